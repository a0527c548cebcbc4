"""What coupling costs: orders of the error, energy that it makes, the largest stable step."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from drives import drive, first_order

import alfmu
from alfmu import InputError, Mechanism, System
from alfmu.cli import main
from alfmu.systems.coupling import Coupling, couple
from alfmu.systems.description import Connection, Monolithic
from alfmu.systems.masters import MASTERS
from alfmu.systems.run import Assembly, interface_jacobian


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Coupling:
    """A four-bar with motor and controller, in three parts and in one."""
    return couple(drive(tmp_path_factory.mktemp("couple")), halvings=4)


@pytest.mark.slow
def test_the_error_falls_with_its_order(found):
    assert found.reference_error < 1e-9
    assert found.order("held") == pytest.approx(1.0, abs=0.1)
    assert found.order("extrapolated") == pytest.approx(2.0, abs=0.1)
    assert found.order("iterated") == pytest.approx(2.0, abs=0.1)
    finest = {master: found.of(master)[-1].error for master in MASTERS}
    assert finest["iterated"] < 0.3 * finest["extrapolated"] < 0.01 * finest["held"]
    assert finest["iterated"] > 100 * found.reference_error


@pytest.mark.slow
def test_the_energy_that_coupling_makes_falls_as_well(found):
    assert found.bonds == ["motor.torque and arm.link1.angular_velocity"]
    for master, order in (("held", 1), ("extrapolated", 2), ("iterated", 2)):
        cases = found.of(master)
        slope = np.polyfit(np.log([c.step for c in cases]), np.log([c.energy for c in cases]), 1)[0]
        assert slope == pytest.approx(order, abs=0.2)
        assert all(c.passed == pytest.approx(cases[-1].passed, rel=0.1) for c in cases)


def test_iteration_is_stable_where_the_others_are_not(found):
    (held, failed), (other, fails), (iterated, longest) = (found.stable[master] for master in MASTERS)
    assert failed
    assert fails
    assert 0.02 < held < other < 0.06
    assert iterated == pytest.approx(0.1)
    assert not longest
    assert all(case.tries > 1.5 for case in found.of("iterated"))


@pytest.mark.slow
def test_the_largest_stable_step_is_that_of_the_difference_equation():
    """x' = -x + u, y' = -y + v, u = -g y, v = x, both held: x and y step by exp(-H) and 1 - exp(-H).

    The step is stable while |exp(-H) +- i sqrt(g) (1 - exp(-H))| < 1.
    """
    gain = 30.0
    one = Mechanism("one")
    x, y = one.state("x", "rad/s", start=1.0), one.state("y", "rad/s")
    one.derivative(x, -x - gain * y)
    one.derivative(y, x - y)
    start = {"start.x": 1.0}
    system = System(
        "pair",
        {"a": alfmu.Recipe(first_order("a"), parameters=start), "b": first_order("b")},
        [("a.y", "b.u"), Connection("b.y", "a.u", factor=-gain)],
        stop_time=20.0,
        communication_step=0.01,
        monolithic=Monolithic(one, {"a.x": "x"}),
    )
    found = couple(system, halvings=0, masters=["held"])
    # With E = exp(-H): E^2 + g (1 - E)^2 = 1, so E = (g - 1) / (g + 1).
    limit = -math.log((gain - 1) / (gain + 1))
    step, failed = found.stable["held"]
    assert failed
    assert step == pytest.approx(limit, rel=0.25)  # what grows slowly has 20 s to become as large as the motion
    assert step > limit / 1.05
    assert found.bonds == []
    assert math.isnan(found.cases[0].energy)
    assert "no power bond" in "\n".join(found.lines())


def test_the_matrix_of_an_interface_is_that_of_the_step():
    """x over a step whose input goes from 0 to e: e (H - 1 + exp(-H)) / H."""
    h = 0.2
    with Assembly(System("one", {"a": first_order("a")}, [], {"a.u": 0.0})) as unit:
        unit.initialize()
        (slave,) = unit.slaves
        state = slave.save()

        def outputs(end):
            slave.restore(state)
            slave.set("u", 0.0)
            slave.slope("u", end[0] / h)
            slave.step(h, 0.0)
            return slave.read()

        found = interface_jacobian(outputs, np.array([1.0]), [0], np.array([1e-2]))
        place = [p.name for p in slave.outputs].index("x")
    assert found[place, 0] == pytest.approx((h - 1 + math.exp(-h)) / h, rel=1e-6)


def test_what_passes_a_bond_is_the_work(tmp_path):
    """Energy through the bond of motor and arm, by the integral of the torque over the angle."""
    system = System.load(drive(tmp_path))
    run = system.simulate(master="iterated", communication_step=1e-3)
    work = float(np.trapezoid(np.abs(run["motor.torque"] * run["arm.link1.angular_velocity"]), run.time))
    case = couple(system, halvings=0, masters=["iterated"], stability=False).cases[0]
    assert case.passed == pytest.approx(work, rel=1e-2)


@pytest.mark.slow
def test_a_study_says_what_it_lacks(tmp_path):
    path = drive(tmp_path)
    system = System.load(path)
    with pytest.raises(InputError, match="has no mechanism to compare with"):
        couple(System("plain", {"a": first_order()}, []))
    with pytest.raises(InputError, match=r"no output .link1\.angel.; did you mean link1\.angle"):
        couple(system.changed(monolithic=Monolithic(path.with_name("one.py"), {"arm.link1.angle": "link1.angel"})))
    with pytest.raises(InputError, match=r"drive has no output .arm\.angle."):
        couple(system.changed(monolithic=Monolithic(path.with_name("one.py"), {"arm.angle": "link1.angle"})))
    with pytest.raises(
        InputError, match=r"arm\.link1\.angle is in rad and motor\.current in A; compare outputs with one unit"
    ):
        couple(system.changed(monolithic=Monolithic(path.with_name("one.py"), {"arm.link1.angle": "motor.current"})))
    with pytest.raises(InputError, match="whole number of communication steps"):
        couple(system.changed(communication_step=0.03))
    with pytest.raises(InputError, match="whole number from 0 to 12"):
        couple(system, halvings=-1)
    with pytest.raises(InputError, match="no master 'best'"):
        couple(system, masters=["best"])
    with pytest.raises(InputError, match="are not a bond"):
        couple(system.changed(bonds=[("motor.torque", "controller.output")]))


def circle(**more) -> System:
    """Two blocks whose outputs follow their inputs at once: y = x + u / 2, u_a = -y_b, u_b = y_a."""
    one = Mechanism("one")
    a, b = one.state("a", "rad/s", start=1.0), one.state("b", "rad/s")
    y = (a - b / 2) / 1.25
    one.derivative(a, -(b + y / 2) - a)
    one.derivative(b, y - b)
    blocks = {name: first_order(name, instant=0.5) for name in "ab"}
    return System(
        "circle",
        {"a": alfmu.Recipe(blocks["a"], parameters={"start.x": 1.0}), "b": blocks["b"]},
        [("a.y", "b.u"), Connection("b.y", "a.u", factor=-1.0)],
        stop_time=1.0,
        communication_step=0.1,
        monolithic=Monolithic(one, {"a.x": "a"}),
        **more,
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*algebraic loop:alfmu.AlfmuWarning")
@pytest.mark.parametrize("own", ["iterated", "extrapolated"])
def test_a_master_that_is_refused_leaves_the_others(own, tmp_path):
    system = circle(master=own)
    found = couple(system, halvings=2)
    assert {case.master for case in found.cases} == {"held", "iterated"} == set(found.stable)
    assert found.of("iterated")[-1].error < 1e-2
    (said,) = [line for line in found.lines() if line.startswith("extrapolated")]
    assert said.startswith("extrapolated: refused: circle: ")
    assert "is an algebraic loop" in said
    found.save(tmp_path / "cost.csv")
    rows = list(csv.DictReader((tmp_path / "cost.csv").read_text().splitlines()))
    (row,) = [row for row in rows if row["master"] == "extrapolated"]
    assert math.isnan(float(row["error [1]"]))
    assert "algebraic loop" in row["failed"]
    found.plot(tmp_path / "cost.png")


def test_a_study_whose_masters_are_all_refused_says_why():
    with pytest.raises(InputError, match="algebraic loop"):
        couple(circle(), masters=["extrapolated"], halvings=1)


@pytest.mark.slow
def test_the_command(tmp_path, monkeypatch, capsys):
    drive(tmp_path)
    monkeypatch.chdir(tmp_path)
    asked = ["couple", "drive.toml", "--halvings", "3", "--masters", "held,iterated", "--no-stability"]
    assert main([*asked, "-o", "table.csv", "--plot", "cost.png"]) == 0
    said = capsys.readouterr().out
    assert "held" in said
    assert "extrapolated" not in said
    with Path("table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["step [s]"]) for row in rows[:4]] == [0.01, 0.005, 0.0025, 0.00125]
    errors = [float(row["error [1]"]) for row in rows if row["master"] == "held"]
    assert errors == sorted(errors, reverse=True)
    assert Path("cost.png").stat().st_size > 20_000
    assert main([*asked, "-o", "table.txt"]) == 1
    assert "table.txt: the name of a file for a table must end in .csv" in capsys.readouterr().err
