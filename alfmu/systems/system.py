"""Connected systems: description, run, export."""

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


@dataclass(frozen=True, repr=False, eq=False)
class System(Description):
    """A system of connected mechanisms, parts and FMUs.

    `components` maps names to a `Mechanism`, a `Recipe`, the name of a mechanism, a Python file, the path of an `.fmu`
    file or a `Component`; `connections` are pairs ("COMPONENT.OUTPUT", "COMPONENT.INPUT") or `Connection`s; `inputs`
    has values of unconnected inputs. Times are in s; `master` is one of MASTERS. `bonds` are pairs of sources of
    connections, an effort (force, torque, voltage, pressure) and the flow in the opposite direction, between which
    power passes; None for all bonds that the units determine. Raises InputError if the fields are invalid.
    """

    @classmethod
    def load(cls, path: str | Path) -> System:
        """Load a system from a TOML file or an SSP. An SSP is not trusted, and nothing in it is executed here.

        Raises InputError or ExportError if it is invalid.
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
        """Run the system; columns are named COMPONENT.VARIABLE. The arguments are those of `alfmu.simulate`.

        With `held_rows`, outputs that depend directly on inputs belong to the inputs of the step that ends there, as
        importers record them. Raises AlfmuError; its `result` has the rows so far if a run has begun.
        """
        system = self.changed(stop_time=stop_time, communication_step=communication_step, master=master)
        return simulate(system, inputs or {}, parameters or {}, held_rows, progress)

    def export(self, path: str | Path | None = None, *, version: str = VERSIONS[0]) -> Path:
        """Write an SSP, `<name>.ssp` by default, and return its path; the same system gives the same bytes.

        Mechanisms and parts become native FMUs. `version` of SSP is 1.0 or 2.0. Raises AlfmuError.
        """
        return write(self, path, version)
