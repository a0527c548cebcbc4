"""Mechanisms written as MJCF, URDF and SDF: their motion when alfmu reads them back, and accelerations of MuJoCo and
Pinocchio with rigid loops."""

import importlib.util
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from oracles.converted import BUILT
from oracles.linkages import by_pinocchio, mujoco_accelerations

import alfmu
from alfmu import Mechanism

HERE = Path(__file__).parent / "linkages"
MUJOCO = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed (extra bench)")
PINOCCHIO = pytest.mark.skipif(importlib.util.find_spec("pinocchio") is None, reason="Pinocchio is not installed")
EXACT = {"solver.relative_tolerance": 1e-12}

PLANE = {
    f"{name}, {coordinates}": lambda name=name, coordinates=coordinates: alfmu.load(name, coordinates=coordinates)
    for name in ("four_bar", "five_bar", "slider_crank")
    for coordinates in ("absolute", "joint", "mixed", "natural")
    if name == "slider_crank" or coordinates in ("joint", "mixed")
}
"""Mechanisms in the plane in all their coordinates."""

ALL = BUILT | PLANE


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Let files be read and written without what they leave out: other tests judge that."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", alfmu.AlfmuWarning)
        yield


def starts(name: str, seed: int, rests: bool = False) -> dict[str, float]:
    """Start values near those declared, away from the singular position of the parallelograms."""
    rng, given = np.random.default_rng(seed), dict[str, float]()
    for s in ALL[name]().starts:
        value = 0.7 if name.startswith(("four", "five")) else s.value
        scale = 0.02 if s.unit == "1" else 0.05
        given[f"start.{s.name}"] = value + scale * rng.normal()
        given[f"start.{s.rate_name}"] = 0.0 if rests else s.rate + (0.3 * rng.normal() if s.unit != "1" else 0.0)
    return given


def measured(mechanism: Mechanism) -> Mechanism:
    mechanism.measures_all = True
    return mechanism


def named(joint: str, what: str) -> list[str]:
    """Names that an output of a joint of a file can have."""
    base, _, which = joint.partition(".")
    digit = which[-1:] if which[-1:].isdigit() else ""
    words = {"": ("angle", "position"), "velocity": ("angular_velocity", "velocity"),
             "acceleration": ("angular_acceleration", "acceleration")}[what]  # fmt: skip
    chosen = words if not which else words[:1] if which.startswith("angle") else words[1:]
    return [f"{base}.{word}{digit}" for word in chosen]


def readings(name: str, given: dict[str, float], inputs: dict[str, float], what: str) -> dict[str, float]:
    """Rates or accelerations at the start, by the names of joints in files."""
    run = alfmu.simulate(measured(ALL[name]()), 1e-4, 1e-4, parameters=given | EXACT, inputs=inputs)
    found = {}
    for output in run.names:
        match = re.fullmatch(rf"(\w+)\.(angular_)?{what}(\d?)", output)
        if match and match[1] != "monitor":
            base, turns, digit = match.groups()
            word = ("angle" if turns else "position") + digit
            found[base] = found[f"{base}.{word}"] = run[output][0]
    return found


def motions(mechanism: Mechanism, seconds: float, given: dict[str, float] | None = None) -> dict[str, np.ndarray]:
    run = alfmu.simulate(measured(mechanism), seconds, seconds / 10, parameters=EXACT | (given or {}))
    return {x: run[x] for x in run.names if re.fullmatch(r"\w+\.(angle|position)\d?", x)}


def same(one: dict[str, np.ndarray], two: dict[str, np.ndarray], shift: bool) -> int:
    """Compare displacements of joints by name, from the start on if they are shifted; return how many."""
    count = 0
    for output, x in one.items():
        base, _, word = output.rpartition(".")
        kinds = ("angle", "position")
        others = [output, *(f"{base}_{word}.{kind}" for kind in kinds)]
        found = next((two[k] for k in others if k in two), None)
        if found is None:
            continue
        apart = (x - x[0] - found + found[0]) if shift else x - found
        if "angle" in word:
            apart -= 2 * np.pi * np.round(apart / (2 * np.pi))
        assert np.abs(apart).max() < 1e-9, output
        count += 1
    return count


HELD = {
    ".xml": list(ALL),
    ".urdf": [name for name in ALL if name not in ("shaper", "stewart", "floating")],
    ".sdf": [name for name in ALL if name not in ("shaper", "raft", "joints")],
}
"""Mechanisms that formats hold."""


@pytest.mark.slow
@pytest.mark.parametrize(("suffix", "name"), [(suffix, name) for suffix, names in HELD.items() for name in names])
def test_what_is_read_back_moves_alike(suffix: str, name: str, tmp_path: Path):
    mjcf = suffix == ".xml"
    given = starts(name, 0, rests=not mjcf)
    path = alfmu.convert(ALL[name](), tmp_path / f"file{suffix}", parameters=given)
    back = alfmu.imported(path, **({"key": "start"} if mjcf else {}))
    assert not back.moved
    one = motions(ALL[name](), 0.3, given)
    assert max(np.ptp(x) for x in one.values()) > 0.02 or name == "raft"
    assert same(one, motions(back.mechanism, 0.3), shift=not mjcf) >= 2


@MUJOCO
@pytest.mark.parametrize("name", ALL)
def test_accelerations_are_those_of_mujoco(name: str, tmp_path: Path):
    import mujoco

    for seed in range(3):
        given = starts(name, seed)
        path = alfmu.convert(ALL[name](), tmp_path / "file.xml", parameters=given)
        model = mujoco.MjModel.from_xml_path(str(path))
        key, controls = model.key("start"), np.zeros(model.nu)
        inputs = {x.name: 0.3 - 0.2 * k for k, x in enumerate(ALL[name]().inputs)}
        for k in range(model.nu):
            controls[k] = inputs.get(model.actuator(k).name, 0.0)
        reference, _, opens = mujoco_accelerations(path, key.qpos, key.qvel, controls, rubs=True)
        assert opens < 1e-11
        found, rates = (readings(name, given, inputs, what) for what in ("acceleration", "velocity"))
        compared = 0
        for j in range(model.njnt):
            joint, d = model.joint(j).name, model.jnt_dofadr[j]
            if joint in found:
                np.testing.assert_allclose(key.qvel[d], rates[joint], atol=1e-11)
                np.testing.assert_allclose(found[joint], reference[d], atol=1e-10 * np.abs(reference).max(), rtol=0)
                compared += 1
        assert compared >= 3 or (compared == 2 and name == "shaper")


@MUJOCO
@pytest.mark.parametrize("name", ["robot", "press", "shaper"])
def test_displacements_keep_their_numbers_in_mujoco(name: str, tmp_path: Path):
    """Accelerations of a file at places and rates that another file has for its start."""
    import mujoco

    path = alfmu.convert(ALL[name](), tmp_path / "file.xml", parameters=starts(name, 0))
    other = alfmu.convert(ALL[name](), tmp_path / "other.xml", parameters=starts(name, 1))
    key = mujoco.MjModel.from_xml_path(str(other)).key("start")
    controls = np.zeros(mujoco.MjModel.from_xml_path(str(path)).nu)
    found, reference = (mujoco_accelerations(each, key.qpos, key.qvel, controls)[0] for each in (path, other))
    assert np.abs(reference).max() > 1
    np.testing.assert_allclose(found, reference, atol=1e-10 * np.abs(reference).max(), rtol=0)


@PINOCCHIO
@pytest.mark.parametrize("name", [name for name in HELD[".urdf"] if name not in ("delta", "raft", "joints")])
def test_accelerations_are_those_of_pinocchio(name: str, tmp_path: Path):
    for seed in range(3):
        given = starts(name, seed)
        path = alfmu.convert(ALL[name](), tmp_path / "file.urdf", parameters=given)
        root = ElementTree.parse(path).getroot()
        inputs = {x.name: 0.3 - 0.2 * k for k, x in enumerate(ALL[name]().inputs)}
        efforts = {x.find("joint").get("name"): inputs[x.get("name")] for x in root.findall("transmission")}
        found, rates = (readings(name, given, inputs, what) for what in ("acceleration", "velocity"))
        moved = [x.get("name") for x in root.findall("joint") if x.get("type") != "fixed"]
        reference, opens = by_pinocchio(path, {x: rates[x] for x in moved}, efforts)
        assert opens < 1e-11
        size = max(map(abs, reference.values()))
        for joint in moved:
            np.testing.assert_allclose(found[joint], reference[joint], atol=1e-10 * size, rtol=0)
