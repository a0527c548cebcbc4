"""FMU entry of Bennett's linkage: the class that pythonfmu runs, packed by `alfmu export bennett`."""

from alfmu.fmi.slave import Slave


class Bennett(Slave):
    """Bennett's linkage behind FMI 2.0."""
