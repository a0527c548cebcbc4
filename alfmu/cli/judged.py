"""Commands for studies of accuracy: report, stability."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from ..model.errors import InputError
from .options import NAME_HELP, Command
from .says import progress_bar

_REPORT = """The report compares alfmu's methods, formulations and kernels, SciPy on every mechanism, and Pinocchio,
Exudyn and MuJoCo on five_bar and slider_crank (pip install 'alfmu[bench]'). It also has errors over tolerances, the
study of Blajer (2002) on particle_on_circle, five_bar and four_bar, the parts that scenes omit, and small maps of
stability (`alfmu stability` has the full ones). Runs for which no time was left, and codes that are not installed, are
listed. report.html is one file that needs no network; --quick takes less than a minute for a mechanism. Needs pip
install 'alfmu[report]'."""


def add(command: Command) -> None:
    sub = command(
        "report", _report, "measure error against run time, for all methods, formulations and kernels, and other codes"
    )
    _add_study(sub, "report.html, its numbers as CSV files, and pictures", "within a quarter of an hour for all")
    sub.add_argument(
        "--profile",
        choices=("usual", "tolerances", "paper", "peers"),
        default="usual",
        help="tolerances: errors of whole runs over the tolerance, beside SciPy; paper: the study of Blajer (2002) "
        "in full; peers: run times at equal error on five_bar and slider_crank, beside codes that are tuned to "
        "them",
    )
    sub.epilog = _REPORT
    sub = command("stability", _stability, "map the parameters for which a mechanism runs, becomes inexact or fails")
    _add_study(sub, "stability.md, its numbers as CSV files, and maps", "within an hour for all")


def _add_study(sub: argparse.ArgumentParser, what: str, usual: str) -> None:
    sub.add_argument("mechanism", metavar="NAME|all", help=f"{NAME_HELP}; or all that are registered")
    sub.add_argument("-o", "--output", metavar="DIR", required=True, help=f"folder for {what}")
    sub.add_argument("--quick", action="store_true", help=f"short runs: some minutes for all (otherwise {usual})")


def _report(chosen: argparse.Namespace) -> None:
    from ..studies.report import report

    _study(chosen, partial(report, profile=chosen.profile))


def _stability(chosen: argparse.Namespace) -> None:
    from ..studies.stability import stability

    _study(chosen, stability)


def _study(chosen: argparse.Namespace, write: Callable[..., Path]) -> None:
    """Write a study of one mechanism or of all."""
    from ..catalogue.registry import mechanisms

    names = mechanisms() if chosen.mechanism == "all" else [chosen.mechanism]
    try:
        print(f"wrote {write(names, chosen.output, chosen.quick, lambda name: progress_bar(name, 'case'))}")
    except OSError as error:
        raise InputError(f"cannot write into {chosen.output} ({error.strerror or error})") from None
