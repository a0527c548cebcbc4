"""Derivatives of runs: of the discrete steps against complex steps, of motions against closed forms and an unrelated
integrator, forward against back, by every integrator, through singular positions, redundant constraints and locks."""

import math
from functools import cache
from pathlib import Path

import casadi as ca
import fmpy
import fmpy.fmi2
import fmpy.fmi3
import numpy as np
import pytest
from oracles.complex_steps import EPSILON, Complex
from oracles.slider_crank import SliderCrank
from scenes import double_pendulum, initialized
from scipy.integrate import solve_ivp
from test_bennett import ALPHA, BETA, reference
from test_locks import END, FREE, LOCKED, stopped, swung

import alfmu
from alfmu.gradients import Columns, Final, Integral, Maximum, TimeOfMaximum, derivatives, gradient
from alfmu.gradients.run import Runs
from alfmu.runtime import Instance
from alfmu.runtime.sweeps import Sweeps

NUMBERS = {"l": 1.0, "m1": 1.0, "m2": 0.7, "m3": 1.0, "m4": 1.0, "g": 9.81}
"""Parameters of the five-bar, in the order of its declaration."""


def parallelogram(l: complex, a: complex, w: complex) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and velocities of the five-bar by its angle and angular velocity."""
    c, s = np.cos(a), np.sin(a)
    q = [a, l * c + l / 2, l * s, 0, a, l / 2 * c + l / 2, l / 2 * s, 0]
    v = [w, -l * s * w, l * c * w, 0, w, -l / 2 * s * w, l / 2 * c * w, 0]
    return np.array(q), np.array(v)


def by_complex_steps(name: str, method: str, angle: float, steps: int, h: float) -> tuple[np.ndarray, list[str]]:
    """Derivatives of q and v of the five-bar after some steps, and the tiers of the steps."""
    unit = Instance("five_bar")
    numbers = {**NUMBERS, "start.angle": angle, "start.angular_velocity": 2.0}
    initialized(unit, {**numbers, "solver.method": method, "solver.step_size": h})
    numbers[name] += 1j * EPSILON
    q, v = parallelogram(numbers["l"], numbers["start.angle"], numbers["start.angular_velocity"])
    own = len(unit.equations.parameters)
    p = [numbers[v.name] for v in unit.parameters[:own]]
    np.testing.assert_allclose(q.real, unit.q, atol=1e-14)
    np.testing.assert_allclose(v.real, unit.v, atol=1e-13)
    found = Complex(unit, q, v, p)
    if method == "rk4":
        found.rk4(steps, h)
    else:
        for k in range(steps):
            found.method((k + 1) * h)
    return found.m["z"][:16].imag / EPSILON, found.tiers


def coordinates(method: str, name: str, angle: float, steps: int, h: float) -> np.ndarray:
    """The same by tangents."""
    unit = Instance("five_bar")
    given = {**NUMBERS, "start.angle": angle, "solver.method": method, "solver.step_size": h}
    outputs = ["link1.angle", "link2.x", "link2.y", "link2.angle", "link3.angle", "link4.x", "link4.y", "link4.angle"]
    rates = [
        *("link1.angular_velocity", "link2.vx", "link2.vy", "link2.angular_velocity", "link3.angular_velocity"),
        *("link4.vx", "link4.vy", "link4.angular_velocity"),
    ]
    del unit
    found = derivatives("five_bar", [name], steps * h, h, outputs=[*outputs, *rates], parameters=given)
    return found.values[-1, :, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "angle", "steps", "bound", "name"),
    [
        *(("rk4", 0.3, 12, 1e-11, name) for name in ("l", "m2", "start.angle")),
        *(("rk4", 0.0, 6, 1e-9, name) for name in ("l", "start.angle")),
        *(("stiff", 0.3, 3, 1e-9, name) for name in ("l", "m2")),
        *(("explicit", 0.3, 3, 1e-9, name) for name in ("m2", "start.angle")),
    ],
)
def test_discrete_steps_have_the_derivatives_that_complex_steps_tell(
    method: str, angle: float, steps: int, bound: float, name: str
):
    wanted, tiers = by_complex_steps(name, method, angle, steps, 0.02)
    found = coordinates(method, name, angle, steps, 0.02)
    assert np.abs(found - wanted).max() <= bound * np.abs(wanted).max()
    if angle == 0.0 and method == "rk4":
        assert "branch" in tiers  # begins in a singular position


class _Complex:
    """Functions of complex numbers, for `oracles.slider_crank`; angles between -pi / 2 and pi / 2."""

    sin, cos, sqrt = np.sin, np.cos, np.sqrt

    @staticmethod
    def atan2(a: complex, b: complex) -> complex:
        return np.arctan(a / b)


def swept(rate, start: list[complex], times: np.ndarray) -> np.ndarray:
    """States over time, by DOP853 in complex numbers: derivatives are those of the motion, by no code of alfmu."""
    return solve_ivp(rate, (0.0, times[-1]), np.array(start, complex), "DOP853", times, rtol=1e-13, atol=1e-13).y


def motion_of_five_bar(numbers: dict[str, complex], times: np.ndarray) -> np.ndarray:
    """Angle and angular velocity: all links but two turn alike, those two move along circles."""
    n = numbers
    moment = n["m1"] / 2 + n["m2"] + n["m3"] / 2 + n["m4"] / 2
    inertia = n["l"] * (n["m1"] / 3 + n["m2"] + n["m3"] / 3 + n["m4"] / 4)
    torque = n["A.torque"] / n["l"]

    def rate(_: float, y: np.ndarray) -> list[complex]:
        return [y[1], (torque - n["g"] * moment * np.cos(y[0])) / inertia]

    return swept(rate, [n["start.angle"], n["start.angular_velocity"]], times)


BY = ["l", "m2", "g", "start.angle", "start.angular_velocity", "A.torque"]


@cache
def exact_of_five_bar(angle: float) -> dict[str, np.ndarray]:
    """Derivatives of the motion from an angle and 2 rad/s by each number, every 0.1 s of 1.5 s."""
    given = {**NUMBERS, "start.angle": angle, "start.angular_velocity": 2.0, "A.torque": 0.0}
    varied = {name: {**given, name: given[name] + 1j * EPSILON} for name in BY}
    times = np.arange(16) * 0.1
    return {name: motion_of_five_bar(numbers, times).imag / EPSILON for name, numbers in varied.items()}


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "bound"), [(0.3, 1e-9), (0.0, 1e-8)])
@pytest.mark.parametrize("method", ["auto", "explicit", "stiff"])
def test_five_bar_has_the_derivatives_of_its_motion_through_singular_positions(method: str, angle: float, bound: float):
    """One constraint is redundant, and at 0 all links are aligned. A run that begins there takes limits at once, whose
    round-off of 5e-11 the runtime tells: derivatives by the place where it begins have 1.5e-9."""
    given = {**NUMBERS, "start.angle": angle, "start.angular_velocity": 2.0}
    solver = {"solver.method": method, "solver.relative_tolerance": 1e-12}
    outputs = ["link1.angle", "link1.angular_velocity"]
    found = derivatives("five_bar", BY, 1.5, 0.1, outputs=outputs, parameters={**given, **solver})
    assert found["link1.angle"].shape == (16, 6)
    assert found.result["link1.angle"].min() < -math.pi / 2
    assert found.result.time == pytest.approx(np.arange(16) * 0.1, abs=1e-15)
    for name, exact in exact_of_five_bar(angle).items():
        got = np.array([found["link1.angle", name], found["link1.angular_velocity", name]])
        assert np.abs(got - exact).max() <= bound * np.abs(exact).max(), name


@pytest.mark.slow
def test_slider_crank_has_the_derivatives_of_its_motion():
    given = {"l1": 0.5, "l2": 1.0, "b": 0.1, "m1": 1.0, "m2": 0.8, "m3": 1.2, "g": 9.81}
    starts = {"start.angle": 0.3, "start.angular_velocity": 2.0}
    by = [*given, *starts, "A.torque"]
    solver = {"solver.method": "explicit", "solver.relative_tolerance": 1e-12}
    found = derivatives(
        "slider_crank", by, 1.0, 0.1, outputs=["crank.angle", "slider.x"], parameters={**given, **starts, **solver}
    )
    for name in by:
        numbers = {**given, **starts, "A.torque": 0.0}
        numbers[name] += 1j * EPSILON
        start = [numbers.pop("start.angle"), numbers.pop("start.angular_velocity")]
        own = SliderCrank(torque=numbers.pop("A.torque"), **numbers)
        y = swept(lambda _, y, own=own: [y[1], own.acceleration(*y, _Complex)], start, found.result.time)
        places = np.array([own.places(angle, _Complex)["s"][0] for angle in y[0]])
        exact = np.array([y[0], places]).imag / EPSILON
        got = np.array([found["crank.angle", name], found["slider.x", name]])
        assert np.abs(got - exact).max() <= 1e-9 * np.abs(exact).max(), name


def test_slider_crank_has_derivatives_through_both_links_vertical():
    """Rod and crank of one length, aligned: at a right angle two motions are possible, and this one goes on."""
    given = {"l1": 0.5, "l2": 0.5, "m1": 1.0, "m2": 0.8, "m3": 1.2, "g": 9.81}
    starts = {"start.angle": 1.2, "start.angular_velocity": 5.0}
    by = ["m1", "m2", "m3", "g", *starts]
    solver = {"solver.method": "explicit", "solver.relative_tolerance": 1e-11}
    found = derivatives("slider_crank", by, 0.4, 0.1, outputs=["crank.angle"], parameters={**given, **starts, **solver})
    assert found.result["crank.angle"][-1] > math.pi / 2
    for name in by:
        numbers: dict[str, complex] = {**given, **starts}
        numbers[name] += 1j * EPSILON
        start = [numbers.pop("start.angle"), numbers.pop("start.angular_velocity")]
        own = SliderCrank(aligned=True, **numbers)
        exact = swept(lambda _, y, own=own: [y[1], own.acceleration(*y, _Complex)], start, found.result.time)[0]
        assert (
            np.abs(found["crank.angle", name] - exact.imag / EPSILON).max() <= 1e-9 * np.abs(exact.imag / EPSILON).max()
        )


def test_a_lock_and_its_impact_have_derivatives():
    """A double pendulum whose elbow is stopped on the way, keeps its angle, and is let go again."""
    by = {"start.th": 0, "start.elbow": 1, "start.th_rate": 2, "start.elbow_rate": 3}
    y = [0.3, 0.8, 1.0, -3.0]
    solver = {"solver.method": "explicit", "solver.relative_tolerance": 1e-12}
    found = derivatives(
        double_pendulum(),
        list(by),
        END,
        0.1,
        outputs=["upper.angle", "lower.angle", "elbow.impulse", "monitor.energy_lost"],
        inputs={"elbow.locked": lambda t: LOCKED - 1e-9 < t < FREE - 1e-9},
        parameters=solver,
    )
    for name, k in by.items():
        start = np.array(y, complex)
        start[k] += 1j * EPSILON
        state, impulse, lost = stopped(swung(start, 0.0, LOCKED))
        end = swung(swung(state, LOCKED, FREE, locked=True), FREE, END)
        exact = np.array([end[0], end[1], impulse, lost]).imag / EPSILON
        assert np.abs(found.values[-1, :, k] - exact).max() <= 1e-9 * np.abs(exact).max(), name


@pytest.mark.slow
def test_a_frozen_rank_has_derivatives():
    """Bennett's linkage, whose redundant constraints would brake it: by the start against the variational equations of
    its one equation in screws, by a twist against the identity of its two angles."""
    accelerate, _, _ = reference()
    th, w = ca.SX.sym("th"), ca.SX.sym("w")
    slopes = ca.Function("slopes", [th, w], [ca.jacobian(accelerate(th, w), ca.vertcat(th, w))])

    def rate(_: float, y: np.ndarray) -> list[float]:
        by_place, by_speed = np.array(slopes(y[0], y[1])).ravel()
        varied = [(y[k + 1], by_place * y[k] + by_speed * y[k + 1]) for k in (2, 4)]
        return [y[1], float(accelerate(y[0], y[1])), *varied[0], *varied[1]]

    by = ["start.angle", "start.angular_velocity", "alpha"]
    given = {"start.angle": 1.0, "start.angular_velocity": 3.0}
    solver = {"solver.method": "explicit", "solver.relative_tolerance": 1e-12}
    outputs = ["hinge1.angle", "hinge1.angular_velocity", "hinge2.angle", "multiplier[1]"]
    found = derivatives("bennett", by, 1.0, 0.1, outputs=outputs, parameters={**given, **solver})
    start = [1.0, 3.0, 1.0, 0.0, 0.0, 1.0]
    exact = solve_ivp(rate, (0.0, 1.0), start, "DOP853", found.result.time, rtol=1e-13, atol=1e-13).y
    assert np.abs(found.result["hinge1.angle"] - exact[0]).max() < 1e-9
    for k, name in enumerate(by[:2]):
        for row, output in enumerate(outputs[:2]):
            wanted = exact[2 + 2 * k + row]
            assert np.abs(found[output, name] - wanted).max() <= 1e-9 * np.abs(exact[2:]).max(), (name, output)
    alpha, beta = (found.result.facts["parameters"].get(n, x) for n, x in (("alpha", ALPHA), ("beta", BETA)))
    angles = [ca.SX.sym(name) for name in ("first", "second", "alpha")]
    ratio = ca.sin((beta + angles[2]) / 2) / ca.sin((beta - angles[2]) / 2)
    identity = ca.sin(angles[0] / 2) * ca.sin(angles[1] / 2) - ratio * ca.cos(angles[0] / 2) * ca.cos(angles[1] / 2)
    closed = ca.Function("closed", angles, [identity, ca.jacobian(identity, ca.vertcat(*angles))])
    for row in range(len(found.result.time)):
        left, by_each = closed(found.result["hinge1.angle"][row], found.result["hinge2.angle"][row], alpha)
        changes = [found["hinge1.angle", "alpha"][row], found["hinge2.angle", "alpha"][row], 1.0]
        assert abs(float(left)) < 1e-12
        assert abs(float(by_each @ np.array(changes))) <= 1e-9 * np.abs(changes).max()


CASES = [  # limits at singular positions, and Newton's method, enlarge round-off in values as well
    ("five_bar", {"solver.method": "rk4", "start.angle": 0.5}, ["l", "m2", "g", "start.angle", "A.torque"], 1e-11),
    ("five_bar", {"solver.method": "rk4"}, ["l", "m2", "g", "start.angular_velocity", "A.torque"], 1e-9),
    (
        "five_bar",
        {"solver.method": "rk4", "start.angle": 0.3, "solver.formulation": "dae"},
        ["m2", "start.angle"],
        1e-10,
    ),
    ("slider_crank", {"solver.method": "stiff"}, ["l2", "m2", "start.angle", "slider.force"], 1e-10),
    ("end_stop", {}, ["l2", "stop", "stiffness", "start.angle", "O.torque"], 1e-9),
    ("bennett", {}, ["a", "alpha", "m1", "start.angle", "hinge1.torque"], 1e-10),
    ("flexible_four_bar", {}, ["stiffness", "damping", "l1", "start.bend"], 1e-8),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "parameters", "by", "bound"), CASES, ids=[f"{c[0]}-{k}" for k, c in enumerate(CASES)])
def test_forward_and_back_are_the_same_to_round_off(name: str, parameters: dict, by: list[str], bound: float):
    """Also where the tape is shorter than the run, which is then run again in parts; the values are those of a run."""
    step = 0.01
    runs = Runs(name, by, 0.4, step, None, parameters)
    wanted = runs.columns()
    values, found = runs.tangents(wanted)
    plain = alfmu.simulate(name, 0.4, step, parameters=parameters)
    assert [*plain.names] == wanted
    assert np.array_equal(values, plain.values)
    sizes = np.abs(found).max(axis=(0, 2))
    sizes[[name.startswith("monitor.") for name in wanted]] = 0.0  # round-off has no derivative
    shares = np.random.default_rng(0).standard_normal(values.shape) / np.where(sizes > 1e-6, sizes, np.inf)
    exact = np.einsum("kw,kwb->b", shares, found)
    for tape in (32e6, 1e5):
        sweeps = runs.sweeps(wanted, 0, None)
        sweeps.record(tape)
        assert np.array_equal(sweeps.values, plain.values)
        for _ in range(2):  # it can be swept again
            of_parameters, of_inputs = sweeps.adjoints(shares)
            for k, each in enumerate(by):
                column = runs.inputs.index(each) if each in runs.inputs else None
                got = of_parameters[runs.names.index(each)] if column is None else of_inputs[:, column].sum()
                size = np.abs(shares[:, :, None] * found).sum(axis=(0, 1))[k]
                assert abs(got - exact[k]) <= bound * size, (tape, each)


def test_functions_of_a_run_have_their_gradients():
    """A pendulum of the five-bar: integral, maximum and its time by complex steps of the motion, interpolated alike."""
    given = {**NUMBERS, "start.angle": 0.3, "start.angular_velocity": 2.0}
    solver = {"solver.method": "explicit", "solver.relative_tolerance": 1e-12}
    how = {"stop_time": 1.0, "communication_step": 0.05, "parameters": {**given, **solver}}
    target = np.linspace(0.0, -1.0, 21)
    functions = {
        "final": Final("link1.angle"),
        "integral": Integral(lambda o: ca.sin(o["link1.angle"]) * o["link1.angular_velocity"] + o["time"]),
        "maximum": Maximum("link1.angle"),
        "time": TimeOfMaximum("link1.angle"),
        "columns": Columns(["link1.angle"], lambda o: ca.sumsqr(o["link1.angle"] - target)),
    }
    for name in ("m2", "start.angle"):
        numbers: dict[str, complex] = {**given, "A.torque": 0.0}
        numbers[name] += 1j * EPSILON
        times = np.arange(21) * 0.05
        a, w = motion_of_five_bar(numbers, times)
        k = int(np.argmax(a.real))
        curve = np.polyfit([-1.0, 0.0, 1.0], np.eye(3), 2) @ a[k - 1 : k + 2]
        top = -curve[1] / (2 * curve[0])
        terms = np.sin(a) * w + times
        exact = {
            "final": a[-1],
            "integral": 0.05 * (terms.sum() - terms[0] / 2 - terms[-1] / 2),
            "maximum": curve[2] + curve[1] * top / 2,
            "time": times[k] + 0.05 * top,
            "columns": ((a - target) ** 2).sum(),
        }
        for key, of in functions.items():
            found = gradient("five_bar", of, [name], **how)
            assert found.value == pytest.approx(exact[key].real, rel=1e-9), key
            assert found[name] == pytest.approx(exact[key].imag / EPSILON, rel=2e-9), key


def test_each_point_of_an_input_has_its_derivative():
    """By the communication steps of one pulse each, which is linear; and a table of inputs gives what a number does."""
    times = np.arange(11) * 0.02
    how = {"stop_time": 0.2, "communication_step": 0.02, "parameters": {"solver.method": "rk4", "start.angle": 0.3}}
    found = gradient("five_bar", "link1.angular_velocity", ["A.torque"], inputs={"A.torque": (times, 0 * times)}, **how)
    assert found["A.torque"] == pytest.approx(
        gradient("five_bar", "link1.angular_velocity", ["A.torque"], **how)["A.torque"]
    )
    assert found.inputs["A.torque"].shape == (11,)
    assert found.inputs["A.torque"][-1] == 0.0  # it acts from there on
    for k in (0, 4, 9):
        ends = []
        for size in (1e-3, -1e-3):
            pulse = np.where(np.arange(11) == k, size, 0.0)
            run = alfmu.simulate(
                "five_bar",
                0.2,
                0.02,
                inputs={"A.torque": lambda t, u=pulse: u[round(t / 0.02)]},
                parameters=how["parameters"],
            )
            ends.append(run["link1.angular_velocity"][-1])
        assert found.inputs["A.torque"][k] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-7)


@pytest.mark.parametrize("order", [0, 2])
def test_inputs_that_move_something_have_derivatives(order: int):
    """Between communication points an input is followed by polynomials of its values, so that the angle that it moves
    is linear in them: pulses of any size tell its derivatives. What the motion takes is the same forward and back."""
    m = alfmu.Mechanism("moved")
    rod = m.bar("rod", mass=1.0, length=m.parameter("l", 0.7, "m"))
    A = m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=m.coordinate("th", "rad"))
    m.motion(A, m.input("A.angle", "rad", order=order))
    m.gravity(0, -9.81)
    times = np.arange(11) * 0.05

    def moved(pulse: int = 0, size: float = 0.0) -> dict:
        values = 0.3 + 0.1 * np.sin(4 * times) + size * (np.arange(11) == pulse)
        return {"A.angle": (times, values)}

    torque = next(v.name for v in Runs(m, ["l"], 0.5, 0.05, moved(), None).unit.outputs if v.unit == "N.m")
    for row in (5, 10):
        of = Columns(["rod.angle"], lambda o, row=row: o["rod.angle"][row])
        found = gradient(m, of, ["l", "A.angle"], 0.5, 0.05, inputs=moved())
        for pulse in (1, 3, 4):
            ends = [alfmu.simulate(m, 0.5, 0.05, inputs=moved(pulse, x))["rod.angle"][row] for x in (0.01, -0.01)]
            assert found.inputs["A.angle"][pulse] == pytest.approx((ends[0] - ends[1]) / 0.02, abs=1e-11)
        assert found["A.angle"] == pytest.approx(1.0, abs=1e-11)
    forward = derivatives(m, ["l", "A.angle"], 0.5, 0.05, inputs=moved(), outputs=[torque])
    back = gradient(m, torque, ["l", "A.angle"], 0.5, 0.05, inputs=moved())
    for name in ("l", "A.angle"):
        assert back[name] == pytest.approx(forward[torque, name][-1], rel=1e-11)
        assert abs(back[name]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("by", [["l"], ["l", "m", "g", "start.angle"]])
def test_a_gradient_is_one_run_and_one_sweep_back_whatever_the_number_of_numbers(by, monkeypatch):
    """What that takes stands in the benchmark."""
    calls = []
    for name in ("record", "adjoints", "tangents"):
        each = getattr(Sweeps, name)
        monkeypatch.setattr(Sweeps, name, lambda *given, name=name, each=each: calls.append(name) or each(*given))
    found = gradient("n_four_bar", Final("crank1.angle"), by, 0.5, 0.01)
    assert calls == ["record", "adjoints"]
    assert all(found[name] != 0.0 for name in by)


def test_what_has_no_derivatives_is_refused_by_name():
    with pytest.raises(alfmu.InputError, match=r"no parameter, start value or input 'm22' .*m2"):
        derivatives("five_bar", ["m22"], 0.1)
    with pytest.raises(alfmu.InputError, match=r"'solver.tolerance' to differentiate by"):
        gradient("five_bar", "link1.angle", ["solver.tolerance"], 0.1)
    with pytest.raises(alfmu.InputError, match="no output or input 'link9'"):
        gradient("five_bar", "link9", ["m2"], 0.1)
    for expression in (lambda o: 3.0, lambda o: math.sin(o["link1.angle"]), lambda o: o["link1.angle"] / 0):
        with pytest.raises(alfmu.InputError, match="takes no column"):
            Integral(expression)
    for expression in (lambda o: None, lambda o: [o["link1.angle"]], lambda o: abs(min(o["link1.angle"], 1)), 3):
        with pytest.raises(alfmu.InputError, match="cannot be differentiated"):
            Final(expression)
    with pytest.raises(alfmu.InputError, match="inputs are 3; give a dictionary"):
        derivatives("five_bar", ["m2"], 0.1, inputs=3)
    m = alfmu.Mechanism("rubs")
    th = m.coordinate("th", "rad", start=0.3, independent=True)
    rod = m.bar("rod", mass=1.0, length=1.0)
    m.friction(m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th), coulomb=0.2, radius=0.02)
    m.gravity(0, -9.81)
    with pytest.raises(alfmu.InputError, match="dry friction are not available"):
        derivatives(m, ["start.th"], 0.1)


# FMUs -----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
def test_fmus_have_derivatives_by_parameters_and_start_values_before_the_run(tmp_path, version: int):
    """Those of the library at the start; FMI 3 has them back, too, and both leave the FMU as it is."""
    path = alfmu.export("slider_crank", tmp_path / "slider_crank.fmu", kind="native", fmi=version)
    description, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    kind = fmpy.fmi2.FMU2Slave if version == 2 else fmpy.fmi3.FMU3Slave
    unit = kind(guid=description.guid, unzipDirectory=folder, modelIdentifier=description.coSimulation.modelIdentifier)
    unit.instantiate()
    reference = {v.name: v.valueReference for v in description.modelVariables}
    by = ["l2", "m2", "start.angle", "start.angular_velocity", "A.torque"]
    outputs = ["crank.angle", "slider.x", "slider.vx", "slider.ax", "B.force.x", "guide.force"]
    exact = derivatives("slider_crank", by, 0.02, 0.02, outputs=outputs).values[0]
    if version == 2:
        unit.setupExperiment()
    unit.enterInitializationMode()
    get = unit.getReal if version == 2 else unit.getFloat64
    of, known = ([reference[name] for name in names] for names in (outputs, by))
    before = get(of)
    found = np.array([unit.getDirectionalDerivative(of, [each], [2.0]) for each in known]).T / 2
    np.testing.assert_allclose(found, exact, rtol=1e-10, atol=1e-10 * np.abs(exact).max())
    together = unit.getDirectionalDerivative(of, known, [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(together, exact @ [0.1, 0.2, 0.3, 0.4, 0.5], rtol=1e-10, atol=1e-9)
    weights = [1.0, -2.0, 0.5, 0.3, 0.1, 0.2]
    if version == 3:
        back = unit.getAdjointDerivative(of, known, weights, len(known))
        np.testing.assert_allclose(back, weights @ exact, rtol=1e-10)
    assert get(of) == before
    unit.exitInitializationMode()
    assert get(of) == before
    for k in range(5):
        unit.doStep(0.02 * k, 0.02)
    torque = reference["A.torque"]
    by_torque = unit.getDirectionalDerivative(of, [torque], [1.0])
    if version == 3:
        back = unit.getAdjointDerivative(of, [torque], weights, 1)
        assert back[0] == pytest.approx(np.dot(weights, by_torque), rel=1e-10)
    with pytest.raises(fmpy.fmi1.FMICallException, match="Derivative"):
        unit.getDirectionalDerivative(of, [reference["l2"]], [1.0])
    text = Path(folder, "modelDescription.xml").read_text()
    assert "providesDirectionalDerivative" + "s" * (version == 3) + '="true"' in text
    assert ('providesAdjointDerivatives="true"' in text) == (version == 3)
    unit.terminate()
    unit.freeInstance()
