"""What is said of the error of a whole run: its drift of energy, and a run with a finer setting."""

import logging

import numpy as np
import pytest
from scenes import hinged
from scipy.special import ellipj, ellipk

import alfmu
from alfmu import Mechanism
from alfmu.cli.__main__ import main


def pendulum(damping: float = 0.0) -> Mechanism:
    """A bar that begins horizontally at rest."""
    m, _, hinge, *_ = hinged("pendulum", independent=True)
    if damping:
        m.spring_damper(hinge, damping=damping)
    return m


def swung(time: np.ndarray) -> np.ndarray:
    """Its angle, by elliptic functions."""
    k = 0.5  # sin^2 of half the amplitude, a right angle
    sn, *_ = ellipj(np.sqrt(1.5 * 9.81) * time + ellipk(k), k)
    return 2 * np.arcsin(np.sqrt(k) * sn) - np.pi / 2


def test_a_run_says_how_far_off_it_is(caplog):
    """A long run comes off by 4e-3 rad in 5e3 s."""
    r = alfmu.simulate(pendulum(), 5000.0, 20.0, check=True)
    error = np.abs(r["bar.angle"] - swung(r.time)).max()
    assert error > 1e-3
    assert r.check.worst == "bar.angle"
    assert r.check.share == r.check.errors["bar.angle"] == pytest.approx(error, rel=0.05)
    assert r.check.since == pytest.approx(r.time[np.abs(r["bar.angle"] - swung(r.time)) > 1e-3][0], abs=20.0)
    assert r.counters.drift == pytest.approx(error, rel=0.6)
    assert "the drift of energy has put the motion off by about 0.001 rad" in caplog.text
    assert (
        f"bar.angle is off by {error:.2g} rad at most, compared with a run with solver.relative_tolerance 1e-08"
        in caplog.text
    )


def test_what_stays_within_it_says_nothing(caplog):
    for damping, stop in ((0.0, 100.0), (0.05, 1000.0)):
        caplog.clear()
        r = alfmu.simulate(pendulum(damping), stop, 1.0, check=True)
        assert r.check.since is None
        assert r.check.share < 1e-3
        assert not caplog.records


@pytest.mark.slow
@pytest.mark.parametrize("place", [0.0, 100.0])
def test_lengths_are_judged_by_the_motion_wherever_the_origin_is(place, caplog):
    """A slider on a spring swings by 2 mm, a tenth more as it gains energy, with an error of 5 % of that."""
    m = Mechanism("slider")
    body = m.body("b", mass=1.0)
    x = m.coordinate("x", "m", start=0.001, independent=True)
    m.spring_damper(m.prismatic("guide", m.ground.at(place, 0), body.at(0, 0), coordinate=x), stiffness=1e4)
    m.gravity(0, 0)
    r = alfmu.simulate(m, 20.0, 0.01, parameters={"solver.relative_tolerance": 1e-2}, check=True)
    error = np.abs(r["b.x"] - place - 0.001 * np.cos(100 * r.time)).max()
    assert r.check.share == pytest.approx(error / 0.002, rel=0.1)
    assert (
        "m at most, compared with a run with solver.relative_tolerance 0.0001; its relative error exceeds 0.001 from"
        in caplog.text
    )
    still = alfmu.simulate(m, 1.0, 0.1, start="equilibrium", check=True)
    assert still.check.since is None


def test_steps_of_one_length_are_halved():
    r = alfmu.simulate(pendulum(), 10.0, 1.0, parameters={"solver.method": "rk4"}, check=True)
    error = np.abs(r["bar.angle"] - swung(r.time)).max()
    assert r.check.setting == "solver.step_size"
    assert r.check.share == pytest.approx(error, rel=0.2)


@pytest.mark.parametrize("kind", ["python", "native"])
def test_fmus_are_checked(kind, tmp_path, capsys, caplog):
    """From Python, and by the command line."""
    path = alfmu.export(pendulum(), tmp_path / "pendulum.fmu", kind=kind)
    r = alfmu.simulate(path, 400.0, 10.0, check=True)
    error = np.abs(r["bar.angle"] - swung(r.time)).max()
    assert r.check.share == pytest.approx(error, rel=0.05)
    caplog.set_level(logging.WARNING)
    wanted = ["--stop-time", "400", "--step", "10", "-o", str(tmp_path / "run.csv")]
    assert main(["simulate", str(path), "--check", *wanted]) == 0
    assert f"{r.check}" in capsys.readouterr().out


@pytest.mark.slow
def test_the_command_line_checks_mechanisms(tmp_path, capsys):
    wanted = ["--set", "solver.relative_tolerance=1e-4", "--stop-time", "2", "-o", str(tmp_path / "run.csv")]
    assert main(["simulate", "slider_crank", "--check", *wanted]) == 0
    assert "at most, compared with a run with solver.relative_tolerance 1e-06" in capsys.readouterr().out


def test_systems_are_not_checked():
    with pytest.raises(alfmu.InputError, match=r"connected systems are not checked"):
        alfmu.simulate("drive.toml", check=True)
