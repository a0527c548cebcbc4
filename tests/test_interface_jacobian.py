"""The interface Jacobian, derivatives of outputs at the end of a communication step by inputs that are held over it, in
the library and in FMUs of both kinds, against differences of steps that are taken back; and what carries none of it."""

import logging
import re
from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path

import casadi as ca
import fmpy
import fmpy.fmi2
import fmpy.fmi3
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scenes import derived, hinged, initialized

import alfmu
from alfmu.analysis.linearization import linearize
from alfmu.cli import main
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.model.units import UNITS, composed, quotient
from alfmu.runtime import Instance
from alfmu.runtime.pipeline import packed
from alfmu.simulation import prepared

OUTPUTS = {
    "five_bar": ["link1.angle", "link4.x", "link1.angular_velocity", "link3.angular_acceleration", "A.force.x"],
    "slider_crank": ["crank.angle", "slider.x", "slider.vx", "slider.ax", "B.force.y"],
}
KINDS = [("native", 2), ("native", 3), ("python", 2)]
STENCIL = {-2: 1 / 12, -1: -8 / 12, 1: 8 / 12, 2: -1 / 12}
"""Of a central difference of order 4."""


@pytest.fixture(scope="session")
def built(fmu_of) -> Callable[..., Path]:
    """`built("five_bar", "native", 2)`: an FMU with its interface Jacobian."""

    def get(name: str, kind: str, fmi: int, **given) -> Path:
        outputs = ["*", *(f"{output}/*" for output in OUTPUTS[name])]
        return fmu_of(name, **{"kind": kind, "fmi": fmi, "outputs": outputs, "reference": False, **given})

    return get


def entries(unit) -> list[str]:
    return [v.name for v in unit.outputs if "/" in v.name]


def by_differences(
    unit, names: list[str], time: float, h: float, nudge: float, slope: float | None = None
) -> np.ndarray:
    """The same derivatives by steps that are taken back; the unit is then where it was."""
    outputs = [v.name for v in unit.outputs]
    places = [outputs.index(name.split("/")[0]) for name in names]
    by = [name.split("/")[1] for name in names]
    state, at = unit.save(), dict(zip((v.name for v in unit.input_variables), unit.read_inputs(), strict=True))
    found = np.zeros(len(names))
    for name in dict.fromkeys(by):
        for times, weight in STENCIL.items():
            unit.restore(state)
            unit.set(name, at[name] + times * nudge)
            for each in dict.fromkeys(by) if slope else ():
                unit.slope(each, slope)
            unit.step(h, time)
            values = unit.read()[places]
            found += np.where([each == name for each in by], weight * values / nudge, 0.0)
    unit.restore(state)
    return found


def compared(
    unit, h: float, steps: int, nudge: float = 0.05, size: float = 0.5, slope: float | None = None
) -> np.ndarray:
    """The largest differences of entries of the Jacobian from differences, over the largest value of each."""
    names = entries(unit)
    inputs = [v.name for v in unit.input_variables if v.type == "Real"]
    exact, found = [], []
    for k in range(steps):
        for j, name in enumerate(inputs):
            unit.set(name, size * np.sin(0.7 * k + j))
        exact.append(by_differences(unit, names, k * h, h, nudge, slope))
        for each in inputs if slope else ():
            unit.slope(each, slope)
        unit.step(h, k * h)
        found.append(unit.read()[[v.name in names for v in unit.outputs]])
    largest = np.abs(exact).max(0)
    assert (largest > 0).all()
    return np.abs(np.array(found) - exact).max(0) / largest


# In FMUs --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind", "fmi", "method"),
    [(name, *KINDS[k], ("rk4", "auto")[(k + j) % 2]) for j, name in enumerate(OUTPUTS) for k in range(len(KINDS))],
)
def test_in_an_fmu_it_is_that_of_steps_that_are_taken_back(built, name, kind, fmi, method):
    """Through a singular position, in which the five-bar begins."""
    with Fmu(built(name, kind, fmi)) as fmu:
        fmu.set("solver.method", method)
        if method == "auto":
            fmu.set("solver.relative_tolerance", 1e-11)
        fmu.initialize()
        assert not fmu.read()[["/" in v.name for v in fmu.outputs]].any()
        assert compared(fmu, 0.05, 12).max() <= 1e-8
        assert len(entries(fmu)) == 10


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "fmi"), KINDS, ids=[f"{kind}-{fmi}" for kind, fmi in KINDS])
def test_the_description_is_good(built, kind, fmi):
    path = built("slider_crank", kind, fmi)
    assert validate_fmu(str(path)) == []
    assert validate(str(path)) == []
    description = fmpy.read_model_description(str(path))
    found = {v.name: v for v in description.modelVariables}
    v = found["crank.angle/A.torque"]
    assert (v.causality, v.variability, v.unit) == ("output", "discrete", "rad/(N.m)")
    assert found["slider.ax/slider.force"].unit == "m/(s2.N)"
    assert description.variableNamingConvention == "flat"
    unknowns = {u.variable.name: u.dependencies for u in (*description.outputs, *description.initialUnknowns)}
    assert list(unknowns[v.name]) == []
    units = {u.name: u.baseUnit for u in description.unitDefinitions}
    assert (units[v.unit].rad, units[v.unit].kg, units[v.unit].m, units[v.unit].s) == (1, -1, -2, 2)


@pytest.mark.parametrize(("kind", "fmi"), KINDS, ids=[f"{kind}-{fmi}" for kind, fmi in KINDS])
def test_it_is_part_of_the_state(built, kind, fmi):
    """Its value is there at once in another instance that is given a state, and goes with a reset."""
    path = built("five_bar", kind, fmi)
    with Fmu(path) as fmu, Fmu(path) as other:
        fmu.initialize()
        names = [v.name in entries(fmu) for v in fmu.outputs]
        for k in range(7):
            fmu.step(0.02, 0.02 * k)
        before, state = fmu.read(), fmu.save()
        assert before[names].all()
        fmu.step(0.02, 0.14)
        assert (fmu.read()[names] != before[names]).all()
        ahead = fmu.read()
        fmu.restore(state)
        assert np.array_equal(fmu.read(), before)
        other.initialize()
        other.restore(state)
        assert np.array_equal(other.read(), before)
        other.step(0.02, 0.14)
        assert np.array_equal(other.read(), ahead)
        other.set("A.torque", 3.0)
        assert np.array_equal(other.read()[names], ahead[names])
        other.reset()
        other.initialize()
        assert not other.read()[names].any()


def slave_of(path: Path, version: int, **how):
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    kind = fmpy.fmi2.FMU2Slave if version == 2 else fmpy.fmi3.FMU3Slave
    unit = kind(guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier)
    unit.instantiate(**how)
    unit.references = {v.name: v.valueReference for v in description.modelVariables}
    if version == 2:
        unit.setupExperiment()
    unit.enterInitializationMode()
    return unit, description


@pytest.mark.slow
def test_where_the_host_looks_and_returns_early_it_is_that_of_the_step_so_far(built):
    path, seen = built("slider_crank", "native", 3, parameters={"solver.method": "rk4"}), []

    def look(environment, time, set_requested, get_allowed, finished, can_return, wanted, until):
        seen.append(time)
        wanted[0] = time > 0.25

    watched, _ = slave_of(path, 3, earlyReturnAllowed=True, intermediateUpdate=look)
    plain, _ = slave_of(path, 3)
    names = [watched.references[f"{output}/A.torque"] for output in OUTPUTS["slider_crank"]]
    for unit in (watched, plain):
        unit.exitInitializationMode()
        unit.setFloat64([unit.references["A.torque"]], [0.7])
        unit.doStep(0.0, 0.2)
    assert len(seen) > 5
    np.testing.assert_allclose(watched.getFloat64(names), plain.getFloat64(names), rtol=1e-12)
    _, _, early, reached = watched.doStep(0.2, 0.2)
    assert early
    plain.doStep(0.2, reached - 0.2)
    np.testing.assert_allclose(watched.getFloat64(names), plain.getFloat64(names), rtol=1e-12)
    for unit in (watched, plain):
        unit.terminate()
        unit.freeInstance()


@pytest.mark.parametrize("version", [2, 3])
def test_other_derivatives_of_it_are_zero_or_refused(built, version):
    """It follows no input at once; and has no rate, as it belongs to steps."""
    unit, _ = slave_of(built("five_bar", "native", version), version)
    unit.exitInitializationMode()
    unit.doStep(0.0, 0.02)
    entry, torque = unit.references["link1.angle/A.torque"], unit.references["A.torque"]
    assert unit.getDirectionalDerivative([entry], [torque], [1.0]) == [0.0]
    rates = unit.getRealOutputDerivatives if version == 2 else unit.getOutputDerivatives
    assert len(rates([unit.references["link1.angle"]], [1])) == 1
    with pytest.raises(fmpy.fmi1.FMICallException):
        rates([entry], [1])
    unit.terminate()
    unit.freeInstance()


@pytest.mark.slow
def test_without_it_nothing_is_there(tmp_path):
    """Patterns of other outputs match none of it; the file of the scene, and the state, are those without; with it, the
    motion is the same to the last bit."""
    plain = prepared(derived("five_bar"))
    with_it = Instance("five_bar", outputs=["*", "link1.angle/*", "*.force.x/D.torque"])
    without = Instance("five_bar", outputs=["*"])
    assert entries(without) == []
    assert packed(with_it.equations).count(b"link1.angle/A.torque") == 1
    assert packed(without.equations) == packed(Instance(plain).equations)
    assert len(with_it.save()) == len(without.save()) + 8 * len(entries(with_it))
    for method in ("rk4", "auto"):
        runs = [
            alfmu.simulate("five_bar", 2.0, 0.05, outputs=outputs, parameters={"solver.method": method}, inputs=loads)
            for outputs in (None, ["*", "link1.angle/*"])
            for loads in [{"A.torque": lambda t: 2 * np.sin(5 * t)}]
        ]
        assert not any("/" in name for name in runs[0].names)
        for name in runs[0].names:
            assert np.array_equal(runs[0][name], runs[1][name]), name
    path = alfmu.export("five_bar", tmp_path / "five_bar.fmu", kind="native", reference=False)
    description = fmpy.read_model_description(str(path))
    assert description.variableNamingConvention == "structured"
    assert not any("/" in v.name for v in description.modelVariables)


# In the library -------------------------------------------------------------------------------------------------------


def driven() -> alfmu.Mechanism:
    """A four-bar with a lock, and a motor with a current."""
    m = alfmu.load("four_bar")
    i = m.state("current", "A")
    speed = m.rate(next(c for c in m.coordinates if c.name == "th1").q)
    m.derivative(i, (m.input("voltage", "V") - 0.5 * i - speed) / 0.05)
    m.drive(next(j for j in m.joints if j.name == "A"), m.parameter("k", 1.0, "N.m/A") * i)
    m.output("motor.current", i, "A")
    m.lock(next(j for j in m.joints if j.name == "B"))
    return m


def moved() -> alfmu.Mechanism:
    """A double pendulum whose first bar an input moves."""
    m = alfmu.Mechanism("moved")
    upper, lower = m.bar("upper", mass=1.0, length=0.7), m.bar("lower", mass=1.0, length=0.5)
    A = m.revolute("A", m.ground.at(0, 0), upper.start, coordinate=m.coordinate("th", "rad"))
    B = m.revolute("B", upper.end, lower.start, coordinate=m.coordinate("phi", "rad", start=0.4, independent=True))
    m.motion(A, m.input("A.angle", "rad", order=1))
    m.drive(B, m.input("B.torque", "N.m"))
    m.gravity(0, -9.81)
    return m


TIGHT = {"solver.relative_tolerance": 1e-11}
CASES = [
    ("five_bar", ["link1.angle/*", "D.force.x/*"], {"solver.method": "rk4", "solver.input_order": 2}, {}),
    ("five_bar", ["link1.angle/*", "D.force.x/*"], {"solver.method": "rk4"}, {"slope": 3.0}),
    ("five_bar", ["link1.angle/*"], {"solver.formulation": "dae", "solver.method": "rk4", "start.angle": 0.3}, {}),
    ("slider_crank", ["crank.angle/*", "slider.ax/*"], {"solver.method": "stiff", **TIGHT}, {}),
    ("slider_crank", ["crank.angle/*", "slider.ax/*"], {"solver.method": "explicit", **TIGHT}, {}),
    ("slider_crank", ["crank.angle/*", "slider.ax/*"], {"solver.method": "order8", **TIGHT}, {}),
    ("slider_crank", ["crank.angle/*", "slider.x/*"], {"solver.method": "trapezoidal"}, {"h": 0.02}),
    ("bennett", ["hinge1.angle/*", "hinge1.angular_acceleration/*"], {"solver.method": "rk4"}, {}),
    ("n_four_bar", ["crank1.angle/*", "crank2.x/*"], {"solver.method": "rk4"}, {}),
    (driven, ["link1.angle/*", "motor.current/*", "B.force.x/A.torque"], TIGHT, {"nudge": 0.2}),
    (moved, ["lower.angle/*", "lower.vx/*"], TIGHT, {"nudge": 0.001, "size": 0.04}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("what", "outputs", "given", "how"), CASES, ids=[str(k) for k in range(len(CASES))])
def test_it_is_that_of_steps_that_are_taken_back(what, outputs, given, how):
    """Inputs that are extrapolated, that have a slope, that move something; implicit and explicit methods, redundant
    constraints whose rank is frozen, states of first-order equations."""
    unit = initialized(Instance(what() if callable(what) else what, outputs=["*", *outputs]), given)
    assert compared(unit, **{"h": 0.05, "steps": 8, **how}).max() <= 1e-8


@pytest.mark.slow
def test_a_step_in_which_a_lock_engages_and_one_in_which_it_lets_go():
    unit = Instance(driven(), outputs=["*", "link*.angular_velocity/*", "motor.current/*"])
    unit.set("solver.relative_tolerance", 1e-11)
    unit.initialize()
    sizes = []
    for k in range(9):
        unit.set("B.locked", float(3 <= k < 6))
        unit.set("A.torque", 1.0)
        exact = by_differences(unit, entries(unit), 0.05 * k, 0.05, 0.05)
        unit.step(0.05)
        found = unit.read()[["/" in v.name for v in unit.outputs]]
        sizes.append(np.abs(exact[0]))
        assert np.abs(found - exact).max() <= 1e-8 * np.abs(exact).max(), k
    assert max(sizes[3:6]) < 1e-6 * sizes[0]  # nothing moves in between


@pytest.mark.slow
def test_a_step_of_any_length_takes_the_memory_of_one():
    """A million numbers of tape would be thousands of steps; it is that of short steps, one after the other."""
    unit = Instance("slider_crank", outputs=["*", "crank.angle/A.torque"])
    unit.set("solver.method", "rk4")
    unit.set("solver.step_size", 1e-4)
    unit.initialize()
    exact = by_differences(unit, ["crank.angle/A.torque"], 0.0, 0.5, 0.02)
    unit.step(0.5)
    assert unit.get("crank.angle/A.torque") == pytest.approx(exact[0], rel=1e-8)
    before = peak()
    unit.step(5.0)
    assert peak() - before < 30_000  # kB; 50 000 steps would take gigabytes


def peak() -> int:
    """The most memory that this process has taken [kB]."""
    status = Path("/proc/self/status")
    if not status.is_file():
        pytest.skip("this system does not tell the memory of a process")
    return int(re.search(r"VmHWM:\s+(\d+)", status.read_text())[1])


@pytest.mark.slow
def test_a_step_without_derivative_is_refused_and_leaves_the_state():
    """The root of an input at zero; and a rank that is not sure, where the five-bar passes a singular position by a
    formulation that does not look out for it."""
    m, _, A, *_ = hinged("rooted", bar="rod", weight=0.0, independent=True)
    m.drive(A, ca.sqrt(m.input("u", "1", start=0.25)) * m.parameter("k", 2.0, "N.m"))
    unit = initialized(Instance(m, outputs=["*", "rod.angle/u"]))
    unit.step(0.02)
    state, derivative = unit.save(), unit.get("rod.angle/u")
    assert derivative > 0
    unit.set("u", 0.0)
    with pytest.raises(alfmu.StepError, match=r"rooted, t = 0.04 s: rod.angle/u cannot be computed over this step"):
        unit.step(0.02)
    assert unit.get("rod.angle/u") == derivative
    unit.set("u", 0.25)
    unit.step(0.02)
    after = unit.read()
    unit.restore(state)
    unit.step(0.02)
    assert np.array_equal(unit.read(), after)
    rank = Instance("five_bar", outputs=["*", "link1.angle/A.torque"])
    rank.set("solver.method", "rk4")
    rank.set("solver.formulation", "dae")
    rank.initialize()

    def through_the_singular_position() -> None:
        for k in range(20):
            for j, name in enumerate(("A.torque", "D.torque")):
                rank.set(name, 0.3 * np.sin(0.3 * (k + 1) + j))
            rank.step(0.05)

    with pytest.raises(alfmu.StepError, match=r"link1.angle/A.torque cannot be computed over this step"):
        through_the_singular_position()


@pytest.mark.slow
def test_what_is_not_there_is_refused_by_name(tmp_path, capsys):
    for pattern, says in (
        (
            "link9.angle/A.torque",
            "no output 'link9.angle' for the derivative 'link9.angle/A.torque' over a step; did you",
        ),
        ("link1.angle/B.torque", "no input 'B.torque' for the derivative"),
        ("monitor.energy/A.torque", "no output 'monitor.energy' for the derivative"),
        ("link1.angle/", "no input '' for the derivative"),
        ("link1.angle/A.torque/D.torque", "no input 'A.torque/D.torque' for"),
    ):
        with pytest.raises(alfmu.InputError, match=re.escape(says)):
            Instance("five_bar", outputs=["*", pattern])
    assert main(["export", "five_bar", "-o", str(tmp_path / "x.fmu"), "--outputs", "link1.angle/x"]) == 1
    assert "no input 'x'" in capsys.readouterr().err
    assert not (tmp_path / "x.fmu").exists()
    with pytest.raises(alfmu.InputError, match=r"the oracle has no derivatives over a step, as link1.angle/A.torque"):
        alfmu.simulate("five_bar", 0.1, 0.02, outputs=["link1.angle/A.torque"], kernel="oracle")
    m, _, A, *_ = hinged("rubbing", bar="rod", weight=0.0, independent=True)
    m.friction(A, coulomb=0.2, radius=0.02)
    m.drive(A, m.input("A.torque", "N.m"))
    for kind in ("python", "native"):
        with pytest.raises(alfmu.InputError, match="rubbing: derivatives of a run with dry friction"):
            alfmu.export(m, tmp_path / "x.fmu", kind=kind, outputs=["rod.angle/A.torque"])
    assert not (tmp_path / "x.fmu").exists()


@pytest.mark.slow
def test_of_forces_that_may_jump_it_says_so(caplog):
    with caplog.at_level(logging.WARNING, "alfmu"):
        Instance("end_stop", outputs=["*"])
        assert not caplog.records
        Instance("end_stop", outputs=["*", "*.angle/*"])
    assert sum("omit the effect of jumps" in each.message for each in caplog.records) == 1


@pytest.mark.slow
def test_recipes_commands_and_runs_have_it(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("arm.py").write_text(
        'import alfmu\nrecipe = alfmu.Recipe("slider_crank", measure=["A"], outputs=["A.angle/A.torque"], '
        'parameters={"solver.method": "rk4"})\n'
    )
    assert main(["export", "arm.py"]) == 0
    assert main(["simulate", "arm.py", "--stop-time", "0.2"]) == 0
    assert main(["info", "arm.py", "--all"]) == 0
    assert "A.angle/A.torque" in capsys.readouterr().out
    with Fmu("arm.fmu") as fmu:
        assert [v.name for v in fmu.outputs] == ["A.angle", "A.angle/A.torque"]
    found = fmpy.simulate_fmu("arm.fmu", stop_time=0.2, output_interval=0.02)
    mine = alfmu.Result.from_csv("arm.csv")
    assert np.array_equal(found["A.angle/A.torque"], mine["A.angle/A.torque"])
    assert mine["A.angle/A.torque"][0] == 0.0
    assert mine["A.angle/A.torque"][1:].all()
    recipe = alfmu.Recipe("slider_crank", measure=["A"], outputs=["A.angle/A.torque"])
    assert alfmu.derivatives(recipe, ["l2"], 0.1, 0.02).result.names == ("A.angle", "A.torque", "slider.force")
    assert "A.angle/A.torque" not in linearize(recipe).outputs


@pytest.mark.parametrize(
    ("one", "other", "name"),
    [
        *(("rad", "N.m", "rad/(N.m)"), ("m", "N", "m/N"), ("rad/s", "N.m", "rad/(s.N.m)"), ("N.m", "A", "N.m/A")),
        *(("m/s2", "N", "m/(s2.N)"), ("rad", "rad", "1"), ("N", "1", "N"), ("1", "V", "1/V")),
        ("rad/s2", "m/s", "rad/(s.m)"),
    ],
)
def test_units_of_quotients(one, other, name):
    assert quotient(one, other) == name
    exponents = {
        base: UNITS[one].exponents.get(base, 0) - UNITS[other].exponents.get(base, 0)
        for base in ("kg", "m", "s", "A", "rad")
    }
    assert composed(name).exponents == {base: x for base, x in exponents.items() if x}
    with pytest.raises(alfmu.DeclarationError):
        composed("%")


# Directional derivatives ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("name", "version"), [("slider_crank", 2), ("five_bar", 3)])
def test_every_output_has_its_derivatives_by_every_parameter_start_value_and_input(tmp_path, name, version):
    """While the run begins, and by inputs later; against differences of what is read. No parameter is tunable: a host
    can set none later, and is told so."""
    path = alfmu.export(
        name, tmp_path / "x.fmu", kind="native", fmi=version, parameters={"start.angle": 0.4}, reference=False
    )
    unit, description = slave_of(path, version)
    real, get, put = (
        ("Real", unit.getReal, unit.setReal) if version == 2 else ("Float64", unit.getFloat64, unit.setFloat64)
    )
    numbers = [v for v in description.modelVariables if v.type == real]
    assert not any(v.variability == "tunable" for v in numbers)
    errors = [f"monitor.{each}" for each in ("*_error", "distance", "work")]
    of = [
        v.valueReference
        for v in numbers
        if v.causality == "output" and not any(fnmatchcase(v.name, each) for each in errors)
    ]
    inputs = [v.valueReference for v in numbers if v.causality == "input"]
    known = [v.valueReference for v in numbers if v.causality == "parameter" and not v.name.startswith("solver.")]

    def differences(by: list[int]) -> np.ndarray:
        columns = []
        for each in by:
            (at,) = get([each])
            h, column = 1e-4 * max(1.0, abs(at)), 0.0
            for times, weight in STENCIL.items():
                put([each], [at + times * h])
                column = column + weight * np.array(get(of)) / h
            put([each], [at])
            columns.append(column)
        return np.array(columns).T

    def directional(by: list[int]) -> np.ndarray:
        return np.array([unit.getDirectionalDerivative(of, [each], [1.0]) for each in by]).T

    def agree(by: list[int]) -> np.ndarray:
        found, exact = directional(by), differences(by)
        assert np.abs(found - exact).max() <= 1e-10 * np.abs(exact).max()
        if version == 3:
            weights = np.cos(np.arange(len(of)))
            back = unit.getAdjointDerivative(of, by, list(weights), len(by))
            np.testing.assert_allclose(back, weights @ found, rtol=1e-10, atol=1e-10 * np.abs(weights @ found).max())
        return exact

    exact = agree([*known, *inputs])
    assert exact.shape[0] > 40
    assert (np.abs(exact).max(0) > 0).all()
    unit.exitInitializationMode()
    for k in range(5):
        unit.doStep(0.02 * k, 0.02)
    agree(inputs)
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.getDirectionalDerivative(of, known[:1], [1.0])
    unit.terminate()
    unit.freeInstance()


@pytest.mark.parametrize(("kind", "version"), [("native", 2), ("native", 3), ("python", 2)])
def test_inputs_that_move_something_move_the_start(tmp_path, kind, version):
    """A host may read, set and read again while the run begins: outputs, their derivatives and the run follow."""
    m = alfmu.Mechanism("carriage")
    x = m.input("x", "m")
    th = m.coordinate("th", "rad", start=-1.2, independent=True)
    rod = m.bar("rod", mass=1.0, length=m.parameter("l", 0.5, "m", minimum=1e-3))
    m.revolute("A", m.ground.at(x, 0), rod.start, coordinate=th)
    m.gravity(0, -9.81)
    unit, description = slave_of(alfmu.export(m, tmp_path / "x.fmu", kind=kind, fmi=version, reference=False), version)
    get, put = (unit.getReal, unit.setReal) if version == 2 else (unit.getFloat64, unit.setFloat64)
    reference = {v.name: v.valueReference for v in description.modelVariables}
    at, l, place = reference["x"], reference["l"], [reference["rod.x"]]
    (before,) = get(place)
    put([at], [0.05])
    assert get(place)[0] == pytest.approx(before + 0.05, abs=1e-12)
    (unknown,) = (each for each in description.initialUnknowns if each.variable.name == "rod.x")
    assert "x" in [each.name for each in unknown.dependencies]
    if kind == "native":
        by_length, by_place = (unit.getDirectionalDerivative(place, [each], [1.0])[0] for each in (l, at))
        assert by_place == pytest.approx(1.0, abs=1e-12)
        together = unit.getDirectionalDerivative(place, [l, at], [1.0, 1.0])
        assert together[0] == pytest.approx(by_length + by_place, abs=1e-12)
    if version == 3:
        assert unit.getAdjointDerivative(place, [at], [1.0], 1)[0] == pytest.approx(1.0, abs=1e-12)
    unit.exitInitializationMode()
    unit.doStep(0.0, 0.001)
    assert get(place)[0] == pytest.approx(before + 0.05, abs=1e-4)
    unit.terminate()
    unit.freeInstance()


@pytest.mark.slow
def test_an_fmu_of_kind_python_claims_no_directional_derivatives(built):
    """pythonfmu's library answers the call with an error, and asks no Python code."""
    unit, description = slave_of(built("five_bar", "python", 2), 2)
    assert not description.coSimulation.providesDirectionalDerivative
    unit.exitInitializationMode()
    names = [unit.references[name] for name in ("link1.angular_acceleration", "A.torque")]
    with pytest.raises(fmpy.fmi1.FMICallException):
        unit.getDirectionalDerivative(names[:1], names[1:], [1.0])
    unit.terminate()
    unit.freeInstance()
