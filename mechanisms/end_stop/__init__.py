"""Slider-crank of a heavy flywheel, a rod a million times lighter, and a ram that runs into an elastic end stop.

          ____
        /   B  \\
       |   /\\--|----\\         rod, l2
       |  O     |     ----\\                        y
        \\ ____ /           C ram | ||| stop         |
      flywheel, l1 to B   [====] | |||              o-- x
    ---------------------------- | -------- guide
                                 stop: place of C at which they touch

    q = [th1 x2 y2 th2 s]   angle of the flywheel; centre of mass and angle of the torn-off rod; place of the ram

The stop pushes with a spring that stiffens smoothly over the first part of the penetration, and a dissipation in
proportion to it (Hunt and Crossley): three times continuously differentiable, so that methods of fourth order keep
their order.
"""

import casadi as ca

from alfmu import Experiment, Mechanism

SKETCH = __doc__


def end_stop() -> Mechanism:
    """Return a slider-crank with masses a million apart, whose ram runs into an elastic end stop."""
    m = Mechanism(
        "end_stop",
        "Slider-crank with masses a million apart, whose ram runs into an elastic end stop",
        SKETCH,
        Experiment(5.0, 5e-5, communication_step=1e-3),
    )
    l1 = m.parameter("l1", 0.5, "m", minimum=1e-6, description="distance of the crank pin from the flywheel's axis")
    l2 = m.parameter("l2", 1.0, "m", minimum=1e-6, description="length of the rod")
    m1 = m.parameter("m1", 1000.0, "kg", minimum=0.0, description="mass of the flywheel")
    m2 = m.parameter("m2", 1e-3, "kg", minimum=0.0, description="mass of the rod")
    m3 = m.parameter("m3", 10.0, "kg", minimum=0.0, description="mass of the ram")
    radius = m.parameter("radius", 0.5, "m", minimum=0.0, description="radius of the flywheel, a uniform disc")
    stop = m.parameter("stop", 1.4, "m", description="place of the ram at which it touches the stop")
    stiffness = m.parameter("stiffness", 1e8, "N/m", minimum=0.0, description="stiffness of the stop")
    dissipation = m.parameter("dissipation", 0.2, "s/m", minimum=0.0, description="share of damping in the push")
    onset = m.parameter("onset", 5e-4, "m", minimum=1e-9, description="penetration over which the stop stiffens")
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    angle = m.start("angle", -2.0, "rad", rate=2.0, rate_name="angular_velocity", description="angle of the flywheel")

    xB, yB = l1 * ca.cos(angle), l1 * ca.sin(angle)
    square = l2**2 - yB**2
    reach = ca.sqrt(ca.if_else(square > 0, square, 1e-12 * l2**2))
    th1 = m.coordinate("th1", "rad", start=angle)
    pose = (
        m.coordinate("x2", "m", start=xB + reach / 2),
        m.coordinate("y2", "m", start=yB / 2),
        m.coordinate("th2", "rad", start=ca.atan2(-yB, reach)),
    )
    s = m.coordinate("s", "m", start=xB + reach)

    flywheel = m.body("flywheel", mass=m1, inertia=m1 * radius**2 / 2)
    rod = m.bar("rod", mass=m2, length=l2, pose=pose)
    ram = m.body("ram", mass=m3)
    axle = m.revolute("O", m.ground.at(0.0, 0.0), flywheel.at(0.0, 0.0), coordinate=th1)
    m.revolute("B", flywheel.at(l1, 0.0), rod.start)
    m.revolute("C", rod.end, ram.at(0.0, 0.0))
    guide = m.prismatic("guide", m.ground.at(0.0, 0.0), ram.at(0.0, 0.0), coordinate=s)
    m.drive(axle, m.input("O.torque", "N.m", description="torque on the flywheel from the ground"))
    m.drive(guide, m.input("ram.force", "N", description="force on the ram along the guide"))
    m.gravity(0.0, -g)

    m.end_stop("stop", guide, upper=stop, stiffness=stiffness, onset=onset, dissipation=dissipation)
    return m
