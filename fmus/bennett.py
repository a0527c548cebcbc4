"""FMU of Bennett's linkage, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("bennett")


class Bennett(Entry, recipe=recipe):
    """Bennett's linkage behind FMI 2.0."""
