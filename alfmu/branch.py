"""Singular positions: how near one is, and the acceleration of the branch of the motion that is followed.

Where C loses rank, two or more motions cross, and an acceleration can keep the constraints and yet belong to none of
them. On the branch that is followed the acceleration is smooth, so that its limit is known from places before and after
(extrapolated along v); and every stage of a step is first brought to the branch, as the constraints are nearly
inconsistent beside it. Written for NumPy arrays and for symbols alike, as `alfmu.method` is.
"""

from collections.abc import Callable
from typing import Any

__all__ = ["BRANCHES", "GUARD", "LEAST", "MASSES", "MEAN", "SPACING", "ZONE", "curvature", "tangential"]

Array = Any

BRANCHES: dict[str, str] = {
    "continue": "follow the branch smoothly through singular positions",
    "paper": "as in Blajer (2002): the accelerations that (8) gives there, corrected by (10)",
}
"""Ways to pass singular positions."""

GUARD = 1e-3
"""Margin below which a step is made on the branch.

The margin is the smallest pivot of H over its diagonal entry, apart from those that masses make, one for each degree of
freedom: about the square of the distance [rad] to the singular position, for links of similar lengths. It is 0 where
there are more of those pivots, and 1 where there are fewer: then a coordinate has an extremum, with two pivots between
that of a mass and that of a constraint, and the position is regular."""

MASSES = 10.0
"""Pivots up to so many times those that masses usually make are theirs."""

SPACING = 0.25
"""Of the places from which a limit is taken, over the internal step."""

LEAST = 0.003
"""Smallest distance of the first of these places, as the square root of a margin."""

ZONE = 0.5
"""Distance to the singular position, over that spacing, below which the limit is taken."""

MEAN = {-2: -1 / 6, -1: 4 / 6, 1: 4 / 6, 2: -1 / 6}
"""Weights of the places, which leave an error of fourth order in their spacing."""


def curvature(before: Array, here: Array, after: Array) -> Array:
    """Square of the distance that one spacing makes, from margins, which are parabolas over the distance."""
    return (before + after) / 2 - here


def tangential(C: Array, alpha: Array, solve: Callable[[Array], Array], d: Array) -> Array:
    """The part of a displacement d (n,) that keeps the constraints; the rest is orthogonal to it in the metric of M."""
    return d - solve(C.T @ (alpha @ (C @ d)))
