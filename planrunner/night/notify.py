"""Sends notifications at the end of a night: JSON to a webhook, or an e-mail. Secrets come from environment variables only."""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping
from email.message import EmailMessage

from planrunner.base.documents import JsonObject
from planrunner.night.suite import Notification
from planrunner.night.summary import headline, summary

PATIENCE = 30.0
"""Time within which a server must answer, s."""
SIGNATURE = "X-Planrunner-Signature"


class NotificationError(Exception):
    """Reports that a notification could not be sent. The message gives the reason; it contains no secret."""


def receiver(entry: Notification) -> str:
    """Describes the receiver of a notification without secrets."""
    if entry.webhook_from is not None:
        return f"the address in {entry.webhook_from}"
    return entry.webhook or ", ".join(entry.email)


def wanted(entry: Notification, exit_code: int) -> bool:
    return entry.when == "always" or exit_code != 0


def send(entry: Notification, night: JsonObject, environment: Mapping[str, str]) -> None:
    """Sends one notification. Raises `NotificationError` if the notification cannot be sent."""
    if entry.email:
        _mail(entry, night, environment)
    else:
        _post(entry, night, environment)


def _post(entry: Notification, night: JsonObject, environment: Mapping[str, str]) -> None:
    import http.client
    from urllib.error import URLError
    from urllib.request import HTTPRedirectHandler, Request, build_opener

    class NoRedirect(HTTPRedirectHandler):
        """Refuses redirects, because a redirect could send the summary to another host."""

        def redirect_request(self, *_: object) -> None:
            return None

    address = entry.webhook or _from(environment, entry.webhook_from)
    if not address.startswith(("http://", "https://")):
        raise NotificationError("the address does not begin with http:// or https://")
    body = json.dumps({"text": headline(night), "summary": summary(night), "night": night}, ensure_ascii=False).encode()
    headers = {"Content-Type": "application/json; charset=utf-8", "User-Agent": "planrunner"}
    if entry.secret_from is not None:
        key = _from(environment, entry.secret_from).encode()
        headers[SIGNATURE] = "sha256=" + hmac.new(key, body, hashlib.sha256).hexdigest()
    try:
        with build_opener(NoRedirect).open(Request(address, body, headers), timeout=PATIENCE):
            pass
    except URLError as error:
        raise NotificationError(f"the server did not accept it: {error.reason}") from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise NotificationError(
            f"{type(error).__name__}: the server cannot be reached or gave no valid answer"
        ) from None


def _mail(entry: Notification, night: JsonObject, environment: Mapping[str, str]) -> None:
    import smtplib
    import ssl

    message = EmailMessage()
    message["From"], message["To"] = entry.sender or "", ", ".join(entry.email)
    message["Subject"] = " ".join(headline(night).split())
    message.set_content(summary(night))
    host, _, port = entry.server.partition(":")
    try:
        if entry.security == "tls":
            server: smtplib.SMTP = smtplib.SMTP_SSL(host, int(port or 465), timeout=PATIENCE)
        else:
            server = smtplib.SMTP(host, int(port or 25), timeout=PATIENCE)
        with server:
            if entry.security == "starttls":
                server.starttls(context=ssl.create_default_context())
            if entry.user is not None:
                server.login(entry.user, _from(environment, entry.password_from))
            server.send_message(message)
    except (OSError, smtplib.SMTPException) as error:
        raise NotificationError(f"{entry.server}: {type(error).__name__}: {error}") from None


def _from(environment: Mapping[str, str], name: str | None) -> str:
    value = environment.get(name or "", "")
    if not value:
        raise NotificationError(f"the environment variable {name} is not set")
    return value
