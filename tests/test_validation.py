"""Validation: FMUs that are right pass, and each defect of one that is wrong on purpose is found by its check."""

import hashlib
import html
import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import fmpy
import pytest
from archives import changed

import alfmu
from alfmu.cli import main
from alfmu.fmi import records
from alfmu.fmi.checks.pages import FORMS, lines, save
from alfmu.fmi.checks.registry import FAILED, NOT_APPLICABLE, NOTED, PASSED, RISKY, UNJUDGED, Finding
from alfmu.fmi.checks.validation import Report, examine, known_checks
from alfmu.fmi.records import FOLDER
from alfmu.runtime import build
from alfmu.simulation import driver

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the FMUs of these tests are built for Unix")

SOURCE = Path(__file__).with_name("defective_fmu.c")

_VARIABLES = {
    "2": """
<ScalarVariable name="m" valueReference="0" causality="parameter" variability="fixed" initial="exact">
 <Real start="2" min="0.1" max="10" declaredType="Mass"/></ScalarVariable>
<ScalarVariable name="k" valueReference="1" causality="parameter" variability="fixed" initial="exact">
 <Real start="3" unit="N/m"/></ScalarVariable>
<ScalarVariable name="mode" valueReference="2" causality="parameter" variability="fixed" initial="exact">
 <Enumeration declaredType="Mode" start="1"/></ScalarVariable>
<ScalarVariable name="u" valueReference="3" causality="input" variability="continuous">
 <Real start="0" min="-100" max="100"/></ScalarVariable>
<ScalarVariable name="x" valueReference="4" causality="output" variability="continuous" initial="calculated">
 <Real/></ScalarVariable>
<ScalarVariable name="v" valueReference="5" causality="output" variability="continuous" initial="calculated">
 <Real/></ScalarVariable>
<ScalarVariable name="a" valueReference="6" causality="output" variability="continuous" initial="calculated">
 <Real/></ScalarVariable>
<ScalarVariable name="count" valueReference="7" causality="output" variability="discrete" initial="calculated">
 <Integer min="0"/></ScalarVariable>""",
    "3": """
<Float64 name="m" valueReference="0" causality="parameter" variability="fixed" start="2" min="0.1" max="10" unit="kg"/>
<Float64 name="k" valueReference="1" causality="parameter" variability="fixed" start="3" unit="N/m"/>
<Enumeration name="mode" valueReference="2" causality="parameter" variability="fixed" start="1" declaredType="Mode"/>
<Float64 name="u" valueReference="3" causality="input" start="0" min="-100" max="100"/>
<Float64 name="x" valueReference="4" causality="output"/>
<Float64 name="v" valueReference="5" causality="output"/>
<Float64 name="a" valueReference="6" causality="output"/>
<Int32 name="count" valueReference="7" causality="output" variability="discrete" min="0"/>
<Float64 name="time" valueReference="8" causality="independent"/>""",
}

_KNOWN = {"x": ([], []), "v": ([], []), "a": ([3], [0, 1, 3]), "count": ([], [])}
"""References of what each output depends on, while it runs and at the start."""


def description(version: str) -> str:
    two = version == "2"
    head = 'guid="{1}"' if two else 'instantiationToken="{1}"'
    state, many = ("FMUstate", "") if two else ("FMUState", "s")
    more = "" if two else ' providesAdjointDerivatives="true"'
    items = '<Item name="one" value="1"/><Item name="two" value="2"/>'
    mass = '<SimpleType name="Mass"><Real unit="kg"/></SimpleType>'
    types = f'<SimpleType name="Mode"><Enumeration>{items}</Enumeration></SimpleType>{mass}' if two else ""
    types = types or f'<EnumerationType name="Mode">{items}</EnumerationType>'
    places = {"x": 4, "v": 5, "a": 6, "count": 7}

    def listed(tag: str, which: int) -> str:
        rows = []
        for name, place in places.items():
            on = " ".join(str(each + two) for each in _KNOWN[name][which])
            at = f'index="{place + 1}"' if two else f'valueReference="{place}"'
            rows.append(f'<{"Unknown" if two else tag} {at} dependencies="{on}"/>')
        return "\n".join(rows)

    structure = (
        f"<Outputs>{listed('', 0)}</Outputs><InitialUnknowns>{listed('', 1)}</InitialUnknowns>"
        if two
        else listed("Output", 0) + listed("InitialUnknown", 1)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="{version}.0" modelName="spring" {head} generationTool="by hand">
<CoSimulation modelIdentifier="spring" canHandleVariableCommunicationStepSize="true" maxOutputDerivativeOrder="1"
 canGetAndSet{state}="true" canSerialize{state}="true" providesDirectionalDerivative{many}="true"{more}/>
<UnitDefinitions><Unit name="kg"><BaseUnit kg="1"/></Unit>
 <Unit name="N/m"><BaseUnit kg="1" s="-2"/></Unit></UnitDefinitions>
<TypeDefinitions>{types}</TypeDefinitions>
<LogCategories><Category name="problems"/></LogCategories>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>{_VARIABLES[version]}</ModelVariables>
<ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>"""


@pytest.fixture(scope="module")
def springs(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`springs("2")`: the FMU of that version, right but for what the environment says; compiled on first use."""
    compiler = build.compiler()
    if not compiler:
        pytest.skip("there is no C compiler")
    folder, made = tmp_path_factory.mktemp("springs"), {}

    def get(version: str, *flags: str) -> Path:
        key = "_".join([version, *flags])
        if key not in made:
            library = folder / f"spring{key}{fmpy.sharedLibraryExtension}"
            command = [*compiler, "-shared", "-fPIC", "-fvisibility=hidden", "-w", f"-DFMI={version}", *flags]
            subprocess.run([*command, str(SOURCE), "-lm", "-o", str(library)], check=True, timeout=60)
            platform = fmpy.platform if version == "2" else fmpy.platform_tuple
            path = folder / f"spring{key}.fmu"
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("modelDescription.xml", description(version))
                archive.write(library, f"binaries/{platform}/spring{fmpy.sharedLibraryExtension}")
                archive.writestr("resources/nothing.txt", "")
            made[key] = path
        return made[key]

    return get


@pytest.fixture(scope="module")
def right(springs: Callable[..., Path]) -> Callable[[str], Report]:
    """The report of an FMU that is right."""
    return cache(lambda version: examine(springs(version)))


def results(report: Report) -> dict[str, str]:
    return {f.id: f.result for f in report.findings}


both = pytest.mark.parametrize("version", ["2", "3"])


# FMUs that are right --------------------------------------------------------------------------------------------------


@both
def test_an_fmu_that_is_right_passes_every_check(right, version):
    """All apply but those of the other version and of records, which it has none of."""
    report = right(version)
    assert report.problems == []
    found = results(report)
    assert set(found) == set(known_checks())
    apart = {id for id, result in found.items() if result != PASSED}
    expected = {"file.records"} | ({"reference.type", "derivatives.adjoint"} if version == "2" else set())
    assert apart == expected
    assert all(found[id] == NOT_APPLICABLE for id in apart)


@pytest.mark.slow
@both
def test_an_fmu_that_is_instantiated_once_per_process_passes(springs, right, tmp_path, version):
    """A second instance in a process is none; only what is about several instances does not apply."""

    def once(name: str, data: bytes) -> bytes:
        return data.replace(b"<CoSimulation ", b'<CoSimulation canBeInstantiatedOnlyOncePerProcess="true" ')

    report = examine(changed(springs(version, "-DONCE"), tmp_path / "once.fmu", once))
    assert report.problems == []
    found = results(report)
    plain = results(right(version))
    assert {id for id in found if found[id] != plain[id]} == {"instance.two", "instance.repeated"}
    assert {found[id] for id in found if found[id] != plain[id]} == {NOT_APPLICABLE}
    assert examine(springs(version, "-DONCE"), checks=["state.bytes"]).problems != []


@pytest.mark.slow
def test_outputs_that_jump_when_an_input_moves_its_base_are_not_judged_by_differences(tmp_path):
    """Accelerations jump at the communication point, and so does friction; places and velocities are still compared."""
    m = alfmu.Mechanism("shaken")
    base = m.body("base", mass=2.0, pose=(0, m.input("y", "m", derivatives=2), 0))
    bar = m.bar("bar", mass=1.0, length=0.5)
    hinge = m.revolute("hinge", base.at(), bar.start, coordinate=m.coordinate("th", start=0.2, independent=True))
    m.friction(hinge, coulomb=0.3, radius=0.02)
    m.gravity(0, -9.81)
    path = alfmu.export(m, tmp_path / "shaken.fmu")
    found = next(x for x in examine(path, checks=["derivatives.output"]).findings if x.id == "derivatives.output")
    assert found.result == PASSED
    assert int(found.detail.split()[0]) >= 8


@both
def test_a_last_digit_is_no_difference(springs, monkeypatch, version):
    monkeypatch.setenv("DEFECT", "digit")
    found = results(examine(springs(version), checks=["run.*", "state.*", "instance.two"]))
    assert set(found.values()) == {PASSED}


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "version"), [("native", "2"), ("native", "3"), ("python", "2")])
def test_fmus_of_alfmu_pass(fmu_of, kind, version):
    path = fmu_of("slider_crank", {}, kind=kind, **({"fmi": 3} if version == "3" else {}))
    report = examine(path)
    assert report.problems == []
    counts = report.counts()
    assert counts[PASSED] >= (29 if kind == "python" else 35)
    assert {f.id for f in report.findings if f.result == UNJUDGED} <= (
        {"order.calls", "logging.categories"} if kind == "python" else set()
    )
    assert {"record.defaults", "record.moving_inputs"} <= {f.id for f in report.findings if f.result == PASSED}


# FMUs that are wrong --------------------------------------------------------------------------------------------------

DEFECTS = [
    ("version", "api.version", "23", "it reports '1.0'"),
    ("stillborn", "run.default", "2", "cannot be instantiated"),
    ("no_start", "run.default", "3", "fmi3ExitInitializationMode ended with Error: it will not start"),
    ("nan", "run.default", "2", "x is not finite"),
    ("any_reference", "reference.get", "23", "which no variable has, gives"),
    ("crash_reference", "reference.get", "23", "ended its process in fmi"),
    ("any_set", "reference.set", "23", "which no variable has, ends with OK"),
    ("any_type", "reference.type", "3", "of m, a Float64, ends with OK"),
    ("set_output", "set.output", "23", "whose causality is output, is set with OK"),
    ("set_fixed", "set.parameter", "23", "m, which is fixed, is set with OK"),
    ("any_order", "order.calls", "3", "it takes a step before initialisation"),
    ("category", "logging.categories", "23", "the declared category 'problems' is refused with Error"),
    ("any_category", "logging.categories", "3", "a category that is not declared is accepted"),
    ("mute", "logging.errors", "23", "ends with Error and logs nothing"),
    ("shared", "instance.two", "2", "beside a second instance, "),
    ("leak", "instance.repeated", "3", "memory grows by 6"),
    ("forget", "instance.end", "2", "outputs change at Terminate"),
    ("random", "run.repeated", "2", "in a second instance, x is"),
    ("part_state", "state.restored", "23", "restored once, "),
    ("no_state", "state.restored", "2", "fmi2GetFMUstate ended with Error: there are no states"),
    ("bytes", "state.bytes", "23", "read from bytes by the same instance, "),
    ("half_reset", "run.reset", "2", "after Reset, "),
    ("zero", "step.zero", "23", "after a step of no length"),
    ("negative", "step.negative", "23", "a step of -0.1 s ends with OK"),
    ("elsewhere", "step.time", "2", "outputs are not finite afterwards"),
    ("steps", "step.sizes", "3", "0.05 is the limit"),
    ("derivative", "derivatives.directional", "23", "the derivative of a by u is 1, and 0.5 by differences"),
    ("adjoint", "derivatives.adjoint", "3", "the adjoint derivative by u is"),
    ("slope", "derivatives.output", "23", "the rate of v is"),
    ("orders", "derivatives.output", "2", "order 2 is answered, and 1 is the highest declared"),
    ("no_state", "flags.capabilities", "3", "canGetAndSetFMUState is true, and the call ends with Error"),
    ("start", "values.start", "23", "m is 2.5 before initialisation ends, and its start value is 2.0"),
    ("bounds", "values.bounds", "2", "m = -0.9, outside its bounds, is taken, and x is not finite"),
    ("nonfinite", "values.nonfinite", "3", "u = nan is taken, and x is not finite"),
    ("item", "values.types", "23", "mode takes 3, which is no item"),
    ("count", "values.types", "2", "count is -1, outside its bounds"),
    ("undeclared", "dependencies.outputs", "23", "v depends on u at the same time"),
    ("start_dependency", "dependencies.start", "3", "x depends on k at the start"),
    ("exit", "run.default", "2", "ended its process in fmi2DoStep(from 0 s, by 0.1 s) (exit code 0)"),
    ("abort", "run.default", "3", "ended its process in fmi3DoStep(from 0.2 s, by 0.1 s) (SIGABRT)"),
]


NO_ERRORS = {
    **dict.fromkeys(("reference.get", "reference.set", "reference.type", "set.output", "set.parameter"), RISKY),
    **dict.fromkeys(("order.calls", "run.repeated", "values.bounds"), RISKY),
    **dict.fromkeys(("step.zero", "step.negative", "step.time", "step.sizes"), RISKY),
    "values.nonfinite": NOTED,
}
"""Results of checks of what the standard does not demand of an FMU: it need not detect what it forbids importers."""


APART = """
import json, os, pathlib, sys

fork = os.fork

def of_this_check():
    if not (made := fork()):
        check = pathlib.Path(sys.argv[1], "current").read_text()
        os.environ["DEFECT"] = json.loads(os.environ["DEFECTS"]).get(check, "")
    return made

os.fork = of_this_check
"""
"""A `sitecustomize` by which each check, in its own copy of the process, meets another defect."""


def rounds() -> list[tuple[str, dict[str, tuple[str, str]]]]:
    """A version, and by checks a defect and words of its finding; checks that others come after are alone."""
    found = list[tuple[str, dict[str, tuple[str, str]]]]()
    for defect, id, versions, words in DEFECTS:
        for version in versions:
            there = (each for v, each in found if v == version and id not in each and "run.default" not in each)
            first = None if id == "run.default" else next(there, None)
            if first is None:
                found.append((version, first := {}))
            first[id] = defect, words
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("version", "defects"), rounds(), ids=lambda x: x if isinstance(x, str) else f"{len(x)}")
def test_a_defect_is_found_by_its_check(springs, tmp_path, monkeypatch, version, defects):
    (tmp_path / "sitecustomize.py").write_text(APART)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setenv("DEFECTS", json.dumps({id: defect for id, (defect, _) in defects.items()}))
    report = examine(springs(version), checks=[*defects])
    found = {f.id: f for f in report.findings}
    problems = {problem.partition(": ")[0]: problem for problem in report.problems}
    assert problems.keys() <= defects.keys()
    for id, (_, words) in defects.items():
        finding = found[id]
        result = FAILED if "ended its process" in words else NO_ERRORS.get(id, FAILED)
        assert finding.result == result, id
        assert words in finding.detail
        assert (finding.section in problems.get(id, "")) == (result == FAILED)
        assert finding.section.startswith(f"FMI {version}.0")


def test_every_check_that_runs_an_fmu_is_seen_to_fail():
    seen = {id for _, id, _, _ in DEFECTS}
    assert {id for id in known_checks() if not id.startswith("file.")} == seen


@pytest.mark.slow
def test_a_failure_of_an_fmu_with_clocks_could_not_be_judged(springs, tmp_path, monkeypatch):
    """Clocks tick in event mode, which the checks do not use: what fails without their ticks may be right with them."""

    def clocked(name: str, data: bytes) -> bytes:
        clock = b'<Clock name="tick" valueReference="90" causality="input" intervalVariability="triggered"/>'
        return data.replace(b"</ModelVariables>", clock + b"</ModelVariables>")

    path = changed(springs("3"), tmp_path / "clocked.fmu", clocked)
    assert results(examine(path, checks=["run.default"]))["run.default"] == "passed"
    monkeypatch.setenv("DEFECT", "no_start")
    (finding,) = examine(path, checks=["run.default"]).findings
    assert finding.result == "could not be judged"
    assert "its clocks tick in event mode, which is not used here: fmi3ExitInitializationMode ended" in finding.detail


@pytest.mark.slow
def test_checks_after_one_that_ended_the_process_go_on(springs, monkeypatch):
    """All in one process, as where there is no fork: it is started again behind the check that ended it."""
    monkeypatch.setenv("DEFECT", "crash_reference")
    for together in (False, True):
        found = results(examine(springs("3"), together=together))
        failed = {id for id, result in found.items() if result == FAILED}
        # All of them ask for a value that there is not.
        assert failed == {"reference.get", "reference.type", "logging.errors"}
        assert found["values.types"] == PASSED


@pytest.mark.slow
def test_a_step_that_does_not_end_is_ended(springs, monkeypatch):
    monkeypatch.setenv("DEFECT", "hang")
    report = examine(springs("2"), checks=["run.default", "step.zero"], timeout=1.0)
    default, zero = report.findings
    assert default.detail == "it did not return within 1 s in fmi2DoStep(from 0 s, by 0.1 s)"
    assert (zero.result, zero.detail) == (UNJUDGED, "run.default failed")


@pytest.mark.slow
def test_the_start_of_the_checker_is_no_time_of_its_first_check(springs, monkeypatch, tmp_path):
    (tmp_path / "sitecustomize.py").write_text("import time\ntime.sleep(1.5)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    assert results(examine(springs("2"), checks=["run.default"], timeout=1.0)) == {"run.default": PASSED}


@pytest.mark.slow
def test_a_step_that_does_not_end_with_an_input_of_nan_is_a_risk(springs, monkeypatch):
    """The standard does not say what to do with such inputs; solvers that control their error may never end."""
    monkeypatch.setenv("DEFECT", "stuck")
    report = examine(springs("2"), checks=["values.nonfinite"], timeout=2.0)
    found = next(f for f in report.findings if f.id == "values.nonfinite")
    assert (found.result, report.problems) == (RISKY, [])
    assert found.detail.startswith("it did not return within 2 s in fmi2DoStep")


def test_start_values_by_writers_of_fifteen_digits_are_right(springs, monkeypatch):
    """Public FMUs have 0.000168694678594554 in their description, and 0.0001686946785945534 after initialisation."""
    monkeypatch.setenv("DEFECT", "digits")
    assert results(examine(springs("2"), checks=["values.start"]))["values.start"] == PASSED


def test_what_one_failure_leaves_unjudged_is_one_line(springs, monkeypatch):
    monkeypatch.setenv("DEFECT", "stillborn")
    report = examine(springs("2"), checks=["run.default", "step.zero", "step.sizes", "file.description"])
    failed, unjudged, summary = lines(report)
    assert failed.split()[:2] == ["failed", "run.default"]
    assert unjudged == "could not be judged  2 checks     run.default failed"
    assert "4 checks" in summary
    assert [line.split()[-1] for line in lines(report, every=True)[-3:-1]] == ["failed", "failed"]


def test_a_reason_of_several_lines_stays_in_its_column():
    finding = Finding("run.default", "it runs", "2.1", "", FAILED, "it says:\nno")
    found = Report("x.fmu", "x", "2", "none", (finding,), 0.1)
    first, _ = lines(found)
    assert first == "failed               run.default  it says:\n" + 34 * " " + "no (2.1)"


def test_fmi_2_names_no_status_for_calls_in_the_wrong_order(springs, monkeypatch):
    monkeypatch.setenv("DEFECT", "any_order")
    (finding,) = [f for f in examine(springs("2"), checks=["order.calls"]).findings if f.id == "order.calls"]
    assert finding.result == UNJUDGED
    assert "a step after Terminate" in finding.detail


@both
def test_a_library_that_lacks_a_function_is_told(springs, version):
    report = examine(springs(version, "-DMISSING"), checks=["run.default"])
    (finding,) = report.findings
    assert finding.result == FAILED
    assert "the library lacks a function of FMI" in finding.detail


# Files ----------------------------------------------------------------------------------------------------------------


def test_static_checks_run_nothing(springs, tmp_path, monkeypatch):
    monkeypatch.setenv("DEFECT", "crash_reference")
    report = examine(springs("2"), static=True)
    assert set(results(report)) == {"file.description", "file.values", "file.library", "file.records"}
    monkeypatch.setattr(subprocess, "Popen", None)
    assert alfmu.validate(springs("2"), static=True) == []
    broken = changed(springs("2"), tmp_path / "b.fmu", lambda name, data: data.replace(b' unit="N/m"', b' unit="lb"'))
    (problem,) = alfmu.validate(broken, static=True)
    assert problem.startswith("file.description: ")
    assert 'The unit "lb" of variable "k"' in problem


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (b'<Real start="2" min="0.1"', b'<Real start="0.01" min="0.1"', "m starts with 0.01, outside its bounds"),
        (b'<Real unit="kg"/>', b'<Real unit="slug"/>', "m has the unit slug by its type, and it is not defined"),
        (b'min="-100" max="100"', b'min="100" max="-100"', "min of u is 100 and max -100"),
        (b'declaredType="Mode" start="1"', b'declaredType="Mode" start="9"', "mode starts with 9, which is no item"),
    ],
)
def test_values_that_do_not_fit_together_are_told(springs, tmp_path, old, new, words):
    path = changed(springs("2"), tmp_path / "c.fmu", lambda name, data: data.replace(old, new))
    assert any(words in each for each in alfmu.validate(path, static=True))


def test_a_library_for_another_machine_is_not_run(springs, tmp_path, capsys):
    path = tmp_path / "other.fmu"
    with zipfile.ZipFile(springs("2")) as old, zipfile.ZipFile(path, "w") as new:
        for info in old.infolist():
            new.writestr(info.filename.replace(fmpy.platform, "amiga68k"), old.read(info))
    report = examine(path)
    found = {f.id: f for f in report.findings}
    assert found["file.library"].result == UNJUDGED
    assert "it has those of amiga68k" in found["file.library"].detail
    assert found["run.default"].detail == "the FMU cannot run here; see file.library"
    assert report.problems == []
    assert main(["validate", str(path)]) == 3
    assert " not judged (" in capsys.readouterr().out
    with pytest.raises(alfmu.ExportError, match=r"there is no library for .* in it; it has those of amiga68k"):
        alfmu.simulate(path, 0.1)


# Records --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(fmu_of: Callable[..., Path]) -> Path:
    return fmu_of("slider_crank", kind="native")


def summed(path: Path, target: Path, changes: dict[str, Callable[[bytes], bytes]]) -> Path:
    """The FMU with changed records, whose check sums are right."""
    with zipfile.ZipFile(path) as archive:
        files = {info.filename: archive.read(info) for info in archive.infolist()}
    manifest = files[f"{FOLDER}/fmi-ls-manifest.xml"]
    for name, change in changes.items():
        before = files[f"{FOLDER}/{name}"]
        files[f"{FOLDER}/{name}"] = after = change(before)
        sums = (hashlib.sha3_256(each).hexdigest().encode() for each in (before, after))
        manifest = manifest.replace(*sums)
    files[f"{FOLDER}/fmi-ls-manifest.xml"] = manifest
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return target


@pytest.mark.slow
def test_inputs_of_the_recorded_run_move_and_matter(recorded, tmp_path):
    with zipfile.ZipFile(recorded) as archive:
        archive.extractall(tmp_path / "u")
    folder = tmp_path / "u" / FOLDER
    inputs = alfmu.Result.from_csv(folder / "slider_crank_validation_in.csv")
    still, moved = (
        alfmu.Result.from_csv(folder / f"slider_crank_{name}_ref.csv") for name in ("smoke_test", "validation")
    )
    assert all(inputs[name].std() > 0 for name in inputs.names)
    assert len(inputs.names) == 2
    apart = max(abs(moved[name] - still[name]).max() / (1 + abs(still[name]).max()) for name in still.names)
    assert 0.01 < apart < 0.3

    def frozen(data: bytes) -> bytes:
        head, *rows = data.decode().splitlines()
        return "\n".join([head, *(row.split(",")[0] + ",0" * 2 for row in rows)]).encode()

    path = summed(recorded, tmp_path / "frozen.fmu", {"slider_crank_validation_in.csv": frozen})
    (problem,) = alfmu.validate(path, checks=["record.*"])
    assert problem.startswith("record.moving_inputs: ")
    path = summed(
        recorded, tmp_path / "light.fmu", {"slider_crank_validation.ssv": lambda d: d.replace(b"1.1", b"1.2")}
    )
    (problem,) = alfmu.validate(path, checks=["record.*"])
    assert problem.startswith("record.moving_inputs: ")


@pytest.mark.slow
def test_reference_results_that_differ_are_told_with_their_size(recorded, tmp_path):
    def one(data: bytes) -> bytes:
        head, *rows = data.decode().splitlines()
        at, last = head.split(",").index("crank.angle"), rows[-1].split(",")
        last[at] = str(float(last[at]) + 1e-4)
        return "\n".join([head, *rows[:-1], ",".join(last)]).encode()

    path = summed(recorded, tmp_path / "other.fmu", {"slider_crank_smoke_test_ref.csv": one})
    (problem,) = alfmu.validate(path, checks=["record.*"])
    assert problem.startswith("record.defaults: crank.angle is ")
    assert "1e-06 is asked" in problem
    assert alfmu.validate(path, checks=["record.*"], tolerance=1e-3) == []


def test_a_record_that_was_changed_is_told_by_its_check_sum(recorded, tmp_path):
    path = changed(recorded, tmp_path / "c.fmu", lambda n, d: d + b"\n" if n.endswith("_in.csv") else d)
    (problem,) = alfmu.validate(path, static=True)
    assert problem == (
        "file.records: slider_crank_validation_in.csv was changed since the manifest was written (check sum) "
        "(FMI-LS-REF, Layered Standard Manifest File)"
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("slider_crank_validation.exp", lambda d: b"<Experiments", "slider_crank_validation.exp is no XML that can be"),
        (
            "slider_crank_validation.exp",
            lambda d: b'<?xml version="1.0" encoding="of the moon"?><Experiments/>',
            "slider_crank_validation.exp is no XML that can be read",
        ),
        (
            "slider_crank_validation.ssv",
            lambda d: d.replace(b"<ssv", b"<!DOCTYPE a [<!ENTITY b 'c'>]><ssv", 1),
            "slider_crank_validation.ssv is not read: it declares a document type",
        ),
        ("slider_crank_validation.exp", lambda d: d.replace(b'stopTime="', b'stopTime="-'), "has stopTime -"),
        (
            "slider_crank_validation.exp",
            lambda d: d.replace(b'stopTime="', b'stopTime="1e17" x="'),
            "communication points",
        ),
        ("slider_crank_validation.exp", lambda d: d.replace(b'stepSize="', b'stepSize="x'), "no stepSize that is a"),
        (
            "slider_crank_validation.exp",
            lambda d: d.replace(b'source="slider_crank_validation.ssv"', b'source="../../../../etc/passwd"'),
            "is not a file inside the FMU, and is not read",
        ),
        (
            "slider_crank_validation.exp",
            lambda d: d.replace(b"TransientSimulation", b"SteadyState"),
            "is a SteadyState; only a TransientSimulation is run",
        ),
        ("slider_crank_validation.ssv", lambda d: d.replace(b"Real", b"Binary"), "holds Binary"),
        ("slider_crank_validation_ref.csv", lambda d: b'time,"x', "a quotation mark"),
    ],
)
def test_damaged_records_are_a_problem_and_the_others_run(recorded, tmp_path, file, change, words):
    report = examine(summed(recorded, tmp_path / "bad.fmu", {file: change}), checks=["file.records", "record.*"])
    (problem,) = report.problems
    assert words in problem
    assert str(tmp_path) not in problem
    assert results(report)["record.defaults"] == PASSED


@pytest.mark.slow
def test_experiments_of_the_form_before_are_read(recorded, tmp_path):
    """Times were attributes of the experiment itself."""

    def older(data: bytes) -> bytes:
        text = data.decode()
        start = text.index("<TransientSimulation ")
        end = text.index("/>", start)
        times = text[start + len("<TransientSimulation ") : end]
        return (text[:start] + text[end + 2 :]).replace("<Experiment ", f"<Experiment {times} ").encode()

    path = summed(recorded, tmp_path / "older.fmu", {"slider_crank_validation.exp": older})
    report = examine(path, checks=["record.*"])
    assert results(report)["record.moving_inputs"] == PASSED


# An FMU of another tool -----------------------------------------------------------------------------------------------

_TANK = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Tank(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.inflow, self.level = 0.1, 1.0
        self.register_variable(Real("inflow", causality=Fmi2Causality.input, start=0.1))
        self.register_variable(Real("level", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.level += step_size * self.inflow
        return True
"""


@pytest.mark.slow
def test_a_plain_slave_of_pythonfmu_is_judged_though_its_description_is_not_valid(tmp_path):
    (tmp_path / "tank.py").write_text(_TANK)
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "tank.py"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, timeout=60)
    found = {f.id: f for f in examine(tmp_path / "Tank.fmu").findings}
    assert found["file.description"].result == FAILED
    assert found["run.default"].result == PASSED
    assert found["state.restored"].result == NOT_APPLICABLE
    # Its slave does not look at what it is given, and pythonfmu neither.
    assert found["step.negative"].result == RISKY
    assert found["values.nonfinite"].detail.startswith("inflow = nan is taken, and level is not finite afterwards")


# The command ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_says_what_failed_and_ends_with_1(springs, monkeypatch, capsys, tmp_path):
    path = str(springs("2"))
    assert main(["validate", path, "--checks", "step.*"]) == 0
    assert capsys.readouterr().out.endswith("0 problems found (5 checks: 5 passed)\n")
    monkeypatch.setenv("DEFECT", "negative")
    out = str(tmp_path / "report.html")
    assert main(["validate", path, "--checks", "step.*", "--every", "-o", out]) == 0
    said = capsys.readouterr().out
    assert "risk                 step.negative  a step of -0.1 s ends with OK" in said
    assert f"wrote {out}" in said
    monkeypatch.setenv("DEFECT", "start")
    assert main(["validate", path, "--checks", "values.*"]) == 1
    assert "its start value is 2.0 (FMI 2.0.5, 2.2.7 Definition" in capsys.readouterr().out
    assert main(["validate", path, "--checks", "values.*", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["counts"] == {PASSED: 4, FAILED: 1, RISKY: 0, NOTED: 0, NOT_APPLICABLE: 0, UNJUDGED: 0}
    one = next(f for f in found["findings"] if f["id"] == "values.start")
    assert set(one) == {"id", "title", "section", "demand", "result", "detail"}
    assert one["section"] == "FMI 2.0.5, 2.2.7 Definition of Model Variables (start, initial)"


def test_mistakes_of_the_command_are_told(springs, capsys, tmp_path):
    path = str(springs("2"))
    for arguments, words in (
        ([path, "--checks", "stat.restored"], "there is no check 'stat.restored'"),
        (
            [path, "-o", "report.pdf"],
            "report.pdf: the name of a file for a report must end in .html, .md, .svg or .json",
        ),
        ([path, "--tolerance", "-1"], "timeout and tolerance are above zero"),
        ([str(tmp_path / "none.fmu")], "none.fmu"),
        ([], "validate takes an .fmu file"),
    ):
        assert main(["validate", *arguments]) == 1
        assert words in capsys.readouterr().err
    assert main(["validate", "--list"]) == 0
    said = capsys.readouterr().out
    assert all(f"{id}: " in said for id in known_checks())


def test_reports_hold_every_check_and_no_markup_of_an_fmu(springs, tmp_path, chromium):
    """Names come from the FMU: they are text in every form."""
    evil = "<script>document.title = 'run'</script> | x"
    path = changed(
        springs("2"),
        tmp_path / "evil.fmu",
        lambda name, data: data.replace(b'modelName="spring"', f'modelName="{html.escape(evil)}"'.encode()),
    )
    report = examine(path)
    assert report.name == evil
    for form, write in FORMS.items():
        text = write(report)
        assert all(f.id in text for f in report.findings), form
        assert form == ".json" or "<script>" not in text
        save(report, tmp_path / f"report{form}")
    for form in (".html", ".svg"):
        chromium.get((tmp_path / f"report{form}").as_uri())
        assert chromium.title != "run"
        assert not chromium.get_log("browser")
    chromium.get((tmp_path / "report.html").as_uri())
    rows = chromium.find_elements("css selector", "tbody tr")
    assert len(rows) == len(report.findings)
    # A narrow window scrolls the table, not the page.
    assert chromium.execute_script("return document.documentElement.scrollWidth <= window.innerWidth")


def test_wild_inputs_of_records_are_tried_for_a_moment(monkeypatch):
    """A torque that spins a light rod is told from the begin of the run, and a smaller one is recorded."""
    m = alfmu.Mechanism("light")
    rod = m.bar("rod", mass=1e-3, length=0.1)
    angle = m.coordinate("angle", "rad", start=0.3, independent=True)
    m.drive(m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=angle), m.input("torque", "N.m"))
    m.gravity(0, 0)
    spans = []

    def run(instance, stop_time, *how, **more):
        spans.append(stop_time)
        return driver.run(instance, stop_time, *how, **more)

    monkeypatch.setattr(records, "run", run)
    files = records.record_files(alfmu.Instance(m).equations)
    assert any("validation_ref" in name for name in files)
    assert spans[0] == spans[-1] == 10.0
    assert max(spans[1:7]) < 1.0
