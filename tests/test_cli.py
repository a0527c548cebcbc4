"""The command line as its users call it: every command, every help text, and no traceback for a user's mistake."""

import argparse
import contextlib
import csv
import io
import json
import os
import pty
import re
import subprocess
import sys
import termios
import zipfile
from collections import OrderedDict
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import alfmu
from alfmu.cli import GROUPS, _parser, main
from alfmu.cli.options import name_list
from alfmu.kernel import VERSION
from alfmu.kernel.tables import MAGIC
from alfmu.runtime import library as binding
from alfmu.runtime import pipeline, shipped
from alfmu.runtime.library import library

PENDULUM = """
from alfmu import Mechanism

def pendulum() -> Mechanism:
    m = Mechanism("pendulum", "A bar on a hinge")
    l = m.parameter("l", 1.0, "m", minimum=1e-6)
    th = m.coordinate("th", "rad", start=0.5, independent=True)
    rod = m.bar("rod", mass=1.0, length=l)
    m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=th)
    m.gravity(0, -9.81)
    return m
"""


def read(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    return {name: np.array([float(row[i]) for row in rows[1:]]) for i, name in enumerate(rows[0])}


@cache
def info(*arguments: str) -> str:
    """What `alfmu info` says, asked once."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert main(["info", *arguments]) == 0
    return out.getvalue()


@pytest.mark.slow
def test_the_whole_job_export_validate_simulate_plot_animate(here, capsys):
    assert main(["export", "five_bar"]) == 0
    assert main(["validate", "five_bar.fmu"]) == 0
    assert "0 problems found" in capsys.readouterr().out
    arguments = ["simulate", "five_bar.fmu", "--stop-time", "1", "--step", "0.02", "-o", "out/r.csv", "--plot", "r.png"]
    assert main(arguments) == 0
    result = read(here / "out" / "r.csv")
    library = alfmu.simulate("five_bar", 1.0, 0.02)
    assert np.array_equal(result["link1.angle"], library["link1.angle"])
    assert np.array_equal(result["time"], library.time)
    assert (here / "r.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((here / "out" / "r.json").read_text())["mechanism"] == "five_bar"
    assert main(["animate", "out/r.csv", "-o", "film.html", "--fps", "10"]) == 0
    assert "<canvas" in (here / "film.html").read_text()


@pytest.mark.slow
def test_a_mechanism_of_the_users_own_works_wherever_a_name_does(here, capsys):
    (here / "pendulum.py").write_text(PENDULUM)
    assert main(["info", "pendulum.py"]) == 0
    assert "degrees of freedom: 1, redundant constraints: 0" in capsys.readouterr().out
    assert main(["export", "pendulum.py", "--set", "l=2"]) == 0
    assert main(["validate", "pendulum.fmu"]) == 0
    assert main(["simulate", "pendulum.fmu", "--stop-time", "0.5", "-o", "fmu.csv"]) == 0
    assert main(["simulate", "pendulum.py", "--set", "l=2", "--stop-time", "0.5", "-o", "file.csv"]) == 0
    a, b = read(here / "fmu.csv"), read(here / "file.csv")
    assert all(np.array_equal(a[name], b[name]) for name in b)
    assert main(["animate", "file.csv"]) == 0
    assert (here / "file.gif").read_bytes().startswith(b"GIF89a")


@pytest.mark.slow
def test_another_distribution_can_register_a_mechanism(here, distribution, capsys):
    distribution("their_linkages", PENDULUM, "[alfmu.mechanisms]\ntheir_pendulum = their_linkages:pendulum\n")
    assert main(["list"]) == 0
    assert "their_pendulum" in capsys.readouterr().out
    assert main(["export", "their_pendulum", "-o", "p.fmu"]) == 0
    assert main(["validate", "p.fmu"]) == 0


@pytest.mark.parametrize(
    ("module", "says"),
    [
        (
            "from alfmu import Mechanism\n\n\ndef broken():\n    m = Mechanism('broken')\n    return m.nothing\n",
            "line 6: Attr",
        ),
        ("import alfmu\n\nlost = alfmu.nothing\n", "line 3: Attr"),
    ],
)
def test_what_a_registered_mechanism_raises_is_said_with_its_line(here, distribution, capsys, module, says):
    name = "their_broken" if "def" in module else "their_lost"
    distribution(name, module, f"[alfmu.mechanisms]\nbroken = {name}:broken\n")
    for command in (["info", "broken"], ["simulate", "broken"], ["export", "broken", "-o", "x.fmu"]):
        assert main(command) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert re.search(rf"broken: \S*{name}.py, {says}ibuteError: ", err)


@pytest.mark.slow
def test_options_parameters_and_inputs_reach_the_run(here):
    (here / "in.csv").write_text("time,A.torque\n0,1\n0.5,2\n1,2\n")
    arguments = ["simulate", "slider_crank", "--option", "coordinates=joint", "--set", "b=0.1", "--input", "in.csv"]
    assert main([*arguments, "--stop-time", "1", "--step", "0.05"]) == 0
    result = read(here / "slider_crank.csv")
    assert result["A.torque"] == pytest.approx(np.interp(result["time"], [0, 0.5, 1], [1, 2, 2]))
    equations = alfmu.derive(alfmu.load("slider_crank", coordinates="joint"))
    torque = ([0.0, 0.5, 1.0], [1.0, 2.0, 2.0])
    library = alfmu.simulate(equations, 1.0, 0.05, parameters={"b": 0.1}, inputs={"A.torque": torque})
    assert np.array_equal(result["guide.force"], library["guide.force"])


@pytest.mark.slow
def test_info_of_many_bodies_stays_short():
    """One line for all that differ in numbers of names alone; every number of a few; in short, how many were left."""
    text = info("n_four_bar", "--option", "loops=12", "--all")
    assert len(text.splitlines()) < 120
    assert "option loops = 12 (whole number)" in text
    assert "coordinates (26): x1 [m], y1 [m], x2 [m]" in text
    for line in (
        r"coupler\{1\.\.12\}\.x +m +position of the centre of mass of coupler\{1\.\.12\} along x",
        r"C\{1\.\.12\}\.force\.y +N +force along y on coupler\{1\.\.12\} from crank\{2\.\.13\}",
        r"multiplier\[\{14\.\.25\}\] +N +multiplier of coupler\{1\.\.12\}\.length, length",
    ):
        assert re.search(f"^  {line}$", text, re.M)
    out = info("n_four_bar", "--option", "loops=12")
    assert len(out.splitlines()) <= 20
    assert max(map(len, out.splitlines())) < 130
    assert "constraints (25): crank1.length length" in out
    shown = re.search(r"constraints \(25\): (.*) and (\d+) more", out)
    assert len(shown[1].split(", ")) + int(shown[2]) == 25
    assert "crank{1..13}, coupler{1..12} (9 each)" in out


def test_list_names_every_registered_mechanism_and_its_options(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    for name in alfmu.mechanisms():
        assert f"\n{name} " in f"\n{out}"
    assert "coordinates=absolute|joint|mixed|natural" in out


@pytest.mark.slow
def test_info_counts_freedoms_and_redundancy_and_says_which_reactions_are_unique():
    out = info("five_bar", "--all")
    assert "degrees of freedom: 1, redundant constraints: 1, singular at the start: 2 motions possible" in out
    assert "E ---- link4 ---- F" in out
    for name in ("A.torque", "link4.angular_acceleration", "multiplier[8]", "monitor.energy", "solver.formulation"):
        assert name in out
    (line,) = (x for x in out.splitlines() if x.startswith("not unique"))
    names = line.split(": ")[1].split(", ")
    assert names == [f"{joint}.force.x" for joint in "ABCDEF"] + [f"multiplier[{i}]" for i in (1, 3, 5, 7)]
    assert "not unique" not in info("four_bar")


@pytest.mark.parametrize("command", ["list", "info", "export", "simulate", "validate", "animate", "completion"])
def test_help_explains_every_command(command, capsys):
    with pytest.raises(SystemExit) as exit_:
        main([command, "--help"])
    assert exit_.value.code == 0
    assert "usage: alfmu" in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["help"], ["help", "draw"]], ids=" ".join)
def test_whoever_gives_no_command_or_asks_for_help_is_shown_what_there_is(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == (0 if words else 2)
    said = "".join(capsys.readouterr())
    assert "raw a mechanism in its start position" in said
    assert ("page that runs" in said) == (len(words) < 2)


def test_a_source_folder_in_the_way_of_the_installed_package_is_named(tmp_path):
    (tmp_path / "alfmu" / "runtime").mkdir(parents=True)
    with pytest.raises(OSError, match=r"is missing.*install alfmu again"):
        library(tmp_path / "alfmu" / "runtime")
    (tmp_path / "pyproject.toml").touch()
    library.cache_clear()
    with pytest.raises(OSError, match=r"from its source folder .* run this in another folder, or build it there"):
        library(tmp_path / "alfmu" / "runtime")


STALE = {
    "version": ((shipped, "VERSION", VERSION + 1), rf"its scenes have version {VERSION}, .* the package {VERSION + 1}"),
    "functions": ((binding, "_SIGNATURES", {"newer": (None,)}), "undefined symbol: alfmu_newer|alfmu_newer"),
}


@pytest.mark.parametrize(("newer", "why"), STALE.values(), ids=STALE)
def test_a_library_of_older_sources_is_to_be_built_again(newer, why, monkeypatch, capsys):
    """Sources get newer by `git pull`; what they read and call is in this table."""
    monkeypatch.setattr(*newer)
    monkeypatch.setattr(pipeline, "_KEPT", OrderedDict())  # scenes that tests before have loaded
    for known in (library, shipped.installed):
        known.cache_clear()
    try:
        assert main(["simulate", "particle_on_circle", "--stop-time", "0.1"]) == 1
        said = capsys.readouterr().err
        assert re.search(
            rf"^alfmu: .*was built from other sources.*\(.*{why}.*\); build it again: python .*build\.py$", said
        )
        with pytest.raises(alfmu.LibraryError, match=why):
            alfmu.Instance("particle_on_circle")
    finally:
        for known in (library, shipped.installed):
            known.cache_clear()


@pytest.mark.parametrize("kind", ["native", "python"])
def test_an_fmu_with_a_scene_of_another_version_is_to_be_exported_again(kind, fmu_of, tmp_path, capsys):
    path = tmp_path / "old.fmu"
    with zipfile.ZipFile(fmu_of("particle_on_circle", kind=kind)) as good, zipfile.ZipFile(path, "w") as old:
        for name in good.namelist():
            data = good.read(name)
            if data.startswith(MAGIC):
                data = data[:8] + (VERSION - 1).to_bytes(4, "little") + data[12:]
            old.writestr(name, data)
    assert main(["simulate", str(path), "--stop-time", "0.1"]) == 1
    said = capsys.readouterr().err
    assert f"its version is {VERSION - 1} and this runtime reads {VERSION}; export it again" in said
    assert "Traceback" not in said


MISTAKES = [
    (["info", "nonsense"], "no mechanism 'nonsense'"),
    (["info", "missing.py"], "there is no file missing.py"),
    (["info", "broken.py"], "broken.py, line 1: ZeroDivisionError"),
    (["info", "typo.py"], "typo.py, line 1: "),
    (["info", "empty.py"], "empty.py declares no mechanism; write `def empty() -> Mechanism:`"),
    (["info", "unmarked.py"], "or mark the one that is there: `def swing(...) -> Mechanism:`"),
    (["info", "twins.py"], "twins.py declares several mechanisms, one(), two(); write `def twins() -> Mechanism:`"),
    (["info", "empty"], "there is no mechanism 'empty'; did you mean empty.py? Use one of bennett"),
    (["info", "fivebar"], "did you mean five_bar? Use one of bennett"),
    (["live", "five_bar.fmu"], "five_bar.fmu is an FMU; give the mechanism instead"),
    (["simulate", "five_bar.csv"], "five_bar.csv is a table; give the mechanism instead"),
    (["animate", "empty.py"], "empty.py is not a result; `alfmu simulate` writes one"),
    (["info", "slider_crank", "--option", "coordinates=polar"], "use one of absolute, joint, mixed, natural"),
    (["info", "five_bar", "--option", "colour=red"], "has no option 'colour'; it has coordinates"),
    (["export", "five_bar", "--set", "m9=1"], "no input or parameter 'm9'"),
    (["export", "five_bar", "--set", "m2=heavy"], "must be a finite number in kg"),
    (["export", "five_bar", "--set", "m2=nan"], "must be a finite number in kg"),
    (["export", "slider_crank", "--set", "l2=0.2"], "the loops cannot be closed"),
    (["export", "five_bar", "-o", "five_bar.zip"], "does not end in .fmu"),
    (["simulate", "five_bar", "--step", "0"], "must be a finite number above zero"),
    (["simulate", "five_bar", "--stop-time", "-1"], "must be a finite number above zero"),
    (["simulate", "missing.fmu"], "missing.fmu"),
    (["simulate", "broken.fmu"], "not an FMU that can be read"),
    (["simulate", "five_bar", "--input", "missing.csv"], "missing.csv"),
    (["simulate", "five_bar", "--input", "words.csv"], "not a table of numbers"),
    (["simulate", "five_bar", "--input", "unknown.csv"], "no input or parameter 'Z.torque'"),
    (["simulate", "five_bar", "--input", "bad.csv", "--stop-time", "1"], "A.torque is nan"),
    (["simulate", "five_bar", "--stop-time", "0.1", "-o", "/dev/null/r.csv"], "cannot write"),
    (["simulate", "five_bar", "--plot-names", "*.angle"], "--plot-names needs --plot"),
    (
        ["simulate", "four_bar", "--kernel", "oracle", "--set", "solver.method=explicit"],
        "the oracle has no solver.method",
    ),
    (["simulate", "x.fmu", "--kernel", "oracle"], "the kernel of an FMU are fixed"),
    (["validate", "missing.fmu"], "missing.fmu"),
    (["animate", "missing.csv"], "missing.csv"),
    (["animate", "bare.csv"], "--mechanism"),
    (["animate", "bare.csv", "--mechanism", "five_bar"], "link1"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "words"), MISTAKES, ids=[" ".join(a) for a, _ in MISTAKES])
def test_a_mistake_is_one_clear_line_and_exit_code_1(arguments, words, here, capsys):
    (here / "broken.py").write_text("1 / 0\n")
    (here / "typo.py").write_text("def f(:\n")
    (here / "empty.py").write_text("x = 1\n")
    (here / "unmarked.py").write_text("def swing():\n    return 1\n")
    marked = "".join(f"def {name}() -> Mechanism:\n    return Mechanism({name!r})\n" for name in ("one", "two"))
    (here / "twins.py").write_text(f"from alfmu import Mechanism\n{marked}")
    (here / "broken.fmu").write_text("no archive")
    (here / "words.csv").write_text("time,A.torque\n0,many\n")
    (here / "unknown.csv").write_text("time,Z.torque\n0,1\n")
    (here / "bad.csv").write_text("time,A.torque\n0,1\n0.5,nan\n1,1\n")
    (here / "bare.csv").write_text("time,x\n0,1\n1,2\n")
    assert main(arguments) == 1
    err = capsys.readouterr().err
    assert words in err
    assert err.startswith("alfmu: ")
    assert "Traceback" not in err
    assert err.count("\n") == 1


def test_wrong_usage_is_exit_code_2(capsys):
    for arguments in (
        [],
        ["fly"],
        ["export"],
        ["export", "five_bar", "--set", "m2"],
        ["simulate", "x", "--step", "soon"],
    ):
        with pytest.raises(SystemExit) as exit_:
            main(arguments)
        assert exit_.value.code == 2
        assert "usage: alfmu" in capsys.readouterr().err


@pytest.mark.slow
def test_a_reader_that_stops_listening_gets_no_traceback():
    command = f"{sys.executable} -m alfmu.cli info five_bar | head -1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=120)
    assert done.stdout.startswith("five_bar")
    assert done.stderr == ""


@pytest.mark.slow
def test_a_long_run_shows_its_progress_on_a_terminal(tmp_path):
    master, terminal = pty.openpty()
    termios.tcsetwinsize(terminal, (24, 100))
    command = [sys.executable, "-m", "alfmu.cli", "simulate", "slider_crank", "--stop-time", "20"]
    command += ["--step", "0.02", "--set", "solver.method=rk4", "--set", "solver.step_size=1e-5"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=terminal, stdout=subprocess.DEVNULL) as run:
        os.close(terminal)
        shown = ""
        with contextlib.suppress(OSError):  # the terminal is gone when the command ends
            while chunk := os.read(master, 1000):
                shown += chunk.decode()
    os.close(master)
    assert run.returncode == 0
    assert "simulating" in shown
    assert "%" in shown


@pytest.mark.slow
def test_info_shows_what_fmus_carry(capsys, tmp_path):
    assert main(["info", "particle_on_circle", "--sizes"]) == 0
    said = capsys.readouterr().out
    kinds = said.split("FMU of kind ")[1:]
    for text in kinds:
        sizes = [float(line.split()[-1]) for line in text.split("\n\n")[0].splitlines()[1:]]
        assert sizes[-1] == pytest.approx(sum(sizes[:-1]), abs=0.5)
        assert min(sizes) >= 0.0
    path = alfmu.export("particle_on_circle", tmp_path, kind="native")
    with zipfile.ZipFile(path) as archive:
        libraries = [i for i in archive.infolist() if i.filename.startswith("binaries")]
        scene = archive.getinfo("resources/scene.bin").file_size
    packed, whole = (sum(getattr(i, name) for i in libraries) / 1000 for name in ("compress_size", "file_size"))
    assert f"compiled libraries {packed:.1f} {whole:.1f}" in " ".join(kinds[0].split())
    parts = [float(line.split()[-1]) for line in kinds[-1].split("\n\n")[1].splitlines()[1:]]
    assert sum(parts) == pytest.approx(scene / 1000, abs=0.5)
    assert "steps and outputs that iterate until they converge" in said


@pytest.mark.slow
@pytest.mark.parametrize("name", alfmu.mechanisms())
def test_info_fits_on_a_screen(name):
    lines = info(name).splitlines()
    assert len(lines) <= 20
    e = alfmu.derive(alfmu.load(name))
    assert lines[0] == f"{name}: {e.description}"
    text = "\n".join(lines)
    for said in (f"coordinates ({e.n}): {e.coordinates[0].name} [", f"constraints ({e.l}): ", "degrees of freedom: "):
        assert said in text
    parameters = next(line for line in lines if line.startswith("parameters: "))
    assert f"{e.parameters[0].name} = {e.parameters[0].start:g}" in parameters
    assert f"run: {e.stop_time:g} s in steps of {e.interval:g} s, method " in text


def test_info_counts_the_outputs_that_it_leaves_out():
    named = "link1, link2, link3 (9 each); A, B, C, D (force.x, force.y)"
    assert f"outputs (47): {named} and {47 - 3 * 9 - 4 * 2} more" in info("four_bar")


@pytest.mark.slow
def test_info_in_full_has_no_empty_place_for_a_sketch_or_options(tmp_path):
    file = tmp_path / "held.py"
    file.write_text(
        "from alfmu import Mechanism\n\n\ndef held() -> Mechanism:\n    m = Mechanism('held')\n"
        "    x = m.coordinate('x', 'm', independent=True)\n    m.kinetic_energy(m.rate(x) ** 2)\n    return m\n"
    )
    for name in (str(file), "four_bar"):
        assert "\n\n\n" not in info(name, "--all")


@pytest.mark.slow
def test_info_as_json_has_all_of_it(capsys):
    assert main(["info", "five_bar", "--json", "--set", "m2=2.5"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["degrees_of_freedom"], found["redundant_constraints"], found["motions_at_start"]) == (1, 1, 2)
    assert found["options"] == {"coordinates": {"value": "mixed", "choices": ["mixed", "joint"]}}
    parameters = {v["name"]: v for v in found["parameters"]}
    assert (parameters["m2"]["start"], parameters["m2"]["unit"], parameters["m2"]["minimum"]) == (2.5, "kg", 0.0)
    assert "A.force.x" in found["not_unique"]
    assert [c["name"] for c in found["coordinates"]][:3] == ["th1", "x2", "y2"]
    assert len(found["constraints"]) == 8
    assert {"name": "A.torque", "unit": "N.m"}.items() <= found["inputs"][0].items()
    assert "monitor.energy" in {v["name"] for v in found["outputs"]}
    assert found["operations"]["careful_step"] > found["operations"]["step"] > 100


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["simulte", "five_bar"], "there is no command 'simulte'; did you mean simulate?"),
        (["fly"], "there is no command 'fly'; use one of list, info, "),
        (["simulate", "five_bar", "--stop-tme", "3"], "--stop-tme is not understood; did you mean --stop-time?"),
        (["info", "five_bar", "extra"], "extra is not understood"),
        (["simulate", "five_bar", "--set", "m2=2", "m3=2"], "each value takes a --set of its own: --set m3=2"),
        (["info", "five_bar", "--all", "--json"], "not allowed with"),
    ],
    ids=lambda x: " ".join(x) if isinstance(x, list) else "",
)
def test_a_misspelt_command_or_option_is_answered_by_the_nearest(arguments, says, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(arguments)
    assert exit_.value.code == 2
    assert says in capsys.readouterr().err


def completions(line: str, folder: Path) -> list[str]:
    """What a shell is offered at the end of a line."""
    command = [sys.executable, "-m", "alfmu"]
    environment = {**os.environ, "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "COMP_LINE": line}
    environment |= {"COMP_POINT": str(len(line)), "_ARGCOMPLETE_STDOUT_FILENAME": str(folder / "offered")}
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=60)
    assert done.stdout == ""
    return (folder / "offered").read_text().split()


@pytest.mark.slow
def test_a_shell_completes_commands_options_names_and_files(tmp_path, capsys):
    pytest.importorskip("argcomplete")
    for name in ("fourth.fmu", "fox.py", "foo.txt"):
        (tmp_path / name).write_text("")
    assert completions("alfmu sim", tmp_path) == ["simulate"]
    assert completions("alfmu info fo", tmp_path) == ["four_bar", "four_cylinders", "fox.py"]
    assert completions("alfmu simulate fo", tmp_path) == ["four_bar", "four_cylinders", "fourth.fmu", "fox.py"]
    assert completions("alfmu simulate four_bar --ker", tmp_path) == ["--kernel"]
    assert completions("alfmu simulate four_bar --kernel or", tmp_path) == ["oracle"]
    assert main(["completion", "bash"]) == 0
    assert "complete " in (script := capsys.readouterr().out)
    assert "alfmu" in script


@pytest.mark.slow
def test_options_of_several_names_may_be_given_many_times(here, capsys):
    """None is lost, as the first of two would be where the second takes its place."""
    for name, sub in _parser()[1].items():
        for each in sub._actions:
            if each.option_strings and (each.nargs == "+" or each.type is name_list):
                assert isinstance(each, argparse._ExtendAction), (name, each.option_strings)
    words = ["sweep", "four_bar", "--vary", "m2=1", "--stop-time", "0.02", "--workers", "1", "--no-page", "-o", "few"]
    assert main([*words, "--keep", "final(link1.angle)", "--keep", "final(link3.angle)", "final(link2.x)"]) == 0
    kept = ("final(link1.angle)", "final(link3.angle)", "final(link2.x)")
    assert alfmu.Sweep.load("few").plan.measures == kept
    assert main(["simulate", "four_bar", "--stop-time", "0.02", "--lock", "B", "--lock", "C", "-o", "run.csv"]) == 0
    assert {"B.locked", "C.locked"} <= set(alfmu.Result.from_csv("run.csv").names)


def test_the_help_has_every_command_in_one_group(capsys):
    _, commands = _parser()
    grouped = [name for names in GROUPS.values() for name in names]
    assert sorted(grouped) == sorted(commands)
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    named = [line.split()[0] for line in lines if re.match(r" {4}\w", line)]
    assert named == grouped
    assert [line.strip() for line in lines if re.fullmatch(r"  \w+", line)] == list(GROUPS)


COUNTED = """
from pathlib import Path

from alfmu import Mechanism

with Path("runs").open("a") as file:
    file.write("x")

def counted(n: int = 1) -> Mechanism:
    m = Mechanism("counted")
    rod = m.bar("rod", mass=2.0, length=1.0)
    m.revolute("A", m.ground.at(0, 0), rod.start, coordinate=m.coordinate("th", start=0.5, independent=True))
    return m
"""


@pytest.mark.parametrize("command", ["simulate", "info", "draw", "export", "equilibrium", "linearize", "mobility"])
def test_a_file_that_declares_a_mechanism_runs_once(here, command):
    (here / "counted.py").write_text(COUNTED)
    assert main([command, "counted.py"]) == 0
    assert (here / "runs").read_text() == "x"


def test_a_run_tells_of_gravity_and_of_the_solver_when_it_is_asked(here, capsys):
    """In half a second from rest the bar falls by an angle that energy and a quadrature give."""
    fall = COUNTED.replace("counted", "fall").replace("return m", "m.gravity(0, -9.81)\n    return m")
    (here / "fall.py").write_text(fall)
    assert main(["simulate", "fall.py", "--stop-time", "0.5"]) == 0
    out = capsys.readouterr().out.splitlines()
    (said,) = [line for line in out if line.startswith("gravity")]
    assert len(out) == 2
    angle = read(here / "fall.csv")["rod.angle"]
    varied = 2.0 * 9.81 * 0.5 * np.ptp(np.sin(angle))
    assert said.startswith(f"gravity: 9.81 m/s2 along -y; its potential varied by {varied:.3g} J (100 % of both), the")
    assert main(["simulate", "fall.py", "--stop-time", "0.5", "--verbose"]) == 0
    assert "multiplier iterations" in capsys.readouterr().out
    assert main(["info", "fall.py"]) == 0
    assert "gravity: 9.81 m/s2 along -y, 19.6 N on all bodies" in capsys.readouterr().out
    (here / "fall.py").write_text(fall.replace("-9.81", "9.81"))
    assert main(["info", "fall.py"]) == 0
    assert "gravity: 9.81 m/s2 along +y, which is upwards, 19.6 N" in capsys.readouterr().out
    (here / "counted.py").write_text(COUNTED)
    for command in ("info", "simulate"):
        assert main([command, "counted.py"]) == 0
        assert (
            "gravity: bodies have masses and no gravity acts; declare it by gravity(0, -9.81)"
            in capsys.readouterr().out
        )


@pytest.mark.slow
def test_a_mass_that_is_set_in_grams_is_doubted(here, capsys):
    assert main(["info", "five_bar", "--set", "m2=500"]) == 0
    assert "the mass of link2 is 500 kg, 500 times that of any other body; if grams" in capsys.readouterr().err
