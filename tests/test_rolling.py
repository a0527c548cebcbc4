"""Blades, balls and discs: constraints of velocities, against closed forms, another integration, and in balance."""

import math

import numpy as np
import pytest
from oracles import ode
from scenes import readings, started
from scipy.spatial.transform import Rotation

import alfmu

G = 9.81
MASS, INERTIA, ARM = 2.0, 0.4, 0.3


def sleigh(trailer: bool = False) -> alfmu.Mechanism:
    """Chaplygin's sleigh: its blade is ARM behind its centre of mass; it may pull a trailer on a blade of its own."""
    m = alfmu.Mechanism("sleigh", experiment=alfmu.Experiment(4.0, 0.02))
    turn = m.coordinate("turn", start=0.2, rate=1.0, independent=True)
    c, s = math.cos(0.2), math.sin(0.2)
    rates = 2.0 * c - ARM * s, 2.0 * s + ARM * c
    x, y = (m.coordinate(k, "m", rate=rate, independent=True) for k, rate in zip("xy", rates, strict=True))
    body = m.body("body", mass=MASS, inertia=INERTIA, pose=(x, y, turn))
    m.blade("blade", body.at(-ARM, 0.0))
    if trailer:
        box = m.body("box", mass=1.5, inertia=0.2, center=(-0.6, 0.05))
        m.revolute("hitch", body.at(-0.5, 0.0), box.at(0, 0), coordinate=m.coordinate("bend", start=0.4))
        m.blade("wheels", box.at(-0.8, 0.0), axis=0.1)
        m.torque(body, m.input("steer", "N.m", start=0.7))
        m.force(body.at(0.1, 0.0), y=3.0)
    return m


def known(times: np.ndarray) -> np.ndarray:
    """Speed along the blade, rate of turning and angle, by the equations of Chaplygin."""
    turned = MASS * ARM / (INERTIA + MASS * ARM**2)
    start = 2.0, 1.0, 0.2
    return ode.solved(lambda t, s: [ARM * s[1] ** 2, -turned * s[1] * s[0], s[1]], start, times)


@pytest.mark.parametrize("method", ["explicit", "stiff"])
def test_the_sleigh_goes_as_chaplygin_says(method: str):
    given = {"solver.method": method, "solver.relative_tolerance": 1e-10}
    r = alfmu.simulate(sleigh(), 4.0, 0.1, parameters=given)
    exact = known(r.time)
    assert r["body.angle"] == pytest.approx(exact[:, 2], abs=1e-9)
    along = r["body.vx"] * np.cos(r["body.angle"]) + r["body.vy"] * np.sin(r["body.angle"])
    assert along == pytest.approx(exact[:, 0], abs=1e-9)
    assert np.ptp(r["monitor.energy"]) < 1e-9
    # The blade alone acts: mass times acceleration, all of it across.
    ax, ay, angle = r["body.ax"], r["body.ay"], r["body.angle"]
    assert MASS * (ay * np.cos(angle) - ax * np.sin(angle)) == pytest.approx(r["blade.force"], abs=1e-10)
    assert ax * np.cos(angle) + ay * np.sin(angle) == pytest.approx(0.0, abs=1e-10)
    assert r["monitor.velocity_error"].max() < 1e-12


def test_the_readable_method_makes_the_same_steps():
    runs = [
        alfmu.simulate(sleigh(), 0.5, 0.1, parameters={"solver.method": "rk4"}, kernel=kernel)
        for kernel in ("vm", "oracle")
    ]
    assert runs[1].names == runs[0].names
    for name in ("body.angle", "body.x", "body.vy", "blade.force"):
        assert runs[1][name] == pytest.approx(runs[0][name], abs=1e-13)


def test_the_place_of_a_sleigh_is_free_and_its_speed_is_not():
    """Any place is a start, also one beside the blade; rates that do not fit are refused, as is what keeps no rates."""
    equations = alfmu.derive(sleigh())
    with pytest.raises(alfmu.AssemblyError, match="no motion has the given start rates; blade is violated"):
        started(equations, {"start.turn_rate": 0.0})
    y = readings(started(equations, {"start.x": 3.0, "start.y": -5.0}))
    assert (y["body.x"], y["body.y"], y["body.angle"]) == pytest.approx((3.0, -5.0, 0.2))
    with pytest.raises(alfmu.InputError, match="does not support constraints of velocities"):
        alfmu.simulate(sleigh(), 0.1, parameters={"solver.formulation": "stiffness"})


def test_a_hitch_feels_the_blade_behind_it():
    """A trailer in joint coordinates: forces and moments of both bodies by Newton and Euler."""
    m = sleigh(trailer=True)
    y = readings(started(alfmu.derive(m)))
    hitch = np.array([y["hitch.force.x"], y["hitch.force.y"]])
    turns = {name: y[f"{name}.angle"] for name in ("body", "box")}

    def across(name: str, lean: float = 0.0) -> np.ndarray:
        return np.array([-math.sin(turns[name] + lean), math.cos(turns[name] + lean)])

    def arm(name: str, dx: float, dy: float) -> np.ndarray:
        c, s = math.cos(turns[name]), math.sin(turns[name])
        return np.array([c * dx - s * dy, s * dx + c * dy])

    def moment(r: np.ndarray, f: np.ndarray) -> float:
        return r[0] * f[1] - r[1] * f[0]

    blade, wheels = y["blade.force"] * across("body"), y["wheels.force"] * across("box", 0.1)
    push = np.array([0.0, 3.0])
    assert MASS * np.array([y["body.ax"], y["body.ay"]]) == pytest.approx(blade - hitch + push, abs=1e-11)
    assert 1.5 * np.array([y["box.ax"], y["box.ay"]]) == pytest.approx(hitch + wheels, abs=1e-11)
    on_body = (
        moment(arm("body", -ARM, 0), blade) - moment(arm("body", -0.5, 0), hitch) + moment(arm("body", 0.1, 0), push)
    )
    assert INERTIA * y["body.angular_acceleration"] == pytest.approx(on_body + 0.7, abs=1e-11)
    on_box = moment(arm("box", 0.6, -0.05), hitch) + moment(arm("box", -0.2, -0.05), wheels)
    assert 0.2 * y["box.angular_acceleration"] == pytest.approx(on_box, abs=1e-11)
    v = np.array([y["box.vx"], y["box.vy"]]) + y["box.angular_velocity"] * arm("box", 0.05, -0.2)
    assert v @ across("box", 0.1) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.slow
def test_a_ball_rolls_down_a_slope_with_five_sevenths():
    m = alfmu.Mechanism("ball", experiment=alfmu.Experiment(0.5, 0.01))
    r, tilt = 0.2, 0.3
    normal = (-math.sin(tilt), 0.0, math.cos(tilt))
    ball = m.spatial_body("ball", mass=3.0, inertia=(0.4 * 3.0 * r**2,) * 3, position=[r * x for x in normal])
    m.spatial_rolling("contact", m.spatial_ground.at(0, 0, 0), ball.at(0, 0, 0), radius=r, normal=normal)
    m.gravity(0, 0, -G)
    y = alfmu.simulate(m, 0.3, 0.1, parameters={"solver.method": "explicit", "solver.relative_tolerance": 1e-9})
    down = np.array([-math.cos(tilt), 0.0, -math.sin(tilt)])
    speed = np.array([y["ball.vx"], y["ball.vy"], y["ball.vz"]]).T @ down
    assert speed == pytest.approx(5 / 7 * G * math.sin(tilt) * y.time, abs=1e-9)
    assert y["ball.angular_velocity.y"] == pytest.approx(-speed / r, abs=1e-8)
    force = np.array([y[f"contact.force.{k}"][-1] for k in "xyz"])
    assert force @ down == pytest.approx(-2 / 7 * 3.0 * G * math.sin(tilt), rel=1e-9)
    assert force @ normal == pytest.approx(3.0 * G * math.cos(tilt), rel=1e-9)


@pytest.mark.slow
def test_a_coin_rolls_by_newton_and_euler():
    """A thin disc that leans and turns: at all times it does not slip, keeps its energy, and is in balance."""
    m = alfmu.Mechanism("coin", experiment=alfmu.Experiment(0.8, 0.01))
    r, mass = 0.1, 0.5
    inertia = (mass * r**2 / 4, mass * r**2 / 2, mass * r**2 / 4)
    lean = 0.35
    height = r * math.cos(lean)
    e = [math.cos(lean / 2), math.sin(lean / 2), 0.0, 0.0]
    coin = m.spatial_body("coin", mass=mass, inertia=inertia, position=(0.0, 0.0, height), attitude=e)
    # Rolling about its axis with 14 rad/s, which is turned by the lean about x.
    names = [f"coin_{k}" for k in ("x", "y", "z", "e0", "e1", "e2", "e3")]
    turn = Rotation.from_quat([*e[1:], e[0]])
    spin = turn.apply([0.0, 14.0, 0.0])
    arm = turn.apply([0.0, 0.0, -r])
    speed = -np.cross(spin, arm)
    rates = dict(zip(names, [*speed, -spin @ e[1:] / 2, *(e[0] * spin + np.cross(spin, e[1:])) / 2], strict=True))
    for k, coordinate in enumerate(m.coordinates):
        value = [0.0, 0.0, height, *e][k]
        m.tie(m.start(coordinate.name, value, coordinate.unit, rate=rates[coordinate.name]), coordinate.q)
    m.spatial_rolling("edge", m.spatial_ground.at(0, 0, 0), coin.at(0, 0, 0), radius=r, axis=(0, 1, 0))
    m.gravity(0, 0, -G)
    y = alfmu.simulate(m, 0.8, 0.05, parameters={"solver.method": "explicit", "solver.relative_tolerance": 1e-9})
    assert np.ptp(y["monitor.energy"]) < 1e-7
    assert np.ptp(y["coin.vx"]) > 0.1
    for k in range(len(y.time)):
        at = {name: y[name][k] for name in y.names}
        R = Rotation.from_quat([at[f"coin.e{i}"] for i in (1, 2, 3, 0)]).as_matrix()
        w, alpha = (np.array([at[f"coin.angular_{what}.{i}"] for i in "xyz"]) for what in ("velocity", "acceleration"))
        axis = R[:, 1]
        down = -np.array([0, 0, 1.0]) + axis[2] * axis
        arm = r * down / np.linalg.norm(down)
        v = np.array([at["coin.vx"], at["coin.vy"], at["coin.vz"]])
        assert v + np.cross(w, arm) == pytest.approx(np.zeros(3), abs=1e-9)
        assert at["coin.z"] == pytest.approx(-arm[2], abs=1e-11)
        force = np.array([at[f"edge.force.{i}"] for i in "xyz"])
        a = np.array([at["coin.ax"], at["coin.ay"], at["coin.az"]])
        assert mass * a == pytest.approx(force - [0, 0, mass * G], abs=1e-8)
        J = R @ np.diag(inertia) @ R.T
        assert J @ alpha + np.cross(w, J @ w) == pytest.approx(np.cross(arm, force), abs=1e-8)


def test_hinges_of_an_edge_mill_carry_what_the_wheel_rolls_on():
    """A wheel on an arm that turns presses on the ground by its gyroscopic moment, too; its hinges balance both (Newton
    and Euler)."""
    m = alfmu.Mechanism("edge_mill")
    r, length, mass, arm_mass, W = 0.3, 0.8, 5.0, 1.0, 4.0
    spin, across = mass * r**2 / 2, mass * r**2 / 4
    turn = m.coordinate("turn", "rad", start=0.2, rate=W, independent=True)
    roll = m.coordinate("roll", "rad")
    arm = m.spatial_body("arm", mass=arm_mass, inertia=(0.0, 0.05, 0.05), center=(length / 2, 0, 0), relative=True)
    wheel = m.spatial_body("wheel", mass=mass, inertia=(spin, across, across), relative=True)
    ground = m.spatial_ground
    m.spatial_revolute("shaft", ground.at(0, 0, r), arm.at(), axis=(0, 0, 1), coordinate=turn)
    m.spatial_revolute("axle", arm.at(length, 0, 0), wheel.at(), axis=(1, 0, 0), coordinate=roll)
    m.spatial_rolling("tread", ground.at(), wheel.at(), radius=r, axis=(1, 0, 0))
    m.gravity(0, 0, -G)
    y = alfmu.simulate(m, 1.0, 0.1, parameters={"solver.method": "explicit", "solver.relative_tolerance": 1e-10})
    assert y["shaft.angle"] == pytest.approx(0.2 + W * y.time, abs=1e-8)
    assert abs(y["axle.angle"]) == pytest.approx(length / r * W * y.time, abs=1e-7)
    for k in range(len(y.time)):
        force, hinge, axle = (
            np.array([y[f"{name}.force.{i}"][k] for i in "xyz"]) for name in ("tread", "shaft", "axle")
        )
        out = np.array([math.cos(y["shaft.angle"][k]), math.sin(y["shaft.angle"][k]), 0.0])
        weight = np.array([0, 0, -G])
        assert axle + force + mass * weight == pytest.approx(-mass * W**2 * length * out, abs=1e-6)
        assert hinge - axle + arm_mass * weight == pytest.approx(-arm_mass * W**2 * length / 2 * out, abs=1e-6)
        moment = np.array([y[f"axle.moment.{i}"][k] for i in "xyz"])
        # The spin along the arm turns with W: its moment is about the horizontal across the arm.
        roll_rate = -length / r * W
        change = spin * roll_rate * np.cross([0, 0, W], out)
        assert moment + np.cross([0, 0, -r], force) == pytest.approx(change, abs=1e-6)


def test_rolling_that_cannot_be_is_refused():
    m = alfmu.Mechanism("m")
    ball = m.spatial_body("ball", mass=1.0, inertia=(1.0, 1.0, 1.0))
    with pytest.raises(alfmu.DeclarationError, match="give a marker of spatial_ground first"):
        m.spatial_rolling("contact", ball.at(0, 0, 0), m.spatial_ground.at(0, 0, 0), radius=0.1)
    with pytest.raises(alfmu.DeclarationError, match="has no direction"):
        m.spatial_rolling("contact", m.spatial_ground.at(0, 0, 0), ball.at(0, 0, 0), radius=0.1, normal=(0, 0, 0))
    with pytest.raises(alfmu.DeclarationError, match="joins bodies in the plane"):
        m.blade("blade", ball.at(0, 0, 0))
    with pytest.raises(alfmu.DeclarationError, match="blade blade is on the ground, which cannot move"):
        m.blade("blade", m.ground.at(0, 0))
