"""Result of a run: columns over time by name, as a table in a file, a plot or a film; inputs from tables.

A table `run.csv` has a companion `run.json` with data that columns cannot store: settings of the run, units, drawing.
Importers of FMUs can read the table alone.
"""

from __future__ import annotations

import codecs
import csv
import json
import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..equations.interface import Counters
from ..model.content import content
from ..model.errors import InputError, needs
from ..model.files import atomic, write
from ..model.hooks import handed_in
from ..model.mechanism import Mechanism
from ..model.words import counted, some_like

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Table = Sequence[float] | NDArray[Any]

Signal = float | Callable[[float], float] | tuple[Table, Table]
"""An input over time: a number, a function of time [s], or a table (times, values) that is interpolated linearly."""

_ROWS = 25
"""Number of rows shown in a notebook."""


OFF = 1e-3
"""Error of a position over 1 rad, or over the largest length of a run [1], above which a warning is issued."""

_NONE = 1e-6
"""Length over the largest coordinate [1] below which nothing moves and only round-off differs."""


@dataclass(frozen=True)
class Check:
    """Deviation of the positions of a run from one with a finer setting, which estimates its error."""

    setting: str
    """The solver setting that was finer."""
    value: float
    errors: Mapping[str, float]
    """Largest difference of each column [in its unit]: of angles and lengths, or of all if there are none."""
    worst: str
    """The column with the largest relative error: relative to 1 rad for angles, to the largest distance along one axis
    (independent of the origin) for lengths, to the largest value in their unit for others."""
    unit: str
    share: float
    """Relative error of that column."""
    since: float | None
    """First time [s] at which the relative error exceeds `OFF`; None if it never does."""

    @classmethod
    def of(cls, result: Result, finer: Result, setting: str, value: float) -> Check:
        """Return the differences of two runs with the same communication points."""
        places = [name for name in result.names if result.units.get(name) in ("rad", "m")] or list(result.names)
        largest, spans = {"rad": 1.0}, dict[str, list[NDArray[np.float64]]]()
        for name in (x for x in places if result.units[x] != "rad"):
            unit, size = result.units[name], float(np.abs(result[name]).max(initial=0.0))
            largest[unit] = max(largest.get(unit, 0.0), size)
            if unit == "m":
                spans.setdefault(name.rpartition(".")[2], []).append(result[name])
        if spans:
            largest["m"] = max(_NONE * largest["m"], *(float(np.ptp(each)) for each in spans.values()))
        off = {name: np.abs(result[name] - finer[name]) for name in places}
        shares = {name: x / (largest[result.units[name]] or 1.0) for name, x in off.items()}
        worst = max(shares, key=lambda name: float(shares[name].max()))
        late = np.flatnonzero(shares[worst] > OFF)
        return cls(
            setting,
            value,
            {name: float(x.max()) for name, x in off.items()},
            worst,
            result.units[worst],
            float(shares[worst].max()),
            float(result.time[late[0]]) if late.size else None,
        )

    def __str__(self) -> str:
        error = f"{self.worst} is off by {self.errors[self.worst]:.2g} {self.unit} at most"
        return f"{error}, compared with a run with {self.setting} {self.value:g}"


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """Outputs and inputs over time: `result["link1.angle"]` is an array like `result.time`.

    A pattern selects several columns: `result["link*.angle"]` is an array (rows, columns),
    `result.select("link*.angle")` a result with these columns alone. `time` (rows,) is in s, `values` (rows, columns)
    has one row per communication point, `names` and `units` describe its columns. A result behaves as a dictionary of
    names, without the time: `"A.force.x" in result`, `len(result)`, `dict(result)`.
    """

    mechanism: str
    time: NDArray[np.float64]
    """Communication points (rows,) [s]."""
    names: tuple[str, ...]
    units: Mapping[str, str]
    """Unit of each column, if known; foreign tables have none."""
    values: NDArray[np.float64]
    """Values (rows, columns): one row per communication point, one column per name."""
    counters: Counters | None = None
    """Work and largest errors; None if another solver made the run."""
    facts: Mapping[str, Any] = field(default_factory=dict)
    """Description of the run: `mechanism`, `options` and `parameters`; for a table from a file, all facts in its
    companion file."""
    declared: Mechanism | None = None
    """The mechanism, if it is known and not only its drawing."""
    check: Check | None = None
    """Deviation from a run with a finer setting, on request."""
    _ran: str | None = field(default=None, init=False)
    """Content of the declaration at the time of the run."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "_ran", self.declared and content(self.declared))

    def __repr__(self) -> str:
        return f"Result({self._said()})"

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def keys(self) -> tuple[str, ...]:
        """Return the names, so that `dict(result)` has the columns by name."""
        return self.names

    def __getitem__(self, name: str | tuple[str, ...] | list[str]) -> NDArray[np.float64]:
        """Return a column (rows,) by its name, including `time`, or the columns (rows, columns) of a pattern or list.

        Raises InputError if no column matches, with the most similar names.
        """
        if not isinstance(name, str):
            return self.values[:, self._places(name)]
        if name in self.names:
            return self.values[:, self.names.index(name)]
        return self.time if name == "time" else self.values[:, self._places((name,))]

    def select(self, *patterns: str) -> Result:
        """Return a result with only the columns that match a name or a pattern, in their order."""
        places = self._places(patterns)
        names = tuple(self.names[i] for i in places)
        units = {name: self.units[name] for name in names if name in self.units}
        return replace(self, names=names, units=units, values=self.values[:, places])

    def _places(self, patterns: Sequence[str]) -> list[int]:
        """Return indices of columns that match the patterns, each once."""
        found: dict[int, None] = {}
        for pattern in patterns:
            fit = [i for i, name in enumerate(self.names) if name == pattern or fnmatchcase(name, pattern)]
            if not fit:
                what = "no column like" if set(pattern) & set("*?") else "no column"
                raise InputError(
                    f"the result of {self.mechanism} has {what} {pattern!r}; {some_like(pattern, self.names)}"
                )
            found |= dict.fromkeys(fit)
        return list(found)

    # Display -----------------------------------------------------------------------------------------------------

    def to_pandas(self) -> pandas.DataFrame:
        """Return a pandas table with the index `time` [s]; `attrs["units"]` has the units. Needs `alfmu[pandas]`."""
        with needs("to_pandas() needs pandas", "pandas"):
            import pandas
        table = pandas.DataFrame(
            self.values, pandas.Index(self.time, name="time"), pandas.Index(self.names, dtype=object)
        )
        table.attrs["units"] = dict(self.units)
        return table

    def plot(self, names: Sequence[str] | str | None = None, *more: str) -> Figure:
        """Return a matplotlib figure over time, of names or patterns such as "link*.angle", as a list or as arguments.

        See `alfmu.view.plot.figure`. A notebook displays it, `savefig("run.png")` writes it. Needs `alfmu[plot]`.
        """
        found = None if names is None else [*([names] if isinstance(names, str) else names), *more]
        figure: Figure = handed_in("plot")(self, found)
        return figure

    def animate(self, path: str | Path | None = None, *, fps: float = 25.0, speed: float = 1.0) -> Film | None:
        """Return a film of the motion for a notebook, or write it as `.gif` or `.html`.

        `speed` is the time [s] shown per second, `fps` the frames per second of a GIF. Raises InputError if there is no
        drawing of the mechanism, as with a foreign table or FMU.
        """
        film: Film | None = handed_in("animate")(self, path, fps, speed)
        return film

    def _repr_html_(self) -> str:
        """Return the range of each column as HTML for notebooks."""
        heads = ("", "unit", "start", "end", "least", "largest")
        rows = []
        for name, column in zip(self.names[:_ROWS], self.values.T, strict=False):
            numbers = (column[0], column[-1], column.min(), column.max()) if len(column) else ()
            cells = [name, self.units.get(name, ""), *(f"{x:.6g}" for x in numbers)]
            rows.append("".join(f"<td>{escape(cell)}</td>" for cell in cells))
        more = len(self.names) - _ROWS
        rows += [f'<td colspan="6">and {more} more columns</td>'] if more > 0 else []
        body = "".join(f"<tr>{row}</tr>" for row in ["".join(f"<th>{head}</th>" for head in heads), *rows])
        return f"<table><caption>{escape(self._said())}</caption>{body}</table>"

    def _said(self) -> str:
        span = f" from {self.time[0]:g} to {self.time[-1]:g} s" if len(self.time) else ""
        sizes = f"{counted(len(self.time), 'row')}{span}, {counted(len(self.names), 'column')}"
        return f"{self.mechanism}: {sizes}"

    # Tables ------------------------------------------------------------------------------------------------------

    @classmethod
    def from_csv(cls, path: str | Path) -> Result:
        """Read a table with a column `time` and columns of numbers, with the units and drawing that alfmu wrote beside
        it. Nothing in it is executed."""
        names, table = _table(path)
        facts = facts_in(facts_beside(path))
        name, units = facts.get("name"), facts.get("units")
        units = units if isinstance(units, dict) else {}
        return cls(
            name if isinstance(name, str) else Path(path).stem,
            table[:, 0],
            tuple(names[1:]),
            {each: units[each] for each in names[1:] if isinstance(units.get(each), str)},
            table[:, 1:],
            facts=facts,
        )

    def to_csv(self, path: str | Path) -> None:
        """Write time and all columns with 17 significant digits under a row of names, and units and settings beside it.

        The latter go to a file of the same name with the suffix `.json`. Raises WriteError, and InputError if that file
        exists and alfmu did not write it.
        """
        beside = facts_beside(path)
        if beside.exists() and not facts_in(beside):
            raise InputError(f"{beside} exists and was not written by alfmu; take another name, or remove it")
        with atomic(path) as file:
            writer = csv.writer(codecs.getwriter("utf-8")(file))
            writer.writerow(["time", *self.names])
            for t, row in zip(self.time, self.values, strict=True):
                writer.writerow([f"{x:.17g}" for x in (t, *row)])
        facts: dict[str, Any] = {"mechanism": self.mechanism, "options": {}, "parameters": {}, **self.facts}
        facts |= {"name": self.mechanism, "units": dict(self.units), "drawing": handed_in("drawing_of")(self)}
        lines = (f" {json.dumps(key)}: {json.dumps(value, default=_as_json)}" for key, value in facts.items())
        write(beside, ("{\n" + ",\n".join(lines) + "\n}\n").encode())

    def shown(self) -> Mechanism | None:
        """Return the mechanism of the run; raise InputError if it was changed since."""
        if self.declared is not None and content(self.declared) != self._ran:
            raise InputError(
                f"{self.mechanism} was changed since this run, so that its motion cannot be drawn any more"
            )
        return self.declared


@dataclass(frozen=True, repr=False)
class Film:
    """A film as a self-contained page, which a notebook displays."""

    html: str

    def __repr__(self) -> str:
        return f"Film({len(self.html) / 1000:.0f} kB of HTML)"

    def _repr_html_(self) -> str:
        """Return the page in a frame as HTML for notebooks."""
        return f'<iframe srcdoc="{escape(self.html)}" width="100%" height="620" style="border:0"></iframe>'


def _as_json(value: object) -> object:
    """Return a value for JSON: mappings, NumPy numbers as numbers, everything else as text."""
    if isinstance(value, Mapping):
        return dict(value)
    return value.item() if isinstance(value, np.generic) else str(value)


def facts_beside(table: str | Path) -> Path:
    """Return the path of the facts beside a table."""
    return Path(table).with_suffix(".json")


def facts_in(path: Path) -> dict[str, Any]:
    """Return the facts stored beside a table; empty if the file is missing, damaged or not written by alfmu."""
    form = {"mechanism": str, "options": dict, "parameters": dict}
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    known = isinstance(found, dict) and all(isinstance(found.get(key), kind) for key, kind in form.items())
    return found if known else {}


def read_inputs(path: str | Path) -> dict[str, Signal]:
    """Return inputs from a CSV file: a column `time` [s], and a column of finite numbers for each input."""
    names, table = _table(path)
    for row, column in np.argwhere(~np.isfinite(table))[:1]:
        raise InputError(f"{path}: {names[column]} is {table[row, column]} at {table[row, 0]:g} s; it must be finite")
    return {name: (table[:, 0], table[:, i]) for i, name in enumerate(names) if i}


def _table(path: str | Path) -> tuple[list[str], NDArray[np.float64]]:
    """Return names and numbers of a CSV file whose first column is time; raise InputError with the line if it is
    invalid."""
    line, numbers = 0, array("d")
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file, strict=True)
            rows = (row for row in reader if row)
            names = [name.strip() for name in next(rows, [])]
            _check_names(path, names)
            for row in rows:
                line = reader.line_num
                if len(row) != len(names):
                    raise InputError(f"{path}, line {line}: {len(row)} columns under {len(names)} names")
                numbers.extend(map(float, row))
                if not -math.inf < numbers[-len(names)] < math.inf:
                    raise InputError(f"{path}, line {line}: time is {row[0]}; it must be a finite number")
                if len(numbers) > len(names) and numbers[-len(names)] < numbers[-2 * len(names)]:
                    raise InputError(f"{path}, line {line}: time goes back to {row[0]}; sort the rows by time")
    except OSError as error:
        raise InputError(f"cannot read {path} ({error.strerror})") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a table of numbers: it is no text in UTF-8 ({error.reason})") from None
    except csv.Error as error:
        quoted = "end of data" in str(error)
        why = "a quotation mark is opened and not closed" if quoted else f"it has a {error}"
        raise InputError(f"{path} is not a table of numbers: {why}, at line {reader.line_num} or before") from None
    except ValueError:
        wrong = next(cell for cell in row if not _number(cell))
        raise InputError(f"{path} is not a table of numbers: line {line} has {wrong[:40]!r}") from None
    if not numbers:
        raise InputError(f"{path} has no rows of numbers under its names")
    return names, np.array(numbers).reshape(-1, len(names))


def _check_names(path: str | Path, names: list[str]) -> None:
    """Raise InputError if a row of names is not valid for a table."""
    if names[:1] != ["time"]:
        raise InputError(
            f"{path} is not a table of numbers under names: its first column is {(names or [''])[0][:40]!r}; it must "
            "be 'time', with commas between the columns"
        )
    if "" in names:
        raise InputError(f"{path}: column {1 + names.index('')} has no name")
    if twice := next((name for name, count in Counter(names).items() if count > 1), None):
        raise InputError(f"{path}: two columns are called {twice!r}; leave one out")


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
