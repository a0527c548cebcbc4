"""Trace integrators other than RK4: a program that proposes a step, makes it, and judges its error.

Implicit ones have loops of Newton's method: iterations with the same tangents while these gain enough, then with new
ones (`method.stepping.newton`). Tangents are those of the augmented equation (`method.implicit.stiffness`). A step that
cannot be judged (a stage near a singular position, unsatisfied constraints) is marked as trouble, and the patient tier
makes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce

import casadi as ca
from casadi import SX

from ..equations.evaluation import DENSE, with_tangents
from ..equations.interface import default_settings, integrator
from ..method import formulations as method
from ..method import implicit
from ..method.singular import LONG_PLACES, LONG_SPACING
from ..method.stepping import (
    EXPLICIT5_SHORT,
    RADAU9,
    SHORTEST,
    Collocation,
    Explicit,
    combined,
    continued,
    explicit,
    explicit_at,
    explicit_rule,
    judged,
    kink_bounds,
    landing,
    newton,
    rule_beside,
)
from ..model.kept import once
from ..model.settings import FIXED
from . import rubbing
from .form import Call, Factor, Loop, Plan, Program, Routine, Solve, Step, Traced, rewritten
from .memory import PACE
from .trace import CAREFUL, Calls, Tracer, spaced, traced, untraced

PASSES = 8
"""Most iterations of Newton's method with the same tangents, after the first."""

RENEWALS = 4
"""Most evaluations of tangents in a step."""

NEWMARK_PASSES = 16
"""Most iterations of Newton's method in the index-3 form, each with new tangents."""

RETURNS = 4
"""Number of projections of q and v after these iterations."""


def whole(equations: Traced) -> Traced:
    """Return traced equations whose programs have steps; a scene from the cache is traced now to find them."""
    return equations if "seen" in equations.functions else _whole(equations)


@once
def _whole(equations: Traced) -> Traced:
    e = replace(untraced(equations), survey=equations.survey)
    return traced(with_tangents(e) if "tangents" in equations.signatures else e, programs)


def programs(tracer: Tracer, quick: Plan) -> dict[str, Program]:
    """Return the programs of the integrator of a scene; none if RK4 makes its steps.

    `quick` is the plan of a quick step, shared by short steps of `auto`.
    """
    name = integrator(tracer.e)
    # If redundant constraints brake, the matrix that replaces penalties needs more than two iterations.
    careful = Plan(CAREFUL, 3) if tracer.e.survey.brakes else quick
    plan = replace(careful, corrections=2 * bool(tracer.e.l), weighted=True, margins=bool(tracer.e.l))
    tolerance = default_settings(tracer.e).relative_tolerance
    rule, explicit_one = implicit.RULES.get(name), explicit_rule(name, tolerance)
    gaining = replace(
        plan, iterations=3 if tracer.e.l else 1, corrections=3 * bool(tracer.e.l), quick=False, gaining=True
    )
    if explicit_one:
        programs = {"method": _Explicit(tracer, plan).program(explicit_one)}
        program = _Explicit(tracer, gaining, name="method_careful").program(explicit_one)
        programs["method_careful"] = _softened(tracer, program) if tracer.e.l else program
        if default_settings(tracer.e).method == "auto" and "tangents" in tracer.e.signatures:
            programs["stiff"] = _Collocation(tracer, gaining, RADAU9, "stiff").program("stiff")
    elif isinstance(rule, Collocation):
        programs = {"method": _Collocation(tracer, plan, rule).program()}
        if tracer.e.l:
            programs["method_careful"] = _Collocation(tracer, gaining, rule, name="method_careful").program()
    elif rule:
        programs = {"method": _Newmark(tracer, plan, rule).program()}
    else:
        return {}
    if tracer.e.l:
        # Implicit methods take no limits; an explicit method passes singular positions.
        on_branch = Plan(3, 3, weighted=True, branch=True, gaining=True, spacing=LONG_SPACING, side=LONG_PLACES)
        wanted = explicit_one or explicit_at(tolerance)
        wanted = wanted if name in FIXED else rule_beside(wanted)
        mark = "method" if wanted is explicit_one else "beside"
        step = _Explicit(tracer, on_branch, mark, "beside")
        programs["beside"] = step.program(wanted, "" if explicit_one else "beside")
        if isinstance(rule, Collocation):
            # The masses can make a position seem singular although its constraints are regular.
            programs["regular"] = _Explicit(tracer, gaining, mark, "regular").program(wanted, "beside")
    if default_settings(tracer.e).method == "auto":
        programs["short"] = _Explicit(tracer, quick, "short").program(EXPLICIT5_SHORT, "short")
        if tracer.e.l:
            step = _Explicit(tracer, Plan(CAREFUL, 3, weighted=True, branch=True), "short", "short_beside")
            programs["short_beside"] = step.program(EXPLICIT5_SHORT, "short")
    return programs


def _softened(tracer: Tracer, program: Program) -> Program:
    """Return the program with softer penalties."""
    calls = Calls(tracer, program.plan)
    calls("soften", "k", "soft", calls.scene.softened)

    def soft(step: Call | Routine) -> tuple[Step]:
        return (replace(step, arguments=tuple("soft" if x == "k" else x for x in step.arguments)),)

    return replace(program, steps=(*calls.steps, *rewritten(program.steps, soft)))


class _Step:
    """Common parts of all methods: the calls before and after a step."""

    def __init__(self, tracer: Tracer, plan: Plan, mark: str = "method", name: str = ""):
        self.tracer, self.plan, self.e, self.layout = tracer, plan, tracer.e, tracer.layout
        self.mark, self.name = mark, name or mark
        """Prefixes of function names: for stages, and for the end of the step."""
        self.calls = Calls(tracer, plan)
        self.scene = self.calls.scene
        self.by_constraints = plan.gaining and not plan.branch and self.e.l > 0 and self.e.n <= DENSE
        """Whether constraints alone, without masses, determine the distance to a singular position."""

    def begin(self) -> None:
        """Set the length of the step and the time at its end, from the state of step control."""

        def found(z: SX, pace: SX) -> tuple[SX, SX]:
            known, t = _known(pace), z[self.layout.time]
            left, fixed = known["end"] - t, known["fixed"]
            step = ca.if_else(fixed, ca.fmin(fixed, left), landing(known["dt"], left, ca.if_else))
            return step, ca.if_else(step >= left * (1 - 1e-9), known["end"], t + step)

        self.calls("pace", "z pace", "step arrival", found)

    def project(self) -> None:
        """Project q and v onto the constraints."""
        if self.plan.quick and self.plan.corrections == 1:
            self.tracer.correct(self.calls)
            return
        for _ in range(self.plan.corrections):
            self.tracer.place(self.calls, "q", "q")
        if self.e.l:
            self.tracer.settle_well(self.calls)

    @property
    def kinked(self) -> bool:
        """Whether rates of the scene have kinks, so that a step across one is also judged by a bound."""
        return self.tracer.kinks.numel_out(0) > 0

    def judge_kinks(self, rule: Explicit | Collocation, places: list[str], rates: list[str], share: SX) -> None:
        """Raise the error of a step across a kink to the bound of the kink's effect.

        `rates` are those of the velocities and states at the places, in order; `share` is the tolerance of the step
        over that of an explicit one.
        """
        n, scene, states = self.e.n, self.scene, self.tracer.states
        for i in places:
            known = f"t{i} q{i} v{i} {self.tracer.inputs_name(i)} p"
            self.calls("kinks", known, f"kinks{i}", lambda *x: self.tracer.kinks(*x, scene.p))

        def found(z: SX, dt: SX, error: SX, q: SX, v: SX, *known: SX) -> SX:
            x, rest = (known[0], known[1:]) if states else (None, known)
            kinks, each = rest[: len(places)], ca.vertcat(*rest[len(places) :])
            signs = ca.vertcat(*(ca.sign(kinks[0]) * ca.sign(x) for x in kinks[1:]))
            left = ca.reshape(each, -1, len(places)) @ ca.DM(kink_bounds(rule)).T
            bounds = dt * reduce(ca.fmax, ca.horzsplit(ca.fabs(left)))
            size = scene.bound_size(z, q, v, x, ca.vertcat(dt * bounds[:n], bounds))
            return ca.if_else(ca.mmin(signs) > 0, error, ca.fmax(error, size / share))

        known = spaced("z step error q v", states, [f"kinks{i}" for i in places], rates, "k")
        self.calls(f"{self.name}_kinks", known, "error", found)

    def end(self, watches: Sequence[str], order: int, kept: Sequence[str] = ()) -> None:
        """Compute the state after the step and that of step control; `kept` is the old and the new history."""
        names = ["z", "pace", "arrival", "q", "v", "work", *self.tracer.states, "p", "k", "error", *watches]
        if self.e.l:
            names += ["pivot", "left"]
        if self.plan.branch or self.by_constraints:
            names += [watch.replace("watch", "zone") for watch in watches]
        self.calls(f"{self.name}_close", spaced(names), "after", lambda *_: self.scene.closed(self.plan, names))
        self.calls(
            f"{self.name}_judge",
            spaced("after pace step floor", kept),
            spaced("after pace", kept[:1]),
            lambda *known: self._judged(order, *known),
        )

    def _judged(self, order: int, after: SX, pace: SX, step: SX, floor: SX, *kept: SX) -> list[SX]:
        layout, known = self.layout, _known(pace)
        error, trouble, near = after[layout.change], after[layout.trouble], after[layout.near]
        numbers = [known[name] for name in ("dt", "before", "refused")]
        *following, accepted = judged(order, numbers, step, error, ca.if_else)
        fixed = known["fixed"] != 0
        # Steps of fixed length are judged by the convergence of Newton's method alone. On the branch the error is
        # unknown if the motion does not reach the positions of a limit; shorter steps do not reach them either.
        unknown = 1 - (error < math.inf)
        unjudged = unknown if self.plan.branch else near
        trouble = ca.if_else(fixed, trouble + unknown, ca.if_else(accepted, trouble, unjudged))
        trouble += ca.logic_not(fixed) * (1 - (step >= SHORTEST))
        accepted = ca.logic_or(fixed, accepted)
        following = [ca.if_else(fixed, old, new) for old, new in zip(numbers, following, strict=True)]
        last = ca.if_else(accepted, step, known["last"])
        floor = ca.if_else(fixed, 0, floor)
        known |= zip(("dt", "before", "refused"), following, strict=True)
        known |= {"last": last, "accepted": accepted, "floor": floor}
        results = [ca.vertcat(after[: layout.trouble], trouble, after[layout.change :])]
        results.append(ca.if_else(trouble, pace, ca.vertcat(*(known[name] for name in PACE))))
        if kept:
            before, new = kept
            results.append(ca.if_else(ca.logic_and(trouble == 0, accepted), new, before))
        return results


class _Explicit(_Step):
    """A step of an explicit method with projection."""

    def program(self, rule: Explicit, allowed: str = "") -> Program:
        """Return the program of a step; `allowed` names a setting: its tolerance over that of the method."""
        n, layout, calls, scene = self.e.n, self.layout, self.calls, self.scene
        z, dt = map(scene.symbol, ("z", "step"))
        self.begin()
        rates: list[str] = []
        settled: list[str] = []

        def settle(y: SX) -> SX:
            after = y[:n], y[n : 2 * n], *self.tracer.parted(y[2 * n :])
            names = ["q", "v", "work", *self.tracer.states]
            calls(f"{self.mark}_sum", spaced("z step", rates), spaced(names), lambda *_: after)
            self.project()
            settled.extend(names)
            return ca.vertcat(*map(scene.symbol, settled))

        def less(*_: SX) -> SX:
            i = len(rates)
            calls("less", f"rate{i} rate1", f"difference{i}", lambda rate, first: rate - first)
            rates[-1] = f"difference{i}"
            return scene.symbol(rates[-1])

        rate = self.tracer.rate(calls, f"{self.mark}_stage", rates, settled, "step")
        _, [error], _ = explicit(rule, rate, z[layout.time], self.tracer.begun(z), dt, None, settle, less)
        for i in range(len(rates) * self.by_constraints):
            calls("irregular", f"q{i + 1} p k", f"zone{i + 1}", scene.irregular)

        rounds = self.plan.gaining
        if rounds:
            self._rounded(str(len(rates)))
        share = getattr(scene.settings, allowed) if allowed else None

        def judged(x: SX) -> SX:
            return x if share is None else x / share

        off = "off_q", "off_v", *("off_x" for _ in self.tracer.states)
        worked = ["off_work"] * self.tracer.supplies
        powers = [f"power{i + 1}" for i in range(len(rates) * len(worked))]

        def parted(*_: SX) -> tuple[SX, ...]:
            found = judged(error)
            work = (scene.work_size(z, dt, found[2 * n], list(map(scene.symbol, powers))) for _ in worked)
            return found[:n], found[n : 2 * n], *(found[2 * n + 1 :] for _ in off[2:]), *work

        def size(z: SX, q: SX, v: SX, *known: SX) -> tuple[SX, SX]:
            *x, off_q, off_v = known[: 2 + len(off[2:])]
            change = known[len(x) + 2 : len(x) + 2 + len(x)]
            left = map(scene.symbol, ("round_off", "round_off_along"))
            least = [judged(scene.least_error(rule, dt, v, a)) for a in left] if rounds else None
            size, floor = scene.error_size(z, q, v, (off_q, off_v), least, (*x, *change))
            for name in worked:
                size = ca.fmax(size, scene.symbol(name))
            return size, floor

        known = spaced("z step", rates, powers, ["control"] * len(worked), "k")
        calls(f"{self.name}_off", known, spaced(off, worked), parted)
        # The second time off_v lies along the motion already: no other function is needed.
        for change in ("off_q", *["round_off_along"] * rounds):
            self.tracer.along(calls, change, "off_v")
        known = spaced("z q v", self.tracer.states, off, *["step round_off round_off_along"] * rounds, worked, "k")
        calls(f"{self.name}_error", known, "error floor", size)
        if self.kinked:
            places = [str(i + 1) for i in range(len(rule.nodes))]
            kinked = [f"{x}{i}" for i in places for x in ("a", *["xdot"] * bool(self.e.states))]
            self.judge_kinks(rule, places, kinked, getattr(scene.settings, allowed) if allowed else SX(1))
        self.end([f"watch{i + 1}" for i in range(len(rates))], rule.estimate + 1)
        return Program(calls.steps, self.plan, rule.name, len(rates))

    def _rounded(self, i: str) -> None:
        """Estimate the round-off of accelerations of a stage, by a change of the last digits of q and v; twice, for its
        part along the motion."""
        calls, tracer = self.calls, self.tracer
        calls("nudged", f"t{i} q{i} v{i}", "tn qn vn", lambda t, q, v: (t, *calls.scene.nudged(q, v)))
        if self.plan.branch:
            tracer._on_branch(calls, "n", tracer.inputs(calls, i), "step", False)
        else:
            tracer.evaluation(calls, "n", {"u": tracer.inputs(calls, i)})
        calls("round_off", f"a{i} an", "round_off round_off_along", lambda a, other: 2 * (a - other,))


class _Implicit(_Step):
    """Common parts of methods with Newton's method.

    States are appended to the velocities, as velocities of masses of 1, and their rates to the accelerations: `side`
    numbers in all. Displacements of these masses are never needed.
    """

    def __init__(self, tracer: Tracer, plan: Plan, mark: str = "method", name: str = ""):
        super().__init__(tracer, plan, mark, name)
        self.by_constraints = False  # an implicit step uses margins, and may need any number of iterations
        self.moved = SX(len(self.e.states), 1)
        self.side = self.e.n + len(self.e.states)
        alike = "guess dq dv change w after_w dx rates_of begun"
        tracer.lengths |= dict.fromkeys(alike.split(), self.side)

    def inputs(self, i: str) -> str:
        """Return the name of the inputs at a stage, followed by its states."""
        return self.tracer.inputs_name(i)

    def at(self, z: SX) -> tuple[SX, SX]:
        """Return positions and velocities of z, each extended for the states."""
        n, layout = self.e.n, self.layout
        return ca.vertcat(z[:n], self.moved), ca.vertcat(z[n : 2 * n], z[layout.states : layout.time])

    def parted(self, q: SX, v: SX) -> tuple[SX, ...]:
        """Return q and v, and the states if there are any."""
        n = self.e.n
        return (q[:n], v[:n], v[n:]) if self.e.states else (q, v)

    def named(self, names: str, i: str) -> str:
        """Return names of values with i appended, and the name of the states there."""
        return spaced([f"{x}{i}" for x in (*names.split(), *self.tracer.states)])

    def start(self) -> None:
        """Evaluate at the start of the step."""
        time = self.layout.time
        results = self.named("t q v", "0")
        self.calls("unpack_method", "z", results, lambda z: (z[time], *self.parted(*self.at(z))))
        self.evaluate(self.calls, "0")

    def evaluate(self, calls: Calls, i: str) -> None:
        """Compute a, lam, power and watch at a stage, with inputs at its time; a is extended by the rates of states."""
        u = self.tracer.inputs(calls, i)
        self.tracer.evaluation(calls, i, {"u": u})
        if self.e.states:
            calls.made.append(Call("state_rates", (f"q{i}", f"v{i}", u, "p", f"t{i}"), (f"xdot{i}",)))
            calls("rates_of", f"a{i} xdot{i}", f"rates_of{i}", ca.vertcat)

    def rates_of(self, i: str) -> str:
        """Return the name of the accelerations at a stage, extended by the rates of states."""
        return f"rates_of{i}" if self.e.states else f"a{i}"

    def factor(self, calls: Calls, weights: str, parts: Sequence[str], to: str, count: int) -> None:
        calls.made.append(Factor((weights, *parts), (to, f"{to}_order"), self.side, count))

    def solve(self, calls: Calls, factors: str, right: Sequence[str], to: str) -> None:
        calls.made.append(Solve((factors, f"{factors}_order", *right), (to,), self.side, len(right)))


class _Collocation(_Implicit):
    """A step of a collocation method, by the accelerations at its nodes."""

    def __init__(self, tracer: Tracer, plan: Plan, rule: Collocation, mark: str = "method", name: str = ""):
        super().__init__(tracer, plan, mark, name)
        self.rule, self.nodes = rule, [str(i + 1) for i in range(len(rule.nodes))]
        self.count = self.side * len(rule.nodes)
        tracer.lengths |= dict.fromkeys(("history", "rates", "changes"), self.count)

    def program(self, allowed: str = "") -> Program:
        """Return the program of a step; `allowed` names a setting: its tolerance over that of the method."""
        side, rule, calls, s = self.side, self.rule, self.calls, len(self.nodes)
        self.allowed = getattr(self.scene.settings, allowed) if allowed else SX(1)
        self.begin()
        self.start()
        self.stiff(calls, "0")
        calls("filter", "step", "filter", lambda dt: _flat(implicit.filter_weights(rule.gamma * dt)))
        self.factor(calls, "filter", ["H0", "Q0", "V0"], "filtered", 1)

        def guess(pace: SX, dt: SX, history: SX, a0: SX) -> tuple[SX, SX]:
            last = pace[PACE.index("last")]
            there = ca.vertcat(*continued(rule, ca.vertsplit(history, side), dt / last))
            return ca.if_else(last, there, ca.repmat(a0, s)), SX(1)

        calls("guess_rates", f"pace step history {self.rates_of('0')}", "rates renew", guess)
        outer, again = calls.inside(), calls.inside()
        self._pass(outer, fresh=True)
        self._pass(again, fresh=False)
        outer.made.append(Loop("go", PASSES, again.steps))
        calls.made.append(Loop("renew", RENEWALS, outer.steps))
        self._sum()
        self._judge()
        self.end([f"watch{i}" for i in ("0", *self.nodes)], rule.estimate + 1, ("history", "rates"))
        return Program(calls.steps, self.plan, rule.name, 1, s, self.count)

    def stiff(self, calls: Calls, i: str) -> None:
        """Compute H, Q, V, by columns, at the stage evaluated last."""

        def found(*known: SX) -> list[SX]:
            return [ca.vec(ca.densify(x)) for x in self.scene.stiffness(*known)]

        calls("stiffness", f"t{i} q{i} v{i} a{i} lam{i} {self.inputs(i)} p k M C", f"H{i} Q{i} V{i}", found)

    def _place(self, calls: Calls, i: str) -> None:
        """Compute time, q and v at a node, with its states, and the accelerations with the rates of states."""
        number, rule = int(i) - 1, self.rule

        def found(z: SX, dt: SX, rates: SX) -> tuple[SX, ...]:
            each = ca.vertsplit(rates, self.side)
            known = self.parted(*implicit.at_node(rule, number, dt, *self.at(z), each))
            return z[self.layout.time] + rule.nodes[number] * dt, *known, each[number]

        calls(f"node{i}", "z step rates", spaced(self.named("t q v", i), f"guess{i}"), found)

    def _pass(self, calls: Calls, fresh: bool) -> None:
        """Make an iteration of Newton's method: accelerations at all nodes, and their changes."""
        side = self.side
        for i in self.nodes:
            self._place(calls, i)
            self.evaluate(calls, i)
            if fresh:
                self.stiff(calls, i)
            known = f"{self.rates_of(i)} guess{i} H{i}"
            calls("lacking", known, f"lacking{i}", lambda a, guess, H: ca.reshape(H, side, side) @ (a - guess))
        if fresh:

            def weights(dt: SX) -> tuple[SX, SX]:
                return _flat(implicit.stage_weights(self.rule, dt)), SX(math.inf)

            calls("weights", "step", "weights before", weights)
            self.factor(calls, "weights", [f"{x}{i}" for x in "HQV" for i in self.nodes], "factors", len(self.nodes))
        self.solve(calls, "factors", [f"lacking{i}" for i in self.nodes], "changes")
        calls("pass", "z step rates changes k before passes", "rates go renew before passes", self._passed)

    def _passed(self, z: SX, step: SX, rates: SX, changes: SX, before: SX, passes: SX) -> tuple[SX, ...]:
        """Return the rates, whether to continue, whether to renew tangents, the change, and the number
        of iterations."""
        n, layout, parts = self.e.n, self.layout, ca.vertsplit(changes, self.side)
        allowed = self.scene.allowed(ca.fabs(z[: 2 * n]))
        if self.e.states:
            allowed = ca.vertcat(allowed, self.scene.allowed_states(ca.fabs(z[layout.states : layout.time])))
        # Change of q, followed by those of v and the states.
        sizes = [step * combined(row, parts)[:n] for row in self.rule.matrix], parts
        change = ca.mmax(ca.vertcat(*(ca.fabs(step * ca.vertcat(*x) / allowed) for x in zip(*sizes, strict=True))))
        change /= self.allowed
        finite = ca.sumsqr(changes) < math.inf
        converged, worth = newton(change, before, ca.if_else)
        converged = ca.logic_and(finite, converged)
        return rates + changes, ca.logic_and(finite, worth), ca.logic_not(converged), change, passes + 1

    def _sum(self) -> None:
        """Compute q, v and work after the step."""
        rule, powers = self.rule, []
        if self.e.works:
            for i in self.nodes:
                self._place(self.calls, i)
                if self.e.frictions and not self.tracer.supplies:
                    known = f"t{i} q{i} v{i} {self.inputs(i)}"
                    rubbing.power(self.calls, known, f"guess{i}", f"power{i}", "rubbing_power_at_node")
                else:
                    self._power(i)
            powers = [f"power{i}" for i in self.nodes]

        def found(z: SX, dt: SX, rates: SX, *powers: SX) -> tuple[SX, ...]:
            q, v, *x = self.parted(*implicit.at_node(rule, -1, dt, *self.at(z), ca.vertsplit(rates, self.side)))
            work = z[self.layout.work]
            return q, v, work + dt * combined(rule.matrix[-1], list(powers)) if powers else work, *x

        self.calls(f"{self.mark}_sum", spaced("z step rates", powers), spaced("q v work", self.tracer.states), found)

    def _power(self, i: str) -> None:
        """Compute power at a stage, with that of prescribed motion."""
        self.calls.made.append(Call("power", (f"q{i}", f"v{i}", self.inputs(i), "p", f"t{i}"), (f"power{i}",)))
        self.tracer._supply(self.calls, i, {"u": self.inputs(i)}, whole=True)
        self.tracer._supplied(self.calls, i)

    def _judge(self) -> None:
        """Compute the error of the step, filtered twice as in `alfmu.method.stepping.collocation_error`; the work of a
        prescribed motion counts, unfiltered."""
        n, side, rule, calls, scene = self.e.n, self.side, self.rule, self.calls, self.scene

        def first(z: SX, dt: SX, rates: SX, a0: SX) -> list[SX]:
            (q0, v0), each = self.at(z), ca.vertsplit(rates, side)
            velocities = [implicit.at_node(rule, i, dt, q0, v0, each)[1] for i in range(len(each))]
            begins = (v0, velocities), (a0, each)
            return [dt * (rule.gamma * begin + combined(rule.errors, x)) for begin, x in begins]

        def filtering(dt: SX, H: SX, Q: SX, dq: SX, dv: SX) -> SX:
            return ca.reshape(H, side, side) @ dv + rule.gamma * dt * (ca.reshape(Q, side, side) @ dq)

        def off_work(z: SX, dt: SX, _: SX, *powers: SX) -> SX:
            return scene.work_size(z, dt, dt * combined((rule.gamma, *rule.errors), list(powers)), powers)

        def size(z: SX, q: SX, v: SX, *known: SX) -> tuple[SX, SX]:
            *x, dq, dv, renew = known[: len(known) - len(worked)]
            states = (*x, dv[n:]) if x else ()
            parts = dq[:n], dv[:n]
            size, floor = scene.error_size(z, q, v, scene.along(q, *parts) if self.e.l else parts, states=states)
            size = reduce(ca.fmax, map(scene.symbol, worked), size) / self.allowed
            return ca.if_else(ca.logic_and(renew == 0, ca.sumsqr(dv) < math.inf), size, math.inf), floor

        calls("estimate", f"z step rates {self.rates_of('0')}", "dq dv", first)
        for _ in range(2):
            calls("filtering", "step H0 Q0 dq dv", "estimate", filtering)
            self.solve(calls, "filtered", ["estimate"], "dv")
            calls("moving", "step dq dv", "dq", lambda dt, dq, dv: dq + rule.gamma * dt * dv)
        self.project()
        worked = ["off_work"] * self.tracer.supplies
        if worked:
            self._power("0")
            powers = [f"power{i}" for i in ("0", *self.nodes)]
            calls(f"{self.name}_off", spaced("z step control", powers, "k"), spaced(worked), off_work)
        known = spaced("z q v", self.tracer.states, "dq dv renew", worked, "p k")
        calls(f"{self.mark}_error", known, "error floor", size)
        if self.kinked:
            # The tolerance of an explicit step is the scene's own, or that of an explicit alternative.
            explicit = scene.settings.beside if self.mark == "method" else SX(1)
            self.judge_kinks(rule, ["0", *self.nodes], [self.rates_of("0"), "rates"], explicit)


class _Newmark(_Implicit):
    """A step of the index-3 form: Newton's method on the positions, then projections in the metric of its tangent.

    Its history is the accelerations `a`, those of the rule `w`, and the multipliers `force`.
    """

    def __init__(self, tracer: Tracer, plan: Plan, rule: implicit.Newmark):
        super().__init__(tracer, plan)
        self.rule, self.count = rule, 2 * self.side + self.e.l
        tracer.lengths |= dict.fromkeys(("history", "kept"), self.count)

    def program(self) -> Program:
        n, l, calls = self.side, self.e.l, self.calls
        self.begin()
        self.start()

        def start(pace: SX, history: SX, a0: SX, lam0: SX) -> tuple[SX, ...]:
            begun = ca.if_else(pace[PACE.index("last")], history, ca.vertcat(a0, a0, lam0))
            return *ca.vertsplit(begun, [0, n, 2 * n, 2 * n + l]), SX.zeros(n), SX(1)

        calls("start", f"pace history {self.rates_of('0')} lam0", "begun w force change go", start)
        again = calls.inside()
        self._pass(again)
        calls.made.append(Loop("go", NEWMARK_PASSES, again.steps))
        self._moved(calls)
        for _ in range(RETURNS * bool(l)):
            self._returned("q1", "closing", "q1", lambda q: self.e.Phi(q, self.scene.p))
            self._returned("v1", "slowing", "q1 v1", lambda q, v: self.scene.speed(q, v, self.e.C(q, self.scene.p)))
        self._settled()
        self.end(["watch0", "watch1"], 3, ("history", "kept"))
        return Program(calls.steps, self.plan, self.rule.name, 2, 0, self.count)

    def _moved(self, calls: Calls) -> None:
        """Compute time, q, v and the accelerations of the rule after the step."""

        def found(z: SX, dt: SX, w: SX, a: SX, change: SX) -> tuple[SX, ...]:
            q, v, after = implicit.moved(self.rule, dt, *self.at(z), w, a, change)
            return z[self.layout.time] + dt, *self.parted(q, v), after

        calls("moved", "z step w begun change", spaced(self.named("t q v", "1"), "after_w"), found)

    def _pass(self, calls: Calls) -> None:
        """Make an iteration of Newton's method, with new tangents."""
        rule, scene = self.rule, self.scene
        self._moved(calls)
        u = self.tracer.inputs(calls, "1")

        def found(t: SX, q: SX, v: SX, a: SX, change: SX, lam: SX, u: SX, dt: SX) -> list[SX]:
            *tangents, C, Phi, right = scene.positions(rule, dt, t, q, v, a + change, lam, u)
            return [*(ca.vec(ca.densify(x)) for x in tangents), C, Phi, right]

        calls("positions", f"t1 q1 v1 begun change force {u} p k step", "H Rq Rv rows Phi right", found)
        calls("weights", "step", "weights", lambda dt: _flat(implicit.position_weights(rule, dt)))
        self.factor(calls, "weights", ["H", "Rq", "Rv"], "factors", 1)
        self.solve(calls, "factors", ["right"], "dq")
        calls("pass", "z step rows Phi dq change force k passes", "change force go size passes", self._passed)

    def _passed(self, z: SX, dt: SX, C: SX, Phi: SX, dq: SX, change: SX, lam: SX, passes: SX) -> tuple[SX, ...]:
        """Return accelerations, multipliers, whether to continue, the size of the change, the number of iterations."""
        n, l, layout = self.e.n, self.e.l, self.layout
        _, by_a = implicit.changes(self.rule, dt)
        size = ca.mmax(ca.fabs(dq[:n]) / ca.fmax(ca.fabs(z[:n]), 1))
        if self.e.states:  # displacements of the states' masses over the step
            nominal = ca.DM([v.nominal or 1.0 for v in self.e.states])
            x = ca.fmax(ca.fabs(z[layout.states : layout.time]), nominal)
            size = ca.fmax(size, ca.mmax(ca.fabs(dq[n:]) / (dt * x)))
        size = ca.if_else(ca.sumsqr(dq) < math.inf, size, math.inf)
        if l:
            lam = lam + by_a * (self.scene.weights @ (Phi + ca.reshape(C, l, n) @ dq[:n]))
        go = ca.logic_and(size > implicit.CONVERGED, size < math.inf)
        return change + by_a * dq, lam, go, size, passes + 1

    def _returned(self, what: str, name: str, known: str, residue: Callable[..., SX]) -> None:
        """Apply a correction (10) to q or v with the factors of the last iteration."""
        n, l, weights = self.e.n, self.e.l, self.scene.weights

        def right(*known: SX) -> SX:
            *at, C = known
            force: SX = method.project(ca.reshape(C, l, n), weights, lambda b: b, residue(*at))
            return ca.vertcat(force, self.moved)

        self.calls(name, f"{known} rows p k", "right", right)
        self.solve(self.calls, "factors", ["right"], "dx")
        self.calls("corrected", f"{what} dx", what, lambda x, dx: x + dx[:n])

    def _settled(self) -> None:
        """Compute q, v, the accelerations at the start of the next step, work, and whether all converged."""
        l, scene, calls, plan = self.e.l, self.scene, self.calls, self.plan
        u = self.tracer.inputs(calls, "1")

        def arrived(t: SX, q: SX, v: SX, u: SX) -> tuple[SX, ...]:
            power, (_, pivot, left) = scene.power(t, q, v, u), scene.settled(q, v, 0)
            return (q, v, power, pivot, left) if l else (q, v, power)

        def nearest(t: SX, q: SX, v: SX, a: SX, change: SX, w: SX, lam: SX, u: SX, *rates: SX) -> tuple[SX, SX]:
            found, watch = scene.nearest(plan, t, q, v, u, (a + change)[: self.e.n])
            return ca.vertcat(found, *rates, w, lam), watch

        def summed(z: SX, dt: SX, power0: SX, power1: SX, size: SX) -> tuple[SX, SX, SX]:
            work = z[self.layout.work] + dt / 2 * (power0 + power1)
            # Steps of fixed length have no error estimate, but must have converged.
            return work, ca.if_else(size <= implicit.CONVERGED, 0, math.inf), SX(0)

        self.tracer._supply(calls, "0", {"u": self.inputs("0")})
        self.tracer._supplied(calls, "0")
        calls("arrived", f"t1 q1 v1 {u} p k", "q v power1" + " pivot left" * bool(l), arrived)
        # Choose the accelerations that satisfy the constraints and are nearest in the metric of M.
        rates = ""
        if self.e.states:
            rates = "xdot1"
            calls.made.append(Call("state_rates", ("q1", "v1", u, "p", "t1"), (rates,)))
            calls("states_after", "x1", "x", lambda x: x)
        calls("nearest", spaced(f"t1 q1 v1 begun change after_w force {u}", rates, "p k"), "kept watch1", nearest)
        if self.tracer.supplies:
            calls("accelerated", "begun change", "a1", lambda a, change: a + change)
            self.tracer._supply(calls, "1", {"u": u, "lam1": "force"})
            self.tracer._supplied(calls, "1")
        calls("method_sum", "z step power0 power1 size", "work error floor", summed)


def _known(pace: SX) -> dict[str, SX]:
    """Return the state of step control, by name."""
    return dict(zip(PACE, ca.vertsplit(pace), strict=True))


def _flat(weights: list[list[list[SX]]]) -> SX:
    return ca.vertcat(*(x for rows in weights for row in rows for x in row))
