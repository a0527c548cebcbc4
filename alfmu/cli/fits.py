"""Command that fits parameters and start values to measurements: fit."""

import argparse
import sys

from .options import Command, add_each, add_name, add_names, add_option, add_set, chosen_recipe, file_of
from .says import save_file

_FIT = """The table has a column `time` in s, which begins where the run does. Columns with names of outputs are
measurements (`nan` if one is missing), those with names of inputs drive the run. Values of --set are the first guesses
of numbers to vary. Standard deviations follow from the residuals; alfmu warns of combinations of numbers that the data
do not determine."""


def add(command: Command) -> None:
    sub = command("fit", _fit, "fit parameters and start values to measurements, by least squares")
    sub.epilog = _FIT
    add_name(sub, "name", "NAME", "a mechanism, a recipe, or a Python file")
    sub.add_argument("data", metavar="DATA.csv", help="measurements over time, and inputs")
    add_names(sub, "--vary", "NAME,...", "parameters and start values, such as m2,l", required=True)
    add_each(sub, "--bounds", "NAME=LOW:HIGH", _bounds, "bounds of a number (default: those of the mechanism)")
    add_names(sub, "--columns", "NAME,...", "columns of measurements to fit (default: all but monitors)")
    add_each(
        sub,
        "--deviation",
        "NAME=SIZE",
        _size,
        "standard deviation of a measured column, which sets its weight (default: the range of the column)",
    )
    sub.add_argument(
        "--starts",
        type=int,
        default=0,
        metavar="N",
        help="search also from the nearest of N other first guesses within the bounds",
    )
    sub.add_argument("-o", "--output", metavar="FILE.csv", help="write the fitted run")
    sub.add_argument("--plot", metavar="FILE.png", help="draw measurements, the fitted run and the residuals")
    add_option(sub)
    add_set(sub)


def _bounds(text: str) -> tuple[str, tuple[float, float]]:
    name, _, both = text.partition("=")
    low, _, high = both.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=LOW:HIGH, such as m2=0.5:2") from None


def _size(text: str) -> tuple[str, float]:
    name, _, size = text.partition("=")
    try:
        return name, float(size)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=SIZE, such as link1.angle=0.01") from None


def _fit(chosen: argparse.Namespace) -> None:
    from ..gradients import fit

    file_of("a plot", chosen.plot)
    file_of("a table", chosen.output)
    recipe = chosen_recipe(chosen, chosen.name)

    def show(run: int, size: float) -> None:
        if sys.stderr.isatty():
            print(f"\rrun {run}: differs by {size:.6g} of the measurements", end="", file=sys.stderr, flush=True)

    found = fit(
        recipe,
        chosen.data,
        chosen.vary,
        bounds=dict(chosen.bounds),
        columns=chosen.columns,
        deviations=dict(chosen.deviation),
        starts=chosen.starts,
        progress=show,
    )
    if sys.stderr.isatty():
        print(file=sys.stderr)
    print(found)
    print(f"{found.runs} runs; {found.said}")
    save_file(chosen.output, found.result.to_csv)
    if chosen.plot:
        from ..view.plot import save

        save_file(chosen.plot, lambda path: save(found.plot(), path, 150))
