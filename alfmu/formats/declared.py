"""A linkage as a declaration: bodies in relative coordinates, placed by joints, and joints that close loops.

The frame of each body has the origin of the link's frame in the file, and axes parallel to those of the ground at zero
coordinates, so every joint has one axis, the same on both bodies, and its coordinate is that of the file.
"""

from __future__ import annotations

import functools
import itertools
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..model.errors import DeclarationError, InputError
from ..model.mechanism import Mechanism
from ..model.words import quantity
from .closing import Closed, Loops
from .linkage import (
    ANYWHERE,
    Closure,
    Coupling,
    Frame,
    Joint,
    Link,
    Linkage,
    Motor,
    Sum,
    Tendon,
    Wrench,
    place,
)  # fmt: skip
from .markup import Node
from .poses import Array, Pose, cleaned, of_quaternion, quaternion, vector
from .script import Named, Script, called

_LONGEST = 60
"""Longest name in characters: with suffixes, it fits a line of Python."""

_OPEN = 1e-6
"""Gap of a loop at the start [m, rad] that is reported: positions in files are rounded to some six digits."""

_FAR = 0.05
"""Change of a coordinate due to closing loops [rad, mechanism's size] that causes a warning; some 3 degrees."""

_NAMED = 3
"""Number of coordinates named in the note on open loops."""

_PARALLEL = 1e-14
"""Entry of a rotation matrix up to which frames are parallel: round-off of some successive rotations."""

_RATE = 200.0
"""Natural frequency [rad/s] of a joint's load on its end stop: steps of 1 ms resolve the impact of some 15 ms."""

_SAG, _SAG_M = 0.01, 1e-3
"""Largest static penetration [rad, m] of an end stop under the weight that the joint carries."""

_ONSET, _ONSET_M = 0.01, 1e-3
"""Penetration [rad, m] over which an end stop of a file stiffens."""

_RESTITUTION = 0.3
"""Default restitution of end stops from files, as of an impact on rubber or on a gearbox."""

_CREEP = 0.01
"""Rate [rad/s, m/s] between approach and return at end stops of files."""

_LIGHT = 1e-7
"""Inertia of a link, over the inertia that its parent carries, up to which it counts as a frame without inertia."""

_AVOIDED = {"start", "solver", "monitor", "multiplier", "ground", "time"}
_SUFFIXES = {"rad": "angle", "m": "position"}
_INTEGRALS = {"rad/s": "rad", "m/s": "m", "N": "N.s", "N.m": "N.m.s"}
"""Units of integrals of inputs over time."""

_UNITS = {
    "revolute": ("rad",), "prismatic": ("m",), "screw": ("rad",), "universal": ("rad", "rad"), "spherical": ("1",) * 4,
}  # fmt: skip
_FREEDOMS = {"universal": ("angle1", "angle2")}
_METHODS = {kind: f"spatial_{kind}" for kind in ("revolute", "prismatic", "screw", "weld")}
"""Methods of `Mechanism` whose names differ from the kind of joint."""


def plain_name(name: str) -> str:
    """Return a name reduced to letters, digits and underscores."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", name)[:_LONGEST].strip("_") or "part"
    return plain if re.match(r"[A-Za-z]", plain) else f"n{plain}"


def declared(linkage: Linkage, description: str) -> tuple[Script, dict[str, str], list[str], str]:
    """Return the declaration, changed names by old ones, notes on the start, and a warning."""
    guessed = _Declaring(linkage, description)
    mechanism, notes, warned = guessed.script.mechanism, [], ""
    chosen = {c.name for c in mechanism.coordinates}
    values, spare = guessed.values, dict[str, tuple[str, ...]]()
    if mechanism.closures:
        loose = "gaps" in linkage.leaves
        closed = Loops(mechanism, values, guessed.driven, guessed.given, guessed.limits, loose).close()
        chosen, values, spare = closed.independent, closed.values, closed.spare
        if not chosen:
            notes.append("its closed loops permit no motion here; a redundant constraint or an axis may be misaligned")
            warned = notes[-1]
        if spare:
            why = "at any position" if loose else "as numbers in the file are rounded"
            left = ", ".join(f"{' and '.join(directions)} of {name}" for name, directions in spare.items())
            notes.append(
                "joints of its loops constrain some directions more than once, and agree there only to "
                f"{closed.missed:.1g} m or rad, {why}; these directions are left out: {left}"
            )
            warned = notes[-1] if loose else warned
        if closed.gap > _OPEN:
            notes.append(_moved(mechanism, guessed.values, closed, loose))
            warned = notes[-1] if closed.way > _FAR or closed.left > _OPEN or closed.beyond else warned
    final = _Declaring(linkage, description, chosen, values, spare)
    final.script.mechanism._dropped = False
    return final.script, final.renamed, notes, warned


def _moved(mechanism: Mechanism, given: Mapping[str, float], closed: Closed, loose: bool) -> str:
    """Return how far closing the loops moved coordinates, as text."""
    said = f"its loops are open by up to {closed.gap:.2g} m or rad in the file"
    if closed.left > _OPEN:
        said += f", and were not closed: the nearest position leaves {closed.left:.2g} m or rad"
        remedy = "; --option leave=gaps leaves out directions of loops that other joints suppress with a gap"
        return said + remedy * (not loose)
    units = {c.name: c.unit for c in mechanism.coordinates}
    changes = {name: abs(value - given[name]) for name, value in closed.values.items()}
    most = sorted((name for name, x in changes.items() if x > _OPEN), key=lambda name: -changes[name])
    parts = [f"{name} by {quantity(closed.values[name] - given[name], units[name])}" for name in most[:_NAMED]]
    more = f" and {len(most) - _NAMED} more by less" * (len(most) > _NAMED)
    said += f"; closing them moved {', '.join(parts)}{more}" if parts else "; they are closed at the start"
    if closed.beyond:
        said += f"; {', '.join(closed.beyond)} then exceed their limits"
    return said


class _Declaring:
    """One pass: it declares guesses for all coordinates, or independent coordinates at closed loops."""

    def __init__(
        self,
        linkage: Linkage,
        description: str,
        chosen: set[str] | None = None,
        closed: Mapping[str, float] | None = None,
        spare: Mapping[str, tuple[str, ...]] | None = None,
    ):
        self.linkage, self.chosen, self.closed, self.spare = linkage, chosen, closed or {}, spare or {}
        self.given: set[str] = set()
        self.limits: dict[str, tuple[float, float]] = {}
        self.taken, self.renamed = set(_AVOIDED), dict[str, str]()
        self.values: dict[str, float] = {}
        self.coordinates: dict[Joint, list[Named]] = {}
        self.made: dict[Joint, Named] = {}
        self.bodies: dict[Link | None, Named] = {}
        self.origins: dict[Link | None, Array] = {None: np.zeros(3)}
        self.zeros: dict[Link, Pose] = {}
        self.parents = {joint: link.parent for link in linkage.links for joint in link.joints}
        self.drivable: set[Joint] = {joint for motor in linkage.motors for joint, _ in motor.along}
        self.script = Script(plain_name(linkage.name), description)
        self.bodies[None] = self.script.ground
        with self._of(linkage.node):
            self.script.do("gravity", *linkage.gravity)
        for link in linkage.links:
            self._link(link)
        for closure in linkage.closures:
            with self._of(closure.joint.node):
                self._closure(closure)
        for coupling in linkage.couplings:
            with self._of(coupling.node):
                self._coupling(coupling)
        for tendon in linkage.tendons:
            with self._of(tendon.node):
                self._tendon(tendon)
        if linkage.motors:
            self.script.remark("Motors")
        efforts: dict[Joint, list[Named]] = {}
        for motor in linkage.motors:
            with self._of(motor.node):
                self._motor(motor, efforts)
        for joint, given in efforts.items():
            effort = functools.reduce(operator.add, given)
            with self._of(joint.node):
                self.script.do("drive", self.made[joint], effort.limited(*joint.effort) if joint.effort else effort)

    @property
    def driven(self) -> list[str]:
        """Return names of coordinates with motors."""
        return [str(c.value.name()) for joint in self.drivable for c in self.coordinates.get(joint, ())]

    @contextmanager
    def _of(self, node: Node) -> Iterator[None]:
        """Declare parts of the mechanism for an element of the file, which messages then name."""
        lines = self.script.mechanism._lines
        count = len(lines)
        try:
            yield
        except DeclarationError as error:
            raise InputError(f"{node.where}: {error}") from error
        added = [*itertools.islice(reversed(lines), len(lines) - count)]
        lines |= dict.fromkeys(added, (str(node.file), node.line))

    def _name(self, wanted: str, otherwise: str, companions: Sequence[str] = ()) -> str:
        """Return an unused name: the wanted one, with `otherwise` appended, or with a number."""
        plain = plain_name(wanted)
        beside = ("", *companions)
        tries = itertools.chain(
            (plain, f"{plain}_{otherwise}"), (f"{plain}_{otherwise}{i}" for i in itertools.count(1))
        )
        name = next(name for name in tries if not any(name + each in self.taken for each in beside))
        self.taken.update(name + each for each in beside)
        if name != wanted:
            self.renamed.setdefault(f"{otherwise} {wanted}", name)  # a loop may have the name of a joint
        return name

    def _zero(self, link: Link | None) -> Pose:
        """Return the pose of a link at zero coordinates."""
        return place(link, {}, self.zeros)

    def _point(self, link: Link | None, world: Array) -> list[float]:
        """Return a point given in ground axes at zero coordinates, in the frame of a body."""
        return cleaned(world - self.origins[link]).tolist()

    # Links and their joints -------------------------------------------------------------------------------------

    def _link(self, link: Link) -> None:
        zero = self._zero(link)
        free = any(joint.kind == "free" for joint in link.joints)
        own = ["_x", "_y", "_z", "_e0", "_e1", "_e2", "_e3", "_attitude"] if free else []
        name = self._name(link.name, "body", own)
        self.script.remark(f"{link.node.tag} {' '.join(link.name.split())[:80]}")
        before: Link | None = link.parent
        for j, joint in enumerate(link.joints[:-1]):
            between = Link(f"{name}_{j + 1}", link.node, None, Pose(), link.inertial)
            called = self._name(between.name, "frame")
            with self._of(joint.node):
                pose = link.before(j, {}, self.zeros)
                self.origins[between] = pose.at(joint.point)
                self.bodies[between] = self._frame(called)
                self._joint(joint, before, between, pose)
            before = between
        self.origins[link] = zero.place
        with self._of(link.node):
            self.bodies[link] = self._body(link, name, zero, free)
            if (share := self.linkage.lifted.get(link)) and link.inertial.mass:
                center = cleaned(zero.turn @ link.inertial.center).tolist()
                lift = [-share * link.inertial.mass * g for g in self.linkage.gravity]
                self.script.do("force", self.bodies[link].at(center), *lift)
        if not link.joints:
            at = zero.place
            with self._of(link.node):
                weld = self._name(f"{name}_weld", "joint")
                markers = (self.bodies[b].at(self._point(b, at)) for b in (before, link))
                self.script.do("spatial_weld", weld, *markers)
        elif not free:
            with self._of(link.joints[-1].node):
                self._joint(link.joints[-1], before, link, link.before(len(link.joints) - 1, {}, self.zeros))

    def _frame(self, name: str) -> Named:
        """Return a body without mass."""
        return self.script.do("spatial_body", name, mass=0.0, inertia=(0.0, 0.0, 0.0), relative=True, keep=name)

    def _body(self, link: Link, name: str, zero: Pose, free: bool) -> Named:
        inertial = link.inertial
        center = cleaned(zero.turn @ inertial.center)
        matrix = cleaned(zero.turn @ inertial.inertia @ zero.turn.T)
        matrix = (matrix + matrix.T) / 2
        moments = np.diag(matrix)
        plain = not np.any(matrix - np.diag(moments))
        given = {"mass": _rounded(inertial.mass), "inertia": tuple(moments.tolist()) if plain else matrix.tolist()}
        if center.any():
            given["center"] = tuple(center.tolist())
        if not free:
            return self.script.do("spatial_body", name, **given, relative=True, keep=name)
        joint = next(joint for joint in link.joints if joint.kind == "free")
        start = Pose(vector(joint.start[:3]), of_quaternion(joint.start[3:]))
        turn = start.turn @ zero.turn.T
        e = quaternion(turn)
        velocity, spin = vector(joint.rates[:3]), start.turn @ vector(joint.rates[3:])
        arm = turn @ center
        entries = zip(
            (*(f"{name}_{axis}" for axis in "xyz"), *(f"{name}_e{i}" for i in range(4))),
            (*cleaned(start.place + arm).tolist(), *cleaned(e).tolist()),
            (*(velocity + np.cross(spin, arm)).tolist(), *_quaternion_rate(e, spin).tolist()),
            ("m",) * 3 + ("1",) * 4,
            strict=True,
        )
        values = [self._started(*entry) for entry in entries]
        return self.script.do(
            "spatial_body", name, **given, position=tuple(values[:3]), attitude=tuple(values[3:]), keep=name
        )

    def _started(self, name: str, value: float, rate: float, unit: str) -> Named | float:
        """Return the start of a coordinate of a body: a start quantity if the coordinate is independent, else a
        number."""
        self.values[name] = value = self.closed.get(name, value)
        self.given.add(name)
        if self.chosen is None or name not in self.chosen:
            return _rounded(value)
        speed = {"rate": _rounded(rate)} if rate else {}
        return self.script.do("start", name, value, unit, **speed, keep=f"{name}_start")

    def _coordinate(self, name: str, unit: str, value: float, rate: float) -> Named:
        self.values[name] = value = _rounded(self.closed.get(name, value))
        given: dict[str, float | bool] = {"start": value}
        if self.chosen is not None and name in self.chosen:
            given |= {"rate": _rounded(rate), "independent": True} if rate else {"independent": True}
        return self.script.do("coordinate", name, unit, **given, keep=name)

    def _joint(self, joint: Joint, first: Link | None, second: Link, pose: Pose) -> None:
        """Declare a joint that places a body; `pose` is the pose of the link before it."""
        units = _UNITS[joint.kind]
        words = [f"_{_SUFFIXES.get(x, x)}{i + 1 if len(units) > 1 else ''}" for i, x in enumerate(units)]
        if joint.kind == "spherical":
            words = [f"_e{i}" for i in range(4)]
        name = self._name(joint.name, "joint", ["_attitude", *words])
        axes = [cleaned(pose.turn @ (axis / np.linalg.norm(axis))) for axis in joint.axes]
        start, rates = joint.start, joint.rates
        if joint.kind == "spherical":
            e = vector((joint.start[0], *(pose.turn @ vector(joint.start[1:]))))
            e = e / np.linalg.norm(e)
            spin = pose.turn @ of_quaternion(joint.start) @ vector(joint.rates if len(joint.rates) == 3 else (0.0,) * 3)
            start, rates = tuple(e.tolist()), tuple(_quaternion_rate(e, spin).tolist())
        if joint.follows is not None:
            other, factor, offset = joint.follows
            expression = self.coordinates[other][0] if factor == 1 else factor * self.coordinates[other][0]
            coordinates = [expression + offset if offset else expression]
        else:
            names = [f"{name}{word}" for word in words]
            if self.linkage.inside and joint.limits:
                start = tuple(min(max(x, low), high) for x, (low, high) in zip(start, joint.limits, strict=True))
            coordinates = [self._coordinate(*x) for x in zip(names, units, start, rates, strict=True)]
            self.limits |= dict(zip(names, joint.limits, strict=False))
            if self.linkage.posed:
                self.given.update(names)
        self.coordinates[joint] = coordinates
        at = pose.at(joint.point)
        markers = [self.bodies[b].at(self._point(b, at)) for b in (first, second)]
        given = dict[str, Any](zip(("axis", "second_axis"), (tuple(x.tolist()) for x in axes), strict=False))
        if joint.kind == "screw":
            given["lead"] = joint.lead
        given |= {"coordinate": coordinates[0]} if len(units) == 1 else {"coordinates": tuple(coordinates)}
        stopped = self.linkage.stops and self.chosen is not None and joint.follows is None and joint.limits
        uses = any(map(any, (joint.damping, joint.stiffness, joint.friction))) or joint in self.drivable or stopped
        keep = name if uses and joint.kind != "spherical" else ""
        made = self.script.do(_METHODS.get(joint.kind, joint.kind), name, *markers, **given, keep=keep)
        self.made[joint] = made
        if joint.kind == "spherical":
            for each in coordinates:
                # Rates of unit Euler parameters have half the magnitude of the angular velocity.
                if joint.damping[0]:
                    self.script.do("generalized_force", each, (-4 * joint.damping[0]) * self.script.rate(each))
                if joint.armature:
                    self.script.do("kinetic_energy", (2 * joint.armature) * self.script.rate(each) ** 2)
            return
        self._spring(joint, made)
        if joint.armature:
            self.script.do("kinetic_energy", (joint.armature / 2) * self.script.rate(coordinates[0]) ** 2)
        if stopped:
            for i, limits in enumerate(joint.limits):
                which = made.freedom(_FREEDOMS[joint.kind][i]) if joint.kind in _FREEDOMS else made
                value, stiffness = self.values[f"{name}{words[i]}"], self._stiffness(joint, i)
                self._stop(f"{name}_stop{i + 1 if i else ''}", joint.node, which, limits, value, units[i], stiffness)

    def _value(self, joint: Joint) -> float:
        """Return the start value of a joint with one coordinate."""
        if joint.follows is not None:
            other, factor, offset = joint.follows
            return factor * self._value(other) + offset
        return self.values[str(self.coordinates[joint][0].value.name())]

    def _stiffness(self, joint: Joint, which: int = 0) -> float:
        """Return the stiffness of an end stop, from the inertia and weight that the joint carries, or if there is none,
        that the joints before it carry."""
        M, momenta, columns = self.linkage.masses
        at = columns[joint][which]
        parent = self.parents[joint]
        while parent is not None:
            for each in parent.joints:
                if each.kind == joint.kind and M[at, at] <= _LIGHT * M[columns[each][0], columns[each][0]]:
                    at = columns[each][0]
            parent = parent.parent
        inertia, lever = M[at, at], float(np.linalg.norm(momenta[:, at]))
        sag = _SAG_M if joint.kind == "prismatic" else _SAG
        found = max(inertia * _RATE**2, lever * float(np.linalg.norm(self.linkage.gravity)) / sag)
        return float(f"{found or 1.0:.3g}")

    def _stop(
        self, name: str, node: Node, of: Named, limits: tuple[float, float], value: float, unit: str, stiffness: float
    ) -> None:
        """Declare an end stop, unless the start is beyond it."""
        onset = _ONSET if unit == "rad" else _ONSET_M
        given: dict[str, Any] = {}
        given |= {which: x for which, x in zip(("lower", "upper"), limits, strict=True) if abs(x) < ANYWHERE}
        if not limits[0] - onset <= value <= limits[1] + onset:
            inside = "" if self.linkage.inside else "; --option limits=inside starts within them"
            self.linkage.warn(f"limits that the start exceeds{inside}", node)
        elif given:
            if limits[1] - limits[0] < onset:
                what = "joints that their limits hold nearly still, so that runs take long; make them fixed in the file"
                self.linkage.note(f"{what}, or leave limits out by --option limits=ignore", node)
            self.script.do(
                "end_stop", self._name(name, "stop", (".penetration",)), of, **given, stiffness=stiffness, onset=onset,
                restitution=_RESTITUTION, creep=_CREEP, unit=unit,
            )  # fmt: skip

    def _spring(self, joint: Joint, made: Named) -> None:
        freedoms = _FREEDOMS.get(joint.kind, ("",))
        for which, k, d, rest in zip(freedoms, joint.stiffness, joint.damping, joint.rest, strict=False):
            numbers: dict[str, Any] = {"stiffness": k, "damping": d, "rest": rest if k else 0.0}
            if any(numbers.values()):
                of = made.freedom(which) if which else made
                self.script.do("spring_damper", of, **{name: x for name, x in numbers.items() if x})
        if joint.friction[0]:
            self.script.do("friction", made, coulomb=1.0, load=joint.friction[0])

    # Closures of loops ------------------------------------------------------------------------------------------

    def _closure(self, closure: Closure) -> None:
        (first, frame1), (second, frame2) = closure.first, closure.second
        joint, axes = closure.joint, closure.joint.axes
        if second is None:
            # Free motions of this body relative to the other have the same values, about opposite axes.
            (first, frame1), (second, frame2) = (second, frame2), (first, frame1)
            axes = tuple(-axis for axis in reversed(axes))
        if first is second:
            joint.node.fail("it joins a body to itself; name two bodies")
        self.script.remark(f"{joint.node.tag} that closes a loop")
        zero1, zero2 = self._zero(first) @ frame1, self._zero(second) @ frame2
        name = self._name(joint.name, "joint", ["_frame"])
        markers = [self.bodies[b].at(self._point(b, zero.place)) for b, zero in ((first, zero1), (second, zero2))]
        apart = cleaned(zero1.turn @ zero2.turn.T)
        differ = float(np.abs(apart - np.eye(3)).max()) > _PARALLEL
        if differ and joint.kind in ("weld", "prismatic", "universal", "screw"):
            markers[0] = self._turned(f"{name}_frame", markers[0], quaternion(zero1.turn @ zero2.turn.T))
            zero1, differ = zero2, False
        given: dict[str, Any] = {}
        if axes:
            both = ((zero1, axes[0]), (zero2, axes[-1]))
            one, two = (cleaned(zero.turn @ (x / np.linalg.norm(x))).tolist() for zero, x in both)
            given["axis"] = tuple(one)
            if joint.kind == "universal" or differ:
                given["second_axis"] = tuple(two)
        if any(joint.stiffness) and differ and joint.kind == "revolute":
            what = "its spring has no force where its two frames coincide, which they do not at zero"
            joint.node.fail(f"{what}; give both frames the same directions there")
        if joint.kind == "screw":
            given["lead"] = joint.lead
        springs = any(map(any, (joint.damping, joint.stiffness, joint.friction)))
        method = _METHODS.get(joint.kind, joint.kind)
        made = self.script.do(method, name, *markers, **given, keep=name if springs else "")
        if name in self.spare:
            self.script.do("spare", name, *self.spare[name])
        self._spring(joint, made)

    def _turned(self, name: str, marker: Named, e: Array) -> Named:
        """Return a massless frame at a point of a body, with a constant rotation."""
        self.taken.add(f"{name}_turn")
        frame = self._frame(name)
        angle = 2 * float(np.arctan2(np.linalg.norm(e[1:]), e[0]))
        axis = tuple(cleaned(e[1:] / np.linalg.norm(e[1:])).tolist())
        origin = frame.at((0.0, 0.0, 0.0))
        self.script.do("spatial_revolute", f"{name}_turn", marker, origin, axis=axis, coordinate=angle)
        return origin

    def _along(self, terms: Sum, referred: bool = False, rates: bool = False) -> Named:
        """Return a sum of coordinates, counted from the joints' references if `referred`, or the sum of their rates."""
        found = []
        for joint, factor in terms:
            each = self.coordinates[joint][0]
            if rates:
                each = self.script.rate(each)
            elif referred and joint.reference:
                each = each - joint.reference
            found.append(each if factor == 1 else factor * each)
        return functools.reduce(operator.add, found)

    def _coupling(self, coupling: Coupling) -> None:
        found = self._along(coupling.of, True)
        if coupling.coefficients[0]:
            found = found - coupling.coefficients[0]
        if coupling.by:
            x = self._along(coupling.by, True)
            for power, factor in enumerate(coupling.coefficients[1:], 1):
                if factor:
                    found = found - factor * (x if power == 1 else x**power)
        name = self._name(coupling.name, "coupling")
        self.script.do("constraint", name, found, "m" if coupling.of[0][0].kind == "prismatic" else "rad")

    def _tendon(self, tendon: Tendon) -> None:
        length, rate = self._along(tendon.along), self._along(tendon.along, rates=True)
        low, high = tendon.rest
        if tendon.stiffness:
            stretch = length - low if low == high else length - length.limited(low, high)
            self.script.do("potential_energy", (tendon.stiffness / 2) * (stretch if low or high else length) ** 2)
        for joint, factor in tendon.along if tendon.damping else ():
            self.script.do("generalized_force", self.coordinates[joint][0], (-tendon.damping * factor) * rate)
        if tendon.armature:
            self.script.do("kinetic_energy", (tendon.armature / 2) * rate**2)
        if tendon.limits and self.linkage.stops and self.chosen is not None:
            unit = "m" if tendon.along[0][0].kind == "prismatic" else "rad"
            value = sum(factor * self._value(joint) for joint, factor in tendon.along)
            stiffness = max(self._stiffness(joint) / max(factor**2, _LIGHT) for joint, factor in tendon.along)
            self._stop(tendon.name, tendon.node, length, tendon.limits, value, unit, float(f"{stiffness:.3g}"))

    def _motor(self, motor: Motor, efforts: dict[Joint, list[Named]]) -> None:
        name = self._name(motor.name, "motor")
        u = self.script.do("input", name, motor.unit, **({"start": motor.start} if motor.start else {}), keep=name)
        if motor.control is not None:
            u = u.limited(*motor.control)
        if motor.lag or motor.integrates:
            state = self._name(f"{name}_state", "state", (".start",))
            begun = motor.start if motor.begun is None and not motor.integrates else motor.begun or 0.0
            unit = _INTEGRALS.get(motor.unit, "s") if motor.integrates else motor.unit
            x = self.script.do("state", state, unit, start=begun, keep=state)
            speed = u if motor.integrates else (1 / motor.lag) * (u - x)
            if motor.state is not None:  # the state stays at a limit while its rate leads beyond
                low, high = motor.state
                falls, rises = called("fmin", speed, 0.0), called("fmax", speed, 0.0)
                speed = called("if_else", x > low, falls, 0.0) + called("if_else", x < high, rises, 0.0)
            self.script.do("derivative", x, speed)
            u = x
        along, forces = self._ways(motor, name)

        def fed(length: float, rate: float) -> list[Named]:
            """Return the feedback of length and rate."""
            return [(size * motor.gear) * along(rates) for size, rates in ((length, False), (rate, True)) if size]

        effort = u if motor.gain == 1 else motor.gain * u
        if slopes := fed(*motor.slopes):
            effort = functools.reduce(operator.add, slopes, motor.gain) * u
        constant, length, rate = motor.bias
        if motor.ratio:
            mass = self.linkage.mass_along(motor.along) / motor.gear**2
            rate -= 2 * motor.ratio * float(np.sqrt(motor.gain * mass))
        effort = functools.reduce(operator.add, fed(length, rate), effort)
        if constant:
            effort = effort + constant
        if motor.force is not None:
            effort = effort.limited(*motor.force)
        for joint, factor in motor.along:
            share = motor.gear * factor
            efforts.setdefault(joint, []).append(effort if share == 1 else share * effort)
        if forces:
            effort = self.script.let(
                self._name(f"{name}_effort", "effort"), effort if motor.gear == 1 else motor.gear * effort
            )
        for end, force, torque in forces:
            if end[0] is None:
                continue
            if force is not None:
                parts = [force[i] * effort for i in range(3)]
                self.script.do("force", self._marker(end), *parts)
            if torque is not None:
                self.script.do("torque", self.bodies[end[0]], torque * effort)

    def _marker(self, frame: Frame) -> Named:
        """Return the origin of a frame as a point of a body."""
        return self.bodies[frame[0]].at(self._point(frame[0], self._zero(frame[0]).at(frame[1].place)))

    def _turned_by(self, frame: Frame, vector: Array) -> Named:
        """Convert a vector from the axes of a frame to those of the ground."""
        return self.bodies[frame[0]].turned(cleaned(self._zero(frame[0]).turn @ frame[1].turn @ vector).tolist())

    def _ways(
        self, motor: Motor, name: str
    ) -> tuple[Callable[[bool], Named], list[tuple[Frame, Named | None, Named | None]]]:
        """Return a function for the length of a motor or its rate, and forces and torques at frames per effort."""
        across = motor.across
        if across is None:
            return lambda rates: self._along(motor.along, rates=rates), []

        def let(what: str, value: Named) -> Named:
            return self.script.let(self._name(f"{name}_{what}", what), value)

        if isinstance(across, Wrench):
            axes, carrier = across.against or across.on, across.carrier
            way, turn = (
                let(what, self._turned_by(axes, x)) if x.any() else None
                for what, x in (("direction", across.force), ("axis", across.torque))
            )
            apart, forces = self._marker(across.on).place, [(across.on, way, turn)]
            if across.against is not None:
                apart = apart - self._marker(across.against).place
                forces.append((across.against, way and -way, turn and -turn))
            if carrier is not None and way is not None:
                forces.append(((carrier, Pose()), None, called("cross", way, apart)))

            def along(rates: bool) -> Named:
                assert way is not None
                parts = way, apart
                if carrier is not None:
                    parts = self.bodies[carrier].seen(way), self.bodies[carrier].seen(apart)
                moves = [self.script.rate(parts[1][i]) for i in range(3)] if rates else []
                return called("dot", parts[0], called("vertcat", *moves) if rates else parts[1])

            return along, forces
        pin, guide = self._marker(across.pin), self._marker(across.guide)
        axis = let("axis", self._turned_by(across.guide, np.array((0.0, 0.0, 1.0))))
        way = let("way", pin.place - guide.place)
        foot = let("foot", called("dot", axis, way))
        square = let("square", foot**2 - called("sumsqr", way) + across.rod**2)
        root = called("sqrt", called("fmax", square, 1e-30 * across.rod**2))
        slope = let("slope", called("if_else", square > 0.0, 1.0 / root, 0.0))
        share = let("share", -(foot * slope) + 1.0)
        force = let("force", share * axis + slope * way)
        couple = let("couple", share * called("cross", axis, way))
        length = let("length", foot - root)
        forces = [(across.pin, force, None), (across.guide, -force, couple)]
        return lambda rates: self.script.rate(length) if rates else length, forces


def _quaternion_rate(e: Array, spin: Array) -> Array:
    """Return rates of Euler parameters (4,) at an angular velocity (3,) in body axes."""
    w, p = e[0], e[1:]
    return 0.5 * np.array([-p @ spin, *(w * spin + np.cross(spin, p))])


def _rounded(value: float) -> float:
    return float(f"{value:.15g}")
