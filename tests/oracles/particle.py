"""Table I of Blajer 2002: the iterates of (8) for a particle on a circle at (rho, 0) with the velocity (0, v).

With C = [1 0], xi = -v^2 / rho and k = F_x / m + v^2 / rho, by hand:

    a_i = (-v^2 / rho + (m / (m + alpha))^i k, F_y / m),   lambda_i = m k (1 - (m / (m + alpha))^i).
"""

from fractions import Fraction


def table(i: int, m: Fraction, rho: Fraction, v: Fraction, fx: Fraction, fy: Fraction, alpha: Fraction) -> tuple:
    """a_x, a_y, lambda after iteration i."""
    shrunk = (m / (m + alpha)) ** i
    k = fx / m + v**2 / rho
    return -(v**2) / rho + shrunk * k, fy / m, m * k * (1 - shrunk)
