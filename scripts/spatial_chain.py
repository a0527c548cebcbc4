"""Cost of a step of a six-body chain in relative coordinates, beside Pinocchio's articulated-body algorithm.

Both integrate the same chain, hinges about z, y, y, x, y, x with full matrices of inertia, by RK4 with steps of 1 ms.
Processor times are those of the fastest of several runs. As Pinocchio (`pip install -e ".[bench]"`) is called from
Python, only its recursion is counted: the time that a body adds to a call, times six bodies, times four evaluations per
step.
"""

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np
from _singular_codes import mechanism
from _singular_problems import Problem, Run
from _study import clocked

import alfmu
from alfmu.method.integrators import rk4
from alfmu.simulation import prepared
from alfmu.studies.trees import GROUND, Body, pinocchio_model

AXES = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
CENTER, NEXT, STEP, STEPS = (0.1, 0.02, 0.05), (0.1, 0.0, 0.3), 1e-3, 1000


def inertia(i: int) -> np.ndarray:
    """Matrix of inertia (3, 3) [kg.m2] of body i, a full matrix."""
    A = np.random.default_rng(i).normal(size=(3, 3))
    E = 0.01 * A @ A.T
    return np.trace(E) * np.eye(3) - E


def chain(count: int) -> Problem:
    """Return the chain; angle number i starts at 0.1 i rad."""
    bodies = [
        Body(
            f"body{i}",
            f"body{i - 1}" if i else GROUND,
            NEXT if i else (0.0, 0.0, 0.0),
            1.0 + i,
            CENTER,
            inertia(i),
            axis=AXES[i % 6],
        )
        for i in range(count)
    ]
    start, names = Run(0.1 * np.arange(1, count + 1), np.zeros(count)), [body.name for body in bodies]
    return Problem("chain", "Chain", bodies, [], {}, [start], STEP * STEPS, names, (0.0, 0.0, -9.81))


def aba(bodies: int) -> Callable[..., np.ndarray]:
    """Return Pinocchio's recursion for the same chain: a function of q, v and torques that returns accelerations."""
    import pinocchio as pin

    model, _, _ = pinocchio_model(pin, chain(bodies))
    return partial(pin.aba, model, model.createData())


def main() -> None:
    """Print operations and times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=9, help="runs, of which the quickest counts")
    times = parser.parse_args().times

    def best(run: Callable[[], object]) -> float:
        """Return the time of a step [us] in the fastest of several runs of STEPS steps."""
        return 1e6 * min(clocked(run).repeat(times, 1)) / STEPS

    equations = alfmu.derive(mechanism(chain(6))[0])
    print(f"operations of M, f - d: {equations.functions['dynamics'].n_instructions()}")
    steps, ends = {}, {}
    for kernel in ("vm", "compiled"):
        i = alfmu.Instance(prepared(equations, kernel))
        i.set("solver.method", "rk4")
        i.set("solver.step_size", STEP)
        i.initialize()
        i.step(STEP * STEPS)
        ends[kernel] = i.q.copy()
        steps[kernel] = best(partial(i.step, STEP * STEPS))
        print(f"{kernel}: a step takes {steps[kernel]:.2f} us")
    try:
        six = aba(6)
    except ImportError:
        print('Pinocchio is not installed: pip install -e ".[bench]"')
        return
    y, tau = np.array([0.1 * np.arange(1, 7), np.zeros(6)]), np.zeros(6)
    for _ in range(STEPS):
        y = rk4(lambda t, y: np.array([y[1], six(*y, tau)]), 0.0, y, STEP)
    print(f"the angles agree to {np.abs(ends['vm'] - y[0]).max():.1e} rad after {STEPS * STEP:g} s")
    spent = {}
    for bodies, call in ((6, six), (24, aba(24))):
        given = np.random.default_rng(1).normal(size=(3, bodies))
        spent[bodies] = best(lambda call=call, given=given: [call(*given) for _ in range(STEPS)])
    each = (spent[24] - spent[6]) / 18
    print(f"Pinocchio: a call for six bodies takes {spent[6]:.2f} us from Python, a body adds {each:.2f} us")
    for kernel, step in steps.items():
        print(f"{kernel}: {step / (4 * 6 * each):.2f} times four evaluations of Pinocchio")


if __name__ == "__main__":
    main()
