"""Rollouts over any `concurrent.futures` executor; what is done is kept, and never done twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, as_completed
from typing import Any, Generic, Protocol, TypeVar

from nermo_sim.experiments.result_log import ResultLog


class Job(Protocol):
    """One rollout: picklable data."""

    @property
    def key(self) -> str:
        """Name of the rollout, by its content."""
        ...


JobType = TypeVar("JobType", bound=Job)


class Rollouts(Generic[JobType]):
    """Does jobs of one kind.

    run: does one; picklable. log: keeps each result as it comes, so that a search that was stopped finds its rollouts
    done. done: called after each rollout.
    """

    def __init__(
        self,
        run: Callable[[JobType], dict[str, Any]],
        executor: Executor,
        log: ResultLog,
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self._run, self._executor, self._log, self._done = run, executor, log, done
        self._used: set[str] = set()
        self.run_now = 0
        """Rollouts that were not in the log."""
        self.seconds = 0.0
        """Time spent on them."""

    @property
    def count(self) -> int:
        """Different rollouts that were asked for."""
        return len(self._used)

    def results(self, jobs: Sequence[Sequence[JobType]]) -> list[list[dict[str, Any]]]:
        """The result of each job, in the shape of the jobs."""
        wanted = {job.key: job for each in jobs for job in each}
        missing = [job for key, job in wanted.items() if key not in self._log]
        begin = time.monotonic()
        futures = {self._executor.submit(self._run, job): job for job in missing}
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
        return [[self._log[job.key] for job in each] for each in jobs]
