"""The whole controller in process."""

from __future__ import annotations

from nermo_control.controller import Controller
from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, MotionOutput, Odometry, Phase, Posture, SpineModes, TrajectoryMode
from nermo_description.parameters import RobotParameters

PERIOD = 5_000_000


def run(controller: Controller, command: ControlCommand, ticks: range, servos: list[float]) -> list[MotionOutput]:
    outputs = []
    for tick in ticks:
        stamp = tick * PERIOD
        output = controller.step(stamp, command, Odometry(stamp, 0.0, 0.0, 0.0), servos)
        servos[:] = output.servo_positions
        outputs.append(output)
    return outputs


def test_stand_walk_and_stop(robot: RobotParameters, gait_parameters: GaitParameters) -> None:
    controller = Controller(robot, gait_parameters, PERIOD)
    servos = [0.1] * len(robot.servos)
    standing = run(controller, ControlCommand(0, posture=Posture.STAND), range(0, 400), servos)
    assert standing[0].servo_positions == (0.1,) * len(robot.servos)
    assert standing[-1].servo_positions == standing[-2].servo_positions

    walking = run(controller, ControlCommand(0, forward_velocity=0.08), range(400, 1400), servos)
    assert {phase for output in walking for phase in output.leg_states.phases} == {Phase.STANCE, Phase.SWING}
    assert not [warning for output in walking for warning in output.warnings]

    still = run(controller, ControlCommand(0), range(1400, 1440), servos)
    settled = round(gait_parameters.settle_duration / 5e-3)
    assert all(output.servo_positions == still[-1].servo_positions for output in still[settled + 1 :])
    assert set(still[-1].leg_states.phases) == {Phase.STANCE}


def test_the_same_parameters_again_change_nothing(robot: RobotParameters) -> None:
    """The knowledge-base repeats itself at 10 Hz."""
    command = ControlCommand(0, 0.08, 0.1, turning_strategy="mix", spine_modes=SpineModes(stride_extension=True))
    once, again = (Controller(robot, GaitParameters(), PERIOD) for _ in range(2))
    for tick in range(1000):
        outputs = []
        for controller in (once, again):
            outputs.append(controller.step(tick * PERIOD, command, None, [0.0] * len(robot.servos)))
        again.set_parameters(GaitParameters())
        assert outputs[0] == outputs[1]


def test_the_same_commands_give_the_same_servo_positions(robot: RobotParameters) -> None:
    """Through a minute with changes of gait, speed and turn; nothing depends on anything but the input."""
    script = [
        ControlCommand(0, 0.06, 0.0, gait="lateral_walk"),
        ControlCommand(0, 0.09, 0.2, gait="trot"),
        ControlCommand(0, -0.05, -0.1, gait="walking_trot", gait_frequency=0.67),
        ControlCommand(0),
        ControlCommand(0, 0.08, trajectory_mode=TrajectoryMode.STRAIGHT_LINE),
    ]
    first, second = ([0.0] * len(robot.servos) for _ in range(2))
    one, two = (Controller(robot, GaitParameters(), PERIOD) for _ in range(2))
    for tick in range(0, 12_000, 600):
        command = script[(tick // 600) % len(script)]
        a = run(one, command, range(tick, tick + 600), first)
        b = run(two, command, range(tick, tick + 600), second)
        assert a == b
