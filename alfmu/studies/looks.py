"""Styles in all figures of a study: one colour and marker for each integrator; line styles for other differences."""

from collections.abc import Sequence

from ..model.settings import METHODS
from .charts import Line, Look
from .rivals import RIVALS
from .tables import Row

COLOURS = (
    *("#c0523a", "#d98c1f", "#3f9268", "#7a66b0", "#b0608c", "#8a6d3b", "#1f5fae"),
    *("#6b7680", "#a4acb3", "#222222", "#1f8f96", "#5aa9d6", "#93a83a", "#d0709a"),
    *("#55618a", "#a35d1f", "#4d7d6a", "#7d2f4f", "#b8a13c", "#2e3f8f", "#7fb5a0"),
)
MARKERS = (
    *(("o", "circle"), ("s", "square"), ("^", "triangle-up"), ("D", "diamond"), ("v", "triangle-down")),
    *(("P", "cross"), ("*", "star"), ("h", "hexagon"), ("<", "triangle-left"), (">", "triangle-right")),
    ("p", "pentagon"),
)

LINES = tuple(Line(*each) for each in (("-", "solid"), ("--", "dash"), (":", "dot"), ("-.", "dashdot")))
LINES += tuple(Line(*each) for each in (((0, (8, 3)), "longdash"), ((0, (8, 2, 2, 2)), "longdashdot")))


def integrator(row: Row) -> str:
    """Return the integrator of a run: a method of alfmu, or another code and its method."""
    return str(row["method"]) if row["code"] == "alfmu" else f"{row['code']}, {row['method']}"


def line_of(value: object, values: Sequence[object]) -> Line:
    """Return the line style of a value among several."""
    return LINES[list(values).index(value) % len(LINES)]


def _looks() -> dict[str, Look]:
    names = [*METHODS, *dict.fromkeys(f"{rival.name}, {rival.method}" for rival in RIVALS)]
    return {
        name: Look(COLOURS[i % len(COLOURS)], *MARKERS[i % len(MARKERS)], filled=name in METHODS)
        for i, name in enumerate(names)
    }


LOOKS = _looks()
"""Styles of all integrators in a report, by the name that `integrator` returns."""
