"""Sets of gait parameters, tried on the twin over any `concurrent.futures` executor."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor

import numpy as np

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_description.results import CommandError
from nermo_sim.experiments.result_log import ResultLog
from nermo_sim.optimize.rollout import Metrics, Rollout, Trial, Walk, run
from nermo_sim.optimize.rollouts import Rollouts
from simgap.data.errors import GapInputError
from simgap.execution.executors import open_pool


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
    """An executor by its name, as `open_pool` of simgap takes it.

    Raises CommandError (status 2) where it cannot be used.
    """
    with contextlib.ExitStack() as stack:
        try:
            pool = stack.enter_context(open_pool(place, workers))
        except GapInputError as error:
            raise CommandError(str(error), status=2) from error
        yield pool.executor
