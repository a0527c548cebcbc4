"""Measure whether runs hold the tolerance that they are given, on every mechanism over its own stop time.

Run times of `auto` stand beside those of the methods that it chooses from, and run times of alfmu beside those of
SciPy's integrators at equal error. Writes `tolerances.md`, a CSV file for each of its tables and `tolerances.png` into
one folder. `alfmu report` runs the same mechanisms in every other way, over shorter times.
"""

from __future__ import annotations

import os

# One thread for everyone; BLAS reads these when NumPy is loaded.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from _report import Heard, Target, judged, parser, written
from matplotlib.figure import Figure
from tqdm import tqdm

import alfmu
from alfmu.catalogue.registry import mechanisms, options
from alfmu.method.stepping import EXPLICIT8, RADAU9
from alfmu.runtime.build import compiler
from alfmu.simulation import prepared, with_defaults
from alfmu.studies import reference, tables
from alfmu.studies.cases import POSITION, Case, Judge, exactness, restarting, run, scene
from alfmu.studies.report import HELD
from alfmu.studies.rivals import SCIPY, Rival
from alfmu.studies.tables import Chapter, Row

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "matplotlib")

METHODS = ("explicit", "stiff")
"""`auto` chooses from them."""

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

REPEATS = 5
"""Runs at that tolerance, of which the median counts; fewer of long ones."""

FASTER = 20.0
"""Run time of each of SciPy's integrators over alfmu's at equal error that is wanted at least, compiled."""


@dataclass(frozen=True)
class Race:
    """A motion that SciPy's integrators can follow: they leave the branch at a singular position."""

    method: str
    horizon: float
    """Simulated time [s]."""
    start: Mapping[str, float]
    tolerances: Sequence[float] = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)


RACES = {
    "slider_crank": Race("explicit", 2.0, {"start.angle": np.pi / 4, "start.angular_velocity": 0.0}),
    "five_bar": Race("explicit", 2.0, {"start.angle": -0.7}),
    "flyball_governor": Race("stiff", 1.0, {}, (1e-3, 1e-5, 1e-7)),
}


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
    races: Sequence[str] = tuple(RACES)


USUAL = Effort((1e-4, 1e-6, 1e-9, 1e-11), np.inf, 120.0, 100, 120.0)
QUICK = Effort((1e-6, 1e-9), 1.0, 10.0, 20, 20.0, ("slider_crank",))

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
        "By the eigenvalues of small motions at the start. The ratio is the run time of `auto`, short steps and "
        f"changes of method included, over that of the better method at a tolerance of `{COMPARED:g}`.",
        {"Choices": ("mechanism", "chosen", "ratio", "verdict", "reason")},
    ),
    "races": Chapter(
        "## Beside SciPy on (9)",
        "The ratio is the run time of each of SciPy's runs over that of alfmu at the same error, interpolated between "
        "its runs; where all of them are more exact, over the fastest. SciPy calls functions of Python in each "
        "evaluation, which is most of the ratio; (9) is solved by least squares there, constraints may drift, and "
        "Jacobians are differences.",
        {"Runs": ("mechanism", "code", "method", "tolerance", POSITION, "median [s]", "ratio", "note")},
    ),
    "targets": Chapter(
        "## Targets",
        "The least ratio of each method of SciPy. Not measured is what was left out or not finished.",
        {"Target against measured": ("study", "row", "number", "target", "measured", "verdict")},
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
    start: Mapping[str, float] | None = None,
    rivals: Sequence[Rival] = (),
) -> list[Row]:
    """Runs of a mechanism with some of its options, by every method and tolerance and by other codes, judged."""
    equations = with_defaults(alfmu.derive(alfmu.load(name, **(chosen or {}))), start or {})
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
    for method in methods or (*METHODS, "auto"):
        try:
            unit = alfmu.Instance(scene(equations, method, kernel))
        except alfmu.InputError as error:
            rows.append({"mechanism": name, "method": method, "note": str(error), "verdict": "not judged"})
            continue
        restart = restarting(unit)
        before: tuple[float, int] | None = None
        for tolerance in effort.tolerances:
            if method == "auto" and tolerance != COMPARED:
                continue
            repeats = REPEATS if rivals or tolerance == COMPARED else 1
            with Heard() as heard:
                found = run(unit, restart, Case(exactness(method, tolerance), times, effort.limit, repeats))
            error = judge.errors(found)[POSITION]
            cost = found.cost()
            over = error / tolerance if found.complete else None
            told = [text for text in heard.said if SAID in text]
            verdict = "not judged" if over is None else "held" if over <= HELD else "told" if told else "not held"
            row = {"mechanism": name, "method": method, "tolerance": tolerance, POSITION: error}
            row |= {"error over tolerance": over, "change of reference": max(changes, default=None)}
            row |= {x: cost[x] for x in ("simulated [s]", "steps", "evaluations", "median [s]")} | {"verdict": verdict}
            if found.complete and before and method in ORDERS:
                row["trend"] = cost["evaluations"] / before[1] / (before[0] / tolerance) ** (1 / ORDERS[method])
            before = (tolerance, cost["evaluations"]) if found.complete else None
            rows.append(row | {"refused": found.counters.refused if found.counters else None})
            rows[-1]["note"] = cost["note"] or "; ".join(told)
    for rival in rivals:
        for tolerance in effort.tolerances:
            found = rival.run(plain, tolerance, Case({}, times, effort.limit))
            row = {"mechanism": name, "code": rival.name, "method": rival.method, "tolerance": tolerance}
            rows.append(row | {POSITION: judge.errors(found)[POSITION]} | found.cost())
    return rows


def raced(effort: Effort) -> list[Row]:
    """Runs of alfmu and of SciPy on the motions that both can follow, with the ratios of run times at equal error."""
    kernel, rows = "compiled" if compiler() else "vm", []
    for name in effort.races:
        race = RACES[name]
        asked = replace(effort, tolerances=race.tolerances, horizon=race.horizon, parts=100)
        some = measured(name, asked, kernel, (race.method,), start=race.start, rivals=SCIPY)
        own = [(row[POSITION], row["median [s]"]) for row in some if "code" not in row and row.get("median [s]")]
        for row in some:
            if "code" not in row:
                row["code"] = f"alfmu, {kernel}"
            elif row["median [s]"] and (spent := time_at(row[POSITION], own)):
                row["ratio"] = row["median [s]"] / spent
        rows += some
    return rows


def time_at(error: float, runs: Sequence[tuple[float, float]]) -> float | None:
    """Run time at an error, of runs with their errors and times, interpolated in logarithms and never beyond them."""
    reached = sorted(runs)
    if not reached or error < reached[0][0]:
        return None
    cheap = [t for e, t in reached if e <= error]
    if error >= reached[-1][0]:
        return min(cheap)
    x, y = np.log([max(e, 1e-16) for e, _ in reached]), np.log([t for _, t in reached])
    return min(*cheap, float(np.exp(np.interp(np.log(max(error, 1e-16)), x, y))))


def targets(races: Sequence[Row]) -> list[Row]:
    """The least ratio of each method of SciPy on each motion against what is wanted."""
    least: list[Row] = []
    for name, rival in product(RACES, SCIPY):
        some = [r["ratio"] for r in races if (r["mechanism"], r["method"]) == (name, rival.method) and "ratio" in r]
        least.append({"mechanism": name, "method": rival.method, "least ratio": min(some, default=None)})
    column = "least ratio"
    wanted = (Target("races", {x: r[x] for x in ("mechanism", "method")}, column, FASTER, at_least=True) for r in least)
    return [judged(target, {"races": least}) for target in wanted]


def choice(name: str, rows: Sequence[Row], chosen: Mapping[str, str]) -> Row:
    """What `auto` chose on a mechanism, and its run time over that of the better method."""
    decided = prepared(with_defaults(alfmu.derive(alfmu.load(name, **chosen)), {"solver.method": "auto"}), "oracle")
    made = decided.decision
    name = " ".join([name, *chosen.values()])
    seconds = {r["method"]: r["median [s]"] for r in rows if r.get("tolerance") == COMPARED and r["median [s]"]}
    others = [seconds[x] for x in METHODS if x in seconds]
    ratio = seconds["auto"] / min(others) if others and "auto" in seconds else None
    verdict = "not judged" if ratio is None else "met" if ratio <= TWICE else "not met"
    return {"mechanism": name, "chosen": made.method, "ratio": ratio, "verdict": verdict, "reason": made.reason}


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


def save(folder: Path, results: Mapping[str, list[Row]]) -> None:
    """The CSV files."""
    for name, chapter in CHAPTERS.items():
        chapter.write(folder / f"{name}.csv", results[name])


def write(folder: Path, effort: Effort, names: Sequence[str], command: str) -> None:
    """Measure and write the results."""
    logging.getLogger("alfmu").addHandler(logging.NullHandler())
    where = tables.where(command, PACKAGES, {"wall time of a run, at most [s]": effort.limit})
    results: dict[str, list[Row]] = {name: [] for name in CHAPTERS}
    for name in tqdm(names, "tolerances", unit="mechanism"):
        for chosen in variants(name):
            rows = measured(name, effort, chosen=chosen)
            results["tolerances"] += rows
            results["auto"].append(choice(name, rows, chosen))
            save(folder, results)  # as they come, since a run of hours may be ended
    results["races"] = raced(effort)
    results["targets"] = targets(results["races"])
    save(folder, results)
    tables.write_csv(folder / "environment.csv", where)
    picture(results["tolerances"], effort.tolerances).savefig(folder / "tolerances.png", dpi=110)
    parts = ["# Tolerances", tables.shown("Where this was measured", "environment", ("what", "value"), where)]
    parts += [chapter.markdown(name, results[name]) for name, chapter in CHAPTERS.items()]
    (folder / "tolerances.md").write_text("\n\n".join([*parts, "![errors over tolerances](tolerances.png)\n"]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the command line asks for."""
    names = mechanisms()
    text = (
        "Measure whether runs hold their tolerance, on every mechanism over its own stop time, and compare run times."
    )
    chosen = parser("tolerances", names, text, "half an hour", "one second each").parse_args(arguments)

    def make(studies: list[str], command: str) -> None:
        write(chosen.output, QUICK if chosen.quick else USUAL, studies, command)

    return written(chosen, "tolerance_study.py", names, "tolerances.md", make)


if __name__ == "__main__":
    raise SystemExit(main())
