"""What comes with alfmu: `mechanisms`, which it declares, and `fmus`, their recipes, each by its registered name.

Both are installed in this folder. In a source tree, also one that is installed editable, they are folders at its top.
"""

from pathlib import Path

if not Path(__file__).with_name("mechanisms").is_dir():
    __path__.append(str(Path(__file__).parents[2]))
