"""Links of README.md for a package index, which shows the page without the files beside it."""

from __future__ import annotations

import re

_LINK = re.compile(r"(!?)\[([^\]]*)\]\((?![a-z]+:|#)([^)\s]+)\)")
"""A picture or a link of Markdown to a file beside the page."""

_LINE = re.compile(r"^!\[[^\]]*\]\((?![a-z]+:)[^)\s]+\)\n\n?", re.MULTILINE)
"""A picture that stands alone."""


def relative(text: str) -> list[str]:
    """Where the links and pictures of a page in Markdown lead to beside it."""
    return [path for _, _, path in _LINK.findall(text)]


def for_an_index(text: str, source: str | None, version: str) -> str:
    """The page with absolute links into the repository at `source`, as GitHub and GitLab lay it out, at this version.

    Where no address is known, no link could lead anywhere: pictures are left out, and a link becomes its text with the
    path in the source archive.
    """
    if source:
        at = source.rstrip("/")

        def absolute(found: re.Match[str]) -> str:
            mark, label, path = found.groups()
            return f"{mark}[{label}]({at}/{'raw' if mark else 'blob'}/v{version}/{path})"

        return _LINK.sub(absolute, text)

    def named(found: re.Match[str]) -> str:
        _, label, path = found.groups()
        return f"`{path}`" if path.startswith(label.rstrip("/")) else f"{label}, `{path}`"

    plain = _LINK.sub(named, _LINE.sub("", text))
    return plain.rstrip() + "\n\nPaths on this page are those of files in the source archive.\n"
