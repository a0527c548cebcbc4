"""The parser of the command line as the pages show it: sphinx-argparse reads help texts as reStructuredText."""

from __future__ import annotations

import argparse

from alfmu import cli

__all__ = ["parser"]


def parser() -> argparse.ArgumentParser:
    """The parser, in whose texts an asterisk is one."""
    return _escaped(cli.parser())


def _escaped(given: argparse.ArgumentParser) -> argparse.ArgumentParser:
    for action in given._actions:
        if action.help:
            action.help = action.help.replace("*", "\\*")
        if isinstance(action, argparse._SubParsersAction):
            for each in set(action.choices.values()):
                _escaped(each)
    return given
