"""What hosts do: last steps that round-off leaves, traps of floating-point numbers, stop times, times of 32 bits, looks
into steps, other locales, older systems."""

import ctypes
import os
import re
import shutil
import subprocess
import sys
import textwrap
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from drives import drive
from fmpy.fmi1 import FMICallException
from scenes import by_rk4
from test_motion import crank
from test_rubbing_motions import belt
from test_source import with_binary

import alfmu
from alfmu.model.settings import METHODS
from alfmu.runtime import build
from alfmu.runtime.compiled import compiled_scene
from alfmu.runtime.pipeline import packed
from alfmu.runtime.shipped import there
from alfmu.simulation import prepared

on_glibc = pytest.mark.skipif(
    not (sys.platform == "linux" and os.uname().machine == "x86_64"), reason="it calls glibc for x86-64"
)
kinds = pytest.mark.parametrize("kind", ["native2", "native3", "python2"])


@pytest.fixture(scope="session")
def made(fmu_of) -> Callable[..., Path]:
    """`made("native3", "five_bar", ...)`: the path of that FMU."""

    def get(kind: str, name: str = "five_bar", outputs: tuple[str, ...] = ("*",), **parameters) -> Path:
        if kind.startswith("source"):
            return with_binary(fmu_of(name, kind="source", fmi=int(kind[-1])), int(kind[-1]))
        given = {f"solver.{each}": value for each, value in parameters.items()}
        return fmu_of(name, kind=kind[:-1], fmi=int(kind[-1]), parameters=given, outputs=outputs, reference=False)

    return get


class Host:
    """A unit of an FMU as a plain importer calls it: what it logs, its outputs by names."""

    def __init__(self, path: Path, stop: float | None = None, start: float = 0.0, **options):
        description = fmpy.read_model_description(str(path))
        self.two = description.fmiVersion.startswith("2")
        self.log: list[str] = []
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.outputs = [v.valueReference for v in description.modelVariables if v.causality == "output"]
        self.unit = (fmpy.fmi2.FMU2Slave if self.two else fmpy.fmi3.FMU3Slave)(
            guid=description.guid,
            unzipDirectory=fmpy.extract(str(path)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="one",
        )
        if self.two:
            callbacks = self.callbacks = fmpy.fmi2.fmi2CallbackFunctions()
            logger = fmpy.fmi2.fmi2CallbackLoggerTYPE
            callbacks.logger = logger(lambda *said: self.log.append((said[4] or b"").decode()))
            callbacks.allocateMemory = fmpy.fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.fmi2.calloc)
            callbacks.freeMemory = fmpy.fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.fmi2.free)
            self.unit.instantiate(callbacks=callbacks, loggingOn=True)
            self.unit.setupExperiment(startTime=start, stopTime=stop)
            self.unit.enterInitializationMode()
        else:
            self.unit.instantiate(logMessage=lambda *said: self.log.append(said[-1].decode()), **options)
            self.unit.enterInitializationMode(startTime=start, stopTime=stop)
        self.unit.exitInitializationMode()
        self.step = self.unit.doStep
        self.time = start

    def read(self) -> np.ndarray:
        get = self.unit.getReal if self.two else self.unit.getFloat64
        names = [name for name in self.references if name.endswith((".x", ".y", ".angle", ".angular_velocity"))]
        return np.array(get([self.references[name] for name in names]))

    def of(self, name: str) -> float:
        return float((self.unit.getReal if self.two else self.unit.getFloat64)([self.references[name]])[0])


# Last steps -----------------------------------------------------------------------------------------------------------


LAST = [
    (kind, method, *((1.0, 0.1), (5.0, 0.02), (10.0, 0.1))[(i + j) % 3])
    for i, kind in enumerate(("native2", "native3", "python2"))
    for j, method in enumerate(("auto", "rk4", "stiff"))
]
"""Kind, method, end and step [s]: every two of them occur together."""


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "method", "end", "step"), LAST)
def test_the_last_step_that_round_off_leaves_is_made(made, kind, method, end, step):
    """A master that ends at `end` and sums up its steps; nothing moves in no time, and forces change by as much as they
    are inexact: at 10 s, beside a singular position, by 1e-9 N."""
    host, t, h = Host(made(kind, outputs=("*", "monitor.reaction_error"), method=method)), 0.0, 0.0
    names = [name for name in host.references if name.endswith((".x", ".y", ".angle", ".angular_velocity"))]
    moving = np.array([".force." not in name for name in names])
    while t < end:
        h, before, off = min(step, end - t), host.read(), host.of("monitor.reaction_error")
        host.step(t, h)
        t += h
    assert 0.0 < h < 1e-12
    assert t == end
    changes = np.abs(host.read() - before)
    assert changes[moving].max() <= 1e-11  # Constraints are closed once more.
    assert changes[~moving].max() <= 1e-11 + 2 * (off + host.of("monitor.reaction_error"))
    host.step(t, step)


def driven_crank() -> alfmu.Mechanism:
    return crank(None)


def moved_belt() -> alfmu.Mechanism:
    return belt("input")


@pytest.mark.slow
@pytest.mark.parametrize("mechanism", ["slider_crank", "end_stop", driven_crank, moved_belt])
@pytest.mark.parametrize("method", METHODS)
def test_steps_of_any_length_are_made(mechanism, method):
    """Among others, by every method: coordinates go on by rate times length, and time by the length."""
    instance = alfmu.Instance(mechanism() if callable(mechanism) else mechanism)
    if mechanism is moved_belt and method in ("trapezoidal", "generalized_alpha"):
        return  # which have no dry friction
    instance.set("solver.method", method)
    instance.initialize()
    rng = np.random.default_rng(7)

    def aim() -> None:
        if mechanism is driven_crank:
            instance.set("A.angle", 0.2 * (1 - np.cos(instance.time)))

    for exponent in np.linspace(-18, -9, 12):
        aim()
        instance.step(rng.uniform(0.005, 0.03))
        aim()
        q, v, t, h = instance.q.copy(), instance.v.copy(), instance.time, 10.0**exponent
        outputs = instance.read().copy()
        instance.step(h)
        assert instance.time == t + h
        np.testing.assert_allclose(instance.q, q + h * v, rtol=0, atol=1e-13)
        loads = [i for i, each in enumerate(instance.outputs) if ".force." in each.name or ".torque" in each.name]
        np.testing.assert_allclose(instance.read()[loads], outputs[loads], rtol=1e-5, atol=1e-5)


@pytest.mark.slow
def test_a_master_of_a_system_ends_at_its_stop_time(tmp_path):
    """As OMSimulator does it, which tells units the stop time and makes a last step of what its sum lacks."""
    alfmu.System.load(drive(tmp_path)).export(tmp_path / "drive.ssp")
    with zipfile.ZipFile(tmp_path / "drive.ssp") as archive:
        archive.extractall(tmp_path)
    end, step, t, h = 1.2, 0.005, 0.0, 0.0
    paths = {each: next(tmp_path.glob(f"resources/*{each}*.fmu")) for each in ("arm", "motor", "controller")}
    units = {each: Host(path, stop=end) for each, path in paths.items()}

    def pass_on(source: str, output: str, target: str, variable: str) -> None:
        a, b = units[source], units[target]
        b.unit.setReal([b.references[variable]], a.unit.getReal([a.references[output]]))

    while t < end:
        h = min(step, end - t)
        pass_on("motor", "torque", "arm", "A.torque")
        pass_on("arm", "link1.angular_velocity", "motor", "speed")
        pass_on("arm", "link1.angular_velocity", "controller", "measured")
        pass_on("controller", "output", "motor", "voltage")
        for host in units.values():
            host.step(t, h)
        t += h
    assert h < 1e-14
    for host in units.values():
        assert host.log == []
        with pytest.raises(FMICallException):
            host.step(end, step)


def test_a_step_that_is_lost_in_the_time_is_refused_unless_it_is_one_of_no_time():
    instance = alfmu.Instance("particle_on_circle")
    instance.time = 1e16
    instance.initialize()
    with pytest.raises(alfmu.InputError, match="below the resolution of the time"):
        instance.step(0.5)
    before = instance.q.copy()
    instance.step(1e-12)
    assert instance.time == 1e16
    np.testing.assert_allclose(instance.q, before, atol=1e-11)


# The floating-point environment ---------------------------------------------------------------------------------------

_TRAPS = """
import ctypes, os, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from test_hosts import Host
libm = ctypes.CDLL("libm.so.6")
import fmpy
traps = 1 | 4 | 8  # invalid, division by zero, overflow
for unit in ("fmi2", "fmi3"):
    slave = getattr(getattr(fmpy, unit), unit.upper().replace("FMI", "FMU") + "Slave")
    plain = slave.exitInitializationMode
    def trapped(self, *given, plain=plain):
        libm.feenableexcept(traps)
        return plain(self, *given)
    slave.exitInitializationMode = trapped
host = Host(Path({path!r}))
for k in range(60):
    host.step(0.02 * k, 0.02)
    libm.feenableexcept(traps)
rows = host.read()
assert libm.fegetexcept() == traps, libm.fegetexcept()
print(" ".join(map(float.hex, map(float, rows))))
os._exit(0)
"""


def by_another_process(code: str, **environment: str) -> str:
    command = [sys.executable, "-c", textwrap.dedent(code)]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, timeout=120, env={**os.environ, **environment}
    )
    assert done.returncode == 0, f"{done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout


@pytest.mark.slow
@on_glibc
@pytest.mark.parametrize("kind", ["native2", "native3", "python2", "source2", "source3"])
def test_a_host_that_unmasks_traps_lives_and_keeps_them(made, kind):
    """From the end of the initialisation on; the numbers are those of a host that does not."""
    path = made(kind)
    said = by_another_process(_TRAPS.format(tests=str(Path(__file__).parent), path=str(path)))
    host = Host(path)
    for k in range(60):
        host.step(0.02 * k, 0.02)
    assert [float.fromhex(each) for each in said.split()] == host.read().tolist()


@pytest.mark.slow
@on_glibc
@pytest.mark.parametrize("kind", ["native2", "native3", "source2", "source3"])
def test_a_host_that_rounds_in_another_way_has_the_same_numbers(made, kind):
    upward, libm = 0x800, ctypes.CDLL("libm.so.6")
    hosts = [Host(made(kind)) for _ in range(2)]
    for k in range(20):
        hosts[0].step(0.02 * k, 0.02)
        time = 0.02 * k
        libm.fesetround(upward)
        try:
            hosts[1].step(time, 0.02)
            assert libm.fegetround() == upward
        finally:
            libm.fesetround(0)
    assert hosts[0].read().tolist() == hosts[1].read().tolist()


# Times ----------------------------------------------------------------------------------------------------------------


@kinds
def test_no_step_leads_past_the_stop_time(made, kind):
    host = Host(made(kind), stop=0.2)
    for k in range(9):
        host.step(0.02 * k, 0.02)
    before = host.read()
    with pytest.raises(FMICallException, match="discard" if kind == "python2" else "error"):
        host.step(0.18, 0.04)
    if kind != "python2":
        assert "a step of 0.04 s leads past the stop time of 0.2 s" in host.log[-1]
    assert host.read().tolist() == before.tolist()
    host.step(0.18, 0.02 * (1 + 1e-9))  # but for round-off
    free = Host(made(kind))
    free.step(0.0, 0.5)


@pytest.mark.parametrize("kind", ["native2", "native3", "python2"])
def test_a_stop_time_before_the_start_is_refused(made, kind):
    with pytest.raises(FMICallException):
        Host(made(kind), start=1.0, stop=0.5)
    Host(made(kind), start=1.0, stop=1.0)


def test_a_reset_forgets_the_stop_time(made):
    host = Host(made("native2"), stop=0.1)
    host.unit.reset()
    host.unit.setupExperiment()
    host.unit.enterInitializationMode()
    host.unit.exitInitializationMode()
    host.step(0.0, 0.5)


@kinds
def test_a_time_of_32_bits_is_followed_and_told_once(made, kind, caplog):
    """Against a host that keeps the time in 64 bits; a time that is off by more is refused."""
    path = made(kind)
    single, double = Host(path), Host(path)
    h = np.float32(0.01)
    t, count = np.float32(0.0), 200
    for k in range(count):
        single.step(float(t), float(h))
        double.step(float(h) * k, float(h))
        t += h
    np.testing.assert_allclose(single.read(), double.read(), rtol=0, atol=1e-5)
    told = single.log if kind != "python2" else [each.getMessage() for each in caplog.records]
    assert sum("a time rounded to 32 bits" in each for each in told) == 1
    for wrong in (float(t) * (1 + 1e-6), float(t) + 0.005):
        with pytest.raises(FMICallException):
            single.step(wrong, float(h))
    single.step(float(t), float(h))


# Looks ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "rk4", "stiff"])
@pytest.mark.parametrize("name", ["five_bar", "slider_crank"])
def test_looks_into_steps_change_no_bit(made, name, method):
    seen: list[tuple[float, float]] = []

    def look(environment, time, *rest) -> None:
        seen.append((time, watched.unit.getFloat64([watched.references["A.torque"]])[0]))

    path = made("native3", name, method=method)
    watched, plain = Host(path, intermediateUpdate=look), Host(path)
    for k in range(10):
        for host in (watched, plain):
            host.unit.setFloat64([host.references["A.torque"]], [np.sin(k)])
            host.step(0.13 * k, 0.13)
        assert watched.read().tobytes() == plain.read().tobytes()
    times = [time for time, _ in seen]
    assert len(seen) == 70
    assert times == sorted(times)


# Texts and symbols ----------------------------------------------------------------------------------------------------


_COMMA = """
import locale, sys
sys.path.insert(0, {tests!r})
from pathlib import Path
from test_hosts import Host
from fmpy.fmi1 import FMICallException
locale.setlocale(locale.LC_ALL, "de_DE.UTF-8")
assert locale.localeconv()["decimal_point"] == ","
host = Host(Path({path!r}))
for call in (lambda: host.step(0.125, 0.5), lambda: host.unit.setReal([host.references["solver.step_size"]], [-0.25])):
    try:
        call()
    except FMICallException:
        pass
print("|".join(host.log))
"""


@pytest.mark.slow
def test_numbers_in_messages_have_a_point_wherever_the_host_is(made, tmp_path):
    if not shutil.which("localedef") or not Path("/usr/share/i18n/locales/de_DE").is_file():
        pytest.skip("there is nothing to make a locale of")
    command = ["localedef", "-i", "de_DE", "-f", "UTF-8", str(tmp_path / "de_DE.UTF-8")]
    subprocess.run(command, check=False, capture_output=True, timeout=60)
    code = _COMMA.format(tests=str(Path(__file__).parent), path=str(made("native2")))
    said = by_another_process(code, LOCPATH=str(tmp_path))
    assert "a step from t = 0.125 s is asked for" in said


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="it is about glibc")
def test_libraries_run_where_glibc_is_old():
    """The newest version among their symbols, also by what stands in their tables of strings."""
    libraries = [there(build.HERE, fmi) for fmi in build.VERSIONS]
    if build.compiler():
        equations = prepared(by_rk4("four_bar"))
        libraries.append(compiled_scene(equations, packed(equations)))
    for path in libraries:
        data = path.read_bytes()
        newest = max(tuple(map(int, each.split(b"."))) for each in re.findall(rb"GLIBC_([\d.]+\d)", data))
        assert build.needed(data) == ".".join(map(str, newest))
        assert newest <= (2, 17)
    assert build.needed(b"MZ") == ""
