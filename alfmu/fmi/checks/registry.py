"""The checks by their ids, and how a check says what it found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from .unit import Session

__all__ = [
    "CHECKS",
    "FAILED",
    "NOTED",
    "NOT_APPLICABLE",
    "PASSED",
    "RISKY",
    "UNJUDGED",
    "Check",
    "Fault",
    "Finding",
    "NotApplicable",
    "Noted",
    "Task",
    "Unjudged",
    "check",
    "judge",
]

PASSED, FAILED, NOT_APPLICABLE, UNJUDGED = "passed", "failed", "not applicable", "could not be judged"
RISKY, NOTED = "risk", "note"
"""Results of a check. What the standard forbids fails. A risk is what it does not forbid and what hides mistakes of
importers; a note is worth knowing."""


class Fault(Exception):
    """What the FMU does is not what the standard says."""


class Noted(Exception):
    """What the FMU does is allowed, and worth knowing."""


class NotApplicable(Exception):
    """The FMU has nothing that this check is about."""


class Unjudged(Exception):
    """The check cannot tell, and why."""


@dataclass(frozen=True)
class Finding:
    """What one check found: `result` is one of passed, failed, risk, note, not applicable, could not be judged."""

    id: str
    title: str
    section: str
    """Where the standard says it."""
    demand: str
    """What the standard says."""
    result: str
    detail: str = ""

    def as_data(self) -> dict[str, str]:
        return asdict(self)


@dataclass(frozen=True)
class Task:
    """What the checks are given beside the FMU: the records of runs, as plain data, and how near they have to come."""

    records: Sequence[Mapping[str, Any]] = ()
    tolerance: float = 1e-6


@dataclass(frozen=True)
class Check:
    """A check: what the standard demands, where it says so by version, and the function that finds out.

    The function returns what it saw, and raises Fault, NotApplicable or Unjudged.
    """

    id: str
    title: str
    demand: str
    sections: Mapping[str, str]
    run: Callable[[Session, Task], str | None] | None = field(repr=False)
    after: str | None = "run.default"
    """The check without which this one tells nothing."""
    fault: str = FAILED
    """Result where the FMU does not do it: a risk where the standard does not demand it of the FMU."""

    def finding(self, version: str, result: str, detail: str = "") -> Finding:
        return Finding(self.id, self.title, self.sections.get(version, ""), self.demand, result, detail)


CHECKS: dict[str, Check] = {}
"""By their ids, in the order in which they run and are reported."""


def check(
    id: str, title: str, demand: str, fmi2: str, fmi3: str, after: str | None = "run.default", fault: str = FAILED
) -> Callable[[Callable[[Session, Task], str | None]], Callable[[Session, Task], str | None]]:
    """Register a function as a check; `fmi2` and `fmi3` say where each version has it."""

    def registered(function: Callable[[Session, Task], str | None]) -> Callable[[Session, Task], str | None]:
        sections = {"2": f"FMI 2.0.5, {fmi2}", "3": f"FMI 3.0, {fmi3}"}
        CHECKS[id] = Check(id, title, demand, sections, function, after, fault)
        return function

    return registered


def judge(faults: Sequence[str], passed: str = "") -> str:
    """What was seen, or Fault with the first of the faults."""
    if faults:
        more = f"; and {len(faults) - 3} more" if len(faults) > 3 else ""
        raise Fault("; ".join(faults[:3]) + more)
    return passed
