"""`planrunner bench`: the shipped benches and the installed instrument drivers."""

from __future__ import annotations

import argparse

from planrunner import cli, plugins
from planrunner.bench.model import read_bench, shipped_benches


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=["list"], help="list: benches and drivers")


def run(args: argparse.Namespace) -> int:
    print("Shipped benches (use with --bench NAME, or `bench: NAME` in a plan):")
    for name in shipped_benches():
        bench, _, _ = read_bench(name)
        print(f"  {name:<24} {' '.join((bench.description or bench.name).split())}")
    print("Instrument drivers (`driver: NAME` in a bench file):")
    for name in plugins.names(plugins.INSTRUMENTS):
        driver = plugins.load(plugins.INSTRUMENTS, name)
        about = (driver.__doc__ or driver.__name__).strip().partition("\n")[0]
        print(f"  {name:<24} {driver.role}: {about}")
    return cli.DONE
