"""`python -m tests.real_sets`: runs all real sets and writes their table into docs/real-recordings.md."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from tests.real_sets.running import Found, found
from tests.real_sets.sets import SETS, RealSet
from tests.real_sets.table import BEGIN, END, markdown, rows

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("PLANRUNNER_DATA", ROOT.parent / "shared" / "data"))
PAGE = ROOT / "docs" / "real-recordings.md"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.real_sets", description=__doc__)
    parser.add_argument("words", nargs="*", help="only sets whose title or first file contains one of these words")
    parser.add_argument("--data", type=Path, default=DATA, help="the folder of the recordings")
    args = parser.parse_args()
    done: list[tuple[RealSet, Found]] = []
    for one in SETS:
        if args.words and not any(word in one.title or word in one.files[0] for word in args.words):
            continue
        done.append((one, found(one, args.data)))
        for row in rows(*done[-1]):
            print(one.title, *row, sep=" | ", flush=True)
    if not args.words:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
        after = rest.partition(END)[2]
        PAGE.write_text(f"{before}{BEGIN}\n\n{markdown(done)}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
