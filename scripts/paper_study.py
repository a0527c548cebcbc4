"""Remake the study of Blajer (2002) and put what is measured beside what the paper reports.

Writes CSV files, pictures and `report.md` into one folder. The chapters are those of `alfmu.studies.paper`, in full.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Sequence
from pathlib import Path

from _report import parser, written
from tqdm import tqdm

from alfmu.model.errors import InputError
from alfmu.studies import paper, tables

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "mpmath", "matplotlib")


def write(folder: Path, effort: paper.Effort, studies: Sequence[str], command: str) -> None:
    """Run the studies and write their results; InputError where something is not installed."""
    if importlib.util.find_spec("mpmath") is None:
        raise InputError("the references take mpmath; install it with: pip install 'alfmu[bench]'")
    logging.getLogger("alfmu").addHandler(logging.NullHandler())  # what ends without convergence is in the tables
    about = paper.settings(effort)
    where = tables.where(command, PACKAGES, {})
    parts = ["# The paper's study, remade", tables.paragraph(paper.__doc__.split("\n\n")[1])]
    parts += ["## How it was made", tables.shown("Where this was measured", "environment", ("what", "value"), where)]
    parts.append(about.markdown())
    tables.write_csv(folder / "environment.csv", where)
    tables.write_csv(folder / f"{about.name}.csv", about.rows)
    for name in tqdm(studies, "studies", unit="study"):
        _, make = paper.STUDIES[name]
        chapter = make(effort)
        chapter.write(folder)
        parts += chapter.markdown("##")
    parts += ["## Where the comparison stops being fair", paper.LIMITS]
    (folder / "report.md").write_text("\n\n".join(parts), encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    text = (
        "Remake the study of Blajer (2002): Table I, Figure 7, iterations and corrections, accuracy against the "
        "penalty, and the driven four-bar through its singular positions. Writes report.md, CSV files and pictures."
    )
    chosen = parser(
        "paper", paper.STUDIES, text, "some minutes", "short runs, half a minute on a quiet machine"
    ).parse_args(arguments)

    def make(studies: list[str], command: str) -> None:
        write(chosen.output, paper.QUICK if chosen.quick else paper.USUAL, studies, command)

    return written(chosen, "paper_study.py", paper.STUDIES, "report.md", make)


if __name__ == "__main__":
    raise SystemExit(main())
