"""Prescribed motion: closed forms of all reactions, inverse dynamics and back, moving places, signals, switches, FMUs.

References: Newton's and Euler's laws by hand, the equation of the one degree of freedom of a parallelogram, DOP853.
"""

import math
from collections.abc import Callable
from functools import cache

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu
from numpy.polynomial import chebyshev
from oracles import ode
from scenes import hinged, initialized, made

import alfmu
from alfmu.fmi.drive import Fmu
from alfmu.runtime.pipeline import with_defaults
from alfmu.simulation import run

G = 9.81
KERNELS = ("vm", "oracle")


def by_rk4(mechanism: alfmu.Mechanism) -> alfmu.Equations:
    """Equations to be integrated by RK4 alone, which takes less to trace."""
    return with_defaults(alfmu.derive(mechanism), {"solver.method": "rk4"})


def crank(law: Callable, switch: bool = False, **signal) -> alfmu.Mechanism:
    """A bar of 1 kg and 1 m on a hinge that turns by a law of time, or by the input `A.angle`."""
    m, _, A, *_ = hinged("crank", weight=G, independent=True)
    m.motion(A, law(m.time) if law else m.input("A.angle", "rad", **signal), switch=switch)
    return m


def linkage(law=None, torque=None, bars=4, motors="A") -> alfmu.Mechanism:
    """The paper's parallelogram of bars of 1 kg and 1 m, with a fifth bar in the middle, or without.

    `law(t)` is the angle that motors give links from the parameter `before` on, `torque(t)` what drives the first one.
    """
    m = alfmu.Mechanism("linkage", experiment=alfmu.Experiment(step_size=0.01))
    before = m.parameter("before", 0.3, "rad")
    th1 = m.coordinate("th1", "rad", independent=True)
    first = m.bar("first", mass=1.0, length=1.0)
    third = m.bar("third", mass=1.0, length=1.0)
    A = m.revolute("A", m.ground.at(0, 0), first.start, coordinate=th1)
    m.revolute("D", m.ground.at(1, 0), third.start, coordinate=m.coordinate("th3", "rad", start=th1))
    for i, (name, at) in enumerate((("coupler", 1.0), ("middle", 0.5))[: bars - 3]):
        places = at * ca.cos(th1) + 0.5, at * ca.sin(th1)
        x, y = (m.coordinate(f"{k}{i}", "m", start=start) for k, start in zip("xy", places, strict=True))
        bar = m.bar(name, mass=1.0, length=1.0, pose=(x, y, m.coordinate(f"turn{i}", "rad")))
        m.revolute("BE"[i], first.at(at), bar.start)
        m.revolute("CF"[i], third.at(at), bar.end)
    m.gravity(0, -G)
    if torque is not None:
        m.drive(A, torque(m.time))
    for motor in motors if law else "":
        m.motion(motor, before + law(m.time))
    return m


def swing(t):
    """A law that turns the parallelogram through its singular positions at 0 and pi, where all bars are in line."""
    return 2 * t + 0.5 * (ca if isinstance(t, ca.SX) else np).sin(t)


def torque_of_swing(t: np.ndarray, bars: int, before: float = 0.0) -> np.ndarray:
    """What that takes, from the equation of the one degree of freedom that the parallelogram has."""
    inertia, weight = (5 / 3, 2.0) if bars == 4 else (23 / 12, 2.5)
    return -inertia * 0.5 * np.sin(t) + weight * G * np.cos(swing(t) + before)


# Closed forms -----------------------------------------------------------------------------------------------------


def slider_crank(speed: float) -> alfmu.Mechanism:
    m = alfmu.Mechanism("slider_crank")
    angle = m.coordinate("angle", "rad", independent=True)
    turn = m.coordinate("turn", "rad")
    s = m.coordinate("s", "m", start=0.4)
    arm = m.bar("arm", mass=1.0, length=0.1)
    rod = m.bar("rod", mass=0.5, length=0.3)
    slider = m.body("slider", mass=0.8, inertia=0.01)
    A = m.revolute("A", m.ground.at(0, 0), arm.start, coordinate=angle)
    m.revolute("B", arm.end, rod.start, coordinate=turn)
    m.prismatic("G", m.ground.at(0, 0), slider.at(0, 0), coordinate=s)
    m.revolute("C", rod.end, slider.at(0, 0))
    m.gravity(0, -G)
    m.motion(A, speed * m.time)
    return m


@cache
def turned() -> alfmu.Equations:
    return by_rk4(slider_crank(30.0))


def by_hand(t: np.ndarray, w: float) -> dict[str, np.ndarray]:
    """Every reaction of the slider-crank at a constant speed w of its crank, by Newton's and Euler's laws."""
    r, l, m1, m2, m3 = 0.1, 0.3, 1.0, 0.5, 0.8
    c, s = np.cos(w * t), np.sin(w * t)
    sine = -r * s / l  # of the rod's angle
    cosine = np.sqrt(1 - sine**2)
    rate = -r * w * c / l / cosine
    turning = (r * w**2 * s / l + sine * rate**2) / cosine
    slide = -r * w**2 * c - l * (cosine * rate**2 + sine * turning)
    rod_x = -r * w**2 * c - l / 2 * (cosine * rate**2 + sine * turning)
    rod_y = -r * w**2 * s + l / 2 * (cosine * turning - sine * rate**2)
    C_x = m3 * slide
    B_x = C_x + m2 * rod_x
    both = (sine * (B_x + C_x) - m2 * l / 6 * turning) / cosine  # of B and C along y
    C_y = (both - m2 * (G + rod_y)) / 2
    B_y = both - C_y
    A_x, A_y = B_x - m1 * r / 2 * w**2 * c, B_y + m1 * (G - r / 2 * w**2 * s)
    torque = r * (c * B_y - s * B_x) + m1 * G * r / 2 * c
    forces = {"A": (A_x, A_y), "B": (B_x, B_y), "C": (C_x, C_y)}
    parts = {f"{joint}.force.{axis}": x for joint, force in forces.items() for axis, x in zip("xy", force, strict=True)}
    return {**parts, "G.force": m3 * G - C_y, "G.moment": 0 * t, "A.torque": torque, "slider.acceleration": slide}


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_slider_crank_at_constant_speed_has_the_reactions_of_the_textbook(kernel):
    found = alfmu.simulate(turned(), 0.25, 0.005, kernel=kernel)
    for name, expected in by_hand(found.time, 30.0).items():
        assert found[name] == pytest.approx(expected, abs=1e-10 * max(1.0, abs(expected).max())), name
    assert found["arm.angle"] == pytest.approx(30.0 * found.time, abs=1e-14)
    assert found["monitor.step_error"].max() < 1e-5


def test_all_freedom_prescribed_leaves_none():
    instance = initialized(made(turned(), "vm"))
    assert (instance.mobility().freedom, instance.mobility().redundant) == (0, 0)
    assert instance.undetermined() == []
    assert instance.equations.coordinates[-1].name == "time"
    assert [v.name for v in instance.equations.starts] == []  # The motion says where the crank begins.


# Inverse dynamics through singular positions -----------------------------------------------------------------------


@cache
def prescribed(bars: int) -> alfmu.Equations:
    return alfmu.derive(linkage(swing, bars=bars))


@pytest.mark.parametrize("bars", [4, 5])
@pytest.mark.parametrize("kernel", KERNELS)
def test_in_a_singular_position_the_torque_is_the_limit_along_the_motion(kernel, bars):
    how = {"solver.method": "rk4", "before": 0.0}
    found = alfmu.simulate(prescribed(bars), 0.3, 0.02, kernel=kernel, parameters=how)
    assert found["monitor.singular"][0] > 0
    assert found["A.torque"] == pytest.approx(torque_of_swing(found.time, bars), abs=1e-8)
    assert found["coupler.angle"] == pytest.approx(0 * found.time, abs=1e-12)  # on the branch of the parallelogram
    assert found["monitor.step_error"].max() < 1e-6


@pytest.mark.parametrize("before", [-0.3, -0.7, -0.61803])
def test_whatever_the_phase_the_law_is_followed_through_singular_positions(before):
    found = alfmu.simulate(prescribed(4), 0.6, 0.02, parameters={"before": before})
    assert found["first.angle"] == pytest.approx(swing(found.time) + before, abs=1e-12)
    assert found["A.torque"] == pytest.approx(torque_of_swing(found.time, 4, before), abs=1e-7)


@pytest.mark.parametrize("formulation", ["classic", "penalty", "baumgarte", "dae"])
def test_every_formulation_follows_the_law(formulation):
    how = {"solver.formulation": formulation, "solver.method": "rk4", "solver.step_size": 0.005, "before": 0.4}
    found = alfmu.simulate(prescribed(4), 0.3, 0.02, parameters=how)
    assert found["first.angle"] == pytest.approx(swing(found.time) + 0.4, abs=1e-8)
    assert found["A.torque"] == pytest.approx(torque_of_swing(found.time, 4, 0.4), abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("bars", [4, 5])
def test_the_torque_of_a_motion_gives_that_motion_back(bars):
    """Through both singular positions, by a series fitted to the torque at communication points, those two included."""
    end, before = 1.7, -0.4
    inverse = alfmu.simulate(prescribed(bars), end, 0.01, parameters={"before": before})
    t = inverse.time
    series = chebyshev.chebfit(2 * t / end - 1, inverse["A.torque"], 24)
    assert chebyshev.chebval(2 * t / end - 1, series) == pytest.approx(torque_of_swing(t, bars, before), abs=1e-9)

    def torque(time: ca.SX) -> ca.SX:
        x, one, two = 2 * time / end - 1, ca.SX(0), ca.SX(0)
        for k in series[:0:-1]:
            one, two = float(k) + 2 * x * one - two, one
        return float(series[0]) + x * one - two

    given = {"start.th1": before, "start.th1_rate": 2.5, "solver.step_size": 0.001}
    forward = alfmu.simulate(by_rk4(linkage(torque=torque, bars=bars)), end, 0.1, parameters=given)
    assert forward["first.angle"] == pytest.approx(inverse["first.angle"][::10], abs=1e-9)
    assert before < 0 < math.pi < swing(end) + before  # both singular positions are passed


@pytest.mark.slow
def test_two_motors_on_one_freedom_share_the_load_and_say_so():
    e = by_rk4(linkage(swing, motors="AD"))
    found = alfmu.simulate(e, 0.5, 0.02)
    expected = torque_of_swing(found.time, 4, 0.3)
    assert found["A.torque"] + found["D.torque"] == pytest.approx(expected, abs=1e-9)
    instance = initialized(made(e, "vm"))
    assert (instance.mobility().freedom, instance.mobility().redundant) == (0, 1)
    assert {"A.torque", "D.torque"} <= set(instance.shared())
    assert "not unique" in next(v.description for v in instance.outputs if v.name == "A.torque")
    # Of least norm: no share that both can take from each other is left in the multipliers.
    rows = [i for i, v in enumerate(instance.outputs) if v.name.startswith("multiplier")]
    lam = instance.read()[rows]
    C = np.array(instance.equations.functions["constraints"](instance.q, instance.v, instance.memory["p"])[1])
    _, sizes, _ = np.linalg.svd(C)
    null = np.linalg.svd(C)[0][:, (sizes > 1e-9).sum() :]
    assert null.T @ lam == pytest.approx(0, abs=1e-9 * abs(lam).max())


@pytest.mark.parametrize("method", ["rk4", "order8", "stiff", "auto", "parted"])
def test_a_law_beyond_a_dead_position_or_against_another_one_is_called_into_question(method):
    """The slide of a slider-crank would leave the circle that its rod reaches, at 0.5 s; two laws of one freedom part
    from 0.2 s on."""
    m = alfmu.Mechanism("press")
    crank, rod, slide = m.bar("crank", mass=1.0, length=0.1), m.bar("rod", mass=1.0, length=0.3), m.body("k", mass=1.0)
    m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=m.coordinate("angle", start=0.9))
    m.revolute("B", crank.end, rod.start, coordinate=m.coordinate("bend", start=-1.2))
    guide = m.prismatic("guide", m.ground.at(0, 0), slide.at(0, 0), coordinate=m.coordinate("way", "m", start=0.35))
    m.revolute("C", rod.end, slide.at(0, 0))
    m.gravity(0, -G)
    if method != "parted":
        m.motion(guide, 0.35 + 0.1 * m.time)  # up to 0.4 m, at 0.5 s
    else:
        angle = 0.9 + m.time
        m.motion("A", angle)
        m.motion(
            guide, 0.1 * ca.cos(angle) + ca.sqrt(0.09 - (0.1 * ca.sin(angle)) ** 2) + ca.fmax(m.time - 0.2, 0) ** 3
        )
    with pytest.raises(alfmu.StepError, match=r"its laws lead on to positions at which the loops cannot be") as error:
        alfmu.simulate(m, 1.0, 0.07, parameters={"solver.method": "auto" if method == "parted" else method})
    # Steps that become ever shorter before the position would be hundreds of thousands.
    assert error.value.result.counters.evaluations < 1e5
    last, found = (0.49, 0.5) if method != "parted" else (0.14, 0.2)
    assert error.value.result.time[-1] == pytest.approx(last)
    assert float(str(error.value).split("t = ")[1].split(" s")[0]) == pytest.approx(found, abs=2e-3)


def test_two_motors_that_contradict_each_other_are_refused():
    m = linkage(lambda t: 0.3 + t)
    m.motion("D", 0.4 + m.time)
    with pytest.raises(alfmu.AssemblyError, match="linkage: the loops cannot be closed"):
        made(by_rk4(m), "vm").initialize()


# What moves by itself ----------------------------------------------------------------------------------------------


def kapitza(amplitude: float) -> alfmu.Mechanism:
    """A pendulum that stands on its hinge, which shakes up and down at 200 rad/s."""
    m = alfmu.Mechanism("kapitza", experiment=alfmu.Experiment(step_size=1e-3))
    th = m.coordinate("th", "rad", start=math.pi / 2 + 0.1, independent=True)
    bar = m.bar("bar", mass=1.0, length=1.0)
    m.revolute("A", m.ground.at(0, amplitude * ca.cos(200 * m.time)), bar.start, coordinate=th)
    m.gravity(0, -G)
    return m


@pytest.mark.parametrize("kernel", KERNELS)
def test_on_a_vibrating_base_a_pendulum_stands_up(kernel):
    found = alfmu.simulate(by_rk4(kapitza(0.05)), 0.3, 0.005, kernel=kernel)
    t = found.time
    exact = ode.motion(
        lambda t, x, v: -1.5 * (G - 0.05 * 200**2 * math.cos(200 * t)) * math.cos(x), math.pi / 2 + 0.1, 0, t
    )
    assert found["bar.angle"] == pytest.approx(exact[:, 0], abs=5e-5)
    assert np.ptp(exact[:, 0]) < 0.25
    turning = found["bar.angular_acceleration"]
    base = -0.05 * 200**2 * np.cos(200 * t)
    up = base + 0.5 * (np.cos(exact[:, 0]) * turning - np.sin(exact[:, 0]) * exact[:, 1] ** 2)
    assert found["A.force.y"] == pytest.approx(G + up, abs=2e-2)
    balance = found["monitor.energy"] - found["monitor.energy"][0] - found["monitor.work"]
    assert abs(balance).max() < 1e-4 * found["monitor.energy"].max()


def test_it_falls_where_the_base_shakes_too_little():
    found = alfmu.simulate(by_rk4(kapitza(0.005)), 1.2, 0.02)
    assert abs(found["bar.angle"][-1] - math.pi / 2) > 1


def test_a_law_as_a_coordinate_is_the_motion_of_a_coordinate():
    """With the same work and the same torque; the arm that is carried along swings freely."""
    runs = []
    for as_coordinate in (False, True):
        m = alfmu.Mechanism("carried")
        law = ca.sin(3 * m.time)
        upper, lower = (m.bar(name, mass=1.0, length=1.0) for name in ("upper", "lower"))
        th = law if as_coordinate else m.coordinate("th", "rad")
        A = m.revolute("A", m.ground.at(0, 0), upper.start, coordinate=th)
        swinging = m.coordinate("swinging", "rad", start=-1.0, independent=True)
        m.revolute("B", upper.end, lower.start, coordinate=swinging)
        m.gravity(0, -G)
        if not as_coordinate:
            m.motion(A, law)
        runs.append(alfmu.simulate(by_rk4(m), 0.5, 0.01, parameters={"solver.step_size": 0.001}))
    one, other = runs
    for name in ("lower.angle", "A.torque", "A.force.x", "B.force.y", "monitor.work"):
        assert one[name] == pytest.approx(other[name], abs=1e-7), name


@pytest.mark.parametrize("kernel", KERNELS)
def test_laws_alone_are_a_mechanism(kernel):
    """Two bars that turn at constant speeds: the torque of the elbow by Euler's law, that of the shoulder by energy."""
    m = alfmu.Mechanism("arm")
    upper, lower = (m.bar(name, mass=1.0, length=1.0) for name in ("upper", "lower"))
    m.revolute("A", m.ground.at(0, 0), upper.start, coordinate=3 * m.time)
    m.revolute("B", upper.end, lower.start, coordinate=-2 * m.time)
    m.gravity(0, -G)
    found = alfmu.simulate(by_rk4(m), 1.0, 0.05, kernel=kernel)
    t = found.time
    elbow = -4.5 * np.sin(2 * t) + G / 2 * np.cos(t)
    power = -3 * np.sin(2 * t) + G * (4.5 * np.cos(3 * t) + np.cos(t) / 2)
    assert found["B.torque"] == pytest.approx(elbow, abs=1e-12)
    assert found["A.torque"] == pytest.approx((power + 2 * elbow) / 3, abs=1e-12)
    assert 0 < found["monitor.step_error"].max() < 1e-4


def test_a_guide_that_turns_throws_its_slider_out():
    """r'' = w^2 r, and the guide pushes with 2 m w r'."""
    m = alfmu.Mechanism("tube")
    tube = m.body("tube", mass=1.0, inertia=1.0, pose=(0.0, 0.0, 2 * m.time))
    ball = m.body("ball", mass=0.5)
    r = m.coordinate("r", "m", start=0.1, independent=True)
    m.prismatic("guide", tube.at(0, 0), ball.at(0, 0), coordinate=r)
    found = alfmu.simulate(m, 1.0, 0.02, parameters={"solver.relative_tolerance": 1e-10})
    assert found["ball.position"] == pytest.approx(0.1 * np.cosh(2 * found.time), abs=1e-9)
    assert found["guide.force"] == pytest.approx(0.4 * np.sinh(2 * found.time), abs=1e-8)
    assert found["monitor.work"] == pytest.approx(found["monitor.energy"] - found["monitor.energy"][0], abs=1e-8)


def test_a_driven_length_and_a_constraint_of_time():
    """A weight on a rope that is wound up, and that something pulls aside."""
    m = alfmu.Mechanism("winch")
    x, y = m.coordinate("x", "m"), m.coordinate("y", "m", start=-2.0)
    load = m.body("load", mass=3.0, pose=(x, y, 0.0))
    m.distance("rope", m.ground.at(0, 0), load.at(0, 0), length=2.0 - 0.25 * m.time)
    m.constraint("plumb", x - 0.1 * m.time**2)
    m.gravity(0, -G)
    found = alfmu.simulate(by_rk4(m), 2.0, 0.02)
    t = found.time
    length, across = 2.0 - 0.25 * t, 0.1 * t**2
    assert found["load.y"] == pytest.approx(-np.sqrt(length**2 - across**2), abs=1e-12)
    balance = found["monitor.energy"] - found["monitor.energy"][0] - found["monitor.work"]
    assert abs(balance).max() < 1e-6


def test_a_spatial_hinge_turns_on_and_on():
    m = alfmu.Mechanism("rotor")
    body = m.spatial_body("body", mass=2.0, inertia=(0.1, 0.2, 0.25), position=(0.5, 0, 0))
    J = m.spatial_revolute("J", m.spatial_ground.at(), body.at(-0.5, 0, 0), axis=(0, 0, 1))
    m.gravity(0, -G)
    m.motion(J, 3 * m.time)
    found = alfmu.simulate(by_rk4(m), 3.0, 0.1, parameters={"solver.step_size": 0.05})
    assert found["J.angle"] == pytest.approx(3 * found.time, abs=1e-12)
    assert found["J.torque"] == pytest.approx(G * np.cos(3 * found.time), abs=1e-10)
    assert found["J.force.x"] == pytest.approx(-9 * np.cos(3 * found.time), abs=1e-10)


def test_a_spatial_hinge_with_a_coordinate_follows_a_law_and_is_carried_by_one():
    def rotor(base) -> alfmu.Mechanism:
        m = alfmu.Mechanism("rotor")
        body = m.spatial_body("body", mass=2.0, inertia=(0.1, 0.2, 0.25), relative=True)
        at, angle = m.spatial_ground.at(base(m.time), 0, 0), m.coordinate("angle", "rad")
        m.spatial_revolute("J", at, body.at(-0.5, 0, 0), axis=(0, 0, 1), coordinate=angle)
        m.gravity(0, -G)
        m.motion("J", 3 * m.time)
        return m

    found = alfmu.simulate(by_rk4(rotor(lambda t: 0.0)), 1.0, 0.05)
    assert found["J.torque"] == pytest.approx(G * np.cos(3 * found.time), abs=1e-10)
    assert found["J.force.x"] == pytest.approx(-9 * np.cos(3 * found.time), abs=1e-10)
    moved = alfmu.simulate(by_rk4(rotor(ca.sin)), 1.0, 0.05)
    t, turned = moved.time, 3 * moved.time
    assert moved["J.torque"] == pytest.approx(G * np.cos(turned) + np.sin(turned) * np.sin(t), abs=1e-10)
    assert moved["J.force.x"] == pytest.approx(-9 * np.cos(turned) - 2 * np.sin(t), abs=1e-10)


def test_natural_coordinates_and_a_prismatic_joint():
    m = alfmu.Mechanism("natural")
    x, y, s = m.coordinate("x", "m", start=1.0), m.coordinate("y", "m"), m.coordinate("s", "m")
    cart = m.body("cart", mass=2.0)
    rail = m.prismatic("rail", m.ground.at(0, 0), cart.at(0, 0), coordinate=s)
    bar = m.bar("bar", mass=1.0, length=1.0, between=(cart.at(0, 0), m.point(x, y)))
    A = m.revolute("A", cart.at(0, 0), bar.start)
    m.motion(rail, 0.5 * m.time**2)
    m.motion(A, 4 * m.time)
    found = alfmu.simulate(by_rk4(m), 2.0, 0.05)
    t = found.time
    assert found["bar.angle"] == pytest.approx(4 * t, abs=1e-12)
    assert found["rail.driving_force"] == pytest.approx(3.0 - 8 * np.cos(4 * t), abs=1e-9)
    assert found["A.torque"] == pytest.approx(-np.sin(4 * t) / 2, abs=1e-9)


def test_the_start_follows_the_law_at_the_time_it_begins():
    instance = made(by_rk4(crank(lambda t: 1 + 2 * t)), "vm")
    instance.time = 1.5
    instance.initialize()
    assert (instance.get("bar.angle"), instance.get("bar.angular_velocity")) == (4.0, 2.0)
    instance.step(0.1)
    assert instance.get("bar.angle") == pytest.approx(4.2, abs=1e-14)


def test_start_values_that_contradict_a_motion_are_refused():
    m, _, A, th = hinged("tied", weight=0.0)
    m.tie(m.start("tip", 0.5, "m"), ca.cos(th))
    m.motion(A, 2 * m.time)
    with pytest.raises(alfmu.AssemblyError, match="start"):
        made(by_rk4(m), "vm").initialize()
    with pytest.raises(alfmu.InputError, match=r"start\.th"):
        with_defaults(alfmu.derive(crank(lambda t: t * 2)), {"start.th": 0.3})


def _hinged(law: Callable[[ca.SX], ca.SX]) -> alfmu.Mechanism:
    """A bar on a hinge whose angle follows a law."""
    m = alfmu.Mechanism("hinged")
    bar = m.bar("bar", mass=1.0, length=1.0)
    m.motion(m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=m.coordinate("th", "rad")), law(m.time))
    return m


@pytest.mark.parametrize(
    ("law", "size", "time"),
    [
        (lambda t: ca.if_else(t > 0.513, 0.05, 0.0), "0.05", "0.513"),
        (lambda t: ca.floor(10 * t), "1", "0.1"),
        (lambda t: ca.fmod(3 * t, 1.0), "1", "0.333333"),
        (lambda t: t + 2e-6 * ca.sign(t - 1 / 3), "4e-06", "0.333333"),
    ],
)
def test_a_law_that_jumps_is_refused_with_its_size(law, size, time):
    with pytest.raises(
        alfmu.DeclarationError, match=f"motion of A jumps by {size} rad at t = {time} s, which a rigid mechanism"
    ):
        _hinged(law)


def test_a_place_that_jumps_is_refused_and_a_rate_that_jumps_is_told():
    m = alfmu.Mechanism("places")
    x, y = m.coordinate("x", "m"), m.coordinate("y", "m")
    m.body("block", mass=1.0, pose=(x, y, 0.0))
    with pytest.raises(alfmu.DeclarationError, match=r"constraint level jumps by 0.2 m at t = 2 s"):
        m.constraint("level", y - x**2 - 0.2 * (m.time > 2))
    step = m.body("step", mass=1.0)
    with pytest.raises(alfmu.DeclarationError, match=r"coordinate of lift, a prismatic, jumps by 1 m at t = 1 s"):
        m.prismatic("lift", m.ground.at(0, 0), step.at(), coordinate=ca.floor(m.time))
    with pytest.raises(alfmu.DeclarationError, match=r"a point of joint rail jumps by 0.5 m at t = 1 s"):
        m.revolute("rail", m.ground.at(0, ca.if_else(m.time > 1, 0.5, 0)), step.at())
    arm = m.spatial_body("arm", mass=1.0, inertia=(1.0, 1.0, 1.0), relative=True)
    base, hand, turn = m.spatial_ground.at(), arm.at(), ca.floor(m.time / 2)
    with pytest.raises(alfmu.DeclarationError, match=r"coordinate of turn, a .*revolute, jumps by 1 rad at t = 2 s"):
        m.spatial_revolute("turn", base, hand, axis=(0, 0, 1), coordinate=turn)
    with pytest.raises(alfmu.DeclarationError, match=r"the pose of jig jumps by 2 rad at t = 3 s"):
        m.body("jig", mass=1.0, pose=(0, 0, 2 * (m.time > 3)))
    with pytest.warns(alfmu.AlfmuWarning, match=r"motion of A changes its rate by 2 rad/s at t = 0.5 s: an impact"):
        _hinged(lambda t: ca.fabs(t - 0.5))


@pytest.mark.parametrize(
    "law",
    [
        lambda t: ca.if_else(t < 1, 0, ca.if_else(t < 2, t - 1 - ca.sin(2 * np.pi * (t - 1)) / (2 * np.pi), 1)),
        lambda t: ca.tanh((t - 0.5) / 1e-6),
        lambda t: 0.1 * ca.sin(2e3 * t),
        lambda t: t**1.5,
        lambda t: ca.fmax(t - 1, 0) ** 2,
    ],
)
def test_laws_in_parts_and_steep_ones_are_none_that_jump(law):
    _hinged(law)


# Laws that break while they run -------------------------------------------------------------------------------------


def stepping(switch: bool = False) -> alfmu.Mechanism:
    """A bar whose angle has a ramp over `width` and a step at `late`; by default neither within the experiment."""
    m = alfmu.Mechanism("stepping", experiment=alfmu.Experiment(stop_time=1.0))
    late, width = m.parameter("late", 100.0, "s"), m.parameter("width", 50.0, "s")
    bar = m.bar("bar", mass=1.0, length=1.0)
    th = m.coordinate("th", "rad", independent=switch)
    A = m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=th)
    x = ca.fmin(ca.fmax((m.time - 2.0) / width, 0), 1)
    m.motion(A, 0.5 * m.time + ca.if_else(m.time > late, 0.25, 0.0) + x**3 * (10 - 15 * x + 6 * x**2), switch=switch)
    m.gravity(0, -G)
    return m


JUMP_AT = (
    r"stepping: the motion of A jumps by {} rad at t = {} s, which a rigid mechanism cannot follow; give a law without "
    r"jumps"
)


@cache
def stepping_by(method: str) -> alfmu.Equations:
    return with_defaults(alfmu.derive(stepping()), {"solver.method": method})


@pytest.mark.parametrize("method", ["auto", "rk4", "explicit", "order8", "stiff", "trapezoidal", "generalized_alpha"])
def test_a_law_that_jumps_with_other_parameters_is_refused_by_the_step(method):
    """The step before it is made, the one over it is not, whichever integrator would have made it."""
    with pytest.raises(alfmu.StepError, match=JUMP_AT.format("0.25", "0.513")) as caught:
        alfmu.simulate(stepping_by(method), 1.0, 0.02, parameters={"late": 0.513})
    assert caught.value.result.time[-1] == pytest.approx(0.5, abs=1e-12)
    assert caught.value.result["bar.angle"] == pytest.approx(0.5 * caught.value.result.time, abs=1e-12)


@pytest.mark.parametrize(
    ("given", "size", "time"),
    [
        ({"late": 1.7}, "0.25", "1.7"),  # Behind the stop time of the experiment.
        ({"late": 1.6}, "0.25", "1.6"),  # At a communication point.
        ({"width": 1e-14}, "1", "2"),
    ],
)
def test_a_jump_is_seen_in_runs_of_any_length(given, size, time):
    with pytest.raises(alfmu.StepError, match=JUMP_AT.format(size, time)):
        alfmu.simulate(stepping_by("rk4"), 3.0, 0.1, parameters=given)
    found = alfmu.simulate(stepping_by("rk4"), 3.0, 0.1, parameters={"width": 0.5})
    assert found["bar.angle"][-1] == pytest.approx(2.5, abs=1e-12)


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_step_over_a_jump_changes_nothing(kernel):
    instance = initialized(made(stepping_by("rk4"), kernel), {"late": 0.05})
    instance.step(0.04)
    before, read = instance.save(), instance.read()
    with pytest.raises(alfmu.StepError, match=JUMP_AT.format("0.25", "0.05")):
        instance.step(1.0)
    assert instance.save() == before
    assert np.array_equal(instance.read(), read)
    instance.step(0.005)
    assert instance.get("bar.angle") == pytest.approx(0.0225, abs=1e-13)


def test_a_jump_counts_while_its_motion_is_in_force():
    equations, given = by_rk4(stepping(switch=True)), {"late": 0.3, "start.th": -math.pi / 2}
    off = alfmu.simulate(equations, 0.5, 0.02, parameters=given)
    assert off["bar.angle"] == pytest.approx(-math.pi / 2, abs=1e-12)
    after = alfmu.simulate(equations, 0.5, 0.02, parameters=given, inputs={"A.driven": lambda t: t > 0.35})
    assert after["bar.angle"][-1] == pytest.approx(-math.pi / 2 + 0.5 * 0.14, abs=1e-12)
    with pytest.raises(alfmu.StepError, match=JUMP_AT.format("0.25", "0.3")):
        alfmu.simulate(equations, 0.5, 0.02, parameters=given, inputs={"A.driven": lambda t: t > 0.29})
    instance = made(equations, "vm")  # Where the step is refused the motion is not in force.
    initialized(instance, {**given, "late": 0.01})
    instance.set("A.driven", True)
    before = instance.q.copy(), instance.v.copy()
    with pytest.raises(alfmu.StepError, match=r"jumps by 0.25 rad"):
        instance.step(0.02)
    assert np.array_equal(instance.q, before[0])
    assert np.array_equal(instance.v, before[1])
    instance.step(0.02)
    assert instance.get("A.torque") == 0.0


def test_a_law_of_a_signal_that_jumps_is_refused():
    """What a law makes of a signal is known in the run alone: here a step where the signal passes 0.05 rad."""
    m, _, A, *_ = hinged("ratchet", weight=0.0)
    place = m.input("place", "rad", derivatives=1)
    m.motion(A, ca.if_else(place > 0.05, 0.3, 0.0) + place)
    given = {"place": lambda t: 0.2 * t, "place_rate": 0.2}
    with pytest.raises(alfmu.StepError, match=r"ratchet: the motion of A jumps by 0.3 rad at t = 0.25 s") as caught:
        alfmu.simulate(by_rk4(m), 1.0, 0.1, inputs=given)
    assert caught.value.result.time[-1] == pytest.approx(0.2)


def test_other_things_that_jump_in_the_run_are_named():
    def carried(place: Callable) -> None:
        m = alfmu.Mechanism("carried")
        leap = ca.if_else(m.time > m.parameter("late", 100.0, "s"), 0.1, 0.0)
        place(m, m.bar("bar", mass=1.0, length=1.0), leap)
        m.gravity(0, -G)
        alfmu.simulate(by_rk4(m), 0.5, 0.02, parameters={"late": 0.3})

    def on_a_point(m: alfmu.Mechanism, bar: alfmu.Body, leap: ca.SX) -> None:
        m.revolute("A", m.ground.at(leap, 0), bar.start, coordinate=m.coordinate("th", "rad", independent=True))

    def held(m: alfmu.Mechanism, bar: alfmu.Body, leap: ca.SX) -> None:
        th = m.coordinate("th", "rad")
        m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=th)
        m.constraint("held", th + 1.5 - leap, "rad")

    def guided(m: alfmu.Mechanism, bar: alfmu.Body, leap: ca.SX) -> None:
        s = m.coordinate("s", "m", independent=True)
        m.prismatic("G", m.ground.at(0, 0), bar.start, axis=leap, coordinate=s)

    for place, what in ((on_a_point, "a point of joint A"), (held, "constraint held"), (guided, "the axis of G")):
        with pytest.raises(alfmu.StepError, match=f"carried: {what} jumps by 0.1 (m|rad) at t = 0.3 s"):
            carried(place)


def test_a_guide_a_wheel_and_a_point_that_jump_are_refused_when_they_are_declared():
    m = alfmu.Mechanism("places")
    body, wheel = m.body("body", mass=1.0), m.body("wheel", mass=1.0)
    leap = ca.floor(m.time)
    for line in (
        lambda: m.prismatic("G", m.ground.at(0, 0), body.at(), axis=leap, coordinate=m.coordinate("s", "m")),
        lambda: m.point_on_line("L", m.ground.at(0, 0), body.at(), axis=leap),
        lambda: m.rolling("R", m.ground.at(leap, 0), wheel.at(), radius=0.1),
        lambda: m.point(leap, 0.0),
    ):
        with pytest.raises(alfmu.DeclarationError, match=r"jumps by 1 (m|rad) at t = 1 s"):
            line()
    assert m.laws == ()


def test_a_rate_that_jumps_with_other_parameters_is_told_once(caplog):
    m = alfmu.Mechanism("corner", experiment=alfmu.Experiment(stop_time=1.0))
    bar = m.bar("bar", mass=1.0, length=1.0)
    late = m.parameter("late", 100.0, "s")
    A = m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=m.coordinate("th", "rad"))
    m.motion(A, ca.fabs(m.time - late) + ca.fabs(m.time - late - 0.2))
    with caplog.at_level("WARNING", "alfmu"):
        alfmu.simulate(by_rk4(m), 0.3, 0.02)
        assert not caplog.records
        found = alfmu.simulate(by_rk4(m), 0.7, 0.02, parameters={"late": 0.31, "solver.step_size": 0.001})
    (said, *others) = caplog.messages
    assert said.startswith(
        "corner: the motion of A changes its rate by 2 rad/s at t = 0.31 s: an impact, whose impulse"
    )
    assert not any("changes its rate" in each for each in others)
    assert found["bar.angle"][-1] == pytest.approx(0.39 + 0.19, abs=1e-12)


LAWS = [
    (lambda t, p: ca.sqrt(p - t), 0.5),
    (lambda t, p: ca.asin(t / p), 0.5),
    (lambda t, p: t ** (2 + p), -0.5),
    (lambda t, p: ca.fmin(ca.fmax((t - 0.7) / (p - 5), 0), 1), 5.0),
]


@pytest.mark.parametrize(
    ("part", "law"), [*(("motion of A", k) for k in range(len(LAWS))), ("point of joint A", 0), ("point of joint A", 3)]
)
def test_a_law_that_is_not_finite_is_named(part, law):
    """At the start, or in the step where it ends; with other parameters it is a law as any other."""
    given, broken = LAWS[law]
    m = alfmu.Mechanism("broken", experiment=alfmu.Experiment(stop_time=0.6))
    bar = m.bar("bar", mass=1.0, length=1.0)
    th = m.coordinate("th", "rad", start=0.1, independent=part[0] == "p")
    value = given(m.time, m.parameter("p", 10.0))
    A = m.revolute("A", m.ground.at(value if part[0] == "p" else 0, 0), bar.start, coordinate=th)
    if part[0] == "m":
        m.motion(A, value)
    equations = by_rk4(m)
    assert alfmu.simulate(equations, 0.6, 0.02).time[-1] == pytest.approx(0.6)
    with pytest.raises(alfmu.AlfmuError, match=rf"broken: at t = 0.* s (the|a) {part}, its rate or its acceleration"):
        alfmu.simulate(equations, 0.6, 0.02, parameters={"p": broken})


@pytest.mark.parametrize(
    "law",
    [
        lambda t: ca.if_else(t < 1, 0, ca.if_else(t < 2, t - 1 - ca.sin(2 * np.pi * (t - 1)) / (2 * np.pi), 1)),
        lambda t: ca.fmax(ca.tanh((t - 0.5) / 1e-3), -2),
        lambda t: ca.fabs(0.1 * ca.sin(2e3 * t) + 0.2),
        lambda t: t**2.5,
        lambda t: ca.fmax(t - 1, 0) ** 2,
        lambda t: ca.sqrt(1 + t**2) + 1 / (1 + t),
    ],
)
def test_laws_in_parts_and_steep_ones_run_in_long_steps(law, caplog):
    instance = initialized(made(by_rk4(_hinged(law)), "vm"), {"solver.step_size": 0.5})
    for _ in range(4):
        instance.step(0.5)
        assert instance.get("bar.angle") == pytest.approx(float(ca.DM(law(ca.SX(instance.time)))), abs=1e-9)
    assert not any("changes its rate" in each for each in caplog.messages)


def test_coordinates_go_on_in_a_law_that_knows_no_whole_turns():
    """The difference of an angle and its law within a turn: it stays at zero, however far both go in a step."""
    m, _, _, th = hinged("turning", weight=0.0)
    m.constraint("turns", ca.remainder(th - m.parameter("w", 0.0, "rad/s") * m.time, 2 * math.pi), "rad")
    found = alfmu.simulate(by_rk4(m), 4.0, 2.0, parameters={"w": 5.0})
    assert found["bar.angle"] == pytest.approx(5 * found.time, abs=1e-10)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (lambda x: ca.sqrt(1 + x), "the motion of A changes too often to be searched for jumps"),
        (lambda x: ca.fmax(x, -1), "forces or laws of time have more than 4096 jumps or kinks"),
    ],
)
def test_a_law_that_turns_too_often_to_be_looked_at_says_so(law, said):
    m = alfmu.Mechanism("buzz", experiment=alfmu.Experiment(stop_time=1.0))
    bar = m.bar("bar", mass=1.0, length=1.0)
    A = m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=m.coordinate("th", "rad"))
    m.motion(A, law(1e-3 * ca.sin(m.parameter("w", 1.0, "rad/s") * m.time)))
    instance = initialized(made(by_rk4(m), "vm"), {"w": 1e9})
    with pytest.raises(
        alfmu.StepError, match=rf"buzz, t = .* s: {said} up to 0.02 s; take shorter communication steps"
    ):
        instance.step(0.02)


def test_a_scene_without_motion_carries_none_of_it():
    e = alfmu.derive(alfmu.load("four_bar"))
    assert (e.timed, list(e.followed), list(e.leaps)) == (False, [], [])
    assert "laws" not in by_rk4(_hinged(ca.sin)).functions
    assert "laws" in by_rk4(stepping()).functions
    assert "Phi_dot" not in e.functions
    assert e.dependent == e.n


# Signals -----------------------------------------------------------------------------------------------------------


def wave(t):
    return 0.5 * (1 - np.cos(2 * t))


WAVE = {"A.angle": wave, "A.angle_rate": lambda t: np.sin(2 * t), "A.angle_acceleration": lambda t: 2 * np.cos(2 * t)}


@cache
def by_signal(derivatives: int) -> alfmu.Equations:
    return by_rk4(crank(None, derivatives=derivatives))


@pytest.mark.parametrize(("derivatives", "order"), [(0, 3), (1, 4), (2, 5)])
def test_a_signal_is_followed_the_closer_the_more_is_known_of_it(derivatives, order):
    """Errors fall with the third, fourth and fifth power of the communication step."""
    inputs = {name: WAVE[name] for name in list(WAVE)[: derivatives + 1]}
    errors = []
    for h in (0.04, 0.02, 0.01):
        found = alfmu.simulate(by_signal(derivatives), 1.0, h, inputs=inputs)
        late = found.time > 0.3  # from the start on nothing is known of the past
        errors.append(abs(found["bar.angle"] - wave(found.time))[late].max())
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert slopes.min() > order - 0.1, (errors, slopes)


def test_with_all_companions_the_torque_is_that_of_the_motion():
    found = alfmu.simulate(by_signal(2), 1.0, 0.01, inputs=WAVE)
    t = found.time
    expected = 2 * np.cos(2 * t) / 3 + G / 2 * np.cos(wave(t))
    assert found["A.torque"] == pytest.approx(expected, abs=1e-3)
    assert found["A.torque"][t > 0.05] == pytest.approx(expected[t > 0.05], abs=1e-5)


@pytest.mark.parametrize(("derivatives", "smooth"), [(0, 2), (1, 2), (2, 3)])
def test_places_and_rates_never_jump(derivatives, smooth):
    """A zigzag of values: where a communication step ends the next one begins, with the same rate."""
    instance = initialized(made(by_signal(derivatives), "vm"))

    def reached() -> np.ndarray:
        since, *coefficients = instance.memory["p"][-7:]
        way = np.polynomial.Polynomial(coefficients)
        return np.array([way.deriv(k)(instance.time - since) for k in range(smooth)])

    scale = np.array([1e-2, 1.0, 100.0])[:smooth]
    for k in range(10):
        instance.set("A.angle", 0.002 * (k % 3))
        before = reached()
        instance.step(0.01)
        since, *coefficients = instance.memory["p"][-7:]
        assert since == pytest.approx(0.01 * k, abs=1e-15)
        begun = np.array([coefficients[d] * math.factorial(d) for d in range(smooth)])
        assert abs((begun - before) / scale).max() < 1e-12
        assert instance.get("bar.angle") == pytest.approx(reached()[0], abs=1e-14)
        assert instance.get("bar.angular_velocity") == pytest.approx(reached()[1], abs=1e-12)


def test_a_jump_is_refused_with_its_size_and_nothing_has_changed():
    instance = initialized(made(by_signal(0), "vm"))
    instance.step(0.01)
    before = instance.save()
    instance.set("A.angle", 0.3)
    with pytest.raises(
        alfmu.InputError,
        match=r"A.angle is set to 0.3 rad \(17.19 deg\), .* a jump of 0.3 rad, above the limit of 0.1 rad",
    ):
        instance.step(0.01)
    instance.restore(before)
    instance.set("A.angle", 0.05)
    instance.step(0.01)
    tolerant = initialized(made(by_rk4(crank(None, jump=0.5)), "vm"))
    tolerant.set("A.angle", 0.3)
    tolerant.step(0.01)
    assert tolerant.get("bar.angle") == pytest.approx(0.3, abs=1e-12)


def test_what_is_heard_of_an_input_is_part_of_the_state():
    def stepped(instance: alfmu.Instance, first: int, last: int) -> np.ndarray:
        for k in range(first, last):
            instance.set("A.angle", wave(0.02 * k))
            instance.step(0.02)
        return instance.read()

    instance, again = (made(by_signal(0), "vm") for _ in range(2))
    for each in (instance, again):
        each.initialize()
    stepped(instance, 0, 7)
    state = instance.save()
    expected = stepped(instance, 7, 12)
    instance.restore(state)
    assert np.array_equal(stepped(instance, 7, 12), expected)
    again.restore(state)
    assert np.array_equal(stepped(again, 7, 12), expected)


def test_kernels_agree_on_signals():
    one, other = (
        alfmu.simulate(by_signal(1), 0.5, 0.02, inputs=dict(list(WAVE.items())[:2]), kernel=kernel)
        for kernel in KERNELS
    )
    for name in ("bar.angle", "bar.angular_velocity", "A.torque", "A.force.x"):
        assert one[name] == pytest.approx(other[name], abs=1e-10)


def test_a_base_that_an_input_moves():
    """A pendulum at rest on a base that an input accelerates hangs back by the acceleration over gravity."""
    m = alfmu.Mechanism("carriage")
    x = m.input("x", "m", derivatives=2)
    th = m.coordinate("th", "rad", start=-math.pi / 2 - math.atan(2.0 / G), independent=True)
    bar = m.bar("bar", mass=1.0, length=1.0)
    m.revolute("A", m.ground.at(x, 0), bar.start, coordinate=th)
    m.gravity(0, -G)
    inputs = {"x": lambda t: t**2, "x_rate": lambda t: 2 * t, "x_acceleration": 2.0}
    found = alfmu.simulate(by_rk4(m), 1.0, 0.02, inputs=inputs)
    assert found["bar.angle"] == pytest.approx(-math.pi / 2 - math.atan(2.0 / G) + 0 * found.time, abs=1e-9)
    assert found["A.force.x"] == pytest.approx(2.0, abs=1e-8)


# Switches ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_motion_is_switched_on_where_the_joint_is_and_off_again(kernel):
    """It makes the changes of its law, begins with an impact, and is a lock where the law stands still."""
    m = crank(lambda t: 1.5 * t, switch=True)
    m.lock("A")
    given = {"start.th": 0.2, "start.th_rate": 0.5, "solver.step_size": 0.005}
    on = {"A.driven": lambda t: 0.1 <= t < 0.3}
    found = alfmu.simulate(by_rk4(m), 0.5, 0.01, inputs=on, parameters=given, kernel=kernel)
    t = found.time
    driven = (t > 0.105) & (t < 0.305)
    angle, speed = found["bar.angle"], found["bar.angular_velocity"]
    assert speed[driven] == pytest.approx(1.5 + 0 * t[driven], abs=1e-12)
    begin = angle[t.searchsorted(0.0999)]
    assert angle[driven] - begin == pytest.approx(1.5 * (t[driven] - 0.1), abs=1e-12)
    assert found["A.torque"][driven][:-1] == pytest.approx(G / 2 * np.cos(angle[driven][:-1]), abs=1e-9)
    assert found["A.torque"][~driven].max() == 0.0
    before = speed[t.searchsorted(0.0999)]
    assert found["A.impulse.motion"][-1] == pytest.approx((1.5 - before) / 3, abs=1e-9)
    assert found["monitor.energy_lost"][-1] == pytest.approx((1.5 - before) ** 2 / 6, abs=1e-9)
    balance = found["monitor.energy"] - found["monitor.energy"][0] - found["monitor.work"]
    assert abs(balance).max() < 1e-7


@pytest.mark.parametrize("switch", [False, True])
def test_a_lock_against_a_motion_is_refused_and_the_motion_goes_on(switch, caplog):
    m = crank(lambda t: 2 * t, switch=switch)
    m.lock("A")
    instance = initialized(made(by_rk4(m), "vm"))
    if switch:
        instance.set("A.driven", True)
    instance.step(0.1)
    instance.set("A.locked", True)
    with pytest.raises(
        alfmu.InputError, match=r"t = 0.1 s: the lock, joint or motion switched on contradicts .* A locked is violated"
    ):
        instance.step(0.1)
    instance.step(0.1)
    assert instance.get("bar.angle") == pytest.approx(0.4, abs=1e-12)
    assert instance.get("A.locked") == 0.0
    assert not caplog.records  # There is no dry friction whose load could be shared.


def test_a_motion_of_rate_zero_is_a_lock():
    runs = []
    for name in ("locked", "driven"):
        m = crank(lambda t: 0 * t, switch=True)
        m.lock("A")
        on = {f"A.{name}": lambda t: t >= 0.1}
        runs.append(alfmu.simulate(by_rk4(m), 0.3, 0.01, inputs=on, parameters={"start.th": 0.2}))
    lock, motion = runs
    assert np.array_equal(lock["bar.angle"], motion["bar.angle"])
    assert lock["A.locking_torque"] == pytest.approx(motion["A.torque"], abs=1e-12)


# FMUs --------------------------------------------------------------------------------------------------------------


def two_motors() -> alfmu.Mechanism:
    """An arm of two bars: its shoulder follows a law, its elbow an input while a switch is on."""
    m = alfmu.Mechanism("arm")
    upper, lower = (m.bar(name, mass=1.0, length=0.5) for name in ("upper", "lower"))
    m.revolute("A", m.ground.at(0, 0), upper.start, coordinate=m.coordinate("th", "rad"))
    m.revolute("B", upper.end, lower.start, coordinate=m.coordinate("ph", "rad", independent=True))
    m.gravity(0, -G)
    m.motion("A", swing(m.time))
    m.motion("B", m.input("B.angle", "rad", start=0.3, derivatives=2), switch=True)
    return m


@pytest.mark.parametrize(("kind", "version"), [("python", 2), ("native", 2), ("native", 3)])
def test_a_jump_fails_the_step_of_an_fmu_with_its_size(tmp_path, kind, version):
    chosen = {"solver.method": "rk4"}
    path = alfmu.export(stepping(), tmp_path / "stepping.fmu", kind=kind, fmi=version, parameters=chosen)
    with Fmu(path) as fmu, pytest.raises(alfmu.AlfmuError, match=JUMP_AT.format("0.25", "0.313")) as caught:
        run(fmu, 0.4, 0.02, {}, parameters={"late": 0.313})
    assert caught.value.result.time[-1] == pytest.approx(0.3)
    given = {"stop_time": 0.4, "output_interval": 0.02, "start_values": {"late": 0.313}}
    if kind == "python":  # A step that pythonfmu discards ends the run of fmpy, without more.
        assert fmpy.simulate_fmu(str(path), **given)["time"][-1] == pytest.approx(0.3)
    else:
        with pytest.raises(FMICallException, match="DoStep"):
            fmpy.simulate_fmu(str(path), **given)
    result = fmpy.simulate_fmu(str(path), stop_time=0.4, output_interval=0.02, output=["bar.angle"])
    assert result["bar.angle"] == pytest.approx(0.5 * result["time"], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "version"), [("python", 2), ("native", 2), ("native", 3)])
def test_through_fmpy_as_in_the_library(tmp_path, kind, version):
    path = alfmu.export(two_motors(), tmp_path / "arm.fmu", kind=kind, fmi=version)
    assert validate_fmu(str(path)) == []
    laws = {
        "B.angle": lambda t: 0.3 + wave(t),
        "B.angle_rate": WAVE["A.angle_rate"],
        "B.angle_acceleration": WAVE["A.angle_acceleration"],
        "B.driven": lambda t: t < 0.3,
    }
    with Fmu(path) as fmu:
        through_fmi = run(fmu, 0.4, 0.02, laws)
    library = alfmu.simulate(two_motors(), 0.4, 0.02, inputs=laws)
    assert through_fmi.names == library.names
    assert np.array_equal(through_fmi.values, library.values)
    driven = library.time < 0.31
    assert library["lower.angle"][driven] == pytest.approx((swing(library.time) + wave(library.time))[driven], abs=1e-5)
    result = fmpy.simulate_fmu(str(path), stop_time=0.2, output_interval=0.02, output=["upper.angle", "A.torque"])
    assert result["upper.angle"] == pytest.approx(swing(result["time"]), abs=1e-12)


@pytest.mark.slow
def test_input_derivatives_of_fmi_2_are_the_rate_of_a_signal(tmp_path):
    path = alfmu.export(crank(None), tmp_path / "crank.fmu", kind="native")
    errors = []
    for told in (False, True):
        with Fmu(path) as fmu:
            fmu.initialize()
            reference = [v.valueReference for v in fmu.description.modelVariables if v.name == "A.angle"]
            for k in range(20):
                fmu.set("A.angle", wave(0.02 * k))
                if told:
                    fmu.slave.setRealInputDerivatives(reference, [1], [math.sin(0.04 * k)])
                fmu.step(0.02, 0.02 * k)
            angle = dict(zip([v.name for v in fmu.outputs], fmu.read(), strict=True))["bar.angle"]
            errors.append(abs(angle - wave(0.4)))
    assert errors[1] < errors[0] / 5


def skew_loop(held: str) -> alfmu.Mechanism:
    """A sleeve on a post, a rod on a ball joint, and a sleeve whose angle a lock or a motion holds."""
    m = alfmu.Mechanism("loop")
    post = [m.coordinate("turn", "rad", start=0.3), m.coordinate("height", "m", start=0.1)]
    ball = [m.coordinate(f"e{k}", "1", start=x) for k, x in enumerate((0.9, 0.2, 0.3, 0.1))]
    arm = m.spatial_body("arm", mass=1.0, inertia=(0.01, 0.02, 0.025), center=(0.1, 0, 0.05), relative=True)
    rod = m.spatial_body("rod", mass=2.0, inertia=(0.03, 0.02, 0.04), center=(0.1, 0.1, 0), relative=True)
    A = m.cylindrical("A", m.spatial_ground.at(), arm.at(), axis=(0, 0, 1), coordinates=post)
    m.spherical("S", arm.at(0.3, 0, 0), rod.at(), coordinates=ball)
    at = m.spatial_ground.at(0.4, 0.3, 0.2), rod.at(0.3, 0.1, 0)
    K = m.cylindrical("K", *at, axis=(1, 0.2, 0.1), second_axis=(0, 1, 0))
    m.gravity(0, 0, -G)
    m.drive(A.freedom("angle"), 3.0)
    if held == "lock":
        m.lock(K.freedom("angle"))
    else:
        m.motion(K.freedom("angle"), m.parameter("at", 0.0, "rad") + 0.0 * m.time)
    return m


def test_reactions_feel_the_motion_of_a_joint_that_closes_a_loop_in_space():
    """A motion that stands still does what a lock does, wherever the bodies are and whatever the multipliers."""
    random, found = np.random.default_rng(3), []
    q, v, a, lam = (random.normal(size=k) for k in (6, 6, 6, 6))
    for held in ("lock", "motion"):
        e = alfmu.derive(skew_loop(held))
        timed = held == "motion"
        assert (e.n - timed, e.l) == (6, 6)
        x = [np.append(each, one) if timed else each for each, one in ((q, 0.0), (v, 1.0), (a, 0.0))]
        p = [0.4, 0.0] if timed else [0.4]  # where it is held; the time at which the run begins
        y = np.array(e.functions["readings"](*x, lam, [], p, 0.0)).ravel()
        found.append({o.name: value for o, value in zip(e.outputs, y, strict=True)})
    locked, moved = found
    for joint in "ASK":
        for axis in "xyz":
            assert moved[f"{joint}.force.{axis}"] == pytest.approx(locked[f"{joint}.force.{axis}"], rel=1e-12)
    for axis in "xy":
        assert moved[f"A.moment.{axis}"] == pytest.approx(locked[f"A.moment.{axis}"], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("on", ["joint", "coordinate"])
def test_a_motion_begins_the_angle_of_a_pose_that_its_hinge_turns(on):
    """A parallelogram of torn-off bars begins aligned, which is singular: guesses follow the angle, and so do rates."""
    m = alfmu.Mechanism("aligned")
    angle = m.coordinate("angle", "rad")
    c, s = ca.cos(angle), ca.sin(angle)

    def bar(name, x, y, turned):
        own = [m.coordinate(f"{name}_{k}", "m", start=each) for k, each in (("x", x), ("y", y))]
        return m.bar(name, mass=1.0, length=1.0, pose=(*own, turned))

    crank = bar("crank", c / 2, s / 2, angle)
    rod = bar("rod", c + 0.5, s, m.coordinate("rod_t", "rad"))
    rocker = bar("rocker", 1 + c / 2, s / 2, m.coordinate("rocker_t", "rad", start=angle))
    A = m.revolute("A", m.ground.at(), crank.start)
    for name, first, second in (
        ("B", crank.end, rod.start),
        ("C", rod.end, rocker.end),
        ("D", m.ground.at(1, 0), rocker.start),
    ):
        m.revolute(name, first, second)
    m.motion(A if on == "joint" else angle, 3 * m.time)
    run = alfmu.simulate(m, 0.5, 0.1)
    np.testing.assert_allclose(run["rocker.angle"], 3 * run.time, atol=1e-9)
    np.testing.assert_allclose(run["rod.angle"], 0.0, atol=1e-9)


def test_a_motion_of_a_joint_in_space_begins_its_coordinate():
    """Independent or not: it has no start value then."""
    m = alfmu.Mechanism("turntable")
    angle = m.coordinate("angle", "rad", independent=True)
    table = m.spatial_body("table", mass=1.0, inertia=(1.0, 1.0, 1.0), relative=True)
    m.motion(m.spatial_revolute("J", m.spatial_ground.at(), table.at(), axis=(0, 0, 1), coordinate=angle), 0.3 + m.time)
    i = initialized(alfmu.Instance(m))
    assert (i.q[0], i.v[0]) == (pytest.approx(0.3), pytest.approx(1.0))
    assert not m.starts


@pytest.mark.parametrize("method", ["auto", "stiff"])
def test_the_work_of_a_prescribed_motion_is_exact_for_any_communication_step(method, caplog):
    """The work of the motor is the change of the energy of a bar; steps that are short but not for a fast law warn."""

    def error(step: float, w: float = 9.0) -> float:
        m, _, hinge, *_ = hinged("swung", joint="hinge", angle="angle", mass=3.0, length=2.0, weight=0.0)
        m.motion(hinge, ca.sin(w * m.time))
        m.gravity(0, -9.81)
        found = alfmu.simulate(m, 3.0, step, parameters={"solver.method": method})["monitor.work"][-1]
        kinetic = 3 * 4 / 3 / 2 * w**2 * (np.cos(3 * w) ** 2 - 1)
        return abs(found - kinetic - 3 * 9.81 * np.sin(np.sin(3 * w))) / 124

    assert error(0.01) < 1e-9
    assert all(error(step) < 1e-5 for step in (0.5, 1.5, 3.0))
    assert not caplog.records
    error(0.02, 200.0)
    assert "take shorter communication steps" in caplog.text
