"""Methods as data: order conditions, observed orders, stability, step control; implicit forms against differences."""

import casadi as ca
import numpy as np
import pytest
from oracles.adaptive import Adaptive, Control, collocation, collocation_error, tolerance
from oracles.parallelogram import Parallelogram
from scenes import derived

from alfmu.method import implicit, stepping
from alfmu.method.stepping import EXPLICIT5, EXPLICIT8, EXPLICIT8_BESIDE, RADAU9, combined, continued, explicit, landing
from alfmu.simulation import oracle

EXPLICITS = {"5(4)": EXPLICIT5, "8(7)": EXPLICIT8, "8(7) beside": EXPLICIT8_BESIDE}
RADAUS = {"Radau 9": RADAU9}

each_explicit = pytest.mark.parametrize("name", EXPLICITS)
each_radau = pytest.mark.parametrize("name", RADAUS)


# Coefficients -----------------------------------------------------------------------------------------------------


def matrix(method) -> np.ndarray:
    a = np.zeros((len(method.nodes),) * 2)
    for i, row in enumerate(method.stages, 1):
        a[i, :i] = row
    return a


def trees(order: int, a: np.ndarray) -> list[tuple[np.ndarray, float, int]]:
    """Elementary weights (before b), densities and orders of all rooted trees up to an order (Butcher)."""
    found: list[list[tuple[np.ndarray, float, tuple]]] = [[(np.ones(len(a)), 1.0, ())]]
    for n in range(2, order + 1):
        level, seen = [], set()
        for parts in partitions(n - 1):
            for children in choices(parts, found):
                key = tuple(sorted(c[2] for c in children))
                if key in seen:
                    continue
                seen.add(key)
                weight = np.prod([a @ c[0] for c in children], axis=0)
                level.append((weight, n * float(np.prod([c[1] for c in children])), key))
        found.append(level)
    return [(w, density, n) for n, level in enumerate(found, 1) for w, density, _ in level]


def partitions(n: int, largest: int | None = None):
    if n == 0:
        yield ()
    for k in range(min(n, largest or n), 0, -1):
        for rest in partitions(n - k, k):
            yield (k, *rest)


def choices(parts: tuple[int, ...], found: list):
    if not parts:
        yield ()
        return
    for rest in choices(parts[1:], found):
        for tree in found[parts[0] - 1]:
            yield (tree, *rest)


def test_every_rule_has_a_name_of_its_own():
    """A scene says by its name which rule it carries."""
    rules = [each for each in vars(stepping).values() if isinstance(each, stepping.Explicit | stepping.Collocation)]
    assert len({rule.name for rule in rules}) == len(rules) >= 5


@each_explicit
def test_explicit_methods_meet_all_conditions_of_their_order(name):
    method = EXPLICITS[name]
    a, b = matrix(method), np.array(method.weights)
    conditions = trees(method.order, a)
    assert len(conditions) == {5: 17, 8: 200}[method.order]
    assert max(abs(b @ w - 1 / density) for w, density, _ in conditions) <= 1e-12
    assert np.abs(a.sum(axis=1) - method.nodes).max() <= 1e-13


@each_explicit
def test_estimates_vanish_up_to_their_order(name):
    method = EXPLICITS[name]
    a, b = matrix(method), method.weights
    if method.reuses:
        n = len(b) + 1
        a = np.vstack([np.hstack([a, np.zeros((n - 1, 1))]), [*b, 0.0]])
    order = method.estimate
    for errors in method.errors:
        values = [(abs(np.dot(errors, w)), n) for w, _, n in trees(order + 1, a)]
        assert max(x for x, n in values if n <= order) <= 1e-12
        assert max(x for x, n in values if n == order + 1) > 1e-8


@each_radau
def test_radau_methods_meet_the_simplifying_assumptions(name):
    """B(2 s - 1) and C(s) are enough for the order; the embedded method is of order s."""
    method = RADAUS[name]
    a, c = np.array(method.matrix), np.array(method.nodes)
    s, b = len(c), a[-1]
    assert c[-1] == 1.0
    for k in range(1, 2 * s):
        assert b @ c ** (k - 1) == pytest.approx(1 / k, abs=1e-14)
    for k in range(1, s + 1):
        assert np.abs(a @ c ** (k - 1) - c**k / k).max() <= 1e-14
        assert method.gamma * (k == 1) + np.dot(method.errors, c ** (k - 1)) == pytest.approx(0.0, abs=1e-14)
    assert min(abs(np.linalg.eigvals(a) - method.gamma)) <= 1e-13
    assert (method.order, method.estimate) == (2 * s - 1, s)


# Stability --------------------------------------------------------------------------------------------------------


def damping(method, z: complex) -> complex:
    """The stability function, by a step of y' = z y."""
    a = np.array(method.matrix)
    return 1 + z * a[-1] @ np.linalg.solve(np.eye(len(a)) - z * a, np.ones(len(a)))


@pytest.mark.parametrize("method", RADAUS.values(), ids=RADAUS)
def test_stiff_methods_are_l_stable(method):
    assert abs(damping(method, -1e9)) <= 1e-6
    axis = 1j * np.logspace(-3, 5, 400)
    assert max(abs(damping(method, z)) for z in axis) <= 1 + 1e-9
    for angle in np.linspace(np.pi / 2, np.pi, 7):
        assert max(abs(damping(method, r * np.exp(1j * angle))) for r in np.logspace(-2, 4, 60)) <= 1 + 1e-9


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.8, 1.0])
def test_generalised_alpha_has_the_radius_asked_for(radius):
    """Of the map of (q, dt v, dt^2 w) for x'' = -(big)^2 x."""
    rule, stiff, columns = implicit.damped(radius), 1e8, []
    for q, v, w in np.eye(3):
        a = -stiff * q
        by_a = implicit.changes(rule, 1.0)[1]
        free = implicit.moved(rule, 1.0, q, v, w, a, 0.0)[0]
        change = -(stiff * free + a) / (1 + stiff / by_a)
        columns.append(implicit.moved(rule, 1.0, q, v, w, a, change))
    assert max(abs(np.linalg.eigvals(np.array(columns).T))) == pytest.approx(radius, abs=5e-3)


# Orders -----------------------------------------------------------------------------------------------------------


def rate(t, y):
    return np.array([y[1], -np.sin(y[0]) - 0.1 * y[1] + 0.3 * np.cos(2 * t)])


def tangent(t, y):
    return np.array([[0.0, 1.0], [-np.cos(y[0]), -0.1]])


def implicit_step(method, t, y, dt, k):
    eye = np.eye(len(y))

    def correct(tangents, residues):
        a, nodes = method.matrix, range(len(method.nodes))
        blocks = [[(i == j) * eye - dt * a[i][j] * tangents[i] for j in nodes] for i in nodes]
        return np.split(np.linalg.solve(np.block(blocks), np.concatenate(residues)), len(nodes))

    def done(changes, _):
        return np.abs(changes).max() <= 1e-14

    y, k, _, converged = collocation(method, lambda t, y: (rate(t, y), tangent(t, y)), correct, t, y, dt, k, 9, done)
    assert converged
    return y, k


def ends(method, steps: int) -> tuple[np.ndarray, float]:
    """The state after 2 s, and the error estimated in the first step."""
    y, dt, k, estimate = np.array([1.0, 0.5]), 2.0 / steps, None, None
    for i in range(steps):
        t, begin = i * dt, y
        if method in EXPLICITS.values():
            y, errors, _ = explicit(method, rate, t, y, dt)
        else:
            k = [rate(t, y)] * len(method.nodes) if k is None else continued(method, k, 1.0)
            y, k = implicit_step(method, t, y, dt, k)
            j = tangent(t, begin)
            errors = [
                collocation_error(
                    method, lambda s, r, j=j: np.linalg.solve(np.eye(2) - s * j, r), rate(t, begin), k, dt
                )
            ]
        estimate = max(np.abs(e).max() for e in errors) if estimate is None else estimate
    return y, estimate


ALL = {**EXPLICITS, **RADAUS}


@pytest.mark.parametrize("name", ALL)
def test_orders_are_as_stated(name):
    method = ALL[name]
    exact, _ = ends(EXPLICIT8, 200)
    steps = {4: (16, 32), 5: (8, 16), 8: (4, 8), 9: (2, 4)}[method.order]
    (coarse, first), (fine, second) = (ends(method, n) for n in steps)
    observed = np.log2(np.abs(coarse - exact).max() / np.abs(fine - exact).max())
    assert observed >= method.order - 0.5
    assert np.log2(first / second) >= method.estimate + 1 - 0.7


@each_explicit
def test_symbols_and_a_known_first_rate_give_the_same_step(name):
    method = EXPLICITS[name]
    y = np.array([1.0, 0.5])
    after, errors, last = explicit(method, rate, 0.3, y, 0.1)
    again, _, _ = explicit(method, rate, 0.3, y, 0.1, rate(0.3, y))
    assert np.array_equal(after, again)
    s, t, dt = ca.SX.sym("y", 2), ca.SX.sym("t"), ca.SX.sym("dt")

    def symbolic(t, y):
        return ca.vertcat(y[1], -ca.sin(y[0]) - 0.1 * y[1] + 0.3 * ca.cos(2 * t))

    found, estimates, _ = explicit(method, symbolic, t, s, dt)
    step = ca.Function("step", [t, s, dt], [found, *estimates])(0.3, y, 0.1)
    for value, expected in zip(step, [after, *errors], strict=True):
        assert np.abs(np.array(value).ravel() - expected).max() <= 1e-15
    assert (last is not None) == method.reuses
    if method.reuses:
        assert np.array_equal(last, rate(0.4, after))


@each_radau
def test_the_guess_of_the_next_step_is_the_polynomial(name):
    method = RADAUS[name]
    degree = len(method.nodes) - 1
    k = [np.array([(0.2 + c) ** degree]) for c in method.nodes]
    guess = continued(method, k, 0.7)
    assert [x[0] for x in guess] == pytest.approx([(1.2 + 0.7 * c) ** degree for c in method.nodes], rel=1e-11)


def test_combined_leaves_out_what_has_no_weight():
    assert combined((0.0, 2.0), [np.nan, 3.0]) == 6.0
    assert combined((0.0,), [np.nan], 1.0) == 1.0


# Step control -----------------------------------------------------------------------------------------------------


def test_landing_leaves_no_tiny_step():
    assert landing(0.3, 0.3 * (1 + 1e-12)) == 0.3 * (1 + 1e-12)
    assert landing(0.3, 0.31) == 0.155
    assert landing(0.3, 1.0) == 0.3
    left, steps = 1.0, []
    while left > 0:
        steps.append(landing(0.3, left))
        left = 0.0 if steps[-1] == left else left - steps[-1]
    assert min(steps) > 0.19


def test_a_step_cut_to_land_is_forgotten():
    control = Control(5, 0.3)
    assert control.propose(0.1) == 0.1
    assert control.judge(0.1, 1e-6)
    assert control.dt >= 0.3
    before = control.dt
    for _ in range(50):
        assert control.judge(control.propose(0.01), 1e-9)
    assert control.dt == before  # neither forgotten nor grown beyond what was tried


def test_refused_steps_shrink_and_do_not_grow_at_once():
    control = Control(5, 1.0)
    assert not control.judge(1.0, 32.0)
    assert control.dt == pytest.approx(0.45)
    assert control.judge(0.45, 1e-3)
    assert control.dt == 0.45
    assert control.judge(0.45, 1e-3)
    assert control.dt > 0.45
    for error in (np.nan, np.inf):
        control = Control(5, 1.0)
        assert not control.judge(1.0, error)
        assert 0 < control.dt < 1


@pytest.mark.parametrize("method", [EXPLICIT5, EXPLICIT8], ids=["5(4)", "8(7)"])
@pytest.mark.parametrize("every", [2.0, 0.05])
def test_the_error_follows_the_tolerance_and_steps_are_few(method, every):
    exact, _ = ends(EXPLICIT8, 200)
    counts = []
    for run in (1e-6, 1e-9):
        y, t, control, count, refused = np.array([1.0, 0.5]), 0.0, Control(method.estimate + 1, 1e-3), 0, 0
        for k in range(1, round(2.0 / every) + 1):
            end = k * every
            while t < end:
                dt = control.propose(end - t)
                after, errors, _ = explicit(method, rate, t, y, dt)
                scale = tolerance(method, run) * (1 + np.abs(y))
                if control.judge(dt, max(np.abs(e / scale).max() for e in errors)):
                    t, y, count = (end if dt == end - t else t + dt), after, count + 1
                else:
                    refused += 1
        assert np.abs(y - exact).max() <= run
        assert refused <= 3
        counts.append(count)
    if every == 0.05:
        assert counts[0] <= {5: 90, 8: 48}[method.order]  # the first steps are short, then one or two for each


# Implicit forms of mechanisms -------------------------------------------------------------------------------------


def adaptive(name, rule, run, parameters=(), inputs=(), fixed=None) -> Adaptive:
    i = oracle.Instance(derived(name))
    for key, value in [*dict(parameters).items(), *dict(inputs).items()]:
        i.set(key, value)
    i.initialize()
    u = i.inputs.copy()
    found = Adaptive(i, rule, lambda t: u, run, run)
    found.place(0.0, i.q, i.v, 0.0)
    found.fixed = fixed
    return found


@pytest.mark.parametrize("name", ["five_bar", "slider_crank"])
def test_tangents_are_the_derivatives_of_the_accelerations(name):
    """With redundant constraints too: along displacements that keep them, as no others have a meaning there."""
    a = adaptive(name, RADAU9, 1e-6, {"start.angle": 0.7})
    a.advance(0.2)
    q, v, o = a.q, a.v, a.oracle
    _, aq, av, _, _, (C, solve, Xv) = a.tangent(q, v, a.x, 0.2)
    n = len(q)
    T, S = implicit.return_map(C, o.alpha, solve, Xv, np.eye(n), 4)
    by_q, by_v = implicit.on_branch(aq, av, T, S)
    h = 1e-5
    for direction in np.random.default_rng(1).standard_normal((4, 2, n)):
        dq, dv = T @ direction[0], S @ direction[0] + T @ direction[1]
        ends = [o.on_branch(q + k * h * dq, v + k * h * dv) for k in (-1, 1)]
        low, high = (o.accelerations(*place, a.inputs(0.2), 0.2)[0] for place in ends)
        expected = (high - low) / (2 * h)
        found = by_q @ direction[0] + by_v @ direction[1]
        assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max()


FOUR_BAR = Parallelogram(m4=None)


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "bound"), [(EXPLICIT5, 3.0), (EXPLICIT8, 3.0), (RADAU9, 3.0)])
def test_a_driven_four_bar_passes_singular_positions_within_the_tolerance(rule, bound):
    run = 1e-6
    a = adaptive("four_bar", rule, tolerance(rule, run), {"solver.tolerance": 1e-15}, {"A.torque": 4.0})
    times = np.linspace(0.0, 5.0, 11)
    exact = FOUR_BAR.driven(0.0, 2.0, times, 4.0)[:, 0]
    for t, th in zip(times[1:], exact[1:], strict=True):
        a.advance(t)
        assert abs(a.q[0] - th) <= bound * run * (1 + abs(th))
    assert a.counts["refused"] <= 3


@pytest.mark.parametrize("radius", [None, 0.8, 0.0])
def test_the_index_3_form_is_of_order_two(radius):
    rule = implicit.TRAPEZOIDAL if radius is None else implicit.damped(radius)
    exact = FOUR_BAR.driven(0.0, 2.0, np.array([0.0, 1.0]), 4.0)[1, 0]
    errors = []
    for h in (0.01, 0.005):
        a = adaptive("four_bar", rule, 1e-6, {}, {"A.torque": 4.0}, fixed=h)
        a.advance(1.0)
        errors.append(abs(a.q[0] - exact))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
