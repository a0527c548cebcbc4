"""A scene as one file for the C runtime: its tables, functions and programs; the headers that both languages share."""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..equations import Equations, Variable
from ..equations.evaluation import DENSE
from ..equations.interface import CHOICES, SOLVER_VARIABLES, Interface, events, every_event, variables_of
from ..method import formulations, implicit, singular, stepping
from ..method.stepping import Collocation, Explicit, explicit_rule, share
from ..model.settings import FIXED, FORMULATIONS, PROJECTED, Settings
from . import program as program_module
from . import thresholds
from .alternatives import OWN
from .alternatives import formulations as carried
from .emit import compiled_code
from .joined import joined
from .program import CHOICE, FACTOR, LEAST_NORM, LOOP, SOLVE, TIERS, Layout
from .scene import CALLS, Code, Constants, Writer, code
from .standalone import passed, standalone
from .trace import CAREFUL, ROUND_OFF, Watch

__all__ = [
    "alone",
    "function_sizes",
    "identified",
    "interface",
    "known_choices",
    "layout_header",
    "machine_code",
    "packed",
]

VERSION = 3
"""Of scene files; raised whenever their content changes meaning."""

MAGIC = b"ALFMU\r\n\x1a"

HEAD, IDENTITY = 64, 40
"""Bytes before the body: MAGIC, version, length, check sum; at their end the identity."""

COUNTS = (
    *("parameters", "choices", "inputs", "switches", "outputs", "own", "starts", "compliances", "solver", "held"),
    *("impulses", "event_count", "n", "l", "angles", "readings", "ties"),
)
REFERENCES = ("step_size", "penalty", "tolerance", "max_iterations", "relative_tolerance", "absolute_tolerance")
FIELDS = ("z", "after", "begin", "u", "p", "k", "dt", "control", "tally", "pace", "past", "seen")
HANDED = {
    **{name: name for name in ("most", "patient", "du", "slopes", "within", "q", "v", "dy", "struck", "lost")},
    **{name: name for name in ("again", "stabilisation", "projects")},
    "impulse": "impulses",
    **{f"{name}{i}": f"{name}{i}" for name in ("watch", "q", "v") for i in (1, 2, 3, 4)},
    "watch0": "watch0",
}
OTHERS = tuple(name for name in FORMULATIONS if name != OWN)
FUNCTIONS = {
    **{name: name for name in ("dynamics", "constraints", "energy", "closure", "guesses", "displacements", "pivots")},
    **{"place": "weighted_place", "bring": "weighted_return", "settle": "weighted_settle"},
}
PROGRAMS = {
    **{name: name for name in ("quick", "careful", "instant", "limit", "move", "move_on_branch", "close", "impact")},
    **{name: name for name in ("sensitivity", "limit_sensitivity", "reach", "beside")},
    **{"branch_step": "branch", "method_step": "method"},
    **{name: name for name in ("instant_patient", "limit_patient", "keep")},
    **{f"{program}_{name}": f"{program}_{name}" for program in ("move", "instant") for name in OTHERS},
}
NUMBERS = (
    *COUNTS,
    *REFERENCES,
    *("formulation", "branch", "continues", "method_choice"),
    *("freedom", "brakes", "weighted", "same_tiers", "careful_iterations"),
    *("monitor_position", "monitor_velocity", "monitor_energy", "monitor_iterations"),
    *("method", *FIELDS, "past_size", "seen_size", "time", "work", "trouble", "near", "size", "workspace"),
    *(*HANDED, *FUNCTIONS, *PROGRAMS),
)
REALS = ("no_slope", "share", "exponent")

_WATCHED = {"position": "position_error", "velocity": "velocity_error", "energy": "energy", "iterations": "iterations"}
"""Monitors whose largest values an instance keeps, and the one that it counts where loops stop on convergence."""

HOT = ("quick", "instant", "method")
"""Programs whose calls are joined: they run in every step."""


def interface(equations: Equations) -> Interface:
    """The variables of a scene; it carries one order of inputs."""
    found = variables_of(equations)
    only = [replace(v, minimum=v.start, maximum=v.start) if v.name in _FIXED else v for v in found.parameters]
    return replace(found, parameters=only)


_FIXED = ("solver.input_order",)
"""Numbers of the solver that a scene has traced."""


def known_choices(equations: Equations) -> dict[str, dict[str, str]]:
    """What text variables can be, and what that is: a scene carries one method of integration."""
    chosen = {v.name: str(v.start) for v in variables_of(equations).choices}
    carries = {"solver.formulation": carried(equations), "solver.method": [chosen["solver.method"]]}
    return {
        name: {each: text for each, text in known.items() if each in carries.get(name, known)}
        for name, known in CHOICES.items()
    }


def layout_header() -> str:
    """layout.h: what the C runtime shares with Python: names of the numbers of a scene, constants."""
    found = {
        "SCENE_VERSION": VERSION,
        "SETTINGS": program_module.SETTINGS,
        "GROSS": program_module.GROSS,
        "TURN": program_module.TURN,
        "CORRECTIONS": formulations.CORRECTIONS,
        "NOISE_FLOOR": singular.NOISE_FLOOR,
        "LEAST_DISTANCE": singular.LEAST_DISTANCE,
        "REGULAR_PRODUCT": singular.REGULAR_PRODUCT,
        "CONVERGENCE": singular.CONVERGENCE,
        "QUARTER": math.pi / 2,
        "DENSE": DENSE,
        "TIERS": len(TIERS),
        "WATCH": len(Watch.FIELDS),
        "PACE": len(program_module.PACE),
        **{f"PACE_{name.upper()}": i for i, name in enumerate(program_module.PACE)},
        **{f"WATCH_{name.upper()}": i for i, name in enumerate(Watch.FIELDS)},
        "CHOICES": len(CHOICES),
        "FORMULATIONS": len(FORMULATIONS),
        **{f"{name.upper()}_FORMULATION": i for i, name in enumerate(FORMULATIONS)},
        "PROJECTED": tuple(int(name in PROJECTED) for name in FORMULATIONS),
        "ZETA": Settings.zeta,
        "OMEGA": Settings.omega,
        "LEAST_BEFORE": stepping.LEAST_BEFORE,
        "ROUND_OFF": ROUND_OFF,
    }
    found |= {name: value for name, value in vars(thresholds).items() if name.isupper()}
    found |= {name: ", ".join(map(repr, x)) for name, x in found.items() if isinstance(x, tuple)}
    lines = [f"#define {name} {value}" for name, value in found.items()]
    tables = {"COUNTS": COUNTS, "REFERENCES": REFERENCES, "NUMBERS": NUMBERS, "REALS": REALS, "PROGRAMS": PROGRAMS}
    tables |= {"OTHERS": OTHERS}
    for name, names in tables.items():
        rows = "".join(f" \\\n    X({each})" for each in names)
        lines += ["", f"#define SCENE_{name}(X){rows}"]
    head = "/* What alfmu's Python code and its runtime share; generated from alfmu/kernel/tables.py. */"
    return "\n".join([head, "", "#ifndef ALFMU_LAYOUT_H", "#define ALFMU_LAYOUT_H", "", *lines, "", "#endif", ""])


def alone(equations: Equations) -> Equations:
    """Traced equations with the programs and functions that a scene file has; the order is that of the file."""
    e = joined(standalone(equations), HOT)
    used = dict.fromkeys(name for each in e.kernel.values() for name in program_module.called(each["calls"]))
    names = dict.fromkeys([*(name for name in FUNCTIONS.values() if name in e.signatures), *used])
    functions, signatures = ({name: table[name] for name in names} for table in (e.functions, e.signatures))
    return replace(e, functions=functions, signatures=signatures)


def machine_code(equations: Equations, scene: bytes) -> list[str]:
    """C files with the functions of a scene file of these equations, for `scene_compiled` of the runtime."""
    e = alone(equations)
    kept = {name: dict(enumerate(e.signatures[name]["inputs"])) for name in FUNCTIONS.values() if name in e.signatures}
    return compiled_code(e, kept, f"{zlib.crc32(scene[HEAD:]):08x}")


def function_sizes(equations: Equations) -> dict[str, int]:
    """Bytes of each function in a scene file."""
    e, constants, found = alone(equations), Constants(), {}
    for name in e.signatures:
        w = Writer()
        w.code(code(e.functions[name], constants, e.name), len(constants))
        found[name] = sum(map(len, w.parts))
    return found


def packed(equations: Equations) -> bytes:
    """The scene file of traced equations."""
    e = alone(equations)
    w = Writer()
    w.text(e.name)
    table = _Table(equations, e)
    table.code()
    numbers = table.numbers()
    for name in NUMBERS:
        w.integer(int(numbers[name]))
    for name in REALS:
        w.real(float(numbers[name]))
    table.write(w)
    return identified(bytes(HEAD) + b"".join(w.parts), hashlib.sha256(b"".join(w.parts)).hexdigest()[:32])


def identified(scene: bytes, identity: str) -> bytes:
    """The same scene with another identity: the GUID of the FMU that it is in."""
    rest = identity.encode().ljust(IDENTITY, b"\0") + scene[HEAD:]
    return MAGIC + struct.pack("<IIQ", VERSION, len(scene), zlib.crc32(rest)) + rest


class _Table:
    """What stands in the file of a scene."""

    def __init__(self, scene: Equations, own: Equations):
        self.scene, self.e = scene, own
        self.layout = Layout(scene)
        self.places: dict[str, tuple[int, int]] = {}
        """Where values stand in the workspace that programs hand on, and their lengths."""
        self.workspace = 0

    def code(self) -> None:
        """Functions and programs, in the order of their numbers."""
        e = self.e
        for name, length in {**dict.fromkeys(HANDED.values(), 0), **passed(e)}.items():
            if length:
                self._place(name, length)
        self.constants = Constants()
        self.functions: list[Code] = [code(each, self.constants, e.name) for each in e.functions.values()]
        self.number = {name: i for i, name in enumerate(e.functions)}
        self.program_names = list(e.kernel)
        self.programs = [self._program(e.kernel[name]["calls"]) for name in self.program_names]

    def _place(self, name: str, length: int) -> int:
        self.places[name] = self.workspace, length
        self.workspace += length
        return self.places[name][0]

    def _length(self, name: str) -> int:
        fields = self.layout.fields
        return fields[name][1] if name in fields else self.places[name][1]

    def _at(self, name: str) -> int:
        """Place in the memory; the workspace stands behind the fields."""
        fields = self.layout.fields
        return fields[name][0] if name in fields else self.layout.size + self.places[name][0]

    def _program(self, calls: list[list]) -> list[int]:
        words: list[int] = []
        for name, *rest in calls:
            if name == CHOICE:
                number, *ways = rest
                first, second = map(self._program, ways)
                words += [CALLS.index("choice"), self._at(number), len(first), len(second), *first, *second]
            elif name == LOOP:
                number, times, again = rest
                body = self._program(again)
                limit = times if isinstance(times, int) else -1 - self._at(times)
                words += [CALLS.index("loop"), self._at(number), limit, len(body), *body]
            else:
                inputs, outputs, *sizes = rest
                if sizes:
                    side = math.prod(sizes)
                    lengths = [side * side, side] if name == FACTOR else [side]
                else:
                    lengths = self.functions[self.number[name]].outputs
                for each, length in zip(outputs, lengths, strict=True):
                    if each not in self.layout.fields and each not in self.places:
                        self._place(each, length)
                    if self._length(each) != length:
                        raise ValueError(f"{each} has {self._length(each)} entries, and {name} gives {length}")
                at = [self._at(each) for each in (*inputs, *outputs)]
                if name == FACTOR:
                    terms = (len(inputs) - 1) // sizes[1]
                    words += [CALLS.index("factor"), *sizes, terms, *at]
                elif name == SOLVE:
                    words += [CALLS.index("solve"), *sizes, *at]
                elif name == LEAST_NORM:
                    words += [CALLS.index("least_norm"), *sizes, *at]
                else:
                    words += [CALLS.index("call"), self.number[name], *at]
        return words

    def numbers(self) -> dict[str, float]:
        """The numbers of the scene by name."""
        e, layout = self.e, self.layout
        variables, known = interface(self.scene), known_choices(self.scene)
        at = {v.name: k for k, (_, v) in enumerate(variables.causalities)}
        names, seen = list(CHOICES), {v.name: k for k, v in enumerate(variables.outputs)}
        quick, careful = (e.kernel[name] for name in ("quick", "careful"))
        method = self.scene.solver.get("method", Settings.method)
        rule = explicit_rule(method, 1.0, e.kernel.get("method", {}).get("rule")) or implicit.RULES.get(method)
        factor, exponent = share(rule) if isinstance(rule, Explicit | Collocation) else (1.0, 1.0)
        offsets = {name: self.places.get(key, (0, 0))[0] for name, key in HANDED.items()}
        return {
            "parameters": len(variables.parameters),
            "choices": len(CHOICES),
            "inputs": len(e.inputs),
            "switches": len(e.switches),
            "outputs": len(variables.outputs),
            "own": len(e.parameters),
            "starts": len(e.starts),
            "compliances": len(e.compliances),
            "solver": len(SOLVER_VARIABLES),
            "held": len(e.held),
            "impulses": sum(len(switch.rows) for switch in e.switches),
            "event_count": len(events(e)),
            "n": e.n,
            "l": e.l,
            "angles": len(e.wrapped),
            "readings": len(e.outputs),
            "ties": len(e.tied),
            **{name: at[f"solver.{name}"] for name in REFERENCES},
            "formulation": names.index("solver.formulation"),
            "branch": names.index("solver.branch"),
            "continues": list(known["solver.branch"]).index("continue"),
            "method_choice": names.index("solver.method"),
            "freedom": -1 if e.freedom is None else e.freedom,
            "brakes": e.brakes,
            "weighted": quick.get("weighted", False),
            "same_tiers": quick == careful,
            "careful_iterations": CAREFUL if e.l else 1,
            **{f"monitor_{name}": seen.get(f"monitor.{key}", -1) for name, key in _WATCHED.items()},
            "method": 0 if method == Settings.method else 1 + (method in FIXED),
            **{name: layout.fields[name][0] for name in FIELDS},
            "past_size": layout.fields["past"][1],
            "seen_size": layout.fields["seen"][1],
            "time": layout.time,
            "work": layout.work,
            "trouble": layout.trouble,
            "near": layout.near,
            "size": layout.size,
            # What a scene does not hand on has a place at the beginning, which has room for it.
            "workspace": max(self.workspace, e.n + e.l + len(e.outputs) + len(e.inputs) + len(Watch.FIELDS) + 1),
            **offsets,
            **{name: self.number.get(key, -1) for name, key in FUNCTIONS.items()},
            **{
                name: self.program_names.index(key) if key in self.program_names else -1
                for name, key in PROGRAMS.items()
            },
            "no_slope": math.inf if "reach" in e.kernel else 0.0,
            "share": factor,
            "exponent": exponent,
        }

    def write(self, w: Writer) -> None:
        """Everything behind the numbers."""
        e, known, variables = self.e, known_choices(self.scene), interface(self.scene)
        for _, v in variables.causalities:
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
        w.integers(row for switch in e.switches for row in switch.rows)
        every = [v.name for v in every_event(e)]
        w.integers(every.index(v.name) for v in events(e))
        w.integers(e.wrapped.values())
        w.integers(e.tied)
        for c in e.coordinates:
            w.text(c.name)
            w.text(c.unit)
        for r in e.rows:
            w.text(r.name)
            w.text(r.direction)
            w.text(r.unit)
        w.reals(np.random.default_rng(0).standard_normal((max(thresholds.TRIES, thresholds.RANKED), e.n)).ravel())
        closure, constraints = (e.signatures[name]["outputs"] for name in ("closure", "constraints"))
        for shape in (*constraints[:2], *closure[:2]):
            self._pattern(w, shape)
        w.reals(struct.unpack(f"<{len(self.constants)}d", self.constants.packed()))
        w.integer(len(self.functions))
        for each in self.functions:
            w.code(each, len(self.constants))
        w.integer(len(self.programs))
        for words in self.programs:
            w.integers(words)

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
