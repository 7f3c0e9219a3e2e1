"""``python -m simgap``: the simgap command."""

from simgap.cli import main

main()
