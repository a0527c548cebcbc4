"""Tolerances are held on every mechanism, by the script that measures it over whole runs; and its files."""

from dataclasses import replace

import pytest
from studies import prose, rows, script, tables, untraced


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
    assert study.main(["--quick", "--only", "particle_on_circle", "four_bar", "-o", str(tmp_path)]) == 0
    report = tmp_path / "tolerances.md"
    for _, name, columns, lines in tables(report):
        assert untraced(report, name, columns, lines) == []
    assert not any(c.isdigit() for c in prose(report))
    assert [(r["mechanism"], float(r["tolerance"]), r["verdict"]) for r in rows(tmp_path, "tolerances")] == [
        (name, tolerance, "held")
        for name in ("four_bar mixed", "four_bar joint", "particle_on_circle")
        for tolerance in (1e-6, 1e-9)
    ]
    assert {(r["chosen"], r["ratio"], r["verdict"]) for r in rows(tmp_path, "auto")} == {("explicit", "1", "met")}
    assert (tmp_path / "tolerances.png").stat().st_size > 10_000
    machine = {r["what"]: r["value"] for r in rows(tmp_path, "environment")}
    assert machine["command"] == "`python scripts/tolerance_study.py --quick --only four_bar particle_on_circle`"
