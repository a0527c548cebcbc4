"""Master algorithms: components of a system stepped together, with inputs held, extrapolated or iterated.

With u the inputs that are connected and y(u) the outputs behind a communication step, u = G y + b at each communication
point. Within the step from t to t + H inputs change linearly, from u(t) to an end value e (where a component cannot
take a rate, their mean is held):

    held           e = u(t), and u(t + H) = G y + b, as in importers of FMUs
    extrapolated   e = u(t) + (u(t) - u(t - H))
    iterated       e = G y(e) + b, by Newton's method with steps that are taken back; its matrix I - G dy/de is kept as
                   long as it brings convergence
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from .. import simulation
from ..equations import Variable
from ..model.errors import AlfmuError, AlfmuWarning, InputError, StepError
from ..model.files import scratch
from ..model.words import there_is
from ..simulation.result import Result, Signal
from .description import Connection, Description
from .ports import Port, conversion
from .reading import unpacked
from .slaves import Slave, opened, outputs_of

Vector = NDArray[np.float64]

AGREES = 1e-9
"""Difference of an input from its output, over the signal's largest value so far [1], up to which they agree."""

STALLS = 1e-6
"""Difference [1] that is accepted once it stops falling, as it is due to the error control of the components."""

SMALL = 1e-6
"""Smallest size of a signal [its unit], so that signals at zero agree."""

MOST = 25
"""Largest number of iterations of a step."""

SLOW = 0.3
"""Reduction of the difference by an iteration, as a factor, above which the matrix is computed again."""

NUDGE = 1e-4
"""Relative change of an input for a difference quotient [1], over the size of the signal; a few digits suffice."""


@dataclass(frozen=True)
class Link:
    """A connection between two ports, with the unit conversion as factor and offset."""

    source: tuple[int, int]
    """Component, and index among its outputs."""
    target: tuple[int, str]
    """Component, and name of its input."""
    factor: float
    offset: float
    smooth: bool
    """Whether both are continuous numbers; others are held constant in each step."""
    given: Connection
    ends: tuple[Port, Port]


def simulate(
    system: Description,
    inputs: Mapping[str, Signal],
    parameters: Mapping[str, float | str],
    held_rows: bool,
    progress: simulation.Progress,
) -> Result:
    """Run a system from its start to its stop time, as `alfmu.System.simulate` does."""
    with Assembly(system, parameters, held_rows) as unit:
        facts = {"mechanism": system.name, "options": {"master": system.master}, "parameters": dict(parameters)}
        span = system.stop_time - system.start_time
        late = {name: _later(signal, system.start_time) for name, signal in inputs.items()}
        try:
            found = simulation.run(unit, span, system.communication_step, late, None, progress, held_rows, facts)
        except AlfmuError as error:
            if (made := cast("Result | None", error.result)) is not None:
                error.result = replace(made, time=made.time + system.start_time)
            raise
        return replace(found, time=found.time + system.start_time)


def _later(signal: Signal, start_time: float) -> Signal:
    """Return a signal as a function of the time since the start."""
    if isinstance(signal, tuple):
        return np.asarray(signal[0], float) - start_time, signal[1]
    return (lambda t: signal(t + start_time)) if callable(signal) else signal


class Assembly:
    """The opened components of a system, run as one unit by `alfmu.simulation.run`; close it, or use `with`.

    Raises InputError for an invalid connection: unknown variables, wrong causality, type or unit, or an algebraic loop
    that the master does not solve.
    """

    def __init__(
        self,
        system: Description,
        parameters: Mapping[str, float | str] | None = None,
        held_rows: bool = False,
        observed: bool = False,
    ):
        self.system, self.name, self._held_rows, self._observed = system, system.name, held_rows, observed
        own: dict[str, dict[str, float | str]] = {}
        sources = {each.target: each.source for each in system.connections}
        for name, value in (parameters or {}).items():
            component, _, variable = name.partition(".")
            if component not in system.components:
                raise InputError(f"{self.name}: {name!r} is of no component; {there_is(component, system.components)}")
            if name in sources:
                raise InputError(f"{self.name}: {name} is connected to {sources[name]}, which gives its value")
            if name in system.inputs:  # explicit inputs override inputs of the system, as for a mechanism
                system = self.system = system.changed(inputs={name: value})
                continue
            own.setdefault(component, {})[variable] = value
        with ExitStack() as stack:
            folder = system.folder
            if system.archive is not None:
                folder = stack.enter_context(scratch())
                unpacked(system, folder)
            self.slaves: list[Slave] = []
            for component in system.components.values():
                slave = opened(component, Path(folder), own.get(component.name, {}))
                stack.callback(slave.close)
                self.slaves.append(slave)
            if system.master == "iterated" and (stuck := [slave.name for slave in self.slaves if not slave.rewinds]):
                raise InputError(
                    f"{self.name}: the FMU of {stuck[0]} cannot save its state, which the master "
                    '"iterated" needs to repeat steps; use "held" or "extrapolated"'
                )
            self._index = {slave.name: i for i, slave in enumerate(self.slaves)}
            self.links = [self._link(each) for each in system.connections]
            self._check_inputs()
            self._depth = self._levels()
            self._stack = stack.pop_all()
        self._offsets = np.cumsum([0] + [len(slave.outputs) for slave in self.slaves])
        self._places = np.array([self._offsets[c] + k for c, k in (each.source for each in self.links)], int)
        self._gain = np.array([each.factor for each in self.links])
        self._shift = np.array([each.offset for each in self.links])
        self._smooth = np.array([each.smooth for each in self.links], bool)
        self._into = [[k for k, each in enumerate(self.links) if each.target[0] == c] for c in range(len(self.slaves))]
        fed = {(each.target[0], each.target[1]) for each in self.links}
        self.outputs = [_prefixed(s.name, p) for s in self.slaves for p in s.outputs]
        free = [(c, p) for c, s in enumerate(self.slaves) for p in s.inputs if (c, p.name) not in fed]
        self._free = {f"{self.slaves[c].name}.{p.name}": (c, p.name) for c, p in free}
        self.input_variables = [_prefixed(self.slaves[c].name, p) for c, p in free]
        self._given: dict[tuple[int, str], float] = {self._free[name]: x for name, x in system.inputs.items()}
        self._begun = False
        self.iterations = self.jacobians = self.steps = 0
        """Numbers of steps, repeated attempts, and computed matrices."""

    def __enter__(self) -> Assembly:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the components."""
        self._stack.close()

    # Checks ----------------------------------------------------------------------------------------------------------

    def _port(self, end: str, kind: str, what: Connection) -> tuple[int, Port]:
        component, _, name = end.partition(".")
        slave = self.slaves[self._index[component]]
        port = slave.ports.get(name)
        there = [p.name for p in slave.ports.values() if p.kind == kind]
        if port is None:
            raise InputError(f"{self.name}, {what}: {component} has no {kind} {name!r}; {there_is(name, there)}")
        if port.kind != kind:
            role = "begins at an output" if kind == "output" else "ends at an input"
            raise InputError(f"{self.name}, {what}: {end} is {_a(port.kind)}, and a connection {role}")
        return self._index[component], port

    def _link(self, given: Connection) -> Link:
        """Return a connection after checks of causality, type and unit."""
        i, source = self._port(given.source, "output", given)
        j, target = self._port(given.target, "input", given)
        whole = ("Integer", "Boolean")
        if source.type != target.type and not (source.type in whole and target.type in whole):
            raise InputError(
                f"{self.name}, {given}: {given.source} is {source.type} and {given.target} {target.type}; connect "
                "variables of one type"
            )
        smooth = source.type == target.type == "Real"
        if not smooth and (given.factor, given.offset, given.convert) != (1.0, 0.0, None):
            raise InputError(f"{self.name}, {given}: it is {source.type}, which takes no factor, offset or conversion")
        factor, offset = self._converted(given, source, target) if smooth else (1.0, 0.0)
        place = [p.name for p in self.slaves[i].outputs].index(source.name)
        factor, offset = given.factor * factor, given.factor * offset + given.offset
        return Link((i, place), (j, target.name), factor, offset, smooth, given, (source, target))

    def _converted(self, given: Connection, source: Port, target: Port) -> tuple[float, float]:
        """Return factor and offset for the units of two ports."""
        named = f"{source.unit} -> {target.unit}"
        if given.convert == "none":
            return 1.0, 0.0
        if given.convert not in (None, "*") and " ".join(str(given.convert).split()) != named:
            raise InputError(f"{self.name}, {given}: convert is {given.convert!r}, and the units are {named!r}")
        if source.measure == target.measure and (source.measure is not None or source.unit == target.unit):
            if source.unit is None:
                self._warn(f"{given}: neither end has a unit, so that units are not checked")
            return 1.0, 0.0
        if source.measure is None or target.measure is None:
            if source.unit == target.unit:
                return 1.0, 0.0
            blind = given.source if source.measure is None else given.target
            unit = source.unit if source.measure is None else target.unit
            if unit is None:
                self._warn(f"{given}: {blind} has no unit, so that units are not checked")
                return 1.0, 0.0
            raise InputError(f"{self.name}, {given}: {unit}, the unit of {blind}, is not known")
        try:
            factor, offset = conversion(source.measure, target.measure)
        except InputError as error:
            raise InputError(f"{self.name}, {given}: {error}; connect variables of one unit") from None
        if (factor, offset) != (1.0, 0.0) and given.convert is None:
            raise InputError(
                f"{self.name}, {given}: the units are {source.unit} and {target.unit}; say that they are converted, "
                f'with convert = "{named}"'
            )
        return factor, offset

    def _warn(self, text: str) -> None:
        warnings.warn(f"{self.name}, {text}", AlfmuWarning, stacklevel=2)

    def _check_inputs(self) -> None:
        fed = {each.target for each in self.links}
        for name in self.system.inputs:
            component, _, variable = name.partition(".")
            inputs = [p.name for p in self.slaves[self._index[component]].inputs]
            if variable not in inputs or (self._index[component], variable) in fed:
                raise InputError(f"{self.name}: {component} has no input {variable!r}; {there_is(variable, inputs)}")

    def _levels(self) -> int:
        """Return the longest chain of outputs that depend directly on each other; reject, warn of or solve an algebraic
        loop."""
        after: dict[int, set[int]] = {k: set() for k in range(len(self.links))}
        for k, each in enumerate(self.links):
            follows = each.ends[0].follows
            for other, feed in enumerate(self.links):
                if feed.target[0] == each.source[0] and feed.target[1] in follows:
                    after[k].add(other)
        try:
            order = list(TopologicalSorter(after).static_order())
        except CycleError as error:
            loop = [self.links[k].given.source for k in reversed(error.args[1])]
            self.loop: list[str] = loop
            said = f"{' -> '.join(loop)} is an algebraic loop: each output follows the one before without delay"
            if self.system.master == "extrapolated":
                raise InputError(f'{self.name}: {said}; use the master "iterated", which solves it') from None
            if self.system.master == "held":
                self._warn(
                    f'{said}. The master "held" breaks it by a delay of one communication step, as importers do; '
                    '"iterated" solves it'
                )
            return len(self.slaves)
        self.loop = []
        depth: dict[int, int] = {}
        for k in order:
            depth[k] = 1 + max((depth[other] for other in after[k]), default=-1)
        return max(depth.values(), default=0)

    # Interface of the driver -----------------------------------------------------------------------------------------

    def set(self, name: str, value: float | str) -> None:
        """Set an unconnected input."""
        if name not in self._free:
            raise InputError(f"{self.name} has no input {name!r} that is free; {there_is(name, self._free)}")
        c, variable = self._free[name]
        self._given[c, variable] = float(value)
        if self._begun:
            self.slaves[c].set(variable, float(value))
            if self.system.master != "held":  # this master updates inputs after steps only, as importers do
                self._solve_loop() if self.loop else self._settle(self._depth)

    def initialize(self) -> None:
        """Start all components, with inputs that agree with outputs."""
        u: Vector | None = None
        for _ in range(len(self.slaves) + 1):
            for c, slave in enumerate(self.slaves):
                inputs = {name: x for (place, name), x in self._given.items() if place == c}
                if u is not None:
                    inputs |= {self.links[k].target[1]: self._typed(k, u[k]) for k in self._into[c]}
                self._guarded(slave, partial(slave.begin, inputs, self.system.start_time))
            before, self._begun = u, True
            self._u = np.array([self.slaves[c].get(name) for c, name in (each.target for each in self.links)], float)
            self._size = np.maximum(np.abs(self._u), SMALL)
            self._time = self.system.start_time
            if self.loop and self.system.master == "iterated":
                self._solve_loop()
            else:
                self._settle(self._depth + 1)
            u = self._u
            if before is not None and np.array_equal(before, u):
                break
        self._before: tuple[Vector, float] | None = None
        self._matrix: Vector | None = None
        self._y = self._read()
        self.observed: list[tuple[float, float, Vector, Vector]] = []

    def step(self, communication_step: float, time: float) -> None:
        """Step all components; `time` counts from the start."""
        h, self._time = communication_step, self.system.start_time + time
        if self._observed:
            self._began = self._read()
        getattr(self, f"_step_{self.system.master}")(h)
        self._size = np.maximum(self._size, np.abs(self._u))
        self.steps += 1

    def read(self) -> Vector:
        """Return all outputs; with `held_rows`, those before inputs were set at this communication point."""
        return np.array(self._y) if self._held_rows else self._read()

    def read_inputs(self) -> Vector:
        """Return the unconnected inputs."""
        return np.array([self.slaves[c].get(name) for c, name in self._free.values()], float)

    def fed(self) -> Vector:
        """Return the connected inputs, in the order of `links`."""
        return np.array(self._u)

    # Masters ---------------------------------------------------------------------------------------------------------

    def _step_held(self, h: float) -> None:
        self._advance(h, self._u)
        self._settle(1)

    def _step_extrapolated(self, h: float) -> None:
        u = self._u
        self._advance(h, self._predicted(h))
        self._before = (u, h)
        self._settle(self._depth + 1)

    def _step_iterated(self, h: float) -> None:
        u, last = self._u, np.inf
        states = [slave.save() for slave in self.slaves]
        end, seen, fresh = self._predicted(h), list(self.observed), False
        for k in range(MOST):
            if k:
                self._rewind(states, seen)
            self._advance(h, end)
            wanted = self._wanted()
            miss = np.where(self._smooth, wanted - end, 0.0)
            size = float(np.max(np.abs(miss) / np.maximum(self._size, np.abs(end)), initial=0.0))
            self.iterations += 1
            if size <= AGREES or (size <= STALLS and size > SLOW * last and fresh):
                break
            if self._matrix is None or (size > SLOW * last and not fresh):
                self._matrix, fresh = self._newton_matrix(h, states, end, seen), True
            try:
                end = end + np.linalg.solve(self._matrix, miss)
            except np.linalg.LinAlgError:
                raise StepError(
                    f"{self.name}, t = {self._time:.6g} s: outputs do not determine inputs at the end of a "
                    f"communication step of {h:g} s, as the matrix is singular; take another step"
                ) from None
            last = size
        else:
            worst = int(np.argmax(np.abs(miss) / np.maximum(self._size, np.abs(end))))
            raise StepError(
                f"{self.name}, t = {self._time:.6g} s: {self.links[worst].given} still differs by "
                f"{abs(miss[worst]):.2g} after {MOST} iterations of a communication step of {h:g} s; take a shorter one"
            )
        self._before = (u, h)
        self._put(np.where(self._smooth, end, wanted))

    def _predicted(self, h: float) -> Vector:
        """Extrapolate inputs to the end of a step, linearly from the last step."""
        if self._before is None:
            return self._u
        before, length = self._before
        return np.where(self._smooth, self._u + (self._u - before) * (h / length), self._u)

    def _advance(self, h: float, end: Vector) -> None:
        """Step all components with inputs that change linearly to `end`, which are then current."""
        if not self._observed:
            for c, slave in enumerate(self.slaves):
                self._guarded(slave, partial(self._stepped, c, h, self._u, end))
            self._y = self._read()
            return
        middle, seen = (self._u + end) / 2, [self._wanted(self._began)]
        for part, (begin, to) in enumerate(((self._u, middle), (middle, end))):
            for c, slave in enumerate(self.slaves):
                self._guarded(slave, partial(self._stepped, c, h / 2, begin, to, part * h / 2))
            self._y = self._read()
            seen.append(self._wanted(self._y))
        self.observed.append((self._time, h, np.array([self._u, middle, end]), np.array(seen)))

    def _stepped(self, c: int, h: float, begin: Vector, end: Vector, later: float = 0.0) -> None:
        """Step one component; its inputs change linearly from `begin` to `end`, or are held at their mean."""
        slave = self.slaves[c]
        for k in self._into[c]:
            name = self.links[k].target[1]
            change = end[k] - begin[k]
            if change and slave.interpolates:
                slave.set(name, begin[k])
                slave.slope(name, change / h)
            else:
                slave.set(name, self._typed(k, begin[k] + change / 2))
        slave.step(h, self._time + later)
        for k in self._into[c]:
            if end[k] != begin[k]:
                slave.set(self.links[k].target[1], end[k])

    def _rewind(self, states: Sequence[bytes], seen: list[tuple[float, float, Vector, Vector]]) -> None:
        for slave, state in zip(self.slaves, states, strict=True):
            slave.restore(state)
        self.observed = list(seen)

    def _newton_matrix(
        self, h: float, states: Sequence[bytes], end: Vector, seen: list[tuple[float, float, Vector, Vector]]
    ) -> Vector:
        """Return I - G dy/de for the components in these states."""
        n = len(self.links)
        matrix = np.eye(n)
        for c, slave in enumerate(self.slaves):
            inputs = [k for k in self._into[c] if self._smooth[k]]
            given = [k for k in range(n) if self.links[k].source[0] == c and self._smooth[k]]
            if not inputs or not given:
                continue

            def outputs(at: Vector, c: int = c, slave: Slave = slave) -> Vector:
                slave.restore(states[c])
                self._guarded(slave, lambda: self._stepped(c, h, self._u, at))
                return slave.read()

            change = interface_jacobian(outputs, end, inputs, NUDGE * np.maximum(self._size, np.abs(end)))
            for k in given:
                matrix[k, inputs] -= self.links[k].factor * change[self.links[k].source[1]]
        self._rewind(states, seen)
        self.jacobians += 1
        return matrix

    def _solve_loop(self) -> None:
        """Find inputs that agree with outputs in an algebraic loop."""
        n, u = len(self.links), self._u
        for _ in range(MOST):
            self._put(u)
            wanted = self._wanted()
            miss = wanted - u
            if np.max(np.abs(miss) / np.maximum(SMALL, np.abs(u)), initial=0.0) <= AGREES:
                return
            matrix = np.eye(n)
            for k in range(n):
                nudged = np.array(u)
                nudged[k] += (step := NUDGE * max(1.0, abs(u[k])))
                self._put(nudged)
                matrix[:, k] -= (self._wanted() - wanted) / step
            try:
                u = np.where(self._smooth, u + np.linalg.solve(matrix, miss), wanted)
            except np.linalg.LinAlgError:
                break
        raise InputError(
            f"{self.name}, t = {self._time:.6g} s: no inputs solve the algebraic loop {' -> '.join(self.loop)}; give "
            "one component a state between input and output"
        )

    # Signals ---------------------------------------------------------------------------------------------------------

    def _read(self) -> Vector:
        try:
            return outputs_of(self.slaves)
        except AlfmuError as error:
            raise type(error)(f"{self.name}, t = {self._time:.6g} s: {error}") from None

    def _wanted(self, y: Vector | None = None) -> Vector:
        """Return the values of connected inputs."""
        y = self._read() if y is None else y
        return self._gain * y[self._places] + self._shift

    def _settle(self, levels: int) -> None:
        """Set inputs from outputs, once for every level of direct dependence."""
        for k in range(levels):
            self._put(self._wanted(self._y if k == 0 and self._held_rows and levels == 1 else None))

    def _put(self, u: Vector) -> None:
        self._u = np.array(u, float)
        for k, each in enumerate(self.links):
            self.slaves[each.target[0]].set(each.target[1], self._typed(k, u[k]))

    def _typed(self, k: int, value: float) -> float:
        kind = self.links[k].ends[1].type
        return value if kind == "Real" else bool(value) if kind == "Boolean" else round(value)

    def _guarded(self, slave: Slave, run: Callable[[], object]) -> None:
        """Run a call of a component; errors get its name."""
        try:
            run()
        except AlfmuError as error:
            raise type(error)(f"{self.name}, component {slave.name}: {error}") from None


def interface_jacobian(
    outputs: Callable[[Vector], Vector], end: Vector, inputs: Sequence[int], nudges: Vector
) -> Vector:
    """Return dy/de of one component (outputs, inputs): outputs after a step by the values of inputs at its end.

    `outputs(e)` repeats the step with inputs that end at e, and returns all outputs; the quotients are differences with
    the `nudges` of inputs.
    """
    base = outputs(end)
    found = np.empty((len(base), len(inputs)))
    for column, k in enumerate(inputs):
        nudged = np.array(end)
        nudged[k] += nudges[k]
        found[:, column] = (outputs(nudged) - base) / nudges[k]
    return found


def _prefixed(component: str, port: Port) -> Variable:
    return Variable(f"{component}.{port.name}", port.unit or "", description=port.description, type=port.type)


def _a(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"
