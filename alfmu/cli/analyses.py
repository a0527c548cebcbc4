"""Commands that analyse: equilibrium, linearize, mobility, kinematics."""

import argparse
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..model.errors import InputError
from .options import (
    EITHER_HELP,
    Command,
    add_name,
    add_names,
    add_option,
    add_set,
    chosen_recipe,
    file_of,
    inputs_of,
    name_list,
    pair,
)
from .says import progress_bar, save_file

_EQUILIBRIUM = """Inputs come from --input at the time of --at, or from --set, as start values do; `alfmu simulate
--start equilibrium` begins in the nearest stable position found. Stability is that of small motions; where it cannot be
judged, as at a singular position, the reason is shown. The search may miss positions. Inputs that prescribe motion are
held, laws of time must be at rest at the time of --at, and dry friction is left out."""

_LINEARIZE = """States are independent coordinates NAME and their rates der(NAME); inputs and outputs have their names
in FMI. Along a motion the coefficients are frozen at each state, and laws of time with them. An input that prescribes
motion acts by its value, rate and acceleration; joints with dry friction stick or slide as they do in the state. At a
singular position small motions are not linear, and the command fails."""

_MOBILITY = """Constraints that are redundant at every position are listed with those that they depend on. A position
in which more motions begin than there are degrees of freedom is singular: its branches are given by the rates of
coordinates. Prescribed motions count as constraints, dry friction does not."""


_KINEMATICS = """Values have the names of joints, coordinates, bodies, watched points and outputs: --at A=0.3,B=1.2
for actuated joints, --to tool.x=0.2,tool.y=0.4 for a position to reach. The Jacobian is that of --watch; efforts are
those at rest, or for --rates and --accelerations, and have the least norm if actuators are redundant. A position is
singular if one of three numbers vanishes: `constraint` (loops permit more motions), `parallel` (actuators cannot hold
it), `serial` (the watched points cannot move in some direction). --cycle moves one joint, --along all of them by a
table over time."""


def add(command: Command) -> None:
    sub = command("equilibrium", _equilibrium, "find the positions where a mechanism is at rest, stable or not")
    sub.epilog = _EQUILIBRIUM
    _add_analysis(sub, "FILE.json", "write the positions with their outputs and reactions")
    sub.add_argument(
        "--at",
        metavar="S",
        type=float,
        default=0.0,
        help="time in s at which loads and inputs are evaluated (default: 0)",
    )
    sub.add_argument("--starts", metavar="N", type=int, help="number of positions to search from, besides the start")
    sub.add_argument("--draw", metavar="FILE", help="draw the position in which a run would begin (PNG or SVG)")

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
    add_names(sub, "--outputs", "PATTERNS", 'outputs of C and D, such as "link*.angle,*.force.*" (default: all)')
    sub.add_argument("--plot", metavar="FILE.png", help="draw the eigenvalues in the plane (PNG, SVG or PDF)")
    sub.add_argument("--film", metavar="FILE", help="write a mode as a film (GIF or HTML)")
    sub.add_argument("--mode", metavar="N", type=int, default=1, help="the mode of --film (default: 1, the slowest)")
    sub.add_argument(
        "--amplitude", metavar="A", type=float, help="amplitude of --film: the largest change of a coordinate in rad"
    )

    sub = command(
        "mobility", _mobility, "count degrees of freedom, name redundant constraints, find singular positions"
    )
    sub.epilog = _MOBILITY
    _add_analysis(sub, "FILE.json", "write all results, each singular position with its branches")
    sub.add_argument(
        "--stop-time",
        type=float,
        metavar="S",
        help="time in s to follow the motion; 0 for the start alone (default: the mechanism's own)",
    )
    sub.add_argument(
        "--at", metavar="S", type=float, default=0.0, help="time in s at which laws of time are evaluated for the start"
    )

    sub = command("kinematics", _kinematics, "move a mechanism by its actuated joints: positions, Jacobian, efforts")
    sub.epilog = _KINEMATICS
    _add_analysis(sub, "FILE.csv", "write the table of --cycle or --along")
    add_names(sub, "--actuated", "JOINTS", "the actuated joints (default: drives and motions)")
    add_names(sub, "--watch", "NAMES", "points and outputs of the Jacobian (default: watched points)")
    values: dict[str, Any] = {"metavar": "NAME=VALUE,...", "type": _values, "action": "extend"}
    sub.add_argument("--at", help="forward: displacements of actuated joints in rad or m", **values)
    sub.add_argument("--to", help="inverse: positions to reach; the solution nearest to the start is taken", **values)
    sub.add_argument("--solutions", action="store_true", help="show all solutions of --to or --at that are found")
    sub.add_argument("--rates", help="of actuated joints, for the efforts", **values)
    sub.add_argument("--accelerations", help="of actuated joints, for the efforts", **values)
    sub.add_argument("--along", metavar="FILE.csv", help="efforts along a motion: `time` and a column for each joint")
    sub.add_argument("--cycle", metavar="JOINT", help="move one actuated joint by a turn, or between dead positions")
    sub.add_argument("--span", metavar="LOW,HIGH", type=_at, help="the range of --cycle in rad or m")
    sub.add_argument("--rows", metavar="N", type=int, default=181, help="rows of --cycle (default: 181)")
    sub.add_argument(
        "--transmission", metavar="HINGE", help="hinge whose transmission angle the table of --cycle contains"
    )
    sub.add_argument("--plot", metavar="FILE.png", help="draw the table of --cycle or --along (PNG, SVG or PDF)")


def _add_analysis(sub: argparse.ArgumentParser, files: str, what: str) -> None:
    """Add the options common to all analyses."""
    add_name(sub, "mechanism", "NAME", EITHER_HELP)
    sub.add_argument("--json", action="store_true", help="print the results as JSON, for programs")
    sub.add_argument("-o", "--output", metavar=files, help=what)
    sub.add_argument("--input", metavar="FILE.csv", help="inputs over time: a column `time` and one for each input")
    add_option(sub)
    add_set(sub)


def _equilibrium(chosen: argparse.Namespace) -> None:
    from ..analysis.equilibria import STARTS, equilibrium

    path, drawn = file_of("positions of rest", chosen.output), file_of("a drawing", chosen.draw)
    starts, inputs = STARTS if chosen.starts is None else chosen.starts, inputs_of(chosen)
    found = equilibrium(chosen_recipe(chosen, chosen.mechanism), inputs=inputs, time=chosen.at, starts=starts)
    _analysed(chosen, [found], path, found.save)
    save_file(drawn, lambda path: found.nearest.draw().save(path), chosen.json)


def _linearize(chosen: argparse.Namespace) -> None:
    from ..analysis.linearization import AMPLITUDE, figure, linearize, save

    path, plot = file_of("linearisations", chosen.output), file_of("a plot", chosen.plot)
    film = file_of("a film", chosen.film)
    if film and isinstance(chosen.at, list):
        raise InputError("--film shows the modes of one state; give --at one place or time")
    recipe = chosen_recipe(chosen, chosen.mechanism)
    made = linearize(recipe, chosen.at, inputs=inputs_of(chosen), outputs=chosen.outputs)
    found = made if isinstance(made, list) else [made]
    _analysed(chosen, found, path, lambda path: save(found, path))
    amplitude = AMPLITUDE if chosen.amplitude is None else chosen.amplitude
    save_file(plot, lambda path: figure(found, path), chosen.json)
    save_file(film, lambda path: found[0].film(path, chosen.mode, amplitude=amplitude), chosen.json)


def _mobility(chosen: argparse.Namespace) -> None:
    from ..analysis.freedoms import mobility

    path = file_of("degrees of freedom", chosen.output)
    found = mobility(
        chosen_recipe(chosen, chosen.mechanism),
        stop_time=chosen.stop_time,
        inputs=inputs_of(chosen),
        time=chosen.at,
        progress=progress_bar("following the motion"),
    )
    _analysed(chosen, [found], path, found.save)


def _kinematics(chosen: argparse.Namespace) -> None:
    from ..analysis.kinematics import kinematics
    from ..simulation.result import read_inputs
    from ..view.plot import figure
    from ..view.plot import save as draw

    output, plot = Path(chosen.output) if chosen.output else None, file_of("a plot", chosen.plot)
    if (output or plot) and not (chosen.cycle or chosen.along):
        raise InputError("-o and --plot are for the table of --cycle or --along; give one of these")
    k = kinematics(chosen_recipe(chosen, chosen.mechanism), chosen.actuated, chosen.watch, inputs=inputs_of(chosen))
    at, to = (dict(x) if x else {} for x in (chosen.at, chosen.to))
    if chosen.solutions:
        places = k.solutions({**at, **to})
    else:
        place = k.forward(at)
        places = [k.inverse(to, place) if to else place]
    table = k.along(read_inputs(chosen.along)) if chosen.along else None
    if chosen.cycle and not chosen.along:
        given = {name: getattr(chosen, name) for name in ("span", "rows", "transmission")}
        table = k.cycle(chosen.cycle, near=places[0], **given)
    motion = tuple(dict(x) if x else None for x in (chosen.rates, chosen.accelerations))
    data, lines = k.said(places, table, *motion)
    print(json.dumps(data, indent=1) if chosen.json else "\n".join(lines))
    if table is not None:
        ends = ("advantage", "transmission_angle", "manipulability", "torque", "force")
        shown = [name for own in k.watched.values() for name in own]
        shown += [name for name in table.names if name.rpartition(".")[2] in ends]
        save_file(output, table.to_csv, chosen.json)
        save_file(plot, lambda path: draw(figure(table, shown), path, 150), chosen.json)


def _values(text: str) -> list[tuple[str, float]]:
    """Parse NAME=VALUE,NAME=VALUE."""
    found = [pair(each) for each in name_list(text)]
    for name, number in found:
        if isinstance(number, str):
            raise argparse.ArgumentTypeError(f"{name} is {number!r}; give a number")
    return [(name, float(number)) for name, number in found]


def _analysed(
    chosen: argparse.Namespace, found: Sequence[Any], path: Path | None, save: Callable[[Path], None]
) -> None:
    """Print the results of an analysis, and write them on request."""
    if chosen.json:
        data = [each.as_data() for each in found]
        print(json.dumps(data[0] if len(data) == 1 else data, indent=1))
    else:
        print("\n\n".join("\n".join(each.lines()) for each in found))
    save_file(path, save, chosen.json)


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
