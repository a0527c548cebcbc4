"""Former name, for `alfmu.oracle`; to be deleted with its imports of it."""

from ..equations.arrays import ArrayFunctions
from .memory import Layout, Memory

__all__ = ["Vm"]


class Vm(ArrayFunctions):
    """`ArrayFunctions`, and where an oracle keeps its numbers."""

    def memory(self, layout: Layout) -> Memory:
        return Memory(layout)
