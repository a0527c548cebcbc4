"""What holds of each example of the gallery, by the names that it leaves; whatever runs an example asks for it."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import alfmu
from alfmu.model.content import content

Names = dict[str, Any]


def near(found: float, expected: float, rel: float = 0.0, abs: float = 0.0) -> bool:
    return bool(np.abs(found - expected) <= max(rel * np.abs(expected), abs))


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
    assert near(n["held"], n["statics"], rel=1e-5)
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
    assert near(n["usual"], n["expected"], rel=0.03)


def stewart_platform(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert 0 < n["off"] < 0.005
    assert np.ptp(n["places"][:, 2]) > 0.1


def toggle_press(n: Names) -> None:
    assert n["deviation"] < 1e-9
    assert n["result"]["press"].max() > 2e5


def crank_press(n: Names) -> None:
    assert n["strokes"] == 4
    assert near(n["result"]["pressed"][-1], 4 * n["stroke"], rel=1e-2)
    assert n["unaccounted"] < 1e-6 * n["result"]["supplied"][-1]


def quick_return(n: Names) -> None:
    assert near(n["ratio"], n["expected"], rel=1e-3)


def valve_train(n: Names) -> None:
    assert near(n["seen"], n["greatest"], rel=2e-3)
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
    assert near(n["brace"], n["expected"], rel=5e-3)
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
    assert near(n["found"], n["expected"], rel=0.05)
    assert n["largest"] < 0.35
    assert len(n["crossings"]) >= 5


def governor(n: Names) -> None:
    assert n["deviation"] < 1e-4
    assert near(n["grown"], 30.0, rel=1e-5)
    assert np.ptp(n["result"]["slider.z"]) > 0.05


def bar_clamp(n: Names) -> None:
    assert near(n["kept"], n["expected"], rel=2e-3)
    assert n["slide"] < 1 < n["hold"]
    assert n["left"] < 0.01 * n["kept"]
    assert n["creep"] < 1e-15


def delta(n: Names) -> None:
    assert n["deviation"] < 1e-11
    assert near(n["work"], n["gained"], abs=1e-6)
    assert n["moved"] > 1
    assert min(each.parallel for each in n["near"]) > 0.1


def path_robot(n: Names) -> None:
    assert n["off"].max() < 1e-3 * np.ptp(n["path"][:, 0])
    assert near(n["lag"], n["expected"], rel=0.05)
    assert np.ptp(n["alone"]["tool.y"]) > 1.1 * np.ptp(n["path"][:, 1])


def gripper(n: Names) -> None:
    assert near(n["force"], n["expected"], rel=1e-6)
    assert n["turned"] < 1e-12
    assert abs(n["centred"]) < 1e-9
    at = np.interp(
        n["result"]["right_nail.x"][-1], n["way"]["right_nail.x"][::-1], n["way"]["right_nail.x/right_axle"][::-1]
    )
    assert near(n["TORQUE"] / 2 / abs(at), n["force"], rel=1e-4)


def biped_leg(n: Names) -> None:
    assert n["deviation"] < 1e-11
    assert near(n["work"] + n["lifted"], n["gained"], abs=1e-4)
    assert n["work"] > 40
    assert np.abs(n["result"]["left_motor.torque"] - n["result"]["right_motor.torque"]).max() > 1


CHECKS: dict[str, Callable[[Names], None]] = {
    name: each for name, each in globals().items() if getattr(each, "__annotations__", {}).get("n") is Names
}
"""What holds of each file of the gallery, by the numbers that it leaves."""


REGISTERED = {"five_bar", "four_bar", "slider_crank", "bennett", "governor"}
"""Files that use a mechanism by its name."""


def registered(function: Callable[[], alfmu.Mechanism]) -> alfmu.Mechanism:
    """What a function declares, with all that `load` adds."""
    m, named = function(), alfmu.load(Path(function.__code__.co_filename).stem.removeprefix("plot_"))
    m.options, m.documentation = named.options, named.documentation
    return m


def hold(name: str, names: Names, figures: int, said: str, files: Sequence[str]) -> None:
    """Raise AssertionError unless an example draws a figure, says something, leaves its film alone, and is right."""
    CHECKS[name](names)
    if name not in REGISTERED:  # By its name, it is the same mechanism, without the run.
        (function,) = [f for f in names.values() if getattr(f, "__annotations__", {}).get("return") is alfmu.Mechanism]
        assert content(alfmu.load(name)) == content(registered(function))
    assert figures, "the file draws no figure"
    assert said.strip(), "the file says nothing of its check"
    assert list(files) == [f"{name}.gif"]
    result = names["result"]
    assert isinstance(result, alfmu.Result)
    assert np.abs(result["monitor.position_error"]).max() < 1e-9
