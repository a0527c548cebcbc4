"""Measures of a run: numbers by name such as `max(A.force.x)`, computed from columns over time."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError
from ..model.words import some_like, there_is

Table = NDArray[np.float64]

FUNCTIONS = {
    "final": "the last value",
    "min": "the least value",
    "max": "the largest value",
    "mean": "the mean over time",
    "peak": "the largest magnitude",
    "rms": "the root of the mean square over time",
}
"""Measures of an output over a run, at its communication points."""

USUAL = ("final", "min", "max", "mean")
"""Measures for a pattern of outputs without a function."""

INNER = ("multiplier[[]*", "monitor.*")
"""Patterns of outputs that are stored on request only."""

MOST_COLUMNS = 4000
"""Largest number of measures of a run."""

_CALL = re.compile(r"(\w+)\((.+)\)")


@dataclass(frozen=True, order=True)
class Measure:
    """One measure of a run."""

    function: str
    output: str

    def __str__(self) -> str:
        return f"{self.function}({self.output})"


def measures(unit: str, keep: Sequence[str] | None, outputs: Sequence[str]) -> list[Measure]:
    """Return the measures that match patterns, such as `A.force.*` (all of USUAL) or `max(A.force.*)`, each once.

    None stands for USUAL of all outputs but multipliers and monitors. Raises InputError if a pattern matches none.
    """
    if keep is None:
        names = [name for name in outputs if not any(fnmatchcase(name, inner) for inner in INNER)] or list(outputs)
        found = dict.fromkeys(Measure(function, name) for name in names for function in USUAL)
    else:
        found = {}
        for pattern in [keep] if isinstance(keep, str) else keep:
            called = None if _fitting(pattern, outputs) else _CALL.fullmatch(pattern)
            if called and called[1] not in FUNCTIONS:
                raise InputError(f"{unit}: {pattern} cannot be kept; {there_is(called[1], FUNCTIONS)}")
            functions, wanted = ((called[1],), called[2]) if called else (USUAL, pattern)
            each = matching(unit, [wanted], outputs)
            found |= dict.fromkeys(Measure(function, name) for name in each for function in functions)
    if not found:
        raise InputError(f"{unit}: nothing is kept of a run; name outputs to keep")
    if len(found) > MOST_COLUMNS:
        raise InputError(
            f"{unit}: {len(found)} numbers are to be kept of each run, more than {MOST_COLUMNS}; name the outputs to "
            'keep, such as --keep "max(*.force.*)"'
        )
    return list(found)


def inside(pattern: str) -> str:
    """Return the pattern of outputs in a pattern to keep: `A.force.*` in `max(A.force.*)`."""
    called = _CALL.fullmatch(pattern)
    return called[2] if called else pattern


def _fitting(pattern: str, outputs: Sequence[str]) -> list[str]:
    """Return the output of a name, or those that match a pattern."""
    return [name for name in outputs if name == pattern or fnmatchcase(name, pattern)]


def matching(unit: str, patterns: Sequence[str], outputs: Sequence[str]) -> list[str]:
    """Return the outputs that match names or patterns, each once; raise InputError if one matches none."""
    found: dict[str, None] = {}
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        fit = _fitting(pattern, outputs)
        if not fit:
            raise InputError(f"{unit} has no output {pattern!r} to keep; {some_like(pattern, outputs)}")
        found |= dict.fromkeys(fit)
    return list(found)


def measured(times: Table) -> dict[str, Callable[[Table], Table]]:
    """Return the functions of columns (points, outputs) over communication points (points,) [s], by name."""
    steps = np.diff(times)
    weights = (np.append(steps, 0.0) + np.append(0.0, steps)) / (2 * (times[-1] - times[0]))
    return {
        "final": lambda y: y[-1],
        "min": lambda y: y.min(axis=0),
        "max": lambda y: y.max(axis=0),
        "mean": lambda y: weights @ y,
        "peak": lambda y: np.abs(y).max(axis=0),
        "rms": lambda y: np.sqrt(weights @ y**2),
    }
