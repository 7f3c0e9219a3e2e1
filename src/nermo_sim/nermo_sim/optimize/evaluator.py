"""Sets of gait parameters, tried on the twin over any `concurrent.futures` executor."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor

import numpy as np

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.results import CommandError
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.optimize.rollout import Metrics, Rollout, Trial, Walk, run
from nermo_sim.optimize.rollouts import Rollouts

DASK = "dask://"


class Evaluator:
    """Tries sets of gait parameters: `Rollouts` of walks, and their means."""

    def __init__(
        self,
        executor: Executor,
        log: ResultLog,
        walk: Walk,
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self._walk = walk
        self.rollouts = Rollouts(run, executor, log, done)

    def evaluate(self, candidates: Sequence[GaitParameters], trials: Sequence[Trial]) -> list[Metrics]:
        """The mean over the trials of each candidate."""
        jobs = [[Rollout(self._walk, candidate, trial) for trial in trials] for candidate in candidates]
        return [_mean(each) for each in self.rollouts.results(jobs)]


def _mean(runs: Sequence[Metrics]) -> Metrics:
    """Means over runs; fallen is who fell once."""
    names = [name for name in runs[0] if name != "fell"]
    return {
        **{name: float(np.mean([one[name] for one in runs])) for name in names},
        "fell": any(r["fell"] for r in runs),
    }


@contextlib.contextmanager
def open_executor(place: str, workers: int) -> Iterator[Executor]:
    """An executor by its name: `processes` of this machine, `dask://HOST:PORT` (a scheduler), or `dask://local`.

    Raises CommandError for an unknown place, a scheduler that does not answer, and where dask is not installed.
    """
    if place == "processes":
        # A fresh interpreter for each worker: forking would copy the threads of whoever calls.
        with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            try:
                yield pool
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        return
    if not place.startswith(DASK):
        raise CommandError(f"executor {place!r} is unknown: processes, dask://local or dask://HOST:PORT", status=2)
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise CommandError("dask is not installed: pip install distributed, into ./nermo's .venv", status=2) from error
    address = place.removeprefix(DASK)
    with contextlib.ExitStack() as stack:
        if address == "local":
            cluster = stack.enter_context(LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None))
            client = stack.enter_context(Client(cluster))
        else:
            try:
                client = stack.enter_context(Client(f"tcp://{address}", timeout=10.0))
            except (OSError, ValueError) as error:
                raise CommandError(f"no dask scheduler answers at {address}: {error}") from error
        yield client.get_executor()
