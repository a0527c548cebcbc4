"""Output of commands, progress, and handling of interrupts."""

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any


def failed(why: str, code: int = 1) -> int:
    """Print why a command failed, after all other output; return the exit code."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        fall_silent()
    print(f"alfmu: {why}", file=sys.stderr)
    return code


def fall_silent() -> None:
    """Redirect output to a closed pipe, so that the interpreter does not report an error at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def perhaps(word: str, words: Collection[str]) -> str:
    """Return a suggestion for an unknown word."""
    from ..model.words import in_words, nearest

    meant = nearest(word, words)
    return f"did you mean {in_words(meant)}?" if meant else f"use one of {', '.join(words)}"


def once_written(path: Path) -> str:
    """Return the message to print after a file is written; call it before writing."""
    return f"replaced {path}" if path.exists() else f"wrote {path}"


def save_file(path: str | Path | None, write: Callable[[Path], object], json: bool = False) -> None:
    """Write a file if one is requested, and print its path, to stderr if stdout is used for JSON."""
    if path:
        said = once_written(Path(path))
        write(Path(path))
        print(said, file=sys.stderr if json else sys.stdout)


def progress_bar(what: str, unit: str = "step") -> Callable[[Iterable[Any]], Iterable[Any]]:
    """Return a progress bar for a terminal, shown if it takes longer than a second."""
    from tqdm import tqdm

    return lambda steps: tqdm(steps, desc=what, unit=unit, delay=1.0, disable=None, leave=False)


class GettingReady:
    """Shows on a terminal the stages of preparing a mechanism; consecutive ones share a delay."""

    AFTER = 2.0
    """Time [s] after which the display appears."""

    def __init__(self) -> None:
        self._begun = self._ended = -math.inf

    @contextmanager
    def __call__(self) -> Iterator[Callable[[str], None]]:
        from tqdm import tqdm

        now = time.monotonic()
        if now - self._ended > self.AFTER / 2:
            self._begun = now
        delay = max(self._begun + self.AFTER - now, 1e-9)
        with tqdm(desc="getting ready", unit="function", delay=delay, disable=None, leave=False) as bar:

            def show(name: str) -> None:
                bar.set_postfix_str(name, refresh=False)
                bar.update()

            yield show
        self._ended = time.monotonic()


@contextmanager
def checking() -> Iterator[Callable[[str], None]]:
    """Show the current check on a terminal if it takes longer than a second."""
    from tqdm import tqdm

    with tqdm(desc="checking", unit="check", delay=1.0, disable=None, leave=False) as bar:

        def show(what: str) -> None:
            bar.set_postfix_str(what, refresh=False)
            bar.update()

        yield show


@contextmanager
def handling(handler: Callable[..., Any], *signals: signal.Signals) -> Iterator[None]:
    """Handle signals in the main thread, which receives them."""
    main = threading.current_thread() is threading.main_thread()
    before = {each: signal.signal(each, handler) for each in signals if main}
    try:
        yield
    finally:
        for each, old in before.items():
            signal.signal(each, old)


@contextmanager
def between_steps(progress: Callable[..., Iterable[Any]]) -> Iterator[Callable[..., Iterable[Any]]]:
    """Return a progress display with which an interrupt ends the run between two steps, with FMU and rows intact; a
    second interrupt ends it at once."""
    asked: list[int] = []

    def ask(number: int, frame: object) -> None:
        asked.append(number)
        if len(asked) > 1:
            raise KeyboardInterrupt

    def checked(steps: Sequence[Any]) -> Iterator[Any]:
        every: Any = iter(progress(steps))
        with closing(every) as shown:
            for step in shown:
                if asked:
                    raise KeyboardInterrupt
                yield step

    checked.ended = lambda: bool(asked)  # type: ignore[attr-defined]
    with handling(ask, signal.SIGINT, signal.SIGTERM):
        yield checked
