"""FMU entry of the flexible four-bar: the class that pythonfmu runs, packed by `alfmu export flexible_four_bar`."""

from alfmu.fmi.slave import Slave


class FlexibleFourBar(Slave):
    """The flexible four-bar behind FMI 2.0."""
