"""Surfaces for pictures: pixels of Pillow, or the text of an SVG file; colours, and placement of labels."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from html import escape
from typing import Any, Protocol

from PIL import Image, ImageColor, ImageDraw, ImageFont

Vector = tuple[float, float]

Size = tuple[int, int]

BACKGROUND, GRID, ZERO = "#fbfcfd", "#eceff3", "#d3dae2"
INK, FAINT, STEEL, WHITE = "#2b3440", "#7d8995", "#dde3e9", "#ffffff"
PALETTE = {"ink": INK, "faint": FAINT, "steel": STEEL, "white": WHITE, "grid": GRID, "zero": ZERO}
RIM = 0.58
"""Brightness of the rim of a colour over that of the colour."""

COLORS = ("#6b9bc7", "#e3b05f", "#76b18f", "#d0826f", "#9d8fc6", "#58a9ae", "#c98ca9", "#9aa4ae")
"""Colours of bodies and of dots, in the order of declaration."""

SAMPLES = 3
"""Pixels painted for each pixel shown, along either axis."""

MASKS = 200
"""Number of cached texts of a font, some kilobytes each."""

PASSES = 60
"""Largest number of passes in which labels push each other apart."""

PUSHED = 2.5
"""Largest displacement of a label in a film in its half sizes; beyond it the label is left out. The scripts of pages
have the same number."""

FONTS = 'system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
"""Fonts of pages and of SVG files."""


@dataclass(frozen=True)
class Text:
    """A text about a position [pixels, y upwards]; `anchor` is "m" for its middle, "l" for its start."""

    text: str
    x: float
    y: float
    size: float
    color: str
    anchor: str = "m"


class Surface(Protocol):
    """A surface to paint a picture on."""

    size: Size
    pushed: float
    """Largest displacement of a label by others in its half sizes."""

    def stroke(self, points: Sequence[Vector], width: float, color: str, filled: bool = False) -> None:
        """Paint a line with round ends in pixels, y upwards: a disc if it has one point, a closed area if filled.

        An area of zero width has no outline.
        """

    def text(self, text: Text) -> None:
        """Paint a text with a rim in the colour of the background."""


class Raster:
    """A surface of pixels, painted at a larger scale and reduced."""

    def __init__(self, size: Size, pushed: float = math.inf):
        self.size, self.pushed = size, pushed
        self._image = Image.new("RGB", (SAMPLES * size[0], SAMPLES * size[1]), BACKGROUND)
        self._pen = ImageDraw.Draw(self._image)

    @property
    def image(self) -> Image.Image:
        """Return the current image."""
        return self._image.reduce(SAMPLES)

    def stroke(self, points: Sequence[Vector], width: float, color: str, filled: bool = False) -> None:
        top, ink = self.size[1], _ink(color)
        places = [SAMPLES * each for x, y in points for each in (x, top - y)]
        if filled:
            self._pen.polygon(places, ink)
            if not width:
                return
            places += places[:2]
        wide = max(1, round(SAMPLES * width))
        if len(places) > 2:
            self._pen.line(places, ink, wide)
        r = wide / 2
        for x, y in zip(places[::2], places[1::2], strict=True) if r > 1 else ():
            self._pen.ellipse((x - r, y - r, x + r, y + r), ink)

    def text(self, text: Text) -> None:
        # At whole pixels, so that the masks of moving labels are the same in all frames.
        place = round(SAMPLES * text.x), round(SAMPLES * (self.size[1] - text.y))
        halo, font = round(SAMPLES * text.size / 7), _font(SAMPLES * text.size)
        anchor = f"{text.anchor}m"
        self._pen.text(place, text.text, text.color, font, anchor, stroke_width=halo, stroke_fill=BACKGROUND)


class Svg:
    """A surface that writes an SVG file."""

    pushed = math.inf

    def __init__(self, size: Size, title: str):
        self.size = size
        width, height = size
        self._parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            'role="img" stroke-linecap="round" stroke-linejoin="round">',
            f"<title>{escape(title)}</title>",
            f'<rect width="{width}" height="{height}" fill="{BACKGROUND}"/>',
        ]

    @property
    def file(self) -> str:
        """Return the text of the file, reproducibly."""
        return "\n".join([*self._parts, "</svg>\n"])

    def stroke(self, points: Sequence[Vector], width: float, color: str, filled: bool = False) -> None:
        places = [(_short(x), _short(self.size[1] - y)) for x, y in points]
        if len(places) == 1:
            ((x, y),) = places
            self._parts.append(f'<circle cx="{x}" cy="{y}" r="{_short(width / 2)}" fill="{color}"/>')
            return
        shape, fill = ("polygon", color) if filled else ("polyline", "none")
        width = width or 0.5  # without an outline, the seam between adjacent areas would be visible
        drawn = " ".join(f"{x},{y}" for x, y in places)
        about = f'fill="{fill}" stroke="{color}" stroke-width="{_short(width)}"'
        self._parts.append(f'<{shape} points="{drawn}" {about}/>')

    def text(self, text: Text) -> None:
        anchor = {"m": "middle", "l": "start"}[text.anchor]
        place = f'x="{_short(text.x)}" y="{_short(self.size[1] - text.y)}"'
        rim = f'stroke="{BACKGROUND}" stroke-width="{_short(2 * text.size / 7)}" paint-order="stroke"'
        font = f'font-size="{_short(text.size)}" font-family=\'{FONTS}\' text-anchor="{anchor}" dy="0.35em"'
        self._parts.append(f'<text {place} {font} fill="{text.color}" {rim}>{escape(text.text)}</text>')


def placed(
    texts: Sequence[Text], size: Size, pins: Sequence[tuple[float, float, float]] = (), pushed: float = math.inf
) -> list[Text]:
    """Move texts so that none covers another, one of the `pins` (x, y, radius) or the rim; leave out those that would
    be moved by more than `pushed` of their half sizes.

    Each pass moves every two overlapping texts apart along the axis of the smaller overlap, half the way each, so that
    labels of a film move smoothly. The scripts of pages have the same rules (`apart`).
    """
    boxes = [[t.x, t.y, width_of(t.text, t.size) / 2 + 2, 0.55 * t.size + 1] for t in texts]
    for _ in range(PASSES):
        moved = False
        for i, (x, y, w, h) in enumerate(boxes):
            for other in boxes[i + 1 :]:
                across, along = w + other[2], h + other[3]
                if -across < x - other[0] < across and -along < y - other[1] < along:
                    over, under = across - abs(x - other[0]), along - abs(y - other[1])
                    k, way = (0, over) if over < under else (1, under)
                    way = way / 2 + 0.01
                    sign = 1 if (boxes[i][k] - other[k]) >= 0 else -1
                    boxes[i][k] += sign * way
                    other[k] -= sign * way
                    x, y, moved = boxes[i][0], boxes[i][1], True
            for px, py, r in pins:
                if -w - r < x - px < w + r and -h - r < y - py < h + r:
                    over, under = w + r - abs(x - px), h + r - abs(y - py)
                    k, way = (0, over) if over < under else (1, under)
                    boxes[i][k] += way + 0.01 if boxes[i][k] >= (px, py)[k] else -way - 0.01
                    x, y, moved = boxes[i][0], boxes[i][1], True
            for k, half in ((0, w), (1, h)):
                boxes[i][k] = min(max(boxes[i][k], half), max(size[k] - half, half))
        if not moved:
            break
    return [
        replace(t, x=x, y=y)
        for t, (x, y, w, h) in zip(texts, boxes, strict=True)
        if max(abs(x - t.x) / w, abs(y - t.y) / h) <= pushed
    ]


def base_of(size: Size) -> float:
    """Return the size of a picture relative to 640 x 480."""
    return min(size[0] / 640, size[1] / 480)


def shade(color: str, share: float = RIM) -> str:
    """Return a colour #rrggbb with this share of its brightness."""
    return "#" + "".join(f"{int(int(color[i : i + 2], 16) * share):02x}" for i in (1, 3, 5))


def rim_of(color: str) -> str:
    """Return the colour of the rim of a colour, either by name or as #rrggbb."""
    return INK if color in ("white", "steel", "faint") else shade(PALETTE.get(color, color))


def rounded(points: Iterable[Any]) -> tuple[Vector, ...]:
    """Round points to a hundredth of a pixel."""
    return tuple((round(float(x), 2), round(float(y), 2)) for x, y in points)


def cell_of(pixels: float, scale: float) -> float:
    """Return the distance of grid lines [m] of at least this many pixels: 1, 2 or 5 times a power of ten."""
    wanted = pixels / scale
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(m * power for m in (1, 2, 5, 10) if m * power >= wanted * (1 - 1e-9))


@cache
def _ink(color: str) -> Any:
    """Return a colour as Pillow's numbers, read once: a picture in space has a thousand areas."""
    return ImageColor.getrgb(color)


@cache
def _font(size: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Return the font of a size, which caches its texts as masks: frames of a film repeat most of them."""
    font = ImageFont.load_default(size)
    if isinstance(font, ImageFont.FreeTypeFont):
        font.getmask2 = lru_cache(MASKS)(font.getmask2)  # type: ignore[assignment]
    return font


def width_of(text: str, size: float) -> float:
    """Return the approximate width of a text [pixels] in any of the fonts."""
    return _font(SAMPLES * size).getlength(text) / SAMPLES


def _short(number: float) -> str:
    """Format a number to a hundredth, without trailing zeros."""
    return f"{round(number, 2) + 0.0:.2f}".rstrip("0").rstrip(".")
