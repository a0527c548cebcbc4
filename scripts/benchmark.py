"""Measure what alfmu costs: an internal step by part, a doStep through FMI, and how both grow with a mechanism.

Writes `benchmark.md`, a CSV file for each of its chapters and a picture into one folder. As times depend on the
machine, each is compared with a yardstick timed in turn with it: `numpy.linalg.solve` of an 8 x 8 system, the NumPy
oracle, or an empty FMU; costs of many loops are compared with those of ten.
"""

import argparse
import gc
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from multiprocessing import get_context
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
from _study import Call, Laps, Results, Target, clocked, in_turns, judged, times
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pythonfmu import FmuBuilder
from tqdm import tqdm

import alfmu
from alfmu.catalogue.registry import mechanisms
from alfmu.equations.arrays import ArrayFunctions
from alfmu.equations.specialisation import specialised
from alfmu.fmi.drive import Fmu
from alfmu.gradients.run import Runs
from alfmu.kernel.controlled import whole
from alfmu.kernel.form import called
from alfmu.kernel.joined import joined
from alfmu.kernel.memory import TIERS as KINDS
from alfmu.model.cache import VARIABLE
from alfmu.model.settings import Settings
from alfmu.runtime.build import HERE, PLATFORMS, compiler
from alfmu.simulation import oracle, prepared, with_defaults
from alfmu.studies.cost import cost, operations, parts
from alfmu.studies.tables import Row, environment, markdown, paragraph, rounded, shown, write_csv

KERNELS = ("vm", "compiled")
"""Kernels: functions of a scene interpreted by the runtime, or compiled."""

OPTIMISED = "-O2"
"""How the host of a native FMU is compiled."""

HEADERS = Path(fmpy.__file__).parent / "c-code"
"""Folder of the FMI headers, for hosts."""

SCRIPTS = Path(__file__).parent

START = {"start.angle": 1.2, "start.angular_velocity": 2.0}
"""Start of all mechanisms [rad, rad/s]: a regular position, at which steps are timed."""

SHORT = 1e-6
"""Internal step of the kernels [s], so short that a lap stays at the regular position."""


@dataclass(frozen=True)
class Effort:
    """Extent of the measurements."""

    rounds: int
    """Number of laps of each way to make a step."""
    lap: float
    """Shortest lap [s]."""
    runs: int
    """Number of runs of the five-bar's motion through FMI."""
    builds: int
    """Number of processes that each build every N-four-bar."""
    loops: tuple[int, ...]
    coordinates: tuple[str, ...]
    """Coordinates of the N-four-bars."""
    horizon: float
    """Longest motion of which every single step is timed [s]."""
    passes: int
    """Number of repetitions of this motion."""
    mechanisms: tuple[str, ...] = ()
    """Mechanisms whose single steps are timed; all if empty."""


QUICK = Effort(7, 1e-3, runs=3, builds=1, loops=(1, 10), coordinates=("natural",), horizon=1.0, passes=3)
USUAL = Effort(40, 2e-3, 15, 3, (1, 10, 40, 200), ("natural", "absolute"), horizon=math.inf, passes=5)
FULL = replace(USUAL, loops=(*USUAL.loops, 1000))


# What is timed ----------------------------------------------------------------------------------------------------


def solve_call() -> Call:
    """Return the yardstick: `numpy.linalg.solve` of 8 equations."""
    random = np.random.default_rng(0)
    A, b = random.normal(size=(8, 8)) + 8 * np.eye(8), random.normal(size=8)
    return Call(clocked(partial(np.linalg.solve, A, b)))


RK4 = {"solver.method": "rk4"}
"""Setting of all timed runs: steps of a given length, each with four evaluations."""


def by_rk4(name: str, **options: str | int) -> alfmu.Equations:
    """Return the equations of a mechanism for RK4."""
    return with_defaults(alfmu.derive(alfmu.load(name, **options)), RK4)


AnyInstance = alfmu.Instance | oracle.Instance


def begun(equations: alfmu.Equations, step_size: float = SHORT, **settings: float) -> alfmu.Instance:
    """Return an instance at the regular position, with internal steps of `step_size` [s]."""
    instance = alfmu.Instance(equations, Settings(step_size=step_size, method="rk4", **settings))
    start(instance)
    return instance


def start(instance: AnyInstance) -> None:
    """Initialise an instance at the regular position."""
    for name, value in START.items():
        instance.set(name, value)
    instance.initialize()


def reading(instance: alfmu.Instance) -> Call:
    """Return the call that reads all outputs after an input was set."""
    name = instance.input_variables[0].name
    value = instance.get(name)

    def read() -> None:
        instance.set(name, value)
        instance.read()

    return Call(clocked(read))


def stepping(instance: AnyInstance, dt: float = SHORT, steps: int = 1, once: bool = False) -> Call:
    """Return a communication step of `steps` internal steps of dt [s]; laps begin at the instance's present state."""
    return Call(clocked(partial(instance.step, steps * dt), partial(instance.restore, instance.save())), steps, once)


def quick_share(instance: alfmu.Instance) -> float:
    """Return the share of quick steps in the last lap [%]."""
    steps = instance.memory["tally"][: len(KINDS)]
    return float(100.0 * steps[0] / steps.sum())


# One internal step ------------------------------------------------------------------------------------------------

SCENES: dict[str, tuple[str, dict[str, str]]] = {
    "particle_on_circle": ("particle_on_circle", {}),
    **{f"slider_crank, {c}": ("slider_crank", {"coordinates": c}) for c in ("absolute", "joint", "mixed", "natural")},
    **{name: (name.split(",")[0], {}) for name in ("four_bar", "five_bar", "five_bar, frozen")},
}
"""Mechanism and options by scene; in a frozen scene all parameters are constants."""

MANY = 64
"""Steps in one call."""

STEPS = ("step", f"step of {MANY}")

INTERPRETED = "interpreted / compiled"
"""Column with the ratio of step times: interpreted functions over compiled ones."""

ONCE = ("empty call", "model", "model and factors", "accelerations")
PARTS = ("model", "factorisation", "iterations")
REST = "integration, projection, checks"
"""Timed functions (ONCE); parts of an evaluation, the differences of their times (PARTS); the rest of a step (REST)."""


def step_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Return the rows of step.csv: times of a step made in every way, and its operations by part."""
    rows = []
    for scene, (mechanism, options) in tqdm(SCENES.items(), "step", unit="scene"):
        derived = by_rk4(mechanism, **options)
        if scene.endswith("frozen"):
            derived = specialised(derived, None, ["all"])
        traced, dt = prepared(derived), derived.step_size
        by_oracle = oracle.Instance(derived, Settings(step_size=dt, method="rk4"))
        start(by_oracle)
        calls = {"solve": solve_call(), "oracle step": stepping(by_oracle, dt, once=True)}
        calls |= functions(begun(traced))
        quick = {kernel: begun(prepared(traced, kernel)) for kernel in kernels}
        for kernel, instance in quick.items():
            # A penalty given by the user starts with the careful step.
            careful = begun(instance.equations, penalty=float(instance.penalty.max(initial=1.0)))
            calls |= {
                f"{kernel} step": stepping(instance),
                f"{kernel} step of {MANY}": stepping(instance, steps=MANY),
                f"{kernel} careful step": stepping(careful),
                f"{kernel} outputs": reading(instance),
            }
        row = {"scene": scene, **times(in_turns(calls, effort.rounds, effort.lap), "solve")}
        for name in (f"{kernel} {step}" for kernel in kernels for step in STEPS):
            row[f"oracle / {name}"] = row["oracle step [us]"] / row[f"{name} [us]"]
        if "compiled" in kernels:
            row |= {f"{INTERPRETED} {step}": row[f"vm {step} [us]"] / row[f"compiled {step} [us]"] for step in STEPS}
        row |= {f"{kernel} quick steps [%]": quick_share(instance) for kernel, instance in quick.items()}
        counted = cost(traced)
        whole = {"step": counted.step, "careful": counted.careful, "outputs": counted.outputs}
        row |= {f"operations: {name}": n for name, n in {**counted.parts, **whole}.items()}
        rows.append(row | part_shares(row))
    return {"step": rows}


def functions(instance: alfmu.Instance) -> dict[str, Call]:
    """Return calls of the quick step as one CasADi function, and of the parts of an evaluation.

    The runtime cannot time parts; CasADi's virtual machine makes the same operations in the same order.
    """
    e, memory = whole(instance.equations), instance.memory
    memory["dt"][:] = SHORT
    state = [instance.q, instance.v, memory["u"], memory["p"], [instance.time], memory["k"]]
    x = ca.SX.sym("x")
    bound = {"empty call": (ca.Function("empty", [x], [x]), [[0.0]])}
    bound |= {name: (f, state) for name, f in zip(ONCE[1:], parts(e, e.kernel["quick"].plan)[0].values(), strict=True)}
    together = joined(e, ["quick"])
    [step] = together.kernel["quick"].steps
    bound["step, function alone"] = together.functions[step.function], [memory[name] for name in step.arguments]
    calls = {}
    for name, (function, arguments) in bound.items():
        vm, x = ArrayFunctions(e), [np.array(each, float) for each in arguments]
        y = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        run = vm.bound(function, x, y)
        run.alive = vm, x, y  # keep them alive: the call uses their addresses
        calls[f"CasADi {name}"] = Call(clocked(run))
    return calls


def part_shares(row: Row) -> Row:
    """Return the shares [%] of the parts in the time of the step as one function, without the empty call."""
    once = [row[f"CasADi {name} [us]"] for name in ONCE]
    whole = row["CasADi step, function alone [us]"] - once[0]
    # A step of RK4 has four evaluations.
    shares = [100 * 4 * (once[i + 1] - once[i]) / whole for i in range(len(PARTS))]
    return dict(zip((f"time: {part} [%]" for part in (*PARTS, REST)), [*shares, 100 - sum(shares)], strict=True))


# Every single step ------------------------------------------------------------------------------------------------

FINER = 20
"""Ratio of the default step to the shorter step."""

SPREAD = ("slowest / median", f"slowest / median at 1/{FINER}")
"""Columns with the ratio of the slowest internal step to the median, at the default step and at a shorter one."""


def spread_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Return the rows of spread.csv: the slowest internal step of a mechanism's own motion over the median."""
    rows: list[Row] = []
    for name in tqdm(effort.mechanisms or mechanisms(), "spread", unit="mechanism"):
        traced = prepared(by_rk4(name))
        for kernel in kernels:
            row: Row = {"mechanism": name, "kernel": kernel, "method": traced.solver.get("method", "rk4")}
            for ratio, dt in zip(SPREAD, (traced.step_size, traced.step_size / FINER), strict=True):
                spent, note = single_steps(prepared(traced, kernel), dt, effort)
                median, what = float(np.median(spent)), ratio.removeprefix("slowest / median")
                row |= {f"steps{what}": len(spent), f"median{what} [us]": median, f"slowest{what} [us]": spent.max()}
                row |= {ratio: spent.max() / median, f"slowest step{what} begins at [s]": dt * int(spent.argmax())}
                row["note"] = " ".join(filter(None, [row.get("note"), note])) or None
            rows.append(row)
    return {"spread": rows}


def single_steps(equations: alfmu.Equations, dt: float, effort: Effort) -> tuple[NDArray, str | None]:
    """Return the time [us] of each step of dt [s] from the start, least of all passes, and the reason of an early
    end."""
    instance = alfmu.Instance(equations)
    instance.set("solver.step_size", dt)
    instance.initialize()
    begin, clock, step = instance.save(), time.perf_counter_ns, instance.step
    points = [k * dt for k in range(round(min(equations.stop_time, effort.horizon) / dt))]
    least, note = np.full(len(points), np.inf), None
    collects = gc.isenabled()
    gc.disable()
    try:
        for _ in range(effort.passes):
            instance.restore(begin)
            spent = []
            try:
                for t in points:
                    before = clock()
                    step(dt, t)
                    spent.append(clock() - before)
            except alfmu.AlfmuError as error:
                note = str(error)
            least = np.minimum(least[: len(spent)], spent)
    finally:
        if collects:
            gc.enable()
    return least / 1e3, note


# doStep through FMI -----------------------------------------------------------------------------------------------

STOP = 20.0
"""End of the motion [s]."""

DT, SHORTER = 0.02, 0.001
"""Communication steps [s], equal to the internal steps."""

PASSING, REGULAR = "through singular positions", "between them"

MOTIONS: dict[str, dict[str, float]] = {
    PASSING: {},
    REGULAR: {"start.angle": -math.pi / 2, "start.angular_velocity": 2.0},
}
"""Start values of the motions: the five-bar's own, and one about the lowest position."""

TIERS = ("quick steps", "careful steps", "steps on the branch", "patient steps")
"""Tiers by which a step can be made."""

EMPTY_SLAVE = '''"""A slave that does nothing: what pythonfmu and fmpy cost by themselves."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class EmptySlave(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x = 0.0
        self.register_variable(Real("x", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        return True
'''


def dostep_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Return the rows of dostep.csv: the five-bar with each kernel and an empty FMU, for both steps."""
    with tempfile.TemporaryDirectory(prefix="alfmu_") as folder, ExitStack() as stack:
        script = Path(folder) / "empty_slave.py"
        script.write_text(EMPTY_SLAVE, encoding="utf-8")
        paths = {"empty": FmuBuilder.build_FMU(script, dest=folder)}
        for kernel in tqdm(kernels, "dostep", unit="FMU"):
            paths[kernel] = alfmu.export(
                "five_bar", Path(folder) / f"{kernel}.fmu", kind="python", kernel=kernel, parameters=RK4
            )
        motions = {(slave, name): start for slave in paths for name, start in MOTIONS.items()}
        del motions["empty", REGULAR]
        fmus = {motion: stack.enter_context(Fmu(paths[motion[0]])) for motion in motions}
        rows = []
        for dt in (DT, SHORTER):
            points = [i * dt for i in range(round(STOP / dt))]
            calls = {
                f"{slave} {name}": driven(fmus[slave, name], points, dt, start if slave != "empty" else {})
                for (slave, name), start in motions.items()
            }
            measured = times(in_turns(calls, effort.runs, 0.0), f"empty {PASSING}")
            for (slave, name), start in motions.items():
                call = f"{slave} {name}"
                own = {key.replace(call, "doStep", 1): measured[key] for key in measured if key.startswith(call)}
                own = {key.replace(f" / empty {PASSING}", " / empty"): value for key, value in own.items()}
                made = {} if slave == "empty" else tiers(slave, points, dt, start)
                about = {"slave": slave, "motion": name if slave != "empty" else "none", "step [s]": dt}
                rows.append({**about, **own, **made, "runs": effort.runs, "steps in a run": len(points)})
    return {"dostep": rows}


def driven(fmu: Fmu, points: Sequence[float], dt: float, start: Mapping[str, float]) -> Call:
    """Return the whole motion of an FMU in steps of dt [s] as a call; every lap begins at the start of the motion."""
    do_step = fmu.slave.doStep

    def begin() -> None:
        fmu.reset()
        for name, value in start.items():
            fmu.set(name, value)
        fmu.initialize()

    begin()
    return Call(clocked(lambda: [do_step(t, dt) for t in points], begin), len(points), once=True)


def tiers(kernel: str, points: Sequence[float], dt: float, start: Mapping[str, float]) -> Row:
    """Return the number of steps of the same motion made by each tier, counted in the library."""
    instance, made = alfmu.Instance(prepared(by_rk4("five_bar"), kernel)), Counter()
    for name, value in start.items():
        instance.set(name, value)
    instance.initialize()
    for t in points:
        instance.memory["tally"][:] = 0.0
        instance.step(dt, t)
        steps = instance.memory["tally"][: len(KINDS)]
        made[TIERS[int(np.argmax(steps)) if steps.any() else -1]] += 1
    return {tier: made[tier] for tier in TIERS}


# A native FMU -----------------------------------------------------------------------------------------------------


def native_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Return the rows of native.csv: the five-bar as a native FMU, from C and through fmpy."""
    if "compiled" not in kernels:
        return {}
    points = [i * DT for i in range(round(STOP / DT))]
    with tempfile.TemporaryDirectory(prefix="alfmu_") as folder:
        top = Path(folder)
        path = alfmu.export("five_bar", top / "five_bar.fmu", kind="native", parameters=RK4)
        with zipfile.ZipFile(path) as archive:
            archive.extractall(top / "native")
        guid = fmpy.read_model_description(str(path)).guid
        ready, stepped, kernel = from_c(top, guid, len(points), 3 * effort.runs)
        empty = top / "empty" / "binaries" / fmpy.platform
        empty.mkdir(parents=True)
        library = empty / f"five_bar{PLATFORMS[HERE].suffix}"
        flags = ["-w", "-O2", "-shared", "-fPIC"]
        subprocess.run([*compiler(), *flags, str(SCRIPTS / "empty_fmu.c"), "-o", str(library)], check=True)
        calls = {name: slave_of(top / name, guid, points) for name in ("empty", "native")}
        measured = times(in_turns(calls, effort.runs, 0.0), "empty")
        size = path.stat().st_size / 1000
    through = measured["native [us]"] / (measured["empty [us]"] + 1e6 * kernel)
    row = {"scene": "five_bar", "initialise [us]": 1e6 * ready, "doStep in C [us]": 1e6 * stepped}
    row |= {"kernel step [us]": 1e6 * kernel, "doStep in C / kernel": stepped / kernel}
    row |= {f"{x} through fmpy [us]": measured[f"{y} [us]"] for x, y in (("doStep", "native"), ("empty", "empty"))}
    row |= {"doStep through fmpy / (empty + kernel)": through, "file [kB]": size, "runs": effort.runs}
    return {"native": [row]}


def from_c(top: Path, guid: str, steps: int, rounds: int) -> list[float]:
    """Return medians [s] of an initialisation, a doStep, and a step of the kernel with outputs, timed in turns."""
    unpacked = top / "native"
    flags = [OPTIMISED, "-fno-math-errno", "-ffp-contract=off", "-DNDEBUG", f'-DGUID="{guid}"', f"-I{HEADERS}"]
    flags += [f"-I{unpacked / 'sources'}", str(SCRIPTS / "native_bench.c"), str(unpacked / "sources" / "files.c")]
    libraries = ["-lm", *["-ldl"] * sys.platform.startswith("linux")]
    subprocess.run([*compiler(), *flags, "-o", str(top / "host"), *libraries], check=True)
    given = [str(steps), str(DT), str(rounds), (unpacked / "resources").as_uri()]
    said = subprocess.run([str(top / "host"), *given], check=True, capture_output=True)
    return np.median(np.array(said.stdout.split(), float).reshape(-1, 3), axis=0).tolist()


def slave_of(folder: Path, guid: str, points: Sequence[float]) -> Call:
    """Return the whole motion of an unpacked FMU through fmpy as a call."""
    slave = fmpy.fmi2.FMU2Slave(guid=guid, unzipDirectory=str(folder), modelIdentifier="five_bar", instanceName="one")
    slave.instantiate()

    def begin() -> None:
        slave.reset()
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()

    begin()
    return Call(clocked(lambda: [slave.doStep(t, DT) for t in points], begin), len(points), once=True)


# Gradients --------------------------------------------------------------------------------------------------------

DIFFERENTIATED = ("five_bar", "four_bar", "n_four_bar")
"""Mechanisms whose runs are differentiated."""

LONGEST = 5.0
"""Longest differentiated run [s]."""

DIRECTIONS = 20
"""Number of directions of one forward sweep."""


def gradient_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Return the rows of gradient.csv: time of the gradient of a run by all its numbers over the time of the run."""
    rows: list[Row] = []
    stop = min(LONGEST, effort.horizon)
    for name, method in tqdm([*product(DIFFERENTIATED, ("rk4", "auto"))], "gradient", unit="run"):
        runs = Runs(name, [], stop, 0.01, None, {"solver.method": method})
        laps = in_turns(differentiating(runs), effort.rounds, 0.0)
        row = {"mechanism": name, "method": method, "numbers": len(runs.unit.parameters), "stop time [s]": stop}
        rows.append(row | times(laps, "run"))
    return {"gradient": rows}


def differentiating(runs: Runs) -> dict[str, Call]:
    """Return calls of a run, a run with the gradient of its end by all numbers, and one with forward derivatives."""
    unit, last = runs.unit, [runs.columns(None)[0]]

    def gradient() -> None:
        sweeps = runs.sweeps(last, 0, None)
        sweeps.record()
        weights = np.zeros_like(sweeps.values)
        weights[-1] = 1.0
        sweeps.adjoints(weights)

    def forward() -> None:
        runs.sweeps(last, DIRECTIONS, None).tangents(np.ones((len(unit.parameters), DIRECTIONS)))

    def run() -> None:
        unit._unit.run_on(False)
        unit.run(runs.times, [], runs.table, last)

    calls = {"run": run, "gradient": gradient, f"forward by {DIRECTIONS}": forward}
    return {name: Call(clocked(call), once=True) for name, call in calls.items()}


# Growth with the mechanism ----------------------------------------------------------------------------------------

STRETCH = 16
"""Steps in one call."""

BASE = 10
"""Number of loops whose cost per loop is the reference."""

READY = ("derive [s]", "trace [s]", "peak memory [MB]", "compile [s]")
SPENT = ("operations", "vm step [us]", "compiled step [us]")
"""Columns that are compared, per loop, with those at ten loops."""


def scale_study(effort: Effort, kernels: Sequence[str]) -> Results:
    """Return the rows of scale.csv, one for each N-four-bar; separate processes build it, the first one compiles."""
    cases = [(c, loops) for loops in effort.loops for c in effort.coordinates]
    builds: dict[tuple[str, int], list[tuple[Row, Laps]]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory(prefix="alfmu_") as cache:
        for case in tqdm(cases * effort.builds, "scale", unit="build"):
            with ProcessPoolExecutor(1, get_context("spawn")) as child:
                try:
                    builds[case].append(child.submit(build, *case, effort, kernels, cache).result())
                except BrokenProcessPool:
                    text = f"n_four_bar, {case[1]} loops: the process ended early; free some memory, or take fewer"
                    raise alfmu.AlfmuError(text) from None
    rows = {case: scale_row(*case, builds[case]) for case in cases}
    for (coordinates, loops), row in rows.items():
        base = rows.get((coordinates, BASE), {})
        for name in (*READY, *SPENT):
            if row.get(name) is not None and base.get(name) is not None:
                row[f"{name} per loop / at {BASE}"] = row[name] / loops / (base[name] / BASE)
    return {"scale": list(rows.values())}


def build(coordinates: str, loops: int, effort: Effort, kernels: Sequence[str], cache: str) -> tuple[Row, Laps]:
    """Build an N-four-bar in this process; return the cost of building and the laps of its steps."""
    os.environ["XDG_CACHE_HOME"] = cache
    row: Row = {"memory after import [MB]": peak_memory()}

    def watched(name: str, call: Callable[[], alfmu.Equations]) -> alfmu.Equations:
        begin = time.perf_counter()
        result = call()
        row[name] = time.perf_counter() - begin
        return result

    m = alfmu.load("n_four_bar", loops=loops, coordinates=coordinates)
    derived = watched("derive [s]", lambda: with_defaults(alfmu.derive(m), RK4))
    scene = {"vm": watched("trace [s]", lambda: prepared(derived))}
    row["peak memory [MB]"] = peak_memory()
    if "compiled" in kernels:
        scene["compiled"] = watched("compile [s]", lambda: prepared(scene["vm"], "compiled"))
    instances = {kernel: begun(e) for kernel, e in scene.items()}
    calls = {f"{kernel} step": stepping(instance, steps=STRETCH) for kernel, instance in instances.items()}
    laps = in_turns({"solve": solve_call(), **calls}, math.ceil(effort.rounds / effort.builds), effort.lap)
    row |= {f"{kernel} quick steps [%]": quick_share(instance) for kernel, instance in instances.items()}
    row |= {"n": derived.n, "l": derived.l, "steps in a call": STRETCH}
    traced = whole(scene["vm"])
    return row | {
        "operations": sum(operations(traced.functions[name]) for name in called(traced.kernel["quick"]))
    }, laps


def peak_memory() -> float | None:
    """Return the peak memory [MB] of this process, without that of its parent; None if the system does not tell."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return next(int(line.split()[1]) * 1024 / 1e6 for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return None


def scale_row(coordinates: str, loops: int, builds: Sequence[tuple[Row, Laps]]) -> Row:
    """Return the row of an N-four-bar: laps of all builds, medians of build times, other numbers of the first build."""
    first, laps = builds[0]
    row: Row = {"coordinates": coordinates, "N": loops, **first, "builds": len(builds)}
    for name in ("derive", "trace"):
        spent = [built[f"{name} [s]"] for built, _ in builds]
        row |= {f"{name} [s]": statistics.median(spent), f"{name}, minimum [s]": min(spent)}
    row["derive and trace [s]"] = row["derive [s]"] + row["trace [s]"]
    return row | times({name: [lap for _, each in builds for lap in each[name]] for name in laps}, "solve")


def scale_plot(rows: Sequence[Row]) -> Figure:
    """Plot the cost of a step and of preparation over the number of loops."""
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    panels = (("time of a step [us]", SPENT[1:]), ("time to get ready [s]", (*READY[:2], READY[3])))
    for axes, (title, columns) in zip(figure.subplots(1, 2), panels, strict=True):
        for column, (coordinates, style) in product(columns, (("natural", "o-"), ("absolute", "s--"))):
            chosen = [row for row in rows if row["coordinates"] == coordinates and column in row]
            if chosen:
                x, y = [row["N"] for row in chosen], [row[column] for row in chosen]
                label, color = f"{column.split(' [')[0]}, {coordinates}", f"C{columns.index(column)}"
                axes.plot(x, y, style, color=color, label=label)
        last = max(row["N"] for row in rows)
        top = axes.get_ylim()[1]
        axes.plot([1, last], [top / last, top], ":", color="0.5", label="proportional to N")
        axes.set(xlabel="loops N", ylabel=title, xscale="log", yscale="log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


# The report -------------------------------------------------------------------------------------------------------

STEP_LIMITS = {"compiled {} / solve": 0.3, f"{INTERPRETED} {{}}": 1.6, "oracle / compiled {}": 50, "oracle / vm {}": 50}
DOSTEP_LIMITS = {"compiled": 3, "vm": 4}
SPREAD_LIMIT = 60
NATIVE_LIMITS = {
    "doStep in C / kernel": 1.3,
    "doStep through fmpy / (empty + kernel)": 2.5,
    "initialise [us]": 1000,
    "file [kB]": 300,
}
SCALE_LIMITS = {
    f"vm step [us] per loop / at {BASE}": 1.5,
    f"compiled step [us] per loop / at {BASE}": 2,
    "derive and trace [s]": 30,
    "peak memory [MB]": 2000,
}
TARGETS = (
    *(
        Target("step", {"scene": "five_bar"}, column.format(step), limit, column.startswith("oracle"))
        for column, limit in STEP_LIMITS.items()
        for step in STEPS
    ),
    *(
        Target("spread", {"mechanism": name, "kernel": kernel}, column, SPREAD_LIMIT)
        for name, kernel, column in product(mechanisms(), KERNELS, SPREAD)
    ),
    *(
        Target("dostep", {"slave": kernel, "motion": name, "step [s]": dt}, "doStep / empty", limit)
        for (kernel, limit), name, dt in product(DOSTEP_LIMITS.items(), MOTIONS, (DT, SHORTER))
    ),
    *(Target("native", {"scene": "five_bar"}, *each) for each in NATIVE_LIMITS.items()),
    *(
        Target("gradient", {"mechanism": name, "method": method}, "gradient / run", 6)
        for name, method in product(DIFFERENTIATED, ("rk4", "auto"))
    ),
    *(
        Target("scale", {"coordinates": coordinates, "N": FULL.loops[-1]}, column, limit)
        for coordinates in FULL.coordinates
        for column, limit in SCALE_LIMITS.items()
    ),
)

CHAPTERS = {
    "step": (
        "One internal step",
        f"""Each mechanism at a regular position, {START["start.angle"]:g} rad from its zero. `step` is a call of
        `Instance.step` from Python, `step of {MANY}` one that makes so many internal steps, by step; either ends with
        the outputs. `vm` is the runtime's interpreter, `compiled` the same runtime with compiled functions. Outputs are
        read anew after an input has been set. `function alone` is the step as one function of CasADi's virtual machine,
        which makes the same operations; shares of time are differences between such functions.""",
    ),
    "spread": (
        "The slowest internal step",
        f"""Every step of a mechanism's own motion up to its stop time (`--quick`: one second), timed by itself
        from Python with its outputs, at the default step and at 1/{FINER} of it: of each step the least time of some
        passes. By a method with error control a step is a communication step of that length.""",
    ),
    "dostep": (
        "doStep of the five-bar through FMI",
        f"""Called through fmpy every {DT:g} s, and every {SHORTER:g} s, up to {STOP:g} s, in turns with an FMU of
        pythonfmu that does nothing: from a start in a singular position, through many of them, and about
        the lowest position, between them. Steps by what made them were counted in the library.""",
    ),
    "native": (
        "The five-bar as a native FMU",
        f"""The same motion, {STOP:g} s in steps of {DT:g} s. From C the FMU is linked with a host, where its doStep and
        the kernel's part of it take turns; through fmpy it takes turns with a C library whose functions do nothing.
        Initialise is an instantiation up to the first step; the file is for one platform.""",
    ),
    "gradient": (
        "Gradients",
        f"""Processor time of a run from its start, of the same with the derivatives of its end by all parameters and
        start values, swept back, and forward by {DIRECTIONS} directions; by the interpreter, in turns.""",
    ),
    "scale": (
        "Growth with the mechanism",
        f"""The N-four-bar, built in processes of its own; {STRETCH} steps in a call of `Instance.step`. Times to derive
        and trace are medians of all processes; the first one compiles, with an empty cache, and tells its memory after
        tracing, imports included.""",
    ),
}

LIMITS = """
- Times hold for the machine above and for what else it did meanwhile: where median and minimum differ, it was busy.
  Load slows calls from Python more than long computations, so it changes ratios to the solve as well.
- The yardstick `numpy.linalg.solve` is mostly the way from Python to LAPACK and back at this size.
- Steps are timed at one regular position; the motions of dostep and spread pass singular ones.
- The oracle iterates until it converges, kernels a fixed number of times; both leave the same errors. Its step has the
  mechanism's own length; those of the kernels cost the same at any, and are so short that the position stays.
- A doStep is timed from Python, and the empty slave pays for the same way; a host in another language pays less for it
  and sees larger ratios.
- C of many loops fills several files that are compiled side by side: times depend on the number of processors.
"""

STUDIES = {
    "step": step_study,
    "spread": spread_study,
    "dostep": dostep_study,
    "native": native_study,
    "gradient": gradient_study,
    "scale": scale_study,
}


INTRODUCTION = """
Measure an internal step by part, a doStep through FMI, and how cost grows with a mechanism. Ratios are of medians of
what was timed in turns.
"""

PACKAGES = ("alfmu", "casadi", "numpy", "scipy", "fmpy", "pythonfmu", "matplotlib")

WIDE = 12
"""Number of columns of a CSV file from which its table in the report is transposed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the studies selected on the command line; return the exit code."""
    os.environ[VARIABLE] = "off"  # preparation is measured, too
    line = argparse.ArgumentParser(
        description=f"{paragraph(INTRODUCTION)} Writes benchmark.md, CSV files and a picture.",
        epilog="needs the extra alfmu[test]; takes some minutes; overwrites an earlier run in the same folder",
    )
    folder, some = Path("results") / "benchmark", f"some of: {', '.join(STUDIES)}"
    line.add_argument("-o", "--output", type=Path, default=folder, help="folder (default: %(default)s)")
    line.add_argument("--only", nargs="+", choices=STUDIES, metavar="STUDY", help=some)
    size = line.add_mutually_exclusive_group()
    efforts = {"": USUAL, "quick": QUICK, "full": FULL}
    for option in filter(None, efforts):
        size.add_argument(f"--{option}", action="store_const", const=option, dest="size", default="")
    chosen = line.parse_args(arguments)
    only = [name for name in STUDIES if name in (chosen.only or STUDIES)]
    command = ["python", "scripts/benchmark.py", *[f"--{chosen.size}"] * bool(chosen.size)]
    command += ["--only", *only] * (len(only) < len(STUDIES))
    path = chosen.output / "benchmark.md"
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
        path.touch()
    except OSError as error:
        print(f"{path} cannot be written ({error.strerror}); give another folder with -o", file=sys.stderr)
        return 1
    try:
        measure(path, efforts[chosen.size], only, " ".join(command))
    except alfmu.AlfmuError as error:
        print(error, file=sys.stderr)
        return 1
    print(path)
    return 0


def measure(path: Path, effort: Effort, studies: Sequence[str], command: str) -> None:
    """Run the studies and write their results."""
    begin, without = time.perf_counter(), no_compiler()
    kernels = ("vm",) if without else KERNELS
    where: list[Row] = [{"what": what, "value": value} for what, value in environment(command, PACKAGES)]
    results: Results = {"environment": where, "targets": []}
    for name in studies:
        results |= STUDIES[name](effort, kernels)
    where += [{"what": "kernel", "value": kernels[-1]}, {"what": "without compiled code as", "value": without}]
    where.append({"what": "it took", "value": f"{rounded(time.perf_counter() - begin)} s"})
    results["targets"] = [judged(target, results) for target in TARGETS]
    for name, rows in results.items():
        write_csv(path.parent / f"{name}.csv", rows)
    if "scale" in results:
        scale_plot(results["scale"]).savefig(path.parent / "scale.png", dpi=120, metadata={"Software": None})
    path.write_text(report(results), encoding="utf-8")


def report(results: Results) -> str:
    """Return the report in Markdown: each chapter with all columns of its CSV file, rounded."""
    note = "Judged by the numbers of this run alone; what was left out is not measured."
    parts = ["# Costs of alfmu", paragraph(INTRODUCTION), table("Machine and versions", "environment", results)]
    parts += ["## Targets", note, table("Target against measured", "targets", results)]
    for name, (heading, introduction) in CHAPTERS.items():
        if name in results:
            parts += [f"## {heading}", paragraph(introduction), table(heading, name, results)]
            parts += ["![Cost against the number of loops](scale.png)"] * (name == "scale")
    return "\n\n".join([*parts, "## Where the comparison stops being fair", LIMITS.strip()]) + "\n"


def table(title: str, name: str, results: Results) -> str:
    """Return the rows of a CSV file as a Markdown table, transposed if there are many columns."""
    rows = results[name]
    columns = [
        x for x in dict.fromkeys(x for row in rows for x in row) if any(row.get(x) not in (None, "") for row in rows)
    ]
    if len(columns) <= WIDE or len(rows) >= len(columns):
        return shown(title, name, columns, rows)
    first, *others = columns
    lines = [[column, *(row.get(column) for row in rows)] for column in others]
    return f"**{title}** (`{name}.csv`)\n\n" + markdown([first, *(str(row[first]) for row in rows)], lines)


def no_compiler() -> str | None:
    """Return why kernels cannot be compiled here; None if they can."""
    try:
        prepared(alfmu.derive(alfmu.load("particle_on_circle")), "compiled")
    except alfmu.ExportError as error:
        return str(error)
    return None


if __name__ == "__main__":
    raise SystemExit(main())
