"""Inputs inside a communication step, extrapolated from their values at past communication points.

The rules run on numbers and on symbols: they branch by a `where` that the caller passes (see `stepping`).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

KEPT = 3
"""Number of communication points recorded: enough for order 2."""

Array = Any
Where = Callable[[Any, Any, Any], Any]
Points = Sequence[Array] | NDArray[np.float64]
"""Values at past communication points, newest first."""


def memory_size(inputs: int) -> int:
    """Return the size of the record of past points: their count, times and inputs, newest first."""
    return 1 + KEPT * (1 + inputs)


def reached(
    known: Array, times: Points, inputs: Points, t: Array, u: Array, where: Where
) -> tuple[Array, list[Array], list[Array]]:
    """Return the record after inputs u at communication point t; a point already recorded is replaced."""
    later = sum(where(known > i, where(times[i] >= t, 1.0, 0.0), 0.0) for i in range(KEPT))

    def older(values: Points, i: int) -> Array:
        found = values[i]
        for shift in range(1, KEPT - i):
            found = where(later == shift, values[i + shift], found)
        return found

    kept = where(known - later + 1 > KEPT, float(KEPT), known - later + 1)
    first = range(KEPT - 1)
    return kept, [t, *(older(times, i) for i in first)], [u, *(older(inputs, i) for i in first)]


def extrapolated(known: Array, times: Points, inputs: Points, t: Array, order: int, where: Where) -> Array:
    """Return inputs at t by the polynomial of this order through the newest points, of lower order if there are few."""
    total = 0.0
    for i in range(order + 1):
        weight = where(known > i, 1.0, 0.0)
        for j in range(order + 1):
            if j != i:
                there = where(known > j, where(known > i, 1.0, 0.0), 0.0)
                weight = weight * where(there, t - times[j], 1.0) / where(there, times[i] - times[j], 1.0)
        total = total + weight * inputs[i]
    return total


class Past:
    """Inputs at the last communication points, newest first; `numbers` hold the whole state and can be saved."""

    def __init__(self, inputs: int, numbers: NDArray[np.float64] | None = None):
        self.numbers: NDArray[np.float64] = np.zeros(memory_size(inputs)) if numbers is None else numbers
        self._times = self.numbers[1 : 1 + KEPT]
        self._inputs = self.numbers[1 + KEPT :].reshape(KEPT, inputs)

    def reach(self, t: float, u: NDArray[np.float64]) -> None:
        """Record the inputs u at a communication point t."""
        known, times, inputs = reached(self.numbers[0], self._times.tolist(), self._inputs.copy(), t, u, np.where)
        self.numbers[0], self._times[:], self._inputs[:] = known, times, inputs

    def at(self, t: float, order: int) -> NDArray[np.float64]:
        """Return inputs at t."""
        return extrapolated(self.numbers[0], self._times, self._inputs, t, order, np.where)
