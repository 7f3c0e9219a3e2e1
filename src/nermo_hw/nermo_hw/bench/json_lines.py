"""A process that obeys words, one JSON line each way; what the parts of a measurement are made of."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from typing import IO, Any

PATIENCE_S = 60.0
"""Longer than any word takes."""


class WordError(RuntimeError):
    """A process refused a word, or has ended; the text says why."""


def serve(words: Mapping[str, Callable[..., Any]], end: Callable[[], None] = lambda: None) -> None:
    """Obeys lines such as {"do": "walk", "on": true} from stdin until it is closed, then calls `end`."""
    answers = sys.stdout
    sys.stdout = sys.stderr  # nothing else may come between the answers
    try:
        for line in sys.stdin:
            request = json.loads(line)
            word = request.pop("do")
            try:
                answer = {"ok": True, "result": words[word](**request)}
            except Exception as error:
                answer = {"ok": False, "error": f"{word}: {type(error).__name__}: {error}"}
            answers.write(json.dumps(answer) + "\n")
            answers.flush()
    finally:
        end()


class Words:
    """The other end, over the streams of a process. One word at a time."""

    def __init__(self, name: str, to: IO[str], back: IO[str]) -> None:
        self._name, self._to, self._back = name, to, back
        self._lock = threading.Lock()

    def do(self, word: str, **arguments: Any) -> Any:
        """Has one word obeyed and returns what it gave. Raises WordError."""
        with self._lock:
            try:
                self._to.write(json.dumps({"do": word, **arguments}) + "\n")
                self._to.flush()
                line = self._back.readline()
            except (OSError, ValueError) as error:
                raise WordError(f"{self._name} is gone: {error}") from error
        if not line:
            raise WordError(f"{self._name} has ended")
        answer = json.loads(line)
        if not answer["ok"]:
            raise WordError(f"{self._name}: {answer['error']}")
        return answer["result"]


class Child(Words):
    """A process that was started here and obeys words."""

    def __init__(self, name: str, command: list[str]) -> None:
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdin is not None and self.process.stdout is not None
        super().__init__(name, self.process.stdin, self.process.stdout)

    def close(self) -> None:
        """Lets it end by closing its stdin; kills it if it does not."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.close()
            self.process.wait(10.0)
        except (OSError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
