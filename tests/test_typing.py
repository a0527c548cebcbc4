"""Types of the public names, as mypy and pyright tell a user: of a file of theirs, of the gallery."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import typing
from pathlib import Path
from typing import Any

import pytest

import alfmu
from alfmu.equations.interface import CHOICES, Choice

ROOT = Path(__file__).parents[1]

GALLERY = sorted((ROOT / "docs" / "gallery").glob("plot_*.py"))

GOOD = """
import warnings
from pathlib import Path

import alfmu
from alfmu import AlfmuError, AlfmuWarning, AssemblyError, DeclarationError, ExportError, InputError, StepError
from alfmu import Body, Equations, Experiment, Instance, Joint, Marker, Mechanism, Recipe, Result, derive, export, load
from alfmu import Imported, Sweep, imported, sweep
from alfmu import Equilibrium, Linearization, WriteError, equilibrium, linearize, mechanisms, mobility, parts, simulate
from alfmu import Derivatives, Fit, Gradient, LibraryError, derivatives, fit, gradient
from alfmu import Batch, Environment, Kinematics, System, VectorEnvironment, convert, couple, kinematics, validate

warnings.simplefilter("error", AlfmuWarning)

def pendulum(l: float = 1.0) -> Mechanism:
    m = Mechanism("pendulum", experiment=Experiment(5.0, communication_step=0.01))
    mass = m.parameter("m", 1.0, "kg", minimum=0.0)
    angle = m.coordinate("angle", "rad", start=0.5, independent=True)
    rod: Body = m.bar("rod", mass=mass, length=l)
    tip: Marker = rod.end
    hinge: Joint = m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=angle)
    m.drive(hinge, m.input("torque", "N.m"))
    x = m.state("x", "V", start=0.0)
    m.derivative(x, -x)
    motor: parts.Motor = parts.dc_motor(m, "motor", hinge, voltage=x, resistance=1.0, inductance=0.1, constant=0.1)
    m.output("power", motor.torque * m.rate(angle), "W")
    m.force(tip, y=1.0)
    m.gravity(0, -9.81)
    m.output("height", mass * l, "m")
    return m

try:
    r = simulate(pendulum(), 2.0, communication_step=0.01, inputs={"torque": lambda t: 2.0 * t, "x": ([0.0], [1.0])},
                 parameters={"m": 2.0, "solver.method": "explicit"}, outputs=["rod.*"])
except (AssemblyError, DeclarationError, ExportError, InputError, StepError, WriteError) as error:
    raise SystemExit(f"{error}, {error.result['rod.angle'][-1] if error.result else 0.0}") from None
except AlfmuError as error:
    raise SystemExit(str(error)) from None
reveal_type(r)
reveal_type(r["rod.angle"])
reveal_type(r.time)
reveal_type(r.select("rod.*"))
reveal_type([name for name in r])
reveal_type(pendulum().bodies[0].name)
reveal_type(pendulum().draw().svg())
i = Instance(derive(load("five_bar")))
linkage: Imported = imported(Path("robot.xml"), drives="all")
text: str = linkage.source()
written: Path = convert(linkage.mechanism, "robot.urdf", parameters={"start.angle": 0.1})
i.initialize()
i.step(0.02)
reveal_type(i.get("link1.angle"))
reveal_type(i.get("solver.method"))
reveal_type(i.q)
reveal_type(i.outputs[0].unit)
reveal_type(alfmu.export(Recipe(pendulum(), freeze=["m"]), "out.fmu", kind="native"))
equations: Equations = derive(pendulum())
reveal_type(equations.n + len(mechanisms()))
again: Result = Result.from_csv("run.csv")
again.to_csv("copy.csv")
made: Path = export("five_bar", "five_bar.fmu")
problems: list[str] = validate(made, checks=["step.*"])
rest: Equilibrium = equilibrium(pendulum(), parameters={"m": 2.0}).nearest
reveal_type(rest.stable)
linear: Linearization = linearize(pendulum(), rest)
reveal_type(linear.A)
reveal_type(linearize(pendulum(), [0.0, 1.0]))
reveal_type(mobility(pendulum(), stop_time=0.0).groups[0].rows)
moved: Kinematics = kinematics(pendulum(), ["A"])
reveal_type(moved.efforts(moved.forward({"A": 0.1}))["A"])
many: Sweep = sweep(pendulum(), {"m": "uniform(0.9,1.1)", "start.angle": [0.1, 0.2]}, 10, keep=["max(rod.angle)"])
reveal_type(many["max(rod.angle)"])
reveal_type(many.summary.spreads[0].sensitivities["m"])
simulate(pendulum(), start=rest)
system = System("pair", {"a": pendulum(), "b": Recipe("five_bar")}, [("b.link1.angle", "a.torque")], {"a.x": 1.0})
reveal_type(system.simulate(master="iterated"))
reveal_type(couple(system, halvings=2).order("held"))
changes: Derivatives = derivatives(pendulum(), ["m"], 1.0)
reveal_type(changes["rod.angle", "m"])
slope: Gradient = gradient(pendulum(), "rod.angle", ["m"], 1.0)
reveal_type(slope["m"])
fitted: Fit = fit(pendulum(), r, ["m"], bounds={"m": (0.1, 2.0)})
reveal_type(fitted.plot())
"""

REVEALED = (
    *("Result", "float64", "float64", "Result", "list[", "str", "str"),
    *("float", "str", "float64", "str", "Path", "int", "bool", "float64", "Linearization", "str"),
    *("float", "ndarray", "float"),
    *("Result", "float"),
    *("float64", "float", "Figure"),
)
"""What stands in the types that checkers reveal, in their order."""

BAD = {
    'alfmu.simulate("four_bar", 1.0, step=0.1)': ('Unexpected keyword argument "step"', 'No parameter named "step"'),
    'alfmu.simulate("four_bar", "soon")': ("incompatible type", "cannot be assigned"),
    "alfmu.simulat": ("has no attribute", "is not a known attribute"),
    "alfmu.Settings": ("has no attribute", "is not a known attribute"),
    "pendulum().bodies.append(1)": ("has no attribute", 'Cannot access attribute "append"'),
    "pendulum().bodies = ()": ("assign", "bodies"),
    'r["rod.angle"].nothing': ("has no attribute", 'Cannot access attribute "nothing"'),
    'pendulum().bar("x", mas=1.0)': ("mas", 'No parameter named "mas"'),
    'i.get("link1.angle").upper()': ("has no attribute", 'Cannot access attribute "upper"'),
}
"""Mistakes, and what mypy and pyright say of each."""

FIRST = GOOD.count("\n") + 3
"""Line of the first mistake."""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What mypy says of a user's file; of the package itself and of the gallery, `.ci/run` asks it."""
    folder = tmp_path_factory.mktemp("typed")
    users(folder, "# mypy: disallow-untyped-defs, disallow-untyped-calls")
    command = [sys.executable, "-m", "mypy", "--no-error-summary", str(folder / "users.py")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500)
    assert done.stderr == ""
    return done.stdout.splitlines()


def users(folder: Path, head: str) -> None:
    """Writes the file of a user, its mistakes last."""
    (folder / "users.py").write_text("\n".join([head, GOOD, *BAD, ""]))


def pyright(folder: Path, *arguments: str) -> dict[str, Any]:
    """What pyright says in a folder; the test is skipped where there is none that runs."""
    beside = str(Path(sys.executable).parent)
    names = ("basedpyright", "pyright")
    found = [path for name in names for where in (beside, None) if (path := shutil.which(name, path=where))]
    if not found:
        pytest.skip("there is no pyright here; pip install -e '.[pyright]' brings one")
    command = [found[0], "--outputjson", "--pythonpath", sys.executable, *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=500)
    assert done.stdout.lstrip().startswith("{"), f"{done.stdout}{done.stderr}"
    return json.loads(done.stdout)


def test_a_users_file_has_every_public_name():
    words = set(GOOD.replace("(", " ").replace(",", " ").replace("[", " ").replace(":", " ").split())
    assert set(dir(alfmu)) <= words


def test_every_module_is_checked():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]
    assert settings["files"] == ["alfmu"]
    assert not any(each.get("ignore_errors") for each in settings["overrides"])


@pytest.mark.slow
def test_a_user_is_told_types_and_mistakes(said):
    assert all("users.py" in line for line in said)
    revealed = [line.partition("Revealed type is ")[2] for line in said if "Revealed type" in line]
    assert len(revealed) == len(REVEALED)
    for text, each in zip(revealed, REVEALED, strict=True):
        assert each in text
    errors = [line for line in said if ": error: " in line]
    for k, (code, (words, _)) in enumerate(BAD.items()):
        assert any(f"users.py:{FIRST + k}: error: " in line and words in line for line in errors), (code, errors)
    assert all(int(line.split(":")[1]) >= FIRST for line in errors), errors


@pytest.mark.slow
def test_pyright_tells_the_same_and_finds_nothing_in_the_gallery(tmp_path):
    """The gallery as an editor judges it, the user's file in the strict mode, where no type may be unknown."""
    for path in GALLERY:
        shutil.copy(path, tmp_path)
    users(tmp_path, "# pyright: strict, reportUnusedExpression=false, reportUnusedImport=false")
    settings = {"typeCheckingMode": "standard", "extraPaths": [str(ROOT)]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    found = pyright(tmp_path)
    assert found["summary"]["filesAnalyzed"] == len(GALLERY) + 1
    notes = [
        (d["severity"], Path(d["file"]).name, d["range"]["start"]["line"] + 1, d["message"])
        for d in found["generalDiagnostics"]
    ]
    revealed = [message.partition(" is ")[2] for severity, *_, message in notes if severity == "information"]
    assert len(revealed) == len(REVEALED), revealed
    for text, each in zip(revealed, REVEALED, strict=True):
        assert each in text
    wrong = [note for note in notes if note[0] != "information"]
    for k, (code, (_, words)) in enumerate(BAD.items()):
        assert any(note[1:3] == ("users.py", FIRST + k) and words in note[3] for note in wrong), (code, wrong)
    assert [note for note in wrong if note[1] != "users.py" or note[2] < FIRST] == []


@pytest.mark.slow
def test_pyright_knows_every_type_of_the_modules_that_public_names_come_from(tmp_path, monkeypatch):
    # An editable installation is nothing that pyright finds, nor packages that classes here are derived from.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), sysconfig.get_path("purelib")]))
    found = pyright(tmp_path, "--verifytypes", "alfmu", "--ignoreexternal")["typeCompleteness"]
    modules = {getattr(alfmu, name).__module__ for name in dir(alfmu)} | {"alfmu.view.picture"}  # its Drawing
    public = [s for s in found["symbols"] if s["isExported"] and s["name"].startswith(tuple(f"{m}." for m in modules))]
    assert {getattr(alfmu, name).__module__ + "." + name for name in dir(alfmu)} <= {s["name"] for s in public}
    unknown = [(s["name"], d["message"]) for s in public for d in s["diagnostics"] if not s["isTypeKnown"]]
    assert unknown == []


def test_choices_have_their_names_in_types():
    assert typing.get_args(Choice) == tuple(CHOICES)


def test_the_package_says_that_it_is_typed():
    assert (Path(alfmu.__file__).parent / "py.typed").is_file()
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "py.typed" in settings["tool"]["setuptools"]["package-data"]["alfmu"]
