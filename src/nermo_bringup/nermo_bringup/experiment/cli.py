"""`nermo experiment`: the commands of nermo_sim, whose experiments can be done on the real mouse here."""

from __future__ import annotations

from nermo_bringup.network import use_network
from nermo_sim.experiments import cli
from nermo_sim.experiments.on_robot import RobotRequest

experiment_app = cli.experiment_app


def _on_the_robot(request: RobotRequest) -> None:
    from nermo_bringup.experiment.command import do

    use_network(None)
    do(request)


cli.hand_in(_on_the_robot)
