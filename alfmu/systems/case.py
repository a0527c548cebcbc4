"""One run of a study of coupling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["Case"]


@dataclass(frozen=True, eq=False)
class Case:
    """One run of the system."""

    master: str
    step: float
    """Communication step [s]."""
    error: float
    """Largest difference of a compared output over the largest value of it [1]; infinite where the run failed."""
    errors: Mapping[str, float]
    energy: float
    """Largest energy that coupling has made up to any time [J], by size; NaN where no power bond is known."""
    passed: float
    """Energy that went through the bonds, forth and back [J]."""
    tries: float
    """Steps of the components that were made for one communication step."""
    seconds: float
    why: str = ""
    """Why it failed."""
    time: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    made: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Energy made up to these times [J]."""
