"""Five-bar and four-bar linkage of equal links on their parallelogram branch, where th1 = th3 = th and th2 = th4 = 0.

The motion has one degree of freedom,

    (m1/3 + m3/3 + m2 + m4/4) l^2 th'' = tau - (m1/2 + m3/2 + m2 + m4/2) g l cos th,

and with th, th', th'' known all matrices of the five-bar are written down by hand (Blajer 2002, Fig. 6, misprints
corrected) in 50 digits. Multipliers are those of least norm, by pseudo-inverse, and of the five-bar those by which all
six joints carry least: a unit of [1 0 -1 0 -2 0 2 0] moves nothing, and changes the force along x in A and D by 1 and
-1. The four-bar is the five-bar without its link 4: the first five coordinates and four constraints.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from mpmath import cos, matrix, mp, mpf, pi, sin, sqrt, zeros

from . import ode, pendulum

DIGITS = 50
RANK = 1e-20
"""Pivots below this, relative to the largest entry, are zero: round-off leaves 1e-50, true ones are above 1e-9 here."""


@dataclass(frozen=True)
class Parallelogram:
    """Dimensions of the linkage; `m4` of None is the four-bar."""

    l: float = 1.0
    m1: float = 1.0
    m2: float = 1.0
    m3: float = 1.0
    m4: float | None = 1.0
    g: float = 9.81

    @property
    def inertia(self) -> float:
        return (mpf(self.m1) / 3 + mpf(self.m3) / 3 + self.m2 + mpf(self.m4 or 0) / 4) * mpf(self.l) ** 2

    @property
    def weight(self) -> float:
        return (mpf(self.m1) / 2 + mpf(self.m3) / 2 + self.m2 + mpf(self.m4 or 0) / 2) * self.g * mpf(self.l)

    def acceleration(self, th, torque=0.0):
        """th'' under the sum of the torques on links 1 and 3."""
        return (mpf(torque) - self.weight * cos(th)) / self.inertia

    def swing(self, th: float, w: float, times: np.ndarray) -> np.ndarray:
        """th and th' at `times` under gravity alone, in elliptic functions: th + pi/2 is a pendulum's angle."""
        return _swing(self, th, w, tuple(times)).copy()

    def driven(self, th: float, w: float, times: np.ndarray, torque: float) -> np.ndarray:
        """th and th' at `times` under gravity and a constant torque, by integration."""
        inertia, weight = float(self.inertia), float(self.weight)
        return ode.motion(lambda t, x, v: (torque - weight * np.cos(x)) / inertia, th, w, times)

    def state(self, th, w, torque=0.0) -> tuple[matrix, matrix, matrix]:
        """q, v, a on the branch."""
        l = mpf(self.l)
        th, w, e = mpf(th), mpf(w), self.acceleration(th, torque)
        c, s = cos(th), sin(th)
        q = [th, l * c + l / 2, l * s, 0, th, l * c / 2 + l / 2, l * s / 2, 0]
        tangent = [1, -l * s, l * c, 0, 1, -l * s / 2, l * c / 2, 0]
        bend = [0, -l * c, -l * s, 0, 0, -l * c / 2, -l * s / 2, 0]
        n = 8 if self.m4 is not None else 5
        return (
            matrix(q[:n]),
            matrix([w * x for x in tangent[:n]]),
            matrix([e * x + w**2 * y for x, y in zip(tangent[:n], bend[:n], strict=True)]),
        )

    def equations(self, q, v, torques=(0.0, 0.0)) -> tuple[matrix, matrix, matrix, matrix, matrix]:
        """Phi, C, xi, M, f at any state, as printed (d = 0); `torques` on links 1 and 3."""
        l, g, h = mpf(self.l), mpf(self.g), mpf(self.l) / 2
        full = self.m4 is not None
        th1, x2, y2, th2, th3 = q[:5]
        w1, _, _, w2, w3 = v[:5]
        x4, y4, th4 = q[5:8] if full else (mpf(0),) * 3
        w4 = v[7] if full else mpf(0)
        c1, c2, c3, c4 = (cos(t) for t in (th1, th2, th3, th4))
        s1, s2, s3, s4 = (sin(t) for t in (th1, th2, th3, th4))
        Phi = [
            x2 - h * c2 - l * c1,
            y2 - h * s2 - l * s1,
            x2 + h * c2 - l * c3 - l,
            y2 + h * s2 - l * s3,
            x4 - h * c4 - h * c1,
            y4 - h * s4 - h * s1,
            x4 + h * c4 - h * c3 - l,
            y4 + h * s4 - h * s3,
        ]
        C = [
            [l * s1, 1, 0, h * s2, 0, 0, 0, 0],
            [-l * c1, 0, 1, -h * c2, 0, 0, 0, 0],
            [0, 1, 0, -h * s2, l * s3, 0, 0, 0],
            [0, 0, 1, h * c2, -l * c3, 0, 0, 0],
            [h * s1, 0, 0, 0, 0, 1, 0, h * s4],
            [-h * c1, 0, 0, 0, 0, 0, 1, -h * c4],
            [0, 0, 0, 0, h * s3, 1, 0, -h * s4],
            [0, 0, 0, 0, -h * c3, 0, 1, h * c4],
        ]
        xi = [
            -h * c2 * w2**2 - l * c1 * w1**2,
            -h * s2 * w2**2 - l * s1 * w1**2,
            h * c2 * w2**2 - l * c3 * w3**2,
            h * s2 * w2**2 - l * s3 * w3**2,
            -h * c4 * w4**2 - h * c1 * w1**2,
            -h * s4 * w4**2 - h * s1 * w1**2,
            h * c4 * w4**2 - h * c3 * w3**2,
            h * s4 * w4**2 - h * s3 * w3**2,
        ]
        m1, m2, m3, m4 = (mpf(m or 0) for m in (self.m1, self.m2, self.m3, self.m4))
        M = [m1 * l**2 / 3, m2, m2, m2 * l**2 / 12, m3 * l**2 / 3, m4, m4, m4 * l**2 / 12]
        f = [torques[0] - m1 * g * h * c1, 0, -m2 * g, 0, torques[1] - m3 * g * h * c3, 0, -m4 * g, 0]
        n, rows = (8, 8) if full else (5, 4)
        return (
            matrix(Phi[:rows]),
            matrix([row[:n] for row in C[:rows]]),
            matrix(xi[:rows]),
            mp.diag(M[:n]),
            matrix(f[:n]),
        )

    def multipliers(self, th, w, torques=(0.0, 0.0)) -> np.ndarray:
        """Multipliers at a state of the branch, C' lam = f - M a, with the least sum of squares of all joint forces."""
        with mp.workdps(DIGITS):
            lam, a = self.of_rows(th, w, torques)
            if self.m4 is not None:
                free, ax = matrix([1, 0, -1, 0, -2, 0, 2, 0]), a[5]  # of link 4, which is that of both middles
                apart = (self.m1 - self.m3) * ax - lam[0] - lam[4] + lam[2] + lam[6]  # A less D
                lam -= free * apart / 12  # 10 of the rows, 2 of A and D
            return floats(lam)

    def of_rows(self, th, w, torques=(0.0, 0.0), penalties=None) -> tuple[matrix, matrix]:
        """Multipliers at a state of the branch with the least sum of lam^2 / penalty over the rows alone, and a."""
        with mp.workdps(DIGITS):
            q, v, a = self.state(th, w, sum(map(mpf, torques)))
            _, C, _, M, f = self.equations(q, v, torques)
            root = np.array([sqrt(mpf(x)) for x in (penalties if penalties is not None else [1] * C.rows)])
            weighted = matrix((np.array(C.T.tolist()) * root).tolist())
            return matrix((root * np.array(list(least_norm(weighted, f - M * a)))).tolist()), a

    def accelerations(self, th, w, torque=0.0) -> np.ndarray:
        """Accelerations of all coordinates at a state of the branch."""
        with mp.workdps(DIGITS):
            return floats(self.state(th, w, torque)[2])

    def forces(self, th, w, torques=(0.0, 0.0)) -> dict[str, float]:
        """Multipliers, and forces in all joints on the second link from the first in ground axes, by Newton's law.

        The force on link 2 at B is -(lam1, lam2), at C link 2 gives link 3 (lam3, lam4); likewise E and F with link 4.
        What is left to accelerate the centres of mass of links 1 and 3 comes from the ground.
        """
        lam = [mpf(x) for x in self.multipliers(th, w, torques)]
        with mp.workdps(DIGITS):
            h, th, w = mpf(self.l) / 2, mpf(th), mpf(w)
            e = self.acceleration(th, sum(map(mpf, torques)))
            ax, ay = h * (-sin(th) * e - cos(th) * w**2), h * (cos(th) * e - sin(th) * w**2)
            lam += [mpf(0)] * (8 - len(lam))
            forces = {
                "A": (self.m1 * ax - lam[0] - lam[4], self.m1 * (ay + self.g) - lam[1] - lam[5]),
                "B": (-lam[0], -lam[1]),
                "C": (lam[2], lam[3]),
                "D": (self.m3 * ax - lam[2] - lam[6], self.m3 * (ay + self.g) - lam[3] - lam[7]),
            }
            if self.m4 is not None:
                forces |= {"E": (-lam[4], -lam[5]), "F": (lam[6], lam[7])}
            found = {f"{j}.force.{k}": x for j, pair in forces.items() for k, x in zip("xy", pair, strict=True)}
            found |= {f"multiplier[{i + 1}]": x for i, x in enumerate(lam[: 8 if self.m4 is not None else 4])}
            return {name: float(x) for name, x in found.items()}


def least_norm(A: matrix, b: matrix) -> matrix:
    """x of least norm with A x nearest to b, by full-rank factorisation A = B G (Ben-Israel and Greville, section 1.6):

    A+ = G' (G G')^-1 (B' B)^-1 B', with B the pivot columns of A and G the reduced row echelon form.
    """
    G, B = np.array(A.tolist()), list[int]()  # entries of arrays are taken in a tenth of the time of a matrix's
    rank, largest = 0, max(abs(e) for e in A)
    while rank < min(A.rows, A.cols):
        free = [j for j in range(A.cols) if j not in B]
        size, i, j = max((abs(G[i, j]), i, j) for i in range(rank, A.rows) for j in free)
        if size < RANK * largest:
            break
        G[[rank, i]] = G[[i, rank]]
        G[rank] = G[rank] / G[rank, j]
        for k in range(A.rows):
            if k != rank and G[k, j]:
                G[k] = G[k] - G[rank] * G[k, j]
        B.append(j)
        rank += 1
    G, B = G[:rank], np.array(A.tolist())[:, B]
    y = mp.lu_solve(matrix((B.T @ B).tolist()), matrix((B.T @ np.array(list(b))).tolist()))
    return matrix((G.T @ np.array(list(mp.lu_solve(matrix((G @ G.T).tolist()), y)))).tolist())


def constrained(M: matrix, F: matrix, C: matrix, xi: matrix) -> tuple[matrix, matrix]:
    """a and lam of (9) for constraints of full rank, by elimination."""
    n, l = M.rows, C.rows
    K, b = zeros(n + l), zeros(n + l, 1)
    K[:n, :n], K[:n, n:], K[n:, :n] = M, C.T, C
    b[:n, 0], b[n:, 0] = F, xi
    x = mp.lu_solve(K, b)
    return x[:n, 0], x[n:, 0]


def floats(x: matrix) -> np.ndarray:
    """A column as an array."""
    return np.array([float(e) for e in x])


@cache
def _swing(linkage: Parallelogram, th: float, w: float, times: tuple[float, ...]) -> np.ndarray:
    with mp.workdps(DIGITS):
        frequency = sqrt(linkage.weight / linkage.inertia)
        rows = [pendulum.swing(frequency, th + pi / 2, w, t) for t in times]
        return np.array([[float(phi - pi / 2), float(rate)] for phi, rate in rows])
