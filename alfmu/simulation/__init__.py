"""Runs: their driver (`run`), `Result` and its tables, and the oracle that verifies the kernel.

Other rooms import `oracle`, `result`.
"""

from ..kernel import KERNELS
from ..runtime.pipeline import prepared, with_defaults
from .driver import (
    Progress,
    Unit,
    by_name,
    checked,
    communication_points,
    finer,
    instance,
    names_in,
    run,
    settings_of,
    signals_of,
    table_of,
    values_of,
)
from .result import Result, read_inputs

__all__ = [
    "KERNELS",
    "Progress",
    "Result",
    "Unit",
    "by_name",
    "checked",
    "communication_points",
    "finer",
    "instance",
    "names_in",
    "prepared",
    "read_inputs",
    "run",
    "settings_of",
    "signals_of",
    "table_of",
    "values_of",
    "with_defaults",
]
