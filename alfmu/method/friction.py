"""Newton's method for friction that follows from the load, on arrays and symbols alike.

Forces phi of joints that slide are what their laws say of the reactions, phi = law(a, lambda); a and lambda are affine
in phi, as (4) and (3) are linear. With the slopes D of law(phi) the change of phi is that of (I - D) dphi = law - phi.
Where friction goes on from none without a fold, all pivots of I - D are positive. At a fold they vanish: a jam.
"""

from collections.abc import Sequence
from typing import Any

__all__ = ["ENOUGH", "MOST", "PIVOT", "SETTLED", "newton"]

MOST = 12
"""Most passes of Newton's method in an evaluation: from no friction to round-off it takes three to five."""

ENOUGH = 1e-7
"""What the last pass may find left of a law, over the friction: Newton's method then leaves round-off."""

SETTLED = 1e-6
"""What the last pass may leave of a law, over the friction: a pass that is no better has found none."""

PIVOT = 1e-3
"""Pivot of I - D beside which a motion that cannot go on has met a jam; 1 without friction, negative beyond a fold."""

Number = Any


def newton(slopes: Sequence[Sequence[Number]], residues: Sequence[Number]) -> tuple[list[Number], list[Number]]:
    """The change of phi by elimination without exchange of rows, and the pivots of I - D; D is given by rows."""
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
