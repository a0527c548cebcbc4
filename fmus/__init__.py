"""FMU entries."""
