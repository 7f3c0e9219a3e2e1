"""The two numbers of the decision that are fitted to checks with known truth; `calibrated.yaml` says how."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import yaml
from pydantic import BaseModel, ConfigDict, Field


class Calibrated(BaseModel):
    """What stands in calibrated.yaml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    law_error: float = Field(gt=0.0, le=1.0)
    sparsity: float = Field(ge=0.0, le=10.0)
    how: str


@cache
def calibrated() -> Calibrated:
    """The numbers in use."""
    text = files("simgap.inference").joinpath("calibrated.yaml").read_text(encoding="utf-8")
    return Calibrated.model_validate(yaml.safe_load(text))
