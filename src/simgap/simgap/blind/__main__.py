"""``python -m simgap.blind``: the blind check where there is no ROS and no ``nermo`` command."""

import typer

from simgap.blind.cli import blind_app

typer.main.get_command(blind_app)()
