"""Pictures: geometry in numbers, pixels where the links are, animations that play, plots that name what they show."""

import json
import math
import re
import shutil
import subprocess
import sys
from io import BytesIO
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from PIL import Image

from alfmu import DeclarationError, InputError, Instance, Mechanism, Result, derive, load, simulate
from alfmu.view import picture
from alfmu.view.picture import animate, draw, model_png, view_of
from alfmu.view.plot import COLORS as OF_LINES
from alfmu.view.plot import figure, plot
from alfmu.view.shapes import Anchor, geometry
from alfmu.view.surface import COLORS

SLIDER_CRANKS = [
    {"coordinates": coordinates, "rod": rod}
    for coordinates in ("absolute", "joint", "mixed", "natural")
    for rod in ("right", "left")
]


def pendulum() -> Mechanism:
    """A bob on an arm of length l, with its tip as a dot."""
    m = Mechanism("pendulum", "A bob </script> on an arm")
    l = m.parameter("l", 2.0, "m")
    th = m.coordinate("th", "rad", start=0.5, independent=True)
    bob = m.body("bob", mass=1.0, inertia=0.1, center=(0.0, -l))
    m.revolute("A", m.ground.at(1.0, 0.0), bob.at(0.0, 0.0), coordinate=th)
    m.gravity(0.0, -9.81)
    m.output("tip.x", 1.0 + l * ca.sin(th), "m")
    m.output("tip.y", -l * ca.cos(th), "m")
    m.output("push.x", th, "rad")  # not a place
    return m


def bench() -> Mechanism:
    """Every symbol once: plate, weld, rod, spring, damper, spiral, slot, inclined guide on a moving body."""
    m = Mechanism("bench")
    a = m.coordinate("a", "rad", start=0.2, independent=True)
    s = m.coordinate("s", "m", start=0.3, independent=True)
    b = m.coordinate("b", "rad", start=2.0)
    plate = m.body("plate", mass=1.0, inertia=0.1, center=(0.3, 0.2))
    tag = m.body("tag", mass=0.1, inertia=0.1)
    block = m.body("block", mass=0.1, inertia=0.1)
    arm = m.bar("arm", mass=1.0, length=0.4)
    A = m.revolute("A", m.ground.at(0.0, 0.0), plate.at(0.0, 0.0), coordinate=a)
    m.weld("W", plate.at(0.8, 0.0), tag.at(0.0, 0.0))
    m.prismatic("P", plate.at(0.1, 0.1), block.at(0.0, 0.0), axis=0.5, offset=0.05, angle=0.2, coordinate=s)
    m.revolute("B", plate.at(0.2, 0.6), arm.start, coordinate=b)
    m.distance("R", m.ground.at(-0.6, 0.9), arm.end, length=0.7)
    m.spring_damper((m.ground.at(1.2, -0.6), plate.at(0.8, 0.0)), stiffness=50.0, damping=1.0, rest=0.7)
    m.spring_damper((tag.at(0.1, 0.0), block.at(0.0, 0.0)), damping=1.0)
    m.spring_damper(A, stiffness=3.0)
    m.friction(A, 0.1)
    return m


def bar_on_hinge(angle: float) -> Mechanism:
    m = Mechanism("rod")
    th = m.coordinate("th", "rad", start=angle, independent=True)
    m.revolute("A", m.ground.at(0.0, 0.0), m.bar("bar", mass=1.0, length=1.0).start, coordinate=th)
    return m


def outputs_at_start(mechanism: Mechanism) -> dict[str, float]:
    instance = Instance(derive(mechanism))
    instance.initialize()
    return {v.name: instance.get(v.name) for v in instance.outputs}


def colored(image: Image.Image, color: str) -> np.ndarray:
    """Which pixels (row, column) have a colour."""
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return np.all(np.asarray(image.convert("RGB")) == rgb, axis=2)


def box(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Left, top, width, height of the pixels of a mask."""
    rows, columns = np.nonzero(mask)
    return columns.min(), rows.min(), np.ptp(columns) + 1, np.ptp(rows) + 1


# Geometry -----------------------------------------------------------------------------------------------------------


def test_geometry_of_the_five_bar():
    shapes = geometry(load("five_bar"))
    assert [link.name for link in shapes.links] == ["link1", "link2", "link3", "link4"]
    assert all(link.kind == "bar" for link in shapes.links)
    assert set(shapes.links[0].points) == {(-0.5, 0.0), (0.5, 0.0), (0.0, 0.0)}
    assert set(shapes.links[1].points) == {(-0.5, 0.0), (0.5, 0.0)}
    assert {j.name: j.kind for j in shapes.joints} == dict.fromkeys("ABCDEF", "revolute")
    joints = {j.name: j for j in shapes.joints}
    assert joints["A"].first == Anchor("ground", 0.0, 0.0)
    assert joints["D"].first == Anchor("ground", 1.0, 0.0)
    assert (joints["E"].first, joints["E"].second) == (Anchor("link1", 0.0, 0.0), Anchor("link4", -0.5, 0.0))
    assert not shapes.guides
    assert not shapes.ties
    assert not shapes.dots
    assert shapes.columns[:4] == ["link1.x", "link1.y", "link1.angle", "link2.x"]


def test_geometry_follows_parameters_and_ignores_the_rest_of_a_run():
    shapes = geometry(load("five_bar"), {"l": 3.0, "start.angle": 0.4, "solver.formulation": "residual"})
    assert set(shapes.links[1].points) == {(-1.5, 0.0), (1.5, 0.0)}
    assert shapes.joints[3].first == Anchor("ground", 3.0, 0.0)


@pytest.mark.parametrize("options", SLIDER_CRANKS, ids=lambda o: "-".join(o.values()))
def test_slider_crank_looks_the_same_in_all_coordinates(options):
    mechanism = load("slider_crank", **options)
    shapes = geometry(mechanism)
    assert shapes == geometry(load("slider_crank"))
    assert [(link.name, link.kind) for link in shapes.links] == [("crank", "bar"), ("rod", "bar"), ("slider", "block")]
    (guide,) = shapes.guides
    assert (guide.base, guide.axis, guide.rider, guide.block) == (
        Anchor("ground", 0.0, 0.0),
        0.0,
        Anchor("slider", 0.0, 0.0),
        0.0,
    )
    picture = Image.open(BytesIO(model_png(mechanism)))
    left = {name: box(colored(picture, color))[0] for name, color in zip(("crank", "rod"), COLORS, strict=False)}
    assert (left["rod"] > left["crank"]) == (options["rod"] == "right")


def test_geometry_of_every_symbol():
    shapes = geometry(bench())
    links = {link.name: link for link in shapes.links}
    assert {name: link.kind for name, link in links.items()} == {
        "plate": "bar",
        "tag": "bar",
        "block": "block",
        "arm": "bar",
    }
    assert (-0.3, -0.2) in links["plate"].points
    (guide,) = shapes.guides
    assert guide.base.x == pytest.approx(0.1 - 0.3 - 0.05 * math.sin(0.5))
    assert guide.base.y == pytest.approx(0.1 - 0.2 + 0.05 * math.cos(0.5))
    assert guide.axis == 0.5
    assert guide.block == pytest.approx(0.3)
    assert [(tie.name, tie.kind) for tie in shapes.ties] == [
        ("R", "rod"),
        ("", "spring-damper"),
        ("", "damper"),
        ("", "spiral"),
    ]
    assert shapes.ties[0].first == Anchor("ground", -0.6, 0.9)


def test_a_body_on_one_joint_is_a_mass_on_an_arm_and_outputs_are_dots():
    shapes = geometry(pendulum(), {"l": 3.0})
    (link,) = shapes.links
    assert (link.kind, link.points) == ("mass", ((0.0, 3.0), (0.0, 0.0)))
    assert shapes.dots == ("tip",)
    assert geometry(load("particle_on_circle")).dots == ("particle",)


def test_a_pin_in_a_slot_has_a_guide_without_a_block():
    m = Mechanism("slotted")
    a, x = (m.coordinate(n, u, start=s, independent=True) for n, u, s in (("a", "rad", 1.0), ("x", "m", 0.2)))
    crank, yoke = m.bar("crank", mass=1.0, length=0.5), m.body("yoke", mass=1.0, inertia=0.1)
    m.revolute("A", m.ground.at(0.0, 0.0), crank.start, coordinate=a)
    m.prismatic("bed", m.ground.at(0.0, -0.9), yoke.at(0.0, 0.0), coordinate=x)
    m.point_on_line("slot", yoke.at(0.0, 0.9), crank.end, axis=math.pi / 2)
    bed, slot = geometry(m).guides
    assert bed.block == 0.0
    assert slot.block is None
    assert slot.rider == Anchor("crank", 0.25, 0.0)


def test_geometry_in_more_than_parameters_is_refused():
    m = bar_on_hinge(0.0)
    x = m.coordinate("x", "m")
    m.distance("R", m.ground.at(x, 0.0), m.bodies[0].end, length=1.0)
    with pytest.raises(DeclarationError, match="rod: a shape uses x; it may use parameters only"):
        geometry(m)


# One frame ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("angle", "wide"), [(0.0, True), (math.pi / 2, False)])
def test_a_bar_is_drawn_where_it_is(angle, wide):
    mechanism = bar_on_hinge(angle)
    image = draw(geometry(mechanism), outputs_at_start(mechanism))
    assert image.size == (640, 480)
    left, top, width, height = box(colored(image, COLORS[0]))
    scale = (640 if wide else 480) - 150  # pixels per metre: the bar of 1 m fills the picture but for its margins
    x, y = 320, 240 - 8  # its middle
    if wide:
        assert left + width == pytest.approx(x + scale / 2 + 7, abs=2)  # the free end, rounded
        assert top + height / 2 == pytest.approx(y, abs=1)
        hinge = x - scale // 2, y
    else:
        assert top == pytest.approx(y - scale / 2 - 7, abs=2)
        assert left + width / 2 == pytest.approx(x, abs=1)
        hinge = x, y + scale // 2
    assert max(width, height) == pytest.approx(scale, abs=4)  # the hinge hides the other end
    assert min(width, height) == pytest.approx(14, abs=2)
    assert image.getpixel(hinge) == (255, 255, 255)


@pytest.mark.slow
def test_axes_are_equal_and_the_view_holds_the_motion():
    mechanism = load("slider_crank")
    shapes = geometry(mechanism)
    result = simulate(mechanism, 2.0, 0.02)
    view = view_of(shapes, {name: result[name] for name in shapes.columns})
    assert view.high[0] == pytest.approx(result["slider.x"].max())
    assert view.low[1] == pytest.approx(min(0.0, 2 * result["crank.y"].min()))
    assert view.travel == ((pytest.approx(result["slider.x"].min()), pytest.approx(result["slider.x"].max())),)
    now = {name: float(result[name][0]) for name in shapes.columns}
    square = draw(shapes, now, (600, 600), view)
    twice = draw(shapes, now, (1200, 1200), view)
    areas = [colored(image, COLORS[1]).sum() for image in (square, twice)]
    assert areas[1] == pytest.approx(4 * areas[0], rel=0.05)


def test_trails_and_captions_are_drawn():
    mechanism = load("particle_on_circle")
    shapes, now = geometry(mechanism), outputs_at_start(mechanism)
    turns = np.linspace(0.0, 2 * math.pi, 100)
    circle = {"particle.x": np.cos(turns), "particle.y": np.sin(turns)}
    view = view_of(shapes, circle)
    plain = draw(shapes, now, view=view)
    trail = draw(shapes, now, view=view, trails={"particle": list(zip(*circle.values(), strict=True))})
    _, _, width, height = box(colored(trail, COLORS[0]))
    assert width == pytest.approx(height, abs=12)
    assert width > 300 > 20 > box(colored(plain, COLORS[0]))[2]
    captioned = draw(shapes, now, view=view, caption="t = 1 s")
    changed = np.any(np.asarray(captioned) != np.asarray(plain), axis=2)
    left, top, width, height = box(changed)
    assert (left + width, top + height) < (120, 60)


@pytest.mark.slow
def test_missing_and_endless_columns_are_named():
    mechanism = load("five_bar")
    shapes, now = geometry(mechanism), outputs_at_start(mechanism)
    with pytest.raises(InputError, match=r"five_bar: a picture needs link1\.angle; the result must hold all outputs"):
        draw(shapes, {name: x for name, x in now.items() if name not in ("link1.angle", "link4.x")})
    with pytest.raises(InputError, match="the place of link2 is not finite"):
        draw(shapes, {**now, "link2.y": math.nan})


# The picture of a model -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["five_bar", "four_bar", "slider_crank", "particle_on_circle"])
def test_model_png_is_the_same_each_time(name):
    data = model_png(load(name))
    assert data == model_png(load(name))
    assert data == model_png(load(name), equations=derive(load(name)))
    image = Image.open(BytesIO(data))
    assert (image.format, image.size, image.info) == ("PNG", (640, 480), {})
    shapes = geometry(load(name))
    for color in COLORS[: len(shapes.links) + len(shapes.dots)]:
        assert colored(image, color).sum() > 100


def test_links_that_hide_each_other_are_shown_apart():
    flat = Image.open(BytesIO(model_png(load("five_bar"))))  # all links are aligned at the start
    _, _, _, height = box(colored(flat, COLORS[0]))
    assert height > 200
    assert model_png(load("five_bar"), {"start.angle": 1.0}) != model_png(load("five_bar"))  # without the caption
    _, _, _, height = box(colored(Image.open(BytesIO(model_png(bar_on_hinge(0.0)))), COLORS[0]))
    assert height < 20  # nothing to show apart


def test_model_png_follows_parameters():
    assert model_png(load("slider_crank"), {"l1": 0.2}) != model_png(load("slider_crank"))


@pytest.mark.parametrize("declare", [pendulum, bench])
def test_a_users_own_mechanism_has_a_picture(declare):
    image = Image.open(BytesIO(model_png(declare(), size=(800, 400))))
    assert image.size == (800, 400)
    assert colored(image, COLORS[0]).sum() > 500


def test_a_mechanism_without_shapes_has_a_picture_that_says_so():
    m = Mechanism("bare")
    x = m.coordinate("x", "m", start=1.0, independent=True)
    m.kinetic_energy(m.rate(x) ** 2 / 2)
    assert np.asarray(Image.open(BytesIO(model_png(m)))).min() < 200
    with pytest.raises(InputError, match=r"bare has nothing to draw; it needs bodies, or outputs NAME\.x"):
        animate(m, simulate(m, 0.1, 0.02), "bare.gif")


# Animations -----------------------------------------------------------------------------------------------------------


class Columns(dict):
    """What `animate` needs of a result, from anywhere."""

    def __init__(self, time: np.ndarray, columns: dict[str, np.ndarray]):
        super().__init__(columns)
        self.time, self.names = time, list(columns)


def frames_of(path: Path) -> tuple[int, list[int], Image.Image]:
    """Number of frames, duration of each [ms], and the file itself."""
    film = Image.open(BytesIO(path.read_bytes()))
    durations = []
    for i in range(film.n_frames):
        film.seek(i)
        durations.append(film.info["duration"])
    return film.n_frames, durations, film


@pytest.mark.slow
def test_a_gif_plays_at_its_speed_for_ever(tmp_path):
    mechanism = load("five_bar")
    result = simulate(mechanism, 1.0, 0.05)
    seen = []

    def progress(instants):
        for t in instants:
            seen.append(t)
            yield t

    animate(mechanism, result, tmp_path / "a.gif", fps=20, size=(320, 240), progress=progress)
    count, durations, film = frames_of(tmp_path / "a.gif")
    assert (count, set(durations), film.info["loop"], film.size) == (21, {50}, 0, (320, 240))
    assert seen == pytest.approx([i * 0.05 for i in range(21)])
    animate(mechanism, result, tmp_path / "slow.gif", fps=20, speed=0.5, size=(320, 240))
    count, durations, _ = frames_of(tmp_path / "slow.gif")
    assert count == pytest.approx(41, abs=1)
    assert sum(durations) == 2050
    animate(mechanism, result, tmp_path / "again.gif", fps=20, size=(320, 240))
    assert (tmp_path / "again.gif").read_bytes() == (tmp_path / "a.gif").read_bytes()


def test_frames_of_a_gif_show_the_motion(tmp_path):
    mechanism = bar_on_hinge(0.0)
    angle = np.array([0.0, math.pi / 2])
    columns = {"bar.x": np.cos(angle) / 2, "bar.y": np.sin(angle) / 2, "bar.angle": angle}
    result = Columns(np.array([0.0, 1.0]), columns)
    animate(mechanism, result, tmp_path / "a.gif", fps=2)
    count, durations, film = frames_of(tmp_path / "a.gif")
    assert (count, durations) == (3, [500, 500, 500])
    boxes = []
    for i in (0, 2):
        film.seek(i)
        pixels = np.asarray(film.convert("RGB")).astype(int)
        target = [int(COLORS[0][k : k + 2], 16) for k in (1, 3, 5)]
        boxes.append(box(np.abs(pixels - target).max(axis=2) < 12))
    assert boxes[0][2] > 10 * boxes[0][3]
    assert boxes[1][3] > 10 * boxes[1][2]


@pytest.mark.slow
def test_a_long_gif_has_a_limited_number_of_frames(tmp_path, monkeypatch):
    monkeypatch.setattr(picture, "MAX_FRAMES", 75)
    mechanism = bar_on_hinge(0.0)
    time = np.linspace(0.0, 6.0, 2001)
    columns = {"bar.x": np.cos(time) / 2, "bar.y": np.sin(time) / 2, "bar.angle": time}
    result = Columns(time, columns)
    animate(mechanism, result, tmp_path / "a.gif", size=(96, 72))
    count, durations, _ = frames_of(tmp_path / "a.gif")
    assert 75 / 2 < count <= 76
    assert sum(durations[1:]) == 6000  # [ms]: the last one is shown as long as the others


def data_of(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1])


def test_a_page_holds_everything_it_needs(tmp_path):
    mechanism = load("slider_crank", coordinates="natural")
    result = simulate(mechanism, 1.0, 0.02)
    animate(mechanism, result, tmp_path / "a.html", speed=0.3)
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "http" not in page
    assert "{{" not in page
    assert "Slider-crank in natural coordinates" in page
    data = data_of(page)
    assert data["time"] == pytest.approx(result.time)
    x, y, angle = data["poses"]["rod"]
    pixel = 1 / data["fit"]["scale"]
    assert np.abs(x - result["rod.x"]).max() < 0.01 * pixel
    assert np.abs(y - result["rod.y"]).max() < 0.01 * pixel
    assert np.abs(angle - result["rod.angle"]).max() < 1e-4
    assert data["speed"] == 0.3
    assert {label.get("text") for label in data["scene"]["labels"]} >= {
        "A",
        "B",
        "C",
        "guide",
        "crank",
        "rod",
        "slider",
    }
    assert len(page) < 60_000
    animate(mechanism, result, tmp_path / "b.html", speed=0.3)
    assert (tmp_path / "b.html").read_text(encoding="utf-8") == page


BROWSER = """
const calls = {};
const context = new Proxy({ measureText: () => ({ width: 10 }) }, {
  get: (own, name) => own[name] ?? ((...values) => (calls[name] ??= []).push(values)),
  set: () => true,
});
const elements = {};
function element(tag) {
  return elements[tag] ??= { textContent: content, clientWidth: 640, listeners: {}, getContext: () => context, add() {},
    addEventListener(name, listener) { this.listeners[name] = listener; }, classList: { toggle() {} }, value: "2" };
}
const document = { getElementById: element, querySelector: element, addEventListener() {},
  documentElement: { style: { setProperty() {} } } };
const matchMedia = () => ({ matches: false }), devicePixelRatio = 1;
let frame;
const requestAnimationFrame = (next) => { frame = next; };
class ResizeObserver { constructor(listener) { this.observe = listener; } }
class Option {}
"""
"""As much of a browser as a page needs to draw."""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("node") is None, reason="no JavaScript outside a browser here")
def test_the_script_of_a_page_draws_what_pillow_draws(tmp_path):
    mechanism = load("five_bar")
    result = simulate(mechanism, 1.0, 0.02)
    animate(mechanism, result, tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    script = page[page.index('"use strict"') : page.rindex("</script>")]
    play = "frame(0); calls.arc = []; frame(50); console.log(JSON.stringify([calls.arc, elements.output.value]));"
    program = tmp_path / "page.js"
    content = f"const content = {json.dumps(json.dumps(data_of(page)))};"
    program.write_text(content + BROWSER + script + play, encoding="utf-8")
    run = subprocess.run(["node", str(program)], capture_output=True, text=True, check=True)
    discs, shown = json.loads(run.stdout)
    assert shown == "0.10 s / 1.00 s"  # 50 ms at twice the speed
    angle, fit = result["link1.angle"][5], data_of(page)["fit"]
    hinges = [(0, 0), (math.cos(angle), math.sin(angle))]
    for place in hinges:
        pixels = [o + fit["scale"] * x for o, x in zip(fit["origin"], place, strict=True)]
        assert min(math.dist(pixels, disc[:2]) for disc in discs) < 0.05


def test_a_page_escapes_what_a_user_wrote_and_carries_dots(tmp_path):
    mechanism = pendulum()
    result = simulate(mechanism, 0.5, 0.02)
    animate(mechanism, result, tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "A bob &lt;/script&gt; on an arm" in page
    assert page.count("</script>") == 2
    data = data_of(page)
    assert data["dots"] == ["tip"]
    assert data["poses"]["tip"][0] == pytest.approx(result["tip.x"], abs=1e-4)


def test_an_animation_follows_the_parameters_of_the_run(tmp_path):
    mechanism = load("slider_crank")
    result = simulate(mechanism, 0.5, 0.02, parameters={"l1": 0.2})
    animate(mechanism, result, tmp_path / "a.html", parameters={"l1": 0.2})
    data = data_of((tmp_path / "a.html").read_text(encoding="utf-8"))
    at = [a for label in data["scene"]["labels"] if label.get("text") == "crank" for a in label["at"]]
    assert sorted(a["x"] for a in at) == pytest.approx([-0.1, 0.1])


def test_animations_that_cannot_be_written_say_why(tmp_path):
    mechanism = load("five_bar")
    result = simulate(mechanism, 0.1, 0.02)
    with pytest.raises(InputError, match=r"film\.mp4: the name of a file for a film must end in \.gif or \.html"):
        animate(mechanism, result, tmp_path / "film.mp4")
    for wrong in ({"fps": 0}, {"speed": math.inf}):
        with pytest.raises(InputError, match=f"five_bar: {next(iter(wrong))} is .*above zero"):
            animate(mechanism, result, tmp_path / "a.gif", **wrong)
    little = simulate(mechanism, 0.1, 0.02, outputs=["link1.x", "link1.y", "link1.angle", "link2.x"])
    with pytest.raises(InputError, match=r"a picture needs link2\.y; the result must hold all outputs of bodies"):
        animate(mechanism, little, tmp_path / "a.html")
    assert not list(tmp_path.iterdir())


# Plots ----------------------------------------------------------------------------------------------------------------


def panels_of(drawn) -> dict:
    """Axes of a figure by what their vertical axis says."""
    return {axes.get_ylabel(): axes for axes in drawn.axes}


def legend_of(axes) -> list[str]:
    return [text.get_text().replace("\n", " ") for text in axes.get_legend().get_texts()]


def test_a_plot_has_few_panels_of_what_moves():
    result = simulate("five_bar", 1.0, 0.02)
    drawn = figure(result)
    panels = panels_of(drawn)
    assert list(panels) == ["angle [rad]", "position [m]", "force [N]", "error [m, rad; per s]"]
    assert drawn.get_suptitle() == "five bar"
    assert panels["error [m, rad; per s]"].get_yscale() == "log"
    assert panels["error [m, rad; per s]"].get_xlabel() == "time [s]; forces at points of 0.02 s"
    (line,) = panels["angle [rad]"].get_lines()  # links 2 and 4 never turn, links 1 and 3 turn alike
    assert line.get_label() == "link1.angle = link3.angle"
    np.testing.assert_array_equal(line.get_ydata(), result["link1.angle"])
    np.testing.assert_array_equal(line.get_xdata(), result.time)
    forces = panels["force [N]"].get_lines()
    sizes = np.hypot(result["A.force.x"], result["A.force.y"])
    assert forces[0].get_label() == "|A.force| = |D.force|"
    np.testing.assert_allclose(forces[0].get_ydata(), sizes, rtol=1e-12)


@pytest.mark.slow
def test_every_column_is_shown_or_counted_in_the_caption():
    for name in ("five_bar", "flexible_four_bar", "flyball_governor", "particle_on_circle"):
        result = simulate(name, 0.5, 0.02)
        drawn = figure(result)
        caption = drawn._supxlabel.get_text().replace("\n", " ")
        shown = [part for axes in drawn.axes for label in legend_of(axes) for part in label.split(" = ")]
        columns = [part for part in shown if not part.startswith("|")]
        smaller, _, rest = caption.partition("Also in the result: ")
        partly = re.findall(r"[\w|]+[.][\w.|]+", smaller) if smaller else []
        more = re.search(r"and (\d+) more", smaller)
        sizes = [part for part in (*shown, *partly) if part.startswith("|")]
        counted = [int(number) for number in re.findall(r"(\d+) [a-z]", rest)]
        assert not more or not sizes or all(part in shown for part in sizes)
        total = len(columns) + len([p for p in partly if not p.startswith("|")]) + (int(more[1]) if more else 0)
        assert total + sum(counted) == len(result.names), name


def test_what_a_panel_has_no_room_for_is_named():
    result = simulate("flexible_four_bar", 0.5, 0.02)
    drawn = figure(result)
    positions = panels_of(drawn)["position [m]"]
    assert len(positions.get_lines()) == 6
    ranges = {name: np.ptp(result[name]) for name in result.names if result.units[name] == "m"}
    shown = {part for label in legend_of(positions) for part in label.split(" = ")}
    caption = drawn._supxlabel.get_text().replace("\n", " ")
    dropped = re.findall(r"[\w.]+[.][xy]\b", caption)
    assert dropped
    assert not shown & set(dropped)
    assert max(ranges[name] for name in dropped) <= min(ranges[name] for name in shown)


def test_names_and_patterns_choose_lines_by_unit():
    result = simulate("five_bar", 0.2, 0.02)
    drawn = figure(result, ["link*.angle", "multiplier[[]2]", "multiplier[1]", "link1.angle", "monitor.iterations"])
    assert [legend_of(axes) for axes in drawn.axes] == [
        ["link1.angle = link3.angle", "link2.angle = link4.angle"],
        ["multiplier[2]", "multiplier[1]"],
        ["monitor.iterations"],
    ]
    assert drawn.axes[2].get_ylabel() == "value [dimensionless]"
    assert drawn._supxlabel is None  # nothing that was asked for is left out
    with pytest.raises(InputError, match="the result of five_bar has no column like 'link9"):
        figure(result, ["link1.x", "link9.*"])


@pytest.mark.slow
def test_all_that_is_named_is_shown():
    result = simulate("flyball_governor", 0.1, 0.02)
    drawn = figure(result, ["*"])
    shown = [part for axes in drawn.axes for label in legend_of(axes) for part in label.split(" = ")]
    assert sorted(shown) == sorted(result.names)


def test_lines_that_run_close_to_each_other_differ_in_more_than_colour():
    result = simulate("five_bar", 1.0, 0.02)
    time = result.time
    values = np.column_stack([np.sin(time), np.sin(time) + 0.01, np.cos(time), np.sin(time) + 1e-5])
    close = Result(
        "close", time, ["a.x", "b.x", "c.x", "d.x"], dict.fromkeys(("a.x", "b.x", "c.x", "d.x"), "m"), values
    )
    (axes,) = figure(close, ["*"]).axes
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert list(lines) == ["a.x = d.x", "b.x", "c.x"]
    assert [line.get_marker() == "None" for line in lines.values()] == [True, False, True]


def test_drift_of_a_mechanism_without_constraints_is_not_logarithmic():
    result = simulate(bar_on_hinge(0.5), 0.2, 0.02)
    assert "error [m, rad; per s]" not in panels_of(figure(result))
    (axes,) = figure(result, ["monitor.*_error"]).axes
    assert axes.get_yscale() == "linear"


def test_errors_far_below_rounding_make_no_empty_panel():
    """As those of a lock that opens and closes: a scale down to rounding would show none of them."""
    time, error = np.linspace(0, 1, 11), "monitor.velocity_error"
    tiny = Result("tiny", time, ["bar.angle", error], {"bar.angle": "rad"}, np.column_stack([time, 1e-35 * time]))
    assert [axes.get_ylabel() for axes in figure(tiny).axes] == ["angle [rad]"]
    (axes,) = figure(tiny, [error]).axes
    assert axes.get_yscale() == "linear"


def test_what_turns_round_does_not_hide_what_swings():
    time = np.linspace(0.0, 10.0, 101)
    names = ["crank.angle", "wheel.angle", "arm.angle", "rod.angle", "rod.x"]
    values = np.column_stack([6 * time, -3 * time, np.sin(time), 0.2 * np.cos(time), 0.1 * np.sin(time)])
    result = Result("turning", time, names, dict.fromkeys(names, "rad") | {"rod.x": "m"}, values)
    for drawn in (figure(result), figure(result, ["*"])):
        assert [legend_of(axes) for axes in drawn.axes] == [names[2:4], names[:2], names[4:]]
        assert [axes.get_ylabel() for axes in drawn.axes] == ["angle [rad]", "angle [rad]", "position [m]"]
    few = Result("turning", time, names[:2], dict.fromkeys(names[:2], "rad"), values[:, :2])
    assert len(figure(few).axes) == 1
    motion = simulate("slider_crank", 4.0, 0.02, inputs={"A.torque": 20.0})  # its crank turns round many times
    panels = [axes.get_ylabel() for axes in figure(motion).axes]
    assert panels == ["angle [rad]", "angle [rad]", "position [m]", "force [N]", "error [m, rad; per s]"]


def test_errors_are_points_and_multipliers_begin_with_the_first_colour():
    drawn = figure(simulate("five_bar", 0.5, 0.02), ["monitor.*_error", "multiplier*"])
    multipliers, errors = drawn.axes[-2:]
    assert errors.get_yscale() == "log"
    assert {line.get_linestyle() for line in errors.get_lines()} == {"None"}
    assert multipliers.get_lines()[0].get_color() == OF_LINES[0]
    assert multipliers.get_lines()[0].get_linestyle() == "-"


def test_rounding_is_not_blown_up():
    (energy,) = figure(simulate("particle_on_circle", 1.0, 0.02), ["monitor.energy"]).axes
    low, high = energy.get_ylim()
    assert high - low > 0.9e-6
    assert low < 0.5 < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "suffix", "start"),
    [
        ("slider_crank", "png", b"\x89PNG"),
        ("particle_on_circle", "svg", b"<?xml"),
        ("particle_on_circle", "pdf", b"%PDF"),
    ],
)
def test_plots_are_written(tmp_path, name, suffix, start):
    path = tmp_path / f"a.{suffix}"
    plot(simulate(name, 0.2, 0.02), path)
    assert path.read_bytes().startswith(start)
    assert path.stat().st_size > 5000


def test_plots_that_cannot_be_written_say_why(tmp_path, monkeypatch):
    result = simulate("particle_on_circle", 0.1, 0.02)
    with pytest.raises(InputError, match=r"a\.bmp: the name of a file for a plot must end in \.png, \.svg or \.pdf"):
        plot(result, tmp_path / "a.bmp")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"install it with: pip install 'alfmu\[plot\]'"):
        plot(result, tmp_path / "a.png")


@pytest.mark.slow
def test_pictures_need_no_matplotlib_and_plots_leave_its_state_alone():
    code = """
import sys, alfmu, alfmu.view.picture, alfmu.view.plot
assert "matplotlib" not in sys.modules
alfmu.view.plot.figure(alfmu.simulate("five_bar", 0.1))
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_pole_is_a_gap_and_an_arrow():
    """A driven four-bar that starts with its links aligned has one there, of which a table has the finite part."""
    result = simulate("four_bar", 1.0, 0.02, inputs={"A.torque": 4.0})
    poles = result["monitor.singular"] == 2
    assert poles.any()
    axes = panels_of(figure(result, ["A.force.x", "link1.angle"]))["force [N]"]
    line, arrows = axes.get_lines()
    np.testing.assert_array_equal(np.isnan(line.get_ydata()), poles)
    np.testing.assert_array_equal(arrows.get_xdata(), result.time[poles])
    assert set(arrows.get_ydata()) == {1.0}  # at the upper edge of the panel
