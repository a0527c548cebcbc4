"""A study as one self-contained page: text, tables, interactive plots, maps, pictures and films in one file.

plotly's script is in the page once, compressed, as is each film; a plot is drawn when it scrolls into view.
"""

from __future__ import annotations

import base64
import gzip
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from io import BytesIO
from typing import TYPE_CHECKING

from markdown import markdown as to_html

from ..model.errors import needs
from .charts import Map
from .plots import Figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

_NUMBER = re.compile(r"<td([^>]*>-?[\d.]+e[-+]?\d+</td>)")
"""Matches a cell with a number that must not wrap."""


def library() -> str:
    """Return plotly's script; raise InputError if plotly is missing."""
    with needs("a report needs plotly", "report"):
        from plotly.offline import get_plotlyjs
    return get_plotlyjs()


@dataclass
class Page:
    """A page assembled from top to bottom."""

    title: str
    _parts: list[str] = field(default_factory=list)
    _heads: list[tuple[int, str, str]] = field(default_factory=list)
    _count: int = 0

    def head(self, level: int, text: str) -> None:
        """Add a heading of level 2 or more, listed in the contents down to level 3."""
        name = f"{re.sub(r'[^a-z0-9]+', '-', text.lower()).strip('-')}-{len(self._heads)}"
        self._heads.append((level, name, text))
        self._parts.append(f'<h{level} id="{name}">{escape(text)}</h{level}>')

    def text(self, markdown: str, note: bool = False) -> None:
        """Add text and tables in Markdown, highlighted if a note."""
        html = to_html(markdown, extensions=["tables"]).replace("<table>", '<div class="table"><table>')
        html = html.replace("</table>", "</table></div>")
        html = _NUMBER.sub(r'<td class="number"\1', html)
        self._parts.append(f'<aside class="note">{html}</aside>' if note else html)

    def fold(self, title: str, markdown: str) -> None:
        """Add text and tables that unfold at a click."""
        self._parts.append(f"<details><summary>{escape(title)}</summary>")
        self.text(markdown)
        self._parts.append("</details>")

    def plot(self, figure: Figure, caption: str) -> None:
        """Add an interactive plot with a caption."""
        data = json.dumps(figure, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        height = figure["layout"]["height"]
        self._parts.append(
            f'<figure><div class="plot" role="img" aria-label="{escape(caption)}" style="height:{height}px">'
            f'<script type="application/json">{data}</script></div><figcaption>{escape(caption)}</figcaption></figure>'
        )

    def pictures(self, drawn: Sequence[Picture], caption: str) -> None:
        """Add figures of matplotlib."""
        for each in drawn:
            file = BytesIO()
            each.savefig(file, format="png", dpi=110, metadata={"Software": None})
            source = base64.b64encode(file.getvalue()).decode("ascii")
            self._parts.append(
                f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{source}">'
                f"<figcaption>{escape(caption)}</figcaption></figure>"
            )

    def film(self, html: str, caption: str) -> None:
        """Add a page with a film, in its own frame."""
        self._parts.append(
            f'<figure><iframe class="film" title="{escape(caption)}" data-film="{_packed(html)}"></iframe>'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )

    def legend(self, colours: Mapping[str, str], meanings: Mapping[str, str]) -> None:
        """Add a legend of all classes of maps: colour, name and meaning."""
        each = "".join(
            f'<div><dt><i style="background:{colour}"></i>{escape(name)}</dt><dd>{escape(meanings[name])}</dd></div>'
            for name, colour in colours.items()
        )
        self._parts.append(f'<dl class="legend">{each}</dl>')

    def maps(self, each: Sequence[Map], colours: Mapping[str, str], about: Mapping[tuple[str, str, str], str]) -> None:
        """Add maps side by side; `about` describes a cell by the title of its map, its row and its column."""
        self._parts.append('<div class="maps">')
        for one in each:
            self._parts.append(_map(one, colours, about))
        self._parts.append("</div>")

    def beside(self) -> None:
        """Begin two columns, on wide screens, up to `together`."""
        self._parts.append('<div class="beside"><div>')

    def next(self) -> None:
        """Begin the second column."""
        self._parts.append("</div><div>")

    def together(self) -> None:
        """End the columns."""
        self._parts.append("</div></div>")

    def html(self) -> str:
        """Return the whole page."""
        contents = "".join(
            f'<a class="level{level}" href="#{name}">{escape(text)}</a>'
            for level, name, text in self._heads
            if level < 4
        )
        values = {
            "title": escape(self.title),
            "contents": contents,
            "style": _text("report.css"),
            "body": "\n".join(self._parts),
            "library": _packed(library()),
            "script": _text("report.js"),
        }
        return re.sub(r"\{\{(\w+)\}\}", lambda match: values[match[1]], _text("report.html"))


def _map(one: Map, colours: Mapping[str, str], about: Mapping[tuple[str, str, str], str]) -> str:
    """Return a map as a table of coloured cells, each with a tooltip and text for screen readers."""
    heads = "".join(f"<th>{escape(x).replace(', ', '<br>')}</th>" for x in one.columns)
    lines = []
    for row in one.rows:
        cells = []
        for column in one.columns:
            name = one.classes.get((row, column))
            if name is None:
                cells.append("<td></td>")
                continue
            note = one.notes.get((row, column), "")
            said = escape(f"{name}; {about.get((one.title, row, column), '')}".removesuffix("; "))
            pale = ' class="pale"' if note else ""
            cells.append(
                f'<td{pale} style="--c:{colours[name]}" title="{said}" aria-label="{said}">{escape(note)}</td>'
            )
        lines.append(f"<tr><th>{escape(row)}</th>{''.join(cells)}</tr>")
    return (
        f'<table class="map"><caption>{escape(one.title)}</caption><thead><tr><th>{escape(one.down)} / '
        f"{escape(one.across)}</th>{heads}</tr></thead><tbody>{''.join(lines)}</tbody></table>"
    )


def _packed(text: str) -> str:
    """Return text as gzip in base64, reproducibly."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode("ascii")


def _text(name: str) -> str:
    return (files(__package__) / "html" / name).read_text(encoding="utf-8")
