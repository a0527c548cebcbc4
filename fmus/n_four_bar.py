"""FMU of the N-four-bar, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("n_four_bar")


class NFourBar(Entry, recipe=recipe):
    """The N-four-bar behind FMI 2.0."""
