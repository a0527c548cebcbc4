"""Particle on a circle (Blajer 2002, Fig. 4 and Table I).

           y
           |      o  particle, mass m, force (Fx, Fy)
           |    /
           |  /  rho
           |/________ x
           O

q = [x y], one constraint: the distance from O is rho. Declared at the general level, by energy and constraint.
"""

import casadi as ca

from alfmu import Mechanism

SKETCH = __doc__


def particle_on_circle() -> Mechanism:
    """Return a particle on a circle."""
    m = Mechanism("particle_on_circle", "Particle on a circle under a force", SKETCH)
    mass = m.parameter("m", 1.0, "kg", minimum=0.0, description="mass of the particle")
    rho = m.parameter("rho", 1.0, "m", minimum=1e-6, description="radius of the circle")
    g = m.parameter("g", 0.0, "m/s2", description="gravity, along -y")
    angle = m.start("angle", 0.0, "rad", rate=1.0, rate_name="angular_velocity", description="angle of the radius")
    x = m.coordinate("x", "m", start=rho * ca.cos(angle))
    y = m.coordinate("y", "m", start=rho * ca.sin(angle))
    m.tie(angle, ca.atan2(y, x))
    m.kinetic_energy(mass * (m.rate(x) ** 2 + m.rate(y) ** 2) / 2)
    m.potential_energy(mass * g * y)
    m.generalized_force(x, m.input("force.x", "N", description="force along x"))
    m.generalized_force(y, m.input("force.y", "N", description="force along y"))
    m.constraint("circle", ca.sqrt(x**2 + y**2) - rho, "m")
    for name, q, rates in (("x", x, ("vx", "ax")), ("y", y, ("vy", "ay"))):
        m.output(f"particle.{name}", q, "m", f"place of the particle along {name}")
        m.output(f"particle.{rates[0]}", m.rate(q), "m/s", f"velocity of the particle along {name}")
        m.output(f"particle.{rates[1]}", m.acceleration(q), "m/s2", f"acceleration of the particle along {name}")
    return m
