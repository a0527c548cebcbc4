"""The flyball governor (IFToMM A05): three minimal coordinates, free bodies, the 10 s of the benchmark, and its FMU."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from oracles import flyball
from oracles.flyball import Governor
from oracles.free_body import SpatialBalance
from scenes import by_rk4, by_the_oracle, derived, evaluate, readings, started
from scipy.spatial.transform import Rotation
from test_spatial import moving

import alfmu
from alfmu.method.singular import BRANCH_MARGIN
from alfmu.simulation import prepared, with_defaults

BENCHMARK = Governor()
STEPS = np.array([2e-4, 1e-4, 5e-5])


@cache
def exact(governor: Governor = BENCHMARK, stop: float = 0.1, rtol: float = 1e-12) -> np.ndarray:
    """phi, al, s, their rates and the work every 0.01 s."""
    return governor.motion(np.linspace(0.0, stop, round(stop / 0.01) + 1), method="DOP853", rtol=rtol)


scene = partial(by_rk4, "flyball_governor")
"""The equations, traced once."""


def simulated(step: float, stop: float = 0.1, **given: float) -> alfmu.Result:
    inputs = {name.replace("_", "."): given.pop(name) for name in ("bearing_torque", "slider_force") if name in given}
    parameters = {"solver.method": "rk4", "solver.step_size": step, **given}
    return alfmu.simulate(scene(), stop, 0.01, parameters=parameters, inputs=inputs)


# The reference --------------------------------------------------------------------------------------------------------


def test_the_reference_is_good_to_1e_12_m():
    """An explicit and an implicit method over 0.5 s, the rows of the table for it, and two tolerances."""
    times = flyball.TIMES[:2]
    found = flyball.heights(times=times)
    for other in (flyball.heights(times=times, method="Radau", rtol=1e-10), flyball.table()[:2, 1]):
        assert np.abs(other - found).max() <= 1e-12
    assert np.abs(exact(rtol=1e-11) - exact())[:, :3].max() <= 1e-14
    assert np.array_equal(flyball.table()[:, 0], flyball.TIMES)


def test_the_reference_keeps_momentum_and_energy():
    """I phi' is constant, and so is the energy less the work of the dampers: to 1e-11 of each."""
    rows = exact()
    momentum = [BENCHMARK.inertia(al)[0] * turn for _, al, _, turn, *_ in rows]
    energy = [BENCHMARK.energy(al, s, rates) - work for _, al, s, *rates, work in rows]
    assert np.ptp(momentum) <= 1e-11 * momentum[0]
    assert np.ptp(energy) <= 1e-11 * energy[0]


# The equations --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_accelerations_at_random_symmetric_states(seed):
    """Shaft, rods and slider, with all dimensions and loads at random, to 1e-11 of the largest of each."""
    random = np.random.default_rng(seed)
    fields = {k: x * random.uniform(0.8, 1.25) for k, x in vars(BENCHMARK).items() if k not in ("torque", "force")}
    governor = Governor(**fields, torque=random.uniform(-50, 50), force=random.uniform(-500, 500))
    turn, al, s, *rates = random.uniform([-3, 0.2, 0.3, -9, -2, -1], [3, 0.9, 0.6, 9, 2, 1])
    start = {"angle": turn, "rod_angle": al, "position": s}
    start |= dict(zip(("angular_velocity", "rod_rate", "velocity"), rates, strict=True))
    given = {**fields, **{f"start.{k}": x for k, x in start.items()}}
    r = readings(
        started(
            derived("flyball_governor"), {**given, "bearing.torque": governor.torque, "slider.force": governor.force}
        )
    )
    names = ["bearing.angular_acceleration", "hinge1.angular_acceleration", "slider.acceleration"]
    want = governor.accelerations(al, s, tuple(rates))
    assert [r[n] for n in names] == pytest.approx(want, rel=1e-11)
    assert r["hinge2.angular_acceleration"] == pytest.approx(want[1], rel=1e-11)
    assert r["monitor.energy"] == pytest.approx(governor.energy(al, s, tuple(rates)), rel=1e-13)


@pytest.mark.parametrize("seed", range(4))
def test_free_bodies_balance_at_random_states_without_symmetry(seed):
    """Rods at different angles: all forces and moments on all four bodies, by the joint reactions that are read."""
    random = np.random.default_rng(seed)
    turn, al1, al2, s = random.uniform([-3, 0.2, 0.2, 0.3], [3, 0.9, 0.9, 0.6])
    w, rate1, rate2, speed = random.uniform(-3, 3, 4)
    b = BENCHMARK
    mass = b.rod + b.m_ball
    center = (b.rod / 2 + b.m_ball) * b.l / mass
    thick, thin = b.rod * (b.l**2 + b.width**2) / 12, b.rod * b.width**2 / 6
    swung = thick + b.rod * (center - b.l / 2) ** 2 + b.m_ball * (b.l - center) ** 2
    up, spin, upright = np.array([0, 0, 1.0]), np.array([0, 0, w]), Rotation.from_rotvec([0, 0, turn])
    parts = [moving([0, 0, b.l / 2], upright, np.zeros(3), spin), moving([0, 0, s], upright, speed * up, spin)]
    for al, rate, side in ((al1, rate1, 0.0), (al2, rate2, np.pi)):
        attitude = upright * Rotation.from_rotvec([0, 0, side]) * Rotation.from_rotvec([0, al, 0])
        hinge = (upright * Rotation.from_rotvec([0, 0, side])).apply([b.pivot, 0, b.l])
        omega, arm = spin + rate * attitude.apply([0, 1, 0]), attitude.apply([center, 0, 0])
        parts.append(moving(hinge + arm, attitude, np.cross(spin, hinge) + np.cross(omega, arm), omega))
    q, v = ([x for part in parts for x in part[k]] for k in (0, 1))
    r = evaluate(derived("flyball_governor"), q, v, [7.0, 30.0])
    cube = b.m_slider * b.side**2 / 6
    bodies = {
        "shaft": (b.rod, (thick, thick, thin), (0, 0, b.l / 2)),
        "slider": (b.m_slider, (cube,) * 3, (0, 0, 0)),
        "rod1": (mass, (thin, swung, swung), (center, 0, 0)),
        "rod2": (mass, (thin, swung, swung), (center, 0, 0)),
    }
    balance = SpatialBalance(r, bodies, (0, 0, -b.g))
    balance.joint("bearing", "ground", "shaft", (0, 0, 0), turn=7.0 * up)
    balance.joint("guide", "shaft", "slider", (0, 0, 0), effort=30.0 * up)
    for i, outward in ((1, 1), (2, -1)):
        balance.joint(f"hinge{i}", "shaft", f"rod{i}", (0, 0, 0))
        foot = (outward * b.side / 2, 0, 0)
        balance.spring((f"rod{i}", (b.l / 2, 0, 0)), ("slider", foot), b.stiffness, b.damping, b.rest)
    assert balance.lack() <= 1e-12
    assert [r["hinge1.angle"], r["hinge2.angle"]] == pytest.approx([al1, al2], rel=1e-13)
    assert [r["hinge1.angular_velocity"], r["slider.velocity"]] == pytest.approx([rate1, speed], rel=1e-12)
    meet = balance.acceleration("rod2", (0, 0, 0)) - balance.acceleration("shaft", (-b.pivot, 0, b.l))
    assert np.abs(meet).max() <= 1e-10


# The motion -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_fourth_order_and_the_exact_motion():
    """0.1 s, in which the springs settle in about 1 ms and the rods begin to rise."""
    errors = []
    for h in STEPS:
        r = simulated(h)
        state = np.array([r[n] for n in ("bearing.angle", "hinge1.angle", "slider.position", "hinge2.angle")])
        errors.append(np.abs(state.T - exact()[:, [0, 1, 2, 1]]).max(axis=0))
        assert r.counters.position_error <= 1e-13
        assert r.counters.unconverged == 0
    slopes = np.polyfit(np.log(STEPS), np.log(errors), 1)[0]
    assert (np.abs(slopes - 4.4) <= 0.5).all(), slopes  # the first step is near the limit of stability
    assert np.max(errors[-1]) <= 1e-12


@pytest.mark.slow
def test_no_regular_position_is_taken_for_a_singular_one():
    """The shaft turns past pi, where one of its Euler parameters has an extremum and so a small pivot."""
    i = started(scene(), {"solver.method": "rk4", "solver.step_size": 2e-4, "start.angle": 3.0})
    judge, small = by_the_oracle(scene(), {"solver.method": "rk4", "solver.step_size": 2e-4, "start.angle": 3.0}), 0
    for k in range(50):
        i.step(1e-3, 1e-3 * k)
        small += int((judge.factor(i.q).diagonal() ** 2 < BRANCH_MARGIN).sum()) > judge.freedom
        assert i.get("monitor.singular") == 0
        assert 0.5 <= i.get("monitor.distance") <= 1.0
    assert small > 0
    assert (i.memory["tally"][1:] == 0).all()  # no step but the quick one


@pytest.mark.slow
def test_none_is_in_a_mechanism_of_many_coordinates():
    """The same among pendulums, with which products of pivots are too small for a number."""
    m = alfmu.load("flyball_governor")
    for k in range(45):
        bob = m.spatial_body(f"bob{k}", mass=1.0, inertia=(0.1, 0.1, 0.1), center=(0, 0, -1), relative=True)
        angle = m.coordinate(f"swing{k}_angle", "rad", start=0.1)
        m.spatial_revolute(f"swing{k}", m.spatial_ground.at(k, 5, 0), bob.at(), axis=(0, 1, 0), coordinate=angle)
    of = prepared(with_defaults(alfmu.derive(m), {"solver.method": "rk4"}))
    i = started(of, {"solver.method": "rk4", "solver.step_size": 2e-4, "start.angle": 3.0})
    judge, small = by_the_oracle(of, {"solver.method": "rk4", "solver.step_size": 2e-4, "start.angle": 3.0}), 0
    for k in range(50):
        i.step(1e-3, 1e-3 * k)
        small += int((judge.factor(i.q).diagonal() ** 2 < BRANCH_MARGIN).sum()) > judge.freedom
        assert i.get("monitor.distance") >= 0.5
        assert judge.margin(i.q)[1] >= 0.25
    assert small > 0
    assert (i.memory["tally"][1:] == 0).all()


@pytest.mark.slow
def test_energy_and_momentum():
    """Energy as by hand, its loss the work of the dampers; the momentum about the shaft stays to 1e-11."""
    r = simulated(1e-4)
    rates = np.array([r[n] for n in ("bearing.angular_velocity", "hinge1.angular_velocity", "slider.velocity")]).T
    al, s = r["hinge1.angle"], r["slider.position"]
    by_hand = [BENCHMARK.energy(*x, tuple(v)) for *x, v in zip(al, s, rates, strict=True)]
    assert r["monitor.energy"] == pytest.approx(by_hand, rel=1e-13)
    assert by_hand[-1] - by_hand[0] == pytest.approx(exact()[-1, 6], abs=1e-8)
    assert exact()[-1, 6] < -1e-3
    assert r.counters.energy_error <= 1e-6
    momentum = [BENCHMARK.inertia(x)[0] * w for x, w in zip(al, rates[:, 0], strict=True)]
    assert np.ptp(momentum) <= 1e-11 * momentum[0]


@pytest.mark.slow
def test_one_second_of_the_benchmark():
    """The slider's height at 0.5 s and 1 s as in the table, at the largest steps that RK4 allows; more than a turn."""
    r = alfmu.simulate(scene(), 1.0, 0.5, parameters={"solver.method": "rk4", "solver.step_size": 3e-4})
    assert r["slider.position"] == pytest.approx(flyball.table()[:3, 1], abs=1e-7)
    assert r["bearing.angle"][-1] == pytest.approx(exact(stop=1.0)[-1, 0], abs=1e-7)
    assert r["bearing.angle"][-1] > np.pi


@pytest.mark.slow
def test_stiffness_times_a_hundred_and_loads():
    """Springs of 8e7 N/m; then a torque on the shaft and a force on the slider."""
    stiff = replace(BENCHMARK, stiffness=8e7)
    r = simulated(1e-4, stiffness=8e7)
    assert r["slider.position"] == pytest.approx(exact(stiff)[:, 2], abs=5e-9)
    loaded = replace(BENCHMARK, torque=20.0, force=100.0)
    r = simulated(1e-4, bearing_torque=20.0, slider_force=100.0)
    assert r["slider.position"] == pytest.approx(exact(loaded)[:, 2], abs=1e-10)
    assert r["bearing.angular_velocity"] == pytest.approx(exact(loaded)[:, 3], abs=1e-10)
    assert r.counters.energy_error <= 1e-6


@pytest.mark.slow
def test_the_limit_of_stability_is_that_of_rk4():
    """2.785 over the largest eigenvalue at the start, 8117 1/s: 3.43e-4 s."""
    largest = np.abs(np.linalg.eigvals(BENCHMARK.slopes(0.0, exact()[0]))).max()
    assert 2.785 / largest == pytest.approx(3.43e-4, rel=0.01)
    below = simulated(0.97 * 2.785 / largest)["slider.position"]
    assert np.abs(below - exact()[:, 2]).max() <= 1e-5
    said = r"flyball_governor, t = .* s: a step of .* opened [\w.]+( \w+)? by .*; reduce solver\.step_size"
    with pytest.raises(alfmu.StepError, match=said):
        simulated(1.06 * 2.785 / largest)


OVER_THE_AXIS = (
    {
        **{"l": 1.05, "width": 0.0133, "density": 4370.0, "m_ball": 20.6, "m_slider": 1.96, "side": 0.103},
        **{"pivot": 0.00732, "stiffness": 4.53e6, "damping": 88700.0, "rest": 0.232, "g": 2.22},
    },
    {
        **{"l": 0.806, "width": 0.0278, "density": 1710.0, "m_ball": 4.25, "m_slider": 4.7, "side": 0.011},
        **{"pivot": 0.0139, "stiffness": 85000.0, "damping": 131000.0, "rest": 0.0547, "g": 47.5},
    },
)
"""Governors whose balls swing so near the axis that nearly nothing is left of the inertia about it."""

SWUNG = (
    {"angle": 0.183, "rod_angle": -2.04, "position": 0.473, "angular_velocity": 0.311, "rod_rate": -0.064},
    {"angle": 0.935, "rod_angle": 0.998, "position": 0.561, "angular_velocity": 0.173, "rod_rate": 3.13},
)
"""Their starts [rad, m, rad/s]."""


@pytest.mark.slow
@pytest.mark.parametrize(("given", "start"), list(zip(OVER_THE_AXIS, SWUNG, strict=True)))
def test_little_inertia_is_no_singular_position(given, start):
    """The shaft turns up to a thousand times as fast for an instant; limits there would be those of another motion."""
    parameters = {**given, **{f"start.{name}": x for name, x in start.items()}}
    r = alfmu.simulate("flyball_governor", 0.2, 0.01, parameters=parameters)
    names = ("angle", "rod_angle", "position", "angular_velocity", "rod_rate")
    motion = Governor(**given).motion(r.time, (*(start[name] for name in names), 0.0), method="DOP853")
    assert np.abs(motion[:, 3]).max() > 50 * abs(start["angular_velocity"])
    assert r["slider.position"] == pytest.approx(motion[:, 2], abs=1e-7)
    assert r["bearing.angle"] == pytest.approx(motion[:, 0], abs=1e-7)


# The FMU, and what is refused -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "says"),
    [({"stiffness": -1.0}, "stiffness"), ({"l": 0.0}, r"\bl\b"), ({"start.position": np.nan}, "position")],
)
def test_bad_numbers_are_refused(given, says):
    with pytest.raises(alfmu.InputError, match=f"flyball_governor.*{says}"):
        started(derived("flyball_governor"), given)
