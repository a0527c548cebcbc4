"""Fast operators of CasADi's scalar symbols, to which most of the time of tracing went.

CasADi tries numbers first: some 30 us go by until `x * y` finds out that both are symbols, which `SX.binary` knows from
its signature. Results are the same.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
from casadi import SX

__all__ = ["quicken"]

_OPERATORS = {
    **{"add": ca.OP_ADD, "sub": ca.OP_SUB, "mul": ca.OP_MUL, "truediv": ca.OP_DIV},
    **{"lt": ca.OP_LT, "le": ca.OP_LE},
}


def _fast(operation: int, usual: Callable[[SX, Any], Any], swapped: bool) -> Callable[[SX, Any], Any]:
    """Return an operator for symbols and plain numbers, which leaves all other operands to the usual one."""
    binary = SX.binary

    def operator(x: SX, y: Any) -> Any:
        if type(y) is SX or type(y) is float or type(y) is int:
            return binary(operation, y, x) if swapped else binary(operation, x, y)
        return usual(x, y)

    return operator


def quicken() -> None:
    """Let symbols have the fast operators."""
    for name, operation in _OPERATORS.items():
        for full, swapped in ((f"__{name}__", False), (f"__r{name}__", True)):
            if usual := getattr(SX, full, None):
                setattr(SX, full, _fast(operation, usual, swapped))
