"""Gait parameters that were changed live, kept for a knowledge-base that is started again in the same session."""

from __future__ import annotations

import os
from pathlib import Path

import psutil
from pydantic import BaseModel, ConfigDict

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.parameter_files import read_yaml, validate, write_yaml


class _Kept(BaseModel):
    model_config = ConfigDict(extra="forbid")

    session: str
    gait_parameters: GaitParameters


class KeptChanges:
    """A file with the newest values. They count in one session only: as long as the process that starts the node runs.

    So a node that is respawned goes on with what was set, and the next launch begins as its arguments say.
    """

    def __init__(self, path: Path, session: str | None = None) -> None:
        self._path, self._session = path, session or launched_by()

    def keep(self, parameters: GaitParameters) -> None:
        """Writes them at once or not at all. Raises ParameterError."""
        write_yaml({"session": self._session, "gait_parameters": parameters.model_dump(mode="json")}, self._path)

    def kept(self) -> GaitParameters | None:
        """What was kept in this session; None where nothing was. Raises ParameterError where the file is unusable."""
        if not self._path.exists():
            return None
        kept = validate(read_yaml(self._path), self._path, _Kept)
        return kept.gait_parameters if kept.session == self._session else None


def launched_by() -> str:
    """Name of the process that started this one, which no other one has."""
    parent = psutil.Process(os.getppid())
    return f"{parent.pid} {parent.create_time():.3f}"
