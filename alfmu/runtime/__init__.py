"""What moves a scene: an instance in Python, and the same in C for native FMUs."""

from .instance import CHOICES, SOLVER_VARIABLES, Instance, choices

__all__ = ["CHOICES", "SOLVER_VARIABLES", "Instance", "choices"]
