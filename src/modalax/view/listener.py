"""Requests of a browser on the loopback interface, answered by a page.

The address holds a random port and a token. A request without the token, for another host name (a page elsewhere whose
name was made to lead here) or from another origin is refused.
"""

import json
import secrets
from collections.abc import Mapping
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol, runtime_checkable
from urllib.parse import urlsplit

from modalax.files.json_text import plain

LARGEST = 100_000  # bytes of a request; the page sends some hundred
RULES = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)


@runtime_checkable
class Page(Protocol):
    """What is served: files by name, and answers to messages."""

    def file(self, name: str) -> tuple[bytes, str] | None:
        """A file and its type; None where there is none."""
        ...

    def answer(self, name: str, asked: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a message; ``ValueError``, ``OSError`` or ``ImportError`` where there is none."""
        ...


class Listener(ThreadingHTTPServer):
    """A page at a random port of 127.0.0.1, for those who know a token of 256 random bits."""

    daemon_threads = True

    def __init__(self, page: Page):
        super().__init__(("127.0.0.1", 0), Handler)
        self.page = page
        self.token = secrets.token_urlsafe(32)

    @property
    def hosts(self) -> tuple[str, str]:
        """Names by which a request may ask for this machine."""
        return f"127.0.0.1:{self.server_port}", f"localhost:{self.server_port}"

    def allowed(self, path: str, headers: Message) -> str | None:
        """What a request asks for, after the token; None where it has no right to ask."""
        parts = urlsplit(path).path.split("/", 2)
        if len(parts) < 3 or not secrets.compare_digest(parts[1].encode(), self.token.encode()):
            return None
        origin = headers.get("Origin")
        if headers.get("Host") not in self.hosts or origin not in (None, *(f"http://{h}" for h in self.hosts)):
            return None
        return parts[2]


class Handler(BaseHTTPRequestHandler):
    """Files of the page by GET, messages as JSON by POST."""

    server: Listener
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "modalax", ""
    timeout = 60

    def do_GET(self) -> None:
        """Send a file."""
        name = self.server.allowed(self.path, self.headers)
        found = None if name is None else self.server.page.file(name)
        if name is None:
            self._send(403, b"refused", "text/plain")
        elif found is None:
            self._send(404, b"there is no such file", "text/plain")
        else:
            self._send(200, *found)

    def do_POST(self) -> None:
        """Answer a message."""
        name = self.server.allowed(self.path, self.headers)
        length = self.headers.get("Content-Length", "")
        if name is None or not length.isdecimal() or int(length) > LARGEST:
            self.close_connection = True
            self._send(403 if name is None else 413, b"refused", "text/plain")
            return
        status, value = self._answered(name, self.rfile.read(int(length)))
        self._send(status, json.dumps(plain(value), allow_nan=False).encode(), "application/json")

    def _answered(self, name: str, body: bytes) -> tuple[int, dict[str, Any]]:
        try:
            asked = json.loads(body or b"{}")
            if not isinstance(asked, dict):
                raise ValueError("a message is an object")
            return 200, self.server.page.answer(name, asked)
        except (ValueError, OSError, ImportError) as error:
            return 422, {"error": " ".join(str(error).split())}
        except Exception as error:  # a fault of the program: the page tells it, and the view goes on
            return 500, {"error": f"{type(error).__name__}: {error}"}

    def _send(self, status: int, body: bytes, kind: str) -> None:
        self.send_response(status)
        for key, value in (
            ("Content-Type", f"{kind}; charset=utf-8"), ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"), ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"), ("Content-Security-Policy", RULES),
        ):  # fmt: skip
            self.send_header(key, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Requests are not logged: their addresses hold the token."""
