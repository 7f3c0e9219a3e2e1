"""`python -m nermo_bringup`: the nermo command."""

from nermo_bringup.cli import main

main()
