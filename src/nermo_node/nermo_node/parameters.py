"""ROS parameters from a pydantic model: declared with unit and range, checked by the model, handed over frozen.

A field is a parameter of the same name; fields of a nested model follow after a dot, and so do the entries of a
dictionary. Values are numbers, booleans, strings (also enumerations, literals and paths) and lists of these that are
not empty. `json_schema_extra={"unit": "m"}` names the unit, `{"readOnly": True}` a parameter that is fixed at start.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

Model = TypeVar("Model", bound=BaseModel)

_INTEGER_LIMITS = (-(2**63), 2**63 - 1)
_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


class ParameterError(ValueError):
    """A parameter is unusable; the message names parameter, value and what is allowed."""


@contextmanager
def blame(parameter: str) -> Iterator[None]:
    """Turns a ValueError into a ParameterError that names the parameter, where only its use shows that it is bad."""
    try:
        yield
    except ValueError as error:
        raise ParameterError(f"parameter {parameter}: {error}") from error


def declare(node: Node, model: type[Model], on_change: Callable[[Model], None] | None = None) -> Model:
    """Declares the fields of `model` as parameters of `node` and returns them as given at the start.

    With `on_change` the parameters may be changed while the node runs, except those marked `readOnly`; it gets the
    new model after each change. Raises ParameterError for a bad value and for a name that the node does not have.
    """
    return NodeParameters(node, model, on_change).values


class NodeParameters(Generic[Model]):
    """The parameters of one node, as `declare` makes them, for a node that also changes them itself."""

    def __init__(self, node: Node, model: type[Model], on_change: Callable[[Model], None] | None = None) -> None:
        self._node, self._model, self._on_change = node, model, on_change
        given = {name: parameter.value for name, parameter in node._parameter_overrides.items()}
        known = flatten(model())
        known.update({name: value for name, value in given.items() if _field(model, name) is not None})
        self._refuse_unknown(given, known)
        self.values = _validated(model, known)
        """The present values."""
        self._changing = False
        self._declare(flatten(self.values))
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def change(self, values: Model) -> None:
        """Makes `values` the present ones, through the ROS parameters. Raises ParameterError where one is fixed."""
        before, after = flatten(self.values), flatten(values)
        changed = [
            Parameter(name, value=value) for name, value in after.items() if name in before and before[name] != value
        ]
        self._changing = True
        try:
            result = self._node.set_parameters_atomically(changed)
            if not result.successful:
                raise ParameterError(result.reason)
            for name in before.keys() - after.keys():
                self._node.undeclare_parameter(name)
            self._declare({name: value for name, value in after.items() if name not in before})
        finally:
            self._changing = False
        self._take(values)

    def _refuse_unknown(self, given: Iterable[str], known: Mapping[str, Any]) -> None:
        for name in given:
            if name not in known and not self._node.has_parameter(name) and not name.startswith(_OF_ROS):
                near = difflib.get_close_matches(name, known, n=1)
                hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
                raise ParameterError(f"unknown parameter {name}: {hint}")

    def _declare(self, flat: Mapping[str, Any]) -> None:
        for name, value in flat.items():
            descriptor = self._descriptor(name, value)
            self._node.declare_parameter(name, value, descriptor, ignore_override=True)

    def _descriptor(self, name: str, value: object) -> ParameterDescriptor:
        field = _field(self._model, name)
        assert field is not None, f"{name} is a field"
        lower, upper, unit = _range(field)
        descriptor = ParameterDescriptor(
            name=name,
            description=f"{field.description or ''}{f' [{unit}]' if unit else ''}",
            read_only=self._on_change is None or bool(_extra(field).get("readOnly")),
        )
        if lower is None and upper is None:
            return descriptor
        if isinstance(value, float):
            limits = -math.inf if lower is None else float(lower), math.inf if upper is None else float(upper)
            descriptor.floating_point_range = [FloatingPointRange(from_value=limits[0], to_value=limits[1])]
        elif isinstance(value, int):
            first, last = _INTEGER_LIMITS
            whole = first if lower is None else int(lower), last if upper is None else int(upper)
            descriptor.integer_range = [IntegerRange(from_value=whole[0], to_value=whole[1], step=1)]
        return descriptor

    def _merged(self, parameters: Iterable[Parameter]) -> Model:
        flat = flatten(self.values)
        flat.update({parameter.name: parameter.value for parameter in parameters if parameter.name in flat})
        return _validated(self._model, flat)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        if not self._changing:
            try:
                self._merged(parameters)
            except ParameterError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        if not self._changing:
            self._take(self._merged(parameters))

    def _take(self, values: Model) -> None:
        if values != self.values:
            self.values = values
            if self._on_change is not None:
                self._on_change(values)


def flatten(values: BaseModel | Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Parameter names and ROS values of a model."""
    flat: dict[str, Any] = {}
    for name, value in values.items() if isinstance(values, Mapping) else values:
        if isinstance(value, (BaseModel, Mapping)):
            flat.update(flatten(value, f"{prefix}{name}."))
        else:
            flat[f"{prefix}{name}"] = _ros_value(value)
    return flat


def _ros_value(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Path):
        return str(value)
    return [_ros_value(item) for item in value] if isinstance(value, (tuple, list)) else value


def _validated(model: type[Model], flat: Mapping[str, Any]) -> Model:
    nested: dict[str, Any] = {}
    for name, value in flat.items():
        *path, last = name.split(".")
        place = nested
        for part in path:
            place = place.setdefault(part, {})
        place[last] = value if isinstance(value, (bool, int, float, str)) else list(value)
    try:
        # JSON has the types of ROS parameters, without any that pydantic would make of others.
        return model.model_validate_json(json.dumps(nested), strict=True)
    except ValidationError as error:
        raise ParameterError("; ".join(_explain(model, mistake) for mistake in error.errors())) from error


def _explain(model: type[BaseModel], mistake: Any) -> str:
    name = ".".join(str(part) for part in mistake["loc"])
    if not name:
        return str(mistake["msg"]).removeprefix("Value error, ")
    if mistake["type"] == "missing":
        return f"parameter {name} is missing"
    field = _field(model, ".".join(part for part in mistake["loc"] if isinstance(part, str)))
    lower, upper, unit = _range(field) if field is not None else (None, None, "")
    allowed = ""
    if lower is not None or upper is not None:
        low, high = "-inf" if lower is None else lower, "inf" if upper is None else upper
        allowed = f" (allowed {low} to {high}{f' {unit}' if unit else ''})"
    return f"parameter {name} = {mistake['input']!r}: {mistake['msg'].removeprefix('Value error, ').lower()}{allowed}"


def _field(model: type[BaseModel], name: str) -> FieldInfo | None:
    """The field behind a parameter's name; None where there is none."""
    first, _, rest = name.partition(".")
    field = model.model_fields.get(first)
    if field is None or not rest:
        return field
    annotation = field.annotation
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return _field(annotation, rest)
    entry = getattr(annotation, "__args__", ())[1:]
    _, _, after_key = rest.partition(".")
    if getattr(annotation, "__origin__", None) is dict and entry and issubclass(entry[0], BaseModel) and after_key:
        return _field(entry[0], after_key)
    return None


def _range(field: FieldInfo) -> tuple[float | None, float | None, str]:
    """Lowest and highest value, None where there is none, and the unit."""
    limits = {
        key: getattr(rule, key) for rule in field.metadata for key in ("ge", "gt", "le", "lt") if hasattr(rule, key)
    }
    unit = str(_extra(field).get("unit", ""))
    return limits.get("ge", limits.get("gt")), limits.get("le", limits.get("lt")), "" if unit == "1" else unit


def _extra(field: FieldInfo) -> Mapping[str, Any]:
    return field.json_schema_extra if isinstance(field.json_schema_extra, Mapping) else {}
