"""What moves a scene: the C library, what builds it, and instances that it drives."""

from .instance import Instance

__all__ = ["Instance"]
