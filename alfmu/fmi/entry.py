"""The class that pythonfmu's own command builds an FMU from: `pythonfmu build -f fmus/five_bar.py`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from ..model.hooks import handed_in
from ..runtime.library import Scene
from .recipe import Recipe
from .slave import SCENE, Slave

__all__ = ["Entry"]


class Entry(Slave):
    """The mechanism of a recipe behind FMI 2.0: `class FiveBar(Entry, recipe=recipe)` beside the recipe in its file.

    pythonfmu makes an instance when it builds, in the folder that becomes the FMU's resources. The scene is derived
    then, and left there with the description, so that nothing is derived where the FMU runs. The FMU imports alfmu,
    which has to be installed there; one by `alfmu export` needs Python alone. A recipe's `kind`, `platforms`, `fmi` and
    `reference` are for `alfmu export`.
    """

    recipe: Recipe

    def __init_subclass__(cls, recipe: Recipe) -> None:
        super().__init_subclass__()
        cls.recipe = recipe.in_file(Path(str(sys.modules[cls.__module__].__file__)))

    def _scene(self, folder: Path) -> Scene:
        if (folder / SCENE).is_file():
            return Scene((folder / SCENE).read_bytes())
        self._description, self._resources = handed_in("described")(self.recipe)
        return Scene(self._resources[SCENE])

    def to_xml(self, model_options: Any = None) -> Element:
        """The description of the FMU; what the scene consists of is left in the resources."""
        for name, data in self._resources.items():
            Path(self.resources, name).write_bytes(data)
        return self._description
