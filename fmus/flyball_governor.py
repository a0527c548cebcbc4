"""FMU of the flyball governor, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("flyball_governor")


class FlyballGovernor(Entry, recipe=recipe):
    """The flyball governor behind FMI 2.0."""
