"""What the continuous integration asserts beside the tests, of the source archive that it builds; run by `.ci/run`."""

import re
import shutil
import subprocess
import sys
import tarfile
from email import message_from_bytes
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts" / "packaging"))

from links import relative  # noqa: E402


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> tuple[str, set[str]]:
    """The description for a package index, and the files, of the source archive."""
    folder = tmp_path_factory.mktemp("archive")
    left = shutil.ignore_patterns(
        *(".git", ".venv", ".*_cache", "_build", "made", "results", "build", "dist", "*.egg-info", "__pycache__")
    )
    shutil.copytree(ROOT, folder / "alfmu", ignore=left)
    code = "from setuptools import build_meta as b; b.build_sdist('..')"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder / "alfmu", capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    with tarfile.open(next(folder.glob("*.tar.gz"))) as packed:
        names = {name.partition("/")[2] for name in packed.getnames()}
        top = packed.getnames()[0].split("/")[0]
        about = message_from_bytes(packed.extractfile(f"{top}/PKG-INFO").read())
    return about.get_payload(decode=True).decode(), names


def test_the_source_archive_has_what_builds_and_no_library_of_this_machine(archive):
    _, names = archive
    assert {"pyproject.toml", "setup.py", "scripts/packaging/backend.py", "scripts/packaging/links.py"} <= names
    assert {path.relative_to(ROOT).as_posix() for path in (ROOT / "alfmu" / "runtime").rglob("*.[ch]")} <= names
    assert not [name for name in names if re.match(r"alfmu/runtime/(alfmu|fmi\d)-", name)]


def test_links_of_the_readme_lead_to_files_of_the_source_archive(archive):
    _, names = archive
    paths = relative((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(paths) > 15
    for path in paths:
        assert (ROOT / path).exists(), path
        assert any(name == path.rstrip("/") or name.startswith(f"{path.rstrip('/')}/") for name in names), path


def test_a_package_index_shows_no_link_that_leads_nowhere(archive):
    text, names = archive
    assert "docs/tutorial.md" in text
    assert relative(text) == []
    for path in re.findall(r"`((?:docs|scripts|fmus|mechanisms)/[\w./-]*)`", text):
        assert any(name == path.rstrip("/") or name.startswith(path) for name in names), path
