"""Sizes of the FMUs of a scene in bytes: by file, and the C of a native one by purpose."""

import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

from ..kernel.complete import complete
from ..kernel.form import Traced, called
from ..kernel.tables import function_sizes
from ..model.errors import ExportError
from ..model.files import scratch
from ..model.mechanism import Mechanism
from ..runtime.pipeline import packed
from . import native
from .export import export, packed_scene
from .recipe import KINDS, Recipe

_CONTENTS = {
    "binaries/": "compiled libraries",
    "sources/": "their C sources",
    "resources/": "resources: the scene, and the Python code that runs it",
    "documentation/": "documentation, licences, picture",
    "extra/": "reference results",
    "": "description of the model, icon",
}
"""Contents of an FMU by path."""

_PARTS = {
    "an internal step": ("quick", "careful"),
    "an internal step on the branch of the motion, near singular positions": ("branch",),
    "a step by solver.method": ("method", "beside", "regular", "stiff", "reach"),
    "outputs": ("instant", "instant_quick"),
    "limits of outputs at singular positions": ("limit",),
    "steps and outputs that iterate until they converge": (
        *("move", "close"),
        *("instant_patient", "limit_patient"),
    ),
    "impacts of locks": ("impact",),
    "sticking of dry friction": ("gripping",),
}
"""Programs of a scene by purpose."""


def sizes(
    mechanism: Mechanism,
    parameters: Mapping[str, float | str],
    outputs: Sequence[str] | None,
    freeze: Sequence[str] | None,
) -> list[str]:
    """Return sizes of the FMUs of a scene, of each kind, as lines of text; exports them to measure."""
    given: dict[str, Any] = {"parameters": parameters, "outputs": outputs, "freeze": freeze}
    text = []
    for kind in KINDS:
        try:
            found = _contents(mechanism, given, kind)
        except ExportError as error:
            text += [f"no FMU of kind {kind}: {error}", ""]
            continue
        where = f" for {', '.join(native.platforms(mechanism.name, ()))}" if kind == "native" else ""
        text += [f"{f'FMU of kind {kind}{where}, kB':66} {'packed':>8} {'unpacked':>8}"]
        text += [f"  {what:64} {_kB(size)} {_kB(whole)}" for what, (size, whole) in found.items()]
        size, whole = map(sum, zip(*found.values(), strict=True))
        text += [f"  {'in all':64} {_kB(size)} {_kB(whole)}", ""]
    try:
        _, equations = packed_scene(mechanism, **given, kernel=None)
    except ExportError:
        return text[:-1]
    text += [f"{'the scene by purpose, kB; shared functions count for the first one':66} {'':8} {'unpacked':>8}"]
    return text + [f"  {what:64} {'':8} {_kB(size)}" for what, size in _parts(equations).items() if size]


def _contents(mechanism: Mechanism, given: Mapping, kind: str) -> dict[str, tuple[int, int]]:
    """Return sizes of the contents of an FMU, packed and unpacked."""
    found = dict.fromkeys(_CONTENTS, (0, 0))
    with (
        scratch() as folder,
        zipfile.ZipFile(export(Recipe(mechanism).changed(**given, kind=kind), folder)) as archive,
    ):
        for info in archive.infolist():
            place = next(place for place in _CONTENTS if info.filename.startswith(place))
            packed, unpacked = found[place]
            found[place] = packed + info.compress_size, unpacked + info.file_size
    return {_CONTENTS[place]: size for place, size in found.items() if any(size)}


def _parts(equations: Traced) -> dict[str, int]:
    """Return sizes of the parts of a scene file by purpose."""
    left, found, kernel = function_sizes(complete(equations)), {}, complete(equations).kernel
    whole = len(packed(equations))
    for what, programs in _PARTS.items():
        names = {name for program in programs if program in kernel for name in called(kernel[program])}
        found[what] = sum(left.pop(name, 0) for name in names)
    found["programs of the start and of other formulations"] = sum(left.values())
    found["calls of functions in programs, variables"] = whole - sum(found.values())
    return found


def _kB(size: int) -> str:
    return f"{size / 1000:8.1f}"
