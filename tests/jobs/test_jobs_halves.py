"""Which halves are one IMU, and what is interpolated."""

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.jobs.input.halves import joined
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.clock import choose_clock
from imucalib_cli.logs.log import LogData
from imucalib_cli.logs.streams import ImuStream

START_NS = 1_700_000_000_000_000_000
ASKED = CalibrationRequest(logs=())


def wave(t: Any) -> Any:
    """Three sines of a hertz, 2 of amplitude."""
    return 2.0 * np.sin(2.0 * np.pi * np.asarray(t)[:, None] + np.arange(3.0))


def imu(topic: str, rate: float, sensors: str, *, shift: float = 0.0, frame: str = "") -> ImuStream:
    t = np.arange(shift, 10.0, 1.0 / rate)
    ns = START_NS + np.round(t * 1e9).astype(np.int64)
    none = np.zeros((len(t), 3))
    return ImuStream(
        topic=topic,
        header_ns=ns,
        log_ns=ns + 1000,
        frame_id=frame,
        gyro=wave(t) if "g" in sensors else none,
        accel=wave(t) + 9.0 if "a" in sensors else none,
    )


def join(*imus: ImuStream, request: CalibrationRequest = ASKED) -> dict[str, ImuStream]:
    data = LogData(imus={each.name: each for each in imus})
    return joined(data, choose_clock(list(imus)), request)[0].imus


def test_slower_sensor_is_interpolated_onto_the_faster() -> None:
    gyro = imu("/camera/gyro/sample", 200.0, "g", frame="gyro_frame")
    for rate, limit in ((63.0, 2e-5), (250.0, 1e-7)):
        accel = imu("/camera/accel/sample", rate, "a", shift=0.003, frame="accel_frame")
        one = join(gyro, accel)["/camera/gyro/sample"]
        t = (one.header_ns - START_NS) * 1e-9
        np.testing.assert_allclose(one.gyro, wave(t), atol=limit)
        np.testing.assert_allclose(one.accel, wave(t) + 9.0, atol=limit)
        assert (one.frame_id, one.accel_topic) == ("gyro_frame", "/camera/accel/sample")
        assert set(one.header_ns) <= set(max(gyro, accel, key=len).header_ns)


def test_nothing_is_interpolated_across_a_gap() -> None:
    gyro, accel = imu("/gyro", 200.0, "g"), imu("/accel", 100.0, "a")
    kept = np.abs((accel.header_ns - START_NS) * 1e-9 - 5.0) > 0.5
    names = ("header_ns", "log_ns", "gyro", "accel")
    accel = replace(accel, **{name: getattr(accel, name)[kept] for name in names})
    one = join(gyro, accel)["/gyro"]
    t = (one.header_ns - START_NS) * 1e-9
    assert np.diff(t).max() > 0.99
    np.testing.assert_allclose(one.accel, wave(t) + 9.0, atol=2e-4)


@pytest.mark.parametrize(
    ("halves", "expected"),
    [
        # of one name
        ({"/a/gyro": "g", "/a/accel": "a", "/b/gyr": "g", "/b/acc": "a"}, {"/a/gyro", "/b/gyr"}),
        ({"/imu/gyr": "g", "/imu/acc": "a", "/other": "ga"}, {"/imu/gyr", "/other"}),
        # the only ones
        ({"/left": "g", "/right": "a"}, {"/left"}),
        ({"/imu_gyro": "g", "/imu/force": "a"}, {"/imu_gyro"}),
        # of two robots
        ({"/one/gyro": "g", "/two/accel": "a"}, {"/one/gyro", "/two/accel"}),
        # not clear
        ({"/a": "g", "/b": "g", "/c": "a"}, {"/a", "/b", "/c"}),
        ({"/gyro": "ga", "/accel": "a"}, {"/gyro", "/accel"}),
        ({"/gyro": "g", "/accel": "g"}, {"/gyro", "/accel"}),
    ],
)
def test_matching_gyro_and_accel_topics_are_joined(
    halves: dict[str, str], expected: set[str]
) -> None:
    assert set(join(*(imu(topic, 100.0, which) for topic, which in halves.items()))) == expected
