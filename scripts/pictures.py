"""Remake pictures of the docs: `film` (docs/five_bar.gif), `singular` (docs/singular.png), `cost` (theory/cost.md).

The film shows one period of the five-bar of Blajer (2002) from its singular position, so it loops without a jump. The
figure shows a four-bar linkage that passes a singular position. `cost DIR` puts the picture and the table of a report,
which `alfmu report all -o DIR` wrote, between the markers of the page.
"""

import argparse
import csv
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles import ode
from oracles.parallelogram import Parallelogram

import alfmu
from alfmu.method.singular import BRANCH_MARGIN, LEAST_DISTANCE, LIMIT_ZONE, READ_DISTANCE, READ_ZONE
from alfmu.simulation import with_defaults
from alfmu.studies.cases import POSITION
from alfmu.studies.looks import LOOKS, integrator
from alfmu.studies.report import LEVELS, TIME
from alfmu.studies.tables import markdown, paragraph
from alfmu.view.picture import animate

DOCS = Path(__file__).parents[1] / "docs"


def film(output: Path, fps: float) -> None:
    """Write the film."""
    run = alfmu.simulate("five_bar", 10.0, 0.01, outputs=["link1.angle", "link1.angular_velocity"])
    angle, rate = run["link1.angle"], run["link1.angular_velocity"]
    after = next(i for i in range(10, len(angle)) if angle[i - 1] < 0 <= angle[i] and rate[i] > 0)
    period = float(np.interp(0.0, angle[after - 1 : after + 1], run.time[after - 1 : after + 1]))
    run = alfmu.simulate("five_bar", period, 0.01, outputs=["link*.x", "link*.y", "link*.angle"])
    animate(alfmu.load("five_bar"), run, output, fps=fps, size=(320, 300))


# A singular position ----------------------------------------------------------------------------------------------

SPEED, TORQUE, STEP, BEFORE, STEPS = 3.0, 4.0, 0.02, 10, 30
"""The motion: speed at the singular position [rad/s], torque [N.m], step [s], number of steps before it and in all.

A step ends almost exactly at the singular position, the hardest case for a method without provisions for it."""

ZONES = {
    "S3: stages are brought to the branch": (BRANCH_MARGIN**0.5, "#d7e6f4"),
    "S4: reactions read are limits": (READ_ZONE * READ_DISTANCE, "#9cc4e4"),
    "S4: accelerations are limits": (LIMIT_ZONE * LEAST_DISTANCE, "#4f93c8"),
}
"""Distance [rad] below which each provision applies, the largest first, and its colour."""


def distance(equations: alfmu.Equations, angle: float) -> float:
    """Return the distance that alfmu measures at an angle [rad] of the crank."""
    i = alfmu.Instance(equations)
    i.set("start.angle", float(angle))
    i.initialize()
    return i.get("monitor.distance")


def singular(output: Path) -> None:
    """Draw the distance from a singular position, and the error of the angle, over a motion through it."""
    equations = with_defaults(alfmu.derive(alfmu.load("four_bar", coordinates="joint")), {"solver.method": "rk4"})
    linkage, before = Parallelogram(m4=None), -STEP * BEFORE
    # The acceleration depends on the angle alone, so the motion is reversible.
    start = linkage.driven(0.0, SPEED, np.array([0.0, -before]), TORQUE)[-1] * (1, -1)
    fine = np.sort([*np.geomspace(1e-5, STEP * (STEPS - BEFORE), 120), *-np.geomspace(1e-5, -before, 120)])
    angles = linkage.driven(*start, fine - before, TORQUE)[:, 0]
    exact = linkage.driven(*start, STEP * np.arange(STEPS + 1), TORQUE)[1:, 0]
    times = STEP * np.arange(1, STEPS + 1) + before

    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for label, (zone, colour) in ZONES.items():
        above.axhspan(1e-6, zone, color=colour, lw=0, label=f"{label} (below {zone:.2g} rad)")
    above.semilogy(fine, [distance(equations, angle) for angle in angles], "k-", lw=1.4)
    above.set(ylabel="distance, root of the margin [rad]", ylim=(1e-5, 2))
    above.set(title=f"Four-bar linkage in joint coordinates, torque of {TORQUE:g} N m, RK4 with steps of {STEP:g} s")
    lines = {"the paper's procedure (solver.branch = paper)": "paper", "on the branch (default)": "continue"}
    for (label, branch), style in zip(lines.items(), ("C1-x", "C0-o"), strict=True):
        given = {"start.angle": start[0], "start.angular_velocity": start[1], "solver.branch": branch}
        given |= {"solver.step_size": STEP}
        run = alfmu.simulate(equations, STEP * STEPS, STEP, parameters=given, inputs={"A.torque": TORQUE})
        errors = np.abs(run["link1.angle"][1:] - exact)
        below.semilogy(times, np.maximum.accumulate(errors), style, ms=4, lw=1.2, label=label)
    by_rk4 = ode.plain_steps(lambda th, _: float(linkage.acceleration(th, TORQUE)), *start, STEP, STEPS)
    best = np.maximum.accumulate(np.abs(by_rk4[1:] - exact))
    below.semilogy(times, best, "k:", lw=1.6, label="RK4 on the exact equation of one degree of freedom")
    below.set(xlabel="time from the singular position [s]", ylabel="largest error so far of the angle [rad]")
    below.set(xlim=(-0.21, 0.41))
    for axes in (above, below):
        axes.legend(fontsize=8, loc="lower right", framealpha=1)
        axes.axvline(0.0, color="0.4", lw=0.8, ls="--")
        axes.grid(alpha=0.3)
    figure.savefig(output, dpi=110)


# Costs ------------------------------------------------------------------------------------------------------------

BEGIN, END = "<!-- report: begin -->", "<!-- report: end -->"

LINES = {
    "auto, compiled": ("alfmu", "auto", "compiled", "-"),
    "rk4, compiled": ("alfmu", "rk4", "compiled", "-"),
    "order8, compiled": ("alfmu", "order8", "compiled", "-"),
    "auto, vm": ("alfmu", "auto", "vm", "--"),
    "auto, through an FMU": ("alfmu", "auto", "FMU (compiled)", ":"),
    "rk4, in Python": ("alfmu", "rk4", "oracle", "-."),
    "Pinocchio, RK4 in Python": ("Pinocchio", "RK4, Baumgarte", None, "-"),
    "Exudyn, generalized alpha": ("Exudyn", "generalized alpha", None, "-"),
    "MuJoCo, RK4": ("MuJoCo", "RK4", None, "-"),
    "SciPy's DOP853 on (9), in Python": ("SciPy on (9)", "DOP853", None, "-"),
}
"""Code, method, way to run and line style by label; colour and marker are those of the report."""


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    """Return the rows of a CSV file of the report."""
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def error_over_time(errors: Sequence[dict[str, str]], mechanism: str) -> Figure:
    """Plot error over run time of one mechanism."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    known = [r for r in errors if r["mechanism"] == mechanism and r["formulation"] in ("residual", "dae")]
    for label, (code, method, way, style) in LINES.items():
        own = [r for r in known if (r["code"], r["method"]) == (code, method) and way in (None, r["way"])]
        own = [r for r in own if r[TIME] and r[POSITION] and (code != "alfmu" or r["formulation"] == "residual")]
        if own:
            x, y = ([float(r[name]) for r in own] for name in (TIME, POSITION))
            look = LOOKS[integrator(own[0])]
            face = look.colour if look.filled else "white"
            shown = {"color": look.colour, "marker": look.marker, "linestyle": style, "markerfacecolor": face}
            axes.loglog(x, y, markersize=5, linewidth=1.3, label=label, **shown)
    axes.set(xlabel="run time, fastest of enough repeats [s]", ylabel="largest error of places and angles [m, rad]")
    axes.grid(color="#e3e8ee")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return figure


def cost(report: Path, page: Path, mechanism: str) -> None:
    """Put the picture and the table of a report into a page; raise ValueError if it has no markers."""
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, marked, after = rest.partition(END)
    if not marked:
        raise ValueError(f"{page} has no lines {BEGIN} and {END}; add them where the report belongs")
    where = {r["what"]: r["value"] for r in rows(report, "environment")}
    rivalry = [r for r in rows(report, "rivalry") if r["its run time [ms]"]]
    text = (
        f"Error against run time of `{mechanism}`, {float(where['longest simulated time [s]']):g} s of motion: "
        f"{where['command']} on {where['processor']}, load average {where['load average at the start']}. Below, the "
        f"run time to an error of {LEVELS[1]:g} m and rad, and how many times as long others take; SciPy runs in "
        "Python, and is compared with alfmu's oracle, which does too:"
    )
    cells = [[float(x) if x[:1].isdigit() else x or None for x in r.values()] for r in rivalry]
    picture = page.with_suffix(".png")
    error_over_time(rows(report, "errors"), mechanism).savefig(picture, dpi=100, metadata={"Software": None})
    shown = [BEGIN, f"![error against run time of the {mechanism}]({picture.name})", paragraph(text)]
    shown += [markdown([*rivalry[0]], cells, 2), END]
    page.write_text(before + "\n\n".join(shown) + after, encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Remake one of the pictures."""
    line = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = line.add_subparsers(dest="kind", required=True)
    film_line, figure_line, cost_line = (kinds.add_parser(name) for name in ("film", "singular", "cost"))
    film_line.add_argument("-o", "--output", type=Path, default=DOCS / "five_bar.gif", help="file to write")
    film_line.add_argument("--fps", type=float, default=20.0, help="frames per second (default: %(default)g)")
    figure_line.add_argument("-o", "--output", type=Path, default=DOCS / "singular.png", help="file to write")
    cost_line.add_argument("report", type=Path, metavar="DIR", help="folder that `alfmu report all -o DIR` wrote")
    cost_line.add_argument("-o", "--output", type=Path, default=DOCS / "theory" / "cost.md", help="page to write into")
    cost_line.add_argument("--mechanism", default="five_bar", help="that of the picture (default: %(default)s)")
    chosen = line.parse_args(arguments)
    try:
        if chosen.kind == "film":
            film(chosen.output, chosen.fps)
        elif chosen.kind == "singular":
            singular(chosen.output)
        else:
            cost(chosen.report, chosen.output, chosen.mechanism)
    except OSError as error:
        print(f"{error.filename}: {error.strerror}; give the folder of `alfmu report all -o DIR`", file=sys.stderr)
        return 1
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    print(os.path.relpath(chosen.output))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
