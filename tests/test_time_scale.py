"""Mechanisms a thousand times faster and slower: all rates over the time scale, and all forces over its square.

Velocities have an absolute tolerance in rad/s and m/s, so that under error control slower ones take fewer steps.
"""

import casadi as ca
import numpy as np
import pytest
from scenes import sliding

import alfmu


def pendulum() -> alfmu.Mechanism:
    """It swings with viscous and dry friction until it sticks."""
    m = alfmu.Mechanism("pendulum")
    T = m.parameter("T", 1.0, "1")
    th = m.coordinate("th", "rad", start=0.9, independent=True)
    bar = m.bar("bar", mass=1.3, length=0.8)
    m.friction(m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=th), 0.02 / T, coulomb=0.3, radius=0.1)
    m.gravity(0, -9.81 / T**2)
    m.output("place", th, "rad")
    return m


def stopped() -> alfmu.Mechanism:
    """A four-bar whose crank swings between two stops."""
    m = alfmu.Mechanism("stopped")
    T = m.parameter("T", 1.0, "1")
    a = m.coordinate("a", "rad", start=1.0, independent=True)
    b, c = m.coordinate("b", "rad", start=-0.6), m.coordinate("c", "rad", start=1.2)
    one, two, three = (
        m.bar("one", mass=1.0, length=0.4),
        m.bar("two", mass=1.5, length=0.9),
        m.bar("three", mass=0.7, length=0.6),
    )
    A = m.revolute("A", m.ground.at(0, 0), one.start, coordinate=a)
    m.revolute("B", one.end, two.start, coordinate=b)
    D = m.revolute("D", m.ground.at(0.9, 0), three.start, coordinate=c)
    m.revolute("C", two.end, three.end)
    given = {"restitution": 0.6, "creep": 1e-2 / T, "onset": 1e-3}
    m.end_stop("stop", A, upper=1.6, lower=-0.4, stiffness=400.0 / T**2, **given)
    m.gravity(0, -9.81 / T**2)
    m.spring_damper(D, stiffness=2.0 / T**2, damping=0.05 / T, rest=1.0)
    m.output("place", a, "rad")
    return m


def slider_crank() -> alfmu.Mechanism:
    """Its slide rubs, under a torque that depends on time."""
    m = alfmu.Mechanism("slider")
    T = m.parameter("T", 1.0, "1")
    a = m.coordinate("a", "rad", start=0.5, independent=True)
    b, s = m.coordinate("b", "rad", start=-0.7), m.coordinate("s", "m", start=1.0)
    crank, rod, block = (
        m.bar("crank", mass=1.0, length=0.3),
        m.bar("rod", mass=1.5, length=0.9),
        m.body("block", mass=2.0),
    )
    A = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=a)
    m.revolute("B", crank.end, rod.start, coordinate=b)
    slide = m.prismatic("slide", m.ground.at(0, 0), block.at(0, 0), coordinate=s)
    m.revolute("C", rod.end, block.at(0, 0))
    m.gravity(0, -9.81 / T**2)
    m.drive(A, 1.5 * ca.cos(2 * m.time / T) / T**2)
    m.friction(slide, coulomb=0.1, length=0.2)
    m.output("place", a, "rad")
    return m


def belt() -> alfmu.Mechanism:
    """A block that a spring pulls, whose other end moves evenly: it sticks and slips."""
    m, _, slide, x = sliding("belt", joint="slide", place="x", start=0.0, independent=True)
    T = m.parameter("T", 1.0, "1")
    m.friction(slide, coulomb=0.3, static=0.4)
    m.spring_damper(slide, stiffness=20.0 / T**2, damping=0.0, rest=0.2 * m.time / T)
    m.gravity(0, -9.81 / T**2)
    m.output("place", x, "m")
    return m


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "rate"),
    [(pendulum, {"th": 0.5}), (stopped, {"a": 1.0}), (slider_crank, {"a": 3.0}), (belt, {"x": 0.1})],
)
@pytest.mark.filterwarnings("ignore")
def test_the_motion_is_the_same_in_proportion(build, rate):
    m, [(of, at_one)] = build(), rate.items()
    for method, tolerance, within, fewer, more in (
        ("rk4", 1e-6, 1e-9, 0.85, 1.15),
        ("auto", 1e-6, 1e-6, 0.7, 1.4),
        ("auto", 1e-9, 1e-9, 0.6, 1.5),
    ):
        runs = []
        for T in (1.0, 1e-3, 1e3):
            given = {"solver.method": method, "solver.step_size": 0.02 * T, "solver.relative_tolerance": tolerance}
            given |= {"T": T, f"start.{of}_rate": at_one / T}
            runs.append(alfmu.simulate(m, 4 * T, 0.02 * T, parameters=given))
        for run in runs[1:]:
            assert np.abs(run["place"] - runs[0]["place"]).max() <= within, (method, tolerance)
            assert fewer <= run.counters.evaluations / runs[0].counters.evaluations <= more, (method, tolerance)
