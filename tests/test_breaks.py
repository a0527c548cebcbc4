"""What jumps or bends by itself in time or by inputs: steps end there, whatever the communication steps are."""

from collections.abc import Callable

import casadi as ca
import fmpy
import numpy as np
import pytest
from scenes import hinged
from scipy.integrate import quad

import alfmu
from alfmu import Mechanism
from alfmu.kernel.complete import complete
from alfmu.model.errors import StepError
from alfmu.simulation import prepared

INERTIA = 1 / 3
"""Of a bar of 1 kg and 1 m about its end."""

METHODS = [
    *({"solver.method": name} for name in ("auto", "stiff", "trapezoidal")),
    *({"solver.method": name, "solver.step_size": 0.02} for name in ("rk4", "order8")),
    *({"solver.method": name, "solver.relative_tolerance": 1e-11} for name in ("auto", "explicit", "stiff")),
]


def bar(torque: Callable[[Mechanism], ca.SX]) -> Mechanism:
    """A bar on a hinge under a torque, without gravity: its rate is the impulse over the inertia."""
    m, _, hinge, *_ = hinged("bar", bar="b", weight=0.0, independent=True)
    m.drive(hinge, torque(m))
    return m


def pulse(m: Mechanism) -> ca.SX:
    width = m.parameter("width", 0.005, "s")
    return ca.if_else(ca.fabs(m.time - 1.2345) < width / 2, 1 / width, 0.0)


@pytest.mark.parametrize("settings", METHODS, ids=lambda x: "-".join(map(str, x.values())))
@pytest.mark.parametrize("width", [0.1, 0.005, 1e-5])
def test_no_pulse_is_stepped_over(settings, width):
    """All of 5 ms were, between communication points of 0.1 s; those of 0.1 s ended runs at 1e-9."""
    r = alfmu.simulate(bar(pulse), 3.0, 0.1, parameters={**settings, "width": width})
    assert r["b.angular_velocity"][-1] == pytest.approx(1 / INERTIA, rel=1e-8)


def test_pulses_are_where_they_were_declared():
    """Pulse trains, within others, of sines, at communication points, and that parameters move: against their sums."""

    def torque(m: Mechanism) -> ca.SX:
        t, begin = m.time, m.parameter("begin", 0.7, "s")
        train = ca.if_else(ca.fmod(t, 0.01) < 0.001, 2.0, 0.0)  # 0.2 N.m in the mean
        within = ca.if_else(
            ca.logic_and(t > begin, t < begin + 0.25), ca.if_else(ca.fmod(t, 0.05) < 0.01, 1.0, 0.0), 0.0
        )
        waves = ca.if_else(ca.sin(2 * ca.pi * 5 * t) > 0.999, 3.0, 0.0)
        table = ca.pw_const(t, ca.DM([0.25, 0.5, 0.75]), ca.DM([0.0, 1.0, -2.0, 0.5]))
        steps = 0.1 * ca.floor(4 * t)
        return train + within + waves + table + steps

    r = alfmu.simulate(bar(torque), 1.0, 0.25, parameters={"solver.relative_tolerance": 1e-10, "begin": 0.7})
    of_train, of_within = 100 * 2.0 * 0.001, 5 * 0.01
    of_waves = 3.0 * 5 * (np.pi - 2 * np.arcsin(0.999)) / (2 * np.pi * 5)
    impulse = of_train + of_within + of_waves + 0.25 * (1.0 - 2.0 + 0.5) + 0.1 * 0.25 * (0 + 1 + 2 + 3)
    assert r["b.angular_velocity"][-1] == pytest.approx(impulse / INERTIA, rel=1e-9)


def test_inputs_that_change_in_a_step_break_there():
    """An input that an importer interpolates passes a narrow window."""
    m = bar(lambda m: ca.if_else(ca.fabs(m.input("u", "1") - 0.5) < 0.005, 100.0, 0.0))
    unit = alfmu.Instance(alfmu.derive(m))
    unit.initialize()
    for k in range(10):
        unit.set("u", 0.1 * k + 0.03)
        unit.slope("u", 1.0)
        unit.step(0.1)
    assert unit.get("b.angular_velocity") == pytest.approx(100 * 0.01 / INERTIA, rel=1e-8)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("method", ["auto", "rk4"])
def test_inputs_that_are_extrapolated_break_there(order, method):
    """The window passed unseen: extrapolation was in the steps alone."""
    unit = alfmu.Instance(alfmu.derive(bar(lambda m: ca.if_else(ca.fabs(m.input("u", "1") - 0.5) < 0.005, 100.0, 0.0))))
    for name, value in {"solver.input_order": order, "solver.method": method, "solver.step_size": 0.02}.items():
        unit.set(name, value)
    unit.initialize()
    for k in range(10):
        unit.set("u", 0.1 * k + 0.03)
        unit.step(0.1)
    assert unit.get("b.angular_velocity") == pytest.approx(100 * 0.01 / INERTIA, rel=1e-8)


@pytest.mark.parametrize("settings", [{}, {"solver.relative_tolerance": 1e-10}])
def test_smooth_pulses_are_met(settings):
    """Bells are found at their middle; anything else where an event is declared."""

    def bell(m: Mechanism) -> ca.SX:
        x = (m.time - 0.456) / 1e-4
        return ca.exp(-(x**2) / 2) + 1 / (1 + ((m.time - 0.856) / 1e-4) ** 4)

    def other(m: Mechanism) -> ca.SX:
        at = m.parameter("at", 0.3, "s")
        m.event(at)
        return ca.exp(1e6 * (ca.cos(m.time - at) - 1))

    of_bells = 1e-4 * (np.sqrt(2 * np.pi) + quad(lambda x: 1 / (1 + x**4), -np.inf, np.inf)[0])
    of_other = quad(lambda x: np.exp(1e6 * (np.cos(x) - 1)), -0.02, 0.02, epsabs=1e-14)[0]
    for torque, impulse in ((bell, of_bells), (other, of_other)):
        given = settings | ({"at": 0.654} if torque is other else {})
        r = alfmu.simulate(bar(torque), 1.0, 0.5, parameters=given)
        assert r["b.angular_velocity"][-1] == pytest.approx(impulse / INERTIA, rel=1e-4)


def test_states_have_their_breaks():
    """A square wave on a first-order lag, against its closed form."""
    m = bar(lambda m: ca.SX(0))
    x = m.state("x", "1")
    m.derivative(x, (ca.if_else(ca.fmod(m.time, 0.02) < 0.01, 1.0, 0.0) - x) / 0.05)
    value = 0.0
    for k in range(100):
        value = (k % 2 == 0) + (value - (k % 2 == 0)) * np.exp(-0.01 / 0.05)
    r = alfmu.simulate(m, 1.0, 0.5, parameters={"solver.relative_tolerance": 1e-10})
    assert r["x"][-1] == pytest.approx(value, rel=1e-8)


def cart(law: Callable[[Mechanism], ca.SX]) -> Mechanism:
    """A bar that hangs on a cart which follows a law, without gravity."""
    m = Mechanism("cart")
    body, rod = m.body("cart", mass=2.0), m.bar("rod", mass=1.0, length=1.0)
    guide = m.prismatic("G", m.ground.at(0, 0), body.at(0, 0), coordinate=m.coordinate("s", "m"))
    m.revolute("H", body.at(0, 0), rod.start, coordinate=m.coordinate("th", "rad", start=1.0, independent=True))
    m.motion(guide, law(m))
    return m


WIDTH, MIDDLE = 0.0025, 0.503


def test_a_law_that_jumps_and_comes_back_is_found():
    """It was not, where both were within a communication step."""

    def law(m: Mechanism) -> ca.SX:
        return m.parameter("size", 0.0, "m") * ca.if_else(ca.fabs(m.time - MIDDLE) < WIDTH, 1.0, 0.0)

    with pytest.raises(StepError, match=r"the motion of G jumps by 0.01 m at t = 0.5005 s"):
        alfmu.simulate(cart(law), 1.0, 0.1, parameters={"size": 0.01})


def test_rates_of_laws_that_jump_are_impacts_at_their_times(caplog):
    """A triangle: three impacts, between which the rod turns evenly; the first stretch had the rates before each."""

    def law(m: Mechanism) -> ca.SX:
        return m.parameter("size", 0.0, "m") * ca.fmax(0, 1 - ca.fabs(m.time - MIDDLE) / WIDTH)

    r = alfmu.simulate(cart(law), 1.0, 0.1, parameters={"size": 0.01})
    th, rate, jump = 1.0, 0.0, 0.01 / WIDTH
    for change, length in ((jump, WIDTH), (-2 * jump, WIDTH), (jump, 0.5 - 0.003 - WIDTH)):
        rate += 1.5 * np.sin(th) * change  # m L/2 sin(th)/(m L^2/3)
        th += rate * length
    assert r["rod.angular_velocity"][-1] == pytest.approx(rate, abs=1e-9)
    assert r["rod.angle"][-1] == pytest.approx(th, abs=1e-9)
    assert r.counters.run_error < 1e-6
    assert "changes its rate by 4 m/s at t = 0.5005 s" in caplog.text


@pytest.mark.slow
def test_accelerations_of_laws_that_jump_end_no_run():
    """Explicit steps at 1e-9 ended at 0.5 s. Against the rod on the two pieces, to a tighter tolerance."""

    def law(m: Mechanism, middle: float = 0.5) -> ca.SX:
        t = m.time
        return ca.if_else(t < middle, 2 * t**2, 0.5 + 2 * (t - 0.5) - 3 * (t - 0.5) ** 2)

    found = []
    for method, tolerance in (("explicit", 1e-9), ("auto", 1e-10), ("stiff", 1e-10), ("explicit", 1e-12)):
        settings = {"solver.method": method, "solver.relative_tolerance": tolerance}
        found.append(alfmu.simulate(cart(law), 0.7, 0.025, parameters=settings)["rod.angle"][-1])
    assert np.ptp(found) < 1e-9


@pytest.mark.parametrize("settings", METHODS[-3:], ids=lambda x: "-".join(map(str, x.values())))
def test_jumps_by_the_motion_are_crossed(settings):
    """A torque that turns round where the bar passes an angle: parabolas; tight runs ended there."""

    def turns_round(m: Mechanism) -> ca.SX:
        return ca.if_else(m.coordinates[0].q > 0.3, -5.0, 5.0)

    m = bar(turns_round)
    r = alfmu.simulate(m, 2.0, 0.1, parameters={**settings, "start.th_rate": 1.0})
    passes = np.sqrt(1 + 2 * 15 * 0.3)
    left = 2.0 - (passes - 1) / 15
    left -= left // (2 * passes / 15) * (2 * passes / 15)
    turned = int((2.0 - (passes - 1) / 15) // (2 * passes / 15))
    side = 1 if turned % 2 == 0 else -1
    assert r["b.angle"][-1] == pytest.approx(0.3 + side * (passes * left - 7.5 * left**2), abs=1e-9)


def test_what_chatters_still_ends_a_run():
    m = bar(lambda m: ca.if_else(m.coordinates[0].v > 0.0, -5.0, 5.0))
    settings = {"solver.method": "explicit", "solver.relative_tolerance": 1e-10, "start.th_rate": 1.0}
    with pytest.raises(StepError, match="no step however short meets the tolerance"):
        alfmu.simulate(m, 1.0, 0.1, parameters=settings)
    m = bar(lambda m: ca.if_else(m.coordinates[0].v > 0.0, -5.0, 5.0))
    m.end_stop("stop", m.coordinates[0].q, upper=9.0, stiffness=1e3, unit="rad")
    with pytest.raises(StepError, match="by its option limits=ignore, or start within them, by limits=inside"):
        alfmu.simulate(m, 1.0, 0.1, parameters=settings)


@pytest.mark.parametrize(("kind", "fmi"), [("python", 2), ("native", 2), ("native", 3)])
def test_every_kind_of_fmu_meets_them(kind, fmi, tmp_path):
    path = alfmu.export(bar(pulse), tmp_path / "pulse.fmu", kind=kind, fmi=fmi)
    found = fmpy.simulate_fmu(str(path), stop_time=3.0, output_interval=0.1, output=["b.angular_velocity"])
    assert found["b.angular_velocity"][-1] == pytest.approx(1 / INERTIA, rel=1e-8)


def test_the_oracle_meets_them():
    settings = {"solver.method": "rk4", "solver.step_size": 0.02}
    r = alfmu.simulate(bar(pulse), 3.0, 0.1, parameters=settings, kernel="oracle")
    assert r["b.angular_velocity"][-1] == pytest.approx(1 / INERTIA, rel=1e-8)


def test_too_many_are_refused():
    with pytest.raises(StepError, match="have more than 4096 jumps or kinks up to 1 s; take shorter"):
        alfmu.simulate(bar(lambda m: ca.floor(1e5 * m.time)), 1.0, 1.0)


def test_what_has_none_carries_nothing():
    """Forces of contacts, and of inputs and time without a break."""

    def smooth(m: Mechanism) -> ca.SX:
        return ca.sin(m.time) * m.input("u", "N.m") + m.time**2 - ca.fmax(m.coordinates[0].q, 0.0)

    own = complete(prepared(alfmu.derive(bar(smooth))))
    assert not own.breaks
    assert "breaks" not in own.functions


@pytest.mark.parametrize(
    ("law", "end"),
    [
        (lambda m: ca.sqrt(0.05 - m.time), 0.05),
        (lambda m: ca.log(0.3 - m.coordinates[0].q), 0.3 / 2.0),
    ],
    ids=["time", "angle"],
)
@pytest.mark.parametrize("method", ["auto", "stiff", "rk4"])
def test_a_force_that_ends_in_the_midst_of_a_run_is_named_instead_of_the_tolerance(law, end, method):
    """A root of less than zero: no tolerance helps."""
    m = bar(lambda m: 1e-6 * law(m))
    with pytest.raises(StepError, match="are not finite from here on; check roots, logarithms") as caught:
        alfmu.simulate(m, 0.5, 0.02, parameters={"start.th_rate": 2.0, "solver.method": method})
    away = 0.0101 if method == "rk4" else 1e-4  # a step
    assert float(str(caught.value).split("t = ")[1].split(" s")[0]) == pytest.approx(end, abs=away)
