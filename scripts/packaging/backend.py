"""Setuptools, and ziglang beside it where this machine has no C compiler to build the runtime with."""

import os
import shutil

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403 - the hooks that need nothing else


def _compiler() -> list[str]:
    there = os.environ.get("CC") or any(shutil.which(name) for name in ("cc", "gcc", "clang"))
    return [] if there else ["ziglang>=0.13"]


def get_requires_for_build_wheel(config_settings=None) -> list[str]:
    return build_meta.get_requires_for_build_wheel(config_settings) + _compiler()


def get_requires_for_build_editable(config_settings=None) -> list[str]:
    return build_meta.get_requires_for_build_editable(config_settings) + _compiler()
