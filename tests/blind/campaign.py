"""Makes cases and has them answered, by processes of this machine or on a Dask cluster, going on where it stopped.

Results do not depend on how the work is shared: a case's random numbers come from the seed and its own number.
"""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any, Literal

from planrunner.base.workers import ALONE, Workers, results_in_order
from tests.blind import folder as store
from tests.blind import further
from tests.blind.generator import assigned, make

Source = Literal["drawn", "real noise", "further"]
Answerer = Callable[[store.Shown], dict[str, Any]]

ANSWERERS = {
    "planrunner": "tests.blind.product:diagnose",
    "closure": "tests.blind.product:closure_and_truth",
    "oracle": "tests.blind.oracle:diagnose",
    "stepwise-bic": "tests.blind.baselines:stepwise_bic",
    "whitened-bic": "tests.blind.baselines:whitened_bic",
    "lasso": "tests.blind.baselines:lasso",
    "stlsq": "tests.blind.baselines:stlsq",
}
BATCH = 24  # cases of one set-up that a worker takes at a time


def make_batch(folder: str, seed: int, source: Source, numbers: Sequence[int]) -> int:
    for number in numbers:
        further_kind = source == "further"
        case = further.make(seed, number) if further_kind else make(seed, number, real_noise=source == "real noise")
        store.write_case(Path(folder), case, seed)
    return len(numbers)


def _setup(seed: int, number: int, source: Source) -> tuple[str, str]:
    """Plan and sensor type of a case."""
    told = further.assigned(seed, number) if source == "further" else assigned(seed, number, source == "real noise")
    return told[:2]


def answerer(name: str) -> Answerer:
    """A known name or `module:function`; the module is imported here and not before."""
    module, _, function = ANSWERERS.get(name, name).partition(":")
    return getattr(importlib.import_module(module), function)


def answer_batch(folder: str, names: Sequence[str], cases: Sequence[str]) -> int:
    """Has cases answered by all of `names`, case by case, so that those that need the same diagnosis share it."""
    answerers = {_label(name): answerer(name) for name in names}
    for case in cases:
        shown = store.shown(Path(folder), case)
        _ = shown.columns  # reading is not counted
        for label, diagnose in answerers.items():
            if store.answer_file(Path(folder), label, case).exists():
                continue
            begin = time.perf_counter()
            try:
                answer = diagnose(shown)
            except Exception as error:  # counted as an answer that failed, and shown in the score
                answer = {"error": f"{type(error).__name__}: {error}"}
            store.write_answer(Path(folder), label, case, {**answer, "seconds": time.perf_counter() - begin})
    return len(cases)


def _label(name: str) -> str:
    """The name of a folder of answers."""
    return name.replace(":", ".")


def _batches(keyed: list[tuple[Any, Any]]) -> list[list]:
    """Items in groups of one key and at most BATCH, so that a worker keeps what it knows of a set-up."""
    found = []
    for _, group in groupby(sorted(keyed), key=lambda pair: pair[0]):
        items = [item for _, item in group]
        found += [items[i : i + BATCH] for i in range(0, len(items), BATCH)]
    return found


class Progress:
    """Tells how many cases are done and about how long the others will take, from those done since it began."""

    def __init__(self, what: str, done: int, count: int, tell: Callable[[str], None]):
        self.what, self.begun, self.done, self.count, self.tell = what, done, done, count, tell
        self.since = time.monotonic()

    def more(self, cases: int) -> None:
        self.done += cases
        left = self.count - self.done
        seconds = (time.monotonic() - self.since) / (self.done - self.begun) * left
        told = f", about {seconds / 60:.0f} min left" if seconds >= 60 else ""
        self.tell(f"{self.done} of {self.count} {self.what}{told}")


def make_all(
    folder: Path,
    count: int,
    seed: int,
    workers: Workers = ALONE,
    tell: Callable = lambda _: None,
    source: Source = "drawn",
) -> None:
    """Makes `count` cases, those that are whole already left out, then commits to the labels.

    source: the cases of the campaign with drawn noise, or with that of recordings at rest; or those of further kinds.

    Raises ValueError where the folder holds another campaign: its seed or its commitments would not be kept.
    """
    folder.mkdir(parents=True, exist_ok=True)
    campaign = folder / "sealed" / "seed"
    if campaign.exists() and campaign.read_text(encoding="utf-8") != str(seed):
        raise ValueError(f"{folder} holds a campaign of another seed; take a new folder")
    store.write_setups(folder, source == "real noise")
    campaign.parent.mkdir(exist_ok=True)
    campaign.write_text(str(seed), encoding="utf-8")
    have = set(store.made(folder))
    wanted = [(_setup(seed, n, source), n) for n in range(count) if f"case-{n:05d}" not in have]
    progress = Progress("made", count - len(wanted), count, tell)
    for more in results_in_order(partial(make_batch, str(folder), seed, source), _batches(wanted), workers):
        progress.more(more)
    store.commit(folder)


def answer_all(
    folder: Path,
    names: Sequence[str],
    workers: Workers = ALONE,
    tell: Callable = lambda _: None,
    first: int | None = None,
) -> None:
    """Has every case answered that one of `names` has not answered yet, or of the first so many cases."""
    cases = store.made(folder)[:first]
    wanted = [
        (json.loads((folder / "cases" / case / "case.json").read_text(encoding="utf-8"))["setup"], case)
        for case in cases
        if not all(store.answer_file(folder, _label(name), case).exists() for name in names)
    ]
    progress = Progress(f"answered by {', '.join(names)}", len(cases) - len(wanted), len(cases), tell)
    for more in results_in_order(partial(answer_batch, str(folder), tuple(names)), _batches(wanted), workers):
        progress.more(more)
