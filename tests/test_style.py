"""The script of the continuous integration runs what it promises."""

from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_the_ci_script_runs_the_test_command_of_the_readme():
    commands = [line for line in (ROOT / "README.md").read_text().splitlines() if line.startswith("python3 -m venv")]
    assert [line.endswith("/pytest") for line in commands] == [False, True]
    script = (ROOT / ".ci" / "run").read_text()
    checks = ("ruff check", "ruff format --check", "mypy alfmu docs/gallery", ".ci/checks.py", "-m sphinx")
    assert all(each in script for each in ("README.md", *checks))
