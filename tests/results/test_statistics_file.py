"""Files of statistics: exact, small, and solved again from the command line."""

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from msgspec.structs import asdict, replace

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.checks.segments import parts_of_log
from imucalib_cli.jobs.calibrate import Calibrated
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.results.statistics_file import read_statistics, statistics_bytes
from tests.conftest import Imucalib
from tests.report.report_pages import outcome
from tests.results.results_samples import edited

SAMPLE_DATA = Path(__file__).parents[2] / "sample_data"
MOST = 1_000_000
"""Bytes of a file of an ordinary arm."""


@pytest.fixture(scope="module")
def calibrated() -> Calibrated:
    (found,) = outcome("rihibot").calibrated
    return found


@pytest.fixture(scope="module")
def content(calibrated: Calibrated) -> bytes:
    assert calibrated.estimate.statistics is not None
    return statistics_bytes(calibrated.result, calibrated.estimate.statistics)


@pytest.fixture
def combine(imucalib: Imucalib) -> Imucalib:
    return imucalib.with_("combine", "--format", "yaml")


def of_another(calibrated: Calibrated, sha256: str | None = None) -> bytes:
    """The same statistics, of another IMU and by other files."""
    assert calibrated.estimate.statistics is not None
    other = edited(calibrated.result, "transform.child", "other")
    if sha256 is not None:
        log = edited(other.provenance.files[0], "sha256", sha256)
        other = edited(edited(other, "provenance.urdf.sha256", sha256), "provenance.files", [log])
    return statistics_bytes(other, calibrated.estimate.statistics)


@pytest.fixture
def file(content: bytes, tmp_path: Path) -> Path:
    path = tmp_path / "log.statistics.npz"
    path.write_bytes(content)
    return path


def test_statistics_read_back_equal(file: Path, content: bytes, calibrated: Calibrated) -> None:
    assert len(content) < MOST
    read, before = read_statistics(file), calibrated.estimate.statistics
    assert before is not None
    assert read.result == calibrated.result
    for name in ("information", "score", "noise", "motion"):
        there, here = getattr(read.statistics.equations, name), getattr(before.equations, name)
        assert np.array_equal(there, here), name
    assert asdict(read.statistics.options) == asdict(before.options)
    few = read.statistics.parts
    joined = before.parts.reshape(len(few), -1, *few.shape[1:]).sum(axis=1)
    assert np.array_equal(np.triu(few), np.triu(joined))
    assert statistics_bytes(read.result, read.statistics) == content


def test_names_of_joints_may_have_spaces(file: Path, calibrated: Calibrated) -> None:
    statistics = calibrated.estimate.statistics
    assert statistics is not None
    equations = statistics.equations
    placed = tuple(
        replace(
            each,
            labels=tuple("arm " + label for label in each.labels),
            joint=replace(each.joint, name="arm " + each.joint.name),
        )
        if each.joint is not None
        else each
        for each in equations.layout.placed
    )
    renamed = replace(equations, layout=replace(equations.layout, placed=placed))
    renamed_log = replace(statistics, equations=renamed)
    file.write_bytes(statistics_bytes(calibrated.result, renamed_log))
    read = read_statistics(file)
    joints = [each.joint and each.joint.name for each in read.statistics.equations.layout.placed]
    assert joints == [each.joint and each.joint.name for each in placed]


def test_documentation_has_every_array_and_the_schema(content: bytes) -> None:
    page = (Path(__file__).parents[2] / "docs/several-logs.md").read_text(encoding="utf-8")
    table = page.partition("## The file of statistics")[2]
    with np.load(io.BytesIO(content)) as file:
        header = json.loads(file["header"].tobytes())
        named = {name.replace("gyro_", "accel_") for name in file.files}
    assert {name for name in named if f"`{name}`" not in table} == set()
    assert f"`schema` {header['schema']}," in table


def test_log_parts_match_the_report(file: Path, calibrated: Calibrated) -> None:
    details, covariance = calibrated.estimate.details, calibrated.estimate.covariance
    assert details is not None
    assert details.stretches is not None
    assert covariance is not None
    found = parts_of_log(read_statistics(file).statistics, np.sqrt(np.diag(covariance)))
    assert found is not None
    # A few longer parts in place of many: ends and sums are the same.
    share = details.stretches.share.reshape(len(found.share), -1, 6).sum(axis=1)
    np.testing.assert_allclose(found.share, share, atol=1e-6)
    np.testing.assert_allclose(found.fold_difference, details.stretches.fold_difference, atol=1e-9)
    np.testing.assert_allclose(found.std_so_far[-1], details.stretches.std_so_far[-1])


def test_command_reproduces_result_from_file_and_stdin_list(
    file: Path, calibrated: Calibrated, combine: Imucalib
) -> None:
    first = calibrated.result
    for argument, stdin in ((file, b""), ("-", f"{file}\n".encode())):
        again = yaml.safe_load(combine(argument, stdin=stdin).out)
        for there, here in (
            (again["covariance"], first.covariance),
            (again["transform"]["translation"], first.transform.translation),
        ):
            np.testing.assert_allclose(np.array(there), np.array(here), rtol=1e-12)
        turned = np.subtract(again["transform"]["rotation_xyzw"], first.pose.rotation_xyzw)
        assert np.abs(turned).max() < 1e-12
        told = [each["code"] for each in again["diagnostics"]["findings"]]
        assert told == [each.code for each in first.diagnostics.findings]
        assert again["status"] == "ok"
        assert again["provenance"]["options"] == first.provenance.options
        assert again["diagnostics"]["combined"] is None


def test_statistics_are_found_under_batch_names(
    file: Path, calibrated: Calibrated, combine: Imucalib
) -> None:
    result = file.with_name("log.imu_link.yaml")
    result.write_text(to_yaml([calibrated.result]), encoding="utf-8")
    file.with_name("log.statistics.other.npz").write_bytes(of_another(calibrated))
    (found,) = yaml.safe_load_all(combine(result).out)
    assert found["transform"]["child"] == calibrated.result.child


def test_unsolvable_imu_does_not_stop_the_others(
    file: Path, calibrated: Calibrated, combine: Imucalib
) -> None:
    for digit in "01":
        content = of_another(calibrated, sha256=64 * digit)
        file.with_name(f"{digit}.npz").write_bytes(content)
    seen = combine(file.parent, code=2)
    (found,) = yaml.safe_load_all(seen.out)
    assert found["transform"]["child"] == calibrated.result.child
    assert "different URDFs" in seen.err


def test_unusable_files_in_folder_do_not_stop_the_others(file: Path, combine: Imucalib) -> None:
    """An archive of something else is passed over, a damaged one is an error beside the result."""
    np.savez(file.with_name("weights.npz"), layer=np.eye(3))
    damaged = file.with_name("damaged.npz")
    for code, words in (
        (0, "weights.npz: holds no statistics of imucalib and is left out"),
        (1, "damaged.npz: is damaged"),
    ):
        if code:
            damaged.write_bytes(file.read_bytes()[:-1000])
        seen = combine(file.parent, code=code)
        assert len(list(yaml.safe_load_all(seen.out))) == 1
        assert words in seen.err
    file.unlink()
    damaged.unlink()
    assert "no statistics in it" in combine(file.parent, code=1).err


def test_priors_can_change_without_the_log(file: Path, combine: Imucalib) -> None:
    known = "-0.0225 0.1 0 3.14159265 0 1.57079633"
    said = combine(file, "--initial", known, "--prior-std", "tz=1mm", "--robot", "exact").out
    options = yaml.safe_load(said)["provenance"]["options"]
    assert options["robot"] == "exact"
    assert options["pose.std"].split()[2] == "0.001"


def test_a_page_of_statistics_has_spectra_and_parts(file: Path, imucalib: Imucalib) -> None:
    page = file.with_name("page.html")
    imucalib("report", file, "-o", page)
    text = page.read_text(encoding="utf-8")
    for part in ("from the statistics of a log", 'id="imu0-spectra"', 'id="imu0-segments"'):
        assert part in text


@pytest.mark.parametrize("seed", range(40))
def test_damaged_file_is_one_line_error(seed: int, content: bytes, file: Path) -> None:
    rng = np.random.default_rng(seed)
    data = bytearray(content)
    for place in rng.integers(0, len(data), 20).tolist():
        data[place] = int(rng.integers(256))
    file.write_bytes(data)
    with pytest.raises(InputError):
        read_statistics(file)


def _of_level(level: float) -> Any:
    def change(header: Any) -> Any:
        changed = {**json.loads(header.tobytes()), "level": level}
        return np.frombuffer(json.dumps(changed).encode(), dtype=np.uint8)

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        *((name, None) for name in ("header", "information", "widened", "accel_density")),
        *(("header", _of_level(level)) for level in (0.0, -1.0, np.nan)),
        ("R", lambda R: 2.0 * R),
        ("score", lambda score: score * np.inf),
    ],
)
def test_missing_or_impossible_array_is_one_line_error(name: str, change: Any, file: Path) -> None:
    with np.load(file) as archive:
        arrays = dict(archive)
    array = arrays.pop(name)
    np.savez(file, **arrays, **({} if change is None else {name: change(array)}))
    with pytest.raises(InputError, match="damaged or has no statistics"):
        read_statistics(file)


def test_earlier_output_of_a_failed_combination_is_told(
    file: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    old = tmp_path / "old.yaml"
    combine = imucalib.with_("combine", "-o", old)
    combine(file)
    (tmp_path / "empty").mkdir()
    for wrong in (tmp_path / "nope.npz", tmp_path / "empty"):
        assert f"{old} was not updated" in combine(wrong, code=1).err
    assert "was not updated" not in combine(wrong, "-o", wrong / "new", code=1).err


def test_untrusted_combination_is_a_bare_pose_by_force(file: Path, imucalib: Imucalib) -> None:
    bound = ("--require", "1um", "--format", "matrix")
    refused = imucalib("combine", file, *bound, code=3)
    assert refused.out == ""
    assert "--force writes it anyway" in refused.err
    assert len(imucalib("combine", file, *bound, "--force", code=3).out.splitlines()) == 4


def test_combination_overwrites_a_log_by_force_alone(
    file: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes((SAMPLE_DATA / "rihibot.mcap").read_bytes())
    combine = imucalib.with_("combine", file, "-o", log)
    combine(code=2)
    combine("--force")
    assert yaml.safe_load(log.read_text())["status"] == "ok"
