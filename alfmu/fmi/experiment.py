"""Reference results inside an FMU: a run of the exported scene, with what it takes to repeat it.

The files have the names and the form of the FMI cross-check (`NAME_ref.csv`, `NAME_ref.opt`), and stand where the
layered standard FMI-LS-REF (1.0.0-alpha.1) has a tool look for them, with its manifest.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from ..equations import Equations
from ..equations.evaluation import DENSE
from ..equations.interface import MONITORS
from ..model.errors import InputError, StepError
from ..result import Result
from ..runtime import Instance
from ..simulation import run

__all__ = ["AGREES", "FOLDER", "Experiment", "reference_results", "unlike"]

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
"""Of the files in an FMU."""

AGREES = 1e-6
"""Largest difference of a run from reference results, over 1 and the largest value of the variable: where a motion is
sensitive, another platform's round-off grows."""

_STEPS = 1000
"""Most internal steps of the run; a tenth of them in a large scene."""

_VALUES = 4000
"""Numbers that are kept, or so many as there are in `_ROWS`."""

_ROWS = 3

_UNREPEATABLE = {v.name for v in MONITORS} - {"monitor.energy"}
"""Outputs that say how the steps were made: round-off, or counts."""


@dataclass(frozen=True)
class Experiment:
    """A run from the defaults: to `stop_time` [s] in steps of `step` [s], of which one in `every` is kept."""

    stop_time: float
    step: float
    every: int

    @classmethod
    def of(cls, equations: Equations) -> Experiment:
        """That of a scene: its own, as far as the run stays short."""
        e, instance = equations, Instance(equations)
        internal = math.ceil(e.interval / instance.get("solver.step_size") * (1 - 1e-12))
        most = _STEPS / internal / (10 if e.n > DENSE else 1)
        count = max(1, math.floor(min(e.stop_time / e.interval * (1 + 1e-12), most)))
        every = math.ceil(count / max(_ROWS, _VALUES // max(1, len(_kept(instance)))))
        return cls(count // every * every * e.interval, e.interval, every)

    @classmethod
    def read(cls, folder: Path, name: str) -> tuple[Experiment, Result] | None:
        """The experiment and the results in the folder of an FMU called `name`, None where there are none."""
        settings, table = (folder / FOLDER / f"{name}_ref{suffix}" for suffix in (".opt", ".csv"))
        if not (settings.is_file() and table.is_file()):
            return None
        try:
            lines = settings.read_text(encoding="utf-8").splitlines()
            found = dict(line.split(",", 1) for line in lines if "," in line)
            wanted = ("StopTime", "StepSize", "OutputIntervalLength")
            stop_time, step, interval = (float(found.get(key, 0.0)) for key in wanted)
            results = Result.from_csv(table)
        except ValueError as error:
            raise InputError(f"{settings.name} cannot be read ({error})") from None
        except InputError as error:
            raise InputError(str(error).replace(f"{folder}/", "")) from None
        if not (0 < stop_time < math.inf and 0 < step <= interval < math.inf):
            return None
        return cls(stop_time, step, round(interval / step)), results


def reference_results(equations: Equations) -> dict[str, bytes]:
    """The files, by their places in the FMU; none where the experiment cannot be run to its end."""
    experiment, name = Experiment.of(equations), equations.name
    instance = Instance(equations)
    kept = _kept(instance)
    if not kept:
        return {}
    try:
        result = run(instance, experiment.stop_time, experiment.step)
    except StepError:
        return {}
    table = io.StringIO(newline="")
    rows = np.column_stack([result.time, *(result[each] for each in kept)])[:: experiment.every]
    if not np.isfinite(rows).all():
        return {}
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["time", *kept])
    writer.writerows([f"{x:.9g}" for x in row] for row in rows)
    settings = {
        "StartTime": 0.0,
        "StopTime": experiment.stop_time,
        "StepSize": experiment.step,
        "RelTol": instance.get("solver.relative_tolerance"),
        "OutputIntervalLength": experiment.every * experiment.step,
    }
    files = {
        "fmi-ls-manifest.xml": _manifest(name),
        f"{name}_ref.csv": table.getvalue().encode(),
        f"{name}_ref.opt": "".join(f"{key},{value:.12g}\n" for key, value in settings.items()).encode(),
    }
    return {f"{FOLDER}/{file}": data for file, data in files.items()}


def unlike(reference: Result, experiment: Experiment, result: Result) -> list[str]:
    """How a run of an experiment differs from reference results, in sentences."""
    if len(result.time[:: experiment.every]) != len(reference.time):
        return ["the reference results have other instants than their experiment"]
    found = []
    for name in reference.names:
        wanted, got = reference[name], result[name][:: experiment.every]
        size = np.abs(got - wanted).max() / (1 + np.abs(wanted).max())
        if not size <= AGREES:
            found.append(f"{name} is {size:.1e} (relative) from the reference results; {AGREES:.0e} is expected")
    return found


def _kept(instance: Instance) -> list[str]:
    return [v.name for v in instance.outputs if v.name not in _UNREPEATABLE]


def _manifest(name: str) -> bytes:
    """fmi-ls-manifest.xml."""
    space = "http://fmi-standard.org/fmi-ls-manifest"
    ET.register_namespace("fmi-ls", space)
    facts = {
        "name": "org.fmi-standard.fmi-ls-ref",
        "version": "1.0.0-alpha.1",
        "description": "Layered Standard providing information on related files included in an FMU.",
    }
    root = ET.Element("fmiReferences", {f"{{{space}}}fmi-ls-{key}": value for key, value in facts.items()})
    for source, role, text in (
        (f"{name}_ref.csv", "result", "outputs over time, run with the defaults and no input"),
        (f"{name}_ref.opt", "experiment/smoke-test", "stop time and communication step of that run"),
    ):
        ET.SubElement(root, "Related", type="text/csv", source=source, role=role, description=text)
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"
