"""A mechanism at its start, before it is traced: what a scene is made for, and where a large one begins."""

from .instance import Instance as Probe

__all__ = ["Probe"]
