"""Cost of a step of a six-body chain in relative coordinates, beside Pinocchio's articulated-body algorithm.

Both integrate the same chain, hinges about z, y, y, x, y, x with full matrices of inertia, by RK4 with steps of 1 ms.
The time of the processor is of the best of some runs. Pinocchio is called from Python, as its packages
have it, so that its time is that of its recursion alone: what a body adds to a call, times six, times the four
evaluations of a step. It needs `pip install -e ".[bench]"`.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import alfmu
from alfmu.simulation import prepared

AXES = [(0, 0, 1), (0, 1, 0), (0, 1, 0), (1, 0, 0), (0, 1, 0), (1, 0, 0)]
CENTER, NEXT, STEP, STEPS = (0.1, 0.02, 0.05), (0.1, 0.0, 0.3), 1e-3, 1000


def inertia(i: int) -> np.ndarray:
    """Matrix of inertia (3, 3) [kg.m2] of body i, one that no frame makes diagonal at a glance."""
    A = np.random.default_rng(i).normal(size=(3, 3))
    E = 0.01 * A @ A.T
    return np.trace(E) * np.eye(3) - E


def chain(bodies: int) -> alfmu.Mechanism:
    """The chain, started with all angles at 0.1 rad times their number."""
    m = alfmu.Mechanism("chain")
    m.gravity(0, 0, -9.81)
    before = m.spatial_ground.at()
    for i in range(bodies):
        angle = m.coordinate(f"angle{i}", "rad", start=0.1 * (i + 1), independent=True)
        body = m.spatial_body(f"body{i}", mass=1.0 + i, inertia=inertia(i), center=CENTER, relative=True)
        m.spatial_revolute(f"hinge{i}", before, body.at(), axis=AXES[i % 6], coordinate=angle)
        before = body.at(*NEXT)
    return m


def pinocchios(bodies: int):
    """The same as a model of Pinocchio."""
    import pinocchio as pin

    model, parent = pin.Model(), 0
    model.gravity.linear = np.array([0, 0, -9.81])
    joints = {(1, 0, 0): pin.JointModelRX, (0, 1, 0): pin.JointModelRY, (0, 0, 1): pin.JointModelRZ}
    for i in range(bodies):
        place = pin.SE3(np.eye(3), np.array(NEXT) if i else np.zeros(3))
        parent = model.addJoint(parent, joints[AXES[i % 6]](), place, f"hinge{i}")
        model.appendBodyToJoint(parent, pin.Inertia(1.0 + i, np.array(CENTER), inertia(i)), pin.SE3.Identity())
    return model


def best(run: Callable[[], object], times: int) -> float:
    """Time of the processor [us] of the quickest of some runs."""
    found = []
    for _ in range(times):
        began = time.process_time()
        run()
        found.append(time.process_time() - began)
    return 1e6 * min(found)


def main() -> None:
    """Print operations and times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=9, help="runs, of which the quickest counts")
    times = parser.parse_args().times
    equations = alfmu.derive(chain(6))
    print(f"operations of M, f - d: {equations.functions['dynamics'].n_instructions()}")
    steps, ends = {}, {}
    for kernel in ("vm", "compiled"):
        i = alfmu.Instance(prepared(equations, kernel))
        i.set("solver.method", "rk4")
        i.set("solver.step_size", STEP)
        i.initialize()
        i.step(STEP * STEPS)
        ends[kernel] = i.q.copy()
        steps[kernel] = best(lambda i=i: i.step(STEP * STEPS), times) / STEPS
        print(f"{kernel}: a step takes {steps[kernel]:.2f} us")
    try:
        import pinocchio as pin
    except ImportError:
        print('Pinocchio is not installed: pip install -e ".[bench]"')
        return

    def calls(bodies: int) -> float:
        model = pinocchios(bodies)
        data, (q, v, tau) = model.createData(), np.random.default_rng(1).normal(size=(3, bodies))
        return best(lambda: [pin.aba(model, data, q, v, tau) for _ in range(STEPS)], times) / STEPS

    model = pinocchios(6)
    data, q, v, tau = model.createData(), 0.1 * np.arange(1, 7), np.zeros(6), np.zeros(6)

    def rate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return pin.aba(model, data, q, v, tau).copy()

    for _ in range(STEPS):
        a1, v2 = rate(q, v), v + STEP / 2 * rate(q, v)
        a2 = rate(q + STEP / 2 * v, v2)
        v3 = v + STEP / 2 * a2
        a3 = rate(q + STEP / 2 * v2, v3)
        v4 = v + STEP * a3
        a4 = rate(q + STEP * v3, v4)
        q, v = q + STEP / 6 * (v + 2 * v2 + 2 * v3 + v4), v + STEP / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    print(f"the angles agree to {np.abs(ends['vm'] - q).max():.1e} rad after {STEPS * STEP:g} s")
    each = (calls(24) - calls(6)) / 18
    print(f"Pinocchio: a call for six bodies takes {calls(6):.2f} us from Python, a body adds {each:.2f} us")
    for kernel, step in steps.items():
        print(f"{kernel}: {step / (4 * 6 * each):.2f} times four evaluations of Pinocchio")


if __name__ == "__main__":
    main()
