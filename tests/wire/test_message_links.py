"""A link to an instrument that misbehaves: every failure is told in words, in time, and never spoils the next exchange."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from scripted import Listener, answering, closed_port, messages, silent_at_first

from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.wire import links
from planrunner.instruments.wire.links import LinkSettings, MessageLink
from planrunner.instruments.wire.replies import number, numbers, written

TIMEOUT = 0.5  # s, where no answer comes within it
PATIENT = 60.0  # s, where one comes, which a busy machine may delay
HANGS = 60.0  # s; a busy machine is late by seconds, a link that waits for ever is not back by then


@contextmanager
def link_to(address: str, tries: int = 1, timeout: float = PATIENT) -> Iterator[MessageLink]:
    link = MessageLink(LinkSettings(address, timeout, tries=tries))
    try:
        yield link
    finally:
        link.close()


def echo(message: str) -> bytes:
    """Answers questions only."""
    if not message.endswith("?"):
        return b""
    return f"{message} heard\n".encode()


@pytest.fixture
def sent(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """To be set by the instrument when it has begun to answer: reading, and its time-out, begin then, however late that is."""
    begun = threading.Event()
    byte = links.Incoming._byte

    def after_the_first(incoming: links.Incoming) -> None:
        if not incoming.got:
            assert begun.wait(HANGS)
            incoming.deadline = time.monotonic() + TIMEOUT
        byte(incoming)

    monkeypatch.setattr(links.Incoming, "_byte", after_the_first)
    return begun


def fails(link: MessageLink, why: str) -> None:
    with pytest.raises(InstrumentError, match=why):
        link.query("A?")


def test_what_is_asked_is_answered() -> None:
    with answering(echo) as server, link_to(server.address) as link:
        assert link.query("A?") == "A? heard"
        link.write("SET 1")
        assert link.query("B?", after=["SET 2", "SET 3"]) == "B? heard"
        assert server.connections == 1


def test_a_refused_port_is_reported_with_what_to_look_at() -> None:
    with (
        closed_port() as port,
        link_to(f"TCPIP::127.0.0.1::{port}::SOCKET") as link,
        pytest.raises(
            InstrumentError,
            match=rf"^TCPIP::127.0.0.1::{port}::SOCKET, when asked 'A\?', refuses the connection: check that the",
        ),
    ):
        link.query("A?")


def test_silence_ends_with_the_time_out() -> None:
    with answering(lambda message: b"") as server, link_to(server.address, timeout=TIMEOUT) as link:
        start = time.monotonic()
        fails(link, rf"did not answer within {TIMEOUT} s")
        assert TIMEOUT < time.monotonic() - start < HANGS


def test_a_clock_that_is_set_back_meanwhile_prolongs_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    true_time, begun = time.time, time.monotonic()
    monkeypatch.setattr(time, "time", lambda: true_time() - 1000.0 * (time.monotonic() - begun > TIMEOUT / 2))
    with answering(lambda message: b"") as server, link_to(server.address, timeout=TIMEOUT) as link:
        fails(link, rf"did not answer within {TIMEOUT} s")
        assert time.monotonic() - begun < HANGS


def test_a_late_answer_is_never_taken_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    next_asked, late_sent = threading.Event(), threading.Event()

    def talk(connection: socket.socket) -> None:
        for message in messages(connection, b"\n"):
            if message == "SLOW?":
                next_asked.wait(HANGS)
                late_sent.set()
            else:
                next_asked.set()
                late_sent.wait(HANGS)
            connection.sendall(echo(message))

    with Listener(talk) as server, link_to(server.address) as link:
        silent_at_first(link, monkeypatch)
        with pytest.raises(InstrumentError, match="did not answer"):
            link.query("SLOW?")
        for _ in range(5):
            assert link.query("NEXT?") == "NEXT? heard"
        assert server.connections == 2


def test_after_an_answer_that_was_no_number_nothing_late_is_taken_for_the_next() -> None:
    """Somebody else's answer came first: the right one is still on its way."""
    next_asked = threading.Event()

    def talk(connection: socket.socket) -> None:
        for message in messages(connection, b"\n"):
            if message == "ANGLE?":
                connection.sendall(b"done\n")
                next_asked.wait(HANGS)
                connection.sendall(b"70\n")
            else:
                next_asked.set()
                connection.sendall(b"0\n")

    with Listener(talk) as server, link_to(server.address) as link:
        with pytest.raises(InstrumentError, match="'done', but a number is expected"):
            number(link, "ANGLE?")
        assert number(link, "RATE?") == 0


def test_an_answer_that_stops_half_way_is_shown(sent: threading.Event) -> None:
    def talk(connection: socket.socket) -> None:
        for _ in messages(connection, b"\n"):
            connection.sendall(b"12.3")
            sent.set()

    with Listener(talk) as server, link_to(server.address, timeout=TIMEOUT) as link:
        fails(link, r"stopped in the middle of its answer \('12?.?3?' so far\)")


def test_an_answer_that_drips_does_not_hold_longer_than_the_time_out(sent: threading.Event) -> None:
    def talk(connection: socket.socket) -> None:
        for _ in messages(connection, b"\n"):
            while True:
                connection.sendall(b"1")
                sent.set()
                time.sleep(TIMEOUT / 4)

    with Listener(talk) as server, link_to(server.address, timeout=TIMEOUT) as link:
        start = time.monotonic()
        fails(link, "stopped in the middle")
        assert time.monotonic() - start < HANGS


def test_an_answer_without_end_is_cut_off() -> None:
    with answering(lambda message: b"x" * 100_000) as server, link_to(server.address) as link:
        fails(link, "sends continuously")


def test_a_flood_before_the_question_is_reported() -> None:
    def talk(connection: socket.socket) -> None:
        connection.sendall(b"x" * 100_000)
        for message in messages(connection, b"\n"):
            connection.sendall(echo(message))

    with Listener(talk) as server, link_to(server.address) as link:
        fails(link, r"sends (data without a request|continuously)")


@pytest.mark.parametrize("garbage", [b"\xff\xfe\x00\x9a\n", b"\x00\x01\n"])
def test_garbage_is_shown_as_bytes(garbage: bytes) -> None:
    with answering(lambda message: garbage) as server, link_to(server.address) as link:
        fails(link, r"which is not text: check that it is the instrument")


def test_a_peer_that_hangs_up_in_its_answer(sent: threading.Event) -> None:
    def talk(connection: socket.socket) -> None:
        for _ in messages(connection, b"\n"):
            connection.sendall(b"12.")
            sent.set()
            return

    with Listener(talk) as server, link_to(server.address, timeout=TIMEOUT) as link:
        start = time.monotonic()
        fails(link, r"stopped in the middle of its answer \('12?.?' so far\)|closed")
        assert time.monotonic() - start < HANGS


def test_what_comes_unasked_is_dropped_and_reported() -> None:
    with answering(lambda message: echo(message) + b"77\n") as server, link_to(server.address) as link:
        assert link.query("A?") == "A? heard"
        assert link.query("B?") == "B? heard"
        assert link.remarks() == [f"{server.address} sent '77\\n' without a request; this text was discarded"]
        assert link.remarks() == []


def test_a_question_is_asked_again_once_and_that_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    hung_up: list[str] = []

    def answer(message: str) -> bytes | None:
        if not hung_up:
            hung_up.append(message)
            return None
        return echo(message)

    with answering(answer) as server, link_to(server.address, tries=2) as link:
        silent_at_first(link, monkeypatch)
        assert link.query("A?") == "A? heard"
        (remark,) = link.remarks()
        assert remark.endswith("'A?' is sent again")


def test_what_changes_the_instrument_is_not_sent_again() -> None:
    heard: list[str] = []

    def answer(message: str) -> bytes:
        heard.append(message)
        return b""

    with answering(answer) as server, link_to(server.address, tries=3, timeout=TIMEOUT) as link:
        with pytest.raises(InstrumentError):
            link.query("STATUS?", after=["MOVE 10"])
        with pytest.raises(InstrumentError):
            link.query("POP?", again=False)
    assert heard == ["MOVE 10", "STATUS?", "POP?"]


def test_threads_on_two_links_to_one_resource_do_not_mix_their_answers() -> None:
    answers: list[tuple[str, str]] = []

    with answering(echo) as server, link_to(server.address) as one, link_to(server.address) as other:

        def ask(name: str) -> None:
            for count in range(25):
                question = f"{name}{count}?"
                for link in (one, other):
                    answers.append((question, link.query(question)))

        threads = [threading.Thread(target=ask, args=(name,)) for name in "abcd"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len(answers) == 4 * 25 * 2
    assert all(answer == f"{question} heard" for question, answer in answers)


def test_an_interrupted_question_does_not_leave_its_answer_to_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    next_asked = threading.Event()

    def talk(connection: socket.socket) -> None:
        for message in messages(connection, b"\n"):
            if message == "SLOW?":
                next_asked.wait(HANGS)
            else:
                next_asked.set()
            connection.sendall(echo(message))

    def interrupted(self: links.Incoming) -> None:
        raise KeyboardInterrupt

    with Listener(talk) as server, link_to(server.address) as link:
        with monkeypatch.context() as patched:
            patched.setattr(links.Incoming, "_byte", interrupted)
            with pytest.raises(KeyboardInterrupt):
                link.query("SLOW?")
        assert link.query("NEXT?") == "NEXT? heard"


@contextmanager
def serial_line(talk: Callable[[int], None]) -> Iterator[str]:
    tty = pytest.importorskip("tty", reason="this system has no pseudo-terminals")
    near, far = os.openpty()
    tty.setraw(far)
    thread = threading.Thread(target=talk, args=(near,), daemon=True)
    thread.start()
    try:
        yield f"ASRL{os.ttyname(far)}::INSTR"
    finally:
        os.close(far)
        thread.join(2)
        os.close(near)


def test_a_late_answer_on_a_serial_line_is_waited_out(monkeypatch: pytest.MonkeyPatch) -> None:
    listening, late_sent = threading.Event(), threading.Event()
    await_silence = MessageLink._await_silence

    def talk(near: int) -> None:
        try:
            while data := os.read(near, 100):
                if data == b"SLOW?\n":
                    listening.wait(HANGS)
                os.write(near, data.strip() + b" heard\n")
                if data == b"SLOW?\n":
                    late_sent.set()
        except OSError:
            return

    def while_it_comes(link: MessageLink, resource: Any) -> None:
        listening.set()
        assert late_sent.wait(HANGS)
        resource.timeout = round(1000 * TIMEOUT)
        await_silence(link, resource)

    with serial_line(talk) as address, link_to(address) as link:
        assert link.query("A?") == "A? heard"
        silent_at_first(link, monkeypatch)
        with pytest.raises(InstrumentError, match="did not answer"):
            link.query("SLOW?")
        monkeypatch.setattr(MessageLink, "_await_silence", while_it_comes)
        assert link.query("NEXT?") == "NEXT? heard"


def test_a_serial_line_loses_no_answer_between_many_questions() -> None:
    """A port that is set up anew between question and answer may lose the answer."""

    def talk(near: int) -> None:
        try:
            while data := os.read(near, 100):
                os.write(near, data.strip() + b" heard\n")
        except OSError:
            return

    with serial_line(talk) as address, link_to(address, tries=2) as link:
        assert {link.query("A?") for _ in range(300)} == {"A? heard"}
        assert link.remarks() == []


def test_a_serial_port_that_is_not_there() -> None:
    with link_to("ASRL/dev/no-such-port::INSTR") as link:
        fails(link, r"cannot be reached \(.*No such file or directory")


def test_numbers_out_of_replies() -> None:
    replies = {"GOOD?": b"1.5;-2,3e1\n", "WORDS?": b"hello\n", "FEW?": b"1\n", "NAN?": b"nan\n", "INF?": b"1e999\n"}
    with answering(lambda message: replies[message]) as server, link_to(server.address) as link:
        assert numbers(link, "GOOD?", 3) == [1.5, -2.0, 30.0]
        for question in ("WORDS?", "NAN?", "INF?"):
            with pytest.raises(InstrumentError, match=r"but a number is expected: check that it is the instrument"):
                number(link, question)
        with pytest.raises(InstrumentError, match=r"answers 'FEW\?' with '1', but 2 numbers are expected"):
            numbers(link, "FEW?", 2)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (1e-9, "0"),
        (-1e-9, "0"),
        (100.0, "100"),
        (0.2, "0.2"),
        (1e6, "1000000"),
        (-12.3456789, "-12.345679"),
    ],
)
def test_numbers_into_commands_have_no_exponent(value: float, text: str) -> None:
    assert written(value) == text
