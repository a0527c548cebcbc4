"""Mechanisms that somebody declares and runs, with nothing said about the method: right to 1e-5 the first time.

Each is judged by an unrelated method: Eksergian's equation of one degree of freedom by DOP853, with all places as
closed functions of one angle, or a published solution.
"""

import math
from functools import cache

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from oracles.slider_crank import SliderCrank

import alfmu
from alfmu.equations.types import configured
from alfmu.model.settings import Settings
from alfmu.simulation import prepared

BOUND = 1e-5
"""Largest error of an angle [rad], ten times the default tolerance."""


def bars(*each):
    """Mass and inertia of uniform bars, from masses and lengths."""
    return [(mass, mass * length**2 / 12) for mass, length in each]


def eksergian(weights, poses, potential, load):
    """th'' of a mechanism of one degree of freedom: mass and inertia, and (x, y, angle) at th, of each body; potential
    energy beside that of weight at th; generalised load at th and th'."""
    th = ca.SX.sym("th")
    places = poses(th)
    slopes = [[ca.jacobian(x, th) for x in place] for place in places]
    inertia = sum(m * (x**2 + y**2) + J * a**2 for (m, J), (x, y, a) in zip(weights, slopes, strict=True))
    energy = potential(th) + 9.81 * sum(m * y for (m, _), (_, y, _) in zip(weights, places, strict=True))
    parts = [inertia, ca.jacobian(inertia, th), ca.jacobian(energy, th)]
    buffer, evaluate = ca.Function("parts", [th], [ca.densify(ca.vertcat(*parts))]).buffer()
    at, found = np.zeros(1), np.zeros(3)
    buffer.set_arg(0, memoryview(at))  # a call by these takes a tenth of the time of one by numbers
    buffer.set_res(0, memoryview(found))

    def acceleration(_, th, w):
        at[0] = th
        evaluate()
        inertia, slope, pull = found.tolist()
        return (load(w) - pull - slope * w**2 / 2) / inertia

    acceleration.buffer = buffer  # lives as long
    return acceleration


def run(equations, stop, step, **given):
    """A run in which nothing is said about the method."""
    assert (Settings.method, Settings.relative_tolerance, configured(equations).solver) == ("auto", 1e-6, {})
    return alfmu.simulate(equations, stop, step, **given)


@cache
def declared(mechanism, *options):
    """Equations of a mechanism, traced once."""
    return prepared(alfmu.derive(mechanism(*options)), "vm")


CRANK, COUPLER, ROCKER, BASE, ARM = 0.05, 0.22, 0.09, 0.21, 0.45
WIPER = bars((0.1, CRANK), (0.15, COUPLER), (0.4, ARM))
STALL, FREE = 3.0, 6.5
"""Torque of the motor at rest [N.m], rate at which it has none [rad/s]."""


def wiper():
    """Crank, coupler and arm of a windscreen wiper under the torque of a motor."""
    m = alfmu.Mechanism("wiper")
    turn = m.coordinate("turn", "rad", start=0.3, rate=6.0, independent=True)
    swing, sweep = (m.coordinate(name, "rad", start=start) for name, start in (("swing", 0.1), ("sweep", 1.6)))
    crank = m.bar("crank", mass=WIPER[0][0], length=CRANK)
    coupler = m.bar("coupler", mass=WIPER[1][0], length=COUPLER)
    arm = m.bar("arm", mass=WIPER[2][0], length=ARM)
    motor = m.revolute("motor", m.ground.at(0, 0), crank.start, coordinate=turn)
    m.revolute("knuckle", crank.end, coupler.start, coordinate=swing)
    m.revolute("pivot", m.ground.at(BASE, 0), arm.start, coordinate=sweep)
    m.revolute("pin", coupler.end, arm.at(ROCKER, 0))
    m.gravity(0, -9.81)
    m.drive(motor, STALL * (1 - m.rate(turn) / FREE))
    return m


def wiper_poses(th):
    """Where two circles meet, above the line between the pivots."""
    x, y = CRANK * ca.cos(th), CRANK * ca.sin(th)
    far = ca.sqrt((BASE - x) ** 2 + y**2)
    sweep = ca.atan2(y, x - BASE) - ca.acos((far**2 + ROCKER**2 - COUPLER**2) / (2 * far * ROCKER))
    ahead, up = BASE + ROCKER * ca.cos(sweep), ROCKER * ca.sin(sweep)
    coupler = (x + ahead) / 2, (y + up) / 2, ca.atan2(up - y, ahead - x)
    return [(x / 2, y / 2, th), coupler, (BASE + ARM / 2 * ca.cos(sweep), ARM / 2 * ca.sin(sweep), sweep)]


@pytest.mark.slow
def test_a_windscreen_wiper():
    motion = eksergian(WIPER, wiper_poses, lambda th: 0.0, lambda w: STALL * (1 - w / FREE))
    exact = ode.motion(motion, 0.3, 6.0, np.arange(2001) * 0.005)[:, 0]
    assert exact[-1] > 40
    for every in (1, 4, 20):
        r = run(declared(wiper), 10.0, every * 0.005)
        assert np.abs(r["crank.angle"] - exact[::every]).max() <= BOUND, every


LEG, STAGES, LOAD, SPRING, REST = 1.0, 3, 60.0, 20000.0, 0.5


def lift(rails):
    """A scissor lift of three stages on a spring, in the places of its pins; rails guide what is guided already."""
    m = alfmu.Mechanism("lift")
    angle, pins = m.start("angle", 1.2, "rad"), {}
    for k in range(STAGES + 1):
        for side, x in (("left", 0.0), ("right", LEG * ca.cos(angle))):
            place = (
                m.coordinate(f"{side}{k}_x", "m", start=x),
                m.coordinate(f"{side}{k}_y", "m", start=k * LEG * ca.sin(angle)),
            )
            pins[side, k] = m.point(*place)
    m.tie(angle, ca.atan2(pins["right", 1].y - pins["left", 0].y, pins["right", 1].x - pins["left", 0].x))
    for k in range(STAGES):
        rising = m.bar(f"rising{k}", mass=5.0, length=LEG, between=(pins["left", k], pins["right", k + 1]))
        falling = m.bar(f"falling{k}", mass=5.0, length=LEG, between=(pins["right", k], pins["left", k + 1]))
        m.revolute(f"middle{k}", rising.at(LEG / 2, 0), falling.at(LEG / 2, 0))
    for name, open_by in (("foot_x", pins["left", 0].x), ("foot_y", pins["left", 0].y), ("floor", pins["right", 0].y)):
        m.constraint(name, open_by)
    for k in range(1, rails + 1):
        m.constraint(f"rail{k}", pins["left", k].x)
    m.body("table", mass=LOAD, inertia=1.0, pose=(pins["left", STAGES].x, pins["left", STAGES].y, 0.0))
    m.gravity(0, -9.81)
    m.potential_energy(SPRING / 2 * (pins["right", 0].x - REST) ** 2)
    return m


def lift_poses(th):
    x, y = LEG / 2 * ca.cos(th), LEG * ca.sin(th)
    legs = [(x, (k + 0.5) * y, way * th) for k in range(STAGES) for way in (1, -1)]
    return [*legs, (0.0 * th, STAGES * y, 0.0 * th)]


@pytest.mark.slow
@pytest.mark.parametrize("rails", [0, 3])
def test_a_scissor_lift_of_three_stages(rails):
    r = run(declared(lift, rails), 4.0, 0.02)
    weights = [*bars(*[(5.0, LEG)] * 2 * STAGES), (LOAD, 1.0)]
    motion = eksergian(weights, lift_poses, lambda th: SPRING / 2 * (LEG * ca.cos(th) - REST) ** 2, lambda w: 0.0)
    exact = ode.motion(motion, 1.2, 0.0, r.time)[:, 0]
    assert np.ptp(exact) > 0.5
    assert np.abs(r["rising0.angle"] - exact).max() <= BOUND


@cache
def crank_slider(coordinates):
    """The registered mechanism, traced once."""
    return prepared(alfmu.derive(alfmu.load("slider_crank", coordinates=coordinates)), "vm")


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.1, 0.02, 0.005])
@pytest.mark.parametrize("coordinates", ["absolute", "joint", "mixed", "natural"])
@pytest.mark.parametrize("masses", [(1.0, 1.0, 1.0), (4.0, 0.5, 0.02)], ids=["equal", "unequal"])
def test_a_slider_crank_through_its_singular_positions(masses, coordinates, step):
    """With equal links both stand upright at each half turn, where the slider may also stay at the crank's pivot."""
    given = {"l1": 1.0, "l2": 1.0} | {f"m{i}": m for i, m in enumerate(masses, 1)}
    r = run(crank_slider(coordinates), 5.0, step, parameters=given)
    m1, m2, m3 = masses
    motion = SliderCrank(l1=1.0, l2=1.0, m1=m1, m2=m2, m3=m3, aligned=True)
    exact = motion.motion(np.pi / 4, 0.0, r.time)[:, 0]
    assert np.count_nonzero(np.diff(np.sign(exact + np.pi / 2))) >= 2
    assert np.abs(r["crank.angle"] - exact).max() <= BOUND


BODIES = {
    **{"K1": (0.04325, 2.194e-6), "K2": (0.00365, 4.410e-7), "K3": (0.02373, 5.255e-6), "K4": (0.00706, 5.667e-7)},
    **{"K5": (0.07050, 1.169e-5), "K6": (0.00706, 5.667e-7), "K7": (0.05498, 1.912e-5)},
}
ANGLES = {
    **{"beta": -0.0617138900142764496, "theta": 0.0, "gamma": 0.455279819163070380, "phi": 0.222668390165885884},
    **{"delta": 0.487364979543842550, "omega": -0.222668390165885884, "epsilon": 1.23054744454982119},
}
AT_THE_END = {
    **{"beta": 15.81077119629904, "theta": -15.75637105984298, "gamma": 0.04082224013073101},
    **{"phi": -0.5347301163226948, "delta": 0.5244099658805304, "omega": 0.5347301163226948},
    **{"epsilon": 1.048080741042263},
}
"""The angles after 0.03 s, from the test set for solvers of initial value problems (Mazzia and Magherini, 2008)."""


def squeezer():
    """Andrews' mechanism of seven bodies (Hairer and Wanner, Solving Ordinary Differential Equations II, VII.7)."""
    m = alfmu.Mechanism("squeezer")
    beta, theta, gamma, phi, delta, omega, epsilon = (
        m.coordinate(name, "rad", start=start, independent=name == "beta") for name, start in ANGLES.items()
    )
    xa, ya, xb, yb, xc, yc = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072
    d, da, e, ea, rr, ra = 0.028, 0.0115, 0.02, 0.01421, 0.007, 0.00092
    ss, sa, sb, sc, sd = 0.035, 0.01874, 0.01043, 0.018, 0.02
    zf, zt, fa, ta, tb, u, ua, ub = 0.02, 0.04, 0.01421, 0.02308, 0.00916, 0.04, 0.01228, 0.00449

    def along(x, y, angle):
        """A vector of a body, in ground axes."""
        return x * ca.cos(angle) - y * ca.sin(angle), x * ca.sin(angle) + y * ca.cos(angle)

    def total(*vectors):
        return tuple(sum(x) for x in zip(*vectors, strict=True))

    A, B = (xa, ya), (xb, yb)
    crank, rod, upper, lower = along(rr, 0, beta), beta + theta, phi + delta, omega + epsilon
    places = {
        "K1": (along(ra, 0, beta), beta),
        "K2": (total(crank, along(-da, 0, rod)), rod),
        "K3": (total(B, along(sb, -sa, gamma)), gamma),
        "K4": (total(A, along(zt, 0, delta), along(0, ea - e, upper)), upper),
        "K5": (total(A, along(tb, -ta, delta)), delta),
        "K6": (total(A, along(0, -u, epsilon), along(zf - fa, 0, lower)), lower),
        "K7": (total(A, along(-ub, -ua, epsilon)), epsilon),
    }
    for name, (mass, inertia) in BODIES.items():
        (x, y), angle = places[name]
        m.body(name, mass=mass, inertia=inertia, pose=(x, y, angle))
    end = total(crank, along(-d, 0, rod))
    others = {
        "third": total(B, along(0, -ss, gamma)),
        "upper": total(A, along(zt, 0, delta), along(0, -e, upper)),
        "lower": total(A, along(0, -u, epsilon), along(zf, 0, lower)),
    }
    for name, (x, y) in others.items():
        m.constraint(f"{name}_x", end[0] - x)
        m.constraint(f"{name}_y", end[1] - y)
    x, y = total(B, along(sd, -sc, gamma))
    m.potential_energy(4530.0 / 2 * (ca.sqrt((x - xc) ** 2 + (y - yc) ** 2) - 0.07785) ** 2)
    m.generalized_force(beta, 0.033)
    for name, angle in zip(ANGLES, (beta, theta, gamma, phi, delta, omega, epsilon), strict=True):
        m.output(f"{name}.angle", angle, "rad")
    return m


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.03, 0.001, 0.0001])
def test_andrews_mechanism(step):
    r = run(declared(squeezer), 0.03, step)
    errors = {name: abs(r[f"{name}.angle"][-1] - value) for name, value in AT_THE_END.items()}
    assert max(errors.values()) <= BOUND, errors
    assert math.isclose(r.time[-1], 0.03)
