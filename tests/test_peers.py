"""Codes that are tuned to a mechanism, and the profile of a report that sets alfmu beside them at equal error."""

from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np
import pytest
from studies import rows, tables, untraced

import alfmu
from alfmu.simulation import prepared, with_defaults
from alfmu.studies import peers
from alfmu.studies import reference as exact
from alfmu.studies.cases import POSITION, REACTION, Case, Judge
from alfmu.studies.report import PROFILES, Setting, Study, report, time_at
from alfmu.studies.rivals import TUNED, not_installed

pytestmark = pytest.mark.slow

OTHERS = {"pin": "Pinocchio", "exudyn": "Exudyn", "mujoco": "MuJoCo"}

ONCE = {"order8": "compiled, joint", "auto": "vm"}
"""The one way in which each of these integrators runs here; RK4 runs in all."""


def needed(setting: Setting) -> bool:
    return ONCE.get(setting.method, setting.way) == setting.way


@pytest.fixture(scope="module")
def folder(tmp_path_factory, quick_compiler):
    """The profile over 1 s, where nothing but alfmu and SciPy is installed."""
    made = tmp_path_factory.mktemp("peers")
    effort = PROFILES["peers"][1]
    with pytest.MonkeyPatch.context() as patch:
        alone = tuple(replace(x, missing="not installed") if x.name in OTHERS.values() else x for x in TUNED)
        patch.setattr("alfmu.studies.report.TUNED", alone)
        every = Study._settings
        patch.setattr(Study, "_settings", lambda own: [[x for x in each if needed(x)] for each in every(own)])
        effort = replace(effort, horizon=1.0, factors=(1, 1 / 2, 1 / 4), tolerances=(1e-5, 1e-6))
        report(list(peers.MACHINES), made, effort=effort, profile="peers", quick=True)
    return made


@pytest.fixture(scope="module", params=list(peers.MACHINES))
def judged(request):
    """Equations from the start of the profile, their judge over 1 s, and the points."""
    equations = with_defaults(alfmu.derive(alfmu.load(request.param)), PROFILES["peers"][0].given)
    equations = prepared(equations, "oracle")
    instance = alfmu.Instance(equations)
    instance.initialize()
    known = exact.reference(instance, 1.0, exact.Effort(parts=100))
    times = np.arange(51) * 0.02
    judge = Judge(equations, known)
    return equations, judge, times


def test_the_reference_is_tighter_than_what_it_judges(judged):
    """Other ways to compute it, its energy, and its rate: 2 rad/s at the start, a little less one sample later."""
    equations, judge, times = judged
    assert all(row[POSITION] < 1e-11 for row in judge.errors_of_reference(times))
    assert np.ptp(judge.reference.energies(times)) < 1e-11
    angle = judge.reference.outputs(times)[:, judge.names.index(peers.MACHINES[equations.name].names[0])]
    start = PROFILES["peers"][0].given
    assert angle[0] == start["start.angle"] == 0.0
    assert 0.8 < angle[1] / (start["start.angular_velocity"] * times[1]) < 1.0


@pytest.mark.parametrize("package", [*OTHERS, "scipy"])
def test_an_installed_code_simulates_the_same_mechanism(judged, package):
    pytest.importorskip({"pin": "pinocchio"}.get(package, package))
    equations, judge, times = judged
    name = OTHERS.get(package, "SciPy stabilised")
    rival = next(x for x in TUNED if x.name == name)
    made = rival.run(equations, 1e-6 if package == "scipy" else 1e-3, Case({}, times, 60.0))
    assert np.array_equal(made.times, times)
    errors, cost = judge.errors(made), made.cost()
    assert 0 < cost["least [s]"] <= cost["median [s]"] <= max(made.seconds)
    assert errors[POSITION] < 1e-3
    assert errors[REACTION] < 1.0  # N, of some 60; second order and soft constraints


def test_rows_of_a_study_without_other_codes(folder):
    made = rows(folder, "errors")
    assert {(r["mechanism"], r["code"]) for r in made} == {
        (mechanism, code) for mechanism in peers.MACHINES for code in ("alfmu", "SciPy stabilised")
    }
    for row in (r for r in made if not r["note"]):
        assert 0 < float(row["least [s]"]) <= float(row["median [s]"])
        assert 2 <= int(row["repeats"]) <= PROFILES["peers"][1].repeats
        assert float(row[POSITION]) < 1e-3
        assert float(row[REACTION]) < 0.1
    skipped = {(r["mechanism"], r["code"]) for r in rows(folder, "skipped")}
    assert skipped >= {(mechanism, code) for mechanism in peers.MACHINES for code in OTHERS.values()}


def test_alfmu_converges_with_order_4_and_kernels_agree(folder):
    for mechanism in peers.MACHINES:
        own = [r for r in rows(folder, "errors") if (r["code"], r["mechanism"]) == ("alfmu", mechanism)]
        error = {(r["way"], r["method"], round(float(r["value"]), 6)): float(r[POSITION]) for r in own}
        for form in ("", ", joint", ", joint, lean"):
            way = f"compiled{form}"
            assert error[way, "rk4", 0.01] / error[way, "rk4", 0.005] == pytest.approx(16, rel=0.5)
            assert error[f"vm{form}", "rk4", 0.01] == pytest.approx(error[way, "rk4", 0.01], rel=1e-3)
        assert error["compiled, joint", "order8", 0.02] < 1e-10
        assert error["vm", "auto", 1e-5] < 1e-5


def test_the_report_compares_at_equal_error(folder):
    page = folder / "report.md"
    for _, name, names, lines in tables(page):
        assert untraced(page, name, names, lines) == [], name
    text = page.read_text(encoding="utf-8")
    assert "`alfmu report all --profile peers --quick`" in text
    for code in (*OTHERS.values(), "SciPy stabilised"):
        assert f"| {code} | " in text
    reach = rows(folder, "reach")
    for row in (r for r in reach if r["run time [s]"]):
        same = [r for r in reach if all(r[x] == row[x] for x in ("mechanism", "position error")) and r["run time [s]"]]
        for way in ("compiled", "vm"):
            own = [r for r in same if r["code"] == "alfmu" and r["way"].startswith(way) and "lean" not in r["way"]]
            ratio = row[f"over alfmu's fastest, {way}"]
            fastest = min((float(r["run time [s]"]) for r in own), default=None)
            assert (fastest is None) == (ratio == "")
            if fastest:
                assert float(ratio) == pytest.approx(float(row["run time [s]"]) / fastest)


def test_mechanisms_that_no_code_is_tuned_to_are_refused(tmp_path):
    with pytest.raises(alfmu.InputError, match="tuned to five_bar, slider_crank"):
        report(["bennett"], tmp_path, profile="peers")


def test_what_is_not_installed_is_seen(monkeypatch):
    def missing(package: str) -> str:
        if package in OTHERS:
            raise PackageNotFoundError(package)
        return version(package)

    monkeypatch.setattr("alfmu.studies.rivals.version", missing)
    assert {package for package in (*OTHERS, "scipy") if not_installed(package)} == set(OTHERS)


def test_run_times_are_compared_at_equal_error_and_never_beyond_it():
    own = [(1e-3, 1.0), (1e-7, 4.0)]
    assert time_at(1e-5, own) == pytest.approx(2.0)
    assert time_at(1e-2, own) == 1.0
    assert time_at(1e-9, own) is None
    assert time_at(1e-5, []) is None
