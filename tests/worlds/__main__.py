"""Coverage and warnings of each estimator in each world:

python -m tests.worlds [--runs N] [--seed S] [--estimator NAME] [--world NAME]
"""

from __future__ import annotations

import argparse

import numpy as np

from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import tally
from tests.worlds.faults import WORLDS


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.worlds", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--estimator", default="", help="a part of its name")
    parser.add_argument("--world", default="", help="a part of its name")
    args = parser.parse_args()
    print("| estimator | world | lowest coverage | highest | median error, u | warned | no estimate |")
    print("|---|---|---|---|---|---|---|")
    for estimator, campaign in CAMPAIGNS.items():
        for name, world in WORLDS.items():
            if args.estimator not in estimator or args.world not in name or name in campaign.without:
                continue
            found = tally(campaign, world, args.runs, args.seed)
            made = found.runs - len(found.failed)
            shares = {item: 100 * held / made for item, held in found.held.items()}
            low, high = (choose(shares, key=shares.__getitem__, default="") for choose in (min, max))
            figures = (
                f"{shares[low]:.1f} % ({low}) | {shares[high]:.1f} % | {np.median(found.off[low]):.2g}"
                if made
                else "– | – | –"
            )
            print(
                f"| {estimator} | {name} | {figures} | {100 * found.warned / found.runs:.1f} % | {len(found.failed)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
