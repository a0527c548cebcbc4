"""Films as self-contained pages: a template, the script of a picture and the motion as data in one file."""

import base64
import gzip
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import faces, plane, space
from .pieces import names_of
from .plot import POLE
from .shapes import Shapes, Spot
from .surface import BACKGROUND, FONTS, PALETTE, RIM
from .traced import Traced

EFFORTS = {
    "force": {"applied": "#b3261e", "reaction": "#d9534a"},
    "moment": {"applied": "#5b3fa8", "reaction": "#8a6fd1"},
}
"""Colours of arrows, by unit."""

TRAILING = 12
"""Number of bodies up to which each has a trail; with more, only dots have."""

_OVER = '<canvas id="names" aria-hidden="true"></canvas><p>drag to turn, wheel to zoom, double click to go back</p>'

_SHOWS = """    <div id="shows">
      {boxes}
      <span>{scale}</span>
    </div>
"""


def page(
    shapes: Shapes,
    scene: plane.Stage | faces.Stage,
    time: NDArray[np.float64],
    columns: Mapping[str, NDArray[np.float64]],
    speed: float,
) -> str:
    """Return the page of a motion: its scene, and all poses over time to a hundredth of a pixel and 1e-4 rad."""
    data: dict[str, Any] = {
        "time": np.round(time, _digits(1e-6 * (time[-1] - time[0]) or 1.0)).tolist(),
        "speed": speed,
        "size": scene.size,
        "palette": {**PALETTE, "paper": BACKGROUND, "rim": RIM},
    }
    values = {"over": "", "more": "", "library": ""}
    if isinstance(scene, faces.Stage):
        data |= _in_space(scene, shapes, time, columns)
        values |= {"over": _OVER, "more": _shows(data)}
        values["library"] = space_of("film/space.js", "film/film.js")
    else:
        data |= _in_plane(scene, shapes, time, columns)
    own = ("shared/unpack",) if shapes.space else ("film/plane", "film/film")
    names = ("film/clock", "shared/strokes", *own)
    scripts = [*(text_of(f"{name}.js") for name in names), 'loaded("space");\n' * bool(shapes.space)]
    values |= {
        "title": escape(shapes.name.replace("_", " ")),
        "description": escape(shapes.description),
        "background": BACKGROUND,
        "fonts": FONTS,
        "data": json.dumps(data, separators=(",", ":")).replace("<", "\\u003c"),
    }
    values["script"] = filled("".join(scripts), values)
    return filled(text_of("film/film.html"), values)


def filled(text: str, values: Mapping[str, str]) -> str:
    """Return a template with a value for each `{{name}}`."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: values[match[1]], text)


def data_of(of: Any, digits: int, number: Callable[[Traced], Any] = float) -> Any:
    """Return dataclasses as data for JSON without empty fields; numbers are rounded to `digits` or, if traced, mapped
    by `number`."""
    if is_dataclass(of):
        of = {each.name: getattr(of, each.name) for each in fields(of)}
    if isinstance(of, Mapping):
        kept = {name: x for name, x in of.items() if x or type(x) in (int, tuple, list, dict, Traced)}
        return {name: data_of(x, digits, number) for name, x in kept.items()}
    if isinstance(of, list | tuple):
        return [data_of(x, digits, number) for x in of]
    if isinstance(of, Traced):
        return number(of)
    if isinstance(of, float):
        return int(of) if of.is_integer() else round(of, digits)
    return of


def space_of(*names: str) -> str:
    """Return the element with compressed scripts for pictures in space, in order of dependence (`shared/unpack.js` runs
    it)."""
    script = "".join(map(text_of, ("vendor/three.min.js", "shared/space.js", *names)))
    return f'<script type="text/plain" id="space">{packed_text(script.encode())}</script>\n'


def packed_text(content: bytes) -> str:
    """Return content compressed by gzip as text, reproducibly."""
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode("ascii")


def text_of(name: str) -> str:
    """Return the content of a file of this room."""
    return (files(__package__) / name).read_text(encoding="utf-8")


def _in_plane(
    stage: plane.Stage, shapes: Shapes, time: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]
) -> dict[str, Any]:
    digits = _digits(0.01 / stage.fit.scale)
    poses = {
        name: [np.round(q + 0 * time, n).tolist() for q, n in zip(pose, (digits, digits, 4), strict=True)]
        for name, pose in plane.poses_of(shapes, columns).items()
    }
    rounding = max(digits, 4)
    drawn = {"scene": data_of(stage.scene, rounding), "fit": data_of(stage.fit, rounding)}
    return {**drawn, "dots": shapes.dots, "poses": poses}


def _in_space(
    stage: faces.Stage, shapes: Shapes, time: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]
) -> dict[str, Any]:
    drawn, digits = stage.space, _digits(0.01 / stage.lens.scale)
    frames = {}
    for name, (place, turn) in space.poses_of(shapes, columns).items():
        lengths = np.linalg.norm(turn, axis=-1, keepdims=True)
        frames[name] = {
            key: [np.round(q + 0 * time, n).tolist() for q in np.moveaxis(values, -1, 0)]
            for key, values, n in (("p", place, digits), ("e", turn / np.where(lengths > 0, lengths, 1.0), 5))
        }
    arrows = [
        a for a in drawn.arrows if all(name in columns and np.isfinite(columns[name]).all() for name in a.columns)
    ]
    most = {kind: max([_largest(a, columns) for a in arrows if a.kind == kind], default=0.0) for kind in EFFORTS}
    arrows = [a for a in arrows if _largest(a, columns) > 1e-9 * most[a.kind]]
    bodies = [solid.name for solid in drawn.solids]
    trailing = [*drawn.dots, *(bodies if len(bodies) <= TRAILING else ())]
    centers = [(Spot(name, 0.0, 0.0, 0.0), stage.colors[name]) for name in trailing]
    centers += [(joint.second, "faint") for joint in drawn.pivots if not bodies and joint.second.frame != "ground"]
    moving = [
        {**data_of(a, digits + 3), "values": [_significant(columns[name], most[a.kind]) for name in a.columns]}
        for a in arrows
    ]
    data = {"trails": [{"at": at, "color": color} for at, color in centers], "colors": EFFORTS, **stage_of(stage)}
    most = {kind: value or 1.0 for kind, value in most.items()}
    poles = np.flatnonzero(columns.get("monitor.singular", np.zeros(0)) == POLE).tolist()
    return {"frames": frames, "arrows": moving, "most": most, "poles": poles, **data_of(data, digits + 3)}


def stage_of(stage: faces.Stage) -> dict[str, Any]:
    """Return the arguments of the stage in `shared/space.js`, without the frames."""
    view, names = stage.view, names_of(stage.space, stage.colors)
    data = {"pieces": stage.pieces, "labels": names, "camera": stage.camera, "floor": stage.floor}
    return {**data, "up": view.up, "unit": view.unit, "extent": view.extent}


def _shows(data: Mapping[str, Any]) -> str:
    """Return the controls of a film in space for its layers, and the largest lengths of arrows."""
    kinds = {arrow["kind"] for arrow in data["arrows"]}
    boxes = {"names": ("Names", True), "trails": ("Trails", True)}
    boxes |= {f"{kind}s": (f"{kind.capitalize()}s", kind == "force") for kind in EFFORTS}
    html = []
    for name, (text, on) in boxes.items():
        gone = " hidden" * (name[:-1] in EFFORTS and name[:-1] not in kinds)
        html.append(f'<label{gone}><input type="checkbox" name="{name}"{" checked" * on}>{text}</label>')
    scale = [
        f"{kind} at most {data['most'][kind]:.3g} {unit}"
        for kind, unit in (("force", "N"), ("moment", "N·m"))
        if kind in kinds
    ]
    steps = np.diff(data["time"])
    points = f" at points of {steps.max():.3g} s" if scale and steps.size else ""
    if data["poles"] and any(arrow["role"] == "reaction" for arrow in data["arrows"]):
        points += ", heads alone where reactions have a pole"
    return _SHOWS.format(boxes="\n      ".join(html), scale=", ".join(scale) + points)


def _largest(arrow: Any, columns: Mapping[str, NDArray[np.float64]]) -> float:
    """Return the largest magnitude of an arrow over the motion."""
    return float(np.sqrt(np.sum([np.square(columns[name]) for name in arrow.columns], axis=0)).max())


def _significant(values: NDArray[np.float64], most: float) -> list[float]:
    """Round values to a thousandth of the largest."""
    return np.round(values, _digits(1e-3 * most)).tolist()


def _digits(step: float) -> int:
    """Return the number of decimals that distinguish values that differ by `step`."""
    return -math.floor(math.log10(step))
