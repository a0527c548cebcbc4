"""Summary of a sweep: quantiles, worst cases, rank sensitivities, reasons of failures."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .parts import Plan, Store

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Probabilities [1] of the quantiles."""

AT_ONCE = 24
"""Number of columns read at once."""

SAME = 1e-12
"""Relative spread [1] below which a measure is constant up to round-off."""

_NUMBERS = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


@dataclass(frozen=True)
class Spread:
    """Statistics of one measure over all cases that did not fail."""

    name: str
    unit: str
    count: int
    """Number of cases with a value."""
    mean: float
    deviation: float
    least: float
    least_case: int
    largest: float
    largest_case: int
    quantiles: tuple[float, ...]
    """Quantiles at QUANTILES."""
    sensitivities: Mapping[str, float]
    """Spearman's rank correlation [1] with each varying quantity; empty if the measure is constant."""
    size: float
    """Largest magnitude of all measures of its unit, or without a unit, of its output."""

    @property
    def moves(self) -> bool:
        """Return whether the measure varies between cases by more than round-off."""
        return self.largest - self.least > SAME * self.size

    @property
    def scale(self) -> str:
        """Return the group of measures with a common size."""
        return self.name.partition("(")[2] if self.unit in ("", "1") else self.unit


@dataclass(frozen=True)
class Failures:
    """Cases that failed or had a warning for the same reason."""

    reason: str
    """The text of the first case."""
    cases: tuple[int, ...]
    """The numbers of the first cases, at most `FEW`."""
    count: int


FEW = 5
"""Number of cases listed for a reason."""


@dataclass(frozen=True)
class Summary:
    """Summary of all finished cases."""

    cases: int
    finished: int
    failed: int
    ranges: Mapping[str, tuple[float, float]]
    """Minimum and maximum of each varied quantity, over the finished cases."""
    spreads: Sequence[Spread]
    failures: Sequence[Failures]
    warnings: Sequence[Failures]

    def as_data(self) -> dict[str, Any]:
        """Return the summary as data for JSON; missing numbers are null."""

        def number(x: float) -> float | None:
            return float(x) if np.isfinite(x) else None

        def reasons(each: Sequence[Failures]) -> list[dict[str, Any]]:
            return [{"reason": x.reason, "count": x.count, "first_cases": list(x.cases)} for x in each]

        measures = [
            {
                "name": s.name,
                "unit": s.unit,
                "count": s.count,
                "varies": s.moves,
                "mean": number(s.mean),
                "deviation": number(s.deviation),
                "min": {"value": number(s.least), "case": s.least_case},
                "max": {"value": number(s.largest), "case": s.largest_case},
                "quantiles": {f"{q:g}": number(x) for q, x in zip(QUANTILES, s.quantiles, strict=True)},
                "rank_correlations": {name: number(x) for name, x in s.sensitivities.items()},
            }
            for s in self.spreads
        ]
        return {
            "cases": self.cases,
            "finished": self.finished,
            "failed": self.failed,
            "varied": {name: [number(x) for x in each] for name, each in self.ranges.items()},
            "measures": measures,
            "failures": reasons(self.failures),
            "warnings": reasons(self.warnings),
        }


def summarised(store: Store) -> Summary:
    """Return the summary of all finished cases, reading a few columns at a time."""
    plan = store.plan
    texts = store.columns(["case", "failure", "warning"])
    cases, failed = texts["case"].astype(int), texts["failure"] != ""
    varied = store.columns(plan.varied)
    ranges = {name: (x.min(), x.max()) if len(x) else (np.nan, np.nan) for name, x in varied.items()}
    spreads = _sized(list(_spreads(store, plan, cases, varied)))
    reasons = [_reasons(cases, texts[name]) for name in ("failure", "warning")]
    return Summary(plan.cases, len(cases), int(failed.sum()), ranges, spreads, *reasons)


def _spreads(
    store: Store, plan: Plan, cases: NDArray[np.int64], varied: Mapping[str, NDArray[np.float64]]
) -> Iterator[Spread]:
    ranks: dict[bytes, dict[str, NDArray[np.float64]]] = {}
    """Ranks of varied quantities among the cases with a value of the measure, shared by most measures."""
    for begin in range(0, len(plan.measures), AT_ONCE):
        for name, column in store.columns(plan.measures[begin : begin + AT_ONCE]).items():
            known = np.isfinite(column)
            if (key := np.packbits(known).tobytes()) not in ranks:
                ranks.clear()
                ranks[key] = {
                    each: _ranked(x[known]) for each, x in varied.items() if np.ptp(x[known] if known.any() else [0])
                }
            yield _spread(name, plan.unit(name), column[known], cases[known], ranks[key])


def _ranked(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return centred ranks of unit length."""
    from scipy.stats import rankdata

    ranks = rankdata(x)
    ranks -= ranks.mean()
    return ranks / (np.linalg.norm(ranks) or 1.0)


def _spread(
    name: str, unit: str, x: NDArray[np.float64], cases: NDArray[np.int64], varied: Mapping[str, NDArray[np.float64]]
) -> Spread:
    if not len(x):
        nothing = (np.nan,) * len(QUANTILES)
        return Spread(name, unit, 0, np.nan, np.nan, np.nan, -1, np.nan, -1, nothing, {}, 0.0)
    low, high = int(x.argmin()), int(x.argmax())
    quantiles = tuple(np.quantile(x, QUANTILES).tolist())
    ranks = _ranked(x)
    sensitivities = {each: float(ranks @ other) for each, other in varied.items()}
    return Spread(
        *(name, unit, len(x), float(x.mean()), float(x.std()), float(x[low]), int(cases[low]), float(x[high])),
        *(int(cases[high]), quantiles, sensitivities, float(np.abs(x).max())),
    )


def _sized(spreads: Sequence[Spread]) -> list[Spread]:
    """Return spreads with sizes among all measures, and without sensitivities due to round-off."""
    sizes: dict[str, float] = {}
    for s in spreads:
        sizes[s.scale] = max(s.size, sizes.get(s.scale, 0.0))
    found = [replace(s, size=sizes[s.scale]) for s in spreads]
    return [s if s.moves else replace(s, sensitivities={}) for s in found]


def _reasons(cases: NDArray[np.int64], texts: NDArray[Any]) -> list[Failures]:
    """Group texts that differ in their numbers alone, most frequent first."""
    groups: dict[str, list[int]] = {}
    for i in np.flatnonzero(texts != ""):
        groups.setdefault(_NUMBERS.sub("#", texts[i]), []).append(int(i))
    found = [Failures(str(texts[g[0]]), tuple(int(cases[i]) for i in g[:FEW]), len(g)) for g in groups.values()]
    return sorted(found, key=lambda each: -each.count)
