"""Every formulation in native FMUs: the oracle's numbers, its words where a step fails, and what is refused."""

from collections import OrderedDict

import fmpy
import numpy as np
import pytest
from scenes import derived, initialized
from test_native import summed

import alfmu
from alfmu.fmi import native
from alfmu.fmi.drive import Fmu
from alfmu.kernel import alternatives as traced
from alfmu.kernel.alternatives import SYSTEMS, alternatives, formulations
from alfmu.kernel.memory import Layout
from alfmu.kernel.tables import known_choices
from alfmu.kernel.trace import Calls, Tracer
from alfmu.model.settings import FORMULATIONS, Settings
from alfmu.runtime import pipeline
from alfmu.simulation import oracle, prepared, run, with_defaults

PASSING = ("five_bar", "four_bar")
SOFT = {"solver.penalty": 100.0, "solver.method": "rk4", "solver.step_size": 0.002}
"""A penalty with which (5) can be integrated by RK4, and (8) as printed loses two digits in place of eight."""


def unlike(got, library, motion: bool) -> float:
    """Largest difference, over 1 and the largest value: of the motion, or of what is read with it.

    Left out are iterations and distances to a singular position, which is found from other places by either side.
    """
    moving = {name for name in library.names if name.endswith((".x", ".y", ".angle")) and ".force." not in name}
    compared = moving if motion else {*library.names} - moving - {"monitor.iterations", "monitor.distance"}
    found = ((got[name], library[name]) for name in compared if name in library.names)
    return max(np.abs(x - y).max() / (1 + np.abs(y).max()) for x, y in found)


# Numbers --------------------------------------------------------------------------------------------------------------

LIMITS = {
    # Motion, and what is read; the arithmetic of both sides is the same but for its order.
    "residual": (2e-12, 1e-11),
    "baumgarte": (2e-12, 1e-11),
    "dae": (2e-12, 1e-11),
    # With the default penalty of 1e8 masses (8) as printed and (6) lose eight digits to cancellation, on either side
    # others; reactions that redundant constraints share lose two more.
    "classic": (1e-7, 2e-5),
    "penalty": (1e-7, 2e-5),
}
BESIDE = 1e-7
"""The same for what is read of mechanisms that pass singular positions: a communication point that lies 0.01 beside one
(`monitor.distance`) magnifies differences of the motion by the square of its inverse."""


CHOSEN = [
    *((name, formulation) for name in ("slider_crank", "four_bar") for formulation in LIMITS),
    *(("five_bar", "classic"), ("five_bar", "dae"), ("particle_on_circle", "penalty")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "formulation"), CHOSEN)
def test_a_host_chooses_the_formulation_and_has_the_numbers_of_the_oracle(built, name, formulation):
    chosen = {"solver.formulation": formulation, "solver.method": "rk4"}
    library = alfmu.simulate(name, 1.0, 0.02, kernel="oracle", parameters=chosen)
    wanted = [n for n in library.names if n != "monitor.iterations"]
    path = str(built(name))
    # fmpy sets items by their numbers; the first method of an FMU is RK4.
    number = {"solver.formulation": [*FORMULATIONS].index(formulation) + 1, "solver.method": 1}
    got = fmpy.simulate_fmu(path, stop_time=1.0, output_interval=0.02, start_values=number, output=wanted)
    assert len(got) == 51
    motion, read = LIMITS[formulation]
    assert unlike(got, library, motion=True) <= motion
    assert unlike(got, library, motion=False) <= max(read, BESIDE * (name in PASSING))


SOFTLY = [
    *(("five_bar", "classic"), ("four_bar", "penalty"), ("slider_crank", "stiffness")),
    *(("slider_crank", "classic"), ("particle_on_circle", "penalty"), ("five_bar", "stiffness")),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "formulation"), SOFTLY)
def test_with_a_soft_penalty_they_differ_by_round_off(built, name, formulation):
    values = {"solver.formulation": formulation, **SOFT}
    library = alfmu.simulate(name, 0.4, 0.02, kernel="oracle", parameters=values)
    with Fmu(built(name)) as fmu:
        got = run(fmu, 0.4, 0.02, {}, values)
    assert unlike(got, library, motion=True) <= 1e-12
    # Classic reactions of the five-bar, which starts in a singular position, are stopped at the tolerance of a alone.
    assert unlike(got, library, motion=False) <= (1e-6 if formulation == "classic" else 1e-9)


@pytest.mark.slow
def test_inputs_and_switched_constraints(built):
    """A lock that comes and goes leaves zero rows in (9)."""
    m = alfmu.load("slider_crank")
    m.lock("B")
    path = built(m)
    inputs = {"A.torque": lambda t: np.sin(5 * t), "B.locked": lambda t: 0.2 < t < 0.5}
    for formulation in ("dae", "penalty"):
        values = {"solver.formulation": formulation}
        library = alfmu.simulate(alfmu.derive(m), 1.0, 0.02, inputs=inputs, parameters=values, kernel="oracle")
        with Fmu(path) as fmu:
            got = run(fmu, 1.0, 0.02, inputs, values)
        assert unlike(got, library, motion=True) <= LIMITS[formulation][0]


@pytest.mark.parametrize("formulation", ["penalty", "stiffness", "baumgarte", "dae"])
def test_directional_derivatives_are_those_of_the_formulation(built, formulation):
    with Fmu(built("slider_crank")) as fmu:
        initialized(fmu, {"solver.formulation": formulation, "solver.penalty": 100.0})
        outputs = [v for v in fmu.description.modelVariables if v.causality == "output" and v.type == "Real"]
        torque = next(v.valueReference for v in fmu.description.modelVariables if v.name == "A.torque")
        references = [v.valueReference for v in outputs]
        before = np.array(fmu.slave.getReal(references))
        found = fmu.slave.getDirectionalDerivative(references, [torque], [2.0])
        assert np.array_equal(before, fmu.slave.getReal(references))
        fmu.set("A.torque", 2.0)
        after = np.array(fmu.slave.getReal(references))
        assert found == pytest.approx(after - before, rel=1e-9, abs=1e-9 * np.abs(after).max())
        assert np.abs(found).max() > 0.1


# Numbers that are no variables ----------------------------------------------------------------------------------------

COUNTED, UNCONVERGED = 15, 3
"""What an instance counts, as in instance.h, and where the evaluations that did not converge are in it."""


def numbers(fmu: Fmu, layout: Layout) -> np.ndarray:
    """What stands before the memory: what is counted, then zeta, omega and projection."""
    return np.frombuffer(fmu.save()[-8 * (layout.size + COUNTED + 3) : -8 * layout.size]).copy()


def give(fmu: Fmu, layout: Layout, values: list[float]) -> None:
    """Zeta, omega and projection."""
    state = fmu.save()
    changed = state[: -8 * (layout.size + 3)] + np.array(values).tobytes() + state[-8 * layout.size :]
    fmu.restore(summed(changed))


@pytest.mark.parametrize(
    ("formulation", "given", "projects"),
    [
        ("baumgarte", (0.7, 25.0), -1.0),
        ("penalty", (0.3, 40.0), -1.0),
        ("dae", (1.0, 10.0), 1.0),
        ("penalty", (1.0, 10.0), 1.0),
        ("classic", (1.0, 10.0), 0.0),
    ],
)
def test_stabilisation_and_projection_are_numbers_of_the_instance(built, formulation, given, projects):
    """Beside a singular position nothing is magnified: the crank starts at 0.4 rad."""
    zeta, omega = given
    equations = derived("five_bar")
    forced = {-1.0: None, 0.0: False, 1.0: True}[projects]
    values = {"solver.formulation": formulation, "start.angle": 0.4, **SOFT}
    library = oracle.Instance(
        prepared(equations, "oracle"), Settings(method="rk4", step_size=0.02, zeta=zeta, omega=omega, projection=forced)
    )
    for name, value in values.items():
        library.set(name, value)
    library.initialize()
    layout = Layout(prepared(equations))
    with Fmu(built("five_bar")) as fmu:
        initialized(fmu, values)
        assert numbers(fmu, layout)[COUNTED:].tolist() == [1.0, 10.0, -1.0]
        give(fmu, layout, [zeta, omega, projects])
        # The library closed the loops at the start where it projects, the FMU where the formulation does by itself.
        for k in range(10):
            for unit in (library, fmu):
                unit.step(0.02, 0.02 * k)
        kept = [i for i, v in enumerate(library.outputs) if v.name.startswith("link")]
        assert fmu.read()[kept] == pytest.approx(library.read()[kept], rel=1e-9, abs=1e-9)
        error = [v.name for v in library.outputs].index("monitor.position_error")
        assert (fmu.read()[error] < 1e-12) == bool(library.settings.projects)


def test_evaluations_that_do_not_converge_are_counted(built):
    layout = Layout(prepared(derived("five_bar")))
    counts = {}
    for formulation, most in (("residual", 10), ("residual", 2), ("classic", 10), ("dae", 10)):
        with Fmu(built("five_bar")) as fmu:
            fmu.set("solver.method", "rk4")
            fmu.set("solver.formulation", formulation)
            fmu.set("solver.max_iterations", most)
            fmu.set("start.angle", 0.4)
            fmu.initialize()
            for k in range(5):
                fmu.step(0.02, 0.02 * k)
            counts[formulation, most] = numbers(fmu, layout)[UNCONVERGED]
    assert counts["residual", 10] == counts["dae", 10] == 0
    # Four stages in each of five steps, and a reading at the start and after each. With the default penalty (8) as
    # printed changes by its round-off from iteration to iteration, about as much as the tolerance allows: how often it
    # ends is chance.
    assert counts["residual", 2] == 26
    assert 0 < counts["classic", 10] <= 26


# What fails, and what is refused --------------------------------------------------------------------------------------


def test_a_step_that_fails_says_what_the_oracle_says(built):
    """With the default penalty (5) is far too stiff for a step of 0.02 s; the state before the step is kept."""
    chosen = {"solver.formulation": "stiffness"}
    with pytest.raises(alfmu.StepError) as wanted:
        alfmu.simulate("particle_on_circle", 1.0, 0.02, kernel="oracle", parameters=chosen)
    with Fmu(built("particle_on_circle")) as fmu:
        with pytest.raises(alfmu.StepError) as caught:
            run(fmu, 1.0, 0.02, {}, chosen)
        assert str(caught.value) == str(wanted.value)
        assert "the equations of motion are not finite" in str(caught.value)
    with Fmu(built("five_bar")) as fmu:
        initialized(fmu, {"solver.formulation": "stiffness"})
        before = fmu.read().copy()
        with pytest.raises(alfmu.StepError, match="rad in one step, more than half a turn; reduce"):
            fmu.step(0.02, 0.0)
        assert np.array_equal(fmu.read(), before)


def test_a_singular_mass_matrix_stops_stiffness_alone(built):
    """m2 = 0: (5) solves with M itself, the others with H or with (9)."""
    for formulation in FORMULATIONS:
        with Fmu(built("five_bar")) as fmu:
            fmu.set("m2", 0.0)
            fmu.set("start.angle", 0.4)
            fmu.set("solver.formulation", formulation)
            if formulation == "stiffness":
                with pytest.raises(alfmu.StepError, match="the augmented mass matrix is singular; give the massless"):
                    fmu.initialize()
                continue
            fmu.initialize()
            fmu.step(0.02, 0.0)
            assert np.isfinite(fmu.read()).all()


def test_an_unknown_formulation_is_refused(built):
    with Fmu(built("particle_on_circle")) as fmu:
        with pytest.raises(
            alfmu.InputError, match=r"solver\.formulation is 'exact'; it must be a value of type Enumeration"
        ):
            fmu.set("solver.formulation", "exact")
        with pytest.raises(alfmu.StepError, match=r"solver\.formulation.* supports 1 \(residual\), 2 \(classic\)"):
            fmu.set("solver.formulation", len(FORMULATIONS) + 1)
        initialized(fmu, {"solver.formulation": "dae"})


def test_only_rk4_has_every_formulation(tmp_path):
    given = {"solver.method": "explicit"}
    path = alfmu.export("particle_on_circle", tmp_path, kind="native", parameters=given)
    with Fmu(path) as fmu:
        fmu.initialize()
        fmu.reset()
        fmu.set("solver.formulation", "classic")
        with pytest.raises(alfmu.StepError, match=r"solver\.method explicit needs solver\.formulation residual"):
            fmu.initialize()
    both = {**given, "solver.formulation": "classic"}
    for kind in ("native", "python"):
        with pytest.raises(alfmu.ExportError, match=r"with solver\.formulation classic; use solver\.method rk4$"):
            alfmu.export("particle_on_circle", tmp_path, kind=kind, parameters=both)


@pytest.mark.slow
def test_a_scene_is_exported_with_any_formulation_as_its_default(tmp_path):
    path = alfmu.export("slider_crank", tmp_path, kind="native", parameters={"solver.formulation": "baumgarte"})
    library = alfmu.simulate("slider_crank", 0.5, 0.02, parameters={"solver.formulation": "baumgarte"})
    with Fmu(path) as fmu:
        got = run(fmu, 0.5, 0.02)
    assert unlike(got, library, motion=True) <= 1e-12


@pytest.mark.slow
def test_large_scenes_leave_the_dense_system_out(tmp_path, monkeypatch, uncached):
    equations = derived("slider_crank")
    refused = with_defaults(equations, {"solver.formulation": "dae"})
    native.checked(refused)
    monkeypatch.setattr(traced, "DENSE", equations.n - 1)
    monkeypatch.setattr(pipeline, "_KEPT", OrderedDict())  # scenes that were traced before
    assert formulations(equations) == [*known_choices(equations)["solver.formulation"]] == [*FORMULATIONS][:4]
    assert not {*alternatives(equations)} & {*SYSTEMS}
    with pytest.raises(alfmu.ExportError, match=r"no solver\.formulation dae of more than 50 coordinates; use resi"):
        native.checked(refused)
    with pytest.raises(alfmu.InputError, match=r"formulation dae takes up to 50 coordinates; use residual, classic"):
        alfmu.simulate(refused, 0.1, 0.01)
    with Fmu(alfmu.export("slider_crank", tmp_path, kind="native", reference=False)) as fmu:
        with pytest.raises(alfmu.InputError, match="must be a value of type Enumeration"):
            fmu.set("solver.formulation", "dae")
        with pytest.raises(alfmu.StepError, match=r"supports 1 \(residual\), .* 4 \(stiffness\)(?!,)"):
            fmu.set("solver.formulation", 5)
        initialized(fmu, {"solver.formulation": "penalty"})
        fmu.step(0.02, 0.0)


def test_two_meanings_of_a_name_are_refused():
    """Programs share functions and memory by name: by these two once, implicit methods lost their numbers."""
    e = prepared(with_defaults(derived("particle_on_circle"), {"solver.method": "stiff"}))
    tracer = Tracer(e)
    calls = Calls(tracer)
    calls("twice", "stabilisation", "y", lambda x: 2 * x)
    with pytest.raises(ValueError, match="two functions are called twice"):
        calls("twice", "watch", "y", lambda x: x)
