"""N-four-bar: any number of parallel four-bar loops in a row (IFToMM benchmark A02).

     P1 - coupler1 - P2 - coupler2 - P3        P(N+1)
     |               |               |          |
   crank1          crank2          crank3 ... crank(N+1)   y
     |               |               |          |          |  gravity g along -y
     A1 == ground == A2 == ground == A3 ...    A(N+1)      o-- x

N loops: N + 1 cranks on the ground and N couplers; every link and every distance of neighbouring pivots has length l.
Crank i turns about Ai at ((i - 1) l, 0) and ends in Pi. There joint Bi holds the start of coupler i, and joint C(i - 1)
the end of coupler i - 1.

    natural   q = [x1 y1 ... x(N+1) y(N+1)]     points P1 to P(N+1)
    absolute  q = [crank1_x crank1_y crank1_th coupler1_x ... crank(N+1)_th]     centres of mass and angles

At start.angle = n pi all links are in one line and the position is singular: every loop may leave its parallelogram.
"""

from typing import Literal

import casadi as ca

from alfmu import Body, Experiment, InputError, Mechanism

SKETCH = __doc__


def n_four_bar(loops: int = 2, coordinates: Literal["natural", "absolute"] = "natural") -> Mechanism:
    """Return an N-four-bar with this number of loops, in these coordinates."""
    if loops < 1:
        raise InputError(f"n_four_bar: option loops is {loops}; use a whole number from 1 on")
    text = f"N-four-bar with {loops} loop{'s' * (loops > 1)} in {coordinates} coordinates"
    m = Mechanism("n_four_bar", text, SKETCH, Experiment(stop_time=10.0, step_size=0.01))
    l = m.parameter("l", 1.0, "m", minimum=1e-6, description="length of every link, and distance of the pivots")
    mass = m.parameter("m", 1.0, "kg", minimum=1e-6, description="mass of every link")
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    start = m.start("angle", ca.pi / 2, "rad", rate=-1.0, rate_name="angular_velocity", description="angle of crank 1")

    cranks, couplers = (_natural if coordinates == "natural" else _absolute)(m, loops, l, mass, start)
    pivots = [m.revolute(f"A{i + 1}", m.ground.at(i * l, 0.0), crank.start) for i, crank in enumerate(cranks)]
    for i, coupler in enumerate(couplers):
        m.revolute(f"B{i + 1}", cranks[i].end, coupler.start)
        m.revolute(f"C{i + 1}", cranks[i + 1].end, coupler.end)
    m.drive(pivots[0], m.input("A1.torque", "N.m", description="torque on crank 1 from the ground"))
    m.gravity(0.0, -g)
    return m


def _natural(m: Mechanism, loops: int, l: ca.SX, mass: ca.SX, start: ca.SX) -> tuple[list[Body], list[Body]]:
    """Return cranks and couplers between points (natural coordinates)."""
    x, y = l * ca.cos(start), l * ca.sin(start)
    ends = [
        m.point(m.coordinate(f"x{i + 1}", "m", start=i * l + x), m.coordinate(f"y{i + 1}", "m", start=y))
        for i in range(loops + 1)
    ]
    m.tie(start, ca.atan2(ends[0].y / l, ends[0].x / l))
    cranks = [
        m.bar(f"crank{i + 1}", mass=mass, length=l, between=(m.ground.at(i * l, 0.0), end))
        for i, end in enumerate(ends)
    ]
    couplers = [m.bar(f"coupler{i + 1}", mass=mass, length=l, between=(ends[i], ends[i + 1])) for i in range(loops)]
    return cranks, couplers


def _absolute(m: Mechanism, loops: int, l: ca.SX, mass: ca.SX, start: ca.SX) -> tuple[list[Body], list[Body]]:
    """Return cranks and couplers with a centre of mass and an angle each (absolute coordinates)."""

    def bar(name: str, x: ca.SX, y: ca.SX, angle: ca.SX | float) -> Body:
        starts = {"x": ("m", x), "y": ("m", y), "th": ("rad", angle)}
        pose = tuple(m.coordinate(f"{name}_{k}", unit, start=guess) for k, (unit, guess) in starts.items())
        return m.bar(name, mass=mass, length=l, pose=pose)

    x, y = l * ca.cos(start), l * ca.sin(start)
    cranks, couplers = [bar("crank1", x / 2, y / 2, start)], []
    for i in range(1, loops + 1):
        couplers.append(bar(f"coupler{i}", (i - 0.5) * l + x, y, 0.0))
        cranks.append(bar(f"crank{i + 1}", i * l + x / 2, y / 2, cranks[0].pose[2]))
    return cranks, couplers
