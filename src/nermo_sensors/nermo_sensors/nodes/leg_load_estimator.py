"""Node `leg_load_estimator`: tactile readings and IMU [d], leg_states -> leg_loads, once for every tactile message."""

from __future__ import annotations

import math
import sys
from array import array
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field
from rclpy.node import Node
from sensor_msgs.msg import Imu

from nermo_description.feet import readings_by_cell
from nermo_description.parameters import LEGS
from nermo_description.robots import load_any_robot
from nermo_description.silence import WALK
from nermo_interfaces.msg import LegLoads, LegStates, Tactile
from nermo_node import qos, run
from nermo_node.complaints import Complaints
from nermo_node.diagnostics import OK, WARN, Diagnostics, Status
from nermo_node.inputs import Inputs
from nermo_node.parameters import blame, declare
from nermo_node.time import to_message, to_nanoseconds
from nermo_sensors.estimation.estimator import LegLoadEstimator
from nermo_sensors.estimation.weight import felt_weight
from nermo_sensors.parameters import TactileParameters, load_tactile, tactile_of_robot

WEIGHT_STALE_NS = 10_000_000
"""An older acceleration is not used: it changes within a step."""
IDLE_PERIOD_NS = 50_000_000
"""While nobody listens to the loads, samples closer than this are passed over. The estimates stay as good, and the
cells are still watched; from 100 ms on F2 takes its cells for broken."""
UNKNOWN_MEASUREMENT = -1.0
"""First element of the covariance of what is not measured (REP-145)."""


class Scales(BaseModel):
    """Factors on the covariances of the robot's parameter file, for tuning while the robot walks."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    process: float = Field(1.0, ge=1e-6, le=1e6, description="How fast load and memories may change")
    piezoresistive: float = Field(1.0, ge=1e-6, le=1e6, description="Variance of the static cell")
    piezoelectric: float = Field(1.0, ge=1e-6, le=1e6, description="Variance of the dynamic cell")


class LegLoadEstimatorParameters(BaseModel):
    """Parameters of the node."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field(
        "nermo_lite",
        description="Name of a robot, or path of its parameter file",
        json_schema_extra={"readOnly": True},
    )
    feet: str = Field(
        "",
        description="Whose tactile feet: a name, or path of their parameter file; empty: the robot's own",
        json_schema_extra={"readOnly": True},
    )
    estimator: Literal["f1", "f2", "memory"] = Field(
        "memory", description="F1 or F2 of C, or the filter with memory", json_schema_extra={"readOnly": True}
    )
    contact_force: float = Field(
        0.0, ge=0.0, le=100.0, description="Load of a foot in contact; 0: of the file", json_schema_extra={"unit": "N"}
    )
    weigh: bool = Field(
        True, description="Ties the four loads to the body's weight and the IMU's vertical acceleration"
    )
    contact_certainty: float = Field(0.9, ge=0.51, le=0.999, description="Of touch-down and lift-off")
    scale: Scales = Scales()


class LegLoadEstimatorNode(Node):
    """Answers every tactile message with the loads for its stamp, as long as somebody listens."""

    def __init__(self) -> None:
        super().__init__("leg_load_estimator")
        parameters = declare(self, LegLoadEstimatorParameters, self._on_parameters)
        with blame("feet"):
            self._feet = load_tactile(parameters.feet) if parameters.feet else tactile_of_robot(parameters.robot)
        with blame("robot"):
            robot = load_any_robot(parameters.robot)
        self._mass = robot.total_mass
        self._estimator = LegLoadEstimator(self._feet, parameters.estimator)
        self._weigh = parameters.weigh
        self._weight: tuple[int, float] | None = None
        """Stamp [ns] and what all feet bear [N]."""
        self._on_parameters(parameters)
        self._legs: LegStates | None = None
        self._answers = self._told_answers = self._passed_over = 0
        self._listened = True
        self._looked_at: int | None = None
        """Stamp of the last sample that was not passed over."""
        self._refused = Complaints(self, "refused")
        self._message = LegLoads()
        self._message.header.frame_id = "base_link"
        self._publisher = self.create_publisher(LegLoads, "leg_loads", qos.SENSOR)
        inputs = Inputs(self, self._refused.add_one)
        inputs.subscribe(LegStates, "leg_states", self._on_leg_states, qos.BEST_EFFORT)
        inputs.subscribe(Imu, "imu/data_raw", self._on_imu, qos.BEST_EFFORT)
        inputs.subscribe(Tactile, "tactile", self._on_tactile, qos.BEST_EFFORT)
        Diagnostics(
            self,
            self._feet.name,
            {
                "loads": self._state,
                **{f"{leg} tactile": lambda leg=leg: self._foot(LEGS.index(leg)) for leg in LEGS},  # type: ignore[misc]
                "messages": self._refused.status,
            },
        )

    def _on_parameters(self, parameters: LegLoadEstimatorParameters) -> None:
        self._estimator.set_contact(parameters.contact_force or self._feet.contact_force, parameters.contact_certainty)
        self._weigh = parameters.weigh
        self._estimator.set_noises(_scaled(self._feet, parameters.scale).noises)

    def _on_imu(self, message: Imu) -> None:
        if not self._weigh or message.orientation_covariance[0] == UNKNOWN_MEASUREMENT:
            return
        q, a = message.orientation, message.linear_acceleration
        weight = felt_weight(self._mass, (q.w, q.x, q.y, q.z), (a.x, a.y, a.z))
        self._weight = (to_nanoseconds(message.header.stamp), weight) if math.isfinite(weight) else None

    def _on_leg_states(self, message: LegStates) -> None:
        self._legs = message

    def _on_tactile(self, message: Tactile) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        if not self._listened and self._looked_at is not None and 0 <= stamp - self._looked_at < IDLE_PERIOD_NS:
            self._passed_over += 1
            return
        self._listened, self._looked_at = self._publisher.get_subscription_count() > 0, stamp
        frequency, swing = self._gait(stamp)
        restarts = self._estimator.restarts
        weight = None
        if self._weigh and self._weight is not None and abs(stamp - self._weight[0]) <= WEIGHT_STALE_NS:
            weight = self._weight[1]
        readings = readings_by_cell(message.name, message.voltage)
        loads = self._estimator.step(stamp, readings, frequency, swing, weight)
        if unknown := set(readings).difference(self._estimator.cells):
            self._refused.add([f"tactile: the feet {self._feet.name} have no cell {', '.join(sorted(unknown))}"])
        if self._estimator.restarts > restarts:
            self._refused.add(["time ran backwards, or a filter diverged: the estimates begin anew"])
        if loads is None or loads.stamp != stamp:
            return
        answer = self._message
        answer.header.stamp = message.header.stamp
        answer.load = array("d", loads.load)
        answer.variance = array("d", loads.variance)
        answer.contact_probability = array("d", loads.contact_probability)
        answer.contact = loads.contact.tolist()
        answer.contact_since = [to_message(since) for since in loads.since.tolist()]
        self._publisher.publish(answer)
        self._answers += 1

    def _gait(self, stamp: int) -> tuple[float | None, list[bool] | None]:
        """Frequency of the gait [rad/s] and which legs swing, as far as that is known."""
        legs = self._legs
        if legs is None or abs(stamp - to_nanoseconds(legs.header.stamp)) > WALK.after * 1e9:
            return None, None
        frequency = 2.0 * math.pi * legs.gait_frequency
        swing = [phase == LegStates.SWING for phase in legs.phases]
        return frequency if math.isfinite(frequency) and frequency > 0.0 else None, swing

    def _state(self) -> Status:
        answers, self._told_answers = self._answers - self._told_answers, self._answers
        values = {
            "answers_in_last_second": answers,
            "late_samples": self._estimator.ignored,
            "restarts": self._estimator.restarts,
            "passed_over": self._passed_over,
        }
        if answers == 0:
            return WARN, "no tactile readings", values
        return OK, "running" if self._listened else "nobody listens: a sample every 50 ms is enough", values

    def _foot(self, foot: int) -> Status:
        cells, surprise = self._estimator.cells, self._estimator.health.surprise[:, foot]
        values = {f"{cell}_surprise": round(float(s), 2) for cell, s in zip(cells, surprise, strict=True)}
        broken = {cells[cell]: fault for number, cell, fault in self._estimator.broken() if number == foot}
        if not broken:
            return OK, "the cells agree", values
        texts = [f"the {cell} cell {fault.value}" for cell, fault in broken.items()]
        left = [cell for cell in cells if cell not in broken]
        rest = f"the estimate goes on with {' and '.join(left)}" if left else "no cell is left"
        return WARN, f"{LEGS[foot]}: {', '.join(texts)}; {rest}", values


def _scaled(feet: TactileParameters, scale: Scales) -> TactileParameters:
    """The same feet with covariances times their factors."""
    noises = feet.noises
    scaled = {}
    for name in type(noises).model_fields:
        noise = getattr(noises, name)
        factors = {
            field: getattr(noise, field) * (1.0 if field.endswith("_time") else getattr(scale, field, scale.process))
            for field in type(noise).model_fields
        }
        scaled[name] = type(noise).model_validate(factors)
    return feet.model_copy(update={"noises": noises.model_copy(update=scaled)})


def main() -> int:
    """Runs the node."""
    return run(LegLoadEstimatorNode)


if __name__ == "__main__":
    sys.exit(main())
