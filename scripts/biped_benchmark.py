"""Thousands of bipeds with six loops side by side: steps a second and errors, beside MuJoCo and MJX with soft loops.

    python scripts/biped_benchmark.py [--count 4096] [--seconds 0.5] [--threads 2] [--codes alfmu,mujoco,mjx]

The bipeds of `tests/linkages/biped.xml` fall under constant torques, which are held over 0.02 s as by a trainer. Errors
are the largest of the joints' angles at the end, relative to a solution by SciPy's DOP853 of the equations with
MuJoCo's matrices and rigid loops; gaps are those of the loops. Needs `alfmu[mujoco]`, and for MJX the packages
mujoco-mjx and jax.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import alfmu

FILE = Path(__file__).parents[1] / "tests" / "linkages" / "biped.xml"
HELD = 0.02
"""Time over which torques are held [s]."""

Numbers = NDArray[np.float64]


def torques(count: int) -> Numbers:
    """Return constant torques (12,) of the motors [N.m]."""
    return 0.1 * np.sin(np.arange(1, count + 1))


class Rigid:
    """The biped with MuJoCo's matrices, its loops as rigid rows."""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(FILE))
        self.data = mujoco.MjData(self.model)
        self.data.ctrl[:] = torques(self.model.nu)

    def rows(self, of: Callable[..., None]) -> Numbers:
        """Return rows of all loops by `mj_jac`, or their rates by `mj_jacDot`."""
        m, d, made = self.model, self.data, []
        for one, other, anchors in zip(m.eq_obj1id, m.eq_obj2id, m.eq_data, strict=True):
            both = np.zeros((2, 3, m.nv))
            for rows, body, anchor in zip(both, (one, other), (anchors[:3], anchors[3:6]), strict=True):
                of(m, d, rows, None, d.xpos[body] + d.xmat[body].reshape(3, 3) @ anchor, body)
            made.append(both[0] - both[1])
        return np.concatenate(made)

    def accelerations(self, q: Numbers, v: Numbers) -> Numbers:
        """Return rigid accelerations."""
        m, d = self.model, self.data
        d.qpos[:], d.qvel[:] = q, v
        mujoco.mj_fwdPosition(m, d)
        mujoco.mj_fwdVelocity(m, d)
        mujoco.mj_fwdActuation(m, d)
        J, M = self.rows(mujoco.mj_jac), np.zeros((m.nv, m.nv))
        for column, one in zip(M, np.eye(m.nv), strict=True):
            mujoco.mj_mulM(m, d, column, one)
        force = d.qfrc_actuator + d.qfrc_passive - d.qfrc_bias
        whole = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
        right = np.concatenate([force, -self.rows(mujoco.mj_jacDot) @ v])
        return np.linalg.lstsq(whole, right)[0][: m.nv]  # some rows are redundant

    def __call__(self, t: float, state: Numbers) -> Numbers:
        q, v = state[: self.model.nq].copy(), state[self.model.nq :]
        q[3:7] /= np.linalg.norm(q[3:7])
        turned = np.zeros(4)
        mujoco.mju_derivQuat(turned, q[3:7], v[3:6])
        return np.concatenate([v[:3], turned, v[6:], self.accelerations(q, v)])


def reference(seconds: float) -> Numbers:
    """Return the angles of the joints at the end."""
    rigid = Rigid()
    begin = np.concatenate([rigid.model.qpos0, np.zeros(rigid.model.nv)])
    found = solve_ivp(rigid, (0.0, seconds), begin, "DOP853", rtol=1e-11, atol=1e-12)
    return found.y[7 : rigid.model.nq, -1]


def by_alfmu(count: int, seconds: float, threads: int) -> Iterator[tuple[str, float, Numbers, float]]:
    model = mujoco.MjModel.from_xml_path(str(FILE))
    names = [f"{model.joint(k).name}.angle" for k in range(1, model.njnt)]
    declared = alfmu.load(FILE)
    for step in (1e-3, 2e-3, 5e-3):
        own = {"solver.method": "rk4", "solver.step_size": step}
        batch = alfmu.Batch(declared, count, own, [*names, "monitor.position_error"], threads)
        batch.set_many(batch.inputs, torques(model.nu))
        batch.initialize()
        took = timed(lambda batch=batch: batch.step(HELD), seconds)
        *angles, gap = batch.get(*names, "monitor.position_error")[0]
        yield f"alfmu, RK4, {1e3 * step:g} ms", took, np.array(angles), gap


def by_mujoco(count: int, seconds: float, threads: int) -> Iterator[tuple[str, float, Numbers, float]]:
    for name, integrator in (("Euler", 0), ("RK4", 1), ("implicitfast", 3)):
        for step in (1e-3, 2e-3):
            model = mujoco.MjModel.from_xml_path(str(FILE))
            model.opt.timestep, model.opt.integrator = step, integrator
            datas = [mujoco.MjData(model) for _ in range(threads)]
            every = np.empty((count, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
            mujoco.mj_getState(model, datas[0], every[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            every[:] = every[0]
            steps = round(HELD / step)
            held = np.broadcast_to(torques(model.nu), (count, steps, model.nu))

            def move(model=model, datas=datas, every=every, held=held) -> None:
                every[:] = mujoco.rollout.rollout(model, datas, every, held)[0][:, -1]

            took = timed(move, seconds)
            data = datas[0]
            mujoco.mj_setState(model, data, every[0], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            mujoco.mj_forward(model, data)
            yield (
                f"MuJoCo, {name}, {1e3 * step:g} ms",
                took,
                data.qpos[7:].copy(),
                np.abs(data.efc_pos[: data.ne]).max(),
            )


def by_mjx(count: int, seconds: float, threads: int) -> Iterator[tuple[str, float, Numbers, float]]:
    import jax
    from mujoco import mjx

    jax.config.update("jax_enable_x64", True)
    model = mujoco.MjModel.from_xml_path(str(FILE))
    model.opt.timestep = 2e-3
    device, begin = mjx.put_model(model), mujoco.MjData(model)
    mujoco.mj_forward(model, begin)
    one = mjx.put_data(model, begin).replace(ctrl=jax.numpy.array(torques(model.nu)))
    every = [jax.tree.map(lambda x: jax.numpy.broadcast_to(x, (count, *x.shape)), one)]
    step = jax.jit(jax.vmap(lambda d: jax.lax.fori_loop(0, round(HELD / 2e-3), lambda _, d: mjx.step(device, d), d)))
    step(every[0]).qpos.block_until_ready()

    def move() -> None:
        every[0] = step(every[0])
        every[0].qpos.block_until_ready()

    took = timed(move, seconds)
    begin.qpos[:], begin.qvel[:] = every[0].qpos[0], every[0].qvel[0]
    mujoco.mj_forward(model, begin)
    yield "MJX on the processor, Euler, 2 ms", took, begin.qpos[7:].copy(), np.abs(begin.efc_pos[: begin.ne]).max()


def timed(move: Callable[[], object], seconds: float) -> float:
    """Return the shortest time of the moves over some seconds."""
    taken = []
    for _ in range(round(seconds / HELD)):
        begun = time.perf_counter()
        move()
        taken.append(time.perf_counter() - begun)
    return min(taken)


CODES = {"alfmu": by_alfmu, "mujoco": by_mujoco, "mjx": by_mjx}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=4096)
    parser.add_argument("--seconds", type=float, default=0.5)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--codes", type=lambda text: text.split(","), default=list(CODES))
    chosen = parser.parse_args()
    exact = reference(chosen.seconds)
    print(f"{chosen.count} bipeds, {chosen.threads} threads, torques held over {HELD} s, after {chosen.seconds} s")
    for code in chosen.codes:
        for name, took, angles, gap in CODES[code](chosen.count, chosen.seconds, chosen.threads):
            rate, error = chosen.count / took, np.abs(angles - exact).max()
            print(f"{name:34} {rate:9.0f} steps/s  error {error:.1e} rad  loops open by {gap:.1e} m", flush=True)


if __name__ == "__main__":
    main()
