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

__all__ = ["Mechanism"]


QUICK = 100
"""Coordinates up to which a notebook draws a mechanism that it shows: a second, or less."""

DRAWN = ("", "revolute", "cylindrical", "prismatic", "spherical")
"""Kinds of joints that pictures show of what is declared at the general level; the first is none."""
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

    What is declared can be read: `parameters`, `coordinates`, `inputs`, `states`, `outputs`, `bodies`, `joints`,
    `spatial_bodies` and `spatial_joints` are tuples in the order of declaration, `options` are those it was made with.

    `sketch` is shown wherever the mechanism is explained; the README beside a mechanism's file is its documentation.
    Its `author` is named in the FMU. Methods raise DeclarationError, with the mechanism and the name, where what they
    are given makes no sense.
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
        """What pictures show at a place (3,) [m] in ground axes: for mechanisms whose bodies are energies alone.

        `kind` is "revolute", "cylindrical" or "prismatic", with the direction `axis` (3,); "spherical"; or "" for an
        end of a bar.
        Where they move, the outputs `<name>.x` ... and `<name>.axis.x` ... tell the place and the axis.
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
        """A bar in pictures, through two or more drawn joints by their names."""
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
        """The picture of the mechanism at its start, before anything is simulated; written to `path` (PNG or SVG) too.

        `at` gives values [rad, m] of start quantities or coordinates that it is drawn at, `parameters` changes
        defaults, `size` is in pixels. Returns a `Drawing`, which notebooks show. Raises AlfmuError where there is no
        start.
        """
        drawn: Picture = handed_in("draw")(self, path, at=at, parameters=parameters, size=size)
        return drawn

    def _repr_svg_(self) -> str | None:
        """What notebooks show; nothing, in silence, of a declaration that is not finished or cannot start."""
        return self._shown(lambda drawing: drawing._repr_svg_())

    def _repr_png_(self) -> bytes | None:
        return self._shown(lambda drawing: drawing._repr_png_())

    def _shown(self, how: Callable[[Picture], _Form | None]) -> _Form | None:
        """The drawing as a notebook asks for it, None where there is none or where it would take long."""
        if len(self.coordinates) > QUICK:
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                return how(self.draw())
            except Exception:
                return None

    def _kinematics(self) -> Kinematics:
        """Where its bodies and points are, as expressions, as far as it is declared by now."""
        return Kinematics(self)

    # General level ----------------------------------------------------------------------------------------------

    def kinetic_energy(self, expression: ca.SX) -> None:
        """Kinetic energy [J] in coordinates, their rates and time, in addition to that of the bodies."""
        Declaration.kinetic.of(self).append(symbolic(self._quantity("a kinetic energy", expression, "J", MOTION)))

    def potential_energy(self, expression: ca.SX) -> None:
        """Potential energy [J] in coordinates, time and inputs, in addition to that of the bodies and springs."""
        Declaration.potential.of(self).append(symbolic(self._quantity("a potential energy", expression, "J", PLACE)))

    def generalized_force(self, coordinate: ca.SX, expression: Scalar) -> None:
        """A generalised force along a coordinate: any expression in coordinates, rates, inputs, states and time."""
        along = self._coordinate(coordinate)
        what = f"the generalised force along {along.name}"
        expression = self._quantity(what, expression, EFFORTS.get(along.unit, "1"), EFFORT)
        Declaration.generalized.of(self).append((along.q, expression))

    def compliances(self) -> None:
        """Give each constraint a parameter `<joint>.compliance.<direction>` [m/N or rad/(N.m)], zero by default.

        Where they are given, redundant constraints share a load as joints of that compliance do; otherwise joints
        carry the least. The motion is that of rigid joints either way.
        """
        self.compliant = True

    def event(self, time: Scalar) -> None:
        """Let steps end at a time [s]: a number, or an expression in parameters.

        Where forces, laws and rates of states have comparisons, maxima, whole numbers and the like of time and inputs,
        these times are found by themselves. Declare one where something smooth is so short that steps may pass it.
        """
        Declaration.instants.of(self).append(self._quantity("the time of an event", time, "s", CONSTANT))

    # Changing topology ------------------------------------------------------------------------------------------

    def lock(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.locked` stop the free motion of a revolute or prismatic joint while it is on.

        A joint that moves stops in a plastic impact, and keeps its state where it is let go.
        """
        joint = self._joint(of)
        self._lock(joint.name, joint, self._free(joint, "lock()"))

    def motion(self, of: AnyJoint | str | ca.SX, law: Scalar, *, switch: bool = False) -> None:
        """Prescribe a motion: the free displacement of a revolute or prismatic joint, or a coordinate, follows `law`.

        `law` [rad or m] is an expression in time, parameters and inputs. The output `<name>.torque` [N.m] is the
        torque that the motion takes, on the second body from the first: inverse dynamics. Of a displacement in metres
        it is `<name>.force` [N], of a prismatic joint `<joint>.driving_force`. A coordinate that is independent has
        no start value then: it begins where the law has it.

        With `switch`, the Boolean input `<name>.driven` puts the motion in force while it is on, as a `lock` is: from
        where the joint is at that instant, it makes the *changes* of the law, in a plastic impact where the rates
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
                    f"{self.name}: the coordinate of {name} says already how it moves; leave out one of both"
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
        """What is declared as the free displacement of a joint, if anything: its coordinate, or the angle in the pose
        of a body that the joint hinges to the ground."""
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
        """A coordinate begins where its motion has it; DeclarationError where it was given another start."""
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
        """A law at time zero and default parameters; None where it takes a signal."""
        known = {key_of(self.time): 0.0, **{key_of(x.symbol): x.default for x in self.parameters}}
        symbols = ca.symvar(law)
        if any(key_of(x) not in known for x in symbols):
            return None
        return float(ca.substitute(law, stack(symbols), stack([known[key_of(x)] for x in symbols])))

    def clutch(self, name: str, first: Body, second: Body) -> None:
        """Let the Boolean input `<name>.locked` couple the turning of two bodies; a brake where one is the ground."""
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
        """Let the Boolean input `<name>.locked` keep any expression in the coordinates [m or rad] as it is."""
        self._claim(name, unit, "a lock")
        self._lock(name, self._of_coordinates(f"lock {name}", expression, unit), unit)

    def release(self, of: AnyJoint | str) -> None:
        """Let the Boolean input `<joint>.released` switch the constraints of a joint off while it is on.

        It can be switched off where the joint is closed again, in a plastic impact. `of` may name a `constraint`.
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
