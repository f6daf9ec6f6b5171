"""Folders that somebody else could change: found along the whole path, whoever owns what and wherever links lead."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from planrunner.base.trusted_folders import UntrustedFolderError, make_private, this_user, trusted, trusted_within

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="owners and modes are POSIX")
SOMEBODY = 54321


def foreign(path: Path) -> int:
    """Give a path to another user where we may, and return the user to look at it as; else become another user ourselves."""
    if os.geteuid() == 0:
        os.chown(path, SOMEBODY, SOMEBODY, follow_symlinks=False)
        return 0
    return os.geteuid() + 1


def test_a_folder_of_ones_own_in_a_sticky_one_is_trusted(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    own = shared / "a" / "b"
    make_private(own)
    assert trusted(own) == own and own.stat().st_mode & 0o777 == 0o700 == own.parent.stat().st_mode & 0o777
    assert trusted(shared) == shared


@pytest.mark.parametrize("depth", [0, 1, 2])
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o757])
def test_a_folder_that_others_may_write_to_anywhere_on_the_path_is_not(tmp_path: Path, depth: int, mode: int) -> None:
    path = tmp_path / "x" / "y" / "z"
    make_private(path)
    assert trusted(path) == path
    path.parents[depth - 1].chmod(mode) if depth else path.chmod(mode)
    with pytest.raises(UntrustedFolderError, match="others may write to"):
        trusted(path)


@pytest.mark.parametrize("depth", [0, 1])
def test_a_folder_of_another_users_is_not(tmp_path: Path, depth: int) -> None:
    path = tmp_path / "x" / "y"
    make_private(path)
    user = foreign(path.parents[depth - 1] if depth else path)
    with pytest.raises(UntrustedFolderError, match="belongs to another user"):
        trusted(path, user)


def test_links_are_followed_and_held_to_the_same_rule(tmp_path: Path) -> None:
    """The folder behind a link counts, and all above it; so does who made the link."""
    private, opened = tmp_path / "private", tmp_path / "open"
    make_private(private / "kept")
    make_private(opened / "kept")
    opened.chmod(0o777)
    (private / "to").symlink_to(Path("..") / "private" / "kept")
    assert trusted(private / "to") == private / "kept"
    (private / "out").symlink_to(opened / "kept")
    with pytest.raises(UntrustedFolderError, match=r"others may write to .*open"):
        trusted(private / "out")
    user = foreign(private / "to")
    with pytest.raises(UntrustedFolderError, match="belongs to another user"):
        trusted(private / "to", user)
    (private / "round").symlink_to(private / "round")
    with pytest.raises(UntrustedFolderError, match="endless chain"):
        trusted(private / "round")


def test_what_is_no_folder_is_an_error_of_the_system(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    with pytest.raises(NotADirectoryError):
        trusted(tmp_path / "file")
    with pytest.raises(FileNotFoundError):
        trusted(tmp_path / "none")


@pytest.mark.parametrize("fault", ["link", "pipe", "open file", "open folder", "another user's"])
def test_everything_within_is_held_to_the_rule(tmp_path: Path, fault: str) -> None:
    folder = tmp_path / "kept"
    (folder / "kernels").mkdir(parents=True)
    (folder / "kernels" / "index").write_text("", encoding="utf-8")
    folder.chmod(0o755)
    trusted_within(folder)
    bad, user = folder / "kernels" / "bad", this_user()
    if fault == "link":
        bad.symlink_to(tmp_path)
    elif fault == "pipe":
        os.mkfifo(bad)
    elif fault == "open folder":
        bad.mkdir()
        bad.chmod(0o777)
    else:
        bad.write_text("", encoding="utf-8")
        bad.chmod(0o666 if fault == "open file" else 0o600)
        user = foreign(bad) if fault == "another user's" else user
    with pytest.raises(UntrustedFolderError):
        trusted_within(folder, user)


def test_what_others_cannot_reach_may_have_any_mode(tmp_path: Path) -> None:
    """As a mask without restrictions makes it."""
    folder = tmp_path / "kept"
    make_private(folder)
    (folder / "index").write_text("", encoding="utf-8")
    (folder / "index").chmod(0o666)
    trusted_within(folder)
