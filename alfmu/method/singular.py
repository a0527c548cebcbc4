"""Singular positions, in five steps that `docs/singular.md` explains and that lines of the code cite.

S1 calibrate at the start, S2 measure the margin, S3 bring a stage to the branch, S4 compute the limit from positions on
either side, S5 return to the constraints and freeze the rank. At a singular position C loses rank and two or more
motions cross: an acceleration can satisfy the constraints and yet belong to none of them. On one branch the
acceleration is smooth, so its limit follows from positions before and after. The page has the formula of the margin,
and the effect of halving and doubling each of these constants. The functions take NumPy arrays and symbols alike,
except `with_pole`, which takes arrays.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .formulations import project, project_residual

Array = Any

BRANCH_MARGIN = 2.5e-4
"""margin [1]: a step below it is made on the branch; at four times the value a third more steps are made there, and
errors change by 0.4 % at most."""

SMALL_PIVOT = 0.03
"""pivot over its scale [1]: only pivots below it enter the margin; larger ones vary with the position and do not
vanish."""

REGULAR_PRODUCT = 0.1
"""product of all pivots over its typical value [1]: a position above it is regular although a pivot is small, as where
Euler parameters hardly describe the motion."""

NOISE_FLOOR = 25.0
"""margin over the pivot contributed by masses [1]: below it a margin is indistinguishable from that of the singular
position itself, where masses contribute several such pivots."""

SPACING = 0.25
"""distance between positions over the step [1]: at 0.1 round-off of margins puts the N-four-bar of 10 loops in natural
coordinates 1.5e-6 rad off after 10 s, instead of less than 1e-8."""

LEAST_DISTANCE = 0.011
"""distance of the first position [rad]: accelerations on the branch lose digits with the third power of the distance;
at 0.003 the N-four-bar of ten loops in natural coordinates is 8e-6 rad off after 10 s of steps of 0.3 ms instead of
2e-11; at half and twice the value `stiff` at 1e-9 rejects one or two steps in 3 s, as at the value
(`tests/test_methods.py`)."""

MOST_MOVED = 0.04
"""displacement of the first position [rad]: the position is closer if the distance falls slowly along the motion, as
the limit misses curvature between its positions; without the bound a Stewart platform whose distance falls by 0.07 a
radian is 5e-5 m off after two passages, whatever the tolerance, instead of 4e-8 m."""

CONVERGENCE = 7.0
"""distance of the first position over the root of the pivot contributed by masses [1]: each multiplier iteration gains
the square of it, 49, and the five of the careful step gain 3e8; it applies where the penalty is small."""

DOUBLINGS = 20
"""most doublings of a spacing [1]: positions of a slow motion are too close to be distinguished until the spacing has
grown up to a million times."""

LIMIT_ZONE = 0.5
"""distance to the singular position over the distance of the first position [1]: closer stages take the limit, whose
positions are then on both sides of the singular one."""

INDEPENDENT_MASS = 1e3
"""mass added to independent coordinates over that of the motion [1]: large enough that a stage reaches the branch by
moving dependent coordinates instead."""

REFINED = 3
"""corrections of a motion before it is scaled to that of the independent coordinates [1]: each leaves the pivot
contributed by masses over the squared distance of what the constraints hardly hold; with one a Stewart platform loses
7e-7 J of 30 in a passage, whatever the tolerance, with three 2e-9 J."""

JUDGED = 1e-6
"""margin [1]: closer to a singular position the acceleration there cannot check a limit, as it may be mostly
round-off."""

READ_DISTANCE = 0.03
"""distance of the first position where reactions are evaluated [rad]: reactions lose digits with its fourth power, so
it is larger than that of accelerations."""

READ_ZONE = 0.2
"""distance to the singular position over READ_DISTANCE [1]: closer reactions are limits; farther away, direct
evaluation is as exact."""

FARTHEST = 0.1
"""distance of the first position [rad]: above it steps with error control take no limit; penalties of 200 times the
masses would require 0.5, and a four-bar is then 2e-5 rad off at a tolerance of 1e-6, which no estimate detects."""

PLACES = 4
"""positions on either side [1]: a limit of order 8, whose positions can be far enough apart to make round-off
negligible; with 2 the N-four-bar in natural coordinates is 8e-10 rad off after 10 s of steps of 0.3 ms instead of
2e-11."""

LONG_PLACES = 4
"""positions on either side for reactions, and for integrators other than RK4 [1]: a limit of order 8, the order of the
best integrator."""

LONG_SPACING = 0.1
"""distance between positions over the step of integrators other than RK4 [1]: their steps are longer, and a margin is a
parabola only near the position."""

READ_LOSS = 20.0
"""error of reactions at a regular position over round-off of the loads [1]: it was 0.1 to 25 in runs of slider-cranks,
four-bars and five-bars."""

OFF_LOSS = 4.0
"""error of reactions at a regular position over the relative error of positions and velocities [1]: it was 0.1 to 5 in
runs of four-bars, as links turn by more than their ends move."""

BENT_LOSS = 10.0
"""error of reactions at a regular position over the relative error of accelerations [1]: it was 1 to 12 in runs with
penalties of 100 masses, as constraint directions may be nearly parallel at regular positions, too."""

NEAR_LOSS = 0.05
"""error of reactions near a singular position over round-off of the loads and the fourth power of the distance [1]: in
runs of four-bars and five-bars it was 0.00025 to 0.05."""

MOVED_LOSS = 0.15
"""error of reactions near a singular position over the relative error of positions and velocities and the third power
of the distance [1]: it was 0.001 to 0.3 in runs of five-bars."""

LIMIT_LOSS = 3.0
"""error of a limit over round-off of its nearest positions [1]: in runs of four-bars and five-bars it was 0.05 to 5."""

POLE_SEEN = 1e-6
"""contribution of a pole to reactions over the largest of them [1]: a smaller pole is ignored, as round-off leaves
1e-8."""

POLE_ZERO = 1e-7
"""distance of a pole over the distance of the first position [1]: below it the position counts as the pole itself;
round-off leaves 1e-9."""

FROZEN = 1e-6
"""motion at fixed time over the whole motion [1]: below it a mechanism has only its prescribed motion, along which no
position is displaced; round-off leaves 1e-12 near a singular position."""

TINY = 1e-300
"""number [1]: added to a divisor that may be zero, as for a mechanism at rest."""


def weights(m: int) -> dict[int, float]:
    """S4: return weights of m evenly spaced positions before and after, with an error of order 2 m in the spacing."""
    return {
        k * side: (-1) ** (k + 1) * math.comb(2 * m, m + k) / math.comb(2 * m, m)
        for side in (-1, 1)
        for k in range(1, m + 1)
    }


MEAN = weights(PLACES)
"""Positions [spacings] from which a step takes the limit of an acceleration, and their weights."""

READ_MEAN = weights(LONG_PLACES)
"""Positions [spacings] from which a limit of reactions is taken, and their weights."""


def first_position(
    least: Array, rate: Array, moved: Array, nothing: Array, choose: Callable[[Any, Any, Any], Any]
) -> Array:
    """S4: return the distance of the first position of a limit, if a spacing moves a coordinate by `moved` and changes
    the distance by `rate`. It is the least distance, or a smaller one with less displacement at which (8) still
    converges."""
    floor = CONVERGENCE * (nothing / NOISE_FLOOR) ** 0.5
    near = choose(MOST_MOVED * rate < least * moved, MOST_MOVED * rate / (moved + TINY), least)
    return choose(rate > 0, choose(near < floor, floor, near), least)


def farthest(least: Array, larger: Callable[[Any, Any], Any]) -> Array:
    """S4: return the largest displacement of the first position. Beyond it the distance hardly falls along the motion,
    as for a lever far shorter than its body, and the limit does not belong to this position."""
    return larger(FARTHEST, 4 * least)


def curvature(before: Array, here: Array, after: Array) -> Array:
    """S2: return the squared length [rad^2] of the spacing from margins, which are parabolas over the distance."""
    return (before + after) / 2 - here


def mean(values: dict[int, Array]) -> Array:
    """S4: return the limit from values at as many positions before as after."""
    return sum(w * values[k] for k, w in weights(len(values) // 2).items())


def pole(values: dict[int, Array]) -> tuple[Array, Array, Array]:
    """S4: return the limits of x_k, k x_k and k^2 x_k at k = 0.

    The last two vanish where x is smooth. For A / (k - c) they are B and c B, and -B / c corrects the limit of x_k.
    """
    limit, first, second = (mean({k: k**power * x for k, x in values.items()}) for power in (0, 1, 2))
    return limit, first, second


def fewer(values: dict[int, Array]) -> dict[int, Array]:
    """Return the values without the farthest positions; the change of the limit estimates its error."""
    return {k: x for k, x in values.items() if abs(k) < len(values) // 2}


def direct_error(margin: Array, eps: Array) -> Array:
    """Return the relative round-off of reactions at this margin: eps over the fourth power of the distance.

    It also bounds the error of accelerations, which lose digits with the third power, and fewer if (8) converges
    slowly.
    """
    return eps / (margin * margin + TINY)


def reading_error(margin: Array, eps: float, off: Sequence[Array], forces: Sequence[Array]) -> Array:
    """Return the error of reactions evaluated at this margin; the masses do not contribute to it.

    `off` are relative errors of positions, velocities and accelerations, from residuals of constraints; `forces` are
    the largest of F, C' lam, residual of (4), M a, and twice the kinetic energy over the mechanism's length.
    """
    F, carried, imbalance, inertia, of_speed = forces
    loads = (F * F + carried * carried) ** 0.5
    moved = off[0] * loads + off[1] * of_speed
    regular = READ_LOSS * eps * loads + NEAR_LOSS * direct_error(margin, eps * loads)
    off_constraints = moved * (OFF_LOSS + MOVED_LOSS / margin**1.5) + off[2] * inertia * (BENT_LOSS + 1 / margin)
    return regular + off_constraints + imbalance / margin**0.5


def limit_error(change: Array, before: Array, largest: Array, magnified: Array, eps: Array) -> Array:
    """Return the error of a limit of values that reach `largest`.

    The effect of each farther pair of positions is extrapolated from the last two, `change` and `before`. Round-off of
    the nearest positions is `magnified` where it displaces a pole.
    """
    noise = LIMIT_LOSS * direct_error(READ_DISTANCE**2, eps) * largest
    return change * change / (change + before + TINY) + noise * (1 + magnified)


def with_pole(values: dict[int, NDArray], use_pole: bool = True) -> tuple[NDArray, bool, float]:
    """S4: return the limit of reactions (l,) from values before and after, whether a pole is near, and by how much the
    pole magnifies round-off.

    Near a pole the limit is the value at the position itself; at the pole, or with `use_pole` false, it is the finite
    part.
    """
    limit, first, second = pole(values)
    largest = max((np.abs(x).max(initial=0.0) for x in values.values()), default=0.0)
    steepest = int(np.argmax(np.abs(first)))
    if not np.abs(first[steepest]) > POLE_SEEN * largest or not abs(second[steepest]) < abs(first[steepest]):
        return limit, False, 0.0
    place = second[steepest] / first[steepest]
    if not use_pole or abs(place) <= POLE_ZERO:
        return limit, True, 0.0
    return limit - np.where(np.abs(first) > POLE_SEEN * largest, first, 0.0) / place, True, 1 / place**2


def tangential(C: Array, alpha: Array, solve: Callable[[Array], Array], d: Array) -> Array:
    """S3: return the part of d (n,) that satisfies the constraints; the rest is orthogonal to it in metric M."""
    return d + project(C, alpha, solve, C @ d)


def along(M: Array, heavy: Array, way: Array, d: Array, least: Array = 0.0) -> Array:
    """S3: return the multiple of the tangent `way` (n,) that makes a displacement d (n,) orthogonal to it in the metric
    of M with the masses `heavy` (n,) of the independent coordinates, given that it is orthogonal in metric M. A tangent
    far shorter than `least` in that metric counts as zero."""
    given = way * heavy
    return (given.T @ d) / (way.T @ (M @ way) + given.T @ way + least + TINY)


def returned(
    M: Array,
    C: Array,
    alpha: Array,
    solve: Callable[[Array], Array],
    heavy: Array,
    q: Array,
    wanted: Array,
    v: Array,
    speed: Callable[[Array], Array] | None = None,
    still: Array | None = None,
) -> tuple[Array, Array]:
    """Return q displaced along the motion to the position nearest to `wanted`, and the v of that motion.

    If time is a coordinate, `speed` returns Phi-dot of a velocity, and `still` is v at fixed time: time itself is not
    displaced.
    """
    speed = speed or (lambda x: C @ x)

    def refined(x: Array) -> Array:
        return x + project_residual(M, C, alpha, solve, speed(x), lambda d: speed(x + d))

    def kept(x: Array) -> Array:
        for _ in range(REFINED):
            x = refined(x)
        return x

    way, d = kept(v), kept(wanted - q)
    if still is None:
        q = q + d + way * along(M, heavy, way, wanted - q - d)
        return q, way + way * along(M, heavy, way, v - way)
    least, free = FROZEN**2 * (v.T @ (M @ v)), kept(still)
    q = q + d + free * along(M, heavy, free, wanted - q - d, least)
    return q, way + free * along(M, heavy, free, v - way, least)
