"""The runtime: the C library, its build and binding, and instances.

Other rooms import `batch`, `build`, `compiled`, `embedding`, `instance`, `library`, `pipeline`, `probe`, `shipped`,
`sweeps`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .instance import Instance

__all__ = ["Instance"]


def __getattr__(name: str) -> Any:
    """Import `Instance` on first use: `library` alone needs neither NumPy nor CasADi."""
    if name != "Instance":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .instance import Instance

    return Instance
