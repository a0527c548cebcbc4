"""The start of a run: assembly, rates, masses; names and numbers that cannot be; what survives a refusal."""

import re
import warnings
from math import cos, degrees, hypot, inf, nan, pi, sin

import casadi as ca
import numpy as np
import pytest
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from scenes import by_rk4, by_the_oracle, derived, readings, refused, started

import alfmu

# Assembly -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("coordinates", "joint"), [("absolute", "B|C"), ("joint", "C"), ("mixed", "B|C"), ("natural", "rod")]
)
@pytest.mark.parametrize("given", [{"l2": 0.3, "start.angle": 1.5}, {"b": 2.0}], ids=["short rod", "high crank"])
def test_impossible_dimensions_name_the_loop_and_the_gap(coordinates: str, joint: str, given: dict) -> None:
    """How far the rod, at its best, stays from its joint [m]; where both its ends are torn off, half of it at each."""
    e = derived("slider_crank", coordinates=coordinates)
    height = given.get("b", 0.0) + 0.5 * sin(given.get("start.angle", pi / 4))
    gap = height - given.get("l2", 1.0)
    if coordinates in ("absolute", "mixed"):
        gap /= 2
    with pytest.raises(
        alfmu.AssemblyError, match=rf"slider_crank: the loops cannot be closed; .* m at ({joint})"
    ) as caught:
        started(e, given)
    said = float(str(caught.value).split("a gap of ")[1].split(" m at")[0])
    assert said == pytest.approx(gap, rel=0.02)


FOUR_LENGTHS = (0.4, 1.0, 0.8, 1.1)
"""Crank, coupler, rocker, base of `linkage`."""


def linkage(
    rocker: float, coupler: float = 0.0, *, both: bool = False, rate: float = 0.0, stop: tuple[float, ...] = ()
) -> alfmu.Equations:
    """A four-bar in relative coordinates, crank at 0.8 rad and 1 rad/s, rocker and coupler (from the crank) guessed.

    With `both`, the rocker's angle and rate are given as well, which is one too many; a stop limits the coupler's.
    """
    l1, l2, l3, l0 = FOUR_LENGTHS
    m = alfmu.Mechanism("linkage")
    t1 = m.coordinate("t1", "rad", start=0.8, rate=1.0, independent=True)
    t2 = m.coordinate("t2", "rad", start=coupler)
    t3 = m.coordinate("t3", "rad", start=rocker, **({"independent": True, "rate": rate} if both else {}))
    crank, link, swing = (m.bar(k, mass=1.0, length=x) for k, x in (("crank", l1), ("coupler", l2), ("rocker", l3)))
    m.revolute("A", m.ground.at(), crank.start, coordinate=t1)
    hinge = m.revolute("B", crank.end, link.start, coordinate=t2)
    m.revolute("D", m.ground.at(l0, 0.0), swing.start, coordinate=t3)
    m.revolute("C", link.end, swing.end)
    if stop:
        m.end_stop("stop", hinge, lower=stop[0], upper=stop[1], stiffness=10.0)
    m.gravity(0.0, -9.81)
    return alfmu.derive(m)


def closed(side: int) -> tuple[float, float]:
    """Angles of the rocker and of the coupler (from the crank) in one of the two assemblies: two circles meet."""
    l1, l2, l3, l0 = FOUR_LENGTHS
    bx, by = l1 * cos(0.8), l1 * sin(0.8)
    dx, dy = l0 - bx, -by
    far = hypot(dx, dy)
    along = (l2**2 - l3**2 + far**2) / (2 * far)
    across = side * np.sqrt(l2**2 - along**2)
    cx, cy = bx + (along * dx - across * dy) / far, by + (along * dy + across * dx) / far
    return float(np.arctan2(cy, cx - l0)), float(np.arctan2(cy - by, cx - bx)) - 0.8


def rocker_rate(side: int) -> float:
    """Rate of the rocker at 1 rad/s of the crank, by the velocity of the coupler along itself."""
    rocker, coupler = closed(side)
    return FOUR_LENGTHS[0] * sin(-coupler) / (FOUR_LENGTHS[2] * sin(rocker - 0.8 - coupler))


NEAR = [(1.2, 0.3), (1.8, 0.6), (-1.8, -1.0), (-2.5, -1.5), (1.5, 0.5)]
FAR = [(1.9, 1.0), (3.0, 0.0), (-2.5, 0.0), (10.0, 0.0), (1.2, -40.0), (-3.0, 2.5)]


@pytest.mark.parametrize("guess", NEAR, ids=str)
def test_assembly_nearest_to_the_guess(guess: tuple[float, float]) -> None:
    """Open or crossed, as guessed, exactly as two circles meet; rates follow."""
    side = min((1, -1), key=lambda s: hypot(*(x - y for x, y in zip(closed(s), guess, strict=True))))
    rocker, coupler = closed(side)
    r = readings(started(linkage(*guess)))
    assert r["rocker.angle"] == pytest.approx(rocker, abs=1e-12)
    assert r["coupler.angle"] == pytest.approx(0.8 + coupler, abs=1e-12)
    assert r["rocker.angular_velocity"] == pytest.approx(rocker_rate(side), rel=1e-12)


@pytest.mark.parametrize("side", [1, -1])
def test_guesses_in_degrees_are_told_where_they_lead_to_the_other_assembly(side: int) -> None:
    """Whole degrees, taken for radians; the start names the angles of the assembly that they were meant for."""
    rocker, coupler = (round(degrees(x)) for x in closed(side))
    with pytest.warns(alfmu.AlfmuWarning) as caught:
        i = started(linkage(rocker, coupler))
    told = [str(each.message) for each in caught if "read as degrees" in str(each.message)]
    if abs(np.remainder(readings(i)["rocker.angle"] - closed(side)[0] + pi, 2 * pi) - pi) < 1e-9:
        assert not told
        return
    (text,) = told
    for name, given, meant in (("t2", coupler, closed(side)[1]), ("t3", rocker, closed(side)[0])):
        (found,) = re.findall(
            rf"{name} is \S+ rad \(.*?\), guessed as {given} rad \(.*?\), and would be (\S+) rad", text
        )
        assert float(found) == pytest.approx(meant, abs=1e-5)


def test_a_guess_far_from_the_assembly_is_told_by_name() -> None:
    """More than 60 degrees off, though it leads to the nearest assembly; what is nearer is not told."""
    with pytest.warns(alfmu.AlfmuWarning, match="closed far from the guesses: t2 is .*guessed as .*deg") as caught:
        started(linkage(-1.8, closed(-1)[1] + 1.1))
    assert "t3 is" not in str(caught[0].message)


@pytest.mark.parametrize("inside", [True, False])
def test_an_assembly_within_the_limits_of_stops_is_taken_where_there_is_one(inside: bool) -> None:
    """The guess leads to the assembly with the rocker below; a stop leaves the one above alone, or none."""
    guess, (rocker, coupler) = closed(-1), closed(1)
    stop = (coupler - 0.3, coupler + 0.3) if inside else (guess[1] + 0.4, coupler - 0.4)
    e = linkage(guess[0] + 0.2, coupler - 0.2 if inside else (coupler + guess[1]) / 2, stop=stop)
    words = "exceeds stop by .*; the nearest found within limits is taken" if inside else "no assembly within limits"
    with pytest.warns(alfmu.AlfmuWarning, match=words):
        r = readings(started(e))
    if inside:
        assert np.remainder(r["rocker.angle"] - rocker + pi, 2 * pi) - pi == pytest.approx(0.0, abs=1e-12)
        assert r["stop.penetration"] == 0.0
    else:
        assert r["stop.penetration"] > 0.1


@pytest.mark.parametrize("guess", FAR, ids=str)
def test_a_guess_that_leads_elsewhere_is_told(guess: tuple[float, float]) -> None:
    """Radians off, the start is the nearest assembly, counting whole turns, and what is said names a coordinate.

    Where two assemblies are about equally far (a quarter) either will do; it says that the guess lies between them.
    """
    turns = [2 * pi * k for k in range(-8, 9)]
    nearest = min(
        hypot(closed(s)[0] + a - guess[0], closed(s)[1] + b - guess[1]) for s in (1, -1) for a in turns for b in turns
    )
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        r = readings(started(linkage(*guess)))
    assert all(re.match(r"linkage: .* t[23] is ", str(each.message)) for each in said)
    moved = hypot(r["rocker.angle"] - guess[0], r["coupler.angle"] - 0.8 - guess[1])
    assert moved <= 1.25 * nearest


@pytest.mark.parametrize("coordinates", ["absolute", "joint", "mixed", "natural"])
def test_rod_points_to_the_side_that_is_asked_for(coordinates: str) -> None:
    """Right by default, left by option, at the place that the triangle has."""
    reach = np.sqrt(1 - (0.1 + 0.5 * sin(1.9)) ** 2)
    for rod, sign in (("right", 1), ("left", -1)):
        i = started(derived("slider_crank", coordinates=coordinates, rod=rod), {"b": 0.1, "start.angle": 1.9})
        assert i.get("slider.position") == pytest.approx(0.5 * cos(1.9) + sign * reach, rel=1e-12)


def test_consistent_start_values_may_be_too_many() -> None:
    """Crank and rocker both given, with rates that belong together."""
    rocker, coupler = closed(1)
    r = readings(started(linkage(rocker, coupler, both=True, rate=rocker_rate(1))))
    assert r["rocker.angle"] == pytest.approx(rocker, abs=1e-12)
    assert r["rocker.angular_velocity"] == pytest.approx(rocker_rate(1), rel=1e-12)


def test_start_values_that_contradict_each_other() -> None:
    """Crank and rocker both given, but not of one assembly: the loop C and its gap are named, and what to do."""
    rocker, coupler = closed(1)
    with pytest.raises(
        alfmu.AssemblyError,
        match=r"gap of 0\.\d+ m at C; give fewer or consistent start values; they close where start\.t[13] is \S+ rad "
        r"\(\S+ deg\) instead of",
    ):
        started(linkage(rocker + 0.4, coupler, both=True))


def test_two_starts_for_one_coordinate() -> None:
    """No loop is open, yet the start values cannot both hold."""
    m = alfmu.Mechanism("twice")
    x = m.coordinate("x", "m", start=0.2, independent=True)
    m.tie(m.start("double", 1.0, "m"), 2 * x)
    m.body("cart", mass=1.0, pose=(x, 0.0, 0.0))
    e = alfmu.derive(m)
    with pytest.raises(alfmu.AssemblyError, match=r"contradict each other; .*start\.(x|double) missed by"):
        started(e)
    i = started(e, {"start.double": 0.4})
    assert i.get("cart.x") == pytest.approx(0.2, abs=1e-13)


def test_rates_that_contradict_each_other() -> None:
    """Rates of crank and rocker that no motion has."""
    with pytest.raises(alfmu.AssemblyError, match=r"no motion has the given start rates; .* per second"):
        started(linkage(*closed(1), both=True, rate=rocker_rate(1) + 0.3))


@pytest.mark.parametrize(("w", "th"), [(2.0, 0.0), (-1.5, 0.0), (3.0, -pi), (0.7, -1.0)])
def test_rates_of_the_five_bar_are_those_of_its_parallelogram(w: float, th: float) -> None:
    """At the singular positions too, where C alone would let the links part: link 2 does not turn."""
    r = readings(started(derived("five_bar"), {"start.angle": th, "start.angular_velocity": w}))
    _, v, _ = Parallelogram().state(th, w)
    assert r["link3.angular_velocity"] == pytest.approx(w, rel=1e-13)
    assert r["link2.angular_velocity"] == pytest.approx(0.0, abs=1e-13)
    assert r["link4.vy"] == pytest.approx(float(v[6]), abs=1e-13)


@pytest.mark.parametrize(
    ("name", "angle", "here"),
    [
        ("five_bar", -1.0, (1, 1, 1)),
        ("five_bar", 0.0, (1, 1, 2)),
        ("four_bar", -1.0, (1, 0, 1)),
        ("four_bar", 0.0, (1, 0, 2)),
    ],
)
def test_mobility(name: str, angle: float, here: tuple[int, int, int]) -> None:
    """One degree of freedom; one redundant constraint in the five-bar; one more velocity where links are aligned."""
    i = started(derived(name), {"start.angle": angle})
    m = i.mobility()
    assert (m.freedom, m.redundant, m.freedom_here) == here


# Masses ---------------------------------------------------------------------------------------------------------------


def chain(m1: float, m2: float) -> alfmu.Equations:
    """A double pendulum."""
    m = alfmu.Mechanism("chain")
    a, b = (m.coordinate(k, "rad", independent=True) for k in ("a", "b"))
    one, two = m.bar("one", mass=m1, length=1.0), m.bar("two", mass=m2, length=1.0)
    m.revolute("J", m.ground.at(), one.start, coordinate=a)
    m.revolute("K", one.end, two.start, coordinate=b)
    m.gravity(0.0, -9.81)
    return alfmu.derive(m)


@pytest.mark.parametrize(
    ("equations", "given", "coordinates"),
    [
        (lambda: chain(1.0, 0.0), {}, ["b"]),
        (lambda: derived("particle_on_circle"), {"m": 0.0, "start.angle": 0.0}, ["y"]),
        (
            lambda: derived("four_bar"),
            {"m1": 0.0, "m2": 0.0, "m3": 0.0, "start.angle": -1.0},
            ["th1", "x2", "y2", "th3"],
        ),
        (lambda: derived("slider_crank", coordinates="joint"), {"m1": 0.0, "m2": 0.0, "m3": 0.0}, ["th1", "th2", "s"]),
    ],
    ids=["last link of an open chain", "particle", "four-bar", "slider-crank"],
)
def test_a_motion_without_mass_is_refused(equations, given: dict, coordinates: list[str]) -> None:
    """The coordinates that move are named, and the rule."""
    with pytest.raises(alfmu.AssemblyError, match="no mass and no constraint that holds it") as caught:
        started(equations(), given)
    named = str(caught.value).split("motion along ")[1].split(" has no mass")[0].split(", ")
    assert named == coordinates
    assert "never the last body of an open chain" in str(caught.value)


@pytest.mark.parametrize("coordinates", ["absolute", "joint", "mixed", "natural"])
@pytest.mark.parametrize("massless", [("m2",), ("m1", "m2"), ("m3",), ("m2", "m3")], ids=str)
def test_massless_links_that_constraints_hold(coordinates: str, massless: tuple[str, ...]) -> None:
    """Wherever one mass is left to the mechanism, the closed loop holds the others: accelerations and reactions."""
    masses = dict.fromkeys(massless, 0.0)
    given = {**masses, "b": 0.1, "start.angle": 0.9, "start.angular_velocity": 2.0, "A.torque": 0.7}
    r = readings(started(derived("slider_crank", coordinates=coordinates), given))
    want = SliderCrank(b=0.1, torque=0.7, **masses).readings(0.9, 2.0)
    scale = max(map(abs, want.values()))
    assert max(abs(r[name] - x) for name, x in want.items()) <= 1e-12 * scale


# Names and numbers ----------------------------------------------------------------------------------------------------

REFUSED = [
    ("mass", 1.0, "has no input or parameter 'mass'; it has .*m1"),
    ("link1.angle", 1.0, "has no input or parameter 'link1.angle'"),
    ("l", nan, "l is nan; it must be a finite number in m"),
    ("l", inf, "l is inf"),
    ("l", 0.0, r"l = 0 m is outside \[1e-06, inf\]"),
    ("m2", -1e-9, r"m2 = -1e-09 kg is outside \[0.0, inf\]"),
    ("m2", "heavy", "m2 is 'heavy'; it must be a finite number"),
    ("m2", None, "m2 is None"),
    ("start.angle", nan, "start.angle is nan"),
    ("start.angular_velocity", -inf, "start.angular_velocity is -inf"),
    ("A.torque", nan, "A.torque is nan; it must be a finite number in N.m"),
    ("A.torque", inf, "A.torque is inf"),
    ("solver.step_size", 0.0, "solver.step_size = 0 s is outside"),
    ("solver.step_size", -0.01, "solver.step_size = -0.01 s is outside"),
    ("solver.penalty", -1.0, "solver.penalty = -1 kg is outside"),
    ("solver.tolerance", 0.0, "solver.tolerance = 0 1 is outside"),
    ("solver.max_iterations", 0, "solver.max_iterations = 0 1 is outside"),
    ("solver.max_iterations", 2.5, "solver.max_iterations"),
    ("solver.formulation", "exact", "solver.formulation is 'exact'; use one of residual, classic"),
]


@pytest.mark.parametrize(("name", "value", "says"), REFUSED, ids=[f"{n}={v}" for n, v, _ in REFUSED])
def test_values_that_cannot_be(name: str, value, says: str) -> None:
    """InputError with mechanism, name, value and bounds; nothing is changed."""
    i = alfmu.Instance(derived("five_bar"))
    with refused(i, alfmu.InputError, match=f"five_bar:? .*{says}" if "has no" in says else f"five_bar: {says}"):
        i.set(name, value)


@pytest.mark.parametrize(
    "name", ["l", "start.angle", "start.angular_velocity", "solver.step_size", "solver.formulation"]
)
def test_parameters_are_fixed_once_the_run_has_begun(name: str) -> None:
    """Inputs are not."""
    i = started(derived("five_bar"))
    with refused(i, alfmu.InputError, match=f"five_bar: {name} is fixed once the run has begun"):
        i.set(name, "classic" if name.endswith("formulation") else 1.0)
    i.set("A.torque", 2.0)
    assert i.get("A.torque") == 2.0


def test_an_input_is_refused_while_running_and_the_state_survives() -> None:
    """NaN and infinity in the middle of a run."""
    i = started(derived("five_bar"))
    i.step(0.1)
    read, before = readings(i), i.save()
    for value in (nan, inf, -inf, "1", None):
        with pytest.raises(alfmu.InputError, match=r"A\.torque"):
            i.set("A.torque", value)
    assert i.save() == before
    assert readings(i) == read


@pytest.mark.parametrize("name", ["link9.angle", "force", ""])
def test_there_is_no_such_variable(name: str) -> None:
    """To be read, whether the run has begun or not."""
    for i in (alfmu.Instance(derived("five_bar")), started(derived("five_bar"))):
        with pytest.raises(alfmu.InputError, match="five_bar has no variable"):
            i.get(name)


def test_nothing_moves_before_the_start() -> None:
    """Steps, outputs and counters belong to a run."""
    i = alfmu.Instance(derived("five_bar"))
    before = i.save()
    with pytest.raises(alfmu.InputError, match="five_bar: initialise before the first step"):
        i.step(0.02)
    with pytest.raises(alfmu.InputError, match="outputs are known after initialising"):
        i.get("link1.angle")
    assert i.save() == before
    assert i.get("l") == 1.0
    assert i.get("solver.formulation") == "residual"


# Steps that cannot be taken -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.0, -0.02, nan, inf, -inf])
def test_a_step_of_no_length_is_refused(step: float) -> None:
    """Zero, negative, not a number, infinite: the state before it survives to the last bit."""
    i = started(derived("five_bar"))
    i.step(0.02)
    read, before = readings(i), i.save()
    with pytest.raises(alfmu.InputError, match=r"five_bar, t = 0\.02 s: a communication step of .* must be above zero"):
        i.step(step)
    assert i.save() == before
    assert readings(i) == read


@pytest.mark.parametrize("time", [0.0, 0.01, 0.03, nan])
def test_a_step_from_another_time_is_refused(time: float) -> None:
    """The caller's clock is not the instance's."""
    i = started(derived("five_bar"))
    i.step(0.02)
    with refused(i, alfmu.InputError, match=r"the state is at t = 0\.02 s"):
        i.step(0.02, time)


@pytest.mark.parametrize("angle", [-0.5, 0.0], ids=["regular", "singular"])
def test_a_step_that_blows_up_leaves_the_state_before_it(angle: float) -> None:
    """A torque of 1e300 N.m is finite, its motion is not: StepError with mechanism, time and remedy, no warning;
    at first no step has been made whose length could be at fault."""
    i = started(derived("five_bar"), {"start.angle": angle})
    i.set("A.torque", 1e300)
    with refused(i, alfmu.StepError, match=r"five_bar, t = 0\.\d+ s: .*; check forces, dimensions and start values$"):
        i.step(0.1)
    i.set("A.torque", 0.0)
    i.step(0.1)
    assert i.time == 0.1
    i.set("A.torque", 1e300)
    with refused(i, alfmu.StepError, match=r"five_bar, t = 0\.1\d+ s: .*reduce solver.step_size$"):
        i.step(0.1)


def test_a_step_that_misses_the_constraints_leaves_the_state_before_it() -> None:
    """One internal step that is far too long: what turned is named, and the remedy."""
    i = started(
        derived("slider_crank", coordinates="joint"),
        {"solver.method": "rk4", "solver.step_size": 10.0, "start.angular_velocity": 90.0},
    )
    with refused(i, alfmu.StepError, match=r"slider_crank, t = 1 s: th\d turned by .*; reduce solver.step_size"):
        i.step(1.0)
    # What is left of |Phi| after corrections in vain is named too, with joint and remedy.
    with pytest.raises(
        alfmu.StepError, match=r"slider_crank, t = 1 s: \|Phi.* at C [xy] > .*; reduce solver.step_size"
    ):
        by_the_oracle(i.equations).project(i.q + 1e14 * np.array([0.3, 1.0, -2.0]), i.v, 1.0)


# Saved states ---------------------------------------------------------------------------------------------------------


def trace(i: alfmu.Instance, steps: int, read: bool = True) -> list[bytes]:
    """States and outputs along some steps under a torque that changes."""
    seen = []
    for k in range(steps):
        i.set(i.input_variables[0].name, 0.3 * (k % 3))
        i.step(0.017)
        if read:
            seen.append(i.read().tobytes())
    return [*seen, i.q.tobytes(), i.v.tobytes(), i.save() if read else b""]


CASES = [
    ("five_bar", {}, {}),
    ("four_bar", {}, {"solver.penalty": 1e6, "solver.formulation": "classic", "start.angle": -1.0}),
    ("slider_crank", {"coordinates": "absolute"}, {"b": 0.1}),
    ("slider_crank", {"coordinates": "natural"}, {"start.angle": 9.0, "start.angular_velocity": 14.0}),
    ("end_stop", {}, {"start.angle": -0.6}),
    ("flyball_governor", {}, {"solver.method": "rk4", "solver.step_size": 3e-4}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options", "given"), CASES, ids=lambda x: str(x) if isinstance(x, str) else None)
def test_a_restored_state_continues_to_the_last_bit(name: str, options: dict, given: dict) -> None:
    """In the instance itself after it went on, and in another one that had another life before."""
    e = by_rk4(name, **options)
    i = started(e, given)
    trace(i, 12)
    state, read = i.save(), i.read().tobytes()
    onwards = trace(i, 12)
    for other in (i, started(e, {"start.angular_velocity": 0.5}), alfmu.Instance(e)):
        other.restore(state)
        assert other.save() == state
        assert other.read().tobytes() == read
        other.restore(state)
        assert trace(other, 12) == onwards


def test_a_constraint_switched_off_stays_off_when_restored() -> None:
    """The penalties belong to the state."""
    e = derived("five_bar")
    i = started(e, {"start.angle": -1.0})
    i.penalty = [1e8] * 4 + [0.0] * 4
    i.step(0.1)
    state = i.save()
    other = started(e)
    other.restore(state)
    assert trace(other, 5) == trace(i, 5)
    assert other.get("link4.ay") == pytest.approx(-9.81, rel=1e-14)


def test_angles_in_natural_coordinates_are_restored_with_their_turns() -> None:
    """After two turns from a start beyond pi; points alone would not tell."""
    e = by_rk4("slider_crank", coordinates="natural")
    i = started(e, {"start.angle": 9.0, "start.angular_velocity": 14.0})
    assert i.get("crank.angle") == pytest.approx(9.0, abs=1e-13)
    i.step(1.5)
    angle = i.get("crank.angle")
    assert angle > 9.0 + 4 * pi
    other = alfmu.Instance(e)
    other.restore(i.save())
    assert other.get("crank.angle") == angle


def test_reading_does_not_disturb_the_motion() -> None:
    """The same bits whether anybody looks at the outputs or not."""
    one, two = (started(derived("five_bar")) for _ in range(2))
    assert trace(one, 20)[-3:-1] == trace(two, 20, read=False)[-3:-1]


def test_two_instances_do_not_disturb_each_other() -> None:
    """Interleaved or alone: the same bits."""
    alone = trace(started(derived("five_bar")), 10)
    one, two = started(derived("five_bar")), started(derived("five_bar"), {"start.angle": -1.0, "m2": 0.0})
    both = []
    for k in range(10):
        one.set("A.torque", 0.3 * (k % 3))
        one.step(0.017)
        two.set("A.torque", 5.0)
        two.step(0.03)
        both.append(one.read().tobytes())
    assert both == alone[:10]


def test_a_settings_state_is_restored_before_the_start() -> None:
    """Values and formulation of an instance that has not begun."""
    e = by_rk4("five_bar")
    i = alfmu.Instance(e)
    i.set("l", 0.7)
    i.set("solver.formulation", "classic")
    state = i.save()
    other = started(e)
    other.restore(state)
    assert other.get("l") == 0.7
    assert other.get("solver.formulation") == "classic"
    with pytest.raises(alfmu.InputError, match="initialise"):
        other.step(0.02)
    other.initialize()
    i.initialize()
    assert other.read().tobytes() == i.read().tobytes()


@pytest.mark.parametrize(
    "state",
    [b"", b"not a state at all", lambda s: s[:-8], lambda s: s[:-3], lambda s: s + b"\0" * 8, None],
    ids=["nothing", "text", "a number short", "bytes short", "a number long", "another mechanism"],
)
def test_a_state_of_something_else_is_refused(state) -> None:
    """Truncated, padded, of another mechanism: InputError, and the instance goes on as it was."""
    i = started(derived("five_bar"))
    i.step(0.02)
    before = i.save()
    foreign = started(derived("four_bar")).save() if state is None else state(before) if callable(state) else state
    with pytest.raises(alfmu.InputError, match="five_bar: the saved state is not one of this mechanism"):
        i.restore(foreign)
    assert i.save() == before


# Step lengths ---------------------------------------------------------------------------------------------------------

START, RATE, RUN = -1.0, 1.5, 1.2


def uneven(h: float) -> list[float]:
    """Communication steps that are no multiples of h, changing, some shorter than h, 1.2 s in all."""
    pattern = np.array([2.3, 0.4, 1.0, 3.7, 0.01, 1.6])
    steps = np.tile(pattern, round(RUN / (h * pattern.sum()) + 0.5)) * h
    return list(steps[steps.cumsum() < RUN - 1e-9])


def test_order_is_kept_and_time_is_exact_for_any_steps() -> None:
    """Order four over four halvings of solver.step_size, however the communication steps fall."""
    errors, sizes = [], 0.04 / 2 ** np.arange(5)
    exact = Parallelogram().swing(START, RATE, np.array([0.0, RUN]))[-1]
    for h in sizes:
        given = {"start.angle": START, "start.angular_velocity": RATE, "solver.method": "rk4", "solver.step_size": h}
        i = started(derived("five_bar"), given)
        t = 0.0
        for step in uneven(h):
            i.step(step, t)
            t += step
            assert i.time == t
        i.step(RUN - t, t)
        assert i.time == pytest.approx(RUN, abs=4e-16)
        errors.append([abs(i.get("link1.angle") - exact[0]), abs(i.get("link1.angular_velocity") - exact[1])])
    slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert (np.abs(slopes - 4) < 0.3).all(), slopes


def test_a_thousand_steps_do_not_drift() -> None:
    """0.1 s is no binary number, yet the caller's clock, k times the step, is always accepted."""
    i = started(derived("particle_on_circle"), {"solver.method": "rk4", "solver.step_size": 0.1})
    for k in range(1000):
        i.step((k + 1) * 0.1 - k * 0.1, k * 0.1)
    assert i.time == pytest.approx(100.0, abs=1e-12)


@pytest.mark.parametrize(("step", "internal"), [(0.1, 5), (0.05, 3), (0.02, 1), (0.003, 1), (1.0, 50), (0.0200001, 2)])
def test_internal_steps_are_the_fewest_that_are_short_enough(step: float, internal: int) -> None:
    """A communication step is cut evenly; one that exceeds solver.step_size by round-off alone is not."""
    i = started(derived("particle_on_circle"))
    i.step(step)
    assert i.counters.steps == internal


def test_cutting_the_same_way_gives_the_same_bits() -> None:
    """One step of 0.1 s is five of 0.02 s, but for the round-off of time (none enters: no force depends on it)."""
    one, five = (started(derived("five_bar"), {"start.angle": -1.0}) for _ in range(2))
    one.step(0.1)
    for _ in range(5):
        five.step(0.02)
    assert np.abs(one.q - five.q).max() <= 1e-15
    assert np.abs(one.v - five.v).max() <= 2e-15


# Driver ---------------------------------------------------------------------------------------------------------------


def test_simulate_reaches_its_end() -> None:
    """0, step, 2 step, ... and the stop time itself, whole multiple or not."""
    for stop, step, last in ((1.0, 0.3, [0.9, 1.0]), (0.9, 0.3, [0.6, 0.9]), (0.1, 1.0, [0.0, 0.1])):
        r = alfmu.simulate(derived("particle_on_circle"), stop, step)
        assert r.time[-2:] == pytest.approx(last, abs=1e-15)
        assert r["particle.x"][-1] == pytest.approx(cos(stop), abs=1e-6)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"stop_time": 0.0}, "stop time is 0.0 s"),
        ({"stop_time": nan}, "stop time is nan s"),
        ({"communication_step": 0.0}, "step is 0.0 s"),
        ({"communication_step": -1.0}, "step is -1.0 s"),
        ({"communication_step": inf}, "step is inf s"),
        ({"outputs": ["particle.z"]}, "no output 'particle.z'"),
        ({"inputs": {"force.z": 1.0}}, "no input or parameter 'force.z'"),
        ({"inputs": {"force.x": lambda t: nan}}, "force.x is nan"),
        ({"parameters": {"mass": 1.0}}, "no input or parameter 'mass'"),
    ],
)
def test_simulate_refuses(given: dict, says: str) -> None:
    """With the mechanism's name and the fault."""
    with pytest.raises(alfmu.InputError, match=f"particle_on_circle.*{says}"):
        alfmu.simulate(derived("particle_on_circle"), **given)


def test_inputs_are_held_over_a_communication_step() -> None:
    """A number, a function, a table: momentum by the sum of impulses, of a cart that nothing else pushes."""
    m = alfmu.Mechanism("cart")
    x = m.coordinate("x", "m")
    m.body("cart", mass=2.0, pose=(x, 0.0, 0.0))
    m.generalized_force(x, m.input("push", "N"))
    e = alfmu.derive(m)
    table = ([0.0, 1.0], [0.0, 4.0])
    for signal, at in ((3.0, lambda t: 3.0), (lambda t: t**2, lambda t: t**2), (table, lambda t: 4 * min(t, 1.0))):
        r = alfmu.simulate(e, 1.5, 0.1, inputs={"push": signal})
        impulse = np.cumsum([0.0, *(0.1 * at(t) for t in r.time[:-1])])
        assert np.abs(2.0 * r["cart.vx"] - impulse).max() <= 1e-14
        assert r["push"] == pytest.approx([at(t) for t in r.time])
        assert 2.0 * r["cart.ax"] == pytest.approx(r["push"])  # outputs follow the inputs of their own time


def test_start_quantities_may_be_any_expression() -> None:
    """The height of a slider's crank pin as start value: the angle follows."""
    m = alfmu.Mechanism("pin")
    height = m.start("height", 0.3, "m", rate=0.2)
    th = m.coordinate("th", "rad", start=ca.asin(height))
    m.tie(height, ca.sin(th))
    m.bar("bar", mass=1.0, length=1.0)
    m.revolute("A", m.ground.at(), m.bodies[0].start, coordinate=th)
    r = readings(started(alfmu.derive(m), {"start.height": 0.6}))
    assert r["bar.angle"] == pytest.approx(np.arcsin(0.6), rel=1e-13)
    assert r["bar.angular_velocity"] == pytest.approx(0.2 / 0.8, rel=1e-13)


def test_a_singular_start_between_two_motions_is_refused() -> None:
    """Equal links, both vertical: the slider can stand still or run at twice the crank's pin, not in between."""
    for coordinates in ("absolute", "joint", "mixed", "natural"):
        e = derived("slider_crank", coordinates=coordinates)
        given = {"l1": 1.0, "l2": 1.0, "start.angle": pi / 2, "start.angular_velocity": -1.0}
        with pytest.raises(alfmu.AssemblyError, match=r"slider_crank: the start is a singular position.* beside it"):
            started(e, given)
        beside = started(e, {**given, "start.angle": pi / 2 - 1e-3})
        assert beside.get("slider.velocity") == pytest.approx(2 * cos(1e-3), rel=1e-6)


def test_counters_are_there_before_the_start() -> None:
    assert alfmu.Instance(derived("five_bar")).counters.steps == 0


def test_a_weld_places_whichever_body_has_no_place() -> None:
    """Two halves of a bar welded in either order swing as the whole bar does."""
    accelerations = []
    for flip in (False, True):
        m = alfmu.Mechanism("halves")
        th = m.coordinate("th", "rad", start=0.4, independent=True)
        near, far = (m.bar(name, mass=0.5, length=0.5) for name in ("near", "far"))
        m.revolute("A", m.ground.at(), near.start, coordinate=th)
        ends = (far.start, near.end) if flip else (near.end, far.start)
        m.weld("W", *ends)
        m.gravity(0.0, -9.81)
        r = readings(started(alfmu.derive(m)))
        accelerations.append(r["far.angular_acceleration"])
        sign = -1 if flip else 1
        # Newton's law for the far half: the weld carries its weight and its inertia.
        assert sign * r["W.force.y"] == pytest.approx(0.5 * (r["far.ay"] + 9.81), rel=1e-12)
    assert accelerations == pytest.approx([-1.5 * 9.81 * cos(0.4)] * 2, rel=1e-13)
