"""Workers of a sweep, with one interface for this process, local processes, and a Dask cluster.

A worker gets a range of cases and returns those that it starts within `PART` seconds; the rest is distributed again. If
a worker dies, only its current cases are lost, and other workers repeat them. Cases that crash every process are
isolated by bisection and become rows with the reason.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
import sys
import threading
import time
import types
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from ..model.errors import InputError, WriteError, needs
from .jobs import Job, NeedsBrakes, Part, begin, lost, run_part
from .parts import Store, kept
from .variations import Cases

PART = 2.0
"""Time [s] after which a part is returned: it bounds the loss due to a killed process, and exceeds the time to write a
file."""

SHORT = 0.1
"""Time [s] of the smallest pieces at the end of a sweep, so that all workers finish together."""

PART_NUMBERS = 4_000_000
"""Largest number of values in a part: 32 MB."""

PART_CASES = 20_000
"""Largest number of cases in a part."""

AT_HAND = 2
"""Number of ranges queued for each worker: the current one and the next."""

DEATHS = 2
"""Number of processes that may die with the same cases before these run alone."""

GLANCE = 0.2
"""Interval [s] of checks for a request to stop."""

LEAVE = 1.0
"""Time [s] for processes to exit by themselves."""

PATIENCE = 60.0
"""Time [s] to wait for a cluster without workers."""


class Stop:
    """Whether the user asked to stop: the first request ends after the current work, the second at once."""

    def __init__(self) -> None:
        self.asked = 0
        self.on_request: Callable[[], None] = bool  # type: ignore[assignment]

    def __call__(self) -> bool:
        return self.asked > 0

    def ask(self, number: int, frame: object) -> None:
        self.asked += 1
        if self.asked > 1:
            raise KeyboardInterrupt
        self.on_request()


@contextmanager
def stopping() -> Iterator[Stop]:
    """Handle interrupts and termination requests as `Stop`, in the main thread, which receives them."""
    stop = Stop()
    main = threading.current_thread() is threading.main_thread()
    before = {each: signal.signal(each, stop.ask) for each in (signal.SIGINT, signal.SIGTERM) if main}
    try:
        yield stop
    finally:
        for each, old in before.items():
            signal.signal(each, old)


class Crew(Protocol):
    """Workers that run ranges of cases."""

    def workers(self) -> int:
        """Return the current number of workers."""

    def submit(self, job: Job, first: int, values: Any) -> Future[Part]: ...

    def renew(self) -> None:
        """Replace lost workers."""

    def close(self) -> None:
        """End the workers that this crew started, with their current work."""

    deadly: tuple[type[BaseException], ...]
    """Exceptions that mean that the worker of a range was lost."""


@dataclass
class Processes:
    """Local processes, which end with this one."""

    count: int
    deadly: tuple[type[BaseException], ...] = (BrokenExecutor,)
    _pool: ProcessPoolExecutor | None = None

    def workers(self) -> int:
        return self.count

    def submit(self, job: Job, first: int, values: Any) -> Future[Part]:
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.count, context, begin)
        with _without_main():
            return self._pool.submit(run_part, job, first, values, PART)

    def renew(self) -> None:
        self.close()

    def close(self) -> None:
        pool, self._pool = self._pool, None
        if pool is not None:
            processes = list((pool._processes or {}).values())
            pool.shutdown(wait=False, cancel_futures=True)
            end = time.monotonic() + LEAVE
            for each in processes:  # idle processes exit by themselves
                each.join(max(0.0, end - time.monotonic()))
            for each in processes:
                each.terminate()
                each.join()


@contextmanager
def _without_main() -> Iterator[None]:
    """Hide the user's script from processes while they are started, as each would run it again.

    Their code is in modules, so scripts need no `if __name__ == "__main__"` around a sweep.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@dataclass
class Cluster:
    """The workers of a Dask cluster."""

    client: Any
    deadly: tuple[type[BaseException], ...]
    _executor: Executor = field(init=False)
    _known: tuple[float, int] = (-math.inf, 0)

    def __post_init__(self) -> None:
        self._executor = self.client.get_executor(pure=False)

    def workers(self) -> int:
        asked, count = self._known
        if time.monotonic() - asked > 1.0:
            count = sum(each["nthreads"] for each in self.client.scheduler_info(n_workers=-1)["workers"].values())
            self._known = time.monotonic(), count
        return count

    def submit(self, job: Job, first: int, values: Any) -> Future[Part]:
        return self._executor.submit(run_part, job, first, values, PART)

    def renew(self) -> None:
        pass

    def close(self) -> None:
        with suppress(Exception):  # the scheduler may be gone
            self._executor.shutdown(wait=False, cancel_futures=True)
            self.client.close(timeout=5)


WAIT = 10
"""Time [s] to wait for a scheduler."""


def cluster(address: str) -> Cluster:
    """Return the workers of a Dask cluster, given the address of its scheduler, such as `tcp://10.0.0.5:8786`.

    Raises InputError if it is unreachable. Needs `alfmu[sweep]`, here and on the workers.
    """
    with needs("a cluster needs distributed", "sweep"):
        import distributed
    try:
        client = distributed.Client(address, timeout=WAIT, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"there is no Dask scheduler at {address} ({error})") from None
    return Cluster(client, (distributed.scheduler.KilledWorker,))


@dataclass
class _Range:
    """A range of cases to run."""

    first: int
    stop: int
    deaths: int = 0

    def __len__(self) -> int:
        return self.stop - self.first

    def split(self, count: int) -> tuple[_Range, _Range]:
        return replace(self, stop=self.first + count), replace(self, first=self.first + count)


def make(
    job: Job,
    cases: Cases,
    store: Store,
    crew: Crew | None,
    stop: Stop,
    done: Callable[[int], None],
    brakes: Callable[[], Job],
    seconds: float | None = None,
) -> None:
    """Run the cases missing in a store, until the user stops or time is over.

    Without a crew, this process runs them, for at most `seconds` [s]. `done` is called with the number of cases added;
    `brakes` returns the job with the scene that `NeedsBrakes` requires. Raises WriteError if a part cannot be stored.
    """
    work = _Work(job, cases, store, stop, done, brakes)
    try:
        if crew is None:
            work.alone(math.inf if seconds is None else seconds)
        else:
            work.shared(crew)
    except WriteError as error:
        raise WriteError(f"{error}; {kept(store)}") from error


class _Work:
    def __init__(
        self,
        job: Job,
        cases: Cases,
        store: Store,
        stop: Stop,
        done: Callable[[int], None],
        brakes: Callable[[], Job],
    ):
        self.job, self.cases, self.store, self.stop, self.done, self.brakes = job, cases, store, stop, done, brakes
        self.waiting = deque(_Range(*each) for each in store.missing())
        self.suspects: deque[_Range] = deque()
        self.pace = 0.0
        """Time of a run [s]; zero if unknown yet."""
        self.most = max(1, min(PART_CASES, PART_NUMBERS // job.numbers))

    # In this process -------------------------------------------------------------------------------------------------

    def alone(self, seconds: float) -> None:
        """Run cases in this process for at most a time [s]."""
        end = time.perf_counter() + seconds
        while self.waiting and not self.stop() and (left := end - time.perf_counter()) > 0:
            given = self._next(self.most)
            values = self.cases.values(given.first, given.stop)
            try:
                part = run_part(self.job, given.first, values, min(PART, left), self.stop)
            except NeedsBrakes:
                self._with_brakes(given)
                continue
            self._keep(given, part)

    # With workers ----------------------------------------------------------------------------------------------------

    def shared(self, crew: Crew) -> None:
        """Distribute cases to workers, and store their results."""
        under_way: dict[Future[Part], _Range] = {}
        alone_since = time.monotonic()
        try:
            while (self.waiting or self.suspects or under_way) and not (self.stop() and not under_way):
                workers = crew.workers()
                if workers:
                    alone_since = time.monotonic()
                elif time.monotonic() - alone_since > PATIENCE:
                    raise InputError(f"the cluster has had no workers for {PATIENCE:.0f} s; {kept(self.store)}")
                while (given := self._chosen(len(under_way), workers)) is not None:
                    values = self.cases.values(given.first, given.stop)
                    try:
                        under_way[crew.submit(self.job, given.first, values)] = given
                    except crew.deadly:
                        self.waiting.appendleft(given)
                        if not under_way:
                            crew.renew()
                        break
                if self.stop():  # ranges not yet started are dropped
                    under_way = {each: given for each, given in under_way.items() if not each.cancel()}
                finished = wait(under_way, GLANCE, FIRST_COMPLETED).done
                if not under_way:
                    time.sleep(GLANCE)
                dead = [under_way[each] for each in finished if not self._taken(crew, each, under_way[each])]
                for each in finished:
                    del under_way[each]
                if dead:
                    if not isinstance(crew, Cluster):
                        # The pool loses all its current ranges, except those finished at the same time.
                        for each, given in under_way.items():
                            if not (each.done() and self._taken(crew, each, given)):
                                dead.append(given)
                        under_way.clear()
                    crew.renew()
                    self._mourn(dead, certain=isinstance(crew, Cluster))
        finally:
            for each in under_way:
                each.cancel()

    def _chosen(self, under_way: int, workers: int) -> _Range | None:
        """Return the next range to distribute; None to wait."""
        if self.stop():
            return None
        if self.suspects:
            return self.suspects.popleft() if not under_way else None
        if not self.waiting or under_way >= AT_HAND * workers:
            return None
        left = sum(map(len, self.waiting))
        least = math.ceil(SHORT / self.pace) if self.pace else 1
        usual = math.ceil(1.5 * PART / self.pace) if self.pace else self.most
        return self._next(min(self.most, usual, max(least, left // (AT_HAND * workers))))

    def _next(self, most: int) -> _Range:
        """Return a range of at most `most` waiting cases."""
        given = self.waiting.popleft()
        if len(given) > most:
            given, rest = given.split(most)
            self.waiting.appendleft(rest)
        return given

    def _taken(self, crew: Crew, future: Future[Part], given: _Range) -> bool:
        """Store the results of a worker; return False if it was lost."""
        try:
            part = future.result()
        except crew.deadly:
            return False
        except NeedsBrakes:
            self._with_brakes(given)
            return True
        self._keep(given, part)
        return True

    def _keep(self, given: _Range, part: Part) -> None:
        self.store.add(part)
        made = len(part)
        self.pace = part.seconds / made or self.pace
        if made < len(given):
            rest = given.split(made)[1]
            (self.suspects if given.deaths >= DEATHS else self.waiting).appendleft(rest)
        self.done(made)

    def _with_brakes(self, given: _Range) -> None:
        if not getattr(self.job, "braking", None):
            self.job = self.brakes()
        self.waiting.appendleft(given)

    def _mourn(self, dead: Sequence[_Range], certain: bool) -> None:
        """Requeue cases of a lost worker; those over which several died run alone, bisected."""
        for each in dead:
            each.deaths += DEATHS if certain else 1
            if each.deaths < DEATHS:
                self.waiting.appendleft(each)
            elif each.deaths == DEATHS:  # it did not run alone, so another range may be the cause
                self.suspects.append(each)
            elif len(each) > 1:
                first, second = each.split(len(each) // 2)
                self.suspects.extend([first, second])
            else:
                values = self.cases.values(each.first, each.stop)
                why = f"{self.job.name}: the process that ran this case ended without a message, each time"
                self.store.add(lost(self.job, each.first, values, why))
                self.done(1)
