"""How many threads the linear algebra of NumPy takes."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Any

__all__ = ["one_thread"]


def one_thread() -> AbstractContextManager:
    """Matrices of some hundred rows are slower in several threads, by far where others want the processor."""
    if not _CONTROLLER:
        try:
            from threadpoolctl import ThreadpoolController

            _CONTROLLER.append(ThreadpoolController())
        except ImportError:  # in an FMU, whose host has what it has
            return nullcontext()
    return _CONTROLLER[0].limit(limits=1, user_api="blas")


_CONTROLLER: list[Any] = []
"""What holds the threads back, once it is known."""
