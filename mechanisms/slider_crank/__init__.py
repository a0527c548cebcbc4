"""Slider-crank in four sets of coordinates (Blajer 2002, Fig. 5 a to d).

           B
          / \\
    crank/     \\ rod             y
        /        \\               |  gravity g along -y
       A          C slider        o-- x
     (0, b)      [===]---> slider.force
    ------------------------- guide, y = 0

    absolute  q = [x1 y1 th1 x2 y2 th2 x3 y3]   centres of mass and angles of crank, rod, slider
    joint     q = [th1 th2 s]                   crank from ground, rod from crank, slider along the guide
    mixed     q = [th1 x2 y2 th2 s]             rod torn off
    natural   q = [x1 y1 x2 y2]                 points B and C

With l1 = l2 and b = 0 the position with both links vertical is singular.
"""

from typing import Literal

import casadi as ca

from alfmu import Mechanism

SKETCH = __doc__


def slider_crank(
    coordinates: Literal["absolute", "joint", "mixed", "natural"] = "absolute",
    rod: Literal["right", "left"] = "right",
) -> Mechanism:
    """Return a slider-crank in these coordinates, with the rod on this side of the crank at the start."""
    m = Mechanism("slider_crank", f"Slider-crank in {coordinates} coordinates", SKETCH)
    l1 = m.parameter("l1", 0.5, "m", minimum=1e-6, description="length of the crank")
    l2 = m.parameter("l2", 1.0, "m", minimum=1e-6, description="length of the rod")
    b = m.parameter("b", 0.0, "m", description="height of A above the guide")
    m1, m2, m3 = (
        m.parameter(f"m{i}", 1.0, "kg", minimum=0.0, description=f"mass of the {name}")
        for i, name in ((1, "crank"), (2, "rod"), (3, "slider"))
    )
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    start = m.start(
        "angle", 0.25 * ca.pi, "rad", rate=0.0, rate_name="angular_velocity", description="angle of the crank"
    )
    side = 1 if rod == "right" else -1

    # Positions of B and C, and the angle of the rod, for a crank angle th: only the guess of the assembly uses them.
    def place(th: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        xB, yB = l1 * ca.cos(th), b + l1 * ca.sin(th)
        square = l2**2 - yB**2
        reach = side * ca.sqrt(ca.if_else(square > 0, square, 1e-12 * l2**2))  # of a rod too short, almost none
        return xB, yB, xB + reach, ca.atan2(-yB, reach)

    A, guide = m.ground.at(0.0, b), m.ground.at(0.0, 0.0)
    xB, yB, xC, th_rod = place(start)
    if coordinates == "natural":
        B = m.point(m.coordinate("x1", "m", start=xB), m.coordinate("y1", "m", start=yB))
        C = m.point(m.coordinate("x2", "m", start=xC), m.coordinate("y2", "m", start=0.0))
        m.tie(start, ca.atan2((B.y - b) / l1, B.x / l1))
        crank = m.bar("crank", mass=m1, length=l1, between=(A, B))
        rod_ = m.bar("rod", mass=m2, length=l2, between=(B, C))
        slider = m.body("slider", mass=m3, pose=(C.x, C.y, 0.0))
        crank_angle = rod_angle = slide = None
    elif coordinates == "absolute":
        crank_pose = (
            m.coordinate("x1", "m", start=xB / 2),
            m.coordinate("y1", "m", start=(b + yB) / 2),
            m.coordinate("th1", "rad", start=start),
        )
        crank = m.bar("crank", mass=m1, length=l1, pose=crank_pose)
        rod_ = m.bar("rod", mass=m2, length=l2, pose=_rod_pose(m, xB, yB, xC, th_rod))
        slider_pose = (m.coordinate("x3", "m", start=xC), m.coordinate("y3", "m", start=0.0), 0.0)
        slider = m.body("slider", mass=m3, pose=slider_pose)
        crank_angle = rod_angle = slide = None
    else:
        crank_angle = m.coordinate("th1", "rad", start=start)
        crank = m.bar("crank", mass=m1, length=l1)
        if coordinates == "mixed":
            rod_angle = None
            rod_ = m.bar("rod", mass=m2, length=l2, pose=_rod_pose(m, xB, yB, xC, th_rod))
        else:
            rod_angle = m.coordinate("th2", "rad", start=th_rod - start)
            rod_ = m.bar("rod", mass=m2, length=l2)
        slide = m.coordinate("s", "m", start=xC)
        slider = m.body("slider", mass=m3)

    joint = m.revolute("A", A, crank.start, coordinate=crank_angle)
    m.revolute("B", crank.end, rod_.start, coordinate=rod_angle)
    m.revolute("C", rod_.end, slider.at(0.0, 0.0))
    track = m.prismatic("guide", guide, slider.at(0.0, 0.0), coordinate=slide)
    m.drive(joint, m.input("A.torque", "N.m", description="torque on the crank from the ground"))
    m.drive(track, m.input("slider.force", "N", description="force on the slider along the guide"))
    m.gravity(0.0, -g)
    return m


def _rod_pose(m: Mechanism, xB: ca.SX, yB: ca.SX, xC: ca.SX, angle: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return coordinates of a torn-off rod from B to C on the guide."""
    return (
        m.coordinate("x2", "m", start=(xB + xC) / 2),
        m.coordinate("y2", "m", start=yB / 2),
        m.coordinate("th2", "rad", start=angle),
    )
