"""Redundant constraints of given compliances: the shares of elastic joints, and the motion of rigid ones."""

import numpy as np
import pytest
from oracles import stiff_joints
from scenes import by_the_oracle, initialized, made, multipliers, parameters, started

import alfmu
from alfmu.fmi.drive import Fmu
from alfmu.simulation import prepared, run


def with_compliances(name: str) -> alfmu.Equations:
    m = alfmu.load(name)
    m.compliances()
    return alfmu.derive(m)


@pytest.mark.slow
def test_bennetts_linkage_shares_its_reactions_as_stiff_joints_do():
    """Six constraints of compliances over two decades, three of them redundant; the stiffer, the nearer."""
    e = with_compliances("bennett")
    compliance = 10 ** np.random.default_rng(2).uniform(-1, 1, 6)
    given = {variable.name: x * 1e-9 for variable, x in zip(e.compliances, compliance, strict=True)}
    i = started(e, given, step_size=1e-3)
    p, q, v = i.memory["p"], i.q.copy(), i.v.copy()
    i.step(0.03)
    shares = multipliers(i)
    errors = [
        np.abs(stiff_joints.forces(e, p, q, v, stiffness / compliance, 0.03) - shares).max() for stiffness in (1e7, 1e8)
    ]
    assert errors[1] < 1e-4 * np.abs(shares).max()
    assert errors[0] / errors[1] > 2.5
    plain = started(e, step_size=1e-3)
    plain.step(0.03)
    assert np.abs(multipliers(plain) - shares).max() > 0.1 * np.abs(shares).max()  # else this would show nothing
    assert np.array_equal(plain.q, i.q)  # shares are read, the motion does not know them


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["oracle", "vm"])
@pytest.mark.parametrize("decades", [0.0, 1.5, 2.5])
def test_shares_are_those_of_a_weighted_pseudo_inverse(kernel, decades):
    """To 1e-12 of the reactions, for compliances over up to five decades."""
    e = with_compliances("five_bar")
    compliance = 10 ** np.random.default_rng(3).uniform(-decades, decades, e.l)
    i = made(e, kernel)
    for variable, x in zip(e.compliances, compliance, strict=True):
        i.set(variable.name, x)
    initialized(i, {"start.angle": 0.7})
    shared_by_none = by_the_oracle(e, {"start.angle": 0.7})
    for _ in range(5):
        i.step(0.02)
        lam = multipliers(i)
        C = np.array(e.C(i.q, parameters(i)))
        some = shared_by_none.accelerations(i.q, i.v, np.zeros(1), 0.0)[1]
        W = np.diag(1 / np.sqrt(compliance))
        expected = W @ np.linalg.pinv(C.T @ W, rcond=1e-9) @ (C.T @ some)
        assert lam == pytest.approx(expected, abs=1e-12 * np.abs(lam).max() * 10 ** max(0, 2 * decades - 3))
    assert i.counters.patient == 0


@pytest.mark.slow
def test_compliances_in_an_fmu(tmp_path):
    m = alfmu.load("five_bar")
    m.compliances()
    names = [v.name for v in alfmu.derive(m).compliances]
    assert names[:2] == ["B.compliance.x", "B.compliance.y"]
    given = {name: 1e-8 * (k + 1) ** 2 for k, name in enumerate(names)}
    path = alfmu.export(m, tmp_path / "five_bar.fmu", parameters={"start.angle": 0.7})
    with Fmu(path) as fmu:
        through_fmi = run(fmu, 0.5, 0.02, parameters=given)
    library = alfmu.simulate(alfmu.derive(m), 0.5, 0.02, parameters={**given, "start.angle": 0.7})
    assert np.array_equal(through_fmi.values, library.values)
    equal = alfmu.simulate(alfmu.derive(m), 0.5, 0.02, parameters={"start.angle": 0.7})
    assert np.abs(equal["B.force.x"] - library["B.force.x"]).max() > 0.01
    assert equal["B.force.y"] == pytest.approx(library["B.force.y"], abs=1e-9)  # unique


@pytest.mark.slow
def test_some_compliances_and_not_all_are_refused():
    i = alfmu.Instance(with_compliances("five_bar"))
    i.set("C.compliance.x", 1e-8)
    with pytest.raises(alfmu.InputError, match=r"B\.compliance\.x is 0 and others are not"):
        i.initialize()
    with pytest.raises(alfmu.InputError, match="outside"):
        i.set("C.compliance.x", -1.0)


def held(given: float = 0.0) -> tuple[alfmu.Equations, alfmu.Instance]:
    """A parallel four-bar held at B and by a brake from its start on, by compliances over so many decades."""
    m = alfmu.load("four_bar")
    m.lock("B")
    m.clutch("brake", m.ground, next(b for b in m.bodies if b.name == "link3"))
    m.compliances()
    e = alfmu.derive(m)
    i = alfmu.Instance(prepared(e))
    if given:
        for variable, x in zip(
            e.compliances, np.random.default_rng(4).uniform(-given / 2, given / 2, e.l), strict=True
        ):
            i.set(variable.name, 10**x)
    i.set("start.angle", 0.6)
    for name in ("B.locked", "brake.locked"):
        i.set(name, True)
    i.initialize()
    return e, i


@pytest.mark.slow
@pytest.mark.parametrize("given", [0.0, 2.0])
def test_an_impact_at_the_start_is_shared_by_compliances(given):
    """Two brakes that come into force at the start; where no compliances are given, in the least norm."""
    e, i = held(given)
    p = parameters(i)
    free = by_the_oracle(alfmu.derive(alfmu.load("four_bar")), {"start.angle": 0.6})
    momentum = np.array(e.M(i.q, p)) @ free.v
    compliance = np.array([i.get(v.name) for v in e.compliances]) if given else np.ones(e.l)
    W = np.diag(1 / np.sqrt(compliance))
    shares = -W @ np.linalg.pinv(np.array(e.C(i.q, p)).T @ W, rcond=1e-9) @ momentum
    assert [i.get("B.impulse"), i.get("brake.impulse")] == pytest.approx(shares[-2:], rel=1e-10)
    assert abs(shares[-1]) > 0.1  # else the brake would show nothing


@pytest.mark.slow
def test_compliances_that_are_too_far_apart_are_named():
    """Eight decades are more than the passes share."""
    with pytest.raises(alfmu.StepError, match=r"would be nan.*compliances .* differ by a factor of \d"):
        held(14.0)[1].get("A.force.x")
