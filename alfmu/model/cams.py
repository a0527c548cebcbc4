"""Cams and their followers: curves around a cam, and the constraints of a roller or a flat face on one.

A curve gives a length over a direction in the cam's frame: the radius R(u) of the *outline* at the polar angle u, or
the *distance* D of the follower, of its roller's centre (the pitch curve) or of its face (the support function), over
the direction in which it lies. With the roller's centre at c from the cam's centre and the face's normal m, both in the
cam's frame and in polar form c = d (cos phi, sin phi), m = (cos psi, sin psi), and the face at h = m . c,

    distance, roller    Phi = d - D(phi)                        distance, face      Phi = h - D(psi)
    outline, roller     Phi = n . (c - r) - radius,  t . (c - r)
    outline, face       Phi = h - m . r,  m . r'

with r(u) the point of contact, n and t the normal and the tangent there. An outline takes the place u of the contact as
a coordinate without mass; the multiplier of the second row is zero, as nothing drives the contact along the outline,
and that of the first is the force between cam and follower.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from .declaration import Declaration
from .errors import DeclarationError
from .parts import Marker, Scalar, symbolic
from .relations import Places, Reading, Relation, Rim, circle
from .words import Brief, angle, shown

_LOOK = 720
"""Number of directions at which a curve is checked [1]: two per degree."""

_DRAWN = 120
"""Number of sides of a cam in pictures [1]: three degrees each."""

_CLOSED = 1e-6
"""Largest gap of a curve after one turn, and of its slope per radian, relative to its size [1]."""

_FEWEST = 4
"""Smallest number of points of a curve."""

Profile = Callable[[ca.SX], ca.SX] | Sequence[Sequence[float]] | NDArray[np.float64]
"""A function of an angle [rad] from 0 to 2 pi that returns a length [m], or points."""


@dataclass(frozen=True, eq=False, repr=False)
class Curve(Brief):
    """A length [m] over a direction [rad], of period 2 pi: an expression in `turn`, and its derivatives."""

    turn: ca.SX
    value: ca.SX

    def at(self, turn: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the length [m] in a direction [rad] and its slope [m/rad]."""
        slope = ca.gradient(self.value, self.turn)
        return ca.substitute(self.value, self.turn, turn), ca.substitute(slope, self.turn, turn)

    def samples(self, parameters: ca.SX, values: ca.DM, count: int = _LOOK) -> NDArray[np.float64]:
        """Return directions (count,), and the lengths with their first and second derivatives (4, count)."""
        slope = ca.gradient(self.value, self.turn)
        terms = ca.vertcat(self.turn, self.value, slope, ca.gradient(slope, self.turn))
        look = ca.Function("look", [self.turn, parameters], [terms])
        # Avoid round angles, at which pieces of curves often meet.
        turns = (np.arange(count) + 0.5) * 2 * math.pi / count
        return np.array(look(ca.DM(turns).T, ca.repmat(values, 1, count)))


@dataclass(eq=False, repr=False)
class Cam(Relation):
    """A cam and a follower that stays on it: a `roller` of a radius [m], 0 for an edge, or a flat `face`."""

    kind: ClassVar[str] = "cam"

    first: Marker
    second: Marker
    curve: Curve
    roller: Scalar
    """Its radius [m], zero if there is a face."""
    face: tuple[Scalar, Scalar, Scalar] | None
    """Direction [rad] of the normal in the follower's frame, its cosine and its sine."""
    contact: ca.SX | None
    """Coordinate of the contact's place on an outline; None if the curve is a distance."""

    @property
    def directions(self) -> tuple[str, ...]:  # type: ignore[override]
        """Names of the constraint rows."""
        return ("normal",) if self.contact is None else ("normal", "contact")

    def residual(self, places: Places, direction: str) -> ca.SX:
        seen = self._seen(places)
        if self.face is not None:
            height, lean = seen
            if self.contact is None:
                return height - self.curve.at(lean)[0]
            R, slope = self.curve.at(self.contact)
            c, s = ca.cos(self.contact - lean), ca.sin(self.contact - lean)
            return height - R * c if direction == "normal" else slope * c - R * s
        away, across = seen
        if self.contact is None:
            return ca.sqrt(away**2 + across**2) - self.curve.at(self._polar(places))[0]
        R, slope = self.curve.at(self.contact)
        size, beyond = ca.sqrt(R**2 + slope**2), away - R
        if direction == "normal":
            return (R * beyond - slope * across) / size - self.roller
        return (slope * beyond + R * across) / size

    def readings(self, places: Places, multipliers: dict[str, ca.SX]) -> list[Reading]:
        turn = places.frame(self.first.body).angle
        x0, y0 = places.place(self.first)
        force = -multipliers["normal"]
        if self.contact is not None:
            R, _ = self.curve.at(self.contact)
            x, y = x0 + R * ca.cos(turn + self.contact), y0 + R * ca.sin(turn + self.contact)
        elif self.face is not None:
            _, lean = self._seen(places)
            D, slope = self.curve.at(lean)
            c, s = ca.cos(turn + lean), ca.sin(turn + lean)
            x, y = x0 + D * c - slope * s, y0 + D * s + slope * c
        else:
            polar = self._polar(places)
            D, slope = self.curve.at(polar)
            size = ca.sqrt(D**2 + slope**2)
            force *= size / D
            c, s, back = ca.cos(turn + polar), ca.sin(turn + polar), self.roller / size
            x = x0 + D * c - back * (D * c + slope * s)
            y = y0 + D * s - back * (D * s - slope * c)
        pair = f"on {self.second.body.name} from {self.first.body.name}"
        where = f"place where {self.second.body.name} touches {self.first.body.name}, along {{}}"
        return [
            ("force", force, "N", f"force {pair} normal to the contact, negative where it would lift off"),
            ("contact.x", x, "m", where.format("x")),
            ("contact.y", y, "m", where.format("y")),
        ]

    def rims(self) -> list[Rim]:
        x0, y0, points = self.first.x, self.first.y, []
        for k in range(_DRAWN + 1):
            turn = 2 * math.pi * k / _DRAWN
            (R, slope), c, s = self.curve.at(ca.SX(turn)), math.cos(turn), math.sin(turn)
            if self.contact is None and self.face is not None:
                points.append((x0 + R * c - slope * s, y0 + R * s + slope * c))
            elif self.contact is not None or symbolic(self.roller).is_zero():
                points.append((x0 + R * c, y0 + R * s))
            else:
                back = self.roller / ca.sqrt(R**2 + slope**2)
                points.append((x0 + R * c - back * (R * c + slope * s), y0 + R * s - back * (R * s - slope * c)))
        rims = [Rim(self.first.body, tuple(points), filled=True)]
        if self.face is not None:
            _, mx, my = self.face
            half = 0.6 * self.curve.at(ca.SX(0))[0]
            x, y = self.second.x, self.second.y
            ends = tuple((x - side * half * my, y + side * half * mx) for side in (-1, 1))
            return [*rims, Rim(self.second.body, ends)]
        return rims if symbolic(self.roller).is_zero() else [*rims, circle(self.second, self.roller, spoke=False)]

    def _seen(self, places: Places) -> tuple[ca.SX, ca.SX]:
        """Return, for a face, its distance and the direction of its normal in the cam's frame; for a roller, its centre
        in the axes of the contact, or of the ground if there is no contact coordinate."""
        (x1, y1), (x2, y2) = places.place(self.first), places.place(self.second)
        dx, dy = x2 - x1, y2 - y1
        turn = places.frame(self.first.body).angle
        if self.face is not None:
            angle, c, s = self.face
            follower = places.frame(self.second.body)
            mx, my = follower.turn(c, s)
            return mx * dx + my * dy, follower.angle + angle - turn
        if self.contact is None:
            return dx, dy
        c, s = ca.cos(turn + self.contact), ca.sin(turn + self.contact)
        return c * dx + s * dy, c * dy - s * dx

    def _polar(self, places: Places) -> ca.SX:
        """Return the polar angle of the roller's centre in the cam's frame."""
        dx, dy = self._seen(places)
        return ca.atan2(dy, dx) - places.frame(self.first.body).angle


def curve(m: Declaration, what: str, given: Any, outline: bool) -> Curve:
    """Return a closed curve made from a function or points; raise DeclarationError if it is invalid or does not
    close."""
    which = f"the {'outline' if outline else 'distance'} of {what}"
    turn = ca.SX.sym("turn")
    if callable(given):
        once = turn - 2 * math.pi * ca.floor(turn / (2 * math.pi))
        value = ca.SX(m._constant(which, _of(m, which, given, turn), "m", turn))
        ends = [
            m._at_defaults(which, ca.substitute(x, turn, at))
            for x in (value, ca.gradient(value, turn))
            for at in (0.0, 2 * math.pi)
        ]
        for (begin, end), of in ((ends[:2], "m"), (ends[2:], "m/rad")):
            if abs(end - begin) > _CLOSED * max(abs(ends[0]), abs(ends[1])):
                raise DeclarationError(
                    f"{m.name}: {which} is not closed: it is {begin:.6g} {of} at 0 and {end:.6g} {of} at 2 pi"
                    f"{' in its slope' * (of != 'm')}; make it periodic"
                )
        return Curve(turn, ca.substitute(value, turn, once))
    from scipy.interpolate import CubicSpline  # which takes half a second to import

    turns, lengths = _points(m, which, given, outline)
    spline = CubicSpline(turns, lengths, bc_type="periodic")
    # The first knot is the origin; coefficients of a piece are sums of steps, which keeps the derivatives short.
    inside = turn - turns[0] - 2 * math.pi * ca.floor((turn - turns[0]) / (2 * math.pi))
    knots, pieces = turns[:-1] - turns[0], np.vstack([spline.c, turns[:-1] - turns[0]]).T
    coefficients: list[ca.SX] = [ca.SX(x) for x in pieces[0]]
    for knot, before, after in zip(knots[1:], pieces[:-1], pieces[1:], strict=True):
        past = inside >= knot
        coefficients = [c + past * (y - x) for c, x, y in zip(coefficients, before, after, strict=True)]
    cubic, square, linear, constant, start = coefficients
    along = inside - start
    return Curve(turn, ((cubic * along + square) * along + linear) * along + constant)


def _of(m: Declaration, which: str, given: Callable[[ca.SX], Any], turn: ca.SX) -> Any:
    """Return the user's function evaluated at an angle."""
    try:
        return given(turn)
    except DeclarationError:
        raise
    except Exception as error:
        raise DeclarationError(
            f"{m.name}: {which} is a function that fails for a symbol: {error}; use functions of CasADi in it, such as "
            "ca.sin"
        ) from error


def _points(m: Declaration, which: str, given: Any, outline: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions that rise by one turn, and lengths, from points (x, y) of an outline or pairs (angle,
    length)."""
    form = "(x, y) [m]" if outline else "(angle, length) [rad, m]"
    try:
        points = np.array(given, float)
    except (TypeError, ValueError):
        raise DeclarationError(f"{m.name}: {which} is {shown(given)}; give a function, or points {form}") from None
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < _FEWEST or not np.isfinite(points).all():
        raise DeclarationError(
            f"{m.name}: {which} has the shape {points.shape}; give a function, or {_FEWEST} or more finite points "
            f"{form}"
        )
    if outline:
        points = points[:-1] if np.allclose(points[0], points[-1], rtol=0, atol=1e-12) else points
        lengths = np.hypot(*points.T)
        turns = np.unwrap(np.arctan2(points[:, 1], points[:, 0]))
        if len(turns) > 1 and turns[-1] < turns[0]:
            turns, lengths = (
                np.concatenate([turns[:1], turns[:0:-1] + 2 * math.pi]),
                np.concatenate([lengths[:1], lengths[:0:-1]]),
            )
        around = turns[0] + 2 * math.pi
        if lengths.min() <= 0 or not (np.diff(turns) > 0).all() or not turns[-1] < around:
            raise DeclarationError(
                f"{m.name}: {which} does not go around the cam's centre once, each direction met at one point; give "
                "the points in their order, from the centre"
            )
    else:
        turns, lengths = points.T
        if abs(turns[-1] - turns[0] - 2 * math.pi) < 1e-9:
            if abs(lengths[-1] - lengths[0]) > _CLOSED * np.abs(lengths).max():
                raise DeclarationError(
                    f"{m.name}: {which} is {lengths[0]:g} m at its first point and {lengths[-1]:g} m a turn later; "
                    "make both the same, or leave out the last"
                )
            turns, lengths = turns[:-1], lengths[:-1]
        around = turns[0] + 2 * math.pi
        if not (np.diff(turns) > 0).all() or not turns[-1] < around:
            raise DeclarationError(
                f"{m.name}: the angles of {which} do not rise within one turn; give them in order, in rad"
            )
    return np.append(turns, around), np.append(lengths, lengths[0])


def check_follower(
    m: Declaration, what: str, samples: NDArray[np.float64], outline: bool, roller: float | None
) -> None:
    """Raise DeclarationError if a follower does not fit its curve at the default parameters."""
    turns, lengths, slopes, bends = samples
    if not np.isfinite(samples).all() or lengths.min() <= 0:
        at = int(np.argmin(np.where(np.isfinite(lengths), lengths, -math.inf)))
        raise DeclarationError(
            f"{m.name}: {what} has the {'radius' if outline else 'distance'} {lengths[at]:g} m at {angle(turns[at])}; "
            "it must be above zero all around"
        )
    if roller is None and not outline:
        inner = lengths + bends  # radius of curvature of the outline
        at = int(np.argmin(inner))
        if inner[at] <= 0:
            raise DeclarationError(
                f"{m.name}: no outline lets a flat face move as {what} says: its radius of curvature would be "
                f"{inner[at]:.3g} m at {angle(turns[at])}; enlarge the base circle, or make the law smoother"
            )
        return
    bent = (lengths**2 + 2 * slopes**2 - lengths * bends) / (lengths**2 + slopes**2) ** 1.5
    if roller is None:
        at = int(np.argmin(bent))
        if bent[at] <= 0:
            raise DeclarationError(
                f"{m.name}: the outline of {what} is hollow or straight at {angle(turns[at])}, where a flat face "
                "cannot follow it; make it convex, or take a roller"
            )
    elif roller > 0:
        # A roller outside bridges hollows of the outline; it undercuts bulges of the pitch curve.
        at = int(np.argmin(bent) if outline else np.argmax(bent))
        sharpest = -bent[at] if outline else bent[at]
        if sharpest * roller >= 1:
            where = "the outline has a hollow" if outline else "the pitch curve has a bulge"
            raise DeclarationError(
                f"{m.name}: the roller of {what} has the radius {roller:g} m and {where} of {1 / sharpest:.3g} m at "
                f"{angle(turns[at])}; take a smaller roller, or make the curve smoother"
            )
