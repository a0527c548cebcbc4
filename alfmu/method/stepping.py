"""Integrators with error control, independent of mechanisms: they take a state vector, its rate and a tangent solver.

Methods are data. A step runs on NumPy arrays and on symbols, so it never branches on values. The rules for step sizes
at the end do, by a `where` that the caller passes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

State = Any
Rate = Callable[[Any, State], State]


# Methods ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Explicit:
    """An explicit Runge-Kutta method with embedded ones."""

    name: str
    order: int
    estimate: int
    """Order of the embedded method; its local error is one order higher in the step."""
    nodes: tuple[float, ...]
    stages: tuple[tuple[float, ...], ...]
    """Weights of the rates in the second stage, the third, and so on."""
    weights: tuple[float, ...]
    errors: tuple[tuple[float, ...], ...]
    """Weights of the rates in each estimate; one more than `weights` if the rate at the end is used."""

    @property
    def reuses(self) -> bool:
        """Whether the last stage of a step is the first of the next one (FSAL)."""
        return len(self.errors[0]) > len(self.weights)


@dataclass(frozen=True)
class Collocation:
    """An implicit Runge-Kutta method of collocation whose last node is the end of the step."""

    order: int
    estimate: int
    gamma: float
    """Weight of the rate at the start in the embedded method, and the factor of its filter."""
    nodes: tuple[float, ...]
    matrix: tuple[tuple[float, ...], ...]
    """Weights of the rates at the nodes in the state at each node."""
    errors: tuple[float, ...]
    """Weights of the rates at the nodes in the estimate; gamma is that of the rate at the start."""

    @property
    def name(self) -> str:
        """Return a name that identifies the method."""
        return f"collocation {self.order}"


EXPLICIT5 = Explicit(
    name="explicit 5",
    order=5,
    estimate=4,
    nodes=(0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
    stages=(
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    ),
    weights=(35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    errors=((71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40),),
)
"""Dormand and Prince, "A family of embedded Runge-Kutta formulae", J. Comput. Appl. Math. 6 (1980) 19-26."""

EXPLICIT5_SHORT = Explicit(
    name="explicit 5, short steps",
    order=5,
    estimate=4,
    nodes=(0.0, 1 / 5, 3 / 10, 3 / 5, 1.0, 7 / 8),
    stages=(
        (1 / 5,),
        (3 / 40, 9 / 40),
        (3 / 10, -9 / 10, 6 / 5),
        (-11 / 54, 5 / 2, -70 / 27, 35 / 27),
        (1631 / 55296, 175 / 512, 575 / 13824, 44275 / 110592, 253 / 4096),
    ),
    weights=(37 / 378, 0.0, 250 / 621, 125 / 594, 0.0, 512 / 1771),
    errors=(
        (
            *(37 / 378 - 2825 / 27648, 0.0, 250 / 621 - 18575 / 48384, 125 / 594 - 13525 / 55296),
            *(-277 / 14336, 512 / 1771 - 1 / 4),
        ),
    ),
)
"""Cash and Karp, "A variable order Runge-Kutta method for initial value problems with rapidly varying right-hand
sides", ACM Trans. Math. Softw. 16 (1990) 201-222: for short steps, as its estimate needs no rate at the end."""

EXPLICIT8 = Explicit(
    name="explicit 8",
    order=8,
    estimate=7,
    nodes=(0.0, 0.05, 0.1065625, 0.15984375, 0.39, 0.465, 0.155, 0.943, 0.901802041735857, 0.909, 0.94, 1.0, 1.0),
    stages=(
        (0.05,),
        (-0.0069931640625, 0.1135556640625),
        (0.0399609375, 0.0, 0.1198828125),
        (0.36139756280045754, 0.0, -1.3415240667004928, 1.3701265039000352),
        (0.049047202797202795, 0.0, 0.0, 0.23509720422144048, 0.18085559298135673),
        (0.06169289044289044, 0.0, 0.0, 0.11236568314640277, -0.03885046071451367, 0.01979188712522046),
        (-1.767630240222327, 0.0, 0.0, -62.5, -6.061889377376669, 5.6508231982227635, 65.62169641937624),
        (
            *(-1.1809450665549708, 0.0, 0.0, -41.50473441114321, -4.434438319103725, 4.260408188586133),
            *(43.75364022446172, 0.00787142548991231),
        ),
        (
            *(-1.2814059994414884, 0.0, 0.0, -45.047139960139866, -4.731362069449577, 4.514967016593808),
            *(47.44909557172985, 0.010592282971116612, -0.0057468422638446166),
        ),
        (
            *(-1.7244701342624853, 0.0, 0.0, -60.92349008483054, -5.951518376222393, 5.556523730698456),
            *(63.98301198033305, 0.014642028250414961, 0.06460408772358203, -0.0793032316900888),
        ),
        (
            *(-3.301622667747079, 0.0, 0.0, -118.01127235975251, -10.141422388456112, 9.139311332232058),
            *(123.37594282840426, 4.62324437887458, -3.3832777380682018, 4.527592100324618, -5.828495485811623),
        ),
        (
            *(-3.039515033766309, 0.0, 0.0, -109.26086808941763, -9.290642497400293, 8.43050498176491),
            *(114.20100103783314, -0.9637271342145479, -5.0348840888021895, 5.958130824002923, 0.0, 0.0),
        ),
    ),
    weights=(
        *(0.04427989419007951, 0.0, 0.0, 0.0, 0.0, 0.3541049391724449, 0.2479692154956438, -15.694202038838084),
        *(25.084064965558564, -31.738367786260277, 22.938283273988784, -0.2361324633071542, 0.0),
    ),
    errors=(
        (
            *(-3.27210390102875e-05, 0.0, 0.0, 0.0, 0.0, -0.0005046250618777615, 0.00012117235897848855),
            *(-20.142336771313868, 5.237178599439829, -8.156744408794658, 22.938283273988784, -0.2361324633071542),
            0.36016794372897754,
        ),
    ),
)
"""Verner's "most efficient" pair 8(7) (RKV87.IIa; "Numerically optimal Runge-Kutta pairs with interpolants", Numer.
Algorithms 53 (2010) 383-396); its error on smooth motions is a seventh of DOP853's."""

EXPLICIT8_BESIDE = Explicit(
    name="explicit 8, near singular positions",
    order=8,
    estimate=7,
    nodes=(
        *(0.0, 1 / 18, 1 / 12, 1 / 8, 5 / 16, 3 / 8, 59 / 400, 93 / 200, 5490023248 / 9719169821, 13 / 20),
        *(1201146811 / 1299019798, 1.0, 1.0),
    ),
    stages=(
        (1 / 18,),
        (1 / 48, 1 / 16),
        (1 / 32, 0.0, 3 / 32),
        (5 / 16, 0.0, -75 / 64, 75 / 64),
        (3 / 80, 0.0, 0.0, 3 / 16, 3 / 20),
        (
            *(29443841 / 614563906, 0.0, 0.0, 77736538 / 692538347, -28693883 / 1125000000),
            23124283 / 1800000000,
        ),
        (
            *(16016141 / 946692911, 0.0, 0.0, 61564180 / 158732637, 22789713 / 633445777),
            *(545815736 / 2771057229, -180193667 / 1043307555),
        ),
        (
            *(39632708 / 573591083, 0.0, 0.0, -433636366 / 683701615, -421739975 / 2616292301),
            *(100302831 / 723423059, 790204164 / 839813087, 800635310 / 3783071287),
        ),
        (
            *(246121993 / 1340847787, 0.0, 0.0, -37695042795 / 15268766246, -309121744 / 1061227803),
            *(-12992083 / 490766935, 6005943493 / 2108947869, 393006217 / 1396673457, 123872331 / 1001029789),
        ),
        (
            *(-1028468189 / 846180014, 0.0, 0.0, 8478235783 / 508512852, 1311729495 / 1432422823),
            *(-10304129995 / 1701304382, -48777925059 / 3047939560, 15336726248 / 1032824649),
            *(-45442868181 / 3398467696, 3065993473 / 597172653),
        ),
        (
            *(185892177 / 718116043, 0.0, 0.0, -3185094517 / 667107341, -477755414 / 1098053517),
            *(-703635378 / 230739211, 5731566787 / 1027545527, 5232866602 / 850066563),
            *(-4093664535 / 808688257, 3962137247 / 1805957418, 65686358 / 487910083),
        ),
        (
            *(403863854 / 491063109, 0.0, 0.0, -5068492393 / 434740067, -411421997 / 543043805),
            *(652783627 / 914296604, 11173962825 / 925320556, -13158990841 / 6184727034),
            *(3936647629 / 1978049680, -160528059 / 685178525, 248638103 / 1413531060, 0.0),
        ),
    ),
    weights=(
        *(14005451 / 335480064, 0.0, 0.0, 0.0, 0.0, -59238493 / 1068277825, 181606767 / 758867731),
        *(561292985 / 797845732, -1041891430 / 1371343529, 760417239 / 1151165299, 118820643 / 751138087),
        *(-528747749 / 2220607170, 1 / 4),
    ),
    errors=(
        (
            *(14005451 / 335480064 - 13451932 / 455176623, 0.0, 0.0, 0.0, 0.0),
            *(808719846 / 976000145 - 59238493 / 1068277825, 181606767 / 758867731 - 1757004468 / 5645159321),
            *(561292985 / 797845732 - 656045339 / 265891186, 3867574721 / 1518517206 - 1041891430 / 1371343529),
            *(760417239 / 1151165299 - 465885868 / 322736535, 118820643 / 751138087 - 53011238 / 667516719),
            *(-528747749 / 2220607170 - 2 / 45, 1 / 4),
        ),
    ),
)
"""Prince and Dormand, "High order embedded Runge-Kutta formulae", J. Comput. Appl. Math. 7 (1981) 67-75: for steps on
the branch near a singular position, where rates are noisy. Its weights are below 1; those of `EXPLICIT8` reach 32 and
amplify the noise 40 times more. On smooth motions it takes 1.5 times the steps."""

RADAU9 = Collocation(
    order=9,
    estimate=5,
    gamma=0.15906584442746913,
    nodes=(0.05710419611451768, 0.2768430136381238, 0.5835904323689168, 0.8602401356562195, 1.0),
    matrix=(
        (0.07299886431790333, -0.02673533110794557, 0.018676929763984353, -0.01287910609330644, 0.005042839233882015),
        (0.15377523147918246, 0.14621486784749352, -0.03644456890512809, 0.02123306311930472, -0.007935579902728777),
        (0.14006304568480987, 0.29896712949128346, 0.16758507013524895, -0.03396910168661774, 0.010944288744192253),
        (0.14489430810953477, 0.2765000687601592, 0.32579792291042103, 0.12875675325490976, -0.015708917378805327),
        (0.14371356079122594, 0.28135601514946207, 0.31182652297574126, 0.22310390108357075, 0.04),
    ),
    errors=(-0.2523433122495464, 0.16035712210296996, -0.11627313434096281, 0.08100664894556402, -0.03181316888549383),
)
"""Radau IIA with five nodes (Hairer and Wanner, "Stiff differential equations solved by Radau methods", J. Comput.
Appl. Math. 111 (1999) 93-111): order 9, L-stable, of order at least 5 for stiff components."""


# Steps ------------------------------------------------------------------------------------------------------------


def combined(weights: Sequence[float], values: Sequence[State], begin: State | None = None) -> State:
    """Return `begin` plus the weighted sum of values; values of weight zero are left out."""
    for weight, value in zip(weights, values, strict=True):
        if weight:
            begin = weight * value if begin is None else begin + weight * value
    return begin


def explicit(
    method: Explicit,
    rate: Rate,
    t: Any,
    y: State,
    dt: Any,
    first: State | None = None,
    settle: Callable[[State], State] | None = None,
    less: Callable[[State, State], State] = lambda other, first: other - first,
) -> tuple[State, list[State], State | None]:
    """Return one step from y at t to t + dt: the new state, estimates of its error, and the rate there if known.

    `first` is the rate at y if known. `settle` projects the new state onto the constraints; an FSAL method evaluates
    its last rate there, since the next step begins there. `less` subtracts the first rate from another one.
    """
    first = rate(t, y) if first is None else first
    others: list[State] = []  # differences from the first rate, so that large weights of opposite sign lose no digits
    for node, weights in zip(method.nodes[1:], method.stages, strict=True):
        place = combined(weights[1:], others, node * first)
        others.append(less(rate(t + node * dt, y + dt * place), first))
    y = y + dt * combined(method.weights[1:], others, first)
    if settle is not None:
        y = settle(y)
    last = rate(t + dt, y) if method.reuses else None
    if last is not None:
        others.append(less(last, first))
    return y, [dt * combined(weights[1:], others) for weights in method.errors], last


def kink_bounds(method: Explicit | Collocation) -> list[tuple[float, ...]]:
    """Return weights of the rates for bounds of the error that a kink within a step causes.

    For a collocation method the rate at the start comes first. Estimates of high order miss most of this error: the
    embedded methods have weights of 1e-4 in their first stages, a filter damps it like a stiff component, and any
    single estimate vanishes for some position of the kink. Each bound is the residual of one rate from a polynomial of
    second degree, times the weight of that rate if it is above 1. Their maximum is at least two thirds of the error of
    a jump or kink anywhere in the step.
    """
    nodes, weights = method.nodes, method.matrix[-1] if isinstance(method, Collocation) else method.weights
    if isinstance(method, Collocation):
        nodes, weights = (0.0, *nodes), (0.0, *weights)
    powers = np.vander(nodes, 3)
    left = np.eye(len(nodes)) - powers @ np.linalg.pinv(powers)
    return [tuple(row) for row in (np.maximum(np.abs(weights), 1.0)[:, None] * left).tolist()]


def continued(method: Collocation, k: list[State], ratio: Any) -> list[State]:
    """Extrapolate the rates to the next step, `ratio` times as long, by the polynomial through the rates of the last
    step."""
    nodes = method.nodes
    guesses = []
    for node in nodes:
        x, weights = 1 + ratio * node, []
        for i, here in enumerate(nodes):
            weight = 1.0
            for j, other in enumerate(nodes):
                if j != i:
                    weight = weight * (x - other) / (here - other)
            weights.append(weight)
        guesses.append(sum((w * f for w, f in zip(weights[1:], k[1:], strict=True)), weights[0] * k[0]))
    return guesses


# Step sizes -------------------------------------------------------------------------------------------------------


LOOSE = 1e-4
"""Tolerance of a run above which the pair of order 5 is more efficient than that of order 8."""


EXPLICIT_METHODS = {"order8": EXPLICIT8}
"""Explicit methods that are the same at every tolerance, by the name of `solver.method`."""


def explicit_rule(method: str, run: float, carried: str | None = None) -> Explicit | None:
    """Return the explicit method that `solver.method` selects at the tolerance of a run, None if it is not explicit.

    `carried` names the method traced into the scene; if given, it is used at any tolerance.
    """
    return explicit_at(run, carried) if method == "explicit" else EXPLICIT_METHODS.get(method)


def explicit_at(run: float, carried: str | None = None) -> Explicit:
    """Return the method that `explicit` stands for, as `explicit_rule`."""
    wanted = EXPLICIT5 if run > LOOSE else EXPLICIT8
    return next((rule for rule in (EXPLICIT5, EXPLICIT8) if rule.name == carried), wanted)


def rule_beside(rule: Explicit) -> Explicit:
    """Return the method that replaces an explicit one for steps on the branch near a singular position."""
    return EXPLICIT8_BESIDE if rule is EXPLICIT8 else rule


SHARE = 0.0016
"""tolerance of a step over that of a run [1]: errors of steps add up and grow with the motion; at the default tolerance
a slider-crank of equal links that turns twice is at most 7e-8 rad off in 12,000 phases, and at 0.002 it is 1.2e-7."""


STEADY = 1e-6
"""Tolerance of a run up to which the tolerance of a long explicit step is proportional to it."""

LOOSER = 0.25
"""Exponent by which the step tolerance falls further above STEADY, where steps are so long that the estimate misses
part of their errors. Without it, Bennett's linkage is 35 tolerances off at 1e-4 after 10 s; with it 2, at a cost of a
seventh more evaluations."""


def share(method: Explicit | Collocation) -> tuple[float, float]:
    """Return factor and exponent of the step tolerance, factor * (run tolerance)^exponent.

    The estimate of a collocation method has a far lower order than the method: with the exponent of Hairer and
    Wanner's RADAU code the error is still proportional to the tolerance.
    """
    return SHARE, (method.estimate + 1) / (method.order + 1) if isinstance(method, Collocation) else 1.0


SPLIT = 2.0
"""Number of steps left up to an end below which they are made equal."""

NOISE = 8.0
"""Error attributed to round-off, as a multiple of one sample of it; errors below it are ignored. At a multiple of 4,
steps of the flyball governor by an explicit method collapse at 1e-12."""

SHORTEST = 1e-12
"""Step [s] below which a run fails."""

SAFETY = 0.9
"""Safety factor of a new step, over the one that would just meet the tolerance."""

INTEGRAL = 0.7
"""Exponent of the current error over the tolerance."""

PROPORTIONAL = 0.4
"""Exponent of the previous error over the tolerance, with opposite sign."""

LEAST_FACTOR, MOST_FACTOR = 0.2, 5.0
"""Bounds of the ratio of a step to the previous one."""

LEAST_ERROR, LEAST_BEFORE = 1e-6, 1e-2
"""Lower bounds of the current and of the previous error over the tolerance."""

Where = Callable[[Any, Any, Any], Any]
"""Takes a condition and two values, and returns the first where it holds, else the second, for numbers and
for symbols."""


def chosen(condition: bool, a: float, b: float) -> float:
    """Return a if the condition holds, else b: `Where` for numbers."""
    return a if condition else b


def landing(dt: Any, left: Any, where: Where = chosen) -> Any:
    """Return a step of about dt that covers `left` without a tiny last step."""
    return where(dt >= left * (1 - 1e-9), left, where(SPLIT * dt > left, left / 2, dt))


def judged(
    order: int, numbers: Sequence[Any], step: Any, error: Any, where: Where = chosen
) -> tuple[Any, Any, Any, Any]:
    """Return the numbers of step control after a step, given its error over the tolerance, and whether it is accepted.

    The numbers are the proposed step [s], the error of the last accepted step over the tolerance, and whether the last
    attempt was rejected.

    The controller is proportional-integral in the logarithm of the error. An accepted step that was cut to end at a
    given time does not shorten the next. A NaN error is rejected.
    """

    def larger(a: Any, b: Any) -> Any:
        return where(a > b, a, b)

    def smaller(a: Any, b: Any) -> Any:
        return where(a < b, a, b)

    dt, before, refused = numbers
    accepted = error <= 1.0
    over = where(error < math.inf, larger(error, 1.0), math.inf)
    again = step * larger(LEAST_FACTOR, SAFETY * over ** (-1 / order))
    small = larger(error, LEAST_ERROR)
    factor = SAFETY * small ** (-INTEGRAL / order) * before ** (PROPORTIONAL / order)
    following = step * smaller(larger(factor, LEAST_FACTOR), where(refused, 1.0, MOST_FACTOR))
    following = where(step < dt * (1 - 1e-9), larger(dt, following), following)
    return (
        where(accepted, following, again),
        where(accepted, larger(error, LEAST_BEFORE), before),
        where(accepted, 0.0, 1.0),
        accepted,
    )


CONVERGED = 1e-5
"""Largest last change of Newton's method with fixed tangents, over the tolerance of the step."""

SLOW = 0.2
"""Ratio of successive changes above which new tangents cost less than further iterations."""


def newton(change: Any, before: Any, where: Where = chosen) -> tuple[Any, Any]:
    """Return whether Newton's method with fixed tangents has converged, and whether another iteration can succeed.

    `change` and `before` are the last two changes over the tolerance; `before` is infinite at the first iteration.
    """
    rate = change / before
    converged = where(before < math.inf, change * rate, change) <= CONVERGED * (1 - rate)
    return converged, where(converged, 0.0, where(rate < SLOW, 1.0, 0.0))
