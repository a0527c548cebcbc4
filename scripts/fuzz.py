"""Call every function of native FMUs in legal and illegal order, under sanitizers.

Runs `tests/native_fuzz.c` on several scenes. Prints for each run its seed, the number of calls by status and the
longest call, and at the end the total; returns 1 if a sanitizer reported an error, a call did not return, or a status
was wrong.
"""

import argparse
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import fmpy

import alfmu
from alfmu import parts
from alfmu.runtime import build

SOURCE = Path(__file__).parents[1] / "tests" / "native_fuzz.c"

HEADERS = Path(fmpy.__file__).parent / "c-code"
"""Folder of the FMI headers."""

CHECKS = {
    "address": ("-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"),
    "thread": ("-fsanitize=thread",),
}
"""Compiler flags of sanitizers, by what they check."""

MOST_STEPS = 2000
"""Largest number of internal steps of one call, so that long steps are refused quickly."""

PATIENCE = 3600
"""Time limit of a run [s]; a single call may take a minute."""


def locked() -> alfmu.Mechanism:
    m = alfmu.load("five_bar")
    m.lock("B")
    m.release("E")
    m.release("F")
    return m


@dataclass(frozen=True)
class Case:
    """A scene to fuzz."""

    mechanism: Callable[[], alfmu.Mechanism]
    parameters: dict[str, float | str] = field(default_factory=dict)
    outputs: list[str] | None = None
    share: int = 1
    """Share of all calls; scenes with slow calls have less."""


RK4 = {"solver.method": "rk4"}
"""Avoids error control, which tries a failing step up to a million times: too slow with sanitizers."""


def motor() -> alfmu.Mechanism:
    """Return a slider-crank with a motor and a controller, which have first-order states."""
    m = alfmu.load("slider_crank", coordinates="joint")
    voltage = parts.pi_controller(
        m, "speed", wanted=m.input("wanted", "rad/s"), measured=m.rate(m.coordinates[0].q), gain=1.0, time=0.5
    )
    data = {"resistance": 1.0, "inductance": 0.01, "constant": 0.1, "inertia": 1e-3}
    parts.dc_motor(m, "motor", m.joints[0], voltage=voltage, gearbox=parts.Gearbox(ratio=10.0), **data)
    return m


CASES = {
    "five_bar": Case(lambda: alfmu.load("five_bar"), RK4, share=4),
    "locks": Case(locked, RK4, share=4),
    "extrapolated": Case(lambda: alfmu.load("slider_crank"), {**RK4, "solver.input_order": 2}, share=4),
    "auto": Case(lambda: alfmu.load("four_bar")),
    "explicit": Case(lambda: alfmu.load("four_bar"), {"solver.method": "explicit"}),
    "states": Case(motor),
    "jacobian": Case(locked, RK4, ["*", "link1.angle/*", "B.force.x/D.torque"], share=2),
    "order8": Case(lambda: alfmu.load("particle_on_circle"), {"solver.method": "order8"}, share=2),
    "stiff": Case(lambda: alfmu.load("flexible_four_bar"), {"solver.method": "stiff"}),
    "trapezoidal": Case(lambda: alfmu.load("particle_on_circle"), {"solver.method": "trapezoidal"}, share=2),
}


def built(name: str, fmi: int, folder: Path, watched: str, runtime: Path) -> list[str]:
    """Return the command that runs the fuzzer on a scene, without seed, calls and threads: program and arguments.

    The program contains the object files of a folder `runtime`, which `compiled` has made.
    """
    case = CASES[name]
    path = folder / f"{name}_{fmi}.fmu"
    how = {"parameters": case.parameters, "outputs": case.outputs}
    alfmu.export(case.mechanism(), path, kind="native", fmi=fmi, reference=False, **how)
    place, program = path.with_suffix(""), path.with_suffix(f".{watched}")
    with zipfile.ZipFile(path) as archive:
        archive.extractall(place)
    host = [f"-DFUZZ_FMI={fmi}", f"-I{HEADERS}", str(SOURCE), *objects(runtime, fmi)]
    subprocess.run([*compiling(watched), *host, "-lm", "-pthread", "-o", str(program)], check=True)
    described = fmpy.read_model_description(str(path))
    variables = [v for v in described.modelVariables if v.causality != "independent"]
    real = {
        k: [v.valueReference for v in variables if v.causality == k and v.type in ("Real", "Float64")] for k in KINDS
    }
    ranges = [str(x) for k in KINDS for x in first_run(real[k])]
    return [str(program), described.guid, str(len(variables)), *ranges]


def compiling(watched: str) -> list[str]:
    """Return the command of the compiler with sanitizers."""
    flags = ["-std=gnu99", "-g", "-O0", "-Wall", "-Wextra", "-Werror", f"-DMOST_STEPS={MOST_STEPS}"]
    return [*build.compiler(), *flags, *CHECKS[watched]]


def compiled(folder: Path, watched: str) -> Path:
    """Compile the runtime with sanitizers into a folder, and return it: all features, for every scene and version."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [str(path) for path in build.sources() if path.suffix == ".c"]
    command = [*compiling(watched), *build.including(), "-fPIC", "-ffp-contract=off", "-c", *files]
    subprocess.run(command, cwd=folder, check=True)
    return folder


def objects(runtime: Path, fmi: int) -> list[str]:
    """Return the object files of a version of FMI, or of Python (0), in a folder that `compiled` has made."""
    return [str(runtime / f"{path.stem}.o") for path in build._files(build.HERE, fmi)]


KINDS = ("input", "output")


def first_run(references: Sequence[int]) -> tuple[int, int]:
    """Return the first number, and the length of the run of consecutive numbers from it."""
    count = 0
    while count < len(references) and references[count] == references[0] + count:
        count += 1
    return (references[0] if references else 0), count


def fuzzed(command: Sequence[str], seed: int, calls: int, threads: int) -> tuple[int, str]:
    """Return the number of calls of a fuzzer run (0 if it found an error), and its output."""
    program, guid, *told = command
    given = [program, guid, str(seed), str(calls), str(threads), *told]
    try:
        done = subprocess.run(given, capture_output=True, text=True, check=False, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return 0, f"seed {seed}: no end after {PATIENCE} s"
    said = done.stdout + done.stderr[-3000:]
    made = next((int(word) for word, unit in zip(said.split(), said.split()[1:], strict=False) if unit == "calls,"), 0)
    good = done.returncode == 0 and made >= calls
    return (made if good else 0), said.strip() or f"seed {seed}: ended by signal {-done.returncode}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=1_000_000, help="in all (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the first run (default: %(default)s)")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), help="some of the scenes")
    given = parser.parse_args(arguments)
    shares = {name: CASES[name].share for name in given.only}
    total, failed = 0, 0
    with tempfile.TemporaryDirectory(prefix="alfmu_") as folder:
        runtimes = {watched: compiled(Path(folder, watched), watched) for watched in CHECKS}
        for name, share in shares.items():
            for fmi in (2, 3):
                for watched, threads, part in (("address", 1, 0.9), ("thread", 4, 0.1)):
                    calls = int(given.calls * share / sum(shares.values()) / 2 * part) + 1
                    made, said = fuzzed(
                        built(name, fmi, Path(folder), watched, runtimes[watched]), given.seed, calls, threads
                    )
                    print(f"{name}, {watched}: {said}", flush=True)
                    total, failed = total + made, failed + (not made)
    print(f"{total} calls without a report, {failed} runs with one")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
