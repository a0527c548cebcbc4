"""What a scene does not need is left out: outputs by pattern, frozen parameters, and what `alfmu info` says of it."""

import math
import re

import casadi as ca
import numpy as np
import pytest
from scenes import by_rk4, derived

import alfmu
from alfmu.cli import main
from alfmu.equations.interface import MONITORS, SOLVED
from alfmu.equations.specialisation import specialised
from alfmu.equations.types import REACTION_ERROR
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.kernel.controlled import whole
from alfmu.kernel.form import called
from alfmu.simulation import prepared, run
from alfmu.studies.cost import cost, described, operations

pytestmark = pytest.mark.usefixtures("quick_compiler")

WANTED = ["link*.angle", "A.force.x"]


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["vm", "compiled"])
def test_only_the_outputs_that_match_are_there_with_the_same_values(kernel):
    some = alfmu.simulate(by_rk4("five_bar"), 1.0, 0.02, outputs=WANTED, kernel=kernel)
    every = alfmu.simulate(by_rk4("five_bar"), 1.0, 0.02, kernel=kernel)
    names = ["link1.angle", "link2.angle", "link3.angle", "link4.angle", "A.force.x"]
    assert sorted(some.names) == sorted([*names, *(v.name for v in derived("five_bar").inputs)])
    for name in names:
        assert np.abs(some[name] - every[name]).max() <= 1e-12 * np.abs(every[name]).max(), name


@pytest.mark.slow
def test_a_monitor_alone_has_its_values():
    """Also those that take accelerations, multipliers or pivots, which no other output asks for then."""
    how = {"inputs": {"A.torque": 4.0}, "parameters": {"solver.method": "rk4"}}
    names = [v.name for v in MONITORS]
    every = alfmu.simulate("four_bar", 0.4, 0.02, outputs=["*", REACTION_ERROR], **how)
    for name in names:
        alone = alfmu.simulate("four_bar", 0.4, 0.02, outputs=[name], **how)[name]
        assert np.array_equal(alone, every[name]), name
        assert name not in SOLVED or np.abs(alone).max() > 0, name


@pytest.mark.slow
def test_what_is_traced_for_all_outputs_is_traced_again_for_some():
    e = prepared(by_rk4("four_bar"))
    some = alfmu.simulate(e, 0.1, 0.02, outputs=["link1.angle"])
    assert some.names == ("link1.angle", *(v.name for v in e.inputs))
    assert np.array_equal(some["link1.angle"], alfmu.simulate(e, 0.1, 0.02)["link1.angle"])


@pytest.mark.slow
def test_what_nobody_watches_is_not_a_number_in_the_counters():
    some = alfmu.simulate(by_rk4("five_bar"), 0.1, 0.02, outputs=["link1.angle", "monitor.energy"])
    assert math.isnan(some.counters.position_error)
    assert math.isnan(some.counters.velocity_error)
    assert some.counters.energy_error < 1e-3
    assert "monitor.energy" in some.names
    assert math.isnan(alfmu.simulate(by_rk4("five_bar"), 0.1, 0.02, outputs=["link1.x"]).counters.energy_error)


@pytest.mark.slow
def test_wrapped_angles_go_on_counting_where_they_are_kept():
    """A crank in natural coordinates over several turns."""
    start = {"start.angular_velocity": 9.0}
    e = by_rk4("slider_crank", coordinates="natural")
    some = alfmu.simulate(e, 3.0, 0.02, parameters=start, outputs=["rod.angle", "crank.angle"])
    every = alfmu.simulate(e, 3.0, 0.02, parameters=start)
    assert np.array_equal(some["crank.angle"], every["crank.angle"])
    assert np.ptp(every["crank.angle"]) > 2 * math.pi
    none = alfmu.simulate(e, 3.0, 0.02, parameters=start, outputs=["slider.x"])
    assert np.array_equal(none["slider.x"], every["slider.x"])


@pytest.mark.slow
def test_without_reactions_no_reaction_equation_is_left():
    e = prepared(specialised(derived("five_bar"), ["link*.angle"]))
    everything = prepared(derived("five_bar"))
    assert list(called(whole(e).kernel["instant"])) == ["seen"]
    assert cost(e).outputs < 20 < cost(everything).outputs / 50
    assert cost(e).step < cost(everything).step  # no work is integrated for a balance that nobody reads


@pytest.mark.parametrize("patterns", [["nonsense"], ["link1.angle", "*.speed"], "nonsense"])
def test_a_pattern_that_matches_nothing_is_refused(patterns):
    with pytest.raises(alfmu.InputError, match=r"five_bar has no output '(nonsense|\*\.speed)'; it has link1\.x"):
        alfmu.simulate("five_bar", 0.1, 0.02, outputs=patterns)


@pytest.mark.slow
def test_a_multiplier_is_found_by_its_name():
    assert "multiplier[3]" in alfmu.simulate(by_rk4("five_bar"), 0.1, 0.02, outputs=["multiplier[3]"]).names


@pytest.mark.slow
@pytest.mark.parametrize(("kernel", "freeze"), [("vm", ["all"]), ("compiled", ["m2", "l"])])
def test_frozen_parameters_are_constants_at_the_values_given(kernel, freeze):
    """The same motion and reactions to round-off, with m2 = 0.25, from fewer operations."""
    start = {"m2": 0.25, "start.angle": 1.2}  # no singular position on the way
    runs = [
        alfmu.simulate(by_rk4("five_bar"), 0.5, 0.02, parameters=start, freeze=names, kernel=kernel)
        for names in (freeze, None)
    ]
    assert runs[0].names == runs[1].names
    assert np.abs(runs[0].values - runs[1].values).max() <= 1e-10 * np.abs(runs[1].values).max()
    plain, frozen = (prepared(specialised(derived("five_bar"), None, names)) for names in (None, freeze))
    assert cost(frozen).step < cost(plain).step
    left = [p.name for p in frozen.parameters]
    assert left == ([] if freeze == ["all"] else [p.name for p in plain.parameters if p.name not in freeze])


def test_a_mass_frozen_at_zero_leaves_no_term():
    """m2 = 0 in the mass matrix of the five-bar takes its entries out of the structure."""
    massless = alfmu.simulation.with_defaults(derived("five_bar"), {"m2": 0.0})
    frozen = cost(prepared(specialised(massless, None, ["all"])))
    assert frozen.nonzeros["M"] == cost(prepared(derived("five_bar"))).nonzeros["M"] - 3


@pytest.mark.slow
def test_freezing_what_is_no_parameter_is_refused():
    with pytest.raises(alfmu.InputError, match=r"five_bar has no parameter 'start\.angle' to freeze; it has l, m1"):
        alfmu.simulate("five_bar", 0.1, 0.02, freeze=["start.angle"])
    i = alfmu.Instance(specialised(by_rk4("five_bar"), None, ["all"]))
    with pytest.raises(alfmu.InputError, match="no input or parameter 'm2'"):
        i.set("m2", 1.0)


@pytest.mark.slow
def test_an_fmu_has_only_what_it_was_asked_for(built, tmp_path):
    given = {"outputs": WANTED, "freeze": ["all"], "parameters": {"m2": 0.5}, "reference": False}
    path = alfmu.export("five_bar", tmp_path / "lean.fmu", **given)
    assert validate(path) == []
    with Fmu(path) as fmu:
        names = {v.name for v in fmu.description.modelVariables}
        assert {"link1.angle", "A.force.x", "start.angle", "solver.step_size"} <= names
        assert not {"m2", "link1.x", "A.force.y", "monitor.energy", "multiplier[1]"} & names
        result = run(fmu, 0.5, 0.02, parameters={"start.angle": 1.2})
    library = alfmu.simulate("five_bar", 0.5, 0.02, parameters={"m2": 0.5, "start.angle": 1.2})
    assert np.abs(result["A.force.x"] - library["A.force.x"]).max() <= 1e-11 * np.abs(library["A.force.x"]).max()
    assert path.stat().st_size < built("five_bar").stat().st_size


def test_operations_are_counted_without_moves():
    x = ca.SX.sym("x", 3)
    assert operations(ca.Function("f", [x], [x[0] * x[1] + 2.5, x[2]])) == 2


@pytest.mark.slow
def test_info_says_what_a_scene_costs_and_what_was_left_out(capsys):
    assert main(["info", "five_bar", "--all", "--outputs", "link*.angle", "--freeze", "all"]) == 0
    text = capsys.readouterr().out
    step = int(re.search(r"operations of a step: (\d+)", text)[1])
    parts = {
        name: int(count)
        for name, count in re.findall(
            r"^  (model|factorisation|iterations|integration|projection)\s+(\d+)$", text, re.M
        )
    }
    assert len(parts) == 5
    rest = int(re.search(r"^  checks, minus shared operations\s+(-?\d+)$", text, re.M)[1])
    assert sum(parts.values()) + rest == step
    assert re.search(r"structural nonzeros: M 8, C 24, H 40, L \d+", text)
    saved, full = (
        [int(x) for x in re.search(rf"^  {what}\s+(\d+)\s+(\d+)$", text, re.M).groups()]
        for what in ("in all", "the same scene with all parts")
    )
    everything = cost(prepared(derived("five_bar")))
    assert full == [everything.step, everything.outputs]
    assert saved[0] == full[0] - step
    assert "6 parameters, folded into constants" in text
    assert "all accelerations and reactions with them" in text


@pytest.mark.slow
def test_info_of_a_scene_that_needs_everything():
    i = alfmu.Instance(derived("five_bar"))
    i.initialize()
    assert "  nothing: all of it is needed" in described(derived("five_bar"), derived("five_bar"), i.mobility())


def test_an_fmu_takes_no_options_of_its_making(built, capsys):
    path = built("particle_on_circle")
    assert main(["simulate", str(path), "--outputs", "particle.x"]) == 1
    assert main(["simulate", str(path), "--freeze", "all"]) == 1
    assert "give them to `alfmu export`" in capsys.readouterr().err


@pytest.mark.slow
def test_from_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["simulate", "five_bar", "--stop-time", "0.2", "--outputs", "link1.*,monitor.energy"]
    assert main([*arguments, "--freeze", "m1,m2", "--set", "m2=0.5", "--set", "solver.method=rk4"]) == 0
    header = (tmp_path / "five_bar.csv").read_text().splitlines()[0].split(",")
    assert "link1.angle" in header
    assert "monitor.energy" in header
    assert "link2.angle" not in header
