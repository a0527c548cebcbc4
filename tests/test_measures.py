"""Motion of joints, elongation and force of springs, places of markers: against differences and closed forms."""

import math

import casadi as ca
import numpy as np
import pytest
from scenes import ARM, arm, evaluate, readings, started

import alfmu


def state() -> tuple[list[float], list[float]]:
    return [0.35, -0.6], [0.7, -1.2]


def test_measures_are_those_of_places_and_rates():
    """Each angle and place by the poses of bodies, each rate by theirs, each force by the law of a spring."""
    m = arm("coordinates")
    m.measure()
    q, v = state()
    e = alfmu.derive(m)
    y = evaluate(e, q, v, [0.0] * 4)
    assert (y["hinge.angle"], y["hinge.angular_velocity"]) == pytest.approx((q[1], v[1]))
    assert (y["slide.displacement"], y["slide.velocity"]) == pytest.approx((q[0], v[0]))
    assert y["hinge.angular_acceleration"] == pytest.approx(
        y["boom.angular_acceleration"] - y["carriage.angular_acceleration"]
    )
    along = np.array([math.cos(0.4), math.sin(0.4)])
    assert y["slide.acceleration"] == pytest.approx(along @ [y["carriage.ax"], y["carriage.ay"]])
    assert y["slide.spring.elongation"] == pytest.approx(q[0] - 0.2)
    assert y["slide.spring.force"] == pytest.approx(30.0 * (q[0] - 0.2) + 2.0 * v[0])
    assert y["hinge.spring.torque"] == pytest.approx(4.0 * (q[1] - 0.1) + 0.3 * v[1])
    assert not any(name.startswith("hinge.spring4") for name in y)  # Viscous friction is no spring.

    def tip(h: float) -> float:
        """Distance of the spring's points, by the pose of the tip, h [s] later."""
        z = evaluate(e, [x + h * w for x, w in zip(q, v, strict=True)], v, [0.0] * 4)
        c, s = math.cos(z["tip.angle"]), math.sin(z["tip.angle"])
        dx, dy = 0.2 - ARM["tip"][2][0], -ARM["tip"][2][1]
        return math.hypot(z["tip.x"] + c * dx - s * dy - 0.4, z["tip.y"] + s * dx + c * dy - 1.5)

    rate = (tip(1e-5) - tip(-1e-5)) / 2e-5
    assert y["spring3.elongation"] == pytest.approx(tip(0) - 0.5, rel=1e-12)
    assert y["spring3.elongation_rate"] == pytest.approx(rate, rel=1e-8)
    assert y["spring3.force"] == pytest.approx(12.0 * (tip(0) - 0.5) + 0.7 * rate, rel=1e-8)


def test_only_what_is_asked_for_is_measured():
    def names(m: alfmu.Mechanism) -> set[str]:
        return {o.name for o in alfmu.derive(m).outputs}

    plain = names(arm("coordinates"))
    m = arm("coordinates")
    m.measure("hinge", "slide.spring")
    extra = {"angle", "angular_velocity", "angular_acceleration"}
    springs = {"elongation", "elongation_rate", "force"}
    asked = {f"hinge.{x}" for x in extra} | {f"slide.spring.{x}" for x in springs}
    assert names(m) - plain == asked
    m = arm("coordinates")
    strut = m.spring_damper(m.joints[0], stiffness=1.0, name="strut")
    assert names(m) - plain == {f"strut.{x}" for x in springs}
    m.measure(strut)
    assert names(m) - plain == {f"strut.{x}" for x in springs}


def test_the_angle_of_a_hinge_between_natural_bars_counts_its_turns():
    m = alfmu.Mechanism("spinner")
    x, y = m.coordinate("x", "m", start=1.0), m.coordinate("y", "m")
    angle = m.start("angle", 0.5, "rad", rate=40.0)
    bar = m.bar("bar", mass=1.0, length=1.0, between=(m.point(0, 0), m.point(x, y)))
    m.revolute("A", m.ground.at(0, 0), bar.start)
    m.tie(angle, ca.atan2(y, x))
    m.measure("A")
    result = alfmu.simulate(m, 1.0, 0.05)
    assert result["A.angle"][-1] == pytest.approx(40.5, abs=1e-5)


def test_a_place_is_an_expression_in_coordinates():
    m = alfmu.Mechanism("slope")
    x, tilt = m.coordinate("x", "m", start=0.4, independent=True), m.coordinate("tilt")
    block = m.body("block", mass=1.0, inertia=0.1)
    with pytest.raises(alfmu.DeclarationError, match="nothing places block"):
        _ = block.at(0.1, 0).position
    m.prismatic("guide", m.ground.at(0.2, 0.1), block.at(0, 0), axis=0.3, coordinate=x)
    arm = m.bar("arm", mass=1.0, length=0.5)
    m.revolute("A", block.at(0.1, 0.0), arm.start, coordinate=tilt)
    place = ca.vertcat(*arm.end.position, arm.angle)
    at = np.array(ca.Function("f", [x, tilt], [place])(0.7, -0.4)).ravel()
    c, s = math.cos(0.3), math.sin(0.3)
    by_hand = [0.2 + 0.7 * c + 0.1 + 0.5 * math.cos(-0.4), 0.1 + 0.7 * s + 0.5 * math.sin(-0.4), -0.4]
    assert at == pytest.approx(by_hand, rel=1e-14)
    # The end stays on a circle, and its speed is an output.
    ex, ey = arm.end.position
    m.constraint("circle", (ex - 0.9) ** 2 + (ey - 0.1) ** 2 - 0.16)
    m.output("speed", ca.sqrt(m.rate(ex) ** 2 + m.rate(ey) ** 2), "m/s")
    m.watch("end", arm.end)
    y = readings(started(alfmu.derive(m), {"start.x_rate": 0.3}))
    assert math.hypot(y["end.x"] - 0.9, y["end.y"] - 0.1) == pytest.approx(0.4, rel=1e-12)
    assert y["speed"] == pytest.approx(math.hypot(y["end.vx"], y["end.vy"]), rel=1e-12)
    assert y["speed"] > 0.1


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("hing", "arm has no joint or spring hing to measure; did you mean hinge"),
        ("glue", "glue is a weld, which has no single free motion"),
        (3, "takes joints, springs or their names, not 3"),
    ],
)
def test_what_cannot_be_measured_is_refused(asked: object, said: str):
    with pytest.raises(alfmu.DeclarationError, match=said):
        arm("coordinates").measure(asked)


def test_what_belongs_to_no_mechanism_is_refused():
    one, other = arm("coordinates"), arm("coordinates")
    with pytest.raises(alfmu.DeclarationError, match="spring of another mechanism"):
        one.measure(other.springs[0])
    with pytest.raises(alfmu.DeclarationError, match="slide is a joint of another mechanism; arm has slide, hinge"):
        one.measure(other.joints[0])
    with pytest.raises(alfmu.DeclarationError, match="belongs to no mechanism"):
        _ = type(one.ground)("alone", 1.0, 1.0, (0.0, 0.0)).angle


def test_a_mechanism_of_the_gallery_is_measured_from_outside(tmp_path):
    """By a recipe: what `alfmu --measure` gives it."""
    from alfmu.fmi.recipe import Recipe

    outputs = {o.name for o in alfmu.derive(Recipe("four_bar", measure="A").declared()).outputs}
    assert {"A.angle", "A.angular_velocity"} <= outputs
    assert "B.angle" not in outputs
    assert "B.angle" in {o.name for o in alfmu.derive(Recipe("four_bar", measure=["all"]).declared()).outputs}


def test_all_joints_are_measured_but_those_whose_names_are_taken():
    """Whoever measures a whole mechanism need not know its outputs."""
    m = alfmu.load("flexible_four_bar")
    m.measure()
    run = alfmu.simulate(m, 0.01, 0.01)
    own = alfmu.simulate("flexible_four_bar", 0.01, 0.01)
    np.testing.assert_array_equal(run["B.angle"], own["B.angle"])
    assert set(own.names) < set(run.names)
