"""The singular study at its smallest effort: exact motions, files, rows, statistics and verdicts hang together."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from studies import agree, number, rows, tables

import alfmu

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parents[1] / "scripts"
NUMBER = 6
TABLES = {"environment", "targets", "phases", "hardest", "orders", "steps", "loops", "slider_crank"}


@pytest.fixture(scope="module")
def study():
    """The script as a module, under a name that its child processes find too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        import singular_study

        patch.setattr(
            singular_study, "QUICK", replace(singular_study.QUICK, phases=NUMBER, cases=("4 N.m",), hardest=2, long=2.0)
        )
        patch.setattr(singular_study, "STEPS", (0.04, 0.02))
        patch.setattr(singular_study, "BLOCK", 4)
        yield singular_study


@pytest.fixture(scope="module")
def folder(study, tmp_path_factory):
    """Results of all studies."""
    made = tmp_path_factory.mktemp("singular")
    assert study.main(["--quick", "-o", str(made)]) == 0
    return made


def column(among: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in among])


# The references ---------------------------------------------------------------------------------------------------


def test_the_exact_motions_are_those_of_unrelated_references(study):
    """Others' equations of motion, at some states."""
    for th, w in ((0.3, 2.0), (-2.5, -1.0), (1.5, 4.0)):
        for own, other in (
            (study.parallelogram(), Parallelogram(m4=None)),
            (study.parallelogram(m2=0.0), Parallelogram(m2=0.0, m4=None)),
            (study.parallelogram(m4=1.0), Parallelogram()),
        ):
            assert own(th, w, 4.0) == pytest.approx(float(other.acceleration(th, 4.0)), rel=1e-13)
        for sizes, aligned in (((0.5, 0.5), True), ((0.3, 0.5), False)):
            crank = SliderCrank(*sizes, aligned=aligned)
            assert study.slider_crank(*sizes)(th, w, 0.0) == pytest.approx(crank.acceleration(th, w), rel=1e-12)
    assert study.row(1)(0.3, 2.0, 4.0) == pytest.approx(study.parallelogram()(0.3, 2.0, 4.0), rel=1e-14)


def test_the_exact_motion_is_tighter_than_what_it_judges(study):
    """Many motions at once, and a torque that is held, are as good as one by one."""
    start, torque = ([0.3, -2.0], [2.0, 0.5]), np.array([4.0, -3.0])
    both = study.reference(study.parallelogram(), start, torque, 0.02, 100)
    assert both.change <= 1e-11
    assert both.rk4_error > 1e-8
    for k, (th, w) in enumerate(zip(*start, strict=True)):
        alone = Parallelogram(m4=None).driven(th, w, 0.02 * np.arange(101), torque[k])[:, 0]
        assert np.abs(both.exact[:, k] - alone).max() <= 1e-11
    held = study.reference(study.parallelogram(), (0.3, 2.0), lambda t: 4.0, 0.02, 100)
    assert np.abs(held.exact[:, 0] - both.exact[:, 0]).max() <= 1e-11
    assert np.array_equal(held.by_rk4[:, 0], both.by_rk4[:, 0])


@pytest.mark.parametrize("coordinates", ["mixed", "joint"])
def test_tilt_is_seen_in_all_coordinates(study, coordinates):
    """Links 2 and 3 of a parallelogram that is left, and of one that is kept."""
    th, off = np.array([0.2, 0.4]), np.array([0.0, 1e-3])
    second = {"x2": th, "th2": off} if coordinates == "mixed" else {"th2": off - th}
    assert study.tilt({"th1": th, "th3": th, **second}) == pytest.approx(1e-3, rel=1e-12)
    second["th2"] = second["th2"] - off
    assert study.tilt({"th1": th, "th3": th + 2 * off, **second}) == pytest.approx(2e-3, rel=1e-12)


# A run of the study -----------------------------------------------------------------------------------------------


def test_everything_that_was_promised_is_there(study, folder):
    names = {path.name for path in folder.iterdir()}
    files = {f"{name}.csv" for name in (*TABLES, "phase_runs")}
    assert names == {"singular.md", "phases.png", "steps.png", *files}
    assert min((folder / f"{name}.png").stat().st_size for name in ("phases", "steps")) > 10_000
    assert len(rows(folder, "phase_runs")) == 4 * NUMBER
    assert len(rows(folder, "phases")) == 8
    assert len(rows(folder, "hardest")) == 4 * 2
    assert [row["dt [s]"] for row in rows(folder, "steps")] == ["0.040000000000000001", "0.02"]
    machine = {row["what"]: row["value"] for row in rows(folder, "environment")}
    assert machine["command"] == "`python scripts/singular_study.py --quick`"
    assert {"processor", "Python", "C compiler", "casadi", "numpy", "kernel", "it took"} < machine.keys()


def test_every_table_of_the_report_shows_rows_of_its_csv_file(folder):
    found = tables(folder / "singular.md")
    assert {name for _, name, _, _ in found} == TABLES
    for _, name, columns, lines in found:
        kept = rows(folder, name)
        assert len(lines) == len(kept), name
        for line, row in zip(lines, kept, strict=True):
            for title, shown in zip(columns, line, strict=True):
                assert agree(shown, row[title]), (name, title, shown, row[title])


def test_phases_are_the_same_in_every_way_to_run_them(study, folder):
    singles = rows(folder, "phase_runs")
    drawn = np.array(study.phases(NUMBER))
    for coordinates in study.PHASE_SETS:
        for dt in study.PHASE_STEPS:
            own = [r for r in singles if r["coordinates"] == coordinates and float(r["dt [s]"]) == dt]
            names = ("start angle [rad]", "torque [N.m]", "start speed [rad/s]")
            assert np.array_equal(np.array([column(own, name) for name in names]).T, drawn)
    assert drawn[:, 1].tolist() == [4.0, 2.0, 1.0, -3.0, 8.0, 4.0]
    assert drawn[:, 2].tolist() == [2.0, 2.0, 0.5, 2.0, 2.0, 0.5]


def test_what_phases_say_together_follows_from_the_single_ones(study, folder):
    singles = rows(folder, "phase_runs")
    for row in rows(folder, "phases"):
        same = [r for r in singles if all(r[name] == row[name] for name in ("coordinates", "dt [s]"))]
        branch = row["branch"]
        error, best = column(same, f"{branch} error [rad]"), column(same, "RK4 error [rad]")
        assert float(row["median / RK4"]) == pytest.approx(np.median(error / best), rel=1e-12)
        assert float(row["worst / RK4"]) == pytest.approx((error / best).max(), rel=1e-12)
        assert int(row["above twice RK4"]) == np.count_nonzero(error > 2 * best)
        calm = best < study.CALM
        assert int(row["RK4 below 5e-08 rad"]) == np.count_nonzero(calm)
        assert number(row["worst error there [rad]"]) == (error[calm].max() if calm.any() else None)
        tilted = column(same, f"{branch} tilt [rad]") > study.TILT
        assert int(row["switches of branch"]) == np.count_nonzero((error > study.LOST) | tilted)
        own, plain = (column(same, f"{name} evaluations") for name in (branch, study.PAPER))
        assert float(row["evaluations / paper"]) == pytest.approx(own.sum() / plain.sum(), rel=1e-12)
        assert float(row["evaluations / paper, worst phase"]) == pytest.approx((own / plain).max(), rel=1e-12)
        assert float(row["evaluations / step"]) >= 4.0
        assert float(row["change of reference [rad]"]) <= 1e-11
    assert any(int(row["RK4 below 5e-08 rad"]) for row in rows(folder, "phases"))


def test_the_hardest_phases_come_first(folder):
    singles, hardest = rows(folder, "phase_runs"), rows(folder, "hardest")
    for first in hardest[::2]:
        same = [r for r in singles if all(r[name] == first[name] for name in ("coordinates", "dt [s]"))]
        assert float(first["continue / RK4"]) == column(same, "continue / RK4").max()


def test_a_single_phase_is_what_the_library_gives(study, folder):
    """The error of a row, from what the row says alone."""
    row = rows(folder, "hardest")[0]
    given = {
        "start.angle": float(row["start angle [rad]"]),
        "start.angular_velocity": float(row["start speed [rad/s]"]),
    }
    torque, dt = float(row["torque [N.m]"]), float(row["dt [s]"])
    r = alfmu.simulate(
        alfmu.derive(alfmu.load("four_bar", coordinates=row["coordinates"])),
        study.PHASE_STOP,
        dt,
        parameters={**given, "solver.method": "rk4", "solver.step_size": dt},
        inputs={"A.torque": torque},
        kernel="auto",
    )
    exact = Parallelogram(m4=None).driven(*given.values(), r.time, torque)[:, 0]
    error = np.abs(r["link1.angle"] - exact).max()
    assert error == pytest.approx(float(row["continue error [rad]"]), rel=1e-3, abs=1e-11)


def test_orders_follow_from_the_errors(folder):
    (order,), (coarse, fine) = rows(folder, "orders"), rows(folder, "steps")
    for way in ("RK4", "continue", "paper"):
        slope = np.log2(float(coarse[f"{way} error [rad]"]) / float(fine[f"{way} error [rad]"]))
        assert float(fine[f"{way} order"]) == pytest.approx(slope, rel=1e-9)
        assert float(order[f"{way} order"]) == pytest.approx(slope, rel=1e-9)  # a line through two points
    assert float(order["paper order"]) < 3.0 < float(order["continue order"])
    assert float(order["continue / RK4, worst"]) == max(float(row["continue / RK4"]) for row in (coarse, fine))


def test_every_target_has_a_verdict_that_follows_from_its_number(study, folder):
    judged = rows(folder, "targets")
    assert len(judged) == len(study.TARGETS)
    for row, target in zip(judged, study.TARGETS, strict=True):
        found = [r for r in rows(folder, target.study) if all(same(r[name], x) for name, x in target.row.items())]
        value = number(found[0][target.column]) if found else None
        assert number(row["measured"]) == value
        good = value is not None and (value >= target.limit if target.at_least else value <= target.limit)
        assert row["verdict"] == ("not measured" if value is None else "met" if good else "not met")
    measured = [row for row in judged if row["verdict"] != "not measured"]
    assert {row["study"] for row in measured} == {"phases", "orders", "loops", "slider_crank"}


def same(text: str, value: str | float) -> bool:
    return text == value if isinstance(value, str) else float(text) == value


def test_a_run_that_stops_is_counted_and_judged_by_nothing_else(study):
    """Two phases, the second of which stopped under `continue`."""
    angles, starts = np.array([0.1, 0.2]), study.phases(2)
    motions = study.Reference(np.tile(angles, (2, 1)).T, np.tile(angles + 1e-6, (2, 1)).T, 0.0)
    fine, stopped = study.Run(angles + 2e-6, 0.0, 100), study.Run(angles[:1], 0.0, 40, "stopped")
    lines = [
        study.phase_row(0.02, "mixed", k, starts[k], motions, runs)
        for k, runs in enumerate([(fine, fine), (stopped, fine)])
    ]
    own, plain = (study.summary(lines, branch, 0.0) for branch in study.BRANCHES)
    assert (own["stopped"], plain["stopped"]) == (1, 0)
    assert own["worst / RK4"] == pytest.approx(2.0)
    assert own["evaluations / paper"] == 1.0
    assert lines[1]["continue error [rad]"] is None
    assert lines[1]["continue stopped by"] == "stopped"


def test_without_a_compiler_it_runs_by_the_virtual_machine(study, tmp_path, monkeypatch):
    monkeypatch.setattr("_study.no_compiler", lambda: "there is none")
    assert study.main(["--quick", "--only", "slider-crank", "-o", str(tmp_path)]) == 0
    assert {row["what"]: row["value"] for row in rows(tmp_path, "environment")}["kernel"] == "vm"
    assert {row["verdict"] for row in rows(tmp_path, "targets") if row["study"] != "slider_crank"} == {"not measured"}
    assert not (tmp_path / "phases.csv").exists()


def test_mistakes_of_the_user_are_explained_without_a_traceback(tmp_path):
    file = tmp_path / "file"
    file.touch()
    for arguments, words in ((["-o", str(file)], "cannot be written"), (["--only", "phase"], "invalid choice")):
        command = [sys.executable, str(SCRIPTS / "singular_study.py"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert done.returncode != 0
        assert words in done.stderr
        assert "Traceback" not in done.stderr
