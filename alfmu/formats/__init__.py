"""Mechanisms from the files of other programs: MJCF, SDF and URDF, with their loops."""

from .imports import Imported, factory, imported

__all__ = ["Imported", "factory", "imported"]
