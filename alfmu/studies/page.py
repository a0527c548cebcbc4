"""A study as one page that needs no network: text, tables, interactive plots, maps, pictures and films in one file.

plotly's script stands in the page once, packed with gzip, and so does each film; a plot is drawn when it comes into
view.
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

from ..model.errors import InputError
from .charts import Map
from .plots import Figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

__all__ = ["Page", "library"]


_NUMBER = re.compile(r"<td([^>]*>-?[\d.]+e[-+]?\d+</td>)")
"""A cell with a number that a line would end within."""


def library() -> str:
    """plotly's script; InputError where plotly is missing."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        raise InputError("a report needs plotly; install it with: pip install 'alfmu[report]'") from None
    return get_plotlyjs()


@dataclass
class Page:
    """A page that is put together from its top to its end."""

    title: str
    _parts: list[str] = field(default_factory=list)
    _heads: list[tuple[int, str, str]] = field(default_factory=list)
    _count: int = 0

    def head(self, level: int, text: str) -> None:
        """A heading of a level from 2 on, which the list of contents has down to level 3."""
        name = f"{re.sub(r'[^a-z0-9]+', '-', text.lower()).strip('-')}-{len(self._heads)}"
        self._heads.append((level, name, text))
        self._parts.append(f'<h{level} id="{name}">{escape(text)}</h{level}>')

    def text(self, markdown: str, note: bool = False) -> None:
        """Text and tables in Markdown; a note stands out."""
        html = to_html(markdown, extensions=["tables"]).replace("<table>", '<div class="table"><table>')
        html = html.replace("</table>", "</table></div>")
        html = _NUMBER.sub(r'<td class="number"\1', html)
        self._parts.append(f'<aside class="note">{html}</aside>' if note else html)

    def fold(self, title: str, markdown: str) -> None:
        """Text and tables that open at a click."""
        self._parts.append(f"<details><summary>{escape(title)}</summary>")
        self.text(markdown)
        self._parts.append("</details>")

    def plot(self, figure: Figure, caption: str) -> None:
        """An interactive plot; the caption says what it shows."""
        data = json.dumps(figure, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
        height = figure["layout"]["height"]
        self._parts.append(
            f'<figure><div class="plot" role="img" aria-label="{escape(caption)}" style="height:{height}px">'
            f'<script type="application/json">{data}</script></div><figcaption>{escape(caption)}</figcaption></figure>'
        )

    def pictures(self, drawn: Sequence[Picture], caption: str) -> None:
        """Figures of matplotlib, as they are."""
        for each in drawn:
            file = BytesIO()
            each.savefig(file, format="png", dpi=110, metadata={"Software": None})
            source = base64.b64encode(file.getvalue()).decode("ascii")
            self._parts.append(
                f'<figure><img alt="{escape(caption)}" src="data:image/png;base64,{source}">'
                f"<figcaption>{escape(caption)}</figcaption></figure>"
            )

    def film(self, html: str, caption: str) -> None:
        """A page with a film, in a frame of its own."""
        self._parts.append(
            f'<figure><iframe class="film" title="{escape(caption)}" data-film="{_packed(html)}"></iframe>'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )

    def legend(self, colours: Mapping[str, str], meanings: Mapping[str, str]) -> None:
        """All classes of maps: colour, name and what it means."""
        each = "".join(
            f'<div><dt><i style="background:{colour}"></i>{escape(name)}</dt><dd>{escape(meanings[name])}</dd></div>'
            for name, colour in colours.items()
        )
        self._parts.append(f'<dl class="legend">{each}</dl>')

    def maps(self, each: Sequence[Map], colours: Mapping[str, str], about: Mapping[tuple[str, str, str], str]) -> None:
        """Maps beside each other; `about` says more of a cell by the title of its map, its row and its column."""
        self._parts.append('<div class="maps">')
        for one in each:
            self._parts.append(_map(one, colours, about))
        self._parts.append("</div>")

    def beside(self) -> None:
        """What follows stands in two columns on a wide screen, up to `together`."""
        self._parts.append('<div class="beside"><div>')

    def next(self) -> None:
        """The second column begins."""
        self._parts.append("</div><div>")

    def together(self) -> None:
        """One column again."""
        self._parts.append("</div></div>")

    def html(self) -> str:
        """The whole page."""
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
    """A map as a table of coloured cells, each of which says what it is to those who point at it or cannot see it."""
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
    """Text as gzip in base64, the same each time."""
    return base64.b64encode(gzip.compress(text.encode(), 9, mtime=0)).decode("ascii")


def _text(name: str) -> str:
    return (files(__package__) / "html" / name).read_text(encoding="utf-8")
