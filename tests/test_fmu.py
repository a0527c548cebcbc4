"""FMUs through fmpy: the same numbers as the library, the life cycle of FMI 2.0, and every refusal."""

import csv
import hashlib
import posixpath
import re
import subprocess
import sys
import uuid
import zipfile
from itertools import pairwise
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from archives import replaced
from scenes import initialized

import alfmu
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.simulation import run

CASES = [
    ("five_bar", {}),
    ("four_bar", {}),
    ("particle_on_circle", {}),
    *(("slider_crank", {"coordinates": c}) for c in ("absolute", "joint", "mixed", "natural")),
    ("flexible_four_bar", {}),
    ("end_stop", {}),
]
LOADS = {"particle_on_circle": {"force.y": 0.7}, "flexible_four_bar": {"O.torque": 0.3}, "end_stop": {"O.torque": 0.3}}
each_case = pytest.mark.parametrize(("name", "options"), CASES, ids=["_".join([n, *o.values()]) for n, o in CASES])


def variables(description):
    return {v.name: v for v in description.modelVariables}


@pytest.mark.slow
@each_case
def test_fmpy_and_alfmu_find_no_problem(exported, name, options):
    """All that is of a mechanism by itself; what the slave does, by two of them."""
    assert validate(exported(name, **options), static=name not in ("five_bar", "flexible_four_bar")) == []


@pytest.mark.slow
@each_case
def test_the_fmu_gives_the_numbers_of_the_library_to_the_last_bit(exported, name, options):
    inputs = LOADS.get(name, {"A.torque": 0.3})
    with Fmu(exported(name, **options)) as fmu:
        through_fmi = run(fmu, 1.5, 0.03, inputs)
    equations = alfmu.derive(alfmu.load(name, **options))
    library = alfmu.simulate(equations, 1.5, 0.03, inputs=inputs)
    assert through_fmi.names == library.names
    assert np.array_equal(through_fmi.values, library.values)
    assert np.abs(library.values).max() > 0.1


def test_fmpy_simulate_holds_the_bar_of_the_five_bar(exported):
    """20 s at dt = 0.02 s: the exact angle within 1.5e-5 rad, |Phi| below 1e-13 (tests/test_five_bar.py: reactions)."""
    from scipy.integrate import solve_ivp

    output = ["link1.angle", "monitor.position_error", "multiplier[1]", "A.force.x"]
    result = fmpy.simulate_fmu(str(exported("five_bar")), stop_time=20.0, output_interval=0.02, output=output)
    assert result["time"][-1] == pytest.approx(20.0)
    # (m1/3 + m3/3 + m2 + m4/4) th'' = -(m1/2 + m3/2 + m2 + m4/2) g cos th with unit masses and length.
    exact = solve_ivp(
        lambda t, y: [y[1], -2.5 * 9.81 * np.cos(y[0]) / (2 / 3 + 1.25)],
        (0, 20.0 + 1e-9),
        [0.0, 2.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        t_eval=np.minimum(result["time"], 20.0),
    ).y[0]
    assert np.abs(result["link1.angle"] - exact).max() < 1.5e-5
    assert result["monitor.position_error"].max() < 1e-13
    assert result["link1.angle"].min() < -np.pi  # beyond both singular positions, 0 and -pi


def test_communication_steps_of_any_length_keep_time_and_order(exported):
    """Steps that change, are no multiple of the internal step, or are shorter than it: RK4's error all the same."""
    lengths = np.tile([0.013, 0.05, 0.002, 0.0351], 10)
    errors = []
    for step_size in (0.01, 0.005, 0.0025):
        with Fmu(exported("slider_crank")) as fmu, Fmu(exported("slider_crank")) as even:
            for unit in (fmu, even):
                initialized(unit, {"solver.method": "rk4", "solver.step_size": step_size})
            time = 0.0
            for length in lengths:
                fmu.step(length, time)
                time += length
            even.set("solver.step_size", 1.0)  # refused: the run has begun
            with pytest.raises(alfmu.StepError, match="fixed once the run has begun"):
                even.step(0.1, 0.0)
            fine = alfmu.simulate(
                "slider_crank", time, time, parameters={"solver.method": "rk4", "solver.step_size": 2e-4}
            )
            wanted = ["crank.angle", "slider.position", "guide.force"]
            got = dict(zip([v.name for v in fmu.outputs], fmu.read(), strict=True))
            errors.append([abs(got[n] - fine[n][-1]) for n in wanted])
    # Order 4: halving the step divides the error by about 16; communication steps shorter than the internal one
    # (0.002, and the rests of the others) make the mean internal step shrink by less than half, so 8 is asked for.
    for coarse, finer in pairwise(errors):
        assert (np.array(coarse) > 8 * np.array(finer)).all(), errors


def test_outputs_are_consistent_after_initialisation_and_follow_the_inputs(exported):
    with Fmu(exported("slider_crank")) as fmu:
        initialized(fmu, {"A.torque": 2.0})
        names = [v.name for v in fmu.outputs]
        before = dict(zip(names, fmu.read(), strict=True))
        fmu.set("A.torque", 5.0)
        after = dict(zip(names, fmu.read(), strict=True))
        instant = {u.variable.name for u in fmu.description.outputs if u.dependencies}
        changed = {name for name in names if before[name] != after[name]}
        assert changed <= instant
        assert {"crank.angular_acceleration", "B.force.x", "guide.force"} <= changed
        # Newton's law for the slider holds at this very instant and for these inputs.
        assert after["C.force.x"] == pytest.approx(1.0 * after["slider.acceleration"], rel=1e-12)
        # The state does not move when an input does.
        assert after["crank.angle"] == before["crank.angle"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "name", "options"),
    [
        *(("python", *case) for case in CASES),
        *(("native", name, {}) for name in ("five_bar", "particle_on_circle", "flexible_four_bar", "bennett")),
    ],
    ids=str,
)
def test_state_is_saved_restored_and_serialised_bit_by_bit(fmu_of, kind, name, options):
    path = fmu_of(name, options, kind=kind)
    with Fmu(path) as fmu, Fmu(path) as other:
        fmu.initialize()
        for i in range(7):
            fmu.step(0.05, 0.05 * i)
        state = fmu.save()
        expected = []
        for i in range(7, 12):
            fmu.step(0.05, 0.05 * i)
            expected.append(fmu.read())
        for unit in (fmu, other):
            unit.restore(state)
            assert unit.save() == state
            for i, row in zip(range(7, 12), expected, strict=True):
                unit.step(0.05, 0.05 * i)
                assert np.array_equal(unit.read(), row)


def test_reset_gives_the_defaults_back(exported):
    with Fmu(exported("five_bar")) as fmu:
        initialized(fmu, {"m2": 0.0, "solver.formulation": "classic"})
        fmu.step(0.1, 0.0)
        fmu.reset()
        fmu.initialize()
        with Fmu(exported("five_bar")) as new:
            new.initialize()
            assert np.array_equal(fmu.read(), new.read())


@pytest.mark.slow
def test_parameters_reach_the_equations(exported):
    for parameters in ({"m2": 0.0}, {"solver.formulation": "classic", "solver.penalty": 1e6}, {"l": 2.0, "g": 1.6}):
        with Fmu(exported("five_bar")) as fmu:
            through_fmi = run(fmu, 1.0, 0.02, parameters=parameters)
        library = alfmu.simulate("five_bar", 1.0, 0.02, parameters=parameters)
        assert np.array_equal(through_fmi.values, library.values)
        assert not np.array_equal(library.values, alfmu.simulate("five_bar", 1.0, 0.02).values)


# Refusals -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_input_discards_the_step_and_a_good_one_continues(exported, bad):
    with Fmu(exported("five_bar")) as fmu, Fmu(exported("five_bar")) as undisturbed:
        for unit in (fmu, undisturbed):
            unit.initialize()
            unit.step(0.1, 0.0)
        fmu.set("A.torque", bad)
        with pytest.raises(alfmu.StepError, match=r"five_bar: A.torque is .*finite number in N.m"):
            fmu.step(0.1, 0.1)
        assert np.array_equal(fmu.read(), undisturbed.read())
        fmu.set("A.torque", 0.0)
        fmu.step(0.1, 0.1)
        undisturbed.step(0.1, 0.1)
        assert np.array_equal(fmu.read(), undisturbed.read())


@pytest.mark.parametrize("length", [0.0, -0.1, np.nan, np.inf])
def test_a_bad_step_is_discarded(exported, length):
    with Fmu(exported("five_bar")) as fmu:
        fmu.initialize()
        before = fmu.read()
        with pytest.raises(alfmu.StepError, match="above zero"):
            fmu.step(length, 0.0)
        assert np.array_equal(fmu.read(), before)
        fmu.step(0.02, 0.0)


def test_a_step_from_another_time_is_discarded(exported):
    with Fmu(exported("five_bar")) as fmu:
        fmu.initialize()
        with pytest.raises(alfmu.StepError, match=r"the state is at t = 0 s"):
            fmu.step(0.1, 5.0)


@pytest.mark.parametrize(("kind", "bad"), [("python", np.nan), ("native", 1e30)])
def test_discarded_steps_are_seen_by_fmpy(fmu_of, kind, bad):
    """`simulate_fmu` ends early without an exception: the last time reached tells. It repeated steps for ever."""
    torque = np.array([(0.0, 0.0), (0.5, 0.0), (0.52, bad), (1.0, 0.0)], dtype=[("time", float), ("A.torque", float)])
    given = {"stop_time": 1.0, "output_interval": 0.02, "input": torque, "timeout": 60.0}
    result = fmpy.simulate_fmu(str(fmu_of("four_bar", kind=kind, reference=False)), **given)
    assert 0.4 < result["time"][-1] < 0.6
    assert len(result) < 40


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"m2": -1.0}, "m2 = -1 kg is outside"),
        ({"l": np.nan}, "l is nan"),
        ({"solver.step_size": 0.0}, "solver.step_size = 0 s is outside"),
        ({"solver.formulation": "magic"}, "'magic'; use one of residual, classic"),
    ],
)
def test_a_bad_parameter_ends_the_initialisation_with_its_reason(exported, values, words):
    with Fmu(exported("five_bar")) as fmu:
        for name, value in values.items():
            fmu.set(name, value)
        with pytest.raises(alfmu.StepError, match="five_bar") as caught:
            fmu.initialize()
        assert words in str(caught.value)


def test_a_refused_value_does_not_outlive_a_restored_state(exported):
    with Fmu(exported("five_bar")) as fmu:
        fmu.initialize()
        state = fmu.save()
        fmu.set("A.torque", np.nan)
        fmu.restore(state)
        fmu.step(0.02, 0.0)


def test_a_bad_parameter_can_be_mended_before_initialisation(exported):
    with Fmu(exported("five_bar")) as fmu:
        fmu.set("m2", -1.0)
        initialized(fmu, {"m2": 0.5})
        fmu.step(0.02, 0.0)


def test_a_mechanism_that_cannot_be_assembled_says_so(exported):
    with Fmu(exported("slider_crank")) as fmu:
        fmu.set("l2", 0.2)
        with pytest.raises(alfmu.StepError, match=r"slider_crank: the loops cannot be closed; .* gap of 0\.\d+ m at"):
            fmu.initialize()


def test_an_unknown_name_is_refused(exported):
    with Fmu(exported("five_bar")) as fmu, pytest.raises(alfmu.InputError, match="no input or parameter 'm9'"):
        fmu.set("m9", 1.0)


# Several in one process -----------------------------------------------------------------------------------------------

SEVERAL = """
import fmpy, numpy as np, sys
paths, step = sys.argv[1:], 0.02
single = [fmpy.simulate_fmu(p, stop_time=1.0, output_interval=step) for p in paths]
again = [fmpy.simulate_fmu(p, stop_time=1.0, output_interval=step) for p in reversed(paths)][::-1]
for a, b in zip(single, again):
    assert len(a) == 51 and a.dtype == b.dtype and all(np.array_equal(a[n], b[n]) for n in a.dtype.names)
units = []
for p in paths + paths:
    d = fmpy.read_model_description(p)
    f = fmpy.instantiate_fmu(fmpy.extract(p), d, "CoSimulation")
    f.setupExperiment(startTime=0.0); f.enterInitializationMode(); f.exitInitializationMode()
    outputs = [v for v in d.modelVariables if v.causality == "output" and v.type == "Real"]
    units.append((f, [(v.name, v.valueReference) for v in outputs]))
for i in range(50):
    for f, _ in units:
        f.doStep(i * step, (i + 1) * step - i * step)
for (f, outputs), result in zip(units, single + single):
    values = f.getReal([r for _, r in outputs])
    assert all(result[n][-1] == x for (n, _), x in zip(outputs, values))
print("undisturbed")
"""


@pytest.mark.slow
def test_instances_mechanisms_and_versions_in_one_process_do_not_disturb_each_other(exported, tmp_path):
    """Two mechanisms, two versions of one mechanism, each twice, interleaved and one after the other."""
    second = alfmu.export("five_bar", tmp_path / "second.fmu", parameters={"m4": 3.0})
    paths = [exported("five_bar"), second, exported("four_bar"), exported("slider_crank", coordinates="natural")]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", SEVERAL, *map(str, paths)], capture_output=True, text=True, timeout=300
    )
    assert "undisturbed" in done.stdout, done.stderr


def test_many_instances_of_one_fmu_one_after_another(exported):
    for _ in range(20):
        with Fmu(exported("particle_on_circle")) as fmu:
            fmu.initialize()
            fmu.step(0.02, 0.0)


ENDING = """
import atexit, ctypes, sys
from alfmu.fmi.drive import Fmu

register, ends = atexit.register, []
def noted(call, *given, **named):
    ends.append(ctypes.cast(call, ctypes.c_void_p).value if isinstance(call, ctypes._CFuncPtr) else None)
    return register(call, *given, **named)
atexit.register = noted
for path in [*sys.argv[1:], sys.argv[1]]:
    with Fmu(path) as fmu:
        fmu.initialize()
        fmu.step(0.01, 0.0)
print(len({each for each in ends if each}))
"""
"""Each unpacked FMU has a library of its own, of which a function is to run when Python ends."""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="as on Linux")
def test_the_library_of_an_fmu_gives_up_its_interpreter_before_the_process_ends(exported):
    paths = [exported("five_bar"), exported("four_bar")]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", ENDING, *map(str, paths)], capture_output=True, text=True, timeout=300
    )
    assert (done.stdout.split(), done.returncode) == (["3"], 0), done.stderr


# The file -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_same_input_same_bytes_also_from_another_process(exported, tmp_path):
    code = "import sys, alfmu; alfmu.export('five_bar', sys.argv[1], kind='python')"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "other.fmu")], check=True, timeout=300)
    digests = {hashlib.sha256(p.read_bytes()).hexdigest() for p in (exported("five_bar"), tmp_path / "other.fmu")}
    assert len(digests) == 1


@pytest.mark.slow
def test_other_content_other_guid(exported, tmp_path):
    guids = [fmpy.read_model_description(str(exported("five_bar"))).guid]
    for parameters in ({"m2": 2.0}, {"solver.formulation": "classic"}):
        path = alfmu.export("five_bar", tmp_path / "x.fmu", kind="python", parameters=parameters)
        guids.append(fmpy.read_model_description(str(path)).guid)
    assert len(set(guids)) == 3
    for guid in guids:
        assert uuid.UUID(guid).version == 5


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["native", "python"])
def test_defaults_changed_at_export_are_the_defaults_of_the_fmu(tmp_path, kind):
    parameters = {"m4": 3.0, "start.angle": 0.4, "A.torque": 1.5, "solver.max_iterations": 7, "solver.penalty": 1e7}
    given = {**parameters, "solver.formulation": "classic"}
    path = alfmu.export("five_bar", tmp_path / "x.fmu", kind=kind, parameters=given)
    found = variables(fmpy.read_model_description(str(path)))
    assert {name: float(found[name].start) for name in parameters} == parameters
    choice = found["solver.formulation"]
    names = [item.name for item in choice.declaredType.items] if kind == "native" else []
    assert (names[int(choice.start) - 1] if names else choice.start) == "classic"
    with Fmu(path) as fmu:
        through_fmi = run(fmu, 0.5, 0.02)
    library = alfmu.simulate("five_bar", 0.5, 0.02, parameters=given)
    assert np.array_equal(through_fmi.values, library.values)


def test_the_description_says_what_a_tool_wants_to_know(exported):
    description = fmpy.read_model_description(str(exported("five_bar")))
    found = variables(description)
    assert {v.type for v in found.values()} == {"Real", "Integer", "String"}
    assert all(v.description for v in found.values())
    assert all(v.unit for v in found.values() if v.type == "Real")
    assert float(found["m2"].min) == 0.0
    assert found["A.torque"].unit == "N.m"
    assert found["link1.angle"].displayUnit == "deg"
    exponents = {u.name: u.baseUnit for u in description.unitDefinitions}
    newton_metre = exponents["N.m"]
    assert (newton_metre.kg, newton_metre.m, newton_metre.s) == (1, 2, -2)
    assert exponents["rad/s"].rad == 1
    assert {v.variability for v in found.values() if v.causality == "parameter"} == {"fixed"}
    assert description.coSimulation.canGetAndSetFMUstate
    assert description.coSimulation.canSerializeFMUstate
    assert not description.coSimulation.needsExecutionTool
    assert description.defaultExperiment.stopTime == "20"
    assert {u.variable.name for u in description.initialUnknowns} == {u.variable.name for u in description.outputs}
    instant = {u.variable.name: [d.name for d in u.dependencies] for u in description.outputs}
    assert instant["link1.angle"] == []
    assert instant["A.force.x"] == ["A.torque", "D.torque"]


def test_the_names_that_users_rely_on(exported):
    def outputs_of(*bodies: str) -> set[str]:
        quantities = ["x", "y", "angle", "vx", "vy", "angular_velocity", "ax", "ay", "angular_acceleration"]
        return {f"{b}.{q}" for b in bodies for q in quantities}

    monitors = {
        f"monitor.{m}"
        for m in (
            *("position_error", "velocity_error", "energy", "work", "step_error"),
            *("iterations", "distance", "singular"),
        )
    }
    solver = {f"solver.{s}" for s in ("step_size", "penalty", "tolerance", "max_iterations", "formulation", "branch")}
    solver |= {f"solver.{s}" for s in ("method", "relative_tolerance", "absolute_tolerance", "input_order")}
    start = {"start.angle", "start.angular_velocity"}
    pins = {"A", "B", "C", "D", "E", "F"}
    names = set(variables(fmpy.read_model_description(str(exported("five_bar")))))
    assert names == (
        outputs_of("link1", "link2", "link3", "link4")
        | {f"{j}.force.{axis}" for j in pins for axis in "xy"}
        | {f"multiplier[{i}]" for i in range(1, 9)}
        | {"l", "m1", "m2", "m3", "m4", "g", "A.torque", "D.torque"}
        | monitors
        | solver
        | start
    )
    for coordinates in ("absolute", "joint", "mixed", "natural"):
        names = set(variables(fmpy.read_model_description(str(exported("slider_crank", coordinates=coordinates)))))
        assert {n for n in names if not n.startswith("multiplier")} == (
            outputs_of("crank", "rod", "slider")
            | {f"{j}.force.{axis}" for j in "ABC" for axis in "xy"}
            | {"guide.force", "guide.moment", "slider.position", "slider.velocity", "slider.acceleration"}
            | {"l1", "l2", "b", "m1", "m2", "m3", "g", "A.torque", "slider.force"}
            | monitors
            | solver
            | start
        )


def test_the_archive_is_clean_and_complete(exported):
    with zipfile.ZipFile(exported("five_bar")) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        assert not [n for n in names if n.startswith((".", "/")) or "\\" in n or "__pycache__" in n]
        assert {i.date_time for i in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        assert {
            "modelDescription.xml",
            "model.png",
            "documentation/index.html",
            "documentation/externalDependencies.txt",
            "documentation/licenses/alfmu.txt",
            "documentation/licenses/pythonfmu.txt",
        } <= set(names)
        assert archive.read("model.png").startswith(b"\x89PNG")
        entry = archive.read("resources/slavemodule.txt").decode()
        assert "class FiveBar(Slave)" in archive.read(f"resources/{entry}.py").decode()  # that of fmus/five_bar.py
        page = archive.read("documentation/index.html").decode()
        assert "link1" in page
        assert "E ---- link4 ---- F" in page
        assert "<table>" in page
        assert posixpath.normpath("documentation/" + re.search(r'<img src="(.*?)"', page)[1]) in names
        assert ET.fromstring(archive.read("modelDescription.xml")).get("guid")
        assert b"libraries" not in archive.read("documentation/externalDependencies.txt")
        assert b"no package" in archive.read("documentation/externalDependencies.txt")


@pytest.mark.slow
def test_the_model_says_whose_and_of_when_it_is_and_how_exact_a_run(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    m = alfmu.Mechanism("credited", author="A. Turner")
    m.kinetic_energy(m.rate(m.coordinate("x", "m", start=1.0, independent=True)) ** 2)
    given = {"solver.method": "explicit", "solver.relative_tolerance": 1e-5}
    root = ET.fromstring(zipfile.ZipFile(alfmu.export(m, tmp_path, parameters=given)).read("modelDescription.xml"))
    wanted = {"author": "A. Turner", "license": "MIT", "generationDateAndTime": "2023-11-14T22:13:20Z"}
    assert {name: root.get(name) for name in wanted} == wanted
    assert root.get("copyright").startswith("Copyright")
    assert float(root.find("DefaultExperiment").get("tolerance")) == 1e-5
    assert validate(tmp_path / "credited.fmu") == []
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "today")
    with pytest.raises(alfmu.ExportError, match="SOURCE_DATE_EPOCH is 'today'"):
        alfmu.export(m, tmp_path)


FOLDER = "extra/org.fmi-standard.fmi-ls-ref"


def test_reference_results_are_those_of_the_scene(exported):
    """In the form of experiments, which the manifest of FMI-LS-REF lists; inputs stand still in one and move in one."""
    with zipfile.ZipFile(exported("slider_crank")) as archive:
        read = {
            name.removeprefix(f"{FOLDER}/"): archive.read(name)
            for name in archive.namelist()
            if name.startswith(FOLDER)
        }
    for about, given in (("smoke_test", {}), ("validation", None)):
        name = f"slider_crank_{about}"
        (experiment,) = ET.fromstring(read[f"{name}.exp"])
        times = experiment.find("TransientSimulation").attrib
        stop, step = float(times["stopTime"]), float(times["stepSize"])
        names, *rows = csv.reader(read[f"{name}_ref.csv"].decode().splitlines())
        table = np.array(rows, float)
        assert 10 < len(table) <= 1001
        assert table[-1, 0] == pytest.approx(stop, rel=1e-8)
        every = round((table[1, 0] - table[0, 0]) / step)
        inputs = {}
        if given is None:
            heads, *moving = csv.reader(read[f"{name}_in.csv"].decode().splitlines())
            columns = np.array(moving, float).T
            inputs = {head: (columns[0], column) for head, column in zip(heads[1:], columns[1:], strict=True)}
            parameters = ET.fromstring(read[f"{name}.ssv"]).findall(".//{*}Parameter")
            given = {each.get("name"): float(each[0].get("value")) for each in parameters}
            assert inputs.keys() == {"A.torque", "slider.force"}
            assert given
        library = alfmu.simulate("slider_crank", stop, step, inputs=inputs, parameters=given, held_rows=True)
        assert {n for n in library.names if n.endswith((".angle", ".force.x"))} < set(names)
        wanted = np.column_stack([library[name][::every] for name in names[1:]])
        assert table[:, 1:] == pytest.approx(wanted, rel=1e-8, abs=1e-12)
    listed = {each.get("source"): each.get("role") for each in ET.fromstring(read["fmi-ls-manifest.xml"])}
    assert listed.keys() == read.keys() - {"fmi-ls-manifest.xml"}
    assert listed["slider_crank_smoke_test.exp"] == "experiment/smoke-test"
    assert listed["slider_crank_validation.exp"] == "experiment/validation"


@pytest.mark.slow
def test_reference_results_may_be_left_out_and_are_where_a_run_ends_early(tmp_path):
    m = alfmu.Mechanism("dead_end")
    x, y = m.coordinate("x", "m", start=1.0, rate=-2.0, independent=True), m.coordinate("y", "m", start=1.0)
    m.kinetic_energy((m.rate(x) ** 2 + m.rate(y) ** 2) / 2)
    m.constraint("curve", y**2 - x**3, "m")
    m.output("place", x, "m")
    with pytest.raises(alfmu.StepError, match="locked up"):
        alfmu.simulate(m, 1.0, 0.02, parameters={"solver.method": "rk4"})
    early = alfmu.export(m, tmp_path / "m.fmu", parameters={"solver.method": "rk4"})
    for path in (alfmu.export("particle_on_circle", tmp_path / "p.fmu", reference=False), early):
        with zipfile.ZipFile(path) as archive:
            assert not [name for name in archive.namelist() if name.startswith("extra")]


def test_an_fmu_is_exported_without_leaving_modules_or_paths_behind(tmp_path):
    path, modules = list(sys.path), set(sys.modules)
    alfmu.export("particle_on_circle", tmp_path / "p.fmu")
    assert sys.path == path
    assert not [m for m in set(sys.modules) - modules if m.startswith(("particle_on_circle", "alfmu_particle"))]


@pytest.mark.slow
def test_validation_finds_what_is_wrong(exported, tmp_path):
    broken = replaced(
        exported("five_bar"), tmp_path / "broken.fmu", "modelDescription.xml", 'unit="N.m"', 'unit="lbf.ft"'
    )
    assert any("lbf.ft" in problem for problem in validate(broken, static=True))
    nothing = tmp_path / "nothing.fmu"
    nothing.write_text("no archive")
    with pytest.raises(alfmu.ExportError, match="not an FMU that can be read"):
        validate(nothing)
    with pytest.raises(alfmu.ExportError, match=r"does not end in \.fmu"):
        alfmu.export("five_bar", tmp_path / "five_bar.zip")


def test_a_folder_that_pythonfmu_cannot_read_is_refused_and_native_fmus_run_there(exported, tmp_path, monkeypatch):
    """pythonfmu's library would end the process: it decodes blanks in a URI alone."""
    native = alfmu.export("particle_on_circle", tmp_path / "native.fmu", kind="native")
    for folder in ("ü", "a#b", "50%", "a+b", "it's", "a b"):
        (tmp_path / folder).mkdir()
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path / folder))
        runs = [native]
        if folder == "a b":
            runs.append(exported("particle_on_circle"))
        else:
            with pytest.raises(alfmu.ExportError, match=r"is of kind python, .* set TMPDIR to another one"):
                Fmu(exported("particle_on_circle"))
        for path in runs:
            with Fmu(path) as fmu:
                fmu.initialize()
                fmu.step(0.02, 0.0)
        assert not list((tmp_path / folder).iterdir())


@pytest.mark.parametrize("kind", ["python", "native"])
def test_a_warning_in_the_log_of_an_fmu_is_told_once(kind, tmp_path, caplog):
    """Steps of RK4 that are too long: 0.57 of the energy is gone after 4 s."""
    with caplog.at_level("WARNING", "alfmu"):
        path = alfmu.export("slider_crank", tmp_path / "it.fmu", kind=kind, parameters={"solver.method": "rk4"})
        (warning,) = caplog.messages  # of the results that the FMU brings, of a run without work
        assert "the drift of energy has put the motion off" in warning
        caplog.clear()
        alfmu.simulate(path, 2.0, 0.05, parameters={"A.torque": 5.0})
    (warning,) = caplog.messages
    assert "the energy balance is off" in warning
