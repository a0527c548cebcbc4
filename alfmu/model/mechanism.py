"""The declaration of a mechanism: frames, bodies, joints, forces, inputs, outputs, parameters.

A declaration lists *the parts*; `alfmu.derive` turns it into equations. Nothing here is differentiated or stepped.
Every number may be a float or an expression in parameters; poses, forces and outputs may use coordinates too.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import casadi as ca
import numpy as np

from .calls import declares
from .checks import symbols_in
from .declaration import Declaration
from .errors import DeclarationError
from .forces import Forces
from .hooks import Picture, handed_in
from .kinematics import Kinematics
from .parts import (
    CONSTANT,
    EFFORT,
    EFFORTS,
    LAW,
    MOTION,
    PLACE,
    AnyJoint,
    Body,
    Coordinate,
    DrawnBar,
    DrawnJoint,
    Lock,
    Motion,
    Rigidity,
    Scalar,
    key_of,
    stack,
    symbolic,
)
from .spatial import SpatialBody, SpatialFreedom, SpatialJoint
from .units import rate_of
from .words import in_words, quantity, shown, there_is

QUICK = 100
"""Largest number of coordinates for which a notebook draws a mechanism: this takes a second at most."""

DRAWN = ("", "revolute", "cylindrical", "prismatic", "spherical")
"""Kinds of joints that pictures can show for a mechanism at the general level; "" is the end of a bar."""
_Form = TypeVar("_Form", str, bytes)


@declares
class Mechanism(Forces):
    """A mechanism: bodies and joints in the plane or in space, with a general level for everything else.

    Declare parameters and coordinates, then bodies, then joints and forces::

        m = Mechanism("pendulum", description="A bar on a hinge")
        l = m.parameter("l", 1.0, "m", minimum=1e-6)
        g = m.parameter("g", 9.81, "m/s2")
        th = m.coordinate("th", "rad", start=0.5, independent=True)
        rod = m.bar("rod", mass=1.0, length=l)
        m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th)
        m.gravity(0, -g)

    `ground` is the frame of the ground in the plane, x to the right, y upwards and angles [rad] counter-clockwise;
    `spatial_ground` is that in space; `time` is the symbol of time [s]. Numbers are in SI units: floats, or expressions
    of CasADi in what the methods return.

    The parts can be read: `parameters`, `coordinates`, `inputs`, `states`, `outputs`, `bodies`, `joints`,
    `spatial_bodies` and `spatial_joints` are tuples in the order of declaration, `options` are the arguments it was
    made with.

    Explanations of the mechanism show `sketch`; the README beside a mechanism's file is its documentation. Its `author`
    is named in the FMU. Methods raise DeclarationError, which names the mechanism and the part, if an argument is
    invalid.
    """

    # Pictures ---------------------------------------------------------------------------------------------------

    def drawn_joint(
        self,
        name: str,
        at: Sequence[Scalar] | np.ndarray | ca.SX,
        *,
        kind: str = "",
        axis: Sequence[Scalar] | np.ndarray | ca.SX | None = None,
    ) -> None:
        """Draw a joint at a place (3,) [m] in ground axes: for mechanisms declared by energies only.

        `kind` is "revolute", "cylindrical" or "prismatic", with the direction `axis` (3,); "spherical"; or "" for an
        end of a bar. For a joint that moves, the outputs `<name>.x` ... and `<name>.axis.x` ... give the place and the
        axis.
        """
        if kind not in DRAWN:
            raise DeclarationError(f"{self.name}: {name} is drawn as {shown(kind)}; take one of {in_words(DRAWN[1:])}")
        if (axis is None) != (kind in ("", "spherical")):
            what = "needs an axis" if axis is None else "has no axis"
            raise DeclarationError(f"{self.name}: {name}, drawn as {kind or 'an end'}, {what}")
        if name in (joint.name for joint in self.drawn_joints):
            raise DeclarationError(f"{self.name}: {name} is drawn twice; give each joint its own name")
        place = self._vector(f"the place of {name}", at, ("m",) * 3, PLACE)
        along = None if axis is None else self._vector(f"the axis of {name}", axis, ("1",) * 3, PLACE)
        parts = {f"{name}.{k}": (x, "m", f"place of {name} along {k}") for k, x in zip("xyz", place, strict=True)}
        for k, x in zip("xyz", along or (), strict=False):
            parts[f"{name}.axis.{k}"] = x, "1", f"direction of the axis of {name} along {k}"
        kinds = {self._symbols[key_of(s)].kind for x in (*place, *(along or ())) for s in symbols_in(x)}
        if moves := bool(kinds & {"coordinates", "time", "inputs"}):
            for output, (expression, unit, description) in parts.items():
                self.output(output, expression, unit, description)
        Declaration.drawn_joints.of(self).append(DrawnJoint(name, kind, place, along, tuple(parts) if moves else ()))

    def drawn_bar(self, name: str, *joints: str) -> None:
        """Draw a bar in pictures, through two or more drawn joints given by their names."""
        known = [joint.name for joint in self.drawn_joints]
        if len(joints) < 2:
            raise DeclarationError(f"{self.name}: {name} is drawn through {len(joints)} joints; give two or more")
        for joint in joints:
            if joint not in known:
                raise DeclarationError(f"{self.name}: {name} is drawn through {joint}; {there_is(joint, known)}")
        Declaration.drawn_bars.of(self).append(DrawnBar(name, joints))

    def draw(
        self,
        path: str | Path | None = None,
        *,
        at: Mapping[str, float] | None = None,
        parameters: Mapping[str, float] | None = None,
        size: tuple[int, int] = (640, 480),
    ) -> Picture:
        """Draw the mechanism at its start, before any simulation; write the picture to `path` (PNG or SVG) if given.

        `at` gives values [rad, m] of start quantities or coordinates that it is drawn at, `parameters` changes
        defaults, `size` is in pixels. Returns a `Drawing`, which notebooks show. Raises AlfmuError if the mechanism has
        no start.
        """
        drawn: Picture = handed_in("draw")(self, path, at=at, parameters=parameters, size=size)
        return drawn

    def _repr_svg_(self) -> str | None:
        """Return the picture for notebooks; None, without an error, if the declaration is unfinished or cannot
        start."""
        return self._shown(lambda drawing: drawing._repr_svg_())

    def _repr_png_(self) -> bytes | None:
        return self._shown(lambda drawing: drawing._repr_png_())

    def _shown(self, how: Callable[[Picture], _Form | None]) -> _Form | None:
        """Return the drawing in the form that a notebook asks for; None if there is none or if drawing would take
        long."""
        if len(self.coordinates) > QUICK:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return how(self.draw())
            except Exception:
                return None

    def _kinematics(self) -> Kinematics:
        """Return the places of its bodies and points as expressions, from the declaration so far."""
        return Kinematics(self)

    # General level ----------------------------------------------------------------------------------------------

    def kinetic_energy(self, expression: ca.SX) -> None:
        """Add kinetic energy [J] in coordinates, their rates and time to that of the bodies."""
        Declaration.kinetic.of(self).append(symbolic(self._quantity("a kinetic energy", expression, "J", MOTION)))

    def potential_energy(self, expression: ca.SX) -> None:
        """Add potential energy [J] in coordinates, time and inputs to that of the bodies and springs."""
        Declaration.potential.of(self).append(symbolic(self._quantity("a potential energy", expression, "J", PLACE)))

    def generalized_force(self, coordinate: ca.SX, expression: Scalar) -> None:
        """Add a generalised force along a coordinate: any expression in coordinates, rates, inputs, states and time."""
        along = self._coordinate(coordinate)
        what = f"the generalised force along {along.name}"
        expression = self._quantity(what, expression, EFFORTS.get(along.unit, "1"), EFFORT)
        Declaration.generalized.of(self).append((along.q, expression))

    def compliances(self) -> None:
        """Give each constraint a parameter `<joint>.compliance.<direction>` [m/N or rad/(N.m)], zero by default.

        If compliances are given, redundant constraints share a load like elastic joints with these compliances;
        otherwise the multipliers have least norm. The motion is that of rigid joints in both cases.
        """
        self.compliant = True

    def event(self, time: Scalar) -> None:
        """Let steps end at a time [s]: a number, or an expression in parameters.

        Times at which comparisons, maxima, roundings and similar functions of time and inputs switch in forces, laws
        and rates of states are found automatically. Declare an event for a smooth pulse so short that a step may miss
        it.
        """
        Declaration.instants.of(self).append(self._quantity("the time of an event", time, "s", CONSTANT))

    # Changing topology ------------------------------------------------------------------------------------------

    def lock(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.locked` stop the free motion of a revolute or prismatic joint while it is on.

        A joint that moves stops in a plastic impact, and keeps its state when it is released.
        """
        joint = self._joint(of)
        self._lock(joint.name, joint, self._free(joint, "lock()"))

    def motion(self, of: AnyJoint | str | ca.SX, law: Scalar, *, switch: bool = False) -> None:
        """Prescribe a motion: the free displacement of a revolute or prismatic joint, or a coordinate, follows `law`.

        `law` [rad or m] is an expression in time, parameters and inputs. The output `<name>.torque` [N.m] is the torque
        that the motion requires, on the second body from the first: inverse dynamics. For a displacement in metres it
        is `<name>.force` [N], for a prismatic joint `<joint>.driving_force`. An independent coordinate then has no
        start value: it starts at the value of the law.

        With `switch`, the Boolean input `<name>.driven` puts the motion in force while it is on, like a `lock`: from
        its position at that instant, the joint follows the *changes* of the law, after a plastic impact if the rates
        differ.
        """
        along: AnyJoint | ca.SX
        placed: Scalar | None
        if isinstance(of, ca.SX):
            own = self._coordinate(of)
            name, unit, along, placed = own.name, own.unit, own.q, own.q
            if unit == "1":
                raise DeclarationError(f"{self.name}: {name} has no unit; motion() takes a coordinate in m or rad")
        else:
            along = self._joint(of)
            name, unit = along.name, self._free(along, "motion()")
            placed = self._displacing(along)
            if placed is not None and not self._moves(placed):
                raise DeclarationError(
                    f"{self.name}: the coordinate of {name} already prescribes its motion; leave out one of both"
                )
        if any(isinstance(c, Motion) and c.name == name for c in self.closures):
            raise DeclarationError(f"{self.name}: {name} has a motion already; give it one")
        law = symbolic(self._quantity(f"the motion of {name}", law, unit, LAW))
        self._no_jumps(f"the motion of {name}", law, unit, name if switch else "")
        self.moves = True
        value = None
        coordinate = None if placed is None else self._by_symbol.get(key_of(placed))
        if switch:
            self._claim(f"{name}.driven", "1", "an input")
            value = ca.SX.sym(f"{name}.driven_from")
        elif isinstance(coordinate, Coordinate):
            self._begins(coordinate, law)
        Declaration.closures.of(self).append(Motion(name, along, law, unit, value))

    def _displacing(self, joint: AnyJoint) -> Scalar | None:
        """Return the free displacement of a joint as declared, if any: its coordinate, or the angle in the pose of a
        body that the joint hinges to the ground."""
        if isinstance(joint, SpatialFreedom):
            whole, which = joint.joint, joint.which
            return None if whole.coordinates is None else whole.coordinates[list(whole.freedoms).index(which)]
        if isinstance(joint, SpatialJoint):
            return None if joint.coordinates is None else joint.coordinates[0]
        if joint.coordinate is None and joint.kind == "revolute" and joint.first.body is self.ground:
            pose = joint.second.body.pose
            return pose[2] if pose is not None and self._moves(pose[2]) else None
        return joint.coordinate

    def _begins(self, coordinate: Coordinate, law: ca.SX) -> None:
        """Let a coordinate start at the value of its motion; raise DeclarationError if it was given another start."""
        name = coordinate.name
        own = [x for x in self.starts if x.name == name and x.symbol is coordinate.guess]
        for start in own:
            for each, rate in ((start.value, False), (start.rate, True)):
                there = self._at_begin(ca.jacobian(law, self.time) if rate else law)
                if each and there is not None and abs(each - there) > 1e-9 * max(1.0, abs(there)):
                    what, unit = ("rate of ", rate_of(start.unit)) if rate else ("", start.unit)
                    raise DeclarationError(
                        f"{self.name}: the start {what}{name} is {quantity(each, unit, 6)}, and its motion has "
                        f"{quantity(there, unit, 6)} at t = 0; leave the start out, which follows the motion"
                    )
            Declaration.starts.of(self).remove(start)
            ties = Declaration.ties.of(self)
            ties[:] = [tie for tie in ties if tie[0] is not start.symbol]
            for claimed in (f"start.{name}", f"start.{start.rate_name}"):
                del self._names[claimed]
        i = next(i for i, each in enumerate(self.coordinates) if each is coordinate)
        following = replace(coordinate, guess=law)
        Declaration.coordinates.of(self)[i] = self._by_symbol[key_of(coordinate.q)] = following

    def _at_begin(self, law: ca.SX) -> float | None:
        """Return a law at time zero and default parameters; None if it depends on a signal."""
        known = {key_of(self.time): 0.0, **{key_of(x.symbol): x.default for x in self.parameters}}
        symbols = ca.symvar(law)
        if any(key_of(x) not in known for x in symbols):
            return None
        return float(ca.substitute(law, stack(symbols), stack([known[key_of(x)] for x in symbols])))

    def clutch(self, name: str, first: Body, second: Body) -> None:
        """Let the Boolean input `<name>.locked` couple the rotation of two bodies; a brake if one is the ground."""
        self._claim(name, "1", "a clutch")
        for body in (first, second):
            self._body(body, f"clutch {name}")
            if isinstance(body, SpatialBody):
                raise DeclarationError(
                    f"{self.name}: clutch {name} couples bodies in the plane, and {body.name} is in space; use "
                    "lock() on a hinge"
                )
        if first is second:
            raise DeclarationError(f"{self.name}: clutch {name} couples {first.name} to itself")
        self._lock(name, (first, second), "rad")

    def lock_displacement(self, name: str, expression: ca.SX, unit: str = "rad") -> None:
        """Let the Boolean input `<name>.locked` keep an expression in the coordinates [m or rad] at its present
        value."""
        self._claim(name, unit, "a lock")
        self._lock(name, self._of_coordinates(f"lock {name}", expression, unit), unit)

    def release(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.released` switch the constraints of a joint off while it is on.

        The input can be switched off again at a position where the joint closes; the impact is plastic. `of` may name a
        `constraint`.
        """
        found = [c for c in self.closures if c is of or (not isinstance(c, Rigidity | Lock | Motion) and c.name == of)]
        if not found:
            names = ", ".join(c.name for c in self.closures if not isinstance(c, Rigidity | Lock | Motion)) or "none"
            called = of.name if isinstance(of, AnyJoint) else of
            raise DeclarationError(
                f"{self.name}: {called} is not closed by constraints, so it cannot be released; those are {names}"
            )
        self._claim(f"{found[0].name}.released", "1", "an input")
        Declaration.releases.of(self).append(found[0])

    def _lock(self, name: str, of: AnyJoint | tuple[Body, Body] | ca.SX, unit: str) -> None:
        self._claim(f"{name}.locked", "1", "an input")
        Declaration.closures.of(self).append(Lock(name, of, unit, ca.SX.sym(f"{name}.locked_at")))
