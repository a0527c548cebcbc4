"""FMU entry of the flyball governor: the class that pythonfmu runs, packed by `alfmu export flyball_governor`."""

from alfmu.fmi.slave import Slave


class FlyballGovernor(Slave):
    """The flyball governor behind FMI 2.0."""
