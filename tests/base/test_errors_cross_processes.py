"""Every exception of the package that is raised in another process arrives in this one as it was."""

from __future__ import annotations

import ast
import importlib
import inspect
import pickle
from pathlib import Path

import pytest

from planrunner.base.findings import Finding, InputError, Mark
from tests.conftest import ROOT

_GIVEN = {
    "path": Path("runs/a"),
    "what": "it is a link",
    "kind": "link",
    "message": "it is wrong",
    "hint": "correct it",
    "findings": (Finding(Mark("plan.yaml", 2, 3), "meaning-range", "error", "too large", "use 3"),),
    "code": "quantity-unit",
    "key": "segments",
    "version": 1,
    "known": 3,
    "effect": "gyro_bias",
    "output": "gyro_x",
}
"""Values for the arguments of the exceptions, by their names."""
_STAY = {"CalledOffError", "StoppedAtOnceError", "RefusedRequestError", "EndedError"}
"""They are caught in the process that raises them."""


def exceptions() -> list[type[Exception]]:
    """All exception classes of the package, by the source: the names of their classes end so."""
    found = []
    for path in sorted((ROOT / "planrunner").rglob("*.py")):
        for node in ast.parse(path.read_bytes()).body:
            if isinstance(node, ast.ClassDef) and any(
                ast.unparse(base).endswith(("Error", "Exception")) for base in node.bases
            ):
                module = importlib.import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
                found.append(getattr(module, node.name))
    return [one for one in found if one.__name__ not in _STAY]


@pytest.mark.parametrize("kind", exceptions(), ids=lambda kind: kind.__name__)
def test_an_exception_crosses(kind: type[Exception]) -> None:
    own = "__init__" in vars(kind) or issubclass(kind, InputError)
    names = [*inspect.signature(kind).parameters] if own else ["message"]
    error = kind(*(_GIVEN[name] for name in names))
    there = pickle.loads(pickle.dumps(error))
    assert type(there) is kind and str(there) == str(error) and vars(there) == vars(error)
    if isinstance(error, OSError) and isinstance(there, OSError):
        assert (there.errno, there.strerror, there.filename) == (error.errno, error.strerror, error.filename)
