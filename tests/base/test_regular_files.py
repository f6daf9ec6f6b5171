"""Files that somebody else named: only regular ones within their bound are opened, and nothing makes the program wait."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from planrunner.base import regular_files
from planrunner.base.findings import InputError
from planrunner.base.regular_files import RefusedFileError, open_regular, read_regular
from planrunner.plan import source

posix = pytest.mark.skipif(os.name == "nt", reason="pipes and devices as files are of POSIX systems")


def kind_of(path: Path, limit: int = 100, *, links: bool = True) -> str:
    with pytest.raises(RefusedFileError) as caught:
        read_regular(path, limit, links=links)
    assert str(caught.value)
    assert caught.value.hint
    return caught.value.kind


def test_a_regular_file_is_read_up_to_its_bound(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 100)
    assert read_regular(path, 100) == b"x" * 100
    assert kind_of(path, 99) == "size"


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    assert kind_of(tmp_path) == "folder"
    assert kind_of(tmp_path / "none") == "missing"
    (tmp_path / "file").write_text("x")
    assert kind_of(tmp_path / "file" / "beneath") == "unreadable"
    assert kind_of(tmp_path / "null\0character") == "unreadable"


@posix
def test_pipes_devices_and_sockets_are_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert kind_of(tmp_path / "pipe") == "special"
    assert kind_of(Path("/dev/zero")) == "special"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "s"))
        assert kind_of(tmp_path / "s") == "special"


@posix
def test_a_file_exchanged_for_a_pipe_between_look_and_opening_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    seen = os.stat(tmp_path / "file")
    monkeypatch.setattr(os, "stat", lambda *_, **__: seen)
    assert kind_of(tmp_path / "pipe") == "special"


@posix
def test_links_are_followed_only_where_that_is_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "nowhere").symlink_to("none")
    assert read_regular(tmp_path / "link", 10) == b"x"
    assert kind_of(tmp_path / "nowhere") == "missing"
    assert kind_of(tmp_path / "link", links=False) == "link"
    seen = os.stat(tmp_path / "file")
    monkeypatch.setattr(os, "stat", lambda *_, **__: seen)  # exchanged for a link after the look
    assert kind_of(tmp_path / "link", links=False) == "unreadable"


def test_a_sparse_file_is_refused_by_its_size_and_one_that_grows_by_what_it_gives(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(3_000_000_000)
    assert kind_of(tmp_path / "sparse", 1_000_000) == "size"
    path = tmp_path / "growing"
    path.write_bytes(b"x" * 10)
    with open_regular(path, 10) as file:
        path.write_bytes(b"x" * 20)
        with pytest.raises(RefusedFileError) as caught:
            regular_files.read_bounded(file, 10)
    assert caught.value.kind == "size"


@pytest.mark.skipif(os.open not in os.supports_dir_fd, reason="no opening relative to a folder")
def test_a_file_is_found_relative_to_an_open_folder(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    folder = os.open(tmp_path, os.O_RDONLY)
    try:
        assert read_regular("file", 10, folder=folder, links=False) == b"x"
    finally:
        os.close(folder)


@posix
def test_the_finding_on_a_plan_that_is_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "plan.yaml")
    with pytest.raises(InputError) as caught:
        source.read_bytes(tmp_path / "plan.yaml")
    assert caught.value.findings[0].code == "file-special"
