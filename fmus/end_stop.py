"""FMU of the slider-crank with an end stop, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("end_stop")


class EndStop(Entry, recipe=recipe):
    """The slider-crank with an end stop behind FMI 2.0."""
