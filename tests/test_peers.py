"""The peers script at its smallest effort: exact motions, errors, rounds, interpolation and files hang together."""

import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest
from studies import rows

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parents[1] / "scripts"
OTHERS = {"pin": "Pinocchio", "exudyn": "Exudyn", "mujoco": "MuJoCo"}


@pytest.fixture(scope="module")
def peers():
    """The script as a module, with runs of 1 s."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        import peers

        patch.setattr(peers, "STOP", 1.0)
        yield peers


@pytest.fixture(scope="module")
def folder(peers, tmp_path_factory):
    """Results of a quick study where nothing but alfmu and SciPy is installed."""

    def found(package: str) -> str:
        if package in OTHERS:
            raise PackageNotFoundError(package)
        return version(package)

    made = tmp_path_factory.mktemp("peers")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("alfmu.studies.peers.version", found)
        assert peers.main(["--quick", "-o", str(made)]) == 0
    return made


def judged(peers, peer, mechanism: str, step: float):
    """A point of a run of 1 s."""
    point = peers.Point(peer, mechanism, step)
    peers.judge(point, peers.reference(mechanism, peers.STOP), peers.samples(peers.STOP))
    return point


@pytest.mark.parametrize("mechanism", ["five_bar", "slider_crank"])
def test_the_exact_motion_is_tighter_than_what_it_judges(peers, mechanism):
    exact = peers.reference(mechanism, 2.0)
    assert exact.change < 1e-11
    assert exact.energy < 1e-11
    assert exact.angle[0] == 0
    assert 0.8 < exact.angle[1] / (peers.RATE * peers.SAMPLE) < 1


def test_rows_of_a_study_without_peers(folder):
    points = rows(folder, "peers")
    assert {(row["mechanism"], row["code"]) for row in points} == {
        (mechanism, code) for mechanism in ("five_bar", "slider_crank") for code in ("alfmu", "SciPy")
    }
    for row in points:
        least, median, most = (float(row[f"{name} [s]"]) for name in ("least", "median", "most"))
        assert 0 < least <= median <= most
        assert row["repeats"] == "3"
        assert float(row["angle error [rad]"]) < 1e-3
        assert float(row["reaction error [N]"]) < 0.1
        assert row["note"] == ""


def test_alfmu_converges_with_order_4_and_kernels_agree(folder):
    for mechanism in ("five_bar", "slider_crank"):
        runs = [r for r in rows(folder, "peers") if (r["code"], r["mechanism"]) == ("alfmu", mechanism)]
        error = {(r["setting"], round(float(r["step"]), 6)): float(r["angle error [rad]"]) for r in runs}
        for setting in ("compiled", "compiled, joint", "compiled, joint, lean"):
            assert error[setting, 0.01] / error[setting, 0.005] == pytest.approx(16, rel=0.5)
        for form in ("", ", joint", ", joint, lean"):
            assert error[f"vm{form}", 0.01] == pytest.approx(error[f"compiled{form}", 0.01], rel=1e-3)
        assert error["compiled, joint, order8", 0.02] < 1e-10
        assert error["vm, auto", 1e-5] < 1e-5


def test_report_names_what_is_missing_and_where_it_ran(peers, folder):
    text = (folder / "peers.md").read_text(encoding="utf-8")
    for package, name in OTHERS.items():
        assert text.count(f"| {name} |  | not installed |") == 2, package
    assert "`python scripts/peers.py --quick`" in text
    assert str(folder) not in text
    assert (folder / "peers.png").stat().st_size > 10_000
    for kernel, ratio in peers.RATIOS.items():
        assert re.search(rf"\| {kernel}.* \| SciPy, DOP853 .* {ratio:g}: (met|not met) \|", text)
    missing = [r for r in rows(folder, "peers_reach") if r["time at target [s]"] == "not installed"]
    assert len(missing) == 2 * len(OTHERS)


def points(peers, *measured):
    """Points of one setting from errors [rad] and rounds [s]."""
    peer = peers.Alfmu("alfmu", "alfmu", "compiled", {})
    return [peers.Point(peer, "five_bar", 0.02, error, 0.1, seconds) for error, seconds in measured]


def test_interpolation_is_logarithmic_and_by_rounds(peers):
    reach = peers.Reach(points(peers, (1e-4, [1.0, 2.0, 9.0]), (1e-8, [4.0, 8.0])), 1e-6)
    assert reach.seconds == pytest.approx([2.0, 4.0])
    assert reach.text == "3"
    assert reach.ratios(peers.Reach(points(peers, (1e-4, [1.0]), (1e-8, [1.0])), 1e-6)) == pytest.approx([2.0])


def test_nothing_is_extrapolated(peers):
    short = peers.Reach(points(peers, (1e-3, [1.0]), (2e-5, [2.0])), 1e-6)
    assert (short.seconds, short.text) == ([], "not reached (best 2e-05 rad)")
    below = peers.Reach(points(peers, (1e-7, [1.0]), (1e-8, [2.0])), 1e-6)
    assert (below.seconds, below.text) == ([1.0], "<= 1")
    lost = points(peers, (None, []))
    lost[0].note = "lost the motion at t = 1 s"
    assert peers.Reach(lost, 1e-6).text == "not reached (lost the motion at t = 1 s)"


def test_a_lost_motion_and_an_exception_are_results(peers):
    class Strays(peers.Peer):
        def build(self, mechanism, start, step, times):
            if step == 1.0:
                raise RuntimeError("no\n such model")
            angle = peers.reference(mechanism, peers.STOP).angle + np.where(times > 0.5, 1.0, 0.0)
            return lambda: peers.Trajectory(times, angle, np.zeros((len(times), 7)))

    peer = Strays("scipy", "SciPy", "strays", {})
    assert judged(peers, peer, "slider_crank", 1.0).note == "RuntimeError: no such model"
    lost = judged(peers, peer, "slider_crank", 0.5)
    assert (lost.note, lost.simulate) == ("lost the motion at t = 0.52 s", None)


@pytest.mark.parametrize("mechanism", ["five_bar", "slider_crank"])
@pytest.mark.parametrize("package", OTHERS)
def test_an_installed_peer_simulates_the_same_mechanism(peers, package, mechanism):
    pytest.importorskip({"pin": "pinocchio"}.get(package, package))
    peer = next(peer for peer in peers.peers() if peer.package == package)
    point = judged(peers, peer, mechanism, 1e-3)
    assert point.error < 1e-3, point.note
    assert point.force_error < 1.0  # N, of some 60; second order and soft constraints
