"""Equilibria: positions where loads, springs and reactions balance, searched from many starts, with their stability.

A mechanism is in equilibrium at q if Phi(q) = 0 and the loads do no work on any motion, N' f(q) = 0 with C N = 0; then
multipliers balance them, f = C' lam, for redundant constraints and any masses. Newton's method runs on the positions
that close the loops, with the exact stiffness K = -N' d(f - C' lam)/dq N.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from ..kernel.symbolic import ROUND_OFF
from ..model.calls import asked
from ..model.errors import InputError
from ..model.files import path_for, write
from ..model.words import counted, in_words
from ..simulation.result import Signal
from .branches import polished, ways
from .laws import check_at_rest, driving, held_still
from .loops import REACH, STEP, Loops, WithStates, arm_of, evenly, plain
from .situation import Situation, Subject, Vector, begun
from .small import ZERO, Small, small_motions

if TYPE_CHECKING:
    from ..view.picture import Drawing

STARTS = 32
"""Default number of positions beside the start from which equilibria are searched [1]; 16 of them suffice for the four
of the double pendulum."""

BALANCED = 1e-11
"""Load along a motion over the largest encountered [1] below which a mechanism is in equilibrium."""

SAME = 1e-5
"""Largest difference [rad, sizes] of positions that count as one equilibrium; if a stiffness vanishes, Newton's method
ends some 1e-6 from it."""

STEPS, SHORTENED = 80, 1000
"""Largest number of steps of Newton's method from a position, and of those that are shortened to `STEP` [1]: 300 rad,
as to the position of rest of a drum on a soft spring of many turns."""

HELD = 1e-7
"""Unbalanced generalised force over the largest load [1] above which reactions at a singular position do not balance
the loads."""

FLAT = 1e-9
"""Stiffness over the largest [1] below which it counts as zero."""

PACE = 0.05
"""Step along a motion of one degree of freedom [rad, sizes]: equilibria closer to each other may be missed."""

ROUND = 1000
"""Largest number of steps along such a motion [1]: 50 rad."""

MOST_WAYS = 64
"""Largest number of such searches [1]: one in each direction of every branch at every singular position reached."""


@dataclass(frozen=True)
class Equilibrium:
    """An equilibrium of a mechanism."""

    mechanism: str
    time: float
    """Time [s] at which loads are evaluated."""
    coordinates: Mapping[str, float]
    """Coordinates by name [m or rad]."""
    inputs: Mapping[str, float]
    """Inputs by name, held constant."""
    states: Mapping[str, float]
    """States of the mechanism by name, at their equilibrium values."""
    outputs: Mapping[str, float]
    """All outputs at rest, including reactions; those of redundant constraints have least norm."""
    stability: str
    """"stable", "asymptotically stable", "unstable" or "not judged"."""
    reason: str
    """Reason why the stability is not judged, or the criterion that decides it."""
    eigenvalues: NDArray[np.complex128] = field(repr=False)
    """Eigenvalues of small motions about the equilibrium [1/s]; empty if unknown."""
    residual: float
    """Residual of the balance: the largest generalised force on a coordinate [N, or N.m]."""
    connected: bool
    """Whether a path from the start was found on which the loops stay closed."""
    isolated: bool
    """Whether the equilibrium is isolated, not one of a continuous family."""
    energy: float
    """Potential energy of gravity and springs [J]."""
    loads: Vector = field(repr=False)
    """Generalised forces (n,) that reactions balance [N or N.m]."""
    distance: float
    """Largest difference of a coordinate from the start [rad, and lengths over the size of the mechanism]."""
    situation: Situation = field(repr=False, compare=False)

    def __repr__(self) -> str:
        return f"Equilibrium({self.mechanism!r}, {self.said()})"

    @property
    def q(self) -> Vector:
        """Coordinates (n,) [m or rad]."""
        return self.situation.state.q

    @property
    def held_by(self) -> list[str]:
        """Efforts of the prescribed motions that hold the mechanism, as lines of text."""
        where, units = self.situation, {v.name: v.unit for v in self.situation.equations.outputs}
        rows = zip(where.equations.rows, where.held, strict=True)
        motions = [row.name for row, on in rows if on and row.direction == "motion"]
        names = [f"{name}.{what}" for name in motions for what in ("torque", "force", "driving_force")]
        return [f"{name} = {self.outputs[name]:.6g} {units[name]}" for name in names if name in self.outputs]

    @property
    def kept(self) -> Vector:
        """Stored values that determine the equilibrium beside the parameters: displacements of locks, and signals."""
        return self.situation.p[len(self.situation.equations.parameters) :]

    @property
    def _units(self) -> dict[str, str]:
        e = self.situation.equations
        return {v.name: v.unit for v in (*e.coordinates, *e.states)}

    def said(self) -> str:
        """A line of text."""
        shown = ", ".join(
            f"{name} = {plain(x, self._units[name])}" for name, x in list(self.coordinates.items())[:_SHOWN]
        )
        return f"{self.stability}, {shown}"

    @property
    def stable(self) -> bool:
        """Whether the equilibrium was found stable."""
        return self.stability in ("stable", "asymptotically stable")

    @property
    def frequencies(self) -> Vector:
        """Frequencies of small vibrations about it [Hz], in rising order; motions without stiffness have none."""
        least = ZERO * np.abs(self.eigenvalues).max(initial=0.0)
        return np.sort(np.array([x.imag for x in self.eigenvalues if x.imag > least])) / (2 * math.pi)

    def draw(self, size: tuple[int, int] | None = None) -> Drawing:
        """Return a drawing of the mechanism in this position. Raises InputError if only its equations are known."""
        from ..view.picture import SIZE, Drawing, view_of
        from ..view.shapes import geometry

        shapes = geometry(self.situation.source.drawn(), self.situation.parameters)
        columns = {name: self.outputs[name] for name in shapes.columns}
        caption = f"{self.stability}, " + ", ".join(f"{k} = {x:.3g}" for k, x in list(self.coordinates.items())[:3])
        return Drawing(shapes, columns, view_of(shapes, columns), {}, caption, size or SIZE)

    def as_data(self) -> dict[str, Any]:
        """Return all of it as data for JSON."""
        plain = ("stability", "reason", "residual", "connected", "isolated", "energy", "distance")
        return {
            **{name: getattr(self, name) for name in plain},
            "coordinates": dict(self.coordinates),
            "states": dict(self.states),
            "eigenvalues": [[x.real, x.imag] for x in self.eigenvalues.tolist()],
            "outputs": dict(self.outputs),
        }


@dataclass(frozen=True)
class Equilibria(Sequence[Equilibrium]):
    """Equilibria, the nearest to the start first; a sequence of `Equilibrium`."""

    mechanism: str
    time: float
    found: tuple[Equilibrium, ...]
    starts: int
    """Number of positions from which they were searched."""
    notes: tuple[str, ...] = ()
    """Limitations of the search, as sentences."""

    def __repr__(self) -> str:
        return f"Equilibria({self.mechanism!r}, {counted(len(self), 'position')} of rest)"

    def __len__(self) -> int:
        return len(self.found)

    def __iter__(self) -> Iterator[Equilibrium]:
        return iter(self.found)

    @overload
    def __getitem__(self, index: int) -> Equilibrium: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Equilibrium, ...]: ...
    def __getitem__(self, index: int | slice) -> Equilibrium | tuple[Equilibrium, ...]:
        return self.found[index]

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Equilibria that were found stable."""
        return tuple(each for each in self.found if each.stable)

    @property
    def nearest(self) -> Equilibrium:
        """The default start of a run: the nearest stable one connected with the start, else the nearest stable one,
        else the nearest."""
        if not self.found:
            raise InputError(f"{self.mechanism}: no position of rest was found; {self.notes[-1]}")
        ranked = sorted(self.found, key=lambda each: (not (each.stable and each.connected), not each.stable))
        return ranked[0]

    def as_data(self) -> dict[str, Any]:
        """Return all of it as data for JSON."""
        known = {"mechanism": self.mechanism, "time": self.time, "starts": self.starts, "notes": list(self.notes)}
        inputs = dict(self.found[0].inputs) if self.found else {}
        return {**known, "inputs": inputs, "equilibria": [each.as_data() for each in self.found]}

    @asked
    def save(self, path: str | Path) -> None:
        """Write all of it as `.json`. Raises InputError if the suffix is another one, else WriteError."""
        path = path_for("positions of rest", path)
        write(path, (json.dumps(self.as_data(), indent=1) + "\n").encode())

    def lines(self) -> list[str]:
        """Return a table as lines of text."""
        title = f"{self.mechanism}: {counted(len(self), 'position')} of rest, loads at t = {self.time:g} s"
        lines = [title]
        if self.found and self.found[0].inputs:
            lines += ["inputs: " + ", ".join(f"{name} = {x:g}" for name, x in self.found[0].inputs.items())]
        for k, each in enumerate(self.found):
            slowest = f", frequencies {_listed(each.frequencies)} Hz" if len(each.frequencies) else ""
            grows = max((x.real for x in each.eigenvalues), default=0.0)
            grows_by = f", grows by {grows:.4g} 1/s" if each.stability == "unstable" else ""
            where = "" if each.connected else ", no path from the start found"
            beside = "" if each.isolated else ", one of a continuum"
            lines += [f"{k + 1:3}  {each.stability}{slowest}{grows_by}{beside}{where}"]
            if each.stability == "not judged":
                lines += [f"     {each.reason}"]
            lines += [f"     {text}" for text in _columns({**each.coordinates, **each.states}, each._units)]
            lines += ["     held by " + ", ".join(each.held_by)] * bool(each.held_by)
            lines += [f"     balance within {each.residual:.1e} N, N.m"]
        return [*lines, *self.notes]


_SHOWN = 12
"""Number of coordinates in a table."""


def _columns(coordinates: Mapping[str, float], units: Mapping[str, str]) -> list[str]:
    texts = [f"{name} = {plain(x, units[name])}" for name, x in list(coordinates.items())[:_SHOWN]]
    more = [f"and {len(coordinates) - _SHOWN} more"] if len(coordinates) > _SHOWN else []
    each = [*texts, *more]
    return ["  ".join(each[begin : begin + 5]) for begin in range(0, len(each), 5)]


def _listed(values: Sequence[float] | Vector) -> str:
    shown = ", ".join(f"{x:.4g}" for x in values[:4])
    return shown + ", ..." * (len(values) > 4)


def equilibrium(
    mechanism: Subject,
    *,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    time: float = 0.0,
    starts: int = STARTS,
) -> Equilibria:
    """Return the equilibria of a mechanism under its loads and springs, stable or not, the nearest to the start first.

    `mechanism` is a mechanism as for `simulate`, but no FMU; or an `Instance` with its present values and inputs.
    `parameters` sets parameters, start values and inputs by name, `inputs` gives inputs over time as `simulate` takes
    them, and loads and inputs are evaluated at `time` [s]. The search begins at the start and at `starts` other
    positions, the same each time: on the motions that begin at the start, and, to find other assemblies, anywhere.
    Redundant constraints, singular positions and massless bodies are allowed; the stability of a singular position is
    not judged.

    Inputs and laws of time that prescribe motion are held at their values at that time. Dry friction is left out:
    positions where it balances the loads lie around the equilibria without it. States are in equilibrium, too; states
    without an equilibrium value of their own, such as the integral of a controller, determine the position.

    Raises AlfmuError if a name or a value is invalid, or the loops cannot be closed, InputError if a law of time
    prescribes motion at that time.
    """
    if isinstance(starts, bool) or not isinstance(starts, int) or starts < 0:
        name = getattr(mechanism, "name", "") or mechanism
        raise InputError(f"{name}: starts is {starts!r}; it must be a whole number, 0 or above")
    return equilibria(begun(mechanism, parameters or {}, inputs or {}, time), starts)


def equilibria(where: Situation, starts: int = STARTS) -> Equilibria:
    """Return the equilibria of a situation."""
    frictions = ", ".join(x.name for x in where.equations.frictions)
    where, moved = held_still(where.without_friction())
    check_at_rest(where, where.at_rest(where.state.q))
    size = REACH * arm_of(where)
    loops = Loops(where, settled=True, size=size)
    unsettled = loops.unsettled()
    search = _Search(WithStates(where, size) if unsettled else loops)
    found = search.all(starts)
    notes = search.notes(found)
    if unsettled and not found:
        notes[-1] = (
            f"no position was found where loads balance and the rates of {', '.join(unsettled)} vanish; no values of "
            "the states alone make these rates zero"
        )
    if moved:
        notes.append(f"inputs that prescribe motion are held at their values: {', '.join(moved)}")
    if frictions:
        notes.append(
            f"dry friction is left out ({frictions}): where it holds, positions beside these are positions of rest too"
        )
    return Equilibria(where.name, where.state.t, tuple(found), 1 + starts, tuple(notes))


class _Search:
    """A search for equilibria."""

    def __init__(self, loops: Loops):
        self.loops = loops
        self.largest = 0.0
        """Largest load along a motion encountered."""
        self._meet(loops.balance(loops.home)[1])
        for way in (sign * way for way in loops.motions(loops.home).T for sign in (0, 1, -1)):
            if (y := loops.closed(loops.home + STEP * way)) is not None:
                self._meet(loops.balance(y)[1])

    def all(self, starts: int) -> list[Equilibrium]:
        """Return the equilibria found, the nearest first."""
        loops = self.loops
        if not math.isfinite(self._left(loops.home)) and self.largest == 0.0:
            raise InputError(
                f"{loops.situation.name}: loads are not finite at the start nor beside it, as that of a spring between "
                "points that coincide; start elsewhere"
            )
        if self.largest == 0.0:  # without loads every position is an equilibrium
            return [self._judged(loops.home, True)]
        reached = [(y, True) for y in map(self.balanced, self._along(starts)) if y is not None]
        others = [(y, False) for y in map(self.balanced, self._anywhere(starts)) if y is not None]
        distinct: list[tuple[Vector, bool]] = []
        for y, connected in sorted([*reached, *others], key=lambda x: (not x[1], loops.apart(x[0], loops.home))):
            y = loops.nearer(y, loops.home)
            if self._at_rest(y) and not any(loops.same(y, other, SAME) for other, _ in distinct):
                distinct.append((y, connected))
        found: list[Equilibrium] = []
        for y, connected in sorted(distinct, key=lambda x: float(np.abs(x[0] - loops.home).max(initial=0.0))):
            each = self._judged(y, connected)
            held = each.residual <= HELD * max(self.largest / self.loops.scale.min(), np.abs(each.loads).max())
            if held and (each.isolated or not any(_family(each, other) for other in found)):
                found.append(each)
        return found

    def notes(self, found: Sequence[Equilibrium]) -> list[str]:
        """Return the limitations of the search, as sentences."""
        notes, where = [], self.loops.situation
        if angles := list(where.equations.counted):
            notes.append(f"{in_words(angles)} counted from the start: looked for within half a turn of it only")
        if self.largest == 0.0 and self.loops.freedom:
            notes.append("no load acts on any motion: every position is one of rest")
        elif any(not each.isolated for each in found):
            notes.append(
                "positions of rest form a continuum, as loads do not act on all motions; only the nearest to the "
                "start is shown"
            )
        if not found:
            notes.append("loads are out of balance at every position tried; hold it by a spring, a lock or an input")
        return notes

    # Starts of the search ---------------------------------------------------------------------------------------------

    def _along(self, starts: int) -> Iterator[Vector]:
        """Yield the start, and positions on motions that begin there."""
        loops = self.loops
        yield loops.home
        if loops.freedom == 1 and not isinstance(loops, WithStates):
            yield from self._on_the_ways()
        elif loops.freedom > 0 and starts:
            yield from self._around(starts // 2)

    def _on_the_ways(self) -> Iterator[Vector]:
        """Yield positions near which the load along a motion with one degree of freedom vanishes, on all branches from
        the start."""
        loops, home = self.loops, self.loops.home
        (way,) = loops.motions(home).T
        crossings: list[Vector] = []
        ways = [(home, sign * way) for sign in (1, -1)]
        if loops.situation.start.freedom_here > 1:
            crossings, ways = [home], _leaving(loops, home)
        walked = 0
        while ways and walked < MOST_WAYS:
            walked += 1
            begin, way = ways.pop(0)
            for place, crossing in self._on_the_way(begin, way):
                if not crossing:
                    yield place
                elif all(loops.apart(place, other) > SAME for other in crossings):
                    crossings.append(place)
                    ways += _leaving(loops, place)

    def _on_the_way(self, begin: Vector, way: Vector) -> Iterator[tuple[Vector, bool]]:
        """Yield positions near which the load along the motion vanishes, and singular positions, marked by the flag."""
        loops, before, last, falls = self.loops, begin, None, False
        sizes: list[float] = []
        for k, y in enumerate(loops.walk(begin, way, PACE, ROUND)):
            along = (y - before) / np.linalg.norm(y - before)
            N, r, _ = loops.balance(y)
            load = float(r[0] * (np.sign(N[:, 0] @ along) or 1.0))
            self._meet(r)
            if last is not None and load * last <= 0:
                yield self._between(before, y), False
            elif last is not None and abs(load) > abs(last) and falls:
                yield before, False  # the load has a minimum here, which may be zero
            falls = last is not None and abs(load) < abs(last)
            sizes = [*sizes[-2:], float(loops.sizes(y)[-1])] if loops.rank else []
            if len(sizes) == 3 and sizes[1] < min(sizes[0], sizes[2], 2 * PACE):
                place = polished(loops, before)
                if place is not None and loops.situation.mobility(place * loops.scale)[0].freedom_here > 1:
                    yield place, True
            if (
                k > 10
                and loops.apart(y, begin) < 1.5 * PACE
                and abs(loops.nearer(y, begin) - begin) @ abs(way) < 2 * PACE
            ):
                return
            before, last = y, load

    def _between(self, a: Vector, b: Vector) -> Vector:
        """Return the position between two at which the load along the motion changes its sign."""
        loops, way = self.loops, b - a
        sign = 0.0
        for _ in range(12):
            middle = loops.closed((a + b) / 2)
            if middle is None:
                break
            loads = []
            for y in (a, middle):
                N, r, _ = loops.balance(y)
                loads.append(float(r[0] * (np.sign(N[:, 0] @ way) or 1.0)))
            sign = loads[0] * loads[1]
            a, b = (middle, b) if sign > 0 else (a, middle)
        return (a + b) / 2

    def _around(self, count: int) -> Iterator[Vector]:
        """Yield ends of motions from the start in directions of all its freedoms, up to half a turn long."""
        from scipy.special import ndtri

        loops = self.loops
        N = loops.motions(loops.home)[:, : loops.freedom]
        for numbers in evenly(loops.freedom + 1, count):
            way = N @ ndtri(0.5 + (numbers[1:] - 0.5) * (1 - 1e-9))
            if not way.any():
                continue
            most = math.ceil(numbers[0] * math.pi * math.sqrt(loops.freedom) / STEP)
            *_, end = [loops.home, *loops.walk(loops.home, way, STEP, most)]
            yield end

    def _anywhere(self, starts: int) -> Iterator[Vector]:
        """Yield positions anywhere at which the loops are closed."""
        loops = self.loops
        count = starts if loops.freedom == 1 else starts - starts // 2
        for place in loops.scattered(count if loops.situation.held.any() else 0):
            y = loops.assembled(place)
            if y is not None:
                yield y

    # Balance ------------------------------------------------------------------------------------------------------

    @property
    def _nothing(self) -> float:
        """Load that counts as zero; positions far from the origin have more round-off."""
        return max(BALANCED, ROUND_OFF * float(np.abs(self.loops.home).max(initial=0.0))) * self.largest

    def _meet(self, r: Vector) -> None:
        """Update the largest load; where a spring has no length, no load is defined."""
        if np.isfinite(r).all():
            self.largest = max(self.largest, float(np.abs(r).max(initial=0.0)))

    def _at_rest(self, y: Vector) -> bool:
        N, r, lam = self.loops.balance(y)
        known = np.isfinite(self.loops.stiffness(y, N, lam)).all()
        return bool(known and np.abs(r).max(initial=0.0) <= self._nothing)

    def _left(self, y: Vector) -> float:
        return float(np.abs(self.loops.balance(y)[1]).max(initial=0.0))

    def balanced(self, y: Vector) -> Vector | None:
        """Return an equilibrium by Newton's method in steps along the motions, None if there is none."""
        loops, damping, stalled, made, shortened = self.loops, 0.0, 0, 0, 0
        N, r, lam = loops.balance(y)
        self._meet(r)
        while self.largest > 0 and made < STEPS and shortened < SHORTENED:
            size = float(np.linalg.norm(r))
            if size == 0.0 or stalled > 2:
                break
            K = loops.stiffness(y, N, lam)
            if not np.isfinite(K).all():
                return None
            U, s, V = np.linalg.svd(K)
            low = max(damping, 1e-13) * max(s[0], 1e-100)
            dz = V.T @ (s / (s**2 + low**2) * (U.T @ r))
            part = min(1.0, STEP / max(np.abs(N @ dz).max(), 1e-100))
            dz *= part
            ahead = loops.closed(y + N @ dz, y)
            moved = None if ahead is None else loops.balance(ahead)
            if ahead is not None and moved is not None and np.linalg.norm(moved[1]) < size:
                stalled += int(np.linalg.norm(moved[1]) > 0.5 * size and size <= self._nothing)
                y, (N, r, lam) = ahead, moved
                made, shortened = made + (part == 1.0), shortened + (part < 1.0)
                damping = damping / 10 if damping > 1e-6 else 0.0
            elif size <= self._nothing:
                break
            else:
                made += 1
                damping = max(10 * damping, 1e-3)
                if damping > 1e4:
                    break
        return y if self._at_rest(y) else None

    # Properties of an equilibrium -------------------------------------------------------------------------------------

    def _judged(self, y: Vector, connected: bool) -> Equilibrium:
        loops, where = self.loops, self.loops.situation
        e, state = where.equations, loops.state(y)
        check_at_rest(where, state)
        here = replace(where, state=state)
        mobility, _ = where.mobility(state.q)
        N, _, lam = loops.balance(y)
        K = loops.stiffness(y, N, lam)
        sizes = np.linalg.svd(K, compute_uv=False)
        isolated = not len(K) or bool(sizes[-1] > FLAT * max(sizes[0], self.largest))
        small: Small | None = None
        if mobility.freedom_here > loops.freedom:
            stability = "not judged"
            reason = (
                f"it is a singular position, where {counted(mobility.freedom_here, 'velocity')} are possible with "
                f"{counted(loops.freedom, 'degree')} of freedom: linear equations of one branch do not describe the "
                "others"
            )
        else:
            try:
                small = small_motions(here, mobility.freedom)
                stability, reason = small.stability(isolated)
            except InputError as error:
                stability, reason = "not judged", str(error)
        full = np.zeros(e.l)
        full[where.held] = loops._weights * lam
        left = where.value("f", state) - where.value("C", state).T @ full
        outputs = small.readings if small else where.value("readings", state, a=np.zeros(e.n), lam=full)
        return Equilibrium(
            where.name,
            state.t,
            dict(zip((c.name for c in where.coordinates), state.q.tolist(), strict=False)),
            {x.name: x.value for x in driving(where)[: len(e.inputs)]},
            dict(zip((x.name for x in e.states), state.u[len(e.inputs) :].tolist(), strict=True)),
            dict(zip((c.name for c in e.outputs), outputs.tolist(), strict=True)),
            stability,
            reason,
            small.eigenvalues if small else np.array([], complex),
            float(np.abs(left).max(initial=0.0)),
            connected,
            isolated,
            float(where.value("potential_energy", state)[0]),
            where.value("f", state),
            float(np.abs(y - loops.home)[: e.n].max(initial=0.0)),
            here,
        )


def _family(one: Equilibrium, other: Equilibrium) -> bool:
    """Return whether two equilibria that are not isolated have the same energy and the same small motions."""
    if other.isolated or len(one.eigenvalues) != len(other.eigenvalues):
        return False
    size = max(np.abs(one.eigenvalues).max(initial=0.0), 1e-3)
    pairs = [(np.sort(part(one.eigenvalues)), np.sort(part(other.eigenvalues))) for part in (np.abs, np.real)]
    alike = all(np.abs(a - b).max(initial=0.0) < 1e-3 * size for a, b in pairs)
    return bool(alike and abs(one.energy - other.energy) <= 1e-6 * max(1e-6, abs(one.energy)))


def _leaving(loops: Loops, y: Vector) -> list[tuple[Vector, Vector]]:
    """Return a singular position with the directions of the branches that begin there."""
    found = ways(loops, y, loops.situation.mobility(y * loops.scale)[0].freedom_here)
    return [(y, sign * each.way) for each in found if not each.singular for sign in (1, -1)]
