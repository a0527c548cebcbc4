"""One run of a study of coupling."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Case:
    """One run of the system."""

    master: str
    step: float
    """Communication step [s]."""
    error: float
    """Largest difference of a compared output over its largest value [1]; infinite if the run failed."""
    errors: Mapping[str, float]
    energy: float
    """Largest magnitude of the energy created by coupling up to any time [J]; NaN if no power bond is known."""
    passed: float
    """Energy that passed through the bonds in either direction [J]."""
    tries: float
    """Number of steps of the components per communication step."""
    seconds: float
    why: str = ""
    """Reason of a failure."""
    time: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    made: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    """Energy created by coupling up to these times [J]."""
