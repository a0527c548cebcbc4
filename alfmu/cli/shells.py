"""The command completion."""

from __future__ import annotations

import argparse

from ..model.errors import InputError
from .options import Command

SHELLS = ("bash", "zsh", "fish", "powershell")
"""Shells whose completion argcomplete knows."""


def add(command: Command) -> None:
    """Add it to the command line."""
    sub = command("completion", _completion, "print what makes a shell complete the names of commands and mechanisms")
    sub.add_argument("shell", choices=SHELLS, help='for bash, put this into ~/.bashrc: eval "$(alfmu completion bash)"')


def _completion(chosen: argparse.Namespace) -> None:
    try:
        from argcomplete.shell_integration import shellcode
    except ImportError:
        raise InputError("completion needs argcomplete; install it with: pip install 'alfmu[completion]'") from None
    print(shellcode(["alfmu"], shell=chosen.shell))
