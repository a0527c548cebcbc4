"""Measure error against run time of the methods with error control, beside SciPy's integrators on the index-1 DAE (9).

Writes `methods.md`, a CSV file for each of its chapters and a picture into one folder. Errors are judged by motions in
minimal coordinates; run times of one machine mean little, so what counts are their ratios at equal error.
"""

from __future__ import annotations

import os

# One thread for everyone; BLAS reads these when NumPy is loaded.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1")

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from _report import Target, judged
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tqdm import tqdm

import alfmu
from alfmu.catalogue.registry import mechanisms
from alfmu.simulation import prepared, with_defaults
from alfmu.studies.cases import Case, exactness
from alfmu.studies.rivals import SCIPY
from alfmu.studies.tables import Chapter, Row, environment, rounded

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles import flyball
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank

KERNELS = ("vm", "compiled")


@dataclass(frozen=True)
class Scene:
    """A mechanism whose motion is known by an unrelated method."""

    output: str
    """What is compared [m, rad]."""
    times: NDArray
    """Points where it is, from the start on [s]."""
    exact: Callable[[NDArray], NDArray]
    methods: Mapping[str, Sequence[float]]
    """Methods, and their tolerances or steps [s]."""
    start: Mapping[str, float] = field(default_factory=dict)
    rivals: Sequence[float] = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
    """Tolerances of SciPy's methods."""


SCENES = {
    "flyball_governor": Scene(
        "slider.position",
        flyball.TIMES[:3],
        lambda times: flyball.table()[: len(times), 1],
        {"stiff": (1e-3, 1e-5, 1e-7, 1e-9)},
        rivals=(1e-4, 1e-7),
    ),
    "five_bar": Scene(
        "link1.angle",
        np.linspace(0.0, 2.0, 9),
        lambda times: Parallelogram().swing(-0.7, 2.0, times)[:, 0],
        {"explicit": Scene.rivals, "order8": (0.2, 0.1, 0.05, 0.02)},
        {"start.angle": -0.7},
    ),
    "slider_crank": Scene(
        "crank.angle",
        np.linspace(0.0, 2.0, 9),
        lambda times: SliderCrank().motion(np.pi / 4, 0.0, times)[:, 0],
        {"explicit": Scene.rivals, "order8": (0.1, 0.05, 0.02, 0.01)},
        {"start.angle": np.pi / 4, "start.angular_velocity": 0.0},
    ),
}


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    repeats: int
    """Most repetitions of a run, of which the median counts."""
    limit: float
    """Wall time after which a run is stopped, and no further repetition is begun [s]."""
    scenes: Sequence[str]
    mechanisms: Sequence[str]
    """Of the study of `auto`."""


SMALL = ("particle_on_circle", "slider_crank", "four_bar")
QUICK = Effort(3, 20.0, ("slider_crank",), SMALL)
USUAL = Effort(5, 60.0, tuple(SCENES), tuple(mechanisms()))


# Runs -------------------------------------------------------------------------------------------------------------


Clock = Callable[[], float]


def runs(
    instance: alfmu.Instance,
    times: NDArray,
    effort: Effort,
    read: str | None = None,
    clock: Clock = time.perf_counter,
) -> tuple[float, NDArray]:
    """Median time [s] of a run of an initialised instance over communication points, and an output there.

    By the wall, as SciPy's runs are timed, or by another clock.
    """
    start, spent, found = instance.save(), [], np.zeros(len(times))
    while len(spent) < effort.repeats and sum(spent) < effort.limit / 10:
        instance.restore(start)
        begin = clock()
        for i, h in enumerate(np.diff(times)):
            instance.step(h)
            y = instance.read()
            if read:
                found[i + 1] = y[[v.name for v in instance.outputs].index(read)]
        spent.append(clock() - begin)
    return statistics.median(spent), found


def begun(equations: alfmu.Equations, values: Mapping[str, float | str]) -> alfmu.Instance:
    """An initialised instance."""
    instance = alfmu.Instance(equations)
    for name, value in values.items():
        instance.set(name, value)
    instance.initialize()
    return instance


def work_study(effort: Effort, kernels: Sequence[str]) -> list[Row]:
    """Rows of work.csv: every run with its error and its time."""
    rows: list[Row] = []
    for name in tqdm(effort.scenes, "work", unit="scene"):
        scene = SCENES[name]
        exact, derived = scene.exact(scene.times), alfmu.derive(alfmu.load(name))
        for method, kernel, value, instance in _cases(derived, scene, kernels):
            seconds, found = runs(instance, scene.times, effort, scene.output)
            error = float(np.abs(found - exact)[1:].max())
            counters = instance.counters
            row: Row = {"mechanism": name, "code": f"alfmu {kernel}", "method": method, "value": value}
            row |= {"error": error, "time [s]": seconds, "steps": counters.steps, "refused": counters.refused}
            rows.append(row)
        started, case = with_defaults(derived, scene.start), Case({}, scene.times, effort.limit)
        for rival in SCIPY:
            for tolerance in scene.rivals:
                run = rival.build(started, tolerance, case)()
                row = {"mechanism": name, "code": rival.name, "method": rival.method, "value": tolerance}
                if len(run.values) == len(exact):
                    found = run.values[:, run.names.index(scene.output)]
                    row |= {"error": float(np.abs(found - exact)[1:].max()), "time [s]": run.seconds[0]}
                rows.append(row | {"failure": run.failure or ("too slow" if run.cut else None)})
    return rows


def _cases(
    derived: alfmu.Equations, scene: Scene, kernels: Sequence[str]
) -> Iterator[tuple[str, str, float, alfmu.Instance]]:
    """Every way to run a scene, by method, kernel and tolerance or step."""
    for method, values in scene.methods.items():
        for kernel in kernels:
            equations = prepared(with_defaults(derived, {"solver.method": method}), kernel)
            for value in values:
                yield method, kernel, value, begun(equations, {**scene.start, **exactness(method, value)})


def equal_study(work: Sequence[Row]) -> list[Row]:
    """Rows of equal.csv: time of each of SciPy's runs over that of alfmu's at its error, for each way to run alfmu."""
    rows = []
    for run in work:
        if run["code"].startswith("alfmu") or run.get("error") is None:
            continue
        row: Row = {x: run[x] for x in ("mechanism", "method", "value", "error", "time [s]")}
        mine = [r for r in work if r["mechanism"] == run["mechanism"] and r["code"].startswith("alfmu")]
        for code in dict.fromkeys(r["code"] for r in mine):
            for method in dict.fromkeys(r["method"] for r in mine):
                some = [r for r in mine if (r["code"], r["method"]) == (code, method)]
                if spent := time_at(run["error"], some):
                    name, ratio = f"{run['code']} / {code}", run["time [s]"] / spent
                    row[name] = max(row.get(name, 0.0), ratio)
        rows.append(row)
    return rows


def time_at(error: float, rows: Sequence[Row]) -> float | None:
    """Time of runs that leave an error, interpolated in logarithms; of the fastest one where all are better."""
    reached = sorted((r["error"], r["time [s]"]) for r in rows)
    if not reached or error < reached[0][0]:
        return None
    cheap = [t for e, t in reached if e <= error]
    if error >= reached[-1][0]:
        return min(cheap)
    x, y = np.log([max(e, 1e-16) for e, _ in reached]), np.log([t for _, t in reached])
    return min(*cheap, float(np.exp(np.interp(np.log(max(error, 1e-16)), x, y))))


def least(equal: Sequence[Row]) -> list[Row]:
    """Rows of least.csv: the least of these ratios for each mechanism and method of SciPy."""
    rows = []
    for mechanism, method in dict.fromkeys((r["mechanism"], r["method"]) for r in equal):
        some = [r for r in equal if (r["mechanism"], r["method"]) == (mechanism, method)]
        names = list(dict.fromkeys(x for r in some for x in r if " / " in x))
        ratios = {x: min((r[x] for r in some if x in r), default=None) for x in names}
        rows.append({"mechanism": mechanism, "method": method, "runs": len(some), **ratios})
    return rows


def auto_study(effort: Effort, kernel: str) -> list[Row]:
    """Rows of auto.csv: run times of `auto`, `explicit` and `stiff` at equal tolerance, and what `auto` chose."""
    rows: list[Row] = []
    for name in tqdm(effort.mechanisms, "auto", unit="mechanism"):
        derived = alfmu.derive(alfmu.load(name))
        chosen = prepared(with_defaults(derived, {"solver.method": "auto"}), kernel).decision.method
        row: Row = {"mechanism": name, "auto": chosen}
        for method in ("auto", "explicit", "stiff"):
            try:
                equations = prepared(with_defaults(derived, {"solver.method": method}), kernel)
                times = np.linspace(0.0, min(derived.stop_time, AUTO_STOP), AUTO_POINTS)
                row[f"{method} [s]"], _ = runs(begun(equations, {}), times, effort, clock=time.process_time)
            except alfmu.AlfmuError as error:
                row[f"{method} failed"] = str(error)
        known = [row[x] for x in ("explicit [s]", "stiff [s]") if x in row]
        row[AUTO] = row["auto [s]"] / min(known) if known and "auto [s]" in row else None
        rows.append(row)
    worst = [row[AUTO] for row in rows if row[AUTO] is not None]
    return [*rows, {"mechanism": WORST, AUTO: max(worst, default=None)}]


AUTO_STOP, AUTO_POINTS = 2.0, 41
"""Longest run, and communication points, of the study of `auto` [s]."""

AUTO, WORST = "auto / better one", "worst"


# The report -------------------------------------------------------------------------------------------------------

RATIOS = tuple(f"SciPy on (9) / alfmu {kernel}" for kernel in KERNELS)
TARGETS = (
    *(
        Target("least", {"mechanism": name, "method": rival.method}, RATIOS[-1], 20, at_least=True)
        for name in SCENES
        for rival in SCIPY
    ),
    Target("auto", {"mechanism": WORST}, AUTO, 2),
)

CHAPTERS = {
    "environment": Chapter(
        "# Error against run time of the methods with error control",
        """Tables show columns of the CSV files named above them, rounded.""",
        {"Machine and versions": ("what", "value")},
    ),
    "targets": Chapter(
        "## Targets",
        """Judged by the numbers of this run alone. Not measured is what was left out, what SciPy did not finish, and
        where there is no C compiler.""",
        {"Target against measured": ("study", "row", "number", "target", "measured", "verdict")},
    ),
    "work": Chapter(
        "## Runs",
        """The error is the largest one of one coordinate at the communication points, against a motion in minimal
        coordinates. Times are medians of repeated runs, stepping and reading all outputs, of SciPy single ones. The
        value is the tolerance, or the step in s for order8.""",
        {"Runs": ("mechanism", "code", "method", "value", "error", "time [s]", "steps", "refused", "failure")},
    ),
    "equal": Chapter(
        "## Equal error",
        """Time of each of SciPy's runs over that of alfmu's best method at the same error, interpolated between runs;
        where all of alfmu's runs are more exact, over the fastest of them.""",
        {
            "Ratios": (
                "mechanism",
                "method",
                "value",
                "error",
                *RATIOS,
            )
        },
    ),
    "least": Chapter(
        "## The least of these ratios",
        "Over the tolerances of each method of SciPy.",
        {"Least ratios": ("mechanism", "method", "runs", *RATIOS)},
    ),
    "auto": Chapter(
        "## What auto chooses",
        f"""Run times at the default tolerance over at most {AUTO_STOP:g} s with {AUTO_POINTS - 1} communication steps,
        from each mechanism's default start, by the processor's time. `auto` is the whole of that method, short steps
        included; beside it stands which of the two it stands for.""",
        {
            "Run times": (
                *("mechanism", "auto", "auto [s]", "explicit [s]", "stiff [s]", AUTO),
                *(f"{method} failed" for method in ("auto", "explicit", "stiff")),
            )
        },
    ),
}
"""By the name of their CSV files."""

LIMITS = """\
## Where the comparison stops being fair

- SciPy's integrators call functions of Python for each evaluation of (9), which is what a user of SciPy pays; a large
  part of the ratios is that, and not the method.
- (9) is solved by least squares in each evaluation, which any rank of the constraints needs; constraints may drift.
- Implicit methods of SciPy take their Jacobians by differences.
- Runs of the five-bar stay between singular positions, as SciPy's would leave the branch there.
"""


def plot(work: Sequence[Row]) -> Figure:
    """Error against run time of each mechanism."""
    names = list(dict.fromkeys(row["mechanism"] for row in work))
    figure = Figure(figsize=(5.5 * len(names), 4.8), layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names))), names, strict=True):
        some = [row for row in work if row["mechanism"] == name and row.get("error") is not None]
        for code, method in dict.fromkeys((row["code"], row["method"]) for row in some):
            mine = [row for row in some if (row["code"], row["method"]) == (code, method)]
            style = "o-" if code.startswith("alfmu") else "x:"
            errors = [max(row["error"], 1e-16) for row in mine]
            axes.loglog([row["time [s]"] for row in mine], errors, style, label=f"{code}, {method}")
        axes.set(title=name, xlabel="run time [s]", ylabel="error [m, rad]")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    return figure


def measure(folder: Path, effort: Effort, command: str) -> None:
    """Run the studies and write their results."""
    begin = time.perf_counter()
    kernels, without = KERNELS, None
    try:
        prepared(alfmu.derive(alfmu.load("particle_on_circle")), "compiled")
    except alfmu.ExportError as error:
        kernels, without = KERNELS[:-1], str(error)
    packages = ("alfmu", "casadi", "numpy", "scipy")
    where = [{"what": what, "value": value} for what, value in environment(command, packages)]
    results: dict[str, Sequence[Row]] = {"environment": where, "targets": []}
    studies: dict[str, Callable[[], Sequence[Row]]] = {
        "work": lambda: work_study(effort, kernels),
        "equal": lambda: equal_study(results["work"]),
        "least": lambda: least(results["equal"]),
        "auto": lambda: auto_study(effort, kernels[-1]),
    }
    for name, study in studies.items():
        results[name] = study()
        CHAPTERS[name].write(folder / f"{name}.csv", results[name])
    where.append({"what": "it took", "value": f"{rounded(time.perf_counter() - begin)} s"})
    if without:
        where.append({"what": "compiled kernel", "value": f"missing: {without}"})
    results["targets"] = [judged(target, results) for target in TARGETS]
    for name in ("environment", "targets"):
        CHAPTERS[name].write(folder / f"{name}.csv", results[name])
    plot(results["work"]).savefig(folder / "methods.png", dpi=120)
    text = [CHAPTERS[name].markdown(name, rows) for name, rows in results.items()]
    report = "\n\n".join([*text, "![Error against run time](methods.png)", LIMITS])
    (folder / "methods.md").write_text(report, encoding="utf-8")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Measure error against run time of the methods with error control, beside SciPy on (9).",
        epilog="needs the extra alfmu[test]; takes some minutes, on a machine that should do nothing else; overwrites "
        "an earlier run in the same folder",
    )
    folder = Path("results/methods")
    parser.add_argument("-o", "--output", type=Path, default=folder, help="folder (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="one mechanism, few repeats: less than a minute")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the command line asks for."""
    chosen = parse(arguments)
    report = chosen.output / "methods.md"
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
        report.touch()
    except OSError as error:
        print(f"{report} cannot be written ({error.strerror}); give another folder with -o", file=sys.stderr)
        return 1
    measure(
        chosen.output,
        QUICK if chosen.quick else USUAL,
        f"python scripts/methods_benchmark.py{' --quick' * chosen.quick}",
    )
    print(report)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
