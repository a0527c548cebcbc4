"""Linkages in space drawn at random, as data in the position in which they are assembled, declared in any direction.

Most are planar linkages made of bodies and joints in space, whose loops have redundant constraints in every position.
The others are a Sarrus linkage, a linkage with a universal joint and a ball, and a table on parallel legs.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from alfmu import Mechanism

Z = (0.0, 0.0, 1.0)
G = 9.81


@dataclass
class Link:
    """A body: mass [kg], centre of mass [m], matrix of inertia about it [kg.m2] in ground axes at the assembly."""

    name: str
    mass: float
    center: NDArray
    inertia: NDArray


@dataclass
class Hinge:
    """A joint between two bodies (None is the ground) through a point along one or two directions, in ground axes."""

    name: str
    kind: str
    first: str | None
    second: str
    point: NDArray
    axis: tuple[float, ...] = Z
    other: tuple[float, ...] = ()


@dataclass
class Linkage:
    """A linkage; the rate of its first joint [rad/s or m/s]."""

    name: str
    links: list[Link] = field(default_factory=list)
    joints: list[Hinge] = field(default_factory=list)
    gravity: tuple[float, ...] = (0.0, -G, 0.0)
    rate: float = 1.0

    def link(self, random: np.random.Generator, name: str, *points: NDArray) -> str:
        """A body whose mass lies about some points."""
        center = np.mean(points, 0) + random.uniform(-0.05, 0.05, 3)
        spread = np.mean([np.sum((p - center) ** 2) for p in points])
        axes = Rotation.random(random_state=random.integers(1 << 30)).as_matrix()
        mass = random.uniform(0.5, 2.0)
        moments = mass * (0.02 + spread) * random.uniform(0.3, 0.5, 3)
        self.links.append(Link(name, mass, center, axes @ np.diag(moments) @ axes.T))
        return name

    def join(self, *args: object, **more: object) -> None:
        self.joints.append(Hinge(*args, **more))  # type: ignore[arg-type]

    def declared(
        self, turn: Rotation | None = None, offset: tuple[float, ...] = (0.0, 0.0, 0.0), absolute: str = ""
    ) -> Mechanism:
        """The linkage turned and shifted; `absolute` tells which bodies have coordinates of their own: those whose
        letter ("l" links, "c" the others of the loop) it has."""
        turn = turn or Rotation.identity()
        R, shift = turn.as_matrix(), np.array(offset)
        m = Mechanism(self.name)
        m.gravity(*map(float, R @ self.gravity))
        own = {each.name: _kind_of(each.name) in absolute for each in self.links}
        bodies = {None: m.spatial_ground}
        origin = {None: np.zeros(3)}
        for each in self.links:
            place = R @ each.center + shift
            origin[each.name] = place
            moments = (R @ each.inertia @ R.T).tolist()
            given = {"position": tuple(map(float, place))} if own[each.name] else {"relative": True}
            bodies[each.name] = m.spatial_body(each.name, mass=each.mass, inertia=moments, **given)
        placed = {None, *(name for name, free in own.items() if free)}
        for i, joint in enumerate(self.joints):
            point = R @ joint.point + shift
            first, second = (bodies[x].at(*map(float, point - origin[x])) for x in (joint.first, joint.second))
            places = joint.second not in placed
            placed.add(joint.second)
            axis = tuple(map(float, R @ joint.axis))
            count = {"revolute": 1, "prismatic": 1, "universal": 2, "spherical": 4}[joint.kind] * places
            q = [
                m.coordinate(
                    f"{joint.name}{k}" if count > 1 else joint.name,
                    "m" if joint.kind == "prismatic" else "1" if joint.kind == "spherical" else "rad",
                    start=float(joint.kind == "spherical" and k == 0),
                    **({"independent": True, "rate": self.rate} if i == 0 and k == 0 else {}),
                )
                for k in range(count)
            ]
            if joint.kind == "revolute":
                m.spatial_revolute(f"J{i}", first, second, axis=axis, coordinate=q[0] if q else None)
            elif joint.kind == "prismatic":
                m.spatial_prismatic(f"J{i}", first, second, axis=axis, coordinate=q[0] if q else None)
            elif joint.kind == "universal":
                other = tuple(map(float, R @ joint.other))
                m.universal(f"J{i}", first, second, axis=axis, second_axis=other, coordinates=q or None)
            else:
                m.spherical(f"J{i}", first, second, coordinates=q or None)
        return m


def _kind_of(name: str) -> str:
    return "l" if name.startswith("link") else "c"


def _flat(x: float, y: float, random: np.random.Generator) -> NDArray:
    return np.array([x, y, random.uniform(-0.1, 0.1)])


def four_bar(random: np.random.Generator) -> Linkage:
    """Four hinges; the last one may be a ball, and the one before it a universal joint."""
    made = Linkage("four_bar", rate=random.uniform(0.5, 2.0))
    O, D = _flat(0, 0, random), _flat(1, random.uniform(-0.2, 0.2), random)
    A, C = _flat(0, random.uniform(0.3, 0.5), random), _flat(0.9, random.uniform(0.6, 0.9), random)
    a, b, c = made.link(random, "link1", O, A), made.link(random, "coupler", A, C), made.link(random, "link2", D, C)
    kinds = [("revolute", "revolute"), ("revolute", "spherical"), ("universal", "spherical"), ("universal", "revolute")]
    second, last = kinds[random.integers(4)]
    made.join("a", "revolute", None, a, O)
    made.join("b", second, a, b, A, Z, (1.0, 0.0, 0.0))
    made.join("d", "revolute", None, c, D)
    made.join("c", last, b, c, C)
    return made


def six_bar(random: np.random.Generator) -> Linkage:
    """A four-bar whose coupler drives a second loop (Watt or Stephenson)."""
    made = four_bar(random)
    made.name = "six_bar"
    for each in made.joints:
        each.kind = "revolute"
    C, D = made.joints[3].point, made.joints[2].point
    on, where = ("link2", D + 0.6 * (C - D)) if random.random() < 0.5 else ("coupler", C + np.array([0.1, -0.2, 0.0]))
    E, F, H = where, _flat(1.6, 0.7, random), _flat(1.9, -0.1, random)
    e, f = made.link(random, "link3", E, F), made.link(random, "link4", F, H)
    made.join("e", "revolute", on, e, E)
    made.join("h", "revolute", None, f, H)
    made.join("f", "revolute", e, f, F)
    return made


def slider_crank(random: np.random.Generator) -> Linkage:
    """Crank, rod and slide; the hinge at the slide closes the loop, or the slide does."""
    made = Linkage("slider_crank", rate=random.uniform(0.5, 2.0))
    O, A, B = _flat(0, 0, random), _flat(0.2, random.uniform(0.2, 0.4), random), _flat(1.2, 0.1, random)
    a, b = made.link(random, "link1", O, A), made.link(random, "coupler", A, B)
    s = made.link(random, "link2", B, B + np.array([0.1, 0.1, 0.1]))
    made.join("a", "revolute", None, a, O)
    made.join("b", "revolute", a, b, A)
    if random.random() < 0.5:
        made.join("s", "prismatic", None, s, B, (1.0, 0.0, 0.0))
        made.join("c", "revolute", b, s, B)
    else:
        made.join("c", "revolute", b, s, B)
        made.join("s", "prismatic", None, s, B, (1.0, 0.0, 0.0))
    return made


def sarrus(random: np.random.Generator) -> Linkage:
    """A platform on two chains of three parallel hinges, square to each other, so high that it falls for half a second
    before they fold up."""
    made = Linkage("sarrus", gravity=(0.0, 0.0, -G), rate=random.uniform(0.5, 1.5))
    z, knee, reach = random.uniform(1.2, 1.6), random.uniform(0.15, 0.35), random.uniform(0.3, 0.6)
    made_of = []
    for axis, side in (((0.0, 1.0, 0.0), np.array([1.0, 0, 0])), ((1.0, 0.0, 0.0), np.array([0, 1.0, 0]))):
        low = reach * side + np.array([0, 0, 0.0])
        middle = (reach + knee) * side + np.array([0, 0, random.uniform(0.4, 0.6) * z])
        made_of.append((axis, low, middle, reach * side + np.array([0, 0, z])))
    (ax, a0, a1, a2), (bx, b0, b1, b2) = made_of
    one, top = made.link(random, "link1", a0, a1), ""
    two = made.link(random, "coupler1", a1, a2)
    top = made.link(random, "link2", a2, b2)
    three = made.link(random, "link3", b0, b1)
    four = made.link(random, "coupler2", b1, b2)
    made.join("a0", "revolute", None, one, a0, ax)
    made.join("a1", "revolute", one, two, a1, ax)
    made.join("a2", "revolute", two, top, a2, ax)
    made.join("b0", "revolute", None, three, b0, bx)
    made.join("b1", "revolute", three, four, b1, bx)
    made.join("b2", "revolute", four, top, b2, bx)
    return made


def scissors(random: np.random.Generator) -> Linkage:
    """Two stages of crossed bars, hinged at their middles and ends, on a hinge and a slide."""
    made = Linkage("scissors", rate=random.uniform(0.3, 1.0))
    w, h = random.uniform(0.5, 0.8), random.uniform(0.3, 0.5)
    at = {(i, side): np.array([w * side, h * i, 0.02 * i]) for i in range(3) for side in (0, 1)}
    previous: dict[int, str | None] = {0: None, 1: None}
    slide = made.link(random, "link0", at[0, 1], at[0, 1] + 0.1)
    for i in range(2):
        up = made.link(random, f"link{i + 1}", at[i, 0], at[i + 1, 1])
        down = made.link(random, f"coupler{i + 1}", at[i, 1], at[i + 1, 0])
        middle = np.array([w / 2, h * (i + 0.5), 0.01])
        made.join(f"u{i}", "revolute", previous[0], up, at[i, 0])
        made.join(f"m{i}", "revolute", up, down, middle)
        if i == 0:
            made.join("s", "prismatic", None, slide, at[0, 1], (1.0, 0.0, 0.0))
            made.join("g", "revolute", slide, down, at[0, 1])
        else:
            made.join(f"d{i}", "revolute", previous[1], down, at[i, 1])
        previous = {0: down, 1: up}
    return made


def gripper(random: np.random.Generator) -> Linkage:
    """A finger that hangs on two parallel arms of equal length, and a redundant third one; they swing to no line."""
    made = Linkage("gripper", rate=random.uniform(0.5, 1.5))
    arm = np.array([random.uniform(0.2, 0.5), -random.uniform(0.3, 0.5), 0.0])
    roots = [_flat(x, 0.0, random) for x in (0.0, 0.3, random.uniform(0.5, 0.8))]
    finger = "coupler"
    arms = [made.link(random, f"link{i}", p, p + arm) for i, p in enumerate(roots)]
    made.link(random, finger, *(p + arm for p in roots))
    made.join("a0", "revolute", None, arms[0], roots[0])
    made.join("b0", "revolute", arms[0], finger, roots[0] + arm)
    for i in (1, 2):
        made.join(f"a{i}", "revolute", None, arms[i], roots[i])
        made.join(f"b{i}", "revolute", arms[i], finger, roots[i] + arm)
    return made


def universal_table(random: np.random.Generator) -> Linkage:
    """A table on two parallel legs of equal length with universal joints below and balls above, and a hinged strut."""
    made = Linkage("table", gravity=(0.0, 0.0, -G), rate=random.uniform(0.2, 0.5))
    leg = np.array([random.uniform(0.1, 0.3), random.uniform(0.1, 0.3), 0.8])
    roots = [np.array([x, y, 0.0]) for x, y in ((0.0, 0.0), (0.7, 0.1), (0.2, 0.6))]
    legs = [made.link(random, f"link{i}", p, p + leg) for i, p in enumerate(roots)]
    top = made.link(random, "coupler", *(p + leg for p in roots))
    x, y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    made.join("a0", "revolute", None, legs[0], roots[0], x)
    made.join("b0", "revolute", legs[0], top, roots[0] + leg, x)
    for i in (1, 2):
        made.join(f"a{i}", "universal", None, legs[i], roots[i], x, y)
        made.join(f"b{i}", "spherical", legs[i], top, roots[i] + leg)
    return made


KINDS = (four_bar, six_bar, slider_crank, sarrus, scissors, gripper, universal_table)
