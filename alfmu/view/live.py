"""A live page: a mechanism that runs in a browser, in one self-contained file.

The page contains the runtime as WebAssembly and the scene of the mechanism's FMU, so its numbers are those of the FMU.
Its files are in the folder `page`: `engine.js` and `worker.js` drive the runtime; `picture.js`, `plane.js` and
`space.js` animate the picture with the scripts of films in `shared`; `page.js` has the clock; plots, controls and
pointer input have their own files. This module collects the data of the mechanism.
"""

import importlib.metadata
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ..equations import Configuration, Equations, Variable
from ..equations.interface import state_starts, variables_of
from ..kernel.stream import BINARY, UNARY
from ..model.doubts import tell_of_gravity
from ..model.errors import AlfmuError, InputError
from ..model.files import write
from ..model.mechanism import Mechanism
from ..model.spatial import right_handed
from ..runtime import Instance
from ..runtime.build import WEB
from ..runtime.pipeline import packed, prepared
from ..runtime.shipped import library
from ..simulation import communication_points
from ..simulation.result import Result
from . import faces
from .pages import data_of, filled, packed_text, space_of, stage_of, text_of
from .picture import SIZE, view_of
from .scene import scene_of
from .shapes import Shapes, geometry
from .space import SpaceView
from .surface import COLORS, FONTS
from .traced import Traced

_MARK = '<meta name="generator" content="alfmu'
"""Identifies a page of alfmu."""

LOOK = 2000, 20_000
"""Largest numbers of communication steps, and of steps of `solver.step_size`, in the run before the page: a second or
two. The extent of the picture follows from it, reproducibly."""

CURVES = 8
"""Largest number of curves in a plot."""


def live(
    mechanism: Mechanism,
    equations: Equations,
    path: str | Path,
    *,
    parameters: Mapping[str, float | str] | None = None,
    source: str = "",
) -> None:
    """Write the page of a mechanism.

    `equations` are those of the mechanism with the initial defaults of the page, `parameters` those that differ from
    the mechanism's own, `source` the argument of `alfmu simulate` for it. Raises AlfmuError if the mechanism cannot
    start, or if there is no runtime for browsers.
    """
    e = prepared(equations, "vm")
    unit = Instance(e)
    tell_of_gravity(mechanism)
    wasm = library(WEB, e.name)
    looked, scale = _look(unit, e)
    about, functions = _about(mechanism, e, parameters or {}, looked, scale)
    about["command"] = f"alfmu simulate {source or e.name} --step {e.interval:g}"
    write(path, _page(mechanism, about, functions, wasm, packed(e)).encode())


def needed(mechanism: Mechanism) -> list[str]:
    """Return the names of the outputs for the picture and the displays of a page."""
    return sorted({*geometry(mechanism).columns, "monitor.*"})


def written_by_alfmu(path: Path) -> bool:
    """Return whether a file is a page of alfmu, which may be overwritten."""
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return _MARK in file.read(1000)
    except OSError:
        return False


# Page -------------------------------------------------------------------------------------------------------------


def _page(mechanism: Mechanism, about: dict[str, Any], functions: str, wasm: bytes, scene: bytes) -> str:
    """Return the text of a page, reproducibly."""
    name = escape(mechanism.name.replace("_", " "))
    kind = about["picture"]["kind"] if about["picture"] else ""
    hints = {
        "space": "Drag to turn, scroll or pinch to zoom",
        "plane": "Drag a body to place it" if about["tied"] else "",
    }
    libraries = ["vendor/uPlot.LICENSE"]
    library = over = ""
    own = ["picture", *(["plane"] if kind == "plane" else []), "page", "plots", "controls", "hands"]
    if kind == "space":
        libraries += ["vendor/three.LICENSE"]
        library = space_of("page/space.js")
        over = '<canvas id="over" aria-hidden="true"></canvas>'
    values = {
        "title": name,
        "description": escape(mechanism.description),
        "version": escape(importlib.metadata.version("alfmu")),
        "interval": f"{about['interval']:g}",
        "hint": hints.get(kind, "This mechanism has no drawing: plots show its motion."),
        "over": over,
        "library": library,
        "libraries": "Plots by uPlot" + ", pictures by three.js" * (kind == "space"),
        "styles": text_of("vendor/uPlot.min.css") + text_of("page/page.css"),
        "licence": escape("\n".join(map(text_of, libraries))),
        "about": json.dumps(about, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        "wasm": packed_text(wasm),
        "scene": packed_text(scene),
        "worker": text_of("page/engine.js") + text_of("page/worker.js"),
        "plots": text_of("vendor/uPlot.min.js"),
        "functions": functions,
        "script": text_of("shared/unpack.js")
        + filled(text_of("shared/strokes.js"), {"fonts": FONTS})
        + "".join(text_of(f"page/{each}.js") for each in own),
    }
    return filled(text_of("page/page.html"), values)


def _about(
    mechanism: Mechanism,
    e: Equations,
    parameters: Mapping[str, float | str],
    looked: Result,
    scale: tuple[float, float],
) -> tuple[dict[str, Any], str]:
    """Return the page's data of a scene, and its functions in JavaScript."""
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
    # The order of the value references in the runtime.
    every = [*found.parameters, *found.choices, *found.inputs, *found.switches, *found.outputs]
    variables = []
    for v in every:
        choice = v.type == "String"
        kind = "choice" if choice else kinds.get(v.name, "solver")
        own = {key: getattr(v, key) for key in ("name", "unit", "type", "minimum", "maximum", "description")}
        start = 0.0 if choice else float(v.start)
        variables.append({**own, "kind": kind, "start": start, "range": range_of(v, kind, scale)})
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
        "colors": COLORS,
    }
    columns = {every[reference].name: column for column, reference in enumerate(shown)}
    about["picture"], function = _picture(mechanism, parameters, looked, columns)
    if about["picture"]:
        about["picture"]["parameters"] = [
            {"ref": references[p.name]} if p.name in references else {"value": float(parameters.get(p.name, p.default))}
            for p in mechanism.parameters
        ]
    about["tie_parameters"] = [{"ref": references[v.name]} for v in e.parameters]
    return about, _ties(e, tied) + function


def range_of(v: Variable, kind: str, scale: tuple[float, float]) -> list[float] | None:
    """Return the range of a slider: the declared bounds, or a range with visibly different motions.

    `scale` is the largest kinetic energy [J] of the preliminary run, and the size of the mechanism [m]: an effort goes
    up to twice that energy over its path. None if an input field suffices.
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
    """Return the smallest number that is 1, 2, 3 or 5 times a power of ten and not below `wanted`."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return float(f"{next(m * power for m in (1, 2, 3, 5, 10) if m * power >= wanted * (1 - 1e-9)):.3g}")


def _groups(e: Equations, shown: Sequence[Variable]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the groups of variables for plots, and the initial plots."""
    inputs = {v.name for v in e.inputs} | {v.name for v in e.switches}
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
    """Return a name without the part in the title of its legend."""
    return (name.removesuffix(f".{of}") if of and of != "inputs" else name).removeprefix("monitor.").replace("_", " ")


# Preliminary run ----------------------------------------------------------------------------------------------------


def _look(unit: Instance, e: Configuration) -> tuple[Result, tuple[float, float]]:
    """Return the beginning of a run, its largest kinetic energy [J] and the extent of the motion [m].

    Raises AlfmuError if the mechanism cannot start.
    """
    most = min(LOOK[0] * e.interval, LOOK[1] * float(e.solver.get("step_size", e.step_size)), e.stop_time)
    times = communication_points(e.name, max(most, e.interval), e.interval, len(unit.outputs))
    names = tuple(v.name for v in unit.outputs)
    values, why = unit.run(times, [], np.zeros((len(times), 0)), names)
    if not len(values) and why is not None:
        raise why
    values = values[np.isfinite(values[:, [v.unit == "m" for v in unit.outputs]]).all(axis=1)]
    result = Result(e.name, times[: len(values)], names, {}, values)
    ways = [np.ptp(result[v.name]) for v in unit.outputs if v.unit == "m" and not v.name.startswith("monitor.")]
    size = max([float(way) for way in ways if len(values)], default=0.0)
    energy = unit.energy_scale
    return result, (energy if energy > 1e-9 else 1.0, size if size > 1e-9 else 1.0)


# Picture --------------------------------------------------------------------------------------------------------------


def _picture(
    m: Mechanism, parameters: Mapping[str, float | str], looked: Result, columns: Mapping[str, int]
) -> tuple[dict[str, Any] | None, str]:
    """Return the picture of the page, and the function from parameters to its numbers.

    None if there is nothing to draw, or if the picture depends on more than parameters. `columns` are those of outputs.
    """
    try:
        shapes = geometry(m, parameters, traced=True)
        view = view_of(shapes, {name: looked[name] for name in shapes.columns})
    except AlfmuError:
        shapes = Shapes(m.name, "")
    if not shapes.columns:
        return None, javascript("geometry", ["p"], [], [])
    places: dict[str, int] = {}
    expressions: list[ca.SX] = []

    def number(x: Traced) -> dict[str, int]:
        """Return the index of a number among the function's results."""
        key = str(x.expression)
        if key not in places:
            places[key] = len(expressions)
            expressions.append(x.expression)
        return {"#": places[key]}

    data: dict[str, Any]
    if isinstance(view, SpaceView):
        stage = faces.Stage(shapes, view, SIZE)
        frames = {frame.name: (frame.kind, frame.columns) for frame in stage.space.frames}
        data = {"kind": "space", "dots": stage.space.dots, "colors": stage.colors, **stage_of(stage)}
        data["room"] = _room(view)
    else:
        scene = scene_of(shapes)
        frames = {link.name: ("plane", tuple(f"{link.name}.{q}" for q in ("x", "y", "angle"))) for link in shapes.links}
        frames |= {dot: ("point", (f"{dot}.x", f"{dot}.y")) for dot in shapes.dots}
        data = {"kind": "plane", "scene": scene, "guides": shapes.guides, "dots": shapes.dots}
        data |= {"low": view.low, "high": view.high, "travel": view.travel}
    data["frames"] = {
        name: {"kind": kind, "columns": [columns[each] for each in of]} for name, (kind, of) in frames.items()
    }
    symbols = ca.vertcat(*(p.symbol for p in m.parameters))
    return data_of(data, 9, number), javascript("geometry", ["p"], [symbols], expressions)


def _room(view: SpaceView) -> dict[str, Any]:
    """Return the vertical cylinder that contains all positions, and the floor below them [m]."""
    axes = np.array(right_handed(view.up)).T
    flat, tall = np.split(view.cloud @ axes, [2], axis=1)
    middle = (flat.min(axis=0) + flat.max(axis=0)) / 2
    reach = float(np.linalg.norm(flat - middle, axis=1).max())
    return {"middle": middle.tolist(), "reach": reach, "low": view.floor, "high": float(tall.max())}


# Functions in JavaScript ----------------------------------------------------------------------------------------------


def _ties(e: Equations, tied: Sequence[int]) -> str:
    """Return the page's function from coordinates and parameters to the quantities of start values."""
    f = e.functions["ties"]
    q, p = ca.SX.sym("q", e.n), ca.SX.sym("p", f.size1_in(1))
    ties = f(q, p, ca.SX.zeros(f.size1_in(2))) if tied else ca.SX()
    return javascript("ties", ["q", "p"], [q, p], [ties[e.tied.index(i)] for i in tied])


_JAVASCRIPT = """const { sqrt, exp, log, expm1, log1p, sin, cos, tan, asin, acos, atan, sinh, cosh, tanh, asinh, acosh,
    atanh, pow, atan2, hypot, floor, ceil, abs: fabs } = Math;
"""


def javascript(name: str, letters: Sequence[str], symbols: Sequence[ca.SX], expressions: Sequence[ca.SX]) -> str:
    """Return a JavaScript function from arrays to the array of the values of expressions.

    Raises InputError if an expression cannot be translated.
    """
    # Dense, so that each result has its index.
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
