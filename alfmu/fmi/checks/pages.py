"""Reports of checks as text, HTML, Markdown, SVG and JSON."""

import json
from collections.abc import Callable
from html import escape
from pathlib import Path
from textwrap import shorten

from ...model.files import path_for, write
from ...model.words import counted
from .registry import FAILED, NOT_APPLICABLE, NOTED, PASSED, RISKY, UNJUDGED, Finding
from .validation import Report

_COLOURS = {PASSED: "#2b7a3d", FAILED: "#b3261e", NOT_APPLICABLE: "#7a7a7a", UNJUDGED: "#9a6700"}
_COLOURS |= {RISKY: "#a04000", NOTED: "#1f5fa8"}
"""Dark enough for text on white: the contrast is at least 4.5."""

_MARKS = {PASSED: "✓", FAILED: "✗", NOT_APPLICABLE: "–", UNJUDGED: "?", RISKY: "!", NOTED: "i"}

_SHOWN = (FAILED, RISKY, NOTED, UNJUDGED)
"""Results that are shown by default, in order of severity."""

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1d1d1b; max-width: 78rem; margin: 2rem auto; padding: 0 1.2rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } .facts { color: #555; margin: 0 0 1rem; }
.counts { display: flex; gap: 1.5rem; flex-wrap: wrap; padding: 0; list-style: none; } .counts b { font-size: 1.3rem; }
.table { overflow-x: auto; } table { border-collapse: collapse; width: 100%; min-width: 64rem; table-layout: fixed; }
th, td { text-align: left; vertical-align: top; padding: .45rem .7rem; border-bottom: 1px solid #ddd; }
th { background: #f4f4f1; } td p { margin: 0; overflow-wrap: anywhere; } .small { color: #555; font-size: .86em; }
code { font-size: .92em; overflow-wrap: anywhere; } .result { font-weight: 600; }
tr.failed { background: #fdf1f0; }
@media print { body { margin: 0; font-size: 11px; } tr { break-inside: avoid; } }
"""


_COLUMNS = "".join(f'<col style="width: {width}">' for width in ("14%", "16%", "28%", "28%", "14%"))


def summary(report: Report) -> str:
    """Return one line: the number of problems, or that most checks could not be judged, and the number of checks by
    result."""
    counts = report.counts()
    nouns = {RISKY, NOTED}
    each = ", ".join(counted(n, result) if result in nouns else f"{n} {result}" for result, n in counts.items() if n)
    total = counted(len(report.findings), "check")
    found = f"{counted(counts[FAILED], 'problem')} found" if report.judged or counts[FAILED] else "not judged"
    return f"{report.path}: {found} ({total}: {each})"


def lines(report: Report, every: bool = False) -> list[str]:
    """Return the checks that failed, show a risk, have a note, or could not be judged (or every check), and the
    summary.

    A failure cites the section of the standard. Checks that could not be judged for the same reason share a line if
    there are many, for example if the first run fails.
    """
    groups: dict[tuple[str, ...], list[Finding]] = {}
    for f in report.findings:
        if every:
            groups[f.id,] = [f]
        elif f.result in _SHOWN:
            groups.setdefault((f.result, f.detail) if f.result == UNJUDGED else (f.id,), []).append(f)
    if not every:
        groups = dict(sorted(groups.items(), key=lambda group: _SHOWN.index(group[1][0].result)))
    which = [alike[0].id if len(alike) == 1 else counted(len(alike), "check") for alike in groups.values()]
    wide = max(map(len, which), default=0)
    below = "\n" + " " * (len(UNJUDGED) + wide + 4)
    said = []
    for name, (f, *_) in zip(which, groups.values(), strict=True):
        text = f"{f.detail or f.title}{f' ({f.section})' if f.result == FAILED else ''}"
        said.append(f"{f.result:<{len(UNJUDGED)}}  {name:<{wide}}  {text}".replace("\n", below))
    return [*said, summary(report)]


def markdown(report: Report) -> str:
    """Return a Markdown table, for a message to the author of the FMU."""

    def cell(text: str) -> str:
        return escape(text, quote=False).replace("|", "\\|").replace("\n", " ")

    rows = [
        f"| {_MARKS[f.result]} {f.result} | `{f.id}` | {cell(f.title)} | {cell(f.detail)} | {cell(f.section)}: "
        f"{cell(f.demand)} |"
        for f in _by_weight(report)
    ]
    head = "| Result | Check | What | Seen | What the standard says |\n|---|---|---|---|---|"
    return (
        f"# {cell(report.name)}\n\n{cell(_facts(report))}\n\n{cell(summary(report))}\n\n{head}\n"
        + "\n".join(rows)
        + "\n"
    )


def html(report: Report) -> str:
    """Return a self-contained HTML page."""
    counts = "".join(
        f'<li style="color:{_COLOURS[result]}"><b>{number}</b> {result}</li>'
        for result, number in report.counts().items()
    )
    rows = "\n".join(
        f'<tr class="{"failed" if f.result == FAILED else ""}"><td class="result" style="color:{_COLOURS[f.result]}">'
        f"{_MARKS[f.result]} {f.result}</td><td><code>{escape(f.id)}</code></td>"
        f'<td><p>{escape(f.title)}</p><p class="small">{escape(f.demand)}</p></td>'
        f'<td><p>{escape(f.detail)}</p></td><td class="small">{escape(f.section)}</td></tr>'
        for f in _by_weight(report)
    )
    title = f"Validation of {escape(report.name)}"
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title><style>{_STYLE}</style></head><body>
<h1>{title}</h1><p class="facts">{escape(_facts(report))}</p><ul class="counts">{counts}</ul>
<div class="table"><table>{_COLUMNS}
<thead><tr><th>Result</th><th>Check</th><th>What, and what the standard says</th><th>Seen</th>
<th>Section</th></tr></thead><tbody>
{rows}
</tbody></table></div></body></html>
"""


def svg(report: Report) -> str:
    """Return an SVG picture with a line for each check."""
    row, top, wide = 20, 58, 960
    high = top + row * len(report.findings) + 14
    texts = []
    for i, f in enumerate(report.findings):
        y, colour = top + row * i + 14, _COLOURS[f.result]
        bold = ' font-weight="600"' if f.result == FAILED else ""
        seen = f.detail if f.result in _SHOWN else f.title
        texts.append(
            f'<text x="16" y="{y}" fill="{colour}"{bold}>{_MARKS[f.result]}</text>'
            f'<text x="36" y="{y}" fill="{colour}"{bold}>{f.result}</text>'
            f'<text x="182" y="{y}" font-family="monospace" font-size="12">{escape(f.id)}</text>'
            f'<text x="390" y="{y}"{bold}>{escape(shorten(seen, 72 if bold else 82, placeholder=" ..."))}</text>'
        )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" width="{wide}" height="{high}" '
        f'font-family="system-ui, sans-serif" font-size="13" fill="#1d1d1b"><title>{escape(summary(report))}</title>'
        f'<rect width="{wide}" height="{high}" fill="white"/>'
        f'<text x="16" y="24" font-size="16" font-weight="600">{escape(shorten(_facts(report), 100))}</text>'
        f'<text x="16" y="44" fill="#555">{escape(shorten(summary(report), 130))}</text>{"".join(texts)}</svg>\n'
    )


def as_json(report: Report) -> str:
    return json.dumps(report.as_data(), indent=1, ensure_ascii=False) + "\n"


FORMS: dict[str, Callable[[Report], str]] = {".html": html, ".md": markdown, ".svg": svg, ".json": as_json}
"""Formats of a report by the suffix of its file."""


def save(report: Report, path: str | Path) -> None:
    """Write a report in the format of the suffix; raise InputError for an unknown suffix, or WriteError."""
    path = path_for("a report", path)
    write(path, FORMS[path.suffix.lower()](report).encode())


def _facts(report: Report) -> str:
    return f"{report.name}, an FMU of FMI {report.fmi} by {report.tool}"


def _by_weight(report: Report) -> list[Finding]:
    """Return findings in order of severity: failed, risks, notes, could not be judged."""
    order = (*_SHOWN, PASSED, NOT_APPLICABLE)
    return sorted(report.findings, key=lambda f: order.index(f.result))
