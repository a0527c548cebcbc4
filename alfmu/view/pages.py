"""Films as pages: a template, the script of a picture and the motion as data in one file that needs no network."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import plane, space
from .shapes import Shapes
from .surface import BACKGROUND, FAINT, FONTS, GRID, INK, STEEL, WHITE, ZERO, shade

__all__ = ["filled", "page", "text_of"]

EFFORTS = {
    "force": {"applied": "#b3261e", "reaction": "#d9534a"},
    "moment": {"applied": "#5b3fa8", "reaction": "#8a6fd1"},
}
"""Colours of arrows."""

TRAILING = 12
"""Bodies up to which each has a trail; of more, dots alone."""

_OVER = '<canvas id="names" aria-hidden="true"></canvas><p>drag to turn, wheel to zoom, double click to go back</p>'

_SHOWS = """    <div id="shows">
      {boxes}
      <span>{scale}</span>
    </div>
"""


def page(
    shapes: Shapes,
    scene: plane.Scene | space.Stage,
    time: NDArray[np.float64],
    columns: Mapping[str, NDArray[np.float64]],
    speed: float,
) -> str:
    """The page of a motion: its scene, and all poses over time to a hundredth of a pixel and 1e-4 rad."""
    data: dict[str, Any] = {
        "time": np.round(time, _digits(1e-6 * (time[-1] - time[0]) or 1.0)).tolist(),
        "speed": speed,
        "size": scene.size,
    }
    values = {"over": "", "more": "", "library": ""}
    if isinstance(scene, space.Stage):
        data |= _in_space(scene, shapes, time, columns)
        values |= {"over": _OVER, "more": _shows(data)}
        values["library"] = f"<script>\n{text_of('vendor/three.min.js')}</script>\n"
    else:
        data |= _in_plane(scene, shapes, time, columns)
    names = ("film/clock", "shared/strokes", "film/space" if shapes.space else "film/plane", "film/film")
    scripts = [text_of(f"{name}.js") for name in names]
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
    """A template with a value for each `{{name}}`."""
    return re.sub(r"\{\{(\w+)\}\}", lambda match: values[match[1]], text)


def text_of(name: str) -> str:
    """A file of this room."""
    return (files(__package__) / name).read_text(encoding="utf-8")


def _in_plane(
    scene: plane.Scene, shapes: Shapes, time: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]
) -> dict[str, Any]:
    digits = _digits(0.01 / scene.scale)
    poses = {
        name: [np.round(q + 0 * time, n).tolist() for q, n in zip(pose, (digits, digits, 4), strict=True)]
        for name, pose in plane.poses_of(shapes, columns).items()
    }
    return {"scene": asdict(scene), "dots": shapes.dots, "poses": poses}


def _in_space(
    stage: space.Stage, shapes: Shapes, time: NDArray[np.float64], columns: Mapping[str, NDArray[np.float64]]
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
    centers = [(space.Spot(name, 0.0, 0.0, 0.0), stage.colors[name]) for name in trailing]
    centers += [(joint.second, FAINT) for joint in drawn.pivots if not bodies and joint.second.frame != "ground"]
    colors = {piece.color for piece in stage.pieces}
    return {
        "pieces": [asdict(piece) for piece in stage.pieces],
        "frames": frames,
        "camera": asdict(stage.camera),
        "up": stage.view.up,
        "unit": stage.unit,
        "extent": stage.view.extent,
        "floor": asdict(stage.floor),
        "labels": [asdict(name) for name in space.names_of(drawn, stage.colors)],
        "trails": [{"at": asdict(at), "color": color} for at, color in centers],
        "arrows": [
            {
                **{key: value for key, value in asdict(a).items() if key != "columns"},
                "values": [_significant(columns[name], most[a.kind]) for name in a.columns],
            }
            for a in arrows
        ],
        "most": {kind: value or 1.0 for kind, value in most.items()},
        "colors": {**EFFORTS, "grid": GRID, "zero": ZERO, "faint": FAINT},
        "rims": {color: INK if color in (WHITE, STEEL, FAINT) else shade(color) for color in sorted(colors)},
    }


def _shows(data: Mapping[str, Any]) -> str:
    """What a film in space can show and hide; how long the longest arrow is."""
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
    return _SHOWS.format(boxes="\n      ".join(html), scale=", ".join(scale) + points)


def _largest(arrow: Any, columns: Mapping[str, NDArray[np.float64]]) -> float:
    """The largest effort of an arrow over the motion."""
    return float(np.sqrt(np.sum([np.square(columns[name]) for name in arrow.columns], axis=0)).max())


def _significant(values: NDArray[np.float64], most: float) -> list[float]:
    """Values to a thousandth of the largest."""
    return np.round(values, _digits(1e-3 * most)).tolist()


def _digits(step: float) -> int:
    """Decimals that distinguish values that differ by `step`."""
    return -math.floor(math.log10(step))
