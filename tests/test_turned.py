"""Planar and over-constrained linkages made of bodies in space: the same motion in every direction and place.

`DRAWS=200 pytest tests/test_turned.py` draws so many of each kind; by default one of each.
"""

import logging

import numpy as np
import pytest
from oracles import ode
from oracles.newton_euler import NewtonEuler
from pairs import draws
from scipy.spatial.transform import Rotation
from turned import KINDS, G, Link, Linkage, gripper, sarrus, scissors, six_bar, slider_crank

import alfmu
from alfmu.runtime.probe import Probe

DRAWS = draws(1)
STOP, STEP = 0.3, 0.02
TIGHT = {"solver.relative_tolerance": 1e-9}
CASES = [(kind, seed) for kind in KINDS for seed in range(DRAWS)]
NAMES = [f"{kind.__name__}-{seed}" for kind, seed in CASES]


def direction(seed: int) -> tuple[Rotation, tuple[float, ...]]:
    """A random direction, and a place up to 100 m from the origin."""
    random = np.random.default_rng(seed)
    return Rotation.random(random_state=seed), tuple(map(float, random.uniform(-100, 100, 3)))


def motion(linkage, m, turn=None, offset=(0.0, 0.0, 0.0), **parameters) -> tuple[np.ndarray, int]:
    """Centres of mass (bodies, 3, times) in the axes of the linkage declared as m, and the evaluations of the run."""
    run = alfmu.simulate(m, STOP, STEP, parameters=parameters)
    places = np.array([[run[f"{each.name}.{axis}"] for axis in "xyz"] for each in linkage.links])
    if turn is not None:
        places = np.einsum("ji,bjt->bit", turn.as_matrix(), places - np.array(offset)[:, None])
    return places, run.counters.evaluations


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), CASES, ids=NAMES)
def test_a_turned_and_shifted_linkage_moves_as_newton_and_euler_say(kind, seed, caplog):
    """By default within 1e-6, in as many evaluations as the aligned one to a tenth, and without a warning; at a
    tolerance of 1e-9 as exactly as that. Rows that depend on others to round-off are redundant in all directions."""
    linkage, where = kind(np.random.default_rng(seed)), direction(seed + KINDS.index(kind))
    exact = NewtonEuler(linkage).motion(np.arange(0.0, STOP + STEP / 2, STEP))
    aligned, turned = linkage.declared(), linkage.declared(*where)
    with caplog.at_level(logging.WARNING, "alfmu"):
        (straight, evaluations), (oblique, more) = motion(linkage, aligned), motion(linkage, turned, *where)
    assert np.abs(straight - exact).max() <= 1e-6
    assert np.abs(oblique - exact).max() <= 1e-6
    assert more <= 1.1 * evaluations
    assert not caplog.records
    straight, oblique = motion(linkage, aligned, **TIGHT)[0], motion(linkage, turned, *where, **TIGHT)[0]
    assert np.abs(oblique - straight).max() <= 1e-9
    known, probe = (Probe.of(alfmu.derive(m)) for m in (aligned, turned))
    assert probe.mobility() == known.mobility()
    assert set(probe.units) == set(known.units) == {1.0}
    assert probe.penalty.max() == pytest.approx(known.penalty.max(), rel=0.5)


MIXED = [
    (kind, absolute) for kind in (slider_crank, six_bar, sarrus, scissors, gripper) for absolute in ("l", "c", "lc")
]
FEW = [*((slider_crank, which) for which in ("l", "c", "lc")), (six_bar, "c"), (sarrus, "l"), (scissors, "c")]
"""Each linkage and each choice of bodies; all of their combinations from two draws on."""


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "absolute"), MIXED if DRAWS > 1 else [*FEW, (gripper, "lc")])
def test_bodies_with_coordinates_of_their_own_move_as_those_on_joints(kind, absolute):
    """From rest, as a joint between bodies with coordinates of their own has no rate to begin with."""
    linkage, where = kind(np.random.default_rng(0)), direction(1)
    linkage.rate = 0.0
    exact = NewtonEuler(linkage).motion(np.arange(0.0, STOP + STEP / 2, STEP))
    own = motion(linkage, linkage.declared(*where, absolute), *where, **TIGHT)[0]
    assert np.abs(own - exact).max() <= 1e-9


def parallelogram(angle: float) -> Linkage:
    """Three bars of 1 m and 1 kg, which gravity drives through the line on which they all lie."""
    linkage, turn = (
        Linkage("parallelogram", gravity=(0.0, G, 0.0), rate=0.0),
        Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix(),
    )
    end, bar = turn[:, 0], np.diag([1e-3, 1 / 12, 1 / 12])
    places = {"link1": end / 2, "coupler": np.array([0.5, 0.0, 0.0]) + end, "link2": end / 2 + [1.0, 0.0, 0.0]}
    linkage.links += [
        Link(name, 1.0, place, bar if name == "coupler" else turn @ bar @ turn.T) for name, place in places.items()
    ]
    linkage.join("A", "revolute", None, "link1", np.zeros(3))
    linkage.join("B", "revolute", "link1", "coupler", end)
    linkage.join("D", "revolute", None, "link2", np.array([1.0, 0.0, 0.0]))
    linkage.join("C", "revolute", "coupler", "link2", np.array([1.0, 0.0, 0.0]) + end)
    return linkage


def swing_error(run, turn: Rotation, start: float) -> float:
    """The largest error [rad] of the angle of a parallelogram that begins at rest."""
    exact = ode.motion(lambda t, x, v: 2 * G * np.cos(x) / (5 / 3), start, 0.0, run.time)
    places = turn.inv().apply(np.array([run[f"link1.{axis}"] for axis in "xyz"]).T)
    return np.abs(np.arctan2(places[:, 1], places[:, 0]) - exact[:, 0]).max()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 4])
def test_bodies_with_coordinates_of_their_own_leave_a_singular_position_in_every_direction(seed):
    """They begin at rest in it, and have no start value that tells a direction."""
    turn = Rotation.random(random_state=seed)
    places = [f"link1.{axis}" for axis in "xyz"]
    run = alfmu.simulate(parallelogram(0.0).declared(turn, absolute="lc"), STOP, STEP, outputs=places)
    assert swing_error(run, turn, 0.0) <= 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 10])
def test_bodies_with_coordinates_of_their_own_pass_a_singular_position_in_every_direction(seed):
    """In some directions pivots of Euler parameters are small that belong to no singular value."""
    turn, tight = Rotation.random(random_state=seed), {"solver.relative_tolerance": 1e-10}
    own, on_joints = (
        alfmu.simulate(parallelogram(-0.3).declared(turn, absolute=which), STOP, 5e-4, parameters=tight)
        for which in ("lc", "")
    )
    assert swing_error(own, turn, -0.3) <= 1e-9
    # The pole lies at the singular position; rods pull with thousands of newtons within some milliradians of it.
    pulls = [np.array([run[f"J1.force.{axis}"] for axis in "xyz"]) for run in (own, on_joints)]
    assert (np.abs(pulls[0] - pulls[1]) / (1 + np.abs(pulls[1]).max(0))).max() <= 1e-5
