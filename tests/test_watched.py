"""Points of bodies that are watched: their outputs in the plane and in space, and what pictures make of them."""

import math

import numpy as np
import pytest

from alfmu import DeclarationError, Mechanism, derive, simulate
from alfmu.view.picture import drawing
from alfmu.view.shapes import geometry


def arm(length: float = 0.8) -> Mechanism:
    """A bar on a hinge with a tip that stands off it."""
    m = Mechanism("arm")
    angle = m.coordinate("angle", "rad", start=0.3, rate=1.5, independent=True)
    bar = m.bar("bar", mass=1.0, length=length)
    m.revolute("A", m.ground.at(0.2, 0.1), bar.start, coordinate=angle)
    m.watch("tip", bar.at(length, 0.1), "the tip")
    m.gravity(0, -9.81)
    return m


def test_a_point_in_the_plane_has_its_place_and_velocity():
    result = simulate(arm(), 1.0, 0.01)
    angle, rate = result["bar.angle"], result["bar.angular_velocity"]
    x = 0.8 * np.cos(angle) - 0.1 * np.sin(angle)
    y = 0.8 * np.sin(angle) + 0.1 * np.cos(angle)
    for name, expected in (("x", 0.2 + x), ("y", 0.1 + y), ("vx", -y * rate), ("vy", x * rate)):
        assert np.abs(result[f"tip.{name}"] - expected).max() < 1e-12, name
    assert result.units["tip.x"] == "m"
    assert result.units["tip.vy"] == "m/s"


@pytest.mark.slow
def test_a_point_in_space_has_three_components():
    m = Mechanism("top")
    body = m.spatial_body("body", mass=1.0, inertia=(0.1, 0.1, 0.1), position=(0.5, 0.0, 0.0))
    m.spatial_revolute("A", m.spatial_ground.at(), body.at(-0.5, 0, 0), axis=(0, 1, 0))
    m.watch("end", body.at(0.5, 0.2, 0.0))
    m.gravity(0, 0, -9.81)
    result = simulate(m, 0.5, 0.01, outputs=["end.*", "A.*"])
    angle, rate = result["A.angle"], result["A.angular_velocity"]
    assert abs(angle[-1]) > 0.5
    expected = {"x": np.cos(angle), "y": 0.2 + 0 * angle, "z": -np.sin(angle)}
    expected |= {"vx": -np.sin(angle) * rate, "vy": 0 * angle, "vz": -np.cos(angle) * rate}
    for name, values in expected.items():
        assert np.abs(result[f"end.{name}"] - values).max() < 1e-9, name


def test_the_former_name_declares_the_same():
    m = arm()
    m.trace("middle", m.bodies[0].at(0.4))
    assert [point.name for point in m.watched] == ["tip", "middle"]
    assert {"middle.x", "middle.vy"} <= {v.name for v in derive(m).outputs}


def test_a_picture_holds_the_trail_and_everything_else_where_it_stands():
    """A cart beside the arm, which runs away by metres, stands in the picture at its start."""
    m = arm()
    cart = m.body("cart", mass=1.0)
    m.prismatic("guide", m.ground.at(), cart.at(), coordinate=m.coordinate("s", "m", rate=5.0, independent=True))
    drawn = drawing(m)
    path = np.array(drawn.trails["tip"])
    assert np.ptp(path, axis=0).min() > 0.5
    assert (drawn.view.low <= path.min(axis=0)).all()
    assert (drawn.view.high >= path.max(axis=0)).all()
    assert drawn.view.high[0] < 1.1
    assert drawn.view.travel == ((0.0, 0.0),)


def test_a_picture_in_space_holds_the_trail_and_everything_else_where_it_stands():
    m = Mechanism("top")
    how = {"mass": 1.0, "inertia": (0.1, 0.1, 0.1), "relative": True}
    body, cart = m.spatial_body("body", **how), m.spatial_body("cart", **how)
    ground, angle = m.spatial_ground.at(), m.coordinate("angle", "rad", start=0.3, independent=True)
    m.spatial_revolute("A", ground, body.at(-0.5, 0, 0), axis=(0, 1, 0), coordinate=angle)
    s = m.coordinate("s", "m", rate=5.0, independent=True)
    m.spatial_prismatic("guide", ground, cart.at(), axis=(1, 0, 0), coordinate=s)
    m.watch("end", body.at(0.5, 0.2, 0.0))
    m.gravity(0, 0, -9.81)
    drawn = drawing(m)
    path = np.array(drawn.trails["end"])
    assert np.ptp(path[:, 0]) > 0.5
    assert np.ptp(drawn.view.cloud[:, 0]) >= np.ptp(path[:, 0]) - 0.1  # places at some instants alone
    assert drawn.view.extent < 3.0


def test_pictures_show_the_point_and_draw_the_body_as_far():
    shapes = geometry(arm())
    assert shapes.dots == ("tip",)
    (bar,) = shapes.links
    assert (0.4, 0.1) in bar.points  # from the centre of mass


def test_a_rod_in_a_barrel_is_drawn_as_two_bars():
    m = Mechanism("cylinder")
    turn = m.coordinate("turn", "rad", start=0.5, independent=True)
    stroke = m.coordinate("stroke", "m", start=1.5, independent=True)
    barrel, rod = m.bar("barrel", mass=2.0, length=1.0), m.bar("rod", mass=1.0, length=1.0)
    m.revolute("eye", m.ground.at(0, 0), barrel.start, coordinate=turn)
    m.prismatic("slide", barrel.start, rod.end, coordinate=stroke)
    shapes = geometry(m)
    assert shapes.guides == ()
    assert [link.kind for link in shapes.links] == ["bar", "bar"]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (lambda m: m.watch("bar", m.bodies[0].end), "'bar' is a body already"),
        (lambda m: m.watch("p", m.bodies[0]), "takes a point of bar, not the body"),
        (lambda m: m.watch("p", arm().bodies[0].end), "a body of another mechanism"),
        (lambda m: m.watch("p", m.bodies[0].at(math.nan, 0)), "nan"),
    ],
)
def test_what_cannot_be_watched_is_refused(line, message: str):
    with pytest.raises(DeclarationError, match=message):
        line(arm())
