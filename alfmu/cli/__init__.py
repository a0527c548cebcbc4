"""The command line: parse, call, print.

Each command is declared and run in one of the modules COMMANDS.
"""

import argparse
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Any

from ..model.errors import AlfmuError, AlfmuWarning
from ..model.making import showing
from . import analyses, fits, fmus, judged, looks, many, runs, shells, systems
from .says import GettingReady, failed, fall_silent, handling, perhaps

__all__ = ["main", "parser"]

COMMANDS = (looks, fmus, runs, many, fits, systems, analyses, judged, shells)
"""Modules with commands; `add` adds them."""

GROUPS = {
    "make": ("export", "import", "convert"),
    "look": ("list", "info", "draw", "live", "animate"),
    "run": ("simulate", "sweep", "fit"),
    "judge": ("equilibrium", "linearize", "mobility", "kinematics", "validate", "report", "stability"),
    "connect": ("system", "couple"),
    "install": ("cache", "completion"),
}
"""Commands by purpose, in the order of the help."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code.

    It is 0 on success, 1 for a failure or problems found, 2 for wrong usage, 3 if not judged, 130 if interrupted.
    """
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
        parser.error(f"there is no command {words[0]!r}; {perhaps(words[0], commands)}")
    chosen, unknown = parser.parse_known_args(words)
    if unknown:
        sub = commands[words[0]]
        options = re.findall(r"--[\w-]+", sub.format_usage())
        known = f"; {perhaps(unknown[0].partition('=')[0], options)}" if unknown[0].startswith("-") else ""
        if not known and "=" in unknown[0] and "--set" in options:
            known = f"; each value takes a --set of its own: --set {unknown[0]}"
        sub.error(f"{unknown[0]} is not understood{known}")
    try:
        with warnings.catch_warnings(), handling(signal.default_int_handler, signal.SIGTERM):
            # Cleanup runs if a signal interrupts work.
            warnings.filterwarnings("always", category=AlfmuWarning)
            warnings.showwarning = _printed(warnings.showwarning)
            with showing(GettingReady()):
                return chosen.run(chosen) or 0
    except AlfmuError as error:
        return failed(str(error))
    except BrokenPipeError:  # the reader of the output has closed it
        fall_silent()
        return 0
    except OSError as error:
        return failed(f"{error.filename or 'the folder for temporary files'}: {error.strerror or error}")
    except MemoryError:
        return failed("there is not enough memory for this")
    except KeyboardInterrupt:
        return failed("interrupted", 130)


def _printed(otherwise: Callable[..., None]) -> Callable[..., None]:
    """Return a handler that prints each warning of alfmu once, as one line."""
    seen: set[str] = set()

    def show(message: Warning, category: type[Warning], file: str, line: int, *more: Any) -> None:
        if not issubclass(category, AlfmuWarning):
            otherwise(message, category, file, line, *more)
        elif not any(each.startswith(str(message)) for each in seen):
            seen.add(str(message))
            print(f"alfmu: warning: {message}", file=sys.stderr)

    return show


class _Grouped(argparse.HelpFormatter):
    """Formats help with commands grouped by GROUPS."""

    def _format_action(self, action: argparse.Action) -> str:
        if not isinstance(action, argparse._SubParsersAction):
            return super()._format_action(action)
        self._indent()
        self._action_max_length += self._indent_increment
        lines = {each.dest: super(_Grouped, self)._format_action(each) for each in action._get_subactions()}
        self._dedent()
        return "\n".join(
            f"{'':{self._current_indent}}{group}\n{''.join(lines[name] for name in names)}"
            for group, names in GROUPS.items()
        )


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line, from which the documentation page is made."""
    return _parser()[0]


def _parser() -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """Return the parser, and the parsers of the commands by name."""
    from importlib.metadata import version

    parser = argparse.ArgumentParser(
        prog="alfmu",
        description="Closed-loop mechanisms as FMUs for co-simulation: export, run, check and watch them.",
        epilog="Exit codes: 0 done, 1 failed or problems found, 2 wrong usage, 3 not judged, 130 interrupted. "
        "See `alfmu COMMAND --help`.",
        formatter_class=_Grouped,
    )
    parser.add_argument("--version", action="version", version=f"alfmu {version('alfmu')}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    by_name: dict[str, argparse.ArgumentParser] = {}

    def command(name: str, run: Callable[[argparse.Namespace], int | None], text: str) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        sub.set_defaults(run=run)
        by_name[name] = sub
        return sub

    for each in COMMANDS:
        each.add(command)
    return parser, by_name
