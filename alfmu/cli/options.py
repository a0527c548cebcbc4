"""Options shared by several commands, and the objects that they select."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..kernel import DEFAULT, KERNELS
from ..model.errors import InputError
from ..model.files import path_for

if TYPE_CHECKING:
    from ..equations import Equations
    from ..fmi.recipe import Recipe
    from ..model.mechanism import Mechanism
    from ..simulation.result import Signal

Command = Callable[[str, Callable[[argparse.Namespace], int | None], str], argparse.ArgumentParser]
"""Adds a command: its name, the function that runs it and returns the exit code (None for 0), and a line of help."""


NAME_HELP = "a name of `alfmu list`, or a Python, MJCF, SDF or URDF file that declares one"

EITHER_HELP = "a mechanism or recipe of `alfmu list`, or a Python, MJCF, SDF or URDF file that declares one"


def add_name(sub: argparse.ArgumentParser, name: str, metavar: str, text: str, *suffixes: str) -> None:
    """Add the argument for a mechanism: a name, or a file with one of the suffixes, at least `.py`."""

    def known(prefix: str, **_: Any) -> list[str]:
        from ..catalogue.registry import known as mechanisms
        from ..catalogue.registry import registered
        from ..fmi.recipe import GROUP as RECIPES
        from ..model.sources import LINKAGES

        return mechanisms() + registered(RECIPES) + _files(prefix, (".py", *LINKAGES, *suffixes))

    sub.add_argument(name, metavar=metavar, help=text).completer = known  # type: ignore[attr-defined]


def _files(prefix: str, suffixes: tuple[str, ...]) -> list[str]:
    """Return files and folders that complete a word on the command line."""
    folder = Path(prefix if prefix.endswith("/") else os.path.dirname(prefix) or ".")
    base = prefix[: prefix.rfind("/") + 1]
    found = list(folder.iterdir()) if folder.is_dir() else []
    return [f"{base}{each.name}{'/' * each.is_dir()}" for each in found if each.is_dir() or each.suffix in suffixes]


def add_step(sub: argparse.ArgumentParser, text: str) -> None:
    """Add the option for the communication step: its name in FMI, and a short one."""
    sub.add_argument("--communication-step", "--step", dest="step", type=float, metavar="S", help=text)


def add_start(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--start",
        choices=("declared", "equilibrium"),
        help="start: its start values (default), or at rest in the nearest position where loads and springs "
        "balance, a stable one if there is one (see `alfmu equilibrium`)",
    )


def add_kernel(sub: argparse.ArgumentParser) -> None:
    each = "; ".join(f"{name}, {text}" for name, text in KERNELS.items())
    sub.add_argument(
        "--kernel", choices=list(KERNELS), help=f"kernel that runs the method (default: {DEFAULT}): {each}"
    )


def add_scene(sub: argparse.ArgumentParser) -> None:
    """Add the options of a scene."""
    add_option(sub)
    add_set(sub)
    add_names(
        sub,
        "--outputs",
        "PATTERNS",
        'compute only these outputs, such as "link*.angle,*.force.*" (default: all); "*,link1.angle/A.torque" '
        "adds the derivative of link1.angle at the end of each communication step by A.torque, held over the step",
    )
    text = "make parameters of the mechanism constants at their values, as m1,m2 or all: smaller and faster"
    add_names(sub, "--freeze", "all|NAMES", text)
    sub.add_argument(
        "--compliances",
        action=argparse.BooleanOptionalAction,
        help="add a compliance of each constraint as a parameter: redundant constraints share a load accordingly",
    )
    add_names(sub, "--lock", "JOINTS", "joints that Boolean inputs JOINT.locked can stop while running, as B,C")
    add_names(sub, "--release", "JOINTS", "joints that Boolean inputs JOINT.released can open while running, as E,F")
    text = "joints and springs whose relative motion, elongation and force are outputs, as B,C or all"
    add_names(sub, "--measure", "all|NAMES", text)


def add_names(sub: argparse.ArgumentParser, option: str, metavar: str, text: str, **more: Any) -> None:
    """Add an option that takes names with commas between them, and may be given many times."""
    sub.add_argument(option, metavar=metavar, type=name_list, action="extend", help=text, **more)


def add_each(sub: argparse.ArgumentParser, option: str, metavar: str, kind: Callable[[str], Any], text: str) -> None:
    """Add an option that may be given many times, each with a value of a `kind`."""
    sub.add_argument(option, metavar=metavar, action="append", type=kind, default=[], help=text)


def add_option(sub: argparse.ArgumentParser) -> None:
    text = "an option of the mechanism, such as coordinates=natural; may be given many times"
    add_each(sub, "--option", "KEY=VALUE", pair, text)


def add_set(sub: argparse.ArgumentParser) -> None:
    text = "a parameter, start value, input or solver variable; may be given many times"
    add_each(sub, "--set", "NAME=VALUE", pair, text)


def inputs_of(chosen: argparse.Namespace) -> dict[str, Signal]:
    """Return the inputs over time in the file of --input."""
    from ..simulation.result import read_inputs

    return read_inputs(chosen.input) if chosen.input else {}


def file_of(content: str, path: str | None) -> Path | None:
    """Return the path of a requested file, None if none is. Raises InputError if its name has another suffix."""
    return path_for(content, path) if path else None


def name_list(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def pair(text: str) -> tuple[str, float | str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, float(value)
    except ValueError:
        return name, value


def changed_by(chosen: argparse.Namespace, recipe: Recipe) -> Recipe:
    """Return a recipe changed by the options of a scene."""
    of_scene = ("outputs", "freeze", "lock", "release", "measure", "compliances", "start")
    own = {name: getattr(chosen, name, None) for name in of_scene}
    return recipe.changed(options=dict(chosen.option), parameters=dict(chosen.set), **own)


def chosen_recipe(chosen: argparse.Namespace, name: str) -> Recipe:
    """Return the mechanism of this name as a recipe, or the recipe of this name."""
    from ..fmi.recipe import of

    return changed_by(chosen, of(name))


def equations_of(recipe: Recipe, mechanism: Mechanism) -> Equations:
    """Return the equations of a recipe; warn of values in it that seem to be in another unit."""
    from ..equations.derivation import derive
    from ..model.checks import hint, perhaps_degrees, perhaps_millimetres
    from ..model.doubts import masses, perhaps_grams
    from ..runtime.pipeline import with_defaults

    equations = with_defaults(derive(mechanism), recipe.parameters)
    own = recipe.parameters
    for v in (v for v in (*equations.starts, *equations.parameters) if v.unit == "rad" and v.name in own):
        perhaps_degrees(f"{equations.name}: {v.name}", float(v.start))
    for v in (v for v in equations.parameters if v.unit == "m" and v.name in own):
        perhaps_millimetres(f"{equations.name}: {v.name}", float(v.start))
    if any(v.unit == "kg" and v.name in own for v in equations.parameters):
        values = {v.name: float(v.start) for v in equations.parameters}
        for message in perhaps_grams(equations.name, masses(mechanism, values)).values():
            hint(message)
    return equations


def refuse_scene_of_fmu(chosen: argparse.Namespace, fmu: str) -> None:
    """Raise InputError for an option that is fixed in an FMU."""
    fixed = ("option", "kernel", "outputs", "freeze", "lock", "release", "measure", "compliances", "start")
    if any(getattr(chosen, name, None) for name in fixed):
        raise InputError(
            f"{fmu}: options, outputs, frozen parameters, locks, the start and the kernel of an FMU are fixed when it "
            "is exported; give them to `alfmu export`"
        )


def file_name(name: str) -> str:
    """Return a valid file name for the name of a model, which may be any text."""
    return re.sub(r"[^\w.+-]+", "_", name).strip("._")[:60] or "result"
