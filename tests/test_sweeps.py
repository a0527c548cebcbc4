"""Sweeps: cases by a small grammar, runs that are those of the library, parts that survive, failures as rows."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import alfmu
from alfmu.cli import main
from alfmu.runtime.library import Scene
from alfmu.sweeps import crew, jobs
from alfmu.sweeps.variations import parsed, planned

KEEP = ["link1.angle", "peak(A.force.*)"]
VARY = {"m2": "0:1:3", "l": "uniform(0.9,1.1)"}
SCRIPT = """
import sys, alfmu, alfmu.sweeps.crew, alfmu.sweeps.sweep
alfmu.sweeps.crew.PART, alfmu.sweeps.sweep.QUICK = 0.2, 0.1
alfmu.sweep("slider_crank", {"start.angle": "uniform(0.1,1.0)"}, int(sys.argv[2]), folder=sys.argv[1], workers=2,
    stop_time=2.0, keep=["crank.angle"], kernel="vm", form="csv")
"""
"""A sweep of a user's file, without `if __name__ == "__main__"`."""


SAMPLES = 3000


@cache
def at_once() -> alfmu.Sweep:
    """What SCRIPT makes, in this process."""
    angles = {"start.angle": "uniform(0.1,1.0)"}
    return alfmu.sweep("slider_crank", angles, SAMPLES, stop_time=2.0, keep=["crank.angle"])


def tables(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("part-*"))}


# What is varied ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0:1:3", [0.0, 0.5, 1.0]),
        ("0.01:100:3:log", [0.01, 1.0, 100.0]),
        ("1, 2,-5e-1", [1.0, 2.0, -0.5]),
        ("7", [7.0]),
        ((3, 4), [3.0, 4.0]),
    ],
)
def test_grids_and_lists(text, values):
    assert parsed("x", text) == pytest.approx(values, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "law"),
    [
        ("uniform(-1,3)", stats.uniform(-1, 4)),
        ("loguniform(0.1,10)", stats.loguniform(0.1, 10)),
        ("normal(2, 0.5)", stats.norm(2, 0.5)),
        ("normal(2,0.5,1,2.2)", stats.truncnorm(-2, 0.4, 2, 0.5)),
        ("lognormal(3,0.2)", stats.lognorm(0.2, scale=3)),
        ("triangular(1,2,5)", stats.triang(0.25, 1, 4)),
        ("triangular(1,1,5)", stats.triang(0, 1, 4)),
    ],
)
def test_distributions_are_those_of_scipy(text, law):
    u = np.linspace(0, 1, 401)[1:-1]
    assert parsed("x", text).quantiles(u) == pytest.approx(law.ppf(u), rel=1e-9, abs=1e-12)
    assert np.isfinite(parsed("x", text).quantiles(np.array([0.0, 1.0]))).all()


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("__import__('os').system('touch pwned')", "no variation"),
        ("1+1", "no variation"),
        ("normal(0,-1)", "deviation > 0"),
        ("normal(1)", "1 numbers; give normal"),
        ("unifrom(0,1)", "did you mean uniform"),
        ("0:1:1", r"2 to 5e\+07 values"),
        ("0:1:100000000", r"2 to 5e\+07 values"),
        ("0:1:3:log", "above zero"),
        ("1e999", "finite"),
        ("uniform(0,1e999)", "low < high"),
    ],
)
def test_what_is_no_variation_is_refused(text, why, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(alfmu.InputError, match=why.replace("(", r"\(")):
        parsed("x", text)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("sampler", ["latin", "sobol"])
def test_samples_cover_each_share_of_probability_once(sampler):
    count = 64
    cases = planned({"a": "uniform(0,1)", "b": "normal(0,1)"}, count, sampler, 7)
    values = cases.values(0, count)
    for u in (values[:, 0], stats.norm.cdf(values[:, 1])):
        assert sorted(np.floor(u * count)) == list(range(count))
    again = planned({"a": "uniform(0,1)", "b": "normal(0,1)"}, count, sampler, 7)
    other = planned({"a": "uniform(0,1)", "b": "normal(0,1)"}, count, sampler, 8)
    assert cases.digest() == again.digest() != other.digest()


def test_cases_are_the_product_and_made_when_asked_for():
    cases = planned({"b": "1,2", "x": "uniform(0,1)"}, 3, "random", 1, {"a": np.array([5.0, 6.0])})
    whole = cases.values(0, len(cases))
    assert (len(cases), cases.names) == (12, ("a", "b", "x"))
    assert whole[:, 0].tolist() == [5.0] * 6 + [6.0] * 6
    assert whole[:, 1].tolist() == ([1.0] * 3 + [2.0] * 3) * 2
    assert (whole[:3, 2] == whole[9:, 2]).all()
    assert (cases.values(4, 9) == whole[4:9]).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"vary": {}}, "nothing is varied"),
        ({"vary": {"l": "uniform(1,2)"}}, "how many samples"),
        ({"vary": {"l": "1,2"}, "samples": 5}, "nothing has a distribution"),
        ({"vary": {"q": "1,2"}}, "no input or parameter 'q'"),
        ({"vary": {"solver.method": "1,2"}}, "cannot be varied"),
        ({"vary": {"solver.max_iterations": "1.5,2"}}, "a whole number"),
        ({"vary": {"l": "1,2"}, "parameters": {"l": 1.0}}, "varied and set"),
        ({"vary": {"l": "1,2"}, "freeze": ["l"]}, "varied and frozen"),
        ({"vary": {"A.torque": "1,2"}, "inputs": {"A.torque": 1.0}}, "also given a value"),
        ({"vary": {"l": "1,2"}, "keep": ["max(nothing)"]}, "no output 'nothing'"),
        ({"vary": {"l": "1,2"}, "keep_series": ["A.torqe"]}, "no output 'A.torqe'"),
        ({"vary": {"l": "1,2"}, "cases": {"l": [1.0]}}, "leave one out"),
        ({"cases": {"l": [1.0], "m1": [1.0, 2.0]}}, "these have l 1, m1 2"),
        ({"vary": {"l": "1,2"}, "workers": 0}, "give 1 or more"),
        ({"vary": {"l": "0:1:100000", "m1": "0:1:100000"}}, "more than the 5e"),
        ({"vary": {"l": "1,2"}, "kernel": "oracle"}, "not by the oracle"),
        ({"vary": {"l": [[1.0, 2.0]]}}, "finite numbers in a row"),
        ({"vary": {"l": "1,2"}, "keep": [3]}, r"outputs to keep are \[3\]; give a list"),
        ({"vary": {"l": "1,2"}, "keep_series": 3}, "outputs to keep are 3; give a list"),
        ({"vary": ["l=1,2"]}, r"variations are \['l=1,2'\]; give a dictionary"),
        ({"vary": {"l": "1,2"}, "inputs": 3}, "inputs are 3; give a dictionary"),
        ({"vary": {"l": "uniform(1,2)"}, "samples": 2.5}, "samples is 2.5; give a whole number"),
        ({"vary": {"l": "uniform(1,2)"}, "samples": 2, "seed": None}, "seed is None; give a whole number"),
        ({"vary": {"l": "1,2"}, "workers": "2"}, "workers is '2'; give a whole number"),
        ({"vary": {"l": "1,2"}, "keep": ["median(link1.angle)"]}, "median.*cannot be kept; did you mean mean"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is(given, why):
    with pytest.raises(alfmu.InputError, match=why):
        alfmu.sweep("five_bar", **given)


@pytest.mark.slow
def test_a_table_of_cases_from_a_file(tmp_path):
    table = tmp_path / "cases.csv"
    table.write_text("m2, l\n0.5,1\n0.7,1.1\n")
    found = alfmu.sweep("five_bar", cases=table, keep=KEEP, stop_time=0.1)
    assert (found["m2"].tolist(), found["l"].tolist()) == ([0.5, 0.7], [1.0, 1.1])
    for text, why in (
        ("m2\n1,2\n", "case 1"),
        ("m2\n1\nnan\n", "case 2"),
        ("m2,m2\n1,2\n", "each once"),
        ("", "no cases"),
    ):
        table.write_text(text)
        with pytest.raises(alfmu.InputError, match=why):
            alfmu.sweep("five_bar", cases=table)


# Numbers -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_numbers_are_those_of_single_runs(workers, monkeypatch):
    monkeypatch.setattr("alfmu.sweeps.sweep.QUICK", 0.0)
    time_, drive = np.linspace(0, 0.5, 3), np.array([0.0, 1.0, 0.0])
    how = {"stop_time": 0.5, "communication_step": 0.01, "inputs": {"A.torque": (time_, drive)}}
    keep = [f"{f}(link1.angle)" for f in ("final", "min", "max", "mean", "peak", "rms")] + ["peak(A.force.x)"]
    found = alfmu.sweep("five_bar", VARY, 4, keep=keep, keep_series=["link3.angle"], workers=workers, **how)
    assert len(found) == 12
    assert set(found["failure"]) == {""}
    for case in (0, 5, 11):
        own = {name: found[name][case] for name in VARY}
        run = alfmu.simulate("five_bar", **how, parameters=own)
        y = run["link1.angle"]
        expected = [y[-1], y.min(), y.max(), np.trapezoid(y, run.time) / 0.5, np.abs(y).max()]
        expected += [np.sqrt(np.trapezoid(y**2, run.time) / 0.5), np.abs(run["A.force.x"]).max()]
        exact = np.array([found[name][case] for name in keep])
        assert exact[[0, 1, 2, 4, 6]].tolist() == [expected[i] for i in (0, 1, 2, 4, 6)]
        assert exact == pytest.approx(expected, rel=1e-12)
        assert np.array_equal(found.over_time("link3.angle")[case], run["link3.angle"])
    assert found.units["peak(A.force.x)"] == "N"
    assert found.units["l"] == "m"


@pytest.mark.slow
@pytest.mark.usefixtures("quick_compiler")
def test_compiled_runs_have_the_same_numbers():
    how = {"vary": {"start.angular_velocity": "0:1:3"}, "keep": ["peak(*)"], "stop_time": 0.3, "workers": 1}
    one, other = (alfmu.sweep("particle_on_circle", kernel=kernel, **how) for kernel in ("vm", "auto"))
    assert all(np.array_equal(one[name], other[name]) for name in one.names[:-2])


def test_values_that_look_like_degrees_are_told():
    with pytest.warns(alfmu.AlfmuWarning, match=r"start\.angle.*45"):
        alfmu.sweep("five_bar", {"start.angle": "10,-45"}, keep=KEEP, stop_time=0.05)


def test_inputs_and_numbers_of_the_solver_are_varied():
    found = alfmu.sweep("five_bar", {"A.torque": "0,2", "solver.step_size": "0.005,0.01"}, keep=KEEP, stop_time=0.3)
    for case in range(4):
        run = alfmu.simulate(
            "five_bar",
            0.3,
            inputs={"A.torque": found["A.torque"][case]},
            parameters={"solver.step_size": found["solver.step_size"][case]},
        )
        assert found["final(link1.angle)"][case] == run["link1.angle"][-1]


def test_failures_are_rows_with_reasons_and_leave_no_trace_in_others(tmp_path):
    """A loop that cannot be closed, a value out of its bounds, and good cases between them."""
    text = """
from alfmu import Mechanism

def gap() -> Mechanism:
    m = Mechanism("gap", "A triangle of bars whose third side may be too long")
    reach = m.parameter("reach", 1.0, "m", minimum=0.0)
    th, ps = m.coordinate("th", "rad", start=0.9), m.coordinate("ps", "rad", start=2.0)
    one = m.bar("one", mass=1.0, length=1.0)
    two = m.bar("two", mass=1.0, length=1.0)
    m.revolute("A", m.ground.at(0, 0), one.start, coordinate=th)
    m.revolute("B", m.ground.at(reach, 0), two.start, coordinate=ps)
    m.revolute("C", one.end, two.end)
    m.gravity(0, -9.81)
    return m
"""
    linkage = tmp_path / "gap.py"
    linkage.write_text(text)
    found = alfmu.sweep(
        linkage, {"reach": "1,5,-1,1,1.2"}, stop_time=0.05, keep=["one.angle"], keep_series=["one.angle"]
    )
    said = found["failure"].tolist()
    assert [bool(text) for text in said] == [False, True, True, False, False]
    assert "reach = -1 m is outside" in said[2]
    with pytest.raises(alfmu.AssemblyError) as single:
        alfmu.simulate(linkage, 0.05, parameters={"reach": 5.0})
    assert str(single.value) == said[1]
    ends = found["final(one.angle)"]
    assert np.isnan(ends[[1, 2]]).all()
    assert np.isnan(found["end_time"][[1, 2]]).all()
    assert ends[0] == ends[3] != ends[4]
    assert np.isnan(found.over_time("one.angle")[1]).all()
    s = found.summary
    assert (s.failed, s.finished, len(s.failures)) == (2, 5, 2)
    assert sorted(each.cases for each in s.failures) == [(1,), (2,)]


def test_warnings_of_a_run_are_kept_with_it():
    found = alfmu.sweep(
        "five_bar",
        {"solver.step_size": "0.001,0.02"},
        keep=KEEP,
        parameters={"solver.method": "rk4", "solver.tolerance": 1e-3, "start.angular_velocity": -60.0},
        stop_time=1.0,
    )
    said = found["warning"].tolist()
    assert said[0] == ""
    assert "energy" in said[1]
    assert [each.count for each in found.summary.warnings] == [1]


# Workers -------------------------------------------------------------------------------------------------------------


def test_a_worker_imports_neither_casadi_nor_what_traces():
    code = (
        "import sys, alfmu.sweeps.jobs; print([m for m in ('casadi', 'scipy', 'alfmu.equations') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_runs_are_made_side_by_side_by_instances_of_one_scene(monkeypatch):
    """The first one alone, as it may take long."""
    made: dict[str, list[int] | int] = {"scenes": 0, "runs": []}
    load, run = Scene.__init__, jobs._Seats.run

    def counting(self, given, values):
        made["runs"].append(len(values))
        return run(self, given, values)

    def loading(self, *given):
        made["scenes"] += 1
        load(self, *given)

    alfmu.sweep("five_bar", {"m2": "0.31,0.32"}, keep=KEEP, stop_time=0.1, workers=1)
    monkeypatch.setattr(jobs._Seats, "run", counting)
    monkeypatch.setattr(Scene, "__init__", loading)
    monkeypatch.setattr(jobs, "_OWN", jobs.threading.local())
    alfmu.sweep("five_bar", {"m2": "0:1:25"}, keep=KEEP, stop_time=0.1, workers=1)
    assert made == {"scenes": 1, "runs": [1, 24]}


@pytest.mark.slow
def test_cases_that_no_process_survives_are_rows_and_others_are_not(tmp_path):
    """A scene whose worker ends at one value: that case alone is lost, by halving."""
    module = tmp_path / "deadly.py"
    module.write_text(
        "import os\nimport alfmu.sweeps.jobs as jobs\nrun = jobs.run_part\n"
        "def run_part(job, first, values, seconds):\n"
        "    if (values[:, 0] == 7).any():\n        os._exit(9)\n"
        "    return run(job, first, values, seconds)\n"
    )
    code = f"""
import sys; sys.path.insert(0, {str(tmp_path)!r})
import deadly, alfmu.sweeps.crew as crew, alfmu.sweeps.sweep as sweep, alfmu
crew.run_part, sweep.QUICK = deadly.run_part, 0.0
found = alfmu.sweep("five_bar", {{"m2": "0:15:16"}}, keep=["link1.angle"], stop_time=0.1, workers=2, kernel="vm")
print([int(x) for x in found["m2"] if found["failure"][int(x)]], set(found["failure"][7:8]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(tmp_path)}
    )
    assert done.stdout.startswith("[7] {'five_bar: the process that ran this case ended"), done.stderr


def started(folder: Path, samples: int, parts: int) -> subprocess.Popen:
    """The sweep of SCRIPT in a process of its own, once it has written so many parts."""
    script = folder.parent / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, script, folder, str(samples)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60
    while len(list(folder.glob("part-*"))) < parts:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end
        time.sleep(0.02)
    return process


def children(pid: int) -> list[int]:
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks for processes as Linux lists them")
def test_a_sweep_that_is_killed_goes_on_and_repeats_nothing(tmp_path):
    """kill -9 of a worker, then of all of it: parts are whole, workers end, the second sweep makes the rest alone."""
    folder = tmp_path / "s"
    process = started(folder, SAMPLES, 2)
    first = children(process.pid)
    worker = next(pid for pid in first if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes())
    os.kill(worker, signal.SIGKILL)
    known = len(tables(folder))
    end = time.monotonic() + 60
    while len(tables(folder)) < known + 2:  # goes on with other workers
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < end
        time.sleep(0.02)
    workers = children(process.pid)
    process.kill()
    process.wait()
    process.stderr.close()
    before = tables(folder)
    stamps = {path.name: path.stat().st_mtime_ns for path in folder.glob("part-*")}
    done = sum(text.count(b"\n") - 1 for text in before.values())
    assert 0 < done < SAMPLES
    end = time.monotonic() + 20
    while any(Path(f"/proc/{pid}/exe").exists() for pid in workers):
        assert time.monotonic() < end, "a worker outlives the process that started it"
        time.sleep(0.05)
    made = subprocess.run(
        [sys.executable, tmp_path / "script.py", folder, str(SAMPLES)], capture_output=True, text=True
    )
    assert made.returncode == 0, made.stderr
    assert {path.name: path.stat().st_mtime_ns for path in folder.glob("part-*") if path.name in before} == stamps
    found = alfmu.Sweep.load(folder)
    assert np.array_equal(found["case"], np.arange(SAMPLES))
    assert sum(text.count(b"\n") - 1 for text in tables(folder).values()) == SAMPLES
    assert all(np.array_equal(found[name], at_once()[name]) for name in found.names[:-2])


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_an_interrupt_keeps_what_is_under_way(tmp_path):
    folder = tmp_path / "s"
    process = started(folder, SAMPLES, 1)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    found = alfmu.Sweep.load(folder)
    assert process.returncode != 0
    assert f"{len(found)} of {SAMPLES} cases are in {folder}; the same command goes on from there" in said
    assert 0 < len(found) < SAMPLES
    assert not np.isnan(found["final(crank.angle)"]).any()
    assert not list(folder.glob(".alfmu-*"))


FULL = """
import resource, sys
import alfmu.sweeps.crew as crew
from alfmu.cli import main
from pathlib import Path
taken = crew._Work._next
def following(work, most):
    if work.store.finished >= 16:
        sys.dont_write_bytecode = True
        resource.setrlimit(resource.RLIMIT_FSIZE, (1, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    return taken(work, 8)
crew._Work._next = following
sys.exit(main(sys.argv[1:]))
"""
"""A disk that has room for two parts of eight cases: a limit of the process stands for it."""


@pytest.mark.slow
@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_a_full_disk_loses_no_finished_case(form, tmp_path):
    pytest.importorskip("resource")
    pytest.importorskip("pyarrow")
    arguments = [
        "sweep",
        "five_bar",
        "--vary",
        "m2=uniform(0,1)",
        "--samples",
        "416",
        "--stop-time",
        "0.1",
        "--workers",
    ]
    arguments += ["1", "--format", form, "-o", str(tmp_path / "s"), "--keep", "final(link1.angle)", "--no-page"]
    done = subprocess.run([sys.executable, "-c", FULL, *arguments], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "cannot write" in done.stderr
    assert "16 of 416 cases are in" in done.stderr
    assert "Traceback" not in done.stderr
    before = tables(tmp_path / "s")
    assert len(before) == 2
    assert not list((tmp_path / "s").glob(".alfmu-*"))
    assert main(arguments) == 0
    after = tables(tmp_path / "s")
    assert {name: after[name] for name in before} == before
    found = alfmu.Sweep.load(tmp_path / "s")
    at_once = alfmu.sweep("five_bar", {"m2": "uniform(0,1)"}, 416, stop_time=0.1, keep=["final(link1.angle)"])
    assert np.array_equal(found["final(link1.angle)"], at_once["final(link1.angle)"])


def test_another_plan_in_a_folder_is_refused_and_the_same_one_repeats_nothing(tmp_path):
    how = {"keep": KEEP, "stop_time": 0.1, "folder": tmp_path / "s", "form": "csv"}
    alfmu.sweep("five_bar", VARY, 4, **how)
    before = tables(tmp_path / "s")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "runner_of", lambda job: pytest.fail("a case is made again"))
        assert len(alfmu.sweep("five_bar", VARY, 4, **how)) == 12
    for other, why in (
        ({"samples": 5}, "samples is 4, not 5"),
        ({"seed": 2}, "seed is 1, not 2"),
        ({"stop_time": 0.2}, "stop_time is 0.1, not 0.2"),
        ({"keep": ["link1.angle"]}, "measures is"),
        ({"parameters": {"m3": 2.0}}, "set is"),
        ({"inputs": {"A.torque": 1.0}}, "set is|digest of the inputs is"),
        ({"form": "parquet"}, 'format is "csv", not "parquet"'),
    ):
        with pytest.raises(alfmu.InputError, match=why):
            alfmu.sweep("five_bar", **{"vary": VARY, "samples": 4, **how, **other})
    assert tables(tmp_path / "s") == before
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "thesis.txt").write_text("mine")
    with pytest.raises(alfmu.InputError, match="other files"):
        alfmu.sweep("five_bar", VARY, 4, **{**how, "folder": tmp_path / "t"})


def test_a_damaged_part_is_told(tmp_path):
    folder = tmp_path / "s"
    alfmu.sweep("five_bar", {"m2": "0,1"}, keep=KEEP, stop_time=0.1, folder=folder, form="csv")
    part = next(folder.glob("part-*"))
    part.write_text(part.read_text().rsplit("\n", 2)[0] + "\n")
    with pytest.raises(alfmu.InputError, match=r"cannot be read .*remove it, and the same command"):
        alfmu.Sweep.load(folder)["m2"]
    plan = folder / "plan.json"
    plan.write_text("{}")
    with pytest.raises(alfmu.InputError, match=r"plan\.json is not that of a sweep"):
        alfmu.Sweep.load(folder)


def test_two_processes_do_not_write_into_one_folder(tmp_path):
    pytest.importorskip("fcntl")
    from alfmu.model.files import exclusive

    with exclusive(tmp_path / "s") as ours:
        assert ours
        with pytest.raises(alfmu.InputError, match="another process"):
            alfmu.sweep("five_bar", {"m2": "0,1"}, folder=tmp_path / "s")


# A cluster -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_dask_cluster_of_which_a_worker_is_killed(tmp_path, monkeypatch):
    """Two workers in processes of their own; one is killed while it has cases in hand, and none is lost."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(crew, "PART", 0.2)
    monkeypatch.setattr("alfmu.sweeps.sweep.QUICK", 0.1)
    environment = {**os.environ, "DASK_LOGGING__DISTRIBUTED": "critical"}
    begin = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment, "cwd": tmp_path}
    address = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address), "--nthreads", "1"]
    processes = [subprocess.Popen([*dask, "--no-dashboard", "--scheduler-file", str(address)], **begin)]
    try:
        processes += [subprocess.Popen([*worker, "--no-nanny", "--no-dashboard"], **begin) for _ in range(2)]
        end = time.monotonic() + 60
        while not address.exists():
            assert time.monotonic() < end
            time.sleep(0.1)
        killed = []

        def kill(cases):
            for case in cases:
                yield case
                if case > 1000 and not killed:
                    processes[1].kill()
                    killed.append(case)

        found = alfmu.sweep(
            "slider_crank",
            {"start.angle": "uniform(0.1,1.0)"},
            SAMPLES,
            stop_time=2.0,
            keep=["crank.angle"],
            scheduler=json.loads(address.read_text())["address"],
            folder=tmp_path / "s",
            kernel="vm",
            progress=kill,
        )
    finally:
        for each in reversed(processes):
            each.kill()
            each.wait()
    assert killed
    assert np.array_equal(found["case"], np.arange(SAMPLES))
    assert set(found["failure"]) == {""}
    assert all(np.array_equal(found[name], at_once()[name]) for name in found.names[:-2])


def test_an_address_without_a_scheduler_is_told():
    pytest.importorskip("distributed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(crew, "WAIT", 1.0)
        with pytest.raises(alfmu.InputError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:9"):
            alfmu.sweep("five_bar", {"l": "0.9:1.1:20000"}, keep=KEEP, scheduler="tcp://127.0.0.1:9")


# FMUs ----------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["native", "python"])
def test_sweeps_of_fmus_are_those_of_the_mechanism(kind, tmp_path, capsys):
    path = alfmu.export(alfmu.Recipe("five_bar", kind=kind, reference=False), tmp_path / "five_bar.fmu")
    arguments = ["sweep", str(path), "--vary", "m2=-1:1:5", "--set", "m3=0.8", "--stop-time", "0.3", "--keep", *KEEP]
    assert main([*arguments, "--keep-series", "link1.angle", "-o", str(tmp_path / "s"), "--workers", "1"]) == 0
    out = capsys.readouterr().out
    assert "5 of 5 cases finished, 2 of them failed" in out
    found = alfmu.Sweep.load(tmp_path / "s")
    own = alfmu.sweep("five_bar", {"m2": "-1:1:5"}, parameters={"m3": 0.8}, keep=KEEP, stop_time=0.3)
    assert [bool(text) for text in found["failure"]] == [True, True, False, False, False]
    assert "m2 = -1 kg is outside" in found["failure"][0]
    for name in own.plan.measures:
        assert np.array_equal(found[name], own[name], equal_nan=True)
    assert np.array_equal(found.over_time("link1.angle")[2:, -1], own["final(link1.angle)"][2:])
    assert main([*arguments, "--freeze", "all"]) == 1
    how = {"keep": KEEP, "stop_time": 0.1, "workers": 1, "folder": tmp_path / "numbers of NumPy"}
    few = alfmu.sweep(path, {"m2": "uniform(0.5,1)"}, np.int64(2), parameters={"m3": np.float32(0.5)}, **how)
    assert few["failure"].tolist() == ["", ""]


# What is said --------------------------------------------------------------------------------------------------------


def test_the_summary_is_that_of_pandas_and_scipy(tmp_path):
    pandas = pytest.importorskip("pandas")
    found = alfmu.sweep("five_bar", {"m2": "0.1:1:3", "l": "uniform(0.9,1.1)"}, 20, keep=KEEP, stop_time=0.5)
    table = found.to_pandas()
    assert isinstance(table, pandas.DataFrame)
    for s in found.summary.spreads:
        column = table[s.name]
        assert s.quantiles == pytest.approx(column.quantile([0.05, 0.25, 0.5, 0.75, 0.95]).tolist(), rel=1e-12)
        assert (s.least_case, s.largest_case) == (column.idxmin(), column.idxmax())
        if s.moves:
            for name in ("m2", "l"):
                assert s.sensitivities[name] == pytest.approx(stats.spearmanr(table[name], column)[0], abs=1e-12)
    same = alfmu.sweep("five_bar", cases={"m2": [0.5, 0.5]}, keep=KEEP, stop_time=0.1)
    assert not any(s.moves or s.sensitivities for s in same.summary.spreads)


def test_what_varies_by_round_off_alone_has_no_ranks(tmp_path):
    """The slider of a slider-crank keeps to y = 0, to 1e-18 m."""
    keep, folder = ["max(slider.y)", "min(slider.y)", "max(slider.x)"], tmp_path / "s"
    found = alfmu.sweep("slider_crank", {"l1": "0.45:0.55:6"}, stop_time=0.5, keep=keep, folder=folder)
    by_name = {s.name: s for s in found.summary.spreads}
    least = by_name["min(slider.y)"]
    assert least.largest > least.least
    assert not any(by_name[name].moves or by_name[name].sensitivities for name in keep[:2])
    assert by_name["max(slider.x)"].sensitivities["l1"] == pytest.approx(1.0)
    said = [line for line in found.lines() if line.startswith("min(slider.y)")]
    assert len(said) == 1
    assert said[0].startswith("min(slider.y) does not vary: ")
    assert said[0].endswith(" m in all cases, but for round-off")
    found.save()
    told = {each["name"]: each for each in json.loads((folder / "summary.json").read_text())["measures"]}
    assert told["min(slider.y)"]["varies"] is False
    assert told["max(slider.x)"]["varies"] is True
    pytest.importorskip("plotly")
    (row,) = [x for x in (folder / "sweep.html").read_text().split("<tr>") if "<code>min(slider.y)</code>" in x]
    assert "does not vary" in row


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_files_are_read_by_others(form, tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    folder = tmp_path / "s"
    how = {"keep": KEEP, "keep_series": ["link1.angle"], "stop_time": 0.1, "folder": folder, "form": form}
    found = alfmu.sweep("five_bar", {"m2": "-1:1:5"}, **how)
    read = pandas.read_parquet if form == "parquet" else pandas.read_csv
    table = pandas.concat([read(path) for path in sorted(folder.glob("part-*"))])
    assert table["case"].tolist() == [0, 1, 2, 3, 4]
    assert np.array_equal(table["final(link1.angle)"], found["final(link1.angle)"], equal_nan=True)
    series = pandas.concat([read(path) for path in sorted(folder.glob("series-*"))])
    one = series[series["case"] == 3]
    assert np.array_equal(one["time"], found.time)
    assert np.array_equal(one["link1.angle"], found.over_time("link1.angle")[3])
    if form == "parquet":
        from pyarrow import parquet

        schema = parquet.read_schema(next(folder.glob("part-*")))
        assert schema.field("peak(A.force.x)").metadata == {b"unit": b"N"}
    else:
        with next(folder.glob("part-*")).open(newline="") as file:
            assert next(csv.reader(file)) == list(found.names)


@pytest.mark.slow
def test_the_page_has_its_pictures_and_needs_no_network(tmp_path, chromium, capsys):
    pytest.importorskip("plotly")
    folder = tmp_path / "s"
    arguments = ["sweep", "five_bar", "--vary", "m2=-0.1:1:12", "--vary", "l=uniform(0.9,1.1)", "--samples", "4"]
    arguments += ["--keep", "peak(*.force.x)", "--keep-series", "link1.angle", "--stop-time", "0.5", "-o", str(folder)]
    assert main(arguments) == 0
    assert f"wrote {folder / 'sweep.html'}" in capsys.readouterr().out
    assert json.loads((folder / "summary.json").read_text())["failed"] == 4
    chromium.get((folder / "sweep.html").as_uri())
    chromium.execute_async_script(
        "const end = arguments[0];"
        "Promise.all([...document.querySelectorAll('.plot:not([data-drawn])')].map(make)).then(end, end)"
    )
    kinds = chromium.execute_script(
        "return [...document.querySelectorAll('.plot')].map(p => [...new Set(p.data.map(d => d.type))].join())"
    )
    assert kinds == ["scatter", "bar", "heatmap", "scatter", "parcoords"]
    assert not chromium.find_elements("class name", "failed")
    assert not [line for line in chromium.get_log("browser") if line["level"] == "SEVERE"]
    text = chromium.find_element("tag name", "main").text
    assert "48 of 48" not in text.split("Failures")[1]
    assert "m2 = -0.1 kg is outside" in text


@pytest.mark.slow
def test_what_a_variation_does_not_change_is_told_with_its_value():
    """A few by name, many by their number; nothing where no case has a number."""
    rates = {"start.angular_velocity": [1.0, 2.0]}
    found = alfmu.sweep("five_bar", rates, stop_time=0.1, keep=["max(link1.x)", "min(link1.x)"])
    assert found.lines()[-1] == "max(link1.x) does not vary: 0.5 m in all cases"
    many = alfmu.sweep("five_bar", rates, stop_time=0.1, keep=["max(link*.x)"])
    assert many.lines()[-1] == "4 kept numbers do not vary between cases"
    failed = alfmu.sweep("four_bar", {"m2": [-1.0, -2.0]}, stop_time=0.1, keep=["max(link1.x)"])
    assert not any("in all cases" in line for line in failed.lines())
