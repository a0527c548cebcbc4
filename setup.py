"""Builds the C library of the runtime with the package; everything else about it is in pyproject.toml.

The one for browsers (`alfmu live`) is built with it where there is zig, which the build asks for. A wheel for release
has the libraries of all platforms, so that its user exports native FMUs for any of them without a compiler.
"""

import importlib.util
import os
import sys
import tomllib
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).parent
RUNTIME = ROOT / "alfmu" / "runtime"
RELEASE = os.environ.get("ALFMU_WHEEL", "")
"""The platform of a wheel for release, from `scripts/packaging/backend.py`; empty where it is for this machine."""


def _module(name: str, path: Path):
    """A module of a file that needs nothing of alfmu."""
    spec = importlib.util.spec_from_file_location(name, path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _builder():
    return _module("alfmu_runtime_build", RUNTIME / "build.py")


def _description() -> str:
    """README.md, with links that work on a package index."""
    about = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    links = _module("alfmu_links", ROOT / "scripts" / "packaging" / "links.py")
    return links.for_an_index(text, about.get("urls", {}).get("Source"), about["version"])


_LIBRARIES = {
    "library_of_this_machine": ("HERE", 0),
    "library_of_fmi_2": ("HERE", 2),
    "library_of_fmi_3": ("HERE", 3),
    "library_of_browsers": ("WEB", 0),
}
"""What stands for modules of Python, so that setuptools puts them where the package is, their platforms, and their
versions of FMI. The first one of a platform builds all of them, as they consist of the same objects."""


class BuildRuntime(build_ext):
    """The libraries in place of modules for Python."""

    def get_ext_filename(self, name: str) -> str:
        *package, own = name.split(".")
        return str(Path(*package, _builder().file_name(*self.library(own))))

    def build_extension(self, extension: Extension) -> None:
        path = Path(self.get_ext_fullpath(extension.name))
        path.parent.mkdir(parents=True, exist_ok=True)
        builder, (name, fmi) = _builder(), self.library(extension.name.split(".")[-1])
        if fmi:
            return
        for each in builder.PLATFORMS if RELEASE and name == builder.HERE else [name]:
            builder.build(each, path.parent, builder.versions(each), release=bool(RELEASE))

    def library(self, name: str) -> tuple[str, int]:
        platform, fmi = _LIBRARIES[name]
        return getattr(_builder(), platform), fmi


class Wheel(bdist_wheel):
    """A wheel for every Python 3: the library is no module, and knows none of Python."""

    def get_tag(self) -> tuple[str, str, str]:
        platforms = _builder().PLATFORMS
        if RELEASE and RELEASE not in platforms:
            raise SystemExit(f"there is no platform {RELEASE!r}; use one of {', '.join(platforms)}")
        return "py3", "none", platforms[RELEASE].wheel if RELEASE else super().get_tag()[2]


setup(
    long_description=_description(),
    long_description_content_type="text/markdown",
    ext_modules=[
        Extension(f"alfmu.runtime.{x}", []) for x, (name, _) in _LIBRARIES.items() if name == "HERE" or _builder().zig()
    ],
    cmdclass={"build_ext": BuildRuntime, "bdist_wheel": Wheel},
)
