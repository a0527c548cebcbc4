"""Builds the C library of the runtime with the package; everything else about it is in pyproject.toml.

The one for browsers (`alfmu live`) is built with it where there is zig, which the build asks for.
"""

import importlib.util
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

RUNTIME = Path(__file__).parent / "alfmu" / "runtime"


def _builder():
    """alfmu/runtime/build.py, which needs nothing of alfmu."""
    spec = importlib.util.spec_from_file_location("alfmu_runtime_build", RUNTIME / "build.py")
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class BuildRuntime(build_ext):
    """The library in place of a module for Python."""

    def get_ext_filename(self, name: str) -> str:
        return str(Path(*name.split(".")[:-1], _builder().file_name(_builder().HERE)))

    def build_extension(self, extension: Extension) -> None:
        builder, path = _builder(), Path(self.get_ext_fullpath(extension.name))
        path.parent.mkdir(parents=True, exist_ok=True)
        builder.build(builder.HERE, path)
        if builder.zig():
            builder.build(builder.WEB, path.with_name(builder.file_name(builder.WEB)))


setup(
    ext_modules=[Extension("alfmu.runtime.library_of_this_machine", [])],
    cmdclass={"build_ext": BuildRuntime},
)
