"""Mechanisms written as MJCF, URDF and SDF: their motion when alfmu reads them back, and accelerations of MuJoCo and
Pinocchio with rigid loops."""

import importlib.util
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pytest
from oracles.converted import BUILT, floating, robot, shaper
from oracles.linkages import by_pinocchio, mujoco_accelerations
from scenes import hinged
from scipy.integrate import solve_ivp

import alfmu
from alfmu import Mechanism
from alfmu.cli import main

HERE = Path(__file__).parent / "linkages"
MUJOCO = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed (extra bench)")
PINOCCHIO = pytest.mark.skipif(importlib.util.find_spec("pinocchio") is None, reason="Pinocchio is not installed")
FORMS = (".xml", ".urdf", ".sdf")
EXACT = {"solver.method": "explicit", "solver.relative_tolerance": 1e-12}

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


def named(mechanism: Mechanism, pattern: str) -> list[str]:
    """Outputs that match, as scenes with all of them take longer to make; the mechanism is measured then."""
    return [x.name for x in alfmu.derive(measured(mechanism)).outputs if re.fullmatch(pattern, x.name)]


def readings(mechanism: Mechanism, given: dict[str, float], inputs: dict[str, float]) -> list[dict[str, float]]:
    """Accelerations and rates at the start, by the names of joints in files."""
    asked = named(mechanism, r"(?!monitor)\w+\.(angular_)?(acceleration|velocity)\d?")
    given = given | {"solver.method": "rk4"}
    run = alfmu.simulate(mechanism, 1e-4, 1e-4, parameters=given, inputs=inputs, outputs=asked)
    found: dict[str, dict[str, float]] = {"acceleration": {}, "velocity": {}}
    for output in asked:
        base, turns, what, digit = re.fullmatch(r"(\w+)\.(angular_)?(acceleration|velocity)(\d?)", output).groups()
        word = ("angle" if turns else "position") + digit
        found[what][base] = found[what][f"{base}.{word}"] = run[output][0]
    return [*found.values()]


def motions(
    mechanism: Mechanism, seconds: float, given: dict[str, float] | None = None, inputs: dict[str, float] | None = None
) -> dict[str, np.ndarray]:
    """Displacements of joints by output."""
    asked, given = named(mechanism, r"\w+\.(angle|position)\d?"), EXACT | (given or {})
    run = alfmu.simulate(mechanism, seconds, seconds / 10, parameters=given, inputs=inputs, outputs=asked)
    return {x: run[x] for x in asked}


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
    ".urdf": [name for name in ALL if name not in ("shaper", "stewart", "floating", "servos")],
    ".sdf": [name for name in ALL if name not in ("shaper", "raft", "joints", "servos")],
}
"""Mechanisms that formats hold."""

FEW = [*BUILT, "four_bar, joint", "five_bar, mixed", "slider_crank, absolute", "slider_crank, natural"]
"""Mechanisms of which each is in the plane in some of its coordinates; accelerations are compared in all of them."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "name"),
    [(suffix, name) for name in FEW for suffix, names in HELD.items() if name in names],  # so each is derived once
)
def test_what_is_read_back_moves_alike(suffix: str, name: str, tmp_path: Path):
    mjcf = suffix == ".xml"
    given = starts(name, 0, rests=not mjcf)
    path = alfmu.convert(measured(ALL[name]()), tmp_path / f"file{suffix}", parameters=given)
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
        path = alfmu.convert(measured(ALL[name]()), tmp_path / "file.xml", parameters=given)
        model = mujoco.MjModel.from_xml_path(str(path))
        key, controls = model.key("start"), np.zeros(model.nu)
        inputs = {x.name: 0.3 - 0.2 * k for k, x in enumerate(ALL[name]().inputs)}
        for k in range(model.nu):
            controls[k] = inputs.get(model.actuator(k).name, 0.0)
        reference, _, opens = mujoco_accelerations(path, key.qpos, key.qvel, controls, rubs=True)
        assert opens < 1e-11
        found, rates = readings(ALL[name](), given, inputs)
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
        path = alfmu.convert(measured(ALL[name]()), tmp_path / "file.urdf", parameters=given)
        root = ElementTree.parse(path).getroot()
        inputs = {x.name: 0.3 - 0.2 * k for k, x in enumerate(ALL[name]().inputs)}
        efforts = {x.find("joint").get("name"): inputs[x.get("name")] for x in root.findall("transmission")}
        found, rates = readings(ALL[name](), given, inputs)
        moved = {x.get("name") for x in root.findall("joint") if x.get("type") != "fixed"}
        for mimic in (x for x in root.findall("joint") if x.find("mimic") is not None):
            follows = mimic.find("mimic")
            rates[mimic.get("name")] = float(follows.get("multiplier")) * rates[follows.get("joint")]
        reference, opens = by_pinocchio(path, {x: rates[x] for x in moved}, efforts)
        assert opens < 1e-11
        size = max(map(abs, reference.values()))
        for joint in moved & found.keys():
            np.testing.assert_allclose(found[joint], reference[joint], atol=1e-10 * size, rtol=0)


@PINOCCHIO
def test_a_flying_base_with_a_loop_moves_as_in_pinocchio(tmp_path: Path):
    """At rest, as its base has rates that Pinocchio counts in other axes."""
    given = starts("floating", 0, rests=True)
    path = alfmu.convert(floating(springs=False), tmp_path / "file.urdf", parameters=given)
    found, _ = readings(floating(springs=False), given, {"torque": 0.4})
    joints_ = {x.get("name") for x in ElementTree.parse(path).getroot().findall("joint")} & found.keys()
    reference, _ = by_pinocchio(path, {}, {"A": 0.4 - 0.02})  # dry friction as it begins to slide
    assert len(joints_) == 3
    for joint in joints_:
        assert abs(found[joint] - reference[joint]) < 1e-10 * max(map(abs, reference.values()))


FILES = {"five_bar.xml": FORMS[2:], "carried.xml": FORMS, "slider_crank.xml": FORMS[1:2], "slider_crank.sdf": FORMS,
         "four_bar.urdf": FORMS, "spatial.xml": FORMS[:1], "coupled.xml": FORMS[:1]}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_files_that_are_read_and_written_move_alike(name: str, tmp_path: Path):
    own = alfmu.imported(HERE / name).mechanism
    pushed = {x.name: 0.1 for x in own.inputs}
    one = motions(own, 0.2, inputs=pushed)
    for suffix in FILES[name]:
        path = alfmu.convert(str(HERE / name), tmp_path / f"file{suffix}")
        options = {".xml": {"key": "start"}, ".sdf": {"drives": "all"}}.get(suffix, {})
        back = alfmu.imported(path, **options).mechanism
        driven = {drive.joint.name for drive in own.drives}
        names = {x.name: x.name.removesuffix("_drive") for x in back.inputs}
        again = {x: 0.1 for x, joint in names.items() if joint in driven | pushed.keys()}
        assert len(again) == len(pushed)
        assert same(one, motions(back, 0.2, inputs=again), shift=suffix != ".xml") >= 3


def test_limits_and_springs_stand_where_they_were(tmp_path: Path):
    """In MJCF by their own numbers, in the other formats from the start."""
    roots = {}
    for name, suffixes in (("press", FORMS), ("stewart", (".xml", ".sdf"))):
        for suffix in suffixes:
            path = alfmu.convert(ALL[name](), tmp_path / f"{name}{suffix}")
            root = ElementTree.parse(path).getroot()
            roots[name + suffix] = {x.get("name"): x for x in root.iter("joint")}
    guide, leg = roots["press.xml"]["guide"], roots["stewart.xml"]["leg2"]
    assert guide.get("range").split() == ["-1e+16", "2.0"]
    start = float(guide.get("ref"))
    assert float(roots["press.urdf"]["guide"].find("limit").get("upper")) == pytest.approx(2.0 - start, abs=1e-15)
    assert float(roots["press.sdf"]["guide"].find("axis/limit/upper").text) == pytest.approx(2.0 - start, abs=1e-15)
    assert [float(x) for x in leg.get("range").split()] == [0.2, 0.9]
    assert float(leg.get("springref")) == pytest.approx(0.5, abs=1e-15)
    axis, start = roots["stewart.sdf"]["leg2"].find("axis"), float(leg.get("ref"))
    for where, x in (("limit/lower", 0.2), ("limit/upper", 0.9), ("dynamics/spring_reference", 0.5)):
        assert float(axis.find(where).text) == pytest.approx(x - start, abs=1e-15)


def test_what_a_format_cannot_hold_is_refused_at_once(tmp_path: Path, capsys: pytest.CaptureFixture):
    path = tmp_path / "file.urdf"
    with pytest.raises(alfmu.InputError, match="shaper is refused for 3 reasons") as refused:
        alfmu.convert(shaper(), path)
    for part in ("motor: its input torque is scaled", "motor: a constant effort", "pivot: URDF holds no springs"):
        assert part in str(refused.value)
    assert main(["convert", "bennett", "-o", str(path)]) == 1
    assert "declare bodies and joints" in capsys.readouterr().err
    with pytest.raises(
        alfmu.InputError, match=r"file\.txt is not a file .* converts to; its name must end in one of \.xml, \.urdf"
    ):
        alfmu.convert(robot(), tmp_path / "file.txt")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("mass", [0.0, 1.0])
def test_links_without_mass_or_inertia_are_refused_where_the_other_program_refuses_them(mass: float, tmp_path: Path):
    m = Mechanism("thin")
    rod = m.spatial_body("rod", mass=mass, inertia=(0.0, mass, mass), relative=True)
    other = m.spatial_body("other", mass=1.0, inertia=(1.0, 1.0, 1.0), relative=True)
    turns = [m.coordinate(f"q{i}", "rad", start=0.0, independent=True) for i in range(3)]
    m.spatial_revolute("A", m.spatial_ground.at(), rod.at(), axis=(0, 1, 0), coordinate=turns[0])
    m.spatial_revolute("B", rod.at(1, 0, 0), other.at(), axis=(0, 0, 1), coordinate=turns[1])
    third = m.spatial_body("third", mass=1.0, inertia=(1.0, 1.0, 1.0), relative=True)
    m.spatial_revolute("C", rod.at(0.5, 0, 0), third.at(), axis=(0, 0, 1), coordinate=turns[2])
    m.gravity(0, 0, -9.81)
    with pytest.raises(alfmu.InputError, match=r"thin: rod: it has (no mass|a moment of inertia that is zero)"):
        alfmu.convert(m, tmp_path / "file.xml")
    if mass:
        alfmu.convert(m, tmp_path / "file.sdf")
    else:
        with pytest.raises(alfmu.InputError, match="thin: rod: it has no mass, and links of SDF have one"):
            alfmu.convert(m, tmp_path / "file.sdf")
    alfmu.convert(m, tmp_path / "file.urdf")
    assert same(motions(m, 0.2), motions(alfmu.imported(tmp_path / "file.urdf").mechanism, 0.2), shift=True) == 3


@pytest.mark.slow
@pytest.mark.parametrize("slack", [False, True])
def test_springs_dampers_and_inertia_along_sums_are_those_of_tendons(slack: bool, tmp_path: Path):
    """Two sliders, one actuator with feedback on both, by the equations of two masses (DOP853); read back from MJCF."""
    m, k, d, more, ends = Mechanism("sums"), 40.0, 3.0, 0.4, (-0.1, 0.05 if slack else -0.1)
    c, masses, starts = np.array([1.0, -2.0]), np.array([0.7, 0.3]), (0.2, -0.1)
    x = [m.coordinate(f"x{i}", "m", start=starts[i], independent=True) for i in range(2)]
    ways = []
    for i in range(2):
        block = m.spatial_body(f"b{i}", mass=float(masses[i]), inertia=(0.1, 0.1, 0.1), relative=True)
        at = m.spatial_ground.at(0, i, 0)
        ways.append(m.spatial_prismatic(f"way{i}", at, block.at(), axis=(1, 0, 0), coordinate=x[i]))
    length, rate = c[0] * x[0] + c[1] * x[1], c[0] * m.rate(x[0]) + c[1] * m.rate(x[1])
    stretch = length - (ca.fmin(ca.fmax(length, ends[0]), ends[1]) if slack else ends[0])
    m.potential_energy(k / 2 * stretch**2)
    m.kinetic_energy(more / 2 * rate**2)
    for i in range(2):
        m.generalized_force(x[i], -d * c[i] * rate)
    m.end_stop("stop", length, upper=9.0, stiffness=1e3, unit="m")
    m.end_stop("far", 0.1 - 2 * x[0], lower=-9.3, stiffness=1e3, unit="m")
    effort = 2 * m.input("u", "N", start=0.3) + 0.1 - 5 * length - 0.4 * rate
    effort = ca.fmin(ca.fmax(effort, -0.4), 0.5) if slack else effort
    for i in range(2):
        m.drive(ways[i], float(c[i]) * effort)
    m.gravity(0, 0, -9.81)

    def forces(_: float, y: np.ndarray) -> np.ndarray:
        apart = c @ y[:2]
        pull = k * (apart - np.clip(apart, *ends)) + d * c @ y[2:]
        pull -= np.clip(0.7 - 5 * apart - 0.4 * c @ y[2:], *((-0.4, 0.5) if slack else (-9, 9)))
        return np.append(y[2:], np.linalg.solve(np.diag(masses) + more * np.outer(c, c), -c * pull))

    path = alfmu.convert(m, tmp_path / "sums.xml")
    run = alfmu.simulate(alfmu.imported(path, key="start").mechanism, 1.0, 0.1, parameters=EXACT, outputs=["b?.x"])
    wanted = solve_ivp(forces, (0, 1), (*starts, 0, 0), "DOP853", run.time, rtol=1e-12, atol=1e-13, max_step=1e-3).y
    for i in range(2):
        np.testing.assert_allclose(run[f"b{i}.x"], wanted[i], atol=1e-9)
    root = ElementTree.parse(path).getroot()
    fixed = root.findall("tendon/fixed")
    assert len(fixed) == 2  # that of the actuator, and one with the spring, the damper, the inertia and the limit
    (one,) = [each for each in fixed if each.get("range")]
    assert set(one.attrib) == {"name", "stiffness", "damping", "armature", "springlength", "range"}
    assert [float(x) for x in root.find(".//joint[@name='way0']").get("range").split()] == [-1e16, 4.7]
    for suffix in (".urdf", ".sdf"):
        with pytest.raises(alfmu.InputError, match="this energy or force is an expression"):
            alfmu.convert(m, tmp_path / f"sums{suffix}")
    if slack:  # of another sum than the one within limits
        m.potential_energy((length + 2.0 * x[0] - ca.fmin(length, 1.0)) ** 2)
        with pytest.raises(alfmu.InputError, match="this energy or force is an expression"):
            alfmu.convert(m, path)
    m.generalized_force(x[0], -2.0 * m.rate(x[1]))
    with pytest.raises(alfmu.InputError, match="forces by rates act along it that no dampers"):
        alfmu.convert(m, path)


@pytest.mark.parametrize("suffix", FORMS)
def test_the_inertia_of_a_welded_body_without_mass_goes_to_its_neighbour(suffix: str, tmp_path: Path):
    """A pendulum with a flange, a flywheel and a frame welded to it falls as one body (DOP853)."""
    m, mass, length, own, more = Mechanism("flange"), 0.8, 0.3, 0.01, (0.02, 0.05)
    arm = m.spatial_body("arm", mass=mass, inertia=(own,) * 3, center=(length, 0, 0), relative=True)
    q = m.coordinate("q", "rad", start=0.4, independent=True)
    m.spatial_revolute("A", m.spatial_ground.at(), arm.at(), axis=(0, 1, 0), coordinate=q)
    before = arm
    for i, x in enumerate((*more, 0.0)):
        flange = m.spatial_body(f"flange{i}", mass=0.0, inertia=(x, x, x), relative=True)
        m.spatial_weld(f"weld{i}", before.at(0.1, 0.2, 0.3), flange.at())
        before = flange
    m.gravity(0, 0, -9.81)

    def falls(_: float, y: np.ndarray) -> list[float]:
        return [y[1], mass * 9.81 * length * np.cos(y[0]) / (own + sum(more) + mass * length**2)]

    path = alfmu.convert(m, tmp_path / f"flange{suffix}")
    run = alfmu.simulate(alfmu.imported(path).mechanism, 0.5, 0.1, parameters=EXACT, outputs=["A.angle"])
    swings = solve_ivp(falls, (0, 0.5), (0.4, 0.0), "DOP853", run.time, rtol=1e-12, atol=1e-12).y[0]
    np.testing.assert_allclose(run["A.angle"] - run["A.angle"][0], swings - 0.4, atol=1e-9)


def alone(what: str) -> Mechanism:
    """A pendulum with one part that no file holds."""
    m, bar, pin, th = hinged("pendulum", start=0.3, independent=True)
    if what == "world":
        m.revolute("B", m.ground.at(1, 0), m.body("world", mass=1.0, inertia=1.0).at(),
                   coordinate=m.coordinate("other", "rad", start=0.0, independent=True))  # fmt: skip
    if what == "pose":
        m.body("block", mass=1.0, inertia=1.0, pose=(m.coordinate("x", "m", start=0.0, independent=True), 0.0, 0.0))
    parts = {
        "spring": lambda: m.spring_damper((m.ground.at(1, 0), bar.end), stiffness=1.0),
        "friction": lambda: m.friction(pin, coulomb=0.1, radius=0.1),
        "static": lambda: m.friction(pin, coulomb=0.1, static=0.2, load=1.0),
        "lock": lambda: m.lock(pin),
        "law": lambda: m.motion(th, 0.3 + 0.1 * m.time),
        "effort": lambda: m.drive(pin, th**2),
        "force": lambda: m.force(bar.end, 1.0, 0.0),
        "rod": lambda: m.distance("rod", m.ground.at(0, 1), bar.end, length=float(np.sqrt(2 - 2 * np.sin(0.3)))),
        "energy": lambda: m.potential_energy(th**2),
        "power": lambda: m.potential_energy(th**4),
        "armature": lambda: m.kinetic_energy(0.1 * m.rate(th) ** 2),
        "rotor": lambda: m.kinetic_energy(0.1 * m.rate(th) ** 2 * th),
        "blade": lambda: m.blade("blade", bar.end),
        "stiffness": lambda: m.spring_damper(pin, damping=th**2),
        "gravity": lambda: m.gravity(0, -9.0),
        "sum": lambda: m.end_stop("stop", 2 * th + 0.1, upper=1.0, stiffness=1.0, unit="rad"),
        "stop": lambda: m.end_stop("stop", th**2, upper=1.0, stiffness=1.0, unit="rad"),
        "apart": lambda: [m.end_stop(f"to{k + 1}", k * th, upper=-0.5, stiffness=1.0, unit="rad") for k in (-1, 1)],
    }
    if what in parts:
        parts[what]()
    return m


REFUSED = {
    "spring": "a spring acts between points", "friction": "in proportion to the reaction", "static": "static friction",
    "lock": "it is a lock", "law": "depend on time", "effort": "not a sum of inputs",
    "force": "a force from the ground", "rod": "a rod without mass",
    "energy": "holds no springs", "power": "is an expression",
    "armature": "holds no inertia of motors", "rotor": "is an expression", "blade": "it is a blade",
    "world": "the name of the ground in files", "stiffness": "no constant",
    "gravity": r"it is 9 m/s2; in a URDF",
    "pose": "permit 4 motions, and the coordinates 2", "stop": "pendulum: an end stop: an end stop acts",
    "apart": "to2: end stops of A leave no angle or way between 0.5 and -0.5",
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_parts_that_no_file_holds_are_refused_by_name(what: str, tmp_path: Path):
    with pytest.raises(alfmu.InputError, match=REFUSED[what]):
        alfmu.convert(alone(what), tmp_path / "file.urdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", FORMS)
def test_a_stop_along_a_multiple_of_an_angle_is_a_limit_of_the_joint(suffix: str, tmp_path: Path):
    """2 th + 0.1 = 1 at th = 0.45, which is 0.15 from the start."""
    root = ElementTree.parse(alfmu.convert(alone("sum"), tmp_path / f"file{suffix}")).getroot()
    given = {
        ".xml": lambda: root.find(".//joint").get("range").split()[1],
        ".urdf": lambda: root.find(".//limit").get("upper"),
        ".sdf": lambda: root.find(".//limit/upper").text,
    }
    assert float(given[suffix]()) == pytest.approx(0.45 if suffix == ".xml" else 0.15, abs=1e-15)
