"""The base class for FMUs built by pythonfmu's own command: `pythonfmu build -f fmus/five_bar.py`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from ..model.hooks import handed_in
from ..runtime.library import Scene, library
from .recipe import Recipe
from .slave import SCENE, Slave


class Entry(Slave):
    """The mechanism of a recipe as an FMI 2.0 slave: `class FiveBar(Entry, recipe=recipe)` in the file of the recipe.

    pythonfmu makes an instance when it builds, in the folder that becomes the FMU's resources. The scene is derived
    then and stored there with the description. The FMU imports alfmu, which must be installed where it runs; one by
    `alfmu export` needs Python alone. A recipe's `kind`, `platforms`, `fmi` and `reference` apply to `alfmu export`
    only.
    """

    recipe: Recipe

    def __init_subclass__(cls, recipe: Recipe) -> None:
        super().__init_subclass__()
        cls.recipe = recipe.in_file(Path(str(sys.modules[cls.__module__].__file__)))

    def _scene(self, folder: Path) -> Scene:
        if (folder / SCENE).is_file():
            return Scene((folder / SCENE).read_bytes(), library())
        self._description, self._resources = handed_in("described")(self.recipe)
        return Scene(self._resources[SCENE], library())

    def to_xml(self, model_options: Any = None) -> Element:
        """Return the description of the FMU, and write the files of the scene into the resources."""
        for name, data in self._resources.items():
            Path(self.resources, name).write_bytes(data)
        return self._description
