"""`python -m nermo_hw`: the words of `nermo hw` where there is no `nermo` command, as on the robot."""

import sys

from nermo_description.results import CommandError
from nermo_hw.cli import hw_app

try:
    hw_app(prog_name="python -m nermo_hw")
except CommandError as error:
    print(f"nermo_hw: {error}", file=sys.stderr)
    sys.exit(error.status)
except OSError as error:
    print(f"nermo_hw: {' '.join(str(error).split())}", file=sys.stderr)
    sys.exit(1)
