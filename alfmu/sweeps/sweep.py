"""Plan and run a sweep: `alfmu.sweep`, also for the command line."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..equations import Equations, Variable
from ..equations.interface import BALANCE, CHOICES, PEAK, variables_of
from ..equations.specialisation import specialised
from ..kernel import DEFAULT
from ..model.checks import perhaps_degrees, perhaps_millimetres
from ..model.doubts import tell_of_gravity
from ..model.errors import InputError
from ..model.mechanism import Mechanism
from ..model.words import shown, there_is
from ..runtime import Instance
from ..runtime.batch import processors
from ..runtime.pipeline import derive, library_in_lanes, packed, ready, with_brakes, with_defaults
from ..runtime.shipped import lane_flags
from ..simulation import by_name, communication_points, instance, names_in, signals_of
from ..simulation.result import Signal
from .crew import Crew, Processes, Stop, cluster, make, stopping
from .jobs import Code, FmuJob, Job, SceneJob, machine
from .measures import Measure, inside, matching, measures
from .parts import FORMS, OWN, Folder, Held, Plan, Store, kept, usual_form
from .results import Sweep, show
from .variations import Cases, planned, read_cases, table_of_cases

if TYPE_CHECKING:
    from ..fmi.recipe import Recipe

_LOGGER = logging.getLogger("alfmu")

QUICK = 1.0
"""Time [s] for which this process makes runs before it starts other processes, which takes about as long."""

_DOUBTS = {"rad": perhaps_degrees, "m": perhaps_millimetres}
"""Checks whether a value seems to be in another unit, by the expected unit."""

RETRACED = ("solver.method", "solver.input_order")
"""Variables that change the traced scene."""

Vary = Mapping[str, str | Sequence[float]]


def sweep(
    mechanism: str | Path | Mechanism | Equations | Recipe,
    vary: Vary | None = None,
    samples: int | None = None,
    *,
    folder: str | Path | None = None,
    keep: Sequence[str] | None = None,
    keep_series: Sequence[str] = (),
    sampler: str = "latin",
    seed: int = 1,
    cases: str | Path | Mapping[str, Sequence[float]] | None = None,
    stop_time: float | None = None,
    communication_step: float | None = None,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    freeze: Sequence[str] | None = None,
    kernel: str | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    form: str | None = None,
    progress: Callable[[Iterable[Any]], Iterable[Any]] = iter,
) -> Sweep:
    """Run a mechanism or an FMU many times with different parameters, start values or inputs, on all cores or a
    cluster.

    `mechanism` is a mechanism as for `alfmu.simulate`. `vary` maps names to variations: "0:1:11" is a grid from 0 to 1
    of 11 values ("0.1:10:5:log" by equal factors), "1,2,5" or a sequence of numbers a list, "uniform(0.9,1.1)" a
    distribution (`alfmu.sweeps.variations.DISTRIBUTIONS`), of which `samples` are drawn together by a `sampler`
    ("latin", "sobol", "random") with a `seed`. `cases` is a table, or a CSV file, of explicit cases. Every row of the
    table is run at every point of the grids with every sample. A varied input is constant during a run.

    `keep` selects measures of a run: "max(A.force.*)" (final, min, max, mean, peak, rms of outputs at communication
    points), or "A.force.*" for the first four; by default these four measures of all outputs but multipliers and
    monitors. `keep_series` names outputs to store at each communication point. `stop_time` [s], `communication_step`
    [s], `inputs`, `parameters` and `freeze` are those of `simulate`.

    With a `folder`, finished cases are written there in parts, by `form` "parquet" or "csv"; the same call resumes an
    interrupted sweep and repeats nothing. Runs are made by `workers` processes (None: one for each core; 1: this
    process alone), or by the workers of the Dask cluster at the address `scheduler`. A failed case is a row with its
    reason.

    Raises InputError if the sweep cannot be run, and KeyboardInterrupt, with the finished cases as `sweep`, if the user
    interrupts it.
    """
    samples = samples if samples is None else _whole("samples", samples)
    for each in (keep or (), keep_series):
        names_in(mechanism, "outputs to keep", [each] if isinstance(each, str) else each)
    freeze = freeze if freeze is None else names_in(mechanism, "parameters to freeze", freeze)
    workers = workers if workers is None else _whole("workers", workers)
    seed = _whole("seed", seed)
    vary = by_name(mechanism, "variations", vary)
    table = read_cases(cases) if isinstance(cases, str | Path) else table_of_cases(by_name(mechanism, "cases", cases))
    planned_cases = planned(vary, samples, sampler, seed, table)
    given, signals = by_name(mechanism, "parameters", parameters), by_name(mechanism, "inputs", inputs)
    how = _How(keep, keep_series, stop_time, communication_step, signals, given, planned_cases)
    is_fmu = isinstance(mechanism, str | Path) and str(mechanism).endswith(".fmu")
    if is_fmu and not (freeze is None and kernel is None):
        raise InputError(f"{mechanism}: frozen parameters and the kernel of an FMU are fixed when it is exported")
    job, units, braking = _fmu(Path(str(mechanism)), how) if is_fmu else _scene(mechanism, how, freeze, kernel)
    asked = {
        "vary": {name: text if isinstance(text, str) else f"{np.size(text)} values" for name, text in vary.items()},
        "samples": samples,
        **({"sampler": sampler, "seed": seed} if samples else {}),
        "set": dict(job.fixed),
        "digest of the inputs": hashlib.sha256(repr(job.inputs).encode() + job.table.tobytes()).hexdigest(),
        "digest of the cases": planned_cases.digest(),
        "digest of the scene or FMU": job.identity,
    }
    names = tuple(map(str, job.measures))
    plan = Plan(job.name, len(planned_cases), job.times, job.varied, names, job.series, units, asked)
    if not (workers is None or workers >= 1):
        raise InputError(f"{job.name}: {workers} workers; give 1 or more")
    with ExitStack() as stack:
        store: Store = Held(plan)
        if folder is not None:
            form = form or usual_form()
            _check_form(form)
            store = stack.enter_context(Folder.opened(plan, Path(folder), form))
        stop = stack.enter_context(stopping())
        stop.on_request = partial(
            _LOGGER.warning, "%s: stopping when the present runs are stored; interrupt again to stop at once", job.name
        )
        done = show(progress, plan.cases)
        done(store.finished)
        _made(job, planned_cases, store, workers, scheduler, stop, done, braking)
        done(plan.cases)
        if store.missing():
            ended = KeyboardInterrupt(kept(store))
            ended.sweep = Sweep(store)  # type: ignore[attr-defined]
            raise ended
    return Sweep(store)


def _whole(what: str, given: object) -> int:
    if not isinstance(given, int | np.integer):
        raise InputError(f"{what} is {shown(given)}; give a whole number")
    return int(given)


def _made(
    job: Job,
    cases: Cases,
    store: Store,
    workers: int | None,
    scheduler: str | None,
    stop: Stop,
    done: Callable[[int], None],
    braking: Callable[[], Job],
) -> None:
    """Run the missing cases in this process, in local processes, or on a cluster."""
    count = workers or processors()
    with ExitStack() as stack:
        crew: Crew | None = None
        if scheduler:  # connect first, as the address may be wrong
            crew = cluster(scheduler)
        elif count > 1 or isinstance(job, FmuJob):  # a foreign FMU may crash its process
            crew = Processes(count)
        if crew:
            stack.callback(crew.close)
        if isinstance(job, SceneJob) and store.missing():
            make(job, cases, store, None, stop, done, braking, QUICK)  # avoids starting a process for a short sweep
        if store.missing() and not stop():
            make(job, cases, store, crew, stop, done, braking)


def _check_form(form: str) -> None:
    if form not in FORMS:
        raise InputError(f"there is no format {form!r} of parts; use {' or '.join(FORMS)}")
    if form == "parquet" and usual_form() != "parquet":
        raise InputError("Parquet needs pyarrow; install it with: pip install 'alfmu[sweep]', or use the format csv")


@dataclass(frozen=True)
class _How:
    """Settings common to all runs."""

    keep: Sequence[str] | None
    series: Sequence[str]
    stop_time: float | None
    step: float | None
    inputs: Mapping[str, Signal]
    parameters: Mapping[str, float | str]
    cases: Cases

    def check(self, name: str, known: Mapping[str, Variable], fixed: Mapping[str, Any]) -> None:
        """Raise InputError if a varied name cannot be set in a run."""
        for each in self.cases.names:
            if each in CHOICES or each in RETRACED:
                raise InputError(
                    f"{name}: {each} cannot be varied, as a scene is traced with it; make a sweep for each"
                )
            if each not in known:
                raise InputError(f"{name} has no input or parameter {each!r} to vary; {there_is(each, known)}")
            if each in OWN:
                raise InputError(f"{name}: {each!r} is the name of a column of every sweep; rename the parameter")
            if each in self.inputs or each in fixed:
                raise InputError(f"{name}: {each} is varied and also given a value; leave one out")
        place = 0
        for table in self.cases.tables:
            for column in table.T:
                v = known[self.cases.names[place]]
                wrong = {"Integer": column != np.round(column), "Boolean": (column != 0) & (column != 1)}
                if (found := wrong.get(v.type)) is not None and found.any():
                    what = "a whole number" if v.type == "Integer" else "0 or 1"
                    raise InputError(
                        f"{name}: {v.name} = {column[found][0]:g} is among its variations; it must be {what}"
                    )
                if v.unit in _DOUBTS:
                    _DOUBTS[v.unit](f"{name}: {v.name}", float(column[np.abs(column).argmax()]))
                place += 1

    def over_time(self, name: str, times: Any, known: Iterable[Variable]) -> tuple[tuple[str, ...], Any]:
        """Return inputs that vary over time, and their values (points, inputs) at communication points."""
        switches = {v.name for v in known if v.type == "Boolean"}
        signals = signals_of(name, self.inputs)
        table = np.array([[float(signal(t)) for signal in signals.values()] for t in times], float)
        table = table.reshape(len(times), len(signals))
        for i, each in enumerate(signals):
            if each in switches:  # interpolation between 0 and 1 would switch half-way
                table[:, i] = table[:, i] >= 0.5
        if not np.isfinite(table).all():
            raise InputError(f"{name}: an input is not finite at a communication point")
        return tuple(signals), table

    @property
    def asked(self) -> list[str]:
        """Return the patterns of outputs to keep."""
        asked = [[each] if isinstance(each, str) else each for each in (self.keep or (), self.series)]
        return [inside(each) for some in asked for each in some]

    def read(self, name: str, outputs: Sequence[str]) -> tuple[list[Measure], list[str], tuple[str, ...]]:
        """Return the measures, the outputs stored over time, and all outputs needed for both."""
        found, series = measures(name, self.keep, outputs), matching(name, self.series, outputs)
        return found, series, tuple(dict.fromkeys([*(m.output for m in found), *series]))


def _scene(
    mechanism: Any, how: _How, freeze: Sequence[str] | None, kernel: str | None
) -> tuple[SceneJob, dict[str, str], Callable[[], Job]]:
    """Return the job of a mechanism, units of its variables by name, and variants of the job."""
    given, outputs = dict(how.parameters), None
    if isinstance(mechanism, Equations):
        e = mechanism
    else:
        from ..fmi.recipe import of

        recipe = of(mechanism)
        if recipe.start != "declared":
            raise InputError(
                f"{recipe}: a sweep begins at start values, and a position of rest changes with them; take a "
                "recipe that starts as declared"
            )
        declared = recipe.declared()
        e = derive(declared)
        tell_of_gravity(declared)
        given, outputs = {**recipe.parameters, **given}, recipe.outputs
        freeze, kernel = recipe.freeze if freeze is None else freeze, kernel or recipe.kernel
    if kernel == "oracle":
        raise InputError(f"{e.name}: a sweep is run by alfmu's runtime, not by the oracle; leave --kernel out")
    if twice := set(how.cases.names) & set(given):
        raise InputError(f"{e.name}: {min(twice)} is varied and set as well; leave one out")
    if frozen := set(how.cases.names) & set(freeze or ()) - {"all"}:
        raise InputError(f"{e.name}: {min(frozen)} is varied and frozen as well; leave one out")
    if peaks := [each for each in how.asked if each.endswith(PEAK)]:  # outputs on request only
        outputs = [*(["*"] if outputs is None else outputs), *peaks]
    whole = variables_of(specialised(with_defaults(e, given), outputs, freeze)).causal("output")
    _, _, wanted = how.read(e.name, [v.name for v in whole])
    balance = [v.name for v in whole if v.name in BALANCE]
    own = kernel or DEFAULT
    scene, left = ready(e, given, [*wanted, *balance], freeze, own)
    unit = instance(scene, own)
    for name, value in left.items():
        unit.set(name, value)
    known = {v.name: v for v in (*unit.parameters, *unit.input_variables)}
    how.check(e.name, known, {})
    stop, step = (b if a is None else a for a, b in ((how.stop_time, e.stop_time), (how.step, e.interval)))
    times = communication_points(e.name, stop, step, len(wanted))
    kept_, series, wanted = how.read(e.name, [v.name for v in unit.outputs])
    inputs, table = how.over_time(e.name, times, unit.input_variables)
    for name, value in zip(inputs, table[0], strict=True):
        unit.set(name, value)  # raises for unknown names and bad values
    fixed = [
        (v.name, float(unit.get(v.name))) for v in (*unit.parameters, *unit.input_variables) if v.name not in inputs
    ]
    chosen: list[tuple[str, float | str]] = [*fixed, *unit.choices.items()]
    chosen = [(name, value) for name, value in chosen if name not in how.cases.names]
    file, code = _packed(unit)
    settings = unit._given
    job = SceneJob(
        name=e.name,
        identity=hashlib.sha256(file).hexdigest(),
        times=times,
        fixed=tuple(chosen),
        inputs=inputs,
        table=table,
        varied=how.cases.names,
        outputs=wanted,
        measures=tuple(kept_),
        series=tuple(series),
        scene=file,
        code=code,
        penalty=tuple(np.broadcast_to(settings.penalty, scene.l).tolist()) if np.ndim(settings.penalty) else None,
        stabilisation=(settings.zeta, settings.omega, -1 if settings.projection is None else int(settings.projection)),
    )

    def braking() -> SceneJob:
        other = instance(with_brakes(unit.equations), own)
        return replace(job, braking=_packed(other))

    return job, {v.name: v.unit for v in (*known.values(), *unit.outputs)}, braking


def _packed(unit: Instance) -> tuple[bytes, Code | None]:
    """Return the scene of an instance as a file, and its compiled functions if there are any."""
    e = unit.equations
    if e.library is None:
        return packed(e), None
    lanes = library_in_lanes(e)
    code = Code(machine(), e.library.read_bytes(), lane_flags(), lanes.read_bytes() if lanes else None)
    return packed(e), code


def _fmu(path: Path, how: _How) -> tuple[FmuJob, dict[str, str], Callable[[], Job]]:
    """Return the job of an FMU, and units of its variables by name."""
    from ..fmi.drive import Fmu

    with Fmu(path) as fmu:
        archive = path.read_bytes()
        settable = {v.name: v for v in (*fmu.settable(), *fmu.input_variables)}
        how.check(fmu.name, settable, how.parameters)
        fixed = [(k, x.item() if isinstance(x, np.generic) else x) for k, x in how.parameters.items()]
        for name, value in fixed:
            fmu.set(name, value)
        stop, step = (b if a is None else a for a, b in ((how.stop_time, fmu.stop_time), (how.step, fmu.interval)))
        outputs = [v.name for v in fmu.outputs]
        found, series, wanted = how.read(fmu.name, outputs)
        times = communication_points(fmu.name, stop, step, len(outputs))
        inputs, table = how.over_time(fmu.name, times, fmu.input_variables)
        for name in inputs:
            if name not in {v.name for v in fmu.input_variables}:
                known = there_is(name, [v.name for v in fmu.input_variables])
                raise InputError(f"{fmu.name} has no input {name!r}; {known}")
        job = FmuJob(
            name=fmu.name,
            identity=hashlib.sha256(archive).hexdigest(),
            times=times,
            fixed=tuple(fixed),
            inputs=inputs,
            table=table,
            varied=how.cases.names,
            outputs=wanted,
            measures=tuple(found),
            series=tuple(series),
            archive=archive,
        )
        units = {v.name: v.unit for v in (*settable.values(), *fmu.outputs)}
    return job, units, lambda: job
