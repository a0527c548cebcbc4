"""Mechanisms by name or file, and what comes with alfmu: `mechanisms`, which it declares, and `fmus`, their recipes.

These are installed in this folder. In a source tree, also one that is installed editable, they are folders at its top.

Other rooms import `registry`.
"""

from pathlib import Path

if not Path(__file__).with_name("mechanisms").is_dir():
    __path__.append(str(Path(__file__).parents[2]))
