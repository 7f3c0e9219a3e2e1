"""Many jobs over an executor; each is a picklable argument of one module-level function."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from itertools import chain, islice
from typing import TypeVar

from simgap.execution.executors import PROCESSES, open_pool

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_batch(
    function: Callable[[Job], Result],
    jobs: Iterable[Job],
    workers: int | None = None,
    place: str = PROCESSES,
    light: bool = False,
) -> Iterator[tuple[Job, Result]]:
    """Yields each job with its result as soon as it is done, in no fixed order.

    workers, place, light: as `open_pool` takes them. One worker (or a single job) stays in this process, unless
    the place is elsewhere. A job is drawn from ``jobs`` when there is a worker for it. An exception in a job comes out
    here, and the jobs that have not begun are dropped.

    Raises:
        GapInputError: the place cannot be used.
    """
    waiting = iter(jobs)
    first = list(islice(waiting, 2))
    waiting = chain(first, waiting)
    if not first:
        return
    if place == PROCESSES and not light and (len(first) == 1 or workers == 1):
        for job in waiting:
            yield job, function(job)
        return
    with open_pool(place, workers, light) as pool:
        running: dict[Future[Result], Job] = {}
        try:
            while True:
                for job in islice(waiting, max(pool.width() - len(running), 0)):
                    running[pool.executor.submit(function, job)] = job
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        finally:
            for future in running:
                future.cancel()
