"""alfmu: closed-loop mechanisms as FMUs for co-simulation.

Blajer's augmented-Lagrangian method with projection, for mechanisms with redundant constraints, singular positions and
massless links. Declare a `Mechanism`, `derive` its equations, `simulate` it, `export` it as an FMU.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .model.hooks import hand_in

_HOME = {
    "AlfmuError": "model.errors",
    "AlfmuWarning": "model.errors",
    "AssemblyError": "model.errors",
    "Batch": "runtime.batch",
    "Body": "model.parts",
    "DeclarationError": "model.errors",
    "Derivatives": "gradients",
    "Environment": "sweeps.environment",
    "Equations": "equations",
    "Equilibrium": "analysis.equilibria",
    "Experiment": "model.parts",
    "ExportError": "model.errors",
    "Fit": "gradients",
    "Gradient": "gradients",
    "Imported": "formats",
    "InputError": "model.errors",
    "Instance": "runtime",
    "Joint": "model.parts",
    "Kinematics": "analysis.kinematics",
    "LibraryError": "model.errors",
    "Linearization": "analysis.linearization",
    "Marker": "model.parts",
    "Mechanism": "model.mechanism",
    "Recipe": "fmi.recipe",
    "Result": "simulation",
    "StepError": "model.errors",
    "Sweep": "sweeps.results",
    "System": "systems.system",
    "VectorEnvironment": "sweeps.environment",
    "WriteError": "model.errors",
    "convert": "api",
    "couple": "systems.coupling",
    "derivatives": "gradients",
    "derive": "runtime.pipeline",
    "equilibrium": "analysis.equilibria",
    "export": "api",
    "fit": "gradients",
    "gradient": "gradients",
    "imported": "formats",
    "kinematics": "analysis.kinematics",
    "linearize": "analysis.linearization",
    "load": "api",
    "mechanisms": "api",
    "mobility": "analysis.freedoms",
    "simulate": "api",
    "sweep": "sweeps.sweep",
    "validate": "fmi.checks.validation",
}
"""Public name -> module; imported when first used."""

# Names that need an extra are left out, so that `import *` works without it.
__all__ = [name for name, module in _HOME.items() if module != "sweeps.environment"]

if TYPE_CHECKING:
    from .analysis.equilibria import Equilibrium as Equilibrium
    from .analysis.equilibria import equilibrium as equilibrium
    from .analysis.freedoms import mobility as mobility
    from .analysis.kinematics import Kinematics as Kinematics
    from .analysis.kinematics import kinematics as kinematics
    from .analysis.linearization import Linearization as Linearization
    from .analysis.linearization import linearize as linearize
    from .api import convert as convert
    from .api import export as export
    from .api import load as load
    from .api import mechanisms as mechanisms
    from .api import simulate as simulate
    from .equations import Equations as Equations
    from .fmi.checks.validation import validate as validate
    from .fmi.recipe import Recipe as Recipe
    from .formats import Imported as Imported
    from .formats import imported as imported
    from .gradients import Derivatives as Derivatives
    from .gradients import Fit as Fit
    from .gradients import Gradient as Gradient
    from .gradients import derivatives as derivatives
    from .gradients import fit as fit
    from .gradients import gradient as gradient
    from .model.errors import AlfmuError as AlfmuError
    from .model.errors import AlfmuWarning as AlfmuWarning
    from .model.errors import AssemblyError as AssemblyError
    from .model.errors import DeclarationError as DeclarationError
    from .model.errors import ExportError as ExportError
    from .model.errors import InputError as InputError
    from .model.errors import LibraryError as LibraryError
    from .model.errors import StepError as StepError
    from .model.errors import WriteError as WriteError
    from .model.mechanism import Mechanism as Mechanism
    from .model.parts import Body as Body
    from .model.parts import Experiment as Experiment
    from .model.parts import Joint as Joint
    from .model.parts import Marker as Marker
    from .runtime import Instance as Instance
    from .runtime.batch import Batch as Batch
    from .runtime.pipeline import derive as derive
    from .simulation import Result as Result
    from .sweeps.environment import Environment as Environment
    from .sweeps.environment import VectorEnvironment as VectorEnvironment
    from .sweeps.results import Sweep as Sweep
    from .sweeps.sweep import sweep as sweep
    from .systems.coupling import couple as couple
    from .systems.system import System as System

    __version__: str

hand_in(lambda name: getattr(import_module(".api", __name__), name))

_GONE = {
    "Settings": "settings of the solver are variables: give parameters={'solver.method': 'explicit'} to simulate(), or "
    "set('solver.method', 'explicit') of an Instance; `alfmu info NAME --all` lists them",
}
"""Names that a user may expect here, with their replacement."""


def __dir__() -> list[str]:
    return sorted(__all__)


if not TYPE_CHECKING:  # a checker knows the names above, and no others

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            return import_module("importlib.metadata").version("alfmu")
        if name in _GONE:
            raise AttributeError(f"module 'alfmu' has no attribute {name!r}; {_GONE[name]}")
        if name not in _HOME:
            raise AttributeError(f"module 'alfmu' has no attribute {name!r}")
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
