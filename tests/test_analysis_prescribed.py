"""Analyses where motions are prescribed or joints rub dryly, against closed forms and differences."""

from functools import cache

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
import scenes
from scenes import hinged
from scipy.optimize import brentq
from scipy.signal import lsim
from test_analysis import differences
from test_motion import by_rk4, crank, linkage, swing

import alfmu

G = 9.81


@cache
def carried() -> alfmu.Equations:
    """A crank that follows a signal, on a pivot that a law of time moves; at its end a bar that swings, of coordinates
    that constraints close."""
    m = alfmu.Mechanism("carried")
    pivot = m.ground.at(0.1 * ca.sin(3 * m.time), 0.02 * m.time)
    arm = m.bar("arm", mass=1.0, length=0.5)
    A = m.revolute("A", pivot, arm.start, coordinate=m.coordinate("arm_angle", "rad"))
    free = m.coordinate("free", "rad", start=0.4, rate=0.7, independent=True)
    x, y = (m.coordinate(name, "m") for name in "xy")
    bar = m.bar("bar", mass=0.8, length=0.6, pose=(x, y, free))
    m.revolute("B", arm.end, bar.start)
    m.spring_damper((m.ground.at(1.0, -0.5), bar.end), stiffness=30.0, damping=0.6, rest=0.3)
    m.motion(A, m.input("A.angle", "rad", derivatives=2))
    m.torque(bar, m.input("torque", "N.m"))
    m.output("lever", bar.end.position[1], "m")
    m.gravity(0, -G)
    return by_rk4(m)


GIVEN = {"A.angle": 0.3, "A.angle_rate": 1.2, "A.angle_acceleration": -2.0, "torque": 0.4}


def checked_by_differences(equations: alfmu.Equations, lin, given: dict, keys: list[str], step: float = 1e-3) -> None:
    """All outputs after the start, and so accelerations, by differences of instances."""

    def outputs(key: str, change: float) -> np.ndarray:
        values = scenes.readings(scenes.started(equations, {**given, key: given.get(key, 0.0) + change}))
        return np.array([values[each] for each in lin.outputs])

    size = 1 + np.abs(np.hstack([lin.C, lin.D])).max(axis=1)
    for key, column in zip(keys, np.hstack([lin.C, lin.D]).T, strict=True):
        error = np.abs(differences(lambda change, key=key: outputs(key, change), step) - column) / size
        assert error.max() < 1e-7, (key, lin.outputs[int(error.argmax())])
    here = outputs(keys[0], 0.0) - [lin.values[each] for each in lin.outputs]
    assert np.abs(here).max() < 1e-8 * (1 + max(map(abs, lin.values.values())))


def test_with_signals_and_laws_of_time_outputs_change_as_the_matrices_say():
    """By the coordinate that is left, and by value, rate and acceleration of the signal."""
    lin = alfmu.linearize(carried(), parameters={**GIVEN, "start.free": 0.4, "start.free_rate": 0.7})
    assert lin.states == ("free", "der(free)")
    assert lin.inputs == tuple(GIVEN)
    keys = ["start.free", "start.free_rate", *GIVEN]
    checked_by_differences(carried(), lin, {**GIVEN, "start.free": 0.4, "start.free_rate": 0.7}, keys)
    row = lin.outputs.index("bar.angular_acceleration")
    assert np.abs(lin.A[1] - lin.C[row]).max() < 1e-9
    assert np.abs(lin.B[1] - lin.D[row]).max() < 1e-9
    assert any("time stands still" in note for note in lin.notes)


def test_a_held_crank_has_the_torque_that_holds_it():
    """In closed form, of signals whose derivatives are inputs and of those where they are none."""
    for derivatives, names in ((2, ("A.angle_rate", "A.angle_acceleration")), (0, ("der(A.angle)", "der(A.angle,2)"))):
        m = crank(None, derivatives=derivatives)
        (rest,) = alfmu.equilibrium(m, parameters={"A.angle": 0.3})
        assert rest.outputs["A.torque"] == pytest.approx(G / 2 * np.cos(0.3), rel=1e-13)
        assert rest.coordinates == {"th": 0.3}
        assert rest.held_by == [f"A.torque = {rest.outputs['A.torque']:.6g} N.m"]
        lin = alfmu.linearize(m, parameters={"A.angle": 0.3}, outputs=["A.torque"])
        assert (lin.states, lin.inputs) == ((), ("A.angle", *names))
        assert np.abs(lin.D - [[-G / 2 * np.sin(0.3), 0.0, 1 / 3]]).max() < 1e-12
        assert lin.at_rest
    assert alfmu.mobility(crank(None), stop_time=0.0).freedom == 0


def crane() -> alfmu.Mechanism:
    """A bar of 1 kg and 2 m that hangs from a trolley, whose place is a signal."""
    m = alfmu.Mechanism("crane")
    place = m.input("place", "m", derivatives=2)
    rope = m.bar("rope", mass=1.0, length=2.0)
    trolley = m.body("trolley", mass=5.0, pose=(place, 0, 0))
    m.revolute("hook", trolley.at(0, 0), rope.start, coordinate=m.coordinate("swing", "rad", start=-1.2))
    m.gravity(0, -G)
    return m


def test_a_load_on_a_trolley_that_follows_a_signal_swings_in_closed_form():
    m = crane()
    rest = alfmu.equilibrium(m, parameters={"place": 0.3}).nearest
    assert rest.coordinates["swing"] == pytest.approx(-np.pi / 2, abs=1e-12)
    lin = alfmu.linearize(m, "equilibrium", inputs={"place": 0.3}, outputs=["rope.ax", "trolley.x"])
    assert np.abs(lin.A - [[0, 1], [-0.75 * G, 0]]).max() < 1e-12
    assert np.abs(lin.B - [[0, 0, 0], [0, 0, -0.75]]).max() < 1e-12
    assert np.abs(lin.D - [[0, 0, 0.25], [1, 0, 0]]).max() < 1e-12
    run = alfmu.simulate(by_rk4(m), 0.5, 0.1, start="equilibrium", inputs={"place": 0.3})
    assert np.ptp(run["rope.angle"]) < 1e-10
    assert np.abs(run["trolley.x"] - 0.3).max() < 1e-12


def test_a_small_run_responds_to_a_signal_as_the_linear_system_does():
    """The load swings on while the trolley goes to and fro by a thousandth of a metre."""
    m, size, times = by_rk4(crane()), 1e-3, np.linspace(0.0, 2.0, 201)
    given = {
        "place": lambda t: size * (1 - np.cos(4 * t)),
        "place_rate": lambda t: 4 * size * np.sin(4 * t),
        "place_acceleration": lambda t: 16 * size * np.cos(4 * t),
    }
    lin = alfmu.linearize(m, "equilibrium", outputs=["rope.angle", "hook.force.x"])
    run = alfmu.simulate(m, 2.0, 0.01, start="equilibrium", inputs=given)
    _, y, _ = lsim(lin.to_scipy(), np.column_stack([f(times) for f in given.values()]), times)
    for name, found in zip(lin.outputs, y.T, strict=True):
        assert np.abs(run[name] - lin.values[name] - found).max() < 1e-3 * np.abs(found).max(), name


def vibrating() -> alfmu.Mechanism:
    """A bar of 1 kg and 1 m on a hinge that goes up and down by 0.1 cos(20 t) m."""
    m = alfmu.Mechanism("vibrating")
    bar = m.bar("bar", mass=1.0, length=1.0)
    at = m.ground.at(0, 0.1 * ca.cos(20 * m.time))
    m.revolute("A", at, bar.start, coordinate=m.coordinate("th", "rad", start=np.pi / 2))
    m.gravity(0, -G)
    return m


def test_along_a_law_of_time_the_equations_are_those_of_the_instant():
    e = by_rk4(vibrating())
    for lin in alfmu.linearize(e, [0.0, 0.04]):
        lifted = G - 40 * np.cos(20 * lin.time)
        assert lin.A[1, 0] == pytest.approx(1.5 * lifted * np.sin(lin.values["th"]), rel=1e-11)
        assert not lin.at_rest


def test_a_law_that_moves_has_no_position_of_rest_and_one_that_stands_still_has():
    with pytest.raises(alfmu.InputError, match="the law of A motion has a rate of 2 and an acceleration of 0"):
        alfmu.equilibrium(crank(lambda t: 2 * t))
    with pytest.raises(alfmu.InputError, match="the law of A motion has a rate of 0 and an acceleration of 1"):
        alfmu.equilibrium(crank(lambda t: 1 - ca.cos(t)))
    with pytest.raises(alfmu.InputError, match=r"bar is carried \(bar.ay = -40 m/s2\) by a law of time"):
        alfmu.equilibrium(vibrating())
    late = crank(lambda t: 0.3 + (t - 1) ** 3)
    rest = alfmu.equilibrium(late, time=1.0).nearest
    with pytest.raises(alfmu.InputError, match="cannot start in a position of rest at t = 1 s"):
        alfmu.simulate(late, 0.1, start=rest)
    assert rest.outputs["A.torque"] == pytest.approx(G / 2 * np.cos(0.3), rel=1e-12)


def test_motions_count_as_constraints_and_singular_positions_on_their_way_are_found():
    """The parallelogram is aligned where its crank is at pi."""
    found = alfmu.mobility(by_rk4(linkage(swing)), stop_time=1.3)
    assert (found.freedom, found.redundant) == (0, 0)
    time = brentq(lambda t: 2 * t + 0.5 * np.sin(t) + 0.3 - np.pi, 0.0, 2.0, xtol=1e-14)
    assert [each.time for each in found.singular] == pytest.approx([time], abs=1e-8)
    assert (found.singular[0].motions, found.singular[0].branches) == (1, ())
    assert "1 motion by a law (A): it counts as a constraint" in found.notes
    assert alfmu.mobility(linkage(swing), time=time).freedom_here == 1
    assert alfmu.mobility(linkage(swing), time=time + 0.1).freedom_here == 0
    with pytest.raises(alfmu.InputError, match="give time or stop_time"):
        alfmu.mobility(linkage(swing), time=time, stop_time=1.0)
    both = alfmu.mobility(linkage(swing, motors="AD"), stop_time=0.0)
    assert [(set(group.rows), group.redundant) for group in both.groups] == [
        ({"B x", "C x", "A motion", "D motion"}, 1)
    ]
    twice = alfmu.Mechanism("twice")
    th, angle = twice.coordinate("th", "rad"), twice.input("angle", "rad")
    bar = twice.bar("bar", mass=1.0, length=1.0)
    twice.revolute("A", twice.ground.at(0, 0), bar.start, coordinate=th)
    twice.motion("A", angle)
    twice.constraint("again", th - twice.input("other", "rad"), "rad")
    assert alfmu.mobility(twice, stop_time=0.0).redundant == 1
    with pytest.raises(alfmu.InputError, match="the input angle cannot change by itself, as other motions"):
        alfmu.linearize(twice)


# Dry friction --------------------------------------------------------------------------------------------------------

MU, R = 0.25, 0.1
"""Coefficient and radius [m] of a journal."""


def journal(angle: float = 0.0, rate: float = 0.0) -> alfmu.Mechanism:
    """A bar of 1 kg and 1 m in a journal that rubs."""
    m, _, A, *_ = hinged("journal", weight=0.0, start=angle, rate=rate, independent=True)
    m.friction(A, coulomb=MU, static=0.35, radius=R)
    m.drive(A, m.input("A.torque", "N.m"))
    m.gravity(0, -G)
    return m


def acceleration(th: mp.mpf, rate: mp.mpf) -> mp.mpf:
    """Of the bar while it slides forwards: the load of the journal contains it, too."""
    g = mp.mpf("9.81")

    def left(a):
        x, y = (-(rate**2) * f / 2 + h * a / 2 for f, h in ((mp.cos(th), -mp.sin(th)), (mp.sin(th), mp.cos(th))))
        load = mp.sqrt(x**2 + (y + g) ** 2)
        return a / 3 + g / 2 * mp.cos(th) + mp.mpf(MU) * mp.mpf(R) * load

    return mp.findroot(left, -15)


def test_a_joint_that_slides_has_the_law_of_its_friction():
    lin = alfmu.linearize(journal(0.2, 1.5), outputs=["A.friction_torque", "bar.angular_acceleration"])
    th, rate = mp.mpf("0.2"), mp.mpf("1.5")
    exact = [mp.diff(lambda x: acceleration(x, rate), th), mp.diff(lambda x: acceleration(th, x), rate)]
    assert lin.A[1] == pytest.approx([float(x) for x in exact], rel=1e-10)
    assert lin.values["bar.angular_acceleration"] == pytest.approx(float(acceleration(th, rate)), rel=1e-12)
    assert lin.frictions == {"A": "slides"}
    assert lin.as_data()["frictions"] == {"A": "slides"}


def test_a_joint_that_sticks_is_held_and_positions_of_rest_are_told_without_friction():
    stuck = alfmu.linearize(journal(-1.55), outputs=["A.friction_torque"])
    assert (stuck.states, stuck.frictions, stuck.at_rest) == ((), {"A": "sticks"}, True)
    assert np.abs(stuck.D - [[-1.0]]).max() < 1e-12
    assert stuck.values["A.friction_torque"] == pytest.approx(G / 2 * np.cos(-1.55), rel=1e-12)
    assert any("held, as long as its load" in note for note in stuck.notes)
    found = alfmu.equilibrium(journal(-1.55))
    assert found.nearest.coordinates["th"] == pytest.approx(-np.pi / 2, abs=1e-12)
    assert found.nearest.frequencies == pytest.approx([np.sqrt(1.5 * G) / (2 * np.pi)], rel=1e-12)
    assert "dry friction is left out (A)" in found.notes[-1]
    at = alfmu.linearize(journal(-1.55), found.nearest)
    assert (at.states, at.frictions) == (("th", "der(th)"), {"A": "left out"})
    assert alfmu.mobility(journal(-1.55), stop_time=0.0).freedom == 1


def test_a_linkage_that_slides_changes_as_the_matrices_say():
    """A slider-crank whose journals and guide rub, each by its own load, by differences of instances."""
    m = alfmu.Mechanism("rubbing")
    arm, rod = m.bar("arm", mass=1.0, length=0.1), m.bar("rod", mass=0.5, length=0.3)
    slider = m.body("slider", mass=0.8, inertia=0.01)
    angle = m.coordinate("angle", "rad", start=0.8, rate=12.0, independent=True)
    A = m.revolute("A", m.ground.at(0, 0), arm.start, coordinate=angle)
    m.revolute("B", arm.end, rod.start, coordinate=m.coordinate("turn", "rad"))
    guide = m.prismatic("guide", m.ground.at(0, 0), slider.at(0, 0), coordinate=m.coordinate("s", "m", start=0.4))
    C = m.revolute("C", rod.end, slider.at(0, 0))
    m.friction(A, coulomb=0.2, radius=0.02)
    m.friction(C, coulomb=0.15, static=0.3, stribeck=2.0, radius=0.01)
    m.friction(guide, coulomb=0.1, length=0.05)
    m.drive(A, m.input("A.torque", "N.m"))
    m.gravity(0, -G)
    e, given = by_rk4(m), {"start.angle": 0.8, "start.angle_rate": 12.0, "A.torque": 0.7}
    lin = alfmu.linearize(e, parameters=given)
    assert set(lin.frictions.values()) == {"slides"}
    checked_by_differences(e, lin, given, list(given), 1e-4)
