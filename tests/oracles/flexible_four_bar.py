"""Four-bar with a flexible coupler, by Newton's and Euler's laws on each of its four bars: no energies, no multipliers.

The state is the angle of the crank and the bend beta of the coupler with their rates. Trigonometry closes the loop, and
22 linear equations give the accelerations of the four bars together with the forces in the five joints: the laws of
motion of each bar, and equal accelerations of the two points that meet in a joint.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

BARS = ("crank", "near", "far", "rocker")
JOINTS = {  # first and second bar, and which end of each (0 start, 1 end); None is the ground
    "O": (None, 0, "crank", 0),
    "A": ("crank", 1, "near", 0),
    "B": ("near", 1, "far", 0),
    "C": ("far", 1, "rocker", 1),
    "D": (None, 0, "rocker", 0),
}


@dataclass(frozen=True)
class FlexibleFourBar:
    """Dimensions [m], masses [kg], spring-damper of the joint B, torque on the crank."""

    l0: float = 1.0
    l1: float = 0.3
    l2: float = 0.9
    l3: float = 0.7
    m1: float = 0.3
    m2: float = 0.9
    m3: float = 0.7
    stiffness: float = 1e5
    damping: float = 1.0
    rest: float = 0.0
    g: float = 9.81
    torque: float = 0.0

    @property
    def lengths(self) -> dict[str, float]:
        return dict(zip(BARS, (self.l1, self.l2 / 2, self.l2 / 2, self.l3), strict=True))

    @property
    def masses(self) -> dict[str, float]:
        return dict(zip(BARS, (self.m1, self.m2 / 2, self.m2 / 2, self.m3), strict=True))

    def angles(self, th: float, beta: float) -> dict[str, float]:
        """Angles of the bars from the x axis; C lies to the left of the way from A to D."""
        ax, ay = self.l1 * math.cos(th), self.l1 * math.sin(th)
        line = self.l2 * math.cos(beta / 2)  # from A to C
        to_d = math.hypot(self.l0 - ax, ay)
        along = (to_d**2 + line**2 - self.l3**2) / (2 * to_d)  # A to the foot of C on the way from A to D
        across = math.sqrt(line**2 - along**2)
        ux, uy = (self.l0 - ax) / to_d, -ay / to_d
        cx, cy = ax + along * ux - across * uy, ay + along * uy + across * ux
        mean = math.atan2(cy - ay, cx - ax)
        return {
            "crank": th,
            "near": mean - beta / 2,
            "far": mean + beta / 2,
            "rocker": math.atan2(cy, cx - self.l0),
        }

    def spins(self, angles: dict[str, float], w: float, beta_rate: float) -> dict[str, float]:
        """Angular velocities: C has one velocity, whether reached by the coupler or by the rocker."""
        h = self.l2 / 2
        c = {k: math.cos(x) for k, x in angles.items()}
        s = {k: math.sin(x) for k, x in angles.items()}
        # l1 w e1 + h wn en + h (wn + beta') ef = l3 wr er, with e = (-sin, cos)
        a, b = -h * (s["near"] + s["far"]), self.l3 * s["rocker"]
        d, e = h * (c["near"] + c["far"]), -self.l3 * c["rocker"]
        rx = self.l1 * w * s["crank"] + h * beta_rate * s["far"]
        ry = -self.l1 * w * c["crank"] - h * beta_rate * c["far"]
        det = a * e - b * d
        near, rocker = (rx * e - b * ry) / det, (a * ry - d * rx) / det
        return {"crank": w, "near": near, "far": near + beta_rate, "rocker": rocker}

    def moment(self, beta: float, beta_rate: float) -> float:
        """Moment on the far half from the near one."""
        return -self.stiffness * (beta - self.rest) - self.damping * beta_rate

    def accelerations(self, th: float, beta: float, w: float, beta_rate: float) -> dict[str, float]:
        """Accelerations of all bars and forces in all joints, on the second bar from the first."""
        angles = self.angles(th, beta)
        spins = self.spins(angles, w, beta_rate)
        A, r = np.zeros((22, 22)), np.zeros(22)
        place = {bar: 3 * i for i, bar in enumerate(BARS)}
        moments = dict.fromkeys(BARS, 0.0)
        moments["crank"] += self.torque
        moments["far"] += self.moment(beta, beta_rate)
        moments["near"] -= self.moment(beta, beta_rate)
        for bar, i in place.items():
            m, l = self.masses[bar], self.lengths[bar]
            A[i, i] = A[i + 1, i + 1] = m
            A[i + 2, i + 2] = m * l**2 / 12
            r[i : i + 3] = 0.0, -m * self.g, moments[bar]
        for k, (first, first_end, second, second_end) in enumerate(JOINTS.values()):
            force, meet = 12 + 2 * k, 12 + 2 * k
            for bar, end, sign in ((first, first_end, -1), (second, second_end, 1)):
                if bar is None:
                    continue
                i = place[bar]
                half = (end - 0.5) * self.lengths[bar]
                x, y = half * math.cos(angles[bar]), half * math.sin(angles[bar])
                A[i, force] -= sign
                A[i + 1, force + 1] -= sign
                A[i + 2, force] -= -sign * y
                A[i + 2, force + 1] -= sign * x
                A[meet, i], A[meet, i + 2] = sign, -sign * y
                A[meet + 1, i + 1], A[meet + 1, i + 2] = sign, sign * x
                r[meet] += sign * x * spins[bar] ** 2
                r[meet + 1] += sign * y * spins[bar] ** 2
        x = np.linalg.solve(A, r)
        found = {}
        for bar, i in place.items():
            found |= {f"{bar}.ax": x[i], f"{bar}.ay": x[i + 1], f"{bar}.angular_acceleration": x[i + 2]}
        for k, joint in enumerate(JOINTS):
            found |= {f"{joint}.force.x": x[12 + 2 * k], f"{joint}.force.y": x[13 + 2 * k]}
        return found

    def right_side(self) -> Callable[[float, np.ndarray], list[float]]:
        """Rates of [th, beta, th', beta']."""

        def rates(t: float, y: np.ndarray) -> list[float]:
            a = self.accelerations(*y)
            bend = a["far.angular_acceleration"] - a["near.angular_acceleration"]
            return [y[2], y[3], a["crank.angular_acceleration"], bend]

        return rates
