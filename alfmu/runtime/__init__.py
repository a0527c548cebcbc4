"""What moves a scene: an instance in Python, and the same in C for native FMUs."""

from .instance import Instance

__all__ = ["Instance"]
