"""Newton's method for friction that follows from the load, on arrays and symbols alike.

Forces phi of sliding joints follow from the reactions, phi = law(a, lambda); a and lambda are affine in phi, as (4)
and (3) are linear. With the slopes D of law(phi), one iteration solves (I - D) dphi = law - phi. On the branch that
continues from zero friction all pivots of I - D are positive. At a fold one of them vanishes: the joint jams.
"""

from collections.abc import Sequence
from typing import Any

LAW_PASSES = 12
"""most iterations of Newton's method in an evaluation [1]: near a jam it takes more than six."""

LAW_ENOUGH = 1e-7
"""residual of a law over the friction [1]: Newton's method ends below it, as one more iteration would leave
round-off."""

JAM_SETTLED = 1e-6
"""residual of a law over the friction after the last iteration [1]: Newton's method has failed above it."""

JAM_PIVOT = 1e-3
"""pivot of I - D [1]: below it a motion that cannot continue has met a jam; it is 1 without friction, and negative
beyond a fold."""

Number = Any


def newton(slopes: Sequence[Sequence[Number]], residues: Sequence[Number]) -> tuple[list[Number], list[Number]]:
    """Return the change of phi by elimination without pivoting, and the pivots of I - D; D is given by rows."""
    count, right = len(residues), list(residues)
    rows = [[(i == j) - slopes[i][j] for j in range(count)] for i in range(count)]
    pivots = []
    for k in range(count):
        pivots.append(rows[k][k])
        for i in range(k + 1, count):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
            right[i] = right[i] - factor * right[k]
    for k in reversed(range(count)):
        for j in range(k + 1, count):
            right[k] = right[k] - rows[k][j] * right[j]
        right[k] = right[k] / rows[k][k]
    return right, pivots
