"""Sizes of the C that `alfmu export --kind source` writes, as a table: `python scripts/source_sizes.py`.

It needs ziglang, which compiles for x86-64 and for a Cortex-M7, and `size` from binutils.
"""

import re
import subprocess
import tempfile
from pathlib import Path

import alfmu
from alfmu.fmi.source import facts
from alfmu.runtime.build import zig

SMALL = {"outputs": ["link1.angle", "A.force.x"], "freeze": ["all"]}
ROWS = {
    **{name: ({}, name) for name in sorted(alfmu.mechanisms())},
    "small": (SMALL, "five_bar, an angle and a reaction, all frozen"),
    "least": (
        {**SMALL, "parameters": {"solver.branch": "paper"}, "stop_time": 2.0},
        "the same, not through singular positions (`--set solver.branch=paper`)",
    ),
}
"""Exports by their names in the table."""

FLAGS = ["-std=c99", "-Os", "-fno-unwind-tables"]
TARGETS = (["-target", "x86_64-linux-musl"], ["-target", "thumb-linux-musleabihf", "-mcpu=cortex_m7"])


def size(path: Path, target: list[str]) -> float:
    """Return the size of code and tables [kB]."""
    made = path.with_suffix(".o")
    command = [*(zig() or []), *FLAGS, *target, "-c", str(path), "-o", str(made)]
    subprocess.run(command, check=True)
    done = subprocess.run(["size", str(made)], capture_output=True, text=True, check=True)
    text, data = map(int, done.stdout.splitlines()[1].split()[:2])
    return (text + data) / 1000


def main() -> None:
    print(
        "| Mechanism | code and tables, x86-64 [kB] | Cortex-M7 [kB] | memory [kB] | operations, as a rule | at most |"
    )
    print("|---|---|---|---|---|---|")
    for key, (given, said) in ROWS.items():
        name = key if key in alfmu.mechanisms() else "five_bar"
        with tempfile.TemporaryDirectory() as folder:
            path = alfmu.export(alfmu.Recipe(name, kind="source", **given), Path(folder) / f"{name}.c")
            text = " ".join(facts(path))
            numbers = [re.search(what, text)[1] for what in (r"(\d+) bytes of memory", r": (\d+) operations")]
            most = re.search(r"(\d+) at most$|at most (\d+) in each", text)
            sizes = (f"{size(path, target):.0f}" for target in TARGETS)
            per = " an internal step" if most[2] else ""
            cells = [said, *sizes, f"{int(numbers[0]) / 1000:.0f}", numbers[1], f"{most[1] or most[2]}{per}"]
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
