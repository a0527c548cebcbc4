"""Error against run time: every formulation, method and way to run a mechanism, judged by a reference.

The report adds other codes, the study of Blajer (2002) for its mechanisms, and maps of stability. `report` writes
`report.html`, a self-contained page; `report.md`, CSV files with every number, and pictures of each mechanism.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..api import export, simulate
from ..catalogue.registry import load
from ..equations import Equations
from ..equations.derivation import derive
from ..equations.specialisation import specialised
from ..fmi.drive import Fmu
from ..model.errors import AlfmuError, InputError
from ..model.files import scratch, write
from ..model.mechanism import Mechanism
from ..model.settings import FORMULATIONS, Settings
from ..runtime import Instance
from ..runtime.build import compiler
from ..simulation import communication_points, instance, prepared, with_defaults
from ..view.picture import animate
from ..view.plot import save
from . import cases, paper, peers
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
from .charts import scatter, slope
from .cost import cost, left_out
from .looks import LOOKS, integrator, line_of
from .page import Page, library
from .plots import against_time, convergence
from .rivals import COMPILED, PYTHON, RIVALS, SCIPY, TUNED, Rival
from .tables import Row, markdown, measured, number, paragraph, shown, write_csv

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "fmpy", "pythonfmu", "matplotlib", "pin", "exudyn", "mujoco")

TIME = "least [s]"
"""Name of the run time: the fastest of enough repetitions (`cases.Case.enough`), since disturbances only add time."""

LEVELS = (1e-3, 1e-6, 1e-9)
"""Position errors [m, rad] at which run times are compared."""

LOST = 0.1
"""Position error [m, rad] above which a run has lost the motion and does not count for an order."""

ABOVE = 10.0
"""Errors count for an order if they exceed this multiple of the error of the reference."""

LATE = "the time for this mechanism was used up"

FITTING, STRAIGHT = 3, 1.5
"""Least number of errors in the line fit of an order, and the factor within which each must lie from the line."""

FILMED, FRAME = 10.0, 0.02
"""Longest duration of a film, and interval of its frames [s]."""

CLEARLY = 2.0
"""Errors and times that differ by less than this factor are called equal."""

ROUNDOFF = 1e-11
"""Errors up to this value are called equal."""

POINTS = 40
"""Approximate number of output times of a run: few, as methods with error control must end a step at each."""

HELD = 10.0
"""Error of a run over its tolerance up to which it meets the tolerance."""

MAPPED = 0.15
"""Share of the time of a mechanism for its maps of stability."""

FOR_PAPER = 0.2
"""Share for the chapters of the paper's study, if some treat the mechanism."""

ABOUT = tuple(dict.fromkeys(name for name, _ in paper.STUDIES.values()))
"""Mechanisms that the paper's study is about."""

OWN = Settings.formulation


@dataclass(frozen=True)
class Effort:
    """Extent of a report."""

    total: float
    """Wall time for all mechanisms together [s]."""
    each: float
    """Time limit per mechanism [s]."""
    horizon: float
    """Longest simulated time [s]; a shorter stop time of the mechanism takes precedence."""
    steps: int
    """Largest number of the mechanism's own steps in the simulated time."""
    factors: tuple[float, ...]
    """Steps over the mechanism's own, the longest first."""
    tolerances: tuple[float, ...]
    """Tolerances of methods with error control, the largest first."""
    limit: float
    """Wall time limit of one run [s]."""
    repeats: int
    """Largest number of repetitions of a case; fewer if it is long."""
    reference: exact.Effort
    paper: paper.Effort
    stability: maps.Effort
    """Extent of the maps; its `total` is ignored."""
    wide: bool = True
    """Whether every integrator runs in every way; otherwise only the first and the default one do, and the others run
    by the interpreter, which needs no compiler."""
    parts: tuple[str, ...] = ("film", "runs", "scenes", "paper", "maps")
    """Parts of the report that are made."""
    methods: tuple[str, ...] = ()
    """Integrators that run by the fastest kernel, beside those of SciPy; if empty, all integrators run in every way."""
    points: int = POINTS
    ways: tuple[str, ...] = ()
    """Ways in which those integrators run, if available; if empty, the fastest way."""
    given: Mapping[str, float] = field(default_factory=dict)
    """Defaults in place of the mechanism's own; if given, its stop time is ignored, too."""


USUAL = Effort(
    780.0,
    240.0,
    3.0,
    20000,
    (4, 2, 1, 1 / 2, 1 / 4, 1 / 8),
    (1e-3, 1e-6, 1e-9, 1e-11),
    2.0,
    25,
    exact.Effort(parts=100, seconds=10.0),
    paper.SHORT,
    maps.QUICK,
)
QUICK = Effort(
    210.0,
    35.0,
    1.0,
    2000,
    (2, 1, 1 / 2),
    (1e-3, 1e-6),
    0.5,
    9,
    exact.Effort(parts=50, seconds=6.0),
    paper.QUICK,
    replace(maps.QUICK, horizon=0.5, limit=0.01),
    wide=False,
)
TOLERANCES = replace(
    USUAL,
    total=7200.0,
    each=1800.0,
    horizon=math.inf,
    steps=10**9,
    tolerances=(1e-4, 1e-6, 1e-9, 1e-11),
    limit=120.0,
    repeats=5,
    reference=exact.Effort(parts=100, seconds=120.0),
    parts=("runs",),
    methods=("explicit", "stiff", "auto"),
    points=10,  # So few that the error control decides on the steps.
)
PAPER = replace(USUAL, total=1800.0, each=900.0, paper=paper.USUAL, parts=("paper",))
PEERS = replace(
    TOLERANCES,
    horizon=20.0,
    factors=(1, 1 / 2, 1 / 3, 1 / 4, 1 / 8, 1 / 16, 1 / 32),
    tolerances=tuple(10.0**-k for k in range(5, 12)),
    limit=30.0,
    repeats=12,
    methods=("rk4", "order8", "auto"),
    points=1000,
    ways=tuple(f"{kernel}{form}" for kernel in ("compiled", "vm") for form in ("", ", joint", ", joint, lean")),
    given={"start.angle": 0.0, "start.angular_velocity": 2.0, "solver.step_size": 0.02},
)
PROFILES = {
    "usual": (USUAL, QUICK),
    "tolerances": (
        TOLERANCES,
        replace(TOLERANCES, each=60.0, horizon=1.0, limit=10.0, reference=exact.Effort(parts=20, seconds=20.0)),
    ),
    "paper": (PAPER, replace(PAPER, paper=paper.QUICK)),
    "peers": (PEERS, replace(PEERS, factors=PEERS.factors[:4], tolerances=PEERS.tolerances[:3], limit=3.0, repeats=3)),
}
"""Profiles of a report, with their quick forms: all of it; tolerances over whole runs; the complete study of the paper;
run times at equal error against codes tuned to a mechanism."""


@dataclass(frozen=True)
class Setting:
    """A line in the plots: the configuration to run, and its steps [s] or tolerances."""

    code: str
    formulation: str
    method: str
    way: str
    control: str
    values: tuple[float, ...]
    default: float
    """The step or tolerance whose errors are in the report."""
    run: Callable[[float, Case], Run]
    language: str
    """Programming language in which it runs."""

    def row(self, value: float) -> Row:
        """Return the columns that identify a run of this setting."""
        names = ("code", "formulation", "method", "way", "language", "control")
        return {name: getattr(self, name) for name in names} | {"value": value}

    def growth(self, before: float, value: float) -> float:
        """Return the expected ratio of its run times; an order of 4 is assumed for tolerances."""
        return (before / value) ** (1.0 if self.control == STEP else 0.25)


# One mechanism -----------------------------------------------------------------------------------------------------


class Study(cases.Study):
    """All measurements of one mechanism, as rows of CSV files."""

    def __init__(self, name: str | Path | Mechanism, effort: Effort):
        super().__init__(name, effort)
        if effort.given:
            self.derived = with_defaults(self.derived, effort.given)
        self.compared: Sequence[str] = ()
        if effort.ways:
            self.compared = peers.MACHINES[self.name].names
        self.files: dict[str, list[Row]] = {name: [] for name in FILES}
        self.chapters: list[paper.Chapter] = []
        """Chapters of the paper's study."""
        self.film = ""
        """Page with a film of the motion; empty if nothing can be drawn."""
        self.maps = maps.Study(self.mechanism, effort.stability)
        self._before: dict[Setting, tuple[float, float]] = {}
        self._traced: dict[str, Equations] = {}

    def measure(self, deadline: float, progress: Progress) -> None:
        """Run all cases until `deadline`."""
        logging.getLogger("alfmu").addHandler(logging.NullHandler())  # messages of a failing FMU are in its row
        self.equations = prepared(self.derived, "oracle")
        parts, left = self.effort.parts, deadline - time.perf_counter()
        mapped = deadline - MAPPED * left * ("maps" in parts)
        judged = mapped - FOR_PAPER * left * ("paper" in parts and self.mechanism.name in ABOUT)
        if "film" in parts:
            self._film()
        if "runs" in parts:
            self.times = self._points()
            self._judge(float(self.times[-1]))
            if "scenes" in parts:
                self._scenes()
            self._runs(judged, progress)
        if "paper" in parts:
            self._paper(mapped)
        if "maps" in parts:
            self.maps.measure(deadline, progress)

    def _runs(self, deadline: float, progress: Progress) -> None:
        """Run all settings until `deadline`, and compare them."""
        with ExitStack() as self._stack, scratch() as folder:
            self._ways = self._makers(folder)
            self._units: dict[tuple[str, str], _Open] = {}
            for setting, value in progress([case for group in self._settings() for case in _passes(group)]):
                self._run(setting, value, deadline)
        self._summarise()
        self._tolerances()
        self._compare()
        if self.effort.ways:
            self._reach()

    def _points(self) -> NDArray:
        """Return the output times of all runs: their interval is the longest step, or a multiple of it."""
        e, longest = self.equations, max(self.effort.factors) * self.equations.step_size
        stop = math.inf if self.effort.given else e.stop_time
        horizon = min(stop, self.effort.horizon, self.effort.steps * e.step_size)
        apart = max(1, round(horizon / (self.effort.points * longest))) * longest
        return communication_points(e.name, max(1, int(horizon / apart * (1 + 1e-12))) * apart, apart)

    def _paper(self, deadline: float) -> None:
        """Run the chapters of the paper's study on this mechanism with its defaults."""
        for name, (mechanism, chapter) in paper.STUDIES.items():
            if mechanism != self.mechanism.name:
                continue
            try:
                if time.perf_counter() > deadline:
                    raise InputError(LATE)
                self.chapters.append(chapter(self.effort.paper))
            except InputError as error:
                self._keep("skipped", {"code": "the paper's study", "method": name, "reason": str(error)})

    def _film(self) -> None:
        """Film the motion of the mechanism with its defaults."""
        length = FRAME * max(1, round(min(self.equations.stop_time, FILMED) / FRAME))
        try:
            with scratch() as folder:
                animate(self.mechanism, simulate(self.mechanism, length, FRAME), folder / "film.html")
                self.film = (folder / "film.html").read_text(encoding="utf-8")
        except AlfmuError as error:
            self._keep("skipped", {"code": "the film", "reason": str(error)})

    def _keep(self, file: str, row: Row) -> None:
        self.files[file].append({"mechanism": self.name, **row})

    def _judge(self, horizon: float) -> None:
        """Compute the reference, and its error."""
        instance = Instance(self.equations)
        instance.initialize()
        self.mobility = instance.mobility()
        found = exact.reference(instance, horizon, self.effort.reference)
        self.floors: dict[str, float | None] = dict.fromkeys(QUANTITIES)
        if isinstance(found, str):
            self.judge = Judge(self.equations, None)
            self._keep("reference", {"horizon [s]": horizon, "note": found})
            return
        self.judge = Judge(self.equations, found)
        motion, readable = found.motion, found.readable(self.times)
        about: Row = {
            "reduced by": motion.way.name,
            "integrator": motion.method,
            "tolerance": motion.tolerance,
            "horizon [s]": horizon,
            "known until [s]": found.until,
            "energy drift [J]": float(np.ptp(found.energies(self.times))) if self.judge.conserves else None,
            "points": len(self.times),
            "points for reactions": int(readable.sum()),
        }
        compared = self.judge.errors_of_reference(self.times)
        for row in compared or [{"compared with": "nothing"}]:
            self._keep("reference", about | row)
        for name in (POSITION, REACTION):
            self.floors[name] = max((x for r in compared if (x := measured(r, name)) is not None), default=None)

    def _scenes(self) -> None:
        """Collect parts that scenes leave out, and the operations that this saves."""
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
                self._keep("scenes", {"scene": name, "left out": what, **saved})

    def _makers(self, folder: Path) -> dict[str, Callable[[str], Any]]:
        """Return all ways to run: functions that make a unit for a method."""
        kernels = ["compiled"] * bool(compiler()) + ["vm", "oracle"]
        makers: dict[str, Callable[[str], Any]] = {kernel: partial(self._instance, kernel) for kernel in kernels}
        if self.effort.ways:
            for kernel, lean in product(kernels[:-1], (False, True)):
                makers[f"{kernel}, joint{', lean' * lean}"] = partial(self._joint, kernel, lean)
            return makers
        return {**makers, f"FMU ({kernels[0]})": partial(self._fmu, folder, kernels[0])}

    def _instance(self, kernel: str, method: str) -> Instance:
        if method not in self._traced:
            self._traced[method] = scene(self.derived, method, "vm")
        return instance(self._traced[method], kernel)

    def _joint(self, kernel: str, lean: bool, method: str) -> Instance:
        """Return the mechanism in joint coordinates with constant parameters, as in other codes."""
        form = f"{method}, joint{', lean' * lean}"
        if form not in self._traced:
            equations = with_defaults(derive(load(self.name, coordinates="joint")), self.effort.given)
            chosen = specialised(equations, list(self.compared) if lean else None, ["all"])
            self._traced[form] = scene(chosen, method, "vm")
        return instance(self._traced[form], kernel)

    def _fmu(self, folder: Path, kernel: str, method: str) -> Fmu:
        path, given = folder / f"{self.name}_{method}.fmu", {"solver.method": method}
        return Fmu(export(self.mechanism, path, kind="python", kernel=kernel, parameters=given))

    def _unit(self, way: str, method: str) -> _Open:
        """Return a unit of a way to run for a method, created on first use."""
        if (way, method) not in self._units:
            self._units[way, method] = self._stack.enter_context(closing(_Open(self._ways[way](method))))
        return self._units[way, method]

    def _settings(self) -> list[list[Setting]]:
        """Return all settings in groups, the most important first."""
        if self.effort.methods:
            ways = [way for way in self.effort.ways if way in self._ways] or [next(iter(self._ways))]
            own = [self._setting(OWN, method, way) for way in ways for method in self.effort.methods]
            beside = TUNED if self.effort.ways else SCIPY
            return [own + [rival for rival in map(self._rival, beside) if rival]]
        (first, *more), others = methods(), [name for name in FORMULATIONS if name != OWN]
        more.sort(key=lambda method: method != Settings.method)
        every = "vm" if not self.effort.wide and "vm" in self._ways else next(iter(self._ways), None)
        fastest, slower = [way for way in self._ways if way == every], [way for way in self._ways if way != every]
        told = [method for method in more if self.effort.wide or method == Settings.method]
        # The oracle supports the first method only.
        again = [way for way in self._ways if way != "oracle"]
        pairs = [
            [(OWN, m, way) for m in (first, *more) for way in fastest],
            [(OWN, first, way) for way in slower],
            [(f, first, "oracle") for f in others],
            [(OWN, m, way) for way in reversed(slower) if way in again for m in told],
            [(f, m, way) for f in others for m in more for way in fastest],
            [(f, first, way) for f in others for way in again],
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
            if not opened.warm:  # exclude initialisation on first use from the time
                run(opened.unit, opened.restart, replace(case, most=1))
                opened.warm = True
            return run(opened.unit, opened.restart, case)

        default = e.step_size if stepped else _middle(values)
        language = PYTHON if way == "oracle" else COMPILED
        return Setting("alfmu", formulation, method, way, control(method), tuple(values), default, once, language)

    def _rival(self, rival: Rival) -> Setting | None:
        """Return the setting of another code with as many values as alfmu, None if it has no model of the mechanism."""
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

        way, middle = "its own", _middle(values)
        return Setting(rival.name, "dae", rival.method, way, rival.control, values, middle, once, rival.language)

    def _run(self, setting: Setting, value: float, deadline: float) -> None:
        """Run a setting; if it would take too long, list it with its estimate."""
        before = self._before.get(setting)
        estimate = before[1] * setting.growth(before[0], value) if before else None
        late = time.perf_counter() > deadline
        if late or (estimate is not None and estimate > self.effort.limit):
            reason = LATE if late else "it would take too long"
            self._keep("skipped", setting.row(value) | {"estimate [s]": estimate, "reason": reason})
            return
        try:
            compared = self.compared if setting.code == "alfmu" else ()
            found = setting.run(value, Case({}, self.times, self.effort.limit, self.effort.repeats, compared))
        except AlfmuError as error:
            self._keep("skipped", setting.row(value) | {"estimate [s]": estimate, "reason": str(error)})
            return
        if not found.failure:
            self._before[setting] = value, min(found.seconds)
        about = setting.row(value) | {"default": int(value == setting.default)}
        self._keep("errors", about | self.judge.errors(found) | found.cost())

    def _summarise(self) -> None:
        """Add the row at the default step or tolerance of each setting, with its order and its slope over run time."""
        lines: dict[tuple, list[Row]] = {}
        for row in self.files["errors"]:
            lines.setdefault(_line(row), []).append(row)
        for rows in lines.values():
            fit = self._telling(rows)
            order, doubt = self._order(rows)
            told = [number(r, TIME) for r in fit]
            spread = bool(fit) and max(told) > CLEARLY * min(told)
            falls = slope(told, [number(r, POSITION) for r in fit]) if spread else None
            for row in rows:
                if row["default"]:
                    shown_row = {k: x for k, x in row.items() if k not in ("mechanism", "default")}
                    self._keep(
                        "settings", shown_row | {"order": order, "no order as": doubt, "slope over run time": falls}
                    )

    def _order(self, rows: Sequence[Row]) -> tuple[float | None, str]:
        """Return the order in the errors of one setting over its steps, or why there is none."""
        if rows[0]["control"] != STEP:
            return None, "a tolerance chooses the steps"
        fit = self._telling(rows)
        if len(fit) < FITTING:
            return None, "too few errors are between the motion lost and the error of the reference"
        x, y = [number(r, "value") for r in fit], [number(r, POSITION) for r in fit]
        order = slope(x, y)
        if order is None:
            return None, "all runs have one step"
        left = np.log(y) - order * np.log(x)
        if np.ptp(left) > 2 * np.log(STRAIGHT):
            return None, "the errors are not on a straight line"
        return order, ""

    def _tolerances(self) -> None:
        """Compare errors with the requested tolerances."""
        for row in self.files["errors"]:
            if row["code"] == "alfmu" and row["formulation"] == OWN and row["control"] == TOLERANCE:
                told = {"method": row["method"], "way": row["way"], TOLERANCE: row["value"], POSITION: row[POSITION]}
                error = measured(row, POSITION)
                over = None if row[TIME] is None or error is None else error / number(row, "value")
                verdict = "not judged" if over is None else "held" if over <= HELD else "not held"
                told |= {"error over tolerance": over, "steps": row["steps"], "within ten times": verdict}
                self._keep("tolerances", told)

    def _telling(self, rows: Sequence[Row]) -> list[Row]:
        """Return complete runs whose errors count for an order."""
        least = max(ABOVE * (self.floors[POSITION] or 0.0), ROUNDOFF)
        ended = [r for r in rows if r[TIME] is not None]
        return [r for r in ended if (error := measured(r, POSITION)) is not None and least < error < LOST]

    # Comparisons -------------------------------------------------------------------------------------------------

    def _compare(self) -> None:
        """Compare the defaults of alfmu with all others, also where alfmu is worse: run times at equal error, errors at
        equal step."""
        rows = [r for r in self.files["errors"] if r[TIME] is not None]
        own = [r for r in rows if (r["code"], r["formulation"]) == ("alfmu", OWN)]
        in_python = [r for r in own if r["language"] == PYTHON]
        for level in LEVELS:
            mine = _fastest(own, level)
            for code in dict.fromkeys(r["code"] for r in rows if r["code"] != "alfmu"):
                what: Row = {"what": "run time to a position error of", "level or step": level, "other": code}
                theirs = [r for r in rows if r["code"] == code]
                self._versus(what, TIME, mine, _fastest(theirs, level))
                if in_python and all(r["language"] == PYTHON for r in theirs):
                    self._versus(what, TIME, _fastest(in_python, level), _fastest(theirs, level))
        for other in rows:
            if other["code"] == "alfmu" and other["formulation"] != OWN and other["default"]:
                for mine in own:
                    if all(mine[x] == other[x] for x in ("method", "way", "value")):
                        for quantity in (*QUANTITIES, TIME):
                            named = "run time" if quantity == TIME else quantity
                            what = {"what": f"{named} at equal step", "level or step": other["value"]}
                            self._versus(what, quantity, mine, other)

    def _reach(self) -> None:
        """Compare run times at equal errors, interpolated between runs of a setting, with the fastest of alfmu."""
        lines: dict[tuple, list[Row]] = {}
        for row in self.files["errors"]:
            if row[TIME] is not None and row[POSITION] is not None:
                lines.setdefault(_line(row), []).append(row)
        for level in LEVELS[1:]:
            spent = {
                line: time_at(level, [(number(r, POSITION), number(r, TIME)) for r in rows])
                for line, rows in lines.items()
            }
            own = [(x[3], s) for x, s in spent.items() if x[0] == "alfmu" and s and "lean" not in x[3]]
            best = {way: [s for its, s in own if its.startswith(way)] for way in ("compiled", "vm")}
            for line, seconds in spent.items():
                told: Row = {**dict(zip(LINE, line, strict=True)), "position error": level, "run time [s]": seconds}
                for way, times in best.items():
                    told[f"over alfmu's fastest, {way}"] = seconds / min(times) if seconds and times else None
                self._keep("reach", told)

    def _versus(self, about: Row, quantity: str, mine: Row | None, theirs: Row | None) -> None:
        a, b = (None if row is None else measured(row, quantity) for row in (mine, theirs))
        row = about | {"alfmu": _named(mine), "its value": a, "other": _named(theirs) or about.get("other")}
        row["other's value"] = b
        if quantity == TIME and mine and theirs:
            same = mine["language"] == theirs["language"]
            row["ran in"] = str(mine["language"]) if same else f"{mine['language']}; the other in {theirs['language']}"
        self._keep("comparisons", row | {"ratio": b / a if a and b else None, "result": _verdict(quantity, a, b)})


def time_at(error: float, runs: Sequence[tuple[float, float]]) -> float | None:
    """Return the run time at an error, interpolated on log scales between runs (error, time); None if it is too
    small."""
    reached = sorted(runs)
    if not reached or error < reached[0][0]:
        return None
    cheap = [t for e, t in reached if e <= error]
    if error >= reached[-1][0]:
        return min(cheap)
    x, y = np.log([max(e, 1e-16) for e, _ in reached]), np.log([t for _, t in reached])
    return min(*cheap, float(np.exp(np.interp(np.log(max(error, 1e-16)), x, y))))


@dataclass
class _Open:
    """A unit that can be run repeatedly."""

    unit: Instance | Fmu
    warm: bool = False

    def __post_init__(self) -> None:
        self.restart = restarting(self.unit)

    def close(self) -> None:
        if isinstance(self.unit, Fmu):
            self.unit.close()


def _passes(settings: Sequence[Setting]) -> list[tuple[Setting, float]]:
    """Return all settings with their largest step or tolerance, then with the next: each runs at least once."""
    most = max((len(setting.values) for setting in settings), default=0)
    return [(setting, setting.values[i]) for i in range(most) for setting in settings if i < len(setting.values)]


def _middle(values: Sequence[float]) -> float:
    return values[(len(values) - 1) // 2]


LINE = ("code", "formulation", "method", "way")
"""Columns that distinguish settings."""


def _line(row: Row) -> tuple:
    return tuple(row[name] for name in LINE)


def _named(row: Row | None) -> str | None:
    return None if row is None else ", ".join(dict.fromkeys(map(str, _line(row))))


def _fastest(rows: Sequence[Row], level: float) -> Row | None:
    """Return the fastest run with a position error up to a level."""
    reached = [r for r in rows if (error := measured(r, POSITION)) is not None and error <= level]
    return min(reached, key=lambda r: number(r, TIME), default=None)


def _verdict(quantity: str, mine: float | None, theirs: float | None) -> str:
    if mine is None or theirs is None:
        return "not compared" if mine is theirs is None else "lost: not reached" if mine is None else "alfmu alone"
    level = 0.0 if quantity == TIME else ROUNDOFF
    if not mine > max(CLEARLY * theirs, level):
        return "alfmu better" if theirs > max(CLEARLY * mine, level) else "equal"
    return "lost: slower" if quantity == TIME else "lost: less exact"


# Report ------------------------------------------------------------------------------------------------------------

FILES = ("reference", "errors", "settings", "tolerances", "comparisons", "reach", "scenes", "skipped")

SHOWN = {
    "reference": (
        "The reference, and its change if it is computed in other ways",
        (
            *("reduced by", "integrator", "tolerance", "known until [s]", "points", "points for reactions"),
            *("energy drift [J]", "compared with", POSITION, REACTION),
        ),
    ),
    "settings": (
        "At the default step, or a middle tolerance",
        (
            *("code", "formulation", "method", "way", "language", "control", "value", *QUANTITIES, TIME, "repeats"),
            *("order", "no order as", "slope over run time", "note"),
        ),
    ),
    "tolerances": (
        "Errors over tolerances",
        ("method", "way", TOLERANCE, POSITION, "error over tolerance", "steps", "within ten times"),
    ),
    "comparisons": (
        "Run times at equal error, and lost comparisons",
        ("what", "level or step", "alfmu", "its value", "other", "other's value", "ratio", "ran in", "result"),
    ),
    "reach": (
        "Run times at equal error, interpolated between runs",
        (*LINE, "position error", "run time [s]", *(f"over alfmu's fastest, {way}" for way in ("compiled", "vm"))),
    ),
    "scenes": (
        "Operations of scenes, and savings by the parts they leave out",
        ("scene", "left out", "step", "outputs"),
    ),
}
"""Tables of a mechanism: title and columns by CSV file."""

METHOD = f"""
Every run is judged by a motion from an unrelated method: the equations of motion reduced to independent coordinates,
with the constraints closed to round-off, integrated with tolerances near round-off (`studies.reference`). Its error is
the change to other ways to compute it: the other reduction, a larger tolerance. {POSITION} and {REACTION} are the
largest differences of outputs with these units at the points of the run; reactions are compared where they are unique
and the position is not nearly singular. {PHI}, {PHI_DOT} and {ENERGY} are those of the run itself at these points.
Run time is the processor's, of all steps and of reading all outputs at each point, without set-up: the fastest of so
many repeats that the fastest ones agree, or of all that the limits allow. An order is that of errors over steps, where
there are enough of them between the error of the reference and a motion that is lost, and they are on a straight line.
"""

LIMITS = """
SciPy integrates the DAE (9) as it stands, in Python, with the same compiled evaluation of the equations as the
oracle, and is not told of singular positions. Beside alfmu's compiled code that is no fair comparison of methods, so
its times stand beside those of the oracle too, which is Python as well. Formulations other than the default take the
default integrator alone, and are timed by the oracle first, which has no other. All runs share one machine and one
process, in the order of `errors.csv`; small ratios of times are not to be trusted. Where the reference ends before
the run, positions and reactions are judged up to there.
Pinocchio, Exudyn and MuJoCo run mechanisms that were built for them by hand (`five_bar`, `slider_crank`), tuned to them
with exact motions at hand; the angle of the first link and the reactions are what is judged. Pinocchio is stepped in
Python. Longer runs beside them, the study of the paper in full and tolerances over whole runs are those of `--profile`,
maps with all their cells those of `alfmu stability`.
"""


def report(
    names: Sequence[str | Path | Mechanism],
    folder: str | Path,
    quick: bool = False,
    progress: Callable[[str], Progress] = lambda what: iter,
    effort: Effort | None = None,
    profile: str = "usual",
) -> Path:
    """Measure mechanisms and write the report into a folder; return the path of its page.

    `profile` is one of PROFILES; mechanisms to which it does not apply are left out. Raises AlfmuError before any run
    if a name is unknown, a mechanism cannot start, or matplotlib or plotly is missing.
    """
    library()
    effort = effort or PROFILES[profile][quick]
    if effort.parts == ("paper",):
        names = [name for name in names if name in ABOUT]
        if not names:
            raise InputError(f"the paper's study is about {', '.join(ABOUT)}; name one of them")
    if effort.ways:
        names = [name for name in names if name in peers.MACHINES]
        if not names:
            raise InputError(f"other codes are tuned to {', '.join(peers.MACHINES)}; name one of them")
    effort = replace(effort, total=min(effort.total, effort.each * len(names)))
    bounds = {
        "longest simulated time [s]": effort.horizon,
        "wall time of a run, at most [s]": effort.limit,
        "repeats of a run, at most": effort.repeats,
        "wall time of a cell of a map [s]": effort.stability.limit,
    }
    kind = "report" if profile == "usual" else f"report --profile {profile}"
    begun = begin(kind, Study, names, folder, effort, quick, bounds, PACKAGES)
    for study in begun.measured(progress):
        _pictures(study, begun.folder)
    for file in FILES if "runs" in effort.parts else ("skipped",):
        write_csv(begun.folder / f"{file}.csv", [row for study in begun.studies for row in study.files[file]])
    if "maps" in effort.parts:
        maps.write(begun.folder, [study.maps for study in begun.studies])
    summary = _skipped(begun.studies)
    if "runs" in effort.parts:
        write_csv(begun.folder / "rivalry.csv", _rivalry(begun.studies))
    write_csv(begun.folder / "skipped_summary.csv", summary, SKIPPED)
    if any(study.chapters for study in begun.studies):
        about = paper.settings(effort.paper)
        write_csv(begun.folder / f"{about.name}.csv", about.rows)
    begun.write("report.md", _markdown(begun, summary))
    page = begun.folder / "report.html"
    write(page, _page(begun, summary).encode())
    return page


SKIPPED = ("mechanism", "reason", "runs", "what")

NAMED = 6
"""Number of skipped runs up to which a line names them; of more it gives the number."""


def _skipped(studies: Sequence[Study]) -> list[Row]:
    """Return the skipped runs, a row for each reason of each mechanism."""
    found: list[Row] = []
    for study in studies:
        why: dict[str, list[Row]] = {}
        for row in study.files["skipped"]:
            why.setdefault(str(row["reason"]), []).append(row)
        for reason, each in why.items():
            names = list(dict.fromkeys(", ".join(str(r[x]) for x in LINE if r.get(x)) for r in each))
            what = "; ".join(names[:NAMED]) + f"; {len(names) - NAMED} others" * (len(names) > NAMED)
            found.append({"mechanism": study.name, "reason": reason, "runs": len(each), "what": what})
    return found


def _markdown(begun: Begun[Study], summary: Sequence[Row]) -> str:
    where = shown("Where this was measured", "environment", ("what", "value"), begun.environment)
    parts, rivalry = ["# Error against run time"], _rivalry(begun.studies)
    if numbered(rivalry):
        parts += [paragraph(RIVALRY), shown("All mechanisms", "rivalry", _columns(rivalry), rivalry)]
    for study in begun.studies:
        parts += _chapter(study)
    parts += ["## How it was measured", where, paragraph(METHOD)]
    if begun.studies[0].effort.ways:
        parts += ["## How each is used", markdown(("code", "use"), list(peers.USAGE.items()))]
    if any(study.chapters for study in begun.studies):
        parts += ["## The paper's study", paper.settings(begun.studies[0].effort.paper).markdown(), paper.LIMITS]
    if "maps" in begun.studies[0].effort.parts:
        parts += ["## Maps of stability", *maps.explained()]
    parts += ["## Skipped runs"]
    parts.append(shown("Skipped", "skipped_summary", SKIPPED, summary) if summary else "All runs were made.")
    return "\n\n".join([*parts, "## Where the comparison stops being fair", paragraph(LIMITS)]) + "\n"


def _chapter(study: Study) -> Iterator[str]:
    """Yield the chapter of one mechanism."""
    yield f"## {study.name}"
    yield study.mechanism.description + "."
    if "runs" in study.effort.parts:
        yield f"Lower and further left is better.\n\n![{OWN}: errors against run time]({study.name}.png)"
        for file in SHOWN:
            yield from _table(study, file)
            if file == "reference":
                yield f"![formulations: errors against run time]({study.name}_formulations.png)"
                yield "All runs: `errors.csv`."
    for chapter in study.chapters:
        yield from chapter.markdown("###")
    if "maps" in study.effort.parts:
        yield "### Stability"
        yield from maps.chapter(study.maps)


def _table(study: Study, file: str) -> list[str]:
    """Return a table of a mechanism in Markdown, empty if it has no rows."""
    rows, (title, columns) = study.files[file], SHOWN[file]
    if file == "comparisons":
        rows = [r for r in rows if str(r["what"]).startswith("run time to") or str(r["result"]).startswith("lost")]
    if file == "reference" and any("note" in row for row in rows):
        columns = ("horizon [s]", "note")
    return [shown(title, file, columns, rows)] if numbered(rows) else []


SHOWN_ERRORS = (POSITION, REACTION, ENERGY, PHI)
"""Quantities in plots, with a panel each."""


def _own(study: Study) -> list[Row]:
    """Return the runs of the default formulation by all ways to run, and those of other codes."""
    return [r for r in study.files["errors"] if r["formulation"] == OWN or r["code"] != "alfmu"]


def _one_way(study: Study) -> list[Row]:
    """Return the runs of every formulation by the one way that runs all integrators, and those of other codes."""
    rows = study.files["errors"]
    first = next((r["way"] for r in rows if r["code"] == "alfmu"), "")
    return [r for r in rows if r["way"] == first or r["code"] != "alfmu"]


def _pictures(study: Study, folder: Path) -> None:
    """Draw the default formulation in every way, every formulation in one way, the plots of the paper, and maps."""
    for chapter in study.chapters:
        chapter.write(folder)
    if "maps" in study.effort.parts:
        maps.draw(study.maps, folder)
    if "runs" not in study.effort.parts:
        return
    for name, title, chosen, told in (
        (study.name, f"{study.name}: {OWN}", _own(study), "way"),
        (f"{study.name}_formulations", f"{study.name}: formulations", _one_way(study), "formulation"),
    ):
        kinds = list(dict.fromkeys(r[told] for r in chosen))

        def label(row: Row, told: str = told) -> str:
            return integrator(row) + f", {row[told]}" * (row["code"] == "alfmu")

        def look(row: Row, told: str = told, kinds: list = kinds) -> tuple:
            return LOOKS[integrator(row)], line_of(row[told], kinds)

        figure = scatter(title, chosen, SHOWN_ERRORS, TIME, label, look, study.floors)
        save(figure, folder / f"{name}.png", 110)


# Page --------------------------------------------------------------------------------------------------------------

RIVALRY = """
How many times as long each other code takes as the fastest way of alfmu to get below a position error. A code that
runs in Python is compared with alfmu's oracle, which runs in Python as well.
"""

BY_TIME = """
Errors against run time, {what}; lower and further left is better. Colour and marker are those of the integrator in all
plots of this page, lines tell {lines} apart, and open markers are other codes. Click an entry of the legend to hide a
line, double-click to see it alone; errors far above a motion that is lost lie outside until one zooms out.
"""


def _page(begun: Begun[Study], summary: Sequence[Row]) -> str:
    """Return the page: the plot of the first mechanism and a sentence on each, then details in folds and chapters."""
    page = Page("Error against run time")
    rows = _rivalry(begun.studies)
    if "runs" in begun.studies[0].effort.parts:
        for study, row in zip(begun.studies, rows, strict=True):
            page.text(_sentence(study, row))
    first = begun.studies[:1]
    for study in first:
        _against_time(page, study)
    if numbered(rows):
        columns = _columns(rows)
        page.fold(
            "All mechanisms, beside other codes",
            f"{paragraph(RIVALRY)}\n\n{markdown(columns, [[row.get(x) for x in columns] for row in rows])}",
        )
    page.fold("How it was measured", paragraph(METHOD))
    page.fold("Where the comparison stops being fair", paragraph(LIMITS))
    page.fold("Where this was measured", shown("Machine", "environment", ("what", "value"), begun.environment))
    for study in begun.studies:
        _chapter_of_page(page, study, study in first)
    page.head(2, "Skipped runs")
    page.text(markdown(SKIPPED, [[r[x] for x in SKIPPED] for r in summary]) if summary else "All runs were made.")
    return page.html()


def _sentence(study: Study, row: Row) -> str:
    """Return a sentence on the results of a mechanism."""
    time = row["its run time [ms]"]
    if time is not None:
        which, level = row[fastest(LEVELS[1])], f"{LEVELS[1]:g} m, rad"
        return f"**{study.name}**: {which} is the fastest to a position error of {level}, in {time:.3g} ms."
    known = [r for r in study.files["errors"] if r["code"] == "alfmu" and r.get(POSITION) and r.get(TIME)]
    if not known:
        return f"**{study.name}**: no run has an error that could be judged."
    best = min(known, key=lambda r: number(r, POSITION))
    how, spent = f"{integrator(best)}, {best['way']}", 1e3 * number(best, TIME)
    return f"**{study.name}**: {how} has the smallest position error, {best[POSITION]:.2g}, in {spent:.3g} ms."


def fastest(level: float) -> str:
    """Return the column of the fastest run below a position error."""
    return f"fastest to {level:g} m, rad"


def _against_time(page: Page, study: Study) -> None:
    """Add the main plot of a mechanism: errors of all ways to run it, and of other codes."""
    if any(r["code"] == "alfmu" for r in study.files["errors"]):
        plotted = against_time(_own(study), SHOWN_ERRORS, TIME, "way", "way", study.floors)
        page.plot(plotted, " ".join(BY_TIME.format(what=f"formulation {OWN}", lines="ways to run").split()))


def numbered(rows: Sequence[Row]) -> bool:
    """Return whether any row contains a number."""
    return any(isinstance(x, int | float) and not isinstance(x, bool) for row in rows for x in row.values())


def _rivalry(studies: Sequence[Study]) -> list[Row]:
    """Return run times of other codes over alfmu's at a medium error, in the same language if possible."""
    level, rows = LEVELS[1], []
    for study in studies:
        told = [r for r in study.files["comparisons"] if "run time to" in str(r["what"])]
        found = [r for r in told if r["level or step"] == level]
        mine = next((r for r in found if r["its value"]), None)
        row: Row = {"mechanism": study.name, fastest(level): mine["alfmu"] if mine else None}
        row["its run time [ms]"] = 1e3 * number(mine, "its value") if mine else None
        for each in found:
            code = str(each["other"]).split(",")[0]
            beside = "oracle" if "oracle" in str(each["alfmu"]) else "fastest"
            row[f"{code} / {beside}"] = each["ratio"] or ("not reached" if each["other's value"] is None else None)
        rows.append(row)
    return rows


def _columns(rows: Sequence[Row]) -> list[str]:
    """Return the columns in which some row has a value."""
    return [name for name in dict.fromkeys(x for row in rows for x in row) if any(row.get(name) for row in rows)]


def _chapter_of_page(page: Page, study: Study, opened: bool = False) -> None:
    """Add the chapter of one mechanism; `opened` if the page began with its plot."""
    name = study.name
    page.head(2, name)
    page.text(study.mechanism.description + ".")
    if study.film:
        page.film(study.film, f"The motion of {name}.")
    if "runs" in study.effort.parts:
        page.head(3, f"Errors of {name}")
    for row in study.files["reference"]:
        if "note" in row:
            page.text(
                f"There is no reference, so that constraints and energy alone are judged: {row['note']}.", note=True
            )
    shown_rows = [r for r in study.files["errors"] if r["code"] == "alfmu"]
    if not opened:
        _against_time(page, study)
    if shown_rows:
        plotted = against_time(_one_way(study), SHOWN_ERRORS, TIME, "formulation", "method", study.floors)
        way = next(r["way"] for r in shown_rows)
        about = BY_TIME.format(what=f"all formulations in the way {way}", lines="formulations")
        page.plot(plotted, " ".join(about.split()))
    orders = {
        str(r["method"]): order
        for r in study.files["settings"]
        if r["code"] == "alfmu" and r["formulation"] == OWN and (order := measured(r, "order")) is not None
    }
    fast = [r for r in _one_way(study) if (r["code"], r["formulation"]) == ("alfmu", OWN) and r[TIME] is not None]
    panels = {c: [r for r in fast if r["control"] == c] for c in (STEP, TOLERANCE)}
    if fast:
        about = (
            f"Position errors of {name} over step or tolerance, of runs that reached their end. An order stands beside "
            "integrators whose errors show one. On the dashed line, the error is the tolerance."
        )
        page.plot(convergence(panels, orders, TOLERANCE, POSITION), about)
    for file in SHOWN:
        for text in _table(study, file):
            page.fold(SHOWN[file][0], text)
    if "maps" in study.effort.parts:
        page.head(3, f"Where {name} runs")
        if all(r["class"] == maps.NOT_RUN for r in study.maps.rows):
            page.text("No cell of a map was run, as the time for this mechanism was used up before.", note=True)
        else:
            _maps_of_page(page, study)
    for chapter in study.chapters:
        page.head(3, f"The paper: {chapter.title}")
        page.text(paragraph(chapter.text))
        page.beside()
        page.pictures(list(chapter.pictures.values()), chapter.title)
        page.next()
        for table in chapter.tables:
            page.text(table.markdown())
        page.together()
    if study.chapters:
        page.text(paper.LIMITS, note=True)


def _maps_of_page(page: Page, study: Study) -> None:
    """Add maps of stability under their legend."""
    meaning = {str(r["class"]): _criterion(r) for r in maps.CRITERIA}
    page.legend(maps.CLASSES, {x: meaning.get(x) or meaning[x.split(":")[0]] for x in maps.CLASSES})
    page.maps(maps.maps_of(study.maps), maps.CLASSES, _said(study.maps.rows))
    if late := maps.left_out(study.maps):
        page.text(f"There was no time for {len(late)} more: {'; '.join(late)}.", note=True)
    page.fold("How maps are made", "\n\n".join([*maps.explained(), *maps.chapter(study.maps)][1:2]))


def _criterion(row: Row) -> str:
    """Return the criterion that determines the class of a cell of a map."""
    bounds = [f"{word} {row[word]:g}" for word in ("at most", "above") if word in row]
    return " ".join([str(row["measure"]), *bounds])


def _said(rows: Sequence[Row]) -> dict[tuple[str, str, str], str]:
    """Return the tooltips of cells of maps, beside their class."""
    found = {}
    for r in rows:
        error = r.get(POSITION)
        parts = [f"position error {error:.2g} m, rad"] if error is not None else []
        if r.get("cut short"):
            parts.append(f"cut short at {r['reached [%]']:.2g} % of its time")
        parts += [str(r["message"])] if r.get("message") else []
        found[str(r["map"]), str(r["row"]), str(r["column"])] = "; ".join(parts)
    return found
