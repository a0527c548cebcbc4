"""How a mechanism passes its singular positions under drive: many phases, many steps, rows of loops, a slider-crank.

Writes `singular.md`, CSV files and pictures into one folder. Each run is judged by the exact motion, that of one degree
of freedom on the branch that is followed; beside it stands RK4 on that same equation with the same step, which is as
good as RK4 can be.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import pairwise, product
from multiprocessing import get_context
from typing import NamedTuple

import numpy as np
from _study import Report, Results, Target
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tqdm import tqdm

import alfmu
from alfmu import simulate
from alfmu.method.integrators import rk4
from alfmu.simulation import prepared, with_defaults
from alfmu.studies.tables import Row

GRAVITY = 9.81

RK4 = {"solver.method": "rk4"}
"""Steps have the length that each study gives."""


OWN, PAPER = BRANCHES = ("continue", "paper")
"""Values of solver.branch that are compared: the default, and the plain scheme."""

SEED = 1
PHASE_STOP, PHASE_STEPS = 2.5, (0.02, 0.005)
PHASE_SETS = ("mixed", "joint")
TORQUES, SPEEDS = (4.0, 2.0, 1.0, -3.0, 8.0), (2.0, 2.0, 0.5)
"""The phases: seed of their angles, stop time [s], steps [s], coordinates, torques [N.m] and speeds [rad/s] in turn."""

BLOCK = 25
"""Phases that a process takes at a time."""

LOST, TILT = 0.1, 1e-6
"""Angle error and tilt of what should be parallel [rad], above which a run has switched its branch."""

CALM, CLOSE = 5e-8, 1e-7
"""Where RK4 on the exact equation errs by less than the first, alfmu should by no more than the second [rad]."""

DRIVEN_STOP, DRIVEN_SPEED = 5.0, 2.0
"""The runs over many steps start exactly at 0 with this speed [rad/s], until this time [s]."""

ROW_STEPS = {"natural": 0.00125, "absolute": 0.0025}
"""Steps of the N-four-bar [s], by coordinates."""

ROW_START = (np.pi / 2, -1.0)
SAMPLE = 0.05
"""How often the N-four-bar and the slider-crank are read [s]."""

CRANK_SETS = ("absolute", "joint", "mixed", "natural")
CRANK_START, CRANK_STEP, ROD, SHORT = (np.pi / 4, 0.0), 0.00125, 0.5, 0.3
"""The slider-crank: coordinates, start [rad, rad/s], step [s], length of the rod and of a regular crank [m]."""

GOOD = 1e-8
"""An error [rad] that needs no comparison with a regular mechanism."""


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    phases: int
    cases: tuple[str, ...]
    """Of the runs over many steps."""
    loops: tuple[int, ...]
    rows: tuple[str, ...]
    """Coordinates of the N-four-bar."""
    cranks: tuple[str, ...]
    """Coordinates of the slider-crank."""
    long: float
    """Stop time of the N-four-bar and the slider-crank [s]."""
    hardest: int = 5
    """Phases that the report lists, of each way to run them."""


# The exact motion -------------------------------------------------------------------------------------------------

Acceleration = Callable[[NDArray, NDArray, float | NDArray], NDArray]
"""th'' of th, th' and a torque on the crank; all may be arrays of motions."""

Torque = float | NDArray | Callable[[float], float]
"""A number for each motion, or a function of time whose value is held over each step."""

LARGEST = 0.005
"""Longest step of the reference [s], at which round-off is all that is left of its error."""


@cache
def parallelogram(m2: float = 1.0, m4: float = 0.0) -> Acceleration:
    """Five-bar of links of 1 m and 1 kg on its parallelogram branch; the four-bar where m4 = 0.

    (m1/3 + m3/3 + m2 + m4/4) l^2 th'' = torque - (m1/2 + m3/2 + m2 + m4/2) g l cos th
    """
    inertia, weight = 2 / 3 + m2 + m4 / 4, (1 + m2 + m4 / 2) * GRAVITY
    return lambda th, w, torque: (torque - weight * np.cos(th)) / inertia


def row(loops: int) -> Acceleration:
    """N-four-bar of links of 1 m and 1 kg: (4 N + 1) / 3 m l^2 th'' = -(3 N + 1) / 2 m g l cos th."""
    return lambda th, w, torque: (torque - (3 * loops + 1) / 2 * GRAVITY * np.cos(th)) / ((4 * loops + 1) / 3)


def slider_crank(l1: float, l2: float) -> Acceleration:
    """Slider-crank with masses of 1 kg; where l1 = l2 the rod mirrors the crank, through both links vertical.

    J th'' + J' th'^2 / 2 = torque - (m1 + m2) g l1/2 cos th, with J by the places of rod and slider over th; p is the
    angle of the rod, sin p = -l1/l2 sin th.
    """

    def acceleration(th: NDArray, w: NDArray, torque: float | NDArray) -> NDArray:
        s, c = np.sin(th), np.cos(th)
        sp = -l1 / l2 * s
        if l1 == l2:
            cp, p1, p2 = c, -1.0, 0.0
        else:
            cp = np.sqrt(1 - sp**2)
            p1 = -l1 * c / (l2 * cp)
            p2 = (l1 * s + l2 * sp * p1**2) / (l2 * cp)
        bend = cp * p1**2 + sp * p2
        x2 = -l1 * s - l2 / 2 * sp * p1, -l1 * c - l2 / 2 * bend
        y2 = l1 / 2 * c, -l1 / 2 * s
        x3 = -l1 * s - l2 * sp * p1, -l1 * c - l2 * bend
        J = l1**2 / 3 + x2[0] ** 2 + y2[0] ** 2 + l2**2 / 12 * p1**2 + x3[0] ** 2
        half_slope = x2[0] * x2[1] + y2[0] * y2[1] + l2**2 / 12 * p1 * p2 + x3[0] * x3[1]
        return (torque - GRAVITY * l1 * c - half_slope * w**2) / J

    return acceleration


class Reference(NamedTuple):
    """Angles (steps + 1, motions) [rad], exact and by RK4; by how much steps of half the length change the former."""

    exact: NDArray
    by_rk4: NDArray
    change: float

    @property
    def rk4_error(self) -> float:
        """The largest error of RK4 on the exact equation [rad]."""
        return float(np.abs(self.by_rk4 - self.exact).max())


def reference(acceleration: Acceleration, start: Sequence, torque: Torque, dt: float, steps: int) -> Reference:
    """The motions from angles and speeds [rad, rad/s] under a torque that is held over each step."""
    y = np.array([np.atleast_1d(x) for x in start], float)
    by_rk4 = [y]
    for k in range(steps):
        held = partial(_rate, acceleration, torque(k * dt) if callable(torque) else torque)
        by_rk4.append(rk4(held, 0.0, by_rk4[-1], dt))
    times = dt * np.arange(steps + 1)
    exact, finer = (motion(acceleration, y, torque, times, largest) for largest in (LARGEST, LARGEST / 2))
    return Reference(exact[:, 0], np.array(by_rk4)[:, 0], float(np.abs(exact - finer)[:, 0].max()))


def motion(acceleration: Acceleration, y: NDArray, torque: Torque, times: NDArray, largest: float) -> NDArray:
    """Angles and speeds (times, 2, motions) by DOP853, begun anew wherever the torque changes."""
    if callable(torque):
        states = [y]
        for t, after in pairwise(times):
            span = np.array([t, after])
            states.append(motion(acceleration, states[-1], torque(t), span, largest)[-1])
        return np.array(states)
    solution = solve_ivp(
        lambda t, z: _rate(acceleration, torque, t, z.reshape(y.shape)).ravel(),
        (times[0], times[-1]),
        y.ravel(),
        "DOP853",
        times,
        rtol=1e-13,
        atol=1e-13,
        max_step=largest,
    )
    return solution.y.T.reshape(len(times), *y.shape)


def _rate(acceleration: Acceleration, torque: float | NDArray, t: float, y: NDArray) -> NDArray:
    return np.array([y[1], acceleration(y[0], y[1], torque)])


# Runs -------------------------------------------------------------------------------------------------------------


@cache
def scene(kernel: str, name: str, **options: str | int) -> alfmu.Equations:
    """A mechanism made ready to run by RK4, once a process; compiled code is shared by all through the user's cache."""
    return prepared(with_defaults(alfmu.derive(alfmu.load(name, **options)), RK4), kernel)


@dataclass
class Run:
    """What a run gave up to where it ended; `stopped` says why it ended early."""

    angles: NDArray
    """Of the crank, after each step [rad]."""
    tilt: float
    """Largest angle between links that should be parallel [rad]."""
    evaluations: int
    stopped: str | None = None

    def error(self, exact: NDArray) -> float:
        """The largest angle error [rad]."""
        return float(np.abs(self.angles - exact[: len(self.angles)]).max())


def drive(
    equations: alfmu.Equations,
    given: Mapping[str, float | str],
    torques: Mapping[str, float | Callable[[float], float]],
    dt: float,
    steps: int,
) -> Run:
    """Step a linkage from an assembled start, each step under a torque that is held."""
    i, stopped = alfmu.Instance(equations), None
    changing = {name: torque for name, torque in torques.items() if callable(torque)}
    at_start = {name: torque(0.0) if callable(torque) else torque for name, torque in torques.items()}
    for name, value in {"g": GRAVITY, **given, **at_start, "solver.step_size": dt}.items():
        i.set(name, value)
    q = []
    try:
        i.initialize()
        q.append(i.q.copy())
        for k in range(steps):
            for name, torque in changing.items():
                i.set(name, torque(k * dt))
            i.step(dt, k * dt)
            q.append(i.q.copy())
    except alfmu.AlfmuError as error:
        stopped = str(error)
    if not q:
        return Run(np.empty(0), 0.0, 0, stopped)
    at = dict(zip((c.name for c in equations.coordinates), np.array(q).T, strict=True))
    return Run(at["th1"], tilt(at), i.counters.evaluations, stopped)


def tilt(at: Mapping[str, NDArray]) -> float:
    """Largest departure from a parallelogram [rad]: of couplers from the base, of link 3 from link 1."""
    below = 0.0 if "x2" in at else at["th1"]  # in joint coordinates couplers are measured from link 1
    off = [at["th3"] - at["th1"], *(at[name] + below for name in ("th2", "th4") if name in at)]
    return float(np.abs(off).max())


def spread(call: Callable, cases: Sequence[tuple], text: str) -> list:
    """`call(*case)` of all cases, by as many processes as there are processors."""
    workers = min(os.cpu_count() or 1, len(cases))
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        return list(tqdm(pool.map(call, *zip(*cases, strict=True)), text, len(cases), unit="part"))


# Phases -----------------------------------------------------------------------------------------------------------


class Phase(NamedTuple):
    """Start and drive of the four-bar."""

    angle: float
    torque: float
    speed: float


def phases(number: int) -> list[Phase]:
    """Random starting angles [rad]; torques [N.m] and speeds [rad/s] in turn."""
    angles = np.random.default_rng(SEED).uniform(-np.pi, np.pi, number)
    return [Phase(float(x), TORQUES[k % len(TORQUES)], SPEEDS[k % len(SPEEDS)]) for k, x in enumerate(angles)]


def run_phases(kernel: str, coordinates: str, branch: str, dt: float, starts: Sequence[Phase]) -> list[Run]:
    """The four-bar from some phases, in a process of its own."""
    equations, steps = scene(kernel, "four_bar", coordinates=coordinates), round(PHASE_STOP / dt)
    runs = []
    for phase in starts:
        given = {"start.angle": phase.angle, "start.angular_velocity": phase.speed, "solver.branch": branch}
        runs.append(drive(equations, given, {"A.torque": phase.torque}, dt, steps))
    return runs


def phase_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Rows of phases.csv, hardest.csv and phase_runs.csv: all phases, by coordinates, step and branch."""
    kernel = kernels[-1]
    for coordinates in PHASE_SETS:
        scene(kernel, "four_bar", coordinates=coordinates)  # compiles once for all processes
    starts = phases(effort.phases)
    blocks = [starts[k : k + BLOCK] for k in range(0, len(starts), BLOCK)]
    ways = list(product(PHASE_STEPS, PHASE_SETS, BRANCHES))
    cases = [(kernel, coordinates, branch, dt, block) for dt, coordinates, branch in ways for block in blocks]
    parts = iter(spread(run_phases, cases, "phases"))
    runs = {way: [run for _ in blocks for run in next(parts)] for way in ways}
    found: dict[str, list[Row]] = {"phases": [], "hardest": [], "phase_runs": []}
    th, torque, w = np.array(starts).T
    for dt in PHASE_STEPS:
        motions = reference(parallelogram(), (th, w), torque, dt, round(PHASE_STOP / dt))
        for coordinates in PHASE_SETS:
            pairs = list(zip(*(runs[dt, coordinates, branch] for branch in BRANCHES), strict=True))
            rows = [phase_row(dt, coordinates, k, p, motions, pairs[k]) for k, p in enumerate(starts)]
            found["phases"] += [summary(rows, branch, motions.change) for branch in BRANCHES]
            found["hardest"] += sorted(rows, key=lambda r: -(r[f"{OWN} / RK4"] or np.inf))[: effort.hardest]
            found["phase_runs"] += rows
    return found


def phase_row(dt: float, coordinates: str, number: int, phase: Phase, motions: Reference, runs: Iterable[Run]) -> Row:
    """A row of phase_runs.csv: one phase, with and without the branch continued."""
    exact = motions.exact[:, number]
    best = float(np.abs(motions.by_rk4[:, number] - exact).max())
    line: Row = {"coordinates": coordinates, "dt [s]": dt, "phase": number, "start angle [rad]": phase.angle}
    line |= {"torque [N.m]": phase.torque, "start speed [rad/s]": phase.speed, "RK4 error [rad]": best}
    for branch, run in zip(BRANCHES, runs, strict=True):
        done = run.stopped is None
        error = run.error(exact) if done else None
        line |= {
            f"{branch} error [rad]": error,
            f"{branch} / RK4": error / best if done else None,
            f"{branch} tilt [rad]": run.tilt if done else None,
            f"{branch} evaluations": run.evaluations if done else None,
            f"{branch} stopped by": run.stopped,
        }
    own, plain = (line[f"{branch} evaluations"] for branch in BRANCHES)
    return line | {"evaluations / paper": own / plain if own and plain else None}


def summary(rows: Sequence[Row], branch: str, change: float) -> Row:
    """A row of phases.csv: what all phases of one coordinate set, step and branch say together."""
    done = [line for line in rows if line[f"{branch} stopped by"] is None]
    calm = [line for line in done if line["RK4 error [rad]"] < CALM]
    error, there = (_column(among, f"{branch} error [rad]") for among in (done, calm))
    over, off = (_column(done, f"{branch} {what}") for what in ("/ RK4", "tilt [rad]"))
    return {
        "coordinates": rows[0]["coordinates"],
        "dt [s]": rows[0]["dt [s]"],
        "branch": branch,
        "phases": len(rows),
        "stopped": len(rows) - len(done),
        "RK4's worst error [rad]": _largest(_column(rows, "RK4 error [rad]")),
        "worst error [rad]": _largest(error),
        "median / RK4": float(np.median(over)) if done else None,
        "99 % within / RK4": float(np.quantile(over, 0.99)) if done else None,
        "worst / RK4": _largest(over),
        "above twice RK4": int((over > 2).sum()),
        f"RK4 below {CALM:g} rad": len(calm),
        "worst error there [rad]": _largest(there),
        f"above {CLOSE:g} rad there": int((there > CLOSE).sum()) if calm else None,
        "switches of branch": int(((error > LOST) | (off > TILT)).sum()),
        "largest tilt [rad]": _largest(off),
        **spent(rows, branch),
        "change of reference [rad]": change,
    }


def spent(rows: Sequence[Row], branch: str) -> Row:
    """Evaluations of the phases that neither branch stopped."""
    done = [line for line in rows if line["evaluations / paper"] is not None]
    if not done:
        return {}
    own, plain = (_column(done, f"{name} evaluations") for name in (branch, PAPER))
    steps = len(done) * round(PHASE_STOP / rows[0]["dt [s]"])
    return {
        "evaluations / step": float(own.sum() / steps),
        "evaluations / paper": float(own.sum() / plain.sum()),
        "evaluations / paper, worst phase": _largest(own / plain),
    }


def _column(rows: Sequence[Row], name: str) -> NDArray:
    return np.array([line[name] for line in rows], float)


def _largest(values: NDArray) -> float | None:
    return float(values.max()) if len(values) else None


def phase_plot(rows: Sequence[Row]) -> Figure:
    """Error against that of RK4, a point for each phase, a panel for each step."""
    figure = Figure(figsize=(13, 6), layout="constrained")
    for axes, dt in zip(figure.subplots(1, len(PHASE_STEPS)), PHASE_STEPS, strict=True):
        chosen = [line for line in rows if line["dt [s]"] == dt]
        ends = np.array([f([line["RK4 error [rad]"] for line in chosen]) for f in (min, max)]) * (0.7, 1.4)
        _cloud(axes, chosen, PAPER, "x", ["lightskyblue", "navajowhite"], 1.0)
        _cloud(axes, chosen, OWN, "o", ["C0", "C1"], 0.6)
        axes.plot(ends, 2 * ends, "k-", lw=1, label="twice RK4")
        axes.plot(ends, ends, "k:", lw=1, label="RK4")
        if ends[0] < CALM:
            axes.plot([ends[0], CALM, CALM], [CLOSE, CLOSE, ends[0]], "C3--", lw=1, label="target, left of it")
        axes.set(xlabel="error of RK4 on the exact equation [rad]", ylabel="largest angle error [rad]")
        axes.set(xscale="log", yscale="log", title=f"dt = {dt:g} s, {len(chosen) // len(PHASE_SETS)} phases")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="upper left")
    return figure


def _cloud(axes: Axes, rows: Sequence[Row], branch: str, mark: str, colours: Sequence[str], alpha: float) -> None:
    for coordinates, colour in zip(PHASE_SETS, colours, strict=True):
        points = [
            (line["RK4 error [rad]"], line[f"{branch} error [rad]"])
            for line in rows
            if line["coordinates"] == coordinates and line[f"{branch} error [rad]"]
        ]
        x, y = zip(*points, strict=True) if points else ((), ())
        axes.plot(x, y, mark, color=colour, ms=3, mew=0.6, alpha=alpha, label=f"{branch}, {coordinates}")


# Steps ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A driven linkage from its singular start."""

    torques: Mapping[str, float | Callable[[float], float]]
    mechanism: str = "four_bar"
    coordinates: str = "mixed"
    given: Mapping[str, float] = field(default_factory=dict)
    acceleration: Acceleration = field(default_factory=parallelogram)

    def torque(self) -> float | Callable[[float], float]:
        """The sum of all torques, which is what moves a parallelogram."""
        if any(map(callable, self.torques.values())):
            return lambda t: sum(x(t) if callable(x) else x for x in self.torques.values())
        return sum(self.torques.values())


def _swinging(t: float) -> float:
    return 4.0 * np.sin(3.0 * t)


CASES = {
    "4 N.m": Case({"A.torque": 4.0}),
    "4 N.m, joint coordinates": Case({"A.torque": 4.0}, coordinates="joint"),
    "massless coupler": Case({"A.torque": 4.0}, given={"m2": 0.0}, acceleration=parallelogram(m2=0.0)),
    "penalty 1e6 kg": Case({"A.torque": 4.0}, given={"solver.penalty": 1e6}),
    "penalty 1e12 kg": Case({"A.torque": 4.0}, given={"solver.penalty": 1e12}),
    "4 sin(3 t) N.m": Case({"A.torque": _swinging}),
    "five-bar, 4 N.m at A": Case({"A.torque": 4.0}, "five_bar", acceleration=parallelogram(m4=1.0)),
    "five-bar, 3 and -1 N.m at A and D": Case(
        {"A.torque": 3.0, "D.torque": -1.0}, "five_bar", acceleration=parallelogram(m4=1.0)
    ),
}

STEPS = (0.04, 0.02, 0.01, 0.005, 0.0025)
"""Steps of these runs [s]."""


def step_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Rows of steps.csv and orders.csv: errors over the step, and the orders that lines through them have."""
    kernel = kernels[-1]
    rows, orders = [], []
    for name, dt in tqdm(list(product(effort.cases, STEPS)), "steps", unit="step"):
        line = step_row(kernel, name, dt)
        last = rows[-1] if rows and rows[-1]["case"] == name else {}
        for way in ("RK4", *BRANCHES):
            before, after = last.get(f"{way} error [rad]"), line[f"{way} error [rad]"]
            if before and after and before <= LOST:
                line[f"{way} order"] = float(np.log(before / after) / np.log(last["dt [s]"] / dt))
        rows.append(line)
    for name in effort.cases:
        chosen = [line for line in rows if line["case"] == name]
        over = [line[f"{OWN} / RK4"] for line in chosen]
        fits = {f"{way} order": fitted(chosen, way) for way in ("RK4", *BRANCHES)}
        orders.append({"case": name, **fits, f"{OWN} / RK4, worst": None if None in over else max(over)})
    return {"orders": orders, "steps": rows}


@cache
def driven(acceleration: Acceleration, torque: float | Callable[[float], float], dt: float) -> Reference:
    """The motion of these runs, which some cases share."""
    return reference(acceleration, (0.0, DRIVEN_SPEED), torque, dt, round(DRIVEN_STOP / dt))


def step_row(kernel: str, name: str, dt: float) -> Row:
    """A row of steps.csv: one case with one step, by RK4 and by both branches."""
    case, steps = CASES[name], round(DRIVEN_STOP / dt)
    equations = scene(kernel, case.mechanism, coordinates=case.coordinates)
    motions = driven(case.acceleration, case.torque(), dt)
    line: Row = {"case": name, "dt [s]": dt, "RK4 error [rad]": motions.rk4_error}
    start = {"start.angle": 0.0, "start.angular_velocity": DRIVEN_SPEED}
    for branch in BRANCHES:
        run = drive(equations, {**start, **case.given, "solver.branch": branch}, case.torques, dt, steps)
        error = None if run.stopped else run.error(motions.exact[:, 0])
        line |= {
            f"{branch} error [rad]": error,
            f"{branch} / RK4": error / motions.rk4_error if error is not None else None,
            f"{branch} tilt [rad]": run.tilt,
            f"{branch} evaluations / step": run.evaluations / steps if error is not None else None,
            f"{branch} stopped by": run.stopped,
        }
    return line | {"change of reference [rad]": motions.change}


def fitted(rows: Sequence[Row], way: str) -> float | None:
    """Slope of the line through the errors over the step, both logarithmic, where the branch was kept."""
    points = [(dt, error) for dt, error in judged_steps(rows, way) if error <= LOST]
    return float(np.polyfit(*np.log(points).T, 1)[0]) if len(points) > 1 else None


def judged_steps(rows: Sequence[Row], way: str) -> list[tuple[float, float]]:
    """Steps [s] and errors [rad] of the runs that reached the end."""
    return [(line["dt [s]"], line[f"{way} error [rad]"]) for line in rows if line[f"{way} error [rad]"]]


def step_plot(rows: Sequence[Row]) -> Figure:
    """Errors against the step, a panel for each case, with the fitted orders."""
    names = list(dict.fromkeys(line["case"] for line in rows))
    figure = Figure(figsize=(16, 4.2 * -(-len(names) // 4)), layout="constrained")
    panels = figure.subplots(-(-len(names) // 4), min(4, len(names)), sharex=True, sharey=True, squeeze=False).ravel()
    for axes, name in zip(panels, names, strict=False):
        chosen = [line for line in rows if line["case"] == name]
        for way, style in (("RK4", "k:s"), (OWN, "C0-o"), (PAPER, "C1--x")):
            points = judged_steps(chosen, way)
            if points:
                slope = fitted(chosen, way)
                label = way if slope is None else f"{way}, order {slope:.2f}"
                axes.loglog(*zip(*points, strict=True), style, ms=4, lw=1.2, label=label)
        axes.set(title=name, xlabel="step [s]", ylabel="largest angle error [rad]")
        axes.set_xticks(STEPS, [f"{dt:g}" for dt in STEPS])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    return figure


# Rows of loops ----------------------------------------------------------------------------------------------------


def loop_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Rows of loops.csv: the N-four-bar through ten seconds of singular positions."""
    kernel = kernels[-1]
    cases = list(product(effort.rows, effort.loops))
    return {"loops": [loop_row(kernel, effort.long, *case) for case in tqdm(cases, "N-four-bar", unit="row")]}


def loop_row(kernel: str, stop: float, coordinates: str, loops: int) -> Row:
    """One N-four-bar: its first upper point, its energy, and its cranks beside each other."""
    dt, every = ROW_STEPS[coordinates], round(SAMPLE / ROW_STEPS[coordinates])
    motions = reference(row(loops), ROW_START, 0.0, dt, round(stop / dt))
    exact = motions.exact[::every, 0]
    line: Row = {"coordinates": coordinates, "N": loops, "dt [s]": dt}
    line |= {"RK4 error [rad]": motions.rk4_error, "change of reference [rad]": motions.change}
    given = {"start.angle": ROW_START[0], "start.angular_velocity": ROW_START[1]}
    given |= {"solver.step_size": dt, "g": GRAVITY}
    equations = scene(kernel, "n_four_bar", loops=loops, coordinates=coordinates)
    try:
        r = simulate(equations, stop, SAMPLE, parameters=given, kernel=kernel)
    except alfmu.AlfmuError as error:
        return line | {"stopped by": str(error)}
    cranks = np.array([r[f"crank{i}.angle"] for i in range(1, loops + 2)])
    energy = r["monitor.energy"]
    return line | {
        "first upper point [m]": float(2 * np.abs(np.sin((cranks[0] - exact) / 2)).max()),
        "energy / N [J]": float(np.abs(energy - energy[0]).max() / loops),
        "cranks apart [rad]": float(np.abs(np.sin(cranks - cranks[0])).max()),
        "evaluations / step": r.counters.evaluations / round(stop / dt),
    }


# The slider-crank -------------------------------------------------------------------------------------------------


def crank_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Rows of slider_crank.csv: with l1 = l2, which is singular with both links vertical, beside a regular one."""
    kernel = kernels[-1]
    steps, every = round(effort.long / CRANK_STEP), round(SAMPLE / CRANK_STEP)
    motions = {l1: reference(slider_crank(l1, ROD), CRANK_START, 0.0, CRANK_STEP, steps) for l1 in (ROD, SHORT)}
    rows = []
    for coordinates in tqdm(effort.cranks, "slider-crank", unit="set"):
        equations = scene(kernel, "slider_crank", coordinates=coordinates)
        line: Row = {"coordinates": coordinates, "dt [s]": CRANK_STEP}
        for l1, known in motions.items():
            line |= crank_run(equations, kernel, effort.long, l1, known.exact[::every, 0])
            line |= {f"l1 = {l1:g} m: RK4 error [rad]": known.rk4_error}
            line |= {f"l1 = {l1:g} m: change of reference [rad]": known.change}
        own, regular = (line.get(f"l1 = {l1:g} m: error [rad]") for l1 in motions)
        if own is not None and regular is not None:
            line[f"error / that of {SHORT:g} m or {GOOD:g} rad"] = own / max(regular, GOOD)
        rows.append(line)
    return {"slider_crank": rows}


def crank_run(equations: alfmu.Equations, kernel: str, stop: float, l1: float, exact: NDArray) -> Row:
    """What a row of slider_crank.csv says of one length of the crank."""
    given = {"l1": l1, "l2": ROD, "start.angle": CRANK_START[0], "start.angular_velocity": CRANK_START[1]}
    given |= {"solver.step_size": CRANK_STEP, "g": GRAVITY}
    try:
        r = simulate(equations, stop, SAMPLE, parameters=given, kernel=kernel)
    except alfmu.AlfmuError as error:
        return {f"l1 = {l1:g} m: stopped by": str(error)}
    energy = r["monitor.energy"]
    return {
        f"l1 = {l1:g} m: error [rad]": float(np.abs(r["crank.angle"] - exact).max()),
        f"l1 = {l1:g} m: energy [J]": float(np.abs(energy - energy[0]).max()),
        f"l1 = {l1:g} m: evaluations / step": r.counters.evaluations / round(stop / CRANK_STEP),
    }


# Targets ----------------------------------------------------------------------------------------------------------

QUICK = Effort(40, ("4 N.m", "4 N.m, joint coordinates"), loops=(2,), rows=("natural",), cranks=("joint",), long=3.0)
USUAL = Effort(1000, tuple(CASES), loops=(2, 10, 40), rows=tuple(ROW_STEPS), cranks=CRANK_SETS, long=10.0)

PHASE_LIMITS = {
    "worst error there [rad]": CLOSE,
    "switches of branch": 0,
    "stopped": 0,
    "evaluations / paper": 1.1,
    "evaluations / paper, worst phase": 1.1,
}
ROW_LIMITS = {"first upper point [m]": 1e-8, "energy / N [J]": 1e-7, "cranks apart [rad]": 1e-8}
TARGETS = (
    *(
        Target("phases", {"coordinates": coordinates, "dt [s]": dt, "branch": OWN}, column, limit)
        for dt, coordinates in product(PHASE_STEPS, PHASE_SETS)
        for column, limit in PHASE_LIMITS.items()
    ),
    *(Target("orders", {"case": name}, f"{OWN} order", 3.8, at_least=True) for name in CASES),
    *(Target("orders", {"case": name}, f"{OWN} / RK4, worst", 2) for name in CASES),
    *(
        Target("loops", {"coordinates": coordinates, "N": loops}, column, limit)
        for coordinates, loops in product(USUAL.rows, USUAL.loops)
        for column, limit in ROW_LIMITS.items()
    ),
    *(
        Target("slider_crank", {"coordinates": coordinates}, f"error / that of {SHORT:g} m or {GOOD:g} rad", 1)
        for coordinates in CRANK_SETS
    ),
)


# The report -------------------------------------------------------------------------------------------------------

CHAPTERS = {
    "phases": (
        "Phases",
        f"""The four-bar from random starting angles (seed {SEED}) under {", ".join(f"{x:g}" for x in TORQUES)} N.m at A
        in turn, from {", ".join(f"{x:g}" for x in SPEEDS)} rad/s in turn, for {PHASE_STOP:g} s. A run has switched its
        branch where its angle errs by more than {LOST:g} rad, or links that should be parallel differ by more than
        {TILT:g} rad. Evaluations over those of `paper` are of all phases together, and of the worst one. Single phases
        stand in `phase_runs.csv`.""",
    ),
    "hardest": (
        "The hardest phases",
        "Those with the largest error over that of RK4, or that stopped, of each coordinate set and step.",
    ),
    "orders": (
        "Steps",
        f"""Linkages from exactly 0, a singular position, with {DRIVEN_SPEED:g} rad/s for {DRIVEN_STOP:g} s, with steps
        from {max(STEPS):g} to {min(STEPS):g} s. Orders are slopes of lines through all errors up to {LOST:g} rad; above
        that the branch is lost, and its errors follow no power of the step.""",
    ),
    "steps": (
        "Step by step",
        f"Orders are those between a step and the one above it, unless that erred by more than {LOST:g} rad.",
    ),
    "loops": (
        "Rows of loops",
        f"""The N-four-bar (IFToMM A02) under gravity for {USUAL.long:g} s ({QUICK.long:g} s by `--quick`): the distance
        of its first upper point from the exact one, the change of its energy over N, and the angle between its cranks,
        every {SAMPLE:g} s. Evaluations include those for outputs.""",
    ),
    "slider_crank": (
        "The slider-crank of equal links",
        f"""A slider-crank with a rod of {ROD:g} m from rest at pi/4 under gravity, for the same time. With a crank of
        the same length it is singular with both links vertical, and the rod mirrors the crank; with one of {SHORT:g} m
        it is regular. Evaluations include those for outputs.""",
    ),
}

PICTURES = {
    "phases": ("phase_runs", phase_plot, "Error of every phase against that of RK4"),
    "steps": ("steps", step_plot, "Error against the step"),
}
"""Of CSV files, by name: whose rows, drawn how, and what they show."""

LIMITS = """
- The reference is the motion on the parallelogram, or of the mirrored rod. It judges how well a run stays on that
  branch, not which one a real linkage with play and flexibility would take.
- RK4 on the equation of one degree of freedom is a measure, not a rival: nothing else knows that equation. In
  coordinates where the motion is a straight line, such as joint ones, RK4 on the constrained equations errs as it does;
  in others it errs more, at regular positions too.
- Near the edge between swinging and turning over, a motion magnifies errors of any origin. Ratios to RK4 allow for that
  in part alone, as its own error may be small there by chance.
- Evaluations of steps that were tried in more than one way are counted from below: the first try and the last.
- Worst cases are those of the phases that were drawn; more phases can only find worse ones.
"""


STUDIES = {"phases": phase_study, "steps": step_study, "loops": loop_study, "slider-crank": crank_study}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the command line asks for."""
    return Report(
        "singular",
        "singular_study.py",
        "Through singular positions under drive",
        "Measure how mechanisms pass their singular positions under drive. Errors are the largest of a whole run, "
        "against the exact motion on the branch that is followed. RK4 is that of the exact equation of one degree of "
        "freedom with the same step. `continue` and `paper` are values of `solver.branch`; `change of reference` is "
        "the change of the exact motion with half the steps.",
        STUDIES,
        {"": USUAL, "quick": QUICK},
        CHAPTERS,
        TARGETS,
        PICTURES,
        LIMITS,
    ).main(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
