"""Trace the method of a scene beside RK4: a program that proposes a step, makes it, and judges its error.

Implicit ones have loops of Newton's method: passes with the same tangents as long as they gain enough, then with new
ones (`method.stepping.newton`). Tangents are those of the augmented equation (`method.implicit.stiffness`). A step
that cannot be judged (a stage near a singular position, constraints that stay open) is troubled: the oracle makes it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace

import casadi as ca

from ..method import formulations as method
from ..method import implicit
from ..method.singular import LONG_NOISE, LONG_PLACES, LONG_SPACING
from ..method.stepping import (
    SHORTEST,
    Collocation,
    Explicit,
    combined,
    continued,
    explicit,
    explicit_rule,
    judged,
    landing,
    newton,
)
from ..model.settings import Settings
from .program import FACTOR, LOOP, PACE, SOLVE, Program
from .trace import Calls, Plan, Scene, Tracer, Watch

__all__ = ["controlled"]

PASSES = 8
"""Most passes of Newton's method with the same tangents, after the first."""

RENEWALS = 4
"""Most tangents in a step."""

NEWMARK_PASSES = 16
"""Most passes of Newton's method in the index-3 form, each with new tangents."""

BESIDE = 7
"""Multiplier iterations of a step on the branch: enough at the nearest places that a limit is taken from."""

RETURNS = 4
"""Projections of q and v after them."""

LEFT = 1e3
"""Steps below so many of the shortest are left to the oracle, which says why."""


def controlled(tracer: Tracer, plan: Plan) -> dict[str, Program]:
    """The programs of the method of a scene; none where RK4 makes its steps."""
    solver = tracer.e.solver
    name = solver.get("method", "rk4")
    plan = replace(plan, weighted=True, margins=bool(tracer.e.l))
    tolerance = solver.get("relative_tolerance", Settings.relative_tolerance)
    rule, explicit_one = implicit.RULES.get(name), explicit_rule(name, tolerance)
    if rule is None and explicit_one is None:
        return {}
    if explicit_one:
        programs = {"method": _Explicit(tracer, plan).program(explicit_one)}
    else:
        kind = _Collocation if isinstance(rule, Collocation) else _Newmark
        programs = {"method": kind(tracer, plan, rule).program()}
    if tracer.e.l:
        # Implicit methods have no limits at singular positions: an explicit one passes them.
        beside = Plan(BESIDE, 3, weighted=True, branch=True, spacing=LONG_SPACING, side=LONG_PLACES)
        step = _Explicit(tracer, beside)
        step.mark = "method" if explicit_one else "beside"
        programs["beside"] = step.program(explicit_one or explicit_rule("explicit", tolerance))
    return programs


class _Step:
    """What all methods have: the calls before and after a step."""

    def __init__(self, tracer: Tracer, plan: Plan):
        self.tracer, self.plan, self.e, self.layout = tracer, plan, tracer.e, tracer.layout
        self.z, self.u, self.p, self.k, self.dt = tracer.known.values()
        self.scene = Scene(self.e, plan.weighted, self.p, self.k)
        self.calls = Calls(tracer)
        self.pace = ca.SX.sym("pace", len(PACE))
        self.name = "beside" if plan.branch else "method"

    def begin(self) -> None:
        """The length of the step and the time at its end, from what step control remembers."""
        known, t = dict(zip(PACE, ca.vertsplit(self.pace), strict=True)), self.z[self.layout.time]
        left, fixed = known["end"] - t, known["fixed"]
        step = ca.if_else(fixed, ca.fmin(fixed, left), landing(known["dt"], left, ca.if_else))
        arrival = ca.if_else(step >= left * (1 - 1e-9), known["end"], t + step)
        found = {"step": step, "arrival": arrival}
        self.calls("pace", {"z": self.z, "pace": self.pace}, lambda: found, list(found))

    def project(self, q: ca.SX, v: ca.SX) -> None:
        """q and v brought back to the constraints."""
        for _ in range(self.plan.corrections):
            self.tracer.place(self.calls, self.scene, "q", "q")
        if self.e.l:
            known = {"q": q, "v": v, "p": self.p, "k": self.k}
            self.tracer.settle(self.calls, self.scene, self.plan, known, ["v", "pivot", "left"])

    def end(self, watches: list[str], order: int, **kept: ca.SX) -> None:
        """The state after the step and what step control remembers; `kept` is the history with its part that is new."""
        e, scene, calls = self.e, self.scene, self.calls
        known = {"z": self.z, "arrival": ca.SX.sym("arrival"), "q": ca.SX.sym("q", e.n), "v": ca.SX.sym("v", e.n)}
        known |= {"work": ca.SX.sym("work"), "p": self.p, "k": self.k, "error": ca.SX.sym("error")}
        known |= {name: ca.SX.sym("watch", len(Watch.FIELDS)) for name in watches}
        if e.l:
            known |= {"pivot": ca.SX.sym("pivot"), "left": ca.SX.sym("left", 2)}
        if self.plan.branch:
            known |= {watch.replace("watch", "zone"): ca.SX.sym("zone") for watch in watches}
        calls(f"{self.name}_close", known, lambda: {"after": scene.closed(self.plan, known)}, ["after"])
        after, step = ca.SX.sym("after", self.z.numel()), self.dt
        known = {"after": after, "pace": self.pace, "step": step, **kept}
        results = ["after", "pace", *list(kept)[:1]]
        calls(f"{self.name}_judge", known, lambda: self._judged(order, after, *kept.values()), results)

    def _judged(self, order: int, after: ca.SX, *kept: ca.SX) -> dict[str, ca.SX]:
        layout, pace, step = self.layout, self.pace, self.dt
        known = dict(zip(PACE, ca.vertsplit(pace), strict=True))
        error, trouble, near = after[layout.change], after[layout.trouble], after[layout.near]
        numbers = [known[name] for name in ("dt", "before", "refused")]
        *following, accepted = judged(order, numbers, step, error, ca.if_else)
        fixed = known["fixed"] != 0
        # Steps of one length are not judged, but for Newton's method.
        near = ca.SX(0) if self.plan.branch else near
        trouble = ca.if_else(fixed, trouble + 1 - (error < math.inf), ca.if_else(accepted, trouble, near))
        trouble += ca.logic_not(fixed) * (1 - (step >= LEFT * SHORTEST))
        accepted = ca.logic_or(fixed, accepted)
        following = [ca.if_else(fixed, old, new) for old, new in zip(numbers, following, strict=True)]
        last = ca.if_else(accepted, step, known["last"])
        following = ca.vertcat(*following, known["fixed"], known["end"], last, accepted)
        results = {"after": ca.vertcat(after[: layout.trouble], trouble, after[layout.change :])}
        results["pace"] = ca.if_else(trouble, pace, following)
        if kept:
            before, new = kept
            results["history"] = ca.if_else(ca.logic_and(trouble == 0, accepted), new, before)
        return results


class _Explicit(_Step):
    """A step of an explicit method with projection; functions of stages have the mark in their names."""

    mark = "method"

    def program(self, rule: Explicit) -> Program:
        e, layout, z, dt, calls, scene = self.e, self.layout, self.z, self.dt, self.calls, self.scene
        self.begin()
        rates: dict[str, ca.SX] = {}
        q, v, work = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n), ca.SX.sym("work")
        settled: dict[str, ca.SX] = {}

        def settle(y: ca.SX) -> ca.SX:
            after = {"q": y[: e.n], "v": y[e.n : 2 * e.n], "work": y[2 * e.n]}
            calls(f"{self.mark}_sum", {"z": z, "step": dt, **rates}, lambda: after, list(after))
            self.project(q, v)
            settled.update({"q": q, "v": v, "work": work})
            return ca.vertcat(q, v, work)

        rate = self.tracer.rate(calls, scene, self.plan, f"{self.mark}_stage", rates, settled, "step")
        start = ca.vertcat(z[: 2 * e.n], z[layout.work])
        _, [error], _ = explicit(rule, rate, z[layout.time], start, dt, None, settle)
        known = {"z": z, "step": dt, **rates, "q": q, "v": v, "p": self.p, "k": self.k}
        least = LONG_NOISE * self.plan.branch
        calls(f"{self.name}_error", known, lambda: {"error": scene.error_size(z, q, v, error, least)}, ["error"])
        self.end([f"watch{i + 1}" for i in range(len(rates))], rule.estimate + 1)
        return {**asdict(self.plan), "rule": rule.name, "evaluations": len(rates), "calls": calls.made}


class _Implicit(_Step):
    """What methods with Newton's method have."""

    def __init__(self, tracer: Tracer, plan: Plan):
        super().__init__(tracer, plan)
        n, l = self.e.n, self.e.l
        self.q, self.v, self.a = (ca.SX.sym(name, n) for name in "qva")
        self.t, self.lam = ca.SX.sym("t"), ca.SX.sym("lam", l)
        self.matrices = tracer.matrices(self.scene)

    def inputs(self, i: str) -> str:
        """Name of the inputs at a place."""
        return f"u{i}" if self.tracer.order else "u"

    def evaluate(self, i: str) -> None:
        """a, lam, power and watch of a place, with the inputs at its time."""
        self.tracer.evaluation(self.calls, self.scene, self.plan, i, {"u": self.tracer.inputs(self.calls, i)})

    def stiff(self, i: str) -> None:
        """H, Q, V of a place that was evaluated last, each by columns."""
        scene = self.scene
        some = {name: self.matrices[name] for name in ("M", "C")}
        known = {f"t{i}": self.t, f"q{i}": self.q, f"v{i}": self.v, f"a{i}": self.a, f"lam{i}": self.lam}
        known |= {self.inputs(i): self.u, "p": self.p, "k": self.k, **some}

        def found() -> dict[str, ca.SX]:
            found = scene.stiffness(self.q, self.v, self.a, self.lam, self.u, self.t, some)
            return {name: ca.vec(ca.densify(x)) for name, x in zip("HQV", found, strict=True)}

        self.calls("stiffness", known, found, [f"H{i}", f"Q{i}", f"V{i}"])

    def factor(self, weights: str, parts: list[str], to: str, nodes: int) -> None:
        self.calls.made.append([FACTOR, [weights, *parts], [to, f"{to}_order"], self.e.n, nodes])

    def solve(self, factors: str, right: list[str], to: str) -> None:
        self.calls.made.append([SOLVE, [factors, f"{factors}_order", *right], [to], self.e.n, len(right)])

    def loop(self, number: str, times: int, passes: list[list]) -> None:
        self.calls.made.append([LOOP, number, times, passes])

    def inside(self) -> list[list]:
        """The calls that are made from here on, apart."""
        self.calls.made = []
        return self.calls.made


class _Collocation(_Implicit):
    """A step of a collocation method, by the accelerations at its nodes."""

    def __init__(self, tracer: Tracer, plan: Plan, rule: Collocation):
        super().__init__(tracer, plan)
        self.rule, self.nodes = rule, [str(i + 1) for i in range(len(rule.nodes))]
        self.rates = ca.SX.sym("rates", self.e.n * len(rule.nodes))

    def program(self) -> Program:
        rule, z, dt, k, calls, made = self.rule, self.z, self.dt, self.k, self.calls, self.calls.made
        n, s = self.e.n, len(self.nodes)
        self.begin()
        q0, v0, a0 = z[:n], z[n : 2 * n], ca.SX.sym("a0", n)
        here = {"t0": z[self.layout.time], "q0": q0, "v0": v0}
        calls("unpack_method", {"z": z}, lambda: here, list(here))
        self.evaluate("0")
        self.stiff("0")
        calls("filter", {"step": dt}, lambda: {"w": _flat(implicit.filter_weights(rule.gamma * dt))}, ["filter"])
        self.factor("filter", ["H0", "Q0", "V0"], "filtered", 1)
        history = ca.SX.sym("history", n * s)

        def guess() -> dict[str, ca.SX]:
            last = self.pace[PACE.index("last")]
            there = ca.vertcat(*continued(rule, ca.vertsplit(history, n), dt / last))
            rates = ca.if_else(last, there, ca.repmat(a0, s))
            return {"rates": rates, "renew": ca.SX(1)}

        calls("guess_rates", {"pace": self.pace, "step": dt, "history": history, "a0": a0}, guess, ["rates", "renew"])
        outer = self.inside()
        self._pass(fresh=True)
        again = self.inside()
        self._pass(fresh=False)
        calls.made = outer
        self.loop("go", PASSES, again)
        calls.made = made
        self.loop("renew", RENEWALS, outer)

        self._sum()
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        dq, dv, renew = ca.SX.sym("dq", n), ca.SX.sym("dv", n), ca.SX.sym("renew")
        first = dict(zip(("dq", "dv"), self._estimate(q0, v0, a0), strict=True))
        calls("estimate", {"z": z, "step": dt, "rates": self.rates, "a0": a0}, lambda: first, list(first))
        H, Q, by = ca.SX.sym("H", n * n), ca.SX.sym("Q", n * n), rule.gamma * dt
        known = {"step": dt, "H0": H, "Q0": Q, "dq": dq, "dv": dv}
        for _ in range(2):
            right = ca.reshape(H, n, n) @ dv + by * (ca.reshape(Q, n, n) @ dq)
            calls("filtering", known, lambda right=right: {"b": right}, ["estimate"])
            self.solve("filtered", ["estimate"], "dv")
            calls("moving", {"step": dt, "dq": dq, "dv": dv}, lambda: {"dq": dq + by * dv}, ["dq"])
        self.project(q, v)

        def size() -> dict[str, ca.SX]:
            size = self.scene.error_size(z, q, v, ca.vertcat(dq, dv))
            return {"error": ca.if_else(ca.logic_and(renew == 0, ca.sumsqr(dv) < math.inf), size, math.inf)}

        known = {"z": z, "q": q, "v": v, "dq": dq, "dv": dv, "renew": renew, "p": self.p, "k": k}
        calls("method_error", known, size, ["error"])
        self.end([f"watch{i}" for i in ("0", *self.nodes)], rule.estimate + 1, history=history, rates=self.rates)
        own = {"rule": rule.name, "evaluations": 1, "nodes": s, "history": n * s}
        return {**asdict(self.plan), **own, "calls": made}

    def _place(self, i: str) -> None:
        """Time, q and v at a node, and the acceleration that they were found with."""
        z, n, number = self.z, self.e.n, int(i) - 1
        rates = ca.vertsplit(self.rates, n)
        q, v = implicit.at_node(self.rule, number, self.dt, z[:n], z[n : 2 * n], rates)
        found = {f"t{i}": z[self.layout.time] + self.rule.nodes[number] * self.dt, f"q{i}": q, f"v{i}": v}
        found[f"guess{i}"] = rates[number]
        self.calls(f"node{i}", {"z": z, "step": self.dt, "rates": self.rates}, lambda: found, list(found))

    def _pass(self, fresh: bool) -> None:
        """A pass of Newton's method: accelerations at all nodes, and what they change."""
        n, s, calls, dt = self.e.n, len(self.nodes), self.calls, self.dt
        H, guess = ca.SX.sym("H", n * n), ca.SX.sym("guess", n)
        for i in self.nodes:
            self._place(i)
            self.evaluate(i)
            if fresh:
                self.stiff(i)
            known = {f"a{i}": self.a, f"guess{i}": guess, f"H{i}": H}
            calls("lacking", known, lambda: {"b": ca.reshape(H, n, n) @ (self.a - guess)}, [f"lacking{i}"])
        if fresh:

            def weights() -> dict[str, ca.SX]:
                return {"weights": _flat(implicit.stage_weights(self.rule, dt)), "before": ca.SX(math.inf)}

            calls("weights", {"step": dt}, weights, ["weights", "before"])
            self.factor("weights", [f"{x}{i}" for x in "HQV" for i in self.nodes], "factors", s)
        self.solve("factors", [f"lacking{i}" for i in self.nodes], "changes")
        known = {"z": self.z, "step": dt, "rates": self.rates, "changes": ca.SX.sym("changes", n * s), "k": self.k}
        known |= {name: ca.SX.sym(name) for name in ("before", "passes")}
        calls("pass", known, lambda: self._passed(**known), ["rates", "go", "renew", "before", "passes"])

    def _passed(
        self, z: ca.SX, step: ca.SX, rates: ca.SX, changes: ca.SX, k: ca.SX, before: ca.SX, passes: ca.SX
    ) -> dict[str, ca.SX]:
        n, parts = self.e.n, ca.vertsplit(changes, self.e.n)
        allowed = self.scene.allowed(ca.fabs(z[: 2 * n]))
        sizes = [step * combined(row, parts) for row in self.rule.matrix], parts
        change = ca.mmax(ca.vertcat(*(ca.fabs(step * ca.vertcat(*x) / allowed) for x in zip(*sizes, strict=True))))
        finite = ca.sumsqr(changes) < math.inf
        converged, worth = newton(change, before, ca.if_else)
        converged = ca.logic_and(finite, converged)
        return {
            "rates": rates + changes,
            "go": ca.logic_and(finite, worth),
            "renew": ca.logic_not(converged),
            "before": change,
            "passes": passes + 1,
        }

    def _sum(self) -> None:
        """q, v and work after the step."""
        z, n, rule, dt = self.z, self.e.n, self.rule, self.dt
        known = {"z": z, "step": dt, "rates": self.rates}
        if self.e.works:
            for i in self.nodes:
                self._place(i)
                self.calls.made.append(["power", [f"q{i}", f"v{i}", self.inputs(i), "p", f"t{i}"], [f"power{i}"]])
            known |= {f"power{i}": ca.SX.sym("power") for i in self.nodes}
        powers = [known[f"power{i}"] for i in self.nodes] if self.e.works else []

        def found() -> dict[str, ca.SX]:
            q, v = implicit.at_node(rule, -1, dt, z[:n], z[n : 2 * n], ca.vertsplit(self.rates, n))
            work = z[self.layout.work]
            return {"q": q, "v": v, "work": work + dt * combined(rule.matrix[-1], powers) if powers else work}

        self.calls("method_sum", known, found, ["q", "v", "work"])

    def _estimate(self, q0: ca.SX, v0: ca.SX, a0: ca.SX) -> tuple[ca.SX, ca.SX]:
        """What the estimate of the error filters, as in `alfmu.method.stepping.collocation_error`."""
        rule, n = self.rule, self.e.n
        rates = ca.vertsplit(self.rates, n)
        velocities = [implicit.at_node(rule, i, self.dt, q0, v0, rates)[1] for i in range(len(rates))]
        begins = (v0, velocities), (a0, rates)
        return tuple(self.dt * (rule.gamma * first + combined(rule.errors, each)) for first, each in begins)


class _Newmark(_Implicit):
    """A step of the index-3 form: Newton's method on the positions, then projections in the metric of its tangent."""

    def __init__(self, tracer: Tracer, plan: Plan, rule: implicit.Newmark):
        super().__init__(tracer, plan)
        n, l = self.e.n, self.e.l
        self.rule = rule
        self.history = {"a": ca.SX.sym("a", n), "w": ca.SX.sym("w", n), "force": ca.SX.sym("force", l)}
        """Accelerations, those of the rule, and multipliers (times `scale`) that a step begins with."""
        self.change = ca.SX.sym("change", n)

    def program(self) -> Program:
        n, l, calls, made, z = self.e.n, self.e.l, self.calls, self.calls.made, self.z
        q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
        self.begin()
        here = {"t0": z[self.layout.time], "q0": z[:n], "v0": z[n : 2 * n]}
        calls("unpack_method", {"z": z}, lambda: here, list(here))
        self.evaluate("0")
        history = ca.SX.sym("history", 2 * n + l)

        def start() -> dict[str, ca.SX]:
            begun = ca.if_else(self.pace[PACE.index("last")], history, ca.vertcat(self.a, self.a, self.lam))
            a, w, lam = ca.vertsplit(begun, [0, n, 2 * n, 2 * n + l])
            return {"a": a, "w": w, "force": lam, "change": ca.SX.zeros(n), "go": ca.SX(1)}

        known = {"pace": self.pace, "history": history, "a0": self.a, "lam0": self.lam}
        calls("start", known, start, ["a", "w", "force", "change", "go"])
        again = self.inside()
        self._pass()
        calls.made = made
        self.loop("go", NEWMARK_PASSES, again)
        self._moved("1")
        for _ in range(RETURNS * bool(l)):
            self._returned("q1", "closing", {"q1": q}, lambda: self.e.Phi(q, self.p))
            self._returned("v1", "slowing", {"q1": q, "v1": v}, lambda: self.e.C(q, self.p) @ v)
        self._settled()
        kept = ca.SX.sym("kept", 2 * n + l)
        self.end(["watch0", "watch1"], 3, history=history, kept=kept)
        own = {"rule": self.rule.name, "evaluations": 2, "nodes": 0, "history": 2 * n + l}
        return {**asdict(self.plan), **own, "calls": made}

    def _moved(self, i: str) -> None:
        """Time, q, v and the accelerations of the rule after the step."""
        z, n, h = self.z, self.e.n, self.history
        known = {"z": z, "step": self.dt, "w": h["w"], "a": h["a"], "change": self.change}

        def found() -> dict[str, ca.SX]:
            q, v, w = implicit.moved(self.rule, self.dt, z[:n], z[n : 2 * n], h["w"], h["a"], self.change)
            return {"t": z[self.layout.time] + self.dt, "q": q, "v": v, "w": w}

        self.calls("moved", known, found, [f"t{i}", f"q{i}", f"v{i}", "after_w"])

    def _pass(self) -> None:
        """A pass of Newton's method, with new tangents."""
        n, l, calls, dt = self.e.n, self.e.l, self.calls, self.dt
        self._moved("1")
        u = self.tracer.inputs(calls, "1")
        a, change, lam = self.history["a"], self.change, self.history["force"]
        known = {"t1": self.t, "q1": self.q, "v1": self.v, "a": a, "change": change, "force": lam}
        known |= {u: self.u, "p": self.p, "k": self.k, "step": dt}
        names = ["H", "Rq", "Rv", "rows", "Phi", "right"]

        def found() -> dict[str, ca.SX]:
            *parts, C, Phi, right = self.scene.positions(self.rule, dt, self.q, self.v, a + change, lam, self.u, self.t)
            return {
                **{str(i): ca.vec(ca.densify(x)) for i, x in enumerate(parts)},
                "rows": C,
                "Phi": Phi,
                "right": right,
            }

        calls("positions", known, found, names)
        calls("weights", {"step": dt}, lambda: {"w": _flat(implicit.position_weights(self.rule, dt))}, ["weights"])
        self.factor("weights", ["H", "Rq", "Rv"], "factors", 1)
        self.solve("factors", ["right"], "dq")
        C, Phi, dq = ca.SX.sym("C", l * n), ca.SX.sym("Phi", l), ca.SX.sym("dq", n)
        known = {"z": self.z, "step": dt, "rows": C, "Phi": Phi, "dq": dq, "change": change, "force": lam, "k": self.k}
        known["passes"] = ca.SX.sym("passes")
        results = ["change", "force", "go", "size", "passes"]
        calls("pass", known, lambda: self._passed(C, Phi, dq, known["passes"]), results)

    def _passed(self, C: ca.SX, Phi: ca.SX, dq: ca.SX, passes: ca.SX) -> dict[str, ca.SX]:
        n, l = self.e.n, self.e.l
        _, by_a = implicit.changes(self.rule, self.dt)
        size = ca.mmax(ca.fabs(dq) / ca.fmax(ca.fabs(self.z[:n]), 1))
        size = ca.if_else(ca.sumsqr(dq) < math.inf, size, math.inf)
        lam = self.history["force"]
        if l:
            lam = lam + by_a * (self.scene.weights @ (Phi + ca.reshape(C, l, n) @ dq))
        go = ca.logic_and(size > implicit.CONVERGED, size < math.inf)
        return {"change": self.change + by_a * dq, "force": lam, "go": go, "size": size, "passes": passes + 1}

    def _returned(self, what: str, name: str, known: dict[str, ca.SX], residue: Callable[[], ca.SX]) -> None:
        """q or v after a correction (10) with the factors of the last pass."""
        n, l, scene, x = self.e.n, self.e.l, self.scene, known[what]
        C, dx = ca.SX.sym("C", l * n), ca.SX.sym("dx", n)
        known = {**known, "rows": C, "p": self.p, "k": self.k}

        def right() -> dict[str, ca.SX]:
            return {"b": method.project(ca.reshape(C, l, n), scene.weights, lambda b: b, residue())}

        self.calls(name, known, right, ["right"])
        self.solve("factors", ["right"], "dx")
        self.calls("corrected", {what: x, "dx": dx}, lambda: {"x": x + dx}, [what])

    def _settled(self) -> None:
        """q, v, the accelerations that the next step begins with, work, and what tells whether all that was enough."""
        n, l, scene, z, calls = self.e.n, self.e.l, self.scene, self.z, self.calls
        u = self.inputs("1")
        known = {"t1": self.t, "q1": self.q, "v1": self.v, u: self.u, "p": self.p, "k": self.k}
        names = ["q", "v", "power1", "pivot", "left"] if l else ["q", "v", "power1"]
        if u == "u1":
            self.tracer.inputs(calls, "1")

        def found() -> dict[str, ca.SX]:
            _, pivot, left = scene.settled(self.q, self.v, 0)
            power = scene.power(self.q, self.v, self.u, self.t)
            return dict(zip(names, (self.q, self.v, power, pivot, left), strict=False))

        calls("arrived", known, found, names)
        # Of all accelerations that keep the constraints, the nearest in the metric of M.
        change, a, w, lam = self.change, self.history["a"], ca.SX.sym("w", n), self.history["force"]
        known = {"t1": self.t, "q1": self.q, "v1": self.v, "a": a, "change": change, "after_w": w, "force": lam}
        known |= {u: self.u, "p": self.p, "k": self.k}

        def nearest() -> dict[str, ca.SX]:
            found, watch = scene.nearest(self.plan, self.q, self.v, self.u, self.t, a + change)
            return {"kept": ca.vertcat(found, w, lam), "watch": watch}

        calls("nearest", known, nearest, ["kept", "watch1"])
        size, power0, power1 = ca.SX.sym("size"), ca.SX.sym("power"), ca.SX.sym("power")
        known = {"z": z, "step": self.dt, "power0": power0, "power1": power1, "size": size}
        work = z[self.layout.work] + self.dt / 2 * (power0 + power1)
        # Steps of one length have no error to be judged by, but must have converged.
        error = ca.if_else(size <= implicit.CONVERGED, 0, math.inf)
        calls("method_sum", known, lambda: {"work": work, "error": error}, ["work", "error"])


def _flat(weights: list[list[list[ca.SX]]]) -> ca.SX:
    return ca.vertcat(*(x for rows in weights for row in rows for x in row))
