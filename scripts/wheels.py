"""The source archive and a wheel for each platform, built on any machine by zig, opened and checked.

`pip install ".[release]"`, then `python scripts/wheels.py`. The wheels are built from the source archive, in an
isolated environment. Every wheel has the runtime for all platforms and for browsers; wheels differ only in their tags.
The exit code is 1 if a check fails.
"""

import argparse
import base64
import configparser
import csv
import hashlib
import os
import re
import struct
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from email.parser import Parser
from pathlib import Path

from build import BuildBackendException, ProjectBuilder
from build.env import DefaultIsolatedEnv
from pyproject_hooks import quiet_subprocess_runner as quietly

from alfmu.runtime.build import HERE, PLATFORMS, WEB, file_name, versions

ROOT = Path(__file__).parents[1]

GLIBC = (2, 17)
"""Newest version of glibc whose symbols a library may need, as `manylinux_2_17` promises."""

_FORMATS = {
    "linux64": ("ELF", 62),
    "aarch64-linux": ("ELF", 183),
    "win64": ("PE", 0x8664),
    "darwin64": ("Mach-O", 0x01000007),
    "aarch64-darwin": ("Mach-O", 0x0100000C),
    WEB: ("WebAssembly", 1),
}
"""Platform -> format of its libraries, and the format's number for the processor (WebAssembly: the version)."""

_RUN = """
import alfmu
assert alfmu.__file__.startswith({folder!r}), alfmu.__file__
r = alfmu.simulate("five_bar", 0.1, 0.02)
assert len(r.time) == 6, r
"""


def machine(data: bytes) -> tuple[str, int]:
    """Return the format of a library and its number for the processor; ("", 0) for an unknown format."""
    if data[:4] == b"\x7fELF":
        return "ELF", struct.unpack_from("<H", data, 18)[0]
    if data[:2] == b"MZ":
        at = struct.unpack_from("<I", data, 0x3C)[0]
        return ("PE", struct.unpack_from("<H", data, at + 4)[0]) if data[at : at + 4] == b"PE\0\0" else ("", 0)
    if data[:4] == b"\xcf\xfa\xed\xfe":
        return "Mach-O", struct.unpack_from("<I", data, 4)[0]
    if data[:4] == b"\0asm":
        return "WebAssembly", struct.unpack_from("<I", data, 4)[0]
    return "", 0


def problems(path: Path, name: str) -> list[str]:
    """Return the errors of a wheel for a platform: in names, tag, metadata, files and libraries."""
    with zipfile.ZipFile(path) as archive:
        files = {file: archive.read(file) for file in archive.namelist() if not file.endswith("/")}
    [info] = {file.partition("/")[0] for file in files if file.partition("/")[0].endswith(".dist-info")}
    found = []
    if extra := {file.partition("/")[0] for file in files} - {"alfmu", info}:
        found.append(f"names beside alfmu: {', '.join(sorted(extra))}")
    tag = f"py3-none-{PLATFORMS[name].wheel}"
    if not path.stem.endswith(f"-{tag}") or f"Tag: {tag}\n".encode() not in files[f"{info}/WHEEL"]:
        found.append(f"its tag is not {tag}")
    about = Parser().parsestr(files[f"{info}/METADATA"].decode())
    if about["License-Expression"] != "MIT":
        found.append(f"its licence is {about['License-Expression']}")
    found += [f"no {x}" for x in about.get_all("License-File", []) if f"{info}/licenses/{x}" not in files]
    found += _unlike_their_record(files, info) + _missing_entries(files, info)
    for each in (*PLATFORMS, WEB):
        for fmi in versions(each):
            library = f"alfmu/runtime/{file_name(each, fmi)}"
            found += [f"{library} {what}" for what in _of_library(files.get(library, b""), each, fmi)]
    return found


def _unlike_their_record(files: dict[str, bytes], info: str) -> list[str]:
    """Return the files that the wheel's record does not list, or lists with another digest."""
    rows = {file: digest for file, digest, _ in csv.reader(files[f"{info}/RECORD"].decode().splitlines())}
    digests = {
        file: base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=") for file, data in files.items()
    }
    wrong = [file for file in files if rows.get(file) not in (f"sha256={digests[file].decode()}", "")]
    return [f"{file} is not as recorded" for file in sorted({*wrong, *rows.keys() - files.keys()})]


def _missing_entries(files: dict[str, bytes], info: str) -> list[str]:
    """Return the missing modules of entry points, and the missing READMEs of mechanisms."""
    entries = configparser.ConfigParser()
    entries.optionxform = str
    entries.read_string(files[f"{info}/entry_points.txt"].decode())
    modules = {value.partition(":")[0].replace(".", "/") for group in entries.values() for value in group.values()}
    missing = [m for m in sorted(modules) if not {f"{m}.py", f"{m}/__init__.py"} & files.keys()]
    folders = [value.partition(":")[0].replace(".", "/") for value in entries["alfmu.mechanisms"].values()]
    return [f"no module {m}" for m in missing] + [f"no {x}/README.md" for x in folders if f"{x}/README.md" not in files]


def _of_library(data: bytes, name: str, fmi: int = 0) -> list[str]:
    """Return the errors of the library for a platform and a version of FMI."""
    if machine(data) != _FORMATS[name]:
        return [f"is {machine(data)}, not {_FORMATS[name]}"]
    wanted = f"fmi{fmi}DoStep" if fmi else "alfmu_scene_load"
    found = [] if wanted.encode() in data else [f"has no {wanted}"]
    newest = max(((int(a), int(b)) for a, b in re.findall(rb"GLIBC_(\d+)\.(\d+)", data)), default=GLIBC)
    if newest > GLIBC:
        found.append(f"needs glibc {'.'.join(map(str, newest))}")
    return found


def runs(path: Path) -> list[str]:
    """Return the errors of a run of a mechanism from this machine's wheel, with the packages of this environment."""
    with tempfile.TemporaryDirectory(prefix="alfmu_") as folder, zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
        command = [sys.executable, "-P", "-c", _RUN.format(folder=folder)]
        environment = {**os.environ, "PYTHONPATH": folder}
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder, env=environment)
    return [f"does not run: {done.stderr.strip().splitlines()[-1]}"] if done.returncode else []


def built(out: Path, names: list[str]) -> dict[str, Path]:
    """Build the source archive, and from it the wheels of platforms; return the wheels by platform."""
    with DefaultIsolatedEnv() as environment, tempfile.TemporaryDirectory(prefix="alfmu_") as folder:
        builder = ProjectBuilder.from_isolated_env(environment, ROOT, quietly)
        environment.install(builder.build_system_requires)
        environment.install(builder.get_requires_for_build("sdist"))
        source = Path(builder.build("sdist", out))
        print(source)
        with tarfile.open(source) as archive:
            archive.extractall(folder, filter="data")
        unpacked = Path(folder) / source.name.removesuffix(".tar.gz")
        if made := [path.name for path in (unpacked / "alfmu" / "runtime").glob("*-*")]:
            raise SystemExit(f"{source} has libraries of this machine: {', '.join(made)}")
        builder = ProjectBuilder.from_isolated_env(environment, unpacked, quietly)
        environment.install(builder.get_requires_for_build("wheel"))
        return {name: Path(builder.build("wheel", out, {"platform": name})) for name in names}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("platforms", nargs="*", metavar="PLATFORM", help=f"of {', '.join(PLATFORMS)}; all by default")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist", help="folder for the archives")
    given = parser.parse_args()
    if unknown := set(given.platforms) - PLATFORMS.keys():
        parser.error(f"there is no platform {', '.join(sorted(unknown))}; use one of {', '.join(PLATFORMS)}")
    wrong = False
    try:
        wheels = built(given.output, given.platforms or list(PLATFORMS))
    except BuildBackendException as error:
        sys.exit(getattr(error.exception, "output", b"").decode(errors="replace") + str(error))
    for name, path in wheels.items():
        found = problems(path, name) + (runs(path) if name == HERE else [])
        wrong = wrong or bool(found)
        print(f"{path} ({path.stat().st_size / 1e6:.1f} MB): {'; '.join(found) or 'checked'}")
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
