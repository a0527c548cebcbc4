"""Export: equations and the run side of alfmu packed as an FMU, reproducible to the byte."""

import hashlib
import importlib.metadata
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
from typing import Any, Protocol
from xml.etree import ElementTree as ET

from ..equations import Equations
from ..equations.specialisation import starting_at
from ..kernel import DEFAULT
from ..kernel.complete import complete
from ..kernel.exchange import exchanged, indicators, obstacle
from ..kernel.form import Traced
from ..kernel.tables import identified, interface, known_choices
from ..model.doubts import tell_of_gravity
from ..model.errors import ExportError
from ..model.files import atomic, scratch
from ..model.mechanism import Mechanism
from ..model.settings import Settings
from ..model.sources import is_file
from ..runtime import Instance
from ..runtime.build import HERE, PLATFORMS, file_name
from ..runtime.compiled import compiled_scene, verified
from ..runtime.pipeline import chosen, derive, packed
from ..simulation import prepared, with_defaults
from ..view.picture import model_png
from . import native
from .description import (
    build_description,
    dependencies,
    documentation,
    enumerated,
    model_description,
)
from .recipe import Recipe
from .records import record_files
from .slave import COMPILED, OPTIONS, SCENE
from .source import paced, source
from .terminals import document, terminals

RUN_SIDE = ("runtime/library.py", "fmi/slave.py")
"""Modules of alfmu packed into an FMU for Python, beside the C library."""

HOSTS = ("linux64", "win64")
"""Platforms supported by pythonfmu's library."""

_ENTRY = '''"""FMU entry of {name}: the class that pythonfmu runs."""

from {package}.fmi.slave import Slave


class {title}(Slave):
    """The mechanism behind FMI 2.0."""
'''

_PINNED = (1980, 1, 1, 0, 0, 0)
"""Time stamp of every file in the archive, the earliest of the zip format."""


class Rest(Protocol):
    """An equilibrium with the interface of `alfmu.Equilibrium`: coordinates, states, stored values of locks and
    motions."""

    @property
    def q(self) -> Any: ...
    @property
    def states(self) -> Any: ...
    @property
    def kept(self) -> Any: ...


def export(recipe: Recipe, path: str | Path | None = None, rest: Rest | None = None) -> Path:
    """Write the FMU of a recipe and return its path; `rest` is an equilibrium in which it starts;
    see `alfmu.export`."""
    if recipe.kind == "source":
        recipe = _fixed(recipe)
    declared = recipe.declared()
    every, equations = _scene(recipe, declared, rest)
    path = Path(path or f"{equations.name}.fmu")
    if path.is_dir():
        path = path / f"{equations.name}.fmu"
    if recipe.kind == "source":
        if equations.jacobian:
            text = "sources have no interface Jacobian; leave it out, or use --kind native"
            raise ExportError(f"{equations.name}: {text}")
        equations = paced(equations, fixed="solver.step_size" in recipe.parameters)
    if recipe.kind == "source" and path.suffix == ".c":
        if recipe.fmi != 2:
            raise ExportError(f"{equations.name}: plain C is of no version of FMI; leave --fmi out, or write an .fmu")
        return _plain(equations, path)
    if path.suffix != ".fmu":
        raise ExportError(f"{equations.name}: {path} does not end in .fmu")

    version = importlib.metadata.version("alfmu")
    apart = ("solver.",) if recipe.start == "declared" else ("solver.", "start.")
    posed = {name: value for name, value in recipe.parameters.items() if not name.startswith(apart)}
    key = tuple(sorted((name, repr(value)) for name, value in posed.items()))
    picture = every.kept.latest(model_png, lambda: model_png(declared, posed, equations=every), key)
    results = record_files(equations) if recipe.reference else {}
    files_of = _python if recipe.kind == "python" else _native
    archive(path, {**results, **files_of(recipe, equations, declared, version, picture)})
    return path


def _python(recipe: Recipe, equations: Traced, declared: Mechanism, version: str, picture: bytes) -> dict[str, bytes]:
    """Return the files of an FMU of kind python."""
    from pythonfmu.builder import FmuBuilder

    sources, scene, name = {each: _source(each) for each in RUN_SIDE}, packed(equations), equations.name
    hosts = [each for each in native.platforms(name, ()) if each in HOSTS]
    libraries = {file_name(each): data for each, data in native.libraries(name, hosts).items()}
    content = [_ENTRY.encode(), *(text.encode() for text in sources.values()), scene]
    digest = hashlib.sha256(b"\0".join(content)).hexdigest()[:16]
    package, generator = f"alfmu_{name}_{digest}", _generator()
    guid = _guid(generator, digest)
    entry = _ENTRY.format(name=name, package=package, title=name.title().replace("_", ""))
    resources = {**_resources(recipe, equations, scene, guid), **libraries}

    with scratch() as top:
        script = _write(top / f"{name}_{digest}.py", entry)
        _write(top / package / "__init__.py", '"""The run side of alfmu."""\n')
        for room in sorted({str(Path(module).parent) for module in sources} - {"."}):
            _write(top / package / room / "__init__.py", '"""Part of the run side."""\n')
        for module, text in sources.items():
            _write(top / package / module, text)
        for file, data in resources.items():
            (top / file).write_bytes(data)
        documents, needs = top / "documentation", dependencies()
        page = documentation(equations, declared.sketch, declared.documentation, generator, needs, _PICTURE[2])
        _write(documents / "index.html", page)
        _write(documents / "externalDependencies.txt", needs + "\n")
        for each in ("alfmu", "pythonfmu"):
            _write(documents / "licenses" / f"{each}.txt", _license(each))
        made = top / f"{name}.fmu"
        with _imports_undone(package, script.stem), _temporary_in(top):
            FmuBuilder.build_FMU(script, made, [top / package, *(top / file for file in resources)], documents)
        description = model_description(equations, version, generator, guid, credits=_credits(declared))
        with zipfile.ZipFile(made) as built:
            files = {info.filename: built.read(info) for info in built.infolist() if not info.is_dir()}
        return {**files, "modelDescription.xml": description, _PICTURE[2]: picture}


def described(recipe: Recipe, rest: Rest | None = None) -> tuple[ET.Element, dict[str, bytes]]:
    """Return the description of an FMU of kind python and the files of its scene, for pythonfmu's own command."""
    recipe = recipe.changed(kind="python")
    declared = recipe.declared()
    _, equations = _scene(recipe, declared, rest)
    scene, generator = packed(equations), _generator()
    guid = _guid(generator, hashlib.sha256(scene).hexdigest())
    version = importlib.metadata.version("alfmu")
    text = model_description(equations, version, generator, guid, credits=_credits(declared))
    return ET.fromstring(text), _resources(recipe, equations, scene, guid)


def _scene(recipe: Recipe, declared: Mechanism, rest: Rest | None) -> tuple[Equations, Traced]:
    r = recipe
    return packed_scene(declared, r.parameters, r.outputs, r.freeze, r.kernel, rest)


def _resources(recipe: Recipe, equations: Traced, scene: bytes, guid: str) -> dict[str, bytes]:
    """Return the files of a scene by name, with compiled functions if there are any."""
    files = {SCENE: identified(scene, guid), OPTIONS: _options(recipe, equations)}
    if equations.library:
        library = compiled_scene(equations, files[SCENE])
        files[f"{COMPILED}{HERE}{library.suffix}"] = verified(equations.name, library)
    return files


def _generator() -> str:
    """Return the generator of FMUs of kind python."""
    return f"alfmu {importlib.metadata.version('alfmu')} with pythonfmu {importlib.metadata.version('pythonfmu')}"


def packed_scene(
    declared: Mechanism,
    parameters: Mapping[str, float | str] | None,
    outputs: Sequence[str] | None,
    freeze: Sequence[str] | None,
    kernel: str | None,
    rest: Rest | None = None,
) -> tuple[Equations, Traced]:
    """Return all equations of a mechanism, and its traced scene with the requested outputs and frozen parameters.

    The arguments are those of `alfmu.export`; the position of `rest`, if given, becomes the start values.
    """
    every = derive(declared)
    tell_of_gravity(declared)
    equations = chosen(every, parameters or {}, outputs, freeze)
    if rest is not None:
        begun = with_defaults(every, parameters or {})
        every = starting_at(begun, rest.q, rest.states, rest.kept)
        equations = starting_at(equations, rest.q, rest.states, rest.kept)
    native.checked(equations)
    scene = prepared(equations, kernel or DEFAULT)
    Instance(scene).initialize()  # refuses an FMU that cannot start
    return every, scene


def _native(recipe: Recipe, equations: Traced, declared: Mechanism, version: str, picture: bytes) -> dict[str, bytes]:
    """Return the files of a native FMU or of a source-code FMU."""
    e, fmi, bare = equations, recipe.fmi, recipe.kind == "source"
    chosen = [] if bare else native.platforms(e.name, recipe.platforms)
    interfaces, derivatives = _interfaces(recipe, e), recipe.derivatives is not False
    states = [] if bare or obstacle(complete(e)) else exchanged(e)
    scene, generator = packed(e), f"alfmu {version}"
    guid = _guid(generator, hashlib.sha256(scene + b"source" * bare).hexdigest())
    variables, choices = interface(e).causalities, known_choices(e)
    if bare:
        files, scene_files = source(e, fmi, guid), {}
        needs = "This FMU is C to be compiled: one file of C99 that needs math.h and string.h."
        choices["solver.formulation"] = {RESIDUAL: choices["solver.formulation"][RESIDUAL]}
    else:
        without = native.left_out(e, derivatives, "me" in interfaces)
        files = native.used(native.sources(fmi, without)) if recipe.sources else {}
        scene_files = {f"resources/{SCENE}": identified(scene, guid), f"resources/{OPTIONS}": _options(recipe, e)}
        needs = "This FMU needs nothing but the C library."
    compiled = [name for name in files if name.endswith(".c")]
    listed = enumerated(variables, choices)
    page = documentation(e, declared.sketch, declared.documentation, generator, needs, _PICTURE[fmi], listed)
    found = terminals(declared, [v.name for _, v in variables])
    facts = _credits(declared), choices, fmi, derivatives, interfaces, states, indicators(e) if states else [], bare
    described = model_description(e, version, generator, guid, variables, compiled, *facts)
    form = {}
    if fmi == 3:
        form["terminalsAndIcons/terminalsAndIcons.xml"] = document(found)
        if compiled:
            form["sources/buildDescription.xml"] = build_description(e.name, compiled)
    libraries = native.component(e.name, identified(scene, guid)) if native.WASM in chosen else {}
    for each, data in native.libraries(e.name, [name for name in chosen if name != native.WASM], fmi).items():
        platform = PLATFORMS[each]
        folder = each if fmi == 2 else platform.fmi3
        libraries[f"binaries/{folder}/{e.name}{platform.suffix}"] = data
    return {
        "modelDescription.xml": described,
        **form,
        _PICTURE[fmi]: picture,
        "documentation/index.html": page.encode(),
        "documentation/licenses/alfmu.txt": _license("alfmu").encode(),
        **scene_files,
        **{f"sources/{name}": text.encode() for name, text in files.items()},
        **libraries,
    }


RESIDUAL = Settings.formulation
"""The only formulation available in source FMUs."""


def _fixed(recipe: Recipe) -> Recipe:
    """Return the recipe of a source FMU, which steps by RK4; raise ExportError if it asks for another method."""
    for name, only in (("solver.method", "rk4"), ("solver.formulation", RESIDUAL)):
        if (asked := recipe.parameters.get(name, only)) != only:
            raise ExportError(
                f"{recipe}: sources support only {name} {only}, whose work in a step is bounded, not {asked}; leave "
                f"{name} out, or use --kind native"
            )
    return recipe.changed(parameters={"solver.method": "rk4"}, interface="cs", derivatives=False)


def _plain(equations: Traced, path: Path) -> Path:
    """Write plain C in place of an FMU."""
    if path.stem != equations.name:
        raise ExportError(f"{equations.name}: C has the name of the model; write {equations.name}.c, not {path.name}")
    for name, text in source(equations).items():
        with atomic(path.with_name(name)) as file:
            file.write(text.encode("ascii"))
    return path


def _interfaces(recipe: Recipe, equations: Traced) -> tuple[str, ...]:
    """Return the interfaces of a native FMU, from "me" and "cs"; raise ExportError if the wanted ones are
    impossible."""
    why = obstacle(complete(equations)) if recipe.interface != "cs" else ""
    if why and recipe.interface:
        raise ExportError(
            f"{equations.name}: it cannot be exported for Model Exchange, as {why}; use --interface cs, co-simulation"
        )
    asked = "cs" if why else recipe.interface or "both"
    return ("me", "cs") if asked == "both" else (asked,)


_PICTURE = {2: "model.png", 3: "terminalsAndIcons/icon.png"}
"""Path of the picture by version of FMI."""


def _credits(declared: Mechanism) -> dict[str, str]:
    """Return author and copyright, and the date if SOURCE_DATE_EPOCH is set, so that exports are reproducible."""
    rights = next((line for line in _license("alfmu").splitlines() if line.startswith("Copyright")), "")
    date = ""
    if epoch := os.environ.get("SOURCE_DATE_EPOCH"):
        if not epoch.isdecimal():
            raise ExportError(f"SOURCE_DATE_EPOCH is {epoch!r}; give seconds since 1970, or unset it")
        date = datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    found = {"author": declared.author, "copyright": rights, "generationDateAndTime": date}
    return {name: value for name, value in found.items() if value}


def _options(recipe: Recipe, equations: Equations) -> bytes:
    """Return the file with the mechanism, from which it is drawn, and its options."""
    registered = isinstance(recipe.mechanism, str) and not is_file(recipe.mechanism)
    facts = {"mechanism": recipe.mechanism if registered else equations.name, "options": equations.options}
    return json.dumps(facts, indent=1).encode()


def _guid(generator: str, digest: str) -> str:
    return "{" + str(uuid.uuid5(uuid.NAMESPACE_URL, f"alfmu:{generator}:{digest}")) + "}"


def _source(name: str) -> str:
    return (Path(__file__).parents[1] / name).read_text(encoding="utf-8")


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", newline="\n")
    return path


def _license(distribution: str) -> str:
    """Return the licence text of an installed package, or its declared licence."""
    for file in importlib.metadata.files(distribution) or ():
        if re.search(r"LICEN[CS]E", file.name) and Path(str(file.locate())).is_file():
            return file.read_text()
    about = importlib.metadata.metadata(distribution)
    terms = next((about[key] for key in ("License-Expression", "License") if key in about), "see its site")
    return f"{distribution} {about['Version']}: {terms}\n"


@contextmanager
def _imports_undone(*names: str) -> Iterator[None]:
    """Remove modules and search paths that packing imports."""
    path = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = path
        for module in [m for m in sys.modules if m.split(".")[0] in names]:
            del sys.modules[module]


@contextmanager
def _temporary_in(folder: Path) -> Iterator[None]:
    """Redirect a library's temporary folders to this folder, which is removed even after a kill."""
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


def archive(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a zip archive of these files, sorted, compressed, without time stamps and owners."""
    with atomic(path) as file, zipfile.ZipFile(file, "w") as packed_files:
        for name in sorted(files):
            info = zipfile.ZipInfo(name, _PINNED)
            info.external_attr = 0o644 << 16
            packed_files.writestr(info, files[name], zipfile.ZIP_DEFLATED, 8)
