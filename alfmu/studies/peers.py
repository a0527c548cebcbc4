"""Models of two mechanisms in Pinocchio, Exudyn, MuJoCo and SciPy, coded by hand; each runs if it is installed.

five_bar      links of 1 m and 1 kg; one constraint is redundant
slider_crank  crank 0.5 m, rod 1 m, 1 kg each and for the slider

Gravity alone acts on both, from an angle and a rate of the first link. Reactions are forces on the second body from the
first in ground axes [N], named as in alfmu: A to F (x and y) of the five-bar, A, B, C (x and y) and the guide of the
slider-crank. A run returns the angle of the first link and all reactions at equidistant times.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from types import ModuleType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg.lapack import dgelsy

from ..catalogue.registry import load
from ..equations.derivation import derive
from ..runtime import Instance

GRAVITY = 9.81

EVALUATIONS = 100_000
"""Number of evaluations after which an adaptive integrator is stopped."""

PART = 0.02
"""Steps divide this interval [s], and intervals of times are multiples of it."""

CRANK, ROD = 0.5, 1.0
"""Lengths of the slider-crank [m]."""

MECHANISMS = ("five_bar", "slider_crank")
ANGLE = {"five_bar": "link1.angle", "slider_crank": "crank.angle"}
REACTIONS = {
    "five_bar": [f"{joint}.force.{axis}" for joint in "ABCDEF" for axis in "xy"],
    "slider_crank": [*(f"{joint}.force.{axis}" for joint in "ABC" for axis in "xy"), "guide.force"],
}


class Start(NamedTuple):
    """Angle [rad] and rate [rad/s] of the first link."""

    angle: float
    rate: float


class Trajectory(NamedTuple):
    """Results of one run at its sample times."""

    times: NDArray
    """Times (k,) [s]."""
    angle: NDArray
    """Angles (k,) of link 1 or crank [rad]."""
    reactions: NDArray
    """Reactions (k, REACTIONS) [N]."""
    note: str = ""


Simulation = Callable[[], Trajectory]
"""A run from the start, which can be called repeatedly."""


def solved(rate: Callable, start: NDArray, method: str, tolerance: float, times: NDArray) -> NDArray:
    """Return states at the times by `solve_ivp`, (k, 2 n); fewer if it fails; raise TimeoutError if it takes
    too long."""
    count = itertools.count()

    def counted(t: float, y: NDArray) -> NDArray:
        if next(count) > EVALUATIONS:
            raise TimeoutError(f"{EVALUATIONS} evaluations at t = {t:.3g} s")
        return rate(y)

    return solve_ivp(counted, (0.0, times[-1]), start, method, times, rtol=tolerance, atol=tolerance).y.T


@dataclass(frozen=True)
class Peer(ABC):
    """A simulation code: `build` prepares a mechanism with a step [s] or tolerance, for given times.

    Times are equidistant; a step divides their distance.
    """

    package: str
    """Distribution whose version is reported."""
    name: str
    setting: str
    steps: Mapping[str, Sequence[float]]
    """Steps [s], or tolerances, by mechanism; the coarsest first."""
    control: str = "step"
    """Meaning of `steps`: "step" [s] or "rtol" [1]."""
    quick: int = 2
    """Number of steps in a quick study."""

    @abstractmethod
    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        """Prepare a mechanism at a start, with a step or tolerance, for a run over these times [s]."""

    @property
    def installed(self) -> bool:
        try:
            return bool(version(self.package))
        except PackageNotFoundError:
            return False


def _each(times: NDArray, step: float) -> int:
    """Return the number of steps from one time to the next."""
    return round((times[1] - times[0]) / step)


def _rod(start: Start) -> tuple[float, float]:
    """Return angle and rate of the rod of the slider-crank."""
    angle = math.asin(-CRANK / ROD * math.sin(start.angle))
    return angle, -CRANK * math.cos(start.angle) * start.rate / (ROD * math.cos(angle))


def _joints(mechanism: str, start: Start) -> tuple[NDArray, NDArray]:
    """Return coordinates of the tree of joints (A, B, E, D of the five-bar; A, B and the slider) and their rates."""
    th, w = start
    if mechanism == "five_bar":
        signs = np.array([1.0, -1.0, -1.0, 1.0])
        return th * signs, w * signs
    rod, turning = _rod(start)
    place = CRANK * math.cos(th) + ROD * math.cos(rod)
    speed = -CRANK * math.sin(th) * w - ROD * math.sin(rod) * turning
    return np.array([th, rod - th, place]), np.array([w, turning - w, speed])


@dataclass(frozen=True)
class Pinocchio(Peer):
    """`pin.constraintDynamics` (proximal) on a tree of joints, closed by CONTACT_3D; `pin.rnea` for joint forces."""

    method: str = "RK4"
    """RK4, or a method of `solve_ivp`."""
    omega: Mapping[str, float] = field(default_factory=dict)
    """Frequency of Baumgarte's stabilisation [1/s] by mechanism, critically damped."""

    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        import pinocchio as pin

        model, closures, begin = _pinocchio_model(pin, mechanism, start)
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
            """Store forces without those of the closures in the frames of the joints, right after y gave a."""
            states[k], contacts[k] = y, data.lambda_c
            rnea(model, data, y[:n], y[n:], a)
            felt[k] = inner

        def runge_kutta() -> Trajectory:
            y, s, K = begin.copy(), np.empty(2 * n), np.empty((4, 2 * n))
            q, v, weights, steps = s[:n], s[n:], np.array([1, 2, 2, 1]) * step / 6, range(_each(times, step))
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
            found = solved(rate, begin, self.method, step, times)
            for k, y in enumerate(found):
                record(k, y, rate(y)[n:])
            reactions = _pinocchio_reactions(mechanism, states, felt, contacts)[: len(found)]
            return Trajectory(times[: len(found)], found[:, 0], reactions)

        return runge_kutta if self.method == "RK4" else adaptive


def _pinocchio_model(pin: ModuleType, mechanism: str, start: Start) -> tuple:
    """Return model, loop closures, q and v at the start; joints turn about z or slide along x, and are added depth
    first."""

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
        return model, closures, np.concatenate(_joints(mechanism, start))
    B = link(A, CRANK, "B", ROD)
    guide = model.addJoint(0, pin.JointModelPX(), at(0.0), "guide")
    model.appendBodyToJoint(guide, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    return model, [close(B, ROD, guide, 0.0)], np.concatenate(_joints(mechanism, start))


def _pinocchio_reactions(mechanism: str, q: NDArray, felt: NDArray, contacts: NDArray) -> NDArray:
    """Return REACTIONS (k, ...) in ground axes, from forces in the axes of the bodies.

    `felt` are the joint forces of the open tree, `contacts` the forces of the closures on their first bodies.
    """

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

    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        sys.exudynFast = True  # type: ignore[attr-defined]  # the build without range checks, where there is one
        with contextlib.redirect_stdout(None):
            import exudyn as exu
        exu.config.printToConsole = False
        mbs = exu.SystemContainer().AddSystem()
        node, joints = _exudyn_model(mbs, mechanism, start)
        kept = {"storeInternal": True, "writeToFile": False}
        from exudyn.itemInterface import SensorNode, SensorObject

        kinds = exu.OutputVariableType
        seen = mbs.AddSensor(SensorNode(nodeNumber=node, outputVariableType=kinds.Coordinates, **kept))
        felt = [mbs.AddSensor(SensorObject(objectNumber=j, outputVariableType=kinds.Force, **kept)) for j, _ in joints]
        mbs.Assemble()
        settings = exu.SimulationSettings()
        settings.solution.sensors.writePeriod = times[1] - times[0]
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


def _exudyn_model(mbs: Any, mechanism: str, start: Start) -> tuple[object, list[tuple[object, float]]]:
    """Return node of the first link, and the joints in the order of REACTIONS with the sign of their forces."""
    from exudyn import itemInterface as item

    def bar(length: float, along: float, begin: tuple = (0.0, 0.0), drift: tuple = (0.0, 0.0), w: float = 0.0) -> tuple:
        """Add a bar at an angle, with one end at a point with a velocity."""
        half = length / 2 * np.array([math.cos(along), math.sin(along)])
        speed = np.add(drift, w * np.array([-half[1], half[0]]))
        places = {"referenceCoordinates": [*np.add(begin, half), 0], "initialCoordinates": [0, 0, along]}
        node = mbs.AddNode(item.NodeRigidBody2D(**places, initialVelocities=[*speed, w]))
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

    ground, (th, w) = mbs.AddObject(item.ObjectGround()), start
    c, s = math.cos(th), math.sin(th)
    if mechanism == "five_bar":
        node, link1 = bar(1.0, th, w=w)
        (_, link2), (_, link3) = bar(1.0, 0.0, (c, s), (-s * w, c * w)), bar(1.0, th, (1.0, 0.0), w=w)
        _, link4 = bar(1.0, 0.0, (c / 2, s / 2), (-s * w / 2, c * w / 2))
        ends = [
            (ground, 0.0, link1, -0.5),
            (link1, 0.5, link2, -0.5),
            (link2, 0.5, link3, 0.5),
            (ground, 1.0, link3, -0.5),
            (link1, 0.0, link4, -0.5),
            (link4, 0.5, link3, 0.0),
        ]
        return node, [join(*end) for end in ends]
    (_, _, place), (_, _, speed) = _joints(mechanism, start)
    along, turning = _rod(start)
    node, crank = bar(CRANK, th, w=w)
    _, rod = bar(ROD, along, (CRANK * c, CRANK * s), (-CRANK * s * w, CRANK * c * w), turning)
    point = mbs.AddNode(item.NodePoint2D(referenceCoordinates=[place, 0], initialVelocities=[speed, 0]))
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
    """MuJoCo on the same tree of joints as Pinocchio, closed by `connect`; reactions by `mj_rnePostConstraint`."""

    integrator: str = "RK4"
    hardness: Mapping[str, float] = field(default_factory=dict)
    """Stiffness times step^2 (mass-normalised), by mechanism."""

    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        import mujoco

        warnings: list[str] = []
        mujoco.set_mju_user_warning(warnings.append)  # by default it writes a file into the working folder
        text = _mujoco_model(mechanism, step, self.integrator, self.hardness[mechanism] / step**2)
        q_0, v_0 = _joints(mechanism, start)
        model = mujoco.MjModel.from_xml_string(text)
        data, steps, five = mujoco.MjData(model), _each(times, step), mechanism == "five_bar"

        def simulate() -> Trajectory:
            warnings.clear()
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = q_0, v_0
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


def _mujoco_model(mechanism: str, step: float, integrator: str, stiffness: float) -> str:
    """Return MJCF text, with all links along the x axis."""

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
        loops = connect("2", "3", 1.0) + connect("4", "3", 1.0)
    else:
        slider = (
            f'<body name="3" pos="{CRANK + ROD} 0 0"><joint type="slide" axis="1 0 0" ref="{CRANK + ROD}"/>'
            '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
        )
        bodies, loops = bar("1", 0, CRANK, bar("2", CRANK, ROD)) + slider, connect("2", "3", ROD)
    return f"""<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>
<option timestep="{step!r}" gravity="0 {-GRAVITY} 0" integrator="{integrator}" solver="Newton" tolerance="1e-14"
 iterations="5" jacobian="dense"><flag contact="disable" refsafe="disable" autoreset="disable"/></option>
<default><equality solref="{-stiffness!r} {-2 * math.sqrt(stiffness)!r}" solimp="0.9999 0.9999 1"/></default>
<worldbody>{bodies}</worldbody><equality>{loops}</equality></mujoco>"""


@dataclass(frozen=True)
class SciPy(Peer):
    """`solve_ivp` on alfmu's M, C, f, xi, Phi in the index-1 form (9), by elimination of a and least squares."""

    method: str = "DOP853"

    def build(self, mechanism: str, start: Start, step: float, times: NDArray) -> Simulation:
        five = mechanism == "five_bar"
        omega, cut, options = (15.0, 1e-4, {}) if five else (6.0, 1e-12, {"coordinates": "joint"})
        e = derive(load(mechanism, **options))
        instance, n, l = Instance(e), e.n, e.l
        instance.set("start.angle", start.angle)
        instance.set("start.angular_velocity", start.rate)
        instance.initialize()
        begin, p, u = np.concatenate([instance.q, instance.v]), instance.values[: len(e.parameters)], instance.inputs
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        C, inverse = e.C(q, p), ca.inv(e.M(q, p))
        falling, pulled = inverse @ (e.f(q, v, u, p, 0) - e.d(q, v, p)), inverse @ C.T
        xi = e.xi(q, v, p) - 2 * omega * C @ v - omega**2 * e.Phi(q, p)
        results = [ca.densify(x) for x in (C @ pulled, C @ falling - xi, falling, pulled)]
        terms = _Terms(ca.Function("terms", [q, v], results, {"cse": True}))
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


class _Terms:
    """A CasADi function whose arguments and results are arrays at fixed addresses."""

    def __init__(self, f: ca.Function):
        self.buffer, self.evaluate = f.buffer()  # the memory of evaluate lives as long as the buffer
        self.arguments = [np.zeros(f.size_in(i), order="F") for i in range(f.n_in())]
        self.results = [np.zeros(f.size_out(i), order="F") for i in range(f.n_out())]
        for tie, arrays in ((self.buffer.set_arg, self.arguments), (self.buffer.set_res, self.results)):
            for i, x in enumerate(arrays):
                tie(i, memoryview(x.reshape(-1, order="F")))  # type: ignore[arg-type,call-arg]


def _tuned() -> tuple[Peer, ...]:
    steps = dict.fromkeys(MECHANISMS, tuple(PART / k for k in (1, 2, 3, 4, 8, 16, 32, 64)))
    loop = {"five_bar": (1e-6, 1e-8, 1e-10, 1e-11, 1e-12), "slider_crank": (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-11, 1e-12)}
    stabilised = {"five_bar": 60.0, "slider_crank": 5.0}
    alpha = {"five_bar": (5e-3, 1e-3, 2e-4, 1e-4, 4e-5), "slider_crank": (5e-3, 1e-3)}
    trapezoidal = {"five_bar": (5e-3, 1e-3), "slider_crank": (5e-3, 1e-3, 2e-4, 5e-5)}
    soft = dict.fromkeys(MECHANISMS, tuple(PART / k for k in (2, 4, 5, 8, 10, 20, 40)))
    softer = dict.fromkeys(MECHANISMS, tuple(PART / k for k in (10, 40)))
    rtols = dict.fromkeys(MECHANISMS, (1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11))
    tight = {"five_bar": (1e-7, 1e-8, 1e-9, 1e-11), "slider_crank": (1e-6, 1e-7, 1e-8, 1e-9, 1e-11)}
    first, second = {"five_bar": 2.0, "slider_crank": 0.2}, {"five_bar": 0.1, "slider_crank": 0.5}
    return (
        Pinocchio("pin", "Pinocchio", "RK4, Baumgarte", steps, quick=5, omega=stabilised),
        Pinocchio("pin", "Pinocchio", "RK4, not stabilised", steps, quick=1),
        Pinocchio("pin", "Pinocchio", "DOP853, Baumgarte", loop, "rtol", 3, method="DOP853", omega=stabilised),
        Pinocchio("pin", "Pinocchio", "LSODA, Baumgarte", loop, "rtol", method="LSODA", omega=stabilised),
        Exudyn("exudyn", "Exudyn", "generalized alpha", alpha),
        Exudyn("exudyn", "Exudyn", "trapezoidal, index 2", trapezoidal, solver="TrapezoidalIndex2"),
        MuJoCo("mujoco", "MuJoCo", "RK4", soft, quick=3, hardness=first),
        MuJoCo("mujoco", "MuJoCo", "implicitfast", softer, quick=1, integrator="implicitfast", hardness=second),
        SciPy("scipy", "SciPy stabilised", "DOP853", rtols, "rtol", 3),
        SciPy("scipy", "SciPy stabilised", "RK45", tight, "rtol", 0, method="RK45"),
        SciPy("scipy", "SciPy stabilised", "LSODA", tight, "rtol", 0, method="LSODA"),
    )


TUNED = _tuned()
"""All codes, each with the best settings of those tried on these mechanisms (USAGE)."""

USAGE = {
    "alfmu": "Library `Instance`, a whole run in one call of its method `run`; all outputs are read at each point. "
    "`joint`: the coordinates are those of the joints and parameters are frozen (defaults: mixed and absolute, none). "
    "`lean`: outputs are those that are compared.",
    "Pinocchio": "Minimal tree and two (one) loop closures, `constraintDynamics` with mu = 1e-8 and 3 proximal "
    "iterations on preallocated data; RK4 in NumPy or `solve_ivp`. Tried: mu 1e-4 to 1e-12, 1 to 50 iterations, "
    "Baumgarte from 0 to 200 1/s (five-bar 60, slider-crank 5), projection instead (slower), `lcaba` (slower).",
    "Exudyn": "Its solvers on rigid bodies with joints, files off, build without range checks. Tried: spectral radius "
    "0.5 to 1, index 2 and 3, all linear solvers, Newton tolerances 1e-6 to 1e-10. The redundant constraint needs "
    "EigenDense with `ignoreSingularJacobian`. Explicit solvers refuse joints; all methods used are of order 2.",
    "MuJoCo": "Pinocchio's tree with `connect`; constraints are soft by design, here as hard as possible: solimp "
    "0.9999, solref with stiffness c / step^2 and critical damping, refsafe off. Tried: c from 0.01 to 4 (RK4: "
    "five-bar 2, slider-crank 0.2), 1 to 50 iterations, implicit integrators (order 1).",
    "SciPy stabilised": "alfmu's terms in one CasADi function, a eliminated from (9), multipliers of least norm by "
    "LAPACK gelsy (cut-off 1e-4 on the five-bar), Baumgarte with 15 and 6 1/s (from 0 to 200 tried), joint "
    "coordinates of the slider-crank.",
}
