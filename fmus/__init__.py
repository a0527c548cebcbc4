"""FMU entries, one module for each mechanism; built FMUs go to `fmus/build`, which git ignores."""
