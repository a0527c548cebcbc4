"""Maps of stability at their smallest effort; and classes of runs that are known to fail."""

import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from studies import prose, rows, tables, untraced

import alfmu
from alfmu.cli import main
from alfmu.model.settings import FORMULATIONS, METHODS
from alfmu.studies import reference as exact
from alfmu.studies.cases import ENERGY, PHI, POSITION, Run
from alfmu.studies.stability import CLASSES, OTHER, REFUSED, Cell, Effort, Study, classified, stability

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_compiler")]

SMALL = Effort(
    total=30.0,
    horizon=0.4,
    limit=0.05,
    steps=(1e-4, 1.0, 10.0),
    penalties=(1e2, 1e14),
    scales=(1e-6, 1.0, 1e6),
    masses=1,
    reference=exact.Effort(fine=1e-9, coarse=None, parts=20, seconds=0.5),
)

SPRING = """
from alfmu import Mechanism

def bouncer() -> Mechanism:
    m = Mechanism("bouncer", "A mass on a spring")
    k = m.parameter("k", 100.0, "N/m")
    mass = m.parameter("m1", 1.0, "kg", minimum=0.0)
    x = m.coordinate("x", "m", start=0.1, independent=True)
    m.kinetic_energy(mass * m.rate(x) ** 2 / 2)
    m.potential_energy(k * x ** 2 / 2)
    m.output("mass.x", x, "m", "place")
    return m
"""


FEW = ("rk4", "explicit")
"""Methods that the maps of these tests run, of all that there are."""


@pytest.fixture(autouse=True, scope="module")
def few_methods():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("alfmu.studies.stability.methods", lambda: {name: METHODS[name] for name in FEW})
        yield


@pytest.fixture(scope="module")
def written(tmp_path_factory, few_methods):
    return stability(["particle_on_circle"], tmp_path_factory.mktemp("stability"), effort=SMALL)


@cache
def prepared_study(name: str) -> Study:
    """A study of which no cell is run yet."""
    study = Study(name, replace(SMALL, horizon=2.0, limit=5.0))
    study.measure(0.0, iter)
    return study


def cell(formulation: str = "residual", step: float = 1.0, penalty: float = 0.0, **scaled: float) -> Cell:
    return Cell("map", "across", "down", "column", "row", formulation, "rk4", step, penalty, scaled)


def test_every_number_of_the_report_stands_in_a_csv_file(written):
    shown = tables(written)
    for title, name, names, lines in shown:
        if name != "cells":
            assert untraced(written, name, names, lines) == [], name
            continue
        known = {(r["row"], r["column"]): r for r in rows(written.parent, name) if r["map"] == title}
        for label, *classes in lines:
            for column, text in zip(names[1:], classes, strict=True):
                row = known[label, column]
                assert text == row["class"] + " *" * (row["cut short"] == "1"), (title, label, column)
    assert not any(c.isdigit() for c in prose(written))
    counted = sum(int(r["cells"]) for r in rows(written.parent, "counts"))
    assert counted == len(rows(written.parent, "cells"))
    assert (written.parent / "particle_on_circle_stability.png").stat().st_size > 20_000


def test_no_corner_is_left_out(written):
    cells = rows(written.parent, "cells")
    corners = {
        (r["formulation"], float(r["step over default"]), float(r["penalty over mass"]), r["parameters"])
        for r in cells
        if r["map"].startswith("corners")
    }
    masses = ("m*1e-06", "m*1e+06")
    assert corners == set(product(FORMULATIONS, (1e-4, 10.0), (1e2, 1e14), masses))
    assert all(r["class"] in CLASSES for r in cells)
    assert {r["class"] for r in cells if r["map"] == "masses at the default step"} == {"exact"}
    assert all(float(r["simulated [s]"]) >= 0.4 - 1e-9 or r["cut short"] == "1" or r["message"] for r in cells)


def test_a_step_that_suits_is_exact_and_a_wrong_one_fails():
    study = prepared_study("slider_crank")
    row = study._measured(cell())
    assert row["class"] == "exact"
    assert row["simulated [s]"] == pytest.approx(2.0)
    assert row[POSITION] < 1e-3
    wrong = study._measured(cell(step=25.0))
    assert wrong["class"] not in ("exact", "inexact", "stable, not judged")


def test_a_stiff_penalty_blows_up_by_refusal():
    row = prepared_study("slider_crank")._measured(cell("stiffness"))
    assert row["class"] == "refused: step too long"
    assert "reduce solver.step_size" in row["message"]


def test_a_mass_out_of_its_bounds_is_refused_as_such():
    row = prepared_study("slider_crank")._measured(cell(l1=-1.0))
    assert row["class"] == "refused: value out of bounds"
    assert row["simulated [s]"] == 0.0


def test_what_is_cut_short_says_how_far_it_came():
    study = prepared_study("particle_on_circle")
    study.effort = replace(study.effort, limit=0.02)
    row = study._measured(cell("classic", step=1e-4))
    assert row["cut short"] == 1
    assert 0 < row["reached [%]"] < 100
    assert row["class"] == "exact"


def test_springs_have_a_map_where_there_are_any(tmp_path):
    path = tmp_path / "bouncer.py"
    path.write_text(SPRING)
    effort = replace(SMALL, scales=(1.0, 1e8))
    shown = tables(stability([path], tmp_path / "out", effort=effort))
    table = next(lines for title, _, _, lines in shown if title.startswith("stiffness of springs"))
    classes = {line[0]: line[1:] for line in table}
    assert classes["1"][1] == "exact"  # the default step
    assert classes["1e+08"][1] not in ("exact", "inexact")
    corners = rows(tmp_path / "out", "cells")
    assert {"m1*1 k*1", "m1*1e+08 k*1e+08"} < {r["parameters"] for r in corners}


def test_criteria_in_their_order():
    finite = Run(["x"], np.zeros(1), np.zeros((1, 1)), [0.0])

    def of(position, phi=0.0, energy=0.0, judged=True, run=finite):
        return classified(run, {POSITION: position, PHI: phi, ENERGY: energy}, 1.0, 1.0, judged)

    assert of(1e-4) == "exact"
    assert of(1e-2) == "inexact"
    assert of(1.0) == "motion lost"
    assert of(1.0, phi=0.1) == "constraints drift"
    assert of(1.0, phi=0.1, energy=1.0) == "energy grows"
    assert of(None, judged=False) == "stable, not judged"
    assert of(1e-4, run=replace(finite, values=np.array([[np.nan]]))) == "not finite"
    assert of(1e-4, run=replace(finite, failure="x: locked up at y")) == "refused: locked up"
    assert of(1e-4, run=replace(finite, failure="nobody knows")) == REFUSED + OTHER
    steps = Path(alfmu.__file__).parent / "runtime" / "c" / "step"
    written = "".join(path.read_text() for path in steps.glob("*.c"))
    opened = re.findall(r'instance_say\(i, CONSTRAINT_OPEN,\s*((?:"[^"]*"\s*)+)', written)
    assert len(opened) == 3
    for each in opened:
        failure = "".join(re.findall('"([^"]*)"', each))
        assert of(1e-4, run=replace(finite, failure=failure)) == REFUSED + "constraints left open", failure


def test_what_time_does_not_allow_is_listed_and_all_is_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("alfmu.studies.stability.QUICK", replace(SMALL, total=0.0))
    monkeypatch.setattr("alfmu.catalogue.registry.mechanisms", lambda: ["particle_on_circle", "four_bar"])
    assert main(["stability", "all", "--quick", "-o", str(tmp_path)]) == 0
    assert "stability.md" in capsys.readouterr().out
    assert {r["class"] for r in rows(tmp_path, "cells")} == {"not run"}
    assert {r["mechanism"] for r in rows(tmp_path, "cells")} == {"particle_on_circle", "four_bar"}
    assert "`alfmu stability all --quick`" in (tmp_path / "stability.md").read_text()
