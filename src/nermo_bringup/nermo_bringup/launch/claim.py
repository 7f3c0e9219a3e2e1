"""Who has brought the graph up on this machine: a second one with the same names would share its clock and commands."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from nermo_bringup.launch.description import NodeAction
from nermo_description.results import CommandError


@contextmanager
def claimed(nodes: Sequence[NodeAction]) -> Iterator[None]:
    """The nodes' names in this ROS domain, for whoever runs on this machine, while the block runs.

    By locks on files, which end with the process however it ends, so that nothing has to be waited for or cleared up.

    Raises:
        CommandError: another process has some of the names, and which one; or the files of the locks cannot be written.
    """
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    folder = Path(tempfile.gettempdir()) / f"nermo_graphs_{os.getuid()}" / domain
    with ExitStack() as held:
        for name in sorted({node.full_name for node in nodes}):
            try:
                folder.mkdir(parents=True, exist_ok=True)
                file = held.enter_context((folder / name.strip("/").replace("/", ".")).open("a+"))
            except OSError as error:
                raise CommandError(f"{folder}: {error.strerror}; it says which graphs are up.") from error
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                file.seek(0)
                who = file.read().strip() or "?"
                raise CommandError(
                    f"a graph is up already in ROS_DOMAIN_ID={domain} ({name}, of process {who}): end it, or take "
                    "another ROS_DOMAIN_ID, or another namespace:=NAME."
                ) from None
            file.truncate(0)
            file.write(str(os.getpid()))
            file.flush()
        yield
