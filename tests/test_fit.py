"""Parameters and start values fitted to measurements: from noisy data, in the library and on the command line."""

import logging

import casadi as ca
import numpy as np
import pytest
from pairs import draws
from scenes import hinged

import alfmu
from alfmu.cli import main
from alfmu.gradients.run import Runs

TRUE = {"m2": 0.7, "l": 1.1, "start.angle": 0.35}
NOISE = {"link1.angle": 0.01, "link2.x": 0.02}
NAMES = (*NOISE, "A.torque")

DRAWS = draws(10)
"""Sets of noise; `DRAWS=200 pytest tests/test_fit.py` draws more."""


def measured(seed: int = 1, noise: float = 1.0) -> alfmu.Result:
    """A five-bar swung by a torque, two of its outputs with noise."""
    run = alfmu.simulate("five_bar", 2.0, 0.02, parameters=TRUE, inputs={"A.torque": lambda t: 2 * np.sin(3 * t)})
    chance = np.random.default_rng(seed)
    values = np.column_stack([run[name] for name in NAMES])
    for k, size in enumerate(NOISE.values()):
        values[:, k] += noise * size * chance.standard_normal(len(values))
    return alfmu.Result("measured", run.time, NAMES, {name: run.units[name] for name in NAMES}, values)


@pytest.fixture(scope="module")
def fits() -> list[alfmu.Fit]:
    return [
        alfmu.fit("five_bar", measured(seed), {"m2": 1, "l": 1, "start.angle": 0.2}, deviations=NOISE)
        for seed in range(DRAWS)
    ]


@pytest.mark.slow
def test_parameters_are_recovered_within_their_deviations(fits):
    """Over some sets of noise, errors have the size that each fit says, and no side on which they fall."""
    for name, true in TRUE.items():
        off = np.array([(found[name] - true) / found.errors[name] for found in fits])
        assert np.abs(off).max() < 4
        assert 0.6 < np.sqrt(np.mean(off**2)) < 1.5
        assert abs(off.mean()) < 0.8
    for found in fits:
        assert found.runs < 20
        for name, size in NOISE.items():
            assert found.noise[name] == pytest.approx(size, rel=0.3)
            np.testing.assert_allclose(found.residuals[name].std(), found.noise[name], rtol=0.1)
    assert np.abs(fits[0].correlation).max() == pytest.approx(1.0)


@pytest.mark.slow
def test_without_noise_the_numbers_are_exact_and_missing_values_count_for_nothing():
    data = measured(noise=0.0)
    values = data.values.copy()
    values[10:30, 0] = np.nan
    torn = alfmu.Result(data.mechanism, data.time, data.names, data.units, values)
    found = alfmu.fit("five_bar", torn, {"m2": 1.0, "l": 1.0, "start.angle": 0.2})
    for name, true in TRUE.items():
        assert found[name] == pytest.approx(true, rel=1e-9)
    assert np.isnan(found.residuals["link1.angle"]).sum() == 20


@pytest.mark.slow
def test_a_table_of_all_columns_is_fitted_whatever_rests():
    """Link 2 of the four-bar never turns: its angle, which is round-off, and monitors weigh nothing."""
    run = alfmu.simulate("four_bar", 1.0, 0.05, inputs={"A.torque": 4.0})
    found = alfmu.fit("four_bar", run, {"m2": 1.5})
    assert found["m2"] == pytest.approx(1.0, abs=1e-10)
    assert "link2.angle" in found.noise
    assert not any(name.startswith("monitor.") for name in found.noise)


def test_bounds_hold(tmp_path):
    """One number at its bound has no deviation, and the other that which it has where the first is given."""
    found = alfmu.fit("five_bar", measured(), ["m2", "l"], bounds={"m2": (0.9, 2.0)}, parameters={"start.angle": 0.35})
    assert found["m2"] == pytest.approx(0.9, abs=1e-12)
    assert np.isnan(found.errors["m2"])
    assert str(found).startswith("m2  0.9 kg  at its bound\n")
    alone = alfmu.fit("five_bar", measured(), ["l"], parameters={"start.angle": 0.35, "m2": 0.9})
    assert found["l"] == pytest.approx(alone["l"], rel=1e-9)
    assert found.errors["l"] == pytest.approx(alone.errors["l"], rel=0.01)
    drawn = found.plot()
    drawn.savefig(tmp_path / "fit.png")
    assert len(drawn.axes) == 4
    assert "fitted run" in [each.get_text() for each in drawn.axes[0].get_legend().get_texts()]


def test_what_the_data_do_not_tell_is_said(caplog):
    """Links 1 and 3 turn alike: their masses act by their sum."""
    with caplog.at_level(logging.WARNING, "alfmu"):
        found = alfmu.fit(
            "five_bar", measured(), ["m1", "m3", "l"], parameters={**TRUE, "m2": 0.7}, columns=["link1.angle"]
        )
    assert "do not determine m1, m3" in caplog.text
    assert np.isinf([found.errors["m1"], found.errors["m3"]]).all()
    assert found.errors["l"] < 0.01
    assert "not determined by the data" in str(found)


def test_as_many_measurements_as_numbers_tell_no_deviation():
    data = measured(noise=0.0)
    one = alfmu.Result("one", data.time[[0, 90]], ("link1.angle",), {}, data.values[[0, 90], :1])
    one.values[0] = np.nan
    how = {"inputs": {"A.torque": lambda t: 2 * np.sin(3 * t)}, "parameters": {"start.angle": 0.35, "l": 1.1}}
    found = alfmu.fit("five_bar", one, {"m2": 0.8}, **how)
    assert np.isnan(found.errors["m2"])
    assert "error unknown: no more measurements than numbers" in str(found)
    assert str(found).endswith(" rad")
    with pytest.raises(alfmu.InputError, match="1 measurement cannot determine 2 numbers"):
        alfmu.fit("five_bar", one, ["m2", "g"], **how)


def swung() -> alfmu.Mechanism:
    """A bar with a moment of inertia of 1 kg.m^2 at a torsion spring."""
    m, _, hinge, *_ = hinged("swung", angle="angle", mass=3.0, weight=0.0, start=0.5, independent=True)
    m.spring_damper(hinge, stiffness=m.parameter("c", 1.0, "N.m/rad"))
    m.gravity(0, 0)
    return m


def test_other_first_guesses_lead_out_of_a_local_minimum():
    """The angle is a cosine of known frequency; a guess of another frequency is in a local minimum."""
    time = np.linspace(2.0, 12.0, 101)
    angle = 0.4 * np.cos(3.0 * (time - 2.0))
    data = alfmu.Result("measured", time, ("bar.angle",), {"bar.angle": "rad"}, angle[:, None])
    guess, bounds = {"c": 1.0, "start.angle": 0.1}, {"c": (0.5, 40.0), "start.angle": (-1.0, 1.0)}
    assert alfmu.fit(swung(), data, guess, bounds=bounds).noise["bar.angle"] > 0.2
    found = alfmu.fit(swung(), data, guess, bounds=bounds, starts=64)
    assert found["c"] == pytest.approx(9.0, rel=1e-7)
    assert found["start.angle"] == pytest.approx(0.4, rel=1e-7)
    assert found.runs > 64


def test_a_first_guess_without_derivatives_is_left_out():
    """The torque is the root of p + 0.5; the only other guess is p = -0.5, where its derivative is infinite."""
    m = swung()
    m.drive(m.joints[0], ca.sqrt(m.parameter("p", 0.0, "1") + 0.5))
    time, torque = np.linspace(0.0, 2.0, 21), 0.6
    angle = torque + (0.5 - torque) * np.cos(time)
    data = alfmu.Result("measured", time, ("bar.angle",), {"bar.angle": "rad"}, angle[:, None])
    found = alfmu.fit(m, data, {"p": 0.4}, bounds={"p": (-1.5, 0.5)}, starts=np.int64(1))
    assert found["p"] == pytest.approx(torque**2 - 0.5, rel=1e-7)


def test_a_first_guess_that_cannot_be_assembled_is_left_out():
    """A crank of 0.5 m turns by a law; the first rod is too short for it. The place of the ram has a closed form."""
    m = alfmu.Mechanism("ram")
    length = m.parameter("length", 0.1, "m", minimum=0.05)
    angle, place = m.coordinate("angle", "rad", start=1.2), m.coordinate("place", "m", start=1.0)
    crank, ram = m.bar("crank", mass=1.0, length=0.5), m.body("ram", mass=1.0)
    hinge = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=angle)
    m.prismatic("guide", m.ground.at(0, 0), ram.at(0, 0), coordinate=place)
    m.distance("rod", crank.end, ram.at(0, 0), length=length)
    m.motion(hinge, 1.2 + 0.5 * m.time)
    m.gravity(0, 0)
    m.output("ram.place", place, "m")
    time = np.linspace(0.0, 1.0, 11)
    turn = 1.2 + 0.5 * time
    ram_at = 0.5 * np.cos(turn) + np.sqrt(0.9**2 - (0.5 * np.sin(turn)) ** 2)
    data = alfmu.Result("measured", time, ("ram.place",), {"ram.place": "m"}, ram_at[:, None])
    with pytest.raises(alfmu.AssemblyError, match="ram: the loops cannot be closed"):
        alfmu.fit(m, data, ["length"], bounds={"length": (0.05, 2.0)})
    found = alfmu.fit(m, data, ["length"], bounds={"length": (0.05, 2.0)}, starts=8)
    assert found["length"] == pytest.approx(0.9, rel=1e-9)


def test_runs_side_by_side_are_those_one_after_the_other():
    times, torque = np.array([1.0, 1.1, 1.15, 1.4, 2.0]), {"A.torque": lambda t: 2 * np.sin(3 * t)}
    runs = Runs("slider_crank", ["m2", "l1"], None, None, torque, {"start.angle": 1.2}, times=times)
    numbers, names = np.array([[1.0, 0.5], [0.7, 0.6], [1.0, 1.2]]), ["crank.angle", "A.force.x"]
    found = runs.side_by_side(numbers, names)
    for own, columns in zip(numbers[:2], found, strict=False):
        runs.set(own)
        np.testing.assert_array_equal(columns, runs.tangents(names)[0])
    assert np.isnan(found[2]).all()  # this crank does not reach the guide


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"starts": -1}, "starts is -1; it must be a whole number, 0 or above"),
        ({"starts": 8}, "other first guesses of m2 need bounds; give them, or leave out starts"),
        ({"vary": "m2"}, "give a list of names"),
        ({"vary": ["m2", "m2"]}, "m2 is named twice"),
        ({"columns": "link1.angle"}, "give a list of names"),
        ({"vary": 5}, "five_bar: the numbers to vary are 5; give a list of names"),
        ({"vary": [5]}, "five_bar: the numbers to vary are .*; give a list of names"),
        ({"columns": 5}, "five_bar: the columns are 5; give a list of names"),
        ({"bounds": {"m2": 3.0}}, "the bounds of m2 are 3.0; give two numbers"),
        ({"bounds": {"m2": (-2.0, -1.0)}}, "it must be from 0 to inf"),
        ({"bounds": [(0, 1)]}, "give a dictionary"),
        ({"deviations": {"link1.angle": "x"}}, "it must be a finite number above zero"),
        ({"data": np.zeros((3, 3))}, "give a Result"),
        ({"inputs": [1.0]}, "give a dictionary"),
    ],
)
def test_senseless_arguments_are_answered(given, why):
    with pytest.raises(alfmu.InputError, match=why):
        alfmu.fit("five_bar", **{"data": measured(), "vary": ["m2"], **given})


def test_data_in_other_units_are_refused():
    data = measured()
    degrees = alfmu.Result("degrees", data.time, data.names, {"link1.angle": "deg"}, data.values)
    with pytest.raises(alfmu.InputError, match=r"link1\.angle in deg, five_bar has it in rad"):
        alfmu.fit("five_bar", degrees, ["m2"])


@pytest.mark.slow
def test_the_command_line_fits(tmp_path, capsys):
    measured().to_csv(tmp_path / "data.csv")
    table, picture = str(tmp_path / "run.csv"), str(tmp_path / "fit.png")
    words = ["fit", "five_bar", str(tmp_path / "data.csv"), "--vary", "m2,l,start.angle", "--bounds", "m2=0.1:3"]
    words += ["--bounds", "l=0.9:1.3", "--bounds", "start.angle=0:1", "--starts", "8"]
    assert main([*words, "--deviation", "link1.angle=0.01", "-o", table, "--plot", picture]) == 0
    said = capsys.readouterr().out
    assert said.startswith("m2           0.")
    assert "+/-" in said
    assert (tmp_path / "fit.png").read_bytes().startswith(b"\x89PNG")
    assert alfmu.Result.from_csv(table).names == tuple(NOISE)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--vary", "m22"], "no parameter, start value or input 'm22'"),
        (["--vary", "m2", "--columns", "link9"], "no column 'link9'"),
        (["--vary", "m2", "--bounds", "m2=2:3"], "m2 begins at 1, outside its bounds"),
        (["--vary", "m2", "--bounds", "l=2:3"], "bounds are given for 'l', which is not varied"),
        (["--vary", "A.torque"], "A.torque is an input"),
        (["--vary", "m2", "--deviation", "link1.angle=0"], "must be a finite number above zero"),
    ],
)
def test_wrong_words_are_refused(tmp_path, capsys, words, why):
    measured().to_csv(tmp_path / "data.csv")
    assert main(["fit", "five_bar", str(tmp_path / "data.csv"), *words]) == 1
    assert why in capsys.readouterr().err
