"""Slider-crank in the angle of its crank alone, with joint forces from free-body diagrams.

Motion by Eksergian's equation, I(th) th'' + I'(th) th'^2 / 2 = Q(th), with all places as functions of the crank angle
th; joint forces by Newton's law on the slider, the rod and the crank in turn. Uniform bars, crank pivot at (0, b),
guide on the x axis, rod at the angle phi with sin phi = -(b + l1 sin th) / l2.
"""

import math
from dataclasses import dataclass, replace
from types import ModuleType

import mpmath
import numpy as np

from . import ode

DIGITS = 40


@dataclass(frozen=True)
class SliderCrank:
    """Dimensions, masses and constant loads; `side` is +1 for a rod that points to positive x, -1 for the other way.

    `aligned` follows the branch on which the rod mirrors the crank (phi = -th), through both links vertical; it needs
    l1 = l2 and b = 0.
    """

    l1: float = 0.5
    l2: float = 1.0
    b: float = 0.0
    m1: float = 1.0
    m2: float = 1.0
    m3: float = 1.0
    g: float = 9.81
    torque: float = 0.0
    force: float = 0.0
    side: int = 1
    aligned: bool = False

    def exactly(self) -> "SliderCrank":
        """The same numbers in 40 digits."""
        names = ("l1", "l2", "b", "m1", "m2", "m3", "g", "torque", "force")
        return replace(self, **{name: mpmath.mpf(getattr(self, name)) for name in names})

    def rod(self, th, of: ModuleType = math) -> tuple:
        """phi and its first and second derivative with respect to th; `of` computes with floats or in 40 digits."""
        if self.aligned:
            return -th, -1, 0
        sine = -(self.b + self.l1 * of.sin(th)) / self.l2
        cosine = self.side * of.sqrt(1 - sine**2)
        first = -self.l1 * of.cos(th) / (self.l2 * cosine)
        second = (self.l1 * of.sin(th) / self.l2 + sine * first**2) / cosine
        return of.atan2(sine, cosine), first, second

    def places(self, th, of: ModuleType = math) -> dict[str, tuple]:
        """Coordinates of the centres of mass, phi and s, each with first and second derivative with respect to th."""
        phi, p1, p2 = self.rod(th, of)
        l1, h1, h2 = self.l1, self.l1 / 2, self.l2 / 2
        c, s, cr, sr = of.cos(th), of.sin(th), of.cos(phi), of.sin(phi)
        rc = (cr, -sr * p1, -cr * p1**2 - sr * p2)
        rs = (sr, cr * p1, -sr * p1**2 + cr * p2)
        cc, ss = (c, -s, -c), (s, c, -s)
        return {
            "x1": tuple(h1 * x for x in cc),
            "y1": (self.b + h1 * s, h1 * c, -h1 * s),
            "x2": tuple(l1 * x + h2 * y for x, y in zip(cc, rc, strict=True)),
            "y2": tuple(l1 * x + h2 * y + z for x, y, z in zip(ss, rs, (self.b, 0, 0), strict=True)),
            "phi": (phi, p1, p2),
            "s": tuple(l1 * x + 2 * h2 * y for x, y in zip(cc, rc, strict=True)),
        }

    def acceleration(self, th, w, of: ModuleType = math):
        """th'' of Eksergian's equation."""
        weights = {
            "x2": self.m2,
            "y2": self.m2,
            "phi": self.m2 * self.l2**2 / 12,
            "s": self.m3,
        }
        p = self.places(th, of)
        inertia = self.m1 * self.l1**2 / 3 + sum(m * p[k][1] ** 2 for k, m in weights.items())
        half_slope = sum(m * p[k][1] * p[k][2] for k, m in weights.items())
        load = self.torque + self.force * p["s"][1] - self.g * (self.m1 * p["y1"][1] + self.m2 * p["y2"][1])
        return (load - half_slope * w**2) / inertia

    def motion(self, th: float, w: float, times: np.ndarray) -> np.ndarray:
        """th and th' at `times`."""
        return ode.motion(lambda t, x, v: self.acceleration(x, v), th, w, times)

    def readings(self, th: float, w: float) -> dict[str, float]:
        """Everything there is to read at a state, in 40 digits: bodies, slider, and all joint forces.

        A force acts on the second body from the first of A (ground, crank), B (crank, rod), C (rod, slider) and
        guide (ground, slider).
        """
        with mpmath.mp.workdps(DIGITS):
            return {name: float(x) for name, x in self.exactly()._readings(mpmath.mpf(th), mpmath.mpf(w)).items()}

    def _readings(self, th, w) -> dict:
        e = self.acceleration(th, w, mpmath)
        p = self.places(th, mpmath)
        at = {k: (x, x1 * w, x1 * e + x2 * w**2) for k, (x, x1, x2) in p.items()}
        at |= {"th": (th, w, e), "y3": (0, 0, 0), "none": (0, 0, 0)}
        m1, m2, m3, g = self.m1, self.m2, self.m3, self.g
        c, s = mpmath.cos(at["phi"][0]), mpmath.sin(at["phi"][0])
        cx = m3 * at["s"][2] - self.force  # slider, along x
        bx = m2 * at["x2"][2] + cx  # rod, along x
        ax = m1 * at["x1"][2] + bx  # crank, along x
        lift = m2 * (at["y2"][2] + g)  # by - cy, rod along y
        spin = m2 * self.l2 / 6 * at["phi"][2]  # 2 J2 phi'' / l2 = s (bx + cx) - c (by + cy)
        cy = (s * (bx + cx) - spin - c * lift) / (2 * c)
        by = lift + cy
        ay = m1 * (at["y1"][2] + g) + by
        forces = {
            "A.force.x": ax,
            "A.force.y": ay,
            "B.force.x": bx,
            "B.force.y": by,
            "C.force.x": cx,
            "C.force.y": cy,
            "guide.force": m3 * g - cy,
            "guide.moment": 0,
        }
        bodies = {}
        for body, x, y, angle in (
            ("crank", "x1", "y1", "th"),
            ("rod", "x2", "y2", "phi"),
            ("slider", "s", "y3", "none"),
        ):
            for k, (place, turn) in enumerate(
                (("", "angle"), ("v", "angular_velocity"), ("a", "angular_acceleration"))
            ):
                bodies |= {f"{body}.{place}x": at[x][k], f"{body}.{place}y": at[y][k], f"{body}.{turn}": at[angle][k]}
        slide = dict(zip(("slider.position", "slider.velocity", "slider.acceleration"), at["s"], strict=True))
        return bodies | slide | forces

    def crank_moment(self, th: float, w: float) -> float:
        """What the moments about A on the crank lack to its angular acceleration: zero, and used nowhere above."""
        r = self.readings(th, w)
        arm = self.l1 * math.cos(th), self.l1 * math.sin(th)
        joint = arm[1] * r["B.force.x"] - arm[0] * r["B.force.y"]
        weight = -self.m1 * self.g * arm[0] / 2
        return self.torque + joint + weight - self.m1 * self.l1**2 / 3 * r["crank.angular_acceleration"]
