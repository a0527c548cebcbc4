"""Cams and followers: against closed forms of an eccentric disc, against curves known otherwise, and in balance."""

import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scenes import readings, started
from scipy.interpolate import CubicSpline

import alfmu
from alfmu.model.cams import curve

G = 9.81
DISC, OFF = 0.05, 0.02
"""Radius of an eccentric disc and the distance of its middle from the axle [m]; the middle lies along its x axis."""


def disc(u: ca.SX) -> ca.SX:
    """Polar radius of the eccentric disc [m]."""
    return OFF * ca.cos(u) + ca.sqrt(DISC**2 - (OFF * ca.sin(u)) ** 2)


def points(form: Callable[[np.ndarray], np.ndarray], count: int, outline: bool) -> np.ndarray:
    u = np.linspace(0, 2 * math.pi, count, endpoint=False)
    r = np.array(form(u))
    return np.array([r * np.cos(u), r * np.sin(u)]).T if outline else np.array([u, r]).T


def tappet(guide: float = 0.0, turned: float = 0.8, **curve) -> tuple[alfmu.Mechanism, dict[str, float]]:
    """A cam about the origin and a follower that slides along y at x = guide; all outputs at its start."""
    m = alfmu.Mechanism("tappet")
    turn = m.coordinate("turn", start=turned, rate=10.0, independent=True)
    lift = m.coordinate("lift", "m", start=0.09)
    disc = m.body("disc", mass=1.0, inertia=0.01)
    stem = m.body("stem", mass=0.3, inertia=0.001)
    m.revolute("axle", m.ground.at(0, 0), disc.at(0, 0), coordinate=turn)
    m.prismatic("bush", m.ground.at(guide, 0), stem.at(0, 0), axis=math.pi / 2, coordinate=lift)
    m.cam("cam", disc.at(0, 0), stem.at(0, 0), **curve)
    m.torque(disc, 0.5)
    m.gravity(0, -G)
    return m, readings(started(alfmu.derive(m)))


def moves(y: dict[str, float], law: Callable[[float], float]) -> float:
    """Check a follower's motion against its law of the cam's angle; the force of the cam along the follower [N]."""
    h = 1e-4
    angle = y["disc.angle"]
    at, back, on = law(angle), law(angle - h), law(angle + h)
    slope, bend = (on - back) / (2 * h), (on - 2 * at + back) / h**2
    assert y["stem.y"] == pytest.approx(at, rel=1e-12)
    assert y["stem.vy"] == pytest.approx(slope * 10.0, rel=1e-6)
    turn = (0.5 - 0.3 * (G + bend * 100.0) * slope) / (0.01 + 0.3 * slope**2)
    assert y["disc.angular_acceleration"] == pytest.approx(turn, rel=1e-5)
    assert y["stem.ay"] == pytest.approx(bend * 100.0 + slope * turn, rel=1e-5)
    return 0.3 * (y["stem.ay"] + G)


@pytest.mark.parametrize("form", ["outline", "distance", "outline of points", "distance of points"])
def test_a_flat_follower_on_an_eccentric_disc(form: str):
    """The face is as high as the disc's middle and its radius."""
    which, _, by_points = form.partition(" of ")
    law = {"outline": disc, "distance": lambda u: DISC + OFF * ca.cos(u)}[which]
    if by_points:
        plain = {"outline": lambda u: OFF * np.cos(u) + np.sqrt(DISC**2 - (OFF * np.sin(u)) ** 2)}
        plain["distance"] = lambda u: DISC + OFF * np.cos(u)
        law = points(plain[which], 40, which == "outline")
    _, y = tappet(face=math.pi / 2, **{which: law})
    if by_points:
        assert y["stem.y"] == pytest.approx(DISC + OFF * math.sin(0.8), abs=2e-6)
        assert y["cam.contact.x"] == pytest.approx(OFF * math.cos(0.8), abs=3e-5)
        return
    force = moves(y, lambda t: DISC + OFF * math.sin(t))
    assert y["cam.force"] == pytest.approx(force, rel=1e-9)
    assert [y["cam.contact.x"], y["cam.contact.y"]] == pytest.approx([OFF * math.cos(0.8), y["stem.y"]], rel=1e-10)
    # The force acts beside the stem, which its bush holds upright.
    assert y["bush.moment"] == pytest.approx(-force * OFF * math.cos(0.8), rel=1e-9)
    assert y["axle.force.y"] == pytest.approx(1.0 * G + force, rel=1e-9)


@pytest.mark.parametrize(("form", "roller"), [("outline", 0.012), ("outline", 0.0), ("distance", 0.012)])
def test_a_roller_on_an_eccentric_disc(form: str, roller: float):
    """Its centre stays on a circle about the disc's middle; the follower is beside the axle."""
    reach, guide = DISC + roller, 0.004
    pitch = (lambda u: OFF * ca.cos(u) + ca.sqrt(reach**2 - (OFF * ca.sin(u)) ** 2)) if form == "distance" else disc
    _, y = tappet(guide, roller=roller, **{form: pitch})

    def law(t: float) -> float:
        return OFF * math.sin(t) + math.sqrt(reach**2 - (guide - OFF * math.cos(t)) ** 2)

    along = moves(y, law)
    middle = OFF * np.array([math.cos(0.8), math.sin(0.8)])
    normal = (np.array([guide, y["stem.y"]]) - middle) / reach
    assert y["cam.force"] == pytest.approx(along / normal[1], rel=1e-9)
    assert [y["cam.contact.x"], y["cam.contact.y"]] == pytest.approx(list(middle + DISC * normal), rel=1e-9)
    push = y["cam.force"] * normal
    assert y["bush.force"] == pytest.approx(push[0], rel=1e-9)  # to the left
    assert [y["axle.force.x"], y["axle.force.y"]] == pytest.approx([push[0], push[1] + G], rel=1e-9)


def test_a_rocker_follows_a_cam_through_turns():
    """A roller on a swinging arm, a revolution and more: it stays at its distance from the disc's middle."""
    m = alfmu.Mechanism("rocker", experiment=alfmu.Experiment(0.5, 5e-3))
    turn = m.coordinate("turn", start=0.3, rate=20.0, independent=True)
    swing = m.coordinate("swing", start=2.4)
    wheel = m.body("wheel", mass=1.0, inertia=0.05)
    arm = m.bar("arm", mass=0.2, length=0.12)
    m.revolute("axle", m.ground.at(0, 0), wheel.at(0, 0), coordinate=turn)
    m.revolute("pivot", m.ground.at(0.12, 0.02), arm.start, coordinate=swing)
    m.cam("cam", wheel.at(0, 0), arm.end, outline=disc, roller=0.015)
    m.watch("roller", arm.end)
    m.gravity(0, -G)
    r = alfmu.simulate(m, parameters={"solver.method": "explicit", "solver.relative_tolerance": 1e-8})
    middle = OFF * np.exp(1j * r["wheel.angle"])
    place = r["roller.x"] + 1j * r["roller.y"]
    assert r["wheel.angle"][-1] > 9.0
    assert np.abs(place - middle) == pytest.approx(DISC + 0.015, abs=1e-12)
    contact = r["cam.contact.x"] + 1j * r["cam.contact.y"]
    assert contact == pytest.approx(middle + DISC * (place - middle) / np.abs(place - middle), abs=1e-10)
    # What the cam gives the arm: its moment about the pivot.
    force = r["cam.force"] * (place - middle) / np.abs(place - middle)
    pivot = 0.12 + 0.02j
    weight = -0.2 * G * (np.cos(r["arm.angle"]) * 0.06)
    moment = np.imag(np.conj(place - pivot) * force) + weight
    assert moment == pytest.approx(0.2 * 0.12**2 / 3 * r["arm.angular_acceleration"], abs=1e-9)
    assert abs(r["monitor.energy"] - r["monitor.energy"][0]).max() < 1e-6


def test_points_have_the_periodic_cubic_spline():
    """Value, slope and curvature by SciPy, over several turns either way; clockwise points are the same outline."""
    random = np.random.default_rng(3)
    turns = np.sort(random.uniform(0.3, 0.3 + 2 * math.pi, 12))
    lengths = random.uniform(0.8, 1.2, 12)
    around = np.append(turns, turns[0] + 2 * math.pi)
    known = CubicSpline(around, np.append(lengths, lengths[0]), bc_type="periodic")
    xy = np.array([lengths * np.cos(turns), lengths * np.sin(turns)]).T
    m = alfmu.Mechanism("m")
    at = np.linspace(-9, 15, 97)
    for given, outline in ((np.array([turns, lengths]).T, False), (xy, True), (xy[::-1], True)):
        form = curve(m, "it", given, outline)
        slope = ca.gradient(form.value, form.turn)
        f = ca.Function("f", [form.turn], [ca.vertcat(form.value, slope, ca.gradient(slope, form.turn))])
        seen = np.array(f(ca.DM(at).T))
        for k in range(3):
            assert seen[k] == pytest.approx(known(at, k), abs=1e-11)


SQUARE = [(1, 1), (-1, 1), (-1, -1), (1, -1)]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"face": 0.0}, "has neither an outline nor a distance"),
        ({"outline": disc, "distance": disc, "face": 0.0}, "has an outline and a distance"),
        ({"outline": disc}, "has neither a roller nor a face"),
        ({"outline": disc, "roller": 0.01, "face": 0.0}, "has a roller and a face"),
        ({"outline": disc, "roller": -0.01}, "radius of the roller of cam cam is -0.01 m"),
        ({"outline": lambda u: 0.05 + 0.001 * u, "roller": 0.01}, "is not closed: it is 0.05 m at 0 and 0.0562832 m"),
        ({"outline": lambda u: 0.05 + 0.01 * ca.sin(u / 2), "roller": 0.01}, "in its slope"),
        ({"outline": lambda u: math.sin(u), "roller": 0.01}, "functions of Python's math make nan of symbols"),
        ({"outline": lambda u: 0.05 + 0.06 * ca.cos(u), "roller": 0.01}, "has the radius -0.0099"),
        ({"outline": lambda u: 0.05 + 0.02 * ca.cos(4 * u), "face": 0.0}, "where a flat face cannot follow it"),
        ({"outline": lambda u: 0.05 + 0.02 * ca.cos(4 * u), "roller": 0.01}, "the outline has a hollow of 0.0"),
        ({"distance": lambda u: 0.05 + 0.02 * ca.cos(4 * u), "roller": 0.02}, "the pitch curve has a bulge of 0.0"),
        ({"distance": lambda u: 0.05 + 0.02 * ca.cos(4 * u), "face": 0.0}, "no outline lets a flat face move as cam"),
        ({"outline": [(1, 0), (0, 1)], "roller": 0.0}, r"has the shape \(2, 2\)"),
        ({"outline": "round", "roller": 0.0}, "is 'round'; give a function, or points"),
        ({"outline": [(x + 3, y) for x, y in SQUARE], "roller": 0.0}, "does not go around the cam's centre once"),
        ({"distance": [(0, 1), (2, 1), (1, 1), (3, 1)], "roller": 0.0}, "do not rise within one turn"),
        ({"distance": [(0, 1), (2, 1), (3, 1), (2 * math.pi, 2)], "roller": 0.0}, "1 m at its first point and 2 m"),
    ],
)
def test_a_cam_that_cannot_be_is_refused(given: dict, said: str):
    with pytest.raises(alfmu.DeclarationError, match=said):
        tappet(**given)
