"""Recipes: the contents of an FMU, declared in a Python file that `alfmu export` and `pythonfmu build` read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import KW_ONLY, InitVar, dataclass, field, fields, replace
from numbers import Real
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ..kernel import KERNELS
from ..model.errors import ExportError, InputError
from ..model.words import LONGEST, Brief

if TYPE_CHECKING:
    from ..model.mechanism import Mechanism

GROUP = "alfmu.fmus"
"""Entry-point group in which any package can register modules that declare a recipe."""

KINDS = {
    "native": "a C library: for every host, on the platforms that it contains",
    "python": "runs in Python, for hosts with Python: Linux and Windows on x86-64",
    "source": "C sources alone, without files, stdio and malloc: for rigs and microcontrollers, which compile it",
}
"""Kinds of FMUs, the default first."""

INTERFACES = {
    "both": "co-simulation and Model Exchange",
    "cs": "co-simulation alone",
    "me": "Model Exchange alone",
}
"""Interfaces of native FMUs."""

_MAY_DECLARE = re.compile(rb"recipe|import\s*\(?\s*\*", re.IGNORECASE)
"""Matches text in every file that declares a recipe."""

_OF_A_KIND = ("kernel", "platforms", "fmi", "interface", "sources")
"""Fields that apply to one kind of FMU only."""


def _dictionary(value: object) -> bool:
    return isinstance(value, Mapping) and all(isinstance(key, str) for key in value)


def _text(value: object) -> str:
    return ", ".join(f"{k}={x}" for k, x in value.items()) if isinstance(value, Mapping) else str(value)


def _names(value: object) -> bool:
    return isinstance(value, tuple) and all(isinstance(each, str) for each in value)


def _seconds(value: object) -> bool:
    return value is None or (isinstance(value, Real) and not isinstance(value, bool) and 0 < float(value) < math.inf)


def _one_of(*known: object) -> tuple[Callable[[object], bool], str]:
    text = " or ".join(map(str, known))
    return lambda value: any(type(value) is type(each) and value == each for each in known), text


_LISTS = ("lock", "release", "measure", "outputs", "freeze", "platforms")
"""Fields that are lists of names; a single name stands for a list of one."""

_FORM: dict[str, tuple[Callable[[Any], object], str]] = {
    "mechanism": (lambda x: isinstance(x, (str, Path)) or hasattr(x, "experiment"), "a name, a path or a Mechanism"),
    "name": (
        lambda x: isinstance(x, str) and len(x) <= LONGEST and re.fullmatch(r"([A-Za-z_][A-Za-z_0-9]*)?", x),
        f"letters, digits and underscores, {LONGEST} at most; rename the file, or give the recipe a name",
    ),
    "options": (_dictionary, "a dictionary from names to values"),
    "parameters": (
        lambda x: _dictionary(x) and all(isinstance(value, (Real, str)) for value in x.values()),
        "a dictionary from names to numbers or texts",
    ),
    **dict.fromkeys(("lock", "release", "measure", "platforms"), (_names, "a list of names")),
    **dict.fromkeys(("outputs", "freeze"), (lambda x: x is None or _names(x), "a list of names, or None")),
    **dict.fromkeys(("compliances", "reference", "sources"), _one_of(True, False)),
    "derivatives": _one_of(True, False, None),
    **dict.fromkeys(("stop_time", "communication_step"), (_seconds, "a finite number of seconds above zero, or None")),
    "kernel": _one_of(*KERNELS, None),
    "start": _one_of("declared", "equilibrium"),
    "interface": _one_of(*INTERFACES, None),
}
"""Fields of a recipe: a check of the value, and the expected form in words."""


@dataclass(frozen=True, repr=False)
class Recipe(Brief):
    """The recipe of an exported FMU: a mechanism, the parts of it in the FMU, and its form. Checked when created.

    `mechanism` is a registered name, the path of a Python file that declares one (relative to the recipe's file), or a
    `Mechanism`. `kind` is "native", a C library for every host, "python", an FMU that runs in Python, or "source", C to
    be compiled for a rig or a microcontroller; `options` are the mechanism's, `parameters`, `outputs` and `freeze` are
    those of `alfmu.simulate`, `lock` and `release` name joints that get Boolean inputs, `stop_time` and
    `communication_step` [s] are of the default experiment. Raises InputError if a field has the wrong form, ExportError
    if fields contradict each other; names of variables, joints and options are checked at export.
    """

    mechanism: str | Path | Mechanism
    _: KW_ONLY
    name: str = ""
    """Name of the model; by default that of the recipe's file, or of the mechanism if there is no file."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the mechanism, such as its coordinates."""
    lock: Sequence[str] = ()
    """Joints with a Boolean input that locks them."""
    release: Sequence[str] = ()
    """Joints with a Boolean input that releases them."""
    measure: Sequence[str] = ()
    """Joints and springs with outputs of their motion and effort, `["all"]` for every one."""
    compliances: bool = False
    """Whether each constraint has a compliance as a parameter."""
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    """Other defaults of parameters, start values, inputs and solver variables; the tolerance of the experiment is
    `solver.relative_tolerance`, the internal step `solver.step_size`."""
    start: str = "declared"
    """Default start: "declared" (at the start values) or "equilibrium" (where loads and springs balance); the start
    values of that position become the defaults."""
    outputs: Sequence[str] | None = None
    """The outputs that are computed, as names or patterns such as `link*.angle`; None for all. Entries of the interface
    Jacobian need a pattern such as `link1.angle/A.torque`."""
    freeze: Sequence[str] | None = None
    """Parameters of the mechanism that become constants, `["all"]` for every one."""
    stop_time: float | None = None
    """End of the default experiment [s]; None for the mechanism's own."""
    communication_step: float | None = None
    """Communication step of the default experiment [s]; None for the mechanism's own."""
    kind: str = "native"
    """Kind of the FMU, one of KINDS."""
    kernel: str | None = None
    """Kernel of an FMU of kind python, of `alfmu.kernel.KERNELS`; on platforms without its compiled functions it
    interprets them."""
    platforms: Sequence[str] = ()
    """Platforms of a native FMU, of `alfmu.runtime.build.PLATFORMS`, or `["all"]`; empty for those in
    this installation."""
    fmi: int = 2
    """Version of FMI; 3 for FMUs of kinds native and source."""
    interface: str | None = None
    """Interfaces of a native FMU, of INTERFACES; None for both, or co-simulation alone where an importer cannot
    integrate the mechanism."""
    derivatives: bool | None = None
    """Whether a native FMU gives directional derivatives, and adjoint ones with FMI 3; it is smaller without them. None
    for the default of its kind."""
    reference: bool = True
    """Whether reference results (`alfmu.fmi.records`) are inside."""
    sources: bool = True
    """Whether a native FMU contains its C sources, from which importers may build it for further platforms; it is
    smaller without them."""
    interval: InitVar[float | None] = None
    """Former name of `communication_step`."""

    def __post_init__(self, interval: float | None) -> None:
        if interval is not None:
            if self.communication_step is not None:
                raise InputError(f"recipe of {self}: give communication_step or its former name interval, not both")
            object.__setattr__(self, "communication_step", interval)
        for name, (good, what) in _FORM.items():
            value = getattr(self, name)
            if name in _LISTS and isinstance(value, Iterable):
                value = (value,) if isinstance(value, str) else tuple(value)
            if not good(value):
                raise InputError(f"recipe of {self}: {name} is {value!r}; it must be {what}")
            object.__setattr__(self, name, MappingProxyType({**value}) if isinstance(value, Mapping) else value)
        # Options of the command line have the names of fields of a recipe.
        if self.kind not in list(KINDS):
            raise ExportError(f"{self}: there is no kind {self.kind!r} of FMU; use one of {', '.join(KINDS)}")
        native, python = self.kind == "native", self.kind == "python"
        what = "a native FMU" if native else "an FMU that runs in Python" if python else "an FMU of sources"
        for refused, why in (
            (self.kernel == "oracle", "an FMU cannot contain the oracle, which is for comparison; leave --kernel out"),
            (self.kernel and not python, f"{what} has a kernel of its own; leave --kernel out, or use --kind python"),
            (self.platforms and not native, f"{what} is not built for a platform; leave --platform out"),
            (
                self.interface in ("me", "both") and not native,
                f"{what} supports co-simulation only; leave --interface out, or use --kind native",
            ),
            (
                self.fmi not in (2, 3) or (self.fmi == 3 and python),
                f"there is no {self.kind} FMU of FMI {self.fmi}; use FMI 2, or a native one of FMI 3",
            ),
            (
                "wasm32" in self.platforms and self.fmi == 2,
                "WebAssembly (the draft FMI-LS-WASM) is for FMI 3; add --fmi 3, or leave --platform wasm32 out",
            ),
            (not self.sources and not native, f"{what} has no library in place of its sources; leave --no-sources out"),
            (
                self.derivatives and not native,
                f"{what} has no derivatives; leave --derivatives out, or use --kind native",
            ),
        ):
            if refused:
                raise ExportError(f"{self}: {why}")

    def __str__(self) -> str:
        return self.name or getattr(self.mechanism, "name", str(self.mechanism))

    def said(self) -> str:
        """Return the fields that differ from the defaults, as text."""
        plain = Recipe(self.mechanism)
        own = [f.name for f in fields(self) if f.name != "name" and getattr(self, f.name) != getattr(plain, f.name)]
        texts = {name: getattr(self, name) for name in own}
        return "; ".join(f"{name} {', '.join(x) if isinstance(x, tuple) else _text(x)}" for name, x in texts.items())

    def changed(self, **given: Any) -> Recipe:
        """Return the recipe with other fields, of which None changes nothing; options and parameters are merged.

        Fields that apply to one kind only are dropped if the kind changes.
        """
        given = {name: value for name, value in given.items() if value is not None}
        for name in ("options", "parameters"):
            given[name] = {**getattr(self, name), **given.get(name, {})}
        if given.get("kind", self.kind) != self.kind:
            given = {f.name: f.default for f in fields(self) if f.name in _OF_A_KIND} | given
        return replace(self, **given)

    def in_file(self, path: Path) -> Recipe:
        """Return the recipe that a file declares: named after it, with paths relative to it."""
        from ..model.sources import is_file

        where = self.mechanism
        if isinstance(where, (str, Path)) and is_file(where):
            where = path.parent / where
        return replace(self, mechanism=where, name=self.name or path.stem)

    def declared(self) -> Mechanism:
        """Return the mechanism with its options, locks, releases, measures and compliances, under the name of the
        model."""
        from ..catalogue.registry import load

        mechanism = load(self.mechanism, **self.options)
        if mechanism is self.mechanism:
            if self.lock or self.release or self.compliances or self.measure:
                raise InputError(f"{self}: the mechanism is declared already; give it locks and compliances itself")
            mechanism = copy(mechanism)
        for joint in self.lock:
            mechanism.lock(joint)
        for joint in self.release:
            mechanism.release(joint)
        if self.compliances:
            mechanism.compliances()
        if self.measure:
            mechanism.measure(*(self.measure if list(self.measure) != ["all"] else ()))
        mechanism.name = self.name or mechanism.name
        given = {"stop_time": self.stop_time, "communication_step": self.communication_step}
        own: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
        mechanism.experiment = replace(mechanism.experiment, **own)
        return mechanism


def of(which: str | Path | Mechanism | Recipe) -> Recipe:
    """Return a default recipe for the name of a registered mechanism, else the recipe of a name or a file."""
    from ..catalogue.registry import mechanisms

    return Recipe(which) if isinstance(which, str) and which in mechanisms() else load(which)


def recipes() -> dict[str, Recipe]:
    """Return all registered recipes by name, in alphabetical order."""
    from ..catalogue.registry import registered

    return {name: load(name) for name in registered(GROUP)}


def load(which: str | Path | Mechanism | Recipe) -> Recipe:
    """Return the recipe of a registered name or a Python file; a default one for a mechanism without a recipe.

    A file declares one as a `Recipe` object. Raises InputError if there is no such file, its code fails, or it declares
    several.
    """
    if isinstance(which, Recipe):
        return which
    from ..catalogue.registry import entries, executed

    if str(which).endswith(".py"):
        path = Path(str(which))
        if path.is_file() and not _MAY_DECLARE.search(path.read_bytes()):
            return Recipe(which)  # avoids running the file twice
        return _declared(path, executed(path)) or Recipe(which)
    for entry in entries(GROUP):
        if entry.name == which:
            module = entry.load()
            if found := _declared(Path(module.__file__), vars(module)):
                return found
            raise InputError(f"{entry.value}, registered as the recipe {which}, declares none; give it a Recipe object")
    return Recipe(which)


def _declared(path: Path, names: Mapping[str, Any]) -> Recipe | None:
    """Return the recipe among the names of a file, None if there is none."""
    found = {id(x): x for x in names.values() if isinstance(x, Recipe)}
    if len(found) > 1:
        raise InputError(f"{path} declares {len(found)} recipes; a file declares one, so give each a file")
    return next((recipe.in_file(path) for recipe in found.values()), None)
