"""Logs behind URLs: the same as on disk, in ranges, whatever the server does."""

import errno
import gc
import os
import pickle
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from msgspec.structs import asdict

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.logs.log import LogData, open_log
from imucalib_cli.logs.remote import http
from imucalib_cli.logs.remote.file import RemoteFile, in_bytes, path_or_url
from imucalib_cli.logs.remote.store import NoRangesError
from imucalib_cli.logs.remote.url import file_name, is_url
from imucalib_cli.shown import without_secrets
from tests.logs.logs_remote import wanted_bytes, with_images
from tests.logs.logs_samples import BAGS, MCAPS, Said, Write, mixed_messages, said_on, write_log
from tests.web_server import WebServer, serving

SAMPLES = Path(__file__).parents[2] / "sample_data"
TOPICS = ("/imu/data", "/joint_states")
WANTED = ("/imu", "/joint_states")
"""Beside images."""


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Waiting times are short."""
    monkeypatch.setattr(http, "PAUSE_S", 0.01)


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without images."""
    return write_log(tmp_path_factory.mktemp("plain") / "log.mcap", said_on(), "mcap-none")


@pytest.fixture(scope="module")
def images(plain: Path) -> Path:
    """38 MB, of which one is wanted."""
    return with_images(plain, plain.parent / "images.mcap", size=37 << 20, image_bytes=1 << 20)


def read(path: Path | RemoteFile, *, scan: bool = False, progress: Any = None) -> LogData:
    log = open_log([path], scan_remote=scan)
    return log.read([topic.name for topic in log.topics if topic.kinds], progress)


@cache
def local() -> LogData:
    """What the sample of :func:`rihibot` is on disk."""
    return read(SAMPLES / "rihibot.mcap")


def assert_same(data: LogData, expected: LogData) -> None:
    def fields_of(each: LogData) -> dict[str, Any]:
        several = {**each.joints, **each.poses}
        groups = {topic: [asdict(one) for one in streams] for topic, streams in several.items()}
        return {**groups, **{topic: asdict(imu) for topic, imu in each.imus.items()}}

    np.testing.assert_equal(fields_of(data), fields_of(expected))
    codes = [[finding.code for finding in each.findings] for each in (data, expected)]
    assert codes[0] == codes[1]


def refused(url: str, *, scan: bool = False) -> str:
    """The error for a file that cannot be read: one line, without secrets."""
    with pytest.raises(ImucalibError) as caught:
        read(RemoteFile(url), scan=scan)
    said = str(caught.value)
    assert "\n" not in said
    assert said.startswith(without_secrets(url))
    assert said.count(": ") >= 1
    return said.removeprefix(without_secrets(url)).strip()


@contextmanager
def rihibot(**behaviour: Any) -> Iterator[tuple[WebServer, RemoteFile]]:
    with serving(SAMPLES, **behaviour) as web:
        yield web, RemoteFile(web.url("rihibot.mcap"))


@pytest.mark.parametrize("storage", [*BAGS, *MCAPS])
def test_remote_file_reads_like_local_file(
    messages: list[Said], storage: str, written: Write
) -> None:
    path = written(messages, storage)
    with serving(path.parent) as web:
        remote = RemoteFile(web.url(path.name))
        assert_same(read(remote), read(path))
        assert remote.traffic.bytes == web.sent
        assert remote.traffic.requests == len(web.asked)
        assert open_log([remote]).topics == open_log([path]).topics


def test_only_wanted_chunks_are_read(images: Path) -> None:
    with serving(images.parent) as web:
        remote = RemoteFile(web.url(images.name))
        log = open_log([remote])
        size = images.stat().st_size
        assert len(web.asked) <= 6  # head, summary, and the index of the first and last chunks
        assert web.asked[1][1] == f"bytes={size - (1 << 16) - size // 4096}-{size - 1}"
        data = log.read(WANTED)
        assert_same(data, open_log([images]).read(WANTED))
        assert web.sent == remote.traffic.bytes
        assert web.sent <= 1.2 * wanted_bytes(images, WANTED)
        spans = [re.findall(r"\d+", each) for _, each in web.asked]
        assert max(int(stop) - int(start) for start, stop in spans) < 1 << 22


def test_unwanted_messages_in_large_plain_chunks_are_not_read(plain: Path, tmp_path: Path) -> None:
    shares: list[float] = []
    path = tmp_path / "log.mcap"
    with_images(plain, path, size=8 << 20, image_bytes=1 << 20, apart=False)
    with serving(tmp_path) as web:
        log = open_log([RemoteFile(web.url("log.mcap"))])
        assert_same(log.read(WANTED, shares.append), open_log([path]).read(WANTED))
        assert web.sent < wanted_bytes(path, WANTED) - (3 << 20)  # of images that share a chunk
        assert shares == sorted(shares)
        assert shares[-1] == 1.0
        assert_same(log.read(["/imu"]), open_log([path]).read(["/imu"]))


def test_damaged_index_of_large_plain_chunk_loses_no_message(plain: Path, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with_images(plain, path, size=4 << 20, image_bytes=1 << 20, apart=False)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    inner = summary.chunk_indexes[1:-1]
    large = next(each for each in inner if each.chunk_length > 1 << 20)
    content = bytearray(path.read_bytes())
    content[min(large.message_index_offsets.values())] ^= 0xFF
    path.write_bytes(content)
    with serving(tmp_path) as web:
        assert_same(read(RemoteFile(web.url("log.mcap"))), read(path))


def test_long_summary_needs_one_more_read(messages: list[Said], written: Write) -> None:
    path = written(messages[:1000], "mcap-none", chunk_bytes=1)
    with serving(path.parent) as web:
        remote = RemoteFile(web.url(path.name))
        assert open_log([remote]).topics == open_log([path]).topics
        size = path.stat().st_size
        starts = [int(re.findall(r"\d+", each)[0]) for _, each in web.asked]
        assert starts[2] < starts[1] == size - (1 << 16) - size // 4096


# Servers at fault


def test_server_without_ranges_is_downloaded_if_allowed() -> None:
    shares: list[float] = []
    with rihibot(ranges=False) as (_, remote):
        log = open_log([remote], scan_remote=True, progress=shares.append)
        copy = remote.copy
        assert copy is not None
        assert copy.read_bytes() == (SAMPLES / "rihibot.mcap").read_bytes()
        assert_same(log.read(TOPICS), open_log([SAMPLES / "rihibot.mcap"]).read(TOPICS))
        assert str(log.paths[0]) == str(remote)
        del log, remote
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    gc.collect()
    assert not copy.parent.exists()


@pytest.mark.parametrize("ranges", [True, False])
def test_interrupted_transfer_is_resumed(*, ranges: bool) -> None:
    with rihibot(break_after=10_000, fails=3, sound=1, ranges=ranges) as (web, remote):
        assert_same(read(remote, scan=True), local())
        assert remote.traffic.repeats == 3
        if ranges:  # nothing is read twice
            expected = RemoteFile(web.url("rihibot.mcap"))
            web.behaviour.fails = 0
            read(expected)
            assert remote.traffic.bytes == expected.traffic.bytes


def test_repeatedly_interrupted_download_leaves_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with rihibot(break_after=100, ranges=False, sound=1) as (_, remote):
        assert "broke off, 4 times" in refused(remote.address, scan=True)
    assert list(tmp_path.iterdir()) == []


def test_a_slow_server_shows_progress() -> None:
    shares: list[float] = []
    with rihibot(seconds_per_block=0.005) as (_, remote):
        read(remote, progress=shares.append)
    assert shares == sorted(shares)
    assert len(set(shares)) > 10
    assert shares[-1] == 1.0


@pytest.mark.parametrize(
    ("behaviour", "words"),
    [
        (
            {"break_after": 100, "sound": 1},
            "cannot be read: the connection broke off, 4 times in a row: try again later",
        ),
        (
            {"silent_after": 1000, "sound": 1},
            "cannot be read: the server sent nothing for 30 s, 4 times in a row: ",
        ),
        ({"seconds_per_block": 10.0, "sound": 1}, "cannot be read: a request took longer than 300"),
        ({"status": 404}, "does not exist (404 Not Found): check the URL"),
        ({"status": 410}, "does not exist (410 Gone): check the URL"),
        ({"status": 403}, "may not be read (403 Forbidden): check the URL, and whether its"),
        ({"asks_for": "robot:secret"}, "may not be read (401 Unauthorized): check the URL"),
        ({"status": 400}, "cannot be read: the server answers 400 Bad Request: check the URL"),
        (
            {"status": 503},
            "cannot be read: the server answers 503 Service Unavailable, 4 times in a row",
        ),
        ({"redirect_to": "/rihibot.mcap"}, "cannot be read: the server redirects without end"),
        ({"no_ranges_after": 1}, "cannot be read: its server sent parts of it at first, and now"),
        ({"no_ranges_after": 7}, "cannot be read: its server sent parts of it at first, and now"),
        ({"changes_after": 3}, "changed while it was read: try again when nothing writes"),
        ({"other_start": 5}, "cannot be read: the server sends other bytes than it was asked for"),
    ],
)
def test_server_errors_are_one_line(
    behaviour: dict[str, Any], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(http, "REQUEST_S" if "seconds_per_block" in behaviour else "SILENCE_S", 0.1)
    with rihibot(**behaviour) as (web, remote):
        assert refused(remote.address).startswith(words)
        if "times in a row" in words and "sound" in behaviour:
            assert len(web.asked) == 1 + http.TRIES


def test_busy_server_is_retried() -> None:
    with rihibot(status=503, fails=2, sound=2) as (_, remote):
        assert_same(read(remote), local())
        assert remote.traffic.repeats == 2


@pytest.mark.parametrize("more", [1000, -1000])
def test_wrong_content_length_is_handled(more: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """As far as the tries reach: what was promised and did not come is asked for again."""
    monkeypatch.setattr(http, "TRIES", 8)
    with rihibot(more_claimed=more) as (_, remote):
        if more > 0:
            assert_same(read(remote), local())
        else:
            assert "the connection broke off, 8 times" in refused(remote.address)


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("http://robot.invalid/log.mcap", "there is no such host"),
        ("http://[host/log.mcap", "is not a valid URL"),
        ("http://host:port/log.mcap", "is not a valid URL"),
        ("http:///", "is a folder"),
        ("http://{address}/log.mcap", "the server cannot be reached"),  # it has ended
        ("memory://bucket/other.mcap", "does not exist: check the URL"),
        ("nowhere://bucket/log.mcap", "Protocol not known: nowhere"),
        ("s3://bucket/log.mcap", "needs a package that is not installed: Install s3fs"),
    ],
)
def test_invalid_urls_are_one_line_errors(url: str, words: str) -> None:
    with rihibot() as (web, _):
        url = url.format(address=web.address)
    assert words in refused(url)


def test_server_without_tls_is_one_line_error() -> None:
    with rihibot() as (web, _):
        assert "does not speak TLS" in refused(f"https://{web.address}/rihibot.mcap")


@pytest.mark.skipif(shutil.which("openssl") is None, reason="makes a certificate")
def test_untrusted_certificate_is_refused(tmp_path: Path) -> None:
    made = ["req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost"]
    files = ["-keyout", str(tmp_path / "key"), "-out", str(tmp_path / "certificate")]
    subprocess.run(["openssl", *made, *files], check=True, capture_output=True)
    with serving(SAMPLES, certificate=(tmp_path / "certificate", tmp_path / "key")) as web:
        said = refused(f"https://{web.address}/rihibot.mcap")
    assert said.startswith("cannot be read: the server's certificate is not valid: check URL")


def test_missing_version_header_is_not_a_change() -> None:
    with rihibot(no_version=True) as (_, remote):
        assert_same(read(remote), local())
        assert remote.version == ""


# Files that cannot be read in parts


@pytest.fixture(scope="module")
def wholes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files that have no index, or none that can be used."""
    messages = mixed_messages(30)
    made, folder = tmp_path_factory.mktemp("made"), tmp_path_factory.mktemp("wholes")
    for storage, name in (("db3", "log.db3"), ("mcap2-file", "log.mcap.zstd")):
        files = write_log(made / storage, messages, storage).iterdir()
        (found,) = (each for each in files if each.suffix in {".db3", ".zstd"})
        shutil.copy(found, folder / name)
    for storage, name in (("mcap-zstd", "killed.mcap"), ("bag-lz4", "killed.bag")):
        whole = write_log(made / name, messages, storage).read_bytes()
        (folder / name).write_bytes(whole[: len(whole) // 2])
    rows = "".join(f"{k / 100},0,0,0.1,0,0,9.8\n" for k in range(100))
    (folder / "imu.csv").write_text(f"t_s,gx,gy,gz,ax,ay,az\n{rows}")
    return folder


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("log.db3", "a ROS 2 .db3 has no index"),
        ("log.mcap.zstd", "it is compressed as a whole"),
        ("killed.mcap", "it has no usable index"),
        ("killed.bag", "it has no usable index"),
        ("imu.csv", "a CSV table has no index"),
    ],
)
def test_file_without_index_is_downloaded_only_if_allowed(
    wholes: Path, name: str, reason: str
) -> None:
    with serving(wholes) as web:
        said = refused(web.url(name))
        size = in_bytes((wholes / name).stat().st_size)
        assert said.startswith(f"would have to be read whole, {size}: ")
        assert reason in said
        assert_same(read(RemoteFile(web.url(name)), scan=True), read(wholes / name))


def test_remote_non_log_is_refused_like_a_local_file(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "words.txt").write_text("words")
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    with serving(tmp_path) as web:
        assert refused(web.url("empty.mcap")) == "is empty: record or copy it again"
        assert refused(web.url("words.txt")).startswith("is not a log: expected an MCAP file")
        assert "name those one by one" in refused(web.url("metadata.yaml"))
        assert refused(web.url("")).startswith("is a folder: name its .mcap or .bag files")


def test_duplicate_remote_file_is_refused() -> None:
    with rihibot() as (web, remote), pytest.raises(ChoiceError, match="is given twice"):
        open_log([remote, RemoteFile(web.url("rihibot.mcap"))])


# URLs and what is shown of them

URL = "http://me:pa$$word@host:81/a%20b/log.mcap?X-Signature=geheim&token=1#part"


def test_secrets_are_sent_only_to_the_server() -> None:
    with rihibot(asks_for="me:secret") as (web, _):
        url = web.url("rihibot.mcap?signature=hidden%2Bone", user="me:secret")
        remote = RemoteFile(url)
        assert_same(read(remote), local())
        assert web.asked[0][0] == "/rihibot.mcap?signature=hidden%2Bone"
        web.behaviour.status = 403
        assert "secret" not in refused(url) + remote.account
        web.behaviour.asks_for = "another:one"
        assert "secret" not in refused(url)


@pytest.mark.parametrize(
    ("text", "is_one", "name"),
    [
        ("https://host/a/log.mcap", True, "log.mcap"),
        ("s3://bucket/a/log.bag", True, "log.bag"),
        ("simplecache::s3://bucket/log.bag", True, "log.bag"),
        ("HTTP://host/a%20b%2Fc.mcap?x=/y", True, "c.mcap"),
        ("https://host/", True, "log"),
        ("log.mcap", False, ""),
        ("C:/logs/log.mcap", False, ""),
        ("a::b.mcap", False, ""),
        ("/logs/https:/host", False, ""),
    ],
)
def test_urls_are_distinguished_from_paths(text: str, *, is_one: bool, name: str) -> None:
    assert is_url(text) is is_one
    assert isinstance(path_or_url(text), RemoteFile) is is_one
    if is_one:
        assert file_name(text) == name


def test_a_file_url_is_a_path() -> None:
    assert path_or_url("file:///a%20b/log.mcap") == Path("/a b/log.mcap")
    assert path_or_url("file://host/[a/log.mcap") == Path("/[a/log.mcap")
    with pytest.raises(InputError, match="names no file"):
        path_or_url("file://[x")


def test_full_temporary_disk_is_one_line_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "log.mcap").write_bytes(bytes(1000))

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for name in ("mkdtemp", "TemporaryFile"):
        monkeypatch.setattr(tempfile, name, full)
    with serving(tmp_path, ranges=False) as web:
        file = RemoteFile(web.url("log.mcap"))
        with pytest.raises(NoRangesError):
            file.head(100)
        for read in (lambda: file.download(lambda _: None), lambda: file.read_bytes(1 << 30)):
            with pytest.raises(InputError, match="No space left on device; free some space"):
                read()


def test_pickled_remote_file_opens_its_own_connection() -> None:
    with rihibot() as (_, remote):
        read(remote)
        again = pickle.loads(pickle.dumps(remote))  # noqa: S301 - our own
        assert (again.address, again.traffic.bytes) == (remote.address, 0)


# Other file systems


@pytest.fixture
def memory() -> Iterator[Any]:
    from fsspec.implementations.memory import MemoryFileSystem

    system = MemoryFileSystem()
    system.pipe("/bucket/log.mcap", (SAMPLES / "rihibot.mcap").read_bytes())
    yield system
    system.rm("/bucket", recursive=True)


def test_fsspec_file_system_is_read_in_ranges(memory: Any) -> None:
    remote = RemoteFile("memory://bucket/log.mcap")
    assert_same(read(remote), local())
    assert 0 < remote.traffic.bytes < 0.9 * memory.size("/bucket/log.mcap")


def test_changed_fsspec_file_is_detected(memory: Any) -> None:
    remote = RemoteFile("memory://bucket/log.mcap")
    log = open_log([remote])
    memory.pipe("/bucket/log.mcap", (SAMPLES / "broad_21_cut.mcap").read_bytes())
    with pytest.raises(InputError, match="changed while it was read"):
        log.read(TOPICS)


def test_missing_fsspec_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    from imucalib_cli import optional

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(optional, "import_module", missing)
    said = refused("https://host/log.mcap")
    assert said == "needs fsspec, which is not installed: pip install 'imucalib[remote]'"


@pytest.mark.parametrize(
    "password", ["pw", "p/w", "p#w", "p?w", "p@w", "p/w@#w", "p@w/w", "p::w", "/"]
)
@pytest.mark.parametrize("chain", ["", "zip://a.mcap::", "simplecache::zip://me:pw@x::"])
def test_password_is_completely_hidden(password: str, chain: str) -> None:
    url = f"{chain}https://bob:{password}@host/a.mcap?sig=pw@w"
    for text in (without_secrets(f"at {url} it fails"), str(RemoteFile(url)), str(InputError(url))):
        assert "bob" not in text
        assert "p" not in re.sub("https|zip|simplecache|mcap", "", text)
        assert "w" not in text
        assert without_secrets(text) == text
    assert "here" in str(RemoteFile("https://bob:a b@here"))
    assert "bob" not in str(RemoteFile("https://bob:a b@here"))


def test_url_parts_without_secrets_are_shown() -> None:
    for url in (
        "s3://bucket/user@example/log.mcap",
        "https://host:8080/a/log.mcap",
        "zip://a.mcap::https://host/x.zip",
    ):
        assert without_secrets(f"{url}: gone") == f"{url}: gone"
    hidden = without_secrets("https://host/log.mcap?sig=1")
    assert str(InputError(f"{hidden}: gone")) == "https://host/log.mcap?…: gone"
