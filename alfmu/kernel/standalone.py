"""Programs and functions for C only: the oracle's loops as programs, and functions for the start.

A patient tier follows those of `alfmu.kernel.trace`; its loops stop on convergence. `move` makes a step, `close`
projects its end onto the constraints, `instant_patient` and `limit_patient` evaluate outputs, `impact` makes the
velocity consistent. The runtime passes numbers to `move` and `instant_patient` that select a formulation
(`alfmu.kernel.alternatives`) or, near a singular position, the branch of the motion. `instant_quick` evaluates outputs
by the few iterations of a quick step, which can then reuse the evaluation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import casadi as ca
from casadi import SX

from ..equations import Configuration
from ..equations.evaluation import elimination_order, symbols, with_functions
from ..equations.interface import default_settings, variables_of
from ..method import formulations as method
from ..method.formulations import CORRECTIONS
from ..method.singular import DOUBLINGS
from . import rubbing
from .alternatives import CHOSEN, Alternatives, alternatives
from .breaks import breaks
from .form import Call, Choice, Loop, Plan, Program, Routine, Step, Traced, called, renamed, rewritten
from .memory import SEEN
from .symbolic import MATRICES, PATIENT_LOADED, ROUND_OFF, Watch, lengths_of
from .trace import CAREFUL, NO_NAMES, Calls, Tracer, spaced


def passed(equations: Traced) -> dict[str, int]:
    """Return the values that the C runtime passes to programs, with their lengths.

    They are: the limit of multiplier iterations, and whether the motion may end; the communication point and the time
    derivatives of the inputs there; the number of iterations of (8) as printed after the first; zeta and omega; whether
    steps end with projections, and multipliers have least norm; which formulation other than `residual` is selected;
    whether a step follows the branch of the motion, and whether it continues from the evaluated outputs; storage of
    past inputs, and whether the current communication step began before.
    """
    names = ["most", "patient", "slopes", "again", "stabilisation", "projects", "of_least_norm", *CHOSEN.values()]
    names += ["on_branch", "onward"]
    names += ["within"] * ("reach" in equations.kernel)
    lengths = lengths_of(equations)
    return {name: lengths[name] for name in names}


def standalone(equations: Traced) -> Traced:
    """Return traced equations with the programs and functions that a native FMU needs besides those of the kernel."""
    e = equations
    tracer = _Patient(e)
    kernel = {name: tracer.extrapolated(program) for name, program in e.kernel.items() if name not in _APART}
    kernel |= {name: program for name, program in e.kernel.items() if name in _APART}
    if tracer.reads_quickly():
        kernel["instant_quick"] = tracer.instant_quick()
        # Power of prescribed motion is not passed on.
        if not (e.timed or tracer.timed()):
            step = "short" if "method" in kernel else "quick"
            kernel[step] = tracer.onward(kernel[step])
    if "reach" in kernel:
        kernel["reach"] = Program((Choice("within", zero=kernel["reach"].steps),))
    if e.l:
        careful = Plan(CAREFUL, 3, weighted=True)
        chosen, redundant = tracer.of_all(), tracer.redundant
        kernel["move"] = tracer.extrapolated(chosen.move(careful))
        kernel["close"] = tracer.close(careful)
        if len(e.kernel["instant"].steps) > 1:
            kernel["instant_patient"] = chosen.instant(careful, redundant)
        if "limit" in e.kernel:
            kernel["limit_patient"] = tracer.limit(careful, redundant)
        kernel["impact"] = tracer.impact(careful)
        if e.frictions:
            kernel["gripping"] = tracer.extrapolated(tracer.gripping(careful))
        tracer.pivots(careful)
    found = breaks(e)
    if found is not None:
        tracer.functions["breaks"] = found[0]
    return replace(with_functions(e, tracer.functions), kernel=kernel, breaks=found[1] if found else [])


def beginning(equations: Configuration) -> Traced:
    """Return untraced equations with everything for the start, and no steps.

    Functions that detect singular positions and correct residuals of the assembly are replaced by stand-ins.
    """
    e, tracer, nothing = equations, _Patient(equations), Program((), Plan(CAREFUL, 3))
    kernel = {"quick": nothing, "careful": nothing, "instant": Program((Call("seen", (), ("seen",)),))}
    tracer.functions["seen"] = ca.Function("seen", [], [ca.SX.zeros(len(SEEN) + len(variables_of(e).outputs))])
    if e.l:
        kernel |= dict.fromkeys(("move", "close", "impact"), nothing)
        if any(switch.start and switch.holds for switch in e.switches):
            kernel["impact"] = tracer.impact(Plan(CAREFUL, 3, weighted=True))
        q, v, ones = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n), ca.SX.ones(e.n)
        p, k = (ca.SX.sym(name, lengths_of(e)[name]) for name in "pk")
        stand_ins: dict[str, tuple[list[SX], list[SX | float]]] = {
            "pivots": ([q, p, k], [ones, ones, ones, 1]),
            "weighted_place": ([q, p, k], [q]),
            "weighted_return": ([q, ca.SX.sym("wanted", e.n), v, p, k], [q, v]),
            "weighted_settle": ([q, v, p, k], [v, 1, ca.SX.zeros(2)]),
        }
        tracer.functions |= {name: ca.Function(name, *each) for name, each in stand_ins.items()}
    return Traced.of(with_functions(e, tracer.functions), kernel=kernel)


_APART = ("instant", "limit", "reach")
"""Programs that run at a communication point."""

READ = ("read_a", "read_power", "read_watch")
"""Values that `instant_quick` passes to `onward` and `short_onward`: the first evaluation of a quick or short step at
this instant."""


class _Patient(Alternatives):
    """Traces programs with loops that stop on convergence; the instance stores their limit, `most`."""

    def __init__(self, equations: Configuration):
        super().__init__(equations)
        self.kernel: dict[str, Program] = equations.kernel if isinstance(equations, Traced) else {}
        used = {name for program in self.kernel.values() for name in called(program)}
        self.functions, self.shapes = {name: equations.functions[name] for name in used}, {}
        self.redundant = any(name in ("least", "distribute", "carry") for name in self.functions)

    # Programs ------------------------------------------------------------------------------------------------------

    def move(self, plan: Plan) -> Program:
        """Return a step of RK4 up to its end, before projection."""
        calls = Calls(self, plan)
        self._moved(calls)
        return Program(calls.steps, plan)

    def reads_quickly(self) -> bool:
        """Whether outputs at an instant need no more multiplier iterations than a quick step, and RK4 steps can reuse
        this evaluation: without rates of states or dry friction."""
        e = self.e
        quick, read = self.kernel["quick"].plan, any("a0" in _results(x) for x in self.kernel["instant"].steps)
        plain = "method" not in self.kernel or default_settings(e).method == "auto"
        plain = plain and not (self.order or e.states or e.frictions)
        return plain and read and quick.quick

    def timed(self) -> bool:
        """Whether the equations of motion depend explicitly on time."""
        e, x = self.e, symbols(self.e)
        known = x["q"], x["v"], x["u"], x["p"], x["t"]
        terms = ca.vertcat(*(ca.vec(ca.densify(each)) for each in (*e.dynamics(*known), e.power(*known))))
        return any(ca.which_depends(terms, x["t"], 1, True))

    def instant_quick(self) -> Program:
        """Return `instant` by the first evaluation of a quick step, if its iterations converge to round-off; it passes
        READ to `onward`."""
        plan = self.kernel["quick"].plan
        calls, careful = Calls(self, plan), Calls(self, replace(plan, weighted=True))

        def margin_of(D: SX, L: SX, watch: SX) -> SX:
            near, margin = careful.scene.margin(D, L)
            return Watch.of(watch)._replace(near=near, margin=margin).vector()

        self._unpacked(calls)
        Tracer.evaluation(self, calls, "0")
        calls("handed_on", "a0 power0 watch0", spaced(READ), lambda *x: x)
        careful("margin_told", "k D L watch0", "watch0", margin_of)
        calls.made += careful.made
        known = spaced("z u p k C xi a0 lam0 watch0 singular", self.losses)
        if self.redundant:
            Tracer._share(self, calls, "t0 q0 v0 u", "a0 lam0")
        self._lost(calls, "q0 v0 a0 lam0 watch0")
        calls("seen_quickly", known, "seen", lambda *x: calls.scene.seen(plan, *x, limit=ROUND_OFF))
        return Program(calls.steps, plan)

    def onward(self, step: Program) -> Program:
        """Return the step for a start at which outputs were evaluated; READ replaces its first evaluation."""
        first = next(k for k, x in enumerate(step.steps) if "rate1" in _results(x))
        steps = renamed(step.steps, dict(zip(("a1", "power1", "watch1"), READ, strict=True)))
        begin = [x for x in steps[:first] if {"v1", "step"} & {*_results(x)}]
        return replace(step, steps=(Choice("onward", zero=steps[:first]), *begin, *steps[first:]))

    def close(self, plan: Plan) -> Program:
        """S5: return the program that projects the state after `move` onto the constraints if steps project.

        It ends as a careful step does.
        """
        calls, again = Calls(self, plan), Calls(self, plan)
        brought, kept = calls.inside(), calls.inside()
        self.place(again, "q", "q")
        self.settle(again)
        self.unsettled(again)
        self.repeat(brought, "more", CORRECTIONS, again)
        kept("unprojected", "k", "pivot left", lambda: (SX(math.inf), SX.zeros(2)))
        calls.choice("projects", brought, kept)
        return Program((*calls.steps, self.kernel["careful"].steps[-1]))

    def impact(self, plan: Plan) -> Program:
        """Return the velocity after constraints were switched on, their impulses, and the energy lost."""
        e, calls, nothing = self.e, Calls(self, plan), SX(self.e.driven, 1)
        scene = calls.scene

        def begun(z: SX) -> list[SX]:
            _, q, v = self._position(z)
            M, C, F, _ = scene.terms(SX(0), q, v, nothing)
            return scene.begun((M, C, 0 * F, -scene.speed(q, v, C) if e.timed else -C @ v))

        def end(z: SX, M: SX, dv: SX, lam: SX) -> tuple[SX, SX, SX]:
            return z[e.n : 2 * e.n] + dv, -lam / scene.scale, dv.T @ M @ dv / 2 / scene.scale

        calls("impact", "z p k", spaced(MATRICES, "a0 lam0 watch0"), begun)
        self._iterate(calls, "a0", "lam0", "watch0")
        if self.redundant and self.loaded and e.switches:  # Without switches there are no outputs of impulses.

            def shared(z: SX, C: SX, dv: SX, lam: SX) -> SX:
                t, q, v = self._position(z)
                return scene.carried(t, q, v, nothing, C, dv, lam, passes=PATIENT_LOADED, impact=True)

            self._settle(calls, "lam0")
            calls("bear_impact", "z p k C a0 lam0", "lam0", shared)
        elif self.redundant:
            self._least(calls, "lam0")
        calls("impact_end", "z M a0 lam0 k", "struck impulses lost", end)
        return Program(calls.steps)

    def gripping(self, plan: Plan) -> Program:
        """Return the quantities that decide on sticking and sliding of joints with dry friction."""
        calls = Calls(self, plan)
        self._unpacked(calls)
        if self.e.states:
            calls("unpack_states", "z", "x0", lambda z: z[self.layout.states : self.layout.time])
        u = self.inputs(calls, "0")
        self.evaluation(calls, "0", {"u": u})
        if self.redundant:
            self._share(calls, f"t0 q0 v0 {u}", "a0 lam0")
        rubbing.grip(calls, f"t0 q0 v0 {u}", "a0", "lam0")
        return Program(calls.steps)

    def pivots(self, plan: Plan) -> None:
        """S1: trace a function of the pivots of H over their scales, the diagonal of H, the sum of weights of C in each
        column, and the largest mass over its scale; masses that no constraint touches are their own scales."""
        e, calls = self.e, Calls(self, plan)
        scene = calls.scene

        def found(q: SX) -> tuple[SX, ...]:
            C = e.C(q, scene.p)
            M = scene.scale * e.M(q, scene.p)
            H: SX = method.augmented_mass(M, C, scene.weights)
            D, _ = scene.factors(H)
            columns = ca.sum1(scene.weights @ ca.fabs(C)).T
            heaviest = ca.mmax(ca.if_else(columns > 0, ca.diag(M) * scene.inverse_scales, 0))
            return D * scene.inverse_scales[elimination_order(e)], ca.diag(H), columns, heaviest

        calls("pivots", "q p k", "pivots diagonal columns heaviest", found)

    def extrapolated(self, program: Program) -> Program:
        """Return the program with inputs extrapolated from the communication point to the time of each call.

        Inputs are extrapolated by their derivatives; those without derivatives by their past values."""
        if not self.e.inputs:
            return program

        def there(u: SX, slopes: SX, t: SX, past: SX | None = None) -> SX:
            moved = u + (t - slopes[0]) * slopes[1:]
            return moved if past is None else ca.if_else(slopes[1:] < ca.inf, moved, past)

        # This call traces the function; programs then call it by its name before they use inputs.
        Calls(self)("inputs_at", spaced("u slopes t", "inputs" * bool(self.order)), "inputs", there)
        return replace(program, steps=rewritten(program.steps, _inputs_moved))

    # Loops that stop on convergence --------------------------------------------------------------------------------

    def _on_branch(self, calls: Calls, i: str, u: str, length: str, kept: bool) -> None:
        """S4: where the motion does not reach the positions of a limit, evaluate accelerations directly."""
        super()._on_branch(calls, i, u, length, kept)
        watch, scene, plan = f"watch{i}", calls.scene, calls.plan
        end, last = calls.inside(), calls.inside()
        end("unreached", watch, "unreached", lambda watch: 1 - (watch[0] < ca.inf))
        self.place(last, f"q{i}", "placed")
        self._brought(last, f"q{i}", "placed", f"v{i}")
        names = {"u": u, "t0": f"t{i}", "a0": f"a{i}", "watch0": watch}
        self.evaluation(last, "0", names, most="patient")
        self._supply(last, "0", names, f"supplied{i}", whole=True)

        def given_up(watch: SX) -> SX:
            lost = scene.unconverged(plan, [Watch.of(watch)])
            return ca.vertcat(ca.if_else(lost, ca.inf, watch[0]), watch[1:])

        last("given_up", f"k {watch}", watch, given_up)
        self._reached(last, watch)
        end.choice("unreached", last)
        [*_, limit, _] = calls.made
        assert isinstance(limit, Choice)
        calls.made[-2] = replace(limit, nonzero=limit.nonzero + end.steps)

    def evaluation(
        self,
        calls: Calls,
        i: str,
        names: Mapping[str, str] = NO_NAMES,
        iterations: int | None = None,
        most: str = "most",
    ) -> None:
        super().evaluation(calls, i, names, 1)
        if self.e.frictions:
            return
        own = {x: names.get(x + i, x + i) for x in ("q", "v", "a", "lam", "watch")}
        found = calls.inside()
        self._iterate(found, own["a"], own["lam"], own["watch"], most)
        for name in alternatives(self.e) if self.chooses else ():
            found, other = calls.inside(), found
            way = found.inside()
            if name == "classic":
                self._iterate(way, own["a"], own["lam"], own["watch"], "again", self.classic)
            else:
                self.once(way, own, name)
            found.choice(CHOSEN[name], way, other)
        calls.made += found.made

    def evaluated(self, calls: Calls, i: str, u: str, length: str) -> None:
        """If `on_branch` is nonzero, evaluate on the branch of the motion, by `residual` only."""
        if not self.chooses:
            super().evaluated(calls, i, u, length)
            return
        plain, branch = calls.inside(), Calls(self, replace(calls.plan, branch=True))
        super().evaluated(plain, i, u, length)
        self.of_all(False).evaluated(branch, i, u, length)
        calls.choice("on_branch", branch, plain)

    def _iterate(
        self,
        calls: Calls,
        a: str,
        lam: str,
        watch: str,
        most: str = "most",
        once: Callable[[Calls, str, str, str], None] | None = None,
    ) -> None:
        """Repeat the multiplier iteration until it converges; `once` adds the calls of one iteration."""
        if not self.e.l:
            return
        again, plan = calls.inside(), calls.plan
        (once or self._iterate_once)(again, a, lam, watch)
        again("unconverged", f"k {watch}", "more", lambda watch: again.scene.unconverged(plan, [Watch.of(watch)]))
        self.repeat(calls, "more", most, again)

    def doubles(self, plan: Plan) -> bool:
        """Return True, as no tier follows."""
        return True

    def _read_places(self, calls: Calls, places: Sequence[str]) -> None:
        """Double spacings until the positions are distinguishable."""
        again = calls.inside()
        self._read_along(again, places, "stretched")

        def longer(stretched: SX, first: SX) -> tuple[SX, SX]:
            more = 1 - (ca.sumsqr(first) < ca.inf)
            return stretched * (1 + more), more

        again("longer_places", f"stretched {places[0]}", "stretched slow", longer)
        self._direct(calls, "vz")
        calls("stretch", "dt", "stretched", lambda dt: dt)
        self.repeat(calls, "slow", DOUBLINGS, again)

    def _least(self, calls: Calls, lam: str) -> None:
        """Repeat passes until they converge; for other formulations if steps project."""
        if self.chooses:
            own = calls.inside()
            self.of_all(False)._least(own, lam)
            calls.choice("of_least_norm", own)
            return
        scene = calls.scene
        self._settle(calls, lam)
        if self.e.compliances or self.e.lengths:
            share = scene.distributed
            calls("share", f"k M C {lam}", lam, lambda M, C, lam: share(scene.light(M), C, lam, CORRECTIONS))

    def _settle(self, calls: Calls, lam: str) -> None:
        """Compute multipliers of least norm, without the round-off that (8) leaves in unresolved directions."""
        again = calls.inside()
        calls("least_begin", "k", "least_z before", lambda: (SX(self.e.n, 1), SX(math.inf)))
        passed = "least_z least_norm more before"
        again("least_again", f"k C D L {lam} least_z before", passed, calls.scene.least_again)
        self.repeat(calls, "more", method.SETTLING, again)
        calls("least_end", "least_norm", lam, lambda lam: lam)

    def _share(self, calls: Calls, known: str, found: str) -> None:
        """Make more passes, which suffice near singular positions too."""
        if not self.loaded:
            super()._share(calls, known, found)
            return
        if self.chooses:
            own = calls.inside()
            self.of_all(False)._share(own, known, found)
            calls.choice("of_least_norm", own)
            return
        self._settle(calls, found.split()[1])
        self._bear(calls, known, found)


def _results(step: Step) -> tuple[str, ...]:
    """Return names of the results of a step other than a choice or a loop."""
    return () if isinstance(step, Choice | Loop) else step.results


def _inputs_moved(step: Call | Routine) -> Iterator[Call | Routine]:
    """Yield a step whose inputs, extrapolated ones too, follow their slopes to the time of the step."""
    if not isinstance(step, Call):
        yield step
    elif step.function == "inputs":
        yield step
        yield Call("inputs_at", ("u", "slopes", step.arguments[1], *step.results), step.results)
    elif "u" in step.arguments:
        time = next(x for x in step.arguments if x[0] == "t")
        yield Call("inputs_at", ("u", "slopes", time), ("inputs",))
        yield replace(step, arguments=tuple("inputs" if x == "u" else x for x in step.arguments))
    else:
        yield step
