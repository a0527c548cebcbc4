"""Export: equations and the run side of alfmu packed as an FMU by pythonfmu, reproducible to the byte."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import re
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pythonfmu.builder import FmuBuilder

from ..equations import Equations
from ..equations.derivation import derive
from ..equations.specialisation import specialised
from ..kernel import DEFAULT
from ..kernel.build import compiled_scene, verified
from ..kernel.tables import identified, interface, known_choices, packed
from ..model.errors import ExportError
from ..model.mechanism import Mechanism
from ..model.registry import load
from ..runtime import Instance
from ..runtime.build import HERE
from ..simulation import prepared, with_defaults
from ..view.picture import model_png
from . import native
from .description import (
    build_description,
    dependencies,
    documentation,
    enumerated,
    model_description,
    model_description3,
)
from .experiment import reference_results
from .slave import COMPILED, OPTIONS, SCENE
from .terminals import document, terminals

__all__ = ["KINDS", "RUN_SIDE", "export", "packed_scene"]

KINDS = {
    "python": "runs in Python, in hosts that have it: Linux and Windows on x86-64",
    "native": "a C library and nothing else: for every host, on the platforms that it carries",
}
"""Kinds of FMUs."""

GROUP = "alfmu.fmus"
"""Entry-point group of modules with a pythonfmu class for the mechanism of the same name."""

RUN_SIDE = ("runtime/library.py", "fmi/slave.py")
"""Modules of alfmu that travel inside an FMU for Python, beside the C library."""

HOSTS = ("linux64", "win64")
"""Platforms that pythonfmu has a library for."""

_ENTRY = '''"""FMU entry of a mechanism that has none of its own."""

from alfmu.fmi.slave import Slave


class Entry(Slave):
    """The mechanism behind FMI 2.0."""
'''

_PINNED = (1980, 1, 1, 0, 0, 0)
"""Time stamp of every file in the archive: the earliest that zip can hold."""


def export(
    mechanism: str | Path | Mechanism,
    path: str | Path | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    parameters: Mapping[str, float | str] | None = None,
    outputs: Sequence[str] | None = None,
    freeze: Sequence[str] | None = None,
    kernel: str | None = None,
    kind: str = "python",
    platforms: Sequence[str] = (),
    fmi: int = 2,
    reference: bool = True,
) -> Path:
    """Write the FMU (co-simulation) of a mechanism and return its path, `<name>.fmu` by default.

    `options` are the mechanism's own; `parameters` changes the defaults of parameters, start values, inputs and solver
    variables. Only outputs that match `outputs` (names, or patterns such as `link*.angle`) are there, None for all; the
    parameters in `freeze` become constants, `["all"]` for every one. `kind` is one of `KINDS`. `kernel` is what runs in
    one that runs in Python (`alfmu.kernel.KERNELS`, but for `oracle`): one with compiled functions runs without them on
    other platforms. A native one is for `platforms` (`alfmu.fmi.native.PLATFORMS`, or
    `all`), this one by default, and may be of FMI 3 (`fmi`). Reference results (`alfmu.fmi.experiment`) are inside
    unless `reference` is False. The same arguments give the same bytes. Raises AlfmuError where the mechanism cannot
    start from the defaults, and ExportError where the file cannot be written or compiled.
    """
    if kind not in KINDS:
        raise ExportError(f"there is no kind {kind!r} of FMU; use one of {', '.join(KINDS)}")
    if kernel == "oracle":
        raise ExportError("no FMU carries the oracle, which is for comparison in the library; leave --kernel out")
    if kind == "native" and kernel is not None:
        raise ExportError("a native FMU has a kernel of its own; leave --kernel out")
    if kind == "python" and platforms:
        raise ExportError("an FMU that runs in Python is for no platform of its own; leave --platform out")
    if fmi not in (2, 3) or (fmi == 3 and kind != "native"):
        raise ExportError(f"there is no {kind} FMU of FMI {fmi}; use FMI 2, or a native one of FMI 3")
    declared = load(mechanism, **(options or {}))
    derived, equations = packed_scene(declared, parameters, outputs, freeze, kernel, kind)
    path = Path(path or f"{equations.name}.fmu")
    if path.is_dir():
        path = path / f"{equations.name}.fmu"
    if path.suffix != ".fmu":
        raise ExportError(f"{equations.name}: {path} does not end in .fmu")

    version = importlib.metadata.version("alfmu")
    posed = {name: value for name, value in (parameters or {}).items() if not name.startswith("solver.")}
    picture = model_png(declared, posed, equations=derived)
    results = reference_results(equations) if reference else {}
    if kind == "native":
        _archive(path, {**results, **_native(equations, declared, version, picture, platforms, fmi)})
        return path
    generator = f"alfmu {version} with pythonfmu {importlib.metadata.version('pythonfmu')}"
    sources, scene, entry = {name: _source(name) for name in RUN_SIDE}, packed(equations), _entry(equations.name)
    hosts = [name for name in native.platforms(equations.name, ()) if name in HOSTS]
    libraries = {native.file_name(name): data for name, data in native.libraries(equations.name, hosts).items()}
    content = [entry.encode(), *(text.encode() for text in sources.values()), scene]
    digest = hashlib.sha256(b"\0".join(content)).hexdigest()[:16]
    package = f"alfmu_{equations.name}_{digest}"
    guid = _guid(generator, digest)
    resources = {SCENE: identified(scene, guid), OPTIONS: _options(equations), **libraries}
    if equations.library:
        library = compiled_scene(equations, resources[SCENE])
        resources[f"{COMPILED}{HERE}{library.suffix}"] = verified(equations.name, library)

    with tempfile.TemporaryDirectory(prefix="alfmu_") as folder:
        top = Path(folder)
        script = _write(top / f"{equations.name}_{digest}.py", entry.replace("alfmu.fmi.slave", f"{package}.fmi.slave"))
        _write(top / package / "__init__.py", '"""The run side of alfmu."""\n')
        for name in sorted({str(Path(module).parent) for module in sources} - {"."}):
            _write(top / package / name / "__init__.py", '"""Part of the run side."""\n')
        for name, text in sources.items():
            _write(top / package / name, text)
        for name, data in resources.items():
            (top / name).write_bytes(data)
        documents, needs = top / "documentation", dependencies()
        page = documentation(equations, declared.sketch, declared.documentation, generator, needs)
        _write(documents / "index.html", page)
        _write(documents / "externalDependencies.txt", needs + "\n")
        for name in ("alfmu", "pythonfmu"):
            _write(documents / "licenses" / f"{name}.txt", _license(name))
        (documents / "model.png").write_bytes(picture)
        made = top / f"{equations.name}.fmu"
        with _imports_undone(package, script.stem):
            FmuBuilder.build_FMU(script, made, [top / package, *(top / name for name in resources)], documents)
        described = {
            "modelDescription.xml": model_description(equations, version, generator, guid, credits=_credits(declared)),
            "model.png": picture,
        }
        with zipfile.ZipFile(made) as archive:
            files = {info.filename: archive.read(info) for info in archive.infolist() if not info.is_dir()}
        _archive(path, {**files, **described, **results})
    return path


def packed_scene(
    declared: Mechanism,
    parameters: Mapping[str, float | str] | None,
    outputs: Sequence[str] | None,
    freeze: Sequence[str] | None,
    kernel: str | None,
    kind: str,
) -> tuple[Equations, Equations]:
    """All equations of a mechanism, and what of them an FMU of a kind carries, prepared; the arguments of `export`."""
    derived = derive(declared)
    equations = specialised(with_defaults(derived, parameters or {}), outputs, freeze)
    if kind == "native":
        native.checked(equations)
    equations = prepared(equations, kernel or DEFAULT)
    Instance(equations).initialize()  # an FMU that cannot start is not worth writing
    return derived, equations


def _native(
    equations: Equations, declared: Mechanism, version: str, picture: bytes, platforms: Sequence[str], fmi: int
) -> dict[str, bytes]:
    """The files of a native FMU."""
    e = equations
    chosen = native.platforms(e.name, platforms)
    files, scene = native.sources(), packed(e)
    generator = f"alfmu {version}"
    guid = _guid(generator, hashlib.sha256(scene).hexdigest())
    compiled = [name for name in files if name.endswith(".c")]
    needs = "This FMU needs nothing but the C library."
    variables, choices = interface(e).causalities, known_choices(e)
    page = documentation(e, declared.sketch, declared.documentation, generator, needs, enumerated(variables, choices))
    found = terminals(declared, [v.name for _, v in variables])
    if fmi == 2:
        described = model_description(e, version, generator, guid, variables, compiled, _credits(declared), choices)
        form = {}
    else:
        described = model_description3(e, version, generator, guid, variables, _credits(declared), choices)
        form = {
            "sources/buildDescription.xml": build_description(e.name, compiled),
            "terminalsAndIcons/terminalsAndIcons.xml": document(found),
        }
    libraries = {}
    for each, data in native.libraries(e.name, chosen).items():
        platform = native.PLATFORMS[each]
        folder = each if fmi == 2 else platform.fmi3
        libraries[f"binaries/{folder}/{e.name}{platform.suffix}"] = data
    return {
        "modelDescription.xml": described,
        **form,
        _PICTURE[fmi]: picture,
        "documentation/index.html": page.encode(),
        "documentation/model.png": picture,
        "documentation/licenses/alfmu.txt": _license("alfmu").encode(),
        f"resources/{SCENE}": identified(scene, guid),
        f"resources/{OPTIONS}": _options(e),
        **{f"sources/{name}": text.encode() for name, text in files.items()},
        **libraries,
    }


_PICTURE = {2: "model.png", 3: "terminalsAndIcons/icon.png"}
"""Where tools look for a picture."""


def _credits(declared: Mechanism) -> dict[str, str]:
    """Author and copyright; the date where SOURCE_DATE_EPOCH gives one, as the same arguments give the same bytes."""
    rights = next((line for line in _license("alfmu").splitlines() if line.startswith("Copyright")), "")
    date = ""
    if epoch := os.environ.get("SOURCE_DATE_EPOCH"):
        if not epoch.isdecimal():
            raise ExportError(f"SOURCE_DATE_EPOCH is {epoch!r}; give seconds since 1970, or unset it")
        date = datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    found = {"author": declared.author, "copyright": rights, "generationDateAndTime": date}
    return {name: value for name, value in found.items() if value}


def _options(equations: Equations) -> bytes:
    return json.dumps({"options": equations.options}, indent=1).encode()


def _guid(generator: str, digest: str) -> str:
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, f"alfmu:{generator}:{digest}")) + "}"


def _entry(name: str) -> str:
    for entry in importlib.metadata.entry_points(group=GROUP):
        if entry.name == name:
            spec = importlib.util.find_spec(entry.module)
            return Path(spec.origin).read_text(encoding="utf-8")
    return _ENTRY


def _source(name: str) -> str:
    return (Path(__file__).parents[1] / name).read_text(encoding="utf-8")


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")
    return path


def _license(distribution: str) -> str:
    """Licence text of an installed package, or its declared licence."""
    for file in importlib.metadata.files(distribution) or ():
        if re.search(r"LICEN[CS]E", file.name) and file.locate().is_file():
            return file.read_text()
    about = importlib.metadata.metadata(distribution)
    terms = about.get("License-Expression") or about.get("License") or "see its site"
    return f"{distribution} {about['Version']}: {terms}\n"


@contextmanager
def _imports_undone(*names: str) -> Iterator[None]:
    """Leave no trace of modules and search paths that packing imports."""
    path = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = path
        for module in [m for m in sys.modules if m.split(".")[0] in names]:
            del sys.modules[module]


def _archive(path: Path, files: Mapping[str, bytes]) -> None:
    """An FMU of these files, sorted, compressed, and free of time stamps and owners."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.getpid()}")
        with zipfile.ZipFile(partial, "w") as archive:
            for name in sorted(files):
                info = zipfile.ZipInfo(name, _PINNED)
                info.external_attr = 0o644 << 16
                archive.writestr(info, files[name], zipfile.ZIP_DEFLATED, 9)
        partial.replace(path)
    except OSError as error:
        raise ExportError(f"{path.stem}: cannot write {path} ({error.strerror})") from error
