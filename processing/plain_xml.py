"""XML of strangers, without document types: those declare entities, which unpack to any length or text."""

from xml.etree import ElementTree


class _WithoutDoctype(ElementTree.TreeBuilder):
    """Refuses them in any encoding and wherever they stand."""

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError(f"it declares a document type ({name}), which it must not; remove the DOCTYPE")


def parsed_xml(data: bytes) -> ElementTree.Element:
    """The root. Raises ParseError, LookupError (an unknown encoding) or ValueError in one line."""
    return ElementTree.fromstring(data, ElementTree.XMLParser(target=_WithoutDoctype()))
