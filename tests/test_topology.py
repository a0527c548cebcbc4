"""Case 8 of the paper: constraints removed and added while running, by a penalty that is zero."""

import numpy as np
import pytest
from scenes import initialized, refused

import alfmu


def test_a_particle_leaves_its_circle_on_a_straight_line_and_is_caught_again():
    """Without force: uniform motion on the circle, then on the tangent, both known in closed form."""
    i = initialized(alfmu.Instance(alfmu.derive(alfmu.load("particle_on_circle"))))
    on = i.penalty
    for _ in range(50):
        i.step(0.02)
    # Uniform motion: angle = t; RK4's error after 1 s at 0.02 s is 1.3e-9.
    assert i.q == pytest.approx([np.cos(1.0), np.sin(1.0)], abs=5e-9)
    q, v = i.q.copy(), i.v.copy()
    i.penalty = [0.0]
    assert np.array_equal(i.q, q)
    assert np.array_equal(i.v, v)
    for _ in range(10):
        i.step(0.05)
    # A straight line is integrated exactly but for round-off.
    assert i.q == pytest.approx(q + 0.5 * v, abs=1e-14)
    assert i.get("multiplier[1]") == 0.0
    assert i.get("monitor.position_error") == 0.0  # a constraint that is off has no error
    with refused(i, alfmu.InputError, match=r"open by 0\.118 at circle cannot be switched on"):
        i.penalty = on
    # A circle of the radius reached: the speed along the radius is lost, the speed along the circle kept.
    i.penalty = [0.0]
    rebound = alfmu.Instance(i.equations)
    rebound.set("rho", float(np.hypot(*i.q)))
    rebound.set("start.angle", float(np.arctan2(i.q[1], i.q[0])))
    rebound.initialize()
    rebound.penalty = [0.0]
    rebound.v[:] = i.v
    rebound.penalty = on
    radial = i.q / np.hypot(*i.q)
    assert rebound.v == pytest.approx(i.v - radial * (radial @ i.v), abs=1e-14)


@pytest.mark.parametrize("bad", [[1.0, 1.0], [-1.0], [np.nan]])
def test_a_bad_penalty_is_refused(bad):
    i = initialized(alfmu.Instance(alfmu.derive(alfmu.load("particle_on_circle"))))
    before = i.penalty
    with pytest.raises(alfmu.InputError, match=r"solver\.penalty"):
        i.penalty = bad
    assert np.array_equal(i.penalty, before)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "bound"), [("rk4", 1e-11), ("auto", 1e-5)])
def test_the_redundant_link_of_the_five_bar_can_come_off_and_the_motion_stays(method, bound):
    """Rows E and F off: link 4 falls freely, links 1 to 3 are the four-bar from then on."""
    five, four = (alfmu.Instance(alfmu.derive(alfmu.load(name))) for name in ("five_bar", "four_bar"))
    for i in (five, four):
        initialized(i, {"solver.method": method, "start.angle": 0.7})
    q0, v0 = five.q[5:7].copy(), five.v[5:7].copy()
    five.penalty = [*five.penalty[:4], 0.0, 0.0, 0.0, 0.0]
    for _ in range(20):
        five.step(0.02)
        four.step(0.02)
    names = ["link1.angle", "link3.angular_velocity", "A.force.x", "D.force.y", "B.force.x", "multiplier[4]"]
    assert [five.get(n) for n in names] == pytest.approx([four.get(n) for n in names], abs=bound)
    assert five.q[5:7] == pytest.approx(q0 + 0.4 * v0 + [0.0, -9.81 * 0.4**2 / 2], abs=1e-13)
    assert [five.get(f"{j}.force.{x}") for j in "EF" for x in "xy"] == [0.0] * 4


def test_the_penalty_is_part_of_the_saved_state():
    i = initialized(alfmu.Instance(alfmu.derive(alfmu.load("five_bar"))), {"start.angle": 0.7})
    i.penalty = [*i.penalty[:4], 0.0, 0.0, 0.0, 0.0]
    state = i.save()
    i.step(0.1)
    expected = i.read()
    other = alfmu.Instance(i.equations)
    other.restore(state)
    other.step(0.1)
    assert np.array_equal(other.read(), expected)
