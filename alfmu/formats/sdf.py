"""SDF, the format of Gazebo: links with poses, and joints between any two of them, so that loops are joints too.

A tree of joints from the world outwards places the links; each joint to a link that is already placed closes a loop.
Versions from 1.5 on are supported. Rotations are about fixed axes (roll, pitch, yaw).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..model.words import shown
from .linkage import Closure, Joint, Link, Linkage
from .markup import Node, Reading, known, numbers
from .poses import Array, Pose, of_quaternion, quaternion, turned, vector
from .solids import Inertial

__all__ = ["ball_constraint", "joint_closure", "read"]

_KINDS = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "ball": "spherical",
    "universal": "universal",
    "screw": "screw",
    "fixed": "weld",
}
_LATER = (
    "a {} joint does not map; alfmu takes revolute, continuous, prismatic, ball, universal, screw and fixed joints "
    "(make it of these)"
)
_MODEL_HARMLESS = ("allow_auto_disable", "enable_wind", "link", "joint", "frame", "pose", "static", "self_collide")
_LINK_HARMLESS = ("must_be_base_link", "self_collide", "inertial", "pose", "gravity", "enable_wind", "kinematic")
_LEFT = {
    "visual": "visuals",
    "collision": "shapes of collisions",
    "sensor": "sensors",
    "light": "lights",
    "projector": "projectors",
    "audio_sink": "audio",
    "audio_source": "audio",
    "particle_emitter": "particle emitters",
    "battery": "batteries",
    "gripper": "grippers",
}
_WORLD_HARMLESS = {
    "gravity", "model", "physics", "scene", "light", "gui", "plugin", "magnetic_field", "spherical_coordinates",
    "audio", "frame", "atmosphere",
}  # fmt: skip
_PROGRAMS = "plugins, which are programs"
_TWICE = "<{}> stands here a second time; give one"


def read(root: Node, model: str = "", contacts: str = "refuse") -> Linkage:
    """The linkage of a model in an SDF file; see `imported` for the options."""
    return _File(root, model, contacts).linkage


def child_text(node: Node, tag: str, default: str | None = None) -> str:
    """Return the text of a child."""
    child = node.one(tag)
    if child is None:
        if default is None:
            node.fail(f"it has no <{tag}>; give one")
        return default
    return child.text.strip()


def number(node: Node, tag: str, default: float) -> float:
    """Return the number in a child."""
    child = node.one(tag)
    return default if child is None else numbers(child, f"<{tag}>", child.text, 1)[0]


def flag(node: Node, tag: str, default: bool) -> bool:
    """Return a Boolean, true or false, in a child."""
    said = child_text(node, tag, str(default)).lower()
    if said not in ("true", "1", "false", "0"):
        node.fail(f"<{tag}> is {shown(said[:40])}; give true or false")
    return said in ("true", "1")


class _File:
    def __init__(self, root: Node, model: str, contacts: str):
        version = Reading(root).text("version")
        try:
            self.version = tuple(int(part) for part in version.split("."))
        except ValueError:
            root.fail(f"its version is {shown(version[:40])}; give a number such as 1.9")
        if self.version < (1, 5):
            root.fail(f"version {version} does not say where axes point as later ones do; alfmu reads 1.5 and later")
        worlds = root.all("world")
        if len(worlds) > 1:
            worlds[1].fail(_TWICE.format("world"))
        world = worlds[0] if worlds else None
        models = root.all("model") + (world.all("model") if world else [])
        chosen = self._chosen(root, models, model)
        self.linkage = Linkage(Reading(chosen).text("name"), "SDF", chosen)
        self.linkage.gravity = (0.0, 0.0, -9.8)
        if world is not None:
            self._world(world)
        self.model = chosen
        if contacts == "refuse":
            self._contacts(models)
        self.linkage.leave("other models", *(each for each in models if each is not chosen))
        self._model()

    def _chosen(self, root: Node, models: list[Node], wanted: str) -> Node:
        named = {each.attributes.get("name", ""): each for each in models}
        if wanted:
            known(root, wanted, named, "model")
            return named[wanted]
        moving = [each for each in models if not flag(each, "static", False)]
        if not moving:
            root.fail("it has no model that moves")
        if len(moving) > 1:
            moving[1].fail("there are several models that move; choose one with --option model=NAME")
        return moving[0]

    def _world(self, world: Node) -> None:
        for child in world.each():
            if child.tag == "include":
                child.fail("models by <include> do not map; put the model into the file")
            if child.tag not in _WORLD_HARMLESS | {"wind"}:
                child.fail(f"<{child.tag}> of a world does not map; alfmu takes a model and gravity")
            if child.tag == "plugin":
                self.linkage.warn(_PROGRAMS, child)
            elif child.tag not in ("gravity", "model"):
                self.linkage.leave("settings of the world", child)
            if child.tag == "physics" and child.one("gravity") is not None:
                child.fail("gravity stands in <physics>, as in old files; put it into <world>")
        if world.one("gravity") is not None:
            gravity = world.one("gravity")
            assert gravity is not None
            x, y, z = numbers(gravity, "<gravity>", gravity.text, 3)
            self.linkage.gravity = (x, y, z)

    def _contacts(self, models: list[Node]) -> None:
        """Reject bodies that could touch; links of one model do not unless self-collision is enabled."""
        leave = "contacts do not map; leave them out with --option contacts=leave"
        for each in (x for x in self.model.below() if x.tag == "self_collide"):
            if each.text.strip().lower() in ("true", "1"):
                each.fail(f"links of the model can touch each other; {leave}")
        shapes = [[x for x in each.below() if x.tag == "collision"] for each in models]
        if sum(bool(x) for x in shapes) > 1:
            other = next(x for each, x in zip(models, shapes, strict=True) if x and each is not self.model)
            other[0].fail(f"links of the model can touch another model; {leave}")

    # Frames -----------------------------------------------------------------------------------------------------

    def _model(self) -> None:
        node = self.model
        for child in node.each():
            if child.tag in ("plugin",):
                self.linkage.warn(_PROGRAMS, child)
            elif child.tag in ("include", "model"):
                child.fail("models inside models do not map; put their links into one")
            elif child.tag == "drake:ball_constraint" or child.tag in _MODEL_HARMLESS:
                continue
            elif child.tag in _LEFT:
                self.linkage.leave(_LEFT[child.tag], child)
            else:
                child.fail(f"<{child.tag}> of a model does not map; alfmu takes links, joints and frames")
        given = Reading(node)
        given.text("name")
        given.text("canonical_link", "")
        self.nodes = {each.attributes.get("name", ""): each for each in node.all("link", "joint", "frame")}
        if len(self.nodes) < len(node.all("link", "joint", "frame")):
            node.fail("two of its links, joints and frames have the same name, or none; names are used once")
        if node.attributes.get("placement_frame"):
            node.fail("placement_frame does not map; give the pose of the model itself")
        own = node.one("pose")
        self.base = self._given(own) if own is not None else Pose()
        if own is not None and own.attributes.get("relative_to", "world") != "world":
            own.fail("the pose of a model that is relative to another does not map; give it in the world")
        self.poses: dict[str, Pose] = {"__model__": Pose()}
        self.pending: list[str] = []
        self.links: dict[str, Link] = {}
        self._tree(node.all("link"), node.all("joint"))
        for each in node.all("drake:ball_constraint"):
            self.linkage.closures.append(ball_constraint(each, self.links, len(self.linkage.closures)))

    def _given(self, node: Node) -> Pose:
        """Return the pose given by the numbers of a <pose>."""
        given = Reading(node)
        form = given.choice("rotation_format", ("euler_rpy", "quat_xyzw"), "euler_rpy")
        degrees = given.flag("degrees", False)
        given.text("relative_to", "")
        given.done()
        if not node.text.strip():
            return Pose()
        x = numbers(node, "<pose>", node.text, 7 if form == "quat_xyzw" else 6)
        if form == "quat_xyzw":
            if not any(x[3:]):
                node.fail("the quaternion is zero")
            return Pose(vector(x[:3]), of_quaternion((x[6], x[3], x[4], x[5])))
        return Pose(vector(x[:3]), turned("XYZ", [math.radians(a) if degrees else a for a in x[3:]]))

    def _pose(self, name: str, asked: Node) -> Pose:
        """Return the pose of a link, a joint or a frame in the model."""
        if name in self.poses:
            return self.poses[name]
        known(asked, name, self.nodes, "link, joint or frame")
        node = self.nodes[name]
        if name in self.pending:
            node.fail(f"frames are relative to each other in a circle ({' -> '.join([*self.pending, name])[:200]})")
        self.pending.append(name)
        posed = node.one("pose")
        default = child_text(node, "child") if node.tag == "joint" else node.attributes.get("attached_to", "")
        base = (posed.attributes.get("relative_to", "") if posed is not None else "") or default or "__model__"
        found = self.base.inverse if base == "world" else self._pose(base, node)
        self.poses[name] = found @ (self._given(posed) if posed is not None else Pose())
        self.pending.pop()
        return self.poses[name]

    def _link_of(self, node: Node, tag: str) -> str:
        """Return the link of a joint's parent or child, through frames; empty for the world."""
        name, seen = child_text(node, tag), set()
        while name != "world":
            known(node, name, self.nodes, "link or frame")
            found = self.nodes[name]
            if found.tag == "link":
                return name
            if found.tag == "joint" or name in seen:
                node.fail(f"its <{tag}> is {shown(name[:60])}, which is no link")
            seen.add(name)
            name = found.attributes.get("attached_to", "__model__")
            if name == "__model__":
                node.fail(f"its <{tag}> is a frame of the model, not of a link; name the link")
        return ""

    # The tree ---------------------------------------------------------------------------------------------------

    def _tree(self, links: list[Node], joints: list[Node]) -> None:
        """Place links from the world outwards; links that no joint reaches float."""
        if flag(self.model, "static", False):
            self.model.fail("the model is static; nothing of it moves")
        ends = {each: (self._link_of(each, "parent"), self._link_of(each, "child")) for each in joints}
        self.made: dict[str, Joint] = {}
        mimics: list[tuple[Node, Joint]] = []
        nodes = {each.attributes["name"]: each for each in links}
        left, placed = list(joints), {""}
        while len(placed) <= len(nodes):
            step = next((j for j in left if len(placed & set(ends[j])) == 1), None)
            if step is None:
                name = next(each for each in nodes if each not in placed)
                link = self._made(nodes[name], None, self.base @ self._pose(name, nodes[name]))
                flying = Joint(f"{name}_free", "free", nodes[name], rates=(0.0,) * 6)
                flying.start = (*link.pose.place.tolist(), *quaternion(link.pose.turn).tolist())
                link.joints.append(flying)
                placed.add(name)
                continue
            left.remove(step)
            parent, child = ends[step]
            reverse = child in placed
            one, other = (child, parent) if reverse else (parent, child)
            here = self.base @ self._pose(other, step)
            before = self.base @ self._pose(one, step) if one else Pose()
            link = self._made(nodes[other], self.links.get(one), before.inverse @ here)
            placed.add(other)
            kind, details = self._joint(step)
            if kind != "weld":
                at = here.inverse @ details["frame"]
                axes = tuple(at.turn @ axis for axis in details["axes"])
                if reverse:
                    axes = tuple(-axis for axis in reversed(axes))
                    self.linkage.note(
                        "reactions act on the parent link of joints that are taken from child to parent", step
                    )
                    if kind == "universal":
                        self.linkage.note(
                            "angle 1 of such a universal joint is about <axis2>, angle 2 about <axis>", step
                        )
                joint = Joint(step.attributes["name"], kind, step, at.place, axes, lead=details["lead"])
                count = {"spherical": 4, "universal": 2}.get(kind, 1)
                joint.start, joint.rates = joint.zero, (0.0,) * (3 if kind == "spherical" else count)
                for each in ("damping", "stiffness", "rest"):
                    values = details[each]
                    setattr(joint, each, tuple(reversed(values)) if reverse else values)
                joint.limits = tuple(reversed(details["limits"])) if reverse else tuple(details["limits"])
                self.made[joint.name] = joint
                link.joints.append(joint)
                mimics += [(mimic, joint) for mimic in details["mimic"]]
        for name, node in self.nodes.items():
            self._pose(name, node)
        for closing in left:
            self.linkage.closures.append(self._closure(closing, *ends[closing]))
        for mimic, joint in mimics:
            self._mimic(mimic, joint)

    def _made(self, node: Node, parent: Link | None, pose: Pose) -> Link:
        for child in node.each():
            if child.tag in _LEFT:
                self.linkage.leave(_LEFT[child.tag], child)
            elif child.tag == "plugin":
                self.linkage.warn(_PROGRAMS, child)
            elif child.tag == "velocity_decay":
                if any(number(child, each, 0.0) for each in ("linear", "angular")):
                    child.fail("velocity_decay does not map; give joints damping")
            elif child.tag not in _LINK_HARMLESS:
                child.fail(f"<{child.tag}> of a link does not map; alfmu takes its pose and its inertial")
        if not flag(node, "gravity", True):
            node.fail("a link without gravity does not map: alfmu's gravity acts on all bodies")
        if flag(node, "kinematic", False) or flag(node, "enable_wind", False):
            node.fail("a kinematic link, or one in the wind, does not map; leave <kinematic> and <enable_wind> out")
        link = Link(node.attributes["name"], node, parent, pose, self._inertial(node))
        self.links[link.name] = link
        self.linkage.links.append(link)
        return link

    def _inertial(self, link: Node) -> Inertial:
        node = link.one("inertial")
        if node is None:
            self.linkage.note("1 kg and 1 kg.m2 are taken, as SDF says, for links without <inertial>", link)
            return Inertial(1.0, np.zeros(3), np.eye(3))
        Reading(node).refuse({"auto": "give mass and inertia"})
        for child in node.each():
            if child.tag not in ("pose", "mass", "inertia"):
                child.fail(f"<{child.tag}> does not map; alfmu takes pose, mass and inertia")
        posed = node.one("pose")
        if posed is not None and posed.attributes.get("relative_to"):
            posed.fail("relative_to of an inertial does not map; give the pose in the link")
        at = self._given(posed) if posed is not None else Pose()
        inertia = node.one("inertia") or Node("inertia", {}, node.file, node.line, node)
        xx, yy, zz = (number(inertia, each, 1.0) for each in ("ixx", "iyy", "izz"))
        xy, xz, yz = (number(inertia, each, 0.0) for each in ("ixy", "ixz", "iyz"))
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        mass = number(node, "mass", 1.0)
        if mass < 0:
            node.fail(f"the mass is {mass:g} kg; it must not be negative")
        return Inertial(mass, at.place, at.turn @ matrix @ at.turn.T)

    # Joints -----------------------------------------------------------------------------------------------------

    def _joint(self, node: Node) -> tuple[str, dict]:
        """Return its kind, its frame in the world, axes in that frame, and the properties of its free motions."""
        frame = self.base @ self._pose(node.attributes["name"], node)

        def axis_in(axis: Node) -> Array:
            xyz = axis.one("xyz")
            x = vector(numbers(xyz, "<xyz>", xyz.text, 3)) if xyz is not None else np.array((0.0, 0.0, 1.0))
            base = xyz.attributes.get("expressed_in", "") if xyz is not None else ""
            if flag(axis, "use_parent_model_frame", False):
                if self.version >= (1, 7):
                    axis.fail("use_parent_model_frame is not of this version; use expressed_in")
                base = "__model__"
            if not np.linalg.norm(x) > 0:
                axis.fail("the axis has no direction")
            if base:
                whole = Pose() if base == "world" else self.base @ self._pose(base, axis)
                x = frame.turn.T @ whole.turn @ x
            return x

        return joint_details(self.linkage, node, frame, axis_in)

    def _closure(self, node: Node, parent: str, child: str) -> Closure:
        kind, details = self._joint(node)
        ends = []
        for name in (parent, child):
            at = self.base @ self._pose(name, node) if name else Pose()
            ends.append((self.links.get(name), at.inverse @ details["frame"]))
        return joint_closure(node, kind, details, ends[0], ends[1])

    def _mimic(self, node: Node, joint: Joint) -> None:
        given = Reading(node)
        name = given.text("joint")
        known(node, name, self.made, "joint that places a link")
        if given.text("axis", "axis") != "axis" or len(self.made[name].zero) > 1 or len(joint.zero) > 1:
            node.fail("mimic maps between joints with one axis")
        factor, offset, reference = (number(node, each, x) for each, x in _MIMIC.items())
        follow(self.linkage, node, joint, self.made[name], factor, offset - factor * reference)


_LIMITS = {"lower": -1e16, "upper": 1e16, "effort": -1.0, "velocity": -1.0}
_MIMIC = {"multiplier": 1.0, "offset": 0.0, "reference": 0.0}


def follow(linkage: Linkage, node: Node, joint: Joint, other: Joint, factor: float, offset: float) -> None:
    """Make a joint follow another, which must be declared before it and follow none."""
    order = linkage.joints
    if other.follows is not None or order.index(other) >= order.index(joint):
        node.fail(
            f"{joint.name} follows {other.name}, which follows another or comes later in the tree; name the one that "
            "leads, and put it before"
        )
    if other.kind == "free" or joint.kind == "free":
        node.fail("mimic maps between joints with one axis")
    joint.follows = (other, factor, offset)


def joint_details(linkage: Linkage, node: Node, frame: Pose, axis_in: Callable[[Node], Array]) -> tuple[str, dict]:
    """Return the kind and properties of a joint: frame, axes, damping, stiffness, rest, lead, mimicked joint."""
    kind = node.attributes.get("type", "")
    if kind not in _KINDS:
        node.fail(_LATER.format(shown(kind[:40])))
    kind = _KINDS[kind]
    wanted = {"revolute": ["axis"], "prismatic": ["axis"], "screw": ["axis"], "universal": ["axis", "axis2"]}
    allowed = {"parent", "child", "pose", "axis", "axis2", "physics", "sensor", "screw_thread_pitch", "thread_pitch"}
    for child in node.each():
        if child.tag == "sensor":
            linkage.leave("sensors", child)
        elif child.tag == "physics":
            linkage.leave("settings of solvers", child)
        elif child.tag not in allowed:
            child.fail(f"<{child.tag}> of a joint does not map")
        elif child.tag in ("axis", "axis2") and child.tag not in wanted.get(kind, []):
            linkage.leave("axes of joints that have none", child)
    found: dict = {
        "frame": frame,
        "axes": [],
        "damping": (),
        "stiffness": (),
        "rest": (),
        "limits": [],
        "lead": 0.0,
        "mimic": [],
    }
    for tag in wanted.get(kind, []):
        axis = node.one(tag)
        if axis is None:
            node.fail(f"it has no <{tag}>; give one")
        found["axes"].append(axis_in(axis))
        found["limits"].append((-math.inf, math.inf))
        _axis(linkage, axis, found)
    if kind == "universal":
        one, two = found["axes"]
        if abs(one @ two) > 1e-9 * np.linalg.norm(one) * np.linalg.norm(two):
            node.fail("its two axes are not square to each other, as those of a universal joint are")
    if kind == "screw":
        if node.one("screw_thread_pitch") is None:
            node.fail("a screw needs <screw_thread_pitch> [m per turn]; <thread_pitch> is read in several ways")
        found["lead"] = number(node, "screw_thread_pitch", 0.0)
    if not found["damping"]:
        found |= dict.fromkeys(("damping", "stiffness", "rest"), (0.0,))
    return kind, found


def _axis(linkage: Linkage, axis: Node, found: dict) -> None:
    """Read springs, dampers, limits and followers of an axis."""
    for child in axis.each():
        if child.tag == "mimic":
            found["mimic"].append(child)
        elif child.tag == "limit":
            linkage.leave("stiffness of limits", *child.all("stiffness", "dissipation"))
            low, high, effort, speed = (number(child, each, x) for each, x in _LIMITS.items())
            if min(abs(low), abs(high)) < 1e15 or any(0 <= x < 1e15 for x in (effort, speed)):
                linkage.warn("limits of joints", child.parent.parent)  # type: ignore[union-attr,arg-type]
            found["limits"][-1] = (low, high) if low < high else (-math.inf, math.inf)
        elif child.tag not in ("xyz", "dynamics", "use_parent_model_frame", "initial_position"):
            child.fail(f"<{child.tag}> of an axis does not map")
    if number(axis, "initial_position", 0.0):
        axis.fail("initial_position does not map; give the start value")
    dynamics = axis.one("dynamics") or Node("dynamics", {}, axis.file, axis.line, axis)
    if number(dynamics, "friction", 0.0):
        dynamics.fail("friction does not map: alfmu's dry friction follows from the reaction (`Mechanism.friction`)")
    for each, tag in (("damping", "damping"), ("stiffness", "spring_stiffness"), ("rest", "spring_reference")):
        value = number(dynamics, tag, 0.0)
        if value < 0 and each != "rest":
            dynamics.fail(f"{tag} is {value:g}; it must not be negative")
        found[each] = (*found[each], value)


def joint_closure(
    node: Node, kind: str, details: dict, first: tuple[Link | None, Pose], second: tuple[Link | None, Pose]
) -> Closure:
    """Return an SDF joint that closes a loop, by its frame in both links."""
    if details["mimic"]:
        details["mimic"][0].fail("a joint that closes a loop cannot follow another; make another one close it")
    names = ("damping", "stiffness", "rest")
    numbers_of = {each: details[each] for each in names}
    return Closure(
        node.attributes["name"], kind, node, first, second, tuple(details["axes"]), lead=details["lead"], **numbers_of
    )


def ball_constraint(node: Node, links: dict[str, Link], count: int) -> Closure:
    """Return a ball joint that closes a loop, in Drake's notation."""
    ends = []
    for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
        tags = [f"drake:ball_constraint_{each}" for each in (body, point)]
        one, other = (node.one(tag) for tag in tags)
        if one is None or other is None:
            node.fail(f"it has no <{tags[0] if one is None else tags[1]}>; give one")
        name = one.attributes.get("name", one.text.strip())
        if name != "world":
            known(one, name, links, "link")
        at = numbers(other, f"<{tags[1]}>", other.attributes.get("value", other.text), 3)
        ends.append((links.get(name), Pose(vector(at))))
    return Closure(f"ball_constraint{count + 1}", "spherical", node, ends[0], ends[1])
