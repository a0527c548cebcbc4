"""What `alfmu.derive` finds out, against hand-written geometry differentiated by numbers, and Newton's laws."""

import casadi as ca
import numpy as np
import pytest
from mpmath import atan2, cos, mp, mpf, sin, sqrt
from oracles import mechanisms
from oracles.free_body import Balance, turn
from oracles.lagrange import DIGITS, Description, slope
from oracles.parallelogram import Parallelogram
from oracles.pendulum import period
from scenes import ARM, GLUE, QUICK_RETURN, SLIDE, arm, derived, evaluate, hinged, quick_return, readings, started

import alfmu

EXACT = 1e-13
"""Of the largest entry: a few hundred roundings of double precision, nothing else, part a formula from its value."""

SIGNATURES = {
    "M": "qp",
    "d": "qvp",
    "f": "qvupt",
    "Phi": "qp",
    "C": "qp",
    "xi": "qvp",
    "kinetic_energy": "qvp",
    "potential_energy": "qp",
    "input_power": "qvupt",
    "other_power": "qvpt",
}

MECHANISMS = {
    "particle_on_circle": ({}, mechanisms.particle),
    "five_bar": ({}, mechanisms.parallelogram),
    "four_bar": ({}, mechanisms.parallelogram),
    **{
        f"slider_crank-{c}": ({"coordinates": c}, lambda p, c=c: mechanisms.slider_crank(p, c))
        for c in ("absolute", "joint", "mixed", "natural")
    },
}


def array(x) -> np.ndarray:
    return np.array([float(e) for e in x])


def values(e: alfmu.Equations, quantity: str, **at) -> np.ndarray:
    """One function of the equations at a state, flat."""
    return np.array(getattr(e, quantity)(*(at[letter] for letter in SIGNATURES[quantity])), float).reshape(-1)


def near(got, want, scale: float | None = None) -> None:
    """Equal but for round-off of the largest entry."""
    got, want = np.asarray(got, float), np.asarray(want, float)
    assert got.shape == want.shape
    assert np.abs(got - want).max(initial=0.0) <= EXACT * (scale or max(1.0, np.abs(want).max(initial=0.0)))


def random_state(e: alfmu.Equations, seed: int) -> dict:
    """Any state, on the constraints or (almost surely) not, with any parameters and inputs."""
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-1.5, 1.5, (2, e.n))
    u = rng.uniform(-5, 5, len(e.inputs))
    return {"q": q, "v": v, "u": u, "p": rng.uniform(0.5, 2.0, len(e.parameters)), "t": 0.7}


# The project's mechanisms ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", MECHANISMS)
def test_equations_are_lagranges(name: str, seed: int) -> None:
    """M, d, f of (4), Phi, C, xi of (1) to (3), energies and power, at states off the constraints too."""
    options, describe = MECHANISMS[name]
    e = derived(name.split("-")[0], **options)
    at = random_state(e, seed)
    by_hand = describe({v.name: x for v, x in zip(e.parameters, at["p"], strict=True)})
    for quantity, want in by_hand.equations(at["q"], at["v"], at["u"]).items():
        near(values(e, quantity, **at), array(want))
    assert values(e, "other_power", **at) == 0  # none of them has dampers or loads


@pytest.mark.parametrize("seed", range(3))
def test_five_bar_is_the_paper_s(seed: int) -> None:
    """Phi, C, xi, M, f entry by entry as Blajer prints them (misprints corrected), and d = 0."""
    e = derived("five_bar")
    at = random_state(e, seed)
    sizes = {v.name: x for v, x in zip(e.parameters, at["p"], strict=True)}
    q, v = ([mpf(x) for x in at[k]] for k in "qv")
    printed = Parallelogram(**sizes).equations(q, v, at["u"])
    for quantity, want in zip(("Phi", "C", "xi", "M", "f"), printed, strict=True):
        # CasADi's arrays are stored by rows here, as mpmath's are.
        near(values(e, quantity, **at), array(want))
    near(values(e, "d", **at), np.zeros(8))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", MECHANISMS)
def test_bodies_are_where_the_coordinates_put_them(name: str, seed: int) -> None:
    """Place, velocity and acceleration of every body, by differences along a parabola in q."""
    options, describe = MECHANISMS[name]
    e = derived(name.split("-")[0], **options)
    at = random_state(e, seed)
    p = {v.name: x for v, x in zip(e.parameters, at["p"], strict=True)}
    d = describe(p)
    if "natural" in name:
        d = Description(poses=lambda q: mechanisms.natural_poses(q, mpf(p["b"]), mpf(p["l1"]), mpf(p["l2"])))
    a = np.random.default_rng(seed + 100).uniform(-1.5, 1.5, e.n)
    y = np.array(e.readings(at["q"], at["v"], a, np.zeros(e.l), at["u"], at["p"], 0.0)).reshape(-1)
    read = {v.name: x for v, x in zip(e.outputs, y, strict=True)}
    bodies = dict.fromkeys(v.name.split(".")[0] for v in e.outputs if v.name.endswith(".ax"))
    whole = any(v.name.endswith(".angle") for v in e.outputs)
    letters = [(".x", ".y", ".angle"), (".vx", ".vy", ".angular_velocity"), (".ax", ".ay", ".angular_acceleration")]
    for body, levels in zip(bodies, d.readings(at["q"], at["v"], a), strict=True):
        for names, want in zip(letters, levels, strict=True):
            near([read[body + k] for k in names[: 3 if whole else 2]], array(want)[: 3 if whole else 2])


# Every joint, load and spring -----------------------------------------------------------------------------------------


def rotated(angle, x, y) -> tuple:
    return cos(angle) * x - sin(angle) * y, sin(angle) * x + cos(angle) * y


def arm_points(q) -> dict[str, tuple]:
    """Points of `arm` in coordinates [s, th], by hand."""
    s, th = q
    tilt, lean = mpf(SLIDE["axis"]), mpf(SLIDE["angle"])

    def on(point, angle, x, y):
        dx, dy = rotated(angle, mpf(x), mpf(y))
        return point[0] + dx, point[1] + dy

    guide = on((mpf(0.1), mpf(0.2)), tilt, s, SLIDE["offset"])
    zero = on(guide, lean, -0.02, -0.03)  # origin of the carriage
    hinge = on(zero, lean, 0.1, -0.05)
    boom = on(hinge, lean + th, 0.02, -0.04)
    weld = on(boom, lean + th, 0.5, 0.1)
    end = lean + th + mpf(GLUE)
    tip = on(weld, end, 0.03, -0.02)
    return {
        "carriage": (*on(zero, lean, *ARM["carriage"][2]), lean),
        "boom": (*on(boom, lean + th, *ARM["boom"][2]), lean + th),
        "tip": (*on(tip, end, *ARM["tip"][2]), end),
        "pull": on(tip, end, 0.3, 0.1),
        "anchor": on(tip, end, 0.2, 0.0),
    }


def arm_description() -> Description:
    """`arm` in coordinates [s, th], at the time 0.7 s."""

    def stretch(q) -> list:
        x, y = arm_points(q)["anchor"]
        return [sqrt((x - mpf(0.4)) ** 2 + (y - mpf(1.5)) ** 2)]

    def loads(q, v) -> list:
        rate = slope(stretch, q, v)[0]
        directions = ([mpf(1), mpf(0)], [mpf(0), mpf(1)])
        lift = [slope(lambda at: [arm_points(at)["pull"][1]], q, e)[0] * 2 * cos(mpf(0.7)) for e in directions]
        pulled = [-mpf(0.7) * rate * slope(stretch, q, e)[0] for e in directions]
        own = [-2 * v[0], -(mpf(0.3) + mpf(0.2)) * v[1]]
        return [a + b + c for a, b, c in zip(lift, pulled, own, strict=True)]

    return Description(
        poses=lambda q: [arm_points(q)[b] for b in ARM],
        weights=[(mpf(m), mpf(j)) for m, j, _ in ARM.values()],
        potential=lambda q: (
            15 * (q[0] - mpf(0.2)) ** 2 + 2 * (q[1] - mpf(0.1)) ** 2 + 6 * (stretch(q)[0] - mpf(0.5)) ** 2
        ),
        loads=loads,
        paths=lambda q: [q[0], q[1], arm_points(q)["pull"][0], arm_points(q)["boom"][2]],
        gravity=(mpf(0.5), mpf(-9.81)),
    )


@pytest.fixture(scope="module")
def arms() -> dict[str, alfmu.Equations]:
    return {kind: alfmu.derive(arm(kind)) for kind in ("coordinates", "constraints")}


@pytest.mark.parametrize("seed", range(3))
def test_arm_is_lagranges(arms: dict, seed: int) -> None:
    """Springs, dampers, friction, inputs and a load that depends on time, on joints that coordinates close."""
    e = arms["coordinates"]
    at = random_state(e, seed)
    by_hand = arm_description()
    for quantity, want in by_hand.equations(at["q"], at["v"], at["u"]).items():
        near(values(e, quantity, **at), array(want))
    with mp.workdps(DIGITS):
        passive = by_hand.loads([mpf(x) for x in at["q"]], [mpf(x) for x in at["v"]])
    near(values(e, "other_power", **at), [array(passive) @ at["v"]])


def arm_balance(r: dict, u: np.ndarray, t: float) -> float:
    """What Newton's and Euler's laws lack on any body of `arm`."""
    b = Balance(r, ARM, (0.5, -9.81))
    b.joint("prismatic", "slide", "ground", "carriage", (0.02, 0.03), axis=SLIDE["axis"])
    b.joint("revolute", "hinge", "carriage", "boom", (-0.02, 0.04))
    b.joint("weld", "glue", "boom", "tip", (-0.03, 0.02))
    along = turn(SLIDE["axis"])[:, 0]
    place = along @ (b.point("carriage", (0.02, 0.03)) - (0.1, 0.2))
    rate = along @ b.velocity("carriage", (0.02, 0.03))
    b.push("ground", "carriage", b.point("carriage", (0.02, 0.03)), (u[0] - 30 * (place - 0.2) - 2 * rate) * along)
    bent, spin = b.angle("boom") - b.angle("carriage"), b.spin("boom") - b.spin("carriage")
    hinge = u[1] - 4 * (bent - 0.1) - 0.5 * spin
    b.push("carriage", "boom", b.point("boom", (0, 0)), np.zeros(2), hinge)
    b.push("ground", "boom", b.point("boom", (0, 0)), np.zeros(2), u[3])
    b.push("ground", "tip", b.point("tip", (0.3, 0.1)), np.array([u[2], 2 * np.cos(t)]))
    push_spring(b, "ground", (0.4, 1.5), "tip", (0.2, 0.0), 12.0, 0.7, 0.5)
    return b.lack()


def push_spring(b: Balance, first: str, one: tuple, second: str, two: tuple, k: float, c: float, rest: float) -> None:
    """A spring-damper between two points."""
    line = b.point(second, two) - b.point(first, one)
    length = np.linalg.norm(line)
    rate = (b.velocity(second, two) - b.velocity(first, one)) @ line / length
    b.push(first, second, b.point(second, two), -(k * (length - rest) + c * rate) * line / length)


@pytest.mark.parametrize("seed", range(3))
def test_joints_closed_by_coordinates_and_by_constraints_carry_the_same(arms: dict, seed: int) -> None:
    """The same arm in 2 coordinates and in 9 with 7 constraints: all accelerations and reactions agree, and balance."""
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-1, 1, (2, 2))
    u, t = rng.uniform(-5, 5, 4), 0.7
    joint = evaluate(arms["coordinates"], q, v, u, t)
    places = [joint[f"{b}.{k}"] for b in ARM for k in ("x", "y", "angle")]
    rates = [joint[f"{b}.{k}"] for b in ARM for k in ("vx", "vy", "angular_velocity")]
    absolute = evaluate(arms["constraints"], places, rates, u, t)
    common = [k for k in joint if k in absolute]
    assert {"slide.force", "slide.moment", "hinge.force.x", "glue.moment", "carriage.position", "tip.ay"} <= set(common)
    near([absolute[k] for k in common], [joint[k] for k in common])
    for read in (joint, absolute):
        assert arm_balance(read, u, t) <= EXACT


def quick_return_balance(r: dict, u: np.ndarray) -> float:
    """What Newton's and Euler's laws lack on any body of `quick_return`."""
    b = Balance(r, QUICK_RETURN, (0.0, -9.81))
    b.joint("revolute", "axle", "ground", "crank", (0.0, 0.0))
    b.joint("revolute", "pivot", "ground", "rocker", (0.0, 0.0))
    b.joint("prismatic", "track", "ground", "ram", (0.0, 0.0), axis=0.1)
    b.joint("point_on_line", "slot", "rocker", "crank", (0.3, 0.0), axis=0.05)
    b.joint("distance", "rod", "rocker", "ram", (0.05, 0.02), of=(1.1, 0.05))
    b.joint("weld", "bolts", "ram", "box", (-0.02, 0.01))
    b.joint("prismatic", "bush", "rocker", "sleeve", (0.01, -0.01), axis=0.05)
    none = np.zeros(2)
    b.push("ground", "crank", none, none, u[0])
    b.push("ground", "ram", b.point("ram", (0.2, 0.05)), np.array([u[1], -1.5]))
    b.push("ground", "box", none, none, u[2])
    b.push("ground", "rocker", none, none, -3.0 * (b.angle("rocker") - 1.2) - 0.4 * b.spin("rocker"))
    track = turn(0.1)[:, 0]
    b.push("ground", "ram", b.point("ram", (0.0, 0.0)), -0.8 * (track @ b.vector("ram", "v")) * track)
    push_spring(b, "sleeve", (0.0, 0.05), "ram", (0.0, -0.05), 8.0, 0.6, 0.3)
    # Along the guide on the rocker, which turns: the place is u . (P2 - P1), so its rate has a part from u.
    ux, normal = turn(b.angle("rocker") + 0.05).T
    between = b.point("sleeve", (0.01, -0.01)) - b.point("rocker", (0.1, 0.03))
    rate = ux @ (b.velocity("sleeve", (0.01, -0.01)) - b.velocity("rocker", (0.1, 0.03)))
    rate += b.spin("rocker") * normal @ between
    effort = -60.0 * (ux @ between - 0.4) - 1.5 * rate
    b.push("rocker", "sleeve", b.point("sleeve", (0.01, -0.01)), effort * ux)
    return b.lack()


@pytest.fixture(scope="module")
def ram_machine() -> alfmu.Equations:
    return alfmu.derive(quick_return())


def test_every_kind_of_joint_balances_along_a_motion(ram_machine: alfmu.Equations) -> None:
    """Slot, rod, weld and moving guide as constraints: what they carry balances every body throughout a run."""
    u = np.array([0.6, -1.0, 0.3])
    i = started(ram_machine)
    for variable, value in zip(ram_machine.inputs, u, strict=True):
        i.set(variable.name, value)
    lack = []
    for _ in range(40):
        lack.append(quick_return_balance(readings(i), u))
        i.step(0.05)
    # Velocities are consistent to 1e-13 (solver.tolerance), twenty times that is seen in centripetal terms.
    assert max(lack) <= 20 * EXACT


def test_every_kind_of_joint_holds_its_points_together(ram_machine: alfmu.Equations) -> None:
    """What each joint suppresses, by geometry alone, after a run."""
    i = started(ram_machine)
    i.set("axle.torque", 0.6)
    for _ in range(20):
        i.step(0.05)
    b = Balance(readings(i), QUICK_RETURN, (0.0, 0.0))
    slot = b.point("crank", (0.3, 0.0)) - b.point("rocker", (0.0, 0.01))
    bush = b.point("sleeve", (0.01, -0.01)) - b.point("rocker", (0.1, 0.03))
    left = turn(b.angle("rocker") + 0.05)[:, 1]
    gaps = [
        *b.point("crank", (0.0, 0.0)),
        *(b.point("rocker", (0.0, 0.0)) - (0.0, -0.6)),
        turn(0.1)[:, 1] @ (b.point("ram", (0.0, 0.0)) - (0.0, 0.5)),
        b.angle("ram"),
        left @ slot - 0.02,
        np.linalg.norm(b.point("ram", (0.05, 0.02)) - b.point("rocker", (1.1, 0.05))) - 0.8,
        *(b.point("box", (-0.02, 0.01)) - b.point("ram", (0.1, 0.1))),
        b.angle("box") - b.angle("ram") - 0.3,
        left @ bush + 0.04,
        b.angle("sleeve") - b.angle("rocker") - 0.2,
    ]
    assert np.abs(gaps).max() <= EXACT  # solver.tolerance, at which projection stops


def test_energy_changes_by_the_work_of_loads_and_dampers(arms: dict) -> None:
    """Work by Simpson's rule over power that is put together by hand from what is read."""
    u, h, steps = {"slide.drive": 5.0, "hinge.drive": 1.0, "tip.pull": -3.0, "boom.torque": 0.5}, 0.005, 200
    i = started(arms["coordinates"], {**u, "solver.method": "rk4", "solver.step_size": 0.0025})
    first, power = i.get("monitor.energy"), []
    for k in range(steps + 1):
        r = readings(i)
        b = Balance(r, ARM, (0.0, 0.0))
        slide, hinge = r["carriage.velocity"], b.spin("boom") - b.spin("carriage")
        line = b.point("tip", (0.2, 0.0)) - (0.4, 1.5)
        stretching = b.velocity("tip", (0.2, 0.0)) @ line / np.linalg.norm(line)
        driven = 5.0 * slide + hinge + b.velocity("tip", (0.3, 0.1)) @ (-3.0, 2 * np.cos(i.time)) + 0.5 * b.spin("boom")
        power.append(driven - 2.0 * slide**2 - 0.5 * hinge**2 - 0.7 * stretching**2)
        if k < steps:
            i.step(h)
    weights = np.array([1, *[4, 2] * (steps // 2 - 1), 4, 1]) * h / 3
    work = weights @ np.array(power)
    # Both of order four: RK4 leaves 1.7e-9 J at this step, Simpson's rule 2e-8 J of the 4 J that are exchanged.
    assert abs(i.get("monitor.energy") - first - work) <= 5e-8
    assert i.counters.energy_error <= 5e-9
    assert abs(work) > 1.0


# Statics by hand ------------------------------------------------------------------------------------------------------

MASS, LENGTH, G = 2.0, 0.8, 9.81
WEIGHT = MASS * G


def still(m: alfmu.Mechanism, q=None, v=None, u=()) -> dict[str, float]:
    """Everything that can be read of a mechanism at its own guess, or in a given state, under gravity."""
    m.gravity(0.0, -G)
    e = alfmu.derive(m)
    q = np.array(e.guess([], []), float).reshape(-1) if q is None else q
    return evaluate(e, q, np.zeros(e.n) if v is None else v, u)


@pytest.mark.parametrize("closed_by", ["placement", "constraints"])
def test_weld_carries_a_cantilever(closed_by: str) -> None:
    """Weight as shear, weight times half the length as moment about the wall; a mass hangs still from the end."""
    m = alfmu.Mechanism("cantilever")
    th = m.coordinate("th", "rad", start=-np.pi / 2, independent=True)
    pose = None
    if closed_by == "constraints":
        pose = tuple(m.coordinate(k, u, start=s) for k, u, s in (("x", "m", 0.4), ("y", "m", 0.0), ("a", "rad", 0.0)))
    beam = m.bar("beam", mass=MASS, length=LENGTH, pose=pose)
    bob = m.bar("bob", mass=0.5, length=0.3)
    m.weld("wall", m.ground.at(0.0, 0.0), beam.start)
    m.revolute("hook", beam.end, bob.start, coordinate=th)
    m.gravity(0.0, -G)
    e = alfmu.derive(m)
    q = [-np.pi / 2, 0.4, 0.0, 0.0][: e.n]
    r = evaluate(e, q, np.zeros(e.n))
    near([r["wall.force.x"], r["wall.force.y"]], [0.0, WEIGHT + 0.5 * G])
    near([r["wall.moment"]], [WEIGHT * LENGTH / 2 + 0.5 * G * LENGTH])
    near([r["hook.force.x"], r["hook.force.y"]], [0.0, 0.5 * G])


@pytest.mark.parametrize("closed_by", ["coordinate", "constraints", "distance"])
def test_pendulum_tension(closed_by: str) -> None:
    """m (l w^2 - g sin th) towards the pivot, th from the x axis, whatever closes the pivot."""
    th, w = -1.1, 1.7
    c, s = np.cos(th), np.sin(th)
    m = alfmu.Mechanism("pendulum")
    if closed_by == "coordinate":
        bob = m.body("bob", mass=MASS, inertia=0.0, center=(LENGTH, 0.0))
        m.revolute("pivot", m.ground.at(), bob.at(), coordinate=m.coordinate("th", "rad"))
        q, v = [th], [w]
    elif closed_by == "constraints":
        # A point mass: the angle of the body has inertia through the pivot alone, by the augmented mass matrix.
        bob = m.body(
            "bob",
            mass=MASS,
            inertia=0.0,
            center=(LENGTH, 0.0),
            pose=tuple(m.coordinate(k, u) for k, u in zip("xya", ("m", "m", "rad"), strict=True)),
        )
        m.revolute("pivot", m.ground.at(), bob.at())
        q, v = [LENGTH * c, LENGTH * s, th], [-LENGTH * s * w, LENGTH * c * w, w]
    else:
        bob = m.body("bob", mass=MASS, pose=(m.coordinate("x", "m"), m.coordinate("y", "m"), 0.0))
        m.distance("pivot", m.ground.at(), bob.at(), length=LENGTH)
        q, v = [LENGTH * c, LENGTH * s], [-LENGTH * s * w, LENGTH * c * w]
    r = still(m, q, v)
    tension = MASS * (LENGTH * w**2 - G * s)
    if closed_by == "distance":
        near([r["pivot.force"]], [-tension])  # positive when the joint pushes
    else:
        near([r["pivot.force.x"], r["pivot.force.y"]], [-tension * c, -tension * s], tension)


@pytest.mark.parametrize("closed_by", ["coordinate", "constraints"])
def test_slider_on_an_inclined_guide(closed_by: str) -> None:
    """It slides at -g sin b; the guide bears m g cos b, and the moment of the weight about the slider's marker."""
    b, offset, angle, center, marker = 0.35, 0.1, 0.2, (0.15, 0.25), (0.05, -0.04)
    m = alfmu.Mechanism("incline")
    s = pose = None
    place = turn(b) @ (0.3, offset) + turn(angle) @ (np.array(center) - marker)
    if closed_by == "coordinate":
        s = m.coordinate("s", "m", start=0.3)
    else:
        pose = tuple(
            m.coordinate(k, u, start=x) for k, u, x in zip("xya", ("m", "m", "rad"), (*place, angle), strict=True)
        )
    block = m.body("block", mass=MASS, inertia=0.07, center=center, pose=pose)
    m.prismatic("guide", m.ground.at(), block.at(*marker), axis=b, offset=offset, angle=angle, coordinate=s)
    r = still(m)
    near([r["block.x"], r["block.y"], r["block.position"]], [*place, 0.3])
    near([r["block.acceleration"], r["guide.force"]], [-G * np.sin(b), WEIGHT * np.cos(b)])
    # About the centre of mass, which does not turn: moment + (marker - centre) x normal force = 0.
    arm_, normal = turn(angle) @ (np.array(marker) - center), WEIGHT * np.cos(b) * turn(b)[:, 1]
    near([r["guide.moment"]], [-(arm_[0] * normal[1] - arm_[1] * normal[0])])


def test_pin_in_a_slot_bears_half_a_bar() -> None:
    """A horizontal bar on a hinge, its end pinned in a slot at an angle b: the slot bears m g / (2 cos b)."""
    b = 0.3
    m, bar, *_ = hinged("shelf", joint="hinge", mass=MASS, length=LENGTH, weight=0.0)
    m.point_on_line("slot", m.ground.at(LENGTH, 0.0), bar.end, axis=b)
    r = still(m)
    near([r["slot.force"]], [WEIGHT / 2 / np.cos(b)])
    near([r["hinge.force.x"], r["hinge.force.y"]], [WEIGHT / 2 * np.tan(b), WEIGHT / 2])
    run = alfmu.simulate(m, 0.1, 0.01)  # a structure: no coordinate is independent
    near(run["slot.force"], [WEIGHT / 2 / np.cos(b)] * 11)


def test_massless_rod_holds_a_boom() -> None:
    """A horizontal boom on a hinge, its end held by a stay at 45 degrees from above: tension m g / sqrt(2)."""
    m, boom, *_ = hinged("boom", bar="boom", joint="hinge", mass=MASS, length=LENGTH, weight=0.0)
    m.distance("stay", m.ground.at(0.0, LENGTH), boom.end, length=LENGTH * np.sqrt(2))
    r = still(m)
    near([r["stay.force"]], [-WEIGHT / np.sqrt(2)])
    near([r["hinge.force.x"], r["hinge.force.y"]], [WEIGHT / 2, WEIGHT / 2])


def test_chain_that_is_declared_from_its_far_end() -> None:
    """Joints whose coordinate places their first body: hinge, then guide, with the reactions on the second body."""
    m = alfmu.Mechanism("backwards")
    pose = tuple(m.coordinate(k, u, start=x) for k, u, x in zip("xya", ("m", "m", "rad"), (0.3, 0.2, 0.4), strict=True))
    sizes = {"base": (1.0, 0.1, (0.1, 0.0)), "lever": (0.7, 0.05, (0.2, 0.1)), "collar": (0.4, 0.02, (0.0, 0.05))}
    base, lever, collar = (
        m.body(k, mass=x, inertia=j, center=c, pose=pose if k == "base" else None) for k, (x, j, c) in sizes.items()
    )
    m.revolute("hinge", lever.at(0.3, 0.0), base.at(0.05, 0.02), coordinate=m.coordinate("th", "rad"))
    m.prismatic(
        "guide",
        collar.at(0.02, 0.0),
        lever.at(-0.1, 0.0),
        axis=0.3,
        offset=0.1,
        angle=0.5,
        coordinate=m.coordinate("s", "m"),
    )
    r = still(m, [0.3, 0.2, 0.4, 0.6, 0.25], [1.0, -0.5, 2.0, -1.5, 0.8])
    b = Balance(r, sizes, (0.0, -G))
    near([b.angle("base") - b.angle("lever"), b.angle("lever") - b.angle("collar")], [0.6, 0.5])
    near(b.point("lever", (0.3, 0.0)), b.point("base", (0.05, 0.02)))
    along, across = turn(b.angle("collar") + 0.3).T
    between = b.point("lever", (-0.1, 0.0)) - b.point("collar", (0.02, 0.0))
    near([along @ between, across @ between], [0.25, 0.1])
    b.joint("revolute", "hinge", "lever", "base", (0.05, 0.02))
    b.joint("prismatic", "guide", "collar", "lever", (-0.1, 0.0), axis=0.3)
    assert b.lack() <= EXACT


# Motions with a closed form -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "points"])
def test_spring_and_damper_oscillate(kind: str) -> None:
    """x'' = -(k / m) (x - rest) - (c / m) x', the damped oscillation of every textbook."""
    k, c, rest, mass = 18.0, 0.9, 0.5, 2.0
    m = alfmu.Mechanism("oscillator")
    x = m.coordinate("x", "rad" if kind == "revolute" else "m", start=0.8, rate=-0.3, independent=True)
    if kind == "revolute":
        joint = m.revolute("J", m.ground.at(), m.body("wheel", mass=1.0, inertia=mass).at(), coordinate=x)
    else:
        cart = m.body("cart", mass=mass)
        joint = m.prismatic("J", m.ground.at(), cart.at(), axis=0.7, coordinate=x)
    m.spring_damper((m.ground.at(), cart.at()) if kind == "points" else joint, stiffness=k, damping=c, rest=rest)
    e = alfmu.derive(m)
    r = alfmu.simulate(e, 3.0, 0.01, parameters={"solver.method": "rk4", "solver.step_size": 0.005})
    decay = c / mass / 2
    w = np.sqrt(k / mass - decay**2)
    t = r.time
    want = rest + np.exp(-decay * t) * (0.3 * np.cos(w * t) + (-0.3 + decay * 0.3) / w * np.sin(w * t))
    got = r["wheel.angle" if kind == "revolute" else "cart.position"]
    # RK4: 9 rad / 120 (w h)^4 = 4e-9, twice that for safety.
    assert np.abs(got - want).max() <= 8e-9


@pytest.mark.parametrize("closed_by", ["coordinate", "constraints"])
def test_period_of_a_compound_pendulum(closed_by: str) -> None:
    """A body with its centre of mass anywhere and its pivot anywhere is where it began after one elliptic period."""
    mass, inertia, center, marker = 1.7, 0.12, (0.25, -0.3), (-0.1, 0.15)
    arm_ = np.array(center) - marker
    r, lean = np.hypot(*arm_), np.arctan2(arm_[1], arm_[0])
    amplitude = 2.0
    start = amplitude - np.pi / 2 - lean
    m = alfmu.Mechanism("compound")
    th = pose = None
    angle = m.start("angle", start, "rad")
    if closed_by == "coordinate":
        th = m.coordinate("th", "rad", start=angle)
    else:
        a = m.coordinate("a", "rad", start=angle)
        pose = (
            m.coordinate("x", "m", start=r * ca.cos(a + lean)),
            m.coordinate("y", "m", start=r * ca.sin(a + lean)),
            a,
        )
    body = m.body("body", mass=mass, inertia=inertia, center=center, pose=pose)
    m.revolute("pivot", m.ground.at(0.2, 0.1) if th is not None else m.ground.at(), body.at(*marker), coordinate=th)
    m.gravity(0.0, -G)
    w = np.sqrt(mass * G * r / (inertia + mass * r**2))
    swing = float(period(w, amplitude))
    result = alfmu.simulate(m, swing, swing / 400)
    # 400 steps a period: RK4 leaves (2 pi / 400)^4 / 120 of a radian per radian travelled, 4e-9, times its growth.
    assert abs(result["body.angle"][-1] - start) <= 1e-7
    assert abs(result["body.angular_velocity"][-1]) <= 1e-6
    half = result["body.angle"][200]
    assert abs(half - (start - 2 * amplitude)) <= 1e-7


def test_disk_that_rolls_down() -> None:
    """A pose that is any function of a coordinate: m r^2 3/2 for a disk that rolls, 2/3 g sin b down the slope."""
    radius, b = 0.3, 0.4
    m = alfmu.Mechanism("disk")
    th = m.coordinate("th", "rad")
    rolled = -radius * th
    x, y = np.cos(b) * rolled - np.sin(b) * radius, np.sin(b) * rolled + np.cos(b) * radius
    m.body("disk", mass=MASS, inertia=MASS * radius**2 / 2, pose=(x, y, th))
    r = still(m)
    near([r["disk.angular_acceleration"]], [2 / 3 * G * np.sin(b) / radius])


def test_general_level_says_the_same_as_bodies() -> None:
    """A bar on a hinge with a spring and an input, once by bodies and joints, once by energies and forces."""
    body = alfmu.Mechanism("bar")
    th = body.coordinate("th", "rad")
    hinge = body.revolute("A", body.ground.at(), body.bar("bar", mass=MASS, length=LENGTH).start, coordinate=th)
    body.drive(hinge, body.input("torque", "N.m"))
    body.spring_damper(hinge, stiffness=3.0, damping=0.4, rest=0.2)
    body.gravity(0.0, -G)
    level = alfmu.Mechanism("bar")
    th = level.coordinate("th", "rad")
    w = level.rate(th)
    level.kinetic_energy(MASS * LENGTH**2 / 6 * w**2)
    level.potential_energy(WEIGHT * LENGTH / 2 * ca.sin(th) + 1.5 * (th - 0.2) ** 2)
    level.generalized_force(th, level.input("torque", "N.m") - 0.4 * w)
    one, two = alfmu.derive(body), alfmu.derive(level)
    at = random_state(one, 5)
    for quantity in SIGNATURES:
        near(values(two, quantity, **at), values(one, quantity, **at))


def test_general_level_with_inertia_that_depends_on_place() -> None:
    """A double pendulum, once as two bars, once by the textbook's energies; polar coordinates, by hand."""
    masses, lengths = (1.3, 0.8), (0.7, 1.1)
    body = alfmu.Mechanism("double")
    a, b = body.coordinate("a", "rad"), body.coordinate("b", "rad")
    one, two = (body.bar(k, mass=x, length=y) for k, x, y in zip(("one", "two"), masses, lengths, strict=True))
    body.revolute("A", body.ground.at(), one.start, coordinate=a)
    body.revolute("B", one.end, two.start, coordinate=b)
    body.gravity(0.0, -G)
    level = alfmu.Mechanism("double")
    a, b = level.coordinate("a", "rad"), level.coordinate("b", "rad")
    wa, wb = level.rate(a), level.rate(a) + level.rate(b)
    (m1, m2), (l1, l2) = masses, lengths
    level.kinetic_energy((m1 / 6 + m2 / 2) * l1**2 * wa**2 + m2 * l2**2 / 6 * wb**2)
    level.kinetic_energy(m2 * l1 * l2 / 2 * ca.cos(b) * wa * wb)
    level.potential_energy(G * ((m1 / 2 + m2) * l1 * ca.sin(a) + m2 * l2 / 2 * ca.sin(a + b)))
    one, two = alfmu.derive(body), alfmu.derive(level)
    at = random_state(one, 6)
    for quantity in SIGNATURES:
        near(values(two, quantity, **at), values(one, quantity, **at))
    polar = alfmu.Mechanism("polar")
    r, phi = polar.coordinate("r", "m"), polar.coordinate("phi", "rad")
    polar.kinetic_energy(MASS / 2 * (polar.rate(r) ** 2 + r**2 * polar.rate(phi) ** 2))
    e = alfmu.derive(polar)
    near(values(e, "d", q=[0.6, 1.0], v=[0.7, -1.3], p=[]), [-MASS * 0.6 * 1.3**2, 2 * MASS * 0.6 * 0.7 * -1.3])


def spherical(rate: float) -> alfmu.Equations:
    """A point mass in x y z on a rod of 1 m, 0.6 m off the axis, thrown sideways."""
    m = alfmu.Mechanism("spherical")
    x = m.coordinate("x", "m", start=0.6, independent=True)
    y = m.coordinate("y", "m", start=0.0, rate=rate, independent=True)
    z = m.coordinate("z", "m", start=-0.8)
    m.kinetic_energy(MASS * (m.rate(x) ** 2 + m.rate(y) ** 2 + m.rate(z) ** 2) / 2)
    m.potential_energy(WEIGHT * z)
    m.constraint("rod", ca.sqrt(x**2 + y**2 + z**2) - 1.0, "m")
    for name, c in (("x", x), ("y", y), ("z", z)):
        m.output(f"bob.{name}", c, "m")
    m.output("bob.spin", MASS * (x * m.rate(y) - y * m.rate(x)), "1")
    return alfmu.derive(m)


def test_conical_pendulum() -> None:
    """A spatial mechanism at the general level: thrown at w = sqrt(g / h), it circles, with a tension of m g l / h."""
    w = np.sqrt(G / 0.8)
    r = alfmu.simulate(spherical(0.6 * w), 4.0, 0.01, parameters={"solver.method": "rk4", "solver.step_size": 0.005})
    circle = np.array([0.6 * np.cos(w * r.time), 0.6 * np.sin(w * r.time), np.full_like(r.time, -0.8)])
    # RK4 lags by (w h)^4 w t / 120 = 1e-8 m; the tension follows with its own frequency squared.
    assert np.abs(np.array([r["bob.x"], r["bob.y"], r["bob.z"]]) - circle).max() <= 4e-8
    assert np.abs(r["multiplier[1]"] - WEIGHT / 0.8).max() <= 4e-7


def test_spherical_pendulum_conserves() -> None:
    """Energy and the angular momentum about the vertical stay, while it rises and falls."""
    r = alfmu.simulate(spherical(1.0), 4.0, 0.01, parameters={"solver.method": "rk4", "solver.step_size": 0.0025})
    assert np.ptp(r["bob.z"]) > 0.1
    assert np.ptp(r["bob.spin"]) <= 1e-8
    assert np.ptp(r["monitor.energy"]) <= 1e-8 * WEIGHT
    assert r.counters.energy_error == pytest.approx(np.ptp(r["monitor.energy"]), abs=1e-8)


# Declarations that have no equations ----------------------------------------------------------------------------------


def _unplaced(m: alfmu.Mechanism) -> None:
    m.coordinate("x", "m")
    m.body("loose", mass=1.0)


def _circle(m: alfmu.Mechanism) -> None:
    one, two = m.body("one", mass=1.0), m.body("two", mass=1.0)
    m.revolute("J", one.at(), two.at(), coordinate=m.coordinate("a"))
    m.revolute("K", two.at(1.0), one.at(1.0), coordinate=m.coordinate("b"))


def _foreign(m: alfmu.Mechanism) -> None:
    x = m.coordinate("x", "m")
    m.body("cart", mass=1.0, pose=(x, 0.0, 0.0))
    m.generalized_force(x, ca.SX.sym("stranger"))


def _gap(m: alfmu.Mechanism) -> None:
    cart = m.body("cart", mass=1.0, pose=(m.coordinate("x", "m"), 0.0, 0.0))
    m.prismatic("guide", m.ground.at(0.0, 0.5), cart.at())


def _twice(m: alfmu.Mechanism) -> None:
    m.coordinate("x", "m")
    m.body("x", mass=1.0)


def _itself(m: alfmu.Mechanism) -> None:
    body = m.body("body", mass=1.0)
    m.revolute("J", body.at(), body.at(1.0))


def _both_placed(m: alfmu.Mechanism) -> None:
    body = m.body("body", mass=1.0, pose=(m.coordinate("x", "m"), 0.0, 0.0))
    m.revolute("J", m.ground.at(), body.at(), coordinate=m.coordinate("a"))


@pytest.mark.parametrize(
    ("declare", "says"),
    [
        (_unplaced, "nothing places loose"),
        (_circle, "place each other in a circle"),
        (_foreign, "stranger"),
        (_gap, "guide leaves a gap"),
        (_twice, "'x' is a coordinate already"),
        (_itself, "connects body to itself"),
        (lambda m: m.revolute("J", m.body("body", mass=1.0).at(), m.ground.at()), "ends on the ground"),
        (lambda m: m.drive(m.weld("J", m.ground.at(), m.body("b", mass=1.0).at()), 1.0), "J is a weld"),
        (_both_placed, "are placed already"),
        (lambda m: m.parameter("k", 1.0, "furlong"), "unknown unit 'furlong'"),
        (lambda m: m.parameter("k", -1.0, "m", minimum=0.0), "outside"),
        (lambda m: None, "at least one coordinate"),
        (lambda m: m.rate(ca.SX.sym("z")), "not a coordinate"),
        (lambda m: m.coordinate("start.x", "m"), "alfmu uses itself"),
    ],
)
def test_declaration_without_equations_says_why(declare, says: str) -> None:
    """DeclarationError names the mechanism (units excepted) and the culprit."""
    m = alfmu.Mechanism("odd")

    def attempt() -> None:
        declare(m)
        alfmu.derive(m)

    with pytest.raises(alfmu.DeclarationError, match=says):
        attempt()


def test_an_angle_of_natural_coordinates_is_that_of_its_points() -> None:
    """atan2 of the points, by hand."""
    e = derived("slider_crank", coordinates="natural")
    q = [0.3, -0.2, 0.9, 0.1]
    r = evaluate(e, q, np.zeros(4), np.zeros(2))
    poses = mechanisms.natural_poses([mpf(x) for x in q], mpf(0), mpf(0.5), mpf(1))
    near([r["crank.angle"], r["rod.angle"]], [float(atan2(mpf(q[1]), mpf(q[0]))), float(poses[1][2])])
