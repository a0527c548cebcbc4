"""Commands for this machine: cache, completion."""

import argparse
import os

from ..model.cache import LIMIT, VARIABLE, clear, entries, folder, is_off
from ..model.errors import needs
from .options import Command

SHELLS = ("bash", "zsh", "fish", "powershell")
"""Shells with completion by argcomplete."""


_CACHE = f"""Scenes and compiled kernels are kept for the next start, up to {LIMIT / 1e6:.0f} MB; the least recently
used files are removed first. {VARIABLE}=FOLDER in the environment moves the folder, {VARIABLE}=off keeps nothing."""


def add(command: Command) -> None:
    sub = command("cache", _cache, "show or clear the folder in which scenes and compiled kernels are kept")
    sub.epilog = _CACHE
    sub.add_argument("--clear", action="store_true", help="remove all files that alfmu keeps there")

    sub = command("completion", _completion, "print a shell script that completes the names of commands and mechanisms")
    sub.add_argument("shell", choices=SHELLS, help='for bash, put this into ~/.bashrc: eval "$(alfmu completion bash)"')


def _cache(chosen: argparse.Namespace) -> None:
    if chosen.clear:
        clear()
    found = entries()
    size = sum(about.st_size for _, about in found)
    kept = f"{folder()}: {len(found)} files, {size / 1e6:.1f} MB of at most {LIMIT / 1e6:.0f} MB"
    print(f"nothing is kept: {VARIABLE} is {os.environ[VARIABLE]}" if is_off() else kept)


def _completion(chosen: argparse.Namespace) -> None:
    with needs("completion needs argcomplete", "completion"):
        from argcomplete.shell_integration import shellcode
    print(shellcode(["alfmu"], shell=chosen.shell))
