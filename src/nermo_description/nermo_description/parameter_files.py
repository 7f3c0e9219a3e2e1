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


def read_yaml(path: Path) -> Any:
    """Contents of a YAML file. Raises ParameterError if it cannot be read or is not YAML."""
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from error
    except yaml.YAMLError as error:
        raise ParameterError(f"{path}: is not valid YAML: {' '.join(str(error).split())}") from error


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
    return f"{field}: is {value!r}; {message[0].lower()}{message[1:]}{_range(info)}"


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
