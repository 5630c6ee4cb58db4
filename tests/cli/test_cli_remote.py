"""The command line and Python on logs behind URLs: the same answers, and no secret in any."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from msgspec.structs import replace

import imucalib_cli as ic
from imucalib_cli.cli.main import main
from imucalib_cli.errors import ChoiceError
from imucalib_cli.results.codec import read_results
from tests.cli.stand_in import ESTIMATE, Estimator
from tests.conftest import Imucalib
from tests.web_server import WebServer, serving

SAMPLES = Path(__file__).parents[2] / "sample_data"
URDF = SAMPLES / "rihibot.urdf"
QUICK = ("--to", "15", "--robot", "exact", "--sensor-model", "ideal")


@pytest.fixture
def web() -> Iterator[WebServer]:
    with serving(SAMPLES) as server:
        yield server


@pytest.fixture
def silent(estimator: Estimator) -> None:
    """Nothing is estimated, and nothing found that would be printed."""
    estimator.estimate = replace(ESTIMATE, findings=())


def parts(text: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """A result without its files, and these."""
    result = yaml.safe_load(text)
    return result, result["provenance"].pop("files")


@pytest.mark.usefixtures("silent")
def test_remote_result_equals_local_result(
    web: WebServer, imucalib: Imucalib, tmp_path: Path
) -> None:
    url = web.url("rihibot.mcap?signature=hidden", user="me:secret")
    web.behaviour.asks_for = "me:secret"
    seen = imucalib("run", url, "--urdf", URDF, "-v")
    sent = web.sent
    (tmp_path / "rihibot.imu_link.yaml").write_text(seen.out.replace("0.06", "0.07", 1))
    here = imucalib("run", SAMPLES / "rihibot.mcap", "--urdf", URDF, "-v")
    result, files = parts(seen.out)
    expected, local = parts(here.out)
    assert result == expected
    path = web.url("rihibot.mcap?…")
    size = (SAMPLES / "rihibot.mcap").stat().st_size
    assert files == [
        {"path": path, "sha256": None, "remote": {"bytes": size, "version": '"first"'}}
    ]
    assert "remote" not in local[0]
    assert not re.search("secret|hidden", seen.out + seen.err)
    assert here.err == ""
    assert re.fullmatch(
        rf"read: {re.escape(path)}: [\d.]+ MB of 2\.2 MB \({sent} bytes\) in \d+ requests\n",
        seen.err,
    )
    (read,) = read_results(seen.out, "stdout")
    assert read.provenance.files[0].identity == f'{path} {size} bytes, version "first"'
    # a result of the same log is replaced
    imucalib("run", url, "--urdf", URDF, "-o", f"{tmp_path}/")
    assert [each.name for each in tmp_path.iterdir()] == ["rihibot.imu_link.yaml"]


def test_inspect_output_equals_local_and_hides_secrets(web: WebServer, imucalib: Imucalib) -> None:
    url = web.url("rihibot.mcap?signature=hidden", user="me:secret")
    path = str(SAMPLES / "rihibot.mcap")
    found, expected = (
        json.loads(imucalib("inspect", log, "--urdf", URDF, "--format", "json").out)
        for log in (url, path)
    )
    assert "secret" not in json.dumps(found)
    assert "hidden" not in json.dumps(found)
    assert f"'{web.url('rihibot.mcap?…')}'" in found["command"]
    for each in (found, expected):
        del each["files"], each["command"]
    assert found == expected


def test_verify_accepts_urls_of_log_and_urdf(web: WebServer, imucalib: Imucalib) -> None:
    web.behaviour.ranges = True
    log, urdf = web.url("rihibot.mcap"), web.url("rihibot.urdf")
    seen = imucalib("verify", log, "--urdf", urdf, "--within", "5mm,1.5deg", "-v", *QUICK)
    assert f"path: {urdf}\n" in seen.out
    assert f"read: {urdf}: 5.1 kB of 5.1 kB (5119 bytes) in 1 request\n" in seen.err


def test_remote_urdf_needs_no_range_requests(web: WebServer, imucalib: Imucalib) -> None:
    web.behaviour.ranges = False
    log = str(SAMPLES / "rihibot.mcap")
    said = imucalib("inspect", log, "--urdf", web.url("rihibot.urdf"))
    assert f"urdf      {web.url('rihibot.urdf')}\n" in said.out
    said = imucalib("inspect", log, "--urdf", web.url("robot.urdf"), code=1)
    assert "robot.urdf does not exist (404 Not Found): check the URL" in said.err


def test_bytes_read_are_reported_on_failure(web: WebServer, imucalib: Imucalib) -> None:
    web.behaviour.changes_after = 4
    said = imucalib("run", web.url("rihibot.mcap"), "--urdf", URDF, "-v", code=1)
    *_, first, second = said.err.splitlines()
    assert first.startswith("read: http://")
    assert second.startswith(f"error: {web.url('rihibot.mcap')} changed while it was read: ")


@pytest.mark.parametrize("command", ["diff", "apply", "verify", "trend"])
def test_url_in_wrong_argument_hides_secrets(
    command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    url = "https://me:secret@host.invalid/result.yaml?signature=hidden"
    result = tmp_path / "result.yaml"
    result.write_text("schema: 1\n")
    others = ["--urdf", str(URDF)] if command == "apply" else [str(result)]
    urdf = ["--urdf", url]
    for arguments in ([url, *others], [str(result), *others, *urdf], [str(result), "-o", url]):
        assert main([command, *arguments]) in {1, 2}
        seen = capsys.readouterr()
        assert seen.err.startswith("error: ")
        assert not re.search("secret|hidden", seen.out + seen.err)


@pytest.mark.usefixtures("silent")
def test_python_api_accepts_urls(web: WebServer) -> None:
    log, urdf = web.url("rihibot.mcap"), web.url("rihibot.urdf")
    assert ic.calibrate(log, urdf=urdf).result.provenance.files[0].path == log
    web.behaviour.ranges = False
    with pytest.raises(ChoiceError, match="--allow-remote-scan"):
        ic.calibrate(log, urdf=urdf)
