"""Finds the private key of a bench on its computer: a file in the folder of signing keys, or a key that the running ssh-agent
holds.

Runs may end when nobody is present, so the program never asks for the passphrase of such a key. Two arrangements are possible. The
key file may have no passphrase; then only its owner can read it, as for the host keys of SSH. Otherwise, the passphrase is in an
environment variable.
"""

from __future__ import annotations

import sys
from pathlib import Path

from planrunner.archive.origin import OriginUnknownError, state_folder
from planrunner.base.findings import InputError, Mark
from planrunner.base.trusted_folders import UntrustedFolderError, make_private, trusted
from planrunner.signing.keys import (
    PrivateKey,
    PublicKey,
    Signer,
    generate,
    is_encrypted,
    read_private,
    read_public,
    write_unencrypted,
)
from planrunner.signing.passphrase import VARIABLE, of_environment
from planrunner.signing.ssh_agent import AgentKey, holds

FOLDER = "signing-keys"
"""Folder of the signing keys in the user's state folder."""
ENDING = ".pem"


class BenchKeyError(Exception):
    """Reports that the private key of a bench cannot be used. The message gives the reason."""


def keys_folder() -> Path:
    """Returns the folder of the signing keys. Raises `BenchKeyError` if this user has no state folder."""
    try:
        return state_folder() / FOLDER
    except OriginUnknownError as error:
        raise BenchKeyError(str(error)) from None


def bench_signer(public: PublicKey) -> Signer:
    """Returns the private key that belongs to a public key. The private key comes from the folder of signing keys or, if it is not
    there, from the ssh-agent. Nothing is signed, and the user is not asked for anything. Raises `BenchKeyError` if neither the
    folder nor the agent has the key."""
    found, why = _of_files(public)
    if found is not None:
        return found
    if holds(public):
        return AgentKey(public)
    raise BenchKeyError(f"{why}, and no running ssh-agent holds it")


def new_bench_key(name: str) -> tuple[Path, PrivateKey]:
    """Makes a new key without a passphrase in the folder of signing keys. Returns the path of its file, and the key. Raises
    `InputError` if the file cannot be written, and `BenchKeyError` if there is no folder."""
    folder = keys_folder()
    try:
        make_private(folder)
        trusted(folder)
    except (OSError, UntrustedFolderError) as error:
        raise BenchKeyError(f"{folder}: {error}") from None
    path, key = folder / f"{name}{ENDING}", generate()
    public = path.with_name(f"{path.name}.pub")
    if public.exists():
        raise InputError.at(Mark(str(public)), "key-exists", "this file exists already", "choose another name")
    write_unencrypted(path, key)
    return path, key


def _of_files(public: PublicKey) -> tuple[PrivateKey | None, str]:
    """Returns the private key for this public key, from the file next to the `.pub` file; None and the reason if no file can be
    used."""
    folder = keys_folder()
    why = f"it is not in {folder}"
    try:
        names = sorted(path.name for path in trusted(folder).glob(f"*{ENDING}.pub"))
    except FileNotFoundError:
        return None, why
    except (OSError, UntrustedFolderError) as error:
        return None, f"{folder} cannot be used: {error}"
    for name in names:
        try:
            if read_public(folder / name) != public:
                continue
            return _private(folder / name.removesuffix(".pub"), public), ""
        except (InputError, BenchKeyError, OSError) as error:
            why = f"{folder / name}: {reason(error)}"
    return None, why


def _private(path: Path, public: PublicKey) -> PrivateKey:
    if sys.platform != "win32" and path.stat().st_mode & 0o077:
        raise BenchKeyError("other users may read its private key: remove these permissions (chmod 600)")
    encrypted = is_encrypted(path)
    passphrase = of_environment() or None
    if encrypted and passphrase is None:
        raise BenchKeyError(f"its private key has a passphrase, and {VARIABLE} is not set")
    key = read_private(path, passphrase if encrypted else None)
    if key.public != public:
        raise BenchKeyError("its private key belongs to another public key")
    return key


def reason(error: Exception) -> str:
    """States in words why a key or a file cannot be used."""
    if isinstance(error, InputError):
        return error.findings[0].message
    return error.strerror or str(error) if isinstance(error, OSError) else str(error)
