"""What scripts that measure share: timing in turns, targets, where a study ran, CSV files, Markdown."""

from __future__ import annotations

import csv
import datetime
import math
import os
import platform
import statistics
import subprocess
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from timeit import Timer
from typing import NamedTuple

from alfmu.kernel.build import compiler

Cell = str | int | float | None
Row = dict[str, Cell]
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


@dataclass(frozen=True)
class Chapter:
    """A part of a report: a heading, an introduction, and tables that each show some columns of one CSV file."""

    heading: str
    introduction: str
    tables: Mapping[str, Sequence[str]]
    """Columns by title."""

    def write(self, path: Path, rows: Sequence[Row]) -> None:
        """The CSV file, with all that the rows have and all that the tables show."""
        named = [*(name for row in rows for name in row), *(name for shown in self.tables.values() for name in shown)]
        write_csv(path, list(dict.fromkeys(named)), rows)

    def markdown(self, name: str, rows: Sequence[Row], notes: Sequence[str] = ()) -> str:
        """The chapter in Markdown; `name` is that of its CSV file, without the ending."""
        introduction = textwrap.fill(" ".join(self.introduction.split()), 118, break_on_hyphens=False)
        parts = [self.heading, introduction, *notes]
        for title, shown in self.tables.items():
            parts += [f"**{title}** (`{name}.csv`)", markdown(shown, [[row.get(x) for x in shown] for row in rows])]
        return "\n\n".join(parts)


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


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Cell]]) -> None:
    """A CSV file with 17 significant digits; what a row does not have stays empty."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([_exact(row.get(name)) for name in columns] for row in rows)


def markdown(columns: Sequence[str], rows: Sequence[Sequence[Cell]], digits: int = 3) -> str:
    """A Markdown table with rounded numbers."""
    lines = [columns, ["---"] * len(columns), *([rounded(x, digits) for x in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rounded(x: Cell, digits: int = 3) -> str:
    """A cell as text; floats with so many significant digits, without an exponent where it can be helped."""
    if x is None:
        return "-"
    if isinstance(x, float):
        return f"{x:.0f}" if 10**digits <= abs(x) < 1e7 else f"{x:.{digits}g}"
    return str(x).replace("|", "\\|")


def environment(command: str, packages: Sequence[str]) -> list[tuple[str, str]]:
    """Where, when and with what a study ran."""
    load = f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"
    return [
        ("command", f"`{command}`"),
        ("date", datetime.date.today().isoformat()),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("processor", f"{processor()}, {os.cpu_count()} logical"),
        ("load average at the start", load),
        ("Python", f"{platform.python_implementation()} {platform.python_version()}"),
        ("C compiler", _compiler()),
        *((name, _version(name)) for name in packages),
    ]


def _exact(x: Cell) -> str:
    return "" if x is None else f"{x:.17g}" if isinstance(x, float) else str(x)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _compiler() -> str:
    command = compiler()
    if command is None:
        return "none"
    try:
        done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    except OSError as error:
        return f"cannot be run ({error.strerror})"
    return (done.stdout.strip().splitlines() or ["unknown"])[0]


def processor() -> str:
    """The name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
