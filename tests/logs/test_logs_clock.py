"""The choice between header stamps and receive times."""

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.findings import warnings
from imucalib_cli.logs.clock import choose_clock
from imucalib_cli.logs.streams import PoseStream, StampKind, Stream

START = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def stream(
    topic: str = "/imu", *, rate: float = 100.0, seconds: float = 20.0, header: Any = None
) -> Stream:
    """A stream received with jitter; ``header`` turns true times (ns since START) into stamps."""
    rng = np.random.default_rng(len(topic))
    true = (np.arange(int(rate * seconds)) / rate * SECOND).astype(np.int64)
    log_ns = np.sort(START + true + rng.integers(0, 5_000_000, size=len(true)))
    header_ns = START + true if header is None else np.asarray(header(true), dtype=np.int64)
    return Stream(topic=topic, header_ns=header_ns, log_ns=log_ns)


def unreceived(header: Any = None) -> Stream:
    """A stream whose receive times are all zero."""
    imu = stream(header=header)
    return replace(imu, log_ns=np.zeros_like(imu.log_ns))


def table(header_ns: Any) -> Stream:
    """Both stamps are the same."""
    return Stream(topic="/table", header_ns=header_ns, log_ns=header_ns)


def test_valid_headers_are_used() -> None:
    imu, joints = stream(), stream("/joints", rate=50.0)
    clock = choose_clock([imu, joints])
    assert clock.kind == "header"
    assert warnings(clock.findings) == ()
    assert clock.origin_ns == START
    np.testing.assert_allclose(clock.seconds(imu), np.arange(2000) / 100, atol=1e-12)
    assert choose_clock([imu, joints], "log").kind == "log"
    late = stream(header=lambda t: START + t + SECOND)  # within the search for an offset
    assert choose_clock([late, stream("/joints")]).kind == "header"


@pytest.mark.parametrize(
    ("header", "says"),
    [
        (np.zeros_like, "/imu: no stamps in the messages; receive times are used for all"),
        (lambda t: np.where(np.arange(len(t)) % 10 == 0, 0, START + t), "are zero in 200 of 2000"),
        (lambda t: np.full_like(t, START), "all the same"),
        (lambda t: START + t // SECOND * SECOND, "advance in only 19 of 1999"),
        (lambda t: START - t, "advance in only 0"),
        (lambda t: 35 * SECOND + t, "apart from those of other topics"),
        (lambda t: START + 30 * SECOND + t, "apart from those of other topics"),
        (lambda t: START + (1.05 * t).astype(int), "at 1.05 times"),
        (
            lambda t: START + t - 2 * SECOND * (t > t[-1] // 2),
            "jump back by 1.99 s at message 1001",
        ),
        (lambda t: START + t + SECOND // 20 * (t > t[-1] // 3), "step by +50 ms against the rec"),
        (lambda t: START + t - SECOND // 5 * (t > t[-1] // 2), "step by -200 ms against the rec"),
    ],
)
def test_one_stream_with_bad_headers_switches_all_to_receive_times(header: Any, says: str) -> None:
    imu = stream(header=header)
    others = [stream("/joints", rate=50.0), stream("/tf", rate=30.0)]
    clock = choose_clock([imu, *others])
    assert clock.kind == "log"
    assert len(warnings(clock.findings)) == 1
    assert says in warnings(clock.findings)[0]
    assert "/imu" in warnings(clock.findings)[0]
    np.testing.assert_array_equal(imu.stamps_ns(clock.kind), imu.log_ns)
    assert choose_clock([imu, *others], "header").kind == "header"


@pytest.mark.parametrize(
    "header",
    [
        lambda t: t + SECOND,  # simulated time
        lambda t: t // 2 + SECOND,  # simulated time at half speed
        lambda t: START + t + 100 * SECOND,  # the recorder's clock is off
        lambda t: np.where(np.arange(len(t)) == 7, 0, START + t),  # one glitch
        lambda t: START + t // 10_000_000 * 10_000_000,  # coarse stamps that repeat
        lambda t: START + (1.0005 * t).astype(int),  # a clock that drifts
        lambda t: START + t - SECOND * (np.arange(len(t)) == 9),  # one glitch back
    ],
)
def test_mutually_consistent_headers_are_used(header: Any) -> None:
    streams = [stream(header=header), stream("/joints", rate=500.0, header=header)]
    clock = choose_clock(streams)
    assert clock.kind == "header"
    assert warnings(clock.findings) == ()
    assert float(np.median(clock.seconds(streams[0]))) < 21


def test_static_transforms_do_not_affect_the_clock() -> None:
    zero = np.zeros(1, dtype=np.int64)
    static = PoseStream(
        topic="/tf_static",
        header_ns=zero,
        log_ns=zero,
        parent="a",
        child="b",
        position=np.zeros((1, 3)),
        quaternion_xyzw=np.array([[0.0, 0.0, 0.0, 1.0]]),
        is_static=True,
    )
    clock = choose_clock([stream(), static])
    assert clock.kind == "header"
    assert clock.origin_ns == START


def test_times_of_a_table_may_be_negative() -> None:
    """They count from the start of a motion; only zero says that nobody set a stamp."""
    motion = table(stream(header=lambda t: t - 10 * SECOND).header_ns)
    clock = choose_clock([motion])
    assert warnings(clock.findings) == ()
    assert clock.seconds(motion)[0] == 0.0


def test_two_bad_clocks_keep_headers_with_a_warning() -> None:
    clock = choose_clock([unreceived(np.zeros_like)])
    assert clock.kind == "header"
    assert "no better" in warnings(clock.findings)[0]
    assert clock.alternative is None
    assert choose_clock([]).origin_ns == 0


def test_only_valid_stamps_are_an_alternative() -> None:
    assert choose_clock([stream()]).alternative == "log"
    assert choose_clock([stream()], "log").alternative == "header"
    assert choose_clock([stream(header=np.zeros_like)]).alternative is None
    assert choose_clock([unreceived()]).alternative is None
    assert choose_clock([table(stream().header_ns)], "log").alternative is None


def test_requested_clock_warns_only_if_another_is_better() -> None:
    (warning,) = warnings(choose_clock([stream(header=np.zeros_like)], "header").findings)
    assert warning.endswith("yet --clock header was asked for: try --clock log")
    wishes: tuple[tuple[StampKind, str], ...] = (
        ("header", "receive times"),
        ("log", "header stamps"),
    )
    for kind, other in wishes:
        (warning,) = warnings(choose_clock([unreceived(np.zeros_like)], kind).findings)
        assert "try" not in warning
        assert f"and {other} of /imu are all zero" in warning
