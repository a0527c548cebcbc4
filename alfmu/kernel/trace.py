"""Trace the method, RK4 and the projections over a mechanism's equations into flat, sparse functions.

Loops that stop on convergence in the oracle are unrolled a fixed number of times, and each step reports whether they
converged; if not, the caller makes the careful step, then the patient one. Only the needed parts are traced: no
multiplier iteration without constraints, no least-norm pass without redundant rows, no reaction equation without
reaction outputs, no work if nothing does work.

A step is a program (`alfmu.kernel.form`) of small functions: `stage` combines rates into the state of a stage,
`evaluate` and `iterate` contain the method, `place` and `settle` (or `correct`) the projection (10), `close` the
checks. Near singular positions each stage is brought to the branch of the motion by the same functions and by `return`,
and `margin_at` tells where the limit of the accelerations is taken, from `places` before and after, as their weighted
`mean`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from types import MappingProxyType

import casadi as ca
from casadi import SX

from ..equations import Configuration, Equations
from ..equations.evaluation import ARGUMENTS, DENSE, EVALUATED, shared, symbols, with_functions
from ..equations.interface import SOLVED
from ..equations.types import REACTION_ERROR, configured
from ..method import singular as branch
from ..method.formulations import CORRECTIONS
from ..method.inputs import KEPT, extrapolated, reached
from ..method.integrators import rk4
from ..model.making import making
from ..model.settings import Settings
from . import rubbing
from .form import Call, Choice, Loop, Plan, Program, Step, Steps, Traced, called
from .kinks import kinks_of_rates
from .memory import GROSS, TIERS, Layout
from .symbolic import LOADED, MATRICES, PATIENT_LOADED, Scene, Watch, lengths_of

CAREFUL = 5
"""Multiplier iterations of the careful step: enough from the default penalty down to 1e4 masses."""

MOST_GAINS = 25
"""Most multiplier iterations while each gains: at the smallest gain of two thirds they leave 1e-12."""

_OFTEN = 3
"""Multiplier iterations of most evaluations in a step on the branch."""

SHARING = ("share_begin", "share_again", "carry")
"""Functions that share a load for outputs, called one after the other."""

NO_NAMES: Mapping[str, str] = MappingProxyType({})


def traced(
    configuration: Configuration,
    controlled: Callable[[Tracer, Plan], dict[str, Program]] = lambda tracer, plan: {},
) -> Traced:
    """Return the equations with the traced functions and programs of the kernel.

    `controlled` traces the integrator of the scene (`alfmu.kernel.controlled.programs`).
    """
    e = replace(untraced(configuration), survey=configuration.survey)
    survey, mobility = e.survey, e.survey.mobility
    redundant = bool(e.l) and (mobility is None or mobility.redundant > 0 or e.changes)
    careful = Plan(CAREFUL, 3, weighted=True) if e.l else Plan(1, 0)
    quick = careful
    if mobility and e.l and survey.iterations < CAREFUL:
        # A large scene shares the functions of the careful step, which take long to trace and to compile.
        weighted = e.n > DENSE or e.changes or survey.brakes or survey.uneven
        quick = Plan(survey.iterations, 1, quick=True, weighted=weighted)
    tracer = Tracer(e)
    kernel = {"quick": tracer.step(quick), "careful": tracer.step(careful)}
    continues = e.l and e.solver.get("branch", Settings.branch) == Settings.branch
    if continues:
        kernel["branch"] = tracer.step(replace(careful, branch=True))
    kernel |= controlled(tracer, quick)
    kernel["instant"] = tracer.instant(careful, redundant)
    if tracer.order:
        kernel["reach"] = tracer.reach()
    if continues and len(kernel["instant"].steps) > 1:
        kernel["limit"] = tracer.limit(careful, redundant)
    return Traced.of(with_functions(e, tracer.functions), kernel=kernel)


def untraced(equations: Equations) -> Configuration:
    """Return the equations without the functions of the kernel."""
    e = equations
    if not isinstance(e, Traced):
        return configured(e)
    names = {name for program in e.kernel.values() for name in called(program)} - set(EVALUATED)
    functions, signatures = (
        {name: x for name, x in each.items() if name in e.functions and name not in names}
        for each in (e.functions, e.signatures)
    )
    return Configuration.of(e, functions=functions, signatures=signatures, survey=e.survey.elsewhere)


def spaced(*names: str | Sequence[str]) -> str:
    """Join names of values with spaces, as arguments of a call."""
    return " ".join(each if isinstance(each, str) else " ".join(each) for each in names)


class Tracer:
    """Traces programs, and each function that they call once."""

    def __init__(self, equations: Configuration):
        self.e, self.layout = equations, Layout(equations)
        self.functions: dict[str, ca.Function] = {}
        self.shapes: dict[str, tuple[list[int], int]] = {}
        """Lengths of the arguments of each function, and its number of results, as far as requested."""
        self.calls: dict[tuple[str, str, str, str], Call] = {}
        """Calls made before, by penalties, function, arguments and results."""
        self.lengths = lengths_of(equations)
        """Lengths of the values of functions, by name."""
        self.order = int(equations.solver.get("input_order", 0)) if equations.inputs else 0
        self._scenes: dict[bool, Scene] = {}

    def scene(self, weighted: bool) -> Scene:
        """Return the symbolic method, with one penalty for each constraint if `weighted`, otherwise one for all."""
        if weighted not in self._scenes:
            self._scenes[weighted] = Scene(self.e, weighted, self.lengths)
        return self._scenes[weighted]

    # Programs ------------------------------------------------------------------------------------------------------

    def step(self, plan: Plan) -> Program:
        """Return an internal step of RK4 with projection."""
        calls = Calls(self, plan)
        rates = self._moved(calls)
        known = ["z", "dt", "q", "v", "work", *self.states, "p", "k"]
        closing = [*known, *(f"watch{i + 1}" for i in range(len(rates)))]
        if self.e.l:
            (self._projected if plan.corrections > 1 else self.correct)(calls)
            closing += ["pivot", "left"]
        if plan.branch:
            closing += [f"zone{i + 1}" for i in range(len(rates))]
        tier = TIERS[2 if plan.branch else 0 if plan.quick else 1]
        calls(f"{tier}_close", spaced(closing), "after", lambda *_: calls.scene.closed(plan, closing))
        return Program(calls.steps, plan)

    def _moved(self, calls: Calls) -> list[str]:
        """Compute q, v and work after a step of RK4 before projection; return names of the rates."""
        n, layout, rates = self.e.n, self.layout, list[str]()
        z, dt = map(calls.scene.symbol, ("z", "dt"))
        rate = self.rate(calls, "stage", rates)
        y = rk4(rate, z[layout.time], self.begun(z), dt)
        after = y[:n], y[n : 2 * n], *self.parted(y[2 * n :])
        calls("sum", spaced("z dt", rates), spaced("q v work", self.states), lambda *_: after)
        return rates

    @property
    def states(self) -> list[str]:
        """Name of the states, empty if there are none."""
        return ["x"] * bool(self.e.states)

    def begun(self, z: SX) -> SX:
        """Return the integrated values: q, v, work and states."""
        n, layout = self.e.n, self.layout
        return ca.vertcat(z[: 2 * n], z[layout.work : layout.time])

    def parted(self, rest: SX) -> tuple[SX, ...]:
        """Split the integrated values other than q and v into work and states."""
        return (rest[0], rest[1:]) if self.e.states else (rest[0],)

    def correct(self, calls: Calls) -> None:
        """Compute q and v after one correction (10) of both, and its convergence."""
        calls(f"{calls.scene.kind}_correct", "q v p k", "q v pivot left", calls.scene.corrected)

    def _projected(self, calls: Calls) -> None:
        """Project q and v onto the constraints; on the branch by as many corrections as necessary."""
        plan, scene = calls.plan, calls.scene
        self.place(calls, "q", "q")
        more = calls.inside() if plan.branch else calls
        for _ in range(plan.corrections - 1):
            self.place(more, "q", "q")
        if plan.branch:
            calls("open", "q p k", "open", scene.open)
            calls.choice("open", more)
        self.settle_well(calls)

    def reach(self) -> Program:
        """Return the program that records the inputs at a communication point."""
        calls = Calls(self)

        def kept(z: SX, u: SX, past: SX) -> SX:
            known, times, inputs = reached(*self._kept(past), z[self.layout.time], u, ca.if_else)
            found: list[SX] = [known, *times, *inputs]
            return ca.vertcat(*found)

        calls("reach", "z u past", "past", kept)
        return Program(calls.steps)

    def inputs(self, calls: Calls, i: str) -> str:
        """Return the name of the inputs at a stage, held over the communication step or extrapolated to t with i in its
        name, extended by the states of the stage."""
        u = f"u{i}" if self.order else "u"
        if self.order:
            calls("inputs", f"past t{i}", u, lambda past, t: extrapolated(*self._kept(past), t, self.order, ca.if_else))
        if self.e.states:
            # The time argument marks calls that use inputs with derivatives (`alfmu.kernel.standalone`).
            def given(t: SX, u: SX, x: SX) -> SX:
                return ca.vertcat(u, x)

            calls("given", f"t{i} {u} x{i}", f"given{i}", given)
        return self.inputs_name(i)

    def inputs_name(self, i: str) -> str:
        """Return the name of the inputs at a stage, with the states there."""
        return f"given{i}" if self.e.states else f"u{i}" if self.order else "u"

    @cached_property
    def kinks(self) -> ca.Function:
        """Return kinks(t, q, v, u, p): functions that change sign at kinks of the rates of velocities or states."""
        x = symbols(self.e)
        found = kinks_of_rates(self.e, x)
        self.lengths["kinks"] = found.numel()
        return shared("kinks", [x[name] for name in "tqvup"], [found])

    def here(self, calls: Calls) -> str:
        """Return the name of the inputs at a communication point, with the states there."""
        if not self.e.states:
            return "u"
        calls("known", "z u", "known", calls.scene.given)
        return "known"

    def _kept(self, past: SX) -> tuple[SX, list[SX], list[SX]]:
        first = ca.vertsplit(past[: 1 + KEPT])
        return first[0], first[1:], ca.vertsplit(past[1 + KEPT :], len(self.e.inputs))

    def instant(self, plan: Plan, redundant: bool) -> Program:
        """Return the program for outputs, monitors, largest |Phi-ddot|, trouble."""
        e, calls = self.e, Calls(self, plan)
        if not SOLVED - set(e.monitors) and not any(o.instant for o in e.outputs):
            # No output needs accelerations or reactions.
            calls("seen", "z u p k", "seen", lambda z, u: calls.scene.seen_at_rest(plan, z, u))
            return Program(calls.steps, plan)
        self._unpacked(calls)
        u = self.here(calls)
        self.evaluation(calls, "0", {"u": u})
        if redundant:
            self._share(calls, f"t0 q0 v0 {u}", "a0 lam0")
        self._lost(calls, "q0 v0 a0 lam0 watch0")
        self._seen(calls, "a0 lam0 watch0")
        return Program(calls.steps, plan)

    def limit(self, plan: Plan, redundant: bool) -> Program:
        """S4: return `instant` with the limits of accelerations and reactions along the motion."""
        calls, count = Calls(self, plan), range(len(branch.READ_MEAN))
        places = [f"place{j}" for j in count]
        self._unpacked_limit(calls)
        u = self.here(calls)
        self._read_places(calls, places)
        for j in count:
            self._beside(calls, places[j], str(j), u)
            if redundant:
                self._share(calls, f"tz q0 v0 {u}", f"a{j} lam{j}")
        self._here(calls, u, redundant)
        found = [f"{name}{j}" for name in ("a", "lam", "watch") for j in count]
        self._lost(calls, "qz vz al laml watchl")
        known, results = (
            spaced("k", found, "al laml watchl", self.losses, ["noise"] * len(self.losses)),
            spaced("a0 laml watchl singular", self.losses),
        )
        calls("limits", known, results, calls.scene.limits)
        self._seen(calls, "a0 laml watchl")
        return Program(calls.steps, plan)

    def _here(self, calls: Calls, u: str, redundant: bool) -> None:
        """Evaluate at the position of the outputs itself, besides the positions of the limit."""
        self.evaluation(calls, "l", {"u": u, "tl": "tz", "ql": "qz", "vl": "vz"})
        if redundant:
            (self._bear if self.loaded else self._share)(calls, f"tz qz vz {u}", "al laml")

    # Parts of programs ---------------------------------------------------------------------------------------------

    def _unpacked(self, calls: Calls) -> None:
        """Extract time, q and v of the state, for evaluation without limits."""
        calls("unpack", "z", "t0 q0 v0 singular", lambda z: (*self._position(z), SX(0)))

    def _unpacked_limit(self, calls: Calls) -> None:
        """Extract time, q and v of the state, for evaluation with limits."""
        calls("unpack_limit", "z", "tz qz vz", self._position)

    def _position(self, z: SX) -> tuple[SX, SX, SX]:
        """Return time, q and v."""
        n = self.e.n
        return z[self.layout.time], z[:n], z[n : 2 * n]

    def rate(
        self, calls: Calls, name: str, rates: list[str], settled: Sequence[str] = (), length: str = "dt"
    ) -> Callable[[SX, SX], SX]:
        """Return the rate of a state for an integrator, which makes its calls and appends its name to `rates`.

        `settled` are further values on which a stage may depend, `length` is the name of the step.
        """
        n = self.e.n

        def found(t: SX, y: SX) -> SX:
            i = len(rates) + 1
            stage = t, y[:n], y[n : 2 * n], *self.parted(y[2 * n :])[1:]
            results = f"t{i} q{i} v{i}" + f" x{i}" * bool(self.e.states)
            calls(f"{name}{i}", spaced("z", length, rates, settled), results, lambda *_: stage)
            u = self.inputs(calls, str(i))
            self.evaluated(calls, str(i), u, length)
            self._supplied(calls, str(i))
            known = f"v{i} a{i} power{i}"
            if self.e.states:
                calls.made.append(Call("state_rates", (f"q{i}", f"v{i}", u, "p", f"t{i}"), (f"xdot{i}",)))
                known += f" xdot{i}"
            calls("rate", known, f"rate{i}", ca.vertcat)
            rates.append(f"rate{i}")
            return calls.scene.symbol(rates[-1])

        return found

    def evaluated(self, calls: Calls, i: str, u: str, length: str) -> None:
        """Make the calls that an integrator needs for a stage, by the plan; i is part of each name."""
        if calls.plan.branch:
            self._on_branch(calls, i, u, length, i == "1")
        else:
            self.evaluation(calls, i, {"u": u})
            self._supply(calls, i, {"u": u})

    def _beside(self, calls: Calls, place: str, j: str, u: str) -> None:
        """Evaluate at a position from which a limit is taken; j is part of the names of results, u the name of the
        inputs."""
        self.place(calls, place, "placed")
        self._brought(calls, place, "placed", "vz")
        self.evaluation(calls, j, {"u": u, f"t{j}": "tz", f"q{j}": "q0", f"v{j}": "v0"})

    def _read_places(self, calls: Calls, places: Sequence[str]) -> None:
        """Compute the positions from which a limit of outputs is taken."""
        self._direct(calls, "vz")
        self._read_along(calls, places, "dt")

    def _direct(self, calls: Calls, v: str) -> None:
        """Compute the direction along which limits are taken."""
        calls("directed", f"{v} k", "way", calls.scene.directed)

    def _read_along(self, calls: Calls, places: Sequence[str], length: str) -> None:
        """Compute the positions of a limit of outputs along a known direction; `length` is the base of the spacing."""
        scene = calls.scene

        def aside(q: SX, v: SX, dt: SX) -> tuple[SX, ...]:
            spacing = scene.spacing(branch.SPACING, v, dt)
            return spacing, *scene.aside(q, v, spacing)

        calls("read_aside", f"qz way {length} k", "spacing aside1 aside2", aside)
        self._margins(calls, "qz aside1 aside2")
        known = "margin0 margin1 margin2 spacing qz way k"
        calls("read_places", known, spaced(places), scene.read_places)

    def _margins(self, calls: Calls, places: str, first: int = 0) -> None:
        """Compute the margins at positions; their names are numbered from `first`."""
        for i, place in enumerate(places.split(), first):
            calls("margin_at", f"{place} p k", f"margin{i}", calls.scene.margin_at)

    def _least(self, calls: Calls, lam: str) -> None:
        """Replace the last multipliers by those of least norm."""
        if self.e.compliances or self.e.lengths:
            calls("distribute", f"k M C {lam}", lam, calls.scene.distributed)
        else:
            calls("least", f"k C D L {lam}", lam, calls.scene.least)

    def _share(self, calls: Calls, known: str, found: str) -> None:
        """Replace the last multipliers by those with least loads of joints; `known` are names of time, q, v and inputs,
        `found` those of a and lam."""
        if self.loaded:
            self._carry(calls, known, found, "carry", LOADED)
        else:
            self._least(calls, found.split()[1])

    def _bear(self, calls: Calls, known: str, found: str) -> None:
        """Share a load by more passes, which suffice near singular positions."""
        self._carry(calls, known, found, "bear", PATIENT_LOADED)

    def _carry(self, calls: Calls, known: str, found: str, name: str, passes: int) -> None:
        """Share a load by so many passes, of which the last function has a name of its own."""
        scene, lam, shared = calls.scene, found.split()[1], "shared shared_mu"
        calls("share_begin", f"{known} p k C {found}", f"sharing {shared}", scene.sharing_begun)
        for _ in range(passes):
            calls("share_again", f"k C sharing {shared}", f"{shared} shared_last", scene.shared_again)
        end = f"k {lam} sharing shared shared_last"
        calls(name, end, lam, lambda *x: scene.sharing_ended(passes, *x))

    @cached_property
    def loaded(self) -> bool:
        """Whether joints share a load that affects outputs, so that the least norm of all rows differs from that of
        joints."""
        e, x = self.e, symbols(self.e)
        if e.compliances or not (e.changes or e.survey.shared or e.survey.shared is None):
            return False
        slope = e.shares(*(x[letter] for letter in ARGUMENTS["shares"]))
        alike = ca.jacobian(slope[0], x["lam"][0])
        return e.survey.uneven or not ca.simplify(slope - alike * x["lam"]).is_zero()

    @property
    def losses(self) -> list[str]:
        """Name of the error of reactions, if it is an output."""
        return ["lost"] * (bool(self.e.l) and REACTION_ERROR not in self.e.monitors)

    def _lost(self, calls: Calls, found: str) -> None:
        """Compute the error of reactions at the position itself."""
        if self.losses:
            calls("lost", f"p k M C F xi {found}", "lost noise", calls.scene.lost)

    def _seen(self, calls: Calls, found: str) -> None:
        known = spaced(f"z u p k C xi {found} singular", self.losses)
        calls("seen", known, "seen", lambda *x: calls.scene.seen(calls.plan, *x))

    def _on_branch(self, calls: Calls, i: str, u: str, length: str, kept: bool) -> None:
        """S2 to S4: compute a, power, watch of the branch near t, q, v, and whether a limit was taken; i is part of
        each name.

        `u` and `length` are the names of the inputs and of the step; `kept` is true if q and v satisfy the constraints.
        """
        scene, side, own = calls.scene, calls.plan.side, calls.plan.own
        self._probe(calls, i, length)
        count = range(2 * side)
        places, accelerations, watches = (
            [f"{name}{j}" for j in count] for name in ("place", "acceleration", "watched")
        )
        names = {"u": u, "t0": f"t{i}", "a0": f"a{i}", "watch0": f"watch{i}"}
        if kept:
            names |= {"q0": f"q{i}", "v0": f"v{i}"}
        else:
            self.place(calls, f"q{i}", "placed")
            self._brought(calls, f"q{i}", "placed", f"v{i}")
        self.evaluation(calls, "0", names)
        self._supply(calls, "0", names, f"supplied{i}", whole=True)
        if not kept:
            self._reached(calls, f"watch{i}")
        limit = calls.inside()
        limit(f"places{own}", f"q{i} way spacing", spaced(places), lambda *x: scene.places(*x, side=side))
        for place, a, watch in zip(places, accelerations, watches, strict=True):
            self.place(limit, place, "placed")
            self._brought(limit, place, "placed", f"v{i}")
            names = {"u": u, "t0": f"t{i}", "a0": a, "watch0": watch}
            self.evaluation(limit, "0", names)
            self._supply(limit, "0", names, place.replace("place", "supply"), whole=True)
            self._reached(limit, watch)
        known = spaced(f"here a{i} watch{i} zone{i}", accelerations, watches, "k")
        limit(f"mean{own}", known, f"a{i} watch{i} zone{i}", scene.mean)
        if self.supplies:
            known = spaced(f"zone{i} supplied{i}", [f"supply{j}" for j in count])

            def supplied(zone: SX, here: SX, *x: SX) -> SX:
                return ca.if_else(zone, scene.mean_of(x, side), here)

            limit(f"mean_supply{own}", known, f"supplied{i}", supplied)
        calls.choice(f"zone{i}", limit)
        if self.e.frictions and not self.supplies:
            rubbing.power(calls, f"t{i} q{i} v{i} {u}", f"a{i}", f"power{i}")
        else:
            calls.made.append(Call("power", (f"q{i}", f"v{i}", u, "p", f"t{i}"), (f"power{i}",)))

    @property
    def supplies(self) -> bool:
        """Whether the work of prescribed motion counts."""
        return self.e.timed and self.e.works

    def _supply(self, calls: Calls, i: str, names: Mapping[str, str], to: str = "", whole: bool = False) -> None:
        """Compute power of prescribed motion after an evaluation with these names; with `whole`, include friction, if
        the evaluation's own power is not used."""
        if self.supplies:
            scene, rubs = calls.scene, whole and bool(self.e.frictions)
            t, q, v, a, lam = (names.get(x + i, x + i) for x in ("t", "q", "v", "a", "lam"))
            known = f"{t} {q} {v} {a} {lam} {names.get('u', 'u')} p k"
            supply = (lambda *x: rubbing.supply(scene, *x)) if rubs else scene.supply
            calls("rubbing_supply" if rubs else "supply", known, to or f"supplied{i}", supply)

    def _supplied(self, calls: Calls, i: str) -> None:
        """Add the power of prescribed motion to the power of an evaluation."""
        if self.supplies:
            calls("supplied", f"power{i} supplied{i}", f"power{i}", lambda power, supplied: power + supplied)

    def _probe(self, calls: Calls, i: str, length: str) -> None:
        """Compute whether a limit has to be taken, and the spacing of its positions; `length` is the base of the
        spacing."""
        calls("margin_at", f"q{i} p k", "here", calls.scene.margin_at)
        calls("probe", "here k", f"zone{i} spacing", calls.scene.may_be_near)
        if self.doubles(calls.plan):
            self._approach_until_told(calls, i, length)
        else:
            self._direct(calls, f"v{i}")
            self._approach(calls, i, length)

    def doubles(self, plan: Plan) -> bool:
        """Return whether a spacing is doubled until positions are distinguishable; RK4 leaves this to the
        patient tier."""
        return plan.gaining

    def _approach(self, calls: Calls, i: str, length: str) -> None:
        """Compute whether a limit is taken at a position of known margin, and the spacing, along a known direction."""
        scene, plan = calls.scene, calls.plan
        ways = calls.inside()

        def aside(q: SX, v: SX, dt: SX) -> tuple[SX, ...]:
            spacing = scene.spacing(plan.spacing, v, dt)
            return spacing, *scene.aside(q, v, spacing)

        ways(f"aside{plan.own}", f"q{i} way {length} k", "spacing aside1 aside2", aside)
        self._margins(ways, "aside1 aside2", 1)
        ways("approach", "here margin1 margin2 spacing way k", f"zone{i} spacing", scene.approached)
        calls.choice(f"zone{i}", ways)

    def _approach_until_told(self, calls: Calls, i: str, length: str) -> None:
        """Compute the same, with a spacing doubled until positions are distinguishable; the least one counts metres as
        radians."""
        zone, again = f"zone{i}", calls.inside()
        self._approach(again, i, "stretched")

        def longer(stretched: SX, near: SX, spacing: SX) -> tuple[SX, SX]:
            more = ca.logic_and(near, 1 - (spacing < ca.inf))
            return stretched * (1 + more), more

        again("longer", f"stretched {zone} spacing", "stretched slow", longer)
        self._direct(calls, f"v{i}")
        calls("stretch", length, "stretched", lambda dt: dt)
        self.repeat(calls, "slow", branch.DOUBLINGS, again)
        calls("told", f"{zone} slow", zone, lambda near, slow: near * (1 - slow))

    def repeat(self, calls: Calls, number: str, most: int | str, again: Calls) -> None:
        """Make calls that repeat `again` while the named number is not zero."""
        calls("begin", "k", number, lambda: SX(1))
        calls.made.append(Loop(number, most, again.steps))

    def _reached(self, calls: Calls, watch: str) -> None:
        """Mark trouble in a watch if the branch does not lead to the last position."""

        def seen(watch: SX, left: SX) -> SX:
            lost = ca.if_else(left[0] <= GROSS**2, 0, math.inf)
            return watch + ca.vertcat(lost, SX(len(Watch._fields) - 1, 1))

        calls("reached", f"{watch} left0", watch, seen)

    def _brought(self, calls: Calls, place: str, placed: str, velocity: str) -> None:
        """S3: compute q0 and v0 on the branch from `placed`, the position after a first correction, displaced only
        across the motion, as in the oracle."""
        self.place(calls, placed, "q0")
        calls(f"{calls.scene.kind}_return", f"q0 {place} {velocity} p k", "q0 v0", calls.scene.returned)
        self.place(calls, "q0", "q0")
        self.settle(calls, "q0", "v0", "pivot0 left0")

    def place(self, calls: Calls, at: str, to: str) -> None:
        """Compute a position after a correction (10)."""
        calls(f"{calls.scene.kind}_place", f"{at} p k", to, calls.scene.placed)

    def along(self, calls: Calls, dq: str, dv: str) -> None:
        """Project changes of q and v onto the constraints at q."""
        if self.e.l:
            calls(f"{calls.scene.kind}_along", f"q {dq} {dv} p k", f"{dq} {dv}", calls.scene.along)

    def settle(self, calls: Calls, q: str = "q", v: str = "v", results: str = "pivot left") -> None:
        """Compute v after corrections (10), and into `results` the smallest pivot and squared residuals of q, v."""
        corrections, settled = calls.plan.corrections, calls.scene.settled
        calls(f"{calls.scene.kind}_settle", f"{q} {v} p k", f"{v} {results}", lambda q, v: settled(q, v, corrections))

    def settle_well(self, calls: Calls) -> None:
        """Settle q and v at the end of a step; on the branch until converged, as corrections gain little near a
        singular position."""
        if not calls.plan.branch:
            self.settle(calls)
            return
        again = calls.inside()
        self.settle(again)
        self.unsettled(again)
        self.repeat(calls, "more", CORRECTIONS, again)

    def unsettled(self, calls: Calls) -> None:
        """Compute whether q and v violate the constraints beyond the tolerance."""
        calls("unsettled", "left q v k", "more", calls.scene.unsettled)

    def evaluation(
        self, calls: Calls, i: str, names: Mapping[str, str] = NO_NAMES, iterations: int | None = None
    ) -> None:
        """Compute a, lam, power and watch from t, q, v, each with i in its name, or named by `names`."""
        plan, scene = calls.plan, calls.scene
        t, q, v, a, lam, power, watch = (names.get(x + i, x + i) for x in ("t", "q", "v", "a", "lam", "power", "watch"))
        known = spaced(t, q, v, names.get("u", "u"), "p k")
        calls(f"{scene.kind}_evaluate", known, spaced(MATRICES, a, lam, power, watch), scene.evaluated)
        more = calls.inside()
        for k in range((iterations or (1 if self.e.frictions else plan.iterations)) - 1):
            self._iterate_once(more if plan.branch and k >= _OFTEN - 1 else calls, a, lam, watch)
        if more.made:
            calls("judge", f"k {watch}", f"more {watch}", lambda watch: scene.judged(plan, watch))
            calls.choice("more", more)
        if self.e.frictions:
            self.rub(calls, i, names)
        elif plan.gaining and self.e.l:
            again = calls.inside()
            self._iterate_once(again, a, lam, watch)
            again("gaining", f"k {watch} before", "more before", scene.gaining)
            calls("begin_gaining", f"k {watch}", "more before", lambda watch: scene.gaining(watch, SX(math.inf)))
            calls.made.append(Loop("more", MOST_GAINS, again.steps))

    def rub(self, calls: Calls, i: str, names: Mapping[str, str]) -> None:
        """Evaluate with dry friction, whose passes are multiplier iterations, too."""
        t, q, v, u, a, lam, power, watch = (
            names.get(x + i, x + i) if x != "u" else names.get("u", "u")
            for x in ("t", "q", "v", "u", "a", "lam", "power", "watch")
        )
        rubbing.rub(calls, f"{t} {q} {v} {u}", a, lam, power, watch)

    def _iterate_once(self, calls: Calls, a: str, lam: str, watch: str) -> None:
        scene, found = calls.scene, f"{a} {lam} {watch}"
        calls(f"{scene.kind}_iterate", spaced("k", MATRICES, found), found, scene.iterated_again)


class Calls:
    """The steps of a program while it is traced; the first call of a function traces it."""

    def __init__(self, tracer: Tracer, plan: Plan | None = None):
        self._tracer = tracer
        self.plan = plan or Plan(1, 0)
        self.scene = tracer.scene(self.plan.weighted)
        self.made: list[Step] = []

    @property
    def steps(self) -> Steps:
        return tuple(self.made)

    def inside(self) -> Calls:
        """Return empty calls of the same plan."""
        return Calls(self._tracer, self.plan)

    def choice(self, number: str, nonzero: Calls, zero: Calls | None = None) -> None:
        """Add a choice between two lists of calls: the first runs if a number is not zero, the second if it is zero."""
        self.made.append(Choice(number, nonzero.steps, zero.steps if zero else ()))

    def __call__(self, name: str, arguments: str, results: str, function: Callable[..., SX | Sequence[SX]]) -> None:
        """Call the function of this name; arguments and results are names, separated by spaces.

        `function` computes its results from the values of its arguments, except p and k, which are those of the scene.
        """
        known, key = self._tracer.calls, (self.scene.kind, name, arguments, results)
        if key not in known:
            known[key] = self._called(Call(name, tuple(arguments.split()), tuple(results.split())), function)
        self.made.append(known[key])

    def _called(self, call: Call, function: Callable[..., SX | Sequence[SX]]) -> Call:
        """Return the call, once its function is traced and found to fit it."""
        e, functions, scene, name = self._tracer.e, self._tracer.functions, self.scene, call.function
        if name not in functions:
            values = function(*(scene.value(x) for x in call.arguments if x not in ("p", "k")))
            values = [values] if isinstance(values, SX) else values
            making(name)
            # Repeated operations are removed when the function is written or joined, much faster than in symbols.
            dense = [x if isinstance(x, SX) and x.is_dense() else ca.densify(x) for x in values]
            functions[name] = ca.Function(name, [scene.symbol(x) for x in call.arguments], dense)
        if name not in self._tracer.shapes:
            known = functions[name]
            self._tracer.shapes[name] = [known.numel_in(i) for i in range(known.n_in())], known.n_out()
        if ([scene.length(x) for x in call.arguments], len(call.results)) != self._tracer.shapes[name]:
            raise ValueError(f"{e.name}: two functions are called {name}")
        return call
