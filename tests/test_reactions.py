"""What joints carry where constraints are redundant; what penalties, copies of a constraint and coordinates change."""

import logging
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from pairs import ALL
from scenes import derived, initialized, made, multipliers, parameters, readings, started
from scipy.spatial.transform import Rotation

import alfmu
from alfmu.equations.specialisation import specialised
from alfmu.model import spatial
from alfmu.model.parts import Joint
from alfmu.runtime.pipeline import with_defaults
from alfmu.simulation import prepared

COORDINATES = ("absolute", "joint", "mixed", "natural")


# Rows of joints alone -------------------------------------------------------------------------------------------------


def bennett_in_space(a: float = 0.3, alpha: float = 0.7, beta: float = 1.2) -> alfmu.Mechanism:
    """Bennett's linkage of three bodies with Euler parameters: 20 rows of four hinges, of which 17 are independent."""
    m = alfmu.Mechanism("bennett_in_space")
    th, b = 1.0, a * np.sin(beta) / np.sin(alpha)
    other = 2 * np.arctan2(np.sin((beta + alpha) / 2) / np.sin((beta - alpha) / 2) * np.cos(th / 2), np.sin(th / 2))
    start = m.start("angle", th, "rad", rate=3.0, rate_name="angular_velocity")
    place, turn, end, axis = ca.SX.zeros(3), ca.SX([1, 0, 0, 0]), m.spatial_ground.at(), (0.0, 0.0, 1.0)
    hinges = []
    for i, (angle, length, twist) in enumerate(((th, a, alpha), (other, b, beta), (-th, a, alpha)), 1):
        turn = spatial.product(turn, spatial.about((0, 0, 1), angle))
        along = spatial.rotation(turn)[:, 0]
        inertia = (0.0, length**2 / 12, length**2 / 12)
        guess = {"position": place + length / 2 * along, "attitude": turn}
        link = m.spatial_body(f"link{i}", mass=1.0, inertia=inertia, center=(length / 2, 0.0, 0.0), **guess)
        hinges.append(m.spatial_revolute(f"hinge{i}", end, link.at(), axis=axis, second_axis=(0.0, 0.0, 1.0)))
        place, turn = place + length * along, spatial.product(turn, spatial.about((1, 0, 0), twist))
        end, axis = link.at(length), (0.0, -np.sin(twist), np.cos(twist))
    place, axis_there = (np.array(ca.DM(x)).ravel() for x in (place, spatial.rotation(turn)[:, 2]))
    m.spatial_revolute("hinge4", m.spatial_ground.at(*place), end, axis=tuple(axis_there), second_axis=axis)
    m.tie(start, hinges[0].free)
    m.gravity(0.0, -9.81)
    return m


def door() -> alfmu.Mechanism:
    """A plate on two hinges, of which one would do: 11 rows, of which 6 are independent."""
    m = alfmu.Mechanism("door")
    plate = m.spatial_body("plate", mass=2.0, inertia=(0.3, 0.2, 0.1), center=(0.4, 0.1, 0.5))
    hinges = [
        m.spatial_revolute(f"hinge{i}", m.spatial_ground.at(0, 0, z), plate.at(0, 0, z), axis=(0, 0, 1))
        for i, z in enumerate((0.1, 1.2), 1)
    ]
    m.tie(m.start("angle", 0.3, "rad", rate=2.0), hinges[0].free)
    m.drive(hinges[0], 1.0)
    m.gravity(2.0, 0.0, -9.81)
    return m


def nearest_to_zero(i: alfmu.Instance, weights: np.ndarray) -> np.ndarray:
    """Multipliers that act as those of (9), by the null space of C': with the smallest sum of (weight times lam)^2."""
    e, p, l = i.equations, parameters(i), i.equations.l
    M, C, f, d = (np.array(x) for x in (e.M(i.q, p), e.C(i.q, p), e.f(i.q, i.v, [], p, i.time), e.d(i.q, i.v, p)))
    matrix = np.block([[M, C.T], [C, np.zeros((l, l))]])
    right = np.concatenate([(f - d).ravel(), np.array(e.xi(i.q, i.v, p)).ravel()])
    some = np.linalg.lstsq(matrix, right, rcond=1e-9)[0][e.n :]
    _, sizes, rows = np.linalg.svd(C.T)
    free = rows[(sizes > 1e-9).sum() :].T
    return some - free @ np.linalg.lstsq(weights[:, None] * free, weights * some, rcond=None)[0]


@cache
def in_space(build) -> alfmu.Equations:
    """With no outputs but what hinges and rows carry."""
    return specialised(alfmu.derive(build()), ["hinge*", "multiplier*"])


@pytest.mark.slow
@pytest.mark.parametrize(("build", "kernel"), [(bennett_in_space, "vm"), (door, "vm"), (door, "oracle")])
def test_the_length_of_euler_parameters_changes_nothing_that_hinges_carry(build, kernel):
    """Least forces and moments over the longest arm, to 1e-12 of the largest; with the other rows, 1e-2 off or more."""
    i = initialized(made(in_space(build), kernel))
    i.step(0.1)
    lam, scale = multipliers(i), np.abs(multipliers(i)).max()
    hinges = np.array([row.name.startswith("hinge") for row in i.equations.rows])
    assert hinges.sum() == {bennett_in_space: 20, door: 10}[build]
    longest = {bennett_in_space: 0.3 * np.sin(1.2) / np.sin(0.7) / 2, door: np.sqrt(0.4**2 + 0.1**2 + 0.7**2)}[build]
    moments = np.array([row.unit == "rad" for row in i.equations.rows])
    exact = nearest_to_zero(i, np.where(hinges, np.where(moments, 1 / longest, 1.0), 0.0))
    assert lam == pytest.approx(exact, abs=1e-12 * scale)
    assert np.abs(nearest_to_zero(i, np.ones(len(lam))) - exact)[hinges].max() >= 1e-2 * scale


@pytest.mark.slow
def test_the_length_of_euler_parameters_has_no_share_by_compliance():
    """Shares of the hinges by their compliances, whatever that of the length of Euler parameters is."""
    m = door()
    m.compliances()
    e = prepared(specialised(alfmu.derive(m), ["hinge*", "multiplier*"]), "vm")
    compliance = 10 ** np.random.default_rng(1).uniform(-1, 1, e.l)
    shares = []
    for length in (1e-2, 1e2):
        compliance[e.lengths] = length
        given = {variable.name: x for variable, x in zip(e.compliances, compliance, strict=True)}
        i = initialized(alfmu.Instance(e), given)
        shares.append(multipliers(i))
    weights = np.sqrt(compliance)
    weights[e.lengths] = 0.0
    for each in shares:
        assert each == pytest.approx(nearest_to_zero(i, weights), abs=1e-11 * np.abs(each).max())


# Penalties ------------------------------------------------------------------------------------------------------------

PENALISED = [("slider_crank", {"coordinates": x}) for x in ("absolute", "natural")] + [
    ("four_bar", {}),
    ("bennett", {}),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"), PENALISED, ids=lambda x: "-".join(x.values()) if isinstance(x, dict) else x
)
def test_a_penalty_runs_as_the_default_does_or_is_refused_by_name(name, options):
    """1 to 1e12 times the largest mass: angles after 0.5 s to 1e-6 rad; from 100 on none is refused."""
    e = prepared(derived(name, **options), "vm")
    usual = started(e).penalty
    usual_angle = None
    for ratio in (1e8, *10.0 ** np.arange(13)):
        penalty, said = ratio * usual.max() / 1e8, ""
        try:
            r = alfmu.simulate(
                e, 0.5, 0.05, parameters={"solver.penalty": penalty, "solver.method": "rk4", "solver.step_size": 0.0025}
            )
        except alfmu.StepError as error:
            said = str(error)
        if ratio < 100 and said:
            assert f"solver.penalty {penalty:g} " in said
            assert "use solver.penalty 0, which scales it with the masses" in said
            continue
        assert not said
        angle = r[next(n for n in r.names if n.endswith("angle"))]
        usual_angle = angle if usual_angle is None else usual_angle
        assert angle == pytest.approx(usual_angle, abs=1e-6), ratio


@pytest.mark.parametrize(("method", "ratio"), [("stiff", 100.0), ("stiff", 1e4), ("explicit", 100.0)])
def test_steps_go_on_without_limits_that_small_penalties_put_far_away(method, ratio):
    """Implicit ones by themselves; in place of explicit ones RK4 goes on, in steps that its error allows."""
    usual, small = (
        alfmu.simulate(derived("four_bar"), 0.5, 0.02, parameters={"solver.method": method, "solver.penalty": x})
        for x in (0.0, ratio)
    )
    assert small["link1.angle"] == pytest.approx(usual["link1.angle"], abs=1e-8)


@pytest.mark.parametrize(("method", "ratio"), [("explicit", 1.0), ("stiff", 1.0), ("auto", 1e18), ("rk4", 1e18)])
def test_a_penalty_that_a_method_cannot_take_is_named(method, ratio):
    with pytest.raises(alfmu.StepError, match=r"solver\.penalty"):
        alfmu.simulate(derived("four_bar"), 0.5, 0.02, parameters={"solver.method": method, "solver.penalty": ratio})


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [10.0, 100.0, 1000.0])
@pytest.mark.parametrize("name", ["four_bar", "five_bar"])
def test_implicit_steps_iterate_as_long_as_a_small_penalty_asks(name, ratio):
    """They were refused, as few iterations do not suit such penalties."""
    found, exact = (
        alfmu.simulate(derived(name), 0.5, 0.02, parameters={"solver.method": "stiff", **own})
        for own in ({"solver.penalty": ratio}, {"solver.relative_tolerance": 1e-9})
    )
    for each in (x for x in found.names if x.endswith(("angle", "velocity", "force.x", "force.y"))):
        assert found[each] == pytest.approx(exact[each], rel=1e-6, abs=1e-6)


def test_an_evaluation_that_did_not_converge_is_told(caplog):
    """Once for a run; nothing where all converged."""
    given = {"solver.penalty": 10.0, "start.angle": 0.3}
    with caplog.at_level(logging.WARNING, "alfmu"):
        alfmu.simulate(derived("five_bar"), 0.1, 0.02, parameters={"start.angle": 0.3})
        assert not caplog.records
        r = alfmu.simulate(derived("five_bar"), 0.1, 0.02, parameters=given)
    assert r.counters.unconverged > 0
    assert [x.getMessage().partition("s: ")[2] for x in caplog.records] == [
        "an evaluation ended without convergence after 10 passes of the multiplier iteration; use solver.penalty 0, "
        "which scales it with the masses, or raise solver.max_iterations"
    ]


# Copies of a constraint -----------------------------------------------------------------------------------------------

COPIED = [
    ("four_bar", {}, {}, {"A.torque": 4.0}),
    ("five_bar", {}, {}, {"A.torque": 3.0, "D.torque": -1.0}),
    *(("slider_crank", {"coordinates": x}, {"l2": 0.5}, {}) for x in COORDINATES),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options", "given", "inputs"), COPIED)
def test_a_constraint_written_up_to_five_times_changes_no_motion(name, options, given, inputs):
    """Through singular positions over 3 s by RK4 in long steps and in short ones, to 1e-12 rad."""
    angles = []
    for copies in (1, 2, 5):
        m = alfmu.load(name, **options)
        row = {c.name: c for c in m.closures}["rod.length" if "natural" in options.values() else "C"]
        for k in range(1, copies):
            alfmu.Mechanism.closures.of(m).append(replace(row, **({"name": f"C{k}"} if isinstance(row, Joint) else {})))
        for step in (0.02, 0.0025):
            parameters = {**given, "solver.method": "rk4", "solver.step_size": step}
            r = alfmu.simulate(m, 3.0, 0.02, parameters=parameters, inputs=inputs)
            angles.append(r[next(n for n in r.names if n.endswith("angle"))])
    assert np.ptp(angles[0]) > 2.9
    assert angles[2::2] == [pytest.approx(angles[0], abs=1e-12)] * 2
    assert angles[3::2] == [pytest.approx(angles[1], abs=1e-12)] * 2


# Coordinates ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("l2", [1.0, 0.5])
def test_reactions_of_four_coordinate_sets_agree(l2):
    """A driven slider-crank over 2 s, with equal links through singular positions: joint forces to 1e-10 N away from
    them, more than 0.3 rad."""
    given = {"l2": l2, "solver.method": "order8", "solver.step_size": 0.005}
    inputs = {"A.torque": 1.0, "slider.force": -2.0}
    runs = [
        alfmu.simulate(derived("slider_crank", coordinates=x), 2.0, 0.02, parameters=given, inputs=inputs)
        for x in COORDINATES
    ]
    names = [n for n in runs[0].names if ".force" in n and n != "slider.force"]
    assert len(names) >= 7
    away = np.abs(np.cos(runs[0]["crank.angle"])) > np.sin(0.3)
    assert away.sum() > 50
    for other in runs[1:]:
        assert max(np.abs(other[n] - runs[0][n])[away].max() for n in names) <= 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("loops", [1, 2])
def test_natural_coordinates_keep_order_four_through_singular_positions(loops):
    """N-four-bar over 10 s, at steps of 2.5 ms and three times halved: 1e-10 m at the shortest."""
    e = prepared(derived("n_four_bar", loops=loops, coordinates="natural"), "vm")
    times, steps = np.arange(0.0, 10.05, 0.1), 0.0025 / 2 ** np.arange(4)

    def acceleration(t, th, w):
        return -(3 * loops + 1) / 2 * 9.81 * np.cos(th) / ((4 * loops + 1) / 3)

    exact = ode.motion(acceleration, np.pi / 2, -1.0, times)[:, 0]
    errors = []
    for h in steps:
        r = alfmu.simulate(e, 10.0, 0.1, parameters={"solver.method": "rk4", "solver.step_size": h})
        errors.append(2 * np.abs(np.sin((r["crank1.angle"] - exact) / 2)).max())
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] >= 3.8
    assert errors[-1] <= 1e-10


# One definition for every direction and every set of coordinates -----------------------------------------------------


class Turned:
    """A mechanism in space whose directions are turned by the matrix of the parameters r00 to r22."""

    def __init__(self, name: str):
        self.m = alfmu.Mechanism(name)
        unit = np.eye(3)
        self.R = [[self.m.parameter(f"r{i}{j}", unit[i, j], "1") for j in range(3)] for i in range(3)]
        self.m.gravity(*self.along(0.7, -9.81, 1.3))
        self.ground = self.m.spatial_ground

    def along(self, x: float, y: float, z: float) -> tuple:
        return tuple(row[0] * x + row[1] * y + row[2] * z for row in self.R)

    def body(self, name: str, mass: float, *center: float) -> spatial.SpatialBody:
        given = {"mass": mass, "inertia": (0.02, 0.02, 0.02), "center": self.along(*center), "relative": True}
        return self.m.spatial_body(name, **given)

    def at(self, body: spatial.SpatialBody, *place: float):
        return body.at(*self.along(*place))

    def joint(self, kind: str, name: str, first, second, *axis: float, unit: str = "", rate: float = 0.0) -> None:
        """Between points of two bodies, with a coordinate where it has a unit; independent with a rate."""
        given = {"axis": self.along(*axis)} if axis else {}
        if unit:
            more = {"independent": True, "rate": rate} if rate else {}
            given["coordinate"] = self.m.coordinate(f"{name}_q", unit, start=0.0, **more)
        getattr(self.m, f"spatial_{kind}")(name, self.at(*first), self.at(*second), **given)


def four_hinges() -> alfmu.Mechanism:
    """A planar four-bar in space: three redundant constraints."""
    t = Turned("four_hinges")
    a, b, c = t.body("a", 1.0, 0.1, 0.15, 0), t.body("b", 2.0, 0.25, 0, 0), t.body("c", 1.5, 0.1, 0.2, 0)
    t.joint("revolute", "A", (t.ground, 0, 0, 0), (a, 0, 0, 0), 0, 0, 1, unit="rad", rate=1.5)
    t.joint("revolute", "B", (a, 0.2, 0.3, 0), (b, 0, 0, 0), 0, 0, 1, unit="rad")
    t.joint("revolute", "D", (t.ground, 0.5, 0, 0), (c, 0, 0, 0), 0, 0, 1, unit="rad")
    t.joint("revolute", "C", (b, 0.5, 0.1, 0), (c, 0.2, 0.4, 0), 0, 0, 1)
    return t.m


def two_hinges() -> alfmu.Mechanism:
    """A door: five redundant constraints."""
    t = Turned("two_hinges")
    plate = t.body("plate", 2.0, 0.4, 0.5, 0.1)
    for name, y, unit in (("A", 0.1, "rad"), ("B", 1.2, "")):
        given = (t.ground, 0, y, 0), (plate, 0, y, 0)
        t.joint("revolute", name, *given, 0, 1, 0, unit=unit, rate=2.0)
    return t.m


def two_rails() -> alfmu.Mechanism:
    """A table on two rails: five redundant constraints."""
    t = Turned("two_rails")
    table = t.body("table", 2.0, 0.4, 0.2, 0.1)
    for name, z, unit in (("A", 0.0, "m"), ("B", 0.7, "")):
        t.joint("prismatic", name, (t.ground, 0, 0, z), (table, 0, 0, z), 1, 0, 0, unit=unit, rate=0.5)
    return t.m


def welded() -> alfmu.Mechanism:
    """A four-bar that a weld within a link closes: three redundant constraints."""
    t = Turned("welded")
    a, b, c, d = (t.body(name, mass, 0.1, 0.1, 0) for name, mass in zip("abcd", (1.0, 2.0, 1.5, 0.5), strict=True))
    t.joint("revolute", "A", (t.ground, 0, 0, 0), (a, 0, 0, 0), 0, 0, 1, unit="rad", rate=-1.2)
    t.joint("revolute", "B", (a, 0.1, 0.4, 0), (b, 0, 0, 0), 0, 0, 1, unit="rad")
    t.joint("revolute", "D", (t.ground, 0.6, 0, 0), (c, 0, 0, 0), 0, 0, 1, unit="rad")
    t.joint("revolute", "C", (c, 0.1, 0.3, 0), (d, 0, 0, 0), 0, 0, 1, unit="rad")
    t.joint("weld", "loop", (b, 0.3, 0, 0), (d, -0.3, 0.1, 0))
    return t.m


def sarrus() -> alfmu.Mechanism:
    """Sarrus' linkage, two chains of three hinges: one redundant constraint."""
    t = Turned("sarrus")
    top = t.body("top", 2.0, -0.4, 0.1, 0.05)
    for k, (x, y) in enumerate(((1, 0), (0, 1)), 1):
        low, high = t.body(f"low{k}", 1.0, x / 4, y / 4, 0.25), t.body(f"high{k}", 0.7, -x / 4, -y / 4, 0.25)
        given = {"unit": "rad"}
        base = (t.ground, x, y, 0), (low, 0, 0, 0)
        t.joint("revolute", f"A{k}", *base, y, x, 0, **given, rate=1.1 if k == 1 else 0.0)
        t.joint("revolute", f"B{k}", (low, x / 2, y / 2, 0.5), (high, 0, 0, 0), y, x, 0, **given)
        place = (high, -x / 2, -y / 2, 0.5), (top, x - 1, y, 0)
        t.joint("revolute", f"C{k}", *place, y, x, 0, **(given if k == 1 else {}))
    return t.m


def vectors(i: alfmu.Instance, R: np.ndarray) -> np.ndarray:
    """Forces and moments of all joints, turned back."""
    y = dict(zip((v.name for v in i.equations.outputs), i.read(), strict=False))
    names = [n[:-2] for n in y if n.endswith((".force.x", ".moment.x"))]
    return np.array([R.T @ [y[f"{name}.{axis}"] for axis in "xyz"] for name in names])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "redundant"), [(four_hinges, 3), (two_hinges, 5), (two_rails, 5), (welded, 3), (sarrus, 1)]
)
def test_loads_turn_with_the_mechanism(build, redundant):
    """Twenty directions; turned back, all joints carry the same to 1e-9 of the largest load."""
    by_rk4 = with_defaults(alfmu.derive(build()), {"solver.method": "rk4"})
    e = prepared(specialised(by_rk4, ["*.force.*", "*.moment.*"]), "vm")
    usual = None
    for k in range(100 if ALL else 20):
        R = np.eye(3) if not k else Rotation.random(random_state=k).as_matrix()
        i = started(e, {f"r{a}{b}": R[a, b] for a in range(3) for b in range(3)})
        assert i.mobility().redundant == redundant
        found = vectors(i, R)
        usual = found if usual is None else usual
        assert np.abs(found - usual).max() <= 1e-9 * np.abs(usual).max()


def with_motors(coordinates: str) -> alfmu.Mechanism:
    """A parallel four-bar with a motor on each of the outer links, one of which would do."""
    m = alfmu.load("four_bar", coordinates=coordinates)
    q = {c.name: c.q for c in m.coordinates}
    for name in ("th1", "th3"):
        m.motion(q[name], 0.4 + 3.0 * m.time)
    return m


def of_the_catalogue(name: str):
    return lambda coordinates: alfmu.load(name, coordinates=coordinates)


SETS = {
    "equal motors": (with_motors, ("mixed", "joint"), {"start.angular_velocity": 3.0}),
    "motors": (with_motors, ("mixed", "joint"), {"m3": 2.5, "start.angular_velocity": 3.0}),
    "five_bar": (of_the_catalogue("five_bar"), ("mixed", "joint"), {"m1": 2.0, "A.torque": 5.0, "D.torque": -2.0}),
    "n_four_bar": (of_the_catalogue("n_four_bar"), ("natural", "absolute"), {}),
    "slider_crank": (of_the_catalogue("slider_crank"), COORDINATES, {}),
}


@pytest.mark.slow
@pytest.mark.parametrize("which", SETS)
def test_all_sets_of_coordinates_share_alike(which):
    """What joints and motors carry, to 1e-11 of the largest."""
    build, sets, given = SETS[which]
    found = []
    for coordinates in sets:
        equations = with_defaults(alfmu.derive(build(coordinates)), {"solver.method": "rk4"})
        i = started(equations, {"start.angle": 0.4, **given})
        y = readings(i)
        found.append({v.name: y[v.name] for v in i.equations.outputs if v.unit in ("N", "N.m") and "[" not in v.name})
    scale = max(map(abs, found[0].values()))
    for other in found[1:]:
        assert set(other) == set(found[0])
        assert max(abs(other[name] - x) for name, x in found[0].items()) <= 1e-11 * scale


@cache
def table(way: int) -> alfmu.Equations:
    """A table on three rails, of any size; another of them is closed by its coordinate the other way round."""
    m = alfmu.Mechanism("table")
    size, heavy = m.parameter("size", 1.0, "m"), m.parameter("heavy", 1.0, "1")
    mass = {"mass": heavy, "inertia": [heavy * size**2 * x for x in (0.3, 0.2, 0.4)]}
    top = m.spatial_body("top", **mass, center=(0.1 * size, 0.2 * size, 0.3 * size), relative=True)
    q = m.coordinate("x", "m", start=0.2, independent=True)
    for name, y, z in (("A", 0.0, 0.0), ("B", 0.7, 0.1), ("C", 0.3, 0.9))[::way]:
        ends = m.spatial_ground.at(0, y * size, z * size), top.at(0, y * size, z * size)
        given = {"coordinate": q} if name == ("A" if way == 1 else "C") else {}
        m.spatial_prismatic(name, *ends, axis=(1, 0, 0), **given)
    m.force(top.at(0, size, 0), heavy, -2 * heavy, 3 * heavy)
    m.gravity(0.0, 0.0, -9.81)
    return specialised(with_defaults(alfmu.derive(m), {"solver.method": "rk4"}), ["*.force.*", "*.moment.*"])


def shares(size: float, heavy: float, way: int) -> dict[str, float]:
    """Forces over the mass, and moments over the mass and the size."""
    y = readings(started(table(way), {"size": size, "heavy": heavy, "start.x": 0.2 * size, "start.x_rate": size}))
    return {name: x / heavy / (size if ".moment" in name else 1.0) for name, x in y.items()}


@pytest.mark.slow
def test_shares_are_in_proportion_to_the_size():
    usual = shares(1.0, 1.0, 1)
    assert max(abs(x) for name, x in usual.items() if "moment" in name) > 0.5
    for size in (1e-3, 1e-1, 10.0, 1e3):
        for heavy, way in ((1.0, 1), (100.0, 1), (size**3, -1)):
            found = shares(size, heavy, way)
            assert max(abs(found[name] - x) for name, x in usual.items()) <= 1e-9 * max(map(abs, usual.values())), size


def test_equal_motors_share_alike():
    """Half of what the weight of equal links takes at a constant rate, 2 m g l cos(th) in all."""
    given = {"start.angle": 0.4, "start.angular_velocity": 3.0}
    i = started(with_defaults(alfmu.derive(with_motors("joint")), {"solver.method": "rk4"}), given)
    for name in ("th1", "th3"):
        assert i.get(f"{name}.torque") == pytest.approx(9.81 * np.cos(0.4), rel=1e-12)
