"""The substitutions of launch files: `$(var x)`, `$(find-pkg-share x)`, `$(equals a b)` and their like."""

from __future__ import annotations

import os
import shlex
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix, get_package_share_directory

_TRUE = ("true", "1")
_FALSE = ("false", "0")


class SubstitutionError(ValueError):
    """A substitution is malformed or asks for something that does not exist."""


def truth(text: str) -> bool:
    """Whether a condition holds: true, 1, false or 0, in any case, as ROS's launch reads it."""
    lowered = text.strip().lower()
    if lowered in _TRUE:
        return True
    if lowered in _FALSE:
        return False
    raise SubstitutionError(f"{text!r} is neither true nor false")


class Substituter:
    """Replaces `$(...)` in a text; substitutions may stand within each other.

    Args:
        variables: What `$(var NAME)` gives.
        folder: What `$(dirname)` gives: the folder of the launch file.
    """

    def __init__(self, variables: Mapping[str, str], folder: Path) -> None:
        self._variables = variables
        self._folder = folder
        self._functions: dict[str, tuple[Callable[..., str], range]] = {
            "var": (self._var, range(1, 3)),
            "env": (self._env, range(1, 3)),
            "dirname": (lambda: str(self._folder), range(0, 1)),
            "find-pkg-share": (lambda name: _find(get_package_share_directory, name), range(1, 2)),
            "find-pkg-prefix": (lambda name: _find(get_package_prefix, name), range(1, 2)),
            "command": (_command, range(1, 2)),
            "equals": (lambda left, right: _text(left == right), range(2, 3)),
            "not-equals": (lambda left, right: _text(left != right), range(2, 3)),
            "not": (lambda value: _text(not truth(value)), range(1, 2)),
            "and": (lambda left, right: _text(truth(left) and truth(right)), range(2, 3)),
            "or": (lambda left, right: _text(truth(left) or truth(right)), range(2, 3)),
        }

    def __call__(self, text: str) -> str:
        """The text with everything replaced.

        Raises:
            SubstitutionError: A substitution is not known, malformed, or cannot be resolved.
        """
        done = ""
        position = 0
        while (start := text.find("$(", position)) >= 0:
            value, end = self._call(text, start + 2)
            done += text[position:start] + value
            position = end
        return done + text[position:]

    def _call(self, text: str, position: int) -> tuple[str, int]:
        """Reads words up to the closing bracket, substituting within them, and calls the function that they name."""
        words: list[str] = []
        word: str | None = None
        quote = ""
        while position < len(text):
            character = text[position]
            if text.startswith("$(", position):
                value, position = self._call(text, position + 2)
                word = (word or "") + value
                continue
            position += 1
            if quote:
                if character == quote:
                    quote = ""
                else:
                    word = (word or "") + character
            elif character in "'\"":
                quote = character
                word = word or ""
            elif character.isspace() or character == ")":
                if word is not None:
                    words.append(word)
                    word = None
                if character == ")":
                    return self._evaluate(words), position
            else:
                word = (word or "") + character
        raise SubstitutionError(f"{text!r} lacks a closing bracket or quote")

    def _evaluate(self, words: list[str]) -> str:
        if not words:
            raise SubstitutionError("$() names no substitution")
        name, *arguments = words
        if name not in self._functions:
            raise SubstitutionError(f"$({name} ...) is not known; known are {', '.join(self._functions)}")
        function, counts = self._functions[name]
        if len(arguments) not in counts:
            wanted = " or ".join(map(str, counts))
            raise SubstitutionError(f"$({name} ...) takes {wanted} arguments and has {len(arguments)}")
        return function(*arguments)

    def _var(self, name: str, *default: str) -> str:
        if name in self._variables:
            return self._variables[name]
        if default:
            return default[0]
        known = ", ".join(sorted(self._variables)) or "none"
        raise SubstitutionError(f"there is no variable {name!r}; there are: {known}")

    @staticmethod
    def _env(name: str, *default: str) -> str:
        if name in os.environ:
            return os.environ[name]
        if default:
            return default[0]
        raise SubstitutionError(f"the environment variable {name} is not set")


def _text(value: bool) -> str:
    return "true" if value else "false"


def _command(line: str) -> str:
    """What a command prints; one that fails, or says something on stderr, is an error."""
    try:
        done = subprocess.run(shlex.split(line), capture_output=True, text=True, check=False)
    except (OSError, ValueError) as error:
        raise SubstitutionError(f"the command {line!r} cannot be run: {error}") from error
    if done.returncode or done.stderr:
        raise SubstitutionError(" ".join(done.stderr.split()) or f"{line!r} ended with status {done.returncode}")
    return done.stdout


def _find(function: Callable[[str], str], package: str) -> str:
    try:
        return function(package)
    except (PackageNotFoundError, ValueError) as error:
        raise SubstitutionError(f"there is no package {package!r} in the sourced workspace") from error
