"""What reports of scripts share: where a study ran, CSV files, Markdown tables."""

from __future__ import annotations

import csv
import datetime
import os
import platform
import subprocess
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from alfmu.kernel.build import compiler

Cell = str | int | float | None


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
        ("processor", f"{_processor()}, {os.cpu_count()} logical"),
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
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    return (done.stdout.strip().splitlines() or ["unknown"])[0]


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
