"""Rollouts over any `concurrent.futures` executor; what is done is kept, and never done twice."""

from __future__ import annotations

import contextlib
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed

import numpy as np

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.results import CommandError
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.optimize.rollout import Metrics, Rollout, Trial, Walk, run

DASK = "dask://"


class Evaluator:
    """Tries sets of gait parameters.

    executor: any; `rollout.run` and its jobs are picklable. log: keeps each rollout as it comes, so that a search that
    was stopped finds its rollouts done. done: called after each rollout.
    """

    def __init__(
        self,
        executor: Executor,
        log: ResultLog,
        walk: Walk,
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self._executor, self._log, self._walk, self._done = executor, log, walk, done
        self._used: set[str] = set()
        self.run_now = 0
        """Rollouts that were not in the log."""
        self.seconds = 0.0
        """Time spent on them."""

    @property
    def rollouts(self) -> int:
        """Different rollouts that were asked for."""
        return len(self._used)

    def evaluate(self, candidates: Sequence[GaitParameters], trials: Sequence[Trial]) -> list[Metrics]:
        """The mean over the trials of each candidate."""
        jobs = [[Rollout(self._walk, candidate, trial) for trial in trials] for candidate in candidates]
        wanted = {job.key: job for each in jobs for job in each}
        missing = [job for key, job in wanted.items() if key not in self._log]
        begin = time.monotonic()
        futures = {self._executor.submit(run, job): job for job in missing}
        for _ in range(sum(key not in self._used for key in wanted) - len(missing)):
            self._done()
        try:
            for future in as_completed(futures):
                self._log.add(futures[future].key, future.result())
                self._done()
        finally:
            for future in futures:
                future.cancel()
        self._used.update(wanted)
        self.run_now += len(missing)
        self.seconds += time.monotonic() - begin
        return [_mean([self._log[job.key] for job in each]) for each in jobs]


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
