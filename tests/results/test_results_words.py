"""Digits, words and files: what people read and what reaches the disk."""

import os
import re
import stat
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib_cli.digits import decimals, figures, sigma, with_std
from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, note, warning
from imucalib_cli.results.atomic import write_whole
from imucalib_cli.results.fields import findings_of
from imucalib_cli.results.result import Result
from tests.results.results_samples import make_result


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        # the examples of the Review of Particle Physics, Introduction 5.3
        (0.827, 0.119, "0.83 ± 0.12"),
        (0.827, 0.367, "0.8 ± 0.4"),
        (1.2567, 0.1234, "1.26 ± 0.12"),
        (12.34, 0.0099, "12.340 ± 0.010"),
        (0.827, 0.0354, "0.827 ± 0.035"),
        (0.827, 0.0355, "0.83 ± 0.04"),
        (1234.5, 95.2, "1230 ± 100"),
        (-0.0001, 0.01, "0.000 ± 0.010"),
    ],
)
def test_digits_are_rounded_to_sigma(value: float, std: float, text: str) -> None:
    assert with_std(value, std) == text


def test_text_states_missing_sigma() -> None:
    for std in (None, 0.0, float("inf"), float("nan")):
        assert with_std(1.5, std, default=2) == "1.50 (no sigma)"


@pytest.mark.parametrize(
    ("value", "count", "text"),
    [
        (180.0, 2, "180"),
        (-178.2, 2, "-180"),
        (99_999.0, 3, "100000"),
        (1e5, 2, "1e+05"),
        (12_345.0, 3, "12300"),
        (0.5, 2, "0.5"),
        (0.0012345, 3, "0.00123"),
        (0.00099, 2, "0.00099"),
        (1.5e-7, 2, "1.5e-07"),
        (9.96, 2, "10"),
        (0.0, 2, "0"),
        (float("inf"), 2, "inf"),
    ],
)
def test_moderate_numbers_use_plain_decimals(value: float, count: int, text: str) -> None:
    assert figures(value, count) == text


@settings(deadline=None)
@given(value=st.floats(-1e8, 1e8).filter(lambda x: abs(x) > 1e-8), count=st.sampled_from([2, 3]))
def test_figures_match_format_rounding(value: float, count: int) -> None:
    # half a unit of the last figure; which way a tie goes does not matter
    assert float(figures(value, count)) == pytest.approx(value, rel=0.5001 * 10.0 ** (1 - count))


@settings(deadline=None)
@given(std=st.floats(1e-12, 1e12))
def test_a_printed_sigma_is_within_five_percent_or_one_digit(std: float) -> None:
    printed = float(sigma(std))
    assert abs(printed - std) <= 0.5 * 10.0 ** -decimals(std) * (1 + 1e-9)
    digits = re.sub(r"^[0.]+|\.", "", sigma(std)).lstrip("0")
    assert decimals(std) < 0 or len(digits) <= 2


def test_file_is_written_atomically_with_umask(tmp_path: Path) -> None:
    target = tmp_path / "out.yaml"
    write_whole(target, "a: ü\r\n")
    assert target.read_bytes() == "a: ü\r\n".encode()
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE(target.stat().st_mode) == 0o666 & ~umask
    target.chmod(0o640)
    write_whole(target, b"b\n")
    assert target.read_bytes() == b"b\n"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert list(tmp_path.iterdir()) == [target]


def test_failed_write_keeps_old_file_and_no_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "out.yaml"
    target.write_text("old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match=r"out\.yaml: cannot be written: No space left on device"):
        write_whole(target, "new")
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_link_is_kept_and_its_target_replaced(tmp_path: Path) -> None:
    target, link = tmp_path / "real.yaml", tmp_path / "link.yaml"
    target.write_text("old")
    link.symlink_to(target)
    write_whole(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"


def test_folders_are_refused_and_devices_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        write_whole(tmp_path, "text")
    write_whole(Path("/dev/null"), "text")
    assert stat.S_ISCHR(Path("/dev/null").stat().st_mode)


def test_findings_common_to_several_imus_are_printed_once() -> None:
    def of(child: str, *findings: Finding) -> Result:
        return make_result(child=child, findings=findings)

    base = note("base.imu", topic="/imu", link="trunk")
    results = [
        of("a", base, warning("bias.unusual", name="accel_bias", size=0.7)),
        of("b", base, warning("bias.unusual", name="accel_bias", size=0.8)),
        of("c", base, warning("bias.unusual", name="gyro_bias", size=0.8)),
    ]
    told = [str(each) for each in findings_of(results)]
    assert [each.split(" of ")[0] for each in told[:2]] == [
        "warning: a: an accelerometer bias",
        "warning: c: a gyroscope bias",
    ]
    assert told[0].endswith("; the same for b")
    assert told[2:] == [f"note: {base.message}"]
    assert str(findings_of(results[1:2])[0]).startswith("warning: an accel")


def test_all_notes_of_one_imu_are_printed() -> None:
    notes = [
        note("imu.joined", gyro=f"/{n}", accel="/a", fast="/a", slow="/s", rate=1) for n in "pq"
    ]
    biases = [warning("bias.unusual", name="accel_bias", size=size) for size in (0.7, 0.8)]
    results = [make_result(child=child, findings=(*notes, *biases)) for child in "ab"]
    for few in (results[:1], results):
        said = [str(each) for each in findings_of(few)]
        assert said == [f"{each.severity.value}: {each.message}" for each in (*biases, *notes)]
