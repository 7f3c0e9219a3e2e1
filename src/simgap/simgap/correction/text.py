"""Start tags of an XML text, found and changed in place, so that comments, layout and order stay as they are."""

from __future__ import annotations

import re
import xml.parsers.expat
from collections.abc import Sequence
from dataclasses import dataclass, field

_TAG = re.compile(rb"""<([\w:.-]+)((?:\s+[\w:.-]+\s*=\s*(?:"[^"]*"|'[^']*'))*)\s*(/?)>""")
_ATTRIBUTE = r"""\s+{name}\s*=\s*(?:"[^"]*"|'[^']*')"""


@dataclass
class Element:
    """A start tag in the text: where it begins [byte], its ancestors' names, and its first child of each name."""

    start: int
    tag: str
    path: tuple[str, ...]
    attributes: dict[str, str]
    children: dict[str, Element] = field(default_factory=dict)


@dataclass
class Edit:
    """New attributes of a start tag (None: none of that name), its new name, and what to put behind it."""

    attributes: dict[str, str | None] = field(default_factory=dict)
    tag: str = ""
    behind: str = ""


def elements_of(text: bytes) -> list[Element]:
    """All elements in the order of the text. Raises xml.parsers.expat.ExpatError where it is no XML."""
    parser = xml.parsers.expat.ParserCreate()
    found: list[Element] = []
    open_: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(parser.CurrentByteIndex, tag, tuple(e.tag for e in open_), attributes)
        if open_:
            open_[-1].children.setdefault(tag, element)
        found.append(element)
        open_.append(element)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: open_.pop()
    parser.Parse(text, True)
    return found


def rewritten(text: bytes, start: int, edit: Edit) -> bytes | None:
    """The text with one start tag changed, or None where that cannot be done."""
    match = _TAG.match(text, start)
    if match is None or (edit.behind and match[3]):
        return None
    body = match[2].decode()
    for name, value in edit.attributes.items():
        pattern = re.compile(_ATTRIBUTE.format(name=re.escape(name)))
        if value is None:
            body = pattern.sub("", body)
        elif pattern.search(body):
            body = pattern.sub(f' {name}="{value}"', body)
        else:
            body += f' {name}="{value}"'
    tag = edit.tag or match[1].decode()
    new = f"<{tag}{body}{match[3].decode()}>{edit.behind}".encode()
    old_tag = match[1].decode()
    rest = text[match.end() :]
    if edit.tag and edit.tag != old_tag and not match[3]:
        # An element with children ends with its own name.
        end = rest.find(f"</{old_tag}".encode())
        rest = rest[:end] + f"</{edit.tag}".encode() + rest[end + len(old_tag) + 2 :]
    return text[:start] + new + rest


def number_text(values: Sequence[float]) -> str:
    """Numbers of an attribute."""
    return " ".join(f"{v:.10g}" for v in values)
