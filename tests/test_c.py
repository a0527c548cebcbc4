"""The structure of the runtime in C: small files that call only files below them, with names that tell the file."""

import re
from collections import defaultdict
from graphlib import TopologicalSorter
from pathlib import Path

from alfmu.runtime.build import FOLDERS, sources

MOST_LINES, MOST_COLUMNS = 600, 120
HOSTS = re.compile(r"fmi[23][A-Z]\w+|alfmu_\w+|[A-Z_]+")
"""Functions that hosts and the binding call, whose names are given, and macros that define some of them."""


def functions() -> dict[Path, dict[str, tuple[bool, str]]]:
    """Of each file the functions that it defines by name: whether they are static, and their bodies."""
    found: dict[Path, dict[str, tuple[bool, str]]] = {}
    for path in sources():
        text = re.sub(r"/\*.*?\*/", " ", path.read_text(encoding="ascii"), flags=re.DOTALL)
        text = re.sub(r'"(?:\\.|[^"\\\n])*"', '""', text)
        parts = re.findall(
            r"^([A-Za-z][^;{}#]*?\b(\w+)\([^;{}]*\))\n\{\n(.*?)^\}", text, flags=re.DOTALL | re.MULTILINE
        )
        found[path] = {name: (head.startswith("static"), body) for head, name, body in parts}
    return found


FUNCTIONS = functions()
EXTERNAL = {name: path for path, own in FUNCTIONS.items() for name, (static, _) in own.items() if not static}


def calls() -> dict[Path, set[Path]]:
    """The files that each file calls."""
    found: dict[Path, set[Path]] = defaultdict(set)
    for path, own in FUNCTIONS.items():
        for _, body in own.values():
            for name in set(re.findall(r"\b(\w+)\(", body)) - own.keys():
                if name in EXTERNAL and EXTERNAL[name] != path:
                    found[path].add(EXTERNAL[name])
    return found


def test_functions_are_found():
    assert len(EXTERNAL) > 250
    assert sum(map(len, FUNCTIONS.values())) > 650


def test_files_that_call_each_other_form_no_circle():
    order = list(TopologicalSorter(calls()).static_order())  # raises CycleError
    assert len(order) > 50


def test_folders_call_only_those_below_them():
    for path, below in calls().items():
        for each in below:
            assert FOLDERS.index(each.parent.name) <= FOLDERS.index(path.parent.name), f"{path.name} calls {each.name}"


def test_files_are_small_and_their_names_differ():
    assert {path.name: lines for path in sources() if (lines := len(path.read_text().splitlines())) > MOST_LINES} == {}
    names = [path.name for path in sources()]
    assert len(names) == len(set(names))


def test_lines_are_short():
    written = [path for path in sources() if "generated from" not in path.read_text(encoding="ascii")[:200]]
    assert [path.name for path in written if max(map(len, path.read_text().splitlines())) > MOST_COLUMNS] == []


def test_functions_that_other_files_call_have_a_prefix():
    assert [name for name in EXTERNAL if "_" not in name and not HOSTS.fullmatch(name)] == []


def test_functions_are_declared_in_the_header_of_their_file():
    for name, path in EXTERNAL.items():
        if path.suffix == ".c" and not HOSTS.fullmatch(name):
            header = path.with_suffix(".h").read_text(encoding="ascii")
            assert re.search(rf"\b{name}\(", header), f"{name} of {path.name}"
