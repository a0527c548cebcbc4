"""Mechanisms by name or file, including those of alfmu: `mechanisms`, and their recipes `fmus`.

These are installed in this folder; in a source tree they are folders at its top, also if it is installed editable.

Other rooms import `registry`.
"""

from pathlib import Path

if not Path(__file__).with_name("mechanisms").is_dir():
    __path__.append(str(Path(__file__).parents[2]))
