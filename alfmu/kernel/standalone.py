"""Programs and functions that a scene needs in C alone: the oracle's loops as programs, and functions for the start.

After the tiers of `alfmu.kernel.trace` comes a patient one, whose loops stop on convergence: `move` and
`move_on_branch` integrate to the end of a step, `close` projects it onto the constraints, `instant_patient` and
`limit_patient` evaluate outputs. `impact` makes the velocity consistent, `sensitivity` and `limit_sensitivity`
differentiate outputs by the inputs. `instant_quick` evaluates outputs by as few iterations as a quick step; `onward` is
a quick step that continues from that evaluation, `short_onward` a short step that does. Other formulations
(`alfmu.kernel.alternatives`) have their own `move` and `instant`, and `keep` ends a step without projections.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from casadi import SX

from ..equations import Equations
from ..equations.evaluation import symbols, with_functions
from ..equations.interface import default_settings, variables_of
from ..method import formulations as method
from ..method import singular as branch
from ..method.formulations import CORRECTIONS
from ..method.singular import DOUBLINGS
from . import rubbing
from .alternatives import OWN, Alternatives, alternatives
from .breaks import breaks
from .form import Call, Choice, Plan, Program, Routine, called, rewritten
from .memory import SEEN
from .symbolic import MATRICES, PATIENT_LOADED, ROUND_OFF, Watch, lengths_of
from .trace import CAREFUL, NO_NAMES, Calls, Tracer, spaced

__all__ = ["READ", "beginning", "passed", "standalone"]


def passed(equations: Equations) -> dict[str, int]:
    """Return the values that the C runtime passes to programs, with their lengths.

    They are: the limit of multiplier iterations, and whether the motion may end; a direction of the inputs; the
    communication point and the time derivatives of the inputs there; the number of iterations of (8) as printed after
    the first; zeta and omega; whether steps end with projections; storage of past inputs, and whether the current
    communication step began before.
    """
    names = ["most", "patient", "du", "slopes", "again", "stabilisation", "projects"]
    names += ["within"] * ("reach" in equations.kernel)
    lengths = lengths_of(equations)
    return {name: lengths[name] for name in names}


def standalone(equations: Equations) -> Equations:
    """Return traced equations with the programs and functions that a native FMU needs beside those of the kernel."""
    e = equations
    tracer = _Patient(e)
    kernel = {name: tracer.extrapolated(program) for name, program in e.kernel.items() if name not in _APART}
    kernel |= {name: program for name, program in e.kernel.items() if name in _APART}
    if tracer.reads_quickly():
        kernel["instant_quick"] = tracer.instant_quick()
        # Power of prescribed motion is not passed on.
        if not (e.timed or tracer.timed()):
            name, step = ("short_onward", "short") if "method" in kernel else ("onward", "quick")
            kernel[name] = tracer.onward(kernel[step])
    if "reach" in kernel:
        kernel["reach"] = Program((Choice("within", zero=kernel["reach"].steps),))
    if e.l:
        careful = Plan(CAREFUL, 3, weighted=True)
        for name, plan in {"move": careful, "move_on_branch": replace(careful, branch=True)}.items():
            kernel[name] = tracer.extrapolated(tracer.move(plan))
        kernel["close"] = tracer.close(careful)
        kernel["keep"] = tracer.keep()
        read, redundant = len(e.kernel["instant"].steps) > 1, tracer.redundant
        if read:
            kernel["instant_patient"] = tracer.instant(careful, redundant)
        if "limit" in e.kernel:
            kernel["limit_patient"] = tracer.limit(careful, redundant)
        kernel["impact"] = tracer.impact(careful)
        if e.frictions:
            kernel["gripping"] = tracer.gripping(careful)
        for name in alternatives(e):
            other = tracer.by(name)
            kernel[f"move_{name}"] = other.extrapolated(other.move(careful))
            if read:
                kernel[f"instant_{name}"] = other.instant(careful, redundant)
        tracer.pivots(careful)
    if e.inputs and any(v.instant for v in e.outputs):
        plan = Plan(CAREFUL, 3, weighted=e.l > 0)
        kernel["sensitivity"] = tracer.sensitivity(plan)
        if "limit" in e.kernel:
            kernel["limit_sensitivity"] = tracer.limit_sensitivity(plan)
    found = breaks(e)
    if found is not None:
        tracer.functions["breaks"] = found[0]
    return replace(with_functions(e, tracer.functions), kernel=kernel, breaks=found[1] if found else [])


def beginning(equations: Equations) -> Equations:
    """Return untraced equations with everything for the start, and no steps.

    Functions that detect singular positions and correct residuals of the assembly are replaced by stand-ins.
    """
    e, tracer, nothing = equations, _Patient(equations), Program((), Plan(CAREFUL, 3))
    kernel = {"quick": nothing, "careful": nothing, "instant": Program((Call("seen", (), ("seen",)),))}
    tracer.functions["seen"] = ca.Function("seen", [], [ca.SX.zeros(len(SEEN) + len(variables_of(e).outputs))])
    if e.l:
        moves = ["move", *(f"move_{name}" for name in alternatives(e))]
        kernel |= dict.fromkeys([*moves, "close", "keep", "impact"], nothing)
        if any(switch.start and switch.holds for switch in e.switches):
            kernel["impact"] = tracer.impact(Plan(CAREFUL, 3, weighted=True))
        q, v, ones = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n), ca.SX.ones(e.n)
        p, k = (ca.SX.sym(name, lengths_of(e)[name]) for name in "pk")
        stand_ins = {
            "pivots": ([q, p, k], [ones, ones, ones, 1]),
            "weighted_place": ([q, p, k], [q]),
            "weighted_return": ([q, ca.SX.sym("wanted", e.n), v, p, k], [q, v]),
            "weighted_settle": ([q, v, p, k], [v, 1, ca.SX.zeros(2)]),
        }
        tracer.functions |= {name: ca.Function(name, *each) for name, each in stand_ins.items()}
    return replace(with_functions(e, tracer.functions), kernel=kernel)


_APART = ("instant", "limit", "reach")
"""Programs at a communication point."""

READ = ("read_a", "read_power", "read_watch")
"""Values that `instant_quick` passes to `onward` and `short_onward`: the first evaluation of a quick or short step at
this instant."""


class _Patient(Alternatives):
    """Programs with loops that stop on convergence; `most` is a number of the instance."""

    def __init__(self, equations: Equations):
        super().__init__(equations)
        used = {name for program in equations.kernel.values() for name in called(program)}
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
        quick, read = e.kernel["quick"].plan, any(x == "a0" for x in _made(e.kernel["instant"]))
        plain = "method" not in e.kernel or default_settings(e).method == "auto"
        plain = plain and not (self.order or e.states or e.frictions)
        return plain and read and bool(quick and quick.quick)

    def timed(self) -> bool:
        """Whether the equations of motion depend explicitly on time."""
        e, x = self.e, symbols(self.e)
        known = x["q"], x["v"], x["u"], x["p"], x["t"]
        terms = ca.vertcat(*(ca.vec(ca.densify(each)) for each in (*e.dynamics(*known), e.power(*known))))
        return any(ca.which_depends(terms, x["t"], 1, True))

    def instant_quick(self) -> Program:
        """Return `instant` by the first evaluation of a quick step, if its iterations converge to round-off; it passes
        READ to `onward`."""
        plan = self.e.kernel["quick"].plan
        calls, careful = Calls(self, plan), Calls(self, replace(plan, weighted=True))

        def told(D: SX, watch: SX) -> SX:
            near, margin = careful.scene.margin(D)
            return Watch.of(watch)._replace(near=near, margin=margin).vector()

        self._unpacked(calls)
        Tracer.evaluation(self, calls, "0")
        calls("handed_on", "a0 power0 watch0", spaced(READ), lambda *x: x)
        careful("margin_told", "k D watch0", "watch0", told)
        calls.made += careful.made
        known = spaced("z u p k C xi a0 lam0 watch0 singular", self.losses)
        if self.redundant:
            Tracer._share(self, calls, "t0 q0 v0 u", "a0 lam0")
        self._lost(calls, "C F lam0 watch0")
        calls("seen_quickly", known, "seen", lambda *x: calls.scene.seen(plan, *x, limit=ROUND_OFF))
        return Program(calls.steps, plan)

    def onward(self, step: Program) -> Program:
        """Return the step from an instant whose outputs were evaluated, with its first evaluation taken from there."""
        first = next(k for k, x in enumerate(step.steps) if "rate1" in x.results)
        given = dict(zip(("a1", "power1", "watch1"), READ, strict=True))
        rest = rewritten(
            step.steps[first:], lambda x: (replace(x, arguments=tuple(given.get(y, y) for y in x.arguments)),)
        )
        begin = [x for x in step.steps[:first] if {"v1", "step"} & set(x.results)]
        return replace(step, steps=(*begin, *rest))

    def close(self, plan: Plan) -> Program:
        """Return S5: projection of q and v after `move` onto the constraints, and the resulting state."""
        calls, again = Calls(self, plan), Calls(self, plan)
        self.place(again, "q", "q")
        self.settle(again)
        self.unsettled(again)
        self.repeat(calls, "more", CORRECTIONS, again)
        return self._ended(calls)

    def keep(self) -> Program:
        """Return the state of q and v after `move` without projection."""
        calls = Calls(self)
        calls("unprojected", "k", "pivot left", lambda: (SX(math.inf), SX.zeros(2)))
        return self._ended(calls)

    def _ended(self, calls: Calls) -> Program:
        """Add the end of a careful step."""
        return Program((*calls.steps, self.e.kernel["careful"].steps[-1]))

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
                return scene.carried(t, q, v, nothing, C, dv, lam, PATIENT_LOADED, impact=True)

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
        u = self.here(calls)
        self.evaluation(calls, "0", {"u": u})
        if self.redundant:
            self._share(calls, f"t0 q0 v0 {u}", "a0 lam0")
        rubbing.told(calls, f"t0 q0 v0 {u}", "a0", "lam0")
        return Program(calls.steps)

    def sensitivity(self, plan: Plan) -> Program:
        """Return changes of outputs along the direction `du` of the inputs: accelerations and multipliers by one more
        solve."""
        calls = Calls(self, plan)
        self._unpacked(calls)
        u = self.here(calls)
        self.evaluation(calls, "0", {"u": u})
        self._forced(calls, "t0", "0", u)
        self._changed(calls, "a0 lam0 da0 dlam0")
        return Program(calls.steps)

    def limit_sensitivity(self, plan: Plan) -> Program:
        """Return these changes where limits are read: the derivative of the limit by the values it is taken from."""
        calls, count = Calls(self, plan), len(branch.READ_MEAN)
        scene = calls.scene
        self._unpacked_limit(calls)
        u = self.here(calls)
        self._read_places(calls, [f"place{j}" for j in range(count)])
        for j in range(count):
            self._beside(calls, f"place{j}", str(j), u)
            self._forced(calls, "tz", str(j), u)
        self.evaluation(calls, "l", {"u": u, "tl": "tz", "ql": "qz", "vl": "vz"})
        calls("here", "qz vz", "q0 v0", lambda q, v: (q, v))
        self._forced(calls, "tz", "l", u)
        sizes = [self.e.n, self.e.l]

        def derived(*known: SX) -> tuple[SX, ...]:
            values, watches = known[: 2 * count], known[2 * count : 3 * count]
            here, changes = known[3 * count : 3 * count + 3], known[3 * count + 3 :]
            found = scene.limits(*values, *watches, *here)[:2]
            change = ca.jtimes(ca.vertcat(*found), ca.vertcat(*values, *here[:2]), ca.vertcat(*changes))
            return *found, *ca.vertsplit(change, np.cumsum([0, *sizes]).tolist())

        values, watches, changes = (
            [f"{name}{j}" for name in names.split() for j in range(count)] for names in ("a lam", "watch", "da dlam")
        )
        known = spaced("k", values, watches, "al laml watchl", changes, "dal dlaml")
        calls("limit_change", known, "al laml dal dlaml", derived)
        self._changed(calls, "al laml dal dlaml")
        return Program(calls.steps)

    def _forced(self, calls: Calls, time: str, i: str, given: str) -> None:
        """Compute da and dlam, with i in their names, due to the forces of `du` at q0, v0; lam with least loads of
        joints.

        `given` is the name of the inputs and the states behind them, which do not change.
        """
        e, scene = self.e, calls.scene

        def forces(t: SX, q: SX, v: SX, u: SX, du: SX) -> tuple[SX, ...]:
            F = ca.jtimes(scene.terms(t, q, v, u)[2], u, ca.vertcat(du, SX(len(e.states), 1)))
            return F, *(SX(size, 1) for size in (e.l, e.n, e.l, len(Watch._fields)))

        def carried(t: SX, q: SX, v: SX, u: SX, du: SX, C: SX, a: SX, lam: SX, da: SX, dlam: SX) -> SX:
            both = scene.carried(t, q, v, u, C, a, lam, PATIENT_LOADED)
            return ca.jtimes(both, ca.vertcat(a, lam, u), ca.vertcat(da, dlam, du, SX(len(e.states), 1)))

        known = f"{time} q0 v0 {given}"
        if self.redundant:
            self._share(calls, known, f"a{i} lam{i}")
        calls("forced", f"{known} p k du", f"F xi da{i} dlam{i} dwatch", forces)
        if e.l:
            self._iterate(calls, f"da{i}", f"dlam{i}", "dwatch")
        else:  # one solution is exact
            self._iterate_once(calls, f"da{i}", f"dlam{i}", "dwatch")
        if self.redundant and self.loaded:
            calls("bear_change", f"{known} p k du C a{i} lam{i} da{i} dlam{i}", f"dlam{i}", carried)
        elif self.redundant:
            self._least(calls, f"dlam{i}")

    def _changed(self, calls: Calls, found: str) -> None:
        """Compute the changes of outputs."""
        e, scene = self.e, calls.scene

        def reading(z: SX, u: SX, du: SX, a: SX, lam: SX, da: SX, dlam: SX) -> SX:
            t, q, v = self._position(z)
            y = e.readings(q, v, a, lam / scene.scale, scene.given(z, u), scene.p, t)
            return ca.jtimes(y, ca.vertcat(a, lam, u), ca.vertcat(da, dlam, du))

        calls("sensitivity", f"z u p k du {found}", "dy", reading)

    def pivots(self, plan: Plan) -> None:
        """S1, S2: trace pivots of H over their scales, its diagonal, the weights of C in each column, the margin."""
        e, calls = self.e, Calls(self, plan)
        scene = calls.scene

        def found(q: SX) -> tuple[SX, ...]:
            C = e.C(q, scene.p)
            H = method.augmented_mass(scene.scale * e.M(q, scene.p), C, scene.weights)
            D, _ = scene.factors(H)
            columns = ca.sum1(scene.weights @ ca.fabs(C)).T
            return D * scene.inverse_scales[e.order], ca.diag(H), columns, scene.margin(D)[1]

        calls("pivots", "q p k", "pivots diagonal columns margin", found)

    def extrapolated(self, program: Program) -> Program:
        """Return the program with inputs extrapolated from the communication point to the time of each call, by their
        derivatives; past inputs only if they have no derivative."""
        if not self.e.inputs:
            return program

        def there(u: SX, slopes: SX, t: SX, past: SX | None = None) -> SX:
            moved = u + (t - slopes[0]) * slopes[1:]
            return moved if past is None else ca.if_else(slopes[1:] < ca.inf, moved, past)

        # This names and traces the function; programs call it where they use inputs.
        Calls(self)("inputs_at", spaced("u slopes t", "inputs" * bool(self.order)), "inputs", there)
        return replace(program, steps=rewritten(program.steps, _inputs_moved))

    # Loops that stop on convergence --------------------------------------------------------------------------------

    def _on_branch(self, calls: Calls, i: str, u: str, length: str, kept: bool) -> None:
        """S4: where the motion does not reach the positions of a limit, accelerations are evaluated directly."""
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
        calls.made[-2] = replace(limit, nonzero=limit.nonzero + end.steps)

    def evaluation(
        self,
        calls: Calls,
        i: str,
        names: Mapping[str, str] = NO_NAMES,
        iterations: int | None = None,
        most: str = "most",
    ) -> None:
        if self.e.frictions and self.formulation == OWN:
            super().evaluation(calls, i, names, 1)
            return
        super().evaluation(calls, i, names, 1)
        own = {x: names.get(x + i, x + i) for x in ("q", "v", "a", "lam", "watch")}
        if self.formulation in (OWN, "classic"):
            self._iterate(calls, own["a"], own["lam"], own["watch"], most if self.formulation == OWN else "again")
        else:
            self.once(calls, own)

    def _iterate(self, calls: Calls, a: str, lam: str, watch: str, most: str = "most") -> None:
        """Repeat the multiplier iteration until it converges."""
        if not self.e.l:
            return
        again, plan = calls.inside(), calls.plan
        (self._iterate_once if self.formulation == OWN else self.classic)(again, a, lam, watch)
        again("unconverged", f"k {watch}", "more", lambda watch: again.scene.unconverged(plan, [Watch.of(watch)]))
        self.repeat(calls, "more", most, again)

    def doubles(self, plan: Plan) -> bool:
        """Return True: no tier follows this one."""
        return True

    def _read_places(self, calls: Calls, places: Sequence[str], length: str = "dt") -> None:
        """Double spacings until the positions are distinguishable."""
        again = calls.inside()
        calls("stretch", length, "stretched", lambda dt: dt)
        super()._read_places(again, places, "stretched")

        def longer(stretched: SX, first: SX) -> tuple[SX, SX]:
            more = 1 - (ca.sumsqr(first) < ca.inf)
            return stretched * (1 + more), more

        again("longer_places", f"stretched {places[0]}", "stretched slow", longer)
        self.repeat(calls, "slow", DOUBLINGS, again)

    def _least(self, calls: Calls, lam: str) -> None:
        """Repeat passes until they converge; for other formulations if steps project."""
        if self.formulation != OWN:
            own = calls.inside()
            self.by(OWN)._least(own, lam)
            calls.choice("projects", own)
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
        if self.formulation != OWN:
            own = calls.inside()
            self.by(OWN)._share(own, known, found)
            calls.choice("projects", own)
            return
        self._settle(calls, found.split()[1])
        self._bear(calls, known, found)


def _made(program: Program) -> Iterator[str]:
    """Yield names of all results of a program without choices."""
    return (name for step in program.steps for name in step.results)


def _inputs_moved(step: Call | Routine) -> Iterator[Call | Routine]:
    """Yield a call with its inputs at its own time; past ones are moved where they are determined."""
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
