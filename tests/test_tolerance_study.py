"""Tolerances are held on every mechanism, by the script that measures it over whole runs; and its files."""

from dataclasses import replace

import pytest
from studies import prose, rows, script, tables, untraced

from alfmu.studies.cases import POSITION

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def study():
    """The script as a module."""
    yield from script("tolerance_study")


@pytest.mark.parametrize(
    ("name", "horizon", "tolerances"),
    [
        ("particle_on_circle", 3.0, (1e-6, 1e-9)),
        ("slider_crank", 3.0, (1e-6, 1e-9)),
        ("four_bar", 3.0, (1e-6, 1e-9)),
        ("five_bar", 3.0, (1e-6, 1e-9)),
        ("n_four_bar", 3.0, (1e-6, 1e-9)),
        ("bennett", 3.0, (1e-6, 1e-9)),
        ("end_stop", 2.5, (1e-6, 1e-9)),
        ("flexible_four_bar", 0.02, (1e-6,)),
    ],
)
def test_the_largest_error_is_within_ten_times_the_tolerance(study, name, horizon, tolerances):
    """By `explicit`, from the start with all defaults; the flyball governor is in `test_methods`."""
    effort = replace(study.QUICK, horizon=horizon, tolerances=tolerances, limit=60.0)
    for row in study.measured(name, effort, "vm", ("explicit",)):
        assert row["verdict"] == "held", row
        assert row["error over tolerance"] <= 10
        assert row["change of reference"] <= 0.2 * row["tolerance"]
        assert row["simulated [s]"] == pytest.approx(horizon)


def test_the_report_of_two_mechanisms(study, tmp_path, monkeypatch):
    monkeypatch.setattr(study, "QUICK", replace(study.QUICK, horizon=0.5))
    monkeypatch.setattr(study, "METHODS", ("explicit",))
    short = study.Race("explicit", 0.5, study.RACES["slider_crank"].start, (1e-4, 1e-7))
    monkeypatch.setitem(study.RACES, "slider_crank", short)
    assert study.main(["--quick", "--only", "particle_on_circle", "four_bar", "-o", str(tmp_path)]) == 0
    report = tmp_path / "tolerances.md"
    assert {name for _, name, *_ in tables(report)} == {"environment", *study.CHAPTERS}
    for _, name, columns, lines in tables(report):
        assert untraced(report, name, columns, lines) == []
    assert not any(c.isdigit() for c in prose(report).replace("(9)", ""))
    cases = (("explicit", 1e-6), ("explicit", 1e-9), ("auto", 1e-6))
    held = [(r["mechanism"], r["method"], float(r["tolerance"]), r["verdict"]) for r in rows(tmp_path, "tolerances")]
    names = ("four_bar mixed", "four_bar joint", "particle_on_circle")
    assert held == [(name, *case, "held") for name in names for case in cases]
    seconds = {(r["mechanism"], r["method"], r["tolerance"]): r["median [s]"] for r in rows(tmp_path, "tolerances")}
    for row in rows(tmp_path, "auto"):
        both = [float(seconds[row["mechanism"], method, f"{1e-6:.17g}"]) for method in ("auto", "explicit")]
        assert (row["chosen"], float(row["ratio"])) == ("explicit", pytest.approx(both[0] / both[1]))
        assert row["verdict"] == ("met" if float(row["ratio"]) <= study.TWICE else "not met")
    assert (tmp_path / "tolerances.png").stat().st_size > 10_000
    machine = {r["what"]: r["value"] for r in rows(tmp_path, "environment")}
    assert machine["command"] == "`python scripts/tolerance_study.py --quick --only four_bar particle_on_circle`"
    races = rows(tmp_path, "races")
    assert [r["method"] for r in races] == [x for x in ("explicit", "DOP853", "Radau", "BDF") for _ in range(2)]
    assert all(float(r[POSITION]) <= 10 * float(r["tolerance"]) for r in races if r["method"] == "explicit")
    verdicts = {r["row"]: r for r in rows(tmp_path, "targets")}
    assert len(verdicts) == len(study.RACES) * 3
    assert verdicts["flyball_governor, Radau"]["verdict"] == "not measured"
    for method in ("DOP853", "Radau", "BDF"):
        ratios = [float(r["ratio"]) for r in races if r["method"] == method and r["ratio"]]
        target = verdicts[f"slider_crank, {method}"]
        if ratios:
            assert float(target["measured"]) == pytest.approx(min(ratios))
            assert target["verdict"] == ("met" if min(ratios) >= 20 else "not met")
    assert any(r["ratio"] for r in races)


def test_run_times_are_compared_at_equal_error_and_never_beyond_it(study):
    own = [(1e-3, 1.0), (1e-7, 4.0)]
    assert study.time_at(1e-5, own) == pytest.approx(2.0)
    assert study.time_at(1e-2, own) == 1.0
    assert study.time_at(1e-9, own) is None
    assert study.time_at(1e-5, []) is None
