"""What is asked of a scene before it is traced: where it starts, what moves, what is shared, how fast."""

import numpy as np
import pytest
from scenes import derived, double_pendulum, started

import alfmu
from alfmu.equations.evaluation import with_tangents
from alfmu.runtime.probe import Probe
from alfmu.simulation import prepared, with_defaults

CASES = [
    *(("five_bar", {}), ("four_bar", {}), ("particle_on_circle", {}), ("end_stop", {}), ("bennett", {})),
    *(("slider_crank", {"coordinates": c}) for c in ("absolute", "joint", "mixed", "natural")),
    *(("flexible_four_bar", {}), ("flyball_governor", {}), ("n_four_bar", {"loops": 30})),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), CASES, ids=lambda x: x if isinstance(x, str) else "")
def test_a_probe_stands_where_an_instance_starts(name: str, options: dict) -> None:
    """Positions, velocities, parameters, penalties; what it tells is what the instance tells."""
    e = derived(name, **options)
    probe, i = Probe.of(e), started(prepared(e))
    for letter, values in {"q": i.q, "v": i.v, "u": i.inputs, "p": i.memory["p"], "t": [0.0]}.items():
        assert probe.numbers[letter] == pytest.approx(values, rel=1e-9, abs=1e-11), letter
    assert probe.penalty == pytest.approx(i.penalty, rel=1e-12)
    assert probe.mobility() == i.mobility()
    assert probe.shared() == i.shared()


def test_a_switch_that_holds_at_the_start_is_in_force() -> None:
    """The elbow of a double pendulum, locked from the start: both bars turn alike, after the impact."""
    e = with_defaults(alfmu.derive(double_pendulum()), {"elbow.locked": True})
    probe, i = Probe.of(e), started(prepared(e))
    assert probe.numbers["v"] == pytest.approx(i.v, abs=1e-12)
    assert probe.numbers["p"] == pytest.approx(i.memory["p"], abs=1e-12)
    assert probe.mobility().freedom == i.mobility().freedom == 1


def test_what_redundant_constraints_do_is_told() -> None:
    """Bennett's linkage: its redundant constraints would stop it; those of the five-bar do not."""
    assert Probe.of(derived("bennett")).brakes
    assert not Probe.of(derived("five_bar")).brakes
    assert Probe.of(derived("five_bar")).mobility(every=True).redundant == 1


@pytest.mark.slow
def test_a_scene_without_a_start_tells_nothing_and_is_traced() -> None:
    """It can be given another start."""
    e = with_defaults(derived("slider_crank"), {"l2": 0.3, "start.angle": 1.5})
    assert Probe.of(e) is None
    i = alfmu.Instance(prepared(e))
    with pytest.raises(alfmu.AssemblyError, match="cannot be closed"):
        i.initialize()
    i.set("l2", 1.0)
    i.initialize()


def test_small_motions_of_a_pendulum() -> None:
    """A bar that hangs: +-i sqrt(3 g / 2 l)."""
    m = alfmu.Mechanism("bar")
    m.bar("bar", mass=2.0, length=0.7)
    th = m.coordinate("th", "rad", start=-np.pi / 2, independent=True)
    m.revolute("A", m.ground.at(), m.bodies[0].start, coordinate=th)
    m.gravity(0.0, -9.81)
    values = Probe.of(with_tangents(alfmu.derive(m))).spectrum()
    assert np.sort(values.imag) == pytest.approx(np.sqrt(1.5 * 9.81 / 0.7) * np.array([-1, 1]), rel=1e-12)
    assert np.abs(values.real).max() <= 1e-12
