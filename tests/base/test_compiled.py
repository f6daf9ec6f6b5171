"""Compiled code is kept only where nobody else can plant any: what is read there is executed."""

from __future__ import annotations

import importlib.metadata
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from planrunner.base.compiled import KEPT, cache_folder
from planrunner.base.trusted_folders import UntrustedFolderError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="owners and modes are POSIX")
KERNEL = """\
from planrunner.base.compiled import compiled
@compiled()
def doubled(x):
    return 2 * x
assert doubled(21) == 42
print(sum(doubled.stats.cache_hits.values()))
"""


class Planted:
    """A pickle that makes a folder when it is read."""

    def __init__(self, mark: Path):
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[[str], None], tuple[str]]:
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize("variable", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_a_folder_of_ones_own_is_made_for_the_user_alone(tmp_path: Path, variable: str) -> None:
    folder = cache_folder({variable: str(tmp_path / "cache")})
    assert folder == tmp_path / "cache" / KEPT
    assert folder.stat().st_mode & 0o777 == 0o700


def test_the_users_own_cache_folder_without_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder({}) == tmp_path / ".cache" / KEPT


@pytest.mark.parametrize("opened", ["", "cache", "cache/planrunner", "cache/planrunner/compiled"])
def test_no_code_is_kept_where_others_may_write(tmp_path: Path, opened: str) -> None:
    asked = {"NUMBA_CACHE_DIR": str(tmp_path / "base" / "cache")}
    assert cache_folder(asked)
    (tmp_path / "base" / opened).chmod(0o777)
    with pytest.raises(UntrustedFolderError):
        cache_folder(asked)


def test_no_code_is_read_that_somebody_else_could_have_written(tmp_path: Path) -> None:
    asked = {"NUMBA_CACHE_DIR": str(tmp_path)}
    folder = cache_folder(asked)
    assert folder is not None
    (folder / "kernels").mkdir()
    (folder / "kernels" / "x.nbi").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(UntrustedFolderError):
        cache_folder(asked)


def test_where_no_folder_can_be_made_nothing_is_kept(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert cache_folder({"NUMBA_CACHE_DIR": str(tmp_path / "file")}) is None


@pytest.mark.slow
def test_a_planted_file_is_not_run(tmp_path: Path) -> None:
    """In a folder of one's own it would be: that shows that the planted file is one which works."""
    (tmp_path / "kernel.py").write_text(KERNEL, encoding="utf-8")

    def ran(folder: Path) -> str:
        """How often kept code was used; nothing where the process failed."""
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
        command = [sys.executable, str(tmp_path / "kernel.py")]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False).stdout.strip()

    def planted(folder: Path) -> bool:
        """Whether what is planted in the index of the kept code is run."""
        mark = tmp_path / f"ran-from-{folder.name}"
        version = importlib.metadata.version("numba")  # which numba compares before it reads on
        next(folder.rglob("*.nbi")).write_bytes(pickle.dumps(version) + pickle.dumps(Planted(mark)))
        ran(folder)
        return mark.exists()

    own, shared = tmp_path / "own", tmp_path / "shared"
    assert (ran(own), ran(own), ran(shared)) == ("0", "1", "0")
    assert planted(own)
    shared.chmod(0o777)
    assert not planted(shared)
    assert ran(shared) == "0"
