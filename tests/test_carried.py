"""Bodies in relative coordinates on places that laws of time, inputs and coordinates move: against the same bodies in
absolute coordinates, Newton's and Euler's laws, the kinetic energy, and a closed equation of motion."""

import casadi as ca
import fmpy
import numpy as np
import pytest
from oracles.free_body import SpatialBalance
from scenes import evaluate
from scipy.integrate import solve_ivp
from test_motion import by_rk4
from test_spatial_joints import absolute

import alfmu
from alfmu.view.live import live

G = 9.81
INERTIA = ((0.04, -0.006, 0.004), (-0.006, 0.05, 0.003), (0.004, 0.003, 0.06))
CENTERS = {"base": (0.1, 0.0, -0.1), "arm": (0.05, -0.02, 0.03), "tool": (0.0, 0.04, 0.1)}
BODIES = {name: (1.3, INERTIA, center) for name, center in CENTERS.items()}
GRAVITY = (0.5, -0.3, -9.81)


def shaken(relative: bool) -> alfmu.Mechanism:
    """A base that turns by a law about a pivot that moves on both bodies, an arm on a hinge whose points move on both,
    a tool that slides by a coordinate on the arm and turns by a law, and a spring and a drive between them."""
    m = alfmu.Mechanism("shaken")
    m.gravity(*GRAVITY)
    base, arm, tool = (
        m.spatial_body(name, mass=1.3, inertia=INERTIA, center=center, relative=relative)
        for name, center in CENTERS.items()
    )
    t, sin, cos = m.time, ca.sin, ca.cos
    law, twist = 0.6 * sin(2 * t) + 0.2, 0.5 * t**2
    c, s = (m.coordinate("c", "rad"), m.coordinate("s", "m")) if relative else (None, None)
    at = m.spatial_ground.at(0.3 * cos(3 * t), 0.1 * t, t**2), base.at(0.05 * sin(4 * t), 0.1, 0.02 * t)
    H = m.spatial_revolute(
        "H", *at, axis=(1, 2, -0.5), second_axis=(0.3, -1, 0.4), coordinate=law if relative else None
    )
    at = base.at(0.2, 0.1 * cos(2 * t), 0), arm.at(-0.2 + 0.1 * sin(t), 0, 0.05)
    J = m.spatial_revolute("J", *at, axis=(0, 1, 0.3), coordinate=c)
    at = arm.at(0.3, 0.05 * t, 0), tool.at(0, 0, 0.1)
    K = m.cylindrical("K", *at, axis=(1, 0, 0.2), coordinates=(twist, s) if relative else None)
    if not relative:
        m.motion(H, law)
        m.motion(K.freedom("angle"), twist)
    m.drive(H, 2.0)
    m.friction(J, 0.3)
    m.spring_damper(K.freedom("position"), stiffness=20.0, damping=0.5, rest=0.1)
    m.spring_damper((m.spatial_ground.at(0, 0, 1), tool.at(0.2, 0.1 * t, 0)), stiffness=40.0, damping=2.0, rest=0.3)
    return m


def test_a_tree_that_is_shaken_moves_as_its_bodies_do_under_constraints():
    """At a state and a time: everything that can be read in both kinds of coordinates, torques of laws among it, and
    Newton's and Euler's laws."""
    time, v = 0.7, [-1.3, 0.8, 1.0]
    tree, loop = (alfmu.derive(shaken(relative)) for relative in (True, False))
    r = evaluate(tree, [0.4, 0.15, time], v, p=[0.0])
    q_loop, v_loop = absolute(r)
    s = evaluate(loop, [*q_loop, time], [*v_loop, 1.0], p=[0.0])
    largest = max(abs(r[f"{joint}.force.{k}"]) for joint in "HJK" for k in "xyz")
    names = {x.name for x in tree.outputs if not x.name.startswith("multiplier")}
    assert {"H.torque", "K.angle.torque", "K.position"} <= names
    for name in names:
        angle = name.endswith(".angle")
        difference = r[name] - s[name]
        assert (abs(np.sin(difference)) if angle else abs(difference)) <= 1e-9 * largest, name
    b = SpatialBalance(r, BODIES, GRAVITY)

    def axis(body: str, x: tuple) -> np.ndarray:
        return (b.turns[body] if body in b.turns else np.eye(3)) @ (np.array(x) / np.linalg.norm(x))

    turn = (r["H.torque"] + 2.0) * axis("ground", (1, 2, -0.5))
    b.joint("H", "ground", "base", (0.05 * np.sin(4 * time), 0.1, 0.02 * time), turn=turn)
    b.joint("J", "base", "arm", (-0.2 + 0.1 * np.sin(time), 0, 0.05), turn=-0.3 * v[0] * axis("arm", (0, 1, 0.3)))
    along = axis("arm", (1, 0, 0.2))
    push = -20.0 * (0.15 - 0.1) - 0.5 * v[1]
    b.joint("K", "arm", "tool", (0, 0, 0.1), effort=push * along, turn=r["K.angle.torque"] * along)
    line = b.point("tool", (0.2, 0.1 * time, 0)) - [0, 0, 1]
    length = np.linalg.norm(line)
    speed = b.velocity("tool", (0.2, 0.1 * time, 0)) + b.turns["tool"] @ [0, 0.1, 0]
    end = b.point("tool", (0.2, 0.1 * time, 0))
    b.push("ground", "tool", end, -(40.0 * (length - 0.3) + 2.0 * line @ speed / length) * line / length)
    assert b.lack() <= 1e-12


def test_a_point_that_a_coordinate_moves_is_refused():
    m = alfmu.Mechanism("geared")
    arm = m.spatial_body("arm", mass=1.3, inertia=INERTIA, relative=True)
    b = m.coordinate("b", "rad")
    m.spatial_revolute("H", m.spatial_ground.at(), arm.at(0.1 * b, 0, 0), axis=(1, 2, -0.5), coordinate=b)
    with pytest.raises(alfmu.DeclarationError, match=r"a point of arm .* at which H places arm depends on coordinates"):
        alfmu.derive(m)


def place(t):
    return 0.1 * (1 - np.cos(3 * t))


PLACE = {
    "place": place,
    "place_rate": lambda t: 0.3 * np.sin(3 * t),
    "place_acceleration": lambda t: 0.9 * np.cos(3 * t),
}


def lift(t):
    """How a base goes up and down [m]."""
    return 0.05 * (ca if isinstance(t, ca.SX) else np).cos(30 * t)


def pendulum(kind: str) -> alfmu.Mechanism:
    """A bar of 1 kg and 1 m on a base that a signal moves along and a law moves up and down."""
    m = alfmu.Mechanism(f"pendulum_{kind}")
    at, up = m.input("place", "m", derivatives=2), lift(m.time)
    if kind == "plane":
        angle = m.coordinate("angle", "rad", start=1.2, independent=True)
        bar = m.bar("bar", mass=1.0, length=1.0)
        m.revolute("A", m.ground.at(at, up), bar.start, coordinate=angle)
        m.gravity(0, -G)
        return m
    m.gravity(0, 0, -G)
    turned = (
        {} if kind == "relative" else {"position": (0.18, 0.0, 0.52), "attitude": (np.cos(0.6), 0, -np.sin(0.6), 0)}
    )
    inertia = (1e-3, 1 / 12, 1 / 12)
    bar = m.spatial_body("bar", mass=1.0, inertia=inertia, relative=kind == "relative", **turned)
    angle = m.coordinate("angle", "rad", start=1.2, independent=True) if kind == "relative" else None
    A = m.spatial_revolute("A", m.spatial_ground.at(at, 0, up), bar.at(-0.5, 0, 0), axis=(0, -1, 0), coordinate=angle)
    if angle is None:
        m.tie(m.start("angle", 1.2, "rad"), A.free)
    return m


def test_a_pendulum_on_a_vibrating_base_moves_as_its_equation_says():
    """In the plane and in both kinds of coordinates in space, with the force of its hinge and the work of the base.

    The signal is known to the third power of a communication step where it begins.
    """
    step, found = 0.005, {}
    for kind in ("plane", "relative", "absolute"):
        run = alfmu.simulate(by_rk4(pendulum(kind)), 0.4, step, inputs=PLACE, parameters={"solver.step_size": 0.001})
        angle, force = ("bar.angle", "A.force.y") if kind == "plane" else ("A.angle", "A.force.z")
        found[kind] = run[angle], run[force], run["bar.y" if kind == "plane" else "bar.z"]
        assert np.ptp(run["monitor.energy"] - run["monitor.work"]) < 1e-6
    for kind, limit in (("plane", 1e-10), ("absolute", 1e-8)):  # The latter by its own error of integration.
        for a, b in zip(found[kind], found["relative"], strict=True):
            assert np.abs(a - b).max() < limit

    def turning(t, th):
        return 1.5 * (0.9 * np.cos(3 * t) * np.sin(th) - (G - 45 * np.cos(30 * t)) * np.cos(th))

    t = np.linspace(0, 0.4, 81)
    exact = solve_ivp(
        lambda t, y: [y[1], turning(t, y[0])], (0, 0.4), (1.2, 0.0), method="DOP853", rtol=1e-12, atol=1e-12, t_eval=t
    )
    th, rate = exact.y
    angle, force, _ = found["relative"]
    assert np.abs(angle - th).max() < 1e-8
    exact_force = G - 45 * np.cos(30 * t) + (turning(t, th) * np.cos(th) - rate**2 * np.sin(th)) / 2
    assert np.abs(force - exact_force).max() < 1e-4


@pytest.mark.parametrize("kind", ["native", "python"])
def test_an_fmu_carries_such_a_tree(kind, tmp_path):
    """In fmpy, with a base that a law moves and an input that stands still."""
    given = {"place": 0.2, "solver.method": "rk4", "solver.step_size": 0.002}
    path = alfmu.export(pendulum("relative"), tmp_path, kind=kind, parameters=given, reference=False)
    names = ["A.angle", "A.force.z", "bar.x"]
    found = fmpy.simulate_fmu(str(path), stop_time=0.1, output_interval=0.01, output=names)
    run = alfmu.simulate(pendulum("relative"), 0.1, 0.01, parameters=given)
    for name in names:
        assert found[name] == pytest.approx(run[name], rel=1e-11), name


def test_a_live_page_shows_a_hinge_whose_point_a_law_moves(tmp_path):
    m, path = pendulum("relative"), tmp_path / "page.html"
    live(m, by_rk4(m), path)
    assert '{"name":"A","kind":"cylinder","at":[{"frame":"bar"' in path.read_text()
