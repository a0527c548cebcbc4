"""Constraints that come and go: locks, clutches and joints that let go, switched by Boolean inputs.

A constraint is out of force where its penalty is zero (Blajer 2002, section 4); one that comes into force stops the
motion it forbids in a plastic impact, and one that goes out of force leaves the state as it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...equations import Equations, Variable

__all__ = ["Topology"]


class Topology:
    """What the switches of one instance were told, and what is in force."""

    def __init__(self, equations: Equations):
        e = equations
        self.rows_held = np.ones(e.l, bool)
        self.inputs = [Variable(s.name, "1", s.start, description=s.description, type="Boolean") for s in e.switches]
        self._switches = e.switches
        self.wanted, self.on, self.kept = (np.zeros(size) for size in (len(e.switches), len(e.switches), len(e.held)))
        self.wanted[:] = [s.start for s in e.switches]

    @property
    def pending(self) -> bool:
        """Whether something is wanted that is not in force."""
        return bool((self.wanted != self.on).any())

    def force(self, on: NDArray) -> NDArray:
        """Which constraints are in force (l,) with the switches `on` or off."""
        held = self.rows_held.copy()
        for switch, is_on in zip(self._switches, on, strict=True):
            held[switch.rows] = bool(is_on) == switch.holds
        return held

    def stops(self, displacements: NDArray) -> NDArray:
        """Displacements that locks keep, with those that are locked now taken where they are."""
        kept = self.kept.copy()
        for switch, wanted, on in zip(self._switches, self.wanted, self.on, strict=True):
            if switch.value >= 0 and wanted and not on:
                kept[switch.value] = displacements[switch.value]
        return kept
