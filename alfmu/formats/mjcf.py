"""MJCF, the format of MuJoCo: bodies in a tree, geoms with their inertia, equality constraints that close loops.

Angles are in degrees unless the compiler setting differs. Constraints are rigid; MuJoCo's `solref` and `solimp` are
ignored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..model.words import shown
from . import solids
from .linkage import Closure, Coupling, Joint, Link, Linkage, Motor, place
from .markup import Node, Reading, known, parsed
from .poses import Array, Pose, about, of_quaternion, quaternion, turned, vector
from .solids import Inertial

__all__ = ["read"]

_VISUAL = {"asset", "visual", "statistic", "size", "sensor", "custom"}
"""Sections without effect on the motion."""

_MEDIUM = "alfmu has no medium around bodies; leave it out"
_SOLVER = "settings of MuJoCo's solver, as constraints are rigid here"
_IN_BODIES = {"camera", "light"}
_ACTUATORS = ("motor", "general", "position", "velocity")
_SHARED = {"name", "class", "group", "user", "joint", "gear", "ctrllimited", "ctrlrange", "forcelimited", "forcerange"}
"""Attributes of actuators of all kinds; defaults of one kind apply to all."""

_HARMLESS_GEOM = (
    "name", "class", "type", "size", "fromto", "pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "mass",
    "density", "shellinertia", "fitscale", "mesh", "hfield", "contype", "conaffinity", "group", "user", "material",
    "rgba", "condim", "priority", "friction", "solmix", "solref", "solimp", "margin", "gap", "surfacevel",
)  # fmt: skip
_DYNAMICS = (
    "dyntype", "actdim", "timeconst", "inheritrange", "dampratio", "delay", "nsample", "armature", "damping",
)  # fmt: skip
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}
_PARTIAL = {"size", "stiffness", "damping", "polycoef", "biasprm"}
"""Attributes with optional trailing numbers, which come from the default."""

_ATTITUDES = {"quat": 4, "axisangle": 4, "xyaxes": 6, "zaxis": 3, "euler": 3}
"""Attributes for an attitude, and the number of their values."""

_POLYNOMIAL = (0.0, 1.0, 0.0, 0.0, 0.0)
"""Default coefficients of an equality of joints."""

_TREE = ("body", "frame", "joint", "freejoint", "geom", "inertial", "site", *_IN_BODIES)
_FLAGS = {
    "actuation", "autoreset", "clampctrl", "constraint", "contact", "damper", "diagexact", "energy", "equality",
    "eulerdamp", "filterparent", "frictionloss", "fwdinv", "gravity", "invdiscrete", "island", "limit", "midphase",
    "multiccd", "nativeccd", "override", "passive", "refsafe", "sensor", "sleep", "spring", "warmstart",
}  # fmt: skip
_DEEPEST = 8
"""Largest depth of nested includes."""

_FILES = 100
"""Largest number of included files."""


@dataclass
class _Settings:
    """Settings of the compiler and the options."""

    degrees: bool = True
    euler: str = "xyz"
    autolimits: bool = True
    from_geoms: str = "auto"
    groups: range = range(0, 6)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    off: set[str] = field(default_factory=set)

    def angle(self, x: float) -> float:
        return math.radians(x) if self.degrees else x


Inherited = dict[str, tuple[str, Node]]


def read(root: Node, key: str = "", contacts: str = "refuse") -> Linkage:
    """Return the linkage of an MJCF file; see `imported` for the options."""
    return _File(root, key, contacts).linkage


class _File:
    def __init__(self, root: Node, key: str, contacts: str):
        self.root = root
        _include(root, root.file.resolve().parent, 0, [])
        model = Reading(root)
        self.linkage = Linkage(model.text("model", ""), "MJCF", root)
        self.settings = self._settings()
        self.linkage.gravity = self.settings.gravity
        self.defaults: dict[str, dict[str, Inherited]] = {"main": {}}
        for node in root.all("default"):
            self._default(node, None)
        self.links: dict[str, Link] = {}
        self.joints: dict[str, Joint] = {}
        self.sites: dict[str, tuple[Link | None, Pose]] = {}
        self.geoms: list[tuple[Link | None, Node, int, int]] = []
        self.free: set[Link] = set()
        for section in root.each():
            self._section(section)
        for node in root.all("worldbody"):
            self._tree(node, None, Pose(), None)
        self.zero: dict[Link, Pose] = {}
        for node in root.all("equality"):
            self._equalities(node)
        for node in root.all("actuator"):
            for each in node.each():
                self._actuator(each)
        if contacts == "refuse" and not self.settings.off & {"contact", "constraint"}:
            self._contacts()
        else:
            self.linkage.leave("contacts", *root.all("contact"))
        self._start(key)

    def _section(self, section: Node) -> None:
        tag = section.tag
        if tag in _VISUAL:
            what = {"asset": "assets", "sensor": "sensors"}.get(tag, tag)
            self.linkage.leave(what, *(section.each() if section.children and not section.attributes else [section]))
        elif tag in ("tendon", "deformable", "extension"):
            for child in section.each():
                child.fail(
                    f"a <{child.tag}> does not map; alfmu takes bodies, joints, connect, weld and joint equalities, "
                    "and motors on joints (declare the rest in the file that `alfmu import` writes)"
                )
        elif tag not in (
            "compiler", "option", "default", "worldbody", "equality", "actuator", "contact", "keyframe",
        ):  # fmt: skip
            section.fail(f"alfmu does not know <{tag}>")

    # Settings and defaults --------------------------------------------------------------------------------------

    def _settings(self) -> _Settings:
        found = _Settings()
        for node in self.root.all("compiler"):
            given = Reading(node)
            found.degrees = (
                given.choice("angle", ("degree", "radian"), "degree" if found.degrees else "radian") == "degree"
            )
            found.euler = given.text("eulerseq", found.euler)
            if len(found.euler) != 3 or set(found.euler.lower()) - set("xyz"):
                given.fail("eulerseq", f"eulerseq is {shown(found.euler[:40])}; give three of x, y, z, X, Y, Z")
            found.autolimits = given.flag("autolimits", found.autolimits)
            found.from_geoms = given.choice("inertiafromgeom", ("auto", "true", "false"), found.from_geoms)
            low, high = given.numbers("inertiagrouprange", 2, (0, 5))
            found.groups = range(int(low), int(high) + 1)
            if given.text("coordinate", "local") != "local":
                given.fail("coordinate", "global coordinates do not map; save the file with local ones, as MuJoCo does")
            if given.has("settotalmass") and given.number("settotalmass") > 0:
                given.fail("settotalmass", "settotalmass does not map; give the masses themselves")
            given.refuse(
                {
                    "boundmass": "give the masses themselves",
                    "boundinertia": "give the inertias themselves",
                    "balanceinertia": "give inertias that a body can have",
                    "alignfree": "leave it out: it moves frames, not bodies",
                }
            )
            given.done(
                ("strippath", "meshdir", "texturedir", "assetdir", "fitaabb", "discardvisual", "usethread",
                 "fusestatic", "saveinertial", "conflict", "convexhull", "exactmeshinertia")
            )  # fmt: skip
            self.linkage.leave("lengthrange", *node.all("lengthrange"))
        for node in self.root.all("option"):
            given = Reading(node)
            x, y, z = given.numbers("gravity", 3, found.gravity)
            found.gravity = (x, y, z)
            given.refuse(dict.fromkeys(("density", "viscosity", "wind"), _MEDIUM))
            given.done(
                ("timestep", "integrator", "solver", "cone", "jacobian", "iterations", "tolerance", "ls_iterations",
                 "ls_tolerance", "noslip_iterations", "noslip_tolerance", "ccd_iterations", "ccd_tolerance",
                 "sdf_iterations", "sdf_initpoints", "impratio", "magnetic", "o_margin", "o_solref", "o_solimp",
                 "o_friction", "actuatorgroupdisable", "apirate", "sleep_tolerance")
            )  # fmt: skip
            if given.has("actuatorgroupdisable"):
                given.fail("actuatorgroupdisable", "actuatorgroupdisable does not map; leave the actuators out")
            if set(node.attributes) - {"gravity", "density", "viscosity", "wind"}:
                self.linkage.leave(_SOLVER, node)
            for flags in node.all("flag"):
                self._flags(Reading(flags), found)
        if "gravity" in found.off:
            found.gravity = (0.0, 0.0, 0.0)
        return found

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

    def _default(self, node: Node, parent: str | None) -> None:
        given = Reading(node)
        name = given.text("class", "main" if parent is None else None)
        if parent is None and name != "main":
            given.fail("class", f"the outermost default class is called {shown(name[:40])}; its name is main")
        given.done()
        known_before = self.defaults.get(name, {}) if parent is None else {}
        self.defaults[name] = {tag: dict(x) for tag, x in (self.defaults[parent] if parent else known_before).items()}
        for child in node.each():
            if child.tag != "default":
                child.attributes.taken.update(child.attributes)
                self.defaults[name][child.tag] = _over(self.defaults[name].get(child.tag, {}), child)
        for child in node.all("default"):
            self._default(child, name)

    def _reading(self, node: Node, childclass: str | None, *tags: str) -> Reading:
        """Return the attributes of an element with the defaults of its class."""
        name = node.attributes.get("class") or childclass or "main"
        known(node, name, self.defaults, "default class")
        inherited: Inherited = {}
        for tag in tags or (node.tag,):
            inherited |= self.defaults[name].get(tag, {})
        inherited.pop("class", None)
        return Reading(node, _over(inherited, node))

    # Bodies -----------------------------------------------------------------------------------------------------

    def _tree(self, node: Node, link: Link | None, pose: Pose, childclass: str | None) -> list[Inertial]:
        """Read a body, or a frame in a body at a pose; return the masses of its geoms."""
        parts = []
        for child in node.each():
            if child.tag == "body":
                self._body(child, link, pose, childclass)
            elif child.tag == "frame":
                given = Reading(child)
                inner = pose @ self._pose(given)
                given.done(("name", "childclass"))
                own = child.attributes.get("childclass", childclass)  # type: ignore[arg-type]
                parts += self._tree(child, link, inner, own)
            elif child.tag in ("joint", "freejoint"):
                if link is None:
                    child.fail("the world has no joints; put the joint into a body")
                self._joint(child, link, pose, childclass)
            elif child.tag == "geom":
                parts += self._geom(child, link, pose, childclass)
            elif child.tag == "site":
                given = self._reading(child, childclass)
                if given.has("fromto"):
                    start, end = np.split(vector(given.numbers("fromto", 6)), 2)
                    at = Pose((start + end) / 2, self._along(child, start - end))
                else:
                    at = self._pose(given)
                if name := given.text("name", ""):
                    self.sites[name] = link, pose @ at
                self.linkage.leave("sites", child)
            elif child.tag in _IN_BODIES:
                self.linkage.leave(f"{child.tag}s", child)
            elif child.tag not in ("inertial",):
                child.fail(f"<{child.tag}> does not map; alfmu takes {', '.join(_TREE)}")
        return parts

    def _body(self, node: Node, parent: Link | None, pose: Pose, childclass: str | None) -> None:
        given = Reading(node)
        name = given.text("name", f"body{len(self.links) + 1}")
        childclass = given.text("childclass", childclass or "main")
        own = self._pose(given)
        given.refuse(
            {"mocap": "use a joint with a law, as in docs of motion", "gravcomp": "alfmu's gravity acts on all bodies"}
        )
        given.done(("user", "sleep"))
        if name in self.links:
            node.fail(f"there is a body {shown(name[:60])} already; names are used once")
        nothing = Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
        link = Link(name, node, parent, pose @ own, nothing)
        self.links[name] = link
        self.linkage.links.append(link)
        parts = self._tree(node, link, Pose(), childclass)
        inertial = node.one("inertial")
        if inertial is not None:
            link.inertial = self._inertial(Reading(inertial))
        if parts:  # geoms define the inertia without an inertial, or if the compiler setting demands it
            link.inertial = solids.together(parts)
        free = any(joint.kind == "free" for joint in link.joints)
        if free and (link.parent is not None or len(link.joints) > 1):
            node.fail("a free joint stands alone, in a body of the world")

    def _inertial(self, given: Reading) -> Inertial:
        at = self._pose(given)
        mass = given.positive("mass")
        if given.has("fullinertia"):
            xx, yy, zz, xy, xz, yz = given.numbers("fullinertia", 6)
            matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            matrix = np.diag(given.numbers("diaginertia", 3))
        given.done()
        return Inertial(mass, at.place, at.turn @ matrix @ at.turn.T)

    def _pose(self, given: Reading) -> Pose:
        ways = [name for name in _ATTITUDES if given.has(name)]
        if len(ways) > 1:
            given.node.fail(f"its attitude is given by {' and by '.join(ways)}; give one of them")
        turn = self._turn(given, ways[0]) if ways else np.eye(3)
        return Pose(vector(given.numbers("pos", 3, (0.0, 0.0, 0.0))), turn)

    def _turn(self, given: Reading, how: str) -> Array:
        x = vector(given.numbers(how, _ATTITUDES[how]))
        if how == "euler":
            return turned(self.settings.euler, [self.settings.angle(a) for a in x])
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

    def _along(self, node: Node, direction: Array) -> Array:
        """Return the smallest rotation of the z axis to a direction."""
        size = float(np.linalg.norm(direction))
        if not size > 0:
            node.fail("its two ends are one point")
        z = direction / size
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
            node.fail(f"there is a joint {shown(name[:60])} already; names are used once")
        hinge = kind == "hinge"
        angle = self.settings.angle if hinge else float
        point, axis = vector(given.numbers("pos", 3, (0, 0, 0))), vector(given.numbers("axis", 3, (0, 0, 1)))
        if not np.linalg.norm(axis) > 0:
            given.fail("axis", "the axis has no direction")
        first = "alfmu takes linear ones; give one number"
        stiffness, damping = (self._linear(given, each, first) for each in ("stiffness", "damping"))
        joint = Joint(
            name,
            {"hinge": "revolute", "slide": "prismatic", "ball": "spherical", "free": "free"}[kind],
            node,
            frame.at(point),
            (frame.turn @ axis,) if kind in ("hinge", "slide") else (),
            reference=angle(given.number("ref", 0.0)) if kind in ("hinge", "slide") else 0.0,
            stiffness=(stiffness,),
            damping=(damping,),
            rest=(angle(given.number("springref", 0.0)),) if kind in ("hinge", "slide") else (0.0,),
            armature=given.positive("armature", 0.0),
        )
        joint.start = {"ball": (1.0, 0.0, 0.0, 0.0), "free": ()}.get(kind, (joint.reference,))
        joint.rates = {"ball": (0.0,) * 3, "free": (0.0,) * 6}.get(kind, (0.0,))
        if kind == "free" and not free:
            for each in ("stiffness", "damping", "armature", "frictionloss"):
                if given.number(each, 0.0):
                    given.fail(
                        each, f"{each} of a free joint does not map; use <freejoint/>, or three slides and a ball"
                    )
        if kind == "ball" and stiffness:
            given.fail("stiffness", "the spring of a ball joint does not map; use three hinges")
        if "frictionloss" not in self.settings.off:
            given.refuse(
                {"frictionloss": "alfmu's dry friction follows from the joint's reaction (`Mechanism.friction`)"}
            )
        given.refuse(
            {
                "springdamper": "give stiffness and damping",
                "actuatorgravcomp": "alfmu's gravity acts on all bodies",
                "align": "it moves frames, not bodies; leave it out",
                "actuatorfrcrange": "limit the motor by forcerange",
            }
        )
        limits = given.numbers("range", 2, (0.0, 0.0))
        limited = given.text("limited", "auto")
        if (limited == "true" or (limited == "auto" and self.settings.autolimits and any(limits))) and (
            not self.settings.off & {"limit", "constraint"}
        ):
            self.linkage.warn("limits of joints", node)
            if kind in ("hinge", "slide"):
                joint.limits = ((angle(limits[0]), angle(limits[1])),)
        given.done(
            ("class", "group", "user", "type", "pos", "axis", "ref", "springref", "solreflimit", "solimplimit",
             "solreffriction", "solimpfriction", "margin", "align", "frictionloss", "range", "limited",
             "actuatorfrclimited")
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

    def _geom(self, node: Node, link: Link | None, frame: Pose, childclass: str | None) -> list[Inertial]:
        given = self._reading(node, childclass)
        kind = given.text("type", "mesh" if given.has("mesh") else "sphere")
        masks = [int(given.number(name, 1)) for name in ("contype", "conaffinity")]
        self.geoms.append((link, node, masks[0], masks[1]))
        given.refuse({"fluidshape": _MEDIUM})
        given.done((*_HARMLESS_GEOM, "fluidcoef", "fluidshape"))
        self.linkage.leave("shapes of geoms", node)
        if link is None or kind in ("plane", "hfield"):
            return []
        needed = self.settings.from_geoms != "false" and not (
            self.settings.from_geoms == "auto" and _holder(node).one("inertial") is not None
        )
        if not needed or int(given.number("group", 0)) not in self.settings.groups:
            return []
        mass = given.positive("mass") if given.has("mass") else None
        density = given.positive("density", 1000.0)
        if mass == 0 or (mass is None and density == 0):
            return []
        if kind not in _SIZES:
            node.fail(
                f"a geom of type {shown(kind[:40])} gives no inertia here; give its body an <inertial>, or the geom "
                'mass="0"'
            )
        if given.flag("shellinertia", False):
            node.fail("the inertia of shells does not map; give the body an <inertial>")
        if given.has("mesh"):
            node.fail("a geom fitted to a mesh has a size that alfmu does not know; give the body an <inertial>")
        solid, at = self._solid(given, kind)
        return [solids.placed(solid, density * solid.volume if mass is None else mass, frame @ at)]

    def _solid(self, given: Reading, kind: str) -> tuple[solids.Solid, Pose]:
        count = _SIZES[kind]
        if given.has("fromto") and kind in ("capsule", "cylinder", "box", "ellipsoid"):
            start, end = np.split(vector(given.numbers("fromto", 6)), 2)
            size = given.numbers("size", range(1, 4))
            half = float(np.linalg.norm(end - start)) / 2
            sizes = [size[0], half] if count == 2 else [size[0], size[0], half]
            at = Pose((start + end) / 2, self._along(given.node, start - end))
        else:
            sizes = given.numbers("size", range(count, 4))[:count]
            at = self._pose(given)
        if min(sizes) <= 0:
            given.fail("size", f"a {kind} has sizes above zero")
        make = getattr(solids, kind)
        return make(*sizes), at

    # Closures of loops ------------------------------------------------------------------------------------------

    def _equalities(self, section: Node) -> None:
        if self.settings.off & {"equality", "constraint"}:
            self.linkage.leave("equality constraints, which the options disable", section)
            return
        for i, node in enumerate(section.each()):
            if node.tag not in ("connect", "weld", "joint"):
                node.fail(f"an equality of kind <{node.tag}> does not map; alfmu takes connect, weld and joint")
            given = self._reading(node, None, "equality")
            name = given.text("name", f"{node.tag}{i + 1}")
            if not given.flag("active", True):
                self.linkage.leave("equality constraints that are not active", node)
                continue
            if node.tag == "joint":
                of = self._scalar(given, "joint1")
                by = self._scalar(given, "joint2") if given.has("joint2") else None
                given_ones = given.numbers("polycoef", range(1, 6), _POLYNOMIAL)
                coefficients = [*given_ones, *_POLYNOMIAL[len(given_ones) :]]
                self.linkage.couplings.append(Coupling(name, node, of, by, coefficients))
            else:
                self.linkage.closures.append(self._equality(given, name))
            if given.has("solref") or given.has("solimp"):
                self.linkage.leave(_SOLVER, node)
            given.done(("class", "solref", "solimp", "user", "anchor", "relpose"))

    def _scalar(self, given: Reading, which: str) -> Joint:
        name = given.text(which)
        known(given.node, name, self.joints, "joint")
        joint = self.joints[name]
        if joint.kind not in ("revolute", "prismatic"):
            given.fail(which, f"{which} {shown(name)} is no hinge and no slide")
        return joint

    def _equality(self, given: Reading, name: str) -> Closure:
        node = given.node
        kind = "spherical" if node.tag == "connect" else "weld"
        if given.has("site1"):
            places = []
            for which in ("site1", "site2"):
                site = given.text(which)
                known(node, site, self.sites, "site")
                places.append(self.sites[site])
            return Closure(name, kind, node, places[0], places[1])
        first, second = self._link(given, "body1"), self._link(given, "body2", "world")
        apart = self._at_reference(first).inverse @ self._at_reference(second)
        if kind == "spherical":
            anchor = vector(given.numbers("anchor", 3))
            return Closure(name, kind, node, (first, Pose(anchor)), (second, Pose(apart.inverse.at(anchor))))
        # The anchor is given in the frame of the second body.
        anchor = vector(given.numbers("anchor", 3, (0, 0, 0)))
        if not given.number("torquescale", 1.0) > 0:
            given.fail("torquescale", "a weld that leaves turns free does not map; use connect")
        posed = given.numbers("relpose", 7, (0, 1, 0, 0, 0, 0, 0))
        if any(posed[3:]):
            # MuJoCo fixes the anchor at the position of relpose.
            here = Pose(vector(posed[:3]), of_quaternion(posed[3:]))
            return Closure(name, kind, node, (first, here), (second, Pose(anchor)))
        return Closure(name, kind, node, (first, apart @ Pose(anchor)), (second, Pose(anchor)))

    def _at_reference(self, link: Link | None) -> Pose:
        return place(link, self.linkage.references, self.zero)

    def _link(self, given: Reading, which: str, default: str | None = None) -> Link | None:
        name = given.text(which, default)
        if name == "world":
            return None
        known(given.node, name, self.links, "body")
        return self.links[name]

    # Actuators --------------------------------------------------------------------------------------------------

    def _actuator(self, node: Node) -> None:
        kind = node.tag
        if kind not in _ACTUATORS:
            node.fail(f"an actuator of kind <{kind}> does not map; alfmu takes {', '.join(_ACTUATORS)} on joints")
        given = self._reading(node, None, *(t for t in _ACTUATORS if t != kind), kind)
        for name, (_, origin) in given._given.items():
            if name not in _SHARED and origin.tag != kind:
                origin.fail(f"{name} of <{origin.tag}> counts for the <{kind}> in line {node.line} too; give it there")
        for each in ("jointinparent", "tendon", "site", "body", "slidersite", "cranksite", "refsite"):
            if given.has(each):
                given.fail(each, f"{each} does not map: alfmu takes motors on joints")
        joint = self._scalar(given, "joint")
        name = given.text("name", f"{joint.name}_{kind}")
        rotary = joint.kind == "revolute"
        gear = given.numbers("gear", range(1, 7), (1.0,))[0]
        motor = Motor(name, node, joint, "N.m" if rotary else "N", gear)
        if kind == "position":
            kp, kv = given.positive("kp", 1.0), given.positive("kv", 0.0)
            motor.gain, motor.bias, motor.unit = kp, (0.0, -kp, -kv), "rad" if rotary else "m"
        elif kind == "velocity":
            kv = given.positive("kv", 1.0)
            motor.gain, motor.bias, motor.unit = kv, (0.0, 0.0, -kv), "rad/s" if rotary else "m/s"
        elif kind == "general":
            if given.choice("gaintype", ("fixed",), "fixed"):
                motor.gain = given.numbers("gainprm", range(1, 11), (1.0,))[0]
            bias = given.choice("biastype", ("none", "affine"), "none")
            prm = [*given.numbers("biasprm", range(1, 11), (0.0,)), 0.0, 0.0]
            motor.bias = (prm[0], prm[1], prm[2]) if bias == "affine" else (0.0, 0.0, 0.0)
            motor.unit = motor.unit if bias == "none" else "1"
        motor.control = self._range(given, "ctrl")
        motor.force = self._range(given, "force")
        given.refuse(dict.fromkeys(_DYNAMICS, "alfmu takes actuators without dynamics; give the input what they make"))
        given.done(("class", "group", "user", "ctrllimited", "forcelimited", "lengthrange", "actlimited", "actrange",
                    "dynprm", "actearly", "interp"))  # fmt: skip
        self.linkage.motors.append(motor)

    def _range(self, given: Reading, what: str) -> tuple[float, float] | None:
        low, high = given.numbers(f"{what}range", 2, (0.0, 0.0))
        limited = given.choice(f"{what}limited", ("true", "false", "auto"), "auto")
        if limited == "false" or (limited == "auto" and not (self.settings.autolimits and (low or high))):
            return None
        if not low < high:
            given.fail(f"{what}range", f"{what}range is from {low:g} to {high:g}; give the smaller number first")
        return low, high

    # Contacts ---------------------------------------------------------------------------------------------------

    def _contacts(self) -> None:
        """Reject a file whose bodies could touch each other."""
        excluded = set()
        for section in self.root.all("contact"):
            for pair in section.all("pair"):
                pair.fail(f"contacts do not map; {_CONTACTS}")
            for each in section.all("exclude"):
                given = Reading(each)
                excluded.add(frozenset((given.text("body1"), given.text("body2"))))
        for i, (one, node, type1, affinity1) in enumerate(self.geoms):
            for two, other, type2, affinity2 in self.geoms[:i]:
                a, b = _moving(one), _moving(two)
                if a is b or not (type1 & affinity2 or type2 & affinity1):
                    continue
                # MuJoCo ignores contacts of a body with its parent, unless that is the world.
                related = a is not None and b is not None and (_moving(a.parent) is b or _moving(b.parent) is a)
                if related and "filterparent" not in self.settings.off:
                    continue
                names = [link.name if link is not None else "world" for link in (two, one)]
                if frozenset(names) not in excluded:
                    node.fail(
                        f"this geom and that in line {other.line} could touch, of {names[0]} and {names[1]}; contacts "
                        f"do not map; {_CONTACTS}"
                    )

    # Start ------------------------------------------------------------------------------------------------------

    def _start(self, key: str) -> None:
        keys = [each for section in self.root.all("keyframe") for each in section.all("key")]
        named = {each.attributes.get("name", str(i)): each for i, each in enumerate(keys)}
        for joint in self.linkage.joints:
            if joint.kind == "free":
                pose = self._at_reference(next(link for link in self.linkage.links if joint in link.joints))
                joint.start = (*pose.place.tolist(), *quaternion(pose.turn).tolist())
        rest = [each for name, each in named.items() if name != key]
        self.linkage.leave("keyframes, one of which --option key=NAME takes as the start", *rest)
        if not key:
            return
        known(self.root, key, named, "keyframe")
        given = Reading(named[key])
        widths = {"spherical": (4, 3), "free": (7, 6)}
        sizes = [widths.get(joint.kind, (1, 1)) for joint in self.linkage.joints]
        positions = given.numbers("qpos", sum(a for a, _ in sizes)) if given.has("qpos") else None
        rates = given.numbers("qvel", sum(b for _, b in sizes)) if given.has("qvel") else None
        given.refuse(dict.fromkeys(("act", "mpos", "mquat"), "alfmu has no such state"))
        if given.has("ctrl"):
            motors = self.linkage.motors
            for motor, x in zip(motors, given.numbers("ctrl", len(motors)), strict=True):
                motor.start = x
        given.done(("name", "time"))
        for joint, (a, b) in zip(self.linkage.joints, sizes, strict=True):
            if positions is not None:
                self.linkage.posed = True
                joint.start, positions = tuple(positions[:a]), positions[a:]
                e = joint.start[-4:]
                if a > 1 and not any(e):
                    given.fail("qpos", f"the quaternion of {joint.name} is zero")
            if rates is not None:
                joint.rates, rates = tuple(rates[:b]), rates[b:]


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
    'say <flag contact="disable"/> in <option>, exclude the pair, or leave contacts out with --option contacts=leave'
)


def _moving(link: Link | None) -> Link | None:
    """Return the link that carries one without joints, None for the world."""
    while link is not None and not link.joints:
        link = link.parent
    return link


def _holder(node: Node) -> Node:
    """Return the body of a geom, skipping frames."""
    found = node.parent
    while found is not None and found.tag == "frame":
        found = found.parent
    assert found is not None
    return found


def _include(node: Node, folder: Path, depth: int, read: list[Path]) -> None:
    """Replace <include> elements by the elements of the included files."""
    children = []
    for child in node.children:
        if child.tag != "include":
            _include(child, folder, depth, read)
            children.append(child)
            continue
        given = Reading(child)
        name = given.text("file")
        given.done()
        if depth >= _DEEPEST:
            child.fail(f"files include each other more than {_DEEPEST} deep")
        path = (child.file.parent / name).resolve()
        if Path(name).is_absolute() or not path.is_relative_to(folder):
            child.fail(f"{shown(name[:60])} is outside the folder of the file; alfmu includes files in it alone")
        if not path.is_file():
            child.fail(f"there is no file {shown(name[:60])}")
        read.append(path)
        if len(read) > _FILES:
            child.fail(f"more than {_FILES} files are included")
        root = parsed(path)
        _include(root, folder, depth + 1, read)
        for each in root.each():
            each.parent = node
        children += root.children
    node.children = children
