"""Random parameters, starts and inputs: no run is wrong in silence, and with error control none is wrong."""

from contextlib import nullcontext

import pytest
from pairs import draws
from studies import script

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_compiler")]
DRAWS = draws(8)
"""`DRAWS=20 pytest tests/test_draw_study.py` draws more."""


@pytest.fixture(scope="module")
def study():
    """The script as a module."""
    yield from script("draw_study")


@pytest.mark.parametrize("name", ["particle_on_circle", "slider_crank", "four_bar"])
def test_fixed_steps_are_right_or_warned_about(study, name):
    found = study.counted(name, max(DRAWS, 10), "rk4", 2.0, 1)
    assert found["silent"] == found["traceback"] == 0
    assert found["right"] > 0
    assert found["warned"] + found["ended"] > 0


@pytest.mark.parametrize("name", ["particle_on_circle", "slider_crank", "four_bar"])
def test_with_error_control_all_that_start_are_right(study, name):
    found = study.counted(name, DRAWS, "explicit", 2.0, 1)
    assert found["right"] + found["refused"] == DRAWS


def test_the_script_prints_its_counts(study, capsys):
    assert study.main(["--draws", "3", "--only", "particle_on_circle", "--stop-time", "0.5", "--jobs", "1"]) == 0
    head, row = capsys.readouterr().out.splitlines()
    assert head.split() == ["mechanism", *study.KINDS]
    assert sum(map(int, row.split()[1:])) == 3


def test_processes_count_the_same(study):
    alone, together = (study.counted("particle_on_circle", 6, "rk4", 1.0, 1, jobs=jobs) for jobs in (1, 2))
    assert alone == together
    assert sum(alone.values()) == 6


def test_a_silent_run_is_seen(study, monkeypatch, capsys):
    """With nothing heard, what was warned about counts as silent."""
    monkeypatch.setattr(study, "collected", lambda: nullcontext([]))
    assert study.main(["--draws", "10", "--only", "particle_on_circle", "--method", "rk4", "--jobs", "1"]) == 1
    assert "silent" in capsys.readouterr().err
