"""Throughput of sweeps of the five-bar over 1 s: beside fmpy's simulate_fmu in a loop, on one core and all, in memory.

    python scripts/sweep_benchmark.py [--runs 20000] [--all 100000] [--repeat 3] [--fmpy 100]

Every figure is printed with its number of runs. Of repetitions the fastest counts, as other processes only add time;
processor times, which they disturb less, are printed beside wall times.
"""

import argparse
import os
import resource
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

import alfmu
from alfmu.runtime.batch import processors

KEEP = ["final(link1.angle)", "peak(A.force.*)"]
VARY = {"m2": "uniform(0.5,1.5)", "l": "uniform(0.9,1.1)"}
STOP, STEP = 1.0, 0.02


def used() -> float:
    """Return the processor time [s] of this process and its finished children."""
    each = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(x.ru_utime + x.ru_stime for x in each)


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """Return wall and processor time [s] of a call."""
    begun, before = time.perf_counter(), used()
    run()
    return time.perf_counter() - begun, used() - before


def by_fmpy(kind: str, runs: int, folder: Path) -> dict[str, tuple[float, float]]:
    """Return wall and processor time [s] per run, for each way to call `simulate_fmu` in a loop."""
    import fmpy

    path = alfmu.export(alfmu.Recipe("five_bar", kind=kind), folder / f"{kind}.fmu")
    unpacked, outputs = fmpy.extract(str(path)), ["link1.angle", "A.force.x", "A.force.y"]
    description = fmpy.read_model_description(unpacked)
    rng = np.random.default_rng(1)
    starts = [{"m2": rng.uniform(0.5, 1.5), "l": rng.uniform(0.9, 1.1)} for _ in range(runs)]

    def loop(**how) -> None:
        for start in starts:
            found = fmpy.simulate_fmu(stop_time=STOP, output_interval=STEP, start_values=start, output=outputs, **how)
            final, peaks = found["link1.angle"][-1], [np.abs(found[name]).max() for name in outputs[1:]]
            assert np.isfinite([final, *peaks]).all()

    ways = {
        "the file": {"filename": str(path)},
        "unpacked once": {"filename": unpacked},
        "unpacked and its description read once": {"filename": unpacked, "model_description": description},
    }
    found = {}
    for name, how in ways.items():
        clock, busy = timed(lambda how=how: loop(**how))
        found[name] = clock / runs, busy / runs
    shutil.rmtree(unpacked, ignore_errors=True)
    return found


def swept(runs: int, workers: int, folder: Path) -> tuple[float, float]:
    """Return wall and processor time [s] of a sweep into a folder."""
    place = folder / f"sweep-{time.monotonic_ns()}"
    how = {"folder": place, "keep": KEEP, "stop_time": STOP, "communication_step": STEP, "workers": workers}
    found = timed(lambda: alfmu.sweep("five_bar", VARY, runs, kernel="auto", **how))
    sweep = alfmu.Sweep.load(place)
    assert len(sweep) == runs
    assert not (sweep["failure"] != "").any()
    shutil.rmtree(place)
    return found


def watched(cases: Iterable[int], most: dict[str, float]) -> Iterator[int]:
    """Yield finished cases, and record the peak memory [MB] of this process and its children (on Linux)."""
    for case in cases:
        if case % 1000 == 0:
            pid = os.getpid()
            for who in [pid, *map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())]:
                lines = Path(f"/proc/{who}/status").read_text().splitlines()
                held = next((float(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM")), 0.0)
                key = "own" if who == pid else "worker"
                most[key] = max(most.get(key, 0.0), held)
        yield case


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--runs", type=int, default=20_000, help="of a sweep on one core and all (default: %(default)s)"
    )
    parser.add_argument("--all", type=int, default=100_000, help="of the large sweep (default: %(default)s)")
    parser.add_argument("--repeat", type=int, default=3, help="times that each is measured (default: %(default)s)")
    parser.add_argument("--fmpy", type=int, default=100, help="runs by fmpy each time (default: %(default)s)")
    chosen = parser.parse_args()
    count = processors()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        swept(2000, 1, folder)  # traces and compiles
        each = {n: [swept(chosen.runs, n, folder) for _ in range(chosen.repeat)] for n in (1, count)}
        best = {n: (min(x[0] for x in times), min(x[1] for x in times)) for n, times in each.items()}
        for n, (clock, busy) in best.items():
            print(
                f"sweep, workers {n}: {chosen.runs} runs in {clock:.2f} s, {chosen.runs / clock:.0f} runs/s, "
                f"{1e3 * busy / chosen.runs:.3f} ms of a processor each; best of {chosen.repeat}"
            )
        if count > 1:
            speed, share = (best[1][k] / best[count][k] for k in (0, 1))
            print(
                f"of ideal speed on {count} cores: {speed / count:.2f} by the clock, {share:.2f} by processors' time "
                f"(all that workers, writing and starting take beside one core's work)"
            )
        for kind in ("native", "python"):
            times = [by_fmpy(kind, chosen.fmpy, folder) for _ in range(chosen.repeat)]
            for way in times[0]:
                clock, busy = (min(x[way][k] for x in times) for k in (0, 1))
                print(
                    f"fmpy.simulate_fmu, {kind}, {way}: {chosen.fmpy} runs, {1e3 * clock:.2f} ms each, "
                    f"{1e3 * busy:.2f} ms of a processor; the sweep has "
                    f"{clock * chosen.runs / best[count][0]:.0f} times the throughput on {count} cores by the clock, "
                    f"{busy * chosen.runs / best[1][1]:.1f} times on one by processors' time"
                )
        place = folder / "all"
        how = {"folder": place, "keep": [*KEEP, "*.force.*"], "stop_time": STOP, "communication_step": STEP}
        memory: dict[str, float] = {}
        clock, busy = timed(
            lambda: alfmu.sweep("five_bar", VARY, chosen.all, **how, progress=lambda x: watched(x, memory))
        )
        sweep = alfmu.Sweep.load(place)
        size = sum(path.stat().st_size for path in place.iterdir()) / 1e6
        print(
            f"{len(sweep)} runs in {clock:.0f} s ({busy:.0f} s of processors), {len(sweep.names)} columns, "
            f"{len(list(place.glob('part-*')))} parts, {size:.0f} MB; most memory of this process "
            f"{memory['own']:.0f} MB, of a worker {memory['worker']:.0f} MB"
        )
        clock, _ = timed(sweep.save)
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(f"summary and page of {len(sweep)} runs in {clock:.1f} s, with {most:.0f} MB at most")


if __name__ == "__main__":
    main()
