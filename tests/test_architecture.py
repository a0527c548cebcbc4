"""The import graph: every room imports only rooms below it, and the run side no declaration."""

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

import alfmu
from alfmu.fmi.export import RUN_SIDE

PACKAGE = Path(alfmu.__file__).parent

ROOMS: dict[str, set[str]] = {
    "catalogue": set(),
    "model": set(),
    "files": {"model"},
    "equations": {"model"},
    "parts": {"equations", "model"},
    "formats": {"model"},
    "method": set(),
    "kernel": {"equations", "method", "model"},
    "runtime": {"equations", "files", "kernel", "method", "model"},
    "oracle": {"equations", "kernel", "method", "model", "runtime"},
    "result": {"equations", "files", "model"},
    "simulation": {"equations", "kernel", "model", "oracle", "result", "runtime"},
    "view": {"equations", "files", "kernel", "model", "result", "runtime", "simulation"},
    "fmi": {"equations", "files", "kernel", "model", "result", "runtime", "simulation", "view"},
    "gradients": {"equations", "fmi", "model", "oracle", "result", "runtime", "simulation", "view"},
    "analysis": {"equations", "files", "fmi", "kernel", "model", "result", "runtime", "simulation", "view"},
    "studies": {"equations", "files", "fmi", "kernel", "model", "oracle", "runtime", "simulation", "view"},
    "systems": {"equations", "files", "fmi", "model", "parts", "result", "runtime", "simulation", "view"},
    "sweeps": {"equations", "files", "fmi", "kernel", "model", "result", "runtime", "simulation", "studies"},
    "cli": {
        "analysis",
        "equations",
        "files",
        "fmi",
        "formats",
        "gradients",
        "kernel",
        "model",
        "result",
        "runtime",
        "simulation",
        "studies",
        "systems",
        "sweeps",
        "view",
    },
    "__main__": {"cli"},
}
"""Room -> the rooms that its modules may import: the table of CONTRIBUTING.md, from the bottom up."""

LATE: dict[str, set[str]] = {
    "kernel": {"runtime"},
    "model": {"equations", "formats", "result", "view"},
    "result": {"view"},
    "simulation": {"analysis", "fmi", "systems"},
    "fmi": {"analysis"},
}
"""Room -> the rooms above it that it imports when it is asked to, or for types alone: `Mechanism.draw()`,
`Marker.position`, the result that an error has, `result.plot()`, the film of a result, an FMU that `simulate` is given,
a start in a position of rest, the C library that arranges functions. Never where a module is imported."""


def modules() -> dict[str, Path]:
    """Every module of every room by name, a room itself by that of the room."""
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        if name != "__init__":
            found[name] = path
    return found


MODULES = modules()


@cache
def imports(path: Path) -> tuple[set[str], set[str]]:
    """Modules of alfmu, those of LATE in functions left out, and top-level packages from elsewhere, that a file imports
    anywhere in its text."""
    tree = ast.parse(path.read_text())
    own, foreign = imports_of(path, list(ast.walk(tree)))
    late = LATE.get(path.relative_to(PACKAGE).parts[0].removesuffix(".py"), set())
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    typed = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    within = {id(node) for each in (*functions, *typed) for node in ast.walk(each)}
    at_once, _ = imports_of(path, [node for node in ast.walk(tree) if id(node) not in within])
    return {name for name in own if name in at_once or room(name) not in late}, foreign


def imports_of(path: Path, nodes: list[ast.AST]) -> tuple[set[str], set[str]]:
    """The same of some nodes of a file."""
    own: set[str] = set()
    foreign: set[str] = set()
    package = list(path.relative_to(PACKAGE).parent.parts)
    for node in nodes:
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


def imported_at_once(path: Path) -> set[str]:
    """Modules that importing a file imports: not those inside functions, nor those for type checkers."""
    found: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and not node.level:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found


def test_every_module_is_in_a_room():
    assert {room(name) for name in MODULES} == set(ROOMS)


@pytest.mark.parametrize("name", sorted(MODULES))
def test_imports_point_down(name: str):
    own, foreign = imports(MODULES[name])
    wrong = {o for o in own if room(o) not in {room(name), *ROOMS[room(name)]}}
    assert not wrong, f"{name} imports {sorted(wrong)}, which the table of rooms does not allow"
    assert "alfmu" not in foreign, f"{name} imports alfmu by its own name, which it has not inside an FMU"


def test_the_table_allows_nothing_that_is_not_used():
    pairs = {(name, o) for name, path in MODULES.items() for o in imports(path)[0]}
    used = {(room(name), room(o)) for name, o in pairs}
    assert {(name, below) for name, rooms in ROOMS.items() for below in rooms} <= used


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
