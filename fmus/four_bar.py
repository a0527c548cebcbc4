"""FMU entry of the parallel four-bar linkage: the class that pythonfmu runs, packed by `alfmu export four_bar`."""

from alfmu.fmi.slave import Slave


class FourBar(Slave):
    """The parallel four-bar linkage behind FMI 2.0."""
