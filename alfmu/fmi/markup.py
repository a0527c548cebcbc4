"""Parse XML files of FMUs and systems from untrusted sources, and write such files."""

from xml.etree import ElementTree as ET

from ..model.errors import InputError


def written(root: ET.Element) -> bytes:
    """Return a file with this root, indented, as UTF-8."""
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


class _Plain(ET.TreeBuilder):
    """Builds a tree; rejects document types, and with them entities."""

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        raise InputError("it declares a document type")


def tree(data: bytes, name: str) -> ET.Element:
    """Return the root of a file; raise InputError, with the `name` of the file, for invalid XML or a document type."""
    parser = ET.XMLParser(target=_Plain())
    try:
        parser.feed(data)
        return parser.close()
    except (ET.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{name} is no XML that can be read ({error})") from None
    except InputError as error:
        raise InputError(f"{name} is not read: {error}") from None
