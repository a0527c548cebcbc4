"""Linkages in space by the equations of Newton and Euler for each body, and joints by least squares.

The state of a body is its centre of mass, its rotation as a quaternion, its velocity and its angular velocity; no
coordinates are chosen. Joints are rows for the accelerations of both bodies. Gauss's principle of least constraint
gives the accelerations, by a pseudoinverse, which redundant rows do not disturb. DOP853 integrates.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from turned import Hinge, Linkage


def cross(a: NDArray, b: NDArray) -> NDArray:
    """The cross product of two vectors, in a fifth of the time that NumPy takes."""
    (x, y, z), (k, m, n) = a, b
    return np.array([y * n - z * m, z * k - x * n, x * m - y * k])


class NewtonEuler:
    """A linkage as it is assembled, with the ground as its last body."""

    def __init__(self, linkage: Linkage):
        self.linkage, self.count = linkage, len(linkage.links)
        self.names = [each.name for each in linkage.links]
        self.mass = np.array([each.mass for each in linkage.links])
        self.inertia = [each.inertia for each in linkage.links]
        self.centers = np.array([*(each.center for each in linkage.links), np.zeros(3)])

    def motion(self, times: NDArray) -> NDArray:
        """Centres of mass (bodies, 3, times)."""
        start = np.zeros((self.count, 13))
        start[:, :3], start[:, 6] = self.centers[:-1], 1.0
        start[:, 7:] = self._speeds(start)
        found = solve_ivp(self._rates, (0.0, times[-1]), start.ravel(), "DOP853", times, rtol=1e-11, atol=1e-12)
        return found.y.reshape(self.count, 13, -1)[:, :3]

    def _speeds(self, state: NDArray) -> NDArray:
        """Velocities (bodies, 6) with which the joints move as their rates are, the first one by the linkage's rate."""
        rows, _ = self._joints(state)
        first = self.linkage.joints[0]
        driven = np.zeros((self.count + 1, 6))
        part = slice(0, 3) if first.kind == "prismatic" else slice(3, 6)
        driven[self._index(first.second), part] = first.axis
        rows = np.vstack([rows, driven[:-1].ravel()])
        wanted = np.zeros(len(rows))
        wanted[-1] = self.linkage.rate
        speeds = np.linalg.lstsq(rows, wanted, rcond=1e-10)[0]
        assert np.abs(rows @ speeds - wanted).max() < 1e-9
        return speeds.reshape(self.count, 6)

    def accelerations(self, state: NDArray, wrenches: NDArray) -> NDArray:
        """Accelerations (bodies, 6) of a state (bodies, 13) under forces and torques (bodies, 6) beside gravity."""
        return self._rates(0.0, state.ravel(), wrenches.ravel()).reshape(self.count, 13)[:, 7:]

    def _rates(self, _: float, flat: NDArray, pushed: float | NDArray = 0.0) -> NDArray:
        state = flat.reshape(self.count, 13)
        rows, bias = self._joints(state)
        size = 6 * self.count
        M, f = np.zeros((size, size)), np.zeros(size)
        rates = np.zeros_like(state)
        for b in range(self.count):
            R, w = Rotation.from_quat(state[b, 3:7]).as_matrix(), state[b, 10:]
            J = R @ self.inertia[b] @ R.T
            M[6 * b : 6 * b + 3, 6 * b : 6 * b + 3] = self.mass[b] * np.eye(3)
            M[6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = J
            f[6 * b : 6 * b + 3] = self.mass[b] * np.array(self.linkage.gravity)
            f[6 * b + 3 : 6 * b + 6] = -cross(w, J @ w)
            x, y, z, e = state[b, 3:7]
            rates[b, :3] = state[b, 7:10]
            rates[b, 3:7] = 0.5 * np.array(
                [
                    e * w[0] + w[1] * z - w[2] * y,
                    e * w[1] + w[2] * x - w[0] * z,
                    e * w[2] + w[0] * y - w[1] * x,
                    -w[0] * x - w[1] * y - w[2] * z,
                ]
            )
        # Of all accelerations that the joints allow, the nearest to the free ones in the metric of M (Gauss).
        root = np.linalg.inv(np.linalg.cholesky(M))
        free = root.T @ root @ (f + pushed)
        change = np.linalg.lstsq(rows @ root.T, -bias - rows @ free, rcond=1e-8)[0]
        rates[:, 7:] = (free + root.T @ change).reshape(self.count, 6)
        return rates.ravel()

    def _joints(self, state: NDArray) -> tuple[NDArray, NDArray]:
        """Rows for the accelerations (v', w') of all bodies, and what velocities add to them."""
        rows, bias = [], []
        for joint in self.linkage.joints:
            found = self._joint(joint, state)
            rows += [row[:-1].ravel() for row, _ in found]
            bias += [x for _, x in found]
        return np.array(rows), np.array(bias)

    def _index(self, name: str | None) -> int:
        return self.count if name is None else self.names.index(name)

    def _joint(self, joint: Hinge, state: NDArray) -> list[tuple[NDArray, float]]:
        i, j = self._index(joint.first), self._index(joint.second)
        (R, x, v, w), (R2, x2, v2, w2) = (self._body(state, b) for b in (i, j))
        arm, arm2 = R @ (joint.point - self.centers[i]), R2 @ (joint.point - self.centers[j])
        axis, u = R @ joint.axis, np.eye(3)
        turn = w2 - w
        apart, speed = x2 + arm2 - x - arm, v2 + cross(w2, arm2) - v - cross(w, arm)
        bent = cross(w2, cross(w2, arm2)) - cross(w, cross(w, arm))

        def row(n: NDArray, on: NDArray, on2: NDArray, linear: bool = True) -> NDArray:
            """n by the relative acceleration of points, `on` and `on2` by the angular accelerations."""
            made = np.zeros((self.count + 1, 6))
            made[j, 3:] += on2
            made[i, 3:] += on
            if linear:
                made[j, :3] += n
                made[i, :3] -= n
            return made

        normals = R @ np.linalg.svd(np.array(joint.axis)[None])[2][1:].T
        found = []
        if joint.kind == "prismatic":
            for n in normals.T:
                moved = cross(w, n)
                value = n @ bent + 2 * moved @ speed + cross(w, moved) @ apart
                found.append((row(n, -cross(arm, n) + cross(n, apart), cross(arm2, n)), value))
            found += [(row(n, -n, n, False), cross(w, n) @ turn) for n in (R @ u).T]
            return found
        found += [(row(n, -cross(arm, n), cross(arm2, n)), n @ bent) for n in u]
        if joint.kind == "revolute":
            found += [(row(n, -n, n, False), cross(w, n) @ turn) for n in normals.T]
        if joint.kind == "universal":
            other = R2 @ joint.other
            both = cross(axis, other)
            rate = cross(cross(w, axis), other) + cross(axis, cross(w2, other))
            found.append((row(both, -both, both, False), rate @ turn))
        return found

    def _body(self, state: NDArray, b: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        if b == self.count:
            return np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3)
        x = state[b]
        return Rotation.from_quat(x[3:7]).as_matrix(), x[:3], x[7:10], x[10:]
