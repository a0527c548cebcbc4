"""Reproduction of the study of Blajer (2002): results of the paper and of alfmu, as chapters of a report.

W. Blajer, "Augmented Lagrangian Formulation: Geometrical Interpretation and Application to Systems with Singularities
and Redundancy", Multibody System Dynamics 8 (2002) 141-159. Equation numbers are the paper's.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

from ..catalogue.registry import load
from ..equations import Equations
from ..equations.derivation import derive
from ..equations.interface import Counters
from ..model.errors import StepError, needs
from ..model.settings import Settings
from ..simulation.oracle import Instance
from ..view.plot import require, save
from .tables import Row, number, paragraph, shown, write_csv

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GRAVITY = 9.81
RATE = 2.0
"""Start of all linkages: th = 0, a singular position, with this rate [rad/s]."""

DT, ALPHA = 0.02, 1e6
"""Settings of the paper's five-bar run: step [s], penalty [kg]."""

TORQUE, DRIVEN_STEPS, PAPER_MOST = 4.0, (0.02, 0.01, 0.005), 5
"""Settings of the four-bar run: torque on link 1 [N m], steps [s], the paper's limit of iterations (8)."""

LUCK = 0.1
"""Range of start angles of the four-bar [rad], either way, that average whether steps hit a singular position."""

TOLERANCES, LIMIT = (1e-8, 1e-12, 1e-15), 50
"""Tolerances of (8) whose iterations are counted, and the limit of the count."""

RATIOS = tuple(10.0**k for k in range(2, 15, 2))
"""Penalties over mass in the accuracy study."""

DIGITS = 60

CLASSIC = Settings(step_size=DT, penalty=ALPHA, formulation="classic", method="rk4")
DEFAULT = Settings(step_size=DT, method="rk4")

ROWS = range(1, 9)
ACCELERATIONS = (
    *("link1.angular_acceleration", "link2.ax", "link2.ay", "link2.angular_acceleration"),
    *("link3.angular_acceleration", "link4.ax", "link4.ay", "link4.angular_acceleration"),
)
"""Accelerations of q = [th1 x2 y2 th2 th3 x4 y4 th4]."""

COLOURS = {"reference": "0.25", "classic": "C1", "residual": "C0"}


@dataclass(frozen=True)
class Effort:
    """Extent of the study."""

    stop: float = 20.0
    """Simulated time of the five-bar [s]; the default is the paper's."""
    counted: float = 20.0
    """Simulated time in which iterations are counted [s]."""
    driven: float = 5.0
    """Simulated time of the four-bar [s]."""
    phases: int = 40
    """Number of start angles of the four-bar, evenly distributed over LUCK."""
    states: int = 20
    """Number of states of the accuracy study, evenly distributed over th from -pi to 0, away from
    singular positions."""
    ratios: Sequence[float] = RATIOS
    """Penalties over mass of the accuracy study."""


USUAL = Effort()
SHORT = Effort(stop=5.0, counted=1.0, phases=6, states=4)
QUICK = Effort(stop=2.0, counted=1.0, driven=2.0, phases=4, states=2, ratios=RATIOS[::3])


# Results ----------------------------------------------------------------------------------------------------------


@dataclass
class Table:
    """Rows of one CSV file; if `title` is None, the report names the file without listing its rows."""

    name: str
    title: str | None
    rows: Sequence[Row]
    """At least one; all have the same columns."""
    digits: int = 3

    def markdown(self) -> str:
        """Return the rounded rows with their source; the source alone if there is no title."""
        if self.title is None:
            return f"All values: `{self.name}.csv`."
        return shown(self.title, self.name, list(self.rows[0]), self.rows, self.digits)


@dataclass
class Chapter:
    """One part of the study: text without numbers, tables, pictures by file name."""

    title: str
    text: str
    tables: list[Table]
    pictures: dict[str, Figure] = field(default_factory=dict)

    def write(self, folder: Path) -> None:
        """Write the CSV files and the pictures."""
        for table in self.tables:
            write_csv(folder / f"{table.name}.csv", table.rows)
        for name, figure in self.pictures.items():
            save(figure, folder / name, 110)

    def markdown(self, level: str) -> Iterator[str]:
        """Yield its parts in Markdown under a heading of a level, as `##`."""
        yield f"{level} {self.title}"
        yield paragraph(self.text)
        yield from (table.markdown() for table in self.tables)
        yield from (f"![{self.title}]({name})" for name in self.pictures)


def _figure(size: tuple[float, float], rows: int, columns: int, **shared: Any) -> tuple[Figure, Any]:
    """Return a figure of a size [inch] with panels in rows and columns."""
    figure = require()(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, **shared)


# Exact references -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parallelogram:
    """Five-bar (four-bar: m4 = 0) of links of 1 m on its parallelogram branch th1 = th3 = th, th2 = th4 = 0.

    (m1/3 + m3/3 + m2 + m4/4) l^2 th'' = tau - (m1/2 + m3/2 + m2 + m4/2) g l cos th,  m1 = m3 = 1 kg.
    """

    m2: float = 1.0
    m4: float = 1.0
    torque: float = 0.0

    @property
    def inertia(self) -> float:
        return 2 / 3 + self.m2 + self.m4 / 4

    @property
    def weight(self) -> float:
        return (1 + self.m2 + self.m4 / 2) * GRAVITY

    def acceleration(self, th: NDArray) -> NDArray:
        return (self.torque - self.weight * np.cos(th)) / self.inertia

    def motion(self, times: NDArray, start: float = 0.0, largest: float = 0.01) -> tuple[NDArray, NDArray]:
        """Return angle and rate at `times` by DOP853; steps of at most `largest` [s] keep its interpolation exact."""
        solution = solve_ivp(
            lambda _, y: (y[1], self.acceleration(y[0])),
            (0.0, times[-1]),
            (start, RATE),
            "DOP853",
            times,
            rtol=1e-13,
            atol=1e-13,
            max_step=largest,
        )
        return solution.y[0], solution.y[1]

    def energy(self, th: NDArray, w: NDArray) -> NDArray:
        """Return kinetic and potential energy minus the work of the torque [J]."""
        return self.inertia * w**2 / 2 + self.weight * np.sin(th) - self.torque * th

    def multipliers(self, th: NDArray, w: NDArray) -> NDArray:
        """Return the eight multipliers of least norm (8, len(th)) under gravity alone.

        Links 2 and 4 translate, so each end carries half of their load: by moments for the forces along y, by symmetry
        (m1 = m3) and least norm for those along x.
        """
        e = self.acceleration(th)
        ax = -np.sin(th) * e - np.cos(th) * w**2
        ay = np.cos(th) * e - np.sin(th) * w**2
        along = [-self.m2 * ax / 2, -self.m2 * (GRAVITY + ay) / 2]
        middle = [-self.m4 * ax / 4, -self.m4 * (GRAVITY + ay / 2) / 2]
        return np.array([*along, *along, *middle, *middle])


def exact_state(th: float, w: float, m2: float) -> tuple[NDArray, NDArray]:
    """Return accelerations (8,) and least-norm multipliers (8,) of the five-bar with DIGITS digits, by (9).

    The constraint matrix has the null space [1 0 -1 0 -2 0 2 0] away from singular positions; (9) bordered with it is
    regular, and its solution has least norm.
    """
    with needs("a reference in many digits needs mpmath", "bench"):
        import mpmath
    with mpmath.workdps(DIGITS):
        th, w, m2, g, h = (mpmath.mpf(x) for x in (th, w, m2, GRAVITY, 0.5))
        c, s = mpmath.cos(th), mpmath.sin(th)
        C = mpmath.matrix(
            [
                [s, 1, 0, 0, 0, 0, 0, 0],
                [-c, 0, 1, -h, 0, 0, 0, 0],
                [0, 1, 0, 0, s, 0, 0, 0],
                [0, 0, 1, h, -c, 0, 0, 0],
                [h * s, 0, 0, 0, 0, 1, 0, 0],
                [-h * c, 0, 0, 0, 0, 0, 1, -h],
                [0, 0, 0, 0, h * s, 1, 0, 0],
                [0, 0, 0, 0, -h * c, 0, 1, h],
            ]
        )
        xi = [-(w**2) * x for x in (c, s, c, s, h * c, h * s, h * c, h * s)]
        f = [-g * h * c, 0, -m2 * g, 0, -g * h * c, 0, -g, 0]
        third, twelfth = mpmath.mpf(1) / 3, mpmath.mpf(1) / 12
        K = mpmath.zeros(17, 17)
        K[:8, :8] = mpmath.diag([third, m2, m2, m2 * twelfth, third, 1, 1, twelfth])
        K[8:16, :8], K[:8, 8:16] = C, C.T
        for row, entry in zip(range(8, 16), (1, 0, -1, 0, -2, 0, 2, 0), strict=True):
            K[row, 16] = K[16, row] = entry
        x = mpmath.lu_solve(K, mpmath.matrix([*f, *xi, 0]))
        return np.array([float(y) for y in x[:8]]), np.array([float(y) for y in x[8:16]])


# Runs -------------------------------------------------------------------------------------------------------------


@dataclass
class Run:
    """Results of a run up to its end; `failure` is the reason if it ended early."""

    times: NDArray
    values: NDArray
    """One row per time, one column per requested output."""
    states: list[tuple[NDArray, NDArray]]
    """q and v at each time."""
    corrections: list[int]
    """Number of corrections (10) after each step, of positions and velocities together."""
    counters: Counters
    seconds: float
    failure: str = ""


def run(
    equations: Equations,
    settings: Settings,
    stop: float,
    outputs: Sequence[str],
    parameters: dict[str, float] | None = None,
    inputs: dict[str, float] | None = None,
) -> Run:
    """Run a mechanism with the internal step as communication step, counting corrections step by step.

    A failed step ends the run; the results up to it are kept.
    """
    instance = Instance(equations, settings)
    for name, value in {"start.angular_velocity": RATE, "g": GRAVITY, **(parameters or {}), **(inputs or {})}.items():
        instance.set(name, value)
    dt, rows, states, corrections, failure = settings.step_size, [], [], [], ""

    def record() -> None:
        rows.append([instance.get(name) for name in outputs])
        states.append((instance.q.copy(), instance.v.copy()))

    times = np.arange(round(stop / dt) + 1) * dt
    begin = time.perf_counter()
    try:
        instance.initialize()
        record()
        for t, after in pairwise(times):
            before = instance.counters.projection_iterations
            instance.step(after - t, t)
            corrections.append(instance.counters.projection_iterations - before)
            record()
    except StepError as error:
        failure = str(error)
    seconds = time.perf_counter() - begin
    return Run(
        times[: len(rows)],
        np.array(rows).reshape(len(rows), len(outputs)),
        states,
        corrections,
        instance.counters,
        seconds,
        failure,
    )


# Table I ----------------------------------------------------------------------------------------------------------


def table_1(effort: Effort) -> Chapter:
    """Compare iterates of (8) with their closed forms in case 1, the particle at (rho, 0)."""
    equations = derive(load("particle_on_circle"))
    m, rho, vy, fx, fy = 2.0, 0.5, 3.0, 5.0, 7.0
    limit = fx + m * vy**2 / rho
    values = {"m": m, "rho": rho, "g": 0.0, "force.x": fx, "force.y": fy, "start.angular_velocity": vy / rho}
    names = ("particle.ax", "multiplier[1]", "particle.ay")
    rows = []
    for ratio in (1.0, 10.0, 1e3, 1e6):
        for i in (1, 2, 3):
            left = (m / (m + ratio * m)) ** i
            closed = np.array([-(vy**2) / rho + left * limit / m, limit * (1 - left), fy / m])
            # Without projection, multipliers are read exactly as (8) left them.
            settings = replace(CLASSIC, penalty=ratio * m, max_iterations=i, tolerance=1e-16, projection=False)
            computed = run(equations, settings, 0.0, names, values).values[0]
            row: Row = {"alpha / m": ratio, "iterations": i}
            for name, x, y in zip(("ax [m/s2]", "multiplier [N]", "ay [m/s2]"), closed, computed, strict=True):
                row |= {f"{name}, closed form": float(x), f"{name}, computed": float(y)}
                row[f"{name}, relative difference"] = float(abs(y - x) / abs(x))
            rows.append(row)
    about: Row = {"m [kg]": m, "rho [m]": rho, "vy [m/s]": vy, "Fx [N]": fx, "Fy [N]": fy}
    about |= {"limit of ax [m/s2]": -(vy**2) / rho, "limit of multiplier [N]": limit}
    given = Table("table_1_given", "Particle", [about], 6)
    text = (
        "A particle at `(rho, 0)` of its circle. With `e = m / (m + alpha)`, iterate i of (8) is\n"
        "`ax = -vy^2/rho + e^i (Fx + m vy^2/rho) / m`, `ay = Fy / m`, `lambda = (1 - e^i) (Fx + m vy^2/rho)`."
    )
    iterates = Table("table_1", "Iterates of (8): closed forms and computed", rows, 8)
    return Chapter("Table I: the particle on a circle", text, [given, iterates])


# Figure 7 ---------------------------------------------------------------------------------------------------------


def figure_7(effort: Effort) -> Chapter:
    """Plot angle and eight reactions of the five-bar over the paper's run, cases 4 and 5."""
    equations = derive(load("five_bar"))
    outputs = ["link1.angle", "link1.angular_velocity", *(f"multiplier[{i}]" for i in ROWS)]
    figure, axes = _figure((13, 15), 5, 2, sharex=True)
    motion, multipliers, references, series = [], [], [], []
    for column, m2 in enumerate((1.0, 0.0)):
        exact = Parallelogram(m2)
        runs = {
            name: run(equations, settings, effort.stop, outputs, {"m2": m2})
            for name, settings in (("classic", CLASSIC), ("residual", DEFAULT))
        }
        times = np.arange(round(effort.stop / DT) + 1) * DT
        th, w = exact.motion(times)
        references.append(_reference_row("five_bar", m2, exact, times))
        motion += [_motion_row(m2, name, r, th) for name, r in runs.items()]
        multipliers += [_multipliers_row(equations, m2, name, r, exact.multipliers(th, w)) for name, r in runs.items()]
        series.append(_figure_7_series(m2, times, th, exact.multipliers(th, w), runs))
        _figure_7_plot(axes[:, column], m2, times, th, runs)
    text = (
        "The five-bar with one redundant constraint starts at the singular position `th = 0` and falls under gravity, "
        "with `rk4` and corrections (10) after each step. `classic` is (8) as printed with the paper's penalty, "
        "`residual` the default settings. Rows of even number are unique reactions; those of odd number share a "
        "redundant force and are those of least norm. Multipliers are compared in three ways: in time, with the "
        "reference at the same time; at its angle, with the closed form for the angle and rate that the run itself "
        "has; at its q and v, with (9) solved by singular values for the coordinates that the run itself has. The "
        "second differs from the third by how far round-off carried the run off the parallelogram: close to a singular "
        "position rows of odd number magnify that, whatever the formulation."
    )
    tables = [
        Table("figure_7", "Largest errors of the motion, and work", motion),
        Table("figure_7_multipliers", "Largest errors of the multipliers", multipliers),
        _references("figure_7", references),
        *series,
    ]
    return Chapter("Figure 7: the five-bar", text, tables, {"figure_7.png": figure})


def _motion_row(m2: float, name: str, r: Run, th: NDArray) -> Row:
    c, angle = r.counters, r.values[:, 0]
    return {
        "m2 [kg]": m2,
        "formulation": name,
        "reached [s]": float(r.times[-1]),
        "singular positions passed": int(np.count_nonzero(np.diff(np.sign(np.sin(angle[1:]))))),
        "angle error [rad]": float(np.abs(angle - th[: len(angle)]).max()),
        "Phi [m]": c.position_error,
        "Phi-dot [m/s]": c.velocity_error,
        "Phi-ddot [m/s2]": c.acceleration_error,
        "energy error [J]": c.energy_error,
        "iterations per evaluation": c.multiplier_iterations / c.evaluations,
        "corrections per step": float(np.mean(r.corrections)),
        "run time [s]": r.seconds,
    }


def _multipliers_row(equations: Equations, m2: float, name: str, r: Run, in_time: NDArray) -> Row:
    lam = r.values[:, 2:].T
    at_its_angle = Parallelogram(m2).multipliers(r.values[:, 0], r.values[:, 1])
    own = least_norm(equations, {"g": GRAVITY, "m2": m2}, r)
    ways = {"in time": in_time[:, : lam.shape[1]], "at its angle": at_its_angle, "at its q and v": own}
    row: Row = {"m2 [kg]": m2, "formulation": name}
    for way, x in ways.items():
        errors = np.abs(lam - x).max(axis=1)
        row[f"rows 2 4 6 8, {way} [N]"], row[f"rows 1 3 5 7, {way} [N]"] = errors[1::2].max(), errors[::2].max()
    return row


def least_norm(equations: Equations, parameters: dict[str, float], r: Run) -> NDArray:
    """Return multipliers (l, steps) with least loads of joints at the states of a run, by (9) without
    redundant rows."""
    p = [float(parameters.get(v.name, v.start)) for v in equations.parameters]
    u = [float(v.start) for v in equations.inputs]
    columns = []
    for q, v in r.states:
        M, C = np.array(equations.M(q, p)), np.array(equations.C(q, p))
        F = np.array(equations.f(q, v, u, p, 0.0) - equations.d(q, v, p))[:, 0]
        U, sizes, V = np.linalg.svd(C, full_matrices=False)
        kept = sizes > 1e-9
        free, U, C = U[:, ~kept], U[:, kept], sizes[kept, None] * V[kept]
        K = np.block([[M, C.T], [C, np.zeros((len(C), len(C)))]])
        xi = U.T @ np.array(equations.xi(q, v, p))[:, 0]
        a, lam = np.split(np.linalg.solve(K, np.concatenate([F, xi])), [len(M)])
        lam = U @ lam
        slopes = [np.array(equations.shares(q, v, a, x, u, p, 0.0))[:, 0] for x in (lam, *(lam + free.T))]
        P = np.column_stack(slopes[1:]) - slopes[0][:, None]
        columns.append(lam - free @ np.linalg.solve(free.T @ P, free.T @ slopes[0]))
    return np.array(columns).T


def _figure_7_series(m2: float, times: NDArray, th: NDArray, lam: NDArray, runs: dict[str, Run]) -> Table:
    columns, blocks = ["time [s]"], [times[:, None]]
    known = {"reference": np.vstack([th, lam]).T} | {k: _only(r, len(times)) for k, r in runs.items()}
    for name, values in known.items():
        columns += [f"{name} angle [rad]", *(f"{name} multiplier[{i}] [N]" for i in ROWS)]
        blocks.append(values)
    lines = np.hstack(blocks).tolist()
    return Table(f"figure_7_m2_{m2:g}", None, [dict(zip(columns, line, strict=True)) for line in lines])


def _only(r: Run, length: int) -> NDArray:
    """Return angle and multipliers of a run, with NaN after an early end."""
    values = np.full((length, 9), np.nan)
    values[: len(r.times)] = np.delete(r.values, 1, axis=1)
    return values


def _figure_7_plot(axes: Sequence[Axes], m2: float, times: NDArray, th: NDArray, runs: dict[str, Run]) -> None:
    axes[0].set_title(f"m2 = {m2:g} kg", loc="right", fontweight="bold")
    axes[0].plot(times, th, color=COLOURS["reference"], lw=3, alpha=0.4, label="exact")
    for name, r in runs.items():
        axes[0].plot(
            r.times, r.values[:, 0], color=COLOURS[name], lw=1, ls="-" if name == "classic" else "--", label=name
        )
    for turns in (0, -np.pi):
        axes[0].axhline(turns, color="0.3", lw=0.8, ls=":")
    axes[0].set_ylabel("angle th [rad]\n(dotted: singular)")
    # Rows 1 and 3, 2 and 4, 5 and 7, 6 and 8 coincide, so the second of a pair is dashed.
    for axis, rows in ((axes[1], (1, 3, 5, 7)), (axes[2], (2, 4, 6, 8))):
        for i, (row, colour) in enumerate(zip(rows, ("C0", "C3", "C2", "C1"), strict=True)):
            axis.plot(
                runs["residual"].times,
                runs["residual"].values[:, 1 + row],
                color=colour,
                lw=(2.5, 1.2)[i % 2],
                ls=("-", (0, (4, 4)))[i % 2],
                label=f"row {row}",
            )
        axis.set_ylabel("multipliers [N]\n" + ("along x, least norm" if rows[0] == 1 else "along y, unique"))
    for name, r in runs.items():
        k = len(r.times)
        axes[3].semilogy(r.times, np.abs(r.values[:, 0] - th[:k]) + 1e-17, color=COLOURS[name], lw=1, label=name)
        error = np.abs(r.values[:, 2:].T - Parallelogram(m2).multipliers(r.values[:, 0], r.values[:, 1])).max(axis=0)
        axes[4].semilogy(r.times, error + 1e-17, color=COLOURS[name], lw=1, label=name)
    axes[3].set_ylabel("angle error [rad]")
    axes[3].set_ylim(1e-10, 1e-4)
    axes[4].set_ylabel("largest multiplier error\nat its angle [N]")
    axes[4].set_xlabel("time [s]")
    for axis in axes:
        axis.grid(alpha=0.3)
        axis.legend(loc="lower left", bbox_to_anchor=(-0.02, 0.98), ncols=4, fontsize=9, frameon=False)


# Iterations -------------------------------------------------------------------------------------------------------


def iterations(effort: Effort) -> Chapter:
    """Compare iterations of (8) and (10) in double precision with those reported in the paper."""
    equations = derive(load("five_bar"))
    cases = [(replace(CLASSIC, tolerance=tol, max_iterations=LIMIT), tol) for tol in TOLERANCES]
    cases += [(replace(DEFAULT, tolerance=tol, max_iterations=LIMIT), tol) for tol in TOLERANCES]
    summary, claims, counts = [], [], []
    for m2 in (1.0, 0.0):
        for settings, tol in cases:
            r = run(equations, settings, effort.counted, ["monitor.iterations"], {"m2": m2})
            used = r.values[:, 0].astype(int)
            summary.append(_iterations_row(m2, settings, r, used))
            for quantity, values in (("iterations", used), ("corrections", r.corrections)):
                about: Row = {
                    "m2 [kg]": m2,
                    "formulation": settings.formulation,
                    "tolerance": tol,
                    "quantity": quantity,
                }
                counts += [about | {"count": n, "times": k} for n, k in sorted(Counter(map(int, values)).items())]
            if settings.formulation == "classic":
                claims.append(_claim("iterations (8)", m2, tol, "1 to 3", used, 3))
            if settings.formulation == "classic" and tol == min(TOLERANCES):
                claims.append(
                    _claim("corrections (10), positions and velocities", m2, tol, "at most 2 of each", r.corrections, 4)
                )
    text = (
        "Iterations of (8) at each communication point of the five-bar run, and corrections (10) after each step,\n"
        "those of positions and of velocities added up. The test on iterations is relative, |da| <= tolerance * |a|,\n"
        "hence easier than the paper's absolute one; the tolerance is also that of |Phi| and |Phi-dot|, where it is\n"
        "never stricter than the round-off of the row. The paper has its count for the strictest tolerance; in double\n"
        "precision it is enough for the loosest. A small |da| says that (8) stands still, not that it is right: see\n"
        "the next chapter."
    )
    tables = [
        Table("claims", "The paper's counts and the measured ones, classic", claims),
        Table("iterations", "Iterations and corrections that were needed", summary),
        Table("iterations_histogram", None, counts),
    ]
    return Chapter("Iterations and corrections", text, tables, {"iterations.png": _iterations_plot(counts)})


def _iterations_row(m2: float, settings: Settings, r: Run, used: NDArray) -> Row:
    return {
        "m2 [kg]": m2,
        "formulation": settings.formulation,
        "penalty [kg]": _penalty(settings),
        "tolerance": settings.tolerance,
        "median iterations": float(np.median(used)),
        "90 % of states within": float(np.quantile(used, 0.9)),
        "most iterations": int(used.max()),
        "states within 3 [%]": 100 * float(np.mean(used <= 3)),
        "states at the limit [%]": 100 * float(np.mean(used >= LIMIT)),
        "limit": LIMIT,
        "mean corrections per step": float(np.mean(r.corrections)),
        "most corrections in a step": max(r.corrections),
    }


def _penalty(settings: Settings) -> float | str:
    """Return the penalty in a table; the study has one number for all rows."""
    assert isinstance(settings.penalty, float)
    return settings.penalty or "scaled"


def _claim(count: str, m2: float, tol: float, paper: str, values: ArrayLike, most: int) -> Row:
    used = np.asarray(values)
    row: Row = {"count": count, "m2 [kg]": m2, "tolerance": tol, "paper": paper}
    row |= {"measured median": float(np.median(used)), "measured most": int(used.max())}
    return row | {"within the claim [%]": 100 * float(np.mean(used <= most))}


def _iterations_plot(counts: Sequence[Row]) -> Figure:
    figure, axes = _figure((13, 6), 2, len(TOLERANCES), sharex="row", sharey="row")
    for column, tol in enumerate(TOLERANCES):
        for row, quantity in enumerate(("iterations", "corrections")):
            axis, last = axes[row, column], (16, 8)[row]
            for shift, name in ((-0.2, "classic"), (0.2, "residual")):
                bars: Counter[int] = Counter()
                for x in counts:
                    if [*x.values()][:4] == [1.0, name, tol, quantity]:
                        bars[min(int(number(x, "count")), last)] += int(number(x, "times"))
                axis.bar([n + shift for n in bars], bars.values(), 0.4, color=COLOURS[name], label=name)
            axis.set_xticks(range(last + 1), [*map(str, range(last)), f"≥{last}"], fontsize=8)
            axis.set_xlim(-0.6, last + 0.6)
            axis.grid(axis="y", alpha=0.3)
            axis.set_xlabel(f"{quantity}" + (" of (8) per state" if row == 0 else " (10) per step"))
        axes[0, column].set_title(f"tolerance {tol:g}")
        axes[0, column].axvspan(0.5, 3.5, color="0.88", zorder=0, label="the paper's 1 to 3")
        axes[1, column].axvspan(-0.5, 4.5, color="0.88", zorder=0, label="the paper's at most 2 of each")
    for axis in axes[:, 0]:
        axis.legend(fontsize=8, loc="upper right")
    axes[0, 0].set_ylabel("states (m2 = 1 kg)")
    axes[1, 0].set_ylabel("steps (m2 = 1 kg)")
    return figure


# Accuracy against the penalty -------------------------------------------------------------------------------------


def accuracy(effort: Effort) -> Chapter:
    """Compare (8) as printed and in residual form with a reference in many digits, over decades of penalty."""
    equations = derive(load("five_bar"))
    rows = []
    for m2 in (1.0, 0.0):
        angles = -np.pi * (1 - (np.arange(effort.states) + 0.5) / effort.states)
        exact = Parallelogram(m2)
        rates = np.sqrt(RATE**2 - 2 * exact.weight * np.sin(angles) / exact.inertia)
        references = [exact_state(th, w, m2) for th, w in zip(angles, rates, strict=True)]
        for name in ("classic", "residual"):
            for ratio in effort.ratios:
                errors = [
                    _errors(equations, name, ratio, m2, th, w, reference)
                    for th, w, reference in zip(angles, rates, references, strict=True)
                ]
                a, lam, raw, used = np.array(errors).T
                row: Row = {"m2 [kg]": m2, "formulation": name, "alpha / mass": ratio, "error of a": float(a.max())}
                row |= {"error of multipliers": float(lam.max()), "the same, as iterated": float(raw.max())}
                rows.append(row | {"median iterations": float(np.median(used)), "most iterations": int(used.max())})
    text = (
        "Accelerations and multipliers of the five-bar at states spread over its motion, each solved anew in many\n"
        "digits with the redundant direction held explicitly. Errors are the largest over the states, each relative\n"
        "to the largest entry of its vector. Multipliers are those of least norm, as a user reads them; `as iterated`\n"
        "is the result of the iteration of (8) before its redundant part is removed."
    )
    about: Row = {"digits": DIGITS, "states": effort.states, "largest entry of M [kg]": 1.0}
    about |= {"tolerance": min(TOLERANCES), "limit of iterations": LIMIT}
    given = Table("accuracy_given", "Reference and states", [about])
    table = Table("accuracy", "Largest relative errors", rows)
    return Chapter("Accuracy against the penalty", text, [given, table], {"accuracy.png": _accuracy_plot(rows)})


def _errors(
    equations: Equations,
    formulation: str,
    ratio: float,
    m2: float,
    th: float,
    w: float,
    reference: tuple[NDArray, NDArray],
) -> tuple[float, float, float, float]:
    """Return relative errors of a, lam, lam as iterated, and the number of iterations, at one state."""
    settings = Settings(
        penalty=ratio, formulation=formulation, tolerance=min(TOLERANCES), max_iterations=LIMIT, projection=True
    )
    names = [*ACCELERATIONS, *(f"multiplier[{i}]" for i in ROWS), "monitor.iterations"]
    values = {"m2": m2, "start.angle": th, "start.angular_velocity": w}
    read, iterated = (
        run(equations, replace(settings, projection=projects), 0.0, names, values).values[0]
        for projects in (True, False)
    )
    a, lam = reference
    return (
        np.abs(read[:8] - a).max() / np.abs(a).max(),
        np.abs(read[8:16] - lam).max() / np.abs(lam).max(),
        np.abs(iterated[8:16] - lam).max() / np.abs(lam).max(),
        read[16],
    )


def _accuracy_plot(rows: Sequence[Row]) -> Figure:
    figure, axes = _figure((12, 4.8), 1, 2, sharey=True)
    titles = {"error of a": "accelerations", "error of multipliers": "multipliers of least norm"}
    for axis, (error, title) in zip(axes, titles.items(), strict=True):
        for m2, style in ((1.0, "o-"), (0.0, "s--")):
            for name in ("classic", "residual"):
                chosen = [r for r in rows if r["m2 [kg]"] == m2 and r["formulation"] == name]
                x, y = ([r[column] for r in chosen] for column in ("alpha / mass", error))
                axis.loglog(x, y, style, color=COLOURS[name], ms=5, label=f"{name}, m2 = {m2:g} kg")
        axis.axhline(np.finfo(float).eps, color="0.6", lw=0.8, ls=":")
        axis.annotate("round-off", (1e14, np.finfo(float).eps * 0.4), ha="right", va="top", fontsize=8, color="0.4")
        axis.set_title(title)
        axis.set_xlabel("alpha / mass")
        axis.grid(alpha=0.3)
        axis.set_ylim(2e-17, 3)
    axes[0].set_ylabel("largest relative error")
    axes[0].legend(fontsize=8, loc="upper left")
    return figure


# The four-bar through its singular positions ----------------------------------------------------------------------


PROCEDURES = {"classic": replace(CLASSIC, max_iterations=PAPER_MOST), "residual": DEFAULT}
"""The paper's procedure, (8) stopped early, and the defaults."""


def four_bar(effort: Effort) -> Chapter:
    """Run the driven four-bar, case 6, in which another degree of freedom opens at each singular position."""
    equations = derive(load("four_bar"))
    exact = Parallelogram(m4=0.0, torque=TORQUE)
    rows, curves = [], {}
    for name, settings in PROCEDURES.items():
        for dt in DRIVEN_STEPS:
            r = _drive(equations, replace(settings, step_size=dt), effort)
            curves[name, dt] = r
            rows.append(_four_bar_row(name, settings, dt, r, exact))
    phases, samples = _phases(equations, exact, effort)
    text = (
        "A constant torque on the first link cannot pass through the aligned links, so the reactions have a pole at "
        "`th = 0` and `th = -pi`, and (8) does not converge to the branch that is followed. The first table starts "
        "exactly at `th = 0`; the second varies the start angle: the error depends on how close a Runge-Kutta stage "
        "comes to the singular position. `classic` is the paper's procedure, (8) stopped early; `residual` the default "
        "settings, which take limits along the branch there. A run that stopped says why, and its values are those up "
        "to there; the second table takes errors only from runs that reached the end. Steps are left open where the "
        "corrections (10) did not reach the tolerance."
    )
    times = np.arange(round(effort.driven / DT) + 1) * DT
    tables = [
        Table("four_bar", "Start at a singular position", rows),
        Table("four_bar_phases", "The same over many start angles", phases),
        _references("four_bar", [_reference_row("four_bar", 1.0, exact, times)]),
        Table("four_bar_starts", None, samples),
    ]
    pictures = {"four_bar.png": _four_bar_plot(curves, samples, exact, effort)}
    return Chapter("The driven four-bar through its singular positions", text, tables, pictures)


def _drive(equations: Equations, settings: Settings, effort: Effort, start: float = 0.0) -> Run:
    return run(equations, settings, effort.driven, ["link1.angle"], {"start.angle": start}, {"A.torque": TORQUE})


def _four_bar_row(name: str, settings: Settings, dt: float, r: Run, exact: Parallelogram) -> Row:
    c = r.counters
    return {
        "procedure": name,
        "penalty [kg]": _penalty(settings),
        "tolerance": settings.tolerance,
        "limit of iterations": settings.max_iterations,
        "dt [s]": dt,
        "reached [s]": float(r.times[-1]),
        "angle error [rad]": _angle_error(r, exact),
        "Phi [m]": c.position_error,
        "Phi-dot [m/s]": c.velocity_error,
        "energy error [J]": c.energy_error,
        "iterations per evaluation": c.multiplier_iterations / c.evaluations,
        "evaluations at the limit [%]": 100 * c.unconverged / c.evaluations,
        "steps left open": c.unprojected,
        "stopped by": r.failure or None,
    }


def _angle_error(r: Run, exact: Parallelogram, start: float = 0.0) -> float:
    if len(r.times) < 2:
        return 0.0
    return float(np.abs(r.values[:, 0] - exact.motion(r.times, start)[0]).max())


def _phases(equations: Equations, exact: Parallelogram, effort: Effort) -> tuple[list[Row], list[Row]]:
    """Return errors over many starts: a summary by procedure, and every run."""
    summary: list[Row] = []
    samples: list[Row] = []
    for name, settings in PROCEDURES.items():
        errors = []
        for start in np.linspace(-LUCK, LUCK, effort.phases).tolist():
            r = _drive(equations, settings, effort, start)
            error, reached = _angle_error(r, exact, start), float(r.times[-1]) if len(r.times) else 0.0
            row: Row = {"procedure": name, "start angle [rad]": start, "reached [s]": reached}
            samples.append(row | {"angle error [rad]": error})
            errors += [] if r.failure else [error]
        middle, most, largest = (float(x) for x in np.quantile(errors, (0.5, 0.9, 1.0)))
        row = {
            "procedure": name,
            "dt [s]": DT,
            "starts": effort.phases,
            "runs that stopped": effort.phases - len(errors),
        }
        row |= {"median angle error [rad]": middle, "90 % within [rad]": most, "largest angle error [rad]": largest}
        summary.append(row | {"starts above 1e-3 rad [%]": 100 * float(np.mean(np.array(errors) > 1e-3))})
    return summary, samples


def _four_bar_plot(
    curves: dict[tuple[str, float], Run], samples: Sequence[Row], exact: Parallelogram, effort: Effort
) -> Figure:
    figure, axes = _figure((15, 4.8), 1, 3)
    times = np.arange(round(effort.driven / DT) + 1) * DT
    axes[0].plot(times, exact.motion(times)[0], color=COLOURS["reference"])
    for turns in (0, -np.pi):
        axes[0].axhline(turns, color="0.6", lw=0.8, ls=":")
    axes[0].set(title="exact motion (dotted: singular)", xlabel="time [s]", ylabel="angle th [rad]")
    styles = dict(zip(DRIVEN_STEPS, ("-", "--", ":"), strict=True))
    for (name, dt), r in curves.items():
        if len(r.times) < 2:
            continue
        error = np.abs(r.values[:, 0] - exact.motion(r.times)[0]) + 1e-17
        label = f"{name}, {dt:g} s" + (f", stopped at {r.times[-1]:.3g} s" if r.failure else "")
        width = 3 if name == "classic" else 1.2
        axes[1].semilogy(r.times, error, styles[dt], color=COLOURS[name], lw=width, alpha=0.8, label=label)
    axes[1].set(title="start at th = 0, three steps", xlabel="time [s]", ylabel="angle error [rad]", ylim=(1e-9, 30))
    axes[1].legend(fontsize=8, loc="upper left", ncols=2)  # above the curves
    marks = {"classic": "s", "residual": "o"}
    for name in PROCEDURES:
        own = [s for s in samples if s["procedure"] == name]
        done = [s for s in own if number(s, "reached [s]") > effort.driven - DT / 2]
        x, y = ([s[column] for s in done] for column in ("start angle [rad]", "angle error [rad]"))
        label = f"{name} ({len(own) - len(done)} stopped)"
        axes[2].semilogy(x, y, marks[name], color=COLOURS[name], ms=5, label=label, mfc="none")
    axes[2].set(title=f"many starts, dt = {DT:g} s", xlabel="start angle [rad]", ylabel="largest angle error [rad]")
    axes[2].set_ylim(1e-6, 30)
    axes[2].set_xticks(np.linspace(-LUCK, LUCK, 5))
    axes[2].legend(fontsize=8, loc="upper left")
    for axis in axes:
        axis.grid(alpha=0.3)
    return figure


# The references' own errors ---------------------------------------------------------------------------------------


def _reference_row(name: str, m2: float, exact: Parallelogram, times: NDArray) -> Row:
    th, w = exact.motion(times)
    finer, _ = exact.motion(times, largest=0.004)
    energy = exact.energy(th, w)
    row: Row = {"mechanism": name, "m2 [kg]": m2}
    row["change of angle with finer steps [rad]"] = float(np.abs(th - finer).max())
    return row | {"energy drift [J]": float(np.abs(energy - energy[0]).max())}


def _references(name: str, rows: list[Row]) -> Table:
    return Table(f"{name}_reference", "Error of the reference itself (DOP853)", rows)


# The study --------------------------------------------------------------------------------------------------------


STUDIES: dict[str, tuple[str, Callable[[Effort], Chapter]]] = {
    "table-1": ("particle_on_circle", table_1),
    "figure-7": ("five_bar", figure_7),
    "iterations": ("five_bar", iterations),
    "accuracy": ("five_bar", accuracy),
    "four-bar": ("four_bar", four_bar),
}
"""Chapters by name: the mechanism of each, and the function that makes it."""

LIMITS = """\
- The reference of the linkages is the motion on the parallelogram branch with one degree of freedom. It judges how
  well a run stays on that branch, not which branch a real linkage with play and flexibility would take.
- At a singular position the reactions of the driven four-bar are unbounded, so they are not compared; angles are.
- Reactions that redundancy leaves open are those by which all six joints carry the least, which is a convention. The
  paper's are of least norm over the eight rows; with equal outer links and without torques both are the same.
- The paper's counts of iterations and corrections come from another programme, another stopping rule and another
  machine; only their size can be compared.
- Accuracy against the penalty is measured where the distance to a singular position is at least half the spacing of
  the states; closer to it every form loses digits.
- `classic` and `residual` differ in penalty and in tolerance of iterations where a table says so: they are compared as
  they are meant to be used, not at equal work.
- Run times hold for one run on the machine named above, with the readable NumPy formulation and outputs read at each
  step. They say nothing about compiled kernels. `residual` on the four-bar is run by the fastest kernel there is.
"""


def settings(effort: Effort) -> Table:
    """Return the settings of the study."""
    values = {
        "gravity [m/s2]": GRAVITY,
        "start rate [rad/s]": RATE,
        "five-bar: stop time [s]": effort.stop,
        "five-bar: stop time where iterations are counted [s]": effort.counted,
        "five-bar: step [s]": DT,
        "penalty of classic [kg]": ALPHA,
        "default tolerance": DEFAULT.tolerance,
        "default limit of iterations": DEFAULT.max_iterations,
        "four-bar: torque on link 1 [N m]": TORQUE,
        "four-bar: stop time [s]": effort.driven,
        "four-bar: limit of iterations of classic": PAPER_MOST,
    }
    rows: list[Row] = [{"quantity": name, "value": value} for name, value in values.items()]
    return Table("paper_settings", "Numbers of the study", rows, 6)
