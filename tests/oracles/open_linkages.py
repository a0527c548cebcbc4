"""Random linkages in space that are closed at a place of their own, and declared with guesses away from it."""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

import alfmu
from alfmu.model.spatial import SpatialBody

OPEN = (1.0, 0.3)
"""Largest offset of a guess: angle [rad], length over the size of the mechanism or Euler parameter."""

KINDS = ("revolute", "revolute", "revolute", "prismatic", "spherical", "universal", "cylindrical")
CLOSING = ("spherical", "spherical", "revolute", "cylindrical")


def _unit(x: NDArray) -> NDArray:
    return x / np.linalg.norm(x)


def opened(seed: int, planar: bool, true: dict[str, float] | None = None) -> alfmu.Mechanism:
    """Three to six bodies in a tree, one to three joints that close loops; in space, or in a plane of any direction.

    `true` is filled with the coordinates at which they are closed.
    """
    true = {} if true is None else true
    rng = np.random.default_rng(seed)
    size, normal = 10 ** rng.uniform(-1, 0.7), _unit(rng.normal(size=3))
    m = alfmu.Mechanism(f"open{seed}")

    def flat(x: NDArray) -> NDArray:
        return x - normal * (x @ normal) if planar else x

    def coordinates(name: str, unit: str, *values: float) -> list[ca.SX]:
        off = OPEN[unit != "rad"] * (size if unit == "m" else 1.0)
        true.update({f"{name}{k}": x for k, x in enumerate(values)})
        return [m.coordinate(f"{name}{k}", unit, start=x + off * rng.uniform(-1, 1)) for k, x in enumerate(values)]

    def at(expression: ca.SX) -> NDArray:
        """An expression at the place where all loops are closed."""
        q = ca.vertcat(*(c.q for c in m.coordinates))
        return np.array(ca.Function("at", [q], [expression])([true[c.name] for c in m.coordinates]))

    def close(name: str, one: SpatialBody, two: SpatialBody, kind: str) -> None:
        point = flat(0.5 * size * rng.normal(size=3))
        (R1, o1), (R2, o2) = ((at(b.rotation), at(b.at().place).ravel()) for b in (one, two))
        markers = one.at(*point.tolist()), two.at(*(R2.T @ (o1 + R1 @ point - o2)).tolist())
        if kind == "spherical":
            m.spherical(name, *markers)
            return
        axis = normal if planar else _unit(rng.normal(size=3))
        axes = {"axis": tuple(R1.T @ axis), "second_axis": tuple(R2.T @ axis)}
        (m.cylindrical if kind == "cylindrical" else m.spatial_revolute)(name, *markers, **axes)

    bodies = [m.spatial_ground]
    for k in range(int(rng.integers(3, 7))):
        box = {"mass": 1.0, "inertia": (0.1 * size**2,) * 3}
        first = bodies[rng.integers(len(bodies))]
        if not planar and rng.random() < 0.15:
            e, x = _unit(rng.normal(size=4)), size * rng.normal(size=3)
            off = rng.uniform(-1, 1, 7) * OPEN[1]
            bodies.append(
                m.spatial_body(f"b{k}", **box, position=tuple(x + size * off[:3]), attitude=tuple(_unit(e + off[3:])))
            )
            true.update(zip((c.name for c in m.coordinates[-7:]), (*x, *e), strict=True))
            close(f"own{k}", first, bodies[-1], ("spherical", "revolute")[rng.integers(2)])
            continue
        body = m.spatial_body(f"b{k}", **box, relative=True)
        kind = KINDS[rng.integers(4 if planar else len(KINDS))]
        ends = first.at(*flat(0.5 * size * rng.normal(size=3)).tolist()), body.at()
        axis = normal if planar and kind == "revolute" else _unit(flat(rng.normal(size=3)))
        angle, way = rng.uniform(-2.5, 2.5), size * rng.uniform(0.2, 1.0)
        if kind == "revolute":
            m.spatial_revolute(f"j{k}", *ends, axis=tuple(axis), coordinate=coordinates(f"q{k}", "rad", angle)[0])
        elif kind == "prismatic":
            m.spatial_prismatic(f"j{k}", *ends, axis=tuple(axis), coordinate=coordinates(f"q{k}", "m", way)[0])
        elif kind == "cylindrical":
            both = (*coordinates(f"q{k}", "rad", angle), *coordinates(f"s{k}", "m", way))
            m.cylindrical(f"j{k}", *ends, axis=tuple(axis), coordinates=both)
        elif kind == "universal":
            second = _unit(np.cross(axis, rng.normal(size=3)))
            both = coordinates(f"q{k}", "rad", angle, angle / 3)
            m.universal(f"j{k}", *ends, axis=tuple(axis), second_axis=tuple(second), coordinates=both)
        else:
            m.spherical(f"j{k}", *ends, coordinates=coordinates(f"q{k}", "1", *_unit(rng.normal(size=4))))
        bodies.append(body)
    for k in range(int(rng.integers(1, max(2, len(bodies) // 2)))):
        one, two = sorted(rng.choice(len(bodies), 2, replace=False))
        close(f"loop{k}", bodies[one], bodies[two], "revolute" if planar else CLOSING[rng.integers(4)])
    return m
