"""Setuptools, and ziglang beside it, which builds the runtime for browsers, and for a machine without a C compiler."""

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the hooks that need nothing else

_COMPILER = ["ziglang>=0.13; sys_platform == 'linux' or sys_platform == 'darwin' or sys_platform == 'win32'"]
"""Elsewhere it is not offered: there the system's compiler builds, and nothing for browsers."""


def get_requires_for_build_wheel(config_settings=None) -> list[str]:
    return build_meta.get_requires_for_build_wheel(config_settings) + _COMPILER


def get_requires_for_build_editable(config_settings=None) -> list[str]:
    return build_meta.get_requires_for_build_editable(config_settings) + _COMPILER
