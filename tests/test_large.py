"""Scenes of many coordinates: their start by sparse factors, and the same run by every kind of FMU."""

import casadi as ca
import numpy as np
import pytest
from fmpy import simulate_fmu
from oracles import ode
from scenes import derived, started

import alfmu
from alfmu.equations.evaluation import DENSE
from alfmu.fmi.checks.validation import validate

LOOPS = 30
"""Of rows of four-bars in points: more than DENSE coordinates."""


def row(off: float = 0.0, *, braced: bool = False, dangling: bool = False, both: bool = False) -> alfmu.Equations:
    """Cranks at one angle (1.1 rad, -1 rad/s) side by side, coupled by rods; their ends are guessed off by up to `off`.

    `braced` repeats a rod, so that a constraint is redundant; `dangling` adds a point without mass that one rod holds
    across alone; `both` gives the angle of the last crank as well, 0.2 rad off.
    """
    m = alfmu.Mechanism("row")
    th = m.start("angle", 1.1, "rad", rate=-1.0, rate_name="rate")
    random = np.random.default_rng(0)
    points = []
    for i in range(LOOPS + 1):
        x, y = i + ca.cos(th) + off * random.uniform(-1, 1), ca.sin(th) + off * random.uniform(-1, 1)
        points.append(m.point(m.coordinate(f"x{i}", "m", start=x), m.coordinate(f"y{i}", "m", start=y)))
    m.tie(th, ca.atan2(points[0].y, points[0].x))
    if both:
        last = m.start("last", 1.3, "rad", rate=-1.0, rate_name="last_rate")
        m.tie(last, ca.atan2(points[-1].y, points[-1].x - LOOPS))
    rods = [(f"crank{i}", m.ground.at(i, 0.0), points[i]) for i in range(LOOPS + 1)]
    rods += [(f"coupler{i}", points[i], points[i + 1]) for i in range(LOOPS)]
    rods += [("brace", points[3], points[4])] if braced else []
    for name, *ends in rods:
        m.bar(name, mass=1.0, length=1.0, between=tuple(ends))
    if dangling:
        end = m.point(m.coordinate("xd", "m", start=LOOPS + 1 + ca.cos(th)), m.coordinate("yd", "m", start=ca.sin(th)))
        m.bar("light", mass=0.0, length=1.0, between=(points[-1], end))
    m.gravity(0.0, -9.81)
    return alfmu.derive(m)


@pytest.mark.slow
def test_loops_are_closed_as_near_as_small_ones() -> None:
    """From guesses 5 cm off, to round-off, by corrections of least norm as NumPy's singular values give them."""
    e = row(0.05)
    assert e.n > DENSE
    i = started(e)
    p, s = i.memory["p"], np.array([1.1])
    q = np.array(e.guess(p, s)).ravel()
    for _ in range(20):
        J = np.vstack([np.array(x) for x in (e.gaps_matrix(q, p), e.ties_matrix(q, p, s))])
        q = q - np.linalg.lstsq(J, np.concatenate([np.array(e.gaps(q, p)), np.array(e.ties(q, p, s))]).ravel())[0]
    assert np.abs(np.array(e.gaps(i.q, p))).max() <= 1e-12
    assert np.abs(i.q - q).max() <= 1e-9
    # Rates: no other motion is left.
    assert i.v == pytest.approx(np.tile([np.sin(1.1), -np.cos(1.1)], LOOPS + 1), abs=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(("braced", "redundant"), [(False, 0), (True, 1)])
def test_mobility_of_many(braced: bool, redundant: int) -> None:
    """By pivots: one degree of freedom, and the rod that is there twice."""
    mobility = started(row(braced=braced)).mobility()
    assert (mobility.freedom, mobility.redundant, mobility.freedom_here) == (1, redundant, 1)


@pytest.mark.slow
def test_all_loops_may_part_where_they_are_in_line() -> None:
    """At a singular position C tells so: every loop may leave its parallelogram."""
    assert started(derived("n_four_bar", loops=LOOPS), {"start.angle": 0.0}).mobility().freedom_here == LOOPS + 1


@pytest.mark.slow
def test_start_values_that_contradict_each_other_in_many_coordinates() -> None:
    said = r"row: the loops .* start\.last missed by 0\.01\d+ rad .*; give fewer .* close where start\.last is 1\.1 rad"
    with pytest.raises(alfmu.AssemblyError, match=said):
        started(row(both=True))


@pytest.mark.slow
def test_a_motion_without_mass_is_refused_among_many() -> None:
    """A light rod at the end of the row swings, and nothing holds it: across itself, along y."""
    with pytest.raises(alfmu.AssemblyError, match="row: the motion along yd has no mass and no constraint"):
        started(row(dangling=True))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["python", "native"])
def test_large_scenes_in_every_kind_of_fmu(kind, tmp_path) -> None:
    """105 coordinates: a valid FMU, the motion of the one degree of freedom, the numbers of the library."""
    options, given = {"loops": 17, "coordinates": "absolute"}, {"start.angle": 1.3}
    path = alfmu.export("n_four_bar", tmp_path / "large.fmu", options=options, kind=kind)
    assert validate(path) == []
    names = ["crank1.angle", "crank18.angle", "A12.force.y"]
    arguments = {"stop_time": 0.1, "output_interval": 0.02, "output": names, "start_values": given}
    found = simulate_fmu(str(path), **arguments)
    times = np.asarray(found["time"])

    def rate(x: float, v: float) -> float:
        return -(3 * 17 + 1) / 2 * 9.81 * np.cos(x) / ((4 * 17 + 1) / 3)

    exact = ode.motion(lambda t, x, v: rate(x, v), 1.3, -1.0, times)[:, 0]
    assert max(np.abs(found[name] - exact).max() for name in names[:2]) <= 1e-8
    library = alfmu.simulate(derived("n_four_bar", **options), 0.1, 0.02, parameters=given)
    assert all(np.array_equal(found[name], library[name]) for name in names)
