"""Commands that show a mechanism: list, info, draw, import, live."""

import argparse
import json
import keyword
import re
import shlex
from pathlib import Path

from ..model.errors import InputError
from ..model.files import path_for
from .options import (
    EITHER_HELP,
    Command,
    add_each,
    add_name,
    add_option,
    add_scene,
    add_set,
    add_step,
    chosen_recipe,
    equations_of,
    file_name,
    pair,
)
from .says import once_written, save_file

_DRAW = """Closing the loops keeps the values of --at exactly, and other start values if possible; otherwise these are
guesses. Names of coordinates: `alfmu info NAME`."""

_IMPORT = """MJCF (.xml), SDF and URDF files also run as they are: `alfmu simulate robot.xml --option key=home`.
The Python file declares the same mechanism with the same numbers, to change and extend. Elements without effect on
the motion are left out, and listed by --all; elements that are not supported are listed together, each with its line.
Options are those of the file's format: `alfmu info FILE`."""

_CONVERT = """The command refuses a mechanism that the format cannot hold, and lists all causes. Positions are those of
the start with closed loops: in MJCF displacements keep their numbers, and the keyframe `start` has the rates; in URDF
and SDF displacements are relative to the start. Loops of a URDF are <loop_joint> elements, inputs <transmission>
elements."""

_LIVE = """The page holds the runtime of an FMU, compiled for browsers, and needs no network: its numbers are those of
the native FMU with the same communication steps, to round-off. Inputs act while it runs; a change of a parameter or
start value restarts the run, and so does dragging a body, which sets start values. --set gives the initial values of
the page."""


def add(command: Command) -> None:
    command("list", _list, "list the registered mechanisms and those of the gallery")

    sub = command("info", _info, "show a mechanism: sketch, coordinates, constraints, parameters, inputs, outputs")
    add_name(sub, "mechanism", "NAME", EITHER_HELP)
    form = sub.add_mutually_exclusive_group()
    form.add_argument(
        "--all", action="store_true", help="all variables with units and descriptions, and the cost of a step"
    )
    form.add_argument("--json", action="store_true", help="the same as JSON, for programs")
    form.add_argument(
        "--sizes", action="store_true", help="export it as well, to show the size of the parts of its FMUs in kB"
    )
    add_scene(sub)

    sub = command("draw", _draw, "draw a mechanism in its start position, without a simulation (PNG or SVG)")
    sub.epilog = _DRAW
    add_name(sub, "mechanism", "NAME|FILE", EITHER_HELP)
    sub.add_argument("-o", "--output", metavar="FILE", help=".png or .svg (default: NAME.png here)")
    add_each(
        sub,
        "--at",
        "COORD=VALUE",
        pair,
        "draw it with this start value or coordinate [rad or m]; may be given many times",
    )
    sub.add_argument("--size", metavar="WxH", type=_size, help="width and height in pixels (default: 640x480)")
    add_option(sub)
    add_set(sub)

    sub = command(
        "import", _import, "write an MJCF, SDF or URDF file as a Python file that declares the same mechanism"
    )
    sub.epilog = _IMPORT
    sub.add_argument("file", metavar="FILE", help="an MJCF (.xml), SDF or URDF file")
    sub.add_argument("-o", "--output", metavar="FILE.py", help="where to write it (default: NAME.py here)")
    sub.add_argument("--loops", metavar="FILE", help="loops of a URDF (default: the file NAME.yaml beside it)")
    what = "take limits of joints as end stops (default), and start inside them"
    sub.add_argument("--limits", choices=("stop", "inside", "ignore"), help=what)
    sub.add_argument("--all", action="store_true", help="also list elements without effect that were left out")
    add_option(sub)

    sub = command("convert", _convert, "write a mechanism as MJCF, URDF or SDF, for other programs")
    sub.epilog = _CONVERT
    add_name(sub, "mechanism", "NAME|FILE", EITHER_HELP)
    sub.add_argument(
        "-o", "--output", metavar="FILE", required=True, help="where to write it: a name in .xml (MJCF), .urdf or .sdf"
    )
    add_option(sub)
    add_set(sub)

    sub = command("live", _live, "write a page that runs a mechanism in a browser, with sliders, as one file")
    sub.epilog = _LIVE
    add_name(sub, "mechanism", "NAME", EITHER_HELP)
    sub.add_argument(
        "-o", "--output", metavar="PAGE.html", help="where to write the page (default: NAME_live.html here)"
    )
    add_step(sub, "communication step in s (default: the mechanism's own)")
    add_scene(sub)


def _list(chosen: argparse.Namespace) -> None:
    from ..catalogue.registry import choices, known, load, mechanisms
    from ..fmi.recipe import recipes

    def show(name: str) -> None:
        mechanism = load(name)
        print(f"{name:20} {mechanism.description}")
        for option, values in choices(mechanism).items():
            print(f"{'':20}   --option {option}={'|'.join(values)}")

    own = mechanisms()
    for name in own:
        show(name)
    for name, recipe in recipes().items():
        if said := recipe.said():
            print(f"{name:20} FMU of {recipe.mechanism}: {said}")
    if of_gallery := [name for name in known() if name not in own]:
        print("\nfrom the gallery of the documentation:")
        for name in of_gallery:
            show(name)


def _info(chosen: argparse.Namespace) -> None:
    from ..studies.about import about, in_all, in_short

    recipe = chosen_recipe(chosen, chosen.mechanism)
    mechanism = recipe.declared()
    found = about(recipe, mechanism, equations_of(recipe, mechanism))
    if chosen.json:
        print(json.dumps(found.as_data(), indent=1, default=str))
        return
    print("\n".join(in_all(found) if chosen.all else in_short(found)))
    if chosen.sizes:
        from ..fmi.sizes import sizes

        print("\n" + "\n".join(sizes(mechanism, recipe.parameters, recipe.outputs, recipe.freeze)))


def _import(chosen: argparse.Namespace) -> None:
    from ..formats import imported
    from ..model.files import write

    options = dict(chosen.option)
    if chosen.loops:
        options["loops"] = str(Path(chosen.loops).resolve())
    if chosen.limits:
        options["limits"] = chosen.limits
    found = imported(chosen.file, **options)
    path = Path(chosen.output or f"{file_name(found.mechanism.name)}.py")
    if path.suffix != ".py" or not path.stem.isidentifier() or keyword.iskeyword(path.stem):
        raise InputError(f"{path} cannot be a Python file with a function of its name; say -o NAME.py")
    save_file(path, lambda path: write(path, found.source(path.stem).encode()))
    for title, lines in (
        ("left out, and may matter: ", found.warnings),
        ("left out: ", found.left_out if chosen.all else ()),
        ("", found.notes),
        ("", [f"{old} is called {new}" for old, new in found.renamed.items()]),
    ):
        for line in lines:
            print(f"{title}{line}")


def _draw(chosen: argparse.Namespace) -> None:
    from ..view.picture import SIZE, drawing

    path = path_for("a drawing", chosen.output or f"{file_name(Path(chosen.mechanism).stem)}.png")
    recipe = chosen_recipe(chosen, chosen.mechanism)
    drawn = drawing(recipe.declared(), dict(chosen.at), recipe.parameters, chosen.size or SIZE)
    save_file(path, drawn.save)


def _convert(chosen: argparse.Namespace) -> None:
    from ..api import convert

    save_file(chosen.output, lambda path: convert(chosen_recipe(chosen, chosen.mechanism), path))


def _live(chosen: argparse.Namespace) -> None:
    from ..equations.specialisation import plain, specialised
    from ..view.live import live, needed, written_by_alfmu

    recipe = chosen_recipe(chosen, chosen.mechanism).changed(communication_step=chosen.step)
    mechanism = recipe.declared()
    path = path_for("a page", chosen.output or f"{file_name(mechanism.name)}_live.html")
    if path.exists() and not chosen.output and not written_by_alfmu(path):
        raise InputError(f"{path} exists and was not written by alfmu live; name another file with -o, or remove it")
    outputs = None if recipe.outputs is None else [*plain(recipe.outputs), *needed(mechanism)]
    equations = specialised(equations_of(recipe, mechanism), outputs, recipe.freeze)
    said = once_written(path)
    source = shlex.join([Path(chosen.mechanism).name, *_scene_options(chosen)])
    live(mechanism, equations, path, parameters=recipe.parameters, source=source)
    print(f"{said} ({path.stat().st_size / 1000:.0f} kB); open it in a browser")


def _scene_options(chosen: argparse.Namespace) -> list[str]:
    """Return the given options of a scene as a command line."""
    said = [
        text
        for name in ("option", "set")
        for key, value in getattr(chosen, name)
        for text in (f"--{name}", f"{key}={value}")
    ]
    for name in ("outputs", "freeze", "lock", "release", "measure"):
        if (names := getattr(chosen, name)) is not None:
            said += [f"--{name}", ",".join(names)]
    if chosen.compliances is not None:
        said += ["--compliances" if chosen.compliances else "--no-compliances"]
    return said


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT in pixels, such as 800x600")
    return int(found[1]), int(found[2])
