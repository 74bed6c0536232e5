"""Reading and writing the XML of model files."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from drake_hand.errors import InputError
from drake_hand.files import read_text

_DRAKE = "http://drake.mit.edu"
ET.register_namespace("drake", _DRAKE)


def drake_tag(name: str) -> str:
    """ElementTree's spelling of ``drake:name``."""
    return f"{{{_DRAKE}}}{name}"


def read_xml(file: Path, tag: str) -> ET.Element:
    """The root element of an XML file.

    Args:
        file: the file; Drake reads ``drake:`` tags without their namespace being declared, so this does too.
        tag: what the root element has to be.

    Raises:
        InputError: unreadable, not XML, or another root.
    """
    text = read_text(file)
    if "drake:" in text and "xmlns:drake" not in text:
        text = text.replace(f"<{tag}", f'<{tag} xmlns:drake="{_DRAKE}"', 1)
    try:
        root = ET.fromstring(text)
    except ET.ParseError as e:
        raise InputError("not well-formed XML", file=file, found=str(e), expected=f"a <{tag}> document") from e
    if root.tag != tag:
        raise InputError("wrong kind of XML file", file=file, found=f"<{root.tag}>", expected=f"<{tag}>")
    return root


def write_xml(root: ET.Element) -> str:
    """The XML text of an element, indented."""
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
