"""What there is to know of a mechanism before it runs: as data, in a few lines, or all of it."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ..catalogue.registry import choices
from ..equations import Equations, Mobility, Variable
from ..equations.interface import default_settings, variables_of
from ..equations.specialisation import specialised
from ..fmi.recipe import Recipe
from ..model.doubts import evaluated, masses, no_gravity
from ..model.errors import AlfmuError
from ..model.mechanism import Mechanism
from ..model.words import quantity
from ..runtime import Instance
from ..runtime.pipeline import decision_of, prepared
from ..simulation import Result
from .cost import cost, described

__all__ = ["About", "about", "gravity", "in_all", "in_short", "notes"]

LINES = 20
"""Lines of a mechanism in short, at most."""

_WIDE = 100
"""Characters of a line in short, at most, but for what a user must know in full."""

_FEW = 3
"""Outputs of a body or joint up to which they are named and not counted."""

_TURNED = 0.1
"""Change of an angle [rad] from its guess from which on it is told; some 6 degrees."""

_MOVED = 1e-6
"""Way [m] up to which assembly has left a body where its guess has it."""

_MANY = 300
"""Lines of one kind up to which each is shown."""

_NUMBER = re.compile(r"(?<=[A-Za-z_\[])(\d+)")
"""In a name."""


@dataclass(frozen=True)
class About:
    """A mechanism with the scene that is made of it, at its start."""

    mechanism: Mechanism
    options: dict[str, list[str]]
    """The values that each option takes."""
    everything: Equations
    equations: Equations
    """Of the scene: what is left out of `everything` is not in it."""
    mobility: Mobility
    notes: list[str]
    shared: list[str]
    """Outputs that are not unique, as redundant constraints share a load."""
    inputs: Sequence[Variable]
    outputs: Sequence[Variable]

    @property
    def parameters(self) -> list[Variable]:
        """Parameters, start values and what may be chosen of the solver."""
        return variables_of(self.equations).causal("parameter")

    @property
    def coordinates(self) -> Sequence[Variable]:
        """The coordinates that are declared."""
        e = self.equations
        return () if e.resting else e.coordinates[: e.dependent]

    @property
    def method(self) -> str:
        """The method of integration, and why where it was chosen."""
        decision = decision_of(self.equations)
        return decision.reason or decision.method

    @property
    def chosen(self) -> str:
        """The method of integration, and what it stands for where it is `auto`."""
        given, stands_for = default_settings(self.equations).method, decision_of(self.equations).method
        return given if given == stands_for else f"{given} ({stands_for} here)"

    def as_data(self) -> dict[str, Any]:
        """All of it, as JSON has it."""
        m, e, size = self.mechanism, self.equations, self.mobility
        counted = cost(prepared(e))
        return {
            "name": m.name,
            "description": m.description,
            "sketch": m.sketch.strip("\n"),
            "options": {name: {"value": m.options[name], "choices": each} for name, each in self.options.items()},
            "coordinates": [{"name": c.name, "unit": c.unit} for c in self.coordinates],
            "states": [asdict(v) for v in e.states],
            "constraints": [asdict(row) for row in e.rows],
            "degrees_of_freedom": size.freedom - e.resting,
            "redundant_constraints": size.redundant,
            "motions_at_start": size.freedom_here - e.resting,
            "not_unique": self.shared,
            "gravity": evaluated(
                m, list(m.gravity_vector), {v.name: float(v.start) for v in self.everything.parameters}
            ),
            "notes": self.notes,
            **{name: [asdict(v) for v in getattr(self, name)] for name in ("parameters", "inputs", "outputs")},
            "stop_time": e.stop_time,
            "communication_step": e.interval,
            "method": self.method,
            "operations": {"step": counted.step, "careful_step": counted.careful, "outputs": counted.outputs},
        }


def about(recipe: Recipe, mechanism: Mechanism, everything: Equations) -> About:
    """What there is to know of the mechanism of a recipe, whose equations with all in them are `everything`.

    Raises AlfmuError where it has no start.
    """
    equations = specialised(everything, recipe.outputs, recipe.freeze)
    instance = Instance(replace(equations, solver={**equations.solver, "method": "rk4"}))
    instance.initialize()
    return About(
        mechanism,
        choices(mechanism),
        everything,
        equations,
        instance.mobility(),
        notes(instance),
        instance.shared(),
        instance.input_variables,
        instance.outputs,
    )


def notes(unit: Any) -> list[str]:
    """What a user should know of a start: how far bodies are from their guesses, what nobody gave a start value."""
    if not isinstance(unit, Instance):
        return []
    found, moved = [], {name: way for name, way in unit.moved.items() if way > _MOVED}
    if moved:
        name, way = next(iter(moved.items()))
        most = f", {name} most" * (len(moved) > 1)
        what = f"{len(moved)} bodies by up to {way:.3g} m" if len(moved) > 1 else f"{name} by {way:.3g} m"
        turned = [f"{each} by {quantity(way, 'rad')}" for each, way in unit.turned.items() if abs(way) > _TURNED][:1]
        found.append("; ".join([f"assembly moved {what} from where the guesses have them{most}", *turned]))
    with contextlib.suppress(AlfmuError):  # a run may have ended where freedoms cannot be told
        if forgotten := unit.forgotten():
            found.append(forgotten)
    return found


def gravity(m: Mechanism, values: Mapping[str, float], result: Result | None = None) -> str:
    """The gravity of a mechanism in a line, at values of its parameters by name: how strong and whereto, and how much
    its potential varied in a run beside all else that did work, where the result has the places of all bodies."""
    x, y, z = evaluated(m, list(m.gravity_vector), values)
    if not (x or y or z):
        return f"gravity: {no_gravity(m).partition(': ')[2] or 'none'}"
    along = {axis: size for axis, size in zip("xyz", (x, y, z), strict=True) if size}
    if len(along) == 1:
        [(axis, size)] = along.items()
        said = f"gravity: {abs(size):g} m/s2 along {'-' if size < 0 else '+'}{axis}"
        said += ", which is upwards" * (axis == "y" and size > 0 and not m.spatial_bodies)
    else:
        said = f"gravity: ({x:g}, {y:g}, {z:g}) m/s2"
    found = masses(m, values)
    if result is None:
        return f"{said}, {math.hypot(x, y, z) * sum(found.values()):.3g} N on all bodies"
    names = {f"{body}.{axis}": -mass * size for body, mass in found.items() for axis, size in along.items()}
    if not len(result.time) or not {*names, "monitor.work"} <= {*result.names}:
        return said
    potential = sum((result[name] * weight for name, weight in names.items()), np.zeros(len(result.time)))
    varied, work = (float(np.ptp(each)) for each in (potential, result["monitor.work"]))
    share = f" ({100 * varied / (varied + work):.0f} % of both)" if varied + work > 0 else ""
    return (
        f"{said}; its potential varied by {varied:.3g} J{share}, the work of drives, loads and dampers by {work:.3g} J"
    )


def in_short(a: About) -> list[str]:
    """The mechanism in LINES lines at most, notes apart: its picture where there is room."""
    e, parameters = a.equations, [v for v in a.parameters if not v.name.startswith("solver.")]
    starts = [v for v in parameters if v.name.startswith("start.")]
    own = [v for v in parameters if not v.name.startswith(("start.", *(f"{row.name}.compliance" for row in e.rows)))]
    facts = [
        *_options(a),
        _fitted(f"coordinates ({len(a.coordinates)})", [f"{c.name} [{c.unit}]" for c in a.coordinates]),
        *([_fitted(f"states ({len(e.states)})", [f"{v.name} [{v.unit}]" for v in e.states])] if e.states else []),
        _fitted(f"constraints ({e.l})", [row.text for row in e.rows]),
        _freedom(a),
        *([_fitted("not unique, as redundant constraints share a load", a.shared)] if a.shared else []),
        *_friction(a),
        *_gravity(a),
        _fitted("parameters", [f"{v.name} = {_valued(v)}" for v in own]),
        _fitted("at the start", [f"{v.name} = {_valued(v)}" for v in starts]),
        _fitted("inputs", [f"{v.name} [{v.unit}]" for v in a.inputs]),
        _fitted(f"outputs ({len(a.outputs)})", *_owned(a.outputs), "; "),
        _fitted("run", [f"{e.stop_time:g} s in steps of {e.interval:g} s", f"method {a.chosen}"]),
        "--all shows every name with unit and description, and the operations of a step; --json is for programs",
    ]
    title = f"{a.mechanism.name}: {a.mechanism.description}"
    picture = _picture(a.mechanism.sketch)
    with_picture = [[title, "", *picture, "", *facts], [title, *picture, *facts]] if picture else []
    for lines in (*with_picture, [title, "", *facts]):
        if len(lines) <= LINES:
            break
    return [*lines, *a.notes]


def _friction(a: About) -> list[str]:
    """What is said of joints whose friction follows from a load that is not unique."""
    names = [x.name for x in a.equations.frictions if x.output in a.shared]
    return [_fitted("friction is not unique, nor is the motion, unless compliances settle it", names)] if names else []


def _gravity(a: About) -> list[str]:
    """What is said of gravity where there are bodies."""
    m = a.mechanism
    values = {v.name: float(v.start) for v in a.everything.parameters}
    return [gravity(m, values)] if m.bodies or m.spatial_bodies else []


def in_all(a: About) -> list[str]:
    """All of it, in lines."""
    m, e = a.mechanism, a.equations
    known = ([m.sketch.strip()], _options(a))
    lines = [f"{m.name}: {m.description}", "", *(line for part in known if any(part) for line in (*part, ""))]
    coordinates, states = (_merged((f"{c.name} [{c.unit}]",) for c in each) for each in (a.coordinates, e.states))
    rows = _merged((r.text,) for r in e.rows)
    lines += [f"coordinates ({len(a.coordinates)}): {', '.join(text for (text,) in coordinates) or 'none'}"]
    lines += [f"states ({len(e.states)}): {', '.join(text for (text,) in states)}"] if e.states else []
    lines += [f"constraints ({e.l}): {', '.join(text for (text,) in rows) or 'none'}", _freedom(a), *a.notes]
    if a.shared:
        each = _merged((name,) for name in a.shared)
        lines += [f"not unique, as redundant constraints share a load: {', '.join(text for (text,) in each)}"]
    lines += _friction(a) + _gravity(a)
    titles = {"parameters and start values": a.parameters, "inputs": a.inputs, "outputs": a.outputs}
    for title, variables in titles.items():
        starts = ["" if title == "outputs" else _start(v) for v in variables]
        units = [f"{v.unit} {_in_degrees(v)}" if start else v.unit for v, start in zip(variables, starts, strict=True)]
        rows = _merged(
            (v.name, start, unit.strip(), v.description)
            for v, start, unit in zip(variables, starts, units, strict=True)
        )
        width = max([32, *(len(name) for name, *_ in rows)])
        lines += ["", f"{title}:"]
        lines += [f"  {name:{width}} {start:>10} {unit:12} {text}".rstrip() for name, start, unit, text in rows]
    return [*lines, "", f"method of integration: {a.method}", "", *described(a.everything, e, a.mobility)]


def _options(a: About) -> list[str]:
    return [f"option {name} = {a.mechanism.options[name]} ({' | '.join(each)})" for name, each in a.options.items()]


def _freedom(a: About) -> str:
    size, rest = a.mobility, a.equations.resting
    here = f", singular at the start: {size.freedom_here} motions possible" * (size.freedom_here > size.freedom)
    return f"degrees of freedom: {size.freedom - rest}, redundant constraints: {size.redundant}{here}"


def _start(v: Variable) -> str:
    return v.start if isinstance(v.start, str) else f"{v.start:g}"


def _in_degrees(v: Variable) -> str:
    """The start of an angle as a person reads it."""
    return f"({math.degrees(v.start):.4g} deg)" if v.unit == "rad" and isinstance(v.start, float) and v.start else ""


def _valued(v: Variable) -> str:
    """Its start with its unit, an angle in degrees, too."""
    return v.start if isinstance(v.start, str) else quantity(v.start, v.unit, 6)


def _fitted(title: str, texts: Sequence[str], counts: Sequence[int] = (), between: str = ", ") -> str:
    """A line of texts, as many as there is room for, and how many more there are, each as many as its count or one."""
    shown, line = 0, f"{title}: "
    for k, text in enumerate(texts):
        added = f"{between if k else ''}{text}"
        if k and len(line) + len(added) > _WIDE - len(" and 999 more") * (k < len(texts) - 1):
            break
        line, shown = line + added, k + 1
    left = sum(counts[shown:]) or len(texts) - shown
    return line + (f" and {left} more" if left else "" if texts else "none")


def _owned(variables: Sequence[Variable]) -> tuple[list[str], list[int]]:
    """Outputs by what they belong to: those that have the same ones together, a few by name and many by number.

    Beside each text the number of outputs that it stands for.
    """
    parts: dict[str, list[str]] = {}
    for v in variables:
        owner, _, rest = v.name.replace("[", ".[").partition(".")
        parts.setdefault(owner, []).append(rest)
    alike: dict[tuple[str, ...], list[str]] = {}
    for owner, rests in parts.items():
        alike.setdefault(tuple(rests), []).append(owner)
    texts = []
    for names, owners in alike.items():
        alone = not any(names)
        by_name = len(names) <= _FEW and not names[0].startswith("[")
        known = ", ".join(names) if by_name else f"{len(names)}{' each' * (len(owners) > 1)}"
        texts.append(", ".join(_ranges(owners)) + f" ({known})" * (not alone))
    return texts, [len(names) * len(owners) for names, owners in alike.items()]


def _ranges(names: Sequence[str]) -> list[str]:
    """Names, a few; of those that differ in numbers alone, one for all."""
    if len(names) <= _FEW:
        return list(names)
    alike: dict[str, list[str]] = {}
    for name in names:
        alike.setdefault(_NUMBER.sub("0", name), []).append(name)
    return [_range(group) for group in alike.values()]


def _picture(sketch: str) -> list[str]:
    """The drawing in a sketch: the first lines together that begin with blanks."""
    lines: list[str] = []
    for line in sketch.strip("\n").splitlines():
        if line.startswith(" ") or (lines and not line.strip()):
            lines.append(line)
        elif lines:
            break
        if lines and not line.strip():
            break
    return [line for line in lines if line.strip()]


def _merged(lines: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Lines in columns; of many, one for all that differ in numbers of names alone, as `link{1..200}.x`."""
    lines = list(lines)
    if len(lines) <= _MANY:
        return lines
    alike: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for line in lines:
        alike.setdefault(tuple(_NUMBER.sub("0", column) for column in line), []).append(line)
    return [tuple(_range(texts) for texts in zip(*group, strict=True)) for group in alike.values()]


def _range(texts: Sequence[str]) -> str:
    """Texts that differ in numbers of names alone as one."""
    whole = ""
    for pieces in zip(*(_NUMBER.split(text) for text in texts), strict=True):
        same = len(set(pieces)) == 1
        whole += pieces[0] if same else f"{{{min(map(int, pieces))}..{max(map(int, pieces))}}}"
    return whole
