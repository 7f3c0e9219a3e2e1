"""Many runs over several processes; each job is a picklable argument of one module-level function."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def processors() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_batch(
    function: Callable[[Job], Result], jobs: Iterable[Job], workers: int | None = None
) -> Iterator[tuple[Job, Result]]:
    """Yields each job with its result as soon as it is done, in no fixed order.

    workers: processes; None is one a processor, and 1 (or a single job) stays in this process. An exception in a job
    comes out here, and the jobs that have not begun are dropped.
    """
    waiting = list(jobs)
    count = min(workers or processors(), len(waiting))
    if count <= 1:
        for job in waiting:
            yield job, function(job)
        return
    # A fresh interpreter for each worker: forking would copy the threads of whoever calls.
    with ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = {pool.submit(function, job): job for job in waiting}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
