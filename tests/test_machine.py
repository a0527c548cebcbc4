"""One machine of gears, belt, rack, cam, stop, blade and springs: the same in both kinds of FMU as in the library."""

import math
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest

import alfmu
from alfmu.fmi.recipe import Recipe


def machine() -> alfmu.Mechanism:
    """A motor drives a cam by a pinion and a belt, and a rack that runs to a stop; a sled on a blade falls."""
    m = alfmu.Mechanism("machine", "Gears, belt, rack, cam and stop", experiment=alfmu.Experiment(0.4, 1e-3))
    motor = m.coordinate("motor_angle", start=0.2, independent=True)
    bodies = {}
    for name, inertia, place in (("motor", 1e-4, (0.0, 0.0)), ("wheel", 2e-3, (0.09, 0.0)), ("cam", 4e-3, (0.3, 0.0))):
        angle = motor if name == "motor" else m.coordinate(f"{name}_angle")
        bodies[name] = m.body(name, mass=0.5, inertia=inertia)
        m.revolute(f"{name}_axle", m.ground.at(*place), bodies[name].at(0, 0), coordinate=angle)
    lever = m.bar("lever", mass=0.2, length=0.1)
    pivot = m.revolute("pivot", m.ground.at(0.38, 0.1), lever.start, coordinate=m.coordinate("lever_angle", start=3.4))
    bar = m.body("bar", mass=0.4)
    guide = m.prismatic("guide", m.ground.at(0.09, -0.06), bar.at(0, 0), coordinate=m.coordinate("run", "m"))
    motor, wheel, cam = (body.at(0, 0) for body in bodies.values())
    m.gear("mesh", motor, wheel, teeth=(20, 40))
    m.belt("belt", wheel, cam, radii=(0.03, 0.03), pretension=50.0)
    m.rack("rack", wheel, guide, radius=0.06)
    u = np.linspace(0, 2 * math.pi, 24, endpoint=False)
    radius = 0.05 + 0.015 * np.sin(u) + 0.003 * np.cos(2 * u)
    m.cam("nose", cam, lever.end, outline=np.array([radius * np.cos(u), radius * np.sin(u)]).T, roller=0.012)
    m.end_stop("buffer", guide, upper=0.06, lower=-0.04, stiffness=2e4, restitution=0.6)
    m.spring_damper((m.ground.at(0.3, 0.3), lever.end), stiffness=20.0, damping=0.5, rest=0.35, name="link")
    m.measure(pivot, guide)
    x, turn = m.coordinate("x", "m", rate=0.5, independent=True), m.coordinate("turn", rate=2.0, independent=True)
    sled = m.body("sled", mass=0.1, inertia=1e-3, pose=(x, m.coordinate("y", "m", start=-0.2), turn))
    m.blade("blade", sled.at(-0.05, 0.0))
    m.drive(m.joints[0], m.input("motor.torque", "N.m", start=0.4))
    m.gravity(0, -9.81)
    return m


WATCHED = (
    *("motor.angle", "pivot.angle", "pivot.angular_velocity", "guide.displacement", "mesh.force", "belt.tension.left"),
    *(
        "rack.force",
        "nose.force",
        "nose.contact.x",
        "buffer.force",
        "buffer.penetration",
        "link.force",
        "link.elongation",
    ),
)


EXPLICIT = {"solver.method": "explicit"}
"""A scene without tangents is traced in half the time."""


@pytest.fixture(scope="module")
def known() -> alfmu.Result:
    outputs = [*WATCHED, "monitor.energy", "monitor.work", "monitor.position_error"]
    return alfmu.simulate(machine(), outputs=outputs, parameters=EXPLICIT)


@pytest.mark.slow
def test_the_machine_works(known):
    """The rack runs into its stop, the cam lifts the lever, and no energy is lost on the way."""
    assert known["buffer.penetration"].max() > 1e-3
    assert known["nose.force"].min() > 0
    assert np.ptp(known["pivot.angle"]) > 0.02
    assert known["monitor.position_error"].max() < 1e-10
    lost = known["monitor.energy"] - known["monitor.energy"][0] - known["monitor.work"]
    assert np.abs(lost).max() < 1e-5 * np.ptp(known["monitor.energy"])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["python", "native"])
def test_both_kinds_of_fmu_give_the_same(known, kind: str, tmp_path: Path):
    recipe = Recipe(machine(), kind=kind, outputs=WATCHED, parameters=EXPLICIT, reference=False)
    path = alfmu.export(recipe, tmp_path / "machine.fmu")
    rows = fmpy.simulate_fmu(str(path), stop_time=0.4, output_interval=1e-3, output=list(WATCHED))
    assert len(rows) == len(known.time)
    for name in WATCHED:
        assert rows[name] == pytest.approx(known[name], abs=1e-9 * max(1.0, np.abs(known[name]).max())), name
    units = {v.name: v.unit for v in fmpy.read_model_description(str(path)).modelVariables}
    assert [
        units[name] for name in ("nose.force", "belt.tension.left", "pivot.angular_velocity", "nose.contact.x")
    ] == [*("N", "N", "rad/s", "m")]


def test_a_mechanism_that_measures_is_written_as_it_is():
    """Equal declarations have one digest, and another curve or radius has another."""
    from alfmu.model.content import content

    one, other = machine(), machine()
    assert content(one) == content(other)
    assert content(one) is not None
    other.relations()[0].radii = (0.03, 0.061)
    assert content(one) != content(other)
    third = machine()
    object.__setattr__(third.relations()[3].curve, "value", third.relations()[3].curve.value + ca.SX(1e-9))
    assert content(one) != content(third)
