"""Compiled kernels: the C and its numbers, the cache, FMUs that need no CasADi, and what happens without a compiler."""

import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scenes import derived

import alfmu
from alfmu.cli import main
from alfmu.fmi import native
from alfmu.fmi.drive import Fmu, validate
from alfmu.kernel import build, emit, stream
from alfmu.kernel.program import LIBRARY, SUFFIX
from alfmu.simulation import prepared, run

START = {"start.angle": 0.4, "m2": 0.5}


scenes = pytest.mark.parametrize(
    ("name", "options"),
    [("five_bar", {}), ("slider_crank", {"coordinates": "natural"}), ("n_four_bar", {"coordinates": "natural"})],
    ids=["five_bar", "slider_crank", "n_four_bar"],
)


@pytest.fixture
def own_cache(tmp_path, monkeypatch) -> Path:
    """A cache folder that nobody else uses."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "alfmu"


@pytest.fixture(scope="module")
def five_bar(tmp_path_factory) -> Path:
    """The FMU of the five-bar with a compiled kernel, and the portable form beside it."""
    return alfmu.export("five_bar", tmp_path_factory.mktemp("compiled") / "five_bar.fmu", kernel="compiled")


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
    library = build.compiled(replace(e, functions={"f": f}, signatures={"f": signature})).library
    values, y = np.zeros(2), np.zeros(len(results))
    call = library.bind("f", [values], [y])
    for values[:] in ((0.3, 0.7), (0.7, 0.3), (0.5, 0.5), (0.9, -0.4)):
        call()
        expected = np.array(f(values)).reshape(-1)
        assert np.allclose(y, expected, rtol=4e-16, atol=0, equal_nan=True)


def test_an_operation_that_has_no_c_is_named():
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.erfinv(x)])
    with pytest.raises(alfmu.ExportError, match=r"some_scene: operation \d+ of f has no C here; use --kernel vm"):
        stream.Instructions.of(f).check("some_scene", f.name())


@scenes
def test_the_c_is_free_of_warnings(name, options, tmp_path):
    if not (command := build.compiler()):
        pytest.skip("no compiler")
    for i, text in enumerate(emit.sources(prepared(derived(name, **options)))[0]):
        (tmp_path / f"{i}.c").write_text(text)
        flags = ["-Wall", "-Wextra", "-Werror", "-c", f"{i}.c"]
        done = subprocess.run([*command, *flags], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@scenes
def test_functions_cut_into_blocks_and_files_give_the_same_numbers(name, options, monkeypatch, own_cache):
    """Blocks of 30 operations in many files, against whole functions in one."""
    whole = prepared(derived(name, **options), "compiled")
    monkeypatch.setattr(emit, "BLOCK", 30)
    monkeypatch.setattr(emit, "WHOLE", 30)
    monkeypatch.setattr(emit, "UNIT", 20000)
    cut = prepared(derived(name, **options), "compiled")
    assert len(emit.sources(cut)[0]) > 5
    assert cut.workspace > whole.workspace
    start = {"start.angle": 0.4}
    runs = [alfmu.simulate(e, 1.0, 0.02, parameters=start, kernel="compiled") for e in (whole, cut)]
    assert np.array_equal(runs[0].values, runs[1].values)


def test_a_library_is_built_once_and_kept(own_cache, monkeypatch):
    prepared(derived("particle_on_circle"), "compiled")
    (path,) = own_cache.iterdir()
    made = path.stat().st_mtime_ns
    monkeypatch.setattr(build, "build", None)  # would fail
    assert prepared(derived("particle_on_circle"), "compiled").library.path == path
    assert path.stat().st_mtime_ns == made


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


damages = pytest.mark.parametrize("how", ["a bit", "an end", "nothing", "more"])


@damages
def test_a_damaged_library_is_built_again_and_never_loaded(own_cache, how):
    expected = alfmu.simulate("particle_on_circle", 0.1, 0.02, kernel="compiled").values
    (path,) = own_cache.iterdir()
    content = spoiled(path, how)
    e = prepared(derived("particle_on_circle"), "compiled")
    assert e.library.path.read_bytes() == content
    assert list(own_cache.iterdir()) == [e.library.path]
    assert np.array_equal(alfmu.simulate(e, 0.1, 0.02).values, expected)


@damages
@pytest.mark.parametrize("kind", ["python", "native"])
def test_a_damaged_library_is_never_in_an_fmu(own_cache, tmp_path, kind, how):
    """Export builds it again, and says that all went well only then."""
    command = ["export", "particle_on_circle", "--kind", kind, *["--kernel", "compiled"] * (kind == "python")]
    found = []
    for name in ("one", "two"):
        assert main([*command, "--output", str(tmp_path / f"{name}.fmu")]) == 0
        with zipfile.ZipFile(tmp_path / f"{name}.fmu") as archive:
            libraries = [x for x in archive.namelist() if x.endswith((LIBRARY, f"particle_on_circle{SUFFIX}"))]
            found.append({x: archive.read(x) for x in libraries if kind == "native" or x.endswith(LIBRARY)})
        for path in own_cache.iterdir():
            spoiled(path, how)
    assert len(found[0]) == 1
    assert list(found[0].values()) == list(found[1].values())


def test_a_library_that_is_damaged_once_it_is_loaded_is_not_exported(own_cache):
    e = prepared(derived("particle_on_circle"), "compiled")
    spoiled(e.library.path, "a bit")
    with pytest.raises(alfmu.ExportError, match=r"particle_on_circle: the library .* was damaged"):
        native.content(e.name, e.library.path)


def test_several_processes_may_build_at_once(own_cache):
    """Each gets a library that works, and one whole file is left."""
    code = (
        "import alfmu; r = alfmu.simulate('particle_on_circle', 0.1, 0.02, kernel='compiled'); "
        "print(r['particle.x'][-1].hex())"
    )
    running = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(4)]
    said = {process.communicate(timeout=120)[0] for process in running}
    assert [process.returncode for process in running] == [0] * 4
    assert len(said) == 1
    assert len(list(own_cache.iterdir())) == 1


def test_without_a_compiler(monkeypatch, own_cache):
    monkeypatch.setattr(build, "compiler", lambda: None)
    monkeypatch.setattr("alfmu.simulation.compiler", lambda: None)
    with pytest.raises(alfmu.ExportError, match=r"particle_on_circle: no C compiler found .* use --kernel vm"):
        alfmu.simulate("particle_on_circle", 0.1, 0.02, kernel="compiled")
    e = prepared(derived("particle_on_circle"), "auto")
    assert e.library is None
    assert alfmu.Instance(e).machine is not None


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


def in_fmpy(path: Path, blocked: str) -> subprocess.CompletedProcess:
    """A process with fmpy that runs an FMU for 0.5 s and prints an angle; some packages cannot be imported in it."""
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({blocked!r}.split()))\n"
        "import fmpy\n"
        f"r = fmpy.simulate_fmu({str(path)!r}, stop_time=0.5, output_interval=0.02, start_values={START!r},\n"
        "                      debug_logging=True)\n"
        "print(r['time'][-1], r['link2.x'][-1].hex(), r['A.force.x'][-1].hex())\n"
    )
    environment = {**os.environ, "PYTHONPATH": ""}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


def test_a_compiled_fmu_needs_neither_casadi_nor_alfmu(five_bar):
    """The same numbers as with the library, in a process where neither can be imported; and the log says what runs."""
    done = in_fmpy(five_bar, "casadi alfmu alfmu_mechanisms scipy")
    assert "five_bar: compiled kernel for" in done.stdout + done.stderr
    library = alfmu.simulate("five_bar", 0.5, 0.02, parameters=START, kernel="compiled")
    expected = f"0.5 {library['link2.x'][-1].hex()} {library['A.force.x'][-1].hex()}"
    assert expected in done.stdout, done.stdout + done.stderr


def changed(source: Path, target: Path, leave_out: str) -> Path:
    """An FMU without one of its resources."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            if name != f"resources/{leave_out}":
                new.writestr(name, old.read(name))
    return target


def test_on_another_platform_the_portable_form_runs(five_bar, tmp_path):
    """As if the library were for another platform: the FMU runs by CasADi, says so, and gives the same numbers."""
    elsewhere = changed(five_bar, tmp_path / "elsewhere.fmu", LIBRARY)
    done = in_fmpy(elsewhere, "alfmu")
    assert "five_bar: portable kernel" in done.stdout + done.stderr
    assert in_fmpy(five_bar, "").stdout.splitlines()[-1] == done.stdout.splitlines()[-1]
    without = in_fmpy(elsewhere, "casadi")
    assert (
        "five_bar: the portable kernel needs the Python package casadi; install it" in without.stdout + without.stderr
    )


def test_an_fmu_for_one_platform_says_so_elsewhere(tmp_path):
    alone = alfmu.export("five_bar", tmp_path / "alone.fmu", kernel="compiled", portable=False)
    names = zipfile.ZipFile(alone).namelist()
    assert "resources/functions.json" not in names
    assert not any(name.endswith(("kernel/vm.py", "kernel/trace.py")) for name in names)
    assert validate(alone) == []
    needs = zipfile.ZipFile(alone).read("documentation/externalDependencies.txt").decode()
    assert "casadi" not in needs
    assert "on another platform" in needs
    assert len(needs.strip().splitlines()) == 1
    elsewhere = changed(alone, tmp_path / "elsewhere.fmu", LIBRARY)
    done = in_fmpy(elsewhere, "")
    assert "nothing for" in done.stdout + done.stderr
    assert "export it without --no-portable" in done.stdout + done.stderr


def test_a_compiled_fmu_validates_saves_and_restores(five_bar):
    assert validate(five_bar) == []
    with Fmu(five_bar) as fmu:
        result = run(fmu, 1.0, 0.05, inputs={"A.torque": lambda t: t}, parameters=START)
    library = alfmu.simulate("five_bar", 1.0, 0.05, inputs={"A.torque": lambda t: t}, parameters=START)
    assert np.abs(result.values - library.values).max() <= 1e-11 * np.abs(library.values).max()


def test_the_same_export_gives_the_same_bytes(five_bar, tmp_path):
    assert alfmu.export("five_bar", tmp_path / "five_bar.fmu", kernel="compiled").read_bytes() == five_bar.read_bytes()


def test_from_the_command_line(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["export", "five_bar", "--kernel", "compiled", "--no-portable"]) == 0
    assert main(["simulate", "five_bar.fmu", "--stop-time", "0.1"]) == 0
    assert main(["simulate", "five_bar", "--stop-time", "0.1", "--kernel", "auto", "-o", "auto.csv"]) == 0
    assert main(["simulate", "five_bar.fmu", "--kernel", "compiled"]) == 1
    assert "fixed when it is exported" in capsys.readouterr().err


def test_a_state_that_is_not_finite_reaches_nobody():
    """NaN through the compiled step: refused with a reason, the state before it kept."""
    i = alfmu.Instance(prepared(derived("five_bar"), "compiled"))
    i.set("start.angle", 0.4)
    i.initialize()
    i.step(0.02)
    before = i.save()
    i.inputs[0] = np.nan
    with pytest.raises(alfmu.InputError, match=r"five_bar: .* must be a finite number"):
        i.step(0.02)
    i.inputs[0] = 0.0
    for h, t in ((0.0, None), (-1.0, None), (float("nan"), None), (0.02, 5.0), (0.02, float("nan"))):
        with pytest.raises(alfmu.InputError):
            i.step(h, t)
    assert i.save() == before
