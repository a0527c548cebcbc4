"""A declaration and its Python text from the same calls: `alfmu import` writes the code of the loaded mechanism."""

from __future__ import annotations

import keyword
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from ..model.mechanism import Mechanism

_WIDTH = 116
"""Longest line in characters."""

_OWN = {"m", "ca", "Mechanism", "ground"}


@dataclass(frozen=True, eq=False)
class Named:
    """A value with its Python expression."""

    value: Any
    text: str
    plain: bool = True
    """Whether the expression needs no brackets."""

    def at(self, point: Sequence[float]) -> Named:
        """Return a point of a body."""
        given = ", ".join(map(written, point)) if any(point) else ""
        return Named(self.value.at(*map(float, point)), f"{self.text}.at({given})")

    def freedom(self, which: str) -> Named:
        """Return one of a joint's free motions."""
        return Named(self.value.freedom(which), f'{self.text}.freedom("{which}")')

    def __add__(self, other: Named | float) -> Named:
        return Named(self.value + value_of(other), f"{self.text} + {written(other)}", False)

    def __radd__(self, other: float) -> Named:
        return Named(other + self.value, f"{written(other)} + {self.text}", False)

    def __sub__(self, other: Named | float) -> Named:
        return Named(self.value - value_of(other), f"{self.text} - {_bracketed(other)}", False)

    def __rmul__(self, factor: float) -> Named:
        return Named(factor * self.value, f"{written(factor)} * {_bracketed(self)}", True)

    def __rtruediv__(self, factor: float) -> Named:
        return Named(factor / self.value, f"{written(factor)} / {_bracketed(self)}", False)

    def __gt__(self, other: float) -> Named:
        return Named(self.value > other, f"{_bracketed(self)} > {written(other)}", False)

    def __lt__(self, other: float) -> Named:
        return Named(self.value < other, f"{_bracketed(self)} < {written(other)}", False)

    def __mul__(self, other: Named) -> Named:
        return Named(self.value * other.value, f"{_bracketed(self)} * {_bracketed(other)}", True)

    def __neg__(self) -> Named:
        return Named(-self.value, f"-{_bracketed(self)}", False)

    def __getitem__(self, i: int) -> Named:
        return Named(self.value[i], f"{_bracketed(self)}[{i}]")

    def __pow__(self, power: int) -> Named:
        return Named(self.value**power, f"{_bracketed(self)}**{power}", True)

    @property
    def place(self) -> Named:
        """Return the position (3,) of a point in ground axes."""
        return Named(self.value.place, f"{self.text}.place")

    def turned(self, vector: Sequence[float]) -> Named:
        """Return a vector (3,) of a body's frame in ground axes."""
        given = [float(x) for x in vector]
        return Named(self.value.rotation @ ca.DM(given), f"{self.text}.rotation @ ca.DM({written(given)})", False)

    def seen(self, vector: Named) -> Named:
        """Return a vector (3,) of ground axes in a body's frame."""
        return Named(self.value.rotation.T @ vector.value, f"{self.text}.rotation.T @ {_bracketed(vector)}", False)

    def limited(self, low: float, high: float) -> Named:
        """Return the value limited to an interval."""
        return called("fmin", called("fmax", self, low), high)


def called(function: str, *arguments: Any) -> Named:
    """Return the value of one of CasADi's functions."""
    value = getattr(ca, function)(*map(value_of, arguments))
    return Named(value, f"ca.{function}({', '.join(map(written, arguments))})")


def value_of(thing: Any) -> Any:
    """Return the value of a `Named`, or things themselves, recursively."""
    if isinstance(thing, Named):
        return thing.value
    if isinstance(thing, tuple | list):
        return type(thing)(map(value_of, thing))
    return thing


def written(thing: Any) -> str:
    """Return the Python expression of a value; integers have no decimal point."""
    if isinstance(thing, Named):
        return thing.text
    if isinstance(thing, str):
        return '"' + repr("'" + thing)[2:-1].replace('"', '\\"').replace("\\'", "'") + '"'
    if isinstance(thing, tuple | list):
        inner = ", ".join(map(written, thing))
        return f"[{inner}]" if isinstance(thing, list) else f"({inner}{',' * (len(thing) == 1)})"
    if isinstance(thing, float) and thing.is_integer() and abs(thing) < 1e15:
        return str(int(thing))
    return repr(thing)


def _bracketed(thing: Any) -> str:
    text = written(thing)
    return text if not isinstance(thing, Named) or thing.plain else f"({text})"


def _folded(text: str) -> str:
    """Break a bracketed expression over several lines if it is long, at spaces outside strings."""
    lines = [""]
    for word in re.findall(r'(?:"(?:\\.|[^"\\])*"|[^\s"])+', text):
        if lines[-1] and len(lines[-1]) + len(word) > _WIDTH - 12:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return "\n        ".join(lines)


class Script:
    """Declares a mechanism by calls and records them."""

    def __init__(self, name: str, description: str):
        self.mechanism = Mechanism(name, description)
        self.mechanism._dropped = True
        self._lines: list[str] = []
        self.ground = Named(self.mechanism.spatial_ground, "m.spatial_ground")

    def do(self, method: str, *arguments: Any, keep: str = "", **named: Any) -> Named:
        """Call a method of the mechanism; `keep` names the variable for its result."""
        made = getattr(self.mechanism, method)(
            *map(value_of, arguments), **{name: value_of(x) for name, x in named.items()}
        )
        given = [*map(written, arguments), *(f"{name}={written(x)}" for name, x in named.items())]
        variable = keep + "_" * (keyword.iskeyword(keep) or keep in _OWN)
        begin = f"{variable + ' = ' if keep else ''}m.{method}("
        line = f"{begin}{', '.join(given)})"
        if len(line) > _WIDTH:
            line = begin + "".join(f"\n    {_folded(each)}," for each in given) + "\n)"
        self._lines.append(line)
        return Named(made, variable)

    def rate(self, coordinate: Named) -> Named:
        """Return the rate of a coordinate."""
        return Named(self.mechanism.rate(coordinate.value), f"m.rate({coordinate.text})")

    def let(self, name: str, value: Named) -> Named:
        """Give an expression a name."""
        line = f"{name} = {value.text}"
        self._lines.append(line if len(line) <= _WIDTH else f"{name} = (\n    {_folded(value.text)}\n)")
        return Named(value.value, name)

    def remark(self, text: str) -> None:
        """Add an empty line and a comment."""
        self._lines += ["", f"# {text}"]

    def text(self, function: str, docstring: str) -> str:
        """Return a Python file with one function."""
        body = "\n".join(self._lines)
        head = [f'"""{docstring}"""', ""]
        if re.search(r"\bca\.\w+\(", body):
            head += ["import casadi as ca", ""]
        name, description = written(self.mechanism.name), written(self.mechanism.description)
        head += ["from alfmu import Mechanism", "", "", f"def {function}() -> Mechanism:"]
        made = f"    m = Mechanism({name}, {description})"
        head += [made if len(made) <= _WIDTH else f"    m = Mechanism(\n        {name},\n        {description},\n    )"]
        lines = [f"    {line}" if line else "" for line in body.split("\n")]
        return "\n".join([*head, *lines, "    return m", ""])
