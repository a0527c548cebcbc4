"""Degrees of freedom at a position and along a motion, with redundant and idle constraints and singular positions.

At a regular position rows with U' C = 0 depend on each other: they share a load. At a singular position more motions N
with C N = 0 begin than at regular ones; `branches` finds those that can be continued.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..equations import Equations
from ..model.calls import asked
from ..model.errors import AlfmuError, InputError
from ..model.files import path_for, write
from ..model.words import counted
from ..runtime import Instance
from ..simulation import Progress, communication_points
from ..simulation.result import Signal
from .branches import STRAIGHT, Way, polished, ways
from .laws import prescribed
from .loops import STEP, Loops, plain
from .situation import Situation, Source, Subject, Vector, begun, source, subject
from .small import independent
from .states import motion

TOUCHED = 1e-7
"""Entry of a projector [1] below which a row is not part of a dependency, or a row of C constrains nothing."""

_SHOWN = 8
"""Number of coordinates, rates or times in a text."""

MOST = 6
"""Largest number of motions at a singular position whose branches are searched [1]."""


@dataclass(frozen=True)
class Branch:
    """A motion that begins at a singular position."""

    way: Mapping[str, float]
    """Rates of the coordinates by name, scaled so that the largest is 1 [m or rad]."""
    ends: bool
    """Whether the branch continues in one direction only."""
    singular: bool
    """Whether the positions on the branch are singular, too."""

    def __repr__(self) -> str:
        return f"Branch({self.said()})"

    def said(self) -> str:
        """A line of text."""
        moving = [f"{name} {x:.4g}" for name, x in self.way.items() if abs(x) > 1e-6]
        more = [f"and {len(moving) - _SHOWN} more"] if len(moving) > _SHOWN else []
        what = ", which ends here" * self.ends + ", singular all along" * self.singular
        return ", ".join([*moving[:_SHOWN], *more]) + what


@dataclass(frozen=True)
class SingularPosition:
    """A position with more independent velocities than degrees of freedom."""

    time: float
    """Time at which the motion passes the position [s]."""
    coordinates: Mapping[str, float]
    """Coordinates by name [m or rad]."""
    angles: tuple[str, ...]
    """Names of the coordinates in rad."""
    motions: int
    """Independent velocities that constraints allow there."""
    branches: tuple[Branch, ...]
    """Motions that begin there; empty if they cannot be determined, see `reason`."""
    followed: int | None
    """Index of the branch of the motion; None if unknown."""
    reason: str
    """Reason why branches cannot be determined; empty if they can."""

    def __repr__(self) -> str:
        return f"SingularPosition(t = {self.time:.6g} s, {counted(len(self.branches), 'branch')})"


@dataclass(frozen=True)
class Group:
    """Constraints that depend on each other."""

    rows: tuple[str, ...]
    redundant: int
    """Number of redundant constraints among them."""

    def __repr__(self) -> str:
        return f"Group({self.redundant} of {', '.join(self.rows)})"


@dataclass(frozen=True)
class Freedoms:
    """Degrees of freedom of a mechanism, at its start and along its motion."""

    mechanism: str
    freedom: int
    """Degrees of freedom at regular positions."""
    redundant: int
    """Constraints that depend on the others at every position."""
    freedom_here: int
    """Independent velocities at the start; more than `freedom` if the start is singular."""
    independent: tuple[str, ...]
    """Coordinates that describe the motions best."""
    groups: tuple[Group, ...]
    """Redundant constraints, with those on which they depend."""
    idle: tuple[str, ...]
    """Constraints in force that constrain no motion, neither at the start nor near it."""
    off: tuple[str, ...]
    """Constraints that are not in force: open locks, released joints."""
    start: SingularPosition | None
    """The start, if it is singular."""
    singular: tuple[SingularPosition, ...]
    """Singular positions along the motion, without the start."""
    covered: tuple[float, float]
    """Interval [s] over which the motion was followed; both ends are equal if it was not."""
    least: float
    """Smallest singular value of the constraint matrix along the motion that vanishes at singular positions [1]: for
    links of similar lengths about the distance to one [rad]."""
    least_at: float
    """Time at which it occurred [s]."""
    changes: tuple[tuple[float, int], ...] = ()
    """Times [s] at which constraints were switched, and the degrees of freedom after each."""
    notes: tuple[str, ...] = field(default=())

    def __repr__(self) -> str:
        found = f", {counted(len(self.singular), 'singular position')} on the way" * bool(self.singular)
        return f"Freedoms({self.mechanism!r}, freedom = {self.freedom}, redundant = {self.redundant}{found})"

    def as_data(self) -> dict[str, Any]:
        """Return all of it as data for JSON."""

        def position(each: SingularPosition | None) -> dict[str, Any] | None:
            if each is None:
                return None
            known = {name: getattr(each, name) for name in ("time", "motions", "followed", "reason")}
            found = [{"way": dict(b.way), "ends": b.ends, "singular": b.singular} for b in each.branches]
            return {**known, "coordinates": dict(each.coordinates), "branches": found}

        plain = ("mechanism", "freedom", "redundant", "freedom_here", "least", "least_at")
        lists = ("independent", "idle", "off", "covered", "changes", "notes")
        return {
            **{name: getattr(self, name) for name in plain},
            **{name: list(getattr(self, name)) for name in lists},
            "groups": [{"rows": list(each.rows), "redundant": each.redundant} for each in self.groups],
            "start": position(self.start),
            "singular": [position(each) for each in self.singular],
        }

    @asked
    def save(self, path: str | Path) -> None:
        """Write all of it as `.json`. Raises InputError if the suffix is another one, else WriteError."""
        path = path_for("degrees of freedom", path)
        write(path, (json.dumps(self.as_data(), indent=1) + "\n").encode())

    def lines(self) -> list[str]:
        """Return a text as lines."""
        lines = [f"{self.mechanism}: {counted(self.freedom, 'degree')} of freedom"]
        lines += [f"determined by: {', '.join(self.independent) or 'nothing, as constraints leave no freedom'}"]
        lines += [f"redundant constraints: {self.redundant}"]
        for group in self.groups:
            lines += [f"  {group.redundant} of {len(group.rows)}: {', '.join(group.rows)}"]
        for title, names in (("idle constraints", self.idle), ("not in force", self.off)):
            lines += [f"{title}: {', '.join(names)}"] * bool(names)
        if self.start:
            lines += ["singular at the start:", *_position(self.start)]
        if self.covered[1] > self.covered[0]:
            span = f"along the motion from {self.covered[0]:g} to {self.covered[1]:g} s"
            what = counted(len(self.singular), "singular position") if self.singular else "no singular position"
            lines += [f"{span}: {what}"]
            for same in _alike(self.singular):
                times = [f"{each.time:.6g}" for each in same[:_SHOWN]]
                more = [f"and {len(same) - _SHOWN} more times"] if len(same) > _SHOWN else []
                lines += [f"  at t [s] = {', '.join([*times, *more])}", *_position(same[0])]
            if not self.singular and not self.start:
                lines += [f"  nearest to one at t = {self.least_at:.6g} s: singular value {self.least:.3g}"]
            lines += [f"  from t = {t:g} s: {counted(freedom, 'degree')} of freedom" for t, freedom in self.changes]
        return [*lines, *self.notes]


def _position(each: SingularPosition) -> list[str]:
    units = dict.fromkeys(each.angles, "rad")
    shown = [f"{name} = {plain(x, units.get(name, '1'))}" for name, x in each.coordinates.items()]
    more = [f"and {len(shown) - _SHOWN} more"] if len(shown) > _SHOWN else []
    lines = [f"    {', '.join([*shown[:_SHOWN], *more])}"]
    found = len(each.branches)
    lines += [f"    {each.motions} independent velocities, {found} branch{'es' * (found != 1)}"]
    for k, branch in enumerate(each.branches):
        lines += [f"      {branch.said()}{'  <- the motion' * (k == each.followed)}"]
    return [*lines, *([f"    {each.reason}"] if each.reason else [])]


def _alike(found: Sequence[SingularPosition]) -> list[list[SingularPosition]]:
    """Return singular positions grouped by equality."""
    groups: list[list[SingularPosition]] = []
    for each in found:
        place = np.array([*each.coordinates.values()])
        for group in groups:
            other = np.array([*group[0].coordinates.values()])
            if np.abs(place - other).max() < 1e-6 and each.followed == group[0].followed:
                group.append(each)
                break
        else:
            groups.append([each])
    return groups


def mobility(
    mechanism: Subject,
    *,
    stop_time: float | None = None,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    time: float = 0.0,
    progress: Progress = iter,
) -> Freedoms:
    """Return degrees of freedom, redundant and idle constraints by name, and singular positions with their branches.

    `mechanism` is a mechanism as for `simulate`, but no FMU; or an `Instance`, of which only the present position is
    analysed. The motion is followed from the start to `stop_time` [s], by default that of the mechanism's own
    experiment, 0 for the start alone. `parameters` sets parameters, start values and inputs by name, `inputs` gives
    inputs over time and `progress` shows progress, as for `simulate`. With `time` [s] only the position that laws of
    time prescribe at that time is analysed. Prescribed motions count as constraints, dry friction does not.

    Raises AlfmuError if a name or a value is invalid, or the loops cannot be closed.
    """
    if isinstance(mechanism, Instance):
        if stop_time:
            raise InputError(
                f"{mechanism.name}: only the present position of an Instance is analysed; leave stop_time out"
            )
        return freedoms(subject(mechanism, parameters))
    found = source(mechanism, parameters or {})
    if stop_time and time:
        raise InputError(
            f"{found.equations.name}: only the position at {time!r} s is analysed, and a motion begins at 0 s; "
            "give time or stop_time"
        )
    stop_time = (0.0 if time else found.equations.stop_time) if stop_time is None else stop_time
    where = begun(found, {}, inputs or {}, time)
    if not stop_time:
        return freedoms(where)
    times = communication_points(where.name, stop_time, found.equations.interval)
    return freedoms(where, found, times, inputs, progress)


def freedoms(
    where: Situation,
    source: Source | None = None,
    times: Sequence[float] | Vector = (),
    inputs: Mapping[str, Signal] | None = None,
    progress: Progress = iter,
) -> Freedoms:
    """Return the degrees of freedom of a situation, and along the motion at instants [s] if any are given."""
    where = where.without_friction()
    e, here = where.equations, where.start
    rubbing = [x.row for x in e.frictions]
    loops = Loops(where)
    singular = here.freedom_here > here.freedom
    start = _singular(loops, loops.home, where.state.t, where.state.v) if singular else None
    beside = _beside(loops, start)
    groups = _groups(loops, beside)
    matrices = [np.abs(loops.matrix(y)) for y in (loops.home, beside)]
    names = [row.text for row in e.rows]
    off = [i for i in range(e.l) if not where.held[i] and i not in rubbing]
    held = np.flatnonzero(where.held)
    idle = [names[i] for k, i in enumerate(held) if max(C[k].max(initial=0.0) for C in matrices) < TOUCHED]
    way = _Way(loops, where)
    if source is not None:
        way.follow(source, progress([float(t) for t in times]), inputs or {})
    return Freedoms(
        where.name,
        here.freedom,
        here.redundant,
        here.freedom_here,
        tuple(e.coordinates[i].name for i in independent(where, loops.motions(beside))),
        groups,
        tuple(idle),
        tuple(names[i] for i in off),
        start,
        tuple(way.singular),
        (where.state.t, way.until),
        way.least,
        way.least_at,
        tuple(way.changes),
        (*prescribed(where), *_left_out(e), *way.notes),
    )


def _left_out(e: Equations) -> list[str]:
    """Return the note that dry friction is left out."""
    names = ", ".join(x.name for x in e.frictions)
    return [f"dry friction ({names}) is no constraint here, though a joint that sticks has no motion"] * bool(names)


def _beside(loops: Loops, start: SingularPosition | None) -> Vector:
    """Return a regular position: the start, or one on a branch that begins there, preferably that of the motion."""
    where = loops.situation
    if start is None:
        return loops.home
    if start.branches:
        branch = start.branches[start.followed or 0]
        way = np.array([branch.way[c.name] for c in where.coordinates]) / loops.scale
        found = loops.closed(loops.home + STEP * way / np.abs(way).max())
        if found is not None and where.mobility(found * loops.scale)[0].freedom_here == loops.freedom:
            return found
    return where.mobility(where.state.q)[1] / loops.scale


def _groups(loops: Loops, y: Vector) -> tuple[Group, ...]:
    """Return constraints in force that depend on each other at a regular position."""
    from scipy.sparse.csgraph import connected_components

    where = loops.situation
    names = [row.text for row, on in zip(where.equations.rows, where.held, strict=True) if on]
    null = loops.parts(loops.matrix(y))[0][:, loops.rank :]
    shared = null @ null.T
    if not shared.any():
        return ()
    _, labels = connected_components(np.abs(shared) > TOUCHED)
    found = []
    for label in dict.fromkeys(labels[shared.diagonal() > TOUCHED].tolist()):
        rows = np.flatnonzero(labels == label)
        found.append(Group(tuple(names[i] for i in rows), round(np.trace(shared[np.ix_(rows, rows)]))))
    return tuple(found)


def _singular(loops: Loops, y: Vector, t: float, v: Vector) -> SingularPosition:
    """Return the properties of a singular position passed with velocity v (n,)."""
    e = loops.situation.equations
    motions = loops.situation.mobility(y * loops.scale)[0].freedom_here
    found: list[Way] = []
    reason, followed = "", None
    if e.timed:
        reason = "branches are not determined if laws of time or inputs prescribe motion"
    elif loops.freedom != 1:
        reason = f"branches are not separated: with {loops.freedom} degrees of freedom they are surfaces, not lines"
    elif motions > MOST:
        reason = f"branches are not separated: {motions} motions can cross in up to {2 ** (motions - 1)} branches"
    else:
        found = ways(loops, y, motions)
        if not found:
            reason = (
                "no motion to second order begins here: either the mechanism is locked, or its branches are tangent "
                "to each other, which this analysis does not tell apart"
            )
    speed = np.linalg.norm(v / loops.scale)
    if speed > 0 and found:
        cosines = [abs(each.way @ (v / loops.scale)) / speed for each in found]
        followed = int(np.argmax(cosines)) if max(cosines) > 1 - STRAIGHT / 4 else None
    names = [c.name for c in loops.situation.coordinates]
    each = []
    for branch in found:
        way = branch.way * loops.scale
        rates = way / way[np.argmax(np.abs(way))] + 0.0
        each.append(Branch(dict(zip(names, rates.tolist(), strict=False)), branch.ends, branch.singular))
    place = dict(zip(names, (y * loops.scale).tolist(), strict=False))
    angles = tuple(c.name for c in loops.situation.coordinates if c.unit == "rad")
    return SingularPosition(t, place, angles, motions, tuple(each), followed, reason)


# Along a motion ----------------------------------------------------------------------------------------------------


class _Way:
    """The motion from the start, with its singular positions."""

    def __init__(self, loops: Loops, where: Situation):
        self.loops = loops
        self.until = self.least_at = where.state.t
        self.least = float(loops.sizes(loops.home)[-1]) if loops.rank else 1.0
        self.singular: list[SingularPosition] = []
        self.changes: list[tuple[float, int]] = []
        self.notes: list[str] = []

    def follow(self, source: Source, times: Iterable[float], inputs: Mapping[str, Signal]) -> None:
        """Follow the motion at these instants, up to its end if it ends early."""
        loops = self.loops
        passed: list[tuple[float, Vector, Vector, float]] = []
        on, freedom = loops.situation.held, loops.freedom
        try:
            for t, there in motion(source, times, inputs):
                where = there.without_friction()
                if not np.array_equal(where.held, on):
                    loops, on, passed = Loops(where), where.held, []
                    if loops.freedom != freedom:
                        freedom = loops.freedom
                        self.changes.append((t, freedom))
                elif where.equations.followed:  # signals store new polynomials at each instant
                    loops = Loops(where)
                y, v = where.state.q / loops.scale, where.state.v / loops.scale
                size = float(loops.sizes(y)[-1]) if loops.rank else 1.0
                passed.append((t, y, v, size))
                self.until = t
                if size < self.least:
                    self.least, self.least_at = size, t
                if len(passed) > 2:
                    self._between(loops, passed[-3:])
        except AlfmuError as ended:
            self.notes.append(f"the motion ended at t = {self.until:g} s: {ended}")

    def _between(self, loops: Loops, three: list[tuple[float, Vector, Vector, float]]) -> None:
        """Add a singular position if the singular value has a minimum near the second of three instants."""
        from scipy.interpolate import CubicHermiteSpline
        from scipy.optimize import minimize_scalar

        times, places, rates, (a, b, c) = zip(*three, strict=True)
        t0, _, t2 = times
        if not (b <= a and b < c) or b > 0.5:
            return
        # The singular value falls and rises at equal rates at a singular position: this checks for a zero between.
        if b > 1.2 * max(abs(a - b), abs(c - b)) + 1e-12:
            return
        at = CubicHermiteSpline(times, places, rates)
        found = minimize_scalar(
            lambda t: loops.sizes(at(t))[-1], bounds=(t0, t2), options={"xatol": 1e-9 * (t2 - t0)}, method="bounded"
        )
        t = float(found.x)
        y = polished(loops, at(t))
        if y is None:
            return
        there, _ = loops.situation.mobility(y * loops.scale)
        if there.freedom_here > there.freedom:
            v = (at(min(t + 1e-4 * (t2 - t0), t2)) - at(max(t - 1e-4 * (t2 - t0), t0))) * loops.scale
            self.least, self.least_at = min(self.least, float(loops.sizes(y)[-1])), t
            if loops.situation.equations.timed and not loops.freedom:
                t = float(y[-1])
            if self.singular and abs(self.singular[-1].time - t) < 0.5 * (t2 - t0):
                return
            self.singular.append(_singular(loops, y, t, v))
