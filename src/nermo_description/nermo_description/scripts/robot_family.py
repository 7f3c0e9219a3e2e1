"""Prints the family of a robot: launch files choose its controller by it."""

from __future__ import annotations

import argparse
import sys

from nermo_description.robots import ParameterError, family_of


def main(arguments: list[str] | None = None) -> int:
    """Exit status 0 if printed, 1 if the robot cannot be used."""
    parser = argparse.ArgumentParser(description=__doc__, epilog="example: robot_family cheetah_cub")
    parser.add_argument("robot", help="name of a robot, or a YAML file with its parameters")
    try:
        # Without a line's end: what is printed becomes part of a file's name.
        print(family_of(parser.parse_args(arguments).robot), end="")
    except ParameterError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
