"""The singular benchmark: which codes pass singular positions, with what error, in what time.

Ten problems (`docs/singular_benchmark`) are run by every installed code, each pair in a separate process with a time
limit. Writes `results.csv`, a picture and tables into a folder; `--write` puts them into the page, and `--references`
remakes problems and exact motions.
"""

import argparse
import csv
import importlib
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from _singular_codes import CATALOGUE, CODES, Found, Simulation, declared, given
from _singular_problems import FOLDER, PROBLEMS, Motion, Problem, loaded, table, write_reference
from matplotlib.figure import Figure
from numpy.typing import NDArray

import alfmu
from alfmu.studies.tables import Cell, Row, environment, markdown, rounded, write_csv

BRANCH, OPEN, CLOSE = 0.05, 1e-3, 0.1
"""Distance [m] from the nearest position on the branch, gap [m] of a closure, and error [m], above which a run has left
its branch, has opened its loops, or is inaccurate."""

LIMIT, LONG, BRIEF = 30.0, 300.0, 0.2
"""Limits of processor time [s] for a problem, and for the row of 1000 loops; runs below the last number are
repeated."""

QUICK = ("particle", "five_bar", "kite"), ("alfmu", "SciPy")
OWN = [name for name in CODES if name.startswith("alfmu")]
LOST, DONE = ("left the branch", "loops open"), ("ok", "inaccurate")
BEGIN, END = "<!-- results: begin -->", "<!-- results: end -->"

# One code on one problem ------------------------------------------------------------------------------------------


def branch_of(problem: Problem, motion: Motion) -> NDArray:
    """Return the points (g, m, 3) at many positions on the branch."""
    with np.errstate(invalid="ignore"):
        points = motion.geometry(np, list(motion.grid))[1]
    shape = motion.grid[0].shape
    found = np.zeros((len(motion.grid[0]), len(points), 3))
    for i, point in enumerate(points):
        for j, x in enumerate(point):
            found[:, i, j] = np.broadcast_to(np.asarray(x, float), shape)
    return found[np.isfinite(found).all((1, 2))]


def errors(problem: Problem, found: Found, reference: dict[str, NDArray], branch: NDArray) -> dict[str, float]:
    """Return the errors of a run: points, distance from the branch, gaps of loops, force."""
    k, m = len(found.places), len(problem.points)
    axes = "xy" if problem.planar else "xyz"
    exact = np.zeros((k, m, 3))
    for i, name in enumerate(problem.points):
        for j, axis in enumerate(axes):
            exact[:, i, j] = reference[f"{name}.{axis}"][:k]
    seen, sides = found.places[:, :m], found.places[:, m:]
    gaps = np.linalg.norm(sides[:, 1::2] - sides[:, ::2], axis=2) - [c.length or 0.0 for c in problem.seen]
    off = [np.linalg.norm(branch - x, axis=2).max(1).min() for x in seen]
    row = {"error [m]": float(np.linalg.norm(seen - exact, axis=2).max(initial=0.0))}
    row |= {"off the branch [m]": float(max(off, default=0.0)), "gap [m]": float(np.abs(gaps).max(initial=0.0))}
    if found.forces is not None and "force.x" in reference:
        wanted = np.column_stack([reference["force.x"], reference["force.y"]])[:k]
        kept = np.isfinite(wanted)
        row["force error [N]"] = float(np.abs(found.forces[:, 0, :2] - wanted)[kept].max(initial=0.0))
    return row


def measured(name: str, code: str) -> None:
    """Print the rows of a code on a problem as lines of JSON, the coarsest setting first."""
    problem, references, chosen = loaded(name), table(name), CODES[code]
    branch = branch_of(problem, PROBLEMS[name]()[1])
    base: Row = {"problem": name, "code": code}

    def judge(simulate: Simulation, value: float, again: int, number: int) -> Row:
        seconds, kept, stopped = 0.0, 0, ""
        worst: dict[str, float] = {}
        for run, reference in zip(problem.runs[:number], references, strict=False):
            try:
                found = simulate(run, value)
                for _ in range(again * (found.seconds < BRIEF)):
                    found = min(found, simulate(run, value), key=lambda x: x.seconds)
            except Exception as error:
                found = Found(np.empty((0, len(problem.read), 3)), None, 0.0, _said(error))
            off = errors(problem, found, reference, branch)
            seconds += found.seconds
            kept += not found.stopped and off["off the branch [m]"] <= BRANCH
            stopped = stopped or found.stopped
            worst = {key: float(np.fmax(x, worst.get(key, 0.0))) for key, x in off.items()}
        row: Row = {"seconds": seconds, **worst, "branch kept": f"{kept} of {len(problem.runs[:number])}"}
        return row | {"result": verdict(row, stopped)}

    try:
        ways: list[tuple[tuple[bool, float], Simulation, str]] = []
        variants = chosen.variants[: 1 if len(problem.bodies) > 50 else None]
        for variant in variants:
            simulate, alone = chosen.build(problem, **variant), len(variants) == 1
            row = {} if alone else judge(simulate, chosen.values[1], 0, 5)
            rank = row.get("result", "ok") not in DONE, row.get("error [m]", 0.0)
            ways.append((rank, simulate, ", ".join(f"{key} {rounded(x)}" for key, x in variant.items())))  # type: ignore[arg-type]
    except Exception as error:
        print(json.dumps(base | {"result": f"stopped: {_said(error)}"}), flush=True)
        return
    _, simulate, setting = min(ways, key=lambda way: way[0])
    for value in chosen.values:
        row = judge(simulate, value, 2 if len(problem.runs) == 1 else 0, len(problem.runs))
        print(json.dumps({**base, "setting": setting, chosen.control: value, **row}), flush=True)


def verdict(row: Row, stopped: str) -> str:
    """Return the outcome of a run."""
    number = {key: x for key, x in row.items() if isinstance(x, float)}
    if stopped or not math.isfinite(number["error [m]"]):
        return f"stopped: {' '.join(stopped.split())[:160]}" if stopped else "stopped: the state is NaN"
    if number["off the branch [m]"] > BRANCH:
        return LOST[0]
    if number["gap [m]"] > OPEN:
        return LOST[1]
    return "inaccurate" if number["error [m]"] > CLOSE else "ok"


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:140]}"


def spent(pid: int) -> float:
    """Return the processor time of a process [s], 0 if unknown; a limit by `resource` would make its clock coarse."""
    try:
        numbers = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(numbers[11]) + int(numbers[12])) / os.sysconf("SC_CLK_TCK")


def apart(name: str, code: str, limit: float) -> list[Row]:
    """Return the rows of a code on a problem, run in another process."""
    base: Row = {"problem": name, "code": code}
    try:
        importlib.import_module(CODES[code].module)
    except ImportError:
        return [base | {"result": "not installed"}]
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as said:
        command = [sys.executable, __file__, "--one", name, code]
        ended = ""
        with subprocess.Popen(command, stdout=out, stderr=said) as process:
            while process.poll() is None:
                if spent(process.pid) > limit:
                    process.kill()
                    ended = f"stopped: more than {limit:g} s"
                time.sleep(0.1)
        if process.returncode and not ended:
            ended = f"stopped: the process ended with code {process.returncode}"
        out.seek(0)
        said.seek(0)
        rows: list[Row] = [json.loads(line) for line in out if line.startswith("{")]
        if ended and "code" in ended:
            ended += f" ({(said.read().strip().splitlines() or ['it says nothing'])[-1][:120]})"
    return rows + [base | {"result": ended}] * bool(ended)


def class_row(name: str) -> Row:
    """Return the kind of the forces at the singular position, and the kind that alfmu reports 1e-4 rad from it."""
    problem, motion = loaded(name), PROBLEMS[name]()[1]
    problem.runs[0].q = [motion.singular] * len(problem.bodies)  # guesses of the assembly
    e = alfmu.derive(declared(problem))
    i = alfmu.Instance(e)
    parameters = CATALOGUE.get(name, ("", {}, {}))[2]
    for key, x in {**given(problem, problem.runs[0], e), **parameters, "solver.method": "rk4"}.items():
        i.set(key, x)
    for v in e.starts:
        i.set(v.name, motion.singular + 1e-4)
    for v in e.start_rates:
        i.set(v.name, 2.0)
    i.initialize()
    says = {0: "regular", 1: "limit", 2: "pole"}[round(float(i.get("monitor.singular")))]
    return {"problem": name, "forces": problem.reactions, "alfmu says": says}


# Tables and picture -----------------------------------------------------------------------------------------------


def best(rows: Sequence[Row], problem: str, code: str) -> Row:
    """Return the most accurate row of a code on a problem; if all are lost, the row that kept the branch most often."""
    mine = [row for row in rows if (row["problem"], row["code"]) == (problem, code)]
    done = [row for row in mine if row["result"] in DONE]
    if done:
        return min(done, key=lambda row: row["error [m]"])  # type: ignore[arg-type,return-value]
    return max(mine, key=lambda row: int(str(row.get("branch kept", "0")).split()[0]), default={})


def cell(rows: Sequence[Row], problem: str, code: str) -> str:
    """Return the least error and its time, or why there is none."""
    row = best(rows, problem, code)
    if row.get("result") in DONE:
        return f"{row['error [m]']:.0e} m, {rounded(row['seconds'], 2)} s"
    kept = str(row.get("branch kept", ""))
    return str(row.get("result", "-")).split(":")[0] + f", {kept} kept" * (not kept.endswith("of 1") and bool(kept))


def felt(rows: Sequence[Row], problem: str, code: str) -> Cell:
    """Return the error of the force in the most accurate run that was not lost."""
    row = best(rows, problem, code)
    return row.get("force error [N]") if row.get("result") in DONE else None


def duel(rows: Sequence[Row], problem: str) -> Row:
    """Return the other code that comes closest to alfmu at equal time, over all settings."""
    runs = [row for row in rows if row["problem"] == problem and row["result"] in DONE]
    own = [(row["seconds"], row["error [m]"]) for row in runs if row["code"] in OWN]
    found: Row = {"problem": problem}
    ratios, faster = [], []
    for row in runs:
        if row["code"] not in OWN:
            mine = [error for seconds, error in own if seconds <= row["seconds"]]  # type: ignore[operator]
            if mine:
                ratios.append((row["error [m]"] / min(mine), row))  # type: ignore[operator,type-var]
            else:
                faster.append(row)
    if ratios:
        ratio, row = min(ratios, key=lambda pair: pair[0])
        found |= {"closest": row["code"], "its error [m]": row["error [m]"], "in [s]": row["seconds"]}
        found["its error / alfmu's"] = float(ratio)
        as_good = [seconds for seconds, error in own if error <= row["error [m]"]]  # type: ignore[operator]
        found["its time / alfmu's for that error"] = row["seconds"] / min(as_good) if as_good else None  # type: ignore[operator,type-var]
    if faster:
        row = min(faster, key=lambda row: row["error [m]"])  # type: ignore[arg-type,return-value]
        found["faster than any run of alfmu"] = f"{row['code']}: {row['error [m]']:.1e} m in {row['seconds']:.2g} s"
    return found


def picture(rows: Sequence[Row], names: Sequence[str]) -> Figure:
    """Plot errors over times, with a panel for each problem."""
    figure = Figure(figsize=(15, 3.4 * -(-len(names) // 4)), layout="constrained")
    panels = figure.subplots(-(-len(names) // 4), 4, squeeze=False).ravel()
    handles = {}
    for axes, name in zip(panels, names, strict=False):
        for k, code in enumerate(CODES):
            style = {"color": f"C{k}", "marker": "osD^v<>phX*d"[k], "ls": "-" if code in OWN else ":"}
            runs = [row for row in rows if (row["problem"], row["code"]) == (name, code) and row.get("seconds")]
            for lost in (False, True):
                chosen = [row for row in runs if (row["result"] not in DONE) == lost]
                at = [(row["seconds"], row["error [m]"]) for row in chosen if row.get("error [m]")]
                more = {"ls": "", "marker": "x"} if lost else {}
                if at:
                    (line,) = axes.loglog(*zip(*at, strict=True), ms=4, lw=1.2, **style | more)
                    if not lost:
                        handles[code] = line
        axes.set_title(loaded(name).title, fontsize=9)
        axes.set_ylim(1e-16, 30)
        axes.grid(alpha=0.3)
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    figure.supxlabel("processor time of the run [s]; a cross: it left its branch, opened its loops or stopped")
    figure.supylabel("largest error of the points [m]")
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=5, fontsize=9)
    return figure


def page(rows: Sequence[Row], names: Sequence[str], classes: Sequence[Row], command: str) -> str:
    """Return the part of the page that shows the results."""
    codes = [code for code in CODES if any(row["code"] == code for row in rows)]
    facts = environment(command, [CODES[code].package for code in dict.fromkeys(codes)])
    duels = [duel(rows, name) for name in names]
    heads = list(dict.fromkeys(key for row in duels for key in row))
    lost = [row for row in rows if row["result"] not in DONE]
    kinds: dict[tuple, list[str]] = {}
    for row in lost:
        value = row.get("step") or row.get("tolerance")
        kinds.setdefault((row["problem"], row["code"], row["result"]), []).append(f"{value:g}" if value else "all")
    parts = [
        "**Least error, and the time it took**",
        markdown(["problem", *codes], [[name, *(cell(rows, name, code) for code in codes)] for name in names]),
        "**Who comes closest to alfmu in the same time**",
        markdown(heads, [[row.get(key) for key in heads] for row in duels]),
        "**Largest error of the force [N], of the most accurate run**",
        markdown(["problem", *codes], [[name, *(felt(rows, name, code) for code in codes)] for name in names], 2),
        "**Pole or limit**",
        markdown(list(classes[0]), [list(row.values()) for row in classes]) if classes else "not asked for",
        "**Lost runs**",
        markdown(["problem", "code", "result", "step or tolerance"], [[*k, ", ".join(x)] for k, x in kinds.items()]),
        "**Machine and versions**",
        markdown(["what", "value"], list(dict.fromkeys(facts))),
    ]
    return "\n\n".join(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the selected part of the benchmark."""
    line = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    line.add_argument("--problems", nargs="*", choices=PROBLEMS, default=list(PROBLEMS), metavar="PROBLEM")
    line.add_argument("--codes", nargs="+", choices=CODES, default=list(CODES), metavar="CODE")
    line.add_argument("--quick", action="store_true", help="three problems, alfmu and SciPy")
    line.add_argument("--references", action="store_true", help="make problems and exact motions anew (an hour)")
    line.add_argument("--write", action="store_true", help="put the results into the page")
    line.add_argument(
        "--kept", action="store_true", help="keep other rows of results.csv; with an empty --problems, all"
    )
    line.add_argument("-o", "--output", type=Path, default=Path("results") / "singular_benchmark")
    line.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    chosen = line.parse_args(arguments)
    if chosen.one:
        measured(*chosen.one)
        return 0
    if chosen.references:
        for name in chosen.problems:
            print(write_reference(name), flush=True)
        return 0
    names, codes = QUICK if chosen.quick else (chosen.problems, chosen.codes)
    folder = FOLDER if chosen.write else chosen.output
    folder.mkdir(parents=True, exist_ok=True)
    path, rows = folder / "results.csv", []
    if chosen.kept and path.exists():
        rows = [row for row in read(path) if not (row["problem"] in names and row["code"] in codes)]
    for name in names:
        for code in codes:
            print(f"{name}: {code}", file=sys.stderr, flush=True)
            rows += apart(name, code, LONG if name.endswith("1000") else LIMIT)
            write_csv(path, rows)
    rows.sort(key=lambda row: ([*PROBLEMS].index(str(row["problem"])), [*CODES].index(str(row["code"]))))
    write_csv(path, rows)
    seen = [name for name in PROBLEMS if any(row["problem"] == name for row in rows)]
    forces = [] if chosen.quick else [p for p in map(loaded, seen) if p.reactions != "none" and len(p.bodies) < 10]
    classes = [class_row(p.name) for p in forces]
    picture(rows, seen).savefig(folder / "results.png", dpi=90, metadata={"Software": None})
    text = page(rows, seen, classes, "python scripts/singular_benchmark.py --write")
    if chosen.write:
        index = FOLDER / "index.md"
        before, _, rest = index.read_text(encoding="utf-8").partition(BEGIN)
        index.write_text(f"{before}{BEGIN}\n\n{text}\n\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    else:
        (folder / "results.md").write_text(text + "\n", encoding="utf-8")
    print(path)
    return 0


def read(path: Path) -> list[Row]:
    """Return the rows of a CSV file of results."""
    words = ("problem", "code", "setting", "result", "branch kept")
    with path.open(encoding="utf-8") as file:
        return [{k: x if k in words else float(x) for k, x in row.items() if x} for row in csv.DictReader(file)]


if __name__ == "__main__":
    raise SystemExit(main())
