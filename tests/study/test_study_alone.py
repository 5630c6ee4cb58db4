"""The measured cost of a call, against calls of known cost."""

import os
import signal
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.study.alone import run_alone


def allocate(count: int, given: str) -> str:
    numbers = np.ones(count)
    return f"{given}: {numbers.sum():g}"


def sleep(given: str) -> str:
    time.sleep(0.3)
    return given


def refuse(given: str) -> str:
    raise InputError(f"{given} cannot be used")


def die(given: str) -> str:
    os.kill(os.getpid(), signal.SIGKILL)
    return given


def test_values_time_and_memory_are_returned() -> None:
    calls: list[Callable[[str], str]] = [
        partial(allocate, 12_500_000),
        partial(allocate, 10),
        sleep,
        refuse,
    ]
    large, small, slow, failed = run_alone(
        calls,
        "log",
        ["scipy.linalg", "a_library_that_is_not_there"],
    )
    assert large.value == "log: 1.25e+07"
    assert large.memory == pytest.approx(100e6, rel=0.1)
    assert small.memory < 20e6  # the peak of the call before is forgotten
    assert large.held > 10e6
    assert slow.seconds == pytest.approx(0.3, abs=0.2)
    assert slow.cpu_seconds < 0.1
    assert failed.value is None
    assert failed.failure == "log cannot be used"


def invert(given: str) -> str:
    del given
    return str(np.linalg.inv(np.zeros((2, 2))))


def leave(given: str) -> str:
    os._exit(len(given))


def make_a_function(given: str) -> Callable[[], str]:
    return lambda: given


def test_exception_is_returned_with_traceback_as_cause(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="Singular matrix") as raised:
        run_alone([sleep, invert], "log")
    assert "in invert" in str(raised.value.__cause__)
    with pytest.raises(Exception, match="pickle"):
        run_alone([make_a_function], "log")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("end", [die, leave])
def test_killed_process_is_reported(end: Callable[[str], str]) -> None:
    with pytest.raises(InputError, match="was killed"):
        run_alone([end], "log")
