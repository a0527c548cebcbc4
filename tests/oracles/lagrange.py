"""Lagrange's equations by numbers: a mechanism described by hand, everything else by differences in 60 digits.

A description is what one reads off a sketch: energies and constraints as plain functions of lists of numbers. In 60
digits central differences with a step of 1e-15 are exact to 1e-30, and differences of those with a step of 1e-12 to
1e-24, so that double precision sees no difference from an exact derivative. Nothing is differentiated by rules.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpmath import matrix, mp, mpf

DIGITS = 60
STEP = mpf(10) ** -15
OUTER = mpf(10) ** -12

Numbers = Sequence


def slope(f: Callable, x: Numbers, direction: Numbers, step: mpf = STEP) -> list:
    """Derivative of f (a list of numbers) at x along a direction."""
    ahead = f([a + step * b for a, b in zip(x, direction, strict=True)])
    behind = f([a - step * b for a, b in zip(x, direction, strict=True)])
    return [(a - b) / (2 * step) for a, b in zip(ahead, behind, strict=True)]


def unit(n: int, i: int) -> list:
    """Direction i of n."""
    return [mpf(k == i) for k in range(n)]


@dataclass(frozen=True)
class Description:
    """`poses` gives x, y of the centre of mass and the angle of each body at q; `weights` its mass and inertia.

    `kinetic(q, v)` and `potential(q)` come in addition; `loads(q, v)` are generalised forces that have no potential;
    `paths(q)` are the displacements along which the inputs u act.
    """

    constraints: Callable[[Numbers], list] = lambda q: []
    poses: Callable[[Numbers], list[tuple]] = lambda q: []
    weights: Sequence[tuple] = ()
    kinetic: Callable[[Numbers, Numbers], mpf] = lambda q, v: mpf(0)
    potential: Callable[[Numbers], mpf] = lambda q: mpf(0)
    loads: Callable[[Numbers, Numbers], list] | None = None
    paths: Callable[[Numbers], list] = lambda q: []
    gravity: tuple = (0.0, 0.0)

    def flat(self, q: Numbers) -> list:
        """All poses in one list."""
        return [x for pose in self.poses(q) for x in pose]

    def T(self, q: Numbers, v: Numbers) -> mpf:
        """Kinetic energy, from the velocities of the bodies."""
        rates = slope(self.flat, q, v)
        bodies = sum(
            m * (rates[3 * i] ** 2 + rates[3 * i + 1] ** 2) / 2 + j * rates[3 * i + 2] ** 2 / 2
            for i, (m, j) in enumerate(self.weights)
        )
        return bodies + self.kinetic(q, v)

    def V(self, q: Numbers) -> mpf:
        """Potential energy of weight, and what is added."""
        gx, gy = self.gravity
        weight = sum(m * (gx * x + gy * y) for (x, y, _), (m, _) in zip(self.poses(q), self.weights, strict=True))
        return self.potential(q) - weight

    def equations(self, q: Numbers, v: Numbers, u: Numbers = ()) -> dict[str, matrix]:
        """M, d, f, Phi, C, xi and the energies at q, v, u: Lagrange's equations term by term."""
        with mp.workdps(DIGITS):
            q, v, u = ([mpf(float(x)) for x in y] for y in (q, v, u))
            n = len(q)
            units = [unit(n, i) for i in range(n)]
            # T is quadratic in v: M by polarisation, exactly.
            own = [self.T(q, e) for e in units]
            M = matrix(n)
            for i in range(n):
                for j in range(i + 1):
                    both = self.T(q, [a + b for a, b in zip(units[i], units[j], strict=True)])
                    M[i, j] = M[j, i] = both - own[i] - own[j]

            # d/dt dT/dv - dT/dq at a = 0, with dT/dv along e read off T(v + e) - T(v - e) = 2 e' M v.
            def momentum(at: Numbers) -> list:
                return [
                    (
                        self.T(at, [a + b for a, b in zip(v, e, strict=True)])
                        - self.T(at, [a - b for a, b in zip(v, e, strict=True)])
                    )
                    / 2
                    for e in units
                ]

            turning = slope(momentum, q, v, OUTER)
            d = [a - slope(lambda at: [self.T(at, v)], q, e, OUTER)[0] for a, e in zip(turning, units, strict=True)]
            # f from the potential and the virtual work of loads and inputs.
            f = [-slope(lambda at: [self.V(at)], q, e)[0] for e in units]
            for i, e in enumerate(units):
                f[i] += sum(a * b for a, b in zip(slope(self.paths, q, e), u, strict=True))
            if self.loads is not None:
                f = [a + b for a, b in zip(f, self.loads(q, v), strict=True)]
            Phi = self.constraints(q)
            columns = [slope(self.constraints, q, e) for e in units]
            along = slope(lambda at: slope(self.constraints, at, v), q, v, OUTER)
            return {
                "M": M,
                "d": matrix(d),
                "f": matrix(f),
                "Phi": matrix(Phi),
                "C": matrix(columns).T if Phi else matrix(0, n),
                "xi": -matrix(along) if Phi else matrix(0, 1),
                "kinetic_energy": matrix([self.T(q, v)]),
                "potential_energy": matrix([self.V(q)]),
                "input_power": matrix([sum(a * b for a, b in zip(slope(self.paths, q, v), u, strict=True))]),
            }

    def readings(self, q: Numbers, v: Numbers, a: Numbers) -> list[tuple]:
        """Place, velocity and acceleration of each body, along q + v t + a t^2 / 2."""
        with mp.workdps(DIGITS):
            q, v, a = ([mpf(float(x)) for x in y] for y in (q, v, a))

            def at(t: Numbers) -> list:
                return self.flat([x + y * t[0] + z * t[0] ** 2 / 2 for x, y, z in zip(q, v, a, strict=True)])

            zero, one, h = [mpf(0)], [mpf(1)], OUTER
            here, ahead, behind = at(zero), at([h]), at([-h])
            second = [(x + y - 2 * z) / h**2 for x, y, z in zip(ahead, behind, here, strict=True)]
            flat = list(zip(here, slope(at, zero, one), second, strict=True))
            return [tuple(zip(*flat[i : i + 3], strict=True)) for i in range(0, len(flat), 3)]
