"""Validate an FMU: static checks first, then records of runs and calls in a separate process."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from hashlib import new as digest_by
from pathlib import Path
from typing import Any

from fmpy import extract
from fmpy.model_description import ModelDescription
from fmpy.validation import validate_fmu

from ...model.errors import ExportError, InputError
from ...model.files import scratch
from ...model.words import there_is
from ...simulation.result import Result
from ..drive import checked_archive, checked_folder, description_of, missing_library, platforms_of
from ..records import AGREES, FOLDER, Record, listed, records_in
from .child import CURRENT, JOURNAL, TASK, all_checks, result_file
from .registry import FAILED, NOT_APPLICABLE, NOTED, PASSED, RISKY, UNJUDGED, Check, Finding
from .unit import Journal

TIMEOUT = 120.0
"""Time limit of a check [s]: minutes, for FMUs that take a second per step."""

OTHERS_AGREE = 1e-3
"""Largest difference [1] from results of other tools, which seldom state their accuracy."""

_RESULTS = (PASSED, FAILED, RISKY, NOTED, NOT_APPLICABLE, UNJUDGED)

_STARTING = 60.0
"""Time [s] that the process of the checks may take to start, which is no time of its first check."""

_DIED = 70
"""Exit code of the process for an error of the checker itself."""


@dataclass(frozen=True)
class Report:
    """The findings of all checks of an FMU."""

    path: str
    name: str
    fmi: str
    tool: str
    """Generating tool according to the description."""
    findings: tuple[Finding, ...]
    seconds: float

    @property
    def problems(self) -> list[str]:
        """Violations of the standard as sentences, with the section."""
        return [f"{f.id}: {f.detail} ({f.section})" for f in self.findings if f.result == FAILED]

    @property
    def judged(self) -> bool:
        """Whether more of the applicable checks were judged than not."""
        counts = self.counts()
        return counts[UNJUDGED] <= sum(counts[each] for each in (PASSED, FAILED, RISKY, NOTED))

    def counts(self) -> dict[str, int]:
        """Number of checks by result."""
        return {result: sum(f.result == result for f in self.findings) for result in _RESULTS}

    def as_data(self) -> dict[str, Any]:
        """Return the report as data for JSON."""
        facts = {"fmu": self.path, "model": self.name, "fmi": self.fmi, "tool": self.tool}
        return {**facts, "counts": self.counts(), "findings": [f.as_data() for f in self.findings]}


def validate(
    path: str | Path, *, static: bool = False, checks: Sequence[str] | None = None, tolerance: float | None = None
) -> list[str]:
    """Return violations of the FMI standard by an FMU of any tool; an empty list means that none was found.

    Its archive, its description (by fmpy) and its records are checked first. Then its code runs, in a separate process:
    recorded runs must be reproduced within `tolerance` [1] (1e-6 for FMUs of alfmu, 1e-3 for others, over 1 plus the
    largest value), and calls of FMI must follow the standard. **This executes the code of the FMU**, with all rights of
    the user; `static` prevents it. `checks` are ids of checks or patterns such as `state.*`, None for all. Raises
    ExportError if the file is not an FMU that can be opened, InputError if no check matches.
    """
    return examine(path, static=static, checks=checks, tolerance=tolerance).problems


def examine(
    path: str | Path,
    *,
    static: bool = False,
    checks: Sequence[str] | None = None,
    tolerance: float | None = None,
    timeout: float = TIMEOUT,
    progress: Callable[[str], object] = lambda id: None,
    together: bool = False,
) -> Report:
    """Validate an FMU as `validate` does, and return all findings.

    `progress` is called with the id of each check before it runs, and `timeout` [s] limits each check. With `together`
    all checks run in one process, as they do on Windows.
    """
    began = time.monotonic()
    if not (timeout > 0 and (tolerance is None or tolerance > 0)):
        raise InputError("timeout and tolerance are above zero")
    checked_archive(path)
    with scratch() as folder:
        findings, description = _static(path, folder)
        ids = _chosen(checks, [each.name for each in _good(folder)])
        runs = next(each.result for each in findings if each.id == "file.library") == PASSED
        findings = [each for each in findings if checks is None or _matches(each.id, checks)]
        if static:
            pass
        elif not runs:
            known, version = all_checks([each.name for each in _good(folder)]), description.fmiVersion[:1]
            why = "the FMU cannot run here; see file.library"
            findings += [known[id].finding(version, UNJUDGED, why) for id in ids]
        elif ids:
            findings += _dynamic(path, folder, description, ids, tolerance, timeout, progress, together)
    tool = description.generationTool or "an unknown tool"
    seconds = time.monotonic() - began
    return Report(str(path), description.modelName, description.fmiVersion, tool, tuple(findings), seconds)


def known_checks() -> dict[str, Check]:
    """Return every check by its id, static ones first; records of an FMU add checks `record.NAME`."""
    return {**_STATIC, **all_checks([])}


def _matches(id: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(id, pattern) for pattern in patterns)


def _chosen(patterns: Sequence[str] | None, records: list[str]) -> list[str]:
    """Return ids of the selected checks; raise InputError for a pattern without a match."""
    known = list(all_checks(records))
    if patterns is None:
        return known
    for pattern in patterns:
        if not any(fnmatchcase(each, pattern) for each in [*_STATIC, *known]):
            raise InputError(f"there is no check {pattern!r}; {there_is(pattern, [*_STATIC, *known])}")
    wanted = [each for each in known if _matches(each, patterns)]
    after = {all_checks(records)[each].after for each in wanted} - {None}
    return [each for each in known if each in wanted or each in after]


# Files ----------------------------------------------------------------------------------------------------------------


def _of_files(id: str, title: str, demand: str, fmi2: str, fmi3: str) -> Check:
    return Check(id, title, demand, {"2": f"FMI 2.0.5, {fmi2}", "3": f"FMI 3.0, {fmi3}"}, None, None)


_STATIC = {
    each.id: each
    for each in (
        _of_files(
            *("file.description", "The description is valid", "modelDescription.xml follows the schema and its rules"),
            *("2.2 FMI Description Schema", "FMI Description Schema"),
        ),
        _of_files(
            "file.values",
            "Units, types and start values fit together",
            "Start values are within min and max and are items of enumerations; units are defined",
            "2.2.2 Definition of Units; 2.2.3; 2.2.7",
            "Definition of Units, of Types, and of Model Variables",
        ),
        _of_files(
            "file.library",
            "There is a library for this machine",
            "The binaries are in a folder with the name of the platform",
            "2.3 FMU Distribution",
            "Structure of the ZIP File",
        ),
        Check(
            "file.records",
            "The related files agree with the manifest",
            "Each file has the check sum of the manifest, and experiments can be read from the files of the FMU",
            dict.fromkeys("23", "FMI-LS-REF, Layered Standard Manifest File"),
            None,
            None,
        ),
    )
}


def _static(path: str | Path, folder: Path) -> tuple[list[Finding], ModelDescription]:
    """Run the static checks of an unpacked FMU."""
    description = description_of(path, valid=False)
    version = description.fmiVersion[:1]
    try:
        problems = [f"{problem}" for problem in validate_fmu(str(path))]
    except Exception as error:  # fmpy passes on exceptions of any kind
        raise ExportError(f"{path} is not an FMU that can be read ({error})") from None
    extract(str(path), str(folder))
    found = {
        "file.description": (problems, "by the rules of fmpy"),
        "file.values": (_values(description), f"{len(description.modelVariables)} variables"),
        "file.records": _related(folder),
    }
    findings = []
    for id, one in _STATIC.items():
        if id == "file.library":
            findings.append(_library(one, folder, description))
            continue
        faults, said = found[id]
        result = FAILED if faults else NOT_APPLICABLE if said is None else PASSED
        more = f"; and {len(faults) - 5} more" if len(faults) > 5 else ""
        text = "; ".join(" ".join(each.split()) for each in faults[:5]) + more
        findings.append(one.finding(version, result, text or said or "it has none"))
    return findings, description


def _values(description: ModelDescription) -> list[str]:
    """Return inconsistencies of units, types and start values."""
    faults = []
    units = {each.name for each in description.unitDefinitions}
    for v in description.modelVariables:
        simple = v.declaredType
        low, high = (getattr(v, key, None) or getattr(simple, key, None) for key in ("min", "max"))
        # fmpy checks units of variables, but not those of their types.
        unit = None if v.unit else getattr(simple, "unit", None)
        if unit and unit not in units:
            faults.append(f"{v.name} has the unit {unit} by its type, and it is not defined")
        numbers = v.type not in ("String", "Boolean", "Binary", "Clock")
        with suppress(ValueError, TypeError):
            if numbers and low is not None and high is not None and float(low) > float(high):
                faults.append(f"min of {v.name} is {low} and max {high}")
            starts = str(v.start).split() if numbers and v.start is not None else ()
            for start in starts:
                outside = (low is not None and float(start) < float(low)) or (
                    high is not None and float(start) > float(high)
                )
                if outside:
                    faults.append(f"{v.name} starts with {start}, outside its bounds")
            if v.type == "Enumeration" and simple is not None and starts:
                items = {int(item.value) for item in simple.items}
                if int(starts[0]) not in items:
                    faults.append(f"{v.name} starts with {starts[0]}, which is no item of {simple.name}")
    return faults


def _library(check: Check, folder: Path, description: ModelDescription) -> Finding:
    version, simulation = description.fmiVersion[:1], description.coSimulation
    if simulation is None or version not in "23":
        return check.finding(
            version, UNJUDGED, "it is not an FMU for co-simulation of FMI 2 or 3, and only these are run"
        )
    if missing := missing_library(folder, description):
        return check.finding(version, UNJUDGED, f"{missing}, so that its code cannot run")
    return check.finding(version, PASSED, f"it has those of {', '.join(platforms_of(folder))}")


def _related(folder: Path) -> tuple[list[str], str | None]:
    """Return errors in files named by the manifest of FMI-LS-REF, and a note, None without a manifest."""
    try:
        related = listed(folder)
    except InputError as error:
        return [str(error)], ""
    faults = []
    for each in related:
        file = (folder / FOLDER / each.source).resolve()
        if not file.is_relative_to(folder.resolve()) or not file.is_file():
            faults.append(f"{each.source} is named but missing")
        elif each.checksum:
            name = each.algorithm.lower().replace("sha-", "sha").replace("-", "_")
            try:
                found = digest_by(name, file.read_bytes()).hexdigest()
            except ValueError:
                faults.append(f"{each.source} has a check sum of an unknown kind, {each.algorithm}")
                continue
            if found != each.checksum.lower():
                faults.append(f"{each.source} was changed since the manifest was written (check sum)")
    records = list(records_in(folder))
    faults += [str(each) for each in records if isinstance(each, InputError)]
    return faults, f"{len(related)} files, {len(records)} recorded runs" if related else None


def _good(folder: Path) -> list[Record]:
    """Return the valid records, one for each name."""
    found = [each for each in records_in(folder) if isinstance(each, Record)]
    return list({each.name: each for each in found}.values())


# Process --------------------------------------------------------------------------------------------------------------


def _dynamic(
    path: str | Path,
    folder: Path,
    description: ModelDescription,
    ids: list[str],
    tolerance: float | None,
    timeout: float,
    progress: Callable[[str], object],
    together: bool,
) -> list[Finding]:
    """Return the findings of checks that run the FMU."""
    version, records = description.fmiVersion[:1], _good(folder)
    checks = all_checks([each.name for each in records])
    checked_folder(folder, path)
    if tolerance is None:
        tolerance = AGREES if (description.generationTool or "").startswith("alfmu") else OTHERS_AGREE
    with scratch() as box:
        task = {
            "fmu": str(folder),
            "folder": str(folder),
            "checks": ids,
            "records": [_plain(each) for each in records],
            "tolerance": tolerance,
            "together": together,
        }
        (box / TASK).write_text(json.dumps(task), encoding="utf-8")
        while left := [id for id in ids if not result_file(box, id).exists()]:
            result, detail = _watched(box, timeout, progress)
            died = (box / CURRENT).read_text(encoding="utf-8") if (box / CURRENT).exists() else left[0]
            if not result_file(box, died).exists():
                _write(box, checks[died].finding(version, result or checks[died].fault, detail))
        found = [Finding(**json.loads(result_file(box, id).read_text(encoding="utf-8"))) for id in ids]
    if any(v.type == "Clock" for v in description.modelVariables):
        found = [_without_ticks(each) if each.result == FAILED else each for each in found]
    return found


def _without_ticks(finding: Finding) -> Finding:
    """Return a failure of an FMU with clocks as not judged, since the checker sends no clock ticks."""
    why = f"its clocks tick in event mode, which is not used here: {finding.detail}"
    return replace(finding, result=UNJUDGED, detail=why)


def _write(box: Path, finding: Finding) -> None:
    result_file(box, finding.id).write_text(json.dumps(finding.as_data()), encoding="utf-8")


def _watched(box: Path, timeout: float, progress: Callable[[str], object]) -> tuple[str, str]:
    """Run the process until it ends or a check exceeds its time.

    Returns result and reason for the check that was running and has no finding; an empty result stands for
    `Check.fault`.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[3]), *_search()])}
    command = [sys.executable, "-m", f"{__package__}.child", str(box)]
    (box / CURRENT).unlink(missing_ok=True)
    (box / JOURNAL).unlink(missing_ok=True)
    with (box / "output").open("wb") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env=environment, start_new_session=True
        )
        shown, since, late = "", time.monotonic() + _STARTING, False
        try:
            while True:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(0.02)
                current = (box / CURRENT).read_text(encoding="utf-8") if (box / CURRENT).exists() else ""
                if current and current != shown:
                    shown, since = current, time.monotonic()
                    progress(current)
                if process.poll() is not None:
                    break
                if time.monotonic() - since > timeout:
                    late = True
                    break
        finally:
            _end(process)
    call = Journal.read(box / JOURNAL)
    where = f" in {call}" if call else " between calls"
    if late:
        return "", f"it did not return within {timeout:g} s{where}"
    if process.returncode == _DIED:
        said = (box / "output").read_text(encoding="utf-8", errors="replace").strip().splitlines() or [""]
        return UNJUDGED, f"the checker stopped{where}: {said[-1]}"
    result = UNJUDGED if "had ended with Fatal" in call else FAILED
    return result, f"the FMU ended its process{where} ({_how(process.returncode)})"


def _search() -> list[str]:
    return [each for each in os.environ.get("PYTHONPATH", "").split(os.pathsep) if each]


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process started here, and its children."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()


def _how(code: int) -> str:
    """Return how a process ended, as text."""
    number = -code if code < 0 else code - 128
    with suppress(ValueError):
        return signal.Signals(number).name
    return f"exit code {code if code < 2**31 else hex(code)}"


def _plain(record: Record) -> dict[str, Any]:
    """Return a record as data."""

    def table(result: Result | None) -> dict[str, Any] | None:
        if result is None:
            return None
        return {"time": result.time.tolist(), "names": list(result.names), "values": result.values.tolist()}

    return {
        "name": record.name,
        "start_time": record.start_time,
        "stop_time": record.stop_time,
        "step_size": record.step_size,
        "parameters": dict(record.parameters),
        "stimuli": table(record.stimuli),
        "references": table(record.references),
    }
