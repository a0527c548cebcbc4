"""What reading and writing an SSP have in common: its names."""

from __future__ import annotations

__all__ = ["DESCRIPTION", "OSP", "OWN", "SPACES", "VERSIONS", "tag"]

VERSIONS = ("1.0", "2.0")
"""Of SSP."""

SPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "https://open-simulation-platform.com/SSP/OSPAnnotations",
    "alfmu": "urn:alfmu:system",
}
"""Prefixes, which libcosim and ecos take as part of the names, and namespaces."""

DESCRIPTION = "SystemStructure.ssd"
OSP, OWN = "com.opensimulationplatform", "alfmu"


def tag(name: str) -> str:
    """The name of an element as ElementTree has it."""
    prefix, _, local = name.partition(":")
    return f"{{{SPACES[prefix]}}}{local}"
