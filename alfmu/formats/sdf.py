"""SDF, the format of Gazebo: links with poses, and joints between any two of them, so that loops are joints too.

A tree of joints from the world outwards places the links; each joint to a link that is already placed closes a loop.
Models inside a model, included ones, and several that move are merged into one. Rotations are about fixed axes (roll,
pitch, yaw).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..model.words import shown
from . import solids
from .linkage import ANYWHERE, Closure, Coupling, Joint, Link, Linkage
from .markup import Node, Reading, found_file, known, numbers, parsed
from .poses import Array, Pose, of_quaternion, quaternion, turned, vector
from .solids import Inertial

__all__ = ["ball_constraint", "joint_closure", "read"]

_KINDS = {
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
    "ball": "spherical",
    "universal": "universal",
    "revolute2": "universal",
    "screw": "screw",
    "fixed": "weld",
}
_LATER = (
    "a {} joint does not map; alfmu takes revolute, continuous, prismatic, ball, universal, revolute2, screw and fixed "
    "joints (make it of these)"
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
    "contact": "settings of contacts",
}
_SCENERY = ("sun", "ground_plane")
_DEEPEST = 8
"""Largest depth of nested includes."""

_WORLD_HARMLESS = {
    "gravity", "model", "joint", "actor", "road", "state", "population", "physics", "scene", "light", "gui", "plugin",
    "magnetic_field", "spherical_coordinates", "audio", "frame", "atmosphere",
}  # fmt: skip
_SOLIDS: dict[str, tuple[tuple[str, int], ...]] = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
    "ellipsoid": (("radii", 3),),
}
"""Solids that give inertia, with the elements of their sizes."""

_PROGRAMS = "plugins, which are programs"
_TWICE = "<{}> stands here a second time; give one"


def read(
    root: Node, model: str = "", contacts: str = "refuse", leaves: Sequence[str] = (), folders: Sequence[Path] = ()
) -> Linkage:
    """The linkage of a model in an SDF file, or of all that move; see `imported` for the options."""
    return _File(root, model, contacts, leaves, folders).linkage


def child_text(node: Node, tag: str, default: str | None = None) -> str:
    """Return the text of a child."""
    child = node.one(tag)
    if child is None:
        if default is None:
            node.fail(f"it has no <{tag}>; give one")
        return default
    return child.text.strip()


def number(node: Node, tag: str, default: float, finite: bool = True) -> float:
    """Return the number in a child."""
    child = node.one(tag)
    return default if child is None else numbers(child, f"<{tag}>", child.text, 1, finite)[0]


def flag(node: Node, tag: str, default: bool) -> bool:
    """Return a Boolean, true or false, in a child."""
    said = child_text(node, tag, str(default)).lower()
    if said not in ("true", "1", "false", "0"):
        node.fail(f"<{tag}> is {shown(said[:40])}; give true or false")
    return said in ("true", "1")


def _base(pose: Node) -> str:
    """Return the frame that a pose is relative to, which had another name in old files."""
    return pose.attributes.get("relative_to", "") or pose.attributes.get("frame", "")


class _File:
    def __init__(self, root: Node, model: str, contacts: str, leaves: Sequence[str], folders: Sequence[Path]):
        version = Reading(root).text("version")
        try:
            self.version = tuple(int(part) for part in version.split("."))
        except ValueError:
            root.fail(f"its version is {shown(version[:40])}; give a number such as 1.9")
        self.linkage = Linkage("", "SDF", root, leaves=leaves)
        self.linkage.gravity = (0.0, 0.0, -9.8)
        trying = self.linkage.trying
        worlds = root.all("world")
        if len(worlds) > 1:
            worlds[1].fail(_TWICE.format("world"))
        include(self.linkage, root, [root.file.resolve().parent, *folders])
        world = worlds[0] if worlds else None
        models = root.all("model") + (world.all("model") if world else [])
        if world is not None:
            self._world(world)
        self.model = self._chosen(root, world, models, model)
        self.linkage.name, self.linkage.node = Reading(self.model).text("name"), self.model
        if contacts == "refuse":
            with trying():
                self._contacts(models)
        with trying(self.model):
            self._model()

    def _chosen(self, root: Node, world: Node | None, models: list[Node], wanted: str) -> Node:
        """Return the model of a name, the only one that moves, or one that holds all that move."""
        named = {each.attributes.get("name", ""): each for each in reversed(models)}
        if wanted:
            known(root, wanted, named, "model")
        moving = [named[wanted]] if wanted else [each for each in models if not flag(each, "static", False)]
        self.linkage.leave("other models", *(each for each in models if each not in moving))
        if not moving:
            root.fail("it has no model that moves")
        others = [] if world is None or wanted else world.all("joint", "frame")
        if len(moving) == 1 and not any(each.tag == "joint" for each in others):
            return moving[0]
        for k, each in enumerate(models):
            if named[name := each.attributes.get("name", "")] is not each:
                each.attributes["name"] = f"{name or 'model'}_{k + 1}"
                self.linkage.note("models with a name that another has, or none, have a number added", each)
        name = (root if world is None else world).attributes.get("name", "") or root.file.stem
        whole = Node("model", {"name": name}, root.file, moving[0].line, root)
        whole.children = [*moving, *others]
        return whole

    def _world(self, world: Node) -> None:
        for child in world.each():
            with self.linkage.trying(child):
                if child.tag not in _WORLD_HARMLESS | {"wind"}:
                    child.fail(f"<{child.tag}> of a world does not map; alfmu takes models, joints and gravity")
                if child.tag == "plugin":
                    self.linkage.warn(_PROGRAMS, child)
                elif child.tag == "physics":
                    self.linkage.leave("settings of the world", child)
                    self._gravity(child)
                elif child.tag not in ("gravity", "model", "joint"):
                    self.linkage.leave("settings of the world", child)
        with self.linkage.trying():
            self._gravity(world)

    def _gravity(self, node: Node) -> None:
        if (gravity := node.one("gravity")) is not None:
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
        for inner in node.all("model"):
            merge(node, inner)
        for child in node.each():
            if child.tag in ("plugin",):
                self.linkage.warn(_PROGRAMS, child)
            elif child.tag == "drake:ball_constraint" or child.tag in _MODEL_HARMLESS:
                continue
            elif child.tag in _LEFT:
                self.linkage.leave(_LEFT[child.tag], child)
            elif child.tag.startswith("drake:collision_filter"):
                self.linkage.leave("settings of contacts", child)
            else:
                with self.linkage.trying(child):
                    child.fail(f"<{child.tag}> of a model does not map; alfmu takes links, joints and frames")
        given = Reading(node)
        given.text("name")
        given.text("canonical_link", "")
        links = {each.attributes.get("name", "") for each in node.all("link", "frame")}
        for each in node.all("joint"):
            if each.attributes.get("name") in links:  # as libsdformat does
                each.attributes["name"] += "_joint"
                self.linkage.note("joints with the name of a link have _joint added", each)
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
        given.text("frame", "")
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
        if f"{name}::__model__" in self.nodes:
            name = f"{name}::__model__"
        known(asked, name, self.nodes, "link, joint or frame")
        node = self.nodes[name]
        if name in self.poses:
            return self.poses[name]
        if name in self.pending:
            node.fail(f"frames are relative to each other in a circle ({' -> '.join([*self.pending, name])[:200]})")
        self.pending.append(name)
        posed = node.one("pose")
        default = child_text(node, "child") if node.tag == "joint" else node.attributes.get("attached_to", "")
        base = (_base(posed) if posed is not None else "") or default or "__model__"
        found = self.base.inverse if base == "world" else self._pose(base, node)
        self.poses[name] = found @ (self._given(posed) if posed is not None else Pose())
        self.pending.pop()
        return self.poses[name]

    def _link_of(self, node: Node, tag: str) -> str:
        """Return the link of a joint's parent or child, through frames; empty for the world."""
        name, seen = child_text(node, tag), set()
        while name != "world":
            if f"{name}::__model__" in self.nodes:
                name = f"{name}::__model__"
            known(node, name, self.nodes, "link or frame")
            found = self.nodes[name]
            if found.tag == "link":
                return name
            if name in seen:
                node.fail(f"its <{tag}> is {shown(name[:60])}, which leads to no link")
            seen.add(name)
            name = found.attributes.get("attached_to", "") if found.tag == "frame" else child_text(found, "child")
            if name in ("", "__model__"):
                first = next((each.attributes["name"] for each in self.model.all("link")), "")
                name = self.model.attributes.get("canonical_link", "") or first
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
            kind, details = "weld", dict[str, Any]()
            with self.linkage.trying(step):
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
                joint.effort = details["effort"]
                for each in ("damping", "stiffness", "rest", "friction"):
                    values = details[each]
                    setattr(joint, each, tuple(reversed(values)) if reverse else values)
                joint.limits = tuple(reversed(details["limits"])) if reverse else tuple(details["limits"])
                self.made[joint.name] = joint
                link.joints.append(joint)
                mimics += [(mimic, joint) for mimic in details["mimic"]]
        for name, node in self.nodes.items():
            self._pose(name, node)
        for closing in left:
            with self.linkage.trying(closing):
                self.linkage.closures.append(self._closure(closing, *ends[closing]))
        for mimic, joint in mimics:
            with self.linkage.trying(mimic):
                self._mimic(mimic, joint)

    def _made(self, node: Node, parent: Link | None, pose: Pose) -> Link:
        link = Link(node.attributes["name"], node, parent, pose, Inertial(1.0, np.zeros(3), np.eye(3)))
        self.links[link.name] = link
        self.linkage.links.append(link)
        with self.linkage.trying(node):
            self._details(node)
            link.inertial = self._inertial(node)
            if not flag(node, "gravity", True):
                self.linkage.lifted[link] = 1.0
        return link

    def _details(self, node: Node) -> None:
        """Reject what a link has beside pose and inertia and does not map."""
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
        if flag(node, "kinematic", False) or flag(node, "enable_wind", False):
            node.fail("a kinematic link, or one in the wind, does not map; leave <kinematic> and <enable_wind> out")

    def _inertial(self, link: Node) -> Inertial:
        node = link.one("inertial")
        if node is None:
            self.linkage.note("1 kg and 1 kg.m2 are taken, as SDF says, for links without <inertial>", link)
            return Inertial(1.0, np.zeros(3), np.eye(3))
        if Reading(node).flag("auto", False):
            return self._of_shapes(link, node)
        for child in node.each():
            if child.tag in ("density", "auto_inertia_params", "fluid_added_mass"):
                self.linkage.leave("settings of inertia that are not in force", child)
            elif child.tag not in ("pose", "mass", "inertia"):
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

    def _of_shapes(self, link: Node, inertial: Node) -> Inertial:
        """Return the inertia of the shapes of collisions, of homogeneous solids."""
        parts = []
        for each in link.all("collision"):
            posed = each.one("pose")
            if posed is not None and posed.attributes.get("relative_to"):
                posed.fail("relative_to of a shape that gives inertia does not map; give the pose in the link")
            density = number(each, "density", number(inertial, "density", 1000.0))
            shape = next((x for x in (each.one("geometry") or each).each() if x.tag in _SOLIDS), None)
            if shape is None:
                each.fail(f"this shape gives no inertia here; alfmu takes {', '.join(_SOLIDS)}, or mass and inertia")
            sizes = [
                x for tag, count in _SOLIDS[shape.tag]
                for x in numbers(shape, f"<{tag}>", child_text(shape, tag), count)
            ]  # fmt: skip
            if min(sizes) <= 0:
                shape.fail(f"a {shape.tag} has sizes above zero")
            halved = shape.tag == "box", shape.tag in ("cylinder", "capsule")
            sizes = [x / 2 for x in sizes] if halved[0] else [sizes[0], sizes[1] / 2] if halved[1] else sizes
            solid = getattr(solids, shape.tag)(*sizes)
            at = self._given(posed) if posed is not None else Pose()
            parts.append(solids.placed(solid, density * solid.volume, at))
        found = solids.together(parts)
        mass = number(inertial, "mass", found.mass)
        if not found.mass:
            inertial.fail("it has no shapes that give its inertia; give mass and inertia")
        return Inertial(mass, found.center, found.inertia * (mass / found.mass))

    # Joints -----------------------------------------------------------------------------------------------------

    def _joint(self, node: Node) -> tuple[str, dict]:
        """Return its kind, its frame in the world, axes in that frame, and the properties of its free motions."""
        frame = self.base @ self._pose(node.attributes["name"], node)

        def axis_in(axis: Node) -> Array:
            xyz = axis.one("xyz")
            x = vector(numbers(xyz, "<xyz>", xyz.text, 3)) if xyz is not None else np.array((0.0, 0.0, 1.0))
            base = xyz.attributes.get("expressed_in", "") if xyz is not None else ""
            if flag(axis, "use_parent_model_frame", self.version < (1, 5)):
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


def include(linkage: Linkage, node: Node, folders: Sequence[Path], within: tuple[Path, ...] = ()) -> None:
    """Replace <include> elements of a world or a model by the models of the files that they name."""
    children = []
    for child in node.children:
        if child.tag in ("world", "model"):
            include(linkage, child, folders, within)
        if child.tag != "include":
            children.append(child)
            continue
        child.taken = True
        with linkage.trying(child):
            children += _included(linkage, child, folders, within)
    node.children = children


def _included(linkage: Linkage, node: Node, folders: Sequence[Path], within: tuple[Path, ...]) -> list[Node]:
    """Return the model that an <include> names, with the name and the pose that it gives; nothing for scenery."""
    uri = child_text(node, "uri")
    plain = uri.removeprefix("model://").removeprefix("file://")
    if plain.split("/")[0] in _SCENERY or plain.rstrip("/").split("/")[-1] in _SCENERY:
        linkage.leave("scenery", node)
        return []
    if "includes" in linkage.leaves:
        linkage.without("includes", node, "")
        return []
    if "://" in plain:
        node.fail(f"{shown(uri[:60])} is on the net, where alfmu reads nothing; --option leave=includes leaves it out")
    choices = [plain, *(f"{plain}/{each}" for each in ("model.sdf", "model.urdf"))]
    here = node.file.resolve().parent
    there = next((name for name in choices for each in [here, *folders] if (each / name).is_file()), plain)
    path = found_file(node, there, [here, *folders], folders)
    if path in within or len(within) >= _DEEPEST:
        node.fail(f"files include each other in a circle, or more than {_DEEPEST} deep")
    root = parsed(path)
    if root.tag != "sdf":
        node.fail(f"{shown(there[:60])} begins with <{root.tag[:40]}>; alfmu includes files in SDF")
    include(linkage, root, folders, (*within, path))
    models = root.all("model")
    if len(models) != 1:
        node.fail(f"{shown(there[:60])} has {len(models)} models; alfmu includes files with one")
    model = models[0]
    for each in node.each():
        if each.tag in ("name", "static", "pose", "placement_frame"):
            if each.tag in ("name", "placement_frame"):
                model.attributes[each.tag] = each.text.strip()
            else:
                model.children = [x for x in model.children if x.tag != each.tag] + [each]
        elif each.tag == "plugin":
            linkage.warn(_PROGRAMS, each)
        elif each.tag != "uri":
            each.fail(f"<{each.tag}> of an include does not map")
    return [model]


def merge(outer: Node, inner: Node) -> None:
    """Put links, joints and frames of a model inside another into that one, under names that begin with its name."""
    outer.children.remove(inner)
    for each in inner.all("model"):
        merge(inner, each)
    name = inner.attributes.get("name", "")
    if inner.attributes.get("placement_frame"):
        inner.fail("placement_frame does not map; give the pose of the model itself")

    def own(said: str) -> str:
        return said if said == "world" else f"{name}::{said}"

    links = [each.attributes.get("name", "") for each in inner.all("link")]
    base = Node("frame", {"name": own("__model__")}, inner.file, inner.line, outer)
    if links:
        base.attributes["attached_to"] = own(inner.attributes.get("canonical_link", "") or links[0])
    pose = inner.one("pose") or Node("pose", {}, inner.file, inner.line, base)
    if not pose.attributes.get("relative_to"):
        pose.attributes["relative_to"] = "__model__"
    base.children = [pose]
    outer.children.append(base)
    if flag(inner, "static", False):
        for link in links:
            held = Node("joint", {"name": f"{link}__held", "type": "fixed"}, inner.file, inner.line, inner)
            for tag, text in (("parent", "world"), ("child", link)):
                held.children.append(Node(tag, {}, inner.file, inner.line, held, text=text))
            inner.children.append(held)
    for each in inner.each():
        if each.tag in ("link", "joint", "frame"):
            each.attributes["name"] = own(each.attributes.get("name", ""))
            _renamed(each, own)
        elif each.tag in ("pose", "static", "self_collide", "allow_auto_disable", "enable_wind"):
            continue
        outer.children.append(each)


def _renamed(node: Node, own: Callable[[str], str]) -> None:
    """Change the names in the references of a link, a joint or a frame of a model inside another."""
    pose = node.one("pose")
    if node.tag == "frame" and not node.attributes.get("attached_to"):
        node.attributes["attached_to"] = own("__model__")
    elif node.tag == "frame":
        node.attributes["attached_to"] = own(node.attributes["attached_to"])
    if pose is None and node.tag == "link":
        pose = Node("pose", {"relative_to": ""}, node.file, node.line, node)
        node.children.append(pose)
    if pose is not None and (node.tag == "link" or pose.attributes.get("relative_to")):
        pose.attributes["relative_to"] = own(pose.attributes.get("relative_to") or "__model__")
    for each in node.children:
        if node.tag == "joint" and each.tag in ("parent", "child"):
            each.text = own(each.text.strip())
        elif node.tag == "joint" and each.tag in ("axis", "axis2"):
            for x in each.all("xyz"):
                if x.attributes.get("expressed_in"):
                    x.attributes["expressed_in"] = own(x.attributes["expressed_in"])
            for x in each.all("mimic"):
                x.attributes["joint"] = own(x.attributes.get("joint", ""))
            if flag(each, "use_parent_model_frame", False):
                each.children = [x for x in each.children if x.tag != "use_parent_model_frame"]
                for x in each.all("xyz"):
                    x.attributes["expressed_in"] = own("__model__")


_LIMITS = {"lower": -1e16, "upper": 1e16, "effort": -1.0, "velocity": -1.0}
_MIMIC = {"multiplier": 1.0, "offset": 0.0, "reference": 0.0}


def follow(linkage: Linkage, node: Node, joint: Joint, other: Joint, factor: float, offset: float) -> None:
    """Make a joint follow another; a constraint couples it to one that comes later in the tree or follows itself."""
    order = linkage.joints
    if other.kind == "free" or joint.kind == "free":
        node.fail("mimic maps between joints with one axis")
    if other.follows is not None or order.index(other) >= order.index(joint):
        coefficients = [offset, factor]
        linkage.couplings.append(Coupling(f"{joint.name}_mimic", node, ((joint, 1.0),), ((other, 1.0),), coefficients))
        return
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
        "friction": (),
        "effort": None,
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
        found["lead"] = number(node, "screw_thread_pitch", 1.0)
        if node.one("screw_thread_pitch") is None and (turns := number(node, "thread_pitch", 0.0)):
            # The older element is in radians per metre, with the other sign, as libsdformat converts it.
            found["lead"] = -2 * math.pi / turns
    if not found["damping"]:
        found |= dict.fromkeys(("damping", "stiffness", "rest", "friction"), (0.0,))
    return kind, found


def _axis(linkage: Linkage, axis: Node, found: dict) -> None:
    """Read springs, dampers, limits and followers of an axis."""
    for child in axis.each():
        if child.tag == "mimic":
            found["mimic"].append(child)
        elif child.tag == "limit":
            linkage.leave("stiffness of limits", *child.all("stiffness", "dissipation"))
            low, high, effort, speed = (number(child, each, x, False) for each, x in _LIMITS.items())
            assert axis.parent is not None
            if min(abs(low), abs(high)) < ANYWHERE and low < high:
                linkage.limited.append(axis.parent)
            if 0 <= speed < ANYWHERE:
                linkage.warn("limits of the speed of joints", axis.parent)
            if 0 < effort < ANYWHERE and axis.tag == "axis":
                found["effort"] = (-effort, effort)
            found["limits"][-1] = (low, high) if low < high else (-math.inf, math.inf)
        elif child.tag not in ("xyz", "dynamics", "use_parent_model_frame", "initial_position"):
            child.fail(f"<{child.tag}> of an axis does not map")
    if number(axis, "initial_position", 0.0):
        axis.fail("initial_position does not map; give the start value")
    dynamics = axis.one("dynamics") or Node("dynamics", {}, axis.file, axis.line, axis)
    names = {"damping": "damping", "stiffness": "spring_stiffness", "rest": "spring_reference", "friction": "friction"}
    for each, tag in names.items():
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
    names = ("damping", "stiffness", "rest", "friction")
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
