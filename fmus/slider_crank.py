"""FMU entry of the slider-crank: the class that pythonfmu runs, packed by `alfmu export slider_crank`."""

from alfmu.fmi.slave import Slave


class SliderCrank(Slave):
    """The slider-crank behind FMI 2.0."""
