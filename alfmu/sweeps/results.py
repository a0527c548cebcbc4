"""Results of a sweep: its columns, its summary, its page."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cached_property
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError, needs
from ..model.files import write
from ..model.words import there_is
from .parts import FORMS, Folder, Plan, Store, read_plan
from .summary import QUANTILES, Summary, summarised

if TYPE_CHECKING:
    import pandas

SUMMARY, PAGE = "summary.json", "sweep.html"

STILL = 3
"""Largest number of constant measures listed individually."""

LISTED = 12
"""Number of measures listed by the command line."""

NOTED = 0.2
"""Rank correlation [1] below which the command line omits a varied quantity."""


class Sweep:
    """Results of a sweep: `sweep["max(A.force.x)"]` is an array with a value for each finished case.

    Columns are `case`, the varied names, the measures, `end_time` [s], `failure` and `warning` (texts, possibly empty);
    measures of a failed case are NaN. Columns are read from the parts on access.
    """

    def __init__(self, store: Store):
        self._store = store

    @classmethod
    def load(cls, folder: str | Path) -> Sweep:
        """Load the finished cases of a sweep from a folder; raise InputError if there is no sweep."""
        path = Path(folder)
        data = read_plan(path)
        try:
            plan, form = Plan.of_data(data), data["format"]
            if form not in FORMS:
                raise ValueError(f"the format is {form!r}")
            store = Folder(plan, path, form)
            store.look()
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"{path}: its plan cannot be read ({error!r})") from None
        return cls(store)

    def __repr__(self) -> str:
        return f"Sweep({self.said()})"

    def __len__(self) -> int:
        """Number of finished cases."""
        return self._store.finished

    @property
    def plan(self) -> Plan:
        """Settings of the sweep."""
        return self._store.plan

    @property
    def folder(self) -> Path | None:
        """Folder of the parts; None if they are in memory."""
        return self._store.path if isinstance(self._store, Folder) else None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return self.plan.columns

    @property
    def units(self) -> dict[str, str]:
        """Units of the columns that have one, by name."""
        return {name: unit for name in self.names if (unit := self.plan.unit(name))}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column (cases,) by its name; raise InputError if there is none."""
        if name not in self.names:
            raise InputError(f"the sweep of {self.plan.name} has no column {name!r}; {there_is(name, self.names)}")
        column = self._store.columns([name])[name]
        return column.astype(int) if name == "case" else column

    def over_time(self, name: str, most: int | None = None) -> NDArray[np.float64]:
        """Return an output of `keep_series` (cases, points) at the communication points `time`, of at most `most`
        cases."""
        if name not in self.plan.series:
            known = there_is(name, self.plan.series)
            raise InputError(f"the sweep of {self.plan.name} kept no {name!r} over time; {known} (keep_series)")
        return self._store.over_time(name, len(self) if most is None else most)

    @property
    def time(self) -> NDArray[np.float64]:
        """(points,) communication points [s]."""
        return self.plan.times

    @cached_property
    def summary(self) -> Summary:
        """Quantiles, worst cases, sensitivities by rank, and reasons of failures."""
        return summarised(self._store)

    def to_pandas(self) -> pandas.DataFrame:
        """Return all columns as a pandas table with the index `case`; `attrs["units"]` has the units.

        Needs `alfmu[pandas]`.
        """
        with needs("to_pandas() needs pandas", "pandas"):
            import pandas
        table = pandas.DataFrame(self._store.columns(self.names))
        table["case"] = table["case"].astype(int)
        table = table.set_index("case")
        table.attrs["units"] = self.units
        return table

    def save(self, page: bool = True) -> list[Path]:
        """Write `summary.json` and, if plotly is installed, the page `sweep.html` into the folder of the sweep."""
        if self.folder is None:
            raise InputError(f"the sweep of {self.plan.name} is in memory; give alfmu.sweep() a folder to save it in")
        wrote = [self.folder / SUMMARY]
        write(wrote[0], (json.dumps(self.summary.as_data(), indent=1) + "\n").encode())
        if page and find_spec("plotly"):
            wrote.append(self.page(self.folder / PAGE))
        return wrote

    def page(self, path: str | Path) -> Path:
        """Write one self-contained page with all plots. Needs `alfmu[sweep]`."""
        from .page import page

        write(path, page(self._store, self.summary).encode())
        return Path(path)

    def said(self) -> str:
        """Return the progress as a line of text."""
        s = f"{self.plan.name}: {len(self)} of {self.plan.cases} cases"
        return f"{s} in {self.folder}" if self.folder else s

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
        s = self.summary
        said = [f"{s.finished} of {s.cases} cases finished, {s.failed} of them failed"]
        for what, reasons in (("failed", s.failures), ("with a warning", s.warnings)):
            said += [f"  {x.count} {what}, the first case {x.cases[0]}: {x.reason}" for x in reasons]
        moving = [each for each in s.spreads if each.moves]
        width = max((len(each.name) for each in moving[:LISTED]), default=0)
        heads = [f"{100 * q:g} %" for q in QUANTILES[::2]]
        if moving:
            said.append(f"{'':{width}}  {heads[0]:>11} {heads[1]:>11} {heads[2]:>11}  largest (case), ranks with")
        for each in moving[:LISTED]:
            low, _, median, _, high = each.quantiles
            ranks = sorted(each.sensitivities.items(), key=lambda item: -abs(item[1]))
            with_ = ", ".join(f"{name} {r:+.2f}" for name, r in ranks[:3] if abs(r) >= NOTED)
            said.append(
                f"{each.name:{width}}  {low:11.5g} {median:11.5g} {high:11.5g}  {each.largest:.5g} {each.unit} "
                f"({each.largest_case}){', ' * bool(with_)}{with_}"
            )
        if more := len(moving) - LISTED:
            said += [f"and {more} more in {SUMMARY}"] if more > 0 else []
        still = [each for each in s.spreads if each.count and not each.moves]
        if len(still) > STILL:
            said.append(f"{len(still)} kept numbers do not vary between cases")
        for x in still if len(still) <= STILL else ():
            but = ", but for round-off" * (x.largest > x.least)
            said.append(f"{x.name} does not vary: {x.largest:.5g} {x.unit} in all cases{but}")
        return said

    def _repr_html_(self) -> str:
        """Return the summary as HTML for notebooks."""
        return f"<pre>{escape(chr(10).join([self.said(), *self.lines()]))}</pre>"


def show(progress: Callable[[Sequence[int]], Any], total: int) -> Callable[[int], None]:
    """Return a function that advances a progress bar by a number of cases."""
    shown = iter(progress(range(total)))

    def done(count: int) -> None:
        for _ in range(count):
            next(shown, None)

    return done
