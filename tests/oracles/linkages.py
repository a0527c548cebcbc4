"""Accelerations of MJCF files by MuJoCo's mass matrix, bias and Jacobians, with rigid constraints (KKT)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def mujoco_accelerations(
    path: Path, qpos: NDArray | None, qvel: NDArray, controls: NDArray
) -> tuple[NDArray, NDArray, float]:
    """Accelerations, the places they were taken at, and the largest rate at which a constraint opens."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    data.qvel[:], data.ctrl[:] = qvel, controls
    mujoco.mj_forward(model, data)
    n = model.nv
    M = np.zeros((n, n))
    for i in range(n):
        unit, column = np.zeros(n), np.zeros(n)
        unit[i] = 1.0
        mujoco.mj_mulM(model, data, column, unit)
        M[:, i] = column
    f = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
    rows, drifts = [np.zeros((0, n))], [np.zeros(0)]

    def at(body: int, point: NDArray) -> tuple[NDArray, NDArray]:
        """The Jacobian (6, n) of a point and its rate."""
        J, rate = np.zeros((6, n)), np.zeros((6, n))
        mujoco.mj_jac(model, data, J[:3], J[3:], point, body)
        mujoco.mj_jacDot(model, data, rate[:3], rate[3:], point, body)
        return J, rate

    for i in range(model.neq):
        kind, one, two = model.eq_type[i], model.eq_obj1id[i], model.eq_obj2id[i]
        if not model.eq_active0[i]:
            continue
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            row, drift = np.zeros(n), 0.0
            row[model.jnt_dofadr[one]] = 1.0
            if two >= 0:
                x = data.qpos[model.jnt_qposadr[two]] - model.qpos0[model.jnt_qposadr[two]]
                c, v = model.eq_data[i, :5], qvel[model.jnt_dofadr[two]]
                row[model.jnt_dofadr[two]] -= c[1] + 2 * c[2] * x + 3 * c[3] * x**2 + 4 * c[4] * x**3
                drift = -(2 * c[2] + 6 * c[3] * x + 12 * c[4] * x**2) * v**2
            rows.append(row[None])
            drifts.append(np.array([drift]))
            continue
        assert model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_BODY
        anchor = model.eq_data[i, :3] if kind == mujoco.mjtEq.mjEQ_CONNECT else model.eq_data[i, 3:6]
        other = model.eq_data[i, 3:6] if kind == mujoco.mjtEq.mjEQ_CONNECT else model.eq_data[i, :3]
        # What stands in the first and the second body.
        p1 = data.xpos[one] + data.xmat[one].reshape(3, 3) @ anchor
        p2 = data.xpos[two] + data.xmat[two].reshape(3, 3) @ other
        (J1, r1), (J2, r2) = at(one, p1), at(two, p2)
        size = 3 if kind == mujoco.mjtEq.mjEQ_CONNECT else 6
        rows.append((J1 - J2)[:size])
        drifts.append(((r1 - r2) @ qvel)[:size])
    J, drift = np.vstack(rows), np.concatenate(drifts)
    l = len(J)
    whole = np.block([[M, J.T], [J, np.zeros((l, l))]])
    found, *_ = np.linalg.lstsq(whole, np.concatenate([f, -drift]), rcond=1e-13)
    return found[:n], data.qpos.copy(), float(np.abs(J @ qvel).max(initial=0.0))
