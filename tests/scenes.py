"""Small mechanisms that the tests declare themselves, and helpers that put one into any state."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeVar

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from oracles.parallelogram import Parallelogram

import alfmu
from alfmu.method import formulations as method
from alfmu.model.settings import Settings
from alfmu.simulation import instance, oracle, with_defaults

Unit = TypeVar("Unit")

ARM = {"carriage": (1.3, 0.05, (0.05, -0.02)), "boom": (0.8, 0.03, (0.3, 0.1)), "tip": (0.4, 0.01, (0.1, 0.05))}
"""Mass, inertia, centre of mass of the bodies of `arm`."""

SLIDE = {"axis": 0.4, "offset": 0.15, "angle": 0.7}
GLUE = 0.9


def arm(closed_by: str) -> alfmu.Mechanism:
    """A carriage on an inclined guide, a boom hinged to it, a tip welded to the boom: every load and spring there is.

    The joints are closed by coordinates [s, th], or by constraints between bodies in absolute coordinates.
    """
    m = alfmu.Mechanism("arm")
    absolute = closed_by == "constraints"
    s = th = None
    if not absolute:
        s = m.coordinate("s", "m", start=0.3, independent=True)
        th = m.coordinate("th", "rad", start=-0.4, independent=True)
    bodies = []
    for name, (mass, inertia, center) in ARM.items():
        pose = tuple(m.coordinate(f"{name}_{k}", "rad" if k == "a" else "m") for k in "xya") if absolute else None
        bodies.append(m.body(name, mass=mass, inertia=inertia, center=center, pose=pose))
    carriage, boom, tip = bodies
    slide = m.prismatic("slide", m.ground.at(0.1, 0.2), carriage.at(0.02, 0.03), coordinate=s, **SLIDE)
    hinge = m.revolute("hinge", carriage.at(0.1, -0.05), boom.at(-0.02, 0.04), coordinate=th)
    m.weld("glue", boom.at(0.5, 0.1), tip.at(-0.03, 0.02), angle=GLUE)
    m.gravity(0.5, -9.81)
    m.drive(slide, m.input("slide.drive", "N"))
    m.drive(hinge, m.input("hinge.drive", "N.m"))
    m.force(tip.at(0.3, 0.1), x=m.input("tip.pull", "N"), y=2.0 * ca.cos(m.time))
    m.torque(boom, m.input("boom.torque", "N.m"))
    m.spring_damper(slide, stiffness=30.0, damping=2.0, rest=0.2)
    m.spring_damper(hinge, stiffness=4.0, damping=0.3, rest=0.1)
    m.spring_damper((m.ground.at(0.4, 1.5), tip.at(0.2, 0.0)), stiffness=12.0, damping=0.7, rest=0.5)
    m.friction(hinge, 0.2)
    return m


QUICK_RETURN = {
    "crank": (0.6, 0.02, (0.15, 0.03)),
    "rocker": (1.1, 0.12, (0.5, -0.02)),
    "ram": (0.9, 0.0, (0.0, 0.0)),
    "box": (0.5, 0.02, (0.02, 0.06)),
    "sleeve": (0.3, 0.004, (0.01, 0.02)),
}
"""Mass, inertia, centre of mass of the bodies of `quick_return`."""


def quick_return() -> alfmu.Mechanism:
    """A crank whose pin runs in a slot of a rocker, a massless rod from the rocker to a ram, a box welded to the ram by
    constraints, a sleeve on the rocker by constraints: two degrees of freedom in nine coordinates."""
    m = alfmu.Mechanism("quick_return")
    th = m.coordinate("th", "rad", start=0.5, rate=2.0, independent=True)
    phi = m.coordinate("phi", "rad", start=1.3)
    s = m.coordinate("s", "m", start=0.9)
    bodies = {}
    poses = {
        "box": tuple(
            m.coordinate(f"box_{k}", u, start=x) for k, u, x in (("x", "m", 1.0), ("y", "m", 0.6), ("a", "rad", 0.3))
        ),
        "sleeve": tuple(
            m.coordinate(f"sleeve_{k}", u, start=x) for k, u, x in (("x", "m", 0.1), ("y", "m", 0.0), ("a", "rad", 1.5))
        ),
    }
    for name, (mass, inertia, center) in QUICK_RETURN.items():
        bodies[name] = m.body(name, mass=mass, inertia=inertia, center=center, pose=poses.get(name))
    crank, rocker, ram, box, sleeve = bodies.values()
    axle = m.revolute("axle", m.ground.at(0.0, 0.0), crank.at(0.0, 0.0), coordinate=th)
    pivot = m.revolute("pivot", m.ground.at(0.0, -0.6), rocker.at(0.0, 0.0), coordinate=phi)
    track = m.prismatic("track", m.ground.at(0.0, 0.5), ram.at(0.0, 0.0), axis=0.1, coordinate=s)
    m.point_on_line("slot", rocker.at(0.0, 0.01), crank.at(0.3, 0.0), axis=0.05, offset=0.02)
    m.distance("rod", rocker.at(1.1, 0.05), ram.at(0.05, 0.02), length=0.8)
    m.weld("bolts", ram.at(0.1, 0.1), box.at(-0.02, 0.01), angle=0.3)
    sliding = m.prismatic("bush", rocker.at(0.1, 0.03), sleeve.at(0.01, -0.01), axis=0.05, offset=-0.04, angle=0.2)
    m.gravity(0.0, -9.81)
    m.drive(axle, m.input("axle.torque", "N.m"))
    m.force(ram.at(0.2, 0.05), x=m.input("ram.load", "N"), y=-1.5)
    m.torque(box, m.input("box.torque", "N.m"))
    m.spring_damper(pivot, stiffness=3.0, damping=0.4, rest=1.2)
    m.spring_damper(sliding, stiffness=60.0, damping=1.5, rest=0.4)
    m.spring_damper((sleeve.at(0.0, 0.05), ram.at(0.0, -0.05)), stiffness=8.0, damping=0.6, rest=0.3)
    m.friction(track, 0.8)
    return m


def cusp() -> alfmu.Mechanism:
    """A point on y^2 = x^3 at constant speed: it comes to the cusp, where the curve has no way on, at 0.7986 s."""
    m = alfmu.Mechanism("cusp")
    x = m.coordinate("x", "m", start=1.0, rate=-1.0, independent=True)
    y = m.coordinate("y", "m", start=1.0)
    m.kinetic_energy((m.rate(x) ** 2 + m.rate(y) ** 2) / 2)
    m.constraint("curve", y**2 - x**3, "m")
    m.output("place", x, "m")
    return m


def double_pendulum() -> alfmu.Mechanism:
    """Two bars of 1 m and 1 kg; the second torn off, so that constraints close the elbow."""
    m = alfmu.Mechanism("double_pendulum")
    th = m.coordinate("th", "rad", start=0.3, rate=1.0, independent=True)
    phi = m.start("elbow", 0.8, "rad", rate=-3.0, rate_name="elbow_rate")
    x, y = (m.coordinate(k, "m", start=place) for k, place in (("x", 1.3), ("y", 0.7)))
    angle = m.coordinate("angle", "rad", start=phi)
    upper = m.bar("upper", mass=1.0, length=1.0)
    lower = m.bar("lower", mass=1.0, length=1.0, pose=(x, y, angle))
    m.revolute("shoulder", m.ground.at(0.0, 0.0), upper.start, coordinate=th)
    m.lock(m.revolute("elbow", upper.end, lower.start))
    m.gravity(0.0, -9.81)
    return m


def hinged(
    name: str, *, bar: str = "bar", joint: str = "A", angle: str = "th", mass: Any = 1.0, length: Any = 1.0,
    weight: float = 9.81, **start: Any,
) -> tuple[alfmu.Mechanism, Any, Any, ca.SX]:  # fmt: skip
    """A mechanism of a bar on a hinge at the origin, which begins at an angle; the bar, the hinge and the angle."""
    m = alfmu.Mechanism(name)
    th = m.coordinate(angle, "rad", **start)
    hung = m.bar(bar, mass=mass, length=length)
    hinge = m.revolute(joint, m.ground.at(0, 0), hung.start, coordinate=th)
    if weight:
        m.gravity(0, -weight)
    return m, hung, hinge, th


def sliding(
    name: str, *, body: str = "block", joint: str = "guide", place: str = "s", mass: Any = 1.0, **start: Any
) -> tuple[alfmu.Mechanism, Any, Any, ca.SX]:
    """A mechanism of a block in a guide through the origin, with a start; the block, the guide and the place."""
    m = alfmu.Mechanism(name)
    s = m.coordinate(place, "m", **start)
    block = m.body(body, mass=mass)
    return m, block, m.prismatic(joint, m.ground.at(0, 0), block.at(0, 0), coordinate=s), s


@cache
def derived(name: str, **options: str) -> alfmu.Equations:
    """Equations of a registered mechanism, derived once."""
    return alfmu.derive(alfmu.load(name, **options))


@cache
def by_rk4(name: str, **options: str) -> alfmu.Equations:
    """The same, to be integrated by RK4 with steps of one length, as the oracle does."""
    return with_defaults(derived(name, **options), {"solver.method": "rk4"})


def evaluate(
    equations: alfmu.Equations, q: Sequence, v: Sequence, u: Sequence = (), t: float = 0.0, p: Sequence | None = None
) -> dict[str, float]:
    """Everything that can be read of a mechanism put into the state q, v, with multipliers of least norm."""
    q, v, u = (np.array(x, float) for x in (q, v, u))
    p = np.array([x.start for x in equations.parameters] if p is None else p, float)
    M, C, F, xi = (np.array(x) for x in equations.functions["dynamics"](q, v, u, p, t))
    F, xi, alpha = F.ravel(), xi.ravel(), 1e8 * max(M.diagonal().max(), 1e-300) * np.eye(len(C))
    H, zeros = method.augmented_mass(M, C, alpha), (np.zeros(len(M)), np.zeros(len(C)))

    def done(change: np.ndarray, value: np.ndarray) -> bool:
        return np.abs(change).max(initial=0.0) <= 1e-16 * np.abs(value).max(initial=0.0)

    def solve(b: np.ndarray) -> np.ndarray:
        return np.linalg.solve(H, b)

    a, lam, _, _ = method.residual(M, F, C, xi, alpha, solve, *zeros, 20, done)
    lam = method.minimum_norm(C, alpha, solve, lam, 20, done)
    y = np.array(equations.functions["readings"](q, v, a, lam, u, p, t)).ravel()
    names = [x.name for x in equations.outputs]
    return dict(zip(names, y, strict=True)) | {c.name: x for c, x in zip(equations.coordinates, q, strict=True)}


def made(equations: alfmu.Equations, kernel: str, settings: Settings | None = None) -> alfmu.Instance:
    """An instance run by a kernel, `oracle` among them."""
    return instance(equations, kernel, settings)


def parameters(i: alfmu.Instance) -> np.ndarray:
    """Parameters p of an instance that is initialised, with what locks keep."""
    return i.memory["p"].copy()


def initialized(unit: Unit, given: Mapping[str, Any] | None = None, **more: Any) -> Unit:
    """The instance, batch or FMU itself, initialised with values by name; two underscores of a keyword are a point."""
    for name, value in {**(given or {}), **{name.replace("__", "."): value for name, value in more.items()}}.items():
        unit.set(name, value)
    unit.initialize()
    return unit


def started(
    equations: alfmu.Equations,
    given: Mapping[str, float | str] | None = None,
    kind: type[alfmu.Instance] = alfmu.Instance,
    **settings,
) -> alfmu.Instance:
    """An initialised instance with parameters, start values, inputs and solver numbers by name."""
    return initialized(
        kind(equations, Settings(**{"step_size": equations.step_size, "method": "rk4", **settings})), given
    )


by_the_oracle = partial(started, kind=oracle.Instance)
"""What `started` gives, on NumPy arrays."""


def multipliers(i: alfmu.Instance) -> np.ndarray:
    """All multipliers, in the order of the rows."""
    return np.array([i.get(f"multiplier[{k + 1}]") for k in range(i.equations.l)])


@contextmanager
def refused(unit: Any, error: type[alfmu.AlfmuError], match: str) -> Iterator[Any]:
    """A call of a unit that fails by an error, and changes nothing in its state."""
    before = unit.save()
    with pytest.raises(error, match=match) as told:
        yield told
    assert unit.save() == before


def readings(instance: alfmu.Instance) -> dict[str, float]:
    """All outputs by name."""
    return {v.name: x for v, x in zip(instance.outputs, instance.read(), strict=True)}


def _torque(t: float) -> float:
    """Flat at the start, where there is no past to extrapolate from."""
    return 2 * (1 - np.cos(2 * t)) ** 2


@cache
def _under_torque() -> np.ndarray:
    """The angle of the four-bar every 0.04 s."""
    linkage = Parallelogram(m4=None)
    inertia, weight = float(linkage.inertia), float(linkage.weight)
    times = np.linspace(0.0, 2.0, 51)
    return ode.motion(lambda t, x, v: (_torque(t) - weight * np.cos(x)) / inertia, -1.0, 0.0, times)[:, 0]


def sampled(unit, step: float) -> float:
    """Largest error of the angle of a four-bar under a smooth torque that is sampled at communication points.

    The unit is initialised at rest at -1 rad; two seconds, compared every 0.04 s.
    """
    angle, worst = [v.name for v in unit.outputs].index("link1.angle"), 0.0
    for k in range(round(2.0 / step)):
        unit.set("A.torque", _torque(k * step))
        unit.step(step, k * step)
        here = (k + 1) * step / 0.04
        if here == round(here):
            worst = max(worst, abs(unit.read()[angle] - _under_torque()[round(here)]))
    return worst
