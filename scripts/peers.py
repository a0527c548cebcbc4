"""Error against run time of alfmu and of what else a Python user might take, on two closed-loop mechanisms.

A run lasts 20 s of simulated time and delivers, every 0.02 s, the angle of the first link and the forces of all joints;
its error is the largest difference of that angle from the exact motion. Building the model is timed apart. Writes
`peers.md`, `peers.csv` (all runs), `peers_reach.csv` (run times at equal error) and `peers.png` into one folder.

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
import itertools
import math
import random
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import casadi as ca
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg.lapack import dgelsy
from tqdm import tqdm

import alfmu
from alfmu.simulation import prepared
from alfmu.specialisation import specialised
from alfmu.tables import Cell, environment, markdown, rounded, write_csv

matplotlib.use("Agg")

GRAVITY = 9.81
RATE = 2.0
"""Start of both mechanisms: angle 0 with this rate [rad/s]."""

STOP, SAMPLE = 20.0, 0.02
"""Simulated time and distance of samples [s]."""

TARGET, RATIO = 1e-6, 5.0
"""Angle error [rad] at which run times are compared, and how much slower the best peer is wanted to be."""

LOST = 0.1
"""Angle error [rad] from which a run counts as having lost the motion."""

ROUNDS, LEAST, BUDGET = 12, 3, 2.0
"""Timed rounds; each point takes part in the first few, and in more until it has used so much time [s]."""

SEED = 1
"""Of the order within each round, so that load from outside does not always meet the same peer."""

EVALUATIONS = 100_000
"""Evaluations after which an adaptive integrator is stopped."""

CRANK, ROD = 0.5, 1.0
"""Lengths of the slider-crank [m]."""

MECHANISMS = ("five_bar", "slider_crank")
ANGLE = {"five_bar": "link1.angle", "slider_crank": "crank.angle"}
REACTIONS = {
    "five_bar": [f"{joint}.force.{axis}" for joint in "ABCDEF" for axis in "xy"],
    "slider_crank": [*(f"{joint}.force.{axis}" for joint in "ABC" for axis in "xy"), "guide.force"],
}


class Trajectory(NamedTuple):
    """What one run delivers at the samples."""

    times: NDArray
    """(k,) s"""
    angle: NDArray
    """(k,) of link 1 or crank, rad"""
    reactions: NDArray
    """(k, number of REACTIONS), N"""
    note: str = ""


Simulation = Callable[[], Trajectory]
"""One run from the start; may be called again and again."""


def samples(stop_time: float) -> NDArray:
    """0, 0.02, ... stop_time [s]."""
    return np.arange(round(stop_time / SAMPLE) + 1) * SAMPLE


def solved(rate: Callable, start: NDArray, method: str, tolerance: float, times: NDArray) -> NDArray:
    """States at the times by `solve_ivp`, (k, 2 n); fewer where it gives up, TimeoutError where it does not end."""
    count = itertools.count()

    def counted(t: float, y: NDArray) -> NDArray:
        if next(count) > EVALUATIONS:
            raise TimeoutError(f"{EVALUATIONS} evaluations at t = {t:.3g} s")
        return rate(y)

    return solve_ivp(counted, (0.0, times[-1]), start, method, times, rtol=tolerance, atol=tolerance).y.T


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


def reference(mechanism: str, stop_time: float) -> Reference:
    """J th'' + J' w^2 / 2 + V' = 0 until stop_time [s], by DOP853 with tolerances 1e-13, steps of at most 0.01 s."""
    times, weight = samples(stop_time), WEIGHT[mechanism]

    def acceleration(th: NDArray, w: NDArray) -> NDArray:
        J, slope = inertia(mechanism, th)
        return -(slope * w**2 / 2 + weight * np.cos(th)) / J

    def motion(tolerance: float, largest: float) -> NDArray:
        options = {"t_eval": times, "rtol": tolerance, "atol": tolerance, "max_step": largest}
        return solve_ivp(lambda _, y: (y[1], acceleration(*y)), (0, times[-1]), (0, RATE), "DOP853", **options).y

    th, w = motion(1e-13, 0.01)
    change = np.abs(motion(1e-12, 0.0137)[0] - th).max()
    drift = np.ptp(inertia(mechanism, th)[0] * w**2 / 2 + weight * np.sin(th)) / np.ptp(weight * np.sin(th))
    reactions = _five_bar_reactions if mechanism == "five_bar" else _slider_crank_reactions
    return Reference(th, reactions(th, w, acceleration(th, w)), float(change), float(drift))


WEIGHT = {"five_bar": (1 / 2 + 1 / 2 + 1 + 1 / 2) * GRAVITY, "slider_crank": CRANK * GRAVITY}
"""Potential energy over the sine of the angle, (m1/2 + m3/2 + m2 + m4/2) g l and (m1 + m2) g l1/2 [J]."""


def inertia(mechanism: str, th: NDArray) -> tuple[NDArray | float, NDArray | float]:
    """J of the kinetic energy J w^2 / 2 [kg.m2], and dJ/dth; the five-bar's on the parallelogram branch."""
    if mechanism == "five_bar":
        return 1 / 3 + 1 / 3 + 1 + 1 / 4, 0.0  # (m1/3 + m3/3 + m2 + m4/4) l^2
    _, _, p1, p2, x21, x22, y21, y22, x31, x32 = _slider_crank_geometry(th)
    J = CRANK**2 / 3 + x21**2 + y21**2 + ROD**2 / 12 * p1**2 + x31**2
    return J, 2 * (x21 * x22 + y21 * y22 + ROD**2 / 12 * p1 * p2 + x31 * x32)


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


def unique(mechanism: str, reactions: NDArray) -> NDArray:
    """What rigid bodies determine: all, but of the five-bar's along x what no tension between its couplers changes."""
    if mechanism == "slider_crank":
        return reactions
    x, y = reactions[:, ::2], reactions[:, 1::2]
    A, B, C, D, E, F = range(6)
    return np.column_stack([y, x[:, B] - x[:, C], x[:, E] - x[:, F], x[:, A] + x[:, D]])


# Peers ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Peer:
    """One way to simulate: `build` makes a simulation of a mechanism with a step [s] or tolerance, for those times."""

    package: str
    """Distribution whose version is reported."""
    name: str
    setting: str
    steps: Mapping[str, Sequence[float]]
    """Steps [s] that divide 0.02 s, or tolerances, by mechanism; the coarsest first."""
    control: str = "step"
    """What the step is: `step` [s] or `rtol`."""
    quick: int = 2
    """How many of the steps a quick study takes."""

    def build(self, mechanism: str, step: float, times: NDArray) -> Simulation:
        raise NotImplementedError

    @property
    def installed(self) -> bool:
        try:
            return bool(version(self.package))
        except PackageNotFoundError:
            return False


@dataclass(frozen=True)
class Alfmu(Peer):
    """The library's `Instance`; `step` is `solver.step_size` [s], all other settings are the defaults."""

    kernel: str = "compiled"
    lean: bool = False
    """With the outputs that are wanted alone, constant parameters, in joint coordinates."""

    def build(self, mechanism: str, step: float, times: NDArray) -> Simulation:
        instance = started(_equations(mechanism, self.kernel, self.lean), step)
        start, points = instance.save(), times.tolist()
        names = [v.name for v in instance.outputs]
        columns = [names.index(name) for name in (ANGLE[mechanism], *REACTIONS[mechanism])]

        def simulate() -> Trajectory:
            instance.restore(start)
            rows = np.empty((len(points), len(names)))
            rows[0] = instance.read()
            for i, t in enumerate(points[:-1], 1):
                instance.step(SAMPLE, t)
                rows[i] = instance.read()
            return Trajectory(times, rows[:, columns[0]], rows[:, columns[1:]])

        return simulate


def started(equations: alfmu.Equations, step: float = SAMPLE) -> alfmu.Instance:
    """An instance at angle 0 with RATE, with this internal step [s]."""
    instance = alfmu.Instance(equations, alfmu.Settings(step_size=step))
    instance.set("start.angle", 0.0)
    instance.set("start.angular_velocity", RATE)
    instance.initialize()
    return instance


@cache
def _equations(mechanism: str, kernel: str, lean: bool) -> alfmu.Equations:
    """Derived, traced and compiled once; so the first point of a setting has the set-up time."""
    options = {"coordinates": "joint"} if lean else {}
    equations = alfmu.derive(alfmu.load(mechanism, **options))
    if lean:
        equations = specialised(equations, [ANGLE[mechanism], *REACTIONS[mechanism]], ["all"])
    return prepared(equations, kernel)


@dataclass(frozen=True)
class Pinocchio(Peer):
    """`pin.constraintDynamics` (proximal) on a tree of joints, closed by CONTACT_3D; `pin.rnea` for joint forces."""

    method: str = "RK4"
    """RK4, or a method of `solve_ivp`."""
    omega: Mapping[str, float] = field(default_factory=dict)
    """Frequency of Baumgarte's stabilisation [1/s] by mechanism, critically damped."""

    def build(self, mechanism: str, step: float, times: NDArray) -> Simulation:
        import pinocchio as pin

        model, closures, start = _pinocchio_model(pin, mechanism)
        omega = self.omega.get(mechanism, 0.0)
        models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for closure in closures:
            closure.m_baumgarte_parameters.Kp, closure.m_baumgarte_parameters.Kd = omega**2, 2 * omega
            models.append(closure)
            datas.append(closure.createData())
        data, n = model.createData(), model.nv
        pin.initConstraintDynamics(model, data, models, datas)
        proximal, tau = pin.ProximalSettings(1e-12, 1e-12, 1e-8, 3), np.zeros(n)
        dynamics, rnea = pin.constraintDynamics, pin.rnea
        states, contacts = np.empty((len(times), 2 * n)), np.empty((len(times), 3 * len(closures)))
        felt, inner = np.empty((len(times), n, 3)), [force.linear for force in data.f][1:]  # views

        def record(k: int, y: NDArray, a: NDArray) -> None:
            """Forces without those of the closures in the frames of the joints, where y gave a just now."""
            states[k], contacts[k] = y, data.lambda_c
            rnea(model, data, y[:n], y[n:], a)
            felt[k] = inner

        def runge_kutta() -> Trajectory:
            y, s, K = start.copy(), np.empty(2 * n), np.empty((4, 2 * n))
            q, v, weights, steps = s[:n], s[n:], np.array([1, 2, 2, 1]) * step / 6, range(round(SAMPLE / step))
            stages = list(zip(K, K[:, :n], K[:, n:], (step / 2, step / 2, step, 0.0), strict=True))
            for k in range(len(times)):
                for i in steps:
                    s[:] = y
                    for stage, (rate, qdot, a, share) in enumerate(stages):
                        qdot[:] = v
                        a[:] = dynamics(model, data, q, v, tau, models, datas, proximal)
                        if i + stage == 0:
                            record(k, y, a)
                        np.multiply(rate, share, out=s)
                        s += y
                    y += weights @ K
            return Trajectory(times, states[:, 0].copy(), _pinocchio_reactions(mechanism, states, felt, contacts))

        def rate(y: NDArray) -> NDArray:
            out = np.empty(2 * n)
            out[:n], out[n:] = y[n:], dynamics(model, data, y[:n], y[n:], tau, models, datas, proximal)
            return out

        def adaptive() -> Trajectory:
            found = solved(rate, start, self.method, step, times)
            for k, y in enumerate(found):
                record(k, y, rate(y)[n:])
            reactions = _pinocchio_reactions(mechanism, states, felt, contacts)[: len(found)]
            return Trajectory(times[: len(found)], found[:, 0], reactions)

        return runge_kutta if self.method == "RK4" else adaptive


def _pinocchio_model(pin: ModuleType, mechanism: str) -> tuple:
    """Model, loop closures, q and v at the start; joints turn about z or slide along x, and are added depth first."""

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
        return model, closures, np.array([0, 0, 0, 0, RATE, -RATE, -RATE, RATE])
    B = link(A, CRANK, "B", ROD)
    guide = model.addJoint(0, pin.JointModelPX(), at(0.0), "guide")
    model.appendBodyToJoint(guide, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    start = np.array([0, 0, CRANK + ROD, RATE, -RATE * (1 + CRANK / ROD), 0])
    return model, [close(B, ROD, guide, 0.0)], start


def _pinocchio_reactions(mechanism: str, q: NDArray, felt: NDArray, contacts: NDArray) -> NDArray:
    """REACTIONS (k, ...) from joint forces without closures and forces on the closures' first bodies, in own frames."""

    def ground(angle: NDArray, force: NDArray) -> NDArray:
        c, s, x, y = np.cos(angle), np.sin(angle), force[:, 0], force[:, 1]
        return np.column_stack([c * x - s * y, s * x + c * y])

    angles = [q[:, 0], q[:, 0] + q[:, 1]]
    if mechanism == "slider_crank":
        A, B = (ground(angle, felt[:, i]) for i, angle in enumerate(angles))
        C = ground(angles[1], contacts)
        return np.column_stack([A - C, B - C, -C, (felt[:, 2] + np.pad(C, ((0, 0), (0, 1))))[:, 1]])
    angles += [q[:, 0] + q[:, 2], q[:, 3]]
    A, B, E, D = (ground(angle, felt[:, i]) for i, angle in enumerate(angles))
    C, F = ground(angles[1], contacts[:, :3]), ground(angles[2], contacts[:, 3:])
    return np.hstack([A - C - F, B - C, -C, D + C + F, E - F, -F])


@dataclass(frozen=True)
class Exudyn(Peer):
    """Exudyn's own solvers on 2D rigid bodies and joints in redundant coordinates, reactions by its sensors."""

    solver: str = "GeneralizedAlpha"

    def build(self, mechanism: str, step: float, times: NDArray) -> Simulation:
        sys.exudynFast = True  # the build without range checks, where there is one
        with contextlib.redirect_stdout(None):
            import exudyn as exu
        exu.config.printToConsole = False
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
        march.endTime, march.numberOfSteps, march.verboseMode = times[-1], round(times[-1] / step), 0
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
                return Trajectory(np.zeros(0), np.zeros(0), np.zeros((0, 0)), note)
            forces = [
                sign * mbs.GetSensorStoredData(sensor)[:, 1:3] for sensor, (_, sign) in zip(felt, joints, strict=True)
            ]
            if mechanism == "slider_crank":
                forces[-1] = forces[-1][:, :1]
            return Trajectory(table[:, 0], table[:, 3], np.hstack(forces), note)

        return simulate


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
    """MuJoCo on the tree of joints that Pinocchio has, closed by `connect`; reactions by `mj_rnePostConstraint`."""

    integrator: str = "RK4"
    hardness: Mapping[str, float] = field(default_factory=dict)
    """Stiffness times step^2 (mass-normalised), by mechanism."""

    def build(self, mechanism: str, step: float, times: NDArray) -> Simulation:
        import mujoco

        warnings: list[str] = []
        mujoco.set_mju_user_warning(warnings.append)  # otherwise it writes a file into the working folder
        text, v_0 = _mujoco_model(mechanism, step, self.integrator, self.hardness[mechanism] / step**2)
        model = mujoco.MjModel.from_xml_string(text)
        data, steps, five = mujoco.MjData(model), round(SAMPLE / step), mechanism == "five_bar"

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
    """`solve_ivp` on alfmu's M, C, f, xi, Phi in the index-1 form (9), by elimination of a and least squares."""

    method: str = "DOP853"

    def build(self, mechanism: str, step: float, times: NDArray) -> Simulation:
        five = mechanism == "five_bar"
        omega, cut, options = (15.0, 1e-4, {}) if five else (6.0, 1e-12, {"coordinates": "joint"})
        e = alfmu.derive(alfmu.load(mechanism, **options))
        instance, n, l = started(e), e.n, e.l
        start, p, u = np.concatenate([instance.q, instance.v]), instance.values[: len(e.parameters)], instance.inputs
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
            states = solved(rate, start, self.method, step, times)
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
    steps, rtols = [SAMPLE / k for k in (1, 2, 3, 4, 8, 16)], (1e-5, 1e-6, 1e-7, 1e-8)
    fine, adaptive = dict.fromkeys(MECHANISMS, steps), dict.fromkeys(MECHANISMS, rtols)
    tight = {"five_bar": (1e-7, 1e-8, 1e-9), "slider_crank": (1e-6, 1e-7, 1e-8, 1e-9)}
    loop = {"five_bar": (1e-6, 1e-8, 1e-10), "slider_crank": (*rtols, 1e-9)}
    stabilised = {"five_bar": 60.0, "slider_crank": 5.0}
    alpha = {"five_bar": (5e-3, 1e-3, 2e-4, 1e-4, 4e-5), "slider_crank": (5e-3, 1e-3)}
    trapezoidal = {"five_bar": (5e-3, 1e-3), "slider_crank": (5e-3, 1e-3, 2e-4, 5e-5)}
    soft = {mechanism: [SAMPLE / k for k in (2, 4, 5, 8, 10, 20, 40)] for mechanism in MECHANISMS}
    softer = {mechanism: [SAMPLE / k for k in (10, 40)] for mechanism in MECHANISMS}
    first, second = {"five_bar": 2.0, "slider_crank": 0.2}, {"five_bar": 0.1, "slider_crank": 0.5}
    return [
        Alfmu("alfmu", "alfmu", "compiled", fine, quick=4),
        Alfmu("alfmu", "alfmu", "compiled, lean", fine, quick=4, lean=True),
        Alfmu("alfmu", "alfmu", "vm", fine, quick=4, kernel="vm"),
        Alfmu("alfmu", "alfmu", "vm, lean", fine, quick=4, kernel="vm", lean=True),
        Pinocchio("pin", "Pinocchio", "RK4, Baumgarte", fine, quick=5, omega=stabilised),
        Pinocchio("pin", "Pinocchio", "RK4, not stabilised", fine, quick=1),
        Pinocchio("pin", "Pinocchio", "DOP853, Baumgarte", loop, "rtol", 3, method="DOP853", omega=stabilised),
        Pinocchio("pin", "Pinocchio", "LSODA, Baumgarte", loop, "rtol", method="LSODA", omega=stabilised),
        Exudyn("exudyn", "Exudyn", "generalized alpha", alpha),
        Exudyn("exudyn", "Exudyn", "trapezoidal, index 2", trapezoidal, solver="TrapezoidalIndex2"),
        MuJoCo("mujoco", "MuJoCo", "RK4", soft, quick=3, hardness=first),
        MuJoCo("mujoco", "MuJoCo", "implicitfast", softer, quick=1, integrator="implicitfast", hardness=second),
        SciPy("scipy", "SciPy", "DOP853", adaptive, "rtol", 3),
        SciPy("scipy", "SciPy", "RK45", tight, "rtol", 0, method="RK45"),
        SciPy("scipy", "SciPy", "LSODA", tight, "rtol", 0, method="LSODA"),
    ]


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
    """Run time in each round [s]."""
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


def judge(point: Point, exact: Reference, times: NDArray) -> None:
    """Errors of one run, which is not timed; what does not reach the end with the motion is not timed at all."""
    try:
        begin = time.perf_counter()
        simulate = point.peer.build(point.mechanism, point.step, times)
        point.setup = time.perf_counter() - begin
        with np.errstate(all="ignore"):
            run = simulate()
    except Exception as error:  # a lost run is a result
        point.note = f"{type(error).__name__}: {' '.join(str(error).split())[:120]}"
        return
    k = len(run.times)
    if not np.allclose(run.times, times[:k], rtol=0, atol=1e-9):
        raise ValueError(f"{point.peer.name}, {point.peer.setting}: samples at other times than asked for")
    gaps = np.abs(run.angle - exact.angle[:k])
    far = np.flatnonzero(~(gaps <= LOST))
    if len(far):
        point.note = f"lost the motion at t = {times[far[0]]:.3g} s"
    elif k < len(times):
        point.note = f"stopped at t = {times[max(k - 1, 0)]:.3g} s"
    else:
        gap = unique(point.mechanism, run.reactions) - unique(point.mechanism, exact.reactions)
        point.error, point.force_error, point.simulate = float(gaps.max()), float(np.abs(gap).max()), simulate
    point.note = "; ".join(filter(None, (point.note, run.note)))


def clock(points: Sequence[Point], rounds: int) -> None:
    """Time every point that has the motion, in rounds of random order."""
    order, ready = random.Random(SEED), [point for point in points if point.simulate]
    for k in tqdm(range(rounds), "timing", unit="round"):
        turn = [point for point in ready if k < LEAST or sum(point.seconds) < BUDGET]
        for point in order.sample(turn, len(turn)):
            begin = time.perf_counter()
            point.simulate()
            point.seconds.append(time.perf_counter() - begin)


@dataclass
class Reach:
    """What one setting takes to come to the target error on one mechanism."""

    points: list[Point]
    """From coarse to fine."""
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
            if finer.error <= TARGET:
                share = math.log(p.error / TARGET) / math.log(p.error / finer.error) if p is not finer else 0.0
                self.seconds = [a * (b / a) ** share for a, b in zip(p.seconds, finer.seconds, strict=False)]
                self.force_error = finer.force_error
                self.text = "<= " * (p is finer) + rounded(self.median)
                return

    @property
    def name(self) -> tuple[str, str]:
        return self.points[0].peer.name, self.points[0].peer.setting

    @property
    def median(self) -> float:
        return statistics.median(self.seconds) if self.seconds else math.inf

    def ratios(self, other: Reach) -> list[float]:
        """Run time over that of the other, in each round that both took part in."""
        return [a / b for a, b in zip(self.seconds, other.seconds, strict=False)]


def reaches(points: Sequence[Point], mechanism: str) -> list[Reach]:
    """The settings of one mechanism."""
    groups: dict[tuple[str, str], list[Point]] = {}
    for point in points:
        if point.mechanism == mechanism:
            groups.setdefault((point.peer.name, point.peer.setting), []).append(point)
    return [Reach(group) for group in groups.values()]


# Report -----------------------------------------------------------------------------------------------------------

USAGE = {
    "alfmu": "Library `Instance`, defaults; all outputs are read at each sample. `lean`: `outputs` are those that are "
    "compared, parameters are frozen, coordinates are those of the joints (defaults: mixed and absolute).",
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
something. alfmu is measured as a library; through an FMU every step costs more. alfmu's compiled kernel, Exudyn and
MuJoCo step in compiled code, its vm kernel in CasADi's virtual machine; Pinocchio evaluates in compiled code and is
stepped in Python (a loop in C++ would spare it that), SciPy is Python but for the terms of the equations. All use one
thread. Pinocchio and MuJoCo describe the five-bar by joint angles, in which its parallelogram is a straight line that
no stage leaves, and so does alfmu's lean setting; alfmu by default, Exudyn and SciPy by coordinates of torn-off
bodies. The peers were tuned to these two motions with the exact ones at hand, alfmu runs with its defaults; other
mechanisms need the tuning again. Time is taken at
equal error of the angle; the reactions there differ in accuracy (see their column): MuJoCo's belong to slightly soft
constraints, Exudyn's to the tolerance of Newton's method. Errors of reactions are taken at equal times and so contain
those of the motion, and only what rigid bodies determine is compared. Steps that do not divide 0.02 s were not run,
and some points are luckier than their neighbours."""

Row = dict[str, Cell]


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
    """Run times at the target, and the ratios to those alfmu settings that reach it."""
    found = reaches(points, mechanism)
    own = [r for r in found if r.name[0] == "alfmu" and r.seconds]
    rows: list[Row] = []
    for r in found:
        row = {"mechanism": mechanism, "code": r.name[0], "setting": r.name[1], "time at target [s]": r.text}
        row |= {"median [s]": r.median if r.seconds else None, "reaction error [N]": r.force_error}
        rows.append(row | {f"ratio to {a.name[1]}": statistics.median(r.ratios(a)) if r.seconds else None for a in own})
    empty = {**dict.fromkeys(rows[0]), "mechanism": mechanism, "time at target [s]": "not installed"}
    missing = dict.fromkeys(peer.name for peer in peers() if not peer.installed)
    return [*rows, *({**empty, "code": name, "setting": ""} for name in missing)]


def verdict_rows(points: Sequence[Point]) -> list[Row]:
    """alfmu against the best peer at the target: ratio by medians of the rounds, its range, and whether it is met."""
    rows = []
    for mechanism in MECHANISMS:
        found = [r for r in reaches(points, mechanism) if r.seconds]
        best = min((r for r in found if r.name[0] != "alfmu"), key=lambda r: r.median, default=None)
        for own in [r for r in found if r.name[0] == "alfmu"] if best else []:
            ratios = best.ratios(own)
            ratio = statistics.median(ratios)
            row = {"mechanism": mechanism, "alfmu": own.name[1], "time [s]": own.text}
            row |= {"best peer": ", ".join(best.name), "its time [s]": best.text}
            row |= {"ratio": ratio, "from": min(ratios), "to": max(ratios)}
            row |= {"rounds": len(ratios), f"target {RATIO:g}": "met" if ratio >= RATIO else "not met"}
            rows.append(row)
    return rows


def table(rows: Sequence[Row], *without: str) -> str:
    """A Markdown table of rows with the same columns."""
    columns = [name for name in rows[0] if name not in without] if rows else []
    return markdown(columns, [[row[name] for name in columns] for row in rows]) if rows else "Nothing to compare."


def picture(points: Sequence[Point]) -> Figure:
    """Error against run time, one panel for each mechanism, one colour for each code."""
    figure = Figure(figsize=(13, 5.5), layout="constrained")
    colours = dict(zip(USAGE, ("#c0523a", "#3b75af", "#3f9268", "#d98c1f", "#7a66b0"), strict=True))
    for axes, mechanism in zip(figure.subplots(1, 2, sharex=True, sharey=True), MECHANISMS, strict=True):
        count = dict.fromkeys(colours, 0)
        for r in reaches(points, mechanism):
            known, (name, setting) = [p for p in r.points if p.seconds], r.name
            style = ("o-", "s--", "^:", "d-.")[count[name] % 4]
            count[name] += 1
            if known:
                x, y = [p.median for p in known], [p.error for p in known]
                axes.loglog(x, y, style, color=colours[name], markersize=4, linewidth=1.2, label=f"{name}: {setting}")
        axes.axhline(TARGET, color="0.4", linewidth=0.8)
        axes.set(title=mechanism, xlabel="run time, median [s]")
        axes.grid(True, which="major", linewidth=0.4)
        axes.label_outer()
    lines = {label: line for axes in figure.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(lines.values(), lines.keys(), loc="outside right upper", fontsize=8)
    figure.axes[0].set_ylabel("largest error of the angle [rad]")
    return figure


def report(
    points: Sequence[Point], references: Mapping[str, Reference], rounds: int, where: Sequence[tuple[str, str]]
) -> str:
    """The report in Markdown."""
    parts = [
        "# Peers: error against run time",
        markdown(("what", "value"), where),
        f"{STOP:g} s of simulated time from angle 0 with {RATE:g} rad/s under gravity; angle and all joint forces\n"
        f"every {SAMPLE:g} s. Errors are the largest over the run. Each point ran once for its errors and then in\n"
        f"timed rounds of random order: in at least {LEAST}, in more until it had used {BUDGET:g} s, in at most\n"
        f"{rounds}. Building the model is timed apart; at its first point alfmu derives and traces, and compiles or\n"
        "finds the library in its cache. `rtol`: adaptive steps, with absolute tolerances as large.",
        f"## Run time at {TARGET:g} rad: alfmu against the best peer",
        table(verdict_rows(points)),
        "The ratio is the median over the rounds that both took part in, `from` and `to` are its least and largest\n"
        "value. Interpolated on log-log scales between the two neighbouring points; `<=` where the coarsest point is\n"
        "already below. A ratio above 1 means that alfmu is faster.",
        "![error against run time](peers.png)",
        "**The exact motion**: one equation of motion in the only angle, by DOP853 with tolerances of 1e-13",
        markdown(
            ("mechanism", "change to another tolerance [rad]", "relative change of energy"),
            [(name, r.change, r.energy) for name, r in references.items()],
        ),
    ]
    for mechanism in MECHANISMS:
        rows = [point_row(p) for p in points if p.mechanism == mechanism]
        parts += [f"## {mechanism}", f"**Run time at {TARGET:g} rad** (`peers_reach.csv`)"]
        parts += [table(reach_rows(points, mechanism), "mechanism", "median [s]")]
        parts += ["**All points** (`peers.csv`)", table(rows, "mechanism")]
    parts += ["## How each is used", markdown(("code", "use"), list(USAGE.items()))]
    return "\n\n".join([*parts, "## Where the comparison stops being fair", LIMITS]) + "\n"


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Measure error against run time of alfmu, Pinocchio, Exudyn, MuJoCo and SciPy on the five-bar and "
        "the slider-crank. Writes peers.md, peers.csv, peers_reach.csv and peers.png.",
        epilog="what of pin, exudyn, mujoco is not installed is left out; takes some minutes; overwrites an earlier "
        "run in the same folder",
    )
    folder = Path("results/peers")
    parser.add_argument("-o", "--output", type=Path, default=folder, help="folder (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="coarse steps and few repeats, less than a minute")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the results."""
    chosen = parse(arguments)
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"{chosen.output} cannot hold the results ({error.strerror}); give another with -o", file=sys.stderr)
        return 1
    packages = dict.fromkeys([*(peer.package for peer in peers()), "casadi", "numpy"])
    where = environment("python scripts/peers.py" + " --quick" * chosen.quick, list(packages))
    times, references = samples(STOP), {mechanism: reference(mechanism, STOP) for mechanism in MECHANISMS}
    points = chosen_points(chosen.quick)
    for point in tqdm(points, "errors", unit="run"):
        judge(point, references[point.mechanism], times)
    rounds = LEAST if chosen.quick else ROUNDS
    clock(points, rounds)
    reached = [row for mechanism in MECHANISMS for row in reach_rows(points, mechanism)]
    for name, rows in (("peers.csv", [point_row(p) for p in points]), ("peers_reach.csv", reached)):
        write_csv(chosen.output / name, rows)
    picture(points).savefig(chosen.output / "peers.png", dpi=120, metadata={"Software": None})
    (chosen.output / "peers.md").write_text(report(points, references, rounds, where), encoding="utf-8")
    print(chosen.output / "peers.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
