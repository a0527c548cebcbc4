"""Mechanisms of the documentation's gallery by name, without the runs and pictures of their pages.

A page of the gallery is a script `plot_NAME.py` that declares a mechanism in a function annotated `-> Mechanism`, then
runs it. Here only that function is executed, with the imports and definitions that it uses.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[1]

_FOLDERS = (_ROOT / "catalogue" / "gallery", _ROOT.parent / "docs" / "gallery")
"""Folders of the pages: installed, or in a source tree."""


@cache
def _pages() -> dict[str, tuple[Path, str]]:
    """Return the pages that declare a mechanism: name -> file and function."""
    files = next((found for folder in _FOLDERS if (found := sorted(folder.glob("plot_*.py")))), [])
    pages = {}
    for path in files:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.returns and ast.unparse(node.returns) == "Mechanism":
                pages[path.stem.removeprefix("plot_")] = path, node.name
    return pages


def names() -> list[str]:
    """Return names of the mechanisms that the gallery declares, in alphabetical order."""
    return list(_pages())


def factory(name: str) -> Callable[..., Any]:
    """Return the function that declares a mechanism of the gallery."""
    path, function = _pages()[name]
    page = ast.parse(path.read_text(encoding="utf-8"))
    wanted = {function}
    kept: list[ast.stmt] = []
    for node in reversed(page.body):
        if isinstance(node, ast.Import | ast.ImportFrom | ast.Assign | ast.FunctionDef) and _bound(node) & wanted:
            kept.insert(0, node)
            wanted |= {x.id for x in ast.walk(node) if isinstance(x, ast.Name)}
    code = compile(ast.Module(kept, []), str(path), "exec")
    module: dict[str, Any] = {"__name__": path.stem, "__doc__": ast.get_docstring(page)}
    exec(code, module)
    return module[function]


def _bound(node: ast.stmt) -> set[str]:
    """Return the names that a statement binds."""
    if isinstance(node, ast.FunctionDef):
        return {node.name}
    if isinstance(node, ast.Import | ast.ImportFrom):
        return {(x.asname or x.name).partition(".")[0] for x in node.names}
    return {x.id for x in ast.walk(node) if isinstance(x, ast.Name) and isinstance(x.ctx, ast.Store)}
