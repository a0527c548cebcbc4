"""FMU of the parallel four-bar linkage, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("four_bar")


class FourBar(Entry, recipe=recipe):
    """The parallel four-bar linkage behind FMI 2.0."""
