"""Information on a mechanism before it runs: as data, in a few lines, or complete."""

import contextlib
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
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
from ..runtime.pipeline import decision_of, prepared, with_defaults
from ..simulation import Result
from .cost import cost, described

LINES = 20
"""Largest number of lines of the short description."""

_WIDE = 100
"""Largest width of its lines in characters, except for text that must not be cut."""

_FEW = 3
"""Number of outputs of a body or joint up to which names are listed instead of the number."""

_TURNED = 0.1
"""Change of an angle [rad] from its guess above which it is reported; some 6 degrees."""

_MOVED = 1e-6
"""Distance [m] from its guess below which a body counts as unmoved by assembly."""

_MANY = 300
"""Number of lines of one kind up to which each is shown."""

_NUMBER = re.compile(r"(?<=[A-Za-z_\[])(\d+)")
"""Matches a number in a name."""


@dataclass(frozen=True)
class About:
    """A mechanism with its scene, at its start."""

    mechanism: Mechanism
    options: dict[str, list[str]]
    """Values of each option."""
    everything: Equations
    equations: Equations
    """Equations of the scene: parts of `everything` may be left out."""
    mobility: Mobility
    notes: list[str]
    shared: list[str]
    """Outputs that are not unique, as redundant constraints share a load."""
    inputs: Sequence[Variable]
    outputs: Sequence[Variable]

    @property
    def parameters(self) -> list[Variable]:
        """Parameters, start values and solver variables that are text."""
        return variables_of(self.equations).causal("parameter")

    @property
    def coordinates(self) -> Sequence[Variable]:
        """The declared coordinates."""
        e = self.equations
        return () if e.resting else e.coordinates[: e.dependent]

    @property
    def method(self) -> str:
        """The integrator, with the reason if it was chosen automatically."""
        decision = decision_of(self.equations)
        return decision.reason or decision.method

    @property
    def chosen(self) -> str:
        """The integrator, with the one that `auto` stands for."""
        given, stands_for = default_settings(self.equations).method, decision_of(self.equations).method
        return given if given == stands_for else f"{given} ({stands_for} here)"

    def as_data(self) -> dict[str, Any]:
        """Return the information as data for JSON."""
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
    """Return the information on the mechanism of a recipe; `everything` are its complete equations.

    Raises AlfmuError if it has no start.
    """
    equations = specialised(everything, recipe.outputs, recipe.freeze)
    instance = Instance(with_defaults(equations, {"solver.method": "rk4"}))
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
    """Return remarks on a start: bodies far from their guesses, coordinates without a start value."""
    if not isinstance(unit, Instance):
        return []
    found, moved = [], {name: way for name, way in unit.moved.items() if way > _MOVED}
    if moved:
        name, way = next(iter(moved.items()))
        most = f", {name} most" * (len(moved) > 1)
        what = f"{len(moved)} bodies by up to {way:.3g} m" if len(moved) > 1 else f"{name} by {way:.3g} m"
        turned = [f"{each} by {quantity(way, 'rad')}" for each, way in unit.turned.items() if abs(way) > _TURNED][:1]
        found.append("; ".join([f"assembly moved {what} from their guesses{most}", *turned]))
    with contextlib.suppress(AlfmuError):  # freedoms may be undefined where a run has ended
        if forgotten := unit.forgotten():
            found.append(forgotten)
    return found


def gravity(m: Mechanism, values: Mapping[str, float], result: Result | None = None) -> str:
    """Return a line on the gravity of a mechanism at parameters by name: its magnitude and direction.

    If the result has the positions of all bodies, the line also compares the change of its potential with the other
    work.
    """
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
    """Return the mechanism in at most LINES lines without notes, with its sketch if it fits."""
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
    """Return remarks on joints whose friction follows from a load that is not unique."""
    names = [x.name for x in a.equations.frictions if x.output in a.shared]
    return [_fitted("friction is not unique, nor is the motion, unless compliances settle it", names)] if names else []


def _gravity(a: About) -> list[str]:
    """Return the remark on gravity if there are bodies."""
    m = a.mechanism
    values = {v.name: float(v.start) for v in a.everything.parameters}
    return [gravity(m, values)] if m.bodies or m.spatial_bodies else []


def in_all(a: About) -> list[str]:
    """Return the complete information as lines of text."""
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
    """Format the start of an angle in degrees."""
    return f"({math.degrees(v.start):.4g} deg)" if v.unit == "rad" and isinstance(v.start, float) and v.start else ""


def _valued(v: Variable) -> str:
    """Format a start with its unit, an angle also in degrees."""
    return v.start if isinstance(v.start, str) else quantity(v.start, v.unit, 6)


def _fitted(title: str, texts: Sequence[str], counts: Sequence[int] = (), between: str = ", ") -> str:
    """Return a line with as many texts as fit, and the number of the others, each counted once or by `counts`."""
    shown, line = 0, f"{title}: "
    for k, text in enumerate(texts):
        added = f"{between if k else ''}{text}"
        if k and len(line) + len(added) > _WIDE - len(" and 999 more") * (k < len(texts) - 1):
            break
        line, shown = line + added, k + 1
    left = sum(counts[shown:]) or len(texts) - shown
    return line + (f" and {left} more" if left else "" if texts else "none")


def _owned(variables: Sequence[Variable]) -> tuple[list[str], list[int]]:
    """Return outputs by owner, owners with the same outputs together, a few by name and many by number.

    The second list has the number of outputs that each text stands for.
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
    """Return a few names, with those that differ in numbers alone merged."""
    if len(names) <= _FEW:
        return list(names)
    alike: dict[str, list[str]] = {}
    for name in names:
        alike.setdefault(_NUMBER.sub("0", name), []).append(name)
    return [_range(group) for group in alike.values()]


def _picture(sketch: str) -> list[str]:
    """Return the drawing in a sketch: its first indented block."""
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
    """Merge lines in columns that differ in numbers of names alone, if there are many, as `link{1..200}.x`."""
    lines = list(lines)
    if len(lines) <= _MANY:
        return lines
    alike: dict[tuple[str, ...], list[tuple[str, ...]]] = {}
    for line in lines:
        alike.setdefault(tuple(_NUMBER.sub("0", column) for column in line), []).append(line)
    return [tuple(_range(texts) for texts in zip(*group, strict=True)) for group in alike.values()]


def _range(texts: Sequence[str]) -> str:
    """Merge texts that differ in numbers of names alone."""
    whole = ""
    for pieces in zip(*(_NUMBER.split(text) for text in texts), strict=True):
        same = len(set(pieces)) == 1
        whole += pieces[0] if same else f"{{{min(map(int, pieces))}..{max(map(int, pieces))}}}"
    return whole
