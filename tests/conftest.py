"""Fixtures shared by the tests: FMUs exported once a session."""

from collections.abc import Callable
from pathlib import Path

import pytest

import alfmu


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """`exported("slider_crank", coordinates="joint")`: the path of that FMU, built on first use."""
    folder = tmp_path_factory.mktemp("fmus")
    built: dict[str, Path] = {}

    def get(name: str, **options: str) -> Path:
        key = "_".join([name, *options.values()])
        if key not in built:
            built[key] = alfmu.export(name, folder / f"{key}.fmu", options=options)
        return built[key]

    return get


@pytest.fixture
def distribution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str, str], None]:
    """`distribution("theirs", text, entry_points)`: another package is installed, with one module."""

    def install(name: str, module: str, entry_points: str) -> None:
        (tmp_path / f"{name}.py").write_text(module)
        about = tmp_path / f"{name}-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text(entry_points)
        monkeypatch.syspath_prepend(tmp_path)

    return install
