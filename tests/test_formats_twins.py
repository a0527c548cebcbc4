"""SDF and URDF against MuJoCo's matrices for the same mechanism written in MJCF, and URDF against Pinocchio."""

import importlib.util
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from oracles import chains
from oracles.linkages import by_mujoco, moving
from scipy.integrate import solve_ivp

import alfmu

MUJOCO = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed (extra bench)")


def judge(folder: Path, name: str, content: str, twin: str, gravity: float, seeds: int = 1) -> None:
    """Accelerations of a file and of MuJoCo for its twin are the same."""
    path, other = folder / name, folder / "twin.xml"
    path.write_text(content)
    other.write_text(twin.replace("{}", str(gravity)))
    for seed in range(seeds):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", alfmu.AlfmuWarning)
            state = moving(path, seed)
        found, reference, opens = by_mujoco(other, *state)
        assert len(found) == sum("_e" not in each for each in state[0])
        assert opens < 1e-11
        assert np.abs(reference).max() > 1
        np.testing.assert_allclose(found, reference, atol=1e-9 * np.abs(reference).max(), rtol=0)


@MUJOCO
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw", "universal"])
@pytest.mark.parametrize("reverse", ["", "-"])
def test_joints_of_sdf_move_as_in_mujoco(kind: str, reverse: str, tmp_path: Path):
    chain = chains.parts(["revolute", reverse + kind, "revolute"], 3, at=0.1)
    judge(tmp_path, "chain.sdf", chains.sdf(chain), chains.mjcf(chain), -9.8)


@MUJOCO
def test_mimic_of_sdf_is_a_coupling(tmp_path: Path):
    chain = chains.parts(["revolute", "-prismatic", "revolute", "revolute"], 4, at=0.1)
    chain[2] = replace(chain[2], follows=("l1j", 1.5, 0.1))
    judge(tmp_path, "chain.sdf", chains.sdf(chain), chains.mjcf(chain), -9.8)


AXES = (0.6, 0.0, 0.8), chains.Y
OTHER = (0.2, 0.0, 0.1, 0.4, 0.6, -0.3)
"""Where a joint that closes a loop stands in the last link."""

ENDS = "l0", "l7"
OF = "drake:ball_constraint_"


def loop() -> tuple[list[chains.Part], tuple[chains.Numbers, chains.Numbers]]:
    """A chain of eight, and frames of its ends that nearly coincide where all coordinates are zero."""
    chain = chains.parts(["revolute"] * 8, 6)
    return chain, (chains.nearly(chain, OTHER), OTHER)


@MUJOCO
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "spherical", "fixed", "drake"])
def test_loops_of_urdf_are_closed_as_in_mujoco(kind: str, tmp_path: Path):
    chain, frames = loop()
    if kind == "drake":
        said = "".join(
            f'<{OF}body_{a} name="{link}"/><{OF}p_{b} value="{chains.text(at[:3])}"/>'
            for a, b, link, at in zip("AB", ("AP", "BQ"), ENDS, frames, strict=True)
        )
        said = f"<drake:ball_constraint>{said}</drake:ball_constraint>"
    else:
        said = "".join(
            f'<link{i} link="{link}" xyz="{chains.text(at[:3])}" rpy="{chains.text(at[3:])}"/>'
            for i, link, at in zip((1, 2), ENDS, frames, strict=True)
        )
        said = f'<loop_joint name="loop" type="{kind}">{said}<axis xyz="{chains.text(AXES[0])}"/></loop_joint>'
    known = {"spherical": "ball", "drake": "ball"}.get(kind, kind)
    twin = chains.mjcf(chain, *chains.closing(known, ENDS, frames, AXES, False))
    judge(tmp_path, "chain.urdf", chains.urdf(chain, said), twin, -9.81)


@MUJOCO
@pytest.mark.parametrize("kind", ["revolute", "prismatic", "screw", "universal", "ball", "fixed", "drake"])
def test_loops_of_sdf_are_closed_as_in_mujoco(kind: str, tmp_path: Path):
    chain, frames = loop()
    if kind == "drake":
        said = "".join(
            f"<{OF}body_{a}>{link}</{OF}body_{a}><{OF}p_{b}>{chains.text(at[:3])}</{OF}p_{b}>"
            for a, b, link, at in zip("AB", ("AP", "BQ"), ENDS, frames, strict=True)
        )
        said = f"<drake:ball_constraint>{said}</drake:ball_constraint>"
    else:
        axes = "".join(
            f"<axis{i}><xyz>{chains.text(axis)}</xyz></axis{i}>" for i, axis in zip(("", 2), AXES, strict=True)
        )
        said = (
            f'<joint name="loop" type="{kind}"><pose relative_to="l0">{chains.text(frames[0])}</pose>'
            f"<parent>l0</parent><child>l7</child>{axes}"
            f"<screw_thread_pitch>{chains.PITCH}</screw_thread_pitch></joint>"
        )
    drake = kind == "drake"
    twin = chains.mjcf(chain, *chains.closing("ball" if drake else kind, ENDS, frames, AXES, not drake))
    judge(tmp_path, "chain.sdf", chains.sdf(chain, said), twin, -9.8)


@MUJOCO
@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_loops_closed_at_sites(kind: str, tmp_path: Path):
    chain, frames = loop()
    sites = {
        link: f'<site name="{link}" pos="{chains.text(at[:3])}" euler="{chains.text(at[3:])}"/>'
        for link, at in zip(ENDS, frames, strict=True)
    }
    twin = chains.mjcf(chain, sites, f'<{kind} site1="l0" site2="l7"/>')
    judge(tmp_path, "chain.xml", twin.replace("{}", "-9.81"), twin, -9.81)


def test_a_parallelogram_that_starts_flat_turns_as_its_pendulum(tmp_path: Path):
    """Two motions begin there; that of both cranks alike is taken, by one start value."""
    rod = '<geom type="box" size="0.01" mass="{}" fromto="0 0 0 {} 0 0"/>'
    crank, coupler = rod.format(0.3, 0.2), rod.format(0.5, 0.4)
    path = tmp_path / "flat.xml"
    path.write_text(
        '<mujoco><option><flag contact="disable"/></option><default><joint axis="0 -1 0"/></default><worldbody>'
        f'<body><joint name="left"/>{crank}<body name="b" pos="0.2 0 0"><joint/>{coupler}</body></body>'
        f'<body name="c" pos="0.4 0 0"><joint name="right"/>{crank}</body></worldbody>'
        '<equality><connect body1="b" body2="c" anchor="0.4 0 0"/></equality></mujoco>'
    )
    mechanism = alfmu.imported(path).mechanism
    assert [s.name for s in mechanism.starts] == ["left_angle"]
    run = alfmu.simulate(mechanism, 0.6, 0.02, parameters={"solver.relative_tolerance": 1e-9})
    # A thin box with square ends of 2 cm about its end; the coupler moves on a circle without turning.
    about = 0.3 * ((0.2**2 + 0.02**2) / 12 + 0.1**2)
    size, lever = 2 * about + 0.5 * 0.2**2, 2 * 0.3 * 0.1 + 0.5 * 0.2
    pendulum = solve_ivp(
        lambda t, y: (y[1], -lever * 9.81 / size * np.cos(y[0])), (0, 0.6), (0, 0), rtol=1e-12, atol=1e-12,
        t_eval=run["time"],
    )  # fmt: skip
    assert pendulum.y[0].min() < -np.pi + 0.01  # on to where it is flat again
    np.testing.assert_allclose(run["left.angle"], pendulum.y[0], atol=1e-7)
    np.testing.assert_allclose(run["right.angle"], pendulum.y[0], atol=1e-7)
    with pytest.raises(alfmu.AlfmuError, match="rates belong to none of the motions possible there"):
        alfmu.simulate(mechanism, 0.1, 0.1, parameters={"start.left_angle_rate": 2.0})


@pytest.mark.skipif(importlib.util.find_spec("pinocchio") is None, reason="Pinocchio is not installed (extra bench)")
def test_a_tree_of_urdf_moves_as_in_pinocchio(tmp_path: Path):
    import pinocchio

    chain = chains.parts(["revolute", "prismatic", "revolute", "continuous", "prismatic", "revolute"], 7)
    chain[3] = replace(chain[3], parent="l0", kind="revolute")  # a branch
    path = tmp_path / "tree.urdf"
    path.write_text(chains.urdf(chain))
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    for seed in range(4):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", alfmu.AlfmuWarning)
            names, q, v, a, _ = moving(path, seed)
        order = [next(i for i, each in enumerate(names) if each.startswith(name)) for name in model.names[1:]]
        effort = -np.array([next(p for p in chain if f"{p.name}j" == name).damping[0] for name in model.names[1:]])
        reference = pinocchio.aba(model, data, q[order], v[order], effort * v[order])
        np.testing.assert_allclose(a[order], reference, atol=1e-10 * np.abs(reference).max(), rtol=0)
