"""The command line: parse, call, print."""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .kernel import DEFAULT, KERNELS
from .model.errors import AlfmuError, AlfmuWarning, InputError

if TYPE_CHECKING:
    from .equations import Equations
    from .fmi.recipe import Recipe
    from .model.mechanism import Mechanism
    from .result import Result, Signal

__all__ = ["main", "parser"]

_REPORT = """Beside alfmu's methods, formulations and kernels: SciPy on every mechanism; Pinocchio, Exudyn and MuJoCo on
five_bar and slider_crank (pip install 'alfmu[bench]'). Also in it: tolerances held or not, the study of Blajer (2002)
on particle_on_circle, five_bar and four_bar, what a scene leaves out, small maps of stability (`alfmu stability` has
the full ones). What there was no time for, or what is not installed, is listed. report.html is one file that needs no
network; --quick takes less than a minute for a mechanism. Needs pip install 'alfmu[report]'."""

_EXPORT = """A recipe is a Python file that says what an FMU is made of: `recipe = alfmu.Recipe("five_bar",
outputs=["*.angle"])`. What the options say takes precedence over it, those of --option and --set one by one."""

_SIMULATE = """A run that ends early, by an error or by Ctrl-C, leaves its rows and its picture up to then; the reason
is said last, and the exit code is 1 or 130. Beside the table, FILE.json says what was run and holds its drawing, from
which `alfmu animate` makes a film. What alfmu did not write is replaced only where -o or --plot names it."""

STEP = ("--communication-step", "--step")
"""How the communication step is given: as FMI calls it, or in short."""

SHELLS = ("bash", "zsh", "fish", "powershell")
"""Shells whose completion argcomplete knows."""
_DRAW = """What --at gives holds when the loops are closed; other start values are kept where that is possible, and are
guesses otherwise. Names of coordinates: `alfmu info NAME`."""

_EQUILIBRIUM = """Inputs and start values are those that --set gives; `alfmu simulate --start equilibrium` begins in the
nearest stable position that is found. Stability is that of small motions; where it cannot be judged, as at a singular
position, the reason is shown. Positions that are not found from the places tried may exist. Inputs that move something
are held, laws of time have to stand still at the time of --at, dry friction is left out."""

_LINEARIZE = """States are independent coordinates NAME and their rates der(NAME), inputs and outputs have their names
in FMI. Along a motion the equations are those of the state as if it stood still, laws of time with it. An input that
moves something acts by its value, its rate and its acceleration; joints with dry friction stick or slide as they do in
the state. At a singular position nothing can be said, and the command fails."""

_MOBILITY = """Constraints that are redundant at every position are named with those that they depend on. Where more
motions begin than there are degrees of freedom the position is singular: its branches are given by the rates of
coordinates. Prescribed motions count as constraints, dry friction does not."""

_LIVE = """The page holds the runtime of an FMU, compiled for browsers, and needs no network: its numbers are those of
the native FMU with the same communication steps, to round-off. Inputs count while it runs; a change of a parameter or
of a start value begins again, and so does dragging a body, which sets start values. --set gives what the page begins
with."""

_NAME_HELP = "a registered mechanism (see `alfmu list`), or a Python file that declares one"

_EITHER_HELP = "a registered mechanism or recipe (see `alfmu list`), or a Python file that declares one"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code: 0 done, 1 failed or problems found, 2 wrong usage, 130 interrupted."""
    parser, commands = _parser()
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser)
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words[:1] == ["help"]:
        words = [*words[1:2], "--help"]
    if not words:
        parser.print_help(sys.stderr)
        parser.exit(2)
    if words and not words[0].startswith("-") and words[0] not in commands:
        parser.error(f"there is no command {words[0]!r}; {_perhaps(words[0], commands)}")
    chosen, unknown = parser.parse_known_args(words)
    if unknown:
        sub = commands[words[0]]
        options = re.findall(r"--[\w-]+", sub.format_usage())
        known = f"; {_perhaps(unknown[0].partition('=')[0], options)}" if unknown[0].startswith("-") else ""
        sub.error(f"{unknown[0]} is not understood{known}")
    try:
        with warnings.catch_warnings(), _signals(signal.default_int_handler, signal.SIGTERM):
            # What is under way when a signal comes is put in order.
            warnings.filterwarnings("always", category=AlfmuWarning)
            warnings.showwarning = _printed(warnings.showwarning)
            return chosen.run(chosen) or 0
    except AlfmuError as error:
        return _failed(str(error))
    except BrokenPipeError:  # whoever reads our output has seen enough
        _fall_silent()
        return 0
    except OSError as error:
        return _failed(f"{error.filename or 'the folder for temporary files'}: {error.strerror or error}")
    except MemoryError:
        return _failed("there is not enough memory for this")
    except KeyboardInterrupt:
        return _failed("interrupted", 130)


def _perhaps(word: str, words: Collection[str]) -> str:
    """What to say of a word that is none of these."""
    from .model.words import in_words, nearest

    meant = nearest(word, words)
    return f"did you mean {in_words(meant)}?" if meant else f"use one of {', '.join(words)}"


def _failed(why: str, code: int = 1) -> int:
    """Say why a command failed, after all else that it said."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _fall_silent()
    print(f"alfmu: {why}", file=sys.stderr)
    return code


def _fall_silent() -> None:
    """Say no more where nobody listens, so that the interpreter does not complain about it at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _signals(handler: Callable[..., Any], *signals: signal.Signals) -> Iterator[None]:
    """Handle signals; in the main thread, where Python takes them."""
    main = threading.current_thread() is threading.main_thread()
    before = {each: signal.signal(each, handler) for each in signals if main}
    try:
        yield
    finally:
        for each, old in before.items():
            signal.signal(each, old)


def _printed(otherwise: Callable[..., None]) -> Callable[..., None]:
    """What shows a warning: those of alfmu as one line, once."""
    seen: set[str] = set()

    def show(message: Warning, category: type[Warning], file: str, line: int, *more: Any) -> None:
        if not issubclass(category, AlfmuWarning):
            otherwise(message, category, file, line, *more)
        elif not any(each.startswith(str(message)) for each in seen):
            seen.add(str(message))
            print(f"alfmu: warning: {message}", file=sys.stderr)

    return show


def parser() -> argparse.ArgumentParser:
    """The parser of the command line, from which its page in the documentation is made."""
    return _parser()[0]


def _parser() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """The parser, and those of the commands by name."""
    from importlib.metadata import version

    parser = argparse.ArgumentParser(
        prog="alfmu",
        description="Closed-loop mechanisms as FMUs for co-simulation: export, run, check and watch them.",
        epilog="Exit codes: 0 done, 1 failed or problems found, 2 wrong usage, 130 interrupted. "
        "See `alfmu COMMAND --help`.",
    )
    parser.add_argument("--version", action="version", version=f"alfmu {version('alfmu')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    by_name: dict[str, argparse.ArgumentParser] = {}

    def command(name: str, run: Callable[[argparse.Namespace], int | None], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(run=run)
        by_name[name] = sub
        return sub

    command("list", _list, "list the registered mechanisms")

    sub = command("info", _info, "show a mechanism: sketch, coordinates, constraints, parameters, inputs, outputs")
    _add_name(sub, "mechanism", "NAME", _EITHER_HELP)
    form = sub.add_mutually_exclusive_group()
    form.add_argument("--all", action="store_true", help="all variables with units and descriptions, and what it costs")
    form.add_argument("--json", action="store_true", help="the same as JSON, for programs")
    form.add_argument(
        "--sizes", action="store_true", help="export it as well, to show what its FMUs carry, in kB by part"
    )
    _add_scene(sub)

    sub = command("draw", _draw, "draw a mechanism where it starts, before anything is simulated (PNG or SVG)")
    sub.epilog = _DRAW
    _add_name(sub, "mechanism", "NAME|FILE", _EITHER_HELP)
    sub.add_argument("-o", "--output", metavar="FILE", help=".png or .svg (default: NAME.png here)")
    sub.add_argument(
        "--at",
        metavar="COORD=VALUE",
        action="append",
        type=_pair,
        default=[],
        help="draw it where a start value or a coordinate is this [rad or m]; may be given many times",
    )
    sub.add_argument("--size", metavar="WxH", type=_size, help="width and height in pixels (default: 640x480)")
    _add_option(sub)
    _add_set(sub)

    sub = command("export", _export, "write the FMU (co-simulation) of a recipe or a mechanism")
    sub.epilog = _EXPORT
    _add_name(sub, "mechanism", "NAME", _EITHER_HELP)
    sub.add_argument("-o", "--output", metavar="PATH", help="FMU file or folder to write (default: NAME.fmu here)")
    sub.add_argument(
        "--kind",
        choices=("python", "native"),
        help="python, the default, runs in hosts that have Python; native is C and nothing else, for every host",
    )
    sub.add_argument("--fmi", type=int, choices=(2, 3), help="version of FMI (default: 2); 3 for native FMUs alone")
    sub.add_argument(
        "--platform",
        metavar="all|NAMES",
        type=_names,
        help="what a native FMU runs on, of linux64, win64, darwin64, aarch64-darwin, aarch64-linux, as linux64,win64 "
        "(default: what alfmu came with, this platform at least); others take ziglang (pip install ziglang)",
    )
    _add_kernel(sub)
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of the default experiment in s")
    sub.add_argument(
        *STEP, dest="step", type=float, metavar="S", help="communication step of the default experiment in s"
    )
    _add_start(sub)
    sub.add_argument(
        "--reference",
        action=argparse.BooleanOptionalAction,
        help="have reference results inside (default) or, to be smaller, leave them out",
    )
    _add_scene(sub)

    sub = command("simulate", _simulate, "run a mechanism or an FMU and keep the result as a table and a picture")
    sub.epilog = _SIMULATE
    _add_name(sub, "unit", "NAME|FMU", f"{_EITHER_HELP}, or an .fmu file", ".fmu")
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of the run in s (default: the unit's own)")
    sub.add_argument(
        *STEP, dest="step", type=float, metavar="S", help="communication step in s (default: the unit's own)"
    )
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")
    _add_start(sub)
    sub.add_argument(
        "--held-rows",
        action="store_true",
        help="rows show outputs with the inputs of the step that ends there, as importers record them (fmpy, fmusim); "
        "without it, with the inputs that are set there",
    )
    sub.add_argument("-o", "--output", metavar="FILE.csv", help="where to write the result (default: NAME.csv here)")
    _add_kernel(sub)
    sub.add_argument("--plot", metavar="FILE.png", help="also draw the result (PNG, SVG or PDF)")
    sub.add_argument(
        "--plot-names", metavar="PATTERN", nargs="+", help='what to draw, such as "link*.angle" "*.force.*"'
    )
    _add_scene(sub)

    sub = command("equilibrium", _equilibrium, "find the positions where a mechanism is at rest, stable or not")
    sub.epilog = _EQUILIBRIUM
    _add_analysis(sub, "FILE.json", "write all that is known of them, outputs and reactions included")
    sub.add_argument(
        "--at", metavar="S", type=float, default=0.0, help="time in s for which loads are taken (default: 0)"
    )
    sub.add_argument("--starts", metavar="N", type=int, help="number of places to begin from beside the start")
    sub.add_argument("--draw", metavar="FILE", help="draw the position that a run would begin with (PNG or SVG)")

    sub = command("linearize", _linearize, "linearise a mechanism: A, B, C, D, eigenvalues, mode shapes")
    sub.epilog = _LINEARIZE
    _add_analysis(sub, "FILE.json|.mat", "write matrices and names; .mat is for MATLAB and GNU Octave")
    sub.add_argument(
        "--at",
        metavar="start|equilibrium|S,S,...",
        type=_at,
        default="start",
        help="where: at the start (default), at rest, or at times in s of the motion from the start",
    )
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")
    sub.add_argument(
        "--outputs",
        metavar="PATTERNS",
        type=_names,
        help='the outputs that C and D have, such as "link*.angle,*.force.*" (default: all)',
    )
    sub.add_argument("--plot", metavar="FILE.png", help="draw the eigenvalues in the plane (PNG, SVG or PDF)")
    sub.add_argument("--film", metavar="FILE", help="write a mode as a film (GIF or HTML)")
    sub.add_argument("--mode", metavar="N", type=int, default=1, help="the mode of --film (default: 1, the slowest)")
    sub.add_argument("--amplitude", metavar="A", type=float, help="its largest change of a coordinate in rad")

    sub = command(
        "mobility", _mobility, "count degrees of freedom, name redundant constraints, find singular positions"
    )
    sub.epilog = _MOBILITY
    _add_analysis(sub, "FILE.json", "write all that is known, each singular position with its branches")
    sub.add_argument(
        "--stop-time",
        type=float,
        metavar="S",
        help="follow the motion so long, in s; 0 for the start alone (default: the mechanism's own)",
    )
    sub.add_argument(
        "--at",
        metavar="S",
        type=float,
        default=0.0,
        help="time in s for which laws of time give the start",
    )
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")

    what = "check an FMU: fmpy's validation, a run, reset, rewind, reproducibility, its reference results"
    sub = command("validate", _validate, what)
    sub.add_argument("fmu", metavar="FMU", help="an .fmu file")

    sub = command("animate", _animate, "turn a result into a film that a person can watch (GIF or HTML)")
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
    _add_option(sub)
    _add_set(sub)

    sub = command("live", _live, "write a page that runs a mechanism in a browser, with sliders, as one file")
    sub.epilog = _LIVE
    _add_name(sub, "mechanism", "NAME", _EITHER_HELP)
    sub.add_argument("-o", "--output", metavar="PAGE.html", help="where to write the page (default: NAME.html here)")
    sub.add_argument(
        *STEP, dest="step", type=float, metavar="S", help="communication step in s (default: the mechanism's own)"
    )
    _add_scene(sub)

    sub = command("report", _report, "measure error against run time, in every way to run it and beside others")
    _add_study(sub, "report.html, its numbers as CSV files, and pictures", "within a quarter of an hour for all")
    sub.epilog = _REPORT
    sub = command("stability", _stability, "map where a mechanism runs, gets inexact or fails, and how")
    _add_study(sub, "stability.md, its numbers as CSV files, and maps", "within an hour for all")

    sub = command("completion", _completion, "print what makes a shell complete the names of commands and mechanisms")
    sub.add_argument("shell", choices=SHELLS, help='for bash, put this into ~/.bashrc: eval "$(alfmu completion bash)"')
    return parser, by_name


def _add_name(sub: argparse.ArgumentParser, name: str, metavar: str, text: str, *suffixes: str) -> None:
    """What is shown or run: a name, or a file with one of the suffixes, `.py` at least."""

    def known(prefix: str, **_: Any) -> list[str]:
        from .fmi.recipe import GROUP as RECIPES
        from .model.registry import GROUP, registered

        return registered(GROUP, RECIPES) + _files(prefix, (".py", *suffixes))

    sub.add_argument(name, metavar=metavar, help=text).completer = known  # type: ignore[attr-defined]


def _files(prefix: str, suffixes: tuple[str, ...]) -> list[str]:
    """Files and folders that a word on the command line may be the beginning of."""
    folder = Path(prefix if prefix.endswith("/") else os.path.dirname(prefix) or ".")
    base = prefix[: prefix.rfind("/") + 1]
    found = list(folder.iterdir()) if folder.is_dir() else []
    return [f"{base}{each.name}{'/' * each.is_dir()}" for each in found if each.is_dir() or each.suffix in suffixes]


def _add_study(sub: argparse.ArgumentParser, what: str, usual: str) -> None:
    sub.add_argument("mechanism", metavar="NAME|all", help=f"{_NAME_HELP}; or all that are registered")
    sub.add_argument("-o", "--output", metavar="DIR", required=True, help=f"folder for {what}")
    sub.add_argument("--quick", action="store_true", help=f"few and short runs: some minutes for all (usual: {usual})")


def _add_start(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--start",
        choices=("declared", "equilibrium"),
        help="where it starts: at its start values (default), or at rest in the nearest position where loads and "
        "springs balance, a stable one if there is any (see `alfmu equilibrium`)",
    )


def _add_analysis(sub: argparse.ArgumentParser, files: str, what: str) -> None:
    """What all analyses have in common."""
    _add_name(sub, "mechanism", "NAME", _EITHER_HELP)
    sub.add_argument("--json", action="store_true", help="print all of it as JSON, for programs")
    sub.add_argument("-o", "--output", metavar=files, help=what)
    _add_option(sub)
    _add_set(sub)


def _add_kernel(sub: argparse.ArgumentParser) -> None:
    each = "; ".join(f"{name}, {text}" for name, text in KERNELS.items())
    sub.add_argument(
        "--kernel",
        choices=list(KERNELS),
        help=f"what runs the method (default: {DEFAULT}): {each}",
    )


def _add_scene(sub: argparse.ArgumentParser) -> None:
    """What a scene consists of."""
    _add_option(sub)
    _add_set(sub)
    sub.add_argument(
        "--outputs",
        metavar="PATTERNS",
        type=_names,
        help='compute these outputs alone, such as "link*.angle,*.force.*" (default: all)',
    )
    sub.add_argument(
        "--freeze",
        metavar="all|NAMES",
        type=_names,
        help="make parameters of the mechanism constants at their values, as m1,m2 or all: smaller and faster",
    )
    sub.add_argument(
        "--compliances",
        action=argparse.BooleanOptionalAction,
        help="add a compliance of each constraint as a parameter: redundant constraints share a load accordingly",
    )
    sub.add_argument(
        "--lock",
        metavar="JOINTS",
        type=_names,
        help="joints that Boolean inputs JOINT.locked can stop while running, as B,C",
    )
    sub.add_argument(
        "--release",
        metavar="JOINTS",
        type=_names,
        help="joints that Boolean inputs JOINT.released can open while running, as E,F",
    )
    sub.add_argument(
        "--measure",
        metavar="all|NAMES",
        type=_names,
        help="joints and springs whose relative motion, elongation and force are outputs, as B,C or all",
    )


def _changed(chosen: argparse.Namespace, recipe: Recipe) -> Recipe:
    """A recipe with what the command line says of its scene."""
    of_scene = ("outputs", "freeze", "lock", "release", "measure", "compliances", "start")
    own = {name: getattr(chosen, name, None) for name in of_scene}
    return recipe.changed(options=dict(chosen.option), parameters=dict(chosen.set), **own)


def _recipe(chosen: argparse.Namespace, name: str) -> Recipe:
    """What is shown or run: a mechanism, or a recipe where no mechanism is called so."""
    from .fmi.recipe import of

    return _changed(chosen, of(name))


def _equations(recipe: Recipe, mechanism: Mechanism) -> Equations:
    """The equations of a recipe; what it sets may look like another unit, as what a mechanism declares may."""
    from .equations.derivation import derive
    from .model.checks import perhaps_degrees, perhaps_millimetres
    from .runtime.prepare import with_defaults

    equations = with_defaults(derive(mechanism), recipe.parameters)
    own = recipe.parameters
    for v in (v for v in (*equations.starts, *equations.parameters) if v.unit == "rad" and v.name in own):
        perhaps_degrees(f"{equations.name}: {v.name}", v.start)
    for v in (v for v in equations.parameters if v.unit == "m" and v.name in own):
        perhaps_millimetres(f"{equations.name}: {v.name}", v.start)
    return equations


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _add_set(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        type=_pair,
        default=[],
        help="a parameter, start value, input or solver variable; may be given many times",
    )


def _add_option(sub: argparse.ArgumentParser) -> None:
    sub.add_argument(
        "--option",
        metavar="KEY=VALUE",
        action="append",
        type=_pair,
        default=[],
        help="an option of the mechanism, such as coordinates=natural; may be given many times",
    )


def _pair(text: str) -> tuple[str, float | str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    try:
        return name, float(value)
    except ValueError:
        return name, value


def _at(text: str) -> str | float | list[float]:
    """A place, a time, or several."""
    from .analysis.states import PLACES

    if text in PLACES:
        return text
    try:
        times = [float(each) for each in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(PLACES)}, and no times in s") from None
    return times if len(times) > 1 else times[0]


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{2,4})x(\d{2,4})", text)
    if not found:
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT in pixels, such as 800x600")
    return int(found[1]), int(found[2])


# Commands ------------------------------------------------------------------------------------------------------------


def _list(chosen: argparse.Namespace) -> None:
    from .fmi.recipe import recipes
    from .model.registry import choices, load, mechanisms

    for name in mechanisms():
        print(f"{name:20} {load(name).description}")
        for option, values in choices(name).items():
            print(f"{'':20}   --option {option}={'|'.join(values)}")
    for name, recipe in recipes().items():
        if said := recipe.said():
            print(f"{name:20} FMU of {recipe.mechanism}: {said}")


def _info(chosen: argparse.Namespace) -> None:
    from .studies.about import about, in_all, in_short

    recipe = _recipe(chosen, chosen.mechanism)
    mechanism = recipe.declared()
    found = about(recipe, mechanism, _equations(recipe, mechanism))
    if chosen.json:
        print(json.dumps(found.as_data(), indent=1, default=str))
        return
    print("\n".join(in_all(found) if chosen.all else in_short(found)))
    if chosen.sizes:
        from .fmi.sizes import sizes

        print("\n" + "\n".join(sizes(mechanism, recipe.parameters, recipe.outputs, recipe.freeze)))


def _draw(chosen: argparse.Namespace) -> None:
    from .view.picture import SIZE, check_drawing, drawing

    path = Path(chosen.output or f"{_file_name(Path(chosen.mechanism).stem)}.png")
    check_drawing(path)
    recipe = _recipe(chosen, chosen.mechanism)
    drawn = drawing(recipe.declared(), dict(chosen.at), recipe.parameters, chosen.size or SIZE)
    said = _wrote(path)
    drawn.save(path)
    print(said)


def _export(chosen: argparse.Namespace) -> None:
    from .fmi.export import export
    from .fmi.native import libraries_in
    from .fmi.recipe import load

    recipe = _changed(chosen, load(chosen.mechanism)).changed(
        kind=chosen.kind,
        fmi=chosen.fmi,
        platforms=chosen.platform,
        kernel=chosen.kernel,
        stop_time=chosen.stop_time,
        communication_step=chosen.step,
        reference=chosen.reference,
    )
    older = {each.resolve() for each in Path(chosen.output or ".").glob("*.fmu")}  # none where -o names the file
    path = export(recipe, chosen.output)
    said = "replaced" if path.resolve() in older else "wrote"
    platforms = libraries_in(path, recipe.kind)
    where = "every host" if recipe.kind == "native" else "hosts with Python (use --kind native for others)"
    print(f"{said} {path} ({path.stat().st_size / 1000:.0f} kB), kind {recipe.kind}: {where} on {', '.join(platforms)}")


def _simulate(chosen: argparse.Namespace) -> None:
    from .result import read_inputs
    from .simulation import run
    from .studies.about import notes

    inputs = read_inputs(chosen.input) if chosen.input else {}
    if chosen.plot_names and not chosen.plot:
        raise InputError("--plot-names needs --plot FILE")
    if chosen.plot:
        from .view.plot import check_name

        check_name(Path(chosen.plot))
    unit, own = _unit(chosen, inputs)
    asked = {"stop_time": chosen.stop_time, "communication_step": chosen.step}
    how = {**own, **{name: value for name, value in asked.items() if value is not None}}
    try:
        table = _table_path(chosen, unit.name)
        with _between_steps(_progress("simulating")) as progress:
            result = run(unit, **how, inputs=inputs, progress=progress, held_rows=chosen.held_rows)
        said = notes(unit)
    except (AlfmuError, KeyboardInterrupt) as ended:
        result = getattr(ended, "result", None)
        if result is not None:
            try:
                _keep(chosen, result, table)
            except AlfmuError as error:
                _failed(str(error))
            except BrokenPipeError:
                _fall_silent()
        raise
    finally:
        if hasattr(unit, "close"):
            unit.close()
    for note in said:
        print(note)
    _keep(chosen, result, table)


def _table_path(chosen: argparse.Namespace, name: str) -> Path:
    """Where the table of a run goes; InputError where it, or the facts beside it, would replace something else."""
    from .result import facts_beside, facts_in

    table = Path(chosen.output or f"{_file_name(name)}.csv")
    if table.suffix.lower() != ".csv":
        raise InputError(f"{table} cannot hold a table; its name must end in .csv")
    if chosen.input and table.resolve() == Path(chosen.input).resolve():
        raise InputError(f"{table} has the inputs of the run and would be replaced; name another file with -o")
    facts = facts_beside(table)
    theirs = facts if facts.exists() else table if table.exists() and not chosen.output else None
    if theirs and not facts_in(facts):
        raise InputError(f"{theirs} is there and was not written by alfmu; name another file with -o, or remove it")
    return table


def _file_name(name: str) -> str:
    """A name of a model, which may be any text, as that of a file here."""
    return re.sub(r"[^\w.+-]+", "_", name).strip("._")[:60] or "result"


def _keep(chosen: argparse.Namespace, result: Result, table: Path) -> None:
    """Write what a run gave, then say so."""
    said: list[str] = []
    try:
        wrote = _wrote(table)
        result.to_csv(table)
        if (c := result.counters) is not None:
            said += [
                f"{c.steps} steps, {c.evaluations} evaluations, {c.multiplier_iterations} multiplier iterations "
                f"({c.unconverged} evaluations without convergence), {c.projection_iterations} projections "
                f"({c.unprojected} steps left above the tolerance)",
                f"largest |Phi| {c.position_error:.1e}, |Phi-dot| {c.velocity_error:.1e}, |Phi-ddot| "
                f"{c.acceleration_error:.1e}, energy balance {c.energy_error:.1e} J",
            ]
            from .model.settings import UNBALANCED

            if c.run_error > UNBALANCED:
                said += [f"WARNING: off by {c.run_error:.2g} of the energy of the motion, as warned of above"]
        said += [f"{wrote} ({len(result.time)} rows up to {result.time[-1]:g} s, {len(result.names) + 1} columns)"]
        if chosen.plot:
            from .view.plot import plot

            wrote = _wrote(Path(chosen.plot))
            plot(result, chosen.plot, chosen.plot_names)
            said += [wrote]
    finally:
        for line in said:
            print(line)


def _wrote(path: Path) -> str:
    """What to say once a file is written."""
    return f"replaced {path}" if path.exists() else f"wrote {path}"


@contextmanager
def _between_steps(progress: Callable[..., Iterable[Any]]) -> Iterator[Callable[..., Iterable[Any]]]:
    """A progress that an interrupt ends between two steps, where FMU and rows are whole; a second one at once."""
    asked: list[int] = []

    def ask(number: int, frame: object) -> None:
        asked.append(number)
        if len(asked) > 1:
            raise KeyboardInterrupt

    def checked(steps: Sequence[Any]) -> Iterator[Any]:
        with closing(iter(progress(steps))) as shown:
            for step in shown:
                if asked:
                    raise KeyboardInterrupt
                yield step

    checked.ended = lambda: bool(asked)  # type: ignore[attr-defined]
    with _signals(ask, signal.SIGINT, signal.SIGTERM):
        yield checked


def _unit(chosen: argparse.Namespace, inputs: Mapping[str, Signal]) -> tuple[Any, dict[str, Any]]:
    """What to run, and how where nobody says otherwise."""
    if chosen.unit.endswith(".fmu"):
        from .fmi.drive import Fmu

        if any(
            (
                chosen.option,
                chosen.kernel,
                chosen.outputs,
                chosen.freeze,
                chosen.lock,
                chosen.release,
                chosen.measure,
                chosen.compliances,
                chosen.start,
            )
        ):
            raise InputError(
                f"{chosen.unit}: options, outputs, frozen parameters, locks, the start and the kernel of an FMU are "
                "fixed when it is exported; give them to `alfmu export`"
            )
        fmu, given = Fmu(chosen.unit), dict(chosen.set)
        about = {"parameters": given, "facts": fmu.facts(given), "declared": fmu.declared()}
        return fmu, {**about, "stop_time": fmu.stop_time, "communication_step": fmu.interval}
    from .equations.specialisation import specialised
    from .simulation import instance

    recipe = _recipe(chosen, chosen.unit)
    mechanism = recipe.declared()
    equations = _equations(recipe, mechanism)
    if recipe.start != "declared":
        from .analysis.states import rest
        from .equations.specialisation import starting_at

        found = rest(equations, recipe.start, inputs)
        equations = starting_at(equations, found.q, found.states, found.kept)
        print(f"start at rest: {found.said()}")
    unit = instance(specialised(equations, recipe.outputs, recipe.freeze), chosen.kernel or recipe.kernel or DEFAULT)
    source = recipe.mechanism if isinstance(recipe.mechanism, (str, Path)) else chosen.unit
    facts = {"mechanism": str(source), "options": mechanism.options, "parameters": dict(recipe.parameters)}
    about = {"parameters": {}, "facts": facts, "declared": mechanism}
    return unit, {**about, "stop_time": equations.stop_time, "communication_step": equations.interval}


def _equilibrium(chosen: argparse.Namespace) -> None:
    from .analysis.equilibria import STARTS, check_file, equilibrium
    from .view.picture import check_drawing

    path, drawn = (Path(x) if x else None for x in (chosen.output, chosen.draw))
    if path:
        check_file(path)
    if drawn:
        check_drawing(drawn)
    starts = STARTS if chosen.starts is None else chosen.starts
    found = equilibrium(_recipe(chosen, chosen.mechanism), time=chosen.at, starts=starts)
    _analysed(chosen, [found], path, found.save)
    if drawn:
        wrote = _wrote(drawn)
        found.nearest.draw().save(drawn)
        _noted(chosen, wrote)


def _linearize(chosen: argparse.Namespace) -> None:
    from .analysis.linearization import AMPLITUDE, check_file, figure, linearize, save
    from .result import read_inputs
    from .view.picture import check_film
    from .view.plot import check_name

    path, plot, film = (Path(x) if x else None for x in (chosen.output, chosen.plot, chosen.film))
    for each, check in ((path, check_file), (plot, check_name), (film, check_film)):
        if each:
            check(each)
    if film and isinstance(chosen.at, list):
        raise InputError("--film shows the modes of one state; give --at one place or time")
    inputs = read_inputs(chosen.input) if chosen.input else {}
    made = linearize(_recipe(chosen, chosen.mechanism), chosen.at, inputs=inputs, outputs=chosen.outputs)
    found = made if isinstance(made, list) else [made]
    _analysed(chosen, found, path, lambda path: save(found, path))
    if plot:
        wrote = _wrote(plot)
        figure(found, plot)
        _noted(chosen, wrote)
    if film:
        wrote = _wrote(film)
        found[0].film(film, chosen.mode, amplitude=AMPLITUDE if chosen.amplitude is None else chosen.amplitude)
        _noted(chosen, wrote)


def _mobility(chosen: argparse.Namespace) -> None:
    from .analysis.freedoms import check_file, mobility
    from .result import read_inputs

    path = Path(chosen.output) if chosen.output else None
    if path:
        check_file(path)
    inputs = read_inputs(chosen.input) if chosen.input else {}
    found = mobility(
        _recipe(chosen, chosen.mechanism),
        stop_time=chosen.stop_time,
        inputs=inputs,
        time=chosen.at,
        progress=_progress("following the motion"),
    )
    _analysed(chosen, [found], path, found.save)


def _analysed(
    chosen: argparse.Namespace, found: Sequence[Any], path: Path | None, save: Callable[[Path], None]
) -> None:
    """Print what an analysis found, and write it where that is asked for."""
    if chosen.json:
        data = [each.as_data() for each in found]
        print(json.dumps(data[0] if len(data) == 1 else data, indent=1))
    else:
        print("\n\n".join("\n".join(each.lines()) for each in found))
    if path:
        wrote = _wrote(path)
        save(path)
        _noted(chosen, wrote)


def _noted(chosen: argparse.Namespace, text: str) -> None:
    """Say what was written; beside JSON, where it is not in the way."""
    print(text, file=sys.stderr if chosen.json else sys.stdout)


def _validate(chosen: argparse.Namespace) -> int:
    from .fmi.drive import validate

    problems = validate(chosen.fmu)
    for problem in problems:
        print(problem)
    print(f"{chosen.fmu}: {len(problems)} problem{'s' * (len(problems) != 1)} found")
    return int(bool(problems))


def _animate(chosen: argparse.Namespace) -> None:
    from .model.registry import load
    from .result import Result, facts_beside
    from .view.drawing import from_data
    from .view.picture import animate, check_film

    path = Path(chosen.output or Path(chosen.result).with_suffix(".gif"))
    check_film(path)
    if Path(chosen.result).suffix.lower() in (".py", ".fmu"):
        raise InputError(f"{chosen.result} is no result; `alfmu simulate` makes one of it, a table that ends in .csv")
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
            why = f"{beside.name} has no drawing ({error})" if facts else f"alfmu wrote no {beside.name} beside it"
            raise InputError(f"{chosen.result}: {why}; say which mechanism it is with --mechanism") from None
    parameters = {**facts.get("parameters", {}), **dict(chosen.set)}
    how = {"parameters": parameters, "fps": chosen.fps, "speed": chosen.speed, "progress": _progress("drawing")}
    said = _wrote(path)
    animate(shown, result, path, **how)
    print(said)


def _scene_options(chosen: argparse.Namespace) -> list[str]:
    """What was said of a scene, as options of the command line."""
    said = [
        text
        for name in ("option", "set")
        for key, value in getattr(chosen, name)
        for text in (f"--{name}", f"{key}={value}")
    ]
    for name in ("outputs", "freeze", "lock", "release", "measure"):
        if (names := getattr(chosen, name)) is not None:
            said += [f"--{name}", ",".join(names)]
    if chosen.compliances is not None:
        said += ["--compliances" if chosen.compliances else "--no-compliances"]
    return said


def _live(chosen: argparse.Namespace) -> None:
    from .equations.specialisation import specialised
    from .view.live import live, needed, written_by_alfmu

    recipe = _recipe(chosen, chosen.mechanism).changed(communication_step=chosen.step)
    mechanism = recipe.declared()
    path = Path(chosen.output or f"{_file_name(mechanism.name)}.html")
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path} cannot hold a page; its name must end in .html")
    if path.exists() and not chosen.output and not written_by_alfmu(path):
        raise InputError(f"{path} is there and was not written by alfmu live; name another file with -o, or remove it")
    outputs = None if recipe.outputs is None else [*recipe.outputs, *needed(mechanism)]
    equations = specialised(_equations(recipe, mechanism), outputs, recipe.freeze)
    said = _wrote(path)
    source = shlex.join([Path(chosen.mechanism).name, *_scene_options(chosen)])
    live(mechanism, equations, path, parameters=recipe.parameters, source=source)
    print(f"{said} ({path.stat().st_size / 1000:.0f} kB); open it in a browser")


def _report(chosen: argparse.Namespace) -> None:
    from .studies.report import report

    _study(chosen, report)


def _stability(chosen: argparse.Namespace) -> None:
    from .studies.stability import stability

    _study(chosen, stability)


def _study(chosen: argparse.Namespace, write: Callable[..., Path]) -> None:
    """Write a study of one mechanism or of all."""
    from .model.registry import mechanisms

    names = mechanisms() if chosen.mechanism == "all" else [chosen.mechanism]
    try:
        print(f"wrote {write(names, chosen.output, chosen.quick, lambda name: _progress(name, 'case'))}")
    except OSError as error:
        raise InputError(f"cannot write into {chosen.output} ({error.strerror or error})") from None


def _completion(chosen: argparse.Namespace) -> None:
    try:
        from argcomplete import shellcode
    except ImportError:
        raise InputError("completion needs argcomplete; install it with: pip install 'alfmu[completion]'") from None
    print(shellcode(["alfmu"], shell=chosen.shell))


def _progress(what: str, unit: str = "step") -> Callable[[Iterable[Any]], Iterable[Any]]:
    """A progress bar on a terminal, for what takes longer than a second."""
    from tqdm import tqdm

    return lambda steps: tqdm(steps, desc=what, unit=unit, delay=1.0, disable=None, leave=False)


if __name__ == "__main__":
    sys.exit(main())
