"""Calls that couple bodies without a joint: gears, belts, racks, rolling, cams, blades."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from .calls import declares
from .cams import Cam, Profile, cam
from .errors import DeclarationError
from .joints import Joints
from .parts import Body, Joint, Marker, Scalar, stack
from .relations import INVOLUTE, Belt, Blade, Gear, Rack, Rolling, SpatialRolling, belt, blade, gear, rack, rolling
from .spatial import SpatialMarker, right_handed

__all__ = ["Couplings"]


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
        self._own((first, second), f"gear {name}", Marker)
        if carrier is not None:
            self._body(carrier, f"gear {name}")
        angle = INVOLUTE if pressure_angle is None else pressure_angle
        return self._relate(gear(self, name, first, second, radii, teeth, internal, phase, angle, carrier))

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
        self._own((first, second), f"belt {name}", Marker)
        if carrier is not None:
            self._body(carrier, f"belt {name}")
        return self._relate(belt(self, name, first, second, radii, crossed, pretension, phase, carrier))

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
        self._own((pinion,), f"rack {name}", Marker)
        self._free(guide, f"rack {name}")
        angle = INVOLUTE if pressure_angle is None else pressure_angle
        return self._relate(rack(self, name, pinion, guide, radius, side, phase, angle))

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
        self._own((line, wheel), f"rolling {name}", Marker)
        return self._relate(rolling(self, name, line, wheel, radius, axis, phase))

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
        defaults = stack([x.symbol for x in self.parameters]), ca.DM([x.default for x in self.parameters])
        found = cam(self, name, cam_centre, follower, outline, distance, roller, face, defaults)
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
        return self._relate(blade(self, name, at, axis))

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
