"""A page that asks this program for answers: on this machine only, by who holds its token.

Why not a framework: one page and one question need no more than the standard library. Why answers are worked out by
the thread that called `serve`, one at a time: numeric libraries are not all safe to call from several threads, and
Ctrl-C reaches that thread.

It listens on the loopback address alone; whoever doesn't send the token is refused, and so is a page of another name
that points at this machine (DNS rebinding) or another site's script.
"""

from __future__ import annotations

import hmac
import json
import queue
import secrets
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from twin.errors import InputError, TwinError

HOST = "127.0.0.1"
LARGEST_QUESTION = 4096
"""Bytes of the largest question that is read."""

IDLE_S = 30.0
"""A connection that says nothing for so long is closed."""

GUARD = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:"

Answer = Callable[[dict[str, Any]], bytes]
_Job = tuple[dict[str, Any], "queue.SimpleQueue[tuple[int, str, bytes]]"]


def may_listen(port: int) -> None:
    """Ask for a port before the work that goes before the page.

    Raises
    ------
    InputError
        The port can't be had.
    """
    _listening(port).server_close()


def _listening(port: int) -> _Server:
    if not 0 <= port <= 65535:
        raise InputError(f"--port {port}: allowed are whole numbers from 1 to 65535, and 0 for any that is free")
    try:
        return _Server((HOST, port), _Handler)
    except OSError as problem:
        raise InputError(f"--port {port}: can't be listened on ({problem.strerror}); give another") from None


class Loopback:
    """Serves one page at ``/`` and answers questions at ``/ask``.

    Parameters
    ----------
    page
        HTML.
    answer
        From a question (a JSON object) to the bytes of the answer; a `TwinError` it raises is told as a problem.
    port
        To listen on; 0 for any that is free.

    Raises
    ------
    InputError
        The port can't be had.
    """

    def __init__(self, page: str, answer: Answer, port: int = 0) -> None:
        self._answer = answer
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self.token = secrets.token_urlsafe(24)
        self._server = _listening(port)
        self._server.page, self._server.token, self._server.jobs = page.encode(), self.token, self._jobs

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_address[1])

    @property
    def address(self) -> str:
        """What to open in a browser."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def serve(self, count: int | None = None) -> None:
        """Answer until interrupted, or until ``count`` questions are answered."""
        listener = threading.Thread(target=self._server.serve_forever, name="twin-loopback", daemon=True)
        listener.start()
        try:
            while count is None or count > 0:
                question, reply = self._jobs.get()
                reply.put(self._worked_out(question))
                count = None if count is None else count - 1
        finally:
            self._server.shutdown()
            self._server.server_close()

    def _worked_out(self, question: dict[str, Any]) -> tuple[int, str, bytes]:
        try:
            return 200, "application/octet-stream", self._answer(question)
        except TwinError as problem:
            return 422, "application/json", json.dumps({"problem": str(problem)}).encode()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = False
    page: bytes
    token: str
    jobs: queue.SimpleQueue[_Job]

    def handle_error(self, *_: object) -> None:
        """Say nothing of a browser that went away in the middle of an answer."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    timeout = IDLE_S
    server: _Server

    def do_GET(self) -> None:
        if self._refused():
            return
        if urlsplit(self.path).path != "/":
            self._send(404, "text/plain", b"no such page\n")
            return
        self._send(200, "text/html; charset=utf-8", self.server.page)

    def do_POST(self) -> None:
        if self._refused():
            return
        if urlsplit(self.path).path != "/ask":
            self._send(404, "text/plain", b"no such page\n", close=True)
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > LARGEST_QUESTION:
            told = f"a question needs a Content-Length of up to {LARGEST_QUESTION} bytes\n".encode()
            self._send(413, "text/plain", told, close=True)
            return
        try:
            question = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            question = None
        if not isinstance(question, dict):
            self._send(400, "text/plain", b"a question is a JSON object\n", close=True)
            return
        reply: queue.SimpleQueue[tuple[int, str, bytes]] = queue.SimpleQueue()
        self.server.jobs.put((question, reply))
        self._send(*reply.get())

    def _refused(self) -> bool:
        """Refuse who doesn't hold the token, and pages that are not ours."""
        given = parse_qs(urlsplit(self.path).query).get("token", [""])[0]
        ours = {f"{name}:{self.server.server_address[1]}" for name in (HOST, "localhost")}
        origin = self.headers.get("Origin")
        if (
            hmac.compare_digest(given.encode(), self.server.token.encode())
            and self.headers.get("Host") in ours
            and (origin is None or origin.removeprefix("http://") in ours)
        ):
            return False
        self._send(403, "text/plain", b"refused: open the address that twin printed, with its token\n", close=True)
        return True

    def _send(self, code: int, kind: str, body: bytes, *, close: bool = False) -> None:
        self.send_response(code)
        for name, value in (
            ("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store"),
            ("Content-Security-Policy", GUARD), ("Referrer-Policy", "no-referrer"),
            ("X-Content-Type-Options", "nosniff"), ("X-Frame-Options", "DENY"),
        ):  # fmt: skip
            self.send_header(name, value)
        if close:
            self.send_header("Connection", "close")
            self.close_connection = True
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        """Name no versions."""
        return "twin"

    def log_message(self, *_: object) -> None:
        """Print nothing: the address with its token must not end in a log."""
