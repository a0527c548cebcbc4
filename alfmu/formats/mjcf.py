"""MJCF, the format of MuJoCo: bodies in a tree, geoms with their inertia, equality constraints that close loops.

Angles are in degrees unless the compiler setting differs. Constraints are rigid; MuJoCo's `solref` and `solimp` are
ignored.
"""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..model.errors import InputError
from ..model.words import shown
from . import solids
from .linkage import Closure, Coupling, Crank, Joint, Link, Linkage, Motor, Sum, Tendon, Wrench, moving, place
from .markup import Includes, Node, Reading, by_name, found_file, known
from .meshes import hull, solid, triangles
from .poses import Array, Pose, about, of_quaternion, quaternion, turned, vector
from .replicas import named, names_in, others, replicated
from .solids import Inertial

T = TypeVar("T")

_VISUAL = {tag: tag for tag in ("visual", "statistic", "size", "custom")} | {"asset": "assets", "sensor": "sensors"}
"""Sections without effect on the motion."""

_MEDIUM = "alfmu has no medium around bodies"
_SOLVER = "settings of MuJoCo's solver, as constraints are rigid here"
_IN_BODIES = {"camera", "light"}
_ACTUATORS = ("motor", "general", "position", "velocity", "intvelocity", "damper", "cylinder")
_SHARED = {
    "name", "class", "group", "user", "joint", "tendon", "gear", "ctrllimited", "ctrlrange", "forcelimited",
    "forcerange", "site", "refsite", "cranksite", "slidersite", "cranklength",
}  # fmt: skip
"""Attributes of actuators of all kinds; defaults of one kind apply to all."""

_HARMLESS_GEOM = (
    "name", "class", "type", "size", "fromto", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "mass",
    "density", "shellinertia", "fitscale", "mesh", "hfield", "contype", "conaffinity", "group", "user", "material",
    "rgba", "condim", "priority", "adhesion", "friction", "solmix", "solref", "solimp", "margin", "gap", "surfacevel",
)  # fmt: skip
_DYNAMICS = ("actdim", "delay", "nsample", "armature", "damping")
_LAGS = ("filter", "filterexact")
_IMPLIED = ("gaintype", "biastype", "dyntype", "gainprm", "biasprm", "dynprm")
"""Attributes of `general` that the other kinds set, or replace by their own defaults."""

_PASSIVE = ("stiffness", "damping", "armature", "frictionloss")
"""Attributes by which a tendon acts without an actuator."""

_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}
_PARTIAL = {"size", "stiffness", "damping", "polycoef", "biasprm"}
"""Attributes whose missing trailing numbers are taken from the default."""

_ATTITUDES = {"quat": 4, "axisangle": 4, "xyaxes": 6, "zaxis": 3, "euler": 3}
"""Attributes for an attitude, and the number of their values."""

_POLYNOMIAL = (0.0, 1.0, 0.0, 0.0, 0.0)
"""Default coefficients of an equality constraint between joints."""

_REPLICATE = ("count", "sep", "offset", "euler")
_TREE = ("body", "frame", "joint", "freejoint", "geom", "inertial", "site", *_IN_BODIES)
_FLAGS = {
    "actuation", "autoreset", "clampctrl", "constraint", "contact", "damper", "diagexact", "energy", "equality",
    "eulerdamp", "filterparent", "frictionloss", "fwdinv", "gravity", "invdiscrete", "island", "limit", "midphase",
    "multiccd", "nativeccd", "override", "passive", "refsafe", "sensor", "sensornoise", "sleep", "spring", "warmstart",
}  # fmt: skip


@dataclass
class _Settings:
    """Settings of the compiler and the options."""

    degrees: bool = True
    bounds: tuple[float, float] = (0.0, 0.0)
    """Least mass [kg] and least moment of inertia [kg.m2] of bodies."""
    meshes: str = ""
    """Folder of meshes."""
    strips: bool = False
    """Whether folders in names of meshes are left out."""
    total: float = 0.0
    """Mass of all bodies together [kg], if above zero."""
    euler: str = "xyz"
    autolimits: bool = True
    from_geoms: str = "auto"
    groups: range = range(0, 6)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    off: set[str] = field(default_factory=set)

    def angle(self, x: float) -> float:
        return math.radians(x) if self.degrees else x


Inherited = dict[str, tuple[str, Node]]


def _is_scalar(joint: Joint) -> bool:
    return joint.kind in ("revolute", "prismatic")


class File:
    """Reads an MJCF file into `linkage`; see `imported` for the options."""

    def __init__(
        self, root: Node, key: str = "", contacts: str = "refuse", leaves: Sequence[str] = (),
        folders: Sequence[Path] = (),
    ):  # fmt: skip
        self.folders = [root.file.resolve().parent, *folders]
        self.linkage = Linkage(Reading(root).text("model", ""), "MJCF", root, leaves=leaves)
        self._includes = Includes(root, self._included)
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.sites: dict[str, tuple[Link | None, Pose]] = {}
        self.geoms: list[tuple[Link | None, Node, int, int]] = []
        self.masses: dict[Link, list[Inertial]] = {}
        """Inertias that geoms contribute to bodies."""
        self.soft: list[str] = []
        """Prefixes of the names of bodies, joints and sites that belong to flexible bodies."""
        self.tendons: dict[str, Sum | None] = {}
        self.zero: dict[Link, Pose] = {}
        self.models: list[File] = [self]
        """This model and those attached to it."""
        every = self.linkage.every
        self._begin(root)
        every(root.all("option"), self._option)
        self.linkage.gravity = (0.0, 0.0, 0.0) if "gravity" in self.settings.off else self.settings.gravity
        for node in root.all("worldbody"):
            self._tree(node, None, Pose(), None)
        if self.settings.total:
            self.linkage.causes += [str(doubt) for _, _, doubt in self.linkage.doubts]
        self._balanced()
        kinds: dict[str, list[Node]] = {}
        for node in root.below():
            section = node.parent.tag if node.parent is not None else ""
            kind = section if section in ("tendon", "actuator", "equality", "sensor") else node.tag
            if node.attributes.get("name") and kind not in ("body", "joint"):  # which are checked where they are read
                kinds.setdefault(kind, []).append(node)
        for nodes in kinds.values():
            with self.linkage.trying():
                by_name(nodes)
        for each in self.models:
            every(each._parts("tendon"), each._tendon)
        if self.settings.off & {"equality", "constraint"}:
            disabled = [node for each in self.models for node in each.root.all("equality")]
            self.linkage.leave("equality constraints, which the options disable", *disabled)
        else:
            for each in self.models:
                every(each._parts("equality"), each._closing)
        for each in self.models:
            every(each._parts("actuator"), each._actuator)
        if contacts == "refuse" and not self.settings.off & {"contact", "constraint"}:
            with self.linkage.trying():
                self._contacts()
        else:
            self.linkage.leave("contacts", *(node for each in self.models for node in each.root.all("contact")))
        with self.linkage.trying():
            self._start(key)

    def _begin(self, root: Node, prefix: str = "", end: str = "") -> None:
        """Read the parts that belong to a single model: compiler settings, default classes, meshes."""
        self.root, self.settings, self.around = root, _Settings(), (prefix, end)
        self.defaults: dict[str, dict[str, Inherited]] = {"main": {}}
        self.meshes = {
            x.attributes.get("name", "") or Path(x.attributes.get("file", "")).stem: x
            for x in self._parts("asset", "mesh")
        }
        self.inertias: dict[tuple[str, bool], Inertial] = {}
        """Inertias at unit density of the meshes read so far, by name and whether the mesh is a shell."""
        self.linkage.every(root.all("compiler"), self._compiler)
        self.linkage.every(root.all("default"), self._default)
        replicated(root, self._euler, self._includes.spend)
        self._sections()

    def _attach(self, node: Node, link: Link | None, pose: Pose) -> None:
        """Read another model, or a body of it, at a pose in a body; its settings and default classes remain its own."""
        given = Reading(node)
        models = {x.attributes.get("name", "") or Path(x.attributes.get("file", "")).stem: x
                  for x in self._parts("asset", "model")}  # fmt: skip
        asset = known(node, given.text("model"), models, "model")
        body, prefix = given.text("body", ""), given.text("prefix", "")
        given.done()
        where = [self.folders[0], asset.file.resolve().parent, *self.folders[1:]]
        with self._includes.inside(asset, Reading(asset).text("file"), where, self.folders) as root:
            if root.tag != "mujoco":
                asset.fail(f"the file begins with <{root.tag[:40]}>; alfmu attaches models in MJCF")
            named(root, prefix, node.end, self._includes.spend)
            made = copy.copy(self)
            made.folders = [root.file.resolve().parent, *self.folders]
            made._begin(root, prefix, node.end)
            made.settings.off = self.settings.off  # flags hold for all models
            self.models.append(made)
            if made.settings.bounds != (0.0, 0.0) or made.settings.total:
                node.fail("bounds of masses of an attached model do not map; give them in the model around it")
            Reading(root).text("model", "")
            root.parent, root.taken = node, True
            node.children.append(root)
            self.linkage.leave("options of attached models, which MuJoCo does not take", *root.all("option"))
            worlds = root.all("worldbody")
            if body:
                bodies = {x.attributes.get("name", ""): x for w in worlds for x in w.below() if x.tag == "body"}
                part = known(node, prefix + body + node.end, bodies, "body")
                rest = [x for w in worlds for x in w.children if part not in x.below()] + others(root, names_in(part))
                self.linkage.leave("parts of attached models that are not attached", *rest)
                for world in worlds:
                    world.children = [part] if world is worlds[0] else []
                part.taken = True
                above: Node | None = part.parent
                while above is not None and "childclass" not in above.attributes:
                    above = above.parent
                made._branch(part, link, pose, above.attributes["childclass"] if above is not None else None)
            else:
                for world in worlds:
                    made._tree(world, link, pose, None)

    def _parts(self, section: str, *tags: str) -> list[Node]:
        """Return the elements in all sections of a name."""
        return [x for each in self.root.all(section) for x in (each.all(*tags) if tags else each.each())]

    def _included(self, includes: Includes, node: Node) -> list[Node]:
        """Return the elements of the file that an <include> names; none if it is missing and may be left out."""
        where, name = [self.folders[0], node.file.resolve().parent, *self.folders[1:]], Reading(node).text("file")
        with self.linkage.trying(node):
            try:
                found_file(node, name, where, self.folders)
            except InputError as error:
                self.linkage.skip("includes", node, str(error).removeprefix(f"{node.where}: "))
            root = includes.root(node, name, where, self.folders)
            for each in root.each():
                each.parent = node.parent
            return root.children
        return []

    def _sections(self) -> None:
        """Ignore or refuse the sections that are not read."""
        for section in self.root.all(*_VISUAL):
            whole = not section.children or section.attributes
            self.linkage.leave(_VISUAL[section.tag], *([section] if whole else section.each()))
        self.linkage.warn("plugins, which are programs", *self._parts("extension"))
        self.linkage.leave("skins", *self._parts("deformable", "skin"))
        what = "a <{}> does not map; alfmu takes rigid bodies"
        soft = [each for each in self._parts("deformable") if each.tag != "skin"]
        self.linkage.every(soft, lambda each: self.linkage.skip("flexible", each, what.format(each.tag)))

    # Settings and defaults --------------------------------------------------------------------------------------

    def _compiler(self, node: Node) -> None:
        found, given = self.settings, Reading(node)
        found.degrees = given.choice("angle", ("degree", "radian"), "degree" if found.degrees else "radian") == "degree"
        order = given.text("eulerseq", found.euler)
        if len(order) != 3 or set(order) - set("xyzXYZ"):
            given.fail("eulerseq", f"eulerseq is {shown(order[:40])}; give three of x, y, z, X, Y, Z")
        found.euler = order
        found.autolimits = given.flag("autolimits", found.autolimits)
        found.from_geoms = given.choice("inertiafromgeom", ("auto", "true", "false"), found.from_geoms)
        low, high = given.numbers("inertiagrouprange", 2, (0, 5))
        found.groups = range(int(low), int(high) + 1)
        found.bounds = given.positive("boundmass", found.bounds[0]), given.positive("boundinertia", found.bounds[1])
        found.meshes = given.text("meshdir", given.text("assetdir", found.meshes))
        found.strips = given.flag("strippath", found.strips)
        self.linkage.balanced = given.flag("balanceinertia", self.linkage.balanced)
        found.total = max(given.number("settotalmass", found.total), 0.0)
        self.linkage.leave("lengthrange", *node.all("lengthrange"))
        if given.text("coordinate", "local") != "local":
            given.fail("coordinate", "global coordinates do not map; save the file with local ones, as MuJoCo does")
        given.refuse({"alignfree": "leave it out: it moves frames, not bodies"})
        given.done(
            ("strippath", "meshdir", "texturedir", "assetdir", "fitaabb", "discardvisual", "usethread",
             "fusestatic", "saveinertial", "conflict", "convexhull", "exactmeshinertia")
        )  # fmt: skip

    def _option(self, node: Node) -> None:
        found, given = self.settings, Reading(node)
        x, y, z = given.numbers("gravity", 3, found.gravity)
        found.gravity = (x, y, z)
        for flags in node.all("flag"):
            self._flags(Reading(flags), found)
        for name in ("density", "viscosity", "wind"):
            if any(given.numbers(name, 3 if name == "wind" else 1, (0.0,))):
                self.linkage.without("medium", node, f'{name}="{given.text(name)[:60]}" does not map: {_MEDIUM}')
        given.done(
            ("timestep", "integrator", "solver", "cone", "jacobian", "iterations", "tolerance", "ls_iterations",
             "ls_tolerance", "noslip_iterations", "noslip_tolerance", "ccd_iterations", "ccd_tolerance",
             "sdf_iterations", "sdf_initpoints", "impratio", "magnetic", "o_margin", "o_solref", "o_solimp",
             "o_friction", "actuatorgroupdisable", "apirate", "sleep_tolerance", "collision")
        )  # fmt: skip
        if given.has("actuatorgroupdisable"):
            given.fail("actuatorgroupdisable", "actuatorgroupdisable does not map; leave the actuators out")
        if set(node.attributes) - {"gravity", "density", "viscosity", "wind"}:
            self.linkage.leave(_SOLVER, node)

    def _flags(self, given: Reading, found: _Settings) -> None:
        for name in given.node.attributes:
            if given.choice(name, ("enable", "disable")) == "disable":
                found.off.add(name)
                if name in ("passive", "spring", "damper", "actuation", "clampctrl"):
                    given.fail(name, f'{name}="disable" does not map; leave out what it disables')
            elif name == "override":
                given.fail(name, 'override="enable" does not map: contacts are not taken')
            if name not in _FLAGS:
                given.fail(name, f"alfmu does not know the flag {name}; leave it out if it does nothing to the motion")

    def _default(self, node: Node, parent: str = "") -> None:
        given = Reading(node)
        name = given.text("class", None if parent else "main")
        if not parent and name != "main":
            given.fail("class", f"the outermost default class is called {shown(name[:40])}; its name is main")
        if parent and name in self.defaults:
            given.fail("class", "there is a default class of this name already; names are used once")
        self.defaults[name] = dict(self.defaults[parent or "main"])
        for child in node.each():
            if child.tag != "default":
                child.attributes.taken.update(child.attributes)
                self.defaults[name][child.tag] = _over(self.defaults[name].get(child.tag, {}), child)
        for child in node.all("default"):
            self._default(child, name)

    def _reading(self, node: Node, childclass: str | None, *tags: str) -> Reading:
        """Return the attributes of an element with the defaults of its class."""
        name = node.attributes.get("class") or childclass or "main"
        defaults = known(node, name, self.defaults, "default class")
        inherited: Inherited = {}
        for tag in tags or (node.tag,):
            inherited |= defaults.get(tag, {})
        inherited.pop("class", None)
        return Reading(node, _over(inherited, node))

    # Bodies -----------------------------------------------------------------------------------------------------

    def _tree(self, node: Node, link: Link | None, pose: Pose, childclass: str | None) -> None:
        """Read the children of a body, or of a frame at a pose in a body."""
        self.linkage.every(node.each(), lambda child: self._branch(child, link, pose, childclass))

    def _branch(self, child: Node, link: Link | None, pose: Pose, childclass: str | None) -> None:
        """Read a child of a body or a frame."""
        if child.tag == "body":
            self._body(child, link, pose, childclass)
        elif child.tag == "replicate":
            child.attributes.taken.update(_REPLICATE)
            self._tree(child, link, pose, childclass)
        elif child.tag == "frame":
            given = Reading(child)
            own = given.text("childclass", "") or childclass
            self._tree(child, link, pose @ self._pose(given), own)
        elif child.tag in ("joint", "freejoint"):
            if link is None:
                child.fail("the world has no joints; put the joint into a body")
            self._joint(child, link, pose, childclass)
        elif child.tag == "geom":
            self._geom(child, link, pose, childclass)
        elif child.tag == "site":
            given = self._reading(child, childclass)
            at = self._between(given)[0] if given.has("fromto") else self._pose(given)
            if name := given.text("name", ""):
                self.sites[name] = link, pose @ at
            self.linkage.leave("sites", child)
        elif child.tag in ("flexcomp", "composite"):
            name, prefix = child.attributes.get("name"), child.attributes.get("prefix")
            self.soft += [f"{name}_"] if child.tag == "flexcomp" else [f"{prefix}{letter}_" for letter in "BJS"]
            self.linkage.without("flexible", child, f"<{child.tag}> does not map; alfmu takes rigid bodies")
        elif child.tag in _IN_BODIES:
            self.linkage.leave(f"{child.tag}s", child)
        elif child.tag == "attach":
            self._attach(child, link, pose)
        elif child.tag == "plugin":
            self.linkage.warn("plugins, which are programs", child)
        elif child.tag != "inertial":
            child.fail(f"<{child.tag}> does not map; alfmu takes {', '.join(_TREE)}")

    def _body(self, node: Node, parent: Link | None, pose: Pose, childclass: str | None) -> None:
        given = Reading(node)
        name = given.text("name", f"body{len(self.links) + 1}")
        if name in self.links:
            node.fail(f"there is a body {shown(name)} already; names are used once")
        link = Link(name, node, parent, pose @ self._pose(given), Inertial())
        childclass = given.text("childclass", childclass or "main")
        if given.flag("mocap", False):
            self.linkage.note("bodies moved by the user of MuJoCo (mocap) are fixed", node)
        if lifted := given.number("gravcomp", 0.0):
            self.linkage.lifted[link] = lifted
        given.done(("user", "sleep"))
        self.links[name] = link
        self.linkage.links.append(link)
        self._tree(node, link, Pose(), childclass)
        if (inertial := node.one("inertial")) is not None:
            link.inertial = self._inertial(Reading(inertial))
        if link in self.masses:  # geoms define the inertia without <inertial>, or if the compiler setting demands it
            link.inertial = solids.together(self.masses[link])
        free = any(joint.kind == "free" for joint in link.joints)
        if free and (link.parent is not None or len(link.joints) > 1):
            node.fail("a free joint stands alone, in a body of the world")

    def _inertial(self, given: Reading) -> Inertial:
        at, mass, products = self._pose(given), given.positive("mass"), [0.0, 0.0, 0.0]
        moments = given.numbers("diaginertia", 3, (0.0, 0.0, 0.0))
        if given.has("fullinertia"):
            full = given.numbers("fullinertia", 6)
            moments, products = full[:3], full[3:]
        return Inertial.of(mass, at, moments, products)

    def _balanced(self) -> None:
        """Adjust masses and inertias by the compiler settings."""
        given, (mass, least) = self.settings, self.settings.bounds
        if not (mass or least or given.total):
            return
        whole = 0.0
        for link in self.linkage.links:
            moments, axes = np.linalg.eigh(link.inertial.inertia)
            moments = np.maximum(moments, least)
            at = Pose(link.inertial.center, axes)
            link.inertial = Inertial.of(max(link.inertial.mass, mass), at, moments.tolist())
            whole += link.inertial.mass
        factor = given.total / whole if given.total and whole else 1.0
        for link in self.linkage.links:
            x = link.inertial
            link.inertial = Inertial(factor * x.mass, x.center, factor * x.inertia)

    def _pose(self, given: Reading) -> Pose:
        ways = [name for name in _ATTITUDES if given.has(name)]
        if len(ways) > 1:
            given.node.fail(f"its attitude is given by {' and by '.join(ways)}; give one of them")
        turn = self._turn(given, ways[0]) if ways else np.eye(3)
        return Pose(vector(given.numbers("pos", 3, (0.0, 0.0, 0.0))), turn)

    def _euler(self, angles: Sequence[float]) -> Array:
        return turned(self.settings.euler, [self.settings.angle(a) for a in angles])

    def _turn(self, given: Reading, how: str) -> Array:
        x = vector(given.numbers(how, _ATTITUDES[how]))
        if how == "euler":
            self.linkage.doubt_angles(given.node, *([] if self.settings.degrees else x))
            return self._euler(x.tolist())
        if (not np.linalg.norm(x[:3]) > 0 and how != "quat") or not np.linalg.norm(x) > 0:
            given.fail(how, f"{how} has no direction")
        if how == "quat":
            return of_quaternion(x.tolist())
        if how == "axisangle":
            return about(x[:3], self.settings.angle(float(x[3])))
        if how == "zaxis":
            return self._along(given.node, x)
        one = x[:3] / np.linalg.norm(x[:3])
        two = x[3:] - one * (one @ x[3:])
        if not np.linalg.norm(two) > 1e-9 * np.linalg.norm(x[3:]):
            given.fail(how, "the two axes of xyaxes are parallel")
        two = two / np.linalg.norm(two)
        return np.column_stack((one, two, np.cross(one, two)))

    def _between(self, given: Reading) -> tuple[Pose, float]:
        """Return the pose of the middle between the two ends of an element, with z along it, and half its length."""
        start, end = np.split(vector(given.numbers("fromto", 6)), 2)
        return Pose((start + end) / 2, self._along(given.node, start - end)), float(np.linalg.norm(end - start)) / 2

    def _along(self, node: Node, direction: Array) -> Array:
        """Return the smallest rotation of the z axis to a direction."""
        if not np.linalg.norm(direction) > 0:
            node.fail("its two ends are one point")
        z = direction / np.linalg.norm(direction)
        across = np.cross((0.0, 0.0, 1.0), z)
        sine = float(np.linalg.norm(across))
        if sine < 1e-15:
            return np.eye(3) if z[2] > 0 else np.diag((1.0, -1.0, -1.0))
        half = math.atan2(sine, float(z[2])) / 2
        return of_quaternion((math.cos(half), *(math.sin(half) * across / sine)))

    # Joints -----------------------------------------------------------------------------------------------------

    def _joint(self, node: Node, link: Link, frame: Pose, childclass: str | None) -> None:
        free = node.tag == "freejoint"
        given = Reading(node) if free else self._reading(node, childclass)
        kind = "free" if free else given.choice("type", ("hinge", "slide", "ball", "free"), "hinge")
        name = given.text("name", f"{link.name}_joint{len(link.joints) + 1 if link.joints else ''}")
        if name in self.joints:
            node.fail(f"there is a joint {shown(name)} already; names are used once")
        scalar = kind in ("hinge", "slide")
        angle = self.settings.angle if kind == "hinge" else float
        point, axis = vector(given.numbers("pos", 3, (0, 0, 0))), vector(given.numbers("axis", 3, (0, 0, 1)))
        if not np.linalg.norm(axis) > 0:
            given.fail("axis", "the axis has no direction")
        first = "alfmu takes linear ones; give one number"
        stiffness, damping = (self._linear(given, each, first) for each in ("stiffness", "damping"))
        said = {"hinge": "revolute", "slide": "prismatic", "ball": "spherical", "free": "free"}[kind]
        joint = Joint(name, said, node, frame.at(point), stiffness=(stiffness,), damping=(damping,))
        joint.armature = given.positive("armature", 0.0)
        if scalar:
            joint.axes, joint.reference = (frame.turn @ axis,), angle(given.number("ref", 0.0))
            joint.rest = (angle(given.number("springref", 0.0)),)
        joint.start = {"ball": (1.0, 0.0, 0.0, 0.0), "free": ()}.get(kind, (joint.reference,))
        joint.rates = {"ball": (0.0,) * 3, "free": (0.0,) * 6}.get(kind, (0.0,))
        if kind == "free" and not free:
            for each in _PASSIVE:
                if any(given.numbers(each, range(1, 6), (0.0,))):
                    what = f"{each} of a free joint does not map; use <freejoint/>, or three slides and a ball"
                    self.linkage.without("free", node, what)
        if kind == "ball" and stiffness:
            self.linkage.without("balls", node, "the spring of a ball joint does not map; use three hinges")
            joint.stiffness = (0.0,)
        loss = given.positive("frictionloss", 0.0)
        if loss and scalar and not self.settings.off & {"frictionloss", "constraint"}:
            joint.friction = (loss,)
        elif loss and kind == "ball":
            self.linkage.without("balls", node, "frictionloss of a ball joint does not map; use three hinges")
        given.refuse({"actuatorgravcomp": "alfmu's gravity acts on all bodies"})
        given.refuse({"align": "it moves frames, not bodies; leave it out"})
        joint.effort = self._range(given, "actuatorfrc")
        time, ratio = given.numbers("springdamper", 2, (0.0, 0.0))
        if time > 0 and ratio > 0 and scalar:
            self.linkage.tuned.append((joint, time, ratio))
        elif time or ratio:
            what = "springdamper gives a time and a damping ratio above zero, of a hinge or a slide"
            given.fail("springdamper", what)
        limits = self._range(given, "", not scalar) if not self.settings.off & {"limit", "constraint"} else None
        if limits and scalar:
            joint.limits = ((angle(limits[0]), angle(limits[1])),)
            self.linkage.limited.append(node)
        elif limits and kind == "ball":
            self.linkage.warn("limits of ball joints", node)
        given.done(
            ("class", "group", "user", "type", "pos", "axis", "ref", "springref", "solreflimit", "solimplimit",
             "solreffriction", "solimpfriction", "margin", "align", "range", "limited")
        )  # fmt: skip
        self.joints[name] = joint
        link.joints.append(joint)

    def _linear(self, given: Reading, name: str, otherwise: str) -> float:
        """Return a stiffness or damping; newer files may give a polynomial, whose higher coefficients must be zero."""
        first, *higher = given.numbers(name, range(1, 6), (0.0,))
        if any(higher):
            given.fail(name, f"{name} that depends on the displacement does not map: {otherwise}")
        if first < 0:
            given.fail(name, f"{name} is {first:g}; it must not be negative")
        return first

    # Geoms ------------------------------------------------------------------------------------------------------

    def _geom(self, node: Node, link: Link | None, frame: Pose, childclass: str | None) -> None:
        given = self._reading(node, childclass)
        kind = given.text("type", "mesh" if given.has("mesh") else "sphere")
        masks = [int(given.number(name, 1)) for name in ("contype", "conaffinity")]
        self.geoms.append((link, node, masks[0], masks[1]))
        if given.text("fluidshape", "none") != "none":
            self.linkage.without("medium", node, f"fluidshape does not map: {_MEDIUM}")
        given.done((*_HARMLESS_GEOM, "fluidcoef"))
        self.linkage.leave("shapes of geoms", node)
        if link is None or kind in ("plane", "hfield") or int(given.number("group", 0)) not in self.settings.groups:
            return
        how = self.settings.from_geoms
        if how == "false" or (how == "auto" and link.node.one("inertial") is not None):
            return
        mass = given.positive("mass") if given.has("mass") else None
        density = given.positive("density", 1000.0)
        if mass == 0 or (mass is None and density == 0):
            return
        shell = given.flag("shellinertia", False)
        try:
            if shell and kind != "mesh":
                node.fail("the inertia of shells maps only for meshes; give the body an <inertial>")
            if kind == "mesh":
                whole, pose = self._mesh(given, shell), frame @ self._pose(given)
                factor = density if mass is None else mass / whole.mass
                inertia = factor * pose.turn @ whole.inertia @ pose.turn.T
                found = Inertial(factor * whole.mass, pose.at(whole.center), inertia)
            else:
                solid, at = self._solid(given, kind)
                found = solids.placed(solid, density * solid.volume if mass is None else mass, frame @ at)
            self.masses.setdefault(link, []).append(found)
        except InputError as error:
            self.linkage.doubts.append((link, node, error))

    def _mesh(self, geom: Reading, shell: bool) -> Inertial:
        """Return the inertia of the mesh of a geom, of unit density."""
        name = geom.text("mesh")
        if (name, shell) in self.inertias:
            return self.inertias[name, shell]
        node = known(geom.node, name, self.meshes, "mesh")
        given = self._reading(node, None)
        kind = given.choice("inertia", ("legacy", "convex", "exact", "shell"), "legacy")
        if given.numbers("refquat", 4, (1, 0, 0, 0))[1:] != [0, 0, 0]:
            node.fail("refquat of a mesh that gives inertia does not map; turn its geoms")
        try:
            if given.has("file"):
                path = Path(given.text("file"))
                path = Path(self.settings.meshes) / (path.name if self.settings.strips else path)
                corners = triangles(found_file(node, str(path), self.folders, self.folders))
            else:
                points = vector(given.numbers("vertex", range(12, 100_001))).reshape(-1, 3)
                faces = np.array(given.numbers("face", range(3, 100_001), ()), dtype=int).reshape(-1, 3)
                corners = points[faces] if len(faces) else hull(points)
            corners = corners * given.numbers("scale", 3, (1.0, 1.0, 1.0))
            corners = corners - given.numbers("refpos", 3, (0.0, 0.0, 0.0))
            corners = hull(corners.reshape(-1, 3)) if kind == "convex" else corners
            found = solid(corners, kind != "legacy", shell or kind == "shell")
        except (InputError, IndexError, ValueError) as error:
            geom.node.fail(f"its mesh gives no inertia ({error}); give its body an <inertial>")
        self.inertias[name, shell] = found
        return found

    def _solid(self, given: Reading, kind: str) -> tuple[solids.Solid, Pose]:
        if kind not in _SIZES:
            what = f"a geom of type {shown(kind[:40])} gives no inertia here"
            given.node.fail(f'{what}; give its body an <inertial>, or the geom mass="0"')
        if given.has("mesh"):
            given.node.fail("a geom fitted to a mesh has a size that alfmu does not know; give the body an <inertial>")
        count = _SIZES[kind]
        if given.has("fromto") and kind != "sphere":
            at, half = self._between(given)
            sizes = [given.numbers("size", range(1, 4))[0]] * (count - 1) + [half]
        else:
            at, sizes = self._pose(given), given.numbers("size", range(count, 4))[:count]
        if min(sizes) <= 0:
            given.fail("size", f"a {kind} has sizes above zero")
        return getattr(solids, kind)(*sizes), at

    # Closures of loops ------------------------------------------------------------------------------------------

    def _closing(self, node: Node) -> None:
        if node.tag in ("flex", "flexvert", "flexstrain", "distance"):
            self.linkage.skip("flexible", node, f"an equality of kind <{node.tag}> does not map")
        if node.tag not in ("connect", "weld", "joint", "tendon"):
            node.fail(f"an equality of kind <{node.tag}> does not map; alfmu takes connect, weld, joint and tendon")
        given = self._reading(node, None, "equality")
        name = given.text("name", f"{node.tag}{self._parts('equality').index(node) + 1}".join(self.around))
        if not given.flag("active", True):
            self.linkage.leave("equality constraints that are not active", node)
            return
        if node.tag in ("joint", "tendon"):
            of = self._summed(given, f"{node.tag}1", node.tag)
            second = f"{node.tag}2"
            by = self._summed(given, second, node.tag) if given.has(second) else ()
            numbers = given.numbers("polycoef", range(1, 6), _POLYNOMIAL)
            self.linkage.couplings.append(Coupling(name, node, of, by, [*numbers, *_POLYNOMIAL[len(numbers) :]]))
        else:
            self.linkage.closures.append(self._equality(given, name))
        if given.has("solref") or given.has("solimp"):
            self.linkage.leave(_SOLVER, node)
        given.done(("class", "solref", "solimp", "user", "anchor", "relpose", "torquescale"))

    def _summed(self, given: Reading, which: str, what: str = "joint") -> Sum:
        """Return a joint, or the joints of a fixed tendon with their factors, by its name in an attribute."""
        name, tag = given.text(which), given.node.tag
        if what == "joint":
            joint = self._known(given, which, self.joints, "joint")
            said = f"{which} {shown(name)} is no hinge and no slide"
            if not _is_scalar(joint) and tag in _ACTUATORS:
                self.linkage.skip("actuators", given.node, said)
            if not _is_scalar(joint):
                given.fail(which, said)
            return ((joint, 1.0),)
        found = known(given.node, name, self.tendons, "tendon")
        if found is None:
            what = f"{which} {shown(name)} is no fixed tendon of hinges and slides; alfmu takes these"
            self.linkage.skip("tendons" if tag == "tendon" else "actuators", given.node, what)
        return found

    # Tendons ----------------------------------------------------------------------------------------------------

    def _tendon(self, node: Node) -> None:
        given = self._reading(node, None, "tendon", node.tag)
        name = given.text("name", f"tendon{len(self.tendons) + 1}")
        limits = self._range(given, "")
        acts = [each for each in _PASSIVE if any(given.numbers(each, range(1, 6), (0.0,)))] + ["limits"] * bool(limits)
        given.done(
            ("class", "group", "limited", "range", "solreflimit", "solimplimit", "solreffriction", "solimpfriction",
             "margin", "springlength", "width", "material", "rgba", "user", "actuatorfrcrange", "actuatorfrclimited")
        )  # fmt: skip
        over = [self.joints.get(each.attributes.get("joint", "")) for each in node.each()]
        if node.tag != "fixed" or any(joint and not _is_scalar(joint) for joint in over):
            self.tendons[name] = None
            if acts:
                what = f"{acts[0]} of a <{node.tag}> tendon does not map; alfmu takes sums of hinges and slides"
                self.linkage.skip("tendons", node, what)
            self.linkage.leave("tendons without forces", node)
            return
        terms = [(self._summed(each, "joint")[0][0], each.number("coef")) for each in map(Reading, node.each())]
        if not terms:
            node.fail("it has no joint; give one")
        self.tendons[name] = along = tuple(terms)
        if not acts:
            return
        if "frictionloss" in acts:
            self.linkage.without("tendons", node, "frictionloss of a tendon does not map")
        ends = given.numbers("springlength", range(1, 3), (-1.0,))
        if ends == [-1.0]:
            ends = [sum(factor * joint.rest[0] for joint, factor in along)]
        stiffness, damping = (self._linear(given, each, "give one number") for each in ("stiffness", "damping"))
        armature = given.positive("armature", 0.0)
        made = Tendon(name, node, along, stiffness, damping, (ends[0], ends[-1]), armature, limits)
        self.linkage.limited += [node] * bool(limits)
        self.linkage.tendons.append(made)

    def _equality(self, given: Reading, name: str) -> Closure:
        node = given.node
        turns = node.tag == "connect" or given.positive("torquescale", 1.0) == 0
        joint = Joint(name, "spherical" if turns else "weld", node)
        if given.has("site1"):
            one, two = (self._known(given, which, self.sites, "site") for which in ("site1", "site2"))
            return Closure(joint, one, two)
        first, second = self._link(given, "body1"), self._link(given, "body2", "world")
        apart = self._at_reference(first).inverse @ self._at_reference(second)
        if node.tag == "connect":
            anchor = vector(given.numbers("anchor", 3))
            return Closure(joint, (first, Pose(anchor)), (second, Pose(apart.inverse.at(anchor))))
        # The anchor is given in the frame of the second body; MuJoCo fixes it at the position of relpose, if given.
        anchor = vector(given.numbers("anchor", 3, (0, 0, 0)))
        posed = given.numbers("relpose", 7, (0, 1, 0, 0, 0, 0, 0))
        here = Pose(vector(posed[:3]), of_quaternion(posed[3:])) if any(posed[3:]) else apart @ Pose(anchor)
        return Closure(joint, (first, here), (second, Pose(anchor)))

    def _at_reference(self, link: Link | None) -> Pose:
        return place(link, self.linkage.references, self.zero)

    def _link(self, given: Reading, which: str, default: str | None = None) -> Link | None:
        return None if given.text(which, default) == "world" else self._known(given, which, self.links, "body")

    def _known(self, given: Reading, which: str, there: Mapping[str, T], what: str) -> T:
        """Return the object that an attribute names; refuse, or leave out, what names a part of a flexible body."""
        name = given.text(which)
        if name not in there and name.startswith(tuple(self.soft)):
            self.linkage.skip("flexible", given.node, f"{which} {shown(name)} is part of a flexible body")
        return known(given.node, name, there, what)

    # Actuators --------------------------------------------------------------------------------------------------

    def _actuator(self, node: Node) -> None:
        kind = node.tag
        if kind not in _ACTUATORS:
            what = f"an actuator of kind <{kind}> does not map; alfmu takes {', '.join(_ACTUATORS)}"
            self.linkage.skip("actuators", node, what)
        given = self._reading(node, None, *(t for t in _ACTUATORS if t != kind), kind)
        for name, (_, origin) in given._given.items():
            implied = kind == "motor" or (kind != "general" and name in _IMPLIED)
            if name not in _SHARED and origin.tag != kind and not implied:
                origin.fail(f"{name} of <{origin.tag}> also applies to the <{kind}> in line {node.line}; give it there")
        motor = self._transmission(given)
        units = {"N": ("m", "m/s"), "N.m": ("rad", "rad/s")}.get(motor.unit, ("1", "1"))
        gain = given.numbers("gainprm", range(1, 11), (1.0,))
        prm = [*given.numbers("biasprm", range(1, 11), (0.0,)), 0.0, 0.0]
        dynamics = given.text("dyntype", "none") if kind in ("general", "position") else "none"
        if dynamics not in ("none", "integrator", *_LAGS) and not given.has("timeconst"):
            what = f"dyntype {shown(dynamics[:40])} does not map; alfmu takes {', '.join(_LAGS)}, integrator and none"
            self.linkage.skip("actuators", node, what)
        lag = given.numbers("dynprm", range(1, 11), (1.0,))[0] if dynamics in _LAGS else 0.0
        motor.integrates = dynamics == "integrator" or kind == "intvelocity"
        if kind in ("position", "intvelocity"):
            kp, kv = given.positive("kp", gain[0]), given.positive("kv", max(-prm[2], 0.0))
            motor.gain, motor.bias, motor.unit = kp, (0.0, -kp, -kv), units[kind == "intvelocity"]
            motor.ratio = given.positive("dampratio", 0.0 if given.has("kv") else max(prm[2], 0.0))
            lag = given.positive("timeconst", lag) if kind == "position" else 0.0
        elif kind == "velocity":
            kv = given.positive("kv", gain[0])
            motor.gain, motor.bias, motor.unit = kv, (0.0, 0.0, -kv), units[1]
        elif kind == "damper":
            motor.gain, motor.slopes, motor.unit = 0.0, (0.0, -given.positive("kv", 1.0)), "1"
        elif kind == "cylinder":
            lag, motor.gain = given.positive("timeconst", 1.0), given.positive("area", 1.0)
            if given.has("diameter"):
                motor.gain = math.pi * given.positive("diameter") ** 2 / 4
            constant, length, rate = given.numbers("bias", 3, (0.0, 0.0, 0.0))
            motor.bias, motor.unit = (constant, length, rate), "1"
        elif kind == "general":
            for each, taken in (("gaintype", ("fixed", "affine")), ("biastype", ("none", "affine"))):
                if (said := given.text(each, taken[0])) not in taken:
                    what = f"{each} {shown(said[:40])} does not map; alfmu takes {' and '.join(taken)}"
                    self.linkage.skip("actuators", node, what)
            affine, bias = given.text("gaintype", "fixed") == "affine", given.text("biastype", "none")
            motor.gain, motor.bias = gain[0], (prm[0], prm[1], prm[2]) if bias == "affine" else (0.0, 0.0, 0.0)
            motor.unit = motor.unit if bias == "none" and not affine else "1"
            if affine:
                motor.slopes = (gain[1] if len(gain) > 1 else 0.0, gain[2] if len(gain) > 2 else 0.0)
            if bias == "affine" and prm[2] > 0 and prm[1] == -motor.gain:
                motor.bias, motor.ratio = (prm[0], prm[1], 0.0), prm[2]
        motor.lag = lag
        motor.control, motor.state = self._range(given, "ctrl"), self._range(given, "act")
        inherit = given.positive("inheritrange", 0.0)
        if inherit and motor.along and motor.along[0][0].limits:
            low, high = motor.along[0][0].limits[0]
            middle, half = (low + high) / 2, inherit * (high - low) / 2
            which = "state" if motor.integrates else "control"
            setattr(motor, which, getattr(motor, which) or (middle - half, middle + half))
        motor.force = self._range(given, "force")
        given.refuse(dict.fromkeys(_DYNAMICS, "alfmu takes actuators with a lag or an integral at most"))
        unused = (*_IMPLIED, "kp", "kv", "timeconst") if kind == "motor" else _IMPLIED
        given.done(("class", "group", "user", "ctrllimited", "forcelimited", "lengthrange", "actlimited", "actrange",
                    "actearly", "interp", *unused))  # fmt: skip
        self._fed_back(motor)
        self.linkage.motors.append(motor)

    def _transmission(self, given: Reading) -> Motor:
        """Return a motor along a joint or a fixed tendon, at a site, or by a rod between two sites."""
        node, named = given.node, given.text("name", "")
        gear = given.numbers("gear", range(1, 7), (1.0,))
        if given.has("body"):
            self.linkage.skip("actuators", node, "body does not map: alfmu has no contacts")
        if given.has("cranksite"):
            pin, guide = (self._known(given, x, self.sites, "site") for x in ("cranksite", "slidersite"))
            rod = given.number("cranklength")
            if not rod > 0:
                given.fail("cranklength", f"cranklength is {rod:g}; it must be above zero")
            made = Motor(named or f"{given.text('cranksite')}_{node.tag}", node, (), "N", gear[0])
            made.across = Crank(pin, guide, rod)
            at = [self._at_reference(link) @ pose for link, pose in (pin, guide)]
            apart, axis = at[0].place - at[1].place, at[1].turn[:, 2]
            if np.linalg.norm(np.cross(axis, apart)) >= rod:
                what = (
                    "slider-cranks whose rod does not reach the axis of the slider at the reference, where the effort"
                )
                self.linkage.warn(f"{what} acts along it, as in MuJoCo", node)
            return made
        if given.has("site"):
            on = self._known(given, "site", self.sites, "site")
            against = self._known(given, "refsite", self.sites, "site") if given.has("refsite") else None
            force, torque = np.split(vector([*gear, *[0.0] * 6][:6]), 2)
            unit = "N" if not torque.any() else "1" if force.any() else "N.m"
            made = Motor(named or f"{given.text('site')}_{node.tag}", node, (), unit)
            made.across = Wrench(on, against, force, torque)
            return made
        which = next((each for each in ("joint", "jointinparent", "tendon") if given.has(each)), "joint")
        along = self._summed(given, which, "tendon" if which == "tendon" else "joint")
        rotary = along[0][0].kind == "revolute"
        return Motor(named or f"{given.text(which)}_{node.tag}", node, along, "N.m" if rotary else "N", gear[0])

    def _fed_back(self, motor: Motor) -> None:
        """Refuse feedback of what an actuator at a site does not measure; without another site its length is zero."""
        if motor.ratio and not motor.along:
            motor.node.fail("a damping ratio does not map here, as it depends on the inertia; give kv")
        if not isinstance(motor.across, Wrench):
            return
        if motor.across.against is None:
            motor.bias, motor.slopes = (motor.bias[0], 0.0, motor.bias[2]), (0.0, motor.slopes[1])
        if motor.across.torque.any() and any((*motor.bias[1:], *motor.slopes)):
            what = "feedback of the rotation of a site does not map: alfmu takes that of its place, and of joints"
            self.linkage.skip("actuators", motor.node, what)

    def _range(self, given: Reading, what: str, point: bool = False) -> tuple[float, float] | None:
        """Return a range, None if it is not in force; `point`: its ends may be equal, as for a ball joint."""
        low, high = given.numbers(f"{what}range", 2, (0.0, 0.0))
        limited = given.choice(f"{what}limited", ("true", "false", "auto"), "auto")
        if limited == "auto" and self.settings.autolimits and low >= high and (low or high):
            self.linkage.warn("ranges whose ends are equal or reversed, which are no limits in MuJoCo", given.node)
        if limited == "false" or (limited == "auto" and not (self.settings.autolimits and low < high)):
            return None
        if not (low < high or (point and low == high)):
            given.fail(f"{what}range", f"{what}range is from {low:g} to {high:g}; give a first number below the second")
        return low, high

    # Contacts ---------------------------------------------------------------------------------------------------

    def _contacts(self) -> None:
        """Reject a file whose bodies could touch each other."""
        pairs, excluded_pairs = (
            [node for each in self.models for node in each._parts("contact", tag)] for tag in ("pair", "exclude")
        )
        self.linkage.every(pairs, lambda pair: pair.fail(f"contacts do not map; {_CONTACTS}"))
        excludes = [Reading(each) for each in excluded_pairs]
        excluded = {frozenset((each.text("body1"), each.text("body2"))) for each in excludes}
        for i, (one, node, type1, affinity1) in enumerate(self.geoms):
            for two, other, type2, affinity2 in self.geoms[:i]:
                a, b = moving(one), moving(two)
                if a is b or not (type1 & affinity2 or type2 & affinity1):
                    continue
                # MuJoCo ignores contacts of a body with its parent, unless that is the world.
                related = a is not None and b is not None and (moving(a.parent) is b or moving(b.parent) is a)
                if related and "filterparent" not in self.settings.off:
                    continue
                names = [link.name if link is not None else "world" for link in (two, one)]
                if frozenset(names) not in excluded:
                    what = f"this geom and that in line {other.line} could touch, of {' and '.join(names)}"
                    node.fail(f"{what}; contacts do not map; {_CONTACTS}")

    # Start ------------------------------------------------------------------------------------------------------

    def _start(self, key: str) -> None:
        keys = [each for model in self.models for each in model._parts("keyframe", "key")]
        named = {each.attributes.get("name", str(i)): each for i, each in enumerate(keys)}
        for joint in self.linkage.joints:
            if joint.kind == "free":
                pose = self._at_reference(next(link for link in self.linkage.links if joint in link.joints))
                joint.start = (*pose.place.tolist(), *quaternion(pose.turn).tolist())
        rest = [each for name, each in named.items() if name != key]
        self.linkage.leave("keyframes, one of which --option key=NAME takes as the start", *rest)
        if not key:
            return
        given = Reading(known(self.root, key, named, "keyframe"))
        model = next(each for each in self.models if given.node in each._parts("keyframe", "key"))
        inside = set(model.root.below())
        joints = [joint for joint in self.linkage.joints if joint.node in inside]
        widths = {"spherical": (4, 3), "free": (7, 6)}
        sizes = [widths.get(joint.kind, (1, 1)) for joint in joints]
        for name, attribute, which in (("qpos", "start", 0), ("qvel", "rates", 1)):
            values = iter(given.numbers(name, sum(x[which] for x in sizes)) if given.has(name) else ())
            for joint, size in zip(joints, sizes, strict=True) if given.has(name) else ():
                setattr(joint, attribute, tuple(itertools.islice(values, size[which])))
                if size[0] > 1 and not any(joint.start[-4:]):
                    given.fail("qpos", f"the quaternion of {joint.name} is zero")
        self.linkage.posed = given.has("qpos") and len(joints) == len(self.linkage.joints)
        given.refuse(dict.fromkeys(("mpos", "mquat"), "alfmu has no such state"))
        motors = [motor for motor in self.linkage.motors if motor.node in inside]
        stated = [motor for motor in motors if motor.lag or motor.integrates]
        for name, attribute, some in (("ctrl", "start", motors), ("act", "begun", stated)):
            for motor, x in zip(some, given.numbers(name, len(some)), strict=True) if given.has(name) else ():
                setattr(motor, attribute, x)
        given.done(("name", "time"))


def _over(inherited: Inherited, node: Node) -> Inherited:
    """Merge attributes of an element into inherited ones: one attitude, and missing trailing numbers are inherited."""
    replaced = _ATTITUDES.keys() if _ATTITUDES.keys() & node.attributes.keys() else set()
    found = {name: given for name, given in inherited.items() if name not in replaced}
    found |= {name: (value, node) for name, value in node.attributes.items()}
    for name in _PARTIAL & inherited.keys() & node.attributes.keys():
        words, before = (each[name][0].split() for each in (found, inherited))
        found[name] = " ".join([*words, *before[len(words) :]]), node
    return found


_CONTACTS = (
    'set <flag contact="disable"/> in <option>, exclude the pair, or leave contacts out with --option contacts=leave'
)
