"""Parts: a DC motor with gearbox, a PI controller, in a mechanism and as an FMU of its own."""

import math
from functools import cache, partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from oracles.motors import linear
from scenes import initialized, sliding
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import alfmu
from alfmu import DeclarationError, Mechanism, parts

R, L, K, J, WHEEL, U = 0.8, 4e-3, 0.06, 3e-5, 0.02, 24.0
"""Of the motor, its rotor, the wheel that it turns, its voltage."""

DATA = {"resistance": R, "inductance": L, "constant": K, "inertia": J}


def wheel(name: str = "drive", inertia: float = WHEEL) -> tuple[Mechanism, alfmu.Joint]:
    """A wheel on the ground and its bearing."""
    m = Mechanism(name)
    angle = m.coordinate("angle", "rad", independent=True)
    body = m.body("wheel", mass=1.0, inertia=inertia)
    return m, m.revolute("A", m.ground.at(), body.at(), coordinate=angle)


def ran(m: Mechanism, end: float, steps: int = 10, **given: float) -> alfmu.Instance:
    i = initialized(alfmu.Instance(m), {"solver.relative_tolerance": 1e-9}, **given)
    for _ in range(steps):
        i.step(end / steps)
    return i


# Motors -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("inertia", [J, 0.0], ids=["rotor", "no rotor"])
def test_a_motor_with_a_gearbox_on_a_wheel(inertia):
    """The step response of wheel and current, by the matrix exponential; the rotor counts with the ratio's square."""
    ratio, damping = 12.0, 2e-5
    m, joint = wheel()
    gearbox = parts.Gearbox(ratio=ratio, damping=damping)
    parts.dc_motor(
        m, "motor", joint, voltage=m.input("voltage", "V", start=U), gearbox=gearbox, **{**DATA, "inertia": inertia}
    )
    i = ran(m, 0.3)
    whole, b = WHEEL + ratio**2 * inertia, ratio**2 * damping
    matrix = np.array([[-b / whole, ratio * K / whole], [-ratio * K / L, -R / L]])
    w, current = linear(matrix, np.array([0.0, U / L]), np.zeros(2), 0.3)
    assert i.get("wheel.angular_velocity") == pytest.approx(w, rel=1e-7)
    assert i.get("motor.current") == pytest.approx(current, rel=1e-6)
    assert i.get("motor.torque") == pytest.approx(ratio * K * current, rel=1e-6)
    if inertia:
        assert i.get("motor.rotor.angular_velocity") == pytest.approx(ratio * w, rel=1e-7)


def test_numbers_are_parameters():
    m, joint = wheel()
    parts.dc_motor(m, "motor", joint, voltage=U, gearbox=parts.Gearbox(ratio=3.0), **DATA)
    known = {p.name: (p.unit, p.default) for p in m.parameters}
    assert known == {
        "motor.resistance": ("Ohm", R),
        "motor.inductance": ("H", L),
        "motor.constant": ("N.m/A", K),
        "motor.inertia": ("kg.m2", J),
        "motor.ratio": ("1", 3.0),
    }
    i = ran(m, 1.0, motor__resistance=2 * R, motor__ratio=6.0)
    assert i.get("motor.current") == pytest.approx((U - 6.0 * K * i.get("wheel.angular_velocity")) / (2 * R), rel=1e-2)


def test_a_current_without_delay():
    """With no inductance the current is an expression: the limit of small ones."""

    def speed(inductance: float) -> float:
        m, joint = wheel()
        parts.dc_motor(m, "motor", joint, voltage=U, **{**DATA, "inductance": inductance})
        assert len(m.states) == (inductance > 0)
        return ran(m, 2.0).get("wheel.angular_velocity")

    exact = U / K * (1 - math.exp(-(K**2) / R / (WHEEL + J) * 2.0))
    assert speed(0.0) == pytest.approx(exact, rel=1e-7)
    assert speed(1e-6) == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize(("voltage", "works"), [(20.0, True), (-2.0, False)], ids=["lifts", "lowers"])
def test_the_efficiency_of_a_gearbox(voltage, works):
    """A hoist: what the load asks of the motor is more by 1 / efficiency where it is lifted, less where it sinks."""
    ratio, efficiency, load = 10.0, 0.8, 3.0
    m, joint = wheel()
    m.drive(joint, -load)
    gearbox = parts.Gearbox(ratio=ratio, efficiency=efficiency)
    parts.dc_motor(m, "motor", joint, voltage=voltage, gearbox=gearbox, **DATA)
    i = ran(m, 20.0, 4)
    asked = load / (ratio * K)
    assert (i.get("wheel.angular_velocity") > 1.0) == works
    assert i.get("motor.current") == pytest.approx(asked / efficiency if works else asked * efficiency, rel=1e-5)


def test_a_motor_on_a_body_that_moves_keeps_the_angular_momentum():
    """Base, arm and rotor float without forces: what the motor gives to arm and rotor, it takes from the base."""
    ratio, bodies = 20.0, {"base": (2.0, 0.5), "arm": (1.0, 0.1)}
    m = Mechanism("satellite")
    x, y = m.coordinate("x", "m", independent=True), m.coordinate("y", "m", independent=True)
    a, b = m.coordinate("a", "rad", independent=True), m.coordinate("b", "rad", start=0.7, independent=True)
    base = m.body("base", mass=2.0, inertia=0.5, pose=(x, y, a))
    arm = m.body("arm", mass=1.0, inertia=0.1, center=(0.4, 0.0))
    joint = m.revolute("shoulder", base.at(0.3, 0.1), arm.at(), coordinate=b)
    parts.dc_motor(m, "motor", joint, voltage=U, gearbox=parts.Gearbox(ratio=ratio), **DATA)
    i = ran(m, 0.5)
    momentum = J * i.get("motor.rotor.angular_velocity")
    for name, (mass, inertia) in bodies.items():
        px, py, vx, vy, w = (i.get(f"{name}.{of}") for of in ("x", "y", "vx", "vy", "angular_velocity"))
        momentum += inertia * w + mass * (px * vy - py * vx)
    assert abs(i.get("base.angular_velocity")) > 0.1
    assert abs(momentum) < 1e-7 * J * abs(i.get("motor.rotor.angular_velocity")) * ratio
    assert i.get("motor.rotor.angular_velocity") == pytest.approx(
        i.get("base.angular_velocity") + ratio * i.v[3], rel=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hinge", "closed hinge", "hinge without a rotor", "screw"])
def test_a_motor_on_a_joint_in_space(kind):
    """On a leaning axis, and as a spindle of a lift, by the matrix exponential as in the plane."""
    ratio, inertia = 12.0, 0.0 if "without" in kind else J
    m = Mechanism("drive")
    wheel = m.spatial_body("wheel", mass=1.0, inertia=(WHEEL,) * 3, relative=kind != "closed hinge")
    placed = {"coordinate": m.coordinate("angle", "rad")} if kind != "closed hinge" else {}
    pair, whole = {"first": m.spatial_ground.at(), "second": wheel.at(), "axis": (1, 2, 2), **placed}, WHEEL
    if kind == "screw":
        joint = m.spatial_screw("A", lead=0.3, **pair)
        whole += (0.3 / (2 * math.pi)) ** 2
    else:
        joint = m.spatial_revolute("A", **pair)
    parts.dc_motor(
        m, "motor", joint, voltage=U, gearbox=parts.Gearbox(ratio=ratio, damping=2e-5), **{**DATA, "inertia": inertia}
    )
    i = ran(m, 0.3)
    whole, b = whole + ratio**2 * inertia, ratio**2 * 2e-5
    matrix = np.array([[-b / whole, ratio * K / whole], [-ratio * K / L, -R / L]])
    w, current = linear(matrix, np.array([0.0, U / L]), np.zeros(2), 0.3)
    speed = np.array([i.get(f"wheel.angular_velocity.{axis}") for axis in "xyz"])
    assert speed == pytest.approx(w * np.array([1, 2, 2]) / 3, rel=1e-7)
    assert i.get("motor.current") == pytest.approx(current, rel=1e-6)
    if inertia:
        spin = [i.get(f"motor.rotor.angular_velocity.{axis}") for axis in "xyz"]
        assert spin == pytest.approx(ratio * speed, rel=1e-7)


@pytest.mark.slow
def test_a_motor_in_space_keeps_the_angular_momentum():
    """Base, arm and rotor float without forces, about an axis that leans: gyroscopic moments and all."""
    sizes = {"base": (2.0, (0.5, 0.3, 0.4)), "arm": (1.0, (0.1, 0.2, 0.15)), "motor.rotor": (0.0, (J / 2, J / 2, J))}
    m = Mechanism("satellite")
    base = m.spatial_body("base", mass=2.0, inertia=sizes["base"][1])
    arm = m.spatial_body("arm", mass=1.0, inertia=sizes["arm"][1], relative=True)
    angle = m.coordinate("b", "rad", start=0.7, independent=True)
    joint = m.spatial_revolute("shoulder", base.at(0.3, 0.1, 0), arm.at(-0.4, 0, 0), axis=(0, 1, 2), coordinate=angle)
    parts.dc_motor(m, "motor", joint, voltage=U, gearbox=parts.Gearbox(ratio=20.0), **DATA)
    i = ran(m, 0.5)
    momentum, largest = np.zeros(3), 0.0
    for name, (mass, inertia) in sizes.items():
        e = np.array([i.get(f"{name}.e{k}") for k in range(4)])
        turn = Rotation.from_quat(e, scalar_first=True).as_matrix()
        place, speed, w = ([i.get(f"{name}.{of}{axis}") for axis in "xyz"] for of in ("", "v", "angular_velocity."))
        own = turn @ np.diag(inertia) @ turn.T @ np.array(w)
        momentum, largest = momentum + own + mass * np.cross(place, speed), max(largest, np.abs(own).max())
    assert largest > 1e-3
    assert np.abs(momentum).max() < 1e-7 * largest


def test_the_joint_that_carries_a_motor_feels_it():
    """A base that is welded to the ground bears the moment that accelerates wheel and rotor, in both directions."""
    m = Mechanism("bench")
    base = m.body("base", mass=2.0, inertia=0.5)
    m.weld("feet", m.ground.at(), base.at())
    body = m.body("wheel", mass=1.0, inertia=WHEEL)
    joint = m.revolute("A", base.at(), body.at(), coordinate=m.coordinate("angle", "rad", independent=True))
    parts.dc_motor(m, "motor", joint, voltage=U, gearbox=parts.Gearbox(ratio=-5.0), **DATA)
    i = ran(m, 0.01)
    total = WHEEL * i.get("wheel.angular_acceleration") + J * i.get("motor.rotor.angular_acceleration")
    assert abs(total) > 0.1
    assert i.get("feet.moment") == pytest.approx(total, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "flywheel"), [("hinge", 0.0), ("closed hinge", 0.04), ("screw", 0.0), ("screw", 0.04)]
)
def test_a_load_on_a_joint_in_space(kind, flywheel):
    """Viscous friction and a fan brake what turns, by the closed form of w' J = -b w - c w^2."""
    b, c, w0 = 0.05, 0.02, 5.0
    m = Mechanism("brake")
    wheel = m.spatial_body("wheel", mass=2.0, inertia=(WHEEL,) * 3, relative=kind != "closed hinge")
    pair = {"first": m.spatial_ground.at(), "second": wheel.at(), "axis": (1, 2, 2)}
    if kind != "closed hinge":
        pair["coordinate"] = m.coordinate("angle", "rad", rate=w0, independent=True)
    make = partial(m.spatial_screw, lead=0.3) if kind == "screw" else m.spatial_revolute
    joint = make("A", **pair)
    whole = WHEEL + flywheel + (2.0 * (0.3 / (2 * math.pi)) ** 2 if kind == "screw" else 0.0)
    if kind == "closed hinge":
        m.tie(m.start("turned", 0.0, "rad", rate=w0), joint.free)
    parts.load(m, "brake", joint, inertia=flywheel, damping=b, fan=c)
    asked = ["wheel.angular_velocity.x", "brake.torque"]
    found = alfmu.simulate(m, 1.0, 0.05, parameters={"solver.relative_tolerance": 1e-9}, outputs=asked)
    fading = np.exp(-b * found.time / whole)
    w = b * w0 * fading / (b + c * w0 * (1 - fading))
    assert found["wheel.angular_velocity.x"] == pytest.approx(w / 3, rel=1e-7)
    assert found["brake.torque"] == pytest.approx(-b * w - c * w**2, rel=1e-7)


def test_a_load_on_what_slides_says_what_to_do_instead():
    m, _, guide, *_ = sliding("slide", body="cart")
    says = r"the load of brake is on guide; give it a joint .* a revolute or a screw.*; load a slider by its mass, fric"
    with pytest.raises(DeclarationError, match=says):
        parts.load(m, "brake", guide, damping=1.0)


def test_a_motor_feels_the_speed_of_what_a_law_turns():
    """On a base that turns by a law the rotor comes to the no-load speed against the base, not against the ground."""
    m = Mechanism("turntable")
    base = m.body("base", mass=1.0, pose=(0, 0, 3 * m.time + ca.sin(m.time)))
    wheel, th = m.body("wheel", mass=0.0, inertia=WHEEL), m.coordinate("th", "rad", independent=True)
    shaft = m.revolute("shaft", base.at(), wheel.at(), coordinate=th - 3 * m.time - ca.sin(m.time))
    motor = parts.dc_motor(m, "motor", shaft, voltage=U, resistance=0.5, inductance=0.0, constant=K)
    m.output("speed", motor.speed, "rad/s")
    found = alfmu.simulate(m, 2.0, 0.05, parameters={"solver.relative_tolerance": 1e-9})
    relative = found["wheel.angular_velocity"] - 3 - np.cos(found.time)
    assert found["speed"] == pytest.approx(relative, abs=1e-9)
    assert found["motor.torque"] == pytest.approx(K * (U - K * relative) / 0.5, abs=1e-7)
    assert found["wheel.angular_acceleration"] * WHEEL == pytest.approx(found["motor.torque"], abs=1e-7)


def test_a_spindle_moves_a_slide():
    """The ratio of a joint that slides is in rad/m, and its torque becomes a force."""
    lead = 0.005
    m, _, guide, *_ = sliding("axis", body="slide", mass=8.0, independent=True)
    motor = parts.dc_motor(m, "motor", guide, voltage=U, gearbox=parts.Gearbox(ratio=2 * math.pi / lead), **DATA)
    m.output("speed", motor.speed, "rad/s")
    i = ran(m, 0.005)
    r, mass = 2 * math.pi / lead, 8.0
    matrix = np.array([[0.0, r * K / (mass + r**2 * J)], [-r * K / L, -R / L]])
    v, current = linear(matrix, np.array([0.0, U / L]), np.zeros(2), 0.005)
    assert i.get("slide.velocity") == pytest.approx(v, rel=1e-7)
    assert i.get("motor.force") == pytest.approx(r * K * current, rel=1e-5)
    assert i.get("speed") == pytest.approx(r * v, rel=1e-7)


@pytest.mark.slow
def test_a_motor_on_a_loop_in_absolute_coordinates():
    """The speed of a joint that constraints close is that of its bodies: the same motion as with a coordinate."""

    def pressed(coordinates: str) -> float:
        m = alfmu.load("slider_crank", coordinates=coordinates)
        parts.dc_motor(m, "motor", m.joints[0], voltage=U, gearbox=parts.Gearbox(ratio=30.0), **DATA)
        return ran(m, 0.4).get("motor.current")

    assert pressed("absolute") == pytest.approx(pressed("joint"), rel=1e-7)


# Controllers --------------------------------------------------------------------------------------------------------


def controlled(limit: float | None) -> Mechanism:
    m, joint = wheel()
    wanted = m.input("wanted", "rad/s", start=100.0)
    measured = m.rate(m.coordinates[0].q)
    voltage = parts.pi_controller(m, "speed", wanted=wanted, measured=measured, gain=1.5, time=0.2, limit=limit)
    parts.dc_motor(m, "motor", joint, voltage=voltage, **DATA)
    return m


def test_a_controller_without_a_limit():
    """Speed, current and integral part by the matrix exponential."""
    i, inertia = ran(controlled(None), 0.5), WHEEL + J
    P, T, wanted = 1.5, 0.2, 100.0
    matrix = np.array([[0.0, K / inertia, 0.0], [-(P + K) / L, -R / L, 1 / L], [-P / T, 0.0, 0.0]])
    expected = linear(matrix, np.array([0.0, P * wanted / L, P * wanted / T]), np.zeros(3), 0.5)
    found = i.get("wheel.angular_velocity"), i.get("motor.current"), i.get("speed.integral")
    assert found == pytest.approx(expected, rel=1e-6)
    assert i.get("speed.output") == pytest.approx(i.get("motor.voltage"), rel=1e-12)
    assert {p.name: p.unit for p in controlled(None).parameters}["speed.gain"] == "V.s/rad"


def test_a_controller_at_its_limit():
    """Against SciPy; the integral part does not run away while the output is at its limit."""
    P, T, wanted, most = 1.5, 0.2, 100.0, 24.0

    def rate(_, y):
        w, i, z = y
        asked = P * (wanted - w) + z
        u = np.clip(asked, -most, most)
        return [K * i / (WHEEL + J), (u - R * i - K * w) / L, (P * (wanted - w) + u - asked) / T]

    times = np.linspace(0.0, 4.0, 9)
    expected = solve_ivp(rate, (0.0, 4.0), [0.0, 0.0, 0.0], "Radau", times, rtol=1e-9, atol=1e-10).y.T
    i = ran(controlled(most), 1e-6, 1)
    highest = 0.0
    for row in expected[1:]:
        i.step(0.5 - 1e-6 * (row is expected[1]))
        found = i.get("wheel.angular_velocity"), i.get("motor.current"), i.get("speed.integral")
        assert found == pytest.approx(row, rel=1e-4, abs=1e-3)
        highest = max(highest, found[0])
    assert abs(expected[1, 2]) < 2 * P * wanted
    assert highest < 1.1 * wanted
    assert i.get("wheel.angular_velocity") == pytest.approx(wanted, rel=1e-2)


# A motor by itself --------------------------------------------------------------------------------------------------


@cache
def apart(folder: Path) -> tuple[Path, Path]:
    """FMUs of a motor by itself, and of a wheel with its rotor."""
    m = Mechanism("motor", "A DC motor by itself")
    speed, voltage = m.input("speed", "rad/s"), m.input("voltage", "V", start=U)
    parts.dc_motor(m, "motor", speed=speed, voltage=voltage, **{**DATA, "inertia": 0.0})
    load, joint = wheel("load", WHEEL + J)
    load.drive(joint, load.input("torque", "N.m"))
    return tuple(alfmu.export(each, folder / f"{each.name}.fmu", kind="native") for each in (m, load))


class Slave:
    """An FMU that is stepped by hand."""

    def __init__(self, path: Path):
        description = read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=extract(str(path)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=path.stem,
        )
        self.fmu.instantiate()
        self.set("solver.relative_tolerance", 1e-9)
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, name: str, value: float) -> None:
        self.fmu.setReal([self.references[name]], [value])

    def get(self, name: str) -> float:
        return self.fmu.getReal([self.references[name]])[0]


def test_a_motor_coupled_from_outside_comes_to_the_motor_inside(tmp_path):
    """The error of the coupling halves with the communication step."""
    m, joint = wheel()
    parts.dc_motor(m, "motor", joint, voltage=U, **DATA)
    end, whole = 0.1, ran(m, 0.1)
    exact = np.array([whole.get("motor.current"), whole.get("wheel.angular_velocity")])
    errors = []
    for step in (2e-3, 1e-3, 5e-4):
        motor, load = map(Slave, apart(tmp_path))
        for k in range(round(end / step)):
            motor.set("speed", load.get("wheel.angular_velocity"))
            motor.fmu.doStep(k * step, step)
            load.set("torque", motor.get("motor.torque"))
            load.fmu.doStep(k * step, step)
        found = np.array([motor.get("motor.current"), load.get("wheel.angular_velocity")])
        errors.append(np.abs(found / exact - 1).max())
        for each in (motor, load):
            each.fmu.terminate()
            each.fmu.freeInstance()
    assert errors[-1] < 0.01
    assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, abs=0.2)


# What makes no part -------------------------------------------------------------------------------------------------

WRONG = {
    "no joint and no speed": ({}, "takes a joint, or the speed of its shaft, and is given neither"),
    "both": ({"joint": "A", "speed": 1.0}, "and is given both"),
    "a joint by name": (
        {"joint": "A as text"},
        "motor is on 'A'; give it a joint of this mechanism that is a revolute, a prismatic or a screw",
    ),
    "a weld": (
        {"joint": "weld"},
        "motor is on feet; give it a joint of this mechanism that is a revolute, a prismatic or a screw",
    ),
    "a rotor without a joint": ({"speed": 1.0, "inertia": 1.0}, "has no joint, so it can have no rotor"),
    "a gearbox that is none": ({"joint": "A", "gearbox": 5.0}, r"gearbox of motor is 5\.0; give parts\.Gearbox"),
    "an efficiency above 1": (
        {"joint": "A", "gearbox": parts.Gearbox(efficiency=1.2)},
        r"motor\.efficiency is outside",
    ),
    "a resistance below 0": ({"joint": "A", "resistance": -1.0}, r"motor\.resistance is outside"),
    "an acceleration": ({"joint": "A", "voltage": "acceleration"}, "depends on the acceleration of angle"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_makes_no_motor(what):
    given, message = WRONG[what]
    m, joint = wheel()
    base = m.body("base", mass=1.0)
    joints = {"A": joint, "A as text": "A", "weld": m.weld("feet", m.ground.at(), base.at())}
    given = {"voltage": U, **DATA, "inertia": 0.0, **given}
    if "joint" in given:
        given["joint"] = joints[given["joint"]]
    if given["voltage"] == "acceleration":
        given["voltage"] = m.acceleration(m.coordinates[0].q)
    with pytest.raises(DeclarationError, match=message):
        parts.dc_motor(m, "motor", **given)


def test_what_makes_no_controller():
    m, _ = wheel()
    given = {"wanted": 1.0, "measured": 0.0, "gain": 1.0, "time": 1.0}
    with pytest.raises(DeclarationError, match="the units of the controller c are 'V'; give two"):
        parts.pi_controller(m, "c", units="V", **given)
    with pytest.raises(DeclarationError, match="unknown unit 'Volt'"):
        parts.pi_controller(m, "c", units=("rad/s", "Volt"), **given)
    with pytest.raises(DeclarationError, match=r"c\.time is outside"):
        parts.pi_controller(m, "c", **{**given, "time": 0.0})
