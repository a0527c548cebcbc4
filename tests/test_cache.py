"""Scenes kept in the cache folder from one process to the next."""

import logging
import os
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import alfmu
from alfmu.cli import main
from alfmu.equations import derivation
from alfmu.kernel import controlled, thresholds
from alfmu.kernel.controlled import whole
from alfmu.method import friction, stepping
from alfmu.model import cache, settings
from alfmu.runtime import pipeline, probe, stored
from alfmu.simulation import prepared, with_defaults

NAMES = [("bennett", {}), ("end_stop", {}), ("slider_crank", {"coordinates": "natural"}), ("particle_on_circle", {})]


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A cache of this test alone, in which everything is kept."""
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(stored, "_WORTH", 0.0)
    return tmp_path / "cache"


@pytest.fixture
def traces(monkeypatch) -> list[str]:
    """The names of the mechanisms that were traced."""
    traced, seen = pipeline.traced, []
    monkeypatch.setattr(pipeline, "traced", lambda e, *given: seen.append(e.name) or traced(e, *given))
    return seen


def fresh(name: str = "particle_on_circle", **options: str) -> alfmu.Equations:
    """Equations that share nothing in memory with others."""
    pipeline._KEPT.clear()
    pipeline._SCENES.clear()
    return derivation.derive(alfmu.load(name, **options))


RK4 = {"parameters": {"solver.method": "rk4"}}
"""Where the integrator does not matter: scenes without error control take a quarter of the time to trace."""


def run(e: alfmu.Equations, **given) -> tuple[bytes, object, tuple]:
    """Everything that a run shows: values, counters, outputs with their descriptions."""
    result = alfmu.simulate(e, 0.2, 0.02, **given)
    found = alfmu.Instance(e)
    return result.values.tobytes(), result.counters, found.outputs


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), NAMES)
def test_runs_from_the_cache_are_the_same_to_the_bit(folder, traces, monkeypatch, name, options):
    """Of explicit methods, which they choose, and of an implicit one."""
    given = {"parameters": {"solver.method": "stiff"}} if name == "particle_on_circle" else {}
    with monkeypatch.context() as without:
        without.setenv(cache.VARIABLE, "off")
        expected = run(fresh(name, **options), **given)
    assert not folder.exists()
    first = run(fresh(name, **options), **given)
    made = len(traces)
    second = run(fresh(name, **options), **given)
    assert len(traces) == made > 0
    assert expected == first == second


@pytest.mark.slow
def test_a_scene_from_the_cache_has_the_same_bytes_programs_and_functions(folder):
    made, found = (prepared(fresh("five_bar")) for _ in range(2))
    assert pipeline.packed(made) == pipeline.packed(found)
    assert "seen" in made.functions
    assert "seen" not in found.functions
    again = whole(found)
    assert again.kernel == made.kernel
    assert {name: f.serialize() for name, f in again.functions.items()} == {
        name: f.serialize() for name, f in made.functions.items()
    }
    assert found.survey == made.survey
    assert found.decision == made.decision


@pytest.mark.slow
@pytest.mark.parametrize("given", [{}, {"outputs": ["particle.*"], "freeze": ["m"]}, {"kind": "python", **RK4}])
def test_fmus_from_the_cache_have_the_same_bytes(folder, traces, tmp_path, monkeypatch, given):
    def exported(name: str) -> bytes:
        pipeline._KEPT.clear()
        pipeline._SCENES.clear()
        return alfmu.export("particle_on_circle", tmp_path / f"{name}.fmu", reference=not given, **given).read_bytes()

    with monkeypatch.context() as without:
        without.setenv(cache.VARIABLE, "off")
        expected = exported("expected")
    first, made = exported("first"), len(traces)
    assert expected == first == exported("second")
    assert len(traces) == made > 0


@pytest.mark.slow
def test_a_compiled_kernel_from_the_cache_is_not_traced(folder, traces):
    made = prepared(with_defaults(fresh(), RK4["parameters"]), "compiled")
    expected, before = run(made, kernel="compiled"), len(traces)
    found = prepared(with_defaults(fresh(), RK4["parameters"]), "compiled")
    assert run(found, kernel="compiled") == expected
    assert found.library == made.library
    assert len(traces) == before


@pytest.mark.slow
def test_processes_share_the_cache(folder):
    code = "import alfmu; r = alfmu.simulate('slider_crank', 0.2, 0.02); print(r.values.tobytes().hex())"
    running = [subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = {process.communicate(timeout=120)[0] for process in running}
    assert [process.returncode for process in running] == [0] * 2
    assert {path.name.partition("_")[0] for path, _ in cache.entries()} >= {"scene", "start"}
    assert {alfmu.simulate(fresh("slider_crank"), 0.2, 0.02).values.tobytes().hex() + "\n"} == said


@pytest.mark.parametrize("how", ["a bit", "an end", "nothing", "other content"])
def test_damaged_files_are_made_again(folder, traces, caplog, how):
    expected = run(fresh())
    made = len(traces)
    for path, _ in cache.entries():
        content = path.read_bytes()
        middle = len(content) // 2
        changed = {
            "a bit": content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :],
            "an end": content[:middle],
            "nothing": b"",
        }
        if how in changed:
            path.write_bytes(changed[how])
        else:  # whole, and of another version
            path.unlink()
            cache.keep(path.stem.rpartition("_")[0], path.suffix, b"something else")
    with caplog.at_level(logging.WARNING):
        assert run(fresh()) == expected
    assert not caplog.records
    assert len(traces) == 2 * made
    assert run(fresh()) == expected
    assert len(traces) == 2 * made


def test_what_a_scene_depends_on_is_in_its_fingerprint(monkeypatch):
    e = fresh()
    prints = [
        stored.fingerprint(each)
        for each in (
            *(e, fresh("five_bar"), fresh("five_bar", coordinates="joint"), with_defaults(e, {"m": 3.0})),
            with_defaults(e, {"solver.method": "rk4"}),
            pipeline.specialised(e, ["particle.x"]),
            pipeline.specialised(e, None, ["m"]),
        )
    ]
    monkeypatch.setattr(stored, "software", lambda: "another version")
    prints.append(stored.fingerprint(e))
    assert None not in prints
    assert len({*prints}) == len(prints)
    monkeypatch.undo()
    assert stored.fingerprint(fresh()) == prints[0]


CONSTANTS = [
    *((thresholds, "LITTLE"), (stepping, "NOISE"), (stepping, "EXPLICIT5"), (controlled, "EXPLICIT5_SHORT")),
    *((probe, "_STRAIN"), (pipeline, "STIFF"), (friction, "JAM_PIVOT"), (settings, "UNBALANCED")),
]
"""Constants of every kind: numbers and tables of methods, of each room, and copies under the same name."""


@pytest.mark.parametrize(("module", "name"), CONSTANTS, ids=lambda x: x if isinstance(x, str) else "")
def test_a_constant_that_a_program_changes_is_in_the_fingerprint(monkeypatch, module, name):
    e = fresh()
    before, value = stored.fingerprint(e), getattr(module, name)
    changed = 2 * value if isinstance(value, int | float) else replace(value, order=value.order + 1)
    monkeypatch.setattr(module, name, changed)
    assert stored.fingerprint(e) not in (None, before)
    monkeypatch.undo()
    assert stored.fingerprint(e) == before


def test_constants_are_those_of_modules_that_every_process_has_loaded():
    """Otherwise processes would not find what others have stored."""
    code = """
        from importlib import import_module
        from pathlib import Path
        import alfmu
        from alfmu.runtime import pipeline, stored
        first = stored.constants()
        for path in sorted(Path(alfmu.__file__).parent.rglob("*.py")):
            if path.parent.name in stored._ROOMS and path.stem != "__init__":
                import_module(f"alfmu.{path.parent.name}.{path.stem}")
        stored._constants.cache_clear()
        assert stored.constants() == first
        """
    subprocess.run([sys.executable, "-c", textwrap.dedent(code)], check=True, timeout=120)


def test_an_entry_of_a_table_that_a_program_changes_is_in_the_fingerprint(monkeypatch):
    e = fresh()
    before = stored.fingerprint(e)
    monkeypatch.setitem(stepping.EXPLICIT_METHODS, "explicit", stepping.EXPLICIT8)
    assert stored.fingerprint(e) not in (None, before)


@pytest.mark.slow
@pytest.mark.parametrize("held", [True, False], ids=["the same equations", "derived again"])
def test_a_run_after_a_constant_was_changed_is_that_of_a_program_that_had_it_from_the_start(folder, monkeypatch, held):
    m = alfmu.load("slider_crank")
    e = alfmu.derive(m)
    before = run(e if held else m)
    monkeypatch.setattr(stepping, "SHARE", 1e-9 * stepping.SHARE)
    after = run(e if held else m)
    assert after != before
    assert after == run(fresh("slider_crank"))
    monkeypatch.undo()
    assert run(e if held else m) == before


@pytest.mark.slow
def test_a_mechanism_with_an_option_that_has_no_text_is_not_kept(folder):
    m = alfmu.load("particle_on_circle")
    m.options["why"] = object()
    e = derivation.derive(m)
    assert stored.fingerprint(e) is None
    assert run(e, **RK4) == run(fresh(), **RK4)


def test_the_cache_is_bounded_and_files_that_were_used_stay(folder, monkeypatch):
    paths = [cache.keep(f"scene_{i:032x}", ".z", bytes(100)) for i in range(4)]
    for i, path in enumerate(paths):
        os.utime(path, (i, i))
    assert cache.kept(f"scene_{0:032x}", ".z") == paths[0]
    monkeypatch.setattr(cache, "LIMIT", 300)
    monkeypatch.setattr(cache, "LEAST", 0)
    other = folder / "mine.txt"
    other.write_bytes(bytes(1000))
    last = cache.keep(f"scene_{9:032x}", ".z", bytes(100))
    assert {path for path, _ in cache.entries()} == {paths[0], paths[3], last}
    assert other.exists()


def test_files_are_counted_once_while_the_cache_is_far_from_its_limit_and_the_limit_is_kept(folder, monkeypatch):
    """Counting thousands of files takes longer than writing one: 100 of 10 bytes, of which 60 are within the limit."""
    monkeypatch.setattr(cache, "LIMIT", 600)
    monkeypatch.setattr(cache, "LEAST", 0)
    counts, entries = [], cache.entries
    monkeypatch.setattr(cache, "entries", lambda: counts.append(0) or entries())
    sizes = []
    for i in range(100):
        cache.keep(f"scene_{i:032x}", ".z", bytes(10))
        sizes.append(sum(path.stat().st_size for path in folder.iterdir()))
        if i == 5:
            assert len(counts) == 1
    assert sizes == [10 * min(i, 60) for i in range(1, 101)]


def test_a_folder_that_cannot_be_written_does_no_harm(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(stored, "_WORTH", 0.0)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(cache.VARIABLE, str(tmp_path / "file" / "cache"))
    with caplog.at_level(logging.WARNING):
        assert np.isfinite(alfmu.simulate(fresh(), 0.2, 0.02).values).all()
    assert not caplog.records


def test_the_command_shows_and_clears_the_cache(folder, capsys, monkeypatch):
    assert main(["cache"]) == 0
    assert capsys.readouterr().out == f"{folder}: 0 files, 0.0 MB of at most 500 MB\n"
    alfmu.simulate(fresh(), 0.1, 0.02)
    (folder / "mine.txt").write_text("mine")
    assert main(["cache"]) == 0
    assert f"{folder}: 3 files, 0.0 MB" in capsys.readouterr().out
    assert main(["cache", "--clear"]) == 0
    assert [path.name for path in folder.iterdir()] == ["mine.txt"]
    monkeypatch.setenv(cache.VARIABLE, "off")
    assert main(["cache"]) == 0
    assert "nothing is kept: ALFMU_CACHE is off" in capsys.readouterr().out


@pytest.mark.slow
def test_without_a_cache_nothing_is_written(folder, monkeypatch, traces):
    monkeypatch.setenv(cache.VARIABLE, "off")
    for _ in range(2):
        run(fresh(), **RK4)
    assert len(traces) >= 2
    assert not folder.exists()
