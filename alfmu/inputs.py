"""Inputs inside a communication step: extrapolated from what they were at past communication points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["Past"]

KEPT = 3
"""Communication points that are kept: enough for order 2."""


class Past:
    """Inputs at the last communication points, newest first."""

    def __init__(self, size: int):
        self.numbers = np.zeros(1 + KEPT * (1 + size))
        """All of it, for saving and restoring: how many points, their times, their inputs."""
        self._times = self.numbers[1 : 1 + KEPT]
        self._inputs = self.numbers[1 + KEPT :].reshape(KEPT, size)

    @property
    def known(self) -> int:
        """How many points are known."""
        return int(self.numbers[0])

    def reach(self, t: float, u: NDArray) -> None:
        """Take note of the inputs u at a communication point t, in place of what was there if it has been reached."""
        while self.known and self._times[0] >= t:
            self._shift(-1)
        self._shift(1)
        self._times[0], self._inputs[0] = t, u

    def at(self, t: float, order: int) -> NDArray:
        """Inputs at t by the polynomial of an order through the newest points, a lower one while there are fewer."""
        count = min(order + 1, self.known)
        times = self._times[:count]
        u = np.zeros(self._inputs.shape[1])
        for i, here in enumerate(times):
            others = np.delete(times, i)
            u += np.prod((t - others) / (here - others)) * self._inputs[i]
        return u

    def _shift(self, by: int) -> None:
        self._times[:], self._inputs[:] = np.roll(self._times, by), np.roll(self._inputs, by, axis=0)
        self.numbers[0] = min(self.known + by, KEPT)
