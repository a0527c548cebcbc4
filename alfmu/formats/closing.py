"""Close the loops of a file before its mechanism is declared, by least squares over all coordinates within limits.

A file gives values that close its loops to some six digits, or none at all. The nearest position that closes the loops
is searched over all coordinates with weights. Only at that position do ranks determine which coordinates are
independent. These keep the values of the file if the loops close with them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ..model.mechanism import Mechanism
from ..model.parts import Constraint
from ..model.spatial import SpatialJoint
from .poses import Array, vector

_RANK = 1e-9
"""Singular value of constraints over the largest below which it counts as zero: files have some ten digits."""

_BESIDE = 1e-2
"""Distance [m, rad] of a position near the closed one: far from round-off, near on the scale of mechanisms."""

_CORRECTIONS = 12
"""Largest number of corrections that close the loops there: each at least halves a gap near a singular position."""

_GOOD = 0.1
"""Least share of a motion over the largest for which a driven joint is preferred as independent."""

_HALF = 0.5 + 1e-6
"""Share of a motion above which the first coordinate is chosen; it differs from one half, a frequent ratio of gears,
where round-off would decide."""

_CLOSED = 1e-12
"""Gap [mechanism's size, rad] of closed loops: some hundred times round-off."""

_NEARLY = 1e-9
"""Gap that is accepted if corrections gain no more, as near singular positions and with truncated digits."""

_ROUGH = 1e-5
"""Singular value of constraints over the largest, and gap [mechanism's size, rad], up to which a constraint counts as
equal to others except for rounded numbers: files give a right angle as 1.5708."""

_LOOSE = 0.03
"""Gap [mechanism's size, rad] up to which it does so if the user leaves gaps: points that are placed by eye."""

_APART = (0.1, 0.3, -0.3)
"""Distances [mechanism's size, rad] along the motion at which this equality is tested."""

_LONGEST = 0.3
"""Longest correction [rad, mechanism's size]: short enough for a linear correction to lead to a near position."""

_MOST = 200
"""Largest number of corrections: some ten suffice; near a singular position each halves the gap."""

_TRIES = 48
"""Number of other starting positions for the search of a closed position if the first one is far or missing."""

_FAR = 0.5
"""Distance [rad, mechanism's size] above which a nearer position is searched."""

_GIVEN = 0.1
"""Weight of a coordinate with a value in the file, relative to one without."""

_DRIVEN = 0.3
"""Weight of a driven coordinate, relative to one without a value."""


@dataclass(frozen=True)
class Closed:
    """A position that closes the loops, its independent coordinates, and its distance from the given position."""

    values: dict[str, float]
    independent: set[str]
    gap: float
    """Largest gap at the given place [m, rad]."""
    left: float
    """Largest gap [m, rad] at this position, far above round-off if the loops do not close."""
    way: float
    """Largest change of a coordinate [rad, mechanism's size]."""
    beyond: tuple[str, ...]
    """Names of coordinates outside their limits, if the loops do not close within the limits."""
    spare: dict[str, tuple[str, ...]]
    """Directions of joints, by joint, that other joints already suppress except for rounding; they are not closed."""
    missed: float
    """Largest gap in these directions at this position [m, rad]."""


class Loops:
    """The loops of a mechanism as functions of its coordinates, in units of its size."""

    def __init__(
        self,
        mechanism: Mechanism,
        values: Mapping[str, float],
        driven: Sequence[str],
        given: Collection[str],
        limits: Mapping[str, tuple[float, float]],
        loose: bool = False,
    ):
        self._agree = _LOOSE if loose else _ROUGH
        coordinates = list(mechanism.coordinates)
        self.names = [c.name for c in coordinates]
        self.driven = {name for name in driven if name in self.names}
        residuals, plain, lengths = [], [], []
        self._rows: list[tuple[str, str]] = []
        """Joints and directions of constraints; other constraints have no direction."""
        for closing in mechanism.closures:
            if isinstance(closing, SpatialJoint):
                self._rows += [(closing.name, direction) for direction in closing.directions]
                for direction in closing.directions:
                    residuals.append(closing.gap(direction))
                    plain.append(closing.residual(direction))
                    lengths.append(not direction.startswith("rotation"))
            elif isinstance(closing, Constraint):
                self._rows.append((closing.name, ""))
                residuals.append(closing.expression)
                plain.append(closing.expression)
                lengths.append(closing.unit == "m")
        q, phi = ca.vertcat(*(c.q for c in coordinates)), ca.vertcat(*residuals)
        self._both = ca.Function("loops", [q], [phi, ca.jacobian(phi, q)])
        self._plain = ca.Function("gaps", [q], [ca.vertcat(*plain)])
        self._kept = np.ones(len(self._rows), dtype=bool)
        self.given = vector([values[name] for name in self.names])
        metres = np.array([c.unit == "m" for c in coordinates])
        rows = np.array(lengths, dtype=bool)
        gaps, matrix = (np.abs(np.array(found)) for found in self._both(self.given))
        arm = np.linalg.norm(matrix[np.ix_(rows, ~metres)], axis=0).max(initial=0.0)
        if arm <= _RANK * matrix.max(initial=0.0):  # no loop rotates: all are prismatic or open
            arm = max(gaps[rows].max(initial=0.0), np.abs(self.given[metres]).max(initial=0.0))
        self.size = arm or 1.0
        """Length [m] of the longest arms of the loops, which scales and turns with them."""
        self.units = np.where(metres, self.size, 1.0)
        self._row_units = np.where(rows, self.size, 1.0)
        self._ready = np.array(
            [(_GIVEN if n in given else 1.0) * (_DRIVEN if n in self.driven else 1.0) for n in self.names]
        )
        bounds = np.array([limits.get(name, (-np.inf, np.inf)) for name in self.names]).reshape(-1, 2)
        low, high = bounds.T / self.units
        self._start = self.given / self.units
        self._low, self._high = np.minimum(low, self._start), np.maximum(high, self._start)

    def _all(self, x: Array) -> tuple[Array, Array]:
        gaps, matrix = (np.array(found) for found in self._both(x * self.units))
        return gaps.ravel() / self._row_units, matrix * self.units / self._row_units[:, None]

    def at(self, x: Array) -> tuple[Array, Array]:
        """Return gaps and their Jacobian at coordinates, in units of the mechanism's size."""
        gaps, matrix = self._all(x)
        return gaps[self._kept], matrix[self._kept]

    def _spare(self, x: Array) -> bool:
        """Leave out directions of joints that other joints suppress except for rounded numbers, which make loops rigid
        or keep them open; return whether there are any.

        The other joints must suppress them far from the position, too, with the same gap: here the position may merely
        be singular.
        """
        gaps, matrix = self._all(x)
        exact = np.abs(gaps).max(initial=0.0) <= _CLOSED
        along = _motions(matrix, _ROUGH)
        way = along @ np.linspace(1.0, 2.0, along.shape[1])
        way /= max(np.abs(way).max(initial=0.0), 1e-300)
        kept, stay = self._kept, list[Array]()
        for part in _APART:
            tried, gaps, matrix = self._corrected(x + part * way, kept)
            if kept.all():
                if np.abs(gaps).max(initial=0.0) > self._agree:
                    return False
                kept = self._enough(matrix)
                if kept.all() or (exact and np.linalg.matrix_rank(matrix, rtol=_RANK) <= kept.sum()):
                    return False
                _, gaps, _ = self._corrected(tried, kept)
            if np.abs(gaps[kept]).max(initial=0.0) <= _NEARLY:
                stay.append(gaps[~kept])
                if np.abs(stay[-1]).max() > self._agree or np.ptp(stay, axis=0).max() > 2 * _ROUGH:
                    return False
        self._kept = kept
        return True

    def _corrected(self, x: Array, kept: Array) -> tuple[Array, Array, Array]:
        """Return a position near one at which the kept constraints are met, with all gaps and their Jacobian."""
        gaps, matrix = self._all(x)
        for _ in range(_CORRECTIONS):
            x = x - np.linalg.lstsq(matrix[kept], gaps[kept], rcond=_ROUGH)[0]
            gaps, matrix = self._all(x)
        return x, gaps, matrix

    def _enough(self, matrix: Array) -> Array:
        """Return which constraints suffice: all that belong to no joint, and those of joints in order."""
        least = _ROUGH * np.linalg.norm(matrix, 2)
        kept = np.array([not direction for _, direction in self._rows], dtype=bool)
        done = np.linalg.svd(matrix[kept], full_matrices=False)
        basis = done[2][done[1] > least]
        left = matrix - matrix @ basis.T @ basis
        while (sizes := np.where(kept, 0.0, np.linalg.norm(left, axis=1))).max() > least:
            i = np.flatnonzero(sizes > _HALF * sizes.max())[0]
            kept[i], own = True, left[i] / sizes[i]
            left = left - np.outer(left @ own, own)
        return kept

    def _followed(self, x: Array, ready: Array, low: Array, high: Array) -> tuple[Array, float]:
        """Apply corrections of least weighted length until loops are closed or nothing is gained; return the remaining
        gap."""
        gaps, matrix = self.at(x)
        for _ in range(_MOST):
            size = float(np.linalg.norm(gaps))
            if np.abs(gaps).max(initial=0.0) <= _CLOSED:
                break
            free = ready.copy()
            for _ in range(len(x)):  # a coordinate at its limit is fixed
                step = free * np.linalg.lstsq(matrix * free, -gaps, rcond=1e-8)[0]
                stopped = (free > 0) & (((x <= low) & (step < 0)) | ((x >= high) & (step > 0)))
                if not stopped.any():
                    break
                free[stopped] = 0.0
            part = min(1.0, _LONGEST / max(np.abs(step).max(initial=0.0), 1e-300))
            while part > 1e-4:
                tried = np.clip(x + part * step, low, high)
                found, there = self.at(tried)
                if np.linalg.norm(found) < (1 - part / 10) * size:
                    break
                part /= 2
            else:
                break
            x, gaps, matrix = tried, found, there
        return x, float(np.abs(gaps).max(initial=0.0))

    def _near(self, x: Array, low: Array, high: Array) -> tuple[Array, float]:
        """Return the nearest closed position by weights, moving from a closed position towards the given values."""
        best, left = x, self._followed(x, self._ready, low, high)[1]
        for _ in range(_CORRECTIONS):
            along = _motions(self.at(best)[1])
            gone = (self._start - best) / self._ready
            pull, *_ = np.linalg.lstsq(along / self._ready[:, None], gone, rcond=_RANK)
            step = along @ pull
            step *= min(1.0, _LONGEST / max(np.abs(step).max(initial=0.0), 1e-300))
            tried, gap = self._followed(np.clip(best + step, low, high), self._ready, low, high)
            if gap > _NEARLY or self._way(tried) > (1 - 1e-3) * self._way(best):
                break
            best, left = tried, gap
        return best, left

    def _way(self, x: Array) -> float:
        return float(np.linalg.norm((x - self._start) / self._ready))

    def _closest(self, low: Array, high: Array) -> tuple[Array, float]:
        """Return the nearest closed position found from the given one and, if that is far, from other positions."""
        start, ready = self._start, self._ready
        best, left = self._followed(start, ready, low, high)
        if left <= self._agree and len(self._kept) and self._kept.all() and self._spare(best):
            best, left = self._followed(start, ready, low, high)
        if left <= _NEARLY and np.abs(best - start).max(initial=0.0) <= _FAR:
            return best, left
        if left <= _NEARLY:
            best, left = self._near(best, low, high)
        rng = np.random.default_rng(0)
        for k in range(_TRIES):
            beside = start + rng.normal(size=len(start)) * ready / ready.max() * (0.2 + 1.8 * k / (_TRIES - 1))
            tried, gap = self._followed(np.clip(beside, low, high), ready, low, high)
            if gap <= _NEARLY:
                tried, gap = self._near(tried, low, high)
            nearer = left > _NEARLY or self._way(tried) < 0.99 * self._way(best)
            if nearer if gap <= _NEARLY else gap < left:
                best, left = tried, gap
        return best, left

    def close(self) -> Closed:
        """Return the nearest position that closes the loops, within limits if possible, and its independent
        coordinates."""
        anywhere = np.full(len(self.names), np.inf)
        x, left = self._closest(self._low, self._high)
        if left > _NEARLY and (np.isfinite(self._low) | np.isfinite(self._high)).any():
            wide, found = self._closest(-anywhere, anywhere)
            if found <= _NEARLY:
                x, left = wide, found
        beyond = tuple(n for n, v, a, b in zip(self.names, x, self._low, self._high, strict=True) if not a <= v <= b)
        chosen = self._independent(x)
        start = self._start
        gap = float(np.abs(np.array(self._plain(self.given))[self._kept]).max(initial=0.0))
        # Independent coordinates keep the given values exactly, if these lead to a near position, within limits too.
        held = np.array([name in chosen for name in self.names])
        from_there = np.where(held, start, x)
        low, high = (-anywhere, anywhere) if beyond else (self._low, self._high)
        kept, opens = self._followed(from_there, np.where(held, 0.0, 1.0), low, high)
        if opens <= _NEARLY and np.abs(kept - x).max(initial=0.0) <= np.abs(x - start).max(initial=0.0) + _NEARLY:
            x, left = kept, opens
        if left > _NEARLY:
            left, x = float(np.abs(self.at(x)[0] * self._row_units[self._kept]).max()), start
        values = dict(zip(self.names, (x * self.units).tolist(), strict=True))
        spare: dict[str, tuple[str, ...]] = {}
        for (name, direction), is_kept in zip(self._rows, self._kept, strict=True):
            if not is_kept:
                spare[name] = (*spare.get(name, ()), direction)
        missed = float(np.abs(np.array(self._plain(x * self.units))[~self._kept]).max(initial=0.0))
        return Closed(values, chosen, gap, left, float(np.abs(x - start).max(initial=0.0)), beyond, spare, missed)

    def _independent(self, x: Array) -> set[str]:
        """Return coordinates whose values determine all others, driven ones preferred."""
        q = x * self.units
        rows = np.array(self._both(q)[1])[self._kept]
        motions = _motions(rows)
        # At a singular position, a position near it determines how many coordinates are independent.
        beside = q + _BESIDE * (motions @ np.linspace(1.0, 2.0, motions.shape[1]))
        for _ in range(_CORRECTIONS):
            left, matrix = (np.array(found)[self._kept] for found in self._both(beside))
            beside = beside - np.linalg.lstsq(matrix, left.ravel(), rcond=_RANK)[0]
        if np.abs(left).max(initial=0.0) < _RANK and np.linalg.norm(beside - q) < 10 * _BESIDE:
            rows, motions = matrix, _motions(matrix)
        held = np.flatnonzero(rows.any(axis=0)).tolist()
        names, motions = [self.names[i] for i in held], motions[held]
        chosen = set(self.names) - set(names)  # nothing holds them
        for _ in range(motions.shape[1] - len(chosen)):
            size = np.linalg.norm(motions, axis=1)
            first = [i for i, name in enumerate(names) if name in self.driven and size[i] > _GOOD * size.max()]
            i = (first or np.flatnonzero(size > _HALF * size.max()).tolist())[0]
            chosen.add(names[i])
            along = motions[i] / size[i]
            motions = motions - np.outer(motions @ along, along)
        return chosen


def _motions(matrix: Array, rank: float = _RANK) -> Array:
    """Return the motions (n, freedoms) that constraints allow."""
    _, sizes, turned = np.linalg.svd(matrix)
    return turned[np.sum(sizes > rank * sizes.max(initial=0.0)) :].T
