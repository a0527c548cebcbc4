"""Trace the method, RK4 and the projections over a mechanism's equations into flat, sparse functions.

What the oracle does with loops that stop on convergence is unrolled here a fixed number of times, and each step says
whether that was enough; where it was not, the caller takes the careful step, then the oracle's path. Only what the
scene needs is traced: no multiplier iteration without constraints, no least-norm pass without redundant rows, no
reaction equation where no reaction is read, no work where nothing works.

A step is a program (`alfmu.kernel.program`) of small functions: `stage` combines rates into the state of a stage,
`evaluate` and `iterate` hold the method, `place` and `settle` (or `correct`) the projection (10), `close` judges. Near
singular positions each stage is brought to the branch of the motion by the same functions and by `return`, and `probe`
says where the limit of the accelerations is taken, from `places` before and after, as their weighted `mean`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from types import MappingProxyType

import casadi as ca
import numpy as np

from ..equations import Equations, Mobility
from ..equations.evaluation import DENSE, EVALUATED, shared, symbols, with_functions
from ..method import formulations as method
from ..method import implicit
from ..method import singular as branch
from ..method.implicit import Newmark
from ..method.inputs import KEPT, extrapolated, memory_size, reached
from ..method.integrators import rk4
from ..model.settings import Settings
from .program import CHOICE, GROSS, SETTINGS, TIERS, TURN, Layout, Program, called

__all__ = ["Calls", "Plan", "Scene", "Tracer", "Watch", "parts", "traced", "untraced"]

CAREFUL = 5
"""Multiplier iterations of the careful step: enough from the default penalty down to 1e4 masses."""

SHARES = 6
"""Passes that share a load among constraints of different compliances; each gains alpha over masses and their ratio."""

_OFTEN = 3
"""Multiplier iterations that most evaluations of a step on the branch need."""

_SHARED = 1e-12
"""Last change of these shares, over what they are."""

MONITORED = tuple(
    f"monitor.{name}" for name in ("position_error", "velocity_error", "energy", "iterations", "distance", "singular")
)
"""Monitors that `instant` computes, in this order."""

_LEFT = 2.0**-50
"""Last change of what multipliers of least norm are made of, over what it is."""

_TOLD = 4.0
"""Margin that can be told from nothing, over it."""

_TINY = 1e-300
"""Lets a mechanism at rest pass the check of convergence."""

ROUND_OFF = 8 * 2.0**-52
"""Of a constraint, over its coordinates."""

_PROBES = 5
"""Positions at which an entry of H is compared."""

_SAME = 1e-13
"""Largest difference of what is the same there, over its size."""


@dataclass(frozen=True)
class Plan:
    """How often the loops of the method are unrolled in a step, and how it is judged whether that was enough."""

    iterations: int
    """Of multipliers in each evaluation."""
    corrections: int
    """Of q, and of v, after the step."""
    quick: bool = False
    """Whether few iterations are judged by how they shrink; otherwise the last change must be within the tolerance."""
    weighted: bool = False
    """Whether each constraint may have a penalty of its own."""
    spacing: float = branch.SPACING
    """Of the places from which limits are taken on the branch, over the step."""
    side: int = branch.PLACES
    """How many of these places there are on either side."""
    branch: bool = False
    """Whether each stage is brought to the branch of the motion that is followed, its limit taken where singular."""
    margins: bool = False
    """Whether the margin itself tells what is near a singular position, not only that it may be; where weighted."""

    @property
    def own(self) -> str:
        """What the names of functions end in that depend on how many places there are."""
        return "" if self.side == Plan.side else "_for_method"


def traced(
    equations: Equations,
    mobility: Mobility | None,
    iterations: int = 2,
    controlled: Callable[[Tracer, Plan], dict[str, Program]] = lambda tracer, plan: {},
) -> Equations:
    """The same equations with the functions of the kernel.

    `mobility` is what is known of constraints and freedoms, `iterations` how many multiplier iterations reach round-off
    at a regular position; `controlled` traces the method of the scene (`alfmu.kernel.controlled`).
    """
    e = untraced(equations)
    redundant = mobility is None or mobility.redundant > 0 or bool(e.switches)
    careful = Plan(CAREFUL, 3, weighted=True) if e.l else Plan(1, 0)
    quick = careful
    if mobility and e.l and iterations < CAREFUL:
        # A large scene shares the functions of the careful step, which are long to trace and to compile.
        weighted = e.n > DENSE or bool(e.switches) or e.brakes or e.uneven
        quick = Plan(iterations, 1, quick=True, weighted=weighted)
    tracer = Tracer(e)
    kernel = {"quick": tracer.step(quick), "careful": tracer.step(careful)}
    continues = e.l and e.solver.get("branch", Settings.branch) == Settings.branch
    if continues:
        kernel["branch"] = tracer.step(replace(careful, branch=True))
    # Where redundant constraints would brake, what stands for their penalties is not the one that two iterations suit.
    kernel |= controlled(tracer, replace(careful if e.brakes else quick, corrections=2 * bool(e.l)))
    kernel["instant"] = tracer.instant(careful, redundant)
    if tracer.order:
        kernel["reach"] = tracer.reach()
    if continues and len(kernel["instant"]["calls"]) > 1:
        kernel["limit"] = tracer.limit(careful, redundant)
    return replace(with_functions(e, tracer.functions), kernel=kernel, freedom=mobility.freedom if mobility else None)


def untraced(equations: Equations) -> Equations:
    """The same equations without the functions of the kernel."""
    if not equations.kernel:
        return equations
    names = {name for program in equations.kernel.values() for name in called(program["calls"])} - set(EVALUATED)
    functions, signatures = (
        {name: x for name, x in each.items() if name not in names}
        for each in (equations.functions, equations.signatures)
    )
    return replace(equations, functions=functions, signatures=signatures, kernel={}, library=None, workspace=0)


def parts(equations: Equations, program: Program) -> tuple[dict[str, ca.Function], dict[str, int]]:
    """What an evaluation of a program comes to step by step, and the structural nonzeros on the way.

    The functions give M, C, F, xi; then also the pivots of H; then the accelerations and the power.
    """
    e = equations
    plan = Plan(**{name: x for name, x in program.items() if name != "calls"})
    x, k = symbols(e), ca.SX.sym("k", Layout(e).fields["k"][1])
    q, v, u, p, t = (x[letter] for letter in "qvupt")
    scene = Scene(e, plan.weighted, p, k)
    terms = scene.terms(q, v, u, t)
    M, C = terms[:2]
    H = scene.augmented_mass(M, C)
    D, L, order = _factors(e, H)
    zeros = ca.SX(e.n, 1), ca.SX(e.l, 1)
    a, _, _ = scene.iterated(terms, (D, L, order), *zeros, plan.iterations)
    results = {"model": terms, "factorisation": [*terms, D, L], "iterations": [a, scene.power(q, v, u, t)]}
    functions = {name: shared(name, [q, v, u, p, t, k], list(values)) for name, values in results.items()}
    return functions, {"M": M.nnz(), "C": C.nnz(), "H": H.nnz(), "L": L.nnz()}


class Tracer:
    """Collects the functions that programs call, each traced once."""

    def __init__(self, equations: Equations):
        self.e, self.layout = equations, Layout(equations)
        self.functions: dict[str, ca.Function] = {}
        self.order = int(equations.solver.get("input_order", 0)) if equations.inputs else 0
        self.past = ca.SX.sym("past", memory_size(len(equations.inputs)))
        fields = self.layout.fields
        self.known = {name: ca.SX.sym(name, fields[name][1]) for name in ("z", "u", "p", "k", "dt")}

    def step(self, plan: Plan) -> Program:
        """An internal step of RK4 with projection."""
        e, layout = self.e, self.layout
        z, _, p, k, dt = self.known.values()
        scene = Scene(e, plan.weighted, p, k)
        calls, rates = Calls(self), {}
        q, v = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n)
        rate = self.rate(calls, scene, plan, "stage", rates)
        y = rk4(rate, z[layout.time], ca.vertcat(z[: 2 * e.n], z[layout.work]), dt)
        after = {"q": y[: e.n], "v": y[e.n : 2 * e.n], "work": y[2 * e.n]}
        calls("sum", {"z": z, "dt": dt, **rates}, lambda: after, list(after))
        watches = {f"watch{i + 1}": ca.SX.sym("watch", len(Watch.FIELDS)) for i in range(len(rates))}
        if e.l:
            state = {"q": q, "v": v, "p": p, "k": k}
            if plan.corrections > 1:
                self.place(calls, scene, "q", "q")
                more = Calls(self) if plan.branch else calls
                for _ in range(plan.corrections - 1):
                    self.place(more, scene, "q", "q")
                if plan.branch:
                    known = {"q": q, "p": p, "k": k}
                    calls("open", known, lambda: {"open": 1 - scene.within(scene.residue(e.Phi(q, p)), q)}, ["open"])
                    calls.made.append([CHOICE, "open", more.made, []])
                self.settle(calls, scene, plan, state, ["v", "pivot", "left"])
                if plan.branch:
                    self.unsettled(calls, scene)
                    again = Calls(self)
                    self.settle(again, scene, plan, state, ["v", "pivot", "left"])
                    calls.made.append([CHOICE, "more", again.made, []])
            else:
                calls(
                    f"{scene.kind}_correct",
                    state,
                    lambda: dict(zip(("q", "v", "pivot", "left"), scene.corrected(q, v), strict=True)),
                    ["q", "v", "pivot", "left"],
                )
            watches |= {"pivot": ca.SX.sym("pivot"), "left": ca.SX.sym("left", 2)}
        work = ca.SX.sym("work")
        known = {"z": z, "dt": dt, "q": q, "v": v, "work": work, "p": p, "k": k, **watches}
        if plan.branch:
            known |= {f"zone{i + 1}": ca.SX.sym("zone") for i in range(len(rates))}
        tier = TIERS[2 if plan.branch else 0 if plan.quick else 1]
        calls(f"{tier}_close", known, lambda: {"after": scene.closed(plan, known)}, ["after"])
        return {**asdict(plan), "calls": calls.made}

    def reach(self) -> Program:
        """Records the inputs at a communication point."""
        z, u, *_ = self.known.values()
        calls, t = Calls(self), z[self.layout.time]

        def noted() -> dict[str, ca.SX]:
            kept, times, inputs = reached(*self._noted(), t, u, ca.if_else)
            return {"past": ca.vertcat(kept, *times, *inputs)}

        calls("reach", {"z": z, "u": u, "past": self.past}, noted, ["past"])
        return {"calls": calls.made}

    def inputs(self, calls: Calls, i: str) -> str:
        """Name of the inputs at a stage: held over the communication step, or extrapolated to t with i in its name."""
        if not self.order:
            return "u"
        t = ca.SX.sym("t")

        def found() -> dict[str, ca.SX]:
            return {"u": extrapolated(*self._noted(), t, self.order, ca.if_else)}

        calls("inputs", {"past": self.past, f"t{i}": t}, found, [f"u{i}"])
        return f"u{i}"

    def _noted(self) -> tuple[ca.SX, list[ca.SX], list[ca.SX]]:
        first = ca.vertsplit(self.past[: 1 + KEPT])
        return first[0], first[1:], ca.vertsplit(self.past[1 + KEPT :], len(self.e.inputs))

    def rate(
        self,
        calls: Calls,
        scene: Scene,
        plan: Plan,
        name: str,
        rates: dict[str, ca.SX],
        settled: Mapping[str, ca.SX] = MappingProxyType({}),
        length: str = "dt",
    ) -> Callable[[ca.SX, ca.SX], ca.SX]:
        """The rate of a state as an integrator asks for it: its calls are made, and its symbol goes into `rates`.

        `length` is the name of what holds the step.
        """
        e = self.e
        z, _, _, _, dt = self.known.values()

        def found(t: ca.SX, y: ca.SX) -> ca.SX:
            i = len(rates) + 1
            stage = {f"t{i}": t, f"q{i}": y[: e.n], f"v{i}": y[e.n : 2 * e.n]}
            calls(f"{name}{i}", {"z": z, length: dt, **rates, **settled}, lambda: stage, list(stage))
            u = self.inputs(calls, str(i))
            if plan.branch:
                self._on_branch(calls, scene, plan, str(i), u, length, i == 1)
            else:
                self.evaluation(calls, scene, plan, str(i), {"u": u})
            v, a, power = ca.SX.sym("v", e.n), ca.SX.sym("a", e.n), ca.SX.sym("power")
            calls(
                "rate",
                {f"v{i}": v, f"a{i}": a, f"power{i}": power},
                lambda: {"rate": ca.vertcat(v, a, power)},
                [f"rate{i}"],
            )
            rates[f"rate{i}"] = ca.SX.sym(f"rate{i}", 2 * e.n + 1)
            return rates[f"rate{i}"]

        return found

    def instant(self, plan: Plan, redundant: bool) -> Program:
        """What a user can read, monitors, largest |Phi-ddot|, trouble."""
        e, layout = self.e, self.layout
        z, u, p, k, _ = self.known.values()
        scene = Scene(e, plan.weighted, p, k)
        calls = Calls(self)
        q, v, t = z[: e.n], z[e.n : 2 * e.n], z[layout.time]
        known = {"z": z, "u": u, "p": p, "k": k}
        distance = {"monitor.distance", "monitor.singular"} - set(e.monitors)
        if not distance and not any(o.instant for o in e.outputs):
            # Nobody reads an acceleration or a reaction: none is computed.
            zeros = ca.SX(e.n, 1), ca.SX(e.l, 1)
            calls("seen", known, lambda: {"seen": scene.seen(plan, z, u, *zeros)}, ["seen"])
            return {**asdict(plan), "calls": calls.made}
        unpacked = {"t0": t, "q0": q, "v0": v, "singular": ca.SX(0)}
        calls("unpack", {"z": z}, lambda: unpacked, list(unpacked))
        self.evaluation(calls, scene, plan, "0")
        if redundant and e.l:
            self._least(calls, scene, "lam0")
        self._seen(calls, scene, plan, "a0", "lam0", "watch0")
        return {**asdict(plan), "calls": calls.made}

    def limit(self, plan: Plan, redundant: bool) -> Program:
        """S4: what `instant` gives, with the limits of accelerations and reactions along the motion."""
        e, layout = self.e, self.layout
        z, _, p, k, _ = self.known.values()
        scene, calls, n = Scene(e, plan.weighted, p, k), Calls(self), e.n
        q, v, t = z[:n], z[n : 2 * n], z[layout.time]
        count = range(len(branch.READ_MEAN))
        places = [f"place{j}" for j in count]
        found = {f"a{j}": ca.SX.sym("a", n) for j in count} | {f"lam{j}": ca.SX.sym("lam", e.l) for j in count}
        found |= {f"watch{j}": ca.SX.sym("watch", len(Watch.FIELDS)) for j in count}
        unpacked = {"tz": t, "qz": q, "vz": v}
        calls("unpack_limit", {"z": z}, lambda: unpacked, list(unpacked))
        self._read_places(calls, scene, places)
        for j in count:
            self._beside(calls, scene, plan, places[j], str(j))
            if redundant:
                self._least(calls, scene, f"lam{j}")
        here = {"tl": "tz", "ql": "qz", "vl": "vz"}
        self.evaluation(calls, scene, replace(plan, iterations=1), "l", here)
        watch = ca.SX.sym("watch", len(Watch.FIELDS))
        known = {**found, "watchl": watch}
        calls("limits", known, lambda: scene.limits(list(found.values()), watch), ["al", "laml", "watchl", "singular"])
        self._seen(calls, scene, plan, "al", "laml", "watchl")
        return {**asdict(plan), "calls": calls.made}

    def _beside(self, calls: Calls, scene: Scene, plan: Plan, place: str, j: str) -> None:
        """An evaluation at a place from which a limit is read; j is part of the names of its results."""
        self.place(calls, scene, place, "placed")
        self._brought(calls, scene, plan, place, "placed", "vz")
        self.evaluation(calls, scene, plan, j, {f"t{j}": "tz", f"q{j}": "q0", f"v{j}": "v0"})

    def _read_places(self, calls: Calls, scene: Scene, places: list[str], dt: str = "dt") -> None:
        """The places from which a limit is read; `dt` is what their spacing is measured by."""
        n = self.e.n
        z, _, p, k, step = self.known.values()
        known = {"z": z, dt: step, "p": p, "k": k}
        calls("read_places", known, lambda: scene.read_places(z[:n], z[n : 2 * n], step), places)

    def _least(self, calls: Calls, scene: Scene, name: str) -> None:
        """Multipliers of least norm in place of those found last."""
        matrices, lam = self.matrices(scene), ca.SX.sym("lam", self.e.l)
        if self.e.compliances:
            some = {each: matrices[each] for each in ("M", "C")}
            known = {"k": self.known["k"], **some, name: lam}
            calls("distribute", known, lambda: {"lam": scene.distributed(some, lam)}, [name])
            return
        some = {each: matrices[each] for each in ("C", "D", "L")}
        known = {"k": self.known["k"], **some, name: lam}
        calls("least", known, lambda: {"lam": scene.least(some, lam)}, [name])

    def _seen(self, calls: Calls, scene: Scene, plan: Plan, a: str, lam: str, watch: str) -> None:
        e = self.e
        z, u, p, k, _ = self.known.values()
        matrices = self.matrices(scene)
        symbols = ca.SX.sym("a", e.n), ca.SX.sym("lam", e.l), ca.SX.sym("watch", len(Watch.FIELDS)), ca.SX.sym("s")
        known = {"z": z, "u": u, "p": p, "k": k, "C": matrices["C"], "xi": matrices["xi"]}
        known |= dict(zip((a, lam, watch, "singular"), symbols, strict=True))
        results = {"C": scene.matrix("C", matrices), "xi": matrices["xi"], "watch": symbols[2], "singular": symbols[3]}
        calls("seen", known, lambda: {"seen": scene.seen(plan, z, u, *symbols[:2], **results)}, ["seen"])

    def _on_branch(self, calls: Calls, scene: Scene, plan: Plan, i: str, u: str, length: str, kept: bool) -> None:
        """S2 to S4: a, power, watch of the branch near t, q, v, and whether a limit was taken; i is part of each name.

        `u` and `length` are the names of the inputs and of the step; `kept` says that q and v keep the constraints.
        """
        n, own = self.e.n, plan.own
        q, v, spacing = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("spacing")
        here = {f"q{i}": q, f"v{i}": v}
        self._probe(calls, scene, plan, i, length)
        places = [f"place{j}" for j in range(2 * plan.side)]
        accelerations = {f"acceleration{j}": ca.SX.sym("a", n) for j in range(len(places))}
        watches = {f"watched{j}": ca.SX.sym("watch", len(Watch.FIELDS)) for j in range(len(places))}
        limit = Calls(self)
        limit(f"places{own}", {**here, "spacing": spacing}, lambda: scene.places(q, v, spacing, plan.side), places)
        for j, (a, watch) in enumerate(zip(accelerations, watches, strict=True)):
            self.place(limit, scene, f"place{j}", "placed")
            self._brought(limit, scene, plan, f"place{j}", "placed", f"v{i}")
            self.evaluation(limit, scene, plan, "0", {"u": u, "t0": f"t{i}", "a0": a, "watch0": watch})
            self._reached(limit, watch)
        limit(
            f"mean{own}",
            {**accelerations, **watches},
            lambda: scene.mean(list(accelerations.values()), list(watches.values()), plan.side),
            [f"a{i}", f"watch{i}"],
        )
        direct = Calls(self)
        names = {"u": u, "t0": f"t{i}", "a0": f"a{i}", "watch0": f"watch{i}"}
        if kept:
            names |= {"q0": f"q{i}", "v0": f"v{i}"}
        else:
            self._brought(direct, scene, plan, f"q{i}", "placed", f"v{i}")
        self.evaluation(direct, scene, plan, "0", names)
        if not kept:
            self._reached(direct, f"watch{i}")
        calls.made.append([CHOICE, f"zone{i}", limit.made, direct.made])
        calls.made.append(["power", [f"q{i}", f"v{i}", u, "p", f"t{i}"], [f"power{i}"]])

    def _probe(self, calls: Calls, scene: Scene, plan: Plan, i: str, length: str) -> None:
        """Whether a limit has to be taken, from places how far apart; `length` is what their spacing is measured by."""
        q, v = ca.SX.sym("q", self.e.n), ca.SX.sym("v", self.e.n)
        _, _, p, k, dt = self.known.values()
        known = {f"q{i}": q, "p": p, "k": k}
        calls("probe", known, lambda: scene.probed(q), ["here", f"zone{i}", "spacing", "placed"])
        ways = Calls(self)
        known = {"here": ca.SX.sym("here"), f"q{i}": q, f"v{i}": v, length: dt, "p": p, "k": k}
        here = known["here"]
        results = [f"zone{i}", "spacing"]
        ways(f"approach{plan.own}", known, lambda: scene.approached(here, q, v, scene.spacing(plan, v, dt)), results)
        calls.made.append([CHOICE, f"zone{i}", ways.made, []])

    def _reached(self, calls: Calls, watch: str) -> None:
        """Trouble in a watch where the branch does not lead to the place that was found last."""
        known = {watch: ca.SX.sym("watch", len(Watch.FIELDS)), "left": ca.SX.sym("left", 2)}
        seen, left = known.values()
        lost = ca.vertcat(ca.if_else(left[0] <= GROSS**2, 0, math.inf), ca.SX(len(Watch.FIELDS) - 1, 1))
        calls("reached", known, lambda: {"watch": seen + lost}, [watch])

    def _brought(self, calls: Calls, scene: Scene, plan: Plan, place: str, placed: str, velocity: str) -> None:
        """S3: q0 and v0 on the branch: displaced across the motion alone, as the oracle does it, from `placed`, where a
        first correction put the place."""
        n = self.e.n
        _, _, p, k, _ = self.known.values()
        q, v, wanted = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("wanted", n)
        self.place(calls, scene, placed, "q0")
        known = {"q0": q, place: wanted, velocity: v, "p": p, "k": k}
        calls(f"{scene.kind}_return", known, lambda: scene.returned(q, wanted, v), ["q0", "v0"])
        self.place(calls, scene, "q0", "q0")
        self.settle(calls, scene, plan, {"q0": q, "v0": v, "p": p, "k": k}, ["v0", "pivot", "left"])

    def place(self, calls: Calls, scene: Scene, at: str, to: str) -> None:
        _, _, p, k, _ = self.known.values()
        q = ca.SX.sym("q", self.e.n)
        calls(f"{scene.kind}_place", {at: q, "p": p, "k": k}, lambda: {"q": scene.placed(q)}, [to])

    def unsettled(self, calls: Calls, scene: Scene) -> None:
        """Whether q and v do not keep the constraints well enough."""
        q, v, left = ca.SX.sym("q", self.e.n), ca.SX.sym("v", self.e.n), ca.SX.sym("left", 2)
        known = {"left": left, "q": q, "v": v, "k": self.known["k"]}
        calls("unsettled", known, lambda: {"more": 1 - scene.within(left[0], q) * scene.within(left[1], v)}, ["more"])

    def settle(self, calls: Calls, scene: Scene, plan: Plan, known: dict[str, ca.SX], to: list[str]) -> None:
        q, v = list(known.values())[:2]
        names = "v", "pivot", "left"
        calls(
            f"{scene.kind}_settle",
            known,
            lambda: dict(zip(names, scene.settled(q, v, plan.corrections), strict=True)),
            to,
        )

    def evaluation(
        self, calls: Calls, scene: Scene, plan: Plan, i: str, names: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """a, lam (times `scale`), power and watch from t, q, v, each with i in its name, or as `names` has it."""
        e, kind = self.e, scene.kind
        _, u, p, k, _ = self.known.values()
        t, q, v = ca.SX.sym("t"), ca.SX.sym("q", e.n), ca.SX.sym("v", e.n)
        matrices = self.matrices(scene)
        at, qi, vi, acceleration, lami, poweri, watchi = (
            names.get(x + i, x + i) for x in ("t", "q", "v", "a", "lam", "power", "watch")
        )
        known = {at: t, qi: q, vi: v, names.get("u", "u"): u, "p": p, "k": k}
        calls(
            f"{kind}_evaluate",
            known,
            lambda: scene.evaluated(q, v, u, t),
            [*matrices, acceleration, lami, poweri, watchi],
        )
        a, lam, watch = ca.SX.sym("a", e.n), ca.SX.sym("lam", e.l), ca.SX.sym("watch", len(Watch.FIELDS))
        again = {"k": k, **matrices, acceleration: a, lami: lam, watchi: watch}
        more = Calls(self)
        for i in range(plan.iterations - 1):
            (more if plan.branch and i >= _OFTEN - 1 else calls)(
                f"{kind}_iterate",
                again,
                lambda: scene.iterated_again(matrices, a, lam, watch),
                [acceleration, lami, watchi],
            )
        if more.made:
            calls("judge", {"k": k, watchi: watch}, lambda: scene.judged(plan, Watch(watch)), ["more", watchi])
            calls.made.append([CHOICE, "more", more.made, []])

    def matrices(self, scene: Scene) -> dict[str, ca.SX]:
        """Symbols for the nonzeros of what an evaluation hands on."""
        return {name: ca.SX.sym(name, pattern.nnz()) for name, pattern in scene.patterns.items()}


class Calls:
    """The calls of a program; a function that is called the first time is traced."""

    def __init__(self, tracer: Tracer):
        self._tracer = tracer
        self.made: list[list] = []

    def __call__(
        self, name: str, arguments: dict[str, ca.SX], results: Callable[[], dict[str, ca.SX]], outputs: list[str]
    ) -> None:
        functions = self._tracer.functions
        if name not in functions:
            values = [ca.densify(value) for value in results().values()]
            # In a large scene little is left to share, and the search takes longer than all the rest.
            make = shared if self._tracer.e.n <= DENSE else ca.Function
            functions[name] = make(name, list(arguments.values()), values)
        known, sizes = functions[name], [x.numel() for x in arguments.values()]
        if sizes != [known.numel_in(i) for i in range(known.n_in())] or known.n_out() != len(outputs):
            raise ValueError(f"two functions are called {name}")
        self.made.append([name, list(arguments), outputs])


class Watch:
    """What an evaluation says of itself."""

    FIELDS = ("change", "size", "pivot", "near", "margin")
    """Last change of a, and a itself (both squared); smallest pivot of H; whether the margin to a singular position may
    be below `alfmu.method.singular.BRANCH_MARGIN`, and that margin, of which the quick step knows nothing (1)."""

    def __init__(self, vector: ca.SX):
        self.change, self.size, self.pivot, self.near, self.margin = ca.vertsplit(vector)


class Scene:
    """The method with symbols; every part says what tells whether its unrolled loops were enough."""

    def __init__(self, equations: Equations, weighted: bool, p: ca.SX, k: ca.SX):
        self.e, self.p, self.k, self.kind = equations, p, k, "weighted" if weighted else "plain"
        alpha, self.tolerance, *singular = ca.vertsplit(k[:SETTINGS])
        self.freedom, self.masses, self.regular, self.nothing, self.least_distance, *singular = singular
        self.continues, *control = singular
        self.relative, self.absolute = control
        # Equation (4) divided by alpha, so that no product with it is left: M / alpha, F / alpha, lam / alpha.
        self.scale = 1 / alpha
        rows, pivots = SETTINGS + equations.l, SETTINGS + 2 * equations.l
        own = k[SETTINGS:rows] if weighted else ca.SX.ones(equations.l)
        # One penalty for all rows is one unit for all.
        self.inverse_units = k[rows:pivots] if weighted else k[rows]
        self.weights = ca.diag(own)
        ends = pivots + equations.n, pivots + equations.n + len(equations.compliances)
        self.inverse_scales, self.stiffnesses = k[pivots : ends[0]], k[ends[0] : ends[1]]
        self.held = own > 0 if weighted else own
        if equations.brakes:
            self.weights = ca.reshape(k[ends[1] :], equations.l, equations.l)

    @cached_property
    def patterns(self) -> dict[str, ca.Sparsity]:
        """Sparsity of what an evaluation hands on: M, C, F, xi, and the factors of H."""
        x = symbols(self.e)
        M, C, F, xi = self.terms(x["q"], x["v"], x["u"], x["t"])
        D, L, self._order = _factors(self.e, self.augmented_mass(M, C))
        values = {"M": M, "C": C, "F": ca.densify(F), "xi": ca.densify(xi), "D": ca.densify(D), "L": L}
        return {name: value.sparsity() for name, value in values.items()}

    def matrix(self, name: str, nonzeros: dict[str, ca.SX]) -> ca.SX:
        return ca.SX(self.patterns[name], nonzeros[name])

    def terms(self, q: ca.SX, v: ca.SX, u: ca.SX, t: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """M (times `scale`), C, F (times `scale`), xi."""
        M, C, F, xi = self.e.dynamics(q, v, u, self.p, t)
        return self.scale * ca.sparsify(M), ca.sparsify(C), self.scale * F, xi

    def power(self, q: ca.SX, v: ca.SX, u: ca.SX, t: ca.SX) -> ca.SX:
        return self.e.power(q, v, u, self.p, t) if self.e.works else ca.SX(0)

    def evaluated(self, q: ca.SX, v: ca.SX, u: ca.SX, t: ca.SX) -> dict[str, ca.SX]:
        """What an evaluation hands on, with a and lam (times `scale`) after the first iteration."""
        found = self.begun(self.terms(q, v, u, t))
        watch = found.pop("watch")
        return {**found, "power": self.power(q, v, u, t), "watch": watch}

    def begun(self, terms: tuple[ca.SX, ca.SX, ca.SX, ca.SX]) -> dict[str, ca.SX]:
        """The same for given M, C, F, xi, and without power."""
        e, (M, C, F, xi) = self.e, terms
        D, L, order = _factors(self.e, self.augmented_mass(M, C))
        a, lam, _ = self.iterated(terms, (D, L, order), ca.SX(e.n, 1), ca.SX(e.l, 1), 1)
        watch = ca.vertcat(ca.sumsqr(a), ca.sumsqr(a), ca.mmin(D), *self.margin(D, order))
        values = {"M": M, "C": C, "F": ca.densify(F), "xi": ca.densify(xi), "D": ca.densify(D), "L": L}
        return {
            **{name: ca.vec(value.nz[:]) for name, value in values.items()},
            **{"a": a, "lam": lam, "watch": watch},
        }

    def iterated_again(self, nonzeros: dict[str, ca.SX], a: ca.SX, lam: ca.SX, watch: ca.SX) -> dict[str, ca.SX]:
        """a and lam (times `scale`) after one more iteration."""
        M, C, F, xi, D, L = (self.matrix(name, nonzeros) for name in ("M", "C", "F", "xi", "D", "L"))
        a, lam, change = self.iterated((M, C, F, xi), (D, L, self._order), a, lam, 1)
        seen = Watch(watch)
        watch = ca.vertcat(ca.sumsqr(change), ca.sumsqr(a), seen.pivot, seen.near, seen.margin)
        return {"a": a, "lam": lam, "watch": watch}

    def margin(self, pivots: ca.SX, order: list[int]) -> tuple[ca.SX, ca.SX]:
        """S2: whether the margin may be below `alfmu.method.singular.BRANCH_MARGIN`, and the margin."""
        ratios = pivots * self.inverse_scales[order]
        near = self.freedom < ca.sum1(ratios < branch.BRANCH_MARGIN)
        if self.kind == "plain" and not self.e.turns:  # The quick step asks no more than whether it may go on.
            return near, ca.SX(1)
        small, few = ratios < branch.SMALL_PIVOT, self.e.n <= DENSE
        if self.e.turns and few:
            irregular = _product(ratios) < self.regular
            near, small = near * irregular, small * irregular
        more = ca.sum1(small) - self.freedom
        # Of many, the product could leave the range of numbers.
        logarithm = (
            ca.log(_product(ca.if_else(small, ratios, 1))) if few else ca.sum1(ca.if_else(small, ca.log(ratios), 0))
        )
        return near, ca.fmin(ca.if_else(more > 0, ca.exp((logarithm - self.masses) / more), 1), 1)

    def spacing(self, plan: Plan, v: ca.SX, dt: ca.SX) -> ca.SX:
        """S4: distance [s] of places along v; steps of error control may be too short to tell the places apart."""
        spacing = plan.spacing * dt
        if plan.side == Plan.side:
            return spacing
        return ca.fmax(spacing, ca.sqrt(_TOLD * self.nothing) / ca.fmax(ca.mmax(ca.fabs(v)), _TINY))

    def probed(self, q: ca.SX) -> dict[str, ca.SX]:
        """S2: the margin at q, and whether a limit may have to be taken; also q after a correction (10), most of
        which is known then."""
        here = self._margin(q)
        farthest = branch.LIMIT_ZONE * ca.fmax(branch.MOST_DISTANCE, self.least_distance)
        near = 1 - (ca.sqrt(here) >= farthest)
        return {"here": here, "zone": near, "spacing": ca.SX(0), "placed": self.placed(q)}

    def approached(self, here: ca.SX, q: ca.SX, v: ca.SX, spacing: ca.SX) -> dict[str, ca.SX]:
        """S4: whether the limit has to be taken at q of a known margin, and the spacing [s] of the places for it."""
        rate = self._rate(here, q, v, spacing)
        wanted = ca.fmax(ca.fmin(rate, branch.MOST_DISTANCE), self.least_distance)
        zone = ca.sqrt(here) < branch.LIMIT_ZONE * wanted
        # Where the places are too near to tell, the spacing is infinite, and the step is left to the oracle.
        zone = ca.if_else(rate > 0, zone, here <= self.nothing)
        return {"zone": zone, "spacing": spacing * wanted / rate}

    def _rate(self, here: ca.SX, q: ca.SX, v: ca.SX, spacing: ca.SX) -> ca.SX:
        """S2: the distance that one spacing along v covers at q of a known margin; 0 where that cannot be told."""
        before, after = (self._margin(q + k * spacing * v) for k in (-1, 1))
        squared = branch.curvature(before, here, after)
        told = ca.logic_or(here > self.nothing, squared > self.nothing)
        return ca.if_else(told, ca.sqrt(ca.fmax(squared, 0)), 0)

    def _margin(self, q: ca.SX) -> ca.SX:
        """S2: the margin at q."""
        M, C = self.scale * self.e.M(q, self.p), self.e.C(q, self.p)
        D, _, order = _factors(self.e, self.augmented_mass(M, C))
        return self.margin(D, order)[1]

    def places(self, q: ca.SX, v: ca.SX, spacing: ca.SX, side: int) -> dict[str, ca.SX]:
        """S4: the places from which a limit is taken."""
        return {str(k): q + k * spacing * v for k in branch.weights(side)}

    def mean(self, accelerations: list[ca.SX], watches: list[ca.SX], side: int) -> dict[str, ca.SX]:
        """S4: the limit, and the worst of what the evaluations say."""
        a = branch.mean(dict(zip(branch.weights(side), accelerations, strict=True)))
        seen = [Watch(x) for x in watches]
        pivot = ca.mmin(ca.vertcat(*(x.pivot for x in seen)))
        watch = ca.vertcat(sum(x.change for x in seen), sum(x.size for x in seen), pivot, seen[0].near, seen[0].margin)
        return {"a": a, "watch": watch}

    def returned(self, q: ca.SX, wanted: ca.SX, v: ca.SX) -> dict[str, ca.SX]:
        """S3: q displaced along the motion to the place nearest to the wanted one, and the v of that motion."""
        heavy, telling = ca.SX(self.e.n, 1), self.e.telling
        heavy[telling] = branch.INDEPENDENT_MASS / branch.NOISE_FLOOR * self.nothing / self.inverse_scales[telling]
        C, _, solve = self._augmented(q)
        M = self.scale * self.e.M(q, self.p)
        way, d = (branch.tangential(C, self.weights, solve, x) for x in (v, wanted - q))
        q = q + d + way * branch.along(M, heavy, way, wanted - q - d)
        return {"q": q, "v": way + way * branch.along(M, heavy, way, v - way)}

    def iterated(self, terms: tuple, factors: tuple, a: ca.SX, lam: ca.SX, most: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """a and lam after so many iterations, and the last change of a."""
        M, C, F, xi = terms
        changes = []

        def done(change: ca.SX, _: ca.SX) -> bool:
            changes.append(change)
            return False

        a, lam, _, _ = method.residual(M, F, C, xi, self.weights, _solver(*factors), a, lam, most, done)
        return a, lam, changes[-1]

    def stiffness(
        self, q: ca.SX, v: ca.SX, a: ca.SX, lam: ca.SX, u: ca.SX, t: ca.SX, nonzeros: dict[str, ca.SX]
    ) -> tuple[ca.SX, ca.SX, ca.SX]:
        """H, Q, V (times `scale`) of `alfmu.method.implicit.stiffness`, at a and lam (times `scale`)."""
        M, C = (self.matrix(name, nonzeros) for name in ("M", "C"))
        tangents = self.e.tangents(q, v, a, lam / self.scale, u, self.p, t)
        Rq, Rv, Xq, Xv = map(ca.sparsify, tangents[:4])
        return implicit.stiffness(self.augmented_mass(M, C), C, self.weights, self.scale * Rq, self.scale * Rv, Xq, Xv)

    def positions(
        self, rule: Newmark, dt: ca.SX, q: ca.SX, v: ca.SX, a: ca.SX, lam: ca.SX, u: ca.SX, t: ca.SX
    ) -> tuple[ca.SX, ...]:
        """H, Rq, Rv (times `scale`), C (by columns), Phi and the right-hand side of `method.implicit.position_step`.

        At a and lam (times `scale`).
        """
        M, C, F, _ = self.terms(q, v, u, t)
        Phi = self.e.Phi(q, self.p)
        Rq, Rv = (self.scale * ca.sparsify(x) for x in self.e.tangents(q, v, a, lam / self.scale, u, self.p, t)[:2])
        R = F - M @ a - C.T @ lam
        right: list[ca.SX] = []

        def divide(A: ca.SX, b: ca.SX) -> ca.SX:
            right.append(b)
            return b

        implicit.position_step(M, C, Phi, R, Rq, Rv, self.weights, rule, dt, divide)
        return self.augmented_mass(M, C), Rq, Rv, ca.vec(ca.densify(C)), Phi, *right

    def nearest(self, plan: Plan, q: ca.SX, v: ca.SX, u: ca.SX, t: ca.SX, a: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Accelerations that keep the constraints, the nearest to a in the metric of M, and what tells of them."""
        M, C, _, xi = self.terms(q, v, u, t)
        D, L, order = _factors(self.e, self.augmented_mass(M, C))
        zeros = ca.SX(self.e.n, 1), ca.SX(self.e.l, 1)
        found, _, change = self.iterated((M, C, M @ a, xi), (D, L, order), *zeros, plan.iterations)
        watch = ca.vertcat(ca.sumsqr(change), ca.sumsqr(found), ca.mmin(D), *self.margin(D, order))
        return found, watch

    def least(self, nonzeros: dict[str, ca.SX], lam: ca.SX) -> ca.SX:
        """lam of least norm; not finite where the passes were too few, as they are with small penalties."""
        C, D, L = (self.matrix(name, nonzeros) for name in ("C", "D", "L"))
        left: list[ca.SX] = []

        def done(change: ca.SX, value: ca.SX) -> bool:
            left[:] = [1 - (ca.sumsqr(change) <= _LEFT**2 * ca.sumsqr(value))]
            return False

        lam = method.minimum_norm(C, self.weights, _solver(D, L, self._order), lam, 2, done)
        return ca.if_else(left[0], math.nan, lam)

    def least_again(self, nonzeros: dict[str, ca.SX], lam: ca.SX, z: ca.SX) -> dict[str, ca.SX]:
        """One more pass: z, lam by it, and whether another one is needed."""
        C, D, L = (self.matrix(name, nonzeros) for name in ("C", "D", "L"))
        change = method.nearer_norm(C, self.weights, _solver(D, L, self._order), lam, z)
        z = z + change
        more = 1 - (ca.sumsqr(C @ change) <= _LEFT**2 * ca.sumsqr(C @ z))
        return {"z": z, "least": self.weights @ (C @ z), "more": more}

    def distributed(self, nonzeros: dict[str, ca.SX], lam: ca.SX, passes: int = SHARES) -> ca.SX:
        """lam as constraints of the given compliances share it; not finite where the passes were too few."""
        M, C = (self.matrix(name, nonzeros) for name in ("M", "C"))
        stiffness, last = ca.diag(self.stiffnesses), []

        def done(change: ca.SX, value: ca.SX) -> bool:
            last[:] = [ca.sumsqr(stiffness @ change), ca.sumsqr(stiffness @ value)]
            return False

        solve = _solver(*_factors(self.e, method.augmented_mass(M, C, stiffness)))
        lam = method.minimum_norm(C, stiffness, solve, lam, passes, done)
        return ca.if_else(last[0] <= _SHARED**2 * last[1], lam, math.nan)

    def seen(
        self,
        plan: Plan,
        z: ca.SX,
        u: ca.SX,
        a: ca.SX,
        lam: ca.SX,
        C: ca.SX | None = None,
        xi: ca.SX | None = None,
        watch: ca.SX | None = None,
        singular: ca.SX | float = 0.0,
    ) -> ca.SX:
        """What a user can read, monitors, largest |Phi-ddot|, whether a limit has to be read instead, trouble."""
        e, p, layout = self.e, self.p, Layout(self.e)
        q, v, angles, t = z[: e.n], z[e.n : 2 * e.n], z[2 * e.n : layout.work], z[layout.time]
        readings = e.readings(q, v, a, lam / self.scale, u, p, t)
        names = {o.name: i for i, o in enumerate(e.outputs)}
        for name, angle in zip(e.wrapped, ca.vertsplit(self.unwrapped(q, angles)), strict=False):
            readings[names[name]] = angle
        monitors = []
        if set(MONITORED) - set(e.monitors):
            _, _, Phi, Cv = e.constraints(q, v, p)
            margin = Watch(watch).margin if watch is not None else ca.SX(1)
            values = self._largest(Phi), self._largest(Cv), e.energy(q, v, p), plan.iterations, ca.sqrt(margin)
            values = *values, singular
            monitors = [x for name, x in zip(MONITORED, values, strict=True) if name not in e.monitors]
        if watch is None:
            return ca.vertcat(readings, *monitors, 0, 0, 1 - (ca.sumsqr(readings) < math.inf))
        seen, near = Watch(watch), ca.SX(0)
        trouble = self.unconverged(plan, [seen]) + 1 - (seen.pivot > 0)
        if e.l:
            near = self.continues * (1 - (seen.margin > (branch.READ_ZONE * branch.READ_DISTANCE) ** 2))
        return ca.vertcat(readings, *monitors, self._largest(C @ a - xi), near, trouble)

    def read_places(self, q: ca.SX, v: ca.SX, dt: ca.SX) -> dict[str, ca.SX]:
        """S4: the places from which a limit is read; not finite where they cannot be told from the position itself."""
        spacing = branch.SPACING * dt
        spacing *= branch.READ_DISTANCE / self._rate(self._margin(q), q, v, spacing)
        return {str(k): q + k * spacing * v for k in branch.READ_MEAN}

    def limits(self, found: list[ca.SX], watch: ca.SX) -> dict[str, ca.SX]:
        """S4: limits of a and lam from those at the places, whether lam has one (1) or a pole (2), as `with_pole`."""
        count = len(branch.READ_MEAN)
        a, lam, watches = (
            dict(zip(branch.READ_MEAN, found[i * count : (i + 1) * count], strict=True)) for i in range(3)
        )
        near, far = (ca.fabs(lam[k] - lam[-k]) for k in (1, 2))
        largest, steepest = {k: x[0] for k, x in lam.items()}, near[0]
        for i in range(1, self.e.l):
            more = near[i] > steepest
            largest = {k: ca.if_else(more, lam[k][i], x) for k, x in largest.items()}
            steepest = ca.fmax(steepest, near[i])
        inverse = {k: 1 / x for k, x in largest.items()}
        zero = branch.mean(inverse)
        pole = steepest > ca.mmax(far)
        passed = ca.fabs(zero) > branch.POLE_ZERO * ca.mmax(ca.fabs(ca.vertcat(*inverse.values())))
        through = branch.mean({k: x * inverse[k] for k, x in lam.items()}) / zero
        chosen = ca.vertcat(
            *(pole * passed * (n > f) for n, f in zip(ca.vertsplit(near), ca.vertsplit(far), strict=True))
        )
        seen = [Watch(x) for x in watches.values()]
        pivot = ca.mmin(ca.vertcat(*(x.pivot for x in seen)))
        said = ca.vertcat(sum(x.change for x in seen), sum(x.size for x in seen), pivot, 0, Watch(watch).margin)
        return {
            "a": branch.mean(a),
            "lam": ca.if_else(chosen, through, branch.mean(lam)),
            "watch": said,
            "singular": 1 + pole,
        }

    def corrected(self, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """q and v after one correction (10) each, by H and C' of q as it was, which serves both at a regular position;
        the smallest pivot, the residues (squared) of both."""
        C, D, solve = self._augmented(q)
        q = q + method.project(C, self.weights, solve, self.e.Phi(q, self.p))
        after = self.e.C(q, self.p)
        v = v + method.project(C, self.weights, solve, after @ v)
        return q, v, ca.mmin(D), self._residues(q, after @ v)

    def placed(self, q: ca.SX) -> ca.SX:
        """q after a correction (10)."""
        C, _, solve = self._augmented(q)
        return q + method.project(C, self.weights, solve, self.e.Phi(q, self.p))

    def settled(self, q: ca.SX, v: ca.SX, corrections: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """v after corrections (10), the smallest pivot, and the residues (squared) of q and v."""
        C, D, solve = self._augmented(q)
        for _ in range(corrections):
            v = v + method.project(C, self.weights, solve, C @ v)
        return v, ca.mmin(D), self._residues(q, C @ v)

    def error_size(self, z: ca.SX, q: ca.SX, v: ca.SX, error: ca.SX, least: float = 0.0) -> ca.SX:
        """Largest error of the constrained state over the tolerance, or over `least` where that is more."""
        n = self.e.n
        parts = error[:n], error[n : 2 * n]
        if self.e.l:
            C, _, solve = self._augmented(q)
            parts = [branch.tangential(C, self.weights, solve, x) for x in parts]
        allowed = self.allowed(ca.fmax(ca.fabs(z[: 2 * n]), ca.fabs(ca.vertcat(q, v))))
        return ca.mmax(ca.fabs(ca.vertcat(*parts) / (ca.fmax(allowed, least) if least else allowed)))

    def allowed(self, sizes: ca.SX) -> ca.SX:
        """Tolerance of each entry of q and v of given sizes; whole turns make an angle no less exact."""
        larger = ca.vertsplit(sizes)
        for i, c in enumerate(self.e.coordinates):
            if c.unit == "rad":
                larger[i] = ca.fmin(larger[i], 1)
        return self.absolute + self.relative * ca.vertcat(*larger)

    def closed(self, plan: Plan, known: dict[str, ca.SX]) -> ca.SX:
        """The state after the step; its `trouble` counts failed checks, each a comparison that NaN fails."""
        e, layout = self.e, Layout(self.e)
        z, q, v, work = (known[name] for name in ("z", "q", "v", "work"))
        evaluations = [Watch(x) for name, x in known.items() if name.startswith("watch")]
        pivot = ca.mmin(ca.vertcat(*(x.pivot for x in evaluations), known.get("pivot", ca.SX(0, 1))))
        trouble, near = 1 - (pivot > 0) + self.unconverged(plan, evaluations), ca.SX(0)
        if plan.branch:
            near = sum(x for name, x in known.items() if name.startswith("zone"))
            trouble += 1 - self.continues
        elif e.l:
            near = sum(x.margin < branch.BRANCH_MARGIN if plan.margins else x.near for x in evaluations)
            trouble += near if plan.quick and not plan.margins else near * self.continues
            near *= self.continues
        if e.l:
            for residue, x in zip(ca.vertsplit(known["left"]), (q, v), strict=True):
                trouble += 1 - self.within(residue, x)
        else:
            trouble += 1 - (ca.sumsqr(ca.vertcat(q, v)) < math.inf)
        turned = (q - z[: e.n])[[i for i, c in enumerate(e.coordinates) if c.unit == "rad"]]
        trouble += 1 - (ca.sumsqr(turned) <= TURN**2)
        change = known.get("error", sum(x.change for x in evaluations) / (evaluations[0].size + _TINY))
        angles = self.unwrapped(q, z[2 * e.n : layout.work])
        arrival = known["arrival"] if "arrival" in known else z[layout.time] + known["dt"]
        return ca.vertcat(q, v, angles, work, arrival, z[layout.trouble] + trouble, change, pivot, near)

    def within(self, residue: ca.SX, x: ca.SX) -> ca.SX:
        """Whether a residue (squared) of x is within the tolerance, or within round-off."""
        return residue <= ca.fmax(self.tolerance**2, ROUND_OFF**2 * ca.sumsqr(x))

    def unwrapped(self, q: ca.SX, near: ca.SX) -> ca.SX:
        """Computed angles moved by whole turns to the values nearest to `near`."""
        e = self.e
        if not e.wrapped:
            return ca.SX(0, 1)
        s, names = symbols(e), {o.name: i for i, o in enumerate(e.outputs)}
        readings = e.readings(q, s["v"], s["a"], s["lam"], s["u"], self.p, s["t"])
        raw = readings[[names[name] for name in e.wrapped]]
        return raw + 2 * ca.pi * ca.floor((near - raw) / (2 * ca.pi) + 0.5)

    def unconverged(self, plan: Plan, evaluations: list[Watch]) -> ca.SX:
        """Number of checks of the multiplier iteration that fail."""
        if not self.e.l:
            return ca.SX(0)
        change, size = sum(x.change for x in evaluations), evaluations[0].size
        if not plan.quick:
            return 1 - (change <= self.tolerance**2 * sum(x.size for x in evaluations) + _TINY)
        # Each of m iterations gains about the same factor, so a last change of limit^((m - 1) / m) leaves the limit.
        m = plan.iterations
        return 1 - (change <= self.tolerance ** (2 * (m - 1) / m) * size + _TINY)

    def judged(self, plan: Plan, seen: Watch) -> dict[str, ca.SX]:
        """Whether more iterations are needed, and the watch with what one more would change at most where not.

        An iteration gains the margin over that of a singular position at least, which masses make.
        """
        next_change = seen.change * (self.nothing / branch.NOISE_FLOOR / seen.margin) ** 2
        expected = ca.fmin(seen.change, next_change)
        watch = ca.vertcat(expected, seen.size, seen.pivot, seen.near, seen.margin)
        return {"more": self.unconverged(plan, [Watch(watch)]), "watch": watch}

    def _largest(self, residue: ca.SX) -> ca.SX:
        return ca.mmax(ca.fabs(residue * self.held)) if self.e.l else ca.SX(0)

    def _residues(self, q: ca.SX, Cv: ca.SX) -> ca.SX:
        """Sums of squares of Phi and Phi-dot, in units of the rows."""
        return ca.vertcat(self.residue(self.e.Phi(q, self.p)), self.residue(Cv))

    def residue(self, rows: ca.SX) -> ca.SX:
        """Sum of squares of Phi or Phi-dot, in units of the rows."""
        if self.kind == "plain":
            return ca.sumsqr(rows) * self.inverse_units**2
        return ca.sumsqr(rows * self.held * self.inverse_units)

    def _augmented(self, q: ca.SX) -> tuple[ca.SX, ca.SX, method.Solve]:
        """C, the pivots of H (times `scale`), and what solves with it."""
        C = self.e.C(q, self.p)
        D, L, order = _factors(self.e, self.augmented_mass(self.scale * self.e.M(q, self.p), C))
        return C, D, _solver(D, L, order)

    def augmented_mass(self, M: ca.SX, C: ca.SX) -> ca.SX:
        """H (times `scale`), with what is the same at every position left to the parameters alone."""
        H = method.augmented_mass(M, C, self.weights)
        for place, value in self._steady.items():
            H[place] = value
        return H

    @cached_property
    def _steady(self) -> dict[tuple[int, int], ca.SX]:
        """Entries of H that contain q and yet do not depend on it, as the square of a length that turns does not."""
        e, q = self.e, ca.SX.sym("q", self.e.n)
        if e.n > DENSE:
            return {}
        M, C, _, _ = self.terms(q, q, ca.SX.zeros(len(e.inputs)), ca.SX(0))
        H = method.augmented_mass(M, C, self.weights)
        entries = ca.vertcat(*H.nonzeros())
        still = ca.substitute(entries, q, ca.SX.zeros(e.n))
        numbers = ca.Function("entries", [q, self.p, self.k], [entries, still])
        random = np.random.default_rng(0)
        same = np.array(ca.which_depends(entries, q, 1, True))
        for _ in range(_PROBES):
            x, reference = numbers(*(random.uniform(0.5, 2.0, size) for size in map(numbers.nnz_in, range(3))))
            same &= np.isclose(x.full(), reference.full(), _SAME, 0.0).ravel()
        row, column = H.sparsity().get_triplet()
        return {(row[i], column[i]): still[int(i)] for i in np.flatnonzero(same)}


def _product(values: ca.SX) -> ca.SX:
    product = ca.SX(1)
    for each in ca.vertsplit(values):
        product *= each
    return product


def _factors(e: Equations, H: ca.SX) -> tuple[ca.SX, ca.SX, list[int]]:
    """D and L of the LDL' factorisation of H, and the order of the coordinates in it."""
    return *ca.ldl(H[e.order, e.order], False)[:2], e.order


def _solver(D: ca.SX, L: ca.SX, order: list[int]) -> method.Solve:
    """What solves with a sparse LDL' factorisation."""
    return lambda b: ca.ldl_solve(b, D, L, order)
