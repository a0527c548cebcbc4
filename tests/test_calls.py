"""Every call that declares something, with arguments that are missing, misspelt, too many, or nonsense."""

import inspect
import math
from collections.abc import Callable, Iterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import casadi as ca
import pytest

import alfmu
from alfmu import Experiment, Mechanism, parts
from alfmu.analysis.linearization import figure
from alfmu.model.content import content
from alfmu.parts import blocks


def workshop() -> SimpleNamespace:
    """A mechanism with a part of each kind, and what is not joined yet."""
    m = Mechanism("shop")
    arm, cart = m.bar("arm", mass=1.0, length=1.0), m.body("cart", mass=1.0)
    wheel = m.body("wheel", mass=1.0, inertia=0.1)
    th, s = m.coordinate("th"), m.coordinate("s", "m")
    A = m.revolute("A", m.ground.at(), arm.start, coordinate=th)
    G = m.prismatic("G", m.ground.at(), cart.at(), coordinate=s)
    m.revolute("W", m.ground.at(1, 0), wheel.at(), coordinate=m.coordinate("w"))
    box = m.spatial_body("box", mass=1.0, inertia=(1, 1, 1), relative=True)
    at, axis = m.spatial_ground.at(), (0, 0, 1)
    C = m.cylindrical("C", at, box.at(), axis=axis, coordinates=[m.coordinate("turn"), m.coordinate("way", "m")])
    free = m.spatial_body("free", mass=1.0, inertia=(1, 1, 1))
    plane = {"name": "n", "first": m.ground.at(), "second": m.body("loose", mass=1.0).at()}
    wheels = {"name": "n", "first": arm.start, "second": wheel.at()}
    space = {"name": "n", "first": at, "second": free.at()}
    given = {
        "start": m.start("begin", 0.1),
        "state": m.state("x", "1"),
        "drawn": [m.drawn_joint(x, (0, 0, 0)) for x in "PQ"],
    }
    return SimpleNamespace(**locals())


GOOD: dict[str, Callable[[SimpleNamespace], dict[str, Any]]] = {
    "parameter": lambda x: {"name": "n", "default": 1.0},
    "start": lambda x: {"name": "n"},
    "tie": lambda x: {"start": x.given["start"], "expression": x.th},
    "coordinate": lambda x: {"name": "n"},
    "rate": lambda x: {"coordinate": x.th},
    "acceleration": lambda x: {"coordinate": x.th},
    "input": lambda x: {"name": "n", "unit": "N"},
    "state": lambda x: {"name": "n", "unit": "A"},
    "derivative": lambda x: {"state": x.given["state"], "rate": 1.0},
    "output": lambda x: {"name": "n", "expression": x.th},
    "watch": lambda x: {"name": "n", "marker": x.arm.end},
    "trace": lambda x: {"name": "n", "marker": x.arm.end},
    "measure": lambda x: {},
    "event": lambda x: {"time": 1.0},
    "measured_joints": lambda x: {},
    "measured_springs": lambda x: {},
    "body": lambda x: {"name": "n", "mass": 1.0},
    "bar": lambda x: {"name": "n", "mass": 1.0, "length": 1.0},
    "point": lambda x: {"x": 1.0, "y": 0.0},
    "gravity": lambda x: {"x": 0.0, "y": -9.81},
    "spatial_body": lambda x: {"name": "n", "mass": 1.0, "inertia": (1, 1, 1)},
    "revolute": lambda x: {**x.plane, "coordinate": x.th},
    "prismatic": lambda x: {**x.plane, "coordinate": x.s},
    "weld": lambda x: x.plane,
    "point_on_line": lambda x: x.plane,
    "distance": lambda x: {**x.plane, "length": 1.0},
    "spherical": lambda x: x.space,
    **{
        name: lambda x: {**x.space, "axis": x.axis}
        for name in ("spatial_revolute", "cylindrical", "spatial_prismatic", "planar")
    },
    "spatial_screw": lambda x: {**x.space, "axis": x.axis, "lead": 0.1},
    "universal": lambda x: {**x.space, "axis": x.axis, "second_axis": (1, 0, 0)},
    "spatial_weld": lambda x: x.space,
    "spare": lambda x: {"of": x.m.spherical("loop", x.at, x.box.at())},
    "gear": lambda x: {**x.wheels, "radii": (0.5, 0.5)},
    "belt": lambda x: {**x.wheels, "radii": (0.1, 0.1)},
    "rack": lambda x: {"name": "n", "pinion": x.wheel.at(), "guide": x.G, "radius": 0.1, "side": "left"},
    "rolling": lambda x: {"name": "n", "line": x.m.ground.at(), "wheel": x.wheel.at(), "radius": 0.1},
    "cam": lambda x: {
        **{"name": "n", "cam_centre": x.wheel.at(), "follower": x.cart.at()},
        **{"distance": lambda t: 0.5 + 0.01 * ca.cos(t), "roller": 0.01},
    },
    "blade": lambda x: {"name": "n", "at": x.cart.at()},
    "spatial_rolling": lambda x: {"name": "n", "plane": x.at, "centre": x.free.at(), "radius": 0.1},
    "relations": lambda x: {},
    "drive": lambda x: {"joint": x.A, "effort": 1.0},
    "force": lambda x: {"at": x.arm.end, "x": 1.0},
    "torque": lambda x: {"body": x.arm, "torque": 1.0},
    "spring_damper": lambda x: {"between": x.A, "stiffness": 1.0},
    "end_stop": lambda x: {"name": "n", "of": x.A, "upper": 1.0, "stiffness": 100.0},
    "friction": lambda x: {"joint": x.A, "coulomb": 0.1, "radius": 0.1},
    "drawn_joint": lambda x: {"name": "n", "at": (0, 0, 0)},
    "kinetic_energy": lambda x: {"expression": x.m.rate(x.th) ** 2},
    "potential_energy": lambda x: {"expression": x.th**2},
    "generalized_force": lambda x: {"coordinate": x.th, "expression": 1.0},
    "constraint": lambda x: {"name": "n", "expression": x.s - 1},
    "compliances": lambda x: {},
    "lock": lambda x: {"of": x.A},
    "motion": lambda x: {"of": x.A, "law": 2 * x.m.time},
    "clutch": lambda x: {"name": "n", "first": x.m.ground, "second": x.arm},
    "lock_displacement": lambda x: {"name": "n", "expression": x.th},
    "release": lambda x: {"of": x.m.weld("closed", x.arm.end, x.cart.at())},
    "declared_at": lambda x: {"name": "arm"},
    "drawn_bar": lambda x: {"name": "n"},
    "draw": lambda x: {},
}
"""Arguments with which each method of a mechanism declares something; of some the nonsense alone is tried."""

_MOTOR = {"voltage": 1.0, "resistance": 1.0, "inductance": 1e-3, "constant": 0.1}

OTHERS: dict[str, tuple[Callable[..., Any], Callable[[SimpleNamespace], dict[str, Any]]]] = {
    "Mechanism": (Mechanism, lambda x: {"name": "n"}),
    "Experiment": (Experiment, lambda x: {}),
    "dc_motor": (parts.dc_motor, lambda x: {"m": x.m, "name": "n", "joint": x.A, **_MOTOR}),
    "load": (parts.load, lambda x: {"m": x.m, "name": "n", "joint": x.A, "inertia": 0.1}),
    "pi_controller": (
        parts.pi_controller,
        lambda x: {"m": x.m, "name": "n", "wanted": 1.0, "measured": x.th, "gain": 1.0, "time": 1.0},
    ),
    **{f"blocks.{name}": (block, lambda x: {}) for name, block in blocks.BLOCKS.items()},
}
"""The same of other calls."""

OF_PARTS: dict[str, tuple[Callable[[SimpleNamespace], Callable[..., Any]], dict[str, Any]]] = {
    "Body.at": (lambda x: x.arm.at, {}),
    "SpatialBody.at": (lambda x: x.box.at, {}),
    "SpatialJoint.freedom": (lambda x: x.C.freedom, {"which": "angle"}),
}
"""The same of methods of parts."""

NONSENSE: dict[str, Any] = {
    **{"None": None, "a text": "nonsense", "nan": math.nan, "an object": object(), "a list": [], "a truth": True},
    **{"a number": -7.5, "numbers": (1, "a", None), "symbols": ca.SX.sym("foreign", 2), "a function": lambda: 1 / 0},
    "a mechanism": Mechanism("other"),
}


def called(name: str, x: SimpleNamespace) -> tuple[Callable[..., Any], dict[str, Any]]:
    """A call with good arguments."""
    if name in GOOD:
        return getattr(x.m if name != "draw" else alfmu.load("slider_crank"), name), GOOD[name](x)
    if name in OTHERS:
        return OTHERS[name][0], OTHERS[name][1](x)
    return OF_PARTS[name][0](x), OF_PARTS[name][1]


def changes(name: str) -> Iterator[tuple[str, Callable[[dict[str, Any]], Any], tuple[Any, ...]]]:
    """What is tried of a call: its description, a change of the good arguments, and arguments by place."""
    takes = inspect.signature(called(name, workshop())[0]).parameters
    for argument, p in takes.items():
        if argument == "m":
            continue
        for what, value in NONSENSE.items():
            if p.kind is p.VAR_POSITIONAL:
                yield f"{what} for {argument}", lambda given: given.clear(), ("n", value)
            else:
                yield f"{argument} is {what}", lambda given, a=argument, v=value: given.update({a: v}), ()
        if p.default is p.empty and p.kind is not p.VAR_POSITIONAL:
            yield f"{argument} is missing", lambda given, a=argument: given.pop(a), ()
    yield "misspelt", lambda given: given.update(nonsens=1), ()
    numbers = tuple(range(30 * ("m" not in takes)))
    yield "too many", lambda given: [given.pop(x) for x in [*given] if x != "m"], numbers


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::alfmu.AlfmuWarning")
@pytest.mark.parametrize("name", [*GOOD, *OTHERS, *OF_PARTS])
def test_nonsense_is_answered_in_words(name):
    """Nothing of Python's own comes out, and what is said is a sentence of the mechanism."""
    said, x, before = {}, None, None
    for what, change, more in changes(name):
        if x is None:
            x = workshop()
            call, good = called(name, x)
            mechanism = good.get("m", getattr(call, "__self__", None))
            if before is None and isinstance(mechanism, Mechanism):
                before = content(mechanism)  # which is that of all, as they are made alike
        given = dict(good)
        change(given)
        try:
            call(*more, **given)
            x = None  # what has declared something is not called again
        except alfmu.AlfmuError as error:
            said[what] = str(error)
            assert before is None or content(mechanism) == before, f"{name}: {what} is refused and leaves something"
        except Exception as error:
            pytest.fail(f"{name}: {what}: {type(error).__name__}: {error}")
    assert {"misspelt", "too many"} <= said.keys()
    assert not {what: text for what, text in said.items() if len(text) < 20 or "cannot use its arguments" in text}


@pytest.mark.filterwarnings("ignore::alfmu.AlfmuWarning")
@pytest.mark.parametrize(
    ("call", "given"),
    [
        ("parameter", {"default": math.nan}),
        ("start", {"rate": math.nan}),
        ("coordinate", {"rate": 1.0}),
        ("coordinate", {"independent": True, "rate": math.nan}),
        ("input", {"derivatives": 2, "order": 7}),
        ("state", {"nominal": 0.0}),
        ("state", {"rate": math.nan}),
        ("output", {"expression": math.nan}),
        ("watch", {"marker": 5}),
        ("constraint", {"expression": ca.SX.sym("foreign")}),
        ("weld", {"second": 5}),
    ],
)
def test_what_was_refused_can_be_declared_right_by_the_same_name(call, given):
    x, right = workshop(), workshop()
    with pytest.raises(alfmu.DeclarationError):
        getattr(x.m, call)(**{**GOOD[call](x), **given})
    getattr(x.m, call)(**GOOD[call](x))
    getattr(right.m, call)(**GOOD[call](right))
    assert content(x.m) == content(right.m)


def test_a_joint_refused_after_an_input_moved_its_point_leaves_the_point_as_it_was():
    m = Mechanism("shop")
    point = m.ground.at(m.input("s", "m"), 0.0)
    with pytest.raises(alfmu.DeclarationError, match="joint A connects ground to itself"):
        m.weld("A", point, m.ground.at())
    assert not m.signals
    assert not m.moves
    m.weld("A", point, m.body("cart", mass=1.0).at())
    assert [signal.input.name for signal in m.signals] == ["s"]


def test_a_part_of_several_declarations_that_is_refused_leaves_none_of_them():
    x = workshop()
    before = content(x.m)
    with pytest.raises(alfmu.DeclarationError):
        parts.load(x.m, "n", x.A, damping=0.1, opposing=math.nan)
    assert content(x.m) == before


def test_every_public_call_is_tried():
    of_mechanism = {name for name, _ in inspect.getmembers(Mechanism, inspect.isfunction) if not name.startswith("_")}
    assert of_mechanism == set(GOOD)
    assert {name for name in parts.__all__ if inspect.isfunction(getattr(parts, name))} <= set(OTHERS)


def test_what_a_call_declares_has_the_good_arguments():
    """They are good, so that nonsense in one place is what is refused."""
    for name, good in GOOD.items():
        x = workshop()
        if name not in ("draw", "drawn_bar"):
            getattr(x.m, name)(**good(x))
    for call, good in OTHERS.values():
        call(**good(workshop()))
    for call, good in OF_PARTS.values():
        call(workshop())(**good)


def test_an_error_of_the_inside_is_kept_as_the_cause():
    with pytest.raises(alfmu.DeclarationError, match=r"shop: motion\(\) of A lacks law") as caught:
        workshop().m.motion("A")
    assert isinstance(caught.value.__cause__, TypeError)


def test_the_damping_of_a_motor_without_a_shaft_is_refused():
    with pytest.raises(
        alfmu.DeclarationError, match=r"the damping of a motor without inertia is 0\.1; .* give it an inertia"
    ):
        blocks.motor(damping=0.1)
    assert blocks.motor(damping=0.1, inertia=1e-4).states


@pytest.mark.parametrize("size", [3, (640,), (0, 480), (640.0, 480), "large"])
def test_the_size_of_a_picture_is_two_numbers_of_pixels(size):
    with pytest.raises(alfmu.InputError, match=r"the size of a picture is .*; give two, as \(640, 480\) pixels"):
        alfmu.load("slider_crank").draw(size=size)


ANALYSES: list[tuple[Callable[[Any], Any], str]] = [
    (lambda x: x.lin.save(5), r"slider_crank: save\(\): path is 5; give a text or a Path"),
    (lambda x: x.lin.save(), r"slider_crank: save\(\) lacks path; it takes path"),
    (lambda x: x.lin.save("a.txt"), r"a.txt: the name of a file for linearisations must end in .json or .mat"),
    (lambda x: x.lin.plot(5), r"path is 5; give a text or a Path, or leave it out"),
    (lambda x: x.lin.film(5), r"slider_crank: film\(\): path is 5; give a text or a Path"),
    (lambda x: x.lin.film("a.gif", 7), "slider_crank: there is no mode 7; it has 2 modes"),
    (lambda x: x.lin.film("a.gif", modes=1), r"film\(\) of a.gif takes no modes; did you mean mode\?"),
    (lambda x: x.lin.film("a.gif", amplitude="x"), r"film\(\) of a.gif: amplitude is 'x'; give a number"),
    (lambda x: x.rest.save(5), r"slider_crank: save\(\): path is 5; give a text or a Path"),
    (lambda x: x.rest.save("a.mat"), r"a.mat: the name of a file for positions of rest must end in .json"),
    (lambda x: x.rest[0].draw(size=3), r"the size of a picture is 3; give two"),
    (lambda x: x.freedoms.save(None), r"slider_crank: save\(\): path is None; give a text or a Path"),
    (lambda x: figure([]), r"figure\(\) is given no linearisation; give one or more"),
    (lambda x: figure([3]), r"figure\(\): found is \[3\]; give several, each a Linearization"),
    *(
        (
            partial(lambda x, at: alfmu.linearize("slider_crank", at), at=at),
            r"slider_crank: at is .*; it must be start, e",
        )
        for at in (None, "middle", -1.0, math.nan, [], [0.1, "x"], object())
    ),
]


@pytest.fixture(scope="module")
def analysed() -> SimpleNamespace:
    """What analyses of the slider-crank come to."""
    lin, rest = alfmu.linearize("slider_crank"), alfmu.equilibrium("slider_crank")
    return SimpleNamespace(lin=lin, rest=rest, freedoms=alfmu.mobility("slider_crank", stop_time=0))


@pytest.mark.parametrize("asked", range(len(ANALYSES)))
def test_nonsense_asked_of_an_analysis_is_answered_in_words(analysed, asked, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, says = ANALYSES[asked]
    with pytest.raises(alfmu.InputError, match=says):
        call(analysed)
    assert not list(tmp_path.iterdir())
