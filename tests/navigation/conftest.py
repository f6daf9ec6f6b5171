"""Lets the tests of this folder share `increments.py`, and the virtual bench of the tests of instruments."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "instruments")]
