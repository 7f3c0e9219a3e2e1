"""Options of the commands that show a page while they run."""

from __future__ import annotations

from typing import Annotated

import typer

Web = Annotated[bool, typer.Option("--web", help="Watch it in the browser: what is known so far, curves to zoom.")]
WebHost = Annotated[str, typer.Option(metavar="HOST", help="With --web: 0.0.0.0 opens the page to who has its token.")]
WebPort = Annotated[
    int, typer.Option(metavar="PORT", min=0, max=65535, help="With --web: where the page is; 0: any that is free.")
]

HERE, PORT = "127.0.0.1", 8081
"""By default; beside the page of ``nermo up --web``, whose port is 8080."""
