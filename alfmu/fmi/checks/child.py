"""The process in which an FMU is checked, so that a crash does not affect the checker.

`python -m alfmu.fmi.checks.child FOLDER` reads `task.json` in that folder and writes one file with a finding for each
check. If the system can fork, each check runs in a copy of this process, so that checks are independent.
"""

import hashlib
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path

from fmpy import read_model_description
from fmpy.model_description import ModelDescription

from . import calls, motion, values
from .registry import (
    CHECKS,
    FAILED,
    NOT_APPLICABLE,
    PASSED,
    UNJUDGED,
    Check,
    Ended,
    Task,
)
from .unit import Broken, Journal, Once, Session

TASK, JOURNAL, CURRENT = "task.json", "journal", "current"
"""Files in the folder: the task, the current call, the current check."""

RECORD = "record."
"""Prefix of ids of records, before the name of the record."""

_MODULES = calls, values, motion
"""Modules with checks."""


def all_checks(records: list[str]) -> dict[str, Check]:
    """Return every check by its id, those of records after `run.default`."""

    def replaying(number: int) -> Callable[[Session, Task], str]:
        return lambda session, task: motion.replayed(session, task, number)

    replayed = {
        f"{RECORD}{name}": Check(
            f"{RECORD}{name}",
            f"The recorded run {name} is reproduced",
            "An experiment in the FMU runs with the files of the FMU alone, and gives its reference results",
            dict.fromkeys("23", "FMI-LS-REF, Role experiment"),
            replaying(number),
        )
        for number, name in enumerate(records)
    }
    order = sorted(CHECKS, key=lambda each: (each != "api.version", each != "run.default"))
    return {each: CHECKS[each] for each in order[:2]} | replayed | {each: CHECKS[each] for each in order[2:]}


def result_file(folder: Path, id: str) -> Path:
    """Return the path of the finding of a check; names of records may be of any length."""
    return folder / f"finding-{hashlib.sha256(id.encode()).hexdigest()}.json"


def main(folder: Path) -> int:
    """Run the remaining checks; return 0 if all have a finding."""
    task = json.loads((folder / TASK).read_text(encoding="utf-8"))
    checks = all_checks([record["name"] for record in task["records"]])
    given = Task(task["records"], task["tolerance"])
    fork = hasattr(os, "fork") and not task["together"]
    # Its validity is a separate check, made before; an invalid description does not prevent the others.
    description = read_model_description(task["fmu"], validate=False)
    for id in task["checks"]:
        if result_file(folder, id).exists():
            continue
        (folder / CURRENT).write_text(id, encoding="utf-8")
        if fork:
            child = os.fork()
            if child == 0:
                _one(folder, checks[id], description, task, given)
                os._exit(0)
            _, status = os.waitpid(child, 0)
            if status or not result_file(folder, id).exists():
                # Exit as the crashed copy did, so that the parent reports its status and current call.
                os._exit(128 + os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status))
        else:
            _one(folder, checks[id], description, task, given)
    return 0


def _one(folder: Path, check: Check, description: ModelDescription, task: dict, given: Task) -> None:
    """Run one check and write its finding."""
    version = description.fmiVersion[:1]
    result, detail, session = UNJUDGED, "", None
    if check.after and (earlier := result_file(folder, check.after)).exists():
        before = json.loads(earlier.read_text(encoding="utf-8"))
        if before["result"] == FAILED:
            detail = f"{check.after} failed"
    if not detail:
        try:
            session = Session(Path(task["folder"]), description, Journal(folder / JOURNAL))
            result, detail = PASSED, (check.run(session, given) if check.run else None) or ""
        except Ended as ended:
            result, detail = ended.result or check.fault, str(ended)
        except Once as reason:
            result, detail = NOT_APPLICABLE, str(reason)
        except Broken as broken:
            result, detail = FAILED, str(broken)
        except AttributeError as error:
            # fmpy resolves all functions of the interface when it loads the library.
            if session is not None:
                raise
            result, detail = FAILED, f"the library lacks a function of FMI ({error})"
        except Exception as error:
            if session is not None:
                raise
            result, detail = FAILED, f"the library cannot be loaded ({error})"
    finding = check.finding(version, result, detail)
    path = result_file(folder, check.id)
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(finding.as_data()), encoding="utf-8")
    partial.replace(path)


if __name__ == "__main__":
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    try:
        sys.exit(main(Path(sys.argv[1])))
    except Exception:
        traceback.print_exc()
        os._exit(70)
