"""Limit stops by one call, against closed forms of blows and the balance of forces."""

import math

import numpy as np
import pytest
from scenes import hinged, readings, sliding, started
from scipy.integrate import solve_ivp

import alfmu
from alfmu.model.stops import CREEP

G = 9.81


@pytest.mark.parametrize(("restitution", "speed"), [(0.0, 3.0), (0.6, 0.4), (0.6, 3.0)])
def test_a_blow_leaves_the_share_of_speed_that_restitution_says(restitution: float, speed: float):
    """Whatever the speed, as no other force does work meanwhile."""
    m = alfmu.Mechanism("puck", experiment=alfmu.Experiment(0.06, 1e-3))
    place = m.coordinate("place", "m", start=0.001, rate=-speed, independent=True)
    puck = m.body("puck", mass=0.5)
    rail = m.prismatic("rail", m.ground.at(0, 0), puck.at(0, 0), coordinate=place)
    m.end_stop("wall", rail, lower=0.0, stiffness=1e5, onset=1e-4, restitution=restitution)
    result = alfmu.simulate(m, parameters={"solver.method": "explicit", "solver.relative_tolerance": 1e-8})
    after = result["puck.vx"][-1]
    assert after == pytest.approx(restitution * speed, abs=2e-3 * speed if restitution else 10 * CREEP)
    assert (result["wall.penetration"][-1] == 0) == (restitution > 0)
    lost = 0.5 * 0.5 * (speed**2 - after**2)
    if restitution:  # without any, the puck creeps out of the wall, which still holds its energy
        assert result["monitor.work"][-1] == pytest.approx(-lost, abs=1e-3 * 0.25 * speed**2)


def test_the_force_of_a_stop_is_that_of_its_law():
    """Hunt and Crossley with both limits on a hinge, against the law integrated apart."""
    m = alfmu.Mechanism("flap", experiment=alfmu.Experiment(0.5, 1e-3))
    angle = m.coordinate("angle", start=0.0, rate=6.0, independent=True)
    flap = m.body("flap", mass=1.0, inertia=0.2)
    hinge = m.revolute("hinge", m.ground.at(0, 0), flap.at(0, 0), coordinate=angle)
    width = m.parameter("width", 0.3, "rad")
    m.end_stop("limit", hinge, upper=width, lower=-width, stiffness=2e3, onset=0.02, dissipation=0.05)

    def push(x: float, rate: float) -> float:
        z, beyond = min(max(x / 0.02, 0.0), 1.0), max(x - 0.02, 0.0)
        return 2e3 * (0.02 * (2.5 * z**4 - 3 * z**5 + z**6) + beyond) * (1 + 0.05 * rate)

    def torque(x: float, rate: float) -> float:
        return -push(x - 0.3, rate) + push(-0.3 - x, -rate)

    result = alfmu.simulate(m, 0.5, 1e-3, parameters={"solver.method": "explicit", "solver.relative_tolerance": 1e-9})
    known = solve_ivp(
        lambda t, y: [y[1], torque(*y) / 0.2],
        (0, 0.5),
        [0.0, 6.0],
        "DOP853",
        result.time,
        rtol=1e-11,
        atol=1e-12,
        max_step=1e-3,
    ).y
    assert result["flap.angle"] == pytest.approx(known[0], abs=2e-7)
    assert result["limit.torque"] == pytest.approx([torque(*y) for y in known.T], abs=1e-3)
    assert result["limit.penetration"] == pytest.approx(np.maximum(np.abs(known[0]) - 0.3, 0), abs=2e-7)
    assert result["limit.penetration"].max() > 0.02
    assert result["flap.angle"].min() < -0.3
    assert abs(result["monitor.step_error"]).max() < 1e-6


def test_a_bumper_between_two_points_is_felt_by_the_bearing():
    m, bar, *_ = hinged("bumper", angle="angle", mass=2.0, weight=0.0, start=-0.2, rate=1.5, independent=True)
    m.end_stop("bumper", (m.ground.at(1.0, -0.5), bar.end), lower=0.4, stiffness=5e3, onset=0.01)
    m.gravity(0, -G)
    y = readings(started(alfmu.derive(m)))
    end = np.array([math.cos(-0.2), math.sin(-0.2)])
    away = end - [1.0, -0.5]
    apart = np.linalg.norm(away)
    assert y["bumper.penetration"] == pytest.approx(0.4 - apart, rel=1e-12)
    force = 5e3 * (0.4 - apart - 0.01 + 0.5 * 0.01)
    assert y["bumper.force"] == pytest.approx(force, rel=1e-12)
    push = force * away / apart
    inertia = 2.0 / 3
    torque = end[0] * push[1] - end[1] * push[0] - 2.0 * G * end[0] / 2
    assert y["bar.angular_acceleration"] == pytest.approx(torque / inertia, rel=1e-12)
    bearing = 2.0 * np.array([y["bar.ax"], y["bar.ay"] + G]) - push
    assert [y["A.force.x"], y["A.force.y"]] == pytest.approx(list(bearing), rel=1e-11)


def test_a_guide_rubs_by_the_blow_of_a_stop():
    """A stop beside the guide, at half the distance of its edges, makes both carry as much as it pushes."""
    m, block, guide, *_ = sliding("hit", place="x", rate=-2.0, independent=True)
    m.friction(guide, coulomb=0.2, length=0.2)
    m.gravity(0, -G)
    beside = m.ground.at(-1.0, 0.1), block.at(0, 0.1)
    m.end_stop("stop", beside, lower=0.7, stiffness=1e6, restitution=0.6)
    run = alfmu.simulate(m, 0.2, 0.0005)
    hit = run["stop.force"] > G
    assert run["stop.force"].max() > 1000.0
    assert run["guide.friction_force"][hit] == pytest.approx(-0.2 * run["stop.force"][hit] * run["guide.slip"][hit])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "end stop floor has no limit"),
        ({"upper": -1.0, "lower": 0.0}, "upper limit -1 m and the lower limit 0 m; the upper one must be above"),
        ({"lower": 0.0, "dissipation": 0.1, "restitution": 0.5}, "has a dissipation and a restitution"),
        ({"lower": 0.0, "restitution": 1.5}, "restitution of end stop floor is 1.5; it must be from 0 to 1"),
        ({"lower": 0.0, "onset": 0.0}, "the onset of end stop floor is 0 m; it must be above zero"),
        ({"lower": 0.0, "stiffness": -1.0}, "the stiffness of end stop floor is -1 N/m; it must not be negative"),
        ({"lower": 0.0, "of": 3.0}, "takes a joint, two markers or an expression in coordinates, not 3.0"),
        ({"lower": 0.0, "of": "fall"}, "takes a joint, two markers or an expression in coordinates, not 'fall'"),
    ],
)
def test_a_stop_that_cannot_be_is_refused(given: dict, said: str):
    m, _, joint, *_ = sliding("m", body="body", joint="fall", place="h")
    with pytest.raises(alfmu.DeclarationError, match=said):
        m.end_stop("floor", **{"of": joint, "stiffness": 1e5, **given})
