"""Recipes: what `alfmu export` and `pythonfmu build` make of a file in `fmus`, through real FMUs."""

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from itertools import pairwise
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

import alfmu
from alfmu import Recipe
from alfmu.catalogue.registry import executed
from alfmu.cli import main
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.fmi.entry import Entry
from alfmu.fmi.recipe import load
from alfmu.runtime.build import HERE, PLATFORMS, file_name, zig
from alfmu.simulation import communication_points, run

ROOT = Path(__file__).parents[1]

PENDULUM = """
from alfmu import Mechanism

def pendulum(rods: int = 1) -> Mechanism:
    m = Mechanism("pendulum", "Bars on a hinge")
    l = m.parameter("l", 1.0, "m", minimum=1e-6)
    mass = m.parameter("mass", 1.0, "kg", minimum=0.0)
    th = m.coordinate("th", "rad", start=0.5, independent=True)
    rod = m.bar("rod", mass=mass * rods, length=l)
    A = m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th)
    m.drive(A, m.input("A.torque", "N.m"))
    m.gravity(0, -9.81)
    return m
"""

HEAVY = """
from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe(
    "mechanisms/pendulum.py",
    options={"rods": 3},
    parameters={"l": 2.0, "start.th": 0.2, "solver.relative_tolerance": 1e-7},
    outputs=["rod.angle", "A.force.*"],
    freeze=["mass"],
    stop_time=3.0,
    communication_step=0.05,
)


class Heavy(Entry, recipe=recipe):
    pass
"""

LIGHT = """
from alfmu import Recipe

recipe = Recipe("mechanisms/pendulum.py", outputs=["rod.angular_velocity"], parameters={"mass": 0.1})
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a mechanism and two recipes of it, which is left for another one: paths are the recipes' own."""
    (tmp_path / "mechanisms").mkdir()
    (tmp_path / "mechanisms" / "pendulum.py").write_text(PENDULUM)
    (tmp_path / "heavy.py").write_text(HEAVY)
    (tmp_path / "light.py").write_text(LIGHT)
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return tmp_path


def pendulum(here: Path) -> alfmu.Result:
    """The run of the heavy pendulum by the library."""
    m = alfmu.load(here / "mechanisms" / "pendulum.py", rods=3)
    parameters = {"l": 2.0, "start.th": 0.2, "solver.relative_tolerance": 1e-7}
    outputs = ["rod.angle", "A.force.*"]
    return alfmu.simulate(m, 1.0, 0.05, parameters=parameters, outputs=outputs, freeze=["mass"])


def is_the_heavy_pendulum(path: Path, here: Path) -> None:
    """Whether an FMU has what the recipe says, and the numbers of the library to the last bit."""
    description = fmpy.read_model_description(str(path))
    found = {v.name: v for v in description.modelVariables}
    assert description.modelName == "heavy"
    assert [v.name for v in found.values() if v.causality == "output"] == ["rod.angle", "A.force.x", "A.force.y"]
    assert (found["l"].start, found["start.th"].start) == ("2", "0.20000000000000001")
    assert "mass" not in found
    experiment = description.defaultExperiment
    assert [float(getattr(experiment, x)) for x in ("stopTime", "stepSize", "tolerance")] == [3.0, 0.05, 1e-7]
    result = fmpy.simulate_fmu(str(path), stop_time=1.0, output_interval=0.05)
    library = pendulum(here)
    for name in ("rod.angle", "A.force.x", "A.force.y"):
        assert np.array_equal(result[name], library[name])
    assert np.abs(library["A.force.y"]).max() > 20.0  # three bars


@pytest.mark.slow
def test_a_recipe_makes_the_fmu_that_it_describes(here, capsys):
    assert main(["export", "../heavy.py"]) == 0
    assert "wrote heavy.fmu" in capsys.readouterr().out
    is_the_heavy_pendulum(Path("heavy.fmu"), here)
    assert validate("heavy.fmu") == []
    assert alfmu.export(here / "heavy.py", "again.fmu").read_bytes() == Path("heavy.fmu").read_bytes()
    with zipfile.ZipFile("heavy.fmu") as archive:
        assert "extra/org.fmi-standard.fmi-ls-ref/heavy_smoke_test_ref.csv" in archive.namelist()
        assert json.loads(archive.read("resources/options.json"))["options"] == {"rods": 3}


@pytest.mark.slow
def test_a_recipe_can_be_looked_at_and_run_without_an_fmu(here, capsys):
    assert main(["info", "../heavy.py", "--all"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("heavy: Bars on a hinge")
    assert "option rods = 3 (whole number)" in out
    assert "rod.angle" in out
    assert "rod.x" not in out
    assert main(["simulate", "../heavy.py", "--stop-time", "1"]) == 0
    result = alfmu.Result.from_csv("heavy.csv")
    assert np.array_equal(result["A.force.y"], pendulum(here)["A.force.y"])
    assert json.loads(Path("heavy.json").read_text())["parameters"]["l"] == 2.0
    assert main(["simulate", "../heavy.py", "--stop-time", "0.5", "--outputs", "*"]) == 0
    assert main(["animate", "heavy.csv", "-o", "film.html", "--fps", "5"]) == 0
    (here / "held.py").write_text(f"{PENDULUM}\nfrom alfmu import Recipe\nrecipe = Recipe(pendulum())\n")
    assert main(["info", "../held.py"]) == 0
    assert main(["simulate", "../held.py", "--stop-time", "0.1", "--set", "l=2", "-o", "held.csv"]) == 0
    assert main(["animate", "held.csv", "-o", "film.html", "--fps", "5"]) == 0


def test_two_recipes_of_one_mechanism_stand_side_by_side(here):
    paths = [alfmu.export(here / f"{name}.py", name + ".fmu") for name in ("heavy", "light")]
    descriptions = [fmpy.read_model_description(str(path)) for path in paths]
    assert [d.modelName for d in descriptions] == ["heavy", "light"]
    assert descriptions[0].guid != descriptions[1].guid
    with Fmu(paths[0]) as heavy, Fmu(paths[1]) as light:
        assert [v.name for v in light.outputs] == ["rod.angular_velocity"]
        for unit in (heavy, light):
            unit.initialize()
        for begin, end in pairwise(communication_points("both", 1.0, 0.05)):
            heavy.step(end - begin, begin)
            light.step(end - begin, begin)
        assert heavy.read()[0] == pendulum(here)["rod.angle"][-1]
        m = alfmu.load(here / "mechanisms" / "pendulum.py")
        library = alfmu.simulate(m, 1.0, 0.05, parameters={"mass": 0.1}, outputs=["rod.angular_velocity"])
        assert light.read() == library["rod.angular_velocity"][-1]


def test_options_take_precedence_over_the_recipe(here, capsys):
    arguments = ["export", "../heavy.py", "--set", "l=1.5", "--outputs", "rod.x", "--option", "rods=2", "--freeze", ""]
    arguments += ["--stop-time", "4", "--step", "0.1", "--no-reference", "--no-sources", "--kind", "native"]
    arguments += ["--fmi", "3", "-o", "x.fmu"]
    assert main(arguments) == 0
    assert capsys.readouterr().out.startswith("wrote x.fmu (")
    description = fmpy.read_model_description("x.fmu")
    found = {v.name: v for v in description.modelVariables}
    assert (description.fmiVersion, description.modelName) == ("3.0", "heavy")
    assert [v.name for v in found.values() if v.causality == "output"] == ["rod.x"]
    assert [float(found[name].start) for name in ("l", "start.th", "mass")] == [1.5, 0.2, 1.0]
    experiment = description.defaultExperiment
    assert [float(getattr(experiment, x)) for x in ("stopTime", "stepSize", "tolerance")] == [4.0, 0.1, 1e-7]
    with zipfile.ZipFile("x.fmu") as archive:
        assert json.loads(archive.read("resources/options.json"))["options"] == {"rods": 2}
        assert not [name for name in archive.namelist() if name.startswith(("extra", "sources"))]


@pytest.mark.slow
def test_export_says_what_it_wrote_and_where_it_runs(tmp_path, capsys):
    """On the platforms whose library of the runtime is inside, with the glibc that it needs; pythonfmu's own are always
    for two."""
    path = str(tmp_path / "p.fmu")
    chosen = {HERE, "win64"} if zig() else {HERE}  # others take ziglang
    for form, what, there in (
        (["--kind", "python"], "python: hosts with Python", {HERE}),
        ([], "native: every host", {HERE}),
        (["--fmi", "3", "--platform", ",".join(chosen)], "native: every host", chosen),
    ):
        assert main(["export", "particle_on_circle", "-o", path, "--no-reference", *form]) == 0
        said, *more = capsys.readouterr().out.splitlines()
        said, _, names = said.rpartition(" on ")
        assert re.fullmatch(rf"wrote {re.escape(path)} \(\d+ kB\), kind {re.escape(what)}", said)
        with zipfile.ZipFile(path) as archive:
            inside = {name for name in PLATFORMS if f"resources/{file_name(name)}" in archive.namelist()} or there
        on = {re.sub(r" \(glibc 2\.\d+\)", "", name) for name in names.split(", ")}
        assert there <= on == inside | there
        assert "linux64 (glibc 2." in names or "linux64" not in on
        (limits,) = more or [""]
        if form[:1] == ["--kind"]:
            assert "only in folders with plain letters" in limits
        elif missing := [name for name in PLATFORMS if name not in on]:
            assert limits == f"  for {', '.join(missing)}, too: pip install ziglang, then --platform all"
        else:
            assert not limits


def test_what_holds_for_one_kind_goes_with_it():
    native = Recipe("five_bar", kind="native", fmi=3, platforms=["linux64"], lock=["B"], parameters={"m2": 2.0})
    other = native.changed(kind="python", parameters={"m4": 3.0}, kernel="compiled")
    assert (other.fmi, other.platforms, other.kernel) == (2, (), "compiled")
    assert other.changed(kind="native").kernel is None
    assert (dict(other.parameters), other.lock) == ({"m2": 2.0, "m4": 3.0}, ("B",))
    assert native.changed(kind="native", lock=None) == native
    assert native.changed(lock=[]).lock == ()


@pytest.mark.slow
def test_pythonfmu_builds_an_fmu_from_a_recipe(here):
    """By its own command; where the FMU runs, nothing is derived, and the mechanism's file may be gone."""
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "../heavy.py", "--handle-state", "--serialize-state"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert validate_fmu("heavy.fmu") == []
    is_the_heavy_pendulum(Path("heavy.fmu"), here)
    (here / "mechanisms" / "pendulum.py").unlink()
    (here / "heavy.py").unlink()
    assert validate("heavy.fmu") == []
    code = "import fmpy, sys; fmpy.simulate_fmu('heavy.fmu'); print({'alfmu.fmi.export', 'casadi'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "set()\n", done.stderr
    description = fmpy.read_model_description("heavy.fmu")
    assert description.guid.startswith("{")
    assert {v.unit for v in description.modelVariables if v.name.startswith("A.")} == {"N.m", "N"}


@pytest.mark.slow
def test_the_classes_of_several_recipes_run_in_one_process(here):
    """Of two FMUs that pythonfmu built, each keeps its own scene."""
    (here / "lighter.py").write_text(
        LIGHT + "\nfrom alfmu.fmi.entry import Entry\nclass Light(Entry, recipe=recipe): ...\n"
    )
    code = "import sys; from pythonfmu.builder import FmuBuilder as b; [b.build_FMU(x, '.') for x in sys.argv[1:]]"
    files = [str(here / name) for name in ("heavy.py", "lighter.py")]
    subprocess.run([sys.executable, "-c", code, *files], check=True, timeout=300)
    with Fmu("heavy.fmu") as heavy, Fmu("lighter.fmu") as light, Fmu("heavy.fmu") as again:
        assert [v.name for v in light.outputs] == ["rod.angular_velocity"]
        for unit in (heavy, light, again):
            run(unit, 0.5, 0.05)
        assert np.array_equal(heavy.read(), again.read())
        assert heavy.read()[0] == pendulum(here)["rod.angle"][10]


def test_a_recipe_may_stand_beside_its_mechanism_or_hold_it(here):
    (here / "alone.py").write_text(
        PENDULUM + '\nfrom alfmu import Recipe\nr = Recipe(pendulum(2), outputs=["rod.x"])\n'
    )
    with Fmu(alfmu.export(here / "alone.py", "alone.fmu")) as fmu:
        assert (fmu.name, [v.name for v in fmu.outputs]) == ("alone", ["rod.x"])
    m = alfmu.load(here / "mechanisms" / "pendulum.py")
    declared = Recipe(m, name="other", stop_time=2.0).declared()
    assert (declared.name, declared.experiment.stop_time) == ("other", 2.0)
    assert (m.name, m.experiment.stop_time) == ("pendulum", 10.0)
    with pytest.raises(alfmu.InputError, match="other: the mechanism is declared already; give it locks"):
        Recipe(m, name="other", lock=["A"]).declared()


@pytest.mark.slow
def test_a_result_is_drawn_by_the_mechanism_of_the_recipe(here):
    recipe = Recipe("particle_on_circle", name="small", outputs=["particle.*"])
    alfmu.export(recipe, "small.fmu", reference=False)
    assert main(["simulate", "small.fmu", "--stop-time", "0.2"]) == 0
    assert json.loads(Path("small.json").read_text())["mechanism"] == "particle_on_circle"
    assert main(["animate", "small.csv", "-o", "film.html", "--fps", "5"]) == 0


MISTAKES = [
    ("Recipe()", "missing 1 required positional argument: 'mechanism'"),
    ("Recipe('pendulum.py', output=['rod.x'])", "unexpected keyword argument 'output'"),
    ("Recipe(7)", "mechanism is 7; it must be a name, a path or a Mechanism"),
    ("Recipe('five_bar', name='five bar')", "name is 'five bar'; it must be letters, digits and underscores"),
    ("Recipe('five_bar', options=['coordinates'])", "options is ['coordinates']; it must be a dictionary"),
    ("Recipe('five_bar', parameters={'m2': None})", "it must be a dictionary from names to numbers or texts"),
    ("Recipe('five_bar', outputs=3)", "outputs is 3; it must be a list of names, or None"),
    ("Recipe('five_bar', freeze=[1])", "freeze is (1,); it must be a list of names, or None"),
    ("Recipe('five_bar', lock=None)", "lock is None; it must be a list of names"),
    ("Recipe('five_bar', reference=1)", "reference is 1; it must be True or False"),
    ("Recipe('five_bar', stop_time=-1)", "stop_time is -1; it must be a finite number of seconds above zero"),
    (
        "Recipe('five_bar', communication_step=float('nan'))",
        "communication_step is nan; it must be a finite number of seconds above zero",
    ),
    ("Recipe('five_bar', kernel='fast')", "kernel is 'fast'; it must be vm or compiled or auto or oracle or None"),
    ("Recipe('five_bar', kind='c')", "there is no kind 'c' of FMU; use one of native, python"),
    (
        "Recipe('five_bar', kind='python', fmi=3)",
        "there is no python FMU of FMI 3; use FMI 2, or a native one of FMI 3",
    ),
    ("Recipe('five_bar', kernel='oracle')", "an FMU cannot contain the oracle"),
    ("Recipe('five_bar', kernel='vm')", "a native FMU has a kernel of its own"),
    (
        "Recipe('five_bar', kind='python', platforms=['win64'])",
        "an FMU that runs in Python is not built for a platform",
    ),
    ("Recipe('six_bar')", "there is no mechanism 'six_bar'; did you mean five_bar? Use one of"),
    ("Recipe('missing.py')", "there is no file"),
    ("Recipe('five_bar', options={'links': 3})", "five_bar has no option 'links'; it has coordinates"),
    ("Recipe('five_bar', parameters={'m9': 1})", "wrong has no input or parameter 'm9'"),
    ("Recipe('five_bar', outputs=['link9.x'])", "wrong has no output 'link9.x'"),
    ("Recipe('five_bar', lock=['Z'])", "has no joint Z; it has A, B"),
    ("Recipe('five_bar'); other = Recipe('four_bar')", "declares 2 recipes; a file declares one"),
]


@pytest.mark.parametrize(("code", "words"), MISTAKES, ids=[code for code, _ in MISTAKES])
def test_a_mistake_in_a_recipe_is_one_clear_line(code, words, tmp_path, capsys):
    (tmp_path / "wrong.py").write_text(f"from alfmu import Recipe\nrecipe = {code}\n")
    assert main(["export", str(tmp_path / "wrong.py"), "-o", str(tmp_path)]) == 1
    err = capsys.readouterr().err
    assert words in err
    assert err.startswith("alfmu: ")
    assert err.count("\n") == 1
    assert not list(tmp_path.glob("*.fmu"))


def test_one_name_stands_for_a_list_of_one():
    assert Recipe("five_bar", outputs="link1.x", freeze="all").changed(lock="B") == Recipe(
        "five_bar", outputs=["link1.x"], freeze=["all"], lock=["B"]
    )


def test_the_recipes_of_the_repository():
    """Every file in fmus is registered, and every mechanism has a plain recipe of its name, for pythonfmu too."""
    files = sorted(path for path in (ROOT / "fmus").glob("*.py") if path.stem != "__init__")
    entries = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["alfmu.fmus"]
    assert entries == {path.stem: f"alfmu.catalogue.fmus.{path.stem}" for path in files}
    found = {path.stem: load(path) for path in files}
    assert set(alfmu.mechanisms()) <= set(found)
    for path in files:
        recipe = found[path.stem]
        assert recipe.name == path.stem
        assert (recipe == Recipe(path.stem, name=path.stem)) == (path.stem in alfmu.mechanisms())
        [entry] = [
            x for x in executed(path).values() if isinstance(x, type) and issubclass(x, Entry) and x is not Entry
        ]
        assert entry.recipe == recipe
    assert load("five_bar") == found["five_bar"]


def test_list_and_help_tell_of_recipes(distribution, capsys):
    recipe = "import alfmu\nr = alfmu.Recipe('five_bar', name='quick', freeze='all')\n"
    distribution("their_fmus", recipe, "[alfmu.fmus]\nquick = their_fmus\n")
    assert main(["list"]) == 0
    assert re.search("^quick +FMU of five_bar: freeze all$", capsys.readouterr().out, re.M)
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    assert "take precedence over it" in " ".join(capsys.readouterr().out.split())
