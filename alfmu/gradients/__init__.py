"""Derivatives of runs by parameters, start values and inputs; functions of a run; fits of parameters
to measurements."""

from .fitting import Fit, fit
from .functions import Columns, Final, Function, Integral, Maximum, TimeOfMaximum
from .run import Derivatives, Gradient, derivatives, gradient

__all__ = [
    "Columns",
    "Derivatives",
    "Final",
    "Fit",
    "Function",
    "Gradient",
    "Integral",
    "Maximum",
    "TimeOfMaximum",
    "derivatives",
    "fit",
    "gradient",
]
