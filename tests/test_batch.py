"""Batches: members are instances to the bit, whatever the others do, and nothing of one reaches another."""

import copy
import logging
import shutil
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scenes import double_pendulum, initialized

import alfmu
from alfmu import AlfmuError, Batch, InputError, Instance
from alfmu.fmi import constants
from alfmu.runtime.build import including
from alfmu.runtime.pipeline import packed
from alfmu.runtime.sweeps import Sweeps

HOST = str(Path(__file__).with_name("batch_host.c"))
LINKAGES = Path(__file__).parent / "linkages"
COUNT = 40  # more than are under way at once

RUNS = {
    "five_bar by rk4": ("five_bar", "rk4", 0.002, "start.link1.angle"),
    "five_bar": ("five_bar", "auto", 0.02, "start.link1.angle"),
    "slider_crank": ("slider_crank", "auto", 0.05, "start.angular_velocity"),
    "end_stop": ("end_stop", "auto", 0.02, None),
    "bennett": ("bennett", "auto", 0.02, None),
    "flexible_four_bar": ("flexible_four_bar", "stiff", 0.002, None),
    "governor": ("flyball_governor", "auto", 0.02, None),
    "a floating base": (LINKAGES / "carried.xml", "rk4", 0.002, None),
}
"""Mechanism, method, communication step [s], and a start value that the members have different values of."""


def starts(batch: Batch, name: str | None) -> dict[str, np.ndarray]:
    """Start values of a batch: those of `name`, or of its first parameter, near the default."""
    chosen = name if name in batch._variables else next(n for n in batch._variables if n.startswith("start."))
    spread = np.random.default_rng(1).uniform(0.0, 0.2, batch.count)
    return {chosen: batch.variable(chosen).start + spread}


@pytest.mark.slow
@pytest.mark.parametrize("case", RUNS)
def test_members_are_instances_to_the_bit(case):
    mechanism, method, h, start = RUNS[case]
    batch = Batch(mechanism, COUNT, {"solver.method": method}, threads=1)
    values = starts(batch, start)
    for name, each in values.items():
        batch.set(name, each)
    steps, inputs = 25 if case != "governor" else 4, batch.inputs[:1]
    loads = np.random.default_rng(2).normal(size=(steps, COUNT))
    with np.errstate(all="ignore"):
        failed = batch.initialize()
    for load in loads:
        for name in inputs:
            batch.set(name, load)
        failed |= batch.step(h, ~failed)
    assert failed.sum() < COUNT / 4
    outputs = [v.name for v in Instance(batch.equations).outputs]
    found = batch.get(*outputs)
    for k in np.flatnonzero(~failed)[:: 1 if case == "five_bar" else 7]:
        single = Instance(batch.equations)
        for name, each in values.items():
            single.set(name, float(each[k]))
        single.initialize()
        for load in loads[:, k]:
            for name in inputs:
                single.set(name, float(load))
            single.step(h)
        np.testing.assert_array_equal(found[k], single.read())
        assert batch.time[k] == single.time


COMPILED = {"five_bar": ({}, 0.02), "end_stop": ({}, 0.1), "n_four_bar": ({"loops": 12}, 0.01)}
"""Mechanisms with limits, with events and with repeated parts: their options and communication steps [s]."""


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("gcc"), reason="there is no gcc")
@pytest.mark.parametrize("name", COMPILED)
def test_compiled_members_are_interpreted_ones_to_the_bit(name, monkeypatch):
    """Also where some of them take other ways than the rest: they have other loads and steps. There is no warning."""
    monkeypatch.setenv("CC", "gcc -O0 -std=c99 -Wall -Wextra -Wpedantic -Werror")
    options, h = COMPILED[name]
    mechanism = alfmu.load(name, **options)
    found = []
    for kernel in ("vm", "compiled"):
        method = {"solver.method": "auto" if name == "end_stop" else "rk4"}
        batch = Batch(mechanism, COUNT, method, threads=1, kernel=kernel)
        for start, values in starts(batch, None).items():
            batch.set(start, values)
        batch.initialize()
        for k in range(8):
            batch.set(batch.inputs[0], np.random.default_rng(k).normal(size=COUNT))
            batch.step(h, np.arange(COUNT) % 7 != k)
        found.append(batch.get(*(v.name for v in batch.equations.outputs)))
    scene = constants.loaded(batch._scene)
    assert all(scene.functions[k].in_lanes for k in range(scene.function_count))
    assert np.ptp(found[0], axis=0).max() > 1e-3
    np.testing.assert_array_equal(*found)


def test_no_batch_of_the_oracle():
    with pytest.raises(InputError, match="five_bar: the oracle has no batches; use the kernel vm or compiled"):
        Batch("five_bar", 2, kernel="oracle")


def test_interface_jacobians_are_those_of_instances():
    """Their tapes and numbers are each member's own."""
    names = ["link1.angle", "link1.angle/A.torque"]
    batch = Batch("four_bar", 5, {"solver.method": "rk4"}, outputs=names, threads=1)
    batch.set("start.angle", np.linspace(0.5, 0.9, 5))
    batch.initialize()
    for _ in range(3):
        batch.step(0.02)
    for k, found in enumerate(batch.get(*names)):
        single = initialized(Instance(batch.equations), {"start.angle": np.linspace(0.5, 0.9, 5)[k]})
        for _ in range(3):
            single.step(0.02)
        assert found.tolist() == [single.get(name) for name in names]


def test_inputs_are_extrapolated_as_those_of_instances():
    batch, single = Batch("four_bar", 2, {"solver.input_order": 1}), Instance("four_bar")
    single.set("solver.input_order", 1)
    batch.initialize()
    single.initialize()
    for torque in (0.0, 1.0, 3.0):
        batch.set("A.torque", torque)
        single.set("A.torque", torque)
        batch.step(0.02)
        single.step(0.02)
    assert batch.get("link1.angle").tolist() == [single.get("link1.angle")] * 2


def test_threads_change_nothing():
    found = []
    for threads in (1, 3):
        batch = Batch("four_bar", 3 * COUNT, threads=threads)
        initialized(batch, {"start.angle": np.linspace(0.5, 0.9, batch.count)})
        for _ in range(10):
            batch.step(0.02)
        found.append(batch.get("link1.angle", "A.force.x"))
    np.testing.assert_array_equal(*found)


def test_some_members_move_and_others_wait():
    batch = initialized(Batch("four_bar", 6))
    batch.step(0.1, [1, 4])
    batch.step(0.1, np.arange(6) == 4)
    np.testing.assert_allclose(batch.time, [0, 0.1, 0, 0, 0.2, 0], rtol=1e-15)
    angles = batch.get("link1.angle")
    assert angles[0] == angles[2] == angles[3] == angles[5]
    assert len({*angles[[0, 1, 4]]}) == 3
    batch.step(0.1, slice(1, 2))
    assert batch.get("link1.angle")[1] == batch.get("link1.angle")[4]


def test_a_reset_member_begins_again_and_a_restored_one_goes_on():
    batch = initialized(Batch("four_bar", 5, {"m2": 1.5}))
    batch.step(0.2)
    states = batch.save([0, 1])
    at_once = batch.get("link1.angle")
    batch.step(0.2)
    after = batch.get("link1.angle")
    batch.restore(states, [3, 4])
    assert batch.time.tolist() == [0.4, 0.4, 0.4, 0.2, 0.2]
    assert batch.get("link1.angle")[4] == at_once[0]
    batch.step(0.2, [3, 4])
    assert set(batch.get("link1.angle")) == set(after)
    batch.reset([2])
    assert batch.initialized.tolist() == [True, True, False, True, True]
    assert np.isnan(batch.get("link1.angle")).tolist() == [False, False, True, False, False]
    batch.set("m2", 2.5, [2])
    assert batch.get("m2").tolist() == [1.5, 1.5, 2.5, 1.5, 1.5]
    with pytest.raises(InputError, match="four_bar: member 2 is not initialised; initialise it first"):
        batch.step(0.1)
    batch.initialize([2])
    batch.step(0.4, [2])
    assert batch.get("link1.angle")[2] != after[2]


def test_values_and_states_go_to_members_in_the_order_given():
    batch = Batch("four_bar", 4)
    batch.set("m2", [10.0, 20.0], [3, 1])
    batch.set("m2", 5.0, [])
    assert batch.get("m2").tolist() == [1.0, 20.0, 1.0, 10.0]
    batch.initialize([2])
    found = batch.get("m2", "link1.angle")
    assert found[:, 0].tolist() == [1.0, 20.0, 1.0, 10.0]
    assert np.isnan(found[:, 1]).tolist() == [True, True, False, True]
    batch.initialize()
    states = batch.save([3, 1])
    np.testing.assert_array_equal(states, batch.save()[[3, 1]])
    batch.step(0.1)
    before = batch.save()
    batch.restore(states, [3, 1])
    np.testing.assert_array_equal(batch.save([3, 1]), states)
    batch.restore(before)
    spoilt = states.copy()
    spoilt[1] = 0
    with pytest.raises(InputError, match="four_bar: the saved state is not one of this mechanism"):
        batch.restore(spoilt, [3, 1])
    np.testing.assert_array_equal(batch.save(), before)


def test_boolean_inputs_are_true_or_false():
    batch = Batch(double_pendulum(), 3)
    batch.set("elbow.locked", [True, False, True])
    assert batch.get("elbow.locked").tolist() == [1.0, 0.0, 1.0]
    for wrong in (0.5, np.nan):
        with pytest.raises(InputError, match=f"double_pendulum: elbow.locked is {wrong}; it must be true or false"):
            batch.set("elbow.locked", [1.0, wrong, 0.0])


def test_a_copy_owns_the_same_members():
    batch = initialized(Batch("four_bar", 3))
    copy.copy(batch)
    batch.step(0.1)
    assert set(batch.time) == {0.1}


def test_one_thread_at_a_time_moves_a_batch():
    batch = initialized(Batch("four_bar", 2 * COUNT, threads=2))
    with ThreadPoolExecutor(2) as pool:
        assert not any(failed.any() for failed in pool.map(lambda _: batch.step(0.02), range(10)))
    np.testing.assert_allclose(batch.time, 0.2, rtol=1e-14)


def run_interrupted(batch: Batch) -> None:
    """A timer on a machine that stalls may fire before the first step."""
    threading.Timer(0.02, lambda: signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)).start()
    all(not batch.step(0.5).any() for _ in range(1000))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows sends no such signal to a thread")
@pytest.mark.parametrize("threads", [1, 2])
def test_an_interrupt_waits_for_all_members(threads):
    batch = initialized(Batch("four_bar", 600, threads=threads))
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores interrupts
    try:
        with pytest.raises(KeyboardInterrupt):
            run_interrupted(batch)
    finally:
        signal.signal(signal.SIGINT, before)
    assert len({*batch.time}) == 1
    at = batch.time
    batch.step(0.5)
    np.testing.assert_array_equal(batch.time, at + 0.5)


def test_a_member_that_fails_is_told_and_the_others_go_on(caplog):
    """Links that cannot be closed at the start."""
    batch = Batch("slider_crank", 20, {"start.angle": 1.4})
    lengths = np.full(20, batch.variable("l2").start)
    lengths[[3, 7]] = 0.1
    batch.set("l2", lengths)
    with caplog.at_level(logging.WARNING, "alfmu"):
        failed = batch.initialize()
    assert np.flatnonzero(failed).tolist() == [3, 7]
    assert (
        "slider_crank: 2 of 20 members failed to start; member 3: slider_crank: the loops cannot be closed"
        in caplog.text
    )
    assert "cannot be closed" in batch.message(7)
    assert not batch.step(0.1, ~failed).any()
    assert np.flatnonzero(np.isnan(batch.get("crank.angle"))).tolist() == [3, 7]


def test_what_the_runtime_warns_of_is_told(caplog):
    given = {"solver.method": "rk4", "solver.tolerance": 1e-3, "start.angular_velocity": -60.0}
    batch = initialized(Batch("five_bar", 2, given), {"solver.step_size": [0.001, 0.02]})
    with caplog.at_level(logging.WARNING, "alfmu"):
        for _ in range(50):
            batch.step(0.02)
    assert "five_bar: 1 of 2 members warn; member 1: five_bar" in caplog.text
    assert caplog.text.count("the energy balance is off") == 1


def test_a_step_that_one_member_refuses_is_one_of_the_others():
    """A constraint that is open cannot be switched on; members that are closed go on."""
    m = alfmu.Mechanism("rods")
    one, two = (m.bar(name, mass=1.0, length=1.0) for name in ("one", "two"))
    a, b = (m.coordinate(name, "rad", start=0.0, independent=True) for name in "ab")
    m.revolute("A", m.ground.at(0, 0), one.start, coordinate=a)
    m.revolute("B", m.ground.at(0, 1), two.start, coordinate=b)
    m.distance("rod", one.end, two.end, length=1.0)
    m.gravity(0.0, -9.81)
    m.release("rod")
    batch = initialized(Batch(m, 2), {"rod.released": True, "start.b": [0.0, 1.0]})
    batch.set("rod.released", False)
    assert batch.step(0.01).tolist() == [False, True]
    assert batch.time.tolist() == [0.01, 0.0]
    assert "a constraint that is open" in batch.message(1)


def test_a_failed_step_leaves_the_state_before_it(caplog):
    batch = initialized(Batch("four_bar", 9))
    batch.step(0.1)
    before = batch.save()
    torque = np.zeros(9)
    torque[5] = 1e200
    batch.set("A.torque", torque)
    with caplog.at_level(logging.WARNING, "alfmu"):
        failed = batch.step(0.1)
    assert np.flatnonzero(failed).tolist() == [5]
    assert "four_bar: 1 of 9 members failed to step; member 5: four_bar, t = 0.1 s: " in caplog.text
    batch.set("A.torque", 0.0)
    assert batch.time[5] == 0.1
    same = Batch("four_bar", 1)
    same.restore(before[5:6])
    same.step(0.1)
    batch.step(0.1, [5])
    assert batch.get("link1.angle")[5] == same.get("link1.angle")[0]


def bead() -> alfmu.Mechanism:
    """A bead on the x axis by two constraints: copies of each other for k = 0, else on the axis alone."""
    m = alfmu.Mechanism("bead")
    k = m.parameter("k", 0.0, "1")
    x, y = m.coordinate("x", "m", independent=True, rate=1.0), m.coordinate("y", "m")
    m.kinetic_energy((m.rate(x) ** 2 + m.rate(y) ** 2) / 2)
    m.generalized_force(x, m.input("force", "N"))
    m.constraint("axis", y, "m")
    m.constraint("again", y + k * x * y, "m")
    m.output("place", x, "m", "place of the bead")
    return m


def test_members_whose_redundant_constraints_would_brake():
    batch = Batch(bead(), 3)
    batch.time = 2.0
    batch.set("k", [0.0, 2.0, 5.0])
    batch.set("force", [1.0, 2.0, 3.0])
    assert not batch.equations.survey.brakes
    assert not batch.initialize().any()
    assert batch.equations.survey.brakes
    batch.step(0.5)
    assert batch.time.tolist() == [2.5] * 3
    np.testing.assert_allclose(batch.get("place"), 0.5 + np.array([1.0, 2.0, 3.0]) / 8, rtol=1e-12)
    other = Batch(bead(), 2)
    other.initialize([0])
    other.set("k", 1.0, [1])
    with pytest.raises(alfmu.AssemblyError, match="bead: redundant constraints would brake the motion of a member"):
        other.initialize([1])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: b.set("nothing", 1.0), "four_bar has no input or parameter 'nothing'"),
        (lambda b: b.set("link1.angle", 1.0), "link1.angle"),
        (lambda b: b.set("m2", [1.0, -1.0, 1.0]), r"four_bar: m2 = -1 kg is outside \[0.0, inf\]"),
        (lambda b: b.set("m2", np.nan), "four_bar: m2 is nan; it must be a finite number in kg"),
        (lambda b: b.set("solver.method", 1.0), "solver.method"),
        (lambda b: b.get("nothing"), "nothing"),
        (lambda b: b.step(0.1), "four_bar: member 0 is not initialised; initialise it first"),
        (lambda b: b.set("m2", 1.0, [7]), "four_bar: there are no such members in a batch of 3"),
        (lambda b: (b.initialize(), b.set("m2", 1.0)), "four_bar: m2 is fixed once a member is initialised"),
        (lambda b: (b.initialize(), b.step(-0.1)), "four_bar: a communication step of -0.1 s; it must be a finite"),
        (lambda b: b.restore(np.zeros((1, 8), np.uint8), [0]), "four_bar"),
        (lambda b: b.restore(np.zeros((2, 8), np.uint8), [0]), "four_bar: 2 states for 1 members"),
        (lambda b: b.set("m2", [1.0, 2.0]), r"four_bar: m2 takes one number, or numbers \(3,\)"),
        (lambda b: b.set("m2", "heavy"), "four_bar: m2 takes one number"),
        (lambda b: b.set("m2", 1.0, [1, 1]), "four_bar: member 1 is given more than once"),
        (lambda b: b.set("m2", 1.0, slice(0.5)), "four_bar: there are no such members"),
        (
            lambda b: b.set_many(["m2", "m3"], np.ones((3, 3))),
            r"four_bar: m2, m3 takes one number, or numbers \(3, 2\)",
        ),
        (lambda b: b.set("solver.max_iterations", [1, 2.5, 3]), "max_iterations is 2.5; it must be a whole number"),
        (lambda b: b.set(3, 1.0), "four_bar has no input or parameter '3'"),
        (lambda b: b.get(3), "four_bar has no number 3"),
        (lambda b: b.get("solver.method"), "four_bar has no number 'solver.method'"),
        (lambda b: b.message(7), "four_bar: there are no such members"),
        (lambda b: (b.initialize(), b.step("long")), "four_bar: a communication step of 'long' s"),
        (lambda b: b.restore(None), "four_bar: 0 states for 3 members"),
        (lambda b: Batch("four_bar", 2.5), "four_bar: a batch of 2.5 members"),
        (lambda b: Batch("four_bar", 10**30), "four_bar: a batch of 1000000000000000000000000000000 members"),
        (lambda b: Batch("four_bar", 2, threads=0), "four_bar: a batch of 0 threads"),
        (
            lambda b: Batch("four_bar", 2, {"m2": [1.0, 2.0]}),
            r"four_bar: m2 is \[1.0, 2.0\], but common to all members",
        ),
        (lambda b: Batch("four_bar.fmu", 2), "four_bar.fmu is an FMU; give the mechanism instead"),
        (lambda b: Batch(alfmu.Recipe("four_bar"), 2), "four_bar is of the type Recipe; give a name, a file"),
        (lambda b: Batch("four_bar", 0), "four_bar: a batch of 0 members"),
        (lambda b: Batch(Instance("four_bar"), 2, outputs=["link1.angle"]), "a batch of an instance has its outputs"),
        (
            lambda b: Batch(Instance("four_bar"), 2, {"solver.input_order": 1}),
            "four_bar: a batch of an instance has its solver.input_order, 0; set 1 in the instance before",
        ),
        (
            lambda b: b.set("solver.input_order", 1),
            "four_bar: solver.input_order is 1, but fixed at 0 here; give it where the instance, batch or FMU is made",
        ),
        (lambda b: setattr(b, "time", np.nan), "four_bar: the time of the start is nan; give one finite number"),
        (lambda b: (b.initialize(), setattr(b, "time", 1.0)), "four_bar: the time is fixed once a member is initialis"),
        (lambda b: Batch("four_bar", 2, {"nothing": 1.0}), "nothing"),
        (lambda b: Batch("four_bar", 2, {"solver.method": "euler"}), "euler"),
    ],
)
def test_what_is_wrong_is_named(call, message):
    batch = Batch("four_bar", 3)
    with pytest.raises(AlfmuError, match=message):
        call(batch)
    assert batch.get("m2").tolist() == [batch.variable("m2").start] * 3


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("gcc"), reason="needs gcc and its sanitizers")
def test_sanitizers_find_nothing_in_a_batch(tmp_path, sanitized, fuzz):
    """Fibers too, which address sanitizers follow from one stack to another."""
    batch = Batch("slider_crank", COUNT)
    (tmp_path / "scene.bin").write_bytes(packed(batch.equations))
    references = [batch._scene.references[name] for name in ("start.angle", "crank.angle")]
    host = str(tmp_path / "host")
    made = [*fuzz.compiling("address"), *including(), HOST, *fuzz.objects(sanitized("address"), 0)]
    subprocess.run([*made, "-lm", "-pthread", "-o", host], check=True)
    start = batch.variable("start.angle").start
    asked = [host, str(tmp_path / "scene.bin"), *map(str, references), repr(start)]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stderr.splitlines() if "fully support makecontext" not in line] == []
    initialized(batch, {"start.angle": start + 0.005 * np.arange(COUNT)})
    for _ in range(20):
        batch.step(0.05)
    lines = [f"0 {angle:.17g}" for angle in batch.get("crank.angle")]
    assert done.stdout.splitlines() == lines


# Environments of Gymnasium --------------------------------------------------------------------------------------------

SWING = {
    "actions": {"A.torque": (-5.0, 5.0)},
    "observations": {"link1.angle": (-100.0, 100.0), "link1.angular_velocity": (-100.0, 100.0)},
    "reward": lambda values, actions: -(values["link1.angle"] ** 2) - 0.1 * actions["A.torque"] ** 2,
    "step": 0.02,
    "horizon": 0.1,
    "start": lambda random, count: {"start.angle": random.uniform(0.5, 0.9, count)},
}


@pytest.fixture(autouse=True)
def _needs_gymnasium(request):
    if "environment" in request.node.name:
        pytest.importorskip("gymnasium")


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric", "ignore:.*not having a spec")
def test_gymnasium_accepts_an_environment():
    from gymnasium.utils.env_checker import check_env

    environment = alfmu.Environment("four_bar", render_mode="rgb_array", **SWING)
    check_env(environment)
    environment.reset(seed=3)
    picture = environment.render()
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 1


def test_an_environment_is_a_batch():
    many = alfmu.VectorEnvironment("four_bar", 3, **SWING)
    first, _ = many.reset(seed=1)
    again, _ = many.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    assert len({*first[:, 0]}) == 3
    batch = initialized(Batch("four_bar", 3), {"start.angle": first[:, 0]})
    actions = np.array([[1.0], [-2.0], [7.0]])  # the last one is out of its bounds
    batch.set("A.torque", [1.0, -2.0, 5.0])
    seen, reward, done, late, infos = many.step(actions)
    batch.step(0.02)
    np.testing.assert_array_equal(seen, batch.get("link1.angle", "link1.angular_velocity"))
    np.testing.assert_allclose(reward, -(seen[:, 0] ** 2) - 0.1 * np.array([1.0, 4.0, 25.0]), rtol=1e-14)
    assert not np.any([done, late])
    assert not infos


def test_an_environment_ends_at_its_horizon_and_begins_again():
    over = {**SWING, "done": lambda values: values["link1.angle"] > 1.0}
    many = alfmu.VectorEnvironment("four_bar", 2, **{**over, "start": lambda r, n: {"start.angle": np.full(n, 0.5)}})
    many.reset(seed=1)
    ends = []
    for _ in range(7):
        seen, reward, done, late, _ = many.step(np.zeros((2, 1)))
        ends.append((done.tolist(), late.tolist()))
        begun = seen[:, 0] == 0.5
    assert [late[0] for _, late in ends] == [False] * 4 + [True] + [False] * 2
    assert not begun.any()
    many.batch.reset()
    done = alfmu.VectorEnvironment("four_bar", 2, **{**over, "start": lambda r, n: {"start.angle": np.full(n, 0.99)}})
    done.reset(seed=1)
    seen, _, ended, late, _ = done.step(np.zeros((2, 1)))
    assert ended.all()
    assert not late.any()
    seen, reward, ended, *_ = done.step(np.ones((2, 1)))
    np.testing.assert_allclose(seen[:, 0], 0.99, rtol=1e-14)
    assert not reward.any()
    assert not ended.any()


def test_a_failed_step_of_an_environment_is_truncated():
    wild = {**SWING, "actions": {"A.torque": (-1e150, 1e150)}, "horizon": 10.0}
    many = alfmu.VectorEnvironment("four_bar", 2, **wild)
    many.reset(seed=1)
    _, reward, done, late, infos = many.step(np.array([[0.0], [1e140]]))
    assert late.tolist() == infos["failed"].tolist() == [False, True]
    assert not done.any()
    assert reward[1] == 0.0


def test_names_of_an_environment_are_checked():
    with pytest.raises(InputError, match=r"four_bar: link1\.angle is no input; use one of A\.torque, D\.torque"):
        alfmu.VectorEnvironment("four_bar", 2, **{**SWING, "actions": {"link1.angle": (0, 1)}})
    with pytest.raises(InputError, match="nothing"):
        alfmu.VectorEnvironment("four_bar", 2, **{**SWING, "observations": {"nothing": (0, 1)}})
    with pytest.raises(InputError, match="four_bar: equations have no pictures"):
        alfmu.VectorEnvironment(alfmu.derive(alfmu.load("four_bar")), 2, render_mode="rgb_array", **SWING)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"step": 0}, "four_bar: step is 0; it must be a finite time above zero"),
        ({"horizon": "long"}, "four_bar: horizon is 'long'; it must be a finite time above zero"),
        ({"actions": {"A.torque": (5.0, -5.0)}}, r"four_bar: bounds of A.torque are \(5.0, -5.0\)"),
        ({"actions": {"A.torque": 5.0}}, "four_bar: bounds of A.torque are 5.0; give its least and largest value"),
        ({"render_mode": "human"}, "there is no render_mode 'human'"),
        ({"reward": lambda values, actions: np.ones((2, 1))}, r"four_bar: reward takes one number, or numbers \(2,\)"),
        ({"reward": lambda values, actions: None}, "four_bar: reward is nan for member 0; it must be finite"),
        ({"done": lambda values: np.zeros((2, 1), bool)}, r"four_bar: done takes one number, or numbers \(2,\)"),
        ({"done": lambda values: None}, "four_bar: done is None; it must be true or false for each member"),
        ({"done": True}, "four_bar: done is True; give a function"),
        ({"observations": ["link1.angle"]}, r"four_bar: bounds are \['link1.angle'\]"),
        ({"start": lambda random, count: None}, "four_bar: start returned None; it must return values by name"),
        ({"start": lambda random, count: {"nothing": 1.0}}, "four_bar has no input or parameter 'nothing'"),
        ({"start": lambda random, count: {"m2": np.ones(3)}}, r"four_bar: m2 takes one number, or numbers \(2,\)"),
    ],
)
def test_what_is_wrong_with_an_environment_is_named(changed, message):
    def use() -> None:
        many = alfmu.VectorEnvironment("four_bar", 2, **{**SWING, **changed})
        many.reset(seed=[1, 2])
        many.step(np.zeros((2, 1)))

    with pytest.raises(InputError, match=message):
        use()


def test_an_environment_takes_actions_of_its_shape_alone():
    many = alfmu.VectorEnvironment("four_bar", 2, **SWING)
    seen, _ = many.reset(seed=np.int64(1), options={"reset_mask": [1, 0]})
    assert np.isnan(seen).any(axis=1).tolist() == [False, True]
    for wrong in (np.zeros(2), np.zeros((1, 1)), 0.0, "push"):
        with pytest.raises(InputError, match=r"four_bar: actions have the shape .*; they must be \(2, 1\)"):
            many.step(wrong)
    with pytest.raises(InputError, match=r"four_bar: an action has the shape \(\); it must be \(1,\)"):
        alfmu.Environment("four_bar", **SWING).step(0.0)


def test_every_seed_of_an_environment_counts():
    """As an environment of Gymnasium has it; and masks and seeds of other kinds are refused."""
    many = alfmu.VectorEnvironment("four_bar", 3, **SWING)
    begun = [many.reset(seed=seed)[0].tolist() for seed in (1, [1, 2, 3], [1, 3, 2], (1, 2, 3), np.array([1, 2, 3]))]
    assert begun[1] == begun[3] == begun[4]
    assert begun[0] != begun[1] != begun[2]
    for how, message in (
        ({"seed": -1}, "seed is -1; give whole numbers"),
        ({"seed": [1, "a", 2]}, "seed is .* give whole numbers"),
        ({"options": 3}, "options are 3"),
        ({"options": {"reset_mask": [0, 3, 0]}}, "reset_mask is .* true or false"),
        ({"options": {"reset_mask": None}}, "reset_mask is None"),
    ):
        with pytest.raises(InputError, match=f"four_bar: {message}"):
            many.reset(**how)


def test_an_environment_observes_parameters_and_inputs():
    seen = {**SWING, "observations": {"m2": (0.0, 9.0), "A.torque": (-5.0, 5.0)}, "reward": lambda values, actions: 0.0}
    many = alfmu.VectorEnvironment("four_bar", 2, **{**seen, "start": lambda random, count: {"m2": [2.0, 3.0]}})
    np.testing.assert_array_equal(many.reset()[0], [[2.0, 0.0], [3.0, 0.0]])
    np.testing.assert_array_equal(many.step(np.array([[1.0], [-2.0]]))[0], [[2.0, 1.0], [3.0, -2.0]])


@pytest.mark.slow
def test_without_gymnasium_an_environment_says_what_to_install():
    code = (
        "import sys; sys.modules['gymnasium'] = None\n"
        "from alfmu import *\n"
        "import alfmu\n"
        "try:\n    alfmu.VectorEnvironment\nexcept InputError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "an environment needs Gymnasium; install it with: pip install 'alfmu[gym]'\n"


def test_a_batch_leaves_the_derivatives_of_its_scene_as_they_were():
    """Lanes have code of their own, in which results share places; derivatives need all results of a function."""
    unit = Instance("slider_crank")
    for name, value in {"solver.method": "rk4", "solver.step_size": 0.01}.items():
        unit.set(name, value)
    outputs, times, h = ["crank.angle", "crank.angular_velocity"], np.linspace(0.0, 0.3, 31), 1e-5
    batch = Batch(unit, 3, threads=1)
    batch.set("m1", unit.get("m1") + h * np.array([-1.0, 0.0, 1.0]))
    assert not batch.initialize().any()
    for _ in times[1:]:
        assert not batch.step(0.01).any()
    low, _, high = batch.get(*outputs)
    seeds = np.array([[float(v.name == "m1")] for v in unit.parameters])
    found = Sweeps(unit, times, [], np.zeros((31, 0)), outputs, directions=1).tangents(seeds)
    np.testing.assert_allclose(found[-1, :, 0], (high - low) / (2 * h), rtol=1e-6)
    assert np.abs(found[-1]).min() > 1e-4
