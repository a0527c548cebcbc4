"""Chains of bodies at random places in the words of MJCF, SDF and URDF, written side by side."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

Numbers = tuple[float, ...]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
PITCH = 0.3
"""Way of a screw in a turn [m]."""


@dataclass(frozen=True)
class Part:
    """A link, and the joint that carries it: its kind is that of SDF, its frame stands in the link at `at`."""

    name: str
    parent: str
    kind: str
    place: Numbers
    angles: Numbers
    at: Numbers = (0.0,) * 6
    axis: Numbers = Z
    axis2: Numbers = X
    reverse: bool = False
    damping: Numbers = (0.0, 0.0)
    stiffness: float = 0.0
    rest: float = 0.0
    mass: float = 1.0
    center: Numbers = (0.0, 0.0, 0.0)
    moments: Numbers = (0.02, 0.03, 0.04)
    follows: tuple[str, float, float] | None = None


def parts(kinds: list[str], seed: int, at: float = 0.0) -> list[Part]:
    """A chain from the world on; `at` is how far joints are from the origins of links."""
    rng = np.random.default_rng(seed)
    found, parent = [], "world"
    for i, kind in enumerate(kinds):
        x = rng.normal(size=12).round(3).tolist()
        place = (0.3 + 0.1 * x[0], 0.1 * x[1], 0.1 * x[2])
        turned = (*(at * np.array(x[3:6])).tolist(), *(5 * at * np.array(x[6:9])).tolist())
        found.append(
            Part(
                f"l{i}", parent, kind.removeprefix("-"), place, tuple(x[9:12]), turned,
                axis=(0.6, 0.0, 0.8) if i % 2 else (0.0, 0.6, -0.8), axis2=Y if i % 2 else X,
                reverse=kind.startswith("-"), damping=(0.1 * (i + 1), 0.25), mass=0.5 + 0.1 * i,
                center=(0.05 * x[3], 0.1, 0.05 * x[4]),
                stiffness=2.0 + i if kind.endswith(("revolute", "prismatic")) and at else 0.0, rest=0.2 if at else 0.0,
            )
        )  # fmt: skip
        parent = f"l{i}"
    return found


def text(numbers: Numbers) -> str:
    return " ".join(f"{x:.15g}" for x in numbers)


def sdf(chain: list[Part], more: str = "") -> str:
    """The model, in a world without other things."""
    said = ""
    for p in chain:
        inertia = "".join(f"<i{a}{a}>{x}</i{a}{a}>" for a, x in zip("xyz", p.moments, strict=True))
        relative = f' relative_to="{p.parent}"' if p.parent != "world" else ""
        said += (
            f'<link name="{p.name}"><pose{relative}>{text(p.place + p.angles)}</pose><inertial><mass>{p.mass}</mass>'
            f"<pose>{text(p.center)} 0 0 0</pose><inertia>{inertia}</inertia></inertial></link>"
        )
        mimic = ""
        if p.follows:
            values = zip(("multiplier", "offset"), p.follows[1:], strict=True)
            mimic = f'<mimic joint="{p.follows[0]}">{"".join(f"<{k}>{x}</{k}>" for k, x in values)}</mimic>'
        axes = ""
        for tag, axis, damping in (("axis", p.axis, p.damping[0]), ("axis2", p.axis2, p.damping[1])):
            if tag == "axis" or p.kind == "universal":
                axes += (
                    f"<{tag}><xyz>{text(axis)}</xyz><dynamics><damping>{damping}</damping><spring_stiffness>"
                    f"{p.stiffness}</spring_stiffness><spring_reference>{p.rest}</spring_reference></dynamics>"
                    f"{mimic}</{tag}>"
                )
        pitch = f"<screw_thread_pitch>{PITCH}</screw_thread_pitch>" if p.kind == "screw" else ""
        ends = (p.name, p.parent) if p.reverse else (p.parent, p.name)
        said += (
            f'<joint name="{p.name}j" type="{p.kind}"><pose relative_to="{p.name}">{text(p.at)}</pose>'
            f"<parent>{ends[0]}</parent><child>{ends[1]}</child>{axes if p.kind != 'ball' else ''}{pitch}</joint>"
        )
    return f'<sdf version="1.9"><model name="chain">{said}{more}</model></sdf>'


def urdf(chain: list[Part], more: str = "") -> str:
    """Joints stand at the origins of links here."""
    said = '<link name="world"/>'
    for p in chain:
        inertia = " ".join(f'i{a}{b}="{x}"' for a, b, x in (*((a, a, x) for a, x in zip("xyz", p.moments, strict=True)),
                                                           ("x", "y", 0), ("x", "z", 0), ("y", "z", 0)))  # fmt: skip
        said += (
            f'<link name="{p.name}"><inertial><origin xyz="{text(p.center)}"/><mass value="{p.mass}"/>'
            f'<inertia {inertia}/></inertial></link><joint name="{p.name}j" type="{p.kind}"><parent link="{p.parent}"/>'
            f'<child link="{p.name}"/><origin xyz="{text(p.place)}" rpy="{text(p.angles)}"/>'
            f'<axis xyz="{text(p.axis)}"/><dynamics damping="{p.damping[0]}"/>'
            '<limit lower="-9" upper="9" effort="99" velocity="99"/></joint>'
        )
    return f'<robot name="chain">{said}{more}</robot>'


def mjcf(chain: list[Part], ends: dict[str, str] | None = None, more: str = "") -> str:
    """The same for MuJoCo; `ends` is what further stands in bodies, by name."""
    said, equal = "", more
    for p in chain:
        joints, more_equal = _joints(p)
        equal += more_equal
        said += (
            f'<body name="{p.name}" pos="{text(p.place)}" euler="{text(p.angles)}">{joints}'
            f'<inertial pos="{text(p.center)}" mass="{p.mass}" diaginertia="{text(p.moments)}"/>'
            f"{(ends or {}).get(p.name, '')}"
        )
    return (
        '<mujoco><compiler angle="radian" eulerseq="XYZ"/><option gravity="0 0 {}"><flag contact="disable"/></option>'
        f"<worldbody>{said}{'</body>' * len(chain)}</worldbody><equality>{equal}</equality></mujoco>"
    )


def _joints(p: Part) -> tuple[str, str]:
    """Joints of MuJoCo that are the joint, about axes of its frame at `at`, and what couples them."""
    turn = Rotation.from_euler("xyz", p.at[3:]).as_matrix()
    # A joint from child to parent: the parent moves the other way in the child, the second turn first.
    sign = -1 if p.reverse else 1
    axes = [(sign * turn @ np.array(axis), d) for axis, d in zip((p.axis, p.axis2), p.damping, strict=True)]

    def one(name: str, kind: str, axis: np.ndarray, damping: float = 0.0) -> str:
        spring = f'stiffness="{p.stiffness}" springref="{p.rest}"' if damping else ""
        return (
            f'<joint name="{name}" type="{kind}" pos="{text(p.at[:3])}" axis="{text(tuple(axis))}" '
            f'damping="{damping}" {spring}/>'
        )

    name = f"{p.name}j"
    equal = ""
    if p.follows:
        factor, offset = p.follows[1:]
        equal = f'<joint joint1="{name}" joint2="{p.follows[0]}" polycoef="{offset} {factor} 0 0 0"/>'
        name = f"{p.name}_follows"
        equal = equal.replace(f"{p.name}j", name)
    if p.kind == "universal":
        both = reversed(axes) if p.reverse else axes
        return "".join(one(f"{name}_angle{i}", "hinge", *axis) for i, axis in enumerate(both, 1)), equal
    if p.kind == "screw":
        equal += f'<joint joint1="{name}_way" joint2="{name}" polycoef="0 {PITCH / 2 / np.pi} 0 0 0"/>'
        return one(name, "hinge", *axes[0]) + one(f"{name}_way", "slide", axes[0][0]), equal
    if p.kind == "fixed":
        return "", ""
    return one(name, {"prismatic": "slide"}.get(p.kind, "hinge"), *axes[0]), equal


def nearly(chain: list[Part], other: Numbers) -> Numbers:
    """Where a frame of the last link stands in the first one where all coordinates are zero, to a digit."""
    turn, place = Rotation.identity(), np.zeros(3)
    for p in chain[1:]:
        place = place + turn.apply(p.place)
        turn = turn * Rotation.from_euler("xyz", p.angles)
    place, turn = place + turn.apply(other[:3]), turn * Rotation.from_euler("xyz", other[3:])
    return tuple(np.round([*place, *turn.as_euler("xyz")], 1).tolist())


def closing(
    kind: str, ends: tuple[str, str], frames: tuple[Numbers, Numbers], axes: tuple[Numbers, Numbers], zero: bool
) -> tuple[dict[str, str], str]:
    """What closes a loop between two links, in MuJoCo: a body of hardly any mass on joints, which is welded.

    The frames of the joint coincide where its own coordinates are zero, or (`zero`) where those of the links are.
    """
    joints, equal = _joints(Part("loop", ends[0], kind, (), (), axis=axes[0], axis2=axes[1], damping=(0.0, 0.0)))
    joints = "" if kind == "ball" else joints
    tiny = '<inertial pos="0 0 0" mass="1e-13" diaginertia="1e-13 1e-13 1e-13"/>' if joints else ""
    one, other = (
        f'<body name="{name}" pos="{text(at[:3])}" euler="{text(at[3:])}">'
        for name, at in zip("io", frames, strict=True)
    )
    weld = f'<weld body1="i" body2="o" {"" if zero else RELPOSE}/>'
    if kind == "ball":
        weld = '<connect body1="i" body2="o" anchor="0 0 0"/>' if zero else '<connect site1="is" site2="os"/>'
    i, o = ('<site name="is"/>', '<site name="os"/>') if kind == "ball" else ("", "")
    return {ends[0]: f"{one}{joints}{tiny}{i}</body>", ends[1]: f"{other}{o}</body>"}, weld + equal


RELPOSE = 'relpose="0 0 0 1 0 0 0"'
