"""Calls that declare quantities: parameters, start values, coordinates, inputs, states, outputs, watched points."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from .calls import declares
from .checks import perhaps_degrees
from .declaration import Declaration
from .errors import DeclarationError
from .motion import DERIVATIVES, ORDERS, Input
from .motion import JUMPS as LEAPS
from .parts import (
    EFFORT,
    GUESS,
    PLACE,
    READING,
    AnyJoint,
    AnyMarker,
    Coordinate,
    Output,
    Parameter,
    Scalar,
    Spring,
    Start,
    State,
    Watched,
    key_of,
    stack,
    symbolic,
)
from .units import is_rate, rate_of
from .words import interval, shown, text, there_is


@declares
class Quantities(Declaration):
    """A declaration with the calls for quantities."""

    # Quantities -------------------------------------------------------------------------------------------------

    def parameter(
        self,
        name: str,
        default: float,
        unit: str = "1",
        *,
        minimum: float | None = None,
        maximum: float | None = None,
        description: str = "",
    ) -> ca.SX:
        """Add a constant that a user may change before the start; return its symbol.

        `default`, `minimum` and `maximum` (inclusive) are floats in `unit`, one of `alfmu.model.units.UNITS`.
        """
        symbol = self._claim(name, unit, "a parameter")
        default = self._plain(f"the default of {name}", default)
        low, high = (
            bound if bound is None else self._plain(f"the {which} of {name}", bound)
            for which, bound in (("minimum", minimum), ("maximum", maximum))
        )
        if low is not None and high is not None and low > high:
            raise DeclarationError(f"{self.name}: the minimum {low:g} of {name} is above its maximum {high:g}")
        if (low is not None and default < low) or (high is not None and default > high):
            raise DeclarationError(f"{self.name}: the default {default} of {name} is outside {interval(low, high)}")
        if unit == "m":
            self._perhaps_millimetres(f"the default of {name}", default)
        elif unit == "rad":
            perhaps_degrees(f"{self.name}: the default of {name}", default)
        text(f"{self.name}: the description of {name}", description)
        Declaration.parameters.of(self).append(Parameter(name, symbol, default, unit, low, high, description))
        return self._stands_for(symbol, "parameters", f"the parameter {name}", unit)

    def start(
        self,
        name: str,
        value: float = 0.0,
        unit: str = "rad",
        *,
        rate: float = 0.0,
        rate_name: str | None = None,
        description: str = "",
    ) -> ca.SX:
        """Add a quantity given at the start, `start.<name>`, and its rate; return the symbol of its value.

        A coordinate whose `start` is this symbol is independent; `tie` binds the symbol to any other expression.
        """
        self._displacement(name, unit)
        rate_name = rate_name or f"{name}_rate"
        symbol = self._claim(f"start.{name}", unit, "a start value")
        self._claim(f"start.{rate_name}", rate_of(unit), "a start value")
        value, rate = self._plain(f"start.{name}", value), self._plain(f"start.{rate_name}", rate)
        if unit == "rad":
            perhaps_degrees(f"{self.name}: start.{name}", value)
        text(f"{self.name}: the description of {name}", description)
        Declaration.starts.of(self).append(Start(name, symbol, value, unit, rate_name, rate, description))
        self._by_symbol[key_of(symbol)] = self.starts[-1]
        return self._stands_for(symbol, "start values", f"the start value start.{name}", unit)

    def tie(self, start: ca.SX, expression: ca.SX) -> None:
        """Require `expression` (of the coordinates) to equal a start quantity when the run begins."""
        if not self._is_start(start):
            raise DeclarationError(f"{self.name}: tie() takes a symbol that start() returned, not {shown(start)}")
        quantity = self._by_symbol[key_of(start)]
        what = f"what start.{quantity.name} is tied to"
        Declaration.ties.of(self).append((start, symbolic(self._quantity(what, expression, quantity.unit, PLACE))))

    def coordinate(
        self,
        name: str,
        unit: str = "rad",
        *,
        start: Scalar | None = None,
        rate: float = 0.0,
        independent: bool = False,
        description: str = "",
    ) -> ca.SX:
        """Add a dependent coordinate (entry of q) in `unit`: rad, m or 1; return its symbol.

        `start` is the guess from which the assembly is solved: a number, or an expression in parameters, start
        quantities and coordinates declared before; its time derivative is the guess of the velocity. A coordinate with
        `independent=True`, or whose `start` is a start quantity, keeps the value the user gives. One without a guess
        begins at zero, and the assembly moves it ten times as readily as one with a guess.
        """
        self._displacement(name, unit)
        symbol = self._claim(name, unit, "a coordinate")
        guessed = start is not None or independent
        start = self._quantity(f"the start of {name}", 0.0 if start is None else start, unit, GUESS)
        if independent:
            if isinstance(start, ca.SX) and not start.is_constant():
                raise DeclarationError(
                    f"{self.name}: the start of the independent coordinate {name} is a number; give one, or tie() the "
                    "coordinate to a start() quantity"
                )
            start = self.start(name, float(start), unit, rate=rate, description=description)
        elif self._plain(f"the rate of {name}", rate):
            raise DeclarationError(
                f"{self.name}: only an independent coordinate has a start rate; {name} is not, so add independent=True"
            )
        elif unit == "rad" and not isinstance(start, ca.SX):
            perhaps_degrees(f"{self.name}: the guess of {name}", start)
        c = Coordinate(name, symbol, ca.SX.sym(f"{name}_v"), ca.SX.sym(f"{name}_a"), unit, start, guessed)
        Declaration.coordinates.of(self).append(c)
        self._by_symbol[key_of(symbol)] = c
        self._stands_for(symbol, "coordinates", f"the coordinate {name}", unit)
        self._stands_for(c.v, "rates", f"the rate of {name}", rate_of(unit))
        self._stands_for(c.a, "accelerations", f"the acceleration of {name}", rate_of(rate_of(unit)))
        if isinstance(start, ca.SX) and self._is_start(start):
            self.tie(start, symbol)
        return symbol

    def rate(self, coordinate: ca.SX) -> ca.SX:
        """Return the velocity of a coordinate, or the rate of an expression in coordinates declared before, for kinetic
        energies, forces and outputs."""
        if isinstance(coordinate, ca.SX) and coordinate.is_scalar() and not coordinate.is_symbolic():
            x = symbolic(self._quantity("the argument of rate()", coordinate, "1", PLACE))
            moving = stack([self.time, *(c.q for c in self.coordinates)])
            return ca.jtimes(x, moving, stack([1.0, *(c.v for c in self.coordinates)]))
        return self._coordinate(coordinate).v

    def acceleration(self, coordinate: ca.SX) -> ca.SX:
        """Return the acceleration symbol of a coordinate, for outputs."""
        return self._coordinate(coordinate).a

    def input(
        self,
        name: str,
        unit: str,
        *,
        start: float = 0.0,
        description: str = "",
        derivatives: int = 0,
        order: int = 2,
        jump: float | None = None,
    ) -> ca.SX:
        """Add a quantity in `unit` that the environment sets at any time and that is `start` until then; return its
        symbol.

        An input can also move something: a `motion`, a place, a guide, a constraint. It is then a *signal*, which runs
        without a jump from its present to its next value inside a communication step, as far as that is known.
        `derivatives` 1 or 2 declares the inputs `<name>_rate` and `<name>_acceleration`, which improve this prediction;
        the highest one given is extrapolated by a polynomial of `order` (0, 1 or 2) through its values at past
        communication points. A value that differs from the present signal by more than `jump` is refused; the default
        is 0.1 rad or 0.01 m.
        """
        symbol = self._claim(name, unit, "an input")
        text(f"{self.name}: the description of {name}", description)
        start = self._plain(f"the start of {name}", start)
        for what, given, known in (("derivatives", derivatives, (0, 1, 2)), ("order", order, ORDERS)):
            if type(given) is not int or given not in known:
                raise DeclarationError(f"{self.name}: the {what} of {name} is {shown(given)}; give 0, 1 or 2")
        limit = LEAPS.get(unit, LEAPS["m"]) if jump is None else self._plain(f"the jump of {name}", jump)
        if not limit > 0:
            raise DeclarationError(f"{self.name}: the jump of {name} is {limit:g} {unit}; it must be above zero")
        if derivatives:
            self._displacement(name, unit)
        own = Input(name, symbol, unit, start, description, derivatives, order, limit)
        Declaration.inputs.of(self).append(own)
        self._by_symbol[key_of(symbol)] = own
        companion, its = name, unit
        for what in DERIVATIVES[:derivatives]:
            companion, its = f"{name}_{what}", rate_of(its)
            rate = self._claim(companion, its, "an input")
            Declaration.inputs.of(self).append(Input(companion, rate, its, 0.0, f"{what} of {name}"))
            self._stands_for(rate, "inputs", f"the input {companion}", its)
        return self._stands_for(symbol, "inputs", f"the input {name}", unit)

    def state(
        self,
        name: str,
        unit: str,
        rate: Scalar | None = None,
        *,
        start: float = 0.0,
        nominal: float = 1.0,
        description: str = "",
    ) -> ca.SX:
        """Add a quantity of a first-order equation that is integrated with the motion: a current, an integral of a
        controller, a filtered signal, the filling of a vessel. Return its symbol, for forces, rates and outputs.

        `rate` is its time derivative [unit/s]: an expression in parameters, coordinates, rates, inputs, states and
        time. If the rate depends on the state itself, or on a later one, give it with `derivative` instead. `start` is
        its value [unit] at the start, which the parameter `start.<name>` changes. `nominal` [unit] is a large value of
        the state: errors below `solver.absolute_tolerance` times it are negligible. The output `<name>` shows it.
        Raises DeclarationError if the name is taken, or if a number or the unit is invalid.
        """
        symbol = self._claim(name, unit, "a state")
        self._claim(f"start.{name}", unit, "a start value")
        start, nominal = self._plain(f"start.{name}", start), self._plain(f"the nominal value of {name}", nominal)
        if not nominal > 0:
            raise DeclarationError(
                f"{self.name}: the nominal value of {name} is {nominal:g} {unit}; give the size of a large value, "
                "above zero"
            )
        text(f"{self.name}: the description of {name}", description)
        Declaration.states.of(self).append(State(name, symbol, unit, start, None, nominal, description))
        self._stands_for(symbol, "states", f"the state {name}", unit)
        if rate is not None:
            self.derivative(symbol, rate)
        return symbol

    def derivative(self, state: ca.SX, rate: Scalar) -> None:
        """Give a state that was declared without a rate its rate, an expression as in `state`::

            i = m.state("motor.current", "A")
            m.derivative(i, (voltage - resistance * i - constant * m.rate(angle)) / inductance)

        Raises DeclarationError if the symbol is no state of this mechanism, or has a rate already.
        """
        place = next((k for k, x in enumerate(self.states) if key_of(x.symbol) == key_of(state)), None)
        if place is None:
            given = state if isinstance(state, ca.SX) else shown(state)
            raise DeclarationError(
                f"{self.name}: {given} is not a state of this mechanism; give the symbol that state() returned"
            )
        found = self.states[place]
        if found.rate is not None:
            raise DeclarationError(
                f"{self.name}: the state {found.name} has a rate already{self.declared_at(found.name)}; give one, in "
                "state() or in derivative()"
            )
        what = f"the rate of {found.name}"
        expression = symbolic(self._quantity(what, rate, "1", EFFORT))
        own = self._symbols[key_of(expression)].unit if expression.is_symbolic() else "1"
        if own != "1" and not is_rate(own, found.unit):
            raise DeclarationError(
                f"{self.name}: {what} is in {found.unit} per second, and "
                f"{self._symbols[key_of(expression)].text} in {own}; give one in {found.unit} per second"
            )
        Declaration.states.of(self)[place] = replace(found, rate=expression)

    def output(self, name: str, expression: Scalar, unit: str = "1", description: str = "") -> None:
        """Add an output in `unit`: an expression in coordinates, rates, accelerations, inputs, states and time."""
        self._claim(name, unit, "an output")
        text(f"{self.name}: the description of {name}", description)
        expression = symbolic(self._quantity(f"output {name}", expression, unit, READING))
        Declaration.outputs.of(self).append(Output(name, expression, unit, description))

    def watch(self, name: str, marker: AnyMarker, description: str = "") -> None:
        """Watch a point of a body: outputs `<name>.x`, `.y` [m] and `.vx`, `.vy` [m/s] in ground axes, in space also
        `.z` and `.vz`. Pictures show the point, and films its trail, the path behind it.

        Raises DeclarationError if the name is taken or the marker is not on a body of this mechanism.
        """
        self._claim(name, "m", "a watched point")
        text(f"{self.name}: the description of {name}", description)
        self._own((marker,), f"watched point {name}")
        Declaration.watched.of(self).append(Watched(name, marker, description))

    def trace(self, name: str, marker: AnyMarker, description: str = "") -> None:
        """Former name of `watch`."""
        self.watch(name, marker, description)

    def measure(self, *of: AnyJoint | Spring | str) -> None:
        """Add outputs of joints and springs, given as objects or names; of all of them if none is given.

        A hinge `A` has `A.angle` [rad], `A.angular_velocity` and `A.angular_acceleration`, a slider `guide` has
        `guide.displacement` [m], `guide.velocity` and `guide.acceleration`: of the second body from the first. A spring
        `S` has `S.elongation`, `S.elongation_rate` and `S.force` [N], positive in tension, or `S.torque` [N.m]. One
        without a name is called after its joint (`A.spring`), between points by its number (`spring1`). Viscous
        friction is no spring: declare a damper in its place to measure it.

        Raises DeclarationError if something is neither a spring nor a joint with one free motion.
        """
        if not of:
            self.measures_all = True
        springs = dict(self._springs())
        for each in of:
            spring = each if isinstance(each, Spring) else springs.get(each) if isinstance(each, str) else None
            if spring is not None:
                if not any(spring is known for known in self.springs):
                    raise DeclarationError(f"{self.name}: measure() is given a spring of another mechanism")
                Declaration.measured.of(self).append(spring)
                continue
            names = [*springs, *(j.name for j in self.joints), *(j.name for j in self.spatial_joints)]
            if not isinstance(each, AnyJoint) and each not in names:
                if not isinstance(each, str):
                    raise DeclarationError(
                        f"{self.name}: measure() takes joints, springs or their names, not {shown(each)}"
                    )
                raise DeclarationError(f"{self.name} has no joint or spring {each} to measure; {there_is(each, names)}")
            joint = self._joint(each)
            self._free(joint, "measure()")
            Declaration.measured.of(self).append(joint)
