"""The benchmark script at its smallest effort: files, rows, ratios and verdicts hang together."""

import re
import subprocess
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from studies import agree, number, rows, tables

import alfmu
from alfmu.catalogue.registry import mechanisms

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def benchmark(quick_compiler):
    """The script as a module, under a name that its child processes find too."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        import benchmark

        scenes = ("particle_on_circle", "five_bar", "five_bar, frozen")
        patch.setattr(benchmark, "SCENES", {name: benchmark.SCENES[name] for name in scenes})
        effort = replace(benchmark.QUICK, rounds=2, lap=1e-4, runs=1, builds=1)
        effort = replace(effort, horizon=0.2, mechanisms=("five_bar", "end_stop"), loops=(1, 4))
        few = {"QUICK": effort, "BASE": 4, "STOP": 5.0, "DIFFERENTIATED": ("five_bar",), "OPTIMISED": "-O0"}
        for name, value in few.items():
            patch.setattr(benchmark, name, value)
        yield benchmark


@pytest.fixture(scope="module")
def folder(benchmark, tmp_path_factory):
    """Results of all studies."""
    made = tmp_path_factory.mktemp("benchmark")
    assert benchmark.main(["--quick", "-o", str(made)]) == 0
    return made


def test_everything_that_was_promised_is_there(folder):
    names = {path.name for path in folder.iterdir()}
    studies = ("environment", "targets", "step", "spread", "dostep", "native", "gradient", "scale")
    assert names == {"benchmark.md", "scale.png", *(f"{name}.csv" for name in studies)}
    assert (folder / "scale.png").stat().st_size > 10_000
    assert [row["scene"] for row in rows(folder, "step")] == ["particle_on_circle", "five_bar", "five_bar, frozen"]
    assert [(row["mechanism"], row["kernel"]) for row in rows(folder, "spread")] == [
        (name, kernel) for name in ("five_bar", "end_stop") for kernel in ("vm", "compiled")
    ]
    assert [row["slave"] for row in rows(folder, "dostep")] == 2 * ["empty", "vm", "vm", "compiled", "compiled"]
    assert [(row["coordinates"], row["N"]) for row in rows(folder, "scale")] == [("natural", "1"), ("natural", "4")]
    machine = {row["what"]: row["value"] for row in rows(folder, "environment")}
    assert machine["command"] == "`python scripts/benchmark.py --quick`"
    assert {"processor", "Python", "C compiler", "casadi", "numpy", "fmpy", "pythonfmu"} < machine.keys()


def test_every_table_of_the_report_shows_rows_of_its_csv_file(folder):
    found = tables(folder / "benchmark.md")
    studies = {"step", "spread", "dostep", "native", "gradient", "scale"}
    assert {name for _, name, _, _ in found} == {"environment", "targets"} | studies
    for _, name, columns, lines in found:
        kept = rows(folder, name)
        assert len(lines) == len(kept), name
        for line, row in zip(lines, kept, strict=True):
            for column, shown in zip(columns, line, strict=True):
                assert agree(shown, row[column]), (name, column, shown, row[column])
    empty = [(n, c) for _, n, columns, lines in found for i, c in enumerate(columns) if {x[i] for x in lines} == {"-"}]
    assert empty == []  # with a compiler, every column is measured somewhere


def test_ratios_follow_from_the_times_beside_them(benchmark, folder):
    checked = 0
    for name in ("step", "scale"):
        for row in rows(folder, name):
            for column in row:
                if match := re.fullmatch(r"(.+) / solve", column):
                    expected = float(row[f"{match[1]} [us]"]) / float(row["solve [us]"])
                elif match := re.fullmatch(r"oracle / (.+)", column):
                    expected = float(row["oracle step [us]"]) / float(row[f"{match[1]} [us]"])
                elif match := re.fullmatch(r"interpreted / compiled (.+)", column):
                    expected = float(row[f"vm {match[1]} [us]"]) / float(row[f"compiled {match[1]} [us]"])
                else:
                    continue
                assert float(row[column]) == pytest.approx(expected, rel=1e-12), (name, column)
                checked += 1
    assert checked == 3 * (15 + 4 + 2) + 2 * 3
    for row in rows(folder, "gradient"):
        for column in ("gradient", f"forward by {benchmark.DIRECTIONS}"):
            expected = float(row[f"{column} [us]"]) / float(row["run [us]"])
            assert float(row[f"{column} / run"]) == pytest.approx(expected, rel=1e-12)
    through = rows(folder, "dostep")
    empty = {row["step [s]"]: row for row in through if row["slave"] == "empty"}
    assert len(empty) == 2
    for row in through:
        ratio = float(row["doStep [us]"]) / float(empty[row["step [s]"]]["doStep [us]"])
        assert float(row["doStep / empty"]) == pytest.approx(ratio, rel=1e-12)
    one, four = rows(folder, "scale")
    compared = [column for column in one if column.endswith(" per loop / at 4")]
    assert len(compared) == 7
    for column in compared:
        quantity = column.removesuffix(" per loop / at 4")
        assert float(one[column]) == pytest.approx(4 * float(one[quantity]) / float(four[quantity]), rel=1e-12)
        assert float(four[column]) == 1.0


def test_numbers_are_those_of_what_they_claim_to_measure(benchmark, folder):
    for row in [*rows(folder, "step"), *rows(folder, "scale")]:
        assert {row["vm quick steps [%]"], row["compiled quick steps [%]"]} == {"100"}
        times = {column: float(x) for column, x in row.items() if column.endswith("[us]") and "minimum" not in column}
        for column, median in times.items():
            assert 0 < float(row[column.replace(" [us]", ", minimum [us]")]) <= median < 1e6
    for row in rows(folder, "step"):
        parts = [float(x) for column, x in row.items() if column.startswith("operations: ")]
        assert sum(parts[:-3]) == parts[-3]  # the step; a careful one and the outputs come after it
        assert sum(float(x) for column, x in row.items() if column.startswith("time: ")) == pytest.approx(100)
        # A hundred times as long, which no load of the machine turns round; interpreted and compiled are closer.
        assert float(row["oracle step [us]"]) > max(float(row[f"{kernel} step [us]"]) for kernel in benchmark.KERNELS)
    for row in (row for row in rows(folder, "dostep") if row["slave"] != "empty"):
        steps = [int(row[tier]) for tier in benchmark.TIERS]
        assert sum(steps) == int(row["steps in a run"]) == round(benchmark.STOP / float(row["step [s]"]))
        assert steps[0] > 10 * steps[2]
        assert steps[3] <= (row["motion"] == benchmark.PASSING) * 0.01 * sum(steps)
        assert (steps[2] > 0) == (row["motion"] == benchmark.PASSING)
    for row in rows(folder, "spread"):
        dt = alfmu.derive(alfmu.load(row["mechanism"])).step_size
        for what, step in (("", dt), (" at 1/20", dt / 20)):
            assert int(row[f"steps{what}"]) == round(0.2 / step)
            slowest, median = float(row[f"slowest{what} [us]"]), float(row[f"median{what} [us]"])
            assert float(row[f"slowest / median{what}"]) == pytest.approx(slowest / median, rel=1e-12)
            assert 0 < median <= slowest < 1e6
            assert 0 <= float(row[f"slowest step{what} begins at [s]"]) < 0.2
        assert row["note"] == ""
    for row in rows(folder, "gradient"):
        assert int(row["numbers"]) > 5
        assert float(row["gradient / run"]) > 1.0  # it makes the run
    one, four = rows(folder, "scale")
    assert float(four["operations"]) > 2.5 * float(one["operations"])
    assert [row["builds"] for row in (one, four)] == ["1", "1"]


def test_every_target_has_a_verdict_that_follows_from_its_number(benchmark, folder):
    judged = rows(folder, "targets")
    limits = [row["target"] for row in judged]
    step = [limit for limit in ("<= 0.3", "<= 1.6", ">= 50", ">= 50") for _ in range(2)]
    assert limits == [
        *step,
        *["<= 60"] * 4 * len(mechanisms()),
        *["<= 3"] * 4,
        *["<= 4"] * 4,
        "<= 1.3",
        "<= 2.5",
        "<= 1000",
        "<= 300",
        *["<= 6"] * 6,
        *["<= 1.5", "<= 2", "<= 30", "<= 2000"] * 2,
    ]
    for row, target in zip(judged, benchmark.TARGETS, strict=True):
        key = target.row.items()
        found = [r for r in rows(folder, target.study) if all(r[name] == str(x) for name, x in key)]
        value = number(found[0][target.column]) if found else None
        assert number(row["measured"]) == value
        if value is None:
            # Studies of few loops, and of some mechanisms.
            assert row["study"] == "scale" or target.row.get("mechanism") not in ("five_bar", "end_stop", None)
            assert row["verdict"] == "not measured"
        else:
            sign, limit = row["target"].split()
            good = value >= float(limit) if sign == ">=" else value <= float(limit)
            assert row["verdict"] == ("met" if good else "not met")
    assert sum(row["verdict"] != "not measured" for row in judged) == 8 + 8 + 8 + 4 + 2


@pytest.mark.parametrize(
    ("value", "at_least", "verdict"), [(0.5, False, "met"), (2.0, False, "not met"), (0.5, True, "not met")]
)
def test_verdicts_go_both_ways(benchmark, value, at_least, verdict):
    target = benchmark.Target("step", {"scene": "five_bar"}, "ratio", 1.0, at_least)
    results = {"step": [{"scene": "four_bar", "ratio": 1.0}, {"scene": "five_bar", "ratio": value}]}
    from _study import judged

    assert judged(target, results)["verdict"] == verdict
    assert judged(target, {})["verdict"] == "not measured"


def test_without_a_compiler_the_report_says_what_is_missing(benchmark, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    assert benchmark.main(["--quick", "--only", "dostep", "-o", str(tmp_path)]) == 0
    text = (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    assert "| without compiled code as | the C compiler no-such-compiler cannot be run" in text
    slaves = rows(tmp_path, "dostep")
    assert [row["slave"] for row in slaves] == 2 * ["empty", "vm", "vm"]
    verdicts = {(row["study"], row["row"]): row["verdict"] for row in rows(tmp_path, "targets")}
    assert verdicts["step", "five_bar"] == "not measured"
    for motion, dt in product(benchmark.MOTIONS, (benchmark.DT, benchmark.SHORTER)):
        assert verdicts["dostep", f"compiled, {motion}, {dt}"] == "not measured"
        assert verdicts["dostep", f"vm, {motion}, {dt}"] in ("met", "not met")
    assert not (tmp_path / "step.csv").exists()


def test_mistakes_of_the_user_are_explained_without_a_traceback(benchmark, tmp_path, capsys):
    file = tmp_path / "file"
    file.touch()
    command = [sys.executable, str(SCRIPTS / "benchmark.py"), "-o", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    for arguments, words in ((["--only", "steps"], "invalid choice"), (["--quick", "--full"], "not allowed with")):
        with pytest.raises(SystemExit, match="2"):
            benchmark.main(arguments)
        assert words in capsys.readouterr().err
