"""Scores answers in the diagnosis' output contract against labels: every figure of the target table, with binomial intervals.

An answer is right at class level when what it names is the truth or a member of the class that the generator found inseparable from it
under that plan; an "indistinguishable" answer is right when its class holds the truth. Effects that the nominal parameters absorb whole
count as none. An effect on the level of the noise beside another effect is no part of the cause: probabilities, sets and calibration
are about causes, whatever the noise, and `right` asks for the noise too. An effect off the catalogue that one of the catalogue looks
like under that plan is rightly called either, and does not count among those to be recognised.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from typing import Any

import numpy as np

from tests.blind.effects import KINDS

UNKNOWN = "unknown"
BANDS = {"20-65 (36)": (20.0, 65.0), "80-260 (144)": (80.0, 260.0), ">= 900": (900.0, np.inf), ">= 36": (36.0, np.inf)}
STRONG, WEAK = 144.0, 36.0
NAMED_SINCE = {"vibration_tone": ("gyro_line_interference",)}
"""Effects of the generator that were off the catalogue when the campaign was laid down, with the names that they have in it now. Labels of
earlier campaigns stay valid: either answer is right."""
_BANDS = ("36-144", "144-900", ">= 900")  # of closures
BINS = 15  # of confidence, equally wide
CERTAIN = 0.99
ON_NOISE = frozenset(name for name, kind in KINDS.items() if kind.covariance)
"""Effects on the level of the noise."""
SEED = 5


@dataclass(frozen=True)
class Rate:
    """A share of cases with its 95 % interval (Wilson, Journal of the American Statistical Association 22 (1927) 209)."""

    hits: int
    n: int

    @property
    def value(self) -> float:
        return self.hits / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        if not self.n:
            return (0.0, 1.0)
        z, n, p = 1.959964, self.n, self.value
        middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z / (1 + z**2 / n) * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
        return max(0.0, float(middle - half)), min(1.0, float(middle + half))

    def to_json(self) -> dict[str, Any]:
        low, high = self.interval
        return {"value": None if not self.n else self.value, "hits": self.hits, "n": self.n, "interval_95": [low, high]}


def rate(hits: Iterable[bool]) -> Rate:
    listed = [bool(hit) for hit in hits]
    return Rate(sum(listed), len(listed))


def causes(names: Iterable[str]) -> set[str]:
    """Effects without those on the noise beside them."""
    named = set(names)
    return named - ON_NOISE or named


@dataclass(frozen=True)
class Scored:
    """One case: its label beside an answer."""

    label: Mapping[str, Any]
    answer: Mapping[str, Any]

    @property
    def kind(self) -> str:
        return str(self.label["kind"])

    @property
    def failed(self) -> bool:
        return "error" in self.answer

    @cached_property
    def strengths(self) -> list[float]:
        return [entry["lambda"] for entry in self.label["entries"] if not entry["absorbed"]]

    @property
    def weakest(self) -> float:
        return min(self.strengths, default=0.0)

    @cached_property
    def acting(self) -> set[str]:
        """The true effects that the nominal parameters do not absorb."""
        return {entry["effect"] for entry in self.label["entries"] if not entry["absorbed"]}

    @cached_property
    def classes(self) -> list[set[str]]:
        """Per effect of the true cause the names that count as it."""
        own = causes(self.acting)
        return [
            {*entry["class"], entry["effect"], *NAMED_SINCE.get(entry["effect"], ())}
            for entry in self.label["entries"]
            if entry["effect"] in own
        ]

    @property
    def lookalikes(self) -> set[str]:
        """Effects of the catalogue that cannot be told from the one off it under that plan."""
        return self.classes[0] - set(self.label["effects"]) if self.kind == UNKNOWN else set()

    def says_the_truth(self, names: Iterable[str]) -> bool:
        """Whether a set of names, {"unknown"} included, is the true cause at class level, whatever the noise."""
        named = causes(names)
        if self.kind == "unknown":
            return named == {UNKNOWN} or (len(named) == 1 and named <= self.lookalikes)
        if len(named) != len(self.classes):
            return False
        return any(
            all(name in own for name, own in zip(sorted(named), order, strict=True))
            for order in permutations(self.classes)
        )

    def key_is_true(self, key: str) -> bool:
        return self.says_the_truth([] if key == "none" else key.split("+"))

    @cached_property
    def announced(self) -> list[str]:
        """Posterior keys that the verdict stands for: one, or those of the class that it names."""
        verdict = self.answer.get("verdict") or {"kind": "none"}
        if verdict["kind"] in ("none", UNKNOWN):
            return [verdict["kind"]]
        effects = "+".join(sorted(verdict.get("effects", ())))
        members = verdict.get("class") or []
        return list(dict.fromkeys(([effects] if effects else []) + ["+".join(sorted(m.split("+"))) for m in members]))

    @cached_property
    def cause_is_right(self) -> bool:
        if self.kind == "mislabelled":
            return self.says_none and self.answer.get("declarations") == self.label["effects"]
        return not self.failed and any(self.key_is_true(key) for key in self.announced)

    @property
    def noise_said(self) -> set[str]:
        """The effects on the noise that the verdict names beside a cause."""
        verdict = self.answer.get("verdict") or {}
        said = {*verdict.get("effects", ()), *verdict.get("noise", ())}
        return said - causes(said)

    @property
    def noise_is_right(self) -> bool:
        return self.noise_said == self.acting - causes(self.acting)

    @property
    def right(self) -> bool:
        """The cause, and the noise beside it."""
        return self.cause_is_right and self.noise_is_right

    @property
    def exact(self) -> bool:
        """The very effects, and nothing beside them."""
        wanted = {UNKNOWN} if self.kind == "unknown" else self.acting
        said = [] if self.announced == ["none"] else [name for key in self.announced for name in key.split("+")]
        return not self.failed and {*said, *self.noise_said} == wanted

    @property
    def says_none(self) -> bool:
        return not self.failed and self.announced == ["none"]

    @cached_property
    def posterior(self) -> dict[str, float]:
        """Of causes, whatever the noise."""
        found: dict[str, float] = {}
        for key, p in (self.answer.get("posterior") or {}).items():
            cause = "+".join(sorted(causes(key.split("+"))))
            found[cause] = found.get(cause, 0.0) + float(p)
        return found

    @property
    def confidence(self) -> float:
        """Probability of what is announced: the whole class where a class is."""
        allowed = {key for key in self.posterior if any(self._same(key, said) for said in self.announced)}
        return min(1.0, sum(self.posterior[key] for key in allowed))

    def _same(self, key: str, said: str) -> bool:
        """Keys that differ only within the true class are one at class level."""
        return key == "+".join(sorted(causes(said.split("+")))) or (self.key_is_true(key) and self.key_is_true(said))

    @property
    def brier(self) -> float:
        """Σ(p − y)² over hypotheses, those that are the truth at class level taken together."""
        truth = sum(p for key, p in self.posterior.items() if self.key_is_true(key))
        return (1 - truth) ** 2 + sum(p**2 for key, p in self.posterior.items() if not self.key_is_true(key))

    @property
    def announced_brier(self) -> float:
        """(p − y)² of what is announced alone: the probability that the calibration is about."""
        return (self.confidence - self.cause_is_right) ** 2

    @property
    def size(self) -> int:
        """Hypotheses in the 95 % set, those that are the truth at class level counting as one."""
        names = {"+".join(sorted(causes(key.split("+")))) for key in self.answer.get("ambiguity_set") or []}
        true = sum(self.key_is_true(key) for key in names)
        return len(names) - max(true - 1, 0)

    @property
    def covered(self) -> bool:
        return any(self.key_is_true(key) for key in self.answer.get("ambiguity_set") or [])

    def place_is_right(self, factors: Mapping[str, Sequence[str]]) -> bool:
        """Whether the top-ranked place is a channel with at least half the largest share of λ, and a factor of a true effect."""
        where = self.answer.get("where") or []
        if not where:
            return False
        channels = np.sum([np.array(e["channels"]) * e["lambda"] for e in self.label["entries"]], axis=0)
        names = self.label["channel_names"]
        top = where[0]
        true = {names[i] for i in np.flatnonzero(channels >= 0.5 * channels.max())}
        wanted = {factor for entry in self.label["entries"] for factor in factors[entry["effect"]]}
        return top["channel"] in true and top["factor"] in wanted


def calibration(
    confidence: Sequence[float] | np.ndarray, correct: Sequence[bool] | np.ndarray, count: int = BINS
) -> dict[str, Any]:
    """Reliability in `count` bins, expected calibration error, and how often a calibrated one would come out larger (4000 draws)."""
    p, y = np.asarray(confidence, float), np.asarray(correct, float)
    if not len(p):
        return {"ece": None, "chance": None, "bins": []}
    number = np.minimum((p * count).astype(int), count - 1)

    def error(outcome: np.ndarray) -> np.ndarray:
        off = np.stack([(outcome - p) @ (number == b) for b in range(count)])
        return np.abs(off).sum(axis=0) / len(p)

    drawn = np.random.default_rng(SEED).random((4000, len(p))) < p
    found = float(error(y))
    bins = [
        {"confidence": float(p[here].mean()), "right": float(y[here].mean()), "n": int(here.sum())}
        for here in (number == b for b in range(count))
        if here.any()
    ]
    return {"ece": found, "chance": float(np.mean(error(drawn) >= found - 1e-12)), "bins": bins}


def score(
    labels: Mapping[str, Mapping], answers: Mapping[str, Mapping], factors: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """All figures for one who answered. Cases without an answer are left out and counted; answers that failed count as wrong."""
    cases = [Scored(labels[name], answers[name]) for name in sorted(labels) if name in answers]
    singles = [c for c in cases if c.kind == "single"]
    pairs = [c for c in cases if c.kind == "pair"]
    none = [c for c in cases if c.kind == "none"]
    foreign = [c for c in cases if c.kind == UNKNOWN]
    apart = [c for c in foreign if not c.lookalikes]
    own = singles + pairs
    wrong = [c for c in none if max(abs(np.log(f)) for f in c.label["noise_factors"]) > 0]
    figures = {
        "cases": len(cases),
        "unanswered": len(labels) - len(cases),
        "failed": sum(c.failed for c in cases),
        "singles": {"right class": _bands(singles, "right"), "exact": _bands(singles, "exact")},
        "by parameter count": _by_parameters(singles),
        "pairs": {
            "right class, each >= 144": rate(c.right for c in pairs if c.weakest >= STRONG),
            "right class, all": rate(c.right for c in pairs),
            "exact, each >= 144": rate(c.exact for c in pairs if c.weakest >= STRONG),
        },
        "false alarm": {
            "all": rate(not c.says_none for c in none),
            "noise declared wrongly": rate(not c.says_none for c in wrong),
        },
        "unknown": {
            "recognised, >= 144": rate(c.right for c in apart if c.weakest >= STRONG),
            "recognised, >= 900": rate(c.right for c in apart if c.weakest >= 900),
            "of the look-alikes, >= 144": rate(c.right for c in foreign if c.lookalikes and c.weakest >= STRONG),
            "called unknown, with the look-alikes, >= 144": rate(c.exact for c in foreign if c.weakest >= STRONG),
            "catalogue called unknown": rate(c.announced == [UNKNOWN] for c in own),
        },
        "place, >= 144": rate(
            c.place_is_right(factors)
            for c in own + foreign
            if c.weakest >= STRONG and "where" in c.answer and all(name in factors for name in c.label["effects"])
        ),
        "outliers": rate(c.right for c in cases if c.label["outliers"]),
        "right, by variety": {
            variety: rate(c.right for c in cases if c.label.get("variety") == variety)
            for variety in dict.fromkeys(str(c.label["variety"]) for c in cases if "variety" in c.label)
        },
        "seconds": _spread([c.answer["seconds"] for c in cases if "seconds" in c.answer]),
    }
    return {**figures, **_probabilities([c for c in cases if c.posterior])}


def _bands(cases: Sequence[Scored], what: str) -> dict[str, Rate]:
    found = {
        name: rate(getattr(c, what) for c in cases if low <= c.weakest < high) for name, (low, high) in BANDS.items()
    }
    return {"all": rate(getattr(c, what) for c in cases), **found}


def _by_parameters(singles: Sequence[Scored]) -> dict[str, Rate]:
    """Right class about λ = 36, where an oracle's ceiling depends on how many parameters an effect has."""
    low, high = BANDS["20-65 (36)"]
    groups = {"1": (1, 1), "2-3": (2, 3), "4-9": (4, 9), "10 and more": (10, 10**6)}
    near = [c for c in singles if low <= c.weakest < high]
    return {
        name: rate(c.right for c in near if least <= len(c.label["entries"][0]["theta"]) <= most)
        for name, (least, most) in groups.items()
    }


def _probabilities(cases: Sequence[Scored]) -> dict[str, Any]:
    """Calibration, Brier score and coverage of those that answer with probabilities."""
    if not cases:
        return {"calibration": None}
    stated = [c for c in cases if c.kind != "mislabelled"]
    confidence, right = [c.confidence for c in stated], [c.cause_is_right for c in stated]
    return {
        "calibration": calibration(confidence, right),
        "calibration of the sentence, in ten bins": calibration(confidence, right, 10),
        "right cause where P >= .99": rate(c.cause_is_right for c in stated if c.confidence >= CERTAIN),
        "right noise beside a cause": rate(
            c.noise_is_right for c in cases if c.noise_said or c.acting - causes(c.acting)
        ),
        "brier": {**_by_strength(cases, "brier"), "of what is announced": _mean(cases, "announced_brier")},
        "95 % set": {"coverage": rate(c.covered for c in cases), "mean size": _by_strength(cases, "size")},
    }


def _mean(cases: Sequence[Scored], what: str) -> float | None:
    return float(np.mean([getattr(c, what) for c in cases])) if cases else None


def _by_strength(cases: Sequence[Scored], what: str) -> dict[str, float | None]:
    """The groups of `tests.blind.ceiling`."""
    return {
        "all": _mean(cases, what),
        "none": _mean([c for c in cases if c.kind == "none"], what),
        "weakest below 36": _mean([c for c in cases if c.kind != "none" and c.weakest < WEAK], what),
        "the rest": _mean([c for c in cases if c.kind != "none" and c.weakest >= WEAK], what),
    }


def closure_against(
    labels: Mapping[str, Mapping], answers: Mapping[str, Mapping], oracle: Mapping[str, Mapping]
) -> dict[str, Any]:
    """Closure ÷ that of an oracle's refit with the true effects, by λ, and how often the 90 % interval holds the oracle's."""
    ratios = {band: list[float]() for band in _BANDS}
    held, unresolved = [], []
    for name in sorted(labels.keys() & answers.keys() & oracle.keys()):
        case, truth = Scored(labels[name], answers[name]), (oracle[name].get("closure") or {}).get("shrinks_by")
        closure = answers[name].get("closure")
        if case.kind not in ("single", "pair") or case.weakest < 36 or not truth or closure is None:
            continue
        resolved = bool(closure.get("resolvable")) and closure.get("shrinks_by") is not None
        unresolved.append(not resolved)
        if resolved:
            ratios[_band(case)].append(closure["shrinks_by"] / truth)
            if closure.get("interval_90"):
                low, high = closure["interval_90"]
                held.append(low <= truth <= high)
    return {
        "ratio": {band: _spread(values) for band, values in ratios.items()},
        "interval holds the oracle's": rate(held),
        "not resolvable": rate(unresolved),
    }


def _band(case: Scored) -> str:
    return _BANDS[0] if case.weakest < 144 else _BANDS[1] if case.weakest < 900 else _BANDS[2]


def closure_held_out(labels: Mapping[str, Mapping], answers: Mapping[str, Mapping]) -> dict[str, Any]:
    """How often the 90 % interval holds the share by which its own predictions shrink the true gap of the held-out segments, where the
    weakest effect has λ of 36 or more, how far the two are apart, and that share ÷ what a refit with the true effects reaches there
    where the closure is resolvable."""
    every = (Scored(labels[name], answers[name]) for name in sorted(labels.keys() & answers.keys()))
    cases = [c for c in every if c.kind in ("single", "pair") and c.weakest >= 36 and not c.failed]
    said = [case.answer["closure"] for case in cases]
    resolved = [closure for closure in said if closure["resolvable"]]
    ratios = {band: list[float]() for band in _BANDS}
    for case, closure in zip(cases, said, strict=True):
        if closure.get("told"):
            ratios[_band(case)].append(closure["true"] / closure["told"])
    by_class: dict[str, list[bool]] = {}
    for case, closure in zip(cases, said, strict=True):
        if closure["resolvable"]:
            name = "pairs" if case.kind == "pair" else str(case.label["entries"][0]["effect"])
            by_class.setdefault(name, []).append(_holds(closure))
    return {
        "ratio to the true effects told": {band: _spread(values) for band, values in ratios.items()},
        "interval holds the truth": rate(map(_holds, resolved)),
        "interval holds the truth, by effect": {name: rate(held) for name, held in sorted(by_class.items())},
        "said less true": _spread([abs(c["shrinks_by"] - c["true"]) for c in resolved]),
        "not resolvable": rate(not closure["resolvable"] for closure in said),
    }


def _holds(closure: Mapping[str, Any]) -> bool:
    low, high = closure["interval_90"]
    return bool(low <= closure["true"] <= high)


def _spread(values: Sequence[float]) -> dict[str, Any]:
    if not len(values):
        return {"n": 0, "mean": None, "median": None, "largest": None}
    v = np.asarray(values, float)
    return {"n": len(v), "mean": float(v.mean()), "median": float(np.median(v)), "largest": float(v.max())}


def plain(figures: Any) -> Any:
    """The figures as JSON has them."""
    if isinstance(figures, Rate):
        return figures.to_json()
    if isinstance(figures, Mapping):
        return {key: plain(value) for key, value in figures.items()}
    return [plain(value) for value in figures] if isinstance(figures, list | tuple) else figures
