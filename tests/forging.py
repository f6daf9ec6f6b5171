"""Run folders, and changes of them as somebody without a key can make them.

The forgeries are made with the standard library only, so that they share no code with what is to find them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from planrunner.archive.run_folder import RunWriter, Witness
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Rest, Segment
from tests.archive.analyses import add_analysis

MACHINERY = {".lock", ".origin"}
"""Files without evidence: the lock, and the mark of the computer."""


def write_run(root: Path, analyses: int = 2, bench: bytes = b"name: bench\n", witness: Witness | None = None) -> Path:
    """A finished run of three segments in an archive. witness: of its journal."""
    rng = np.random.default_rng(5)
    with RunWriter.create(root, "p", b"title: plan\n", bench, {"operator": "A"}, "flushed") as writer:
        writer.witness = witness
        for index in range(3):
            writer.begin(
                Segment(index, f"P{index + 1}", None, "unknown", Rest(), dwell=1.0), float(index), {"x": "deg/s"}
            )
            writer.append(Block(index + np.arange(20) / 20, {"x": rng.normal(size=20)}), index + 1.0)
            writer.acknowledge(index + 1.0, {}, {})
        writer.finish()
    for number in range(analyses):
        add_analysis(writer.path, {"results.json": b'{"x": %d}' % number, "summary.md": b"# x\n"})
    return writer.path


def evidence(run: Path) -> list[Path]:
    return sorted(path for path in run.rglob("*") if path.is_file() and path.name not in MACHINERY)


def lines(run: Path, change: Callable[[list[bytes]], object]) -> None:
    path = run / "journal.jsonl"
    found = path.read_bytes().splitlines(keepends=True)
    change(found)
    path.write_bytes(b"".join(found))


def swap(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


def canonical(value: object) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


def with_digest(value: dict[str, object]) -> bytes:
    """A seal or a list of digests as anyone can write it: the digest in it is no secret."""
    value.pop("digest", None)
    return canonical({**value, "digest": hashlib.sha256(canonical(value)).hexdigest()})


def rechain(run: Path, change: Callable[[list[dict]], object]) -> None:
    """The journal with all its digests computed anew after a change."""
    path = run / "journal.jsonl"
    events = [json.loads(line) for line in path.read_bytes().splitlines()]
    change(events)
    head, out = "0" * 64, b""
    for number, event in enumerate(events, 1):
        text = json.dumps(event | {"seq": number, "previous": head}, separators=(",", ":"), ensure_ascii=False).encode()
        head, out = hashlib.sha256(text).hexdigest(), out + text + b"\n"
    path.write_bytes(out)


def reseal(run: Path, **changed: object) -> None:
    """A new seal for the journal as it is now."""
    seal = json.loads((run / "seal.json").read_bytes())
    data = (run / "journal.jsonl").read_bytes()
    last = data.splitlines()[-1]
    seal["journal"] = {"events": data.count(b"\n"), "head": hashlib.sha256(last).hexdigest()}
    seal["files"]["journal.jsonl"] = hashlib.sha256(data).hexdigest()
    (run / "seal.json").write_bytes(with_digest(seal | changed))


def rewrite(run: Path, change: Callable[[list[dict]], object]) -> None:
    """Journal and seal as someone without a key can write them."""
    rechain(run, change)
    reseal(run)


def flip(path: Path, place: int, bits: int) -> None:
    data = bytearray(path.read_bytes())
    data[place % len(data)] ^= bits
    path.write_bytes(data)
