"""FMU of the five-bar linkage, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("five_bar")


class FiveBar(Entry, recipe=recipe):
    """The five-bar linkage behind FMI 2.0."""
