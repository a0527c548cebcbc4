"""Draw parameters, starts and inputs at random for each mechanism, run it, and count the outcomes.

A run is wrong if energy minus work changes by more than 1e-3 of the largest kinetic energy or work at any communication
point; it is silent if no warning reports this. The exit code is 1 if a run is silent or ends in an error other than
alfmu's own.
"""

import argparse
import logging
import os
import sys
import traceback
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context

import numpy as np
from tqdm import tqdm

import alfmu
from alfmu.catalogue.registry import mechanisms
from alfmu.equations import Equations
from alfmu.equations.interface import variables_of
from alfmu.model.errors import collected
from alfmu.simulation import prepared, with_defaults

WRONG = 1e-3
"""Energy error over the energy of the motion [1] above which a run is wrong."""

DECADES = 1.0
"""Parameters with a default other than zero are drawn within this many decades on either side of it."""

STRONGEST = 1e3
"""Largest input [N, N.m]."""

KINDS = ("right", "warned", "ended", "refused", "silent", "traceback")
"""Outcomes: right; wrong with a warning; an error in the run, at its start; bad ones: wrong and silent, foreign
error."""


def drawn(equations: Equations, random: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Return random parameters and start values within their bounds, and constant inputs."""
    values, inputs = {}, {}
    for v in variables_of(equations).parameters:
        if v.name.startswith(("solver.", "compliance.")) or v.type != "Real":
            continue
        if v.name.startswith("start."):
            x = random.uniform(-np.pi, np.pi) if v.unit.startswith("rad") else v.start * random.uniform(0.8, 1.2)
        elif v.start:
            x = v.start * 10 ** random.uniform(-DECADES, DECADES)
        else:
            x = 0.0
        low, high = (-np.inf if v.minimum is None else v.minimum), (np.inf if v.maximum is None else v.maximum)
        values[v.name] = float(np.clip(x, low, high))
    for v in equations.inputs:
        inputs[v.name] = float(random.choice((-1, 1)) * 10 ** random.uniform(-2, np.log10(STRONGEST)))
    return values, inputs


def outcome(equations: Equations, values: dict[str, float], inputs: dict[str, float], stop: float) -> tuple[str, str]:
    """Return the outcome of a run, one of KINDS, and its messages."""
    unit = alfmu.Instance(equations)
    with collected() as said:
        try:
            for name, value in {**values, **inputs}.items():
                unit.set(name, value)
            unit.initialize()
            off = balance(unit, equations, stop)
        except alfmu.AlfmuError as error:
            return ("ended" if unit.initialized else "refused"), str(error)
        except Exception:
            return "traceback", traceback.format_exc()
    text = f"balance {off:.2g}; {'; '.join(said) or 'nothing said'}"
    if off <= WRONG:
        return "right", text
    return ("warned" if said else "silent"), text


def balance(unit: alfmu.Instance, equations: Equations, stop: float) -> float:
    """Run an instance; return the largest change of energy minus work over the largest kinetic energy or work."""
    energy = equations.functions["energy"]
    first, off, scale = unit.get("monitor.energy"), 0.0, 1e-300
    for _ in range(round(stop / equations.interval)):
        unit.step(equations.interval)
        now, work = unit.get("monitor.energy"), unit.work
        _, kinetic = energy(unit.q, unit.v, unit.memory["p"])
        off, scale = max(off, abs(now - first - work)), max(scale, float(kinetic), abs(work))
    return off / scale


@cache
def judged(name: str, method: str) -> Equations:
    """Return the scene of a mechanism, made once per process."""
    logging.getLogger("alfmu").addHandler(logging.NullHandler())
    logging.getLogger("alfmu").propagate = False
    equations = alfmu.derive(alfmu.load(name))
    return prepared(with_defaults(equations, {"solver.method": method} if method else {}), "auto")


def one(name: str, method: str, stop: float, values: dict[str, float], inputs: dict[str, float]) -> tuple[str, str]:
    """Return the outcome of a draw, in any process."""
    equations = judged(name, method)
    return outcome(equations, values, inputs, min(stop, equations.stop_time))


def counted(
    name: str, draws: int, method: str, stop: float, seed: int, show: bool = False, jobs: int = 1
) -> Counter[str]:
    """Count the outcomes of draws of a mechanism, independent of the number of processes."""
    equations, random, found = judged(name, method), np.random.default_rng(seed), Counter()
    all_drawn = [drawn(equations, random) for _ in range(draws)]
    with tqdm(outcomes(name, method, stop, all_drawn, jobs), name, draws, leave=False, disable=None) as progress:
        for i, (kind, text) in enumerate(progress):
            found[kind] += 1
            progress.set_postfix(found, refresh=False)
            if kind in ("silent", "traceback") or show:
                said = f"{name}, draw {i}: {kind}: {text}\n    {all_drawn[i][0] | all_drawn[i][1]}"
                progress.write(said, file=sys.stderr)
                sys.stderr.flush()
    return found


def outcomes(
    name: str, method: str, stop: float, all_drawn: list[tuple[dict[str, float], dict[str, float]]], jobs: int
) -> Iterator[tuple[str, str]]:
    """Yield the outcomes of draws in order, as soon as each is known."""
    if jobs == 1:
        yield from (one(name, method, stop, *each) for each in all_drawn)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool:
        waiting = [pool.submit(one, name, method, stop, *each) for each in all_drawn]
        for each in waiting:
            yield each.result()


def main(arguments: list[str] | None = None) -> int:
    """Count and print the outcomes; return 1 if any run was bad, else 0."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--draws", type=int, default=1000, help="of each mechanism (default: %(default)s)")
    parser.add_argument("--only", nargs="+", choices=sorted(mechanisms()), default=sorted(mechanisms()), metavar="NAME")
    parser.add_argument("--method", default="", help="solver.method (default: the mechanism's own)")
    parser.add_argument("--stop-time", type=float, default=4.0, help="at most [s] (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the draws (default: %(default)s)")
    parser.add_argument("--show", action="store_true", help="every draw, not only those that are bad")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    print(f"{'mechanism':20}", *(f"{kind:>9}" for kind in KINDS))
    bad = 0
    for name in chosen.only:
        how = (chosen.method, chosen.stop_time, chosen.seed, chosen.show, chosen.jobs)
        found = counted(name, chosen.draws, *how)
        print(f"{name:20}", *(f"{found[kind]:9d}" for kind in KINDS), flush=True)
        bad += found["silent"] + found["traceback"]
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
