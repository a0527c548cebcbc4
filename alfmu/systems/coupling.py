"""Errors of co-simulation: a system against one mechanism of all its parts, as the communication step halves.

For each master algorithm and step a study gives the largest difference of the compared outputs, over the largest value
of each, and the energy created by coupling; for each master, the largest stable step.

Power passes through a bond of two connections between two components, an effort e one way and a flow f the other way.
With e* and f* the values that the components use instead within a step, one side receives e* f, the other delivers e
f*, and coupling creates their difference (after S. Sadjina, L. T. Kyllingstad, S. Skjong, E. Pedersen, "Energy
conservation and power bonds in co-simulations", Engineering with Computers 33, 2017)

    E = sum over steps of the integral of (e* f - e f*) dt.

All four are read at the beginning, the middle and the end of each step, and integrated by Simpson's rule.
"""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import simulation
from ..analysis.start import prepare, simulated
from ..fmi.recipe import of
from ..model.errors import AlfmuError, InputError
from ..model.files import path_for, write
from ..model.units import UNITS
from ..model.words import in_words, there_is
from ..simulation.result import Result
from ..view.plot import save
from .case import Case
from .description import Monolithic
from .masters import MASTERS
from .picture import figure
from .run import Assembly, Link
from .system import System

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HALVINGS = 5
"""Number of halvings of the communication step of the system."""

TOLERANCE = 1e-9
"""Relative tolerance of all components [1], so that the remaining error is due to coupling."""

REFERENCE = 1e-2
"""Tolerance of the equivalent mechanism over that of the components [1]."""

FAR = 1.0
"""Largest error of a stable run [1]: as large as the motion itself."""

FOUND = 1.05
"""Accuracy, as a ratio, of the largest stable step."""

_EFFORTS = ("N", "N.m", "V", "Pa")
_LIMITED = "solver.relative_tolerance"

Progress = Callable[[Iterable[Any]], Iterable[Any]]


@dataclass(frozen=True)
class Bond:
    """Two connections between two components through which power passes: indices of links."""

    effort: int
    flow: int
    name: str


@dataclass(frozen=True, eq=False)
class Coupling:
    """Results of a study of coupling."""

    system: str
    compared: Mapping[str, str]
    cases: Sequence[Case]
    stable: Mapping[str, tuple[float, bool]]
    """Largest stable step by master [s], and whether a longer one failed."""
    reference_error: float
    """Error of the equivalent mechanism [1]: its difference from a run at 1/100 of its tolerance and half its step."""
    bonds: Sequence[str]
    refused: Mapping[str, str] = field(default_factory=dict)
    """Reasons, by master, why the system cannot be run at all or at a requested step."""

    def of(self, master: str) -> list[Case]:
        """Return the runs by one master, the longest step first."""
        return [case for case in self.cases if case.master == master]

    def order(self, master: str) -> float:
        """Return the slope of the error over the step, fitted to the runs with an error above round-off and below 10 %.

        NaN if there are fewer than three.
        """
        floor = 30 * self.reference_error
        used = [case for case in self.of(master) if max(floor, 1e-9) < case.error < 0.1]
        if len(used) < 3:
            return math.nan
        return float(np.polyfit(np.log([c.step for c in used]), np.log([c.error for c in used]), 1)[0])

    def lines(self) -> list[str]:
        """Return all results as a table."""
        said = [f"{self.system}: {', '.join(f'{a} against {b}' for a, b in self.compared.items())}"]
        bonds = "; ".join(self.bonds)
        said += [f"power passes by {bonds}" if bonds else "no power bond is known, so no energy is reported"]
        exact = f"{self.reference_error:.1e}"
        said += [f"the monolithic mechanism changes by {exact} with a tighter tolerance and half the step", ""]
        said += ["master        step [s]    error    energy made [J]   of that passed   tries   time [s]"]
        for case in self.cases:
            if case.why:
                said += [f"{case.master:12} {case.step:9.3g}   failed: {case.why}"]
                continue
            share = f"{case.energy / case.passed:.1e}" if case.passed > 0 else "-"
            energy = "-" if math.isnan(case.energy) else f"{case.energy:.2e}"
            said += [
                f"{case.master:12} {case.step:9.3g}   {case.error:.1e}   {energy:>14}   {share:>14}   {case.tries:5.1f}"
                f"   {case.seconds:8.2f}"
            ]
        said += [""]
        said += [f"{master}: refused: {why}" for master, why in self.refused.items()]
        for master, (step, ended) in self.stable.items():
            order = self.order(master)
            slope = "no order can be fitted" if math.isnan(order) else f"order {order:.2f}"
            least = f"stable up to a step of {step:.3g} s" if step else "not stable at any step that was tried"
            said += [f"{master}: {slope}, {least}{'' if ended else ', the longest that was tried'}"]
        return said

    def save(self, path: str | Path) -> None:
        """Write the table as `.csv`; raise InputError for another suffix, WriteError if it cannot be written."""
        path = path_for("a table", path)
        text = io.StringIO(newline="")
        table = csv.writer(text, lineterminator="\n")
        heads = ["master", "step [s]", "error [1]", *(f"error of {name} [1]" for name in self.compared)]
        table.writerow([*heads, "energy made [J]", "energy passed [J]", "tries per step", "time [s]", "failed"])
        for c in self.cases:
            each = [c.errors.get(name, math.inf) for name in self.compared]
            numbers = (c.step, c.error, *each, c.energy, c.passed, c.tries, c.seconds)
            table.writerow([c.master, *(f"{x:.9g}" for x in numbers), c.why])
        for master, why in self.refused.items():
            table.writerow([master, *["nan"] * (len(self.compared) + 6), why])
        write(path, text.getvalue().encode())

    def figure(self) -> Figure:
        """Plot error over step by master, and the energy created by coupling over time; needs `alfmu[plot]`."""
        orders = {master: self.order(master) for master in dict.fromkeys(case.master for case in self.cases)}
        return figure(self.system, self.cases, orders, self.stable)

    def plot(self, path: str | Path) -> None:
        """Write the figure as PNG, SVG or PDF."""
        path = path_for("a plot", path)
        save(self.figure(), path, 150)


def couple(
    system: System | str | Path,
    *,
    halvings: int = HALVINGS,
    masters: Sequence[str] = tuple(MASTERS),
    tolerance: float = TOLERANCE,
    stability: bool = True,
    progress: Progress = iter,
) -> Coupling:
    """Compare a system with the mechanism that its `monolithic` names, by each of `masters`.

    The communication step is that of the system and `halvings` halvings of it. All mechanisms and parts, and FMUs with
    this parameter, run with the relative tolerance `tolerance` unless the system sets one, the equivalent mechanism
    with `REFERENCE` of it. `stability` searches the largest stable steps. `progress` wraps the runs. A master that
    cannot run the system is left out, with its reason in `refused`. Raises InputError if there is nothing to compare
    with, and the error of the first master if all are refused.
    """
    system = system if isinstance(system, System) else System.load(system)
    mono = system.monolithic
    if mono is None or not mono.compare:
        raise InputError(
            f"{system.name} has no mechanism to compare with; give [monolithic] a mechanism, and compare = {{ "
            '"COMPONENT.OUTPUT" = "OUTPUT" }'
        )
    if not isinstance(halvings, int) or not 0 <= halvings <= 12:
        raise InputError(f"{system.name}: {halvings} halvings; give a whole number from 0 to 12")
    if unknown := [each for each in masters if each not in MASTERS]:
        raise InputError(f"{system.name}: there is no master {unknown[0]!r}; use {in_words(list(MASTERS))}")
    count = round((system.stop_time - system.start_time) / system.communication_step)
    if count < 1 or abs(count * system.communication_step - (system.stop_time - system.start_time)) > 1e-9:
        raise InputError(f"{system.name}: the time from start to stop is no whole number of communication steps")
    if system.start_time:
        raise InputError(f"{system.name}: a study of coupling starts at 0 s, as the monolithic mechanism does")
    finest = system.communication_step / 2**halvings
    reference, inexact, units = _reference(system, mono, finest, tolerance)
    limits: dict[str, float] | None = None
    cases: list[Case] = []
    refused: dict[str, AlfmuError] = {}
    runs = [(master, system.communication_step / 2**k) for master in masters for k in range(halvings + 1)]
    bonds: list[Bond] = []
    for master, step in progress(runs):
        if master in refused:
            continue
        try:
            if limits is None:
                limits = _limits(system.changed(master=master), mono, units, tolerance)
            case, bonds = _run(system, mono, master, step, reference, finest, limits)
        except AlfmuError as error:
            refused[master] = error
        else:
            cases.append(case)
    if refused and not cases:
        raise next(iter(refused.values()))
    stable = {}
    for master in masters if stability else ():
        if master in refused:
            continue

        def fine(step: float, master: str = master) -> bool:
            return _run(system, mono, master, step, reference, finest, limits or {})[0].error <= FAR

        good = [case.step for case in cases if case.master == master and case.error <= FAR]
        stable[master] = _largest(fine, max(good, default=0.0), system.stop_time)
    said = {master: str(error) for master, error in refused.items()}
    return Coupling(system.name, dict(mono.compare), cases, stable, inexact, [bond.name for bond in bonds], said)


def _limits(system: System, mono: Monolithic, units: Mapping[str, str], tolerance: float) -> dict[str, float]:
    """Return tolerances of the components that have one; raise InputError if compared outputs do not exist."""
    with Assembly(system) as assembly:
        known = {v.name: v.unit for v in assembly.outputs}
        for name, theirs in mono.compare.items():
            if name not in known:
                raise InputError(f"{system.name} has no output {name!r}; {there_is(name, known)}")
            if known[name] not in ("", units[theirs]):
                raise InputError(
                    f"{system.name}: {name} is in {known[name]} and {theirs} in {units[theirs]}; compare outputs "
                    "with one unit"
                )
        found = [s.name for s in assembly.slaves if _LIMITED in s.ports]
    return {f"{c}.{_LIMITED}": tolerance for c in found if _LIMITED not in system.components[c].parameters}


def _reference(
    system: System, mono: Monolithic, finest: float, tolerance: float
) -> tuple[dict[str, NDArray[np.float64]], float, Mapping[str, str]]:
    """Return the compared outputs of the equivalent mechanism at all communication points of the finest run, their
    error, and the units of all."""
    if _LIMITED in mono.parameters:
        raise InputError(f"{system.name}: monolithic sets {_LIMITED}; leave it out, as the study's tolerance gives it")
    runs = []
    for halves, share in ((1, REFERENCE), (2, REFERENCE**2)):  # halved steps, for methods without error control
        limit = max(tolerance * share, 1e-13)
        recipe = of(mono.mechanism).changed(options=mono.options, parameters={_LIMITED: limit, **mono.parameters})
        names = sorted(set(mono.compare.values()))
        found = simulated(prepare(recipe, {}, mono.inputs), system.stop_time, finest / halves, inputs=mono.inputs)
        for name in names:
            if name not in found:
                raise InputError(f"{found.mechanism} has no output {name!r}; {there_is(name, found.names)}")
        runs.append({ours: found[theirs][::halves] for ours, theirs in mono.compare.items()})
    return runs[1], max(_difference(runs[0][name], runs[1][name]) for name in mono.compare), found.units


def _difference(found: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    """Return the largest difference over the largest value."""
    size = float(np.max(np.abs(wanted), initial=0.0))
    far = float(np.max(np.abs(found - wanted), initial=0.0))
    return far / size if size else far


def _run(
    system: System,
    mono: Monolithic,
    master: str,
    step: float,
    reference: Mapping[str, NDArray[np.float64]],
    finest: float,
    limits: Mapping[str, float],
) -> tuple[Case, list[Bond]]:
    """Return one run of the system against the reference."""
    began = time.perf_counter()
    span = system.stop_time
    with Assembly(system.changed(master=master, communication_step=step), limits, observed=True) as unit:
        bonds = _bonds(system, unit.links)
        why = ""
        try:
            result = simulation.run(unit, span, step)
        except AlfmuError as error:  # a diverging value is rejected as an input
            if not isinstance(error.result, Result):
                raise
            result, why = error.result, str(error)
        at, made, passed = _energy(unit, bonds)
        tries = 1.0 if master != "iterated" else unit.iterations / max(1, unit.steps)
    errors: dict[str, float] = {}
    for name in mono.compare:
        times = np.arange(len(reference[name])) * finest
        places = np.round(result.time / finest).astype(int)
        on_grid = np.all(np.abs(result.time - places * finest) < 1e-9 * span)
        # Only the search for stable steps has points between those of the reference.
        found = reference[name][np.minimum(places, len(times) - 1)]
        wanted = found if on_grid else np.interp(result.time, times, reference[name])
        errors[name] = _difference(result[name], wanted)
    worst = math.inf if why else max(errors.values())
    energy = float(np.max(np.abs(made), initial=0.0)) if bonds else math.nan
    worst = worst if math.isfinite(worst) else math.inf
    return Case(master, step, worst, errors, energy, passed, tries, time.perf_counter() - began, why, at, made), bonds


def _largest(fine: Callable[[float], bool], good: float, span: float) -> tuple[float, bool]:
    """Return the largest stable step, up to a quarter of the run, and whether a longer one was unstable."""
    most = span / 4
    if not good:
        return 0.0, True
    bad = good
    while bad < most:
        bad = min(2 * good, most)
        if not fine(bad):
            break
        good = bad
    else:
        return good, False
    while bad / good > FOUND:
        middle = math.sqrt(good * bad)
        if fine(middle):
            good = middle
        else:
            bad = middle
    return good, True


def _bonds(system: System, links: Sequence[Link]) -> list[Bond]:
    """Return the power bonds of a system: the named ones, or all that its units and connections imply."""
    by_source: dict[str, list[int]] = {}
    for k, each in enumerate(links):
        by_source.setdefault(each.given.source, []).append(k)

    def bond(i: int, j: int) -> Bond:
        return Bond(i, j, f"{links[i].given.source} and {links[j].given.source}")

    if system.bonds is not None:
        found = []
        for effort, flow in system.bonds:
            pairs = [
                (i, j)
                for i in by_source[effort]
                for j in by_source[flow]
                if links[i].source[0] == links[j].target[0] and links[j].source[0] == links[i].target[0]
            ]
            if len(pairs) != 1:
                raise InputError(
                    f"{system.name}: {effort} and {flow} are not a bond; give an effort and the flow on its way back, "
                    "between two components"
                )
            found.append(bond(*pairs[0]))
        return found
    efforts = {_exponents(name) for name in _EFFORTS}
    candidates = [
        (i, j)
        for i, one in enumerate(links)
        for j, other in enumerate(links)
        if one.source[0] == other.target[0] and other.source[0] == one.target[0] and one.smooth and other.smooth
        if _of(one) in efforts and _watts(one, other)
    ]
    # If several flows match one effort, the system must name the bond.
    alone = [pair for pair in candidates if sum(set(pair) & set(other) != set() for other in candidates) == 1]
    return [bond(*pair) for pair in alone]


def _exponents(name: str) -> tuple[tuple[str, int], ...]:
    return tuple(sorted((base, power) for base, power in UNITS[name].exponents.items() if base != "rad"))


def _of(link: Link) -> tuple[tuple[str, int], ...] | None:
    m = link.ends[1].measure
    return None if m is None else tuple(sorted((base, power) for base, power in m.exponents if base != "rad"))


def _watts(one: Link, other: Link) -> bool:
    """Return whether the product of two signals is a power."""
    product: dict[str, int] = {}
    for each in (one, other):
        for base, power in _of(each) or (("?", 1),):
            product[base] = product.get(base, 0) + power
    return {base: power for base, power in product.items() if power} == dict(_exponents("W"))


def _energy(unit: Assembly, bonds: Sequence[Bond]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return times, the energy created by coupling up to each [J], and the total energy through the bonds [J]."""
    at, made, passed = [unit.system.start_time], [0.0], 0.0
    weights = np.array([1.0, 4.0, 1.0]) / 6
    for begin, h, taken, given in unit.observed:
        change = 0.0
        for bond in bonds:
            i, j = bond.effort, bond.flow
            # Units of the inputs, whose product is in W if both are SI units.
            scale = unit.links[i].ends[1].measure.factor * unit.links[j].ends[1].measure.factor  # type: ignore[union-attr]
            power = taken[:, i] * given[:, j] - given[:, i] * taken[:, j]
            change += h * scale * float(weights @ power)
            passed += h * scale * float(weights @ np.abs(given[:, i] * given[:, j]))
        at.append(begin + h)
        made.append(made[-1] + change)
    return np.array(at), np.array(made), passed
