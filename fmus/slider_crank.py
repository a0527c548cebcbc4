"""FMU of the slider-crank, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("slider_crank")


class SliderCrank(Entry, recipe=recipe):
    """The slider-crank behind FMI 2.0."""
