"""Distributes work on many items over a Dask cluster (https://distributed.dask.org).

A task consists of one item, or of several items if each of them takes very little time. A worker computes one item at a time. Each
worker uses a single thread for linear algebra, and has the same working directory as this process. If a worker is lost, Dask
computes its items again on another worker. Only a limited number of items is on the cluster at a time, so that neither the
scheduler nor this process keeps all of them.

Before computing, a worker checks that it has the same program and libraries as this process, because otherwise the last digits may
differ. The check is part of each task, because workers may join the cluster at any time.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import math
import os
import pickle
import socket
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING, TypeVar
from urllib.parse import urlsplit

import planrunner
from planrunner.base.findings import Mark
from planrunner.base.processes import ClusterError, ProcessEndedError

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")
R = TypeVar("R")


ANSWER_WITHIN = 10.0
"""Seconds within which a scheduler must answer."""
WORKERS_WITHIN = 30.0
"""Seconds within which a cluster must have a worker."""

_AHEAD = 4
"""Number of tasks for each thread of a worker that are on the cluster at the same time."""
_LEAST_AHEAD = 16
_TASK_LASTS = 1.0
"""Intended duration of a task of several items, s. The transfer of a task takes about 10 ms of processor time of the command and
the scheduler. Workers on the same machine lose this time."""
_SHARES_LEFT = 2
"""Minimum number of tasks, for each thread of a worker, into which the remaining items are divided. With small tasks at the end,
the other workers do not wait long for the last task."""
_MOST_OF_A_TASK = 512
_ONE_AT_A_TIME = Lock()
_COMPARED = ("numpy", "scipy", "numba", "pyarrow")
_SCHEDULER = "--scheduler"


@dataclass(frozen=True, slots=True)
class _Terms:
    """The conditions that are sent to a worker with every task of a computation.

    `versions`: the versions of the program and of the libraries that the worker must have. `directory`: the working directory of
    this process, which the worker must use."""

    versions: Mapping[str, str]
    directory: str


@dataclass(frozen=True, slots=True)
class _Answer:
    """The answer to a task. The answer contains the results of the items up to the first item that failed, and the exception of
    this item. If the worker cannot compute, it contains the reason instead.

    `seconds`: the time that computing took, s. `unseen`: a path that the worker cannot access; otherwise empty. `worker`: name of
    the worker. `unfit`: maps each library whose versions differ to the pair (version here, version on the worker)."""

    results: tuple[object, ...] = ()
    error: Exception | None = None
    seconds: float = 0.0
    unfit: Mapping[str, tuple[str, str]] | None = None
    unseen: str = ""
    worker: str = ""


@functools.cache
def versions() -> dict[str, str]:
    """Returns everything that can change the digits of a result: the program (as a digest of its source), Python, and the numerical
    libraries, with their versions."""
    import platform
    from importlib import metadata

    root, source = Path(planrunner.__file__).parent, hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        source.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    found = {"planrunner": f"{planrunner.__version__} ({source.hexdigest()[:12]})", "python": platform.python_version()}
    for name in _COMPARED:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def computed_on_cluster(
    work: Callable[[T], R],
    items: Sequence[T],
    address: str,
    tell: Callable[[float], None] | None = None,
) -> Iterator[R]:
    """Yields the results of `work` for all items, in the order of the items; see `workers.results_in_order`. `address`: the address
    of the cluster's scheduler. Raises `ClusterError` if the cluster cannot be used, for example because a worker cannot access a
    path among the items, and `ProcessEndedError` if the cluster ends. `tell`: a function that is called with the completed
    fraction."""
    if not items:
        return
    terms = _Terms(versions(), os.getcwd())
    with _connected(address) as client:
        packed = _packed(work)
        threads = sum(one["nthreads"] for one in client.scheduler_info(n_workers=-1)["workers"].values())
        ahead = max(_LEAST_AHEAD, _AHEAD * threads)
        waiting: deque[Future[_Answer]] = deque()
        sent = done = 0
        size = 1
        while done < len(items):
            while sent < len(items) and len(waiting) < ahead:
                some = tuple(items[sent : sent + _shared(size, len(items) - sent, threads)])
                waiting.append(client.submit(_compute, packed, terms, some, _paths(some), pure=False))
                sent += len(some)
            answer = _answer_of(waiting.popleft(), address)
            _require_fit(answer, terms, address)
            for result in answer.results:
                done += 1
                if tell is not None:
                    tell(done / len(items))
                yield result  # type: ignore[misc]
            if answer.error is not None:
                raise answer.error
            size = _size(answer)


def _shared(size: int, left: int, threads: int) -> int:
    """Returns the number of items in the next task, at most `size`. Near the end the number is smaller, so that the remaining items
    still give several tasks for each thread of the cluster."""
    return min(size, math.ceil(left / (_SHARES_LEFT * max(1, threads))))


def _size(answer: _Answer) -> int:
    """Returns the number of items for a task of suitable duration, estimated from the computing time of an earlier answer."""
    each = answer.seconds / max(1, len(answer.results))
    return max(1, min(_MOST_OF_A_TASK, int(_TASK_LASTS / each))) if each > 0 else _MOST_OF_A_TASK


def _packed(work: Callable[[T], R]) -> bytes:
    """Packs the work so that only the workers unpack it. Otherwise, the scheduler would also import the modules of the work and
    keep its data."""
    import cloudpickle

    return bytes(cloudpickle.dumps(work))


def _paths(items: Sequence[object]) -> tuple[str, ...]:
    """Returns the items, and parts of items, that are paths of existing files or folders."""
    parts = (part for item in items for part in (item if isinstance(item, tuple) else (item,)))
    return tuple(str(part) for part in parts if isinstance(part, Path) and part.exists())


def _compute(packed: bytes, terms: _Terms, items: Sequence[T], paths: Sequence[str] = ()) -> _Answer:
    """Computes the items of a task; runs on a worker. `paths`: paths that the worker must see."""
    own = versions()
    unfit = {
        name: (one, own.get(name, "not installed")) for name, one in terms.versions.items() if own.get(name) != one
    }
    if unfit:
        return _Answer(unfit=unfit, worker=_name())
    from threadpoolctl import threadpool_limits

    try:
        work = _unpacked(packed)
    except (ImportError, AttributeError) as error:
        return _Answer(unfit={"plug-ins": ("those of the command", str(error))}, worker=_name())
    with _ONE_AT_A_TIME, _in_directory(terms.directory) as there:
        for path in paths:
            if not (there or os.path.isabs(path)) or not os.path.exists(path):
                return _Answer(unseen=path, worker=_name())
        began, results = monotonic(), list[object]()
        with threadpool_limits(limits=1, user_api="blas"):
            try:
                for item in items:
                    results.append(work(item))
            except Exception as error:
                return _Answer(tuple(results), error)
        return _Answer(tuple(results), None, monotonic() - began)


@functools.lru_cache(maxsize=4)  # the tasks of a command share it
def _unpacked(packed: bytes) -> Callable[[object], object]:
    work: Callable[[object], object] = pickle.loads(packed)
    return work


@contextlib.contextmanager
def _in_directory(path: str) -> Iterator[bool]:
    """Changes to the working directory of the command, so that relative paths have the same meaning on the worker, also in
    messages. Yields True if the worker has this directory."""
    before, there = os.getcwd(), False
    with contextlib.suppress(OSError):
        os.chdir(path)
        there = True
    try:
        yield there
    finally:
        os.chdir(before)


def _name() -> str:
    from distributed import get_worker

    return str(get_worker().address)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """Connects a client to the scheduler, which must have a worker. Raises `ClusterError` if no scheduler answers, or if the
    scheduler has no worker."""
    try:
        from distributed import Client
    except ImportError:
        message = "Dask is not installed"
        raise ClusterError.at(
            Mark(_SCHEDULER),
            "scheduler-missing",
            message,
            "run `pip install planrunner[cluster]`, or use --jobs",
        ) from None
    import logging

    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # its reports of lost connections are messages below

    class Closed(Client):  # type: ignore[misc,unused-ignore]
        """A client that does not close itself when it is deleted; `_connected` closes it. Otherwise, a client that was never
        connected would try to close itself for 20 s."""

        def __del__(self) -> None:
            pass

    try:
        _knock(address)
        client = Closed(address, timeout=ANSWER_WITHIN, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        message = f"no Dask scheduler answers at {address}: {_short(error)}"
        hint = "check the address that `dask scheduler` prints, such as tcp://10.0.0.5:8786, and that it still runs"
        raise ClusterError.at(Mark(_SCHEDULER), "scheduler-unreachable", message, hint) from None
    try:
        try:
            client.wait_for_workers(1, timeout=WORKERS_WITHIN)
        except TimeoutError:
            hint = f"start workers with `dask worker {address} --nthreads 1`"
            raise ClusterError.at(
                Mark(_SCHEDULER), "scheduler-idle", f"the scheduler at {address} has no workers", hint
            ) from None
        yield client
    finally:
        with contextlib.suppress(Exception):
            client.close(timeout=ANSWER_WITHIN)  # type: ignore[no-untyped-call]


def _knock(address: str) -> None:
    """Tries to connect to the address once, because Dask repeats a refused connection until its time-out. Raises `OSError` or
    ValueError if the connection is refused."""
    parts = urlsplit(address)
    if parts.scheme in ("tcp", "tls"):
        socket.create_connection((parts.hostname or "", parts.port or 0), timeout=ANSWER_WITHIN).close()


def _answer_of(future: Future[_Answer], address: str) -> _Answer:
    """Returns the answer of a task. Raises `ProcessEndedError` if the item cannot be computed because workers or the scheduler have
    ended, and `ClusterError` if the workers do not have planrunner."""
    from concurrent.futures import CancelledError

    from distributed import KilledWorker
    from distributed.comm import CommClosedError

    try:
        answer = future.result()
    except KilledWorker as error:
        message = (
            f"several workers ended while they computed one of the items, the last one at {error.last_worker.address}"
        )
        raise ProcessEndedError(f"{message}; their memory may be used up: use fewer workers on each machine") from None
    except (CancelledError, CommClosedError) as error:
        raise ProcessEndedError(
            f"the scheduler at {address} ended before the work was done ({_short(error)})"
        ) from None
    except (ImportError, AttributeError, RuntimeError) as error:  # the task could not even be read there
        message = f"the scheduler or a worker of {address} has no planrunner: {_short(error)}"
        hint = "install the same planrunner, with the same plug-ins, for the scheduler and on each worker"
        raise ClusterError.at(Mark(_SCHEDULER), "scheduler-versions", message, hint) from None
    return answer


def _require_fit(answer: _Answer, terms: _Terms, address: str) -> None:
    if answer.unfit is not None:
        other = ", ".join(f"{name} {there} instead of {here}" for name, (here, there) in answer.unfit.items())
        message = f"the worker {answer.worker} of {address} has different versions: {other}"
        hint = "install the same versions on each worker: results are otherwise not the same to the last digit"
        raise ClusterError.at(Mark(_SCHEDULER), "scheduler-versions", message, hint)
    if answer.unseen:
        message = f"the worker {answer.worker} of {address} cannot access {answer.unseen}"
        where = os.path.join(terms.directory, answer.unseen)
        raise ClusterError.at(
            Mark(_SCHEDULER), "scheduler-folder", message, f"share {where} with each worker, under the same path"
        )


def _short(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:200] if lines else type(error).__name__
