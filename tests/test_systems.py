"""Connected systems: descriptions, masters, SSP archives, and other tools that run them."""

import ctypes
import importlib.metadata
import importlib.util
import math
import shutil
import subprocess
import sys
import textwrap
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from archives import changed, replaced
from drives import WANTED, drive, first_order, spindle
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd, read_ssv
from pythonfmu.builder import FmuBuilder
from scenes import initialized
from scipy.integrate import solve_ivp

import alfmu
from alfmu import AlfmuError, AlfmuWarning, ExportError, InputError, Mechanism, StepError, System, parts
from alfmu.cli import main
from alfmu.parts.blocks import BLOCKS
from alfmu.systems.description import Component, Connection
from alfmu.systems.masters import MASTERS
from alfmu.systems.ports import Measure, conversion, measure
from alfmu.systems.run import Assembly

SAME = 1e-6
"""What other tools may differ by."""


@pytest.fixture(scope="module")
def described(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The description of the driven four-bar."""
    return drive(tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def ssp(described: Path) -> Path:
    """The driven four-bar as an SSP."""
    return System.load(described).export(described.with_name("drive.ssp"))


@pytest.fixture(scope="module")
def spindle_ssp(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return spindle().export(tmp_path_factory.mktemp("spindle") / "spindle.ssp")


# Parts --------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_blocks_together_are_the_linear_system(spindle_ssp):
    """Motor, gearbox and load by SciPy, against the system at a step where coupling leaves little."""
    k, r, inductance, inertia = 0.05, 0.4, 2e-3, 1e-3

    def rate(t, x):
        i, w, twist, v = x
        ahead = w / 5 - v
        torque = 50 * twist + 0.5 * ahead
        return [(12 - r * i - k * w) / inductance, (k * i - torque / 5) / inertia, ahead, (torque - 0.1 * v) / 0.05]

    exact = solve_ivp(rate, (0, 0.2), np.zeros(4), method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    run = spindle().simulate(master="iterated", communication_step=2.5e-4)
    found = [run[name][-1] for name in ("motor.current", "motor.speed", "gearbox.twist", "load.speed")]
    assert found == pytest.approx(list(exact), rel=1e-5)


def test_a_load_brakes_a_joint():
    """A wheel with flywheel, friction, an opposing torque and a fan, against SciPy."""
    m = Mechanism("drum")
    angle = m.coordinate("angle", "rad", independent=True, rate=30.0)
    drum = m.body("drum", mass=1.0, inertia=0.02)
    axle = m.revolute("axle", m.ground.at(), drum.at(), coordinate=angle)
    load = parts.load(m, "brake", axle, inertia=0.03, damping=0.05, opposing=0.2, fan=1e-3)
    m.output("power", load.torque * load.speed, "W")
    run = alfmu.simulate(m, 1.0, 0.1, parameters={"solver.relative_tolerance": 1e-9})

    def rate(t, w):
        return (-0.05 * w - 0.2 * np.tanh(w / 0.1) - 1e-3 * abs(w) * w) / 0.05

    exact = solve_ivp(rate, (0, 1.0), [30.0], method="DOP853", rtol=1e-12, atol=1e-13).y[0, -1]
    assert run["drum.angular_velocity"][-1] == pytest.approx(exact, rel=1e-7)
    assert run["power"][-1] == pytest.approx(run["brake.torque"][-1] * exact, rel=1e-6)


def test_a_load_is_refused_where_it_loads_nothing():
    m = Mechanism("drum")
    axle = m.revolute(
        "axle", m.ground.at(), m.body("drum", mass=1.0, inertia=1.0).at(), coordinate=m.coordinate("a", "rad")
    )
    with pytest.raises(AlfmuError, match="loads nothing"):
        parts.load(m, "load", axle)
    with pytest.raises(AlfmuError, match="give it a joint of this mechanism that is a revolute or a screw"):
        parts.load(m, "load", "axle", inertia=1.0)


@pytest.mark.parametrize("name", BLOCKS)
def test_every_block_runs(name):
    i = initialized(alfmu.Instance(BLOCKS[name]()))
    for v in i.input_variables:
        i.set(v.name, 1.0)
    i.step(0.01)
    assert np.isfinite(i.read()).all()
    assert np.abs(i.read()).max() > 0


def test_an_input_changes_along_a_slope():
    """x' = u - x for u = 2 t from x = 0: x = 2 (t - 1 + exp(-t))."""
    i = initialized(alfmu.Instance(first_order()), {"solver.relative_tolerance": 1e-10})
    i.slope("u", 2.0)
    i.step(0.5)
    assert i.get("x") == pytest.approx(2 * (0.5 - 1 + math.exp(-0.5)), rel=1e-8)
    assert i.get("u") == 1.0
    with pytest.raises(InputError, match=r"it has u"):
        i.slope("v", 1.0)
    with pytest.raises(InputError, match="finite"):
        i.slope("u", math.nan)


# Masters ------------------------------------------------------------------------------------------------------------


def pair(gain: float = -4.0, instant: float = 0.0, **more) -> System:
    """Two blocks in a circle, a' = gain b - a and b' = a + 1 - b."""
    links = [("a.y", "b.u"), Connection("b.y", "a.u", factor=gain, offset=1.0)]
    blocks = {"a": first_order("a", instant=instant), "b": first_order("b", instant=instant)}
    return System("pair", blocks, links, **{"stop_time": 1.0, "communication_step": 0.1, **more})


@pytest.mark.parametrize(("master", "order"), [("held", 1), ("extrapolated", 2), ("iterated", 2)])
def test_masters_have_their_order(master, order):
    """Fitted over four halvings against SciPy; factor and offset of a connection included."""
    exact = solve_ivp(
        lambda t, x: [-4 * x[1] + 1 - x[0], x[0] - x[1]], (0, 1), [0, 0], method="DOP853", rtol=1e-12, atol=1e-14
    ).y[:, -1]
    steps = 0.1 / 2.0 ** np.arange(5)
    given = {f"{name}.solver.relative_tolerance": 1e-11 for name in "ab"}
    runs = [pair(master=master).simulate(communication_step=h, parameters=given) for h in steps]
    errors = [max(abs(run["a.x"][-1] - exact[0]), abs(run["b.x"][-1] - exact[1])) for run in runs]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.12)


def test_iteration_follows_a_loop_that_nothing_else_can():
    """Outputs follow inputs at once, in a circle: y_a = x_a + u_a / 2, and u_a = -4 y_b + 1."""
    system = pair(instant=0.5)
    with pytest.raises(InputError, match=r"a\.y -> .* is an algebraic loop.*iterated"):
        system.simulate(master="extrapolated")
    with pytest.warns(AlfmuWarning, match="delay of one communication step"):
        held = system.simulate(master="held", communication_step=0.01, stop_time=0.05)
    assert np.isfinite(held.values).all()

    def rate(t, x):
        # u_b = x_a + u_a / 2, u_a = 1 - 4 (x_b + u_b / 2)
        u_a = (1 - 4 * x[1] - 2 * x[0]) / 2
        return [u_a - x[0], x[0] + u_a / 2 - x[1]]

    exact = solve_ivp(rate, (0, 1), [0, 0], method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    run = system.simulate(master="iterated", communication_step=0.01)
    assert [run["a.x"][-1], run["b.x"][-1]] == pytest.approx(exact, rel=1e-4)
    assert run["a.y"][0] == pytest.approx(0.25, rel=1e-8)  # 0.5 u_a with u_a = 1/2 at rest


def test_iteration_ends_where_inputs_agree_with_outputs():
    with Assembly(pair(master="iterated")) as unit:
        unit.initialize()
        unit.step(0.1, 0.0)
        y = dict(zip([v.name for v in unit.outputs], unit.read(), strict=True))
        assert unit.fed() == pytest.approx([y["a.y"], -4 * y["b.y"] + 1], abs=2e-9)
        assert unit.iterations > 1
        assert unit.jacobians == 1


def test_a_master_that_does_not_converge_says_so(monkeypatch):
    monkeypatch.setattr("alfmu.systems.run.MOST", 1)
    with pytest.raises(StepError, match=r"still differs by .* after 1 iterations.*shorter") as raised:
        pair(master="iterated").simulate()
    assert len(raised.value.result.time) == 1


def test_a_switch_is_held_and_a_run_may_begin_later():
    m = first_order("switched")
    m.output("unused", m.time, "s")
    system = System("late", {"a": m}, [], {"a.u": 1.0}, start_time=2.0, stop_time=3.0, communication_step=0.25)
    run = system.simulate()
    assert list(run.time) == [2.0, 2.25, 2.5, 2.75, 3.0]
    assert run["a.unused"][-1] == 3.0
    assert run["a.x"][-1] == pytest.approx(1 - math.exp(-1), rel=1e-6)
    driven = system.simulate(inputs={"a.u": lambda t: t - 2.0})
    assert driven["a.u"][-1] == 1.0


# Descriptions -------------------------------------------------------------------------------------------------------


def told(described: Path, old: str, new: str, folder: Path) -> Path:
    text = described.read_text()
    assert old in text
    path = folder / "changed.toml"
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("stop_time", "stop_tme", "no key stop_tme; did you mean stop_time"),
        ("[components.arm]", "[components.arm]\nfmu = 'x.fmu'", "has mechanism and fmu"),
        ('part = "motor"', 'part = "moter"', "did you mean motor"),
        ("constant", "konstant", "component motor: motor() takes no konstant; did you mean constant"),
        ("0.4", "inf", "stop_time is inf"),
        ('to = "arm.A.torque"', 'to = "arm.A.torqe"', "arm has no input 'A.torqe'; did you mean A.torque"),
        ('from = "motor.torque"', 'from = "arm.m1"', "is a parameter, and a connection begins at an output"),
        ('to = "arm.A.torque"', 'to = "motor.speed"', "motor.speed is connected to motor.torque and arm"),
        ('from = "motor.torque"', 'from = "motor.current"', "A and N.m do not measure the same"),
        ('from = "motor.torque"', 'from = "mover.torque"', "is of no component"),
        ('to = "arm.A.torque"', 'to = "arm.A.torque"\nconvert = "A -> V"', "the units are 'N.m -> N.m'"),
        ('to = "arm.A.torque"', 'to = "arm.A.torque"\nfactor = 0', "a factor other than zero"),
        ('"controller.wanted" =', '"controller.wantd" =', "has no input 'wantd'"),
        ('"controller.wanted" =', '"motor.voltage" =', "is given, and connected to controller.output"),
        ("[inputs]", "[inputs", "is no TOML file"),
        ('name = "drive"', 'name = "drive"\nmaster = "iterate"', "no master 'iterate'"),
        ('name = "drive"', 'name = "drive"\nmaster = ["held"]', "no master ['held']"),
        ('name = "drive"', 'name = "drive"\nbonds = [["motor.torque", ["a"]]]', "which is connected to nothing"),
        ('to = "arm.A.torque"', 'to = "arm.A.torque"\nconvert = "none"', "convert is 'none'; give both units"),
    ],
)
def test_what_describes_no_system_is_refused(described, tmp_path, old, new, said):
    path = told(described, old, new, tmp_path)
    with pytest.raises(InputError) as raised:
        System.load(path).simulate(stop_time=0.01)
    assert said in str(raised.value).replace("\n", " ")


def test_a_connected_input_is_not_set(described):
    with pytest.raises(InputError, match=r"motor\.speed is connected to arm\.link1\.angular_velocity"):
        System.load(described).simulate(0.01, parameters={"motor.speed": 1.0})


def test_units_are_converted():
    assert conversion(measure("r/min"), measure("rad/s")) == pytest.approx((math.pi / 30, 0.0), rel=1e-14)
    assert conversion(measure("mm"), measure("m")) == (1e-3, 0.0)
    assert conversion(measure("m"), measure("mm")) == pytest.approx((1e3, 0.0), rel=1e-14)
    celsius, kelvin = Measure.of("degC", {"K": 1}, offset=273.15), Measure.of("K", {"K": 1})
    assert conversion(celsius, kelvin) == (1.0, 273.15)
    assert conversion(kelvin, celsius) == (1.0, -273.15)
    with pytest.raises(InputError, match="do not measure the same"):
        conversion(measure("N"), measure("N.m"))


def test_another_unit_of_an_fmu_asks_for_conversion(tmp_path):
    """The unit of an FMU's input is renamed to r/min in its description, as another tool's FMU might have it.

    Its type says that it is a difference, for which the offset of a unit does not count.
    """
    plain = alfmu.export(first_order("tool"), tmp_path / "plain.fmu", kind="native", reference=False)

    def described(name: str, data: bytes) -> bytes:
        if name != "modelDescription.xml":
            return data
        text = data.decode().replace('name="rad/s"', 'name="r/min"')
        text = text.replace('unit="rad/s"', 'declaredType="Change" unit="r/min"')
        change = '<SimpleType name="Change"><Real unit="r/min" relativeQuantity="true" /></SimpleType>'
        text = text.replace("<TypeDefinitions>", f"<TypeDefinitions>{change}")
        base = '<BaseUnit rad="1" s="-1"'
        assert base in text
        return text.replace(f"{base} />", f'{base} factor="0.10471975511965977" offset="7" />').encode()

    other = changed(plain, tmp_path / "tool.fmu", described)
    link = Connection("source.y", "tool.u")
    parts_ = {"source": first_order("source"), "tool": other}
    with pytest.raises(InputError, match='with convert = "rad/s -> r/min"'):
        System("mixed", parts_, [link], {"source.u": 1.0}).simulate(0.1, 0.05)
    link = Connection("source.y", "tool.u", convert="rad/s -> r/min")
    run = System("mixed", parts_, [link], {"source.u": 1.0}, master="iterated").simulate(1.0, 0.01)
    same = System("same", {**parts_, "tool": plain}, [("source.y", "tool.u")], {"source.u": 1.0}, master="iterated")
    assert run["tool.x"][-1] == pytest.approx(same.simulate(1.0, 0.01)["tool.x"][-1] * 30 / math.pi, rel=1e-9)


# Archives -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_ssp_runs_as_what_it_was_made_of(described, ssp):
    """FMUs in place of mechanisms: the same rows by each master, rewound states of FMUs included."""
    for master in MASTERS:
        made, read = (System.load(path).simulate(master=master) for path in (described, ssp))
        assert made.names == read.names
        differences = np.abs(made.values - read.values).max(axis=0) / (1 + np.abs(made.values).max(axis=0))
        assert {n: d for n, d in zip(made.names, differences, strict=True) if d > 1e-9 and "monitor" not in n} == {}
    assert alfmu.simulate(ssp).mechanism == "drive"


def test_an_ssp_has_what_the_system_has(described, ssp):
    system, found = System.load(described), System.load(ssp)
    assert (found.name, found.stop_time, found.communication_step, found.master) == ("drive", 0.4, 0.01, "held")
    assert [str(each) for each in found.connections] == [str(each) for each in system.connections]
    assert found.components["controller"].parameters["wanted"] == WANTED
    assert found.components["arm"].parameters["start.angle"] == 0.5
    assert found.components["arm"].units["A.torque"] == "N.m"


def test_an_ssp_is_valid_and_the_same_bytes(ssp, described, tmp_path):
    """By the schemas that come with fmpy."""
    again = System.load(described).export(tmp_path / "again.ssp")
    assert again.read_bytes() == ssp.read_bytes()
    description = read_ssd(str(ssp))
    assert {unit.name for unit in description.units} == {"N.m", "V", "rad/s"}
    values = {p.name: float(p.value) for p in read_ssv(str(ssp), "resources/controller.ssv").parameters}
    assert values == {"wanted": WANTED}


def test_ssp_2_is_told_apart(described, tmp_path):
    path = System.load(described).export(tmp_path / "two.ssp", version="2.0")
    assert b'version="2.0"' in zipfile.ZipFile(path).read("SystemStructure.ssd")
    assert len(System.load(path).components) == 3
    with pytest.raises(InputError, match=r"no SSP '3\.0'"):
        System.load(described).export(tmp_path / "three.ssp", version="3.0")


DTD = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<ssd:SystemS", DTD + "<ssd:SystemS", "declares a document type"),
        ("</ssd:System>", "", "is no XML"),
        ('version="1.0" name', 'version="7.0" name', "is of SSP '7.0'"),
        ("resources/arm.fmu", "../../arm.fmu", "is not a file in the archive"),
        ("resources/arm.fmu", "http://example.org/arm.fmu", "is not a file in the archive"),
        ("resources/arm.fmu", "SystemStructure.ssd", "is not an FMU"),
        ('name="motor" type', 'name="arm" type', "two components are called 'arm'"),
        ('name="motor" type', 'name="a b" type', "ends at 'motor'; it has arm, a b"),
        ('endElement="arm"', 'endElement="leg"', "ends at 'leg'"),
        ('endConnector="A.torque"', 'endConnector="B.torque"', "has no connector 'B.torque'"),
        ('kind="output"', 'kind="input"', "connects outputs to inputs"),
        ('unit="N.m"', 'unit="V"', "is in N.m and described in V"),
        ('stopTime="0.4"', 'stopTime="nan"', "must be a finite number"),
        ('algorithm="held"', 'algorithm="best"', "no master 'best'"),
        ('communicationStep="0.01"', 'communicationStep="-1"', "communication_step is -1"),
        ("<ssd:Component ", "<ssd:System ", "XML"),
        ('"application/x-fmu-sharedlibrary"', '"application/x-ssp-package"', "alfmu runs FMUs"),
    ],
)
def test_an_ssp_is_not_trusted(ssp, tmp_path, old, new, said):
    path = replaced(ssp, tmp_path / "bad.ssp", "SystemStructure.ssd", old, new)
    with pytest.raises((InputError, ExportError)) as raised:
        System.load(path).simulate(stop_time=0.01)
    assert said in str(raised.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        *(
            ('value="2"', f'value="{text}"', "the parameter wanted of the component")
            for text in ("nan", "1e999", "x", "")
        ),
        ("ssv:Real", "ssv:Boolean", "wanted of the component controller is '2'; a Boolean is true or false"),
        ('ssv:Real value="2"', 'ssv:Boolean value="true"', "wanted is True; it must be a value of type Real"),
        ('ssv:Real value="2"', 'ssv:Integer value="1.5"', "is '1.5'; an Integer is a whole number"),
    ],
)
def test_values_in_a_parameter_set_are_not_trusted(ssp, tmp_path, old, new, said):
    path = replaced(ssp, tmp_path / "bad.ssp", "controller.ssv", old, new)
    with pytest.raises(InputError) as raised:
        System.load(path).simulate(stop_time=0.01)
    assert said in str(raised.value)


def test_places_in_an_archive_are_uris(spindle_ssp, tmp_path):
    path = tmp_path / "blank.ssp"
    with zipfile.ZipFile(spindle_ssp) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            data = source.read(name)
            if name == "SystemStructure.ssd":
                data = data.replace(b"resources/load.fmu", b"resources/my%20load.fmu")
            target.writestr(name.replace("/load.fmu", "/my load.fmu"), data)
    assert System.load(path).components["load"].what == "resources/my load.fmu"


def test_an_archive_stays_in_its_folder(tmp_path):
    path = tmp_path / "out.ssp"
    with zipfile.ZipFile(path, "w") as target:
        target.writestr("../out.txt", "x")
    with pytest.raises(ExportError, match="a place outside its folder"):
        System.load(path)
    with pytest.raises(ExportError, match="is not an SSP that can be read"):
        System.load(tmp_path / "missing.ssp")


# Other tools ---------------------------------------------------------------------------------------------------------


def test_fmpy_gives_the_same_numbers(spindle_ssp):
    """fmpy begins with zeros on all connections, and writes the row of a step at its beginning."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the archive files that it leaves open
        theirs = simulate_ssp(str(spindle_ssp), stop_time=0.2 - 1e-9, step_size=1e-3)
    ours = System.load(spindle_ssp).simulate(held_rows=True)
    assert len(theirs) == 200
    for name in ("motor.speed", "load.speed", "gearbox.load_torque"):
        assert np.abs(theirs[name] - ours[name][1:]).max() <= SAME * (1 + np.abs(ours[name]).max())
    assert np.abs(ours["load.speed"]).max() > 0.5


def test_libcosim_gives_the_same_numbers(ssp):
    pytest.importorskip("libcosimpy.CosimEnums")
    found = ran_by(
        f"""
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimObserver import CosimObserver

        execution = CosimExecution.from_ssp_file({str(ssp)!r})
        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        execution.step(40)
        for name in NAMES:
            component, _, variable = name.partition(".")
            slave = execution.slave_index_from_instance_name(component)
            known = {{v.name.decode(): v.reference for v in execution.slave_variables(slave)}}
            print("is", observer.last_real_values(slave, [known[variable]])[0])
        """
    )
    agrees(found, System.load(ssp).simulate(held_rows=True))


def test_ecos_gives_the_same_numbers(ssp):
    """ecospy needs libtbb.so.12, of the system or of the package tbb, which is loaded before it."""
    if not importlib.util.find_spec("ecospy"):
        pytest.skip("ecospy is not installed")
    libraries = [f.locate() for f in tbb_files() if f.name == "libtbb.so.12"]
    try:
        for each in libraries[:1] or ["libtbb.so.12"]:
            ctypes.CDLL(str(each))
    except OSError:
        pytest.skip("ecospy needs libtbb.so.12, which is not here")
    found = ran_by(
        f"""
        import ctypes

        ctypes.CDLL({str((libraries or ["libtbb.so.12"])[0])!r}, mode=ctypes.RTLD_GLOBAL)
        from ecospy import EcosSimulation

        with EcosSimulation(ssp_path={str(ssp)!r}, step_size=0.01) as simulation:
            simulation.init(parameter_set="defaults")
            simulation.step(40)
            for name in NAMES:
                print("is", simulation.get_real(name.replace(".", "::", 1)))
        """
    )
    agrees(found, System.load(ssp).simulate())


def tbb_files() -> list:
    try:
        return list(importlib.metadata.files("tbb") or [])
    except importlib.metadata.PackageNotFoundError:
        return []


NAMES = ("arm.link1.angle", "motor.torque", "controller.output", "controller.integral")


def ran_by(text: str) -> list[float]:
    """Numbers that another tool prints, in a process of its own."""
    code = f"NAMES = {NAMES!r}\n" + textwrap.dedent(text)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr[-2000:]
    return [float(line.split()[1]) for line in done.stdout.splitlines() if line.startswith("is ")]


def agrees(found: list[float], run: alfmu.Result) -> None:
    wanted = np.array([run[name][-1] for name in NAMES])
    assert len(found) == len(wanted)
    assert np.abs(np.array(found) - wanted).max() <= SAME
    assert np.abs(wanted).min() > 0.1


# Commands ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_commands(described, tmp_path, monkeypatch, capsys):
    shutil.copytree(described.parent, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    assert (
        main(["system", "drive.toml", "--set", "controller.wanted=1", "--master", "iterated", "--plot", "a.png"]) == 0
    )
    run = alfmu.Result.from_csv("drive.csv")
    assert run["arm.link1.angle"][-1] < System.load("drive.toml").simulate()["arm.link1.angle"][-1] - 0.1
    assert run.units["motor.torque"] == "N.m"
    assert Path("a.png").stat().st_size > 10_000
    assert main(["export", "--ssp", "drive.toml", "-o", "made.ssp"]) == 0
    assert main(["system", "made.ssp", "--stop-time", "0.1", "-o", "b.csv"]) == 0
    assert len(alfmu.Result.from_csv("b.csv").time) == 11
    assert "3 components" in capsys.readouterr().out
    assert main(["export", "--ssp", "drive.toml", "--kind", "native"]) == 1
    assert "--kind is for an FMU" in capsys.readouterr().err
    assert main(["system", "nothing.toml"]) == 1
    assert "cannot read nothing.toml" in capsys.readouterr().err


# Kinds of FMUs -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_components_that_take_no_rates_hold_the_mean(tmp_path):
    """FMUs of FMI 3 and of kind python, connected to each other: order 2 all the same."""
    a = alfmu.export(first_order("a"), tmp_path / "a.fmu", kind="native", fmi=3, reference=False)
    b = alfmu.export(first_order("b"), tmp_path / "b.fmu", reference=False)
    links = [("a.y", "b.u"), Connection("b.y", "a.u", factor=-4.0, offset=1.0)]
    system = System("pair", {"a": a, "b": b}, links, stop_time=1.0, start_time=0.0)
    exact = solve_ivp(
        lambda t, x: [-4 * x[1] + 1 - x[0], x[0] - x[1]], (0, 1), [0, 0], method="DOP853", rtol=1e-12, atol=1e-14
    ).y[:, -1]
    steps = 0.1 / 2.0 ** np.arange(4)
    given = {f"{name}.solver.relative_tolerance": 1e-11 for name in "ab"}
    for master in ("extrapolated", "iterated"):
        runs = [system.simulate(master=master, communication_step=h, parameters=given) for h in steps]
        errors = [max(abs(run["a.x"][-1] - exact[0]), abs(run["b.x"][-1] - exact[1])) for run in runs]
        assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2, abs=0.15)


@pytest.mark.slow
def test_a_switch_and_choices_of_an_fmu_are_exchanged(tmp_path):
    """A Boolean input, an enumeration and a number of an FMU that alfmu did not make for this system."""
    locked = alfmu.Recipe("slider_crank", kind="native", lock=["A"], reference=False, name="arm")
    path = alfmu.export(locked, tmp_path / "arm.fmu")
    arm = Component(
        "arm", "fmu", path, parameters={"A.locked": 1.0, "solver.method": "rk4", "solver.max_iterations": 7.0}
    )
    system = System("held", {"arm": arm}, [], stop_time=0.2, communication_step=0.05)
    made = System.load(system.export(tmp_path / "held.ssp"))
    assert made.components["arm"].parameters == {"A.locked": 1.0, "solver.method": "rk4", "solver.max_iterations": 7.0}
    run = made.simulate()
    assert np.ptp(run["arm.crank.angle"]) < 1e-9
    free = system.changed(components={"arm": path}).simulate()
    assert np.ptp(free["arm.crank.angle"]) > 1e-2


COUNTER = """
from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer


class Counter(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.add, self.hold, self.count, self.even, self.most = 1, False, 0, True, 9
        for kind, name, causality in (
            (Integer, "add", "input"), (Boolean, "hold", "input"), (Integer, "count", "output"),
            (Boolean, "even", "output"), (Integer, "most", "parameter"),
        ):
            start = {} if causality == "output" else {"start": getattr(self, name)}
            discrete = Fmi2Variability.tunable if causality == "parameter" else Fmi2Variability.discrete
            self.register_variable(kind(name, causality=Fmi2Causality[causality], variability=discrete, **start))

    def do_step(self, current_time, step_size):
        self.count = min(self.count + (0 if self.hold else self.add), self.most)
        self.even = self.count % 2 == 0
        return True
"""


@pytest.fixture(scope="module")
def counter(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU of another tool without numbers that change continuously."""
    folder = tmp_path_factory.mktemp("counter")
    (folder / "counter.py").write_text(COUNTER)
    return FmuBuilder.build_FMU(folder / "counter.py", dest=folder)


def test_whole_numbers_and_booleans_of_fmus_are_connected(counter):
    """The second counts by what the first has counted, and rests while that is even."""
    links = [("a.count", "b.add"), ("a.even", "b.hold")]
    system = System("pair", {"a": counter, "b": counter}, links, {"a.add": 1}, 5.0, 1.0)
    run = system.simulate(inputs={"a.hold": (np.array([0.0, 3.0, 3.0, 5.0]), np.array([0.0, 0.0, 1.0, 1.0]))})
    assert run["a.count"].tolist() == [0, 1, 2, 3, 3, 3]
    assert run["a.even"].tolist() == [1, 0, 1, 0, 0, 0]
    assert run["b.count"].tolist() == [0, 0, 1, 1, 4, 7]
    with pytest.raises(InputError, match="of a cannot save its state"):
        system.simulate(master="iterated")


@pytest.mark.parametrize("value", [2.7, 3e9, math.inf, True])
def test_a_whole_number_is_not_cut(counter, value):
    with pytest.raises(InputError, match=r"most is .*; it must be a value of type Integer"):
        System("one", {"a": counter}, []).simulate(1.0, 1.0, parameters={"a.most": value})


def test_damaged_descriptions_are_refused(ssp, tmp_path):
    """Bytes changed by chance: read, or refused with a sentence, and never anything else."""
    text = zipfile.ZipFile(ssp).read("SystemStructure.ssd")
    others = {name: zipfile.ZipFile(ssp).read(name) for name in zipfile.ZipFile(ssp).namelist() if ".ssv" in name}
    rng, refused = np.random.default_rng(5), 0
    for _ in range(300):
        data = bytearray(text)
        for place in rng.integers(0, len(data), 3):
            data[place] = rng.integers(0, 256)
        cut = slice(*sorted(rng.integers(0, len(data), 2))) if rng.random() < 0.3 else slice(0, 0)
        del data[cut]
        path = tmp_path / "bad.ssp"
        with zipfile.ZipFile(path, "w") as target:
            target.writestr("SystemStructure.ssd", bytes(data))
            for name in ("arm", "motor", "controller"):
                target.writestr(f"resources/{name}.fmu", b"")
            for name, other in others.items():
                target.writestr(name, other)
        try:
            System.load(path)
        except AlfmuError:
            refused += 1
    assert 100 < refused <= 300
