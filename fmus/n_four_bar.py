"""FMU entry of the N-four-bar: the class that pythonfmu runs, packed by `alfmu export n_four_bar`."""

from alfmu.fmi.slave import Slave


class NFourBar(Slave):
    """The N-four-bar behind FMI 2.0."""
