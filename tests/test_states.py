"""States: first-order equations integrated with the motion, by every method, with and without constraints."""

import copy
import math
import pickle
from functools import cache

import casadi as ca
import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Slave
from oracles.adaptive import by_method
from oracles.motors import Circuit, crank, linear, parallelogram
from oracles.parallelogram import Parallelogram
from scenes import initialized, made

import alfmu
from alfmu import DeclarationError, Mechanism
from alfmu.fmi.recipe import of
from alfmu.kernel.memory import PACE
from alfmu.model.settings import FIXED, METHODS
from alfmu.simulation import prepared, with_defaults
from alfmu.studies.about import About, about, in_short

MOTOR = Circuit()
START = 0.4
"""Angle of the crank at the start [rad]."""


def with_motor(m: Mechanism, joint: str, speed: ca.SX) -> Mechanism:
    """A mechanism with a motor on a joint, whose current is a state."""
    R, L = m.parameter("R", MOTOR.R, "Ohm"), m.parameter("L", MOTOR.L, "H")
    voltage = m.input("voltage", "V", start=MOTOR.u)
    i = m.state("motor.current", "A", description="current of the motor")
    m.derivative(i, (voltage - R * i - MOTOR.k * speed) / L)
    m.drive(next(j for j in m.joints if j.name == joint), MOTOR.k * i)
    m.output("motor.torque", MOTOR.k * i, "N.m")
    return m


def driven(name: str, **options: str) -> Mechanism:
    """A registered mechanism with a motor on its first link."""
    m = alfmu.load(name, **options)
    angle = next(c for c in m.coordinates if c.name == "th1")
    return with_motor(m, "A", m.rate(angle.q))


def flywheel() -> Mechanism:
    """A motor on a flywheel of 0.2 kg m2 with a viscous bearing."""
    m = Mechanism("flywheel")
    angle = m.coordinate("angle", "rad", independent=True)
    wheel = m.body("wheel", mass=1.0, inertia=0.2)
    bearing = m.revolute("A", m.ground.at(), wheel.at(), coordinate=angle)
    m.friction(bearing, 0.03)
    return with_motor(m, "A", m.rate(angle))


def circuit(nominal: float = 1.0) -> Mechanism:
    """A coil on a voltage: a state alone."""
    m = Mechanism("circuit")
    R, L = m.parameter("R", MOTOR.R, "Ohm"), m.parameter("L", MOTOR.L, "H")
    voltage = m.input("voltage", "V", start=MOTOR.u)
    i = m.state("current", "A", start=2.0, nominal=nominal)
    m.derivative(i, (voltage - R * i) / L)
    return m


def natural() -> Mechanism:
    """The slider-crank in natural coordinates, the speed of whose crank is that of a computed angle."""
    m = alfmu.load("slider_crank", coordinates="natural")
    x, y = m.coordinates[:2]
    return with_motor(m, "A", (x.q * y.v - y.q * x.v) / 0.5**2)


MECHANISMS = {
    "flywheel": flywheel,
    "circuit": circuit,
    "slider_crank": lambda: driven("slider_crank", coordinates="mixed"),
    "natural": natural,
    "five_bar": lambda: driven("five_bar"),
}


@cache
def equations(name: str) -> alfmu.Equations:
    return alfmu.derive(MECHANISMS[name]())


@cache
def scene(name: str, method: str, kernel: str = "vm", order: int = 0) -> alfmu.Equations:
    given = {"solver.method": method, "solver.input_order": order}
    return prepared(with_defaults(equations(name), given), kernel)


def begun(name: str, method: str, kernel: str = "vm", order: int = 0, **given: float | str) -> alfmu.Instance:
    """An initialised instance; names of variables with two underscores for the point."""
    return initialized(made(scene(name, method, kernel, order), kernel), **given)


# Against closed forms and other methods ---------------------------------------------------------------------------


def flywheel_at(t: float) -> np.ndarray:
    """Angle, speed, current."""
    R, L, k, J, b = MOTOR.R, MOTOR.L, MOTOR.k, 0.2, 0.03
    matrix = np.array([[0, 1, 0], [0, -b / J, k / J], [0, -k / L, -R / L]])
    return linear(matrix, np.array([0, 0, MOTOR.u / L]), np.zeros(3), t)


BOUNDS = {"rk4": 1e-6, "trapezoidal": 1e-2, "generalized_alpha": 2e-2, "order8": 1e-11, "auto": 1e-6}
"""Largest error of a step of 5 ms, or of the default tolerance; 1e-9 of the others."""


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["flywheel", "circuit"])
def test_every_method_keeps_the_closed_form(name, method):
    """A motor with a flywheel: matrix exponential; a coil: u / R + (i0 - u / R) exp(-R t / L)."""
    i = begun(name, method, solver__step_size=5e-3)
    for _ in range(20):
        i.step(0.025)
    current = MOTOR.u / MOTOR.R + (2.0 - MOTOR.u / MOTOR.R) * math.exp(-MOTOR.R * 0.5 / MOTOR.L)
    expected = flywheel_at(0.5) if name == "flywheel" else np.array([0.0, 0.0, current])
    found = np.concatenate([i.q, i.v, i.states])
    assert np.abs(found - expected).max() <= BOUNDS.get(method, 1e-9) * np.abs(expected).max()
    shown = "current" if name == "circuit" else "motor.current"
    assert i.get(shown) == i.states[0]
    if method not in FIXED:
        assert i.counters.run_error <= 1e-6


@pytest.mark.parametrize(("method", "order"), [("rk4", 4), ("trapezoidal", 2), ("generalized_alpha", 2)])
def test_the_order_of_a_method_is_that_of_its_states(method, order):
    errors = []
    for step in (0.01, 0.005, 0.0025):
        i = begun("flywheel", method, solver__step_size=step)
        i.step(0.25)
        errors.append(abs(i.states[0] - flywheel_at(0.25)[2]))
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert slopes == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize(
    ("name", "method"), [("slider_crank", "explicit"), ("slider_crank", "stiff"), ("natural", "explicit")]
)
def test_a_loop_with_a_motor(name, method):
    """Against SciPy on the crank's angle alone."""
    i = begun(name, method, start__angle=START, solver__relative_tolerance=1e-10)
    times = np.linspace(0.0, 1.5, 7)
    expected = crank(MOTOR, START, 0.0, times)
    for row in expected[1:]:
        i.step(0.25)
        found = i.get("crank.angle"), i.get("crank.angular_velocity"), i.get("motor.current")
        assert found == pytest.approx(row, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("method", ["rk4", "explicit"])
def test_through_singular_positions_with_redundancy(method):
    """The five-bar starts at one, with one redundant constraint, and its motor takes it through others."""
    i = begun("five_bar", method, start__angle=0.0, start__angular_velocity=2.0, solver__step_size=0.005)
    bar = Parallelogram()
    times = np.linspace(0.0, 2.0, 9)
    expected = parallelogram(MOTOR, float(bar.inertia), float(bar.weight), 0.0, 2.0, times)
    assert np.ptp(np.floor(expected[:, 0] / math.pi)) >= 1  # others are passed
    bound = 1e-6
    for row in expected[1:]:
        i.step(0.25)
        found = i.get("link1.angle"), i.get("link1.angular_velocity"), i.get("motor.current")
        assert found == pytest.approx(row, rel=bound, abs=bound)


# Against the readable forms ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "method", "bound"),
    [
        ("slider_crank", "explicit", 1e-12),
        ("slider_crank", "stiff", 1e-10),
        ("five_bar", "stiff", 1e-10),
        ("slider_crank", "trapezoidal", 1e-9),
        ("slider_crank", "generalized_alpha", 1e-9),
    ],
)
def test_a_step_is_that_of_the_readable_form(name, method, bound):
    """From the same state with the same length: q, v, states, work, and the error of the step."""
    start, length = {"start__angle": 0.5}, 0.01
    kernel = begun(name, method, solver__step_size=length, **start)
    adaptive = by_method(begun(name, "rk4", "oracle", **start), method)
    fixed = method in FIXED
    adaptive.fixed = length if fixed else None
    for _ in range(2):
        t, y = kernel.time, (kernel.q.copy(), kernel.v.copy(), kernel.work, kernel.states.copy())
        if not fixed:
            kernel.memory["pace"][PACE.index("dt")] = length
        kernel.step(length)
        adaptive.place(t, *y)
        q, v, x, work, _, _, error = adaptive.step(length)
        found = np.concatenate([kernel.q, kernel.v, kernel.states, [kernel.work]])
        expected = np.concatenate([q, v, x, [work]])
        assert np.abs(found - expected).max() <= bound * (1 + np.abs(expected).max())
        if not fixed:
            assert kernel.memory["after"][kernel.layout.change] == pytest.approx(error, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize(
    "given", [{}, {"solver__max_iterations": 4.0, "solver__penalty": 1e5}], ids=["quick", "patient"]
)
def test_rk4_is_that_of_the_oracle(given):
    """By the unrolled programs, and by those whose loops stop on convergence."""
    runs = [begun("slider_crank", "rk4", kernel, start__angle=START, **given) for kernel in ("vm", "oracle")]
    for i in runs:
        for _ in range(5):
            i.step(0.02)
    vm, oracle = runs
    assert vm.states[0] > 1.0
    assert vm.states == pytest.approx(oracle.states, rel=1e-10)
    counted = [v.name for v in vm.outputs].index("monitor.iterations")  # which each decides by itself
    assert np.delete(vm.read(), counted) == pytest.approx(np.delete(oracle.read(), counted), rel=1e-6, abs=1e-7)
    assert bool(given) == bool(vm.counters.patient)


def test_what_is_read_at_a_singular_position_is_that_of_the_oracle():
    """Limits of accelerations and reactions, with a torque that a state makes."""
    given = {"start__angle": 0.0, "start__angular_velocity": 2.0, "start__motor__current": 3.0}
    vm, oracle = (begun("five_bar", "rk4", kernel, **given) for kernel in ("vm", "oracle"))
    assert vm.get("monitor.singular") >= 1
    without = begun("five_bar", "rk4", **{**given, "start__motor__current": 0.0})
    name = "link1.angular_acceleration"
    bar = Parallelogram()
    assert vm.get(name) - without.get(name) == pytest.approx(MOTOR.k * 3.0 / float(bar.inertia), rel=1e-6)
    counted = [v.name for v in vm.outputs].index("monitor.iterations")
    assert np.delete(vm.read(), counted) == pytest.approx(np.delete(oracle.read(), counted), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("formulation", ["classic", "penalty", "dae"])
def test_other_formulations(formulation):
    given = {"start__angle": START, "solver__step_size": 0.002}
    runs = [begun("slider_crank", "rk4", solver__formulation=each, **given) for each in ("residual", formulation)]
    for i in runs:
        i.step(0.2)
    own, other = runs
    assert other.states == pytest.approx(own.states, rel=1e-5)


def test_both_kernels_make_the_same_run():
    runs = [begun("flywheel", "stiff", kernel) for kernel in ("vm", "compiled")]
    for i in runs:
        i.step(0.5)
    assert runs[0].read() == pytest.approx(runs[1].read(), rel=1e-9, abs=1e-9)


# Inputs, states that are saved, energy ----------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["rk4", "explicit", "stiff"])
def test_inputs_that_are_extrapolated_reach_the_rates(method):
    """A voltage that rises evenly: i = a t / R - a L / R^2 (1 - exp(-R t / L)), from the second step on."""
    i = begun("circuit", method, order=1, start__current=0.0, voltage=0.0, solver__step_size=0.002)
    R, L, slope, h = MOTOR.R, MOTOR.L, 100.0, 0.02
    i.step(h)  # at no voltage: the ramp begins at its end, and one point does not tell it
    i.set("voltage", 0.0)
    held = i.states.copy()
    assert held == pytest.approx(0.0, abs=1e-15)
    for k in range(1, 6):
        i.set("voltage", slope * (k - 1) * h)
        i.step(h)
    # The first of these steps holds the voltage at 0, the second one knows 0 and 0 at its begin, the others the slope.
    rest = 3 * h

    def after(i0: float, u0: float, t: float, rate: float) -> float:
        settled = u0 / R - rate * L / R**2
        return settled + rate * t / R + (i0 - settled) * math.exp(-R * t / L)

    second = after(0.0, slope * h, h, slope)
    expected = after(second, 2 * slope * h, rest, slope)
    assert i.get("current") == pytest.approx(expected, rel=1e-6)


def test_an_instance_belongs_to_its_process():
    for put in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(
            alfmu.InputError, match="five_bar: an instance can be neither pickled nor copied; make one in"
        ):
            put(alfmu.Instance("five_bar"))


def test_a_saved_state_goes_on_with_the_same_bits():
    i = begun("slider_crank", "stiff", start__angle=START)
    i.step(0.1)
    state = i.save()
    i.step(0.1)
    expected = i.read().copy(), i.states.copy()
    i.restore(state)
    assert i.states != pytest.approx(expected[1], rel=1e-6)
    i.step(0.1)
    assert np.array_equal(i.read(), expected[0])
    assert np.array_equal(i.states, expected[1])


def test_a_step_that_fails_leaves_the_states():
    m = Mechanism("runaway")
    x = m.state("x", "1", start=1.0)
    m.derivative(x, x**2)  # infinite at 1 s
    i = initialized(alfmu.Instance(m))
    i.step(0.5)
    before = i.states.copy()
    assert before == pytest.approx(2.0, rel=1e-5)
    with pytest.raises(alfmu.StepError, match="runaway"):
        i.step(1.0)
    assert np.array_equal(i.states, before)


def test_forces_by_states_are_work_from_outside():
    """The work is that of the torque: what it adds to the energy of the motion, and what the bearing takes."""
    i = begun("flywheel", "explicit", solver__relative_tolerance=1e-10)
    i.step(0.5)
    assert i.get("monitor.energy") == pytest.approx(0.2 * i.v[0] ** 2 / 2, rel=1e-12)
    assert i.get("monitor.work") == pytest.approx(i.get("monitor.energy"), rel=1e-9)


def test_what_follows_inputs_at_once():
    """Neither a state nor what depends on it does; accelerations follow forces alone."""
    outputs = {v.name: v for v in equations("flywheel").outputs}
    assert not outputs["motor.current"].instant
    assert not outputs["motor.torque"].instant
    assert not any(v.instant for v in equations("circuit").outputs)
    m = flywheel()
    m.output("demand", m.inputs[0].symbol * m.states[0].symbol, "1")
    e = alfmu.derive(m)
    assert next(v for v in e.outputs if v.name == "demand").instant


def test_frozen_parameters_and_chosen_outputs():
    from alfmu.equations.specialisation import specialised

    i = alfmu.Instance(specialised(equations("flywheel"), ["motor.*"], ["all"]))
    assert [v.name for v in i.outputs] == ["motor.current", "motor.torque"]
    assert "R" not in [v.name for v in i.parameters]
    initialized(i, {"start.motor.current": 1.5})
    assert i.get("motor.torque") == pytest.approx(MOTOR.k * 1.5)
    i.step(0.5)
    assert i.get("motor.current") > 1.5


# Step sizes ---------------------------------------------------------------------------------------------------------


def quick(method: str) -> alfmu.Instance:
    """The slider-crank with a motor whose electrical time constant is 1e-5 s."""
    return begun("slider_crank", method, start__angle=START, L=1e-5)


def test_states_that_decay_quickly():
    """`auto` says that the scene is stiff and takes few steps; the motion is that of a current without delay."""
    e = prepared(with_defaults(equations("slider_crank"), {"L": 1e-5}), "vm")
    assert e.decision.method == "stiff"
    assert "1e+05" in e.decision.reason
    i = initialized(alfmu.Instance(e), {"start.angle": START})
    for _ in range(5):
        i.step(0.1)
    assert i.counters.steps < 200
    settled = (MOTOR.u - MOTOR.k * i.get("crank.angular_velocity")) / MOTOR.R
    assert i.get("motor.current") == pytest.approx(settled, abs=1e-3)
    assert type(equations("slider_crank")) is alfmu.Equations  # decided by the defaults of each scene


def test_the_nominal_value_is_the_scale_of_small_states(caplog):
    """A filling of a millionth of a cubic metre is kept to its tolerance where its nominal value says what it is."""

    def filling(nominal: float) -> float:
        m = Mechanism("vessel")
        x = m.state("filling", "m3", nominal=nominal)
        m.derivative(x, 1e-6 * ca.cos(40 * m.time) - 5 * x)
        run = alfmu.simulate(m, 2.0, 2.0, parameters={"solver.method": "explicit"})
        w, a, t = 40.0, 5.0, 2.0
        exact = 1e-6 * (a * math.cos(w * t) + w * math.sin(w * t) - a * math.exp(-a * t)) / (a**2 + w**2)
        return abs(run["filling"][-1] - exact) / (1e-6 / w)

    assert filling(1e-7) < 1e-5
    assert not caplog.text
    assert filling(1.0) > 1e-3  # its scale is another one then
    assert "the state filling reached" in caplog.text
    assert "nominal value 1 m3; give nominal= in state()" in caplog.text


def test_what_there_is_to_know_names_states():
    """In short, and as data; a mechanism of states alone has no coordinate and no freedom."""

    def known(m: Mechanism) -> About:
        recipe = of(m)
        return about(recipe, m, alfmu.derive(m))

    alone = known(circuit())
    assert "states (1): current [A]" in in_short(alone)
    assert "coordinates (0): none" in in_short(alone)
    assert "degrees of freedom: 0, redundant constraints: 0" in in_short(alone)
    data = alone.as_data()
    assert (data["coordinates"], data["degrees_of_freedom"]) == ([], 0)
    assert [(x["name"], x["unit"], x["start"]) for x in data["states"]] == [("current", "A", 2.0)]
    assert not alone.notes
    assert "at the start: start.angle = 0 rad, start.angle_rate = 0 rad/s, start.motor.current = 0 A" in in_short(
        known(flywheel())
    )


# FMUs ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "fmi"), [("python", 2), ("native", 2), ("native", 3)])
def test_an_fmu_has_states(kind, fmi, tmp_path):
    """Its start is a parameter, it is an output with its unit and nominal value, and it moves as an instance."""
    path = alfmu.export(circuit(nominal=5.0), tmp_path / "circuit.fmu", kind=kind, fmi=fmi)
    known = {v.name: v for v in read_model_description(str(path)).modelVariables}
    start, current = known["start.current"], known["current"]
    assert (start.causality, start.unit, float(start.start)) == ("parameter", "A", 2.0)
    assert (current.causality, current.unit, float(current.nominal)) == ("output", "A", 5.0)
    given = {"start.current": 4.0, "voltage": 6.0}
    table = simulate_fmu(str(path), stop_time=0.1, output_interval=0.01, start_values=given, output=["current"])
    expected = 6.0 - 2.0 * np.exp(-table["time"] / 0.05)
    assert table["current"] == pytest.approx(expected, rel=1e-6)


def test_derivatives_of_a_native_fmu(tmp_path):
    """An input goes on by its derivative inside a step; outputs follow inputs by accelerations, not by states."""
    m = flywheel()
    m.drive(m.joints[0], m.input("torque", "N.m"))
    path = alfmu.export(m, tmp_path / "flywheel.fmu", kind="native", fmi=2)
    description = read_model_description(str(path))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    fmu = FMU2Slave(
        guid=description.guid,
        unzipDirectory=extract(str(path)),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="flywheel",
    )
    fmu.instantiate()
    fmu.setReal([reference["voltage"]], [0.0])
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    of = [reference[name] for name in ("wheel.angular_acceleration", "motor.torque")]
    by_torque = fmu.getDirectionalDerivative(of, [reference["torque"]], [1.0])
    by_voltage = fmu.getDirectionalDerivative(of, [reference["voltage"]], [1.0])
    assert list(by_torque) == pytest.approx([1 / 0.2, 0.0], rel=1e-9)
    assert list(by_voltage) == pytest.approx([0.0, 0.0], abs=1e-12)
    fmu.setRealInputDerivatives([reference["voltage"]], [1], [100.0])
    fmu.doStep(0.0, 0.1)
    R, L, k, J, b = MOTOR.R, MOTOR.L, MOTOR.k, 0.2, 0.03
    matrix = np.array([[-b / J, k / J, 0], [-k / L, -R / L, 1 / L], [0, 0, 0]])
    expected = linear(matrix, np.array([0.0, 0.0, 100.0]), np.zeros(3), 0.1)
    found = fmu.getReal([reference["motor.current"], reference["voltage"]])
    assert found == pytest.approx(expected[1:], rel=1e-6)
    fmu.terminate()
    fmu.freeInstance()


# Declarations that make no sense ------------------------------------------------------------------------------------


def other() -> ca.SX:
    return Mechanism("other").state("x", "1", 0.0)


WRONG = {
    "no rate": (lambda m, x: None, r"the state x has no rate .*, line .*give one"),
    "two rates": (lambda m, x: [m.derivative(x, 1.0), m.derivative(x, 2.0)], "x has a rate already"),
    "a rate of nothing": (lambda m, x: m.derivative(m.coordinates[0].q, 1.0), "th is not a state of this mechanism"),
    "a number": (lambda m, x: m.derivative(3.0, 1.0), "3.0 is not a state"),
    "an acceleration": (
        lambda m, x: m.derivative(x, m.acceleration(m.coordinates[0].q)),
        "the rate of x depends on the acceleration of th; it must be a number or an expression in .*states and time",
    ),
    "a foreign state": (lambda m, x: m.derivative(x, other()), "the rate of x depends on x, which this mechanism does"),
    "not finite": (lambda m, x: m.derivative(x, math.nan), "the rate of x is nan; give a finite number"),
    "a unit": (
        lambda m, x: m.derivative(x, m.parameter("c", 1.0, "A")),
        "x is in A per second, and the parameter c in A",
    ),
    "a name": (lambda m, x: m.state("x", "A", 0.0), "'x' is a state already"),
    "an unknown unit": (lambda m, x: m.state("y", "Amp", 0.0), "y: unknown unit 'Amp'"),
    "a nominal value": (lambda m, x: m.state("y", "A", 0.0, nominal=0.0), "the nominal value of y is 0 A; give"),
    "a start": (lambda m, x: m.state("y", "A", 0.0, start=x), "start.y is an expression; give a number"),
    "a place": (lambda m, x: m.body("b", mass=1.0, pose=(x, 0.0, 0.0)), "the pose of b depends on the state x"),
    "a mass": (lambda m, x: m.body("b", mass=x), "the mass of b depends on the state x"),
    "a derived name": (
        lambda m, x: [m.derivative(x, 1.0), m.state("wheel.angle", "A", 0.0)],
        "'wheel.angle' is the name of a derived variable",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_declarations_that_make_no_sense(what):
    declare, message = WRONG[what]
    m = Mechanism("wrong")
    th = m.coordinate("th", "rad", independent=True)
    wheel = m.body("wheel", mass=1.0, inertia=1.0)
    m.revolute("A", m.ground.at(), wheel.at(), coordinate=th)
    x = m.state("x", "A")

    def wrong() -> None:
        declare(m, x)
        alfmu.derive(m)

    with pytest.raises(DeclarationError, match=message):
        wrong()


def test_a_state_by_a_wrong_name():
    i = alfmu.Instance(circuit())
    with pytest.raises(alfmu.InputError, match=r"did you mean start\.current"):
        i.set("start.curent", 1.0)
    with pytest.raises(alfmu.InputError, match=r"start\.current is nan; it must be a finite number in A"):
        i.set("start.current", math.nan)
