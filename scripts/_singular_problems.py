"""The ten problems of the singular benchmark, and their exact motions in 30 digits, independent of alfmu.

Each problem is a tree of rigid bodies whose loops are closed by constraints (`alfmu.studies.trees`). The exact motion
follows one branch in minimal coordinates s: from centre and direction of every body over s, second-order Taylor
arithmetic derives Lagrange's equations, and the extrapolated midpoint rule integrates them.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpmath import mp, mpf, nstr
from numpy.typing import NDArray

from alfmu.studies.trees import GROUND, Body, Closure, Tree
from alfmu.studies.trees import Start as Run

FOLDER = Path(__file__).parents[1] / "docs" / "singular_benchmark"
DIGITS, KEPT = 30, 20
"""Decimal digits of the arithmetic and of the tables."""

DOWN = (0.0, -9.81, 0.0)


@dataclass
class Problem(Tree):
    """A problem: the content of its JSON file."""

    name: str
    title: str
    bodies: list[Body]
    closures: list[Closure]
    points: dict[str, tuple[str, Sequence[float]]]
    """Points at which errors are measured: body, and position in its frame."""
    runs: list[Run]
    stop: float
    independent: list[str]
    """Bodies whose coordinates determine all others on the branch, near the start."""
    gravity: Sequence[float] = DOWN
    every: float = 0.05
    reactions: str = "limit"
    """Behaviour of forces at the singular position: `limit`, or `pole` if one has a pole; `none` if the motion passes
    no singular position or the force of the first closure is not unique."""

    @property
    def times(self) -> NDArray:
        """Return the times of the tables [s]."""
        return np.round(self.every * np.arange(round(self.stop / self.every) + 1), 9)

    @property
    def seen(self) -> list[Closure]:
        """Return the closures whose gaps are measured: of a long row the first, the middle and the last, else all."""
        n = len(self.closures)
        return self.closures if n < 10 else [self.closures[k] for k in (0, n // 2, n - 1)]

    @property
    def read(self) -> list[tuple[str, Sequence[float]]]:
        """Return body and local position of each judged point."""
        sides = [(c.first, c.first_at, c.second, c.second_at) for c in self.seen]
        return [*self.points.values(), *(pair for a, x, b, y in sides for pair in ((a, x), (b, y)))]


def plain(problem: Problem) -> dict[str, Any]:
    """Return the data of the JSON file."""
    return json.loads(json.dumps(asdict(problem)))


def saved(problem: Problem) -> None:
    """Write the JSON file, with a line for each body, closure and run."""
    lines = []
    for key, x in plain(problem).items():
        rows = ",\n  ".join(map(json.dumps, x)) if isinstance(x, list) and isinstance(x[0], dict) else ""
        lines.append(f' "{key}": ' + (f"[\n  {rows}\n ]" if rows else json.dumps(x)))
    text = "{\n" + ",\n".join(lines) + "\n}\n"
    (FOLDER / f"{problem.name}.json").write_text(text, encoding="utf-8")


def loaded(name: str) -> Problem:
    """Return a problem from its JSON file; the long row of identical bodies has no file and is generated."""
    if not (FOLDER / f"{name}.json").exists():
        return PROBLEMS[name]()[0]
    data = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    parts = (("bodies", Body), ("closures", Closure), ("runs", Run))
    return Problem(**data | {key: [kind(**each) for each in data[key]] for key, kind in parts})  # type: ignore[arg-type]


def table(name: str) -> list[dict[str, NDArray]]:
    """Return the reference columns of each run, by name."""
    with (FOLDER / f"{name}.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    numbers = sorted({int(row["run"]) for row in rows})
    return [
        {key: np.array([float(row[key] or "nan") for row in rows if int(row["run"]) == k]) for key in rows[0]}
        for k in numbers
    ]


# Taylor arithmetic ------------------------------------------------------------------------------------------------


class Jet:
    """A value with its first and second derivative by one variable."""

    __slots__ = ("x",)

    def __init__(self, *x: Any):
        self.x = x

    def _with(self, f: Any, d: Any, dd: Any) -> Jet:
        _, a, b = self.x
        return Jet(f, d * a, d * b + dd * a * a)

    def __add__(self, other: Any) -> Jet:
        return Jet(*(a + b for a, b in zip(self.x, _jet(other).x, strict=True)))

    def __mul__(self, other: Any) -> Jet:
        if not isinstance(other, Jet):
            return Jet(*(a * other for a in self.x))
        (a, a1, a2), (b, b1, b2) = self.x, other.x
        return Jet(a * b, a1 * b + a * b1, a2 * b + 2 * a1 * b1 + a * b2)

    def __neg__(self) -> Jet:
        return self * -1

    def __sub__(self, other: Any) -> Jet:
        return self + -other

    def __rsub__(self, other: Any) -> Jet:
        return -self + other

    def __truediv__(self, other: Any) -> Jet:
        return self * (1 / _jet(other))

    def __rtruediv__(self, other: Any) -> Jet:
        x = self.x[0]
        return self._with(1 / x, -1 / x**2, 2 / x**3) * other

    __radd__, __rmul__ = __add__, __mul__


def _jet(x: Any) -> Jet:
    return x if isinstance(x, Jet) else Jet(mpf(x), mpf(0), mpf(0))


class Exact:
    """Functions of numbers and jets in mpmath, with NumPy's names."""

    @staticmethod
    def sin(x: Any) -> Any:
        if not isinstance(x, Jet):
            return mp.sin(x)
        s, c = mp.sin(x.x[0]), mp.cos(x.x[0])
        return x._with(s, c, -s)

    @staticmethod
    def cos(x: Any) -> Any:
        return Exact.sin(x + mp.pi / 2)

    @staticmethod
    def sqrt(x: Any) -> Any:
        if not isinstance(x, Jet):
            return mp.sqrt(x)
        r = mp.sqrt(x.x[0])
        return x._with(r, 1 / (2 * r), -1 / (4 * r**3))


# The motions ------------------------------------------------------------------------------------------------------

Part = tuple[float, float, tuple, tuple]
"""Mass, moment of inertia about the axes across the body's direction, centre, and direction; in the plane the direction
is the x axis of the body's frame."""

Geometry = Callable[[Any, Sequence[Any]], tuple[list[Part], list[tuple]]]
"""Function of NumPy or Exact and coordinates s; returns the parts in the order of bodies, and the points."""


@dataclass
class Motion:
    """The exact motion of a problem on its branch."""

    geometry: Geometry
    starts: list[tuple]
    """Values and rates of s of each run."""
    grid: Sequence[NDArray] = field(default_factory=lambda: [np.linspace(-np.pi, np.pi, 2000)])
    """Values of s that cover the branch."""
    singular: float = 0.0
    """Value of s at which the motion passes a singular position."""
    aligned: Callable[[Any], Any] = mp.sin
    """Function of s that is zero where a loop is aligned."""

    def rates(self, problem: Problem, torque: Any, s: Sequence, w: Sequence) -> list:
        """Return the second rates of s by Lagrange's equations."""
        k = len(s)
        directions = [[mpf(i == j) for j in range(k)] for i in range(k)]
        along = [self.derivatives(s, d) for d in directions]
        bias, square = (along[0], w[0] ** 2) if k == 1 else (self.derivatives(s, w), 1)
        M, r = mp.matrix(k, k), mp.matrix(k, 1)
        for n, (mass, inertia) in enumerate((part[0], part[1]) for part in along[0][0]):
            for i in range(k):
                for weight, which in ((mass, 2), (inertia, 3)):
                    if weight:
                        mine = along[i][0][n][which]
                        for j in range(k):
                            M[i, j] += weight * _dot(mine, along[j][0][n][which], 1, 1)
                        r[i] -= weight * square * _dot(mine, bias[0][n][which], 1, 2)
                r[i] += mass * sum(x.x[1] * g for x, g in zip(along[i][0][n][2], problem.gravity, strict=False) if g)
        r[0] += torque
        return [r[0] / M[0, 0]] if k == 1 else list(mp.lu_solve(M, r))

    def derivatives(self, s: Sequence, w: Sequence, a: Sequence | None = None) -> tuple[list[Part], list[tuple]]:
        """Return the geometry with its first and second time derivatives."""
        a = [mpf(0)] * len(s) if a is None else a
        parts, points = self.geometry(Exact, [Jet(*x) for x in zip(s, w, a, strict=True)])
        return [(m, i, _jets(p), _jets(u)) for m, i, p, u in parts], [_jets(p) for p in points]

    def integrate(self, problem: Problem, run: int, step: float) -> list[tuple[list, list]]:
        """Return s and its rates at the times of the tables, by extrapolated midpoint steps of this length [s]."""
        torque, k = mpf(problem.runs[run].torque), len(self.starts[run][0])

        def rate(y: list) -> list:
            return [*y[k:], *self.rates(problem, torque, y[:k], y[k:])]

        y = [mpf(x) for part in self.starts[run] for x in part]
        found, each = [(y[:k], y[k:])], round(problem.every / step)
        h = mpf(str(problem.every)) / each
        for _ in problem.times[1:]:
            for _ in range(each):
                y = extrapolated(rate, y, h)
            found.append((y[:k], y[k:]))
        return found


def _jets(x: Sequence) -> tuple[Jet, ...]:
    return tuple(map(_jet, x))


def _dot(a: Sequence[Jet], b: Sequence[Jet], i: int, j: int) -> Any:
    return sum(x.x[i] * y.x[j] for x, y in zip(a, b, strict=True))


LEVELS = 9
"""Number of rows of the extrapolation; its order is twice this number."""


def extrapolated(rate: Callable[[list], list], y: list, h: Any, levels: int = LEVELS) -> list:
    """Return the state after one Gragg-Bulirsch-Stoer step."""
    f0, row = rate(y), []
    for level in range(1, levels + 1):
        n = 2 * level
        d = h / n
        before, now = y, [a + d * b for a, b in zip(y, f0, strict=True)]
        for _ in range(n - 1):
            before, now = now, [a + 2 * d * b for a, b in zip(before, rate(now), strict=True)]
        last = rate(now)
        new = [[(a + b + d * c) / 2 for a, b, c in zip(before, now, last, strict=True)]]
        for i, old in enumerate(row, 1):
            factor = mpf(level) ** 2 / mpf(level - i) ** 2 - 1
            new.append([a + (a - b) / factor for a, b in zip(new[-1], old, strict=True)])
        row = new
    return row[-1]


# Reactions in the plane -------------------------------------------------------------------------------------------


def reactions(problem: Problem, parts: Sequence[Part], torque: float) -> NDArray:
    """Return the forces on second bodies in the plane by Newton-Euler, closures (x, y) first; NaN if not unique."""
    index = {body.name: i for i, body in enumerate(problem.bodies)}
    n, columns = len(problem.bodies), []
    at = {name: np.array([[float(x.x[0]) for x in parts[i][k][:2]] for k in (2, 3)]) for name, i in index.items()}

    def place(name: str, local: Sequence[float]) -> NDArray:
        if name == GROUND:
            return np.array(local[:2], float)
        (center, (c, s)), body = at[name], problem.bodies[index[name]]
        x, y = np.subtract(local, body.center)[:2]
        return center + np.array([c * x - s * y, s * x + c * y])

    joints = [(c.first, c.second, place(c.second, c.second_at), c.kind) for c in problem.closures]
    joints += [(body.parent, body.name, place(body.name, (0, 0, 0)), body.joint) for body in problem.bodies]
    for first, second, point, kind in joints:
        loads = [(1, 0, 0), (0, 1, 0)] if kind in ("point", "revolute") else [(0, 1, 0), (0, 0, 1)]
        for fx, fy, moment in loads:
            column = np.zeros(3 * n)
            for name, sign in ((second, 1), (first, -1)):
                if name != GROUND:
                    rx, ry = point - at[name][0]
                    column[3 * index[name] :][:3] += sign * np.array([fx, fy, rx * fy - ry * fx + moment])
            columns.append(column)
    wanted = np.zeros(3 * n)
    for i, (mass, inertia, center, along) in enumerate(parts):
        u, second_rate = ([float(x.x[k]) for x in along] for k in (0, 2))
        turn = u[0] * second_rate[1] - u[1] * second_rate[0]
        force = [mass * (float(x.x[2]) - g) for x, g in zip(center, problem.gravity, strict=False)][:2]
        wanted[3 * i :][:3] = *force, inertia * turn
    wanted[2] -= torque
    A = np.array(columns).T
    U, sizes, V = np.linalg.svd(A)
    rank = int((sizes > 1e-9 * sizes[0]).sum())
    found = V[:rank].T @ ((U.T @ wanted)[:rank] / sizes[:rank])
    return np.where(np.abs(V[rank:]).max(0, initial=0) < 1e-6, found, np.nan)


OFF, CHECKED = 0.05, 3
"""Distance from an aligned position [rad] within which forces are not compared, and number of runs whose steps are
halved until the change is below the last digit of the tables."""


# The problems -----------------------------------------------------------------------------------------------------


def thin(edge: Sequence[float], mass: float = 1.0) -> dict[str, Any]:
    """Return mass, centre and inertia of a thin uniform bar along an edge [m]."""
    e = np.array(edge, float)
    inertia = mass / 12 * (e @ e * np.eye(3) - np.outer(e, e))
    return {"mass": mass, "center": [*map(float, e / 2)], "inertia": inertia.tolist()}


def bar(name: str, parent: str, x: float, length: float = 1.0, mass: float = 1.0, y: float = 0.0) -> Body:
    """Return a thin bar along x on a hinge."""
    return Body(name, parent, (x, y, 0.0), **thin((length, 0, 0), mass))


def link(f: Any, begin: tuple, angle: Any, length: float = 1.0, mass: float = 1.0) -> tuple[Part, tuple]:
    """Return a bar in the plane, and its end."""
    c, s = f.cos(angle), f.sin(angle)
    x, y = begin
    half = length / 2
    return (mass, mass * length**2 / 12, (x + c * half, y + s * half), (c, s)), (x + c * length, y + s * length)


def still(mass: float, length: float, x: Any, y: Any) -> Part:
    """Return a body that translates without rotation, by its centre."""
    return mass, mass * length**2 / 12, (x, y), (1.0, 0.0)


Made = tuple[Problem, Motion]


def particle() -> Made:
    moment = np.zeros((3, 3)).tolist()
    track = [Body("x", GROUND, (0, 0, 0), 0.0, (0, 0, 0), moment, "prismatic", (1, 0, 0))]
    track.append(Body("particle", "x", (0, 0, 0), 1.0, (0, 0, 0), moment, "prismatic", (0, 1, 0)))
    closure = Closure("circle", GROUND, (0, 0, 0), "particle", (0, 0, 0), "distance", length=1.0)
    points = {"P": ("particle", (0, 0, 0))}
    p = Problem("particle", "Particle on a circle", track, [closure], points, [], 4.0, ["particle"])
    p.runs, p.reactions = [Run([1.0, 0.0], [0.0, 5.0])], "none"

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        at = f.cos(s[0]), f.sin(s[0])
        return [(0.0, 0.0, (at[0], 0.0), (1.0, 0.0)), (1.0, 0.0, at, (1.0, 0.0))], [at]

    return p, Motion(geometry, [((0,), (5,))])


def parallelogram(m2: float | None, m4: float | None) -> tuple[list[Body], list[Closure], Geometry]:
    bodies = [bar("link1", GROUND, 0.0), bar("link2", "link1", 1.0, mass=m2 or 0.0), bar("link3", GROUND, 1.0)]
    closures = [Closure("C", "link2", (1, 0, 0), "link3", (1, 0, 0))]
    if m4 is not None:
        bodies.append(bar("link4", "link1", 0.5, mass=m4))
        closures.append(Closure("F", "link4", (1, 0, 0), "link3", (0.5, 0, 0)))

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        (first, B), (third, C) = link(f, (0.0, 0.0), s[0]), link(f, (1.0, 0.0), s[0])
        parts = [first, still(m2 or 0.0, 1.0, B[0] + 0.5, B[1]), third]
        if m4 is not None:
            parts.append(still(m4, 1.0, first[2][0] + 0.5, first[2][1]))
        return parts, [B, C]

    return bodies, closures, geometry


ENDS = {"B": ("link1", (1, 0, 0)), "C": ("link3", (1, 0, 0))}


def five_bar(m2: float) -> Made:
    bodies, closures, geometry = parallelogram(m2, 1.0)
    name, title = "five_bar" if m2 else "five_bar_massless", f"Five-bar linkage, m2 = {m2:g} kg"
    p = Problem(name, title, bodies, closures, ENDS, [Run([0.0] * 4, [2.0, -2.0, 2.0, -2.0])], 4.0, ["link1"])
    return p, Motion(geometry, [((0,), (2,))])


def four_bar(number: int = 50) -> Made:
    bodies, closures, geometry = parallelogram(1.0, None)
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, number)
    runs = []
    for k, th in enumerate(map(float, angles)):
        w = (2.0, 2.0, 0.5)[k % 3]
        runs.append(Run([th, -th, th], [w, -w, w], (4.0, 2.0, 1.0, -3.0, 8.0)[k % 5]))
    title = f"Four-bar linkage under torque, {number} phases"
    p = Problem("four_bar", title, bodies, closures, ENDS, runs, 2.5, ["link1"], every=0.1, reactions="pole")
    return p, Motion(geometry, [((run.q[0],), (run.v[0],)) for run in runs])


def slider_crank() -> Made:
    l, th = 0.5, float(np.pi / 4)
    bodies = [bar("crank", GROUND, 0.0, l), bar("rod", "crank", l, l)]
    bodies.append(Body("slider", GROUND, (0, 0, 0), 1.0, (0, 0, 0), (0.1 * np.eye(3)).tolist(), "prismatic", (1, 0, 0)))
    closures = [Closure("C", "rod", (l, 0, 0), "slider", (0, 0, 0))]
    points = {"B": ("crank", (l, 0, 0)), "C": ("slider", (0, 0, 0))}
    runs = [Run([th, -2 * th, 2 * l * float(np.cos(th))], [0.0, 0.0, 0.0])]
    p = Problem("slider_crank", "Slider-crank of equal links", bodies, closures, points, runs, 3.0, ["crank"])

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        (first, B), x = link(f, (0.0, 0.0), s[0], l), f.cos(s[0]) * (2 * l)
        second, _ = link(f, B, -s[0], l)
        return [first, second, (1.0, 0.1, (x, 0.0), (1.0, 0.0))], [B, (x, 0.0)]

    return p, Motion(geometry, [((th,), (0,))], singular=-np.pi / 2, aligned=mp.cos)


def n_four_bar(loops: int) -> Made:
    bodies, closures, th = [bar("crank1", GROUND, 0.0)], [], float(np.pi / 2)
    q, v = [th], [-1.0]
    for i in range(1, loops + 1):
        bodies += [bar(f"coupler{i}", f"crank{i}", 1.0), bar(f"crank{i + 1}", GROUND, float(i))]
        closures.append(Closure(f"C{i}", f"crank{i + 1}", (1, 0, 0), f"coupler{i}", (1, 0, 0)))
        q, v = [*q, -th, th], [*v, 1.0, -1.0]
    points = {"first": ("crank1", (1, 0, 0)), "last": (f"crank{loops + 1}", (1, 0, 0))}
    name, title = f"n_four_bar_{loops}", f"Row of {loops} four-bars"
    p = Problem(name, title, bodies, closures, points, [Run(q, v)], 2.5, ["crank1"], reactions="pole")

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        (first, P), last = link(f, (0.0, 0.0), s[0]), link(f, (float(loops), 0.0), s[0])[1]
        parts = [first]
        for i in range(1, loops + 1):
            parts += [still(1.0, 1.0, P[0] + (i - 0.5), P[1]), (*first[:2], (first[2][0] + i, first[2][1]), first[3])]
        return parts, [P, last]

    def alike(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        parts, points = n_four_bar(1)[1].geometry(f, s)
        (m, i, *crank), (n, j, *coupler), _ = parts
        many = [(m * (loops + 1), i * (loops + 1), *crank), (n * loops, j * loops, *coupler)]
        return many, [points[0], (points[0][0] + float(loops), points[0][1])]

    return p, Motion(geometry if loops < 3 else alike, [((th,), (-1,))])  # type: ignore[arg-type]


def product(a: Sequence[Sequence], b: Sequence[Sequence]) -> list[list]:
    """Return the product of matrices as lists of rows, skipping zero entries."""

    def nothing(x: Any) -> bool:
        return isinstance(x, (int, float)) and x == 0

    def entry(row: Sequence, column: Sequence) -> Any:
        return sum(x * y for x, y in zip(row, column, strict=True) if not (nothing(x) or nothing(y)))

    return [[entry(row, column) for column in zip(*b, strict=True)] for row in a]


def turned(R: list, axis: Sequence, c: Any, s: Any) -> list:
    """Return R times the rotation about an axis, given by its cosine and sine."""
    x, y, z = axis
    K = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    square = product(K, K)
    rows = [[(i == j) + s * K[i][j] * (K[i][j] != 0) + (1 - c) * square[i][j] for j in range(3)] for i in range(3)]
    turn = [[r if K[i][j] != 0 or square[i][j] != 0 else int(i == j) for j, r in enumerate(rows[i])] for i in range(3)]
    return product(R, turn)


def spatial(axes: Sequence, edges: Sequence, turns: Sequence) -> tuple[list[Part], list[tuple]]:
    """Return a chain of thin bars of 1 kg from the origin, and their ends."""
    R, at, parts, ends = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], (0.0, 0.0, 0.0), [], []
    for axis, edge, (c, s) in zip(axes, edges, turns, strict=False):
        R = turned(R, axis, c, s)
        span = tuple(x for (x,) in product(R, [[x] for x in edge]))
        parts.append((1.0, 1.0 / 12, tuple(a + b / 2 for a, b in zip(at, span, strict=True)), span))
        at = tuple(a + b for a, b in zip(at, span, strict=True))
        ends.append(at)
    return parts, ends


EDGES = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0))
AXES = ((0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0))


def chain(name: str, title: str, axes: Sequence, edges: Sequence, q: list, v: list, **more: Any) -> Problem:
    """Return a spatial loop of hinges, closed at the last hinge on the ground."""
    bodies = []
    for i, (axis, edge) in enumerate(zip(axes, edges, strict=False), 1):
        at = edges[i - 2] if i > 1 else (0, 0, 0)
        parent = f"bar{i - 1}" if i > 1 else GROUND
        bodies.append(Body(f"bar{i}", parent, [*map(float, at)], **thin(edge), axis=[*map(float, axis)]))
    points = {f"end{i}": (f"bar{i}", [*map(float, edges[i - 1])]) for i in range(1, len(edges))}
    last = [*map(float, edges[-1])]
    closure = Closure("last", f"bar{len(edges)}", last, GROUND, more.pop("end"), "hinge")
    closure.axis, closure.second_axis = [*map(float, axes[len(edges)])], more.pop("end_axis")
    return Problem(name, title, bodies, [closure], points, [Run(q, v)], independent=["bar1"], reactions="none", **more)


def bricard() -> Made:
    v = [2.0, 2.0, -2.0, -2.0, -2.0]
    more = {"gravity": (0.0, 0.0, -9.81), "end": (0.0, 0.0, 1.0), "end_axis": (1.0, 0.0, 0.0), "stop": 2.0}
    p = chain("bricard", "Bricard's linkage", AXES, EDGES, [0.0] * 5, v, **more)

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        c, e = f.cos(s[0]), f.sin(s[0])
        w = 1 / (e + 1)  # (1 + sin a) (1 - sin b) = 1
        cb, sb = f.sqrt(w * (2 - w)), 1 - w
        parts, ends = spatial(AXES, EDGES, [(c, e), (cb, sb), (c, -e), (cb, -sb), (c, -e)])
        return parts, ends[:-1]

    return p, Motion(geometry, [((0,), (2,))], [np.linspace(-0.5, np.pi + 0.5, 2000)])


def bennett() -> Made:
    a, alpha, beta = 0.3, 0.7, 1.2
    b = float(a * mp.sin(beta) / mp.sin(alpha))
    twists = np.cumsum([0.0, alpha, beta, alpha])
    axes = [(0.0, -float(np.sin(x)), float(np.cos(x))) for x in twists]
    edges = [(x, 0.0, 0.0) for x in (a, b, a)]
    k = float(np.sin((beta + alpha) / 2) / np.sin((beta - alpha) / 2))
    th, w = 1.0, 3.0
    opposite = 2 * float(np.arctan2(k * np.cos(th / 2), np.sin(th / 2)))
    rate = -w * k / (np.sin(th / 2) ** 2 + k**2 * np.cos(th / 2) ** 2)
    more = {"end": (-b, 0.0, 0.0), "end_axis": (0.0, float(np.sin(beta)), float(np.cos(beta))), "stop": 3.0}
    start = [th, opposite, -th], [w, float(rate), -w]
    p = chain("bennett", "Bennett's linkage", axes, edges, *start, **more)

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        c, e, h = f.cos(s[0]), f.sin(s[0]), [f.cos(s[0] / 2), f.sin(s[0] / 2)]
        if f is Exact:
            ratio = mp.sin(mpf(beta + alpha) / 2) / mp.sin((mpf(beta) - mpf(alpha)) / 2)
            long = mpf(a) * mp.sin(beta) / mp.sin(alpha)
            tilts = [mpf(0), mpf(alpha), mpf(alpha) + mpf(beta)]
            exact, spans = [(0, -mp.sin(x), mp.cos(x)) for x in tilts], [(x, 0, 0) for x in (mpf(a), long, mpf(a))]
        else:
            ratio, exact, spans = k, axes[:3], edges
        y, x = h[0] * ratio, h[1]
        r = 1 / (x * x + y * y)
        co, so = (x * x - y * y) * r, x * y * r * 2
        parts, ends = spatial(exact, spans, [(c, e), (co, so), (c, -e)])
        return parts, ends[:-1]

    return p, Motion(geometry, [((th,), (w,))])


CHAIN = (-1.496949669220263, -0.7467775023718601), (1.2122781438213286, 9.41908626253452)
"""Start of the chain [rad, rad/s], integrated backwards from 0 with 2 and -3 rad/s, which both loops reach at 0.5 s."""


def parallelogram_chain() -> Made:
    bodies, closures, below = parallelogram(1.0, None)
    bodies += [bar("link4", "link2", 0.0, 0.8), bar("link5", "link4", 0.8), bar("link6", "link2", 1.0, 0.8)]
    closures.append(Closure("C2", "link5", (1, 0, 0), "link6", (0.8, 0, 0)))
    points = ENDS | {"B2": ("link4", (0.8, 0, 0)), "C2": ("link6", (0.8, 0, 0))}
    title = "Chain of two parallelograms, both aligned at 0.5 s"
    p = Problem("parallelogram_chain", title, bodies, closures, points, [], 2.0, ["link1", "link4"])

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        parts, (B, C) = below(f, s)
        (fourth, B2), (sixth, C2) = link(f, B, s[1], 0.8), link(f, C, s[1], 0.8)
        fifth = still(1.0, 1.0, B2[0] + 0.5, B2[1])
        return [*parts, fourth, fifth, sixth], [B, C, B2, C2]

    (th, ph), (w, x) = CHAIN
    p.runs = [Run([th, -th, th, ph, -ph, ph], [w, -w, w, x, -x, x])]
    grid = np.meshgrid(*[np.linspace(-np.pi, np.pi, 300)] * 2)
    return p, Motion(geometry, [CHAIN], [x.ravel() for x in grid])


def kite() -> Made:
    b, th, w = 1.5, -1.2, 5.0
    bodies = [bar("link1", GROUND, 0.0), bar("link2", "link1", 1.0, b), bar("link3", GROUND, 1.0, b)]
    closures = [Closure("C", "link2", (b, 0, 0), "link3", (b, 0, 0))]
    points = {"B": ("link1", (1, 0, 0)), "C": ("link3", (b, 0, 0))}
    lean = float(np.arcsin(np.sin(th / 2) / b))
    turn = float(np.cos(th / 2) / b / np.cos(lean)) * w / 2
    q, v = [th, -th / 2 - lean, th / 2 + lean], [w, -w / 2 - turn, w / 2 + turn]
    p = Problem("kite", "Kite four-bar through its branch point", bodies, closures, points, [Run(q, v)], 2.0, ["link1"])
    p.reactions = "pole"

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        c, e = f.cos(s[0] / 2), f.sin(s[0] / 2)
        sl = e / b
        cl = f.sqrt(1 - sl * sl)
        first, B = link(f, (0.0, 0.0), s[0])

        def rod(begin: tuple, cu: Any, su: Any) -> tuple[Part, tuple]:
            x, y = begin
            return (1.0, b**2 / 12, (x + cu * (b / 2), y + su * (b / 2)), (cu, su)), (x + cu * b, y + su * b)

        second, _ = rod(B, c * cl + e * sl, e * cl - c * sl)
        third, C = rod((1.0, 0.0), c * cl - e * sl, e * cl + c * sl)
        return [first, second, third], [B, C]

    grid = [np.linspace(-2 * np.pi, 2 * np.pi, 4000)]
    return p, Motion(geometry, [((th,), (w,))], grid, aligned=lambda x: mp.sin(x / 2))


def stewart() -> Made:
    psi, mass, tops, bases = -0.8, 30.0, [], []
    for k in range(6):
        angle, (R, r, z) = k * np.pi / 3, ((2.0, 1.0, 0.0), (2.5, 0.8, -0.9))[k % 2]
        around = np.array([np.cos(angle), np.sin(angle), 0.0])
        bases.append(R * around + [0, 0, z])
        tops.append(r * around + [0, 0, z])

    def height(f: Any, s: Any) -> Any:
        return -f.sqrt(f.cos(s) * 4 - mpf("1.11") if f is Exact else f.cos(s) * 4 - 1.11)

    c, s, z = np.cos(psi), np.sin(psi), height(np, psi)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    heads = [turn @ top + [0, 0, z] for top in tops]
    none = np.zeros((3, 3)).tolist()
    bodies, closures, empty = [], [], {"mass": 0.0, "center": (0, 0, 0), "inertia": none}
    for i, (base, head) in enumerate(zip(bases, heads, strict=True), 1):
        along = (head - base) / np.linalg.norm(head - base)
        one = np.cross(along, [0, 0, 1])
        one /= np.linalg.norm(one)
        two = np.cross(along, one)
        edge = [*map(float, head - base)]
        bodies.append(Body(f"cross{i}", GROUND, [*map(float, base)], **empty, axis=[*map(float, one)]))
        bodies.append(Body(f"leg{i}", f"cross{i}", (0, 0, 0), **thin(edge, 2.0), axis=[*map(float, two)]))
        closures.append(Closure(f"J{i}", f"leg{i}", edge, "platform", [*map(float, head - heads[0])]))
    start = bodies[1].center[0] * 2, bodies[1].center[1] * 2, bodies[1].center[2] * 2
    bodies.append(Body("turn_x", "leg1", start, **empty, axis=(1, 0, 0)))
    bodies.append(Body("turn_y", "turn_x", (0, 0, 0), **empty, axis=(0, 1, 0)))
    inertia = (mass * np.diag([0.2, 0.2, 0.4])).tolist()
    middle = [*map(float, np.array([0, 0, z]) - heads[0])]
    bodies.append(Body("platform", "turn_y", (0, 0, 0), mass, middle, inertia))
    points = {f"J{i}": ("platform", closures[i - 1].second_at) for i in (2, 4, 5)}
    run, title = Run([0.0] * len(bodies), [0.0] * len(bodies)), "Stewart platform on rods through a singular pose"
    p = Problem("stewart", title, bodies, closures[1:], points, [run], 2.0, ["leg1"], (0.0, 0.0, -9.81))
    p.reactions = "none"

    def geometry(f: Any, s: Sequence) -> tuple[list[Part], list[tuple]]:
        c, e, z = f.cos(s[0]), f.sin(s[0]), height(f, s[0])
        parts, ends = [], []
        for k in range(6):
            (R, r, h), angle = ((2.0, 1.0, 0.0), (2.5, 0.8, -0.9))[k % 2], k * (mp.pi if f is Exact else np.pi) / 3
            cr, sr = (f.cos(angle), f.sin(angle)) if f is not Exact else (mp.cos(angle), mp.sin(angle))
            end = (c * cr - e * sr) * r, (e * cr + c * sr) * r, z + h
            begin = R * cr, R * sr, h
            span = tuple(a - b for a, b in zip(end, begin, strict=True))
            parts.append((2.0, 2.0 / 12, tuple(b + x / 2 for b, x in zip(begin, span, strict=True)), span))
            ends.append(end)
        parts.append((mass, 0.4 * mass, (0.0, 0.0, z), (c, e, 0.0)))
        return parts, [ends[k - 1] for k in (2, 4, 5)]

    return p, Motion(geometry, [((psi,), (0,))], [np.linspace(-1.2, 1.2, 2000)])


PROBLEMS: dict[str, Callable[[], Made]] = {
    "particle": particle,
    "five_bar": lambda: five_bar(1.0),
    "five_bar_massless": lambda: five_bar(0.0),
    "four_bar": four_bar,
    "slider_crank": slider_crank,
    "n_four_bar_2": lambda: n_four_bar(2),
    "n_four_bar_40": lambda: n_four_bar(40),
    "n_four_bar_1000": lambda: n_four_bar(1000),
    "bricard": bricard,
    "bennett": bennett,
    "parallelogram_chain": parallelogram_chain,
    "kite": kite,
    "stewart": stewart,
}


def write_reference(name: str) -> str:
    """Write the JSON and CSV files of a problem; return a text on the difference between two integrations."""
    with mp.workdps(DIGITS):
        problem, motion = PROBLEMS[name]()
        axes = "xy" if problem.planar else "xyz"
        reacts = problem.reactions != "none" and len(problem.bodies) < 10
        columns = ["run", "t", *(f"{point}.{axis}" for point in problem.points for axis in axes)]
        columns += ["force.x", "force.y"] * reacts
        rows, worst, step = [], mpf(0), problem.every
        for k, run in enumerate(problem.runs):
            states = motion.integrate(problem, k, step)
            while k < CHECKED:
                finer = motion.integrate(problem, k, step / 2)
                pairs = [(a, b) for x, y in zip(states, finer, strict=True) for a, b in zip(x[0], y[0], strict=True)]
                change = max(abs(a - b) for a, b in pairs)
                if change < 10**-KEPT:
                    worst = max(worst, change)
                    break
                step, states = step / 2, finer
            for t, (s, w) in zip(problem.times, states, strict=True):
                a = motion.rates(problem, mpf(run.torque), s, w)
                parts, points = motion.derivatives(s, w, a)
                row = [str(k), f"{t:.10g}", *(nstr(x.x[0], KEPT) for point in points for x in point[: len(axes)])]
                if reacts:
                    near = min(abs(float(motion.aligned(x))) for x in s) < OFF
                    force = [np.nan] * 2 if near else reactions(problem, parts, run.torque)[:2]
                    row += ["" if np.isnan(x) else f"{x:.17g}" for x in force]
                rows.append(row)
    if len(problem.bodies) < 100:
        saved(problem)
    with (FOLDER / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([columns, *rows])
    return f"{name}: steps of {step:g} s, and those of half that, differ by {nstr(worst, 2)} in s"
