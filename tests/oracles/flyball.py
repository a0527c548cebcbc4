"""Flyball governor in three minimal coordinates: both rods at one angle, so that the mechanism stays symmetric.

Angle phi of the shaft, angle al of the rods below the horizontal, height s of the slider. With the moment of inertia
about the axis I(al), that of the rods about their hinges J, and the length d(al, s) of a spring under the force F,

    I phi'' + I' al' phi' = torque,    J al'' = I'/2 phi'^2 + W cos al - 2 F d_al,    m s'' = -m g - 2 F d_s + force

by Lagrange's equations on paper. Without a torque I phi' is constant, which an integration need not know.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

TURN = 2 * np.pi


@dataclass(frozen=True)
class Governor:
    """Dimensions [m], masses [kg], springs and loads of the benchmark."""

    l: float = 1.0
    width: float = 0.01
    density: float = 3000.0
    m_ball: float = 5.0
    m_slider: float = 3.0
    side: float = 0.1
    pivot: float = 0.05
    stiffness: float = 8e5
    damping: float = 4e4
    rest: float = 0.5
    g: float = 9.81
    torque: float = 0.0
    force: float = 0.0

    @property
    def rod(self) -> float:
        """Mass of a rod, and of the shaft."""
        return self.density * self.width**2 * self.l

    def inertia(self, al: float) -> tuple[float, float]:
        """I about the axis and its derivative I'."""
        m, l, w, c, s = self.rod, self.l, self.width, math.cos(al), math.sin(al)
        middle, end = self.pivot + l / 2 * c, self.pivot + l * c
        thick, thin = m * (l**2 + w**2) / 12, m * w**2 / 6
        upright = thin + self.m_slider * self.side**2 / 6
        hanging = m * middle**2 + thick * c**2 + thin * s**2 + self.m_ball * end**2
        slope = -m * l * s * middle - 2 * (thick - thin) * s * c - 2 * self.m_ball * l * s * end
        return upright + 2 * hanging, 2 * slope

    @property
    def swing(self) -> float:
        """J: inertia of both rods about their hinges."""
        l, w = self.l, self.width
        return 2 * (self.rod * (l**2 / 4 + (l**2 + w**2) / 12) + self.m_ball * l**2)

    def spring(self, al: float, s: float, al_rate: float, s_rate: float) -> tuple[float, float, float, float]:
        """Force F of one spring (tension positive), its length d, and the derivatives d_al, d_s."""
        c, sn, h = math.cos(al), math.sin(al), self.l / 2
        x, z = self.pivot + h * c - self.side / 2, self.l - h * sn - s
        d = math.hypot(x, z)
        d_al, d_s = (-x * h * sn - z * h * c) / d, -z / d
        rate = d_al * al_rate + d_s * s_rate
        return self.stiffness * (d - self.rest) + self.damping * rate, d, d_al, d_s

    def accelerations(self, al: float, s: float, rates: tuple[float, float, float]) -> tuple[float, float, float]:
        """phi'', al'', s'' for the rates phi', al', s'."""
        turn, al_rate, s_rate = rates
        I, slope = self.inertia(al)
        F, _, d_al, d_s = self.spring(al, s, al_rate, s_rate)
        weight = 2 * self.g * self.l * (self.rod / 2 + self.m_ball)
        swing = (slope / 2 * turn**2 + weight * math.cos(al) - 2 * F * d_al) / self.swing
        return (
            (self.torque - slope * al_rate * turn) / I,
            swing,
            (self.force - 2 * F * d_s) / self.m_slider - self.g,
        )

    def energy(self, al: float, s: float, rates: tuple[float, float, float]) -> float:
        """Kinetic and potential energy; heights from the foot of the shaft."""
        turn, al_rate, s_rate = rates
        _, d, _, _ = self.spring(al, s, 0.0, 0.0)
        kinetic = self.inertia(al)[0] * turn**2 + self.swing * al_rate**2 + self.m_slider * s_rate**2
        heights = 2 * self.rod * (self.l - self.l / 2 * math.sin(al)) + 2 * self.m_ball * self.l * (1 - math.sin(al))
        weight = self.g * (heights + self.m_slider * s + self.rod * self.l / 2)
        return kinetic / 2 + weight + self.stiffness * (d - self.rest) ** 2

    def right_side(self, t: float, y: np.ndarray) -> list[float]:
        """y = [phi, al, s, phi', al', s', work], the work being that of dampers, torque and force."""
        _, al, s, turn, al_rate, s_rate, _ = y
        _, _, d_al, d_s = self.spring(al, s, al_rate, s_rate)
        lost = 2 * self.damping * (d_al * al_rate + d_s * s_rate) ** 2
        work = self.torque * turn + self.force * s_rate - lost
        return [turn, al_rate, s_rate, *self.accelerations(al, s, (turn, al_rate, s_rate)), work]

    def slopes(self, t: float, y: np.ndarray) -> np.ndarray:
        """Derivatives of the right side by differences: what Newton's iteration of an implicit method takes."""
        here, step = np.array(self.right_side(t, y)), 1e-7
        return np.array([(self.right_side(t, y + step * e) - here) / step for e in np.eye(len(y))]).T

    def motion(
        self,
        times: np.ndarray,
        start: tuple = (0.0, np.pi / 6, 0.5, TURN, 0.0, 0.0),
        method: str = "Radau",
        rtol: float = 1e-12,
    ) -> np.ndarray:
        """[phi, al, s, phi', al', s', work] (len(times), 7)."""
        atol = rtol * 1e-2
        implicit = {"jac": self.slopes} if method in ("Radau", "BDF") else {}
        found = solve_ivp(
            self.right_side,
            (times[0], times[-1]),
            (*start, 0.0),
            method,
            times,
            rtol=rtol,
            atol=atol,
            first_step=1e-7,
            **implicit,
        )
        assert found.success, found.message
        return found.y.T


TIMES = np.linspace(0.0, 10.0, 21)
TABLE = Path(__file__).with_suffix(".csv")
"""Height of the slider [m] at TIMES, for the springs of the benchmark and for some a hundred times as stiff."""


def heights(
    stiffness: float = 8e5, times: np.ndarray = TIMES, method: str = "DOP853", rtol: float = 1e-12
) -> np.ndarray:
    """The benchmark's answer: heights of the slider (len(times),)."""
    return Governor(stiffness=stiffness).motion(times, method=method, rtol=rtol)[:, 2]


def table() -> np.ndarray:
    """Rows of the file that `scripts/governor_study.py` makes: time, height, height with springs of 8e7 N/m."""
    return np.loadtxt(TABLE, delimiter=",", skiprows=1)
