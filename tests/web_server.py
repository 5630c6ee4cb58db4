"""A web server with faults that can be switched on, and counts of what it sent."""

import base64
import re
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

_BLOCK = 1 << 16


@dataclass
class Behaviour:
    """Of all answers; the defaults are those of a good server."""

    ranges: bool = True
    no_ranges_after: int | None = None
    """Requests behind which there are no ranges any more."""
    status: int = 0
    """In place of the file; 0 for the file."""
    fails: int = 1 << 30
    """How many of the requests behind the first ``sound`` get this status, or break off."""
    sound: int = 0
    """Requests that are answered well before that."""
    break_after: int | None = None
    """Bytes of a body behind which the connection is closed."""
    silent_after: int | None = None
    """Bytes of a body behind which nothing comes any more."""
    seconds_per_request: float = 0.0
    seconds_per_block: float = 0.0
    """Of 64 KiB."""
    more_claimed: int = 0
    """Bytes that Content-Length says too many, or too few."""
    other_start: int = 0
    """Bytes by which a range is not where it was asked for."""
    changes_after: int | None = None
    """Requests behind which the file is another one."""
    no_version: bool = False
    asks_for: str = ""
    """user:password."""
    redirect_to: str = ""
    certificate: tuple[Path, Path] | None = None
    """Of HTTPS, and its key."""


@dataclass
class WebServer:
    """Serves the files of a folder."""

    folder: Path
    behaviour: Behaviour = field(default_factory=Behaviour)
    sent: int = 0
    """Bytes of bodies."""
    asked: list[tuple[str, str]] = field(default_factory=list)
    """Path with query, and the range, of each request."""
    address: str = ""

    def url(self, name: str, user: str = "") -> str:
        return f"http://{user}{'@' if user else ''}{self.address}/{name}"


@contextmanager
def serving(folder: Path, **behaviour: Any) -> Iterator[WebServer]:
    """A server for the time of a test."""
    served = WebServer(folder, Behaviour(**behaviour))
    stopped = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            _answer(self, served, stopped)

        def log_message(self, *_: object) -> None: ...

    class Server(ThreadingHTTPServer):
        daemon_threads = True

        def handle_error(self, *_: object) -> None:
            """A client that closes its connection is no fault."""

    server = Server(("127.0.0.1", 0), Handler)
    if served.behaviour.certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*served.behaviour.certificate)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    served.address = f"127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield served
    finally:
        stopped.set()
        server.shutdown()
        thread.join()
        server.server_close()


def _answer(handler: BaseHTTPRequestHandler, served: WebServer, stopped: threading.Event) -> None:
    how = served.behaviour
    asked = handler.headers.get("Range", "")
    served.asked.append((handler.path, asked))
    number = len(served.asked)
    fails = how.sound < number <= how.sound + how.fails
    expected = f"Basic {base64.b64encode(how.asks_for.encode()).decode()}"
    path = served.folder / unquote(urlsplit(handler.path).path).lstrip("/")
    status = how.status if fails else 0
    if how.asks_for and handler.headers.get("Authorization") != expected:
        status = 401
    elif not path.is_file():
        status = 404
    if how.redirect_to:
        _begin(handler, 302, {"Location": how.redirect_to}, 0)
        return
    if status:
        _begin(handler, status, {}, 6)
        handler.wfile.write(b"sorry\n")
        return
    time.sleep(how.seconds_per_request)
    size = path.stat().st_size
    start, stop, status, headers = 0, size, 200, {}
    found = re.fullmatch(r"bytes=(\d+)-(\d+)", asked)
    has_ranges = how.ranges and (how.no_ranges_after is None or number <= how.no_ranges_after)
    if found and has_ranges:
        start, stop = int(found[1]), min(int(found[2]) + 1, size)
        if start >= size:
            _begin(handler, 416, {"Content-Range": f"bytes */{size}"}, 0)
            return
        status = 206
        headers["Content-Range"] = f"bytes {start + how.other_start}-{stop - 1}/{size}"
    if not how.no_version:
        is_old = how.changes_after is None or number <= how.changes_after
        headers["ETag"] = '"first"' if is_old else '"second"'
    _begin(handler, status, headers, stop - start + how.more_claimed)
    try:
        _send(handler, served, path, (start, stop), stopped, fails=fails)
    except OSError:  # the client has had enough
        handler.close_connection = True
    if how.more_claimed:
        handler.close_connection = True


def _begin(
    handler: BaseHTTPRequestHandler, status: int, headers: dict[str, str], size: int
) -> None:
    handler.send_response(status)
    for name, value in {**headers, "Content-Length": str(size)}.items():
        handler.send_header(name, value)
    handler.end_headers()


def _send(
    handler: BaseHTTPRequestHandler,
    served: WebServer,
    path: Path,
    span: tuple[int, int],
    stopped: threading.Event,
    *,
    fails: bool,
) -> None:
    how = served.behaviour
    start, stop = span
    limits = [each for each in (how.break_after, how.silent_after) if each is not None and fails]
    end = min([stop, *(start + limit for limit in limits)])
    with path.open("rb") as file:
        file.seek(start)
        while start < end:
            data = file.read(min(_BLOCK, end - start))
            handler.wfile.write(data)
            start += len(data)
            served.sent += len(data)
            time.sleep(how.seconds_per_block)
    if end < stop:
        if how.silent_after is not None:
            stopped.wait()
        handler.close_connection = True
