"""alfmu: closed-loop mechanisms as FMUs for co-simulation.

Blajer's augmented-Lagrangian method with projection, for mechanisms with redundant constraints, singular positions and
massless links. Declare a `Mechanism`, `derive` its equations, `simulate` it, `export` it as an FMU.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "AlfmuError": "errors",
    "AssemblyError": "errors",
    "Body": "mechanism",
    "DeclarationError": "errors",
    "Equations": "equations",
    "Experiment": "mechanism",
    "ExportError": "errors",
    "InputError": "errors",
    "Instance": "runtime",
    "Joint": "mechanism",
    "Marker": "mechanism",
    "Mechanism": "mechanism",
    "Result": "simulation",
    "Settings": "oracle",
    "StepError": "errors",
    "derive": "derivation",
    "export": "fmi.export",
    "load": "registry",
    "mechanisms": "registry",
    "simulate": "simulation",
}
"""Public name -> module; imported when first used."""

__all__ = list(_HOME)

if TYPE_CHECKING:
    from .derivation import derive as derive
    from .equations import Equations as Equations
    from .errors import AlfmuError as AlfmuError
    from .errors import AssemblyError as AssemblyError
    from .errors import DeclarationError as DeclarationError
    from .errors import ExportError as ExportError
    from .errors import InputError as InputError
    from .errors import StepError as StepError
    from .fmi.export import export as export
    from .mechanism import Body as Body
    from .mechanism import Experiment as Experiment
    from .mechanism import Joint as Joint
    from .mechanism import Marker as Marker
    from .mechanism import Mechanism as Mechanism
    from .oracle import Settings as Settings
    from .registry import load as load
    from .registry import mechanisms as mechanisms
    from .runtime import Instance as Instance
    from .simulation import Result as Result
    from .simulation import simulate as simulate


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'alfmu' has no attribute {name!r}")
    return getattr(import_module(f".{_HOME[name]}", __name__), name)
