"""A scene as data for the C runtime of native FMUs (`alfmu/native`): variables, sizes, places, functions; constants."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from .. import adaptive, assembly, branch, implicit, oracle, runtime, scaling, stepping
from ..equations import Equations, Variable
from ..evaluation import DENSE
from ..kernel import program
from ..kernel.emit import written
from ..kernel.program import Layout
from ..kernel.standalone import passed, standalone
from ..kernel.trace import CAREFUL, ROUND_OFF, Watch
from ..oracle import FIXED, Settings
from ..runtime import CHOICES, SOLVER_VARIABLES, Instance, choices
from ..stepping import Collocation, Explicit, explicit_rule, share
from ..topology import events

__all__ = ["constants", "interface", "sources"]


def interface(equations: Equations) -> list[tuple[str, Variable]]:
    """Every variable of a native FMU with its causality, in the order of value references: those of the Python FMU.

    A scene carries one order of inputs.
    """
    i = Instance(equations)
    return [
        *(("parameter", _only(v) if v.name == "solver.input_order" else v) for v in i.parameters),
        *(("parameter", v) for v in choices(i.choices)),
        *(("input", v) for v in i.input_variables),
        *(("output", v) for v in i.outputs),
    ]


def _only(v: Variable) -> Variable:
    """A variable that can have no other value."""
    return replace(v, minimum=v.start, maximum=v.start)


def known_choices(equations: Equations) -> dict[str, dict[str, str]]:
    """What text variables can be in a native FMU, and what that is: a scene carries one formulation and one method."""
    chosen = Instance(equations).choices
    return {
        name: dict(known) if name == "solver.branch" else {chosen[name]: known[chosen[name]]}
        for name, known in CHOICES.items()
    }


def constants() -> str:
    """constants.h: numbers that the C runtime shares with Python."""
    found = {
        "SETTINGS": program.SETTINGS,
        "GROSS": program.GROSS,
        "TURN": program.TURN,
        "TORN": runtime.TORN,
        "SHORTEST": runtime.SHORTEST,
        "SAID": runtime.SAID,
        "CORRECTIONS": oracle.CORRECTIONS,
        "LITTLE": oracle._LITTLE,
        "FAR_RATIO": oracle._FAR,
        "COARSE": oracle.COARSE,
        "PATIENT": oracle._PATIENT,
        "REGULAR": oracle._REGULAR,
        "NOTHING": branch.NOTHING,
        "LEAST": branch.LEAST,
        "USUAL_PRODUCT": branch.FAR,
        "CONVERGING": branch.CONVERGING,
        "PENALTY_RATIO": scaling.PENALTY_RATIO,
        "ALIKE": scaling._ALIKE,
        "HARDLY": scaling._SMALL,
        "SAME": scaling._SAME,
        "QUARTER": math.pi / 2,
        "TOLERANCE": assembly._TOLERANCE,
        "ROUGH": assembly._ROUGH,
        "MOST": assembly._MOST,
        "LONGEST_TURN": assembly._TURN,
        "TRIES": assembly._TRIES,
        "RANKED": assembly._RANKED,
        "DENSE": DENSE,
        "PACE": len(program.PACE),
        "PACE_FIXED": program.PACE.index("fixed"),
        "PACE_LAST": program.PACE.index("last"),
        "FIRST_STEP": adaptive.FIRST,
        "LEAST_BEFORE": stepping.LEAST_BEFORE,
        "ROUND_OFF": ROUND_OFF,
    }
    lines = [f"#define {name} {value!r}" for name, value in found.items()]
    lines.append(f"#define ASIDE {', '.join(map(repr, oracle.ASIDE))}")
    head = "/* Numbers that alfmu's Python code defines; generated. */"
    return "\n".join([head, "#ifndef ALFMU_CONSTANTS_H", "#define ALFMU_CONSTANTS_H", *lines, "#endif", ""])


def sources(equations: Equations, guid: str) -> list[str]:
    """C files of a traced scene: its functions, programs, and what they are."""
    alone = standalone(equations)
    files, workspace, places = written(alone, passed(alone))
    # Nothing but the functions of FMI leaves the library.
    files = ["#define EXPORT\n" + text for text in files]
    files[-1] += _Table(equations, alone, guid, workspace, places).text()
    return files


class _Table:
    """The text of `alfmu_scene`."""

    def __init__(self, scene: Equations, alone: Equations, guid: str, workspace: int, places: Mapping[str, int]):
        self.scene, self.e, self.guid, self.workspace, self.places = scene, alone, guid, workspace, places
        self.lines: list[str] = []

    def text(self) -> str:
        fields = {**self._variables(), **self._structure(), **self._memory(), **self._code()}
        body = "".join(f"    .{name} = {value},\n" for name, value in fields.items())
        head = '\n#include "alfmu.h"\n\n'
        return head + "".join(self.lines) + f"const Scene alfmu_scene = {{\n{body}}};\n"

    def _variables(self) -> dict[str, object]:
        e, variables, known = self.e, interface(self.scene), known_choices(self.scene)
        instance = Instance(self.scene)
        kinds = [
            *["PARAMETER"] * len(instance.parameters),
            *["CHOICE"] * len(CHOICES),
            *["INPUT"] * len(e.inputs),
            *["SWITCH"] * len(e.switches),
            *["OUTPUT"] * len(instance.outputs),
        ]
        rows = [self._variable(v, kind) for (_, v), kind in zip(variables, kinds, strict=True)]
        self._array("const Variable variables", rows)
        for name, values in known.items():
            self._array(f"const char *const {_field(name)}_values", map(_text, values))
        each = (
            f"{{{len(values)}, {list(values).index(instance.choices[name])}, {_field(name)}_values}}"
            for name, values in known.items()
        )
        self._array("const Choice choice", each)
        at = {v.name: k for k, (_, v) in enumerate(variables)}
        names = list(CHOICES)
        return {
            "name": _text(e.name),
            "guid": _text(self.guid),
            "variables": "variables",
            "parameters": len(instance.parameters),
            "choices": len(CHOICES),
            "inputs": len(e.inputs),
            "switches": len(e.switches),
            "outputs": len(instance.outputs),
            "choice": "choice",
            "own": len(e.parameters),
            "starts": len(e.starts),
            "compliances": len(e.compliances),
            "solver": len(SOLVER_VARIABLES),
            **{name: at[f"solver.{name}"] for name in _NUMBERS},
            "branch": names.index("solver.branch"),
            "method_choice": names.index("solver.method"),
            "continues": list(known["solver.branch"]).index("continue"),
            "no_slope": _number(math.inf if "reach" in e.kernel else 0.0),
        }

    def _variable(self, v: Variable, kind: str) -> str:
        low, high = (-math.inf if v.minimum is None else v.minimum), (math.inf if v.maximum is None else v.maximum)
        start = 0.0 if isinstance(v.start, str) else v.start
        numbers = ", ".join(_number(float(x)) for x in (start, low, high))
        return f"{{{_text(v.name)}, {_text(v.unit)}, {v.type.upper()}, {kind}, {numbers}, {int(v.instant)}}}"

    def _structure(self) -> dict[str, object]:
        e = self.e
        for k, switch in enumerate(e.switches):
            self._array(f"const int switch_rows_{k}", switch.rows)
        self._array(
            "const Switch switched",
            (
                f"{{{len(s.rows)}, switch_rows_{k}, {int(s.holds)}, {s.value}, {int(s.start)}}}"
                for k, s in enumerate(e.switches)
            ),
        )
        impulses = [row for switch in e.switches for row in switch.rows]
        self._array("const int impulse_rows", impulses)
        every = [v.name for v in events(replace(e, monitors=[]))]
        shown = [every.index(v.name) for v in events(e)]
        self._array("const int event_places", shown)
        self._array("const Coordinate coordinates", (f"{{{_text(c.name)}, {_text(c.unit)}}}" for c in e.coordinates))
        self._array("const Row rows", (f"{{{_text(r.name)}, {_text(r.direction)}, {_text(r.unit)}}}" for r in e.rows))
        self._array("const int angle_starts", e.wrapped.values())
        self._array("const int tied", e.tied)
        normal = np.random.default_rng(0).standard_normal((assembly._TRIES, e.n))
        self._array("const double normal", map(_number, normal.ravel().tolist()))
        quick, careful = (e.kernel[name] for name in ("quick", "careful"))
        return {
            "switched": "switched",
            "held": len(e.held),
            "impulses": len(impulses),
            "event_count": len(shown),
            "impulse_rows": "impulse_rows",
            "event_places": "event_places",
            "n": e.n,
            "l": e.l,
            "angles": len(e.wrapped),
            "readings": len(e.outputs),
            "coordinates": "coordinates",
            "rows": "rows",
            "angle_starts": "angle_starts",
            "ties": len(e.tied),
            "tied": "tied",
            "freedom": -1 if e.freedom is None else e.freedom,
            "brakes": int(e.brakes),
            "weighted": int(quick.get("weighted", False)),
            "same_tiers": int(quick == careful),
            "careful_iterations": CAREFUL if e.l else 1,
            "normal": "normal",
            **self._method(),
        }

    def _method(self) -> dict[str, object]:
        """What makes the steps, and how the tolerance of a step follows from that of a run."""
        method = self.scene.solver.get("method", Settings.method)
        rule = explicit_rule(method, 1.0, self.e.kernel.get("method", {}).get("rule")) or implicit.RULES.get(method)
        factor, exponent = share(rule) if isinstance(rule, Explicit | Collocation) else (1.0, 1.0)
        kind = 0 if method == Settings.method else 1 + (method in FIXED)
        return {"method": kind, "share": repr(factor), "exponent": repr(exponent)}

    def _memory(self) -> dict[str, object]:
        layout = Layout(self.e)
        names = "z", "after", "begin", "u", "p", "k", "dt", "control", "pace", "past", "seen"
        found = {name: layout.fields[name][0] for name in names}
        found |= {
            "past_size": layout.fields["past"][1],
            "seen_size": layout.fields["seen"][1],
            "time": layout.time,
            "work": layout.work,
            "trouble": layout.trouble,
            "size": layout.size,
            "workspace": self.workspace,
        }
        handed = {"most": "most", "patient": "patient", "du": "du", "slopes": "slopes", "q": "q", "v": "v", "dy": "dy"}
        handed |= {"within": "within", "struck": "struck", "impulse": "impulses", "lost": "lost"}
        found |= {field: self.places.get(name, 0) for field, name in handed.items()}
        watches = ", ".join(str(self.places.get(f"watch{k + 1}", 0)) for k in range(4))
        return {**found, "watch": f"{{{watches}}}", "near": Watch.FIELDS.index("near")}

    def _code(self) -> dict[str, object]:
        e = self.e
        closure, constraints = (e.signatures[name]["outputs"] for name in ("closure", "constraints"))
        patterns = {"mass": constraints[0], "constraint": constraints[1], "gaps": closure[0], "tie_rows": closure[1]}
        functions = {name: name for name in ("dynamics", "constraints", "energy", "closure", "guesses")}
        functions |= {"displacements": "displacements", "pivots": "pivots"}
        functions |= {"place": "weighted_place", "bring": "weighted_return", "settle": "weighted_settle"}
        programs = {
            name: name
            for name in ("move", "move_on_branch", "close", "impact", "sensitivity", "limit_sensitivity", "reach")
        }
        programs |= {"instant": "instant_patient", "limit": "limit_patient"}
        return {
            **{name: self._pattern(name, shape) for name, shape in patterns.items()},
            **{field: name for field, name in functions.items() if name in e.signatures},
            **{field: f"run_{name}" for field, name in programs.items() if name in e.kernel},
            **{name: f"alfmu_{name}" for name in ("advance", "communicate", "read")},
            **({"cover": "alfmu_cover"} if "method" in e.kernel else {}),
        }

    def _pattern(self, name: str, shape: list) -> str:
        if len(shape) == 2:
            return f"{{{shape[0]}, {shape[1]}, 0, 0}}"
        rows, columns, offsets, indices = shape
        self._array(f"const int {name}_offsets", offsets)
        self._array(f"const int {name}_indices", indices)
        return f"{{{rows}, {columns}, {name}_offsets, {name}_indices}}"

    def _array(self, head: str, values: Iterable[object]) -> None:
        """A static array; C has none without entries."""
        entries = [str(value) for value in values]
        one_a_line = ",\n    ".join(entries) or ("{0}" if head.split()[1] in _STRUCTURES else "0")
        self.lines.append(f"static {head}[] = {{\n    {one_a_line}}};\n\n")


_NUMBERS = ("step_size", "penalty", "tolerance", "max_iterations", "relative_tolerance", "absolute_tolerance")

_STRUCTURES = ("Variable", "Choice", "Row", "Coordinate", "Switch")


def _field(name: str) -> str:
    return name.removeprefix("solver.")


def _number(value: float) -> str:
    return "INFINITY" if value == math.inf else "-INFINITY" if value == -math.inf else repr(value)


def _text(value: str) -> str:
    """A C string; what is not ASCII in bytes of UTF-8, each an octal escape, which ends after three digits."""
    plain = {ord('"'): '\\"', ord("\\"): "\\\\"}
    return '"' + "".join(plain.get(b, chr(b) if 32 <= b < 127 else f"\\{b:03o}") for b in value.encode()) + '"'
