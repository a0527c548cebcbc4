"""The codes of the singular benchmark: each builds and runs problems from their JSON files.

To add a code, write a function that takes a problem and returns a simulation, and add it to CODES.
"""

import hashlib
import math
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from _singular_problems import GROUND, Problem, Run
from numpy.typing import NDArray
from scipy.linalg.lapack import dgelsy

import alfmu
from alfmu.equations.specialisation import specialised
from alfmu.fmi.drive import Fmu
from alfmu.runtime.pipeline import prepared, with_defaults
from alfmu.studies.peers import solved
from alfmu.studies.trees import (
    Found,
    Simulation,
    axes_points,
    by_exudyn,
    by_mujoco,
    pinocchio_contacts,
    pinocchio_model,
    places,
    poses,
    skew,
)

TOLERANCES = (1e-3, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


@dataclass(frozen=True)
class Code:
    """A simulation code with its settings."""

    build: Callable[..., Simulation]
    package: str
    values: Sequence[float]
    """Steps [s] or tolerances, the coarsest first."""
    control: str = "step"
    module: str = ""
    """Name of the Python module to import."""
    variants: Sequence[dict[str, Any]] = ({},)
    """Candidate arguments of `build`: each problem uses those with the least error at a medium setting, a long row the
    first ones."""


# alfmu ------------------------------------------------------------------------------------------------------------

CATALOGUE: dict[str, tuple[str, dict[str, Any], dict[str, float]]] = {
    "five_bar": ("five_bar", {"coordinates": "joint"}, {}),
    "five_bar_massless": ("five_bar", {"coordinates": "mixed"}, {"m2": 0.0}),
    "four_bar": ("four_bar", {"coordinates": "joint"}, {}),
    "slider_crank": ("slider_crank", {"coordinates": "joint"}, {"l1": 0.5, "l2": 0.5}),
    **{f"n_four_bar_{n}": ("n_four_bar", {"loops": n}, {}) for n in (2, 40, 1000)},
}
"""Mechanisms that come with alfmu: name, options and parameters. Others are declared from the file."""


def declared(p: Problem) -> alfmu.Mechanism:
    """Return the alfmu mechanism of a problem, with its points."""
    if p.name in CATALOGUE:
        name, options, _ = CATALOGUE[p.name]
        m = alfmu.load(name, **options)
        bodies: dict[str, Any] = {body.name: body for body in m.bodies}
    else:
        m, bodies = mechanism(p)
    for i, (body, x) in enumerate(p.read):
        if body != GROUND:
            m.watch(f"point{i}", bodies[body].at(*(x[:2] if p.planar else x)))
    return m


def mechanism(p: Problem) -> tuple[alfmu.Mechanism, dict[str, Any]]:
    """Return the alfmu mechanism of a problem, and its bodies."""
    m = alfmu.Mechanism(p.name, p.title)
    run, planar = p.runs[0], p.planar
    bodies: dict[str, Any] = {GROUND: m.ground if planar else m.spatial_ground}

    def at(body: str, x: Sequence[float]) -> Any:
        return bodies[body].at(*(x[:2] if planar else x))

    for i, (body, q, v) in enumerate(zip(p.bodies, run.q, run.v, strict=True)):
        free = body.name in p.independent
        unit = "rad" if body.joint == "revolute" else "m"
        coordinate = m.coordinate(f"q{i}", unit, start=q, rate=v if free else 0.0, independent=free)
        inertia, center = np.array(body.inertia), tuple(body.center)
        mass: Any = {"mass": body.mass}
        if planar:
            bodies[body.name] = m.body(body.name, inertia=inertia[2, 2], center=center[:2], **mass)
            kind = {"revolute": m.revolute, "prismatic": m.prismatic}[body.joint]
            turn = {"axis": math.atan2(body.axis[1], body.axis[0])} if body.joint == "prismatic" else {}
        else:
            bodies[body.name] = m.spatial_body(body.name, inertia=inertia, center=center, relative=True, **mass)
            kind, turn = m.spatial_revolute, {"axis": tuple(body.axis)}  # type: ignore[dict-item]
        joint = kind(f"joint{i}", at(body.parent, body.at), at(body.name, (0, 0, 0)), coordinate=coordinate, **turn)  # type: ignore[arg-type]
        if i == 0 and any(run.torque for run in p.runs):
            m.drive(joint, m.input("A.torque", "N.m" if body.joint == "revolute" else "N"))
    for c in p.closures:
        ends, turns = (at(c.first, c.first_at), at(c.second, c.second_at)), (c.axis, c.second_axis)
        if c.second == GROUND:  # alfmu expects the ground first
            ends, turns = ends[::-1], turns[::-1]
        if c.kind == "distance":
            m.distance(c.name, *ends, length=c.length)
        elif c.kind == "hinge":
            m.spatial_revolute(c.name, *ends, axis=turns[0], second_axis=turns[1])
        else:
            (m.revolute if planar else m.spherical)(c.name, *ends)
    m.gravity(*(p.gravity[:2] if planar else p.gravity))
    return m, bodies


def given(p: Problem, run: Run, e: alfmu.Equations) -> dict[str, float]:
    """Return the start and the torque of a run by their names in the alfmu mechanism."""
    index = [i for i, body in enumerate(p.bodies) if body.name in p.independent]
    given = dict(zip((v.name for v in e.starts), (run.q[i] for i in index), strict=True))
    given |= dict(zip((v.name for v in e.start_rates), (run.v[i] for i in index), strict=True))
    return given | ({"A.torque": run.torque} if run.torque else {})


def _columns(p: Problem, e: alfmu.Equations) -> list[str]:
    """Return the names of the outputs to read."""
    names = [f"point{i}.{axis}" for i, (body, _) in enumerate(p.read) if body != GROUND for axis in "xyz"]
    force = [f"{p.closures[0].name}.force.{axis}" for axis in "xy"]
    known = {v.name for v in e.outputs}
    return [name for name in names if name in known] + [x for x in force if x in known and p.reactions != "none"]


def _seen(p: Problem, names: Sequence[str], values: NDArray) -> tuple[NDArray, NDArray | None]:
    """Return positions and forces from values (k, names) of outputs."""
    found = np.zeros((len(values), len(p.read), 3))
    for i, (body, x) in enumerate(p.read):
        found[:, i] = x if body == GROUND else 0.0
    for name, column in zip(names, values.T, strict=True):
        if name.startswith("point"):
            point, axis = name.removeprefix("point").split(".")
            found[:, int(point), "xyz".index(axis)] = column
    force = [i for i, name in enumerate(names) if ".force." in name]
    return found, values[:, None, force] if len(force) == 2 else None


def _settings(tolerance: float) -> dict[str, float]:
    return {"solver.relative_tolerance": tolerance, "solver.absolute_tolerance": tolerance}


def by_alfmu(p: Problem, kernel: str = "vm", method: str = "auto") -> Simulation:
    """Run alfmu's library, a whole run in one call."""
    e = with_defaults(alfmu.derive(declared(p)), {"solver.method": method, **CATALOGUE.get(p.name, ("", {}, {}))[2]})
    names = _columns(p, e)
    scene = prepared(specialised(e, names), kernel)

    def simulate(run: Run, value: float) -> Found:
        i = alfmu.Instance(scene)
        for name, x in {**given(p, run, e), **_settings(value)}.items():
            i.set(name, x)
        begin = time.process_time()
        values, error = i.run(p.times, [], np.empty((len(p.times), 0)), names)
        seconds = time.process_time() - begin
        return Found(*_seen(p, names, values), seconds, str(error) if error else "")

    return simulate


def by_fmu(p: Problem) -> Simulation:
    """Run alfmu's co-simulation FMU in fmpy, a `doStep` and a `getReal` for each time."""
    e = alfmu.derive(declared(p))
    names = _columns(p, e)
    folder = tempfile.TemporaryDirectory()
    parameters = {"solver.method": "auto", **CATALOGUE.get(p.name, ("", {}, {}))[2]}
    path = alfmu.export(declared(p), Path(folder.name) / "problem.fmu", outputs=names, parameters=parameters)  # type: ignore[arg-type]
    fmu = Fmu(path)
    order = [[v.name for v in fmu.outputs].index(name) for name in names]

    def simulate(run: Run, value: float) -> Found:
        assert folder
        if fmu.begun:
            fmu.reset()
        for name, x in {**given(p, run, e), **_settings(value)}.items():
            fmu.set(name, x)
        rows, stopped, begin = [], "", time.process_time()
        try:
            fmu.initialize()
            rows.append(fmu.read())
            for t in p.times[:-1]:
                fmu.step(p.every, float(t))
                rows.append(fmu.read())
        except alfmu.AlfmuError as error:
            stopped = str(error)
        seconds = time.process_time() - begin
        return Found(*_seen(p, names, np.array(rows)[:, order]), seconds, stopped)

    return simulate


# Pinocchio --------------------------------------------------------------------------------------------------------


def by_pinocchio(p: Problem, frequency: float, mu: float, lcaba: bool = False) -> Simulation:
    """Run Pinocchio: a tree with `CONTACT_3D`, Baumgarte's stabilisation of a frequency [1/s], and RK4 in NumPy."""
    import pinocchio as pin

    model, closures, order = pinocchio_model(pin, p, frequency)
    models, datas = pinocchio_contacts(pin, closures)
    data, n = model.createData(), model.nv
    if lcaba:
        pin.computeJointMinimalOrdering(model, data, models)
        settings, function = pin.ProximalSettings(1e-12, 1e-12, mu, 10), pin.lcaba
    else:
        pin.initConstraintDynamics(model, data, models, datas)
        settings, function = pin.ProximalSettings(1e-12, 1e-12, mu, 5), pin.constraintDynamics
    tau = np.zeros(n)

    def rate(y: NDArray) -> NDArray:
        a = function(model, data, y[:n], y[n:], tau, models, datas, settings)
        return np.concatenate([y[n:], a])

    def simulate(run: Run, value: float) -> Found:
        y = np.zeros(2 * n)
        y[:n][order], y[n:][order] = run.q, run.v
        tau[order[0]] = run.torque
        states, forces, each, begin = [], [], round(p.every / value), time.process_time()
        for k in range(len(p.times)):
            for _ in range(each if k else 0):
                k1 = rate(y)
                k2 = rate(y + value / 2 * k1)
                k3 = rate(y + value / 2 * k2)
                k4 = rate(y + value * k3)
                y = y + value / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            if not np.isfinite(y).all():
                break
            states.append(y[:n].copy())
            if not lcaba:
                rate(y)
                forces.append(np.array(data.lambda_c[:3]))
        seconds, q = time.process_time() - begin, np.array(states)[:, order]
        R = poses(p, q)[p.closures[0].first][0]
        force = -np.einsum("kij,kj->ki", R, np.array(forces))[:, None] if forces else None
        return Found(places(p, q), force, seconds, "" if len(q) == len(p.times) else "the state is NaN")

    return simulate


@cache
def pinocchio_driver() -> Path:
    """Return the program of `_pinocchio.cpp`, compiled at first use in two minutes; needs a C++ compiler, the headers
    that come with Pinocchio, and those of Eigen (libeigen3-dev of Debian)."""
    import pinocchio

    source = Path(__file__).with_name("_pinocchio.cpp")
    prefix = next(x for x in Path(pinocchio.__file__).parents if (x / "include" / "pinocchio").is_dir())
    digest = hashlib.sha256(source.read_bytes() + pinocchio.__version__.encode()).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"pinocchio_driver_{digest}"
    if not path.exists():
        flags = ["-O3", "-march=native", "-DNDEBUG", "-std=c++17", "-w", f"-I{prefix}/include", f"-L{prefix}/lib"]
        flags += [f"-I{x}/include/eigen3" for x in ("/usr", "/usr/local", prefix)]
        flags += [f"-DBOOST_MPL_LIMIT_{x}_SIZE=30" for x in ("LIST", "VECTOR")]  # those that it was compiled with
        flags += ["-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS", "-DBOOST_FUSION_INVOKE_MAX_ARITY=12"]
        made = path.with_suffix(f".{os.getpid()}")
        rest = [source, "-o", made, f"-Wl,-rpath,{prefix}/lib", "-lpinocchio_default", "-lboost_serialization"]
        subprocess.run(["c++", *flags, *rest], check=True)
        made.rename(path)
    return path


def by_pinocchio_in_cpp(p: Problem, frequency: float, mu: float, lcaba: bool = False) -> Simulation:
    """Run Pinocchio, called in C++ as `by_pinocchio` calls it in Python."""
    driver, bodies = pinocchio_driver(), p.carried()
    ids = {GROUND: 0, **{body.name: k for k, body in enumerate(bodies, 1)}}
    order = [ids[body.name] - 1 for body in p.bodies]
    points = [(c, first, second) for c in p.closures for first, second in axes_points(c)]
    about: list[Any] = [*p.gravity, len(bodies)]
    for x in bodies:
        about += [ids[x.parent], x.joint, *x.axis, *x.at, x.mass, *x.center, *np.ravel(x.inertia)]
    about += [len(points)]
    for c, first, second in points:
        about += [ids[c.first], *first, ids[c.second], *second]

    def simulate(run: Run, value: float) -> Found:
        start, tau = np.zeros((2, len(bodies))), np.zeros(len(bodies))
        start[0, order], start[1, order], tau[order[0]] = run.q, run.v, run.torque
        how = [int(lcaba), frequency, mu, value, len(p.times), round(p.every / value)]
        text = " ".join(x if isinstance(x, str) else repr(float(x)) for x in (*how, *about, *start.ravel(), *tau))
        text = text.replace(".0 ", " ")
        done = subprocess.run([driver], input=text, capture_output=True, text=True, check=False, timeout=60)
        if done.returncode:
            why = done.stderr.rpartition("what():")[2].strip()
            raise RuntimeError(f"the program in C++ ended with code {done.returncode}: {why}")
        first, *lines = done.stdout.splitlines()
        rows = np.array([line.split() for line in lines], float)
        q, forces = rows[:, : len(bodies)][:, order], rows[:, len(bodies) :]
        R = poses(p, q)[p.closures[0].first][0]
        force = -np.einsum("kij,kj->ki", R, forces)[:, None] if forces.size else None
        return Found(places(p, q), force, float(first), "" if len(q) == len(p.times) else "the state is NaN")

    return simulate


# Drake ------------------------------------------------------------------------------------------------------------


def by_drake(p: Problem) -> Simulation:
    """Run Drake: its discrete MultibodyPlant with SAP, of order 1; its continuous plant cannot close loops."""
    from pydrake import all as drake

    def built(value: float) -> tuple[Any, list[Any]]:
        plant = drake.MultibodyPlant(value)
        plant.set_discrete_contact_approximation(drake.DiscreteContactApproximation.kSap)
        plant.mutable_gravity_field().set_gravity_vector(np.array(p.gravity, float))
        frames, joints = {GROUND: plant.world_body()}, []
        for body in p.bodies:
            J, c = np.array(body.inertia), np.array(body.center, float)
            moments = drake.RotationalInertia(J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
            about = drake.SpatialInertia.MakeFromCentralInertia(body.mass, c, moments)
            frames[body.name] = plant.AddRigidBody(body.name, about)
            kind = drake.RevoluteJoint if body.joint == "revolute" else drake.PrismaticJoint
            place, parent = drake.RigidTransform(np.array(body.at, float)), frames[body.parent].body_frame()
            at = plant.AddFrame(drake.FixedOffsetFrame(f"at {body.name}", parent, place))
            own, axis = frames[body.name].body_frame(), np.array(body.axis, float)
            joints.append(plant.AddJoint(kind(body.name, at, own, axis)))
        for c in p.closures:
            ends = frames[c.first], np.array(c.first_at, float), frames[c.second], np.array(c.second_at, float)
            if c.kind == "distance":
                plant.AddDistanceConstraint(*ends, c.length)
            else:
                for first, second in axes_points(c):
                    plant.AddBallConstraint(frames[c.first], np.array(first), frames[c.second], np.array(second))
        if any(run.torque for run in p.runs):
            plant.AddJointActuator("torque", joints[0])
        plant.Finalize()
        return plant, joints

    def simulate(run: Run, value: float) -> Found:
        plant, joints = built(value)
        simulator = drake.Simulator(plant)
        context = simulator.get_mutable_context()
        for joint, q, v in zip(joints, run.q, run.v, strict=True):
            turns = isinstance(joint, drake.RevoluteJoint)
            (joint.set_angle if turns else joint.set_translation)(context, q)
            (joint.set_angular_rate if turns else joint.set_translation_rate)(context, v)
        if plant.num_actuators():
            plant.get_actuation_input_port().FixValue(context, [run.torque])
        simulator.Initialize()
        states, order, begin = [], [joint.position_start() for joint in joints], time.process_time()
        for t in p.times:
            simulator.AdvanceTo(float(t))
            states.append(plant.GetPositions(context)[order])
        return Found(places(p, np.array(states)), None, time.process_time() - begin)

    return simulate


# SciPy ------------------------------------------------------------------------------------------------------------


def by_scipy(p: Problem, frequency: float) -> Simulation:
    """Run SciPy: DOP853 on the index-1 form by least squares, with Baumgarte's stabilisation."""
    n = len(p.bodies)
    q, v, tau = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("tau")
    at = {GROUND: (ca.SX.eye(3), ca.SX.zeros(3), ca.SX.zeros(3))}
    M, r = ca.SX(n, n), ca.SX(n, 1)
    for i, body in enumerate(p.bodies):
        (R, o, w), axis = at[body.parent], ca.DM(list(body.axis))
        o = o + R @ ca.DM(list(body.at))
        if body.joint == "prismatic":
            at[body.name] = R, o + R @ axis * q[i], w
        else:
            K = ca.DM(skew(body.axis))
            at[body.name] = R @ (ca.DM.eye(3) + ca.sin(q[i]) * K + (1 - ca.cos(q[i])) * K @ K), o, w + R @ axis * v[i]
        R, o, w = at[body.name]
        c, I = o + R @ ca.DM(list(body.center)), R @ ca.DM(np.array(body.inertia)) @ R.T
        J, W = ca.jacobian(c, q), ca.jacobian(w, v)
        bias, turn = ca.jtimes(ca.jtimes(c, q, v), q, v), ca.jtimes(w, q, v)
        M += body.mass * J.T @ J + W.T @ I @ W
        r += body.mass * J.T @ (ca.DM(list(p.gravity)) - bias) - W.T @ (I @ turn + ca.cross(w, I @ w))
    r[0] += tau
    rows = []
    for c in p.closures:
        (R, o, _), (S, x, _) = at[c.first], at[c.second]
        gap = x + S @ ca.DM(list(c.second_at)) - o - R @ ca.DM(list(c.first_at))
        if c.kind == "distance":
            rows.append(ca.norm_2(gap) - c.length)
            continue
        rows += ca.vertsplit(gap[:2] if p.planar else gap)
        if c.kind == "hinge":
            first, second = R @ ca.DM(list(c.axis)), S @ ca.DM(list(c.second_axis))
            rows += ca.vertsplit(ca.cross(first, second))
    Phi = ca.vertcat(*rows)
    C = ca.jacobian(Phi, q)
    xi = -ca.jtimes(C @ v, q, v) - 2 * frequency * C @ v - frequency**2 * Phi
    terms = ca.Function("terms", [q, v, tau], [ca.densify(x) for x in (M, r, C, xi)], {"cse": True})
    l = len(rows)

    def simulate(run: Run, value: float) -> Found:
        def solve(y: NDArray) -> tuple[NDArray, NDArray]:
            M, r, C, xi = (np.array(x) for x in terms(y[:n], y[n:], run.torque))
            solution = np.linalg.solve(M, np.hstack([r, C.T]))
            S = C @ solution[:, 1:]
            lam = dgelsy(S, C @ solution[:, :1] - xi, np.zeros(l, np.int32), 1e-8, 16 * l + 64)[1][:l, 0]
            return solution[:, 0] - solution[:, 1:] @ lam, lam

        def rate(y: NDArray) -> NDArray:
            return np.concatenate([y[n:], solve(y)[0]])

        begin = time.process_time()
        states = solved(rate, np.array([*run.q, *run.v]), "DOP853", value, p.times)
        seconds = time.process_time() - begin
        force = np.array([[-solve(y)[1][:2]] for y in states]) if p.forces_are_read else None
        stopped = "" if len(states) == len(p.times) else "no step succeeds"
        return Found(places(p, states[:, :n]), force, seconds, stopped)

    return simulate


FIXED, ORDER_1 = (1e-2, 5e-3, 2.5e-3, 1e-3, 5e-4), (1e-2, 1e-3, 2e-4)
METHODS = [{"method": "explicit"}, {"method": "stiff"}]
STABLE = [{"frequency": w} for w in (40.0, 5.0, 100.0)]
HARD = [{"hardness": c} for c in (0.2, 1.0, 2.0, 4.0)]
PROXIMAL = [{"frequency": w, "mu": mu} for w in (20.0, 0.0, 60.0, 150.0) for mu in (1e-6, 1e-4, 1e-8, 1e-10)]

CODES = {
    "alfmu": Code(by_alfmu, "alfmu", TOLERANCES, "tolerance", "alfmu"),
    "alfmu, compiled": Code(partial(by_alfmu, kernel="compiled"), "alfmu", TOLERANCES, "tolerance", "alfmu"),
    "alfmu, chosen method": Code(
        by_alfmu, "alfmu", (1e-4, 1e-8, 1e-10, 1e-11, 1e-12, 1e-13), "tolerance", "alfmu", METHODS
    ),
    "alfmu, FMU": Code(by_fmu, "fmpy", TOLERANCES, "tolerance", "fmpy"),
    "Pinocchio, constraintDynamics": Code(by_pinocchio, "pin", FIXED, module="pinocchio", variants=PROXIMAL),
    "Pinocchio, lcaba": Code(partial(by_pinocchio, lcaba=True), "pin", FIXED, module="pinocchio", variants=PROXIMAL),
    "Pinocchio in C++, constraintDynamics": Code(
        by_pinocchio_in_cpp, "pin", FIXED, module="pinocchio", variants=PROXIMAL
    ),
    "Pinocchio in C++, lcaba": Code(
        partial(by_pinocchio_in_cpp, lcaba=True), "pin", FIXED, module="pinocchio", variants=PROXIMAL
    ),
    "MuJoCo": Code(by_mujoco, "mujoco", FIXED, module="mujoco", variants=HARD),
    "Exudyn": Code(by_exudyn, "exudyn", (1e-2, 1e-3, 2e-4), module="exudyn"),
    "Drake": Code(by_drake, "drake", ORDER_1, module="pydrake"),
    "SciPy": Code(by_scipy, "scipy", TOLERANCES[1:-1], "tolerance", "scipy", STABLE),
}
"""All codes, by their names in tables."""
