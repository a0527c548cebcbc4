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
