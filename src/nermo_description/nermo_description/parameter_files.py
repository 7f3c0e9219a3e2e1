"""Parameter files: YAML read into pydantic models, with faults told as file, field, value and what is allowed."""

from __future__ import annotations

import difflib
import os
import tempfile
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

Model = TypeVar("Model", bound=BaseModel)


class ParameterError(ValueError):
    """A parameter file that cannot be used; the text names file, field, value and what is allowed, a line a fault."""


LARGEST_FILE = 500_000
"""Bytes of a YAML text. Ours have a few thousand; PyYAML takes about 10 s for a million."""
LONGEST_VALUE = 200
"""Characters of a value that an error repeats."""
DEEPEST = 40
"""Collections within collections. Ours go six deep, and Python recurses a few times for each."""
MOST_VALUES = 200_000
"""Values of a YAML text, what an alias stands for counted each time: nine lines of aliases can mean a billion."""


def read_yaml(path: Path) -> Any:
    """Contents of a YAML file. Raises ParameterError if it cannot be read, is not YAML, or is beyond all measure."""
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST_FILE + 1).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from error
    return parse_yaml(text, path)


def parse_yaml(text: str, source: str | Path) -> Any:
    """Plain data of a YAML text; `source` is named in errors. Raises ParameterError, as `read_yaml`."""
    if len(text) > LARGEST_FILE:
        raise ParameterError(f"{source}: is too long: allowed are {LARGEST_FILE} bytes")
    try:
        return yaml.load(text, _BoundedLoader)
    except (yaml.YAMLError, ValueError) as error:  # a ValueError comes of dates and numbers that cannot be
        raise ParameterError(f"{source}: is not valid YAML: {' '.join(str(error).split())}") from error


class _BoundedLoader(yaml.SafeLoader):
    """Plain data only, of limited depth and size."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0
        self._sizes: dict[yaml.Node, int] = {}
        """Values of each node that is complete."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        mark, is_alias = self.peek_event().start_mark, self.check_event(yaml.AliasEvent)
        self._depth += 1
        if self._depth > DEEPEST:
            raise yaml.MarkedYAMLError(problem=f"nested more than {DEEPEST} deep", problem_mark=mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if is_alias and node not in self._sizes:
            raise yaml.MarkedYAMLError(problem="an alias stands for what it is part of", problem_mark=mark)
        if node is not None and not is_alias:
            self._sizes[node] = 1 + sum(self._sizes[child] for child in _children(node))
            if self._sizes[node] > MOST_VALUES:
                raise yaml.MarkedYAMLError(
                    problem=f"more than {MOST_VALUES} values, with all that aliases stand for", problem_mark=mark
                )
        return node


def _children(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return list(node.value) if isinstance(node, yaml.SequenceNode) else []


def write_yaml(data: Any, path: Path) -> None:
    """Writes plain data at once or not at all: a reader never sees half a file. Raises ParameterError."""
    temporary = ""
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", text=True)
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            yaml.safe_dump(data, file, sort_keys=False)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        if temporary:
            Path(temporary).unlink(missing_ok=True)
        raise ParameterError(f"{path}: cannot be written: {error}") from error


def merged(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """`base` with what `own` says otherwise, mapping by mapping."""
    result = dict(base)
    for field, value in own.items():
        inherited = result.get(field)
        result[field] = merged(inherited, value) if isinstance(inherited, dict) and isinstance(value, dict) else value
    return result


def validate(data: Any, source: str | Path, model: type[Model]) -> Model:
    """A model from plain data; `source` is named in errors. Raises ParameterError."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        lines = [_explain(fault, model) for fault in error.errors()]
        raise ParameterError("\n".join(f"{source}: {line}" for line in lines)) from error


def _explain(fault: Any, model: type[BaseModel]) -> str:
    """One pydantic fault as field, value and what is allowed."""
    location = [part for part in fault["loc"] if part != "[key]"]
    field = ".".join(str(part) for part in location) or "the file"
    if fault["type"] == "extra_forbidden":
        valid = list(_fields_at(location[:-1], model))
        close = difflib.get_close_matches(str(location[-1]), valid, n=1, cutoff=0.0)
        return f"{field}: no such field; did you mean {close[0]!r}?" if close else f"{field}: no such field"
    if fault["type"] == "missing":
        return f"{field}: is missing"
    message = str(fault["msg"]).removeprefix("Value error, ")
    value = fault["input"]
    if isinstance(value, (dict, BaseModel)) or (value is None and not location):
        return f"{field}: {message}"
    info = _fields_at(location[:-1], model).get(str(location[-1])) if location else None
    return f"{field}: is {_short(value)}; {message[0].lower()}{message[1:]}{_range(info)}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def _range(field: FieldInfo | None) -> str:
    """The range of a field that has two limits, in words with its unit; otherwise empty."""
    if field is None:
        return ""
    limits = {name: getattr(rule, name) for rule in field.metadata for name in ("ge", "le") if hasattr(rule, name)}
    if len(limits) < 2:
        return ""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    return f" (allowed: {limits['ge']} to {limits['le']} {extra.get('unit', '')}".rstrip() + ")"


def _fields_at(location: list[Any], model: type[BaseModel]) -> dict[str, FieldInfo]:
    """Fields of the model at a place in `model`."""
    place: Any = model
    for part in location:
        annotation = place.model_fields[part].annotation if _is_model(place) and part in place.model_fields else place
        place = _model_in(annotation)
    return dict(place.model_fields) if _is_model(place) else {}


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _model_in(annotation: Any) -> Any:
    """The model in an annotation such as `X`, `X | None` or `dict[str, X]`; the annotation itself if there is none."""
    if _is_model(annotation):
        return annotation
    for argument in getattr(annotation, "__args__", ()):
        found = _model_in(argument)
        if _is_model(found):
            return found
    return annotation
