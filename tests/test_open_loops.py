"""Loops that are open where a mechanism is declared or read from a file: closed over all coordinates, and told."""

import warnings
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from oracles.open_linkages import OPEN, opened
from scenes import initialized

import alfmu
from alfmu.analysis.situation import situation, source
from alfmu.formats.closing import Loops

# Random linkages ------------------------------------------------------------------------------------------------------


def apart(m: alfmu.Mechanism, q: NDArray) -> float:
    """The widest gap [m] of points that joints keep together, or difference of directions that they keep parallel."""
    found = [ca.SX(0)]
    for joint in m.spatial_joints:
        if joint.coordinates is None:
            one, two = joint.triad()[2], joint.triad(second=True)[2]
            way = joint.second.place - joint.first.place
            found.append(ca.norm_2(way if joint.kind != "cylindrical" else ca.cross(one, way)))
            if joint.kind != "spherical":
                found.append(ca.norm_2(one - two))
    known = ca.vertcat(*(c.q for c in m.coordinates))
    return np.array(ca.Function("apart", [known], [ca.vertcat(*found)])(q)).max()


@pytest.mark.slow
@pytest.mark.parametrize("planar", [False, True], ids=["spatial", "planar"])
def test_random_linkages_close(planar: bool) -> None:
    """Opened by up to 1 rad and 0.3 of their size: by the start of a run, and by what closes the loops of files."""
    for seed in range(2 if planar else 6):
        m = opened(seed, planar)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            assert apart(m, situation(source(m, {})).state.q) < 1e-10
        guesses = {c.name: float(c.guess) for c in m.coordinates}
        assert apart(m, np.array(list(guesses.values()))) > 1e-2
        closed = Loops(m, guesses, [], [], {}).close()
        assert apart(m, np.array([closed.values[c.name] for c in m.coordinates])) < 1e-9


def test_a_matrix_that_vanishes_on_one_side_of_its_diagonal_alone() -> None:
    """Constants of this linkage's joints cancel in one of two equal entries of the matrix that shares its reactions."""
    m = opened(311, True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        i = initialized(alfmu.Instance(m))
    assert apart(m, i.q) < 1e-10


def test_random_linkages_close_within_their_limits() -> None:
    """Joints stop 1.1 rad and 0.35 sizes beside an assembly; guesses are up to 1 rad and 0.3 sizes from it."""
    told = 0
    for seed in (7, 18):
        true: dict[str, float] = {}
        m = opened(seed, False, true)
        names = [c.name for c in m.coordinates if c.name[0] in "qs" and c.unit in ("rad", "m")]
        size = max([abs(float(c.guess) - true[c.name]) / OPEN[1] for c in m.coordinates if c.unit == "m"], default=1.0)
        room = {c.name: 1.1 if c.unit == "rad" else 0.35 * size for c in m.coordinates}
        for c in m.coordinates:
            if c.name in names:
                low, high = true[c.name] - room[c.name], true[c.name] + room[c.name]
                m.end_stop(f"stop_{c.name}", c.q, lower=low, upper=high, stiffness=1.0, unit=c.unit)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            q = situation(source(m, {})).state.q
        assert apart(m, q) < 1e-9
        told += any("the nearest found within limits is taken" in str(each.message) for each in caught)
        for c, x in zip(m.coordinates, q, strict=True):
            if c.name in names:
                assert abs(x - true[c.name]) < room[c.name] + 0.1 * (1.0 if c.unit == "rad" else size)
    assert told


def test_an_open_linkage_of_any_size_closes_alike() -> None:
    """Torn-off bars of a five-bar, guessed off by up to 0.6 rad and 0.3 of their size: nothing else tells its place."""
    m = alfmu.Mechanism("loose")
    L = m.parameter("L", 1.0, "m")
    ends = [m.ground.at()]
    for k, (length, x, y, angle) in enumerate([(0.6, 0.4, 0.1, 0.7), (0.9, 0.8, 0.9, 0.8), (1.1, 1.0, 0.4, -0.8)]):
        pose = (m.coordinate(f"x{k}", "m", start=x * L), m.coordinate(f"y{k}", "m", start=y * L))
        bar = m.bar(f"b{k}", mass=1.0, length=length * L, pose=(*pose, m.coordinate(f"a{k}", "rad", start=angle)))
        m.revolute(f"J{k}", ends[-1], bar.start)
        ends.append(bar.end)
    m.revolute("J3", m.ground.at(1.5 * L, 0.0), ends[-1])
    e, found, rad = alfmu.derive(m), [], [c.unit == "rad" for c in m.coordinates]
    for size in 2.0 ** np.array([0, 1, 14, -3, -20]):
        i = alfmu.Instance(e)
        i.set("L", size)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            i.initialize()
        found.append(i.q / np.where(rad, 1.0, size))
        assert np.abs(np.array(e.Phi(i.q, i.memory["p"]))).max() < 1e-12 * size
    assert np.ptp(found, axis=0).max() < 1e-12


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_one_guess_tells_the_assembly(side: float) -> None:
    """A rod guessed within 0.3 rad of one of two assemblies of a four-bar; its rocker has no guess, nothing is said."""
    m = alfmu.Mechanism("rocker")
    guess = m.parameter("guess", 0.0, "rad")
    crank = m.bar("crank", mass=1.0, length=0.3)
    rod, rocker = m.bar("rod", mass=1.0, length=0.8), m.bar("rocker", mass=1.0, length=0.7)
    turn = m.coordinate("turn", "rad", start=0.6, independent=True)
    m.revolute("A", m.ground.at(), crank.start, coordinate=turn)
    m.revolute("B", crank.end, rod.start, coordinate=m.coordinate("bend", "rad", start=guess))
    m.revolute("D", m.ground.at(0.9, 0.0), rocker.start, coordinate=m.coordinate("swing", "rad"))
    m.revolute("C", rod.end, rocker.end)
    e = alfmu.derive(m)
    for angle in np.linspace(-3.0, 3.0, 13):
        B = 0.3 * np.exp(1j * angle)  # a triangle of rod, rocker and the way from B to D
        way = 0.9 - B
        aside = np.arccos((0.8**2 + abs(way) ** 2 - 0.7**2) / (2 * 0.8 * abs(way)))
        bend = np.angle(way * np.exp(1j * (side * aside - angle)))
        for off in (-0.3, 0.0, 0.3):
            i = initialized(alfmu.Instance(e), {"start.turn": angle, "guess": bend + off})
            assert np.exp(1j * i.q[1]) == pytest.approx(np.exp(1j * bend), abs=1e-9), (angle, off)


def test_a_hinge_does_not_close_half_a_turn_away() -> None:
    """Directions that it keeps parallel are opposite there, and their product across vanishes as well."""
    m = alfmu.Mechanism("lid")
    box = {"mass": 1.0, "inertia": (1.0, 1.0, 1.0)}
    lid = m.spatial_body("lid", **box, attitude=(0.2, 0.95, 0.1, 0.2))
    m.spatial_revolute("H", m.spatial_ground.at(), lid.at(), axis=(0, 0, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        e = situation(source(m, {})).state.q[3:]
    assert e[0] ** 2 + e[3] ** 2 == pytest.approx(1.0, abs=1e-12)  # it turned about z alone, and stands upright


# Files ----------------------------------------------------------------------------------------------------------------

ARM = """<link name="{0}"><inertial><origin xyz="0.25 0 0"/><mass value="1"/>
<inertia ixx="1e-3" iyy="1e-2" izz="1e-2" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
HINGE = """<joint name="{0}" type="{5}"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0" rpy="0 0 {4}"/>
<axis xyz="0 0 1"/>{6}</joint>"""
LOOP = '<loop_joint name="tip" type="revolute"><link1 link="{}" xyz="{} 0 0" rpy="0 0 0"/>'
LOOP += '<link2 link="{}" xyz="{} 0 0" rpy="0 0 0"/><axis xyz="0 0 1"/></loop_joint>'


def five_bar(limit: str = "") -> str:
    """Two arms of two links of 0.5 m, both stretched along x from bases 0.4 m apart: their tips are 0.4 m apart."""
    kind = "revolute" if limit else "continuous"
    text = '<robot name="pair"><link name="frame"/>' + "".join(map(ARM.format, ("u1", "l1", "u2", "l2")))
    for k, base in ((1, "0"), (2, "0.4")):
        text += HINGE.format(f"s{k}", "frame", f"u{k}", base, 0, "continuous", "")
        text += HINGE.format(f"e{k}", f"u{k}", f"l{k}", "0.5", 0, kind, limit)
    return text + LOOP.format("l1", 0.5, "l2", 0.5) + "</robot>"


def tips(q: dict[str, float]) -> NDArray:
    """Where the two arms of `five_bar` end."""
    found = []
    for k, base in ((1, 0.0), (2, 0.4)):
        one, two = q[f"s{k}_angle"], q[f"s{k}_angle"] + q[f"e{k}_angle"]
        found.append([base + 0.5 * (np.cos(one) + np.cos(two)), 0.5 * (np.sin(one) + np.sin(two))])
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(("least", "most"), [(None, None), (0.05, 2.5), (-2.5, -0.05)])
def test_a_file_whose_loop_is_open_at_zero(least: float | None, most: float | None, tmp_path: Path) -> None:
    """A place that closes it is taken, within the limits of its joints, told, and has two freedoms."""
    path = tmp_path / "pair.urdf"
    limit = "" if least is None else f'<limit lower="{least}" upper="{most}" effort="1" velocity="1"/>'
    path.write_text(five_bar(limit))
    found = alfmu.imported(path)
    assert "its loops are open by up to 0.4 m or rad in the file; closing them moved" in found.moved
    assert found.moved in found.notes
    given = {s.name: s.value for s in found.mechanism.starts}
    assert len(given) == 2
    q = {c.name: given.get(c.name, c.guess) for c in found.mechanism.coordinates}
    q = {name: float(x) for name, x in q.items()}
    assert np.ptp(tips(q), axis=0) == pytest.approx(0.0, abs=1e-12)
    if least is not None:
        # Zero is outside of the limits, which reach up to it.
        assert all(min(least, 0) <= q[f"e{k}_angle"] <= max(most, 0) for k in (1, 2))
    i = initialized(alfmu.Instance(found.mechanism))
    assert (i.mobility().freedom, i.mobility().redundant) == (2, 3)
    if least is None:
        with pytest.warns(alfmu.AlfmuWarning, match=r"pair.urdf: its loops are open by up to 0\.4 m"):
            alfmu.load(str(path))


def test_a_keyframe_that_is_open_by_its_digits(tmp_path: Path) -> None:
    """What is independent keeps its value to the last digit, and nothing is warned of."""
    path = tmp_path / "four.xml"
    inertial = '<inertial pos="0 0 -0.1" mass="1" diaginertia="0.01 0.01 0.01"/>'
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody><body name="crank">{inertial}<joint name="a" axis="0 1 0"/>'
        f'<body name="rod" pos="0.3 0 -0.1">{inertial}<joint name="b" axis="0 1 0"/></body></body>'
        f'<body name="rocker" pos="0.1 0 0">{inertial}<joint name="c" axis="0 1 0"/></body></worldbody>'
        '<equality><connect body1="rod" body2="rocker" anchor="0 0 -0.4"/></equality>'
        '<actuator><motor name="u" joint="a"/></actuator>'
        '<keyframe><key name="near" qpos="0.3 0.1871 0.4366"/></keyframe></mujoco>'
    )
    found = alfmu.imported(path, key="near")
    assert not found.moved
    (note,) = [each for each in found.notes if "open" in each]
    assert "closing them moved" in note
    assert [(s.name, s.value) for s in found.mechanism.starts] == [("a_angle", 0.3)]


def test_start_values_that_do_not_close_the_loops_say_where_they_would(tmp_path: Path) -> None:
    """A crank beyond its reach: the angle up to which its rod reaches is in the message, in degrees, too."""
    m = alfmu.Mechanism("press")
    th, rod = m.coordinate("th", "rad", start=1.2, independent=True), m.coordinate("rod", "rad", start=-1.0)
    x = m.coordinate("x", "m", start=0.2)
    crank, link = m.bar("crank", mass=1.0, length=0.5), m.bar("link", mass=1.0, length=0.3)
    slider = m.body("slider", mass=1.0, pose=(x, 0.0, 0.0))
    m.revolute("A", m.ground.at(), crank.start, coordinate=th)
    m.revolute("B", crank.end, link.start, coordinate=rod)
    m.revolute("C", link.end, slider.at())
    with pytest.raises(
        alfmu.AssemblyError,
        match=r"gap of \S+ m at C; .*they close where start.th is (\S+) rad \(.* deg\) instead of 1.2",
    ) as caught:
        alfmu.Instance(m).initialize()
    reached = float(str(caught.value).split("start.th is ")[1].split()[0])
    assert 0.5 * np.sin(reached) <= 0.3 + 1e-6


PARALLELOGRAM = """<mujoco><compiler angle="radian"/><option><flag contact="disable"/></option><worldbody>
<body name="left"><joint name="a" axis="0 1 {askew}"/>{arm}
<body name="top" pos="0.3 0 -0.4"><joint name="b" axis="{askew} 1 0"/>
<inertial pos="0.1 0 0" mass="2" diaginertia="0.1 0.1 0.1"/><site name="p" pos="0.2 {off} 0"/>
<site name="pp" pos="0.2 0.1 {off}"/></body></body>
<body name="right" pos="0.2 0 0"><joint name="c" axis="0 1 0"/>{arm}<site name="q" pos="0.3 0 -0.4"/>
<site name="qq" pos="0.3 0.1 -0.4"/></body></worldbody><equality>{loops}</equality></mujoco>"""


@pytest.mark.parametrize("second", ["", '<connect site1="pp" site2="qq"/>'])
@pytest.mark.parametrize(("askew", "off"), [(0.0, 1e-7), (1e-8, 0.0), (3e-6, 2e-6)])
def test_a_loop_closed_several_times_but_for_rounding_moves(
    askew: float, off: float, second: str, tmp_path: Path
) -> None:
    """The energy of a parallelogram whose axes and points are rounded is that of a pendulum: it stood, or did not
    begin."""
    path = tmp_path / "parallelogram.xml"
    arm = '<inertial pos="0.15 0 -0.2" mass="1.2" diaginertia="0.025 0.025 0.025"/>'
    loops = f'<connect site1="p" site2="q"/>{second}'
    path.write_text(PARALLELOGRAM.format(askew=askew, off=off, arm=arm, loops=loops))
    found = alfmu.imported(path)
    (note,) = found.notes
    assert "joints of its loops constrain some directions more than once" in note
    run = alfmu.simulate(found.mechanism, 0.5, 0.05)
    angle, rate = run["a.angle"] - run["a.angle"][0], run["a.angular_velocity"]
    # Both arms turn, with their middles at half of the length 0.5 m, and the top moves along a circle of that radius.
    inertia, moment = 2 * (0.025 + 1.2 * 0.25**2) + 2 * 0.5**2, (2 * 1.2 * 0.25 + 2 * 0.5) * 9.81
    begin = np.arctan2(-0.3, 0.4)
    energy = moment * (np.cos(begin + angle) - np.cos(begin))
    assert abs(angle[-1]) > 0.5
    assert inertia / 2 * rate**2 == pytest.approx(energy, abs=1e-5)
    made: dict[str, Callable[[], alfmu.Mechanism]] = {}
    exec(found.source("made"), made)
    assert made["made"]().spatial_joints[-1].directions == found.mechanism.spatial_joints[-1].directions


def test_a_loop_that_is_askew_is_rigid(tmp_path: Path) -> None:
    """An axis that is off by more than rounding is not left out, and is warned of."""
    path = tmp_path / "parallelogram.xml"
    arm = '<inertial pos="0.15 0 -0.2" mass="1.2" diaginertia="0.025 0.025 0.025"/>'
    path.write_text(PARALLELOGRAM.format(askew=1e-3, off=0, arm=arm, loops='<connect site1="p" site2="q"/>'))
    assert "its closed loops permit no motion here" in alfmu.imported(path).moved


def test_directions_to_spare_are_those_of_a_joint_that_closes_a_loop() -> None:
    m = alfmu.Mechanism("m")
    body, held = (m.spatial_body(name, mass=1.0, inertia=(1, 1, 1), relative=True) for name in ("body", "held"))
    th = m.coordinate("th")
    m.spatial_revolute("A", m.spatial_ground.at(), body.at(), axis=(0, 0, 1), coordinate=th)
    m.spatial_revolute("C", m.spatial_ground.at(1, 0, 0), held.at(), axis=(0, 0, 1), coordinate=m.coordinate("ph"))
    B = m.spherical("B", body.at(0.5, 0, 0), held.at(-0.5, 0, 0))
    with pytest.raises(
        alfmu.DeclarationError, match="m: A closes no loop in space, so that it has no spare directions"
    ):
        m.spare("A", "x")
    with pytest.raises(alfmu.DeclarationError, match="B does not constrain 'rotation1'; it constrains x, y, z"):
        m.spare("B", "rotation1")
    m.spare(B, "z")
    assert B.directions == ("x", "y")
