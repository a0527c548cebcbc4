"""The public functions, for mechanisms, recipes, FMUs and systems alike; each calls the module that does the work."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .analysis.equilibria import Equilibrium
from .analysis.situation import subject
from .analysis.start import prepare, rest_of, simulated
from .catalogue.registry import load, mechanisms
from .equations import Equations
from .fmi.recipe import Recipe
from .fmi.recipe import load as recipe_of
from .model.errors import AlfmuError, AlfmuWarning, InputError
from .model.files import scratch, write
from .model.mechanism import Mechanism
from .runtime import Instance
from .runtime.shipped import installed
from .simulation import Progress, by_name, checked, finer, run, settings_of
from .simulation.result import Film, Result, Signal

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from matplotlib.figure import Figure

    from .view.picture import Drawing

__all__ = [
    "animate",
    "convert",
    "described",
    "draw",
    "drawing_of",
    "export",
    "installed",
    "load",
    "mechanisms",
    "plot",
    "simulate",
]


def simulate(
    mechanism: str | Path | Mechanism | Equations | Recipe,
    stop_time: float | None = None,
    communication_step: float | None = None,
    *,
    inputs: Mapping[str, Signal] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    start: str | Equilibrium | None = None,
    outputs: Sequence[str] | None = None,
    freeze: Sequence[str] | None = None,
    kernel: str | None = None,
    held_rows: bool = False,
    check: bool = False,
    progress: Progress = iter,
) -> Result:
    """Run a mechanism from 0 to `stop_time` [s] with communication steps of `communication_step` [s].

    `mechanism` is a `Mechanism`, a Python file that declares one, the name of a mechanism or of a recipe, an `.fmu`
    file, a `Recipe`, or equations; an `.ssp` or a `.toml` file is a connected system (`alfmu.System`).

    `parameters` sets parameters, start values and solver variables by name, such as `solver.method`. `inputs` gives
    each input by name as a number, a function of time [s], or a table (times, values) that is interpolated linearly;
    each communication step holds the value at its beginning. Defaults are the mechanism's own. `start` is "declared"
    (the start values, the default), "equilibrium" (at rest in `alfmu.equilibrium(...).nearest`, with the inputs at 0 s)
    or an `Equilibrium`. Only outputs that match `outputs` (names, or patterns such as `link*.angle`) are computed, None
    for all; names such as `link1.angle/A.torque` add entries of the interface Jacobian, the derivative of an output at
    the end of each communication step by an input that is held over it (`["*", "link*.angle/*"]`: all outputs and these
    derivatives). Parameters in `freeze` are folded into the equations. `kernel` is one of `alfmu.kernel.KERNELS`;
    `progress` wraps the communication points to show the progress, for example `tqdm.tqdm`. Runs of one mechanism that
    differ in numbers alone share the traced scene.

    Outputs that depend directly on inputs, such as accelerations and reactions, are evaluated with the inputs set at
    the communication point of their row; with `held_rows`, with the inputs of the step that ends there, as importers
    record them (fmpy, fmusim). The motion is the same.

    With `check` a second run uses a hundredth of the tolerance, or for methods with fixed steps half the step;
    `Result.check` has the deviation, and a warning tells when it exceeds a thousandth.

    Raises AlfmuError if a name, a value or the mechanism is invalid. If this or a KeyboardInterrupt ends a run that has
    begun, the exception's `result` has the rows so far.
    """
    given: dict[str, float | str] = by_name(mechanism, "parameters", parameters)
    if isinstance(mechanism, str | Path) and str(mechanism).lower().endswith((".ssp", ".toml")):
        if not (outputs is freeze is kernel is start is None):
            raise InputError(
                f"{mechanism}: outputs, frozen parameters, the kernel and the start are those of its components; give "
                "them there"
            )
        from .systems.system import System

        if check:
            raise InputError(f"{mechanism}: connected systems are not checked; check each component")
        system = System.load(mechanism)
        more: dict[str, Any] = {"inputs": inputs, "parameters": given, "held_rows": held_rows, "progress": progress}
        return system.simulate(stop_time, communication_step, **more)
    how: dict[str, Any] = {"inputs": inputs, "progress": progress, "held_rows": held_rows}
    if isinstance(mechanism, str | Path) and str(mechanism).endswith(".fmu"):
        if not (outputs is freeze is kernel is start is None):
            raise InputError(
                f"{mechanism}: outputs, frozen parameters, the kernel and the start of an FMU are fixed when it is "
                "exported; give them to alfmu.export()"
            )
        return _simulate_fmu(mechanism, stop_time, communication_step, given, how, check)

    def made(given: dict[str, float | str]) -> tuple[Instance, Result]:
        found = prepare(mechanism, given, inputs, start, outputs, freeze, kernel)
        return found.unit, simulated(found, stop_time, communication_step, **how)

    unit, result = made(given)
    if not check:
        return result
    setting, value = finer(unit.name, settings_of(unit))
    return checked(result, made({**given, setting: value})[1], setting, value)


def _simulate_fmu(
    path: str | Path,
    stop_time: float | None,
    communication_step: float | None,
    parameters: dict[str, float | str],
    how: dict[str, Any],
    check: bool = False,
) -> Result:
    """Run an FMU as `simulate` does."""
    from .fmi.drive import Fmu

    if check:
        with Fmu(path) as fmu:
            setting, value = finer(fmu.name, {**fmu.starts(), **parameters})
        result = _simulate_fmu(path, stop_time, communication_step, parameters, how)
        other = _simulate_fmu(path, stop_time, communication_step, {**parameters, setting: value}, how)
        return checked(result, other, setting, value)
    with Fmu(path) as fmu:
        step = fmu.interval if communication_step is None else communication_step
        facts = fmu.facts(parameters)
        stop_time = fmu.stop_time if stop_time is None else stop_time
        return run(fmu, stop_time, step, parameters=parameters, facts=facts, declared=fmu.declared(), **how)


def export(
    mechanism: str | Path | Mechanism | Recipe,
    path: str | Path | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    outputs: Sequence[str] | None = None,
    freeze: Sequence[str] | None = None,
    kernel: str | None = None,
    start: str | None = None,
    kind: str | None = None,
    platforms: Sequence[str] | None = None,
    fmi: int | None = None,
    interface: str | None = None,
    derivatives: bool | None = None,
    reference: bool | None = None,
    sources: bool | None = None,
) -> Path:
    """Write the FMU of a mechanism or a recipe and return its path, `<name>.fmu` by default.

    A name or a Python file stands for its recipe, or without one for its mechanism. The other arguments are fields of
    `Recipe` and override those of the recipe; entries of `options` and `parameters` do so one by one. The same
    arguments give the same bytes. Raises AlfmuError if the mechanism cannot start from the defaults, ExportError if it
    cannot be compiled, and WriteError if the file cannot be written; no partial file is left.
    """
    from .fmi.export import export as written

    own: dict[str, Any] = {
        "options": options,
        "parameters": parameters,
        "outputs": outputs,
        "freeze": freeze,
        "kernel": kernel,
    }
    own |= {"start": start, "kind": kind, "platforms": platforms, "fmi": fmi, "interface": interface}
    recipe = recipe_of(mechanism).changed(**own, derivatives=derivatives, reference=reference, sources=sources)
    return written(recipe, path, rest_of(recipe))


def convert(
    mechanism: str | Path | Mechanism | Recipe,
    path: str | Path,
    *,
    parameters: Mapping[str, float | str] | None = None,
) -> Path:
    """Write a mechanism as MJCF (`.xml`), URDF (`.urdf`) or SDF (`.sdf`) and return the path.

    Bodies, joints, loops, limits, springs, dampers, friction and inputs have their values at the start given by
    `parameters` and defaults; docs/howto/convert.md lists the abilities of each format. Raises InputError with all that
    the format cannot represent, and warns of omitted rates and inputs at the start.
    """
    from .formats.writers import FORMS, written

    path = Path(path)
    if path.suffix not in FORMS:
        raise InputError(f"{path} is not a file that alfmu converts to; its name must end in one of {', '.join(FORMS)}")
    found = subject(mechanism, parameters)
    names = [c.name for c in found.coordinates]
    numbers = [dict(zip(names, x.tolist(), strict=False)) for x in (found.state.q, found.state.v)] + [found.parameters]
    constraints = found.value("C", found.state)[found.held][:, : len(names)]
    content, linkage = written(found.source.drawn(), numbers, constraints, path.suffix)
    for what in linkage.warned:
        warnings.warn(f"{path}: left out, and may matter: {what}", AlfmuWarning, stacklevel=2)
    write(path, content)
    return path


def described(recipe: Recipe) -> tuple[Element, dict[str, bytes]]:
    """Return the description of an FMU of kind python and the files of its scene, for pythonfmu's own command."""
    from .fmi.export import described as made

    return made(recipe, rest_of(recipe))


def draw(
    mechanism: Mechanism,
    path: str | Path | None = None,
    *,
    at: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    size: tuple[int, int] = (640, 480),
) -> Drawing:
    """Return the picture of a mechanism at its start, and write it to `path` if given; see `Mechanism.draw`."""
    from .view.picture import drawing

    drawn = drawing(mechanism, at, parameters, size)
    if path is not None:
        drawn.save(path)
    return drawn


def plot(result: Result, names: Sequence[str] | None = None) -> Figure:
    """Return a matplotlib figure over time; see `Result.plot`."""
    from .view.plot import figure

    return figure(result, names)


def animate(result: Result, path: str | Path | None, fps: float, speed: float) -> Film | None:
    """Write or return a film of the motion; see `Result.animate`."""
    from .view.drawing import from_data
    from .view.picture import animate

    shown: Any = result.shown()
    if shown is None:
        try:
            shown = from_data(result.facts.get("drawing"))
        except ValueError as error:
            raise InputError(
                f"the result of {result.mechanism} has no drawing ({error}); use alfmu animate RESULT.csv "
                "--mechanism NAME"
            ) from None
    how: dict[str, Any] = {"parameters": result.facts.get("parameters", {}), "fps": fps, "speed": speed}
    if path is not None:
        animate(shown, result, path, **how)
        return None
    with scratch() as folder:
        animate(shown, result, folder / "film.html", **how)
        return Film((folder / "film.html").read_text(encoding="utf-8"))


def drawing_of(result: Result) -> Any:
    """Return the drawing of a result's mechanism as data; None if it is unknown or cannot be drawn."""
    from .view.drawing import as_data
    from .view.shapes import geometry

    try:
        declared, parameters = result.shown(), result.facts.get("parameters", {})
        return result.facts.get("drawing") if declared is None else as_data(geometry(declared, parameters))
    except AlfmuError:
        return None
