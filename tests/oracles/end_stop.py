"""Slider-crank with a flywheel and an end stop, in the angle of the flywheel alone (Eksergian's equation).

I(th) th'' + I'(th) th'^2/2 = torque + (force + stop) s'(th), with the places of `slider_crank` as functions of th.
"""

from dataclasses import dataclass

import numpy as np

from .slider_crank import SliderCrank


@dataclass(frozen=True)
class EndStop:
    """Dimensions [m], masses [kg], the law of the stop, constant loads."""

    l1: float = 0.5
    l2: float = 1.0
    m1: float = 1000.0
    m2: float = 1e-3
    m3: float = 10.0
    radius: float = 0.5
    stop: float = 1.4
    stiffness: float = 1e8
    dissipation: float = 0.2
    onset: float = 5e-4
    g: float = 9.81
    torque: float = 0.0
    force: float = 0.0

    @property
    def linkage(self) -> SliderCrank:
        return SliderCrank(l1=self.l1, l2=self.l2)

    def spring(self, s: float) -> tuple[float, float]:
        """Push and energy of the stop's spring, piece by piece."""
        depth = s - self.stop
        if depth <= 0:
            return 0.0, 0.0
        if depth >= self.onset:  # half the onset is lost to stiffening, a seventh of its square in energy
            more = depth - self.onset
            push = self.onset / 2 + more
            return self.stiffness * push, self.stiffness * (self.onset**2 / 7 + (push**2 - self.onset**2 / 4) / 2)
        z = depth / self.onset
        push = self.onset * z**4 * (2.5 + z * (z - 3))
        return self.stiffness * push, self.stiffness * self.onset**2 * z**5 * (0.5 + z * (z / 7 - 0.5))

    def contact(self, s: float, s_rate: float) -> float:
        """Force on the ram from the stop along the guide."""
        push, _ = self.spring(s)
        return -push * (1 + self.dissipation * s_rate)

    def acceleration(self, th: float, w: float) -> float:
        """th''."""
        p = self.linkage.places(th)
        weights = {"x2": self.m2, "y2": self.m2, "phi": self.m2 * self.l2**2 / 12, "s": self.m3}
        inertia = self.m1 * self.radius**2 / 2 + sum(m * p[k][1] ** 2 for k, m in weights.items())
        half_slope = sum(m * p[k][1] * p[k][2] for k, m in weights.items())
        s, first, _ = p["s"]
        load = self.torque - self.m2 * self.g * p["y2"][1] + (self.force + self.contact(s, first * w)) * first
        return (load - half_slope * w**2) / inertia

    def energy(self, th: float, w: float) -> float:
        """Kinetic and potential energy, the spring of the stop among them."""
        p = self.linkage.places(th)
        x, y, phi, s = (p[k][1] * w for k in ("x2", "y2", "phi", "s"))
        kinetic = self.m2 * (x**2 + y**2 + self.l2**2 / 12 * phi**2) + self.m3 * s**2
        kinetic += self.m1 * self.radius**2 / 2 * w**2
        return kinetic / 2 + self.m2 * self.g * p["y2"][0] + self.spring(p["s"][0])[1]

    def right_side(self, t: float, y: np.ndarray) -> list[float]:
        """Rates of [th, th', work], the work of dissipation and loads."""
        th, w, _ = y
        s, first, _ = self.linkage.places(th)["s"]
        loss = -self.spring(s)[0] * self.dissipation * first * w
        return [w, self.acceleration(th, w), self.torque * w + (self.force + loss) * first * w]
