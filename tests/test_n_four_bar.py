"""The N-four-bar in both coordinate sets: accelerations, all joint forces and motion of its one degree of freedom."""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from scenes import derived, readings, started

import alfmu
from alfmu.view.picture import model_png

COORDINATES = ("natural", "absolute")

scenes = pytest.mark.parametrize("loops", [1, 2, 10])
coordinate_sets = pytest.mark.parametrize("coordinates", COORDINATES)
states = pytest.mark.parametrize(
    ("th", "w", "torque"), [(np.pi / 2, -1.0, 0.0), (0.9, 3.0, 2.5), (-2.1, -4.0, -7.0)], ids=["up", "driven", "below"]
)


@dataclass(frozen=True)
class Row:
    """Parallel cranks at one angle th, couplers that do not turn; links of equal mass and length, torque on crank 1.

    T = ((N + 1) m l^2 / 3 + N m l^2) w^2 / 2 and V = ((N + 1) / 2 + N) m g l sin th give

        (4 N + 1) / 3 m l^2 th'' = torque - (3 N + 1) / 2 m g l cos th.
    """

    loops: int
    m: float = 1.0
    l: float = 1.0
    g: float = 9.81

    def acceleration(self, th: float, torque: float = 0.0) -> float:
        weight = (3 * self.loops + 1) / 2 * self.m * self.g * self.l
        return (torque - weight * np.cos(th)) / ((4 * self.loops + 1) / 3 * self.m * self.l**2)

    def energy(self, th: float, w: float) -> float:
        cranks = (self.loops + 1) * (self.m * self.l**2 * w**2 / 6 + self.m * self.g * self.l / 2 * np.sin(th))
        return cranks + self.loops * (self.m * self.l**2 * w**2 / 2 + self.m * self.g * self.l * np.sin(th))

    def forces(self, th: float, w: float, torque: float = 0.0) -> tuple[dict[str, float], float]:
        """Joint forces on the second body by Newton's law, crank by crank, and the moment left on the last crank.

        A coupler that does not turn is carried by both ends alike along y; the moment about A of a crank gives the
        force along x that it passes on.
        """
        m, l, g = self.m, self.l, self.g
        c, s, e = np.cos(th), np.sin(th), self.acceleration(th, torque)
        tip = l * np.array([-s * e - c * w**2, c * e - s * w**2])
        weight = np.array([0.0, m * g])
        coupler = m * tip + weight  # what its two ends carry together
        found, last = {}, np.zeros(2)
        for i in range(1, self.loops + 2):
            moment = m * l**2 / 3 * e + m * g * l / 2 * c - (torque if i == 1 else 0.0)  # l (c ry - s rx)
            if i <= self.loops:
                first = np.array([0.0, coupler[1] / 2])
                ry = -first[1] - last[1]
                first[0] = -(c * ry - moment / l) / s - last[0]
            else:
                first = np.zeros(2)
            r = -first - last  # on the crank at its tip
            found |= {f"A{i}": m * tip / 2 + weight - r}
            left = moment - l * (c * r[1] - s * r[0])
            if i <= self.loops:
                last = coupler - first
                found |= {f"B{i}": first, f"C{i}": last}
        return {
            f"{joint}.force.{k}": float(x) for joint, f in found.items() for k, x in zip("xy", f, strict=True)
        }, left


@cache
def at(loops: int, coordinates: str, th: float, w: float, torque: float, **sizes: float) -> dict[str, float]:
    """All outputs at a state of the branch."""
    given = {"start.angle": th, "start.angular_velocity": w, "A1.torque": torque, **sizes}
    return readings(started(derived("n_four_bar", loops=loops, coordinates=coordinates), given))


@scenes
@states
def test_reference_balances_the_last_crank(loops: int, th: float, w: float, torque: float) -> None:
    """The moments of the cranks, one after the other, lead to the acceleration that the energies give."""
    assert abs(Row(loops).forces(th, w, torque)[1]) <= 1e-12 * loops


@scenes
def test_reference_keeps_its_energy(loops: int) -> None:
    row = Row(loops)
    motion = ode.motion(lambda t, th, w: row.acceleration(th), np.pi / 2, -1.0, np.linspace(0.0, 0.5, 11))
    assert np.ptp([row.energy(*x) for x in motion]) <= 1e-12 * row.energy(np.pi / 2, -1.0)


@pytest.mark.slow
@scenes
def test_coordinates_and_constraints_leave_one_degree_of_freedom(loops: int) -> None:
    natural, absolute = (derived("n_four_bar", loops=loops, coordinates=c) for c in COORDINATES)
    assert (natural.n, natural.l) == (2 * (loops + 1), 2 * loops + 1)
    assert (absolute.n, absolute.l) == (3 * (2 * loops + 1), 6 * loops + 2)
    for equations in (natural, absolute):
        mobility = started(equations).mobility()
        assert (mobility.freedom, mobility.redundant) == (1, 0)


@pytest.mark.slow
def test_the_upper_points_start_at_one_metre_per_second_along_x() -> None:
    """Half of it at the centres of the cranks."""
    for coordinates in COORDINATES:
        r = readings(started(derived("n_four_bar", coordinates=coordinates)))
        assert [r[f"crank{i}.{k}"] for i in (1, 2, 3) for k in ("vx", "vy")] == pytest.approx([0.5, 0.0] * 3, abs=1e-15)
        assert [r["coupler2.x"], r["coupler2.y"], r["coupler2.vx"]] == pytest.approx([1.5, 1.0, 1.0], abs=1e-15)


@pytest.mark.slow
@scenes
@coordinate_sets
@states
def test_accelerations_and_forces(coordinates: str, loops: int, th: float, w: float, torque: float) -> None:
    """The end of crank 1, the angle of every crank, and the force in every joint, with sizes other than the defaults.

    |sin th| > 0.7, so round-off grows with the number of joints that a force passes through, and no more.
    """
    row = Row(loops, m=0.7, l=1.2)
    r = at(loops, coordinates, th, w, torque, m=row.m, l=row.l)
    e = row.acceleration(th, torque)
    tip = row.l * np.array([-np.sin(th) * e - np.cos(th) * w**2, np.cos(th) * e - np.sin(th) * w**2])
    assert 2 * np.array([r["crank1.ax"], r["crank1.ay"]]) == pytest.approx(tip, rel=1e-13, abs=1e-12)
    assert [r[f"crank{i + 1}.angular_acceleration"] for i in range(loops + 1)] == pytest.approx(
        [e] * (loops + 1), rel=1e-12, abs=1e-12
    )
    forces, _ = row.forces(th, w, torque)
    assert len(forces) == 2 * (3 * loops + 1)
    largest = max(map(abs, forces.values()))
    assert max(abs(r[name] - x) for name, x in forces.items()) <= 1e-13 * (loops + 1) * largest


@scenes
@states
def test_both_sets_of_coordinates_say_the_same(loops: int, th: float, w: float, torque: float) -> None:
    """Everything that both can read, but multipliers and what the run itself took."""
    natural, absolute = (at(loops, c, th, w, torque, m=0.7, l=1.2) for c in COORDINATES)
    names = [n for n in natural if not n.startswith(("multiplier", "monitor"))]
    assert set(names) == {n for n in absolute if not n.startswith(("multiplier", "monitor"))}
    largest = max(abs(natural[n]) for n in names)
    assert max(abs(natural[n] - absolute[n]) for n in names) <= 1e-13 * (loops + 1) * largest


@pytest.mark.slow
@scenes
@coordinate_sets
def test_motion(coordinates: str, loops: int) -> None:
    """Half a second from the benchmark's start to where the cranks lean by 45 degrees, far from any singular position.

    RK4 at 1 ms leaves (3.4 rad/s h)^4 of a swing of 1 rad, so 1e-10 rad.
    """
    equations = derived("n_four_bar", loops=loops, coordinates=coordinates)
    r = alfmu.simulate(equations, 0.5, 0.05, parameters={"solver.method": "rk4", "solver.step_size": 0.001})
    row = Row(loops)
    exact = ode.motion(lambda t, th, w: row.acceleration(th), np.pi / 2, -1.0, r.time)
    assert exact[-1, 0] > 0.5
    for i in (1, loops + 1):
        assert np.abs(r[f"crank{i}.angle"] - exact[:, 0]).max() <= 1e-9
    assert np.abs(r[f"coupler{loops}.angle"]).max() <= 1e-9
    assert r.counters.position_error <= 1e-12


@pytest.mark.slow
def test_a_hundred_loops() -> None:
    """All cranks of so many loops turn alike, by a kernel that is not one flat function; `test_large` has bodies."""
    r = alfmu.simulate(derived("n_four_bar", loops=100), 0.2, 0.02)
    exact = ode.motion(lambda t, th, w: Row(100).acceleration(th), np.pi / 2, -1.0, r.time)[:, 0]
    assert max(np.abs(r[f"crank{i}.angle"] - exact).max() for i in (1, 50, 101)) <= 1e-7
    assert r.counters.position_error <= 1e-12


@pytest.mark.slow
@coordinate_sets
def test_equations_grow_linearly_with_the_loops(coordinates: str) -> None:
    """As many more entries of matrices and operations from 20 to 26 loops as from 14 to 20."""
    sizes = []
    for loops in (14, 20, 26):
        e = derived("n_four_bar", loops=loops, coordinates=coordinates)
        matrices = [getattr(e, name).nnz_out() for name in ("M", "C", "gaps_matrix", "ties_matrix")]
        assert max(matrices) <= 24 * loops
        operations = [getattr(e, name).n_instructions() for name in ("M", "C", "d", "f", "xi", "gaps", "readings")]
        sizes.append([*matrices, *operations])
    assert np.array_equal(np.diff(sizes, 2, axis=0), np.zeros((1, len(sizes[0]))))


@pytest.mark.parametrize("given", [3, 3.0, "3", "3.0"])
def test_loops_are_a_whole_number_however_written(given: float | str) -> None:
    mechanism = alfmu.load("n_four_bar", loops=given)
    assert len(mechanism.bodies) == 7
    assert mechanism.options == {"loops": 3, "coordinates": "natural"}
    assert isinstance(mechanism.options["loops"], int)


@pytest.mark.parametrize("bad", [0, -2.0, 2.5, "many", "", float("nan"), float("inf"), None])
def test_other_loops_are_refused(bad: object) -> None:
    with pytest.raises(alfmu.InputError, match=r"n_four_bar: option loops is .*; use a whole number"):
        alfmu.load("n_four_bar", loops=bad)


def test_other_coordinates_are_refused() -> None:
    with pytest.raises(alfmu.InputError, match="option coordinates is 'joint'; use one of natural, absolute"):
        alfmu.load("n_four_bar", coordinates="joint")


@pytest.mark.parametrize("loops", [1, 10])
def test_both_sets_of_coordinates_have_a_picture(loops: int) -> None:
    for coordinates in COORDINATES:
        mechanism = alfmu.load("n_four_bar", loops=loops, coordinates=coordinates)
        assert model_png(mechanism, {}).startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("turned", range(4))
def test_reactions_where_three_bodies_share_a_point_do_not_depend_on_the_order_of_joints(turned):
    """Joints B and C from crank to coupler or from coupler to crank: natural coordinates against absolute ones."""
    values = []
    for natural in (False, True):
        m = alfmu.Mechanism("row")
        th = m.start("angle", 1.1, "rad", rate=-1.0, rate_name="rate")
        ends = [(i + ca.cos(th), ca.sin(th)) for i in range(3)]
        if natural:
            points = [
                m.point(m.coordinate(f"x{i}", "m", start=x), m.coordinate(f"y{i}", "m", start=y))
                for i, (x, y) in enumerate(ends)
            ]
            m.tie(th, ca.atan2(points[0].y, points[0].x))
            placed = [{"between": (m.ground.at(i, 0.0), points[i])} for i in range(3)]
            placed += [{"between": (points[i], points[i + 1])} for i in range(2)]
        else:
            places = [(i + ca.cos(th) / 2, ca.sin(th) / 2, th) for i in range(3)]
            places += [(x + 0.5, y, 0.0) for x, y in ends[:2]]
            placed = [
                {
                    "pose": tuple(
                        m.coordinate(f"{k}{i}", "rad" if k == "a" else "m", start=s)
                        for k, s in zip("xya", place, strict=True)
                    )
                }
                for i, place in enumerate(places)
            ]
            m.tie(th, placed[0]["pose"][2])
        bars = [m.bar(f"bar{i}", mass=1.0, length=1.0, **place) for i, place in enumerate(placed)]
        cranks, couplers = bars[:3], bars[3:]
        for i in range(3):
            m.revolute(f"A{i}", m.ground.at(i, 0.0), cranks[i].start)
        for i in range(2):
            for name, bit, pair in (
                ("B", 1, (cranks[i].end, couplers[i].start)),
                ("C", 2, (cranks[i + 1].end, couplers[i].end)),
            ):
                m.revolute(f"{name}{i}", *(pair[::-1] if turned & bit else pair))
        m.gravity(0.0, -9.81)
        instance = started(alfmu.derive(m))
        names = [v.name for v in instance.outputs if ".force." in v.name]
        values.append({name: instance.get(name) for name in names})
    assert len(values[0]) == 14
    assert values[1] == pytest.approx(values[0], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("loops", [2, 10])
def test_a_drive_at_one_crank_passes_singular_positions_at_full_order(loops):
    """6 N.m at A1 alone, so that couplers carry it to the other cranks, through both singular positions in 5 s."""
    inertia, weight = (4 * loops + 1) / 3, (3 * loops + 1) / 2 * 9.81
    times = np.linspace(0.0, 5.0, 101)

    def rate(x: float, v: float) -> float:
        return (6.0 - weight * np.cos(x)) / inertia

    exact = ode.motion(lambda t, x, v: rate(x, v), np.pi / 2, -1.0, times)[:, 0]
    assert exact.min() < -np.pi
    errors = {}
    for coordinates, step in (("absolute", 0.005), ("natural", 0.005), ("natural", 0.0025)):
        i = started(derived("n_four_bar", loops=loops, coordinates=coordinates), {"A1.torque": 6.0}, step_size=step)
        worst = 0.0
        for k in range(1, 101):
            i.step(times[k] - times[k - 1])
            worst = max(worst, abs(i.get("crank1.angle") - exact[k]))
        errors[coordinates, step] = worst
        assert i.counters.unprojected == 0
        assert i.counters.unconverged <= 3  # read where reactions have a pole
    plain = ode.plain_steps(rate, np.pi / 2, -1.0, 0.005, 1000)[::10]
    assert errors["absolute", 0.005] <= 2 * np.abs(plain - exact).max()
    assert errors["natural", 0.005] > 14 * errors["natural", 0.0025]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("l", "given", "torque"),
    [
        (2.6, {"m": 5.0, "g": 22.6, "start.angle": 1.48, "start.angular_velocity": -1.25}, -60.6),
        (1.66, {"m": 1.51, "g": 2.0, "start.angle": 1.3, "start.angular_velocity": -2.64}, 0.103),
    ],
)
def test_long_links_pass_singular_positions(l, given, torque):
    """Lengths, gravity and torques in proportion leave the angles of a motion as they are."""

    def run(by: float) -> alfmu.Result:
        parameters = {**given, "l": l * by, "g": given["g"] * by}
        return alfmu.simulate(
            derived("n_four_bar"), 2.0, 0.02, parameters=parameters, inputs={"A1.torque": torque * by**2}
        )

    usual, long = run(1 / l), run(1.0)
    assert np.ptp(usual["crank1.angle"]) > np.pi
    assert long["crank1.angle"] == pytest.approx(usual["crank1.angle"], abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "order8"])
@pytest.mark.parametrize(
    ("row", "th", "w", "torque"),
    [
        (
            Row(2, 2.13288279257949, 6.630464526769515, 7.645315553663511),
            -2.7863714778975397,
            3.0103818620836567,
            105.274900794,
        ),
        (Row(2, 3.962931103739716, 3.289434374634343, 14.2866982415673), 0.0322019597676273, -0.6084486, 5.75072578185),
    ],
)
def test_a_step_that_ends_beside_a_singular_position_is_closed(row, th, w, torque, method):
    """A few 1e-5 rad beside it corrections of velocities gain a fifth each, and the runs ended."""
    times = np.linspace(0.0, 4.0, 401)
    exact = ode.motion(lambda t, x, v: row.acceleration(x, torque), th, w, times)[:, 0]
    given = {
        "l": row.l,
        "m": row.m,
        "g": row.g,
        "start.angle": th,
        "start.angular_velocity": w,
        "solver.method": method,
    }
    r = alfmu.simulate(derived("n_four_bar"), 4.0, 0.01, parameters=given, inputs={"A1.torque": torque})
    assert r["crank1.angle"] == pytest.approx(exact, abs=1e-7)
    assert np.abs(r["monitor.velocity_error"]).max() < 1e-12
