"""Parallel four-bar linkage under a driving torque (Blajer 2002, Fig. 8).

    B ---- link2 ---- C
    |                 |
  link1             link3          y
    |                 |            |  gravity g along -y
    A ==== ground === D            o-- x

All links have length l; A at (0, 0), D at (l, 0).

    mixed     q = [th1 x2 y2 th2 th3]   angles of links 1 and 3 from the x axis, link 2 torn off (its centre and angle)
    joint     q = [th1 th2 th3]         link 2 by its angle from link 1, the loop cut at C

At th1 = n pi all links are aligned, and a torque cannot pass through the aligned links: the position is singular.
"""

from typing import Literal

import casadi as ca

from alfmu import Body, Mechanism

SKETCH = __doc__


Coordinates = Literal["mixed", "joint"]


def four_bar(coordinates: Coordinates = "mixed") -> Mechanism:
    """Return a parallel four-bar linkage under a driving torque, in these coordinates."""
    m = Mechanism("four_bar", "Parallel four-bar linkage under a driving torque", SKETCH)
    parallelogram(m, coordinates)
    return m


def parallelogram(m: Mechanism, coordinates: Coordinates) -> tuple[ca.SX, ca.SX, dict[str, Body]]:
    """Add links 1 to 3 of a parallelogram with joints A, B, C, D; return l, th1 and the links by name."""
    l = m.parameter("l", 1.0, "m", minimum=1e-6, description="length of every link and of the base")
    masses = [m.parameter(f"m{i}", 1.0, "kg", minimum=0.0, description=f"mass of link {i}") for i in (1, 2, 3)]
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    angle = m.start("angle", 0.0, "rad", rate=2.0, rate_name="angular_velocity", description="angle of link 1")

    th1 = m.coordinate("th1", "rad", start=angle)
    link1 = m.bar("link1", mass=masses[0], length=l)
    link2, angle_B = across(m, coordinates, 2, masses[1], l, (l * ca.cos(th1), l * ca.sin(th1)), th1)
    th3 = m.coordinate("th3", "rad", start=th1)
    link3 = m.bar("link3", mass=masses[2], length=l)
    A = m.revolute("A", m.ground.at(0.0, 0.0), link1.start, coordinate=th1)
    m.revolute("B", link1.end, link2.start, coordinate=angle_B)
    m.revolute("C", link2.end, link3.end)
    D = m.revolute("D", m.ground.at(l, 0.0), link3.start, coordinate=th3)
    m.drive(A, m.input("A.torque", "N.m", description="torque on link 1 from the ground"))
    m.drive(D, m.input("D.torque", "N.m", description="torque on link 3 from the ground"))
    m.gravity(0.0, -g)
    return l, th1, {"link1": link1, "link2": link2, "link3": link3}


def across(
    m: Mechanism, coordinates: Coordinates, i: int, mass: ca.SX, l: ca.SX, begin: tuple[ca.SX, ca.SX], th1: ca.SX
) -> tuple[Body, ca.SX | None]:
    """Return link i from link 1 to link 3 that begins at a point, and the coordinate of its joint on link 1, if any."""
    if coordinates == "joint":
        th = m.coordinate(f"th{i}", "rad", start=-th1)
        return m.bar(f"link{i}", mass=mass, length=l), th
    x, y = (
        m.coordinate(f"{axis}{i}", "m", start=place)
        for axis, place in zip("xy", (begin[0] + l / 2, begin[1]), strict=True)
    )
    return m.bar(f"link{i}", mass=mass, length=l, pose=(x, y, m.coordinate(f"th{i}", "rad", start=0.0))), None
