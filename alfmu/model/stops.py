"""Limit stops, which push a displacement back beyond its limit and never pull.

With the penetration x, its rate x', and z = x/onset limited to [0, 1], a stop pushes with p(x) (1 + loss), where

    p(x) = stiffness (onset (5/2 z^4 - 3 z^5 + z^6) + max(x - onset, 0)),

so that the stiffness rises smoothly from nothing to its full value: three continuous derivatives, with which methods of
fourth order keep their order. The loss is in proportion to the rate (Hunt and Crossley),

    loss = dissipation x',

or it leaves a share of the energy that is the square of a coefficient of restitution, whatever the speed and the mass,

    loss = -(1 - restitution^2) (1 - tanh(x'/creep))/2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from .words import Brief

Scalar = float | ca.SX

ONSET = 1e-3
"""Default penetration over which a stop stiffens [m or rad]: some tenths of the compression of rubber."""

CREEP = 1e-3
"""Default range of rates between approach and return [m/s or rad/s]: far below the rate of any impact."""


@dataclass(frozen=True, eq=False, repr=False)
class EndStop(Brief):
    """A one-sided stop at an upper limit, at a lower one, or at both; `of` is the limited displacement."""

    name: str
    of: Any
    """A joint, two markers, or an expression in coordinates."""
    unit: str
    upper: Scalar | None
    lower: Scalar | None
    stiffness: Scalar
    onset: Scalar
    dissipation: Scalar | None
    restitution: Scalar | None
    creep: Scalar

    @property
    def limited(self) -> str:
        """The limited displacement in words."""
        if isinstance(self.of, tuple):
            return f"the distance of {self.of[0].body.name} and {self.of[1].body.name}"
        return "the displacement" if isinstance(self.of, ca.SX) else f"{self.of.second.body.name} in {self.of.name}"

    def penetrations(self, x: ca.SX) -> Sequence[tuple[ca.SX, int]]:
        """Return the penetration at each limit, with the sign in which it grows with the displacement."""
        upper = [(x - self.upper, 1)] if self.upper is not None else []
        return upper + ([(self.lower - x, -1)] if self.lower is not None else [])

    def energy(self, x: ca.SX) -> ca.SX:
        """Return the stored energy at a displacement [J]."""
        return sum((contact(depth, self.stiffness, self.onset)[0] for depth, _ in self.penetrations(x)), ca.SX(0))

    def losses(self, x: ca.SX, rate: ca.SX) -> ca.SX:
        """Return the dissipative part of the effort along a displacement [N or N.m]."""
        total = ca.SX(0)
        for depth, sign in self.penetrations(x):
            _, push = contact(depth, self.stiffness, self.onset)
            total -= sign * self._loss(push, sign * rate)
        return total

    def effort(self, x: ca.SX, rate: ca.SX) -> ca.SX:
        """Return the effort along a displacement [N or N.m]."""
        total = ca.SX(0)
        for depth, sign in self.penetrations(x):
            _, push = contact(depth, self.stiffness, self.onset)
            total += sign * (-push - self._loss(push, sign * rate))
        return total

    def penetration(self, x: ca.SX) -> ca.SX:
        """Return the penetration into the stop, 0 outside it [m or rad]."""
        depth = [depth for depth, _ in self.penetrations(x)]
        return ca.fmax(depth[0] if len(depth) == 1 else ca.fmax(*depth), 0)

    def _loss(self, push: ca.SX, rate: ca.SX) -> ca.SX:
        if self.restitution is not None:
            return push * (-(1 - self.restitution**2) / 2) * (1 - ca.tanh(rate / self.creep))
        return ca.SX(0) if self.dissipation is None else push * self.dissipation * rate


def contact(penetration: ca.SX, stiffness: Scalar, onset: Scalar) -> tuple[ca.SX, ca.SX]:
    """Return energy [J] and push [N] of a spring whose stiffness rises from 0 to the given one over the first `onset`
    [m].

    With z = penetration/onset between 0 and 1 the stiffness is k (10 z^3 - 15 z^4 + 6 z^5), and constant beyond.
    """
    z = ca.fmin(ca.fmax(penetration / onset, 0), 1)
    beyond = ca.fmax(penetration - onset, 0)
    push = onset * (5 / 2 * z**4 - 3 * z**5 + z**6) + beyond
    energy = onset**2 * (z**5 / 2 - z**6 / 2 + z**7 / 7) + onset * beyond / 2 + beyond**2 / 2
    return stiffness * energy, stiffness * push
