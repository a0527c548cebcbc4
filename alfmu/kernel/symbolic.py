"""The method in symbols, for the equations of one mechanism; every part reports whether its unrolled loops converged.

Equation (4) is divided by alpha, the largest penalty, so that no product with it remains: M, F and the multipliers are
in units of alpha here (times `scale`), and so are H, its pivots and its factors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property, reduce
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np
from casadi import SX

from ..equations import Configuration
from ..equations.evaluation import DENSE, elimination_order, loops, symbols, telling
from ..equations.interface import MONITORS
from ..method import formulations as method
from ..method import implicit
from ..method import singular as branch
from ..method.implicit import Newmark
from ..method.inputs import memory_size
from ..method.stepping import NOISE, Explicit
from .form import Plan
from .memory import PACE, SETTINGS, TURN, Layout, SceneSettings

MATRICES = ("M", "C", "F", "xi", "D", "L")
"""Values that an evaluation passes on, by their nonzeros: the terms of (4) and (3), and the factors of H."""

SHARES = 6
"""Passes that share a load among constraints of different compliances; each gains a factor of alpha over the masses and
over the ratio of compliances."""

_SHARED = 1e-12
"""Largest last change of the shares, over their size, at which the passes have converged."""

LOADED = 3
"""Passes that share a load among joints for outputs."""

PATIENT_LOADED = 8
"""Passes that share a load near a singular position: each gains HELD_SHARES times the distance squared."""

_LEFT = 2.0**-50
"""Largest last change of the coefficients of multipliers of least norm, over their size, at convergence."""

LEFT_BY_FEW = 1e-3
"""Error of accelerations that few multiplier iterations may leave, over the relative tolerance of a step."""

SOFT = 1e-5
"""Typical pivot contributed by masses, over softened penalties: iterations then gain five digits each, and a motion
that moves 1e-6 of the usual mass keeps five of its digits in H."""

_SOFTEST = 1e4
"""Largest factor by which penalties are softened."""

_TOLD = 4.0
"""Smallest margin, over the noise floor, that counts as nonzero."""

_ALONE = 1e-10
"""Added to the diagonal of C C', whose rows have length 1, so that dependent rows leave a pivot of this size."""

_TINY = 1e-300
"""Avoids division by zero in the convergence check of a mechanism at rest."""

WORK_SHARE = 300.0
"""Tolerance of the work of a prescribed motion in a step over that of q and v [1]: with 1, an excavator makes twice the
evaluations at communication steps of 0.05 s, whose work is right to 2e-7 as it is; with 1000, it is off by 8e-6."""

EPSILON = 2.0**-52
"""Relative round-off of a number."""

ROUND_OFF = 8 * EPSILON
"""Round-off of a constraint, over its coordinates."""

_PROBES = 5
"""Number of positions at which entries of H are compared, to find constant ones."""

_SAME = 1e-13
"""Largest relative difference of an entry of H that counts as constant."""


def lengths_of(equations: Configuration) -> dict[str, int]:
    """Return lengths of the named values of functions of programs; names with appended digits share a length."""
    e, n, l, inputs = equations, equations.n, equations.l, len(equations.inputs)
    found = {name: length for name, (_, length) in Layout(e).fields.items()}
    alike = {
        "t tz tl tn step arrival power powern powerl work pivot here zone zonen spacing stretched near slow": 1,
        "singular lost noise error read_power renew before passes size most patient again projects within floor": 1,
        "of_least_norm on_branch onward by_classic by_penalty by_stiffness by_baumgarte by_dae": 1,
        "supply supplied suppliedn crossed margin off_work": 1,
        "left stabilisation": 2,
        "watch watched watchl watchn read_watch": len(Watch._fields),
        "q qz ql qn v vz vl vn way a al an place placed acceleration guess dq dv change w after_w dx least_z": n,
        "shared_mu": n,
        "aside off_q off_v": n,
        "round_off round_off_along read_a": n,
        "lam laml lamn force Phi Cv stabilised least_norm shared shared_last": l,
        "inputs": inputs,
        "past": memory_size(inputs),
        "soft": found["k"],
        "slopes": 1 + inputs,
        "rate difference": 2 * n + 1 + len(e.states),
        "x xdot off_x": len(e.states),
        "given known": e.driven,
        "H Q": (n + len(e.states)) ** 2,
        "rows": l * n,
        "system_solution": n + l,
    }
    for names, length in alike.items():
        found |= dict.fromkeys(names.split(), length)
    count = len(e.frictions)
    # Dry friction (`kernel.rubbing`): changes of a and lam per unit of each, passes, convergence of the laws,
    # decisions.
    return found | {"moved": n * count, "pressed": l * count, "rubs": 1, "rubbed": 2, "grip": 3 * count + 2}


class Watch(NamedTuple):
    """Diagnostics of an evaluation."""

    change: SX
    """Last change of a, squared, without the round-off of the forces."""
    size: SX
    """Squared norm of a."""
    pivot: SX
    """Smallest pivot of H."""
    near: SX
    """Whether the margin to a singular position may be below `alfmu.method.singular.BRANCH_MARGIN`."""
    margin: SX
    """This margin; 1 in the quick step, which does not compute it."""

    @classmethod
    def of(cls, vector: SX) -> Watch:
        return cls(*ca.vertsplit(vector))

    def vector(self) -> SX:
        return ca.vertcat(*self)


class Sharing(NamedTuple):
    """Values that the passes of `Scene.carried` have in common."""

    P: SX
    inverse: SX
    """Inverse pivots."""
    L: SX
    weights: SX
    slope: SX
    sizes: SX
    size: SX
    """Size of the given loads."""
    order: list[int]
    """Order in which the factors eliminate."""

    @classmethod
    def of(cls, known: Sharing, vector: SX) -> Sharing:
        """Return the values in a vector; `known` has their sparsity."""
        ends = np.cumsum([0, *(x.nnz() for x in known[:-1])]).tolist()
        parts = [SX(x.sparsity(), vector[i:j]) for x, (i, j) in zip(known[:-1], pairwise(ends), strict=True)]
        P, inverse, L, weights, slope, sizes, size = parts
        return cls(P, inverse, L, weights, slope, sizes, size, known.order)

    def vector(self) -> SX:
        """Return the nonzeros."""
        return SX(ca.vertcat(*(entry for x in self[:-1] for entry in x.nz[:].nz)))


class Scene:
    """The method of a scene, with a symbol for each named value."""

    def __init__(self, equations: Configuration, weighted: bool, lengths: dict[str, int]):
        self.e, self.kind, self._lengths = equations, "weighted" if weighted else "plain", lengths
        self._symbols: dict[str, SX] = {}
        self._factorisations: dict[tuple[int, ...], ca.Function] = {}
        """Factorisations of H, by sparsity."""
        e, self.p, self.k = equations, self.symbol("p"), self.symbol("k")
        self.settings = SceneSettings(*ca.vertsplit(self.k[: len(SETTINGS)]))
        self.scale = 1 / self.settings.alpha
        ends = np.cumsum([len(SETTINGS), e.l, e.l, e.n, len(e.compliances), e.n * bool(e.l)]).tolist()
        own, units, self.inverse_scales, self.stiffnesses, self.way = (self.k[a:b] for a, b in pairwise(ends))
        if not weighted:  # a single penalty applies to a single unit
            own, units = SX.ones(e.l), self.k[ends[1]]
        self.inverse_units = units
        self.held = own > 0 if weighted else own
        self._shares = ca.diag(self.stiffnesses if e.compliances else own)
        self._unit_lengths = SX(e.l, e.l)
        for i in e.lengths:
            self._unit_lengths[i, i] = self.held[i]
        self.weights = ca.reshape(self.k[ends[-1] :], e.l, e.l) if e.survey.brakes else ca.diag(own)

    # Named values --------------------------------------------------------------------------------------------------

    def symbol(self, name: str) -> SX:
        """Return the symbol of a value; of a matrix, of its nonzeros."""
        if name not in self._symbols:
            self._symbols[name] = SX.sym(name, self.length(name))
        return self._symbols[name]

    def length(self, name: str) -> int:
        if name in MATRICES:
            return self.patterns[name].nnz()
        if name == "sharing":
            return self.sharing.vector().numel()
        return self._lengths[name if name in self._lengths else name.rstrip("0123456789")]

    def value(self, name: str) -> SX:
        """Return the symbol of a value; a matrix has its sparsity."""
        symbol = self.symbol(name)
        return SX(self.patterns[name], symbol) if name in MATRICES else symbol

    @cached_property
    def patterns(self) -> dict[str, ca.Sparsity]:
        """Sparsity of MATRICES."""
        x = symbols(self.e)
        terms = self.terms(x["t"], x["q"], x["v"], x["u"])
        values = self._handed(terms, *self.factors(self.augmented_mass(*terms[:2])))
        return {name: value.sparsity() for name, value in zip(MATRICES, values, strict=True)}

    @staticmethod
    def _handed(terms: Sequence[SX], D: SX, L: SX) -> list[SX]:
        """Return the values of MATRICES, with dense vectors."""
        M, C, F, xi = terms
        return [M, C, ca.densify(F), ca.densify(xi), ca.densify(D), L]

    # Evaluations ---------------------------------------------------------------------------------------------------

    def terms(self, t: SX, q: SX, v: SX, u: SX) -> tuple[SX, SX, SX, SX]:
        """Return M, C, F, xi."""
        M, C, F, xi = self.e.dynamics(q, v, u, self.p, t)
        return self.scale * ca.sparsify(M), ca.sparsify(C), self.scale * F, xi

    def power(self, t: SX, q: SX, v: SX, u: SX) -> SX:
        return self.e.power(q, v, u, self.p, t) if self.e.works else SX(0)

    def supply(self, t: SX, q: SX, v: SX, a: SX, lam: SX, u: SX) -> SX:
        """Return power of prescribed motion, if time is a coordinate."""
        return self.e.motion_power(q, v, a, lam / self.scale, u, self.p, t)

    def speed(self, q: SX, v: SX, C: SX) -> SX:
        """Return Phi-dot, the residual of (2), for velocities or for displacements along v."""
        return self.e.Phi_dot(q, v, self.p) if self.e.timed else C @ v

    def _own(self, x: SX) -> SX:
        """Return the entries of coordinates except time."""
        return x[: self.e.dependent] if self.e.dependent else SX(0, 1)

    def evaluated(self, t: SX, q: SX, v: SX, u: SX) -> list[SX]:
        """Return MATRICES, a and lam after the first iteration, power, watch."""
        *found, watch = self.begun(self.terms(t, q, v, u))
        return [*found, self.power(t, q, v, u), watch]

    def begun(self, terms: Sequence[SX]) -> list[SX]:
        """Return the results of `evaluated` for given M, C, F, xi, without power."""
        D, L = self.factors(self.augmented_mass(*terms[:2]))
        a, lam, _ = self.iterated(terms, (D, L), *self._at_rest(), 1)
        watch = Watch(self.squares(a), self.squares(a), ca.mmin(D), *self.margin(D, L))
        return [*(ca.vec(value.nz[:]) for value in self._handed(terms, D, L)), a, lam, watch.vector()]

    def iterated_again(self, M: SX, C: SX, F: SX, xi: SX, D: SX, L: SX, a: SX, lam: SX, watch: SX) -> tuple[SX, SX, SX]:
        """Return a, lam and watch after one more iteration."""
        a, lam, change = self.iterated((M, C, F, xi), (D, L), a, lam, 1)
        change = ca.fmax(self.squares(change) - self.left(M, F), 0)
        return a, lam, Watch.of(watch)._replace(change=change, size=self.squares(a)).vector()

    def left(self, M: SX, *forces: SX) -> SX:
        """Return the accelerations (squared) within the tolerance of forces in balance, which leave round-off: it may
        exceed accelerations near zero."""
        size = sum((self.squares(x, -2) for x in forces), SX(0))
        return self.settings.tolerance**2 * size / (self.squares(ca.diag(M), -4) + _TINY)

    def iterated(self, terms: Sequence[SX], factors: tuple[SX, SX], a: SX, lam: SX, most: int) -> tuple[SX, SX, SX]:
        """Return a and lam after `most` iterations, and the last change of a."""
        M, C, F, xi = terms
        changes = []

        def done(change: SX, _: SX) -> bool:
            changes.append(change)
            return False

        a, lam, _, _ = method.residual(M, F, C, xi, self.weights, self.solver(*factors), a, lam, most, done)
        return a, lam, changes[-1]

    def _at_rest(self) -> tuple[SX, SX]:
        """Return a and lam before the first iteration."""
        return SX(self.e.n, 1), SX(self.e.l, 1)

    def nearest(self, plan: Plan, t: SX, q: SX, v: SX, u: SX, a: SX) -> tuple[SX, SX]:
        """Return the accelerations nearest to a in the metric of M that satisfy the constraints, and their watch."""
        M, C, _, xi = self.terms(t, q, v, u)
        D, L = self.factors(self.augmented_mass(M, C))
        found, _, change = self.iterated((M, C, M @ a, xi), (D, L), *self._at_rest(), plan.iterations)
        return found, Watch(self.squares(change), self.squares(found), ca.mmin(D), *self.margin(D, L)).vector()

    def unconverged(self, plan: Plan, evaluations: list[Watch], limit: SX | float | None = None) -> SX:
        """Return the number of failed convergence checks; `limit` is the error allowed after few iterations, by default
        the tolerance."""
        if not self.e.l:
            return SX(0)
        change, size = sum(x.change for x in evaluations), evaluations[0].size
        if not plan.quick:
            return 1 - (change <= self.settings.tolerance**2 * sum(x.size for x in evaluations) + _TINY)
        # Each of m iterations gains about the same factor, so a last change of limit^((m - 1) / m) leaves the limit.
        m, limit = plan.iterations, self.settings.tolerance if limit is None else limit
        return 1 - (change <= limit ** (2 * (m - 1) / m) * size + _TINY)

    def gaining(self, watch: SX, before: SX) -> tuple[SX, SX]:
        """Return whether multiplier iterations that have not converged still gain, and the last change."""
        seen = Watch.of(watch)
        done = seen.change <= self.settings.tolerance**2 * seen.size + _TINY
        return ca.logic_and(ca.logic_not(done), seen.change < method.GAIN**2 * before), seen.change

    def softened(self) -> SX:
        """Return k with penalties reduced so far that the contribution of masses to H keeps its digits."""
        settings = self.settings
        typical = ca.exp(settings.masses / ca.fmax(settings.freedom, 1))
        factor = ca.if_else(settings.freedom > 0, ca.fmin(ca.fmax(SOFT / typical, 1), _SOFTEST), 1)
        changed = {
            "alpha": settings.alpha / factor,
            "masses": settings.masses + settings.freedom * ca.log(factor),
            "regular": settings.regular + settings.freedom * ca.log(factor),
            "nothing": settings.nothing * factor,
        }
        return ca.vertcat(*settings._replace(**changed), self.k[len(SETTINGS) :])

    def judged(self, plan: Plan, watch: SX) -> tuple[SX, SX]:
        """Return whether more iterations are needed, and the watch with a bound of the change by one more if not.

        An iteration gains at least the ratio of the margin to the pivot contributed by masses.
        """
        seen = Watch.of(watch)
        next_change = seen.change * (self.settings.nothing / branch.NOISE_FLOOR / seen.margin) ** 2
        seen = seen._replace(change=ca.fmin(seen.change, next_change))
        return self.unconverged(plan, [seen]), seen.vector()

    # Implicit methods ----------------------------------------------------------------------------------------------

    def given(self, z: SX, u: SX) -> SX:
        """Return inputs, followed by the states of z: u of the equations."""
        layout = Layout(self.e)
        return ca.vertcat(u, z[layout.states : layout.time]) if self.e.states else u

    def stiffness(self, t: SX, q: SX, v: SX, a: SX, lam: SX, u: SX, M: SX, C: SX) -> tuple[SX, SX, SX]:
        """Return H, Q, V of `alfmu.method.implicit.stiffness`; states follow v, as velocities of masses of 1."""
        tangents = self.e.tangents(q, v, a, lam / self.scale, u, self.p, t)
        Rq, Rv, Xq, Xv = map(ca.sparsify, tangents[:4])
        H = self.augmented_mass(M, C)
        found = implicit.stiffness(H, C, self.weights, self.scale * Rq, self.scale * Rv, Xq, Xv)
        return self.beside_states(*found, *(ca.sparsify(x) for x in tangents[5:])) if self.e.states else found

    def beside_states(self, H: SX, Q: SX, V: SX, Rx: SX, Gq: SX, Gv: SX, Gx: SX) -> tuple[SX, SX, SX]:
        """Return H, Q, V extended by rows and columns for states, which have no displacements."""
        n, count, s = self.e.n, len(self.e.states), self.scale
        Q = ca.blockcat([[Q, SX(n, count)], [s * Gq, SX(count, count)]])
        return ca.diagcat(H, s * SX.eye(count)), Q, ca.blockcat([[V, s * Rx], [s * Gv, s * Gx]])

    def positions(self, rule: Newmark, dt: SX, t: SX, q: SX, v: SX, a: SX, lam: SX, u: SX) -> tuple[SX, ...]:
        """Return H, Rq, Rv, C (by columns), Phi and the right-hand side of `method.implicit.position_step`.

        The rates of states follow the accelerations a, as in `stiffness`.
        """
        M, C, F, _ = self.terms(t, q, v, u)
        Phi = self.e.Phi(q, self.p)
        a, rates = (a[: self.e.n], a[self.e.n :]) if self.e.states else (a, None)
        tangents = self.e.tangents(q, v, a, lam / self.scale, u, self.p, t)
        Rq, Rv = (self.scale * ca.sparsify(x) for x in tangents[:2])
        R, H, rows = F - M @ a - C.T @ lam, self.augmented_mass(M, C), ca.vec(ca.densify(C))
        if rates is not None:
            R = ca.vertcat(R, self.scale * (self.e.state_rates(q, v, u, self.p, t) - rates))
            H, Rq, Rv = self.beside_states(H, Rq, Rv, *map(ca.sparsify, tangents[5:]))
            M, C = ca.diagcat(M, self.scale * SX.eye(rates.numel())), ca.horzcat(C, SX(self.e.l, rates.numel()))
        right: list[SX] = []

        def divide(A: SX, b: SX) -> SX:
            right.append(b)
            return b

        implicit.position_step(M, C, Phi, R, Rq, Rv, self.weights, rule, dt, divide)
        return H, Rq, Rv, rows, Phi, *right

    # Multipliers where constraints are redundant -------------------------------------------------------------------

    def least(self, C: SX, D: SX, L: SX, lam: SX) -> SX:
        """Return lam of least norm, NaN if the passes did not converge, as with small penalties."""
        left: list[SX] = []

        def done(change: SX, value: SX) -> bool:
            left[:] = [1 - (ca.sumsqr(change) <= _LEFT**2 * ca.sumsqr(value))]
            return False

        lam, rubbing = self._apart(lam)
        lam = method.minimum_norm(C, self.weights, self.solver(D, L), lam, 2, done)
        return ca.if_else(left[0], math.nan, lam + rubbing if self.e.frictions else lam)

    def _apart(self, lam: SX) -> tuple[SX, SX]:
        """Split lam into multipliers of constraints in force, and of sliding joints with dry friction."""
        if not self.e.frictions:
            return lam, SX(self.e.l, 1)
        own = SX(self.e.l, 1)
        for each in self.e.frictions:
            own[each.row] = (1 - self.held[each.row]) * lam[each.row]
        return lam - own, own

    def least_again(self, C: SX, D: SX, L: SX, lam: SX, z: SX, before: SX) -> tuple[SX, SX, SX, SX]:
        """Make one more pass: return z, its lam, whether another pass is needed, and its change (squared)."""
        lam, rubbing = self._apart(lam)
        change = method.nearer_norm(C, self.weights, self.solver(D, L), lam, z)
        z = z + change
        changed = ca.sumsqr(C @ change)
        more = 1 - method.settled(changed, before, ca.sumsqr(C @ z), self.settings.tolerance)
        lam = self.weights @ (C @ z)
        return z, lam + rubbing if self.e.frictions else lam, more, changed

    def distributed(self, M: SX, C: SX, lam: SX, passes: int = SHARES) -> SX:
        """Return lam shared among joints by the given compliances or with least norm; NaN if the passes did not
        converge."""
        weights, last = self._shares, list[SX]()
        lam, rubbing = self._apart(lam)

        def inverse(C: SX) -> method.Solve:
            return self.solver(*self.factors(method.augmented_mass(M, C, weights)))

        def done(change: SX, value: SX) -> bool:
            last[:] = [ca.sumsqr(weights @ change), ca.sumsqr(weights @ value)]
            return False

        lam = method.minimum_norm_of_joints(C, weights, self._unit_lengths, inverse, lam, passes, done)
        lam = ca.if_else(last[0] <= _SHARED**2 * last[1], lam, math.nan)
        return lam + rubbing if self.e.frictions else lam

    def light(self, M: SX) -> SX:
        """Return M scaled so far below penalties that few passes suffice, for any given penalty."""
        return M * ca.fmin(1, method.LIGHT / ca.fmax(ca.mmax(ca.diag(M)), _TINY))

    def carried(
        self, t: SX, q: SX, v: SX, u: SX, C: SX, a: SX, lam: SX, *, passes: int = LOADED, impact: bool = False
    ) -> SX:
        """Return lam of the same effect with least loads of joints; NaN if the passes did not converge.

        In an impact, a are changes of v, and there are no other loads. docs/theory/redundancy.md defines the loads,
        `method.formulations.shared_again` the algorithm.
        """
        known, C = self._sharing_of(t, q, v, u, C, a, lam, impact)
        d, last = SX(self.e.l, 1), SX(self.e.l, 1)
        mu = SX(self.e.n, 1)
        for _ in range(passes):
            d, mu, last = self._shared(known, C, d, mu)
        return self._carried(known, lam, d, last, passes)

    def sharing_begun(self, t: SX, q: SX, v: SX, u: SX, C: SX, a: SX, lam: SX) -> tuple[SX, ...]:
        """Return what the passes of `carried` share, and d and mu before them."""
        known, _ = self._sharing_of(t, q, v, u, C, a, lam)
        return known.vector(), SX(self.e.l, 1), SX(self.e.n, 1)

    def shared_again(self, C: SX, sharing: SX, d: SX, mu: SX) -> tuple[SX, ...]:
        """Return d, mu and the change of d of another pass."""
        return self._shared(Sharing.of(self.sharing, sharing), ca.sparsify(ca.diag(self.held) @ C), d, mu)

    def sharing_ended(self, passes: int, lam: SX, sharing: SX, d: SX, last: SX) -> SX:
        """Return lam after these passes, of which the last one changed d."""
        return self._carried(Sharing.of(self.sharing, sharing), lam, d, last, passes)

    @cached_property
    def sharing(self) -> Sharing:
        """Return what the passes of `carried` share, of which only the sparsity counts."""
        x = symbols(self.e)
        return self._sharing_of(x["t"], x["q"], x["v"], x["u"], self.value("C"), x["a"], x["lam"])[0]

    def _sharing_of(
        self, t: SX, q: SX, v: SX, u: SX, C: SX, a: SX, lam: SX, impact: bool = False
    ) -> tuple[Sharing, SX]:
        """Return what the passes of `carried` share, and C without the rows that are not held."""
        e, x, physical, held = self.e, SX.sym("x", self.e.l), lam / self.scale, self.held

        def slope(lam: SX) -> SX:
            if not impact:
                return e.shares(q, v, a, lam, u, self.p, t)
            loads = SX.sym("a", e.n), SX.sym("lam", e.l)
            return ca.jtimes(e.shares(q, v, *loads, u, self.p, t), ca.vertcat(*loads), ca.vertcat(a, lam))

        P = ca.sparsify(ca.jacobian(slope(x), x))
        carried = ca.diag(P).sparsity().row()
        P = ca.diag(held) @ P @ ca.diag(held) + ca.diag(1 - held)
        C = ca.sparsify(ca.diag(held) @ C)
        sizes = self._sizes(P, C, carried)
        columns = ca.densify(ca.sum1(C**2 / ca.repmat(sizes, 1, e.n)).T)
        # A column at the level of round-off of H's diagonal counts as zero.
        there = ca.fmin(1, ca.densify(ca.sum1(C**2).T) * self.inverse_scales)
        weights = ca.if_else(columns > 0, method.HELD_SHARES * there / columns, 0)
        eased = P + method.EASE * ca.diag(sizes)
        D, L, order = self._factored(method.augmented_mass(eased, C.T, ca.diag(weights)))
        size = ca.dot(sizes * physical, physical) + ca.dot(slope(0 * x), slope(0 * x) / sizes)
        return Sharing(P, _once(1 / D), L, weights, held * slope(physical), sizes, size, order), C

    def _shared(self, known: Sharing, C: SX, d: SX, mu: SX) -> tuple[SX, SX, SX]:
        """Return d, mu and the change of d of a pass."""
        upper, last = known.L + SX.eye(self.e.l), list[SX]()
        back = np.argsort(known.order).tolist()

        def solve(b: SX) -> SX:
            return ca.solve(upper, known.inverse * ca.solve(upper.T, b[known.order]))[back]

        def done(change: SX, value: SX) -> bool:
            last[:] = [change]
            return False

        d, mu = method.shared_again(known.P, known.slope, C, ca.diag(known.weights), solve, d, mu, 1, done)
        return d, mu, last[0]

    def _carried(self, known: Sharing, lam: SX, d: SX, last: SX, passes: int) -> SX:
        """Return lam with the change d, of which the last pass made `last`; NaN if the passes did not converge."""
        change, size = ca.dot(known.sizes * last, last), ca.dot(known.sizes * d, d) + known.size + _TINY
        # Each of m passes gains about the same factor, so a last change of limit^((m - 1) / m) leaves the limit.
        found = change <= _SHARED ** (2 * (passes - 1) / passes) * size
        return lam + self.scale * ca.if_else(found, d, math.nan)

    def _sizes(self, P: SX, C: SX, carried: Sequence[int]) -> SX:
        """Return the size (l,) of each row of P; a row without loads of joints gets one from other rows with entries in
        its columns of C.

        The sizes make multipliers of all rows comparable, in any units.
        """
        e = self.e
        inverse = ca.vertcat(*(1 / P[i, i] if i in carried else SX(0) for i in range(e.l)))
        columns = ca.sum1(C**2 * ca.repmat(inverse, 1, e.n))
        shares = ca.if_else(columns > 0, 1 / columns, 0)
        found = ca.sum2(C**2 * ca.repmat(shares, e.l, 1))
        return ca.vertcat(*(P[i, i] if i in carried else ca.if_else(found[i] > 0, found[i], 1) for i in range(e.l)))

    def _factored(self, K: SX) -> tuple[SX, SX, list[int]]:
        """Return the factors of a matrix (l, l), and the order in which they eliminate."""
        order = list((K.sparsity() + K.sparsity().T).amd())
        K = ca.sparsify(K)  # an entry may be zero on one side of the diagonal only, because of a joint's constants
        K = ca.project(K, K.sparsity() + K.sparsity().T)[order, order]
        return *self._factors_of(K), order

    # Singular positions --------------------------------------------------------------------------------------------

    def margin(self, D: SX, L: SX) -> tuple[SX, SX]:
        """S2: return whether the margin may be below `alfmu.method.singular.BRANCH_MARGIN`, and the margin."""
        if not self.e.functions["C"].jac_sparsity(0, 0).nnz():  # joints of open chains: no position changes their rank
            return SX(0), SX(1)
        scales, freedom = self.inverse_scales[elimination_order(self.e)], self.settings.freedom
        ratios, few = D * scales, self.e.n <= DENSE
        near, small = freedom < ca.sum1(ratios < branch.BRANCH_MARGIN), ratios < branch.SMALL_PIVOT
        beyond = freedom < ca.sum1(small)
        if self.e.turns:
            irregular = (ca.log(_product(ratios)) if few else ca.sum1(ca.log(ratios))) < self.settings.regular
            near, beyond = near * irregular, beyond * irregular
        if self.kind == "plain":  # the quick step only needs to know whether it may continue
            return near, SX(1)
        among = ca.fmin(ca.fmax(ratios, 1 - small), 1)
        logarithm = ca.log(_product(among)) if few else ca.sum1(ca.log(among))  # the product of many could overflow
        if self.e.turns:
            more = ca.fmin(ca.sum1(small) - freedom, loops(self.e))
        else:
            # What large pivots leave of the diagonal entry of a coordinate is large where it shares a small pivot.
            left = ratios + scales * (L.T**2 @ (small * D))
            more = ca.fmax(ca.sum1(left < branch.SMALL_PIVOT) - freedom, 1)
        return near, ca.fmin(ca.if_else(beyond, ca.exp((logarithm - self.settings.masses) / more), 1), 1)

    def irregular(self, q: SX) -> SX:
        """Return whether more constraints may be dependent at q than at regular positions, for any masses.

        The margin also vanishes where a mechanism moves almost no mass, as at a dead centre with heavy sliders.
        """
        held = self.held if self.kind == "weighted" else SX.ones(self.e.l)
        # A displacement by the size of the smallest loop counts as much as 1 rad: mechanisms of any size are alike.
        sizes = ca.vertcat(*(1 / self.settings.inverse_loop if c.unit == "m" else 1 for c in self.e.coordinates))
        C = (ca.densify(self.e.C(q, self.p)) * held) @ ca.diag(SX(sizes))
        K = C @ C.T
        # A vanishing row of a joint is compared with the size of all its rows.
        joints = [(row.name, row.unit) for row in self.e.rows]
        together = ca.DM([[float(one == other) for other in joints] for one in joints])
        sizes = ca.sqrt(together @ ca.diag(K))
        scale = ca.diag(ca.if_else(sizes > 0, 1 / sizes, 0))
        pivots, upper, _ = ca.ldl(scale @ K @ scale + _ALONE * SX.eye(self.e.l), False)
        found = SX(0)
        for joint in dict.fromkeys(joints):
            own = [i for i, each in enumerate(joints) if each == joint]
            # Eigenvalues of the block of a joint, 1 / len(own) on average where nothing precedes it, do not depend on
            # its axes. As many are below a limit as pivots of the block less the limit are negative.
            unit = SX.eye(len(own))
            U = upper[own, own] + unit
            block = U.T @ ca.diag(pivots[own]) @ U - branch.BRANCH_MARGIN / len(own) * unit
            found += ca.sum1(ca.ldl(block, False)[0] < 0)
        usual = self.e.l - (self.e.dependent - self.settings.freedom)
        return found > usual

    def margin_at(self, q: SX) -> SX:
        """S2: return the margin at a position."""
        H = self.augmented_mass(self.scale * self.e.M(q, self.p), self.e.C(q, self.p))
        return self.margin(*self.factors(H))[1]

    def directed(self, v: SX) -> SX:
        """S4: return the direction along which limits are taken."""
        return self.way + self.settings.along * v

    def spacing(self, share: float, v: SX, dt: SX) -> SX:
        """S4: return the spacing [s] of positions along v: a share of the step, or more if they are
        indistinguishable."""
        return ca.fmax(share * dt, ca.sqrt(_TOLD * self.settings.nothing) / self._fastest(v))

    def _fastest(self, v: SX) -> SX:
        """Return the largest rate of a coordinate [1/s]; lengths are divided by the mechanism's."""
        units = [c.unit for c in self.e.coordinates[: self.e.dependent]]
        sizes = [
            x * self.settings.inverse_length if u == "m" else x for u, x in zip(units, ca.vertsplit(v), strict=False)
        ]
        return ca.fmax(ca.mmax(ca.fabs(ca.vertcat(*sizes))), _TINY)

    def may_be_near(self, here: SX) -> tuple[SX, SX]:
        """Return whether a limit may have to be taken at a position of this margin, and a zero spacing."""
        return 1 - (ca.sqrt(here) >= branch.LIMIT_ZONE * self.settings.least_distance), SX(0)

    def aside(self, q: SX, v: SX, spacing: SX) -> tuple[SX, SX]:
        """S2: return the positions one spacing along v before and after q."""
        before, after = (q + k * spacing * v for k in (-1, 1))
        return before, after

    def approached(self, here: SX, before: SX, after: SX, spacing: SX, v: SX) -> tuple[SX, SX]:
        """S4: return whether the limit has to be taken at a position of known margin, and the spacing [s] of its
        positions, from the margins on either side."""
        rate, settings = self._rate(here, before, after), self.settings
        moved = spacing * self._fastest(v)
        first = branch.first_position(settings.least_distance, rate, moved, settings.nothing, ca.if_else)
        zone = ca.sqrt(here) < branch.LIMIT_ZONE * first
        # Indistinguishable positions give an infinite spacing, which leaves the step to the patient tier.
        within = moved * ca.if_else(rate > 0, first / rate, 1) <= branch.farthest(settings.least_distance, ca.fmax)
        return within * ca.if_else(rate > 0, zone, here <= settings.nothing), spacing * first / rate

    def _rate(self, here: SX, before: SX, after: SX) -> SX:
        """S2: return the distance covered by one spacing along v, from margins; 0 if it is indistinguishable."""
        squared = branch.curvature(before, here, after)
        clear = ca.logic_or(here > self.settings.nothing, squared > self.settings.nothing)
        return ca.if_else(clear, ca.sqrt(ca.fmax(squared, 0)), 0)

    def places(self, q: SX, v: SX, spacing: SX, *, side: int) -> list[SX]:
        """S4: return the positions from which a limit is taken."""
        return [q + k * spacing * v for k in branch.weights(side)]

    def mean(self, margin: SX, here: SX, watch: SX, zone: SX, *found: SX) -> tuple[SX, SX, SX]:
        """S4: return the limit and the worst watch of its evaluations, and whether the limit is taken. If it differs
        from the acceleration here by more than round-off of the latter, it is not the limit of this motion, which
        passes the singular position at a distance."""
        side, direct = len(found) // 4, Watch.of(watch)
        a, seen = self.mean_of(found[: 2 * side], side), [Watch.of(x) for x in found[2 * side :]]
        lost = branch.direct_error(margin, EPSILON) + ca.sqrt(direct.change / (direct.size + _TINY))
        clear = margin > ca.fmax(self.settings.nothing, branch.JUDGED)
        other = ca.logic_and(clear, ca.mmax(ca.fabs(a - here)) > lost * ca.mmax(ca.fabs(a)))
        zone *= 1 - other
        return ca.if_else(zone, a, here), ca.if_else(zone, _worst(seen, seen[0].near, seen[0].margin), watch), zone

    def mean_of(self, values: Sequence[SX], side: int) -> SX:
        """S4: return the limit of a quantity from its values at the positions."""
        return branch.mean(dict(zip(branch.weights(side), values, strict=True)))

    def returned(self, q: SX, wanted: SX, v: SX) -> tuple[SX, SX]:
        """S3: return q displaced along the motion to the position nearest to `wanted`, and the v of that motion."""
        mass, heavy = branch.INDEPENDENT_MASS / branch.NOISE_FLOOR * self.settings.nothing, SX(self.e.n, 1)
        for i in telling(self.e):
            heavy[i] = mass / self.inverse_scales[i]
        M, C, _, solve = self._augmented(q)
        if not self.e.timed:
            return branch.returned(M, C, self.weights, solve, heavy, q, wanted, v)

        def speed(x: SX) -> SX:
            return self.speed(q, x, C)

        return branch.returned(M, C, self.weights, solve, heavy, q, wanted, v, speed, ca.vertcat(self._own(v), 0))

    def read_places(self, here: SX, before: SX, after: SX, spacing: SX, q: SX, v: SX) -> list[SX]:
        """S4: return the positions from which a limit of outputs is taken, by margins; NaN if they are
        indistinguishable from q."""
        spacing *= branch.READ_DISTANCE / self._rate(here, before, after)
        return [q + k * spacing * v for k in branch.READ_MEAN]

    def limits(self, *found: SX) -> tuple[SX, ...]:
        """Return a, lam and watch from their values at the positions and here, and whether lam has a limit (1) or a
        pole (2).

        Limits are used if they are more accurate than the values here: `singular.with_pole`. The error of reactions
        here may follow these values; the last result is then that of the reactions returned.
        """
        count = len(branch.READ_MEAN)
        found, (here, lam_here, watch, *told) = found[: 3 * count], found[3 * count :]
        accelerations, multipliers, watches = (
            dict(zip(branch.READ_MEAN, found[i * count : (i + 1) * count], strict=True)) for i in range(3)
        )
        margin = Watch.of(watch).margin
        limit, pole, magnified = self._with_pole(multipliers)
        use_pole, fewer = 1 - pole * (magnified <= 0), branch.fewer(multipliers)
        rough, coarse = (self._with_pole(x, use_pole)[0] for x in (fewer, branch.fewer(fewer)))
        change = ca.mmax(ca.fabs(limit - rough))
        lost = branch.direct_error(margin, EPSILON) * ca.mmax(ca.fabs(limit))
        direct = ca.logic_and(margin > self.settings.nothing, lost < change)
        said = _worst([Watch.of(x) for x in watches.values()], SX(0), margin)
        largest = ca.mmax(ca.fabs(ca.vertcat(*multipliers.values())))
        before = ca.mmax(ca.fabs(rough - coarse))
        a, lam = ca.if_else(direct, here, branch.mean(accelerations)), ca.if_else(direct, lam_here, limit)
        if told:
            error = branch.limit_error(change, before, largest, magnified, told[1]) / self.scale
            told = [ca.if_else(direct, told[0], error)]
        return a, lam, said, 1 + pole, *told

    def lost(self, M: SX, C: SX, F: SX, xi: SX, q: SX, v: SX, a: SX, lam: SX, watch: SX) -> tuple[SX, SX]:
        """Return the error of reactions evaluated at a position itself, and the relative error of the position."""
        e, own = self.e, self.settings.inverse_length
        arms = ca.vertcat(*(own if c.unit == "rad" else 1 for c in e.coordinates))
        off = [ca.sqrt(self._residue(x)) for x in (e.Phi(q, self.p), self.speed(q, v, C), C @ a - xi)]
        off[0] += EPSILON * self._far(q)
        off[1:] = [x / (ca.sqrt(self.squares(y)) + _TINY) for x, y in zip(off[1:], (v, a), strict=True)]
        forces = [ca.norm_inf(ca.densify(arms * x)) / self.scale for x in (F, C.T @ lam, F - M @ a - C.T @ lam, M @ a)]
        forces.append(own * (v.T @ M @ v) / self.scale)
        masses = self.settings.nothing / branch.NOISE_FLOOR
        margin = ca.fmax(Watch.of(watch).margin - masses, masses / branch.NOISE_FLOOR)
        return branch.reading_error(margin, EPSILON, off, forces), EPSILON + off[0]

    def _with_pole(self, values: dict[int, SX], use_pole: SX | float = 1.0) -> tuple[SX, SX, SX]:
        """Compute `singular.with_pole`."""
        found: tuple[SX, ...] = branch.pole(values)
        limit, first, second = (ca.densify(x) for x in found)
        least = branch.POLE_SEEN * ca.mmax(ca.fabs(ca.vertcat(*values.values())))
        steepest, at = first[0], second[0]
        for i in range(1, self.e.l):
            more = ca.fabs(first[i]) > ca.fabs(steepest)
            steepest, at = ca.if_else(more, first[i], steepest), ca.if_else(more, second[i], at)
        pole = ca.logic_and(ca.fabs(steepest) > least, ca.fabs(at) < ca.fabs(steepest))
        beside = use_pole * ca.logic_and(pole, ca.fabs(at) > branch.POLE_ZERO * ca.fabs(steepest))
        limit -= ca.if_else(ca.logic_and(beside, ca.fabs(first) > least), first * (steepest / at), 0)
        return limit, pole, ca.if_else(beside, (steepest / at) ** 2, 0)

    # Projections (10) and the end of a step ------------------------------------------------------------------------

    def corrected(self, q: SX, v: SX) -> tuple[SX, SX, SX, SX]:
        """Return q and v after one correction (10) each, by H and C' of the old q, which serves both at a regular
        position; the smallest pivot, the residuals (squared) of both."""
        M, C, D, solve = self._augmented(q)
        q = self._closer(M, C, solve, q)
        after = self.e.C(q, self.p)
        Cv = self.speed(q, v, after)
        v = self._slower(M, C, solve, v, Cv)
        return q, v, ca.mmin(D), self._residues(q, self.speed(q, v, after))

    def placed(self, q: SX) -> SX:
        """Return q after a correction (10)."""
        M, C, _, solve = self._augmented(q)
        return self._closer(M, C, solve, q)

    def settled(self, q: SX, v: SX, corrections: int) -> tuple[SX, SX, SX]:
        """Return v after corrections (10), the smallest pivot, and the residuals (squared) of q and v."""
        M, C, D, solve = self._augmented(q)
        for _ in range(corrections):
            v = self._slower(M, C, solve, v, self.speed(q, v, C))
        return v, ca.mmin(D), self._residues(q, self.speed(q, v, C))

    def open(self, q: SX) -> SX:
        """Return whether q violates the constraints beyond the tolerance."""
        return 1 - self._within(self._residue(self.e.Phi(q, self.p)), q)

    def unsettled(self, left: SX, q: SX, v: SX) -> SX:
        """Return whether these residuals (squared) of q and v exceed the tolerance."""
        return 1 - self._within(left[0], q) * self._within(left[1], q, v)

    def along(self, q: SX, *parts: SX) -> tuple[SX, ...]:
        """Return displacements or velocities at q projected onto the constraints."""
        _, C, _, solve = self._augmented(q)
        return tuple(branch.tangential(C, self.weights, solve, x) for x in parts)

    def error_size(
        self, z: SX, q: SX, v: SX, parts: Sequence[SX], least: Sequence[SX] | None = None, states: Sequence[SX] = ()
    ) -> tuple[SX, SX]:
        """Return the largest error of the constrained state over the tolerance, and the largest round-off over the
        tolerance.

        `least` (2 n) is the error by round-off, of all accelerations and of those along the motion. Errors below the
        first are zero; where it exceeds the tolerance, it replaces the tolerance. Projections take away its part across
        the constraints: round-off counts as far as it is along the motion, or as the error shows it. `parts` are the
        errors of q and v along the motion, `states` are the states, if there are any, and their error.
        """
        size, allowed = ca.fabs(ca.vertcat(*parts)), self._allowed_of(z, q, v)
        floor, over = SX(0), size / allowed
        if least is not None:
            lost, along = least
            floor = ca.mmax(ca.fmin(lost, ca.fmax(along, size)) / allowed)
            over = ca.fmax(size - lost, 0) / ca.fmax(allowed, lost)
        if states:
            x, change = states
            size, over = ca.vertcat(size, change), ca.vertcat(over, ca.fabs(change) / self._allowed_of_states(z, x))
        # fmax ignores NaN.
        return ca.if_else(ca.sumsqr(size) < math.inf, ca.mmax(over), math.inf), floor

    def work_size(self, z: SX, dt: SX, error: SX, powers: Sequence[SX]) -> SX:
        """Return the error of the work of a prescribed motion over the tolerance, in steps above `solver.step_size`.

        Nothing else controls steps of a motion that is prescribed as a whole. Shorter steps are not refused for it, as
        power may have poles, at dead positions.
        """
        most = ca.fmax(ca.fabs(z[Layout(self.e).work]), dt * reduce(ca.fmax, map(ca.fabs, powers)))
        size = ca.fabs(error) / (WORK_SHARE * self.settings.relative * most + _TINY)
        return ca.if_else(dt > self.symbol("control")[0] * (1 + 1e-9), size, 0)

    def bound_size(self, z: SX, q: SX, v: SX, x: SX | None, bounds: SX) -> SX:
        """Return the largest of bounds of errors of q, v and states over the tolerance."""
        allowed = self._allowed_of(z, q, v)
        over = bounds / (allowed if x is None else ca.vertcat(allowed, self._allowed_of_states(z, x)))
        return ca.if_else(ca.sumsqr(bounds) < math.inf, ca.mmax(over), math.inf)

    def _allowed_of(self, z: SX, q: SX, v: SX) -> SX:
        """Return the tolerance of q and v in a step from z."""
        return self.allowed(ca.fmax(ca.fabs(z[: 2 * self.e.n]), ca.fabs(ca.vertcat(q, v))))

    def _allowed_of_states(self, z: SX, x: SX) -> SX:
        """Return the tolerance of states in a step from z."""
        layout = Layout(self.e)
        return self.allowed_states(ca.fmax(ca.fabs(z[layout.states : layout.time]), ca.fabs(x)))

    def nudged(self, q: SX, v: SX) -> tuple[SX, SX]:
        """Return q and v with their last digits changed."""
        sign = SX([(-1) ** i for i in range(self.e.n)])
        return q * (1 + EPSILON * sign), v * (1 + EPSILON * sign)

    def least_error(self, rule: Explicit, dt: SX, v: SX, left: SX) -> SX:
        """Return the error of a step of q and v (2 n) due to the round-off `left` of accelerations."""
        left = ca.fabs(left)
        return NOISE * math.hypot(*rule.errors[0]) * dt * ca.vertcat(dt * left + EPSILON * ca.fabs(v), left)

    def allowed(self, sizes: SX) -> SX:
        """Return the tolerance of each entry of q and v of given sizes, which neither whole turns nor a distance from
        the origin increase."""
        larger = ca.vertsplit(sizes)
        for i, c in enumerate(self.e.coordinates):
            if c.unit in ("rad", "m"):
                larger[i] = ca.fmin(larger[i], 1 if c.unit == "rad" else 1 / self.settings.inverse_length)
        least = [self.settings.absolute_length if c.unit == "m" else self.settings.absolute for c in self.e.coordinates]
        return ca.vertcat(*least, *least) + self.settings.relative * ca.vertcat(*larger)

    def allowed_states(self, sizes: SX) -> SX:
        """Return the tolerance of states of given sizes."""
        nominal = ca.DM([v.nominal or 1.0 for v in self.e.states])
        return self.settings.absolute * nominal + self.settings.relative * sizes

    def closed(self, plan: Plan, names: Iterable[str]) -> SX:
        """Return the state after a step from these values; its `trouble` counts failed checks.

        A NaN fails each check."""
        e, layout, known = self.e, Layout(self.e), {name: self.symbol(name) for name in names}
        z, q, v, work = (known[name] for name in ("z", "q", "v", "work"))
        evaluations = [Watch.of(x) for name, x in known.items() if name.startswith("watch")]
        pivot = ca.mmin(ca.vertcat(*(x.pivot for x in evaluations), known.get("pivot", SX(0, 1))))
        # Under error control, the error of iterations is part of the estimate; few iterations are also judged by their
        # rate of convergence.
        fixed = known["pace"][PACE.index("fixed")] != 0 if "pace" in known else SX(1)
        limit = ca.if_else(
            fixed, self.settings.tolerance, ca.fmax(self.settings.tolerance, LEFT_BY_FEW * self.settings.relative)
        )
        unjudged = 1 if plan.quick else fixed
        trouble, near = 1 - (pivot > 0) + unjudged * self.unconverged(plan, evaluations, limit), SX(0)
        if plan.branch or "zone1" in known:
            near = sum((x for name, x in known.items() if name.startswith("zone")), SX(0))
            trouble += 1 - self.settings.continues if plan.branch else near * self.settings.continues
            if plan.branch and plan.gaining:
                trouble += near * (self.settings.least_distance > branch.FARTHEST)
        elif e.l:
            near = sum((x.margin < branch.BRANCH_MARGIN if plan.margins else x.near for x in evaluations), SX(0))
            trouble += near if plan.quick and not plan.margins else near * self.settings.continues
            near *= self.settings.continues
        if e.l:
            trouble += 1 - self._closed(known["left"], q, v, plan.quick, near if plan.branch else None)
        else:
            trouble += 1 - (ca.sumsqr(ca.vertcat(q, v)) < math.inf)
        x = known.get("x", SX(0, 1))
        if e.states:
            trouble += 1 - (ca.sumsqr(x) < math.inf)
        trouble += 1 - (ca.sumsqr(self._angles(q - z[: e.n])) <= TURN**2)
        change = known.get("error", sum(x.change for x in evaluations) / (evaluations[0].size + _TINY))
        angles = self._unwrapped(q, z[2 * e.n : layout.work])
        if e.counted:
            angles = ca.vertcat(angles, e.functions["counted"](q, self.p))
        arrival = known["arrival"] if "arrival" in known else z[layout.time] + known["dt"]
        if e.timed:
            q, v = ca.vertcat(self._own(q), arrival), ca.vertcat(self._own(v), 1)
        return ca.vertcat(q, v, angles, work, x, arrival, z[layout.trouble] + trouble, change, pivot, near)

    # Outputs -------------------------------------------------------------------------------------------------------

    def seen(
        self,
        plan: Plan,
        z: SX,
        u: SX,
        C: SX,
        xi: SX,
        a: SX,
        lam: SX,
        watch: SX,
        singular: SX,
        lost: SX | float = 0.0,
        *,
        limit: float | None = None,
    ) -> SX:
        """Return outputs, monitors, and `memory.SEEN`; `limit` is an argument of `unconverged`."""
        seen, near = Watch.of(watch), SX(0)
        shown = self._shown(plan, z, u, a, lam, seen.margin, singular, lost)
        trouble = self.unconverged(plan, [seen], limit) + 1 - (seen.pivot > 0)
        if self.e.l:
            near = self.settings.continues * (1 - (seen.margin > (branch.READ_ZONE * branch.READ_DISTANCE) ** 2))
        return ca.vertcat(*shown, self._largest(C @ a - xi), near, trouble)

    def seen_at_rest(self, plan: Plan, z: SX, u: SX) -> SX:
        """Return the values of `seen` if no output needs accelerations or multipliers."""
        readings, *monitors = self._shown(plan, z, u, *self._at_rest(), SX(1))
        return ca.vertcat(readings, *monitors, 0, 0, 1 - (ca.sumsqr(readings) < math.inf))

    def _shown(
        self, plan: Plan, z: SX, u: SX, a: SX, lam: SX, margin: SX, singular: SX | float = 0.0, lost: SX | float = 0.0
    ) -> list[SX | float]:
        """Return outputs, and each monitor."""
        e, p, layout = self.e, self.p, Layout(self.e)
        q, v, angles, t = z[: e.n], z[e.n : 2 * e.n], z[2 * e.n : layout.work], z[layout.time]
        readings = e.readings(q, v, a, lam / self.scale, self.given(z, u), p, t)
        names = {o.name: i for i, o in enumerate(e.outputs)}
        for name, angle in zip(e.wrapped, ca.vertsplit(self._unwrapped(q, angles)), strict=False):
            readings[names[name]] = angle
        shown: list[SX | float] = [readings]
        if {monitor.name for monitor in MONITORS} - set(e.monitors):
            _, _, Phi, Cv = e.constraints(q, v, p)
            values: list[SX | float] = [self._largest(Phi), self._largest(Cv), e.energy(q, v, p)[0], z[layout.work], 0]
            values += [plan.iterations, ca.sqrt(margin), singular, lost]
            shown += [x for each, x in zip(MONITORS, values, strict=True) if each.name not in e.monitors]
        return shown

    def _unwrapped(self, q: SX, near: SX) -> SX:
        """Return computed angles, shifted by whole turns to those nearest to the values at the start of the state
        `near`."""
        e = self.e
        if not e.wrapped:
            return SX(0, 1)
        s, names = symbols(e), {o.name: i for i, o in enumerate(e.outputs)}
        readings = e.readings(q, s["v"], s["a"], s["lam"], s["u"], self.p, s["t"])
        raw = readings[[names[name] for name in e.wrapped]]
        beside = raw - near[: len(e.wrapped)]
        return raw - (beside - ca.remainder(beside, 2 * ca.pi))

    # Residuals and factors -----------------------------------------------------------------------------------------

    def _angles(self, q: SX) -> SX:
        """Return the coordinates in rad."""
        return q[[i for i, c in enumerate(self.e.coordinates) if c.unit == "rad"]]

    def _closed(self, left: SX, q: SX, v: SX, quick: bool, near: SX | None) -> SX:
        """Return whether both residuals (squared) are within the tolerance, or within round-off.

        Round-off of large angles perturbs C, so that no v satisfies its dependent rows exactly. A quick step has too
        few corrections to detect that. Near a singular position round-off of q is larger in the direction that C hardly
        determines: by one over the distance, down to the smallest distinguishable one.
        """
        turned = 1.0 if quick else ca.fmax(1, ca.sumsqr(self._angles(q)))
        lost = turned if near is None else ca.if_else(near, ca.fmax(turned, 1 / self.settings.nothing), turned)
        return self._within(left[0], q) * self._within(left[1], q, v, lost)

    def _within(self, residue: SX, q: SX, v: SX | None = None, larger: SX | float = 1.0) -> SX:
        """Return whether a residual (squared) of q, or of v at q, is within the tolerance, within `larger` times
        round-off of x and of places, or within what redundant constraints leave open."""
        far = self._far(q) ** 2
        size = ca.fmax(far, self.squares(q)) if v is None else ca.fmax(far, 1) * self.squares(v)
        agreed = self.settings.agreed**2 * (1 if v is None else self.squares(v))
        return residue <= ca.fmax(ca.fmax(self.settings.tolerance**2, agreed), ROUND_OFF**2 * larger * size)

    def _far(self, q: SX) -> SX:
        """Return the largest coordinate of a place, over the size of the smallest loop: redundant constraints agree to
        this many units of round-off."""
        lengths = [x for x, c in zip(ca.vertsplit(q), self.e.coordinates, strict=True) if c.unit == "m"]
        return self.settings.inverse_loop * ca.norm_inf(ca.vertcat(self.e.reach, *lengths))

    def squares(self, x: SX, power: int = 2) -> SX:
        """Return the sum of squares of coordinates or of their rates, whose lengths are divided by the mechanism's; of
        forces with the power -2, of masses with -4."""
        lengths = [i for i, c in enumerate(self.e.coordinates) if c.unit == "m"]
        others = [i for i, c in enumerate(self.e.coordinates) if c.unit != "m"]
        return ca.sumsqr(x[others]) + self.settings.inverse_length**power * ca.sumsqr(x[lengths])

    def _largest(self, residue: SX) -> SX:
        return ca.mmax(ca.fabs(residue * self.held)) if self.e.l else SX(0)

    def _residues(self, q: SX, Cv: SX) -> SX:
        """Return the sums of squares of Phi and Phi-dot, in units of the rows."""
        return ca.vertcat(self._residue(self.e.Phi(q, self.p)), self._residue(Cv))

    def _residue(self, rows: SX) -> SX:
        """Return the sum of squares of Phi or Phi-dot, in units of the rows."""
        if self.kind == "plain":
            return ca.sumsqr(rows) * self.inverse_units**2
        return ca.sumsqr(rows * self.held * self.inverse_units)

    def _closer(self, M: SX, C: SX, solve: method.Solve, q: SX) -> SX:
        """Return q after a correction (10)."""
        Phi = self.e.Phi(q, self.p)
        return q + method.project_residual(M, C, self.weights, solve, Phi, lambda d: self.e.Phi(q + d, self.p))

    def _slower(self, M: SX, C: SX, solve: method.Solve, v: SX, Cv: SX) -> SX:
        """Return v after a correction (10)."""
        return v + method.project_residual(M, C, self.weights, solve, Cv, lambda d: Cv + C @ d)

    def _augmented(self, q: SX) -> tuple[SX, SX, SX, method.Solve]:
        """Return M and C, the pivots of H, and its solver."""
        M, C = self.scale * self.e.M(q, self.p), self.e.C(q, self.p)
        D, L = self.factors(self.augmented_mass(M, C))
        return M, C, D, self.solver(D, L)

    def augmented_mass(self, M: SX, C: SX) -> SX:
        """Return H; its constant entries depend on the parameters only."""
        H = method.augmented_mass(M, C, self.weights)
        for place, value in self._steady.items():
            H[place] = value
        return H

    @cached_property
    def _steady(self) -> dict[tuple[int, int], SX]:
        """Return entries of H that contain q but do not depend on it, such as the square of a rotating length."""
        e, q = self.e, SX.sym("q", self.e.n)
        if e.n > DENSE:
            return {}
        M, C, _, _ = self.terms(SX(0), q, q, SX.zeros(e.driven))
        H = method.augmented_mass(M, C, self.weights)
        entries = ca.vertcat(*H.nonzeros())
        still = ca.substitute(entries, q, SX.zeros(e.n))
        numbers = ca.Function("entries", [q, self.p, self.k], [entries, still])
        random = np.random.default_rng(0)
        same = np.array(ca.which_depends(entries, q, 1, True))
        for _ in range(_PROBES):
            x, reference = numbers(*(random.uniform(0.5, 2.0, size) for size in map(numbers.nnz_in, range(3))))
            same &= np.isclose(x.full(), reference.full(), _SAME, 0.0).ravel()
        row, column = H.sparsity().get_triplet()
        return {(row[i], column[i]): still[int(i)] for i in np.flatnonzero(same)}

    def factors(self, H: SX) -> tuple[SX, SX]:
        """Return D and L' - I of the LDL' factorisation of H, with coordinates in the order of `elimination_order`."""
        order = elimination_order(self.e)
        H = H[order, order]
        if self.e.n > DENSE:
            return ca.ldl(H, False)[:2]
        return self._factors_of(H)

    def _factors_of(self, H: SX) -> tuple[SX, SX]:
        """Return these factors of a matrix in the order of its rows."""
        pattern = *H.sparsity().colind(), *H.sparsity().row()
        if pattern not in self._factorisations:
            self._factorisations[pattern] = _factorisation(H.sparsity())
        D, L = self._factorisations[pattern](H)
        return D, L

    def solver(self, D: SX, L: SX) -> method.Solve:
        """Return a solver with these factors, by one division per pivot, which takes as long as several products."""
        order = elimination_order(self.e)
        if self.e.n > DENSE:
            return lambda b: ca.ldl_solve(b, D, L, order)
        inverse, upper, back = _once(1 / D), L + SX.eye(self.e.n), np.argsort(order).tolist()
        return lambda b: ca.solve(upper, inverse * ca.solve(upper.T, b[order]))[back]


def _once(quotient: SX) -> SX:
    """Return the quotient in a form that makes CasADi multiply by it instead of dividing each product again."""
    return ca.copysign(quotient, quotient)


def _factorisation(pattern: ca.Sparsity) -> ca.Function:
    """Return the function from a matrix of this sparsity to D and L' - I of its LDL' factorisation, with one division
    per pivot."""
    n, H = pattern.size1(), SX.sym("H", pattern)
    pattern = pattern.ldl(False)[0]
    rows = {column: pattern.row()[pattern.colind()[column] : pattern.colind()[column + 1]] for column in range(n)}
    # One product of vectors takes far less time than sums of products of entries of CasADi's matrices.
    D, inverse = list[SX](), list[SX]()
    upper, scaled = dict[tuple[int, int], SX](), dict[tuple[int, int], SX]()

    def summed(row: int, column: int, over: Sequence[int]) -> SX:
        one, other = [upper[k, row] for k in over], [scaled[k, column] for k in over]
        return ca.horzcat(*one) @ ca.vertcat(*other) if over else SX(0)

    for column in range(n):
        own = set(rows[column])
        for row in rows[column]:
            scaled[row, column] = H[row, column] - summed(row, column, [k for k in rows[row] if k in own])
            upper[row, column] = scaled[row, column] * inverse[row]
        D.append(H[column, column] - summed(column, column, rows[column]))
        inverse.append(_once(1 / D[column]))
    return ca.Function("factors", [H], [ca.vertcat(*D), SX(pattern, ca.vertcat(*upper.values()))])


def _worst(seen: Sequence[Watch], near: SX, margin: SX) -> SX:
    """Return the worst of several watches, with this distance to a singular position."""
    pivot = ca.mmin(ca.vertcat(*(x.pivot for x in seen)))
    change, size = sum((x.change for x in seen), SX(0)), sum((x.size for x in seen), SX(0))
    return Watch(change, size, pivot, near, margin).vector()


def _product(values: SX) -> SX:
    product = SX(1)
    for each in ca.vertsplit(values):
        product *= each
    return product
