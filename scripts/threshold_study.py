"""Sensitivity to each threshold of singular positions and of the start: runs with half and with twice its value.

Each variant runs in a separate process, which sets the constant before anything is traced and, if C uses it too, builds
its own runtime. `--write` puts the figures between two markers of `docs/singular.md`. The other columns of that table
are the constants themselves and their docstrings.
"""

import argparse
import ast
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

# Only a variant imports the modules of alfmu that read the constants, after it has set one.
SHARED = ("casadi", "matplotlib.figure", "scipy.integrate", "tqdm")
"""Modules imported before variants are forked, as all of them need these."""

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))  # Cases and exact motions are those of tests.
PAGE = ROOT / "docs" / "singular.md"
BEGIN, END = "<!-- thresholds: begin -->", "<!-- thresholds: end -->"
MODULES = ("method.singular", "method.friction", "method.stepping", "kernel.thresholds")
SOME = {"method.stepping": ("SHARE",)}
"""Constants to study, for modules that have others, too."""

FACTORS = {"half": 0.5, "twice": 2.0}
FAR = {"a hundredth": 0.01, "a hundredfold": 100.0}
"""Factors of `--far`, which detect constants without any effect."""

SAME = "same"
"""Result of a variant whose runs equal those of the default to the last bit."""

ROUGHLY = 0.02
"""Relative change up to which an error or a number of evaluations counts as unchanged."""


@dataclass(frozen=True)
class Threshold:
    """A constant of one of the modules, with its docstring."""

    module: str
    name: str
    value: float | int | tuple[float, ...]
    noun: str
    unit: str
    why: str

    def times(self, factor: float) -> float | int | tuple[float, ...]:
        """Return the value times a factor; an integer stays an integer, at least 1."""
        if isinstance(self.value, tuple):
            return tuple(factor * x for x in self.value)
        return max(1, round(factor * self.value)) if isinstance(self.value, int) else factor * self.value

    @property
    def shown(self) -> str:
        """The value as shown in the page."""
        return ", ".join(f"{x:g}" for x in (self.value if isinstance(self.value, tuple) else (self.value,)))

    @property
    def row(self) -> str:
        """The cells of its row in the page that come from the module."""
        return f"| `{self.name}` | {self.shown} | {self.unit} | {self.noun}: {self.why} |"


FORM = re.compile(r"(?P<noun>[^\[\]]+) \[(?P<unit>[^\]]+)\]: (?P<why>.+)", re.S)
"""The form of a constant's docstring."""


def thresholds(modules: Sequence[str] = MODULES) -> list[Threshold]:
    """Return the constants of the modules in their order; raise ValueError if a docstring has another form."""
    found = []
    for module in modules:
        values = vars(import_module(f"alfmu.{module}"))
        body = ast.parse((ROOT / "alfmu" / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8")).body
        for line, after in pairwise(body):
            name = line.targets[0].id if isinstance(line, ast.Assign) and isinstance(line.targets[0], ast.Name) else ""
            counts = name.isupper() and name in SOME.get(module, (name,))
            if not counts or not isinstance(values[name], int | float | tuple):
                continue
            text = ast.literal_eval(after.value) if isinstance(after, ast.Expr) else ""
            parts = FORM.fullmatch(" ".join(text.split()))
            if not parts:
                raise ValueError(f"alfmu.{module}.{name}: its docstring is not `noun [unit]: why`: {text!r}")
            found.append(Threshold(module, name, values[name], **parts.groupdict()))
    return found


# Cases ------------------------------------------------------------------------------------------------------------


class Found(NamedTuple):
    """Result of a case: its error and its number of evaluations."""

    error: float
    evaluations: int


GRAVITY, SPEED = 9.81, 2.0
"""Gravity [m/s2], and speed [rad/s] of the linkages that start in their singular position."""

FIVE_BAR = {"A.torque": 3.0, "D.torque": -1.0}
ROW_START = (math.pi / 2, -1.0)
CRANK_START, CRANK_STEP, LINK = (math.pi / 4, 0.0), 0.00125, 0.5
"""Starts of the N-four-bar and the slider-crank [rad, rad/s], its step [s] and the length of its links [m]."""

STARTS = 50
"""Number of starts of the four-bar."""


def phases() -> list[tuple[float, float, float]]:
    """Return random starting angles [rad] of the four-bar, with cyclic speeds [rad/s] and torques [N.m]."""
    import numpy as np

    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, STARTS).tolist()
    torques, speeds = (4.0, 2.0, 1.0, -3.0, 8.0), (2.0, 2.0, 0.5)
    return [(x, speeds[k % 3], torques[k % 5]) for k, x in enumerate(angles)]


def references(cases: Sequence[str]) -> dict[str, Any]:
    """Return the exact angles for these cases; they depend on no constant of the modules."""
    if set(cases) <= set(RUBBING):
        return {}
    import numpy as np
    from oracles import ode
    from oracles.parallelogram import Parallelogram

    five, four = Parallelogram(), Parallelogram(m4=None)

    def times(stop: float, dt: float) -> Any:
        return np.linspace(0.0, stop, round(stop / dt) + 1)

    def row(_: float, y: Any) -> list[float]:
        """(4 N + 1) / 3 m l^2 th'' = -(3 N + 1) / 2 m g l cos th, for N = 2 loops."""
        return [y[1], -7 / 2 * GRAVITY * math.cos(y[0]) / 3]

    def crank(_: float, th: float, w: float) -> float:
        """The rod of equal length mirrors the crank: its centre is at l (3/2 cos th, 1/2 sin th), the slider at
        2 l cos th, which gives J th'' + J' th'^2 / 2."""
        s, c = math.sin(th), math.cos(th)
        J = LINK**2 * (1 / 3 + 1 / 12 + 9 / 4 * s**2 + c**2 / 4 + 4 * s**2)
        return (-GRAVITY * LINK * c - 6 * LINK**2 * s * c * w**2) / J

    return {
        "five-bar": five.driven(0.0, SPEED, times(5.0, 0.02), sum(FIVE_BAR.values()))[:, 0],
        "starts": [four.driven(th, w, times(2.5, 0.02), torque)[:, 0] for th, w, torque in phases()],
        "slider-crank": ode.motion(crank, *CRANK_START, times(2.0, 0.05))[:, 0],
        "order 8": four.driven(0.0, SPEED, times(5.0, 0.1), 4.0)[:, 0],
        "auto": four.driven(0.0, SPEED, times(5.0, 0.01), 4.0)[:, 0],
        "row": ode.solved(row, ROW_START, times(10.0, 0.1), rtol=1e-13, most=0.005)[:, 0],
    }


def _equations(mechanism: Any, **wanted: float | str) -> Any:
    """Return the scene of a mechanism, given by itself or its name, for the interpreter with these solver variables."""
    import alfmu
    from alfmu.simulation import prepared, with_defaults

    made = alfmu.load(mechanism) if isinstance(mechanism, str) else mechanism
    values = {f"solver.{name}": value for name, value in ({"method": "rk4"} | wanted).items()}
    return prepared(with_defaults(alfmu.derive(made), values), "vm")


def _started(equations: Any, given: Mapping[str, float]) -> Any:
    """Return an initialised instance with these values."""
    import alfmu

    i = alfmu.Instance(equations)
    for name, value in given.items():
        i.set(name, value)
    i.initialize()
    return i


def _followed(equations: Any, exact: Any, dt: float, angle: float, speed: float, torques: Mapping[str, float]) -> Found:
    """Step a linkage from a start under constant torques; return the largest error [rad] of its angle th1."""
    given = {"g": GRAVITY, "start.angle": angle, "start.angular_velocity": speed, **torques, "solver.step_size": dt}
    i = _started(equations, given)
    crank = [c.name for c in equations.coordinates].index("th1")
    worst = abs(i.q[crank] - exact[0])
    for k, wanted in enumerate(exact[1:]):
        i.step(dt, k * dt)
        worst = max(worst, abs(i.q[crank] - wanted))
    return Found(float(worst), i.counters.evaluations)


def _driven(exact: Any, name: str, torques: Mapping[str, float], dt: float, method: str = "rk4") -> Found:
    """Run a linkage from its singular start over 5 s with steps of dt [s]; return the error [rad] of its angle."""
    return _followed(_equations(name, method=method), exact, dt, 0.0, SPEED, torques)


def _row(exact: Any) -> Found:
    """Run a row of two four-bars in absolute coordinates over 10 s at 1e-9; return the error [rad] at the end."""
    import alfmu

    m = alfmu.load("n_four_bar", loops=2, coordinates="absolute")
    given = {"start.angle": ROW_START[0], "start.angular_velocity": ROW_START[1], "g": GRAVITY}
    i = _started(_equations(m, method="explicit", relative_tolerance=1e-9), given)
    for _ in exact[1:]:
        i.step(0.1)
    return Found(abs(float(i.get("crank1.angle")) - exact[-1]), i.counters.evaluations)


def _pressed(_: Any) -> Found:
    """Run a slider-crank whose light rod presses the slider against a stiff stop for 0.3 s; return the error [rad, m]
    of its coordinates, compared with implicit steps at 1e-11."""
    given = {"l1": 0.9034, "l2": 6.178, "m1": 218.8, "m2": 1.994e-4, "m3": 1.753, "radius": 0.0711, "stop": 1.639}
    given |= {"stiffness": 2.145e7, "dissipation": 0.8229, "onset": 5.549e-5}
    given |= {"start.angle": -0.1684, "start.angular_velocity": -1.781}
    ends = []
    for wanted in ({"method": "stiff", "relative_tolerance": 1e-11}, {"method": "auto"}):
        i = _started(_equations("end_stop", **wanted), given)
        for _ in range(30):
            i.step(0.01)
        ends.append(i.q)
    return Found(float(abs(ends[1] - ends[0]).max()), i.counters.evaluations)


def _starts(exact: Any) -> Found:
    """Run the four-bar from random starts over 2.5 s with steps of 0.02 s; return the largest error [rad], infinite if
    a run stops."""
    import alfmu

    equations, runs = _equations(alfmu.load("four_bar", coordinates="mixed")), []
    for (th, w, torque), wanted in zip(phases(), exact, strict=True):
        try:
            runs.append(_followed(equations, wanted, 0.02, th, w, {"A.torque": torque}))
        except alfmu.AlfmuError:
            runs.append(Found(math.inf, 0))
    return Found(max(run.error for run in runs), sum(run.evaluations for run in runs))


def _crank(exact: Any) -> Found:
    """Run the slider-crank of equal links in natural coordinates over 2 s with steps of 0.00125 s; return the error
    [rad] of its crank."""
    import alfmu

    given = {"l1": LINK, "l2": LINK, "start.angle": CRANK_START[0], "start.angular_velocity": CRANK_START[1]}
    given |= {"solver.step_size": CRANK_STEP, "g": GRAVITY}
    equations = _equations(alfmu.load("slider_crank", coordinates="natural"))
    r = alfmu.simulate(equations, 2.0, 0.05, parameters=given, kernel="vm")
    return Found(float(abs(r["crank.angle"] - exact).max()), r.counters.evaluations)


def _read(_: Any, torque: float) -> Found:
    """Return the error [N] of the four-bar's finite reactions at B, 1e-6 to 0.02 rad from its singular position."""
    import numpy as np

    import alfmu
    from alfmu.studies.paper import Parallelogram

    exact, worst = Parallelogram(m4=0.0, torque=torque), 0.0
    equations = _equations(alfmu.load("four_bar", coordinates="mixed"))
    for distance in (1e-6, 1e-4, 1e-3, 4e-3, 0.02):
        i = _started(equations, {"start.angle": distance, "A.torque": torque, "g": GRAVITY})
        forces = exact.multipliers(np.array([distance]), np.array([SPEED]))[:, 0]
        rows = (2,) if torque else (1, 2)  # With a torque the first one has a pole.
        worst = max(worst, *(abs(i.get(f"multiplier[{k}]") - forces[k - 1]) for k in rows))
    return Found(float(worst), 0)


def _locked(_: Any) -> Found:
    """Run a point into the cusp of y^2 = x^3; return the error [s] of the time of the lock-up."""
    from scenes import cusp

    i = _started(_equations(cusp()), {"solver.step_size": 0.005})
    return _ended(lambda: i.step(1.0), "locked up", (13**1.5 - 8) / 27 / math.hypot(1.0, 1.5))


def _ended(run: Callable[[], object], why: str, exact: float) -> Found:
    """Return the error [s] of the time at which a run ends with an error for this reason."""
    import alfmu

    try:
        run()
    except alfmu.AlfmuError as error:
        time = re.search(rf"t = (\S+) s: {why}", str(error))
        if time:
            return Found(abs(float(time[1]) - exact), 0)
        raise
    raise alfmu.StepError(f"the run is not reported to end: {why}")


def _assembled(_: Any) -> Found:
    """Assemble a four-bar linkage from 100 poor guesses; return the share of refused ones."""
    import casadi as ca
    import numpy as np

    import alfmu

    m = alfmu.Mechanism("loop")
    a = m.coordinate("a", "rad", start=1.0, independent=True)
    b, c = m.coordinate("b", "rad", start=0.0), m.coordinate("c", "rad", start=1.0)
    m.kinetic_energy(sum(m.rate(x) ** 2 for x in (a, b, c)) / 2)
    m.constraint("x", 0.3 * ca.cos(a) + 1.0 * ca.cos(b) - 0.8 * ca.cos(c) - 1.1, "m")
    m.constraint("y", 0.3 * ca.sin(a) + 1.0 * ca.sin(b) - 0.8 * ca.sin(c), "m")
    m.output("angle", c, "rad")
    equations, refused = _equations(m, method="auto"), 0
    for angle in np.random.default_rng(1).uniform(-np.pi, np.pi, 100):
        try:
            with warnings.catch_warnings(action="ignore", category=alfmu.AlfmuWarning):  # about the poor guesses
                _started(equations, {"start.a": float(angle)})
        except alfmu.AlfmuError:
            refused += 1
    return Found(refused / 100, 0)


def _regular(_: Any, name: str, stop: float) -> Found:
    """Run a mechanism without a singular position; return its position error and its number of evaluations."""
    import alfmu

    r = alfmu.simulate(_equations(name), stop, stop)
    return Found(float(r.counters.position_error), r.counters.evaluations)


def _prescribed(_: Any) -> Found:
    """Run a four-bar with a crank law from its singular start over 4 s; return the error [N m] of the torque."""
    import casadi as ca
    import numpy as np

    import alfmu

    m = alfmu.Mechanism("prescribed")
    th = m.coordinate("th", "rad")
    x, y = m.coordinate("x", "m", start=ca.cos(th) + 0.5), m.coordinate("y", "m", start=ca.sin(th))
    crank, rocker = (m.bar(name, mass=1.0, length=1.0) for name in ("crank", "rocker"))
    coupler = m.bar("coupler", mass=1.0, length=1.0, pose=(x, y, m.coordinate("turn", "rad")))
    A = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=th)
    m.revolute("D", m.ground.at(1, 0), rocker.start, coordinate=m.coordinate("ph", "rad", start=th))
    m.revolute("B", crank.end, coupler.start)
    m.revolute("C", rocker.end, coupler.end)
    m.gravity(0.0, -9.81)
    m.motion(A, 2 * m.time + 0.5 * ca.sin(m.time))
    run = alfmu.simulate(_equations(m), 4.0, 0.02)
    t = run.time
    exact = -5 / 6 * np.sin(t) + 2 * 9.81 * np.cos(2 * t + 0.5 * np.sin(t))
    return Found(float(np.abs(run["A.torque"] - exact).max()), run.counters.evaluations)


def _beside(_: Any, name: str) -> Found:
    """Run a parallelogram of the tests, on a shaking base or with a rotor, from rest; return the error [rad]."""
    import test_moving_base as moving

    import alfmu

    law, acceleration = moving.BASES["5 Hz"]
    if name == "shaken":
        m, torque = moving.on_base(law, "absolute"), 40.0
        exact = moving.crank_on_base(acceleration, torque, [0.0, 0.0], 1.0)
    else:
        m, torque = moving.with_rotor("absolute", 30.0), 1.0
        exact = moving.crank_with_rotor(30.0, torque, [0.0, 0.0], 1.0)
    r = alfmu.simulate(_equations(m, step_size=1e-3), 1.0, 0.02, inputs={"A.torque": torque})
    return Found(float(abs(r["bar1.angle"] - exact).max()), r.counters.evaluations)


def _rubs(_: Any, name: str) -> Found:
    """Run a mechanism of the tests with dry friction; return the error of the quantity that the test checks."""
    import numpy as np
    import test_friction as rubbing
    import test_rubbing_motions as moved
    from oracles.rubbing import Crank

    import alfmu

    def run(m: Any, stop: float, dt: float, **given: float) -> Any:
        parameters = {"solver.relative_tolerance": 1e-9, **given}
        return alfmu.simulate(alfmu.derive(m), stop, dt, parameters=parameters)

    if name == "belt":
        r = run(moved.belt("law"), 3.0, 0.05)
        error = np.abs(r["block.x"] - moved.on_a_belt(r.time)).max()
    elif name == "near jam":
        k = 4.9 / 5.0
        c = k / math.sqrt(1 - k**2)
        r = run(rubbing.rotor(), 2.0, 0.02, g=0.0, mu=4.9, aside=0.1)
        error = np.abs(r["disc.angular_velocity"] * (1 + c * 20.0 * r.time) / 20.0 - 1).max()
    elif name == "wedge":
        least = rubbing.pushed(0.15, 0.2, 1.0)
        mass = rubbing.pushed(0.15, 0.2, 1.0, 1.0) - least
        r = run(rubbing.wedge(), 1.5, 0.01, growth=50.0)
        error = np.abs(r["wedge.position"] - 50.0 * np.maximum(r.time - least / 50.0, 0.0) ** 3 / 6 / mass).max()
    elif name == "crank rubs":
        of = rubbing.L1, rubbing.L2, *rubbing.MASSES, rubbing.MU, rubbing.RADII, rubbing.EDGES
        times = np.arange(101) * 0.01
        exact, _ = Crank(*of, lambda t: 6.5 * math.sin(4.0 * t)).run(0.7, 9.0, times)
        r = run(rubbing.crank(6.5), 1.0, 0.01)
        error = np.abs(r["crank.angle"] - exact[0]).max()
    elif name == "dwell":
        r = run(moved.dwell(), 2.0, 0.05)
        error = np.abs(r["A.torque"] - moved.torque_of_dwell(r)).max()
    elif name == "jam":
        return _ended(lambda: run(moved.pressing(), 1.0, 0.01, speed=2.0), "a jam", (moved.JAM - 3.4) / 2.0)
    else:
        r = run(rubbing.pentagon(), 2.0, 0.01)
        error = r["monitor.step_error"].max()
    return Found(float(error), r.counters.evaluations)


RUBBING = ("belt", "near jam", "wedge", "crank rubs", "dwell", "jam", "pentagon")
"""Cases with dry friction, used for constants of friction only."""

CASES: dict[str, Callable[[Any], Found]] = {
    "five-bar": partial(_driven, name="five_bar", torques=FIVE_BAR, dt=0.02),
    "starts": _starts,
    "slider-crank": _crank,
    "order 8": partial(_driven, name="four_bar", torques={"A.torque": 4.0}, dt=0.1, method="order8"),
    "auto": partial(_driven, name="four_bar", torques={"A.torque": 4.0}, dt=0.01, method="auto"),
    "row": _row,
    "pressed": _pressed,
    "reading": partial(_read, torque=0.0),
    "pole": partial(_read, torque=4.0),
    "lock-up": _locked,
    "assembly": _assembled,
    "bennett": partial(_regular, name="bennett", stop=0.4),
    "governor": partial(_regular, name="flyball_governor", stop=0.01),
    "prescribed": _prescribed,
    **{name: partial(_beside, name=name) for name in ("shaken", "rotor")},
    **{name: partial(_rubs, name=name) for name in RUBBING},
}
"""Cases by their names in the page."""

DECIDING = (
    *("LAW_PASSES", "LAW_ENOUGH", "JAM_SETTLED", "JAM_PIVOT", "REST", "MOVING", "STOPPED", "NEARLY_STOPPED"),
    *("EXCEEDED", "IDLE", "IDLER", "SHARING_ROUNDS", "STEADY_SHARE", "NO_ROOM", "SLIDING_ROUNDS", "SEARCHED"),
    *("RIGHT_THERE", "SEEN_BETWEEN"),
)
"""Constants that decide between sticking and sliding."""

OF_FRICTION = (*DECIDING, "SLOW_STEP", "LOOKED_INTO", "AT_ONCE", "JAM_AHEAD", "JAM_SHORTER", "ONE_STEP", "EARLIEST")
"""Constants that affect mechanisms with dry friction only."""

SLOW = {
    "bennett": ("ASIDE", "FAR_RATIO", "REGULAR", "RANKED"),
    "governor": ("ASIDE", "FAR_RATIO", "SMALL_PIVOT", "REGULAR_PRODUCT", "BRANCH_MARGIN"),
    "prescribed": ("FROZEN", "LATER"),
    **dict.fromkeys(("shaken", "rotor"), ("FROZEN", "AWAY", "BESIDE", "SERVES", "TOO_NEAR")),
    **dict.fromkeys(("crank rubs", "pentagon"), DECIDING),
}
"""Constants for which a case is run, if it is slow to derive or concerns only these."""


def about(name: str, case: str) -> bool:
    """Return whether a case is run for a constant."""
    if (name in OF_FRICTION) != (case in RUBBING):
        return False
    return case not in SLOW or name in SLOW[case]


def _own_runtime() -> None:
    """Build and use a runtime with the constants of this process if they differ from the library's."""
    from alfmu.kernel.tables import layout_header
    from alfmu.runtime import library

    source = ROOT / "alfmu" / "runtime"
    header = layout_header()
    if header == (source / "c" / "core" / "layout.h").read_text(encoding="utf-8"):
        return
    with tempfile.TemporaryDirectory(prefix="alfmu_thresholds_") as made:
        folder = Path(made)
        shutil.copytree(source / "c", folder / "c")
        # Optimisation takes longer than the runs, and changes no number.
        script = re.sub('"-O[2s]"', '"-O0"', (source / "build.py").read_text(encoding="utf-8"))
        (folder / "build.py").write_text(script, encoding="utf-8")
        (folder / "c" / "core" / "layout.h").write_text(header, encoding="utf-8")
        subprocess.run([sys.executable, folder / "build.py"], check=True, capture_output=True)
        loaded = library.library(folder)
    library.library = lambda: loaded


def variant(changed: tuple[str, str, Any], exact: Mapping[str, Any], cases: Sequence[str]) -> dict[str, Found | str]:
    """Return the results of cases with one constant changed (name, module, value), or the message of a stopped case."""
    name, module, value = changed
    if module:
        setattr(import_module(f"alfmu.{module}"), name, value)
        from alfmu.method import singular

        singular.MEAN, singular.READ_MEAN = singular.weights(singular.PLACES), singular.weights(singular.LONG_PLACES)
    _own_runtime()
    from alfmu.model.errors import AlfmuError

    found: dict[str, Found | str] = {}
    for case in cases:
        if module and not about(name, case):
            continue
        try:
            found[case] = CASES[case](exact.get(case))
        except AlfmuError as error:
            found[case] = str(error)
    return found


# The table --------------------------------------------------------------------------------------------------------


def compared(found: Mapping[str, Found | str], usual: Mapping[str, Found | str]) -> str:
    """Return the effect of a change as text: the largest ratios of errors and evaluations, with their cases."""
    if all(x == usual[case] for case, x in found.items()):
        return SAME
    stopped = [case for case, x in found.items() if isinstance(x, str) and not isinstance(usual[case], str)]
    if stopped:
        return f"stops: {', '.join(stopped)}"
    parts = []
    for what in Found._fields:
        ratios = {}
        for case, x in found.items():
            if isinstance(x, Found) and isinstance(usual[case], Found):
                before, after = getattr(usual[case], what), getattr(x, what)
                ratios[case] = after / before if before else math.inf if after else 1.0
        for case, ratio in (max(ratios.items(), key=lambda x: x[1]), min(ratios.items(), key=lambda x: x[1])):
            if abs(ratio - 1) > ROUGHLY:
                parts.append(f"{what} x {ratio:.3g} ({case})")
    return "; ".join(parts) or f"within {100 * ROUGHLY:g} %"


def measured(page: str) -> dict[str, list[str]]:
    """Return the cells of the page by the name of the constant, one for each factor."""
    rows = re.findall(r"^\| `(\w+)` \|.*\| ([^|]+) \| ([^|]+) \|$", page.split(BEGIN)[1].split(END)[0], re.M)
    return {name: list(cells) for name, *cells in rows}


def table(rows: Mapping[str, Sequence[str]]) -> str:
    """Return the tables of the page: the constants in the modules, and the measured `rows` by name."""
    lines = []
    for module in MODULES:
        lines += [f"`alfmu.{module}`:", "", "| Name | Value | Unit | Why | Half | Twice |", "|---|---|---|---|---|---|"]
        lines += [f"{x.row} {' | '.join(rows.get(x.name, ['-'] * len(FACTORS)))} |" for x in thresholds([module])]
        lines.append("")
    return "\n".join(lines)


def write(cells: Mapping[str, Sequence[str]]) -> None:
    """Put the present constants and the measured cells into the page; other cells stay."""
    page = PAGE.read_text(encoding="utf-8")
    head, tail = page.split(BEGIN)[0], page.split(END)[1]
    PAGE.write_text(f"{head}{BEGIN}\n{table({**measured(page), **cells})}{END}{tail}", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the constants selected on the command line."""
    parser = argparse.ArgumentParser(description="Halve and double each threshold, and compare errors and evaluations.")
    parser.add_argument("--only", nargs="*", metavar="NAME", help="some of the constants; without a name none")
    parser.add_argument("--cases", nargs="+", metavar="CASE", choices=CASES, help="some of the runs")
    parser.add_argument("--far", action="store_true", help="by factors of 100 instead")
    parser.add_argument("--write", action="store_true", help="put the figures into docs/singular.md")
    chosen = parser.parse_args(arguments)
    if chosen.write and (chosen.far or chosen.cases):
        parser.error("--write takes all cases, and half and twice")
    from alfmu.model.cache import VARIABLE

    os.environ[VARIABLE] = "off"  # cached scenes contain the constants of the code
    factors = FAR if chosen.far else FACTORS
    wanted = [x for x in thresholds() if chosen.only is None or x.name in chosen.only]
    jobs = [("", "", None), *((x.name, x.module, x.times(f)) for x in wanted for f in factors.values())]
    cells: dict[str, list[str]] = {}
    if wanted:
        for name in SHARED:
            import_module(name)
        with get_context("fork").Pool(os.cpu_count(), maxtasksperchild=1) as pool:
            cases = [case for case in chosen.cases or CASES if any(about(x.name, case) for x in wanted)]
            run = partial(variant, exact=pool.apply(references, (cases,)), cases=cases)
            results = pool.imap(run, jobs)
            usual = next(results)
            for case, x in usual.items():
                print(f"{case}: {x}")
            for (name, _, value), found in zip(jobs[1:], results, strict=True):
                cells.setdefault(name, []).append(compared(found, usual))
                print(name, value, cells[name][-1], sep=" | ", flush=True)
    if chosen.write:
        write(cells)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
