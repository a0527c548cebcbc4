"""FMU entry of the slider-crank with an end stop: the class that pythonfmu runs, packed by `alfmu export end_stop`."""

from alfmu.fmi.slave import Slave


class EndStop(Slave):
    """The slider-crank with an end stop behind FMI 2.0."""
