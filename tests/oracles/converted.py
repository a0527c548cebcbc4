"""Mechanisms that are written in the formats of other programs: loops, joints, forces and starts of all kinds."""

import math
from collections.abc import Callable

import casadi as ca
import numpy as np

from alfmu import Mechanism

SOLID = (0.002, 0.003, 0.0025)


def robot() -> Mechanism:
    """Five hinges in a plane, two of them driven."""
    m = Mechanism("robot")
    guesses = {"left": 2.0, "left_elbow": -1.1, "right": 1.0, "right_elbow": 1.1}
    q = {k: m.coordinate(k, "rad", start=x, independent=k in ("left", "right")) for k, x in guesses.items()}
    bars = {name: m.bar(name, mass=0.5, length=x) for name, x in (("a", 0.2), ("b", 0.3), ("c", 0.2), ("d", 0.3))}
    left = m.revolute("A", m.ground.at(-0.1, 0), bars["a"].start, coordinate=q["left"])
    m.revolute("B", bars["a"].end, bars["b"].start, coordinate=q["left_elbow"])
    right = m.revolute("C", m.ground.at(0.1, 0), bars["c"].start, coordinate=q["right"])
    m.revolute("D", bars["c"].end, bars["d"].start, coordinate=q["right_elbow"])
    m.revolute("E", bars["b"].end, bars["d"].end)
    m.drive(left, m.input("left_motor", "N.m"))
    m.drive(right, ca.fmin(ca.fmax(m.input("right_motor", "N.m"), -0.4), 0.4))
    m.spring_damper(left, damping=0.02)
    m.gravity(0, -9.81)
    return m


def press() -> Mechanism:
    """A slider-crank whose closing hinge is driven and whose slider has friction and a stop; no springs."""
    m = Mechanism("press")
    turn = m.coordinate("turn", "rad", start=0.7, rate=-1.0, independent=True)
    swing, way = m.coordinate("swing", "rad", start=-1.2), m.coordinate("way", "m", start=0.45)
    crank = m.body("crank", mass=0.4, inertia=2e-3, center=(0.05, 0.01))
    rod = m.bar("rod", mass=0.3, length=0.4)
    slider = m.body("slider", mass=0.8)
    m.revolute("A", m.ground.at(0, 0.02), crank.at(), coordinate=turn)
    m.revolute("B", crank.at(0.1, 0), rod.start, coordinate=swing)
    guide = m.prismatic("guide", m.ground.at(), slider.at(), axis=0.1, coordinate=way)
    pin = m.revolute("C", rod.end, slider.at())
    m.drive(pin, m.input("pin_motor", "N.m"))
    m.friction(guide, 0.5, coulomb=1.0, load=0.3)
    m.end_stop("stop", guide, upper=2.0, stiffness=1e4)
    m.gravity(0, -9.81)
    return m


def shaper() -> Mechanism:
    """A pin in a slot that closes a loop, springs with places of rest, a constant effort and gears."""
    m = Mechanism("shaper")
    turn = m.coordinate("turn", "rad", start=0.4, rate=2.0, independent=True)
    swing, wheel = m.coordinate("swing", "rad", start=1.2), m.coordinate("wheel", "rad", start=-0.8)
    crank = m.body("crank", mass=1.0, inertia=4e-3)
    arm = m.bar("arm", mass=0.7, length=0.9)
    disc = m.body("disc", mass=0.5, inertia=1e-3, center=(0.01, 0.02))
    motor = m.revolute("motor", m.ground.at(0, 0.3), crank.at(), coordinate=turn)
    pivot = m.revolute("pivot", m.ground.at(), arm.start, coordinate=swing)
    m.point_on_line("slot", arm.start, crank.at(0.12, 0.0))
    m.revolute("axle", m.ground.at(0.3, 0.3), disc.at(), coordinate=wheel)
    m.gear("mesh", crank.at(), disc.at(), radii=(0.1, 0.2), phase=-0.6)
    m.drive(motor, 0.3 - 0.1 * m.rate(turn) - 2.0 * m.input("torque", "N.m"))
    m.spring_damper(pivot, stiffness=3.0, damping=0.05, rest=1.0)
    m.spring_damper(pivot, stiffness=1.0, rest=-0.5)
    m.gravity(0, -9.81)
    return m


def raft() -> Mechanism:
    """A plate that slides and turns in a plane, with a four-bar on it."""
    m = Mechanism("raft")
    x, y, turn = (m.coordinate(k, u, start=s, rate=0.3, independent=True) for k, u, s in
                  (("x", "m", 0.1), ("y", "m", 0.2), ("turn", "rad", 0.3)))  # fmt: skip
    plate = m.body("plate", mass=2.0, inertia=0.05, center=(0.02, 0.01), pose=(x, y, turn))
    angles = [m.coordinate(f"angle{i}", "rad", start=s, independent=i == 1, rate=3.0 * (i == 1)) for i, s in
              ((1, 1.2), (2, -0.9), (3, 1.4))]  # fmt: skip
    crank, coupler, rocker = (m.bar(n, mass=0.3, length=x) for n, x in (("r1", 0.1), ("r2", 0.3), ("r3", 0.2)))
    m.revolute("A", plate.at(), crank.start, coordinate=angles[0])
    m.revolute("B", crank.end, coupler.start, coordinate=angles[1])
    m.revolute("C", plate.at(0.3, 0), rocker.start, coordinate=angles[2])
    m.revolute("D", coupler.end, rocker.end)
    m.gravity(0, 0)
    return m


def delta() -> Mechanism:
    """Three driven arms, six rods by universal joints, and a platform that hangs on balls."""
    m = Mechanism("delta")
    ground = m.spatial_ground
    plate = m.spatial_body("plate", mass=0.4, inertia=(3e-4, 3e-4, 5e-4), position=(0.0, 0.0, -0.42))
    for i in range(3):
        c, s = math.cos(2 * math.pi * i / 3), math.sin(2 * math.pi * i / 3)
        turn = m.coordinate(f"turn{i}", "rad", start=0.3 + 0.05 * i, rate=0.5 * i, independent=True)
        arm = m.spatial_body(f"arm{i}", mass=0.3, inertia=SOLID, center=(0.1 * c, 0.1 * s, 0.0), relative=True)
        hinge = m.spatial_revolute(
            f"hinge{i}", ground.at(0.1 * c, 0.1 * s, 0), arm.at(), axis=(-s, c, 0.0), coordinate=turn
        )
        m.drive(hinge, m.input(f"motor{i}", "N.m"))
        m.friction(hinge, 0.01)
        for side in (-1, 1):
            name = f"rod{i}{'ab'[side > 0]}"
            swings = [m.coordinate(f"{name}_{k}", "rad", start=x) for k, x in ((1, 0.2), (2, 0.0))]
            rod = m.spatial_body(name, mass=0.1, inertia=(4e-4, 4e-4, 1e-5), center=(0, 0, -0.2), relative=True)
            x, y = -0.05 * side * s, 0.05 * side * c
            at = arm.at(0.2 * c + x, 0.2 * s + y, 0)
            m.universal(f"{name}_top", at, rod.at(), axis=(-s, c, 0), second_axis=(c, s, 0), coordinates=swings)
            m.spherical(f"{name}_end", rod.at(0, 0, -0.4), plate.at(0.05 * c + x, 0.05 * s + y, 0))
    m.gravity(0, 0, -9.81)
    return m


def stewart() -> Mechanism:
    """A platform on six legs with springs, dampers, stops and forces."""
    m = Mechanism("stewart")
    plate = m.spatial_body("plate", mass=3.0, inertia=(0.02, 0.03, 0.04), position=(0.02, 0.01, 0.5))
    for i in range(6):
        low, high = (2 * math.pi * (i // 2) / 3 + (0.35 if i % 2 else -0.35) * k for k in (1.0, 2.0))
        foot, end = (0.4 * math.cos(low), 0.4 * math.sin(low), 0.0), (0.25 * math.cos(high), 0.25 * math.sin(high), 0.0)
        way = np.array((0.02, 0.01, 0.5)) + end - np.array(foot)
        lean, tilt = math.atan2(-way[1], way[2]), math.asin(way[0] / np.linalg.norm(way))
        q = [m.coordinate(f"{k}{i}", u, start=float(x), independent=k == "length") for k, u, x in
             (("lean", "rad", lean), ("tilt", "rad", tilt), ("length", "m", np.linalg.norm(way)))]  # fmt: skip
        tube = m.spatial_body(f"tube{i}", mass=0.5, inertia=SOLID, center=(0, 0, 0.1), relative=True)
        piston = m.spatial_body(f"piston{i}", mass=0.2, inertia=SOLID, center=(0, 0, -0.1), relative=True)
        m.universal(f"base{i}", m.spatial_ground.at(*foot), tube.at(), axis=(1, 0, 0), second_axis=(0, 1, 0),
                    coordinates=q[:2])  # fmt: skip
        leg = m.spatial_prismatic(f"leg{i}", tube.at(), piston.at(), axis=(0, 0, 1), coordinate=q[2])
        m.spherical(f"top{i}", piston.at(), plate.at(*end))
        m.spring_damper(leg, stiffness=300.0, damping=5.0, rest=0.5)
        m.end_stop(f"stop{i}", leg, lower=0.2, upper=0.9, stiffness=1e5)
        m.drive(leg, m.input(f"force{i}", "N"))
    m.gravity(0, 0, -9.81)
    return m


def floating(springs: bool = True) -> Mechanism:
    """A flying base with a loop of hinges in space, with friction, a spring and a stop."""
    m = Mechanism("floating")
    values = ((1.0, "m"), (0.2, "m"), (0.5, "m"), (0.9, "1"), (0.1, "1"), (-0.2, "1"), (math.sqrt(0.14), "1"))
    names = [f"base_{k}" for k in ("x", "y", "z", "e0", "e1", "e2", "e3")]
    given = [
        m.start(n, x, u, rate=0.1 if u == "m" else 0.0)
        for n, (x, u) in zip(names, values, strict=True)
        if n != "base_e0"
    ]
    base = m.spatial_body("base", mass=2.0, inertia=((0.03, 0.002, 0.001), (0.002, 0.04, 0.003), (0.001, 0.003, 0.05)),
                          center=(0.01, 0.02, 0.03), position=given[:3], attitude=(0.9, *given[3:]))  # fmt: skip
    axis = (0.36, 0.48, 0.8)
    along, across = np.array((0.8, -0.6, 0.0)), np.cross(axis, (0.8, -0.6, 0.0))
    angles = [m.coordinate(f"angle{i}", "rad", start=s, independent=i == 1, rate=2.0 * (i == 1)) for i, s in
              ((1, 1.2), (2, -0.9), (3, 1.4))]  # fmt: skip
    bodies = []
    for i, length in enumerate((0.1, 0.3, 0.2), 1):
        center = tuple((along * length / 2 + 0.01 * across).tolist())
        bodies.append(m.spatial_body(f"link{i}", mass=0.3 * i, inertia=SOLID, center=center, relative=True))
    ends = [tuple((along * x).tolist()) for x in (0.1, 0.3, 0.2)]
    crank = m.spatial_revolute("A", base.at(), bodies[0].at(), axis=axis, coordinate=angles[0])
    m.spatial_revolute("B", bodies[0].at(*ends[0]), bodies[1].at(), axis=axis, coordinate=angles[1])
    rocker = m.spatial_revolute("C", base.at(*(along * 0.3).tolist()), bodies[2].at(), axis=axis, coordinate=angles[2])
    m.spatial_revolute("D", bodies[1].at(*ends[1]), bodies[2].at(*ends[2]), axis=axis)
    m.drive(crank, m.input("torque", "N.m"))
    m.friction(crank, 0.01, coulomb=1.0, load=0.02)
    m.end_stop("stop", rocker, lower=-6.0, upper=6.0, stiffness=100.0)
    if springs:
        m.spring_damper(rocker, stiffness=2.0, damping=0.03, rest=1.0)
    m.gravity(0, 0, -9.81)
    return m


def joints() -> Mechanism:
    """A chain with joints of all kinds in space, whose end a universal joint closes to the ground."""
    m = Mechanism("chain")
    axes = ((0.36, 0.48, 0.8), (0.0, 0.6, -0.8), (0.8, 0.0, 0.6), (0.0, 0.0, 1.0))
    before = m.spatial_ground
    for i, kind in enumerate(("screw", "cylindrical", "planar", "universal", "spherical")):
        body = m.spatial_body(f"body{i}", mass=0.5 + 0.1 * i, inertia=SOLID, center=(0.1, 0.02, 0.03), relative=True)
        at = before.at(0.2, 0.05 * i, 0.1), body.at(0.01, 0.02, -0.03)
        units = {
            "screw": ("rad",),
            "cylindrical": ("rad", "m"),
            "planar": ("m", "m", "rad"),
            "universal": ("rad", "rad"),
        }
        q = [m.coordinate(f"q{i}{k}", u, start=0.2 + 0.1 * k, independent=i < 3 and k < 2, rate=0.3 * (i < 3 and k < 2))
             for k, u in enumerate(units.get(kind, ()))]  # fmt: skip
        if kind == "screw":
            m.spatial_screw("screw", *at, axis=axes[0], lead=0.2, coordinate=q[0])
        elif kind == "universal":
            m.universal("universal", *at, axis=(1, 0, 0), second_axis=(0, 0.6, 0.8), coordinates=q)
        elif kind == "spherical":
            e = [m.coordinate(f"e{k}", "1", start=x) for k, x in enumerate((0.9, 0.3, -0.2, math.sqrt(0.06)))]
            m.spherical("ball", *at, coordinates=e)
        else:
            getattr(m, kind)(kind, *at, axis=axes[i], coordinates=q)
        before = body
    m.universal("end", m.spatial_ground.at(0.9, 0.5, 0.5), before.at(0.1, 0, 0), axis=(0, 1, 0), second_axis=(1, 0, 0))
    m.gravity(3.5316, 4.7088, -7.848)
    return m


def gears() -> Mechanism:
    """Two gears and a follower, and a torque from the ground on a hinged body."""
    m = Mechanism("gears")
    a, b = (m.coordinate(k, "rad", start=x, rate=r, independent=k == "a") for k, x, r in (("a", 0.4, 1.0), ("b", 0, 0)))
    wheel = m.body("wheel", mass=1.0, inertia=4e-3, center=(0.05, 0.0))
    other = m.body("other", mass=0.5, inertia=1e-3, center=(0.01, 0.02))
    lever = m.body("lever", mass=0.3, inertia=1e-3, center=(0.1, 0.0))
    m.revolute("A", m.ground.at(), wheel.at(), coordinate=a)
    m.revolute("B", m.ground.at(0.3, 0), other.at(), coordinate=b)
    m.revolute("C", m.ground.at(1, 1), lever.at(), coordinate=2 * a + 0.1)
    m.gear("mesh", wheel.at(), other.at(), radii=(0.1, 0.2))
    m.torque(wheel, m.input("torque", "N.m"))
    m.gravity(0, -9.81)
    return m


def vice() -> Mechanism:
    """A spindle whose thread moves a jaw in its guide, so that a screw closes the loop; a disc is welded on."""
    m = Mechanism("vice")
    axis = (0.6, 0.0, 0.8)
    turn = m.coordinate("turn", "rad", start=0.4, rate=3.0, independent=True)
    way = m.coordinate("way", "m", start=0.4 * 0.05 / (2 * math.pi))
    spindle = m.spatial_body("spindle", mass=0.5, inertia=SOLID, center=(0.02, 0.0, 0.01), relative=True)
    jaw = m.spatial_body("jaw", mass=2.0, inertia=SOLID, relative=True)
    disc = m.spatial_body("disc", mass=1.0, inertia=SOLID, center=(0.05, 0.0, 0.0), relative=True)
    hinge = m.spatial_revolute("hinge", m.spatial_ground.at(), spindle.at(), axis=axis, coordinate=turn)
    m.spatial_prismatic("guide", m.spatial_ground.at(), jaw.at(), axis=axis, coordinate=way)
    m.spatial_screw("thread", jaw.at(), spindle.at(), axis=axis, lead=-0.05)
    m.spatial_weld("fixed", spindle.at(0, 0.1, 0), disc.at())
    m.drive(hinge, m.input("motor", "N.m"))
    m.gravity(0, 0, -9.81)
    return m


def servos() -> Mechanism:
    """One input on two hinges, a servo of limited effort, rotors of motors, a damped ball, a polynomial follower."""
    m = Mechanism("servos")
    q = {k: m.coordinate(k, "rad", start=x, **({"rate": 1.0, "independent": True} if k != "c" else {})) for k, x in
         (("a", 0.4), ("b", -0.3), ("c", 0.2 * -0.3 + 0.1 * 0.09))}  # fmt: skip
    bodies = [m.spatial_body(f"body{i}", mass=0.5 + i, inertia=SOLID, center=(0.1, 0.02, 0.0), relative=True)
              for i in range(4)]  # fmt: skip
    hinges = []
    for k, (name, axis) in enumerate(zip("abc", ((0, 1, 0), (0, 0.6, 0.8), (0, 1, 0)), strict=True)):
        before = bodies[k - 1].at(0.2, 0, 0) if k else m.spatial_ground.at()
        hinges.append(m.spatial_revolute(name.upper(), before, bodies[k].at(), axis=axis, coordinate=q[name]))
    e = [m.coordinate(f"e{k}", "1", start=float(k == 0)) for k in range(4)]
    m.spherical("ball", bodies[0].at(0, 0.1, 0), bodies[3].at(), coordinates=e)
    for each in e:
        m.generalized_force(each, -4 * 0.03 * m.rate(each))
        m.kinetic_energy(2 * 0.002 * m.rate(each) ** 2)
    u, goal = m.input("torque", "N.m"), m.input("goal", "N.m", start=0.2)
    goal = ca.fmin(ca.fmax(goal, -0.15), 0.15)
    servo = ca.fmin(ca.fmax(3 * goal - 2 * q["a"] - 0.1 * m.rate(q["a"]), -0.5), 0.3)
    m.drive(hinges[0], u + servo)
    m.drive(hinges[1], 0.1 - 2 * u)
    m.kinetic_energy(0.5 * 0.01 * m.rate(q["a"]) ** 2)
    m.constraint("follows", q["c"] - 0.2 * q["b"] - 0.1 * q["b"] ** 2, "rad")
    m.gravity(0.5, 0, -9.81)
    return m


BUILT: dict[str, Callable[[], Mechanism]] = {
    each.__name__: each for each in (robot, press, shaper, raft, delta, stewart, floating, joints, gears, vice, servos)
}
