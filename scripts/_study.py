"""Common parts of the maintainers' studies: command line, interleaved timing, targets, and a report with CSV files."""

from __future__ import annotations

import argparse
import math
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from timeit import Timer
from typing import Any, NamedTuple

from matplotlib.figure import Figure

import alfmu
from alfmu.simulation import prepared
from alfmu.studies.tables import Cell, Row, environment, markdown, paragraph, rounded, shown, write_csv

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


# Report -----------------------------------------------------------------------------------------------------------

WIDE = 12
"""Number of columns of a CSV file from which its table in the report is transposed."""


@dataclass(frozen=True)
class Report:
    """The studies of a script, and the texts of their report."""

    name: str
    """Name of the folder in `results` and of the Markdown file."""
    script: str
    title: str
    introduction: str
    studies: Mapping[str, Callable[[Any, Sequence[str]], Results]]
    """Studies by name: functions of the effort and the available kernels that return `Results`."""
    efforts: Mapping[str, Any]
    """Efforts by the option that selects them; the default has an empty name."""
    chapters: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Heading and introduction by CSV file; a file without them is in no chapter."""
    targets: Sequence[Target] = ()
    pictures: Mapping[str, tuple[str, Callable[[Any], Figure], str]] = field(default_factory=dict)
    """Pictures by chapter: the CSV file whose rows are drawn, the function that draws them, and the caption."""
    limits: str = ""
    """Limits of a fair comparison."""
    packages: Sequence[str] = ("alfmu", "casadi", "numpy", "scipy", "matplotlib")
    takes: str = "some minutes"

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run the studies selected on the command line; return the exit code."""
        line = argparse.ArgumentParser(
            description=f"{self.introduction} Writes {self.name}.md, CSV files and pictures.",
            epilog=f"needs the extra alfmu[test]; takes {self.takes}; overwrites an earlier run in the same folder",
        )
        folder, some = Path("results") / self.name, f"some of: {', '.join(self.studies)}"
        line.add_argument("-o", "--output", type=Path, default=folder, help="folder (default: %(default)s)")
        line.add_argument("--only", nargs="+", choices=self.studies, metavar="STUDY", help=some)
        size = line.add_mutually_exclusive_group()
        for option in filter(None, self.efforts):
            size.add_argument(f"--{option}", action="store_const", const=option, dest="size", default="")
        chosen = line.parse_args(arguments)
        only = [name for name in self.studies if name in (chosen.only or self.studies)]
        command = ["python", f"scripts/{self.script}", *[f"--{chosen.size}"] * bool(chosen.size)]
        command += ["--only", *only] * (len(only) < len(self.studies))
        path = chosen.output / f"{self.name}.md"
        try:
            chosen.output.mkdir(parents=True, exist_ok=True)
            path.touch()
        except OSError as error:
            print(f"{path} cannot be written ({error.strerror}); give another folder with -o", file=sys.stderr)
            return 1
        try:
            self.measure(path, self.efforts[chosen.size], only, " ".join(command))
        except alfmu.AlfmuError as error:
            print(error, file=sys.stderr)
            return 1
        print(path)
        return 0

    def measure(self, path: Path, effort: Any, studies: Sequence[str], command: str) -> None:
        """Run the studies and write their results."""
        begin, without = time.perf_counter(), no_compiler()
        kernels = ("vm",) if without else ("vm", "compiled")
        where = [{"what": what, "value": value} for what, value in environment(command, self.packages)]
        results: Results = {"environment": where, "targets": []}
        for name in studies:
            results |= self.studies[name](effort, kernels)
        where += [{"what": "kernel", "value": kernels[-1]}, {"what": "without compiled code as", "value": without}]
        where.append({"what": "it took", "value": f"{rounded(time.perf_counter() - begin)} s"})
        results["targets"] = [judged(target, results) for target in self.targets]
        for name, rows in results.items():
            write_csv(path.parent / f"{name}.csv", rows)
        for name, (source, draw, _) in self.pictures.items():
            if source in results:
                draw(results[source]).savefig(path.parent / f"{name}.png", dpi=120, metadata={"Software": None})
        path.write_text(self.markdown(results), encoding="utf-8")

    def markdown(self, results: Results) -> str:
        """Return the report in Markdown: each chapter with all columns of its CSV file, rounded."""
        parts = [f"# {self.title}", paragraph(self.introduction), table("Machine and versions", "environment", results)]
        if self.targets:
            note = "Judged by the numbers of this run alone; what was left out is not measured."
            parts += ["## Targets", note, table("Target against measured", "targets", results)]
        for name, (heading, introduction) in self.chapters.items():
            if name in results:
                parts += [f"## {heading}", paragraph(introduction), table(heading, name, results)]
                if name in self.pictures:
                    parts.append(f"![{self.pictures[name][-1]}]({name}.png)")
        return "\n\n".join([*parts, "## Where the comparison stops being fair", self.limits.strip()]) + "\n"


def table(title: str, name: str, results: Results) -> str:
    """Return the rows of a CSV file as a Markdown table, transposed if there are many columns."""
    rows = results[name]
    columns = [
        x for x in dict.fromkeys(x for row in rows for x in row) if any(row.get(x) not in (None, "") for row in rows)
    ]
    if len(columns) <= WIDE or len(rows) >= len(columns):
        return shown(title, name, columns, rows)
    first, *others = columns
    lines = [[column, *(row.get(column) for row in rows)] for column in others]
    return f"**{title}** (`{name}.csv`)\n\n" + markdown([first, *(str(row[first]) for row in rows)], lines)


def no_compiler() -> str | None:
    """Return why kernels cannot be compiled here; None if they can."""
    try:
        prepared(alfmu.derive(alfmu.load("particle_on_circle")), "compiled")
    except alfmu.ExportError as error:
        return str(error)
    return None
