"""The pendulum phi'' = -w^2 sin phi in elliptic functions (Whittaker, Analytical Dynamics, section 44)."""

from functools import lru_cache

from mpmath import asin, ellipf, ellipfun, ellipk, mp, mpf, sin, sqrt

DIGITS = 30


@lru_cache(10_000)
def swing(w, phi, rate, t) -> tuple[float, float]:
    """Angle and rate at t of a pendulum that swings (does not turn over) from phi, rate at t = 0, by closed form."""
    with mp.workdps(DIGITS):
        k, begin = _begun(w, phi, rate)
        u = mpf(w) * mpf(t) + begin
        return 2 * asin(k * ellipfun("sn", u, m=k**2)), 2 * mpf(w) * k * ellipfun("cn", u, m=k**2)


@lru_cache(100)
def _begun(w, phi, rate) -> tuple[float, float]:
    """Modulus of a swing, and its argument at t = 0."""
    with mp.workdps(DIGITS):
        w, phi, rate = mpf(w), mpf(phi), mpf(rate)
        k = sqrt(rate**2 / (4 * w**2) + sin(phi / 2) ** 2)
        assert k < 1, "the pendulum turns over"
        begin = ellipf(asin(sin(phi / 2) / k), k**2)
        if rate < 0:
            begin = 2 * ellipk(k**2) - begin
        return k, begin


def period(w, amplitude) -> float:
    """Period of a swing between -amplitude and amplitude."""
    with mp.workdps(DIGITS):
        return 4 / mpf(w) * ellipk(sin(mpf(amplitude) / 2) ** 2)
