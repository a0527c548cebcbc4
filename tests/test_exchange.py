"""Model Exchange: fmpy integrates the states of native FMUs, judged by the same solver on the equations of references.

fmpy's CVode is BDF, whose error over a run is some hundred times its tolerance, whatever coordinates it integrates.
"""

from collections.abc import Callable
from ctypes import POINTER, c_double
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.sundials import CVodeSolver
from oracles import ode
from oracles.end_stop import EndStop
from oracles.flyball import Governor
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from scenes import sliding

import alfmu
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu

STEP = 0.02
TOLERANCE = 1e-7


def exchanged(path: Path, stop: float, given: dict[str, Any], solver: str = "CVode", step: float = STEP, **more: Any):
    """The results of fmpy at every step; its CVode makes steps of its own in between."""
    found = fmpy.simulate_fmu(
        str(path),
        fmi_type="ModelExchange",
        solver=solver,
        stop_time=stop,
        step_size=step,
        output_interval=step,
        start_values=given,
        **{"relative_tolerance": TOLERANCE, **more},
    )
    steps = found["time"] / step
    rows = found[np.abs(steps - np.round(steps)) < 1e-6]  # without those before events
    _, first = np.unique(-np.round(rows["time"] / step).astype(int)[::-1], return_index=True)
    assert len(first) == round(stop / step) + 1
    return rows[::-1][first[::-1]]


def by_cvode(right_side: Callable[[float, np.ndarray], Any], start: tuple, times: np.ndarray) -> np.ndarray:
    """The states (len(times), n) at `times` of y' = right_side(t, y), by the solver that fmpy gives FMUs."""
    here = SimpleNamespace(y=np.array(start), t=0.0)

    def array(pointer: Any, count: int) -> np.ndarray:
        return np.ctypeslib.as_array(pointer, (count,))

    solver = CVodeSolver(
        nx=len(start),
        nz=0,
        get_x=lambda x, n: np.copyto(array(x, n), here.y),
        set_x=lambda x, n: setattr(here, "y", array(x, n).copy()),
        get_dx=lambda dx, n: np.copyto(array(dx, n), right_side(here.t, here.y)),
        get_z=lambda z, n: None,
        get_nominals=lambda x, n: array(x, n).fill(1.0),
        set_time=lambda t: setattr(here, "t", t),
        input=None,
        startTime=0.0,
        maxStep=times[-1] / 50,
        relativeTolerance=TOLERANCE,
    )
    rows, time = [here.y.copy()], 0.0
    for end in times[1:]:
        _, _, time = solver.step(time, end)
        rows.append(here.y.copy())
    return np.array(rows)


TIMES = STEP * np.arange(151)
FIVE, FOUR, CRANK = Parallelogram(), Parallelogram(m4=None), SliderCrank()
ALIGNED = SliderCrank(l1=1.0, l2=1.0, aligned=True)
STOPPED, GOVERNOR = EndStop(), Governor()


def of_one(reference: Parallelogram | SliderCrank, torque: float = 0.0) -> Callable[[float, np.ndarray], Any]:
    """The equation of one angle."""
    if isinstance(reference, SliderCrank):
        return lambda t, y: [y[1], reference.acceleration(*y)]
    inertia, weight = float(reference.inertia), float(reference.weight)
    return lambda t, y: [y[1], (torque - weight * np.cos(y[0])) / inertia]


CASES = {
    "five-bar through singular positions": (
        *("five_bar", {}, {"start.angle": 0.0, "start.angular_velocity": 2.0}, "link1.angle"),
        *(of_one(FIVE), (0.0, 2.0), FIVE.swing(0.0, 2.0, TIMES)[:, 0]),
    ),
    "four-bar under a torque": (
        *("four_bar", {}, {"start.angle": -1.2, "start.angular_velocity": 0.5, "A.torque": 4.0}, "link1.angle"),
        *(of_one(FOUR, 4.0), (-1.2, 0.5), FOUR.driven(-1.2, 0.5, TIMES, 4.0)[:, 0]),
    ),
    "slider-crank": (
        *("slider_crank", {}, {"start.angle": 0.7, "start.angular_velocity": 3.0}, "crank.angle"),
        *(of_one(CRANK), (0.7, 3.0), CRANK.motion(0.7, 3.0, TIMES)[:, 0]),
    ),
    "slider-crank in natural coordinates": (
        "slider_crank",
        {"coordinates": "natural"},
        *({"start.angle": 0.7, "start.angular_velocity": 6.0}, "crank.angle"),
        *(of_one(CRANK), (0.7, 6.0), CRANK.motion(0.7, 6.0, TIMES)[:, 0]),
    ),
    "slider-crank through singular positions": (
        *("slider_crank", {}, {"l1": 1.0, "l2": 1.0, "start.angle": 0.7, "start.angular_velocity": 8.0}, "crank.angle"),
        *(of_one(ALIGNED), (0.7, 8.0), ALIGNED.motion(0.7, 8.0, TIMES)[:, 0]),
    ),
    "end stop": (
        *("end_stop", {}, {"start.angle": -2.0, "start.angular_velocity": 2.0}, "flywheel.angle"),
        *(STOPPED.right_side, (-2.0, 2.0, 0.0), None),
    ),
    "governor": ("flyball_governor", {}, {}, "slider.position", GOVERNOR.right_side, None, None),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_errors_are_those_of_the_solver(built, case):
    """At most ten times the error of the same solver on the equation of the reference, and constraints hold."""
    name, options, given, output, right_side, start, exact = CASES[case]
    stop = {"governor": 0.5}.get(case, 3.0)
    times = STEP * np.arange(round(stop / STEP) + 1)
    start = (0.0, np.pi / 6, 0.5, 2 * np.pi, 0.0, 0.0, 0.0) if start is None else start
    which = 2 if case == "governor" else 0
    if exact is None:
        exact = ode.solved(right_side, start, times, method="Radau" if case == "governor" else "DOP853", most=1e-3)[
            :, which
        ]
    found = exchanged(built(name, options), stop, given)
    error = np.abs(found[output] - exact).max()
    own = np.abs(by_cvode(right_side, start, times)[:, which] - exact).max()
    assert error <= 10 * own
    assert found["monitor.position_error"].max() <= 1e-12
    assert found["monitor.velocity_error"].max() <= 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_constraints_hold_over_100_s(built, fmi):
    """|Phi| and |Phi-dot| of the five-bar through some hundred singular positions, at a tolerance of 1e-6."""
    found = exchanged(built("five_bar", fmi=fmi), 100.0, {"start.angle": 0.3}, relative_tolerance=1e-6)
    assert np.count_nonzero(np.diff(np.sign(found["link1.angle"]))) >= 50
    assert found["monitor.position_error"].max() <= 1e-10
    assert found["monitor.velocity_error"].max() <= 1e-10


@pytest.mark.slow
def test_euler_gains_its_first_order(built):
    """Half the step, half the error; constraints hold after steps of Euler's method, too."""
    errors = []
    for step in (1e-3, 5e-4):
        found = exchanged(built("four_bar", fmi=3), 1.0, {"start.angle": -1.2}, "Euler", step)
        errors.append(np.abs(found["link1.angle"] - FOUR.swing(-1.2, 2.0, found["time"])[:, 0]).max())
        assert found["monitor.position_error"].max() <= 1e-12
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.05)


def test_steps_of_an_importer_that_are_too_long_are_warned_of(built):
    """Euler's method at 20 ms, the default of some importers; CVode and shorter steps are not."""

    def said(solver: str, step: float) -> list[str]:
        lines = list[str]()
        exchanged(built("five_bar", fmi=2), 0.5, {}, solver, step, logger=lambda *x: lines.append(x[-1].decode()))
        return [line for line in lines if "let it take shorter steps, or use its solver with error control" in line]

    assert len(said("Euler", 0.02)) == 1
    assert said("Euler", 1e-4) == said("CVode", 0.02) == []


STATE = {
    2: ("getFMUstate", "setFMUstate", "serializeFMUstate", "deSerializeFMUstate"),
    3: ("getFMUState", "setFMUState", "serializeFMUState", "deserializeFMUState"),
}
"""Functions of fmpy for states."""


def quiet_callbacks() -> fmpy.fmi2.fmi2CallbackFunctions:
    """Callbacks of FMI 2 without fmpy's logger, which may call that of an FMU that another test has ended."""
    callbacks = fmpy.fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmpy.fmi2.fmi2CallbackLoggerTYPE(lambda *said: None)
    callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.fmi2.calloc)
    callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.fmi2.free)
    return callbacks


class Model:
    """An instance for Model Exchange, in continuous-time mode."""

    def __init__(self, path: Path, **given: float):
        self.description = fmpy.read_model_description(str(path))
        self.fmi3 = self.description.fmiVersion.startswith("3")
        self.fmu = (fmpy.fmi3.FMU3Model if self.fmi3 else fmpy.fmi2.FMU2Model)(
            guid=self.description.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=self.description.modelExchange.modelIdentifier,
            instanceName="one",
        )
        self.fmu.instantiate(**({} if self.fmi3 else {"callbacks": quiet_callbacks()}))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.states = [name for name in self.references if name.startswith("state.")]
        self.rates = [f"der({name})" for name in self.states]
        self.begin(**given)

    def begin(self, **given: float) -> None:
        """Lead to continuous-time mode."""
        if not self.fmi3:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        for name, value in given.items():
            self.set(name.replace("_", ".", 1), value)
        self.fmu.exitInitializationMode()
        self.event()
        self.fmu.enterContinuousTimeMode()

    def event(self) -> tuple:
        return self.fmu.updateDiscreteStates() if self.fmi3 else self.fmu.newDiscreteStates()

    def set(self, name: str, value: float) -> None:
        (self.fmu.setFloat64 if self.fmi3 else self.fmu.setReal)([self.references[name]], [value])

    def get(self, *names: str) -> np.ndarray:
        return np.array((self.fmu.getFloat64 if self.fmi3 else self.fmu.getReal)([self.references[x] for x in names]))

    def vector(self, get: Callable[[Any, int], Any]) -> np.ndarray:
        found = np.full(len(self.states), np.nan)
        get(found.ctypes.data_as(POINTER(c_double)), len(found))
        return found

    def at(self, x: np.ndarray) -> None:
        self.fmu.setContinuousStates(np.ascontiguousarray(x).ctypes.data_as(POINTER(c_double)), len(x))


@pytest.mark.parametrize("fmi", [2, 3])
def test_derivatives_by_states_and_inputs_are_those_of_differences(built, fmi):
    """Of rates of states and of all outputs, beside the constraints too, where an importer's steps lead."""
    m = Model(built("four_bar", fmi=fmi), start_angle=0.7)
    outputs = [v for v in m.description.modelVariables if v.causality == "output" and v.variability == "continuous"]
    unknowns = [*m.rates, *(v.name for v in outputs if not v.name.startswith("monitor."))]
    x = m.vector(m.fmu.getContinuousStates) + 1e-4 * np.random.default_rng(1).standard_normal(len(m.states))
    m.at(x)
    inputs = ["A.torque", "D.torque"]
    found = [
        m.fmu.getDirectionalDerivative([m.references[u] for u in unknowns], [m.references[known]], [1.0])
        for known in (*m.states, *inputs)
    ]
    differences = []
    for k in range(len(m.states) + len(inputs)):
        sides = []
        for h in (1e-6, -1e-6):
            moved = x.copy()
            moved[k : k + 1] += h
            m.at(moved)
            if k >= len(x):
                m.set(inputs[k - len(x)], h)
            sides.append(m.get(*unknowns))
            if k >= len(x):
                m.set(inputs[k - len(x)], 0.0)
        differences.append((sides[0] - sides[1]) / 2e-6)
    assert np.abs(np.array(found) - differences).max() <= 1e-8 * np.abs(differences).max()
    assert np.abs(differences).max() > 1.0


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_is_restored_to_the_last_bit(built, fmi):
    """The importer's own states among it, which are beside the constraints; also from bytes, in another instance."""
    m = Model(built("five_bar", fmi=fmi), start_angle=0.7)
    get, set_, write, read = (getattr(m.fmu, name) for name in STATE[fmi])
    x = m.vector(m.fmu.getContinuousStates) + 1e-4
    m.fmu.setTime(0.3)
    m.at(x)
    seen, kept = m.get(*m.rates, "C.force.x"), get()
    saved = write(kept)
    m.at(x + 0.1)
    assert (m.get(*m.rates, "C.force.x") != seen).all()
    set_(kept)
    assert m.vector(m.fmu.getContinuousStates).tobytes() == x.tobytes()
    assert m.get(*m.rates, "C.force.x").tobytes() == seen.tobytes()
    m.at(x + 0.1)
    set_(read(saved))
    assert m.get(*m.rates, "C.force.x").tobytes() == seen.tobytes()


def test_nominal_values_are_the_length_of_the_mechanism(built):
    m = Model(built("five_bar"), start_angle=0.7)
    nominals = dict(zip(m.states, m.vector(m.fmu.getNominalsOfContinuousStates), strict=True))
    assert nominals["state.th1"] == nominals["state.th1_rate"] == 1.0
    assert nominals["state.x2"] == nominals["state.x2_rate"] == pytest.approx(1.0, rel=0.5)


def turning() -> alfmu.Mechanism:
    """A wheel of 0.5 kg m^2 that turns round under -1 N.m, in a seal of 0.5 N.m."""
    m = alfmu.Mechanism("turning")
    a = m.coordinate("a", "rad", start=0.0, rate=1.0, independent=True)
    wheel = m.body("wheel", mass=1.0, inertia=0.5)
    hinge = m.revolute("hinge", m.ground.at(0, 0), wheel.at(0, 0), coordinate=a)
    m.drive(hinge, -1.0)
    m.friction(hinge, coulomb=1.0, load=0.5)
    return m


@pytest.mark.parametrize("fmi", [2, 3])
def test_vectors_are_known_as_early_as_the_standards_have_them(built, fmi, monkeypatch):
    """Nominal values in a new instance, the others during initialisation, where start values change them: a wheel of
    0.5 kg m^2 under -1 N.m in a seal of 0.5 N.m."""
    found = []

    def begin(m: Model, **given: float) -> None:
        rates = m.fmu.getContinuousStateDerivatives if m.fmi3 else m.fmu.getDerivatives
        assert m.vector(m.fmu.getNominalsOfContinuousStates).tolist() == [1.0, 1.0]
        if not m.fmi3:
            m.fmu.setupExperiment(startTime=0.0)
        m.fmu.enterInitializationMode()
        for angle in (0.25, 0.75):
            m.set("start.a", angle)
            found.append([*m.vector(m.fmu.getContinuousStates), *m.vector(rates)])
            m.fmu.getEventIndicators((c_double * 1)(), 1)

    monkeypatch.setattr(Model, "begin", begin)
    Model(built(turning(), fmi=fmi))
    assert found == [[0.25, 1.0, 1.0, pytest.approx(-3.0)], [0.75, 1.0, 1.0, pytest.approx(-3.0)]]


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_is_illegal_is_refused(built, fmi):
    """Calls of the other interface, wrong modes and lengths; the instance goes on after them."""
    m = Model(built("five_bar", fmi=fmi))
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.event()
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.fmu.getContinuousStates((c_double * 3)(), 3)
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.fmu.setTime(np.nan)
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.at(np.full(len(m.states), np.nan))
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.set("state.th1", 0.3)
    assert np.isfinite(m.get(*m.rates)).all()


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_state_of_the_other_interface_is_no_state_to_go_on_from(built, fmi):
    """Calls are refused after it, and the instance goes on from one of its own; it can be reset, and ends."""
    path = built("five_bar", fmi=fmi)
    m = Model(path)
    get, set_, write, read = (getattr(m.fmu, name) for name in STATE[fmi])
    own = get()
    with Fmu(path) as other:
        other.initialize()
        foreign = other.save()
    set_(read(foreign))
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.fmu.setTime(0.1)
    set_(own)
    m.fmu.setTime(0.1)
    assert read(write(get()))
    m.fmu.terminate()
    assert np.isfinite(m.get(*m.rates)).all()
    with pytest.raises(fmpy.fmi1.FMICallException):
        m.fmu.setTime(0.2)
    m.fmu.reset()
    m.begin()
    m.fmu.setTime(0.2)


@pytest.mark.slow
def test_both_interfaces_are_in_one_fmu(built, tmp_path):
    """Variables of Model Exchange have values in co-simulation, too."""
    for fmi in (2, 3):
        path = built("five_bar", fmi=fmi)
        description = fmpy.read_model_description(str(path))
        assert description.coSimulation
        assert description.modelExchange
        names = [f"{x}state.th1{y}" for x, y in (("", ""), ("", "_rate"), ("der(", "_rate)"))]
        outputs = [*names, "link1.angle", "link1.angular_velocity", "link1.angular_acceleration"]
        found = fmpy.simulate_fmu(str(path), stop_time=1.0, output_interval=0.1, output=outputs)
        for name, same in zip(outputs[:3], outputs[3:], strict=True):
            assert np.array_equal(found[name], found[same])
    path = built("five_bar", interface="me")
    description = fmpy.read_model_description(str(path))
    assert description.coSimulation is None
    assert not validate(path, static=True)
    path = built("five_bar", interface="cs")
    assert fmpy.read_model_description(str(path)).modelExchange is None
    with Fmu(built("five_bar")) as one, Fmu(path) as other:
        for fmu in (one, other):
            fmu.initialize()
            fmu.step(0.5, 0.0)
        assert one.read().tobytes() == other.read().tobytes()


# Events ---------------------------------------------------------------------------------------------------------------


def block(force: Callable[[Any], Any]) -> alfmu.Mechanism:
    """A block of 2 kg that rubs on the ground under a force along it."""
    m, _, guide, *_ = sliding("block", mass=2.0, start=0.0)
    m.drive(guide, force(m.time))
    m.friction(guide, coulomb=0.3, static=0.4)
    m.gravity(0, -9.81)
    return m


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_block_slides_stops_sticks_and_slides_back(built, fmi):
    """In closed form, at forces that jump: events in time and of the state, each at its instant."""
    rubs, pieces = 0.3 * 2.0 * 9.81, [(0.0, 9.0), (0.43, -3.0), (1.21, -15.0)]
    motion, s, v = [], 0.0, 0.0
    for (begin, force), end in zip(pieces, (0.43, 1.21, 2.0), strict=True):
        while begin < end:
            sticks = v == 0.0 and abs(force) <= 0.4 * 2.0 * 9.81
            a = 0.0 if sticks else (force - rubs * np.sign(v or force)) / 2.0
            stops = begin - v / a if v * a < 0 else np.inf
            last = min(end, stops)
            motion.append((begin, s, v, a))
            h = last - begin
            s, v, begin = s + v * h + a * h * h / 2, 0.0 if last == stops else v + a * h, last
    force = lambda t: ca.if_else(t < 0.43, 9.0, ca.if_else(t < 1.21, -3.0, -15.0))  # noqa: E731
    found = exchanged(built(block(force), fmi=fmi), 2.0, {})
    which = np.searchsorted([begin for begin, *_ in motion], found["time"] + 1e-9) - 1
    begin, s, v, a = np.array(motion)[which].T
    h = found["time"] - begin
    assert np.abs(found["block.x"] - (s + v * h + a * h**2 / 2)).max() <= 1e-6
    assert np.abs(found["block.vx"] - (v + a * h)).max() <= 1e-6
    assert len(motion) == 4
    assert set(found["guide.slip"]) == {0.0, 1.0, -1.0}


@pytest.mark.parametrize(
    ("fmi", "host", "call"),
    [(2, fmpy.fmi2.FMU2Model, "newDiscreteStates"), (3, fmpy.fmi3.FMU3Model, "updateDiscreteStates")],
)
def test_importers_that_restart_only_where_states_count_as_changed_follow_a_kink(built, fmi, host, call, monkeypatch):
    """fmusim is one. A wheel in a seal turns round under a torque, in closed form: only its rates jump."""
    said, update, restart = [], getattr(host, call), CVodeSolver.reset
    monkeypatch.setattr(host, call, lambda self: said.append(update(self)) or said[-1])
    monkeypatch.setattr(CVodeSolver, "reset", lambda self, time: restart(self, time) if said[-1][3] else None)
    found = exchanged(built(turning(), fmi=fmi), 1.0, {})
    left = 1.0 / 3.0 - found["time"]
    assert len(said) >= 2
    assert np.abs(found["wheel.angular_velocity"] - np.where(left > 0, 3.0, 1.0) * left).max() <= 1e-6


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_block_slides_where_an_importer_meets_its_limit_exactly(built, fmi):
    """At an indicator of zero to the last digit, after which an importer sees no change of its sign."""
    m = Model(built(block(lambda t: 20.0 * t), fmi=fmi))
    low, high = 0.0, 1.0
    while low < (middle := (low + high) / 2) < high:
        m.fmu.setTime(middle)
        low, high = (middle, high) if m.get("indicator.guide")[0] > 0.0 else (low, middle)
    m.fmu.setTime(high)
    assert m.get("indicator.guide", "guide.slip").tolist() == [0.0, 0.0]
    assert high == pytest.approx(0.4 * 2.0 * 9.81 / 20.0, rel=1e-8)
    m.fmu.enterEventMode()
    m.event()
    assert m.get("guide.slip")[0] == 1.0
    assert m.get("guide.friction_force")[0] == pytest.approx(-0.3 * 2.0 * 9.81, rel=1e-12)


def test_stick_and_slip_in_a_linkage_are_those_of_co_simulation(built):
    """A slider-crank whose slider rubs, swung to and fro, with the load that friction follows from."""
    m = alfmu.Mechanism("rubbing")
    a, b, s = (
        m.coordinate("a", "rad", start=0.4),
        m.coordinate("b", "rad", start=-0.2),
        m.coordinate("s", "m", start=1.4),
    )
    crank, rod, slider = (
        m.bar("crank", mass=1.0, length=0.5),
        m.bar("rod", mass=0.7, length=1.0),
        m.body("slider", mass=1.0),
    )
    O = m.revolute("O", m.ground.at(0, 0), crank.start, coordinate=a)
    m.revolute("H", crank.end, rod.start, coordinate=b)
    guide = m.prismatic("guide", m.ground.at(0, 0), slider.at(0, 0), coordinate=s)
    m.revolute("W", rod.end, slider.at(0, 0))
    m.friction(guide, coulomb=0.2)
    m.drive(O, 4.0 * ca.sin(2.0 * m.time))
    m.gravity(0, -9.81)
    path = built(m)
    found = exchanged(path, 4.0, {}, relative_tolerance=1e-9)
    other = fmpy.simulate_fmu(str(path), stop_time=4.0, output_interval=STEP)
    for name, most in (("crank.angle", 2e-6), ("slider.vx", 1e-5), ("guide.friction_force", 1e-4)):
        assert np.abs(found[name] - other[name]).max() <= most
    assert np.count_nonzero(np.diff(found["guide.slip"])) >= 4
    assert found["monitor.position_error"].max() <= 1e-12


def test_a_lock_stops_a_joint_by_an_impact_and_releases_it(built):
    """Impulse, lost energy, and the motion before, during and after are those of co-simulation."""
    m = alfmu.Mechanism("swing")
    a, b = m.coordinate("a", "rad", start=0.3), m.coordinate("b", "rad", start=-0.4)
    one, two = m.bar("one", mass=1.0, length=1.0), m.bar("two", mass=0.7, length=0.8)
    m.revolute("O", m.ground.at(0, 0), one.start, coordinate=a)
    m.revolute("H", one.end, two.start, coordinate=b)
    m.lock("H")
    m.gravity(0, -9.81)
    path = built(m)
    changes = [(0, False), (0.5, False), (0.5, True), (1.1, True), (1.1, False), (3, False)]
    given = {"input": np.array(changes, dtype=[("time", float), ("H.locked", bool)])}
    found = exchanged(path, 2.0, {}, **given)
    other = fmpy.simulate_fmu(str(path), stop_time=2.0, output_interval=STEP, **given)
    same = ~np.isin(np.round(found["time"] / STEP), [25, 55])  # in co-simulation inputs act in the step after them
    for name in ("one.angle", "two.angle", "H.impulse", "monitor.energy_lost"):
        assert np.abs(found[name] - other[name])[same].max() <= 2e-5
    assert found["monitor.energy_lost"][-1] > 0.01
    locked = (found["time"] > 0.51) & (found["time"] < 1.09)
    assert np.ptp((found["two.angle"] - found["one.angle"])[locked]) <= 1e-12
    assert np.ptp((found["two.angle"] - found["one.angle"])[~locked]) > 0.1


def test_a_prescribed_motion_is_followed_through_a_jump_of_its_rate(built):
    """To round-off, as nothing is left to integrate; a law is followed also between the points of the importer."""
    m = alfmu.Mechanism("led")
    turned, swung = m.coordinate("turned", "rad"), m.coordinate("swung", "rad", start=0.1)
    crank, bar = m.bar("crank", mass=1.0, length=1.0), m.bar("bar", mass=1.0, length=1.0)
    motor = m.revolute("motor", m.ground.at(0, 0), crank.start, coordinate=turned)
    with pytest.warns(alfmu.AlfmuWarning, match="impact"):
        m.motion(motor, ca.if_else(m.time < 1.107, 2 * m.time, 2.214 + 3 * (m.time - 1.107)))
    hinge = m.revolute("hinge", crank.end, bar.start, coordinate=swung)
    m.motion(hinge, 0.1 + 0.5 * ca.sin(7 * m.time))
    m.gravity(0, -9.81)
    found = exchanged(built(m), 2.0, {})
    t = found["time"]
    exact = np.where(t < 1.107, 2 * t, 2.214 + 3 * (t - 1.107))
    assert np.abs(found["crank.angle"] - exact).max() <= 1e-12
    assert np.abs(found["crank.angular_velocity"] - np.where(t < 1.107, 2, 3)).max() <= 1e-12
    assert np.abs(found["bar.angle"] - exact - 0.1 - 0.5 * np.sin(7 * t)).max() <= 1e-12


def test_a_state_of_first_order_is_integrated_with_the_motion(built):
    """A force that fades, in closed form; its nominal value is the declared one."""
    m, _, guide, *_ = sliding("lag", mass=2.0, start=0.0)
    lag = m.state("lag", "N", start=1.0, nominal=0.25)
    m.derivative(lag, -3.0 * lag)
    m.drive(guide, lag)
    path = built(m)
    found = exchanged(path, 2.0, {})
    t = found["time"]
    # s'' = exp(-3 t) / 2
    assert np.abs(found["block.x"] - (np.exp(-3 * t) - 1 + 3 * t) / 18).max() <= 1e-5
    model = Model(path)
    assert model.vector(model.fmu.getNominalsOfContinuousStates)[-1] == 0.25


REFUSED = {
    "an input that moves something": "angle prescribes a motion",
    "a force that jumps with an input": "input passes a value",
    "outputs": "monitor.distance",
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_exchanged_is_refused_by_name(tmp_path, case):
    outputs = None
    m, _, guide, *_ = sliding("scene", mass=2.0, start=0.0)
    if case == "a force that jumps with an input":
        m.drive(guide, ca.if_else(m.input("push", "N") > 1.0, 3.0, 0.0))
    elif case == "outputs":
        outputs = ["block.x"]
    else:
        m.motion(guide, m.input("angle", "m"))
    m.gravity(1.0, -9.81)
    for interface in ("both", "me"):
        with pytest.raises(alfmu.ExportError, match=REFUSED[case]):
            alfmu.export(alfmu.Recipe(m, interface=interface, outputs=outputs), tmp_path / "scene.fmu")
    path = alfmu.export(alfmu.Recipe(m, outputs=outputs), tmp_path / "scene.fmu")
    assert fmpy.read_model_description(str(path)).modelExchange is None
