"""The five-bar linkage of the paper: motion against elliptic functions, all reactions against Newton's law.

The start is the paper's: the singular position th = 0, 2 rad/s, gravity alone.
"""

import numpy as np
import pytest
from oracles.parallelogram import Parallelogram
from scenes import derived, readings, started

import alfmu
from alfmu.method.singular import READ_DISTANCE

EPS = np.finfo(float).eps

RUN = 20.0
STEP = 0.02

MASSES = pytest.mark.parametrize("m2", [1.0, 0.0], ids=["m2=1", "m2=0"])

FORCES = [f"{joint}.force.{axis}" for joint in "ABCDEF" for axis in "xy"] + [f"multiplier[{i}]" for i in range(1, 9)]


def room(th: float, largest: float) -> float:
    """Round-off that any method has in the forces at an angle th, when the state is rounded to double precision.

    Near th = n pi the links are almost aligned and the smallest singular value of C is about |sin th|. Place, velocity,
    acceleration and multipliers each follow from the one before through C, so each loses another factor of it.
    """
    return 8 * EPS * largest / min(1.0, abs(np.sin(th))) ** 4


CASES = [(m2, kernel) for kernel in ("vm", "oracle") for m2 in (1.0, 0.0)]


@pytest.fixture(scope="module", params=CASES, ids=[f"m2={m2:g}-{kernel}" for m2, kernel in CASES])
def run(request: pytest.FixtureRequest) -> tuple[Parallelogram, alfmu.Result]:
    """20 s as in the paper, with link 2 and with a massless link 2, by the kernel; half of it by the oracle."""
    m2, kernel = request.param
    given, stop = {"m2": m2, "solver.method": "rk4"}, RUN if kernel == "vm" else RUN / 2
    result = alfmu.simulate(derived("five_bar"), stop, STEP, parameters=given, kernel=kernel)
    return Parallelogram(m2=m2), result


def test_references_agree() -> None:
    """Elliptic functions against an integration of order eight: the reference is good to 1e-11 rad over 20 s."""
    times = np.linspace(0.0, RUN, 201)
    five_bar = Parallelogram()
    gap = five_bar.swing(0.0, 2.0, times) - five_bar.driven(0.0, 2.0, times, 0.0)
    assert np.abs(gap).max() <= 1e-11


@pytest.mark.slow
def test_motion(run: tuple) -> None:
    """Angle and speed of link 1 within 1.5e-5 rad and 4e-5 rad/s of the exact motion; the links stay parallel.

    RK4 at 0.02 s leaves 7e-6 rad (m2 = 0: 1e-5), the projection adds nothing to it.
    """
    five_bar, r = run
    exact = five_bar.swing(0.0, 2.0, r.time)
    assert np.abs(r["link1.angle"] - exact[:, 0]).max() <= 1.5e-5
    assert np.abs(r["link1.angular_velocity"] - exact[:, 1]).max() <= 4e-5
    # Along a nearly singular position the links may part by the square root of what the constraints see.
    assert np.abs(r["link3.angle"] - r["link1.angle"]).max() <= np.sqrt(EPS)
    assert np.abs([r["link2.angle"], r["link4.angle"]]).max() <= np.sqrt(EPS)


@pytest.mark.slow
def test_singular_positions_are_passed(run: tuple) -> None:
    """th = 0 and th = -pi several times each."""
    _, r = run
    th = r["link1.angle"]
    assert np.count_nonzero(np.diff(np.sign(th))) >= 6 * r.time[-1] / RUN
    assert np.count_nonzero(np.diff(np.sign(th + np.pi))) >= 6 * r.time[-1] / RUN


@pytest.mark.slow
def test_constraints(run: tuple) -> None:
    """|Phi| below 1e-13 at every step."""
    _, r = run
    c = r.counters
    assert np.abs(r["monitor.position_error"]).max() == c.position_error < 1e-13
    assert c.velocity_error < 1e-13
    assert c.acceleration_error < 1e-8  # of limits, at the positions that are singular
    assert c.steps == round(r.time[-1] / STEP)


@pytest.mark.slow
@pytest.mark.parametrize("m2", [1.0, 0.0])
def test_work_of_the_oracle(m2: float) -> None:
    """Four evaluations a step (readings are shared), three multiplier iterations each, a correction of q and of v."""
    parameters = {"m2": m2, "solver.branch": "paper"}
    c = alfmu.simulate(derived("five_bar"), 4.0, STEP, parameters=parameters, kernel="oracle").counters
    assert (c.steps, c.evaluations) == (200, 801)
    assert c.multiplier_iterations <= 3.5 * c.evaluations
    assert c.projection_iterations <= 2.2 * c.steps


@pytest.mark.slow
def test_energy(run: tuple) -> None:
    """The sum of kinetic and potential energy, by hand from the bodies, stays within what RK4 leaves of 25 J."""
    five_bar, r = run
    masses = [five_bar.m1, five_bar.m2, five_bar.m3, five_bar.m4]
    energy = sum(
        m * (r[f"link{i}.vx"] ** 2 + r[f"link{i}.vy"] ** 2) / 2
        + m / 24 * r[f"link{i}.angular_velocity"] ** 2
        + m * 9.81 * r[f"link{i}.y"]
        for i, m in enumerate(masses, 1)
    )
    assert np.abs(energy - r["monitor.energy"]).max() <= 100 * EPS * 25
    assert np.ptp(energy) <= 1e-4
    assert r.counters.energy_error == pytest.approx(np.abs(energy - energy[0]).max(), rel=1e-6)


@pytest.mark.slow
def test_all_reactions(run: tuple) -> None:
    """Eight multipliers, redundant ones included, and all joint forces along 20 s, at the simulated angle and speed."""
    five_bar, r = run
    compared = 0
    for k in range(0, len(r.time), 8):
        th, w = r["link1.angle"][k], r["link1.angular_velocity"][k]
        exact = five_bar.forces(th, w)
        assert set(exact) == set(FORCES)
        # At the start they are a limit, extrapolated from places where no method knows them better.
        limit = room(th if k else READ_DISTANCE, max(abs(x) for x in exact.values()))
        assert max(abs(r[name][k] - x) for name, x in exact.items()) <= limit
        compared += limit < 1e-9
    assert compared > 100 * r.time[-1] / RUN


def test_start_at_the_singular_position() -> None:
    """At th = 0 itself the reactions are the limit along the branch: bounded, and known by hand for 2 rad/s.

    Link 2 has the centripetal acceleration 4 m/s2 and falls with th'' = -9.81 2.5 / (23 / 12): each end bears half.
    """
    e = -9.81 * 2.5 / (23 / 12)
    lift = [9.81 + e, 9.81 + e / 2]
    by_hand = [2.0, -lift[0] / 2, 2.0, -lift[0] / 2, 1.0, -lift[1] / 2, 1.0, -lift[1] / 2]
    # A limit is extrapolated from 0.03 rad: round-off over its fourth power, 3e-10, and what the eighth order leaves.
    # Here the accelerations and multipliers that (8) gives at the position itself are the branch's too.
    for branch, digits, singular in (("continue", (1e-9, 1e-9), 1), ("paper", (1e-14, 1e-13), 0)):
        r = readings(started(derived("five_bar"), {"solver.branch": branch}))
        assert r["link1.angular_acceleration"] == pytest.approx(e, rel=digits[0])
        for i, x in enumerate(by_hand, 1):
            assert r[f"multiplier[{i}]"] == pytest.approx(x, rel=digits[1])
        assert r["monitor.singular"] == singular


@pytest.mark.parametrize("torques", [(3.0, 0.0), (0.0, 3.0), (-2.0, 5.0)])
def test_torques_on_both_ground_links(torques: tuple[float, float]) -> None:
    """Swinging about th = -1.2 rad, away from singular positions, under torques at A and D: motion and all forces."""
    five_bar = Parallelogram(m1=1.3, m2=0.7, m3=0.9, m4=1.6, l=0.8)
    sizes = {"m1": 1.3, "m2": 0.7, "m3": 0.9, "m4": 1.6, "l": 0.8}
    given = {**sizes, "start.angle": -1.2, "start.angular_velocity": 0.4}
    inputs = {"A.torque": torques[0], "D.torque": torques[1]}
    r = alfmu.simulate(
        derived("five_bar"),
        2.0,
        0.05,
        parameters={**given, "solver.method": "rk4", "solver.step_size": 0.0025},
        inputs=inputs,
    )
    exact = five_bar.driven(-1.2, 0.4, r.time, sum(torques))
    # RK4 at 0.0025 s: (0.02 / 0.0025)^4 = 4096 times less than the 1e-5 rad of the run above.
    assert np.abs(r["link1.angle"] - exact[:, 0]).max() <= 1e-9
    assert -2.6 < r["link1.angle"].min() < r["link1.angle"].max() < -0.5
    for k in range(len(r.time)):
        th, w = r["link1.angle"][k], r["link1.angular_velocity"][k]
        forces = five_bar.forces(th, w, torques)
        limit = room(th, max(abs(x) for x in forces.values()))
        assert max(abs(r[name][k] - x) for name, x in forces.items()) <= limit
    assert r.counters.energy_error <= 1e-8


@MASSES
@pytest.mark.parametrize(("th", "w"), [(0.0, 2.0), (-1.0, 3.5)], ids=["singular start", "regular start"])
def test_order_four(m2: float, th: float, w: float) -> None:
    """Slope of the error at 1 s over four halvings from 0.02 s, for q, v and lambda; the last errors are above 1e-12.

    Steps this short cross th = 0 and -pi without a stage near enough to them to matter.
    """
    five_bar = Parallelogram(m2=m2)
    _, exact = five_bar.swing(th, w, np.array([0.0, 1.0]))
    forces = five_bar.forces(*exact)
    steps = 0.02 / 2 ** np.arange(5)
    errors = []
    for h in steps:
        i = started(
            derived("five_bar"),
            {"m2": m2, "start.angle": th, "start.angular_velocity": w, "solver.method": "rk4", "solver.step_size": h},
        )
        i.step(1.0)
        r = readings(i)
        lam = max(abs(r[name] - x) for name, x in forces.items() if name.startswith("multiplier"))
        errors.append([abs(r["link1.angle"] - exact[0]), abs(r["link1.angular_velocity"] - exact[1]), lam])
    assert np.min(errors) > 1e-12
    slopes = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert (np.abs(slopes - 4) < 0.3).all(), slopes


@pytest.mark.parametrize("th", [0.17316003556465065, -0.14172486270982032, 0.16, 0.07, -0.03, -0.3])
def test_every_phase_passes(th: float) -> None:
    """Other starts meet singular positions at other phases of a step; at the first, a step ends 2.6e-5 rad off one."""
    r = alfmu.simulate(derived("five_bar"), 5.0, STEP, parameters={"start.angle": th})
    exact = Parallelogram().swing(th, 2.0, r.time)
    assert np.abs(r["link1.angle"] - exact[:, 0]).max() <= 1.5e-5
