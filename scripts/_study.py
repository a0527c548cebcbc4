"""Interleaved timing, and targets of numbers, for scripts that measure costs."""

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from timeit import Timer
from typing import NamedTuple

from alfmu.studies.tables import Cell, Row

Results = dict[str, list[Row]]
"""Rows by the name of their CSV file."""

# Timing -----------------------------------------------------------------------------------------------------------

Laps = dict[str, list[float]]
"""Time per unit [s] of each lap, by the name of the call."""


@dataclass(frozen=True)
class Call:
    """A call that is timed; the timer's setup runs before each lap, outside the clock."""

    timer: Timer
    units: int = 1
    """Number of units in one call, such as steps."""
    once: bool = False
    """Whether a lap is a single call, because each call needs the setup."""


def clocked(statement: Callable[[], object], setup: Callable[[], object] | str = "pass") -> Timer:
    """Return a timer of processor time, which other programs hardly disturb."""
    return Timer(statement, setup, time.process_time)


def in_turns(calls: Mapping[str, Call], rounds: int, shortest: float) -> Laps:
    """Time every call in turn, one lap of at least `shortest` [s] per round."""
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
    """Return median and minimum [us] of each call, and ratios of the medians to that of the call `yardstick`."""
    row: Row = {"rounds": len(laps[yardstick])}
    for name, each in laps.items():
        row |= {f"{name} [us]": 1e6 * statistics.median(each), f"{name}, minimum [us]": 1e6 * min(each)}
    return row | {f"{name} / {yardstick}": row[f"{name} [us]"] / row[f"{yardstick} [us]"] for name in laps}


# Targets ----------------------------------------------------------------------------------------------------------


class Target(NamedTuple):
    """The limit of a number in a row of a study."""

    study: str
    row: Mapping[str, Cell]
    column: str
    limit: float
    at_least: bool = False


def judged(target: Target, results: Mapping[str, Sequence[Row]]) -> Row:
    """Return a row of targets.csv: the target, and the number of this run if there is one."""
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
