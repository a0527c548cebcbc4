"""What scripts that measure share: timing in turns, targets. Tables and files are those of `alfmu.tables`."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from timeit import Timer
from typing import NamedTuple

from alfmu.tables import Cell, Row

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
