"""Calls that couple bodies without a joint: gears, belts, racks, rolling, cams, blades."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca

from .calls import declares
from .cams import Cam, Profile, check_follower, curve
from .declaration import Declaration
from .errors import DeclarationError
from .joints import Joints
from .parts import Body, Joint, Marker, Scalar, stack
from .relations import Belt, Blade, Gear, Rack, Rolling, SpatialRolling, Way, direction
from .spatial import SpatialMarker, right_handed
from .words import in_words, quantity, shown

INVOLUTE = math.radians(20)
"""Default pressure angle of gears [rad], from ISO 53."""

_FIT = 1e-6
"""Largest error of pitch radii relative to the distance of the centres [1]: numbers are typed with six digits."""

_SAME = 1e-9
"""Distance [m] up to which two points of a body count as the same point."""


@declares
class Couplings(Joints):
    """A declaration with the calls for relations between bodies."""

    # Relations between bodies -----------------------------------------------------------------------------------

    def gear(
        self,
        name: str,
        first: Marker,
        second: Marker,
        *,
        radii: Sequence[Scalar] | None = None,
        teeth: Sequence[int] | None = None,
        internal: bool = False,
        phase: Scalar = 0.0,
        pressure_angle: Scalar | None = None,
        carrier: Body | None = None,
    ) -> Gear:
        """Add two gears in mesh, given by the markers of their centres; the ground or a moving carrier holds both.

        Hinges declared before hold the centres and determine the carrier, unless `carrier` names it. Give either
        `radii`, the pitch radii of both [m], or `teeth`, their numbers of teeth. With `internal` the larger of the two
        is a ring with teeth inside. `phase` is the angle [rad] of the second gear from the carrier when that of the
        first is zero. `pressure_angle` [rad] is 20 degrees by default, 0 for discs that roll on each other: it does not
        affect the motion, only the force that separates the bearings.

        Outputs: `<name>.force` [N] at the pitch circles, positive if it turns the second gear counter-clockwise, and
        `<name>.separating_force` [N] across them. Raises DeclarationError if hinges or radii do not fit.
        """
        what = f"gear {name}"
        self._own((first, second), what, Marker)
        if carrier is not None:
            self._body(carrier, what)
        carrier, ways, across, distance, _ = _centres(self, what, first, second, carrier)
        apart = self._at_defaults(f"the distance of the centres of {what}", distance)
        if (radii is None) == (teeth is None):
            raise DeclarationError(
                f"{self.name}: {what} has {'neither radii nor' if radii is None else 'both radii and'} teeth; give one "
                "of them"
            )
        if teeth is not None:
            numbers = _both(self, f"the teeth of {what}", teeth)
            if not all(isinstance(z, int) and not isinstance(z, bool) and z > 0 for z in numbers):
                raise DeclarationError(
                    f"{self.name}: the teeth of {what} are {shown(tuple(numbers))}; give two whole numbers"
                )
            first_teeth, second_teeth = numbers
            if internal and first_teeth == second_teeth:
                raise DeclarationError(
                    f"{self.name}: {what} has {first_teeth} teeth inside and outside; the ring needs more"
                )
            sum_of_both = abs(first_teeth - second_teeth) if internal else first_teeth + second_teeth
            own: Sequence[Scalar] = [distance * z / sum_of_both for z in numbers]
        else:
            own, r1, r2 = _rims(self, what, radii)
            wanted = abs(r1 - r2) if internal else r1 + r2
            if abs(wanted - apart) > _FIT * apart:
                sign, how = ("-", "differ by") if internal else ("+", "sum up to")
                raise DeclarationError(
                    f"{self.name}: the pitch radii {r1:g} m and {r2:g} m of {what} {how} {wanted:g} m, and its centres "
                    f"are {apart:g} m apart on {carrier.name}; change the radii (r1 {sign} r2 is the distance), or "
                    "give teeth=, from which they follow"
                )
        angle = _toothed(self, what, INVOLUTE if pressure_angle is None else pressure_angle)
        signed = own[0], -own[1] if internal else own[1]
        phase = self._constant(f"the phase of {what}", phase, "rad")
        sizes = [self._at_defaults(f"a radius of {what}", r) for r in own]
        ring = int(sizes[1] > sizes[0]) if internal else -1
        return self._relate(Gear(name, first, second, carrier, ways, across, distance, signed, phase, angle, ring))

    def belt(
        self,
        name: str,
        first: Marker,
        second: Marker,
        *,
        radii: Sequence[Scalar],
        crossed: bool = False,
        pretension: Scalar = 0.0,
        phase: Scalar = 0.0,
        carrier: Body | None = None,
    ) -> Belt:
        """Add a belt or chain around two pulleys, given by the markers of their centres; it neither slips nor
        stretches.

        Hinges, `carrier` and `phase` are those of `gear`. `radii` [m] are those of the pulleys; if `crossed`, they turn
        in opposite directions. `pretension` [N] is the tension of each strand without load: half of the load is added
        to it in one strand and subtracted from it in the other.

        Outputs: `<name>.force` [N], positive if it turns the second pulley counter-clockwise, `<name>.tension.left` and
        `<name>.tension.right` [N] of the strands that leave the first pulley on the left and right, seen towards the
        second. A negative tension means that the belt is slack. Raises DeclarationError if the belt cannot fit.
        """
        what = f"belt {name}"
        self._own((first, second), what, Marker)
        if carrier is not None:
            self._body(carrier, what)
        carrier, ways, across, distance, start = _centres(self, what, first, second, carrier)
        apart = self._at_defaults(f"the distance of the centres of {what}", distance)
        own, r1, r2 = _rims(self, what, radii)
        if (taken := r1 + r2 if crossed else abs(r1 - r2)) >= apart:
            raise DeclarationError(
                f"{self.name}: no {'crossed ' * crossed}belt fits around the pulleys of {what}: their radii {r1:g} m "
                f"and {r2:g} m take {taken:g} m, and their centres are {apart:g} m apart; make the pulleys smaller or "
                "their distance larger"
            )
        tension = self._constant(f"the pretension of {what}", pretension, "N")
        if (at := self._at_defaults(f"the pretension of {what}", tension)) < 0:
            raise DeclarationError(f"{self.name}: the pretension of {what} is {at:g} N; it must not be negative")
        signed = own[0], own[1] if crossed else -own[1]
        phase = self._constant(f"the phase of {what}", phase, "rad")
        return self._relate(Belt(name, first, second, carrier, ways, across, distance, signed, phase, tension, start))

    def rack(
        self,
        name: str,
        pinion: Marker,
        guide: Joint,
        *,
        radius: Scalar,
        side: str | None = None,
        phase: Scalar = 0.0,
        pressure_angle: Scalar | None = None,
    ) -> Rack:
        """Add a pinion, given by the marker of its centre, and a rack, given by the prismatic joint that guides it.

        A hinge declared before holds the pinion on the first body of the guide; the rack is its second body. `radius`
        [m] is that of the pitch circle. `side` is the side on which the pinion lies, "left" or "right" of the pitch
        line seen along the guide; it may be omitted if the guide itself runs along the pitch line. `phase` is the
        pinion's angle [rad] when the rack is at 0, `pressure_angle` that of `gear`.

        Outputs: `<name>.force` [N] on the rack along the guide, `<name>.separating_force` [N] across it.
        """
        what = f"rack {name}"
        self._own((pinion,), what, Marker)
        self._free(guide, what)
        if guide.kind != "prismatic":
            raise DeclarationError(
                f"{self.name}: {what} needs the guide of the rack, as prismatic() returns it, not {guide.name}"
            )
        carrier = guide.first.body
        if pinion.body in (carrier, guide.second.body):
            raise DeclarationError(
                f"{self.name}: the pinion of {what} is {pinion.body.name}, which {guide.name} joins; give another"
            )
        way, held = _way(self, what, pinion, carrier)
        radius = self._constant_length(f"the radius of {what}", radius)
        if side not in (None, "left", "right"):
            raise DeclarationError(f"{self.name}: the side of {what} is {shown(side)}; give 'left' or 'right'")
        if side is None:
            # The centre from the first marker of the guide, in the axes of the carrier.
            dx, dy = (self._at_defaults(what, b - a) for a, b in ((guide.first.x, held.x), (guide.first.y, held.y)))
            axis, offset = self._at_defaults(what, guide.axis), self._at_defaults(what, guide.offset)
            left, r = math.cos(axis) * dy - math.sin(axis) * dx - offset, self._at_defaults(what, radius)
            if abs(abs(left) - r) > _FIT * r:
                raise DeclarationError(
                    f"{self.name}: {guide.name} passes the centre of {pinion.body.name} at {abs(left):g} m, and the "
                    f"radius of {what} is {r:g} m, so that its side is not known; give side= 'left' or 'right', the "
                    "side of the pitch line on which the pinion lies, seen along the guide"
                )
            side = "left" if left > 0 else "right"
        angle = _toothed(self, what, INVOLUTE if pressure_angle is None else pressure_angle)
        phase = self._constant(f"the phase of {what}", phase, "rad")
        return self._relate(Rack(name, pinion, guide, way, held, radius, 1 if side == "left" else -1, phase, angle))

    def rolling(
        self, name: str, line: Marker, wheel: Marker, *, radius: Scalar, axis: Scalar = 0.0, phase: Scalar = 0.0
    ) -> Rolling:
        """Add a wheel, given by the marker of its centre, that rolls without slip on a line through a marker of another
        body.

        The line has the direction `axis` [rad] in its body, and the wheel of `radius` [m] lies to its left. `phase` is
        the wheel's angle [rad] from the line's body when the wheel stands on the line's marker.

        Outputs: `<name>.normal_force` [N] on the wheel across the line, negative if the wheel would lift off, and
        `<name>.friction_force` [N] along it, which rolling requires.
        """
        what = f"rolling {name}"
        self._own((line, wheel), what, Marker)
        if line.body is wheel.body:
            raise DeclarationError(
                f"{self.name}: {what} rolls {wheel.body.name} on itself; give a line of another body"
            )
        radius = self._constant_length(f"the radius of {what}", radius)
        axis = self._constant(f"the axis of {what}", axis, "rad")
        phase = self._constant(f"the phase of {what}", phase, "rad")
        return self._relate(Rolling(name, line, wheel, direction(axis), radius, phase))

    def cam(
        self,
        name: str,
        cam_centre: Marker,
        follower: Marker,
        *,
        outline: Profile | None = None,
        distance: Profile | None = None,
        roller: Scalar | None = None,
        face: Scalar | None = None,
    ) -> Cam:
        """Add a cam that turns about the marker of its centre, and a follower that stays on it, guided by its own
        joints.

        The follower has a `roller` of that radius [m] about its marker (0: an edge), or a flat `face` through its
        marker: the direction [rad] square to the face in the follower's frame, away from the cam.

        The curve is an `outline`, the cam's radius [m] over the polar angle in its frame, or a `distance` [m] from the
        cam's centre to the roller's centre (the pitch curve), or to the face, over the direction in the cam's frame in
        which the roller lies or the face's normal points. It is a function of the angle from 0 to 2 pi [rad], made of
        CasADi's functions and parameters, or points: (x, y) [m] of an outline, (angle, length) [rad, m] of a distance,
        with a periodic cubic spline through them. An outline adds the coordinate `<name>_contact`, without mass, unless
        the roller is an edge; place the bodies first.

        Outputs: `<name>.force` [N] between both, negative if the follower would lift off, and the place of contact
        `<name>.contact.x`, `.y` [m]. Raises DeclarationError if a curve does not close or the follower does not fit it.
        """
        what = f"cam {name}"
        self._own((cam_centre, follower), what, Marker)
        if cam_centre.body is follower.body:
            raise DeclarationError(
                f"{self.name}: {what} follows {cam_centre.body.name} itself; give a follower on another body"
            )
        if (outline is None) == (distance is None):
            given = "neither an outline nor a distance" if outline is None else "an outline and a distance"
            raise DeclarationError(f"{self.name}: {what} has {given}; give one of them")
        if (roller is None) == (face is None):
            given = "neither a roller nor a face" if roller is None else "a roller and a face"
            raise DeclarationError(
                f"{self.name}: {what} has {given}; give the radius of its roller, 0 for an edge, or its face"
            )
        radius = 0.0
        if roller is not None:
            roller = self._constant(f"the roller of {what}", roller, "m")
            if (radius := self._at_defaults(f"the roller of {what}", roller)) < 0:
                raise DeclarationError(
                    f"{self.name}: the radius of the roller of {what} is {radius:g} m; give 0 or more"
                )
        normal = None
        if face is not None:
            face = self._constant(f"the face of {what}", face, "rad")
            normal = face, *direction(face)
        defaults = stack([x.symbol for x in self.parameters]), ca.DM([x.default for x in self.parameters])
        form = curve(self, what, outline if distance is None else distance, distance is None)
        check_follower(self, what, form.samples(*defaults), distance is None, None if face is not None else radius)
        found = Cam(name, cam_centre, follower, form, 0.0 if roller is None else roller, normal, None)
        if outline is not None and not (roller is not None and ca.SX(roller).is_zero()):
            (x1, y1), (x2, y2) = cam_centre.position, follower.position
            if found.face is not None:
                guess = follower.body.angle + found.face[0] - cam_centre.body.angle
            else:
                guess = ca.atan2(y2 - y1, x2 - x1) - cam_centre.body.angle
            found.contact = self.coordinate(f"{name}_contact", "rad", start=guess)
        return self._relate(found)

    def blade(self, name: str, at: Marker, *, axis: Scalar = 0.0) -> Blade:
        """Add a blade on the ground, or a thin wheel that rolls on it: a point of a body moves along the blade, not
        across.

        `axis` is the direction of the blade [rad] in the body's frame. This constraint is nonholonomic: the body can
        reach any position, and has fewer independent velocities than positions. Start rates must satisfy it, and
        `solver.formulation` is `residual`, `classic` or `penalty`.

        Output `<name>.force` [N] across the blade, from the ground, along its left normal.
        """
        self._own((at,), f"blade {name}", Marker)
        if at.body is self.ground:
            raise DeclarationError(
                f"{self.name}: blade {name} is on the ground, which cannot move; give a point of a body"
            )
        return self._relate(Blade(name, at, direction(self._constant(f"the axis of blade {name}", axis, "rad"))))

    def spatial_rolling(
        self,
        name: str,
        plane: SpatialMarker,
        centre: SpatialMarker,
        *,
        radius: Scalar,
        axis: Sequence[float] | None = None,
        normal: Sequence[float] = (0.0, 0.0, 1.0),
    ) -> SpatialRolling:
        """Add a ball that rolls without slip on a plane, given by the marker of its centre; with `axis`, a thin disc.

        The plane goes through a marker on `spatial_ground`, and `normal` is the direction from it towards the ball.
        `radius` is in m; `axis` is that of the disc in its body's frame. As with `blade`, the constraint on slip is
        nonholonomic: start rates must satisfy it, and formulations are those of a blade.

        Outputs `<name>.force.x` ... [N] on the body from the ground. The contact is two-sided: a normal force may pull.
        """
        self._own((plane, centre), f"rolling {name}", SpatialMarker)
        if plane.body is not self.spatial_ground or centre.body is self.spatial_ground:
            raise DeclarationError(
                f"{self.name}: rolling {name} is on a plane of {plane.body.name} by {centre.body.name}; give a marker "
                "of spatial_ground first, and one of a body"
            )
        radius = self._constant_length(f"the radius of rolling {name}", radius)
        up = self._direction(f"rolling {name}", normal)
        disc = None if axis is None else right_handed(self._direction(f"rolling {name}", axis))[2]
        return self._relate(SpatialRolling(name, plane, centre, radius, disc, right_handed(up)))


def _both(m: Declaration, what: str, values: Any) -> Sequence[Any]:
    if not isinstance(values, Sequence) or isinstance(values, str | bytes) or len(values) != 2:
        raise DeclarationError(f"{m.name}: {what} are {shown(values)}; give two")
    return values


def _toothed(m: Declaration, what: str, pressure_angle: Scalar) -> Scalar:
    """Return a pressure angle that teeth can have."""
    of = f"the pressure angle of {what}"
    angle = m._constant(of, pressure_angle, "rad")
    if not 0 <= (at := m._at_defaults(of, angle)) < math.pi / 2:
        raise DeclarationError(
            f"{m.name}: {of} is {quantity(at, 'rad', 6)}; give one from 0 to below pi/2 (20 degrees are {INVOLUTE:.4f})"
        )
    return angle


def _rims(m: Declaration, what: str, radii: Any) -> tuple[Sequence[Scalar], float, float]:
    """Return two radii, and their values at the defaults of the parameters."""
    given = _both(m, f"the radii of {what}", radii)
    named = [(f"the {which} radius of {what}", r) for which, r in zip(("first", "second"), given, strict=True)]
    own = [m._constant_length(*each) for each in named]
    first, second = (m._at_defaults(of, r) for (of, _), r in zip(named, own, strict=True))
    return own, first, second


def _centres(
    m: Declaration, what: str, first: Marker, second: Marker, carrier: Body | None
) -> tuple[Body, tuple[Way, Way], tuple[Scalar, Scalar], Scalar, Marker]:
    """Return the carrier of two wheels, the path of hinges to each of them, the vector between the centres, its length
    and its start."""
    wheels = (first.body, second.body)
    if wheels[0] is wheels[1]:
        raise DeclarationError(f"{m.name}: {what} joins {wheels[0].name} to itself; give wheels of two bodies")
    reached = [_reached(m, at) for at in (first, second)]
    common = [body for body in reached[0] if body in reached[1] and body not in wheels]
    if carrier is not None:
        if carrier in wheels:
            raise DeclarationError(
                f"{m.name}: the carrier of {what} is {carrier.name}, one of its wheels; leave it out"
            )
        for at, known in zip((first, second), reached, strict=True):
            if carrier not in known:
                raise DeclarationError(_unheld(m, what, at, [carrier.name]))
    elif len(common) != 1:
        if common:
            several = in_words([body.name for body in common])
            raise DeclarationError(
                f"{m.name}: the wheels of {what} have their centres on {several}; say carrier=, which one"
            )
        names = [in_words([body.name for body in known if body not in wheels] or ["nothing"]) for known in reached]
        raise DeclarationError(
            f"{m.name}: {what} finds no body that carries both wheels: hinges hold the centre of {wheels[0].name} on "
            f"{names[0]} and that of {wheels[1].name} on {names[1]}; declare the hinges before, at the centres"
        )
    carrier = carrier or common[0]
    (way1, at1), (way2, at2) = (known[carrier] for known in reached)
    across = at2.x - at1.x, at2.y - at1.y
    apart = math.hypot(*(m._at_defaults(f"the centres of {what}", x) for x in across))
    if apart < _SAME:
        raise DeclarationError(
            f"{m.name}: the centres of {wheels[0].name} and {wheels[1].name} are at one place of {carrier.name}, so "
            f"that {what} cannot join them; check the markers"
        )
    distance = ca.sqrt(across[0] ** 2 + across[1] ** 2) if any(isinstance(x, ca.SX) for x in across) else apart
    return carrier, (way1, way2), across, distance, at1


def _way(m: Declaration, what: str, at: Marker, carrier: Body) -> tuple[Way, Marker]:
    """Return the hinges from a carrier to a centre, and the centre on the carrier."""
    reached = _reached(m, at)
    if carrier not in reached:
        raise DeclarationError(_unheld(m, what, at, [carrier.name]))
    return reached[carrier]


def _unheld(m: Declaration, what: str, at: Marker, carriers: Sequence[str]) -> str:
    return (
        f"{m.name}: no hinge holds the centre of {at.body.name} that {what} uses on {in_words(carriers)}; declare the "
        f"hinge before, with a marker at ({shown_place(at)}) of {at.body.name}"
    )


def shown_place(at: Marker) -> str:
    """Return the place of a marker as messages show it."""
    return ", ".join("..." if isinstance(x, ca.SX) else f"{x:g}" for x in (at.x, at.y))


def _reached(m: Declaration, centre: Marker) -> dict[Body, tuple[Way, Marker]]:
    """Return the bodies that hinges and welds connect to a point, each with the joints from it to the point and its
    marker there."""
    found: dict[Body, tuple[Way, Marker]] = {centre.body: ((), centre)}
    pending = [centre]
    while pending:
        here = pending.pop(0)
        way, _ = found[here.body]
        for joint in m.joints:
            for own, other, sign in ((joint.second, joint.first, 1), (joint.first, joint.second, -1)):
                if (
                    joint.kind in ("revolute", "weld")
                    and own.body is here.body
                    and other.body not in found
                    and _at(own, here)
                ):
                    found[other.body] = ((joint, sign), *way), other
                    pending.append(other)
    return found


def _at(one: Marker, other: Marker) -> bool:
    """Return whether two markers of a body coincide."""
    apart = [ca.SX(a) - ca.SX(b) for a, b in ((one.x, other.x), (one.y, other.y))]
    return all(x.is_zero() or (x.is_constant() and abs(float(x)) < _SAME) for x in apart)
