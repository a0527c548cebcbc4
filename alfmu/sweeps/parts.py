"""Files of a sweep: a plan, and one file for each part, written atomically.

The name of a part contains its cases, `part-00000000-00000999`; values over time are in `series-...` beside it, which
is written first. The missing cases of a plan follow from the names, so that a sweep can be resumed.
"""

from __future__ import annotations

import csv
import io
import json
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError
from ..model.files import exclusive, write
from ..simulation import communication_points
from .jobs import Part

Column = NDArray[Any]

PLAN = "plan.json"
"""File name of the plan."""

FORM = 1
"""Version of the file format."""

OWN = ("case", "end_time", "failure", "warning")
"""Columns of every sweep beside its measures."""

TEXTS = ("failure", "warning")

FORMS = ("parquet", "csv")
"""Formats of parts."""

_NAME = re.compile(r"part-(\d{8,12})-(\d{8,12})")


def usual_form() -> str:
    """Return parquet if pyarrow is installed, otherwise csv."""
    return "parquet" if find_spec("pyarrow") else "csv"


@dataclass(frozen=True)
class Plan:
    """The plan of a sweep, which identifies its parts."""

    name: str
    cases: int
    times: NDArray[np.float64]
    """Communication points [s]."""
    varied: tuple[str, ...]
    measures: tuple[str, ...]
    series: tuple[str, ...]
    units: Mapping[str, str]
    """Units of variables, by name."""
    asked: Mapping[str, Any]
    """All settings that determine the results, as data for JSON, including digests of the mechanism and the cases."""

    @classmethod
    def of_data(cls, data: Mapping[str, Any]) -> Plan:
        """Return the plan from the result of `as_data`."""
        times = communication_points(data["name"], data["stop_time"], data["communication_step"])
        varied, measures, series = (tuple(map(str, data[each])) for each in ("varied", "measures", "series"))
        units, asked = dict(data["units"]), data["asked"]
        return cls(str(data["name"]), int(data["cases"]), times, varied, measures, series, units, asked)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the table."""
        return ("case", *self.varied, *self.measures, *OWN[1:])

    def unit(self, column: str) -> str:
        """Return the unit of a column, empty if it has none or is unknown."""
        inner = re.fullmatch(r"\w+\((.*)\)", column) if column in self.measures else None
        own = {"end_time": "s", "time": "s"}
        return own.get(column) or self.units.get(column) or self.units.get(inner[1] if inner else "", "")

    def as_data(self) -> dict[str, Any]:
        return {
            "sweep": FORM,
            "name": self.name,
            "cases": self.cases,
            "stop_time": float(self.times[-1]),
            "communication_step": float(self.times[1] - self.times[0]),
            "varied": list(self.varied),
            "measures": list(self.measures),
            "series": list(self.series),
            "units": {name: self.unit(name) for name in (*self.columns, *self.series)},
            "asked": dict(self.asked),
        }


class Store(ABC):
    """Storage of parts."""

    plan: Plan

    @abstractmethod
    def done(self) -> list[tuple[int, int]]:
        """Return ranges of finished cases, first and stop, in ascending order."""

    @abstractmethod
    def add(self, part: Part) -> None:
        """Store a part."""

    @abstractmethod
    def columns(self, names: Sequence[str]) -> dict[str, Column]:
        """Return columns of all finished cases, in ascending order."""

    @abstractmethod
    def over_time(self, name: str, most: int) -> NDArray[np.float64]:
        """Return one output over time (cases, points), of at most `most` finished cases, evenly distributed."""

    def missing(self) -> list[tuple[int, int]]:
        """Return ranges of cases that are not finished."""
        found, at = [], 0
        for first, stop in self.done():
            if first > at:
                found.append((at, first))
            at = stop
        return found + ([(at, self.plan.cases)] if at < self.plan.cases else [])

    @property
    def finished(self) -> int:
        """Return the number of finished cases."""
        return sum(stop - first for first, stop in self.done())

    def _spread(self, most: int) -> NDArray[np.int64]:
        """Return indices of at most `most` finished cases, evenly distributed."""
        count = self.finished
        return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int)) if count else np.empty(0, int)


def _columns_of(plan: Plan, part: Part) -> dict[str, Any]:
    """Return the columns of a part by name."""
    found: dict[str, Any] = {"case": np.arange(part.first, part.first + len(part))}
    found |= {name: part.values[:, i] for i, name in enumerate(plan.varied)}
    found |= {name: part.kept[:, i] for i, name in enumerate(plan.measures)}
    return found | {"end_time": part.ended, "failure": part.failures, "warning": part.warnings}


@dataclass
class Held(Store):
    """Parts in memory."""

    plan: Plan
    parts: list[Part] = field(default_factory=list)

    def done(self) -> list[tuple[int, int]]:
        self.parts.sort(key=lambda part: part.first)
        return [(part.first, part.first + len(part)) for part in self.parts]

    def add(self, part: Part) -> None:
        self.parts.append(part)

    def columns(self, names: Sequence[str]) -> dict[str, Column]:
        self.done()
        of_parts = [_columns_of(self.plan, part) for part in self.parts]
        return {
            name: np.concatenate([[], *(each[name] for each in of_parts)])
            if name not in TEXTS
            else np.array([text for each in of_parts for text in each[name]], object)
            for name in names
        }

    def over_time(self, name: str, most: int) -> NDArray[np.float64]:
        self.done()
        k, places = self.plan.series.index(name), self._spread(most)
        return np.concatenate([part.series[:, :, k] for part in self.parts])[places]


@dataclass
class Folder(Store):
    """Parts as files in a folder."""

    plan: Plan
    path: Path
    form: str
    _done: list[tuple[int, int]] = field(default_factory=list)

    @classmethod
    @contextmanager
    def opened(cls, plan: Plan, path: Path, form: str) -> Iterator[Folder]:
        """Open the folder of a plan for this process alone while the block runs; create it if needed.

        Raises InputError if another process has it, or if it contains something else.
        """
        with exclusive(path) as ours:
            if not ours:
                raise InputError(
                    f"{path}: another process makes runs into this folder; wait for it, or name another -o"
                )
            found = cls(plan, path, form)
            if (path / PLAN).exists():
                found._check()
            elif any(path.iterdir()):
                raise InputError(f"{path} has other files and no {PLAN}; name another folder with -o, or empty it")
            else:
                data = {**plan.as_data(), "format": form}
                write(path / PLAN, (json.dumps(data, indent=1) + "\n").encode())
            found.look()
            yield found

    def look(self) -> None:
        """Update the list of parts, of a folder that another process may write to."""
        self._done = self._ranges()

    def _check(self) -> None:
        """Raise InputError if the folder contains another plan."""
        known = read_plan(self.path)
        asked = {**json.loads(json.dumps(self.plan.as_data())), "format": self.form}
        # A user's settings are compared first; digests, which explain little, last.
        mine, theirs = ({**x["asked"], **{key: x.get(key) for key in asked if key != "asked"}} for x in (asked, known))
        keys = sorted({**theirs, **mine}, key=lambda key: key.startswith("digest"))
        if differing := [key for key in keys if theirs.get(key) != mine.get(key)]:
            key = differing[0]
            one, other = _short(theirs.get(key)), _short(mine.get(key))
            raise InputError(
                f"{self.path} has another sweep, in which {key} is {one}, not {other}; name another folder with -o, or "
                "remove this one"
            )

    def _ranges(self) -> list[tuple[int, int]]:
        """Return ranges of the parts in the folder; raise InputError if they cannot belong to one sweep."""
        names = (_NAME.fullmatch(path.stem) for path in self.path.glob(f"part-*.{self.form}"))
        found, at = [(int(name[1]), int(name[2]) + 1) for name in names if name], 0
        for first, stop in sorted(found):
            if first < at or stop > self.plan.cases or stop <= first:
                raise InputError(
                    f"{self.path}: {self._file('part', first, stop).name} has cases of other parts, or none of this "
                    "sweep; remove it, and start again"
                )
            at = stop
        return sorted(found)

    def done(self) -> list[tuple[int, int]]:
        return self._done

    def _file(self, what: str, first: int, stop: int) -> Path:
        return self.path / f"{what}-{first:08d}-{stop - 1:08d}.{self.form}"

    def add(self, part: Part) -> None:
        plan, reach = self.plan, (part.first, part.first + len(part))
        if plan.series:
            write(self._file("series", *reach), self._bytes(_long(plan, part)))
        write(self._file("part", *reach), self._bytes(_columns_of(plan, part)))
        self._done = sorted([*self._done, reach])

    def _bytes(self, columns: Mapping[str, Any]) -> bytes:
        """Return the content of the file for a table."""
        if self.form == "csv":
            text = io.StringIO()
            writer = csv.writer(text)
            writer.writerow(columns)
            lists = (column if isinstance(column, list) else column.tolist() for column in columns.values())
            writer.writerows(zip(*lists, strict=True))
            return text.getvalue().encode()
        import pyarrow
        from pyarrow import parquet

        table = pyarrow.table(
            [pyarrow.array(column) for column in columns.values()],
            schema=pyarrow.schema(
                [
                    pyarrow.field(
                        name,
                        pyarrow.string() if name in TEXTS else pyarrow.int64() if name == "case" else pyarrow.float64(),
                        metadata={"unit": self.plan.unit(name)},
                    )
                    for name in columns
                ]
            ),
        )
        into = io.BytesIO()
        parquet.write_table(
            table, into, use_dictionary=[name for name in TEXTS if name in columns], write_statistics=False
        )
        return into.getvalue()

    def columns(self, names: Sequence[str]) -> dict[str, Column]:
        found = {name: np.empty(self.finished, object if name in TEXTS else float) for name in names}
        at = 0
        for first, stop in self._done:
            for name, column in self._read("part", first, stop, names, stop - first).items():
                found[name][at : at + stop - first] = column
            at += stop - first
        return found

    def over_time(self, name: str, most: int) -> NDArray[np.float64]:
        points, places = len(self.plan.times), self._spread(most)
        found, at = np.empty((len(places), points)), 0
        for first, stop in self._done:
            within = places[(places >= at) & (places < at + stop - first)]
            if len(within):
                column = self._read("series", first, stop, [name], (stop - first) * points)[name]
                begin = np.searchsorted(places, within[0])
                found[begin : begin + len(within)] = column.reshape(-1, points)[within - at]
            at += stop - first
        return found

    def _read(self, what: str, first: int, stop: int, names: Sequence[str], rows: int) -> dict[str, Column]:
        """Return columns of a file; raise InputError if it is damaged."""
        path = self._file(what, first, stop)
        try:
            read = _read_csv if self.form == "csv" else _read_parquet
            found = read(path, names)
            if any(len(column) != rows for column in found.values()):
                raise ValueError(f"it has not {rows} rows")
        except (OSError, ValueError, KeyError) as error:
            raise InputError(
                f"{path} cannot be read ({getattr(error, 'strerror', None) or error}); remove it, and the same command "
                "makes its cases again"
            ) from None
        return found


def _long(plan: Plan, part: Part) -> dict[str, Any]:
    """Return values over time as a long table: a row for each case and communication point."""
    points = len(plan.times)
    found: dict[str, Any] = {"case": np.repeat(np.arange(part.first, part.first + len(part)), points)}
    found["time"] = np.tile(plan.times, len(part))
    return found | {name: part.series[:, :, k].ravel() for k, name in enumerate(plan.series)}


def _read_parquet(path: Path, names: Sequence[str]) -> dict[str, Column]:
    from pyarrow import ArrowException, parquet

    try:
        table = parquet.read_table(path, columns=list(names), memory_map=False, use_threads=False)
        return {name: table.column(name).to_numpy(zero_copy_only=False) for name in names}
    except ArrowException as error:
        raise ValueError(str(error).splitlines()[0]) from None


def _read_csv(path: Path, names: Sequence[str]) -> dict[str, Column]:
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.reader(file, strict=True)
        heads = next(reader, [])
        places = [heads.index(name) for name in names]
        rows = [[row[i] for i in places] for row in reader]
    columns = list(zip(*rows, strict=True)) if rows else [()] * len(names)
    return {
        name: np.array(column, object) if name in TEXTS else np.array(column, float)
        for name, column in zip(names, columns, strict=True)
    }


def read_plan(path: Path) -> dict[str, Any]:
    """Return the plan in a folder; raise InputError if there is none, or its version is unknown."""
    try:
        found = json.loads((path / PLAN).read_bytes())
        if found["sweep"] != FORM or not isinstance(found["asked"], dict):
            raise ValueError(f"it is of version {found['sweep']!r}, not {FORM}")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: its {PLAN} is not that of a sweep that can be read ({why})") from None
    return found


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def kept(store: Store) -> str:
    """Return a message on the stored results of an interrupted sweep."""
    if isinstance(store, Folder):
        return f"{store.finished} of {store.plan.cases} cases are in {store.path}; the same command goes on from there"
    return f"{store.finished} of {store.plan.cases} cases were finished"
