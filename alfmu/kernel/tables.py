"""A scene file for the C runtime: tables, functions and programs; headers for constants that both languages share."""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from textwrap import wrap

import numpy as np

from ..equations import Configuration, Equations, Variable
from ..equations.evaluation import DENSE
from ..equations.friction import LIMITED, SHARED
from ..equations.interface import (
    BALANCE,
    CHOICES,
    SOLVER_VARIABLES,
    Interface,
    default_settings,
    events,
    every_event,
    integrator,
    variables_of,
)
from ..method import formulations, friction, implicit, singular, stepping
from ..method.stepping import EXPLICIT5_SHORT, EXPLICIT8, RADAU9, Collocation, Explicit, explicit_rule, share
from ..model.checks import BROKEN, IMPACT, JUMP, JUMPS
from ..model.making import getting_ready
from ..model.motion import COEFFICIENTS
from ..model.settings import FIXED, FORMULATIONS, PROJECTED, UNBALANCED, Settings
from ..model.units import rate_of
from . import VERSION, memory, thresholds
from .alternatives import CHOSEN
from .alternatives import formulations as carried
from .complete import FUNCTIONS, ordered
from .emit import compiled_code
from .exchange import ACCELERATIONS, FADING, obstacle
from .form import Call, Choice, Factor, Lanes, LeastNorm, Loop, Routine, Step, Traced, lifetimes, taken
from .memory import TIERS, Layout
from .passes import Constants
from .places import Heap
from .scene import CALLS, Writer, code
from .standalone import beginning, passed
from .symbolic import ROUND_OFF, Watch
from .trace import CAREFUL

MAGIC = b"ALFMU\r\n\x1a"

HEAD, IDENTITY = 64, 40
"""Number of bytes before the body: MAGIC, version, length, checksum, and the identity."""

REFERENCES = (
    *("step_size", "penalty", "tolerance", "max_iterations", "relative_tolerance", "absolute_tolerance"),
    "input_order",
)
"""Solver variables that the runtime reads."""

FIELDS = ("z", "after", "begin", "u", "p", "k", "dt", "control", "tally", "pace", "past", "seen")
"""Fields of the memory that the runtime reads and writes."""


def _same(names: str) -> dict[str, str]:
    return {name: name for name in names.split()}


HANDED = {
    **_same("most patient slopes within q v struck lost again stabilisation projects of_least_norm on_branch onward"),
    **{name: name for name in CHOSEN.values()},
    "impulse": "impulses",
    **_same(" ".join(f"{name}{i}" for name in ("watch", "q", "v") for i in (1, 2, 3, 4))),
    **_same("watch0 read_watch grip"),
}
"""Values passed between the runtime and programs, by their names in C."""

PROGRAMS = {
    **_same("quick careful instant limit move close impact reach beside"),
    **{"branch_step": "branch", "method_step": "method", "method_careful": "method_careful", "short_step": "short"},
    **{"stiff_step": "stiff", "regular_step": "regular"},
    **_same("short_beside instant_quick instant_patient limit_patient gripping"),
}
"""Programs run by the runtime, by their names in C."""

Number = Callable[["_Table"], float]

COUNTS: dict[str, Number] = {
    "parameters": lambda t: len(t.variables.parameters),
    "choices": lambda t: len(CHOICES),
    "inputs": lambda t: len(t.e.inputs),
    "switches": lambda t: len(t.e.switches),
    "outputs": lambda t: len(t.variables.outputs),
    "own": lambda t: len(t.e.parameters),
    "starts": lambda t: len(t.e.starts),
    "compliances": lambda t: len(t.e.compliances),
    "solver": lambda t: len(SOLVER_VARIABLES),
    "held": lambda t: len(t.e.held),
    "frictions": lambda t: len(t.e.frictions),
    "impulses": lambda t: sum(len(switch.rows) for switch in t.e.switches),
    "event_count": lambda t: len(events(t.e)),
    "n": lambda t: t.e.n,
    "l": lambda t: t.e.l,
    "angles": lambda t: len(t.e.wrapped) + len(t.e.counted),
    "counted": lambda t: len(t.e.counted),
    "readings": lambda t: len(t.e.outputs),
    "ties": lambda t: len(t.e.tied),
    "peaks": lambda t: len(t.e.peaks),
    "break_count": lambda t: len(t.e.breaks),
}
"""Counts of a scene, each checked when it is loaded."""

_WATCHED = {
    **{"position": "position_error", "velocity": "velocity_error", "energy": "energy"},
    **{"iterations": "iterations", "step_error": "step_error"},
}
"""Monitors whose largest values an instance records, and those that it computes itself: iterations of loops that stop
on convergence, and the error of a step."""

NUMBERS: dict[str, Number] = {
    **COUNTS,
    **{name: partial(lambda name, t: t.causal(f"solver.{name}"), name) for name in REFERENCES},
    "formulation": lambda t: list(CHOICES).index("solver.formulation"),
    "branch": lambda t: list(CHOICES).index("solver.branch"),
    "continues": lambda t: list(t.known["solver.branch"]).index("continue"),
    "method_choice": lambda t: list(CHOICES).index("solver.method"),
    "freedom": lambda t: t.e.survey.mobility.freedom if t.e.survey.mobility else -1,
    "brakes": lambda t: t.e.survey.brakes,
    "weighted": lambda t: t.e.kernel["quick"].plan.weighted,
    "balances": lambda t: bool(BALANCE - set(t.e.monitors)),
    "same_tiers": lambda t: t.e.kernel["quick"] == t.e.kernel["careful"],
    "careful_iterations": lambda t: CAREFUL if t.e.l else 1,
    **{f"monitor_{name}": partial(lambda key, t: t.output(f"monitor.{key}"), key) for name, key in _WATCHED.items()},
    "method": lambda t: 1 + (t.method in FIXED) if t.rule else 0,
    "rk4_choice": lambda t: list(t.known["solver.method"]).index("rk4") if "rk4" in t.known["solver.method"] else -1,
    "automatic": lambda t: default_settings(t.e).method == "auto",
    "reuses": lambda t: any(
        "onward" in taken(t.e.kernel[name].steps) for name in ("quick", "short") if name in t.e.kernel
    ),
    "implicit": lambda t: bool(t.rule) and t.e.kernel["method"].nodes > 0,
    "method_cost": lambda t: t.cost("method"),
    "short_cost": lambda t: t.cost("short"),
    **{name: partial(lambda name, t: t.layout.fields[name][0], name) for name in FIELDS},
    "past_size": lambda t: t.layout.fields["past"][1],
    "seen_size": lambda t: t.layout.fields["seen"][1],
    **{
        name: partial(lambda name, t: getattr(t.layout, name), name)
        for name in ("time", "work", "trouble", "change", "near")
    },
    "size": lambda t: t.layout.size,
    "exchange": lambda t: t.places[ACCELERATIONS][0] if ACCELERATIONS in t.places and not obstacle(t.e) else -1,
    # Values that no program passes on share the start of the workspace, which must be long enough for them.
    "workspace": lambda t: max(
        t.workspace,
        t.e.n + t.e.l + len(t.e.outputs) + len(t.e.inputs) + len(Watch._fields) + 1,
        3 * len(t.e.frictions) + 2,
    ),
    **{name: partial(lambda key, t: t.places.get(key, (0, 0))[0], key) for name, key in HANDED.items()},
    **{name: partial(lambda key, t: t.number.get(key, -1), key) for name, key in FUNCTIONS.items()},
    **{name: partial(lambda key, t: t.program.get(key, -1), key) for name, key in PROGRAMS.items()},
}
"""Numbers of a scene that the runtime reads by name."""

REALS: dict[str, Number] = {
    "no_slope": lambda t: math.inf if "reach" in t.e.kernel else 0.0,
    "fading": lambda t: FADING / t.e.interval,
    "farthest": lambda t: t.e.reach,
    "share": lambda t: t.share[0],
    "exponent": lambda t: t.share[1],
    "short_share": lambda t: share(EXPLICIT5_SHORT)[0],
    "short_exponent": lambda t: share(EXPLICIT5_SHORT)[1],
    "stiff_share": lambda t: share(RADAU9)[0],
    "stiff_exponent": lambda t: share(RADAU9)[1],
    "beside_share": lambda t: share(EXPLICIT8)[0],
    "beside_exponent": lambda t: share(EXPLICIT8)[1],
}

NODE_COST = 6
"""Evaluations equivalent to a node of an implicit step, with its tangents and iterations of Newton's method."""


def interface(equations: Equations) -> Interface:
    """Return the variables of a scene, which has one order of inputs."""
    found = variables_of(equations)

    def narrowed(v: Variable) -> Variable:
        if v.name not in _FIXED or isinstance(v.start, str):
            return v
        return replace(v, minimum=v.start, maximum=v.start)

    return replace(found, parameters=[narrowed(v) for v in found.parameters])


_FIXED = ("solver.input_order",)
"""Solver variables fixed by tracing."""


def known_choices(equations: Equations) -> dict[str, dict[str, str]]:
    """Return the values of text variables that a scene supports, with descriptions; `auto` also runs RK4."""
    methods = {"auto": ["rk4", "auto"]}
    method = default_settings(equations).method
    carries = {"solver.formulation": carried(equations), "solver.method": methods.get(method, [method])}
    return {
        name: {each: text for each, text in known.items() if each in carries.get(name, known)}
        for name, known in CHOICES.items()
    }


def layout_header() -> str:
    """Return layout.h: the numbers of a scene by name, and constants, shared by the C runtime and Python."""
    found = {
        "SCENE_VERSION": VERSION,
        "GROSS": memory.GROSS,
        "TURN": memory.TURN,
        "CORRECTIONS": formulations.CORRECTIONS,
        "NOISE_FLOOR": singular.NOISE_FLOOR,
        "LEAST_DISTANCE": singular.LEAST_DISTANCE,
        "BRANCH_MARGIN": singular.BRANCH_MARGIN,
        "SMALL_PIVOT": singular.SMALL_PIVOT,
        "REGULAR_PRODUCT": singular.REGULAR_PRODUCT,
        "CONVERGENCE": singular.CONVERGENCE,
        "FROZEN": singular.FROZEN,
        "QUARTER": math.pi / 2,
        "DENSE": DENSE,
        "TIERS": len(TIERS),
        "CHOICES": len(CHOICES),
        "FORMULATIONS": len(FORMULATIONS),
        **{f"{name.upper()}_FORMULATION": i for i, name in enumerate(FORMULATIONS)},
        "PROJECTED": tuple(int(name in PROJECTED) for name in FORMULATIONS),
        "ZETA": Settings.zeta,
        "OMEGA": Settings.omega,
        "LEAST_BEFORE": stepping.LEAST_BEFORE,
        "GIVEN_UP": stepping.SHORTEST,
        "STEADY": stepping.STEADY,
        "LOOSER": stepping.LOOSER,
        "NOISE": stepping.NOISE,
        "UNBALANCED": UNBALANCED,
        "ROUND_OFF": ROUND_OFF,
        "POLYNOMIAL": 1 + COEFFICIENTS,
        "LIMITED": LIMITED,
        "SHARED": SHARED,
        "JAM_PIVOT": friction.JAM_PIVOT,
        "JAM_SETTLED": friction.JAM_SETTLED,
        "JUMP": JUMP,
        "JUMPS": f'"{JUMPS}"',
        "BROKEN": f'"{BROKEN}"',
        "IMPACT": f'"{IMPACT}"',
    }
    found |= {name: value for name, value in vars(thresholds).items() if name.isupper()}
    found |= {name: ", ".join(map(repr, x)) for name, x in found.items() if isinstance(x, tuple)}
    lines = [f"#define {name} {value}" for name, value in found.items()]
    for vector, names in (*memory.NAMED.items(), ("WATCH", Watch._fields)):
        entries = wrap(", ".join([*(f"{vector}_{name.upper()}" for name in names), vector]), 114)
        lines += ["", "enum {", *(f"    {line}" for line in entries), "};"]
    parts = {"COUNTS": COUNTS, "REFERENCES": REFERENCES, "PROGRAMS": PROGRAMS}
    rest = [name for name in NUMBERS if not any(name in part for part in parts.values())]
    numbers = [*COUNTS, *REFERENCES, *rest, *PROGRAMS]
    assert numbers == [*NUMBERS]
    tables = {**parts, "REST": rest, "REALS": REALS, "OTHERS": CHOSEN.values()}
    for name, each in tables.items():
        rows = [f"    {line}" for line in wrap(" ".join(f"X({x})" for x in each), 112)]
        lines += ["", " \\\n".join([f"#define SCENE_{name}(X)", *rows])]
    lines += ["", "#define SCENE_NUMBERS(X) SCENE_COUNTS(X) SCENE_REFERENCES(X) SCENE_REST(X) SCENE_PROGRAMS(X)"]
    head = (
        "/* Numbers and messages common to alfmu's Python code and its runtime; generated from "
        "alfmu/kernel/tables.py. */"
    )
    return "\n".join([head, "", "#ifndef ALFMU_LAYOUT_H", "#define ALFMU_LAYOUT_H", "", *lines, "", "#endif", ""])


def machine_code(equations: Traced, scene: bytes) -> list[str]:
    """Return C files with the functions of a scene file of complete equations, for `scene_compiled` of the runtime."""
    e = equations
    kept = {name: dict(enumerate(e.signatures[name]["inputs"])) for name in FUNCTIONS.values() if name in e.signatures}
    return compiled_code(e, kept, f"{zlib.crc32(scene[HEAD:]):08x}")


def function_sizes(equations: Traced) -> dict[str, int]:
    """Return the size of each function of complete equations in their scene file in bytes."""
    e, found = equations, {}
    table = _Table(e)
    table.code()
    for name, made in zip(e.functions, table.functions, strict=True):
        w = Writer()
        w.code(*made, len(table.constants.numbers))
        found[name] = sum(map(len, w.parts))
    return found


def packed(equations: Traced, shares: bool = False) -> bytes:
    """Return the scene file of complete equations (`kernel.complete`), with their programs and functions; values within
    programs share places if `shares` is set."""
    with getting_ready():
        return _file(equations, shares)


def packed_start(equations: Configuration) -> bytes:
    """Return the scene file of untraced equations: it can be initialised, but not stepped."""
    chosen = {name: value for name, value in equations.solver.items() if name not in ("method", "input_order")}
    return _file(ordered(beginning(replace(equations, solver=chosen))))


def _file(equations: Traced, shares: bool = False) -> bytes:
    w = Writer()
    w.text(equations.name)
    table = _Table(equations)
    table.code()
    if shares:
        table.overlay()
    for number in NUMBERS.values():
        w.integer(int(number(table)))
    for real in REALS.values():
        w.real(float(real(table)))
    table.write(w)
    return identified(bytes(HEAD) + b"".join(w.parts), hashlib.sha256(b"".join(w.parts)).hexdigest()[:32])


def identified(scene: bytes, identity: str) -> bytes:
    """Return the scene with another identity: the GUID of its FMU."""
    rest = identity.encode().ljust(IDENTITY, b"\0") + scene[HEAD:]
    return MAGIC + struct.pack("<IIQ", VERSION, len(scene), zlib.crc32(rest)) + rest


def number_of(scene: bytes, name: str) -> int:
    """Return a number of NUMBERS from a scene file."""
    behind_name = HEAD + 4 + struct.unpack_from("<i", scene, HEAD)[0]
    return struct.unpack_from("<i", scene, behind_name + 4 * list(NUMBERS).index(name))[0]


class _Table:
    """The tables of a scene file."""

    def __init__(self, equations: Traced):
        self.e: Traced = equations
        self.layout: Layout = Layout(equations)
        self.variables: Interface = interface(equations)
        self.known: dict[str, dict[str, str]] = known_choices(equations)
        self.passed: dict[str, int] = passed(equations)
        self.method: str = integrator(equations)
        self.rule: str = equations.kernel["method"].rule if "method" in equations.kernel else ""
        rule = explicit_rule(self.method, 1.0, self.rule) or implicit.RULES.get(self.method)
        self.share: tuple[float, float] = share(rule) if isinstance(rule, Explicit | Collocation) else (1.0, 1.0)
        self.places: dict[str, tuple[int, int]] = {}
        """Addresses and lengths of values in the workspace that programs pass on."""
        self.memory: dict[str, tuple[int, int]] = dict(self.layout.fields)
        """Addresses and lengths in the memory, where the workspace follows the fields."""
        self.workspace: int = 0

    def code(self) -> None:
        """Encode functions and programs, in the order of their numbers."""
        e = self.e
        for name, length in {**dict.fromkeys(HANDED.values(), 0), **self.passed}.items():
            if length:
                self._place(name, length)
        self.constants = Constants()
        made = [code(each, e.name) for each in e.functions.values()]
        self.functions = [(each, self.constants.places(each)) for each in made]
        self.number = {name: i for i, name in enumerate(e.functions)}
        self.program = {name: i for i, name in enumerate(e.kernel)}
        self.programs = [self._program(program.steps) for program in e.kernel.values()]

    def overlay(self) -> None:
        """Encode programs again so that values of one program alone, while they live, share places with others."""
        kernel, lengths = self.e.kernel, {name: length for name, (_, length) in self.places.items()}
        kept = {*HANDED.values(), ACCELERATIONS, *(name for each in kernel.values() for name in taken(each.steps))}
        self.places, self.memory, self.workspace = {}, dict(self.layout.fields), 0
        for name, length in lengths.items():
            if name in kept:
                self._place(name, length)
        memory, begin, self.programs = self.memory, self.workspace, []
        for program in kernel.values():
            heap, self.memory, ending = Heap(begin), dict(memory), list[tuple[int, str]]()
            for name, (first, last) in sorted(lifetimes(program.steps).items(), key=lambda each: each[1]):
                for end, ended in [each for each in ending if each[0] < first]:
                    ending.remove((end, ended))
                    heap.give(self.memory[ended][0] - self.layout.size, lengths[ended])
                if name not in self.memory:
                    self.memory[name] = self.layout.size + heap.take(lengths[name]), lengths[name]
                    ending.append((last, name))
            self.programs.append(self._program(program.steps))
            self.workspace = max(self.workspace, heap.size)

    def _place(self, name: str, length: int) -> None:
        self.places[name] = self.workspace, length
        self.memory.setdefault(name, (self.layout.size + self.workspace, length))
        self.workspace += length

    def _program(self, steps: Iterable[Step]) -> list[int]:
        words: list[int] = []
        for step in steps:
            words.append(CALLS.index(type(step)))
            if isinstance(step, Choice):
                nonzero, zero = map(self._program, (step.nonzero, step.zero))
                words += [self.memory[step.number][0], len(nonzero), len(zero), *nonzero, *zero]
            elif isinstance(step, Loop):
                body = self._program(step.body)
                most = step.most if isinstance(step.most, int) else -1 - self.memory[step.most][0]
                words += [self.memory[step.number][0], most, len(body), *body]
            elif isinstance(step, Lanes):
                words += [len(step.calls), self.number[step.calls[0].function]]
                words += [place for call in step.calls for place in self._called(call)[1:]]
            else:
                words += self._called(step)
        return words

    def _called(self, step: Call | Routine) -> list[int]:
        """Return the encoded call, with addresses of its arguments and of its results, which are assigned here."""
        if isinstance(step, Call):
            what = [self.number[step.function]]
            lengths = self.functions[what[0]][0].outputs
        elif isinstance(step, LeastNorm):
            what, lengths = [step.side], [step.side]
        else:
            what, length = [step.side, step.count], step.side * step.count
            lengths = [length]
            if isinstance(step, Factor):
                what.append((len(step.arguments) - 1) // step.count)
                lengths = [length**2, length]
        for each, length in zip(step.results, lengths, strict=True):
            if each not in self.memory:
                self._place(each, length)
            if self.memory[each][1] != length:
                raise ValueError(f"{self.e.name}: {each} has {self.memory[each][1]} entries, and {step} gives {length}")
        return [*what, *(self.memory[each][0] for each in (*step.arguments, *step.results))]

    def cost(self, program: str) -> int:
        """Return the cost of a step in evaluations of accelerations."""
        known = self.e.kernel.get(program)
        return known.evaluations + NODE_COST * known.nodes if known else 0

    def causal(self, name: str) -> int:
        """Return the number of a settable variable among all of them."""
        return next(k for k, (_, v) in enumerate(self.variables.causalities) if v.name == name)

    def output(self, name: str) -> int:
        """Return the number of an output; -1 if it is left out."""
        return next((k for k, v in enumerate(self.variables.outputs) if v.name == name), -1)

    def write(self, w: Writer) -> None:
        """Write everything after the numbers."""
        e, known, variables = self.e, self.known, self.variables
        for _, v in variables.causalities[: -len(variables.jacobian) or None]:
            self._variable(w, v)
        for v in variables.choices:
            w.integer(list(known[v.name]).index(str(v.start)))
            self._texts(w, known[v.name])
        for switch in e.switches:
            w.integer(switch.holds)
            w.integer(switch.value)
            w.integer(switch.start)
            w.integer(len(switch.rows))
            w.integers(switch.rows)
        for each in e.frictions:
            w.integer(each.row)
            w.integer(each.value)
            w.integer(each.slip)
            w.integer(each.output in (e.survey.shared or ()))
        w.integers(row for switch in e.switches for row in switch.rows)
        # The instance stores impulses, then the energy lost (also without switches), then peaks.
        places = {v.name: i + (v.of_step and not e.switches) for i, v in enumerate(every_event(e))}
        w.integers(places[v.name] for v in events(e))
        outputs = {v.name: i for i, v in enumerate(e.outputs)}
        parts = [[*(outputs[name] for name in each), -1, -1][:3] for each in e.peaks.values()]
        w.integers(part for each in parts for part in each)
        w.integers([*e.wrapped.values(), *e.counted.values()])
        w.integers(e.tied)
        w.integers(e.breaks)
        for c in e.coordinates:
            w.text(c.name)
            w.text(c.unit)
        for r in e.rows:
            w.text(r.name)
            w.text(r.direction)
            w.text(r.unit)
        w.reals(r.size for r in e.rows)
        w.reals(v.nominal or 1.0 for v in e.states)
        normal = np.random.default_rng(0).standard_normal((max(thresholds.TRIES, thresholds.RANKED), e.n))
        normal[:, e.dependent :] = 0.0
        w.reals(normal.ravel())
        w.reals(c.readiness for c in e.coordinates)
        closure, constraints = (e.signatures[name]["outputs"] for name in ("closure", "constraints"))
        for shape in (*constraints[:2], *closure[:2]):
            self._pattern(w, shape)
        w.reals(np.frombuffer(b"".join(self.constants.numbers), "<f8"))
        w.integer(len(self.functions))
        for function, constants in self.functions:
            w.code(function, constants, len(self.constants.numbers))
        w.integer(len(self.programs))
        for words in self.programs:
            w.integers(words)
        if e.timed:
            self._followed(w)
            self._leaps(w)
        for v in e.limited:
            w.text(v.name)
            w.text(v.unit)
        if variables.jacobian:
            self._jacobian(w)

    def _followed(self, w: Writer) -> None:
        """Write inputs that prescribe motion."""
        w.integer(len(self.e.followed))
        for each in self.e.followed:
            for number in (each.input, each.derivatives, each.order):
                w.integer(number)
            w.real(each.jump)

    def _leaps(self, w: Writer) -> None:
        """Write laws of time that may jump or diverge."""
        w.integer(len(self.e.leaps))
        for each in self.e.leaps:
            for text in (each.what, each.unit, rate_of(each.unit)):
                w.text(text)
            w.integer(each.row)

    def _jacobian(self, w: Writer) -> None:
        """Write the interface Jacobian, the last part of the file if the scene has one."""
        outputs, inputs = ([v.name for v in known] for known in (self.e.outputs, self.e.inputs))
        w.integer(len(self.e.jacobian))
        for v, (output, by) in zip(self.variables.jacobian, self.e.jacobian, strict=True):
            self._variable(w, v)
            w.integer(outputs.index(output))
            w.integer(inputs.index(by))

    @staticmethod
    def _texts(w: Writer, values: Iterable[str]) -> None:
        values = list(values)
        w.integer(len(values))
        for value in values:
            w.text(value)

    @staticmethod
    def _variable(w: Writer, v: Variable) -> None:
        w.text(v.name)
        w.text(v.unit)
        w.integer(("Real", "Integer", "Boolean", "String").index(v.type))
        w.integer(v.instant)
        w.real(0.0 if isinstance(v.start, str) else v.start)
        w.real(-math.inf if v.minimum is None else v.minimum)
        w.real(math.inf if v.maximum is None else v.maximum)

    @staticmethod
    def _pattern(w: Writer, shape: list) -> None:
        w.integer(len(shape) > 2)
        if len(shape) > 2:
            w.integers(shape[2])
            w.integers(shape[3])
