"""Error against run time: every formulation, method and way to run a mechanism, judged by a reference.

Beside them other codes, the study of Blajer (2002) where it is about the mechanism, and maps of stability. `report`
writes `report.md`, CSV files with every number in it, and pictures of each mechanism into one folder.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from ..equations.specialisation import specialised
from ..files import scratch
from ..fmi.drive import Fmu
from ..fmi.export import export
from ..model.errors import AlfmuError, InputError
from ..model.mechanism import Mechanism
from ..model.settings import FORMULATIONS, Settings
from ..runtime import Instance
from ..runtime.build import compiler
from ..simulation import Unit, communication_points, instance, prepared
from . import cases, paper
from . import reference as exact
from . import stability as maps
from .cases import (
    ENERGY,
    PHI,
    PHI_DOT,
    POSITION,
    QUANTITIES,
    REACTION,
    STEP,
    TOLERANCE,
    Begun,
    Case,
    Judge,
    Progress,
    Run,
    begin,
    control,
    exactness,
    methods,
    restarting,
    run,
    scene,
)
from .charts import save, scatter, slope
from .cost import cost, left_out
from .rivals import RIVALS, Rival
from .tables import Row, paragraph, shown, write_csv

__all__ = ["Effort", "report"]

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "fmpy", "pythonfmu", "matplotlib", "pin", "exudyn", "mujoco")

TIME = "median [s]"

LEVELS = (1e-3, 1e-6, 1e-9)
"""Position errors [m, rad] at which run times are compared."""

LOST = 0.1
"""Position error [m, rad] of a run that has lost the motion; it says nothing about an order."""

ABOVE = 10.0
"""Errors count towards an order as far as they are so many times that of the reference."""

LATE = "the time for this mechanism was used up"

CLEARLY = 2.0
"""Errors and times that differ by less than this factor are called equal."""

ROUNDOFF = 1e-11
"""Errors up to it are called equal."""

POINTS = 40
"""About how many times a run is read: few, as methods that control their error have to land on each."""

HELD = 10.0
"""Error of a run over its tolerance up to which the tolerance counts as held."""

MAPPED = 0.15
"""Part of the time of a mechanism that is kept for its maps of stability."""

OWN = Settings.formulation


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    total: float
    """Wall time for all mechanisms together [s]."""
    horizon: float
    """Longest simulated time [s]; a mechanism's own stop time where that is shorter."""
    steps: int
    """Most of the mechanism's own steps in it."""
    factors: tuple[float, ...]
    """Steps over the mechanism's own, the longest first."""
    tolerances: tuple[float, ...]
    """Of methods with tolerances, the largest first."""
    limit: float
    """Wall time of one run [s]."""
    repeats: int
    """Most runs of a case; fewer where they are long."""
    reference: exact.Effort
    paper: paper.Effort
    stability: maps.Effort
    """Its `total` does not count here."""


USUAL = Effort(
    780.0,
    3.0,
    20000,
    (4, 2, 1, 1 / 2, 1 / 4, 1 / 8),
    (1e-3, 1e-6, 1e-9, 1e-11),
    2.0,
    9,
    exact.Effort(parts=100, seconds=10.0),
    paper.SHORT,
    maps.QUICK,
)
QUICK = Effort(
    210.0,
    1.0,
    2000,
    (2, 1, 1 / 2),
    (1e-3, 1e-6),
    0.5,
    5,
    exact.Effort(parts=50, seconds=6.0),
    paper.QUICK,
    replace(maps.QUICK, horizon=0.5, limit=0.01),
)


@dataclass(frozen=True)
class Setting:
    """A line in the pictures: what runs, and the steps [s] or tolerances with which it runs."""

    code: str
    formulation: str
    method: str
    way: str
    control: str
    values: tuple[float, ...]
    default: float
    """The value whose errors stand in the report."""
    run: Callable[[float, Case], Run]

    def row(self, value: float) -> Row:
        """What tells a run of it from others."""
        names = ("code", "formulation", "method", "way", "control")
        return {name: getattr(self, name) for name in names} | {"value": value}

    def growth(self, before: float, value: float) -> float:
        """How much longer a run will take than the one before: guessed for tolerances with an order of 4."""
        return (before / value) ** (1.0 if self.control == STEP else 0.25)


# One mechanism -----------------------------------------------------------------------------------------------------


class Study(cases.Study):
    """Everything that is measured of one mechanism, as rows of CSV files."""

    def __init__(self, name: str | Path | Mechanism, effort: Effort):
        super().__init__(name, effort)
        self.files: dict[str, list[Row]] = {name: [] for name in FILES}
        self.chapters: list[paper.Chapter] = []
        """Of the paper."""
        self.maps = maps.Study(self.mechanism, effort.stability)
        self._before: dict[Setting, tuple[float, float]] = {}
        self._traced: dict[str, Equations] = {}

    def measure(self, deadline: float, progress: Progress) -> None:
        """Run all cases, as far as time allows until `deadline`."""
        logging.getLogger("alfmu").addHandler(logging.NullHandler())  # what an FMU says of a failure is in its row
        self.equations = prepared(self.derived, "oracle")
        mapped = deadline - MAPPED * (deadline - time.perf_counter())
        self._paper(mapped)
        self.times = self._points()
        self._judge(float(self.times[-1]))
        self._scenes()
        with ExitStack() as self._stack, scratch() as folder:
            self._ways, self._units = self._makers(folder), {}
            for setting, value in progress([case for group in self._settings() for case in _passes(group)]):
                self._run(setting, value, mapped)
        self._summarise()
        self._tolerances()
        self._compare()
        self.maps.measure(deadline, progress)

    def _points(self) -> NDArray:
        """Times at which all runs are read: as far apart as the longest step, or a multiple of it."""
        e, longest = self.equations, max(self.effort.factors) * self.equations.step_size
        horizon = min(e.stop_time, self.effort.horizon, self.effort.steps * e.step_size)
        apart = max(1, round(horizon / (POINTS * longest))) * longest
        return communication_points(e.name, max(1, int(horizon / apart * (1 + 1e-12))) * apart, apart)

    def _paper(self, deadline: float) -> None:
        """The chapters of the paper's study that are about this mechanism as it comes."""
        for name, (mechanism, chapter) in paper.STUDIES.items():
            if mechanism != self.mechanism.name:
                continue
            try:
                if time.perf_counter() > deadline:
                    raise InputError(LATE)
                self.chapters.append(chapter(self.effort.paper))
            except InputError as error:
                self._keep("skipped", {"code": "the paper's study", "method": name, "reason": str(error)})

    def _keep(self, file: str, row: Row) -> None:
        self.files[file].append({"mechanism": self.name} | row)

    def _judge(self, horizon: float) -> None:
        """The reference, and its error."""
        instance = Instance(self.equations)
        instance.initialize()
        self.mobility = instance.mobility()
        found = exact.reference(instance, horizon, self.effort.reference)
        known = None if isinstance(found, str) else found
        self.judge = Judge(self.equations, known)
        self.floors: dict[str, float | None] = dict.fromkeys(QUANTITIES)
        if known is None:
            self._keep("reference", {"horizon [s]": horizon, "note": found})
            return
        motion, readable = known.motion, known.readable(self.times)
        about = {
            "reduced by": motion.way.name,
            "integrator": motion.method,
            "tolerance": motion.tolerance,
            "horizon [s]": horizon,
            "known until [s]": known.until,
            "energy drift [J]": float(np.ptp(known.energies(self.times))) if self.judge.conserves else None,
            "points": len(self.times),
            "points for reactions": int(readable.sum()),
        }
        compared = self.judge.errors_of_reference(self.times)
        for row in compared or [{"compared with": "nothing"}]:
            self._keep("reference", about | row)
        self.floors |= {
            x: max((r[x] for r in compared if r[x] is not None), default=None) for x in (POSITION, REACTION)
        }

    def _scenes(self) -> None:
        """What scenes leave out, and the operations that this saves."""
        everything = self.derived
        motion = [v.name for v in everything.outputs if not v.instant]
        scenes = {
            "everything": everything,
            "motion alone": specialised(everything, motion, None),
            "motion alone, parameters frozen": specialised(everything, motion, ["all"]),
        }
        for name, each in scenes.items():
            now = cost(prepared(each))
            self._keep("scenes", {"scene": name, "left out": "", "step": now.step, "outputs": now.outputs})
            for what, back in left_out(everything, each, self.mobility):
                saved = {"step": back.step - now.step, "outputs": back.outputs - now.outputs} if back else {}
                self._keep("scenes", {"scene": name, "left out": what} | saved)

    def _makers(self, folder: Path) -> dict[str, Callable[[str], Any]]:
        """Every way to run that there is: what makes a unit of it that carries a method."""
        kernels = ["compiled"] * bool(compiler()) + ["vm", "oracle"]
        makers: dict[str, Callable[[str], Any]] = {kernel: partial(self._instance, kernel) for kernel in kernels}
        return {**makers, f"FMU ({kernels[0]})": partial(self._fmu, folder, kernels[0])}

    def _instance(self, kernel: str, method: str) -> Instance:
        if method not in self._traced:
            self._traced[method] = scene(self.derived, method, "vm")
        return instance(self._traced[method], kernel)

    def _fmu(self, folder: Path, kernel: str, method: str) -> Fmu:
        path, given = folder / f"{self.name}_{method}.fmu", {"solver.method": method}
        return Fmu(export(self.mechanism, path, kernel=kernel, parameters=given))

    def _unit(self, way: str, method: str) -> _Open:
        """A unit of a way to run that carries a method, made when it is first wanted."""
        if (way, method) not in self._units:
            self._units[way, method] = self._stack.enter_context(closing(_Open(self._ways[way](method))))
        return self._units[way, method]

    def _settings(self) -> list[list[Setting]]:
        """All settings in groups, those first whose rows are needed most."""
        (first, *more), others = methods(), [name for name in FORMULATIONS if name != OWN]
        fastest, slower = list(self._ways)[:1], list(self._ways)[1:]
        # What `auto` chooses is there under its own name; the oracle integrates by the first method alone.
        told, again = [m for m in more if m != "auto"], [way for way in self._ways if way != "oracle"]
        pairs = [
            [(OWN, m, way) for m in (first, *told) for way in fastest],
            [(OWN, first, way) for way in slower],
            [(f, first, "oracle") for f in others],
            [(OWN, m, way) for way in reversed(slower) if way in again for m in told],
            [(f, m, way) for f in others for m in more for way in fastest],
            [*((OWN, "auto", way) for way in again), *((f, first, way) for f in others for way in again)],
        ]
        found = [[self._setting(*each) for each in group] for group in pairs]
        found[0] += filter(None, map(self._rival, RIVALS))
        return found

    def _setting(self, formulation: str, method: str, way: str) -> Setting:
        e, stepped = self.equations, control(method) == STEP
        values = [k * e.step_size for k in self.effort.factors] if stepped else self.effort.tolerances

        def once(value: float, case: Case) -> Run:
            opened = self._unit(way, method)
            case = replace(case, values={"solver.formulation": formulation} | exactness(method, value))
            if not opened.warm:  # What is made when it is first wanted has no part in the time.
                run(opened.unit, opened.restart, replace(case, most=1))
                opened.warm = True
            return run(opened.unit, opened.restart, case)

        default = e.step_size if stepped else _middle(values)
        return Setting("alfmu", formulation, method, way, control(method), tuple(values), default, once)

    def _rival(self, rival: Rival) -> Setting | None:
        """Another code, None where it does not know the mechanism; as many values as alfmu gets."""
        values = tuple(rival.values(self.name))
        if rival.control == TOLERANCE:
            values = tuple(x for x in values if x >= min(self.effort.tolerances))
        values = values[: len(self.effort.factors)]
        if not values:
            return None

        def once(value: float, case: Case) -> Run:
            if rival.missing:
                raise InputError(rival.missing)
            return rival.run(self.equations, value, case)

        return Setting(rival.name, "dae", rival.method, "Python", rival.control, values, _middle(values), once)

    def _run(self, setting: Setting, value: float, deadline: float) -> None:
        """A run of a setting; what would take too long is listed with its estimate."""
        before = self._before.get(setting)
        estimate = before[1] * setting.growth(before[0], value) if before else None
        late = time.perf_counter() > deadline
        if late or (estimate is not None and estimate > self.effort.limit):
            reason = LATE if late else "it would take too long"
            self._keep("skipped", setting.row(value) | {"estimate [s]": estimate, "reason": reason})
            return
        try:
            found = setting.run(value, Case({}, self.times, self.effort.limit, self.effort.repeats))
        except AlfmuError as error:
            self._keep("skipped", setting.row(value) | {"estimate [s]": estimate, "reason": str(error)})
            return
        if not found.failure:
            self._before[setting] = value, min(found.seconds)
        about = setting.row(value) | {"default": int(value == setting.default)}
        self._keep("errors", about | self.judge.errors(found) | found.cost())

    def _summarise(self) -> None:
        """The row at the default step or tolerance of each setting, with its order and its slope over run time."""
        lines: dict[tuple, list[Row]] = {}
        for row in self.files["errors"]:
            lines.setdefault(_line(row), []).append(row)
        for rows in lines.values():
            fit = [r for r in rows if r[TIME] is not None and self._tells(r[POSITION])]
            stepped = [r for r in fit if r["control"] == STEP]
            order = slope([r["value"] for r in stepped], [r[POSITION] for r in stepped]) if stepped else None
            told = [r[TIME] for r in fit]
            spread = bool(fit) and max(told) > CLEARLY * min(told)
            falls = slope(told, [r[POSITION] for r in fit]) if spread else None
            for row in rows:
                if row["default"]:
                    shown_row = {k: x for k, x in row.items() if k not in ("mechanism", "default")}
                    self._keep("settings", shown_row | {"order": order, "slope over run time": falls})

    def _tolerances(self) -> None:
        """Errors over the tolerances that were asked for."""
        for row in self.files["errors"]:
            if row["code"] == "alfmu" and row["formulation"] == OWN and row["control"] == TOLERANCE:
                told = {"method": row["method"], "way": row["way"], TOLERANCE: row["value"], POSITION: row[POSITION]}
                over = row[POSITION] / row["value"] if row[TIME] is not None and row[POSITION] is not None else None
                verdict = "not judged" if over is None else "held" if over <= HELD else "not held"
                told |= {"error over tolerance": over, "steps": row["steps"], "within ten times": verdict}
                self._keep("tolerances", told)

    def _tells(self, error: float | None) -> bool:
        """Whether an error says something about an order."""
        return error is not None and max(ABOVE * (self.floors[POSITION] or 0.0), ROUNDOFF) < error < LOST

    # Comparisons -------------------------------------------------------------------------------------------------

    def _compare(self) -> None:
        """alfmu as it comes against all else: run times at equal error, errors at equal step; also where it loses."""
        rows = [r for r in self.files["errors"] if r[TIME] is not None]
        own = [r for r in rows if (r["code"], r["formulation"]) == ("alfmu", OWN)]
        for level in LEVELS:
            mine = _fastest(own, level)
            for code in dict.fromkeys(r["code"] for r in rows if r["code"] != "alfmu"):
                what = {"what": "run time to a position error of", "level or step": level, "other": code}
                self._versus(what, TIME, mine, _fastest([r for r in rows if r["code"] == code], level))
        for theirs in rows:
            if theirs["code"] == "alfmu" and theirs["formulation"] != OWN and theirs["default"]:
                for mine in own:
                    if _same(mine, theirs, ("method", "way", "value")):
                        for quantity in (*QUANTITIES, TIME):
                            what = "run time at equal step" if quantity == TIME else f"{quantity} at equal step"
                            self._versus({"what": what, "level or step": theirs["value"]}, quantity, mine, theirs)

    def _versus(self, about: Row, quantity: str, mine: Row | None, theirs: Row | None) -> None:
        a, b = (None if row is None else row[quantity] for row in (mine, theirs))
        row = about | {"alfmu": _named(mine), "its value": a, "other": _named(theirs) or about.get("other")}
        row["other's value"] = b
        self._keep("comparisons", row | {"ratio": b / a if a and b else None, "result": _verdict(quantity, a, b)})


@dataclass
class _Open:
    """A unit that can be run again and again."""

    unit: Unit
    warm: bool = False

    def __post_init__(self) -> None:
        self.restart = restarting(self.unit)

    def close(self) -> None:
        if hasattr(self.unit, "close"):
            self.unit.close()


def _passes(settings: Sequence[Setting]) -> list[tuple[Setting, float]]:
    """All settings with the largest step or tolerance each, then with the next one: nothing is left without a run."""
    most = max((len(setting.values) for setting in settings), default=0)
    return [(setting, setting.values[i]) for i in range(most) for setting in settings if i < len(setting.values)]


def _middle(values: Sequence[float]) -> float:
    return values[(len(values) - 1) // 2]


def _line(row: Row) -> tuple:
    return tuple(row[name] for name in ("code", "formulation", "method", "way"))


def _named(row: Row | None) -> str | None:
    return None if row is None else ", ".join(dict.fromkeys(map(str, _line(row))))


def _kind(row: Row) -> str:
    """The formulation of alfmu, or another code and its method."""
    return row["formulation"] if row["code"] == "alfmu" else f"{row['code']}, {row['method']}"


def _same(a: Row, b: Row, names: Sequence[str]) -> bool:
    return all(a[name] == b[name] for name in names)


def _fastest(rows: Sequence[Row], level: float) -> Row | None:
    """The run that takes least among those with a position error up to a level."""
    reached = [r for r in rows if r[POSITION] is not None and r[POSITION] <= level]
    return min(reached, key=lambda r: r[TIME], default=None)


def _verdict(quantity: str, mine: float | None, theirs: float | None) -> str:
    if mine is None or theirs is None:
        return "not compared" if mine is theirs is None else "lost: not reached" if mine is None else "alfmu alone"
    level = 0.0 if quantity == TIME else ROUNDOFF
    if not mine > max(CLEARLY * theirs, level):
        return "alfmu better" if theirs > max(CLEARLY * mine, level) else "equal"
    return "lost: slower" if quantity == TIME else "lost: less exact"


# Report ------------------------------------------------------------------------------------------------------------

FILES = ("reference", "errors", "settings", "tolerances", "comparisons", "scenes", "skipped")

SHOWN = {
    "reference": (
        "The reference, and what it changes by where it is computed in other ways",
        (
            *("reduced by", "integrator", "tolerance", "known until [s]", "points", "points for reactions"),
            *("energy drift [J]", "compared with", POSITION, REACTION),
        ),
    ),
    "settings": (
        "At the default step, or a middle tolerance",
        (
            *("code", "formulation", "method", "way", "control", "value", *QUANTITIES, TIME, "repeats"),
            *("order", "slope over run time", "note"),
        ),
    ),
    "tolerances": (
        "Errors over tolerances",
        ("method", "way", TOLERANCE, POSITION, "error over tolerance", "steps", "within ten times"),
    ),
    "comparisons": (
        "Run times at equal error, and lost comparisons",
        ("what", "level or step", "alfmu", "its value", "other", "other's value", "ratio", "result"),
    ),
    "skipped": (
        "Skipped",
        ("code", "formulation", "method", "way", "control", "value", "estimate [s]", "reason"),
    ),
    "scenes": (
        "Operations of scenes, and what is saved by what they leave out",
        ("scene", "left out", "step", "outputs"),
    ),
}
"""Tables of a mechanism: title and columns by CSV file."""

METHOD = f"""
Every run is judged by a motion from an unrelated method: the equations of motion reduced to independent coordinates,
with the constraints closed to round-off, integrated with tolerances near round-off (`studies.reference`). Its error is
the change to other ways to compute it: the other reduction, a larger tolerance. {POSITION} and {REACTION} are the
largest differences of outputs with these units at the points of the run; reactions are compared where they are unique
and the position is not nearly singular. {PHI}, {PHI_DOT} and {ENERGY} are what the run itself leaves at these points.
Run time is that of all steps and of reading all outputs at each point, without set-up; the median of the repeats.
"""

LIMITS = """
SciPy integrates the DAE (9) as it stands, in Python, with the same compiled evaluation of the equations as the oracle,
and is not told of singular positions. Formulations other than the default take the default integrator alone, and are
timed by the oracle first, which has no other. All runs share one machine and one process, in the order of `errors.csv`;
small ratios of times are not to be trusted. Where the reference ends before the run, positions and reactions are judged
up to there.
Pinocchio, Exudyn and MuJoCo run mechanisms that were built for them by hand (`five_bar`, `slider_crank`), tuned to them
with exact motions at hand; the angle of the first link and the reactions are what is judged. Pinocchio is stepped in
Python. Longer runs, in rounds of random order, are those of `scripts/peers.py`; the study of the paper in full is that
of `scripts/paper_study.py`, maps with all their cells are those of `alfmu stability`.
"""


def report(
    names: Sequence[str | Path | Mechanism],
    folder: str | Path,
    quick: bool = False,
    progress: Callable[[str], Progress] = lambda what: iter,
    effort: Effort | None = None,
) -> Path:
    """Measure mechanisms and write the report into a folder; returns its path.

    Raises AlfmuError where a name is unknown, a mechanism cannot start or matplotlib is missing, before any run.
    """
    effort = effort or (QUICK if quick else USUAL)
    bounds = {
        "longest simulated time [s]": effort.horizon,
        "wall time of a run, at most [s]": effort.limit,
        "repeats of a run, at most": effort.repeats,
        "wall time of a cell of a map [s]": effort.stability.limit,
    }
    begun = begin("report", Study, names, folder, effort, quick, bounds, PACKAGES)
    for study in begun.measured(progress):
        _pictures(study, begun.folder)
    for file in FILES:
        write_csv(begun.folder / f"{file}.csv", begun.rows(lambda study, file=file: study.files[file]))
    maps.write(begun.folder, [study.maps for study in begun.studies])
    return begun.write("report.md", _markdown(begun))


def _markdown(begun: Begun[Study]) -> str:
    where = shown("Where this was measured", "environment", ("what", "value"), begun.environment)
    parts = ["# Error against run time", where, paragraph(METHOD)]
    for study in begun.studies:
        parts += _chapter(study)
    if any(study.chapters for study in begun.studies):
        about = paper.settings(begun.studies[0].effort.paper)
        write_csv(begun.folder / f"{about.name}.csv", about.rows)
        parts += ["## The paper's study", about.markdown(), paper.LIMITS]
    parts += ["## Maps of stability", *maps.explained()]
    return "\n\n".join([*parts, "## Where the comparison stops being fair", paragraph(LIMITS)]) + "\n"


def _chapter(study: Study) -> Iterator[str]:
    """One mechanism."""
    yield f"## {study.name}"
    yield study.mechanism.description + "."
    for file, (title, columns) in SHOWN.items():
        rows = study.files[file]
        if file == "comparisons":
            rows = [r for r in rows if r["what"].startswith("run time to") or r["result"].startswith("lost")]
        if file == "reference" and "note" in rows[0]:
            columns = ("horizon [s]", "note")
        if rows:
            yield shown(title, file, columns, rows)
        if file == "reference":
            yield f"![{OWN}: errors against run time]({study.name}.png)"
            yield f"![formulations: errors against run time]({study.name}_formulations.png)"
            yield "All runs: `errors.csv`."
    for chapter in study.chapters:
        yield from chapter.markdown("###")
    yield "### Stability"
    yield from maps.chapter(study.maps)


def _pictures(study: Study, folder: Path) -> None:
    """The default formulation in every way, and every formulation in the fastest way; those of the paper, and maps."""
    for chapter in study.chapters:
        chapter.write(folder)
    maps.draw(study.maps, folder)
    rows = study.files["errors"]
    fitted = {_line(r): r for r in study.files["settings"]}
    first = next((r["way"] for r in rows), "")

    def label(row: Row, *names: str) -> str:
        fit = fitted.get(_line(row), {})
        values = [("order", fit.get("order")), ("slope", fit.get("slope over run time"))]
        told = ", ".join(f"{name} {x:.1f}" for name, x in values if x is not None)
        return ", ".join(str(row[name]) for name in names) + (f" ({told})" if told else "")

    own = [r for r in rows if r["formulation"] == OWN or r["code"] != "alfmu"]
    here = [r for r in rows if r["way"] == first or r["code"] != "alfmu"]
    quantities = (POSITION, REACTION, PHI, ENERGY)
    for name, chosen, colour, told in (
        (study.name, own, lambda r: r["way"] if r["code"] == "alfmu" else r["method"], ("code", "method", "way")),
        (f"{study.name}_formulations", here, _kind, ("code", "formulation", "method")),
    ):
        title = f"{study.name}: {OWN}" if chosen is own else f"{study.name}: formulations, {first}"
        figure = scatter(title, chosen, quantities, TIME, lambda r, names=told: label(r, *names), colour, study.floors)
        save(figure, folder / f"{name}.png", 110)
