"""Drawings of mechanisms: one frame, the picture of a model, an animation of a result.

The declaration gives the shapes in metres (`geometry`), the motion their extent (`view_of`). `scene` and `pieces`
compose them, and `plane` and `faces` paint these on the surfaces of `surface`: pixels for PNG and GIF, or SVG. Pages
(`pages`) have scripts that paint the same scenes and pieces in a browser (`shared/`), in space by three.js (`vendor/`).
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from ..equations import Equations
from ..kernel import DEFAULT
from ..model.errors import AlfmuError, AssemblyError, InputError
from ..model.files import atomic, path_for, write
from ..model.mechanism import Mechanism
from ..model.parts import Start
from ..model.words import quantity, shown, there_is
from ..runtime import Instance
from ..runtime.pipeline import derive, ready
from ..runtime.probe import Probe
from ..simulation import Progress, instance, run, with_defaults
from ..simulation.result import Result
from . import faces, plane, space
from .pages import page
from .plane import View
from .plot import POLE
from .shapes import Shapes, geometry
from .space import SpaceView
from .surface import FAINT, PUSHED, Raster, Size, Surface, Svg, Text, base_of

MAX_FRAMES = 750
"""Largest number of frames of a GIF; a longer motion has fewer frames per second."""

COLORS_OF_ICON = {False: 48, True: 256}
"""Number of colours of the icon of a mechanism in the plane, whose colours are flat, and in space: half the size of an
icon with all shades, or less."""

COLORS_OF_GIF = 96
"""Number of colours shared by all frames of a GIF."""

MAX_SAMPLES = 5000
"""Largest number of instants of a result in an animation, which interpolates between them."""


SIZE: Size = (640, 480)
"""Default size of a picture [pixels]."""


def view_of(shapes: Shapes, columns: Mapping[str, ArrayLike]) -> View | SpaceView:
    """Return the view that contains all shapes at all instants of `columns` (numbers, or arrays over time).

    Raises InputError if a column is missing or not finite.
    """
    return (space if shapes.space else plane).view_of(shapes, columns)


def draw(
    shapes: Shapes,
    columns: Mapping[str, float],
    size: Size = SIZE,
    view: View | SpaceView | None = None,
    trails: Mapping[str, Sequence[Any]] | None = None,
    caption: str = "",
) -> Image.Image:
    """Draw one frame of `size` [pixels]: the mechanism at the outputs `columns`.

    `view` is the extent of the frame (by default of this instant), `trails` the path [m] of dots by name, `caption` a
    text in the upper left corner. Raises InputError if a column is missing.
    """
    stage = _stage(shapes, view or view_of(shapes, columns), size)
    return _painted(Raster(size), stage, columns, trails or {}, caption).image


def _stage(shapes: Shapes, view: View | SpaceView, size: Size) -> plane.Stage | faces.Stage:
    """Return the static part of a picture."""
    return (faces if isinstance(view, SpaceView) else plane).Stage(shapes, view, size)


def _painted(
    surface: Surface,
    stage: plane.Stage | faces.Stage,
    columns: Mapping[str, float],
    trails: Mapping[str, Sequence[Any]],
    caption: str,
) -> Any:
    """Paint a mechanism at one instant; return the surface."""
    stage.paint(surface, columns, trails)
    base = base_of(surface.size)
    if caption:
        surface.text(Text(caption, 20 * base, surface.size[1] - 24 * base, 14 * base, FAINT, "l"))
    return surface


# Picture of a model ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawing:
    """The picture of a mechanism before a simulation, which a notebook displays.

    `columns` are the outputs with all positions, `trails` the paths [m] of dots, `size` is in pixels.
    """

    shapes: Shapes
    columns: Mapping[str, float]
    view: View | SpaceView = field(repr=False)
    trails: Mapping[str, Sequence[Any]] = field(repr=False)
    caption: str = ""
    size: Size = SIZE

    def __post_init__(self) -> None:
        size = self.size
        if not (isinstance(size, tuple | list) and len(size) == 2 and all(type(x) is int and x > 0 for x in size)):
            name = self.shapes.name
            raise InputError(f"{name}: the size of a picture is {shown(size)}; give two, as (640, 480) pixels")

    def __repr__(self) -> str:
        return f"<Drawing of {self.shapes.name}, {self.size[0]} x {self.size[1]} pixels>"

    def image(self) -> Image.Image:
        """Return a Pillow image."""
        return draw(self.shapes, self.columns, self.size, self.view, self.trails, self.caption)

    def png(self, colors: int | None = None) -> bytes:
        """Return a PNG, reproducibly, reduced to its most frequent colours if `colors` is given."""
        image, buffer = self.image(), io.BytesIO()
        if colors is not None:
            image = _in_colors(image, colors)
        image.save(buffer, "PNG", optimize=True)
        return buffer.getvalue()

    def svg(self) -> str:
        """Return an SVG, reproducibly."""
        surface = Svg(self.size, self.shapes.description or self.shapes.name)
        stage = _stage(self.shapes, self.view, self.size)
        return _painted(surface, stage, self.columns, self.trails, self.caption).file

    def save(self, path: str | Path) -> None:
        """Write a `.png` or an `.svg`. Raises InputError for another suffix, else WriteError."""
        path = path_for("a drawing", path)
        write(path, self.png() if path.suffix.lower() == ".png" else self.svg().encode())

    def _repr_svg_(self) -> str | None:
        return None if self.shapes.space else self.svg()

    def _repr_png_(self) -> bytes | None:
        return self.png() if self.shapes.space else None


def drawing(
    mechanism: Mechanism,
    at: Mapping[str, float] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    size: Size = SIZE,
    equations: Equations | None = None,
) -> Drawing:
    """Return the picture of a mechanism at its start; `parameters` changes defaults as `export` does.

    `at` prescribes values [rad, m] of start quantities or of coordinates; other start values are satisfied if the loops
    can be closed with them, otherwise they are guesses. `equations` are the complete equations of the mechanism, if
    already derived.

    Without `at`, if bars hide each other at the start (as at singular positions), the first start angle is increased by
    1 rad, and a caption mentions it. Dots have the trail of the mechanism's own experiment, up to 500 steps and as far
    as it runs; the frame contains the trails and the position. Raises AlfmuError if the mechanism cannot start, or a
    name is unknown.
    """
    shapes = geometry(mechanism, parameters)
    if at:
        return _drawing_at(mechanism, shapes, at, parameters or {}, size)
    every = equations or derive(mechanism)
    equations = with_defaults(every, parameters or {})
    columns = _start(shapes, equations)
    caption = "" if columns else f"{mechanism.name} declares no bodies and no points"
    angle = next((start for start in equations.starts if start.unit == "rad"), None)
    if angle and plane.hides(shapes, columns):
        turned = {angle.name: round(float(angle.start) + 1, 4)}
        with suppress(AlfmuError):
            columns = _start(shapes, with_defaults(equations, turned))
            caption = f"shown at {angle.name} = {quantity(turned[angle.name], 'rad')}"
    covered: Mapping[str, ArrayLike] = columns
    trails = {}
    dots = shapes.space.dots if shapes.space else shapes.dots
    if dots:
        stop_time = min(equations.stop_time, 500 * equations.step_size)
        with suppress(AlfmuError):
            scene, left = ready(every, parameters or {}, None, None, DEFAULT)
            result = run(instance(scene, DEFAULT), stop_time, equations.step_size, parameters=left)
            trails = {dot: _path(result, shapes, dot) for dot in dots}
            # The frame contains whole trails, and other parts at their position.
            moved = {name for dot in dots for name in _columns_of(shapes, dot)}
            still = np.ones(len(result.time))
            covered = {name: np.append(result[name] if name in moved else still * x, x) for name, x in columns.items()}
    return Drawing(shapes, columns, view_of(shapes, covered), trails, caption, size)


def _drawing_at(
    m: Mechanism, shapes: Shapes, at: Mapping[str, float], parameters: Mapping[str, float | str], size: Size
) -> Drawing:
    """Return the picture of a mechanism at given values of some of its quantities."""
    symbols = {start.name: start.symbol for start in m.starts} | {c.name: c.q for c in m.coordinates}
    given = {name.removeprefix("start."): value for name, value in at.items()}
    if unknown := [name for name in given if name not in symbols]:
        (name, *_) = unknown
        raise InputError(f"{m.name}: it cannot be drawn at {name}; {there_is(name, symbols)}")
    for name, value in given.items():
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            raise InputError(f"{m.name}: it cannot be drawn at {name} = {value}; give a finite number")
    own = {start.name for start in m.starts}
    starts = {f"start.{name}": value for name, value in given.items() if name in own}
    held = {name: value for name, value in given.items() if name not in own}
    placed = copy(m)
    placed._parts = {name: list(parts) for name, parts in m._parts.items()}
    ties, starts_of = Mechanism.ties.of(placed), Mechanism.starts.of(placed)
    for name, value in held.items():
        unit = next(c.unit for c in m.coordinates if c.name == name)
        symbol = ca.SX.sym(f"at.{name}")
        starts_of.append(Start(f"at.{name}", symbol, float(value), unit, f"at.{name}_rate", 0.0, ""))
        ties.append((symbol, symbols[name]))
    everything = with_defaults(derive(placed), {**parameters, **starts})
    columns = {}
    try:
        columns = _start(shapes, everything)
    except AssemblyError:
        # More values than degrees of freedom: start values that were not requested become guesses.
        asked = [start.symbol for start in placed.starts if start.name in given or start.name.startswith("at.")]
        ties[:] = [(symbol, x) for symbol, x in ties if any(symbol is a for a in asked)]
        if len(ties) == len(m.ties) + len(held):
            raise
        columns = _start(shapes, with_defaults(derive(placed), {**parameters, **starts}))
    caption = ", ".join(f"{name} = {value:g}" for name, value in at.items())
    return Drawing(shapes, columns, view_of(shapes, columns), {}, caption, size)


def _in_colors(image: Image.Image, count: int) -> Image.Image:
    """Reduce an image to its most frequent colours."""
    shades = np.asarray(image) @ np.array([2**16, 2**8, 1])
    found, each, often = np.unique(shades, return_inverse=True, return_counts=True)
    colors = found[:, None] // [2**16, 2**8, 1] % 2**8
    kept = colors[np.argsort(-often, kind="stable")[:count]]
    nearest = ((colors[:, None] - kept) ** 2).sum(axis=2).argmin(axis=1)
    indexed = Image.fromarray(nearest.astype(np.uint8)[each].reshape(shades.shape))
    indexed.putpalette(kept.astype(np.uint8).tobytes())
    return indexed


def model_png(
    mechanism: Mechanism,
    parameters: Mapping[str, float | str] | None = None,
    size: Size = SIZE,
    equations: Equations | None = None,
) -> bytes:
    """Return the PNG of `drawing`, reproducibly: the icon of an FMU."""
    drawn = drawing(mechanism, None, parameters, size, equations)
    return drawn.png(COLORS_OF_ICON[drawn.shapes.space is not None])


def _start(shapes: Shapes, equations: Equations) -> dict[str, float]:
    """Return the columns of a picture at the start."""
    probe = Probe.of(equations)
    if probe is None:
        Instance(equations).initialize()  # its message names the reason
        return {}
    q, v, u, p, t = (probe.numbers[letter] for letter in "qvupt")
    nothing = np.zeros(equations.n), np.zeros(equations.l)  # positions do not depend on accelerations and multipliers
    values = np.array(equations.functions["readings"](q, v, *nothing, u, p, t)).ravel()
    known = dict(zip((each.name for each in equations.outputs), values.tolist(), strict=True))
    return {name: known[name] for name in shapes.columns}


def _columns_of(shapes: Shapes, dot: str) -> list[str]:
    """Return the columns of the position of a dot."""
    if shapes.space:
        return list(next(frame.columns for frame in shapes.space.frames if frame.name == dot))
    return [f"{dot}.x", f"{dot}.y"]


def _path(columns: Mapping[str, Any] | Result, shapes: Shapes, dot: str) -> list[tuple[float, ...]]:
    """Return the path of a dot [m]."""
    names = _columns_of(shapes, dot)
    path = list(zip(*(columns[name] for name in names), strict=True))
    return [(*place, 0.0) for place in path] if shapes.space and len(names) == 2 else path


# Films ----------------------------------------------------------------------------------------------------------------


def animate(
    shown: Mechanism | Shapes,
    result: Result,
    path: str | Path,
    *,
    parameters: Mapping[str, float | str] | None = None,
    fps: float = 25,
    speed: float = 1.0,
    size: Size = SIZE,
    progress: Progress = iter,
) -> None:
    """Write a motion as a looping `.gif`, or as a self-contained `.html` page with controls.

    `result` has `time` [s], `names` and arrays by name; `parameters` are those of its run, for a mechanism (shapes
    contain theirs). `speed` is the time [s] shown per second. `fps` and `progress` (wraps the instants of the frames
    [s]) apply to a GIF; a page draws at the rate of the browser. For a mechanism in space, a page also shows forces and
    moments contained in the result. Raises InputError for another suffix, a missing column, or a number that is not
    positive.
    """
    path = path_for("a film", path)
    for name, value in (("fps", fps), ("speed", speed)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{shown.name}: {name} is {value}; it must be a finite number above zero")
    shapes = shown if isinstance(shown, Shapes) else geometry(shown, parameters)
    if not shapes.columns:
        raise InputError(
            f"{shapes.name} has nothing to draw; it needs bodies, or outputs NAME.x and NAME.y in m for each point"
        )
    wanted = [*shapes.columns, *shapes.efforts, "monitor.singular"]
    time, columns = result.time, {name: result[name] for name in wanted if name in result.names}
    view = view_of(shapes, columns)
    if len(time) > MAX_SAMPLES:
        samples = np.linspace(time[0], time[-1], MAX_SAMPLES)
        poles = time[columns.pop("monitor.singular", np.zeros(len(time))) == POLE]
        columns = {name: np.interp(samples, time, x) for name, x in columns.items()}
        columns["monitor.singular"] = np.zeros(MAX_SAMPLES)
        columns["monitor.singular"][np.abs(samples[:, None] - poles).argmin(axis=0)] = POLE
        time = samples
    if path.suffix.lower() == ".gif":
        with atomic(path) as file:
            delay, instants = _instants(time, fps, speed)
            some = instants[:: math.ceil(len(instants) / 5)]
            sheet = np.concatenate([np.asarray(f) for f in _frames(shapes, view, size, time, columns, some)])
            palette = Image.fromarray(sheet).quantize(COLORS_OF_GIF)
            frames = _frames(shapes, view, size, time, columns, progress(instants))
            indexed = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
            next(indexed).save(file, "GIF", save_all=True, append_images=indexed, duration=delay, loop=0)
    else:
        write(path, page(shapes, _stage(shapes, view, size), time, columns, speed).encode())


def _instants(time: NDArray[np.float64], fps: float, speed: float) -> tuple[int, list[float]]:
    """Return the duration of each frame of a GIF [ms], a multiple of 10 ms as in GIF, and their instants [s]."""
    seconds = (time[-1] - time[0]) / speed
    hundredths = max(2, round(100 / fps), math.ceil(100 * seconds / MAX_FRAMES))
    count = 1 + math.floor(100 * seconds / hundredths * (1 + 1e-12))
    return 10 * hundredths, [float(time[0] + i * hundredths / 100 * speed) for i in range(count)]


def _frames(
    shapes: Shapes,
    view: View | SpaceView,
    size: Size,
    time: NDArray[np.float64],
    columns: Mapping[str, NDArray[np.float64]],
    instants: Iterable[float],
) -> Iterator[Image.Image]:
    """Yield pictures of a motion at some instants [s], with trails behind dots."""
    dots, stage = shapes.space.dots if shapes.space else shapes.dots, _stage(shapes, view, size)
    for t in instants:
        now = {name: float(np.interp(t, time, x)) for name, x in columns.items()}
        past = {name: [*columns[name][time < t], now[name]] for name in now}
        trails = {dot: _path(past, shapes, dot) for dot in dots}
        yield _painted(Raster(size, PUSHED), stage, now, trails, f"t = {t:.2f} s").image
