"""Names common to reading and writing an SSP."""

VERSIONS = ("1.0", "2.0")
"""Supported versions of SSP."""

SPACES = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "osp": "https://open-simulation-platform.com/SSP/OSPAnnotations",
    "alfmu": "urn:alfmu:system",
}
"""Namespaces by prefix; libcosim and ecos treat these prefixes as part of the names."""

DESCRIPTION = "SystemStructure.ssd"
OSP, OWN = "com.opensimulationplatform", "alfmu"


def tag(name: str) -> str:
    """Return the qualified name of an element for ElementTree."""
    prefix, _, local = name.partition(":")
    return f"{{{SPACES[prefix]}}}{local}"
