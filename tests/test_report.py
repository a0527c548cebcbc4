"""Error against run time at its smallest effort; and the reference, against exact solutions."""

import re
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from pages import errors
from scenes import derived, hinged
from selenium.webdriver.support.ui import WebDriverWait
from studies import prose, rows, script, tables, untraced

import alfmu
from alfmu.catalogue.registry import mechanisms
from alfmu.cli import main
from alfmu.model.settings import FORMULATIONS, METHODS
from alfmu.simulation import oracle, prepared, with_defaults
from alfmu.studies import cases, paper, stability
from alfmu.studies import reference as exact
from alfmu.studies.cases import ENERGY, PHI, POSITION, REACTION, Case, Judge, restarting, run
from alfmu.studies.looks import LOOKS
from alfmu.studies.page import Page
from alfmu.studies.report import (
    LEVELS,
    PROFILES,
    QUICK,
    TIME,
    Effort,
    Setting,
    Study,
    _chapter_of_page,
    _skipped,
    report,
)
from alfmu.studies.rivals import RIVALS

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("quick_compiler")]

MAPS = stability.Effort(
    total=0.0,
    horizon=0.1,
    limit=0.005,
    steps=(0.1, 1.0),
    penalties=(1e2, 1e10),
    scales=(1.0,),
    masses=1,
    reference=exact.Effort(fine=1e-9, coarse=None, parts=20, seconds=0.5),
)
SMALL = Effort(
    total=120.0,
    each=120.0,
    horizon=0.32,
    steps=1000,
    factors=(2.0, 1.0, 0.5),
    tolerances=(1e-5,),
    limit=0.3,
    repeats=1,
    reference=exact.Effort(parts=40),
    paper=replace(paper.QUICK, stop=0.1, counted=0.1, driven=0.1, phases=2, states=1),
    stability=MAPS,
)
FEW = {name: METHODS[name] for name in ("rk4", "explicit")}
"""Methods that the reports of these tests run, of all that there are."""
TIMES = np.linspace(0.0, 0.4, 21)
SHORT = exact.Effort(parts=16)
"""Enough for the TIMES."""

DIAMOND = """
import casadi as ca
from alfmu import Mechanism

def diamond() -> Mechanism:
    m = Mechanism("diamond", "Two cranks and a coupler, with a guess that closes nothing but the start")
    start = m.start("angle", {angle}, "rad", rate=1.0, rate_name="rate")
    th1 = m.coordinate("th1", "rad", start=start)
    th2 = m.coordinate("th2", "rad", start={angle})
    m.kinetic_energy((m.rate(th1) ** 2 + 2 * m.rate(th2) ** 2) / 2)
    m.constraint("mirror", ca.sin(th2) - ca.sin(th1), "m")
    return m
"""


def started(name: str, **values: float) -> alfmu.Instance:
    instance = oracle.Instance(prepared(alfmu.derive(alfmu.load(name)), "oracle"))
    for key, value in values.items():
        instance.set(key.replace("__", "."), value)
    instance.initialize()
    return instance


def columns(instance: alfmu.Instance, names: list[str]) -> list[int]:
    known = [v.name for v in instance.equations.outputs]
    return [known.index(name) for name in names]


# The reference -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.5, 0.0], ids=["away from singular positions", "from a singular position"])
def test_the_reference_of_the_five_bar_is_its_exact_motion(angle):
    instance = started("five_bar", start__angle=angle, start__angular_velocity=2.0)
    found = exact.reference(instance, TIMES[-1], SHORT)
    angles = found.outputs(TIMES)[:, columns(instance, ["link1.angle", "link3.angle"])]
    known = Parallelogram().swing(angle, 2.0, TIMES)
    assert np.abs(angles - known[:, :1]).max() < 1e-12
    readable = found.readable(TIMES)
    assert readable[-1]
    assert readable[0] == (angle != 0.0)
    names = [f"{joint}.force.y" for joint in "ABCDEF"]
    forces = found.outputs(TIMES)[-1, columns(instance, names)]
    expected = Parallelogram().forces(*known[-1])
    assert np.abs(forces - [expected[name] for name in names]).max() < 1e-10


def test_the_reference_of_the_slider_crank_is_its_exact_motion():
    instance = started("slider_crank", start__angular_velocity=1.0)
    found = exact.reference(instance, TIMES[-1], SHORT)
    known = SliderCrank().motion(np.pi / 4, 1.0, TIMES)
    outputs = found.outputs(TIMES)
    assert np.abs(outputs[:, columns(instance, ["crank.angle"])[0]] - known[:, 0]).max() < 1e-11
    expected = SliderCrank().readings(*known[-1])
    names = [name for name in expected if ".force" in name]
    assert len(names) == 7
    assert np.abs(outputs[-1, columns(instance, names)] - [expected[name] for name in names]).max() < 1e-9


@pytest.mark.parametrize(
    ("what", "why"),
    [
        ("state", "it follows the motion of coordinates alone, and this mechanism has states"),
        ("friction", "its equations have no dry friction, which A has"),
        ("blade", "it closes constraints of positions, and edge holds velocities alone"),
        ("law", "constraints or places depend on time, which reductions by start values do not have"),
    ],
)
def test_there_is_no_reference_of_what_it_does_not_know(what, why):
    m, _, joint, *_ = hinged("odd", weight=0.0)
    if what == "state":
        m.derivative(s := m.state("s", "1"), -s)
    elif what == "friction":
        m.friction(joint, coulomb=0.2, radius=0.1)
    elif what == "law":
        m.motion(joint, 2.0 * m.time)
    else:
        place = [m.coordinate(name, unit) for name, unit in (("x", "m"), ("y", "m"), ("a", "rad"))]
        m.blade("edge", m.body("sleigh", mass=1.0, inertia=0.1, pose=tuple(place)).at(0.1, 0))
    instance = alfmu.Instance(m)
    instance.initialize()
    assert exact.reference(instance, 1.0, SHORT) == why


@pytest.mark.parametrize("name", ["five_bar", "slider_crank", "bennett"])
def test_the_reference_is_tighter_than_what_it_judges(name):
    instance = started(name, start__angle=0.6, start__angular_velocity=2.0)
    found = exact.reference(instance, TIMES[-1], SHORT)
    assert {found.motion.way.name, *(other.way.name for other in found.others)} == {
        "placement of the declaration",
        "null space of C",
    }
    judge = Judge(instance.equations, found)
    changes = judge.errors_of_reference(TIMES)
    assert len(changes) == 2
    unit = alfmu.Instance(instance.equations)
    unit.set("start.angle", 0.6)
    unit.set("start.angular_velocity", 2.0)
    judged = judge.errors(
        run(unit, restarting(unit), Case({"solver.method": "rk4", "solver.step_size": 0.005}, TIMES, 60.0))
    )
    for quantity in (POSITION, REACTION):
        assert max(row[quantity] for row in changes) < 0.02 * judged[quantity], quantity
    assert judged[POSITION] < 1e-4
    assert judged[ENERGY] < 1e-3
    assert judged[PHI] < 1e-12


def test_a_driven_mechanism_has_a_reference_too():
    instance = started("four_bar", start__angle=0.5, start__angular_velocity=1.0)
    instance.set("A.torque", 4.0)
    found = exact.reference(instance, TIMES[-1], SHORT)
    angles = found.outputs(TIMES)[:, columns(instance, ["link1.angle"])[0]]
    assert np.abs(angles - Parallelogram(m4=None).driven(0.5, 1.0, TIMES, 4.0)[:, 0]).max() < 1e-11
    assert not Judge(instance.equations, found).conserves
    assert Judge(instance.equations, exact.reference(started("four_bar", start__angle=0.5), 0.1, SHORT)).conserves


def test_without_a_placement_the_reference_ends_before_a_singular_position(tmp_path):
    path = tmp_path / "diamond.py"
    path.write_text(DIAMOND.format(angle=1.3))
    found = exact.reference(started(str(path)), 1.0, SHORT)
    assert found.motion.way.name == "null space of C"
    assert 0.2 < found.until < np.pi / 2 - 1.3
    known = found.outputs(np.array([0.0, found.until, 1.0]))
    assert np.isfinite(known).all(axis=1).tolist() == [True, True, False]
    assert found.readable(np.array([0.0, 1.0])).tolist() == [True, False]


def test_why_there_is_no_reference_is_said(tmp_path):
    path = tmp_path / "diamond.py"
    path.write_text(DIAMOND.format(angle=np.pi / 2))
    said = exact.reference(started(str(path)), 1.0, SHORT)
    assert isinstance(said, str)
    assert "the null space of C ends at a singular position" in said
    assert "the placement of the declaration ends at" in said


# Methods of integration --------------------------------------------------------------------------------------------


def test_methods_are_those_that_the_solver_offers():
    assert cases.methods() == METHODS
    assert cases.exactness("rk4", 0.01) == {"solver.step_size": 0.01}
    assert cases.exactness("stiff", 1e-6) == {"solver.relative_tolerance": 1e-6, "solver.absolute_tolerance": 1e-6}
    assert cases.scene(derived("four_bar"), "stiff", "oracle").solver["method"] == "stiff"
    study = Study("particle_on_circle", SMALL)
    study.equations, study._ways = study.derived, {"vm": None, "oracle": None}
    found = [setting for group in study._settings() for setting in group]
    assert {(s.formulation, s.method) for s in found if s.code == "alfmu"} == set(product(FORMULATIONS, METHODS))
    assert {s.control for s in found if s.method == "stiff"} == {"tolerance"}
    assert [s.formulation for s in found[:2]] == ["residual", "residual"]


# The report --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        for module in ("report", "stability"):
            patch.setattr(f"alfmu.studies.{module}.methods", lambda: FEW)
        page = report(["particle_on_circle"], tmp_path_factory.mktemp("report"), effort=SMALL)
    assert page.name == "report.html"
    return page.with_name("report.md")


def test_every_number_of_the_report_stands_in_a_csv_file(written):
    shown = tables(written)
    assert {name for _, name, _, _ in shown} >= {
        *("environment", "reference", "settings", "tolerances", "comparisons", "scenes"),
        *("table_1", "table_1_given", "paper_settings", "counts", "criteria"),
    }
    for _, name, names, lines in shown:
        assert untraced(written, name, names, lines) == [], name
    assert not any(c.isdigit() for c in prose(written))


def test_every_formulation_and_way_is_there_or_listed_as_skipped(written):
    made = rows(written.parent, "errors") + rows(written.parent, "skipped")
    own = {(r["formulation"], r["way"]) for r in made if r["code"] == "alfmu"}
    ways = {way for _, way in own}
    assert {"vm", "oracle"} < ways
    assert any(way.startswith("FMU") for way in ways)
    assert own == {(f, way) for f in FORMULATIONS for way in ways}
    assert {r["method"] for r in made if r["code"] == "SciPy on (9)"} == {"DOP853", "Radau", "BDF"}


PARTS = """
const done = arguments[arguments.length - 1];
const pause = (time) => new Promise((go) => setTimeout(go, time));
const begun = async () => { while (typeof parts === "undefined") await pause(50); };
begun().then(() => Promise.all([...parts].map(make))).then(
  () => setTimeout(() => done([...document.querySelectorAll(".plot")].map((plot) => ({
    lines: plot.querySelectorAll(".scatterlayer .trace").length,
    legend: [...plot.querySelectorAll(".legendtext")].map((text) => text.textContent),
    traces: plot.data.map((d) => [d.name, d.visible ?? true, d.marker.color, d.marker.symbol]),
    titles: plot.layout.annotations.map((a) => a.text),
    buttons: (plot.layout.updatemenus ?? []).flatMap((menu) => menu.buttons.map((b) => b.label)),
  }))), 300),
  (error) => done(String(error)),
);
"""
"""Makes every part of the page once its script has run, and says what its plots show."""


def test_the_page_draws_its_plots_in_a_browser(written, chromium):
    """With legends, one colour and marker an integrator, quantities apart, a film, and nothing said on the console."""
    page = written.with_name("report.html")
    assert page.stat().st_size < 4e6
    text = page.read_text()
    assert not re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', text)  # It needs no network and no other file.
    chromium.get_log("browser")
    chromium.get(page.as_uri())
    plots = chromium.execute_async_script(PARTS)
    assert len(plots) == 3, plots
    looks: dict[str, set[tuple[str, str]]] = {}
    for plot in plots:
        assert plot["lines"] > 0
        shown_ones = {name for name, visible, *_ in plot["traces"] if visible is True}
        assert set(plot["legend"]) == shown_ones
        for name, _, colour, symbol, *_ in plot["traces"]:
            looks.setdefault(re.split(", (?!D|R|B)|: | [(](?!9)", name)[0], set()).add((colour, symbol))
    assert {"rk4", "explicit", "SciPy on (9), DOP853"} <= looks.keys()
    assert all(len(each) == 1 for each in looks.values()), looks
    assert len(set.union(*looks.values())) == len(looks)
    ways, formulations, convergence = plots
    for plot in (ways, formulations):
        assert {f"<b>{x}</b>" for x in (POSITION, REACTION, ENERGY, PHI)} <= set(plot["titles"])
    assert set(ways["buttons"]) == {"all", *(r["way"] for r in rows(page.parent, "errors") if r["code"] == "alfmu")}
    assert any("Python" in name for name, *_ in ways["traces"])
    assert "rk4: order 4.0" in convergence["legend"]
    assert "explicit" in convergence["legend"]
    film = chromium.find_element("css selector", "iframe.film")
    chromium.switch_to.frame(film)
    WebDriverWait(chromium, 60).until(
        lambda b: b.execute_script("return document.querySelectorAll('canvas, svg').length")
    )
    chromium.switch_to.default_content()
    assert errors(chromium) == []


def test_the_page_opens_with_its_picture_and_a_sentence(written):
    """Prose is behind folds, and no table is without numbers."""
    body = written.with_name("report.html").read_text().partition("<main")[2]
    opening = body[: body.index("<details>")]
    assert opening.index("<p>") < opening.index('<div class="plot"')
    (sentence,) = re.findall(r"<p>(.*?)</p>", opening, re.S)
    assert re.match(r"<strong>particle_on_circle</strong>: .* in [\d.]+(e-\d+)? ms\.", sentence)
    assert "Every run is judged" not in opening
    for table in re.findall(r"<table>.*?</table>", body, re.S):
        assert re.search(r"<td[^>]*>-?\d", table), table[:300]


def test_no_line_ends_within_a_number_of_a_page():
    page = Page("numbers")
    page.text("| error | note |\n|---|---|\n| 3.2e-14 | some 1e-3 of it |\n")
    (html,) = page._parts
    assert '<td class="number">3.2e-14</td>' in html
    assert "<td>some 1e-3 of it</td>" in html


def test_maps_that_there_was_no_time_for_are_not_drawn_and_named_beside_those_that_are():
    study = Study("particle_on_circle", QUICK)
    study.files["reference"] = [{"note": "there was no time for one"}]

    def shown(maps: list[dict]) -> str:
        study.maps.rows, page = maps, Page("late")
        _chapter_of_page(page, study)
        return "".join(page._parts)

    html = shown([{"class": stability.NOT_RUN}])
    assert "No cell of a map was run" in html
    assert 'class="map"' not in html
    where = {"across": "step", "down": "factor", "row": "1", "column": "0.1", "cut short": 0}
    classes = {"formulations": "exact", "springs": stability.NOT_RUN}
    study.maps.springs = ["k"]
    html = shown([{**where, "map": title, "class": each} for title, each in classes.items()])
    assert html.count('class="map"') == 1
    assert "There was no time for 1 more: springs." in html
    assert [one.title for one in stability.maps_of(study.maps)] == ["formulations"]


def test_buttons_choose_which_ways_are_shown(written, chromium):
    chromium.get(written.with_name("report.html").as_uri())
    chromium.execute_async_script(PARTS)
    own = "return [...document.querySelectorAll('.plot')[0].querySelectorAll('.legendtext')].map((x) => x.textContent)"
    before = chromium.execute_script(own)
    click = """
    const [way, done] = arguments, plot = document.querySelector(".plot");
    const place = plot.layout.updatemenus[0].buttons.find((b) => b.label === way);
    Plotly.restyle(plot, place.args[0]).then(() => done(true));
    """
    chromium.execute_async_script(click, "oracle")
    after = chromium.execute_script(own)
    assert "rk4, oracle" in after
    assert "rk4, oracle" not in before
    others = [name for name in before if name.startswith("SciPy")]
    assert others
    assert set(others) <= set(after)


def test_maps_have_every_class_in_their_legend_and_say_what_a_cell_is(written):
    text = written.with_name("report.html").read_text()
    legend = re.findall(r'<dt><i style="background:(#\w+)"></i>([^<]+)</dt>', text)
    assert [(name, colour) for colour, name in legend] == list(stability.CLASSES.items())
    cells = re.findall(r'<td[^>]* style="--c:(#\w+)"[^>]* title="([^";]+)', text)
    assert len(cells) == len({(r["map"], r["row"], r["column"]) for r in rows(written.parent, "cells")})
    assert all(stability.CLASSES[name] == colour for colour, name in cells)


def test_what_ran_in_python_is_compared_with_what_ran_in_python(written):
    compared = [r for r in rows(written.parent, "comparisons") if r["other"].startswith("SciPy") and r["ran in"]]
    same, other = ([r for r in compared if (r["ran in"] == "Python") == each] for each in (True, False))
    assert same
    assert other
    assert all(r["alfmu"].endswith("oracle") for r in same)
    assert all(r["ran in"] == "compiled code; the other in Python" for r in other)


def test_every_integrator_has_a_look_of_its_own():
    """Those of alfmu and of other codes, whether they are installed or not."""
    assert LOOKS.keys() == {*METHODS, *(f"{rival.name}, {rival.method}" for rival in RIVALS)}
    assert len({look.colour for look in LOOKS.values()}) == len(LOOKS)


def test_a_time_is_the_fastest_of_enough():
    case = Case({}, TIMES, 10.0, most=20)
    assert not case.enough([0.01, 0.01])
    assert not case.enough([0.01, 0.03, 0.02])
    assert case.enough([0.03, 0.01, 0.0101, 0.05, 0.0102])
    assert case.enough([0.01 * 1.1**i for i in range(20)])
    assert case.enough([2.0])


def test_an_order_is_told_only_where_errors_show_one():
    study = Study("particle_on_circle", SMALL)
    study.floors = {POSITION: 1e-13}

    def order(control: str, values: list[float], errors: list[float]) -> tuple[float | None, str]:
        return study._order(
            [{"control": control, "value": x, POSITION: e, TIME: 1.0} for x, e in zip(values, errors, strict=True)]
        )

    steps = [0.04, 0.02, 0.01]
    assert order("step [s]", steps, [h**4 for h in steps])[0] == pytest.approx(4)
    assert order("step [s]", steps, [1e-12, 1e-13, 1e-12]) == (
        None,
        "too few errors are between the motion lost and the error of the reference",
    )
    assert order("step [s]", steps, [1e-4, 1e-9, 1e-9])[1] == "the errors are not on a straight line"
    assert order("tolerance", steps, [h**4 for h in steps])[1] == "a tolerance chooses the steps"


def test_runs_that_ended_early_are_no_points_of_errors_over_steps():
    """Up to where they came they may be exact, and a run that failed in its first step has no error at all."""
    study = Study("particle_on_circle", SMALL)
    study.floors = {POSITION: 1e-13}
    study.files["reference"] = [{"note": "it is not asked for here"}]
    study.maps.rows = [{"class": stability.NOT_RUN}]
    where = {"code": "alfmu", "formulation": "residual", "way": "vm", "language": "compiled code", "steps": 1}
    ends = {0.1: (0.0, None), 0.05: (1e-3, 1e-3)}
    study.files["errors"] = [
        {**where, "method": "order8", "control": "step [s]", "value": h, POSITION: error, TIME: seconds}
        for h, (error, seconds) in ends.items()
    ]
    drawn = []
    page = Page("early")
    page.plot = lambda figure, about: drawn.append(figure)
    _chapter_of_page(page, study)
    assert [trace["x"] for trace in drawn[-1]["data"]] == [[0.05]]


def test_what_did_not_run_is_summed_up_by_reasons():
    study = Study("particle_on_circle", SMALL)
    setting = Setting("alfmu", "residual", "rk4", "oracle", "step [s]", (0.02, 0.01), 0.02, None, "Python")
    for value in setting.values:
        study._run(setting, value, deadline=0.0)
    (row,) = _skipped([study])
    assert (row["runs"], row["what"]) == (2, "alfmu, residual, rk4, oracle")
    assert row["reason"] == "the time for this mechanism was used up"


def test_orders_errors_and_pictures(written):
    settings = {(r["formulation"], r["way"]): r for r in rows(written.parent, "settings") if r["method"] == "rk4"}
    for way in ("vm", "oracle"):
        row = settings["residual", way]
        assert float(row["order"]) == pytest.approx(4, abs=0.3)
        assert float(row[PHI]) < 1e-13
    assert float(settings["residual", "vm"][POSITION]) == pytest.approx(
        float(settings["residual", "oracle"][POSITION]), rel=1e-3
    )
    error = max(float(r[POSITION]) for r in rows(written.parent, "reference"))
    assert error < min(float(r[POSITION]) for r in settings.values())
    for name in ("particle_on_circle", "particle_on_circle_formulations", "particle_on_circle_stability"):
        assert (written.parent / f"{name}.png").stat().st_size > 20_000
    machine = {r["what"]: r["value"] for r in rows(written.parent, "environment")}
    assert machine["command"] == "`alfmu report particle_on_circle`"
    assert {"processor", "Python", "C compiler", "scipy", "repeats of a run, at most"} < machine.keys()


def test_lost_comparisons_are_listed(written):
    compared = rows(written.parent, "comparisons")
    lost = [r for r in compared if r["result"].startswith("lost")]
    shown = next(lines for _, name, _, lines in tables(written) if name == "comparisons")
    assert sum(line[-1].startswith("lost") for line in shown) == len(lost)
    levels = [r["level or step"] for r in compared if r["what"].startswith("run time to")]
    assert levels == [f"{x:.17g}" for x in LEVELS for _ in range(2)]  # Beside all of alfmu, and beside what is Python.
    slower = [r for r in compared if r["result"] == "lost: slower"]
    assert all(float(r["its value"]) > 2 * float(r["other's value"]) for r in slower)


def test_a_way_that_cannot_be_opened_is_listed(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    study = Study("particle_on_circle", SMALL)
    study.equations = prepared(study.derived)
    study.times, study.judge = TIMES, Judge(study.equations, None)
    study._units, study._ways = {}, study._makers(tmp_path)
    with pytest.MonkeyPatch.context() as patch, ExitStack() as study._stack:
        patch.setenv("ALFMU_CACHE", str(tmp_path / "cache"))
        for way in study._ways:
            study._run(study._setting("residual", "rk4", way), 0.02, np.inf)
    assert {row["way"] for row in study.files["errors"]} == {"vm", "oracle"}
    ways = {row["way"]: row["reason"] for row in study.files["skipped"]}
    assert set(ways) == {"compiled", "FMU (compiled)"}
    assert all("no-such-compiler" in reason for reason in ways.values())


def test_what_would_take_too_long_is_skipped_with_its_estimate():
    study = Study("particle_on_circle", SMALL)
    study.times = TIMES
    study.judge = Judge(prepared(study.derived), None)
    unit = oracle.Instance(prepared(study.derived, "oracle"))
    restart = restarting(unit)

    def once(value: float, case: Case):
        found = run(unit, restart, Case({}, case.times, case.limit))
        found.seconds = [0.002 / value]
        return found

    setting = Setting("alfmu", "residual", "rk4", "oracle", "step [s]", (0.02, 0.01, 0.005), 0.02, once, "Python")
    for value in setting.values:
        study._run(setting, value, deadline=np.inf)
    assert [r["value"] for r in study.files["errors"]] == [0.02, 0.01]
    (skipped,) = study.files["skipped"]
    assert skipped["estimate [s]"] == pytest.approx(0.4)
    assert skipped["reason"] == "it would take too long"
    study._run(setting, 0.02, deadline=0.0)
    assert study.files["skipped"][1]["reason"] == "the time for this mechanism was used up"


@pytest.mark.parametrize("command", ["report", "stability"])
def test_mistakes_are_said_before_anything_runs(command, tmp_path, capsys, monkeypatch):
    assert main([command, "nonsense", "-o", str(tmp_path / "out")]) == 1
    assert "there is no mechanism 'nonsense'; use one of bennett" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").write_text("")
    assert main([command, "particle_on_circle", "-o", str(tmp_path / "file")]) == 1
    assert "cannot write into" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([command, "particle_on_circle"])
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main([command, "particle_on_circle", "-o", str(tmp_path / "out")]) == 1
    assert "pip install 'alfmu[plot]'" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    if command == "report":
        assert main([command, "particle_on_circle", "-o", str(tmp_path / "out")]) == 1
        assert "pip install 'alfmu[report]'" in capsys.readouterr().err


# Other codes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["five_bar", "slider_crank"])
def test_other_codes_run_the_same_mechanism_from_the_same_start(name):
    """With the parameters and start values that it comes with; none but SciPy knows another mechanism."""
    equations, times = prepared(derived(name), "oracle"), np.linspace(0.0, 0.4, 11)
    judge = Judge(equations, exact.reference(started(name), 0.4, SHORT))
    codes = set()
    for rival in RIVALS:
        if rival.missing or rival.method in ("Radau", "BDF"):
            continue
        values = rival.values(name)
        assert list(values) == sorted(values, reverse=True)
        found = rival.run(equations, values[-1], Case({}, times, 20.0))
        errors = judge.errors(found)
        assert found.complete, (rival.name, rival.method, found.failure)
        assert errors[POSITION] < 2e-3, (rival.name, rival.method)
        assert errors[REACTION] < 0.5, (rival.name, rival.method)  # N, of some 60; soft constraints are among them
        assert rival.values("four_bar") or rival.name != "SciPy on (9)"
        codes.add(rival.name)
    assert "SciPy on (9)" in codes


def test_a_code_that_is_not_there_is_listed(monkeypatch):
    monkeypatch.setattr("alfmu.studies.report.RIVALS", [replace(r, missing="not installed") for r in RIVALS])
    study = Study("five_bar", SMALL)
    study.equations = prepared(study.derived)
    study.times, study.judge = TIMES, Judge(study.equations, None)
    study._ways = {}
    for setting in study._settings()[0]:
        study._run(setting, setting.values[0], np.inf)
    assert study.files["errors"] == []
    missing = {(r["code"], r["reason"]) for r in study.files["skipped"]}
    codes = ("SciPy on (9)", "SciPy stabilised", "Pinocchio", "Exudyn", "MuJoCo")
    assert missing == {(name, "not installed") for name in codes}


# The paper ---------------------------------------------------------------------------------------------------------


def covered(picture) -> list[str]:
    """Titles of the panels of a matplotlib figure whose legend lies over a curve, between its points too."""
    picture.draw_without_rendering()
    found = []
    for axes in picture.axes:
        if legend := axes.get_legend():
            box = legend.get_window_extent()
            curves = [line.get_transform().transform_path(line.get_path()) for line in axes.lines]
            if any(curve.intersects_bbox(box, filled=False) for curve in curves):
                found.append(axes.get_title())
    return found


@pytest.mark.parametrize("study", ["table-1", "figure-7", "iterations", "accuracy", "four-bar"])
def test_the_chapters_of_the_paper(study, tmp_path):
    """At their smallest: every table has rows, and what the paper claims stands beside what is measured."""
    effort = replace(paper.QUICK, stop=0.2, counted=0.1, driven=0.4, phases=2)
    mechanism, make = paper.STUDIES[study]
    chapter = make(effort)
    chapter.write(tmp_path)
    assert all(rows(tmp_path, table.name) for table in chapter.tables)
    assert all((tmp_path / name).stat().st_size > 10_000 for name in chapter.pictures)
    if study == "four-bar":
        (picture,) = chapter.pictures.values()
        assert not covered(picture)
    (tmp_path / "chapter.md").write_text("\n\n".join(chapter.markdown("##")))
    assert not any(c.isdigit() for c in prose(tmp_path / "chapter.md"))
    if study == "table-1":
        for row in rows(tmp_path, "table_1"):
            for name in ("ax [m/s2]", "multiplier [N]", "ay [m/s2]"):
                assert float(row[f"{name}, computed"]) == pytest.approx(float(row[f"{name}, closed form"]), rel=1e-6)
    if study == "figure-7":
        for row in rows(tmp_path, "figure_7"):
            assert float(row["angle error [rad]"]) < 1e-5
            assert float(row["Phi [m]"]) < 1e-12
    if study == "iterations":
        assert {r["paper"] for r in rows(tmp_path, "claims")} == {"1 to 3", "at most 2 of each"}
    if study == "accuracy":
        found = {(r["formulation"], float(r["alpha / mass"])): r for r in rows(tmp_path, "accuracy")}
        assert float(found["residual", 1e8]["error of a"]) < 1e-12 < float(found["classic", 1e8]["error of a"])
    if study == "four-bar":
        steps = {
            (r["procedure"], float(r["dt [s]"])): float(r["angle error [rad]"])
            for r in rows(tmp_path, study.replace("-", "_"))
        }
        assert all(steps["residual", dt] < 0.1 * steps["classic", dt] for dt in paper.DRIVEN_STEPS)
    assert mechanism in mechanisms()


def test_a_picture_and_a_table_of_a_report_go_into_a_page(written, tmp_path):
    """Between the markers, and nothing else changes; numbers are those of the report."""
    page = tmp_path / "cost.md"
    arguments = ["cost", str(written.parent), "-o", str(page), "--mechanism", "particle_on_circle"]
    for pictures in script("pictures"):
        page.write_text(f"before\n\n{pictures.BEGIN}\nold\n{pictures.END}\n\nafter\n")
        assert pictures.main(arguments) == 0
        text = page.read_text()
        assert text.startswith("before\n\n" + pictures.BEGIN)
        assert text.endswith(pictures.END + "\n\nafter\n")
        page.write_text("no markers")
        assert pictures.main(arguments) == 1
    assert "old" not in text
    assert "(cost.png)" in text
    row = next(r for r in rows(written.parent, "comparisons") if r["level or step"] == f"{LEVELS[1]:.17g}")
    shown = next(line for line in text.splitlines() if line.startswith("| particle_on_circle")).strip("| ").split(" | ")
    assert float(shown[2]) == pytest.approx(1e3 * float(row["its value"]), rel=0.05)
    assert (tmp_path / "cost.png").stat().st_size > 10_000
    assert page.read_text() == "no markers"


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
def test_the_largest_error_is_within_ten_times_the_tolerance(name, horizon, tolerances, monkeypatch):
    """By `explicit`, from the start with all defaults; the flyball governor is in `test_methods`."""
    for what, value in (("SCIPY", ()), ("compiler", lambda: None)):
        monkeypatch.setattr(f"alfmu.studies.report.{what}", value)
    effort = replace(PROFILES["tolerances"][1], horizon=horizon, tolerances=tolerances, limit=60.0, repeats=1)
    study = Study(name, replace(effort, methods=("explicit",)))
    study.measure(time.perf_counter() + 600.0, iter)
    held = study.files["tolerances"]
    assert [row[cases.TOLERANCE] for row in held] == list(tolerances)
    assert all(row["within ten times"] == "held" and row["error over tolerance"] <= 10 for row in held), held
    assert max(row[POSITION] or 0.0 for row in study.files["reference"]) <= 0.2 * min(tolerances)
    assert all(row["simulated [s]"] == pytest.approx(study.times[-1]) for row in study.files["errors"])
    assert 0.8 * horizon < study.times[-1] <= horizon


def test_the_profile_of_tolerances_has_whole_runs_beside_scipy(tmp_path, monkeypatch):
    monkeypatch.setattr("alfmu.studies.report.compiler", lambda: None)
    effort = replace(
        PROFILES["tolerances"][1], horizon=0.5, tolerances=(1e-5, 1e-7), methods=("explicit", "stiff", "auto")
    )
    page = report(["particle_on_circle"], tmp_path, effort=effort, profile="tolerances", quick=True)
    written = page.with_name("report.md")
    for _, name, names, lines in tables(written):
        assert untraced(written, name, names, lines) == [], name
    machine = {r["what"]: r["value"] for r in rows(tmp_path, "environment")}
    assert machine["command"] == "`alfmu report particle_on_circle --profile tolerances --quick`"
    held = [(r["method"], float(r["tolerance"]), r["within ten times"]) for r in rows(tmp_path, "tolerances")]
    assert sorted(held) == [(method, x, "held") for method in ("auto", "explicit", "stiff") for x in (1e-7, 1e-5)]
    assert {r["method"] for r in rows(tmp_path, "errors") if r["code"] != "alfmu"} == {"DOP853", "Radau", "BDF"}
    for row in rows(tmp_path, "tolerances"):
        over = float(row[POSITION]) / float(row[cases.TOLERANCE])
        assert float(row["error over tolerance"]) == pytest.approx(over, rel=1e-12)
        assert over <= 10
    # `auto` chooses the better method here, and costs at most twice as much as that: in evaluations, which no load of
    # the machine changes.
    automatic = with_defaults(alfmu.derive(alfmu.load("particle_on_circle")), {"solver.method": "auto"})
    decision = prepared(automatic, "oracle").decision
    assert (decision.method, decision.reason.startswith("explicit: the fastest small motion")) == ("explicit", True)
    own = [r for r in rows(tmp_path, "errors") if r["code"] == "alfmu"]
    made = {(r["method"], float(r["value"])): int(r["evaluations"]) for r in own}
    assert all(made["auto", x] <= 2 * min(made["explicit", x], made["stiff", x]) for x in effort.tolerances)
    for row in rows(tmp_path, "comparisons"):
        ratio, mine, other = (float(row[x] or "nan") for x in ("ratio", "its value", "other's value"))
        assert ratio == pytest.approx(other / mine, rel=1e-12, nan_ok=True)
    assert not (tmp_path / "cells.csv").exists()


def test_a_tolerance_is_held_up_to_ten_times():
    own = {"code": "alfmu", "formulation": "residual", "method": "auto", "way": "vm", "control": cases.TOLERANCE}
    study = Study("particle_on_circle", SMALL)
    told = {1e-6: "held", 0.999e-5: "held", 1.001e-5: "not held", None: "not judged"}
    study.files["errors"] = [{**own, "value": 1e-6, POSITION: x, TIME: 0.1, "steps": 9} for x in told]
    study.files["errors"] += [{**own, "value": 1e-6, POSITION: 1e-7, TIME: None, "steps": 9}]
    study.files["errors"] += [{**own, **other} for other in ({"code": "SciPy"}, {"control": cases.STEP})]
    study._tolerances()
    assert [row["within ten times"] for row in study.files["tolerances"]] == [*told.values(), "not judged"]


def test_the_profile_of_the_paper_has_its_chapters_alone(tmp_path):
    effort = replace(SMALL, parts=("paper",))
    page = report(["particle_on_circle", "bennett"], tmp_path, effort=effort, profile="paper")
    text = page.with_name("report.md").read_text()
    assert re.findall("^## (.*)", text, re.M)[0] == "particle_on_circle"
    assert "bennett" not in text
    assert rows(tmp_path, "table_1")
    with pytest.raises(alfmu.InputError, match="is about particle_on_circle, "):
        report(["bennett"], tmp_path, effort=effort, profile="paper")


def test_a_chapter_that_needs_what_is_not_installed_is_listed(monkeypatch):
    monkeypatch.setitem(sys.modules, "mpmath", None)
    monkeypatch.setattr(paper, "STUDIES", {"accuracy": paper.STUDIES["accuracy"]})
    study = Study("five_bar", SMALL)
    study._paper(np.inf)
    assert study.chapters == []
    assert [r["method"] for r in study.files["skipped"]] == ["accuracy"]
    assert "pip install 'alfmu[bench]'" in study.files["skipped"][0]["reason"]
