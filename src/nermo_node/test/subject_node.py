"""A node to be tested, run as a process."""

from __future__ import annotations

import os
import signal
import sys
import time
from typing import Literal, Self

import rclpy
from pydantic import BaseModel, ConfigDict, Field, model_validator
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from nermo_node import run
from nermo_node.diagnostics import OK, Diagnostics, Status
from nermo_node.parameters import declare


class Shape(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    size: int = Field(3, ge=0)


class Parameters(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    gain: float = Field(1.0, ge=0.0, le=2.0, description="A gain", json_schema_extra={"unit": "m"})
    fails: Literal["", "constructor", "value", "callback", "signal", "interrupt", "hang", "end"] = ""
    shape: Shape = Shape()

    @model_validator(mode="after")
    def _lucky(self) -> Self:
        if self.gain == 1.5:
            raise ValueError("gain = 1.5 is unlucky")
        return self


class Interrupted:
    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        sum(range(1000))


class Subject(Node):
    def __init__(self) -> None:
        super().__init__("subject")
        self.values = declare(self, Parameters, self.changed)
        self.diagnostics = Diagnostics(self, "bench", {"gain": self.status})
        if self.values.fails == "constructor":
            raise RuntimeError("the constructor failed")
        if self.values.fails == "value":
            raise ValueError("the value does not do")
        self.create_timer(0.01, self.tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def changed(self, values: Parameters) -> None:
        self.values = values

    def status(self) -> Status:
        return OK, f"gain {self.values.gain}", {"gain_m": self.values.gain}

    def tick(self) -> None:
        if self.values.fails == "callback":
            raise OSError("the callback failed")
        if self.values.fails == "signal":
            os.kill(os.getpid(), signal.SIGTERM)
            raise TypeError("what was interrupted")
        if self.values.fails == "interrupt":
            Interrupted()
        if self.values.fails == "hang":
            print("hangs", flush=True)
            while rclpy.ok():
                time.sleep(0.1)
            print("still hangs", flush=True)
            while True:
                time.sleep(0.1)
        if self.values.fails == "end":
            raise SystemExit

    def destroy_node(self) -> None:
        super().destroy_node()
        if self.values.fails == "end":
            raise RuntimeError("the end failed")
        sys.stdout.write("destroyed\n")


if __name__ == "__main__":
    sys.exit(run(Subject))
