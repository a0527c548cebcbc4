"""Many instances of one mechanism, which the C library steps side by side in the vector lanes of the processor."""

from __future__ import annotations

import ctypes
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise
from pathlib import Path
from threading import Lock

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..catalogue.registry import load
from ..equations import Equations, Variable
from ..equations.interface import checked, default_settings, not_there, variables_of
from ..kernel import DEFAULT
from ..kernel.form import Traced
from ..kernel.memory import Layout
from ..model.errors import AssemblyError, InputError
from ..model.mechanism import Mechanism
from ..model.words import there_is
from .instance import Instance
from .library import BRAKES, DONE, Scene
from .pipeline import derive, loaded_in_lanes, ready, with_brakes, with_defaults

_LOGGER = logging.getLogger("alfmu")

LEAST = 64
"""Least number of members per thread: with fewer, lanes are often empty."""

Members = ArrayLike | slice | None
"""Members of a batch: a mask (count,) of Booleans, their numbers in any order, a slice, or None for all."""

_Numbers = NDArray[np.float64]
_Mask = NDArray[np.bool_]


class _Part:
    """Consecutive members of a batch, processed by one thread at a time."""

    def __init__(self, scene: Scene, own: slice):
        self.scene, self.own, self.lock = scene, own, Lock()
        self.address: int | None = scene.library.alfmu_batch_new(scene.address, own.stop - own.start)
        if not self.address:
            raise MemoryError(
                f"{scene.name}: there is not enough memory for {own.stop - own.start} members; use a smaller batch"
            )

    def __del__(self) -> None:
        self.scene.library.alfmu_batch_free(self.address)


class Batch:
    """A number of instances of one mechanism with parameters, inputs and states of their own.

    Eight of them at a time are evaluated side by side, with every integrator. Their results are those of an
    `alfmu.Instance`, to the last bit::

        batch = Batch("five_bar", 1000, parameters={"solver.method": "rk4"})
        batch.set("start.link1.angle", np.linspace(1.0, 1.4, 1000))
        batch.initialize()
        batch.step(0.01)
        batch.get("link1.angle")

    `mechanism` is a `Mechanism`, a name, a file, or equations; or an `Instance`, whose scene, parameters and inputs all
    members get, and then `outputs` and `kernel` are those of the instance. `parameters` are common to all members,
    choices such as `solver.method` among them. `outputs` is the argument of `alfmu.simulate`; fewer outputs are faster.
    `threads` share the members, one for each processor by default. `kernel` is one of `alfmu.kernel.KERNELS`, without
    the oracle.
    """

    def __init__(
        self,
        mechanism: str | Path | Mechanism | Equations | Instance,
        count: int,
        parameters: Mapping[str, float | str] | None = None,
        outputs: Sequence[str] | None = None,
        threads: int | None = None,
        kernel: str = DEFAULT,
    ):
        unit = mechanism if isinstance(mechanism, Instance) else None
        if isinstance(mechanism, Instance):
            e: Equations = mechanism.equations
        else:
            e = mechanism if isinstance(mechanism, Equations) else derive(load(mechanism))
        for what, given in (("members", count), ("threads", 1 if threads is None else threads)):
            if isinstance(given, bool) or not isinstance(given, int | np.integer) or not 1 <= given < 2**31:
                raise InputError(f"{e.name}: a batch of {given!r} {what}; give a whole number from 1 to 2147483647")
        if parameters is not None and not isinstance(parameters, Mapping):
            raise InputError(f"{e.name}: the parameters are {parameters!r}; give a dictionary of values by their names")
        if unit and (outputs is not None or kernel != DEFAULT):
            raise InputError(f"{e.name}: a batch of an instance has its outputs and kernel; leave both options out")
        asked = (parameters or {}).get("solver.input_order")
        if unit and asked not in (None, kept := unit.get("solver.input_order")):
            has = f"has its solver.input_order, {kept:g}"
            raise InputError(f"{e.name}: a batch of an instance {has}; set {asked!r} in the instance before")
        if kernel == "oracle":
            raise InputError(f"{e.name}: the oracle has no batches; use the kernel vm or compiled")
        own = dict(parameters or {})
        for name, value in own.items():
            if not isinstance(value, str | int | float | np.number):
                raise InputError(
                    f"{e.name}: {name} is {value!r}, but common to all members; give one number, or set it"
                )
        traced: Traced
        if unit:
            variables = (*unit.parameters, *unit.input_variables)
            values = {v.name: unit.get(v.name) for v in variables if unit.get(v.name) != v.start}
            traced, self._common = unit.equations, {**unit.choices, **values, **own}
        else:
            order = {name: own.pop(name) for name in ("solver.input_order",) if name in own}  # an option of the scene
            traced, self._common = ready(with_defaults(e, order), own, outputs, None, kernel)
        self.name: str = e.name
        self.count: int = count
        wanted = threads or max(1, min(processors(), count // LEAST))
        self._pool = ThreadPoolExecutor(wanted) if wanted > 1 else None
        bounds = np.linspace(0, count, min(wanted, count) + 1).astype(int)
        self._slices = [slice(a, b) for a, b in pairwise(bounds.tolist())]
        self._take(traced)

    def __len__(self) -> int:
        return self.count

    def __repr__(self) -> str:
        return f"Batch({self.name!r}, {self.count})"

    def _take(self, equations: Traced) -> None:
        """Make the members as instances of the scene of these equations, with the common parameters."""
        found = variables_of(equations, default_settings(equations))
        self.equations: Traced = equations
        self._variables = {v.name: v for _, v in found.causalities}
        self._scene: Scene = loaded_in_lanes(equations)
        self._parts = [_Part(self._scene, own) for own in self._slices]
        member = self._scene.library.alfmu_batch_member
        self._members = [member(part.address, k) for part in self._parts for k in range(part.own.stop - part.own.start)]
        self._warns = [ctypes.c_int.from_address(self._scene.library.alfmu_warns(each)) for each in self._members]
        states, behind = (self._scene.library.alfmu_state(each) for each in self._members), 8 * Layout(equations).time
        self._times = [ctypes.c_double.from_address(state + behind) for state in states]
        self._outcomes: NDArray[np.int32] = np.zeros(self.count, np.int32)
        self._ready: _Mask = np.zeros(self.count, bool)
        for member in self._members:
            self._begin(member)

    def _begin(self, member: int) -> None:
        """Set the choices of the scene and the common parameters of a member."""
        library, references = self._scene.library, self._scene.references
        for name, value in self._common.items():
            if name not in references or references[name] >= self._scene.first_output:
                raise InputError(not_there(self.equations, name, list(references)[: self._scene.first_output]))
            if isinstance(value, str):
                outcome = library.alfmu_choose(member, references[name], value.encode())
            else:
                checked(self.name, self._variables[name], value)
                outcome = library.alfmu_set(member, references[name], float(value))
            if outcome != DONE:
                raise InputError(self._text(member))

    def _text(self, member: int) -> str:
        return self._scene.library.alfmu_text(member).decode(errors="replace")

    # Members -----------------------------------------------------------------------------------------------------

    def _chosen(self, members: Members) -> NDArray[np.intp]:
        """Return the indices of members, in the given order."""
        try:
            where = slice(None) if members is None else members if isinstance(members, slice) else np.asarray(members)
            empty = isinstance(where, np.ndarray) and not where.size
            chosen = np.ravel(np.arange(self.count)[[] if empty else where])
        except (IndexError, TypeError, ValueError) as error:
            raise InputError(f"{self.name}: there are no such members in a batch of {self.count}: {error}") from None
        if (twice := np.bincount(chosen, minlength=1) > 1).any():
            raise InputError(f"{self.name}: member {int(np.argmax(twice))} is given more than once; give it once")
        return chosen

    def _mask(self, members: Members) -> _Mask:
        """Return members as a mask (count,)."""
        mask = np.zeros(self.count, bool)
        mask[self._chosen(members)] = True
        return mask

    def _call(self, task: Callable[[int | None, slice], None]) -> None:
        """Run a task for each part, in threads if there are several; an interrupt waits until all have ended."""

        def alone(part: _Part) -> None:
            with part.lock:
                task(part.address, part.own)

        if not self._pool:
            alone(self._parts[0])
            return
        made = [self._pool.submit(alone, part) for part in self._parts]
        try:
            for each in made:
                each.result()
        finally:
            wait(made)

    def _moved(self, what: str, mask: _Mask) -> _Mask:
        """Return the mask of members that failed in the last call; log them and the warnings of the runtime."""
        if told := [k for k, flag in enumerate(self._warns) if flag.value]:
            why = self._scene.library.alfmu_warning(self._members[told[0]]).decode(errors="replace")
            _LOGGER.warning(
                "%s: %d of %d members warn; member %d: %s", *(self.name, len(told), self.count, told[0], why)
            )
        for k in told:
            self._warns[k].value = 0
        failed = mask & (self._outcomes != DONE)
        if failed.any():
            first = int(np.argmax(failed))
            _LOGGER.warning(
                "%s: %d of %d members failed to %s; member %d: %s",
                *(self.name, failed.sum(), mask.sum(), what, first, self._text(self._members[first])),
            )
        return failed

    def message(self, member: int) -> str:
        """Return the reason why the last call failed for a member, or else the message of its start."""
        return self._text(self._members[int(self._chosen([member])[0])])

    # Values ------------------------------------------------------------------------------------------------------

    @property
    def time(self) -> _Numbers:
        """Time of each member (count,) [s]; that of the start can be set before `initialize`."""
        return np.array([time.value for time in self._times])

    @time.setter
    def time(self, value: float) -> None:
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not np.isfinite(value):
            raise InputError(f"{self.name}: the time of the start is {value!r}; give one finite number of seconds")
        if self._ready.any():
            raise InputError(f"{self.name}: the time is fixed once a member is initialised; reset it first")
        for time in self._times:
            time.value = float(value)

    @property
    def initialized(self) -> _Mask:
        """Whether each member has been initialised (count,)."""
        return self._ready.copy()

    @property
    def inputs(self) -> list[str]:
        """Names of the inputs."""
        return [n for n, kind in zip(self._scene.names, self._scene.kinds, strict=True) if kind in ("input", "switch")]

    def variable(self, name: str) -> Variable:
        """Return the variable of this name: its unit, bounds and default; raise InputError if there is none."""
        if not isinstance(name, str) or name not in self._variables:
            raise InputError(f"{self.name} has no variable {name!r}; {there_is(str(name), list(self._variables))}")
        return self._variables[name]

    def set(self, name: str, values: ArrayLike, members: Members = None) -> None:
        """Set an input (any time), or a parameter or start value (before `initialize`), in its unit.

        `values` is one number, or one for each of `members`. Raises InputError, and keeps the old values, if the name
        is unknown or a value is not finite or out of its bounds.
        """
        chosen = self._chosen(members)
        self.set_many([name], self._given(str(name), values, (len(chosen),))[:, None], chosen)

    def _given(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> _Numbers:
        """Return values as numbers of this shape."""
        try:
            return np.broadcast_to(np.asarray(values, float), shape)
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.name}: {name} takes one number, or numbers {shape}: {error}") from None

    def set_many(self, names: Sequence[str], values: ArrayLike, members: Members = None) -> None:
        """Set several variables to `values` (members, names), as `set` does."""
        numbers, references = self._chosen(members), []
        mask = self._mask(numbers)
        given = self._given(", ".join(map(str, names)), values, (len(numbers), len(names)))
        for name, column in zip(names, given.T, strict=True):
            reference = self._reference(name)
            if reference is None or reference >= self._scene.first_output:
                settable = [n for n, r in self._scene.references.items() if self._kept(r)]
                raise InputError(not_there(self.equations, str(name), settable))
            if self._scene.kinds[reference] == "parameter" and (mask & self._ready).any():
                raise InputError(f"{self.name}: {name} is fixed once a member is initialised; reset it first")
            self._check(self._variables[name], column)
            references.append(reference)
        table, chosen, places = np.zeros((self.count, len(names))), mask.view(np.uint8), (ctypes.c_int * len(names))
        table[numbers] = given
        columns = places(*references)

        def task(part: int | None, own: slice) -> None:
            where = [x[own].ctypes.data for x in (table, chosen, self._outcomes)]
            self._scene.library.alfmu_batch_set(part, columns, len(names), *where)

        self._call(task)
        if (refused := mask & (self._outcomes != DONE)).any():
            raise InputError(self._text(self._members[int(np.argmax(refused))]))

    def _reference(self, name: str) -> int | None:
        """Return the value reference of a numeric variable; None if there is no variable of this name."""
        reference = self._scene.references.get(name) if isinstance(name, str) else None
        return None if reference is None or self._scene.types[reference] == "String" else reference

    def _check(self, v: Variable, values: _Numbers) -> None:
        """Raise InputError if a variable cannot have one of these values."""
        if v.type == "Boolean":
            if (wrong := (values != 0) & (values != 1)).any():
                raise InputError(f"{self.name}: {v.name} is {values[wrong][0]:g}; it must be true or false")
            return
        ends = v.type == "Real" and values.size > 0 and np.isfinite(values).all()
        for value in {values.min(), values.max()} if ends else values:
            checked(self.name, v, float(value))

    def get(self, *names: str) -> _Numbers:
        """Return variables as (count, names), or (count,) for one; NaN for members without outputs."""
        references = []
        for name in names:
            if (reference := self._reference(name)) is None:
                numbers = [n for n in self._scene.references if self._reference(n) is not None]
                raise InputError(f"{self.name} has no number {name!r}; {there_is(str(name), numbers)}")
            references.append(reference)
        values, columns = np.empty((self.count, len(names))), (ctypes.c_int * len(names))(*references)
        chosen, outcomes = self._ready.view(np.uint8), np.zeros(self.count, np.int32)
        reads = np.array(references) >= self._scene.first_output
        if not reads.any():
            chosen = np.ones(self.count, np.uint8)

        def task(part: int | None, own: slice) -> None:
            where = [x[own].ctypes.data for x in (values, chosen, outcomes)]
            self._scene.library.alfmu_batch_get(part, columns, len(names), *where)

        self._call(task)
        if reads.any():
            values[np.ix_(~self._ready | (outcomes != DONE), reads)] = np.nan
            if not reads.all():  # parameters and inputs have values before initialisation
                others = [name for name, read in zip(names, reads, strict=True) if not read]
                values[:, ~reads] = self.get(*others).reshape(self.count, -1)
        return values[:, 0] if len(names) == 1 else values

    # Motion ------------------------------------------------------------------------------------------------------

    def initialize(self, members: Members = None) -> _Mask:
        """Assemble members from their start values; return the mask of failed members (count,), with a warning."""
        mask = self._mask(members)

        def task(part: int | None, own: slice) -> None:
            where = [x[own].ctypes.data for x in (mask.view(np.uint8), self._outcomes)]
            self._scene.library.alfmu_batch_initialize(part, *where)

        self._call(task)
        if (mask & (self._outcomes == BRAKES)).any():
            self._ready[mask] = self._outcomes[mask] == DONE
            self._brake(mask)
            self._call(task)
        failed = self._moved("start", mask)
        self._ready[mask] = ~failed[mask]
        return failed

    def _brake(self, mask: _Mask) -> None:
        """Create the members again for a scene in which redundant constraints brake the motion."""
        if (self._ready & ~mask).any():
            raise AssemblyError(
                f"{self.name}: redundant constraints would brake the motion of a member, and the scene of the others "
                "is not traced for this; initialise all members at once"
            )
        names = [name for name, r in self._scene.references.items() if self._kept(r)]
        self._ready[:] = False
        values, times = self.get(*names), self.time
        self._take(with_brakes(self.equations))
        self.set_many(names, values.reshape(self.count, -1))
        for time, old in zip(self._times, times.tolist(), strict=True):
            time.value = old

    def _kept(self, reference: int) -> bool:
        return reference < self._scene.first_output and self._scene.types[reference] != "String"

    def step(self, communication_step: float, members: Members = None) -> _Mask:
        """Make one communication step [s]; return the mask of failed members (count,), with a warning.

        A member that fails keeps the state before the step. Raises InputError if the step is not above zero, or a
        member is not initialised.
        """
        mask, h = self._mask(members), communication_step
        if isinstance(h, bool) or not isinstance(h, int | float | np.number) or not 0 < h < np.inf:
            raise InputError(f"{self.name}: a communication step of {h!r} s; it must be a finite number above zero")
        if (unready := mask & ~self._ready).any():
            raise InputError(f"{self.name}: member {int(np.argmax(unready))} is not initialised; initialise it first")

        def task(part: int | None, own: slice) -> None:
            where = [x[own].ctypes.data for x in (mask.view(np.uint8), self._outcomes)]
            self._scene.library.alfmu_batch_step(part, float(h), *where)

        self._call(task)
        return self._moved("step", mask)

    def reset(self, members: Members = None) -> None:
        """Put members back to time 0 with the common parameters, not initialised."""
        mask = self._mask(members)
        for k in np.flatnonzero(mask):
            self._scene.library.alfmu_reset(self._members[k])
            self._begin(self._members[k])
        self._ready[mask] = False

    def save(self, members: Members = None) -> NDArray[np.uint8]:
        """Return the complete states of members (members, bytes), in the order of `members`."""
        library, chosen = self._scene.library, self._chosen(members)
        states = np.empty((len(chosen), library.alfmu_state_size(self._members[0])), np.uint8)
        for state, k in zip(states, chosen, strict=True):
            library.alfmu_save(self._members[k], state.ctypes.data_as(ctypes.c_char_p))
        return states

    def restore(self, states: NDArray[np.uint8], members: Members = None) -> None:
        """Restore states (members, bytes) that `save` returned for any members.

        Raises InputError for other bytes; all members then keep their states.
        """
        library, chosen = self._scene.library, self._chosen(members)
        given = np.asarray(states)
        if given.dtype != np.uint8 or given.shape[:1] != (len(chosen),):
            raise InputError(
                f"{self.name}: {len(given) if given.ndim else 0} states for {len(chosen)} members; give those of save()"
            )
        before = self.save(chosen)
        for state, k in zip(given, chosen, strict=True):
            content = state.tobytes()
            if library.alfmu_restore(self._members[k], content, len(content)) != DONE:
                why = self._text(self._members[k])
                self.restore(before, chosen)
                raise InputError(why)
            self._ready[k] = bool(library.alfmu_initialized(self._members[k]))


def processors() -> int:
    """The processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
