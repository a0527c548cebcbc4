"""The library as a user's code meets it: results, what `simulate` takes, short texts, lists, scenes that are shared."""

import importlib.metadata
import json
import subprocess
import sys

import casadi as ca
import numpy as np
import pytest

import alfmu
from alfmu.equations import derivation
from alfmu.kernel.complete import complete
from alfmu.kernel.tables import packed
from alfmu.model.kept import MOST
from alfmu.runtime import library as binding
from alfmu.runtime import pipeline

FILE = """
from alfmu import Mechanism

def pendulum(kind: str = "plain") -> Mechanism:
    m = Mechanism("pendulum")
    mass = m.parameter("mass", 1.5, "kg", minimum=0.0)
    l = m.parameter("l", 1.0, "m", minimum=1e-6)
    angle = m.coordinate("angle", "rad", start=0.5, independent=True)
    rod = m.bar("rod", mass=mass, length=l)
    hinge = m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=angle)
    m.drive(hinge, m.input("A.torque", "N.m"))
    m.gravity(0, -9.81)
    return m
"""


def pendulum() -> alfmu.Mechanism:
    names: dict = {}
    exec(FILE, names)
    return names["pendulum"]()


@pytest.fixture(scope="module")
def four_bar() -> alfmu.Result:
    return alfmu.simulate("four_bar", 1.0, 0.05, parameters={"m2": 2.0})


# Results ------------------------------------------------------------------------------------------------------------


def test_a_result_is_a_collection_of_columns_by_name(four_bar):
    r = four_bar
    assert len(r) == len(list(r)) == len(r.names) == r.values.shape[1]
    assert "link1.angle" in r
    assert "link9.angle" not in r
    assert dict(r).keys() == set(r.names)
    assert all(np.array_equal(column, r[name]) for name, column in dict(r).items())
    assert r["time"] is r.time
    assert r.units["link1.angle"] == "rad"
    assert r.units["A.force.x"] == "N"


def test_patterns_take_several_columns(four_bar):
    r = four_bar
    angles = r["link*.angle"]
    assert angles.shape == (len(r.time), 3)
    assert np.array_equal(angles, np.column_stack([r[f"link{k}.angle"] for k in (1, 2, 3)]))
    assert np.array_equal(r["multiplier[[]2]"][:, 0], r["multiplier[2]"])  # a name is a name before it is a pattern
    chosen = r.select("A.*", "link?.angle", "A.force.x")
    assert chosen.names == ("A.force.x", "A.force.y", "A.torque", "link1.angle", "link2.angle", "link3.angle")
    assert set(chosen.units) == set(chosen.names)
    assert np.array_equal(chosen["link2.angle"], r["link2.angle"])
    with pytest.raises(alfmu.InputError, match=r"has no column like 'lever\*\.angle'; did you mean"):
        r["lever*.angle"]
    with pytest.raises(alfmu.InputError, match=r"has no column 'link1\.angel'; did you mean link1\.angle"):
        r["link1.angel"]


def test_a_table_keeps_units_drawing_and_what_was_run(four_bar, here):
    four_bar.to_csv("run.csv")
    assert (here / "run.csv").read_text().startswith("time,link1.x,link1.vx,")  # as importers of FMUs read it
    again = alfmu.Result.from_csv("run.csv")
    assert again.units == four_bar.units
    assert again.mechanism == "four_bar"
    assert again.names == four_bar.names
    assert again.values.tobytes() == four_bar.values.tobytes()
    assert again.facts["parameters"] == {"m2": 2.0}
    again.animate("film.html")
    four_bar.animate("same.html")
    assert (here / "film.html").read_bytes() == (here / "same.html").read_bytes()
    again.to_csv("copy.csv")
    assert (here / "copy.json").read_bytes() == (here / "run.json").read_bytes()


def test_a_table_of_former_times_or_from_elsewhere_is_read(four_bar, here):
    four_bar.to_csv("run.csv")
    facts = json.loads((here / "run.json").read_text())
    (here / "run.json").write_text(json.dumps({k: facts[k] for k in ("mechanism", "options", "parameters")}))
    old = alfmu.Result.from_csv("run.csv")
    assert (old.mechanism, old.units) == ("run", {})
    (here / "run.json").unlink()
    bare = alfmu.Result.from_csv("run.csv")
    assert (bare.mechanism, bare.units, bare.facts) == ("run", {}, {})
    with pytest.raises(alfmu.InputError, match="the result of run has no drawing"):
        bare.animate("film.html")
    (here / "run.json").write_text('{"mechanism": "x", "options": {}, "parameters": {}, "units": {"link1.x": 3}}')
    assert alfmu.Result.from_csv("run.csv").units == {}


def test_a_table_replaces_no_facts_of_anyone_else(four_bar, here):
    (here / "run.json").write_text('{"precious": 1}')
    with pytest.raises(alfmu.InputError, match=r"run\.json exists and was not written by alfmu"):
        four_bar.to_csv("run.csv")
    assert not (here / "run.csv").exists()
    assert (here / "run.json").read_text() == '{"precious": 1}'


def test_fmpy_reads_a_table_and_takes_it_as_input(here, exported):
    import fmpy
    from fmpy.util import read_csv

    r = alfmu.simulate("four_bar", 0.2, 0.02, inputs={"A.torque": lambda t: 3 * t})
    r.to_csv("run.csv")
    table = read_csv("run.csv")
    assert np.array_equal(table["A.torque"], r["A.torque"])
    assert alfmu.Result.from_csv("run.csv")["link1.angle"].tolist() == table["link1.angle"].tolist()
    r.select("A.torque").to_csv("in.csv")
    result = fmpy.simulate_fmu(
        str(exported("four_bar")), stop_time=0.2, output_interval=0.02, input=read_csv("in.csv"), output=["A.torque"]
    )
    assert result["A.torque"][-1] == pytest.approx(0.6, abs=0.07)


@pytest.mark.slow
def test_pandas_has_the_columns_over_time(four_bar):
    pytest.importorskip("pandas")
    table = four_bar.to_pandas()
    assert table.index.name == "time"
    assert list(table.columns) == list(four_bar.names)
    assert table["link1.angle"].to_numpy().tolist() == four_bar["link1.angle"].tolist()
    assert table.attrs["units"]["A.force.x"] == "N"
    assert table.loc[0.5:, "link1.angle"].size == 11


def test_what_is_missing_is_said(four_bar, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(alfmu.InputError, match=r"pip install 'alfmu\[pandas\]'"):
        four_bar.to_pandas()


def test_a_plot_is_a_figure_of_what_was_asked_for(four_bar):
    figure = four_bar.plot("link*.angle")
    lines = [line for axes in figure.axes for line in axes.get_lines()]
    labels = " ".join(str(line.get_label()) for line in lines)
    assert all(f"link{k}.angle" in labels for k in (1, 2, 3))
    assert "force" not in labels
    assert np.array_equal(lines[0].get_xdata(), four_bar.time)
    assert four_bar.plot().axes
    one, other = four_bar.plot("link1.angle", "A.force.x"), four_bar.plot(["link1.angle", "A.force.x"])
    assert [len(figure.axes) for figure in (one, other)] == [2, 2]
    assert [axes.get_ylabel() for axes in one.axes] == [axes.get_ylabel() for axes in other.axes]


def test_a_film_shows_itself_in_a_notebook(four_bar, here):
    film = four_bar.animate()
    assert film.html.startswith("<!DOCTYPE html>")
    assert "<iframe srcdoc=" in film._repr_html_()
    assert len(repr(film)) < 80
    assert four_bar.animate("film.gif") is None
    assert (here / "film.gif").read_bytes().startswith(b"GIF89a")


def test_a_notebook_shows_the_ranges_of_a_result(four_bar):
    page = four_bar._repr_html_()
    assert "<td>link1.angle</td><td>rad</td>" in page
    assert f"{len(four_bar) - 25} more columns" in page
    assert page.count("<tr>") == 27


def test_a_mechanism_that_was_changed_is_not_drawn_as_it_ran():
    m = pendulum()
    r = alfmu.simulate(m, 0.2, 0.05)
    m.bodies[0].length = 0.3
    with pytest.raises(alfmu.InputError, match="pendulum was changed since this run"):
        r.animate()


# What simulate takes ------------------------------------------------------------------------------------------------


def test_simulate_takes_a_mechanism_a_file_a_name_an_fmu_a_recipe_and_equations(here, exported):
    (here / "pendulum.py").write_text(FILE)
    runs = [alfmu.simulate(of, 0.4, 0.05) for of in (pendulum(), "pendulum.py", here / "pendulum.py")]
    runs += [alfmu.simulate(alfmu.derive(pendulum()), 0.4, 0.05)]
    runs += [alfmu.simulate(alfmu.Recipe(pendulum(), outputs=["rod.*"]), 0.4, 0.05)]
    path = alfmu.export("pendulum.py", here / "p.fmu", reference=False)
    runs += [alfmu.simulate(path, 0.4, 0.05), alfmu.simulate(str(path), 0.4, communication_step=0.05)]
    assert len({r["rod.angle"].tobytes() for r in runs}) == 1
    assert "A.force.x" not in runs[4]
    assert runs[5].units["rod.angle"] == "rad"


@pytest.mark.slow
def test_simulate_takes_the_names_of_recipes_and_the_options_of_an_fmu(exported):
    r = alfmu.simulate("five_bar_reactions", 0.1)
    assert [name for name in r if name.startswith("link")] == [f"link{k}.angle" for k in (1, 2, 3, 4)]
    fmu = alfmu.simulate(exported("slider_crank", coordinates="joint"), 0.1, 0.02, parameters={"m1": 2.0})
    own = alfmu.simulate(alfmu.load("slider_crank", coordinates="joint"), 0.1, 0.02, parameters={"m1": 2.0})
    assert fmu["crank.angle"].tobytes() == own["crank.angle"].tobytes()
    assert fmu.facts["options"]["coordinates"] == "joint"
    assert fmu.animate() is not None
    with pytest.raises(alfmu.InputError, match="fixed when it is exported"):
        alfmu.simulate(exported("slider_crank", coordinates="joint"), outputs=["*.angle"])


# Settings -----------------------------------------------------------------------------------------------------------


def test_settings_are_variables_and_nothing_else():
    with pytest.raises(AttributeError, match=r"parameters=\{'solver\.method': 'explicit'\}"):
        alfmu.Settings  # noqa: B018
    for given, meant in (
        ("method", r"solver\.method"),
        ("tolerance", r"solver\.relative_tolerance"),
        ("step_size", r"solver\.step_size"),
    ):
        with pytest.raises(alfmu.InputError, match=f"has no input or parameter {given!r}; did you mean .*{meant}"):
            alfmu.simulate("four_bar", 0.1, parameters={given: 1e-3})


@pytest.mark.slow
def test_a_setting_is_the_same_however_it_is_given(exported):
    given = {"solver.method": "explicit", "solver.relative_tolerance": 1e-9, "m2": 3.0}
    by_parameters = alfmu.simulate("four_bar", 1.0, 0.1, parameters=given)
    instance = alfmu.Instance("four_bar")
    for name, value in given.items():
        instance.set(name, value)
    by_instance = alfmu.simulation.run(instance, 1.0, 0.1)
    by_recipe = alfmu.simulate(alfmu.Recipe("four_bar", parameters=given), 1.0, 0.1)
    assert by_parameters.values.tobytes() == by_instance.values.tobytes() == by_recipe.values.tobytes()
    assert by_parameters.counters == by_instance.counters
    plain = alfmu.simulate("four_bar", 1.0, 0.1, parameters={"m2": 3.0, "solver.method": "rk4"})
    assert plain.counters.evaluations != by_parameters.counters.evaluations


# Scenes that are shared ---------------------------------------------------------------------------------------------


@pytest.fixture
def traces(monkeypatch, uncached) -> list[str]:
    """The names of the mechanisms that were traced, one for each time."""
    traced, seen = pipeline.traced, []

    def counted(equations, *arguments, **named):
        seen.append(equations.name)
        return traced(equations, *arguments, **named)

    monkeypatch.setattr(pipeline, "traced", counted)
    monkeypatch.setattr(pipeline, "_KEPT", type(pipeline._KEPT)())
    return seen


def fresh(m: alfmu.Mechanism, **how) -> alfmu.Result:
    """A run that shares nothing."""
    return alfmu.simulate(derivation.derive(m), 0.5, 0.05, **how)


def test_a_study_of_four_values_takes_one_trace(traces):
    m, masses = pendulum(), (0.5, 1.0, 2.0, 4.0)
    runs = [
        alfmu.simulate(m, 0.5, 0.05, parameters={"l": x, "start.angle": x / 4}, inputs={"A.torque": x}) for x in masses
    ]
    assert traces == ["pendulum"]
    for x, run in zip(masses, runs, strict=True):
        alone = fresh(m, parameters={"l": x, "start.angle": x / 4}, inputs={"A.torque": x})
        assert run.values.tobytes() == alone.values.tobytes()
    assert len({run.values.tobytes() for run in runs}) == 4


def test_the_same_declaration_is_traced_once_whoever_declares_it(traces, here):
    (here / "pendulum.py").write_text(FILE)
    for of in ("pendulum.py", "pendulum.py", alfmu.load("pendulum.py"), alfmu.Recipe("pendulum.py")):
        alfmu.simulate(of, 0.1, parameters={"mass": 2.0})
    alfmu.Instance("pendulum.py").initialize()
    assert traces == ["pendulum"]
    (here / "pendulum.py").write_text(FILE.replace("9.81", "1.62"))
    moon = alfmu.simulate("pendulum.py", 0.5, 0.05)
    assert traces == ["pendulum"] * 2
    assert moon["rod.angle"][-1] != alfmu.simulate(pendulum(), 0.5, 0.05)["rod.angle"][-1]


CHANGES = {
    "a number of a body": lambda m: setattr(m.bodies[0], "mass", 9.0),
    "its centre": lambda m: setattr(m.bodies[0], "center", (0.1, 0.2)),
    "an expression": lambda m: setattr(m.bodies[0], "inertia", m.parameters[0].symbol * m.parameters[1].symbol ** 2),
    "another of the same form": lambda m: setattr(m.bodies[0], "mass", m.parameters[1].symbol),
    "a spring": lambda m: m.spring_damper(m.joints[0], stiffness=20.0, damping=0.1),
    "gravity": lambda m: m.gravity(1.0, -9.81),
    "a load": lambda m: m.force(m.bodies[0].end, 3.0, 0.0),
    "an energy": lambda m: m.kinetic_energy(0.5 * m.rate(m.coordinates[0].q) ** 2),
    "a force": lambda m: m.generalized_force(m.coordinates[0].q, 2.0 * ca.sin(m.time)),
    "an output": lambda m: m.output("twice", 2 * m.coordinates[0].q, "rad"),
    "a release": lambda m: m.lock("A"),
}


@pytest.mark.slow
def test_a_mechanism_that_changes_between_runs_is_traced_again(traces):
    """Each change is one more."""
    m, by_rk4 = pendulum(), {"parameters": {"solver.method": "rk4"}}
    before = alfmu.simulate(m, 0.5, 0.05, **by_rk4)
    for what, change in CHANGES.items():
        change(m)
        traces.clear()
        after = alfmu.simulate(m, 0.5, 0.05, **by_rk4)
        assert traces == ["pendulum"], what
        expected = fresh(m, **by_rk4)
        assert after.names == expected.names, what
        assert after.values.tobytes() == expected.values.tobytes(), what
        assert after.values.tobytes() != before.values.tobytes(), what
        before = after


@pytest.mark.slow
def test_what_a_scene_is_traced_with_is_not_shared(traces):
    m = pendulum()
    frozen = [alfmu.simulate(m, 0.5, 0.05, parameters={"l": l}, freeze=["l"]) for l in (1.0, 2.0)]
    assert len(traces) == 2
    assert frozen[1]["rod.angle"].tobytes() != frozen[0]["rod.angle"].tobytes()
    assert frozen[1]["rod.angle"] == pytest.approx(fresh(m, parameters={"l": 2.0})["rod.angle"], abs=1e-12)
    count = len(traces)
    few = alfmu.simulate(m, 0.5, 0.05, outputs=["rod.angle"])
    assert few.names == ("rod.angle", "A.torque")
    assert len(traces) == count + 1
    for method in ("explicit", "rk4", "explicit"):
        run = alfmu.simulate(m, 0.5, 0.05, parameters={"solver.method": method})
        assert run.values.tobytes() == fresh(m, parameters={"solver.method": method}).values.tobytes()


def test_auto_chooses_by_the_values_of_the_run(traces):
    m = pendulum()
    m.spring_damper(m.joints[0], damping=m.parameter("c", 0.0, "N.m.s/rad", minimum=0.0))
    for c, method in ((0.0, "explicit"), (1e5, "stiff"), (0.1, "explicit"), (2e5, "stiff")):
        run = alfmu.simulate(m, 0.5, 0.1, parameters={"c": c, "solver.method": "auto"})
        assert run["rod.angle"] == pytest.approx(
            fresh(m, parameters={"c": c, "solver.method": method})["rod.angle"][::2], abs=1e-5
        )
        (equations,) = pipeline._KEPT.values()
        scene, left = pipeline.ready(equations, {"c": c, "solver.method": "auto"}, None, None, "vm")
        assert scene.decision.method == method
        assert left == {"c": c}
    (all_outputs,) = equations.kept.of(pipeline.chosen).values()
    assert len(all_outputs.kept.of(pipeline.ready)) == 2


def test_equations_that_differ_in_numbers_alone_are_traced_once(traces):
    """And their scene files are those of equations that share nothing."""
    m, heavier, finer = pendulum(), {"mass": 7.0}, {"solver.step_size": 1e-3, "solver.relative_tolerance": 1e-7}
    e = derivation.derive(m)

    def scene_of(values, equations=e):
        return packed(complete(pipeline.prepared(pipeline.with_defaults(equations, values))))

    shared = [scene_of(values) for values in ({}, heavier, finer)]
    assert len(traces) == 1
    loose = scene_of({"solver.relative_tolerance": 1e-3})
    assert len(traces) == 2, "loose tolerances take another pair"
    for values, scene in ((heavier, shared[1]), (finer, shared[2]), ({"solver.relative_tolerance": 1e-3}, loose)):
        assert scene_of(values, derivation.derive(m)) == scene != shared[0]


@pytest.mark.slow
def test_only_the_latest_mechanisms_are_kept(traces):
    for k in range(MOST + 2):
        m = pendulum()
        m.gravity(0.0, -float(k))
        alfmu.derive(m)
    assert len(pipeline._KEPT) == MOST


@pytest.mark.slow
def test_only_the_latest_scenes_of_a_mechanism_are_kept(traces):
    m, count, rk4 = pendulum(), MOST + 2, {"solver.method": "rk4"}
    for k in range(count):
        alfmu.simulate(m, 0.1, 0.05, parameters=rk4 | {"l": 1.0 + k}, freeze=["l"])
    (equations,) = pipeline._KEPT.values()
    assert len(equations.kept.of(pipeline.chosen)) == MOST
    assert len(traces) == count
    alfmu.simulate(m, 0.1, 0.05, parameters=rk4 | {"l": float(count)}, freeze=["l"])
    assert len(traces) == count


# Texts and lists ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_repr_is_a_short_line():
    m = alfmu.load("five_bar")
    bennett = alfmu.load("bennett")
    e, i = alfmu.derive(m), alfmu.Instance("five_bar")
    things = [m, bennett, m.experiment, e, i, alfmu.Recipe(m), *e.outputs, *e.parameters, *e.rows, *e.switches]
    for each in (m, bennett, alfmu.load("end_stop"), alfmu.load("flexible_four_bar"), alfmu.load("flyball_governor")):
        for name in {name: None for its in alfmu.Mechanism.__mro__ for name in vars(its)}:
            if isinstance(found := getattr(each, name), tuple):
                things += [part for part in found if type(part).__module__.startswith("alfmu")]
    s = alfmu.Mechanism("space")
    ball = s.spatial_body("ball", mass=1.0, inertia=(1.0, 1.0, 1.0))
    things += [ball, ball.at(1, 2, 3), s.spherical("S", s.spatial_ground.at(), ball.at(0, 0, 1))]
    things += [m.bodies[0].end, alfmu.simulate("four_bar", 0.1)]
    assert len(things) > 150
    for thing in things:
        assert "\n" not in repr(thing)
        assert len(repr(thing)) < 400, repr(thing)
    assert repr(m) == "Mechanism('five_bar', 8 coordinates, 2 inputs, 4 bodies, 6 joints)"
    assert repr(m.bodies[0]).startswith("Body(name='link1', mass=m1, ")


def test_mechanisms_and_bodies_are_equal_to_themselves_alone():
    one, other = pendulum(), pendulum()
    assert one != other
    assert one.bodies[0] != other.bodies[0]
    assert len({one, other, one.bodies[0], other.bodies[0]}) == 4


def test_lists_of_a_mechanism_are_read_and_not_written():
    m = pendulum()
    kept = {name: getattr(m, name) for name in ("bodies", "joints", "parameters", "coordinates", "closures", "outputs")}
    for name, found in kept.items():
        assert isinstance(found, tuple)
        with pytest.raises(alfmu.DeclarationError, match=r"pendulum: its .* cannot be set; declare them"):
            setattr(m, name, [])
        assert getattr(m, name) == found
    instance = alfmu.Instance(m)
    assert all(isinstance(x, tuple) for x in (instance.outputs, instance.parameters, instance.input_variables))


def test_public_names_are_found(four_bar):
    assert dir(alfmu) == sorted(alfmu.__all__)
    assert {"Mechanism", "Result", "simulate", "export"} <= set(dir(alfmu))
    assert alfmu.__all__ == sorted(alfmu.__all__, key=lambda name: (name.islower(), name))


def test_python_m_alfmu_is_the_command():
    done = subprocess.run([sys.executable, "-m", "alfmu", "--version"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert done.stdout.startswith("alfmu ")


def test_the_version_is_that_of_the_installation():
    assert alfmu.__version__ == importlib.metadata.version("alfmu")


# Steps from Python --------------------------------------------------------------------------------------------------


def test_a_step_is_a_built_in_function_where_python_is_cpython(monkeypatch):
    """It gives what the call by ctypes gives, and refuses what is no number."""
    instances = []
    for name in (sys.implementation.name, "another"):
        monkeypatch.setattr(sys.implementation, "name", name)
        instances.append(alfmu.Instance(pendulum()))
        instances[-1].initialize()
    built_in, by_ctypes = (instance._unit.step for instance in instances)
    assert "built-in" in repr(built_in)
    assert "partial" in repr(by_ctypes)
    for start, length in ((0.0, 0.01), (0.01, 0.01), (0.5, 0.01), (0.02, -1.0), (0, 1)):
        assert built_in(start, length) == by_ctypes(start, length)
        assert instances[0]._unit.text == instances[1]._unit.text
    assert np.array_equal(instances[0].memory["z"], instances[1].memory["z"])
    for arguments in (("x", 1.0), (0.02, None)):
        with pytest.raises(TypeError):
            built_in(*arguments)
    assert built_in() == built_in(0.02) == binding.REFUSED
