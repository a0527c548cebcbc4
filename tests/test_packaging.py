"""What an installation consists of: its packages, one name for all of them, and the checks of wheels."""

import base64
import hashlib
import importlib
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from alfmu.catalogue.mechanisms import five_bar

import alfmu
from alfmu import InputError
from alfmu.runtime.build import HERE, PLATFORMS
from alfmu.runtime.shipped import there

ROOT = Path(__file__).parents[1]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())


@pytest.fixture
def wheels(monkeypatch):
    """The script as a module."""
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    return importlib.import_module("wheels")


def test_every_package_is_installed_and_inside_alfmu():
    inside = {"alfmu": "alfmu", "mechanisms": "alfmu.catalogue.mechanisms", "fmus": "alfmu.catalogue.fmus"}
    files = [path.relative_to(ROOT) for top in inside for path in (ROOT / top).rglob("__init__.py")]
    packages = {".".join([inside[file.parts[0]], *file.parent.parts[1:]]) for file in files}
    listed = SETTINGS["tool"]["setuptools"]["packages"]
    assert sorted(listed) == sorted({*packages, "alfmu.catalogue.gallery"})  # pages are no modules of a package
    assert {name.partition(".")[0] for name in listed} == {"alfmu"}


def test_entry_points_are_of_modules_that_are_there():
    points = SETTINGS["project"]["entry-points"]
    folders = {path.parent.name for path in (ROOT / "mechanisms").glob("*/__init__.py")}
    assert points["alfmu.mechanisms"] == {name: f"alfmu.catalogue.mechanisms.{name}:{name}" for name in folders}
    assert set(alfmu.mechanisms()) >= folders


def test_a_source_tree_is_complete_by_itself():
    """Without what an editable installation adds: as for somebody who calls Python in the folder of the repository."""
    code = f"""
import sys
sys.meta_path = [finder for finder in sys.meta_path if "editable" not in str(getattr(finder, "__module__", ""))]
sys.path.insert(0, {str(ROOT)!r})
from alfmu.catalogue import fmus
from alfmu.catalogue.mechanisms import five_bar
print(fmus.__file__, five_bar.__file__)
"""
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    files = [ROOT / "fmus" / "__init__.py", ROOT / "mechanisms" / "five_bar" / "__init__.py"]
    assert done.stdout.splitlines() == [" ".join(map(str, files))], done.stderr


def test_a_fault_in_a_mechanism_of_alfmu_is_placed_in_its_file(monkeypatch):
    def faulty(*given, **named):
        raise RuntimeError("out of order")

    monkeypatch.setattr(five_bar, "Mechanism", faulty)
    with pytest.raises(InputError, match=r"five_bar/__init__.py, line \d+: .*out of order"):
        alfmu.load("five_bar")


@pytest.mark.skipif(not HERE, reason="alfmu has no name for this platform")
def test_the_check_of_a_library_knows_its_platform(wheels):
    data = there(HERE, 3).read_bytes()
    assert [name for name in PLATFORMS if wheels.machine(data) == wheels._FORMATS[name]] == [HERE]
    others = [name for name in PLATFORMS if name != HERE]
    assert all("is (" in wheels._of_library(data, name, 3)[0] for name in others)
    assert wheels._of_library(data.replace(b"fmi3DoStep", b"fmi3NoStep"), HERE, 3)[0] == "has no fmi3DoStep"
    assert wheels._of_library(data + b"GLIBC_2.38", HERE, 3)[-1] == "needs glibc 2.38"


def test_the_check_of_a_wheel_compares_files_with_their_record(wheels):
    data = b"one\n"
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    record = f"a.py,sha256={digest},4\nb.py,sha256={digest},4\nlost.py,sha256={digest},4\ni/RECORD,,\n".encode()
    files = {"a.py": data, "b.py": b"two\n", "i/RECORD": record, "new.py": data}
    assert wheels._unlike_their_record(files, "i") == [f"{x} is not as recorded" for x in ("b.py", "lost.py", "new.py")]


@pytest.mark.slow
def test_without_fmpy_an_fmu_is_exported_and_running_it_says_what_to_install(tmp_path):
    code = """
import sys
sys.modules["fmpy"] = None
from alfmu.cli import main
assert main(["export", "particle_on_circle"]) == 0
sys.exit(main(["simulate", "particle_on_circle.fmu"]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 1
    assert (tmp_path / "particle_on_circle.fmu").is_file()
    assert done.stderr.startswith("alfmu: running or checking an FMU needs fmpy")
    assert "pip install 'alfmu[fmu]'" in done.stderr
    assert done.stderr.count("\n") == 1
