"""Singular positions: how near one is, and the acceleration of the branch of the motion that is followed.

Where C loses rank, two or more motions cross, and an acceleration can keep the constraints and yet belong to none of
them. On the branch that is followed the acceleration is smooth, so that its limit is known from places before and after
(extrapolated along v); and every stage of a step is first brought to the branch, as the constraints are nearly
inconsistent beside it. Written for NumPy arrays and for symbols alike, as `alfmu.method` is, but for `with_pole`.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "BRANCHES",
    "GUARD",
    "LEAST",
    "MASSES",
    "MEAN",
    "SPACING",
    "ZONE",
    "curvature",
    "mean",
    "tangential",
    "with_pole",
]

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
"""Least distance of the first of these places, as the square root of a margin."""

CONVERGING = 2.0
"""The same, over the square root of the largest pivot that masses make."""

ZONE = 0.5
"""Distance to the singular position, over that spacing, below which the limit is taken."""

MEAN = {-2: -1 / 6, -1: 4 / 6, 1: 4 / 6, 2: -1 / 6}
"""Weights of the places, which leave an error of fourth order in their spacing."""


_ZERO = 1e-5
"""What is zero, over the values at the places, of a function that is known there to round-off over its spacing."""


def curvature(before: Array, here: Array, after: Array) -> Array:
    """Square of the distance that one spacing makes, from margins, which are parabolas over the distance."""
    return (before + after) / 2 - here


def mean(values: dict[int, Array]) -> Array:
    """The limit from values at the places of MEAN."""
    return sum(w * values[k] for k, w in MEAN.items())


def with_pole(values: dict[int, NDArray]) -> tuple[NDArray, bool]:
    """The limit of reactions (l,) from those at the places of MEAN, and whether they have a pole near instead.

    Differences across a singular position halve with the spacing where there is a limit, and double where there is a
    pole. Then the value is that of the quotient of two smooth functions, of which one has a zero; at the zero itself it
    is the finite part.
    """
    near, far = (np.abs(values[k] - values[-k]) for k in (1, 2))
    limit = mean(values)
    if not near.max(initial=0.0) > far.max(initial=0.0):
        return limit, False
    largest = int(np.argmax(near))
    inverse = {k: 1 / x[largest] for k, x in values.items()}
    zero = mean(inverse)
    if abs(zero) > _ZERO * max(map(abs, inverse.values())):
        through = mean({k: x * inverse[k] for k, x in values.items()}) / zero
        limit = np.where(near > far, through, limit)
    return limit, True


def tangential(C: Array, alpha: Array, solve: Callable[[Array], Array], d: Array) -> Array:
    """The part of a displacement d (n,) that keeps the constraints; the rest is orthogonal to it in the metric of M."""
    return d - solve(C.T @ (alpha @ (C @ d)))
