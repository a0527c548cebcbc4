"""Maps of stability over steps, penalties and parameters: where a run is accurate, inaccurate, or fails, and how.

`stability` writes `stability.md`, CSV files with every number, and a picture of the maps of each mechanism into one
folder.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.errors import AlfmuError
from ..model.mechanism import Mechanism
from ..model.settings import FORMULATIONS, Settings
from ..runtime import Instance
from ..simulation import prepared
from ..view.plot import save
from . import cases
from . import reference as exact
from .cases import ENERGY, PHI, POSITION, Case, Judge, Progress, Run, begin, methods, restarting, run, scene
from .charts import Map, maps
from .tables import Row, markdown, measured, number, paragraph, shown, write_csv

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "matplotlib")

GROWTH = 0.1
"""Energy error over the largest kinetic energy, above which energy counts as growing."""

DRIFT = 1e-3
"""Constraint error over the scale of positions, above which constraints count as drifting."""

LOST, INEXACT = 0.1, 1e-3
"""Position errors over the scale of positions, above which the motion is lost, or inexact.

The scale is the size of the mechanism [m], the largest position output on its motion, and at most 1 [m, rad].
"""

POINTS = 20
"""Least number of output times of a run, with more at its start."""

KINDS = {
    "not finite": "not finite",
    "turned by": "step too long",
    "opened": "step too long",
    "corrections": "constraints left open",
    "leaves": "constraints left open",
    "does not close": "constraints left open",
    "locked up": "locked up",
    "is singular": "singular mass",
    "outside [": "value out of bounds",
}
"""Kinds of failure by the text of their messages; others are "something else"."""

OTHER = "something else"

REFUSED = "refused: "

NOT_RUN = "not run"
"""Class of cells skipped for lack of time."""

SHADES = ("#8fb3d9", "#5f8fc4", "#3b6ea5", "#27507e", "#16335a", "#a9a4c9", "#7f78ad")

CLASSES = {
    "exact": "#59a96a",
    "stable, not judged": "#b9dcae",
    "inexact": "#f2d45c",
    "motion lost": "#f0984b",
    "constraints drift": "#b0608c",
    "energy grows": "#d0423a",
    "not finite": "#4a1d1d",
    **dict(zip((REFUSED + kind for kind in dict.fromkeys([*KINDS.values(), OTHER])), SHADES, strict=True)),
    NOT_RUN: "#ffffff",
}
"""Classes of cells and their colours; if several apply, the last one in the order of CRITERIA counts."""

CRITERIA: Sequence[Row] = (
    {"class": "exact", "measure": "position error over the scale", "at most": INEXACT},
    {"class": "stable, not judged", "measure": "none of those below, and there is no reference"},
    {"class": "inexact", "measure": "position error over the scale", "above": INEXACT},
    {"class": "motion lost", "measure": "position error over the scale", "above": LOST},
    {"class": "constraints drift", "measure": "constraint error, Phi, over the scale", "above": DRIFT},
    {"class": "energy grows", "measure": "energy error over the largest kinetic energy", "above": GROWTH},
    {"class": "not finite", "measure": "an output is not a finite number"},
    {"class": "refused", "measure": "an error ended the run; its message tells the kind"},
    {"class": NOT_RUN, "measure": "the time for the mechanism was used up"},
)

ALPHA = ("residual", "classic", "penalty", "stiffness")
"""Formulations with a penalty."""

OWN = Settings.formulation

SPRINGS = ("N/m", "N.m/rad")


@dataclass(frozen=True)
class Effort:
    """Extent of the maps."""

    total: float
    """Wall time for all mechanisms together [s]."""
    horizon: float
    """Simulated time [s]; a shorter stop time of the mechanism takes precedence."""
    limit: float
    """Wall time limit of a cell [s]; a cell that exceeds it ends before the horizon."""
    steps: tuple[float, ...]
    """Steps over the mechanism's own."""
    penalties: tuple[float, ...]
    """Penalties over the largest entry of M."""
    scales: tuple[float, ...]
    """Factors on masses and on springs."""
    masses: int
    """Number of masses that vary in the corners."""
    reference: exact.Effort


USUAL = Effort(
    total=3600.0,
    horizon=2.0,
    limit=0.2,
    steps=(1e-4, 1e-3, 1e-2, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0),
    penalties=(1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14),
    scales=(1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6),
    masses=10,
    reference=exact.Effort(fine=1e-9, coarse=None, parts=20, seconds=1.0),
)
QUICK = Effort(
    total=120.0,
    horizon=1.0,
    limit=0.03,
    steps=(1e-4, 0.1, 1.0, 10.0),
    penalties=(1e2, 1e6, 1e10, 1e14),
    scales=(1e-6, 1.0, 1e6),
    masses=1,
    reference=exact.Effort(fine=1e-9, coarse=None, parts=20, seconds=0.3),
)


@dataclass(frozen=True)
class Cell:
    """A run and its position in a map."""

    map: str
    across: str
    down: str
    column: str
    row: str
    formulation: str
    method: str
    step: float = 1.0
    """Step over the mechanism's own."""
    penalty: float = 0.0
    """Penalty over the largest entry of M; 0 for the default."""
    scaled: Mapping[str, float] = field(default_factory=dict)
    """Factors of parameters."""


class Study(cases.Study):
    """All cells of one mechanism, as rows of a CSV file."""

    def __init__(self, name: str | Path | Mechanism, effort: Effort):
        super().__init__(name, effort)
        self.rows: list[Row] = []
        self._judges: dict[tuple, tuple[Judge, float, float]] = {}

    def measure(self, deadline: float, progress: Progress) -> None:
        """Run all cells until `deadline`."""
        self.equations = e = prepared(self.derived, "auto")
        self.horizon = min(e.stop_time, self.effort.horizon)
        self.instance = Instance(e)
        self._units: dict[str, tuple[Instance, Callable[[], None]]] = {}
        self.defaults = {v.name: float(v.start) for v in e.parameters}
        self.springs = [v.name for v in e.parameters if v.unit in SPRINGS]
        self.masses = [v.name for v in e.parameters if v.unit == "kg" and v.start]
        self.instance.initialize()
        self.mass = float(e.M(self.instance.q, self.instance.memory["p"]).full().diagonal().max())
        for cell in progress(list(self.cells())):
            self.rows.append(self._measured(cell) if time.perf_counter() < deadline else self._row(cell, NOT_RUN))

    # Cells -------------------------------------------------------------------------------------------------------

    def cells(self) -> Iterator[Cell]:
        """Yield all cells, the corners first."""
        yield from self._corners()
        yield from self._formulations()
        yield from self._masses()
        yield from self._springs()
        yield from self._penalties()

    def _corners(self) -> Iterator[Cell]:
        """Yield every combination of the extremes of all factors."""
        effort, method = self.effort, next(iter(methods()))
        ends = [(min(x), max(x)) for x in (effort.steps, effort.penalties)]
        scales = (min(effort.scales), max(effort.scales))
        masses: list[str | None] = [*self.masses[: effort.masses]]
        for mass in masses or [None]:
            for step, alpha in product(*ends):
                for factor in scales if mass else (1.0,):
                    for stiff in scales if self.springs else (1.0,):
                        scaled = {mass: factor} if mass else {}
                        scaled |= dict.fromkeys(self.springs, stiff) if self.springs else {}
                        column = f"{step:g}, {alpha:g}" + f", {factor:g}" * bool(mass)
                        column += f", {stiff:g}" * bool(self.springs)
                        across = "step, penalty" + f", {mass}" * bool(mass) + ", springs" * bool(self.springs)
                        for name in FORMULATIONS:
                            place = (f"corners{f' of {mass}' * bool(mass)}", across, "formulation", column, name)
                            yield Cell(*place, name, method, step, alpha, scaled)

    def _formulations(self) -> Iterator[Cell]:
        first, *others = methods()
        for formulation, method in [*((f, first) for f in FORMULATIONS), *((OWN, m) for m in others)]:
            for step in self.effort.steps:
                row = formulation if method == first else f"{formulation}, {method}"
                yield Cell("formulations", "step", "formulation", f"{step:g}", row, formulation, method, step)

    def _masses(self) -> Iterator[Cell]:
        for mass, factor in product(self.masses, self.effort.scales):
            place = "masses at the default step", "mass", "factor", mass, f"{factor:g}"
            yield Cell(*place, OWN, next(iter(methods())), scaled={mass: factor})

    def _springs(self) -> Iterator[Cell]:
        for method, factor, step in product(methods(), self.effort.scales, self.effort.steps):
            if self.springs:
                scaled = dict.fromkeys(self.springs, factor)
                place = f"stiffness of springs, {method}", "step", "factor", f"{step:g}", f"{factor:g}"
                yield Cell(*place, OWN, method, step, scaled=scaled)

    def _penalties(self) -> Iterator[Cell]:
        method = next(iter(methods()))
        for formulation, alpha, step in product(ALPHA, self.effort.penalties, self.effort.steps):
            place = f"penalty, {formulation}", "step", "penalty over mass", f"{step:g}", f"{alpha:g}"
            yield Cell(*place, formulation, method, step, alpha)

    # Runs --------------------------------------------------------------------------------------------------------

    def _measured(self, cell: Cell) -> Row:
        """Run and classify a cell."""
        step = cell.step * self.equations.step_size
        try:
            found = run(*self._unit(cell.method), Case(self._values(cell), self._times(step), self.effort.limit))
        except AlfmuError as error:
            return self._row(cell, NOT_RUN, message=str(error))
        reached = float(found.times[-1]) if len(found.times) else 0.0
        judge, scale, kinetic = self._judge(cell)
        errors = judge.errors(found)
        name = classified(found, errors, scale, kinetic, judge.reference is not None)
        row = {"simulated [s]": reached, "reached [%]": 100 * reached / self.horizon, "cut short": int(found.cut)}
        row |= {**errors, "scale [m, rad]": scale, "largest kinetic energy [J]": kinetic, "message": found.failure}
        return self._row(cell, name, **row)

    def _unit(self, method: str) -> tuple[Instance, Callable[[], None]]:
        """Return the instance for a method (created on first use), and a function that undoes its initialisation."""
        if method not in self._units:
            unit = Instance(scene(self.derived, method, "auto"))
            self._units[method] = unit, restarting(unit)
        return self._units[method]

    def _values(self, cell: Cell) -> dict[str, float | str]:
        step = cell.step * self.equations.step_size
        values: dict[str, float | str] = {"solver.formulation": cell.formulation, "solver.step_size": step}
        if cell.penalty:
            values["solver.penalty"] = cell.penalty * self.mass
        return values | {name: factor * self.defaults[name] for name, factor in cell.scaled.items()}

    def _times(self, step: float) -> NDArray:
        """Return times up to the horizon, with increasing numbers of steps between them.

        No interval is longer than all before it together, so that slow steps do not exceed the time limit by much.
        """
        most, at = max(1, round(self.horizon / step)), [0]
        while at[-1] < most:
            at.append(min(most, at[-1] + min(max(1, most // POINTS), max(1, at[-1]))))
        return step * np.array(at)

    def _judge(self, cell: Cell) -> tuple[Judge, float, float]:
        """Return the judge of runs with these parameters, the scale of positions, and the largest kinetic energy."""
        key = tuple(sorted(cell.scaled.items()))
        if key not in self._judges:
            self._judges[key] = self._judged(key)
        return self._judges[key]

    def _judged(self, scaled: Sequence[tuple[str, float]]) -> tuple[Judge, float, float]:
        times = np.linspace(0.0, self.horizon, POINTS)
        instance = Instance(self.equations)
        try:
            for name, factor in scaled:
                instance.set(name, factor * self.defaults[name])
            instance.initialize()
            found = exact.reference(instance, self.horizon, self.effort.reference)
        except AlfmuError as error:
            found = str(error)
        if isinstance(found, str):
            return Judge(self.equations, None), 1.0, np.nan
        judge = Judge(self.equations, found)
        return judge, min(1.0, judge.size(times)), found.kinetic(times)

    def _row(self, cell: Cell, name: str, **more: Any) -> Row:
        row = {x: getattr(cell, x) for x in ("map", "row", "column", "formulation", "method")}
        row |= {"step over default": cell.step, "penalty over mass": cell.penalty or None}
        row |= {"parameters": " ".join(f"{k}*{x:g}" for k, x in cell.scaled.items())}
        return {"mechanism": self.name, **row, "across": cell.across, "down": cell.down, "class": name, **more}


def classified(run: Run, errors: Row, scale: float, kinetic: float, judged: bool) -> str:
    """Return the class of a run by CRITERIA."""
    if run.failure:
        return REFUSED + next((kind for words, kind in KINDS.items() if words in run.failure), OTHER)
    position, phi, energy = (measured(errors, x) for x in (POSITION, PHI, ENERGY))
    if not np.isfinite(run.values).all():
        return "not finite"
    if energy is not None and energy > GROWTH * kinetic:
        return "energy grows"
    if phi is not None and phi > DRIFT * scale:
        return "constraints drift"
    if not judged or position is None:
        return "stable, not judged"
    if position > LOST * scale:
        return "motion lost"
    return "inexact" if position > INEXACT * scale else "exact"


# Report ------------------------------------------------------------------------------------------------------------

METHOD = """
Each cell is a run of its own, in the fastest kernel that there is, classified by the criteria of the table: of
those that apply, the last one counts. The position error is the largest difference to the reference of `alfmu report`
with the same parameters, at the points of the run; the scale is the size of the mechanism in m, or unity where that is
less. Steps are over the mechanism's own step, penalties over the largest entry of its mass matrix, factors over the
default of a parameter. A cell that does not reach its horizon in the time that it is given is cut short, and classified
by what it did up to there: it is pale in the picture, which says how much of the horizon it reached; the table marks it
with an asterisk.
"""


def stability(
    names: Sequence[str | Path | Mechanism],
    folder: str | Path,
    quick: bool = False,
    progress: Callable[[str], Progress] = lambda what: iter,
    effort: Effort | None = None,
) -> Path:
    """Measure mechanisms and write the maps into a folder; return the path of the report.

    Raises AlfmuError before any run if a name is unknown, a mechanism cannot start or matplotlib is missing.
    """
    effort = effort or (QUICK if quick else USUAL)
    bounds = {
        "simulated time, at most [s]": effort.horizon,
        "wall time of a cell [s]": effort.limit,
        "runs of a cell": 1,
    }
    begun = begin("stability", Study, names, folder, effort, quick, bounds, PACKAGES)
    for study in begun.measured(progress):
        draw(study, begun.folder)
    write(begun.folder, begun.studies)
    parts = ["# Stability", shown("Where this was measured", "environment", ("what", "value"), begun.environment)]
    parts += explained()
    for study in begun.studies:
        parts += [f"## {study.name}", f"{study.mechanism.description}.", *chapter(study), *map(_table, maps_of(study))]
    return begun.write("stability.md", "\n\n".join(parts) + "\n")


def draw(study: Study, folder: Path) -> None:
    """Draw the maps of a mechanism."""
    figure = maps(f"{study.name}: where it runs and how it fails", maps_of(study), CLASSES)
    save(figure, folder / _picture(study), 100)


def write(folder: Path, studies: Sequence[Study]) -> None:
    """Write the CSV files."""
    write_csv(folder / "criteria.csv", CRITERIA)
    write_csv(folder / "cells.csv", [row for study in studies for row in study.rows])
    write_csv(folder / "counts.csv", [row for study in studies for row in _counts(study)])


def explained() -> list[str]:
    """Return a description of the classes and of a cell's run in Markdown."""
    return [shown("Criteria", "criteria", ("class", "measure", "at most", "above"), CRITERIA), paragraph(METHOD)]


def chapter(study: Study) -> Iterator[str]:
    """Yield the picture of the maps of a mechanism, and the number of cells in each class."""
    yield f"![maps of {study.name}]({_picture(study)})"
    yield shown("Cells of each class", "counts", ("map", "class", "cells"), _counts(study))
    if not study.springs:
        yield "There is no map of springs: no parameter is a stiffness."


def _picture(study: Study) -> str:
    return f"{study.name}_stability.png"


def _of(study: Study) -> dict[str, list[Row]]:
    """Return the cells of each map."""
    found: dict[str, list[Row]] = {}
    for row in study.rows:
        found.setdefault(str(row["map"]), []).append(row)
    return found


def maps_of(study: Study) -> list[Map]:
    """Return the maps of a mechanism; maps skipped for lack of time are left out, unless all are."""
    drawn = []
    for title, cells in _of(study).items():
        columns, rows = (list(dict.fromkeys(str(c[x]) for c in cells)) for x in ("column", "row"))
        classes = {(str(c["row"]), str(c["column"])): str(c["class"]) for c in cells}
        cut = [c for c in cells if c.get("cut short")]
        short = {(str(c["row"]), str(c["column"])): _percent(number(c, "reached [%]")) for c in cut}
        drawn.append(Map(title, str(cells[0]["across"]), str(cells[0]["down"]), columns, rows, classes, short))
    return [each for each in drawn if set(each.classes.values()) != {NOT_RUN}] or drawn


def left_out(study: Study) -> list[str]:
    """Return maps skipped for lack of time."""
    return [title for title, cells in _of(study).items() if all(c["class"] == NOT_RUN for c in cells)]


def _percent(part: float) -> str:
    return f"{part:.0f} %" if part >= 1 else f"{part:.1g} %"


def _counts(study: Study) -> list[Row]:
    """Return the number of cells in each class by map."""
    rows: list[Row] = []
    for title, cells in _of(study).items():
        count = Counter(c["class"] for c in cells)
        rows += [{"mechanism": study.name, "map": title, "class": x, "cells": count[x]} for x in CLASSES if count[x]]
    return rows


def _table(one: Map) -> str:
    """Return a map as a Markdown table of its classes."""

    def cell(row: str, column: str) -> str:
        return one.classes.get((row, column), "") + " *" * ((row, column) in one.notes)

    lines = [[row, *(cell(row, column) for column in one.columns)] for row in one.rows]
    return f"**{one.title}** (`cells.csv`)\n\n" + markdown([f"{one.down} / {one.across}", *one.columns], lines)
