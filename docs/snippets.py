"""Runs what stands in the pages: a Sphinx extension, and a command for one page.

A page is read from top to bottom, in a folder of its own:

    ```python     a first line `# wiper.py` saves the block under this name; any other block runs, and what it prints
                  has to be what an `output` block right after it shows
    ```console    lines that begin with `$ ` run in a shell; what they print has to be what stands below them, if
                  anything does
    ```toml       a first line `# drive.toml` saves the block under this name
    ```output     see above; `...` stands for anything, and any blank equals any other

A block in another language does not run. `-D snippets_pages=REGEX` runs some of the pages alone, those whose names
match as a whole. Pictures that a page leaves in its folder can be shown by it: that of `howto/fmpy.md` is
`made/howto/fmpy`.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import warnings
from pathlib import Path
from typing import Any

MADE = "made"
"""Folder of what pages leave, in that of the documentation."""

LONGEST = 600
"""Time [s] after which a page is given up: twenty times what the longest takes on a quiet machine."""

EVERY = ".*"

_FENCE = re.compile(r"^```(python|console)$", re.MULTILINE)

_SAVED = re.compile(r"# ([\w-]+\.(?:py|csv|toml))\n")


def runs(text: str) -> bool:
    """Whether a page has anything to run."""
    return bool(_FENCE.search(text))


def check(wanted: str, got: str) -> None:
    """Raise AssertionError where something else is printed than the page says."""
    pieces = [r"\s+".join(map(re.escape, piece.split())) for piece in wanted.split("...")]
    if not re.fullmatch(r"\s*" + ".*".join(pieces) + r"\s*", got, re.DOTALL):
        raise AssertionError(f"the page says\n\n{wanted}\nand this is printed\n\n{got}")


def _python(example: Any) -> None:
    text, names = example.parsed, example.namespace
    if saved := _SAVED.match(text):
        Path(saved[1]).write_text(text, encoding="utf-8")
        names["printed"] = None
        return
    code = compile("\n" * (example.line + example.parsed.line_offset) + text, example.path, "exec")
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(code, names)
    names["printed"] = out.getvalue()


def _toml(example: Any) -> None:
    saved = _SAVED.match(example.parsed)
    if saved:
        Path(saved[1]).write_text(example.parsed, encoding="utf-8")


def _output(example: Any) -> None:
    check(example.parsed, example.namespace["printed"])


def _console(example: Any) -> None:
    for command in re.split(r"^\$ ", example.parsed, flags=re.MULTILINE)[1:]:
        line, _, wanted = command.partition("\n")
        done = subprocess.run(
            line, shell=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=LONGEST
        )
        assert done.returncode == 0, f"{line} ends with exit code {done.returncode}:\n{done.stdout}"
        if wanted.strip():
            check(wanted, done.stdout)


def run(page: Path) -> None:
    """Run a page in the present folder; AssertionError, or what a block raised, with its place."""
    from sybil import Sybil
    from sybil.parsers.myst import CodeBlockParser

    evaluators = {"python": _python, "toml": _toml, "output": _output, "console": _console}
    parsers = [CodeBlockParser(language, evaluator) for language, evaluator in evaluators.items()]
    for example in Sybil(parsers).parse(page).examples():
        try:
            example.evaluate()
        except Exception as error:
            raise RuntimeError(f"{page}, line {example.line}: {type(error).__name__}: {error}") from error


def in_folder(page: Path, folder: Path) -> str:
    """Run a page in another process, in a new folder; what went wrong, nothing if it went well."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    path = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", "")])
    # A width that does not depend on the window: argparse and NumPy ask for it.
    environment = {**os.environ, "PATH": path, "MPLBACKEND": "Agg", "COLUMNS": "100"}
    command = [sys.executable, __file__, str(page)]
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, text=True, capture_output=True, timeout=LONGEST, check=False
        )
    except subprocess.TimeoutExpired:
        return f"{page.name} runs longer than {LONGEST} s"
    return "" if done.returncode == 0 else done.stderr.strip()


def _read(app: Any, document: str, source: list[str]) -> None:
    from sphinx.util import logging

    if re.fullmatch(app.config.snippets_pages, document) and runs(source[0]):
        page, folder = Path(app.env.doc2path(document)), Path(app.srcdir) / MADE / document
        if wrong := in_folder(page, folder):
            logging.getLogger(__name__).warning(wrong, location=document)
            _failed(app.env).add(document)


def _failed(env: Any) -> set[str]:
    """Pages that did not run, kept with the environment until they are read again."""
    return env.__dict__.setdefault("snippets_failed", set())


def _merge(app: Any, env: Any, documents: Any, other: Any) -> None:
    """Take over what another process read."""
    _failed(env).update(_failed(other) & set(documents))


def _end(app: Any, error: Exception | None) -> None:
    """The build fails where a page did not run, with -W or without."""
    if failed := sorted(_failed(app.env)) if app.env else []:
        print(f"pages that did not run: {', '.join(failed)}", file=sys.stderr)
        app.statuscode = 1


def _lenient(app: Any, config: Any) -> None:
    """Pages that do not run lack their pictures."""
    if config.snippets_pages != EVERY:
        config.suppress_warnings = [*config.suppress_warnings, "image.not_readable"]


def setup(app: Any) -> dict[str, Any]:
    """Run each page when Sphinx reads it, so that its pictures are there."""
    app.add_config_value("snippets_pages", EVERY, "env", str)
    app.connect("config-inited", _lenient)
    app.connect("source-read", _read)
    app.connect("env-purge-doc", lambda app, env, document: _failed(env).discard(document))
    app.connect("env-merge-info", _merge)
    app.connect("build-finished", _end)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


if __name__ == "__main__":
    sys.path.insert(0, os.getcwd())
    warnings.simplefilter("error")
    try:
        run(Path(sys.argv[1]))
    except RuntimeError as error:
        sys.exit(str(error))
