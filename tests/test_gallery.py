"""The gallery: every file runs, shows what it promises, and its own check in `docs/checks.py` holds."""

import ast
import os
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import alfmu
from alfmu.cli import main
from alfmu.view import picture

matplotlib = pytest.importorskip("matplotlib")

DOCS = Path(__file__).parents[1] / "docs"
GALLERY = DOCS / "gallery"

with pytest.MonkeyPatch.context() as patch:
    patch.syspath_prepend(str(DOCS))
    import checks
    from checks import CHECKS, REGISTERED


def test_every_file_has_its_check():
    assert sorted(path.stem for path in GALLERY.glob("*.py")) == sorted(f"plot_{name}" for name in CHECKS)


@pytest.mark.parametrize("name", CHECKS)
def test_a_file_has_a_users_length_and_declares_one_mechanism(name: str):
    tree = ast.parse((GALLERY / f"plot_{name}.py").read_text())
    lines = {n.lineno for n in ast.walk(tree) if isinstance(n, ast.expr | ast.stmt)}
    assert 10 < len(lines) <= 80
    declares = [f for f in tree.body if isinstance(f, ast.FunctionDef) and ast.unparse(f.returns or f) == "Mechanism"]
    assert len(declares) == (0 if name in REGISTERED else 1)


@pytest.mark.slow
def test_the_mechanisms_of_the_gallery_are_names(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # which declarations do not take
    assert main(["list"]) == 0
    listed = capsys.readouterr().out.partition("from the gallery")[2]
    for name in CHECKS.keys() - REGISTERED:
        assert f"\n{name} " in listed
    assert main(["simulate", "windscreen_wiper", "--stop-time", "0.02", "--outputs", "arm1.angle"]) == 0
    assert main(["draw", "windscreen_wiper"]) == 0
    assert alfmu.load("bar_clamp", reach=0.1).options == {"reach": 0.1}
    assert alfmu.simulate("kapitza", 0.01).time[-1] == 0.01
    assert main(["info", "wiper"]) == 1
    assert "did you mean windscreen_wiper?" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", CHECKS)
def test_a_file_runs_and_its_check_holds(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    if os.environ.get("SNIPPETS") == "site":
        pytest.skip("SNIPPETS=site: the site is built, too, which runs the gallery and checks what it leaves")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(picture, "MAX_FRAMES", 4)
    try:
        names = runpy.run_path(str(GALLERY / f"plot_{name}.py"), run_name="__main__")
        figures = pyplot.get_fignums()
    finally:
        pyplot.close("all")
    checks.hold(name, names, len(figures), capsys.readouterr().out, [path.name for path in tmp_path.iterdir()])


def test_the_build_of_the_site_fails_where_a_check_does_not_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """And runs the example once more, the next time."""
    pytest.importorskip("sphinx_gallery")
    monkeypatch.syspath_prepend(str(DOCS))
    import films
    from sphinx.errors import ExtensionError

    monkeypatch.setattr(films, "RAN", {"plot_pantograph": ({"deviation": 1e-3}, ["pantograph.gif"])})
    done = tmp_path / "mechanisms" / "gallery" / "plot_pantograph.py.md5"
    done.parent.mkdir(parents=True)
    done.touch()
    done.with_name("plot_pantograph.rst").touch()
    with pytest.raises(ExtensionError, match=r'plot_pantograph: (?s:.*)assert n\["deviation"\] < 1e-12'):
        films.checked(SimpleNamespace(srcdir=tmp_path, outdir=tmp_path / "site"))
    assert not done.exists()
