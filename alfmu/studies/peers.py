"""Models of two mechanisms in Pinocchio, Exudyn, MuJoCo and SciPy; each runs if it is installed.

five_bar      links of 1 m and 1 kg; one constraint is redundant
slider_crank  crank 0.5 m, rod 1 m, 1 kg each and for the slider

Gravity alone acts on both, from an angle and a rate of the first link. Reactions are forces on the second body from the
first in ground axes [N], named as in alfmu: A to F (x and y) of the five-bar, A, B, C (x and y) and the guide of the
slider-crank.
"""

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg.lapack import dgelsy

from ..catalogue.registry import load
from ..equations.derivation import derive
from ..runtime import Instance
from .trees import (
    GROUND,
    Body,
    Closure,
    Found,
    Point,
    Simulation,
    Start,
    Tree,
    pinocchio_contacts,
    pinocchio_model,
    places,
    poses,
)

GRAVITY = 9.81

EVALUATIONS = 100_000
"""Number of evaluations after which an adaptive integrator is stopped."""

CRANK, ROD = 0.5, 1.0
"""Lengths of the slider-crank [m]."""


@dataclass(frozen=True)
class Machine(Tree):
    """A mechanism that other codes run, from an angle and a rate of its first link."""

    name: str
    bodies: Sequence[Body]
    closures: Sequence[Closure]
    begin: Callable[[float, float], Start]
    """Start for an angle [rad] and a rate [rad/s] of the first link."""
    outputs: Sequence[str]
    """Names of the angle of the first link, and of the forces (x, y) of closures and bodies; empty for those that are
    zero."""
    times: NDArray = field(default_factory=lambda: np.zeros(1))
    gravity: Point = (0.0, -GRAVITY, 0.0)

    @property
    def read(self) -> list[tuple[str, Point]]:
        """The end of the first link, which tells its angle."""
        return [(self.bodies[0].name, (1.0, 0.0, 0.0))]

    @property
    def names(self) -> list[str]:
        """Names of the outputs that are compared."""
        return [name for name in self.outputs if name]

    def table(self, found: Found) -> NDArray:
        """Return the outputs of a run (k, names)."""
        assert found.forces is not None
        angle = np.arctan2(found.places[:, 0, 1], found.places[:, 0, 0])
        every = np.column_stack([angle, found.forces[:, :, :2].reshape(len(angle), -1)])
        return every[:, [bool(name) for name in self.outputs]]

    def found(self, table: NDArray, seconds: float) -> Found:
        """Return the results with these outputs (k, names)."""
        every = np.zeros((len(table), len(self.outputs)))
        every[:, [bool(name) for name in self.outputs]] = table
        places = np.column_stack([np.cos(every[:, 0]), np.sin(every[:, 0]), 0 * every[:, 0]])
        return Found(places[:, None], every[:, 1:].reshape(len(table), -1, 2), seconds)


def _bar(name: str, parent: str, x: float, length: float = 1.0) -> Body:
    """Return a thin bar of 1 kg along x on a hinge at x of its parent."""
    moment = length**2 / 12
    inertia = [[0.0, 0.0, 0.0], [0.0, moment, 0.0], [0.0, 0.0, moment]]
    return Body(name, parent, (x, 0.0, 0.0), 1.0, (length / 2, 0.0, 0.0), inertia)


def _five_bar() -> Machine:
    bodies = [_bar("link1", GROUND, 0.0), _bar("link2", "link1", 1.0)]
    bodies += [_bar("link3", GROUND, 1.0), _bar("link4", "link1", 0.5)]
    closures = [
        Closure("C", "link2", (1, 0, 0), "link3", (1, 0, 0)),
        Closure("F", "link4", (1, 0, 0), "link3", (0.5, 0, 0)),
    ]
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    names = [f"{joint}.force.{axis}" for joint in "CFABDE" for axis in "xy"]
    return Machine("five_bar", bodies, closures, lambda th, w: Start(th * signs, w * signs), ["link1.angle", *names])


def _slider_crank() -> Machine:
    def begin(th: float, w: float) -> Start:
        rod = math.asin(-CRANK / ROD * math.sin(th))
        turning = -CRANK * math.cos(th) * w / (ROD * math.cos(rod))
        place = CRANK * math.cos(th) + ROD * math.cos(rod)
        speed = -CRANK * math.sin(th) * w - ROD * math.sin(rod) * turning
        return Start((th, rod - th, place), (w, turning - w, speed))

    slider = Body("slider", GROUND, (0, 0, 0), 1.0, (0, 0, 0), [[0.0] * 3] * 3, "prismatic", (1, 0, 0))
    bodies = [_bar("crank", GROUND, 0.0, CRANK), _bar("rod", "crank", CRANK, ROD), slider]
    names = [f"{joint}.force.{axis}" for joint in "CAB" for axis in "xy"]
    outputs = ["crank.angle", *names, "", "guide.force"]
    closure = Closure("C", "rod", (ROD, 0, 0), "slider", (0, 0, 0))
    return Machine("slider_crank", bodies, [closure], begin, outputs)


MACHINES = {machine.name: machine for machine in (_five_bar(), _slider_crank())}
"""Mechanisms that other codes run, by name."""


def solved(rate: Callable, start: NDArray, method: str, tolerance: float, times: NDArray) -> NDArray:
    """Return states at the times by `solve_ivp`, (k, 2 n); fewer if it fails; raise TimeoutError if it takes
    too long."""
    count = itertools.count()

    def counted(t: float, y: NDArray) -> NDArray:
        if next(count) > EVALUATIONS:
            raise TimeoutError(f"{EVALUATIONS} evaluations at t = {t:.3g} s")
        return rate(y)

    return solve_ivp(counted, (0.0, times[-1]), start, method, times, rtol=tolerance, atol=tolerance).y.T


def by_pinocchio(p: Machine, frequency: float = 0.0, method: str = "RK4") -> Simulation:
    """Run `pin.constraintDynamics` (proximal) on a tree, closed by CONTACT_3D with stabilisation of a frequency [1/s],
    by RK4 or a method of `solve_ivp`; `pin.rnea` gives joint forces."""
    import pinocchio as pin

    model, closures, order = pinocchio_model(pin, p, frequency)
    models, datas = pinocchio_contacts(pin, closures)
    data, n = model.createData(), model.nv
    pin.initConstraintDynamics(model, data, models, datas)
    proximal, tau = pin.ProximalSettings(1e-12, 1e-12, 1e-8, 3), np.zeros(n)
    dynamics, rnea, times = pin.constraintDynamics, pin.rnea, p.times
    states, contacts = np.empty((len(times), 2 * n)), np.empty((len(times), 3 * len(closures)))
    felt, inner = np.empty((len(times), n, 3)), [force.linear for force in data.f][1:]  # views

    def record(k: int, y: NDArray, a: NDArray) -> None:
        """Store forces without those of the closures in the frames of the joints, right after y gave a."""
        states[k], contacts[k] = y, data.lambda_c
        rnea(model, data, y[:n], y[n:], a)
        felt[k] = inner

    def runge_kutta(y: NDArray, step: float) -> int:
        s, K = np.empty(2 * n), np.empty((4, 2 * n))
        q, v, weights, steps = s[:n], s[n:], np.array([1, 2, 2, 1]) * step / 6, range(p.steps(step))
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
        return len(times)

    def rate(y: NDArray) -> NDArray:
        return np.append(y[n:], dynamics(model, data, y[:n], y[n:], tau, models, datas, proximal))

    def adaptive(y: NDArray, tolerance: float) -> int:
        found = solved(rate, y, method, tolerance, times)
        for k, each in enumerate(found):
            record(k, each, rate(each)[n:])
        return len(found)

    def simulate(start: Start, value: float) -> Found:
        y = np.zeros(2 * n)
        y[:n][order], y[n:][order] = start.q, start.v
        begin = time.process_time()
        k = (runge_kutta if method == "RK4" else adaptive)(y, value)
        seconds, q = time.process_time() - begin, states[:k, :n][:, order]
        return Found(places(p, q), _joint_forces(p, q, felt[:k, order], contacts[:k]), seconds)

    return simulate


def _joint_forces(p: Machine, q: NDArray, felt: NDArray, contacts: NDArray) -> NDArray:
    """Return forces (k, closures and bodies, 3) on second bodies in ground axes, from forces in the axes of bodies.

    `felt` are the joint forces of the open tree, `contacts` the forces of the closures on their first bodies.
    """
    turns = {name: R for name, (R, _) in poses(p, q).items()}
    found = {body.name: np.einsum("kij,kj->ki", turns[body.name], felt[:, i]) for i, body in enumerate(p.bodies)}
    parents, closing = {body.name: body.parent for body in p.bodies}, []
    for i, c in enumerate(p.closures):
        closing.append(-np.einsum("kij,kj->ki", turns[c.first], contacts[:, 3 * i : 3 * i + 3]))
        for end, sign in ((c.first, 1), (c.second, -1)):
            while end != GROUND:
                found[end] = found[end] + sign * closing[i]
                end = parents[end]
    return np.stack([*closing, *found.values()], 1)


def by_scipy(p: Machine, omega: float, cut: float, coordinates: str, method: str = "DOP853") -> Simulation:
    """Run `solve_ivp` on alfmu's M, C, f, xi, Phi in the index-1 form (9), by elimination of a and least squares.

    `omega` is a frequency of stabilisation [1/s], `cut` the ratio below which singular values are cut off.
    """
    e = derive(load(p.name, coordinates=coordinates))
    instance, n, l = Instance(e), e.n, e.l
    instance.initialize()
    values, u = instance.values[: len(e.parameters)], instance.inputs
    q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
    C, inverse = e.C(q, values), ca.inv(e.M(q, values))
    falling, pulled = inverse @ (e.f(q, v, u, values, 0) - e.d(q, v, values)), inverse @ C.T
    xi = e.xi(q, v, values) - 2 * omega * C @ v - omega**2 * e.Phi(q, values)
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
    columns = [names.index(name) for name in p.names]

    def simulate(start: Start, tolerance: float) -> Found:
        begun = Instance(e)
        begun.set("start.angle", start.q[0])
        begun.set("start.angular_velocity", start.v[0])
        begun.initialize()
        begin = time.process_time()
        states = solved(rate, np.concatenate([begun.q, begun.v]), method, tolerance, p.times)
        a, lam = (np.array(x).T for x in zip(*map(solve, states), strict=True))
        Q, V, P, U = states[:, :n].T, states[:, n:].T, *(np.tile(x[:, None], len(states)) for x in (values, u))
        seen = np.array(e.readings(Q, V, a, lam, U, P, np.zeros((1, len(states)))))[columns].T
        return p.found(seen, time.process_time() - begin)

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
