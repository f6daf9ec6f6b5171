"""Exit codes: 0 done, 1 a limit failed or the data do not give an estimate, 2 the input is wrong, 3 a fault during execution, 4 a
file was changed or damaged, 130 ended by a signal.
"""

from __future__ import annotations

from planrunner.base.interruption import INTERRUPTED as INTERRUPTED

DONE, LIMIT_FAILED, WRONG_INPUT, FAULT, INTEGRITY = 0, 1, 2, 3, 4
