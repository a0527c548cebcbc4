"""Variations of a sweep: grids, lists and distributions in a small grammar, tables of cases, and their product."""

from __future__ import annotations

import csv
import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from ..model.errors import InputError
from ..model.words import in_words, there_is

Column = NDArray[np.float64]

MOST_CASES = 50_000_000
"""Largest number of cases of a sweep: a year of runs of half a second."""

MOST_SAMPLED = 200_000_000
"""Largest number of samples from distributions: 1.6 GB, drawn at once."""

SAMPLERS = {
    "latin": "Latin hypercube: each number has one sample in each of as many equal shares of its probability",
    "sobol": "Sobol points, scrambled: the most even cover; numbers of samples that are powers of 2 keep its balance",
    "random": "independent samples",
}
"""Functions that draw samples, by name."""

_EDGE = 2.0**-53
"""Smallest distance [1] of probabilities from 0 and 1, where normal quantiles are infinite: round-off."""


@dataclass(frozen=True)
class _Kind:
    """A kind of distribution: its parameters by name, their conditions, and its quantiles."""

    numbers: tuple[str, ...]
    check: Callable[..., bool]
    must: str
    quantile: Callable[..., Column]


def _triangle(u: Column, low: float, mode: float, high: float) -> Column:
    rise, width = (mode - low), (high - low)
    below = low + np.sqrt(u * width * rise)
    return np.where(u * width < rise, below, high - np.sqrt((1 - u) * width * (high - mode)))


def _truncated(u: Column, mean: float, deviation: float, low: float, high: float) -> Column:
    least, most = ndtr((low - mean) / deviation), ndtr((high - mean) / deviation)
    return np.clip(mean + deviation * ndtri(least + u * (most - least)), low, high)


_KINDS = {
    "uniform": [_Kind(("low", "high"), lambda a, b: a < b, "low < high", lambda u, a, b: a + (b - a) * u)],
    "loguniform": [
        _Kind(("low", "high"), lambda a, b: 0 < a < b, "0 < low < high", lambda u, a, b: a * (b / a) ** u),
    ],
    "normal": [
        _Kind(("mean", "deviation"), lambda m, s: s > 0, "deviation > 0", lambda u, m, s: m + s * ndtri(u)),
        _Kind(
            ("mean", "deviation", "low", "high"),
            lambda m, s, a, b: s > 0 and a < b and ndtr((b - m) / s) - ndtr((a - m) / s) > 1e-9,
            "deviation > 0, low < high, and a part of the distribution between these",
            _truncated,
        ),
    ],
    "lognormal": [
        _Kind(
            ("median", "deviation of the logarithm"),
            lambda m, s: m > 0 and s > 0,
            "median > 0 and deviation > 0",
            lambda u, m, s: m * np.exp(s * ndtri(u)),
        ),
    ],
    "triangular": [
        _Kind(("low", "mode", "high"), lambda a, m, b: a <= m <= b and a < b, "low <= mode <= high", _triangle),
    ],
}

DISTRIBUTIONS = {
    name: " or ".join(f"{name}({', '.join(kind.numbers)})" for kind in kinds) for name, kinds in _KINDS.items()
}
"""Distributions of the grammar, and their notation."""


@dataclass(frozen=True)
class Distribution:
    """A distribution of one number, given by its quantiles."""

    name: str
    numbers: tuple[float, ...]

    def quantiles(self, u: Column) -> Column:
        """Return the quantiles at probabilities u (n,)."""
        kind = next(k for k in _KINDS[self.name] if len(k.numbers) == len(self.numbers))
        return kind.quantile(np.clip(u, _EDGE, 1 - _EDGE), *self.numbers)


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_GRID = re.compile(rf"({_NUMBER}):({_NUMBER}):(\d+)(:log)?")
_LIST = re.compile(rf"{_NUMBER}(?:,{_NUMBER})*")
_DRAWN = re.compile(rf"([a-z]+)\(({_NUMBER}(?:,{_NUMBER})*)\)")


def parsed(name: str, text: str | Sequence[float]) -> Column | Distribution:
    """Parse a variation: a grid `first:last:count[:log]`, a list `a,b,c`, or a distribution.

    Nothing in it is executed. Raises InputError if it is none of these.
    """
    if not isinstance(text, str):
        return _values(name, text)
    said = re.sub(r"\s+", "", text)
    if found := _GRID.fullmatch(said):
        return _grid(name, text, float(found[1]), float(found[2]), int(found[3]), bool(found[4]))
    if _LIST.fullmatch(said):
        return _values(name, [float(each) for each in said.split(",")])
    if found := _DRAWN.fullmatch(said):
        return _drawn(name, text, found[1], tuple(float(each) for each in found[2].split(",")))
    raise InputError(
        f"{name}={text}: this is no variation; give a grid first:last:count (or first:last:count:log), values a,b,c or "
        f"a distribution such as uniform(0.9,1.1), of {', '.join(DISTRIBUTIONS)}"
    )


def _values(name: str, given: Sequence[float]) -> Column:
    """Return given values as a column."""
    try:
        found = np.atleast_1d(np.array(given, float))
    except (TypeError, ValueError):
        raise InputError(f"{name}: {given!r} are not numbers to vary it by") from None
    if found.ndim > 1 or not found.size or not np.isfinite(found).all():
        raise InputError(f"{name}: {given!r} must be one or more finite numbers in a row")
    return found


def _grid(name: str, text: str, first: float, last: float, count: int, logarithmic: bool) -> Column:
    if not 2 <= count <= MOST_CASES:
        raise InputError(
            f"{name}={text}: a grid has 2 to {MOST_CASES:.0e} values; give one value alone as {name}={first:g}"
        )
    if not (math.isfinite(first) and math.isfinite(last)) or (logarithmic and not (first > 0 and last > 0)):
        raise InputError(f"{name}={text}: both ends must be finite{' and above zero' * logarithmic}")
    return np.geomspace(first, last, count) if logarithmic else np.linspace(first, last, count)


def _drawn(name: str, text: str, kind: str, numbers: tuple[float, ...]) -> Distribution:
    if kind not in _KINDS:
        raise InputError(f"{name}={text}: there is no distribution {kind!r}; {there_is(kind, DISTRIBUTIONS)}")
    known = next((k for k in _KINDS[kind] if len(k.numbers) == len(numbers)), None)
    if known is None:
        raise InputError(f"{name}={text}: {len(numbers)} numbers; give {DISTRIBUTIONS[kind]}")
    if not (all(map(math.isfinite, numbers)) and known.check(*numbers)):
        raise InputError(f"{name}={text}: it must have {known.must}")
    return Distribution(kind, numbers)


def read_cases(path: str | Path) -> dict[str, Column]:
    """Read a table of cases: a CSV file with a row of names, and a row of finite numbers for each case."""
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            names, *rows = [row for row in csv.reader(file, strict=True) if row] or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"cannot read the cases in {path} ({getattr(error, 'strerror', None) or error})") from None
    names = [name.strip() for name in names]
    if not all(names) or len(set(names)) < len(names) or not rows:
        raise InputError(f"{path} has no cases: it needs a row of names, each once, and a row of numbers for each case")
    table = np.empty((len(rows), len(names)))
    for i, row in enumerate(rows):
        try:
            table[i] = row
        except ValueError:
            table[i] = np.nan
        if not np.isfinite(table[i]).all():
            raise InputError(
                f"{path}, case {i + 1}: {','.join(row)[:60]!r} does not have {len(names)} finite numbers with commas "
                "between them, one under each name"
            )
    return {name: table[:, i] for i, name in enumerate(names)}


def table_of_cases(columns: Mapping[str, Sequence[float]]) -> dict[str, Column]:
    """Return a table of cases from columns; raise InputError if their lengths differ."""
    found = {name: _values(name, column) for name, column in columns.items()}
    if len({len(column) for column in found.values()}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in found.items())
        raise InputError(f"a table of cases has a number for each case in each column; these have {lengths}")
    return found


@dataclass(frozen=True)
class Cases:
    """The values of all cases: the product of tables, the first of which varies slowest.

    Only the tables are stored; `values` computes the values of some cases on demand.
    """

    names: tuple[str, ...]
    tables: tuple[Column, ...]
    """Tables (rows, columns); their columns in order are those of the names."""

    @property
    def shape(self) -> tuple[int, ...]:
        return tuple(len(table) for table in self.tables)

    def __len__(self) -> int:
        return math.prod(self.shape)

    def values(self, first: int, stop: int) -> Column:
        """Return the values (stop - first, names) of cases first, first + 1, ..., stop - 1."""
        places = np.unravel_index(np.arange(first, stop), self.shape)
        return np.hstack([table[at] for table, at in zip(self.tables, places, strict=True)])

    def digest(self) -> str:
        """Return a digest of all values."""
        found = hashlib.sha256(repr(self.names).encode())
        for table in self.tables:
            found.update(repr(table.shape).encode() + np.ascontiguousarray(table, "<f8").tobytes())
        return found.hexdigest()


def planned(
    vary: Mapping[str, str | Sequence[float]],
    samples: int | None,
    sampler: str,
    seed: int,
    table: Mapping[str, Column] | None = None,
) -> Cases:
    """Return the cases of a sweep: each row of the table at each point of all grids and lists with each sample.

    Samples are the same at every point, which makes points comparable. Raises InputError if something is missing, is
    given twice, or is too large.
    """
    table = table or {}
    if sampler not in SAMPLERS:
        raise InputError(f"there is no sampler {sampler!r}; use {in_words(list(SAMPLERS))}")
    if twice := set(table) & set(vary):
        raise InputError(f"{min(twice)} is varied and has a column in the table of cases; leave one out")
    found = {name: parsed(name, text) for name, text in vary.items()}
    grids = {name: each for name, each in found.items() if not isinstance(each, Distribution)}
    drawn = {name: each for name, each in found.items() if isinstance(each, Distribution)}
    if not (found or table):
        raise InputError("nothing is varied; give --vary NAME=... or a table of cases")
    if drawn and (samples is None or samples < 1):
        raise InputError(
            f"{next(iter(drawn))} has a distribution; say how many samples are drawn, 1 or more (--samples)"
        )
    if samples is not None and not drawn:
        raise InputError(f"{samples} samples are asked for, but nothing has a distribution, as in m=uniform(0.9,1.1)")
    tables = [np.column_stack(list(table.values()))] if table else []
    tables += [column[:, None] for column in grids.values()]
    if (count := math.prod(len(each) for each in tables) * (samples or 1)) > MOST_CASES:
        raise InputError(
            f"{count:.3g} cases are more than the {MOST_CASES:.0e} that a sweep may have; vary less at once"
        )
    if drawn:
        tables.append(_sampled(list(drawn.values()), samples or 1, sampler, seed))
    return Cases((*table, *grids, *drawn), tuple(tables))


def _sampled(drawn: Sequence[Distribution], samples: int, sampler: str, seed: int) -> Column:
    """Return samples of independent distributions."""
    if samples * len(drawn) > MOST_SAMPLED:
        raise InputError(f"{samples} samples of {len(drawn)} numbers are more than the {MOST_SAMPLED:.0e} to be drawn")
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed is {seed}; it must be a whole number from 0 to 2^63 - 1")
    generator = np.random.default_rng(seed)
    if sampler == "random":
        u = generator.random((samples, len(drawn)))
    else:
        from scipy.stats import qmc

        if sampler == "latin":
            u = qmc.LatinHypercube(len(drawn), seed=generator).random(samples)
        else:  # drawn by powers of 2, as SciPy warns otherwise
            u = qmc.Sobol(len(drawn), seed=generator).random_base2(math.ceil(math.log2(samples)))[:samples]
    return np.column_stack([each.quantiles(u[:, i]) for i, each in enumerate(drawn)])
