"""Measure whether runs hold the tolerance that they are given, on every mechanism over its own stop time.

Writes `tolerances.md`, a CSV file for each of its tables and `tolerances.png` into one folder.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from _report import Heard, parser, written
from matplotlib.figure import Figure
from tqdm import tqdm

import alfmu
from alfmu.catalogue.registry import mechanisms, options
from alfmu.method.stepping import EXPLICIT8, RADAU9
from alfmu.simulation import prepared, with_defaults
from alfmu.studies import reference, tables
from alfmu.studies.cases import POSITION, Case, Judge, exactness, restarting, run, scene
from alfmu.studies.report import HELD
from alfmu.studies.tables import Chapter, Row

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "matplotlib")

METHODS = ("explicit", "stiff")

ORDERS = {"explicit": EXPLICIT8.estimate + 1, "stiff": RADAU9.order + 1}
"""Steps become as many times more as the tolerance becomes smaller, to the power of one over this."""

TWICE = 2.0
"""Run time of `auto` over that of the better method that is wanted at most."""

SLOWER = 2.0
"""Evaluations over those of the looser tolerance beside, times what the order adds to them, that are wanted at most."""

SAID = "cannot be had"
"""In the warning that a tolerance is below round-off."""

POINTS = 11
"""At which a run is judged; so few that error control decides on the steps."""

COMPARED = 1e-6
"""Tolerance at which run times of methods are compared."""


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    tolerances: Sequence[float]
    horizon: float
    """Longest simulated time [s]; a mechanism's own stop time where that is shorter."""
    limit: float
    """Wall time of a run [s]."""
    parts: int
    """Least number of steps of the reference in a second of simulated time."""
    patience: float
    """Wall time of an integration of the reference [s]."""


USUAL = Effort((1e-4, 1e-6, 1e-9, 1e-11), np.inf, 120.0, 100, 120.0)
QUICK = Effort((1e-6, 1e-9), 1.0, 10.0, 20, 20.0)

CHAPTERS = {
    "tolerances": Chapter(
        "## Errors over tolerances",
        "The largest difference of places and angles to a motion from an unrelated method (`alfmu.studies.reference`), "
        "from the start with all defaults, at few points, so that error control decides the steps. The change of the "
        "reference is its own error: the largest difference to other ways to compute it. A run that takes too long is "
        "judged up to where it came. A tolerance that is not held is told where a warning says that round-off is above "
        "it. The trend is the number of evaluations over that at the looser tolerance above, over what the order of "
        f"the method makes of it; it is wanted to be `{SLOWER:g}` at most.",
        {
            "Held, or not": (
                *("mechanism", "method", "tolerance", "simulated [s]", POSITION, "error over tolerance"),
                *("change of reference", "steps", "refused", "evaluations", "trend", "median [s]", "verdict", "note"),
            )
        },
    ),
    "auto": Chapter(
        "## What `auto` chooses",
        "By the eigenvalues of small motions at the start. The ratio is the run time of what it chose over that of "
        "the better method, where both reached the end.",
        {"Choices": ("mechanism", "chosen", "ratio", "verdict", "reason")},
    ),
}


def variants(name: str) -> list[dict[str, str]]:
    """What is chosen of the options of a mechanism: each of its coordinate sets, if it has some."""
    return [{"coordinates": str(x)} for x in options(name).get("coordinates", ())] or [{}]


def measured(
    name: str,
    effort: Effort,
    kernel: str = "auto",
    methods: Sequence[str] | None = None,
    chosen: Mapping[str, str] | None = None,
) -> list[Row]:
    """Runs of a mechanism, with what is chosen of its options, by every method and tolerance, judged."""
    equations = alfmu.derive(alfmu.load(name, **(chosen or {})))
    name = " ".join([name, *(chosen or {}).values()])
    plain = prepared(equations, "oracle")
    instance = alfmu.Instance(plain)
    instance.initialize()
    stop = min(equations.stop_time, effort.horizon)
    parts = max(20, round(effort.parts * stop))
    known = reference.reference(instance, stop, reference.Effort(parts=parts, seconds=effort.patience))
    if isinstance(known, str):
        return [{"mechanism": name, "note": known, "verdict": "not judged"}]
    times = np.linspace(0.0, stop, POINTS)
    judge = Judge(plain, known)
    changes = [row[POSITION] for row in judge.errors_of_reference(times) if row[POSITION] is not None]
    rows: list[Row] = []
    for method in methods or METHODS:
        try:
            unit = alfmu.Instance(scene(equations, method, kernel))
        except alfmu.InputError as error:
            rows.append({"mechanism": name, "method": method, "note": str(error), "verdict": "not judged"})
            continue
        restart = restarting(unit)
        before: tuple[float, int] | None = None
        for tolerance in effort.tolerances:
            with Heard() as heard:
                found = run(unit, restart, Case(exactness(method, tolerance), times, effort.limit))
            error = judge.errors(found)[POSITION]
            cost = found.cost()
            over = error / tolerance if found.complete else None
            told = [text for text in heard.said if SAID in text]
            verdict = "not judged" if over is None else "held" if over <= HELD else "told" if told else "not held"
            row = {"mechanism": name, "method": method, "tolerance": tolerance, POSITION: error}
            row |= {"error over tolerance": over, "change of reference": max(changes, default=None)}
            row |= {x: cost[x] for x in ("simulated [s]", "steps", "evaluations", "median [s]")} | {"verdict": verdict}
            if found.complete and before:
                row["trend"] = cost["evaluations"] / before[1] / (before[0] / tolerance) ** (1 / ORDERS[method])
            before = (tolerance, cost["evaluations"]) if found.complete else None
            rows.append(row | {"refused": found.counters.refused if found.counters else None})
            rows[-1]["note"] = cost["note"] or "; ".join(told)
    return rows


def choice(name: str, rows: Sequence[Row], chosen: Mapping[str, str]) -> Row:
    """What `auto` chose on a mechanism, and its run time over that of the better method."""
    decided = prepared(with_defaults(alfmu.derive(alfmu.load(name, **chosen)), {"solver.method": "auto"}), "oracle")
    name = " ".join([name, *chosen.values()])
    made = decided.decision.method
    seconds = {r["method"]: r["median [s]"] for r in rows if r.get("tolerance") == COMPARED and r["median [s]"]}
    ratio = seconds[made] / min(seconds.values()) if made in seconds else None
    verdict = "not judged" if ratio is None else "met" if ratio <= TWICE else "not met"
    return {"mechanism": name, "chosen": made, "ratio": ratio, "verdict": verdict, "reason": decided.decision.reason}


def picture(rows: Sequence[Row], tolerances: Sequence[float]) -> Figure:
    """Error over tolerance, a panel for each tolerance."""
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    names = list(dict.fromkeys(row["mechanism"] for row in rows))
    for axes, tolerance in zip(np.ravel(figure.subplots(1, len(tolerances), sharey=True)), tolerances, strict=True):
        for method, marker, colour in zip(METHODS, "os", ("#3b75af", "#d98c1f"), strict=False):
            told = [r for r in rows if (r.get("method"), r.get("tolerance")) == (method, tolerance)]
            told = [r for r in told if r["error over tolerance"]]
            places = [names.index(r["mechanism"]) for r in told]
            over = [r["error over tolerance"] for r in told]
            axes.semilogx(over, places, marker, color=colour, label=method, markersize=6)
        axes.axvline(HELD, color="#c0523a", linewidth=1.0)
        axes.set(title=f"tolerance {tolerance:.0e}", xlabel="largest error over tolerance")
        axes.set_yticks(range(len(names)), names)
        axes.grid(color="#e3e8ee")
    figure.axes[0].invert_yaxis()
    figure.axes[-1].legend(fontsize=8)
    return figure


def write(folder: Path, effort: Effort, names: Sequence[str], command: str) -> None:
    """Measure and write the results."""
    logging.getLogger("alfmu").addHandler(logging.NullHandler())
    where = tables.where(command, PACKAGES, {"wall time of a run, at most [s]": effort.limit})
    results: Mapping[str, list[Row]] = {"tolerances": [], "auto": []}
    for name in tqdm(names, "tolerances", unit="mechanism"):
        for chosen in variants(name):
            rows = measured(name, effort, chosen=chosen)
            results["tolerances"] += rows
            results["auto"].append(choice(name, rows, chosen))
            for table, chapter in CHAPTERS.items():  # as they come, since a run of hours may be ended
                chapter.write(folder / f"{table}.csv", results[table])
    tables.write_csv(folder / "environment.csv", where)
    picture(results["tolerances"], effort.tolerances).savefig(folder / "tolerances.png", dpi=110)
    parts = ["# Tolerances", tables.shown("Where this was measured", "environment", ("what", "value"), where)]
    parts += [chapter.markdown(name, results[name]) for name, chapter in CHAPTERS.items()]
    (folder / "tolerances.md").write_text("\n\n".join([*parts, "![errors over tolerances](tolerances.png)\n"]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the command line asks for."""
    names = mechanisms()
    text = "Measure whether runs hold the tolerance that they are given, on every mechanism over its own stop time."
    chosen = parser("tolerances", names, text, "a quarter of an hour", "one second each").parse_args(arguments)

    def make(studies: list[str], command: str) -> None:
        write(chosen.output, QUICK if chosen.quick else USUAL, studies, command)

    return written(chosen, "tolerance_study.py", names, "tolerances.md", make)


if __name__ == "__main__":
    raise SystemExit(main())
