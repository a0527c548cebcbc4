"""What moves a scene: the C library, what builds it, and instances that it drives.

Other rooms import `build`, `compiled`, `instance`, `library`, `pipeline`, `probe`, `shipped`, `sweeps`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .instance import Instance

__all__ = ["Instance"]


def __getattr__(name: str) -> Any:
    """`Instance` when it is first used: `library` alone needs neither NumPy nor CasADi."""
    if name != "Instance":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .instance import Instance

    return Instance
