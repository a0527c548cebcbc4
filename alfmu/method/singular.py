"""Singular positions: how near one is, and the acceleration of the branch of the motion that is followed.

Where C loses rank, two or more motions cross, and an acceleration can keep the constraints and yet belong to none of
them. On the branch that is followed the acceleration is smooth, so that its limit is known from places before and after
(extrapolated along v); and every stage of a step is first brought to the branch, as the constraints are nearly
inconsistent beside it. Written for NumPy arrays and for symbols alike, as `formulations` is, but for `with_pole`.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "CONVERGING",
    "FAR",
    "GUARD",
    "HEAVY",
    "LEAST",
    "LONGER",
    "LONG_MEAN",
    "LONG_NOISE",
    "LONG_SPACING",
    "MEAN",
    "MOST",
    "NOTHING",
    "READ_DISTANCE",
    "READ_MEAN",
    "READ_ZONE",
    "SMALL",
    "SPACING",
    "ZERO",
    "ZONE",
    "along",
    "curvature",
    "first_distance",
    "mean",
    "returned",
    "tangential",
    "weights",
    "with_pole",
]

Array = Any

GUARD = 2.5e-4
"""Margin below which a step is made on the branch.

The margin is the pivot of H that vanishes at a singular position, over the largest diagonal entry that its coordinate
usually has: about the square of the distance [rad], for links of similar lengths. Small pivots belong to the degrees of
freedom, where masses alone make them, or to a singular position; where a coordinate has an extremum the pivot of a mass
is shared by two. So it is the product of all small ones, over that of those that masses make, and of several that
vanish together the geometric mean; 1 where no more are small than there are degrees of freedom."""

SMALL = 0.03
"""Pivots below it may vanish."""

FAR = 0.1
"""Product of all pivots, over what it usually is, from which on a small one only says that its coordinate hardly tells
the motion: where Euler parameters do so by turns, of few coordinates, between which it hardly changes."""

NOTHING = 25.0
"""Margins up to so many pivots of masses are those of a singular position."""

SPACING = 0.25
"""Of the places from which a limit is taken, over the internal step, where neither LEAST nor MOST tells otherwise."""

LEAST = 0.003
"""Least distance of the first of these places, as the square root of a margin."""

MOST = 0.015
"""Most such distance of the first places: the error of a limit grows with its fourth power."""

CONVERGING = 7.0
"""Least such distance over the square root of a pivot that masses make."""

LONGER = 20
"""Most doublings of a spacing that is too short."""

ZONE = 0.5
"""Distance to the singular position, over that of the first places, below which the limit is taken."""

HEAVY = 1e3
"""Mass that coordinates which tell the motion are given where a place is brought to the branch, over that of the
motion: others are moved instead, and the accelerations are nearly those of a method in the telling ones alone."""

READ_DISTANCE = 0.03
"""Distance of the first place where reactions are read: farther, as they lose digits with its fourth power."""

READ_ZONE = 0.2
"""Distance to the singular position, over that one, below which the limit is read."""


NEVER = 1e-300
"""Added to what may be zero."""


def weights(m: int) -> dict[int, float]:
    """Weights of m places before and m after, evenly spaced, that leave an error of order 2 m in the spacing."""
    return {
        k * side: (-1) ** (k + 1) * math.comb(2 * m, m + k) / math.comb(2 * m, m)
        for side in (-1, 1)
        for k in range(1, m + 1)
    }


MEAN = weights(2)
"""Places from which an acceleration is taken in a step, in spacings, and their weights."""

READ_MEAN = weights(4)
"""The same for what is read."""

LONG_SPACING = 0.1
"""Of the places from which a limit is taken, over the step: long steps need them closer than those of order 4."""

LONG_MEAN = weights(4)
"""Those places: a limit of order 8, as that of the best method."""

LONG_NOISE = 2e-11
"""Errors [m, rad; per s] that a step on the branch may have: the return to it magnifies round-off up to them."""

ZERO = 1e-5
"""What is zero, over the values at the places, of a function that is known there to round-off over its spacing."""


def curvature(before: Array, here: Array, after: Array) -> Array:
    """Square of the distance that one spacing makes, from margins, which are parabolas over the distance."""
    return (before + after) / 2 - here


def first_distance(rate: Array, least: Array, smaller: Callable, larger: Callable) -> Array:
    """Distance of the first places from which a limit is taken, where one spacing makes `rate` of it."""
    return larger(smaller(rate, MOST), least)


def mean(values: dict[int, Array]) -> Array:
    """The limit from values at places, as many before as after."""
    return sum(w * values[k] for k, w in weights(len(values) // 2).items())


def with_pole(values: dict[int, NDArray]) -> tuple[NDArray, bool]:
    """The limit of reactions (l,) from those at places before and after, and whether they have a pole near instead.

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
    if abs(zero) > ZERO * max(map(abs, inverse.values())):
        through = mean({k: x * inverse[k] for k, x in values.items()}) / zero
        limit = np.where(near > far, through, limit)
    return limit, True


def tangential(C: Array, alpha: Array, solve: Callable[[Array], Array], d: Array) -> Array:
    """The part of a displacement d (n,) that keeps the constraints; the rest is orthogonal to it in the metric of M."""
    return d - solve(C.T @ (alpha @ (C @ d)))


def along(M: Array, heavy: Array, way: Array, d: Array) -> Array:
    """How far to go along a way (n,), over it, where a displacement d (n,) is orthogonal to it in the metric of M and
    not in that of M with the masses `heavy` (n,)."""
    given = way * heavy
    return (given.T @ d) / (way.T @ (M @ way) + given.T @ way + NEVER)


def returned(
    M: Array,
    C: Array,
    alpha: Array,
    solve: Callable[[Array], Array],
    heavy: Array,
    q: Array,
    wanted: Array,
    v: Array,
) -> tuple[Array, Array]:
    """q displaced along the motion to the place that is nearest to the wanted one, and the v of that motion."""
    way, d = (tangential(C, alpha, solve, x) for x in (v, wanted - q))
    q = q + d + way * along(M, heavy, way, wanted - q - d)
    return q, way + way * along(M, heavy, way, v - way)
