"""What tests of reports share: scripts as modules, CSV files, the tables of a Markdown file, and whether these show
those."""

import csv
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest


def script(name: str) -> Iterator[ModuleType]:
    """A script as a module, beside what it imports; for a fixture."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parents[1] / "scripts"))
        yield import_module(name)


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    """A CSV file."""
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def number(text: str) -> float | None:
    """A cell of a CSV file that is a number or empty."""
    return float(text) if text else None


def tables(path: Path) -> list[tuple[str, str, list[str], list[list[str]]]]:
    """Title, CSV file, columns and rows of each table in a Markdown file, each turned back if it was turned round."""
    found = []
    for title, name, table in re.findall(r"^\*\*(.+)\*\* \(`(\w+)\.csv`\)\n\n((?:\|.*\n?)+)", path.read_text(), re.M):
        columns, _, *lines = [line.strip()[2:-2].split(" | ") for line in table.strip().splitlines()]
        maps = name == "cells"  # whose columns are values
        if not maps and columns[0] != "what" and not set(columns[1:]) <= set(rows(path.parent, name)[0]):
            columns, *lines = map(list, zip(columns, *lines, strict=True))
        found.append((title, name, columns, lines))
    return found


def agree(shown: str, exact: str) -> bool:
    """Whether a cell of a Markdown table is one of a CSV file, rounded to three digits."""
    try:
        return float(shown) == pytest.approx(float(exact), rel=6e-3, abs=1e-300, nan_ok=True)
    except ValueError:
        return shown == (exact.replace("|", "\\|") or "-") or (shown, exact) == ("", "")


def untraced(path: Path, name: str, columns: list[str], lines: list[list[str]]) -> list[list[str]]:
    """Rows of a table that are no rows of its CSV file."""
    kept = rows(path.parent, name)
    return [
        line
        for line in lines
        if not any(all(agree(x, row[c]) for c, x in zip(columns, line, strict=True)) for row in kept)
    ]


def prose(path: Path) -> str:
    """What a Markdown file says outside its tables, without code, links and the numbers of equations and names."""
    text = "\n".join(line for line in path.read_text().splitlines() if not line.startswith(("|", "!", "#", "**")))
    return re.sub(r"`[^`]*`|\(\d+\)|\(2002\)|Figure 7", "", text)
