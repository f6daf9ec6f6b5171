"""The key `signing` of a bench: the key that signs the seal and the analyses of its runs."""

from __future__ import annotations

from planrunner.plan.kinds import Record, Text, key


class SigningSpec(Record):
    """The bench's own key. The bench file has its public part only."""

    key: str = key(
        Text(r"ssh-ed25519 [A-Za-z0-9+/=]{20,200}( [^\x00-\x1f]{0,200})?", "a public key of OpenSSH"),
        "Public key of the bench, as `planrunner key new --for-bench` prints it. The private key stays on the computer of the bench.",
        "ssh-ed25519 AAAAC3NzaC1lZDI1NTE5AAAAIGLkQmCXDi/PQZJZziZo7k97osN1kINhk5QiG1kpfDFm",
    )
