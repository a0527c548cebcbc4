"""FMU entry of the particle on a circle: the class that pythonfmu runs, packed by `alfmu export particle_on_circle`."""

from alfmu.fmi.slave import Slave


class ParticleOnCircle(Slave):
    """The particle on a circle behind FMI 2.0."""
