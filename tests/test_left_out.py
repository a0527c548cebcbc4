"""What a native FMU leaves out of the runtime, as its scene does not use it, and the same numbers without it."""

import ctypes
import re
import subprocess
import zipfile
from itertools import combinations
from pathlib import Path

import casadi as ca
import pytest
from archives import changed
from fmpy.fmi2 import fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from scenes import derived, hinged, sliding

import alfmu
from alfmu.cli import main
from alfmu.fmi import native
from alfmu.fmi.drive import Fmu
from alfmu.runtime import build
from alfmu.simulation import prepared, run

by_a_compiler = pytest.mark.skipif(not build.compiler(), reason="there is no C compiler")
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-std=c99", "-ffp-contract=off")


def block() -> alfmu.Mechanism:
    """A block on the ground, which rubs, under a force that jumps."""
    m, _, guide, *_ = sliding("block", mass=2.0, start=0.0)
    m.drive(guide, ca.if_else(m.time < 0.43, 9.0, -15.0))
    m.friction(guide, coulomb=0.3, static=0.4)
    m.gravity(0, -9.81)
    return m


def led() -> alfmu.Mechanism:
    """A crank that an input turns, and a pendulum on it that a lock holds."""
    m = alfmu.Mechanism("led")
    turned, swung = (m.coordinate(name, "rad") for name in ("turned", "swung"))
    crank, bar = (m.bar(name, mass=1.0, length=1.0) for name in ("crank", "bar"))
    motor = m.revolute("motor", m.ground.at(0, 0), crank.start, coordinate=turned)
    m.motion(motor, m.input("angle", "rad"))
    m.revolute("hinge", crank.end, bar.start, coordinate=swung)
    m.lock("hinge")
    m.gravity(0, -9.81)
    return m


def five_bar() -> alfmu.Mechanism:
    return alfmu.load("five_bar")


def pendulum() -> alfmu.Mechanism:
    """A single body, of which no constraint is left."""
    return hinged("pendulum", joint="hinge", start=1.0)[0]


CASES = {
    "plain": (five_bar, {}, {"LIMITS", "ERROR_CONTROL", "MODEL_EXCHANGE"}),
    "of RK4": (five_bar, {"parameters": {"solver.method": "rk4"}}, {"LIMITS", "MODEL_EXCHANGE"}),
    "for co-simulation alone": (five_bar, {"interface": "cs"}, {"LIMITS", "ERROR_CONTROL"}),
    "with derivatives": (
        five_bar,
        {"outputs": ["link1.angle", "link1.angle/*"]},
        {"LIMITS", "ERROR_CONTROL", "INTERFACE_JACOBIAN"},
    ),
    "with a peak": (five_bar, {"outputs": ["A.force.peak"]}, {"LIMITS", "ERROR_CONTROL", "PEAKS", "MODEL_EXCHANGE"}),
    "rubbing": (block, {}, {"LIMITS", "FRICTION", "BREAKS", "ERROR_CONTROL", "MODEL_EXCHANGE"}),
    "without derivatives": (
        block,
        {"derivatives": False},
        {"LIMITS", "FRICTION", "BREAKS", "ERROR_CONTROL", "MODEL_EXCHANGE"},
    ),
    "without constraints": (pendulum, {}, {"ERROR_CONTROL", "MODEL_EXCHANGE"}),
    "led and locked": (led, {}, {"LIMITS", "MOVING_INPUTS", "SWITCHES", "ERROR_CONTROL"}),
}
each_case = pytest.mark.parametrize("case", CASES)


def sources_of(path: Path) -> dict[str, str]:
    with zipfile.ZipFile(path) as archive:
        names = [n for n in archive.namelist() if n.startswith("sources/") and n.endswith((".c", ".h"))]
        return {Path(n).name: archive.read(n).decode() for n in names}


def compiled(files: dict[str, str], library: Path, *options: str) -> None:
    """The library of these sources, which have no warnings; some take an optimisation to be found."""
    folder = library.with_suffix(".sources")
    folder.mkdir(parents=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="ascii")
    names = [name for name in files if name.endswith(".c")]
    command = [*build.compiler(), *options, *WARNINGS, "-shared", "-fPIC", *names, "-o", str(library), "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def with_library(path: Path, files: dict[str, str], other: Path, *options: str) -> Path:
    """The FMU with the library of these sources in place of its own."""
    library = other.with_suffix(".so")
    compiled(files, library, "-O0", *options)
    binary = library.read_bytes()
    return changed(path, other, lambda name, data: binary if name.startswith("binaries/") else data)


@pytest.mark.slow
@by_a_compiler
@each_case
def test_the_sources_that_a_scene_uses_give_its_numbers(fmu_of, tmp_path, case):
    """To the last bit, by a library of these sources alone."""
    mechanism, given, needed = CASES[case]
    path = fmu_of(mechanism(), kind="native", reference=False, **given)
    with Fmu(path) as fmu, Fmu(with_library(path, sources_of(path), tmp_path / "own.fmu")) as own:
        found = run(fmu, 1.0, 0.02)
        assert found.values.tobytes() == run(own, 1.0, 0.02).values.tobytes()
        assert found.values.std(axis=0).max() > 0.01  # it moves
        if "MODEL_EXCHANGE" not in needed:
            said, callbacks = [], fmi2CallbackFunctions()
            callbacks.logger = fmi2CallbackLoggerTYPE(lambda *told: said.append(told[4]))
            folder = (own._folder / "resources").as_uri().encode()
            given = own.description.guid.encode(), folder, ctypes.byref(callbacks), 0, 0
            assert not own.slave.fmi2Instantiate(b"one", 0, *given)
            assert b"supports co-simulation only" in said[-1]


@each_case
def test_what_a_scene_does_not_use_is_left_out(fmu_of, case):
    mechanism, given, needed = CASES[case]
    files = sources_of(fmu_of(mechanism(), kind="native", reference=False, **given))
    asked = {"DERIVATIVES"} if given.get("derivatives", True) else set()
    assert files == native.used(native.sources(2, native.FEATURES.keys() - needed - asked))
    assert ("friction_cover(Instance *i, double start, double h, double dt)\n{\n\tconst Scene" in files["alfmu.c"]) == (
        "FRICTION" in needed
    )
    assert sum(map(len, files.values())) < sum(map(len, native.sources(2).values()))


def test_features_are_files_of_the_runtime_with_headers_for_others():
    known = {path.name: path for path in build.sources()}
    texts = [path.read_text() for path in known.values() if path.suffix == ".h"]
    for name, feature in native.FEATURES.items():
        assert known.keys() >= {*feature.files}
        assert [text for text in texts if f"\n#ifndef WITHOUT_{name}\n" in text and "\n#else\n" in text]
    named = {name for path in known.values() for name in re.findall(r"WITHOUT_(\w+)", path.read_text())}
    assert named == native.FEATURES.keys()


WAYS = [each for each in combinations(range(6), 3) if each not in ((0, 2, 3), (1, 2, 3))]
GROUPS = dict(zip(reversed(native.FEATURES), WAYS, strict=False))
"""The compilations that leave a feature out: each other feature is in one of them, also the Jacobian, which is left out
with derivatives, too."""


def test_features_are_left_out_beside_each_other():
    def out(name: str) -> set[int]:
        more = GROUPS["DERIVATIVES"] if name == "INTERFACE_JACOBIAN" else ()
        return {*GROUPS[name], *more}

    assert GROUPS.keys() == native.FEATURES.keys()
    pairs = {(one, other) for one in GROUPS for other in GROUPS if not out(one) - out(other) and one != other}
    assert pairs == {("DERIVATIVES", "INTERFACE_JACOBIAN")}


@pytest.mark.slow
@by_a_compiler
@pytest.mark.parametrize("group", range(6))
def test_each_feature_can_be_left_out_beside_each_other(tmp_path, group):
    """But for derivatives, without which there is no Jacobian."""
    left_out = {name for name, groups in GROUPS.items() if group in groups}
    more = {"INTERFACE_JACOBIAN"} if "DERIVATIVES" in left_out else set()
    compiled(native.sources(3, left_out | more), tmp_path / "library.so", "-Og")


@pytest.mark.slow
@by_a_compiler
def test_a_library_without_what_a_scene_needs_refuses_it(fmu_of, tmp_path):
    path = fmu_of(block(), kind="native", reference=False)
    other = with_library(path, native.sources(2, native.FEATURES), tmp_path / "other.fmu")
    with pytest.raises(alfmu.AlfmuError, match="compiled for a scene without"), Fmu(other) as fmu:
        fmu.initialize()


@pytest.mark.slow
def test_a_scene_tells_what_its_fmu_leaves_out(capsys):
    assert main(["info", "five_bar", "--all"]) in (0, None)
    said = capsys.readouterr().out.partition("omitted from the C library of a native FMU\n")[2]
    left_out = native.left_out(prepared(derived("five_bar")))
    assert said.splitlines() == [f"  {native.FEATURES[name].what}" for name in left_out]
    assert "friction" in said
