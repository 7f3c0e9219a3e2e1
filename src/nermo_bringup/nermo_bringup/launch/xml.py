"""XML elements that know the line they stand on."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from nermo_description.results import CommandError


class LaunchError(CommandError):
    """A launch file, or what was asked of it, is wrong; the text names file and line."""


@dataclass
class Element:
    """One XML element.

    Attributes:
        tag: Its name.
        attributes: Its attributes, not yet substituted.
        file: The file that it stands in.
        line: Its line there, counted from 1.
        children: The elements within, in order.
    """

    tag: str
    attributes: dict[str, str]
    file: Path
    line: int
    children: list[Element] = field(default_factory=list)

    def error(self, text: str) -> LaunchError:
        """An error at this element."""
        return LaunchError(f"{self.file}:{self.line}: {text}")


def read(file: Path) -> Element:
    """Reads an XML file.

    Returns:
        Its root element.

    Raises:
        LaunchError: The file cannot be read, is not XML, or has text between its elements.
    """
    parser = expat.ParserCreate()
    stack: list[Element] = []
    roots: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, file, parser.CurrentLineNumber)
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    def text(data: str) -> None:
        if data.strip():
            raise stack[-1].error(f"text {data.strip()[:40]!r} has no meaning within <{stack[-1].tag}>")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    try:
        parser.Parse(file.read_bytes(), True)
    except OSError as error:
        raise LaunchError(f"{file}: {error.strerror}") from error
    except expat.ExpatError as error:
        raise LaunchError(f"{file}:{error.lineno}: not XML: {expat.ErrorString(error.code)}") from error
    return roots[0]
