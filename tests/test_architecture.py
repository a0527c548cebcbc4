"""The import graph: every module imports only what stands below it, and the run side no declaration."""

import ast
from pathlib import Path

import pytest

import alfmu
from alfmu.fmi.export import METHODS, PORTABLE, RUN_SIDE

PACKAGE = Path(alfmu.__file__).parent

ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "units": {"errors"},
    "spatial": set(),
    "mechanism": {"errors", "spatial", "units"},
    "equations": set(),
    "evaluation": {"equations"},
    "derivation": {"equations", "errors", "evaluation", "mechanism", "spatial", "units"},
    "method": set(),
    "branch": set(),
    "scaling": set(),
    "topology": {"equations"},
    "integrators": set(),
    "inputs": set(),
    "stepping": set(),
    "implicit": {"method", "stepping"},
    "threads": set(),
    "adaptive": {"branch", "errors", "implicit", "method", "oracle", "stepping", "threads"},
    "kernel": set(),
    "kernel.program": {"equations", "inputs"},
    "oracle": {"branch", "equations", "errors", "kernel.program", "method", "scaling"},
    "assembly": {"equations", "errors", "kernel.program"},
    "kernel.order": {"kernel.stream"},
    "kernel.fusion": {"equations", "kernel.order", "kernel.program"},
    "kernel.vm": {"equations", "kernel.fusion", "kernel.program", "threads"},
    "kernel.compiled": {"equations", "kernel.program"},
    "kernel.trace": {
        "assembly",
        "branch",
        "equations",
        "evaluation",
        "implicit",
        "inputs",
        "integrators",
        "kernel.program",
        "method",
        "oracle",
    },
    "kernel.controlled": {"adaptive", "implicit", "kernel.program", "kernel.trace", "method", "oracle", "stepping"},
    "kernel.standalone": {"branch", "equations", "evaluation", "kernel.program", "kernel.trace", "method", "oracle"},
    "kernel.stream": {"errors"},
    "kernel.repeat": {"kernel.stream"},
    "kernel.places": {"kernel.repeat", "kernel.stream"},
    "kernel.loops": {"kernel.places", "kernel.repeat", "kernel.stream"},
    "kernel.emit": {"equations", "kernel.loops", "kernel.program", "kernel.stream"},
    "kernel.build": {"equations", "errors", "kernel.compiled", "kernel.emit", "kernel.program"},
    "runtime": {
        "assembly",
        "branch",
        "adaptive",
        "equations",
        "errors",
        "inputs",
        "integrators",
        "kernel.program",
        "kernel.vm",
        "oracle",
        "topology",
    },
    "registry": {"errors", "mechanism"},
    "specialisation": {"equations", "errors", "evaluation", "runtime", "topology"},
    "cost": {
        "assembly",
        "equations",
        "kernel.fusion",
        "kernel.program",
        "kernel.trace",
        "runtime",
        "simulation",
        "specialisation",
    },
    "simulation": {
        "adaptive",
        "derivation",
        "equations",
        "errors",
        "evaluation",
        "kernel",
        "kernel.build",
        "kernel.controlled",
        "kernel.trace",
        "mechanism",
        "oracle",
        "registry",
        "runtime",
        "specialisation",
    },
    "picture": {"derivation", "equations", "errors", "mechanism", "runtime", "simulation"},
    "plot": {"errors", "simulation"},
    "tables": {"kernel.build"},
    "charts": {"errors", "tables"},
    "reference": {"equations", "evaluation", "kernel.program", "kernel.vm", "runtime"},
    "cases": {
        "charts",
        "derivation",
        "equations",
        "errors",
        "mechanism",
        "oracle",
        "reference",
        "registry",
        "runtime",
        "simulation",
        "tables",
    },
    "peers": set(),
    "rivals": {"cases", "equations", "oracle", "peers", "runtime"},
    "paper": {
        "charts",
        "derivation",
        "equations",
        "errors",
        "oracle",
        "registry",
        "runtime",
        "simulation",
        "tables",
    },
    "report": {
        "cases",
        "charts",
        "cost",
        "equations",
        "errors",
        "fmi.drive",
        "fmi.export",
        "kernel.build",
        "mechanism",
        "oracle",
        "paper",
        "reference",
        "rivals",
        "runtime",
        "simulation",
        "specialisation",
        "stability",
        "tables",
    },
    "stability": {
        "cases",
        "charts",
        "errors",
        "mechanism",
        "oracle",
        "reference",
        "runtime",
        "simulation",
        "tables",
    },
    "fmi": set(),
    "fmi.slave": {"equations", "errors", "kernel.compiled", "kernel.program", "kernel.vm", "runtime"},
    "fmi.table": {
        "adaptive",
        "implicit",
        "stepping",
        "assembly",
        "branch",
        "equations",
        "evaluation",
        "kernel",
        "kernel.emit",
        "kernel.program",
        "kernel.standalone",
        "kernel.trace",
        "oracle",
        "runtime",
        "scaling",
        "topology",
    },
    "fmi.terminals": {"mechanism"},
    "fmi.native": {"equations", "errors", "fmi.table", "kernel.build", "runtime"},
    "fmi.description": {"equations", "evaluation", "fmi.slave", "kernel.program", "runtime", "units"},
    "fmi.export": {
        "derivation",
        "errors",
        "evaluation",
        "equations",
        "fmi.description",
        "fmi.experiment",
        "fmi.native",
        "fmi.slave",
        "fmi.table",
        "fmi.terminals",
        "kernel",
        "kernel.program",
        "kernel.trace",
        "kernel.vm",
        "mechanism",
        "picture",
        "registry",
        "runtime",
        "simulation",
        "specialisation",
    },
    "fmi.experiment": {"equations", "errors", "evaluation", "runtime", "simulation"},
    "fmi.sizes": {
        "equations",
        "errors",
        "fmi.export",
        "fmi.native",
        "kernel.emit",
        "kernel.program",
        "kernel.standalone",
        "mechanism",
    },
    "fmi.drive": {"equations", "errors", "fmi.experiment", "fmi.slave", "simulation"},
    "cli": {
        "cost",
        "derivation",
        "errors",
        "fmi.drive",
        "fmi.export",
        "fmi.sizes",
        "fmi.slave",
        "kernel",
        "picture",
        "plot",
        "registry",
        "report",
        "runtime",
        "simulation",
        "specialisation",
        "stability",
    },
}
"""Module -> the modules of alfmu that it may import: the layer table of CONTRIBUTING.md."""


def imports(path: Path) -> tuple[set[str], set[str]]:
    """Modules of alfmu, and top-level packages from elsewhere, that a file imports anywhere in its text."""
    own: set[str] = set()
    foreign: set[str] = set()
    package = list(path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = [*package[: len(package) - node.level + 1], *(node.module.split(".") if node.module else [])]
            names = [""] if node.module else [name.name for name in node.names]
            own |= {".".join([*base, name]).strip(".") for name in names}
        elif isinstance(node, ast.ImportFrom):
            foreign.add(node.module.split(".")[0])
        elif isinstance(node, ast.Import):
            foreign |= {name.name.split(".")[0] for name in node.names}
    return own, foreign


def imported_at_once(path: Path) -> set[str]:
    """Modules that importing a file imports: not those inside functions, nor those for type checkers."""
    found: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and not node.level:
            found.add(node.module)
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found


def modules() -> dict[str, Path]:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")
        if name != "__init__":
            found[name] = path
    return found


def test_the_table_names_every_module():
    assert set(modules()) == set(ALLOWED)


@pytest.mark.parametrize("name", sorted(ALLOWED))
def test_imports_point_down(name: str):
    own, _ = imports(modules()[name])
    assert own <= ALLOWED[name], f"{name} imports {sorted(own - ALLOWED[name])}, which the layer table does not allow"


def test_the_table_allows_nothing_that_is_not_used():
    unused = {name: sorted(allowed - imports(modules()[name])[0]) for name, allowed in ALLOWED.items()}
    assert {name: rest for name, rest in unused.items() if rest} == {}


def test_the_table_has_no_circle():
    order: list[str] = []
    rest = dict(ALLOWED)
    while rest:
        free = [name for name, below in rest.items() if below <= set(order)]
        assert free, f"these import each other: {sorted(rest)}"
        order += free
        for name in free:
            del rest[name]


def test_the_method_imports_only_typing():
    own, foreign = imports(PACKAGE / "method.py")
    assert own == set()
    assert foreign <= {"typing", "collections"}


def test_the_run_side_is_closed_and_declares_nothing():
    names, portable, methods = (
        {file.removesuffix(".py").replace("/", ".") for file in side} for side in (RUN_SIDE, PORTABLE, METHODS)
    )
    for name in names | methods:
        own, foreign = imports(modules()[name])
        # What methods beside RK4 need travels where a scene asks for one, and is loaded there alone.
        assert own <= names | methods, f"{name} needs {sorted(own - names)} at run time, which an FMU does not carry"
        assert not foreign & {"fmpy", "markdown", "PIL", "tqdm", "matplotlib"}
        # SciPy for large scenes alone, CasADi for portable functions alone: loaded where they are needed.
        at_once = {n.split(".")[0] for n in imported_at_once(modules()[name])}
        assert not at_once & ({"scipy"} if name in portable else {"scipy", "casadi"})


def test_every_public_name_is_there():
    for name in alfmu.__all__:
        assert getattr(alfmu, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        alfmu.nonsense  # noqa: B018
