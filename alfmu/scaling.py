"""Penalties and tolerances in the units of each constraint: the motion is the same where a row is in other units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["PENALTY_RATIO", "scaled"]

PENALTY_RATIO = 1e8
"""Default penalty over the largest mass that constraints hold: far from round-off at either end in residual form."""

_ALIKE = 10.0
"""Units within this factor of 1, or of each other, serve as well as one, which costs less."""

_SMALL = 1e-3
"""Size of a column, over that of the largest, below which its coordinate is hardly held at the places seen."""


def scaled(
    masses: NDArray, entries: NDArray, row: NDArray, column: NDArray, rows: int, metres: NDArray
) -> tuple[NDArray, NDArray]:
    """Penalties and units (rows,) of constraints, so that a row in other units leaves the motion as it is.

    `masses` (n,) is the diagonal of M, `entries` (places, m) are those of C at several places, in `row` and `column`
    (m,); `metres` (n,) tells which coordinates are lengths. The unit of a row is what it comes to for a unit of
    displacement, 1 where rows are in metres and radians, 1000 where one is in millimetres: its constant coefficient of
    lengths, or its largest coefficient where it has none. The penalty is PENALTY_RATIO times the largest mass that the
    rows hold, over the square of the unit.
    """
    sizes = np.abs(entries)
    largest = sizes.max(axis=0)
    constant = metres[column] & (largest - sizes.min(axis=0) <= 1e-12 * largest)
    given = _largest(np.where(constant, largest, 0.0), row, rows)
    exact = given > 0
    units = np.where(exact, given, _largest(largest, row, rows))
    units[units == 0] = 1.0
    if not exact.all() and units.max(initial=1.0) <= _ALIKE * units.min(initial=1.0):
        units[:] = np.exp(np.log(units).mean())
        if 1 / _ALIKE < units[0] < _ALIKE:
            units[:] = 1.0
    held = _largest(largest / units[row], column, len(masses))
    known = held > _SMALL * held.max(initial=0.0)
    heaviest = (masses[known] / np.where(metres, 1.0, held)[known] ** 2).max(initial=0.0)
    return PENALTY_RATIO * max(heaviest, 1e-300) / units**2, units


def _largest(values: NDArray, place: NDArray, size: int) -> NDArray:
    """The largest of the values at each place (size,), 0 where there is none."""
    found = np.zeros(size)
    np.maximum.at(found, place, values)
    return found
