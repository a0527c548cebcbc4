"""Films as pages, in a browser: what they show of space, how they are turned, what moves."""

import io
from pathlib import Path

import numpy as np
import pytest
from pages import double_click, errors, settle
from PIL import Image
from selenium.webdriver.support.ui import WebDriverWait

from alfmu import load, simulate
from alfmu.view.picture import animate
from alfmu.view.shapes import geometry
from alfmu.view.surface import BACKGROUND, COLORS


@pytest.fixture(scope="module")
def films(tmp_path_factory) -> dict[str, Path]:
    """A page of a mechanism in space by its parts, one declared at the general level, one in the plane."""
    folder, found = tmp_path_factory.mktemp("films"), {}
    for name in ("flyball_governor", "bennett", "five_bar"):
        found[name] = folder / f"{name}.html"
        animate(load(name), simulate(name, 1.0, 0.02), found[name])
    return found


def opened(browser, path: Path, at: float = 0.0) -> None:
    """Show a page, stopped at a time [s]; what others said on the console is forgotten."""
    browser.get_log("browser")
    browser.get(path.as_uri())
    began(browser)
    shown(browser, at)


def began(browser) -> None:
    """Wait until the film draws."""
    WebDriverWait(browser, 30).until(lambda b: b.execute_script("return typeof draw === 'function'"))


def shown(browser, at: float) -> np.ndarray:
    """The picture (rows, columns, 3) at a time."""
    browser.execute_script("playing = false; now = arguments[0]; draw();", at)
    return picture(browser)


def picture(browser) -> np.ndarray:
    """What is on the screen where the film is."""
    settle(browser)
    png = browser.find_element("css selector", "canvas").screenshot_as_png
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)


def hue(image: np.ndarray, color: str) -> np.ndarray:
    """Which pixels have about the hue of a colour, however they are lit."""
    rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    wanted, seen = rgb - rgb.mean(), image - image.mean(axis=2, keepdims=True)
    sizes = np.linalg.norm(seen, axis=2)
    return (sizes > 20) & (seen @ wanted > 0.985 * sizes * np.linalg.norm(wanted))


@pytest.mark.slow
def test_a_film_in_space_shows_every_body_and_moves(chromium, films):
    opened(chromium, films["flyball_governor"])
    first = picture(chromium)
    for color in COLORS[:4]:  # shaft, slider, both rods
        assert hue(first, color).sum() > 60, color
    later = shown(chromium, 0.3)
    assert np.mean(np.abs(first - later).max(axis=2) > 30) > 0.01
    again = shown(chromium, 0.0)
    assert np.mean(np.abs(first - again).max(axis=2) > 30) < 1e-3
    assert errors(chromium) == []


@pytest.mark.slow
def test_a_film_plays_by_itself_and_stops_by_the_space_bar(chromium, films):
    from selenium.webdriver.common.keys import Keys

    opened(chromium, films["flyball_governor"])
    time = "return Number(document.querySelector('input[type=range]').value)"
    body = chromium.find_element("css selector", "body")
    body.send_keys(Keys.SPACE)
    before = chromium.execute_script(time)
    for _ in range(20):
        settle(chromium)
    playing = chromium.execute_script(time)
    assert playing != before
    body.send_keys(Keys.SPACE)
    stopped = chromium.execute_script(time)
    settle(chromium)
    assert chromium.execute_script(time) == stopped
    assert errors(chromium) == []


@pytest.mark.slow
def test_the_mouse_turns_and_zooms_the_view_and_a_double_click_brings_it_back(chromium, films):
    from selenium.webdriver import ActionChains
    from selenium.webdriver.common.actions.wheel_input import ScrollOrigin

    opened(chromium, films["bennett"])
    canvas = chromium.find_element("css selector", "canvas")
    home, eye = picture(chromium), "return stage.camera.position.toArray()"
    place = np.array(chromium.execute_script(eye))
    ActionChains(chromium).move_to_element(canvas).click_and_hold().move_by_offset(120, 30).release().perform()
    turned = np.array(chromium.execute_script(eye))
    assert np.linalg.norm(turned - place) > 0.1 * np.linalg.norm(place)
    assert np.mean(np.abs(picture(chromium) - home).max(axis=2) > 30) > 0.02
    ActionChains(chromium).scroll_from_origin(ScrollOrigin.from_element(canvas), 0, -300).perform()
    zoomed = np.array(chromium.execute_script(eye + ".map((x, i) => x - stage.controls.target.toArray()[i])"))
    target = np.array(chromium.execute_script("return stage.controls.target.toArray()"))
    assert np.linalg.norm(zoomed) < 0.95 * np.linalg.norm(turned - target)
    double_click(chromium, canvas)
    assert np.mean(np.abs(picture(chromium) - home).max(axis=2) > 30) < 1e-3
    assert errors(chromium) == []


@pytest.mark.slow
def test_forces_and_moments_are_arrows_that_can_be_hidden(chromium, films):
    opened(chromium, films["flyball_governor"], 0.5)
    red, box = "#d9534a", chromium.find_element("css selector", "input[name=forces]")
    before = hue(picture(chromium), red).sum()
    box.click()
    assert before - hue(picture(chromium), red).sum() > 100  # one rod is red as well
    most = chromium.execute_script("return film.most.force")
    result = simulate("flyball_governor", 1.0, 0.02)
    sizes = [np.sqrt(sum(result[f"{joint}.force.{k}"] ** 2 for k in "xyz")) for joint in ("bearing", "guide", "hinge1")]
    assert most == pytest.approx(max(x.max() for x in sizes), rel=1e-9)
    length = """return arrows.find(({ arrow }) => arrow.name === "hinge1" && arrow.kind === "force").shaft.scale.z"""
    box.click()
    at = int(np.argmin(np.abs(result.time - 0.5)))
    wanted = chromium.execute_script("return 0.3 * extent") * sizes[2][at] / most
    unit = chromium.execute_script("return unit")
    assert chromium.execute_script(length) == pytest.approx(wanted - 1.5 * unit, rel=2e-3)
    assert errors(chromium) == []


@pytest.mark.slow
def test_reactions_at_a_pole_are_heads_alone(chromium, tmp_path):
    """As plots have an arrow and a gap there; what a motor applies stays as it is."""
    result = simulate("flyball_governor", 0.4, 0.02, inputs={"bearing.torque": lambda t: 1.0})
    result.values[10, result.names.index("monitor.singular")] = 2
    animate(load("flyball_governor"), result, tmp_path / "a.html")
    shafts = """playing = false; now = arguments[0]; shows.moments.checked = true; draw();
      return arrows.filter(({ group }) => group.visible).map(({ arrow, shaft }) => [arrow.role, shaft.visible])"""
    chromium.get((tmp_path / "a.html").as_uri())
    began(chromium)
    for at, whole in ((0.16, True), (0.2, False), (0.24, True)):
        found = chromium.execute_script(shafts, at)
        assert {tuple(each) for each in found} == {("reaction", whole), ("applied", True)}
    assert "heads alone where reactions have a pole" in chromium.find_element("css selector", "#shows span").text
    assert errors(chromium) == []


def test_a_piece_is_where_the_result_puts_it(chromium, films):
    """The middle of the first rod's ball in pixels, against the camera by hand."""
    opened(chromium, films["flyball_governor"], 0.4)
    result = simulate("flyball_governor", 1.0, 0.02)
    i = int(np.argmin(np.abs(result.time - 0.4)))
    place = [float(result[f"rod1.{k}"][i]) for k in "xyz"]
    found = chromium.execute_script(
        """const of = ({ piece }) => piece.kind === "ball" && piece.name === "rod1";
        return stage.moving.find(of).mesh.position.toArray()"""
    )
    assert found == pytest.approx(place, abs=2e-4)
    x, y, _ = chromium.execute_script("return stage.pixels(vector(arguments[0]))", place)
    chromium.execute_script("shows.names.checked = false; draw()")  # a name may be over it
    image = picture(chromium)
    scale = image.shape[1] / 640
    rows, columns = (slice(int(v) - 3, int(v) + 4) for v in ((480 - y) * scale, x * scale))
    assert hue(image[rows, columns], COLORS[2]).mean() > 0.9


@pytest.mark.slow
def test_names_in_space_keep_apart(chromium, films):
    opened(chromium, films["flyball_governor"], 0.25)
    boxes = chromium.execute_script(
        """
        const kept = [], old = apart;
        apart = (boxes, pins, size) => { kept.push(...old(boxes, pins, size)); return boxes; };
        draw();
        apart = old;
        return kept;
        """
    )
    assert len(boxes) == 8
    overlaps = [
        (a, b)
        for i, a in enumerate(boxes)
        for b in boxes[i + 1 :]
        if min(a[2] + b[2] - abs(a[0] - b[0]), a[3] + b[3] - abs(a[1] - b[1])) > 0.5
    ]
    assert overlaps == []


@pytest.mark.slow
def test_a_film_in_the_plane_is_one_small_file_without_a_library(chromium, films):
    assert films["five_bar"].stat().st_size < 60_000
    opened(chromium, films["five_bar"], 0.6)
    image = picture(chromium)
    for color in COLORS[:4]:
        assert hue(image, color).sum() > 200
    assert np.mean(np.abs(image - shown(chromium, 0.9)).max(axis=2) > 30) > 0.005
    assert errors(chromium) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flyball_governor", "bennett", "five_bar"])
def test_a_film_fits_a_phone(chromium, films, name):
    chromium.set_window_size(390, 800)
    try:
        opened(chromium, films[name])
        wide = chromium.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
        assert wide[0] <= wide[1]
        background = np.array([int(BACKGROUND[i : i + 2], 16) for i in (1, 3, 5)])
        assert np.mean(np.abs(picture(chromium) - background).max(axis=2) > 30) > 0.01
        assert errors(chromium) == []
    finally:
        chromium.set_window_size(640, 620)


@pytest.mark.slow
def test_pages_ask_for_nothing_from_elsewhere(films):
    for path in films.values():
        text = path.read_text(encoding="utf-8")
        assert text.count("http") == text.count("http://www.w3.org/1999/xhtml")
        assert "{{" not in text.replace("{{}", "")
        assert not any(tag in text for tag in ("<link", "<script src", "import(", "@import"))


def test_the_library_of_the_page_is_the_pinned_one():
    import json

    root = Path(__file__).parents[1]
    pinned = json.loads((root / "scripts" / "three" / "package.json").read_text())["dependencies"]["three"]
    bundle = (root / "alfmu" / "view" / "vendor" / "three.min.js").read_text(encoding="utf-8")
    assert bundle.startswith(f"/* three.js {pinned}, MIT licence")
    assert f'"{pinned.split(".")[1]}"' in bundle  # the revision that it knows itself by
    assert "Permission is hereby granted" in (root / "alfmu" / "view" / "vendor" / "three.LICENSE").read_text()


def test_what_a_film_shows_of_space_is_in_its_shapes():
    space = geometry(load("flyball_governor")).space
    assert [frame.name for frame in space.frames] == ["shaft", "slider", "rod1", "rod2"]
    assert {pivot.name: pivot.kind for pivot in space.pivots} == {
        "bearing": "revolute",
        "guide": "prismatic",
        "hinge1": "revolute",
        "hinge2": "revolute",
    }
    assert [strut.kind for strut in space.struts] == ["spring-damper"] * 2
    assert space.up == (0.0, 0.0, 1.0)
    slider = next(solid for solid in space.solids if solid.name == "slider")
    assert slider.box == pytest.approx((0.05,) * 3)  # half of its edge, from its mass and inertia
    assert {arrow.name for arrow in space.arrows if arrow.role == "applied"} == {"bearing.torque", "slider.force"}
    bennett = geometry(load("bennett")).space
    assert [strut.name for strut in bennett.struts] == ["link1", "link2", "link3"]
    assert [pivot.kind for pivot in bennett.pivots] == ["revolute"] * 4
