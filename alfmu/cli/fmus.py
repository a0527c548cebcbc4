"""Commands for FMUs: export, validate."""

from __future__ import annotations

import argparse
from pathlib import Path

from .options import EITHER_HELP, STEP, Command, add_kernel, add_name, add_scene, add_start, changed_by, name_list

_EXPORT = """A recipe is a Python file that says what an FMU is made of: `recipe = alfmu.Recipe("five_bar",
outputs=["*.angle"])`. What the options say takes precedence over it, those of --option and --set one by one."""


def add(command: Command) -> None:
    """Add them to the command line."""
    sub = command("export", _export, "write the FMU (co-simulation) of a recipe or a mechanism")
    sub.epilog = _EXPORT
    add_name(sub, "mechanism", "NAME", EITHER_HELP)
    sub.add_argument("-o", "--output", metavar="PATH", help="FMU file or folder to write (default: NAME.fmu here)")
    sub.add_argument(
        "--kind",
        choices=("python", "native"),
        help="python, the default, runs in hosts that have Python; native is C and nothing else, for every host",
    )
    sub.add_argument("--fmi", type=int, choices=(2, 3), help="version of FMI (default: 2); 3 for native FMUs alone")
    sub.add_argument(
        "--platform",
        metavar="all|NAMES",
        type=name_list,
        help="what a native FMU runs on, of linux64, win64, darwin64, aarch64-darwin, aarch64-linux, as linux64,win64 "
        "(default: what alfmu came with, this platform at least); others take ziglang (pip install ziglang)",
    )
    add_kernel(sub)
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of the default experiment in s")
    sub.add_argument(
        *STEP, dest="step", type=float, metavar="S", help="communication step of the default experiment in s"
    )
    add_start(sub)
    sub.add_argument(
        "--reference",
        action=argparse.BooleanOptionalAction,
        help="have reference results inside (default) or, to be smaller, leave them out",
    )
    add_scene(sub)

    what = "check an FMU: fmpy's validation, a run, reset, rewind, reproducibility, its reference results"
    sub = command("validate", _validate, what)
    sub.add_argument("fmu", metavar="FMU", help="an .fmu file")


def _export(chosen: argparse.Namespace) -> None:
    from ..fmi.export import export
    from ..fmi.native import libraries_in
    from ..fmi.recipe import load

    recipe = changed_by(chosen, load(chosen.mechanism)).changed(
        kind=chosen.kind,
        fmi=chosen.fmi,
        platforms=chosen.platform,
        kernel=chosen.kernel,
        stop_time=chosen.stop_time,
        communication_step=chosen.step,
        reference=chosen.reference,
    )
    older = {each.resolve() for each in Path(chosen.output or ".").glob("*.fmu")}  # none where -o names the file
    path = export(recipe, chosen.output)
    said = "replaced" if path.resolve() in older else "wrote"
    platforms = libraries_in(path, recipe.kind)
    where = "every host" if recipe.kind == "native" else "hosts with Python (use --kind native for others)"
    print(f"{said} {path} ({path.stat().st_size / 1000:.0f} kB), kind {recipe.kind}: {where} on {', '.join(platforms)}")


def _validate(chosen: argparse.Namespace) -> int:
    from ..fmi.drive import validate

    problems = validate(chosen.fmu)
    for problem in problems:
        print(problem)
    print(f"{chosen.fmu}: {len(problems)} problem{'s' * (len(problems) != 1)} found")
    return int(bool(problems))
