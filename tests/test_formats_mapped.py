"""What files of other programs have beside bodies and joints: tendons, actuators, limits, models in models."""

import collections
import importlib.util
import re
import sys
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
from oracles.linkages import by_mujoco, moving
from scipy.integrate import solve_ivp

import alfmu
from alfmu.cli import main

MUJOCO = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed (extra bench)")

ARM = """<mujoco><compiler angle="radian"{compiler}/><option><flag contact="disable"/></option><worldbody>
<body name="a"{a}><joint name="ja" axis="0 1 0" armature="0.02"/><geom type="box" size="0.1 0.02 0.03" pos="0.1 0 0"/>
<body name="b" pos="0.2 0 0"><joint name="jb" axis="0 1 0" ref="0.4"{b}/><geom size="0.04" pos="0.1 0 0.02"/>
<body name="c" pos="0.2 0 0.02"><joint name="jc" type="slide" axis="1 0 0.2"/><geom type="box" size="0.05 0.01 0.02"/>
</body></body></body></worldbody>{after}</mujoco>"""
"""A chain of two hinges and a slide."""

TENDON = '<tendon><fixed name="t"{}><joint joint="jb" coef="2"/><joint joint="jc" coef="-3"/></fixed></tendon>'


REPLICAS = """<mujoco><compiler eulerseq="ZYx"/><option><flag contact="disable"/></option><worldbody>
<replicate count="3" offset="0.1 0.02 0" euler="20 5 3" sep="_"><body name="a" pos="0.2 0 0">
<joint name="ja" axis="0 1 0" armature="0.02"/><geom type="box" size="0.1 0.02 0.03" pos="0.1 0 0"/>
<replicate count="2" offset="0 0.05 0" euler="0 10 0"><body name="b" pos="0.2 0 0.01"><joint name="jb" axis="0 1 0.2"/>
<geom size="0.04" pos="0.1 0 0.02"/></body></replicate></body></replicate>
<body name="w" pos="1 0 0"><joint name="jw" axis="1 0 0"/><geom size="0.1" pos="0 0.1 0"/></body></worldbody>
<tendon><fixed name="t" stiffness="3"><joint joint="jb" coef="2"/></fixed>
<fixed name="u" damping="3"><joint joint="jb0_2" coef="1"/><joint joint="jw" coef="2"/></fixed></tendon>
<actuator><motor joint="ja" name="m"/></actuator></mujoco>"""
"""Replicas in replicas, with tendons and actuators that name them before and after they are numbered."""


def arm(compiler: str = "", a: str = "", b: str = "", after: str = "") -> str:
    return ARM.format(compiler=compiler, a=a, b=b, after=after)


@MUJOCO
@pytest.mark.parametrize(
    ("text", "twin"),
    [
        (arm(a=' gravcomp="1.3"'), ""),
        (arm(compiler=' boundmass="3" boundinertia="0.02" balanceinertia="true"'), ""),
        (arm(b=' springdamper="0.3 0.7" springref="0.2"'), ""),
        (arm(compiler=' settotalmass="7"'), ""),
        (arm(after=TENDON.format(' stiffness="40" damping="2"')), ""),
        (arm(after=TENDON.format(' stiffness="40" springlength="-0.5 0.3" armature="0.1"')), ""),
        (arm(after=TENDON.format("") + '<actuator><position tendon="t" kp="20" dampratio="0.7" gear="2" '
             'forcerange="-3 2"/><general joint="ja" gainprm="5" biastype="affine" biasprm="0.1 -5 0.4"/></actuator>'),
         ""),
        (arm(after='<default><general gainprm="7" biastype="affine" biasprm="0.3 -2 -0.5"/></default><actuator>'
             '<position joint="ja"/><position joint="jb" kp="3" kv="0.2"/><velocity joint="jc"/><motor joint="ja"/>'
             '</actuator>'), ""),
        (arm(b=' actuatorfrcrange="-0.5 0.5"',
             after='<actuator><motor joint="jb" gear="3"/><velocity joint="jb" kv="2"/></actuator>'), ""),
        (arm(b=' range="-0.3 1.1"', after='<actuator><position joint="jb" inheritrange="0.9"/></actuator>'), ""),
        (arm(after=TENDON.format("") + '<equality><tendon tendon1="t" polycoef="0.1"/></equality>'), "coupled"),
        (arm(after='<equality><weld body1="a" body2="c" torquescale="0" anchor="0.1 0 0"/></equality>'), "connect"),
        (REPLICAS, ""),
    ],
)  # fmt: skip
def test_it_moves_as_in_mujoco(text: str, twin: str, tmp_path: Path):
    path = other = tmp_path / "arm.xml"
    path.write_text(text)
    if twin:
        other = tmp_path / "twin.xml"
        coupled = '<joint joint1="jb" joint2="jc" polycoef="0.05 1.5"/>'
        connect = '<connect body1="c" body2="a" anchor="0.1 0 0"/>'
        other.write_text(arm(after=f"<equality>{coupled if twin == 'coupled' else connect}</equality>"))
    for seed in range(3):
        found, reference, opens = by_mujoco(other, *moving(path, seed))
        assert opens < 1e-11
        assert np.abs(reference).max() > 1
        np.testing.assert_allclose(found, reference, atol=1e-9 * np.abs(reference).max(), rtol=0)


SITES = (
    '<site name="base" pos="0.1 -0.1 0.3" zaxis="1 0.5 0.2"/><body name="f" pos="0.5 0.5 0.5" euler="0.1 0.2 0.3">'
    '<freejoint/><geom type="box" size="0.1 0.05 0.02" pos="0.01 0.02 0.03"/><site name="fly" pos="0.1 0 0.05" '
    'euler="0.3 0 0.2"/></body>'
)


@MUJOCO
@pytest.mark.parametrize(
    "actuators",
    [
        '<motor cranksite="tip" slidersite="base" cranklength="1.5" gear="3"/>',
        '<position cranksite="tip" slidersite="low" cranklength="1.5" gear="-2" kp="7" kv="0.3" forcerange="-3 2"/>',
        '<velocity cranksite="fly" slidersite="tip" cranklength="3" gear="2" kv="0.7"/>'
        '<intvelocity cranksite="low" slidersite="fly" cranklength="3" kp="5" kv="0.7" actrange="-9 9"/>',
        '<position cranksite="tip" slidersite="base" cranklength="0.05" gear="3" kp="7" kv="0.3"/>',  # does not reach
        '<motor site="tip" gear="1 2 3 4 5 6"/><motor site="tip" refsite="low" gear="-3 2 1 4 5 6"/>',
        '<motor site="fly" refsite="base" gear="1 2 3 4 5 6"/><position site="tip" refsite="fly" gear="3 2" kp="3"/>',
        '<general site="tip" gear="1 2 3" biastype="affine" biasprm="0.3 2 -0.7"/>'
        '<position site="tip" refsite="low" gear="1 2 3" kp="3" kv="0.4"/>',
        '<damper joint="ja" kv="2" ctrlrange="0 5" gear="2"/>'
        '<damper site="tip" refsite="low" gear="1 2 3" kv="0.4" ctrlrange="0 5"/>',
        '<general joint="jb" gaintype="affine" gainprm="3 -2 0.5" biastype="affine" biasprm="0.1 2 -0.3" gear="2"/>'
        '<cylinder joint="jc" timeconst="0.1" area="2" bias="0.1 -3 -0.4"/>',
    ],
)
def test_actuators_between_sites_act_as_in_mujoco(actuators: str, tmp_path: Path):
    """Rods to sliders, of the world, of bodies above and of others; forces of sites; gains by lengths and rates."""
    path = tmp_path / "arm.xml"
    text = arm(after=f"<actuator>{actuators}</actuator>").replace("<worldbody>", f"<worldbody>{SITES}")
    text = text.replace('<body name="b"', '<site name="low" pos="0.05 0.01 0.02" zaxis="0.3 1 2"/><body name="b"')
    path.write_text(text.replace("</body></body></body>", '<site name="tip" pos="0.03 0 0.01"/></body></body></body>'))
    for seed in range(10):
        found, reference, _ = by_mujoco(path, *moving(path, seed))
        np.testing.assert_allclose(found, reference, atol=1e-10 * np.abs(reference).max(), rtol=0)


def test_a_rod_that_does_not_reach_its_slider_is_told(tmp_path: Path):
    path = tmp_path / "arm.xml"
    rod = '<actuator><motor name="u" cranksite="s" slidersite="o" cranklength="{}"/></actuator>'
    sites = '<site name="o"/><body name="a"><site name="s" pos="0.3 0 0"/>'
    for length, told in (("0.29", True), ("0.31", False)):
        path.write_text(arm(after=rod.format(length)).replace('<body name="a">', sites))
        assert ("rod does not reach" in str(alfmu.imported(path).warnings)) == told


def test_states_of_actuators_begin_and_end_as_the_file_has_it(tmp_path: Path):
    """An integral of the input within its limits, from the act of a keyframe."""
    path = tmp_path / "arm.xml"
    given = '<intvelocity name="u" joint="ja" kp="9" actrange="-0.2 0.35"/>'
    path.write_text(arm(after=f'<actuator>{given}</actuator><keyframe><key name="k" act="0.1"/></keyframe>'))
    m = alfmu.imported(path, key="k").mechanism
    run = alfmu.simulate(m, 0.4, 0.1, inputs={"u": 1.0})
    np.testing.assert_allclose(run["u_state"], np.minimum(0.1 + run.time, 0.35), atol=1e-8)
    run = alfmu.simulate(m, 0.4, 0.1, inputs={"u": -1.0})
    np.testing.assert_allclose(run["u_state"], np.maximum(0.1 - run.time, -0.2), atol=1e-8)


@pytest.mark.slow
def test_limits_are_stops_of_a_stiffness_that_suits(tmp_path: Path):
    """An arm falls on its limit and comes to rest there, some hundredths beyond at most whatever its mass."""
    for density in (10, 1000, 100000):
        text = arm(b=' range="-0.6 0.9"', after="<keyframe/>").replace("size=", f'density="{density}" size=')
        path = tmp_path / "arm.xml"
        path.write_text(text)
        run = alfmu.simulate(alfmu.imported(path).mechanism, 1.0, 0.01, outputs=["jb.angle"])
        outside = np.maximum(run["jb.angle"] - 0.9, -0.6 - run["jb.angle"]).max()
        assert 1e-3 < outside < 0.1
        unlimited = alfmu.imported(path, limits="ignore").mechanism
        free = alfmu.simulate(unlimited, 1.0, 0.01, outputs=["jb.angle"])
        assert np.maximum(free["jb.angle"] - 0.9, -0.6 - free["jb.angle"]).max() > 0.3


def test_a_limit_beyond_which_the_start_is_pushes_nothing(tmp_path: Path):
    path = tmp_path / "arm.xml"
    path.write_text(arm(b=' range="0.6 0.9"'))
    found = alfmu.imported(path)
    assert found.warnings == ("limits that the start exceeds; --option limits=inside starts within them (line 3, jb)",)
    assert not found.mechanism.end_stops


@pytest.mark.slow
def test_a_folded_leg_starts_within_its_limits_on_request(tmp_path: Path):
    """A slider-crank of equal arms, whose slider stays at zero from there; within the limits, s = 2 l cos(angle)."""
    path = tmp_path / "leg.xml"
    geom = '<geom type="capsule" size="0.02" fromto="0 0 0 0 0 {}"/>'
    path.write_text(
        '<mujoco><compiler angle="radian"/><option><flag contact="disable"/></option><worldbody>'
        f'<body name="a"><joint name="hip" axis="0 1 0" range="0.2 1.3"/>{geom.format(-0.4)}'
        f'<body name="b" pos="0 0 -0.4"><joint name="knee" axis="0 1 0" range="0.4 2.6"/>{geom.format(0.4)}'
        '</body></body><body name="c"><joint name="foot" type="slide" axis="0 0 -1" range="0.1 0.7"/>'
        '<geom size="0.03"/></body></worldbody><equality><connect body1="b" body2="c" anchor="0 0 0.4"/></equality>'
        "</mujoco>"
    )
    found = alfmu.imported(path)
    assert "limits that the start exceeds" in found.warnings[0]
    held = alfmu.simulate(found.mechanism, 0.1, 0.1, outputs=["c.position"])
    assert held["c.position"][-1] == pytest.approx(0, abs=1e-9)
    inside = alfmu.imported(path, limits="inside")
    assert not inside.warnings
    run = alfmu.simulate(inside.mechanism, 0.5, 0.01, outputs=["*.angle", "*.position"])
    hip, knee, foot = (run[name] for name in ("hip.angle", "knee.angle", "c.position"))
    np.testing.assert_allclose(foot, 0.4 * (np.cos(hip) - np.cos(hip + knee)), atol=1e-9)
    for start, low, high in ((hip[0], 0.2, 1.3), (knee[0], 0.4, 2.6), (foot[0], 0.1, 0.7)):
        assert low - 1e-9 <= start <= high + 1e-9


def test_a_plane_loop_whose_points_lie_beside_its_plane_moves_if_gaps_are_left(tmp_path: Path):
    """A parallelogram, which is a pendulum; no position closes its gap of 2 mm along the hinges."""
    path = tmp_path / "swing.xml"
    body = '<inertial pos="0 0 {}" mass="{}" diaginertia="0.1 0.1 0.1"/>'
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="j" axis="0 1 0"/>'
        + body.format(-0.5, 2)
        + '<body name="c" pos="0 0 -1"><joint name="k" axis="0 1 0"/><site name="s" pos="0.7 0.002 0"/>'
        + body.format(0, 3)
        + '</body></body><body name="b" pos="0.7 0 0"><joint name="l" axis="0 1 0"/><site name="t" pos="0 0 -1"/>'
        + body.format(-0.5, 2)
        + '</body></worldbody><equality><connect name="p" site1="s" site2="t"/></equality></mujoco>'
    )
    assert "leaves 0.002 m or rad; --option leave=gaps" in alfmu.imported(path).moved
    found = alfmu.imported(path, leave="gaps")
    assert "these directions are left out: y of p" in found.moved
    run = alfmu.simulate(found.mechanism, 0.01, 0.01, parameters={"start.j_angle": 0.5})
    inertia = 2 * (0.1 + 2 * 0.5**2) + 3 * 1.0**2
    expected = -9.81 * np.sin(0.5) * (2 * 2 * 0.5 + 3 * 1.0) / inertia
    np.testing.assert_allclose(run["j.angular_acceleration"][0], expected, rtol=1e-11)


def test_a_tendon_without_a_motor_is_a_spring(tmp_path: Path):
    """Its text is Python, and actuators of its joints carry it; a motor would be left out."""
    numbers = []
    for given in ("", ' stiffness="40" damping="2" springlength="-0.5 0.3"'):
        path, text = tmp_path / "arm.xml", tmp_path / "arm.py"
        path.write_text(arm(after=TENDON.format(given)))
        found = alfmu.imported(path)
        text.write_text(found.source())
        k = alfmu.kinematics(found.mechanism, ["ja", "jb", "jc"])
        numbers.append([k.efforts(k.start, {"jb": 0.7}), k.efforts(k.forward({"jb": 0.1, "jc": 0.1}))])
        with pytest.raises(alfmu.InputError, match="no joint is actuated"):
            alfmu.kinematics(str(text))
    # Its length is 2 jb - 3 jc: 0.8 at the start, and -0.1, where it is slack.
    pulled = [[moved[x] - plain[x] for x in plain] for plain, moved in zip(*numbers, strict=True)]
    pull = 40 * (0.8 - 0.3) + 2 * 2 * 0.7
    np.testing.assert_allclose(pulled, [[0, 2 * pull, -3 * pull], [0, 0, 0]], atol=1e-12)


def test_friction_and_lags_of_files(tmp_path: Path):
    path = tmp_path / "arm.xml"
    path.write_text(arm(b=' frictionloss="50"', after='<actuator><position name="u" joint="ja" kp="9" timeconst="0.2"/>'
                                                      "</actuator>"))  # fmt: skip
    run = alfmu.simulate(alfmu.imported(path).mechanism, 0.4, 0.1, inputs={"u": 1.0})
    np.testing.assert_array_equal(run["jb.angle"], 0.4)  # friction holds it
    np.testing.assert_allclose(run["u_state"], 1 - np.exp(-run.time / 0.2), atol=1e-8)


def test_tendons_and_motors_of_ball_joints_are_left_out(tmp_path: Path):
    path = tmp_path / "arm.xml"
    ball = arm(after=TENDON.format(' stiffness="2"') + '<actuator><motor joint="jb"/><motor tendon="t"/></actuator>')
    path.write_text(ball.replace('name="jb" axis="0 1 0" ref="0.4"', 'name="jb" type="ball"'))
    with pytest.raises(alfmu.InputError, match="leave=tendons leaves it out") as told:
        alfmu.imported(path)
    assert "leave=actuators leaves it out" in str(told.value)
    found = alfmu.imported(path, leave="actuators,tendons")
    assert len(found.mechanism.coordinates) == 6
    assert not found.mechanism.inputs


@pytest.mark.parametrize("kind", ['gaintype="user"', 'biastype="muscle"', 'dyntype="user"'])
def test_actuators_by_programs_are_left_out(kind: str, tmp_path: Path):
    path = tmp_path / "arm.xml"
    path.write_text(arm(after=f'<actuator><general joint="jb" {kind}/><motor name="u" joint="ja"/></actuator>'))
    with pytest.raises(alfmu.InputError, match=r"does not map; .*leave=actuators leaves it out"):
        alfmu.imported(path)
    assert [each.name for each in alfmu.imported(path, leave="actuators").mechanism.inputs] == ["u"]


def test_screws_of_old_files_have_the_lead_of_new_ones(tmp_path: Path):
    path = tmp_path / "m.sdf"
    screw = "<joint name='l' type='screw'><parent>world</parent><child>l</child><axis><xyz>0 0 1</xyz></axis>{}</joint>"
    texts = []
    for pitch in (
        "<screw_thread_pitch>0.002</screw_thread_pitch>",
        f"<thread_pitch>{-2 * np.pi / 0.002}</thread_pitch>",
    ):
        path.write_text(sdf(LINK.format("l", "") + screw.format(pitch)))
        found = alfmu.imported(path)
        texts.append(found.source())
    assert texts[0] == texts[1]
    assert "lead=0.002" in texts[0]
    assert "joints with the name of a link have _joint added (line 1, l_joint)" in found.notes
    path.write_text(sdf(LINK.format("l", "") + screw.format("")))
    assert "lead=1" in alfmu.imported(path).source()  # as libsdformat has it


LINK = "<link name='{}'>{}<inertial><mass>2</mass></inertial></link>"
HINGE = "<joint name='{0}' type='revolute'><parent>{1}</parent><child>{2}</child><axis><xyz>0 1 0</xyz></axis></joint>"
INNER = (
    "<model name='inner'><pose>0.1 0 0.2 0 0.3 0</pose>" + LINK.format("l", "<pose>0 0 -0.1 0 0 0</pose>")
    + LINK.format("k", "<pose relative_to='l'>0 0 -0.3 0 0 0</pose>") + HINGE.format("j", "l", "k") + "</model>"
)  # fmt: skip


def sdf(inside: str) -> str:
    return f"<sdf version='1.9'><model name='m'>{inside}</model></sdf>"


def test_models_in_models_and_included_ones_are_one(tmp_path: Path):
    outer = LINK.format("base", "") + HINGE.format("h", "world", "base") + HINGE.format("i", "base", "inner::l")
    path = tmp_path / "m.sdf"
    path.write_text(sdf(outer + INNER))
    nested = alfmu.imported(path)
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "model.sdf").write_text(f"<sdf version='1.9'>{INNER.replace('inner', 'part')}</sdf>")
    path.write_text(sdf(outer + "<include><uri>model://part</uri><name>inner</name></include>"))
    assert alfmu.imported(path).source() == nested.source()
    flat = (
        INNER.replace("<model name='inner'><pose>0.1 0 0.2 0 0.3 0</pose>", "")
        .replace("</model>", "")
        .replace("<pose>0 0 -0.1 0 0 0</pose>", "<pose relative_to='f'>0 0 -0.1 0 0 0</pose>")
    )
    path.write_text(
        sdf(outer.replace("inner::l", "l") + "<frame name='f'><pose>0.1 0 0.2 0 0.3 0</pose></frame>" + flat)
    )
    runs = [
        alfmu.simulate(found.mechanism, 0.3, 0.1, parameters={"start.h_angle": 0.5})
        for found in (nested, alfmu.imported(path))
    ]
    assert np.ptp(runs[0]["h.angle"]) > 0.01
    np.testing.assert_allclose(runs[0]["inner_j.angle"], runs[1]["j.angle"], atol=1e-9)


def test_two_revolute_joints_in_series_are_a_universal_one(tmp_path: Path):
    path = tmp_path / "m.sdf"
    axes = "<axis><xyz>1 0 0</xyz></axis><axis2><xyz>0 1 1</xyz></axis2></joint>"
    joint = "<joint name='j' type='{}'><parent>world</parent><child>k</child>" + axes
    texts = []
    for kind in ("universal", "revolute2"):
        path.write_text(sdf(LINK.format("k", "") + joint.format(kind)))
        texts.append(alfmu.imported(path).source())
    assert texts[0] == texts[1]
    path.write_text(sdf(LINK.format("k", "") + joint.format("revolute2").replace("1 0 0", "1 1 0")))
    with pytest.raises(alfmu.InputError, match="its two axes are not perpendicular"):
        alfmu.imported(path)


def test_models_of_a_world_move_together(tmp_path: Path):
    model = "<model name='{}'><pose>{} 0 0 0 0 0</pose>" + LINK.format("l", "") + "{}</model>"
    world = "<sdf version='1.9'><world name='w'>{}</world></sdf>".format(
        model.format("a", 1, HINGE.format("j", "world", "l")) + model.format("b", 2, "")
        + model.format("floor", 0, "<static>1</static>")
    )  # fmt: skip
    path = tmp_path / "w.sdf"
    path.write_text(world)
    found = alfmu.imported(path)
    assert [c.name for c in found.mechanism.coordinates][:3] == ["a_j_angle", "b_l_x", "b_l_y"]
    assert "other models (line 1, floor)" in found.left_out
    assert len(alfmu.imported(path, model="a").mechanism.coordinates) == 1
    path.write_text(world.replace("name='b'", "name='a'"))
    found = alfmu.imported(path)
    assert [c.name for c in found.mechanism.coordinates][:3] == ["a_j_angle", "a_2_l_x", "a_2_l_y"]
    assert "models with a name that another has, or none, have a number added (line 1, a_2)" in found.notes


GEARS = """<sdf version='1.9'><model name='m'>{}<joint name='g' type='gearbox'><parent>a</parent><child>b</child>
<gearbox_ratio>3</gearbox_ratio><gearbox_reference_body>f</gearbox_reference_body><axis><xyz>0 1 0</xyz></axis>
<axis2><xyz>0 {} 0</xyz></axis2></joint></model></sdf>"""


def test_a_gearbox_of_sdf_makes_its_child_turn_by_its_parent(tmp_path: Path):
    """A pendulum that turns a wheel on the same frame, against its closed form; and a frame that a link carries."""
    inertia = "<inertia><ixx>0.1</ixx><iyy>{}</iyy><izz>0.1</izz></inertia>"
    link = "<link name='{}'><inertial><pose>0 0 {} 0 0 0</pose><mass>2</mass>" + inertia + "</inertial></link>"
    hinge = "<joint name='{0}' type='{3}'><parent>{1}</parent><child>{2}</child><axis><xyz>0 1 0</xyz></axis></joint>"
    text = link.format("f", 0, 0.1) + link.format("a", -0.3, 0.12) + link.format("b", 0, 0.05)
    path = tmp_path / "gears.sdf"
    hinges = hinge.format("h", "world", "f", "fixed") + hinge.format("j", "f", "a", "revolute")
    path.write_text(GEARS.format(text + hinges + hinge.format("k", "f", "b", "revolute"), -1))
    run = alfmu.simulate(str(path), 0.3, 0.1, parameters={"start.j_angle": 0.5})
    np.testing.assert_allclose(run["k.angle"], 3 * run["j.angle"], atol=1e-12)
    expected = -2 * 9.8 * 0.3 * np.sin(0.5) / (0.12 + 2 * 0.3**2 + 3**2 * 0.05)
    np.testing.assert_allclose(run["j.angular_acceleration"][0], expected, rtol=1e-12)
    hinges = hinge.format("h", "world", "a", "revolute") + hinge.format("j", "a", "f", "revolute")
    path.write_text(GEARS.format(text + hinges + hinge.format("k", "f", "b", "revolute"), 1))
    run = alfmu.simulate(str(path), 0.3, 0.1, parameters={"start.j_angle": 0.5})
    np.testing.assert_allclose(run["k.angle"], 3 * run["j.angle"], atol=1e-12)
    path.write_text(path.read_text().replace("<axis2><xyz>0", "<axis2><xyz>1"))
    with pytest.raises(alfmu.InputError, match="its <axis2> is not along the hinge k, on which b turns"):
        alfmu.imported(path)
    path.write_text(GEARS.format(text + hinges + hinge.format("k", "world", "b", "revolute"), 1))
    with pytest.raises(alfmu.InputError, match="between links that turn on its reference body by hinges; b does not"):
        alfmu.imported(path)


def test_shapes_give_inertia_in_sdf(tmp_path: Path):
    shape = (
        "<collision name='c'><density>800</density><geometry><box><size>0.2 0.4 0.6</size></box></geometry></collision>"
    )
    path = tmp_path / "m.sdf"
    path.write_text(sdf(f"<link name='l'><inertial auto='true'/>{shape}</link>" + HINGE.format("h", "world", "l")))
    (body,) = alfmu.imported(path).mechanism.spatial_bodies
    mass = 800 * 0.2 * 0.4 * 0.6
    assert body.mass == pytest.approx(mass, rel=1e-14)
    np.testing.assert_allclose(body.inertia, mass / 12 * np.array([0.52, 0.4, 0.2]), rtol=1e-13)
    posed = shape.replace("<density>", "<pose relative_to='f' degrees='true'>0.3 0 0 0 90 0</pose><density>")
    frame = "<frame name='f'><pose degrees='true'>1 2 3 0 0 90</pose></frame>"
    link = f"<link name='l'><pose>0 0 1 0 0 0</pose><inertial auto='true'/>{posed}</link>"
    path.write_text(sdf(frame + link + HINGE.format("h", "world", "l")))
    (body,) = alfmu.imported(path).mechanism.spatial_bodies
    np.testing.assert_allclose(body.center, [1, 2.3, 2], rtol=1e-13)
    np.testing.assert_allclose(body.inertia, mass / 12 * np.array([0.4, 0.2, 0.52]), rtol=1e-13)


def test_shapes_without_an_inertia_matter_only_where_they_move(tmp_path: Path):
    path = tmp_path / "m.sdf"
    mesh = "<collision name='c'><geometry><mesh><uri>a.stl</uri></mesh></geometry></collision>"
    base = f"<link name='base'><inertial auto='true'/>{mesh}</link>"
    held = "<joint name='held' type='fixed'><parent>world</parent><child>base</child></joint>"
    path.write_text(sdf(base + held + LINK.format("l", "") + HINGE.format("h", "base", "l")))
    found = alfmu.imported(path)
    assert any("these shapes of fixed bodies have no mass here" in note for note in found.notes)
    assert len(found.mechanism.coordinates) == 1
    path.write_text(sdf(base + HINGE.format("h", "world", "base")))
    with pytest.raises(alfmu.InputError, match="this shape gives no inertia here"):
        alfmu.imported(path)


BAR = "<inertial><origin xyz='0.1 0 0'/><mass value='1'/><inertia ixx='1e-3' iyy='1e-2' izz='1e-2'/></inertial>"
URDF = "<robot name='r'><link name='base'/>{}{}</robot>"


def chain(ends: str) -> str:
    """Three bars of 0.2 m in a row, the last of which comes back to the ground; `ends` are links at both ends."""
    links = "".join(f"<link name='l{i}'>{BAR}</link>" for i in range(3))
    joints = "".join(
        f"<joint name='j{i}' type='revolute'><parent link='{'base' if i == 0 else f'l{i - 1}'}'/><child link='l{i}'/>"
        f"<origin xyz='{0.0 if i == 0 else 0.2} 0 0' rpy='0 {turn} 0'/><axis xyz='0 1 0'/>"
        "<limit effort='1' velocity='0'/><joint_properties friction='0.0' damping='0.1'/></joint>"
        for i, turn in enumerate((-1.3, 1.2, 1.5))
    )
    return URDF.format(links + joints, ends)


@pytest.mark.parametrize(("kind", "other"), [("3D", "spherical"), ("6d", "fixed")])
def test_loops_stand_in_a_file_beside_a_urdf(kind: str, other: str, tmp_path: Path):
    ends = "".join(
        f"<link name='{name}'/><joint name='f{name}' type='fixed'><parent link='{on}'/><child link='{name}'/>"
        f"<origin xyz='{at}'/></joint>"
        for name, on, at in (("A", "l2", "0.2 0 0"), ("B", "base", "0.2 0 0.01"))
    )
    path = tmp_path / "r.urdf"
    path.write_text(chain(ends))
    assert len(alfmu.imported(path).mechanism.coordinates) == len(alfmu.imported(path).mechanism.starts) == 3
    (tmp_path / "r.yaml").write_text(
        f"# loops\nclosed_loop:\n  [\n    ['A', \"B\"],  # one\n  ]\ntype: ['{kind}']\nname_mot: [j0]\nother: {{}}\n"
    )
    found = alfmu.imported(path)
    assert [x.name for x in found.mechanism.inputs] == ["j0_drive"]
    assert found.notes[0].startswith("loops, motors and freedoms of joints are those of r.yaml")
    (tmp_path / "s.urdf").write_text(chain(ends + f"<loop_joint name='A_closed' type='{other}'><link1 link='A'/>"
                                                        "<link2 link='B'/></loop_joint>"))  # fmt: skip
    own = alfmu.imported(tmp_path / "s.urdf", drives="j0")
    texts = [x.source("f").partition("def f")[2].replace("r.urdf", "s.urdf") for x in (found, own)]
    assert texts[0].replace("# robot", "# loop_joint") == texts[1]
    again = alfmu.imported(tmp_path / "s.urdf", loops="r.yaml")
    assert len(again.mechanism.closures) == 2 * len(own.mechanism.closures)


def test_a_file_of_loops_changes_freedoms(tmp_path: Path):
    path = tmp_path / "r.urdf"
    path.write_text(chain(""))
    (tmp_path / "r.yaml").write_text(
        "closed_loop: []\ntype: []\njoint_name: [j0, j1, j2]\njoint_type:\n  - SPHERICAL\n  - UJOINT_ZY\n  - FIXED\n"
    )
    assert [c.name for c in alfmu.imported(path).mechanism.coordinates] == [
        "j0_e0", "j0_e1", "j0_e2", "j0_e3", "j1_Z_angle", "j1_Y_angle"
    ]  # fmt: skip
    for text, said in (
        ("closed_loop: [[a, b]]\ntype: [4d]", "give 3d or 6d"),
        ("closed_loop: [[a]]\ntype: [3d]", "no pair of links"),
        ("closed_loop: [[a, b]\ntype: [3d]", "instead of a name or a list"),
        ("closed_loop: [[a, b]]]\ntype: [3d]", "brackets that do not match"),
        ("closed_loop: [[a, b]]\ntype: [3d]", "there is no link or joint 'a'"),
    ):
        (tmp_path / "r.yaml").write_text(text)
        with pytest.raises(alfmu.InputError, match=said):
            alfmu.imported(path)


def test_all_reasons_come_at_once_the_most_frequent_first(tmp_path: Path):
    path = tmp_path / "arm.xml"
    wrong = '<actuator><muscle name="{0}" joint="ja"/><muscle name="{0}2" joint="jb"/></actuator>'
    path.write_text(arm(a=' pos="0 0"', b=' springdamper="1 0"', after=wrong.format("m")).replace('pos="0 0"', ""))
    with pytest.raises(alfmu.InputError) as error:
        alfmu.imported(path)
    lines = str(error.value).split("\n")
    assert lines[0].endswith("arm.xml is refused for 2 reasons:")
    assert "actuator of kind <muscle>" in lines[1]
    assert lines[1].endswith("--option leave=actuators leaves it out (and 1 more like it)")
    assert "springdamper" in lines[2]
    path.write_text(arm(after=wrong.format("m")))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert len(alfmu.load(str(path), leave="actuators").coordinates) == 3
    assert "actuators, left out by option" in str(told[0].message)
    with pytest.raises(alfmu.InputError, match="option leave is 'tyres'; alfmu can leave out actuators"):
        alfmu.imported(path, leave="tyres")


def test_inertias_that_no_body_has_come_at_once_and_give_way_to_their_mean(tmp_path: Path):
    """A pendulum whose acceleration is a closed form; its fixed joint follows nothing and takes no effort."""
    link = "<link name='{}'><inertial><origin xyz='0 0 -0.3'/><mass value='2'/><inertia ixx='{}' iyy='0.02' izz='0.07' "
    link += "/></inertial></link>"
    text = "<robot name='r'><link name='w'/>" + link.format("b", "0.03") + link.format("c", "0.04")
    text += "<joint name='j' type='continuous'><parent link='w'/><child link='b'/><axis xyz='0 1 0'/></joint>"
    text += "<joint name='k' type='fixed'><parent link='b'/><child link='c'/><mimic joint='j'/></joint>"
    text += "<transmission name='t'><joint name='k'/></transmission></robot>"
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(alfmu.InputError, match=r"moments of inertia are \[0.02, 0.03, 0.07\] .* \(and 1 more"):
        alfmu.imported(path)
    found = alfmu.imported(path, inertia="mean")
    assert "replaced by their mean (2 from line 1, b, c)" in found.notes[0]
    assert not found.mechanism.inputs
    run = alfmu.simulate(found.mechanism, 0.01, 0.01, parameters={"start.j_angle": 0.5})
    inertia = 0.12 / 3 + 0.13 / 3 + 4 * 0.3**2
    expected = -4 * 9.81 * 0.3 * np.sin(0.5) / inertia
    np.testing.assert_allclose(run["j.angular_acceleration"][0], expected, rtol=1e-12)
    path.write_text(text.replace("'0.03'", "'-0.03'"))
    with pytest.raises(alfmu.InputError, match=r"\[-0.03, 0.02, 0.07\] kg.m2; no body has a negative one"):
        alfmu.imported(path, inertia="mean")


UNKNOWN = {
    "xml": "<mujoco><default><joint wobble='1'/></default><worldbody><body name='b'><joint name='j' hum='2'/>"
    "<geom size='0.1'/></body></worldbody><sway/></mujoco>",
    "urdf": "<robot name='r'><link name='w'/><link name='b'><inertial><mass value='1'/><inertia ixx='1' iyy='1' "
    "izz='1'/></inertial></link><joint name='j' type='continuous'><parent link='w'/><child link='b'/><dynamics hum='2' "
    "damping='1'/><sway/><axis xyz='0 1 0' wobble='1'/></joint></robot>",
    "sdf": "<sdf version='1.9'><model name='m'><link name='b'><sway/></link><joint name='j' type='revolute' "
    "wobble='1'><parent>world</parent><child>b</child><axis><xyz>0 1 0</xyz><hum>2</hum></axis></joint></model></sdf>",
}


@pytest.mark.parametrize("kind", UNKNOWN)
def test_what_is_not_known_is_told_at_once_and_can_be_left_out(kind: str, tmp_path: Path):
    """Attributes, inherited ones and elements; only the first of an element was told, and none could be left."""
    path = tmp_path / f"arm.{kind}"
    path.write_text(UNKNOWN[kind])
    with pytest.raises(alfmu.InputError, match="refused for 3 reasons") as told:
        alfmu.imported(path)
    assert all(each in str(told.value) for each in ("wobble", "hum", "sway"))
    assert str(told.value).count("--option leave=unknown leaves it out") == 3
    found = alfmu.imported(path, leave="unknown")
    assert "unknown elements and attributes, left out by option" in found.warnings[0]
    assert [c.name for c in found.mechanism.coordinates] == ["j_angle"]


@pytest.mark.parametrize("ends", ["0.2 0.2", "0.3 0.2"])
def test_equal_or_reversed_ranges_limit_nothing_unless_they_must(ends: str, tmp_path: Path):
    """MuJoCo does the same: `limited="auto"` is true only where the first end is below the second."""
    path = tmp_path / "r.xml"
    text = "<mujoco><worldbody><body><joint name='j' range='{0}'{1}/><geom size='1'/></body></worldbody><actuator>"
    text += "<motor joint='j' ctrlrange='{0}'/></actuator></mujoco>"
    path.write_text(text.format(ends, ""))
    found = alfmu.imported(path)
    assert not found.mechanism.end_stops
    assert [each.split(" (")[0] for each in found.warnings] == [
        "ranges whose ends are equal or reversed, which are no limits in MuJoCo"
    ]
    path.write_text(text.format(ends, " limited='true'"))
    with pytest.raises(alfmu.InputError, match="give a first number below the second"):
        alfmu.imported(path)


def test_a_ball_joint_whose_range_is_a_point_is_read_with_a_warning(tmp_path: Path):
    path = tmp_path / "arm.xml"
    path.write_text(
        "<mujoco><worldbody><body><joint name='j' type='ball' limited='true' range='0 0'/><geom size='1'/></body>"
        "</worldbody></mujoco>"
    )
    assert "limits of ball joints" in alfmu.imported(path).warnings[0]


def test_limits_that_hold_a_joint_are_told(tmp_path: Path):
    path = tmp_path / "arm.xml"
    for width in (0.02, 1e-5):
        path.write_text(arm(b=f' range="0 {width}"').replace('ref="0.4"', ""))
        told = [note for note in alfmu.imported(path).notes if "limits hold nearly still" in note]
        assert [note[-15:] for note in told] == ["re (line 3, jb)"] * (width < 0.01)


def test_includes_that_lead_in_a_circle_or_out_are_refused(tmp_path: Path):
    (tmp_path / "inner").mkdir()
    path = tmp_path / "inner" / "m.sdf"
    path.write_text(sdf(LINK.format("l", "") + "<include><uri>m.sdf</uri></include>"))
    with pytest.raises(alfmu.InputError, match="include each other in a circle"):
        alfmu.imported(path)
    for uri, said in (
        ("https://a.b/c", "is a network address"),
        ("../n.sdf", "is outside the folder"),
        ("o.sdf", "no file 'o.sdf'"),
    ):
        path.write_text(sdf(LINK.format("l", "") + f"<include><uri>{uri}</uri></include>"))
        with pytest.raises(alfmu.InputError, match=said):
            alfmu.imported(path)
    (tmp_path / "n.sdf").write_text(f"<sdf version='1.9'>{INNER}</sdf>")
    path.write_text(sdf(LINK.format("l", "") + "<include><uri>../n.sdf</uri></include>"))
    assert len(alfmu.imported(path, folders="..").mechanism.coordinates) == 15


def test_springs_and_friction_of_balls_are_left_out_on_request(tmp_path: Path):
    """As defaults of all joints in files of exporters: a damper alone slows a sphere."""
    path = tmp_path / "ball.xml"
    path.write_text(
        "<mujoco><option gravity='0 0 0'/><default><joint frictionloss='0.5' stiffness='2' damping='0.1'/></default>"
        "<worldbody><body name='b'><joint name='j' type='ball'/><inertial pos='0 0 0' mass='1' diaginertia='1 1 1'/>"
        "</body></worldbody></mujoco>"
    )
    with pytest.raises(alfmu.InputError, match=r"the spring of a ball joint .* leave=balls leaves it out"):
        alfmu.imported(path)
    found = alfmu.imported(path, leave="balls")
    assert found.warnings == ("balls, left out by option (2 from line 1, j, j)",)
    run = alfmu.simulate(found.mechanism, 1.0, 0.1, parameters={"start.j_e1_rate": 0.5})
    np.testing.assert_allclose(run["b.angular_velocity.x"], np.exp(-0.1 * run.time), atol=1e-7)


def test_replicas_name_what_is_wrong(tmp_path: Path):
    path = tmp_path / "arm.xml"
    for old, new, said in (
        ('count="3"', 'count="0"', "count is 0; give a number from 1 to"),
        ('count="3"', 'count="1000000"', r"count is 1e\+06"),
        ('count="2"', 'count="1.5"', r"count is 1\.5; give a number from 1 to"),
        ('sep="_"', 'sep="_" pos="1 0 0"', r'does not know the effect of pos="1 0 0" of <replicate>'),
        ('joint="jb0_2"', 'joint="jb"', "there is no joint 'jb'"),
    ):
        path.write_text(REPLICAS.replace(old, new))
        with pytest.raises(alfmu.InputError, match=said) as refused:
            alfmu.imported(path)
        assert "does not map" not in str(refused.value)  # as a second reason


def test_joints_of_drake_move_as_closed_forms_have_it(tmp_path: Path):
    """Bodies on the ground by a screw, a planar, a universal and a ball joint, each with a damper."""
    m, inertia, arm, d, p = 0.7, 0.02, 0.3, 0.4, 0.05 / (2 * np.pi)
    link = "<link name='{0}'><inertial><origin xyz='0 0 {1}'/><mass value='0.7'/><inertia {2}/></inertial></link>"
    moments = "ixx='0.02' iyy='0.02' izz='0.02'"
    joint = "<{0} name='{1}' type='{2}'><parent link='base'/><child link='{3}'/>{4}</{0}>"
    path = tmp_path / "r.urdf"
    path.write_text(
        "<robot name='r'><link name='base'/>"
        + "".join(link.format(name, -arm if name == "b" else 0, moments) for name in "abcd")
        + joint.format("drake:joint", "s", "screw", "a", "<axis xyz='0 0 1'/><dynamics damping='0.4'/>"
                       "<drake:screw_thread_pitch value='0.05'/>")
        + joint.format("drake:joint", "u", "universal", "b", "<dynamics damping='0.4'/>")
        + joint.format("joint", "p", "planar", "c", "<axis xyz='0 2 0'/><dynamics damping='0.3 0.3 0.4'/>")
        + joint.format("drake:joint", "o", "ball", "d", "<dynamics damping='0.4'/>")
        + "</robot>"
    )  # fmt: skip
    mechanism = alfmu.imported(path).mechanism
    given = {"start.u_angle1": 0.6, "start.p_angle_angle_rate": 2.0, "start.o_e1_rate": 1.0}
    asked, exact = ["?.z", "?.angular_velocity.*", "u.angle*"], {"solver.relative_tolerance": 1e-11}
    run = alfmu.simulate(mechanism, 0.5, 0.1, parameters=given | exact, outputs=asked)
    t = run.time
    carried = inertia + m * p**2
    screw = -m * 9.81 * p / d * (t - carried / d * (1 - np.exp(-d * t / carried)))
    np.testing.assert_allclose(run["a.z"], p * screw, atol=1e-10)
    fall = -m * 9.81 / 0.3 * (t - m / 0.3 * (1 - np.exp(-0.3 * t / m)))
    np.testing.assert_allclose(run["c.z"], fall, atol=1e-10)
    np.testing.assert_allclose(run["c.angular_velocity.y"], 2 * np.exp(-d * t / inertia), atol=1e-9)
    np.testing.assert_allclose(run["d.angular_velocity.x"], 2 * np.exp(-d * t / inertia), atol=1e-9)

    def pendulum(_: float, y: np.ndarray) -> list[float]:
        return [y[1], -(m * 9.81 * arm * np.sin(y[0]) + d * y[1]) / (inertia + m * arm**2)]

    swings = solve_ivp(pendulum, (0, 0.5), [0.6, 0.0], "DOP853", t, rtol=1e-12, atol=1e-12).y[0]
    np.testing.assert_allclose(run["u.angle1"], swings, atol=1e-9)
    np.testing.assert_allclose(run["u.angle2"], 0, atol=1e-12)
    turned = alfmu.simulate(mechanism, 0.5, 0.1, parameters=exact | {"start.u_angle2": 0.6}, outputs=asked)
    np.testing.assert_allclose(turned["u.angle2"], swings, atol=1e-9)
    text = path.read_text()
    for old, new, said in (
        ("<dynamics damping='0.3 0.3 0.4'/>", "<dynamics damping='0.3 0.2 0.4'/>", "damping differs along x and y"),
        ("<dynamics damping='0.3 0.3 0.4'/>", "<dynamics damping='0 0 -1'/>", "damping is -1; it must not be negative"),
        ("<dynamics damping='0.3 0.3 0.4'/>", "<dynamics/><dynamics damping='1 1 1'/>", "<dynamics> is given twice"),
        ("<drake:screw_thread_pitch value='0.05'/>", "", "it has no <drake:screw_thread_pitch>"),
        ("type='ball'", "type='revolute'", "a joint of type 'revolute' does not map"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(alfmu.InputError, match=said):
            alfmu.imported(path)
    path.write_text(text)
    with pytest.raises(alfmu.InputError, match="has no option 'folders'; URDF takes base, loops"):
        alfmu.imported(path, folders=".")


def test_messages_at_run_time_name_the_line_of_the_file(tmp_path: Path):
    path = tmp_path / "r.urdf"
    path.write_text(
        "<robot name='r'>\n<link name='base'/>\n<link name='l'/>\n<link name='k'/><joint name='j' type='continuous'>"
        "<parent link='base'/><child link='l'/><axis xyz='0 0 1'/></joint><joint name='f' type='fixed'>"
        "<parent link='l'/><child link='k'/><origin xyz='0.1 0 0'/></joint></robot>"
    )
    with pytest.raises(alfmu.AlfmuError, match=r"no mass and no constraint .* it moves k \(.*r\.urdf, line 4\)"):
        alfmu.simulate(alfmu.imported(path).mechanism, 0.1)


@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_limits_in_the_wrong_order_are_told(kind, tmp_path: Path):
    """They leave the joint no place, so that nothing stops it."""
    limit = {"urdf": "<limit lower='1' upper='-1'/>", "sdf": "<limit><lower>1</lower><upper>-1</upper></limit>"}[kind]
    path = tmp_path / f"r.{kind}"
    path.write_text({
        "urdf": f"<robot name='r'><link name='l0'>{BAR}</link><joint name='j' type='revolute'><parent link='world'/>"
        f"<child link='l0'/><axis xyz='0 1 0'/>{limit}</joint></robot>",
        "sdf": "<sdf version='1.9'><model name='r'><link name='l0'/><joint name='j' type='revolute'>"
        f"<parent>world</parent><child>l0</child><axis>{limit}</axis></joint></model></sdf>",
    }[kind])  # fmt: skip
    found = alfmu.imported(path)
    assert found.warnings == ("limits whose lower one is above the upper one (line 1, j)",)
    assert not found.mechanism.end_stops


@pytest.mark.parametrize("limits", [(-0.5, 0.3), (0.2, 0.2), (3.0, 4.0)])
@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_limits_of_a_joint_that_follows_another_stop_that_one(kind: str, limits: tuple[float, float], tmp_path: Path):
    """It turns by 0.1 - 2 a, within -1 and 1 for a."""
    path, ends = tmp_path / f"r.{kind}", []
    for low, high in ((-1, 1), limits):
        if kind == "urdf":
            follows = '<mimic joint="a" multiplier="-2" offset="0.1"/>' * bool(ends)
            ends.append(f'<limit lower="{low}" upper="{high}"/>{follows}<axis xyz="0 1 0"/></joint>')
        else:
            follows = "<mimic joint='a'><multiplier>-2</multiplier><offset>0.1</offset></mimic>" * bool(ends)
            limit = f"<limit><lower>{low}</lower><upper>{high}</upper></limit>"
            ends.append(f"<axis><xyz>0 1 0</xyz>{limit}{follows}</axis></joint>")
    text = "".join(
        f"<link name='{x}l'>{BAR}</link><joint name='{x}' type='revolute'>"
        f"<parent link='world'/><child link='{x}l'/>{end}"
        if kind == "urdf"
        else f'<link name="{x}l"/><joint name="{x}" type="revolute"><parent>world</parent><child>{x}l</child>{end}'
        for x, end in zip("ab", ends, strict=True)
    )
    text = f'<robot name="r">{text}</robot>' if kind == "urdf" else text
    path.write_text(text if kind == "urdf" else f'<sdf version="1.11"><model name="r">{text}</model></sdf>')
    found = alfmu.imported(path)
    ends = [(-0.1, 0.3)] if limits == (-0.5, 0.3) else [(-1.0, 1.0)]
    assert [(stop.lower, stop.upper) for stop in found.mechanism.end_stops] == [pytest.approx(x) for x in ends]
    words = {(0.2, 0.2): "limits that are equal", (3.0, 4.0): "limits that exclude those"}.get(limits, "")
    assert [each.startswith(words) for each in found.warnings] == [True] * bool(words)


def test_what_exporters_write_is_read_over(tmp_path: Path):
    path = tmp_path / "r.urdf"
    extras = (
        "<contact><friction/></contact>",
        " xmlns:xsi='http://www.w3.org/x' xsi:noNamespaceSchemaLocation='robot.xsd'",
    )
    path.write_text(
        f"<!-- by an exporter --with-- options -->\n<robot name='r'{extras[1]}><link name='l0'>{BAR}{extras[0]}</link>"
        "<joint name='j' type='revolute'><parent link='world'/><child link='l0'/><axis xyz='0 1 0' rpy='0 0 0'/>"
        "<limit lower='-INF' upper='inf'/></joint></robot>"
    )
    found = alfmu.imported(path)
    assert [c.name for c in found.mechanism.coordinates] == ["j_angle"]
    assert not found.mechanism.end_stops
    path.write_text(path.read_text().replace("</robot>", "<axis/></robot>"))
    with pytest.raises(alfmu.InputError, match=r"line 2: robot\[r\]/axis: <axis> does not map"):
        alfmu.imported(path)


def test_the_command_names_what_does_nothing_on_request(tmp_path: Path, capsys: pytest.CaptureFixture):
    path, other = tmp_path / "r.urdf", tmp_path / "loops.yaml"
    path.write_text(chain("<material name='blue'/>"))
    other.write_text("closed_loop: [[l2, base]]\ntype: [3d]\n")
    begin = ["import", str(path), "-o", str(tmp_path / "r.py")]
    assert main([*begin, "--loops", str(other), "--limits", "ignore"]) == 0
    said = capsys.readouterr().out
    assert "freedoms of joints are those of loops.yaml" in said
    assert "left out: " not in said
    assert main([*begin, "--all"]) == 0
    assert "left out: materials (line 1, blue)" in capsys.readouterr().out


SIDES = [(0, 3, 2), (0, 1, 3), (4, 7, 5), (4, 6, 7), (0, 5, 1), (0, 4, 5), (2, 7, 6), (2, 3, 7), (0, 6, 4), (0, 2, 6),
         (1, 7, 3), (1, 5, 7)]  # fmt: skip
"""Triangles of a box, with their outer sides out."""

CORNERS = np.array([(x, y, z) for x in (0.1, 0.3) for y in (-0.2, 0.2) for z in (0.0, 0.6)])


def box_as(kind: str, folder: Path) -> str:
    """Write a box of 0.2 x 0.4 x 0.6 m as a mesh; return the attributes that refer to it."""
    if kind == "points":
        return f'vertex="{" ".join(map(str, CORNERS.ravel()))}"'
    if kind == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in CORNERS * 1000] + [
            f"f {a + 1}/1/1 {b + 1} {c - 8}" for a, b, c in SIDES
        ]
        (folder / "box.obj").write_text("\n".join(lines))
    elif kind == "text.stl":
        facets = ("outer loop\n" + "".join(f"vertex {x} {y} {z}\n" for x, y, z in CORNERS[list(side)] * 1000)
                  for side in SIDES)  # fmt: skip
        (folder / "box.stl").write_text("solid\n" + "".join(facets))
    else:
        records = b"".join(
            bytes(12) + (CORNERS[list(side)] * 1000).astype("<f4").tobytes() + bytes(2) for side in SIDES
        )
        (folder / "box.stl").write_bytes(bytes(80) + len(SIDES).to_bytes(4, "little") + records)
    return f'file="box.{kind[-3:]}" scale="0.001 0.001 0.001"'


@pytest.mark.parametrize("how", ["legacy", "convex", "exact"])
@pytest.mark.parametrize("kind", ["points", "obj", "text.stl", "stl"])
def test_meshes_give_inertia(kind: str, how: str, tmp_path: Path):
    path = tmp_path / "m.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="box" inertia="{how}" {box_as(kind, tmp_path)}/></asset><worldbody><body><joint/>'
        '<geom type="mesh" mesh="box" density="800" pos="1 0 0" euler="0 0 90"/></body></worldbody></mujoco>'
    )
    (body,) = alfmu.imported(path).mechanism.spatial_bodies
    mass = 800 * 0.2 * 0.4 * 0.6
    assert body.mass == pytest.approx(mass, rel=1e-6)  # STL has seven digits
    np.testing.assert_allclose(body.center, (1.0, 0.2, 0.3), atol=1e-7)
    np.testing.assert_allclose(body.inertia, mass / 12 * np.array([0.4, 0.52, 0.2]), rtol=1e-6)
    for old, new, said in (
        ("box.stl", "box.stp", "no file 'box.stp'"),
        ("box.stl", "m.xml", "is no STL or OBJ file"),
        ("box.stl", "../box.stl", "outside the folder"),
    ):
        if kind == "stl":
            (tmp_path / "wrong.xml").write_text(path.read_text().replace(old, new))
            with pytest.raises(alfmu.InputError, match=f"its mesh gives no inertia .*{said}"):
                alfmu.imported(tmp_path / "wrong.xml")
    if kind == "stl":
        for content, said in (
            (b"solid\nvertex 1 2", "no STL file that alfmu"),
            (b"\xff" * 90, "no STL file"),
            (b"", "no tri"),
        ):
            (tmp_path / "box.stl").write_bytes(content)
            with pytest.raises(alfmu.InputError, match=said):
                alfmu.imported(path)


@MUJOCO
@pytest.mark.parametrize("how", ["legacy", "convex", "exact", "shell"])
def test_meshes_that_are_not_convex_have_the_inertia_of_mujoco(how: str, tmp_path: Path):
    import mujoco

    outline = np.array([(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (0, 2)]) * 0.1
    corners = np.array([(x, y, z) for z in (0.0, 0.1) for x, y in outline])
    ends = [(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 5, 4)]
    sides = [face for i in range(6) for j in [(i + 1) % 6] for face in ((i, j, 6 + j), (i, 6 + j, 6 + i))]
    faces = [*ends, *((6 + a, 6 + c, 6 + b) for a, b, c in ends), *sides]
    path = tmp_path / "m.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="l" inertia="{how}" refpos="0.1 0 0" scale="1 2 1" vertex="'
        + " ".join(map(str, corners.ravel())) + '" face="' + " ".join(map(str, np.ravel(faces)))
        + '"/></asset><worldbody><body name="b"><joint/><geom type="mesh" mesh="l" quat="1 0 0.3 0"/></body>'
        "</worldbody></mujoco>"
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_path(str(path))
    (body,) = alfmu.imported(path).mechanism.spatial_bodies
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    turn = turn.reshape(3, 3)
    assert body.mass == pytest.approx(model.body_mass[1], rel=1e-6)
    np.testing.assert_allclose(body.center, model.body_ipos[1], atol=1e-7)
    np.testing.assert_allclose(body.inertia, np.diag(turn @ np.diag(model.body_inertia[1]) @ turn.T), rtol=1e-6)


def test_a_mesh_as_a_shell_has_its_area_as_mass(tmp_path: Path):
    """A cube of 0.2 m: mass 1000 A, and 5/3 of the moment of the solid cube of this mass; of the geom or the mesh."""
    path = tmp_path / "m.xml"
    corners = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1))
    for mesh, geom in (("", 'shellinertia="true"'), ('inertia="shell"', "")):
        path.write_text(
            f'<mujoco><asset><mesh name="c" vertex="{corners}" {mesh}/></asset><worldbody><body><joint/>'
            f'<geom type="mesh" mesh="c" {geom}/></body></worldbody></mujoco>'
        )
        (body,) = alfmu.imported(path).mechanism.spatial_bodies
        assert body.mass == pytest.approx(1000 * 6 * 0.2**2)
        np.testing.assert_allclose(body.inertia, body.mass * 0.2**2 / 6 * 5 / 3, rtol=1e-12)


def test_shapes_of_bodies_that_stand_still_need_no_inertia(tmp_path: Path):
    """A base whose mesh is missing was refused, as if it moved."""
    path = tmp_path / "m.xml"
    text = (
        '<mujoco{}><asset><mesh name="a" file="none.stl"/></asset><worldbody><body name="base"><geom type="mesh" '
        'mesh="a"/><geom type="box" mesh="a"/><body name="arm">{}<inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>'
        "</body></body></worldbody></mujoco>"
    )
    path.write_text(text.format("", '<joint name="j"/>'))
    (note,) = alfmu.imported(path).notes
    assert "shapes of fixed bodies have no mass here" in note
    path.write_text(text.format("", '<joint name="j"/>').replace('name="base">', 'name="base"><joint/>'))
    with pytest.raises(alfmu.InputError, match=r"there is no file 'none\.stl'"):
        alfmu.imported(path)
    path.write_text(text.format("><compiler settotalmass='3'/", '<joint name="j"/>'))
    with pytest.raises(alfmu.InputError, match=r"there is no file 'none\.stl'"):
        alfmu.imported(path)


@pytest.mark.parametrize(
    ("soft", "part"),
    [('<flexcomp name="flag" type="grid"/>', "flag_0"), ('<composite prefix="p" type="cable"/>', "pB_last")],
)
def test_what_holds_a_flexible_body_is_left_out_with_it(soft: str, part: str, tmp_path: Path):
    path = tmp_path / "m.xml"
    text = f'<equality><connect body1="b3" body2="{part}" anchor="0 0 0"/></equality>'
    path.write_text(arm(after=text).replace("<worldbody>", f"<worldbody>{soft}").replace('"b3"', '"world"'))
    with pytest.raises(alfmu.InputError, match=f"{part}' is part of a flexible body; --option leave=flexible"):
        alfmu.imported(path)
    found = alfmu.imported(path, leave="flexible")
    assert "flexible, left out by option (2 from" in found.warnings[0]
    assert not found.mechanism.closures


def test_sites_of_a_flexible_body_are_refused_at_once_with_it(tmp_path: Path):
    path = tmp_path / "m.xml"
    text = '<actuator><motor site="pS_last"/><motor joint="pJ_first"/></actuator>'
    path.write_text(arm(after=text).replace("<worldbody>", '<worldbody><composite prefix="p" type="cable"/>'))
    with pytest.raises(alfmu.InputError, match="refused for 3 reasons") as refused:
        alfmu.imported(path)
    assert str(refused.value).count("is part of a flexible body; --option leave=flexible leaves it out") == 2
    assert not alfmu.imported(path, leave="flexible").mechanism.inputs


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("m.xml", '<mujoco><compiler angle="radian"/><worldbody><body><joint range="-90 {}"/><inertial pos="0 0 0" '
         'mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>'),
        ("m.urdf", '<robot name="m"><link name="w"/><link name="a"/><joint name="j" type="revolute"><parent link="w"/>'
         '<child link="a"/><limit lower="-90" upper="{}"/></joint></robot>'),
        ("m.urdf", '<robot name="m"><link name="w"/><link name="a"/><joint name="j" type="continuous">'
         '<parent link="w"/><child link="a"/><origin rpy="0 {} 0"/></joint></robot>'),
        ("m.sdf", '<sdf version="1.9"><model name="m"><link name="a"><pose>0 0 0 0 {} 0</pose></link><joint name="j" '
         'type="continuous"><parent>world</parent><child>a</child><axis/></joint></model></sdf>'),
    ],
)  # fmt: skip
def test_angles_that_may_be_degrees_are_remarked_upon(name: str, text: str, tmp_path: Path):
    path = tmp_path / name
    path.write_text(text.format(90))
    assert any("multiply degrees by 0.0174532925" in each for each in alfmu.imported(path).notes)
    path.write_text(text.format(1.5).replace("-90", "-1.5"))
    assert not any("degrees" in each for each in alfmu.imported(path).notes)


def test_too_many_bodies_and_too_large_numbers_are_refused(tmp_path: Path):
    path = tmp_path / "m.xml"
    path.write_text("<mujoco><worldbody>" + '<body><joint/><geom size="1"/></body>' * 5001 + "</worldbody></mujoco>")
    with pytest.raises(alfmu.InputError, match="it has 5001 bodies; alfmu takes 5000"):
        alfmu.imported(path, contacts="leave")
    path.write_text('<mujoco><worldbody><body><joint/><geom size="1e200"/></body></worldbody></mujoco>')
    with pytest.raises(alfmu.InputError, match=r"size has '1e200'; alfmu reads numbers up to 1e\+50"):
        alfmu.imported(path)


ATTACHED = """<mujoco><compiler angle="radian" eulerseq="zyx"/><option><flag contact="disable"/></option>
<default><joint damping="0.1"/><default class="heavy"><geom density="3000"/></default></default>
<worldbody><body name="base" pos="0 0 0.1" euler="0.1 0.2 0.3" childclass="heavy">
<geom type="box" size="0.1 0.05 0.05"/><joint name="j" axis="0 1 0"/>
<body name="tip" pos="0.3 0 0"><joint name="k" axis="0 1 0"/><geom size="0.05"/></body></body>
<body name="other" pos="0 1 0"><joint name="o"/><geom size="0.1"/></body></worldbody>
<equality><joint joint1="j" joint2="k" polycoef="0 2 0.3"/><joint joint1="o" joint2="k"/></equality>
<actuator><motor name="m" joint="k"/><motor name="n" joint="o"/></actuator>
<keyframe><key name="up" qpos="0.412 0.2 0.2"/></keyframe></mujoco>"""

AROUND = """<mujoco><option><flag contact="disable"/></option><default><joint damping="0.7"/></default>
<asset><model name="arm" file="arm.xml"/></asset><worldbody>
<body name="cart"><joint name="c" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/>
<frame pos="0 0 0.2" euler="0 0 90"><attach model="arm" body="base" prefix="l_"/></frame></body>
<frame pos="2 0 0"><attach model="arm" prefix="r_"/></frame></worldbody>
<actuator><motor name="p" joint="c"/></actuator></mujoco>"""
"""A part of a model in a turned frame, and the whole of it; degrees around it, radians and other defaults in it."""


REPLICATED = (
    AROUND.replace('<frame pos="2 0 0">', '<replicate count="2" offset="2 0 0" euler="0 0 20" sep="-">')
    .replace('prefix="r_"/></frame>', 'prefix="r_"/></replicate>')
    .replace(
        "</worldbody>",
        '</worldbody><tendon><fixed name="t" stiffness="3"><joint joint="r_j-0" coef="1"/>'
        '<joint joint="r_o-1" coef="2"/></fixed></tendon>',
    )
)
"""The same with two copies of the whole model, whose names are those of the model with a prefix and a number."""


@MUJOCO
@pytest.mark.parametrize("around", [AROUND, REPLICATED])
def test_attached_models_move_as_in_mujoco(around: str, tmp_path: Path):
    path = tmp_path / "scene.xml"
    path.write_text(around)
    (tmp_path / "arm.xml").write_text(ATTACHED)
    for seed in range(2):
        found, reference, opens = by_mujoco(path, *moving(path, seed))
        assert opens < 1e-11
        assert np.abs(reference).max() > 1
        np.testing.assert_allclose(found, reference, atol=1e-9 * np.abs(reference).max(), rtol=0)


PARTS, COUNT = '<body name="b"><joint name="j"/><geom size="1"/></body>', 2000


@pytest.mark.parametrize(
    ("around", "within"),
    [
        ('<attach model="arm" prefix="{long}"/>', ""),
        ('<replicate count="100"><attach model="arm" prefix="{long}"/></replicate>', ""),
        ('<replicate count="12" sep="{long}">' + PARTS + "</replicate>", "<equality>{rows}</equality>"),
        ('<replicate count="1" sep="{long}">' * 99 + PARTS + "</replicate>" * 99, ""),
    ],
)
def test_copies_of_all_kinds_take_bounded_memory(around: str, within: str, tmp_path: Path):
    path, rows = tmp_path / "scene.xml", '<connect body1="b" anchor="0 0 0"/>' * 20_000
    asset = '<asset><model name="arm" file="arm.xml"/></asset>'
    text = f"<mujoco>{asset}<worldbody>{around}</worldbody>{within}</mujoco>"
    path.write_text(text.format(long="p" * 20_000, rows=rows))
    bodies = "".join(PARTS.replace('"b"', f'"b{i}"').replace('"j"', f'"j{i}"') for i in range(COUNT))
    (tmp_path / "arm.xml").write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    tracemalloc.start()
    with pytest.raises(alfmu.InputError, match=r"more than 200000 elements, or 20 million characters"):
        alfmu.imported(path)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 3e8


def test_an_unknown_attribute_of_replicas_is_left_out_on_request(tmp_path: Path):
    path = tmp_path / "scene.xml"
    path.write_text(REPLICAS.replace('sep="_"', 'sep="_" wobble="3"'))
    with pytest.raises(alfmu.InputError, match=r'line 2: mujoco/worldbody/replicate: .* wobble="3" of <replicate>'):
        alfmu.imported(path)
    found = alfmu.imported(path, leave="unknown")
    assert found.warnings == ("unknown elements and attributes, left out by option (line 2)",)
    assert len(found.mechanism.spatial_bodies) == 10


def test_attached_models_are_those_written_out_by_hand(tmp_path: Path):
    path, flat = tmp_path / "scene.xml", tmp_path / "flat.xml"
    path.write_text(AROUND)
    (tmp_path / "arm.xml").write_text(ATTACHED)
    # Rotations of 0.1 about z, 0.2 about y, 0.3 about x, each about the turned axis, as one quaternion.
    (a, b, c), (d, e, f) = np.cos([0.05, 0.1, 0.15]), np.sin([0.05, 0.1, 0.15])
    turn = f"{a * b * c + d * e * f} {a * b * f - d * e * c} {a * e * c + d * b * f} {d * b * c - a * e * f}"
    part = (
        f'<body name="{{0}}base" pos="0 0 0.1" quat="{turn}"><geom type="box" size="0.1 0.05 0.05" density="3000"/>'
        '<joint name="{0}j" axis="0 1 0" damping="0.1"/><body name="{0}tip" pos="0.3 0 0"><joint name="{0}k" '
        'axis="0 1 0" damping="0.1"/><geom size="0.05" density="3000"/></body></body>'
    )
    other = '<body name="r_other" pos="0 1 0"><joint name="r_o" damping="0.1"/><geom size="0.1"/></body>'
    equal = '<joint joint1="{0}j" joint2="{0}k" polycoef="0 2 0.3"/>'
    flat.write_text(
        AROUND.replace('<asset><model name="arm" file="arm.xml"/></asset>', "")
        .replace('<attach model="arm" body="base" prefix="l_"/>', part.format("l_"))
        .replace('<attach model="arm" prefix="r_"/>', part.format("r_") + other)
        .replace("</actuator>", '<motor name="l_m" joint="l_k"/><motor name="r_m" joint="r_k"/>'
                 '<motor name="r_n" joint="r_o"/></actuator><equality>' + equal.format("l_") + equal.format("r_")
                 + '<joint joint1="r_o" joint2="r_k"/></equality>')
    )  # fmt: skip
    mechanisms = [alfmu.imported(each).mechanism for each in (path, flat)]
    assert [x.name for x in mechanisms[0].inputs] == [x.name for x in mechanisms[1].inputs]
    names = ("cart.x", "l_k.angle", "r_o.angle")
    runs = [alfmu.simulate(each, 0.4, 0.1, outputs=names) for each in mechanisms]
    for name in names:
        assert np.ptp(runs[0][name]) > 1e-2
        np.testing.assert_allclose(runs[0][name], runs[1][name], atol=1e-9)
    found = alfmu.imported(path, key="r_up")
    assert alfmu.simulate(found.mechanism, 0.1, 0.1, outputs=["r_k.angle"])["r_k.angle"][0] == pytest.approx(0.2)
    assert "parts of attached models that are not attached (3 from line 6, l_other, l_n)" in found.left_out
    for old, new, said in (
        ('body="base"', 'body="bass"', "there is no body 'l_bass'"),
        ('model="arm" body', 'model="leg" body', "there is no model 'leg'"),
        ('file="arm.xml"', 'file="scene.xml"', "files include each other in a circle"),
        ('prefix="r_"', 'prefix="l_"', "there is a body 'l_base' already"),
    ):
        path.write_text(AROUND.replace(old, new))
        with pytest.raises(alfmu.InputError, match=said):
            alfmu.imported(path)


def test_shapes_of_unknown_mass_are_left_out_on_request(tmp_path: Path):
    path, mesh = tmp_path / "arm.xml", tmp_path / "part.stl"
    mesh.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    path.write_text(
        '<mujoco><asset><mesh name="p" file="part.stl"/></asset><worldbody><body name="b"><joint name="j" '
        'axis="0 1 0"/><geom size="0.1" pos="1 0 0" mass="2"/><geom type="mesh" mesh="p"/></body>'
        '<body name="mug"><freejoint/><geom type="mesh" mesh="p" contype="0" conaffinity="0"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(alfmu.InputError, match=r"a pointer of Git LFS.*--option leave=shapes leaves its mass out"):
        alfmu.imported(path)
    found = alfmu.imported(path, leave="shapes")
    assert found.warnings == ("free bodies that this leaves without mass, which are fixed (line 1, mug)",
                              "shapes, whose mass is unknown, left out by option (line 1)")  # fmt: skip
    run = alfmu.simulate(found.mechanism, 0.01, 0.01)
    np.testing.assert_allclose(run["b.angular_velocity.y"][-1], 9.81 * 0.01 / (1 + 0.4 * 0.1**2), rtol=1e-5)


def test_missing_includes_are_named_together_and_left_out_on_request(tmp_path: Path):
    path = tmp_path / "arm.xml"
    path.write_text(arm().replace("<worldbody>", '<include file="a.xml"/><include file="b.xml"/><worldbody>', 1))
    with pytest.raises(alfmu.InputError, match=r"no file 'a\.xml'.*leave=includes.*and 1 more like it"):
        alfmu.imported(path)
    found = alfmu.imported(path, leave="includes")
    assert found.warnings == ("includes, left out by option (2 from line 1)",)


def test_loops_of_other_dialects_of_urdf_are_those_of_loop_joints(tmp_path: Path):
    """The four-bar by <loop> of URDF+, and by <constraint> with another axis in the turned frame of the child."""
    text = (Path(__file__).parent / "linkages" / "four_bar.urdf").read_text()
    begin, end = text.index("<loop_joint"), text.index("</loop_joint>") + len("</loop_joint>")
    coupler, rocker = "0.4123105625617661 0 0", "0 0 0.3"
    dialects = (
        text[begin:end],
        f'<loop name="l" type="revolute"><successor link="rocker"><origin xyz="{rocker}"/></successor>'
        f'<predecessor link="coupler"><origin xyz="{coupler}"/></predecessor><axis xyz="0 1 0"/></loop>',
        f'<constraint name="l" type="revolute"><parent link="coupler"/><parent_origin xyz="{coupler}"/>'
        f'<parent_axis xyz="0 2 0"/><child link="rocker"/><child_origin xyz="{rocker}" rpy="{np.pi / 2} 0 0"/>'
        '<child_axis xyz="0 0 -1"/></constraint>',
    )
    path, runs = tmp_path / "r.urdf", []
    for loop in dialects:
        path.write_text(text[:begin] + loop + text[end:])
        start = {"start.motor_angle": 0.4, "start.motor_angle_rate": 2.0}
        run = alfmu.simulate(alfmu.imported(path).mechanism, 0.3, 0.1, parameters=start, outputs=["motor.angle"])
        runs.append(run["motor.angle"])
    assert np.ptp(runs[0]) > 0.1
    np.testing.assert_allclose(runs[1:], runs[:1] * 2, atol=1e-9)
    path.write_text(text[:begin] + dialects[2].replace("revolute", "spherical") + text[end:])
    assert any("axes of joints of a type without an axis" in x for x in alfmu.imported(path).left_out)


def test_a_coupling_of_urdf_plus_turns_the_successor_by_its_ratio(tmp_path: Path):
    """A rotor of inertia j on the base, turned 7 times as far as the arms that hang on each other: q1 + q2 = x."""
    link = "<link name='{}'><inertial><mass value='1'/><inertia ixx='{}' iyy='{}' izz='{}'/></inertial></link>"
    joint = "<joint name='{}' type='continuous' independent='True'><parent link='{}'/><child link='{}'/>{}</joint>"
    axis, j = "<axis xyz='0 0 1'/>", 0.003
    path = tmp_path / "r.urdf"
    path.write_text(
        "<robot name='r'><link name='base'/>" + "".join(link.format(x, *[0.02] * 3) for x in ("one", "two"))
        + link.format("rotor", j, j, j) + joint.format("q1", "base", "one", axis)
        + joint.format("q2", "one", "two", axis)
        + joint.format("q3", "base", "rotor", axis) + "<coupling name='c' type='rolling'><predecessor link='two'/>"
        "<successor link='rotor'/><ratio value='7'/></coupling></robot>"
    )  # fmt: skip
    found = alfmu.imported(path, drives="q2")
    run = alfmu.simulate(found.mechanism, 1.0, 0.5, inputs={"q2_drive": 0.1})
    np.testing.assert_allclose(run["q3.angle"], 7 * (run["q1.angle"] + run["q2.angle"]), atol=1e-9)
    # The torque turns the first arm back, of inertia 0.02, and the second one with the rotor, of 0.02 + 49 j.
    np.testing.assert_allclose(run["q1.angle"], -0.1 / 0.02 * run.time**2 / 2, atol=1e-7)
    np.testing.assert_allclose(run["q3.angle"], 7 * 0.1 / (0.02 + 49 * j) * run.time**2 / 2, atol=1e-7)


def test_a_detachable_joint_of_gazebo_remains_attached(tmp_path: Path):
    """A point mass of another model on an arm: a pendulum of both (DOP853)."""
    inertial = "<inertial><mass>{}</mass><inertia><ixx>{i}</ixx><iyy>{i}</iyy><izz>{i}</izz></inertia></inertial>"
    path = tmp_path / "w.sdf"
    path.write_text(
        "<sdf version='1.9'><world name='w'><model name='arm'><link name='a'><pose>0.5 0 0 0 0 0</pose>"
        + inertial.format(2, i=0.1) + "</link><joint name='j' type='revolute'><pose relative_to='__model__'/>"
        "<parent>world</parent><child>a</child><axis><xyz>0 1 0</xyz></axis></joint><plugin filename='f' "
        "name='gz::sim::systems::DetachableJoint'><parent_link>a</parent_link><child_model>load</child_model>"
        "<child_link>b</child_link><topic>/t</topic></plugin></model><model name='load'><pose>1 0 0 0 0 0</pose>"
        "<link name='b'>" + inertial.format(1, i=0.05) + "</link></model></world></sdf>"
    )  # fmt: skip
    found = alfmu.imported(path)
    assert any("detachable joints remain attached" in note for note in found.notes)
    run = alfmu.simulate(found.mechanism, 0.5, 0.1, parameters={"solver.relative_tolerance": 1e-11})
    angle = next(run[name] for name in run.names if name.endswith("j.angle"))
    inertia = 0.1 + 2 * 0.5**2 + 0.05 + 1 * 1**2

    def falls(_: float, y: np.ndarray) -> list[float]:
        return [y[1], (2 * 0.5 + 1) * 9.8 * np.cos(y[0]) / inertia]

    swing = solve_ivp(falls, (0, 0.5), [0.0, 0.0], "DOP853", run.time, rtol=1e-12, atol=1e-12).y[0]
    np.testing.assert_allclose(angle, swing, atol=1e-8)


def test_many_detachable_joints_remain_and_only_they_are_taken_for_such(tmp_path: Path):
    """Two loads on an arm, and a link and a joint that have the name of the plugin; bodies counted by hand."""
    inertial = "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
    joint = "<joint name='{}' type='revolute'><parent>{}</parent><child>{}</child><axis><xyz>0 1 0</xyz></axis></joint>"
    plugin = ("<plugin filename='f' name='gz::sim::systems::DetachableJoint'><parent_link>a</parent_link>"
              "<child_model>{}</child_model><child_link>b</child_link></plugin>")  # fmt: skip
    path = tmp_path / "w.sdf"
    path.write_text(
        f"<sdf version='1.9'><world name='w'><model name='arm'><link name='a'>{inertial}</link>"
        f"<link name='DetachableJointTip'><pose>0.1 0 0 0 0 0</pose>{inertial}</link>" + joint.format("j", "world", "a")
        + joint.format("DetachableJoint", "a", "DetachableJointTip") + plugin.format("one") + plugin.format("two")
        + "</model>" + "".join(f"<model name='{x}'><link name='b'>{inertial}</link></model>" for x in ("one", "two"))
        + "</world></sdf>"
    )  # fmt: skip
    m = alfmu.imported(path).mechanism
    assert {x.name for x in m.spatial_bodies} == {"arm_a", "arm_DetachableJointTip", "one_b", "two_b"}
    assert len(m.coordinates) == 2


def test_flags_of_a_model_hold_for_those_attached_to_it(tmp_path: Path):
    """Without friction and limits a ball of the radius r at the length l falls by g l / (l^2 + 2 r^2 / 5)."""
    path, flags = tmp_path / "scene.xml", 'contact="disable" frictionloss="disable" limit="disable"'
    path.write_text(
        f'<mujoco><option><flag {flags}/></option><asset><model name="arm" file="arm.xml"/></asset><worldbody>'
        '<attach model="arm" prefix="a_"/></worldbody></mujoco>'
    )
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" axis="0 1 0" frictionloss="90" range="5 9" limited="true"/>'
        '<geom size="0.1" pos="0.5 0 0" mass="1"/></body></worldbody></mujoco>'
    )
    run = alfmu.simulate(alfmu.imported(path).mechanism, 1e-3, 1e-3)
    assert run["a_j.angular_velocity"][-1] == pytest.approx(9.81 * 0.5 / (0.5**2 + 0.4 * 0.1**2) * 1e-3, rel=1e-5)


def test_twice_the_bodies_take_twice_the_calls(tmp_path: Path):
    """Names, poses and masses of many bodies were searched for each of them again."""
    made, calls = [], collections.Counter[str]()
    for count in (10, 20, 60, 100):
        legs = "".join(
            f'<link name="b{i}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="j{i}" type="revolute"><parent link="base"/><child link="b{i}"/>'
            '<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
            for i in range(count)
        )
        path = tmp_path / f"legs{count}.urdf"
        path.write_text(f'<robot name="legs"><link name="base"/>{legs}</robot>')
        calls.clear()
        sys.setprofile(lambda frame, event, argument: calls.update((event,)))
        try:
            alfmu.imported(path)
        finally:
            sys.setprofile(None)
        made.append(calls["call"] + calls["c_call"])
    assert made[3] - made[2] < 1.01 * (made[2] - made[1])


@pytest.mark.parametrize(
    ("said", "axis"),
    [
        ("<xyz>0 0 1</xyz><use_parent_model_frame>false</use_parent_model_frame>", (1, 0, 0)),
        ("<xyz>0 0 1</xyz><use_parent_model_frame>true</use_parent_model_frame>", (0, 0, 1)),
        ('<xyz expressed_in="__model__">0 1 0</xyz>', (0, 1, 0)),
        ('<xyz expressed_in="arm">0 1 0</xyz>', (0, 0, 1)),
    ],
)
def test_axes_of_gazebo_joints_are_in_the_named_frame(said: str, axis: tuple[int, int, int], tmp_path: Path):
    """The link `arm` is turned by a quarter about x, and `hand` by one about y, both in the ground's axes."""
    heavy = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    free = '<joint name="{0}" type="floating"><parent link="base"/><child link="{0}l"/></joint>'
    text = f'<robot name="r"><link name="base"/><link name="arm">{heavy}</link><link name="hand">{heavy}</link>'
    for name, turn in (("arm", "1.5707963267948966 0 0"), ("hand", "0 1.5707963267948966 0")):
        text += (
            free.replace("{0}l", name)
            .replace("{0}", f"free_{name}")
            .replace("</joint>", f'<origin rpy="{turn}"/></joint>')
        )
    text += '<gazebo><joint name="g" type="revolute"><parent>arm</parent><child>hand</child><axis>{}</axis></joint>'
    path = tmp_path / "r.urdf"
    path.write_text(text.format(said) + "</gazebo></robot>")
    found = re.search(r'"g",.*?axis=\(([^)]*)\)', alfmu.imported(path).source(), re.DOTALL)
    np.testing.assert_allclose([float(x) for x in found[1].split(",")], axis, atol=1e-12)
    path.write_text(text.format('<xyz expressed_in="nowhere">0 0 1</xyz>') + "</gazebo></robot>")
    with pytest.raises(alfmu.InputError, match="nowhere"):
        alfmu.imported(path)


def test_links_of_gazebo_hang_on_joints_of_gazebo(tmp_path: Path):
    """A pendulum that only `<gazebo>` elements declare, against its equation of motion; its frame is turned."""
    link = (
        '<gazebo><link name="bob"><inertial><mass>2</mass><pose>0.3 0 0 0 0 0</pose><inertia><ixx>0.01</ixx>'
        "<iyy>0.05</iyy><izz>0.05</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia></inertial>"
        "<pose>0.1 0.2 1 0 0.5 0</pose></link></gazebo>"
    )
    joint = (
        '<gazebo><joint name="pin" type="revolute"><parent>base</parent><child>bob</child><pose>0 0 0 0 0 0</pose>'
        "<axis><xyz>0 1 0</xyz></axis></joint></gazebo>"
    )
    path = tmp_path / "r.urdf"
    path.write_text(f'<robot name="r"><link name="base"/>{joint}{link}</robot>')
    run = alfmu.simulate(str(path), 0.5, 0.1)
    rate = 2 * 9.81 * 0.3 / (0.05 + 2 * 0.3**2)
    fall = solve_ivp(lambda _, y: (y[1], rate * np.cos(y[0])), (0, 0.5), (0.5, 0), rtol=1e-12, atol=1e-12)
    angle = fall.y[0, -1]
    found = [run[f"bob.{x}"][-1] for x in "xyz"]
    np.testing.assert_allclose(found, (0.1 + 0.3 * np.cos(angle), 0.2, 1 - 0.3 * np.sin(angle)), atol=1e-9)
    path.write_text(f'<robot name="r"><link name="base"/>{link}{link}</robot>')
    with pytest.raises(alfmu.InputError, match=r"link\[bob\]: line 1 has an element of this name"):
        alfmu.imported(path)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('<site name="s"/>', '<site name="s" pos="0.3 0 0"/>'),
        ('<geom name="s" size="0.1"/>', '<geom name="s" size="0.2"/>'),
    ],
)
def test_a_name_of_mjcf_is_used_once(before: str, after: str, tmp_path: Path):
    """An actuator at either of two sites moves differently."""
    path = tmp_path / "s.xml"
    for inside, more in ((after, ""), ("", '<default><default class="k"/></default>')):
        path.write_text(
            f'<mujoco><default><default class="k"/></default>{more}<worldbody><body name="a"><joint/><geom size="0.1"/>'
            f"{before}{inside}</body></worldbody></mujoco>"
        )
        with pytest.raises(alfmu.InputError, match="names are used once"):
            alfmu.imported(path)


def test_a_loop_with_the_name_of_a_joint_does_not_hide_the_new_name_of_the_joint(tmp_path: Path):
    path = tmp_path / "r.xml"
    path.write_text(
        '<mujoco><worldbody><body name="r"><joint name="r"/><geom size="0.1"/></body></worldbody>'
        '<equality><connect name="r" body1="r" anchor="0 0 0"/></equality></mujoco>'
    )
    found = alfmu.imported(path)
    assert found.mechanism.coordinates[0].name == f"{found.renamed['joint r']}_angle"
