"""FMU of the particle on a circle, by `alfmu export` or `pythonfmu build`."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe("particle_on_circle")


class ParticleOnCircle(Entry, recipe=recipe):
    """The particle on a circle behind FMI 2.0."""
