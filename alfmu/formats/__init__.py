"""Mechanisms from the files of other programs, and as such files: MJCF, SDF and URDF, with their loops.

Other rooms import `writers`.
"""

from .imports import Imported, factory, imported

__all__ = ["Imported", "factory", "imported"]
