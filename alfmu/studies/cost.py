"""Cost of a scene in operations of its generated functions: by part, and with parts left out added again."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import casadi as ca

from ..equations import Configuration, Equations, Mobility, Variable
from ..equations.evaluation import shared, symbols
from ..equations.interface import MONITORS
from ..equations.specialisation import specialised
from ..equations.types import Survey, configured
from ..fmi import native
from ..kernel.controlled import whole
from ..kernel.form import Plan, Traced, called
from ..kernel.joined import joined
from ..kernel.symbolic import Scene, lengths_of
from ..kernel.trace import traced
from ..simulation import prepared

_FREE = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER)


@dataclass(frozen=True)
class Cost:
    """Operations of an internal step and of one evaluation of the outputs."""

    step: int
    """Operations of the quick step; parts that share operations count these once."""
    parts: dict[str, int]
    """Operations of the step by part: model, factorisation, iterations, integration, projection; checks, without shared
    ones."""
    careful: int
    """Operations of the step used if the quick one does not suffice."""
    outputs: int
    nonzeros: dict[str, int]
    """Structural nonzeros of M, C, H, and of its factor L without the diagonal."""
    iterations: int
    corrections: int


def cost(equations: Traced) -> Cost:
    """Return the operations of a traced scene."""
    e = whole(equations)
    quick = e.kernel["quick"]
    step = _whole(e, "quick")
    evaluation, nonzeros = parts(e, quick.plan)
    model, factored, iterated = (operations(evaluation[name]) for name in ("model", "factorisation", "iterations"))
    stages = list(called(quick)).count("rate")

    def together(names: Callable[[str], bool]) -> int:
        return _together(e, filter(names, called(quick)))

    by_part = {
        "model": stages * model,
        "factorisation": stages * (factored - model),
        "iterations": stages * (iterated - factored),
        "integration": together(lambda name: name == "sum" or name.startswith("stage")),
        "projection": together(lambda name: name.endswith(("_place", "_settle", "_correct"))),
    }
    by_part["checks, minus shared operations"] = step - sum(by_part.values())
    return Cost(
        step=step,
        parts=by_part,
        careful=_whole(e, "careful"),
        outputs=_whole(e, "instant"),
        nonzeros=nonzeros,
        iterations=quick.plan.iterations,
        corrections=quick.plan.corrections,
    )


def parts(equations: Configuration, plan: Plan) -> tuple[dict[str, ca.Function], dict[str, int]]:
    """Return the functions of successive parts of an evaluation, and the structural nonzeros of its matrices.

    The functions give M, C, F, xi; then also the pivots of H; then the accelerations and the power.
    """
    e, x = equations, symbols(equations)
    scene = Scene(e, plan.weighted, lengths_of(e))
    t, q, v, u = (x[letter] for letter in "tqvu")
    terms = scene.terms(t, q, v, u)
    M, C = terms[:2]
    H = scene.augmented_mass(M, C)
    D, L = scene.factors(H)
    a, _, _ = scene.iterated(terms, (D, L), ca.SX(e.n, 1), ca.SX(e.l, 1), plan.iterations)
    results = {"model": terms, "factorisation": [*terms, D, L], "iterations": [a, scene.power(t, q, v, u)]}
    functions = {name: shared(name, [q, v, u, scene.p, t, scene.k], list(x)) for name, x in results.items()}
    return functions, {"M": M.nnz(), "C": C.nnz(), "H": H.nnz(), "L": L.nnz()}


def described(everything: Equations, scene: Equations, mobility: Mobility) -> list[str]:
    """Return the cost of a scene and of its omitted parts as lines of text.

    `everything` is the same mechanism with all outputs and parameters, `mobility` that of both. Each omitted part is
    added alone to measure its cost.
    """
    prepared_scene = whole(prepared(scene))
    now, full = cost(prepared_scene), _with_all_passes(everything, mobility, prepared_scene)
    text = [
        f"operations of a step: {now.step} ({now.iterations} multiplier iterations in each of 4 evaluations, "
        f"{now.corrections} correction{'s' * (now.corrections != 1)} each of q and v)",
        *(f"  {name:24} {count:>8}" for name, count in now.parts.items()),
        f"operations of a careful step: {now.careful}, made if a quick step is not exact enough",
        f"operations of reading the outputs: {now.outputs}",
        "structural nonzeros: " + ", ".join(f"{name} {count}" for name, count in now.nonzeros.items()),
        "",
        "operations for hard cases, not part of the step above (0: not in this scene)",
        *(f"  {what:64} {count:>8}" for what, count in _hard(prepared_scene).items()),
        "",
        f"{'omitted parts, and the operations saved':66} {'step':>8} {'outputs':>8}",
    ]
    lines = left_out(everything, scene, mobility)
    text += [f"  {what:64} {_saved(back, now)}".rstrip() for what, back in lines] or ["  nothing: all of it is needed"]
    text.append(f"  {'in all':64} {_saved(full, now)}")
    text.append(f"  {'the same scene with all parts':64} {full.step:>8} {full.outputs:>8}")
    absent = [native.FEATURES[name].what for name in native.left_out(prepared_scene)]
    return [*text, "", "omitted from the C library of a native FMU", *(f"  {what}" for what in absent or ["nothing"])]


def left_out(everything: Equations, scene: Equations, mobility: Mobility) -> list[tuple[str, Cost | None]]:
    """Return the parts that a scene omits, with the cost if each is added; None if that is impossible."""
    outputs = _missing(everything.outputs, scene.outputs)
    frozen = _missing(everything.parameters, scene.parameters)
    kept, constants = None, None
    absent = configured(scene).monitors
    monitors = [name for name in absent if name not in configured(everything).monitors]
    if outputs or monitors:
        kept = [v.name for v in scene.outputs] + [m.name for m in MONITORS if m.name not in absent]
    if frozen:
        constants = frozen
    lines: list[tuple[str, Cost | None]] = []
    if kept is not None:
        back = cost(prepared(specialised(everything, None, constants)))
        some = "" if any(o.instant for o in scene.outputs) else ", so all accelerations and reactions with them"
        lines.append((f"{len(outputs)} outputs, {len(monitors)} monitors{some}", back))
    if constants is not None:
        back = cost(prepared(specialised(everything, kept, None)))
        lines.append((f"{len(frozen)} parameters, folded into constants", back))
    if scene.l and not mobility.redundant and any(o.instant for o in scene.outputs):
        back = _with_all_passes(scene, mobility, prepared(scene))
        lines.append(("least-norm pass: no constraint is redundant", back))
    if not scene.l:
        lines.append(("multiplier iteration and projection: there are no constraints", None))
    if not scene.works:
        lines.append(("integral of work: nothing does work, or no output needs the energy", None))
    return lines


def _with_all_passes(equations: Equations, mobility: Mobility, like: Traced) -> Cost:
    """Return the cost with one redundant constraint, and the multiplier iterations of a prepared scene."""
    found = Survey(replace(mobility, redundant=1), like.kernel["quick"].plan.iterations)
    return cost(traced(Configuration.of(equations, survey=found)))


def _hard(e: Traced) -> dict[str, int]:
    """Return the operations of programs that only difficult scenes need, by purpose."""
    return {
        "a step near a singular position, on the branch of the motion": _whole(e, "branch")
        if "branch" in e.kernel
        else 0,
        "limits of reactions, read at a singular position": _whole(e, "limit") if "limit" in e.kernel else 0,
        "shares of redundant constraints by their compliances": _of(e, "distribute"),
        "quantities that locks hold, when one is switched on": _of(e, "displacements"),
        "tangents of implicit methods": _of(e, "tangents"),
        "a step by solver.method, its loops passed once": _whole(e, "method") if "method" in e.kernel else 0,
    }


def _of(e: Traced, name: str) -> int:
    return operations(e.functions[name]) if name in e.signatures else 0


def _missing(before: Sequence[Variable], after: Sequence[Variable]) -> list[str]:
    """Return names of variables in `before` that are not in `after`."""
    left = {v.name for v in after}
    return [v.name for v in before if v.name not in left]


def _saved(before: Cost | None, now: Cost) -> str:
    return "" if before is None else f"{before.step - now.step:>8} {before.outputs - now.outputs:>8}"


def operations(function: ca.Function) -> int:
    """Return the arithmetic operations of a function, without copies of inputs and outputs."""
    return sum(function.instruction_id(k) not in _FREE for k in range(function.n_instructions()))


def _whole(e: Traced, program: str) -> int:
    together = joined(e, [program])
    return _together(together, called(together.kernel[program]))


def _together(e: Traced, names: Iterable[str]) -> int:
    """Return the operations of several functions, some of which may be missing."""
    return sum(count * operations(e.functions[name]) for name, count in Counter(names).items())
