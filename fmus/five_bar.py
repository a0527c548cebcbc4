"""FMU entry of the five-bar linkage: the class that pythonfmu runs, packed by `alfmu export five_bar`."""

from alfmu.fmi.slave import Slave


class FiveBar(Slave):
    """The five-bar linkage behind FMI 2.0."""
