"""Distributes work on many items over several processes.

The items are distributed before the processes start, and each process sends all its results together when it has finished.
Therefore no process waits for another. If the first process is killed, the others end when they have computed their part. If
another process is killed, its pipe closes; the first process then raises an error instead of waiting for ever.

On Linux, if this process has only one thread, the other processes are forks of this process. A fork already has everything that
this process has imported and computed. Otherwise, each of the other processes is a new interpreter, whose start takes as long as
the work on many items.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Generic, TypeVar

from planrunner.base.findings import InputError
from planrunner.base.interruption import ENDING, signals

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

T = TypeVar("T")
R = TypeVar("R")

_PAYS = {"fork": 4, "spawn": 64}
"""Minimum number of items per process for which a further process saves time, if each item takes some milliseconds."""


class ProcessEndedError(Exception):
    """Reports that a process ended before it had finished its part of the work, for example because the memory was exhausted."""


class ClusterError(InputError):
    """Reports that a cluster cannot be used to share the work, for example because no scheduler answers."""


def processors() -> int:
    """Returns the number of processors that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def shared_out(
    work: Callable[[T], R], items: Sequence[T], jobs: int | None = None, tell: Callable[[float], None] | None = None
) -> list[R]:
    """Returns the results of `work` for all items, in their order.

    `work`: a function at the top level of a module, or a `partial` of one, whose argument and result can be pickled. `jobs`: number
    of processes including this one; if it is None, the number depends on the processors and on the number of items. `tell`: a
    function that is called in this process after each item that it computes, with the completed fraction (0 to 1) of its own items.
    If `work` raises an exception, this function raises it as well; if several items fail, it raises the exception of the item that
    comes first. Raises `ProcessEndedError` if another process ends early.
    """
    tell = tell or _untold
    method = "fork" if _may_fork() else "spawn"
    most = min(processors(), len(items) // _PAYS[method]) if jobs is None else min(jobs, len(items))
    if most < 2 or _is_worker():
        alone = []
        for number, item in enumerate(items, start=1):
            alone.append(work(item))
            tell(number / len(items))
        return alone
    done = [work(items[0])]  # what is computed for the first item is there for all forks
    left = items[1:]
    shares = [left[first::most] for first in range(most)]
    with contextlib.ExitStack() as open_:
        others = [open_.enter_context(_Started(method, work, share)) for share in shares[1:] if share]
        results = [_up_to_a_failure(work, shares[0], tell), *(other.results() for other in others)]
    for number in range(len(left)):
        share, place = results[number % most], number // most
        # One is missing if the work failed on it or before it: it fails here again, as without other processes.
        done.append(share[place] if place < len(share) else work(left[number]))
    return done


def _untold(_: float) -> None:
    """Does nothing. This function is used if no function for the progress is given."""


def _up_to_a_failure(work: Callable[[T], R], share: Sequence[T], tell: Callable[[float], None] = _untold) -> list[R]:
    """Returns the results for the items before the first one that fails. `tell`: a function that is called with the completed
    fraction after each item."""
    results: list[R] = []
    with contextlib.suppress(Exception):
        for item in share:
            results.append(work(item))
            tell(len(results) / len(share))
    return results


def _is_worker() -> bool:
    """Returns True if this process is itself a worker of this module or of Dask. Such a process must not start further
    processes."""
    from multiprocessing import current_process

    return current_process().daemon


def _may_fork() -> bool:
    """Returns True if a fork is safe, because this process has only one thread. In a fork, a lock that another thread holds would
    stay locked for ever."""
    if sys.platform != "linux":
        return False
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


class _Started(Generic[T, R]):
    """A further process, which computes a part of the items. As a context manager, it ends the process on exit."""

    def __init__(self, method: str, work: Callable[[T], R], share: Sequence[T]):
        from multiprocessing import get_context

        context = get_context(method)
        self._answer, end = context.Pipe(duplex=False)
        self._process: BaseProcess = context.Process(target=_do, args=(end, work, share), daemon=True)  # type: ignore[attr-defined]
        try:
            with _signals_held_back():
                self._process.start()
        except OSError as error:
            self._answer.close()
            raise ProcessEndedError(f"a further process cannot be started ({error.strerror}); use fewer jobs") from None
        finally:
            end.close()  # so that it is open in that process alone, and closed when that ends

    def __enter__(self) -> _Started[T, R]:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()
        self._answer.close()

    def results(self) -> list[R]:
        """Returns the results of this process for its items, up to the first item that failed. Raises `ProcessEndedError` if the
        process ended without sending them."""
        try:
            found: list[R] = self._answer.recv()
        except (EOFError, OSError):
            self._process.join()
            code = self._process.exitcode or 0
            how = f"by {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
            message = f"one of the processes that share the work ended {how}; the memory may be used up: use fewer jobs"
            raise ProcessEndedError(message) from None
        return found


def _do(end: Connection, work: Callable[[T], R], share: Sequence[T]) -> None:
    """Runs as the main function of a further process: computes the results of its items, and sends them to the first process."""
    _leave_ctrl_c_to_the_first_process()
    results = _up_to_a_failure(work, share)
    with contextlib.suppress(BrokenPipeError):  # the first process was killed
        end.send(results)
    end.close()


@contextlib.contextmanager
def _signals_held_back() -> Iterator[None]:
    """Blocks the signals that end a command while a process is started, so that the handlers of this process do not run in the new
    process."""
    if sys.platform == "win32":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals(ENDING))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _leave_ctrl_c_to_the_first_process() -> None:
    """Ignores Ctrl-C. In a terminal, Ctrl-C reaches all processes; only the first process handles it, and ends the others."""
    for number in signals(ENDING):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.SIG_IGN if number == signal.SIGINT else signal.SIG_DFL)
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_UNBLOCK, signals(ENDING))
