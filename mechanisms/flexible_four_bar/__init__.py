"""Four-bar linkage with a flexible joint: the coupler bends at B, against a very stiff torsional spring-damper.

              near     B     far
          A o---------(~)---------o C
           /                       \\
    crank /                         \\ rocker         y
         /                           \\               |  gravity g along -y
        O ========= ground ========== D              o-- x

    q = [th1 th2 beta th4]   angle of the crank; of the near half of the coupler from the crank; of the far half from
                             the near one, 0 if the coupler is straight; angle of the rocker from the x axis

The halves of the coupler, joined by a spring, are its lumped model (a pseudo-rigid body): beta oscillates fast about
the rest angle while the linkage turns slowly. Crank-rocker with O at (0, 0), D at (l0, 0).
"""

import casadi as ca

from alfmu import Experiment, Mechanism

SKETCH = __doc__


def flexible_four_bar() -> Mechanism:
    """Return a four-bar linkage whose coupler bends at a stiff torsional spring-damper."""
    m = Mechanism(
        "flexible_four_bar",
        "Four-bar linkage whose coupler bends at a stiff torsional spring-damper",
        SKETCH,
        Experiment(5.0, 2e-4, communication_step=1e-3),
    )
    lengths = (("l0", 1.0, "base"), ("l1", 0.3, "crank"), ("l2", 0.9, "coupler when straight"), ("l3", 0.7, "rocker"))
    l0, l1, l2, l3 = (
        m.parameter(name, value, "m", minimum=1e-6, description=f"length of the {what}")
        for name, value, what in lengths
    )
    masses = (("m1", 0.3, "crank"), ("m2", 0.9, "coupler"), ("m3", 0.7, "rocker"))
    m1, m2, m3 = (
        m.parameter(name, value, "kg", minimum=0.0, description=f"mass of the {what}") for name, value, what in masses
    )
    stiffness = m.parameter("stiffness", 1e5, "N.m/rad", minimum=0.0, description="stiffness of the joint B")
    damping = m.parameter("damping", 1.0, "N.m.s/rad", minimum=0.0, description="damping of the joint B")
    rest = m.parameter("rest", 0.0, "rad", description="angle of the joint B without moment")
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    angle = m.start("angle", 0.5, "rad", rate=6.0, rate_name="angular_velocity", description="angle of the crank")
    bend = m.start("bend", 1e-3, "rad", rate_name="bend_rate", description="angle of the joint B")

    # With the straight line from A to C as coupler it is a four-bar; C lies above the line from A to D.
    line = l2 * ca.cos(bend / 2)
    xA, yA = l1 * ca.cos(angle), l1 * ca.sin(angle)
    diagonal = ca.sqrt((l0 - xA) ** 2 + yA**2)
    opening = ca.acos((diagonal**2 + line**2 - l3**2) / (2 * diagonal * line))
    near_angle = ca.atan2(-yA, l0 - xA) + opening - bend / 2

    th1 = m.coordinate("th1", "rad", start=angle)
    th2 = m.coordinate("th2", "rad", start=near_angle - angle)
    beta = m.coordinate("beta", "rad", start=bend)
    xC, yC = xA + line * ca.cos(near_angle + bend / 2), yA + line * ca.sin(near_angle + bend / 2)
    th4 = m.coordinate("th4", "rad", start=ca.atan2(yC, xC - l0))

    crank, rocker = m.bar("crank", mass=m1, length=l1), m.bar("rocker", mass=m3, length=l3)
    near, far = (m.bar(name, mass=m2 / 2, length=l2 / 2) for name in ("near", "far"))
    pivot = m.revolute("O", m.ground.at(0.0, 0.0), crank.start, coordinate=th1)
    m.revolute("A", crank.end, near.start, coordinate=th2)
    flexible = m.revolute("B", near.end, far.start, coordinate=beta)
    m.revolute("C", far.end, rocker.end)
    m.revolute("D", m.ground.at(l0, 0.0), rocker.start, coordinate=th4)
    m.spring_damper(flexible, stiffness=stiffness, damping=damping, rest=rest)
    m.drive(pivot, m.input("O.torque", "N.m", description="torque on the crank from the ground"))
    m.gravity(0.0, -g)
    m.output("B.angle", beta, "rad", "bend of the coupler")
    m.output("B.angular_velocity", m.rate(beta), "rad/s", "rate of the bend")
    m.output("B.moment", -stiffness * (beta - rest) - damping * m.rate(beta), "N.m", "moment of B on far from near")
    return m
