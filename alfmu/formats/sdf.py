"""SDF, the format of Gazebo: links with poses, and joints between any two of them, so that loops are joints too.

A tree of joints from the world outwards places the links; each joint to a link that is already placed closes a loop.
Models inside a model, included ones, and several that move are merged into one. Rotations are about fixed axes (roll,
pitch, yaw).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ..model.errors import InputError
from ..model.words import shown
from . import solids
from .linkage import ANYWHERE, Closure, Coupling, Joint, Link, Linkage
from .markup import Children, Includes, Node, Reading, by_name, known, numbers
from .poses import Array, Pose, of_quaternion, turned, vector
from .solids import Inertial

_KINDS = {
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "ball": "spherical", "fixed": "weld",
    "universal": "universal", "revolute2": "universal", "screw": "screw",
}  # fmt: skip
_AXES = {"revolute": ("axis",), "prismatic": ("axis",), "screw": ("axis",), "universal": ("axis", "axis2")}
_NO_CONTACTS = "contacts do not map; leave them out with --option contacts=leave"
_OF_MODELS = ("allow_auto_disable", "enable_wind", "link", "joint", "frame", "pose", "static", "self_collide")
_LEFT = {
    "visual": "visuals", "collision": "shapes of collisions", "sensor": "sensors", "light": "lights",
    "projector": "projectors", "audio_sink": "audio", "audio_source": "audio", "battery": "batteries",
    "particle_emitter": "particle emitters", "gripper": "grippers", "contact": "settings of contacts",
    "drake:collision_filter_group": "settings of contacts",
}  # fmt: skip
_SCENERY = ("sun", "ground_plane")

_OF_WORLDS = (
    "actor", "road", "state", "population", "physics", "scene", "light", "gui", "magnetic_field", "audio", "frame",
    "spherical_coordinates", "atmosphere", "wind",
)  # fmt: skip
_SOLIDS = {
    "box": {"size": 3}, "sphere": {"radius": 1}, "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1}, "ellipsoid": {"radii": 3},
}  # fmt: skip
"""Solids with inertia, and the elements with their dimensions."""

_REFERENCES = {"pose": "relative_to", "frame": "attached_to", "xyz": "expressed_in", "mimic": "joint"}
"""Attributes that name links, joints or frames, by elements."""


def _base(pose: Node) -> str:
    """Return the frame to which a pose is relative; old files use another attribute."""
    return pose.attributes.get("relative_to", "") or pose.attributes.get("frame", "")


class File:
    """Reads a model in an SDF file, or all that move, into `linkage`; see `imported` for the options."""

    def __init__(
        self, root: Node, model: str = "", contacts: str = "refuse", leaves: Sequence[str] = (),
        folders: Sequence[Path] = (),
    ):  # fmt: skip
        version = Reading(root).text("version")
        try:
            self.version = tuple(int(part) for part in version.split("."))
        except ValueError:
            root.fail(f"its version is {shown(version[:40])}; give a number such as 1.9")
        self.folders = [root.file.resolve().parent, *folders]
        self.linkage = Linkage("", "SDF", root, leaves=leaves)
        self.linkage.gravity = (0.0, 0.0, -9.8)
        world = root.one("world")
        Includes(root, self._included)
        models = root.all("model") + (world.all("model") if world else [])
        if world is not None:
            self.linkage.pass_over(world, dict.fromkeys(_OF_WORLDS, "settings of the world"))
            self.linkage.every([*world.all("physics"), world], self._gravity)
        self.model = self._chosen(root, world, models, model)
        self.linkage.name, self.linkage.node = Reading(self.model).text("name"), self.model
        if contacts == "refuse":
            with self.linkage.trying():
                self._contacts(models)
        with self.linkage.trying(self.model):
            self._model()

    def _included(self, includes: Includes, node: Node) -> list[Node]:
        """Return the model that an <include> names, with the include's own name and pose; nothing for scenery."""
        found: list[Node] = []
        with self.linkage.trying(node):
            uri = Children(node).text("uri")
            plain = uri.removeprefix("model://").removeprefix("file://")
            if plain.split("/")[0] in _SCENERY or plain.rstrip("/").split("/")[-1] in _SCENERY:
                self.linkage.leave("scenery", node)
            elif "includes" in self.linkage.leaves:
                self.linkage.without("includes", node, "")
            elif "://" in plain:
                node.fail(
                    f"{shown(uri)} is a network address, which alfmu does not read; --option leave=includes "
                    "leaves it out"
                )
            else:
                found.append(self._other_model(includes, node, plain))
        return found

    def _other_model(self, includes: Includes, node: Node, plain: str) -> Node:
        where = [node.file.resolve().parent, *self.folders]
        choices = [plain, f"{plain}/model.sdf", f"{plain}/model.urdf"]
        name = next((name for name in choices for each in where if (each / name).is_file()), plain)
        root = includes.root(node, name, where, self.folders)
        if root.tag != "sdf":
            node.fail(f"{shown(name)} begins with <{root.tag[:40]}>; alfmu includes files in SDF")
        models = root.all("model")
        if len(models) != 1:
            node.fail(f"{shown(name)} has {len(models)} models; alfmu includes files with one")
        model = models[0]
        for each in node.all("name", "placement_frame"):
            model.attributes[each.tag] = each.text.strip()
        for each in node.all("static", "pose"):
            model.children = [x for x in model.children if x.tag != each.tag] + [each]
        self.linkage.pass_over(node, {})
        return model

    def _chosen(self, root: Node, world: Node | None, models: list[Node], wanted: str) -> Node:
        """Return the wanted model, the only moving one, or a model made of all moving ones."""
        named = {each.attributes.get("name", ""): each for each in reversed(models)}
        if wanted:
            known(root, wanted, named, "model")
        moving = [named[wanted]] if wanted else [each for each in models if not Children(each).flag("static", False)]
        self.linkage.leave("other models", *(each for each in models if each not in moving))
        if not moving:
            root.fail("it has no model that moves")
        others = [] if world is None else world.all("joint", "frame") if not wanted else []
        others = [*others, *(joint for each in models for joint in self._detachable(each) if not wanted)]
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

    def _detachable(self, model: Node) -> list[Node]:
        """Return fixed joints in place of plugins that attach a link of another model until a message detaches it."""
        own, made = model.attributes.get("name", ""), list[Node]()
        for plugin in (x for x in model.all("plugin") if "DetachableJoint" in x.attributes.get("name", "")):
            given, name = Children(plugin), f"{own}_attached" + f"_{len(made) + 1}" * bool(made)
            other = given.text("child_model")
            joint = Node("joint", {"name": name, "type": "fixed"}, plugin.file, plugin.line, model)
            joint.add("parent", text=f"{own}::{given.text('parent_link')}")
            joint.add("child", text=f"{own if other == '__model__' else other}::{given.text('child_link')}")
            self.linkage.note("detachable joints remain attached", joint)
            made.append(joint)
            model.children.remove(plugin)
        return made

    def _gravity(self, node: Node) -> None:
        if (gravity := node.one("gravity")) is not None:
            x, y, z = numbers(gravity, "<gravity>", gravity.text, 3)
            self.linkage.gravity = (x, y, z)

    def _contacts(self, models: list[Node]) -> None:
        """Reject bodies that could touch; links of one model do not unless self-collision is enabled."""
        for each in (x for x in self.model.below() if x.tag == "self_collide"):
            if each.text.strip().lower() in ("true", "1"):
                each.fail(f"links of the model can touch each other; {_NO_CONTACTS}")
        shapes = [[x for x in each.below() if x.tag == "collision"] for each in models]
        if sum(bool(x) for x in shapes) > 1:
            other = next(x for each, x in zip(models, shapes, strict=True) if x and each is not self.model)
            other[0].fail(f"links of the model can touch another model; {_NO_CONTACTS}")

    # Frames -----------------------------------------------------------------------------------------------------

    def _model(self) -> None:
        node = self.model
        for inner in node.all("model"):
            merge(node, inner)
        self.linkage.pass_over(node, _LEFT, *_OF_MODELS)
        given = Reading(node)
        given.text("name")
        given.text("canonical_link", "")
        links = {each.attributes.get("name", "") for each in node.all("link", "frame")}
        for each in node.all("joint"):
            if each.attributes.get("name") in links:  # as libsdformat does
                each.attributes["name"] += "_joint"
                self.linkage.note("joints with the name of a link have _joint added", each)
        self.nodes = by_name(node.all("link", "joint", "frame"))
        if node.attributes.get("placement_frame"):
            node.fail("placement_frame does not map; give the pose of the model itself")
        own = node.one("pose")
        self.base = self._given(own)
        if own is not None and own.attributes.get("relative_to", "world") != "world":
            own.fail("the pose of a model that is relative to another does not map; give it in the world")
        self.poses: dict[str, Pose] = {"__model__": Pose()}
        self.pending: list[str] = []
        self.links: dict[str, Link] = {}
        self._tree(node.all("link"), node.all("joint"))
        for each in node.all("drake:ball_constraint"):
            self.linkage.closures.append(ball_constraint(each, self.links, len(self.linkage.closures)))

    def _given(self, node: Node | None) -> Pose:
        """Return the pose given by the numbers of a <pose>."""
        if node is None:
            return Pose()
        given = Reading(node)
        form = given.choice("rotation_format", ("euler_rpy", "quat_xyzw"), "euler_rpy")
        degrees = given.flag("degrees", False)
        given.done(("relative_to", "frame"))
        if not node.text.strip():
            return Pose()
        x = numbers(node, "<pose>", node.text, 7 if form == "quat_xyzw" else 6)
        if form != "quat_xyzw":
            self.linkage.doubt_angles(node, *([] if degrees else x[3:]))
            return Pose(vector(x[:3]), turned("XYZ", [math.radians(a) if degrees else a for a in x[3:]]))
        if not any(x[3:]):
            node.fail("the quaternion is zero")
        return Pose(vector(x[:3]), of_quaternion((x[6], x[3], x[4], x[5])))

    def _in_link(self, node: Node, link: Node) -> Pose:
        """Return the pose of a link's part in the link."""
        posed = node.one("pose")
        base = posed.attributes.get("relative_to", "") if posed is not None else ""
        apart = self._pose(link.attributes["name"], node).inverse @ self._pose(base, node) if base else Pose()
        return apart @ self._given(posed)

    def _named(self, name: str) -> str:
        """Return the name of a link, a joint or a frame; the name of a nested model stands for its frame."""
        return f"{name}::__model__" if f"{name}::__model__" in self.nodes else name

    def _pose(self, name: str, asked: Node) -> Pose:
        """Return the pose of a link, a joint or a frame in the model."""
        name = self._named(name)
        if name in self.poses:
            return self.poses[name]
        node = known(asked, name, self.nodes, "link, joint or frame")
        if name in self.pending:
            node.fail(f"frames are relative to each other in a circle ({' -> '.join([*self.pending, name])[:200]})")
        self.pending.append(name)
        posed = node.one("pose")
        default = Children(node).text("child") if node.tag == "joint" else node.attributes.get("attached_to", "")
        base = (_base(posed) if posed is not None else "") or default or "__model__"
        found = self.base.inverse if base == "world" else self._pose(base, node)
        self.poses[name] = found @ self._given(posed)
        self.pending.pop()
        return self.poses[name]

    def _link_of(self, node: Node, tag: str) -> str:
        """Return the link of a joint's parent or child, through frames; empty for the world."""
        name, seen = Children(node).text(tag), set()
        while name != "world":
            name = self._named(name)
            found = known(node, name, self.nodes, "link or frame")
            if found.tag == "link":
                return name
            if name in seen:
                node.fail(f"its <{tag}> is {shown(name)}, which leads to no link")
            seen.add(name)
            name = found.attributes.get("attached_to", "") if found.tag == "frame" else Children(found).text("child")
            if name in ("", "__model__"):
                first = next((each.attributes["name"] for each in self.model.all("link")), "")
                name = self.model.attributes.get("canonical_link", "") or first
        return ""

    # The tree ---------------------------------------------------------------------------------------------------

    def _tree(self, links: list[Node], joints: list[Node]) -> None:
        """Place links from the world outwards; links that no joint reaches float."""
        if Children(self.model).flag("static", False):
            self.model.fail("the model is static; nothing of it moves")
        ends = {each: (self._link_of(each, "parent"), self._link_of(each, "child")) for each in joints}
        gears = [each for each in joints if each.attributes.get("type") == "gearbox"]
        self.made: dict[str, Joint] = {}
        following: list[tuple[Node, Joint]] = []
        nodes = {each.attributes["name"]: each for each in links}
        left, placed = [each for each in joints if each not in gears], {""}
        while len(placed) <= len(nodes):
            step = next((j for j in left if len(placed & set(ends[j])) == 1), None)
            if step is None:
                name = next(each for each in nodes if each not in placed)
                link = self._made(nodes[name], None, self.base @ self._pose(name, nodes[name]))
                link.float(f"{name}_free", nodes[name])
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
            joint, frame = Joint("", "weld", step), Pose()
            with self.linkage.trying(step):
                joint, frame = self._joint(step)
            if joint.kind != "weld":
                at = here.inverse @ frame
                joint.point, joint.axes = at.place, tuple(at.turn @ axis for axis in joint.axes)
                if reverse:
                    self._reverse(joint)
                self.made[joint.name] = joint
                link.joints.append(joint)
                following += [(mimic, joint) for mimic in mimics(joint)]
        for name, node in self.nodes.items():
            self._pose(name, node)
        self.linkage.every(left, lambda x: self.linkage.closures.append(self._closure(x, *ends[x])))
        for mimic, joint in following:
            with self.linkage.trying(mimic):
                self._mimic(mimic, joint)
        self.linkage.every(gears, lambda x: self._gearbox(x, *ends[x]))

    def _reverse(self, joint: Joint) -> None:
        """Reverse a joint, so that it leads from child to parent."""
        joint.axes = tuple(-axis for axis in reversed(joint.axes))
        for each in ("damping", "stiffness", "rest", "friction", "limits"):
            setattr(joint, each, getattr(joint, each)[::-1])
        note, node = self.linkage.note, joint.node
        note("reactions act on the parent link of joints that are taken from child to parent", node)
        if joint.kind == "universal":
            note("angle 1 of such a universal joint is about <axis2>, angle 2 about <axis>", node)

    def _made(self, node: Node, parent: Link | None, pose: Pose) -> Link:
        link = Link(node.attributes["name"], node, parent, pose, _UNIT)
        self.links[link.name] = link
        self.linkage.links.append(link)
        with self.linkage.trying(node):
            self._details(node)
            if not Children(node).flag("gravity", True):
                self.linkage.lifted[link] = 1.0
            link.inertial = self._inertial(node, link)
        return link

    def _details(self, node: Node) -> None:
        """Reject elements of a link, beside pose and inertia, that cannot be mapped."""
        self.linkage.pass_over(node, _LEFT, "must_be_base_link", "self_collide")
        for decay in node.all("velocity_decay"):
            if any(Children(decay).number(each, 0.0) for each in ("linear", "angular")):
                decay.fail("velocity_decay does not map; give joints damping")
        if Children(node).flag("kinematic", False) or Children(node).flag("enable_wind", False):
            node.fail("a kinematic link, or one in the wind, does not map; leave <kinematic> and <enable_wind> out")

    def _inertial(self, link: Node, made: Link) -> Inertial:
        node = link.one("inertial")
        if node is None:
            self.linkage.note("links without <inertial> get 1 kg and 1 kg.m2, the defaults of SDF", link)
            return _UNIT
        if Reading(node).flag("auto", False):
            try:
                return self._of_shapes(link, node)
            except InputError as error:
                self.linkage.doubts.append((made, node, error))
                node.take()
                return _UNIT
        left = ("density", "auto_inertia_params", "fluid_added_mass")
        self.linkage.pass_over(node, dict.fromkeys(left, "settings of inertia that are not in force"))
        inertia = node.one("inertia") or node.add("inertia")
        given = Children(inertia)
        moments = [given.number(each, 1.0) for each in ("ixx", "iyy", "izz")]
        products = [given.number(each, 0.0) for each in ("ixy", "ixz", "iyz")]
        mass = Children(node).positive("mass", 1.0)
        return Inertial.of(mass, self._in_link(node, link), moments, products)

    def _of_shapes(self, link: Node, inertial: Node) -> Inertial:
        """Return the inertia of a link from its collision shapes as homogeneous solids."""
        parts = []
        for each in link.all("collision"):
            at = self._in_link(each, link)
            density = Children(each).number("density", Children(inertial).number("density", 1000.0))
            shape = next((x for x in (each.one("geometry") or each).each() if x.tag in _SOLIDS), None)
            if shape is None:
                each.fail(f"this shape gives no inertia here; alfmu takes {', '.join(_SOLIDS)}, or mass and inertia")
            given = Children(shape)
            sizes = [x for tag, count in _SOLIDS[shape.tag].items() for x in given.numbers(tag, count)]
            if min(sizes) <= 0:
                shape.fail(f"a {shape.tag} has sizes above zero")
            halved = shape.tag == "box", shape.tag in ("cylinder", "capsule")
            sizes = [x / 2 for x in sizes] if halved[0] else [sizes[0], sizes[1] / 2] if halved[1] else sizes
            solid = getattr(solids, shape.tag)(*sizes)
            parts.append(solids.placed(solid, density * solid.volume, at))
        found = solids.together(parts)
        mass = Children(inertial).number("mass", found.mass)
        if not found.mass:
            inertial.fail("it has no shapes that give its inertia; give mass and inertia")
        return Inertial(mass, found.center, found.inertia * (mass / found.mass))

    # Joints -----------------------------------------------------------------------------------------------------

    def _joint(self, node: Node) -> tuple[Joint, Pose]:
        """Return a joint with its axes in its frame, and that frame in the world."""
        frame = self.base @ self._pose(node.attributes["name"], node)
        return jointed(self.linkage, node, lambda axis: self._axis_in(axis, frame)), frame

    def _axis_in(self, axis: Node, frame: Pose) -> Array:
        """Return the direction of an axis in the frame of its joint."""
        xyz = axis.one("xyz")
        x = vector(numbers(xyz, "<xyz>", xyz.text, 3)) if xyz is not None else np.array((0.0, 0.0, 1.0))
        base = xyz.attributes.get("expressed_in", "") if xyz is not None else ""
        if Children(axis).flag("use_parent_model_frame", self.version < (1, 5)):
            if self.version >= (1, 7):
                axis.fail("use_parent_model_frame is not in this version of SDF; use expressed_in")
            base = "__model__"
        if not np.linalg.norm(x) > 0:
            axis.fail("the axis has no direction")
        if base:
            whole = Pose() if base == "world" else self.base @ self._pose(base, axis)
            x = frame.turn.T @ whole.turn @ x
        return x

    def _gearbox(self, node: Node, parent: str, child: str) -> None:
        """Make the hinge of a gearbox's child follow that of its parent; angles are from the reference body."""
        base = self.links.get(self._link_of(node, "gearbox_reference_body"))
        ratio = Children(node).number("gearbox_ratio", 1.0)
        frame = self.base @ self._pose(node.attributes["name"], node)
        hinges, factor = [], -ratio
        for name, tag in ((parent, "axis"), (child, "axis2")):
            link = self.links.get(name)
            inner, outer = (base, link) if base is not None and base.parent is link else (link, base)
            if inner is None or inner.parent is not outer or [joint.kind for joint in inner.joints] != ["revolute"]:
                what = "alfmu takes a gearbox between links that turn on its reference body by hinges"
                node.fail(f"{what}; {name or 'world'} does not")
            own, axis = inner.joints[0], frame.turn @ self._axis_in(node.need(tag), frame)
            given = (self.base @ self._pose(inner.name, node)).turn @ own.axes[0]
            along = axis @ given / np.linalg.norm(axis) / np.linalg.norm(given)
            if abs(along) < 1 - 1e-9:
                node.fail(f"its <{tag}> is not along the hinge {own.name}, on which {name} turns")
            hinges.append(own)
            factor *= math.copysign(1.0, along if inner is link else -along)
        self.linkage.pass_over(node, {"axis": "limits"}, "parent", "child", "pose", "axis2", "physics")
        follow(self.linkage, node, hinges[1], hinges[0], factor, 0.0)

    def _closure(self, node: Node, parent: str, child: str) -> Closure:
        joint, frame = self._joint(node)
        places = [self.base @ self._pose(name, node) if name else Pose() for name in (parent, child)]
        one, two = (
            (self.links.get(name), at.inverse @ frame) for name, at in zip((parent, child), places, strict=True)
        )
        return closing(joint, one, two)

    def _mimic(self, node: Node, joint: Joint) -> None:
        given = Reading(node)
        name = given.text("joint")
        other = known(node, name, self.made, "joint that places a link")
        if given.text("axis", "axis") != "axis" or len(other.zero) > 1 or len(joint.zero) > 1:
            node.fail("mimic maps only between joints with one axis")
        factor, offset, reference = (Children(node).number(each, x) for each, x in _MIMIC.items())
        follow(self.linkage, node, joint, other, factor, offset - factor * reference)


def merge(outer: Node, inner: Node) -> None:
    """Move links, joints and frames of a nested model into the outer one, prefixed with the nested model's name."""
    outer.children.remove(inner)
    for each in inner.all("model"):
        merge(inner, each)
    name = inner.attributes.get("name", "")
    if inner.attributes.get("placement_frame"):
        inner.fail("placement_frame does not map; give the pose of the model itself")

    def own(said: str) -> str:
        return said if said == "world" else f"{name}::{said}"

    links = [each.attributes.get("name", "") for each in inner.all("link")]
    if Children(inner).flag("static", False):
        for link in links:
            held = inner.add("joint", {"name": f"{link}__held", "type": "fixed"})
            held.add("parent", text="world")
            held.add("child", text=link)
    parts = inner.all("link", "joint", "frame")
    for each in parts:
        each.attributes["name"] = own(each.attributes.get("name", ""))
        _renamed(each, own)
    base = inner.add("frame", {"name": own("__model__")})
    if links:
        base.attributes["attached_to"] = own(inner.attributes.get("canonical_link", "") or links[0])
    pose = inner.one("pose") or base.add("pose")
    pose.attributes["relative_to"] = pose.attributes.get("relative_to") or "__model__"
    base.children = [pose]
    passed = inner.all("pose", "static", "self_collide", "allow_auto_disable", "enable_wind")
    outer.children += [base, *parts, *(x for x in inner.children if x not in (base, *parts, *passed))]


def _renamed(node: Node, own: Callable[[str], str]) -> None:
    """Change the names to which a link, a joint or a frame of a nested model refers."""
    if node.tag == "link":
        pose = node.one("pose") or node.add("pose")
        pose.attributes["relative_to"] = pose.attributes.get("relative_to") or "__model__"
    elif node.tag == "frame":
        node.attributes["attached_to"] = node.attributes.get("attached_to") or "__model__"
    for each in node.below():
        reference = _REFERENCES.get(each.tag, "")
        if reference and each.attributes.get(reference):
            each.attributes[reference] = own(each.attributes[reference])
    for each in node.all("parent", "child", "gearbox_reference_body"):
        each.text = own(each.text.strip())
    for each in node.all("axis", "axis2"):
        if Children(each).flag("use_parent_model_frame", False):
            each.children = [x for x in each.children if x.tag != "use_parent_model_frame"]
            for x in each.all("xyz"):
                x.attributes["expressed_in"] = own("__model__")


_UNIT = Inertial(1.0, np.zeros(3), np.eye(3))
_LIMITS = {"lower": -1e16, "upper": 1e16, "effort": -1.0, "velocity": -1.0}
_MIMIC = {"multiplier": 1.0, "offset": 0.0, "reference": 0.0}


def follow(linkage: Linkage, node: Node, joint: Joint, other: Joint, factor: float, offset: float) -> None:
    """Make a joint follow another one; if that joint is later in the tree or follows a joint itself, add a coupling."""
    order = linkage.joints
    if other.kind == "free" or joint.kind == "free":
        node.fail("mimic maps only between joints with one axis")
    if other.follows or joint.follows or order.index(other) >= order.index(joint):
        coefficients = [offset, factor]
        linkage.couplings.append(Coupling(f"{joint.name}_mimic", node, ((joint, 1.0),), ((other, 1.0),), coefficients))
        return
    joint.follows = (other, factor, offset)
    if joint.limits and factor:
        ends = sorted((x - offset) / factor for x in joint.limits[0])
        low, high = (
            pick(x) for pick, x in zip((max, min), zip(ends, *other.limits or (ends,), strict=True), strict=True)
        )
        if low < high:
            other.limits = ((low, high),)
        else:
            linkage.warn("limits that exclude those of the joint that is followed", joint.node)


def mimics(joint: Joint) -> list[Node]:
    """Return the elements by which the axes of a joint follow others."""
    return [each for axis in joint.node.all(*_AXES.get(joint.kind, ())) for each in axis.all("mimic")]


def jointed(linkage: Linkage, node: Node, axis_in: Callable[[Node], Array]) -> Joint:
    """Return a joint with its axes, springs, dampers and limits; a fixed one is a weld."""
    said = node.attributes.get("type", "")
    if said not in _KINDS:
        node.fail(f"a {shown(said[:40])} joint does not map; alfmu takes {', '.join(_KINDS)} joints (make it of these)")
    kind = _KINDS[said]
    tags = _AXES.get(kind, ())
    spare = [each for each in ("axis", "axis2") if each not in tags]
    left = {"sensor": "sensors", "physics": "settings of solvers"}
    linkage.pass_over(
        node, left | dict.fromkeys(spare, "axes of joints of a type without axes"), "parent", "child", "pose"
    )
    joint = Joint(node.attributes["name"], kind, node)
    joint.start, joint.rates = joint.zero, (0.0,) * (3 if kind == "spherical" else len(joint.zero))
    joint.axes = tuple(axis_in(node.need(tag)) for tag in tags)
    if tags:
        found = zip(*(_axis(linkage, joint, node.need(tag)) for tag in tags), strict=True)
        joint.limits, joint.damping, joint.stiffness, joint.rest, joint.friction = found
    if kind == "universal":
        one, two = joint.axes
        if abs(one @ two) > 1e-9 * np.linalg.norm(one) * np.linalg.norm(two):
            node.fail("its two axes are not perpendicular, as those of a universal joint must be")
    pitch, turns = Children(node).number("screw_thread_pitch", 1.0), Children(node).number("thread_pitch", 0.0)
    # The older element is in radians per metre, with the other sign, as libsdformat converts it.
    joint.lead = -2 * math.pi / turns if turns and node.one("screw_thread_pitch") is None else pitch
    return joint


def _axis(linkage: Linkage, joint: Joint, axis: Node) -> tuple:
    """Return limits, damping, stiffness, rest position and friction of an axis; <axis> also limits the effort."""
    limits = -math.inf, math.inf
    for child in axis.all("limit"):
        linkage.leave("stiffness of limits", *child.all("stiffness", "dissipation"))
        low, high, effort, speed = (Children(child).limit(each, x) for each, x in _LIMITS.items())
        if min(abs(low), abs(high)) < ANYWHERE and low < high:
            linkage.limited.append(joint.node)
        linkage.doubt_limits(joint.node, low, high)
        if 0 <= speed < ANYWHERE:
            linkage.warn("limits of the speed of joints", joint.node)
        if 0 < effort < ANYWHERE and axis.tag == "axis":
            joint.effort = (-effort, effort)
        limits = (low, high) if low < high else (-math.inf, math.inf)
    axis.all("xyz", "use_parent_model_frame", "mimic")
    if Children(axis).number("initial_position", 0.0):
        axis.fail("initial_position does not map; give the start value")
    given = Children(axis.one("dynamics") or axis.add("dynamics"))
    damping, stiffness, friction = (given.positive(x, 0.0) for x in ("damping", "spring_stiffness", "friction"))
    return limits, damping, stiffness, given.number("spring_reference", 0.0), friction


def closing(joint: Joint, first: tuple[Link | None, Pose], second: tuple[Link | None, Pose]) -> Closure:
    """Return a joint that closes a loop, by its frame in both links."""
    if following := mimics(joint):
        following[0].fail("a joint that closes a loop cannot follow another; make another one close it")
    return Closure(joint, first, second)


def ball_constraint(node: Node, links: dict[str, Link], count: int) -> Closure:
    """Return a ball joint that closes a loop, in Drake's notation."""
    ends = []
    for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
        one, other = (node.need(f"drake:ball_constraint_{each}") for each in (body, point))
        name = one.attributes.get("name", one.text.strip())
        if name != "world":
            known(one, name, links, "link")
        at = numbers(other, f"<{other.tag}>", other.attributes.get("value", other.text), 3)
        ends.append((links.get(name), Pose(vector(at))))
    return Closure(Joint(f"ball_constraint{count + 1}", "spherical", node), ends[0], ends[1])
