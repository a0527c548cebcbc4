"""What scripts share: command line, timing in turns, targets. Tables and files are those of `alfmu.studies.tables`."""

from __future__ import annotations

import argparse
import logging
import math
import statistics
import sys
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from timeit import Timer
from typing import NamedTuple

from alfmu.model.errors import AlfmuError
from alfmu.studies.tables import Cell, Row

Laps = dict[str, list[float]]
"""Time of a unit [s] of what was timed, lap by lap."""


@dataclass(frozen=True)
class Call:
    """What is timed; the timer's setup runs before each lap, outside the clock."""

    timer: Timer
    units: int = 1
    """What one call makes: steps, for example."""
    once: bool = False
    """Whether a lap is a single call, as each needs the setup."""


def clocked(statement: Callable[[], object], setup: Callable[[], object] | str = "pass") -> Timer:
    """A timer of the processor's time, so that what else the machine does counts little."""
    return Timer(statement, setup, time.process_time)


def in_turns(calls: Mapping[str, Call], rounds: int, shortest: float) -> Laps:
    """Time every call once a round, in laps of at least `shortest` [s]."""
    numbers = {}
    for name, call in calls.items():
        call.timer.timeit(1)
        numbers[name] = 1 if call.once else math.ceil(shortest / min(call.timer.repeat(3, 1)))
    laps: Laps = {name: [] for name in calls}
    for _ in range(rounds):
        for name, call in calls.items():
            laps[name].append(call.timer.timeit(numbers[name]) / (numbers[name] * call.units))
    return laps


def times(laps: Laps, yardstick: str) -> Row:
    """Median and minimum [us] of what was timed, and the ratios of medians to a yardstick."""
    row: Row = {"rounds": len(laps[yardstick])}
    for name, each in laps.items():
        row |= {f"{name} [us]": 1e6 * statistics.median(each), f"{name}, minimum [us]": 1e6 * min(each)}
    return row | {f"{name} / {yardstick}": row[f"{name} [us]"] / row[f"{yardstick} [us]"] for name in laps}


class Heard(logging.Handler):
    """Keeps the warnings that alfmu logs within a `with` statement."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.said: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning."""
        self.said.append(record.getMessage())

    def __enter__(self) -> Heard:
        logging.getLogger("alfmu").addHandler(self)
        return self

    def __exit__(self, *_: object) -> None:
        logging.getLogger("alfmu").removeHandler(self)


class Target(NamedTuple):
    """What a number in a row of a study must not exceed, or must reach."""

    study: str
    row: Mapping[str, Cell]
    column: str
    limit: float
    at_least: bool = False


def judged(target: Target, results: Mapping[str, Sequence[Row]]) -> Row:
    """A row of targets.csv: the target beside what was measured in this run, if it was."""
    row = next((row for row in results.get(target.study, ()) if target.row.items() <= row.items()), {})
    value, verdict = row.get(target.column), "not measured"
    if value is not None:
        verdict = "met" if (value >= target.limit if target.at_least else value <= target.limit) else "not met"
    return {
        "study": target.study,
        "row": ", ".join(map(str, target.row.values())),
        "number": target.column,
        "target": f"{'>=' if target.at_least else '<='} {target.limit:g}",
        "measured": value,
        "verdict": verdict,
    }


def parser(
    name: str, studies: Collection[str], description: str, takes: str, quick: str | None = None
) -> argparse.ArgumentParser:
    """The command line of a script that writes into `results/NAME`; `takes` says how long."""
    made = argparse.ArgumentParser(
        description=description,
        epilog=f"needs the extra alfmu[test]; takes {takes}; overwrites an earlier run in the same folder",
    )
    folder = Path("results") / name
    made.add_argument("-o", "--output", type=Path, default=folder, help="folder (default: %(default)s)")
    if studies:
        some = f"some of: {', '.join(studies)}"
        made.add_argument("--only", nargs="+", choices=studies, default=[*studies], metavar="STUDY", help=some)
    if quick:
        made.add_argument("--quick", action="store_true", help=quick)
    return made


def written(
    chosen: argparse.Namespace,
    script: str,
    studies: Collection[str],
    report: str,
    write: Callable[[list[str], str], None],
) -> int:
    """Call `write` with the studies that were chosen and the command that makes them again; returns the exit code."""
    only = [name for name in studies if name in getattr(chosen, "only", ())]
    command = ["python", f"scripts/{script}", *(f"--{x}" for x in ("quick", "full") if getattr(chosen, x, False))]
    command += ["--only", *only] * (len(only) < len(studies))
    path = chosen.output / report
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        print(f"{path} cannot be written ({error.strerror}); give another folder with -o", file=sys.stderr)
        return 1
    try:
        write(only, " ".join(command))
    except AlfmuError as error:
        print(error, file=sys.stderr)
        return 1
    print(path)
    return 0
