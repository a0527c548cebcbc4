"""Commands for many runs: sweep."""

import argparse
import sys
from pathlib import Path

from ..kernel import KERNELS
from ..model.errors import InputError
from .options import (
    EITHER_HELP,
    Command,
    add_each,
    add_name,
    add_scene,
    add_step,
    chosen_recipe,
    file_name,
    inputs_of,
    refuse_scene_of_fmu,
)
from .says import progress_bar

_SWEEP = """NAME=HOW of --vary is a grid first:last:count (first:last:count:log by equal factors), values a,b,c, or a
distribution: uniform(low,high), loguniform(low,high), normal(mean,deviation), normal(mean,deviation,low,high),
lognormal(median,deviation of the logarithm), triangular(low,mode,high). Each row of --cases is run at each point of
the grids with each of the samples. --keep "max(A.force.*)" keeps one number of a run, of final, min, max, mean, peak
(largest magnitude) and rms at communication points; --keep "A.force.*" keeps the first four. Finished cases are
stored in parts that survive an interrupt, a kill and a full disk; the same command continues from them. A failed case
is a row with its reason. The folder also holds summary.json and, where plotly is installed, sweep.html (pip install
'alfmu[sweep]'). Exit codes: 0 all cases are finished, even if some of them failed; 1 or 130 it ended before that."""


def add(command: Command) -> None:
    sub = command("sweep", _sweep, "run a mechanism or an FMU many times with other numbers, on all cores or a cluster")
    sub.epilog = _SWEEP
    add_name(sub, "unit", "NAME|FMU", f"{EITHER_HELP}, or an .fmu file", ".fmu")
    add_each(
        sub,
        "--vary",
        "NAME=HOW",
        _varied,
        "a parameter, start value, input or number of the solver, and its values; may be given many times",
    )
    sub.add_argument("--cases", metavar="FILE.csv", help="a table of cases: a row of names, a row of numbers for each")
    sub.add_argument("--samples", metavar="N", type=int, help="number of samples of the distributions")
    sub.add_argument(
        "--sampler",
        choices=("latin", "sobol", "random"),
        default="latin",
        help="sampling: Latin hypercube (default), scrambled Sobol points, or independently",
    )
    sub.add_argument("--seed", metavar="S", type=int, default=1, help="seed of the samples (default: %(default)s)")
    sub.add_argument(
        "--keep",
        metavar="PATTERN",
        nargs="+",
        action="extend",
        help='numbers to keep of a run, such as "max(A.force.*)" "link1.angle" (default: last, least and largest value '
        "and mean of every output but multipliers and monitors)",
    )
    sub.add_argument(
        "--keep-series",
        metavar="PATTERN",
        nargs="+",
        action="extend",
        default=[],
        help="outputs kept at every communication point",
    )
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of each run in s (default: the unit's own)")
    add_step(sub, "communication step in s (default: the unit's own)")
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")
    sub.add_argument("-o", "--output", metavar="DIR", help="folder for the results (default: NAME-sweep here)")
    sub.add_argument(
        "--format",
        choices=("parquet", "csv"),
        help="format of the results (default: parquet where pyarrow is installed, otherwise csv)",
    )
    sub.add_argument("--workers", metavar="N", type=int, help="processes that make the runs (default: one a core)")
    sub.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of the scheduler of a Dask cluster to run on, such as tcp://10.0.0.5:8786; its workers need "
        "alfmu",
    )
    sub.add_argument(
        "--kernel",
        choices=[name for name in KERNELS if name != "oracle"],
        help="kernel that runs the method (default: vm; the numbers are the same)",
    )
    sub.add_argument("--page", action=argparse.BooleanOptionalAction, default=True, help="write sweep.html (default)")
    add_scene(sub)


def _varied(text: str) -> tuple[str, str]:
    name, equals, how = text.partition("=")
    if not (name and equals and how):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=HOW, such as m2=0:1:11 or l=uniform(0.9,1.1)")
    return name, how


def _sweep(chosen: argparse.Namespace) -> None:
    from ..sweeps.sweep import sweep

    vary = dict(chosen.vary)
    if len(vary) < len(chosen.vary):
        names = [name for name, _ in chosen.vary]
        raise InputError(f"{next(x for x in names if names.count(x) > 1)} is varied twice; leave one --vary out")
    unit, parameters = chosen.unit, dict(chosen.set)
    if chosen.unit.endswith(".fmu"):
        refuse_scene_of_fmu(chosen, chosen.unit)
    else:
        unit, parameters = chosen_recipe(chosen, chosen.unit), {}
    folder = Path(chosen.output or f"{file_name(Path(chosen.unit).stem)}-sweep")
    try:
        found = sweep(
            unit,
            vary,
            chosen.samples,
            folder=folder,
            keep=chosen.keep,
            keep_series=chosen.keep_series,
            sampler=chosen.sampler,
            seed=chosen.seed,
            cases=chosen.cases,
            stop_time=chosen.stop_time,
            communication_step=chosen.step,
            inputs=inputs_of(chosen),
            parameters=parameters,
            kernel=chosen.kernel,
            workers=chosen.workers,
            scheduler=chosen.scheduler,
            form=chosen.format,
            progress=progress_bar("sweeping", "run"),
        )
    except KeyboardInterrupt as ended:
        if str(ended):
            print(ended, file=sys.stderr)
        raise
    print("\n".join(found.lines()))
    for path in found.save(page=chosen.page):
        print(f"wrote {path}")
