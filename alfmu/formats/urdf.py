"""URDF: a tree of links, and the extensions by which files close loops.

Loops: `<loop_joint>` with two links, `<drake:ball_constraint>`, `<loop>` and `<coupling>` of URDF+, `<constraint>` as
proposed for URDF, and links and joints of SDF inside `<gazebo>`. `<mimic>` lets a joint follow another. Joints with a
`<transmission>` get an input.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..model.errors import InputError
from ..model.words import shown
from .linkage import ANYWHERE, Closure, Coupling, Joint, Link, Linkage, place
from .loops import listed
from .markup import Children, Node, Reading, by_name, known, numbers
from .poses import Array, Pose, about, quaternion, turned, vector
from .sdf import ball_constraint, closing, follow, jointed
from .solids import Inertial

_KINDS = {
    "revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "", "floating": "free",
    "ball": "spherical", "universal": "universal", "screw": "screw", "planar": "planar",
}  # fmt: skip
_OF_DRAKE = ("ball", "universal", "screw")
"""Kinds of joints that only `<drake:joint>` has."""
_LOOPS = {
    "revolute": "revolute", "continuous": "revolute", "spherical": "spherical", "ball": "spherical", "fixed": "weld",
    "prismatic": "prismatic",
}  # fmt: skip
_LOOPING = ("loop_joint", "drake:loop_joint", "drake:ball_constraint", "loop", "constraint", "coupling")
_NO_AXIS = "axes of joints of a type without an axis"
_SECTIONS = {"material": "materials", "sensor": "sensors"} | {
    tag: f"settings for other programs (<{tag}>)"
    for tag in ("mujoco", "physics", "ros2_control", "frame", "drake:collision_filter_group", "collision_filter_group")
}
_LEFT = {
    "visual": "visuals", "collision": "shapes of collisions", "sensor": "sensors", "contact": "settings of contacts",
    "collision_checking": "settings of contacts", "self_collision_checking": "settings of contacts",
}  # fmt: skip
_TOUCHING = ("selfcollide", "self_collide")
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}

_RESISTING = ("dynamics", "joint_properties")
_MOVING = {
    "dampingFactor": "give joints damping",
    "springStiffness": "declare the spring in the file that `alfmu import` writes",
}
"""Settings for Gazebo that change the motion, with the alternative."""


def _above(link: Link | None) -> Iterator[Link]:
    """Yield a link and all that carry it."""
    while link is not None:
        yield link
        link = link.parent


def _each(node: Node, *tags: str) -> list[Node]:
    """Return the children with these tags, of which there is one each at most."""
    return [child for tag in tags if (child := node.one(tag)) is not None]


class File:
    """Reads a URDF file into `linkage`; see `imported` for the options."""

    def __init__(
        self, root: Node, base: str = "fixed", loops: str = "", contacts: str = "refuse", leaves: Sequence[str] = ()
    ):
        given = Reading(root)
        self.linkage = Linkage(given.text("name", ""), "URDF", root, leaves=leaves)
        given.done([name for name in root.attributes if name.startswith("version")])
        self.contacts = contacts
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.fixed: set[str] = set()
        """Names of joints that stand still."""
        self.other = self._other(root.file, loops)
        self.changed = dict(zip(self.other.get("joint_name", []), self.other.get("joint_type", []), strict=False))
        links, joints = root.all("link"), root.all("joint", "drake:joint")
        gazebo = root.all("gazebo")
        inside = [each for x in gazebo if "reference" not in x.attributes for each in x.all("link")]
        cut = root.all("loop_joint", "drake:loop_joint", "loop", "constraint")
        nodes = by_name(links)
        by_name([*links, *inside])
        by_name([*joints, *cut])
        if "world" not in nodes and any(x.attributes.get("link") == "world" for j in joints for x in j.children):
            nodes["world"] = Node("link", {"name": "world"}, root.file, root.line, root)
        self.linkage.pass_over(root, _SECTIONS)
        every, closures = self.linkage.every, self.linkage.closures
        every([each for each in root.children if not each.taken], self._section)
        with self.linkage.trying(root):
            self._tree(nodes, joints, base)
        every(cut, lambda x: closures.append(self._loop(x)))
        every(root.all("coupling"), self._coupling)
        every(root.all("drake:ball_constraint"),
              lambda x: closures.append(ball_constraint(x, self.links, len(closures))))  # fmt: skip
        every(inside, self._gazebo_link)
        every(gazebo, self._gazebo)
        every(root.all("transmission"), self._transmission)
        with self.linkage.trying():
            self._closed()

    def _other(self, file: Path, loops: str) -> dict[str, list]:
        """Return the lists in the file of loops: the given file, or the one with the same name beside the URDF."""
        path = file.parent / loops if loops else file.with_suffix(".yaml")
        if not loops and not path.is_file():
            return {}
        found = listed(path)
        if not loops and "closed_loop" not in found:
            return {}
        pairs, kinds = found.get("closed_loop", []), found.get("type", [])
        if any(not isinstance(pair, list) or len(pair) != 2 for pair in pairs):
            raise InputError(f"{path}: closed_loop has an entry that is no pair of links; give [[a, b], [c, d]]")
        if len(kinds) != len(pairs) or any(str(kind).lower() not in ("3d", "6d") for kind in kinds):
            raise InputError(f"{path}: type has {len(kinds)} entries for {len(pairs)} loops; give 3d or 6d for each")
        self.linkage.note(f"loops, motors and freedoms of joints are those of {path.name}", self.linkage.node)
        return found

    def _closed(self) -> None:
        """Add the closures and the motors that the file of loops lists."""
        node = self.linkage.node
        frames = {joint.name: link for link in self.linkage.links for joint in link.joints} | self.links
        for (one, two), kind in zip(self.other.get("closed_loop", []), self.other.get("type", []), strict=True):
            first, second = ((known(node, name, frames, "link or joint"), Pose()) for name in (one, two))
            joint = Joint(f"{one}_closed", "spherical" if kind.lower() == "3d" else "weld", node)
            self.linkage.closures.append(Closure(joint, first, second))
        self.linkage.drive(self.other.get("name_mot", []), strict=False)

    def _section(self, child: Node) -> None:
        if child.tag.startswith("xacro:"):
            child.fail("the file is written in xacro; expand it first (xacro robot.urdf.xacro > robot.urdf)")
        if child.tag not in _LOOPING and child.tag not in ("gazebo", "transmission"):
            what = f"<{child.tag}> does not map; alfmu takes links, joints, loop joints and transmissions"
            self.linkage.skip("unknown", child, what)

    # The tree ---------------------------------------------------------------------------------------------------

    def _tree(self, nodes: dict[str, Node], joints: list[Node], base: str) -> None:
        ends: dict[str, tuple[str, Node]] = {}
        for joint in joints:
            parent, child = (self._end(joint, each, nodes) for each in ("parent", "child"))
            if child in ends:
                said = f"{child} has a second parent by the joint in line {ends[child][1].line}"
                joint.fail(f"{said}; close the loop by a <loop_joint>")
            ends[child] = parent, joint
        roots = [name for name in nodes if name not in ends]
        if len(roots) != 1:
            said = f"it has {len(roots)} links without a parent ({', '.join(roots[:4])})"
            self.linkage.node.fail(f"{said}; a URDF is one tree with one root")
        node = nodes[roots[0]]
        link = self._link(node, None, Pose())
        if base == "floating":
            link.float(f"{link.name}_free", node)
        waiting = [name for name in nodes if name in ends]
        mimics: list[tuple[Node, Joint]] = []
        while waiting:
            name = next((each for each in waiting if ends[each][0] in self.links), None)
            if name is None:
                ends[waiting[0]][1].fail("no chain of joints connects its links to the root; joints form a circle")
            waiting.remove(name)
            parent, joint = ends[name]
            link = self._link(nodes[name], self.links[parent], self._origin(joint))
            with self.linkage.trying(joint):
                mimics += self._joint(joint, link)
        for mimic, follower in mimics:
            given = Reading(mimic)
            leader = known(mimic, given.text("joint"), self.joints, "joint that moves")
            factor, offset = given.number("multiplier", 1.0), given.number("offset", 0.0)
            follow(self.linkage, mimic, follower, leader, factor, offset)

    def _end(self, joint: Node, which: str, nodes: dict[str, Node]) -> str:
        name = Reading(child := joint.need(which)).text("link")
        known(child, name, nodes, "link")
        return name

    def _link(self, node: Node, parent: Link | None, pose: Pose) -> Link:
        given = Reading(node)
        name = given.text("name")
        link = Link(name, node, parent, pose, Inertial())
        with self.linkage.trying(node):
            given.done(("type", "drake_ignore"))
            self.linkage.pass_over(node, _LEFT)
            link.inertial = self._inertial(node)
        self.links[name] = link
        self.linkage.links.append(link)
        return link

    def _inertial(self, link: Node) -> Inertial:
        node = link.one("inertial")
        if node is None:
            return Inertial()
        mass = Reading(node.need("mass")).positive("value")
        moments, products = [0.0] * 3, [0.0] * 3
        if (inertia := node.one("inertia")) is not None:
            given = Reading(inertia)
            moments = [given.number(each) for each in ("ixx", "iyy", "izz")]
            products = [given.number(each, 0.0) for each in ("ixy", "ixz", "iyz")]
        return Inertial.of(mass, self._origin(node), moments, products)

    def _origin(self, node: Node) -> Pose:
        child = node.one("origin")
        return self._posed(Reading(child)) if child is not None else Pose()

    def _posed(self, given: Reading) -> Pose:
        """Return the pose from xyz and rpy of an element."""
        angles = given.numbers("rpy", 3, (0, 0, 0))
        self.linkage.doubt_angles(given.node, *angles)
        return Pose(vector(given.numbers("xyz", 3, (0, 0, 0))), turned("XYZ", angles))

    def _axis(self, node: Node) -> Array:
        child = node.one("axis") or node.add("axis")
        given = Reading(child)
        axis = vector(given.numbers("xyz", 3, (1, 0, 0)))
        given.done(("rpy",))
        if not np.linalg.norm(axis) > 0:
            child.fail("the axis has no direction")
        return axis

    def _joint(self, node: Node, link: Link) -> list[tuple[Node, Joint]]:
        """Return the joint that places a link, with its mimic element."""
        given = Reading(node)
        name, kind = given.text("name"), given.text("type")
        given.text("independent", "")  # of URDF+: a choice of coordinates
        if kind not in _KINDS or (kind in _OF_DRAKE) != (node.tag == "drake:joint"):
            node.fail(f"a joint of type {shown(kind[:40])} does not map; alfmu takes {', '.join(_KINDS)} ones")
        left = {each: each for each in ("safety_controller", "calibration")}
        resisting = _RESISTING if kind in ("fixed", "floating") else ()
        if kind in ("floating", "ball", "universal", "planar"):
            for child in node.all("mimic", *resisting):
                child.fail(f"<{child.tag}> of a {kind} joint does not map")
        if kind in ("fixed", "floating", "ball", "universal"):
            why = "axes, limits and dynamics of joints of a type without an axis"
            left |= dict.fromkeys(("axis", "limit", "mimic", *resisting), why)
        self.linkage.pass_over(node, left)
        if kind == "fixed":
            self.fixed.add(name)
            return []
        if kind == "floating" and link.parent is not None and (link.parent.parent or link.parent.joints):
            node.fail("a floating joint maps only at the root of the tree")
        joint = Joint(name, _KINDS[kind], node)
        if kind == "floating":
            at = place(link.parent, {}, {}) @ link.pose
            link.parent, link.pose = None, at
            joint.start, joint.rates = (*at.place.tolist(), *quaternion(at.turn).tolist()), (0.0,) * 6
        elif kind in ("ball", "universal"):
            joint.start, joint.rates = joint.zero, (0.0,) * (3 if kind == "ball" else 2)
            if kind == "universal":
                joint.axes = vector(_AXES["X"]), vector(_AXES["Y"])
                joint.stiffness = joint.rest = (0.0, 0.0)
        elif kind == "planar":
            link.joints += self._planar(joint)
            return []
        else:
            joint.axes = (self._axis(node),)
            self._limits(joint, kind)
        if kind == "screw":
            joint.lead = Reading(node.need("drake:screw_thread_pitch")).number("value")
        for dynamics in _each(node, *_RESISTING):
            given = Reading(dynamics)
            joint.damping = (given.positive("damping", joint.damping[0]),) * max(len(joint.axes), 1)
            joint.friction = (given.positive("friction", joint.friction[0]),) * max(len(joint.axes), 1)
            if any(joint.friction) and len(joint.axes) != 1:
                dynamics.fail(f"friction of a {kind} joint does not map")
        self.joints[name] = joint
        link.joints += self._other_freedoms(joint, self.changed[name]) if name in self.changed else [joint]
        return [(mimic, joint)] if (mimic := node.one("mimic")) is not None else []

    def _planar(self, joint: Joint) -> list[Joint]:
        """Return the two slides and the hinge of a planar joint, whose axis is the normal of the plane."""
        normal, sizes = self._axis(joint.node), [0.0] * 3
        normal = normal / np.linalg.norm(normal)
        for dynamics in _each(joint.node, *_RESISTING):
            given = Reading(dynamics)
            sizes = given.numbers("damping", 3, sizes)
            if min(sizes) < 0:
                given.fail("damping", f"damping is {min(sizes):g}; it must not be negative")
            given.refuse({"friction": "a planar joint has damping alone"})
            if sizes[0] != sizes[1] and abs(normal[2]) < 1:
                dynamics.fail("its damping differs along x and y, which are known only for an axis along z")
        self.linkage.leave("limits of planar joints", *joint.node.all("limit"))
        across = vector(_AXES["X" if abs(normal[0]) < 0.9 else "Y"])
        one = across - normal * (normal @ across)
        axes, words = (one, np.cross(normal, one), normal), ("x", "y", "angle")
        kinds = ("prismatic", "prismatic", "revolute")
        return [
            Joint(f"{joint.name}_{word}", kind, joint.node, axes=(axis,), damping=(size,))
            for word, kind, axis, size in zip(words, kinds, axes, sizes, strict=True)
        ]

    def _limits(self, joint: Joint, kind: str) -> None:
        """Read limits of the coordinate, the rate and the effort of a joint."""
        for child in _each(joint.node, "limit"):
            given = Reading(child)
            low, high, effort, speed = (given.limit(each, 0.0) for each in ("lower", "upper", "effort", "velocity"))
            if 0 < effort < ANYWHERE:
                joint.effort = (-effort, effort)
            if 0 < speed < ANYWHERE:
                self.linkage.warn("limits of the speed of joints", joint.node)
            if kind != "continuous" and low < high:
                joint.limits = ((low, high),)
                self.linkage.limited.append(joint.node)
            elif kind != "continuous" and child.attributes.keys() & {"lower", "upper"}:
                self.linkage.doubt_limits(joint.node, low, high)

    def _other_freedoms(self, joint: Joint, kind: str) -> list[Joint]:
        """Return the joints by which the file of loops replaces a joint of the URDF."""
        if kind == "FIXED":
            return []
        if kind == "SPHERICAL":
            return [Joint(joint.name, "spherical", joint.node, start=(1.0, 0.0, 0.0, 0.0), rates=(0.0,) * 3)]
        letters = kind.removeprefix("UJOINT_")
        if len(letters) != 2 or set(letters) - set(_AXES):
            joint.node.fail(f"its type in the file of loops is {shown(kind)}; alfmu takes SPHERICAL, FIXED, UJOINT_XY")
        return [Joint(f"{joint.name}_{x}", "revolute", joint.node, np.zeros(3), (vector(_AXES[x]),)) for x in letters]

    # Loops ------------------------------------------------------------------------------------------------------

    def _loop(self, node: Node) -> Closure:
        given = Reading(node)
        name, kind = given.text("name"), given.text("type")
        if kind not in _LOOPS:
            node.fail(f"a loop joint of type {shown(kind[:40])} does not map; alfmu takes {', '.join(_LOOPS)}")
        turning = kind in ("revolute", "continuous", "prismatic")
        if node.tag == "constraint":
            return self._constraint(node, Joint(name, _LOOPS[kind], node), turning)
        ends = []
        tags = ("predecessor", "successor") if node.tag == "loop" else ("link1", "link2")
        both = node.all(*tags)
        if len(both) != 2 or len(node.all(tags[1])) > 1:
            node.fail(f"it joins two links; give <{tags[0]}> and <{tags[1]}>")
        for each in both if both[0].tag == tags[0] else both[::-1]:
            given = Reading(each)
            pose = self._origin(each) if node.tag == "loop" else self._posed(given)
            ends.append((known(each, given.text("link"), self.links, "link"), pose))
        axes = (self._axis(node),) if turning else ()
        if not axes:
            self.linkage.leave(_NO_AXIS, *node.all("axis"))
        return Closure(Joint(name, _LOOPS[kind], node, axes=axes), ends[0], ends[1])

    def _constraint(self, node: Node, joint: Joint, turning: bool) -> Closure:
        """Return a loop as proposed for URDF, with a frame and an axis in either link."""
        ends, axes = [], []
        for which in ("parent", "child"):
            given = Reading(end := node.need(which))
            link = known(end, given.text("link"), self.links, "link")
            origin, axis = node.one(f"{which}_origin"), node.one(f"{which}_axis")
            pose = self._posed(Reading(origin)) if origin is not None else Pose()
            axes.append(vector(Reading(axis).numbers("xyz", 3) if axis is not None else (1.0, 0.0, 0.0)))
            if turning and not np.linalg.norm(axes[-1]) > 0:
                node.fail("its axis has no direction")
            ends.append((link, pose))
        if turning:
            one, two = (axis / np.linalg.norm(axis) for axis in axes)
            across = np.cross(one, two)
            if not across.any() and one @ two < 0:
                across = np.cross(one, np.eye(3)[np.abs(one).argmin()])
            if across.any():
                turn = about(across, float(np.arctan2(np.linalg.norm(np.cross(one, two)), one @ two)))
                ends[1] = ends[1][0], ends[1][1] @ Pose(np.zeros(3), turn)
            joint.axes = (one,)
        else:
            self.linkage.leave(_NO_AXIS, *node.all("parent_axis", "child_axis"))
        return Closure(joint, ends[0], ends[1])

    def _coupling(self, node: Node) -> None:
        """Read a coupling of URDF+: the joints from the link that both ends hang on to the successor turn as those to
        the predecessor, times a ratio."""
        chains = []
        for which in ("predecessor", "successor"):
            end = node.need(which)
            chains.append(list(_above(known(end, Reading(end).text("link"), self.links, "link"))))
        ratio = Reading(node.need("ratio")).number("value")
        by, of = ([joint for link in own if link not in other for joint in link.joints]
                  for own, other in (chains, chains[::-1]))  # fmt: skip
        if not (by and of) or any(joint.kind not in ("revolute", "prismatic") for joint in (*by, *of)):
            node.fail("it couples hinges and slides; at each end there must be one, and no other joint")
        sums = [tuple((joint, 1.0) for joint in each) for each in (of, by)]
        name, _ = Reading(node).text("name"), Reading(node).choice("type", ("rolling",), "rolling")
        self.linkage.couplings.append(Coupling(name, node, sums[0], sums[1], [0.0, ratio, 0.0, 0.0, 0.0]))

    def _gazebo(self, node: Node) -> None:
        refers = "reference" in node.attributes
        for child in node.each():
            if child.tag == "joint" and not refers:
                self.linkage.closures.append(self._gazebo_joint(child))
            elif child.tag == "link" and not refers:
                continue
            elif child.tag == "plugin":
                self.linkage.warn("plugins, which are programs", child)
            else:
                said, link = child.text.strip().lower() in ("1", "true"), node.attributes.get("reference", "")
                if link in self.links and (child.tag, said) in (("turnGravityOff", True), ("gravity", False)):
                    self.linkage.lifted[self.links[link]] = 1.0
                if child.tag.lower() in _TOUCHING and said and self.contacts == "refuse":
                    child.fail("its link can touch others; contacts do not map; --option contacts=leave leaves them")
                if child.tag in _MOVING and child.text.strip().lower() not in ("", "0", "0.0", "false"):
                    child.fail(f"<{child.tag}> does not map: {_MOVING[child.tag]}")
                self.linkage.leave("settings for Gazebo", child)

    def _gazebo_link(self, node: Node) -> None:
        """Read an SDF link, posed in the root link, as one of URDF that floats until joints of Gazebo hold it."""
        inertial = node.need("inertial")
        mass, inertia = inertial.need("mass"), inertial.need("inertia")
        mass.attributes["value"] = mass.text
        inertia.attributes.update((each.tag, each.text) for each in inertia.each())
        for each in (node, inertial):
            for pose in each.all("pose"):
                x = pose.text.split()
                each.add("origin", {"xyz": " ".join(x[:3]), "rpy": " ".join(x[3:])})
        link = self._link(node, None, place(self.linkage.links[0], {}, {}) @ self._origin(node))
        link.float(f"{link.name}_free", node)
        if not Children(node).flag("gravity", True):
            self.linkage.lifted[link] = 1.0

    def _gazebo_joint(self, node: Node) -> Closure:
        """Return an SDF joint: its pose and its axes are in the frame of the child."""
        ends = {}
        for tag in ("parent", "child"):
            child = node.need(tag)
            name = child.attributes.get("link", child.text.strip())
            if name != "world":
                known(child, name, self.links, "link")
            ends[tag] = self.links.get(name)
        posed = node.one("pose")
        x = numbers(posed, "<pose>", posed.text, 6) if posed is not None else [0.0] * 6
        if "name" not in node.attributes:
            node.fail("it has no name; give one")

        def axis_in(axis: Node) -> Array:
            xyz = axis.need("xyz")
            direction = vector(numbers(xyz, "<xyz>", xyz.text, 3))
            base = xyz.attributes.get("expressed_in", "")
            if Children(axis).flag("use_parent_model_frame", False):
                base = "__model__"
            if not base:
                return direction
            # The frame of the model is that of the root link, the ground's where all coordinates are zero.
            link = None if base == "__model__" else known(xyz, base, self.links, "link")
            return frame.turn.T @ place(link, {}, zeros).turn @ direction

        own = Pose(vector(x[:3]), turned("XYZ", x[3:]))
        zeros: dict[Link, Pose] = {}
        frame = place(ends["child"], {}, zeros) @ own
        joint = jointed(self.linkage, node, axis_in)
        places = [(link, place(link, {}, zeros).inverse @ frame) for link in (ends["parent"], ends["child"])]
        return closing(joint, places[0], places[1])

    def _transmission(self, node: Node) -> None:
        self.linkage.leave("elements of transmissions other than joints", node)
        for each in node.below():
            if each.tag in ("drake:rotor_inertia", "drake:gear_ratio"):
                each.fail("the inertia of a rotor does not map; declare it in the file that `alfmu import` writes")
            if each.tag == "mechanicalReduction":
                self.linkage.note("inputs of transmissions are efforts of the joints, not of the actuators", node)
        for each in node.all("joint"):
            name = Reading(each).text("name")
            if name not in self.fixed:
                known(each, name, self.joints, "joint that moves")
            self.linkage.drive([name], strict=False)
