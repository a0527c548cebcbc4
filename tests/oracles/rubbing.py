"""A slider-crank with Coulomb friction in all joints, in one coordinate, from event to event by SciPy.

Forces and moments of each body are balanced in ground axes (Newton and Euler), with the friction of each joint as large
as its load says; no constraint, no multiplier and no projection takes part.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

G = 9.81


@dataclass(frozen=True)
class Crank:
    """Lengths [m], masses [kg], coefficients, radii [m] of A, B, C, length of the guide [m], torque [N.m]."""

    l1: float
    l2: float
    m1: float
    m2: float
    m3: float
    mu: tuple[float, float, float, float]
    radii: tuple[float, float, float]
    edges: float
    torque: Callable[[float], float]

    def places(self, th: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Centres of mass and angles of crank, rod and slider (7,), and their first and second derivatives by th."""
        l1, l2 = self.l1, self.l2
        ph = np.arcsin(-l1 * np.sin(th) / l2)
        d = -l1 * np.cos(th) / (l2 * np.cos(ph))
        dd = (l1 * np.sin(th) / l2 + np.sin(ph) * d**2) / np.cos(ph)

        def turned(angle: float, first: float, second: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            e, n = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
            return e, n * first, n * second - e * first**2

        crank, rod = turned(th, 1, 0), turned(ph, d, dd)
        found = []
        for k, angles in enumerate(((th, ph), (1.0, d), (0.0, dd))):
            center = crank[k] * l1 + rod[k] * l2 / 2
            slider = crank[k] * l1 + rod[k] * l2
            found.append(np.array([*(crank[k] * l1 / 2), angles[0], *center, angles[1], slider[0]]))
        return found[0], found[1], found[2]

    def rates(self, th: float) -> np.ndarray:
        """Relative rates of A, B, C and the guide per rate of the crank (4,)."""
        _, d, _ = self.places(th)
        return np.array([d[2], d[5] - d[2], -d[5], d[6]])

    def solved(
        self, t: float, th: float, rate: float, signs: np.ndarray, guess: np.ndarray | None = None
    ) -> tuple[float, np.ndarray]:
        """Second rate of the crank, and the friction of A, B, C and the guide (4,), sliding in these directions."""
        x, d, dd = self.places(th)
        arm1 = self.l1 / 2 * _along(th)
        arm2 = self.l2 / 2 * _along(x[5])
        I1, I2 = self.m1 * self.l1**2 / 12, self.m2 * self.l2**2 / 12
        # Unknown: th'', A, B, C (each x, y; on the later body of the joint), N on the slider.
        K = np.zeros((8, 8))
        right = np.zeros(8)
        masses = [self.m1, self.m1, I1, self.m2, self.m2, I2, self.m3]
        K[:7, 0] = -np.array(masses) * d
        right[:7] = np.array(masses) * dd * rate**2
        right[[1, 4]] += np.array([self.m1, self.m2]) * G
        K[0, 1] = K[1, 2] = 1
        K[0, 3] = K[1, 4] = -1
        K[2, 1:3] = _cross(-arm1)
        K[2, 3:5] = -_cross(arm1)
        K[3, 3] = K[4, 4] = 1
        K[3, 5] = K[4, 6] = -1
        K[5, 3:5] = _cross(-arm2)
        K[5, 5:7] = -_cross(arm2)
        K[6, 5] = 1
        K[7, 6] = K[7, 7] = 1
        right[7] = self.m3 * G
        right[2] -= self.torque(t)
        friction, inverse = np.zeros(4) if guess is None else guess, np.linalg.inv(K)
        for _ in range(200):
            b = right.copy()
            b[2] -= friction[0] - friction[1]
            b[5] -= friction[1] - friction[2]
            b[6] -= friction[3]
            y = inverse @ b
            forces = [np.hypot(*y[1 + 2 * k : 3 + 2 * k]) for k in range(3)]
            loads = [
                *(r * f for r, f in zip(self.radii, forces, strict=True)),
                max(abs(y[7]), 2 * abs(friction[2]) / self.edges),
            ]
            found = -signs * np.array(self.mu) * loads
            if np.abs(found - friction).max() <= 1e-14 * np.abs(found).max():
                break
            friction = found
        return y[0], friction

    def driving(self, th: float, rate: float) -> float:
        """The torque that turns the crank at a constant rate."""
        signs = np.sign(self.rates(th) * rate)

        def second(torque: float) -> float:
            return replace(self, torque=lambda _: torque).solved(0.0, th, rate, signs)[0]

        return brentq(second, -1e3, 1e3, xtol=1e-12)

    def run(self, th: float, rate: float, times: np.ndarray) -> tuple[np.ndarray, list[str]]:
        """Angle and rate of the crank at times (2, k), and what happened on the way: names of events."""
        found, t, names = np.full((2, len(times)), np.nan), times[0], []
        direction = np.sign(rate)
        while True:
            if direction == 0:
                at = self._freed(t, th, times[-1])
                here = (times >= t) & (times <= at)
                found[:, here] = [[th], [0.0]]
                if at >= times[-1]:
                    return found, names
                names.append("freed")
                t, rate, direction = at, 0.0, self._way(at + 1e-9, th)
            signs = np.sign(self.rates(th + 1e-9 * direction) * direction)

            last = [np.zeros(4)]

            def motion(t: float, y: np.ndarray, signs: np.ndarray = signs, last: list = last) -> list[float]:
                second, last[0] = self.solved(t, y[0], y[1], signs, last[0])
                return [y[1], second]

            def stops(t: float, y: np.ndarray, direction: float = direction) -> float:
                return y[1] * direction

            events = [stops, lambda t, y: self.rates(y[0])[2], lambda t, y: self.rates(y[0])[3]]
            stops.direction = -1
            for each in events:
                each.terminal = True
            run = solve_ivp(
                motion, (t, times[-1]), [th, rate], "DOP853", events=events, dense_output=True, rtol=1e-11, atol=1e-12
            )
            here = (times >= t) & (times <= run.t[-1])
            if here.any():
                found[:, here] = run.sol(times[here])
            if run.status == 0:
                return found, names
            t, (th, rate) = run.t[-1], run.y[:, -1]
            which = next(k for k, x in enumerate(run.t_events) if len(x))
            names.append(("stopped", "C", "guide")[which])
            if which == 0:
                rate, direction = 0.0, self._way(t, th)
            else:  # Past the root, so that the next stretch does not begin with it.
                t, th = t + 1e-13, th + 1e-13 * rate

    def _way(self, t: float, th: float) -> float:
        """The direction in which the crank begins to turn from rest, 0 where friction holds it."""
        for way in (1.0, -1.0):
            if self.solved(t, th, 0.0, np.sign(self.rates(th) * way))[0] * way > 0:
                return way
        return 0.0

    def _freed(self, t: float, th: float, end: float) -> float:
        """When the torque sets the crank free."""
        first = t
        while first < end:
            then = min(first + 1e-3, end)
            for way in (1.0, -1.0):
                signs = np.sign(self.rates(th) * way)

                def pull(t: float, signs: np.ndarray = signs, way: float = way) -> float:
                    return self.solved(t, th, 0.0, signs)[0] * way

                if pull(then) > 0:
                    return brentq(pull, first, then, xtol=1e-14) if pull(first) < 0 else first
            first = then
        return end


def _along(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def _cross(arm: np.ndarray) -> np.ndarray:
    """The moment of a force at an arm, as a row."""
    return np.array([-arm[1], arm[0]])
