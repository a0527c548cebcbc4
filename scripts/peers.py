"""Error against run time of alfmu and of what else a Python user might take, on two closed-loop mechanisms.

Each peer is used as its own documentation says, in the best of the settings that were tried (the docstring of its
class says which). A run lasts 20 s of simulated time and delivers, every 0.02 s, the angle of the first link and the
forces of all joints; its error is the largest difference of that angle from the exact motion. Building the model is
timed apart. Writes `peers.csv`, `peers_reach.csv` and `peers.md` into one folder.

Mechanisms, both started at angle 0 with 2 rad/s under gravity alone:
five_bar      links of 1 m and 1 kg; one constraint is redundant; starts in a singular position and passes many
slider_crank  crank 0.5 m, rod 1 m, 1 kg each and for the slider; regular everywhere

Reactions are forces on the second body from the first in ground axes [N], named as in alfmu: A to F (x and y) of the
five-bar, A, B, C (x and y) and the guide of the slider-crank.
"""

from __future__ import annotations

import os

# One thread for everyone; BLAS reads these when NumPy is loaded.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", MKL_NUM_THREADS="1", NUMEXPR_NUM_THREADS="1")

import argparse
import contextlib
import csv
import math
import platform
import random
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tqdm import tqdm

import alfmu
from alfmu.kernel import DEFAULT, KERNELS
from alfmu.simulation import prepared

GRAVITY = 9.81
RATE = 2.0
"""Start of both mechanisms: angle 0 with this rate [rad/s]."""

STOP, SAMPLE = 20.0, 0.02
"""Simulated time and distance of samples [s]."""

TARGET = 1e-6
"""Angle error [rad] at which run times are compared."""

LOST = 0.1
"""Angle error [rad] from which a run counts as having lost the motion."""

REPEATS, MORE, SHORT = 3, 6, 1.0
"""Timed rounds over all points, further rounds over those that are faster than SHORT [s] (none where quick)."""

SEED = 1
"""Of the order within each round, so that load from outside does not always meet the same peer."""

CRANK, ROD = 0.5, 1.0
"""Lengths of the slider-crank [m]."""

MECHANISMS = ("five_bar", "slider_crank")
REACTIONS = {
    "five_bar": [f"{joint}.force.{axis}" for joint in "ABCDEF" for axis in "xy"],
    "slider_crank": [*(f"{joint}.force.{axis}" for joint in "ABC" for axis in "xy"), "guide.force"],
}
ANGLE = {"five_bar": "link1.angle", "slider_crank": "crank.angle"}
START = {
    "five_bar": {"start.angle": 0.0, "start.angular_velocity": RATE},
    "slider_crank": {"start.angle": 0.0, "start.angular_velocity": RATE},
}


class Trajectory(NamedTuple):
    """What one run delivers, sampled every 0.02 s."""

    times: NDArray
    """(k,) s"""
    angle: NDArray
    """(k,) of link 1 or crank, rad"""
    reactions: NDArray | None
    """(k, number of REACTIONS), N; None where the peer has none"""
    note: str = ""


class Run(NamedTuple):
    """A trajectory, what it took, and how often that was measured."""

    times: NDArray
    angle: NDArray
    reactions: NDArray | None
    seconds: list[float]
    """Run time of each repeat."""
    setup: float
    """Time to build the model [s]."""
    note: str

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)


Simulation = Callable[[], Trajectory]
"""One run from the start; may be called again and again."""


def samples(stop_time: float) -> NDArray:
    """0, 0.02, ... stop_time [s]."""
    return np.arange(round(stop_time / SAMPLE) + 1) * SAMPLE


def whole(step: float) -> int:
    """Steps between two samples; ValueError where a step does not divide 0.02 s."""
    n = round(SAMPLE / step)
    if n < 1 or abs(n * step - SAMPLE) > 1e-12:
        raise ValueError(f"a step of {step} s does not divide {SAMPLE} s")
    return n


# Exact references -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Reference:
    """Exact motion and reactions of a mechanism from one equation in its only angle, and how exact that is."""

    angle: NDArray
    """(k,) at the samples, rad"""
    reactions: NDArray
    """(k, number of REACTIONS), N"""
    change: float
    """Largest change of the angle between two tolerances, rad."""
    energy: float
    """Largest change of the energy, relative to the span of the potential energy."""


def reference(mechanism: str, stop_time: float = STOP) -> Reference:
    """The exact motion, by DOP853 with tolerances 1e-13 and steps of at most 0.01 s."""
    acceleration, energy, reactions = {"five_bar": FIVE_BAR, "slider_crank": SLIDER_CRANK}[mechanism]
    times = samples(stop_time)

    def motion(tolerance: float, largest: float) -> NDArray:
        return solve_ivp(
            lambda _, y: (y[1], acceleration(y[0], y[1])),
            (0.0, times[-1]),
            (0.0, RATE),
            "DOP853",
            times,
            rtol=tolerance,
            atol=tolerance,
            max_step=largest,
        ).y

    th, w = motion(1e-13, 0.01)
    change = np.abs(motion(1e-12, 0.0137)[0] - th).max()
    span = np.ptp(energy(th, np.zeros_like(th)))
    drift = np.ptp(energy(th, w)) / span
    return Reference(th, reactions(th, w, acceleration(th, w)), float(change), float(drift))


def _five_bar_acceleration(th: NDArray, w: NDArray) -> NDArray:
    """(m1/3 + m3/3 + m2 + m4/4) l^2 th'' = -(m1/2 + m3/2 + m2 + m4/2) g l cos th on the parallelogram branch."""
    return -2.5 * GRAVITY * np.cos(th) / (2 / 3 + 1 + 1 / 4)


def _five_bar_energy(th: NDArray, w: NDArray) -> NDArray:
    return (2 / 3 + 1 + 1 / 4) * w**2 / 2 + 2.5 * GRAVITY * np.sin(th)


def _five_bar_reactions(th: NDArray, w: NDArray, e: NDArray) -> NDArray:
    """Links 2 and 4 move in translation, so each end carries half of what moves them; x by symmetry and least norm."""
    x, y = -np.sin(th) * e - np.cos(th) * w**2, np.cos(th) * e - np.sin(th) * w**2
    B = np.array([x, y + GRAVITY]) / 2
    E = np.array([x / 2, y / 2 + GRAVITY]) / 2
    A = np.array([x / 2, y / 2 + GRAVITY]) + B + E
    return np.vstack([A, B, -B, A, E, -E]).T


def _slider_crank_geometry(th: NDArray) -> tuple[NDArray, ...]:
    """Rod angle p and the places of rod and slider as functions of the crank angle; first and second derivatives."""
    s, c = np.sin(th), np.cos(th)
    sp = -CRANK / ROD * s
    cp = np.sqrt(1 - sp**2)
    p1 = -CRANK * c / (ROD * cp)
    p2 = (CRANK * s + ROD * sp * p1**2) / (ROD * cp)
    x2 = (-CRANK * s - ROD / 2 * sp * p1, -CRANK * c - ROD / 2 * (cp * p1**2 + sp * p2))
    y2 = (CRANK / 2 * c, -CRANK / 2 * s)
    x3 = (-CRANK * s - ROD * sp * p1, -CRANK * c - ROD * (cp * p1**2 + sp * p2))
    return sp, cp, p1, p2, *x2, *y2, *x3


def _slider_crank_inertia(th: NDArray) -> tuple[NDArray, NDArray]:
    """J(th) of the kinetic energy J w^2 / 2, and dJ/dth, with all masses 1 kg."""
    _, _, p1, p2, x21, x22, y21, y22, x31, x32 = _slider_crank_geometry(th)
    inertia = CRANK**2 / 3 + x21**2 + y21**2 + ROD**2 / 12 * p1**2 + x31**2
    return inertia, 2 * (x21 * x22 + y21 * y22 + ROD**2 / 12 * p1 * p2 + x31 * x32)


def _slider_crank_acceleration(th: NDArray, w: NDArray) -> NDArray:
    """J th'' + J' w^2 / 2 + dV/dth = 0 with V = (m1 + m2) g l1/2 sin th, from the energies alone."""
    inertia, slope = _slider_crank_inertia(th)
    return -(slope * w**2 / 2 + GRAVITY * CRANK * np.cos(th)) / inertia


def _slider_crank_energy(th: NDArray, w: NDArray) -> NDArray:
    return _slider_crank_inertia(th)[0] * w**2 / 2 + GRAVITY * CRANK * np.sin(th)


def _slider_crank_reactions(th: NDArray, w: NDArray, e: NDArray) -> NDArray:
    """Newton and Euler, body by body from the slider to the crank, with all masses 1 kg."""
    sp, cp, p1, p2, x21, x22, y21, y22, x31, x32 = _slider_crank_geometry(th)
    a1x, a1y = CRANK / 2 * (-np.sin(th) * e - np.cos(th) * w**2), CRANK / 2 * (np.cos(th) * e - np.sin(th) * w**2)
    a2x, a2y, a3x = x21 * e + x22 * w**2, y21 * e + y22 * w**2, x31 * e + x32 * w**2
    turning = ROD**2 / 12 * (p1 * e + p2 * w**2)
    Cx = a3x
    Cy = (sp * (a2x + 2 * Cx) - 2 * turning / ROD) / (2 * cp) - (a2y + GRAVITY) / 2
    Bx, By = a2x + Cx, a2y + GRAVITY + Cy
    return np.array([a1x + Bx, a1y + GRAVITY + By, Bx, By, Cx, Cy, GRAVITY - Cy]).T


FIVE_BAR = _five_bar_acceleration, _five_bar_energy, _five_bar_reactions
SLIDER_CRANK = _slider_crank_acceleration, _slider_crank_energy, _slider_crank_reactions


def unique(mechanism: str, reactions: NDArray) -> NDArray:
    """What rigid bodies determine: all forces of the slider-crank; of the five-bar those along y, and of those along x
    the sums that no tension of one coupler against the other changes."""
    if mechanism == "slider_crank":
        return reactions
    x, y = reactions[:, ::2], reactions[:, 1::2]
    A, B, C, D, E, F = range(6)
    return np.column_stack([y, x[:, B] - x[:, C], x[:, E] - x[:, F], x[:, A] + x[:, D]])


# Peers ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Peer:
    """One way to simulate: `build` makes a simulation of a mechanism with a step (or tolerance) for a stop time."""

    package: str
    """Distribution whose version is reported."""
    name: str
    setting: str
    steps: dict[str, Sequence[float]]
    """Steps [s] or tolerances by mechanism, the coarsest first."""
    control: str = "step"
    """What the step is: `step` [s] or `rtol`."""
    quick: int = 2
    """How many of the steps a quick study takes."""

    def build(self, mechanism: str, step: float, stop_time: float) -> Simulation:
        raise NotImplementedError

    def run(self, mechanism: str, step: float, stop_time: float = STOP, repeats: int = REPEATS) -> Run:
        """Build, run and time; `study` does the same, but takes turns between peers."""
        begin = time.perf_counter()
        simulate = self.build(mechanism, step, stop_time)
        setup, seconds = time.perf_counter() - begin, []
        for _ in range(repeats):
            begin = time.perf_counter()
            trajectory = simulate()
            seconds.append(time.perf_counter() - begin)
        return Run(trajectory.times, trajectory.angle, trajectory.reactions, seconds, setup, trajectory.note)

    @property
    def installed(self) -> str:
        """Version of the package, empty if there is none."""
        try:
            return version(self.package)
        except PackageNotFoundError:
            return ""


@dataclass(frozen=True)
class Alfmu(Peer):
    """alfmu itself: the library's `Instance`, all outputs read every 0.02 s; `step` is `solver.step_size`.

    Settings are the defaults. The slider-crank is run in its default coordinates (absolute) and in joint coordinates,
    the smallest set and what the other peers use.
    """

    kernel: str = DEFAULT
    coordinates: str = ""
    """Option of the slider-crank; empty for its default."""

    def build(self, mechanism: str, step: float, stop_time: float) -> Simulation:
        equations = _equations(mechanism, self.kernel, self.coordinates)
        instance = alfmu.Instance(equations, alfmu.Settings(step_size=step))
        for name, value in START[mechanism].items():
            instance.set(name, value)
        instance.initialize()
        start, times = instance.save(), samples(stop_time)
        names = [v.name for v in instance.outputs]
        columns = [names.index(name) for name in (ANGLE[mechanism], *REACTIONS[mechanism])]

        def simulate() -> Trajectory:
            instance.restore(start)
            rows = np.empty((len(times), len(columns)))
            rows[0] = instance.read()[columns]
            for i, t in enumerate(times[:-1]):
                instance.step(SAMPLE, t)
                rows[i + 1] = instance.read()[columns]
            return Trajectory(times, rows[:, 0], rows[:, 1:])

        return simulate


@cache
def _equations(mechanism: str, kernel: str, coordinates: str) -> alfmu.Equations:
    """Derived, traced and compiled once; so the first point of a setting has the set-up time."""
    options = {"coordinates": coordinates} if coordinates else {}
    return prepared(alfmu.derive(alfmu.load(mechanism, **options)), kernel)


@dataclass(frozen=True)
class Pinocchio(Peer):
    """`pin.constraintDynamics` (proximal, sparse) on a tree of revolute joints, closed by CONTACT_3D constraints.

    Tree of the five-bar: A, then B and E on link 1, and D; closed at C and F, so 4 coordinates and 4 rows in the plane
    (and 2 empty ones along z), one of them redundant. The tree makes the parallelogram a straight line in the
    coordinates, on which all stages of RK4 stay. Joints must be added depth first, or the constraints are wrong without
    a word. The reactions are the contact forces and `pin.rnea` with them at the samples; the accelerations of a sample
    are those of the first stage of the next step.

    Tried: mu from 1e-4 to 1e-12, accuracies from 1e-6 to 1e-12, 1 to 50 iterations (1e-8, 1e-12, 10 here; mu above
    1e-8 or fewer than 3 iterations spoil forces or motion of the five-bar, nothing else is faster or more exact); no
    stabilisation (the five-bar leaves its branch or overflows); Baumgarte with critical damping, omega from 1 to 200
    1/s (five-bar: 60; from 20 on all are alike, 10 is lost, and so is 200 with 0.02 s; slider-crank: 5 is best, larger
    ones spoil the order); projection of positions and velocities by least squares after every step and every 0.02 s
    (equally exact, so every 0.02 s); `solve_ivp` in place of RK4 (fastest on the slider-crank, loses the five-bar).
    """

    method: str = "RK4"
    omega: dict[str, float] = field(default_factory=dict)
    """Baumgarte's frequency [1/s] by mechanism."""
    projects: bool = False

    def build(self, mechanism: str, step: float, stop_time: float) -> Simulation:
        import pinocchio as pin

        model, closures, q_0, v_0 = _pinocchio_model(pin, mechanism)
        omega = self.omega.get(mechanism, 0.0)
        models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for closure in closures:
            closure.m_baumgarte_parameters.Kp, closure.m_baumgarte_parameters.Kd = omega**2, 2 * omega
            models.append(closure)
            datas.append(closure.createData())
        data = model.createData()
        pin.initConstraintDynamics(model, data, models, datas)
        proximal = pin.ProximalSettings(1e-12, 1e-12, 1e-8, 10)
        tau, n, times = np.zeros(model.nv), model.nv, samples(stop_time)
        rows, zero = [i for k in range(len(closures)) for i in (3 * k, 3 * k + 1)], pin.Force.Zero()

        def accelerations(q: NDArray, v: NDArray) -> NDArray:
            return pin.constraintDynamics(model, data, q, v, tau, models, datas, proximal).copy()

        def project(q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
            pin.computeJointJacobians(model, data, q)
            for closure, at in zip(models, datas, strict=True):
                closure.calc(model, data, at)
            C = pin.getConstraintsJacobian(model, data, models, datas)[rows]
            gaps = [at.oMc1.rotation.T @ (at.oMc1.translation - at.oMc2.translation) for at in datas]
            phi = np.concatenate([gap[:2] for gap in gaps])
            change = np.linalg.lstsq(C, np.column_stack([phi, C @ v]), rcond=1e-6)[0]
            return q - change[:, 0], v - change[:, 1]

        moving, external = range(1, model.njoints), pin.StdVec_Force()
        external.extend([pin.Force.Zero() for _ in range(model.njoints)])
        ends = [
            (x.joint1_id, x.joint2_id, x.joint1_placement.copy(), x.joint2_placement.copy(), at)
            for x, at in zip(models, datas, strict=True)
        ]

        def forces(q: NDArray, v: NDArray, a: NDArray) -> NDArray:
            """Of joints and closures in their own frames (joints, then closures; 3), where q, v gave a just now."""
            for i in moving:
                external[i] = zero
            felt = []
            for first, second, place_1, place_2, at in ends:
                contact = at.contact_force
                external[first] += place_1.act(contact)
                external[second] -= place_2.act(at.c1Mc2.actInv(contact))
                felt.append(-contact.linear)
            pin.rnea(model, data, q, v, a, external)
            inner = data.f
            return np.array([inner[i].linear for i in moving] + felt)

        def runge_kutta() -> Trajectory:
            q, v, h, steps = q_0, v_0, step, whole(step)
            angles, felt = np.empty((len(times), n)), []
            for k in range(len(times)):
                if self.projects and k:
                    q, v = project(q, v)
                a1 = accelerations(q, v)
                angles[k] = q
                felt.append(forces(q, v, a1))
                for i in range(steps if k + 1 < len(times) else 0):
                    if i:
                        a1 = accelerations(q, v)
                    v2 = v + h / 2 * a1
                    a2 = accelerations(q + h / 2 * v, v2)
                    v3 = v + h / 2 * a2
                    a3 = accelerations(q + h / 2 * v2, v3)
                    v4 = v + h * a3
                    a4 = accelerations(q + h * v3, v4)
                    q, v = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            return Trajectory(times, angles[:, 0], _pinocchio_reactions(mechanism, angles, np.array(felt)))

        def adaptive() -> Trajectory:
            def rate(_: float, y: NDArray) -> NDArray:
                return np.concatenate([y[n:], accelerations(y[:n], y[n:])])

            states = _solved(rate, np.concatenate([q_0, v_0]), self.method, step, times)
            felt = np.array([forces(y[:n], y[n:], accelerations(y[:n], y[n:])) for y in states])
            return Trajectory(times[: len(states)], states[:, 0], _pinocchio_reactions(mechanism, states[:, :n], felt))

        return runge_kutta if self.method == "RK4" else adaptive


def _pinocchio_model(pin: ModuleType, mechanism: str) -> tuple:
    """Model, loop closures, q and v at the start; all joints turn about z or slide along x."""

    def at(x: float) -> object:
        return pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))

    def link(parent: int, x: float, name: str, length: float) -> int:
        joint = model.addJoint(parent, pin.JointModelRZ(), at(x), name)
        moment = length**2 / 12
        inertia = pin.Inertia(1.0, np.array([length / 2, 0, 0]), np.diag([0, moment, moment]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        return joint

    def close(first: int, x_1: float, second: int, x_2: float) -> object:
        frame, kind = pin.ReferenceFrame.LOCAL, pin.ContactType.CONTACT_3D
        return pin.RigidConstraintModel(kind, model, first, at(x_1), second, at(x_2), frame)

    model = pin.Model()
    model.gravity.linear = np.array([0, -GRAVITY, 0])
    A = link(0, 0.0, "A", 1.0 if mechanism == "five_bar" else CRANK)
    if mechanism == "five_bar":
        B, E = link(A, 1.0, "B", 1.0), link(A, 0.5, "E", 1.0)
        D = link(0, 1.0, "D", 1.0)
        closures = [close(B, 1.0, D, 1.0), close(E, 1.0, D, 0.5)]
        return model, closures, np.zeros(4), np.array([RATE, -RATE, -RATE, RATE])
    B = link(A, CRANK, "B", ROD)
    guide = model.addJoint(0, pin.JointModelPX(), at(0.0), "guide")
    model.appendBodyToJoint(guide, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    start = np.array([0.0, 0.0, CRANK + ROD]), np.array([RATE, -RATE * (1 + CRANK / ROD), 0.0])
    return model, [close(B, ROD, guide, 0.0)], *start


def _pinocchio_reactions(mechanism: str, q: NDArray, local: NDArray) -> NDArray:
    """Forces in ground axes, ordered as REACTIONS, from those in the frames of joints and closures (k, joints, 3)."""
    if mechanism == "five_bar":  # A, B, E, D, C on link 2, F on link 4
        link1, link2, link4, link3 = q[:, 0], q[:, 0] + q[:, 1], q[:, 0] + q[:, 2], q[:, 3]
        angles, order = np.column_stack([link1, link2, link4, link3, link2, link4]), [0, 1, 4, 3, 2, 5]
    else:  # A, B, guide, C on the rod
        crank, rod = q[:, 0], q[:, 0] + q[:, 1]
        angles, order = np.column_stack([crank, rod, np.zeros_like(rod), rod]), [0, 1, 3, 2]
    c, s, x, y = np.cos(angles), np.sin(angles), local[..., 0], local[..., 1]
    forces = np.stack([c * x - s * y, s * x + c * y], axis=-1)[:, order].reshape(len(q), -1)
    return forces if mechanism == "five_bar" else np.delete(forces, 6, axis=1)


@dataclass(frozen=True)
class Exudyn(Peer):
    """Exudyn's own solvers on 2D rigid bodies and revolute joints in redundant coordinates, reactions by its sensors.

    Tried: generalised alpha (index 3) with spectral radius 0.5 to 1 and as Newmark with index 2, and the trapezoidal
    rule (index 2), each with the three linear solvers, with and without `ignoreSingularJacobian`; Newton tolerances
    1e-6 to 1e-10, modified and full Newton; the build without range checks. Slider-crank: trapezoidal with EXUdense and
    full Newton is best (half the error of generalised alpha). Five-bar: only EigenDense with `ignoreSingularJacobian`
    takes the redundant constraint, and only generalised alpha with damping then passes the singular positions, with
    1e-4 s only where `adaptiveStep` may halve a step that fails. The trapezoidal rule stops at one; with `adaptiveStep`
    it takes up to 72 s and loses the motion. Explicit solvers refuse joints; joints as stiff springs (1e6 to 1e8 N/m)
    with RK44 and steps of 1e-4 s and above came no closer than 5e-4 rad.
    """

    solver: str = "GeneralizedAlpha"

    def build(self, mechanism: str, step: float, stop_time: float) -> Simulation:
        exu = _exudyn()
        mbs = exu.SystemContainer().AddSystem()
        node, joints = _exudyn_model(mbs, mechanism)
        kept = {"storeInternal": True, "writeToFile": False}
        from exudyn.itemInterface import SensorNode, SensorObject

        kinds = exu.OutputVariableType
        seen = mbs.AddSensor(SensorNode(nodeNumber=node, outputVariableType=kinds.Coordinates, **kept))
        felt = [mbs.AddSensor(SensorObject(objectNumber=j, outputVariableType=kinds.Force, **kept)) for j, _ in joints]
        mbs.Assemble()
        settings = exu.SimulationSettings()
        settings.solution.sensors.writePeriod = SAMPLE
        settings.solution.file.write = False
        settings.show.computationTime = False
        redundant = mechanism == "five_bar"
        settings.linearSolver.solverType = (
            exu.LinearSolverType.EigenDense if redundant else exu.LinearSolverType.EXUdense
        )
        settings.linearSolver.ignoreSingularJacobian = redundant
        march = settings.timeIntegration
        march.endTime, march.numberOfSteps, march.verboseMode = stop_time, round(stop_time / step), 0
        march.adaptiveStep = self.solver == "GeneralizedAlpha"
        march.newton.useModifiedNewton = redundant
        kind = getattr(exu.DynamicSolverType, self.solver)

        def simulate() -> Trajectory:
            note = ""
            try:
                mbs.SolveDynamic(settings, solverType=kind)
            except Exception as error:
                note = " ".join(str(error).split("[Python")[0].split()) or type(error).__name__
            table = mbs.GetSensorStoredData(seen)
            if table.size == 0:
                return Trajectory(np.zeros(0), np.zeros(0), None, note)
            forces = [
                sign * mbs.GetSensorStoredData(sensor)[:, 1:3] for sensor, (_, sign) in zip(felt, joints, strict=True)
            ]
            if mechanism == "slider_crank":
                forces[-1] = forces[-1][:, :1]
            return Trajectory(table[:, 0], table[:, 3], np.hstack(forces), note)

        return simulate


def _exudyn() -> ModuleType:
    """The module, the build without range checks where there is one, silent."""
    sys.exudynFast = True
    with contextlib.redirect_stdout(None):
        import exudyn as exu

    exu.config.printToConsole = False
    return exu


def _exudyn_model(mbs: Any, mechanism: str) -> tuple[object, list[tuple[object, float]]]:
    """Node of the first link, and the joints in the order of REACTIONS with the sign of their forces."""
    from exudyn import itemInterface as item

    def bar(length: float, x: float, vy: float, w: float) -> tuple:
        node = mbs.AddNode(item.NodeRigidBody2D(referenceCoordinates=[x, 0, 0], initialVelocities=[0, vy, w]))
        body = item.ObjectRigidBody2D(mass=1.0, inertia=length**2 / 12, nodeNumber=node)
        return node, weigh(mbs.AddObject(body))

    def weigh(body: object) -> object:
        marker = mbs.AddMarker(item.MarkerBodyMass(bodyNumber=body))
        mbs.AddLoad(item.LoadMassProportional(markerNumber=marker, loadVector=[0, -GRAVITY, 0]))
        return body

    def join(first: object, x_1: float, second: object, x_2: float) -> tuple[object, float]:
        markers = [
            mbs.AddMarker(item.MarkerBodyPosition(bodyNumber=body, localPosition=[x, 0, 0]))
            for body, x in ((first, x_1), (second, x_2))
        ]
        return mbs.AddObject(item.ObjectJointRevolute2D(markerNumbers=markers)), -1.0

    ground = mbs.AddObject(item.ObjectGround())
    if mechanism == "five_bar":
        node, link1 = bar(1.0, 0.5, RATE / 2, RATE)
        (_, link2), (_, link3) = bar(1.0, 1.5, RATE, 0.0), bar(1.0, 1.5, RATE / 2, RATE)
        _, link4 = bar(1.0, 1.0, RATE / 2, 0.0)
        ends = [
            (ground, 0.0, link1, -0.5),
            (link1, 0.5, link2, -0.5),
            (link2, 0.5, link3, 0.5),
            (ground, 1.0, link3, -0.5),
            (link1, 0.0, link4, -0.5),
            (link4, 0.5, link3, 0.0),
        ]
        return node, [join(*end) for end in ends]
    node, crank = bar(CRANK, CRANK / 2, RATE * CRANK / 2, RATE)
    _, rod = bar(ROD, CRANK + ROD / 2, RATE * CRANK / 2, -RATE * CRANK / ROD)
    point = mbs.AddNode(item.NodePoint2D(referenceCoordinates=[CRANK + ROD, 0]))
    slider = weigh(mbs.AddObject(item.ObjectMassPoint2D(mass=1.0, nodeNumber=point)))
    ends = [(ground, 0.0, crank, -CRANK / 2), (crank, CRANK / 2, rod, -ROD / 2), (rod, ROD / 2, slider, 0.0)]
    joints = [join(*end) for end in ends]
    zero = mbs.AddNode(item.NodePointGround(referenceCoordinates=[0, 0, 0]))
    track = [
        mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=zero, coordinate=0)),
        mbs.AddMarker(item.MarkerNodeCoordinate(nodeNumber=point, coordinate=1)),
    ]
    return node, [*joints, (mbs.AddObject(item.ObjectConnectorCoordinate(markerNumbers=track)), -1.0)]


@dataclass(frozen=True)
class MuJoCo(Peer):
    """MuJoCo on the tree of hinges that Pinocchio has, closed by `connect`; reactions by `mj_rnePostConstraint`.

    Its constraints are soft, so they are made as hard as it goes: solimp 0.9999 (its limit), solref as stiffness and
    critical damping with a stiffness of c / step^2, which needs refsafe off. Tried: stiffness 1e2 and 1e4 at every
    step, c from 0.01 to 4 (five-bar 2, slider-crank 0.2; 4 is worse with coarse steps); `diagexact` (spoils the
    five-bar); 1 to 50 solver iterations (equalities alone need one or two); implicit, implicitfast and discrete
    integrators (first order, and softer constraints on the five-bar or they diverge). One call of `mj_step` takes many
    steps.
    """

    integrator: str = "RK4"
    hardness: dict[str, float] = field(default_factory=dict)
    """Stiffness times step^2 (mass-normalised), by mechanism."""

    def build(self, mechanism: str, step: float, stop_time: float) -> Simulation:
        import mujoco

        warnings: list[str] = []
        mujoco.set_mju_user_warning(warnings.append)  # otherwise it writes a file into the working folder
        text, v_0 = _mujoco_model(mechanism, step, self.integrator, self.hardness[mechanism] / step**2)
        model = mujoco.MjModel.from_xml_string(text)
        data, times, steps = mujoco.MjData(model), samples(stop_time), whole(step)
        five = mechanism == "five_bar"

        def simulate() -> Trajectory:
            warnings.clear()
            mujoco.mj_resetData(model, data)
            data.qvel[:] = v_0
            angle, forces = np.empty(len(times)), np.empty((len(times), len(REACTIONS[mechanism])))
            for k in range(len(times)):
                if k:
                    mujoco.mj_step(model, data, steps)
                mujoco.mj_forward(model, data)
                mujoco.mj_rnePostConstraint(model, data)
                angle[k], tree, loop = data.qpos[0], data.cfrc_int[1:, 3:5], -data.efc_force
                if five:  # bodies: links 1, 2, 4, 3
                    forces[k, 0:4], forces[k, 4:6], forces[k, 6:8] = tree[:2].ravel(), loop[:2], tree[3]
                    forces[k, 8:10], forces[k, 10:12] = tree[2], loop[3:5]
                else:
                    forces[k, :4], forces[k, 4:6], forces[k, 6] = tree[:2].ravel(), loop[:2], tree[2, 1]
            return Trajectory(times, angle, forces, warnings[0].split(".")[0] if warnings else "")

        return simulate


def _mujoco_model(mechanism: str, step: float, integrator: str, stiffness: float) -> tuple[str, list[float]]:
    """MJCF text and joint rates at the start."""

    def bar(name: str, x: float, length: float, children: str = "") -> str:
        moment = length**2 / 12
        return (
            f'<body name="{name}" pos="{x} 0 0"><joint type="hinge" axis="0 0 1"/>'
            f'<inertial pos="{length / 2} 0 0" mass="1" diaginertia="1e-9 {moment} {moment}"/>{children}</body>'
        )

    def connect(first: str, second: str, x: float) -> str:
        return f'<connect body1="{first}" body2="{second}" anchor="{x} 0 0"/>'

    if mechanism == "five_bar":
        bodies = bar("1", 0, 1.0, bar("2", 1.0, 1.0) + bar("4", 0.5, 1.0)) + bar("3", 1.0, 1.0)
        loops, rates = connect("2", "3", 1.0) + connect("4", "3", 1.0), [RATE, -RATE, -RATE, RATE]
    else:
        slider = (
            f'<body name="3" pos="{CRANK + ROD} 0 0"><joint type="slide" axis="1 0 0"/>'
            '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
        )
        bodies, loops = bar("1", 0, CRANK, bar("2", CRANK, ROD)) + slider, connect("2", "3", ROD)
        rates = [RATE, -RATE * (1 + CRANK / ROD), 0.0]
    text = f"""<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>
<option timestep="{step!r}" gravity="0 {-GRAVITY} 0" integrator="{integrator}" solver="Newton" tolerance="1e-14"
 iterations="5" jacobian="dense"><flag contact="disable" refsafe="disable" autoreset="disable"/></option>
<default><equality solref="{-stiffness!r} {-2 * math.sqrt(stiffness)!r}" solimp="0.9999 0.9999 1"/></default>
<worldbody>{bodies}</worldbody><equality>{loops}</equality></mujoco>"""
    return text, rates


@dataclass(frozen=True)
class SciPy(Peer):
    """`solve_ivp` on the index-1 form (9) by least squares with Baumgarte's stabilisation, outputs by `t_eval`.

    `alfmu`: the equations of alfmu in one CasADi function, the slider-crank in joint coordinates. `typed`: the five-bar
    typed as a user would, with (9) or, faster, with the multipliers alone (C M^-1 C' lambda = C M^-1 F - xi).

    Tried on the five-bar: without stabilisation all leave the branch or do not end; omega from 5 to 200 1/s and
    cut-offs of the least squares from 1e-12 to 1e-3 (15 1/s and 1e-4 here; 5 1/s, and cut-offs of 1e-10 and less at
    20 1/s, are lost or do not end, and 200 1/s is slow). Slider-crank: omega 0, 3, 6, 20 (6 here), absolute, mixed and
    joint coordinates (joint here). DOP853 beats RK45; Radau and LSODA (slider-crank) gain nothing, since the equations
    are not stiff.
    """

    method: str = "DOP853"
    equations: str = "alfmu"
    """`alfmu`, `typed (9)` or `typed, reduced`."""

    def build(self, mechanism: str, step: float, stop_time: float) -> Simulation:
        omega, cut = {"five_bar": (15.0, 1e-4), "slider_crank": (6.0, None)}[mechanism]
        if self.equations == "alfmu":
            system = FromAlfmu(mechanism, omega, cut)
        elif mechanism == "five_bar":
            system = TypedFiveBar(omega, cut, self.equations == "typed, reduced")
        else:
            raise ValueError("only the five-bar is typed")
        times, n = samples(stop_time), system.n

        def rate(_: float, y: NDArray) -> NDArray:
            return np.concatenate([y[n:], system(y[:n], y[n:])[0]])

        def simulate() -> Trajectory:
            states = _solved(rate, system.start, self.method, step, times)
            solutions = [system(y[:n], y[n:]) for y in states]
            a, lam = (np.array([solution[i] for solution in solutions]) for i in (0, 1))
            return Trajectory(times[: len(states)], states[:, 0], system.reactions(states, a, lam))

        return simulate


def _solved(rate: Callable, start: NDArray, method: str, tolerance: float, times: NDArray) -> NDArray:
    """States at the samples, (k, 2 n); fewer where the solver gives up, TimeoutError where it does not end."""
    end = time.perf_counter() + 30

    def watched(t: float, y: NDArray) -> NDArray:
        if time.perf_counter() > end:
            raise TimeoutError(f"given up after 30 s at t = {t:.3g} s")
        return rate(t, y)

    return solve_ivp(watched, (0.0, times[-1]), start, method, times, rtol=tolerance, atol=tolerance).y.T


class FromAlfmu:
    """Accelerations and multipliers from alfmu's M, C, F = f - d, xi, Phi, evaluated together, and (9)."""

    def __init__(self, mechanism: str, omega: float, cut: float | None):
        self.mechanism, self.omega, self.cut = mechanism, omega, cut
        options = {"coordinates": "joint"} if mechanism == "slider_crank" else {}
        e = self.e = alfmu.derive(alfmu.load(mechanism, **options))
        instance = alfmu.Instance(e)
        for name, value in START[mechanism].items():
            instance.set(name, value)
        instance.initialize()
        self.n, self.l, self.start = e.n, e.l, np.concatenate([instance.q, instance.v])
        self.p, self.u = np.array([instance.get(v.name) for v in e.parameters]), np.zeros(len(e.inputs))
        q, v, p, u = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n), self.p, self.u
        C = e.C(q, p)
        results = [e.M(q, p), C, e.f(q, v, u, p, 0) - e.d(q, v, p), e.xi(q, v, p), e.Phi(q, p), C @ v]
        f = ca.Function("terms", [q, v], [ca.densify(x) for x in results], {"cse": True})
        self.q, self.v = np.zeros(e.n), np.zeros(e.n)
        self.terms = [np.zeros(f.size_out(i), order="F") for i in range(f.n_out())]
        self.buffer, self.evaluate = f.buffer()
        for i, x in enumerate((self.q, self.v)):
            self.buffer.set_arg(i, memoryview(x))
        for i, x in enumerate(self.terms):
            self.buffer.set_res(i, memoryview(x.reshape(-1, order="A")))
        self.K, self.b = np.zeros((e.n + e.l, e.n + e.l)), np.zeros(e.n + e.l)

    def __call__(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        n, omega = self.n, self.omega
        self.q[:], self.v[:] = q, v
        self.evaluate()
        M, C, F, xi, Phi, Cv = self.terms
        self.K[:n, :n], self.K[:n, n:], self.K[n:, :n] = M, C.T, C
        self.b[:n], self.b[n:] = F[:, 0], (xi - 2 * omega * Cv - omega**2 * Phi)[:, 0]
        x = np.linalg.lstsq(self.K, self.b, rcond=self.cut)[0]  # (9)
        return x[:n], x[n:]

    def reactions(self, states: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        names = [v.name for v in self.e.outputs]
        n, k = self.n, len(states)
        p, u = np.tile(self.p[:, None], k), np.tile(self.u[:, None], k)
        readings = self.e.readings(states[:, :n].T, states[:, n:].T, a.T, lam.T, u, p, np.zeros((1, k)))
        return np.array(readings)[[names.index(name) for name in REACTIONS[self.mechanism]]].T


class TypedFiveBar:
    """Case 4 of the paper in plain NumPy, q = [th1 x2 y2 th2 th3 x4 y4 th4], all lengths and masses 1."""

    n = 8
    start = np.array([0, 1.5, 0, 0, 0, 1, 0, 0, RATE, 0, RATE, 0, RATE, 0, RATE / 2, 0], float)

    def __init__(self, omega: float, cut: float, reduced: bool):
        self.omega, self.cut, self.reduced = omega, cut, reduced
        self.M = np.array([1 / 3, 1, 1, 1 / 12, 1 / 3, 1, 1, 1 / 12])
        self.F = np.array([0, 0, -GRAVITY, 0, 0, 0, -GRAVITY, 0])
        self.C = np.zeros((8, 8))
        self.C[range(8), [1, 2, 1, 2, 5, 6, 5, 6]] = 1.0
        self.K, self.b = np.zeros((16, 16)), np.zeros(16)
        self.K[range(8), range(8)] = self.M

    def __call__(self, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        th1, x2, y2, th2, th3, x4, y4, th4 = q.tolist()
        w1, _, _, w2, w3, _, _, w4 = v.tolist()
        s1, c1, s3, c3 = math.sin(th1), math.cos(th1), math.sin(th3), math.cos(th3)
        s2, c2, s4, c4 = math.sin(th2) / 2, math.cos(th2) / 2, math.sin(th4) / 2, math.cos(th4) / 2
        C, F, omega = self.C, self.F, self.omega
        C[0, 0], C[0, 3], C[1, 0], C[1, 3] = s1, s2, -c1, -c2
        C[2, 4], C[2, 3], C[3, 4], C[3, 3] = s3, -s2, -c3, c2
        C[4, 0], C[4, 7], C[5, 0], C[5, 7] = s1 / 2, s4, -c1 / 2, -c4
        C[6, 4], C[6, 7], C[7, 4], C[7, 7] = s3 / 2, -s4, -c3 / 2, c4
        u1, u2, u3, u4 = w1 * w1, w2 * w2, w3 * w3, w4 * w4
        xi = np.array(
            [
                -c2 * u2 - c1 * u1,
                -s2 * u2 - s1 * u1,
                c2 * u2 - c3 * u3,
                s2 * u2 - s3 * u3,
                -c4 * u4 - c1 / 2 * u1,
                -s4 * u4 - s1 / 2 * u1,
                c4 * u4 - c3 / 2 * u3,
                s4 * u4 - s3 / 2 * u3,
            ]
        )
        Phi = np.array(
            [
                x2 - c2 - c1,
                y2 - s2 - s1,
                x2 + c2 - c3 - 1,
                y2 + s2 - s3,
                x4 - c4 - c1 / 2,
                y4 - s4 - s1 / 2,
                x4 + c4 - c3 / 2 - 1,
                y4 + s4 - s3 / 2,
            ]
        )
        xi -= 2 * omega * (C @ v) + omega**2 * Phi
        F[0], F[4] = -GRAVITY / 2 * c1, -GRAVITY / 2 * c3
        if self.reduced:
            A = C / self.M
            lam = np.linalg.lstsq(A @ C.T, A @ F - xi, rcond=self.cut)[0]
            return (F - lam @ C) / self.M, lam
        self.K[8:, :8], self.K[:8, 8:], self.b[:8], self.b[8:] = C, C.T, F, xi
        x = np.linalg.lstsq(self.K, self.b, rcond=self.cut)[0]  # (9)
        return x[:8], x[8:]

    def reactions(self, states: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """B to F from the multipliers; A and D by Newton's law of links 1 and 3."""
        B, C, E, F = -lam[:, 0:2], lam[:, 2:4], -lam[:, 4:6], lam[:, 6:8]

        def pivot(k: int) -> NDArray:
            th, w, e = states[:, k], states[:, 8 + k], a[:, k]
            x, y = -np.sin(th) * e - np.cos(th) * w**2, np.cos(th) * e - np.sin(th) * w**2
            return np.column_stack([x / 2, y / 2 + GRAVITY])

        return np.hstack([pivot(0) + B + E, B, C, pivot(4) - C - F, E, F])


FINE = (0.02, 0.01, 0.005, 0.0025, 0.00125)
ADAPTIVE = (1e-5, 1e-6, 1e-7, 1e-8)


def both(steps: Sequence[float]) -> dict[str, Sequence[float]]:
    """The same steps for both mechanisms."""
    return dict.fromkeys(MECHANISMS, steps)


def peers() -> list[Peer]:
    """All that is compared; alfmu with every kernel it has."""
    kernels = [kernel for kernel in KERNELS if kernel not in ("oracle", "auto")]
    sliding = {"slider_crank": FINE}
    stabilised = {"five_bar": 60.0, "slider_crank": 5.0}
    hard, softer = {"five_bar": 2.0, "slider_crank": 0.2}, {"five_bar": 0.1, "slider_crank": 0.5}
    implicit = {"five_bar": (5e-3, 1e-3, 2e-4, 1e-4, 4e-5), "slider_crank": (5e-3, 1e-3)}
    trapezoidal = {"five_bar": (5e-3, 1e-3), "slider_crank": (5e-3, 1e-3, 2e-4, 5e-5)}
    loose = {"five_bar": (1e-6, 1e-8), "slider_crank": ADAPTIVE}
    radau = {"slider_crank": (1e-5, 1e-6)}
    own, joint = "alfmu's equations", "joint coordinates"
    return [
        *(Alfmu("alfmu", "alfmu", k, both(FINE), quick=3, kernel=k) for k in kernels),
        *(Alfmu("alfmu", "alfmu", f"{k}, {joint}", sliding, quick=3, kernel=k, coordinates="joint") for k in kernels),
        Alfmu("alfmu", "alfmu", "oracle", both((0.01,)), quick=0, kernel="oracle"),
        Pinocchio("pin", "Pinocchio", "RK4, Baumgarte", both(FINE), quick=3, omega=stabilised),
        Pinocchio("pin", "Pinocchio", "RK4, projection", both(FINE), projects=True),
        Pinocchio("pin", "Pinocchio", "DOP853, Baumgarte", loose, "rtol", method="DOP853", omega=stabilised),
        Exudyn("exudyn", "Exudyn", "generalized alpha", implicit),
        Exudyn("exudyn", "Exudyn", "trapezoidal, index 2", trapezoidal, solver="TrapezoidalIndex2"),
        Exudyn("exudyn", "Exudyn", "explicit RK44", both((1e-3,)), solver="RK44"),
        MuJoCo("mujoco", "MuJoCo", "RK4", both((0.01, 0.005, 0.004, 0.002, 0.001, 0.0005)), quick=3, hardness=hard),
        MuJoCo("mujoco", "MuJoCo", "implicitfast", both((0.002, 0.0005)), integrator="implicitfast", hardness=softer),
        SciPy("scipy", "SciPy", "DOP853, typed, reduced", {"five_bar": ADAPTIVE}, "rtol", equations="typed, reduced"),
        SciPy("scipy", "SciPy", "DOP853, typed (9)", {"five_bar": ADAPTIVE}, "rtol", 0, equations="typed (9)"),
        SciPy("scipy", "SciPy", f"DOP853, {own}", both(ADAPTIVE), "rtol"),
        SciPy("scipy", "SciPy", f"RK45, {own}", both((1e-6, 1e-7, 1e-8)), "rtol", 0, method="RK45"),
        SciPy("scipy", "SciPy", f"Radau, {own}", radau, "rtol", 0, method="Radau"),
    ]


# Study ------------------------------------------------------------------------------------------------------------


@dataclass
class Point:
    """One peer on one mechanism with one step: a row of the results."""

    peer: Peer
    mechanism: str
    step: float
    error: float | None = None
    """Largest angle error, rad."""
    force_error: float | None = None
    """Largest error of the reactions that are unique, N."""
    seconds: list[float] = field(default_factory=list)
    setup: float | None = None
    note: str = ""
    simulate: Simulation | None = None

    @property
    def median(self) -> float | None:
        return statistics.median(self.seconds) if self.seconds else None

    @property
    def least(self) -> float | None:
        return min(self.seconds, default=None)


def measure(points: Sequence[Point], references: dict[str, Reference], repeats: int, more: int) -> None:
    """Build and judge every point, then time those that ran: in rounds, each in a new order."""
    for point in tqdm(points, "errors", unit="run"):
        if not point.peer.installed:
            point.note = "not installed"
            continue
        try:
            _judge(point, references[point.mechanism])
        except Exception as error:  # a lost run is a result
            point.note, point.simulate = f"{type(error).__name__}: {' '.join(str(error).split())[:160]}", None
    ready, order = [point for point in points if point.simulate], random.Random(SEED)
    for k in tqdm(range(repeats + more), "timing", unit="round"):
        turn = [point for point in ready if k < repeats or min(point.seconds) < SHORT]
        for point in tqdm(order.sample(turn, len(turn)), "round", unit="run", leave=False):
            begin = time.perf_counter()
            point.simulate()
            point.seconds.append(time.perf_counter() - begin)


def _judge(point: Point, exact: Reference) -> None:
    """Errors of one run; what did not reach the end is not timed."""
    begin = time.perf_counter()
    simulate = point.peer.build(point.mechanism, point.step, STOP)
    point.setup = time.perf_counter() - begin
    with np.errstate(all="ignore"):
        run = simulate()
    point.note = run.note
    if len(run.times) < len(exact.angle):
        reached = run.times[-1] if len(run.times) else 0.0
        point.note = f"stopped at t = {reached:.3g} s: {run.note}"
        return
    point.simulate, error = simulate, float(np.abs(run.angle - exact.angle).max())
    point.error = error if math.isfinite(error) else None
    if point.error is None or point.error > LOST:
        point.note = "; ".join(filter(None, ("lost the motion", run.note)))
        return
    if run.reactions is not None:
        gap = unique(point.mechanism, run.reactions) - unique(point.mechanism, exact.reactions)
        point.force_error = float(np.abs(gap).max())


class Reach(NamedTuple):
    """Run time at which one setting reaches the target error, and how to say it."""

    median: float | None
    least: float | None
    text: str
    bound: str = ""
    """`<= ` where the coarsest point is already below the target."""


def reach(points: Sequence[Point]) -> Reach:
    """Run time at TARGET by log-log interpolation between neighbouring points; `points` from coarse to fine."""
    known = [p for p in points if p.error and p.seconds and p.error <= LOST]
    if not known:
        return Reach(None, None, "not reached")
    if known[0].error <= TARGET:
        return Reach(known[0].median, known[0].least, f"<= {known[0].median:.3g}", "<= ")
    for p, finer in pairwise(known):
        if p.error > TARGET >= finer.error:
            share = math.log(p.error / TARGET) / math.log(p.error / finer.error)
            median, least = p.median * (finer.median / p.median) ** share, p.least * (finer.least / p.least) ** share
            return Reach(median, least, f"{median:.3g}")
    return Reach(None, None, f"not reached (best {min(p.error for p in known):.2g} rad)")


def settings(points: Sequence[Point], mechanism: str) -> dict[tuple[str, str], list[Point]]:
    """Points of one mechanism by peer and setting."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        if point.mechanism == mechanism:
            groups.setdefault((point.peer.name, point.peer.setting), []).append(point)
    return groups


# Report -----------------------------------------------------------------------------------------------------------

LIMITS = """\
Run times are those of small mechanisms called from Python on a shared machine; only ratios within one run mean
something. alfmu is measured as a library; through an FMU every step costs more. Its compiled kernel, Exudyn and MuJoCo
step in compiled code, its vm kernel in CasADi's virtual machine; Pinocchio evaluates in compiled code and is stepped in
Python, and SciPy is Python throughout. All are single-threaded. alfmu and SciPy (alfmu's equations) compute every
output of the mechanism at a sample, the others only angles and joint forces. Pinocchio and MuJoCo describe the
mechanisms by joint angles, in which the five-bar's parallelogram is a straight line; alfmu and Exudyn by absolute
coordinates of torn-off bodies. Peers were tuned to these two motions with the exact ones at hand, alfmu runs with its
defaults; other mechanisms need the tuning again. Some points are luckier than their neighbours (MuJoCo on the five-bar
at 0.004 s). MuJoCo's forces belong to slightly soft constraints. The error in the reactions is taken at equal times and
so contains the error of the motion, and only what rigid bodies determine is compared."""


def rounded(x: float | None, digits: int = 3) -> str:
    return "-" if x is None else f"{x:.{digits}g}"


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(str(x).replace("|", "\\|") for x in line) + " |" for line in lines)


def environment(command: str, packages: Sequence[str]) -> list[tuple[str, str]]:
    """Where and with what the study ran."""
    return [
        ("command", f"`{command}`"),
        ("system", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("processor", f"{_processor()}, {os.cpu_count()} logical"),
        ("Python", f"{platform.python_implementation()} {platform.python_version()}"),
        *((name, _version(name)) for name in packages),
    ]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


COLUMNS = (
    "peer",
    "version",
    "mechanism",
    "setting",
    "control",
    "step",
    "angle error [rad]",
    "reaction error [N]",
    "run time median [s]",
    "run time min [s]",
    "repeats",
    "set-up [s]",
    "note",
)


def exact_row(p: Point) -> list:
    """A row of the CSV file."""
    numbers = [p.error, p.force_error, p.median, p.least, len(p.seconds), p.setup]
    head = [p.peer.name, p.peer.installed, p.mechanism, p.peer.setting, p.peer.control, p.step]
    return [*head, *("" if x is None else x for x in numbers), p.note]


def reach_rows(points: Sequence[Point], mechanism: str) -> tuple[list[str], list[list[str]]]:
    """Run times at the target by setting, and their ratios to alfmu's kernels in default coordinates."""
    groups = settings(points, mechanism)
    reached = {key: reach(group) for key, group in groups.items()}
    kernels = {s: r for (name, s), r in reached.items() if name == "alfmu" and s in KERNELS and s != "oracle"}
    own = {s: r for s, r in kernels.items() if r.median}
    columns = ["peer", "setting", f"time at {TARGET:g} rad [s]", "by least times [s]"]
    columns += [text for kernel in own for text in (f"ratio to alfmu {kernel}", "by least times")]
    rows = []
    for (name, setting), r in reached.items():
        note = groups[name, setting][0].note
        row = [name, setting, note if note == "not installed" else r.text, r.bound + rounded(r.least)]
        for kernel in own.values():
            row += [r.bound + rounded(r.median and r.median / kernel.median)]
            row += [r.bound + rounded(r.least and r.least / kernel.least)]
        rows.append(row)
    return columns, rows


def report(points: Sequence[Point], references: dict[str, Reference], command: str) -> str:
    """The report in Markdown."""
    packages = list(dict.fromkeys([p.peer.package for p in points] + ["casadi", "numpy"]))
    parts = ["# Peers: error against run time", table(("what", "value"), environment(command, packages))]
    parts += [
        f"{STOP:g} s of simulated time from angle 0 with {RATE:g} rad/s under gravity; angle and all joint forces\n"
        f"every {SAMPLE:g} s. Errors are the largest over the run. Repeats in rounds of random order; building the\n"
        "model apart (the first point of an alfmu kernel derives, traces and compiles; a compiled library may come\n"
        "from the user's cache). `rtol` means an adaptive step with that relative and absolute tolerance.",
    ]
    rows = [(name, f"{r.change:.1e}", f"{r.energy:.1e}") for name, r in references.items()]
    columns = ("reference", "change between two tolerances [rad]", "change of energy (relative)")
    parts += ["**The references' own errors**", table(columns, rows)]
    for mechanism in references:
        parts += [f"## {mechanism}", f"**Run time at {TARGET:g} rad** (`peers_reach.csv`)"]
        parts += [table(*reach_rows(points, mechanism))]
        parts += [
            "By log-log interpolation between the two measured points around the target; `<=` where the coarsest\n"
            "point is already below it. Of medians, and of the least of all repeats, which load from outside disturbs\n"
            "less. A ratio above 1 means that alfmu is faster.",
            "**All points** (`peers.csv`)",
        ]
        rows = [
            [
                p.peer.name,
                p.peer.setting,
                f"{p.peer.control} {p.step:g}",
                *map(rounded, (p.error, p.force_error, p.median, p.least)),
                len(p.seconds),
                rounded(p.setup, 2),
                p.note,
            ]
            for p in points
            if p.mechanism == mechanism
        ]
        head = (
            "peer",
            "setting",
            "step [s] or rtol",
            "angle error [rad]",
            "reaction error [N]",
            "median [s]",
            "min [s]",
            "repeats",
            "set-up [s]",
            "note",
        )
        parts += [table(head, rows)]
    return "\n\n".join([*parts, "## Where the comparison stops being fair", LIMITS]) + "\n"


def chosen_points(quick: bool) -> list[Point]:
    """All points, or few of each setting."""
    points = []
    for mechanism in MECHANISMS:
        for peer in peers():
            steps = peer.steps.get(mechanism, ())
            points += [Point(peer, mechanism, step) for step in steps[: peer.quick if quick else None]]
    return points


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Measure error against run time of alfmu, Pinocchio, Exudyn, MuJoCo and SciPy on the five-bar and "
        "the slider-crank. Writes peers.md, peers.csv and peers_reach.csv.",
        epilog="needs scipy, and of pin, exudyn, mujoco what is to be measured; takes some minutes; overwrites an "
        "earlier run in the same folder",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("results/peers"), help="folder (default: %(default)s)"
    )
    parser.add_argument("--quick", action="store_true", help="few steps of each setting, none of the slow ones")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="timed runs of each point (default: %(default)s)")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the results."""
    chosen = parse(arguments)
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"{chosen.output} cannot hold the results ({error.strerror}); give another with -o", file=sys.stderr)
        return 1
    references = {mechanism: reference(mechanism) for mechanism in MECHANISMS}
    points = chosen_points(chosen.quick)
    measure(points, references, chosen.repeats, 0 if chosen.quick else MORE)
    with (chosen.output / "peers.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([COLUMNS, *(exact_row(p) for p in points)])
    with (chosen.output / "peers_reach.csv").open("w", newline="", encoding="utf-8") as file:
        for mechanism in MECHANISMS:
            columns, rows = reach_rows(points, mechanism)
            csv.writer(file).writerows([["mechanism", *columns], *([mechanism, *row] for row in rows)])
    flags = " --quick" * chosen.quick + f" --repeats {chosen.repeats}" * (chosen.repeats != REPEATS)
    text = report(points, references, f"python scripts/peers.py -o {chosen.output.as_posix()}{flags}")
    (chosen.output / "peers.md").write_text(text, encoding="utf-8")
    print(chosen.output / "peers.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
