"""Specialise a scene before it is traced: leave out outputs, freeze parameters, change the start."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError
from ..model.words import some_like, there_is
from .evaluation import ARGUMENTS, Stage, evaluable, shared, symbols, with_functions
from .interface import BALANCE, MONITORS, PEAK, events
from .types import REACTION_ERROR, Configuration, Equations, configured

ALL = "all"
"""Stands for every parameter of the mechanism."""


def specialised(
    equations: Equations, outputs: Iterable[str] | None = None, freeze: Sequence[str] | None = None
) -> Configuration:
    """Return the same equations with only the outputs that match, and with frozen parameters folded in.

    `outputs` are names or patterns such as `link*.angle`; other outputs are not computed. A pattern such as
    `link*.angle/A.torque` requests entries of the interface Jacobian, which no other pattern matches, and their
    outputs; one such as `A.force.peak` requests the largest magnitude of an output, or of a vector of outputs, within
    each communication step; `monitor.reaction_error` must be named. `freeze` names parameters of the mechanism that
    become constants at their defaults, `["all"]` for every one. None leaves out only outputs that must be requested.
    Raises InputError if a pattern matches no output, or a name is no parameter.
    """
    e = configured(equations)
    e = e if freeze is None else _frozen(e, freeze)
    return e if outputs is None else _keeping(e, outputs)


def starting_at(
    equations: Stage,
    q: NDArray[np.float64],
    states: Mapping[str, float] | None = None,
    kept: Sequence[float] | NDArray[np.float64] = (),
) -> Stage:
    """Return the same equations that start at rest at q (n,), with start values and guesses adapted.

    States, by name, start at the given values. With other parameters they start nearby, by the adapted guesses and
    start values. Traced programs stay valid. `kept` are the values of `Equations.held`, which guesses contain if laws
    of time and signals prescribe motion.
    """
    e, x = equations, symbols(equations)
    p = [v.start for v in e.parameters] + (list(kept) or [0.0] * len(e.held))
    s = [float(v.start) for v in e.starts]
    missed = np.array(e.functions["ties"](q, p, s)).ravel()
    for i, way in zip(e.tied, missed, strict=True):
        s[i] += float(way)
    guess, rate = e.functions["guess"], e.functions["guess_rate"]
    arguments = [x["p"], x["s"], x["sdot"]]
    there = ca.densify(guess(x["p"], x["s"]) + (ca.DM(q) - guess(p, s)))
    functions = {
        "guess": shared("guess", arguments[:2], [there]),
        "guesses": shared("guesses", arguments, [there, ca.densify(rate(*arguments))]),
    }
    starts = [replace(v, start=value) for v, value in zip(e.starts, s, strict=True)]
    changed: dict[str, Any] = {"starts": starts, "start_rates": [replace(v, start=0.0) for v in e.start_rates]}
    if states:
        changed["states"] = [replace(v, start=states[v.name]) for v in e.states]
    return with_functions(replace(e, **changed), functions)


def plain(outputs: Iterable[str]) -> list[str]:
    """Return patterns of outputs, with entries of the interface Jacobian replaced by their outputs."""
    return [pattern.partition("/")[0] for pattern in ([outputs] if isinstance(outputs, str) else outputs)]


def without_steps(outputs: Iterable[str]) -> list[str]:
    """Return patterns of outputs, with peaks and entries of the interface Jacobian replaced by their outputs."""
    return [f"{x.removesuffix(PEAK)}*" if x.endswith(PEAK) else x for x in plain(outputs)]


def _entries(e: Equations, pattern: str) -> set[tuple[str, str]]:
    """Return entries of the interface Jacobian that match a pattern such as `link*.angle/A.torque`; none for other
    patterns."""
    output, by, wanted = pattern.partition("/")
    if not by:
        return set()
    outputs, inputs = ([v.name for v in known if v.type == "Real"] for known in (e.outputs, e.inputs))
    for name, known, what in ((output, outputs, "output"), (wanted, inputs, "input")):
        if not any(_matches(each, [name]) for each in known):
            raise InputError(
                f"{e.name} has no {what} {name!r} for the derivative {pattern!r} over a step; {there_is(name, known)}"
            )
    return {(y, u) for y in outputs for u in inputs if _matches(y, [output]) and _matches(u, [wanted])}


def _keeping(equations: Configuration, patterns: Iterable[str]) -> Configuration:
    """Return the same equations with only the outputs and monitors that match a pattern."""
    e = equations
    asked = [patterns] if isinstance(patterns, str) else list(patterns)
    entries, patterns = set().union(*(_entries(e, each) for each in asked)), plain(asked)
    names = [o.name for o in e.outputs]
    left = [name for name in e.monitors if name != REACTION_ERROR or name not in patterns]
    monitors = [m.name for m in (*MONITORS, *events(e)) if m.name not in left]
    peaks = {**e.peaks}
    for pattern in (each.removesuffix(PEAK) for each in patterns if each.endswith(PEAK)):
        peaks |= {name: parts for name, parts in _magnitudes(e).items() if _matches(name, [pattern])}
    monitors += [f"{name}{PEAK}" for name in peaks]
    for pattern in patterns:
        if not any(_matches(name, [pattern]) for name in [*names, *monitors]):
            raise InputError(f"{e.name} has no output {pattern!r}; {some_like(pattern, [*names, *monitors])}")
    needed = {name for parts in peaks.values() for name in parts}
    kept = [i for i, name in enumerate(names) if name in needed or _matches(name, patterns)]
    x = symbols(e)
    arguments = [x[letter] for letter in ARGUMENTS["readings"]]
    readings = shared("readings", arguments, [e.readings(*arguments)[kept]])
    monitors = [name for name in monitors if not _matches(name, patterns)]
    return evaluable(
        _changed(
            e,
            # Only the energy balance needs integrated work.
            works=e.works and bool(BALANCE - {*left, *monitors}),
            outputs=[e.outputs[i] for i in kept],
            wrapped={name: at for name, at in e.wrapped.items() if name in needed or _matches(name, patterns)},
            peaks=peaks,
            monitors=[*left, *monitors],
            jacobian=tuple((y, u.name) for y in names for u in e.inputs if (y, u.name) in entries),
            functions={**{name: e.functions[name] for name in ARGUMENTS if name in e.functions}, "readings": readings},
        )
    )


def _magnitudes(e: Equations) -> dict[str, list[str]]:
    """Return each output, and each vector of outputs, that can have a peak, with its components."""
    found = {v.name: [v.name] for v in e.outputs}
    for name in found.copy():
        base, _, axis = name.rpartition(".")
        if axis in ("x", "y", "z"):
            found.setdefault(base, []).append(name)
    return found


def _frozen(equations: Configuration, names: Sequence[str]) -> Configuration:
    """Return the same equations with parameters folded in; start values and solver variables stay."""
    e = equations
    own = [p.name for p in e.parameters]
    names = own if list(names) == [ALL] else list(names)
    if unknown := [name for name in names if name not in own]:
        raise InputError(f"{e.name} has no parameter {unknown[0]!r} to freeze; {there_is(unknown[0], own)}")
    left = [p for p in e.parameters if p.name not in names]
    x = symbols(replace(e, parameters=left))
    symbol = iter(ca.vertsplit(x["p"]) if x["p"].numel() else ())
    p = ca.vertcat(*(ca.SX(float(p.start)) if p.name in names else next(symbol) for p in e.parameters), *symbol)
    functions = {}
    for name, letters in ((name, x) for name, x in ARGUMENTS.items() if name in e.functions):
        value = e.functions[name](*(p if letter == "p" else x[letter] for letter in letters))
        value = ca.densify(value) if value.is_column() else ca.sparsify(value)
        functions[name] = shared(name, [x[letter] for letter in letters], [value])
    return evaluable(_changed(e, parameters=left, functions=functions))


def _changed(e: Configuration, **changes: Any) -> Configuration:
    """Return a configuration with changes, before it is traced and surveyed."""
    return Configuration.of(e, survey=e.survey.elsewhere, signatures={}, **changes)


def _matches(name: str, patterns: list[str]) -> bool:
    return any(name == pattern or fnmatchcase(name, pattern) for pattern in patterns)
