"""Topology that changes while running, by Boolean inputs: locks, clutches, joints that let go; and what impacts cost.

References: a double pendulum by Lagrange's equations written by hand in its two angles, with DOP853; rigid again, it is
one pendulum; momentum over each impact by hand.
"""

from functools import cache

import fmpy
import fmpy.validation
import numpy as np
import pytest
from scenes import double_pendulum, initialized, made, readings, refused
from scipy.integrate import solve_ivp

import alfmu
from alfmu.fmi.drive import Fmu
from alfmu.simulation import prepared, run

G = 9.81
LOCKED, FREE, END = 0.4, 1.0, 1.4
"""Times of a run in which the elbow of a double pendulum is stopped and let go again."""


@cache
def pendulum() -> alfmu.Equations:
    return alfmu.derive(double_pendulum())


@cache
def switched() -> alfmu.Mechanism:
    """The five-bar with a lock at B, and joints E and F that let go."""
    m = alfmu.load("five_bar")
    m.lock("B")
    m.release("E")
    m.release("F")
    return m


def accelerations(a: float, b: float, wa: float, wb: float) -> tuple[float, float]:
    """Angles a, b of both bars from the x axis: M [a'', b''] = forces."""
    M = [[4 / 3, np.cos(a - b) / 2], [np.cos(a - b) / 2, 1 / 3]]
    s = np.sin(a - b) / 2
    return tuple(np.linalg.solve(M, [-s * wb**2 - 1.5 * G * np.cos(a), s * wa**2 - 0.5 * G * np.cos(b)]))


def swung(y: np.ndarray, begin: float, end: float, locked: bool = False) -> np.ndarray:
    """State (a, b, a', b') at the end."""

    def rate(t: float, y: np.ndarray) -> list:
        if not locked:
            return [*y[2:], *accelerations(*y)]
        # One rigid pendulum: both angles turn alike.
        inertia = 5 / 3 + np.cos(y[0] - y[1])
        turn = -G * (1.5 * np.cos(y[0]) + 0.5 * np.cos(y[1])) / inertia
        return [*y[2:], turn, turn]

    return solve_ivp(rate, (begin, end), y, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]


def stopped(y: np.ndarray) -> tuple[np.ndarray, float, float]:
    """State after the elbow is stopped, the impulse on the lower bar, the energy lost: angular momentum is kept."""
    a, b, wa, wb = y
    M = np.array([[4 / 3, np.cos(a - b) / 2], [np.cos(a - b) / 2, 1 / 3]])
    before = np.array([wa, wb])
    w = (M @ before).sum() / M.sum()
    after = np.array([w, w])
    return np.array([a, b, w, w]), (M @ (after - before))[1], (before @ M @ before - after @ M @ after) / 2


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["oracle", "vm"])
def test_a_double_pendulum_is_one_pendulum_while_its_elbow_is_locked(kernel):
    y = swung(np.array([0.3, 0.8, 1.0, -3.0]), 0.0, LOCKED)
    y, impulse, lost = stopped(y)
    exact = swung(swung(y, LOCKED, FREE, locked=True), FREE, END)
    errors = []
    for h in (0.01, 0.005):
        i = initialized(made(pendulum(), kernel), {"solver.method": "rk4", "solver.step_size": h})
        for t in np.arange(0, END - 1e-9, 0.1):
            i.set("elbow.locked", LOCKED - 1e-9 < t < FREE - 1e-9)
            i.step(0.1)
        got = [i.get(f"{bar}.{what}") for what in ("angle", "angular_velocity") for bar in ("upper", "lower")]
        errors.append(np.abs(np.array(got) - exact).max())
        assert i.get("elbow.impulse") == pytest.approx(impulse, rel=1e3 * h**4)
        assert i.get("monitor.energy_lost") == pytest.approx(lost, rel=1e3 * h**4)
        assert i.counters.energy_error < 1e4 * h**4  # impacts are in the balance
    assert errors[0] < 2e-6
    assert errors[0] / errors[1] > 12  # order 4, over both events


@pytest.mark.parametrize("communication_step", [0.002, 0.1])
def test_a_locked_elbow_by_default(communication_step):
    """By steps of either kind of the method `auto`: short ones do not know of constraints that are off."""
    y, _, _ = stopped(swung(np.array([0.3, 0.8, 1.0, -3.0]), 0.0, LOCKED))
    exact = swung(swung(y, LOCKED, FREE, locked=True), FREE, END)
    i = initialized(alfmu.Instance(pendulum()))
    for t in np.arange(0, END - 1e-9, communication_step):
        i.set("elbow.locked", LOCKED - 1e-9 < t < FREE - 1e-9)
        i.step(communication_step)
    got = [i.get(f"{bar}.{what}") for what in ("angle", "angular_velocity") for bar in ("upper", "lower")]
    assert np.abs(np.array(got) - exact).max() <= 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["absolute", "joint", "mixed", "natural"])
def test_every_coordinate_set_stops_alike(coordinates):
    """A slider-crank locked at B stands still: the lock takes all kinetic energy, and holds the weight from then on."""
    m = alfmu.load("slider_crank", coordinates=coordinates)
    m.lock("B")
    i = initialized(alfmu.Instance(prepared(alfmu.derive(m))), {"start.angle": 0.6})
    kinetic = i.get("monitor.energy") - float(i.equations.potential_energy(i.q, i.memory["p"]))
    v, q = i.v.copy(), i.q.copy()
    i.set("B.locked", True)
    i.step(0.5)
    assert np.abs(i.v).max() < 1e-13
    assert i.q == pytest.approx(q, abs=1e-13)
    assert i.get("monitor.energy_lost") == pytest.approx(kinetic, rel=1e-12)
    # Virtual work of the weights against that of the lock, along the motion that was possible.
    ahead, behind = (float(i.equations.displacements(q + k * v, i.memory["p"])) for k in (1e-5, -1e-5))
    rate = (ahead - behind) / 2e-5
    power = float(np.array(i.equations.f(q, 0 * v, i.memory["u"], i.memory["p"], 0.0)).ravel() @ v)
    assert i.get("B.locking_torque") * rate == pytest.approx(-power, rel=1e-7)  # of the difference
    momentum = np.array(i.equations.M(q, i.memory["p"])) @ v
    assert i.get("B.impulse") * rate == pytest.approx(-float(momentum @ v), rel=1e-7)


@pytest.mark.slow
def test_redundant_locks_share_the_impulse_and_change_nothing():
    """Parallel four-bar: its lock at B and a brake on link 3 each stop it; both together share.

    All joints carry least, torques over half a link: A and D hold links 1 and 3 against the forces in B and C, and
    their weights or what their centres lose of momentum.
    """
    m = alfmu.load("four_bar")
    m.lock("B")
    m.clutch("brake", m.ground, next(b for b in m.bodies if b.name == "link3"))
    equations = prepared(alfmu.derive(m))
    impulses, torques, places = [], [], []
    for locks in (["B.locked"], ["brake.locked"], ["B.locked", "brake.locked"]):
        i = initialized(alfmu.Instance(equations), {"start.angle": 0.6})
        momentum = np.array(equations.M(i.q, i.memory["p"])) @ i.v
        for name in locks:
            i.set(name, True)
        i.step(0.1)
        impulses.append([i.get("B.impulse"), i.get("brake.impulse")])
        torques.append([i.get("B.locking_torque"), i.get("brake.locking_torque")])
        places.append(i.q.copy())
        if len(locks) == 2:
            forces = np.array(equations.f(i.q, i.v, i.memory["u"], i.memory["p"], 0.0)).ravel()
            Ct = np.array(equations.C(i.q, i.memory["p"])).T
            shares = -np.linalg.pinv(Ct) @ np.c_[momentum, forces]
            free = np.linalg.svd(Ct)[2][-1]  # what moves nothing
            stopped = 2.0 / 2 * np.array([np.sin(0.6), -np.cos(0.6)])  # of a centre, 0.5 m from its hinge
            loads, scale = np.c_[np.r_[stopped, stopped], [0.0, G, 0.0, G]], np.array([1, 1, 1, 1, 2, 2])
            more = np.r_[scale * free, free[:4]]
            for share, load in zip(shares.T, loads.T, strict=True):
                share -= free * (np.r_[scale * share, share[:4] + load] @ more) / (more @ more)
            size = i.mobility()
            assert (size.freedom, size.redundant) == (0, 1)
            i.set("B.locked", False)  # the other one still holds
            i.step(0.1)
            assert i.q == pytest.approx(places[0], abs=1e-13)
            assert i.get("brake.locking_torque") == pytest.approx(torques[1][1], rel=1e-10)
    assert impulses[0] == pytest.approx([(1 / 3 + 1 / 3 + 1) * 2.0, 0.0], rel=1e-10)
    assert impulses[1] == pytest.approx([0.0, -(1 / 3 + 1 / 3 + 1) * 2.0], rel=1e-10)
    assert torques[1] == pytest.approx([0.0, 2 * G * np.cos(0.6)], rel=1e-10)
    assert np.c_[impulses[2], torques[2]] == pytest.approx(shares[-2:], rel=1e-10)
    assert np.ptp(places, axis=0).max() < 1e-13


@pytest.mark.slow
def test_a_lock_from_the_start_and_a_joint_that_is_open_from_the_start():
    equations = prepared(alfmu.derive(switched()))
    i = initialized(alfmu.Instance(equations), {"start.angle": 0.7, "B.locked": 1})
    assert np.abs(i.v).max() < 1e-13
    assert i.get("monitor.energy_lost") > 1.0
    open_ = initialized(alfmu.Instance(equations), {"E.released": True, "F.released": True, "start.angle": 0.7})
    y, v = open_.q[6], open_.v[6]
    open_.step(0.2)
    assert open_.q[6] == pytest.approx(y + 0.2 * v - G * 0.02, abs=1e-12)  # link 4 falls


@pytest.mark.slow
def test_released_and_locked_through_fmpy_as_in_the_library(fmu_of):
    path = fmu_of(switched(), parameters={"start.angle": 0.7})
    described = {v.name: v for v in fmpy.read_model_description(str(path)).modelVariables}
    assert [described[n].type for n in ("B.locked", "E.released", "F.released")] == ["Boolean"] * 3
    assert fmpy.validation.validate_fmu(str(path)) == []
    inputs = {
        "B.locked": lambda t: 0.1 < t < 0.3,
        "E.released": ([0.0, 0.5, 0.5, 1.0], [0.0, 0.0, 1.0, 1.0]),
        "F.released": lambda t: t > 0.6,
    }
    with Fmu(path) as fmu:
        through_fmi = run(fmu, 0.8, 0.04, inputs)
    library = alfmu.simulate(switched(), 0.8, 0.04, inputs=inputs, parameters={"start.angle": 0.7})
    assert through_fmi.names == library.names
    assert np.array_equal(through_fmi.values, library.values)
    standing = (library.time > 0.13) & (library.time < 0.3)
    assert np.ptp(library["link1.angle"][standing]) < 1e-13
    assert library["monitor.energy_lost"][-1] > 0.1
    assert library["E.force.x"][-1] == library["F.force.y"][-1] == 0.0
    signals = np.array([(0.0, 0.3, False), (0.2, 0.3, True), (0.4, 0.3, False)], "f8,f8,?")
    signals.dtype.names = "time", "A.torque", "B.locked"
    result = fmpy.simulate_fmu(str(path), stop_time=0.4, output_interval=0.02, input=signals, output=["link1.angle"])
    moved = np.abs(np.diff(result["link1.angle"]))
    assert moved[:10].min() > 1e-3
    assert moved[12:20].max() < 1e-13


@pytest.mark.slow
def test_what_is_open_cannot_be_closed_and_nothing_is_lost(fmu_of):
    i = initialized(alfmu.Instance(prepared(alfmu.derive(switched()))), {"start.angle": 0.7})
    for name in ("E.released", "F.released"):
        i.set(name, True)
    i.step(0.2)
    i.set("F.released", False)
    before = i.q.copy(), i.v.copy(), i.time
    with pytest.raises(alfmu.InputError, match=r"five_bar, t = 0\.2 s: a constraint that is open by .* at F"):
        i.step(0.1)
    assert np.array_equal(i.q, before[0])
    assert np.array_equal(i.v, before[1])
    assert i.time == before[2]
    assert i.get("F.released") == 1.0  # as it was
    i.step(0.1)
    with Fmu(fmu_of(switched(), parameters={"start.angle": 0.7})) as fmu:
        initialized(fmu, {"E.released": True, "F.released": True})
        fmu.step(0.2, 0.0)
        fmu.set("E.released", False)
        with pytest.raises(alfmu.StepError, match="cannot be switched on"):
            fmu.step(0.1, 0.2)
        fmu.step(0.1, 0.2)


def test_a_step_that_is_refused_undoes_its_event():
    i = initialized(alfmu.Instance(prepared(pendulum())))
    i.step(0.2)
    i.set("elbow.locked", True)
    with refused(i, alfmu.InputError, match="communication step of -1"):
        i.step(-1.0)
    i.step(0.2)
    assert i.get("monitor.energy_lost") > 0.0


@pytest.mark.slow
def test_a_massless_link_cannot_lose_what_holds_it():
    i = initialized(alfmu.Instance(prepared(alfmu.derive(switched()))), {"start.angle": 0.7, "m4": 0.0})
    i.set("E.released", True)
    with pytest.raises(alfmu.AssemblyError, match="no mass and no constraint"):
        i.step(0.1)
    before = readings(i)
    i.step(0.1)
    assert readings(i) != before


def test_the_switched_state_is_saved_to_the_last_bit():
    equations = prepared(pendulum())
    i = initialized(alfmu.Instance(equations))
    i.step(0.2)
    i.set("elbow.locked", True)
    i.step(0.2)
    i.set("elbow.locked", False)  # wanted, not yet in force
    state = i.save()
    i.step(0.3)
    other = alfmu.Instance(equations)
    other.restore(state)
    assert other.get("elbow.locked") == 0.0
    other.step(0.3)
    assert np.array_equal(other.read(), i.read())


def test_bad_switches_are_refused():
    m = double_pendulum()
    i = alfmu.Instance(alfmu.derive(m))
    for bad in (0.5, float("nan"), "yes"):
        with pytest.raises(alfmu.InputError, match=r"elbow\.locked is .* true or false"):
            i.set("elbow.locked", bad)
    with pytest.raises(alfmu.DeclarationError, match="has no joint knee; it has shoulder, elbow"):
        m.lock("knee")
    with pytest.raises(alfmu.DeclarationError, match="shoulder is not closed by constraints"):
        m.release("shoulder")
    with pytest.raises(alfmu.DeclarationError, match="an input already"):
        m.lock("elbow")
    with pytest.raises(alfmu.DeclarationError, match="couples ground to itself"):
        m.clutch("k", m.ground, m.ground)
    natural = alfmu.load("slider_crank", coordinates="natural")
    natural.release("B")
    with pytest.raises(alfmu.DeclarationError, match="B holds by the choice of coordinates"):
        alfmu.derive(natural)


@pytest.mark.slow
def test_any_displacement_can_be_locked():
    m = alfmu.load("bennett")
    hinge = m.coordinates[2].q
    m.lock_displacement("hinge3", hinge)
    i = initialized(alfmu.Instance(prepared(alfmu.derive(m))))
    i.step(0.1)
    angle, energy = i.get("hinge3.angle"), i.get("monitor.energy")
    i.set("hinge3.locked", True)
    i.step(0.1)
    assert i.get("hinge3.angle") == pytest.approx(angle, abs=1e-12)
    assert np.abs(i.v).max() < 1e-12
    assert energy - i.get("monitor.energy") == pytest.approx(i.get("monitor.energy_lost"), rel=1e-9)


@pytest.mark.slow
def test_a_scene_without_switches_carries_none_of_it():
    plain, locked = (alfmu.load("four_bar") for _ in range(2))
    locked.lock("B")
    plain, locked = (prepared(alfmu.derive(m)) for m in (plain, locked))
    assert "displacements" not in plain.signatures
    assert "displacements" in locked.signatures
    assert not plain.switches
    assert not plain.held
    names = {v.name for v in alfmu.Instance(plain).outputs}
    assert {v.name for v in alfmu.Instance(locked).outputs} - names == {
        "B.locking_torque",
        "multiplier[5]",
        "B.impulse",
        "monitor.energy_lost",
    }
    some = alfmu.simulate(alfmu.load("four_bar"), 0.1, outputs=["link1.angle"])
    assert some.names == ("link1.angle", "A.torque", "D.torque")
