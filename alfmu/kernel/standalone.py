"""What a scene needs where nothing runs but its C: the oracle's loops as programs, and functions for the start.

The tiers of `alfmu.kernel.trace` stay as they are. After them comes a patient one, whose loops stop on convergence:
`move` and `move_on_branch` lead to the end of a step, `close` brings it back to the constraints, `instant_patient` and
`limit_patient` read. `impact` makes the velocity consistent, `sensitivity` and `limit_sensitivity` derive what is read
by the inputs. Other formulations (`alfmu.kernel.alternatives`) have a `move` and an `instant` of their own, and `keep`
ends a step without projections.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import MappingProxyType

import casadi as ca

from ..equations import Equations
from ..equations.evaluation import with_functions
from ..method import formulations as method
from ..method import singular as branch
from ..method.formulations import CORRECTIONS
from ..method.singular import DOUBLINGS
from .alternatives import OWN, Alternatives, alternatives, classic
from .program import CHOICE, LOOP, Program, called
from .trace import CAREFUL, Calls, Plan, Scene, Watch, _factors

__all__ = ["passed", "standalone"]


def passed(equations: Equations) -> dict[str, int]:
    """What the C runtime hands to programs, and its length: how often the multiplier iteration is repeated at most, and
    where the motion may end; a direction of the inputs; the communication point and the time derivatives of the inputs
    there; iterations of (8) as printed after the first one; zeta and omega; whether steps end with projections; where
    past inputs are kept, whether the communication step under way began before."""
    inputs = len(equations.inputs)
    within = {"within": 1} if "reach" in equations.kernel else {}
    others = {"again": 1, "stabilisation": 2, "projects": 1}
    return {"most": 1, "patient": 1, "du": inputs, "slopes": 1 + inputs, **others, **within}


def standalone(equations: Equations) -> Equations:
    """The same equations, traced, with the programs and functions that a native FMU has beside those of the kernel."""
    e = equations
    tracer = _Patient(e)
    kernel = {name: _extrapolating(tracer, program) for name, program in e.kernel.items() if name not in _APART}
    kernel |= {name: program for name, program in e.kernel.items() if name in _APART}
    if "reach" in kernel:
        kernel["reach"] = {"calls": [[CHOICE, "within", [], kernel["reach"]["calls"]]]}
    if e.l:
        careful = Plan(CAREFUL, 3, weighted=True)
        for name, plan in {"move": careful, "move_on_branch": replace(careful, branch=True)}.items():
            kernel[name] = _extrapolating(tracer, tracer.move(plan))
        kernel["close"] = tracer.close(careful)
        kernel["keep"] = tracer.keep()
        read, redundant = len(e.kernel["instant"]["calls"]) > 1, tracer.redundant
        if read:
            kernel["instant_patient"] = tracer.instant(careful, redundant)
        if "limit" in e.kernel:
            kernel["limit_patient"] = tracer.limit(careful, redundant)
        kernel["impact"] = tracer.impact(careful)
        for name in alternatives(e):
            other = tracer.by(name)
            kernel[f"move_{name}"] = _extrapolating(other, other.move(careful))
            if read:
                kernel[f"instant_{name}"] = other.instant(careful, redundant)
        tracer.pivots(careful)
    if e.inputs and any(v.instant for v in e.outputs):
        plan = Plan(CAREFUL, 3, weighted=e.l > 0)
        kernel["sensitivity"] = tracer.sensitivity(plan)
        if "limit" in e.kernel:
            kernel["limit_sensitivity"] = tracer.limit_sensitivity(plan)
    return replace(with_functions(e, tracer.functions), kernel=kernel)


_APART = ("instant", "limit", "reach")
"""Programs at a communication point."""


def _extrapolating(tracer: _Patient, program: Program) -> Program:
    """A step with inputs that go on from the communication point by their derivatives."""
    return {**program, "calls": tracer.extrapolated(program["calls"])}


class _Patient(Alternatives):
    """Programs with loops that stop on convergence; `most` is a number of the instance."""

    def __init__(self, equations: Equations):
        super().__init__(equations)
        used = {name for program in equations.kernel.values() for name in called(program["calls"])}
        self.functions = {name: equations.functions[name] for name in used}
        self.redundant = any(name in ("least", "distribute") for name in self.functions)

    def move(self, plan: Plan) -> Program:
        """A step of RK4 up to its end, which does not keep the constraints yet."""
        program = self.step(plan)
        names = [call[0] for call in program["calls"]]
        return {**program, "calls": program["calls"][: names.index("sum") + 1]}

    def close(self, plan: Plan) -> Program:
        """S5: q and v after `move`, brought back to the constraints, and the state that they make."""
        e, (_, _, p, k, _) = self.e, self.known.values()
        scene, calls = Scene(e, True, p, k), Calls(self)
        q, v = ca.SX.sym("q", e.n), ca.SX.sym("v", e.n)
        self.place(calls, scene, "q", "q")
        self.settle(calls, scene, plan, {"q": q, "v": v, "p": p, "k": k}, ["v", "pivot", "left"])
        self.unsettled(calls, scene)
        end = self.e.kernel["careful"]["calls"][-1]
        repeated = Calls(self)
        self._repeat(repeated, "more", CORRECTIONS, calls.made)
        return {"calls": [*repeated.made, end]}

    def keep(self) -> Program:
        """The state that q and v after `move` make as they are."""
        calls, end = Calls(self), self.e.kernel["careful"]["calls"][-1]
        nothing = {"pivot": ca.SX(math.inf), "left": ca.SX.zeros(2)}
        calls("unprojected", {"k": self.known["k"]}, lambda: nothing, list(nothing))
        return {"calls": [*calls.made, end]}

    def impact(self, plan: Plan) -> Program:
        """The velocity after constraints came into force, the impulses of all, and the energy that was lost."""
        e, (z, _, p, k, _) = self.e, self.known.values()
        scene, calls = Scene(e, plan.weighted, p, k), Calls(self)
        matrices = self.matrices(scene)
        q, v, nothing = z[: e.n], z[e.n : 2 * e.n], ca.SX(len(e.inputs), 1)

        def begun() -> dict[str, ca.SX]:
            M, C, F, _ = scene.terms(q, v, nothing, ca.SX(0))
            return scene.begun((M, C, 0 * F, -C @ v))

        calls("impact", {"z": z, "p": p, "k": k}, begun, [*matrices, "a0", "lam0", "watch0"])
        self._iterate(calls, scene, plan, ("a0", "lam0", "watch0"))
        if self.redundant:
            self._least(calls, scene, "lam0")
        M, dv, lam = matrices["M"], ca.SX.sym("a", e.n), ca.SX.sym("lam", e.l)

        def end() -> dict[str, ca.SX]:
            lost = dv.T @ scene.matrix("M", matrices) @ dv / 2 / scene.scale
            return {"struck": v + dv, "impulses": -lam / scene.scale, "lost": lost}

        calls("impact_end", {"z": z, "M": M, "a0": dv, "lam0": lam, "k": k}, end, ["struck", "impulses", "lost"])
        return {"calls": calls.made}

    def sensitivity(self, plan: Plan) -> Program:
        """How outputs change with the inputs in the direction `du`: accelerations and multipliers by one more solve."""
        e, layout, (z, _, p, k, _) = self.e, self.layout, self.known.values()
        scene, calls = Scene(e, plan.weighted, p, k), Calls(self)
        unpacked = {"t0": z[layout.time], "q0": z[: e.n], "v0": z[e.n : 2 * e.n], "singular": ca.SX(0)}
        calls("unpack", {"z": z}, lambda: unpacked, list(unpacked))
        self.evaluation(calls, scene, plan, "0")
        self._forced(calls, scene, plan, "t0", "0")
        self._changed(calls, scene, "a0", "lam0", "da0", "dlam0")
        return {"calls": calls.made}

    def limit_sensitivity(self, plan: Plan) -> Program:
        """The same where limits are read: the derivative of the limit by what it is taken from."""
        e, (z, _, p, k, _) = self.e, self.known.values()
        scene, calls, count = Scene(e, plan.weighted, p, k), Calls(self), range(len(branch.READ_MEAN))
        places = [f"place{j}" for j in count]
        sizes = {"a": e.n, "lam": e.l, "watch": len(Watch.FIELDS), "da": e.n, "dlam": e.l}
        found = {name: {f"{name}{j}": ca.SX.sym(name, size) for j in count} for name, size in sizes.items()}
        unpacked = {"tz": z[self.layout.time], "qz": z[: e.n], "vz": z[e.n : 2 * e.n]}
        calls("unpack_limit", {"z": z}, lambda: unpacked, list(unpacked))
        self._read_places(calls, scene, places)
        for j in count:
            self._beside(calls, scene, plan, places[j], str(j))
            self._forced(calls, scene, plan, "tz", str(j))
        self.evaluation(calls, scene, plan, "l", {"tl": "tz", "ql": "qz", "vl": "vz"})
        watch = ca.SX.sym("watch", len(Watch.FIELDS))
        values, changes = ({**found[x], **found[y]} for x, y in (("a", "lam"), ("da", "dlam")))

        def derived() -> dict[str, ca.SX]:
            known = scene.limits([*values.values(), *found["watch"].values()], watch)
            a, lam = known["a"], known["lam"]
            change = ca.jtimes(ca.vertcat(a, lam), ca.vertcat(*values.values()), ca.vertcat(*changes.values()))
            return {"a": a, "lam": lam, "da": change[: e.n], "dlam": change[e.n :]}

        known = {**values, **found["watch"], "watchl": watch, **changes}
        calls("limit_change", known, derived, ["al", "laml", "dal", "dlaml"])
        self._changed(calls, scene, "al", "laml", "dal", "dlaml")
        return {"calls": calls.made}

    def _forced(self, calls: Calls, scene: Scene, plan: Plan, time: str, i: str) -> None:
        """da and dlam (times `scale`), with i in their names, by the forces of `du` at q0, v0; lam of least norm."""
        e, (_, u, p, k, _) = self.e, self.known.values()
        t, q, v, du = (ca.SX.sym(x, size) for x, size in (("t", 1), ("q", e.n), ("v", e.n), ("du", len(e.inputs))))
        names = "F", "xi", f"da{i}", f"dlam{i}", "dwatch"

        def forces() -> dict[str, ca.SX]:
            F = ca.jtimes(scene.terms(q, v, u, t)[2], u, du)
            sizes = e.l, e.n, e.l, len(Watch.FIELDS)
            return dict(zip(names, (F, *(ca.SX(size, 1) for size in sizes)), strict=True))

        if self.redundant:
            self._least(calls, scene, f"lam{i}")
        calls("forced", {time: t, "q0": q, "v0": v, "u": u, "p": p, "k": k, "du": du}, forces, list(names))
        self._iterate(calls, scene, plan, names[2:])
        if self.redundant:
            self._least(calls, scene, f"dlam{i}")

    def _changed(self, calls: Calls, scene: Scene, a: str, lam: str, da: str, dlam: str) -> None:
        """The changes of outputs."""
        e, layout, (z, u, p, k, _) = self.e, self.layout, self.known.values()
        q, v, t, du = z[: e.n], z[e.n : 2 * e.n], z[layout.time], ca.SX.sym("du", len(e.inputs))
        sizes = {a: e.n, lam: e.l, da: e.n, dlam: e.l}
        at = {name: ca.SX.sym(name, size) for name, size in sizes.items()}

        def reading() -> dict[str, ca.SX]:
            y = e.readings(q, v, at[a], at[lam] / scene.scale, u, p, t)
            return {"dy": ca.jtimes(y, ca.vertcat(at[a], at[lam], u), ca.vertcat(at[da], at[dlam], du))}

        calls("sensitivity", {"z": z, "u": u, "p": p, "k": k, "du": du, **at}, reading, ["dy"])

    def pivots(self, plan: Plan) -> None:
        """S1, S2: traces pivots of H over their scales, its diagonal, the weights of C in each column, the margin."""
        e, (_, _, p, k, _) = self.e, self.known.values()
        scene, q = Scene(e, plan.weighted, p, k), ca.SX.sym("q", e.n)
        names = "pivots", "diagonal", "columns", "margin"

        def found() -> dict[str, ca.SX]:
            C = e.C(q, p)
            H = method.augmented_mass(scene.scale * e.M(q, p), C, scene.weights)
            D, _, order = _factors(e, H)
            _, margin = scene.margin(D, order)
            columns = ca.sum1(scene.weights @ ca.fabs(C)).T
            return dict(zip(names, (D * scene.inverse_scales[order], ca.diag(H), columns, margin), strict=True))

        Calls(self)("pivots", {"q": q, "p": p, "k": k}, found, list(names))

    def extrapolated(self, calls: list[list]) -> list[list]:
        """The same calls with inputs at the time of each; of past ones, those that have no derivative."""
        count = len(self.e.inputs)
        if not count:
            return calls
        u, slopes, t, past = self.known["u"], ca.SX.sym("slopes", 1 + count), ca.SX.sym("t"), ca.SX.sym("past", count)
        known, there = {"u": u, "slopes": slopes, "t": t}, u + (t - slopes[0]) * slopes[1:]
        if self.order:
            known, there = {**known, "inputs": past}, ca.if_else(slopes[1:] < ca.inf, there, past)
        Calls(self)("inputs_at", known, lambda: {"inputs": there}, ["inputs"])
        return list(self._moved(calls))

    def _moved(self, calls: list[list]):
        for name, *rest in calls:
            if not isinstance(rest[0], list):
                yield [name, *(list(self._moved(x)) if isinstance(x, list) else x for x in rest)]
                continue
            arguments, results, *sizes = rest
            if name == "inputs":
                yield [name, arguments, results]
                yield ["inputs_at", ["u", "slopes", arguments[1], *results], results]
                continue
            if "u" in arguments:
                time = next(x for x in arguments if x[0] == "t")
                yield ["inputs_at", ["u", "slopes", time], ["inputs"]]
                arguments = ["inputs" if x == "u" else x for x in arguments]
            yield [name, arguments, results, *sizes]

    def _on_branch(self, calls: Calls, scene: Scene, plan: Plan, i: str, u: str, length: str, kept: bool) -> None:
        """S4: where the motion does not reach the places of a limit, accelerations are taken as they are."""
        super()._on_branch(calls, scene, plan, i, u, length, kept)
        watch, last = f"watch{i}", Calls(self)
        seen = ca.SX.sym("watch", len(Watch.FIELDS))
        [*_, [_, _, limit, _], _] = calls.made
        end = Calls(self)
        end("unreached", {watch: seen}, lambda: {"unreached": 1 - (seen[0] < ca.inf)}, ["unreached"])
        self.place(last, scene, f"q{i}", "placed")
        self._brought(last, scene, plan, f"q{i}", "placed", f"v{i}")
        names = {"u": u, "t0": f"t{i}", "a0": f"a{i}", "watch0": watch}
        self.evaluation(last, scene, plan, "0", names, "patient")

        def given_up() -> dict[str, ca.SX]:
            lost = scene.unconverged(plan, [Watch(seen)])
            return {"watch": ca.vertcat(ca.if_else(lost, ca.inf, seen[0]), seen[1:])}

        last("given_up", {"k": self.known["k"], watch: seen}, given_up, [watch])
        self._reached(last, watch)
        limit += [*end.made, [CHOICE, "unreached", last.made, []]]

    def evaluation(
        self,
        calls: Calls,
        scene: Scene,
        plan: Plan,
        i: str,
        names: MappingProxyType = MappingProxyType({}),
        times: str = "most",
    ) -> None:
        super().evaluation(calls, scene, replace(plan, iterations=1), i, names)
        own = {x: names.get(x + i, x + i) for x in ("q", "v", "a", "lam", "watch")}
        if self.formulation == OWN:
            self._iterate(calls, scene, plan, (own["a"], own["lam"], own["watch"]), times)
        elif self.formulation == "classic":
            self._iterate(calls, scene, plan, (own["a"], own["lam"], own["watch"]), "again")
        else:
            self.once(calls, scene, own)

    def _iterate(
        self, calls: Calls, scene: Scene, plan: Plan, names: tuple[str, str, str], times: str = "most"
    ) -> None:
        """The multiplier iteration until it converges."""
        if not self.e.l:
            return
        k, matrices = self.known["k"], self.matrices(scene)
        a, lam, watch = (
            ca.SX.sym(name, size) for name, size in zip("alw", (self.e.n, self.e.l, len(Watch.FIELDS)), strict=True)
        )
        again = Calls(self)
        known = {"k": k, **matrices, **dict(zip(names, (a, lam, watch), strict=True))}
        if self.formulation == OWN:
            again(f"{scene.kind}_iterate", known, lambda: scene.iterated_again(matrices, a, lam, watch), list(names))
        else:
            again("classic_iterate", known, lambda: classic(scene, matrices, a, lam, watch), list(names))
        done = {"k": k, names[2]: watch}
        again("unconverged", done, lambda: {"more": scene.unconverged(plan, [Watch(watch)])}, ["more"])
        self._repeat(calls, "more", times, again.made)

    def _repeat(self, calls: Calls, number: str, times: int | str, again: list[list]) -> None:
        """Calls that are made, and again until a number is zero that they give."""
        calls("begin", {"k": self.known["k"]}, lambda: {"number": ca.SX(1)}, [number])
        calls.made.append([LOOP, number, times, again])

    def _probe(self, calls: Calls, scene: Scene, plan: Plan, i: str, length: str) -> None:
        """With spacings that are doubled until they can tell."""
        near, spacing, stretched, slow = (ca.SX.sym(name) for name in ("zone", "spacing", "dt", "slow"))
        zone = f"zone{i}"
        calls("stretch", {length: stretched}, lambda: {"stretched": stretched}, ["stretched"])
        again = Calls(self)
        super()._probe(again, scene, plan, i, "stretched")

        def longer() -> dict[str, ca.SX]:
            more = ca.logic_and(near, 1 - (spacing < ca.inf))
            return {"stretched": stretched * (1 + more), "slow": more}

        known = {"stretched": stretched, zone: near, "spacing": spacing}
        again("longer", known, longer, ["stretched", "slow"])
        self._repeat(calls, "slow", DOUBLINGS, again.made)
        calls("told", {zone: near, "slow": slow}, lambda: {"zone": near * (1 - slow)}, [zone])

    def _read_places(self, calls: Calls, scene: Scene, places: list[str], dt: str = "dt") -> None:
        """With spacings that are doubled until they can tell."""
        stretched, first = ca.SX.sym("dt"), ca.SX.sym("place", self.e.n)
        calls("stretch", {dt: stretched}, lambda: {"stretched": stretched}, ["stretched"])
        again = Calls(self)
        super()._read_places(again, scene, places, "stretched")

        def longer() -> dict[str, ca.SX]:
            more = 1 - (ca.sumsqr(first) < ca.inf)
            return {"stretched": stretched * (1 + more), "slow": more}

        again("longer_places", {"stretched": stretched, places[0]: first}, longer, ["stretched", "slow"])
        self._repeat(calls, "slow", DOUBLINGS, again.made)

    def _least_by_loop(self, calls: Calls, scene: Scene, name: str) -> None:
        """Multipliers of least norm by passes until they change no more."""
        matrices, lam, z = self.matrices(scene), ca.SX.sym("lam", self.e.l), ca.SX.sym("z", self.e.n)
        some = {each: matrices[each] for each in ("C", "D", "L")}
        calls("least_begin", {"k": self.known["k"]}, lambda: {"z": ca.SX(self.e.n, 1)}, ["least_z"])
        again, known = Calls(self), {"k": self.known["k"], **some, name: lam, "least_z": z}
        again("least_again", known, lambda: scene.least_again(some, lam, z), ["least_z", "least_norm", "more"])
        self._repeat(calls, "more", CORRECTIONS, again.made)
        calls("least_end", {"least_norm": lam}, lambda: {"lam": lam}, [name])

    def _least(self, calls: Calls, scene: Scene, name: str) -> None:
        """By other formulations where steps end with projections, as in the oracle."""
        if self.formulation != OWN:
            made = Calls(self)
            self.by(OWN)._least(made, scene, name)
            calls.made.append([CHOICE, "projects", made.made, []])
            return
        if not self.e.compliances:
            self._least_by_loop(calls, scene, name)
            return
        matrices, lam = self.matrices(scene), ca.SX.sym("lam", self.e.l)
        some = {each: matrices[each] for each in ("M", "C")}
        known = {"k": self.known["k"], **some, name: lam}
        calls("share", known, lambda: {"lam": scene.distributed(some, lam, CORRECTIONS)}, [name])
