"""Dry friction beside prescribed motions and places that depend on time: closed forms, Newton and Euler, jams, FMUs."""

import math
from functools import cache

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from oracles.rubbing import Crank
from scipy.integrate import solve_ivp
from test_friction import EDGES, L1, L2, MASSES, MU, RADII, crank

import alfmu
from alfmu import Mechanism
from alfmu.model.errors import AlfmuError

G = 9.81


def test_the_torque_of_a_crank_at_constant_speed_carries_all_friction():
    """Friction of the crank's own hinge, of both pins and of the guide, by Newton and Euler."""
    speed, begin = 9.0, 0.7
    m = crank(0.0)
    m.motion("A", begin + speed * m.time)
    run = alfmu.simulate(m, 0.7, 0.05, parameters={"solver.method": "rk4", "start.speed": speed})
    reference = Crank(L1, L2, *MASSES, MU, RADII, EDGES, lambda t: 0.0)
    torque = [reference.driving(begin + speed * t, speed) for t in run.time]
    assert np.ptp(torque) > 30.0
    np.testing.assert_allclose(run["A.torque"], torque, atol=1e-11)
    assert {1.0, -1.0} == set(run["guide.slip"])
    assert run["monitor.step_error"].max() < 1e-4


# A block on a belt ---------------------------------------------------------------------------------------------------

STIFFNESS, SPEED, COULOMB, STATIC = 200.0, 0.1, 0.3, 0.6


@cache
def belt(moved: str) -> Mechanism:
    """A block of 1 kg that a spring holds back on a belt."""
    m = Mechanism("belt", "A block on a belt that a law moves")
    band, block = m.body("belt", mass=5.0), m.body("block", mass=1.0)
    if moved == "input":
        drive = m.prismatic("drive", m.ground.at(0, 0), band.at(0, 0), coordinate=m.coordinate("b", "m", start=0.0))
        m.motion(drive, m.input("belt.place", "m", derivatives=1))
    else:
        m.prismatic("drive", m.ground.at(0, 0), band.at(0, 0), coordinate=SPEED * m.time)
    guide = m.prismatic("guide", band.at(0, 0), block.at(0, 0), coordinate=m.coordinate("s", "m", start=0.0))
    m.friction(guide, coulomb=COULOMB, static=STATIC)
    m.spring_damper((m.ground.at(-1, 0), block.at(0, 0)), stiffness=STIFFNESS, rest=1.0)
    m.gravity(0, -G)
    return m


def on_a_belt(times: np.ndarray) -> np.ndarray:
    """Places of the block: it goes with the belt, and slips back in each period."""
    w, D = math.sqrt(STIFFNESS), (STATIC - COULOMB) * G / STIFFNESS

    def slipped(t: float) -> float:
        return SPEED * t + D - D * math.cos(w * t) - SPEED / w * math.sin(w * t)

    stop = 2 * (math.pi - math.atan(D * w / SPEED)) / w
    first, period = STATIC * G / STIFFNESS / SPEED, slipped(stop) / SPEED
    whole, rest = np.divmod(np.maximum(times - first, 0.0), period)
    assert whole[-1] > 3
    return SPEED * times - whole * slipped(stop) - [slipped(min(t, stop)) for t in rest]


def test_a_block_on_a_moving_belt_sticks_and_slips():
    parameters = {"solver.method": "rk4", "solver.step_size": 0.004}
    run = alfmu.simulate(belt("law"), 3.0, 0.05, parameters=parameters)
    np.testing.assert_allclose(run["block.x"], on_a_belt(run.time), atol=5e-8)
    sticks = run["guide.slip"] == 0
    assert sticks.sum() > 10
    np.testing.assert_allclose(run["block.vx"][sticks], SPEED, rtol=1e-14)
    # The belt is driven against friction.
    np.testing.assert_allclose(run["drive.driving_force"], run["guide.friction_force"], atol=1e-12)
    assert run["monitor.step_error"].max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["python", "native"])
def test_a_belt_that_an_input_moves_rubs_in_an_fmu(tmp_path, kind):
    path = alfmu.export(belt("input"), tmp_path / "belt.fmu", kind=kind, parameters={"solver.relative_tolerance": 1e-8})
    assert validate_fmu(str(path)) == []
    times = np.arange(0.0, 3.005, 0.01)
    names = [("time", "f8"), ("belt.place", "f8"), ("belt.place_rate", "f8")]
    signals = np.array([(t, SPEED * t, SPEED) for t in times], names)
    outputs = ["block.x", "guide.slip", "guide.friction_force", "drive.driving_force"]
    found = fmpy.simulate_fmu(str(path), stop_time=3.0, output_interval=0.01, input=signals, output=outputs)
    np.testing.assert_allclose(found["block.x"], on_a_belt(found["time"]), atol=5e-9)
    assert set(found["guide.slip"]) == {0.0, -1.0}
    np.testing.assert_allclose(found["drive.driving_force"], found["guide.friction_force"], atol=1e-9)


# An arm that turns ---------------------------------------------------------------------------------------------------


def test_a_block_on_an_arm_that_turns_faster_lets_go():
    """Across the arm it carries m r a at rest, and slides when (a t)^2 = mu a; the arm rubs in its hinge, too."""
    faster, mu, reach, inertia, mass = 2.0, 0.5, 0.4, 0.1, 2.0
    m = Mechanism("arm", "A block on an arm that a law turns")
    arm = m.body("arm", mass=1.0, inertia=inertia)
    block = m.body("block", mass=mass)
    A = m.revolute("A", m.ground.at(0, 0), arm.at(0, 0), coordinate=faster * m.time**2 / 2)
    guide = m.prismatic("guide", arm.at(0, 0), block.at(0, 0), coordinate=m.coordinate("s", "m", start=reach))
    m.friction(guide, coulomb=mu)
    m.friction(A, coulomb=0.1, radius=0.1)
    run = alfmu.simulate(m, 1.0, 0.01, parameters={"solver.method": "rk4"})
    free = math.sqrt(mu / faster)

    def motion(t: float, y: np.ndarray) -> list[float]:
        w = faster * t
        return [y[1], w**2 * y[0] - mu * (2 * w * y[1] + faster * y[0])]

    exact = solve_ivp(motion, (free, 1.0), [reach, 0.0], "DOP853", dense_output=True, rtol=1e-12, atol=1e-14).sol
    r, rate = np.array([exact(t) if t > free else (reach, 0.0) for t in run.time]).T
    np.testing.assert_allclose(run["block.position"], r, atol=1e-9)
    assert np.abs(run["block.velocity"][run.time < free]).max() < 1e-15
    rubs = 0.01 * np.hypot(run["A.force.x"], run["A.force.y"])
    w = faster * run.time
    torque = (inertia + mass * r**2) * faster + 2 * mass * r * rate * w + rubs
    np.testing.assert_allclose(run["A.torque"][1:], torque[1:], rtol=1e-7)
    np.testing.assert_allclose(run["A.friction_torque"], -rubs, rtol=1e-12)
    assert run["monitor.step_error"].max() < 1e-8


def dwell() -> Mechanism:
    """A bar rests, is turned by a law that begins and ends with no acceleration, and rests again."""
    m = Mechanism("dwell", "A bar that a law turns between two rests")
    bar = m.bar("bar", mass=1.0, length=1.0)
    A = m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=m.coordinate("th", "rad", start=0.0))
    m.friction(A, coulomb=0.3, radius=0.05)
    m.gravity(0, -G)
    x = ca.fmin(ca.fmax(m.time - 0.5, 0.0), 1.0)
    m.motion(A, x**3 * (10 - 15 * x + 6 * x**2))
    return m


def torque_of_dwell(run: alfmu.Result) -> np.ndarray:
    """What that takes; that it stops is seen after the row of 1.5 s."""
    load = np.hypot(run["A.force.x"], run["A.force.y"])
    moves = (run.time > 0.5 + 1e-9) & (run.time < 1.5 + 1e-9)
    weight = G / 2 * np.cos(run["bar.angle"]) + run["bar.angular_acceleration"] / 3
    return weight + 0.3 * 0.05 * load * moves


def test_a_hinge_that_a_motion_holds_at_rest_takes_no_friction():
    run = alfmu.simulate(dwell(), 2.0, 0.05, parameters={"solver.method": "rk4"})
    assert set(run["A.slip"]) == {0.0, 1.0}
    np.testing.assert_allclose(run["A.torque"], torque_of_dwell(run), atol=1e-12)
    load = np.hypot(run["A.force.x"], run["A.force.y"])
    np.testing.assert_allclose(run["A.friction_torque"], -0.3 * 0.05 * load * run["A.slip"], rtol=1e-13)
    assert run["monitor.step_error"].max() < 1e-4


# Jams ----------------------------------------------------------------------------------------------------------------

CRANK, ROD, PUSHED, RUBS = 0.3, 0.4, 50.0, 1.2


def pressing() -> Mechanism:
    """A crank at speed t + growth t^3 pushes a ram by a rod without mass; it jams where the rod leans by atan(1/mu)."""
    m = Mechanism("press", "A ram in a guide that rubs")
    begin = m.parameter("begin", 3.4, "rad")
    speed, growth = m.parameter("speed", 0.0, "rad/s"), m.parameter("growth", 0.0, "1")
    lean = ca.asin(-CRANK / ROD * ca.sin(begin))
    first = m.bar("crank", mass=1.0, length=CRANK)
    rod = m.bar("rod", mass=0.0, length=ROD)
    ram = m.body("ram", mass=3.0)
    A = m.revolute("A", m.ground.at(0, 0), first.start, coordinate=m.coordinate("th", "rad", start=begin))
    m.revolute("B", first.end, rod.start, coordinate=m.coordinate("phi", "rad", start=lean - begin))
    reach = CRANK * ca.cos(begin) + ROD * ca.cos(lean)
    guide = m.prismatic("guide", m.ground.at(0, 0), ram.at(0, 0), coordinate=m.coordinate("s", "m", start=reach))
    m.revolute("C", rod.end, ram.at(0, 0))
    m.drive(guide, -PUSHED)
    m.friction(guide, coulomb=RUBS)
    m.motion(A, begin + speed * m.time + growth * m.time**3)
    return m


@pytest.fixture(scope="module")
def press() -> alfmu.Equations:
    return alfmu.derive(pressing())


JAM = math.pi + math.asin(ROD * math.sin(math.atan(1 / RUBS)) / CRANK)
"""Angle of the crank [rad] up to which the ram can be pushed."""


def test_a_motion_that_jams_is_reported_where_it_jams(press):
    speed, step = 2.0, 0.01
    jam = (JAM - 3.4) / speed
    parameters = {"solver.method": "rk4", "speed": speed}
    run = alfmu.simulate(press, step * (jam // step), step, parameters=parameters)
    angle, a = run["crank.angle"], run["ram.acceleration"]
    lean = np.arcsin(-CRANK / ROD * np.sin(angle))
    pushes = (3.0 * a + PUSHED) / (1 - RUBS * np.abs(np.tan(lean)))  # along the guide
    np.testing.assert_allclose(np.abs(run["guide.friction_force"]), RUBS * pushes * np.tan(lean), rtol=1e-9)
    assert pushes[-1] > 20 * PUSHED
    said = r"press, t = 0\.\d+ s: joints jam: no sliding motion .* \(guide\), but a law of time prescribes one"
    with pytest.raises(AlfmuError, match=said) as found:
        alfmu.simulate(press, 1.0, step, parameters=parameters)
    assert f"t = {step * (jam // step):g}" in str(found.value)


@pytest.mark.parametrize("beyond", [False, True])
def test_a_motion_begins_from_rest_or_jams_there(press, beyond):
    """It begins with neither rate nor acceleration, at a place where the ram can be pushed, or where it cannot."""
    growth = 20.0
    parameters = {"solver.method": "rk4", "growth": growth, "begin": JAM + (0.01 if beyond else -0.2)}
    if beyond:
        with pytest.raises(AlfmuError, match=r"joints jam: .* \(guide\), but a law of time prescribes one"):
            alfmu.simulate(press, 0.1, 0.01, parameters=parameters)
    else:
        run = alfmu.simulate(press, 0.1, 0.01, parameters=parameters)
        assert run["guide.slip"].tolist() == [0.0] + [1.0] * 10
