"""Types of the public names, as a checker tells a user: of a file of theirs, and of the modules they come from."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

GOOD = """
import alfmu
from alfmu import Experiment, Mechanism, Recipe, Result

def pendulum(l: float = 1.0) -> Mechanism:
    m = Mechanism("pendulum", experiment=Experiment(5.0, communication_step=0.01))
    mass = m.parameter("m", 1.0, "kg", minimum=0.0)
    angle = m.coordinate("angle", "rad", start=0.5, independent=True)
    rod = m.bar("rod", mass=mass, length=l)
    hinge = m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=angle)
    m.drive(hinge, m.input("torque", "N.m"))
    m.force(rod.end, y=1.0)
    m.gravity(0, -9.81)
    return m

r = alfmu.simulate(pendulum(), 2.0, communication_step=0.01, inputs={"torque": lambda t: 2.0 * t, "x": ([0.0], [1.0])},
                   parameters={"m": 2.0, "solver.method": "explicit"}, outputs=["rod.*"])
reveal_type(r)
reveal_type(r["rod.angle"])
reveal_type(r.select("rod.*"))
reveal_type([name for name in r])
reveal_type(pendulum().bodies[0].name)
reveal_type(alfmu.Instance("five_bar").get("link1.angle"))
reveal_type(alfmu.export(Recipe(pendulum(), freeze=["m"]), "out.fmu", kind="native"))
again: Result = Result.from_csv("run.csv")
again.to_csv("copy.csv")
"""

BAD = {
    'alfmu.simulate("four_bar", 1.0, step=0.1)': 'Unexpected keyword argument "step"',
    'alfmu.simulate("four_bar", "soon")': "incompatible type",
    "alfmu.simulat": "has no attribute",
    "alfmu.Settings": "has no attribute",
    "pendulum().bodies.append(1)": "has no attribute",
    "pendulum().bodies = ()": "assign",
    'r["rod.angle"].nothing': "has no attribute",
    'pendulum().bar("x", mas=1.0)': "mas",
}


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """What mypy says of a user's file; of the modules that public names come from, and of the gallery."""
    folder = tmp_path_factory.mktemp("typed")
    bad = "\n".join(BAD)
    (folder / "users.py").write_text(f"# mypy: disallow-untyped-defs, disallow-untyped-calls\n{GOOD}\n{bad}\n")
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]
    command = [sys.executable, "-m", "mypy", "--config-file", "pyproject.toml", "--cache-dir", str(folder / "cache")]
    gallery = map(str, sorted((ROOT / "docs" / "gallery").glob("plot_*.py")))
    command += ["--no-error-summary", *settings["files"], *gallery, str(folder / "users.py")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500)
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    return tuple("\n".join(x for x in lines if ("users.py" in x) == theirs) for theirs in (True, False))


def test_the_public_surface_and_the_gallery_have_no_errors(said):
    assert said[1] == ""


def test_a_user_is_told_types_and_mistakes(said):
    lines = said[0].splitlines()
    revealed = [line.partition("Revealed type is ")[2] for line in lines if "Revealed type" in line]
    wanted = ("alfmu.result.Result", "float64", "alfmu.result.Result", "list[", "str", "float", "pathlib.Path")
    assert len(revealed) == len(wanted)
    for text, each in zip(revealed, wanted, strict=True):
        assert each in text
    errors = [line for line in lines if ": error: " in line]
    first = GOOD.count("\n") + 3
    for k, (code, words) in enumerate(BAD.items()):
        assert any(f"users.py:{first + k}: error: " in line and words in line for line in errors), (code, errors)
    assert all(int(line.split(":")[1]) >= first for line in errors), errors


def test_the_package_says_that_it_is_typed():
    import alfmu

    assert (Path(alfmu.__file__).parent / "py.typed").is_file()
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "py.typed" in settings["tool"]["setuptools"]["package-data"]["alfmu"]
