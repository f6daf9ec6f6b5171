"""Compares the meanings of two plans, two benches or two runs, for the command line, pages and other programs.

compared = compare(Path("old.yaml"), Path("new.yaml"))
compared.different          whether they mean different things
compared.meaning            what differs (`planrunner.review.difference`)
compared.consequences       what follows from it (`planrunner.review.consequences`); None for benches and runs
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path

from planrunner.archive.analyses import chosen_analysis
from planrunner.archive.run_reader import RunReader
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.bench.model import NAME, Bench, parse_bench, read_bench, shipped_benches
from planrunner.estimators.results import Results
from planrunner.plan import source
from planrunner.plan.model import Plan, parse_plan
from planrunner.review.compared import Compared, ComparedKind, Fact
from planrunner.review.consequences import Forecast, consequences
from planrunner.review.difference import difference
from planrunner.review.meaning import Meaning, meaning_of_bench, meaning_of_plan
from planrunner.review.runs import run_difference
from planrunner.tasks.check import Checked, Document, check_plan
from planrunner.tasks.estimate import stored_results


def compare(before: Path, after: Path, bench: str | None = None, *, foresee: bool = True) -> Compared:
    """Compares two plans, two benches or two run folders, and returns the difference. A bench may also be given by the name of a
    shipped bench.

    `bench`: the bench on which both plans are checked, instead of the benches that they name. `foresee`: True to check both plans
    on their benches and find the consequences of the difference. This takes as long as two runs of `check`. Raises `InputError` if
    a file cannot be read or has errors of form or meaning, and `IntegrityError` for a damaged run.
    """
    kinds = kind_of(before), kind_of(after)
    if kinds[0] != kinds[1]:
        message = f"{before} is a {kinds[0]}, but {after} is a {kinds[1]}"
        raise InputError.at(COMMAND_LINE, "diff-kinds", message, "compare two plans, two benches or two runs")
    names = str(before), str(after)
    if kinds[0] == "run":
        return _runs(before, after, names)
    if kinds[0] == "bench":
        meanings = [meaning_of_bench(_bench(path)) for path in (before, after)]
        found = difference(*meanings)
        return Compared("bench", names, (meanings[0], meanings[1]), found)
    given = [Document(source.read_bytes(path), str(path)) for path in (before, after)]
    return compare_plans(given[0], given[1], bench, foresee=foresee)


def compare_plans(
    before: Document, after: Document, bench: str | None = None, *, foresee: bool = True, today: date | None = None
) -> Compared:
    """Compares two plans; see `compare`."""
    sides = [_Side.of(document, bench) for document in (before, after)]
    known = all(side.bench is not None for side in sides)
    benches = [meaning_of_bench(side.bench) if known and side.bench is not None else None for side in sides]
    meanings = [meaning_of_plan(side.plan, side.bench if known else None) for side in sides]
    found = difference(meanings[0], meanings[1], benches[0], benches[1])
    made = Compared(
        "plan",
        (before.shown, after.shown),
        (meanings[0], meanings[1]),
        found,
        titles=(sides[0].plan.title, sides[1].plan.title),
    )
    if not foresee:
        return replace(made, unforeseen="predictions were not asked for")
    if not known:
        missing = next(side.missing for side in sides if side.bench is None)
        return replace(made, unforeseen=f"predictions need the benches: {missing}")
    if found.empty:
        return replace(made, unforeseen="the plans mean the same")
    checked = [check_plan(document, bench=bench, today=today) for document in (before, after)]
    effects = consequences(_forecast(checked[0]), _forecast(checked[1]))
    return replace(made, consequences=effects, schedules=(checked[0].schedule, checked[1].schedule))


def kind_of(path: Path) -> ComparedKind:
    """Returns the kind of a file or folder: plan, bench or run. Raises `InputError` if it cannot be read."""
    if path.is_dir():
        return "run"
    if _is_shipped(path):
        return "bench"
    root = source.load(path)
    return "bench" if root.get("planrunner_bench") is not None and root.get("planrunner") is None else "plan"


def meaning_of_file(path: Path) -> Meaning:
    """Returns the meaning of a plan or bench file. The meaning of a plan contains only the name of its bench, not the contents of
    the bench file. Raises `InputError` if the file cannot be read or has errors."""
    if kind_of(path) == "bench":
        return meaning_of_bench(_bench(path))
    return meaning_of_plan(_plan(source.read_bytes(path), str(path)))


def _is_shipped(path: Path) -> bool:
    return re.fullmatch(NAME, str(path)) is not None and not path.exists() and str(path) in shipped_benches()


def _bench(path: Path) -> Bench:
    return read_bench(str(path) if _is_shipped(path) else str(path.absolute()))[0]


def _plan(data: bytes, shown: str) -> Plan:
    plan, log = parse_plan(source.decode(data, shown), shown)
    if plan is None or log.errors:
        raise InputError(log)
    return plan


@dataclass(frozen=True, slots=True)
class _Side:
    """Contains one side of the comparison: a plan and its bench. `missing`: the reason why `bench` is None."""

    plan: Plan
    bench: Bench | None
    missing: str = ""

    @classmethod
    def of(cls, document: Document, bench: str | None) -> _Side:
        plan = _plan(document.data, document.shown)
        try:
            beside = Path() if bench is not None else Path(document.shown).parent
            return cls(plan, read_bench(bench or plan.bench, beside)[0])
        except InputError as error:
            if bench is not None or any(one.code not in _NO_BENCH for one in error.findings):
                raise
            return cls(plan, None, f"{document.shown}: {error.findings[0].message}: '{plan.bench}'")


_NO_BENCH = ("file-missing", "meaning-unknown-bench")
"""Codes of findings about a missing bench, which are not errors here. A plan is often compared without its bench: for example, git
copies the old version to a temporary folder."""


def _forecast(checked: Checked) -> Forecast:
    models = checked.models
    return Forecast(
        checked.schedule,
        checked.designs,
        checked.judged,
        None if models is None else models.table,
        None if models is None else models.chamber,
        tuple(checked.findings),
    )


# -- runs ------------------------------------------------------------------------------------------------------------


def _runs(before: Path, after: Path, names: tuple[str, str]) -> Compared:
    readers = [RunReader.open(path) for path in (before, after)]
    results = [_results(reader) for reader in readers]
    plans = [_plan(reader.plan_bytes, str(reader.path / "plan.yaml")) for reader in readers]
    benches = [_bench_in(reader) for reader in readers]
    meant = [meaning_of_plan(plan, bench) for plan, bench in zip(plans, benches, strict=True)]
    of_benches = [meaning_of_bench(bench) for bench in benches]
    found = difference(meant[0], meant[1], of_benches[0], of_benches[1])
    same = of_benches[0].digest() == of_benches[1].digest()
    return Compared(
        "run",
        names,
        (meant[0], meant[1]),
        found,
        titles=(plans[0].title, plans[1].title),
        runs=run_difference(results[0].estimates, results[1].estimates, same),
        facts=tuple(_facts(readers[0], readers[1])),
        conditions=tuple(_conditions(results[0].segments, results[1].segments)),
    )


def _results(reader: RunReader) -> Results:
    return stored_results(chosen_analysis(reader.path, reader.analyses))


def _bench_in(reader: RunReader) -> Bench:
    shown = str(reader.path / "bench.yaml")
    bench, log = parse_bench(source.parse(source.decode(reader.bench_bytes, shown), shown))
    if bench is None or log.errors:
        raise InputError(log)
    return bench


def _facts(one: RunReader, other: RunReader) -> list[Fact]:
    """Returns the versions, the run information and the instruments in which two runs differ."""
    pairs: dict[str, list[str]] = {}
    for k, reader in enumerate((one, other)):
        stated: JsonObject = {"created": reader.run["created"], "seed": reader.run.get("seed")}
        stated |= {f"version of {name}": text for name, text in reader.run["versions"].items()}
        stated |= {str(name): text for name, text in reader.run["info"].items()}
        for instrument, described in reader.instruments.items():
            stated |= {f"{instrument}, {name}": text for name, text in described.items()}
        for name, value in stated.items():
            pairs.setdefault(name, ["", ""])[k] = "" if value is None else str(value)
    return [Fact(name, a, b) for name, (a, b) in pairs.items() if a != b]


def _conditions(one: Sequence[Mapping[str, object]], other: Sequence[Mapping[str, object]]) -> list[Fact]:
    """Returns the measured conditions in which two runs differ. For each kind of reading, the result contains the values in the
    segment with the largest difference. Different numbers of segments with rejected or truncated data are included too."""
    found = []
    pairs = {str(item["label"]): item for item in other}
    largest: dict[str, tuple[float, str, float, float]] = {}
    for item in one:
        match = pairs.get(str(item["label"]))
        if match is None:
            continue
        a, b = item["readings"], match["readings"]
        assert isinstance(a, Mapping) and isinstance(b, Mapping)
        for name in a.keys() & b.keys():
            apart = abs(float(a[name]) - float(b[name]))
            if apart > largest.get(name, (0.0, "", 0.0, 0.0))[0]:
                largest[name] = apart, str(item["label"]), float(a[name]), float(b[name])
    for name in sorted(largest):
        _, label, x, y = largest[name]
        found.append(Fact(f"{name}, largest difference in {label}", f"{x:.6g}", f"{y:.6g}"))
    for name in ("rejected", "truncated"):
        counts = [sum(int(bool(item[name])) for item in side) for side in (one, other)]
        if counts[0] != counts[1]:
            found.append(Fact(f"segments with {name} data", str(counts[0]), str(counts[1])))
    return found
