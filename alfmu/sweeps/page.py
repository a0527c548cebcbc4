"""A sweep as one self-contained page: settings, failures, quantiles, and plots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..studies.page import Page
from . import pictures
from .measures import FUNCTIONS
from .parts import Store
from .summary import QUANTILES, Failures, Spread, Summary

ACROSS, DOWN = 6, 5
"""Largest numbers of varied and of stored quantities plotted against each other."""

DRAWN = 1500
"""Largest number of cases plotted individually."""

CURVES = 20_000
"""Largest number of cases in bands over time."""

MAPPED, BANDS, LISTED = 30, 12, 200
"""Largest numbers of measures in the map of sensitivities, of outputs over time, and of rows of the table."""

PREFERRED = ("peak", "max", "rms", "final", "min", "mean")
"""Order of preference of the measure that represents an output."""


def chosen(spreads: Sequence[Spread], most: int = DOWN) -> list[Spread]:
    """Return the measures to plot: one of each output among those that differ between cases."""
    order = {f"{f}(": PREFERRED.index(f) for f in FUNCTIONS}
    by_output: dict[str, Spread] = {}
    for s in (s for s in spreads if s.moves):
        begin, _, inner = s.name.partition("(")
        known = by_output.get(inner)
        if known is None or order[f"{begin}("] < order[known.name.partition("(")[0] + "("]:
            by_output[inner] = s
    found = list(by_output.values())
    if len(found) < most:  # few outputs: add more measures of each
        found += [s for s in spreads if s.moves and s not in found]
    return found[:most]


def page(store: Store, s: Summary) -> str:
    """Return the HTML page of finished cases and their summary."""
    plan = store.plan
    made = Page(f"Sweep of {plan.name}")
    moving = [name for name, (low, high) in s.ranges.items() if high > low]
    made.text(
        f"{s.finished} of {s.cases} cases are finished, each from 0 to {plan.times[-1]:g} s with communication steps "
        f"of {plan.times[1] - plan.times[0]:g} s; {s.failed} of them failed. Extremes and means are those at "
        "communication points."
    )
    made.head(2, "Varied quantities")
    made.text(_varied(store, s))
    _reasons(made, "Failures", s.failures, s.finished)
    _reasons(made, "Warnings", s.warnings, s.finished)
    shown = chosen(s.spreads)
    if plan.series and s.finished:
        made.head(2, "Over time")
        _bands(made, store)
    if shown:
        made.head(2, "Distributions")
        columns = store.columns([each.name for each in shown])
        caption = "How many cases have which value; lines are the median and, dotted, quantiles of 5, 25, 75 and 95 %."
        made.plot(pictures.histograms(columns, shown), caption)
        if moving:
            _against(made, store, s, shown, moving)
    elif any(s.count for s in s.spreads):
        made.text("No kept number varies between the cases.")
    made.head(2, "All kept numbers")
    made.text(_table(s.spreads[:LISTED]))
    if more := len(s.spreads) - LISTED:
        made.text(f"And {more} more in summary.json." if more > 0 else "")
    return made.html()


def _against(made: Page, store: Store, s: Summary, shown: Sequence[Spread], moving: Sequence[str]) -> None:
    """Add plots of stored against varied quantities."""
    strongest = sorted(moving, key=lambda name: -max(abs(each.sensitivities.get(name, 0.0)) for each in shown))
    names = [name for name in moving if name in strongest[:ACROSS]]
    made.head(2, "Sensitivities")
    mapped = [each for each in s.spreads if each.moves]
    mapped = mapped if len(mapped) <= MAPPED else chosen(s.spreads, MAPPED)
    made.plot(
        pictures.sensitivities(mapped, moving),
        "Rank correlations (Spearman): +1 if a kept number always rises with a varied one, -1 if it always falls, 0 "
        "if neither, as when it first rises and then falls. Between unrelated numbers, correlations of "
        f"{_noise(s.finished - s.failed)} occur by chance. Numbers that do not vary, or only by round-off, have none.",
    )
    columns = store.columns(["case", "failure", *names, *(each.name for each in shown)])
    failed = columns["failure"] != ""
    places = np.flatnonzero(~failed)
    places = places[np.unique(np.linspace(0, len(places) - 1, min(len(places), DRAWN)).astype(int))]
    varied = {name: columns[name][places] for name in names}
    kept = {each.name: columns[each.name][places] for each in shown}
    left = f"; {len(places)} cases, evenly chosen among {int((~failed).sum())}" if len(places) < (~failed).sum() else ""
    units = {name: store.plan.unit(name) for name in (*varied, *kept)}
    made.head(2, "Scatter")
    made.plot(
        pictures.scatter(varied, kept, units, columns["case"][places].astype(int)),
        f"A point for each case that did not fail{left}.",
    )
    made.head(2, "Parallel coordinates")
    how = "drag along an axis to choose cases, drag its name to move it"
    made.plot(pictures.parallel(varied, kept, units), f"A line for each case that did not fail{left}: {how}.")


def _bands(made: Page, store: Store) -> None:
    names = store.plan.series[:BANDS]
    columns = {name: store.over_time(name, CURVES) for name in names}
    worst = {}
    for name, values in columns.items():
        peaks = np.nanmax(np.abs(np.nan_to_num(values, nan=0.0)), axis=1)
        worst[name] = int(peaks.argmax())
    units = [store.plan.unit(name) for name in names]
    left = f" of {CURVES} cases, evenly chosen" if store.finished > CURVES else ""
    caption = f"Bands that contain 90 % and 50 % of the cases at each instant{left}; the median; and, dotted, the case "
    made.plot(pictures.bands(store.plan.times, columns, units, worst), f"{caption}whose magnitude is the largest.")
    if more := len(store.plan.series) - BANDS:
        made.text(f"{more} more outputs are in the files series-*." if more > 0 else "")


def _noise(count: int) -> str:
    return f"up to ±{min(1.0, 2 / max(1, count - 1) ** 0.5):.2g}"


def _varied(store: Store, s: Summary) -> str:
    """Return a table of the variations."""
    asked, ranges = store.plan.asked, s.ranges
    said = asked.get("vary", {})
    rows = ["| | as | unit | least | largest |", "|---|---|---|---|---|"]
    for name in store.plan.varied:
        low, high = ranges[name]
        how = said.get(name, "table of cases")
        rows.append(f"| `{name}` | `{how}` | {store.plan.unit(name)} | {low:.6g} | {high:.6g} |")
    text = "\n".join(rows)
    if asked.get("samples"):
        text += f"\n\n{asked['samples']} samples ({asked['sampler']}, seed {asked['seed']})."
    return text


def _reasons(made: Page, title: str, reasons: Sequence[Failures], finished: int) -> None:
    if not reasons:
        return
    made.head(2, title)
    rows = ["| cases | part | first cases | the first one's text |", "|---|---|---|---|"]
    for each in reasons:
        first = ", ".join(map(str, each.cases))
        text = each.reason.replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")
        rows.append(f"| {each.count} | {100 * each.count / finished:.3g} % | {first} | {text} |")
    made.text("\n".join(rows))


def _table(spreads: Sequence[Spread]) -> str:
    """Return a table of quantiles and worst cases."""
    heads = ["", "unit", "mean", "deviation", *(f"{100 * q:g} %" for q in QUANTILES), "least (case)", "largest (case)"]
    rows = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for s in spreads:
        numbers = [f"{x:.5g}" for x in (s.mean, s.deviation, *s.quantiles)]
        ends = [f"{s.least:.5g} ({s.least_case})", f"{s.largest:.5g} ({s.largest_case})"]
        if s.count and not s.moves:
            numbers[1], ends = "does not vary", [f"{s.least:.5g}", f"{s.largest:.5g}"]
        rows.append(f"| {' | '.join([f'`{s.name}`', s.unit, *numbers, *ends])} |")
    return "\n".join(rows)
