"""Commands for runs: simulate, animate."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..kernel import DEFAULT
from ..model.errors import AlfmuError, InputError

if TYPE_CHECKING:
    from ..simulation.result import Result, Signal

from ..model.files import path_for
from .options import (
    EITHER_HELP,
    Command,
    add_kernel,
    add_name,
    add_option,
    add_scene,
    add_set,
    add_start,
    add_step,
    chosen_recipe,
    equations_of,
    file_name,
    file_of,
    inputs_of,
    refuse_scene_of_fmu,
)
from .says import between_steps, failed, fall_silent, once_written, progress_bar, save_file

_SIMULATE = """A run that ends early, by an error or by Ctrl-C, keeps its rows and its picture up to then; the reason
is printed last, and the exit code is 1 or 130. Beside the table, FILE.json describes the run and holds its drawing,
from which `alfmu animate` makes a film. A file that alfmu did not write is replaced only if -o or --plot names it."""


def add(command: Command) -> None:
    sub = command("simulate", _simulate, "run a mechanism or an FMU and keep the result as a table and a picture")
    sub.epilog = _SIMULATE
    add_name(sub, "unit", "NAME|FMU", f"{EITHER_HELP}, or an .fmu file", ".fmu")
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of the run in s (default: the unit's own)")
    add_step(sub, "communication step in s (default: the unit's own)")
    add_start(sub)
    sub.add_argument(
        "--check",
        action="store_true",
        help="run it again with a hundredth of the tolerance (with fixed steps, half the step size), and print the "
        "difference",
    )
    add_table(sub)
    add_kernel(sub)
    add_scene(sub)

    sub = command("animate", _animate, "turn a result into a film (GIF or HTML)")
    sub.add_argument(
        "result", metavar="RESULT.csv", help="a result that `alfmu simulate` wrote, or any CSV with its names"
    )
    sub.add_argument("-o", "--output", metavar="FILE", help=".gif or .html (default: RESULT.gif)")
    sub.add_argument(
        "--mechanism",
        metavar="NAME",
        help="draw this mechanism, a registered name or a Python file, which is run, with --option and --set as in "
        "the run (default: the drawing in the .json beside the result)",
    )
    sub.add_argument("--fps", type=float, default=25.0, help="frames per second (default: %(default)g)")
    sub.add_argument("--speed", type=float, default=1.0, help="times real time (default: %(default)g)")
    add_option(sub)
    add_set(sub)


def _simulate(chosen: argparse.Namespace) -> None:
    from ..simulation import run
    from ..studies.about import gravity, notes

    inputs = given_inputs(chosen)
    unit, own = _unit(chosen, inputs)

    def summary(result: Result) -> list[str]:
        declared = result.declared
        if declared is None or not (declared.bodies or declared.spatial_bodies):
            return notes(unit)
        own = {p.name for p in declared.parameters}
        values = {name: float(x) for name, x in result.facts.get("parameters", {}).items() if name in own}
        return [*notes(unit), gravity(declared, values, result)]

    asked = {"stop_time": chosen.stop_time, "communication_step": chosen.step}
    how = {name: value for name, value in asked.items() if value is not None}
    how = {**how, "inputs": inputs, "held_rows": chosen.held_rows}

    def made(progress: Callable[..., Iterable[Any]]) -> Result:
        result = run(unit, **{**own, **how}, progress=progress)
        return _checked(chosen, unit, result, {**how, "progress": progress}) if chosen.check else result

    try:
        run_and_keep(chosen, unit.name, made, summary)
    finally:
        _close(unit)


def _close(unit: Any) -> None:
    if hasattr(unit, "close"):
        unit.close()


def _checked(chosen: argparse.Namespace, unit: Any, result: Result, how: Mapping[str, Any]) -> Result:
    """Return the result with its deviation from a run with a finer setting."""
    from ..simulation import checked, finer, run, settings_of

    known = {**unit.starts(), **dict(chosen.set)} if chosen.unit.endswith(".fmu") else settings_of(unit)
    setting, value = finer(unit.name, known)
    again = argparse.Namespace(**{**vars(chosen), "set": [*chosen.set, (setting, value)]})
    other, own = _unit(again, how["inputs"])
    try:
        return checked(result, run(other, **{**own, **how}), setting, value)
    finally:
        _close(other)


def run_and_keep(
    chosen: argparse.Namespace,
    name: str,
    run: Callable[[Callable[..., Iterable[Any]]], Result],
    notes: Callable[[Result], Iterable[str]] = lambda result: (),
) -> None:
    """Run with progress, and write the rows as a table and a plot, also if the run ends early.

    Notes are printed if the run reaches its end.
    """
    table = _table_path(chosen, name)
    try:
        with between_steps(progress_bar("simulating")) as progress:
            result = run(progress)
        said = notes(result)
    except (AlfmuError, KeyboardInterrupt) as ended:
        made = getattr(ended, "result", None)
        if made is not None:
            try:
                _keep(chosen, made, table)
            except AlfmuError as error:
                failed(str(error))
            except BrokenPipeError:
                fall_silent()
        raise
    for note in said:
        print(note)
    _keep(chosen, result, table)


def add_table(sub: argparse.ArgumentParser) -> None:
    """Add the options for the table of a run."""
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")
    sub.add_argument("-o", "--output", metavar="FILE.csv", help="where to write the result (default: NAME.csv here)")
    sub.add_argument("--plot", metavar="FILE.png", help="also draw the result (PNG, SVG or PDF)")
    sub.add_argument(
        "--plot-names",
        metavar="PATTERN",
        nargs="+",
        action="extend",
        help='what to draw, such as "link*.angle" "*.force.*"',
    )
    sub.add_argument(
        "--held-rows",
        action="store_true",
        help="rows show outputs with the inputs of the step that ends there, as importers record them (fmpy, fmusim); "
        "without it, with the inputs that are set there",
    )
    sub.add_argument("--verbose", action="store_true", help="also print counts of the solver's work, and its errors")


def given_inputs(chosen: argparse.Namespace) -> dict[str, Signal]:
    """Return inputs over time from a file, after checking the names to be plotted."""
    inputs = inputs_of(chosen)
    if chosen.plot_names and not chosen.plot:
        raise InputError("--plot-names needs --plot FILE")
    file_of("a plot", chosen.plot)
    return inputs


def _unit(chosen: argparse.Namespace, inputs: Mapping[str, Signal]) -> tuple[Any, dict[str, Any]]:
    """Return the unit to run, and default arguments of the run."""
    if chosen.unit.endswith(".fmu"):
        from ..fmi.drive import Fmu

        refuse_scene_of_fmu(chosen, chosen.unit)
        fmu, given = Fmu(chosen.unit), dict(chosen.set)
        about = {"parameters": given, "facts": fmu.facts(given), "declared": fmu.declared()}
        return fmu, {**about, "stop_time": fmu.stop_time, "communication_step": fmu.interval}
    from ..equations.specialisation import specialised
    from ..simulation import instance

    recipe = chosen_recipe(chosen, chosen.unit)
    mechanism = recipe.declared()
    equations = equations_of(recipe, mechanism)
    if recipe.start != "declared":
        from ..analysis.states import rest
        from ..equations.specialisation import starting_at

        found = rest(equations, recipe.start, inputs)
        equations = starting_at(equations, found.q, found.states, found.kept)
        print(f"start at rest: {found.said()}")
    unit = instance(specialised(equations, recipe.outputs, recipe.freeze), chosen.kernel or recipe.kernel or DEFAULT)
    source = recipe.mechanism if isinstance(recipe.mechanism, (str, Path)) else chosen.unit
    facts = {"mechanism": str(source), "options": mechanism.options, "parameters": dict(recipe.parameters)}
    about = {"parameters": {}, "facts": facts, "declared": mechanism}
    return unit, {**about, "stop_time": equations.stop_time, "communication_step": equations.interval}


def _table_path(chosen: argparse.Namespace, name: str) -> Path:
    """Return the path of the table of a run; raise InputError if it, or its `.json`, would replace another file."""
    from ..simulation.result import facts_beside, facts_in

    table = path_for("a table", chosen.output or f"{file_name(name)}.csv")
    if chosen.input and table.resolve() == Path(chosen.input).resolve():
        raise InputError(f"{table} holds the inputs of the run and would be overwritten; name another file with -o")
    facts = facts_beside(table)
    theirs = facts if facts.exists() else table if table.exists() and not chosen.output else None
    if theirs and not facts_in(facts):
        raise InputError(f"{theirs} exists and was not written by alfmu; name another file with -o, or remove it")
    return table


def _keep(chosen: argparse.Namespace, result: Result, table: Path) -> None:
    """Write the results of a run, and print their paths."""
    said: list[str] = []
    try:
        wrote = once_written(table)
        result.to_csv(table)
        if (c := result.counters) is not None:
            said += chosen.verbose * [
                f"{c.steps} steps, {c.evaluations} evaluations, {c.multiplier_iterations} multiplier iterations "
                f"({c.unconverged} evaluations without convergence), {c.projection_iterations} projections "
                f"({c.unprojected} steps left above the tolerance)",
                f"largest |Phi| {c.position_error:.1e}, |Phi-dot| {c.velocity_error:.1e}, |Phi-ddot| "
                f"{c.acceleration_error:.1e}, energy balance {c.energy_error:.1e} J",
            ]
            from ..model.settings import UNBALANCED

            if c.run_error > UNBALANCED:
                off = f"off by {c.run_error:.2g} of the energy of the motion"
                said += [f"WARNING: the energy balance is {off}; see the warning above"]
        said += [str(result.check)] if result.check else []
        said += [f"{wrote} ({len(result.time)} rows up to {result.time[-1]:g} s, {len(result.names) + 1} columns)"]
        if chosen.plot:
            from ..view.plot import plot

            wrote = once_written(Path(chosen.plot))
            plot(result, chosen.plot, chosen.plot_names)
            said += [wrote]
    finally:
        for line in said:
            print(line)


def _animate(chosen: argparse.Namespace) -> None:
    from ..catalogue.registry import load
    from ..simulation.result import Result, facts_beside
    from ..view.drawing import from_data
    from ..view.picture import animate

    path = path_for("a film", chosen.output or Path(chosen.result).with_suffix(".gif"))
    if Path(chosen.result).suffix.lower() in (".py", ".fmu"):
        raise InputError(f"{chosen.result} is not a result; `alfmu simulate` writes one, a table that ends in .csv")
    result = Result.from_csv(chosen.result)
    facts = result.facts
    if chosen.mechanism:
        shown: Any = load(chosen.mechanism, **dict(chosen.option))
    elif chosen.option or chosen.set:
        raise InputError("--option and --set say how --mechanism is drawn; give that as well")
    else:
        try:
            shown = from_data(facts.get("drawing"))
        except ValueError as error:
            beside = facts_beside(chosen.result)
            why = (
                f"{beside.name} has no drawing ({error})" if facts else f"there is no {beside.name} of alfmu beside it"
            )
            raise InputError(f"{chosen.result}: {why}; say which mechanism it is with --mechanism") from None
    parameters = {**facts.get("parameters", {}), **dict(chosen.set)}
    how = {"parameters": parameters, "fps": chosen.fps, "speed": chosen.speed, "progress": progress_bar("drawing")}
    save_file(path, lambda path: animate(shown, result, path, **how))
