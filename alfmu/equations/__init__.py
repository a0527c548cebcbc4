"""Equations derived from a declaration, and their evaluation.

Other rooms import `arrays`, `changes`, `derivation`, `evaluation`, `friction`, `interface`, `specialisation`, `types`.
"""

from .types import Equations, Mobility, Row, Switch, Variable

__all__ = ["Equations", "Mobility", "Row", "Switch", "Variable"]
