"""Loops that are carried by a body with four Euler parameters, which flies or turns on a ball joint."""

import math

import numpy as np
import pytest

import alfmu

LINKS = {"a": 1.0, "b": 0.7, "c": 1.2}
"""Masses [kg] of a four-bar on a body of 5 kg."""


def carrier(how: str) -> alfmu.Mechanism:
    """A four-bar of relative bodies on one that flies, or hangs on a ball by its coordinates, or by the body's own."""
    m = alfmu.Mechanism(f"carrier_{how}")
    box = {"mass": 5.0, "inertia": (0.1, 0.12, 0.09)}
    turned = (math.cos(0.2), 0.0, math.sin(0.2), 0.0)
    if how == "ball":
        base = m.spatial_body("base", **box, center=(0.0, 0.0, -0.3), relative=True)
        e = [m.coordinate(f"e{i}", "1", start=x) for i, x in enumerate(turned)]
        m.spherical("S", m.spatial_ground.at(), base.at(), coordinates=e)
        low = -0.3
    else:
        down = (-0.3 * math.sin(0.4), 0.0, -0.3 * math.cos(0.4)) if how == "hung" else (0.0, 0.0, 0.0)
        base = m.spatial_body("base", **box, position=down, attitude=turned)
        if how == "hung":
            m.spherical("S", m.spatial_ground.at(), base.at(0.0, 0.0, 0.3))
        low = 0.0
    a, b, c = (
        m.spatial_body(name, mass=mass, inertia=(0.01, 0.01, 0.01), center=(0.0, 0.0, -0.1), relative=True)
        for name, mass in LINKS.items()
    )
    for name, at, body, rate in (
        ("qa", base.at(0.0, 0.05, low), a, 1.0),
        ("qb", a.at(0.3, 0.0, -0.1), b, None),
        ("qc", base.at(0.1, 0.05, low), c, None),
    ):
        given = {} if rate is None else {"independent": True, "rate": rate}
        m.spatial_revolute(f"j{name}", at, body.at(), axis=(0, 1, 0), coordinate=m.coordinate(name, "rad", **given))
    m.spherical("loop", b.at(0.0, 0.0, -0.4), c.at(0.2, 0.0, -0.5))
    m.gravity(0.0, 0.0, -9.81)
    return m


@pytest.mark.slow
def test_a_loop_that_flies_falls_as_a_whole() -> None:
    """At every attitude the loop is closed, so that Euler parameters have no part in its rows there."""
    run = alfmu.simulate(carrier("free"), 0.4, 0.1, parameters={"solver.relative_tolerance": 1e-10})
    masses = {"base": 5.0, **LINKS}
    centre = np.array(
        [sum(mass * run[f"{name}.{x}"] for name, mass in masses.items()) for x in "xyz"]
    ) / sum(masses.values())  # fmt: skip
    v = np.array([sum(mass * run[f"{name}.v{x}"][0] for name, mass in masses.items()) for x in "xyz"])
    falling = v[:, None] / sum(masses.values()) * run.time - np.outer([0.0, 0.0, 9.81 / 2], run.time**2)
    np.testing.assert_allclose(centre - centre[:, :1], falling, atol=1e-9)
    assert np.ptp(run["jqa.angle"]) > 0.1  # the links move in it


@pytest.mark.slow
def test_a_ball_that_carries_a_loop_by_its_coordinates_or_by_those_of_the_body() -> None:
    """Two sets of coordinates, one with constraints for the ball, move alike."""
    runs = [
        alfmu.simulate(carrier(how), 0.4, 0.1, parameters={"solver.relative_tolerance": 1e-11})
        for how in ("ball", "hung")
    ]
    assert np.ptp(runs[0]["base.x"]) > 0.01
    for name in ("base.x", "base.z", "jqa.angle", "jqb.angle", "c.z"):
        np.testing.assert_allclose(runs[0][name], runs[1][name], atol=2e-9)


@pytest.mark.slow
def test_a_slide_across_a_row_tells_nothing_of_its_unit() -> None:
    """A telescopic leg beside a rod, opened by 1e-5 m, in a plane that turns: across it the slide is round-off."""
    m = alfmu.Mechanism("leg")
    yaw, hip, slide, rod = (
        m.coordinate(name, unit, start=start, independent=name in ("yaw", "hip"))
        for name, unit, start in (
            ("yaw", "rad", 0.9),
            ("hip", "rad", 0.9),
            ("slide", "m", 0.5 + 1e-5),
            ("rod", "rad", 0.4),
        )
    )
    frame, barrel, piston, link = (
        m.spatial_body(name, mass=1.0, inertia=(0.01,) * 3, relative=True)
        for name in ("frame", "barrel", "piston", "link")
    )
    across, ahead = (math.sin(0.9), math.cos(0.9), 0.0), np.array([math.cos(0.9), -math.sin(0.9), 0.0])
    foot = -0.5 * math.sin(0.9) * ahead - [0.0, 0.0, 0.5 * math.cos(0.9)]
    m.spatial_revolute("Y", m.spatial_ground.at(), frame.at(), axis=(0, 0, 1), coordinate=yaw)
    m.spatial_revolute("H", frame.at(0.1, 0.2, -0.3), barrel.at(), axis=across, coordinate=hip)
    m.spatial_prismatic("P", barrel.at(), piston.at(), axis=(0, 0, -1), coordinate=slide)
    m.spatial_revolute("R", frame.at(*([0.1, 0.2, -0.3] + 0.15 * ahead)), link.at(), axis=across, coordinate=rod)
    m.spherical("K", piston.at(), link.at(*(foot - 0.15 * ahead)))
    i = alfmu.Instance(m)
    i.initialize()
    assert i.q[2:] == pytest.approx([0.5, 0.0], abs=1e-12)
