"""Files on web servers, in ranges: every answer is checked, one that breaks off is resumed."""

from __future__ import annotations

import asyncio
import re
from contextlib import asynccontextmanager
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, BinaryIO

import aiohttp
from fsspec import filesystem
from fsspec.asyn import sync
from fsspec.config import conf

from imucalib_cli.logs.remote.store import CHANGED, NoRangesError, RemoteError
from imucalib_cli.logs.remote.url import protocol_of

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Sequence

    from imucalib_cli.logs.remote.store import Received, Span, Traffic

CONNECT_S, SILENCE_S, REQUEST_S = 10.0, 30.0, 300.0
"""s: time-outs of connecting, of waiting for the next byte, and of one request for a range."""
TRIES = 4
"""Of each range; a further try continues where the last one ended."""
PAUSE_S = 0.5
"""s before the second try; doubled before each further one."""
_RANGE = re.compile(r"bytes (?:(\d+)-\d+|\*)/(\d+)")
_BUSY = {HTTPStatus.REQUEST_TIMEOUT, HTTPStatus.TOO_MANY_REQUESTS}
_DENIED = {HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN}
_GONE = {HTTPStatus.NOT_FOUND, HTTPStatus.GONE}


class _BusyError(Exception):
    """The server may answer later."""


_FINAL: dict[type[Exception], str] = {
    aiohttp.ClientConnectorCertificateError: (
        "cannot be read: the server's certificate is not valid: check URL and SSL_CERT_FILE"
    ),
    aiohttp.ClientSSLError: (
        "cannot be read: the server does not speak TLS there: check the port, or use http://"
    ),
    aiohttp.ClientConnectorDNSError: (
        "cannot be read: there is no such host: check its name and the network"
    ),
    aiohttp.ClientConnectorError: (
        "cannot be read: the server cannot be reached: check host, port and network"
    ),
    aiohttp.InvalidURL: "is not a valid URL: check it",
    aiohttp.TooManyRedirects: ("cannot be read: the server redirects without end: check the URL"),
}
"""Errors that another try does not solve; subclasses come first."""
_PASSING: dict[type[Exception], str] = {
    aiohttp.ConnectionTimeoutError: f"the server did not answer within {CONNECT_S:g} s",
    aiohttp.ServerTimeoutError: f"the server sent nothing for {SILENCE_S:g} s",
    asyncio.TimeoutError: f"a request took longer than {REQUEST_S:g} s",
    _BusyError: "the server answers {}",
    aiohttp.ClientError: "the connection broke off",
}
"""Errors that may pass; subclasses come first."""


class HttpStore:
    """As :class:`~imucalib_cli.logs.remote.store.AnyStore`; the size is known after a request.

    fsspec brings the session and its configuration by the user; proxies come from the environment.
    """

    def __init__(self, address: str, traffic: Traffic) -> None:
        protocol = protocol_of(address)
        client = {"trust_env": True, **conf.get(protocol, {}).get("client_kwargs", {})}
        self._fs: Any = filesystem(
            protocol, client_kwargs=client, encoded="%" in address, skip_instance_cache=True
        )
        try:
            self._url = self._fs.encode_url(address)
        except ValueError:
            raise RemoteError("is not a valid URL: check it") from None
        self._traffic = traffic
        self.size: int | None = None
        self.version = ""

    def fetch(self, spans: Sequence[Span], received: Received) -> list[bytes]:
        """See :class:`~imucalib_cli.logs.remote.store.AnyStore`."""
        found: list[bytes] = sync(self._fs.loop, self._ranges, spans, received)
        return found

    def copy_to(self, target: BinaryIO, received: Received) -> None:
        """See :class:`~imucalib_cli.logs.remote.store.AnyStore`."""
        sync(self._fs.loop, self._repeat, lambda: self._whole(target, received))

    def check_unchanged(self) -> None:
        """Nothing: every answer has been compared with the first."""

    async def _ranges(self, spans: Sequence[Span], received: Received) -> list[bytes]:
        tasks = [asyncio.ensure_future(self._range(*span, received)) for span in spans]
        try:
            return await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()

    async def _range(self, start: int, stop: int, received: Received) -> bytes:
        data = bytearray()
        await self._repeat(lambda: self._take(start, stop, data, received))
        return bytes(data)

    async def _repeat(self, once: Callable[[], Awaitable[None]]) -> None:
        """Try a request some times; RemoteError if it fails for good, or every time."""
        reason = ""
        for number in range(TRIES):
            if number:
                self._traffic.repeats += 1
                await asyncio.sleep(PAUSE_S * 2 ** (number - 1))
            try:
                return await once()
            except (*_FINAL, *_PASSING) as error:
                if final := _words(error, _FINAL):
                    raise RemoteError(final) from None
                reason = _words(error, _PASSING)
        raise RemoteError(f"cannot be read: {reason}, {TRIES} times in a row: try again later")

    async def _take(self, start: int, stop: int, data: bytearray, received: Received) -> None:
        """Append the missing bytes of a range."""
        start += len(data)
        headers = {"Range": f"bytes={start}-{stop - 1}"}
        async with self._answer(headers, REQUEST_S) as answer:
            left = min(stop, self._check_range(answer, start)) - start
            if left <= 0:  # of an empty file
                return
            async for block in answer.content.iter_any():
                data += block
                left -= len(block)
                self._traffic.count(len(block), received)
                if left <= 0:  # even if the server promised more
                    break
        if left < 0:
            raise RemoteError("cannot be read: the server sends more than it was asked for")
        if left:
            raise aiohttp.ClientPayloadError

    async def _whole(self, target: BinaryIO, received: Received) -> None:
        received(-target.tell())  # bytes of a request that broke off
        target.seek(0)
        target.truncate()
        async with self._answer({}, None) as answer:
            _check_found(answer)
            self.size = answer.content_length
            self.version = _version(answer)
            async for block in answer.content.iter_any():
                target.write(block)
                self._traffic.count(len(block), received)

    @asynccontextmanager
    async def _answer(
        self, headers: dict[str, str], seconds: float | None
    ) -> AsyncIterator[aiohttp.ClientResponse]:
        self._traffic.requests += 1
        session = await self._fs.set_session()
        own = self._fs.kwargs
        # a compressed answer has no ranges
        headers = {**own.get("headers", {}), "Accept-Encoding": "identity", **headers}
        timeout = aiohttp.ClientTimeout(total=seconds, sock_connect=CONNECT_S, sock_read=SILENCE_S)
        given = {**own, "headers": headers, "timeout": timeout}
        async with session.get(self._url, **given) as answer:
            yield answer

    def _check_range(self, answer: aiohttp.ClientResponse, start: int) -> int:
        """Check that an answer holds the range from ``start`` on; return the size of the file.

        Raises:
            NoRangesError: It is the whole file.
            RemoteError, _BusyError: There is no such file, or it is another one by now.
        """
        if answer.status != HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE:
            _check_found(answer)
        found = _RANGE.fullmatch(answer.headers.get("Content-Range", ""))
        is_plain = answer.headers.get("Content-Encoding", "identity") == "identity"
        if answer.status == HTTPStatus.OK or found is None or not is_plain:
            self.size = answer.content_length if is_plain else None
            raise NoRangesError
        size, version = int(found[2]), _version(answer)
        if self.size is None:
            self.size, self.version = size, version
        if (size, version) != (self.size, self.version):
            raise RemoteError(CHANGED)
        if int(found[1] or size) != start:
            raise RemoteError("cannot be read: the server sends other bytes than it was asked for")
        return size


def _check_found(answer: aiohttp.ClientResponse) -> None:
    """Check that the server sends the file; RemoteError or _BusyError if it does not."""
    said = f"{answer.status} {answer.reason or ''}".strip()
    if answer.status in _GONE:
        raise RemoteError(f"does not exist ({said}): check the URL")
    if answer.status in _DENIED:
        raise RemoteError(
            f"may not be read ({said}): check the URL, and whether its password or signature "
            "still holds"
        )
    if answer.status in _BUSY or answer.status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        raise _BusyError(said)
    if answer.status not in {HTTPStatus.OK, HTTPStatus.PARTIAL_CONTENT}:
        raise RemoteError(f"cannot be read: the server answers {said}: check the URL")


def _version(answer: aiohttp.ClientResponse) -> str:
    headers = answer.headers
    return headers.get("ETag") or headers.get("Last-Modified") or ""


def _words(error: Exception, known: dict[type[Exception], str]) -> str:
    """Words for an error; never its own text, which may hold the URL with its secrets."""
    said = next((words for kind, words in known.items() if isinstance(error, kind)), "")
    return said.format(error) if isinstance(error, _BusyError) else said
