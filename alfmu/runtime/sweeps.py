"""Derivatives of a run, by tangents forward or by adjoints backward: the binding of the library's derivatives.

The run is the same as that of `Instance.run`, to the bit.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..equations.interface import Counters
from ..model.errors import AlfmuError, StepError
from .instance import Instance
from .library import INTERRUPTED, Run

_NO_MEMORY = -2
"""An additional outcome: out of memory."""

TAPE = 32e6
"""Size of a tape in bytes; longer runs are repeated in parts for the adjoints.

Measured on the five-bar over 20 s: a gradient takes 3.8 to 4.6 times a run with 16 MB; with 256 MB the allocation of
memory costs as much as repeating the run.
"""


class Sweeps:
    """A run of an instance that is not yet initialised, with its derivatives.

    `times` (k,) [s] are the communication points, `table` (k, inputs) has the inputs at each, `wanted` names the
    columns to differentiate.
    """

    def __init__(
        self,
        unit: Instance,
        times: NDArray[np.float64],
        inputs: Sequence[str],
        table: NDArray[np.float64],
        wanted: Sequence[str],
        progress: Callable[[int], bool] | None = None,
        directions: int = 0,
    ):
        self.unit = unit
        self._times, self._table = np.ascontiguousarray(times, float), np.ascontiguousarray(table, float)
        self.values: NDArray[np.float64] = np.zeros((len(times), len(wanted)))
        """Values (k, wanted) of the run."""
        self._inputs = len(inputs)
        self._directions = directions
        self._library = unit._scene.library
        places = [[unit._references[name] for name in names] for names in (inputs, wanted)]
        begin, rows, into = (x.ctypes.data for x in (self._times, self._table, self.values))
        self._run = Run(begin, len(times), places[0], rows, places[1], into, progress)
        unit.time = float(times[0])
        unit._unit.run_on(False)
        self._address = self._library.alfmu_gradient_new(unit._unit.address, directions)
        if not self._address:
            raise self._no_memory()

    def __del__(self) -> None:
        if getattr(self, "_address", None):
            self._library.alfmu_gradient_free(self._address)

    def tangents(
        self, seeds: NDArray[np.float64], input_seeds: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Run, and return changes (k, wanted, directions) along directions of parameters (parameters, directions) and
        of inputs at each communication point (k, inputs, directions)."""
        seeds = np.ascontiguousarray(seeds, float)
        given = None if input_seeds is None else np.ascontiguousarray(input_seeds, float)
        found, outcome = np.empty((*self.values.shape, self._directions)), ctypes.c_int()
        self._library.alfmu_tangent_run(
            self._address,
            ctypes.byref(self._run.asked),
            self._directions,
            seeds.ctypes.data,
            None if given is None else given.ctypes.data,
            found.ctypes.data,
            ctypes.byref(outcome),
        )
        self._judge(outcome.value)
        return found

    def record(self, tape: float = TAPE) -> None:
        """Run and record a tape of this size for adjoints."""
        outcome = ctypes.c_int()
        self._library.alfmu_recorded_run(self._address, ctypes.byref(self._run.asked), tape, ctypes.byref(outcome))
        self._judge(outcome.value)

    def adjoints(self, weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the derivatives of the sum of all values times `weights` (k, wanted) by each parameter (parameters,)
        and by each input at each communication point (k, inputs); repeatable after `record`."""
        weights = np.ascontiguousarray(weights, float)
        parameters, inputs = np.zeros(len(self.unit.parameters)), np.zeros((len(self._times), self._inputs))
        self._judge(
            self._library.alfmu_adjoint_run(
                self._address,
                ctypes.byref(self._run.asked),
                weights.ctypes.data,
                parameters.ctypes.data,
                inputs.ctypes.data,
            )
        )
        return parameters, inputs

    @property
    def counters(self) -> Counters:
        """Counters of the run, as in the instance."""
        return self.unit.counters

    def _no_memory(self) -> AlfmuError:
        return StepError(f"{self.unit.name}: there is not enough memory for the derivatives; ask for fewer at once")

    def _judge(self, outcome: int) -> None:
        """Raise the error that ended the run early; issue its warnings."""
        unit = self.unit
        unit._warn()
        if self._run.raised:
            raise self._run.raised.pop()
        if outcome == INTERRUPTED:
            raise KeyboardInterrupt
        if outcome == _NO_MEMORY:
            raise self._no_memory()
        if outcome:
            raise unit._failure(outcome, unit.initialized)
