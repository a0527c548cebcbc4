"""The checks by their ids, and the exceptions by which a check reports its result."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from .unit import Session

PASSED, FAILED, NOT_APPLICABLE, UNJUDGED = "passed", "failed", "not applicable", "could not be judged"
RISKY, NOTED = "risk", "note"
"""Results of a check. A violation of the standard fails. A risk is allowed but hides mistakes of importers; a note is
only worth knowing."""


class Ended(Exception):
    """A check has ended with this result; an empty one stands for `Check.fault`."""

    result = ""


class Fault(Ended):
    """The FMU violates the standard."""


class Noted(Ended):
    """The FMU's behaviour is allowed, and worth knowing."""

    result = NOTED


class NotApplicable(Ended):
    """The FMU has no feature to which this check applies."""

    result = NOT_APPLICABLE


class Unjudged(Ended):
    """The check cannot be judged, for the given reason."""

    result = UNJUDGED


@dataclass(frozen=True)
class Finding:
    """Finding of one check: `result` is one of passed, failed, risk, note, not applicable, could not be judged."""

    id: str
    title: str
    section: str
    """Section of the standard."""
    demand: str
    """Requirement of the standard."""
    result: str
    detail: str = ""

    def as_data(self) -> dict[str, str]:
        return asdict(self)


@dataclass(frozen=True)
class Task:
    """Further input of the checks: the records of runs, as plain data, and the tolerance of their results."""

    records: Sequence[Mapping[str, Any]] = ()
    tolerance: float = 1e-6


@dataclass(frozen=True)
class Check:
    """A check: the requirement of the standard, its section by version, and the function that checks it.

    The function returns a description of its observation, and raises Fault, NotApplicable or Unjudged.
    """

    id: str
    title: str
    demand: str
    sections: Mapping[str, str]
    run: Callable[[Session, Task], str | None] | None = field(repr=False)
    after: str | None = "run.default"
    """Check that must pass before this one is meaningful."""
    fault: str = FAILED
    """Result if the FMU fails it: a risk if the standard does not require it of the FMU."""

    def finding(self, version: str, result: str, detail: str = "") -> Finding:
        return Finding(self.id, self.title, self.sections.get(version, ""), self.demand, result, detail)


CHECKS: dict[str, Check] = {}
"""Checks by their ids, in the order in which they run and are reported."""


def check(
    id: str, title: str, demand: str, fmi2: str, fmi3: str, after: str | None = "run.default", fault: str = FAILED
) -> Callable[[Callable[[Session, Task], str | None]], Callable[[Session, Task], str | None]]:
    """Register a function as a check; `fmi2` and `fmi3` are the sections of each version."""

    def registered(function: Callable[[Session, Task], str | None]) -> Callable[[Session, Task], str | None]:
        sections = {"2": f"FMI 2.0.5, {fmi2}", "3": f"FMI 3.0, {fmi3}"}
        CHECKS[id] = Check(id, title, demand, sections, function, after, fault)
        return function

    return registered


def judge(faults: Sequence[str], passed: str = "") -> str:
    """Return `passed`, or raise Fault with the first of the faults."""
    if faults:
        more = f"; and {len(faults) - 3} more" if len(faults) > 3 else ""
        raise Fault("; ".join(faults[:3]) + more)
    return passed
