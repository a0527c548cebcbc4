"""Files of other programs: accelerations against MuJoCo's matrices, the three formats against each other, refusals."""

import importlib.util
import json
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from oracles.linkages import by_mujoco, moving

import alfmu
from alfmu.cli import main
from alfmu.formats import urdf
from alfmu.formats.markup import parsed

HERE = Path(__file__).parent / "linkages"
STORED = HERE / "accelerations.json"
"""What `python tests/test_formats.py` writes, with MuJoCo; used where MuJoCo is not installed."""

MUJOCO = importlib.util.find_spec("mujoco") is not None

RK4 = {"solver.method": "rk4"}
"""Where runs are compared with each other."""

MJCF = ["five_bar", "spatial", "coupled", "slider_crank", "carried", "biped"]


@pytest.mark.skipif(not MUJOCO, reason="MuJoCo is not installed (extra bench)")
@pytest.mark.parametrize("name", MJCF)
def test_accelerations_are_those_of_mujocos_matrices(name: str):
    for seed in range(2):
        found, reference, opens = by_mujoco(HERE / f"{name}.xml", *moving(HERE / f"{name}.xml", seed))
        assert opens < 1e-12  # alfmu's rates fit MuJoCo's constraints
        assert np.abs(reference).max() > 1
        np.testing.assert_allclose(found, reference, atol=1e-10 * np.abs(reference).max(), rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize("name", MJCF)
def test_accelerations_are_those_stored(name: str):
    """Of hinges and slides, at places and rates that are stored too."""
    stored = json.loads(STORED.read_text())[name]
    names, q, v, a, _ = moving(HERE / f"{name}.xml", 0)
    np.testing.assert_allclose(q, stored["q"], atol=1e-11)
    np.testing.assert_allclose(v, stored["v"], atol=1e-10)
    found = [a[names.index(each)] for each in stored["mujoco"]]
    reference = list(stored["mujoco"].values())
    np.testing.assert_allclose(found, reference, atol=1e-10 * np.abs(reference).max(), rtol=0)


@pytest.mark.slow
def test_the_biped_keeps_its_energy_by_few_iterations():
    """At rest in free fall its loops carry nothing, which tells nothing about the iterations that its motion needs.

    In a faster motion two loops of a leg are nearly singular at once. Accelerations are those that differences of rates
    show, and were a thousand times as large.
    """
    mechanism = alfmu.imported(HERE / "biped.xml").mechanism
    joints = ("hip_roll", "hip_yaw", "hip_pitch", "knee_motor", "shoulder_pitch", "elbow", "wrist_yaw")

    def moved(seed: int, size: float, stop: float) -> alfmu.Result:
        rng = np.random.default_rng(seed)
        start = {f"start.{side}_{x}_angle_rate": size * rng.normal() for side in ("left", "right") for x in joints}
        start |= {"solver.method": "rk4", "solver.step_size": 1e-3}
        return alfmu.simulate(mechanism, stop, 0.01, parameters=start, outputs=["monitor.energy", "*_toe.angular_*.z"])

    run = moved(1, 0.1, 0.5)
    assert run.counters.multiplier_iterations < 4.1 * run.counters.evaluations
    energy = run["monitor.energy"]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-11)
    run = moved(3, 0.3, 1.5)
    for side in ("left", "right"):
        rates = run[f"{side}_toe.angular_velocity.z"]
        assert np.abs(run[f"{side}_toe.angular_acceleration.z"]).max() < 10 * np.abs(np.diff(rates)).max() / 0.01


@pytest.mark.slow
def test_sdf_and_mjcf_of_one_mechanism_move_alike():
    runs = [
        alfmu.simulate(alfmu.imported(HERE / f"slider_crank.{kind}").mechanism, 0.5, 0.05,
                       parameters={"solver.relative_tolerance": 1e-11}, outputs=["main.angle"])
        for kind in ("sdf", "xml")
    ]  # fmt: skip
    assert np.ptp(runs[1]["main.angle"]) > 1
    np.testing.assert_allclose(runs[0]["main.angle"], runs[1]["main.angle"], atol=1e-10)


def test_a_frame_attached_to_a_link_stands_where_its_pose_says(tmp_path: Path):
    path = tmp_path / "frame.sdf"
    frame = '<frame name="f"{}><pose relative_to="__model__">1 2 3 0.1 0.2 0.3</pose></frame>'
    joint = '<joint name="j" type="revolute"><pose relative_to="f"/><parent>world</parent><child>l</child>'
    texts = []
    for attached in ("", ' attached_to="l"'):
        path.write_text(SDF.format(frame.format(attached) + joint + "<axis><xyz>0 1 0</xyz></axis></joint>"))
        texts.append(alfmu.imported(path).source())
    assert texts[0] == texts[1]
    assert "spatial_ground.at(1, 2, 3)" in texts[1]


def four_bar_energy(crank: float, rate: float) -> tuple[float, float]:
    """Kinetic and potential energy of four_bar.urdf, its loop closed by hand (law of cosines)."""
    A = 0.2 * np.exp(1j * crank)
    reach = 0.4 - A
    coupler, rocker = np.sqrt(0.17), 0.3
    at_a = np.arccos((coupler**2 + abs(reach) ** 2 - rocker**2) / (2 * coupler * abs(reach)))
    th = np.angle(reach) + at_a
    B = A + coupler * np.exp(1j * th)
    # Rates: i w1 A + i w2 (B - A) = i w3 (B - 0.4)
    M = np.array([[(B - A).real, -(B - 0.4).real], [(B - A).imag, -(B - 0.4).imag]])
    w2, w3 = np.linalg.solve(M, -rate * np.array([A.real, A.imag]))
    center = 0.2 + 0.02j
    v2 = 1j * rate * A + 1j * w2 * center * np.exp(1j * th)
    T = (1e-3 + 0.3 * 0.1**2) * rate**2 / 2 + (0.6 * abs(v2) ** 2 + 8e-3 * w2**2) / 2
    T += (3.4e-3 + 0.45 * 0.15**2) * w3**2 / 2
    height = 0.3 * (A / 2).imag + 0.6 * (A + center * np.exp(1j * th)).imag + 0.45 * ((B + 0.4) / 2).imag
    return T, 9.81 * height


@pytest.mark.slow
def test_urdf_with_a_loop_joint_has_the_energy_of_the_four_bar():
    with pytest.warns(alfmu.AlfmuWarning, match="limits of the speed of joints"):
        m = alfmu.load(str(HERE / "four_bar.urdf"))
    start = {"start.motor_angle": 0.4, "start.motor_angle_rate": 2.0, "solver.relative_tolerance": 1e-10}
    run = alfmu.simulate(m, 0.3, 0.05, parameters=start, outputs=["motor.*", "monitor.energy"])
    energies = [
        sum(four_bar_energy(np.pi / 2 - angle, -rate))
        for angle, rate in zip(run["motor.angle"], run["motor.angular_velocity"], strict=True)
    ]
    kinetic, _ = four_bar_energy(np.pi / 2 - 0.4, -2.0)
    assert kinetic > 0.01
    # monitor.energy counts potential energy from another zero.
    np.testing.assert_allclose(np.diff(run["monitor.energy"]), np.diff(energies), atol=1e-9)


@pytest.mark.slow
def test_python_text_declares_the_same_mechanism(tmp_path: Path, capsys: pytest.CaptureFixture):
    written = tmp_path / "five.py"
    assert main(["import", str(HERE / "five_bar.xml"), "-o", str(written)]) == 0
    assert "joint left elbow is called left_elbow" in capsys.readouterr().out
    own, other = (alfmu.simulate(str(path), 0.2, 0.02, parameters=RK4) for path in (written, HERE / "five_bar.xml"))
    assert own.names == other.names
    for name in ("left.angle", "tip_joint.force.z"):
        np.testing.assert_array_equal(own[name], other[name])


def test_an_fmu_of_a_file_runs_in_fmpy(tmp_path: Path):
    path = tmp_path / "five.fmu"
    alfmu.export(str(HERE / "five_bar.xml"), path)
    run = fmpy.simulate_fmu(
        str(path), stop_time=0.2, output_interval=0.02, output=["left.angle", "tip_joint.force.x"],
        start_values={"left_motor": 0.3},
    )  # fmt: skip
    own = alfmu.simulate(str(HERE / "five_bar.xml"), 0.2, 0.02, inputs={"left_motor": 0.3})
    assert run["time"][-1] == pytest.approx(0.2)
    np.testing.assert_allclose(run["left.angle"], own["left.angle"], atol=1e-9)


BODY = (
    "<mujoco>{}<worldbody>"
    '<body name="b"><joint name="j"{}/><geom name="g" size="0.1"{}/>{}</body></worldbody>{}</mujoco>'
)


SDF = "<sdf version='1.9'><model name='m'><link name='l'/>{}</model></sdf>"
URDF = (
    "<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='continuous'><parent link='a'/>"
    "<child link='b'/></joint>{}</robot>"
)


def mjcf(before: str = "", joint: str = "", geom: str = "", inner: str = "", after: str = "") -> str:
    return BODY.format(before, joint, geom, inner, after)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (mjcf(after="<tendon><spatial name='t' damping='1'/></tendon>"),
         r"tendon/spatial\[t\]: damping of a <spatial> tendon does not map"),
        (mjcf(geom=' type="mesh" mesh="m"'), "there is no mesh 'm'"),
        (mjcf(geom=' type="hull"'), r"body\[b\]/geom\[g\]: a geom of type 'hull' gives no inertia"),
        (mjcf(joint=' type="ball" frictionloss="1"'), r"joint\[j\]: frictionloss of a ball joint does not map"),
        (mjcf(joint=' springdamper="1 0"'), "gives a time and a damping ratio above zero"),
        (mjcf(joint=' wobble="1"'), 'does not know the effect of wobble="1" of <joint>'),
        (mjcf(joint=' axis="0 0 0"'), "the axis has no direction"),
        (mjcf(joint=' axis="0 nan 1"'), "which is no finite number"),
        (mjcf(joint=' axis="0 1"'), "axis has 2 numbers; give 3"),
        (mjcf(joint=' damping="1 2"'), "that depends on the displacement does not map"),
        (mjcf(joint=' type="ball" stiffness="1"'), "spring of a ball joint does not map"),
        (mjcf(before='<option density="1.2"/>'), "no medium around bodies"),
        (mjcf(before='<compiler coordinate="global"/>'), "global coordinates do not map"),
        (mjcf(inner='<body name="b"><joint/></body>'), "there is a body 'b' already"),
        (mjcf(inner='<composite type="cable"/>'), "<composite> does not map"),
        (mjcf(after="<equality><tendon/></equality>"), "it has no tendon1; give one"),
        (mjcf(after="<equality><distance/></equality>"), "--option leave=flexible leaves it out"),
        (mjcf(after='<equality><connect body1="x" anchor="0 0 0"/></equality>'), "there is no body 'x'"),
        (mjcf(after='<actuator><muscle joint="j"/></actuator>'), "an actuator of kind <muscle> does not map"),
        (mjcf(inner='<site name="s"/>', after='<actuator><position site="s" refsite="s" gear="0 0 0 1"/></actuator>'),
         "feedback of the rotation of a site does not map"),
        (mjcf(after='<actuator><adhesion body="b"/></actuator>'), "an actuator of kind <adhesion> does not map"),
        (mjcf(inner='<site name="s"/>',
              after='<actuator><motor cranksite="s" slidersite="s" cranklength="0"/></actuator>'),
         "cranklength is 0; it must be above zero"),
        (mjcf(before='<include file="../x.xml"/>'), "outside the folder"),
        (mjcf(before='<include file="x.xml"/>'), "there is no file 'x.xml'"),
        ("<!DOCTYPE a [<!ENTITY b 'c'>]><mujoco/>", "document type"),
        ("<mujoco>" + "<a>" * 300 + "</a>" * 300 + "</mujoco>", "more than 200 deep"),
        ("<mujoco><body></mujoco>", r"line 1: this is no XML \(mismatched tag\)"),
        ("<html/>", "alfmu reads <mujoco>"),
        ("<mujoco><worldbody><body><geom size='1'/></body></worldbody></mujoco>", "nothing in it moves"),
        (SDF.format("<joint type='revolute'/>"), "joint: it has no name; give one"),
        ("<sdf version='1.9'><model name='m'><link name='l'/><joint name='j' type='spring'><parent>world</parent>"
         "<child>l</child></joint></model></sdf>", r"joint\[j\]: a 'spring' joint does not map"),
        (SDF.format("<joint name='j' type='gearbox'><parent>world</parent><child>l</child></joint>"),
         r"joint\[j\]: it has no <gearbox_reference_body>; give one"),
        ("<sdf version='1.9'><model name='m'><link name='l'><pose relative_to='f'/></link><frame name='f'><pose "
         "relative_to='l'/></frame></model></sdf>", "in a circle"),
        ("<robot name='r'><link name='a'/><link name='b'/><joint name='j' type='curvilinear'><parent link='a'/>"
         "<child link='b'/></joint></robot>", "a joint of type 'curvilinear' does not map"),
        ("<robot name='r'><link name='a'/><link name='b'/></robot>", "2 links without a parent"),
        ("<robot name='r'><link name='a'/><xacro:arm/></robot>", "expand it first"),
        (mjcf(before='<default class="top"/>'), "its name is main"),
        (mjcf(before='<option actuatorgroupdisable="0"/>'), "leave the actuators out"),
        (mjcf(before='<option><flag wobble="enable"/></option>'), "does not know the flag wobble"),
        (mjcf(before='<compiler eulerseq="abc"/>', inner='<site euler="1 2 3"/>'), "eulerseq is 'abc'; give three"),
        (mjcf(before='<option><wobble/></option>'), "does not know the effect of <wobble> in <option> on"),
        (mjcf(inner='<body name="c"><freejoint align="true"/></body>'), "it moves frames, not bodies"),
        (mjcf(before='<option><flag filterparent="disable"/></option>',
              inner='<body name="c"><joint/><geom size="1"/></body>'), "could touch, of b and c"),
        (SDF.format("<joint name='j' type='revolute'><parent>world</parent><child>l</child><axis><dynamics><dampning>1"
                    "</dampning></dynamics></axis></joint>"), "not know the effect of <dampning> in <dynamics> on"),
        (SDF.format("<joint name='j' type='ball' use='1'><parent>world</parent><child>l</child></joint>"),
         'does not know the effect of use="1" of <joint> on'),
        (URDF.format("<gazebo reference='b'><selfCollide>true</selfCollide></gazebo>"), "contacts=leave leaves them"),
        (URDF.format("<transmission name='t'><joint name='j'/><actuator name='a'><drake:rotor_inertia value='1'/>"
                     "</actuator></transmission>"), "inertia of a rotor does not map"),
    ],
)  # fmt: skip
def test_what_does_not_map_is_refused_by_name(text: str, said: str, tmp_path: Path):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(alfmu.InputError, match=said) as error:
        alfmu.load(str(path))
    assert "robot.xml" in str(error.value)


def test_what_does_nothing_or_may_matter_is_told(tmp_path: Path):
    path = tmp_path / "robot.xml"
    path.write_text(mjcf(before='<option timestep="0.001"/>', joint=' range="-1 1"'))
    found = alfmu.imported(path)
    assert "settings of MuJoCo's solver, as constraints are rigid here (line 1)" in found.left_out
    assert found.warnings == ()
    assert alfmu.imported(path, limits="ignore").warnings == ("limits of joints (line 1, j)",)
    path = tmp_path / "robot.sdf"
    limit = "<axis><limit><upper>1</upper></limit></axis>"
    path.write_text(SDF.format(
        f"<joint name='j' type='revolute'><parent>world</parent><child>l</child>{limit}</joint>"
    ))  # fmt: skip
    assert alfmu.imported(path, limits="ignore").warnings == ("limits of joints (line 1, j)",)
    path.write_text(SDF.format("<link name='k'/>" + "".join(
        f"<joint name='j{a}{b}' type='fixed'><parent>{a}</parent><child>{b}</child></joint>"
        for a, b in (("world", "l"), ("l", "k"), ("world", "k"))
    ) + "<link name='n'/><joint name='x' type='revolute'><parent>world</parent><child>n</child><axis/></joint>"
        "<joint name='y' type='fixed'><parent>k</parent><child>n</child></joint>"))  # fmt: skip
    assert "its closed loops permit no motion here" in alfmu.imported(path).notes[-1]


USUAL = {
    "urdf": URDF.format(
        "<material name='blue'><color rgba='0 0 1 1'/></material><link name='tool'/><joint name='f' type='fixed'>"
        "<parent link='b'/><child link='tool'/><axis xyz='0 0 0'/><limit effort='0' velocity='0'/></joint>"
        "<gazebo reference='b'><material>Gazebo/Red</material><turnGravityOff>false</turnGravityOff></gazebo>"
        "<gazebo><plugin filename='a.so' name='p'><x>1</x></plugin></gazebo><ros2_control name='c'><x/></ros2_control>"
        "<transmission name='t'><type>Simple</type><joint name='j'><hardwareInterface>E</hardwareInterface></joint>"
        "<actuator name='m'><mechanicalReduction>10</mechanicalReduction></actuator></transmission>"
    ),
    "sdf": SDF.format(
        "<joint name='j' type='revolute'><parent>world</parent><child>l</child><axis><limit><lower>-1</lower><upper>1"
        "</upper><stiffness>1e8</stiffness></limit><dynamics><friction>0</friction></dynamics></axis><physics><ode/>"
        "</physics></joint><frame name='f'><pose>0 0 1 0 0 0</pose></frame><plugin name='x'><y/></plugin>"
    ),
    "xml": mjcf(
        before="<size njmax='5'/><visual><map force='1'/></visual><statistic extent='2'/><custom><numeric name='a'/>"
        "</custom>",
        after="<sensor><jointpos joint='j'/></sensor><contact><exclude body1='b' body2='world'/></contact>",
    ),
}  # fmt: skip
"""What files of these formats often have, and does nothing."""


@pytest.mark.parametrize("kind", USUAL)
def test_what_files_often_have_is_left_out(kind: str, tmp_path: Path):
    path = tmp_path / f"robot.{kind}"
    path.write_text(USUAL[kind])
    found = alfmu.imported(path)
    assert [c.name for c in found.mechanism.coordinates] == ["j_angle"]
    assert len(found.left_out) + len(found.warnings) > 2
    massless = [each for each in found.notes if "joints that move no mass and no inertia" in each]
    assert [each[-11:] for each in massless] == ["(line 1, j)"] * (kind == "urdf")
    if kind == "urdf":
        axis = "<parent link='b'/><child link='c'/><mimic joint='j'/></joint>"
        path.write_text(URDF.format(f"<link name='c'/><joint name='k' type='continuous'>{axis}"))
        assert "which no loop holds, so that it cannot run" in alfmu.imported(path).notes[0]


def test_included_files_are_one_with_the_file(tmp_path: Path):
    whole = (HERE / "slider_crank.xml").read_text()
    begin, end = whole.index('<body name="piston"'), whole.index("</worldbody>")
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "piston.xml").write_text(f"<mujocoinclude>{whole[begin:end]}</mujocoinclude>")
    path = tmp_path / "slider_crank.xml"
    path.write_text(f'{whole[:begin]}<include file="parts/piston.xml"/>{whole[end:]}')
    found, own = alfmu.imported(path), alfmu.imported(HERE / "slider_crank.xml")
    assert 'm.coordinate("guide_position"' in found.source()
    assert found.source() == own.source()


CHANGED = [
    ("crank", "pos", "0.1 0 0.2"), ("main", "axis", "0 2 0"), ("main", "damping", "0.3"), ("main", "ref", "10"),
    ("main", "stiffness", "2"), ("main", "armature", "0.01"), ("main", "pos", "0.01 0 0"), ("pin", "springref", "5"),
    ("rod", "pos", "0.11 0.02 0"), ("rod_mass", "euler", "1 2 30"), ("guide", "axis", "1 0 0.1"),
    ("guide", "stiffness", "20"), ("guide", "damping", "3"), ("piston", "pos", "0.4 0.1 0.09"),
]  # fmt: skip
"""Attributes of slider_crank.xml, by the name of their element."""


@pytest.mark.skipif(not MUJOCO, reason="MuJoCo is not installed (extra bench)")
def test_each_attribute_changes_what_it_changes_in_mujoco(tmp_path: Path):
    path = tmp_path / "slider_crank.xml"
    root = ElementTree.fromstring((HERE / "slider_crank.xml").read_text())
    for pose in root.iter("inertial"):
        pose.attrib["mass"] = "0.6"
    for name, attribute, value in CHANGED:
        element = next(each for each in root.iter() if each.get("name") == name)
        element.set(attribute, value)  # on top of what was changed before
        path.write_text(ElementTree.tostring(root, encoding="unicode"))
        found, reference, opens = by_mujoco(path, *moving(path, 0))
        assert opens < 1e-12
        assert np.abs(reference).max() > 1
        np.testing.assert_allclose(found, reference, atol=1e-9 * np.abs(reference).max(), err_msg=f"{name} {attribute}")


INHERITED = """<mujoco><compiler inertiafromgeom="{}"/><option><flag contact="disable"/></option><default>
<geom type="box" size="0.1 0.2 0.3" quat="1 1 0 0"/><joint damping="0.1" axis="1 2 0"/>
<general biastype="affine" biasprm="0 -4 -2"/>
<default class="c"><geom euler="0 20 30"/><general biasprm="0.5 -3"/></default></default><worldbody>
<body><joint name="a"/><geom size="0.05"/><inertial pos="0.1 0 0" mass="2" diaginertia="1 2 2.5"/>
<body pos="0.3 0 0"><joint name="b" ref="10"/><geom class="c" size="0.05 0.1" pos="0 0.2 0"/>
<body pos="0.3 0 0"><joint name="c" axis="0 0 1"/><inertial pos="0.1 0.2 0" mass="1" diaginertia="1 1 1"/></body></body>
</body></worldbody><equality><joint joint1="b" joint2="c" polycoef="0.2"/></equality>
<actuator><general joint="a" class="c" biasprm="0.7"/><general joint="c" ctrlrange="0 0"/></actuator></mujoco>"""
"""Defaults of several levels; arrays that are shorter than what they inherit."""


@pytest.mark.skipif(not MUJOCO, reason="MuJoCo is not installed (extra bench)")
@pytest.mark.parametrize("inertia", ["auto", "true"])
def test_defaults_are_inherited_as_in_mujoco(inertia: str, tmp_path: Path):
    path = tmp_path / "inherited.xml"
    path.write_text(INHERITED.format(inertia))
    found, reference, opens = by_mujoco(path, *moving(path, 0))
    assert opens < 1e-12
    np.testing.assert_allclose(found, reference, atol=1e-9 * np.abs(reference).max())


@pytest.mark.slow
def test_a_recipe_of_a_file_becomes_a_native_fmu(tmp_path: Path):
    (tmp_path / "five_bar.xml").write_text((HERE / "five_bar.xml").read_text())
    recipe = tmp_path / "pair.py"
    recipe.write_text(
        'from alfmu import Recipe\n\nrecipe = Recipe("five_bar.xml", kind="native", outputs=["left.angle"], '
        'options={"contacts": "leave"}, parameters={"left_motor": 0.2})\n'
    )
    assert main(["export", str(recipe), "-o", str(tmp_path / "pair.fmu")]) == 0
    run = fmpy.simulate_fmu(str(tmp_path / "pair.fmu"), stop_time=0.2, output_interval=0.02)
    own = alfmu.simulate(str(HERE / "five_bar.xml"), 0.2, 0.02, inputs={"left_motor": 0.2})
    assert run.dtype.names == ("time", "left.angle")
    assert np.ptp(own["left.angle"]) > 0.1
    np.testing.assert_allclose(run["left.angle"], own["left.angle"], atol=1e-9)


def test_lines_of_python_are_short(tmp_path: Path):
    long = "a very long name that never ends and goes on for ever and ever " * 3
    path = tmp_path / "long.xml"
    path.write_text(mjcf(
        joint=f' class="{long}"', before=f'<default><default class="{long}"/></default>',
        after=f'<actuator><general name="{long}" joint="j" gear="1.23456789" gainprm="2.3456789" biastype="affine" '
        'biasprm="1.2345 2.3456 3.4567" ctrlrange="-1 1.2345" forcerange="-2.3456 3"/></actuator>',
    ).replace("<mujoco>", f'<mujoco model="{long}">').replace('name="b"', f'name="{long}"'))  # fmt: skip
    found = alfmu.imported(path)
    text = found.source()
    assert max(map(len, text.split("\n"))) <= 120
    (tmp_path / "long.py").write_text(text)
    again = alfmu.load(str(tmp_path / "long.py"))
    assert alfmu.derive(again).inputs[0].name == alfmu.derive(found.mechanism).inputs[0].name
    runs = [
        alfmu.simulate(m, 0.2, 0.1, inputs={m.inputs[0].name: 0.5}, parameters=RK4) for m in (again, found.mechanism)
    ]
    assert np.ptp(runs[0]["j.angle"]) > 0
    np.testing.assert_array_equal(runs[0]["j.angle"], runs[1]["j.angle"])


def test_contacts_are_refused_until_they_are_left_out(tmp_path: Path):
    path = tmp_path / "robot.xml"
    path.write_text(mjcf().replace("<worldbody>", '<worldbody><geom type="plane" size="1 1 1"/>'))
    with pytest.raises(alfmu.InputError, match="could touch, of world and b; contacts do not map"):
        alfmu.load(str(path))
    assert alfmu.load(str(path), contacts="leave").coordinates


def test_a_keyframe_is_the_start_and_drives_are_inputs(tmp_path: Path):
    path = tmp_path / "robot.xml"
    path.write_text(
        mjcf(after='<actuator><motor name="u" joint="j"/></actuator><keyframe><key name="up" qpos="0.7" qvel="-2" '
             'ctrl="3"/></keyframe>')
    )  # fmt: skip
    m = alfmu.load(str(path), key="up", drives="j")
    assert (m.starts[0].value, m.starts[0].rate) == (0.7, -2)
    assert [(x.name, x.start) for x in m.inputs] == [("u", 3.0)]
    path.write_text(mjcf())
    assert [x.name for x in alfmu.load(str(path), drives="j").inputs] == ["j_drive"]
    with pytest.raises(alfmu.InputError, match="there is no keyframe 'down'"):
        alfmu.load(str(path), key="down")


def test_urdf_mimic_and_gazebo_joints(tmp_path: Path):
    arm = "<inertial><origin xyz='0 0 -0.1'/><mass value='1'/><inertia ixx='1e-2' iyy='1e-2' izz='1e-2'/></inertial>"
    joint = "<joint name='{0}' type='continuous'><parent link='a'/><child link='{0}l'/><axis xyz='0 1 0'/>{1}</joint>"
    text = f"<robot name='r'><link name='a'/><link name='bl'>{arm}</link><link name='cl'>{arm}</link>"
    text += joint.format("b", "") + joint.format("c", "<mimic joint='b' multiplier='-2' offset='0.1'/>")
    path = tmp_path / "r.urdf"
    path.write_text(text + "</robot>")
    run = alfmu.simulate(str(path), 0.5, 0.1, parameters={"start.b_angle": 0.5})
    np.testing.assert_allclose(run["c.angle"], 0.1 - 2 * run["b.angle"], atol=1e-12)
    assert abs(run["b.angle"][-1] - 0.5) > 0.01
    fixed = "<gazebo><joint name='w' type='fixed'><parent>a</parent><child>cl</child></joint></gazebo></robot>"
    path.write_text(text.replace("<mimic joint='b' multiplier='-2' offset='0.1'/>", "") + fixed)
    run = alfmu.simulate(str(path), 0.2, 0.1, parameters={"start.b_angle": 0.5})
    np.testing.assert_allclose(run["c.angle"], 0.0, atol=1e-12)


SLIDING = """<mujoco><compiler angle="radian"/><option><flag contact="disable"/></option><worldbody>
<body name="b0"><joint name="j0" axis="{}"/><geom type="sphere" size="0.1" pos="{}"/>
<body name="b1" pos="{}" euler="{}">{}<geom type="sphere" size="0.1" pos="{}"/></body></body></worldbody>{}</mujoco>"""
HELD = ["0.776902 0.964881 -1.082178", "0.260105 -0.050448 -0.056898", "-0.436779 -1.279645 -0.4695",
        "-1.196827 -1.839857 -0.145557"]  # fmt: skip
"""A slide, in a direction like no other, between two bodies that are welded together, too: of the rows of the weld
those of rotations are nothing but round-off in C."""


@pytest.mark.slow
def test_what_only_round_off_holds_is_not_held(tmp_path: Path):
    path, ball = tmp_path / "held.xml", "0.076559 0.051957 -0.381028"
    slide = '<joint name="j1" type="slide" axis="0.398279 -2.162061 0.014477"/>'
    weld = '<equality><weld body1="b1" body2="b0"/></equality>'
    angles = []
    for between, closed in ((slide, weld), ("", "")):
        path.write_text(SLIDING.format(*HELD, between, ball, closed))
        angles.append(alfmu.simulate(str(path), 0.5, 0.1)["j0.angle"])
    assert np.abs(angles[1][-1]) > 0.1
    np.testing.assert_allclose(*angles, atol=1e-6)


if __name__ == "__main__":
    values = {}
    for each in MJCF:
        names, q, v, a, u = moving(HERE / f"{each}.xml", 0)
        found, reference, _ = by_mujoco(HERE / f"{each}.xml", names, q, v, a, u)
        scalar = [name for name in names if name.endswith(("_angle", "_position"))]
        # Which of MuJoCo's accelerations is which is known by alfmu's, which agree to ten digits.
        nearest = {name: float(reference[np.abs(found - a[names.index(name)]).argmin()]) for name in scalar}
        values[each] = {"q": q.tolist(), "v": v.tolist(), "mujoco": nearest}
    STORED.write_text(json.dumps(values, indent=1) + "\n")


def test_a_long_chain_has_the_mass_matrix_of_its_sums(tmp_path: Path):
    """Equal links along x that turn about y: each pair of joints moves all links after both."""
    count, mass, inertia = 600, 0.1, 1e-4
    body = f'<inertial><mass value="{mass}"/><origin xyz="0.1 0 0"/><inertia ixx="1e-4" iyy="{inertia}" izz="1e-4" '
    body += 'ixy="0" ixz="0" iyz="0"/></inertial>'
    links = "".join(f'<link name="l{k}">{body * (k > 0)}</link>' for k in range(count + 1))
    hinge = '<joint name="j{0}" type="continuous"><parent link="l{0}"/><child link="l{1}"/><origin xyz="{2} 0 0"/>'
    joints = "".join(f'{hinge.format(k, k + 1, 0.2 * (k > 0))}<axis xyz="0 1 0"/></joint>' for k in range(count))
    path = tmp_path / "chain.urdf"
    path.write_text(f'<robot name="chain">{links}{joints}</robot>')
    M, momenta, _ = urdf.File(parsed(path)).linkage.masses
    arms = 0.2 * np.arange(count) + 0.1 - 0.2 * np.arange(count)[:, None]  # of each link about each joint
    moved = np.where(arms > 0, arms, 0.0)
    np.testing.assert_allclose(M, mass * moved @ moved.T + inertia * np.minimum.outer(*[np.arange(count, 0, -1)] * 2))
    np.testing.assert_allclose(momenta[2], -mass * moved.sum(axis=1))
