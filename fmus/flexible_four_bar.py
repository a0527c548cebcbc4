"""FMU of the flexible four-bar, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("flexible_four_bar")


class FlexibleFourBar(Entry, recipe=recipe):
    """The flexible four-bar behind FMI 2.0."""
