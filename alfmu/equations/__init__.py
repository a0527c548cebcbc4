"""Equations derived from a declaration, and their evaluation.

Other rooms import `arrays`, `changes`, `derivation`, `evaluation`, `friction`, `interface`, `reactions`,
`specialisation`, `types`.
"""

from .types import Configuration, Equations, Mobility, Row, Switch, Variable

__all__ = ["Configuration", "Equations", "Mobility", "Row", "Switch", "Variable"]
