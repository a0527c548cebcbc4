"""Common representation of the formats: links in a tree, joints that place them, closures of loops, motors.

A link is at `pose` in its parent when each of its joints has its reference value. Its joints act successively on its
frame, about points and axes of that frame: a link with several joints is a chain with massless links.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Never

import numpy as np

from ..model.errors import InputError
from .markup import Node, UnknownName, known
from .poses import Array, Pose, about, of_quaternion, quaternion
from .solids import Inertial, together

ANYWHERE = 1e15
"""Smallest number [rad, m, N.m, N] by which files express that there is no limit."""

MOST_LINKS = 5000
"""Largest number of bodies: 2000 take 4 s beside each other and 5 s in a chain."""

LEAVES = ("actuators", "balls", "flexible", "free", "gaps", "includes", "medium", "shapes", "tendons", "unknown")
"""Kinds of elements that a user may leave out although they affect the motion; `balls`: springs and friction in ball
joints; `free`: resistance in free joints; `gaps`: directions of loops that other joints suppress already, but where
points are apart; `shapes`: those whose mass or inertia is unknown."""

_RANK = 1e-7
"""Singular value of constraints over the largest up to which it counts as zero."""

_PARTICULAR = r"'[^']*'|\"[^\"]*\"|\[[^]]*\]|[-+.\d]+"
"""Parts of a message that differ between refusals of one kind."""

Values = Mapping["Joint", Sequence[float]]
"""Coordinates of joints: an angle [rad] or a position [m], two angles, or four Euler parameters."""


@dataclass(eq=False)
class Joint:
    """A joint with coordinates.

    `kind` is the method of `Mechanism` (revolute, prismatic, screw, universal, spherical), free for a floating link,
    or weld for one without a motion.
    """

    name: str
    kind: str
    node: Node
    point: Array = field(default_factory=lambda: np.zeros(3))
    axes: tuple[Array, ...] = ()
    reference: float = 0.0
    """Value of the coordinate at which the link is at its pose."""
    start: tuple[float, ...] = (0.0,)
    """Start values; of a free link, the position of its frame and the Euler parameters in ground axes."""
    rates: tuple[float, ...] = (0.0,)
    """Start rates; a ball joint has the angular velocity in link axes, a free link its velocity in ground axes before
    that."""
    damping: tuple[float, ...] = (0.0,)
    stiffness: tuple[float, ...] = (0.0,)
    rest: tuple[float, ...] = (0.0,)
    friction: tuple[float, ...] = (0.0,)
    """Dry friction, a constant torque [N.m] or force [N]."""
    effort: tuple[float, float] | None = None
    """Limits of the total effort of all motors on the joint."""
    armature: float = 0.0
    lead: float = 0.0
    follows: tuple[Joint, float, float] | None = None
    """Another joint, a factor and an offset: this joint's coordinate is factor * other + offset."""
    limits: tuple[tuple[float, float], ...] = ()
    """Lower and upper limits of its coordinates, if any: loops are closed within them."""

    def seen_from(self, pose: Pose, sign: float) -> None:
        """Transform point and axes into a frame at a pose; a sign of -1 reverses the joint."""
        if self.kind != "free":
            self.point = pose.inverse.at(self.point)
            self.axes = tuple(sign * pose.turn.T @ axis for axis in self.axes)
        if self.kind == "spherical":
            self.rates = tuple((sign * pose.turn.T @ self.rates).tolist())

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

    def float(self, name: str, node: Node) -> None:
        """Let it move freely from its pose on the ground, by a joint of this name."""
        start = *self.pose.place.tolist(), *quaternion(self.pose.turn).tolist()
        self.joints.append(Joint(name, "free", node, start=start, rates=(0.0,) * 6))


def moving(link: Link | None) -> Link | None:
    """Return the link itself or, if it has no joints, the moving link that carries it; None for the world."""
    while link is not None and not link.joints:
        link = link.parent
    return link


def _moving_links(link: Link | None) -> Iterator[Link]:
    """Yield the moving links that carry a link, the nearest first."""
    while (link := moving(link)) is not None:
        yield link
        link = link.parent


def rank(matrix: Array) -> int:
    """Return the rank of constraints at a position that closes loops to some ten digits."""
    sizes = np.linalg.svd(matrix, compute_uv=False) if matrix.size else np.zeros(0)
    return int(np.sum(sizes > _RANK * sizes.max(initial=0.0)))


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

    Its axes are in the first frame, that of the second link in the second frame.
    """

    joint: Joint
    first: tuple[Link | None, Pose]
    second: tuple[Link | None, Pose]


Sum = tuple[tuple["Joint", float], ...]
"""Joints with one coordinate and factors: the sum of their coordinates, as of a tendon."""


@dataclass(eq=False)
class Coupling:
    """A sum of joint coordinates, from its value at the references, equal to a constant or to a polynomial in another
    sum."""

    name: str
    node: Node
    of: Sum
    by: Sum
    coefficients: Sequence[float]


@dataclass(eq=False)
class Tendon:
    """A spring, a damper and limits along a sum of coordinates; none is active by default."""

    name: str
    node: Node
    along: Sum
    stiffness: float = 0.0
    damping: float = 0.0
    rest: tuple[float, float] = (0.0, 0.0)
    """Ends of the range within which the spring is slack."""
    armature: float = 0.0
    limits: tuple[float, float] | None = None


Frame = tuple[Link | None, Pose]
"""A frame on a link; None is the ground."""


@dataclass(eq=False)
class Wrench:
    """A force and a torque at a frame and in its axes; if there is a frame `against`, they are in the axes of that one,
    act on its link in the opposite direction, and their length is the way from it.

    As in MuJoCo, forces do not turn the link that carries both."""

    on: Frame
    against: Frame | None
    force: Array
    torque: Array

    @property
    def carrier(self) -> Link | None:
        """The last link that moves both frames; None if there is none."""
        if self.against is None:
            return None
        above = [*_moving_links(self.against[0])]
        return next((link for link in _moving_links(self.on[0]) if link in above), None)


@dataclass(eq=False)
class Crank:
    """A rod without mass from a pin to a slider on the z axis of a frame; its length is the way of the slider.

    The slider is at the end nearer to the origin. If the rod is too short to reach the axis, the length is the way to
    the foot of the pin, as in MuJoCo.
    """

    pin: Frame
    guide: Frame
    rod: float


@dataclass(eq=False)
class Motor:
    """An input for an effort along a joint or a sum of coordinates, or between frames: gear * limited(gain * u + bias),
    with lengths and rates scaled by gear."""

    name: str
    node: Node
    along: Sum
    unit: str
    gear: float = 1.0
    gain: float = 1.0
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Constant, per length and per rate of the joint."""
    ratio: float = 0.0
    """Damping ratio, which gives a bias per rate with the inertia at the reference."""
    lag: float = 0.0
    """Time constant [s] of the filter of the input."""
    control: tuple[float, float] | None = None
    force: tuple[float, float] | None = None
    start: float = 0.0
    across: Wrench | Crank | None = None
    """Frames between which it acts instead of along coordinates."""
    slopes: tuple[float, float] = (0.0, 0.0)
    """Gain per length and per rate of the joint."""
    integrates: bool = False
    """Whether a state, the integral of the input, takes the place of the input."""
    state: tuple[float, float] | None = None
    """Limits of the state of a lag or of an integral."""
    begun: float | None = None
    """Start value of that state."""


class LeftOut(InputError):
    """The user leaves this element out."""


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
    tendons: list[Tendon] = field(default_factory=list)
    lifted: dict[Link, float] = field(default_factory=dict)
    """Share of its weight that does not act on a link."""
    stops: bool = True
    """Whether limits of joints are end stops."""
    inside: bool = False
    """Whether joints start within their limits, at the nearest value to that of the file."""
    tuned: list[tuple[Joint, float, float]] = field(default_factory=list)
    """Joints with a time constant and a damping ratio for a spring and a damper."""
    balanced: bool = False
    """Whether moments of inertia that no body has are replaced by their mean."""
    limited: list[Node] = field(default_factory=list)
    """Elements with limits of joints."""
    leaves: Sequence[str] = ()
    """Kinds of elements that the user leaves out although they affect the motion."""
    causes: list[str] = field(default_factory=list)
    """Messages on all refused elements."""
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    left_out: dict[str, list[Node]] = field(default_factory=dict)
    """Ignored elements without effect on the motion, by kind."""
    warned: dict[str, list[Node]] = field(default_factory=dict)
    """Ignored elements that may affect the motion, by kind."""

    doubts: list[tuple[Link, Node, InputError]] = field(default_factory=list)
    """Shapes with an unknown inertia, which is an error only if their link moves."""
    posed: bool = False
    """Whether the file gives every coordinate its value, as a keyframe does."""
    noted: dict[str, list[Node]] = field(default_factory=dict)
    """Elements to which further remarks apply, by remark."""

    def note(self, what: str, *nodes: Node) -> None:
        """Add a further remark."""
        self.noted.setdefault(what, []).extend(nodes)

    def doubt_angles(self, node: Node, *angles: float) -> None:
        """Remark on angles [rad] of more than a turn, and by whole numbers, as degrees are."""
        if any(2 * math.pi < abs(x) < 1e4 and x == round(x) for x in angles):
            self.note("angles of more than a turn, which are radians here; multiply degrees by 0.0174532925", node)

    def leave(self, what: str, *nodes: Node) -> None:
        """Record ignored elements without effect on the motion."""
        self.left_out.setdefault(what, []).extend(nodes)

    def warn(self, what: str, *nodes: Node) -> None:
        """Record ignored elements that may affect the motion."""
        self.warned.setdefault(what, []).extend(nodes)

    def pass_over(self, node: Node, left: Mapping[str, str], *harmless: str) -> None:
        """Record children without effect, and plugins, as ignored; other unread children are refused in the end."""
        for child in node.all(*left):
            self.leave(left[child.tag], child)
        self.warn("plugins, which are programs", *node.all("plugin"))
        node.all(*harmless)

    def every(self, nodes: Iterable[Node], read: Callable[[Node], object]) -> None:
        """Read elements; if one is refused, record the reason and continue with the next."""
        for node in nodes:
            with self.trying(node):
                read(node)

    @contextmanager
    def trying(self, node: Node | None = None) -> Iterator[None]:
        """Store the refusal of an element, to report all together; unread parts of the element are not checked."""
        try:
            yield
        except LeftOut:
            pass
        except InputError as error:
            if node is not None:
                node.take()
            if not (isinstance(error, UnknownName) and self.causes):
                self.causes.append(str(error))

    def refuse(self, part: str, why: str) -> None:
        """Store the refusal of a part of the mechanism that is being exported."""
        self.causes.append(f"{self.name}: {part}: {why}")

    def weigh(self) -> None:
        """Refuse unknown inertias of moving links; refuse moments of inertia that no body has, or replace them by their
        mean; tune springs by inertia."""
        for link in dict.fromkeys(link for link, _, _ in self.doubts if "shapes" in self.leaves):
            alone = all(link not in (x.first[0], x.second[0]) for x in self.closures)
            alone &= all(each.parent is not link for each in self.links)
            if alone and not link.inertial.mass and any(joint.kind == "free" for joint in link.joints):
                link.joints = []
                self.warn("free bodies that this leaves without mass, which are fixed", link.node)
        for link, node, doubt in self.doubts:
            if moving(link) is None:
                self.note("these shapes of fixed bodies have no mass here, as it is not known", node)
            elif "shapes" in self.leaves:
                self.warn("shapes, whose mass is unknown, left out by option", node)
            elif str(doubt) not in self.causes:
                self.causes.append(f"{doubt}; --option leave=shapes leaves its mass out")
        for joint in self.joints:
            if joint.kind == "revolute":
                self.doubt_angles(joint.node, *(x for ends in joint.limits for x in ends))
        if len(self.links) > MOST_LINKS:
            self.node.fail(f"it has {len(self.links)} bodies; alfmu takes {MOST_LINKS}")
        for link in self.links:
            moments = np.linalg.eigvalsh(link.inertial.inertia)
            tiny = 1e-12 * np.abs(moments).max()
            if moments[0] >= -tiny and 2 * moments[2] <= moments.sum() + tiny:
                continue
            if self.balanced and moments[0] > 0:
                link.inertial = replace(link.inertial, inertia=moments.mean() * np.eye(3))
                self.note("moments of inertia that no body has are replaced by their mean", link.node)
                continue
            what = "no body has a negative one, or one above the sum of the others"
            mean = "; --option inertia=mean takes their mean" if moments[0] > 0 else ""
            shorter = ", ".join(f"{x:.6g}" for x in moments)
            where = link.node.where
            self.causes.append(f"{where}: its principal moments of inertia are [{shorter}] kg.m2; {what}{mean}")
        if self.causes:
            return
        self._check_moving()
        for joint, time, ratio in self.tuned:
            inertia = self.mass_along(((joint, 1.0),))
            joint.stiffness, joint.damping = (inertia / (time * ratio) ** 2,), (2 * inertia / time,)

    def _check_moving(self) -> None:
        """Tell of joints that move no mass, and that nothing else moves."""
        M, _, columns = self.masses
        ends = [link for closure in self.closures for link, _ in (closure.first, closure.second)]
        bound = [joint for each in self.couplings for joint, _ in (*each.of, *each.by)]
        bound += [joint for tendon in self.tendons for joint, _ in tendon.along]
        for joint in columns:
            if joint.follows is not None:
                bound += [joint, joint.follows[0]] if M[columns[joint][0], columns[joint][0]] else [joint]
        held = {k for link in ends for k in self.twists[1][link]} | {k for joint in bound for k in columns[joint]}
        for joint, own in columns.items():
            if any(M[k, k] == 0 and k not in held for k in own):
                what = "joints that move no mass and no inertia, which no loop holds, so that it cannot run"
                self.note(f"{what}; give the links both, or make the joints fixed", joint.node)

    def doubt_limits(self, node: Node, low: float, high: float) -> None:
        """Tell of limits between which there is no motion: they make no stop."""
        if low > high:
            self.warn("limits whose lower one is above the upper one", node)
        elif low == high:
            self.warn("limits that are equal, within which a joint cannot move; make it fixed in the file", node)

    def without(self, word: str, node: Node, why: str) -> None:
        """Refuse an element that affects the motion, or leave it out if `word` is among `leaves`."""
        if word not in self.leaves:
            node.fail(f"{why}; --option leave={word} leaves it out")
        node.take()
        self.warn(f"{word}, left out by option", node)

    def skip(self, word: str, node: Node, why: str) -> Never:
        """Do the same as `without`, and stop reading the element."""
        self.without(word, node, why)
        raise LeftOut(why)

    def judge(self) -> None:
        """Raise InputError with all refusals, the most frequent kind first."""
        kinds: dict[str, list[str]] = {}
        for cause in self.causes:
            why = cause.split(": ", 2)[-1]
            kinds.setdefault(re.sub(_PARTICULAR, "#", why), []).append(cause)
        sorted_kinds = sorted(kinds.values(), key=len, reverse=True)
        said = [x[0] + (f" (and {len(x) - 1} more like it)" if len(x) > 1 else "") for x in sorted_kinds]
        if len(said) == 1:
            raise InputError(said[0])
        if said:
            raise InputError(f"{self.node.file} is refused for {len(said)} reasons:\n" + "\n".join(said))

    @property
    def joints(self) -> list[Joint]:
        return [joint for link in self.links for joint in link.joints]

    @property
    def references(self) -> Values:
        """Return coordinates at which all links are at their poses."""
        return {j: (j.reference,) if len(j.zero) == 1 else j.zero for j in self.joints if j.kind != "free"}

    @cached_property
    def twists(self) -> tuple[Array, dict[Link | None, list[int]], dict[Joint, range]]:
        """Return twists (n, 6), the angular velocity and the velocity at the ground's origin per unit of each rate, at
        the references; the rates that move each link; and the rates of each joint."""
        found, paths = list[Array](), dict[Link | None, list[int]]({None: []})
        columns, known, references = dict[Joint, range](), dict[Link, Pose](), self.references
        for link in self.links:
            paths[link] = list(paths[link.parent])
            for j, joint in enumerate(link.joints):
                pose = link.before(j, references, known)
                turns = np.array([pose.turn @ axis / np.linalg.norm(axis) for axis in joint.axes] or np.eye(3))
                own = np.hstack((turns, np.cross(pose.at(joint.point), turns) + joint.lead / (2 * np.pi) * turns))
                if joint.kind in ("prismatic", "free"):
                    own = np.hstack((np.zeros_like(turns), turns)) if joint.axes else np.eye(6)
                columns[joint] = range(len(found), len(found) + len(own))
                paths[link] += columns[joint]
                found += list(own)
        return np.array(found).reshape(-1, 6), paths, columns

    @cached_property
    def masses(self) -> tuple[Array, Array, dict[Joint, range]]:
        """Return the mass matrix of the open tree at the references, momenta (3, n) per rate, and columns of joints.

        A diagonal entry is the inertia carried by a joint; the magnitude of its momentum is the carried mass times its
        arm.
        """
        twists, paths, columns = self.twists
        M, momenta = np.diag([j.armature for j in columns for _ in columns[j]]), np.zeros((3, len(twists)))
        known, references, parts = dict[Link, Pose](), self.references, dict[Link | None, list[Inertial]]({None: []})
        for link in self.links:
            x, at = link.inertial, place(link, references, known)
            parts[link] = [Inertial(x.mass, at.at(x.center), at.turn @ x.inertia @ at.turn.T)]
        for link in self.links[::-1]:  # the last first: a joint carries its link and all that follow
            x, path = together(parts[link]), paths[link]
            parts[link.parent].append(x)
            first = len(paths[link.parent])
            spins, moves = np.split(twists[path], 2, axis=1)
            moves = moves + np.cross(spins, x.center)
            rows = x.mass * moves @ moves[first:].T + spins @ x.inertia @ spins[first:].T
            M[np.ix_(path, path[first:])] += rows
            M[np.ix_(path[first:], path[:first])] = rows[:first].T
            momenta[:, path[first:]] = x.mass * moves[first:].T
        return M, momenta, columns

    @property
    def freedoms(self) -> int:
        """Return the number of independent rates at the references, where loops are closed."""
        twists, paths, columns = self.twists
        rows, known = [np.zeros((0, len(twists)))], dict[Link, Pose]()
        for closure in self.closures:
            at = place(closure.first[0], self.references, known) @ closure.first[1]
            apart = np.zeros((6, len(twists)))
            for (link, _), sign in ((closure.first, -1.0), (closure.second, 1.0)):
                spins, ways = np.split(twists[paths[link]], 2, axis=1)
                apart[:, paths[link]] += sign * np.hstack((spins, ways + np.cross(spins, at.place))).T
            axes = [at.turn @ axis for axis in closure.joint.axes] or list(np.eye(3))
            pitch = np.inf if closure.joint.kind == "prismatic" else closure.joint.lead / (2 * np.pi)
            free = [np.append(x, pitch * x) if np.isfinite(pitch) else np.append(0 * x, x) for x in axes]
            kept = np.linalg.svd(free)[2][len(free) :] if closure.joint.kind != "weld" else np.eye(6)
            rows.append(kept @ apart)
        for coupling in self.couplings:
            row = np.zeros((1, len(twists)))
            for joint, factor in (*coupling.of, *((j, -coupling.coefficients[1] * x) for j, x in coupling.by)):
                row[0, columns[joint]] += factor
            rows.append(row)
        return len(twists) - rank(np.vstack(rows))

    def mass_along(self, along: Sum) -> float:
        """Return the mass that an effort along a sum of coordinates accelerates at the references, 1/(J M^-1 J'), where
        loops are open."""
        M, _, columns = self.masses
        J = np.zeros(len(M))
        for joint, factor in along:
            J[columns[joint]] = factor
        return float(1 / (J @ np.linalg.solve(M, J)))

    def drive(self, names: Iterable[str], strict: bool = True) -> None:
        """Add a motor to joints by their names, `all` for every joint with one coordinate; others are refused."""
        able = {j.name: j for j in self.joints if j.kind in ("revolute", "prismatic", "screw") and not j.follows}
        driven = {joint for motor in self.motors for joint, _ in motor.along[:1]}
        for name in able if list(names) == ["all"] else names:
            if strict:
                known(self.node, name, able, "joint to drive")
            if name in able and (joint := able[name]) not in driven:
                unit = "N" if joint.kind == "prismatic" else "N.m"
                self.motors.append(Motor(f"{name}_drive", joint.node, ((joint, 1.0),), unit))
