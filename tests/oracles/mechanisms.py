"""The project's mechanisms described by hand for `lagrange`, in the coordinates and the row order they document.

A row reads point of the second body minus point of the first, the other way round where only the first has absolute
coordinates.
"""

from collections.abc import Mapping

from mpmath import atan2, cos, mpf, sin, sqrt

from .lagrange import Description


def particle(p: Mapping[str, float]) -> Description:
    """q = [x y], paths of force.x and force.y."""
    return Description(
        constraints=lambda q: [sqrt(q[0] ** 2 + q[1] ** 2) - mpf(p["rho"])],
        poses=lambda q: [(q[0], q[1], mpf(0))],
        weights=[(mpf(p["m"]), mpf(0))],
        paths=lambda q: [q[0], q[1]],
        gravity=(0, -mpf(p["g"])),
    )


def slider_crank(p: Mapping[str, float], coordinates: str) -> Description:
    """q as in Fig. 5 a to d of the paper, paths of A.torque and slider.force."""
    l1, l2, b, g, m1, m2, m3 = (mpf(p[k]) for k in ("l1", "l2", "b", "g", "m1", "m2", "m3"))
    bars = [(m1, m1 * l1**2 / 12), (m2, m2 * l2**2 / 12), (m3, mpf(0))]
    zero = mpf(0)

    def crank(th):
        return l1 / 2 * cos(th), b + l1 / 2 * sin(th), th

    if coordinates == "absolute":

        def constraints(q):
            x1, y1, th1, x2, y2, th2, x3, y3 = q
            c1, s1, c2, s2 = l1 / 2 * cos(th1), l1 / 2 * sin(th1), l2 / 2 * cos(th2), l2 / 2 * sin(th2)
            pivot = [x1 - c1, y1 - s1 - b]
            return [*pivot, x2 - c2 - x1 - c1, y2 - s2 - y1 - s1, x3 - x2 - c2, y3 - y2 - s2, y3]

        def poses(q):
            return [tuple(q[:3]), tuple(q[3:6]), (q[6], q[7], zero)]

        def paths(q):
            return [q[2], q[6]]

    elif coordinates == "joint":

        def constraints(q):
            th1, th2, s = q
            return [s - l1 * cos(th1) - l2 * cos(th1 + th2), -b - l1 * sin(th1) - l2 * sin(th1 + th2)]

        def poses(q):
            th1, th2, s = q
            x, y = l1 * cos(th1) + l2 / 2 * cos(th1 + th2), b + l1 * sin(th1) + l2 / 2 * sin(th1 + th2)
            return [crank(th1), (x, y, th1 + th2), (s, zero, zero)]

        def paths(q):
            return [q[0], q[2]]

    elif coordinates == "mixed":

        def constraints(q):
            th1, x2, y2, th2, s = q
            c2, s2 = l2 / 2 * cos(th2), l2 / 2 * sin(th2)
            return [x2 - c2 - l1 * cos(th1), y2 - s2 - b - l1 * sin(th1), x2 + c2 - s, y2 + s2]

        def poses(q):
            return [crank(q[0]), tuple(q[1:4]), (q[4], zero, zero)]

        def paths(q):
            return [q[0], q[4]]

    else:
        # A bar between two points moves with T = m (v1.v1 + v1.v2 + v2.v2) / 6 (Garcia de Jalon and Bayo, section 4.2).
        def constraints(q):
            x1, y1, x2, y2 = q
            first = (x1**2 + (y1 - b) ** 2 - l1**2) / (2 * l1)
            return [first, ((x2 - x1) ** 2 + (y2 - y1) ** 2 - l2**2) / (2 * l2), y2]

        def kinetic(q, v):
            one, two = v[:2], v[2:]
            squares = [sum(x * y for x, y in zip(r, s, strict=True)) for r, s in ((one, one), (one, two), (two, two))]
            return m1 * squares[0] / 6 + m2 * sum(squares) / 6 + m3 * squares[2] / 2

        def paths(q):
            return [atan2(q[1] - b, q[0]), q[2]]

        return Description(
            constraints=constraints,
            kinetic=kinetic,
            potential=lambda q: g * (m1 * (b + q[1]) / 2 + m2 * (q[1] + q[3]) / 2 + m3 * q[3]),
            paths=paths,
        )
    return Description(constraints=constraints, poses=poses, weights=bars, paths=paths, gravity=(0, -g))


def natural_poses(q, b, l1, l2) -> list[tuple]:
    """Centres of mass and angles of crank, rod and slider from points B and C."""
    x1, y1, x2, y2 = q
    return [
        (x1 / 2, (b + y1) / 2, atan2(y1 - b, x1)),
        ((x1 + x2) / 2, (y1 + y2) / 2, atan2(y2 - y1, x2 - x1)),
        (x2, y2, mpf(0)),
    ]


def parallelogram(p: Mapping[str, float]) -> Description:
    """Five-bar, or four-bar where there is no m4; paths of A.torque and D.torque."""
    l, g, h = mpf(p["l"]), mpf(p["g"]), mpf(p["l"]) / 2
    masses = [mpf(p[k]) for k in ("m1", "m2", "m3", "m4") if k in p]
    full = len(masses) == 4

    def poses(q):
        th1, x2, y2, th2, th3 = q[:5]
        links = [(h * cos(th1), h * sin(th1), th1), (x2, y2, th2), (l + h * cos(th3), h * sin(th3), th3)]
        return links + ([tuple(q[5:8])] if full else [])

    def constraints(q):
        (_, _, th1), (x2, y2, th2), (_, _, th3), *rest = poses(q)
        points = [(x2, y2, th2, l)] + [(x, y, th, h) for x, y, th in rest]
        rows = []
        for x, y, th, reach in points:
            rows += [x - h * cos(th) - reach * cos(th1), y - h * sin(th) - reach * sin(th1)]
            rows += [x + h * cos(th) - reach * cos(th3) - l, y + h * sin(th) - reach * sin(th3)]
        return rows

    return Description(
        constraints=constraints,
        poses=poses,
        weights=[(m, m * l**2 / 12) for m in masses],
        paths=lambda q: [q[0], q[4]],
        gravity=(0, -g),
    )
