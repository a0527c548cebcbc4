"""The live page in a browser: its numbers are those of the native FMU, and a person can use it."""

import csv
import io
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from pages import double_click, settle
from selenium import webdriver
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By

import alfmu
from alfmu.cli import main
from alfmu.fmi.drive import Fmu
from alfmu.runtime import build, shipped
from alfmu.simulation import run
from alfmu.view import live, pages, picture, pieces, plane, space
from alfmu.view.scene import scene_of
from alfmu.view.shapes import geometry

pytestmark = pytest.mark.slow

LARGEST = 1_500_000
"""Of a page [bytes]."""

ROUND_OFF = 1e-12
"""Of numbers between 0.1 and 100, where sine and cosine of two C libraries differ in the last digit."""

FIXED = ("slider_crank", "--set", "solver.method=rk4")
"""A page whose steps have a given length: where errors choose it, a last digit changes the steps themselves."""

MONITORS = ("monitor.position_error", "monitor.velocity_error", "monitor.step_error", "monitor.iterations")
"""What is made of round-off alone, so that it need not be the same."""

IN_MOTION = [{"name": "prefers-reduced-motion", "value": "no-preference"}]
"""Those of a person whose pages play by themselves."""


@pytest.fixture
def browser(chromium: webdriver.Chrome) -> Iterator[webdriver.Chrome]:
    """The browser of all tests, where pages play by themselves and have sizes of their own."""
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": IN_MOTION})
    yield chromium
    chromium.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    chromium.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Callable[..., Path]:
    """`written(*FIXED)`: the path of that page, written on first use."""
    folder, pages = tmp_path_factory.mktemp("pages"), {}

    def get(name: str, *more: str) -> Path:
        if (name, *more) not in pages:
            path = pages[name, *more] = folder / f"{len(pages)}_{name}.html"
            assert main(["live", name, "-o", str(path), *more]) == 0
        return pages[name, *more]

    return get


class Page:
    """A page in a browser, as a person has it."""

    def __init__(self, browser: webdriver.Chrome, path: Path, size: tuple[int, int] = (1200, 1000)):
        self.browser = browser
        browser.get_log("browser")
        width, height = size
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        browser.get(path.as_uri())
        self.wait(lambda s: s["ready"])

    def state(self) -> dict:
        return self.browser.execute_script("return alfmu.state()")

    def wait(self, until: Callable[[dict], bool], seconds: float = 60.0) -> dict:
        end = time.monotonic() + seconds
        while not until(state := self.state()):
            assert time.monotonic() < end, state
            time.sleep(0.05)
        return state

    def run_to(self, stop: float) -> None:
        """Run as fast as it goes, and pause at `stop` [s], or where it is already."""
        script = "const done = arguments[1]; alfmu.run(arguments[0]).then(done)"
        assert self.browser.execute_async_script(script, stop)["time"] > stop - 1e-9

    def pause(self) -> None:
        self.browser.execute_script("alfmu.play(false)")
        self.wait(lambda s: not s["busy"] and not s["playing"])

    def table(self) -> tuple[list[str], NDArray]:
        """Names and numbers of what "Save as CSV" writes."""
        names, *rows = csv.reader(io.StringIO(self.browser.execute_script("return alfmu.csv()")))
        return names, np.array(rows, float)

    def drawn(self) -> None:
        """Wait until the page shows what it knows, in the size that it is going to have."""
        for _ in range(200):
            settle(self.browser)
            if not self.browser.execute_script("return picture.settling"):
                return
        raise AssertionError("the picture never comes to rest")

    def picture(self) -> str:
        self.drawn()
        return self.browser.execute_script("return document.getElementById('picture').toDataURL()")

    def text(self, element: str) -> str:
        self.drawn()
        return self.browser.find_element(By.ID, element).text

    def field(self, name: str) -> tuple:
        """Slider and box of a variable."""
        number = self.browser.execute_script(
            "return alfmu.about.variables.findIndex((v) => v.name === arguments[0])", name
        )
        return tuple(self.browser.find_element(By.ID, f"v{number}{end}") for end in ("", "n"))

    def write(self, name: str, text: str) -> str:
        """Write into the box of a variable; what it shows then."""
        _, box = self.field(name)
        box.send_keys(Keys.CONTROL + "a")
        box.send_keys(f"{text}\t")
        return box.get_attribute("value")

    def press(self, key: str) -> None:
        ActionChains(self.browser).send_keys(key).perform()

    def complaints(self) -> list:
        return self.browser.get_log("browser")


@pytest.fixture
def opened(browser, written) -> Iterator[Callable[..., Page]]:
    """`opened(*FIXED)`: its page. Afterwards the browser's console must be empty."""
    pages = []

    def get(name: str, *more: str, **size: tuple[int, int]) -> Page:
        pages.append(Page(browser, written(name, *more), **size))
        return pages[-1]

    yield get
    for page in pages:
        assert page.complaints() == []


def fixed_steps(name: str = FIXED[0], **options: str) -> alfmu.Instance:
    """What the page of FIXED, or that of another mechanism, runs."""
    unit = alfmu.Instance(alfmu.load(name, **options))
    unit.set("solver.method", "rk4")
    return unit


def compared(page: Page, unit, stop: float) -> dict[str, float]:
    """Largest difference of each column up to `stop` [s] from a run of a unit with the page's inputs."""
    names, table = page.table()
    table = table[table[:, 0] <= stop * (1 + 1e-12)]
    driven = {v.name for v in unit.input_variables}
    inputs = {name: (table[:, 0], table[:, i]) for i, name in enumerate(names) if name in driven}
    interval = page.browser.execute_script("return alfmu.about.interval")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", alfmu.AlfmuWarning)
        result = run(unit, stop_time=float(table[-1, 0]), communication_step=interval, inputs=inputs)
    assert ["time", *result.names] == names
    assert np.array_equal(result.time, table[:, 0]), "the page has other communication points"
    size = np.maximum(np.abs(result.values).max(axis=0), 1.0)
    off = (np.abs(result.values - table[:, 1:]) / size).max(axis=0)
    return {name: x for name, x in zip(names[1:], off, strict=True) if name not in MONITORS}


# Numbers --------------------------------------------------------------------------------------------------------------


def test_the_numbers_are_those_of_the_native_fmu(opened, tmp_path):
    """The same scene, communication steps and inputs, one of which a person changes on the way."""
    page = opened(*FIXED)
    page.pause()
    page.press("r")
    page.wait(lambda s: s["rows"] == 1)
    page.run_to(0.1)
    slider, _ = page.field("A.torque")
    slider.send_keys(Keys.ARROW_RIGHT * 40)
    page.run_to(0.4)
    assert "--input slider_crank_inputs.csv" in page.text("command")
    names, table = page.table()
    torque = table[:, names.index("A.torque")]
    assert len(torque) == 21
    assert set(torque[:6]) == {0.0}, "an input counts before it is set"
    assert torque[6] > 0.1, "an input counts from the next communication point on"
    fmu = Fmu(alfmu.export("slider_crank", tmp_path, kind="native", parameters={"solver.method": "rk4"}))
    try:
        off = compared(page, fmu, 0.4)
    finally:
        fmu.close()
    assert len(off) > 40
    assert max(off.values()) < ROUND_OFF, max(off, key=off.get)
    assert table[-1, names.index("monitor.work")] != 0.0


def test_what_it_saves_makes_the_same_run_on_the_command_line(opened, tmp_path):
    """The buttons, and the command that the page gives."""
    page = opened(*FIXED)
    behavior = {"behavior": "allow", "downloadPath": str(tmp_path)}
    page.browser.execute_cdp_cmd("Browser.setDownloadBehavior", behavior)
    page.pause()
    assert not page.browser.find_element(By.ID, "inputs").is_displayed()
    page.write("m3", "2")
    page.write("slider.force", "0.5")
    page.wait(lambda s: s["rows"] == 1 and not s["busy"])
    page.run_to(0.3)
    page.browser.find_element(By.ID, "save").click()
    page.browser.find_element(By.ID, "inputs").click()
    files = [tmp_path / f"slider_crank{end}.csv" for end in ("", "_inputs")]
    end = time.monotonic() + 10
    while not all(file.exists() for file in files):
        assert time.monotonic() < end, list(tmp_path.iterdir())
        time.sleep(0.05)
    saved, stop = alfmu.Result.from_csv(files[0]), page.state()["time"]
    command = page.text("command").replace("slider_crank_inputs.csv", str(files[1])).split()
    again = tmp_path / "again.csv"
    assert main([*command[1:], "--stop-time", f"{stop:.17g}", "-o", str(again)]) == 0
    found = alfmu.Result.from_csv(again)
    assert found.names == saved.names
    keep = [i for i, name in enumerate(saved.names) if name not in MONITORS]
    size = np.maximum(np.abs(saved.values).max(axis=0), 1.0)
    assert np.abs((found.values - saved.values) / size)[:, keep].max() < ROUND_OFF
    assert saved["slider.force"][-1] == 0.5


def test_without_sine_and_cosine_they_are_the_same_bits(opened):
    page = opened("particle_on_circle")
    page.run_to(1.0)
    off = compared(page, alfmu.Instance("particle_on_circle"), 1.0)
    assert set(off.values()) == {0.0}
    _, table = page.table()
    assert np.ptp(table[:, 1:], axis=0).max() > 0.5, "nothing moves"


def test_with_error_control_they_differ_by_no_more_than_a_last_digit_makes(opened):
    """Errors choose the steps by default: the page changes no more than the last digits of the start do."""
    page = opened("slider_crank")
    page.run_to(0.3)
    off = compared(page, alfmu.Instance("slider_crank"), 0.3)
    runs = []
    for digits in range(-3, 4):
        unit = alfmu.Instance("slider_crank")
        start = float(unit.get("start.angle"))
        unit.set("start.angle", start + digits * np.spacing(start))
        runs.append(
            run(unit, stop_time=0.3, communication_step=page.browser.execute_script("return alfmu.about.interval"))
        )
    values = np.array([result.values for result in runs])
    size = np.maximum(np.abs(values[3]).max(axis=0), 1.0)
    responses = dict(zip(runs[0].names, (np.abs(values - values[3]).max(axis=(0, 1)) / size), strict=True))
    for name in off:
        assert off[name] < max(ROUND_OFF, 5 * responses[name]), (name, off[name], responses[name])


def test_parameters_start_values_and_options_of_the_command_line(opened):
    how = ("--set", "m2=2.5", "--set", "start.angle=0.4", "--option", "coordinates=joint", "--step", "0.01")
    page = opened(*FIXED, *how)
    page.run_to(0.3)
    unit = fixed_steps(coordinates="joint")
    unit.set("m2", 2.5)
    unit.set("start.angle", 0.4)
    assert page.browser.execute_script("return alfmu.about.interval") == 0.01
    said = "--option coordinates=joint --set solver.method=rk4 --set m2=2.5 --set start.angle=0.4 --step 0.01"
    assert page.text("command") == f"alfmu simulate slider_crank {said}"
    assert max(compared(page, unit, 0.3).values()) < ROUND_OFF


# Use ------------------------------------------------------------------------------------------------------------------


def test_it_moves_by_itself_and_stops_by_the_keyboard(opened):
    page = opened(*FIXED)
    page.wait(lambda s: s["now"] > 0.1)
    page.press(" ")
    page.wait(lambda s: not s["playing"] and not s["busy"])
    still, begun = page.picture(), page.state()
    time.sleep(0.3)
    assert page.picture() == still
    assert page.state()["now"] == begun["now"]
    page.press(".")
    page.wait(lambda s: s["now"] > begun["now"])
    assert page.picture() != still
    page.press(" ")
    page.wait(lambda s: s["playing"] and s["now"] > begun["now"] + 0.2)
    page.press(" ")
    page.press("r")
    assert page.wait(lambda s: s["rows"] == 1)["now"] == 0.0
    assert page.text("time") == "0.00 s"


def test_sliders_by_arrow_keys_with_unit_and_bounds(opened):
    page = opened(*FIXED)
    page.pause()
    slider, box = page.field("l2")
    assert slider.get_attribute("aria-valuetext") == "1 m"
    assert float(box.get_attribute("min")) == 1e-6
    assert "[m]" in page.browser.find_element(By.CSS_SELECTOR, f"label[for={slider.get_attribute('id')}]").text
    slider.send_keys(Keys.ARROW_RIGHT * 50)
    length = float(box.get_attribute("value"))
    assert length > 1.05
    assert f"--set l2={length:g}" in page.text("command")
    page.wait(lambda s: s["rows"] == 1 and not s["busy"])
    page.run_to(0.2)
    unit = fixed_steps()
    unit.set("l2", length)
    assert max(compared(page, unit, 0.2).values()) < ROUND_OFF
    assert float(page.write("l2", "-1")) == length, "a value out of bounds was taken"


def test_drawn_lengths_follow_their_parameters(opened):
    page = opened(*FIXED)
    page.pause()
    values = page.browser.execute_script("return alfmu.about.variables.map((v) => v.start)")
    names = page.browser.execute_script("return alfmu.about.variables.map((v) => v.name)")
    values[names.index("l2")] = 1.7
    script = """const { parameters, scene } = alfmu.about.picture;
      const g = geometry(parameters.map((p) => ("ref" in p ? arguments[0][p.ref] : p.value)));
      return resolved(scene, g).front.find((part) => part.held && part.at[0].body === 'rod').strokes[0].points"""
    rod = page.browser.execute_script(script, values)
    assert np.ptp(np.array(rod)[:, 0]) == pytest.approx(1.7)


@pytest.mark.parametrize("late", [False, True])
def test_dragging_the_crank_sets_the_start(opened, late):
    """The crank goes where it is dragged, and the motion goes on from there, at rest."""
    page = opened(*FIXED)
    page.pause()
    page.press("r")
    page.wait(lambda s: s["rows"] == 1 and not s["busy"])
    canvas = page.browser.find_element(By.ID, "picture")
    place = "return picture.pixels([arguments[0] * Math.cos(arguments[1]), arguments[0] * Math.sin(arguments[1])])"
    page.wait(
        lambda s: page.browser.execute_script("return Boolean(picture.fit) && !picture.whole && !picture.settling")
    )
    (x0, y0), (x1, y1) = (page.browser.execute_script(place, 0.4, angle) for angle in (np.pi / 4, 1.9))
    box = canvas.rect
    middle = box["width"] / 2, box["height"] / 2
    if late:  # answers of the runtime, so that the pointer is let go before all that it was moved to is answered
        page.browser.execute_script(
            "const { onmessage } = worker; worker.onmessage = (event) => setTimeout(onmessage, 200, event)"
        )
    chain = ActionChains(page.browser, duration=20).move_to_element_with_offset(canvas, x0 - middle[0], y0 - middle[1])
    chain.click_and_hold()
    for share in np.linspace(0.1, 1.0, 10):
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        chain.move_to_element_with_offset(canvas, x - middle[0], y - middle[1])
    chain.release().perform()
    page.wait(lambda s: s["rows"] == 1 and not s["busy"])
    angle, rate = (
        float(page.field(f"start.{name}")[1].get_attribute("value")) for name in ("angle", "angular_velocity")
    )
    assert angle == pytest.approx(1.9, abs=0.02)
    assert rate == 0.0
    exact = float(re.search(r"start\.angle=(\S+)", page.text("command"))[1])
    page.run_to(0.3)
    unit = fixed_steps()
    unit.set("start.angle", exact)
    unit.set("start.angular_velocity", 0.0)
    assert max(compared(page, unit, 0.3).values()) < ROUND_OFF


def test_what_cannot_start_is_said_in_the_words_of_the_runtime(opened):
    page = opened(*FIXED)
    page.pause()
    assert page.write("l2", "0.1") == "0.1"
    page.wait(lambda s: s["failed"])
    unit = fixed_steps()
    unit.set("l2", 0.1)
    with pytest.raises(alfmu.AlfmuError) as error:
        unit.initialize()
    assert page.browser.find_element(By.CSS_SELECTOR, "#said p").text == str(error.value)
    page.browser.find_element(By.ID, "defaults").click()
    page.wait(lambda s: not s["failed"] and s["rows"] == 1)
    assert not page.browser.find_element(By.ID, "said").is_displayed()
    page.run_to(0.1)


def test_a_long_step_keeps_the_page_alive_and_reset_ends_it(opened):
    """A million internal steps of two loops take far longer than the page waits before it says so."""
    page = opened("n_four_bar", *FIXED[1:])
    page.pause()
    page.browser.execute_script("alfmu.set('solver.step_size', 2e-8)")
    page.wait(lambda s: s["rows"] == 1 and not s["busy"])
    page.browser.execute_script("alfmu.play(true)")
    page.wait(lambda s: s["busy"] and "takes long" in page.text("said"))
    page.press("n")
    assert page.browser.find_element(By.ID, "names").get_attribute("aria-pressed") == "true"
    assert page.state()["busy"], "the page answered only when the step was done"
    page.browser.execute_script("alfmu.play(false); alfmu.set('solver.step_size', 0.02)")
    page.wait(lambda s: s["rows"] == 1 and s["ready"] and not s["busy"])
    page.run_to(0.2)
    assert max(compared(page, fixed_steps("n_four_bar"), 0.2).values()) < ROUND_OFF


@pytest.mark.parametrize("width", [320, 390])
def test_a_phone_has_room_for_it(opened, width):
    page = opened(*FIXED, size=(width, 844))
    page.wait(lambda s: s["now"] > 0.1)
    script = "return [document.documentElement.scrollWidth, innerWidth]"
    assert page.browser.execute_script(script) == [width, width]
    wide = """return [...document.querySelectorAll('main *, footer *')]
      .filter((e) => e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.tagName)"""
    assert page.browser.execute_script(wide) == []
    box = page.browser.find_element(By.ID, "play").rect
    assert box["y"] + box["height"] < 844, "the button is below the fold"
    assert box["height"] >= 40


def test_everything_that_can_be_used_has_a_name(opened):
    page = opened(*FIXED)
    nameless = """return [...document.querySelectorAll('button, input, select, canvas')].filter((e) => {
      const label = e.labels && e.labels.length ? e.labels[0].textContent : '';
      return !(label || e.getAttribute('aria-label') || e.textContent.trim());
    }).map((e) => e.outerHTML)"""
    assert page.browser.execute_script(nameless) == []


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_light_and_dark(opened, theme):
    """Text stands out from what is behind it by the 4.5 that accessibility asks for."""
    page = opened(*FIXED)
    page.browser.execute_script("paint(arguments[0])", theme)
    colors = """const style = getComputedStyle(document.documentElement);
      return arguments[0].map((name) => style.getPropertyValue(name).trim())"""
    names = ["--ink", "--soft", "--card", "--page", "--accent", "--on-accent", "--warn", "--warn-card"]
    found = dict(zip(names, page.browser.execute_script(colors, names), strict=True))
    for front, back in (
        *((f"--{a}", f"--{b}") for a in ("ink", "soft") for b in ("card", "page")),
        ("--accent", "--card"),
        ("--on-accent", "--accent"),
        ("--warn", "--warn-card"),
    ):
        assert contrast(found[front], found[back]) >= 4.5, (front, back)


def contrast(front: str, back: str) -> float:
    """Ratio of luminances as WCAG has it, of colours #rrggbb."""

    def luminance(color: str) -> float:
        parts = np.array([int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    bright, dark = sorted((luminance(front), luminance(back)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


RIG = """
import casadi as ca

from alfmu import Mechanism

def rig() -> Mechanism:
    m = Mechanism("rig")
    turn = m.coordinate("turn", "rad", start=0.2, independent=True)
    swing = m.coordinate("swing", "rad", start=-1.0)
    plate = m.body("plate", mass=1.0, inertia=0.1, center=(0.2, 0.1))
    arm = m.body("arm", mass=0.5, inertia=0.05, center=(0.1, 0.0))
    bob = m.bar("bob", mass=0.3, length=0.4)
    m.revolute("A", m.ground.at(0, 0), plate.at(0, 0), coordinate=turn)
    m.weld("W", plate.at(0.5, 0.3), arm.at(0, 0), angle=0.4)
    m.revolute("B", plate.at(0.6, 0.0), bob.start, coordinate=swing)
    m.distance("strut", m.ground.at(1.3, -0.4), bob.end, length=0.6)
    m.spring_damper((m.ground.at(1.2, 0.8), plate.at(0.5, 0.3)), stiffness=20.0, damping=1.0, rest=0.5)
    m.watch("tip", arm.at(0.35, 0))
    r = m.parameter("r", 0.15, "m")
    cog, pin = m.body("cog", mass=0.1, inertia=0.01), m.body("pin", mass=0.1)
    m.revolute("C", m.ground.at(0.4, 0), cog.at(0, 0), coordinate=m.coordinate("spin", "rad"))
    m.prismatic("slide", m.ground.at(0.4, 0), pin.at(0, 0), axis=-1.5, coordinate=m.coordinate("s", "m", start=0.2))
    m.gear("mesh", plate.at(0, 0), cog.at(0, 0), radii=(0.4 - r, r))
    m.cam("nose", cog.at(0, 0), pin.at(0, 0), distance=lambda u: 1.2 * r + 0.03 * ca.cos(u), roller=0.03)
    m.gravity(0, -9.81)
    return m
"""


class Recorded:
    """A surface that keeps what is painted."""

    pushed = np.inf

    def __init__(self) -> None:
        self.lines: list[tuple] = []
        self.texts: list[str] = []

    def stroke(self, points, width, color, filled=False) -> None:
        self.lines.append((np.array(points, float).ravel(), float(width), color, bool(filled)))

    def text(self, text) -> None:
        self.texts.append(text.text)


@pytest.mark.parametrize("name", ["slider_crank", "flexible_four_bar", "rig.py"])
def test_the_page_paints_what_a_drawing_shows(opened, name: str, monkeypatch, tmp_path):
    """Every stroke in its order, to a hundredth of a pixel, and every label, of a picture of the same fit and place."""
    monkeypatch.chdir(tmp_path)
    Path("rig.py").write_text(RIG)
    page = opened(name)
    page.pause()
    page.press("n")
    page.run_to(0.2)
    page.drawn()
    script = """paint('light');
      const { painter } = picture, lines = [], texts = [], { line, text, texts: free } = painter;
      painter.line = (points, width, color, filled = false) => lines.push([points, width, color, Boolean(filled)]);
      painter.text = (said) => texts.push(said);
      painter.texts = (all) => all.forEach((each) => texts.push(each.text)); // before they give way
      picture.trails = picture.trails.map(() => []);
      picture.draw(run.drawn.row);
      Object.assign(painter, { line, text, texts: free });
      return [picture.fit, run.drawn.row, lines, texts]"""
    fit, row, lines, texts = page.browser.execute_script(script)
    names = page.browser.execute_script("return alfmu.about.shown.map((i) => alfmu.about.variables[i].name)")
    shapes = geometry(alfmu.load(name))
    stage = plane.Stage(shapes, plane.View((0.0, 0.0), (1.0, 1.0), tuple(map(tuple, fit["travel"]))), (640, 480))
    stage.fit = plane.Fit(**{**fit, "size": tuple(fit["size"])})
    surface = Recorded()
    stage.paint(surface, dict(zip(names, row, strict=True)), {})
    assert len(lines) == len(surface.lines) > 50
    for (points, width, color, filled), (there, thick, tint, full) in zip(lines, surface.lines, strict=True):
        assert (color, filled) == (tint, full)
        assert width == pytest.approx(thick, abs=0.01)
        assert np.ravel(points) == pytest.approx(there, abs=0.01)
    assert sorted(texts) == sorted(surface.texts)


@pytest.mark.parametrize("name", ["slider_crank", "n_four_bar", "rig.py", "flyball_governor", "bennett"])
def test_traced_numbers_follow_the_parameters(name: str, monkeypatch, tmp_path):
    """The data of a page with numbers for other parameters are those of the mechanism that has them."""
    monkeypatch.chdir(tmp_path)
    Path("rig.py").write_text(RIG)
    m = alfmu.load(name)
    other = {p.name: p.default * (1.01 + 0.003 * i) for i, p in enumerate(m.parameters)}
    symbols, values = ca.vertcat(*(p.symbol for p in m.parameters)), ca.DM(list(other.values()))
    traced, given = geometry(m, traced=True), geometry(m, other)

    def data(shapes, number=float) -> dict:
        if not shapes.space:
            return pages.data_of(scene_of(shapes), 9, number)
        view = picture.view_of(given, {name: [0.1, 1.0] for name in given.columns})
        return pages.data_of({"pieces": pieces.pieces_of(shapes.space, view)}, 9, number)

    found = data(traced, lambda x: float(ca.Function("f", [symbols], [x.expression])(values)))
    assert differences(data(given), found, name) == []
    assert differences(data(geometry(m)), found, name), "nothing follows them"


def differences(expected, found, where: str) -> list[str]:
    """Where a value is not the expected one; what is nothing may be missing."""
    if isinstance(expected, dict):
        pairs = ((key, expected.get(key, 0), found.get(key, 0)) for key in {*expected, *found})
        return [each for key, one, other in pairs for each in differences(one, other, f"{where}.{key}")]
    if isinstance(expected, list) and len(expected) == len(found):
        pairs = enumerate(zip(expected, found, strict=True))
        return [each for i, (one, other) in pairs for each in differences(one, other, f"{where}[{i}]")]
    number = isinstance(expected, int | float) and isinstance(found, int | float)
    same = abs(expected - found) < 1e-8 if number else expected == found
    return [] if same else [f"{where}: {found} instead of {expected}"]


LINKS = """
from alfmu import Mechanism

def links() -> Mechanism:
    m = Mechanism("links")
    a, b = m.parameter("a", 0.5, "m"), m.parameter("b", 0.2, "m")
    plate = m.spatial_body("plate", mass=1.0, inertia=(0.1, 0.1, 0.1), relative=True)
    arm = m.spatial_body("arm", mass=1.0, inertia=(0.1, 0.1, 0.1), relative=True)
    ground = m.spatial_ground
    m.spatial_revolute("A", ground.at(0, 0, 0), plate.at(a, 0, 0), axis=(0, 0, 1), coordinate=m.coordinate("t", "rad"))
    m.spatial_revolute("B", plate.at(0, b, 0), arm.at(0, 0, -a), axis=(1, 0, 0), coordinate=m.coordinate("s", "rad"))
    m.spring_damper((ground.at(0, 0, 1), plate.at(0, -b, 0)), stiffness=10.0, rest=0.5)
    m.gravity(0, 0, -9.81)
    return m
"""


def test_bodies_in_space(opened):
    page = opened("flyball_governor")
    page.wait(lambda s: s["now"] > 0.05)
    page.pause()
    page.run_to(0.2)
    canvas = page.browser.find_element(By.ID, "picture")
    page.drawn()
    still = canvas.screenshot_as_png
    canvas.send_keys(Keys.ARROW_LEFT * 3)
    page.drawn()
    assert canvas.screenshot_as_png != still, "the view does not turn"
    # Where the page shows the hinge of a rod is where its joint on the shaft is.
    script = """const row = run.drawn.row, { mesh } = picture.stage.moving.find(({ piece }) => piece.name === 'hinge1');
      return [mesh.position.toArray(), alfmu.about.picture.frames.shaft.columns.map((c) => row[c])]"""
    hinge, shaft = page.browser.execute_script(script)
    poses = {"shaft": (np.array(shaft[:3]), np.array(shaft[3:]))}
    pivot = next(p for p in geometry(alfmu.load("flyball_governor")).space.pivots if p.name == "hinge1")
    at = pivot.first if pivot.first.frame == "shaft" else pivot.second
    assert hinge == pytest.approx(space.place_of(poses, at), abs=1e-6)


def test_pieces_in_space_follow_the_parameters(opened, monkeypatch, tmp_path):
    """Those of a page whose parameters were changed are those of the mechanism with these values."""
    monkeypatch.chdir(tmp_path)
    Path("links.py").write_text(LINKS)
    page = opened("links.py")
    page.pause()
    page.browser.execute_script("alfmu.set('a', 0.7); alfmu.set('b', 0.3)")
    page.wait(lambda s: s["rows"] == 1 and not s["busy"])
    page.drawn()
    found = page.browser.execute_script("return picture.shown.pieces")
    shapes = geometry(alfmu.load("links.py"), {"a": 0.7, "b": 0.3})
    view = picture.view_of(shapes, {name: [0.0, 1.0] for name in shapes.columns})
    wanted = [piece for piece in pieces.pieces_of(shapes.space, view) if piece.kind != "coil"]
    found = [piece for piece in found if piece["kind"] != "coil"]
    assert [(piece["kind"], piece.get("name", "")) for piece in found] == [(piece.kind, piece.name) for piece in wanted]
    assert "plate" in {piece.kind for piece in wanted}
    for one, other in zip(found, wanted, strict=True):
        there = [[at.get(k, 0.0) for k in "xyz"] for at in one["at"]]
        assert np.array(sorted(there)) == pytest.approx(np.array(sorted([a.x, a.y, a.z] for a in other.at)), abs=1e-9)


# The file -------------------------------------------------------------------------------------------------------------


def test_one_file_without_network(written):
    """No address from elsewhere, and the browser is told to refuse any."""
    text = written(*FIXED).read_text(encoding="utf-8")
    assert len(text) < LARGEST
    assert re.search(r"default-src 'none'", text)
    addresses = set(re.findall(r"https?://[^\s\"'<>)]+", text))
    assert addresses == {"https://github.com/leeoniya/uPlot"}, "uPlot names itself, nothing else"
    loads = re.findall(r"(?:src|href)\s*=\s*[\"']([^\"']*)", text)
    assert set(loads) == {"data:,"}
    assert "Copyright (c) 2022 Leon Sorokin" in text


def test_the_largest_page_is_small(written):
    assert written("flyball_governor").stat().st_size < LARGEST


@pytest.mark.parametrize("name", ["gyroscope", "bennett", "flyball_governor"])
@pytest.mark.parametrize("size", [(1200, 1000), (420, 800)])
def test_what_moves_in_space_stays_in_the_picture(opened, name, size):
    """Points of bodies and their shadows, from wherever they are looked at."""
    page = opened(name, size=size)
    page.run_to(0.4)
    page.drawn()
    out = page.browser.execute_script("""
      const { stage, shown } = picture, { up } = stage;
      let out = 0, moved = 0;
      for (let k = 0; k < 24; k++) {
        const old = stage.camera.position.clone();
        picture.turn(Math.PI / 12, k % 2 ? 0.3 : -0.3);
        picture.draw(run.drawn.row);
        moved += old.distanceTo(stage.camera.position);
        for (const { at } of shown.pieces) {
          for (const place of at.map((a) => stage.place(a))) {
            const foot = place.clone().addScaledVector(up, shown.floor.height - up.dot(place));
            for (const [x, y] of [place, foot].map((p) => stage.pixels(p))) {
              out = Math.max(out, -x, -y, x - picture.width, y - picture.height);
            }
          }
        }
      }
      return [out, moved]""")
    assert out[0] <= 0
    assert out[1] > 0


def test_the_mouse_zooms_and_a_double_click_brings_the_view_back(opened):
    page = opened("bennett")
    page.pause()
    page.drawn()
    far = "return picture.stage.camera.position.distanceTo(picture.stage.controls.target)"
    home = page.browser.execute_script(far)
    canvas = page.browser.find_element(By.ID, "picture")
    ActionChains(page.browser).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, -300).perform()
    page.drawn()
    assert page.browser.execute_script(far) < 0.95 * home
    canvas.send_keys("-" * 12)
    page.drawn()
    assert page.browser.execute_script(far) > 1.1 * home
    double_click(page.browser, canvas)
    page.drawn()
    assert page.browser.execute_script(far) == pytest.approx(home, rel=1e-6)


def test_a_page_in_a_frame_shows_the_picture_alone(written, browser):
    path = written(*FIXED)
    browser.get(path.as_uri() + "#embedded")
    try:
        shown = "return [...document.querySelectorAll(arguments[0])].map((e) => getComputedStyle(e).display !== 'none')"
        assert browser.execute_script(shown, "#picture, #play") == [True, True]
        assert not any(browser.execute_script(shown, "header, footer, #controls, #plots, #readouts"))
        wait = "return alfmu.state().now > 0.1"
        assert any(browser.execute_script(wait) or time.sleep(0.1) for _ in range(300))
        assert browser.execute_script("return document.documentElement.scrollHeight <= innerHeight")
    finally:
        browser.get("about:blank")


def test_the_same_bytes_for_the_same_mechanism(written, tmp_path):
    path = tmp_path / "again.html"
    assert main(["live", "particle_on_circle", "-o", str(path)]) == 0
    assert path.read_bytes() == written("particle_on_circle").read_bytes()


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "rod.py"
    file.write_text(
        "import alfmu\n"
        "def rod():\n"
        "    m = alfmu.Mechanism('rod', 'A <b>rod</b> & its </script> hinge')\n"
        "    th = m.coordinate('th', 'rad', start=0.5, independent=True)\n"
        "    bar = m.bar('bar', mass=1.0, length=1.0)\n"
        "    m.revolute('A', m.ground.at(0, 0), bar.start, coordinate=th)\n"
        "    m.gravity(0, -9.81)\n"
        "    return m\n"
    )
    assert main(["live", "rod.py"]) == 0
    assert "wrote rod_live.html" in capsys.readouterr().out
    text = (tmp_path / "rod_live.html").read_text()
    assert "A &lt;b&gt;rod&lt;/b&gt; &amp; its &lt;/script&gt; hinge" in text
    assert "</script> hinge" not in text
    assert main(["live", "rod.py"]) == 0
    assert "replaced rod_live.html" in capsys.readouterr().out
    (tmp_path / "rod_live.html").write_text("mine")
    assert main(["live", "rod.py"]) == 1
    assert "rod_live.html exists and was not written by alfmu live" in capsys.readouterr().err
    assert main(["live", "rod.py", "-o", "rod.txt"]) == 1
    assert "must end in .html" in capsys.readouterr().err
    assert main(["live", "slider_crank", "--set", "l2=0.1"]) == 1
    assert "the loops cannot be closed" in capsys.readouterr().err
    assert main(["live", "slider_crank", "--set", "l9=0.1"]) == 1
    assert "no input or parameter 'l9'" in capsys.readouterr().err
    assert not (tmp_path / "slider_crank_live.html").exists()


def test_with_few_outputs_the_picture_has_what_it_needs(tmp_path):
    path = tmp_path / "few.html"
    assert main(["live", "slider_crank", "-o", str(path), "--outputs", "crank.angle", "--freeze", "all"]) == 0
    assert '"kind":"plane"' in path.read_text()


def test_without_a_runtime_for_browsers(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(shipped, "there", lambda *which: tmp_path / "nothing")
    monkeypatch.setattr(build, "zig", lambda: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert main(["live", "particle_on_circle", "-o", str(tmp_path / "page.html")]) == 1
    said = capsys.readouterr().err
    assert "the runtime for browsers cannot be built" in said
    assert "install alfmu[compiler]" in said
    assert not (tmp_path / "page.html").exists()


@pytest.mark.skipif(build.zig() is None, reason="ziglang is not installed")
def test_the_runtime_for_browsers_is_built_the_same_twice(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        build.build(build.WEB, tmp_path / name)
    made, again = ((tmp_path / name / build.file_name(build.WEB)).read_bytes() for name in ("a", "b"))
    assert made == again
    assert made.startswith(b"\0asm")
    assert sys.prefix.encode() not in made


def test_functions_in_javascript(browser):
    """Every operation that the page may meet, against CasADi."""
    x = ca.SX.sym("x", 3)
    a, b, c = ca.vertsplit(x)
    expressions = [
        *(f(a) for f in (ca.sin, ca.cos, ca.tan, ca.exp, ca.sqrt, ca.fabs, ca.floor, ca.ceil, ca.tanh, ca.log1p)),
        *(ca.asin(a / 9), ca.acos(a / 9), ca.atan(b), ca.atan2(b, c), ca.fmin(a, b), ca.fmax(a, b), a**b, c**2, 1 / b),
        *(
            ca.if_else(a < b, a, c),
            ca.if_else(ca.logic_and(a > 0, b > 0), b, c),
            ca.sign(c),
            ca.SX(1, 1),
            2 * a - c,
            -b,
        ),
    ]
    function = live.javascript("f", ["x"], [x], expressions)
    for values in ([0.7, -1.3, 2.1], [1.5, 2.5, -3.5]):
        found = browser.execute_script(f"{function} return f(arguments[0]).map((v) => String(Number(v)))", values)
        expected = np.array(ca.Function("f", [x], [ca.vertcat(*expressions)])(values)).ravel()
        np.testing.assert_allclose(np.array(found, float), expected, rtol=1e-14)
