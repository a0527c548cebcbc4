"""Former names, for `alfmu.oracle`; to be deleted with its imports of them."""

from ..equations.arrays import ArrayFunction as Call
from ..equations.arrays import Backend
from .memory import GROSS, PACE, TURN, Layout

__all__ = ["GROSS", "PACE", "TURN", "Backend", "Call", "Layout"]
