"""The effect library of a model: every effect at every site where it can act, and effects from a user's file."""

from __future__ import annotations

import importlib.util
import inspect
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from simgap.data.errors import GapInputError, nearest
from simgap.effects import body, contact, friction, joint, link, mount, sensor, servo, tendon
from simgap.effects.base import Context, Effect

_MODULES = (servo, link, friction, tendon, joint, mount, body, contact, sensor)


def _classes(module: ModuleType) -> list[type[Effect]]:
    found = [c for _, c in inspect.getmembers(module, inspect.isclass) if c.__module__ == module.__name__]
    return [c for c in found if issubclass(c, Effect) and not inspect.isabstract(c)]


def effect_classes() -> dict[str, type[Effect]]:
    """All effects by name."""
    return {c.name: c for module in _MODULES for c in _classes(module)}


def load_effects(path: str | Path) -> list[type[Effect]]:
    """The effects defined in a Python file of the user's (subclasses of simgap.effects.base.Effect).

    Raises:
        GapInputError: the file cannot be run or defines no effect.
    """
    path = Path(path)
    spec = importlib.util.spec_from_file_location(f"user_effects_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise GapInputError(f"{path}: no such Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # a user's file may raise anything; the message says which file and what
        raise GapInputError(f"{path}: cannot be run ({type(error).__name__}: {error})") from error
    classes = _classes(module)
    if not classes:
        raise GapInputError(f"{path}: defines no effect (a subclass of Effect with a name, candidates and apply)")
    return classes


def chosen_effects(extra: Sequence[type[Effect]] = (), only: Sequence[str] = ()) -> dict[str, type[Effect]]:
    """The library's effects and a user's by name; those in ``only``, where given.

    A user's effect replaces one of the same name.

    Raises:
        GapInputError: ``only`` holds a name that no effect has.
    """
    classes = effect_classes() | {c.name: c for c in extra}
    for name in only:
        if name not in classes:
            raise GapInputError(f"no effect {name!r}; {nearest(name, classes, 'effect')}")
    return {n: c for n, c in classes.items() if n in only} if only else classes


def enumerate_effects(context: Context, extra: Sequence[type[Effect]] = (), only: Sequence[str] = ()) -> list[Effect]:
    """Every candidate of the `chosen_effects`, in a fixed order.

    Raises:
        GapInputError: ``only`` holds a name that no effect has.
    """
    classes = chosen_effects(extra, only)
    return [effect for name in sorted(classes) for effect in classes[name].candidates(context)]
