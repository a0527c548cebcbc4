"""Commands that analyse: equilibrium, linearize, mobility."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..model.errors import InputError
from .options import EITHER_HELP, Command, add_name, add_option, add_set, chosen_recipe, name_list
from .says import once_written, progress_bar, say

_EQUILIBRIUM = """Inputs are those of --input at the time of --at, or those that --set gives, as start values are;
`alfmu simulate --start equilibrium` begins in the nearest stable position that is found. Stability is that of small
motions; where it cannot be judged, as at a singular position, the reason is shown. Positions that are not found from
the places tried may exist. Inputs that move something are held, laws of time have to stand still at the time of --at,
dry friction is left out."""

_LINEARIZE = """States are independent coordinates NAME and their rates der(NAME), inputs and outputs have their names
in FMI. Along a motion the equations are those of the state as if it stood still, laws of time with it. An input that
moves something acts by its value, its rate and its acceleration; joints with dry friction stick or slide as they do in
the state. At a singular position nothing can be said, and the command fails."""

_MOBILITY = """Constraints that are redundant at every position are named with those that they depend on. Where more
motions begin than there are degrees of freedom the position is singular: its branches are given by the rates of
coordinates. Prescribed motions count as constraints, dry friction does not."""


def add(command: Command) -> None:
    sub = command("equilibrium", _equilibrium, "find the positions where a mechanism is at rest, stable or not")
    sub.epilog = _EQUILIBRIUM
    _add_analysis(sub, "FILE.json", "write all that is known of them, outputs and reactions included")
    sub.add_argument(
        "--at", metavar="S", type=float, default=0.0, help="time in s for which loads and inputs are taken (default: 0)"
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
    sub.add_argument(
        "--outputs",
        metavar="PATTERNS",
        type=name_list,
        action="extend",
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


def _add_analysis(sub: argparse.ArgumentParser, files: str, what: str) -> None:
    """Add the options common to all analyses."""
    add_name(sub, "mechanism", "NAME", EITHER_HELP)
    sub.add_argument("--json", action="store_true", help="print all of it as JSON, for programs")
    sub.add_argument("-o", "--output", metavar=files, help=what)
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")
    add_option(sub)
    add_set(sub)


def _equilibrium(chosen: argparse.Namespace) -> None:
    from ..analysis.equilibria import STARTS, check_file, equilibrium
    from ..simulation.result import read_inputs
    from ..view.picture import check_drawing

    path, drawn = (Path(x) if x else None for x in (chosen.output, chosen.draw))
    if path:
        check_file(path)
    if drawn:
        check_drawing(drawn)
    starts = STARTS if chosen.starts is None else chosen.starts
    inputs = read_inputs(chosen.input) if chosen.input else {}
    found = equilibrium(chosen_recipe(chosen, chosen.mechanism), inputs=inputs, time=chosen.at, starts=starts)
    _analysed(chosen, [found], path, found.save)
    if drawn:
        wrote = once_written(drawn)
        found.nearest.draw().save(drawn)
        say(chosen, wrote)


def _linearize(chosen: argparse.Namespace) -> None:
    from ..analysis.linearization import AMPLITUDE, check_file, figure, linearize, save
    from ..simulation.result import read_inputs
    from ..view.picture import check_film
    from ..view.plot import check_name

    path, plot, film = (Path(x) if x else None for x in (chosen.output, chosen.plot, chosen.film))
    for each, check in ((path, check_file), (plot, check_name), (film, check_film)):
        if each:
            check(each)
    if film and isinstance(chosen.at, list):
        raise InputError("--film shows the modes of one state; give --at one place or time")
    inputs = read_inputs(chosen.input) if chosen.input else {}
    made = linearize(chosen_recipe(chosen, chosen.mechanism), chosen.at, inputs=inputs, outputs=chosen.outputs)
    found = made if isinstance(made, list) else [made]
    _analysed(chosen, found, path, lambda path: save(found, path))
    if plot:
        wrote = once_written(plot)
        figure(found, plot)
        say(chosen, wrote)
    if film:
        wrote = once_written(film)
        found[0].film(film, chosen.mode, amplitude=AMPLITUDE if chosen.amplitude is None else chosen.amplitude)
        say(chosen, wrote)


def _mobility(chosen: argparse.Namespace) -> None:
    from ..analysis.freedoms import check_file, mobility
    from ..simulation.result import read_inputs

    path = Path(chosen.output) if chosen.output else None
    if path:
        check_file(path)
    inputs = read_inputs(chosen.input) if chosen.input else {}
    found = mobility(
        chosen_recipe(chosen, chosen.mechanism),
        stop_time=chosen.stop_time,
        inputs=inputs,
        time=chosen.at,
        progress=progress_bar("following the motion"),
    )
    _analysed(chosen, [found], path, found.save)


def _analysed(
    chosen: argparse.Namespace, found: Sequence[Any], path: Path | None, save: Callable[[Path], None]
) -> None:
    """Print the results of an analysis, and write them on request."""
    if chosen.json:
        data = [each.as_data() for each in found]
        print(json.dumps(data[0] if len(data) == 1 else data, indent=1))
    else:
        print("\n\n".join("\n".join(each.lines()) for each in found))
    if path:
        wrote = once_written(path)
        save(path)
        say(chosen, wrote)


def _at(text: str) -> str | float | list[float]:
    """Parse a word for a state, a time, or several times."""
    from ..analysis.states import PLACES

    if text in PLACES:
        return text
    try:
        times = [float(each) for each in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is none of {', '.join(PLACES)}, and no times in s") from None
    return times if len(times) > 1 else times[0]
