"""Calls that declare forces: drives, loads, springs, limit stops, friction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from .calls import declares
from .checks import hint, symbols_in
from .couplings import Couplings
from .declaration import Declaration
from .errors import DeclarationError
from .parts import (
    CONSTANT,
    EFFORT,
    EFFORTS,
    PLACE,
    AnyJoint,
    AnyMarker,
    Body,
    Drive,
    Friction,
    Load,
    Marker,
    Scalar,
    SpatialLoad,
    Spring,
    key_of,
    symbolic,
)
from .spatial import SpatialBody, SpatialFreedom, SpatialJoint, SpatialMarker
from .stops import CREEP, ONSET, EndStop
from .units import rate_of
from .words import counted, in_words, quantity, shown

_DRY_FRICTION: dict[tuple[str, bool], tuple[tuple[str, ...], str]] = {
    ("revolute", False): (("radius",), "a revolute joint is a journal; give its radius [m], and no length or collar"),
    ("prismatic", False): (
        ("length",),
        "a prismatic joint has no radius or collar; give the length [m] between its edges, or nothing",
    ),
    ("revolute", True): (
        ("radius", "length", "collar"),
        "a revolute joint is a journal; give its radius [m], and perhaps the length [m] between its bearings and the "
        "radius [m] of its collar",
    ),
    ("prismatic", True): (
        ("radius", "length"),
        "a prismatic joint has no collar; give the length [m] between its edges, the radius [m] of its key, or nothing",
    ),
    ("screw", True): (("radius",), "a screw takes the radius [m] of its thread, and no length or collar"),
}
"""Permitted geometry of dry friction for each kind of joint, in the plane or in space, and the message for any
other."""


@declares
class Forces(Couplings):
    """A declaration with the calls for forces."""

    # Forces -----------------------------------------------------------------------------------------------------

    def drive(self, joint: AnyJoint, effort: Scalar) -> None:
        """Add a torque [N.m] (revolute) or a force along the guide [N] (prismatic) on the second body from the
        first."""
        unit = EFFORTS[self._free(joint, "drive()")]
        Declaration.drives.of(self).append(
            Drive(joint, self._quantity(f"the effort on {joint.name}", effort, unit, EFFORT))
        )

    def force(self, at: AnyMarker, x: Scalar = 0.0, y: Scalar = 0.0, z: Scalar = 0.0) -> None:
        """Add a force [N] in ground axes at a point of a body: an input, a state, a constant, or any expression.

        `z` is for bodies in space. For a force that turns with its body, give the entries of `body.rotation @ force`.
        """
        self._own((at,), "force()")
        what = f"the force on {at.body.name}"
        if isinstance(at, SpatialMarker):
            force = self._vector(what, (x, y, z), ("N",) * 3, EFFORT)
            Declaration.spatial_loads.of(self).append(SpatialLoad(at, force, (0.0,) * 3))
        elif isinstance(z, ca.SX) or z != 0:
            raise DeclarationError(f"{self.name}: {what}, a body in the plane, has a part along z; leave z out")
        else:
            Declaration.loads.of(self).append(Load(at, self._vector(what, (x, y), ("N",) * 2, EFFORT), 0.0))

    def torque(self, body: Body | SpatialBody, torque: Scalar | Sequence[Scalar] | ca.SX) -> None:
        """Add a torque [N.m] on a body from the ground: a number or an expression; in space three of them, in ground
        axes."""
        self._body(body, "torque()")
        what = f"the torque on {body.name}"
        if isinstance(body, SpatialBody):
            vector = self._vector(f"{what}, a body in space,", torque, ("N.m",) * 3, EFFORT)
            Declaration.spatial_loads.of(self).append(SpatialLoad(body.at(*body.center), (0.0,) * 3, vector))
        else:
            torque = self._quantity(what, torque, "N.m", EFFORT)
            Declaration.loads.of(self).append(Load(body.start, (0.0, 0.0), torque))

    def spring_damper(
        self,
        between: AnyJoint | tuple[AnyMarker, AnyMarker],
        *,
        stiffness: Scalar = 0.0,
        damping: Scalar = 0.0,
        rest: Scalar = 0.0,
        name: str = "",
    ) -> Spring:
        """Add a linear spring-damper: torsional on a revolute joint, along the guide on a prismatic one, or between
        points.

        `stiffness` is in N.m/rad or N/m, `damping` in N.m.s/rad or N.s/m, the rest angle or length in rad or m. Points
        may belong to bodies in space. Angles count whole turns, whichever coordinates place the bodies. With a `name`,
        its elongation and force are outputs (see `measure`).
        """
        if isinstance(between, AnyJoint):
            along, what = self._free(between, "spring_damper()"), f"the spring at {between.name}"
        else:
            along, what = "m", "the spring between two points"
            if not isinstance(between, tuple | list) or len(between) != 2:
                given = "" if isinstance(between, tuple | list) else f", not {shown(between)}"
                raise DeclarationError(f"{self.name}: spring_damper() takes a joint, or a pair of markers{given}")
            self._own_pair(between, "a spring")
        stiffness = self._quantity(f"the stiffness of {what}", stiffness, f"{EFFORTS[along]}/{along}", PLACE)
        damping = self._quantity(f"the damping of {what}", damping, f"{EFFORTS[along]}.s/{along}", EFFORT)
        rest = self._quantity(f"the rest of {what}", rest, along, PLACE)
        for which, value, does in (("stiffness", stiffness, "pushes away from rest"), ("damping", damping, "drives")):
            if self._is_constant(value) and (found := self._at_defaults(f"the {which} of {what}", value)) < 0:
                hint(f"{self.name}: the {which} of {what} is {found:g}, so it {does}; leave out the sign if unwanted")
        if name:
            self._claim(name, "1", "a spring")
        Declaration.springs.of(self).append(Spring(between, stiffness, damping, rest, name))
        return self.springs[-1]

    def end_stop(
        self,
        name: str,
        of: AnyJoint | tuple[AnyMarker, AnyMarker] | ca.SX,
        *,
        upper: Scalar | None = None,
        lower: Scalar | None = None,
        stiffness: Scalar,
        onset: Scalar = ONSET,
        dissipation: Scalar | None = None,
        restitution: Scalar | None = None,
        creep: Scalar = CREEP,
        unit: str = "m",
    ) -> EndStop:
        """Add a limit stop: beyond `upper`, below `lower`, or both, it pushes a displacement back and never pulls.

        It acts on the free motion of a joint, on the distance of two markers, or on an expression in coordinates in
        `unit`, m or rad. The stiffness rises smoothly up to a penetration of `onset` [m or rad], beyond which it is
        `stiffness` [N/m or N.m/rad]. Energy is dissipated by `dissipation` [s/m or s/rad], in proportion to the push
        and its rate, or by a coefficient of `restitution` from 0 to 1, the ratio of the speeds after and before a blow;
        without either, none is. With a restitution, `creep` [m/s or rad/s] is the range of rates about zero over which
        the push changes between approach and return.

        Outputs: `<name>.penetration` [m or rad] and `<name>.force` [N] or `<name>.torque` [N.m] along the displacement.
        Raises DeclarationError if there is no limit, or if a number is out of its range.
        """
        what = f"end stop {name}"
        if isinstance(of, AnyJoint):
            along = self._free(of, what)
        elif isinstance(of, tuple | list):
            along = "m"
            if len(of) != 2:
                raise DeclarationError(f"{self.name}: {what} is between {len(of)} points; give two markers")
            self._own_pair(of, what)
        else:
            along = unit
            if unit not in EFFORTS:
                raise DeclarationError(f"{self.name}: {what} is in {shown(unit)}; give m or rad")
            if not isinstance(of, ca.SX):
                raise DeclarationError(
                    f"{self.name}: {what} takes a joint, two markers or an expression in coordinates, not {shown(of)}"
                )
            of = self._of_coordinates(what, of, unit)
        limits = {
            which: self._quantity(f"the {which} limit of {what}", x, along, PLACE)
            for which, x in (("upper", upper), ("lower", lower))
            if x is not None
        }
        if not limits:
            raise DeclarationError(f"{self.name}: {what} has no limit; give upper=, lower= or both, in {along}")
        if not any(self._moves(x) for x in limits.values()):
            at = {which: self._at_defaults(f"the {which} limit of {what}", x) for which, x in limits.items()}
            if len(at) == 2 and not at["upper"] > at["lower"]:
                raise DeclarationError(
                    f"{self.name}: {what} has the upper limit {quantity(at['upper'], along, 6)} and the lower limit "
                    f"{quantity(at['lower'], along, 6)}; the upper one must be above"
                )
        if dissipation is not None and restitution is not None:
            raise DeclarationError(f"{self.name}: {what} has a dissipation and a restitution; give one of them")
        effort = f"{EFFORTS[along]}/{along}"

        def positive(which: str, value: Scalar, unit: str, least: float | None, most: float = math.inf) -> Scalar:
            """Return a constant above zero, or in a range if `least` is given."""
            value = self._constant(f"the {which} of {what}", value, unit)
            x = self._at_defaults(f"the {which} of {what}", value)
            if not (x > 0 if least is None else least <= x <= most):
                needed = "be above zero" if least is None else f"be from {least:g} to {most:g}"
                needed = needed if math.isfinite(most) or least is None else "not be negative"
                given = f"{x:g} {unit}".removesuffix(" 1")
                raise DeclarationError(f"{self.name}: the {which} of {what} is {given}; it must {needed}")
            return value

        stop = EndStop(
            name,
            tuple(of) if isinstance(of, list) else of,
            along,
            limits.get("upper"),
            limits.get("lower"),
            positive("stiffness", stiffness, effort, 0.0),
            positive("onset", onset, along, None),
            None if dissipation is None else positive("dissipation", dissipation, "s/m" if along == "m" else "s", 0.0),
            None if restitution is None else positive("restitution", restitution, "1", 0.0, 1.0),
            positive("creep", creep, rate_of(along), None),
        )
        self._claim(f"{name}.penetration", along, "an output")
        self._claim(f"{name}.{'force' if along == 'm' else 'torque'}", EFFORTS[along], "an output")
        Declaration.end_stops.of(self).append(stop)
        return stop

    def friction(
        self,
        joint: AnyJoint,
        viscous: Scalar | None = None,
        *,
        coulomb: Scalar | None = None,
        static: Scalar | None = None,
        radius: Scalar | None = None,
        length: Scalar | None = None,
        stribeck: Scalar | None = None,
        collar: Scalar | None = None,
        load: Scalar | None = None,
    ) -> None:
        """Add friction in a revolute, prismatic or screw joint: viscous, and dry in proportion to the joint's reaction.

        `viscous` [N.m.s/rad or N.s/m] resists in proportion to the rate. `coulomb` is the coefficient of dry friction
        while the joint slides, `static` that at which it begins to slide (the same if omitted). With `stribeck` [rad/s
        or m/s] the coefficient goes from the static one at rest to the Coulomb one at such rates. A sticking joint is
        held as if locked. A coefficient that depends on inputs, time or the motion counts as zero when it is negative.

        A revolute joint is a journal of `radius` [m]: its torque is coefficient times radius times the force across its
        axis. A prismatic joint bears at two edges that are `length` [m] apart, which carry its force and its moment;
        without `length` only its force causes friction. In space a journal may have a `length` between two bearings,
        too, and a `collar` of that radius [m] for the force along its axis; a guide may have a key at a `radius` for
        the moment about its axis; a screw takes the `radius` of its thread. A bearing surface that is not given carries
        its load without friction.

        With `load` [N.m or N], a constant, the dry friction is the coefficient times this load instead of the reaction:
        that of a seal or a gearbox, which the reaction does not change. Such a joint takes no bearing surfaces.
        """
        numbers = (viscous, coulomb, static, radius, length, stribeck, collar, load)
        if any(x is not None for x in numbers[1:]):
            self._slides_one_way(joint)
        along = self._free(joint, "friction()")
        if all(x is None for x in numbers):
            raise DeclarationError(
                f"{self.name}: the friction of {joint.name} has no coefficient; give viscous or coulomb"
            )
        coulomb = self._coefficient(joint, "coefficient coulomb", 0.0 if coulomb is None else coulomb, "1")
        unit = f"{EFFORTS[along]}.s/{along}"
        viscous = self._coefficient(joint, "viscous coefficient", 0.0 if viscous is None else viscous, unit)
        dry = not symbolic(coulomb).is_zero() or static is not None
        if not dry and (given := [x for x in (radius, length, stribeck, collar, load) if x is not None]):
            raise DeclarationError(
                f"{self.name}: the friction of {joint.name} has {counted(len(given), 'number')} of dry friction and no "
                "coefficient; give coulomb"
            )
        if not dry or not symbolic(viscous).is_zero():
            known = replace(self.spring_damper(joint, damping=viscous), friction=True)
            Declaration.springs.of(self)[-1] = known
        if dry:
            self._dry_friction(joint, along, coulomb, static, radius, length, stribeck, collar, load)

    def _own_pair(self, markers: Sequence[AnyMarker], what: str) -> None:
        """Check two points of this mechanism, both in the plane or both in space."""
        self._own(markers, what)
        if isinstance(markers[0], Marker) != isinstance(markers[1], Marker):
            raise DeclarationError(f"{self.name}: {what} joins a point in the plane to one in space; take one kind")

    def _coefficient(self, joint: AnyJoint, which: str, value: Any, unit: str) -> Scalar:
        """Return a coefficient of friction; a constant that is negative is refused, a variable one counts as zero when
        negative."""
        what = f"the {which} of friction of {joint.name}"
        value = self._quantity(what, value, unit, EFFORT)
        if self._is_constant(value):
            self._not_negative(what, value, unit)
            return value
        return ca.fmax(value, 0)

    def _is_constant(self, value: Scalar) -> bool:
        """Return whether a quantity is a number, or depends on parameters alone."""
        return all(self._symbols[key_of(symbol)].kind in CONSTANT for symbol in symbols_in(value))

    def _slides_one_way(self, joint: AnyJoint) -> None:
        """Raise DeclarationError if the joint has no signed sliding direction, which dry friction requires."""
        whole = joint.joint if isinstance(joint, SpatialFreedom) else joint
        if isinstance(whole, SpatialJoint) and len(whole.freedoms) != 1 and whole.kind not in ("weld", "distance"):
            moves = in_words(list(whole.freedoms), "and") if whole.freedoms else "turns"
            raise DeclarationError(
                f"{self.name}: dry friction of {whole.name}: a {whole.kind} joint can slide in several directions "
                f"({moves}), and dry friction along a combination of them is not supported; "
                "make it of joints with one free motion each, or give only viscous friction"
            )

    def _dry_friction(
        self,
        joint: AnyJoint,
        along: str,
        coulomb: Scalar,
        static: Scalar | None,
        radius: Scalar | None,
        length: Scalar | None,
        stribeck: Scalar | None,
        collar: Scalar | None,
        load: Scalar | None,
    ) -> None:
        name = joint.name
        takes, text = _DRY_FRICTION[joint.kind, isinstance(joint, SpatialJoint)]
        given = {"radius": radius, "length": length, "collar": collar}
        if load is not None:
            takes, text = (), "a constant load needs no radius, length or collar; leave them out, or the load"
            load = self._quantity(f"the load of friction of {name}", load, EFFORTS[along], CONSTANT)
            self._not_negative(f"the load of friction of {name}", load, EFFORTS[along])
        if any(x is not None and each not in takes for each, x in given.items()) or (
            along == "rad" and radius is None and load is None
        ):
            raise DeclarationError(f"{self.name}: dry friction of {name}: {text}")
        if static is None and stribeck is not None:
            raise DeclarationError(
                f"{self.name}: dry friction of {name}: stribeck leads from the static coefficient to the Coulomb one; "
                "give static"
            )
        what = "the {} of friction of {}".format
        static = coulomb if static is None else self._coefficient(joint, "coefficient static", static, "1")
        if not isinstance(coulomb, ca.SX) and not isinstance(static, ca.SX) and static < coulomb:
            raise DeclarationError(
                f"{self.name}: the friction of {name} has static = {static:g} below coulomb = {coulomb:g}; static "
                "friction is at least as large as Coulomb friction"
            )
        radius, length, collar = (
            None if x is None else self._length(what(letter, name), x, CONSTANT) for letter, x in given.items()
        )
        if stribeck is not None:
            stribeck = self._quantity(what("rate stribeck", name), stribeck, rate_of(along), CONSTANT)
            if (value := self._at_defaults(what("rate stribeck", name), stribeck)) <= 0:
                raise DeclarationError(
                    f"{self.name}: {what('rate stribeck', name)} is {value:g} {rate_of(along)}; it must be above zero"
                )
        if any(isinstance(each, Friction) and each.of is joint for each in self.closures):
            raise DeclarationError(f"{self.name}: {name} has dry friction already; give its numbers in one call")
        self._claim(f"{name}.slip", "1", "an output")
        at, slip = ca.SX.sym(f"{name}.sticks_at"), ca.SX.sym(f"{name}.slip")
        Declaration.closures.of(self).append(
            Friction(name, joint, along, at, slip, coulomb, static, radius, length, stribeck, collar, load)
        )
