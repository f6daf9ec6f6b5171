"""A time stamp authority on the loopback for tests: HTTP from the standard library, stamps from `openssl ts`."""

from __future__ import annotations

import subprocess
import threading
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

CONFIGURATION = """[tsa]
default_tsa = here
[here]
serial = {folder}/serial
signer_digest = sha256
default_policy = 1.2.3.4.1
digests = sha256
accuracy = secs:1
ess_cert_id_alg = sha256
"""


class LocalAuthority:
    """down: it answers with an error. count: number of stamps that it gave. ca: file with the certificate of its root."""

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.down, self.count = folder, False, 0
        self.ca = folder / "ca.pem"
        self._make_certificates()
        (folder / "serial").write_text("01\n")
        (folder / "tsa.cnf").write_text(CONFIGURATION.format(folder=folder))
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                query = self.rfile.read(int(self.headers["Content-Length"]))
                if outer.down:
                    self.send_error(503)
                    return
                reply = outer.reply(query)
                self.send_response(200)
                self.send_header("Content-Type", "application/timestamp-reply")
                self.end_headers()
                self.wfile.write(reply)

            def log_message(self, *_: object) -> None:
                pass

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def reply(self, query: bytes) -> bytes:
        self.count += 1
        (self.folder / "query.tsq").write_bytes(query)
        command = ["openssl", "ts", "-reply", "-config", "tsa.cnf", "-section", "here", "-queryfile", "query.tsq"]
        command += ["-signer", "tsa.pem", "-inkey", "tsa.key", "-out", "reply.tsr"]
        subprocess.run(command, cwd=self.folder, check=True, capture_output=True)
        return (self.folder / "reply.tsr").read_bytes()

    def close(self) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def bench_key(self, every: str = "10 min") -> str:
        """The key `time_stamps` of a bench file."""
        pem = "\n".join(f"    {line}" for line in self.ca.read_text().splitlines())
        return f"time_stamps:\n  url: {self.url}\n  every: {every}\n  certificate: |\n{pem}\n"

    def revocations(self, at: datetime, reason: x509.ReasonFlags | None, *, der: bool = False) -> bytes:
        """The list of revoked certificates of the root, in which the authority was revoked at this time."""
        own = x509.load_pem_x509_certificate((self.folder / "tsa.pem").read_bytes())
        entry = x509.RevokedCertificateBuilder().serial_number(own.serial_number).revocation_date(at)
        if reason is not None:
            entry = entry.add_extension(x509.CRLReason(reason), critical=False)
        now = datetime.now(UTC)
        made = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(own.issuer)
            .last_update(now)
            .next_update(now + timedelta(days=30))
            .add_revoked_certificate(entry.build())
            .sign(self._root, hashes.SHA256())
        )
        return made.public_bytes(serialization.Encoding.DER if der else serialization.Encoding.PEM)

    def _make_certificates(self) -> None:
        now = datetime.now(UTC)

        def made(name: str, key: ec.EllipticCurvePrivateKey, by: str, signer: ec.EllipticCurvePrivateKey) -> bytes:
            root = name == by
            builder = (
                x509.CertificateBuilder()
                .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]))
                .issuer_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, by)]))
                .public_key(key.public_key())
                .serial_number(x509.random_serial_number())
                .not_valid_before(now - timedelta(days=1))
                .not_valid_after(now + timedelta(days=3650))
                .add_extension(x509.BasicConstraints(ca=root, path_length=None), critical=True)
                .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
                .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key()), critical=False)
            )
            if not root:
                usage = x509.ExtendedKeyUsage([ExtendedKeyUsageOID.TIME_STAMPING])
                builder = builder.add_extension(usage, critical=True)
            return builder.sign(signer, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)

        root, own = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
        self._root = root
        self.ca.write_bytes(made("Test root", root, "Test root", root))
        (self.folder / "tsa.pem").write_bytes(made("Test authority", own, "Test root", root))
        (self.folder / "tsa.key").write_bytes(
            own.private_bytes(
                serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
            )
        )
