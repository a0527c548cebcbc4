"""Every joint in space, closed by constraints and by coordinates, with loads, springs, drives and matrices of inertia:
Newton's and Euler's laws for each body, and each way of coordinates against the other."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from oracles.free_body import SpatialBalance
from scenes import by_the_oracle, evaluate, initialized, started
from scipy.spatial.transform import Rotation

import alfmu
from alfmu.model import spatial
from alfmu.runtime.probe import Probe
from alfmu.simulation import with_defaults
from alfmu.view.drawing import as_data, from_data
from alfmu.view.pieces import pieces_of
from alfmu.view.shapes import geometry
from alfmu.view.space import place_of, poses_of, view_of

MASS, CENTERS = 1.3, {"base": (0.1, 0.0, -0.1), "arm": (0.05, -0.02, 0.03), "tool": (0.0, 0.04, 0.1)}
INERTIA = ((0.04, -0.006, 0.004), (-0.006, 0.05, 0.003), (0.004, 0.003, 0.06))
GRAVITY = (0.5, -0.3, -9.81)
AXIS, SECOND, ACROSS = (1.0, 2.0, -0.5), (0.3, -1.0, 0.4), (2.0, -1.0, 0.0)
AT, ON = (0.1, -0.2, 0.3), (-0.05, 0.1, 0.2)
LEAD = -0.3

UNITS = {
    "revolute": ["rad"],
    "prismatic": ["m"],
    "screw": ["rad"],
    "cylindrical": ["rad", "m"],
    "universal": ["rad", "rad"],
    "planar": ["m", "m", "rad"],
    "spherical": ["1"] * 4,
    "weld": [],
}
"""Coordinates of the joint under test."""


def pair(kind: str, relative: bool, leaning: bool = False) -> alfmu.Mechanism:
    """A free base, an arm on it by the joint under test, a tool hinged to the arm; all loads and springs there are.

    `leaning` has its axes depend on a parameter, at whose value 0 they are as without.
    """
    m = alfmu.Mechanism("pair")
    m.gravity(*GRAVITY)
    axis, other = AXIS, SECOND
    if leaning:
        lean = m.parameter("lean", 0.2, "rad")
        axis, other = (1.0 + lean, 2.0 * ca.cos(lean), -0.5), (0.3, -1.0, 0.4 * ca.exp(lean))
    base = m.spatial_body("base", mass=MASS, inertia=INERTIA, center=CENTERS["base"])
    arm = m.spatial_body("arm", mass=MASS, inertia=INERTIA, center=CENTERS["arm"], relative=relative)
    tool = m.spatial_body("tool", mass=0.4, inertia=(0.02, 0.03, 0.04), center=CENTERS["tool"], relative=relative)
    c = [m.coordinate(f"c{i}", u) for i, u in enumerate(UNITS[kind])] if relative else None
    one = None if c is None or len(c) != 1 else c[0]
    first, second = base.at(*AT), arm.at(*ON)
    joint = {
        "revolute": lambda: m.spatial_revolute("J", first, second, axis=axis, second_axis=other, coordinate=one),
        "prismatic": lambda: m.spatial_prismatic("J", first, second, axis=axis, coordinate=one),
        "screw": lambda: m.spatial_screw("J", first, second, axis=axis, second_axis=other, lead=LEAD, coordinate=one),
        "cylindrical": lambda: m.cylindrical("J", first, second, axis=axis, second_axis=other, coordinates=c),
        "universal": lambda: m.universal("J", first, second, axis=AXIS, second_axis=ACROSS, coordinates=c),
        "planar": lambda: m.planar("J", first, second, axis=axis, second_axis=other, coordinates=c),
        "spherical": lambda: m.spherical("J", first, second, coordinates=c),
        "weld": lambda: m.spatial_weld("J", first, second),
    }[kind]()
    th = m.coordinate("th", "rad") if relative else None
    hinge = m.spatial_revolute("K", arm.at(0.2, 0, 0), tool.at(0, -0.1, 0), axis=(0, 1, 0), coordinate=th)
    for which in joint.freedoms:
        free = joint.freedom(which)
        m.drive(free, 3.0)
        m.spring_damper(free, stiffness=5.0, damping=0.7, rest=0.1)
    m.friction(hinge, 0.2)
    m.drive(hinge, m.input("K.torque", "N.m"))
    m.end_stop("knock", hinge, upper=0.2, stiffness=5.0, dissipation=0.1)
    m.end_stop("reach", (base.at(), tool.at()), upper=0.01, stiffness=3.0)
    m.force(arm.at(0.3, 0.1, 0.0), 1.0, m.input("pull", "N"), 3.0)
    m.force(base.at(0.0, 0.2, 0.1), *ca.vertsplit(base.rotation @ ca.SX([4.0, -2.0, 1.0])))
    m.torque(arm, (0.5, -1.0, 2.0))
    m.spring_damper((m.spatial_ground.at(0, 0, 1), tool.at(0.2, 0, 0)), stiffness=40.0, damping=2.0, rest=0.3)
    m.spring_damper((base.at(0, 0.4, 0), arm.at(0, 0, 0.5)), stiffness=70.0, damping=3.0, rest=0.2)
    return m


@cache
def paired(kind: str, relative: bool, leaning: bool = False) -> alfmu.Equations:
    return alfmu.derive(pair(kind, relative, leaning))


BODIES = {"base": (MASS, INERTIA, CENTERS["base"]), "arm": (MASS, INERTIA, CENTERS["arm"])}
BODIES["tool"] = 0.4, (0.02, 0.03, 0.04), CENTERS["tool"]


def quaternion(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Euler parameters and rates that keep their length."""
    e, rate = random.normal(size=(2, 4))
    e /= np.linalg.norm(e)
    return e, rate - e * (rate @ e)


def state(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and velocities of the mechanism in relative coordinates."""
    random = np.random.default_rng(seed)
    e, rate = quaternion(random)
    q, v = [*random.normal(size=3), *e], [*random.normal(size=3), *rate]
    if kind == "spherical":
        e, rate = quaternion(random)
        q, v = [*q, *e], [*v, *rate]
    else:
        count = len(UNITS[kind])
        q, v = [*q, *random.normal(size=count)], [*v, *random.normal(size=count)]
    return np.array([*q, 0.7]), np.array([*v, -1.3])


def absolute(r: dict[str, float]) -> tuple[list[float], list[float]]:
    """The same state in absolute coordinates, from what was read."""
    q, v = [], []
    for body in CENTERS:
        e = np.array([r[f"{body}.e{i}"] for i in range(4)])
        w = np.array([r[f"{body}.angular_velocity.{k}"] for k in "xyz"])
        q += [*(r[f"{body}.{k}"] for k in "xyz"), *e]
        v += [*(r[f"{body}.v{k}"] for k in "xyz"), -w @ e[1:] / 2, *((e[0] * w + np.cross(w, e[1:])) / 2)]
    return q, v


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["prismatic", "planar"])
def test_axes_are_expressions_in_parameters_as_well(kind):
    """At another value than the default, closed by constraints and by coordinates, against axes that are numbers."""
    q, v = state(kind, 1)
    leaning, plain = paired(kind, True, True), paired(kind, True)
    r, s = evaluate(leaning, q, v, [1.5, -2.0], p=[0.0]), evaluate(plain, q, v, [1.5, -2.0])
    largest = max(map(abs, s.values()))
    assert max(abs(r[name] - x) for name, x in s.items()) < 1e-12 * largest
    c = evaluate(paired(kind, False, True), *absolute(r), [1.5, -2.0], p=[0.0])
    assert max(abs(c[name] - s[name]) for name in s if ".force." in name or ".moment." in name) < 1e-8 * largest
    drawn = geometry(pair(kind, True, True), {"lean": 0.0}).space
    assert next(x for x in drawn.pivots if x.name == "J").axis == AXIS


def test_an_axis_that_moves_or_has_to_be_numbers_is_refused():
    m = alfmu.Mechanism("leaning")
    arm = m.spatial_body("arm", mass=MASS, inertia=INERTIA)
    at, lean = (m.spatial_ground.at(), arm.at()), m.parameter("lean", 0.0, "rad")
    with pytest.raises(alfmu.DeclarationError, match="the axis of J depends on time"):
        m.spatial_revolute("J", *at, axis=(m.time, 0, 1))
    with pytest.raises(alfmu.DeclarationError, match="has no direction; give three numbers, not all zero"):
        m.spatial_revolute("J", *at, axis=(lean, 0, 0))
    with pytest.raises(alfmu.DeclarationError, match="the axis of J is an expression; give a number"):
        m.universal("J", *at, axis=(1, 0, 0), second_axis=(0, 1, lean))


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "kind"), list(enumerate(UNITS)))
def test_a_tree_and_constraints_agree_and_every_body_balances(seed, kind):
    """At a random state: accelerations and reactions in relative and in absolute coordinates, and Newton and Euler."""
    q, v = state(kind, seed)
    tree, loop = paired(kind, True), paired(kind, False)
    u = [1.5, -2.0]
    r = evaluate(tree, q, v, u)
    s = evaluate(loop, *absolute(r), u)
    largest = max(abs(r[f"{joint}.{each}.{k}"]) for joint in "JK" for each in ("force",) for k in "xyz")
    for name in (x.name for x in tree.outputs if not x.name.startswith("multiplier")):
        angle = "angle" in name and "angular" not in name
        difference = r[name] - s[name]
        assert (abs(np.sin(difference)) if angle else abs(difference)) <= 1e-9 * largest, name
    pushed = {which: 3.0 - 5.0 * (x - 0.1) - 0.7 * rate for which, x, rate in freedoms(kind, q, v)}
    for found in (s, r):
        b = SpatialBalance(found, BODIES, GRAVITY)
        force, moment = efforts(kind, b, pushed)
        b.joint("J", "base", "arm", ON, force, moment)
        hinge = b.turns["arm"] @ [0, 1, 0]
        b.joint("K", "arm", "tool", (0, -0.1, 0), turn=(u[0] - 0.2 * v[-1] + found["knock.torque"]) * hinge)
        line = b.point("tool", (0, 0, 0)) - b.point("base", (0, 0, 0))
        b.push("base", "tool", b.point("tool", (0, 0, 0)), found["reach.force"] * line / np.linalg.norm(line))
        assert min(abs(found["knock.torque"]), abs(found["reach.force"])) > 0.1
        b.spring(("ground", (0, 0, 1)), ("tool", (0.2, 0, 0)), 40.0, 2.0, 0.3)
        b.spring(("base", (0, 0.4, 0)), ("arm", (0, 0, 0.5)), 70.0, 3.0, 0.2)
        b.push("ground", "arm", b.point("arm", (0.3, 0.1, 0.0)), np.array([1.0, u[1], 3.0]), (0.5, -1.0, 2.0))
        b.push("ground", "base", b.point("base", (0.0, 0.2, 0.1)), b.turns["base"] @ [4.0, -2.0, 1.0])
        assert b.lack() <= 1e-12
        # Reactions do no work along the freedoms.
        force, moment = b.vector("J.force."), b.vector("J.moment.") if kind != "spherical" else np.zeros(3)
        for w, along in directions(kind, b).values():
            assert abs(w @ moment + along @ force) <= 1e-12 * b.largest
        if kind in ("revolute", "spherical", "universal"):  # the ends stay together
            assert np.abs(b.acceleration("arm", ON) - b.acceleration("base", AT)).max() <= 1e-11 * b.largest
    # What the joint reads is its freedom.
    if kind == "prismatic":
        assert [r["arm.position"], r["arm.velocity"]] == pytest.approx([q[7], v[7]], rel=1e-12)
    if kind == "revolute":
        turn = b.vector("arm.angular_acceleration.") - b.vector("base.angular_acceleration.")
        [(axis, _)] = directions(kind, b).values()
        assert r["J.angular_velocity"] == pytest.approx(v[7], rel=1e-12)
        assert r["J.angular_acceleration"] == pytest.approx(axis @ turn, abs=1e-12 * b.largest)


def freedoms(kind: str, q: np.ndarray, v: np.ndarray) -> list[tuple[str, float, float]]:
    names = spatial.SPATIAL_FREEDOMS[kind]
    return list(zip(names, q[7:], v[7:], strict=False))


def directions(kind: str, b: SpatialBalance) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Turn and displacement of the arm from the base for a unit of each freedom."""
    base, zero = b.turns["base"], np.zeros(3)
    axis = base @ np.array(AXIS) / np.linalg.norm(AXIS)
    normal, other = (base @ np.array(x) for x in spatial.right_handed(AXIS)[:2])
    across = b.turns["arm"] @ np.array(ACROSS) / np.linalg.norm(ACROSS)
    return {
        "revolute": {"angle": (axis, zero)},
        "prismatic": {"position": (zero, axis)},
        "screw": {"angle": (axis, LEAD / (2 * np.pi) * axis)},
        "cylindrical": {"angle": (axis, zero), "position": (zero, axis)},
        "universal": {"angle1": (axis, zero), "angle2": (across, zero)},
        "planar": {"position1": (zero, normal), "position2": (zero, other), "angle": (axis, zero)},
    }.get(kind, {})


def efforts(kind: str, b: SpatialBalance, pushed: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Force and moment of drives and springs on the arm; what drives a screw is a torque."""
    force, moment = np.zeros(3), np.zeros(3)
    for which, (w, along) in directions(kind, b).items():
        moment += pushed[which] * w
        force += pushed[which] * along * (kind != "screw")
    return force, moment


@pytest.mark.parametrize("kind", UNITS)
def test_velocities_and_accelerations_are_derivatives(kind):
    """Of places and attitudes along a parabola in the coordinates, by differences of second order."""
    q, v = state(kind, 5)
    e = paired(kind, True)
    a = np.random.default_rng(6).normal(size=len(q))
    lam, u = np.zeros(e.l), np.zeros(2)
    names = [x.name for x in e.outputs]

    def read(h: float) -> dict[str, float]:
        y = e.functions["readings"](q + h * v + h * h / 2 * a, v + h * a, a, lam, u, [], 0.0)
        return dict(zip(names, np.array(y).ravel(), strict=True))

    h = 1e-4
    before, now, after = read(-h), read(0.0), read(h)
    for body in ("arm", "tool"):
        turns = [Rotation.from_quat([r[f"{body}.e{i}"] for i in (1, 2, 3, 0)]) for r in (before, after)]
        spin = (turns[1] * turns[0].inv()).as_rotvec() / (2 * h)
        for axis, w in zip("xyz", spin, strict=True):
            speed = (after[f"{body}.{axis}"] - before[f"{body}.{axis}"]) / (2 * h)
            assert now[f"{body}.v{axis}"] == pytest.approx(speed, abs=1e-5)
            for name, rate in (("v{}", "a{}"), ("angular_velocity.{}", "angular_acceleration.{}")):
                name, rate = (f"{body}.{x.format(axis)}" for x in (name, rate))
                assert now[rate] == pytest.approx((after[name] - before[name]) / (2 * h), abs=1e-4)
            if kind != "spherical":  # whose Euler parameters are of unit length to first order along a parabola
                assert now[f"{body}.angular_velocity.{axis}"] == pytest.approx(w, abs=1e-5)


def arm_of_all() -> alfmu.Mechanism:
    """One body on another by every joint whose coordinates are independent, two of them moved by one coordinate."""
    m = alfmu.Mechanism("arm_of_all")
    m.gravity(*GRAVITY)
    c = iter([m.coordinate(f"c{i}", u) for i, u in enumerate(("rad", "m", "rad", "rad", "rad", "m", "m", "rad"))])
    bodies = [m.spatial_body(f"b{i}", mass=1.0 + i, inertia=INERTIA, relative=True) for i in range(6)]
    ends = [m.spatial_ground.at(), *(body.at(0.1, 0.2, -0.1) for body in bodies)]
    on = [body.at(0.02, 0.0, 0.03) for body in bodies]
    th = next(c)
    m.spatial_revolute("A", ends[0], on[0], axis=AXIS, coordinate=th)
    m.cylindrical("B", ends[1], on[1], axis=SECOND, coordinates=(2 * th + 0.3 * ca.sin(th), next(c)))
    m.universal("C", ends[2], on[2], axis=AXIS, second_axis=ACROSS, coordinates=(next(c), next(c)))
    m.spatial_screw("D", ends[3], on[3], axis=SECOND, lead=LEAD, coordinate=next(c))
    m.planar("E", ends[4], on[4], axis=AXIS, coordinates=(next(c), next(c), next(c)))
    m.spatial_weld("F", ends[5], on[5])
    return m


def test_recursions_are_what_lagrange_gives():
    """Velocity terms and weights against derivatives of the energies, where coordinates are independent."""
    e = alfmu.derive(arm_of_all())
    q, v = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n)
    nothing = ca.SX(0, 1)
    T, V = e.kinetic_energy(q, v, nothing), e.potential_energy(q, nothing)
    momentum = ca.gradient(T, v)
    d = ca.jtimes(momentum, q, v) - ca.gradient(T, q)
    lagrange = ca.Function("lagrange", [q, v], [ca.jacobian(momentum, v), d, -ca.gradient(V, q)])
    random = np.random.default_rng(3)
    at = random.normal(size=(2, e.n))
    M, d, f = (np.array(x) for x in lagrange(*at))
    assert np.array(e.M(at[0], [])) == pytest.approx(M, rel=1e-12, abs=1e-12)
    assert np.array(e.d(*at, [])) == pytest.approx(d, rel=1e-11, abs=1e-11)
    assert np.array(e.f(*at, [], [], 0.0)) == pytest.approx(f, rel=1e-12, abs=1e-12)
    # And the kinetic energy that recursion gives is that of the velocities that are read.
    r = evaluate(e, *at)
    total = 0.0
    for i in range(6):
        turn = Rotation.from_quat([r[f"b{i}.e{k}"] for k in (1, 2, 3, 0)]).as_matrix()
        w, speed = (np.array([r[f"b{i}.{x}{k}"] for k in "xyz"]) for x in ("angular_velocity.", "v"))
        total += (1.0 + i) * speed @ speed / 2 + w @ turn @ np.array(INERTIA) @ turn.T @ w / 2
    assert total == pytest.approx(float(e.kinetic_energy(*at, [])), rel=1e-12)


# What a matrix of inertia is ------------------------------------------------------------------------------------------


def test_a_matrix_of_inertia_is_that_of_the_same_body_in_turned_axes():
    """A body thrown free: kinetic energy and accelerations by principal moments, and by the matrix with a parameter."""
    turn = Rotation.from_rotvec([0.4, -0.3, 0.8])
    moments = (0.03, 0.05, 0.07)
    matrix = turn.as_matrix() @ np.diag(moments) @ turn.as_matrix().T

    def thrown(inertia) -> alfmu.Equations:
        m = alfmu.Mechanism("thrown")
        k = m.parameter("k", 2.0, "1")
        m.spatial_body("stone", mass=MASS, inertia=ca.SX(inertia) * k / 2 if np.ndim(inertia) == 2 else inertia)
        return alfmu.derive(m)

    attitude = Rotation.from_rotvec([0.2, 0.5, -0.1])
    w = np.array([1.0, 2.0, 3.0])
    read = []
    for inertia, given in ((moments, attitude), (matrix, attitude * turn.inv())):
        *e, e0 = given.as_quat()
        rates = [-w @ e / 2, *((e0 * w + np.cross(w, e)) / 2)]
        equations = thrown(inertia)
        q, v = [0, 0, 0, e0, *e], [1.0, 0, 0, *rates]
        r = evaluate(equations, q, v)
        read.append([r[f"stone.angular_acceleration.{k}"] for k in "xyz"])
        read[-1].append(float(equations.kinetic_energy(q, v, [2.0])))
    assert read[1] == pytest.approx(read[0], rel=1e-12)
    J = attitude.as_matrix() @ np.diag(moments) @ attitude.as_matrix().T
    assert read[0][3] == pytest.approx(w @ J @ w / 2 + MASS / 2, rel=1e-12)


# Rods, locks, starts --------------------------------------------------------------------------------------------------


def test_a_rod_carries_a_body_like_a_string():
    """A spherical pendulum in a level circle: its speed, and the pull of the rod."""
    length, lean, g = 0.8, 0.5, 9.81
    m = alfmu.Mechanism("conical")
    m.gravity(0, 0, -g)
    bob = m.spatial_body("bob", mass=2.0, inertia=(0.01, 0.01, 0.01))
    m.distance("rod", m.spatial_ground.at(0, 0, 1), bob.at(), length=length)
    e = alfmu.derive(m)
    speed = np.sqrt(g * length * np.sin(lean) * np.tan(lean))
    q = [length * np.sin(lean), 0, 1 - length * np.cos(lean), 1, 0, 0, 0]
    r = evaluate(e, q, [0, speed, 0, 0, 0, 0, 0])
    assert r["rod.force"] == pytest.approx(-2.0 * g / np.cos(lean), rel=1e-12)
    assert [r["bob.ax"], r["bob.az"]] == pytest.approx([-g * np.tan(lean), 0.0], abs=1e-12)
    with pytest.raises(alfmu.DeclarationError, match="joins bodies in the plane"):
        m.distance("other", m.ground.at(), bob.at(), length=1.0)  # type: ignore[call-overload]


def crane(relative: bool) -> alfmu.Mechanism:
    """A column that slides and turns, a jib on it, started by the jib's angle, with locks on all three motions."""
    m = alfmu.Mechanism("crane")
    m.gravity(0, 0, -9.81)
    guesses = ({}, {}) if relative else ({"position": (0.0, 0, 0.5)}, {"position": (0.6, 0, 0.7)})
    column = m.spatial_body("column", mass=5.0, inertia=(0.1, 0.1, 0.05), relative=relative, **guesses[0])
    hanging = {"center": (0.5, 0, 0), "relative": relative, **guesses[1]}
    jib = m.spatial_body("jib", mass=2.0, inertia=(0.01, 0.2, 0.2), **hanging)
    c, th = None, None
    if relative:
        c = [m.coordinate(n, u, start=x, independent=True) for n, u, x in (("turn", "rad", 0.2), ("lift", "m", 0.5))]
        th = m.coordinate("tilt", "rad", start=-0.4, independent=True)
    sleeve = m.cylindrical("sleeve", m.spatial_ground.at(), column.at(), axis=(0, 0, 1), coordinates=c)
    hinge = m.spatial_revolute("hinge", column.at(0.1, 0, 0), jib.at(), axis=(0, 1, 0), coordinate=th)
    if not relative:
        for name, unit, value, free in (
            ("turn", "rad", 0.2, sleeve.freedom("angle").free),
            ("lift", "m", 0.5, sleeve.freedom("position").free),
            ("tilt", "rad", -0.4, hinge.free),
        ):
            m.tie(m.start(name, value, unit), free)
    m.lock(sleeve.freedom("position"))
    m.lock("sleeve.angle")
    m.lock(hinge)
    return m


@pytest.mark.parametrize("relative", [True, False])
def test_locks_hold_what_hangs_on_them(relative):
    """All three motions locked: each lock carries what statics says."""
    locked = dict.fromkeys(("sleeve.position.locked", "sleeve.angle.locked", "hinge.locked"), True)
    e = with_defaults(alfmu.derive(crane(relative)), locked)
    start = Probe.of(e).numbers
    r = evaluate(e, start["q"], start["v"], p=start["p"])
    assert [r["sleeve.position"], r["sleeve.angle"], r["hinge.angle"]] == pytest.approx([0.5, 0.2, -0.4])
    assert r["sleeve.position.locking_force"] == pytest.approx(7.0 * 9.81, rel=1e-9)
    assert r["hinge.locking_torque"] == pytest.approx(-2.0 * 9.81 * 0.5 * np.cos(0.4), rel=1e-9)
    assert r["sleeve.angle.locking_torque"] == pytest.approx(0.0, abs=1e-9)
    # Reactions leave the locks' efforts out: the sleeve holds the moment of the jib's weight alone.
    moment = 2.0 * 9.81 * (0.1 + 0.5 * np.cos(0.4))
    direction = np.array([np.sin(0.2), -np.cos(0.2), 0.0])
    assert [r[f"sleeve.moment.{k}"] for k in "xyz"] == pytest.approx(moment * direction, abs=1e-8)
    assert [r[f"sleeve.force.{k}"] for k in "xyz"] == pytest.approx([0, 0, 0], abs=1e-9)


def test_a_lock_on_a_hinge_with_a_coordinate_holds_and_lets_go():
    i = started(alfmu.derive(crane(True)), {"sleeve.position.locked": True, "hinge.locked": True})
    i.step(0.1)
    assert i.get("hinge.angle") == pytest.approx(-0.4, abs=1e-12)
    i.set("hinge.locked", False)
    i.step(0.1)
    assert i.get("hinge.angular_velocity") > 0.1  # about y, downwards
    assert i.get("sleeve.position") == pytest.approx(0.5, abs=1e-12)


def test_a_screw_that_constraints_close_keeps_its_thread_over_many_turns():
    """A nut that falls on a screw without friction: s'' = g/(1 + J/(m p^2)) over some turns."""
    m = alfmu.Mechanism("nut")
    m.gravity(0, 0, -9.81)
    nut = m.spatial_body("nut", mass=1.5, inertia=(2e-4, 2e-4, 3e-4))
    m.spatial_screw("thread", m.spatial_ground.at(), nut.at(), axis=(0, 0, 1), lead=0.05)
    i = by_the_oracle(alfmu.derive(m), step_size=0.002)
    for _ in range(15):
        i.step(0.02)
    pitch = 0.05 / (2 * np.pi)
    fall = 9.81 / (1 + 3e-4 / (1.5 * pitch**2)) * 0.3**2 / 2
    assert i.get("nut.z") == pytest.approx(-fall, rel=1e-5)
    assert fall > 2 * 0.05
    assert i.get("thread.angle") == pytest.approx(-fall / pitch, rel=1e-5)  # counted beyond a turn
    assert i.counters.position_error < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("absolute", [True, False])
def test_the_turns_of_a_screw_are_told_by_its_way_also_where_constraints_close_it(absolute: bool):
    """A nut ten turns up, held by a spring of turns: a linear oscillator; kinematics moves it by more than a turn."""
    m = alfmu.Mechanism("jack")
    m.gravity(0, 0, -9.81)
    where = {"position": (0, 0, 0.5)} if absolute else {"relative": True}
    nut = m.spatial_body("nut", mass=1.5, inertia=(2e-4, 2e-4, 3e-4), **where)
    pair = {"axis": (0, 0, 1), "first": m.spatial_ground.at(), "second": nut.at()}
    if not absolute:
        turn, place = m.coordinate("turn", "rad"), m.coordinate("place", "m", start=0.5, independent=True)
        m.cylindrical("sleeve", **pair, coordinates=[turn, place])
    thread = m.spatial_screw("thread", **pair, lead=0.05)
    m.spring_damper(thread, stiffness=0.1, rest=70.0, name="spring")
    pitch = 0.05 / (2 * np.pi)
    tight, names = {"solver.relative_tolerance": 1e-9}, ["thread.angle", "nut.z", "spring.torque"]
    run = alfmu.simulate(m, 1.0, 0.1, parameters=tight, outputs=names)
    middle, pace = 70.0 - 1.5 * 9.81 * pitch / 0.1, np.sqrt(0.1 / (3e-4 + 1.5 * pitch**2))
    angle = middle + (0.5 / pitch - middle) * np.cos(pace * run.time)
    assert run["thread.angle"] == pytest.approx(angle, abs=1e-6)
    assert run["nut.z"] == pytest.approx(pitch * angle, abs=1e-8)
    assert run["spring.torque"] == pytest.approx(0.1 * (angle - 70.0), abs=1e-6)
    k = alfmu.kinematics(m, ["thread"])
    for moved in (
        k.forward({"thread": 80.0}),
        *k.solutions({"thread": 80.0}),
    ):  # none half a turn off, none upside down
        assert moved["nut.z"] == pytest.approx(80.0 * pitch, abs=1e-10)


# What it costs --------------------------------------------------------------------------------------------------------


def chain(bodies: int) -> alfmu.Equations:
    """Bodies on hinges in a row, axes by turns, with full matrices of inertia."""
    m = alfmu.Mechanism("chain")
    m.gravity(0, 0, -9.81)
    before = m.spatial_ground.at()
    for i in range(bodies):
        th = m.coordinate(f"th{i}", "rad")
        body = m.spatial_body(f"b{i}", mass=1.0, inertia=INERTIA, center=(0.1, 0.02, 0.05), relative=True)
        axis = ((0, 0, 1), (0, 1, 0), (1, 0, 0))[i % 3]
        m.spatial_revolute(f"J{i}", before, body.at(), axis=axis, coordinate=th)
        before = body.at(0.1, 0.0, 0.3)
    return alfmu.derive(m)


@pytest.mark.slow
def test_expressions_of_a_chain_stay_compact():
    """Operations of all that an evaluation takes: no more than the recursion of an articulated body of six links needs
    by count, 300 n - 267 multiplications and 279 n - 259 additions (Featherstone); forces grow with the bodies."""
    six, nine, twelve = (
        {name: f.n_instructions() for name, f in chain(bodies).functions.items()} for bodies in (6, 9, 12)
    )
    assert six["dynamics"] < (300 + 279) * 6 - 267 - 259
    for name in ("d", "f"):
        assert twelve[name] - nine[name] == pytest.approx(nine[name] - six[name], rel=0.01)


# How it looks ---------------------------------------------------------------------------------------------------------


def every_joint() -> alfmu.Mechanism:
    """One body on each kind of joint, and a rod to another."""
    m = alfmu.Mechanism("every_joint")
    m.gravity(0, 0, -9.81)
    ground = m.spatial_ground
    axis = {"axis": (0, 1, 0)}
    joints = {
        "revolute": lambda *at, c: m.spatial_revolute(*at, **axis, coordinate=c[0]),
        "prismatic": lambda *at, c: m.spatial_prismatic(*at, **axis, coordinate=c[0]),
        "screw": lambda *at, c: m.spatial_screw(*at, **axis, lead=0.1, coordinate=c[0]),
        "cylindrical": lambda *at, c: m.cylindrical(*at, **axis, coordinates=c),
        "universal": lambda *at, c: m.universal(*at, **axis, second_axis=(1, 0, 0), coordinates=c),
        "planar": lambda *at, c: m.planar(*at, **axis, coordinates=c),
        "spherical": lambda *at, c: m.spherical(*at, coordinates=c),
        "weld": lambda *at, c: m.spatial_weld(*at),
    }
    for i, (kind, join) in enumerate(joints.items()):
        body = m.spatial_body(f"on_{kind}", mass=1.0, inertia=INERTIA, center=(0, 0, -0.3), relative=True)
        c = [m.coordinate(f"{kind}{k}", unit, start=0.1) for k, unit in enumerate(UNITS[kind])]
        join(kind, ground.at(0.5 * i, 0, 0), body.at(), c=c)
    bob = m.spatial_body("bob", mass=1.0, inertia=INERTIA, position=(4.0, 0.1, -0.5))
    m.distance("rod", ground.at(4, 0, 0), bob.at(), length=0.5)
    m.force(bob.at(), *(m.input(f"push.{k}", "N") for k in "xyz"))
    m.watch("tip", bob.at(0, 0, -0.2))
    return m


def test_pictures_show_every_joint():
    """Each joint has a piece where it is, and the drawing beside a result is taken back as it was."""
    m = every_joint()
    e = alfmu.derive(m)
    start = Probe.of(e).numbers
    r = evaluate(e, start["q"], start["v"], np.zeros(3))
    shapes = geometry(m)
    assert from_data(as_data(shapes)) == shapes
    view = view_of(shapes, r)
    pieces = pieces_of(shapes.space, view)
    assert {*UNITS, "rod"} <= {piece.name for piece in pieces}
    for piece in pieces:
        for place in (place_of(poses_of(shapes, r), at) for at in piece.at if piece.name in UNITS):
            assert abs(place[0] - r[f"on_{piece.name}.x"]) < 0.5
    pushes = [arrow for arrow in shapes.space.arrows if arrow.role == "applied"]
    assert [(arrow.name, arrow.kind, arrow.columns) for arrow in pushes] == [
        ("push", "force", ("push.x", "push.y", "push.z"))
    ]
    tip = next(solid for solid in shapes.space.solids if solid.name == "bob").points
    assert (0.0, 0.0, -0.2) in tip


@pytest.mark.slow
def test_an_axis_that_parameters_turn_onto_its_normal_is_told():
    """Normals follow from the axis at the defaults: here they are x and y, and the axis becomes x."""
    m = alfmu.Mechanism("tilted")
    tilt, arm = m.parameter("tilt", 0.0), m.spatial_body("arm", mass=MASS, inertia=INERTIA)
    m.spatial_revolute("J", m.spatial_ground.at(), arm.at(), axis=(tilt, 0, 1 - tilt))
    with pytest.raises(alfmu.AssemblyError, match="tilted: at the start guess the gap of J is not finite"):
        initialized(alfmu.Instance(m), {"solver.method": "rk4", "tilt": 1.0})
