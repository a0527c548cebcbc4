"""Setuptools, and ziglang beside it, which builds the runtime for browsers, and for a machine without a C compiler.

A wheel takes the setting `platform` (`pip wheel . -C platform=win64`, names of `alfmu/runtime/build.py`): a release for
that platform, which zig builds on any machine.
"""

import os

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the hooks that need nothing else

_COMPILER = ["ziglang>=0.13; sys_platform == 'linux' or sys_platform == 'darwin' or sys_platform == 'win32'"]
"""Elsewhere it is not offered: there the system's compiler builds, and nothing for browsers."""


def get_requires_for_build_wheel(config_settings=None) -> list[str]:
    return build_meta.get_requires_for_build_wheel(config_settings) + _COMPILER


def get_requires_for_build_editable(config_settings=None) -> list[str]:
    return build_meta.get_requires_for_build_editable(config_settings) + _COMPILER


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None) -> str:
    settings = dict(config_settings or {})
    os.environ["ALFMU_WHEEL"] = settings.pop("platform", "")  # which setup.py reads
    return build_meta.build_wheel(wheel_directory, settings, metadata_directory)
