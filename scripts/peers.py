"""Error against run time of alfmu and of what else a Python user might take, on two closed-loop mechanisms.

A run lasts 20 s of simulated time and delivers, every 0.02 s, the angle of the first link and the forces of all joints;
its error is the largest difference of that angle from the exact motion. `alfmu.studies.peers` describes the mechanisms;
the five-bar starts in a singular position and passes many.
"""

from __future__ import annotations

import os

# One thread for everyone; BLAS reads these when NumPy is loaded.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMEXPR_NUM_THREADS="1")

import math
import random
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
from _study import Report, Results
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.linalg.lapack import dgelsy
from tqdm import tqdm

import alfmu
from alfmu.equations.specialisation import specialised
from alfmu.simulation import prepared, with_defaults
from alfmu.studies import reference as exact
from alfmu.studies.peers import (
    ANGLE,
    MECHANISMS,
    REACTIONS,
    TUNED,
    Peer,
    Pinocchio,
    Simulation,
    Start,
    Trajectory,
    solved,
)
from alfmu.studies.tables import Row, rounded

RATE = 2.0
"""Start of both mechanisms: angle 0 with this rate [rad/s]."""

STOP, SAMPLE = 20.0, 0.02
"""Simulated time and distance of samples [s]."""

TARGETS = (1e-6, 1e-9)
"""Angle errors [rad] at which run times are compared."""

RATIOS = {"compiled": 10.0, "vm": 4.0}
"""How many times slower the best peer is wanted to be than the fastest setting of alfmu with all outputs, by kernel."""

LOST = 0.1
"""Angle error [rad] from which a run counts as having lost the motion."""

ROUNDS, LEAST, BUDGET = 12, 3, 2.0
"""Timed rounds; each point takes part in the first few, and in more until it has used so much time [s]."""

SEED = 1
"""Of the order within each round, so that load from outside does not always meet the same peer."""


def samples(stop_time: float) -> NDArray:
    """0, 0.02, ... stop_time [s]."""
    return np.arange(round(stop_time / SAMPLE) + 1) * SAMPLE


# The exact motion -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reference:
    """Exact motion and reactions of a mechanism by `studies.reference`, and how exact that is."""

    angle: NDArray
    """(k,) at the samples, rad"""
    reactions: NDArray
    """(k, number of REACTIONS), N; NaN where they are not unique, and near a singular position"""
    change: float
    """Largest change of the angle between two ways to compute it, rad."""
    energy: float
    """Largest change of the energy [J]."""


def reference(mechanism: str, stop_time: float) -> Reference:
    """The motion from the start until stop_time [s]."""
    equations = alfmu.derive(alfmu.load(mechanism))
    instance, times = begun(prepared(equations, "oracle"), Start(0.0, RATE), {}), samples(stop_time)
    instance.initialize()
    known = exact.reference(instance, stop_time, exact.Effort(parts=100, seconds=300.0))
    names = [variable.name for variable in instance.equations.outputs]
    angle, table = names.index(ANGLE[mechanism]), known.outputs(times)
    table[~known.readable(times)[:, None] & (np.arange(len(names)) != angle)] = np.nan
    table[:, [names.index(x) for x in instance.equations.survey.shared or ()]] = np.nan
    reactions = table[:, [names.index(x) for x in REACTIONS[mechanism]]]
    change = max(np.abs(other[:, angle] - table[:, angle]).max() for _, other in known.checks(times))
    return Reference(table[:, angle], reactions, float(change), float(np.ptp(known.energies(times))))


# Peers ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Alfmu(Peer):
    """The library's `Instance`, whose `run` makes a whole run, start and outputs included, in one call.

    `step` is `solver.step_size` [s], or `solver.relative_tolerance`; all other settings are the defaults.
    """

    kernel: str = "compiled"
    joint: bool = False
    """In the coordinates of the joints and with constant parameters, as Pinocchio and MuJoCo are."""
    lean: bool = False
    """With the outputs that are wanted alone."""
    method: str = "rk4"
    """`solver.method`"""

    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        variable = "solver.relative_tolerance" if self.control == "rtol" else "solver.step_size"
        equations = _equations(mechanism, self.kernel, self.joint, self.lean, self.method)
        instance = begun(equations, start, {variable: step})
        names, inputs = [v.name for v in instance.outputs], np.empty((len(times), 0))
        columns = [names.index(name) for name in (ANGLE[mechanism], *REACTIONS[mechanism])]

        def simulate() -> Trajectory:
            rows, ended = instance.run(times, (), inputs, names)
            if ended is not None:
                raise ended
            return Trajectory(times, rows[:, columns[0]], rows[:, columns[1:]])

        return simulate


def begun(equations: alfmu.Equations, start: Start, values: Mapping[str, float]) -> alfmu.Instance:
    """An instance that can be initialised at a start, with these values of variables."""
    instance = alfmu.Instance(equations)
    for name, value in {"start.angle": start.angle, "start.angular_velocity": start.rate, **values}.items():
        instance.set(name, value)
    return instance


@cache
def _equations(mechanism: str, kernel: str, joint: bool, lean: bool, method: str) -> alfmu.Equations:
    """Derived, traced and compiled once; so the first point of a setting has the set-up time."""
    options = {"coordinates": "joint"} if joint else {}
    equations = with_defaults(alfmu.derive(alfmu.load(mechanism, **options)), {"solver.method": method})
    outputs = [ANGLE[mechanism], *REACTIONS[mechanism]] if lean else None
    equations = specialised(equations, outputs, ["all"] if joint else None)
    return prepared(equations, kernel)


@dataclass(frozen=True)
class SciPy(Peer):
    """`solve_ivp` on alfmu's M, C, f, xi, Phi in the index-1 form (9), by elimination of a and least squares."""

    method: str = "DOP853"

    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        five = mechanism == "five_bar"
        omega, cut, options = (15.0, 1e-4, {}) if five else (6.0, 1e-12, {"coordinates": "joint"})
        e = alfmu.derive(alfmu.load(mechanism, **options))
        instance, n, l = begun(e, start, {}), e.n, e.l
        instance.initialize()
        begin, p, u = np.concatenate([instance.q, instance.v]), instance.values[: len(e.parameters)], instance.inputs
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        C, inverse = e.C(q, p), ca.inv(e.M(q, p))
        free, pull = inverse @ (e.f(q, v, u, p, 0) - e.d(q, v, p)), inverse @ C.T
        xi = e.xi(q, v, p) - 2 * omega * C @ v - omega**2 * e.Phi(q, p)
        results = [ca.densify(x) for x in (C @ pull, C @ free - xi, free, pull)]
        terms = Terms(ca.Function("terms", [q, v], results, {"cse": True}))
        (y_q, y_v), (S, r, free, pull) = terms.arguments, terms.results
        r, free, work = r[:, 0], free[:, 0], 16 * l + 64

        def solve(y: NDArray) -> tuple[NDArray, NDArray]:
            """(9): C M^-1 C' lambda = C M^-1 (f - d) - xi of least norm, a = M^-1 (f - d - C' lambda)."""
            y_q[:, 0], y_v[:, 0] = y[:n], y[n:]
            terms.evaluate()
            lam = dgelsy(S, r, np.zeros(l, np.int32), cut, work)[1]
            return free - pull @ lam, lam

        def rate(y: NDArray) -> NDArray:
            return np.concatenate([y[n:], solve(y)[0]])

        names = [variable.name for variable in e.outputs]
        columns = [names.index(name) for name in (ANGLE[mechanism], *REACTIONS[mechanism])]

        def simulate() -> Trajectory:
            states = solved(rate, begin, self.method, step, times)
            a, lam = (np.array(x).T for x in zip(*map(solve, states), strict=True))
            Q, V, P, U = states[:, :n].T, states[:, n:].T, *(np.tile(x[:, None], len(states)) for x in (p, u))
            seen = np.array(e.readings(Q, V, a, lam, U, P, np.zeros((1, len(states)))))[columns].T
            return Trajectory(times[: len(states)], seen[:, 0], seen[:, 1:])

        return simulate


class Terms:
    """A CasADi function whose arguments and results are arrays that stay where they are."""

    def __init__(self, f: ca.Function):
        self.buffer, self.evaluate = f.buffer()  # the memory of evaluate lives as long as the buffer
        self.arguments = [np.zeros(f.size_in(i), order="F") for i in range(f.n_in())]
        self.results = [np.zeros(f.size_out(i), order="F") for i in range(f.n_out())]
        for tie, arrays in ((self.buffer.set_arg, self.arguments), (self.buffer.set_res, self.results)):
            for i, x in enumerate(arrays):
                tie(i, memoryview(x.reshape(-1, order="F")))


def peers() -> list[Peer]:
    """All that is compared, each in the best of the settings that were tried (USAGE)."""
    rtols = dict.fromkeys(MECHANISMS, (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11))
    fine = dict.fromkeys(MECHANISMS, tuple(SAMPLE / k for k in (1, 2, 3, 4, 8, 16, 32)))
    coarse = dict.fromkeys(MECHANISMS, (SAMPLE, SAMPLE / 2))
    tight = {"five_bar": (1e-7, 1e-8, 1e-9, 1e-11), "slider_crank": (1e-6, 1e-7, 1e-8, 1e-9, 1e-11)}
    own: list[Peer] = []
    order8: dict[str, Any] = {"joint": True, "method": "order8"}
    for kernel in RATIOS:
        own += [
            Alfmu("alfmu", "alfmu", kernel, fine, quick=4, kernel=kernel),
            Alfmu("alfmu", "alfmu", f"{kernel}, joint", fine, quick=4, kernel=kernel, joint=True),
            Alfmu("alfmu", "alfmu", f"{kernel}, joint, lean", fine, quick=4, kernel=kernel, joint=True, lean=True),
            Alfmu("alfmu", "alfmu", f"{kernel}, joint, order8", coarse, quick=1, kernel=kernel, **order8),
            Alfmu("alfmu", "alfmu", f"{kernel}, auto", rtols, "rtol", 2, kernel=kernel, method="auto"),
        ]
    return [
        *own,
        *(replace(peer, steps=finer(peer)) for peer in TUNED),
        SciPy("scipy", "SciPy", "DOP853", rtols, "rtol", 3),
        SciPy("scipy", "SciPy", "RK45", tight, "rtol", 0, method="RK45"),
        SciPy("scipy", "SciPy", "LSODA", tight, "rtol", 0, method="LSODA"),
    ]


def finer(peer: Peer) -> Mapping[str, Sequence[float]]:
    """The steps or tolerances of a peer, and where it can come to the last target those that take it there."""
    if not isinstance(peer, Pinocchio) or not peer.omega:
        return peer.steps
    more = (1e-11, 1e-12) if peer.control == "rtol" else (SAMPLE / 32, SAMPLE / 64)
    return {name: (*steps, *(x for x in more if x < min(steps))) for name, steps in peer.steps.items()}


# Study ------------------------------------------------------------------------------------------------------------


@dataclass
class Point:
    """One peer on one mechanism with one step: a row of the results."""

    peer: Peer
    mechanism: str
    step: float
    error: float | None = None
    """Largest angle error [rad]."""
    force_error: float | None = None
    """Largest error of the reactions that are unique [N]."""
    seconds: list[float] = field(default_factory=list)
    """Run time in each round, of the processor [s]."""
    setup: float | None = None
    """Time to build the model [s]."""
    note: str = ""
    simulate: Simulation | None = None

    @property
    def median(self) -> float | None:
        return statistics.median(self.seconds) if self.seconds else None


def chosen_points(quick: bool) -> list[Point]:
    """All points of what is installed, or few of each setting."""
    return [
        Point(peer, mechanism, step)
        for mechanism in MECHANISMS
        for peer in peers()
        if peer.installed
        for step in peer.steps[mechanism][: peer.quick if quick else None]
    ]


def judge(point: Point, motion: Reference, times: NDArray) -> None:
    """Errors of one run, which is not timed; what does not reach the end with the motion is not timed at all."""
    try:
        begin = time.perf_counter()
        simulate = point.peer.build(point.mechanism, Start(0.0, RATE), point.step, times)
        point.setup = time.perf_counter() - begin
        with np.errstate(all="ignore"):
            run = simulate()
    except Exception as error:  # a lost run is a result
        point.note = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        return
    k = len(run.times)
    if not np.allclose(run.times, times[:k], rtol=0, atol=1e-9):
        raise ValueError(f"{point.peer.name}, {point.peer.setting}: samples at other times than asked for")
    gaps = np.abs(run.angle - motion.angle[:k])
    far = np.flatnonzero(~(gaps <= LOST))
    if len(far):
        point.note = f"lost the motion at t = {times[far[0]]:.3g} s"
    elif k < len(times):
        point.note = f"stopped at t = {times[max(k - 1, 0)]:.3g} s"
    else:
        gap = np.abs(run.reactions - motion.reactions)
        point.error, point.force_error, point.simulate = float(gaps.max()), float(np.nanmax(gap)), simulate
    point.note = "; ".join(filter(None, (point.note, run.note)))


def clock(points: Sequence[Point], rounds: int) -> None:
    """Time every point that has the motion, in rounds of random order.

    By the time of the processor, all threads together, so that what else the machine does counts little.
    """
    order, ready = random.Random(SEED), [point for point in points if point.simulate]
    for k in tqdm(range(rounds), "timing", unit="round"):
        turn = [point for point in ready if k < LEAST or sum(point.seconds) < BUDGET]
        for point in order.sample(turn, len(turn)):
            begin = time.process_time()
            point.simulate()
            point.seconds.append(time.process_time() - begin)


@dataclass
class Reach:
    """What one setting takes to come to the target error on one mechanism."""

    points: list[Point]
    """From coarse to fine."""
    target: float
    """[rad]"""
    seconds: list[float] = field(default_factory=list)
    """Run time in each round [s]; empty where the target is not reached."""
    force_error: float | None = None
    """Error of the reactions at the finer of the two points [N]."""
    text: str = ""
    """The run time, or why there is none."""

    def __post_init__(self) -> None:
        """By log-log interpolation between neighbouring points, round by round."""
        known = [p for p in self.points if p.seconds]
        if not known:
            self.text = f"not reached ({self.points[-1].note})"
            return
        self.text = f"not reached (best {min(p.error for p in known):.2g} rad)"
        for p, finer in zip([known[0], *known], known, strict=False):
            if finer.error <= self.target:
                share = math.log(p.error / self.target) / math.log(p.error / finer.error) if p is not finer else 0.0
                self.seconds = [a * (b / a) ** share for a, b in zip(p.seconds, finer.seconds, strict=False)]
                self.force_error = finer.force_error
                self.text = "<= " * (p is finer) + rounded(self.median)
                return

    @property
    def wanted(self) -> float | None:
        """The ratio that is wanted of a setting of alfmu that reads all outputs."""
        peer = self.points[0].peer
        return RATIOS[peer.kernel] if isinstance(peer, Alfmu) and not peer.lean else None

    @property
    def name(self) -> tuple[str, str]:
        return self.points[0].peer.name, self.points[0].peer.setting

    @property
    def median(self) -> float:
        return statistics.median(self.seconds) if self.seconds else math.inf

    def ratios(self, other: Reach) -> list[float]:
        """Run time over that of the other, in each round that both took part in."""
        return [a / b for a, b in zip(self.seconds, other.seconds, strict=False)]


def reaches(points: Sequence[Point], mechanism: str, target: float) -> list[Reach]:
    """The settings of one mechanism, and how they come to a target [rad]."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        if point.mechanism == mechanism:
            groups.setdefault((point.peer.name, point.peer.setting), []).append(point)
    return [Reach(group, target) for group in groups.values()]


# Report -----------------------------------------------------------------------------------------------------------

USAGE = {
    "alfmu": "Library `Instance`, a whole run in one call of its method `run`; all outputs are read at each sample. "
    "`solver.method` is `rk4` with `solver.step_size`; `order8`: that method; `auto`: the default, with "
    "`solver.relative_tolerance`. `joint`: the coordinates are those of the joints and parameters are frozen "
    "(defaults: mixed and absolute, none). `lean`: `outputs` are those that are compared.",
    "Pinocchio": "Minimal tree and two (one) loop closures, `constraintDynamics` with mu = 1e-8 and 3 proximal "
    "iterations on preallocated data; RK4 in NumPy or `solve_ivp`. Tried: mu 1e-4 to 1e-12, 1 to 50 iterations, "
    "Baumgarte from 0 to 200 1/s (five-bar 60, slider-crank 5), projection instead (slower), `lcaba` (slower).",
    "Exudyn": "Its solvers on rigid bodies with joints, files off, build without range checks. Tried: spectral radius "
    "0.5 to 1, index 2 and 3, all linear solvers, Newton tolerances 1e-6 to 1e-10. The redundant constraint needs "
    "EigenDense with `ignoreSingularJacobian`. Explicit solvers refuse joints; all methods used are of order 2.",
    "MuJoCo": "Pinocchio's tree with `connect`; constraints are soft by design, here as hard as possible: solimp "
    "0.9999, solref with stiffness c / step^2 and critical damping, refsafe off. Tried: c from 0.01 to 4 (RK4: "
    "five-bar 2, slider-crank 0.2), 1 to 50 iterations, implicit integrators (order 1).",
    "SciPy": "alfmu's terms in one CasADi function, a eliminated from (9), multipliers of least norm by LAPACK gelsy "
    "(cut-off 1e-4 on the five-bar), Baumgarte with 15 and 6 1/s (from 0 to 200 tried), joint coordinates of the "
    "slider-crank.",
}

LIMITS = """\
Run times are those of small mechanisms called from Python on a shared machine; only ratios within one run mean
something. alfmu is measured as a library that makes a whole run in one call, as Exudyn does; through an FMU every step
costs more. alfmu's compiled kernel, Exudyn and MuJoCo step in compiled code, its vm kernel in the runtime's
interpreter; Pinocchio evaluates in compiled code and is stepped in Python (a loop in C++ would spare it that), SciPy
is Python but for the terms of the equations. All use one thread. Pinocchio and MuJoCo describe the five-bar by joint
angles, in which its parallelogram is a straight line that no stage leaves, and so do alfmu's settings named `joint`;
alfmu by default, Exudyn and SciPy by coordinates of torn-off bodies. The peers were tuned to these two motions with
the exact ones at hand; alfmu's choices are its coordinates and its integrator. Other mechanisms need the tuning again.
Time is taken at equal error of the angle; the reactions there differ in accuracy (see their column): MuJoCo's belong
to slightly soft constraints, Exudyn's to the tolerance of Newton's method. Errors of reactions are taken at equal
times and so contain those of the motion, and only what rigid bodies determine is compared. Steps that do not divide
0.02 s were not run, and some points are luckier than their neighbours."""


def point_row(p: Point) -> Row:
    """A point as a row."""
    return {
        "mechanism": p.mechanism,
        "code": p.peer.name,
        "setting": p.peer.setting,
        "control": p.peer.control,
        "step": p.step,
        "angle error [rad]": p.error,
        "reaction error [N]": p.force_error,
        "median [s]": p.median,
        "least [s]": min(p.seconds, default=None),
        "most [s]": max(p.seconds, default=None),
        "repeats": len(p.seconds),
        "set-up [s]": p.setup,
        "note": p.note,
    }


def reach_rows(points: Sequence[Point], mechanism: str) -> list[Row]:
    """Run times at the targets, and the ratios to those alfmu settings that reach them."""
    rows: list[Row] = []
    for target in TARGETS:
        found = reaches(points, mechanism, target)
        own = [r for r in found if r.name[0] == "alfmu"]
        for r in found:
            row = {"mechanism": mechanism, "target [rad]": target, "code": r.name[0], "setting": r.name[1]}
            row |= {"time at target [s]": r.text, "median [s]": r.median if r.seconds else None}
            row |= {"reaction error [N]": r.force_error}
            ratios = {a.name[1]: r.ratios(a) for a in own}
            rows.append(row | {f"ratio to {name}": statistics.median(x) if x else None for name, x in ratios.items()})
    missing = dict.fromkeys(peer.name for peer in peers() if not peer.installed)
    empty = {**dict.fromkeys(rows[0]), "mechanism": mechanism, "time at target [s]": "not installed"}
    return [*rows, *({**empty, "code": name, "setting": ""} for name in missing)]


def verdict_rows(points: Sequence[Point]) -> list[Row]:
    """alfmu against the best peer at the targets: ratio by medians of the rounds, its range.

    What is wanted is wanted of the fastest setting of each kernel that reads all outputs.
    """
    rows = []
    for mechanism, target in product(MECHANISMS, TARGETS):
        found = [r for r in reaches(points, mechanism, target) if r.seconds]
        best = min((r for r in found if r.name[0] != "alfmu"), key=lambda r: r.median, default=None)
        fastest: dict[float, Reach] = {}
        for r in sorted(found, key=lambda r: -r.median):
            if r.wanted:
                fastest[r.wanted] = r
        for own in [r for r in found if r.name[0] == "alfmu"] if best else []:
            ratios = best.ratios(own)
            ratio = statistics.median(ratios)
            row = {"mechanism": mechanism, "error [rad]": target, "alfmu": own.name[1], "time [s]": own.text}
            row |= {"best peer": ", ".join(best.name), "its time [s]": best.text}
            row |= {"ratio": ratio, "from": min(ratios), "to": max(ratios), "rounds": len(ratios)}
            verdict = None
            if own in fastest.values():
                verdict = f"{own.wanted:g}: {'met' if ratio >= own.wanted else 'not met'}"
            rows.append(row | {"wanted": verdict})
    return rows


def picture(points: Sequence[Point]) -> Figure:
    """Error against run time, one panel for each mechanism, one colour for each code."""
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    colours = dict(zip(USAGE, ("#c0523a", "#3b75af", "#3f9268", "#d98c1f", "#7a66b0"), strict=True))
    for axes, mechanism in zip(figure.subplots(1, 2, sharex=True, sharey=True), MECHANISMS, strict=True):
        count = dict.fromkeys(colours, 0)
        for r in reaches(points, mechanism, TARGETS[0]):
            known, (name, setting) = [p for p in r.points if p.seconds], r.name
            style = ("o-", "s--", "^:", "d-.", "v-", "p--", "*:", "x-.")[count[name] % 8]
            count[name] += 1
            if known:
                x, y = [p.median for p in known], [p.error for p in known]
                axes.loglog(x, y, style, color=colours[name], markersize=4, linewidth=1.2, label=f"{name}: {setting}")
        for target in TARGETS:
            axes.axhline(target, color="0.4", linewidth=0.8)
        axes.set(title=mechanism, xlabel="run time, median [s]")
        axes.grid(True, which="major", linewidth=0.4)
        axes.label_outer()
    lines = {label: line for axes in figure.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(lines.values(), lines.keys(), loc="outside right upper", fontsize=8)
    figure.axes[0].set_ylabel("largest error of the angle [rad]")
    return figure


def study(points: Sequence[Point], rounds: int) -> Results:
    """Rows of all files: errors first, then run times in rounds."""
    times, references = samples(STOP), {mechanism: reference(mechanism, STOP) for mechanism in MECHANISMS}
    for point in tqdm(points, "errors", unit="run"):
        judge(point, references[point.mechanism], times)
    clock(points, rounds)
    about = [{"mechanism": name, "change [rad]": r.change, "energy [J]": r.energy} for name, r in references.items()]
    reached = [row for mechanism in MECHANISMS for row in reach_rows(points, mechanism)]
    results = {"peers_verdicts": verdict_rows(points), "peers_reach": reached, "peers": [point_row(p) for p in points]}
    return {**results, "peers_reference": about, "peers_usage": [{"code": x, "use": y} for x, y in USAGE.items()]}


CHAPTERS = {
    "peers_verdicts": (
        f"Run time at {' and '.join(f'{x:g}' for x in TARGETS)} rad: alfmu against the best peer",
        """The ratio is the median over the rounds that both took part in, `from` and `to` are its least and largest
        value. Interpolated on log-log scales between the two neighbouring points; `<=` where the coarsest point is
        already below. A ratio above 1 means that alfmu is faster. A ratio is wanted of the fastest setting of each
        kernel that reads all outputs.""",
    ),
    "peers_reach": ("Run times at equal error", ""),
    "peers": (
        "All points",
        f"""Each point ran once for its errors and then in timed rounds of random order: in at least {LEAST}, in more
        until it had used {BUDGET:g} s. Building the model is timed apart; at its first point alfmu derives and traces,
        and compiles or finds the library in its cache. `rtol`: adaptive steps, those of the peers with absolute
        tolerances as large.""",
    ),
    "peers_reference": ("The exact motion", "From `alfmu.studies.reference`; the change is that to its other ways."),
    "peers_usage": ("How each is used", ""),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what the command line asks for."""
    points: list[Point] = []

    def run(quick: bool, _: Sequence[str]) -> Results:
        points[:] = chosen_points(quick)
        return study(points, LEAST if quick else ROUNDS)

    return Report(
        "peers",
        "peers.py",
        "Peers: error against run time",
        f"Measure error against run time of alfmu, Pinocchio, Exudyn, MuJoCo and SciPy, as far as they are installed, "
        f"on the five-bar and the slider-crank: {STOP:g} s from angle 0 with {RATE:g} rad/s under gravity; angle and "
        f"all joint forces every {SAMPLE:g} s. Errors are the largest over the run; times are those of the processor.",
        {"peers": run},
        {"": False, "quick": True},
        CHAPTERS,
        pictures={"peers": ("peers", lambda _: picture(points), "error against run time")},
        limits=LIMITS,
        packages=list(dict.fromkeys([*(peer.package for peer in peers()), "casadi", "numpy"])),
        takes="ten minutes, or one with --quick",
    ).main(arguments)


if __name__ == "__main__":
    raise SystemExit(main())
