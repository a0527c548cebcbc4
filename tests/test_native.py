"""Native FMUs: the numbers of the library, everything a scene asks for, and a host that does all wrong."""

import os
import posixpath
import re
import shutil
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import fmpy
import numpy as np
import pytest
from scenes import by_rk4, cusp, derived, double_pendulum, initialized, sampled

import alfmu
from alfmu.cli import main
from alfmu.equations.interface import CHOICES
from alfmu.fmi import native
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.kernel.memory import Layout
from alfmu.model.settings import BRANCHES, FIXED, FORMULATIONS
from alfmu.runtime import build
from alfmu.simulation import prepared, run, with_defaults

HOST = Path(__file__).with_name("native_host.c")
HEADERS = Path(fmpy.__file__).parent / "c-code"
"""Of FMI, for hosts."""

CASES = [
    *(("five_bar", {}), ("four_bar", {}), ("particle_on_circle", {}), ("n_four_bar", {}), ("end_stop", {})),
    *(("slider_crank", {"coordinates": c}) for c in ("absolute", "joint", "mixed", "natural")),
    *(("flexible_four_bar", {}), ("bennett", {}), ("flyball_governor", {})),
]
LOADS = {
    **{"particle_on_circle": {"force.y": 0.7}, "flexible_four_bar": {"O.torque": 0.7}, "end_stop": {"O.torque": 5.0}},
    **{"flyball_governor": {"bearing.torque": 3.0}},
}
each_case = pytest.mark.parametrize(("name", "options"), CASES, ids=["_".join([n, *o.values()]) for n, o in CASES])

by_a_compiler = pytest.mark.skipif(not build.compiler(), reason="there is no C compiler")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]


def names_in(library: Path, *options: str, kinds: str = "") -> set[str]:
    """Symbols of a library by nm, of some kinds."""
    said = subprocess.run(["nm", *options, library], capture_output=True, text=True, check=True).stdout
    return {line.split()[-1] for line in said.splitlines() if not kinds or line.split()[-2] in kinds}


def state_of(fmu: Fmu, layout: Layout) -> np.ndarray:
    """The memory of an FMU that was saved: the last numbers of its state."""
    return np.frombuffer(fmu.save()[-8 * layout.size :]).copy()


def summed(state: bytes) -> bytes:
    """A state with the check sum, CRC-32, of what it says now."""
    return state[:8] + zlib.crc32(state[:8] + bytes(4) + state[12:]).to_bytes(4, "little") + state[12:]


def same(got, library) -> bool:
    """Whether two results are the same to the last bit."""
    return got.names == library.names and got.values.tobytes() == library.values.tobytes()


# Numbers --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@each_case
def test_the_numbers_of_the_library(built, name, options):
    """To the last bit, as both are one: at the start, in all that evolves, and in every output."""
    equations = prepared(derived(name, **options))
    stop, step = (0.1 if name == "flyball_governor" else 3.0), max(equations.step_size, 0.02)
    instance = initialized(alfmu.Instance(equations))
    with Fmu(built(name, options=options)) as fmu, Fmu(built(name, options=options)) as other:
        fmu.initialize()
        for part in ("z", "p", "k", "control", "tally", "pace"):
            offset, length = instance.layout.fields[part]
            found = state_of(fmu, instance.layout)[offset : offset + length]
            assert found.tobytes() == instance.memory[part].tobytes(), part
        assert fmu.read().tobytes() == instance.read().tobytes()
        assert same(run(other, stop, step), alfmu.simulate(equations, stop, step))
        if name in LOADS:
            other.reset()
            assert same(run(other, stop, step, LOADS[name]), alfmu.simulate(equations, stop, step, inputs=LOADS[name]))


METHODS = [
    *(("four_bar", "explicit"), ("particle_on_circle", "order8"), ("flexible_four_bar", "stiff")),
    *(("bennett", "explicit"), ("bennett", "trapezoidal")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), METHODS)
def test_methods_of_integration_give_the_numbers_of_the_library(built, name, method):
    """To the last bit; FMI's tolerance is heard by those that control their error."""
    path, stop, results = built(name, parameters={"solver.method": method}), 0.2, {}
    for tolerance in (1e-8, 1e-4):
        chosen = {"solver.method": method, "solver.relative_tolerance": tolerance}
        library = alfmu.simulate(name, stop, 0.1, parameters=chosen)  # long enough that error control decides
        given = {"stop_time": stop, "output_interval": 0.1, "output": library.names}
        results[tolerance] = found = fmpy.simulate_fmu(str(path), relative_tolerance=tolerance, **given)
        assert np.array_equal(found["time"], library.time)
        assert all(np.array_equal(found[n], library[n]) for n in library.names)
    assert (results[1e-8].tobytes() == results[1e-4].tobytes()) == (method in FIXED)
    with Fmu(path) as fmu:
        fmu.initialize()
        fmu.step(0.02, 0.0)
        state = fmu.save()
        first = [fmu.step(0.02, 0.02), fmu.read()][1].copy()
        fmu.restore(state)
        fmu.step(0.02, 0.02)
        assert fmu.read().tobytes() == first.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("name", list(dict(CASES)))
def test_validation_finds_nothing(fmu_of, name):
    assert validate(fmu_of(name, kind="native")) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["five_bar", "slider_crank", "particle_on_circle", "flexible_four_bar", "end_stop"])
def test_variables_are_those_of_the_python_fmu(built, exported, name):
    paths = built(name, interface="cs"), exported(name)
    described = [fmpy.read_model_description(str(path)) for path in paths]
    kept = [
        [
            (v.name, v.valueReference, v.causality, v.type, v.unit, v.start, v.min, v.description)
            for v in d.modelVariables
            if v.name not in CHOICES
        ]
        for d in described
    ]
    assert kept[0] == kept[1]
    choices = [[v for v in d.modelVariables if v.name in CHOICES] for d in described]
    for here, there in zip(*choices, strict=True):
        items = here.declaredType.items
        assert (here.name, here.valueReference, here.causality) == (there.name, there.valueReference, there.causality)
        assert (here.type, items[int(here.start) - 1].name) == ("Enumeration", there.start)
        assert all(item.description == CHOICES[here.name][item.name] for item in items)
        carried = {"solver.formulation": [*FORMULATIONS], "solver.branch": [*BRANCHES]}
        carried["solver.method"] = ["rk4", "auto"]
        assert [item.name for item in items] == carried[here.name]
    follow = [{u.variable.name: [v.name for v in u.dependencies] for u in d.outputs} for d in described]
    assert follow[0] == follow[1]


SCENES = {
    "locks": (
        {"B.locked": lambda t: 0.1 < t < 0.3, "E.released": lambda t: t >= 0.5, "F.released": lambda t: t > 0.6},
        {},
    ),
    "compliances": ({}, {"B.compliance.x": 2e-6}),
    "parameters": (
        {"A.torque": 0.3},
        {"m2": 0.0, "l": 2.0, "g": 1.6, "solver.method": "rk4", "solver.step_size": 0.005},
    ),
    "impatient": ({"A.torque": 0.3}, {"solver.max_iterations": 4}),
    "paper": ({"A.torque": 0.5}, {"solver.branch": "paper"}),
}
"""Of a five-bar that is more than its defaults: inputs and values."""


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_everything_that_a_scene_asks_for(built, scene):
    inputs, values = SCENES[scene]
    m = alfmu.load("five_bar")
    values = {"start.angle": 0.7, **values}
    if scene == "locks":
        m.lock("B")
        m.release("E")
        m.release("F")
    if scene == "compliances":
        m.compliances()
        values = {v.name: 1e-6 for v in alfmu.derive(m).compliances} | values
    with Fmu(built(m)) as fmu:
        got = run(fmu, 2.0, 0.04, inputs, values)
    library = alfmu.simulate(alfmu.derive(m), 2.0, 0.04, inputs=inputs, parameters=values)
    assert same(got, library)


@pytest.mark.slow
def test_what_is_left_out_and_frozen(built):
    given = {"outputs": ["link*.angle", "monitor.energy"], "freeze": ["all"], "parameters": {"m2": 0.5}}
    with Fmu(built("five_bar", **given)) as fmu:
        got = run(fmu, 1.0, 0.02)
    assert got.names == (*(f"link{k}.angle" for k in (1, 2, 3, 4)), "monitor.energy", "A.torque", "D.torque")
    assert same(got, alfmu.simulate("five_bar", 1.0, 0.02, **given))


# Steps that cannot be made --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_step_is_refused_in_the_words_of_the_library_and_nothing_is_lost(built):
    instance = alfmu.Instance(prepared(by_rk4("four_bar")))
    with Fmu(built("four_bar")) as fmu:
        for unit in (instance, fmu):
            initialized(unit, {"solver.method": "rk4", "start.angle": 0.5})
            unit.step(0.02, 0.0)
            unit.set("A.torque", 1e6)
        said, before = [], fmu.read()
        for unit in (instance, fmu):
            with pytest.raises(alfmu.AlfmuError, match="internal steps, more than 1000000"):
                unit.step(1e5, 0.02)
            with pytest.raises(alfmu.StepError) as caught:
                unit.step(0.02, 0.02)
            said.append(str(caught.value))
        assert said[0] == said[1]
        assert "more than half a turn" in said[0]
        assert np.array_equal(fmu.read(), before)
        for unit in (instance, fmu):
            unit.set("A.torque", 0.0)
            unit.step(0.02, 0.02)
        assert fmu.read().tobytes() == instance.read().tobytes()


@pytest.mark.slow
def test_a_motion_that_ends_is_locked_up(fmu_of):
    """The library, and FMUs of both kinds, alike."""
    given = {"solver.method": "rk4", "solver.step_size": 0.005}
    instance = alfmu.Instance(prepared(alfmu.derive(cusp())))
    for name, value in given.items():
        instance.set(name, value)
    paths = [fmu_of(cusp(), kind=kind, parameters=given) for kind in ("native", "python")]
    with Fmu(paths[0]) as fmu, Fmu(paths[1]) as slave:
        said = []
        for unit in (instance, fmu, slave):
            unit.initialize()
            with pytest.raises(alfmu.StepError, match="locked up at x = "):
                unit.step(1.0, 0.0)
            unit.step(0.77, 0.0)
            with pytest.raises(alfmu.StepError, match="locked up at x = ") as caught:
                unit.step(0.05, 0.77)
            said.append(str(caught.value))
        assert said[0] == said[1]
        assert "locked up at x = " in said[2]
        assert float(said[0].split("t = ")[1].split(" s")[0]) == pytest.approx(0.7986, rel=3e-3)
        for unit in (fmu, slave):
            unit.step(0.02, 0.77)


@pytest.mark.parametrize("rate", [1e-4, 1e-2])
def test_a_slow_start_in_a_singular_position(built, rate):
    """Places from which a limit is taken have to be far apart there."""
    values = {"start.angular_velocity": rate}
    with Fmu(built("four_bar")) as fmu:
        got = run(fmu, 1.0, 0.02, {"A.torque": 4.0}, values)
    library = alfmu.simulate(prepared(derived("four_bar")), 1.0, 0.02, inputs={"A.torque": 4.0}, parameters=values)
    assert same(got, library)


# Derivatives ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("steps", [0, 20])
@pytest.mark.parametrize("name", ["five_bar", "slider_crank", "particle_on_circle"])
def test_directional_derivatives_are_differences_as_outputs_are_affine_in_the_inputs(built, name, steps):
    """Of the five-bar at the start too, which is a singular position: of the limits that are read there."""
    with Fmu(built(name)) as fmu:
        fmu.initialize()
        for k in range(steps):
            fmu.step(0.02, 0.02 * k)
        outputs = [v for v in fmu.description.modelVariables if v.causality == "output" and v.type == "Real"]
        inputs = [v for v in fmu.description.modelVariables if v.causality == "input" and v.type == "Real"]
        references = [v.valueReference for v in outputs]
        before = np.array(fmu.slave.getReal(references))
        for v in inputs:
            found = fmu.slave.getDirectionalDerivative(references, [v.valueReference], [2.0])
            fmu.set(v.name, 2.0)
            after = np.array(fmu.slave.getReal(references))
            fmu.set(v.name, 0.0)
            assert found == pytest.approx(after - before, rel=1e-9, abs=1e-9 * np.abs(after).max())
            assert np.abs(found).max() > 0.1


@pytest.mark.slow
def test_inputs_go_on_by_their_derivatives_inside_a_step(tmp_path, built):
    """A torque that grows with time: as an input with a derivative, and in the equations."""

    def pendulum(name: str, driven: bool) -> alfmu.Mechanism:
        m = alfmu.Mechanism(name)
        x, y = (m.coordinate(k, "m", start=s) for k, s in (("x", 0.4), ("y", -0.3)))
        th = m.coordinate("th", "rad", start=-0.6435)
        rod = m.bar("rod", mass=1.0, length=1.0, pose=(x, y, th))
        hinge = m.revolute("hinge", m.ground.at(0.0, 0.0), rod.start)
        m.drive(hinge, m.input("torque", "N.m")) if driven else m.torque(rod, 0.5 + 3.0 * m.time)
        m.gravity(0.0, -9.81)
        return m

    library = alfmu.simulate(pendulum("told", driven=False), 1.0, 0.1)
    with Fmu(built(pendulum("asked", driven=True))) as fmu:
        initialized(fmu, {"torque": 0.5})
        reference = [v.valueReference for v in fmu.description.modelVariables if v.name == "torque"]
        rows = [fmu.read()]
        for k in range(10):
            fmu.slave.setRealInputDerivatives(reference, [1], [3.0])
            fmu.step(0.1, 0.1 * k)
            rows.append(fmu.read())
        assert fmu.read_inputs() == pytest.approx([3.5], rel=1e-13)
    names = [v.name for v in fmu.outputs]
    wanted = np.column_stack([library[name] for name in names])
    kept = [i for i, name in enumerate(names) if name != "monitor.iterations"]
    assert np.array(rows)[:, kept] == pytest.approx(wanted[:, kept], rel=1e-10, abs=1e-11)


# Inputs from past ones ------------------------------------------------------------------------------------------------

LENGTHS = (0.02, 0.035, 0.02, 0.05, 0.01, 0.03)
"""Of communication steps [s]."""

DRIVEN = [
    *(("slider_crank", "rk4", 1), ("slider_crank", "rk4", 2), ("particle_on_circle", "explicit", 2)),
    *(("particle_on_circle", "stiff", 1), ("particle_on_circle", "trapezoidal", 2), ("four_bar", "order8", 1)),
]


def driven(unit, steps: range) -> np.ndarray:
    """Outputs under an input that swings; units that are initialised."""
    name, rows = unit.input_variables[0].name, []
    for k in steps:
        t = sum(LENGTHS) * (k // 6) + sum(LENGTHS[: k % 6])
        unit.set(name, 2 * np.sin(5 * t))
        unit.step(LENGTHS[k % 6], t)
        rows.append(unit.read())
    return np.array(rows)


def past(unit, layout: Layout) -> np.ndarray:
    """Inputs at past communication points."""
    if isinstance(unit, alfmu.Instance):
        return unit.memory["past"].copy()
    offset, length = layout.fields["past"]
    return state_of(unit, layout)[offset : offset + length]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method", "order"), DRIVEN)
def test_inputs_are_extrapolated_as_in_the_library(built, name, method, order):
    """Over 2.8 s."""
    given = {"solver.method": method, "solver.input_order": order}
    library = initialized(alfmu.Instance(prepared(with_defaults(derived(name), given))))
    with Fmu(built(name, parameters=given)) as fmu:
        fmu.initialize()
        got, wanted = driven(fmu, range(100)), driven(library, range(100))
        assert np.array_equal(past(fmu, library.layout), past(library, library.layout))
        assert past(fmu, library.layout).any()
    assert np.array_equal(got, wanted)


@pytest.mark.slow
@pytest.mark.parametrize(("order", "least"), [(1, 1.6), (2, 2.6)])
def test_a_sampled_torque_keeps_the_order(built, order, least):
    """As in the library, where held inputs are of order 1."""
    errors = []
    for step in (0.04, 0.02):
        with Fmu(built("four_bar", parameters={"solver.input_order": order})) as fmu:
            initialized(fmu, {"start.angle": -1.0, "start.angular_velocity": 0.0})
            errors.append(sampled(fmu, step))
    assert np.log2(errors[0] / errors[1]) >= least


def locked_slider_crank() -> alfmu.Mechanism:
    m = alfmu.load("slider_crank")
    m.lock("B")
    return m


@pytest.mark.slow
def test_past_inputs_through_events_refused_steps_states_and_resets(built):
    given = {"solver.method": "rk4", "solver.input_order": 2}
    library = alfmu.Instance(prepared(with_defaults(alfmu.derive(locked_slider_crank()), given)))
    layout, path = library.layout, built(locked_slider_crank(), parameters=given)
    with Fmu(path) as fmu, Fmu(path) as other:
        rows = {}
        for unit in (library, fmu):
            unit.initialize()
            rows[unit] = []
            for first, locked in ((0, False), (5, True), (10, False), (15, False)):
                unit.set("B.locked", locked)
                if first >= 10:  # at the event, and without one
                    unit.set("A.torque", 1e6)
                    before = past(unit, layout)
                    with pytest.raises(alfmu.StepError, match=r"reduce solver\.step_size"):
                        unit.step(0.05, sum(LENGTHS[k % 6] for k in range(first)))
                    assert np.array_equal(past(unit, layout), before)
                rows[unit].append(driven(unit, range(first, first + 5)))
        got, wanted = (np.concatenate(rows[unit]) for unit in (fmu, library))
        assert np.array_equal(past(fmu, layout), past(library, layout))
        assert np.array_equal(got, wanted)
        state = fmu.save()
        expected = driven(fmu, range(20, 25))
        other.restore(state)
        assert np.array_equal(driven(other, range(20, 25)), expected)
        fmu.reset()
        fmu.initialize()
        assert not past(fmu, layout).any()
        assert np.array_equal(driven(fmu, range(5)), rows[fmu][0])


def test_past_inputs_where_the_host_looks_and_returns_early(built, slave):
    """Points between internal steps are no communication points; where the host returned, the next one is."""
    path = built("slider_crank", fmi=3, parameters={"solver.method": "rk4", "solver.input_order": 2})
    asked = []

    def look(environment, time, set_requested, get_allowed, finished, can_return, wanted, until):
        wanted[0] = bool(asked)

    watched, plain = slave(path, earlyReturnAllowed=True, intermediateUpdate=look), slave(path)
    outputs = [watched.references[f"{name}.x"] for name in ("crank", "rod", "slider")]
    for unit in (watched, plain):
        unit.enterInitializationMode()
        unit.exitInitializationMode()
    for k in range(8):
        t, h = 0.06 * k, 0.06
        if k == 7:
            asked.append(True)
        for unit in (watched, plain):
            unit.setFloat64([unit.references["A.torque"]], [2 * np.sin(5 * t)])
        _, _, early, reached = watched.doStep(t, h)
        assert early == (k == 7)
        plain.doStep(t, h / 3 if early else h)
        assert watched.getFloat64(outputs) == plain.getFloat64(outputs)
    asked.clear()
    for unit in (watched, plain):
        unit.setFloat64([unit.references["A.torque"]], [-1.0])
        unit.doStep(reached, 0.06)
    assert reached == pytest.approx(0.44)
    assert watched.getFloat64(outputs) == plain.getFloat64(outputs)


@pytest.mark.slow
def test_derivatives_by_the_host_come_before_past_inputs(built):
    """One input has a derivative, the other goes on along a line, which is a derivative where none is extrapolated."""
    paths = built("slider_crank", parameters={"solver.input_order": 1}), built("slider_crank")
    h = 0.04
    with Fmu(paths[0]) as fmu, Fmu(paths[1]) as held:
        references = [
            next(v.valueReference for v in fmu.description.modelVariables if v.name == name)
            for name in ("A.torque", "slider.force")
        ]
        motion = [i for i, v in enumerate(fmu.outputs) if v.name.endswith((".angle", ".angular_velocity", ".vx"))]
        for unit in (fmu, held):
            initialized(unit, {"solver.method": "rk4"})
        for k in range(50):
            torque, force = np.sin(5 * k * h), np.cos(3 * k * h)
            before = np.sin(5 * (k - 1) * h), np.cos(3 * (k - 1) * h)
            told = k % 3 != 2
            slopes = [3.0 if told else (torque - before[0]) / h, (force - before[1]) / h if k else 0.0]
            for unit in (fmu, held):
                unit.set("A.torque", torque)
                unit.set("slider.force", force)
            fmu.slave.setRealInputDerivatives(references[:told], [1] * told, slopes[:told])
            held.slave.setRealInputDerivatives(references, [1, 1], slopes)
            for unit in (fmu, held):
                unit.step(h, k * h)
            assert fmu.read_inputs() == pytest.approx([torque + 3.0 * h * told, force], rel=1e-14)
            assert fmu.read()[motion] == pytest.approx(held.read()[motion], rel=1e-10, abs=1e-11)


@pytest.mark.slow
def test_only_a_scene_that_asks_keeps_past_inputs(built):
    found = []
    for order in (0, 1):
        with Fmu(built("slider_crank", parameters={"solver.input_order": order} if order else {})) as fmu:
            refused = f"solver.input_order is 2, but fixed at {order} here; give it where the instance, batch or FMU"
            with pytest.raises(alfmu.StepError, match=refused):
                fmu.set("solver.input_order", 2)
            fmu.initialize()
            found.append(len(fmu.save()))
    equations = (prepared(with_defaults(derived("slider_crank"), {"solver.input_order": k})) for k in (0, 1))
    lengths = [Layout(e).fields["past"][1] for e in equations]
    assert lengths[0] == 0 < lengths[1]
    assert found[1] - found[0] == 8 * lengths[1]


# Life -----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_bad_start_is_refused_in_the_words_of_the_library(built):
    for name, values in (
        ("five_bar", {"l": 0.3, "start.angle": 0.2}),
        ("four_bar", {"m1": 0.0, "m2": 0.0, "m3": 0.0}),
        ("slider_crank", {"l1": 1.0, "l2": 0.1}),
    ):
        instance = alfmu.Instance(derived(name))
        known = {v.name for v in instance.parameters}
        values = {key: value for key, value in values.items() if key in known}
        for key, value in values.items():
            instance.set(key, value)
        try:
            instance.initialize()
            said = None
        except alfmu.AlfmuError as error:
            said = str(error)
        with Fmu(built(name)) as fmu:
            for key, value in values.items():
                fmu.set(key, value)
            if said is None:
                fmu.initialize()
                continue
            with pytest.raises(alfmu.StepError) as caught:
                fmu.initialize()
            assert str(caught.value) == said


@pytest.mark.slow
@by_a_compiler
def test_a_host_that_does_all_wrong(built, sanitized, fuzz, tmp_path):
    """Under AddressSanitizer and UndefinedBehaviorSanitizer: a block that an instance or its scene leaves is told, and
    with 100 files at most, a file that it leaves open."""
    path = built(double_pendulum_with_a_torque(), parameters={"solver.method": "rk4"}, interface="cs")
    description = fmpy.read_model_description(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    named = {
        "REAL_INPUT": references["elbow.torque"],
        "REAL_OUTPUT": references["lower.angular_acceleration"],
        "PARAMETER": references["solver.step_size"],
        "TEXT": references["solver.branch"],
        "SWITCH": references["elbow.locked"],
        "GUID": f'"{description.guid}"',
        "SCENE": '"double_pendulum"',
        "RESOURCES": f'"{(tmp_path / "resources").as_uri()}"',
    }
    program = tmp_path / "host"
    defined = [f"-DHOST_{name}={value}" for name, value in named.items()]
    made = [*fuzz.compiling("address"), *defined, f"-I{HEADERS}", str(HOST), *fuzz.objects(sanitized("address"), 2)]
    subprocess.run([*made, "-lm", "-pthread", "-o", str(program)], check=True)
    limited = ["sh", "-c", 'ulimit -n 100 && exec "$0"', str(program)]
    done = subprocess.run(limited, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr[-3000:]


def double_pendulum_with_a_torque() -> alfmu.Mechanism:
    m = double_pendulum()
    m.drive(next(j for j in m.joints if j.name == "elbow"), m.input("elbow.torque", "N.m"))
    return m


# Export ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_importer_can_build_it_from_its_sources(built, tmp_path, fmi):
    """From those that the description names, alone, without any warning; the library in its place exports the functions
    of FMI alone, finds its scene and gives the numbers."""
    path = built("particle_on_circle", fmi=fmi)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
        names = archive.namelist()
    described = {2: tmp_path / "modelDescription.xml", 3: tmp_path / "sources" / "buildDescription.xml"}[fmi]
    ways = ET.parse(described).getroot().iter({2: "SourceFiles", 3: "SourceFileSet"}[fmi])
    listed = [[f.get("name") for f in way.iter({2: "File", 3: "SourceFile"}[fmi])] for way in ways]
    assert listed == listed[:1] * {2: 2, 3: 1}[fmi]  # in FMI 2, one list for each interface
    sources = listed[0]
    assert sources
    library = next(tmp_path / name for name in names if name.startswith("binaries/"))
    library.unlink()
    command = [*build.compiler(), *STRICT, "-O2", "-ffp-contract=off", "-shared", "-fPIC", *sources, "-o", str(library)]
    subprocess.run([*command, "-lm"], cwd=tmp_path / "sources", check=True)
    if sys.platform == "linux":
        functions = names_in(library, "-D", "--defined-only")
        assert {name for name in functions if not name.startswith(f"fmi{fmi}")} <= {"_init", "_fini"}
        assert f"fmi{fmi}DoStep" in functions
    again = tmp_path / "again.fmu"
    with zipfile.ZipFile(again, "w") as archive:
        for name in names:
            archive.write(tmp_path / name, name)
    with Fmu(again) as own, Fmu(path) as fmu:
        assert run(own, 1.0, 0.02).values == pytest.approx(run(fmu, 1.0, 0.02).values, rel=1e-12, abs=1e-12)


@pytest.mark.slow
def test_sources_have_one_version_of_fmi_and_the_scene_is_in_its_resources(built):
    found, scenes = [], []
    for path in (built("particle_on_circle"), built("five_bar"), built("five_bar", fmi=3)):
        with zipfile.ZipFile(path) as archive:
            names = [n for n in archive.namelist() if n.startswith("sources/") and n.endswith((".c", ".h"))]
            found.append({Path(n).name: archive.read(n).decode() for n in names})
            scenes.append(archive.read("resources/scene.bin"))
    for files, fmi in zip(found, (2, 2, 3), strict=True):
        assert list(files) == ["alfmu.c", "alfmu.h", "files.c"]
        assert set(re.findall(r"\bfmi(\d)[A-Z]\w+\(", "".join(files.values()))) == {str(fmi)}
    two, three = (native.sources(fmi) for fmi in (2, 3))
    assert {**two, "alfmu.c": ""} == {**three, "alfmu.c": ""}
    assert not [name for name, text in found[0].items() if "alfmu_run" in text or "fmi3DoStep" in text]
    assert scenes[0] != scenes[1] == scenes[2]


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("nm"), reason="nm lists names of Linux")
@pytest.mark.parametrize("fmi", [2, 3])
def test_a_library_exports_the_functions_of_its_fmi_alone(built, tmp_path, fmi):
    """By the standard's own headers. Others would meet those of another FMU in the same process."""
    library = tmp_path / "own.so"
    with zipfile.ZipFile(built("five_bar", fmi=fmi, platforms=[build.HERE])) as archive:
        (name,) = (each for each in archive.namelist() if each.startswith("binaries/"))
        library.write_bytes(archive.read(name))
    header = (HEADERS / f"fmi{fmi}FunctionTypes.h").read_text()
    assert names_in(library, "-D", "--defined-only") == set(re.findall(rf"\b(fmi{fmi}\w+)TYPE\b", header))


@pytest.mark.skipif(
    build.HERE != "linux64" or build.compiler() in (None, build.zig()), reason="other compilers make other sizes"
)
def test_the_five_bar_is_small(fmu_of):
    assert fmu_of("five_bar", kind="native", platforms=[build.HERE]).stat().st_size <= 326e3
    assert fmu_of("five_bar", kind="native", platforms=[build.HERE], sources=False).stat().st_size <= 237e3


@pytest.mark.slow
@pytest.mark.skipif(not (build.compiler() and build.compiler() != build.zig()), reason="needs a preprocessor")
def test_sources_are_those_of_the_runtime_without_comments(tmp_path):
    """A compiler reads the same."""
    for name, text in native.sources(3).items():
        assert "/*" not in text
        (tmp_path / name).write_text(text, encoding="ascii")
    folders = [each for each in build.FOLDERS if each != "binding"]
    whole = [path for path in build.sources(folders) if path.name != "fmi2.c"]
    apart = {"files": ["files.c"], "alfmu": ["fmi.h", "fmi3.c"]}
    files = {name: [path for path in whole if path.name in own] for name, own in apart.items()}
    hidden = [path for path in whole if path.suffix == ".c" and path not in (*files["files"], *files["alfmu"])]
    for name, texts in files.items():
        own = [line for path in texts for line in preprocessed(path) if not line.startswith("#include")]
        if name == "alfmu":  # what is not FMI's is hidden from an importer that compiles it
            begin, end = (
                ["#if defined(__GNUC__) && !defined(_WIN32)", f"#pragma GCC visibility {each}", "#endif"]
                for each in ("push(hidden)", "pop")
            )
            bodies = [line for path in hidden for line in preprocessed(path) if not line.startswith("#include")]
            own = [*begin, *bodies, *end, *own]
        bare = [line for line in preprocessed(tmp_path / f"{name}.c") if not line.startswith("#include")]
        assert own == bare, name


@pytest.mark.slow
@by_a_compiler
def test_sources_leave_out_what_is_never_called(tmp_path):
    """By a linker, which leaves out the same functions of the complete sources, and none of these. There is no warning,
    as of a macro that two files of the runtime define, which are one file there."""
    found = []
    for name, files in (("whole", native.sources(2)), ("used", native.used(native.sources(2)))):
        (tmp_path / name).mkdir()
        for each, text in files.items():
            (tmp_path / name / each).write_text(text, encoding="ascii")
        made = tmp_path / f"{name}.so"
        command = [*build.compiler(), *STRICT, "-O0", "-fPIC", "-shared", "-fvisibility=hidden", "-ffunction-sections"]
        command += ["-fdata-sections", "-Wl,--gc-sections", "alfmu.c", "files.c", "-o", str(made), "-lm"]
        subprocess.run(command, cwd=tmp_path / name, check=True)
        found.append(names_in(made, kinds="tT"))
    assert found[0] == found[1]
    assert "scene_compiled" in native.sources(2)["alfmu.c"]
    assert "scene_compiled" not in "".join(native.used(native.sources(2)).values())


@pytest.mark.parametrize("fmi", [2, 3])
def test_sources_are_left_out_on_request(built, fmi):
    path, whole = (built("particle_on_circle", fmi=fmi, sources=sources) for sources in (False, True))
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(whole) as other:
        files, more = set(archive.namelist()), set(other.namelist()) - set(archive.namelist())
        assert more == {name for name in other.namelist() if name.startswith("sources/")}
        assert {name for name in files if archive.read(name) != other.read(name)} <= {"modelDescription.xml"}
    assert not validate(path, static=True)
    with Fmu(path) as own, Fmu(whole) as fmu:
        assert (run(own, 0.2, 0.02).values == run(fmu, 0.2, 0.02).values).all()
    for kind in ("python", "source"):
        with pytest.raises(alfmu.ExportError, match="has no library in place of its sources; leave --no-sources out"):
            alfmu.export("particle_on_circle", kind=kind, sources=False)
        with pytest.raises(
            alfmu.ExportError, match="has no derivatives; leave --derivatives out, or use --kind native"
        ):
            alfmu.export("particle_on_circle", kind=kind, derivatives=True)


@pytest.mark.slow
@pytest.mark.skipif(not build.zig(), reason="needs Clang")
@pytest.mark.parametrize("fmi", [2, 3])
def test_clang_compiles_sources_for_linux(tmp_path, fmi):
    """There, functions have versions for several processors."""
    for name, text in native.used(native.sources(fmi)).items():
        (tmp_path / name).write_text(text, encoding="ascii")
    command = [*build.zig(), "-target", "x86_64-linux-gnu", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    command += ["-fPIC", "-c", "alfmu.c", "-o", "alfmu.o"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stderr


def preprocessed(path: Path) -> list[str]:
    """Lines of a file without comments and without blanks."""
    command = [*build.compiler(), "-fpreprocessed", "-E", "-P", str(path)]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    text = re.sub(r"#ifdef IN_SOURCES\n[^#]*#endif\n", "", text)  # for kind source alone
    return [" ".join(line.split()) for line in text.splitlines() if line.strip()]


def test_the_same_mechanism_gives_the_same_bytes(fmu_of, tmp_path):
    again = alfmu.export("particle_on_circle", tmp_path, kind="native")
    assert again.read_bytes() == fmu_of("particle_on_circle", kind="native").read_bytes()


def test_what_a_native_fmu_has_not_is_refused(tmp_path):
    given = {"solver.formulation": "classic", "solver.method": "explicit"}
    with pytest.raises(alfmu.ExportError, match=r"has no solver\.method explicit with solver\.formulation classic"):
        alfmu.export("five_bar", tmp_path, kind="native", parameters=given)
    with pytest.raises(alfmu.ExportError, match="no kind 'other'"):
        alfmu.export("five_bar", tmp_path, kind="other")
    with pytest.raises(alfmu.ExportError, match="leave --kernel out"):
        alfmu.export("five_bar", tmp_path, kind="native", kernel="vm")
    with pytest.raises(alfmu.ExportError, match="leave --platform out"):
        alfmu.export("five_bar", tmp_path, kind="python", platforms=["win64"])
    with pytest.raises(alfmu.ExportError, match="no platform 'amiga'"):
        alfmu.export("particle_on_circle", tmp_path, kind="native", platforms=["amiga"])


def test_without_a_compiler(monkeypatch, tmp_path, fmu_of):
    """For this platform none is needed; for others it takes zig, and what is missing is said."""
    monkeypatch.setattr(build, "compiler", lambda: None)
    monkeypatch.setattr(build, "zig", lambda: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = alfmu.export("particle_on_circle", tmp_path, kind="native")
    assert path.read_bytes() == fmu_of("particle_on_circle", kind="native").read_bytes()
    other = next(name for name in native.PLATFORMS if name not in native.platforms("particle", ()))
    with pytest.raises(alfmu.ExportError, match=rf"for {other} .*pip install ziglang\); leave the platform out"):
        alfmu.export("particle_on_circle", tmp_path, kind="native", platforms=[other])


def test_a_library_in_the_cache_is_kept_and_built_again_where_it_was_damaged(monkeypatch, tmp_path):
    made = []

    def written(name: str, folder: Path, fmi: list[int]) -> None:
        made.append(name)
        for version in fmi:
            (folder / build.file_name(name, version)).write_bytes(f"library {len(made)}".encode())

    monkeypatch.setattr(build, "build", written)
    monkeypatch.setenv("ALFMU_CACHE", str(tmp_path))
    other = next(name for name in native.PLATFORMS if name not in native.platforms("particle", ()))
    assert native.libraries("particle", [other]) == native.libraries("particle", [other]) == {other: b"library 1"}
    next(tmp_path.rglob(f"runtime_*{native.PLATFORMS[other].suffix}")).write_bytes(b"library of another")
    assert native.libraries("particle", [other]) == {other: b"library 2"}
    assert made == [other, other]


# FMI 3 ----------------------------------------------------------------------------------------------------------------


def unit_of(path: Path, log: list[str] | None = None, **given) -> fmpy.fmi3.FMU3Slave:
    """An instance of an FMU of FMI 3, by the arguments of its instantiation; what it says goes to a log."""
    description, told = fmpy.read_model_description(str(path)), [] if log is None else log
    unit = fmpy.fmi3.FMU3Slave(
        instanceName="one",
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(path)),
        modelIdentifier=description.coSimulation.modelIdentifier,
    )
    unit.instantiate(**{"logMessage": lambda *said: told.append(said[-1].decode()), **given})
    unit.references = {v.name: v.valueReference for v in description.modelVariables}
    return unit


@pytest.fixture
def slave(built) -> Iterator[Callable[..., fmpy.fmi3.FMU3Slave]]:
    """Instances of the five-bar or another FMU of FMI 3, freed at the end."""
    made = []

    def make(path: Path | None = None, **given) -> fmpy.fmi3.FMU3Slave:
        made.append(unit_of(path or built("five_bar", fmi=3), **given))
        return made[-1]

    yield make
    for unit in made:
        unit.freeInstance()


@pytest.mark.slow
def test_fmi_3_validates_and_gives_the_numbers_of_the_library(built):
    path = built("five_bar", fmi=3)
    assert validate(path) == []
    result = fmpy.simulate_fmu(str(path), stop_time=2.0, output_interval=0.02)
    library = alfmu.simulate(prepared(derived("five_bar")), 2.0, 0.02)
    names = [name for name in result.dtype.names if name in library.names]
    assert len(names) > 50
    assert max(np.abs(result[name] - library[name]).max() for name in names) == 0.0
    with zipfile.ZipFile(path) as archive:
        terminals = ET.fromstring(archive.read("terminalsAndIcons/terminalsAndIcons.xml"))
        built_from = ET.fromstring(archive.read("sources/buildDescription.xml"))
        names, page = archive.namelist(), archive.read("documentation/index.html").decode()
    assert posixpath.normpath("documentation/" + re.search(r'<img src="(.*?)"', page)[1]) in names
    members = {t.get("name"): [v.get("variableName") for v in t] for t in terminals.iter("Terminal")}
    assert members["A"] == ["A.torque", "link1.angle", "link1.angular_velocity"]
    assert members["D"] == ["D.torque", "link3.angle", "link3.angular_velocity"]
    assert {f"sources/{f.get('name')}" for f in built_from.iter("SourceFile")} <= set(names)


def test_fmi_3_is_driven_as_fmi_2_is(built, tmp_path):
    path = built("five_bar", fmi=3)
    values = {"start.angle": 0.4, "m2": 0.5, "solver.max_iterations": 9, "solver.branch": "continue"}
    results = []
    for each in (path, built("five_bar")):
        with Fmu(each) as fmu:
            results.append(run(fmu, 0.5, 0.02, {"A.torque": 0.3}, values))
            state, before = fmu.save(), fmu.read()
            fmu.step(0.02, 0.5)
            fmu.restore(state)
            assert np.array_equal(fmu.read(), before)
            with pytest.raises(alfmu.StepError, match=r"A\.torque is nan"):
                fmu.set("A.torque", float("nan"))
            with pytest.raises(alfmu.InputError, match="must be a"):
                fmu.set("m2", "heavy")
    assert results[0].names == results[1].names
    assert results[0].units == results[1].units
    assert np.array_equal(results[0].values, results[1].values)
    table = tmp_path / "five_bar.csv"
    assert main(["simulate", str(path), "-o", str(table), "--stop-time", "0.2"]) == 0
    assert len(table.read_text().splitlines()) == 12


def test_fmi_3_saves_derives_and_refuses(slave):
    unit, other = slave(), slave()
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    angle, torque = unit.references["link1.angular_acceleration"], unit.references["A.torque"]
    for k in range(20):
        unit.doStep(0.02 * k, 0.02)
    assert unit.getFloat64([unit.references["time"], angle])[0] == pytest.approx(0.4)
    state = unit.getFMUState()
    data = unit.serializeFMUState(state)
    found = unit.getDirectionalDerivative([angle], [torque], [1.0])
    before = unit.getFloat64([angle])[0]
    unit.setFloat64([torque], [1.0])
    assert found == pytest.approx([unit.getFloat64([angle])[0] - before], rel=1e-9)
    unit.setFloat64([torque], [0.0])
    unit.doStep(0.4, 0.02)
    after = unit.getFloat64([angle])
    other.setFMUState(other.deserializeFMUState(data))
    other.doStep(0.4, 0.02)
    assert other.getFloat64([angle]) == after
    for call in (
        lambda: unit.setFloat64([torque], [float("nan")]),
        lambda: unit.doStep(0.42, -1.0),
        lambda: unit.setFloat64([angle], [1.0]),
        lambda: unit.getInt32([angle]),
        lambda: unit.getFloat64([10**6]),
        lambda: unit.enterInitializationMode(),
        lambda: unit.enterEventMode(),
    ):
        with pytest.raises(fmpy.fmi1.FMICallException):
            call()
    unit.doStep(0.42, 0.02)
    unit.freeFMUState(state)


@pytest.mark.slow
def test_fmi_3_returns_early_where_the_host_asks_and_where_a_motion_ends(built, slave):
    seen, path = [], built("five_bar", fmi=3, parameters={"solver.method": "rk4"})

    def look(environment, time, set_requested, get_allowed, finished, can_return, wanted, until):
        seen.append(time)
        wanted[0] = time > 0.05

    unit, plain = slave(path, earlyReturnAllowed=True, intermediateUpdate=look), slave(path)
    for each in (unit, plain):
        each.enterInitializationMode()
        each.exitInitializationMode()
    _, _, early, reached = unit.doStep(0.0, 0.2)
    assert early
    assert reached == pytest.approx(0.06)
    assert seen == pytest.approx([0.02, 0.04, 0.06])
    plain.doStep(0.0, 0.06)
    angle = unit.references["link1.angle"]
    assert unit.getFloat64([angle]) == plain.getFloat64([angle])


# Other hosts ----------------------------------------------------------------------------------------------------------


def test_for_other_platforms(tmp_path):
    """Built by zig; where there is wine, the Windows library runs and gives the numbers of this platform."""
    pytest.importorskip("ziglang")
    path = alfmu.export("particle_on_circle", tmp_path, kind="native", platforms=["linux64", "win64"])
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    library = tmp_path / "binaries" / "win64" / "particle_on_circle.dll"
    assert library.read_bytes()[:2] == b"MZ"
    if not shutil.which("wine"):
        pytest.skip("there is no wine")
    host = tmp_path / "host.exe"
    command = [sys.executable, "-m", "ziglang", "cc", "-target", native.PLATFORMS["win64"].target]
    command += [f"-I{HEADERS}", str(Path(__file__).with_name("native_windows.c")), "-o", str(host)]
    subprocess.run(command, check=True, capture_output=True)
    description = fmpy.read_model_description(str(path))
    reference = next(v.valueReference for v in description.modelVariables if v.name == "particle.x")
    done = subprocess.run(
        ["wine", str(host), str(library), description.guid, str(reference)],
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
        env={**os.environ, "WINEPREFIX": str(tmp_path / "wine"), "WINEDEBUG": "-all"},
    )
    assert done.returncode == 0, done.stderr
    got = np.array(done.stdout.split(), float)
    library = alfmu.simulate("particle_on_circle", 2.0, 0.02)
    assert np.abs(got - library["particle.x"][1:]).max() < 1e-12


def test_libcosim_runs_it(built):
    cosim = pytest.importorskip("libcosimpy.CosimEnums")
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    assert cosim
    path = built("five_bar")
    references = {v.name: v.valueReference for v in fmpy.read_model_description(str(path)).modelVariables}
    execution = CosimExecution.from_step_size(step_size=20_000_000)
    index = execution.add_local_slave(CosimLocalSlave(fmu_path=str(path), instance_name="five_bar"))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    execution.simulate_until(target_time=1_000_000_000)
    got = observer.last_real_values(slave_index=index, variable_references=[references["link1.angle"]])
    library = alfmu.simulate(prepared(derived("five_bar")), 1.0, 0.02)
    assert got[0] == pytest.approx(library["link1.angle"][-1], abs=1e-12)
