"""Cases of tests with several parameters: fewer than all combinations of their values."""

import os
from collections.abc import Sequence
from itertools import combinations, product
from typing import Any


def draws(least: int) -> int:
    """The number DRAWS of the environment, but no less than this: of random cases, which more than one make all."""
    return max(least, int(os.environ.get("DRAWS", "1")))


ALL = draws(1) > 1
"""Whether all combinations are tested: `DRAWS=2 pytest tests/test_rows.py`."""


def pairs(*parameters: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Combinations in which each value of a parameter meets each value of every other one; all if `ALL`."""
    every, chosen = list(product(*(range(len(values)) for values in parameters))), []
    met = {case: set(combinations(enumerate(case), 2)) for case in every}
    left = set().union(*met.values())
    while left:
        best = max(every, key=lambda case: len(met[case] & left))
        chosen.append(best)
        left -= met[best]
    return [tuple(values[k] for values, k in zip(parameters, c, strict=True)) for c in (every if ALL else chosen)]
