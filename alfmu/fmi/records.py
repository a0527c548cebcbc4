"""Records of runs inside an FMU, complete enough to repeat them elsewhere.

The layered standard FMI-LS-REF (1.0.0-beta.1) defines their paths and the role of each file; the Modelica Association's
format of experiments (`.exp`) names parameters (SSV), stimuli and reference results (CSV) of each run.
"""

import csv
import hashlib
import io
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from ..equations.evaluation import DENSE
from ..equations.interface import MONITORS
from ..model.errors import AlfmuError, InputError, StepError, collected
from ..model.settings import internal_steps
from ..runtime import Instance
from ..simulation import communication_points, run
from ..simulation.result import Result
from .markup import tree, written
from .parameters import SSV, parameter_set, read_parameter_set

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
"""Folder of the files in an FMU."""

MANIFEST = "fmi-ls-manifest.xml"

EXPERIMENTS = "application/x-ma-hs-experiments"
"""Media type of experiments."""

AGREES = 1e-6
"""Largest difference of a run from reference results of alfmu, over 1 plus the largest value of the variable; sensitive
motions amplify the round-off of another platform."""

_STEPS = 1000
"""Largest number of internal steps of a run; a tenth of it for large scenes."""

_VALUES = 1600
"""Largest number of values stored for a run, unless `_ROWS` has more."""

_ROWS = 3

_UNREPEATABLE = {v.name for v in MONITORS} - {"monitor.energy"}
"""Outputs that depend on round-off or on the steps taken."""

_SEEN, _GENTLE = 0.01, 0.3
"""Wanted change due to moving inputs [1] of the output that changes most, over 1 plus its largest value: large enough
to be visible, small enough to leave the motion similar."""

_TRIES = 12
"""Number of amplitudes of moving inputs to try."""

_BEGIN = 16
"""The first 1/_BEGIN of a run with moving inputs is tried first, to detect wild motions, which take long."""

_HEAVIER = 1.1
"""Factor on masses in the run with moving inputs [1]: always feasible, and visible in the motion."""

_SPACE = "http://fmi-standard.org/fmi-ls-manifest"


@dataclass(frozen=True)
class Record:
    """A recorded run from `start_time` to `stop_time` [s] in communication steps of `step_size` [s].

    It has parameters by name, inputs over time, and results.
    """

    name: str
    start_time: float
    stop_time: float
    step_size: float
    tolerance: float | None = None
    description: str = ""
    parameters: Mapping[str, float | int | bool | str] = field(default_factory=dict)
    stimuli: Result | None = None
    references: Result | None = None


def record_files(equations: Equations) -> dict[str, bytes]:
    """Return the files of the records of a scene, by path in the FMU.

    One is a run from the defaults with constant inputs (the smoke test), one has moving inputs and heavier bodies (the
    validation). A run that ends early is left out.
    """
    e, instance = equations, Instance(equations)
    stop_time, step, every = _span(e, instance)
    kept = [v.name for v in instance.outputs if v.name not in _UNREPEATABLE]
    try:
        still = run(Instance(e), stop_time, step)
    except StepError:
        return {}
    if not kept or not np.isfinite(still.values).all():
        return {}
    files: dict[str, bytes] = {}
    related: list[dict[str, str]] = []
    tolerance = instance.get("solver.relative_tolerance")
    span: dict[str, Any] = {"start_time": 0.0, "stop_time": stop_time, "step_size": step, "tolerance": tolerance}
    about = "from the defaults, with constant inputs"
    runs = [("smoke_test", "smoke-test", Record("defaults", description=about, references=still, **span))]
    if moved := _moving(e, still, kept):
        parameters, inputs, result = moved
        about = "with changing inputs; each row has the inputs of the step that ends there"
        moving = Record(
            "moving_inputs", description=about, parameters=parameters, stimuli=inputs, references=result, **span
        )
        runs.append(("validation", "validation", moving))
    for name, role, record in runs:
        made, each = _files(f"{e.name}_{name}", role, record, kept, every)
        files |= made
        related += each
    files[MANIFEST] = _manifest(related, files)
    return {f"{FOLDER}/{name}": data for name, data in files.items()}


def _span(e: Equations, instance: Instance) -> tuple[float, float, int]:
    """Return stop time and communication step [s] of a short run, and the interval of stored rows."""
    internal = internal_steps(e.interval, instance.get("solver.step_size"))
    most = _STEPS / internal / (10 if e.n > DENSE else 1)
    count = max(1, math.floor(min(e.stop_time / e.interval * (1 + 1e-12), most)))
    columns = len(instance.outputs) - len(_UNREPEATABLE & {v.name for v in instance.outputs})
    every = math.ceil(count / max(_ROWS, _VALUES // max(1, columns)))
    return count // every * every * e.interval, e.interval, every


def _moving(e: Equations, still: Result, kept: list[str]) -> tuple[dict[str, float], Result, Result] | None:
    """Return parameters, inputs and results of a run with moving inputs.

    None if there is no input, or no amplitude with which the run completes and differs from one with constant inputs.
    """
    instance = Instance(e)
    real = [v for v in instance.input_variables if v.type == "Real"]
    if not real:
        return None
    parameters = {
        v.name: value
        for v in instance.parameters
        if v.unit == "kg" and not v.name.startswith(("start.", "solver.")) and v.start
        for value in [_HEAVIER * float(v.start)]
        if v.maximum is None or value <= v.maximum
    }
    best, poor, wild, small, large = None, None, None, 0.0, math.inf
    size = 1.0
    for _ in range(_TRIES):
        inputs = _signals(e, instance, still.time, size)
        table = {name: (inputs.time, inputs[name]) for name in inputs.names}
        try:
            with collected() as warnings:
                begin = _change(e, still, kept, parameters, table, max(1, len(still.time) // _BEGIN))
                change = _change(e, still, kept, parameters, table, -1) if begin <= _GENTLE else math.inf
            wild = inputs if _GENTLE < begin < math.inf else wild
        except AlfmuError:
            change = math.inf
        if math.isfinite(change) and warnings:
            poor, change = inputs, math.inf
        elif math.isfinite(change):
            best = inputs
        if _SEEN <= change <= _GENTLE:
            break
        if change > _GENTLE:
            large = min(large, size)
        else:
            small = max(small, size)
        size = small * 8 if large == math.inf else large / 8 if not small else math.sqrt(small * large)
    chosen = best or poor or wild
    if chosen is None:
        return None
    table = {name: (chosen.time, chosen[name]) for name in chosen.names}
    how: dict[str, Any] = {"inputs": table, "parameters": parameters, "held_rows": True}
    with collected(), suppress(AlfmuError):  # a wild motion may end early
        return parameters, chosen, run(Instance(e), still.time[-1], still.time[1], **how)
    return None


def _change(e: Equations, still: Result, kept: list[str], parameters: Any, inputs: Any, row: int) -> float:
    """Return the change due to moving inputs up to a row, infinite if it is NaN."""
    result = run(Instance(e), still.time[row], still.time[1], inputs=inputs, parameters=parameters)
    changes = [_apart(result[name], still[name]) for name in kept]
    return max(changes) if np.isfinite(changes).all() else math.inf


def _signals(e: Equations, instance: Instance, times: NDArray[np.float64], size: float) -> Result:
    """Return inputs of an amplitude: waves of different periods; inputs that prescribe motion have derivatives."""
    inputs = [v for v in instance.input_variables if v.type == "Real"]
    span, columns = times[-1], {}
    companions = {f.input + 1 + k for f in e.followed for k in range(f.derivatives)}
    for i, v in enumerate(inputs):
        if i in companions:
            continue
        rate = 2 * math.pi * (1 + 0.5 * i) / span
        start, amplitude = float(v.start), float(f"{size * (v.nominal or 1.0):.1e}")
        followed = next((f for f in e.followed if f.input == i), None)
        wave = np.sin(rate * times) ** 2
        if not followed:  # rounding shortens its table to a third
            wave = wave.round(2)
        columns[v.name] = start + amplitude * wave * (1 if i % 2 == 0 else -1)
        low, high = (-math.inf if v.minimum is None else v.minimum), (math.inf if v.maximum is None else v.maximum)
        columns[v.name] = np.clip(columns[v.name], low, high)
        sign = 1 if i % 2 == 0 else -1
        slopes = (
            sign * amplitude * rate * np.sin(2 * rate * times),
            sign * amplitude * 2 * rate**2 * np.cos(2 * rate * times),
        )
        for k in range(followed.derivatives if followed else 0):
            columns[inputs[i + 1 + k].name] = slopes[k]
    values = np.array([[float(f"{x:.9g}") for x in column] for column in columns.values()]).T
    return Result(e.name, times, tuple(columns), {v.name: v.unit for v in inputs}, values)


def _apart(got: NDArray[np.float64], wanted: NDArray[np.float64]) -> float:
    """Return max |got - wanted| / (1 + max |wanted|)."""
    return float(np.abs(got - wanted[: len(got)]).max() / (1 + np.abs(wanted).max()))


# Files ----------------------------------------------------------------------------------------------------------------


def _files(
    name: str, role: str, record: Record, kept: list[str], every: int
) -> tuple[dict[str, bytes], list[dict[str, str]]]:
    """Return the files of a record, and their entries in the manifest."""
    files, related = {}, []

    def add(source: str, data: bytes, kind: str, role: str, text: str) -> None:
        files[source] = data
        related.append({"type": kind, "source": source, "role": role, "description": text})

    root = ET.Element("Experiments", name=name, description=f"alfmu: {record.description}")
    facts = {"name": record.name, "description": record.description}
    if record.tolerance is not None:
        facts["tolerance"] = f"{record.tolerance:.12g}"
    one = ET.SubElement(root, "Experiment", facts)
    times = {"startTime": record.start_time, "stopTime": record.stop_time, "stepSize": record.step_size}
    ET.SubElement(one, "TransientSimulation", {key: f"{value:.12g}" for key, value in times.items()})
    if record.parameters:
        ET.SubElement(one, "Parameters", source=f"{name}.ssv", type=SSV)
        add(f"{name}.ssv", parameter_set(name, record.parameters), SSV, "parameter", "parameters of that run")
    if record.stimuli:
        ET.SubElement(one, "Stimuli", source=f"{name}_in.csv", type="text/csv")
        add(f"{name}_in.csv", _table(record.stimuli, record.stimuli.names, 1), "text/csv", "other", "inputs over time")
    if record.references:
        ET.SubElement(one, "References", source=f"{name}_ref.csv", type="text/csv")
        text = f"outputs over time, {record.description}"
        add(f"{name}_ref.csv", _table(record.references, kept, every), "text/csv", "result", text)
    add(f"{name}.exp", written(root), EXPERIMENTS, f"experiment/{role}", f"a run {record.description}")
    return files, related


def _table(result: Result, names: tuple[str, ...] | list[str], every: int) -> bytes:
    table = io.StringIO(newline="")
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["time", *names])
    rows = np.column_stack([result.time, *(result[each] for each in names)])[::every]
    writer.writerows([f"{x:.12g}" if i == 0 else f"{x:.9g}" for i, x in enumerate(row)] for row in rows)
    return table.getvalue().encode()


def _manifest(related: list[dict[str, str]], files: Mapping[str, bytes]) -> bytes:
    """Return fmi-ls-manifest.xml, with the checksum of each file."""
    ET.register_namespace("fmi-ls", _SPACE)
    facts = {
        "name": "org.fmi-standard.fmi-ls-ref",
        "version": "1.0.0-beta.1",
        "description": "Layered Standard providing information on related files included in an FMU.",
    }
    root = ET.Element("fmiReferences", {f"{{{_SPACE}}}fmi-ls-{key}": value for key, value in facts.items()})
    for each in related:
        digest = hashlib.sha3_256(files[each["source"]]).hexdigest()
        ET.SubElement(root, "Related", {**each, "checksum": digest, "checksumType": "SHA3-256"})
    return written(root)


# Reading --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Related:
    """A file named in the manifest: its path, role and expected checksum."""

    source: str
    role: str
    type: str
    checksum: str
    algorithm: str


def listed(folder: Path) -> list[Related]:
    """Return the files named in the manifest of an unpacked FMU, none without one; raise InputError if it
    is damaged."""
    path = folder / FOLDER / MANIFEST
    if not path.is_file():
        return []
    root = tree(path.read_bytes(), MANIFEST)
    return [
        Related(
            each.get("source", ""),
            each.get("role", ""),
            each.get("type", "application/octet-stream"),
            each.get("checksum", ""),
            each.get("checksumType", "SHA3-256"),
        )
        for each in root.iter("Related")
    ]


def records_in(folder: Path) -> Iterator[Record | InputError]:
    """Yield the runs that the experiments in an unpacked FMU describe, or the error in one.

    Files outside the FMU, and of other forms than SSV and CSV, are not read: such a record is an error.
    """
    try:
        experiments = [each.source for each in listed(folder) if each.role.split("/")[0] == "experiment"]
    except InputError as error:
        yield error
        return
    for source in experiments:
        try:
            path = _inside(folder, folder / FOLDER, source)
            root = tree(path.read_bytes(), source)
        except (InputError, OSError) as error:
            yield error if isinstance(error, InputError) else InputError(f"{source} cannot be read ({error.strerror})")
            continue
        if root.tag != "Experiments":
            yield InputError(f"{source} is a {root.tag}, not Experiments")
        for each in root.iter("Experiment"):
            try:
                yield _record(folder, path, each)
            except InputError as error:
                yield InputError(f"{source}: {error}".replace(f"{folder}/", ""))


def _record(folder: Path, path: Path, element: ET.Element) -> Record:
    """Return one experiment, in the current form or in the older one, with times in the element itself."""
    name = element.get("name", "")
    transient = element.find("TransientSimulation")
    other = [each.tag for each in element if each.tag not in _KNOWN]
    if transient is None and other:
        raise InputError(f"the experiment {name} is a {other[0]}; only a TransientSimulation is run")
    times = {**element.attrib, **(transient.attrib if transient is not None else {})}

    def number(key: str, least: float, default: float | None = None) -> float:
        try:
            value = float(times[key]) if key in times or default is None else default
        except (KeyError, ValueError):
            raise InputError(f"the experiment {name} has no {key} that is a number") from None
        if not least <= value < math.inf:
            raise InputError(f"the experiment {name} has {key} {value:g}")
        return value

    start = number("startTime", -math.inf, 0.0)
    stop, step = number("stopTime", math.nextafter(start, math.inf)), number("stepSize", math.ulp(0.0))
    communication_points(name, stop - start, step)  # raises InputError if there are too many
    given: dict[str, Any] = {}
    for tag, field_name, kind, read in (
        ("Parameters", "parameters", SSV, lambda p: read_parameter_set(p.read_bytes(), p.name)),
        ("Stimuli", "stimuli", "text/csv", Result.from_csv),
        ("References", "references", "text/csv", Result.from_csv),
    ):
        if (part := element.find(tag)) is not None:
            if part.get("type", kind) != kind:
                raise InputError(f"the experiment {name} has {tag} of type {part.get('type')}; only {kind} is read")
            file = _inside(folder, path.parent, part.get("source", ""))
            if not file.is_file():
                raise InputError(f"the experiment {name} names {part.get('source')}, which is missing")
            given[field_name] = read(file)
    tolerance = number("tolerance", math.ulp(0.0)) if "tolerance" in times else None
    return Record(name, start, stop, step, tolerance, element.get("description", ""), **given)


_KNOWN = {"TransientSimulation", "Parameters", "Stimuli", "References", "Annotations"}


def _inside(folder: Path, base: Path, source: str) -> Path:
    """Return the file at an address relative to a folder; raise InputError if it is outside the FMU."""
    address = urlsplit(source)
    path = (base / unquote(address.path)).resolve()
    if address.scheme or address.netloc or not path.is_relative_to(folder.resolve()):
        raise InputError(f"{source!r} is not a file inside the FMU, and is not read")
    return path
