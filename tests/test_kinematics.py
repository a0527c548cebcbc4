"""Kinematics and inverse dynamics by the actuated joints: closed forms, other methods, singular positions, refusals."""

import cmath
import importlib.util
import itertools
import json
import math
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from oracles.linkages import by_mujoco
from oracles.newton_euler import NewtonEuler
from scenes import hinged, sliding
from scipy.spatial.transform import Rotation
from turned import KINDS, Linkage

import alfmu
from alfmu import InputError, Mechanism, kinematics
from alfmu.cli import main
from alfmu.model.spatial import about

HERE = Path(__file__).parent / "linkages"
MUJOCO = importlib.util.find_spec("mujoco") is not None

# A robot with five bars: two cranks on the ground, two rods that meet in the tool

CRANK, ROD, BASE = 0.3, 0.4, 0.4
LAWS = {"A": lambda t, sin: 2.0 + 0.3 * sin(3 * t), "B": lambda t, sin: 1.1 + 0.2 * sin(2 * t)}
SORTS = ("joint", "absolute", "natural", "mixed")


def five_bar(sort: str = "joint", turn: float = 0.0, shift: complex = 0j, motion: str = "") -> Mechanism:
    m = Mechanism("robot")
    angle = {"A": 2.0, "B": 1.1}
    feet = {"A": shift, "B": shift + BASE * cmath.exp(1j * turn)}
    elbows = {k: feet[k] + CRANK * cmath.exp(1j * (angle[k] + turn)) for k in "AB"}
    tool = by_circles(elbows["A"], elbows["B"])
    points = {}
    if sort == "natural":
        for name, z in (*elbows.items(), ("tool", tool)):
            xy = [m.coordinate(f"{name}{axis}", "m", start=x) for axis, x in (("x", z.real), ("y", z.imag))]
            points[name] = m.point(*xy)
    ends = {}
    for k in "AB":
        ground = m.ground.at(feet[k].real, feet[k].imag)
        rod_angle = cmath.phase(tool - elbows[k])
        if sort == "natural":
            crank = m.bar(f"crank{k}", mass=1.0, length=CRANK, between=(ground, points[k]))
            rod = m.bar(f"rod{k}", mass=0.5, length=ROD, between=(points[k], points["tool"]))
            joint = m.revolute(k, ground, crank.start)
            m.revolute(f"elbow{k}", crank.end, rod.start)
        elif sort == "absolute":
            poses = []
            for name, z, a in (("crank", (feet[k] + elbows[k]) / 2, angle[k] + turn),
                               ("rod", (elbows[k] + tool) / 2, rod_angle)):  # fmt: skip
                given = (("x", "m", z.real), ("y", "m", z.imag), ("a", "rad", a))
                poses.append(tuple(m.coordinate(f"{name}{k}_{axis}", unit, start=x) for axis, unit, x in given))
            crank, rod = (
                m.bar(f"{name}{k}", mass=mass, length=length, pose=pose)
                for name, mass, length, pose in (("crank", 1.0, CRANK, poses[0]), ("rod", 0.5, ROD, poses[1]))
            )
            joint = m.revolute(k, ground, crank.start)
            m.revolute(f"elbow{k}", crank.end, rod.start)
        else:
            own = m.coordinate(f"crank_angle{k}", "rad", start=angle[k] + turn, independent=True)
            crank = m.bar(f"crank{k}", mass=1.0, length=CRANK)
            joint = m.revolute(k, ground, crank.start, coordinate=own)
            if sort == "mixed":
                z = (elbows[k] + tool) / 2
                given = (("x", "m", z.real), ("y", "m", z.imag), ("a", "rad", rod_angle))
                pose = tuple(m.coordinate(f"rod{k}_{axis}", unit, start=x) for axis, unit, x in given)
                rod = m.bar(f"rod{k}", mass=0.5, length=ROD, pose=pose)
                m.revolute(f"elbow{k}", crank.end, rod.start)
            else:
                rod = m.bar(f"rod{k}", mass=0.5, length=ROD)
                bend = m.coordinate(f"bend{k}", "rad", start=rod_angle - angle[k] - turn)
                m.revolute(f"elbow{k}", crank.end, rod.start, coordinate=bend)
        ends[k] = rod.end
        if motion == "law":
            m.motion(joint, LAWS[k](m.time, ca.sin))
        elif motion:
            m.motion(joint, m.input(f"{k}.goal", "rad", start=angle[k], derivatives=2))
        else:
            m.drive(joint, m.input(f"{k}.torque", "N.m"))
    m.revolute("E", ends["A"], ends["B"])
    m.watch("tool", ends["A"])
    down = -9.81j * cmath.exp(1j * turn)
    m.gravity(down.real, down.imag)
    return m


def by_circles(c: complex, d: complex, side: float = 1.0) -> complex:
    """The tool above both elbows, where circles about them meet."""
    middle, half = (c + d) / 2, (d - c) / 2
    return middle + side * 1j * half / abs(half) * math.sqrt(ROD**2 - abs(half) ** 2)


def elbow_angle(foot: complex, tool: complex, side: float) -> float:
    """Angle of a crank whose rod reaches the tool."""
    apart = tool - foot
    bend = math.acos((CRANK**2 + abs(apart) ** 2 - ROD**2) / (2 * CRANK * abs(apart)))
    return cmath.phase(apart) + side * bend


@pytest.mark.parametrize("sort", SORTS)
def test_five_bar_by_circles(sort: str):
    """Forward and inverse in all kinds of coordinates, and the Jacobian by its rows of Gosselin and Angeles."""
    k = kinematics(five_bar(sort))
    assert (k.actuated, k.freedom, k.redundant) == (("A", "B"), 2, 0)
    position = k.start
    for a, b in ((1.9, 1.2), (2.1, 0.9), (1.5, 1.9)):
        position = k.forward({"A": a, "B": b}, position)
        c, d = CRANK * cmath.exp(1j * a), BASE + CRANK * cmath.exp(1j * b)
        tool = by_circles(c, d)
        assert position.gap < 1e-12
        np.testing.assert_allclose(position["tool"], (tool.real, tool.imag), atol=1e-12)
        found = k.transmission(position)
        # (tool - c) . tool' = (tool - c) . i (c - a) a'
        left = np.array([[(tool - z).real, (tool - z).imag] for z in (c, d)])
        right = np.diag([((tool - z) * (1j * (z - foot)).conjugate()).real for z, foot in ((c, 0), (d, BASE))])
        np.testing.assert_allclose(found.matrix, np.linalg.solve(left, right), atol=1e-11)
        assert found.manipulability == pytest.approx(abs(np.linalg.det(found.matrix)), rel=1e-10)
        assert found.singular == ()
    back = k.inverse({"tool": (0.25, 0.5)})
    wanted = (elbow_angle(0, 0.25 + 0.5j, 1.0), elbow_angle(BASE, 0.25 + 0.5j, -1.0))
    np.testing.assert_allclose([back["A"], back["B"]], wanted, atol=1e-11)
    np.testing.assert_allclose(back["tool"], (0.25, 0.5), atol=1e-12)


def test_all_solutions():
    """Four inverse ones, two assemblies, the nearest first; coordinates without a start value move as well."""
    k = kinematics(five_bar("natural"))
    found = k.solutions({"tool": (0.2, 0.45)})
    every = {(a, b) for a in (1, -1) for b in (1, -1)}
    wanted = sorted((elbow_angle(0, 0.2 + 0.45j, a), elbow_angle(BASE, 0.2 + 0.45j, b)) for a, b in every)
    turned = sorted(tuple(round(math.remainder(x[name], 2 * math.pi), 12) for name in "AB") for x in found)
    np.testing.assert_allclose(turned, wanted, atol=1e-10)
    np.testing.assert_allclose([found[0]["A"], found[0]["B"]], (wanted[-2]), atol=1e-10)
    c, d = CRANK * cmath.exp(1.9j), BASE + CRANK * cmath.exp(1.2j)
    places = [x["tool"] for x in k.solutions({"A": 1.9, "B": 1.2})]
    tools = [by_circles(c, d, side) for side in (1.0, -1.0)]
    np.testing.assert_allclose(places, [(z.real, z.imag) for z in tools], atol=1e-11)


def four_bar_in_space(size: float = 1.0) -> Mechanism:
    """Bodies stand along the ground's axes at the start, where their e1 to e3 are zero."""
    m = Mechanism("space")
    m.gravity(0, 0, 0)
    points = {"O": (0.0, 0.0), "A": (0.0, 0.3), "B": (0.8, 0.5), "C": (0.8, 0.0)}
    points = {name: size * np.array(place) for name, place in points.items()}
    bodies, middles = {None: m.spatial_ground}, {None: np.zeros(2)}
    for name, ends in (("crank", "OA"), ("coupler", "AB"), ("rocker", "CB")):
        middles[name] = np.mean([points[end] for end in ends], 0)
        bodies[name] = m.spatial_body(name, mass=1.0, inertia=(0.1 * size**2,) * 3, position=(*middles[name], 0.0))
    for name, one, two in (
        ("O", None, "crank"),
        ("A", "crank", "coupler"),
        ("C", None, "rocker"),
        ("B", "coupler", "rocker"),
    ):
        ends = [bodies[x].at(*map(float, points[name] - middles[x])) for x in (one, two)]
        m.spatial_revolute(name, *ends, axis=(0, 0, 1))
    return m


def test_solutions_of_bodies_with_euler_parameters_are_closed():
    found = kinematics(four_bar_in_space(), ["O"], ["C"]).solutions({"O": 0.4})
    tip = cmath.rect(0.3, math.pi / 2 + 0.4)
    way, sides = 0.8 - tip, (abs(0.8 + 0.2j), 0.5)
    bend = triangle(sides[0], abs(way), sides[1])
    ends = [tip + cmath.rect(sides[0], cmath.phase(way) + side * bend) for side in (1, -1)]
    got = sorted((each["coupler"][:2] for each in found), key=lambda x: -x[1])
    wanted = sorted([[((tip + end) / 2).real, ((tip + end) / 2).imag] for end in ends], key=lambda x: -x[1])
    np.testing.assert_allclose(got, wanted, atol=1e-10)
    assert max(each.gap for each in found) < 1e-12


@pytest.mark.slow
def test_singular_positions_are_judged_alike_at_any_size():
    """The numbers of a linkage in proportion are the same."""
    judged = [kinematics(four_bar_in_space(size), ["O"], ["C"]).transmission() for size in (1.0, 0.01, 2.0, 10.0)]
    numbers = np.array([[each.constraint, each.parallel, each.serial] for each in judged])
    np.testing.assert_allclose(numbers, numbers[[0]].repeat(4, 0), rtol=1e-9)


@pytest.mark.parametrize("sort", SORTS)
def test_turned_and_shifted(sort: str):
    """Numbers of the verdict and efforts are the same in other axes and coordinates."""
    plain, moved = kinematics(five_bar()), kinematics(five_bar(sort, 0.7, 3.0 - 20.0j))
    for tool in (0.25 + 0.5j, 0.1 + 0.45j):
        there = tool * cmath.exp(0.7j) + 3.0 - 20.0j
        here = plain.inverse({"tool": (tool.real, tool.imag)}), moved.inverse({"tool": (there.real, there.imag)})
        seen = plain.transmission(here[0]), moved.transmission(here[1])
        for name in ("parallel", "serial", "manipulability", "size"):
            assert getattr(seen[1], name) == pytest.approx(getattr(seen[0], name), rel=1e-9)
        np.testing.assert_allclose(seen[1].singular_values, seen[0].singular_values, rtol=1e-9)
        efforts = [k.efforts(x, (1.0, -2.0), (3.0, 0.5)) for k, x in zip((plain, moved), here, strict=True)]
        np.testing.assert_allclose([*efforts[1].values()], [*efforts[0].values()], atol=1e-9)


@pytest.mark.parametrize("sort", SORTS)
def test_singular_positions_of_the_five_bar(sort: str):
    k = kinematics(five_bar(sort))
    # Rods in line: the motors cannot hold the tool.
    a = math.acos(-2 / 3)
    position = k.inverse({"tool": (0.2, CRANK * math.sin(a) + 0.02)})
    assert k.transmission(position).singular == ()
    position = k.inverse({"tool": (0.2, CRANK * math.sin(a))}, position)
    found = k.transmission(position)
    assert found.singular == ("parallel",)
    assert found.parallel < 1e-7
    assert min(found.serial, found.constraint) > 0.1
    assert np.isnan(found.matrix).all()
    with pytest.raises(InputError, match=r"robot: the position is a parallel singularity .*singular at or below 1e-05"):
        k.efforts(position)
    # One arm stretched: the tool cannot follow.
    reach = (CRANK + ROD) * cmath.exp(1.2j)
    b = elbow_angle(BASE, reach, -1.0)
    position = k.forward({"A": 1.2, "B": b})
    np.testing.assert_allclose(position["tool"], (reach.real, reach.imag), atol=1e-7)
    found = k.transmission(position)
    assert found.singular == ("serial",)
    assert found.serial < 1e-6
    assert found.parallel > 0.1
    assert np.linalg.svd(found.matrix, compute_uv=False)[1] < 1e-6
    k.efforts(position)
    assert k.transmission(k.forward({"A": 1.201, "B": b - 0.01})).singular == ()


@pytest.mark.parametrize("sort", ["natural", "absolute"])
def test_the_verdict_is_the_same_far_away(sort: str):
    here, there = (kinematics(five_bar(sort, shift=shift)) for shift in (0j, 2e4 + 1e4j))
    found, far = here.transmission(here.start), there.transmission(there.start)
    assert far.singular == ()
    assert far.constraint == pytest.approx(found.constraint, rel=1e-6)


@pytest.mark.slow
def test_equilibria_are_found_far_away():
    """The places of the search lie about the start, wherever that is."""
    near, far = (alfmu.equilibrium(five_bar("absolute", 0.3, shift)) for shift in (0j, 300 - 200j))
    assert len(near) > 8
    heights = [sorted(x.outputs["tool.y"] - y for x in some) for some, y in ((near, 0.0), (far, -200.0))]
    np.testing.assert_allclose(heights[1], heights[0], atol=1e-9)


def test_constraint_singularity():
    """All bars of the parallelogram in line: loops let a second motion begin."""
    k = kinematics("five_bar", ["th1"], ["link2"])
    found = k.transmission()
    assert found.singular == ("constraint",)
    assert found.constraint < 1e-7
    assert k.transmission(k.forward({"th1": 0.3})).singular == ()
    with pytest.raises(InputError, match="five_bar: the position is a constraint singularity"):
        k.efforts()
    with pytest.raises(InputError, match="five_bar: the cycle begins at a constraint singularity"):
        k.cycle()
    cycle = k.cycle(near=k.forward({"th1": 0.3}), rows=9)
    np.testing.assert_allclose(cycle["link2.x"], np.cos(cycle["th1"]) + 0.5, atol=1e-10)


# In space -----------------------------------------------------------------------------------------------------------

TURN = Rotation.from_rotvec((0.3, -0.5, 0.4))
SHIFT = np.array((2.0, -3.0, 5.0))
ARM, REACH, OUT, TOP = 0.2, 0.45, 0.15, 0.05
PLAIN = (Rotation.identity(), np.zeros(3))


def delta(turn: Rotation = PLAIN[0], shift: np.ndarray = PLAIN[1]) -> Mechanism:
    """Three arms on the base, and from each two rods to the platform that stay parallel."""
    m = Mechanism("delta")
    down = [*map(float, turn.apply([0, 0, -0.4]) + shift)]
    x, y, z, w = turn.as_quat()
    platform = m.spatial_body(
        "platform", mass=0.5, inertia=(1e-3, 1e-3, 2e-3), position=tuple(down), attitude=(w, x, y, z)
    )
    for i in range(3):
        spin = turn * Rotation.from_rotvec([0, 0, 2 * math.pi * i / 3])
        foot = m.spatial_ground.at(*map(float, spin.apply([OUT, 0, 0]) + shift))
        inertia = (spin.as_matrix() @ np.diag([1e-5, 1e-3, 1e-3]) @ spin.as_matrix().T).tolist()
        arm = m.spatial_body(
            f"arm{i}", mass=0.3, inertia=inertia, center=tuple(spin.apply([ARM / 2, 0, 0])), relative=True
        )
        angle = m.coordinate(f"angle{i}", "rad", start=0.2, independent=True)
        motor = m.spatial_revolute(
            f"motor{i}", foot, arm.at(0, 0, 0), axis=tuple(spin.apply([0, 1, 0])), coordinate=angle
        )
        own = Rotation.from_rotvec([0, 0, 2 * math.pi * i / 3])
        for side in (-0.03, 0.03):
            on_arm, on_top = arm.at(*spin.apply([ARM, side, 0])), platform.at(*own.apply([TOP, side, 0]))
            m.distance(f"rod{i}{'ab'[side > 0]}", on_arm, on_top, length=REACH)
        m.drive(motor, m.input(f"torque{i}", "N.m"))
    m.gravity(*map(float, turn.apply([0, 0, -9.81])))
    m.watch("tool", platform.at(0, 0, 0))
    return m


def delta_angles(place: np.ndarray, bends: tuple[int, ...] = (1, 1, 1)) -> list[float]:
    """Closed form: the end of each arm is on a circle and on a sphere about the corner of the platform."""
    found = []
    for i in range(3):
        x, y, z = Rotation.from_rotvec([0, 0, -2 * math.pi * i / 3]).apply(place)
        a, b = x + TOP - OUT, -z
        # |(a, y, -b) - ARM (cos, 0, -sin)| = REACH
        c = (a * a + b * b + y * y + ARM**2 - REACH**2) / (2 * ARM)
        angle = math.atan2(b, a) - bends[i] * math.acos(c / math.hypot(a, b))
        found.append(math.remainder(angle, 2 * math.pi))
    return found


@pytest.mark.parametrize(("turn", "shift"), [PLAIN, (TURN, SHIFT)])
def test_delta_robot(turn: Rotation, shift: np.ndarray):
    """Inverse kinematics against the closed form, forward back, the Jacobian by its rods, the weight."""
    k = kinematics(delta(turn, shift))
    assert (k.freedom, k.actuated) == (3, ("motor0", "motor1", "motor2"))
    position = k.start
    for place in ((0.0, 0.0, -0.42), (0.08, -0.03, -0.4), (-0.05, 0.1, -0.45)):
        there = turn.apply(place) + shift
        position = k.inverse({"tool": there}, position)
        angles = delta_angles(np.array(place))
        np.testing.assert_allclose([*position.actuated.values()], angles, atol=1e-11)
        back = k.forward(angles, k.start)
        np.testing.assert_allclose(back["tool"], there, atol=1e-11)
        assert back.gap < 1e-12
        found = k.transmission(position)
        left, right = np.zeros((3, 3)), np.zeros(3)
        for i, angle in enumerate(angles):
            spin = Rotation.from_rotvec([0, 0, 2 * math.pi * i / 3])
            end = spin.apply([OUT + ARM * math.cos(angle), 0, -ARM * math.sin(angle)])
            left[i] = np.array(place) + spin.apply([TOP, 0, 0]) - end
            right[i] = left[i] @ spin.apply([-ARM * math.sin(angle), 0, -ARM * math.cos(angle)])
        wanted = turn.as_matrix() @ np.linalg.solve(left, np.diag(right))
        np.testing.assert_allclose(found.matrix, wanted, atol=1e-10)
        # At rest the motors carry the platform and the arms: the potential energy by their angles.
        rise = 0.5 * 9.81 * (turn.as_matrix().T @ wanted)[2] - 0.3 * 9.81 * ARM / 2 * np.cos(angles)
        np.testing.assert_allclose([*k.efforts(position).values()], rise, atol=1e-11)


@pytest.mark.slow
def test_all_eight_solutions_of_the_delta_robot():
    place = np.array((-0.05, 0.1, -0.45))
    found = kinematics(delta(shift=SHIFT)).solutions({"tool": place + SHIFT}, starts=256)
    angles = [[math.remainder(x, 2 * math.pi) for x in each.actuated.values()] for each in found]
    for bends in itertools.product((1, -1), repeat=3):
        assert np.abs(np.array(angles) - delta_angles(place, bends)).max(axis=1).min() < 1e-9
    assert max(each.gap for each in found) < 1e-12


def leg(m: Mechanism, i: int, foot: np.ndarray, head: np.ndarray, kind: str) -> tuple:
    """Cylinder and rod of a leg, on a universal joint or a hinge; the prismatic joint is `leg<i>`."""
    way = (head - foot) / np.linalg.norm(head - foot)
    side = np.cross(way, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(way, side)
    given = {"mass": 1.0, "inertia": (0.02, 0.02, 0.02), "center": tuple(0.1 * way), "relative": True}
    cylinder, rod = (m.spatial_body(f"{x}{i}", **given) for x in ("cylinder", "rod"))
    ground = m.spatial_ground.at(*map(float, foot))
    if kind == "universal":
        angles = [m.coordinate(f"tilt{i}{x}", "rad") for x in "ab"]
        m.universal(
            f"foot{i}", ground, cylinder.at(0, 0, 0), axis=tuple(side), second_axis=tuple(other), coordinates=angles
        )
    else:
        axis = np.cross([0, 0, 1.0], foot) / np.linalg.norm(foot[:2])
        m.spatial_revolute(
            f"foot{i}", ground, cylinder.at(0, 0, 0), axis=tuple(axis), coordinate=m.coordinate(f"tilt{i}", "rad")
        )
    length = m.coordinate(f"length{i}", "m", start=float(np.linalg.norm(head - foot)), independent=True)
    joint = m.spatial_prismatic(f"leg{i}", cylinder.at(0, 0, 0), rod.at(0, 0, 0), axis=tuple(way), coordinate=length)
    m.drive(joint, m.input(f"force{i}", "N"))
    return rod


def stewart() -> tuple[Mechanism, np.ndarray, np.ndarray]:
    m = Mechanism("stewart")
    feet = np.array([[math.cos(a), math.sin(a), 0.0] for a in np.radians([-10, 10, 110, 130, 230, 250])])
    heads = 0.6 * np.array([[math.cos(a), math.sin(a), 0.0] for a in np.radians([-50, 50, 70, 170, 190, 290])])
    platform = m.spatial_body("platform", mass=10.0, inertia=(1.0, 1.0, 2.0), position=(0, 0, 0.9))
    for i, (foot, head) in enumerate(zip(feet, heads, strict=True)):
        rod = leg(m, i, foot, head + np.array([0, 0, 0.9]), "universal")
        m.spherical(f"head{i}", rod.at(0, 0, 0), platform.at(*head))
    m.gravity(0, 0, -9.81)
    return m, feet, heads


@pytest.mark.slow
def test_stewart_platform():
    """Lengths of the legs for a pose, the pose from the lengths, and the Jacobian by the screws of the legs."""
    m, feet, heads = stewart()
    k = kinematics(m, watch=["platform"])
    turn = Rotation.from_rotvec((0.15, -0.1, 0.2))
    place = np.array((0.05, -0.08, 1.0))
    x, y, z, w = turn.as_quat()
    found = k.inverse({"platform": (*place, w, x, y, z)})
    lengths = np.linalg.norm(place + turn.apply(heads) - feet, axis=1)
    np.testing.assert_allclose([*found.actuated.values()], lengths, atol=1e-11)
    back = k.forward(lengths)
    np.testing.assert_allclose(back["platform"][:3], place, atol=1e-10)
    seen = k.transmission(back)
    assert seen.rows[3:] == tuple(f"platform.angular_velocity.{axis}" for axis in "xyz")
    ways = (place + turn.apply(heads) - feet) / lengths[:, None]
    rows = np.hstack([ways, np.cross(turn.apply(heads), ways)])
    np.testing.assert_allclose(seen.matrix @ rows, np.eye(6), atol=1e-9)
    assert found["leg3"] == found["length3"] == pytest.approx(lengths[3])


def test_three_rps():
    """Heads of the legs stay in their planes; lengths follow from the pose, and the pose from the lengths."""
    m = Mechanism("rps")
    feet = np.array([[math.cos(a), math.sin(a), 0.0] for a in 2 * math.pi * np.arange(3) / 3])
    heads = 0.5 * feet
    platform = m.spatial_body("platform", mass=10.0, inertia=(1.0, 1.0, 2.0), position=(0, 0, 1.0))
    for i in range(3):
        m.spherical(
            f"head{i}",
            leg(m, i, feet[i], heads[i] + np.array([0, 0, 1.0]), "revolute").at(0, 0, 0),
            platform.at(*heads[i]),
        )
        m.watch(f"P{i}", platform.at(*heads[i]))
    m.gravity(0, 0, -9.81)
    k = kinematics(m, watch=["platform"])
    assert k.freedom == 3
    position = k.forward({"leg0": 1.3, "leg1": 1.15, "leg2": 1.05})
    for i in range(3):
        place = position[f"P{i}"]
        assert np.linalg.norm(place - feet[i]) == pytest.approx(position[f"leg{i}"], abs=1e-12)
        assert abs(np.cross(feet[i], place)[2]) < 1e-12
    other = k.inverse({"platform.z": 1.05, "platform.e1": 0.05, "platform.e2": -0.03})
    np.testing.assert_allclose([*other.actuated.values()],
                               [np.linalg.norm(other[f"P{i}"] - feet[i]) for i in range(3)], atol=1e-12)  # fmt: skip
    assert [other[f"platform.{x}"] for x in ("z", "e1", "e2")] == pytest.approx([1.05, 0.05, -0.03], abs=1e-11)
    assert k.transmission(position).singular == ()


# Inverse dynamics ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "absolute"),
    [(kind, ("", "l", "lc")[k % 3]) for k, kind in enumerate(KINDS)],
    ids=lambda x: getattr(x, "__name__", x),
)
def test_efforts_move_bodies_by_newton_and_gauss(kind, absolute: str):
    """The effort of the first joint, put on bodies by Newton and Euler, gives the acceleration asked for."""
    linkage: Linkage = kind(np.random.default_rng(5))
    names = [each.name for each in linkage.links]
    k = kinematics(linkage.declared(absolute=absolute), ["J0"], names)
    position = k.forward({"J0": k.start["J0"] + 0.1})
    rate, acceleration = 1.3, -2.1
    tau = k.efforts(position, {"J0": rate}, {"J0": acceleration})["J0"]
    oracle, seen = NewtonEuler(linkage), k.transmission(position)
    state, wrenches = np.zeros((len(names), 13)), np.zeros((len(names), 6))
    velocity = dict(zip(seen.rows, seen.matrix[:, 0] * rate, strict=True))
    for b, name in enumerate(names):
        e = [position[f"{name}.e{i}"] for i in range(4)]
        state[b, :3], state[b, 3:7] = [position[f"{name}.{x}"] for x in "xyz"], [*e[1:], e[0]]
        state[b, 7:10] = [velocity[f"{name}.{x}"] for x in "xyz"]
        state[b, 10:] = [velocity[f"{name}.angular_velocity.{x}"] for x in "xyz"]
    first = linkage.joints[0]
    axis, body = np.array(first.axis), names.index(first.second)
    wrenches[body, 3:] = tau * axis
    found = oracle.accelerations(state, wrenches)
    assert abs(tau) > 0.1
    assert found[body, 3:] @ axis == pytest.approx(acceleration, abs=1e-10 * max(1.0, np.abs(found).max()))


@pytest.mark.skipif(not MUJOCO, reason="MuJoCo is not installed (extra bench)")
@pytest.mark.parametrize(("name", "motor"), [("five_bar", ""), ("slider_crank", "main")])
def test_efforts_give_mujocos_accelerations(name: str, motor: str, tmp_path: Path):
    """Efforts as controls of the motors, with rigid rows, give all the accelerations of the motion."""
    path = tmp_path / f"{name}.xml"
    more = f'<actuator><motor name="m" joint="{motor}"/></actuator></mujoco>'
    text = (HERE / path.name).read_text()
    path.write_text(text.replace("</mujoco>", more) if motor else text)
    k = kinematics(alfmu.imported(path).mechanism)
    position = k.forward([x + 0.2 for x in k.start.actuated.values()])
    rates, accelerations = (1.1, -0.7)[: k.freedom], (2.0, 3.0)[: k.freedom]
    u = np.array([*k.efforts(position, rates, accelerations).values()])
    assert 0.01 < np.abs(u).max() < 5  # within the range of the controls
    s, a = k._motion(position.q / k._loops.scale, rates, accelerations)
    names = [c.name for c in k._where.equations.coordinates]
    found, reference, opens = by_mujoco(path, names, s.q, s.v, a, u)
    assert opens < 1e-12
    np.testing.assert_allclose(found, reference, atol=1e-10 * np.abs(reference).max(), rtol=0)


def test_efforts_of_a_simulated_motion():
    """Prescribed motions take the efforts found, also with dampers and springs; the mechanism itself is unchanged."""
    m = five_bar(motion="law")
    m.spring_damper((m.ground.at(0.1, 0.9), m.bodies[1].end), stiffness=20.0, damping=3.0, rest=0.3)
    run = alfmu.simulate(m, 1.0, 0.05, parameters={"solver.relative_tolerance": 1e-12})
    k, position = kinematics(m), None
    for i, t in enumerate(run.time):
        position = k.forward({x: LAWS[x](t, math.sin) for x in "AB"}, position)
        rates, seconds = (
            (0.9 * math.cos(3 * t), 0.4 * math.cos(2 * t)),
            (-2.7 * math.sin(3 * t), -0.8 * math.sin(2 * t)),
        )
        tau = k.efforts(position, rates, seconds)
        for x in "AB":
            assert tau[x] == pytest.approx(run[f"{x}.torque"][i], abs=1e-10)
        np.testing.assert_allclose(position["tool"], [run[f"tool.{x}"][i] for x in "xy"], atol=1e-11)
    assert len([c for c in m.closures if type(c).__name__ == "Motion"]) == 2


def test_a_law_that_is_not_asked_for_stays():
    """One crank follows its law at the time given, the other one is actuated."""
    m = five_bar(motion="law")
    t = 0.35
    run = alfmu.simulate(m, 0.7, t, parameters={"solver.relative_tolerance": 1e-12})
    k = kinematics(m, ["B"], time=t)
    assert k.freedom == 1
    position = k.forward({"B": LAWS["B"](t, math.sin)})
    assert position["A.angle"] == pytest.approx(LAWS["A"](t, math.sin), abs=1e-12)
    tau = k.efforts(position, {"B": 0.4 * math.cos(2 * t)}, {"B": -0.8 * math.sin(2 * t)})
    assert tau["B"] == pytest.approx(run["B.torque"][1], abs=1e-10)


def test_redundant_actuators_share_by_least_norm():
    """Motors on both hinges of a parallelogram: equal shares, and the rates of one are enough."""
    m = Mechanism("pair")
    ends = []
    for k, x in (("A", 0.0), ("B", 1.0)):
        bar = m.bar(f"bar{k}", mass=1.0, length=0.5)
        joint = m.revolute(k, m.ground.at(x, 0), bar.start, coordinate=m.coordinate(f"angle{k}", "rad", start=1.0))
        m.drive(joint, m.input(f"{k}.torque", "N.m"))
        ends.append(bar.end)
    rod = m.bar("rod", mass=2.0, length=1.0)
    m.revolute("C", ends[0], rod.start, coordinate=m.coordinate("bend", "rad", start=-1.0))
    m.revolute("D", rod.end, ends[1])
    m.gravity(0, -9.81)
    k = kinematics(m)
    assert (k.freedom, k.redundant) == (1, 1)
    assert "least norm" in k.notes[0]
    position = k.forward({"A": 0.7})
    assert position["B"] == pytest.approx(0.7, abs=1e-11)
    inertia, weight = 2 * 1.0 * 0.25 / 3 + 2.0 * 0.25, (2 * 1.0 * 0.25 + 2.0 * 0.5) * 9.81 * math.cos(0.7)
    for rates, seconds in (((1.5, 1.5), (2.0, 2.0)), ({"A": 1.5}, {"B": 2.0})):
        tau = k.efforts(position, rates, seconds)
        assert [tau["A"], tau["B"]] == pytest.approx([(inertia * 2.0 + weight) / 2] * 2, rel=1e-11)
    with pytest.raises(InputError, match=r"pair: the rates of A, B contradict each other by .*give those of 1 joint"):
        k.efforts(position, (1.0, 2.0))
    with pytest.raises(InputError, match="out of reach"):
        k.forward((0.5, 0.9))
    cycle = k.cycle("A", span=(0.3, 1.2), rows=7)
    np.testing.assert_allclose(cycle["B.angle"], cycle["A"], atol=1e-11)


def test_outputs_of_the_mechanism_keep_their_names():
    """An output called as a measured angle would be."""
    m = five_bar()
    m.output("elbowA.angle", 2.0 * m.coordinates[1].q, "rad", "twice the angle")
    k = kinematics(m)
    assert k.start["elbowA.angle"] == pytest.approx(2.0 * k.start["bendA"])


def test_outputs_called_as_a_joint_do_not_stand_for_it():
    """An actuated joint is its own motion, whatever outputs have its name before a dot."""
    m = five_bar("absolute")
    for name in ("B.angle", "A.velocity", "A.x"):
        m.output(name, m.coordinates[2].q, "rad")
    found, plain = (kinematics(x).forward({"A": 1.9, "B": 1.2}) for x in (m, five_bar("absolute")))
    np.testing.assert_allclose(found["tool"], plain["tool"], atol=1e-12)


def test_the_place_of_a_slider_is_that_of_its_body():
    """A position gives the values that it is found by, whatever else is called after the body."""
    m = Mechanism("ways")
    table = m.spatial_body("table", mass=1.0, inertia=(0.1, 0.1, 0.1), relative=True)
    x = m.coordinate("x", "m", independent=True)
    m.spatial_prismatic("guide", m.spatial_ground.at(), table.at(), axis=(0.6, 0, 0.8), coordinate=x)
    m.gravity(0, 0, -9.81)
    k = kinematics(m, ["guide"], ["table"])
    there = k.forward({"guide": 0.5})
    assert there["table.position"] == 0.5
    np.testing.assert_allclose(there["table"], (0.3, 0, 0.4, 1, 0, 0, 0), atol=1e-15)
    assert k.inverse({"table": there["table"]})["guide"] == pytest.approx(0.5, abs=1e-12)


def test_a_place_has_no_rates():
    """The height of a table never changes, and its constant rate is no place."""
    m = Mechanism("table")
    top = m.spatial_body("top", mass=1.0, inertia=(0.1, 0.1, 0.1), relative=True)
    q = [m.coordinate(name, unit) for name, unit in (("x", "m"), ("y", "m"), ("a", "rad"))]
    m.planar("J", m.spatial_ground.at(0, 0, 0.4), top.at(), axis=(0, 0, 1), coordinates=q)
    m.watch("pen", top.at(0.3, 0.0, 0.0))
    m.gravity(0, 0, -9.81)
    k = kinematics(m, ["x", "y", "a"])
    np.testing.assert_allclose(k.start["pen"], (0.3, 0.0, 0.4), atol=1e-15)
    there = k.inverse({"pen": (0.0, 0.3, 0.4), "a": math.pi / 2})
    np.testing.assert_allclose([there[x] for x in "xya"], (0, 0, math.pi / 2), atol=1e-12)


@pytest.mark.slow
def test_a_cycle_of_few_rows_begins_in_the_middle():
    """No straight way leads from a dead position, beside which the start is."""
    k = kinematics(crank_rocker(), ["D"], ["A"])
    few, many = k.cycle(near=k.forward({"D": 2.4}), rows=3), k.cycle()
    assert few["A.angle"][1] == pytest.approx(many["A.angle"][90], abs=1e-9)


def test_along_a_sampled_motion():
    """A spline through samples has the efforts of the law they were taken from."""
    k = kinematics(five_bar())
    t = np.linspace(0.0, 1.0, 201)
    x = 2.0 + 0.3 * np.sin(3 * t)
    run = k.along({"A": (t, x)}, [0.3, 0.5])
    for i, at in enumerate((0.3, 0.5)):
        position = k.forward({"A": 2.0 + 0.3 * math.sin(3 * at)})
        tau = k.efforts(position, {"A": 0.9 * math.cos(3 * at)}, {"A": -2.7 * math.sin(3 * at)})
        assert [run["A.torque"][i], run["B.torque"][i]] == pytest.approx([tau["A"], tau["B"]], abs=1e-7)
        assert run["tool.x"][i] == pytest.approx(position["tool.x"], abs=1e-10)
    assert (run.units["der(A,2)"], run.units["A.torque"]) == ("rad/s2", "N.m")


@pytest.mark.slow
def test_fmu_with_motions_is_forward_kinematics_and_inverse_dynamics(tmp_path: Path):
    wanted = ["tool.*", "*.torque"]
    path = alfmu.export(five_bar(motion="input"), tmp_path / "robot.fmu", outputs=wanted, reference=False)
    laws = {"A": (2.0, 0.6, -1.5), "B": (1.1, 0.4, 0.8)}  # with constant accelerations, which an FMU continues exactly
    t = np.linspace(0.0, 0.5, 51)
    columns = {"time": t}
    for x, (q, v, a) in laws.items():
        columns |= {
            f"{x}.goal": q + v * t + a * t * t / 2,
            f"{x}.goal_rate": v + a * t,
            f"{x}.goal_acceleration": a + 0 * t,
        }
    table = np.zeros(len(t), dtype=[(name, float) for name in columns])
    for name, column in columns.items():
        table[name] = column
    wanted = ["tool.x", "tool.y", "A.torque", "B.torque"]
    run = fmpy.simulate_fmu(str(path), stop_time=0.5, output_interval=0.01, input=table, output=wanted)
    k = kinematics(five_bar())
    for row in run[[0, 20, 50]]:
        at = row["time"]
        position = k.forward([q + v * at + a * at * at / 2 for q, v, a in laws.values()])
        tau = k.efforts(position, [v + a * at for _, v, a in laws.values()], [a for *_, a in laws.values()])
        found = [row[name] for name in wanted]
        np.testing.assert_allclose(found, [*position["tool"], *tau.values()], atol=1e-9)


# Cycles -------------------------------------------------------------------------------------------------------------

SHORT, COUPLER, ROCKER, GROUND = 0.1, 0.3, 0.25, 0.3


def natural_crank_rocker() -> Mechanism:
    """The same, with the coordinates of two points, and turned so that angles of the rocker pass half a turn."""
    m, turn = Mechanism("crank_rocker"), cmath.exp(1.2j)
    places = {"P": SHORT * cmath.exp(1j) * turn, "Q": (GROUND + ROCKER * cmath.exp(1.55j)) * turn}
    P, Q = (
        m.point(*(m.coordinate(f"{k}{axis}", "m", start=x) for axis, x in (("x", z.real), ("y", z.imag))))
        for k, z in places.items()
    )
    ground, other = m.ground.at(0, 0), m.ground.at((GROUND * turn).real, (GROUND * turn).imag)
    a, b, c = (
        m.bar(name, mass=1.0, length=length, between=between)
        for name, length, between in (
            ("crank", SHORT, (ground, P)),
            ("coupler", COUPLER, (P, Q)),
            ("rocker", ROCKER, (other, Q)),
        )
    )
    m.revolute("A", ground, a.start)
    m.revolute("B", a.end, b.start)
    m.revolute("D", other, c.start)
    m.revolute("C", b.end, c.end)
    m.gravity(0, -9.81)
    return m


def crank_rocker() -> Mechanism:
    m = Mechanism("crank_rocker")
    a, b, c = (m.bar(n, mass=1.0, length=x) for n, x in (("crank", SHORT), ("coupler", COUPLER), ("rocker", ROCKER)))
    angle = m.coordinate("crank_angle", "rad", start=1.0, independent=True)
    A = m.revolute("A", m.ground.at(0, 0), a.start, coordinate=angle)
    m.revolute("B", a.end, b.start, coordinate=m.coordinate("bend", "rad", start=-0.5))
    m.revolute("D", m.ground.at(GROUND, 0), c.start, coordinate=m.coordinate("rocker_angle", "rad", start=1.8))
    m.revolute("C", b.end, c.end)
    m.watch("pen", b.at(0.15, 0.1))
    m.gravity(0, -9.81)
    m.drive(A, m.input("A.torque", "N.m"))
    return m


def triangle(a: float, b: float, c: float) -> float:
    """Angle opposite to c."""
    return math.acos((a * a + b * b - c * c) / (2 * a * b))


def test_cycle_of_a_crank_rocker(tmp_path: Path):
    k = kinematics(crank_rocker(), watch=["pen", "D"])
    cycle = k.cycle(rows=73)
    x = cycle["A"]
    assert x[-1] - x[0] == pytest.approx(2 * math.pi)
    diagonal = np.sqrt(SHORT**2 + GROUND**2 - 2 * SHORT * GROUND * np.cos(x))
    angle = np.arccos((COUPLER**2 + ROCKER**2 - diagonal**2) / (2 * COUPLER * ROCKER))
    np.testing.assert_allclose(cycle["transmission_angle"], np.minimum(angle, math.pi - angle), atol=1e-7)
    # The rocker turns back where crank and coupler are in line.
    wanted = [
        math.pi + triangle(GROUND, COUPLER - SHORT, ROCKER),
        2 * math.pi + triangle(GROUND, COUPLER + SHORT, ROCKER),
    ]
    np.testing.assert_allclose(cycle.facts["toggles"]["D"], wanted, atol=1e-9)
    assert "pen" not in cycle.facts["toggles"]
    assert cycle.facts["dead"] == []
    slope = np.gradient(cycle["D.angle"], x, edge_order=2)
    np.testing.assert_allclose(cycle["D.angle/A"], slope, atol=2e-2)
    np.testing.assert_allclose(cycle["D.advantage"] * np.abs(cycle["D.angle/A"]), 1.0)
    np.testing.assert_allclose(cycle["pen.advantage"], 1 / np.hypot(cycle["pen.x/A"], cycle["pen.y/A"]))
    cycle.to_csv(tmp_path / "cycle.csv")
    assert alfmu.Result.from_csv(tmp_path / "cycle.csv")["D.angle"] == pytest.approx(cycle["D.angle"])


def test_dead_positions_of_the_rocker():
    """Driven by the rocker it turns back where crank and coupler are in line; the verdict's number vanishes there."""
    cycle = kinematics(crank_rocker(), ["D"], ["A"]).cycle(rows=31)
    wanted = [math.pi - triangle(GROUND, ROCKER, COUPLER - SHORT), math.pi - triangle(GROUND, ROCKER, COUPLER + SHORT)]
    np.testing.assert_allclose(cycle.facts["dead"], sorted(wanted), atol=1e-12)
    assert max(cycle["parallel"][[0, -1]]) < 1e-6 < cycle["parallel"][1:-1].min()
    assert np.isnan(cycle["A.angle/D"][[0, -1]]).all()
    assert np.isfinite(cycle["A.angle/D"][1:-1]).all()
    turned = kinematics(natural_crank_rocker(), ["D"], ["A"]).cycle(rows=31)
    np.testing.assert_allclose(turned.facts["dead"], np.array(sorted(wanted)) + 1.2, atol=1e-11)
    np.testing.assert_allclose(turned["transmission_angle"], cycle["transmission_angle"], atol=1e-6)
    np.testing.assert_allclose(np.diff(turned["A.angle"]), np.diff(cycle["A.angle"]), atol=1e-6)


@pytest.mark.slow
def test_transmission_angle_of_a_slider_crank():
    m = Mechanism("slider")
    crank, rod = m.bar("crank", mass=1.0, length=0.1), m.bar("rod", mass=1.0, length=0.3)
    slide = m.body("slide", mass=1.0)
    A = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=m.coordinate("angle", "rad", start=0.7))
    m.revolute("B", crank.end, rod.start, coordinate=m.coordinate("bend", "rad", start=-0.9))
    m.prismatic("guide", m.ground.at(0, 0.02), slide.at(0, 0), coordinate=m.coordinate("stroke", "m", start=0.35))
    m.revolute("C", rod.end, slide.at(0, 0))
    m.gravity(0, -9.81)
    m.drive(A, m.input("torque", "N.m"))
    cycle = kinematics(m, watch=["guide"]).cycle(rows=41)
    height = (0.02 - 0.1 * np.sin(cycle["A"])) / 0.3
    np.testing.assert_allclose(cycle["transmission_angle"], np.arccos(np.abs(height)), atol=1e-9)
    assert len(cycle.facts["toggles"]["guide"]) == 2
    assert cycle.units["guide.advantage"] == "rad/m"
    push = sliding("slider", body="slide", place="stroke")[0]
    push.gravity(0, 0)
    with pytest.raises(InputError, match=r"slider: guide has no dead position up to .*give the range as span="):
        kinematics(push, ["guide"], ["slide"]).cycle()


@pytest.mark.slow
def test_a_pinion_turns_many_times_between_dead_positions():
    """A slider-crank whose slide is a rack: the crank and the rod in line hold it, far more than one turn apart."""
    m = Mechanism("rack")
    crank, rod, slide = (m.bar(name, mass=1.0, length=a) for name, a in (("crank", 0.1), ("rod", 0.3), ("slide", 0.1)))
    pinion = m.body("pinion", mass=1.0, inertia=1e-3)
    lean = math.asin(0.1 * math.sin(0.7) / 0.3)
    stroke = 0.1 * math.cos(0.7) + 0.3 * math.cos(lean)
    m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=m.coordinate("angle", "rad", start=0.7))
    m.revolute("B", crank.end, rod.start, coordinate=m.coordinate("bend", "rad", start=-0.7 - lean))
    P = m.revolute("P", m.ground.at(0, 0.005), pinion.at(0, 0), coordinate=m.coordinate("turn", "rad"))
    place = m.coordinate("stroke", "m", start=stroke)
    guide = m.prismatic("guide", m.ground.at(0, 0), slide.start, coordinate=place)
    m.rack("teeth", pinion.at(0, 0), guide, radius=0.005, side="left", phase=-stroke / 0.005)
    m.revolute("C", rod.end, slide.start)
    m.gravity(0, 0)
    m.drive(P, m.input("torque", "N.m"))
    cycle = kinematics(m, watch=["guide"]).cycle(rows=41)
    ends = (np.array([0.2, 0.4]) - stroke) / 0.005
    np.testing.assert_allclose(cycle.facts["dead"], ends, rtol=1e-10)
    np.testing.assert_allclose(cycle["P"], np.linspace(*ends, 41), rtol=1e-10)


# Limits, laws, names ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_inverse_keeps_within_the_limits_of_joints():
    m = five_bar()
    m.end_stop("limit", m.joints[0], upper=1.5, lower=-1.0, stiffness=1e4)
    k = kinematics(m)
    found = k.inverse({"tool": (0.2, 0.45)})
    assert found["A"] == pytest.approx(elbow_angle(0, 0.2 + 0.45j, -1.0), abs=1e-10)
    assert not found.beyond
    assert sum(bool(x.beyond) for x in k.solutions({"tool": (0.2, 0.45)})) == 2
    m = five_bar()
    m.end_stop("limit", m.joints[0], upper=2.05, lower=0.3, stiffness=1e4)
    with pytest.raises(InputError, match=r"robot: the position found is 0.0499 beyond the limit limit, and no other"):
        kinematics(m).inverse({"tool": (0.2, 0.45)})


def test_laws_of_time_carry_a_mechanism():
    """A carriage that a law moves: rates and efforts contain the law's."""
    m = Mechanism("carried")
    x = 0.5 * ca.sin(2 * m.time)
    carriage = m.body("carriage", mass=1.0, pose=(x, 0, 0))
    rod = m.bar("rod", mass=2.0, length=1.0)
    hinge = m.revolute("hinge", carriage.at(0, 0), rod.start, coordinate=m.coordinate("angle", "rad", start=0.4))
    m.drive(hinge, m.input("torque", "N.m"))
    m.gravity(0, -9.81)
    t = 0.3
    k = kinematics(m, time=t)
    tau = k.efforts(k.start, (1.0,), (2.0,))["hinge"]
    second = -2.0 * math.sin(2 * t)
    wanted = 2.0 / 3 * 2.0 + 2.0 * 0.5 * (9.81 * math.cos(0.4) - second * math.sin(0.4))
    assert tau == pytest.approx(wanted, abs=1e-10)


def test_joints_that_cannot_move_are_not_proposed_as_actuated():
    m = Mechanism("stand")
    base, arm = (m.spatial_body(name, mass=1.0, inertia=(1, 1, 1), relative=True) for name in ("base", "arm"))
    m.spatial_weld("foot", m.spatial_ground.at(0, 0, 0), base.at(0, 0, 0))
    angle = m.coordinate("angle", "rad")
    m.spatial_revolute("hinge", base.at(0, 0, 0), arm.at(0, 0, 0), axis=(0, 1, 0), coordinate=angle)
    m.distance("cylinder", m.spatial_ground.at(1, 0, 0), arm.at(0, 0, 1), length=1.4)
    with pytest.raises(alfmu.InputError, match=r"name those: actuated=hinge, angle$"):
        kinematics(m)
    with pytest.raises(alfmu.InputError, match=r"cylinder has no motion of its own .* prismatic"):
        kinematics(m, ["cylinder"])


TABLE = {"A": (np.linspace(0.0, 1.0, 11), np.linspace(2.0, 2.1, 11))}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: kinematics(five_bar(), ["A"]),
            "robot has 2 degrees of freedom, and A determines 1 of them; the undetermined motion is",
        ),
        (lambda: kinematics(five_bar(), ["A", "crank_angleA"]), "A, crank_angleA name one motion twice"),
        (lambda: kinematics(five_bar(), ["Z"]), "robot has no place 'Z'"),
        (lambda: kinematics(five_bar(), ["tool"]), "tool has 2 values and cannot be actuated as a whole"),
        (lambda: kinematics(five_bar(), "AB"), "robot: the actuated joints are 'AB'; give a list of names"),
        (lambda: kinematics(five_bar(), watch=["E.force"]), "has no place 'E.force'"),
        (lambda: kinematics(five_bar(), []), "robot: no joint is actuated by a drive or a motion; name those"),
        (lambda: kinematics(alfmu.derive(five_bar())), "robot: equations alone do not define a drawing"),
        (lambda: kinematics("robot.fmu"), "an FMU does not contain its equations"),
        (lambda: kinematics(five_bar()).forward({"tool.x": 1.0}), "robot: 'tool.x' is not actuated; it has A, B"),
        (lambda: kinematics(five_bar()).forward((1.0,)), "robot: 1 value for 2 joints; give one for each of A, B"),
        (lambda: kinematics(five_bar()).forward({"A": math.nan}), "robot: A is nan; give finite numbers"),
        (lambda: kinematics(five_bar()).forward({"A": "x"}), "robot: A is 'x'; give finite numbers"),
        (
            lambda: kinematics(five_bar()).forward({"A": 3.1, "B": 0.0}),
            "A = 3.1 .* is out of reach; .* stay closed up to A",
        ),
        (lambda: kinematics(five_bar()).inverse({"tool": (3.0, 0.0)}), "tool.x = 3, tool.y = 0 is out of reach"),
        (lambda: kinematics(five_bar()).inverse({"tool": 3.0}), "tool is given 1 value, and it has tool.x, tool.y"),
        (lambda: kinematics(five_bar()).inverse({}), "robot: no values are given"),
        (lambda: kinematics(five_bar()).solutions({"tool.x": 0.2}), "robot: these values leave 1 degree of freedom"),
        (lambda: kinematics(five_bar()).solutions({"tool": (0.2, 0.4)}, starts=-1), "robot: starts is -1"),
        (lambda: kinematics(five_bar()).forward(near=1.0), "robot: 1.0 is not a position of it"),
        (lambda: kinematics(five_bar()).cycle("E"), "robot: 'E' is not actuated"),
        (lambda: kinematics(five_bar()).cycle(rows=1), "robot: rows is 1"),
        (lambda: kinematics(five_bar()).cycle(span=3), "robot: span is given 1 value; give 2 numbers"),
        (lambda: kinematics(five_bar()).cycle(transmission="Q"), "robot has no joint 'Q'"),
        (lambda: kinematics(five_bar()).efforts(3), "robot: 3 is not a position of it"),
        (lambda: kinematics(alfmu.Instance("five_bar")), "it must be a name, a path or a Mechanism"),
        (lambda: kinematics(five_bar()).along({"A": ((0, 1), (0, 1))}), "the motion of A has 2 times and 2 values"),
        (lambda: kinematics(five_bar()).along({}), "robot: no joint moves"),
        (lambda: kinematics(five_bar()).along(TABLE, [0.0, 5.0]), "A is given from 0 to 1 s, and times go from 0 to 5"),
        (lambda: kinematics(five_bar()).along(TABLE, []), "times is given 0 values"),
        (lambda: kinematics(stewart()[0]).inverse({"platform": np.zeros(7)}), "Euler parameters of platform are zero"),
        (lambda: kinematics(five_bar()).forward({"A": (1.9, 1.8)}), "A is given 2 values; give 1 number"),
        (lambda: kinematics(five_bar()).start["nothing"], "robot has no place 'nothing'"),
    ],
)
def test_refusals(call, message: str):
    with pytest.raises(InputError, match=message):
        call()


def test_what_floats_is_refused_by_name():
    m = Mechanism("floating")
    base = m.spatial_body("base", mass=5.0, inertia=(0.1, 0.1, 0.1))
    arm = m.spatial_body("arm", mass=1.0, inertia=(0.01, 0.01, 0.01), center=(0.2, 0, 0), relative=True)
    joint = m.spatial_revolute(
        "J", base.at(0, 0, 0), arm.at(0, 0, 0), axis=(0, 0, 1), coordinate=m.coordinate("q", "rad")
    )
    m.drive(joint, m.input("torque", "N.m"))
    m.gravity(0, 0, 0)
    with pytest.raises(
        InputError, match=r"floating has 7 degrees of freedom, and J determines 1 of them; .*base_.*fix a floating base"
    ):
        kinematics(m)


def test_rolling_is_refused_by_name():
    m = Mechanism("sled")
    x, y, a = (m.coordinate(name, unit) for name, unit in (("x", "m"), ("y", "m"), ("a", "rad")))
    sled = m.body("sled", mass=1.0, inertia=1.0, pose=(x, y, a))
    m.blade("blade", sled.at(0, 0))
    m.gravity(0, 0)
    with pytest.raises(InputError, match="sled: blade constrains a velocity"):
        kinematics(m, ["x", "a"])


@pytest.mark.slow
def test_command(tmp_path: Path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    path = str(HERE / "five_bar.xml")
    assert main(["kinematics", path, "--watch", "tip_joint", "--json"]) in (0, 1)
    capsys.readouterr()
    assert main(["kinematics", path, "--at", "left=2.2,right=1.0", "--rates", "left=1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["positions"][0]["actuated"] == pytest.approx({"left": 2.2, "right": 1.0})
    assert set(found["positions"][0]["efforts"]) == {"left", "right"}
    assert main(["kinematics", path, "--at", "left=2.2,right=1.0", "--solutions"]) == 0
    assert "2 solutions found" in capsys.readouterr().out
    cycle = ["--cycle", "left", "--rows", "5", "--span", "2.0,2.2", "-o", "a.csv", "--plot", "a.png"]
    assert main(["kinematics", path, *cycle]) == 0
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    capsys.readouterr()
    assert main(["kinematics", path, "--watch", "left_elbow", "--cycle", "left", "--rows", "9", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["table"]["left"]) == 9
    (tmp_path / "m.csv").write_text("time,left\n" + "".join(f"{0.1 * i},{2.1 + 0.01 * i}\n" for i in range(8)))
    assert main(["kinematics", path, "--along", "m.csv", "-o", "b.csv"]) == 0
    assert "left.torque" in (tmp_path / "b.csv").read_text()
    for words, said in ((["--actuated", "left"], "2 degrees of freedom"), (["-o", "x.csv"], "--cycle or --along")):
        assert main(["kinematics", path, *words]) == 1
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_axis_of_a_body_in_space_is_given_by_euler_parameters():
    """Other signs and lengths of Euler parameters are the same attitude."""
    m, _, _ = stewart()
    k = kinematics(m)
    e = np.array([float(x) for x in ca.vertsplit(about((0.0, 0.0, 1.0), 0.1))])
    places = [k.inverse({"platform": (0, 0, 0.95, *factor * e)}) for factor in (1.0, -3.0)]
    np.testing.assert_allclose(places[0].q, places[1].q, atol=1e-11)


def test_efforts_hold_against_violated_stops():
    """A pendulum beyond its limits: gravity, and the stop's stiffness times the penetration less half its onset."""
    m, _, pin, *_ = hinged("stopped", mass=0.8, length=0.5, weight=0.0, start=0.1, independent=True)
    m.end_stop("stop", pin, upper=0.3, lower=-0.2, stiffness=50.0, onset=0.02, dissipation=0.0)
    m.gravity(0, -9.81)
    k = kinematics(m, actuated=["A"])
    for angle, pushed in ((0.5, 50.0 * (0.2 - 0.01)), (-0.6, -50.0 * (0.4 - 0.01)), (0.2, 0.0)):
        position = k.forward({"A": angle})
        assert k.efforts(position)["A"] == pytest.approx(0.8 * 9.81 * 0.25 * np.cos(angle) + pushed, abs=1e-12)
        assert bool(position.beyond) == bool(pushed)


def test_a_cycle_through_a_folded_position_names_a_span():
    """A scissor folds flat where its feet meet, and there turns as a whole: this side of it, it is a circle."""
    m = Mechanism("scissor")
    p, q = (m.bar(name, mass=1.0, length=0.6) for name in "pq")
    foot = m.body("foot", mass=0.5, inertia=1e-3)
    x = m.coordinate("x", "m", start=0.5, independent=True)
    slider = m.prismatic("S", m.ground.at(0, 0), foot.at(0, 0), coordinate=x)
    m.revolute("O", m.ground.at(0, 0), p.start, coordinate=m.coordinate("a", "rad", start=0.58))
    m.revolute("Q", foot.at(0, 0), q.start, coordinate=m.coordinate("b", "rad", start=math.pi - 0.58))
    m.revolute("C", p.at(0.3, 0), q.at(0.3, 0))
    m.drive(slider, m.input("u", "N"))
    m.watch("tip", q.end)
    k = kinematics(m)
    with pytest.raises(alfmu.InputError, match=r"meet between S = 0.5 and -0.0066+7 m; give a span on one side"):
        k.cycle()
    side = k.cycle(span=(0.1, 0.55), rows=10)
    np.testing.assert_allclose(side["tip.y"], np.sqrt(0.36 - np.linspace(0.1, 0.55, 10) ** 2), atol=1e-12)
