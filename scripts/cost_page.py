"""Put a picture and a table of a report into docs/theory/cost.md.

`python scripts/cost_page.py DIR --run` measures all mechanisms into DIR first; without `--run`, DIR has such a report.

The picture is `cost.png` beside that page; the table stands between two markers. Numbers are those of the CSV files of
that report.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from alfmu.cli import main as alfmu
from alfmu.studies.cases import POSITION
from alfmu.studies.looks import LOOKS, integrator
from alfmu.studies.report import TIME
from alfmu.studies.tables import markdown, paragraph

PAGE = Path(__file__).parents[1] / "docs" / "theory" / "cost.md"
PICTURE = PAGE.with_suffix(".png")
BEGIN, END = "<!-- report: begin -->", "<!-- report: end -->"

MECHANISM = "five_bar"
"""That of the picture."""

LEVEL = 1e-6
"""Position error [m, rad] at which run times are compared in the table."""

LINES = {
    "auto, compiled": ("alfmu", "auto", "compiled", "-"),
    "rk4, compiled": ("alfmu", "rk4", "compiled", "-"),
    "order8, compiled": ("alfmu", "order8", "compiled", "-"),
    "auto, vm": ("alfmu", "auto", "vm", "--"),
    "auto, through an FMU": ("alfmu", "auto", "FMU (compiled)", ":"),
    "rk4, in Python": ("alfmu", "rk4", "oracle", "-."),
    "Pinocchio, RK4 in Python": ("Pinocchio", "RK4, Baumgarte", None, "-"),
    "Exudyn, generalized alpha": ("Exudyn", "generalized alpha", None, "-"),
    "MuJoCo, RK4": ("MuJoCo", "RK4", None, "-"),
    "SciPy's DOP853 on (9), in Python": ("SciPy on (9)", "DOP853", None, "-"),
}
"""Code, method, way and line of each line of the picture; colour and marker are those of the report."""

Rows = list[dict[str, str]]


def rows(folder: Path, name: str) -> Rows:
    """A CSV file of the report."""
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def picture(errors: Rows) -> Figure:
    """Error against run time of one mechanism."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for label, (code, method, way, style) in LINES.items():
        own = [r for r in errors if (r["mechanism"], r["code"], r["method"]) == (MECHANISM, code, method)]
        own = [r for r in own if way in (None, r["way"])]
        own = [r for r in own if r["formulation"] in ("residual", "dae") and r[TIME] and r[POSITION]]
        own = [r for r in own if code != "alfmu" or r["formulation"] == "residual"]
        if own:
            x, y = ([float(r[name]) for r in own] for name in (TIME, POSITION))
            look = LOOKS[integrator(own[0])]
            shown = {"color": look.colour, "marker": look.marker, "linestyle": style, "label": label}
            shown["markerfacecolor"] = look.colour if look.filled else "white"
            axes.loglog(x, y, markersize=5, linewidth=1.3, **shown)
    axes.set(xlabel="run time, fastest of enough repeats [s]", ylabel="largest error of places and angles [m, rad]")
    axes.grid(color="#e3e8ee")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return figure


def table(comparisons: Rows) -> str:
    """Run times at equal error, mechanism by mechanism."""
    told = [r for r in comparisons if r["what"].startswith("run time to") and float(r["level or step"]) == LEVEL]
    codes = list(dict.fromkeys(r["other"].split(",")[0] for r in told))
    lines = []
    for name in dict.fromkeys(r["mechanism"] for r in told):
        each = [r for r in told if r["mechanism"] == name]
        # Of two comparisons with one code, the last one is with alfmu in its language.
        own, first = {r["other"].split(",")[0]: r for r in each}, each[0]
        reached = bool(first["its value"])
        cells = [_ratio(own.get(code)) for code in codes] if reached else [None] * len(codes)
        way = first["alfmu"].removeprefix("alfmu, residual, ") if reached else "not reached"
        lines.append([name, way, 1e3 * float(first["its value"]) if reached else None, *cells])
    return markdown(["mechanism", "alfmu's fastest", "its run time [ms]", *codes], lines, 2)


def _ratio(row: dict[str, str] | None) -> str | float | None:
    """Another code's run time over alfmu's."""
    if row is None:
        return None
    return float(row["ratio"]) if row["ratio"] else "not reached"


def section(folder: Path, link: str) -> str:
    """What stands between the markers."""
    where = {r["what"]: r["value"] for r in rows(folder, "environment")}
    horizon, load = float(where["longest simulated time [s]"]), where["load average at the start"]
    return "\n\n".join(
        [
            BEGIN,
            f"![error against run time of the {MECHANISM}]({link})",
            paragraph(
                f"Error against run time of `{MECHANISM}`, {horizon:g} s of motion: {where['command']} on "
                f"{where['processor']}, load average {load}. Below, the run time to an error of {LEVEL:g} m and rad, "
                "and how many times as long others take; SciPy runs in Python, and is compared with alfmu's oracle, "
                "which does too:"
            ),
            table(rows(folder, "comparisons")),
            END,
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page and the picture."""
    line = argparse.ArgumentParser(description="Put a picture and a table of a report into a page.")
    line.add_argument("report", type=Path, metavar="DIR", help="folder that `alfmu report all -o DIR` wrote")
    line.add_argument("--page", type=Path, default=PAGE, help="file to write into (default: docs/theory/cost.md)")
    line.add_argument("--picture", type=Path, default=PICTURE, help="picture to write (default: docs/theory/cost.png)")
    line.add_argument("--run", action="store_true", help="run `alfmu report all` into DIR first: a quarter of an hour")
    chosen = line.parse_args(arguments)
    if chosen.run and (code := alfmu(["report", "all", "-o", str(chosen.report)])):
        return code
    try:
        before, _, rest = chosen.page.read_text(encoding="utf-8").partition(BEGIN)
        _, marked, after = rest.partition(END)
        if not marked:
            print(f"{chosen.page} has no lines {BEGIN} and {END}; add them where the report belongs", file=sys.stderr)
            return 1
        link = os.path.relpath(chosen.picture, chosen.page.parent).replace(os.sep, "/")
        text = before + section(chosen.report, link) + after
        picture(rows(chosen.report, "errors")).savefig(chosen.picture, dpi=100, metadata={"Software": None})
        chosen.page.write_text(text, encoding="utf-8")
    except OSError as error:
        print(f"{error.filename}: {error.strerror}; give the folder of `alfmu report all -o DIR`", file=sys.stderr)
        return 1
    print(chosen.page)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
