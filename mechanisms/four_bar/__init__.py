"""Parallel four-bar linkage under a driving torque (Blajer 2002, Fig. 8).

    B ---- link2 ---- C
    |                 |
  link1             link3          y
    |                 |            |  gravity g along -y
    A ==== ground === D            o-- x

All links have length l; A at (0, 0), D at (l, 0). q = [th1 x2 y2 th2 th3]: angles of links 1 and 3 from the x axis,
link 2 torn off (place of its centre of mass and angle). At th1 = n pi all links are aligned, and a torque cannot pass
through the aligned links: the position is singular.
"""

import casadi as ca

from alfmu import Body, Mechanism

SKETCH = __doc__


def four_bar() -> Mechanism:
    """Parallel four-bar linkage under a driving torque."""
    m = Mechanism("four_bar", "Parallel four-bar linkage under a driving torque", SKETCH)
    parallelogram(m)
    return m


def parallelogram(m: Mechanism) -> tuple[ca.SX, ca.SX, dict[str, Body]]:
    """Links 1 to 3 of a parallelogram with joints A, B, C, D; returns l, th1 and the links by name."""
    l = m.parameter("l", 1.0, "m", minimum=1e-6, description="length of every link and of the base")
    masses = [m.parameter(f"m{i}", 1.0, "kg", minimum=0.0, description=f"mass of link {i}") for i in (1, 2, 3)]
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    angle = m.start("angle", 0.0, "rad", rate=2.0, rate_name="angular_velocity", description="angle of link 1")

    th1 = m.coordinate("th1", "rad", start=angle)
    x2 = m.coordinate("x2", "m", start=l * ca.cos(th1) + l / 2)
    y2 = m.coordinate("y2", "m", start=l * ca.sin(th1))
    th2 = m.coordinate("th2", "rad", start=0.0)
    th3 = m.coordinate("th3", "rad", start=th1)

    link1 = m.bar("link1", mass=masses[0], length=l)
    link2 = m.bar("link2", mass=masses[1], length=l, pose=(x2, y2, th2))
    link3 = m.bar("link3", mass=masses[2], length=l)
    A = m.revolute("A", m.ground.at(0.0, 0.0), link1.start, coordinate=th1)
    m.revolute("B", link1.end, link2.start)
    m.revolute("C", link2.end, link3.end)
    D = m.revolute("D", m.ground.at(l, 0.0), link3.start, coordinate=th3)
    m.drive(A, m.input("A.torque", "N.m", description="torque on link 1 from the ground"))
    m.drive(D, m.input("D.torque", "N.m", description="torque on link 3 from the ground"))
    m.gravity(0.0, -g)
    return l, th1, {"link1": link1, "link2": link2, "link3": link3}
