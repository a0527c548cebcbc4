"""A connected system: described, run, exported."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .description import Description, read_toml
from .reading import read
from .run import simulate
from .ssp import VERSIONS
from .writing import write

if TYPE_CHECKING:
    from ..simulation import Progress
    from ..simulation.result import Result, Signal

__all__ = ["System"]


@dataclass(frozen=True, repr=False, eq=False)
class System(Description):
    """Mechanisms, parts and FMUs that are connected.

    `components` has by name a `Mechanism`, a `Recipe`, the name of a mechanism, a Python file, the path of an `.fmu`
    file or a `Component`; `connections` are pairs ("COMPONENT.OUTPUT", "COMPONENT.INPUT") or `Connection`s; `inputs`
    has values of inputs that nothing is connected to. Times are in s; `master` is one of MASTERS. `bonds` are pairs of
    a connection's source that is an effort (force, torque, voltage, pressure) and one that is the flow on the way back,
    between which power passes; None for all that can be told. Raises InputError where that describes no system.
    """

    @classmethod
    def load(cls, path: str | Path) -> System:
        """The system that a TOML file or an SSP describes. An SSP is never trusted, and nothing in it is run here.

        Raises InputError or ExportError where it describes none.
        """
        reader = read if str(path).lower().endswith(".ssp") else read_toml
        return cls(**reader(Path(path)))

    def simulate(
        self,
        stop_time: float | None = None,
        communication_step: float | None = None,
        *,
        inputs: Mapping[str, Signal] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        master: str | None = None,
        held_rows: bool = False,
        progress: Progress = iter,
    ) -> Result:
        """Run it; columns are called COMPONENT.VARIABLE. The arguments are those of `alfmu.simulate`.

        With `held_rows`, outputs that follow inputs at once are those with the inputs of the step that ends there, as
        importers record them. Raises AlfmuError; its `result` has the rows up to then where a run has begun.
        """
        system = self.changed(stop_time=stop_time, communication_step=communication_step, master=master)
        return simulate(system, inputs or {}, parameters or {}, held_rows, progress)

    def export(self, path: str | Path | None = None, *, version: str = VERSIONS[0]) -> Path:
        """Write it as an SSP, `<name>.ssp` by default, and return its path; the same system gives the same bytes.

        Mechanisms and parts become native FMUs. `version` of SSP is 1.0 or 2.0. Raises AlfmuError.
        """
        return write(self, path, version)
