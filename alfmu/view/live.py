"""A live page: a mechanism that runs in a browser, as one file that needs nothing else.

The page holds the runtime as WebAssembly and the scene of the mechanism's FMU, so its numbers are those of the FMU. Its
files stand in the folder `page`: `engine.js` and `worker.js` drive the runtime, `picture.js` draws with the painter of
films (`shared/strokes.js`), `page.js` has controls, clock and plots; plots are made by uPlot, a library in `vendor`.
What they must know of the mechanism is put together here.
"""

from __future__ import annotations

import base64
import gzip
import importlib.metadata
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..equations import Equations, Variable
from ..equations.interface import state_starts, variables_of
from ..kernel.stream import BINARY, UNARY
from ..kernel.tables import packed
from ..model.doubts import tell_of_gravity
from ..model.errors import AlfmuError, InputError
from ..model.files import write
from ..model.mechanism import Mechanism
from ..model.parts import Marker
from ..runtime import Instance
from ..runtime.build import WEB
from ..runtime.prepare import prepared
from ..runtime.shipped import library
from ..simulation import communication_points
from ..simulation.result import Result
from .pages import filled, text_of
from .picture import Shapes, geometry, view_of
from .shapes import by_law, ends_of
from .surface import FONTS

__all__ = ["live", "needed", "written_by_alfmu"]

_MARK = '<meta name="generator" content="alfmu'
"""By which a page is known."""

LOOK = 2000, 20_000
"""Communication steps, and steps of `solver.step_size`, of the run before the page at most: a second or two. What the
picture must fit follows from it, the same for the same mechanism."""

CURVES = 8
"""In one plot, at most."""


def live(
    mechanism: Mechanism,
    equations: Equations,
    path: str | Path,
    *,
    parameters: Mapping[str, float | str] | None = None,
    source: str = "",
) -> None:
    """Write the page of a mechanism.

    `equations` are those of the mechanism with the defaults that the page begins with, `parameters` what of them is not
    the mechanism's own, `source` what stands for them behind `alfmu simulate`. Raises AlfmuError where the mechanism
    cannot start, or where there is no runtime for browsers.
    """
    e = prepared(equations, "vm")
    unit = Instance(e)
    tell_of_gravity(mechanism)
    wasm = library(WEB, e.name)
    looked, scale = _look(unit, e)
    shapes = _shapes(mechanism, e, parameters or {}, looked)
    about, functions = _about(mechanism, e, shapes, looked, scale)
    about["command"] = f"alfmu simulate {source or e.name} --step {e.interval:g}"
    write(path, _page(mechanism, about, functions, wasm, packed(e)).encode())


def needed(mechanism: Mechanism) -> list[str]:
    """Names of the outputs that the picture and the readings of a page take."""
    shapes = geometry(mechanism)
    bodies = {body.name for body in mechanism.spatial_bodies}
    space = [f"{name}.{q}" for name in bodies for q in ("x", "y", "z", "e0", "e1", "e2", "e3")]
    own = {output.name for output in mechanism.outputs}
    space += [name for joint in mechanism.drawn_joints for name in joint.outputs]
    return sorted({*shapes.columns, *space, *(f"{dot}.z" for dot in shapes.dots if f"{dot}.z" in own), "monitor.*"})


def written_by_alfmu(path: Path) -> bool:
    """Whether a file is such a page, which the next one may replace."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return _MARK in file.read(1000)
    except OSError:
        return False


# The page ---------------------------------------------------------------------------------------------------------


def _page(mechanism: Mechanism, about: dict[str, Any], functions: str, wasm: bytes, scene: bytes) -> str:
    """The text of a page; the same arguments give the same."""
    name = escape(mechanism.name.replace("_", " "))
    hint = "Nothing of this mechanism can be drawn: plots show its motion."
    if picture := about["picture"]:
        hint = "Drag a body to place it" if picture["kind"] == "plane" and about["tied"] else ""
        hint = "Drag to turn, scroll or pinch to zoom" if picture["kind"] == "space" else hint
    scripts = text_of("page/picture.js") + text_of("page/page.js")
    values = {
        "title": name,
        "description": escape(mechanism.description),
        "version": escape(importlib.metadata.version("alfmu")),
        "interval": f"{about['interval']:g}",
        "hint": hint,
        "styles": text_of("vendor/uPlot.min.css") + text_of("page/page.css"),
        "licence": escape(text_of("vendor/uPlot.LICENSE")),
        "about": json.dumps(about, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "wasm": _packed(wasm),
        "scene": _packed(scene),
        "worker": text_of("page/engine.js") + text_of("page/worker.js"),
        "plots": text_of("vendor/uPlot.min.js"),
        "functions": functions,
        "script": filled(text_of("shared/strokes.js"), {"fonts": FONTS}) + scripts,
    }
    return filled(text_of("page/page.html"), values)


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode("ascii")


def _about(
    mechanism: Mechanism, e: Equations, shapes: _Drawn | None, looked: Result, scale: tuple[float, float]
) -> tuple[dict[str, Any], str]:
    """What the page knows of a scene, and its functions in JavaScript."""
    found = variables_of(e)
    kinds = {
        **dict.fromkeys((v.name for v in e.parameters), "parameter"),
        **dict.fromkeys((v.name for v in e.starts), "start"),
        **dict.fromkeys((v.name for v in e.start_rates), "rate"),
        **dict.fromkeys((v.name for v in state_starts(e)), "start"),
        **dict.fromkeys((v.name for v in e.compliances), "compliance"),
        **dict.fromkeys((v.name for v in found.inputs), "input"),
        **dict.fromkeys((v.name for v in found.switches), "switch"),
        **dict.fromkeys((v.name for v in found.outputs), "output"),
    }
    # In the order of the references that the runtime has.
    every = [*found.parameters, *found.choices, *found.inputs, *found.switches, *found.outputs]
    variables = []
    for v in every:
        choice = v.type == "String"
        kind = "choice" if choice else kinds.get(v.name, "solver")
        variables.append(
            {
                "name": v.name,
                "unit": v.unit,
                "kind": kind,
                "type": v.type,
                "start": 0.0 if choice else float(v.start),
                "minimum": v.minimum,
                "maximum": v.maximum,
                "description": v.description,
                "range": range_of(v, kind, scale),
            }
        )
    references = {v.name: i for i, v in enumerate(every)}
    shown = [references[v.name] for v in (*found.outputs, *found.inputs, *found.switches)]
    tied = list(dict.fromkeys(e.tied))
    groups, panels = _groups(e, [every[i] for i in shown])
    about: dict[str, Any] = {
        "name": e.name,
        "n": e.n,
        "interval": e.interval,
        "stop_time": e.stop_time,
        "variables": variables,
        "shown": shown,
        "tied": [{"value": references[e.starts[i].name], "rate": references[e.start_rates[i].name]} for i in tied],
        "groups": groups,
        "panels": panels,
        "picture": None,
    }
    functions = _ties(e, tied)
    about["tie_parameters"] = [{"ref": references[v.name]} for v in e.parameters]
    if shapes:
        columns = {every[reference].name: column for column, reference in enumerate(shown)}
        about["picture"] = shapes.data(columns)
        about["picture"]["parameters"] = [
            {"ref": references[name]} if name in references else {"value": value}
            for name, value in shapes.parameters.items()
        ]
        functions += shapes.function
    else:
        functions += "const geometry = () => [];\n"
    return about, functions


def range_of(v: Variable, kind: str, scale: tuple[float, float]) -> list[float] | None:
    """The range of a slider: the declared bounds; where there is none, what a motion can tell apart.

    `scale` is the largest kinetic energy [J] of the run that the picture fits, and the size of the mechanism [m]: an
    effort goes up to twice that energy on its way. None where a number is enough.
    """
    if kind not in ("parameter", "start", "rate", "input") or v.type != "Real":
        return None
    energy, size = scale
    efforts = {"N.m": 2 * energy, "N": 2 * energy / size}
    value = abs(float(v.start))
    if kind == "input":
        high = max(efforts.get(v.unit, 1.0), 2 * value)
    elif v.unit == "rad" and value <= math.pi:
        high = math.pi
    elif kind == "rate" and value == 0:
        high = 5.0
    else:
        high = 3 * value or (20.0 if v.unit == "m/s2" else size if v.unit == "m" else 1.0)
    high = high if high == math.pi else _nice(high)
    low = -high if v.minimum is None else v.minimum
    high = high if v.maximum is None else v.maximum
    return [low, high] if high > low else None


def _nice(wanted: float) -> float:
    """1, 2, 3 or 5 times a power of ten, not below what is wanted."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(f"{next(m * power for m in (1, 2, 3, 5, 10) if m * power >= wanted * (1 - 1e-9)):.3g}")


def _groups(e: Equations, shown: Sequence[Variable]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """What plots can show, and which of it each of them shows at first."""
    inputs = {v.name for v in (*e.inputs, *e.switches)}
    alike: dict[tuple[str, str], list[Variable]] = {}
    for v in shown:
        if not v.name.startswith("monitor."):
            of = "inputs" if v.name in inputs else v.name.partition(".")[2] or v.name.partition("[")[0]
            alike.setdefault((of, v.unit), []).append(v)
    groups = []
    for (of, unit), members in alike.items():
        for i in range(0, len(members), CURVES):
            some = members[i : i + CURVES]
            several = f", {some[0].name} to {some[-1].name}" if len(members) > CURVES else ""
            title = (some[0].name if len(members) == 1 else of.replace("_", " ")) + several
            groups.append(_group(title, unit, [v.name for v in some], [_short(v.name, of) for v in some]))
    own = range(len(groups))

    def first(*wanted: tuple[str, str]) -> int:
        known = {
            (of, unit): next(i for i in own if groups[i]["names"][0] == m[0].name) for (of, unit), m in alike.items()
        }
        return next((known[each] for each in wanted if each in known), 0)

    places = [("angle", "rad"), ("position", "m"), ("x", "m")]
    speeds = [("angular_velocity", "rad/s"), ("velocity", "m/s"), ("vx", "m/s"), ("y", "m")]
    panels = [{"groups": [*own], "chosen": first(*wanted)} for wanted in (places, speeds)] if groups else []
    names = {v.name for v in shown}
    for title, unit, log, wanted in (
        ("Energy and work", "J", False, ("monitor.energy", "monitor.work")),
        ("Constraint error", "", True, ("monitor.position_error", "monitor.velocity_error")),
    ):
        if there := [name for name in wanted if name in names]:
            groups.append(_group(title, unit, there, [_short(name, "") for name in there], log))
            panels.append({"groups": [len(groups) - 1], "chosen": 0})
    return groups, panels


def _group(title: str, unit: str, names: list[str], labels: list[str], log: bool = False) -> dict[str, Any]:
    unit = f" [{unit}]" if unit and unit != "1" else ""
    return {"title": title[:1].upper() + title[1:] + unit, "names": names, "labels": labels, "log": log}


def _short(name: str, of: str) -> str:
    """A name in a legend whose title says the rest."""
    return (name.removesuffix(f".{of}") if of and of != "inputs" else name).removeprefix("monitor.").replace("_", " ")


# A run before the page ----------------------------------------------------------------------------------------------


def _look(unit: Instance, e: Equations) -> tuple[Result, tuple[float, float]]:
    """The beginning of a run; its largest kinetic energy [J] and the way of what moves [m].

    Raises AlfmuError where the mechanism cannot start.
    """
    most = min(LOOK[0] * e.interval, LOOK[1] * float(e.solver.get("step_size", e.step_size)), e.stop_time)
    times = communication_points(e.name, max(most, e.interval), e.interval, len(unit.outputs))
    names = [v.name for v in unit.outputs]
    values, why = unit.run(times, [], np.zeros((len(times), 0)), names)
    if not len(values) and why is not None:
        raise why
    values = values[np.isfinite(values[:, [v.unit == "m" for v in unit.outputs]]).all(axis=1)]
    result = Result(e.name, times[: len(values)], names, {}, values)
    ways = [np.ptp(result[v.name]) for v in unit.outputs if v.unit == "m" and not v.name.startswith("monitor.")]
    size = max([float(way) for way in ways if len(values)], default=0.0)
    energy = unit.energy_scale
    return result, (energy if energy > 1e-9 else 1.0, size if size > 1e-9 else 1.0)


# The picture ----------------------------------------------------------------------------------------------------------


class _Drawn:
    """Shapes whose numbers follow the parameters: each is a place in what the function `geometry` of the page gives.

    What is drawn is found at parameters that are all a little off, so that no two points are taken as one because their
    lengths happen to be equal.
    """

    def __init__(self, mechanism: Mechanism, values: Mapping[str, float]):
        self.mechanism, self.parameters = mechanism, dict(values)
        self._symbols = ca.vertcat(*(p.symbol for p in mechanism.parameters))
        self._expressions: list[ca.SX] = []
        self._known: dict[str, int] = {}
        self.form: dict[str, Any] = {}

    def number(self, expression: Any) -> int:
        """The place of an expression among the numbers."""
        expression = ca.SX(expression)
        key = str(expression)
        if key not in self._known:
            self._known[key] = len(self._expressions)
            self._expressions.append(expression)
        return self._known[key]

    def values(self, expressions: Sequence[ca.SX], at: Mapping[str, float]) -> NDArray[np.float64]:
        f = ca.Function("f", [self._symbols], [ca.vertcat(*expressions)])
        return np.array(f(ca.DM([at[p.name] for p in self.mechanism.parameters]))).ravel()

    @property
    def function(self) -> str:
        """The page's function from parameters to numbers."""
        return javascript("geometry", ["p"], [self._symbols], self._expressions)

    def data(self, columns: Mapping[str, int]) -> dict[str, Any]:
        """What the page draws, with the columns of the outputs that move it."""
        form = dict(self.form)
        form.setdefault("bars", [])
        for kind in ("links", "dots", "bodies", "pins"):
            form[kind] = [
                {**each, "columns": [columns[name] for name in each["columns"]]} for each in form.get(kind, ())
            ]
        return form


def _shapes(m: Mechanism, e: Equations, parameters: Mapping[str, float | str], looked: Result) -> _Drawn | None:
    """What the page draws; None where there is nothing, or where it follows more than parameters."""
    values = {p.name: float(parameters.get(p.name, p.default)) for p in m.parameters}
    drawn = _Drawn(m, values)
    outputs = set(looked.names)
    try:
        if m.spatial_bodies or m.drawn_joints or any(f"{dot}.z" in outputs for dot in geometry(m, parameters).dots):
            found = _in_space(drawn, geometry(m, parameters), looked)
        else:
            found = _in_the_plane(drawn, e, looked)
    except AlfmuError:
        return None
    return found


def _in_the_plane(drawn: _Drawn, e: Equations, looked: Result) -> _Drawn | None:
    m, usual = drawn.mechanism, drawn.parameters
    shapes = geometry(m, _generic(m, usual))
    if not shapes.columns:
        return None
    points, guides = _candidates(m), {joint.name: joint for joint in m.joints}
    at = {body: drawn.values([x for pair in pairs for x in pair], _generic(m, usual)) for body, pairs in points.items()}

    def place(body: str, x: float, y: float) -> dict[str, Any]:
        there = at[body].reshape(-1, 2)
        nearest = int(np.argmin(np.hypot(there[:, 0] - x, there[:, 1] - y)))
        return {"body": body, "x": drawn.number(points[body][nearest][0]), "y": drawn.number(points[body][nearest][1])}

    def guide(g: Any) -> dict[str, Any]:
        joint = guides[g.name]
        block = None if g.block is None else drawn.number(joint.axis - joint.angle)
        return {
            "name": g.name,
            "base": place(g.base.body, g.base.x, g.base.y),
            "axis": drawn.number(joint.axis),
            "rider": place(g.rider.body, g.rider.x, g.rider.y),
            "block": block,
        }

    view = view_of(geometry(m, usual), {name: looked[name] for name in shapes.columns})
    drawn.form = {
        "kind": "plane",
        "links": [
            {
                "name": link.name,
                "kind": link.kind,
                "points": [[place(link.name, *p)[k] for k in "xy"] for p in link.points],
                "columns": [f"{link.name}.{q}" for q in ("x", "y", "angle")],
            }
            for link in shapes.links
        ],
        "joints": [_pair(each, place) | {"name": each.name, "kind": each.kind} for each in shapes.joints],
        "guides": [guide(g) for g in shapes.guides],
        "ties": [_pair(tie, place) | {"name": tie.name, "kind": tie.kind} for tie in shapes.ties],
        "dots": [{"name": dot, "columns": [f"{dot}.{q}" for q in "xy"]} for dot in shapes.dots],
        "rims": [
            {
                "body": rim.body.name,
                "filled": rim.filled,
                "points": [
                    [drawn.number(ca.SX(a) - ca.SX(c)) for a, c in zip(point, rim.body.center, strict=True)]
                    for point in rim.points
                ],
            }
            for relation in m.relations()
            for rim in relation.rims()
        ],
        "low": view.low,
        "high": view.high,
        "travel": view.travel,
    }
    return drawn


def _pair(of: Any, place: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    return {end: place(*asdict(getattr(of, end)).values()) for end in ("first", "second")}


def _generic(m: Mechanism, usual: Mapping[str, float]) -> dict[str, float]:
    """Parameters that are all a little off their values, each by another share, and within their bounds."""
    found = {}
    for i, p in enumerate(m.parameters, 1):
        value, share = usual[p.name], 1e-3 * (0.5 + (i * 0.6180339887498949) % 1.0)
        off = value + share * (abs(value) or 1.0)
        found[p.name] = off if p.maximum is None or off <= p.maximum else value - share * (abs(value) or 1.0)
    return found


def _candidates(m: Mechanism) -> dict[str, list[tuple[ca.SX, ca.SX]]]:
    """Points that are drawn on each body, from its centre of mass, as expressions in parameters."""
    found: dict[str, list[tuple[ca.SX, ca.SX]]] = {body.name: [(ca.SX(0), ca.SX(0))] for body in (m.ground, *m.bodies)}

    def add(marker: Marker, dx: Any = 0.0, dy: Any = 0.0) -> None:
        if by_law(m, marker.x, marker.y, dx, dy):
            return
        x, y = (ca.SX(a) - ca.SX(c) for a, c in zip((marker.x, marker.y), marker.body.center, strict=True))
        found[marker.body.name].append((x + dx, y + dy))

    for joint in m.joints:
        add(joint.first)
        add(joint.second)
        if joint.kind in ("prismatic", "point_on_line"):
            axis, offset = ca.SX(joint.axis), ca.SX(joint.offset)
            add(joint.first, -offset * ca.sin(axis), offset * ca.cos(axis))
    for spring in m.springs:
        for end in spring.between if isinstance(spring.between, tuple) else ():
            if isinstance(end, Marker):
                add(end)
    for point in m.watched:
        if isinstance(point.marker, Marker):
            add(point.marker)
    for body in m.bodies:
        if body.length is not None:
            add(body.start)
            add(body.end)
    return found


def _in_space(drawn: _Drawn, shapes: Shapes, looked: Result) -> _Drawn:
    m = drawn.mechanism
    points: dict[str, list[list[int]]] = {body.name: [] for body in m.spatial_bodies}

    def place(marker: Any) -> dict[str, Any]:
        own = zip((marker.x, marker.y, marker.z), marker.body.center, strict=True)
        point = [drawn.number(ca.SX(a) - ca.SX(c)) for a, c in own]
        if marker.body.name in points and point not in points[marker.body.name]:
            points[marker.body.name].append(point)
        return {"body": marker.body.name, "point": point}

    joints, ties = [], []
    for joint in m.spatial_joints:
        if (ends := ends_of(m, joint)) is None:
            continue
        first, second = map(place, ends)
        turns = joint.kind not in ("spherical", "weld")
        axis = ca.vertcat(*joint.axes[second["body"] == joint.second.body.name])
        unit = [drawn.number(x) for x in ca.vertsplit(axis / ca.norm_2(axis))]
        if joint.kind == "distance":
            ties.append({"kind": "rod", "first": first, "second": second})
        elif joint.kind != "prismatic":
            joints.append({"name": joint.name, "kind": joint.kind, **second, "axis": unit if turns else None})
    for spring in m.springs:
        between = spring.between
        if isinstance(between, tuple) and not isinstance(between[0], Marker):
            strengths = {"spring": spring.stiffness, "damper": spring.damping}
            kind = "-".join(name for name, strength in strengths.items() if not ca.SX(strength).is_zero())
            if kind and not by_law(m, *between[0].point, *between[1].point):
                ties.append({"kind": kind, "first": place(between[0]), "second": place(between[1])})
    pins, bars = _pins(drawn)
    named = {*points, *(each["name"] for each in (*pins, *bars))}
    names = set(looked.names)
    dots = [dot for dot in shapes.dots if dot not in named and f"{dot}.z" in names]
    moving = [*points, *dots, *(pin["name"] for pin in pins if pin["columns"])]
    places = np.stack([[looked[f"{name}.{q}"] for q in "xyz"] for name in moving])
    gravity = [abs(x) for x in drawn.values([ca.SX(x) for x in m.gravity_vector], drawn.parameters)]
    up = int(np.argmax(gravity)) if max(gravity) > 0 else 2
    low, high = places.min(axis=(0, 2)), places.max(axis=(0, 2))
    across = np.delete(places - ((low + high) / 2)[:, None], up, axis=1)
    drawn.form = {
        "kind": "space",
        "up": "xyz"[up],
        "bodies": [
            {
                "name": name,
                "points": some,
                "columns": [f"{name}.{q}" for q in ("x", "y", "z", "e0", "e1", "e2", "e3")],
            }
            for name, some in points.items()
        ],
        "joints": joints,
        "ties": ties,
        "dots": [{"name": dot, "columns": [f"{dot}.{q}" for q in "xyz"]} for dot in dots],
        "pins": pins,
        "bars": bars,
        "low": low.tolist(),
        "high": high.tolist(),
        "reach": float(np.hypot(across[:, 0], across[:, 1]).max()),
    }
    return drawn


def _pins(drawn: _Drawn) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Joints and bars that a mechanism has for pictures alone, where its bodies are energies."""
    joints = drawn.mechanism.drawn_joints
    pins = []
    for joint in joints:
        fixed = [drawn.number(x) for x in (*joint.at, *(joint.axis or ()))] if not joint.outputs else []
        pins.append({"name": joint.name, "columns": list(joint.outputs), "numbers": fixed})
    place = {joint.name: i for i, joint in enumerate(joints)}
    bars = drawn.mechanism.drawn_bars
    return pins, [{"name": bar.name, "pins": [place[name] for name in bar.joints]} for bar in bars]


# Functions in JavaScript ----------------------------------------------------------------------------------------------


def _ties(e: Equations, tied: Sequence[int]) -> str:
    """The page's function from coordinates and parameters to the quantities that start values give."""
    f = e.functions["ties"]
    q, p = ca.SX.sym("q", e.n), ca.SX.sym("p", f.size1_in(1))
    ties = f(q, p, ca.SX.zeros(f.size1_in(2))) if tied else ca.SX()
    return javascript("ties", ["q", "p"], [q, p], [ties[e.tied.index(i)] for i in tied])


_JAVASCRIPT = """const { sqrt, exp, log, expm1, log1p, sin, cos, tan, asin, acos, atan, sinh, cosh, tanh, asinh, acosh,
    atanh, pow, atan2, hypot, floor, ceil, abs: fabs } = Math;
"""


def javascript(name: str, letters: Sequence[str], symbols: Sequence[ca.SX], expressions: Sequence[ca.SX]) -> str:
    """A function of arrays that gives the values of expressions as an array.

    Raises InputError where an expression has no JavaScript.
    """
    # Dense, so that each result has its place.
    f = ca.Function(name, [*symbols], [ca.densify(ca.vertcat(*expressions))]) if expressions else None
    lines = list(_lines(f, letters)) if f else []
    return (
        f"function {name}({', '.join(letters)}) {{\n  {_JAVASCRIPT}  const w = [], r = [];\n"
        + "".join(f"  {line};\n" for line in (*lines, "return r"))
        + "}\n"
    )


def _lines(f: ca.Function, letters: Sequence[str]) -> Iterator[str]:
    for k in range(f.n_instructions()):
        operation, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        operands: Iterable[str] = (f"w[{i}]" for i in inputs)
        if operation == ca.OP_OUTPUT:
            yield f"r[{outputs[1]}] = w[{inputs[0]}]"
        elif operation == ca.OP_INPUT:
            yield f"w[{outputs[0]}] = {letters[inputs[0]]}[{inputs[1]}]"
        elif operation == ca.OP_CONST:
            yield f"w[{outputs[0]}] = {f.instruction_constant(k)!r}"
        elif template := {**BINARY, **UNARY}.get(operation):
            yield f"w[{outputs[0]}] = {template.format(*operands)}"
        else:
            raise InputError(f"{f.name()}: operation {operation} has no JavaScript")
