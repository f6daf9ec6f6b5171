"""Signs with an Ed25519 key of a running ssh-agent (draft-ietf-sshm-ssh-agent, sections 3.5 and 3.6). The private key stays in the
agent."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass

from planrunner.base.findings import COMMAND_LINE, InputError
from planrunner.signing.keys import ALGORITHM, PublicKey

LIST_REQUEST, LIST_RESPONSE = 11, 12
SIGN_REQUEST, SIGN_RESPONSE = 13, 14
MOST_BYTES = 2**18
PATIENCE = 120.0
"""Maximum time in seconds for a signature; the user may have to confirm the use of the key."""
LISTING = 10.0
"""Maximum time in seconds for a list of keys."""


@dataclass(frozen=True, slots=True)
class AgentKey:
    """A key that the agent at SSH_AUTH_SOCK has."""

    public: PublicKey

    def sign(self, message: bytes) -> bytes:
        """Returns the 64 bytes of the signature. Raises `InputError` if the agent cannot be reached or refuses to sign."""
        reply = _answer(bytes([SIGN_REQUEST]) + _string(self.public.blob) + _string(message) + bytes(4), PATIENCE)
        expected = bytes([SIGN_RESPONSE]) + _string(_string(ALGORITHM.encode()) + _string(bytes(64)))
        signature = reply[-64:]
        if len(reply) != len(expected) or reply[:-64] != expected[:-64] or not self.public.signed(signature, message):
            hint = "add the key with ssh-add; `ssh-add -l` lists the keys"
            raise InputError.at(COMMAND_LINE, "key-agent", "the ssh-agent did not sign with this key", hint)
        return signature


def holds(key: PublicKey) -> bool:
    """Returns True if the agent at SSH_AUTH_SOCK has this key in its list (section 3.5). The function does not request a
    signature."""
    try:
        reply = _answer(bytes([LIST_REQUEST]), LISTING)
    except InputError:
        return False
    return reply[:1] == bytes([LIST_RESPONSE]) and key.blob in _listed(reply[5:])


def _listed(data: bytes) -> Iterator[bytes]:
    """Yields the keys in the agent's list, in which keys and comments alternate."""
    strings = []
    while len(data) >= 4:
        size = int.from_bytes(data[:4], "big")
        strings.append(data[4 : 4 + size])
        data = data[4 + size :]
    yield from strings[::2]


def _answer(request: bytes, patience: float) -> bytes:
    """Returns the reply of the agent, without the length that precedes it; empty if the reply is too long. Raises `InputError` if
    no agent is running or the agent does not answer. `patience`: the longest time to wait, s."""
    path = os.environ.get("SSH_AUTH_SOCK", "")
    if not path or sys.platform == "win32":
        hint = "start ssh-agent and add the key with ssh-add"
        raise InputError.at(COMMAND_LINE, "key-agent", "no ssh-agent is running (SSH_AUTH_SOCK)", hint)
    try:
        with socket.socket(socket.AF_UNIX) as agent:
            agent.settimeout(patience)
            agent.connect(path)
            agent.sendall(_string(request))
            size = int.from_bytes(_exactly(agent, 4), "big")
            return _exactly(agent, size) if 0 < size <= MOST_BYTES else b""
    except OSError as error:
        message = f"the ssh-agent does not answer: {error.strerror or error}"
        raise InputError.at(COMMAND_LINE, "key-agent", message, "check SSH_AUTH_SOCK") from None


def _exactly(agent: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = agent.recv(size - len(data))
        if not more:
            raise OSError("it closed the connection")
        data += more
    return data


def _string(data: bytes) -> bytes:
    return len(data).to_bytes(4, "big") + data
