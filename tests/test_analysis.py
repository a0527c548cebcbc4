"""Positions of rest, linearisation and degrees of freedom, against closed forms and methods of another kind."""

import json
from functools import cache
from pathlib import Path

import fmpy
import mpmath as mp
import numpy as np
import pytest
import scenes
from oracles.parallelogram import Parallelogram
from PIL import Image
from scenes import hinged
from scipy.integrate import solve_ivp
from scipy.io import loadmat
from scipy.linalg import eigh
from scipy.signal import lsim

import alfmu
from alfmu.analysis.films import motion_of
from alfmu.cli import main

G = 9.81

HOLD = 2 * G * 0.35 * 0.5
"""Torque that holds the pendulum 60 degrees from the horizontal [N.m]."""


def pendulum(damping: float = 0.05) -> alfmu.Mechanism:
    """A bar of 2 kg and 0.7 m with a torque at its hinge."""
    m, _, hinge, *_ = hinged("pendulum", mass=2.0, length=0.7, weight=G, start=0.3, independent=True)
    m.friction(hinge, damping)
    m.drive(hinge, m.input("A.torque", "N.m"))
    return m


LENGTHS = (0.4, 0.9, 0.7, 1.0)
"""Crank, coupler, rocker, base [m]."""

SPRING = {"stiffness": 600.0, "rest": 0.5, "damping": 4.0}


def braced(coordinates: str, torque: float = 0.0) -> alfmu.Mechanism:
    """A four-bar under gravity with a spring and a damper across its diagonal, in three kinds of coordinates."""
    a, b, c, d = LENGTHS
    m = alfmu.Mechanism(f"braced_{coordinates}")
    guess = (1.0, 0.35, 1.4)  # angles of crank, coupler, rocker
    places = [(a * np.cos(1.0) / 2, a * np.sin(1.0) / 2), (0.6, 0.5), (d + c * np.cos(1.4) / 2, c * np.sin(1.4) / 2)]
    bars = {}
    for name, length, mass, angle, at in zip(
        ("crank", "coupler", "rocker"), (a, b, c), (1.0, 2.0, 1.5), guess, places, strict=True
    ):
        pose = None
        if coordinates == "absolute" or (coordinates == "mixed" and name == "coupler"):
            x, y = (m.coordinate(f"{name}_{k}", "m", start=value) for k, value in zip("xy", at, strict=True))
            pose = (x, y, m.coordinate(f"{name}_angle", "rad", start=angle))
        bars[name] = m.bar(name, mass=mass, length=length, pose=pose)
    crank, coupler, rocker = bars.values()

    def joint(name, first, second, start):
        free = None if second.body.pose is not None or start is None else m.coordinate(name, "rad", start=start)
        return m.revolute(name.upper(), first, second, coordinate=free)

    drive = joint("th1", m.ground.at(0, 0), crank.start, 1.0)
    joint("th2", crank.end, coupler.start, -0.65 if coordinates == "joint" else None)
    joint("th3", m.ground.at(d, 0), rocker.start, 1.4)
    joint("th4", coupler.end, rocker.end, None)
    m.spring_damper((m.ground.at(0, 0), rocker.end), **SPRING)
    m.drive(drive, m.input("crank.torque", "N.m", start=torque))
    m.gravity(0.0, -G)
    return m


@cache
@mp.workdps(40)
def reduced(torque: float) -> tuple[mp.mpf, mp.mpf, mp.mpf, mp.mpf]:
    """Angle of the crank at rest, inertia, damping and stiffness of the braced four-bar, by closing triangles and
    differentiating the energy in 40 digits."""
    a, b, c, d = map(mp.mpf, map(str, LENGTHS))

    def points(th):
        B = mp.matrix([a * mp.cos(th), a * mp.sin(th)])
        D = mp.matrix([d, 0])
        way = D - B
        far = mp.sqrt(way[0] ** 2 + way[1] ** 2)
        along = (b**2 - c**2 + far**2) / (2 * far)
        across = mp.sqrt(b**2 - along**2)
        unit = way / far
        return B, B + along * unit + across * mp.matrix([-unit[1], unit[0]])

    def diagonal(th):
        C = points(th)[1]
        return mp.sqrt(C[0] ** 2 + C[1] ** 2)

    def energy(th):
        B, C = points(th)
        weight = mp.mpf("9.81") * (1 * B[1] / 2 + 2 * (B[1] + C[1]) / 2 + mp.mpf("1.5") * C[1] / 2)
        return weight + SPRING["stiffness"] * (diagonal(th) - mp.mpf("0.5")) ** 2 / 2

    def inertia(th):
        """Of a bar through points with velocities u, w: mass (u u + u w + w w) / 3 (Hermite's form of a rod)."""
        dB = [mp.diff(lambda x, i=i: points(x)[0][i], th) for i in (0, 1)]
        dC = [mp.diff(lambda x, i=i: points(x)[1][i], th) for i in (0, 1)]
        rods = [(1, (0, 0), dB), (2, dB, dC), (mp.mpf("1.5"), (0, 0), dC)]
        return sum(mass * sum(u[i] ** 2 + u[i] * w[i] + w[i] ** 2 for i in (0, 1)) / 3 for mass, u, w in rods)

    th = mp.findroot(lambda x: mp.diff(energy, x) - torque, -1.9)
    return th, inertia(th), SPRING["damping"] * mp.diff(diagonal, th) ** 2, mp.diff(energy, th, 2)


@cache
def held() -> tuple[alfmu.Mechanism, alfmu.Equilibrium]:
    """The braced four-bar under a torque of 3 N m, and where it rests."""
    m = braced("mixed", 3.0)
    return m, alfmu.equilibrium(m).nearest


def differences(change, step: float) -> np.ndarray:
    """Derivative at 0 of a function of one number by central differences of order four."""
    far, near = ((change(k * step) - change(-k * step)) / (2 * k * step) for k in (2, 1))
    return (4 * near - far) / 3


# Positions of rest --------------------------------------------------------------------------------------------------


def test_a_pendulum_rests_below_and_above():
    found = alfmu.equilibrium(pendulum())
    assert sorted(each.coordinates["th"] for each in found) == pytest.approx([-np.pi / 2, np.pi / 2], abs=1e-12)
    by_angle = {round(each.coordinates["th"]): each for each in found}
    assert by_angle[-2].stability == "asymptotically stable"
    assert by_angle[2].stability == "unstable"
    assert alfmu.equilibrium(pendulum(0.0)).stable[0].stability == "stable"
    assert found.nearest is by_angle[-2]
    assert all(each.connected and each.isolated for each in found)


def test_inputs_and_time_are_held_where_they_are_given():
    hold = 2 * G * 0.35 * 0.5  # at 60 degrees from below
    found = alfmu.equilibrium(pendulum(), parameters={"A.torque": hold})
    assert found.nearest.coordinates["th"] == pytest.approx(-np.pi / 2 + np.pi / 6, abs=1e-12)
    m = pendulum()
    m.torque(m.bodies[0], hold * m.time)
    assert alfmu.equilibrium(m, time=1.0).nearest.coordinates["th"] == pytest.approx(-np.pi / 3, abs=1e-12)
    assert len(alfmu.equilibrium(m, time=3.0)) == 0  # more than gravity can balance


@pytest.mark.slow
def test_positions_of_rest_take_inputs_as_runs_do(tmp_path, capsys):
    """The torque that holds the bar at -60 degrees, m g l/2 cos, as a number, a function of time and a table."""
    for signal, time in ((HOLD, 0.0), (lambda t: t * HOLD, 1.0), (([0.0, 4.0], [0.0, 2 * HOLD]), 2.0)):
        found = alfmu.equilibrium(pendulum(), inputs={"A.torque": signal}, time=time)
        assert found.nearest.coordinates["th"] == pytest.approx(-np.pi / 3, abs=1e-12)
        assert "th = -1.0472 (-60 deg)" in "\n".join(found.lines())
        with pytest.raises(alfmu.InputError, match=r"has no input 'A.torqe'; did you mean A.torque\?"):
            alfmu.equilibrium(pendulum(), inputs={"A.torqe": signal})
    (tmp_path / "inputs.csv").write_text("time,A.torque\n0,0\n4,1\n")
    assert main(["equilibrium", "five_bar", "--input", str(tmp_path / "inputs.csv"), "--at", "2"]) == 0
    assert "inputs: A.torque = 0.5, D.torque = 0" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["joint", "mixed", "absolute"])
def test_a_four_bar_with_a_spring_rests_and_swings_as_its_reduction_does(coordinates):
    """The position to 1e-11 rad, eigenvalues to 1e-10 of themselves, with and without a torque."""
    name = {"joint": "th1", "mixed": "th1", "absolute": "crank_angle"}[coordinates]
    for torque in (0.0, 3.0):
        m = braced(coordinates, torque)
        found = [each for each in alfmu.equilibrium(m) if each.connected and each.stable]
        (rest,) = found[:1]
        with mp.workdps(40):
            th, J, D, K = reduced(torque)
            exact = [complex((-D + sign * mp.sqrt(mp.mpc(D**2 - 4 * J * K))) / (2 * J)) for sign in (1, -1)]
        assert rest.coordinates[name] == pytest.approx(float(th), abs=1e-11)
        values = alfmu.linearize(m, rest).eigenvalues
        assert np.abs(np.sort_complex(values) - np.sort_complex(exact)).max() < 1e-10 * abs(exact[0])
        assert np.abs(np.sort_complex(rest.eigenvalues) - np.sort_complex(exact)).max() < 1e-10 * abs(exact[0])


@pytest.mark.slow
def test_redundant_constraints_and_massless_links_change_nothing_of_a_position_of_rest():
    """The five-bar, which starts at a singular position, against the pendulum that it is equal to."""
    for masses in ({}, {"m1": 0.0, "m3": 0.0}, {"m2": 0.0, "m4": 0.0}):
        linkage = Parallelogram(**masses)
        stable, unstable = alfmu.equilibrium("five_bar", parameters=masses)
        rate = np.sqrt(float(linkage.weight / linkage.inertia))
        assert stable.coordinates["th1"] == pytest.approx(-np.pi / 2, abs=1e-12)
        assert stable.frequencies == pytest.approx([rate / (2 * np.pi)], rel=1e-12)
        assert unstable.eigenvalues.real.max() == pytest.approx(rate, rel=1e-12)
        assert stable.residual < 1e-12
        exact = linkage.forces(-np.pi / 2, 0.0)
        assert {name: stable.outputs[name] for name in exact} == pytest.approx(exact, abs=1e-11)


@pytest.mark.slow
def test_positions_on_other_branches_are_reached_and_other_assemblies_are_told():
    rests = alfmu.equilibrium("slider_crank")
    assert [(round(each.coordinates["x3"], 6), each.connected) for each in rests] == [
        (0.866025, True),
        (-0.866025, False),
        (0.866025, True),
        (-0.866025, False),
    ]
    assert [each.stable for each in rests] == [False, False, True, True]
    # With equal links the pin of a slider-crank lies on the axle of the crank and stays there: a branch of its own.
    equal = alfmu.equilibrium("slider_crank", parameters={"l1": 0.5, "l2": 0.5})
    assert {round(each.coordinates["x3"], 6) for each in equal if each.connected} >= {0.0}


@pytest.mark.slow
def test_a_spring_that_loses_its_length_on_the_way_hides_no_position_and_makes_none():
    """A folding stool, whose spring has no direction where its feet meet."""
    m = alfmu.Mechanism("stool")
    legs = [m.bar(name, mass=2.0, length=0.7) for name in "ab"]
    m.revolute("A", m.ground.at(), legs[0].start, coordinate=m.coordinate("th", start=0.8, independent=True))
    m.revolute("X", legs[0].at(0.35), legs[1].at(0.35), coordinate=m.coordinate("q", start=1.6))
    m.point_on_line("foot", m.ground.at(), legs[1].start)
    m.spring_damper((legs[0].start, legs[1].start), stiffness=800.0, rest=0.45)
    m.gravity(0, -G)
    found = [each.coordinates["th"] % (2 * np.pi) for each in alfmu.equilibrium(m) if each.connected]
    th = np.linspace(0, 2 * np.pi, 100001)
    potential = 4 * G * 0.35 * np.sin(th) + 400 * (abs(0.7 * np.cos(th)) - 0.45) ** 2
    still = th[1:-1][np.diff(potential)[1:] * np.diff(potential)[:-1] <= 0]
    still = still[abs(np.cos(still)) > 1e-3]  # without the corners of the potential
    assert np.sort(found) == pytest.approx(still, abs=1e-4)


def test_where_a_spring_has_no_length_nothing_is_linearised():
    m, bar, *_ = hinged("flap", length=0.5, weight=0.0, start=0.0, independent=True)
    m.spring_damper((m.ground.at(0.5, 0), bar.end), stiffness=100.0, rest=0.1)
    m.gravity(0, -G)
    with pytest.raises(alfmu.InputError, match="flap, t = 0 s: loads or their derivatives are not finite"):
        alfmu.linearize(m)


def test_a_singular_position_of_rest_is_not_judged():
    rest = alfmu.equilibrium("four_bar", parameters={"g": 0.0, "start.angular_velocity": 0.0}, starts=0)[0]
    assert rest.stability == "not judged"
    assert "singular" in rest.reason
    assert "2 velocities" in rest.reason


def test_without_loads_every_position_is_one_of_rest():
    found = alfmu.equilibrium("particle_on_circle")
    assert len(found) == 1
    assert not found[0].isolated
    assert found[0].stability == "not judged"
    assert "every position" in found.lines()[-1]


def test_the_spin_of_rods_that_no_load_turns_does_not_make_many_positions_of_one():
    m = alfmu.Mechanism("wheel_and_bar")
    for name, center in (("wheel", (0.0, 0.0)), ("arm", (0.4, 0.0))):
        body = m.body(name, mass=1.0, inertia=0.1, center=center)
        free = m.coordinate(f"{name}_angle", "rad", start=0.2, independent=True)
        m.revolute(f"{name}_hinge", m.ground.at(0, 0), body.at(0, 0), coordinate=free)
    m.gravity(0.0, -G)
    found = alfmu.equilibrium(m)
    assert sorted(round(each.coordinates["arm_angle"], 9) for each in found) == pytest.approx([-np.pi / 2, np.pi / 2])
    assert not any(each.isolated for each in found)
    assert [each.stability for each in found if each.coordinates["arm_angle"] > 0] == ["unstable"]
    assert [each.stability for each in found if each.coordinates["arm_angle"] < 0] == ["not judged"]


@pytest.mark.slow
def test_gears_turn_round_together_before_a_position_comes_again():
    """Wheels of ratio 2 to 3: three turns of one and two of the other."""
    m = alfmu.Mechanism("geared")
    wheels = [m.body(name, mass=mass, inertia=0.1, center=(0.2, 0.0)) for name, mass in (("a", 1.0), ("b", 2.1))]
    for k, wheel in enumerate(wheels):
        angle = m.coordinate(f"t{wheel.name}", "rad", start=0.2 * (1 - k), independent=not k)
        m.revolute(wheel.name.upper(), m.ground.at(k, 0), wheel.at(), coordinate=angle)
    m.gear("G", wheels[0].at(), wheels[1].at(), radii=(0.4, 0.6))
    m.gravity(0.0, -G)
    found = alfmu.equilibrium(m)
    # cos(ta) = 2.1 (2/3) cos(tb) with tb = offset - (2/3) ta: sign changes over three turns of a.
    ta = np.linspace(0.1, 0.1 + 6 * np.pi, 20_001)
    offset = found[0].coordinates["tb"] + 2 / 3 * found[0].coordinates["ta"]
    load = np.cos(ta) - 1.4 * np.cos(offset - 2 / 3 * ta)
    assert len(found) == np.count_nonzero(np.diff(np.sign(load)))
    for each in found:
        at = each.coordinates["ta"]
        assert np.cos(at) == pytest.approx(1.4 * np.cos(offset - 2 / 3 * at), abs=1e-11)


def test_a_body_on_a_ball_joint_swings_with_its_closed_frequencies_and_spins_freely():
    """In Euler parameters, whose signs and spin make no further positions of rest."""
    m = alfmu.Mechanism("ball")
    body = m.spatial_body(
        "b",
        mass=2.0,
        inertia=(0.05, 0.08, 0.03),
        position=(-0.5 * np.sin(0.2), 0.0, -0.5 * np.cos(0.2)),
        attitude=(np.cos(0.1), 0.0, np.sin(0.1), 0.0),
    )
    m.spherical("S", m.spatial_ground.at(), body.at(0.0, 0.0, 0.5))
    m.gravity(0.0, 0.0, -G)
    below, above = alfmu.equilibrium(m)
    exact = np.sqrt(2.0 * G * 0.5 / (np.array([0.08, 0.05]) + 2.0 * 0.5**2))
    assert below.frequencies * 2 * np.pi == pytest.approx(exact, rel=1e-11)
    assert above.eigenvalues.real.max() == pytest.approx(exact[1], rel=1e-11)
    assert (below.stability, above.stability) == ("not judged", "unstable")
    assert not below.isolated
    assert alfmu.linearize(m, below).values["S.force.z"] == pytest.approx(2.0 * G, rel=1e-12)
    assert alfmu.mobility(m, stop_time=0.0).freedom == 3


@pytest.mark.slow
def test_a_run_starts_at_rest_and_stays_there():
    m, rest = held()
    for start in ("equilibrium", rest):
        run = alfmu.simulate(m, 1.0, 0.1, start=start)
        assert np.ptp(run["crank.angle"]) < 1e-10
        assert run["crank.angle"][0] == pytest.approx(rest.coordinates["th1"], abs=1e-12)
    assert np.ptp(alfmu.simulate(m, 2.0, 0.1)["crank.angle"]) > 0.1
    run = alfmu.simulate(m, 0.2, 0.1, start="equilibrium", inputs={"crank.torque": 0.0})
    assert run["crank.angle"][0] == pytest.approx(float(reduced(0.0)[0]), abs=1e-10)


# Linearisation -------------------------------------------------------------------------------------------------------


def test_a_pendulum_is_linearised_to_its_closed_form():
    inertia, weight, c = 2 * 0.7**2 / 3, 2 * G * 0.35, 0.05
    lin = alfmu.linearize(pendulum(), "equilibrium")
    assert lin.states == ("th", "der(th)")
    assert lin.inputs == ("A.torque",)
    assert np.abs(lin.A - [[0, 1], [-weight / inertia, -c / inertia]]).max() < 1e-12 * weight / inertia
    assert np.abs(lin.B - [[0], [1 / inertia]]).max() < 1e-12 / inertia
    row = lin.outputs.index("bar.angular_acceleration")
    assert np.abs(lin.C[row] - lin.A[1]).max() < 1e-12 * weight / inertia
    assert np.abs(lin.D[row] - lin.B[1]).max() < 1e-12 / inertia
    (mode,) = lin.modes
    assert mode.frequency == pytest.approx(np.sqrt(weight / inertia - (c / inertia / 2) ** 2) / (2 * np.pi), rel=1e-12)
    assert mode.damping == pytest.approx(c / 2 / np.sqrt(weight * inertia), rel=1e-11)
    assert mode.time_constant == pytest.approx(2 * inertia / c, rel=1e-11)
    assert lin.at_rest
    start = alfmu.linearize(pendulum())
    assert not start.at_rest
    assert start.drift[1] == pytest.approx(-weight * np.cos(0.3) / inertia, rel=1e-12)
    assert start.A[1, 0] == pytest.approx(weight * np.sin(0.3) / inertia, rel=1e-12)


def test_a_double_pendulum_swings_with_its_closed_frequencies_and_shapes():
    """In coordinates of which constraints close the elbow; absolute angles of two bars of 1 m and 1 kg."""
    M = np.array([[4 / 3, 1 / 2], [1 / 2, 1 / 3]])
    squares, shapes = eigh(G * np.diag([3 / 2, 1 / 2]), M)
    found = alfmu.equilibrium(scenes.double_pendulum())
    assert len(found) == 4
    assert [each.stability for each in found].count("unstable") == 3
    lin = alfmu.linearize(scenes.double_pendulum(), found.nearest)
    rates = np.array([mode.eigenvalue for mode in lin.modes])
    assert np.abs(rates - 1j * np.sqrt(squares)).max() < 1e-12 * np.sqrt(squares.max())
    for mode, exact in zip(lin.modes, shapes.T, strict=True):
        ratio = mode.shape["angle"] / mode.shape["th"]
        assert ratio == pytest.approx(exact[1] / exact[0], rel=1e-11)
        assert mode.shape["x"] == pytest.approx(mode.shape["th"] + mode.shape["angle"] / 2, abs=1e-11)


@pytest.mark.slow
def test_small_runs_respond_as_the_linear_system_does():
    """What is left falls with the square of the amplitude."""
    (m, rest), times = held(), np.arange(0.0, 1.0001, 0.01)
    lin = alfmu.linearize(m, rest, outputs=["crank.angle", "TH4.force.*"])
    exact = {"solver.relative_tolerance": 1e-12}
    left = []
    for size in (1e-2, 1e-3):
        run = alfmu.simulate(m, 1.0, 0.01, start=rest, inputs={"crank.torque": 3.0 + size}, parameters=exact)
        _, y, _ = lsim(lin.to_scipy(), np.full((101, 1), size), times)
        base = np.array([lin.values[name] for name in lin.outputs])
        runs = np.column_stack([run[name] for name in lin.outputs]) - base
        left.append(np.abs(runs - y).max(axis=0) / np.abs(y).max(axis=0))
    assert (left[0] < 5e-3).all()
    assert (left[1] < left[0] / 9).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["five_bar", "bennett", "slider_crank"])
def test_along_a_motion_outputs_change_as_the_matrices_say(name):
    """Of states beside the start in motion: all outputs, shared reactions among them, by differences of instances."""
    m = alfmu.load(name)
    if name == "five_bar":
        m.compliances()
    equations = alfmu.derive(m)
    given = {"start.angle": 0.7, "start.angular_velocity": 1.3}
    given |= {v.name: 10.0 ** (-6 - k % 3) for k, v in enumerate(equations.compliances)}
    lin = alfmu.linearize(equations, parameters=given)
    assert not lin.at_rest

    def outputs(key: str):
        def read(change: float) -> np.ndarray:
            i = scenes.started(equations, {**given, key: given.get(key, 0.0) + change})
            values = scenes.readings(i)
            return np.array([values[each] for each in lin.outputs])

        return read

    keys = ["start.angle", "start.angular_velocity"]
    size = 1 + np.abs(lin.C).max(axis=1)
    assert lin.states == ("th1", "der(th1)")
    for column, key in enumerate(keys):
        error = np.abs(differences(outputs(key), 1e-3) - lin.C[:, column]) / size
        assert error.max() < 1e-8, lin.outputs[int(error.argmax())]
    for column, each in enumerate(lin.inputs):
        error = np.abs(differences(outputs(each), 1e-1) - lin.D[:, column]) / (1 + np.abs(lin.D[:, column]))
        assert error.max() < 1e-9, lin.outputs[int(error.argmax())]
    values = scenes.readings(scenes.started(equations, given))
    found = np.array([values[each] - lin.values[each] for each in lin.outputs])
    assert np.abs(found).max() < 1e-9 * (1 + max(map(abs, lin.values.values())))


@pytest.mark.slow
def test_an_array_of_instants_is_a_list_of_them():
    found = alfmu.linearize(pendulum(), np.array([0.0, 0.1]))
    assert [each.time for each in found] == [0.0, 0.1]
    assert alfmu.linearize(pendulum(), np.array(0.1)).time == 0.1


def test_an_instance_and_instants_of_a_motion_are_linearised_where_they_are():
    first, later = alfmu.linearize("slider_crank", [0.0, 0.25])
    assert later.time == 0.25
    i = alfmu.Instance("slider_crank")
    i.initialize()
    assert np.array_equal(alfmu.linearize(i).A, first.A)
    for _ in range(25):
        i.step(0.01)
    q = i.q.copy()
    here = alfmu.linearize(i)
    assert np.abs(here.A - later.A).max() < 1e-4
    assert here.values["th1"] == q[2]
    assert np.array_equal(i.q, q)
    assert alfmu.mobility(i).freedom == 1
    assert np.array_equal(i.q, q)


@pytest.mark.slow
def test_an_fmu_in_fmpy_changes_as_the_matrices_say(exported):
    """Outputs of an FMU after its initialisation, by differences of start values and of an input."""
    path = exported("slider_crank")
    description = fmpy.read_model_description(str(path))
    references = {v.name: v.valueReference for v in description.modelVariables}
    given = {"start.angle": 0.6, "start.angular_velocity": 2.0, "A.torque": 1.5, "slider.force": -0.5}
    lin = alfmu.linearize("slider_crank", parameters=given)
    assert set(lin.outputs) <= set(references)
    assert lin.states == ("th1", "der(th1)")
    folder = fmpy.extract(str(path))
    fmu = fmpy.instantiate_fmu(folder, description, "CoSimulation")
    try:

        def read(key: str, change: float) -> np.ndarray:
            values = {**given, key: given[key] + change}
            fmu.reset()
            fmu.setupExperiment(startTime=0.0)
            fmu.setReal([references[name] for name in values], list(values.values()))
            fmu.enterInitializationMode()
            fmu.exitInitializationMode()
            return np.array(fmu.getReal([references[name] for name in lin.outputs]))

        assert np.abs(read("A.torque", 0.0) - [lin.values[name] for name in lin.outputs]).max() < 1e-10
        expected = [*lin.C.T, *lin.D.T]
        for key, column in zip(given, expected, strict=True):
            found = differences(lambda change, key=key: read(key, change), 1e-3)
            assert np.abs(found - column).max() < 1e-8 * (1 + np.abs(column).max()), key
        row = lin.outputs.index("crank.angular_acceleration")
        assert differences(lambda change: read("start.angle", change)[row], 1e-3) == pytest.approx(
            lin.A[1, 0], rel=1e-8
        )
    finally:
        fmu.terminate()
        fmu.freeInstance()


def test_a_recipe_that_starts_at_rest_gives_an_fmu_that_does(tmp_path):
    path = alfmu.export(pendulum(), tmp_path, start="equilibrium", parameters={"A.torque": 2.0}, reference=False)
    rest = -np.arccos(2.0 / (2 * G * 0.35))
    starts = {v.name: v.start for v in fmpy.read_model_description(str(path)).modelVariables}
    assert float(starts["start.th"]) == pytest.approx(rest, abs=1e-12)
    run = fmpy.simulate_fmu(str(path), stop_time=1.0, output_interval=0.1, output=["bar.angle"])
    assert np.abs(run["bar.angle"] - rest).max() < 1e-9


def test_linearisations_are_saved_for_others(tmp_path):
    lin = alfmu.linearize("slider_crank", "equilibrium", outputs=["slider.*"])
    lin.save(tmp_path / "one.json")
    data = json.loads((tmp_path / "one.json").read_text())
    assert np.array_equal(data["A"], lin.A)
    assert data["outputs"] == list(lin.outputs)
    assert data["modes"][0]["frequency"] == lin.modes[0].frequency
    lin.save(tmp_path / "one.mat")
    found = loadmat(tmp_path / "one.mat", squeeze_me=True)
    for name in "ABCD":
        assert np.array_equal(found[name], getattr(lin, name))
    assert list(found["states"]) == ["th1", "der(th1)"]
    several = alfmu.linearize(pendulum(), [0.1, 0.2, 0.3])
    alfmu.analysis.linearization.save(several, tmp_path / "several.mat")
    found = loadmat(tmp_path / "several.mat", squeeze_me=True)
    assert found["A"].shape == (2, 2, 3)
    assert np.array_equal(found["A"][:, :, 1], several[1].A)
    space = lin.to_scipy()
    assert np.array_equal(space.A, lin.A)
    assert np.array_equal(space.D, lin.D)


@pytest.mark.slow
def test_python_control_gets_the_names():
    pytest.importorskip("control")
    lin = alfmu.linearize("slider_crank", "equilibrium", outputs=["slider.position"])
    system = lin.to_control()
    assert system.input_labels == ["A_torque", "slider_force"]
    assert system.output_labels == ["slider_position"]
    assert np.array_equal(system.A, lin.A)
    values = np.sort_complex(system.poles())
    assert np.abs(values - np.sort_complex(lin.eigenvalues)).max() < 1e-12


def test_the_film_of_a_mode_keeps_the_loops_closed(tmp_path):
    lin = alfmu.linearize(*held())
    lin.film(tmp_path / "mode.gif", 1, amplitude=0.4, fps=10)
    with Image.open(tmp_path / "mode.gif") as film:
        assert film.n_frames == 21
    run = motion_of(lin.situation, lin.modes[0].shape, 0.4)
    assert np.ptp(run["crank.angle"]) > 0.3
    for first, second, ends in (("crank", "coupler", (0.4, -0.9)), ("coupler", "rocker", (0.9, 0.7))):
        places = [
            (run[f"{b}.x"] + end / 2 * np.cos(run[f"{b}.angle"]), run[f"{b}.y"] + end / 2 * np.sin(run[f"{b}.angle"]))
            for b, end in zip((first, second), ends, strict=True)
        ]
        assert np.abs(np.subtract(*places)).max() < 1e-11
    assert run["crank.angle"][0] == pytest.approx(run["crank.angle"][-1], abs=1e-11)


@pytest.mark.slow
def test_further_states_rest_and_are_linearised_with_the_motion():
    """A pendulum on a motor: its current settles, and stands behind coordinates and rates."""
    m = pendulum()
    voltage, current = m.input("voltage", "1", start=1.0), m.state("current", "1", start=0.3)
    th = m.coordinates[0].q
    m.derivative(current, (voltage - 0.5 * current - 0.2 * m.rate(th)) / 0.01)
    m.drive(m.joints[0], 0.2 * current)
    inertia, weight = 2 * 0.7**2 / 3, 2 * G * 0.35
    rest = alfmu.equilibrium(m).nearest
    angle = -np.arccos(0.2 * 2.0 / weight)
    assert rest.coordinates["th"] == pytest.approx(angle, abs=1e-12)
    assert rest.states == {"current": 2.0}
    lin = alfmu.linearize(m, rest)
    assert lin.states == ("th", "der(th)", "current")
    exact = [[0, 1, 0], [weight * np.sin(angle) / inertia, -0.05 / inertia, 0.2 / inertia], [0, -20, -50]]
    assert np.abs(lin.A - exact).max() < 1e-11
    assert np.abs(lin.B[:, lin.inputs.index("voltage")] - [0, 0, 100]).max() < 1e-11
    run = alfmu.simulate(m, 1.0, 0.1, start="equilibrium")
    assert np.ptp(run["bar.angle"]) < 1e-9
    controlled = pendulum()
    integral = controlled.state("integral", "1")
    error = 0.5 - controlled.coordinates[0].q
    controlled.derivative(integral, error)
    lagging = controlled.state("lagging", "1")
    controlled.derivative(lagging, (integral + 20 * error - lagging) / 0.01)
    controlled.drive(controlled.joints[0], lagging)
    held = weight * np.cos(0.5)
    trimmed = alfmu.equilibrium(controlled).nearest
    assert trimmed.coordinates["th"] == pytest.approx(0.5, abs=1e-11)
    assert trimmed.states == pytest.approx({"integral": held, "lagging": held}, rel=1e-9)
    run = alfmu.simulate(controlled, 0.5, 0.1, start="equilibrium")
    assert np.ptp(run["bar.angle"]) < 1e-9
    assert len(alfmu.linearize(controlled).eigenvalues) == 4
    assert alfmu.mobility(controlled, stop_time=0.0).freedom == 1
    alone = alfmu.Mechanism("filter")
    filtered = alone.state("filtered", "1")
    alone.derivative(filtered, (alone.input("raw", "1", start=2.0) - filtered) / 0.1)
    (settled,) = alfmu.equilibrium(alone)
    assert (settled.coordinates, settled.states, settled.stable) == ({}, {"filtered": 2.0}, True)
    lin = alfmu.linearize(alone)
    assert (lin.A.tolist(), lin.B.tolist(), lin.states) == ([[-10.0]], [[10.0]], ("filtered",))


# Degrees of freedom --------------------------------------------------------------------------------------------------


def test_redundant_constraints_are_named_with_those_they_depend_on():
    """What the paper says of the five-bar: rows 2, 4, 6 and 8 are unique, one of 1, 3, 5 and 7 is redundant."""
    found = alfmu.mobility("five_bar", stop_time=0.0)
    assert (found.freedom, found.redundant, found.freedom_here) == (1, 1, 2)
    assert [(set(group.rows), group.redundant) for group in found.groups] == [({"B x", "C x", "E x", "F x"}, 1)]
    assert alfmu.mobility("slider_crank", stop_time=0.0).groups == ()
    m = braced("mixed")
    m.distance("again", m.ground.at(0, 0), m.bodies[1].start, length=LENGTHS[0])
    twice = alfmu.mobility(m, stop_time=0.0)
    assert twice.redundant == 1
    assert [set(group.rows) for group in twice.groups] == [{"again length", "TH2 x", "TH2 y"}]


@pytest.mark.slow
def test_constraints_that_hold_nothing_or_are_off_are_named():
    m = alfmu.load("four_bar")
    m.lock("A")
    m.constraint("slack", m.parameter("k", 0.0) * m.coordinates[0].q, "rad")
    found = alfmu.mobility(m, stop_time=0.0)
    assert found.off == ("A locked",)
    assert found.idle == ("slack",)
    locked = alfmu.mobility(m, stop_time=1.0, parameters={"start.angle": 0.5}, inputs={"A.locked": lambda t: t > 0.5})
    assert [freedom for _, freedom in locked.changes] == [0]
    assert locked.changes[0][0] == pytest.approx(0.5, abs=0.05)


def test_singular_positions_on_the_way_have_their_branches():
    """The four-bar of equal links: at th = 0 it folds about B = D, at th = -pi about A = C; times by an integrator."""
    found = alfmu.mobility("four_bar", stop_time=1.6)
    linkage = Parallelogram(m4=None)
    weight, inertia = float(linkage.weight), float(linkage.inertia)

    def aligned(t, y):
        return np.sin(y[0])

    motion = solve_ivp(
        lambda t, y: [y[1], -weight * np.cos(y[0]) / inertia],
        (0, 1.6),
        (0.0, 2.0),
        events=aligned,
        rtol=1e-12,
        atol=1e-12,
    )
    times = motion.t_events[0][motion.t_events[0] > 1e-6]
    assert [each.time for each in found.singular] == pytest.approx(times, abs=1e-5)
    for each in [found.start, *found.singular]:
        here = np.cos(each.coordinates["th1"])
        assert each.coordinates["th1"] == pytest.approx(0.0 if here > 0 else -np.pi, abs=1e-10)
        ways = [{name: round(x, 6) + 0.0 for name, x in branch.way.items()} for branch in each.branches]
        fold = {"th1": 0.0, "x2": 0.0, "y2": 0.5, "th2": 1.0, "th3": 1.0}
        if here < 0:
            fold = {"th1": 1.0, "x2": 0.0, "y2": -0.5, "th2": 1.0, "th3": 0.0}
        assert fold in ways
        followed = ways[each.followed]
        assert followed["th1"] == pytest.approx(followed["th3"])
        assert followed["th2"] == 0.0
        assert each.motions == len(each.branches) == 2


def test_a_velocity_that_leads_nowhere_is_no_branch_and_one_that_stays_singular_is_told():
    five = alfmu.mobility("five_bar", stop_time=0.0).start
    assert five.motions == 2
    assert len(five.branches) == 1  # link 4 keeps the fold of the four-bar from going on
    row = alfmu.mobility("n_four_bar", stop_time=0.0, parameters={"start.angle": 0.0}).start
    stays = [branch for branch in row.branches if branch.singular]
    assert len(row.branches) == 3
    assert len(stays) == 1
    assert abs(stays[0].way["y3"]) == 1.0
    assert {name for name, x in stays[0].way.items() if abs(x) > 1e-6} == {"y3"}


def test_what_cannot_be_judged_is_said():
    many = scenes.double_pendulum()
    assert alfmu.mobility(many, stop_time=0.0).start is None
    with pytest.raises(alfmu.InputError, match="singular, 2 motions begin there instead of 1"):
        alfmu.linearize("five_bar")
    rest = alfmu.equilibrium("four_bar", parameters={"g": 0.0, "start.angular_velocity": 0.0}, starts=0)
    with pytest.raises(alfmu.InputError, match="singular"):
        alfmu.linearize("four_bar", rest[0])


# Mistakes and the command line ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: alfmu.equilibrium("five_bar", starts=-1), "starts is -1; it must be a whole number"),
        (lambda: alfmu.equilibrium("five_bar", time=np.nan), "the time is nan"),
        (lambda: alfmu.equilibrium("five_bar", parameters={"mm": 1.0}), "no input or parameter 'mm'"),
        (lambda: alfmu.equilibrium("made.fmu"), "an FMU does not contain its equations"),
        (lambda: alfmu.linearize("five_bar", "rest"), "it must be start, equilibrium, or times"),
        (lambda: alfmu.linearize("five_bar", -1.0), "it must be start, equilibrium, or times"),
        (lambda: alfmu.linearize("five_bar", []), "it must be start, equilibrium, or times"),
        (lambda: alfmu.linearize("slider_crank", outputs=["crank.angel"]), "did you mean crank.angle"),
        (lambda: alfmu.linearize("slider_crank", inputs={"A.torqe": 1.0}), "did you mean A.torque"),
        (lambda: alfmu.linearize("slider_crank").save("x.csv"), "must end in .json or .mat"),
        (lambda: alfmu.linearize("slider_crank").film("x.gif", 7), "there is no mode 7; it has 2 modes"),
        (lambda: alfmu.linearize("slider_crank").film("x.gif", amplitude=-1.0), "the amplitude is -1"),
        (lambda: alfmu.linearize(alfmu.Instance("slider_crank")), "call initialize"),
        (lambda: alfmu.simulate("slider_crank", start="rest"), "declared or equilibrium, or an Equilibrium"),
        (lambda: alfmu.simulate("five_bar", start=alfmu.equilibrium(pendulum())[0]), "other coordinates"),
        (lambda: alfmu.equilibrium(pendulum(), parameters={"A.torque": 9.0}).nearest, "no position of rest was found"),
        (lambda: alfmu.Recipe("five_bar", start="rest"), "it must be declared or equilibrium"),
        (lambda: alfmu.equilibrium("five_bar", parameters=["m1"]), "five_bar: the parameters are ['m1']; give a dict"),
        (lambda: alfmu.equilibrium(pendulum(), starts=1.5), "pendulum: starts is 1.5"),
        (lambda: alfmu.equilibrium(alfmu.Recipe("five_bar"), starts=1.5), "five_bar: starts is 1.5"),
        (lambda: alfmu.linearize("slider_crank", None), "at is None; it must be start, equilibrium, or times"),
        (lambda: alfmu.linearize("slider_crank", inputs=["A.torque"]), "the inputs are ['A.torque']; give a dict"),
        (lambda: alfmu.linearize("slider_crank", inputs={"A.torque": "1"}), "the signal of A.torque is '1'; give a"),
        (lambda: alfmu.linearize("slider_crank", outputs=5), "the outputs are 5; give names or patterns in a list"),
        (lambda: alfmu.mobility("slider_crank", stop_time="long"), "the stop time is 'long' s; it must be a finite"),
        (lambda: alfmu.mobility("slider_crank", parameters=[1]), "the parameters are [1]; give a dictionary"),
        (lambda: alfmu.simulate("slider_crank", 1.0, "fine"), "the step is 'fine' s; it must be a finite number"),
        (lambda: alfmu.linearize("five_bar", alfmu.equilibrium(pendulum())[0]), "which has other coordinates"),
        (
            lambda: alfmu.linearize(pendulum(), alfmu.equilibrium(pendulum())[0], inputs={"A.torque": 1.0}),
            "parameters and inputs are part of a position of rest; give them to equilibrium()",
        ),
        (lambda: alfmu.simulate("slider_crank", outputs=[3]), "the outputs are [3]; give a list of names"),
        (lambda: alfmu.simulate("slider_crank", freeze="l1"), "the parameters to freeze are 'l1'; give a list"),
        (lambda: alfmu.sweep("slider_crank", {"l1": "1,2"}, freeze=3), "the parameters to freeze are 3; give a list"),
        (
            lambda: alfmu.simulate("slider_crank", parameters={3: 1.0}),
            "one of the parameters is called 3; a name is a text",
        ),
        (lambda: alfmu.simulate("slider_crank", parameters={"l1": [1.0]}), "l1 is [1.0]; it must be a finite number"),
        (lambda: alfmu.linearize("five_bar", parameters={"solver.method": ["rk4"]}), "solver.method is ['rk4']; use"),
        (lambda: alfmu.derivatives("five_bar", ["m1"], outputs="A.force.x"), "the outputs are 'A.force.x'; give a"),
        (
            lambda: alfmu.simulate("slider_crank", 1.0, 0.1, inputs={"A.torque": ([np.nan], [1.0])}),
            "the signal of A.torque has times that do not rise, or are not finite; give them in order",
        ),
        (
            lambda: alfmu.simulate("slider_crank", 1.0, 0.1, inputs={"A.torque": ([0.0, 1.0], [0.0])}),
            "the signal of A.torque has times of shape (2,) and values of shape (1,); give one value for each time",
        ),
        (
            lambda: alfmu.simulate("slider_crank", 1.0, 0.1, inputs={"A.torque": ([1.0, 0.0], [0.0, 1.0])}),
            "the signal of A.torque has times that do not rise, or are not finite; give them in order",
        ),
    ],
)
def test_a_mistake_is_answered_by_what_was_given_and_what_is_possible(call, says):
    with pytest.raises(alfmu.InputError) as error:
        call()
    assert says in str(error.value)


@pytest.mark.slow
def test_the_command_line_shows_writes_and_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("hung.py").write_text(
        "from alfmu import Mechanism\nm = Mechanism('hung')\nbar = m.bar('bar', mass=2.0, length=0.7)\n"
        "th = m.coordinate('th', 'rad', start=0.3, independent=True)\n"
        "A = m.revolute('A', m.ground.at(0, 0), bar.start, coordinate=th)\n"
        "m.drive(A, m.input('A.torque', 'N.m'))\nm.gravity(0.0, -9.81)\n"
    )
    assert main(["equilibrium", "slider_crank", "--set", "A.torque=2", "-o", "e.json", "--draw", "e.png"]) == 0
    said = capsys.readouterr().out
    assert "4 positions of rest" in said
    assert "no path from the start found" in said
    assert len(json.loads(Path("e.json").read_text())["equilibria"]) == 4
    with Image.open("e.png") as picture:
        assert picture.size == (640, 480)
    arguments = ["--at", "equilibrium", "-o", "l.mat", "--plot", "l.png", "--film", "l.html", "--outputs", "bar.angle"]
    assert main(["linearize", "hung.py", *arguments]) == 0
    said = capsys.readouterr().out
    assert f"{np.sqrt(1.5 * G / 0.7) / (2 * np.pi):.6g}" in said
    assert "wrote l.mat" in said
    assert loadmat("l.mat")["C"].shape == (1, 2)
    with Image.open("l.png") as picture:
        assert picture.size[0] > 500
    assert "<script" in Path("l.html").read_text()
    assert main(["linearize", "hung.py", "--at", "0,0.1", "--json", "-o", "l.json"]) == 0
    captured = capsys.readouterr()
    assert [each["time"] for each in json.loads(captured.out)] == [0.0, 0.1]
    assert "wrote l.json" in captured.err
    assert main(["mobility", "five_bar", "--stop-time", "0"]) == 0
    said = capsys.readouterr().out
    assert "1 of 4: B x, C x, E x, F x" in said
    assert "singular at the start" in said
    assert main(["mobility", "hung.py", "--stop-time", "0.2", "-o", "m.json"]) == 0
    assert "no singular position" in capsys.readouterr().out
    assert json.loads(Path("m.json").read_text())["freedom"] == 1
    assert main(["simulate", "hung.py", "--start", "equilibrium", "--stop-time", "0.1"]) == 0
    assert "start at rest: stable, th = -1.5708" in capsys.readouterr().out
    table = np.loadtxt("hung.csv", delimiter=",", skiprows=1)
    assert np.ptp(table[:, 1:7], axis=0).max() < 1e-10
    assert main(["linearize", "five_bar"]) == 1
    assert "small motions are not linear" in capsys.readouterr().err
    assert main(["linearize", "hung.py", "--at", "0,1", "--film", "x.gif"]) == 1
    assert "one state" in capsys.readouterr().err


@pytest.mark.parametrize("load", [-5.0, 25.0])
def test_a_drum_on_a_soft_spring_rests_many_turns_away(load: float):
    """Load over stiffness, 50 and 250 rad from the start."""
    m = alfmu.Mechanism("drum")
    drum = m.body("drum", mass=1.0, inertia=0.1)
    turn = m.coordinate("turn", "rad", independent=True)
    axle = m.revolute("axle", m.ground.at(0, 0), drum.at(0, 0), coordinate=turn)
    m.spring_damper(axle, stiffness=0.1)
    m.drive(axle, load)
    m.gravity(0, 0)
    (rest,) = alfmu.equilibrium(m)
    assert rest.coordinates["turn"] == pytest.approx(load / 0.1, rel=1e-12)
