"""Accelerations of files by the mass matrix, bias and Jacobians of MuJoCo and Pinocchio, with rigid constraints."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

import alfmu
from alfmu.analysis.situation import situation, source

SCALAR = (2, 3)
"""Types of joints with one coordinate in MuJoCo: slide and hinge."""


def plain(name: str) -> str:
    return name.replace(" ", "_")


def product(a: NDArray, b: NDArray) -> NDArray:
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def matrix(e: NDArray) -> NDArray:
    w, x = e[0], e[1:]
    return (w * w - x @ x) * np.eye(3) + 2 * np.outer(x, x) + 2 * w * np.cross(x, np.eye(3)).T


def moving(path: Path, seed: int) -> tuple[list[str], NDArray, NDArray, NDArray, NDArray]:
    """Names of coordinates, places, rates, accelerations and inputs at random starts, loops closed by alfmu."""
    rng = np.random.default_rng(seed)
    mechanism = alfmu.imported(path).mechanism
    given: dict[str, float] = {}
    for s in mechanism.starts:
        given |= {f"start.{s.name}": s.value + 0.2 * rng.normal(), f"start.{s.rate_name}": rng.normal()}
    found = situation(source(mechanism, given))
    e, q, v = found.equations, found.state.q, found.state.v
    u = 2 * rng.normal(size=len(mechanism.inputs))
    fed = np.concatenate([u, np.zeros(len(mechanism.states))])  # MuJoCo's activations begin at zero
    M, C, F, xi = (np.array(x) for x in e.functions["dynamics"](q, v, fed, found.p, 0.0))
    whole = np.block([[M, C.T], [C, np.zeros((len(C),) * 2)]])
    a = np.linalg.lstsq(whole, np.concatenate([F.ravel(), xi.ravel()]), rcond=1e-13)[0][: len(M)]
    return [c.name for c in e.coordinates], q, v, a, u


def by_mujoco(
    path: Path, names: list[str], q: NDArray, v: NDArray, a: NDArray, u: NDArray
) -> tuple[NDArray, NDArray, float]:
    """alfmu's accelerations in MuJoCo's coordinates, MuJoCo's at the same places and rates, and how loops open.

    Joints that alfmu has no coordinate for stand and move as MuJoCo's constraints have them, and are left out.
    """
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for j in range(model.njnt):
        at = model.jnt_qposadr[j]
        # Body frames of alfmu are parallel to the ground where all coordinates are zero; quaternions begin as they are.
        if model.jnt_type[j] in SCALAR:
            data.qpos[at] = 0.0
    mujoco.mj_forward(model, data)
    zero = data.xmat.reshape(-1, 3, 3).copy()
    places, rates, found = np.zeros(model.nq), np.zeros(model.nv), np.zeros(model.nv)
    unknown = np.zeros(model.nv, dtype=bool)
    for j in range(model.njnt):
        at, d, body = model.jnt_qposadr[j], model.jnt_dofadr[j], model.jnt_bodyid[j]
        name, link, R = plain(model.joint(j).name or ""), plain(model.body(body).name), zero[body]
        kind = model.jnt_type[j]
        if kind in SCALAR:
            k = next((names.index(x) for x in (f"{name}_angle", f"{name}_position", name) if x in names), None)
            if k is None:
                unknown[d] = True
            else:
                places[at], rates[d], found[d] = q[k], v[k], a[k]
            continue
        free = int(kind) == int(mujoco.mjtJoint.mjJNT_FREE)
        k = [names.index(f"{link if free else name}_e{i}") for i in range(4)]
        e, back = q[k], np.array([1, -1, -1, -1]) * q[k]
        w, dw = 2 * product(back, v[k])[1:], 2 * product(back, a[k])[1:]
        d, at = d + 3 * free, at + 3 * free
        rates[d : d + 3], found[d : d + 3] = R.T @ w, R.T @ dw
        places[at : at + 4] = e[0], *(R.T @ e[1:])
        if free:
            turn = matrix(e)
            mujoco.mju_mat2Quat(places[at : at + 4], (turn @ R).ravel())
            k, arm = [names.index(f"{link}_{x}") for x in "xyz"], -turn @ R @ model.body_ipos[body]
            w, dw = turn @ w, turn @ dw
            places[at - 3 : at] = q[k] + arm
            rates[d - 3 : d] = v[k] + np.cross(w, arm)
            found[d - 3 : d] = a[k] + np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
    if unknown.any():
        _follow(model, data, unknown, places, rates)
    reference, _, opens = mujoco_accelerations(path, places, rates, u)
    return found[~unknown], reference[~unknown], opens


def _follow(model: Any, data: Any, unknown: NDArray, places: NDArray, rates: NDArray) -> None:
    """Places and rates of joints by MuJoCo's constraints, in place (Newton's method with its Jacobian)."""
    import mujoco

    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    data.qpos[:] = places
    for _ in range(12):
        mujoco.mj_forward(model, data)
        J, gaps = data.efc_J.reshape(-1, model.nv), data.efc_pos.copy()
        step = np.zeros(model.nv)
        step[unknown] = np.linalg.lstsq(J[:, unknown], -gaps)[0]
        mujoco.mj_integratePos(model, data.qpos, step, 1.0)
    assert np.abs(gaps).max() < 1e-11
    places[:] = data.qpos
    rates[unknown] = np.linalg.lstsq(J[:, unknown], -J[:, ~unknown] @ rates[~unknown])[0]


def mujoco_accelerations(
    path: Path, qpos: NDArray | None, qvel: NDArray, controls: NDArray, rubs: bool = False
) -> tuple[NDArray, NDArray, float]:
    """Accelerations, the places they were taken at, and the largest rate at which a constraint opens; if it rubs, with
    the dry friction of joints, all of which slide."""
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
    f = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias - rubs * model.dof_frictionloss * np.sign(qvel)
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
        if model.eq_objtype[i] == mujoco.mjtObj.mjOBJ_SITE:
            anchor, other = model.site_pos[[one, two]]
            one, two = model.site_bodyid[[one, two]]
        else:
            anchor, other = model.eq_data[i, :3], model.eq_data[i, 3:6]
            if kind == mujoco.mjtEq.mjEQ_WELD:
                anchor, other = other, anchor
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


def by_pinocchio(
    path: Path, rates: Mapping[str, float], efforts: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Accelerations of the joints of a URDF at its zero, with its loops rigid, and the largest rate at which a loop
    opens."""
    import pinocchio

    root = ElementTree.parse(path).getroot()
    model = pinocchio.buildModelFromUrdf(str(path))
    at = {name: model.joints[model.getJointId(name)].idx_v for name in list(model.names)[1:]}
    loops = []
    for loop in root.findall("loop_joint"):
        frames = []
        for end in (loop.find("link1"), loop.find("link2")):
            frame = model.frames[model.getFrameId(end.get("link"))]
            xyz, rpy = (np.array(end.get(k).split(), dtype=float) for k in ("xyz", "rpy"))
            placed = frame.placement * pinocchio.SE3(pinocchio.rpy.rpyToMatrix(*rpy), xyz)
            name = f"{loop.get('name')}{len(frames)}"
            frames.append(model.addFrame(pinocchio.Frame(name, frame.parentJoint, 0, placed, pinocchio.OP_FRAME)))
        axes = [np.array(axis.get("xyz").split(), dtype=float) for axis in loop.findall("axis")]
        loops.append((loop.get("type"), frames, axes))
    data, q, n = model.createData(), pinocchio.neutral(model), model.nv
    v, tau = np.zeros(n), np.zeros(n)
    for given, into in ((rates, v), (efforts, tau)):
        for name, x in given.items():
            into[at[name]] = x
    for joint in root.findall("joint"):
        resists = joint.find("dynamics")
        if resists is not None:
            k = at[joint.get("name")]
            tau[k] -= float(resists.get("damping")) * v[k] + float(resists.get("friction")) * np.sign(v[k])
    M, h = pinocchio.crba(model, data, q).copy(), pinocchio.nonLinearEffects(model, data, q, v).copy()
    M = np.triu(M) + np.triu(M, 1).T
    pinocchio.forwardKinematics(model, data, q, v, np.zeros(n))
    pinocchio.computeJointJacobians(model, data, q)
    pinocchio.updateFramePlacements(model, data)
    rows, drifts = [np.zeros((0, n))], [np.zeros(0)]
    for kind, frames, axes in loops:
        which = pinocchio.LOCAL_WORLD_ALIGNED
        J = [pinocchio.getFrameJacobian(model, data, each, which) for each in frames]
        a = [pinocchio.getFrameClassicalAcceleration(model, data, each, which).vector for each in frames]
        apart, drift, spins = J[1] - J[0], a[1] - a[0], [x[3:] @ v for x in J]
        assert np.abs(data.oMf[frames[0]].translation - data.oMf[frames[1]].translation).max() < 1e-12
        if kind == "fixed":
            kept, more = np.eye(6), np.zeros(6)
        elif kind == "spherical":
            kept, more = np.eye(6)[:3], np.zeros(3)
        else:
            along = data.oMf[frames[0]].rotation @ axes[0]
            normals = np.linalg.svd(along[None])[2][1:]
            turning = np.cross(spins[0], normals)
            if kind == "revolute":
                kept = np.vstack((np.eye(6)[:3], np.hstack((np.zeros((2, 3)), normals))))
                more = np.concatenate((np.zeros(3), turning @ (spins[1] - spins[0])))
            else:
                kept = np.vstack((np.hstack((normals, np.zeros((2, 3)))), np.eye(6)[3:]))
                more = np.concatenate((2 * turning @ (apart[:3] @ v), np.zeros(3)))
        rows.append(kept @ apart)
        drifts.append(kept @ drift + more)
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            row = np.zeros((1, n))
            row[0, at[joint.get("name")]], row[0, at[mimic.get("joint")]] = 1.0, -float(mimic.get("multiplier"))
            rows.append(row)
            drifts.append(np.zeros(1))
    C, drift = np.vstack(rows), np.concatenate(drifts)
    whole = np.block([[M, C.T], [C, np.zeros((len(C),) * 2)]])
    found = np.linalg.lstsq(whole, np.concatenate([tau - h, -drift]), rcond=1e-13)[0]
    return {name: float(found[k]) for name, k in at.items()}, float(np.abs(C @ v).max(initial=0.0))
