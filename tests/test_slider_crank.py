"""The slider-crank in four coordinate sets, against one coordinate and free-body diagrams, and against each other."""

from dataclasses import dataclass

import numpy as np
import pytest
from oracles.ode import plain_steps
from oracles.slider_crank import SliderCrank
from scenes import derived, readings, started

import alfmu

EPS = np.finfo(float).eps

COORDINATES = ("absolute", "joint", "mixed", "natural")


@dataclass(frozen=True)
class Scene:
    """A slider-crank and where it starts."""

    reference: SliderCrank
    angle: float
    rate: float

    @property
    def rod(self) -> str:
        return "right" if self.reference.side > 0 else "left"

    def given(self) -> dict[str, float]:
        r = self.reference
        sizes = {name: getattr(r, name) for name in ("l1", "l2", "b", "m1", "m2", "m3", "g")}
        return {**sizes, "start.angle": self.angle, "start.angular_velocity": self.rate}

    def inputs(self) -> dict[str, float]:
        return {"A.torque": self.reference.torque, "slider.force": self.reference.force}


SCENES = {
    "driven, offset, two turns from 4 rad": Scene(
        SliderCrank(b=0.2, m1=1.3, m2=0.7, m3=2.1, torque=1.5, force=-2), 4, 6
    ),
    "rod to the left, massless": Scene(SliderCrank(l1=0.4, l2=0.9, b=-0.15, m2=0.0, force=3.0, side=-1), 0.5, -2.0),
    "backwards through 0": Scene(SliderCrank(b=-0.1, torque=-2.0), 0.7, -9.0),
}

scenes = pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
coordinate_sets = pytest.mark.parametrize("coordinates", COORDINATES)


def worst(read: dict[str, float], want: dict[str, float]) -> float:
    """The largest difference in anything there is to read, of the largest entry; the rod's angle up to whole turns."""
    off = {name: read[name] - x for name, x in want.items()}
    off["rod.angle"] -= 2 * np.pi * np.round(off["rod.angle"] / 2 / np.pi)
    return max(map(abs, off.values())) / max(1.0, *map(abs, want.values()))


def row(result: alfmu.Result, k: int) -> dict[str, float]:
    return dict(zip(result.names, result.values[k], strict=True))


def test_reference_balances_the_crank() -> None:
    """The moments about A, which the reference does not use, agree with its accelerations and forces."""
    for scene in SCENES.values():
        for th in np.linspace(0.1, 6.0, 7):
            assert abs(scene.reference.crank_moment(th, 3.0)) <= 1e-13 * 100


@scenes
def test_reference_keeps_its_energy(scene: Scene) -> None:
    """Kinetic and potential energy less the work of torque and force, by hand, along 2 s: good to 1e-10 J of 20."""
    r = scene.reference
    energies = []
    for th, w in r.motion(scene.angle, scene.rate, np.linspace(0.0, 2.0, 21)):
        b = r.readings(th, w)
        kinetic = r.m1 * r.l1**2 / 6 * w**2 + r.m2 * r.l2**2 / 24 * b["rod.angular_velocity"] ** 2
        kinetic += r.m2 * (b["rod.vx"] ** 2 + b["rod.vy"] ** 2) / 2 + r.m3 * b["slider.velocity"] ** 2 / 2
        potential = r.g * (r.m1 * b["crank.y"] + r.m2 * b["rod.y"])
        energies.append(kinetic + potential - r.torque * th - r.force * b["slider.position"])
    assert np.ptp(energies) <= 1e-10


MOVED = {"absolute": (0, 2), "joint": (1,), "mixed": (2,), "natural": (0, 1)}
"""Scenes that are run in each set of coordinates; at their starts all sets agree in all scenes."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coordinates", "scene"),
    [pytest.param(c, list(SCENES.values())[k], id=f"{c}-{list(SCENES)[k]}") for c, each in MOVED.items() for k in each],
)
def test_motion_and_all_reactions(coordinates: str, scene: Scene) -> None:
    """2 s of motion; and at every instant places, velocities, accelerations and all reactions for that angle and speed.

    The crank's angle runs on through whole turns, where natural coordinates know it by its sine and cosine alone.
    """
    e = derived("slider_crank", coordinates=coordinates, rod=scene.rod)
    h = 0.004
    r = alfmu.simulate(
        e, 2.0, 0.04, parameters={**scene.given(), "solver.method": "rk4", "solver.step_size": h}, inputs=scene.inputs()
    )
    exact = scene.reference.motion(scene.angle, scene.rate, r.time)[:, 0]
    # Kutta's method on the exact equation of one degree of freedom is the measure; four times it, because the constant
    # of the error belongs to the coordinates that are integrated (points instead of angles).
    plain = plain_steps(scene.reference.acceleration, scene.angle, scene.rate, h, round(2.0 / h))[:: round(0.04 / h)]
    assert np.abs(r["crank.angle"] - exact).max() <= 4 * np.abs(plain - exact).max() < 3e-3
    assert np.abs(np.diff(r["rod.angle"])).max() < 1.0
    # Velocities are consistent to solver.tolerance, 1e-13, which inertia forces multiply by angular velocities.
    for k in range(len(r.time)):
        want = scene.reference.readings(r["crank.angle"][k], r["crank.angular_velocity"][k])
        assert worst(row(r, k), want) <= 1e-12
    assert r.counters.position_error <= 1e-13
    assert r.counters.velocity_error <= 1e-13
    assert r.counters.unconverged == 0


def test_crank_turns_more_than_twice() -> None:
    """The first scene is one in which angles must be counted."""
    scene = SCENES["driven, offset, two turns from 4 rad"]
    exact = scene.reference.motion(scene.angle, scene.rate, np.array([0.0, 2.0]))
    assert exact[-1, 0] - scene.angle > 4 * np.pi


@pytest.mark.slow
@scenes
def test_coordinate_sets_agree(scene: Scene) -> None:
    """At one state all four say the same of everything: reactions in natural coordinates are as physical as any."""
    read = []
    for coordinates in COORDINATES:
        i = started(
            derived("slider_crank", coordinates=coordinates, rod=scene.rod), {**scene.given(), **scene.inputs()}
        )
        read.append(readings(i))
    want = scene.reference.readings(scene.angle, scene.rate)
    names = [n for n in read[0] if not n.startswith(("multiplier", "monitor.")) or n == "monitor.energy"]
    assert set(want) <= set(names)
    for other in read:
        assert worst(other, want) <= 1e-13
        scale = max(1.0, *(abs(read[0][n]) for n in names))
        assert max(abs(other[n] - read[0][n]) for n in names) <= 1e-13 * scale


@coordinate_sets
def test_multipliers_are_the_joint_forces(coordinates: str) -> None:
    """M a + d = f - C' lambda: a row that reads second less first body has the opposite of the force on the second."""
    scene = SCENES["driven, offset, two turns from 4 rad"]
    e = derived("slider_crank", coordinates=coordinates)
    r = readings(started(e, {**scene.given(), **scene.inputs()}))
    suffix = {"x": "force.x", "y": "force.y", "normal": "force", "rotation": "moment"}
    compared = 0
    for i, joint in enumerate(e.rows, 1):
        if joint.direction in suffix:
            sign = 1 if coordinates == "mixed" and joint.name == "C" else -1
            force = r[f"{joint.name}.{suffix[joint.direction]}"]
            assert r[f"multiplier[{i}]"] == pytest.approx(sign * force, rel=1e-12)
            compared += 1
    assert compared == {"absolute": 7, "joint": 2, "mixed": 4, "natural": 1}[coordinates]


@coordinate_sets
def test_order_four(coordinates: str) -> None:
    """Slope of the largest error over 1 s, four halvings from 0.02 s, for angle, speed and all reactions."""
    scene = Scene(SliderCrank(b=0.1, torque=0.5), 0.6, 2.0)
    times = np.linspace(0.0, 1.0, 11)
    exact = scene.reference.motion(scene.angle, scene.rate, times)
    want = [scene.reference.readings(*state) for state in exact]
    names = [n for n in want[0] if ".force" in n]
    forces = np.array([[x[n] for n in names] for x in want]).T
    steps, errors = 0.02 / 2 ** np.arange(5), []
    for h in steps:
        e = derived("slider_crank", coordinates=coordinates)
        given = {**scene.given(), "solver.method": "rk4", "solver.step_size": h}
        r = alfmu.simulate(e, 1.0, 0.1, parameters=given, inputs=scene.inputs())
        state = np.array([r["crank.angle"], r["crank.angular_velocity"]]).T
        errors.append([*np.abs(state - exact).max(0), np.abs([r[n] for n in names] - forces).max()])
    # The reference is good to 1e-12, the last errors are a hundred times that.
    assert np.min(errors) > 1e-10
    slopes = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert (np.abs(slopes - 4) < 0.3).all(), slopes


# Case 3: l1 = l2 and no offset, singular with both links vertical -----------------------------------------------------

ALIGNED = SliderCrank(l1=1.0, l2=1.0, aligned=True)


@coordinate_sets
def test_equal_links_pass_the_vertical(coordinates: str) -> None:
    """Released at pi / 4 it swings through -pi / 2 to -5 pi / 4 and back, the rod mirroring the crank all the way.

    The limit is Kutta's method on the exact equation of one degree of freedom, 1e-3 rad at 0.02 s and 33 times less at
    half of it: no order is lost to the singular position, at which C loses a rank.
    """
    e = derived("slider_crank", coordinates=coordinates)
    for h in (0.02, 0.01, 0.005):
        fine = np.linspace(0.0, 4.0, round(4.0 / h) + 1)
        plain = plain_steps(ALIGNED.acceleration, np.pi / 4, 0.0, h, len(fine) - 1)
        limit = np.abs(plain - ALIGNED.motion(np.pi / 4, 0.0, fine)[:, 0]).max()
        # Stages that are brought to the branch have an error of their own, of fourth order too: a quarter more at most.
        for branch, most in (("paper", limit), ("continue", 1.3 * limit)):
            given = {"l1": 1.0, "l2": 1.0, "solver.method": "rk4", "solver.step_size": h, "solver.branch": branch}
            r = alfmu.simulate(e, 4.0, 0.02, parameters=given)
            exact = ALIGNED.motion(np.pi / 4, 0.0, r.time)[:, 0]
            assert np.abs(r["crank.angle"] - exact).max() <= most
            assert np.count_nonzero(np.diff(np.sign(r["crank.angle"] + np.pi / 2))) >= 2
            assert r.counters.position_error <= 1e-13
    assert limit < 1e-6


@coordinate_sets
def test_equal_links_reactions_stay_bounded(coordinates: str) -> None:
    """Under gravity all reactions have a limit at the vertical, and are the reference's on both sides of it.

    The smallest singular value of C is about |cos th|; state, acceleration and multipliers each lose another factor of
    it to round-off, four in all.
    """
    e = derived("slider_crank", coordinates=coordinates)
    r = alfmu.simulate(
        e, 4.0, 0.02, parameters={"l1": 1.0, "l2": 1.0, "solver.method": "rk4", "solver.step_size": 0.005}
    )
    nearest = 1.0
    for k in range(0, len(r.time), 2):
        th, w = r["crank.angle"][k], r["crank.angular_velocity"][k]
        want = ALIGNED.readings(th, w)
        nearest = min(nearest, abs(np.cos(th)))
        assert max(map(abs, want.values())) < 200
        assert worst(row(r, k), want) <= 1e-12 + 8 * EPS / np.cos(th) ** 4
    assert nearest < 0.02


@pytest.mark.parametrize("angle", [1.0126200716810303, 0.9864894506217938, 0.5, 1.2])
def test_equal_links_pass_from_any_phase(angle: float) -> None:
    """Other starts meet the vertical at other phases of a step."""
    e = derived("slider_crank", coordinates="absolute")
    r = alfmu.simulate(e, 4.0, 0.02, parameters={"l1": 1.0, "l2": 1.0, "start.angle": angle})
    exact = ALIGNED.motion(angle, 0.0, r.time)[:, 0]
    plain = plain_steps(ALIGNED.acceleration, angle, 0.0, 0.02, 200)
    assert np.abs(r["crank.angle"] - exact).max() <= np.abs(plain - exact).max()


@coordinate_sets
def test_equal_links_start_beside_the_vertical(coordinates: str) -> None:
    """A torque turns the crank from rest through the vertical, which is 2.8e-7 rad from the start."""
    e, angle = derived("slider_crank", coordinates=coordinates), np.pi / 2 - 2.8e-7
    given = {"l1": 1.0, "l2": 1.0, "g": 0.0, "start.angle": angle}
    r = alfmu.simulate(e, 0.5, 0.01, inputs={"A.torque": 4.0}, parameters=given)
    exact = SliderCrank(l1=1.0, l2=1.0, g=0.0, torque=4.0, aligned=True).motion(angle, 0.0, r.time)[:, 0]
    assert np.abs(r["crank.angle"] - exact).max() <= 1e-7
