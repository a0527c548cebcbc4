"""What a user may declare by mistake: refused at its line, with the name, what was given and what would be right."""

import contextlib
import math
import re
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scenes import hinged, initialized, started

import alfmu
from alfmu import Mechanism
from alfmu.cli import main
from alfmu.model.checks import number
from alfmu.model.declaration import BOOKKEEPING
from alfmu.model.errors import AlfmuWarning, DeclarationError
from alfmu.model.words import nearest, there_is
from alfmu.simulation import with_defaults
from alfmu.view.live import live

HEAD = """
import math

import casadi as ca
import numpy as np

from alfmu import Experiment, Mechanism


def odd() -> Mechanism:
    m = Mechanism("odd")
"""

PENDULUM = """
    l = m.parameter("l", 1.0, "m", minimum=1e-6)
    k = m.parameter("k", 1.0)
    u = m.input("u", "N.m")
    th = m.coordinate("th", "rad", start=0.5, independent=True)
    rod = m.bar("rod", mass=1.0, length=l)
    A = m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th)
"""
"""What most mistakes are made beside."""


@pytest.fixture
def declare(tmp_path, monkeypatch):
    """`declare(lines)` is the path of a file with a pendulum and these lines, and the number of the first of them."""
    monkeypatch.chdir(tmp_path)

    def write(lines: str, head: str = HEAD + PENDULUM) -> tuple[Path, int]:
        path = Path("odd.py")
        path.write_text(head + textwrap.indent(lines, "    ") + "\n    return m\n", encoding="utf-8")
        return path, head.count("\n") + 1

    return write


NUMBERS = [
    # NaN and infinity, and where they come from.
    ("m.force(rod.at(math.sin(th), 0), 1.0)", r"x of rod.at\(\) is nan; .* use ca.sin instead of math.sin"),
    ('m.bar("b", mass=1.0, length=math.sqrt(l))', "the length of b is nan; .* use ca.sqrt instead of math.sqrt"),
    ("m.drive(A, u * math.cos(th))", "the effort on A contains nan; .* use ca.cos instead of math.cos"),
    # Tables of CasADi, which no scene can hold.
    (
        'm.drive(A, ca.interpolant("t", "linear", [[0.0, 1]], [0.0, 1])(th))',
        "the effort on A calls a function of CasADi",
    ),
    (
        'm.output("o", ca.interpolant("t", "bspline", [[0.0, 1, 2, 3]], [0.0, 1, 4, 9])(th), "1")',
        "output o calls a .*pw_lin",
    ),
    ('m.bar("b", mass=float("nan"), length=l)', "the mass of b is nan; give a finite number; .* such as ca.sin"),
    ('m.bar("b", mass=float("inf"), length=l)', "the mass of b is inf; give a finite number$"),
    ('m.bar("b", mass=1.0, length=1 / (l - 1))', "the length of b is inf at the defaults"),
    ("m.gravity(0, -math.inf)", "gravity is -inf"),
    ('m.parameter("p", math.nan)', "the default of p is nan"),
    ('m.parameter("p", 1.0, minimum=math.nan)', "the minimum of p is nan"),
    ('m.parameter("p", 1.0, minimum=2, maximum=0)', "the minimum 2 of p is above its maximum 0"),
    ('m.input("v", "N", start=math.nan)', "the start of v is nan"),
    ('m.coordinate("x", "m", start=math.inf)', "the start of x is inf"),
    # Texts and other things for numbers.
    ('m.parameter("p", "1")', "the default of p is '1'; give a number"),
    ('m.parameter("p", None)', "the default of p is None; give a number"),
    ('m.parameter("p", l)', "the default of p is an expression; give a number"),
    ('m.bar("b", mass="1", length=l)', "the mass of b is '1'; give a number or an expression"),
    ('m.bar("b", mass=1j, length=l)', "the mass of b is 1j; give"),
    ('m.bar("b", mass=ca.MX.sym("x"), length=l)', "the mass of b is the symbol x; give"),
    ('m.bar("b", mass=np.array([1.0, 2.0]), length=l)', "the mass of b is a ndarray; give"),
    ('m.output("o", ca.vertcat(th, th))', "output o has 2 entries; give one"),
    ('m.output("o", "th")', "output o is 'th'; give a number or an expression"),
    ('m.body("b", mass=1.0, center=0.5)', "the center of b is 0.5; give two"),
    ('m.body("b", mass=1.0, pose=(0.0, 0.0))', "the pose of b is 2 numbers; give three"),
    (
        'm.spatial_body("b", mass=1.0, inertia=(1, 1, 1), attitude=(1, 0, 0))',
        "the attitude of b is 3 numbers; give four",
    ),
    ('m.spatial_body("b", mass=1.0, inertia=(1, 1, 1), attitude=(0, 0, 0, 0))', "the attitude of b is zero"),
    ('m.spatial_body("b", mass=1.0, inertia=1.0)', "the inertia of b is 1.0; give three"),
    ('m.spatial_revolute("J", m.spatial_ground.at(), m.spatial_ground.at(), axis="z")', "the axis 'z' of J has no dir"),
    # Sizes that no body has.
    ('m.bar("b", mass=-1.0, length=l)', "the mass of b is -1 kg; it must not be negative"),
    ('m.bar("b", mass=k - 3, length=l)', "the mass of b is -2 kg; it must not be negative"),
    ('m.body("b", mass=1.0, inertia=-2.0)', "the inertia of b is -2 kg.m2; it must not be negative"),
    ('m.spatial_body("b", mass=-1.0, inertia=(1, 1, 1))', "the mass of b is -1 kg"),
    ('m.bar("b", mass=1.0, length=-1.0)', "the length of b is -1 m; it must be above zero"),
    ('m.distance("d", m.ground.at(), rod.end, length=0.0)', "the length of d is 0 m; it must be above zero"),
]

SYMBOLS = [
    ('m.revolute("B", m.ground.at(u, 0), rod.end)', "joint B uses is in m, and the input u in N.m; give one in m"),
    (
        'm.revolute("B", m.ground.at(2 * u, 0), rod.end)',
        "the input u is in N.m, and an input that prescribes motion is in m, rad or 1",
    ),
    (
        'm.revolute("B", m.ground.at(m.rate(th), 0), rod.end)',
        "depends on the rate of th; .* parameters, coordinates, time and inputs",
    ),
    ('m.body("b", mass=1.0, pose=(m.rate(th), 0.0, 0.0))', "the pose of b depends on the rate of th"),
    ('m.bar("b", mass=1.0, length=1 + m.time)', "length of b depends on time; .* expression in parameters$"),
    ('m.bar("b", mass=1 + m.time, length=l)', "mass of b depends on time; .* expression in parameters$"),
    ("m.motion(A, th)", "the motion of A depends on the coordinate th; .* parameters, time and inputs"),
    ("m.motion(A, u)", "the motion of A is in rad, and the input u in N.m"),
    ('m.motion("B", m.time)', "has no joint B"),
    ("m.motion(A, 0.5 + m.time); m.motion(A, 0.5)", "A has a motion already"),
    (
        'b = m.bar("b", mass=1.0, length=l); m.motion(m.revolute("B", rod.end, b.start, coordinate=2 * m.time), 0.0)',
        "the coordinate of B already prescribes",
    ),
    ("m.motion(A, m.time)", "the motion of A is in rad, and time in s; give one in rad"),
    ("m.motion(A, 2 * m.time)", r"the start th is 0.5 rad \(28.65 deg\), and its motion has 0 rad at t = 0; leave the"),
    (
        'm.motion(m.coordinate("x", "rad", rate=0.5, independent=True), k * m.time)',
        "the start rate of x is 0.5 rad/s, and its motion has 1 rad/s",
    ),
    ('m.motion(m.coordinate("x", "1"), m.time)', r"x has no unit; motion\(\) takes a coordinate in m or rad"),
    ('m.input("w", "rad", derivatives=3)', "the derivatives of w is 3; give 0, 1 or 2"),
    ('m.input("w", "rad", order=0.5)', "the order of w is 0.5; give 0, 1 or 2"),
    ('m.input("w", "rad", jump=0)', "the jump of w is 0 rad; it must be above zero"),
    ('m.input("w", "N", derivatives=1)', "w is in N; give a displacement in m, rad or 1"),
    (
        'm.bar("b", mass=1 + th, length=l)',
        "mass of b depends on the coordinate th; it must .* expression in parameters$",
    ),
    ("m.gravity(0, -9.81 * u)", "gravity depends on the input u"),
    ("m.spring_damper(A, stiffness=1.0, rest=u)", "the rest of the spring at A is in rad, and the input u in N.m"),
    ("m.kinetic_energy(m.rate(th) ** 2 * u)", "a kinetic energy depends on the input u"),
    ('m.constraint("c", l - 1)', "constraint c depends on no coordinate"),
    ('m.coordinate("x", "m", start=m.time)', "the start of x depends on time"),
    ("m.drive(A, m.acceleration(th))", "the effort on A depends on the acceleration of th"),
    (
        'm.bar("b", mass=1.0, length=ca.SX.sym("L"))',
        "the length of b depends on L, which this mechanism does not declare",
    ),
    ('m.bar("b", mass=1.0, length=Mechanism("o").parameter("L", 1.0, "m"))', "depends on L, which this mechanism does"),
]

UNITS = [
    ('m.drive(A, m.input("f", "N"))', "the effort on A is in N.m, and the input f in N; give one in N.m"),
    ('m.drive(A, -m.input("f", "N"))', "the effort on A is in N.m, and the input f in N"),
    ('m.torque(rod, m.input("f", "N"))', "the torque on rod is in N.m, and the input f in N"),
    ("m.force(rod.end, u)", "the force on rod is in N, and the input u in N.m"),
    ("m.generalized_force(th, l)", "the generalised force along th is in N.m, and the parameter l in m"),
    (
        'm.spring_damper(A, stiffness=m.parameter("s", 1.0, "N/m"))',
        "stiffness .* in N.m/rad, and the parameter s in N/m",
    ),
    ('m.friction(A, m.parameter("s", 1.0, "N.s/m"))', "viscous coefficient of friction of A is in N.m.s/rad"),
    ("m.spring_damper(A, rest=l)", "the rest of the spring at A is in rad, and the parameter l in m"),
    ('m.bar("b", mass=l, length=l)', "the mass of b is in kg, and the parameter l in m"),
    ('m.gravity(0, -m.parameter("g", 9.81, "m/s"))', "gravity is in m/s2, and the parameter g in m/s"),
    ('m.prismatic("G", rod.end, m.body("b", mass=1.0).at(), coordinate=th)', "coordinate of G, a prismatic, is in m"),
    ('m.coordinate("x", "kg")', "x is in kg; give a displacement in m, rad or 1"),
    ('m.constraint("c", th, "N")', "constraint c is in N; give a displacement in m, rad or 1"),
    ('m.input("v", "Nm")', "v: unknown unit 'Nm'; did you mean N.m?"),
    ('m.parameter("p", 1.0, "kg m2")', "did you mean kg.m2?"),
    ('m.parameter("p", 1.0, "m/s^2")', "did you mean m/s2?"),
    ('m.parameter("p", 1.0, "deg")', r"the unit 'deg' is for display alone; give rad \(1 rad is 57.2958 deg\)"),
    ('m.parameter("p", 1.0, "furlong")', "unknown unit 'furlong'; use one of: 1, s"),
    ('m.parameter("p", 1.0, None)', "unknown unit None"),
]

KINDS = [
    # What a call lacks, or does not know.
    (
        'm.bar("b")',
        r"odd: bar\(\) of b lacks mass and length; it takes name, mass and length, and may take pose and betw",
    ),
    ("m.motion(A)", r"motion\(\) of A lacks law; it takes of and law, and may take switch"),
    ("m.friction(A)", "the friction of A has no coefficient; give viscous or coulomb"),
    ('m.bar("b", mass=1.0, lenght=1.0)', r"bar\(\) of b takes no lenght; did you mean length\?"),
    ('m.bar("b", 1.0, 1.0)', r"bar\(\) of b lacks mass and length"),
    ("m.gravity(0, 0, 0, 0)", r"gravity\(\) takes x, y and z in this order, and is given 4 values"),
    ("m.motion(A, 0.5, switch='no')", r"motion\(\) of A: switch is 'no'; give True or False"),
    ("m.draw(at=3)", r"draw\(\): at is 3; give numbers by their names"),
    ("m.force(rod.end, z=None)", r"the force on rod, a body in the plane, has a part along z; leave z out"),
    ('m.start("s", rate_name=math.nan)', r"start\(\) of s: rate_name is nan; give a text, or leave it out"),
    ("rod.at(1, 2, 3)", r"rod: at\(\) takes x and y in this order, and is given 3 values"),
    (
        "Mechanism()",
        r"Mechanism\(\) lacks name; it takes name, and may take description, sketch, experiment and author",
    ),
    ("Experiment(stop_time=None)", r"stop_time of an experiment is None; give a number"),
    ("Experiment(stop=3.0)", r"Experiment\(\) takes no stop; did you mean stop_time\?"),
    ('m.revolute("B", rod, m.ground.at())', r"joint B takes a point of rod, not the body; use rod.at\(...\)"),
    ("m.force(rod, 1.0)", r"force\(\) takes a point of rod, not the body"),
    ('m.revolute("B", (0, 0), rod.end)', r"joint B joins bodies in the plane; .*, not \(0, 0\)"),
    ('m.revolute("B", m.spatial_ground.at(), rod.end)', "joint B joins bodies in the plane"),
    ('m.drive("A", 1.0)', r"drive\(\) takes a joint, as revolute\(\) and prismatic\(\) return it, not 'A'"),
    ("m.drive(th, 1.0)", "takes a joint, .*, not the symbol th"),
    ('m.spring_damper("A", stiffness=1.0)', "takes a joint, or a pair of markers, not 'A'"),
    ("m.spring_damper((rod.start, rod.end, rod.end), stiffness=1.0)", "takes a joint, or a pair of markers"),
    ('m.torque("rod", 1.0)', r"torque\(\) takes a body, as body\(\) and bar\(\) return it, not 'rod'"),
    ('m.clutch("C", m.ground, "rod")', "clutch C takes a body, .*, not 'rod'"),
    ('m.bar("b", mass=1.0, length=l, between=((0, 0), rod.end))', r"bar b joins bodies in the plane.* not \(0, 0\)"),
    ('m.revolute("B", rod.end, m.bar("b", mass=1.0, length=l).start, coordinate="th")', "coordinate of B, .* is 'th'"),
    ("m.drive(Mechanism('o').weld('W', rod.start, rod.end), 1.0)", "a body of another mechanism"),
    ('m.rate("th")', r"'th' is not a coordinate of this mechanism; give the symbol that coordinate\(\) returned"),
    ('m.tie("th", th)', r"tie\(\) takes a symbol that start\(\) returned, not 'th'"),
    (
        'm.coordinate("x", "rad", start=1.0, rate=2.0)',
        "only an independent coordinate has a start rate; .*independent=True",
    ),
    (
        'm.coordinate("x", "rad", start=2 * k, independent=True)',
        "the start of the independent coordinate x is a number",
    ),
    ('Mechanism("two", experiment=3.0)', "two: its experiment is 3.0; give an Experiment"),
    ("Experiment(stop_time=-1.0)", "stop_time of an experiment is -1.0 s; it must be above zero"),
    ("Experiment(step_size=math.nan)", "step_size of an experiment is nan"),
]

TEXTS = [
    ('m.parameter("a\\0", 1.0)', r"the name of a parameter has the character '\\x00' at place 2"),
    ('m.parameter("a\\ud800", 1.0)', r"has the character '\\ud800'"),
    ('m.parameter("a" * 300, 1.0)', "the name of a parameter has 300 characters .*; give at most 200"),
    ('m.parameter("größe", 1.0)', "'größe' cannot be a parameter; use words joined by dots, of the letters A to Z"),
    ('m.parameter("my l", 1.0)', "'my l' cannot be a parameter"),
    ("m.parameter(5, 1.0)", "the name of a parameter is 5; give a text"),
    ('m.parameter("p", 1.0, description="a\\x07b")', r"the description of p has the character '\\x07' at place 2"),
    ('m.input("v", "N", description=None)', "the description of v is None; give a text"),
    ('Mechanism("two", "a\\0b")', "two: its description has the character"),
    ('Mechanism("two", author="\\ud800")', "two: its author has the character"),
    ('Mechanism("größe")', "'größe' cannot name a mechanism; use letters, digits and underscores"),
    ('Mechanism("a" * 300)', "the name of a mechanism has 300 characters"),
    ("Mechanism(5)", "the name of a mechanism is 5; give a text"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("line", "says"), [*NUMBERS, *SYMBOLS, *UNITS, *KINDS, *TEXTS])
def test_a_mistake_is_named_at_its_line(declare, line, says):
    path, at = declare(line)
    with pytest.raises(alfmu.DeclarationError, match=says) as caught:
        alfmu.load(path)
    assert str(caught.value).startswith(f"odd.py, line {at}: ")
    assert "\n" not in str(caught.value)


PYTHON = [
    ("if th > 0:\n    pass", "an if, .* asks whether an expression is true.* ca.if_else"),
    ('m.bar("b", mass=1.0, length=max(l, 0.5))', "ca.fmax"),
    ("for _ in range(l):\n    pass", r"a symbol is not a whole number.* def odd\(n: int = 3\)"),
    ('m.revolut("B", 1, 2)', "no attribute 'revolut'; did you mean revolute"),
    ("np.isfinite(th)", "functions of NumPy .* are not for symbols; use those of CasADi"),
]


@pytest.mark.parametrize(("line", "says"), PYTHON)
def test_what_python_says_of_symbols_is_explained(declare, line, says):
    path, at = declare(line)
    with pytest.raises(alfmu.InputError, match=says) as caught:
        alfmu.load(path)
    assert str(caught.value).startswith(f"odd.py, line {at}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("called", "instead"), [("sin(th)", "sin"), ("arctan2(th, l)", "atan2"), ("where(l > 1, l, k)", "if_else")]
)
def test_a_function_of_numpy_is_refused_with_that_of_casadi(declare, called, instead):
    """Where CasADi warns that its answer will change; others make expressions of NumPy's functions, which are right."""
    path, at = declare(f"np.{called}")
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        np.sin(ca.SX.sym("x"))
    if not seen:
        assert alfmu.load(path).name == "odd"
        return
    with pytest.raises(alfmu.InputError, match=f"line {at}: .*use ca.{instead} instead of np."):
        alfmu.load(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEAD, r"odd\(\) returns nothing; end it with `return m`"),
        (HEAD + "    return 3\n", r"odd\(\) returns a int, no Mechanism"),
        (HEAD.replace("odd()", "odd(n)") + "    return m\n", r"odd\(\) takes n, which has no default; .*--option n="),
    ],
)
def test_a_function_that_declares_no_mechanism_says_so(tmp_path, text, says):
    path = tmp_path / "odd.py"
    path.write_text(text)
    with pytest.raises(alfmu.InputError, match=says):
        alfmu.load(path)


DERIVED = [
    (
        'm.input("A.force.x", "N")',
        r"'A.force.x' is the name of a derived variable \(force along x on rod from ground\).*take another name",
    ),
    ('m.output("rod.angle", th, "rad")', "'rod.angle' is the name of a derived variable"),
    ('m.lock(A)\nm.output("A.locking_torque", u, "N.m")', "'A.locking_torque' is the name of a derived variable"),
    ('m.lock(A)\nm.output("A.impulse", 0.0, "N.m.s")', "'A.impulse' is the name of a derived variable"),
    (
        'm.lock(A)\nm.compliances()\nm.parameter("A.compliance.locked", 1.0)',
        "'A.compliance.locked' is the name of a derived variable",
    ),
    ('m.bar("b", mass=1.0, length=l)', "nothing places b"),
    (
        'm.motion(A, 0.5)\nm.input("A.torque", "N.m")',
        "'A.torque' is the name of a derived variable .torque that the motion of A takes",
    ),
    ('m.input("w", "rad", derivatives=1)', "the input w has derivatives and prescribes no motion"),
]


@pytest.mark.parametrize(("lines", "says"), DERIVED)
def test_what_the_whole_shows_is_said_with_the_line(declare, lines, says):
    path, first = declare(lines)
    with pytest.raises(alfmu.DeclarationError, match=says) as caught:
        alfmu.derive(alfmu.load(path))
    assert f"odd.py, line {first + lines.count(chr(10))})" in str(caught.value)


MASSLESS = [
    ('b = m.bar("b", mass=0.0, length=l)\nm.revolute("B", rod.end, b.start, coordinate=m.coordinate("x"))', "x", "b"),
    ('m.body("b", mass=1.0, pose=(m.coordinate("x", "m"), 0.0, m.coordinate("a")))', "a", "b"),
    ('m.spatial_body("b", mass=0.0, inertia=(0, 0, 0))', "b_x, b_y, b_z", "b"),
]


@pytest.mark.parametrize(("lines", "motion", "body"), MASSLESS)
def test_massless_bodies_that_nothing_holds_are_named(declare, lines, motion, body):
    path, first = declare(lines)
    says = rf"motion along {motion} has no mass and no constraint.*it moves {body} \(odd.py, line {first}\)"
    with pytest.raises(alfmu.AssemblyError, match=says):
        alfmu.derive(alfmu.load(path))


def test_a_coordinate_that_moves_nothing_is_named(declare):
    path, _ = declare('m.coordinate("idle")')
    with pytest.raises(alfmu.AssemblyError, match=r"motion along idle .* it moves no body"):
        alfmu.derive(alfmu.load(path))


def test_a_mass_is_not_negative_later_either():
    m = alfmu.Mechanism("free")
    mass = m.parameter("mass", 1.0, "kg")
    x = m.coordinate("x", "m", independent=True)
    m.body("b", mass=mass, pose=(x, 0.0, 0.0))
    with pytest.raises(alfmu.InputError, match=r"mass = -1 kg is outside \[0.0, inf\]"):
        alfmu.simulate(m, 0.1, 0.1, parameters={"mass": -1.0})


HINTS = [
    ('m.coordinate("x", start=30.0, independent=True)', "start.x is 30 rad, 4.8 turns; if degrees .* give 0.523599"),
    ('m.start("x", -90.0)', "start.x is -90 rad"),
    ('m.coordinate("x", start=-34.0)', "the guess of x is -34 rad, 5.4 turns; if degrees were meant, give -0.593412"),
    ('m.parameter("p", 90.0, "rad")', "the default of p is 90 rad, 14.3 turns; if degrees were meant, give 1.5708"),
    ('m.parameter("p", 500.0, "m")', "the default of p is 500 m; if millimetres were meant, give 0.5"),
    ('m.bar("b", mass=1.0, length=120.0)', "the length of b is 120 m"),
    ("m.force(rod.at(350.0, 0.0), 1.0)", r"a point of rod that force\(\) uses is 350 m"),
]


@pytest.mark.parametrize(("line", "says"), HINTS)
def test_what_looks_like_another_unit_is_hinted_at(declare, line, says):
    path, at = declare(line)
    with pytest.warns(AlfmuWarning, match=says) as seen:
        alfmu.load(path)
    assert (seen[0].filename, seen[0].lineno) == ("odd.py", at)


def test_a_hint_is_one_line_and_the_run_goes_on(declare, capsys):
    path, _ = declare('m.parameter("p", 500.0, "m")')
    assert main(["simulate", str(path), "--stop-time", "0.02"]) == 0
    err = capsys.readouterr().err
    assert err == "alfmu: warning: odd: the default of p is 500 m; if millimetres were meant, give 0.5\n"


def test_what_the_command_line_sets_is_hinted_at_too(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    arguments = ["simulate", "particle_on_circle", "--stop-time", "0.02", "--set", "start.angle=90", "--set", "rho=500"]
    assert main(arguments) == 0
    degrees, millimetres = capsys.readouterr().err.splitlines()
    assert degrees.startswith("alfmu: warning: particle_on_circle: start.angle is 90 rad, 14.3 turns")
    assert millimetres == "alfmu: warning: particle_on_circle: rho is 500 m; if millimetres were meant, give 0.5"


@pytest.mark.slow
def test_the_command_line_says_a_mistake_in_one_line(declare):
    path, at = declare('m.revolute("B", m.ground.at(0.3 * m.rate(th), 0), rod.end)')
    command = [sys.executable, "-m", "alfmu.cli", "simulate", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    assert done.stderr.startswith(
        f"alfmu: odd.py, line {at}: odd: a point of ground that joint B uses depends on the rate of th"
    )
    assert done.stderr.count("\n") == 1


# Near misses ----------------------------------------------------------------------------------------------------------


def test_the_nearest_names_are_offered_a_handful():
    names = [f"link{i}.{what}" for i in range(1, 9) for what in ("x", "y", "angle", "force.x")]
    assert nearest("link3.angel", names)[0] == "link3.angle"
    assert len(nearest("link.angle", names)) <= 3
    assert there_is("link3.angel", names).startswith("did you mean link3.angle")
    assert there_is("nonsense", names) == "it has link1.x, link1.y, link1.angle, link1.force.x, link2.x and 27 more"
    assert there_is("nonsense", []) == "it has none"
    assert there_is("nonsense", ["a", "b"]) == "it has a, b"


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["simulate", "four_bar", "--set", "A.torqe=1"], "did you mean A.torque"),
        (["simulate", "four_bar", "--outputs", "link1.angel"], "did you mean link1.angle"),
        (["simulate", "four_bar", "--outputs", "link1"], "did you mean link1.*?"),
        (["simulate", "four_bar", "--option", "coordinate=joint"], "did you mean coordinates"),
    ],
)
def test_a_misspelt_name_is_answered_by_the_nearest(arguments, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert len(err) < 200


# Assembly -------------------------------------------------------------------------------------------------------------


def hanging(marker: float) -> alfmu.Mechanism:
    """A body on a ball joint, its centre guessed 1 m above it."""
    m = alfmu.Mechanism("hanging")
    b = m.spatial_body("b", mass=1.0, inertia=(1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0))
    m.spherical("S", m.spatial_ground.at(), b.at(0.0, 0.0, marker))
    return m


@pytest.mark.slow
def test_a_loop_that_closes_in_another_configuration_is_warned_of():
    """The joint is above the body: to shift the body by 2 m is a longer way than to turn it."""
    i = alfmu.Instance(hanging(1.0))
    with pytest.warns(
        AlfmuWarning, match=r"hanging: the loops closed far from the guess, .* a nearer .* moved b by 2 m"
    ):
        i.initialize()
    assert i.get("b.z") == pytest.approx(-1.0)
    assert i.moved == pytest.approx({"b": 2.0})


@pytest.mark.slow
def test_an_assembly_on_the_other_side_of_the_guess_is_warned_of_where_it_is_the_only_one():
    """A body whose height is guessed at 1 m, and which only closes at -1 m; a short way is none."""
    for guess, way in ((1.0, 2.0), (-0.2, 0.8), (0.1, 0.2)):
        m = alfmu.Mechanism("under")
        x = m.coordinate("x", "m", independent=True)
        y = m.coordinate("y", "m", start=guess)
        m.body("b", mass=1.0, pose=(x, y, 0.0))
        m.constraint("depth", y + (1.0 if way > 0.2 else 0.1))
        i = alfmu.Instance(m)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            i.initialize()
        said = [str(each.message) for each in told]
        assert i.moved == pytest.approx({"b": way})
        if guess < 1.0:
            assert said == []
            continue
        assert said[0].startswith(
            "under: the loops closed where y is -1 m, guessed as 1 m on the other side of zero, and"
        )


def told_at_the_start(m: alfmu.Mechanism) -> list[str]:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        alfmu.Instance(with_defaults(alfmu.derive(m), {"solver.method": "rk4"})).initialize()
    return [str(each.message) for each in told]


def pantograph(inner: float) -> alfmu.Mechanism:
    """Two bars, and two that make a parallelogram with them: the first of these at -1.7 rad to the first bar."""
    m = alfmu.Mechanism("pantograph")
    lengths = {"first": 0.6, "second": 0.6, "inner": 0.24, "outer": 0.36}
    first, second, short, long = (m.bar(name, mass=0.1, length=each) for name, each in lengths.items())
    m.revolute(
        "O", m.ground.at(), first.start, coordinate=m.coordinate("shoulder", "rad", start=1.46, independent=True)
    )
    m.revolute("B", first.end, second.start, coordinate=m.coordinate("corner", "rad", start=-1.7, independent=True))
    m.revolute("A", first.at(0.24, 0), short.start, coordinate=m.coordinate("a", start=inner))
    m.revolute("D", second.at(0.24, 0), long.start, coordinate=m.coordinate("d", start=1.7 - math.pi))
    m.revolute("P", short.end, long.end)
    return m


@pytest.mark.slow
@pytest.mark.parametrize(("off", "between"), [(0.4, False), (-0.4, False), (math.pi, True), (-3.0, True)])
def test_a_guess_between_two_assemblies_is_warned_of(off, between):
    """Half a turn off in one bar, a pantograph closes as an antiparallelogram, to which its guess is nearer in rad."""
    said = told_at_the_start(pantograph(-1.7 + off))
    if not between:
        assert said == []
        return
    assert len(said) == 1
    found = re.match(
        r"pantograph: the guess lies between two assemblies; in the one taken a is (\S+) rad \((\S+) deg\), guessed as "
        r"(\S+) rad \(\S+ deg\), and in the other, hardly farther from the guess, it is (\S+) rad \(\S+ deg\); give "
        r"start values",
        said[0],
    )
    a, degrees, guess, other = map(float, found.groups())
    assert degrees == pytest.approx(math.degrees(a), rel=1e-3)
    assert guess == pytest.approx(-1.7 + off, abs=1e-4)
    assert math.remainder(other + 1.7, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)
    assert abs(math.remainder(a + 1.7, 2 * math.pi)) > 1.0


def test_of_assemblies_that_no_start_value_tells_apart_there_is_no_other():
    """A rod on a pin, guessed 2 m off, may have any angle."""
    m = alfmu.Mechanism("pinned")
    x, y = m.coordinate("x", "m", start=2.0), m.coordinate("y", "m", start=0.3)
    th = m.coordinate("th", "rad", start=0.1)
    rod = m.body("rod", mass=1.0, inertia=0.1, pose=(x, y, th))
    m.revolute("A", m.ground.at(), rod.at(-0.5, 0.0))
    assert told_at_the_start(m) == []


@pytest.mark.slow
def test_an_assembly_at_its_guess_says_nothing():
    i = initialized(alfmu.Instance(hanging(-1.0)))
    assert i.moved == {"b": 0.0}


def test_info_says_how_far_bodies_moved_and_what_no_start_determines(declare, capsys):
    path, _ = declare(
        'x = m.coordinate("x", "m", start=0.2)\nb = m.body("b", mass=1.0, pose=(x, 0.0, 0.0))\n'
        'y = m.coordinate("y", "m", start=0.1)\nm.body("c", mass=1.0, pose=(y, 0.0, 0.0))\n'
        'm.constraint("same", x - 2.0 * ca.cos(th))'
    )
    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    way = abs(2 * math.cos(0.5) - 0.2)
    assert f"assembly moved b by {way:.3g} m from their guesses" in out
    assert "no start value determines y: their guesses are used" in out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slider_crank", "four_bar", "five_bar", "n_four_bar", "particle_on_circle"])
def test_mechanisms_with_starts_for_all_they_do_are_told_nothing(name):
    """At singular starts as well; their guesses are where they begin."""
    i = started(alfmu.derive(alfmu.load(name)))
    assert i.undetermined() == []
    assert max(i.moved.values()) <= 1e-9


def test_numbers_of_numpy_and_casadi_are_numbers():
    assert number("x", np.float32(0.5)) == 0.5
    assert number("x", np.array([2.0])) == 2.0
    assert number("x", ca.DM(3.0)) == 3.0
    assert number("x", 4) == 4


def test_a_file_that_ends_the_process_is_said(declare):
    path, at = declare("raise SystemExit(3)")
    with pytest.raises(alfmu.InputError, match=f"odd.py, line {at}: SystemExit: 3"):
        alfmu.load(path)


def test_a_name_of_a_recipe_has_an_end():
    with pytest.raises(alfmu.InputError, match=r"name is .* letters, digits and underscores, 200 at most"):
        alfmu.Recipe("five_bar", name="a" * 300)


# Sizes ----------------------------------------------------------------------------------------------------------------


def arm(links: int, tip: float) -> alfmu.Mechanism:
    """A chain in absolute coordinates, the last link of another mass."""
    m = alfmu.Mechanism("arm")
    at = m.ground.at()
    for i in range(links):
        x, y, th = m.coordinate(f"x{i}", "m", start=i + 0.5), m.coordinate(f"y{i}", "m"), m.coordinate(f"th{i}")
        link = m.bar(f"link{i}", mass=tip if i == links - 1 else 1.0, length=1.0, pose=(x, y, th))
        m.revolute(f"J{i}", at, link.start)
        at = link.end
    return m


@pytest.mark.slow
@pytest.mark.parametrize(("links", "method"), [(3, "rk4"), (18, "auto")])
def test_a_mass_below_round_off_of_the_others_is_said(links, method):
    """Up to and beyond 50 coordinates."""
    says = "arm, t = 0 s: the augmented mass matrix is singular; give the massless body a mass"
    with pytest.raises(alfmu.StepError, match=says):
        alfmu.simulate(arm(links, 1e-12), 0.02, 0.02, parameters={"solver.method": method})


@pytest.mark.slow
def test_many_bodies_that_depend_on_each_other_run():
    result = alfmu.simulate(arm(60, 1.0), 0.02, 0.02, outputs=["link59.*"])
    assert result["link59.x"][-1] == pytest.approx(59.5)


@pytest.mark.slow
def test_two_coordinates_for_one_motion_are_named_among_many():
    m = arm(20, 1.0)
    twice = m.coordinate("twice", "m")
    m.body("cart", mass=1.0, pose=(twice + m.coordinate("again", "m"), 0.0, 0.0))
    with pytest.raises(alfmu.AssemblyError, match="the motion along twice, again has no mass and no constraint"):
        alfmu.simulate(m, 0.02, 0.02)


# Doubts about a whole declaration ------------------------------------------------------------------------------------


def masses(*given: float, inertia: float | None = 0.0) -> Mechanism:
    """Discs on hinges beside each other."""
    m = Mechanism("discs")
    for i, mass in enumerate(given):
        disc = m.body(f"disc{i}", mass=mass, center=(0.1, 0.0), inertia=inertia)
        angle = m.coordinate(f"angle{i}", "rad", independent=True)
        m.revolute(f"hinge{i}", m.ground.at(i, 0), disc.at(0, 0), coordinate=angle)
    m.gravity(0, -9.81)
    return m


@pytest.mark.parametrize(
    ("given", "heavy"),
    [
        ((500.0, 0.2, 0.05), "disc0 is 500 kg, 2500 times that of any other body; if grams were meant, give 0.5"),
        ((0.3, 250.0), "disc1 is 250 kg, 833 times that of any other body; if grams were meant, give 0.25"),
        ((500.0, 0.002), "disc0 is 500 kg, 250000 times that of any other body; if grams were meant, give 0.5"),
        ((500.0, 200.0, 50.0), ""),  # a machine
        ((1000.0, 10.0, 1e-3), ""),  # a flywheel, a ram and a light rod
        ((5.0, 1e-3), ""),  # no more than what a hand lifts
        ((1e6, 0.1), ""),  # in grams it would be as odd
        ((500.0,), ""),
    ],
)
def test_a_mass_in_grams_is_doubted(given, heavy, recwarn):
    m = masses(*given)
    if not heavy:
        alfmu.derive(m)
        assert not recwarn.list
        return
    with pytest.warns(AlfmuWarning, match=re.escape(heavy)):
        alfmu.derive(m)


def test_a_body_that_turns_without_an_inertia_is_doubted(recwarn):
    with pytest.warns(AlfmuWarning, match="disc0 turns and has a mass but no inertia; give inertia="):
        alfmu.derive(masses(1.0, inertia=None))
    recwarn.clear()
    alfmu.derive(masses(1.0, inertia=0.0))
    m = Mechanism("cart")  # which slides
    cart = m.body("cart", mass=1.0)
    m.prismatic("rail", m.ground.at(0, 0), cart.at(0, 0), coordinate=m.coordinate("x", "m", independent=True))
    m.gravity(0, 0)
    alfmu.derive(m)
    assert not recwarn.list


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"stiffness": 5.0, "rest": 0.1}, "joins two points that A keeps together, so that it has no direction"),
        ({"stiffness": 5.0}, ""),
        ({"stiffness": -5.0}, "the stiffness of the spring between two points is -5, so it pushes away from rest"),
        ({"damping": -1.0}, "the damping of the spring between two points is -1, so it drives"),
    ],
)
def test_springs_that_do_what_nobody_expects_are_doubted(given, said, recwarn):
    m = Mechanism("sprung")
    rod = m.bar("rod", mass=1.0, length=1.0)
    A = m.revolute("A", m.ground.at(0, 0), rod.end, coordinate=m.coordinate("th", independent=True))
    m.spring_damper((rod.end, m.ground.at(0, 0)), **given)
    m.spring_damper(A, stiffness=5.0, damping=1.0, rest=0.1)
    m.gravity(0, -9.81)
    alfmu.derive(m)
    assert len(recwarn) == bool(said)
    assert all(said in str(each.message) for each in recwarn)


def test_a_length_is_doubted_once(recwarn):
    m = Mechanism("long")
    rod = m.body("rod", mass=1.0, inertia=1.0)
    warnings.simplefilter("always", AlfmuWarning)
    m.revolute("A", m.ground.at(0, 0), rod.at(250.0, 0), coordinate=m.coordinate("th", "rad", independent=True))
    m.watch("end", rod.at(-250.0, 0))
    m.watch("tip", rod.at(250.0, 1.0))
    m.watch("other", rod.at(300.0, 0))
    assert [str(each.message).partition(" is ")[2] for each in recwarn] == [
        "250 m; if millimetres were meant, give 0.25",
        "300 m; if millimetres were meant, give 0.3",
    ]
    for x in (400.0, 500.0, 600.0):
        m.watch(f"at{x:.0f}", rod.at(x, 0))
    assert len(recwarn) == 3  # of all lengths of a large mechanism


@pytest.mark.parametrize("gravity", [None, (0, 0), (0, -9.81)])
def test_a_mechanism_that_leaves_gravity_open_says_so_once(gravity, caplog):
    name = f"open{gravity is None}{sum(gravity or ())}".replace(".", "_").replace("-", "_")
    m, *_ = hinged(name, weight=0.0, start=0.5, independent=True)
    if gravity is not None:
        m.gravity(*gravity)
    for stop in (0.02, 0.04):
        alfmu.simulate(m, stop)
    said = "bodies have masses and no gravity acts; declare it by gravity(0, -9.81), or none by gravity(0, 0)"
    assert caplog.messages == ([f"{m.name}: {said}"] if gravity is None else [])


@pytest.mark.slow
def test_every_way_to_use_a_mechanism_tells_of_open_gravity_once(caplog, tmp_path):
    def weighed(name: str) -> Mechanism:
        m, _, A, th = hinged(name, bar="rod", weight=0.0, start=0.5, independent=True)
        m.drive(A, -m.parameter("k", 3.0, "N.m") * th)
        return m

    data = alfmu.simulate(weighed("data"), 0.02, 0.01)

    ways = {
        "exported": lambda m: alfmu.export(m, tmp_path / "exported.fmu", kind="native"),
        "live": lambda m: live(m, alfmu.derive(m), tmp_path / "live.html"),
        "swept": lambda m: alfmu.sweep(m, {"start.th": "0:0.5:2"}, stop_time=0.02, workers=1),
        "rest": alfmu.equilibrium,
        "linear": alfmu.linearize,
        "gradient": lambda m: alfmu.gradient(m, "rod.angle", ["k"], 0.02, 0.01),
        "fitted": lambda m: alfmu.fit(m, data, {"k": 2.0}, columns=["rod.angle"]),
    }
    for name, way in ways.items():
        caplog.clear()
        for _ in range(2):
            with contextlib.suppress(alfmu.ExportError):  # pages need a runtime for browsers
                way(weighed(name))
        (said,) = caplog.messages
        assert said.startswith(f"{name}: bodies have masses and no gravity acts; declare it by gravity(0, -9.81)")


def test_python_tells_of_a_forgotten_independent_as_the_command_line_does(caplog):
    m, *_ = hinged("forgotten", start=0.5)
    for stop in (0.02, 0.04):
        alfmu.simulate(m, stop)
    (said,) = caplog.messages
    assert said.startswith("forgotten: no start value determines th: their guesses are used")
    with pytest.raises(
        alfmu.InputError, match=r"'start.th': th is not independent.*; declare it with independent=True"
    ):
        alfmu.simulate(m, 0.02, parameters={"start.th": 1.0})
    instance = alfmu.Instance(m)
    with pytest.raises(alfmu.InputError, match=r"'start.th_rate': th is not independent"):
        instance.set("start.th_rate", 1.0)


def test_gravity_out_of_the_plane_is_told(caplog):
    m, *_ = hinged("flat", weight=0.0, independent=True)
    m.gravity(0, 0, -9.81)
    alfmu.simulate(m, 0.02)
    assert caplog.messages == [
        "flat: gravity acts along z, out of the plane of all bodies; declare it by gravity(0, -9.81)"
    ]


def test_a_ball_joint_without_a_start_begins_without_a_turn(caplog):
    """It falls like a bar on a hinge that begins level."""
    m = Mechanism("top")
    body = m.spatial_body("body", mass=2.0, inertia=(0.1, 0.1, 0.1), center=(0.3, 0, 0), relative=True)
    e = [m.coordinate(f"e{k}", "1") for k in range(4)]
    m.spherical("S", m.spatial_ground.at(), body.at(), coordinates=e)
    m.gravity(0, 0, -9.81)
    run = alfmu.simulate(m, 0.02)
    assert run["body.z"][0] == 0.0
    assert run["body.az"][0] == pytest.approx(-9.81 * 2 * 0.3**2 / (0.1 + 2 * 0.3**2), rel=1e-12)


def test_the_way_that_an_attitude_turned_in_the_assembly_is_known():
    """A hinge along z between frames whose z axes are at right angles."""
    m = Mechanism("askew")
    half = math.sqrt(0.5)
    body = m.spatial_body("body", mass=1.0, inertia=(1.0, 1.0, 1.0), attitude=(half, half, 0.0, 0.0))
    m.spatial_revolute("A", m.spatial_ground.at(), body.at(), axis=(0, 0, 1))
    m.gravity(0, -9.81)
    i = initialized(alfmu.Instance(m))
    assert i.turned["body"] == pytest.approx(math.pi / 2)


def test_nothing_is_forgotten_where_bodies_in_space_start_at_their_positions(caplog):
    m = Mechanism("flier")
    body = m.spatial_body("body", mass=1.0, inertia=(1.0, 1.0, 1.0), position=(1.0, 2.0, 3.0))
    m.spatial_revolute("A", m.spatial_ground.at(1.0, 2.5, 3.0), body.at(0.0, 0.5, 0.0), axis=(0, 0, 1))
    m.gravity(0, -9.81)
    alfmu.simulate(m, 0.02)
    assert not caplog.messages


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("m.damping(A, 0.1)", "Mechanism odd has no attribute 'damping'; did you mean spring_damper?"),
        ("m.hinge('B')", "Mechanism odd has no attribute 'hinge'; did you mean revolute?"),
        ("m.revolut('B')", "Mechanism odd has no attribute 'revolut'; did you mean revolute or spatial_revolute?"),
        ("rod.ends", "Body rod has no attribute 'ends'; did you mean end?"),
        ("rod.begin", "Body rod has no attribute 'begin'; did you mean start?"),
        ("m.parameter('d', 5.0, minimum=6.0)", "odd: the default 5.0 of d is outside [6.0, inf]"),
        ("m.gravity = (0, -9.81)", "odd: gravity is a method; call it, as m.gravity(...), and do not set it"),
    ],
)
def test_unknown_attributes_suggest_the_nearest_builder(line, meant):
    m = Mechanism("odd")
    names = {"m": m, "rod": m.bar("rod", mass=1.0, length=1.0), "A": None}
    with pytest.raises((AttributeError, DeclarationError), match=f"^{re.escape(meant)}$"):
        exec(line, names)


def test_bookkeeping_of_a_mechanism_is_not_listed_and_becomes_private():
    m = Mechanism("odd")
    listed = {name for name in dir(m) if not name.startswith("_")}
    assert not listed & set(BOOKKEEPING)
    assert {"parameters", "coordinates", "bodies", "joints", "revolute", "gravity"} <= listed
    with pytest.warns(DeprecationWarning, match="closures becomes private in the next version"):
        assert m.closures == tuple(Mechanism.closures.of(m))
