"""Massless links: any link of the mixed and absolute forms, by a parameter set to 0; what cannot be is named."""

import numpy as np
import pytest
from oracles import ode
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from scenes import derived, initialized

import alfmu
from alfmu.fmi.drive import Fmu
from alfmu.simulation import prepared, run

PARALLELOGRAMS = [
    (name, massless)
    for name, links in (("four_bar", "123"), ("five_bar", "1234"))
    for massless in [(f"m{k}",) for k in links] + [("m1", "m3")]
] + [("five_bar", ("m1", "m2", "m3")), ("five_bar", ("m2", "m4"))]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "massless"), PARALLELOGRAMS, ids=str)
def test_every_link_of_the_parallelograms_can_be_massless(name, massless):
    """Over 2 s, past a singular position: order 4 against the exact motion, and joints that balance."""
    masses = dict.fromkeys(massless, 0.0)
    linkage = Parallelogram(**{**({} if name == "five_bar" else {"m4": None}), **masses})
    inertia, weight = float(linkage.inertia), float(linkage.weight)
    times = np.linspace(0.0, 2.0, 101)
    exact = ode.motion(lambda t, x, v: -weight * np.cos(x) / inertia, 0.4, 2.0, times)
    errors = []
    for step in (0.01, 0.005):
        given = {**masses, "start.angle": 0.4, "solver.method": "rk4", "solver.step_size": step}
        i = initialized(alfmu.Instance(prepared(derived(name), "vm")), given)
        worst = 0.0
        for k in range(1, 101):
            i.step(times[k] - times[k - 1])
            worst = max(worst, abs(i.q[0] - exact[k, 0]))
        errors.append(worst)
        assert i.counters.position_error <= 1e-13
        assert i.counters.unconverged == i.counters.unprojected == 0
    assert errors[1] <= 5e-8
    assert errors[0] > 10 * errors[1]
    # The reactions at A and D carry the weight and move the centre of mass.
    total = sum(i.get(f"m{k}") for k in range(1, 5 if name == "five_bar" else 4))
    momentum = sum(i.get(f"m{k}") * i.get(f"link{k}.ay") for k in range(1, 5 if name == "five_bar" else 4))
    assert i.get("A.force.y") + i.get("D.force.y") == pytest.approx(momentum + 9.81 * total, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("massless", [("m1",), ("m2",), ("m3",), ("m2", "m3"), ("m1", "m3")], ids=str)
@pytest.mark.parametrize("coordinates", ["absolute", "mixed"])
def test_every_link_of_the_slider_crank_can_be_massless(coordinates, massless):
    masses = dict.fromkeys(massless, 0.0)
    reference = SliderCrank(**masses)
    times = np.linspace(0.0, 1.0, 51)
    exact = reference.motion(0.6, -2.0, times)[:, 0]
    errors = []
    for step in (0.004, 0.002):
        given = {**masses, "l1": 0.5, "l2": 1.0, "start.angle": 0.6, "start.angular_velocity": -2.0}
        given |= {"solver.method": "rk4", "solver.step_size": step}
        i = initialized(alfmu.Instance(prepared(derived("slider_crank", coordinates=coordinates), "vm")), given)
        worst = 0.0
        for k in range(1, 51):
            i.step(times[k] - times[k - 1])
            worst = max(worst, abs(i.get("crank.angle") - exact[k]))
        errors.append(worst)
        assert i.counters.position_error <= 1e-13
    assert errors[1] < 2e-6
    assert errors[0] > 8 * errors[1]  # order 4


@pytest.mark.slow
def test_a_massless_link_in_an_fmu(exported):
    given = {"m1": 0.0, "m4": 0.0, "start.angle": 0.4}
    with Fmu(exported("five_bar")) as fmu:
        through_fmi = run(fmu, 1.0, 0.02, parameters=given)
    library = alfmu.simulate(derived("five_bar"), 1.0, 0.02, parameters=given)
    assert np.array_equal(through_fmi.values, library.values)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "massless", "named"),
    [
        ("slider_crank", {"coordinates": "joint"}, ("m1", "m2", "m3"), "th1, th2, s"),
        ("four_bar", {"coordinates": "joint"}, ("m1", "m2", "m3"), "th1, th2, th3"),
        ("five_bar", {}, ("m1", "m2", "m3", "m4"), "th1"),
    ],
)
def test_what_cannot_be_massless_is_refused_by_name(name, options, massless, named):
    with pytest.raises(alfmu.AssemblyError, match=f"the motion along {named}.* has no mass and no constraint"):
        initialized(alfmu.Instance(derived(name, **options)), {"start.angle": 0.6, **dict.fromkeys(massless, 0.0)})


def test_a_massless_last_link_of_an_open_chain_is_refused_by_name():
    m = alfmu.Mechanism("arm")
    a, b = (m.coordinate(name, "rad", start=0.3, independent=True) for name in ("a", "b"))
    tip = m.parameter("tip", 1.0, "kg", minimum=0.0)
    upper, lower = m.bar("upper", mass=1.0, length=1.0), m.bar("lower", mass=tip, length=1.0)
    m.revolute("shoulder", m.ground.at(0.0, 0.0), upper.start, coordinate=a)
    m.revolute("elbow", upper.end, lower.start, coordinate=b)
    with pytest.raises(alfmu.AssemblyError, match=r"arm: the motion along b has no mass.* last body of an open chain"):
        initialized(alfmu.Instance(m), {"tip": 0.0})


def test_a_loop_whose_links_are_all_massless_is_refused_by_name():
    """Two constraints cannot hold three coordinates, although each coordinate is in a constraint."""
    m = alfmu.Mechanism("loop")
    a, b, c = (m.coordinate(name, "rad", start=value) for name, value in (("a", 1.0), ("b", -0.5), ("c", 1.2)))
    crank, coupler, rocker = (m.bar(name, mass=0.0, length=x) for name, x in (("p", 0.3), ("q", 0.8), ("r", 0.6)))
    m.revolute("A", m.ground.at(0.0, 0.0), crank.start, coordinate=a)
    m.revolute("B", crank.end, coupler.start, coordinate=b)
    m.revolute("C", m.ground.at(0.7, 0.0), rocker.start, coordinate=c)
    m.revolute("D", coupler.end, rocker.end)
    with pytest.raises(alfmu.AssemblyError, match="loop: the motion along a, b, c has no mass and no constraint"):
        alfmu.simulate(m, 0.1, 0.02)


@pytest.mark.parametrize("method", ["auto", "rk4", "stiff"])
def test_a_prescribed_linkage_without_any_mass_is_statics(method, caplog):
    """The torque of the crank does the work that the load takes: T = -F dx/dq of the loaded point, by differences."""
    m = alfmu.Mechanism("statics")
    q, turn, swing = (m.coordinate(name, start=x) for name, x in (("q", 1.0), ("b", -0.5), ("r", 1.2)))
    crank, coupler, rocker = (m.bar(name, mass=0.0, length=x) for name, x in (("a", 0.3), ("c", 0.8), ("d", 0.6)))
    A = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=q)
    m.revolute("B", crank.end, coupler.start, coordinate=turn)
    m.revolute("C", m.ground.at(0.7, 0), rocker.start, coordinate=swing)
    m.revolute("D", coupler.end, rocker.end)
    m.motion(A, 1.0 + 0.5 * m.time)
    m.force(rocker.end, 10.0, 0.0)
    found = alfmu.simulate(m, 0.1, 0.02, parameters={"solver.method": method})

    def loaded(angle: float) -> float:
        """x of the rocker's end: the upper intersection of two circles."""
        start, pivot = 0.3 * np.exp(1j * angle), 0.7
        between = pivot - start
        along = (0.8**2 - 0.6**2 + abs(between) ** 2) / (2 * abs(between))
        up = np.sqrt(0.8**2 - along**2)
        return (start + between / abs(between) * (along + 1j * up)).real

    for t, torque in zip(found["time"], found["A.torque"], strict=True):
        wanted = -10.0 * (loaded(1.0 + 0.5 * t + 1e-6) - loaded(1.0 + 0.5 * t - 1e-6)) / 2e-6
        assert torque == pytest.approx(wanted, abs=1e-6)
    assert not caplog.messages
