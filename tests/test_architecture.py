"""The import graph: every room imports only rooms below it, and the run side no declaration."""

import ast
import re
import sys
from collections import OrderedDict
from functools import cache
from pathlib import Path

import pytest

import alfmu
from alfmu.fmi.export import RUN_SIDE
from alfmu.runtime import build, pipeline

PACKAGE = Path(alfmu.__file__).parent

ROOMS: dict[str, set[str]] = {
    name: set(below.split())
    for name, below in {
        "model": "",
        "method": "",
        "equations": "model",
        "parts": "model",
        "formats": "model",
        "catalogue": "formats model",
        "kernel": "equations method model",
        "runtime": "catalogue equations kernel method model",
        "simulation": "equations kernel method model runtime",
        "view": "equations kernel model runtime simulation",
        "fmi": "catalogue equations kernel model runtime simulation view",
        "analysis": "equations fmi kernel model runtime simulation view",
        "gradients": "analysis equations fmi model runtime simulation view",
        "systems": "analysis equations fmi model parts runtime simulation view",
        "api": "analysis catalogue equations fmi formats model runtime simulation systems view",
        "studies": "api catalogue equations fmi kernel model runtime simulation view",
        "sweeps": "catalogue equations fmi kernel model runtime simulation studies view",
        "cli": "analysis api catalogue equations fmi formats gradients kernel model runtime simulation studies sweeps "
        "systems view",
    }.items()
}
"""Room -> the rooms that its modules may import: the table of CONTRIBUTING.md, from the bottom up."""

MOST = 18
"""Rooms, at most."""


def modules() -> dict[str, Path]:
    """Every module of every room by name, a room itself by that of the room."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        if name not in ("__init__", "__main__"):
            found[name] = path
    return found


MODULES = modules()


@cache
def imports(path: Path) -> tuple[set[str], set[str]]:
    """Modules of alfmu, and top-level packages from elsewhere, that a file imports anywhere in its text: within
    functions and for types alone, too."""
    own: set[str] = set()
    foreign: set[str] = set()
    package = list(path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = [*package[: len(package) - node.level + 1], *(node.module.split(".") if node.module else [])]
            names = {".".join([*base, name.name]) for name in node.names}
            own |= names & MODULES.keys()
            if base and names - MODULES.keys():
                own.add(".".join(base))
        elif isinstance(node, ast.ImportFrom):
            foreign.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            foreign |= {name.name.split(".")[0] for name in node.names}
    return own, foreign


def room(module: str) -> str:
    return module.split(".")[0]


def test_every_module_is_in_a_room():
    assert {room(name) for name in MODULES} == set(ROOMS)
    assert len(ROOMS) <= MOST


def test_no_room_imports_by_a_name_that_this_test_cannot_see():
    calls = re.compile(r"import_module|__import__|importlib\.util\.module_from_spec")
    assert {name for name, path in MODULES.items() if calls.search(path.read_text())} == set()


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_point_down(name: str):
    own, foreign = imports(MODULES[name])
    wrong = {o for o in own if room(o) not in {room(name), *ROOMS[room(name)]}}
    assert not wrong, f"{name} imports {sorted(wrong)}, which the table of rooms does not allow"
    assert "alfmu" not in foreign, f"{name} imports alfmu by its own name, which it has not inside an FMU"


def test_the_table_allows_nothing_that_is_not_used():
    pairs = {(name, o) for name, path in MODULES.items() for o in imports(path)[0]}
    used = {(room(name), room(o)) for name, o in pairs}
    unused = {(name, below) for name, rooms in ROOMS.items() for below in rooms} - used
    assert not unused, f"ROOMS allows imports that no module makes; take these pairs out of it: {sorted(unused)}"


@pytest.mark.parametrize("name", sorted(ROOMS))
def test_a_room_says_which_of_its_modules_others_import(name: str):
    used = {o for module, path in MODULES.items() if room(module) != name for o in imports(path)[0] if room(o) == name}
    says = ast.get_docstring(ast.parse(MODULES[name].read_text())).partition("Other rooms import ")[2]
    said = {f"{name}.{each}" for each in re.findall("`([a-z_.]+)`", says)}
    missing, unused = sorted(used - said - {name}), sorted(said - used)
    assert not missing, f"'Other rooms import ...' in the docstring of {name} lacks {missing}, which other rooms import"
    assert not unused, f"'Other rooms import ...' in the docstring of {name} has {unused}, which none imports"
    assert name not in used or "__all__ = [" in MODULES[name].read_text()


def test_the_table_has_no_circle():
    below: set[str] = set()
    for name, rooms in ROOMS.items():
        assert rooms <= below, f"{name} stands below {sorted(rooms - below)}, which it may import"
        below.add(name)


def test_modules_do_not_import_each_other():
    order: set[str] = set()
    rest = {name: imports(path)[0] for name, path in MODULES.items()}
    while rest:
        free = [name for name, below in rest.items() if below <= order]
        assert free, f"these import each other: {sorted(rest)}"
        order |= set(free)
        for name in free:
            del rest[name]


def test_the_method_imports_only_typing_and_mathematics():
    for name, path in MODULES.items():
        if room(name) == "method":
            _, foreign = imports(path)
            assert foreign <= {"__future__", "collections", "dataclasses", "math", "numpy", "typing"}, name
    assert imports(MODULES["method.formulations"]) == (set(), {"collections", "typing"})


def test_the_runtime_knows_no_symbols():
    assert {name for name, path in MODULES.items() if room(name) == "runtime" and "casadi" in imports(path)[1]} == set()


def test_what_travels_inside_an_fmu_needs_python_alone():
    names = {file.removesuffix(".py").replace("/", ".") for file in RUN_SIDE}
    for name in names:
        own, foreign = imports(MODULES[name])
        assert own <= names, f"{name} needs {sorted(own - names)}, which an FMU does not carry"
        assert foreign <= {*sys.stdlib_module_names, "pythonfmu"}


def test_every_public_name_is_there():
    for name in alfmu.__all__:
        assert getattr(alfmu, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        alfmu.nonsense  # noqa: B018


@pytest.mark.slow
def test_an_export_goes_through_its_stops_in_their_order(tmp_path, uncached, monkeypatch):
    """CONTRIBUTING.md lists the stops; the survey looks ahead, as it packs a scene that starts."""
    text = (PACKAGE.parent / "CONTRIBUTING.md").read_text()
    listed = text.partition("## How an export goes")[2].partition("\n## ")[0]
    stops = [set(re.findall(r"`([a-z_/]+\.py)`", stop)) for stop in re.split(r"(?m)^\d+\. ", listed)[1:]]
    stops[0] = {"api.py"}
    place = {file: i for i, files in enumerate(stops) for file in files}
    assert len(stops) <= 10
    entered: list[int] = []
    ahead = {"packed_start", "checked"}  # `native.checked` refuses before anything is traced

    def callers(frame):
        while frame is not None:
            yield frame.f_code.co_name
            frame = frame.f_back

    def seen(frame, event, _):
        file = frame.f_code.co_filename.removeprefix(f"{PACKAGE}/")
        if event == "call" and file in place and place[file] not in entered and not ahead & {*callers(frame)}:
            entered.append(place[file])

    alfmu.load("particle_on_circle")
    for known in ("_KEPT", "_SCENES"):  # equations and scenes that tests before left in memory
        monkeypatch.setattr(pipeline, known, OrderedDict())
    sys.setprofile(seen)
    try:
        alfmu.export("particle_on_circle", tmp_path)
    finally:
        sys.setprofile(None)
    assert entered == list(range(len(stops)))


def test_functions_of_c_release_scratch_memory_before_each_return():
    """A function that returns with memory taken lets it overflow after some hundred calls in one step."""
    kept, marked = [], 0
    for path in build.sources():
        for found in re.finditer(r"(?ms)^(\w[^;{}]*)\)\n\{\n(.*?)^\}", path.read_text()):
            if "arena_mark" in found[2]:
                marked, taken = marked + 1, False
                for line in found[2].splitlines():
                    taken = (taken or "arena_alloc(" in line or "_new(i" in line) and "arena_release(" not in line
                    if taken and line.strip().startswith("return"):
                        kept.append(f"{path.name}: {found[1]}")
    assert marked > 50
    assert not kept
