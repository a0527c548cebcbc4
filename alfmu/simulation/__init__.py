"""Runs: the one driver of them (`run`), `Result` and its tables, and the oracle that the kernel is held against.

Other rooms import `oracle`, `result`.
"""

from .driver import (
    KERNELS,
    Progress,
    Unit,
    by_name,
    checked,
    communication_points,
    finer,
    instance,
    names_in,
    prepared,
    read_inputs,
    run,
    settings_of,
    signals_of,
    table_of,
    values_of,
    with_defaults,
)
from .result import Result

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
