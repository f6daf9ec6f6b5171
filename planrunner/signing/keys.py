"""Handles Ed25519 keys (RFC 8032): private keys in files with a passphrase, public keys as lines in OpenSSH format.

Ed25519 is the only algorithm, so that nobody can choose a weaker algorithm for a signature. A public key is written as in
`~/.ssh/id_ed25519.pub` and is named by its fingerprint, as `ssh-keygen -l` shows it.
"""

from __future__ import annotations

import base64
import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from planrunner.base.findings import InputError, Mark
from planrunner.base.regular_files import RefusedFileError, read_regular
from planrunner.plan.source import refused_input

ALGORITHM = "ssh-ed25519"
MOST_BYTES = 2**14
"""Maximum size in bytes of a file with a key."""
FEWEST_LETTERS = 8
"""Minimum length of a passphrase."""


@dataclass(frozen=True, slots=True)
class PublicKey:
    """An Ed25519 public key. `raw`: the 32 bytes of the key (RFC 8032, 5.1.5)."""

    raw: bytes

    @property
    def blob(self) -> bytes:
        """Returns the key in the form in which SSH transmits it (RFC 8709, section 4)."""
        return _text(ALGORITHM.encode()) + _text(self.raw)

    @property
    def fingerprint(self) -> str:
        """Returns the fingerprint as `ssh-keygen -l` shows it: SHA-256 of the blob in base64 without padding."""
        return "SHA256:" + base64.b64encode(hashlib.sha256(self.blob).digest()).decode().rstrip("=")

    @property
    def line(self) -> str:
        """Returns the key as a line in OpenSSH format, without a comment."""
        return f"{ALGORITHM} {base64.b64encode(self.blob).decode()}"

    def signed(self, signature: bytes, message: bytes) -> bool:
        """Returns True if a signature of a message was made with this key."""
        try:
            Ed25519PublicKey.from_public_bytes(self.raw).verify(signature, message)
        except (InvalidSignature, ValueError):
            return False
        return True


class Signer(Protocol):
    """Makes signatures with one private key."""

    @property
    def public(self) -> PublicKey: ...

    def sign(self, message: bytes) -> bytes:
        """Returns the 64 bytes of the Ed25519 signature."""
        ...


@dataclass(frozen=True, slots=True)
class PrivateKey:
    """A private key in memory."""

    _key: Ed25519PrivateKey = field(repr=False)

    @property
    def public(self) -> PublicKey:
        raw = self._key.public_key().public_bytes(serialization.Encoding.Raw, serialization.PublicFormat.Raw)
        return PublicKey(raw)

    def sign(self, message: bytes) -> bytes:
        return self._key.sign(message)

    def pem(self, passphrase: bytes | None) -> bytes:
        """Returns the key as PKCS #8 PEM; encrypted if a passphrase is given."""
        encryption = (
            serialization.NoEncryption() if passphrase is None else serialization.BestAvailableEncryption(passphrase)
        )
        return self._key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, encryption)


def generate() -> PrivateKey:
    """Makes a new key from random numbers of the operating system."""
    return PrivateKey(Ed25519PrivateKey.generate())


def write_private(path: Path, key: PrivateKey, passphrase: bytes) -> None:
    """Writes a private key to a new file that only its owner may read. Raises `InputError` if the file exists or cannot be written."""
    if len(passphrase) < FEWEST_LETTERS:
        message = f"the passphrase has fewer than {FEWEST_LETTERS} characters"
        raise InputError.at(Mark(str(path)), "key-passphrase", message, "choose a longer passphrase")
    _write_new(path, key.pem(passphrase))


def write_unencrypted(path: Path, key: PrivateKey) -> None:
    """Writes a private key without a passphrase to a new file that only its owner may read, for a bench that signs when nobody is
    present. Raises `InputError` like `write_private`."""
    _write_new(path, key.pem(None))


def _write_new(path: Path, data: bytes) -> None:
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
        except BaseException:
            path.unlink(missing_ok=True)
            raise
    except FileExistsError:
        hint = "choose another name: a key is never overwritten"
        raise InputError.at(Mark(str(path)), "key-exists", "this file exists already", hint) from None
    except OSError as error:
        message = f"the key cannot be written: {error.strerror or error}"
        raise InputError.at(Mark(str(path)), "file-unwritable", message, "choose another folder") from None


def is_encrypted(path: Path) -> bool:
    """Returns True if the file contains a private key that needs a passphrase. Raises `InputError` if the file cannot be read."""
    try:
        _load(_read(path), None)
    except TypeError:
        return True
    except (ValueError, UnsupportedAlgorithm):  # no key: `read_private` says so
        pass
    return False


def read_private(path: Path, passphrase: bytes | None) -> PrivateKey:
    """Reads a private key in PEM (PKCS #8) or in the format of OpenSSH. Raises `InputError` if the key cannot be read, if the
    passphrase is missing or wrong, or if the key is not an Ed25519 key."""
    data = _read(path)
    try:
        key = _load(data, passphrase or None)
    except TypeError:
        needs = "this key needs a passphrase" if not passphrase else "this key has no passphrase"
        hint = "keep private keys encrypted; `planrunner key new` makes one"
        raise InputError.at(Mark(str(path)), "key-passphrase", needs, hint) from None
    except UnsupportedAlgorithm as error:
        message = f"this private key cannot be read: {error}"
        hint = "give --agent if the ssh-agent holds it; OpenSSH keys with a passphrase need the package bcrypt"
        raise InputError.at(Mark(str(path)), "key-unreadable", message, hint) from None
    except ValueError:
        message = "this private key cannot be read, or the passphrase is wrong"
        raise InputError.at(Mark(str(path)), "key-unreadable", message, "check the file and the passphrase") from None
    if not isinstance(key, Ed25519PrivateKey):
        message = "this is not an Ed25519 key"
        raise InputError.at(Mark(str(path)), "key-algorithm", message, "make one with `planrunner key new`")
    return PrivateKey(key)


def _load(data: bytes, passphrase: bytes | None) -> object:
    """Loads a private key. Raises TypeError if a passphrase is missing, or is given although none is needed. Raises ValueError or
    UnsupportedAlgorithm for other data that cannot be used."""
    if data.startswith(b"-----BEGIN OPENSSH PRIVATE KEY-----"):
        return serialization.load_ssh_private_key(data, passphrase)
    return serialization.load_pem_private_key(data, passphrase)


def read_public(path: Path) -> PublicKey:
    """Reads the public key in a file of OpenSSH. Raises `InputError` if the file contains no Ed25519 public key."""
    data = _read(path)
    try:
        return parse_public(data.decode("ascii"))
    except ValueError as error:
        hint = "give a file such as id_ed25519.pub, or one that `planrunner key show` printed"
        raise InputError.at(Mark(str(path)), "key-unreadable", str(error), hint) from None


def parse_public(line: str) -> PublicKey:
    """Reads the public key in a line `ssh-ed25519 AAAA… comment`. Raises ValueError for any other text."""
    words = line.split(None, 2)
    if len(words) < 2 or words[0] != ALGORITHM or "\n" in line.strip():
        raise ValueError(f"this is not a public key of the form `{ALGORITHM} AAAA…`")
    try:
        blob = base64.b64decode(words[1], validate=True)
    except ValueError:
        raise ValueError("the public key is not in base64") from None
    key = PublicKey(blob[-32:])
    if blob != key.blob:
        raise ValueError("this is not an Ed25519 public key")
    if bytes([*key.raw[:-1], key.raw[-1] & 0x7F]) in _OF_SMALL_ORDER:
        raise ValueError("this public key is weak: anybody can make signatures that match it")
    return key


_OF_SMALL_ORDER = frozenset(
    bytes.fromhex(text)
    for text in (
        "00" * 32,
        "01" + "00" * 31,
        "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
        "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
        "ec" + "ff" * 30 + "7f",
        "ed" + "ff" * 30 + "7f",
        "ee" + "ff" * 30 + "7f",
    )
)
"""Encodings of the points of order 1, 2, 4 and 8, without the sign bit. These points are refused as public keys, although RFC 8032
does not exclude them."""


def _read(path: Path) -> bytes:
    try:
        return read_regular(path, MOST_BYTES)
    except RefusedFileError as refused:
        raise refused_input(refused, str(path)) from None


def _text(data: bytes) -> bytes:
    """Encodes bytes in the SSH format `string` (RFC 4251, section 5)."""
    return len(data).to_bytes(4, "big") + data
