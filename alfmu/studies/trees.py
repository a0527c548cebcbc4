"""Trees of rigid bodies on hinges and sliders, closed to loops by constraints, and their models in other codes.

The frame of a body is at its joint, parallel to the frame of its parent if the coordinate is zero.
"""

import contextlib
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

GROUND = "ground"

Point = Sequence[float]


@dataclass
class Body:
    """A rigid body on its joint: `at` and `axis` in the parent's frame, other quantities in its own [m, kg, kg.m2]."""

    name: str
    parent: str
    at: Point
    mass: float
    center: Point
    inertia: Sequence[Sequence[float]]
    joint: str = "revolute"
    axis: Point = (0.0, 0.0, 1.0)


@dataclass
class Closure:
    """A constraint between points of two bodies: `point` (they coincide), `hinge` (so do axes through them, with the
    same numbers in both frames), `distance` (they stay apart by `length` [m])."""

    name: str
    first: str
    first_at: Point
    second: str
    second_at: Point
    kind: str = "point"
    axis: Point | None = None
    second_axis: Point | None = None
    length: float | None = None


@dataclass
class Start:
    """Coordinates and rates of all joints, in the order of bodies, and the torque on the first body from the ground
    [N.m]."""

    q: Sequence[float] | NDArray
    v: Sequence[float] | NDArray
    torque: float = 0.0


class Tree:
    """A tree with its loops, and what is read of a run."""

    bodies: Sequence[Body]
    """Each after its parent."""
    closures: Sequence[Closure]
    gravity: Point
    times: NDArray
    """Equidistant times of the results [s]."""

    @property
    def read(self) -> Sequence[tuple[str, Point]]:
        """Body and local position of each point that is read."""
        raise NotImplementedError

    @property
    def planar(self) -> bool:
        return all(
            body.axis[0] == body.axis[1] == 0 if body.joint == "revolute" else body.axis[2] == 0 for body in self.bodies
        )

    @property
    def forces_are_read(self) -> bool:
        """Whether a code returns forces: of points that coincide in the plane."""
        return self.planar and all(c.kind == "point" for c in self.closures)

    def steps(self, size: float) -> int:
        """Return the number of steps from one time to the next."""
        return round((self.times[1] - self.times[0]) / size)

    def carried(self, parent: str = GROUND) -> list[Body]:
        """Return the bodies that a body carries, depth first."""
        return [x for body in self.bodies if body.parent == parent for x in (body, *self.carried(body.name))]


class Found(NamedTuple):
    """Results of a run up to its end."""

    places: NDArray
    """Positions (k, m, 3) [m] of the points that are read."""
    forces: NDArray | None
    """Forces (k, j, 3) [N] in ground axes on the second bodies of closures, then, if the code gives these, on bodies
    from their parents."""
    seconds: float
    """Processor time of the run [s], without preparation."""
    stopped: str = ""


Simulation = Callable[[Start, float], Found]
"""Function that runs from a start with a step [s] or a tolerance."""


class Unable(Exception):
    """The code has no such joint or constraint."""


def skew(a: Point) -> NDArray:
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float)


def poses(p: Tree, q: NDArray) -> dict[str, tuple[NDArray, NDArray]]:
    """Return attitude (k, 3, 3) and origin (k, 3) of every body for coordinates (k, n)."""
    k = len(q)
    found = {GROUND: (np.broadcast_to(np.eye(3), (k, 3, 3)), np.zeros((k, 3)))}
    for body, x in zip(p.bodies, q.T, strict=True):
        R, o = found[body.parent]
        o, K = o + R @ np.array(body.at, float), skew(body.axis)
        if body.joint == "prismatic":
            found[body.name] = R, o + (R @ np.array(body.axis, float)) * x[:, None]
        else:
            s, c = np.sin(x)[:, None, None], np.cos(x)[:, None, None]
            found[body.name] = R @ (np.eye(3) + s * K + (1 - c) * K @ K), o
    return found


def places(p: Tree, q: NDArray) -> NDArray:
    """Return positions (k, m, 3) of the points that are read for coordinates (k, n)."""
    at = poses(p, q)
    return np.stack([at[body][1] + at[body][0] @ np.array(x, float) for body, x in p.read], 1)


def axes_points(c: Closure) -> list[tuple[Point, Point]]:
    """Return pairs of points that a closure keeps together: for a hinge two pairs on its axis, 0.2 m apart."""
    if c.kind == "point":
        return [(c.first_at, c.second_at)]
    if c.kind == "distance" or c.axis is None or c.second_axis is None:
        raise Unable("has no constraint that keeps a distance")
    pairs = []
    for x in (-0.1, 0.1):
        first, second = np.array(c.first_at) + x * np.array(c.axis), np.array(c.second_at) + x * np.array(c.second_axis)
        pairs.append((first.tolist(), second.tolist()))
    return pairs


def pinocchio_contacts(pin: ModuleType, closures: Sequence[Any]) -> tuple[Any, Any]:
    """Return Pinocchio's vectors of constraints and of their data."""
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for closure in closures:
        models.append(closure)
        datas.append(closure.createData())
    return models, datas


def pinocchio_model(pin: ModuleType, p: Tree, frequency: float = 0.0) -> tuple[Any, list[Any], list[int]]:
    """Return a model in Pinocchio, its loops closed by `CONTACT_3D` with critically damped stabilisation of a frequency
    [1/s], and the place of each body's coordinate."""

    def at(x: Point) -> Any:
        return pin.SE3(np.eye(3), np.array(x, float))

    model, ids = pin.Model(), {GROUND: 0}
    model.gravity.linear = np.array(p.gravity, float)
    for body in p.carried():
        kind = pin.JointModelRevoluteUnaligned if body.joint == "revolute" else pin.JointModelPrismaticUnaligned
        joint = kind(np.array(body.axis, float))
        if tuple(body.axis) in _AXES:
            joint = getattr(pin, f"JointModel{'R' if body.joint == 'revolute' else 'P'}{_AXES[tuple(body.axis)]}")()
        ids[body.name] = model.addJoint(ids[body.parent], joint, at(body.at), body.name)
        inertia = pin.Inertia(body.mass, np.array(body.center, float), np.array(body.inertia, float))
        model.appendBodyToJoint(ids[body.name], inertia, pin.SE3.Identity())
    closures = []
    for c in p.closures:
        for first, second in axes_points(c):
            ends = ids[c.first], at(first), ids[c.second], at(second)
            one = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *ends, pin.ReferenceFrame.LOCAL)
            one.m_baumgarte_parameters.Kp, one.m_baumgarte_parameters.Kd = frequency**2, 2 * frequency
            closures.append(one)
    return model, closures, [model.joints[ids[body.name]].idx_q for body in p.bodies]


_AXES: dict[tuple[float, ...], str] = {(1, 0, 0): "X", (0, 1, 0): "Y", (0, 0, 1): "Z"}
"""Axes for which Pinocchio has faster joints."""


def by_mujoco(p: Tree, hardness: float, integrator: str = "RK4") -> Simulation:
    """Run MuJoCo with `connect` and tendons of fixed length, forces by `mj_rnePostConstraint`; `hardness` is the
    mass-normalised stiffness times step^2 of constraints."""
    import mujoco

    warnings: list[str] = []
    mujoco.set_mju_user_warning(warnings.append)  # by default it writes a file into the working folder
    model = mujoco.MjModel.from_xml_string(_mjcf(p, integrator))
    data = mujoco.MjData(model)
    order = [model.joint(body.name).qposadr[0] for body in p.bodies]
    ids = [model.body(body.name).id for body in p.bodies] if model.nbody > len(p.bodies) else []
    loops = 3 * len(p.closures)

    def simulate(start: Start, step: float) -> Found:
        warnings.clear()
        stiffness = hardness / step**2
        model.opt.timestep = step
        model.eq_solref[:], model.eq_solimp[:, :3] = (-stiffness, -2 * math.sqrt(stiffness)), (0.9999, 0.9999, 1)
        mujoco.mj_resetData(model, data)
        data.qpos[order], data.qvel[order], data.qfrc_applied[order[0]] = start.q, start.v, start.torque
        count, each = len(p.times), p.steps(step)
        states, closing, felt = np.empty((count, model.nq)), np.empty((count, loops)), np.empty((count, model.nbody, 6))
        begin = time.process_time()
        for k in range(count):
            if k:
                mujoco.mj_step(model, data, each)
            mujoco.mj_forward(model, data)
            states[k] = data.qpos
            if p.forces_are_read:
                mujoco.mj_rnePostConstraint(model, data)
                closing[k], felt[k] = data.efc_force[:loops], data.cfrc_int
        seconds = time.process_time() - begin
        finite = np.isfinite(states).all(axis=1)
        k = count if finite.all() else int(finite.argmin())
        stopped = "" if k == count else warnings[0].split(".")[0] if warnings else "the state is NaN"
        forces = (
            np.concatenate([-closing.reshape(count, -1, 3), felt[:, ids, 3:]], 1)[:k] if p.forces_are_read else None
        )
        return Found(places(p, states[:k, order]), forces, seconds, stopped)

    return simulate


def _mjcf(p: Tree, integrator: str) -> str:
    """Return the MJCF text of a tree at zero coordinates."""

    def numbers(x: Point) -> str:
        return " ".join(repr(float(each)) for each in x)

    children: dict[str, list[Body]] = {}
    for body in p.bodies:
        children.setdefault(body.parent, []).append(body)
    sites: dict[str, list[str]] = {}
    loops, tendons = [], []
    for i, c in enumerate(p.closures):
        pairs = [(c.first_at, c.second_at)] if c.kind == "distance" else axes_points(c)
        for j, pair in enumerate(pairs):
            for side, name, x in zip("ab", (c.first, c.second), pair, strict=True):
                sites.setdefault(name, []).append(f'<site name="{i}{side}{j}" pos="{numbers(x)}"/>')
            if c.kind == "distance":
                tendons.append(f'<spatial name="{i}"><site site="{i}a{j}"/><site site="{i}b{j}"/></spatial>')
                loops.append(f'<tendon tendon1="{i}" polycoef="{c.length} 0 0 0 0"/>')
            else:
                loops.append(f'<connect site1="{i}a{j}" site2="{i}b{j}"/>')

    def text(body: Body, joints: str = "", at: Point | None = None) -> str:
        kind = "hinge" if body.joint == "revolute" else "slide"
        joints += f'<joint name="{body.name}" type="{kind}" axis="{numbers(body.axis)}"/>'
        at, below = body.at if at is None else at, children.get(body.name, [])
        if body.mass == 0 and len(below) == 1 and not any(below[0].at) and body.name not in sites:
            return text(below[0], joints, at)  # bodies may have several joints
        J = np.array(body.inertia, float)
        missing = np.diag(J.diagonal() == 0) if p.planar else np.eye(3)
        J += 1e-9 * missing * (body.mass > 0)
        full = numbers([J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2]])
        mass = f'<inertial pos="{numbers(body.center)}" mass="{body.mass}" fullinertia="{full}"/>'
        inner = "".join(sites.get(body.name, [])) + "".join(map(text, below))
        return f'<body name="{body.name}" pos="{numbers(at)}">{joints}{mass}{inner}</body>'

    tree = "".join(sites.get(GROUND, [])) + "".join(map(text, children[GROUND]))
    return f"""<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/>
<option gravity="{numbers(p.gravity)}" integrator="{integrator}" solver="Newton" tolerance="1e-14" iterations="5">
<flag contact="disable" refsafe="disable" autoreset="disable"/></option>
<worldbody>{tree}</worldbody><tendon>{"".join(tendons)}</tendon><equality>{"".join(loops)}</equality></mujoco>"""


def by_exudyn(p: Tree, solver: str = "GeneralizedAlpha", redundant: bool = True) -> Simulation:
    """Run one of Exudyn's solvers on rigid bodies and joints in redundant coordinates, forces by its sensors.

    Constraints that may be `redundant` need a slower linear solver.
    """
    sys.exudynFast = True  # type: ignore[attr-defined]  # the build without range checks, where there is one
    with contextlib.redirect_stdout(None):
        import exudyn as exu
    exu.config.printToConsole = False

    def simulate(start: Start, step: float) -> Found:
        mbs = exu.SystemContainer().AddSystem()
        seen, felt = _exudyn_model(mbs, p, start)
        mbs.Assemble()
        settings = exu.SimulationSettings()
        settings.solution.sensors.writePeriod = p.times[1] - p.times[0]
        settings.solution.file.write = False
        settings.show.computationTime = False
        kinds = exu.LinearSolverType
        settings.linearSolver.solverType = kinds.EigenDense if redundant else kinds.EXUdense
        settings.linearSolver.ignoreSingularJacobian = redundant
        march = settings.timeIntegration
        march.endTime, march.numberOfSteps, march.verboseMode = p.times[-1], round(p.times[-1] / step), 0
        march.adaptiveStep = solver == "GeneralizedAlpha"
        march.newton.useModifiedNewton = redundant
        stopped, begin = "", time.process_time()
        try:
            mbs.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, solver))
        except Exception as error:
            stopped = " ".join(str(error).split("[Python")[0].split()) or type(error).__name__
        seconds = time.process_time() - begin
        tables = [mbs.GetSensorStoredData(each) for each in (*seen, *felt)]
        k = min(map(len, tables))
        if not k:
            return Found(np.zeros((0, len(seen), 3)), None, seconds, stopped or "no result")
        rows = np.stack([x[:k, 1:] for x in tables[: len(seen)]], 1)
        forces = np.stack([_across(x[:k, 1:]) for x in tables[len(seen) :]], 1) if felt else None
        return Found(rows, forces, seconds, stopped)

    return simulate


def _across(force: NDArray) -> NDArray:
    """Return forces (k, 3) on second bodies from those of a sensor: of a hinge (x, y), or of a guide along x (y)."""
    return -np.pad(force[:, :2], ((0, 0), (0, 1)) if force.shape[1] > 1 else ((0, 0), (1, 1)))


def _exudyn_model(mbs: Any, p: Tree, start: Start) -> tuple[list[Any], list[Any]]:
    """Return sensors of the points that are read, and of the forces of closures and joints."""
    from exudyn import OutputVariableType, itemInterface
    from exudyn.rigidBodyUtilities import RigidBodyInertia

    item, at = itemInterface, {name: (R[0], o[0]) for name, (R, o) in poses(p, np.array([start.q])).items()}
    items, center = {GROUND: mbs.CreateGround()}, {GROUND: np.zeros(3)}
    speeds, joints = {GROUND: (np.zeros(3), np.zeros(3))}, {}

    def local(body: str, x: Point) -> list[float]:
        return (np.array(x, float) - center[body]).tolist()

    def markers(first: str, x: Point, second: str, y: Point, rigid: bool = False) -> list[Any]:
        kind = item.MarkerBodyRigid if rigid else item.MarkerBodyPosition
        pairs = ((first, x), (second, y))
        return [mbs.AddMarker(kind(bodyNumber=items[body], localPosition=local(body, at))) for body, at in pairs]

    def hinge(first: str, x: Point, second: str, y: Point, axis: Point) -> Any:
        if p.planar:
            return mbs.AddObject(item.ObjectJointRevolute2D(markerNumbers=markers(first, x, second, y)))
        R, o = at[first]
        place, turn = o + R @ np.array(x, float), R @ np.array(axis, float)
        return mbs.CreateRevoluteJoint(bodyNumbers=[items[first], items[second]], position=place, axis=turn)

    def bead(body: Body, place: NDArray, speed: NDArray) -> Any:
        """Add a mass point on the x axis of the ground; return its guide."""
        point = mbs.AddNode(item.NodePoint2D(referenceCoordinates=place[:2], initialVelocities=speed[:2]))
        items[body.name] = mbs.AddObject(item.ObjectMassPoint2D(mass=body.mass, nodeNumber=point))
        weight = item.MarkerBodyMass(bodyNumber=items[body.name])
        mbs.AddLoad(item.LoadMassProportional(markerNumber=mbs.AddMarker(weight), loadVector=list(p.gravity)))
        zero = mbs.AddNode(item.NodePointGround(referenceCoordinates=[0, 0, 0]))
        track = [item.MarkerNodeCoordinate(nodeNumber=node, coordinate=k) for node, k in ((zero, 0), (point, 1))]
        return mbs.AddObject(item.ObjectConnectorCoordinate(markerNumbers=[*map(mbs.AddMarker, track)]))

    for body, rate in zip(p.bodies, start.v, strict=True):
        (R, o), (u, w) = at[body.name], speeds[body.parent]
        axis = at[body.parent][0] @ np.array(body.axis, float)
        u, slides = u + np.cross(w, o - at[body.parent][1]), body.joint == "prismatic"
        u, w = (u + axis * rate, w) if slides else (u, w + axis * rate)
        speeds[body.name] = u, w
        center[body.name] = np.array(body.center, float)
        if body.mass and not np.any(body.inertia) and slides and body.parent == GROUND and body.axis[0] == 1:
            joints[body.name] = bead(body, o, u)
            continue
        c = R @ center[body.name]
        items[body.name] = mbs.CreateRigidBody(
            referencePosition=o + c,
            referenceRotationMatrix=R,
            initialVelocity=u + np.cross(w, c),
            initialAngularVelocity=w,
            inertia=RigidBodyInertia(body.mass, np.array(body.inertia, float)),
            gravity=list(p.gravity),
            create2D=p.planar,
        )
        if slides:
            ends = markers(body.parent, body.at, body.name, (0, 0, 0), True)
            normal = [-body.axis[1], body.axis[0], 0]
            guide = {"axisMarker0": list(body.axis), "normalMarker1": normal}
            mbs.AddObject(item.ObjectJointPrismatic2D(markerNumbers=ends, **guide))  # it has no sensor of its force
        else:
            joints[body.name] = hinge(body.parent, body.at, body.name, (0, 0, 0), body.axis)
    closures = []
    for c in p.closures:
        between = c.first, c.first_at, c.second, c.second_at
        if c.kind == "distance":
            rod = item.ObjectConnectorDistance(markerNumbers=markers(*between), distance=c.length)
            closures.append(mbs.AddObject(rod))
        elif c.kind == "hinge" or p.planar:
            closures.append(hinge(*between, c.axis or ()))
        else:
            place = at[c.first][1] + at[c.first][0] @ np.array(c.first_at, float)
            bodies = [items[c.first], items[c.second]]
            closures.append(mbs.CreateSphericalJoint(bodyNumbers=bodies, position=place))
    if start.torque:
        marker = mbs.AddMarker(item.MarkerBodyRigid(bodyNumber=items[p.bodies[0].name]))
        mbs.AddLoad(item.LoadTorqueVector(markerNumber=marker, loadVector=[0, 0, start.torque]))
    kept: dict[str, Any] = {"storeInternal": True, "writeToFile": False}
    place_of = {**kept, "outputVariableType": OutputVariableType.Position}
    force_of = {**kept, "outputVariableType": OutputVariableType.Force}
    seen = [
        mbs.AddSensor(item.SensorBody(bodyNumber=items[b], localPosition=local(b, x), **place_of)) for b, x in p.read
    ]
    whole = [*joints.values()] if len(joints) == len(p.bodies) else []
    felt = [item.SensorObject(objectNumber=each, **force_of) for each in (*closures, *whole) if p.forces_are_read]
    return seen, [*map(mbs.AddSensor, felt)]
