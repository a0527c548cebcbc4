"""Work of a worker: runs of one job with different values, on reused instances.

A worker gets a job as data and imports neither the tracing of scenes nor CasADi; only FMUs need the library's driver.
"""

from __future__ import annotations

import atexit
import ctypes
import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ..model.errors import AlfmuError, collected
from ..runtime.library import BRAKES, DONE, REFUSED, Run, Scene, Unit
from ..runtime.shipped import installed, lane_flags
from .measures import Measure, measured

Table = NDArray[np.float64]

KEPT = 2
"""Number of runners of different jobs that a worker thread caches."""


class NeedsBrakes(Exception):
    """A case needs the scene that is traced for redundant constraints which would brake the motion."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Data common to all runs of a sweep, which can be sent to another process or machine."""

    name: str
    """Name of the mechanism, or of the model of an FMU."""
    identity: str
    """A digest of the mechanism or FMU."""
    times: Table
    """Communication points (points,) [s]."""
    fixed: tuple[tuple[str, float | str], ...]
    """Values common to all runs, by name."""
    inputs: tuple[str, ...]
    """Inputs that vary over time."""
    table: Table
    """Values (points, inputs) of these inputs."""
    varied: tuple[str, ...]
    outputs: tuple[str, ...]
    """Outputs to read, in the order of the columns of a run."""
    measures: tuple[Measure, ...]
    """Measures of a run to store."""
    series: tuple[str, ...]
    """Outputs to store over time."""
    token: str = field(default_factory=lambda: uuid.uuid4().hex)
    """Identifies this job and its variants in a worker."""

    @property
    def numbers(self) -> int:
        """Number of values stored for a case."""
        return len(self.varied) + len(self.measures) + len(self.times) * len(self.series)


@dataclass(frozen=True)
class Code:
    """Compiled functions of a scene, also those in lanes, with their platform and the flags of their lanes."""

    machine: str
    content: bytes
    flags: list[str]
    lanes: bytes | None


@dataclass(frozen=True, kw_only=True)
class SceneJob(Job):
    """Runs of a scene by alfmu's runtime."""

    scene: bytes
    code: Code | None
    penalty: tuple[float, ...] | None
    """Penalty of each constraint, if they differ."""
    stabilisation: tuple[float, float, int]
    """zeta, omega, and whether steps project; the scene does not contain these."""
    braking: tuple[bytes, Code | None] | None = None
    """The scene traced for redundant constraints that would brake the motion, once a case needs it."""


@dataclass(frozen=True, kw_only=True)
class FmuJob(Job):
    """Runs of an FMU by the library's driver."""

    archive: bytes = field(repr=False)


@dataclass
class Ran:
    """Results of one run."""

    rows: Table
    """Outputs (points, outputs), with fewer rows if it failed."""
    failure: str
    """Reason for an early end; empty if the run reached its end."""
    warning: str


@dataclass
class Part:
    """Stored results of consecutive cases."""

    first: int
    """Number of the first case."""
    values: Table
    """Varied values (cases, varied)."""
    kept: Table
    """Stored numbers (cases, measures); NaN if the run failed."""
    series: Table
    """Outputs over time (cases, points, series); NaN after a run failed."""
    ended: Table
    """Last communication point reached (cases,) [s]; NaN if the start failed."""
    failures: list[str]
    warnings: list[str]
    seconds: float
    """Duration [s]."""

    def __len__(self) -> int:
        return len(self.values)


class Runner(Protocol):
    """Makes runs."""

    def runs(self, values: Table, seconds: float) -> Iterator[list[Ran]]:
        """Make the runs of cases (cases, varied), and yield groups of them that take at most `seconds` [s], or single
        runs that take longer; the next group overwrites their rows."""

    def close(self) -> None: ...


def run_part(job: Job, first: int, values: Table, seconds: float, stop: Callable[[], bool] = bool) -> Part:
    """Run the cases with these values (cases, varied) until a time [s] is over, but at least one.

    `stop` is called between runs and ends them early if true. Raises NeedsBrakes, and errors that prevent the job.
    """
    begun, count = time.perf_counter(), len(values)
    runner, make = runner_of(job), measured(job.times)
    place = {name: i for i, name in enumerate(job.outputs)}
    of = {f: [i for i, m in enumerate(job.measures) if m.function == f] for f in make}
    of = {f: places for f, places in of.items() if places}
    columns = {f: [place[job.measures[i].output] for i in places] for f, places in of.items()}
    over_time = [place[name] for name in job.series]
    kept = np.full((count, len(job.measures)), np.nan)
    series = np.full((count, len(job.times), len(over_time)), np.nan)
    ended = np.full(count, np.nan)
    failures: list[str] = []
    warnings: list[str] = []
    for some in runner.runs(values, seconds):
        for case, ran in enumerate(some, len(failures)):
            if not ran.failure:
                for f, places in of.items():
                    kept[case, places] = make[f](ran.rows[:, columns[f]])
            if over_time:
                series[case, : len(ran.rows)] = ran.rows[:, over_time]
            if len(ran.rows):
                ended[case] = job.times[len(ran.rows) - 1]
        failures += [ran.failure for ran in some]
        warnings += [ran.warning for ran in some]
        if time.perf_counter() - begun > seconds or stop():
            break
    made = len(failures)
    took = time.perf_counter() - begun
    return Part(first, values[:made], kept[:made], series[:made], ended[:made], failures, warnings, took)


_OWN = threading.local()
"""Runners of each thread: an instance belongs to one thread at a time."""


def runner_of(job: Job) -> Runner:
    """Return the runner of a job in this thread, created once."""
    known: dict[Any, Runner] = _OWN.__dict__.setdefault("runners", {})
    key = job.token, *(getattr(job, form, None) is not None for form in ("code", "braking"))
    if key not in known:
        while len(known) >= KEPT:
            known.pop(next(iter(known))).close()
        known[key] = _SceneRunner(job) if isinstance(job, SceneJob) else _FmuRunner(job)  # type: ignore[arg-type]
    return known[key]


# Scenes --------------------------------------------------------------------------------------------------------------


class _SceneRunner:
    """Runs of a scene: each by one call of the runtime, or several side by side if its functions are interpreted."""

    def __init__(self, job: SceneJob):
        self.job = job
        self.table = np.ascontiguousarray(job.table, float)
        self.times = np.ascontiguousarray(job.times, float)
        self.units = [_Seats(job, job.scene, job.code)]
        if job.braking:
            self.units.append(_Seats(job, *job.braking))

    def runs(self, values: Table, seconds: float) -> Iterator[list[Ran]]:
        first, some = 0, 1
        while first < len(values):
            begun = time.perf_counter()
            made = self._some(values[first : first + some])
            took = (time.perf_counter() - begun) / some
            yield made
            first += some
            some = max(1, min(self.units[0].count, int(min(seconds, SHORT) / took)))

    def _some(self, values: Table) -> list[Ran]:
        made: list[Ran | None] = [None] * len(values)
        for seats in self.units:
            left = [k for k, ran in enumerate(made) if ran is None]
            for k, (outcome, ran) in zip(left, seats.run(self, values[left]), strict=True):
                made[k] = ran if outcome != BRAKES else None
        if None in made:
            raise NeedsBrakes
        return cast("list[Ran]", made)

    def close(self) -> None:
        self.units.clear()


SEATS, NUMBERS = 64, 4_000_000
"""Largest number of simultaneous runs, and of numbers in their rows."""

SHORT = 4.0
"""Time [s] of a group of simultaneous runs, if no run is longer: a sweep is not stopped before their end."""


class _Seats:
    """Instances of a scene, reused for successive runs."""

    def __init__(self, job: SceneJob, scene: bytes, code: Code | None):
        self.scene = Scene(scene, installed())
        if code and code.machine == machine():
            _compiled(self.scene, code)
        self.count = max(1, min(SEATS, NUMBERS // (len(job.times) * len(job.outputs) + 1)))
        place = self.scene.references
        self.job = job
        self.inputs = [place[name] for name in job.inputs]
        self.wanted = [place[name] for name in job.outputs]
        c = self.scene.library
        self.address: int | None = c.alfmu_batch_new(self.scene.address, self.count)
        if not self.address:
            raise MemoryError(f"{job.name}: there is not enough memory for {self.count} instances")
        self.members = [c.alfmu_batch_member(self.address, k) for k in range(self.count)]
        self.rows = np.empty((self.count, len(job.times), len(job.outputs)))
        # Runs do not set values that equal those of the scene; a choice is set by its number.
        unit = Unit(self.scene)
        self.choices = [(place[n], x.encode()) for n, x in job.fixed if isinstance(x, str) and unit.get(place[n]) != x]
        fixed = [(place[n], x) for n, x in job.fixed if not isinstance(x, str) and unit.get(place[n]) != x]
        self.fixed = np.array([x for _, x in fixed], float)
        self.set = [r for r, _ in fixed] + [place[name] for name in job.varied] + self.inputs

    def run(self, given: _SceneRunner, values: Table) -> Iterator[tuple[int, Ran]]:
        """Yield the status and the results of each run."""
        c, count = self.scene.library, len(values)
        begin = np.broadcast_to(given.table[0], (count, len(self.inputs)))
        table = np.hstack([np.broadcast_to(self.fixed, (count, len(self.fixed))), values, begin])
        table = np.ascontiguousarray(np.vstack([table, np.zeros((self.count - count, table.shape[1]))]))
        refused = {k: why for k, member in enumerate(self.members[:count]) if (why := self._ready(member))}
        chosen = np.array([k < count and k not in refused for k in range(self.count)], np.uint8)
        outcomes, made = np.full(self.count, REFUSED, np.int32), np.zeros(self.count, ctypes.c_long)
        times, inputs, rows = (x.ctypes.data for x in (given.times, given.table, self.rows))
        run = Run(times, len(given.times), self.inputs, inputs, self.wanted, rows)
        references = (ctypes.c_int * len(self.set))(*self.set)
        where = [x.ctypes.data for x in (table, made, chosen, outcomes)]
        c.alfmu_batch_run(self.address, ctypes.byref(run.asked), references, len(self.set), *where)
        for k, member in enumerate(self.members[:count]):
            failure = "" if outcomes[k] == DONE else c.alfmu_text(member).decode(errors="replace")
            warns = ctypes.c_int.from_address(c.alfmu_warns(member))
            warning = c.alfmu_warning(member).decode(errors="replace") if warns.value else ""
            warns.value = 0
            yield int(outcomes[k]), Ran(self.rows[k, : made[k]], refused.get(k) or failure, warning)

    def _ready(self, member: int) -> str:
        """Reset a member and set the values common to all runs; return the reason of a failure."""
        c = self.scene.library
        c.alfmu_reset(member)
        outcomes = [c.alfmu_stabilise(member, *self.job.stabilisation)]
        outcomes += [c.alfmu_choose(member, reference, value) for reference, value in self.choices]
        if self.job.penalty is not None:
            outcomes.append(c.alfmu_penalize(member, np.array(self.job.penalty).ctypes.data))
        return "" if set(outcomes) == {DONE} else c.alfmu_text(member).decode(errors="replace")

    def __del__(self) -> None:
        if getattr(self, "address", None):
            self.scene.library.alfmu_batch_free(self.address)


def machine() -> str:
    """Return the platform of compiled functions."""
    import platform

    return f"{platform.system()} {platform.machine()}"


def _compiled(scene: Scene, code: Code) -> None:
    """Load compiled functions for a scene; if that fails, it is interpreted, with the same results."""
    from ..model.files import scratch

    lanes = code.lanes if code.flags == lane_flags() else None
    with scratch() as folder, suppress(OSError):
        for in_lanes, content in enumerate((code.content, lanes)):
            if content:
                path = folder / f"kernel{in_lanes}"
                path.write_bytes(content)
                scene.compiled_by(path, bool(in_lanes))


# FMUs ----------------------------------------------------------------------------------------------------------------

_ONE_AT_A_TIME = threading.RLock()
"""Serialises runs of FMUs in a process: fmpy's messages do not name their FMU."""


class _FmuRunner:
    """Runs of an FMU on one instance, which is reset before each run and replaced after a failure."""

    def __init__(self, job: FmuJob):
        from ..model.files import scratch

        self.job = job
        self.files = ExitStack()
        self.path = self.files.enter_context(scratch()) / "unit.fmu"
        self.path.write_bytes(job.archive)
        self.fmu: Any = None
        atexit.register(self.close)

    def runs(self, values: Table, seconds: float) -> Iterator[list[Ran]]:
        for each in values:
            with _ONE_AT_A_TIME, collected() as said:
                rows, failure = self._run(each)
            yield [Ran(rows, failure, "\n".join(text for text in dict.fromkeys(said) if text != failure))]

    def _run(self, values: Table) -> tuple[Table, str]:
        from ..simulation import run

        job = self.job
        inputs = {name: (job.times, job.table[:, i]) for i, name in enumerate(job.inputs)}
        parameters = {**dict(job.fixed), **dict(zip(job.varied, values.tolist(), strict=True))}
        whole, step = float(job.times[-1]), float(job.times[1] - job.times[0])
        failure, result = "", None
        try:
            result = run(self._ready(), whole, step, inputs=inputs, parameters=parameters)
        except AlfmuError as error:
            result, failure = cast(Any, error.result), str(error) or type(error).__name__
            self._drop()
        if result is None:
            return np.empty((0, len(job.outputs))), failure
        return np.column_stack([result[name] for name in job.outputs]), failure

    def _ready(self) -> Any:
        """Return an instance ready to be initialised."""
        from ..fmi.drive import Fmu

        if self.fmu is not None and self.fmu.begun:
            try:
                self.fmu.reset()
            except AlfmuError:
                self._drop()
        if self.fmu is None:
            self.fmu = Fmu(self.path)
        return self.fmu

    def _drop(self) -> None:
        fmu, self.fmu = self.fmu, None
        if fmu is not None:
            fmu.close()

    def close(self) -> None:
        atexit.unregister(self.close)
        self._drop()
        self.files.close()


# Processes -----------------------------------------------------------------------------------------------------------


def begin() -> None:
    """Initialise a worker process: it ignores interrupts, and ends with the process that started it."""
    import multiprocessing
    import signal
    from multiprocessing.connection import wait

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(signal, "SIGTERM"):
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    parent = multiprocessing.parent_process()

    def follow(sentinel: int) -> None:
        wait([sentinel])
        os._exit(1)

    if parent is not None:
        threading.Thread(target=follow, args=(parent.sentinel,), daemon=True).start()


def lost(job: Job, first: int, values: Table, why: str) -> Part:
    """Return a part of cases that crash every process."""
    n, none = len(values), np.full(len(values), np.nan)
    series: Sequence[int] = (n, len(job.times), len(job.series))
    return Part(
        first,
        values,
        np.full((n, len(job.measures)), np.nan),
        np.full(series, np.nan),
        none,
        [why] * n,
        [""] * n,
        0.0,
    )
