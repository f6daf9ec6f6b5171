"""Determines where independent items of work are computed: in this process, in several processes of this machine, or on a Dask
cluster.

The results do not depend on the computer, for three reasons: `work` is a pure function of one item, the random numbers depend on
the item and not on the worker, and the results are in the order of the items. `processes` and `cluster` are the two backends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from time import monotonic
from typing import TypeVar

from planrunner.base.dataclass import dataclass
from planrunner.base.processes import processors, shared_out

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, slots=True)
class Workers:
    """States where work is computed. `jobs`: number of processes on this machine, including this one; if it is None, the number
    depends on the work. `scheduler`: address of a Dask scheduler to use instead of processes, such as `tcp://10.0.0.5:8786`. Every
    worker of the cluster must see the paths among the items under the same names."""

    jobs: int | None = None
    scheduler: str | None = None


ALONE = Workers(1)
"""Uses only this process."""

_FEW, _MOST = 8, 256
"""Number of items for each process that are computed before their results are returned: the initial and the maximum number."""
_SHORT = 0.5
"""If the computation takes less than this time [s], the next number of items is four times as large."""


def results_of(
    work: Callable[[T], R], items: Sequence[T], workers: Workers, tell: Callable[[float], None] | None = None
) -> list[R]:
    """Returns the results of `work` for all items, in their order.

    `work`: a function at the top level of a module, or a `partial` of one, whose argument and result can be pickled. `tell`: a
    function that is called with the completed fraction of all items, 0 to 1. If `work` raises an exception, this function raises it
    as well; if several items fail, it raises the exception of the item that comes first. Raises `ProcessEndedError` if workers end
    before the work is done, and `ClusterError` if the cluster cannot be used.
    """
    if workers.scheduler is None:
        return shared_out(work, items, workers.jobs, tell)
    return list(results_in_order(work, items, workers, tell))


def results_in_order(
    work: Callable[[T], R], items: Sequence[T], workers: Workers, tell: Callable[[float], None] | None = None
) -> Iterator[R]:
    """Does the same as `results_of`, except that each result is yielded as soon as all earlier results are available. Not all
    results need to be in memory at the same time. The arguments are the same."""
    if workers.scheduler is not None:
        from planrunner.base.cluster import computed_on_cluster

        yield from computed_on_cluster(work, items, workers.scheduler, tell)
        return
    jobs = processors() if workers.jobs is None else workers.jobs
    size, done = 1 if jobs == 1 else _FEW * jobs, 0
    while done < len(items):
        began = monotonic()
        found = shared_out(work, items[done : done + size], workers.jobs)
        if jobs > 1 and monotonic() - began < _SHORT:
            size = min(4 * size, _MOST * jobs)
        done += len(found)
        yield from found
        if tell is not None:
            tell(done / len(items))
