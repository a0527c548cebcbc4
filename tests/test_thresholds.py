"""docs/singular.md has every threshold as it is, every step that the code cites, and figures that a script measured."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from studies import script

ROOT = Path(__file__).parents[1]
SCRIPTS = ROOT / "scripts"
PAGE = (ROOT / "docs" / "singular.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def study():
    yield from script("threshold_study")


def cited() -> set[str]:
    """Steps that lines of the package cite."""
    files = [path for path in (ROOT / "alfmu").rglob("*") if path.suffix in {".py", ".c", ".h"}]
    return {step for path in files for step in re.findall(r"\bS[1-9]\b", path.read_text(encoding="utf-8"))}


def test_every_constant_stands_in_the_page_as_it_is(study):
    """Name, value, unit and reason; `python scripts/threshold_study.py --only --write` brings the page up to date."""
    rows, measured = PAGE.splitlines(), study.measured(PAGE)
    known = study.thresholds()
    assert len(known) > 30
    assert len({each.name for each in known}) == len(known)
    for each in known:
        assert sum(row.startswith(each.row) for row in rows) == 1, each.name
    assert {each.name for each in known} == set(measured)


def test_every_constant_was_measured(study):
    for name, cells in study.measured(PAGE).items():
        for cell in cells:
            assert re.match(r"same$|within|stops: |error x |evaluations x ", cell), f"{name}: {cell}"


def test_steps_that_the_code_cites_are_those_of_the_page():
    assert cited() == set(re.findall(r"^### (S\d): ", PAGE, re.M)) == {f"S{k}" for k in range(1, 6)}


def test_names_in_the_page_exist(study):
    """Names in capitals are thresholds; what the page refers to is there."""
    names = {each.name for each in study.thresholds()}
    assert set(re.findall(r"`([A-Z_]{4,})`", PAGE)) <= names
    for path in re.findall(r"\]\(([^)#:]+)\)", PAGE):
        assert (ROOT / "docs" / path).is_file()
    for path in re.findall(r"`((?:runtime|kernel|method)/[\w/]+\.\w+)`", PAGE):
        assert (ROOT / "alfmu" / path).is_file()


@pytest.mark.parametrize("name", ["README.md", "CONTRIBUTING.md"])
def test_the_page_is_linked(name):
    assert "](docs/singular.md)" in (ROOT / name).read_text(encoding="utf-8")


def test_a_docstring_of_another_form_is_refused(study, monkeypatch):
    monkeypatch.setattr(study, "FORM", re.compile("nothing"))
    with pytest.raises(ValueError, match="BRANCH_MARGIN: its docstring is not"):
        study.thresholds()


def test_changes_are_told_by_their_largest_ratios(study):
    usual = {"a": study.Found(1.0, 100), "b": study.Found(2.0, 100)}
    assert study.compared(dict(usual), usual) == "same"
    assert study.compared({"a": study.Found(1.01, 100), "b": usual["b"]}, usual) == "within 2 %"
    assert study.compared({"a": study.Found(3.0, 90), "b": usual["b"]}, usual) == "error x 3 (a); evaluations x 0.9 (a)"
    assert study.compared({"a": "refused", "b": usual["b"]}, usual) == "stops: a"


@pytest.mark.slow
def test_the_study_changes_constants_of_python_and_of_c():
    """Places of reactions further apart err more; the runtime is built with the constant of C, and its start too."""
    given = ["--cases", "pole", "--only", "READ_DISTANCE", "LEAST_DISTANCE"]
    code = f"import threshold_study as study; study.FACTORS = {{'twice': 2.0}}; study.main({given})"
    done = subprocess.run([sys.executable, "-c", code], cwd=SCRIPTS, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    lines = dict(line.rsplit(" | ", 1) for line in done.stdout.splitlines()[1:])
    assert float(re.match(r"error x (\S+) \(pole\)", lines["READ_DISTANCE | 0.06"])[1]) > 20
    assert lines["LEAST_DISTANCE | 0.022"] == "same"
