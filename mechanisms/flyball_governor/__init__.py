"""Flyball governor of rigid rods and stiff spring-dampers, spatial (IFToMM benchmark A05).

                hinge1   hinge2
                  o==[ ]==o             height l, each `pivot` from the axis
                 /   | |   \\
          rod1  /    | |    \\  rod2      each at start.rod_angle below the horizontal
               *     | |     *          middle of the rod
              / \\    | |    / \\
             /   \\   | |   /   \\         stiff spring-dampers from there to the slider
         ball     \\[slider]/    ball                                       z
                     | |                place on the shaft: start.position  |  gravity g along -z
                     | | shaft                                              o-- x, with the shaft at angle 0
          ======== bearing ========     height 0

Shaft, slider and both rods are bodies in space, each with its place and Euler parameters; bearing, guide and hinges are
constraints. Each rod carries a ball, a point mass at its end.
"""

import casadi as ca

from alfmu import Experiment, Mechanism
from alfmu.model.spatial import about, product

SKETCH = __doc__


def flyball_governor() -> Mechanism:
    """Return a flyball governor with stiff spring-dampers, in space."""
    m = Mechanism(
        "flyball_governor",
        "Flyball governor with stiff spring-dampers, in space",
        SKETCH,
        Experiment(10.0, 1e-4, communication_step=0.01),
    )
    l = m.parameter("l", 1.0, "m", minimum=1e-6, description="length of shaft and rods")
    width = m.parameter("width", 0.01, "m", minimum=1e-6, description="width of the square sections of shaft and rods")
    density = m.parameter("density", 3000.0, "kg/m3", minimum=1e-6, description="density of shaft and rods")
    m_ball = m.parameter("m_ball", 5.0, "kg", minimum=0.0, description="mass of the ball at the end of each rod")
    m_slider = m.parameter("m_slider", 3.0, "kg", minimum=1e-6, description="mass of the slider, a cube")
    side = m.parameter("side", 0.1, "m", minimum=1e-6, description="edge of the slider; the springs end at mid-face")
    pivot = m.parameter("pivot", 0.05, "m", minimum=0.0, description="distance of the hinges from the shaft's axis")
    stiffness = m.parameter("stiffness", 8e5, "N/m", minimum=0.0, description="stiffness of each spring")
    damping = m.parameter("damping", 4e4, "N.s/m", minimum=0.0, description="damping of each spring")
    rest = m.parameter("rest", 0.5, "m", minimum=0.0, description="length of a spring without force")
    g = m.parameter("g", 9.81, "m/s2", description="gravity, along -z")
    turn = m.start("angle", 0.0, "rad", rate=2 * ca.pi, rate_name="angular_velocity", description="angle of the shaft")
    droop = m.start(
        "rod_angle", ca.pi / 6, "rad", rate_name="rod_rate", description="angle of both rods below the horizontal"
    )
    height = m.start(
        "position", 0.5, "m", rate_name="velocity", description="height of the slider's centre on the shaft"
    )

    m_rod = density * width**2 * l
    across, along = m_rod * (l**2 + width**2) / 12, m_rod * width**2 / 6
    shaft = m.spatial_body(
        "shaft",
        mass=m_rod,
        inertia=(across, across, along),
        center=(0, 0, l / 2),
        position=(0, 0, l / 2),
        attitude=about((0, 0, 1), turn),
    )
    slider = m.spatial_body(
        "slider",
        mass=m_slider,
        inertia=(m_slider * side**2 / 6,) * 3,
        position=(0, 0, height),
        attitude=about((0, 0, 1), turn),
    )
    bearing = m.spatial_revolute("bearing", m.spatial_ground.at(), shaft.at(), axis=(0, 0, 1))
    guide = m.spatial_prismatic("guide", shaft.at(), slider.at(), axis=(0, 0, 1))
    m.tie(turn, bearing.free)
    m.tie(height, guide.free)

    # A rod with its ball, along the x axis of its frame. The second rod hangs on the other side of the shaft.
    mass = m_rod + m_ball
    center = (m_rod / 2 + m_ball) * l / mass
    swung = across + m_rod * (center - l / 2) ** 2 + m_ball * (l - center) ** 2
    reach, depth = pivot + center * ca.cos(droop), center * ca.sin(droop)
    for i, outward in enumerate((1, -1), 1):
        rod = m.spatial_body(
            f"rod{i}",
            mass=mass,
            inertia=(along, swung, swung),
            center=(center, 0, 0),
            position=(outward * reach * ca.cos(turn), outward * reach * ca.sin(turn), l - depth),
            attitude=product(about((0, 0, 1), turn if outward > 0 else turn + ca.pi), about((0, 1, 0), droop)),
        )
        hinge = m.spatial_revolute(
            f"hinge{i}",
            shaft.at(outward * pivot, 0, l),
            rod.at(),
            axis=(0, outward, 0),
            second_axis=(0, 1, 0),
        )
        m.tie(droop, hinge.free)
        ends = rod.at(l / 2, 0, 0), slider.at(outward * side / 2, 0, 0)
        m.spring_damper(ends, stiffness=stiffness, damping=damping, rest=rest)
    m.drive(
        bearing, m.input("bearing.torque", "N.m", description="torque on the shaft from the ground, along its axis")
    )
    m.drive(guide, m.input("slider.force", "N", description="force on the slider from the shaft, along its axis"))
    m.gravity(0, 0, -g)
    return m
