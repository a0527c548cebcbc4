"""Commands for connected systems: system, couple."""

import argparse

from ..systems.masters import MASTERS
from .options import Command, add_names, add_set, add_step, file_of
from .runs import add_table, given_inputs, run_and_keep
from .says import progress_bar, save_file

_SYSTEM = """The file lists mechanisms, parts and FMUs, their connections, and the settings of the run; its
form is in the documentation, howto/systems. Columns are called COMPONENT.VARIABLE. --set and --input give parameters
and free inputs by these names. Of an .ssp, only its FMUs run code. `alfmu export --ssp FILE.toml`
writes one."""

_COUPLE = """The file has a table [monolithic] that names one mechanism with all the parts, and the outputs that are
compared. The communication step of the file is halved repeatedly; each is run with held, extrapolated and iterated
inputs. A run is stable if no output differs by more than its largest value."""


def add(command: Command) -> None:
    sub = command("system", _system, "run connected mechanisms, parts and FMUs, from a TOML file or an SSP")
    sub.epilog = _SYSTEM
    sub.add_argument("system", metavar="FILE.toml|FILE.ssp", help="description of the system")
    sub.add_argument("--stop-time", type=float, metavar="S", help="end of the run in s (default: the system's own)")
    add_step(sub, "communication step in s (default: the system's)")
    sub.add_argument(
        "--master", choices=list(MASTERS), help="; ".join(f"{name}: {text}" for name, text in MASTERS.items())
    )
    add_table(sub)
    add_set(sub)

    sub = command("couple", _couple, "measure the cost of coupling: error and energy as the communication step halves")
    sub.epilog = _COUPLE
    sub.add_argument("system", metavar="FILE.toml", help="a system with a table [monolithic]")
    sub.add_argument("-o", "--output", metavar="FILE.csv", help="write the table")
    sub.add_argument("--plot", metavar="FILE.png", help="draw error over step and energy over time (PNG, SVG or PDF)")
    sub.add_argument(
        "--halvings", type=int, metavar="N", help="how often the communication step is halved (default: 5)"
    )
    add_names(sub, "--masters", "NAMES", f"of {','.join(MASTERS)} (default: all)")
    sub.add_argument(
        "--tolerance", type=float, metavar="T", help="relative tolerance of the components (default: 1e-9)"
    )
    sub.add_argument("--no-stability", action="store_true", help="skip the search for the largest stable steps")


def _system(chosen: argparse.Namespace) -> None:
    from ..systems.system import System

    inputs = given_inputs(chosen)
    system = System.load(chosen.system)
    run_and_keep(
        chosen,
        system.name,
        lambda progress: system.simulate(
            chosen.stop_time,
            chosen.step,
            inputs=inputs,
            parameters=dict(chosen.set),
            master=chosen.master,
            held_rows=chosen.held_rows,
            progress=progress,
        ),
    )


def _couple(chosen: argparse.Namespace) -> None:
    from ..systems.coupling import couple

    table, plot = file_of("a table", chosen.output), file_of("a plot", chosen.plot)
    asked = {"halvings": chosen.halvings, "masters": chosen.masters, "tolerance": chosen.tolerance}
    how = {name: value for name, value in asked.items() if value is not None}
    found = couple(chosen.system, **how, stability=not chosen.no_stability, progress=progress_bar("coupling", "run"))
    print("\n".join(found.lines()))
    save_file(table, found.save)
    save_file(plot, found.plot)
