"""Measure what alfmu costs: an internal step by part, a doStep through FMI, and how both grow with a mechanism.

Writes step.csv, dostep.csv, scale.csv, two pictures and `benchmark.md` into one folder. Times of one machine mean
little, so each stands beside a yardstick that was timed in turns with it: `numpy.linalg.solve` of an 8 x 8 system, the
NumPy oracle, an FMU that does nothing, the same mechanism with ten loops.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import textwrap
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib
import numpy as np
from _report import Cell, environment, markdown, rounded, write_csv
from numpy.typing import NDArray
from tqdm import tqdm

import alfmu
from alfmu.cost import cost, operations
from alfmu.fmi.drive import Fmu
from alfmu.kernel.emit import sources
from alfmu.kernel.trace import parts
from alfmu.kernel.vm import program_function
from alfmu.simulation import prepared
from alfmu.specialisation import specialised

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

KERNELS = ("vm", "compiled")

Row = dict[str, Cell]


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    lap: float
    """Shortest time that is measured at once [s]."""
    step_rounds: int
    dostep_rounds: int
    loops: tuple[int, ...]
    """Numbers of loops of the N-four-bar."""
    scale_rounds: int
    builds: int
    """Processes that derive and trace each of them anew."""
    coordinates: tuple[str, ...] = ("natural", "absolute")
    """Of the N-four-bar."""


QUICK = Effort(1e-3, 7, 2, (1, 10), 5, 1, ("natural",))
USUAL = Effort(2e-3, 40, 10, (1, 10, 40, 200), 15, 3)
FULL = Effort(2e-3, 40, 10, (1, 10, 40, 200, 1000), 15, 3)


# Timing -----------------------------------------------------------------------------------------------------------


@dataclass
class Timing:
    """A call that is timed again and again, in turns with others."""

    call: Callable[[], Any]
    reset: Callable[[], Any] | None = None
    """What has to happen before each call, outside the clock; None: calls follow one another under one clock."""
    units: int = 1
    """What one call makes: steps, for example."""
    calls: int = 1
    """Calls in a lap."""
    laps: list[float] = field(default_factory=list)
    """Time of a unit in each lap [s]."""

    def prepare(self, shortest: float) -> None:
        """Warm up, and choose how many calls make a lap of at least `shortest` [s]."""
        self.lap()
        once = max(self.lap() for _ in range(2)) * self.units
        self.calls = max(1, math.ceil(shortest / once))

    def lap(self) -> float:
        """Time of a unit [s], the mean of one lap."""
        clock, call, reset, spent = time.perf_counter, self.call, self.reset, 0.0
        if reset is None:
            begin = clock()
            for _ in range(self.calls):
                call()
            spent = clock() - begin
        else:
            for _ in range(self.calls):
                reset()
                begin = clock()
                call()
                spent += clock() - begin
        return spent / (self.calls * self.units)


def in_turns(timings: Sequence[Timing], rounds: int, shortest: float, label: str) -> None:
    """Time every call once a round."""
    for timing in timings:
        timing.prepare(shortest)
    gc.collect()
    gc.disable()
    try:
        for _ in tqdm(range(rounds), label, unit="round"):
            for timing in timings:
                timing.laps.append(timing.lap())
    finally:
        gc.enable()


Span = tuple[float, float]
"""Median and minimum [s]."""


def span(laps: Sequence[float]) -> Span:
    return statistics.median(laps), min(laps)


def summed(terms: Iterable[tuple[float, Span]]) -> Span:
    """Weighted sum of medians, and of minima."""
    terms = list(terms)
    return sum(w * x[0] for w, x in terms), sum(w * x[1] for w, x in terms)


def bound(function: ca.Function, x: Sequence[NDArray]) -> Callable[[], Any]:
    """A function bound to copies of its arguments, called without copying anything in Python."""
    buffer, run = function.buffer()
    alive = [np.array(each, float) for each in x], [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, each in enumerate(alive[0]):
        buffer.set_arg(i, memoryview(each))
    for i, each in enumerate(alive[1]):
        buffer.set_res(i, memoryview(each))
    run.alive = buffer, alive  # as long as the call, which knows their addresses
    return run


def solve_timing() -> Timing:
    """The yardstick: `numpy.linalg.solve` of 8 equations."""
    random = np.random.default_rng(0)
    A, b = random.normal(size=(8, 8)) + 8 * np.eye(8), random.normal(size=8)
    return Timing(lambda: np.linalg.solve(A, b))


# One internal step ------------------------------------------------------------------------------------------------

SETTLE = 0.4
"""Time [s] after which a motion from the defaults is stopped, at a regular position, and timed."""

MANY, SHORT = 64, 2e-4
"""Steps in one call, and their length [s]: short, so that the position stays regular."""

STEP_SCENES = (
    ("particle_on_circle", {}, False),
    *(("slider_crank", {"coordinates": c}, False) for c in ("absolute", "joint", "mixed", "natural")),
    ("four_bar", {}, False),
    ("five_bar", {}, False),
    ("five_bar", {}, True),
)
"""Mechanism, options, whether all parameters are frozen."""

JUDGED = ("five_bar", "-", "free")
"""Scene that targets speak of: the mechanism, coordinates, parameters."""

PARTS = ("model", "factorisation", "iterations", "integration", "projection", "checks")
SHARED = "less what they share"

SOLVE, STEP, ALONE, IN_MANY = "numpy.linalg.solve, 8 x 8", "step", "quick step, function alone", "quick step, of many"
CAREFUL, READ = "careful step", "outputs"
EMPTY, NOTHING = "empty function through a buffer", "empty call with a clock of its own"
MODEL, FACTORED, ITERATED = "model once", "model and factorisation once", "an evaluation: with iterations, once"

BUFFER = "one call from Python to CasADi through a buffer, repeated under one clock"
INCLUDES = {
    SOLVE: "the call from Python, repeated under one clock",
    EMPTY: f"floor of what says so: {BUFFER}",
    NOTHING: "floor of single calls: reading the clock twice and calling a Python function",
    MODEL: BUFFER,
    FACTORED: BUFFER,
    ITERATED: BUFFER,
    ALONE: BUFFER,
    STEP: "one call from Python with a clock of its own; state put back outside the clock",
    IN_MANY: f"one call from Python for {MANY} steps of {SHORT:g} s, by step; state put back outside the clock",
    CAREFUL: "one call from Python with a clock of its own; state put back outside the clock",
    READ: "one call from Python with a clock of its own",
    "model": "evaluations of a step times the model",
    "factorisation": "evaluations of a step times the difference of two measured functions",
    "iterations": "evaluations of a step times the difference of two measured functions",
    "integration": "sum over measured functions: stages and weighted sum",
    "projection": "sum over measured functions",
    "checks": "the measured function that closes a step",
    SHARED: "the step as one function, less all parts: what they share, and floors that parts pay several times",
}

STEP_COLUMNS = (
    "mechanism",
    "coordinates",
    "parameters",
    "quantity",
    "by",
    "operations",
    "median [us]",
    "minimum [us]",
    "median / solve",
    "minimum / solve",
    "oracle / this, median",
    "oracle / this, minimum",
    "quick steps [%]",
    "repeats",
    "calls in a repeat",
    "includes",
)

Key = tuple[str, str]
"""Quantity, and what computes it."""


class StepScene:
    """One mechanism at a regular position: all that is timed of it, in turns."""

    def __init__(self, mechanism: str, options: dict[str, str], frozen: bool):
        self.name = mechanism, options.get("coordinates", "-"), "frozen" if frozen else "free"
        derived = alfmu.derive(alfmu.load(mechanism, **options))
        if frozen:
            derived = specialised(derived, None, ["all"])
        self.equations = prepared(derived, "vm")
        self.step_size = derived.step_size
        self.cost = cost(self.equations)
        self.timings: dict[Key, Timing] = {(SOLVE, "numpy"): solve_timing()}
        self.operations: dict[Key, int] = {}
        self._instances: dict[Key, alfmu.Instance] = {}  # a compiled machine knows the address of a memory alone
        vm = alfmu.Instance(self.equations)
        vm.initialize()
        while vm.time < SETTLE - self.step_size / 2:
            vm.step(min(self.step_size, SETTLE - vm.time))
        self._state = vm.state.copy()
        self._functions(vm)
        for by in KERNELS:
            self._kernel(prepared(self.equations, by), by)
        self._oracle(derived)

    def _functions(self, vm: alfmu.Instance) -> None:
        """What a step is made of, function by function, at arguments that a step has."""
        e, program, memory, n = self.equations, self.equations.kernel["quick"], vm.memory, self.equations.n
        memory["dt"][:] = self.step_size
        known = {name: memory[name].copy() for name in ("z", "u", "p", "k", "dt")}
        z = known["z"]
        arguments = [z[:n], z[n : 2 * n], known["u"], known["p"], z[[vm.layout.time]], known["k"]]
        evaluation, _ = parts(e, program)
        once = dict(zip((MODEL, FACTORED, ITERATED), evaluation.values(), strict=True))
        for name, function in once.items():
            self._function(name, function, arguments)
        self._function(ALONE, program_function(e, program), list(known.values()))
        self.called = Counter(name for name, _, _ in program["calls"])
        for name, inputs, outputs in program["calls"]:
            x = [known[key] for key in inputs]
            if _part(name) and (name, "vm") not in self.timings:
                self._function(name, e.functions[name], x)
            results = e.functions[name].call(x)
            known |= {key: np.array(y).ravel() for key, y in zip(outputs, results, strict=True)}

    def _function(self, name: str, function: ca.Function, x: Sequence[NDArray]) -> None:
        self.timings[name, "vm"] = Timing(bound(function, x))
        self.operations[name, "vm"] = operations(function)

    def _kernel(self, e: alfmu.Equations, by: str) -> None:
        """Steps and outputs by a kernel's machine, each on an instance of its own."""
        for quantity, steps, dt in ((STEP, 1, self.step_size), (IN_MANY, MANY, SHORT), (CAREFUL, 1, self.step_size)):
            instance = self._at_state(e)
            if quantity == CAREFUL:
                instance.memory["control"][1] = 1.0
            self.timings[quantity, by] = self._advancing(instance, steps, dt)
            self._instances[quantity, by] = instance
            self.operations[quantity, by] = self.cost.careful if quantity == CAREFUL else self.cost.step
        reader = self._instances[READ, by] = self._at_state(e)
        self.timings[READ, by] = Timing(reader.machine.read, _nothing)
        self.operations[READ, by] = self.cost.outputs

    def _advancing(self, instance: alfmu.Instance, steps: int, dt: float) -> Timing:
        advance, state, saved = instance.machine.advance, instance.state, self._state

        def reset() -> None:
            state[:] = saved

        return Timing(lambda: advance(steps, dt), reset, steps)

    def _oracle(self, derived: alfmu.Equations) -> None:
        instance, dt = self._at_state(derived), self.step_size
        saved = instance.save()

        def reset() -> None:
            instance.restore(saved)

        self.timings[STEP, "oracle"] = Timing(lambda: instance.step(dt), reset)
        self.timings[READ, "oracle"] = Timing(instance.read, reset)

    def _at_state(self, e: alfmu.Equations) -> alfmu.Instance:
        instance = alfmu.Instance(e)
        instance.initialize()
        instance.state[:] = self._state
        return instance

    def spans(self) -> dict[Key, Span]:
        """Everything measured, and the parts that are made of it."""
        known = {key: span(timing.laps) for key, timing in self.timings.items()}
        stages = self.called["rate"]
        once = [known[name, "vm"] for name in (MODEL, FACTORED, ITERATED)]
        made = {
            "model": summed([(stages, once[0])]),
            "factorisation": summed([(stages, once[1]), (-stages, once[0])]),
            "iterations": summed([(stages, once[2]), (-stages, once[1])]),
        }
        for part in PARTS[3:]:
            made[part] = summed((k, known[name, "vm"]) for name, k in self.called.items() if _part(name) == part)
        made[SHARED] = summed([(1, known[ALONE, "vm"]), *((-1, made[part]) for part in PARTS)])
        return known | {(part, "vm"): x for part, x in made.items()}

    def counted(self) -> dict[Key, int]:
        """Operations of everything that has some."""
        by_part = {(part, "vm"): self.cost.parts[part] for part in PARTS[:5]}
        close = sum(self.operations[name, "vm"] for name in self.called if _part(name) == "checks")
        rest = self.cost.step - close - sum(by_part.values())
        return self.operations | by_part | {("checks", "vm"): close, (SHARED, "vm"): rest}

    def rows(self) -> list[Row]:
        """Rows of step.csv."""
        spans, counted = self.spans(), self.counted()
        return [self._row(key, spans, counted) for key in spans]

    def _row(self, key: Key, spans: dict[Key, Span], counted: dict[Key, int]) -> Row:
        quantity, by = key
        timing, oracle = self.timings.get(key), spans.get((quantity, "oracle"))
        if quantity in (ALONE, IN_MANY):
            oracle = spans[STEP, "oracle"]
        row = _times(spans[key], spans[SOLVE, "numpy"], "solve")
        if oracle and by != "oracle":
            row |= {f"oracle / this, {k}": o / x for k, o, x in zip(_STATISTICS, oracle, spans[key], strict=True)}
        if quantity in (STEP, IN_MANY, CAREFUL) and by in KERNELS:
            quick, careful = self._instances[key].memory["tally"]
            row["quick steps [%]"] = 100 * quick / (quick + careful)
        return {
            **dict(zip(STEP_COLUMNS, self.name, strict=False)),
            "quantity": quantity,
            "by": by,
            "operations": counted.get(key),
            **row,
            "repeats": len(next(iter(self.timings.values())).laps),
            "calls in a repeat": timing.calls if timing else None,
            "includes": INCLUDES.get(quantity, BUFFER),
        }


_STATISTICS = "median", "minimum"


def _part(function: str) -> str:
    """The part that a function of the kernel belongs to; empty for those that are measured otherwise."""
    if function == "sum" or function.startswith("stage"):
        return "integration"
    if function.endswith(("_place", "_settle", "_correct")):
        return "projection"
    return "checks" if function.endswith("_close") else ""


def _nothing() -> None:
    pass


def _times(spent: Span, yardstick: Span, name: str) -> Row:
    """Times of a row [us], and their ratios to a yardstick."""
    times = {f"{k} [us]": 1e6 * x for k, x in zip(_STATISTICS, spent, strict=True)}
    return times | {f"{k} / {name}": x / y for k, x, y in zip(_STATISTICS, spent, yardstick, strict=True)}


def step_study(effort: Effort, scenes: Sequence[tuple[str, dict[str, str], bool]] = STEP_SCENES) -> list[Row]:
    """Rows of step.csv: every scene, then the floors of the measurement."""
    built = [StepScene(*scene) for scene in tqdm(scenes, "step: build", unit="scene")]
    x = ca.SX.sym("x")
    floors = {
        (SOLVE, "numpy"): solve_timing(),
        (EMPTY, "vm"): Timing(bound(ca.Function("empty", [x], [x]), [np.zeros(1)])),
        (NOTHING, "Python"): Timing(lambda: None, _nothing),
    }
    timings = [t for scene in built for t in scene.timings.values()] + list(floors.values())
    in_turns(timings, effort.step_rounds, effort.lap, "step")
    rows = [row for scene in built for row in scene.rows()]
    solve = span(floors[SOLVE, "numpy"].laps)
    for (quantity, by), timing in floors.items():
        rows.append(
            {
                **dict(zip(STEP_COLUMNS, ("floor", "-", "-", quantity, by), strict=False)),
                **_times(span(timing.laps), solve, "solve"),
                "repeats": len(timing.laps),
                "calls in a repeat": timing.calls,
                "includes": INCLUDES[quantity],
            }
        )
    return rows


# doStep through FMI -----------------------------------------------------------------------------------------------

STOP, DT, BATCH = 20.0, 0.02, 200
"""Motion of the five-bar that is timed [s], communication step [s], steps under one clock."""

EMPTY_SLAVE = '''"""A slave that does nothing: what pythonfmu and fmpy cost by themselves."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class EmptySlave(Fmi2Slave):
    """One output that never changes."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.x = 0.0
        self.register_variable(Real("x", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        return True
'''

DO_STEP, AND_READ = "doStep", "doStep and getReal"
DOSTEP_TARGETS = {"compiled": 4.0, "vm": 14.0}
"""Most that a doStep may take over that of the empty slave."""

DOSTEP_COLUMNS = (
    "slave",
    "call",
    "outputs read",
    "median [us]",
    "minimum [us]",
    "median / empty",
    "minimum / empty",
    "target / empty",
    "repeats",
    "steps in a repeat",
    "steps in a batch",
    "quick steps",
    "careful steps",
    "oracle steps",
)


class Driven:
    """An FMU on its way through the motion, batch by batch; every lap begins where the motion does."""

    def __init__(self, path: Path, reads: bool):
        self.fmu = Fmu(path)
        self.fmu.initialize()
        real = [v for v in self.fmu.description.modelVariables if v.causality == "output" and v.type == "Real"]
        self.references = [v.valueReference for v in real] if reads else []
        self.laps: list[float] = []
        """Time of a step [s], the mean over one passage of the motion."""

    def batch(self, first: int, steps: int) -> float:
        """Time [s] of some steps; the loop around them in Python included."""
        do_step, get_real, references = self.fmu.slave.doStep, self.fmu.slave.getReal, self.references
        times = [i * DT for i in range(first, first + steps)]
        clock = time.perf_counter
        if references:
            begin = clock()
            for t in times:
                do_step(t, DT)
                get_real(references)
        else:
            begin = clock()
            for t in times:
                do_step(t, DT)
        return clock() - begin

    def rewind(self) -> None:
        self.fmu.reset()
        self.fmu.initialize()


def dostep_study(effort: Effort, stop: float = STOP) -> list[Row]:
    """Rows of dostep.csv: the five-bar with each kernel against an FMU that does nothing."""
    steps = round(stop / DT)
    with tempfile.TemporaryDirectory(prefix="alfmu_") as folder, ExitStack() as stack:
        paths = {"empty": empty_fmu(Path(folder))}
        for kernel in tqdm((*KERNELS, "oracle"), "doStep: export", unit="FMU"):
            paths[kernel] = alfmu.export("five_bar", Path(folder) / f"{kernel}.fmu", kernel=kernel)
        units = {(slave, reads): Driven(path, reads) for reads in (False, True) for slave, path in paths.items()}
        for unit in units.values():
            stack.enter_context(unit.fmu)
            unit.batch(0, min(BATCH, steps))
        for _ in tqdm(range(effort.dostep_rounds), "doStep", unit="round"):
            for unit in units.values():
                unit.rewind()
            spent = dict.fromkeys(units, 0.0)
            for first in range(0, steps, BATCH):
                for key, unit in units.items():
                    spent[key] += unit.batch(first, min(BATCH, steps - first))
            for key, unit in units.items():
                unit.laps.append(spent[key] / steps)
        spans = {key: span(unit.laps) for key, unit in units.items()}
        read = {slave: len(units[slave, True].references) for slave in paths}
    tiers = {kernel: tier_counts(kernel, steps) for kernel in (*KERNELS, "oracle")}
    return [
        {
            "slave": slave,
            "call": AND_READ if reads else DO_STEP,
            "outputs read": read[slave] if reads else 0,
            **_times(spans[slave, reads], spans["empty", reads], "empty"),
            "target / empty": None if reads else DOSTEP_TARGETS.get(slave),
            "repeats": effort.dostep_rounds,
            "steps in a repeat": steps,
            "steps in a batch": BATCH,
            **tiers.get(slave, {}),
        }
        for slave, reads in units
    ]


def empty_fmu(folder: Path) -> Path:
    """The FMU that does nothing, packed by pythonfmu in a process of its own."""
    script = folder / "empty_slave.py"
    script.write_text(EMPTY_SLAVE, encoding="utf-8")
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", str(script), "-d", str(folder)]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "EmptySlave.fmu"


def tier_counts(kernel: str, steps: int) -> Row:
    """How many internal steps of the same motion each tier makes, seen from the library."""
    instance = alfmu.Instance(prepared(alfmu.derive(alfmu.load("five_bar")), kernel))
    instance.initialize()
    counts, tally = np.zeros(3, int), instance.memory["tally"]
    for i in range(steps):
        tally[:] = 0.0
        instance.step(DT, i * DT)
        quick, careful = map(int, tally)
        counts += quick, careful, quick + careful == 0
    return dict(zip(("quick steps", "careful steps", "oracle steps"), counts.tolist(), strict=True))


# Growth with the mechanism ----------------------------------------------------------------------------------------

SCALE_DT, SCALE_STEPS, SCALE_SETTLE = 0.002, 64, 50
"""Internal step [s], steps in one call, steps before what is timed."""

BASE = 10
"""Loops that costs per loop are compared with."""

SCALE_COLUMNS = (
    "coordinates",
    "loops",
    "n",
    "l",
    "derive median [s]",
    "derive minimum [s]",
    "trace median [s]",
    "trace minimum [s]",
    "build repeats",
    "memory after import [MB]",
    "peak memory, derived and traced [MB]",
    "peak memory, compiled and run [MB]",
    "operations of a step",
    "operations of a step per loop",
    "operations per loop / at 10",
    "C source [bytes]",
    "C files",
    "write C [s]",
    "write and compile C [s]",
    "compile / at 10, per loop",
    "library [bytes]",
    *(
        f"{kernel} {column}"
        for kernel in KERNELS
        for column in (
            "step median [us]",
            "step minimum [us]",
            "step per loop median [us]",
            "step per loop minimum [us]",
            "step per loop / at 10, median",
            "step per loop / at 10, minimum",
            "step / solve, median",
            "quick steps [%]",
        )
    ),
    "vm / compiled, median",
    "solve median [us]",
    "solve minimum [us]",
    "repeats",
    "steps in a call",
)


def peak_memory() -> float | None:
    """Most memory that this process ever held [MB], what its parent held before it not counted; None if unknown."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
        return next(int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return None


def worker(coordinates: str, loops: int, only_trace: bool) -> None:
    """Build one N-four-bar and say what it took; then time a lap for each line that comes in: `solve` or a kernel."""
    built: dict[str, Any] = {"memory after import [MB]": peak_memory()}

    def timed(name: str, call: Callable[[], Any]) -> Any:
        begin = time.perf_counter()
        result = call()
        built[name] = time.perf_counter() - begin
        return result

    derived = timed("derive", lambda: alfmu.derive(alfmu.load("n_four_bar", loops=loops, coordinates=coordinates)))
    traced = timed("trace", lambda: prepared(derived, "vm"))
    built["peak memory, derived and traced [MB]"] = peak_memory()
    if only_trace:
        print(json.dumps(built), flush=True)
        return
    files, _ = timed("write C [s]", lambda: sources(traced))
    built |= {"C source [bytes]": sum(map(len, files)), "C files": len(files)}
    compiled = timed("write and compile C [s]", lambda: prepared(traced, "compiled"))
    timings, instances = {"solve": solve_timing()}, {}
    for kernel, e in zip(KERNELS, (traced, compiled), strict=True):
        instances[kernel] = alfmu.Instance(e, alfmu.Settings(step_size=SCALE_DT))
        timings[kernel] = _scale_timing(instances[kernel])
    for timing in timings.values():
        timing.prepare(USUAL.lap)
    program = traced.kernel["quick"]
    built |= {
        "n": derived.n,
        "l": derived.l,
        "peak memory, compiled and run [MB]": peak_memory(),
        "operations of a step": sum(operations(traced.functions[name]) for name, _, _ in program["calls"]),
        "library [bytes]": compiled.library.path.stat().st_size,
    }
    print(json.dumps(built), flush=True)
    for line in sys.stdin:
        name, result = line.strip(), {}
        result["time"] = timings[name].lap()
        if name in instances:
            result["tally"] = instances[name].memory["tally"].tolist()
        print(json.dumps(result), flush=True)


def _scale_timing(instance: alfmu.Instance) -> Timing:
    """Many steps in one call, from a state a little after the start."""
    instance.initialize()
    advance, state = instance.machine.advance, instance.state
    advance(SCALE_SETTLE, SCALE_DT)
    instance.memory["tally"][:] = 0.0
    saved = state.copy()

    def reset() -> None:
        state[:] = saved

    return Timing(lambda: advance(SCALE_STEPS, SCALE_DT), reset, SCALE_STEPS)


class Worker:
    """A process that has built one N-four-bar and times it when asked."""

    def __init__(self, coordinates: str, loops: int, cache: str, only_trace: bool = False):
        self.name = coordinates, loops
        command = [sys.executable, __file__, "--worker", coordinates, str(loops), *["--trace"] * only_trace]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "XDG_CACHE_HOME": cache, "MPLBACKEND": "Agg"},
        )
        self.built = self._answer()
        self.laps: dict[str, list[float]] = {name: [] for name in ("solve", *KERNELS)}
        self.tally: dict[str, list[float]] = {}

    def lap(self, name: str) -> None:
        """Time `solve` or a kernel once more."""
        self._process.stdin.write(f"{name}\n")
        self._process.stdin.flush()
        answer = self._answer()
        self.laps[name].append(answer["time"])
        if "tally" in answer:
            self.tally[name] = answer["tally"]

    def close(self) -> None:
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()

    def _answer(self) -> dict[str, Any]:
        line = self._process.stdout.readline()
        if not line:
            self.close()
            raise RuntimeError(f"n_four_bar, {self.name}: its process ended with {self._process.returncode}")
        return json.loads(line)


def scale_study(effort: Effort) -> list[Row]:
    """Rows of scale.csv; the cache of compiled kernels is empty at the beginning."""
    cases = [(c, loops) for loops in effort.loops for c in effort.coordinates]
    builds: dict[tuple[str, int], list[dict]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory(prefix="alfmu_") as cache, ExitStack() as stack:
        for _ in tqdm(range(effort.builds - 1), "scale: derive, trace", unit="round"):
            for case in cases:
                again = Worker(*case, cache, only_trace=True)
                again.close()
                builds[case].append(again.built)
        workers = []
        for case in tqdm(cases, "scale: build", unit="scene"):
            workers.append(Worker(*case, cache))
            stack.callback(workers[-1].close)
            builds[case].append(workers[-1].built)
        for _ in tqdm(range(effort.scale_rounds), "scale", unit="round"):
            for name in ("solve", *KERNELS):
                for each in workers:
                    each.lap(name)
    rows = [_scale_row(each, builds[each.name]) for each in workers]
    for row in rows:
        _compare(row, next((x for x in rows if (x["coordinates"], x["loops"]) == (row["coordinates"], BASE)), None))
    return rows


def _scale_row(measured: Worker, builds: Sequence[dict]) -> Row:
    coordinates, loops = measured.name
    built = measured.built
    row: Row = {name: built[name] for name in SCALE_COLUMNS if name in built}
    row |= {"coordinates": coordinates, "loops": loops, "build repeats": len(builds)}
    for name in ("derive", "trace"):
        row |= {f"{name} {k} [s]": x for k, x in zip(_STATISTICS, span([b[name] for b in builds]), strict=True)}
    row["operations of a step per loop"] = built["operations of a step"] / loops
    spans = {name: span(laps) for name, laps in measured.laps.items()}
    for kernel in KERNELS:
        quick, careful = measured.tally[kernel]
        for k, x in zip(_STATISTICS, spans[kernel], strict=True):
            row[f"{kernel} step {k} [us]"] = 1e6 * x
            row[f"{kernel} step per loop {k} [us]"] = 1e6 * x / loops
        row[f"{kernel} step / solve, median"] = spans[kernel][0] / spans["solve"][0]
        row[f"{kernel} quick steps [%]"] = 100 * quick / (quick + careful)
    row["vm / compiled, median"] = spans["vm"][0] / spans["compiled"][0]
    row |= {f"solve {k} [us]": 1e6 * x for k, x in zip(_STATISTICS, spans["solve"], strict=True)}
    return row | {"repeats": len(measured.laps["solve"]), "steps in a call": SCALE_STEPS}


def _compare(row: Row, base: Row | None) -> None:
    """Add ratios of costs per loop to those at ten loops, where these were measured."""
    if base is None:
        return
    compile_time, loops = "write and compile C [s]", "loops"
    row["operations per loop / at 10"] = row["operations of a step per loop"] / base["operations of a step per loop"]
    row["compile / at 10, per loop"] = row[compile_time] / row[loops] / (base[compile_time] / base[loops])
    for kernel in KERNELS:
        for k in _STATISTICS:
            name = f"{kernel} step per loop {k} [us]"
            row[f"{kernel} step per loop / at 10, {k}"] = row[name] / base[name]


# Pictures ---------------------------------------------------------------------------------------------------------


def parts_plot(rows: Sequence[Row]) -> Figure:
    """Operations and time of the parts of a step, scene by scene, with the step as one function beside them."""
    figure, axes = plt.subplots(1, 2, figsize=(13, 5), sharey=True, layout="constrained")
    scenes = list(dict.fromkeys(_scene(row) for row in rows if row["mechanism"] != "floor"))
    found = {(_scene(row), row["quantity"]): row for row in rows if row["by"] == "vm"}
    for axis, column, label in (
        (axes[0], "operations", "operations of a step"),
        (axes[1], "median [us]", "time of a step in the virtual machine, median [us]"),
    ):
        left = np.zeros(len(scenes))
        for i, part in enumerate(PARTS):
            values = np.array([float(found[scene, part][column]) for scene in scenes])
            axis.barh(range(len(scenes)), values, left=left, label=part, color=f"C{i}")
            left += values
        whole = [float(found[scene, ALONE][column]) for scene in scenes]
        axis.plot(whole, range(len(scenes)), "k|", ms=18, mew=2, label="the step as one function")
        axis.set_xlabel(label)
        axis.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(scenes)), [_scene_label(scene) for scene in scenes])
    axes[0].invert_yaxis()
    axes[0].legend(fontsize=8, loc="lower right")
    return figure


def scale_plot(rows: Sequence[Row]) -> Figure:
    """Cost of a step, and of getting ready, against the number of loops."""
    figure, axes = plt.subplots(1, 2, figsize=(13, 5), layout="constrained")
    styles = {"natural": "o-", "absolute": "s--"}
    for coordinates in dict.fromkeys(row["coordinates"] for row in rows):
        chosen = [row for row in rows if row["coordinates"] == coordinates]
        loops, style = [row["loops"] for row in chosen], styles[coordinates]
        for i, kernel in enumerate(KERNELS):
            values = [row[f"{kernel} step median [us]"] for row in chosen]
            axes[0].loglog(loops, values, style, color=f"C{i}", label=f"{kernel}, {coordinates}")
            least = [row[f"{kernel} step minimum [us]"] for row in chosen]
            axes[0].fill_between(loops, least, values, color=f"C{i}", alpha=0.15, lw=0)
        steps = ("derive median [s]", "trace median [s]", "write and compile C [s]")
        for i, name in enumerate(steps):
            label = f"{name.split(' median')[0].split(' [')[0]}, {coordinates}"
            axes[1].loglog(loops, [row[name] for row in chosen], style, color=f"C{i + 2}", label=label)
    x = np.array(sorted({row["loops"] for row in rows}), float)
    top = max(row["vm step median [us]"] for row in rows)
    axes[0].loglog(x, top * x / x[-1], ":", color="0.5", label="proportional to N")
    axes[0].set_ylabel("time of a step, median [us] (shaded: down to the minimum)")
    axes[1].set_ylabel("time to get ready [s]")
    for axis in axes:
        axis.set_xlabel("loops N")
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    return figure


# The report -------------------------------------------------------------------------------------------------------

STEP_TARGETS = (
    ("compiled", "/ solve", 0.4),
    ("vm", "/ solve", 3.5),
    ("compiled", "oracle /", 50),
    ("vm", "oracle /", 50),
)
"""Kernel, ratio, and what it must not exceed (to the solve) or fall short of (from the oracle)."""

LIMITS = """\
- Times hold for the machine above and for what else it did meanwhile; only ratios of what was timed in turns mean
  something elsewhere. Where median and minimum of a row differ much, the machine was busy or its clock changed.
- The yardstick `numpy.linalg.solve` is a call from Python to LAPACK that is mostly overhead at this size. It says how
  many such calls a step is worth, not how far a step is from the best that a processor can do.
- Everything is timed at one regular position. At nearly singular ones a careful step, or several steps by the oracle,
  take the place of the quick one; `dostep.csv` has both, as its motion passes singular positions.
- The oracle iterates until it converges, kernels a fixed number of times; both leave the same errors.
- Parts are timed as functions of their own, which move their arguments in and results out; the step as one function
  does not, and shares subexpressions between parts. So parts come to more than the step; the difference has its row.
- A doStep is timed from Python through fmpy, and the empty slave pays for the same way; a host in another language
  pays less for the way and sees larger ratios.
- With many loops the C of a scene fills several files, which are compiled side by side with -O1 instead of -O2; times
  to compile depend on the number of processors. Each was taken once, with an empty cache.
- Peak memory is that of the process which derives, traces and runs, read from Linux; the compiler's is not in it.
"""


def _scene(row: Row) -> tuple[Cell, ...]:
    return row["mechanism"], row["coordinates"], row["parameters"]


def _scene_label(scene: tuple[Cell, ...]) -> str:
    mechanism, coordinates, parameters = map(str, scene)
    return ", ".join([mechanism, *[coordinates] * (coordinates != "-"), *[parameters] * (parameters == "frozen")])


def paragraph(*lines: str) -> str:
    """Lines filled anew, as numbers change their lengths."""
    return textwrap.fill(" ".join(lines), 118, break_long_words=False, break_on_hyphens=False)


def met(value: float, target: float, at_most: bool) -> str:
    """How a ratio stands to its target."""
    return "met" if (value <= target if at_most else value >= target) else "not met"


def target_rows(rows: Sequence[Row]) -> list[list[Cell]]:
    """Targets of a step of the five-bar beside what was measured."""
    found = {(row["quantity"], row["by"]): row for row in rows if _scene(row) == JUDGED}
    lines = []
    for kernel, ratio, target in STEP_TARGETS:
        for quantity, how in ((STEP, "one call a step"), (IN_MANY, f"{MANY} steps in a call")):
            row, at_most = found[quantity, kernel], ratio == "/ solve"
            values = [row[f"{k} / solve" if at_most else f"oracle / this, {k}"] for k in _STATISTICS]
            name = f"{kernel} step {ratio}" if at_most else f"{ratio} {kernel} step"
            text = f"{'<=' if at_most else '>='} {target:g}"
            lines.append([name, how, text, *values, met(values[0], target, at_most)])
    return lines


def step_chapter(rows: Sequence[Row]) -> list[str]:
    """The report's part on one step."""
    found = {(*_scene(row), row["quantity"], row["by"]): row for row in rows}
    scenes = list(dict.fromkeys(_scene(row) for row in rows if row["mechanism"] != "floor"))

    def value(scene: tuple, quantity: str, by: str, column: str = "median [us]") -> float:
        return float(found[(*scene, quantity, by)][column])

    steps, more, counts, shares = [], [], [], []
    for s in scenes:
        label, solve = _scene_label(s), value(s, SOLVE, "numpy")
        columns = [value(s, quantity, by) for by in KERNELS for quantity in (STEP, IN_MANY)]
        ratios = [value(s, STEP, "oracle") / value(s, STEP, by) for by in KERNELS]
        steps.append([label, solve, *columns, *(x / solve for x in columns), *ratios])
        pairs = [(CAREFUL, by) for by in KERNELS] + [(READ, by) for by in KERNELS]
        more.append(
            [
                label,
                *(x for q, by in pairs for x in (value(s, q, by), value(s, q, by) / value(s, STEP, by))),
                value(s, READ, "oracle") / value(s, READ, "vm"),
                value(s, READ, "oracle") / value(s, READ, "compiled"),
            ]
        )
        listed = (*PARTS, SHARED)
        counts.append([label, *(found[(*s, x, "vm")]["operations"] for x in (*listed, ALONE, CAREFUL, READ))])
        whole = value(s, ALONE, "vm")
        shares.append([label, *(100 * value(s, x, "vm") / whole for x in listed), whole, whole / solve])
    floors = [row for row in rows if row["mechanism"] == "floor"]
    targets = ()
    if JUDGED in scenes:
        columns = ("ratio", "how", "target", "of medians", "of minima", "by medians")
        targets = ("**Targets, five-bar**", markdown(columns, target_rows(rows)))
    quick = min(row["quick steps [%]"] for row in rows if row["quantity"] in (STEP, IN_MANY) and row["by"] in KERNELS)
    heads = [f"{by}, {how} [us]" for by in KERNELS for how in ("single", f"of {MANY}")]
    repeats = rows[0]["repeats"]
    return [
        "## One internal step",
        paragraph(
            f"Each mechanism after {SETTLE:g} s of motion from its defaults; medians of {repeats} repeats in turns. A",
            f"single step is a call of the machine's `advance(1, dt)` from Python, others are made {MANY} in one call.",
            f"Of the steps timed as quick, at least {quick:.4g} % were. All rows, with minima and what each includes:",
            "`step.csv`.",
        ),
        *targets,
        "**A quick step**",
        markdown(
            (
                "scene",
                "solve [us]",
                *heads,
                *(h.replace(" [us]", " / solve") for h in heads),
                "oracle / vm, single",
                "oracle / compiled, single",
            ),
            steps,
        ),
        "**A careful step, and reading the outputs**",
        markdown(
            (
                "scene",
                *(x for q in ("careful", "outputs") for by in KERNELS for x in (f"{q}, {by} [us]", "/ quick step")),
                "outputs: oracle / vm",
                "oracle / compiled",
            ),
            more,
        ),
        "**Operations of a quick step by part; of a careful one; of the outputs**",
        markdown(("scene", *PARTS, SHARED, "quick step", "careful step", "outputs"), counts),
        "**Time of the parts in the virtual machine, % of the step as one function**",
        markdown(("scene", *PARTS, SHARED, "step as one function [us]", "/ solve"), shares),
        "![Parts of a step](parts.png)",
        "**Floors, which are in the numbers above**",
        markdown(
            ("what", "median [us]", "minimum [us]", "median / solve"),
            [[row["quantity"], row["median [us]"], row["minimum [us]"], row["median / solve"]] for row in floors],
        ),
    ]


def dostep_chapter(rows: Sequence[Row]) -> list[str]:
    """The report's part on FMUs."""
    columns = ("slave", "call", "outputs read", "median [us]", "minimum [us]", "median / empty", "minimum / empty")
    lines = []
    for row in rows:
        target = row["target / empty"]
        verdict = (f"<= {target:g}", met(row["median / empty"], target, True)) if target else ("-", "-")
        lines.append([*(row[name] for name in columns), *verdict])
    tiers = ("quick steps", "careful steps", "oracle steps")
    first = rows[0]
    return [
        "## doStep of the five-bar through FMI",
        paragraph(
            f"{first['steps in a repeat']} steps of {DT:g} s through fmpy, from the defaults, which start in a singular",  # noqa: E501
            f"position; batches of {BATCH} steps in turns, {first['repeats']} repeats of the whole motion. `empty` is an",  # noqa: E501
            "FMU of pythonfmu that does nothing, and each ratio is to its same call: with `getReal` it reads its one",
            "output, the others all their real ones. Also in `dostep.csv`.",
        ),
        markdown((*columns, "target", "by medians"), lines),
        "**Internal steps of this motion by tier**",
        markdown(
            ("kernel", *tiers),
            [[row["slave"], *(row[x] for x in tiers)] for row in rows if row["call"] == DO_STEP and tiers[0] in row],
        ),
    ]


def scale_chapter(rows: Sequence[Row]) -> list[str]:
    """The report's part on growth."""
    ready = {
        "n": "n",
        "derive [s]": "derive median [s]",
        "trace [s]": "trace median [s]",
        "peak memory, traced [MB]": "peak memory, derived and traced [MB]",
        "peak memory, all [MB]": "peak memory, compiled and run [MB]",
        "C source [bytes]": "C source [bytes]",
        "C files": "C files",
        "compile [s]": "write and compile C [s]",
        "compile per loop / at 10": "compile / at 10, per loop",
        "library [bytes]": "library [bytes]",
    }
    run = {
        "operations": "operations of a step",
        "operations per loop / at 10": "operations per loop / at 10",
        **{
            f"{kernel} {short}": f"{kernel} {long}"
            for kernel in KERNELS
            for short, long in {
                "[us]": "step median [us]",
                "per loop [us]": "step per loop median [us]",
                "per loop / at 10": "step per loop / at 10, median",
                "the same of minima": "step per loop / at 10, minimum",
                "/ solve": "step / solve, median",
            }.items()
        },
        "vm / compiled": "vm / compiled, median",
    }
    quick = min(float(row[f"{kernel} quick steps [%]"]) for row in rows for kernel in KERNELS)
    first = rows[0]
    builds = first["build repeats"]
    parts_ = [
        "## Growth with the mechanism",
        paragraph(
            "The N-four-bar, each number of loops and coordinate set in a process of its own. Deriving and tracing:",
            f"medians of {builds} process{'es' * (builds > 1)}; compiling: once, with an empty cache, writing the C",
            f"included. Steps of {SCALE_DT:g} s, {SCALE_STEPS} in a call, {first['repeats']} repeats in turns between all",  # noqa: E501
            f"processes; at least {quick:.4g} % of them were quick. All columns: `scale.csv`.",
        ),
    ]
    for title, columns in (("Getting ready", ready), ("A step", run)):
        lines = [[row["coordinates"], row["loops"], *(row.get(name) for name in columns.values())] for row in rows]
        parts_ += [f"**{title}**", markdown(("coordinates", "N", *columns), lines)]
    return [*parts_, "![Cost against the number of loops](scale.png)"]


def report(where: list[tuple[str, str]], step: Sequence[Row], dostep: Sequence[Row], scale: Sequence[Row]) -> str:
    """The report in Markdown."""
    parts_ = [
        "# What alfmu costs",
        markdown(("what", "value"), where),
        paragraph(
            "Every number here is a ratio, or stands beside one. A ratio of medians is of medians of rows that were timed",  # noqa: E501
            "in turns; CSV files have the minima too.",
        ),
        *step_chapter(step),
        *dostep_chapter(dostep),
        *scale_chapter(scale),
        "## Where the comparison stops being fair",
        LIMITS,
    ]
    return "\n\n".join(parts_)


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Measure an internal step by part, a doStep through FMI, and how cost grows with a mechanism. "
        "Writes benchmark.md, step.csv, dostep.csv, scale.csv and two pictures.",
        epilog="needs the extra alfmu[plot] and a C compiler; takes some minutes, and a machine that does nothing "
        "else; overwrites an earlier run in the same folder",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("results/benchmark"), help="folder (default: %(default)s)"
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--quick", action="store_true", help="few repeats, up to 10 loops in one coordinate set: less than a minute"
    )
    size.add_argument("--full", action="store_true", help="up to 1000 loops: many minutes")
    parser.add_argument("--worker", nargs=2, metavar=("COORDINATES", "LOOPS"), help=argparse.SUPPRESS)
    parser.add_argument("--trace", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the results."""
    chosen = parse(arguments)
    if chosen.worker:
        worker(chosen.worker[0], int(chosen.worker[1]), chosen.trace)
        return 0
    folder = chosen.output
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"{folder} cannot hold the results ({error.strerror}); give another with -o", file=sys.stderr)
        return 1
    effort = QUICK if chosen.quick else FULL if chosen.full else USUAL
    command = "python scripts/benchmark.py" + " --quick" * chosen.quick + " --full" * chosen.full
    packages = ("alfmu", "casadi", "numpy", "scipy", "fmpy", "pythonfmu", "matplotlib")
    where, begin = environment(command, packages), time.perf_counter()
    studies = {
        "step": (STEP_COLUMNS, step_study(effort)),
        "dostep": (DOSTEP_COLUMNS, dostep_study(effort)),
        "scale": (SCALE_COLUMNS, scale_study(effort)),
    }
    where.append(("it took", f"{rounded(time.perf_counter() - begin)} s"))
    for name, (columns, rows) in studies.items():
        write_csv(folder / f"{name}.csv", columns, rows)
    step, dostep, scale = (rows for _, rows in studies.values())
    for name, figure in (("parts", parts_plot(step)), ("scale", scale_plot(scale))):
        figure.savefig(folder / f"{name}.png", dpi=120)
        plt.close(figure)
    (folder / "benchmark.md").write_text(report(where, step, dostep, scale), encoding="utf-8")
    print(folder / "benchmark.md")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
