"""Bennett's linkage: four links and four hinges in space that should not move, and do.

          hinge 2 ---- link 2, length b, twist beta ---- hinge 3
             |                                              |
    link 1, length a, twist alpha            link 3, length a, twist alpha      z  y
             |                                              |                   | /
          hinge 1 ==== ground, length b, twist beta ==== hinge 4                o-- x

The axes of neighbouring hinges are skew: `a` apart and turned by alpha, or b apart and turned by beta. Closing the loop
takes six equations for four angles, yet with b sin alpha = a sin beta three of them are redundant on the motion, and
beside it none is. Declared at the general level, in q = [th1 th2 th3 th4], the angles of
the hinges, the first on the z axis.
"""

import casadi as ca

from alfmu import Mechanism

SKETCH = __doc__


def bennett() -> Mechanism:
    """Return Bennett's over-constrained spatial four-bar linkage."""
    m = Mechanism("bennett", "Bennett's spatial four-bar linkage, over-constrained", SKETCH)
    a = m.parameter("a", 0.3, "m", minimum=1e-6, description="length of links 1 and 3")
    alpha = m.parameter("alpha", 0.7, "rad", description="twist of links 1 and 3")
    beta = m.parameter("beta", 1.2, "rad", description="twist of link 2 and of the ground")
    masses = [m.parameter(f"m{i}", 1.0, "kg", minimum=0.0, description=f"mass of link {i}") for i in (1, 2, 3)]
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -y")
    start = m.start("angle", 1.0, "rad", rate=3.0, rate_name="angular_velocity", description="angle of hinge 1")
    lengths, twists = (a, a * ca.sin(beta) / ca.sin(alpha)) * 2, (alpha, beta) * 2

    opposite = 2 * ca.atan2(
        ca.sin((beta + alpha) / 2) / ca.sin((beta - alpha) / 2) * ca.cos(start / 2), ca.sin(start / 2)
    )
    guesses = start, opposite, -start, -opposite
    angles = [m.coordinate(f"th{i}", "rad", start=guess) for i, guess in enumerate(guesses, 1)]
    rods, hinges, place, turn = chain(angles, lengths, twists)
    q, v = ca.vertcat(*angles), ca.vertcat(*map(m.rate, angles))
    for i, ((center, along), mass, length) in enumerate(zip(rods, masses, lengths, strict=False), 1):
        speed, swing = (ca.jtimes(x, q, v) for x in (center, along))
        m.kinetic_energy(mass * (ca.sumsqr(speed) + length**2 / 12 * ca.sumsqr(swing)) / 2)
        m.potential_energy(mass * g * center[1])
        for axis, x in zip("xyz", ca.vertsplit(center), strict=True):
            m.output(f"link{i}.{axis}", x, "m", f"centre of mass of link {i} along {axis}")
    hinges[3] = (-lengths[3], 0.0, 0.0), (0.0, ca.sin(beta), ca.cos(beta))  # on the ground, closing the loop
    for i, (at, axis) in enumerate(hinges, 1):
        m.drawn_joint(f"hinge{i}", at, kind="revolute", axis=axis)
    for i in (1, 2, 3):
        m.drawn_bar(f"link{i}", f"hinge{i}", f"hinge{i + 1}")
    for name, angle in zip(("hinge1", "hinge2", "hinge3", "hinge4"), angles, strict=True):
        m.output(f"{name}.angle", angle, "rad", f"angle of {name}")
        m.output(f"{name}.angular_velocity", m.rate(angle), "rad/s", f"rate of {name}")
        m.output(f"{name}.angular_acceleration", m.acceleration(angle), "rad/s2", f"second rate of {name}")
    m.generalized_force(angles[0], m.input("hinge1.torque", "N.m", description="torque on link 1 from the ground"))
    for axis, x in zip("xyz", ca.vertsplit(place), strict=True):
        m.constraint(f"loop.{axis}", x, "m")
    for axis, (i, j) in zip("xyz", ((2, 1), (0, 2), (1, 0)), strict=True):
        m.constraint(f"turn.{axis}", (turn[i, j] - turn[j, i]) / 2, "rad")
    return m


def chain(angles: list, lengths: tuple, twists: tuple) -> tuple[list, list, ca.SX, ca.SX]:
    """Return centre and direction of each link of an open chain, position and axis of each hinge, pose of the end.

    The chain is built by Denavit and Hartenberg's convention.
    """
    rods, hinges, place, turn = [], [], ca.SX.zeros(3), ca.SX.eye(3)
    for angle, length, twist in zip(angles, lengths, twists, strict=True):
        hinges.append((place, turn[:, 2]))
        c, s = ca.cos(angle), ca.sin(angle)
        turn = turn @ ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        along = turn[:, 0]
        rods.append((place + length / 2 * along, along))
        place = place + length * along
        c, s = ca.cos(twist), ca.sin(twist)
        turn = turn @ ca.blockcat([[1, 0, 0], [0, c, -s], [0, s, c]])
    return rods, hinges, place, turn
