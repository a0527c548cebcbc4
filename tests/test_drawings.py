"""Drawings before anything is simulated: what they show, in pixels, in SVG, in notebooks and in space."""

import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from PIL import Image
from scenes import hinged
from scipy.spatial import ConvexHull

from alfmu import DeclarationError, InputError, Mechanism, load
from alfmu.cli import main
from alfmu.view.drawing import as_data, from_data
from alfmu.view.faces import SIDES, Stage
from alfmu.view.picture import COLORS_OF_ICON, animate, drawing, model_png, view_of
from alfmu.view.shapes import geometry
from alfmu.view.surface import COLORS, PUSHED, WHITE, Text, placed, width_of

SVG = "{http://www.w3.org/2000/svg}"


def natural_four_bar() -> Mechanism:
    """Bars that share points, without a joint: natural coordinates."""
    m = Mechanism("rhomb", "Four bars in natural coordinates")
    bx, by = m.coordinate("bx", "m", start=0.3), m.coordinate("by", "m", start=0.9)
    cx, cy = m.coordinate("cx", "m", start=1.4), m.coordinate("cy", "m", start=1.0)
    points = m.point(0.0, 0.0), m.point(bx, by), m.point(cx, cy), m.point(1.2, 0.0)
    for name, i, length in (("crank", 0, 0.95), ("coupler", 1, 1.1), ("rocker", 2, 1.02)):
        m.bar(name, mass=1.0, length=length, between=points[i : i + 2])
    m.gravity(0.0, -9.81)
    return m


def pins(svg: str) -> list[tuple[float, float]]:
    """Places [pixels, y upwards] of the hinges of a drawing of 640 x 480: white discs."""
    found = ET.fromstring(svg).iter(f"{SVG}circle")
    return [(float(c.get("cx")), 480 - float(c.get("cy"))) for c in found if c.get("fill") == WHITE]


def pixels(image: Image.Image, color: str, within: int = 0) -> np.ndarray:
    rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return np.abs(np.asarray(image.convert("RGB")).astype(int) - rgb).max(axis=2) <= within


def hued(image: Image.Image, color: str) -> np.ndarray:
    """Which pixels have about the hue of a colour, however they are lit."""
    rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)])
    seen = np.asarray(image.convert("RGB")).astype(float)
    wanted, seen = rgb - rgb.mean(), seen - seen.mean(axis=2, keepdims=True)
    sizes = np.linalg.norm(seen, axis=2)
    return (sizes > 20) & (seen @ wanted > 0.985 * sizes * np.linalg.norm(wanted))


# In the plane ---------------------------------------------------------------------------------------------------------


def test_bars_that_share_points_have_pins_there():
    mechanism = natural_four_bar()
    shapes = geometry(mechanism)
    assert [(joint.name, joint.kind) for joint in shapes.joints] == [("", "revolute")] * 4
    drawn = mechanism.draw()
    places = pins(drawn.svg())
    assert len(places) == 4
    ground = sorted(places, key=lambda p: p[1])[:2]
    scale = abs(ground[0][0] - ground[1][0]) / 1.2
    origin = min(ground)
    wanted = [(0.3, 0.9), (1.4, 1.0)]  # the guesses, from which assembly moves them a little
    for x, y in wanted:
        assert min(np.hypot(p[0] - origin[0] - scale * x, p[1] - origin[1] - scale * y) for p in places) < 0.1 * scale
    assert not [joint for joint in geometry(load("slider_crank", coordinates="natural")).joints if not joint.name]


def test_an_svg_and_a_png_show_the_same():
    drawn = load("slider_crank").draw()
    image = drawn.image()
    root = ET.fromstring(drawn.svg())
    assert root.get("viewBox") == "0 0 640 480"
    assert root.find(f"{SVG}title").text == "Slider-crank in absolute coordinates"
    assert {text.text for text in root.iter(f"{SVG}text")} >= {"A", "B", "C", "crank", "rod", "slider", "guide"}
    for x, y in pins(drawn.svg()):
        assert image.getpixel((round(x), round(480 - y))) == (255, 255, 255)
    areas = [part.get("stroke") for part in root.iter() if part.tag in (f"{SVG}polyline", f"{SVG}polygon")]
    for color in COLORS[:3]:
        assert color in areas
        assert pixels(image, color).sum() > 100
    assert drawn.svg() == load("slider_crank").draw().svg()


@pytest.mark.parametrize("name", ["four_bar", "bennett"])
def test_the_icon_of_an_fmu_is_the_drawing(name):
    """In its most frequent colours: edges alone change, and by little, as do shades of bodies in space."""
    drawn = load(name).draw()
    most = COLORS_OF_ICON[drawn.shapes.space is not None]
    assert model_png(load(name)) == drawn.png(most)
    icon, whole = (Image.open(io.BytesIO(x)) for x in (model_png(load(name)), drawn.png()))
    assert len(icon.getcolors()) == most
    apart = np.abs(np.asarray(icon.convert("RGB")).astype(int) - np.asarray(whole)).max(axis=2)
    assert (apart > 0).mean() < 0.02
    assert (apart > 16).mean() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("at", "angle"), [({"angle": 0.7}, 0.7), ({"start.angle": 2.0}, 2.0), ({"th1": -0.5}, -0.5)])
def test_a_drawing_is_at_the_values_that_are_given(at, angle):
    drawn = drawing(load("four_bar"), at)
    assert drawn.columns["link1.angle"] == pytest.approx(angle, abs=1e-9)
    assert drawn.caption == ", ".join(f"{name} = {value:g}" for name, value in at.items())


@pytest.mark.slow
def test_a_dependent_coordinate_holds_and_start_values_give_way():
    mechanism = load("slider_crank", coordinates="joint")
    free = drawing(mechanism)
    drawn = drawing(mechanism, {"th2": 5.5})
    assert drawn.columns["rod.angle"] - drawn.columns["crank.angle"] == pytest.approx(5.5, abs=1e-9)
    assert drawn.columns["slider.y"] == pytest.approx(0.0, abs=1e-12)
    assert drawn.columns["slider.x"] != pytest.approx(free.columns["slider.x"], abs=1e-2)
    assert [len(mechanism.ties), len(mechanism.starts)] == [1, 1]  # nothing is left in the declaration


def test_drawings_that_cannot_be_made_say_why(tmp_path):
    with pytest.raises(InputError, match=r"four_bar: it cannot be drawn at th; did you mean th3, th2 or th1\?"):
        load("four_bar").draw(at={"th": 1.0})
    with pytest.raises(InputError, match="it cannot be drawn at th1 = nan; give a finite number"):
        load("four_bar").draw(at={"th1": float("nan")})
    with pytest.raises(InputError, match=r"a\.pdf: the name of a file for a drawing must end in \.png or \.svg"):
        load("four_bar").draw(tmp_path / "a.pdf")
    assert not list(tmp_path.iterdir())


def test_a_notebook_shows_a_mechanism_and_nothing_where_there_is_nothing_to_show(monkeypatch):
    assert load("four_bar")._repr_svg_() == load("four_bar").draw().svg()
    assert load("four_bar")._repr_png_() is None
    assert Mechanism("empty")._repr_svg_() is None
    m, bar, *_ = hinged("torn", weight=0.0, start=0.5, independent=True)
    m.distance("R", m.ground.at(9.0, 0.0), bar.end, length=1.0)
    assert m._repr_svg_() is None  # it cannot be closed
    many = load("n_four_bar")
    monkeypatch.setattr("alfmu.model.mechanism.QUICK", 3)
    assert many._repr_svg_() is None


def test_the_command_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["draw", "four_bar", "--at", "angle=0.7", "--set", "l=2", "-o", "a.svg", "--size", "800x600"]) == 0
    assert capsys.readouterr().out == "wrote a.svg\n"
    root = ET.fromstring((tmp_path / "a.svg").read_text())
    assert root.get("viewBox") == "0 0 800 600"
    assert "angle = 0.7" in {text.text for text in root.iter(f"{SVG}text")}
    drawn = load("four_bar").draw(at={"angle": 0.7}, parameters={"l": 2.0}, size=(800, 600))
    assert (tmp_path / "a.svg").read_text() == drawn.svg()
    assert main(["draw", "four_bar"]) == 0
    assert capsys.readouterr().out == "wrote four_bar.png\n"
    assert Image.open(io.BytesIO((tmp_path / "four_bar.png").read_bytes())).size == (640, 480)


def test_labels_keep_apart_from_each_other_and_from_pins():
    size, color = (640, 480), "#000000"
    texts = [Text("alpha", 100.0, 100.0, 14.0, color), Text("beta", 104.0, 103.0, 14.0, color)]
    texts += [Text("gamma", 98.0, 95.0, 14.0, color), Text("edge", 2.0, 470.0, 14.0, color)]
    pin = (101.0, 101.0, 6.0)
    moved = placed(texts, size, [pin])
    boxes = [(t.x, t.y, width_of(t.text, t.size) / 2, 0.5 * t.size) for t in moved]
    for i, (x, y, w, h) in enumerate(boxes):
        assert w <= x <= size[0] - w
        assert h <= y <= size[1] - h
        assert abs(x - pin[0]) > w + pin[2] - 0.5 or abs(y - pin[1]) > h + pin[2] - 0.5
        for ox, oy, ow, oh in boxes[i + 1 :]:
            assert abs(x - ox) > w + ow - 0.5 or abs(y - oy) > h + oh - 0.5
    assert placed([*texts[3:], Text("far", 400.0, 300.0, 14.0, color)], size)[1] == Text(
        "far", 400.0, 300.0, 14.0, color
    )


def test_labels_that_others_push_far_off_are_left_out_of_films():
    """Of six in one place those stay that are next to it; a label alone stays anyway."""
    texts = [Text(f"label {i}", 100.0, 100.0, 14.0, "#000000") for i in range(6)]
    alone = Text("alone", 300.0, 300.0, 14.0, "#000000")
    every, some = placed([*texts, alone], (640, 480)), placed([*texts, alone], (640, 480), pushed=PUSHED)
    assert [t.text for t in every] == [*(t.text for t in texts), "alone"]
    assert set(some) < set(every)
    assert {t.text for t in some} >= {"alone"}
    assert 2 <= len(some) - 1 <= 4
    assert all(abs(t.y - 100.0) <= PUSHED * 0.6 * 15 for t in some if t != alone)


# In space -------------------------------------------------------------------------------------------------------------


def slanted() -> Mechanism:
    """Two balls on the ground, one far behind the other, and a platform on three ball joints."""
    m = Mechanism("slanted")
    plate = m.spatial_body("plate", mass=1.0, inertia=(0.1, 0.1, 0.2), position=(0.0, 0.0, 1.0))
    leg = m.spatial_body("leg", mass=1.0, inertia=(0.1, 0.1, 0.01), position=(0.0, 0.0, 0.5))
    m.spherical("S", plate.at(0.0, 0.0, 0.0), leg.at(0.0, 0.0, 0.5))
    m.spherical("G", m.spatial_ground.at(0.0, 0.0, 0.0), leg.at(0.0, 0.0, -0.5))
    m.spring_damper((m.spatial_ground.at(0.5, 0.0, 0.0), plate.at(0.5, 0.0, 0.0)), stiffness=100.0, rest=1.0)
    m.spring_damper((m.spatial_ground.at(-0.3, 0.4, 0.0), plate.at(-0.3, 0.4, 0.0)), stiffness=100.0, rest=1.0)
    m.spring_damper((m.spatial_ground.at(-0.3, -0.4, 0.0), plate.at(-0.3, -0.4, 0.0)), damping=10.0)
    m.gravity(0.0, 0.0, -9.81)
    return m


def test_a_body_in_space_is_a_plate_through_points_of_a_plane():
    from alfmu.view.pieces import pieces_of

    mechanism = slanted()
    shapes, drawn = geometry(mechanism), mechanism.draw()
    pieces = pieces_of(shapes.space, drawn.view)
    (plate,) = [piece for piece in pieces if piece.name == "plate"]
    assert plate.kind == "plate"
    assert sorted((at.x, at.y, at.z) for at in plate.at) == [(-0.3, -0.4, 0.0), (-0.3, 0.4, 0.0), (0.5, 0.0, 0.0)]
    assert [piece.kind for piece in pieces if piece.name == "leg"] == ["rod", "rod"]
    assert sum(piece.kind == "coil" for piece in pieces) == 2
    assert sum(piece.kind == "ball" for piece in pieces) == 2
    assert hued(drawn.image(), COLORS[0]).sum() > 2000  # seen from above, so that its face shows
    assert ET.fromstring(drawn.svg()).tag == f"{SVG}svg"


@pytest.mark.parametrize("name", ["bennett", "flyball_governor"])
def test_a_mechanism_in_space_is_seen_in_perspective(name):
    mechanism = load(name)
    drawn = mechanism.draw()
    image = drawn.image()
    space = drawn.shapes.space
    bodies = [solid.name for solid in space.solids] or [strut.name for strut in space.struts]
    for color in COLORS[: len(bodies)]:
        assert hued(image, color).sum() > 150
    # The picture is filled, and nothing touches its rim.
    rows, columns = np.nonzero(np.any([hued(image, color) for color in COLORS[: len(bodies)]], axis=0))
    assert np.ptp(rows) > 0.3 * 480 or np.ptp(columns) > 0.5 * 640
    assert rows.min() > 5
    assert rows.max() < 475
    assert columns.min() > 5
    assert columns.max() < 635
    assert drawn.png() == mechanism.draw().png()
    assert drawn._repr_svg_() is None
    assert Image.open(io.BytesIO(drawn._repr_png_())).size == (640, 480)


def test_what_is_nearer_hides_what_is_behind():
    """Two crossed bars, at different distances from the camera: the pixel where they cross has the nearer one's hue."""
    from alfmu.view.space import Lens, camera_of

    for near in (0, 1):
        m = Mechanism("crossed")
        for i, (name, ends) in enumerate({"one": ((-1, 0), (1, 0)), "other": ((0, -1), (0, 1))}.items()):
            for k, (x, z) in enumerate(ends):
                m.drawn_joint(f"{name}{k}", (float(x), -0.4 if i == near else 0.4, float(z)))
            m.drawn_bar(name, f"{name}0", f"{name}1")
        x = m.coordinate("x", "m", independent=True)
        m.kinetic_energy(m.rate(x) ** 2 / 2)
        drawn = m.draw()
        camera = camera_of(drawn.view, (640, 480))
        lens = Lens(camera, (640, 480))
        depth = [np.linalg.norm(np.array(camera.eye) - (0.0, -0.4 if i == near else 0.4, 0.0)) for i in (0, 1)]
        front = int(np.argmin(depth))
        # Where the bars cross in the picture, as two lines in pixels.
        a, b = (lens.one(np.array([x, -0.4 if near == 0 else 0.4, 0.0])) for x in (-1.0, 1.0))
        c, d = (lens.one(np.array([0.0, -0.4 if near == 1 else 0.4, z])) for z in (-1.0, 1.0))
        A = np.array([[b[0] - a[0], c[0] - d[0]], [b[1] - a[1], c[1] - d[1]]])
        share, _ = np.linalg.solve(A, np.array(c) - a)
        x, y = np.array(a) + share * (np.array(b) - a)
        image = drawn.image()
        here = hued(image, COLORS[front])[round(480 - y) - 1 : round(480 - y) + 2, round(x) - 1 : round(x) + 2]
        assert here.all()


@pytest.mark.slow
def test_a_gif_of_space_moves(tmp_path):
    from alfmu import simulate

    mechanism = load("flyball_governor")
    animate(mechanism, simulate(mechanism, 0.3, 0.02), tmp_path / "a.gif", fps=10, size=(320, 240))
    film = Image.open(io.BytesIO((tmp_path / "a.gif").read_bytes()))
    assert film.n_frames == 4
    ball = []
    for i in (0, 3):
        film.seek(i)
        rows, columns = np.nonzero(hued(film, COLORS[2]))
        assert len(rows) > 40
        ball.append((rows.mean(), columns.mean()))
    assert np.hypot(*np.subtract(*ball)) > 20


def test_drawn_joints_have_outputs_where_they_move_alone():
    m = load("bennett")
    assert [joint.outputs != () for joint in m.drawn_joints] == [False, True, True, False]
    names = {output.name for output in m.outputs}
    assert {"hinge2.x", "hinge2.axis.z", "hinge3.y"} <= names
    assert "hinge4.x" not in names
    drawn = m.draw()
    place = np.array([drawn.columns[f"hinge2.{k}"] for k in "xyz"])
    assert np.linalg.norm(place) == pytest.approx(0.3, abs=1e-12)  # link 1 is so long
    axis = np.array([drawn.columns[f"hinge2.axis.{k}"] for k in "xyz"])
    assert axis @ [0.0, 0.0, 1.0] == pytest.approx(np.cos(0.7), abs=1e-12)  # and so twisted


def test_wrong_drawn_joints_are_refused():
    m = Mechanism("m")
    with pytest.raises(DeclarationError, match="hinge is drawn as 'hook'; take one of"):
        m.drawn_joint("hinge", (0, 0, 0), kind="hook")
    with pytest.raises(DeclarationError, match="hinge, drawn as revolute, needs an axis"):
        m.drawn_joint("hinge", (0, 0, 0), kind="revolute")
    with pytest.raises(DeclarationError, match="the place of hinge is 2 numbers; give three"):
        m.drawn_joint("hinge", (0, 0))
    m.drawn_joint("end", (0, 0, 0))
    with pytest.raises(DeclarationError, match="end is drawn twice"):
        m.drawn_joint("end", (1, 0, 0))
    with pytest.raises(DeclarationError, match=r"bar is drawn through ende; did you mean end\?"):
        m.drawn_bar("bar", "end", "ende")


@pytest.mark.parametrize("name", ["bennett", "flyball_governor"])
def test_drawings_in_space_are_data(name):
    shapes = geometry(load(name))
    assert from_data(as_data(shapes)) == shapes
    data = as_data(shapes)
    data["space"]["pivots"][0]["first"]["frame"] = "nobody"
    with pytest.raises(ValueError, match="drawing has no body 'nobody'"):
        from_data(data)
    data = as_data(shapes)
    data["space"]["up"] = (0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="direction of no length"):
        from_data(data)
    data = as_data(shapes)
    data["space"]["frames"][0]["columns"] = ("a",)
    with pytest.raises(ValueError, match="drawing has 1 columns"):
        from_data(data)


def test_a_place_in_space_that_is_not_finite_is_named():
    drawn = load("flyball_governor").draw()
    with pytest.raises(InputError, match="the place of rod1 is not finite"):
        view_of(drawn.shapes, {**drawn.columns, "rod1.x": np.nan})
    with pytest.raises(InputError, match=r"a picture needs slider\.e2"):
        view_of(drawn.shapes, {name: x for name, x in drawn.columns.items() if name != "slider.e2"})


def test_what_is_in_the_plane_is_drawn_in_space_beside_bodies_there():
    m = slanted()
    th = m.coordinate("th", "rad", start=0.5, independent=True)
    bar = m.bar("bar", mass=1.0, length=1.0)
    m.revolute("A", m.ground.at(0.0, 0.0), bar.start, coordinate=th)
    shapes = geometry(m)
    assert shapes.links == ()
    assert [frame.kind for frame in shapes.space.frames] == ["body", "body", "plane"]
    image = m.draw().image()
    assert hued(image, COLORS[2]).sum() > 100
    assert re.fullmatch(r"<Drawing of slanted, 640 x 480 pixels>", repr(m.draw()))


def test_shadows_have_the_corners_of_the_convex_hulls():
    """Volumes by Qhull of all corners, and of those that shape a shadow; a rod and a box have fewer."""
    seen = set()
    for name in ("bennett", "bricard", "stewart_platform", "gyroscope"):
        drawn = drawing(load(name))
        stage = Stage(drawn.shapes, drawn.view, drawn.size)
        solid = [piece for piece in stage.pieces if piece.kind != "coil"]
        meshes = [mesh[: len(mesh) // 2] for mesh in stage.meshes if mesh is not None]
        for piece, mesh, outer in zip(solid, meshes, stage.faces.outer, strict=True):
            assert ConvexHull(mesh[outer]).volume == pytest.approx(ConvexHull(mesh).volume, rel=1e-9)
            assert (len(outer) < len(mesh)) == (piece.kind in ("rod", "box")) or len(outer) == len(mesh) == 2 * SIDES
            seen.add(piece.kind)
    assert seen >= {"rod", "box"}
