"""Penalties and tolerances in the units of each constraint: the motion is the same where a row is in other units."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ...kernel.thresholds import ALIKE, HARDLY, PENALTY_RATIO, SAME

__all__ = ["scaled"]


def scaled(
    masses: NDArray,
    entries: NDArray,
    turned: NDArray,
    row: NDArray,
    column: NDArray,
    rows: int,
    metres: NDArray,
    angles: NDArray,
) -> tuple[NDArray, NDArray]:
    """Penalties and units (rows,) of constraints, so that a row in other units leaves the motion as it is.

    `masses` (n,) is the diagonal of M, `entries` (places, m) are those of C at several places, the start first, in
    `row` and `column` (m,); `turned` (places, m) are the same with the angle of each column turned by a quarter;
    `metres` and `angles` (n,) tell which coordinates are lengths or angles, others being Euler parameters. The unit of
    a row is what it comes to for a unit of displacement, 1 where rows are in metres and radians, 1000 where one is in
    millimetres. That is its constant coefficient, of lengths if it has them; otherwise what its lengths come to
    together, or the constant amplitude of an angle; if each row has such an amplitude, and some have no constant, the
    former is taken for all. Of others it is not known but by the size of their coefficients. The penalty is
    PENALTY_RATIO times the largest mass that the rows hold, over the square of the unit.
    """
    sizes, amplitudes, length, angle = np.abs(entries), np.hypot(entries, turned), metres[column], angles[column]
    largest = sizes.max(axis=0)
    there = largest > 0

    def together(some: NDArray) -> NDArray:
        squares = np.bincount(row, np.where(some, entries[0], 0.0) ** 2, rows)
        return np.sqrt(squares / np.maximum(np.bincount(row, some & there, rows), 1))

    with_lengths = np.bincount(row, length & there, rows)[row] > 0
    constant = np.where(_alike(sizes) & (length | ~with_lengths), largest, 0.0)
    exact = _largest(constant, row, rows)
    angular = _largest(np.where(angle & _alike(amplitudes), amplitudes[0], 0.0), row, rows)
    units, known = _largest(largest, row, rows), np.zeros(rows, bool)
    euler, lengths = together(~length & ~angle), math.sqrt(2) * together(length)
    for better in (angular, euler, lengths, exact):
        units = np.where(better > 0, better, units)
        known |= (better > 0) & (better is not euler)
    if angular.all() and not exact.all():
        units = angular
    units[units == 0] = 1.0
    if rows and _alike(units[:, None]).all():
        units[:] = units.max()
    if not known.all() and units.max() <= ALIKE * units.min():
        units[:] = np.exp(np.log(units).mean())
        if 1 / ALIKE < units[0] < ALIKE:
            units[:] = 1.0
    held = _largest(largest / units[row], column, len(masses))
    known = held > HARDLY * held.max(initial=0.0)
    heaviest = (masses[known] / np.where(metres, 1.0, held)[known] ** 2).max(initial=0.0)
    return PENALTY_RATIO * max(heaviest, 1e-300) / units**2, units


def _alike(values: NDArray) -> NDArray:
    """Which columns of values (k, m), none below zero, hold one number."""
    return np.ptp(values, axis=0) <= SAME * values.max(axis=0)


def _largest(values: NDArray, place: NDArray, size: int) -> NDArray:
    """The largest of the values at each place (size,), 0 where there is none."""
    found = np.zeros(size)
    np.maximum.at(found, place, values)
    return found
