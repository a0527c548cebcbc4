"""Common representation of the formats: links in a tree, joints that place them, closures of loops, motors.

A link is at `pose` in its parent when each of its joints has its reference value. Its joints act successively on its
frame, about points and axes of that frame: a link with several joints is a chain with massless links.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..model.words import there_is
from .markup import Node
from .poses import Array, Pose, about, of_quaternion
from .solids import Inertial

__all__ = ["Closure", "Coupling", "Joint", "Link", "Linkage", "Motor"]

Values = Mapping["Joint", Sequence[float]]
"""Coordinates of joints: an angle [rad] or a position [m], two angles, or four Euler parameters."""


@dataclass(eq=False)
class Joint:
    """A joint with coordinates.

    `kind` is the method of `Mechanism` (revolute, prismatic, screw, universal, spherical), or free for a floating link.
    """

    name: str
    kind: str
    node: Node
    point: Array = field(default_factory=lambda: np.zeros(3))
    axes: tuple[Array, ...] = ()
    reference: float = 0.0
    """Value at which the link is at its pose."""
    start: tuple[float, ...] = (0.0,)
    """Start values; of a free link, the position of its frame and the Euler parameters in ground axes."""
    rates: tuple[float, ...] = (0.0,)
    """Start rates; a ball joint has the angular velocity in link axes, a free link its velocity in ground axes before
    that."""
    damping: tuple[float, ...] = (0.0,)
    stiffness: tuple[float, ...] = (0.0,)
    rest: tuple[float, ...] = (0.0,)
    armature: float = 0.0
    lead: float = 0.0
    follows: tuple[Joint, float, float] | None = None
    """Another joint, a factor and an offset: its coordinate is factor * other + offset."""
    limits: tuple[tuple[float, float], ...] = ()
    """Lower and upper limits of its coordinates, if any: loops are closed within them."""

    def moved(self, values: Sequence[float]) -> Pose:
        """Return the transformation of the link's frame at given values."""
        value = values[0] - self.reference
        if self.kind in ("revolute", "prismatic", "screw"):
            axis = self.axes[0] / np.linalg.norm(self.axes[0])
            turn = about(axis, value) if self.kind != "prismatic" else np.eye(3)
            way = {"prismatic": value, "screw": self.lead * value / (2 * np.pi)}.get(self.kind, 0.0) * axis
        elif self.kind == "universal":
            turn, way = about(self.axes[0], values[0]) @ about(self.axes[1], values[1]), np.zeros(3)
        else:
            turn, way = of_quaternion(values), np.zeros(3)
        return Pose(self.point + way - turn @ self.point, turn)

    @property
    def zero(self) -> tuple[float, ...]:
        """Return the values at which its coordinates are zero."""
        return {"spherical": (1.0, 0.0, 0.0, 0.0), "universal": (0.0, 0.0)}.get(self.kind, (0.0,))


@dataclass(eq=False)
class Link:
    """A rigid body; `parent` is None on the ground."""

    name: str
    node: Node
    parent: Link | None
    pose: Pose
    inertial: Inertial
    joints: list[Joint] = field(default_factory=list)

    def before(self, j: int, values: Values, known: dict[Link, Pose]) -> Pose:
        """Return the pose of its frame in ground axes after its first j joints."""
        pose = place(self.parent, values, known) @ self.pose
        for joint in self.joints[:j]:
            if joint.kind == "free":
                return Pose(np.array(values[joint][:3]), of_quaternion(values[joint][3:])) if joint in values else pose
            pose = pose @ joint.moved(values.get(joint, joint.zero))
        return pose


def place(link: Link | None, values: Values, known: dict[Link, Pose]) -> Pose:
    """Return the pose of a link in ground axes; `known` caches poses for these values."""
    if link is None:
        return Pose()
    if link not in known:
        known[link] = link.before(len(link.joints), values, known)
    return known[link]


@dataclass(eq=False)
class Closure:
    """A joint that closes a loop, between frames of two links; None is the ground.

    `axes` are in the first frame, that of the second link in the second frame.
    """

    name: str
    kind: str
    node: Node
    first: tuple[Link | None, Pose]
    second: tuple[Link | None, Pose]
    axes: tuple[Array, ...] = ()
    damping: tuple[float, ...] = (0.0,)
    stiffness: tuple[float, ...] = (0.0,)
    rest: tuple[float, ...] = (0.0,)
    lead: float = 0.0


@dataclass(eq=False)
class Coupling:
    """The coordinate of one joint, from its reference, as a constant or a polynomial in that of another."""

    name: str
    node: Node
    of: Joint
    by: Joint | None
    coefficients: Sequence[float]


@dataclass(eq=False)
class Motor:
    """An input for an effort along a joint: gear * limited(gain * u + bias), with lengths and rates scaled by gear."""

    name: str
    node: Node
    joint: Joint
    unit: str
    gear: float = 1.0
    gain: float = 1.0
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant, per length and per rate of the joint."""
    control: tuple[float, float] | None = None
    force: tuple[float, float] | None = None
    start: float = 0.0


@dataclass(eq=False)
class Linkage:
    """The contents of a file. Links are in the order of the tree, parents first."""

    name: str
    format: str
    node: Node
    links: list[Link] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)
    couplings: list[Coupling] = field(default_factory=list)
    motors: list[Motor] = field(default_factory=list)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    left_out: dict[str, list[Node]] = field(default_factory=dict)
    """Ignored elements without effect on the motion, by kind."""
    warned: dict[str, list[Node]] = field(default_factory=dict)
    """Ignored elements that act only if a limit is reached, by kind."""

    posed: bool = False
    """Whether the file gives every coordinate its value, as a keyframe does."""
    noted: dict[str, list[Node]] = field(default_factory=dict)
    """Elements of further remarks, by remark."""

    def note(self, what: str, *nodes: Node) -> None:
        """Add a further remark."""
        self.noted.setdefault(what, []).extend(nodes)

    def leave(self, what: str, *nodes: Node) -> None:
        """Record ignored elements without effect on the motion."""
        self.left_out.setdefault(what, []).extend(nodes)

    def warn(self, what: str, *nodes: Node) -> None:
        """Record ignored elements that may affect the motion."""
        self.warned.setdefault(what, []).extend(nodes)

    @property
    def joints(self) -> list[Joint]:
        return [joint for link in self.links for joint in link.joints]

    @property
    def references(self) -> Values:
        """Return coordinates at which all links are at their poses."""
        return {j: (j.reference,) if len(j.zero) == 1 else j.zero for j in self.joints if j.kind != "free"}

    def drive(self, wanted: str) -> None:
        """Add a motor to joints by their names, `all` for every joint with one coordinate."""
        able = {j.name: j for j in self.joints if j.kind in ("revolute", "prismatic", "screw") and not j.follows}
        driven = {motor.joint for motor in self.motors}
        for name in able if wanted == "all" else [each.strip() for each in wanted.split(",") if each.strip()]:
            if name not in able:
                self.node.fail(f"there is no joint {name!r} to drive; {there_is(name, list(able))}")
            if (joint := able[name]) not in driven:
                unit = "N" if joint.kind == "prismatic" else "N.m"
                self.motors.append(Motor(f"{name}_drive", joint.node, joint, unit))
