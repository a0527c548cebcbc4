"""What alfmu writes and opens: whole files or none, runs that end early, results and FMUs from anywhere."""

import json
import multiprocessing
import os
import resource
import shutil
import signal
import stat
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import fmpy
import numpy as np
import pytest

import alfmu
from alfmu.cli import main, runs
from alfmu.fmi.drive import Fmu
from alfmu.model import files
from alfmu.simulation import communication_points, prepared, run, with_defaults
from alfmu.simulation.blajer import least_squares
from alfmu.view.drawing import as_data, from_data
from alfmu.view.shapes import geometry

RUN = ["simulate", "particle_on_circle", "--stop-time", "0.1", "--set", "solver.method=rk4"]
NAMELESS = [pytest.param(True, id="nameless"), pytest.param(False, id="named")]


@pytest.fixture(scope="session")
def native(built, tmp_path_factory) -> Path:
    return Path(shutil.copy(built("slider_crank"), tmp_path_factory.mktemp("native") / "native.fmu"))


def there(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def old(path: Path) -> None:
    os.utime(path, (time.time() - 3600,) * 2)


# Whole files ------------------------------------------------------------------------------------------------------


@pytest.fixture(params=NAMELESS)
def kinds(request, monkeypatch):
    """Files with a name while they are written, and without where the system has them."""
    if not request.param:
        monkeypatch.setattr(files, "_nameless", lambda folder: None)


@pytest.mark.usefixtures("kinds")
@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_file_is_there_as_a_whole_or_not_at_all(tmp_path, error):
    path = tmp_path / "new" / "file"

    def fail() -> None:
        with files.atomic(path) as file:
            file.write(b"half")
            raise error

    with pytest.raises(error):
        fail()
    assert there(path.parent) == set()
    files.write(path, b"one")
    with pytest.raises(error):
        fail()
    assert (there(path.parent), path.read_bytes()) == ({"file"}, b"one")
    files.write(path, b"two")
    assert (there(path.parent), path.read_bytes()) == ({"file"}, b"two")


@pytest.mark.usefixtures("kinds")
def test_links_permissions_and_pipes_stay_what_they_are(tmp_path):
    path, link, pipe = (tmp_path / name for name in ("file", "link", "pipe"))
    files.write(path, b"one")
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~_umask()
    path.chmod(0o640)
    link.symlink_to(path)
    files.write(link, b"two")
    assert (link.is_symlink(), path.read_bytes(), stat.S_IMODE(path.stat().st_mode)) == (True, b"two", 0o640)
    os.mkfifo(pipe)
    with subprocess.Popen(["cat", pipe], stdout=subprocess.PIPE) as reader:
        files.write(pipe, b"three")
        assert reader.communicate()[0] == b"three"
    with pytest.raises(alfmu.WriteError, match=r"cannot write .* \(Is a directory\)"):
        files.write(tmp_path, b"")
    assert there(tmp_path) == {"file", "link", "pipe"}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _half(path: Path, begun: multiprocessing.Event) -> None:
    with files.atomic(path) as file:
        file.write(b"half")
        file.flush()
        begun.set()
        time.sleep(60)


def killed(target: Callable[..., None], *arguments: object, pause: Callable[[], None] = lambda: None) -> None:
    """Kill a process once it says that it has begun."""
    context = multiprocessing.get_context("fork")
    begun = context.Event()
    process = context.Process(target=target, args=(*arguments, begun))
    process.start()
    assert begun.wait(20)
    pause()
    process.kill()
    process.join()


def test_nothing_is_left_of_a_file_when_its_writer_is_killed(tmp_path):
    if files._nameless(tmp_path) is None:
        pytest.skip("files have names here while they are written")
    killed(_half, tmp_path / "file")
    assert there(tmp_path) == set()


def test_what_a_killed_writer_leaves_under_a_name_goes_with_a_later_write(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_nameless", lambda folder: None)

    def another_writes() -> None:
        old(next(tmp_path.glob(".alfmu-*.part")))
        files.write(tmp_path / "other", b"")
        assert len(list(tmp_path.glob(".alfmu-*.part"))) == 1, "a file in use was removed"

    killed(_half, tmp_path / "file", pause=another_writes)
    (left,) = tmp_path.glob(".alfmu-*.part")
    os.utime(left)
    files.write(tmp_path / "young", b"")
    assert left.is_file()
    old(left)
    files.write(tmp_path / "later", b"")
    assert there(tmp_path) == {"other", "young", "later"}


def _folder(begun: multiprocessing.Event) -> None:
    with files.scratch() as folder:
        (folder / "file").write_text("half")
        begun.set()
        time.sleep(60)


def test_a_folder_for_a_while_goes_even_where_its_process_is_killed(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "alfmu-scratch").mkdir()
    with files.scratch() as folder:
        assert there(tmp_path) == {"alfmu-scratch", folder.name}

    def another_begins() -> None:
        (left,) = tmp_path.glob("alfmu-scratch-*")
        old(left)
        with files.scratch():
            assert left.is_dir(), "a folder in use was removed"

    killed(_folder, pause=another_begins)
    old(next(tmp_path.glob("alfmu-scratch-*")))
    with files.scratch() as folder:
        assert there(tmp_path) == {"alfmu-scratch", folder.name}
    assert there(tmp_path) == {"alfmu-scratch"}


@contextmanager
def full_disk(size: int) -> Iterator[None]:
    """No file can have more bytes. Python writes no bytecode then, as other processes would load it cut off."""
    before, writes = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = writes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "file"),
    [
        ([*RUN, "--stop-time", "1", "-o", "r.csv"], "r.csv"),
        ([*RUN, "-o", "r.csv", "--plot", "r.svg"], "r.svg"),
        (["export", "particle_on_circle", "--kind", "native", "-o", "p.fmu"], "p.fmu"),
        (["animate", "done.csv", "-o", "film.gif"], "film.gif"),
        (["animate", "done.csv", "-o", "film.html"], "film.html"),
    ],
    ids=["table", "picture", "FMU", "film", "page"],
)
def test_a_full_disk_leaves_no_half_of_anything(arguments, file, here, capsys):
    assert main([*RUN, "-o", "done.csv"]) == 0
    before = there(here)
    capsys.readouterr()
    with full_disk(5000):
        assert main(arguments) == 1
    assert capsys.readouterr().err == f"alfmu: cannot write {file} (File too large)\n"
    assert there(here) - before == ({"r.csv", "r.json"} if "--plot" in arguments else set())


def test_a_full_disk_leaves_what_was_there(here):
    path = alfmu.export("particle_on_circle", kind="native")
    was = path.read_bytes()
    with full_disk(5000), pytest.raises(alfmu.WriteError):
        alfmu.export("particle_on_circle", kind="native")
    assert path.read_bytes() == was
    assert there(here) == {"particle_on_circle.fmu"}


# Runs that end early ----------------------------------------------------------------------------------------------

TORQUE = "time,A.torque\n0,0\n0.5,0\n0.52,1e7\n"
"""From 0.52 s on, more than any step can follow."""


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["vm", "oracle", "held rows", "FMU in Python", "native FMU"])
def test_a_run_that_fails_leaves_its_rows_its_picture_and_its_film(unit, here, capsys, exported, native):
    (here / "in.csv").write_text(TORQUE)
    name = {"FMU in Python": str(exported("slider_crank")), "native FMU": str(native)}.get(unit, "slider_crank")
    how = {"oracle": ["--kernel", "oracle"], "held rows": ["--held-rows"]}.get(unit, [])
    by_rk4 = {"solver.method": "rk4"}
    arguments = ["simulate", name, *how, "--input", "in.csv", "--stop-time", "1", "--step", "0.02"]
    arguments += ["--set", "solver.method=rk4"]
    assert main([*arguments, "-o", "r.csv", "--plot", "r.png", "--plot-names", "rod.angle"]) == 1
    said = capsys.readouterr()
    assert "wrote r.csv (27 rows up to 0.52 s, " in said.out
    assert said.err.startswith("alfmu: ")
    assert "half a turn" in said.err
    assert said.err.count("\n") == 1
    result, whole = alfmu.Result.from_csv("r.csv"), alfmu.simulate("slider_crank", 0.5, 0.02, parameters=by_rk4)
    assert result.time[-1] == pytest.approx(0.52)
    assert np.abs(result["rod.angle"][:26] - whole["rod.angle"]).max() < 1e-9
    assert (here / "r.png").read_bytes().startswith(b"\x89PNG")
    assert main(["animate", "r.csv", "-o", "r.html"]) == 0
    if unit == "vm":
        assert main(["animate", "r.csv", "--fps", "5"]) == 0


@pytest.mark.slow
def test_the_reason_is_said_last(here):
    (here / "in.csv").write_text(TORQUE)
    command = [sys.executable, "-m", "alfmu.cli", "simulate", "slider_crank", "--input", "in.csv", "--stop-time", "1"]
    command += ["--set", "solver.method=rk4"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert lines[-1].startswith("alfmu: slider_crank, t = 0.5")
    assert lines[-2].startswith("wrote slider_crank.csv (27 rows")


def test_the_reason_is_said_even_where_the_rows_cannot_be_written(here, capsys):
    (here / "in.csv").write_text(TORQUE)
    command = ["simulate", "slider_crank", "--input", "in.csv", "--stop-time", "1", "--set", "solver.method=rk4"]
    assert main([*command, "-o", "/dev/null/r.csv"]) == 1
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("alfmu: cannot write /dev/null/r.csv (")
    assert "half a turn" in last


@pytest.mark.slow
def test_a_run_that_does_not_begin_leaves_nothing(here, capsys):
    assert main(["simulate", "slider_crank", "--set", "l2=0.1"]) == 1
    assert "loops cannot be closed" in capsys.readouterr().err
    assert there(here) == set()


@pytest.mark.slow
def test_the_library_has_the_rows_of_a_run_that_ends_early():
    torque = ([0.0, 0.5, 0.52], [0.0, 0.0, 1e7])
    with pytest.raises(alfmu.StepError) as failed:
        alfmu.simulate("slider_crank", 1.0, 0.02, inputs={"A.torque": torque}, parameters={"solver.method": "rk4"})
    result = failed.value.result
    assert len(result.time) == len(result["rod.angle"]) == 27
    with pytest.raises(alfmu.AssemblyError) as failed:
        alfmu.simulate("slider_crank", parameters={"l2": 0.1})
    assert failed.value.result is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("unit", "number"),
    [
        *((unit, signal.SIGINT) for unit in ("vm", "oracle", "FMU in Python", "native FMU")),
        ("native FMU", signal.SIGTERM),
    ],
)
def test_an_interrupt_keeps_the_rows(unit, number, here, capsys, monkeypatch, exported, native):
    name = {"FMU in Python": str(exported("slider_crank")), "native FMU": str(native)}.get(unit, "slider_crank")

    def progress(what: str) -> Callable[..., Iterator[float]]:
        def steps(points: list[float]) -> Iterator[float]:
            for i, point in enumerate(points):
                if i == 7:
                    os.kill(os.getpid(), number)
                yield point

        return steps

    monkeypatch.setattr(runs, "progress_bar", progress)
    kernel = ["--kernel", "oracle"] if unit == "oracle" else []
    before = signal.getsignal(number)
    plot = ["--plot", "r.svg", "--plot-names", "rod.angle"] if unit == "vm" else []
    arguments = ["simulate", name, *kernel, "--stop-time", "1", "--step", "0.02", "-o", "r.csv", *plot]
    assert main(arguments) == 130
    assert signal.getsignal(number) is before
    assert capsys.readouterr().err == "alfmu: interrupted\n"
    rows = len(alfmu.Result.from_csv("r.csv").time)
    assert rows == (51 if unit == "vm" else 8)  # so short a run of the library is over when it first asks
    assert there(here) == {"r.csv", "r.json", *plot[1:2]}


def test_an_interrupt_ends_a_run_of_the_library_where_it_is():
    def progress(points: list[float]) -> Iterator[float]:
        for i, point in enumerate(points):
            if i == 3:
                raise KeyboardInterrupt
            yield point

    with pytest.raises(KeyboardInterrupt) as ended:
        alfmu.simulate(
            "slider_crank", 100.0, 0.1, parameters={"solver.method": "rk4", "solver.step_size": 1e-4}, progress=progress
        )
    assert 4 < len(ended.value.result.time) < 1001


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rk4", "explicit"])
def test_an_interrupt_ends_a_communication_step_that_takes_long(method):
    """One of 900 s, which many thousand internal steps make; the state is the one before it."""
    given = {"solver.method": method, "solver.step_size": 1e-3, "solver.relative_tolerance": 1e-12}
    i = alfmu.Instance(prepared(with_defaults(alfmu.derive(alfmu.load("five_bar")), given), "vm"))
    asked = []

    def progress(done: int) -> None:
        asked.append(done)
        raise KeyboardInterrupt

    values, error = i.run(np.array([0.0, 900.0]), [], np.empty((2, 0)), ["link1.angle"], progress)
    assert isinstance(error, KeyboardInterrupt)
    assert asked == [0]
    assert len(values) == 1
    assert i.time == 0.0
    angle = i.get("link1.angle")
    assert angle == values[0, 0]
    i.step(0.02)
    assert 0 < abs(i.get("link1.angle") - angle) < 0.1


# Rows -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["vm", "oracle", "FMU"])
def test_held_rows_are_those_of_an_importer(unit, native):
    times = np.linspace(0, 1, 6)
    values = 5 * np.sin(7 * times)
    signals = np.array(
        [(t, x, 0.0) for t, x in zip(times, values, strict=True)],
        dtype=[("time", float), ("A.torque", float), ("slider.force", float)],
    )
    inputs = {"A.torque": (times.tolist(), values.tolist())}
    by_rk4, first = {"solver.method": "rk4"}, {"solver.method": 1}
    expected = fmpy.simulate_fmu(str(native), stop_time=1.0, output_interval=0.05, input=signals, start_values=first)
    if unit == "FMU":
        with Fmu(native) as fmu:
            held = run(fmu, 1.0, 0.05, inputs, parameters=by_rk4, held_rows=True)
    else:
        held = alfmu.simulate("slider_crank", 1.0, 0.05, inputs=inputs, parameters=by_rk4, kernel=unit, held_rows=True)
    new = alfmu.simulate("slider_crank", 1.0, 0.05, inputs=inputs, parameters=by_rk4)
    for name in ("crank.angle", "crank.angular_acceleration", "A.force.x"):
        assert held[name] == pytest.approx(expected[name], rel=1e-8, abs=1e-8)
    assert new["crank.angle"] == pytest.approx(expected["crank.angle"], abs=1e-8)
    assert np.abs(new["A.force.x"] - expected["A.force.x"]).max() > 1
    assert held["A.torque"][1:] == pytest.approx(new["A.torque"][:-1])


@pytest.mark.slow
def test_held_rows_from_the_command_line(here):
    (here / "in.csv").write_text("time,A.torque\n0,1\n0.1,2\n0.2,3\n")
    arguments = ["simulate", "slider_crank", "--input", "in.csv", "--stop-time", "0.2", "--step", "0.1"]
    assert main([*arguments, "--held-rows"]) == 0
    assert alfmu.Result.from_csv("slider_crank.csv")["A.torque"].tolist() == [1, 1, 2]
    assert main(arguments) == 0
    assert alfmu.Result.from_csv("slider_crank.csv")["A.torque"].tolist() == [1, 2, 3]


@pytest.mark.slow
def test_a_result_that_fits_in_no_memory_is_refused(here, capsys):
    for end in ("1e15", "1e308"):
        assert main(["simulate", "particle_on_circle", "--stop-time", end]) == 1
        assert "take a longer step, an earlier stop time or fewer outputs" in capsys.readouterr().err
    assert main(["simulate", "particle_on_circle", "--stop-time", "1", "--step", "1e-308"]) == 1
    assert "communication points" in capsys.readouterr().err
    assert there(here) == set()
    assert len(communication_points("any", 1e6, 1.0)) == 1000001


def test_a_run_has_at_least_one_step():
    for end in (5e-324, 1e-15, 1e-11):
        assert communication_points("any", end, 0.02).tolist() == [0, end]


# Tables from anywhere ---------------------------------------------------------------------------------------------

TABLES = {
    "twice": ("time,A.torque,A.torque\n0,1,2\n", "two columns are called 'A.torque'"),
    "open quote": ('time,"A.torque\n0,1\n1,1\n', "a quotation mark is opened and not closed"),
    "long field": (f"time,A.torque\n0,{'1' * 131073}\n", "field larger than field limit (131072), at line 2"),
    "not sorted": ("time,A.torque\n1,1\n0,2\n", "line 3: time goes back to 0"),
    "ragged": ("time,A.torque\n0,1\n1,2,3\n", "line 3: 3 columns under 2 names"),
    "short": ("time,A.torque\n0,1\n1\n", "line 3: 1 columns under 2 names"),
    "word": ("time,A.torque\n0,1\n1,two\n", "line 3 has 'two'"),
    "time": ("time,A.torque\nnan,1\n", "line 2: time is nan"),
    "infinite": ("time,A.torque\n0,1\n1,inf\n", "A.torque is inf at 1 s"),
    "no name": ("time,\n0,1\n", "column 2 has no name"),
    "no time": ("t,A.torque\n0,1\n", "its first column is 't'"),
    "semicolons": ("time;A.torque\n0;1\n", "commas between the columns"),
    "no rows": ("time,A.torque\n", "has no rows of numbers"),
    "empty": ("", "is not a table of numbers"),
    "NUL": ("time,A.torque\n0,\0\n", "line 2"),
    "not text": (b"\xff\xfe", "no text in UTF-8"),
}


@pytest.mark.parametrize("which", TABLES)
def test_a_table_that_is_none_is_one_clear_line(which, here, capsys):
    content, words = TABLES[which]
    (here / "in.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    assert main(["simulate", "slider_crank", "--input", "in.csv"]) == 1
    err = capsys.readouterr().err
    assert words in err
    assert "in.csv" in err
    assert err.count("\n") == 1
    if which != "infinite":
        assert main(["animate", "in.csv", "--mechanism", "slider_crank"]) == 1
        assert words in capsys.readouterr().err
    assert there(here) == {"in.csv"}


@pytest.mark.slow
def test_a_table_from_a_spreadsheet_is_read(here):
    (here / "in.csv").write_bytes("\ufefftime, A.torque\r\n0,1\r\n\r\n1,2\r\n".encode())
    assert main(["simulate", "slider_crank", "--input", "in.csv", "--stop-time", "0.1"]) == 0


# What is there is kept --------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([*RUN, "-o", "out.json"], "out.json: the name of a file for a table must end in .csv"),
        ([*RUN, "-o", "model.fmu"], "model.fmu: the name of a file for a table"),
        ([*RUN, "-o", "theirs.csv"], "theirs.json exists and was not written by alfmu"),
        (RUN, "particle_on_circle.csv exists and was not written by alfmu"),
        ([*RUN, "-o", "in.csv", "--input", "in.csv"], "in.csv holds the inputs of the run"),
        ([*RUN, "-o", "r.csv", "--plot", "model.fmu"], "model.fmu: the name of a file for a plot"),
        (
            ["animate", "in.csv", "-o", "model.fmu", "--mechanism", "four_bar"],
            "model.fmu: the name of a file for a film must end in",
        ),
    ],
    ids=["json", "fmu", "beside", "default", "inputs", "plot", "film"],
)
def test_nothing_of_anyone_elses_is_overwritten(arguments, words, here, capsys):
    for name in ("out.json", "model.fmu", "theirs.json", "particle_on_circle.csv"):
        (here / name).write_text('{"precious": 1}')
    (here / "in.csv").write_text("time,tangential_force\n0,0\n")
    before = {path: path.read_bytes() for path in here.iterdir()}
    assert main(arguments) == 1
    assert words in capsys.readouterr().err
    assert {path: path.read_bytes() for path in here.iterdir()} == before


@pytest.mark.slow
def test_what_is_replaced_is_said(here, capsys):
    assert main([*RUN, "--plot", "r.svg"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[-2:]] == ["wrote", "wrote"]
    assert main([*RUN, "--plot", "r.svg"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()[-2:]] == ["replaced", "replaced"]
    (here / "measured.csv").write_text("time,x\n0,1\n")
    assert main([*RUN, "-o", "measured.csv"]) == 0
    assert "replaced measured.csv" in capsys.readouterr().out
    for said in ("wrote", "replaced"):
        assert main(["export", "particle_on_circle"]) == 0
        assert capsys.readouterr().out.startswith(f"{said} particle_on_circle.fmu (")


# Results from anywhere --------------------------------------------------------------------------------------------

NOISY = """
from pathlib import Path
from alfmu import Mechanism

Path("it_ran").touch()

def noisy() -> Mechanism:
    m = Mechanism("noisy", "A bar on a hinge")
    l = m.parameter("l", 1.0, "m", minimum=1e-6)
    th = m.coordinate("th", "rad", start=0.5, independent=True)
    rod = m.bar("rod", mass=1.0, length=l)
    m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th)
    return m
"""


def test_a_film_runs_no_code(here, capsys):
    (here / "noisy.py").write_text(NOISY)
    assert main(["simulate", "noisy.py", "--stop-time", "0.1", "--set", "l=2"]) == 0
    (here / "it_ran").unlink()
    assert main(["animate", "noisy.csv", "-o", "film.html"]) == 0
    page = (here / "film.html").read_text()
    assert "A bar on a hinge" in page
    facts = json.loads((here / "noisy.json").read_text())
    assert [p[0] for p in facts["drawing"]["links"][0]["points"]] == [-1.0, 1.0]  # of the bar that was run
    assert main(["animate", "noisy.csv", "--set", "l=1"]) == 1
    assert "give that as well" in capsys.readouterr().err
    (here / "noisy.json").write_text(json.dumps({**facts, "drawing": None}))
    assert main(["animate", "noisy.csv"]) == 1
    assert "say which mechanism it is with --mechanism" in capsys.readouterr().err
    assert not (here / "it_ran").exists()
    assert main(["animate", "noisy.csv", "--mechanism", "noisy.py", "-o", "asked.html"]) == 0
    assert (here / "it_ran").exists()
    assert (here / "asked.html").read_text() == page


DEEP = "[" * 100000


@pytest.fixture(scope="module")
def slider_crank(tmp_path_factory) -> Path:
    """A result, with what is beside it."""
    path = tmp_path_factory.mktemp("result") / "r.csv"
    assert main(["simulate", "slider_crank", "--stop-time", "0.1", "-o", str(path)]) == 0
    return path


@pytest.fixture
def result(here, slider_crank) -> Path:
    """A copy of it here."""
    for name in ("r.csv", "r.json"):
        shutil.copy(slider_crank.with_name(name), here)
    return here / "r.json"


@pytest.mark.slow
@pytest.mark.parametrize("facts", ["", "{", DEEP, "[]", "3", '{"mechanism": 3}', b"\xff", '{"mechanism": "five_bar"}'])
def test_bad_facts_beside_a_result_are_said(facts, result, capsys):
    result.write_bytes(facts if isinstance(facts, bytes) else facts.encode())
    assert main(["animate", "r.csv"]) == 1
    assert capsys.readouterr().err == (
        "alfmu: r.csv: there is no r.json of alfmu beside it; say which mechanism it is with --mechanism\n"
    )
    assert main(["animate", "r.csv", "-o", "film.html", "--mechanism", "slider_crank"]) == 0


@pytest.mark.parametrize("name", ["slider_crank", "end_stop", "particle_on_circle", "bennett"])
def test_a_drawing_is_the_same_once_it_was_data(name):
    shapes = geometry(alfmu.load(name))
    assert from_data(json.loads(json.dumps(as_data(shapes)))) == shapes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("links", 0, "points", 0, 0), float("nan")),
        (("links", 0, "points", 0, 0), 1e300),
        (("links", 0, "points", 0, 0), True),
        (("links", 0, "points"), []),
        (("links", 0, "kind"), "engine"),
        (("links", 0, "name"), "rod"),
        (("links", 0), {"name": "crank"}),
        (("joints", 0, "first", "body"), "nowhere"),
        (("guides", 0, "axis"), None),
        (("links",), "crank"),
        (("name",), 3),
    ],
)
def test_a_damaged_drawing_is_told_from_a_good_one(place, value, result, capsys):
    facts = json.loads(result.read_text())
    inside = facts["drawing"]
    for key in place[:-1]:
        inside = inside[key]
    inside[place[-1]] = value
    result.write_text(json.dumps(facts))
    assert main(["animate", "r.csv"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("alfmu: r.csv: r.json has no drawing (drawing")
    assert err.endswith("; say which mechanism it is with --mechanism\n")


# FMUs from anywhere -----------------------------------------------------------------------------------------------


def changed(source: Path, to: Path, files: dict[str, Callable[[bytes], bytes | None]], more: str = "") -> Path:
    """A copy of an FMU in which some files are others, or not there, and with one more."""
    with zipfile.ZipFile(source) as before, zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as after:
        for name in before.namelist():
            data = files.get(name.split("/")[-1], lambda data: data)(before.read(name))
            if data is not None:
                after.writestr(name, data)
        if more:
            after.writestr(more, b"x")
    return to


@pytest.fixture(params=["python", "native"])
def good(request, exported, native) -> Path:
    return exported("slider_crank") if request.param == "python" else native


def test_a_model_called_like_a_path_places_its_result_here(good, here):
    folder = here / "below"
    folder.mkdir()
    os.chdir(folder)
    evil = b'modelName="../../evil model"'
    described = {"modelDescription.xml": lambda data: data.replace(b'modelName="slider_crank"', evil)}
    changed(good, here / "evil.fmu", described)
    assert main(["simulate", "../evil.fmu", "--stop-time", "0.1"]) == 0
    assert there(folder) == {"evil_model.csv", "evil_model.json"}
    assert there(here) == {"below", "evil.fmu"}


@pytest.mark.parametrize("name", ["../../out.txt", "/tmp/out.txt", "a\\..\\out.txt", "C:out.txt", "a/../../out.txt"])
def test_an_fmu_with_files_outside_its_folder_is_not_opened(name, good, here, capsys):
    changed(good, here / "evil.fmu", {}, name)
    for command in ("simulate", "validate"):
        assert main([command, "evil.fmu"]) == 1
        assert "evil.fmu is not opened: it has a file" in capsys.readouterr().err
    assert there(here) == {"evil.fmu"}


def test_an_fmu_whose_identifier_is_a_path_is_not_opened(good, here, capsys):
    evil = {"modelDescription.xml": lambda data: data.replace(b'modelIdentifier="', b'modelIdentifier="../')}
    changed(good, here / "evil.fmu", evil)
    assert main(["simulate", "evil.fmu"]) == 1
    assert "is no C identifier" in capsys.readouterr().err


def test_an_fmu_that_unpacks_to_more_than_a_disk_is_not_opened(good, here, capsys, monkeypatch):
    monkeypatch.setattr("alfmu.fmi.drive.LARGEST", 1e5)
    assert main(["validate", str(good)]) == 1
    assert "bytes, more than 1e+05" in capsys.readouterr().err


def test_a_bad_check_sum_is_said(good, here, capsys):
    data = bytearray(good.read_bytes())
    with zipfile.ZipFile(good) as archive:
        info = archive.getinfo("resources/scene.bin")
    at = info.header_offset + 30 + len(info.filename)
    (here / "cut.fmu").write_bytes(data[: len(data) // 2])
    data[at + info.compress_size // 2] ^= 255
    (here / "bad.fmu").write_bytes(data)
    for command in ("simulate", "validate"):
        assert main([command, "bad.fmu"]) == 1
        err = capsys.readouterr().err
        assert err.startswith("alfmu: bad.fmu is ")
        assert err.count("\n") == 1
        assert main([command, "cut.fmu"]) == 1
        assert "cut.fmu is not an FMU that can be read" in capsys.readouterr().err
    assert there(here) == {"bad.fmu", "cut.fmu"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda data: data[:100], "100 bytes instead of"),
        (lambda data: data[:-9] + bytes(9), "check sum does not agree"),
        (lambda data: None, "there is no scene.bin in its resources"),
    ],
    ids=["cut", "changed", "missing"],
)
def test_a_damaged_scene_in_an_fmu_is_said(damage, words, good, here, capsys):
    changed(good, here / "bad.fmu", {"scene.bin": damage})
    assert main(["simulate", "bad.fmu"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("alfmu: bad.fmu cannot be instantiated: ")
    assert words in err
    assert err.count("\n") == 1
    assert main(["validate", "bad.fmu", "--checks", "run.default"]) == 1
    out = capsys.readouterr().out
    assert "the FMU cannot be instantiated" in out
    assert words in out or good.name.startswith("slider_crank.fmu")


@pytest.mark.parametrize("options", [b"no JSON", b"[1]", b'{"mechanism": "../evil.py", "options": {}}', b"{}"])
def test_what_an_fmu_says_of_its_mechanism_is_not_believed(options, native, here, capsys):
    (here / "evil.py").write_text("raise SystemExit('it ran')")
    path = changed(native, here / "other.fmu", {"options.json": lambda data: options})
    assert main(["simulate", str(path), "--stop-time", "0.1", "-o", "r.csv"]) == 0
    assert json.loads((here / "r.json").read_text())["drawing"] is None
    capsys.readouterr()
    assert main(["animate", "r.csv"]) == 1
    assert "r.json has no drawing" in capsys.readouterr().err
    assert main(["animate", "r.csv", "-o", "film.html", "--mechanism", "slider_crank"]) == 0


# Compilers, and what libraries print ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "words"),
    [('gcc "x', 'the C compiler gcc "x cannot be run'), ("true", "the C compiler true failed (it writes no file)")],
)
def test_a_compiler_that_is_none_is_said(command, words, here, capsys, monkeypatch):
    monkeypatch.setenv("CC", command)
    monkeypatch.setenv("XDG_CACHE_HOME", str(here / "cache"))
    for arguments in (RUN, ["export", "particle_on_circle", "--kind", "python"]):
        assert main([*arguments, "--kernel", "compiled"]) == 1
        err = capsys.readouterr().err
        assert words in err
        assert err.count("\n") == 1
    assert not [path for path in here.rglob("*") if path.is_file()]


def test_linear_algebra_says_nothing_on_the_screen(capfd):
    blocks, right = [[np.full((2, 2), np.nan), np.zeros((2, 1))], [np.zeros((1, 2)), None]], [np.ones(2), np.ones(1)]
    a, lam = least_squares(blocks, right)
    assert np.isnan([*a, *lam]).all()
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "method", "given"),
    [
        *(("vm", "auto", given) for given in ("m1=1e308", "A.torque=1e308", "g=1e308")),
        *(("oracle", "rk4", given) for given in ("m1=1e308", "m3=1e200")),
        ("vm", "rk4", "A.torque=1e308"),
    ],
)
def test_numbers_beyond_all_bounds_are_one_clear_line(kernel, given, method, here, capfd):
    arguments = ["simulate", "slider_crank", "--kernel", kernel, "--stop-time", "0.1", "--set", given]
    code = main([*arguments, "--set", f"solver.method={method}"])
    said = capfd.readouterr()
    assert said.err.count("\n") == code <= 1
    assert "**" not in said.out + said.err
