"""Gears, racks, belts and rolling wheels, against closed forms and the balance of forces of each body."""

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scenes import by_the_oracle, readings, started

import alfmu
from alfmu.view.drawing import as_data, from_data
from alfmu.view.shapes import geometry

G = 9.81
STEEP = math.tan(math.radians(20))


def at_start(m: alfmu.Mechanism) -> dict[str, float]:
    """All outputs of a mechanism at its start."""
    return readings(started(alfmu.derive(m)))


def net(m: alfmu.Mechanism, y: Mapping[str, float], body: alfmu.Body, pushes: list[tuple[tuple, tuple]]) -> np.ndarray:
    """Force and torque about the centre of mass that a body lacks by Newton and Euler: zero where all is told.

    `pushes` are forces and the places in ground axes where they act; hinges and guides count by their outputs.
    """
    place = np.array([y[f"{body.name}.x"], y[f"{body.name}.y"]])
    total = np.zeros(3)

    def add(force: np.ndarray, at: np.ndarray, moment: float = 0.0) -> None:
        arm = at - place
        total[:] += *force, arm[0] * force[1] - arm[1] * force[0] + moment

    def where(marker: alfmu.Marker) -> np.ndarray:
        if marker.body is m.ground:
            return np.array([marker.x, marker.y])
        b, angle = marker.body.name, y[f"{marker.body.name}.angle"]
        c, s = math.cos(angle), math.sin(angle)
        dx, dy = marker.x - marker.body.center[0], marker.y - marker.body.center[1]
        return np.array([y[f"{b}.x"] + c * dx - s * dy, y[f"{b}.y"] + s * dx + c * dy])

    for joint in m.joints:
        for sign, own in ((1, joint.second), (-1, joint.first)):
            if own.body is not body:
                continue
            if joint.kind == "revolute":
                force, moment = np.array([y[f"{joint.name}.force.x"], y[f"{joint.name}.force.y"]]), 0.0
            else:
                base = y[f"{joint.first.body.name}.angle"] if joint.first.body is not m.ground else 0.0
                axis = base + joint.axis
                force = y[f"{joint.name}.force"] * np.array([-math.sin(axis), math.cos(axis)])
                moment = y[f"{joint.name}.moment"]
            add(sign * force, where(joint.second), sign * moment)
    for force, at in pushes:
        add(np.array(force), np.array(at))
    total[:2] += body.mass * np.array([0.0, -G])
    inertia = body.inertia * y[f"{body.name}.angular_acceleration"]
    return total - np.array([body.mass * y[f"{body.name}.ax"], body.mass * y[f"{body.name}.ay"], inertia])


# Gears ----------------------------------------------------------------------------------------------------------------


def train(closed_by: str = "coordinates") -> alfmu.Mechanism:
    """Two gears on the ground, 0.2 m and 0.3 m, with a torque of 3 N.m on the first."""
    m = alfmu.Mechanism("train")
    absolute = closed_by == "constraints"
    wheels = []
    for name, mass, inertia, place in (("a", 1.0, 0.02, (0.0, 0.0)), ("b", 2.0, 0.1, (0.3, 0.4))):
        angle = m.coordinate(f"{name}_angle", independent=name == "a", rate=2.0 if name == "a" else 0.0)
        centre = (
            [m.coordinate(f"{name}_{k}", "m", start=x) for k, x in zip("xy", place, strict=True)] if absolute else []
        )
        wheel = m.body(name, mass=mass, inertia=inertia, pose=(*centre, angle) if absolute else None)
        m.revolute(name.upper(), m.ground.at(*place), wheel.at(0, 0), coordinate=None if absolute else angle)
        wheels.append(wheel)
    m.gear("mesh", wheels[0].at(0, 0), wheels[1].at(0, 0), teeth=(20, 30))
    m.torque(wheels[0], 3.0)
    m.gravity(0, -G)
    return m


@pytest.mark.parametrize("closed_by", ["coordinates", "constraints"])
def test_a_gear_pair_has_the_ratio_and_the_inertia_of_its_teeth(closed_by: str):
    m = train(closed_by)
    y = at_start(m)
    assert y["b.angular_velocity"] == pytest.approx(-2.0 * 20 / 30, abs=1e-14)
    assert y["a.angular_acceleration"] == pytest.approx(3.0 / (0.02 + 0.1 * (20 / 30) ** 2), rel=1e-13)
    torque = 0.1 * y["b.angular_acceleration"]  # all that turns the second gear is the tooth force
    assert y["mesh.force"] * 0.3 == pytest.approx(torque, rel=1e-13)
    assert y["mesh.separating_force"] == pytest.approx(abs(torque) / 0.3 * STEEP, rel=1e-13)
    # Force on the second gear at the pitch point, from its torque and from its teeth.
    e, t = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    push = -torque / 0.3 * t + y["mesh.separating_force"] * e
    pitch = 0.2 * e
    a, b = m.bodies
    lost = net(m, y, a, [(-push, pitch)])
    assert lost[:2] == pytest.approx([0, 0], abs=1e-12)
    assert lost[2] + 3.0 == pytest.approx(0, abs=1e-12)
    assert net(m, y, b, [(push, pitch)]) == pytest.approx(np.zeros(3), abs=1e-12)


def planetary(planets: int = 1, held: str = "ring", **flanks: float) -> alfmu.Mechanism:
    """Sun of 24 teeth, planets of 18, ring of 60, carrier; the ring is the ground, or turns with the sun held."""
    m = alfmu.Mechanism("planetary")
    arm_angle = m.coordinate("arm_angle", start=0.4, rate=1.0, independent=True)
    arm = m.body("arm", mass=2.0, inertia=0.05)
    turning = m.body("wheel", mass=1.0, inertia=0.01 if held == "ring" else 0.2)
    m.revolute("O", m.ground.at(0, 0), arm.at(0, 0), coordinate=arm_angle)
    m.revolute("W", m.ground.at(0, 0), turning.at(0, 0), coordinate=m.coordinate("wheel_angle"))
    sun, ring = (turning, m.ground) if held == "ring" else (m.ground, turning)
    for k in range(planets):
        towards = 2 * math.pi * k / planets
        planet = m.body(f"planet{k}", mass=0.5, inertia=0.002)
        pin = arm.at(0.105 * math.cos(towards), 0.105 * math.sin(towards))
        m.revolute(f"P{k}", pin, planet.at(0, 0), coordinate=m.coordinate(f"planet_angle{k}"))
        m.gear(f"inner{k}", sun.at(0, 0), planet.at(0, 0), teeth=(24, 18), **flanks)
        if held == "ring":
            m.gear(f"outer{k}", planet.at(0, 0), ring.at(0, 0), radii=(0.045, 0.15), internal=True, **flanks)
        else:
            m.gear(f"outer{k}", ring.at(0, 0), planet.at(0, 0), radii=(0.15, 0.045), internal=True, **flanks)
    m.torque(turning, 5.0)
    m.gravity(0, -G)
    return m


@pytest.mark.parametrize(("held", "planets"), [("ring", 1), ("sun", 1), ("ring", 3)])
def test_a_planetary_gear_turns_as_willis_says(held: str, planets: int):
    m = planetary(planets, held)
    y = at_start(m)
    arm = y["arm.angular_velocity"]
    sun, ring = (y["wheel.angular_velocity"], 0.0) if held == "ring" else (0.0, y["wheel.angular_velocity"])
    assert (sun - arm) / (ring - arm) == pytest.approx(-60 / 24, rel=1e-13)
    assert (y["planet0.angular_velocity"] - arm) / (sun - arm) == pytest.approx(-24 / 18, rel=1e-13)
    # By energies: what the torque turns is one inertia.
    wheel, planet = y["wheel.angular_velocity"], y["planet0.angular_velocity"]
    inertia = 0.01 if held == "ring" else 0.2
    of_wheel = inertia + ((0.05 + planets * 0.5 * 0.105**2) * arm**2 + planets * 0.002 * planet**2) / wheel**2
    weight = -planets * 0.5 * G * 0.105 * math.cos(0.4) * arm / wheel if planets == 1 else 0.0
    assert y["wheel.angular_acceleration"] == pytest.approx((5.0 + weight) / of_wheel, rel=1e-12)
    # Forces on the planet at both meshes, from tangents and normals at the pitch points.
    centre = np.array([y["planet0.x"], y["planet0.y"]])
    e = centre / 0.105
    t = np.array([-e[1], e[0]])
    inner = -y["inner0.force"] * t + y["inner0.separating_force"] * e, centre - 0.045 * e
    outer_torque = 0.002 * y["planet0.angular_acceleration"] - 0.045 * y["inner0.force"]
    assert y["outer0.force"] == pytest.approx((-1 if held == "ring" else 1) * outer_torque / 0.045, rel=1e-9)
    outer = outer_torque / 0.045 * t - abs(outer_torque) / 0.045 * STEEP * e, centre + 0.045 * e
    assert net(m, y, m.bodies[2], [inner, outer]) == pytest.approx(np.zeros(3), abs=1e-11)


def test_forces_that_part_teeth_do_not_decide_how_planets_share_a_load():
    """Three planets share as rolling discs do; the library as the oracle."""
    m = planetary(3)
    y, of_discs = at_start(m), at_start(planetary(3, pressure_angle=0.0))
    by_oracle = readings(by_the_oracle(alfmu.derive(m)))
    teeth = [f"{mesh}{k}.force" for mesh in ("inner", "outer") for k in range(3)]
    assert [y[x] for x in teeth] == pytest.approx([of_discs[x] for x in teeth], abs=1e-11)
    named = [x for x in y if x.startswith(("P", "O.", "W.", "inner", "outer"))]
    assert [y[x] for x in named] == pytest.approx([by_oracle[x] for x in named], abs=1e-11)


# Racks ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("side", "closed_by"), [("left", "coordinates"), ("right", "constraints")])
def test_a_rack_weighs_on_its_pinion_as_a_mass_at_the_radius(side: str, closed_by: str):
    m = alfmu.Mechanism("press")
    r, tilt, sign = 0.05, 0.7, 1 if side == "left" else -1
    along, left = np.array([math.cos(tilt), math.sin(tilt)]), np.array([-math.sin(tilt), math.cos(tilt)])
    centre = np.array([0.2, 0.1]) + sign * r * left
    angle = m.coordinate("angle", start=0.3, rate=1.5, independent=True)
    absolute = closed_by == "constraints"
    place = [m.coordinate(f"p{k}", "m", start=x) for k, x in zip("xy", centre, strict=True)] if absolute else []
    pinion = m.body("pinion", mass=0.4, inertia=0.003, pose=(*place, angle) if absolute else None)
    s = m.coordinate("s", "m", start=0.2) if not absolute else None
    starts = {"x": 0.3, "y": 0.3, "a": tilt} if absolute else {}
    pose = tuple(m.coordinate(f"r{k}", "rad" if k == "a" else "m", start=x) for k, x in starts.items())
    bar = m.body("bar", mass=1.5, inertia=0.01, center=(0.03, -0.01), pose=pose if absolute else None)
    m.revolute("axle", m.ground.at(*centre), pinion.at(0, 0), coordinate=None if absolute else angle)
    guide = m.prismatic("guide", m.ground.at(0.2, 0.1), bar.at(0.02, 0.015), axis=tilt, angle=tilt, coordinate=s)
    m.rack("mesh", pinion.at(0, 0), guide, radius=r)
    m.gravity(0, -G)
    y = at_start(m)
    speed = sign * r * 1.5
    assert [y["bar.vx"], y["bar.vy"]] == pytest.approx(list(speed * along), abs=1e-13)
    weight = 1.5 * G * math.sin(tilt)
    assert y["pinion.angular_acceleration"] == pytest.approx(-sign * r * weight / (0.003 + 1.5 * r**2), rel=1e-11)
    teeth = 1.5 * (y["bar.ax"] * along[0] + y["bar.ay"] * along[1]) + weight
    assert y["mesh.force"] == pytest.approx(teeth, rel=1e-10)
    push = teeth * along - sign * abs(teeth) * STEEP * left, centre - sign * r * left
    assert net(m, y, bar, [push]) == pytest.approx(np.zeros(3), abs=1e-10)
    assert net(m, y, pinion, [(-push[0], push[1])]) == pytest.approx(np.zeros(3), abs=1e-10)


# Belts ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("crossed", [False, True])
def test_a_belt_pulls_along_its_strands(crossed: bool):
    m = alfmu.Mechanism("drive")
    small, large, apart, slope = 0.05, 0.12, 0.3, 0.4
    e = np.array([math.cos(slope), math.sin(slope)])
    wheels = []
    for name, inertia, place in (("motor", 0.002, (0.0, 0.0)), ("fan", 0.05, tuple(apart * e))):
        angle = m.coordinate(f"{name}_angle", independent=name == "motor", rate=3.0 if name == "motor" else 0.0)
        wheels.append(m.body(name, mass=1.0, inertia=inertia))
        m.revolute(f"{name}_axle", m.ground.at(*place), wheels[-1].at(0, 0), coordinate=angle)
    m.belt("belt", wheels[0].at(0, 0), wheels[1].at(0, 0), radii=(small, large), crossed=crossed, pretension=40.0)
    m.torque(wheels[0], 2.0)
    m.gravity(0, -G)
    y = at_start(m)
    ratio = (-1 if crossed else 1) * small / large
    assert y["fan.angular_velocity"] == pytest.approx(3.0 * ratio, rel=1e-14)
    assert y["motor.angular_acceleration"] == pytest.approx(2.0 / (0.002 + 0.05 * ratio**2), rel=1e-13)
    assert y["belt.force"] * large == pytest.approx(0.05 * y["fan.angular_acceleration"], rel=1e-13)
    assert y["belt.tension.left"] + y["belt.tension.right"] == pytest.approx(80.0, rel=1e-14)
    # Each strand touches both rims where its normal says so.
    pulls: list[list[tuple]] = [[], []]
    for tension, hand in ((y["belt.tension.left"], 1), (y["belt.tension.right"], -1)):
        lean = math.asin((small + (large if crossed else -large)) / apart)
        normal = math.sin(lean) * e + hand * math.cos(lean) * np.array([-e[1], e[0]])
        starts, ends = small * normal, apart * e + (-large if crossed else large) * normal
        strand = (ends - starts) / np.linalg.norm(ends - starts)
        pulls[0].append((tension * strand, starts))
        pulls[1].append((-tension * strand, ends))
    assert net(m, y, wheels[0], pulls[0]) == pytest.approx([0, 0, -2.0], abs=1e-11)
    assert net(m, y, wheels[1], pulls[1]) == pytest.approx(np.zeros(3), abs=1e-11)


# Wheels ---------------------------------------------------------------------------------------------------------------


def test_a_wheel_rolls_down_a_moving_slope_without_slip():
    """A disc on a wedge that slides on the ground: closed form of both accelerations."""
    m = alfmu.Mechanism("wedge")
    steep, r = 0.5, 0.1
    along, left = np.array([math.cos(steep), math.sin(steep)]), np.array([-math.sin(steep), math.cos(steep)])
    s = m.coordinate("s", "m", start=0.2, independent=True)
    wedge = m.body("wedge", mass=3.0, inertia=0.1)
    m.prismatic("floor", m.ground.at(0, 0), wedge.at(0, 0), coordinate=s)
    run = m.coordinate("run", "m", start=0.4, independent=True)
    x, h = 0.4 * along + r * left
    pose = (m.coordinate("x", "m", start=0.2 + x), m.coordinate("y", "m", start=h), m.coordinate("angle", start=-4.0))
    disc = m.body("disc", mass=2.0, inertia=0.5 * 2.0 * r**2, pose=pose)
    m.rolling("contact", wedge.at(0, 0), disc.at(0, 0), radius=r, axis=steep)
    m.constraint("run_of_disc", pose[0] - s - (run * along[0] + r * left[0]))
    m.gravity(0, -G)
    y = at_start(m)
    assert y["disc.angle"] == pytest.approx(-0.4 / r, rel=1e-13)
    # d/dt of Lagrange's two equations, with the disc's run relative to the wedge.
    matrix = [[5.0, 2.0 * along[0]], [2.0 * along[0], 3.0]]
    floor, rel = np.linalg.solve(matrix, [0.0, -2.0 * G * along[1]])
    assert y["wedge.ax"] == pytest.approx(floor, rel=1e-11)
    assert y["disc.angular_acceleration"] == pytest.approx(-rel / r, rel=1e-11)
    assert y["disc.ay"] == pytest.approx(rel * along[1], rel=1e-11)
    push = y["contact.normal_force"] * left + y["contact.friction_force"] * along
    at = np.array([y["disc.x"], y["disc.y"]]) - r * left
    assert net(m, y, disc, [(push, at)]) == pytest.approx(np.zeros(3), abs=1e-10)
    assert net(m, y, wedge, [(-push, at)]) == pytest.approx(np.zeros(3), abs=1e-10)


# Pictures -------------------------------------------------------------------------------------------------------------


def test_pictures_show_pitch_circles_and_strands():
    """Circles of the right radius about the centres, the strands of a belt as its tangents; as data and back."""
    shapes = geometry(train())
    assert [rim.body for rim in shapes.rims] == ["a", "b"]
    for rim, radius in zip(shapes.rims, (0.2, 0.3), strict=True):
        assert np.hypot(*np.array(rim.points[1:]).T) == pytest.approx(radius)
    data = as_data(shapes)
    assert from_data(data) == shapes
    assert "rims" not in as_data(geometry(alfmu.load("four_bar")))
    data["rims"][0]["body"] = "nobody"
    with pytest.raises(ValueError, match="no body 'nobody'"):
        from_data(data)
    m = alfmu.Mechanism("drive")
    wheels = [m.body(name, mass=1.0, inertia=0.1) for name in "ab"]
    for x, wheel in zip((0.0, 0.3), wheels, strict=True):
        m.revolute(
            wheel.name.upper(), m.ground.at(x, 0.1), wheel.at(0, 0), coordinate=m.coordinate(f"{wheel.name}_angle")
        )
    m.belt("belt", wheels[0].at(0, 0), wheels[1].at(0, 0), radii=(0.05, 0.1), crossed=True)
    for rim in geometry(m).rims[2:]:
        (x1, y1), (x2, y2) = rim.points
        way = np.array([x2 - x1, y2 - y1])
        for centre, x, y, radius in ((0.0, x1, y1, 0.05), (0.3, x2, y2, 0.1)):
            arm = np.array([x - centre, y - 0.1])
            assert np.linalg.norm(arm) == pytest.approx(radius)
            assert way @ arm == pytest.approx(0.0, abs=1e-12)


# Errors ---------------------------------------------------------------------------------------------------------------


def wrong(line: str) -> None:
    m = alfmu.Mechanism("wrong")
    wheels = []
    for i, (x, y) in enumerate(((0.0, 0.0), (0.3, 0.0), (0.0, 0.0))):
        wheels.append(m.body(f"w{i}", mass=1.0, inertia=1.0))
        m.revolute(f"J{i}", m.ground.at(x, y), wheels[i].at(0, 0), coordinate=m.coordinate(f"a{i}"))
    loose = m.body("loose", mass=1.0, inertia=1.0, pose=(0.1, 0.1, m.coordinate("turn")))
    slider = m.body("slider", mass=1.0)
    guide = m.prismatic("guide", m.ground.at(0, 0.2), slider.at(0, 0), coordinate=m.coordinate("s", "m"))
    a, b, c = (wheel.at(0, 0) for wheel in wheels)
    wide = m.parameter("wide", 0.2, "m")
    eval(line, {"m": m, "a": a, "b": b, "c": c, "w0": wheels[0], "loose": loose, "guide": guide, "wide": wide})


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (
            "m.gear('g', a, b, radii=(0.1, wide + 0.05))",
            "radii 0.1 m and 0.25 m of gear g sum up to 0.35 m, and its centres are 0.3 m apart on ground",
        ),
        ("m.gear('g', a, b, radii=(0.1, 0.2), teeth=(1, 2))", "gear g has both radii and teeth"),
        ("m.gear('g', a, b)", "gear g has neither radii nor teeth"),
        ("m.gear('g', a, b, teeth=(10, 20.5))", "give two whole numbers"),
        ("m.gear('g', a, b, teeth=(20, 20), internal=True)", "20 teeth inside and outside"),
        ("m.gear('g', a, c, teeth=(10, 20))", "at one place of ground"),
        ("m.gear('g', a, w0.at(0.1, 0), teeth=(10, 20))", "gear g joins w0 to itself"),
        (
            "m.gear('g', a, loose.at(0, 0), teeth=(10, 20))",
            "hinges hold the centre of w0 on ground or w2 and that of loose on nothing",
        ),
        (
            "m.gear('g', a, b, teeth=(10, 20), carrier=loose)",
            "no hinge holds the centre of w0 that gear g uses on loose",
        ),
        (
            "m.gear('g', a, b, teeth=(10, 20), pressure_angle=20)",
            r"is 20 rad \(1146 deg\); give one from 0 to below pi/2",
        ),
        ("m.gear('J0', a, b, teeth=(10, 20))", "'J0' is a joint already"),
        ("m.belt('g', a, b, radii=(0.05, 0.4))", "take 0.35 m, and their centres are 0.3 m apart"),
        ("m.belt('g', a, b, radii=(0.2, 0.2), crossed=True)", "no crossed belt fits"),
        ("m.belt('g', a, b, radii=(0.1, 0.1), pretension=-1)", "pretension of belt g is -1 N"),
        (
            "m.rack('g', b, guide, radius=0.1)",
            "guide passes the centre of w1 at 0.2 m, and the radius of rack g is 0.1 m",
        ),
        ("m.rack('g', b, guide, radius=0.1, side='above')", "give 'left' or 'right'"),
        ("m.rack('g', b, m.joints[0], radius=0.1)", "needs the guide of the rack"),
        ("m.rolling('g', a, w0.at(0.1, 0), radius=0.1)", "rolls w0 on itself"),
        ("m.rolling('g', m.ground.at(0, 0), b, radius=0.0)", "above zero"),
    ],
)
def test_a_relation_that_cannot_be_is_refused_where_it_is_declared(line: str, said: str):
    with pytest.raises(alfmu.DeclarationError, match=said):
        wrong(line)


def test_a_wheel_whose_turns_nobody_counts_is_refused():
    m = alfmu.Mechanism("natural")
    x, y = m.coordinate("x", "m", start=1.0), m.coordinate("y", "m")
    bar = m.bar("bar", mass=1.0, length=1.0, between=(m.point(0, 0), m.point(x, y)))
    disc = m.body("disc", mass=1.0, inertia=1.0)
    m.revolute("A", m.ground.at(0, 0), bar.start)
    m.revolute("B", m.ground.at(0.3, 0), disc.at(0, 0), coordinate=m.coordinate("turn"))
    m.gear("mesh", bar.start, disc.at(0, 0), teeth=(1, 2))
    with pytest.raises(alfmu.DeclarationError, match="gear mesh needs the turns of bar"):
        alfmu.derive(m)


def test_a_relation_that_no_coordinate_moves_is_refused():
    m = alfmu.Mechanism("still")
    m.coordinate("idle")
    discs = [m.body(name, mass=1.0, inertia=1.0) for name in "ab"]
    for x, disc in enumerate(discs):
        m.revolute(f"J{x}", m.ground.at(x, 0), disc.at(0, 0), coordinate=0.0)
    m.gear("mesh", discs[0].at(0, 0), discs[1].at(0, 0), teeth=(1, 1))
    with pytest.raises(alfmu.DeclarationError, match="no coordinate moves the bodies of gear mesh"):
        alfmu.derive(m)
