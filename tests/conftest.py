"""Fixtures shared by the tests: scenes traced and FMUs exported once for all workers, a browser."""

import gc
import hashlib
import os
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from studies import script

import alfmu
from alfmu.model.cache import VARIABLE
from alfmu.model.content import content
from alfmu.model.files import exclusive
from alfmu.runtime.build import compiler

gc.set_threshold(200_000, 20, 50)
"""Traced scenes are millions of objects, which the collector would go through again and again: a fifth of the time."""


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Path:
    """The temporary folder of all workers."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if hasattr(request.config, "workerinput") else base


@pytest.fixture(scope="session", autouse=True)
def shared_cache(shared_folder: Path) -> Iterator[None]:
    """All workers, and the processes that they start, share one cache, which is not the user's."""
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = before or str(shared_folder / "cache")
    yield
    if before is None:
        del os.environ[VARIABLE]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def uncached(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes are traced, and kept for no other process."""
    monkeypatch.setenv(VARIABLE, "off")


def _unoptimised() -> Iterator[None]:
    command = compiler()
    with pytest.MonkeyPatch.context() as patch:
        if command and "ziglang" not in command:
            patch.setenv("CC", shlex.join([*command, "-O0"]))
        yield


@pytest.fixture(scope="module")
def quick_compiler() -> Iterator[None]:
    """Scenes are compiled without optimisation, in a third of the time, for tests that do not judge compiled code."""
    yield from _unoptimised()


@pytest.fixture
def quickly_compiled() -> Iterator[None]:
    """The same for one test."""
    yield from _unoptimised()


@pytest.fixture(scope="session", autouse=True)
def names_parsed_once() -> Iterator[None]:
    """A grammar parses each name once: fmpy parses those of every FMU that it validates, which takes 2 ms a name."""
    from lark import Lark

    parse, known = Lark.parse, dict[tuple[str, str], Any]()

    def parsed(self: Lark, text: str) -> Any:
        key = self.source_grammar, text
        if key not in known:
            known[key] = parse(self, text)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Lark, "parse", parsed)
        yield


def once(path: Path, make: Callable[[], object]) -> Path:
    """A file or folder that one of all workers makes, as a whole."""
    while not path.exists():
        with exclusive(path.parent) as mine:
            if mine and not path.exists():
                make()
        if not mine:
            time.sleep(0.05)
    return path


@pytest.fixture(scope="session")
def fmu_of(shared_folder: Path) -> Callable[..., Path]:
    """`fmu_of("five_bar", kind="native")`: the path of an FMU, exported at first use by one of all workers.

    Nobody changes these files; tests of the export itself call `alfmu.export`.
    """
    folder = shared_folder / "fmus"

    def get(mechanism: str | alfmu.Mechanism, options: Mapping[str, str] | None = None, **given: Any) -> Path:
        name, declared = (mechanism, mechanism) if isinstance(mechanism, str) else (mechanism.name, content(mechanism))
        assert declared, f"{name} cannot be told from other mechanisms; export it in the test"
        key = hashlib.sha256(repr((declared, sorted((options or {}).items()), sorted(given.items()))).encode())
        path = folder / key.hexdigest()[:16] / f"{'_'.join([name, *(options or {}).values()])}.fmu"
        return once(path, lambda: alfmu.export(mechanism, path, options=options, **given))

    return get


@pytest.fixture(scope="session")
def fuzz() -> Iterator[ModuleType]:
    """The script as a module."""
    yield from script("fuzz")


@pytest.fixture(scope="session")
def sanitized(shared_folder: Path, fuzz: Any) -> Callable[[str], Path]:
    """`sanitized("address")`: the folder of the runtime compiled with these sanitizers at first use, by one of all
    workers; `fuzz.objects` are its files for a version of FMI. Skips where the compiler has none."""

    def get(watched: str) -> Path:
        path = shared_folder / "sanitized" / watched

        def make() -> None:
            empty = [*fuzz.compiling(watched), "-x", "c", "-", "-o", path.with_suffix(".empty")]
            if subprocess.run(empty, input=b"int main(void) { return 0; }", check=False).returncode:
                pytest.skip("this compiler has no sanitizers")
            fuzz.compiled(path.with_name(f"{watched}.part"), watched).rename(path)

        path.parent.mkdir(exist_ok=True)
        return once(path, make)

    return get


@pytest.fixture(scope="session")
def exported(fmu_of: Callable[..., Path]) -> Callable[..., Path]:
    """`exported("slider_crank", coordinates="joint")`: the path of that FMU of kind python."""
    return lambda name, **options: fmu_of(name, options, kind="python")


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


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


@pytest.fixture(scope="session")
def one_chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A Chromium without a window, as a driver of Selenium; `get_log("browser")` has what pages say on the console.

    It draws WebGL by software and asks for reduced motion, so that films wait to be started. Tests that ask for it are
    skipped where there is no Chromium.
    """
    program, driver = next(filter(None, map(shutil.which, BROWSERS)), None), shutil.which("chromedriver")
    if not program or not driver:
        pytest.skip("there is no Chromium with its driver here")
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = program
    quiet = ("quic", "background-networking", "component-update", "sync", "dev-shm-usage")
    for argument in (
        *("headless=new", "no-sandbox", "no-first-run", "window-size=640,620", "force-prefers-reduced-motion"),
        *("use-angle=swiftshader", "enable-unsafe-swiftshader", "force-device-scale-factor=1"),
        f"user-data-dir={tmp_path_factory.mktemp('browser')}",
        *(f"disable-{what}" for what in quiet),
    ):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service(driver))
    browser.set_script_timeout(120)  # s: frames come late where the machine has much else to do
    yield browser
    browser.quit()


@pytest.fixture
def chromium(one_chromium: Any) -> Iterator[Any]:
    """The Chromium of all tests; afterwards it shows nothing, as a page that moves takes time from other tests."""
    yield one_chromium
    one_chromium.get("about:blank")


@pytest.fixture(scope="session")
def built(fmu_of: Callable[..., Path]) -> Callable[..., Path]:
    """`built("five_bar", ...)`: the path of that native FMU, without reference results."""
    return partial(fmu_of, kind="native", reference=False)
