"""Executors by name: processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass

import simgap
from simgap.data.errors import GapInputError

PROCESSES = "processes"
HELP = "Where it runs: processes, dask:local, or dask:tcp://HOST:PORT of a scheduler (pip install distributed)."
_KNOWN = "type processes, dask:local, or dask:tcp://HOST:PORT with a scheduler's address"
_PATIENCE = 10.0
"""[s] that a scheduler may take to answer, and to have a worker; chosen."""


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(frozen=True)
class Pool:
    """Where jobs run.

    Attributes:
        executor: Takes functions and arguments that can be pickled.
        width: How many jobs work at once; a scheduler's workers come and go.
    """

    executor: Executor
    width: Callable[[], int]


@contextlib.contextmanager
def open_pool(place: str = PROCESSES, workers: int | None = None, light: bool = False) -> Iterator[Pool]:
    """A pool by its name: ``processes`` of this machine, ``dask:local``, or ``dask:tcp://HOST:PORT``.

    workers: jobs at a time on this machine, by default one a processor; a scheduler has its own. light: each job only
    waits for a process that it starts itself, so that on this machine threads do. What has not begun when the block is
    left is dropped.

    Raises:
        GapInputError: an unknown place, Dask that is not installed, a scheduler that does not answer or has no workers,
            or workers without this version of simgap.
    """
    count = workers or processors()
    if place == PROCESSES:
        # A fresh interpreter for each worker: forking would copy the threads of whoever calls.
        executor: Executor = (
            ThreadPoolExecutor(count)
            if light
            else ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))
        )
        try:
            yield Pool(executor, lambda: count)
        finally:
            executor.shutdown(wait=light, cancel_futures=True)
        return
    with _dask(_address(place), place, count) as pool:
        yield pool


def _address(place: str) -> str:
    """``local``, or the address of a scheduler; ``dask://HOST:PORT`` is understood too."""
    kind, _, address = place.partition(":")
    address = address.removeprefix("//")
    if kind != "dask" or not address:
        raise GapInputError(f"--executor {place}: unknown; {_KNOWN}")
    return address if address == "local" or "://" in address else f"tcp://{address}"


@contextlib.contextmanager
def _dask(address: str, place: str, workers: int) -> Iterator[Pool]:
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise GapInputError(f"--executor {place}: Dask is not installed; type: pip install distributed") from error
    with contextlib.ExitStack() as stack:
        if address == "local":
            cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            address = stack.enter_context(cluster).scheduler_address
        try:
            client = stack.enter_context(Client(address, timeout=_PATIENCE))
        except (OSError, ValueError, TypeError) as error:
            raise GapInputError(
                f"--executor {place}: no scheduler answers at {address}; start one there: dask scheduler"
            ) from error
        try:
            client.wait_for_workers(1, timeout=_PATIENCE)
        except TimeoutError as error:
            raise GapInputError(
                f"--executor {place}: the scheduler has no workers; start some: dask worker {address}"
            ) from error
        _refuse_other_versions(client, place)
        yield Pool(client.get_executor(), lambda: max(sum(client.nthreads().values()), 1))


def _refuse_other_versions(client: object, place: str) -> None:
    try:
        found = set(client.run(_version).values())  # type: ignore[attr-defined]
    except Exception as error:  # whatever a worker says that cannot import simgap
        raise GapInputError(f"--executor {place}: the workers cannot import simgap; install it there") from error
    if others := found - {simgap.__version__}:
        raise GapInputError(
            f"--executor {place}: workers have simgap {others.pop()}, here it is {simgap.__version__}; install the same"
        )


def _version() -> str:
    return simgap.__version__
