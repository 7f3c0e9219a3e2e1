"""``python -m nermo_gap.blind``: the blind check where there is no ROS and no ``nermo`` command."""

import typer

from nermo_gap.blind.cli import blind_app

typer.main.get_command(blind_app)()
