"""Compiled kernels: the C and its numbers, the cache, FMUs that need no package, what happens without a compiler."""

import ctypes
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from archives import changed
from numpy.typing import NDArray
from scenes import by_rk4, derived, initialized, refused

import alfmu
from alfmu.cli import main
from alfmu.equations import Equations
from alfmu.fmi import export, native
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.fmi.slave import COMPILED
from alfmu.kernel import emit, stream
from alfmu.kernel.complete import complete
from alfmu.kernel.form import Traced
from alfmu.kernel.tables import machine_code
from alfmu.runtime import build as runtime_build
from alfmu.runtime import compiled as build
from alfmu.runtime import pipeline, shipped
from alfmu.runtime.build import HERE, zig
from alfmu.runtime.compiled import SUFFIX
from alfmu.runtime.library import Scene
from alfmu.runtime.pipeline import packed
from alfmu.runtime.shipped import installed
from alfmu.simulation import prepared, run, with_defaults

LIBRARY = f"{COMPILED}{HERE}{SUFFIX}"
"""Name of the compiled functions in an FMU."""

START = {"start.angle": 0.4, "m2": 0.5}


RK4 = {"solver.method": "rk4"}
"""Scenes of one method compile in a third of the time."""

SCENES = [("five_bar", {}), ("slider_crank", {"coordinates": "natural"}), ("n_four_bar", {"coordinates": "natural"})]
scenes = pytest.mark.parametrize(("name", "options"), SCENES, ids=["five_bar", "slider_crank", "n_four_bar"])


def spare(path: Path, name: str = "spare") -> int:
    """Numbers that compiled functions need as a workspace, or another number of their library."""
    return ctypes.c_int.in_dll(ctypes.CDLL(str(path)), f"alfmu_{name}").value


class Functions:
    """The functions of equations as C, compiled and called on arrays; `kept` as of `emit.compiled_code`."""

    def __init__(self, equations: Equations, kept: Mapping[str, dict[int, int]] | None = None):
        self.files = emit.compiled_code(equations, kept or {}, "a scene")
        name = f"kernel_{hashlib.sha256(repr(self.files).encode()).hexdigest()[:32]}"
        self.path = build._built(equations.name, build.compiler(), self.files, name)
        library = ctypes.CDLL(str(self.path))
        count, self.spare = spare(self.path, "function_count"), spare(self.path)
        table = (ctypes.c_void_p * count).in_dll(library, "alfmu_functions")
        kind = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)
        self._functions = dict(zip(equations.signatures, map(kind, table), strict=True))
        self._workspace = np.full(self.spare, np.nan)
        self._library = library

    def bind(self, name: str, x: Sequence[NDArray], y: Sequence[NDArray]) -> Callable[[], None]:
        """A function bound to arrays, to be called without any argument."""
        places = [(ctypes.c_void_p * len(each))(*(a.ctypes.data for a in each)) for each in (x, y)]
        return lambda: self._functions[name](*places, self._workspace.ctypes.data)


@pytest.fixture
def own_cache(tmp_path, monkeypatch) -> Path:
    """A cache folder that nobody else uses; nothing is known of scenes that runs before shared."""
    monkeypatch.setattr(pipeline, "_KEPT", OrderedDict())
    monkeypatch.setenv("ALFMU_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def libraries(cache: Path) -> list[Path]:
    return sorted(cache.glob("kernel_*"))


FMU = {"kind": "python", "kernel": "compiled", "parameters": RK4}


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory) -> Path:
    """The FMU of the five-bar with a compiled kernel."""
    return alfmu.export("five_bar", tmp_path_factory.mktemp("compiled") / "five_bar.fmu", **FMU)


def test_every_operation_means_the_same_in_c(tmp_path):
    """All operations that CasADi's scalar functions have, on values where they differ from each other."""
    x = ca.SX.sym("x", 2)
    a, b = ca.vertsplit(x)
    unary = [ca.fabs, ca.floor, ca.ceil, ca.sqrt, ca.exp, ca.log, ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan]
    unary += [ca.sinh, ca.cosh, ca.tanh, ca.asinh, ca.atanh, ca.sign, ca.erf, ca.log1p, ca.expm1, ca.logic_not]
    binary = [ca.fmin, ca.fmax, ca.atan2, ca.fmod, ca.hypot, ca.copysign, ca.remainder, ca.logic_and, ca.logic_or]
    results = [f(a) for f in unary] + [f(a, b) for f in binary] + [ca.acosh(1 + a), -a, 1 / a, 2 * a, a * a, a**b]
    results += [a**3.5, a + b, a - b, a * b, a / b, a < b, a <= b, a == b, a != b, ca.if_else(a < b, a, b), a + 0.1]
    results += [ca.SX(-0.5) + a, ca.if_else(a > 0, ca.inf, a)]
    f = ca.Function("f", [x], [ca.vertcat(*results)])
    used = {f.instruction_id(k) for k in range(f.n_instructions())} - {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    assert used == (set(stream.BINARY) | set(stream.UNARY)) - {ca.OP_ASSIGN}
    e = derived("particle_on_circle")
    signature = {"inputs": [2], "outputs": [[len(results), 1]], "matrices": 0}
    library = Functions(Traced.of(e, functions={"f": f}, signatures={"f": signature}))
    values, y = np.zeros(2), np.zeros(len(results))
    call = library.bind("f", [values], [y])
    for values[:] in ((0.3, 0.7), (0.7, 0.3), (0.5, 0.5), (0.9, -0.4)):
        call()
        expected = np.array(f(values)).reshape(-1)
        assert np.allclose(y, expected, rtol=4e-16, atol=0, equal_nan=True)


def test_instructions_are_read_once_and_the_oldest_are_dropped(monkeypatch):
    """Three functions of 40 additions each, of which 100 instructions have room for two."""
    for name, value in (("_KNOWN", OrderedDict()), ("_COUNT", [0]), ("MOST", 100)):
        monkeypatch.setattr(stream, name, value)
    x = ca.SX.sym("x")
    functions = [ca.Function(f"f{k}", [x], [sum((ca.sin(x + k) for _ in range(1, 41)), ca.SX(0))]) for k in range(3)]
    read, decoded = [], stream._listed
    monkeypatch.setattr(stream, "_listed", lambda f: read.append(f.name()) or decoded(f))
    for k in (0, 1, 1, 0, 2, 2, 1, 0):
        stream.Instructions.of(functions[k])
    assert read == ["f0", "f1", "f2", "f0"]
    assert stream._COUNT[0] == sum(len(made) for _, made in stream._KNOWN.values()) <= 100


def test_an_operation_that_has_no_c_is_named():
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.erfinv(x)])
    with pytest.raises(alfmu.ExportError, match=r"some_scene: operation \d+ of f has no C here; use --kernel vm"):
        stream.Instructions.of(f).check("some_scene", f.name())


WARNINGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
STRICT = [*WARNINGS, "-O2", "-c", "-o", os.devnull]


@pytest.fixture(scope="module", autouse=True)
def strict_compiler() -> Iterator[None]:
    """All scenes that are compiled here are free of warnings."""
    command = build.compiler()
    with pytest.MonkeyPatch.context() as patch:
        if command and "ziglang" not in command:
            patch.setenv("CC", shlex.join([*command, *WARNINGS]))
        yield


by_each_compiler = pytest.mark.parametrize(
    "command",
    {" ".join(each): each for each in (build.compiler(), zig()) if each}.values(),
    ids=lambda command: Path(command[0]).name,
)
"""The system's, which is gcc as a rule, and clang as zig has it."""


def warnings(command: list[str], files: Mapping[str, str], folder: Path) -> str:
    """What a compiler says of C files."""
    for name, text in files.items():
        (folder / name).write_text(text)
    said = ""
    for name in files:
        if name.endswith(".c"):
            done = subprocess.run([*command, *STRICT, name], cwd=folder, capture_output=True, text=True, check=False)
            said += done.stderr if done.stderr or not done.returncode else f"{name}: exit code {done.returncode}"
    return said


@pytest.mark.slow
@by_each_compiler
@pytest.mark.parametrize(("name", "options"), SCENES[1:])
def test_the_c_is_free_of_warnings(name, options, command, tmp_path):
    """In lanes; the other C by the other compiler, as that of the system compiles all scenes here so. Lanes of the
    five-bar are compiled so by tests of batches."""
    e = prepared(by_rk4(name, **options))
    files = {f"{i}.c": text for i, text in enumerate(machine_code(complete(e), packed(e)))}
    files |= {header.name: header.read_text(encoding="ascii") for header in build.HEADERS}
    if "ziglang" in command:
        assert warnings(command, files, tmp_path) == ""
    assert warnings([*command, *shipped.lane_flags(), "-Wno-psabi"], files, tmp_path) == ""


@pytest.mark.slow
@by_each_compiler
def test_the_c_of_the_runtime_is_free_of_warnings(command, tmp_path):
    files = {path.name: path.read_text(encoding="ascii") for path in runtime_build.sources()}
    assert warnings(command, files, tmp_path) == ""


def values(e: Equations) -> NDArray:
    """Of a run of one second, in which the five-bar passes a singular position; the scene is loaded for it."""
    instance = alfmu.Instance(e)
    assert bool(instance._scene.code) == (e.library is not None)
    found = run(instance, 1.0, 0.02, parameters={"start.angle": 0.4})
    assert e.name != "five_bar" or found["monitor.singular"].max() == 1
    return found.values


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize("method", ["explicit", "stiff", "generalized_alpha"])
def test_both_kernels_make_the_same_run(method):
    """The same tries, with results that differ by round-off."""
    e = with_defaults(derived("slider_crank"), {"solver.method": method})
    vm, compiled = (alfmu.Instance(prepared(e, kernel)) for kernel in ("vm", "compiled"))
    for i in (vm, compiled):
        initialized(i, {"start.angle": 0.4, "solver.step_size": 0.01})
        i.step(1.0)
    assert vm.counters.steps == compiled.counters.steps > 10
    assert vm.counters.refused == compiled.counters.refused
    assert vm.counters.evaluations == compiled.counters.evaluations
    assert np.abs(vm.read() - compiled.read()).max() <= 1e-9 * np.abs(vm.read()).max()


@pytest.mark.slow
@scenes
def test_compiled_scenes_give_the_same_numbers(name, options, monkeypatch, own_cache):
    """To the last bit: interpreted, compiled as whole functions in one file, and in blocks of 30 operations in many."""
    equations = derived(name, **options) if name == "slider_crank" else by_rk4(name, **options)
    interpreted = prepared(equations, "vm")
    monkeypatch.setattr(emit, "WHOLE", 10**9)
    whole = replace(interpreted, library=build.compiled_scene(interpreted, packed(interpreted)))
    monkeypatch.setenv("ALFMU_CACHE", str(own_cache / "cut"))  # a name in the cache stands for one way to write C
    monkeypatch.setattr(emit, "BLOCK", 30)
    monkeypatch.setattr(emit, "WHOLE", 30)
    monkeypatch.setattr(emit, "UNIT", 20000)
    cut = prepared(equations, "compiled")
    assert cut.library != whole.library
    assert len(machine_code(complete(cut), packed(cut))) > 5
    assert spare(whole.library) == 0 < spare(cut.library)
    expected = values(interpreted)
    assert np.isfinite(expected).all()
    for e in (whole, cut):
        assert np.array_equal(values(e), expected)


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_scene_refuses_the_functions_of_another(own_cache):
    e = prepared(by_rk4("five_bar"), "compiled")
    Scene(packed(e), installed()).compiled_by(e.library)
    with pytest.raises(ValueError, match=r"particle_on_circle: kernel_.* has the functions of another scene"):
        Scene(packed(prepared(derived("particle_on_circle"))), installed()).compiled_by(e.library)


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_library_is_built_once_and_kept(own_cache, monkeypatch):
    prepared(derived("particle_on_circle"), "compiled")
    (path,) = libraries(own_cache)
    made = path.stat().st_ino
    monkeypatch.setattr(build, "build", None)  # would fail
    assert prepared(derived("particle_on_circle"), "compiled").library == path
    assert path.stat().st_ino == made


def spoiled(path: Path, how: str) -> bytes:
    """Damages a library; another process may have the old one loaded, so it is a new file."""
    content = path.read_bytes()
    path.unlink()
    middle = len(content) // 2
    path.write_bytes(
        {
            "a bit": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
            "an end": content[:middle],
            "nothing": b"",
            "more": content + b"\0",
        }[how]
    )
    return content


DAMAGES = ("a bit", "an end", "nothing", "more")


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_damaged_library_is_built_again_and_never_loaded(own_cache):
    expected = alfmu.simulate(replace(by_rk4("particle_on_circle")), 0.1, 0.02, kernel="compiled").values
    for how in DAMAGES:
        (path,) = libraries(own_cache)
        content = spoiled(path, how)
        e = prepared(replace(by_rk4("particle_on_circle")), "compiled")
        assert e.library.read_bytes() == content, how
        assert libraries(own_cache) == [e.library]
        assert np.array_equal(alfmu.simulate(e, 0.1, 0.02, kernel="compiled").values, expected)


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize(
    ("kind", "how"), [("python", "a bit"), ("python", "nothing"), ("native", "an end"), ("native", "more")]
)
def test_a_damaged_library_is_never_in_an_fmu(own_cache, tmp_path, monkeypatch, kind, how):
    """Export builds it again, and says that all went well only then; that of the runtime is as if of another platform,
    with which alfmu did not come."""
    form = ["--kernel", "compiled", "--set", "solver.method=rk4"] if kind == "python" else ["--platform", HERE]
    built = []
    there = shipped.there(HERE, 2)
    if kind == "native":
        monkeypatch.setattr(shipped, "there", lambda *which: tmp_path / "nowhere")
        monkeypatch.setattr(shipped.build, "build", lambda name, to, fmi: built.append(shutil.copy(there, to)))
    found = []
    for name in ("one", "two"):
        path = tmp_path / f"{name}.fmu"
        assert main(["export", "particle_on_circle", "--kind", kind, *form, "--output", str(path)]) == 0
        with zipfile.ZipFile(path) as archive:
            wanted = f"resources/{LIBRARY}" if kind == "python" else f"binaries/{HERE}/particle_on_circle{SUFFIX}"
            found.append(archive.read(wanted))
        kept = list(own_cache.glob(f"*{SUFFIX}"))
        assert found[-1] in [each.read_bytes() for each in kept]
        for each in kept:
            spoiled(each, how)
    assert found[0] == found[1]
    assert len(built) == 2 * (kind == "native")


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_library_that_is_damaged_once_it_is_built_is_not_exported(own_cache, tmp_path, monkeypatch):
    left = [*DAMAGES]

    def damaged(equations: Equations, scene: bytes) -> Path:
        path = build.compiled_scene(equations, scene)
        spoiled(path, left.pop())
        return path

    monkeypatch.setattr(export, "compiled_scene", damaged)
    while left:
        with pytest.raises(alfmu.ExportError, match=r"particle_on_circle: the library .* was damaged"):
            alfmu.export("particle_on_circle", tmp_path / "it.fmu", **FMU)
        assert not (tmp_path / "it.fmu").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_several_processes_may_build_at_once(own_cache):
    """Each gets a library that works, and one whole file is left."""
    code = (
        f"import alfmu; r = alfmu.simulate('particle_on_circle', 0.1, 0.02, kernel='compiled', parameters={RK4}); "
        "print(r['particle.x'][-1].hex())"
    )
    running = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(4)]
    said = {process.communicate(timeout=120)[0] for process in running}
    assert [process.returncode for process in running] == [0] * 4
    assert len(said) == 1
    assert len(libraries(own_cache)) == 1


@pytest.mark.slow
def test_without_a_compiler(monkeypatch, own_cache):
    monkeypatch.setattr(build, "compiler", lambda: None)
    monkeypatch.setattr("alfmu.runtime.pipeline.compiler", lambda: None)
    with pytest.raises(alfmu.ExportError, match=r"particle_on_circle: no C compiler found .* use --kernel vm"):
        alfmu.simulate("particle_on_circle", 0.1, 0.02, kernel="compiled")
    e = prepared(derived("particle_on_circle"), "auto")
    assert e.library is None
    assert not bool(alfmu.Instance(e)._scene.code)
    assert not libraries(own_cache)


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_auto_takes_the_compiler_that_is_there():
    assert (prepared(derived("particle_on_circle"), "auto").library is not None) == (build.compiler() is not None)


@pytest.mark.parametrize("command", ["false", "/nowhere/cc"])
def test_a_compiler_that_does_not_work_is_named(monkeypatch, own_cache, command):
    monkeypatch.setenv("CC", command)
    with pytest.raises(alfmu.ExportError, match=f"compiler {command}"):
        alfmu.simulate("particle_on_circle", 0.1, 0.02, kernel="compiled")


def test_compilers_are_looked_for_in_order(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", "my-cc -m64")
    assert build.compiler() == ["my-cc", "-m64"]
    monkeypatch.delenv("CC")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert build.compiler() is None
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    assert build.compiler() == [sys.executable, "-m", "ziglang", "cc"]
    (tmp_path / "gcc").write_text("#!/bin/sh\n")
    (tmp_path / "gcc").chmod(0o755)
    assert build.compiler() == [str(tmp_path / "gcc")]


@pytest.mark.parametrize(("command", "level"), [(["cc"], "-O2"), (["cc", "-O0", "-g"], "-O0")])
def test_a_level_of_optimisation_in_cc_counts(monkeypatch, command, level):
    """The last one on a command line is in force."""
    told = []
    monkeypatch.setattr(build, "build", lambda scene, command, *given: told.append(command))
    build._built("it", command, ["int x;"], "kernel")
    assert told[0][: len(command)] == command
    assert [x for x in told[0] if x.startswith("-O")][-1] == level


def in_fmpy(path: Path, blocked: str = "") -> tuple[list[str], list[str]]:
    """A process with fmpy that runs an FMU for 0.5 s: the end, as numbers to the bit, and the libraries it loaded.

    Some packages cannot be imported from the moment on that the FMU is loaded.
    """
    code = f"""
import ctypes, os, pathlib, sys
import fmpy, fmpy.fmi2

class Loaded(ctypes.CDLL):
    def __init__(self, name, *others, **named):
        super().__init__(name, *others, **named)
        print("loaded", pathlib.Path(name).name)

at = {{v.name: v.valueReference for v in fmpy.read_model_description({str(path)!r}).modelVariables}}
about = fmpy.read_model_description({str(path)!r})
folder = fmpy.extract({str(path)!r})
assert not [name for name in sys.modules if name.split(".")[0] in ("alfmu", "casadi")]
sys.modules.update(dict.fromkeys({blocked!r}.split()))
ctypes.CDLL = Loaded
fmu = fmpy.fmi2.FMU2Slave(guid=about.guid, unzipDirectory=folder, modelIdentifier=about.coSimulation.modelIdentifier)
fmu.instantiate()
fmu.setupExperiment(startTime=0.0)
for name, value in {START!r}.items():
    fmu.setReal([at[name]], [value])
fmu.enterInitializationMode()
fmu.exitInitializationMode()
for i in range(25):
    fmu.doStep(i * 0.02, (i + 1) * 0.02 - i * 0.02)
print(*(value.hex() for value in fmu.getReal([at["link2.x"], at["A.force.x"]])))
fmu.terminate()
fmu.freeInstance()
sys.stdout.flush()
os._exit(0)  # pythonfmu 0.7.0 reads what it has freed when a process ends, which kills some
"""
    environment = {**os.environ, "PYTHONPATH": ""}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    *loaded, numbers = done.stdout.splitlines()
    return numbers.split(), [line.removeprefix("loaded ") for line in loaded if line.startswith("loaded ")]


@pytest.fixture(scope="module")
def expected() -> list[str]:
    """What `in_fmpy` finds, by alfmu, interpreted."""
    result = alfmu.simulate("five_bar", 0.5, 0.02, parameters=RK4 | START, kernel="vm")
    return [float(result[name][-1]).hex() for name in ("link2.x", "A.force.x")]


@pytest.mark.slow
def test_a_compiled_fmu_needs_no_package(five_bar, expected):
    """The same numbers as with alfmu, in a process where no package can be imported; and compiled functions ran."""
    numbers, loaded = in_fmpy(five_bar, "numpy casadi scipy alfmu")
    assert numbers == expected
    assert LIBRARY in loaded


@pytest.mark.slow
@pytest.mark.parametrize("how", ["none", "another platform", "another processor"])
def test_on_another_platform_the_scene_is_interpreted(five_bar, expected, tmp_path, how):
    """The compiled functions are passed over, and the numbers are the same; no package is needed there either."""
    with zipfile.ZipFile(five_bar) as archive:
        content = archive.read(f"resources/{LIBRARY}")
    other = content[:18] + b"\xff\xfe" + content[20:] if how == "another processor" else None  # of ELF
    name = f"resources/{LIBRARY}"
    elsewhere = changed(five_bar, tmp_path / "elsewhere.fmu", lambda n, data: other if n == name else data)
    if how == "another platform":
        with zipfile.ZipFile(elsewhere, "a") as archive:
            archive.writestr(f"resources/{COMPILED}elsewhere.xyz", b"MZ\0\0" + content[4:])
    numbers, loaded = in_fmpy(elsewhere, "numpy casadi scipy alfmu")
    assert numbers == expected
    assert not [name for name in loaded if name.startswith(COMPILED)]


def test_a_compiled_fmu_has_the_scene_inside_and_says_what_it_needs(five_bar):
    with zipfile.ZipFile(five_bar) as archive:
        resources = {Path(name).name for name in archive.namelist() if name.startswith("resources/")}
        needs = archive.read("documentation/externalDependencies.txt").decode()
    assert {LIBRARY, native.file_name(HERE), "scene.bin"} <= resources
    assert "no package" in needs
    assert len(needs.strip().splitlines()) == 1


@pytest.mark.slow
def test_a_compiled_fmu_validates_saves_and_restores(five_bar):
    assert validate(five_bar) == []
    with Fmu(five_bar) as fmu:
        result = run(fmu, 1.0, 0.05, inputs={"A.torque": lambda t: t}, parameters=START)
    library = alfmu.simulate("five_bar", 1.0, 0.05, inputs={"A.torque": lambda t: t}, parameters=RK4 | START)
    assert np.array_equal(result.values, library.values)


@pytest.mark.slow
def test_the_same_export_gives_the_same_bytes(five_bar, tmp_path):
    assert alfmu.export("five_bar", tmp_path / "five_bar.fmu", **FMU).read_bytes() == five_bar.read_bytes()


@pytest.mark.slow
def test_from_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    by_rk4 = ["five_bar", "--set", "solver.method=rk4"]
    assert main(["export", *by_rk4, "--kind", "python", "--kernel", "compiled"]) == 0
    assert main(["simulate", "five_bar.fmu", "--stop-time", "0.1"]) == 0
    assert main(["simulate", *by_rk4, "--stop-time", "0.1", "--kernel", "auto", "-o", "auto.csv"]) == 0
    assert main(["simulate", "five_bar.fmu", "--kernel", "compiled"]) == 1
    assert "fixed when it is exported" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_state_that_is_not_finite_reaches_nobody():
    """NaN through the compiled step: refused with a reason, the state before it kept."""
    e = prepared(by_rk4("five_bar"), "compiled")
    i = alfmu.Instance(e)
    assert i._scene.code
    initialized(i, {"start.angle": 0.4})
    i.step(0.02)
    with refused(i, alfmu.InputError, match=r"five_bar: .* must be a finite number"):
        i.set("A.torque", np.nan)
    before = i.save()
    i.memory["u"][0] = np.nan  # past every check
    with pytest.raises(alfmu.StepError, match=r"five_bar, t = 0.02 s: .* not finite"):
        i.step(0.02)
    i.memory["u"][0] = 0.0
    for h, t in ((0.0, None), (-1.0, None), (float("nan"), None), (0.02, 5.0), (0.02, float("nan"))):
        with pytest.raises(alfmu.InputError):
            i.step(h, t)
    assert i.save() == before
    late = {"A.torque": lambda t: np.nan if t > 0.05 else 0.0}
    with pytest.raises(alfmu.InputError, match=r"five_bar.* must be a finite number"):
        alfmu.simulate(e, 0.2, 0.02, inputs=late, kernel="compiled")
