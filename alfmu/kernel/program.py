"""Former names, for the oracle; to be deleted with its imports of them."""

from ..equations.arrays import ArrayFunction as Call
from ..equations.arrays import Backend
from . import memory
from .memory import GROSS, PACE, TURN, Layout

__all__ = ["GROSS", "PACE", "SETTINGS", "TURN", "Backend", "Call", "Layout"]

SETTINGS = len(memory.SETTINGS)
