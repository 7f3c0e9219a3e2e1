"""What is wrong with a file, in our words: pydantic's findings as sentences that say what would be right."""

from __future__ import annotations

import types
import typing
from typing import Any

from pydantic import BaseModel, ValidationError

from simgap.data.errors import nearest

_SHOULD_BE = {
    "string_type": "must be text (put it in quotes if it looks like a number)",
    "int_parsing": "must be a whole number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "tuple_type": "must be a list, each entry after a dash or in [ ]",
    "list_type": "must be a list, each entry after a dash or in [ ]",
    "dict_type": "must be keys and values, as in {key: value}",
    "model_type": "must be keys and values, as in {key: value}",
    "model_attributes_type": "must be keys and values, as in {key: value}",
}


def first_fault(error: ValidationError, model: type[BaseModel]) -> str:
    """The first thing that is wrong with data for ``model``: place, what it must be, and what it is."""
    fault = error.errors()[0]
    place = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in fault["loc"]).lstrip(".")
    kind, context, value = fault["type"], fault.get("ctx", {}), fault.get("input")
    shown = f", not {value!r}" if isinstance(value, str | int | float | bool) else ""
    match kind:
        case "missing":
            return f"{place}: is missing"
        case "extra_forbidden":
            holder = _model_at(model, fault["loc"][:-1])
            keys = [name for name, f in holder.model_fields.items() if not f.exclude]
            return f"{place}: there is no such key; {nearest(str(fault['loc'][-1]), keys, 'key')}"
        case "literal_error":
            return f"{place}: must be one of {context['expected'].replace(' or ', ', ')}{shown}"
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            (bound,) = context.values()
            words = {"greater_than": "more than", "less_than": "less than", "less_than_equal": "at most"}
            return f"{place}: must be {words.get(kind, 'at least')} {bound:g}{shown}"
        case "value_error":
            return f"{place or 'map'}: {fault['msg'].removeprefix('Value error, ')}{shown}"
        case _:
            return f"{place or 'map'}: {_SHOULD_BE.get(kind, fault['msg'].lower())}{shown}"


def _model_at(model: type[BaseModel], place: tuple[int | str, ...]) -> type[BaseModel]:
    """The model that validates what stands at a place."""
    current: Any = model
    for part in place:
        if isinstance(part, str) and (field := current.model_fields.get(part)) is not None:
            current = _inner(field.annotation) or current
    found: type[BaseModel] = current
    return found


def _inner(annotation: Any) -> type[BaseModel] | None:
    """The first model in an annotation such as ``tuple[Row, ...]``, ``dict[str, Row]`` or ``Row | None``."""
    if isinstance(annotation, type) and not isinstance(annotation, types.GenericAlias):
        return annotation if issubclass(annotation, BaseModel) else None
    return next((found for a in typing.get_args(annotation) if (found := _inner(a))), None)
