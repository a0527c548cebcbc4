"""Sources of kind source: one file of C99 without files, stdio and malloc, and the numbers of native FMUs."""

import ctypes
import importlib.util
import re
import shutil
import struct
import subprocess
import zipfile
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from conftest import once
from scenes import by_rk4, initialized, sliding
from test_left_out import WARNINGS, block, by_a_compiler, led

import alfmu
from alfmu.cli import main
from alfmu.equations.interface import default_settings
from alfmu.fmi import source as module
from alfmu.fmi.drive import Fmu
from alfmu.kernel.form import Call, Choice
from alfmu.kernel.memory import TALLY
from alfmu.kernel.scene import AGAIN, CALLS
from alfmu.kernel.shorten import shortened
from alfmu.runtime import build
from alfmu.runtime.library import DONE
from alfmu.simulation import prepared, run

RK4 = {"solver.method": "rk4"}
SMALL = {"outputs": ["link1.angle", "A.force.x"], "freeze": ["all"], "parameters": {"solver.branch": "paper"}}
"""What a rig asks of the five-bar: torques in, an angle and a reaction out; not through singular positions."""


def five_bar() -> alfmu.Mechanism:
    return alfmu.load("five_bar")


def slider_crank() -> alfmu.Mechanism:
    return alfmu.load("slider_crank")


CASES = {"five_bar": five_bar, "slider_crank": slider_crank, "block": block, "led": led}
each_case = pytest.mark.parametrize("case", CASES)


class Plain:
    """Plain C by ctypes, with checks of the memory."""

    def __init__(self, path: Path):
        name = path.stem
        self.library = path.with_suffix(".so")
        checks = ["-Dassert(x)=((x)?(void)0:__builtin_trap())"]
        compiled(
            [*WARNINGS, "-O1", *checks, "-shared", "-fPIC", path.name, "-o", self.library.name, "-lm"], path.parent
        )
        header = path.with_suffix(".h").read_text()
        self.memory = (ctypes.c_double * int(re.search(r"memory\[(\d+)\]", header)[1]))()
        self.variables = re.findall(r"/\* (\w+) (\S+) \*/", header)
        self.names = [variable for _, variable in self.variables]
        c = ctypes.CDLL(str(self.library))
        self.calls = {each: getattr(c, f"{name}_{each}") for each in ("init", "set", "start", "step", "get", "time")}
        for each in ("get", "time"):
            self.calls[each].restype = ctypes.c_double
        self("init")

    def __call__(self, function: str, *given: float) -> float:
        return self.calls[function](self.memory, *(ctypes.c_double(x) if isinstance(x, float) else x for x in given))

    def set(self, name: str, value: float) -> int:
        return self("set", self.names.index(name), float(value))

    def get(self, name: str) -> float:
        return self("get", self.names.index(name))


def compiled(arguments: list[str], folder: Path, command: list[str] | None = None) -> None:
    command = command or build.compiler()
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def outputs_of(plain: Plain) -> list[str]:
    return [variable for kind, variable in plain.variables if kind == "output"]


@by_a_compiler
@pytest.mark.parametrize("case", ["block", *(pytest.param(x, marks=pytest.mark.slow) for x in CASES if x != "block")])
def test_plain_c_gives_the_numbers_of_the_library(case, tmp_path):
    """To the last bit, where the native FMU makes steps of RK4 with the same iterations."""
    mechanism = CASES[case]()
    plain = Plain(alfmu.export(mechanism, tmp_path / f"{case}.c", kind="source"))
    instance = alfmu.Instance(CASES[case]())
    instance.set("solver.method", "rk4")
    drive = [each for kind, each in plain.variables if kind == "input" and "lock" not in each]
    instance.initialize()
    assert plain("start", 0.0) == 0
    for k in range(60):
        for name in drive:
            instance.set(name, 0.01 * k), plain.set(name, 0.01 * k)
        if case == "led" and k == 30:
            instance.set("hinge.locked", True), plain.set("hinge.locked", 1)
        assert plain("step", 0.01) == 0
        instance.step(0.01)
        found, wanted = ([each.get(name) for name in outputs_of(plain)] for each in (plain, instance))
        assert np.array(found).tobytes() == np.array(wanted, float).tobytes(), k
    assert plain("time") == instance.time


def names_of(path: Path) -> list[str]:
    with zipfile.ZipFile(path) as archive:
        return archive.namelist()


def with_binary(path: Path, fmi: int) -> Path:
    """The FMU of sources with a library of them, as an importer compiles them, made once; unpacked beside it."""
    folder = path.parent / "built" / path.stem

    def make() -> None:
        with zipfile.ZipFile(path) as archive:
            archive.extractall(folder)
        (sources,) = (folder / "sources").glob("*.c")
        platform = build.PLATFORMS[build.HERE]
        binary = folder / "binaries" / (build.HERE if fmi == 2 else platform.fmi3) / f"{sources.stem}{platform.suffix}"
        binary.parent.mkdir(parents=True)
        compiled([*WARNINGS, "-O1", "-shared", "-fPIC", str(sources), "-o", str(binary), "-lm"], folder)
        Path(shutil.make_archive(str(folder), "zip", folder)).rename(folder.with_suffix(".fmu"))

    return once(folder.with_suffix(".fmu"), make)


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_of_sources_gives_the_numbers_of_the_native_one(fmu_of, fmi):
    native = fmu_of("five_bar", kind="native", fmi=fmi, reference=False, parameters=RK4)
    path = fmu_of("five_bar", kind="source", fmi=fmi)
    assert [each for each in names_of(path) if each.endswith((".c", ".h"))] == ["sources/five_bar.c"]
    assert not [each for each in names_of(path) if each.startswith(("binaries/", "resources/"))]
    with zipfile.ZipFile(path) as archive:
        described = archive.read(f"{'modelDescription' if fmi == 2 else 'sources/buildDescription'}.xml").decode()
    assert described.count('name="five_bar.c"') == 1
    with Fmu(native) as one, Fmu(with_binary(path, fmi)) as own:
        found = run(own, 2.0, 0.02)
        assert found.values.tobytes() == run(one, 2.0, 0.02).values.tobytes()
        state = own.save()
        own.step(0.02, 2.0)
        there = own.read()
        own.restore(state)
        own.step(0.02, 2.0)
        assert own.read().tobytes() == there.tobytes()
        with pytest.raises(alfmu.AlfmuError, match=r"^five_bar, t = 2\.02 s: a communication step of -1 s; it must be"):
            own.step(-1.0, 2.02)


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize("fmi", [2, 3])
def test_functions_get_the_prefix_of_fmi(fmu_of, tmp_path, fmi):
    with zipfile.ZipFile(fmu_of("five_bar", kind="source", fmi=fmi)) as archive:
        archive.extract("sources/five_bar.c", tmp_path)
    given = [f"-DFMI{fmi}_FUNCTION_PREFIX=own_", "-O1", "-shared", "-fPIC", "sources/five_bar.c", "-o", "own.so", "-lm"]
    compiled([*WARNINGS, *given], tmp_path)
    library = ctypes.CDLL(str(tmp_path / "own.so"))
    names = set(re.findall(rf"fmi{fmi}[A-Z]\w+", (tmp_path / "own.so").read_bytes().decode("latin")))
    assert {f"fmi{fmi}DoStep", f"fmi{fmi}SetBoolean", f"fmi{fmi}GetContinuousStates"} <= names
    assert not [each for each in names if hasattr(library, each)]
    assert all(hasattr(library, f"own_fmi{fmi}{each}") for each in ("DoStep", "SetBoolean", "GetContinuousStates"))


def test_warnings_of_plain_c_are_given_at_export(tmp_path, caplog):
    """A stiff spring at fixed steps of 10 ms: m omega^2 = k with omega h = 1, so that RK4 loses energy."""
    m, _, guide, s = sliding("spring", start=0.1)
    m.drive(guide, -1e4 * s)
    given = {"kind": "source", "parameters": {"solver.step_size": 0.01}}
    with caplog.at_level("WARNING", "alfmu"):
        alfmu.export(m, tmp_path / "spring.c", **given)
    assert "the energy balance is off by" in caplog.text
    assert "plain C does not tell when it runs" in caplog.text


@by_a_compiler
def test_internal_steps_are_chosen_for_the_default_experiment(tmp_path, caplog):
    """The same spring without a step: 0.1 m cos(100 t), after 0.5 s to the phase error of RK4, (omega h)^4 / 120
    of 50 rad, and half the energy that it lost."""
    m, _, guide, s = sliding("spring", start=0.1)
    m.drive(guide, -1e4 * s)
    with caplog.at_level("WARNING", "alfmu"):
        plain = Plain(alfmu.export(alfmu.Recipe(m, kind="source", stop_time=0.5), tmp_path / "spring.c"))
    step = plain.get("solver.step_size")
    assert f"spring: internal steps are {step:g} s, chosen for the default experiment; with 0.02 s, " in caplog.text
    assert plain("start", 0.0) == 0
    assert [plain("step", 0.02) for _ in range(25)] == [0] * 25
    assert plain.get("block.x") == pytest.approx(0.1 * np.cos(50.0), abs=0.1 * 50 * ((100 * step) ** 4 / 120 + 1e-3))


def test_a_warning_that_shorter_internal_steps_leave_is_given(monkeypatch, caplog):
    outcomes = iter([(1, "it fails"), (DONE, "it errs"), *[(DONE, "it errs, too")] * 7])
    monkeypatch.setattr(module, "_ran", lambda *_: next(outcomes))
    e = prepared(by_rk4("particle_on_circle"))
    with caplog.at_level("WARNING", "alfmu"):
        assert default_settings(module.paced(e, fixed=False)).step_size == 0.01
    assert [("it fails" in x, "it errs (" in x) for x in caplog.messages] == [(True, False), (False, True)]


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize("level", ["-O2", "-O3", "-Os"])
def test_a_mechanism_without_parameters_compiles_without_warnings_and_is_called_from_cpp(level, tmp_path):
    """GCC took references of outputs for those of text variables at -O2. The header serves C++, too."""
    m = alfmu.Mechanism("hatch")
    bar = m.bar("bar", mass=1.0, length=0.5)
    m.lock(m.revolute("hinge", m.ground.at(0, 0), bar.start, coordinate=m.coordinate("th", "rad", start=0.4)))
    m.gravity(0, -9.81)
    alfmu.export(m, tmp_path / "hatch.c", kind="source")
    compiled([*WARNINGS, level, "-c", "hatch.c", "-o", "hatch.o"], tmp_path)
    assert '\nextern "C" {\n' in (tmp_path / "hatch.h").read_text()


@pytest.mark.slow
@by_a_compiler
def test_there_is_memory_for_one_instance_at_a_time(fmu_of):
    path = with_binary(fmu_of("five_bar", kind="source", fmi=2), 2)
    guid = re.search(r'guid="(.*?)"', (path.with_suffix("") / "modelDescription.xml").read_text())[1].encode()
    library = ctypes.CDLL(str(next((path.with_suffix("") / "binaries").rglob("five_bar.*"))))
    library.fmi2Instantiate.restype = ctypes.c_void_p

    def instance() -> int | None:
        return library.fmi2Instantiate(b"one", 1, guid, None, None, 0, 0)

    for _ in range(3):  # what is given back serves again
        one = instance()
        assert one
        assert not instance()
        library.fmi2FreeInstance(ctypes.c_void_p(one))


@pytest.mark.slow
@by_a_compiler
def test_an_intermediate_update_takes_no_memory_of_saved_states(fmu_of):
    """A host that looks into steps of several internal ones still has both states; the third is refused with what to
    do."""
    given = {"kind": "source", "fmi": 3, "parameters": {"solver.step_size": 0.005}}
    path, said = with_binary(fmu_of("five_bar", **given), 3), list[str]()
    folder = path.with_suffix("")
    token = re.search(r'instantiationToken="(.*?)"', (folder / "modelDescription.xml").read_text())[1].encode()
    library = ctypes.CDLL(str(next((folder / "binaries").rglob("five_bar.*"))))
    looks = list[float]()
    c = ctypes
    log_type = c.CFUNCTYPE(None, c.c_void_p, c.c_int, c.c_char_p, c.c_char_p)
    look_type = c.CFUNCTYPE(None, c.c_void_p, c.c_double, *[c.c_bool] * 5, c.c_void_p, c.c_void_p)
    log = log_type(lambda _, status, category, text: said.append(text.decode()))
    look = look_type(lambda _, time, *rest: looks.append(time))
    library.fmi3InstantiateCoSimulation.restype = c.c_void_p
    no = c.c_bool(False)
    rest = no, no, no, no, None, c.c_size_t(0), None, log, look
    one = c.c_void_p(library.fmi3InstantiateCoSimulation(b"one", token, None, *rest))
    assert (
        library.fmi3EnterInitializationMode(one, c.c_bool(False), c.c_double(0), c.c_double(0), False, c.c_double(0))
        == 0
    )
    assert library.fmi3ExitInitializationMode(one) == 0
    states = [c.c_void_p() for _ in range(3)]
    assert [library.fmi3GetFMUState(one, c.byref(each)) for each in states[:2]] == [0, 0]
    flags, last = [c.c_bool() for _ in range(3)], c.c_double()
    done = library.fmi3DoStep(
        one, c.c_double(0.0), c.c_double(0.02), c.c_bool(False), *map(c.byref, flags), c.byref(last)
    )
    assert (done, looks) == (0, pytest.approx([0.005, 0.01, 0.015, 0.02]))
    assert library.fmi3GetFMUState(one, c.byref(states[2])) == 3
    assert "2 saved states; free one, or compile the FMU with larger INSTANCES or SAVED_STATES" in said[-1]
    assert library.fmi3FreeFMUState(one, c.byref(states[0])) == 0
    assert library.fmi3GetFMUState(one, c.byref(states[2])) == 0


TARGETS = {
    "thumb": ["-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m7"],
    "aarch64": ["-target", "aarch64-freestanding"],
    "x86_64": ["-target", "x86_64-linux-musl"],
}
ONE = "acos acosh asin asinh atan atanh ceil cos cosh erf exp expm1 fabs floor log log1p sin sinh sqrt tan tanh"
TWO = "atan2 copysign fmax fmin fmod hypot nextafter pow remainder"
HEADERS = {
    "math.h": '#define NAN __builtin_nanf("")\n#define INFINITY __builtin_inff()\n'
    "#define isnan(x) ((x) != (x))\n#define isfinite(x) ((x) - (x) == 0)\n"
    "double frexp(double, int *);\ndouble ldexp(double, int);\n"
    + re.sub(r"(\w+) ?", r"double \1(double);\n", ONE)
    + re.sub(r"(\w+) ?", r"double \1(double, double);\n", TWO),
    "string.h": "#include <stddef.h>\nvoid *memcpy(void *, const void *, size_t);\n"
    "void *memmove(void *, const void *, size_t);\nvoid *memset(void *, int, size_t);\n"
    "int memcmp(const void *, const void *, size_t);\n"
    "int strcmp(const char *, const char *);\nsize_t strlen(const char *);\nchar *strcpy(char *, const char *);\n"
    "char *strncpy(char *, const char *, size_t);\nchar *strcat(char *, const char *);\n"
    "char *strncat(char *, const char *, size_t);\nchar *strchr(const char *, int);\n",
}
"""All that the C asks of a C library, for targets that have none."""


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="ziglang is not installed")
def test_sources_compile_for_machines_without_a_system(tmp_path):
    for name, text in HEADERS.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "small").mkdir()
    recipe = alfmu.Recipe("five_bar", kind="source", stop_time=2.0, **SMALL)
    paths = [alfmu.export(recipe, tmp_path / "small" / "five_bar.c")]
    paths += [alfmu.export(made(), tmp_path / f"{name}.c", kind="source") for name, made in CASES.items()]
    for target, chosen in TARGETS.items():
        headers = [f"-I{tmp_path}"] * (target != "x86_64")
        for path in paths:
            compiled([*WARNINGS, "-Os", "-c", *chosen, *headers, path.name, "-o", "made.o"], path.parent, build.zig())


def sizes(library: Path) -> int:
    """Bytes of code and tables of an object file of ELF for 64 bits: sections that a program loads."""
    data = library.read_bytes()
    (at,), (each, count) = struct.unpack_from("<Q", data, 40), struct.unpack_from("<HH", data, 58)
    found = (struct.unpack_from("<IIQQQQ", data, at + k * each) for k in range(count))
    return sum(size for _, kind, flags, _, _, size in found if kind == 1 and flags & 2)


@pytest.mark.slow
@by_a_compiler
@pytest.mark.skipif(build.HERE != "linux64", reason="the limits are for x86-64")
def test_a_small_five_bar_is_small(tmp_path, capsys):
    path = tmp_path / "five_bar.c"
    parameters = [f"{name}={value}" for name, value in SMALL["parameters"].items()]
    given = ["--kind", "source", "-o", str(path), "--stop-time", "2", "--freeze", "all", "--set", *parameters]
    assert main(["export", "five_bar", *given, "--outputs", ",".join(SMALL["outputs"])]) in (0, None)
    said = capsys.readouterr().out
    assert "kind source" in said
    tables, memory = (int(re.search(rf"(\d+) bytes of {what}", said)[1]) for what in ("constant tables", "memory"))
    assert re.search(r"a step of 0\.02 s \(internal steps: 1\): \d+ operations as a rule, \d+ at most", said)
    compiled(["-std=c99", "-Os", "-c", path.name, "-o", "five_bar.o"], tmp_path)
    assert tables < sizes(tmp_path / "five_bar.o") < 56_000
    assert memory < 16_000
    plain = Plain(path)
    instance = initialized(alfmu.Instance("five_bar", outputs=SMALL["outputs"]), {**RK4, **SMALL["parameters"]})
    assert plain("set", 0, 1.0) == 1  # parameters are constants, and so is the start
    assert plain("start", 0.5) == 0
    for k in range(100):
        for each in (plain, instance):
            each.set("A.torque", 0.01 * k)
        assert plain("step", 0.02) == 0
        instance.step(0.02)
        for name in SMALL["outputs"]:
            assert plain.get(name) == pytest.approx(instance.get(name), rel=1e-13, abs=1e-13), k


@pytest.mark.slow
@by_a_compiler
def test_a_small_five_bar_through_singular_positions_has_16_kB_of_memory(tmp_path):
    """Values of programs share places: the numbers are those of an instance in which each has its own."""
    given = {name: SMALL[name] for name in ("outputs", "freeze")}
    path = alfmu.export(alfmu.load("five_bar"), tmp_path / "five_bar.c", kind="source", **given)
    assert int(re.search(r"(\d+) bytes of memory", path.read_text())[1]) < 16_000
    if build.HERE == "linux64":
        compiled(["-std=c99", "-Os", "-c", path.name, "-o", "five_bar.o"], tmp_path)
        assert sizes(tmp_path / "five_bar.o") < 64_000  # of code and tables
    plain, instance = Plain(path), alfmu.Instance("five_bar", outputs=SMALL["outputs"])
    initialized(instance, {"solver.method": "rk4"})
    assert plain("start", 0.0) == 0
    for k in range(600):
        assert plain("step", 0.02) == 0
        instance.step(0.02)
        for name in SMALL["outputs"]:
            assert plain.get(name) == pytest.approx(instance.get(name), rel=1e-9, abs=1e-9), k
    assert instance.memory["tally"][TALLY.index("limits")] > 0


def expanded(words: list[int], places: list[int], begin: int, end: int) -> list[int]:
    """Words of a program with sequences in place of the references to them."""
    found, at = [], begin
    while at < end:
        if words[at] == CALLS.index(Call):
            after = at + 2 + places[words[at + 1]]
            found += words[at:after]
        elif words[at] == AGAIN:
            after = at + 3
            found += expanded(words, places, at - words[at + 1], at - words[at + 1] + words[at + 2])
        else:
            head = 2 if words[at] == CALLS.index(Choice) else 3
            after, blocks = at + 4, []
            for length in words[at + head : at + 4]:
                blocks.append(expanded(words, places, after, after + length))
                after += length
            found += [*words[at : at + head], *map(len, blocks), *chain(*blocks)]
        at = after
    return found


def test_programs_with_references_say_the_same():
    places = [0, 2, 5]
    calls = [[0, which, *range(10 * which, 10 * which + places[which])] for which in (0, 1, 2, 1, 2)]
    part = list(chain(*calls))
    choice = [1, 7, len(part), len(calls[2]), *part, *calls[2]]
    words = [*part, *calls[3], *choice, 2, 8, 4, len(part) + len(choice), *part, *choice, *choice, *part]
    short = shortened(words, places)
    assert expanded(short, places, 0, len(short)) == words
    assert len(short) < len(words) / 3


@pytest.mark.slow
def test_a_refused_export_tells_why_steps_of_rk4_fail(tmp_path):
    """The reason is that of an instance, which has no limit of iterations."""
    leg = alfmu.load(str(Path(__file__).parent.parent / "docs" / "gallery" / "plot_jansen_leg.py"))
    instance = initialized(alfmu.Instance(leg), {"solver.method": "rk4"})
    with pytest.raises(alfmu.StepError) as failed:
        run(instance, 1.0, instance.equations.interval)
    assert "more iterations" not in str(failed.value)
    with pytest.raises(alfmu.ExportError, match=re.escape(str(failed.value))):
        alfmu.export(leg, tmp_path / "jansen_leg.c", kind="source", parameters={"solver.step_size": 0.02})


REFUSED = {
    "solver.method": ({"parameters": {"solver.method": "explicit"}}, "sources support only solver.method rk4,"),
    "solver.formulation": (
        {"parameters": {"solver.formulation": "classic"}},
        "sources support only solver.formulation residual,",
    ),
    "derivatives": ({"derivatives": True}, "an FMU of sources has no derivatives; leave --derivatives out"),
    "kernel": ({"kernel": "vm"}, "has a kernel of its own"),
    "platforms": ({"platforms": ["linux64"]}, "is not built for a platform"),
    "Model Exchange": ({"interface": "me"}, "supports co-simulation only; leave --interface out, or use --kind native"),
    "both interfaces": ({"interface": "both"}, "an FMU of sources supports co-simulation only"),
    "Jacobian": ({"outputs": ["link1.angle", "link1.angle/A.torque"]}, "have no interface Jacobian"),
    "FMI 3": ({"fmi": 3, "path": "five_bar.c"}, "plain C is of no version of FMI"),
    "name": ({"path": "other.c"}, "C has the name of the model"),
    "suffix": ({"path": "five_bar.h"}, "does not end in .fmu"),
    "experiment": ({"parameters": {"solver.branch": "paper"}}, "fixed numbers of iterations, which have to serve"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_options_without_effect_are_refused(tmp_path, what):
    given, message = REFUSED[what]
    given = {**given}
    path = tmp_path / given.pop("path", "five_bar.fmu")
    with pytest.raises(alfmu.ExportError, match=re.escape(message)):
        alfmu.export("five_bar", path, kind="source", **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize("name", ["m", "instance", "rad"])
def test_a_model_may_have_a_name_of_the_runtime(tmp_path, name):
    plain = Plain(alfmu.export(alfmu.Recipe("particle_on_circle", name=name, kind="source"), tmp_path / f"{name}.c"))
    instance = initialized(alfmu.Instance("particle_on_circle"), {"solver.method": "rk4"})
    assert plain("start", 0.0) == 0
    for _ in range(20):
        assert plain("step", 0.02) == 0
        instance.step(0.02)
    assert [plain.get(each) for each in outputs_of(plain)] == [instance.get(each) for each in outputs_of(plain)]


def test_names_of_c_are_refused(tmp_path):
    with pytest.raises(alfmu.ExportError, match="the model has a name of C"):
        alfmu.export(alfmu.Recipe("five_bar", name="double", kind="source"), tmp_path)


def test_plain_c_has_no_reference_results(tmp_path, capsys):
    assert main(["export", "five_bar", "--kind", "source", "--reference", "-o", str(tmp_path / "five_bar.c")]) == 1
    assert "plain C has no reference results" in capsys.readouterr().err
