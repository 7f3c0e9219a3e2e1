"""Writes the URDF of a robot, made from its MuJoCo model."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from nermo_description.model import build_robot
from nermo_description.robots import ParameterError, load_robot
from nermo_description.urdf import to_urdf


def main(arguments: list[str] | None = None) -> int:
    """Exit status 0 if written, 1 if the robot or the file cannot be used."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        epilog="examples: export_urdf nermo_lite --out nermo_lite.urdf    export_urdf my_mouse.yaml",
    )
    parser.add_argument("robot", help="name of a robot, or a YAML file with its parameters")
    parser.add_argument("--out", type=Path, help="file to write to (default: standard output)")
    options = parser.parse_args(arguments)
    try:
        text = to_urdf(build_robot(load_robot(options.robot)).compile())
        if options.out is None:
            sys.stdout.write(text)
        else:
            options.out.write_text(text, encoding="utf-8")
    except (ParameterError, ValueError, OSError) as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
