"""Numbers and choices of the method that a user may set: their names, defaults and ranges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .errors import InputError

FORMULATIONS: dict[str, str] = {
    "residual": "augmented Lagrangian (8) in residual form",
    "classic": "augmented Lagrangian (8) as printed",
    "penalty": "full penalty (6)",
    "stiffness": "penalty of stiffness only (5)",
    "baumgarte": "index-1 DAE (9) with Baumgarte's stabilisation",
    "dae": "index-1 DAE (9)",
}
"""Names of the formulations and the equations they stand for."""

METHODS: dict[str, str] = {
    "rk4": "classic Runge-Kutta, steps of solver.step_size",
    "order8": "Verner 8(7), steps of solver.step_size",
    "explicit": "Verner 8(7) or Dormand-Prince 5(4), steps by solver.relative_tolerance",
    "stiff": "Radau IIA of order 9, steps by solver.relative_tolerance",
    "trapezoidal": "index-3 augmented Lagrangian with the trapezoidal rule, steps of solver.step_size",
    "generalized_alpha": "as trapezoidal, with damping of high frequencies",
    "auto": "explicit or stiff, by the eigenvalues at the start; Cash-Karp 5(4) if communication steps are short",
}
"""Names of the methods of integration."""

BRANCHES: dict[str, str] = {
    "continue": "follow the branch smoothly through singular positions",
    "paper": "as in Blajer (2002): the accelerations that (8) gives there, corrected by (10)",
}
"""Ways to pass singular positions."""

FIXED = ("rk4", "order8", "trapezoidal", "generalized_alpha")
"""Methods whose steps have a given length."""

PROJECTED = ("residual", "classic")
"""Formulations that correct the state with (10) after each step; the others do not, as in the literature."""

UNBALANCED = 1e-3
"""Energy error [1], energy minus work over the energy of the motion, above which a run logs a warning."""


@dataclass(frozen=True)
class Settings:
    """Numbers of the method; every default that a user sees comes from here."""

    step_size: float = 0.02
    """Largest internal step [s]."""
    penalty: float | Sequence[float] = 0.0
    """alpha [kg or kg.m2 by row], one for all or one per constraint; 0 (alone) scales it with the masses."""
    tolerance: float = 1e-13
    """Tolerance of multiplier iterations (relative), and of |Phi| and |Phi-dot| after projection [m, rad; per s]."""
    max_iterations: int = 10
    """Largest number of multiplier iterations."""
    formulation: str = "residual"
    """Formulation, one of FORMULATIONS."""
    method: str = "auto"
    """One of METHODS; `auto` means `rk4` for formulations other than `residual` and for `branch` = paper."""
    relative_tolerance: float = 1e-6
    """Relative tolerance of a run, for methods with error control."""
    absolute_tolerance: float = 0.0
    """Absolute tolerance for small values [m, rad; per s]; 0 stands for the value of the relative tolerance."""
    input_order: int = 0
    """Order of the extrapolation of inputs inside a communication step; 0 holds them."""
    branch: str = "continue"
    """How singular positions are passed, one of BRANCHES; "continue" requires `residual` and projection."""
    zeta: float = 1.0
    """Damping of `penalty` and `baumgarte`."""
    omega: float = 10.0
    """Frequency of `penalty` and `baumgarte` [1/s]."""
    projection: bool | None = None
    """Whether to correct the state after each step; None leaves it to the formulation."""

    def checked(self, name: str, rows: int) -> Settings:
        """Return these settings; raise InputError, with the mechanism and the mistake, if one is out of its range."""
        if self.formulation not in list(FORMULATIONS):
            raise InputError(
                f"{name}: solver.formulation is {self.formulation!r}; use one of {', '.join(FORMULATIONS)}"
            )
        if self.branch not in list(BRANCHES):
            raise InputError(f"{name}: solver.branch is {self.branch!r}; use one of {', '.join(BRANCHES)}")
        if self.method not in list(METHODS):
            raise InputError(f"{name}: solver.method is {self.method!r}; use one of {', '.join(METHODS)}")
        if self.method in ("stiff", "trapezoidal", "generalized_alpha") and not self.projects:
            raise InputError(
                f"{name}: solver.method {self.method} takes the augmented Lagrangian; use solver.formulation residual"
            )
        for field, low in (("step_size", 0.0), ("tolerance", 0.0), ("relative_tolerance", 0.0)):
            value = getattr(self, field)
            if not (np.isfinite(value) and value > low):
                raise InputError(f"{name}: solver.{field} is {value}; it must be a finite number above {low:g}")
        if self.max_iterations < 1:
            raise InputError(f"{name}: solver.max_iterations is {self.max_iterations}; it must be at least 1")
        alpha = np.asarray(self.penalty, float)
        if alpha.shape not in ((), (rows,)) or not np.isfinite(alpha).all() or (alpha < 0).any():
            raise InputError(
                f"{name}: solver.penalty is {self.penalty}; it must be one finite number, 0 or above, or one for each "
                f"of the {rows} constraints"
            )
        return self

    @property
    def projects(self) -> bool:
        return self.formulation in PROJECTED if self.projection is None else self.projection

    @property
    def continues(self) -> bool:
        """Whether the branch of the motion is followed through singular positions."""
        return self.formulation == "residual" and self.branch == "continue" and self.projects


def internal_steps(length: float, step_size: float) -> int:
    """Return the smallest number of internal steps in a communication step, allowing for round-off of its length."""
    return max(1, math.ceil(length / step_size * (1 - 1e-12)))
