"""Tables of a study: rows as CSV files with all digits and rounded in Markdown, and the machine they were made on."""

import codecs
import csv
import datetime
import os
import platform
import subprocess
import textwrap
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..model.files import atomic
from ..runtime.build import compiler

Cell = str | int | float | None
Row = dict[str, Cell]


def measured(row: Row, name: str) -> float | None:
    """Return the number in a column of a row; None if there is none."""
    value = row.get(name)
    return None if isinstance(value, str) else value


def number(row: Row, name: str) -> float:
    """Return the number in a column of a row, which must have one."""
    value = measured(row, name)
    if value is None:
        raise TypeError(f"{name} is {row.get(name)!r}, not a number")
    return value


def paragraph(text: str) -> str:
    """Wrap text to lines of readable length."""
    return textwrap.fill(" ".join(text.split()), 118, break_on_hyphens=False)


def shown(title: str, name: str, columns: Sequence[str], rows: Sequence[Mapping[str, Cell]], digits: int = 3) -> str:
    """Return a Markdown table of some columns of rows of a CSV file under its title; `name` is without the suffix."""
    return f"**{title}** (`{name}.csv`)\n\n" + markdown(
        columns, [[row.get(x) for x in columns] for row in rows], digits
    )


def write_csv(path: Path, rows: Sequence[Mapping[str, Cell]], more: Sequence[str] = ()) -> None:
    """Write a CSV file with 17 significant digits: the columns of all rows and of `more`; missing values stay empty."""
    columns = list(dict.fromkeys([*(name for row in rows for name in row), *more]))
    with atomic(path) as file:
        writer = csv.writer(codecs.getwriter("utf-8")(file))
        writer.writerow(columns)
        writer.writerows([_exact(row.get(name)) for name in columns] for row in rows)


def markdown(columns: Sequence[str], rows: Sequence[Sequence[Cell]], digits: int = 3) -> str:
    """Return a Markdown table with rounded numbers."""
    heads = [name.replace("|", "\\|") for name in columns]
    lines = [heads, ["---"] * len(columns), *([rounded(x, digits) for x in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def rounded(x: Cell, digits: int = 3) -> str:
    """Return a cell as text; floats have this number of significant digits, preferably without an exponent."""
    if x is None:
        return "-"
    if isinstance(x, float):
        return f"{x:.0f}" if 10**digits <= abs(x) < 1e7 else f"{x:.{digits}g}"
    return str(x).replace("|", "\\|")


def environment(command: str, packages: Sequence[str]) -> list[tuple[str, str]]:
    """Return time, machine, command and versions of a study."""
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


def where(command: str, packages: Sequence[str], measured: Mapping[str, Cell]) -> list[Row]:
    """Return `environment` and the measured bounds of a study as rows of a CSV file."""
    return [{"what": what, "value": value} for what, value in [*environment(command, packages), *measured.items()]]


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
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
