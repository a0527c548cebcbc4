"""The gallery: every file runs, shows what it promises, and its own check holds."""

import ast
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import alfmu
from alfmu.cli import main
from alfmu.model.content import content
from alfmu.view import picture

matplotlib = pytest.importorskip("matplotlib")

GALLERY = Path(__file__).parents[1] / "docs" / "gallery"

Names = dict[str, Any]


def windscreen_wiper(n: Names) -> None:
    assert abs(n["simulated"] - n["swept"]) < 1e-4
    assert n["apart"] < 1e-9


def coupler_curve(n: Names) -> None:
    assert n["first_apart"] > 0.1
    assert n["lengths_apart"] < 1e-10
    assert n["path_apart"] < 1e-10


def jansen_leg(n: Names) -> None:
    assert n["deviation"] < 1e-9
    # The path is the same in the second turn as in the first.
    angle, x = n["result"]["crank.angle"], n["result"]["foot.x"]
    again = np.interp(angle[angle < angle[-1] - 2 * np.pi] + 2 * np.pi, angle, x)
    assert len(again) > 100
    assert np.abs(again - x[: len(again)]).max() < 1e-3 * np.ptp(x)


def peaucellier(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert np.ptp(n["result"]["D.y"]) > 0.3
    assert np.ptp(n["energy"]) < 1e-6 * n["energy"].max()


def scissor_lift(n: Names) -> None:
    assert n["height_error"] < 1e-9
    assert n["held"] == pytest.approx(n["statics"], rel=1e-5)
    assert n["height"][-1] - n["height"][0] > 2.5


def excavator(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["lost"] < 1e-5 * np.ptp(n["energy"])


def planar_robot(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["tracking"] < 1e-4


def spatial_slider_crank(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["turns"] > 3
    assert n["lost"] < 1e-5


def swing_up(n: Names) -> None:
    assert n["share"] > 0.9
    assert np.sin(n["angles"][0]).max() < -0.98
    np.testing.assert_allclose(n["result"]["crank.angle"][1:21], n["angles"][:20, 0], rtol=1e-9)


def bricard(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["alike"] < 1e-9
    assert n["lost"] < 1e-5
    assert np.ptp(n["a"]) > 1.0


def gyroscope(n: Names) -> None:
    assert n["lost"] < 1e-6
    assert n["usual"] == pytest.approx(n["expected"], rel=0.03)


def stewart_platform(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert 0 < n["off"] < 0.005
    assert np.ptp(n["places"][:, 2]) > 0.1


def toggle_press(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["result"]["press"].max() > 2e5


def crank_press(n: Names) -> None:
    assert n["strokes"] == 4
    assert n["result"]["pressed"][-1] == pytest.approx(4 * n["stroke"], rel=1e-2)
    assert n["unaccounted"] < 1e-6 * n["result"]["supplied"][-1]


def quick_return(n: Names) -> None:
    assert n["ratio"] == pytest.approx(n["expected"], rel=1e-3)


def valve_train(n: Names) -> None:
    assert n["seen"] == pytest.approx(n["greatest"], rel=2e-3)
    assert n["force"].min() > 0
    assert n["balance"] < 1e-6


def planetary_gear(n: Names) -> None:
    assert n["willis"] < 1e-10
    assert n["balance"] < 1e-5
    assert n["uneven"] < 1e-9
    assert n["arm"].max() > 6
    assert n["arm"][-1] < -6


def four_cylinders(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["change"] < 1e-4


def pantograph(n: Names) -> None:
    assert n["deviation"] < 1e-12


def landing_gear(n: Names) -> None:
    assert n["brace"] == pytest.approx(n["expected"], rel=5e-3)
    assert abs(n["up"]) < 0.1


def five_bar(n: Names) -> None:
    assert n["deviation"] < 1e-5


def four_bar(n: Names) -> None:
    assert n["deviation"] < 1e-5


def slider_crank(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["crossings"] >= 4
    assert n["lost"] < 1e-5


def bennett(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["opposite"] < 1e-9


def kapitza(n: Names) -> None:
    assert n["found"] == pytest.approx(n["expected"], rel=0.05)
    assert n["largest"] < 0.35
    assert len(n["crossings"]) >= 5


def governor(n: Names) -> None:
    assert n["deviation"] < 1e-4
    assert n["grown"] == pytest.approx(30.0, rel=1e-5)
    assert np.ptp(n["result"]["slider.z"]) > 0.05


def bar_clamp(n: Names) -> None:
    assert n["kept"] == pytest.approx(n["expected"], rel=2e-3)
    assert n["slide"] < 1 < n["hold"]
    assert n["left"] < 0.01 * n["kept"]
    assert n["creep"] < 1e-15


def delta(n: Names) -> None:
    assert n["deviation"] < 1e-11
    assert n["work"] == pytest.approx(n["gained"], abs=1e-6)
    assert n["moved"] > 1
    assert min(each.parallel for each in n["near"]) > 0.1


def path_robot(n: Names) -> None:
    assert n["off"].max() < 1e-3 * np.ptp(n["path"][:, 0])
    assert n["lag"] == pytest.approx(n["expected"], rel=0.05)
    assert np.ptp(n["alone"]["tool.y"]) > 1.1 * np.ptp(n["path"][:, 1])


def gripper(n: Names) -> None:
    assert n["force"] == pytest.approx(n["expected"], rel=1e-6)
    assert n["turned"] < 1e-12
    assert abs(n["centred"]) < 1e-9
    at = np.interp(
        n["result"]["right_nail.x"][-1], n["way"]["right_nail.x"][::-1], n["way"]["right_nail.x/right_axle"][::-1]
    )
    assert n["TORQUE"] / 2 / abs(at) == pytest.approx(n["force"], rel=1e-4)


def biped_leg(n: Names) -> None:
    assert n["deviation"] < 1e-11
    assert n["work"] + n["lifted"] == pytest.approx(n["gained"], abs=1e-4)
    assert n["work"] > 40
    assert np.abs(n["result"]["left_motor.torque"] - n["result"]["right_motor.torque"]).max() > 1


CHECKS: dict[str, Callable[[Names], None]] = {
    name: each for name, each in globals().items() if getattr(each, "__annotations__", {}).get("n") is Names
}
"""What holds of each file of the gallery, by the numbers that it leaves."""


REGISTERED = {"five_bar", "four_bar", "slider_crank", "bennett", "governor"}
"""Files that use a mechanism by its name."""


def test_every_file_has_its_check():
    assert sorted(path.stem for path in GALLERY.glob("*.py")) == sorted(f"plot_{name}" for name in CHECKS)


@pytest.mark.parametrize("name", CHECKS)
def test_a_file_has_a_users_length_and_declares_one_mechanism(name: str):
    tree = ast.parse((GALLERY / f"plot_{name}.py").read_text())
    lines = {n.lineno for n in ast.walk(tree) if isinstance(n, ast.expr | ast.stmt)}
    assert 10 < len(lines) <= 80
    declares = [f for f in tree.body if isinstance(f, ast.FunctionDef) and ast.unparse(f.returns or f) == "Mechanism"]
    assert len(declares) == (0 if name in REGISTERED else 1)


def registered(function: Callable[[], alfmu.Mechanism]) -> alfmu.Mechanism:
    """What a function declares, with all that `load` adds."""
    m, named = function(), alfmu.load(Path(function.__code__.co_filename).stem.removeprefix("plot_"))
    m.options, m.documentation = named.options, named.documentation
    return m


@pytest.mark.slow
def test_the_mechanisms_of_the_gallery_are_names(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # which declarations do not take
    assert main(["list"]) == 0
    listed = capsys.readouterr().out.partition("from the gallery")[2]
    for name in CHECKS.keys() - REGISTERED:
        assert f"\n{name} " in listed
    assert main(["simulate", "windscreen_wiper", "--stop-time", "0.02", "--outputs", "arm1.angle"]) == 0
    assert main(["draw", "windscreen_wiper"]) == 0
    assert alfmu.load("bar_clamp", reach=0.1).options == {"reach": 0.1}
    assert alfmu.simulate("kapitza", 0.01).time[-1] == 0.01
    assert main(["info", "wiper"]) == 1
    assert "did you mean windscreen_wiper?" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKS)
def test_a_file_runs_and_its_check_holds(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    matplotlib.use("Agg")
    from matplotlib import pyplot

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(picture, "MAX_FRAMES", 4)
    try:
        names = runpy.run_path(str(GALLERY / f"plot_{name}.py"), run_name="__main__")
        assert pyplot.get_fignums(), "the file draws no figure"
    finally:
        pyplot.close("all")
    CHECKS[name](names)
    if name not in REGISTERED:  # By its name, it is the same mechanism, without the run.
        (function,) = [f for f in names.values() if getattr(f, "__annotations__", {}).get("return") is alfmu.Mechanism]
        declared = alfmu.load(name)
        assert content(declared) == content(registered(function))
    assert capsys.readouterr().out.count("\n") >= 1, "the file says nothing of its check"
    assert [path.name for path in tmp_path.iterdir()] == [f"{name}.gif"]
    result = names["result"]
    assert isinstance(result, alfmu.Result)
    assert np.abs(result["monitor.position_error"]).max() < 1e-9
