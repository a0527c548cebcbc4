"""Native FMUs as importers call them: what is refused and what stays, bounded work, states, looks into a step, outputs
that go on."""

import ctypes
import math
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import casadi as ca
import fmpy
import numpy as np
import pytest
from conftest import once
from scenes import initialized
from test_left_out import by_a_compiler, sources_of, with_library
from test_native import summed, unit_of

import alfmu
from alfmu.fmi.drive import Fmu
from alfmu.model.settings import FORMULATIONS


@pytest.fixture(scope="session")
def made(fmu_of) -> Callable[..., Path]:
    """`made("five_bar", ...)`: the path of that native FMU."""

    def get(mechanism, fmi=2, **parameters):
        given = {f"solver.{key}": value for key, value in parameters.items()}
        return fmu_of(mechanism, kind="native", fmi=fmi, parameters=given, reference=False)

    return get


def bounded(path: Path) -> Path:
    """The same FMU, its library built from its sources again, with 50 internal steps of one call at most."""
    made = partial(with_library, path, sources_of(path), path.with_name("made.fmu"), "-DMOST_STEPS=50")
    return once(other := path.with_name("bounded.fmu"), lambda: made().rename(other))


def cart() -> alfmu.Mechanism:
    """A mass on a line that begins at x = 1 and goes left by 1 m/s, with outputs that are not everywhere numbers."""
    m = alfmu.Mechanism("cart")
    x = m.coordinate("x", "m", start=1.0, rate=-1.0, independent=True)
    m.kinetic_energy(m.rate(x) ** 2 / 2)
    pull = m.input("pull", "N")
    m.generalized_force(x, pull)
    m.output("root", ca.sqrt(x), "m")
    m.output("growth", ca.exp(pull), "N")
    return m


# Values -----------------------------------------------------------------------------------------------------------


def test_a_value_that_was_refused_leaves_the_one_before_in_force(made):
    with Fmu(made("four_bar")) as fmu:
        fmu.set("m2", 0.5)
        for name, value in (("m2", -1.0), ("m2", math.nan), ("solver.branch", 9), ("solver.step_size", 0.0)):
            with pytest.raises(alfmu.StepError, match=name.replace(".", r"\.")):
                fmu.set(name, value)
        fmu.initialize()
        with Fmu(made("four_bar")) as plain:
            initialized(plain, {"m2": 0.5})
            with pytest.raises(alfmu.StepError, match="must be a finite number"):
                fmu.set("A.torque", math.inf)
            for unit in (fmu, plain):
                unit.step(0.02, 0.0)
            assert fmu.read().tobytes() == plain.read().tobytes()


@pytest.mark.parametrize("fmi", [2, 3])
def test_choices_are_enumerations_of_what_the_fmu_has(made, fmi):
    path = made("five_bar", fmi)
    described = fmpy.read_model_description(str(path))
    choices = {v.name: v for v in described.modelVariables if v.type == "Enumeration"}
    found = {name: [item.name for item in v.declaredType.items] for name, v in choices.items()}
    assert found == {
        "solver.formulation": [*FORMULATIONS],
        "solver.branch": ["continue", "paper"],
        "solver.method": ["rk4", "auto"],
    }
    with Fmu(path) as by_name, Fmu(path) as by_number, Fmu(path) as other:
        by_name.set("solver.branch", "paper")
        by_number.set("solver.branch", 2)
        rows = []
        for unit in (by_name, by_number, other):
            initialized(unit, {"start.angle": 0.7})
            for k in range(60):
                unit.step(0.02, 0.02 * k)
            rows.append(unit.read())
        assert np.array_equal(rows[0], rows[1])
        with pytest.raises(alfmu.InputError, match="must be a value of type Enumeration"):
            by_name.set("solver.branch", "sideways")
    # fmpy's own run sets items by their numbers.
    given = {"stop_time": 0.1, "output_interval": 0.02, "logger": lambda *said: None}
    result = fmpy.simulate_fmu(str(path), start_values={"solver.branch": 2}, output=["solver.branch"], **given)
    assert result["time"][-1] == pytest.approx(0.1)
    assert set(result["solver.branch"]) == {2}
    with pytest.raises(fmpy.fmi1.FMICallException):
        fmpy.simulate_fmu(str(path), start_values={"solver.branch": 3}, **given)


def test_outputs_that_are_not_finite_are_never_read_as_if_they_were_good(made):
    with Fmu(made(cart())) as fmu:
        fmu.initialize()
        fmu.set("pull", 1000.0)
        for _ in range(3):
            with pytest.raises(alfmu.StepError, match="growth would be inf"):
                fmu.read()
        with pytest.raises(alfmu.StepError, match="growth would be inf"):
            fmu.step(0.02, 0.0)
        with pytest.raises(alfmu.StepError, match=r"cart: outputs are not finite with pull = 1e\+100 N"):
            fmu.set("pull", 1e100)
        assert fmu.read_inputs() == [1000.0]
        fmu.set("pull", 0.0)
        for k in range(33):
            fmu.step(0.03, 0.03 * k)
        before, state, t = fmu.read(), fmu.save(), 0.03 * 33
        with pytest.raises(alfmu.StepError, match=r"cart, t = 1\.02 s: root would be -?nan"):
            fmu.step(0.03, t)
        assert np.array_equal(fmu.read(), before)
        assert fmu.slave.getRealStatus(2) == pytest.approx(t)
        fmu.restore(state)
        fmu.set("pull", 500.0)  # it turns round before x = 0
        fmu.step(0.005, t)
    with Fmu(made(cart())) as fmu:
        fmu.set("start.x", -1.0)
        with pytest.raises(alfmu.StepError, match=r"root would be -?nan"):
            fmu.initialize()


# Steps ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize(("method", "said"), [("rk4", "internal steps, more than 50"), ("explicit", "more than 50")])
def test_the_work_of_a_step_is_bounded(made, method, said):
    with Fmu(bounded(made("four_bar", method=method))) as fmu:
        initialized(fmu, {"start.angle": 0.5})
        fmu.step(0.02, 0.0)
        before, state = fmu.read(), fmu.save()
        size = fmu.parameters["solver.step_size"]
        for h in (1e5, 1e300, 51 * size):
            with pytest.raises(alfmu.StepError, match=f"four_bar.*{said}"):
                fmu.step(h, 0.02)
        assert np.array_equal(fmu.read(), before)
        fmu.step(0.02, 0.02)
        after = fmu.read()
        fmu.restore(state)
        fmu.step(0.02, 0.02)
        assert np.array_equal(fmu.read(), after)


@pytest.mark.slow
@by_a_compiler
def test_tries_of_error_control_are_bounded_too(made):
    """A tolerance of 1e-13 takes more tries than the largest step would."""
    with Fmu(bounded(made("four_bar", method="explicit"))) as fmu:
        initialized(fmu, {"solver.relative_tolerance": 1e-13, "solver.step_size": 1.0})
        before = fmu.read()
        with pytest.raises(alfmu.StepError, match=r"four_bar, t = .*more than 50 internal steps.*take shorter"):
            fmu.step(40.0, 0.0)
        assert np.array_equal(fmu.read(), before)
        fmu.step(0.01, 0.0)


@pytest.mark.parametrize(("start", "step"), [(1e16, 0.5), (math.inf, 0.02), (math.nan, 0.02)])
def test_time_advances(made, start, step):
    with Fmu(made("particle_on_circle")) as fmu:
        if math.isfinite(start):
            fmu.slave.setupExperiment(startTime=start)
            fmu.slave.enterInitializationMode()
            fmu.slave.exitInitializationMode()
        else:
            fmu.initialize()
        with pytest.raises(alfmu.StepError, match=r"below the resolution of the time|a step from t ="):
            fmu.step(step, start)


# States -----------------------------------------------------------------------------------------------------------


def test_a_changed_state_is_refused(made):
    with Fmu(made("five_bar")) as fmu:
        fmu.initialize()
        fmu.step(0.02, 0.0)
        state, before = fmu.save(), fmu.read()
        for k in [*range(140), *range(140, len(state), 37)]:
            changed = bytearray(state)
            changed[k] ^= 1 << k % 8
            with pytest.raises(alfmu.StepError, match=r"check sum|not one of this mechanism"):
                fmu.restore(bytes(changed))
        assert np.array_equal(fmu.read(), before)
        with Fmu(made("four_bar")) as other, pytest.raises(alfmu.StepError, match="not one of this mechanism"):
            other.restore(state)


@pytest.mark.slow
@pytest.mark.parametrize("value", [1e6, -1.0, math.nan, 2.0**40])
def test_numbers_of_a_state_that_index_are_checked(made, value):
    """Even where the check sum is right."""
    layout = alfmu.Instance(alfmu.simulation.prepared(alfmu.derive(alfmu.load("five_bar")))).layout
    with Fmu(made("five_bar")) as fmu:
        fmu.initialize()
        fmu.step(0.02, 0.0)
        state = fmu.save()
        first = len(state) - 8 * layout.size
        for place in (*range(3), None):
            changed = bytearray(state)
            at = first + 8 * (layout.fields["control"][0] + place if place is not None else layout.fields["z"][0])
            if place is None and math.isfinite(value):
                continue
            changed[at : at + 8] = np.float64(value).tobytes()
            with pytest.raises(alfmu.StepError, match=r"five_bar: .* of the saved state is .*; save it again"):
                fmu.restore(summed(bytes(changed)))
        fmu.restore(summed(state))
        fmu.step(0.02, 0.02)


# FMI 3 ------------------------------------------------------------------------------------------------------------


def test_intermediate_updates_come_at_every_internal_step_without_early_return_too(made):
    path, seen, log = made("five_bar", 3), [], []

    def look(environment, time, set_requested, get_allowed, finished, can_return, wanted, until):
        with pytest.raises(fmpy.fmi1.FMICallException):
            unit.setFloat64([unit.references["A.torque"]], [1.0])
        with pytest.raises(fmpy.fmi1.FMICallException):
            unit.doStep(time, 0.02)
        angle = unit.getFloat64([unit.references["link1.angle"]])[0]
        seen.append((time, set_requested, get_allowed, finished, can_return, angle))
        wanted[0] = True  # which nobody allowed

    unit, plain, alone = unit_of(path, log, intermediateUpdate=look), unit_of(path, log), unit_of(path, log)
    for each in (unit, plain, alone):
        each.enterInitializationMode()
        each.exitInitializationMode()
    _, _, early, reached = unit.doStep(0.0, 0.1)
    assert (bool(early), reached) == (False, 0.1)
    assert [row[0] for row in seen] == pytest.approx([0.02, 0.04, 0.06, 0.08, 0.1])
    assert all(row[1:5] == (False, True, True, False) for row in seen)
    angles = []
    for k in range(5):
        plain.doStep(0.02 * k, 0.02)
        angles += plain.getFloat64([plain.references["link1.angle"]])
    # The state after the step is that of a host that does not look.
    alone.doStep(0.0, 0.1)
    assert [row[5] for row in seen] == angles[:-1] + alone.getFloat64([alone.references["link1.angle"]])
    assert any("not during a step" in line for line in log)
    for each in (unit, plain, alone):
        each.freeInstance()


def test_a_step_that_fails_half_way_is_taken_back_where_no_early_return_is_allowed(made):
    """sqrt(x) ends at 1 s."""
    path, log, seen = made(cart(), 3), [], []

    def look(environment, time, *rest):
        seen.append(time)

    unit = unit_of(path, log, intermediateUpdate=look)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    names = [unit.references[name] for name in ("root", "time")]
    before = unit.getFloat64(names)
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.doStep(0.0, 2.0)
    assert 0.9 < seen[-1] <= 1.0
    assert unit.getFloat64(names) == before
    assert "root would be" in log[-1]
    unit.doStep(0.0, 0.5)
    assert unit.getFloat64(names) == pytest.approx([math.sqrt(0.5), 0.5])
    unit.freeInstance()


def test_the_time_of_an_early_return_is_respected(made):
    def look(environment, time, set_requested, get_allowed, finished, can_return, wanted, until):
        wanted[0], until[0] = bool(can_return), 0.05

    unit = unit_of(made("five_bar", 3), [], intermediateUpdate=look, earlyReturnAllowed=True)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    _, _, early, reached = unit.doStep(0.0, 0.2)
    assert early
    assert reached == pytest.approx(0.06)
    unit.freeInstance()


def test_why_an_instance_is_not_made(made):
    path, log = made("five_bar", 3), []
    with pytest.raises(Exception, match="instantiate"):
        unit_of(path, log, eventModeUsed=True)
    assert log[-1].startswith("cannot be instantiated: it has no event mode")


# The description ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_the_description_says(made, fmi):
    with zipfile.ZipFile(made("five_bar", fmi)) as archive:
        root = ET.fromstring(archive.read("modelDescription.xml"))
    described = fmpy.read_model_description(str(made("five_bar", fmi)))
    assert float(root.find("DefaultExperiment").get("tolerance")) == 1e-6
    assert root.find("CoSimulation").get("maxOutputDerivativeOrder") == "2"
    told = [u for u in described.initialUnknowns if u.variable.causality == "output"]
    known = {u.variable.name: {v.name for v in u.dependencies} for u in told}
    assert set(known) == {v.name for v in described.modelVariables if v.causality == "output"}
    assert {"m1", "start.angle", "solver.tolerance"} <= known["link1.angle"]
    assert "A.torque" not in known["link1.angle"]
    assert "A.torque" in known["link1.angular_acceleration"]
    assert not {"solver.step_size", "solver.method"} & known["link1.angle"]


# Derivatives of outputs -------------------------------------------------------------------------------------------

PAIRS = [
    (1, ".angle", ".angular_velocity"),
    (1, ".angular_velocity", ".angular_acceleration"),
    (1, ".x", ".vx"),
    (1, ".vx", ".ax"),
    (2, ".angle", ".angular_acceleration"),
    (2, ".y", ".ay"),
]


@pytest.mark.parametrize(("name", "fmi"), [("five_bar", 2), ("slider_crank", 3), ("particle_on_circle", 2)])
def test_derivatives_of_outputs_are_those_that_other_outputs_are(made, name, fmi):
    with Fmu(made(name, fmi)) as fmu:
        fmu.initialize()
        for k in range(20):
            fmu.step(0.02, 0.02 * k)
        references = {v.name: v.valueReference for v in fmu.description.modelVariables if v.causality == "output"}
        state, compared = fmu.save(), 0
        for order, stem, end in PAIRS:
            pairs = [(n, n.removesuffix(stem) + end) for n in references if n.endswith(stem)]
            pairs = [(references[a], references[b]) for a, b in pairs if b in references]
            if not pairs:
                continue
            first, second = map(list, zip(*pairs, strict=True))
            found = derivatives(fmu, first, order)
            assert found == pytest.approx(real(fmu, second), rel=1e-7 if order == 1 else 1e-4, abs=1e-5)
            compared += len(pairs)
        assert compared >= 3
        assert fmu.save() == state


def real(fmu: Fmu, references: list[int]) -> list[float]:
    return list(
        fmu.slave.getReal(references) if fmu.description.fmiVersion == "2.0" else fmu.slave.getFloat64(references)
    )


def derivatives(fmu: Fmu, references: list[int], order: int) -> list[float]:
    orders = [order] * len(references)
    if fmu.description.fmiVersion == "2.0":
        return list(fmu.slave.getRealOutputDerivatives(references, orders))
    call = fmu.slave.dll.fmi3GetOutputDerivatives
    call.argtypes = [
        *(ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint32), ctypes.c_size_t, ctypes.POINTER(ctypes.c_int32)),
        *(ctypes.POINTER(ctypes.c_double), ctypes.c_size_t),
    ]
    n = len(references)
    values = (ctypes.c_double * n)()
    status = call(fmu.slave.component, (ctypes.c_uint32 * n)(*references), n, (ctypes.c_int32 * n)(*orders), values, n)
    assert status == 0
    return list(values)


def test_derivatives_of_what_follows_inputs_and_of_what_is_no_output(made):
    """A host that extrapolates by them is right to their order: reactions too, and with an input that has a slope."""
    with Fmu(made("slider_crank")) as fmu:
        fmu.initialize()
        references = {v.name: v.valueReference for v in fmu.description.modelVariables}
        y = [references[f"A.force.{k}"] for k in "xy"]
        errors = []
        for k in range(10):
            fmu.set("A.torque", 0.3)
            fmu.step(0.02, 0.02 * k)
        state = fmu.save()
        for h in (0.002, 0.001):
            fmu.restore(state)
            torque = [references["A.torque"]]
            fmu.slave.setRealInputDerivatives(torque, [1], [2.0])
            before, first, second = (
                np.array(x) for x in (real(fmu, y), derivatives(fmu, y, 1), derivatives(fmu, y, 2))
            )
            fmu.step(h, 0.2)
            errors.append(np.abs(before + h * first + h * h / 2 * second - real(fmu, y)).max())
        fmu.slave.setRealInputDerivatives(torque, [1], [200.0])
        speed, rate = ([references[f"crank.angular_{name}"]] for name in ("velocity", "acceleration"))
        assert derivatives(fmu, speed, 1) == pytest.approx(real(fmu, rate), rel=1e-8)
        assert derivatives(fmu, speed, 2) == pytest.approx(derivatives(fmu, rate, 1), rel=1e-6)
        assert np.log2(errors[0] / errors[1]) > 2.6
        assert errors[1] < 1e-3 * np.abs(h * first).max()
        for reference, order in ((references["A.torque"], 1), (y[0], 0), (y[0], 3), (10**6, 1)):
            with pytest.raises(fmpy.fmi1.FMICallException):
                fmu.slave.getRealOutputDerivatives([reference], [order])
