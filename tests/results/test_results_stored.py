"""Results of earlier versions, of the sample log: from before the keys in the file name."""

from pathlib import Path

import pytest
import yaml
from msgspec import to_builtins

from imucalib_cli.results.codec import read_results
from tests.conftest import Imucalib

STORED = sorted((Path(__file__).parent / "stored").glob("*.yaml"))
SAMPLES = Path(__file__).parents[2] / "sample_data"


@pytest.mark.parametrize("path", STORED, ids=lambda path: path.stem)
def test_every_key_of_an_old_result_is_kept(path: Path) -> None:
    text = path.read_text()
    (result,) = read_results(text, path.name)
    _assert_kept(yaml.safe_load(text), to_builtins(result))
    assert result.recorded_at is None


def _assert_kept(old: object, new: object) -> None:
    if isinstance(old, dict):
        assert isinstance(new, dict)
        assert [key for key in new if key in old] == list(old)  # in the same order, too
        for key, value in old.items():
            _assert_kept(value, new[key])
    else:
        assert old == new


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("first", 0, "not moved: imu_link in wrist_3_link has not moved"),
        ("without_codes", 3, "the result contradicts itself or its model: the IMU moves as"),
        ("without_parameters", 0, "not moved: imu_link in wrist_3_link has not moved"),
    ],
)
def test_old_results_can_be_compared_and_verified(
    name: str, code: int, words: str, imucalib: Imucalib
) -> None:
    """The sample's URDF has the IMU turned by 1 degree."""
    (path,) = (each for each in STORED if each.stem == name)
    assert words in imucalib("diff", path, path, code=code).err
    if not code:
        err = imucalib("verify", path, "--urdf", SAMPLES / "rihibot.urdf", code=4).err
        assert "the rotation is off by 1.0" in err
