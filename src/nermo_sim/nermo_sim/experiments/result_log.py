"""Keeps what an experiment has finished, so that one that stops halfway goes on where it was."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any


def fingerprint(configuration: Any) -> str:
    """Digest of everything that a result depends on; `configuration` is plain data."""
    text = json.dumps(configuration, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def seed_for(seed: int, *key: Any) -> int:
    """A seed of its own for each part of an experiment, whatever the order in which the parts run."""
    return int(fingerprint([seed, *key])[:8], 16)


class ResultLog:
    """A JSONL file: one finished result a line, with the digest of its configuration.

    Results of another configuration stay in the file and are not used; a last line that was cut off is ignored.
    """

    def __init__(self, path: Path, digest: str) -> None:
        self._path, self._digest = path, digest
        self._results: dict[str, Any] = {}
        self._cut_off = False
        if path.exists():
            text = path.read_text(encoding="utf-8")
            self._cut_off = bool(text) and not text.endswith("\n")
            for line in text.splitlines():
                try:
                    entry = json.loads(line)
                    if entry["configuration"] == digest:
                        self._results[entry["key"]] = entry["result"]
                except (json.JSONDecodeError, KeyError, TypeError):
                    continue

    def __contains__(self, key: str) -> bool:
        return key in self._results

    def __getitem__(self, key: str) -> Any:
        return self._results[key]

    def add(self, key: str, result: Any) -> None:
        """Appends a result, which is plain data; it is on disk when this returns."""
        self._results[key] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(
                "\n" * self._cut_off + json.dumps({"configuration": self._digest, "key": key, "result": result}) + "\n"
            )
        self._cut_off = False
