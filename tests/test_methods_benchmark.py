"""The script that sets methods against SciPy, at its smallest effort: files, ratios and verdicts hang together."""

import csv
from pathlib import Path

import numpy as np
import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def study():
    """The script as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        import methods_benchmark

        scene = methods_benchmark.SCENES["slider_crank"]
        methods = {"explicit": (1e-4, 1e-7), "order8": (0.05,)}
        times = np.linspace(0.0, 0.5, 3)
        small = methods_benchmark.Scene(scene.output, times, scene.exact, methods, scene.start)
        patch.setitem(methods_benchmark.SCENES, "slider_crank", small)
        patch.setattr(methods_benchmark, "AUTO_STOP", 0.2)
        patch.setattr(methods_benchmark, "AUTO_POINTS", 3)
        effort = methods_benchmark.Effort(1, 20.0, ("slider_crank",), ("particle_on_circle",))
        patch.setattr(methods_benchmark, "QUICK", effort)
        yield methods_benchmark


@pytest.fixture(scope="module")
def folder(study, tmp_path_factory):
    made = tmp_path_factory.mktemp("methods")
    assert study.main(["--quick", "-o", str(made)]) == 0
    return made


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_everything_that_was_promised_is_there(folder, study):
    names = {path.name for path in folder.iterdir()}
    assert names == {"methods.md", "methods.png", *(f"{name}.csv" for name in study.CHAPTERS)}
    work = rows(folder, "work")
    assert {row["code"] for row in work} == {"SciPy on (9)", *(f"alfmu {kernel}" for kernel in study.KERNELS)}
    assert {row["method"] for row in work} == {"explicit", "order8", "DOP853", "Radau", "BDF"}
    mine = [row for row in work if row["method"] == "explicit"]
    for row in mine:
        assert float(row["error"]) <= 10 * float(row["value"])
    text = (folder / "methods.md").read_text(encoding="utf-8")
    assert all(chapter.heading in text for chapter in study.CHAPTERS.values())


def test_ratios_are_of_runs_at_equal_error(folder, study):
    work, equal = rows(folder, "work"), rows(folder, "equal")
    assert len(equal) == sum(row["code"] == "SciPy on (9)" for row in work)
    [least] = [row for row in rows(folder, "least") if row["method"] == "Radau"]
    ratios = [
        float(row["SciPy on (9) / alfmu vm"])
        for row in equal
        if row["method"] == "Radau" and row["SciPy on (9) / alfmu vm"]
    ]
    assert float(least["SciPy on (9) / alfmu vm"]) == pytest.approx(min(ratios))
    mine = [{"error": 1e-3, "time [s]": 1.0}, {"error": 1e-7, "time [s]": 4.0}]
    assert study.time_at(1e-5, mine) == pytest.approx(2.0)
    assert study.time_at(1e-2, mine) == 1.0
    assert study.time_at(1e-9, mine) is None
    assert study.time_at(1e-5, []) is None


def test_targets_are_judged_by_this_run(folder, study):
    targets = rows(folder, "targets")
    assert len(targets) == len(study.TARGETS)
    verdicts = {row["row"]: row["verdict"] for row in targets}
    assert verdicts["flyball_governor, Radau"] == "not measured"
    found = {row["method"]: row for row in rows(folder, "least")}
    reached = float(found["DOP853"]["SciPy on (9) / alfmu compiled"]) >= 20
    assert verdicts["slider_crank, DOP853"] == ("met" if reached else "not met")
    *_, worst = rows(folder, "auto")
    assert verdicts["worst"] == ("met" if float(worst["auto / better one"]) <= 2 else "not met")
