"""The method on NumPy arrays, with loops that stop on convergence: what the kernel is held against."""

from .instance import Instance

__all__ = ["Instance"]
