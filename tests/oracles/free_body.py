"""Newton's and Euler's laws for each body of a mechanism, from what can be read of it: forces must balance.

Give it the places and accelerations of all bodies, then cut every joint by `push`; where nothing is left over on any
body, and the joint forces are unique, they are right.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation


def turn(angle: float) -> np.ndarray:
    """Rotation matrix."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


class Balance:
    """Forces and moments about the centres of mass, body by body; `bodies` maps a name to mass, inertia, center."""

    def __init__(self, read: Mapping[str, float], bodies: Mapping[str, tuple], gravity: tuple[float, float]):
        self.read, self.bodies = read, bodies
        self.left = {}
        self.largest = 0.0
        for name, (mass, inertia, _) in bodies.items():
            acceleration = self.vector(name, "a")
            self.left[name] = np.array(
                [*(mass * (np.array(gravity) - acceleration)), -inertia * read[f"{name}.angular_acceleration"]]
            )

    def vector(self, body: str, what: str = "") -> np.ndarray:
        """Place, velocity ("v") or acceleration ("a") of a centre of mass."""
        return np.array([self.read[f"{body}.{what}x"], self.read[f"{body}.{what}y"]])

    def angle(self, body: str) -> float:
        return 0.0 if body == "ground" else self.read[f"{body}.angle"]

    def spin(self, body: str) -> float:
        return 0.0 if body == "ground" else self.read[f"{body}.angular_velocity"]

    def arm(self, body: str, local: tuple[float, float]) -> np.ndarray:
        """From the centre of mass to a point of the body's frame, in ground axes."""
        return turn(self.angle(body)) @ (np.array(local) - self.bodies[body][2])

    def point(self, body: str, local: tuple[float, float]) -> np.ndarray:
        """A point of a body's frame in ground axes."""
        return np.array(local) if body == "ground" else self.vector(body) + self.arm(body, local)

    def velocity(self, body: str, local: tuple[float, float]) -> np.ndarray:
        """Velocity of a point of a body's frame."""
        if body == "ground":
            return np.zeros(2)
        arm = self.arm(body, local)
        return self.vector(body, "v") + self.spin(body) * np.array([-arm[1], arm[0]])

    def push(self, first: str, second: str, at: np.ndarray, force: np.ndarray, moment: float = 0.0) -> None:
        """A force at a ground point, and a moment, on the second body; the opposite on the first."""
        for body, sign in ((second, 1), (first, -1)):
            if body != "ground":
                about = moment + cross(at - self.vector(body), force)
                self.left[body] += sign * np.array([*force, about])
                self.largest = max(self.largest, *np.abs(force), abs(about))

    def joint(
        self, kind: str, name: str, first: str, second: str, at: tuple, *, axis: float = 0.0, of=(0.0, 0.0)
    ) -> None:
        """The reactions read at a joint whose marker on the second body is `at` (`of`: the one on the first)."""
        point, r = self.point(second, at), self.read
        if kind in ("revolute", "weld"):
            force = np.array([r[f"{name}.force.x"], r[f"{name}.force.y"]])
        elif kind in ("prismatic", "point_on_line"):
            force = r[f"{name}.force"] * turn(self.angle(first) + axis)[:, 1]
        else:
            line = point - self.point(first, of)
            force = r[f"{name}.force"] * line / np.linalg.norm(line)
        self.push(first, second, point, force, r[f"{name}.moment"] if kind in ("prismatic", "weld") else 0.0)

    def lack(self) -> float:
        """The largest force or moment left over, relative to the largest that acts."""
        return max(np.abs(x).max() for x in self.left.values()) / self.largest


class SpatialBalance:
    """Forces and moments about the centres of mass of bodies in space; `bodies` maps a name to mass, inertia, center.

    An inertia is three principal moments, or a matrix. Attitudes come from the Euler parameters that are read, by
    SciPy's rotations.
    """

    def __init__(self, read: Mapping[str, float], bodies: Mapping[str, tuple], gravity: tuple[float, float, float]):
        self.read, self.bodies = read, bodies
        self.turns, self.left = {}, {}
        self.largest = 0.0
        for name, (mass, inertia, _) in bodies.items():
            e0, *e = (read[f"{name}.e{i}"] for i in range(4))
            self.turns[name] = Rotation.from_quat([*e, e0]).as_matrix()
            J = self.turns[name] @ (np.diag(inertia) if np.ndim(inertia) == 1 else inertia) @ self.turns[name].T
            w, rate = self.vector(f"{name}.angular_velocity."), self.vector(f"{name}.angular_acceleration.")
            force = mass * (np.array(gravity) - self.vector(f"{name}.a"))
            self.left[name] = np.array([force, -J @ rate - np.cross(w, J @ w)])

    def vector(self, name: str) -> np.ndarray:
        """The three outputs whose names begin like this."""
        return np.array([self.read[name + axis] for axis in "xyz"])

    def arm(self, body: str, local: tuple) -> np.ndarray:
        """From the centre of mass to a point of the body's frame, in ground axes."""
        return self.turns[body] @ (np.array(local, float) - self.bodies[body][2])

    def point(self, body: str, local: tuple) -> np.ndarray:
        """A point of a body's frame in ground axes."""
        return np.array(local, float) if body == "ground" else self.vector(f"{body}.") + self.arm(body, local)

    def velocity(self, body: str, local: tuple) -> np.ndarray:
        """Velocity of a point of a body's frame."""
        if body == "ground":
            return np.zeros(3)
        return self.vector(f"{body}.v") + np.cross(self.vector(f"{body}.angular_velocity."), self.arm(body, local))

    def acceleration(self, body: str, local: tuple) -> np.ndarray:
        """Acceleration of a point of a body's frame."""
        if body == "ground":
            return np.zeros(3)
        w, rate = (self.vector(f"{body}.angular_{k}.") for k in ("velocity", "acceleration"))
        arm = self.arm(body, local)
        return self.vector(f"{body}.a") + np.cross(rate, arm) + np.cross(w, np.cross(w, arm))

    def push(self, first: str, second: str, at: np.ndarray, force: np.ndarray, moment=(0.0, 0.0, 0.0)) -> None:
        """A force at a ground point, and a moment, on the second body; the opposite on the first."""
        for body, sign in ((second, 1), (first, -1)):
            if body != "ground":
                about = np.array(moment) + np.cross(at - self.vector(f"{body}."), force)
                self.left[body] += sign * np.array([force, about])
                self.largest = max(self.largest, *np.abs(force), *np.abs(about))

    def joint(
        self, name: str, first: str, second: str, at: tuple, effort=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0)
    ) -> None:
        """The reactions read at a joint whose marker on the second body is `at`, and a drive's force and moment."""
        moment = self.vector(f"{name}.moment.") if f"{name}.moment.x" in self.read else np.zeros(3)
        self.push(first, second, self.point(second, at), self.vector(f"{name}.force.") + effort, moment + turn)

    def spring(self, first: tuple, second: tuple, stiffness: float, damping: float, rest: float) -> None:
        """A spring-damper between two points, each a body and a place in its frame."""
        a, b = self.point(*first), self.point(*second)
        length = np.linalg.norm(b - a)
        line = (b - a) / length
        rate = line @ (self.velocity(*second) - self.velocity(*first))
        self.push(first[0], second[0], b, -(stiffness * (length - rest) + damping * rate) * line)

    def lack(self) -> float:
        """The largest force or moment left over, relative to the largest that acts."""
        return max(np.abs(x).max() for x in self.left.values()) / self.largest
