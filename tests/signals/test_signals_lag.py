"""Shifts the test made, found again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

from imucalib_cli.arrays import Bools, Floats
from imucalib_cli.signals.timing.lag import Lag, best_lag


def _series(seed: int, n: int, shift: int) -> tuple[Floats, Floats]:
    """Reference and series with series[i + shift] = reference[i]."""
    rng = np.random.default_rng(seed)
    long = gaussian_filter1d(rng.normal(size=n + 1000), 6.0) + 3.0
    return long[500 : 500 + n], 1.7 * long[500 - shift : 500 - shift + n] + 0.4


def _lag(reference: Floats, series: Floats, most: int, usable: Bools | None = None) -> Lag:
    usable = np.ones((2, len(series)), dtype=bool) if usable is None else usable
    lag = best_lag(reference, series, usable, most)
    assert lag is not None
    return lag


@given(st.integers(-200, 200), st.integers(0, 1000))
@settings(deadline=None, max_examples=40)
def test_positive_and_negative_shifts_are_found(shift: int, seed: int) -> None:
    reference, series = _series(seed, 1500, shift)
    lag = _lag(reference, series, 200)
    assert lag.samples == shift
    assert lag.correlation == pytest.approx(1.0, abs=0.02)
    assert lag.rivals == ()
    assert lag.at_edge == (abs(shift) == 200)


def test_garbage_in_gaps_is_ignored() -> None:
    reference, series = _series(1, 1500, -37)
    usable = np.ones((2, 1500), dtype=bool)
    usable[0, 300:450] = usable[1, 900:1100] = False
    reference = np.where(usable[0], reference, 1e4)
    series = np.where(usable[1], series, -1e5)
    lag = _lag(reference, series, 200, usable)
    assert (lag.samples, lag.at_edge) == (-37, False)
    assert lag.correlation > 0.95


def test_noise_does_not_move_the_peak() -> None:
    reference, series = _series(2, 3000, 88)
    series = series + 0.3 * series.std() * np.random.default_rng(3).normal(size=3000)
    lag = _lag(reference, series, 200)
    assert abs(lag.samples - 88) <= 1
    assert 0.8 < lag.correlation < 1.0


def test_shift_beyond_search_has_no_clear_peak_or_is_at_edge() -> None:
    assert _lag(*_series(4, 3000, 300), 200).correlation < 0.5
    t = np.linspace(-1, 1, 800)
    lag = _lag(np.exp(-((t / 0.2) ** 2)), np.exp(-(((t - 0.3) / 0.2) ** 2)), 60)
    assert (lag.samples, lag.at_edge) == (60, True)


def test_series_that_are_constant_or_never_overlap_by_half_have_no_lag() -> None:
    reference, _ = _series(5, 500, 0)
    assert best_lag(reference, np.full(500, 2.0), np.ones((2, 500), dtype=bool), 50) is None
    nothing = np.zeros((2, 500), dtype=bool)
    assert best_lag(reference, reference, nothing, 50) is None
    reference, series = _series(1, 1500, 10)
    usable = np.zeros((2, 1500), dtype=bool)
    usable[0, :800] = usable[1, 700:] = True
    assert best_lag(reference, series, usable, 200) is None
    assert best_lag(reference, series, usable, 400) is not None


@pytest.mark.parametrize("shift", [-12.3, 0.4, 7.5, 21.8])
def test_a_shift_between_samples_is_found_to_a_fraction(shift: float) -> None:
    i = np.arange(1500.0)

    def signal(x: Floats) -> Floats:
        return np.asarray(
            np.sin(x / 9.0) + np.sin(x / 17.3 + 1.0) + np.exp(-(((x - 700) / 30) ** 2))
        )

    lag = _lag(signal(i), signal(i - shift), 40)
    assert lag.samples + lag.between == pytest.approx(shift, abs=0.1)
    assert abs(lag.between) <= 0.5


@pytest.mark.parametrize("ends", ["start", "end"])
def test_half_of_the_shorter_series_must_overlap(ends: str) -> None:
    """A few samples at the edge of the search agree by chance; they are not searched."""
    rng = np.random.default_rng(3)
    reference, series = (gaussian_filter1d(rng.normal(size=400), 6.0) for _ in range(2))
    usable = np.zeros((2, 400), dtype=bool)
    usable[0, :] = True
    usable[1, :60] = True  # the shorter one: 60 samples
    if ends == "start":
        usable = usable[:, ::-1]
        reference, series = reference[::-1], series[::-1]
    lag = _lag(reference, series, 390, usable)
    shifted = np.arange(400) + lag.samples
    inside = (shifted >= 0) & (shifted < 400)
    meeting = usable[1, shifted[inside]] & usable[0, np.arange(400)[inside]]
    assert meeting.sum() >= 30


def test_other_shifts_of_periodic_motion_are_rivals() -> None:
    """As of a gait, whose steps hardly differ; motion that does not repeat has none."""
    rng, index = np.random.default_rng(5), np.arange(2000)
    steps = np.sin(2.0 * np.pi * index / 100.0) + 0.3 * np.sin(4.0 * np.pi * index / 100.0)
    walked = steps + 0.01 * rng.normal(size=len(index))
    lag = _lag(walked, np.roll(walked, 40) + 0.01 * rng.normal(size=len(index)), 180)
    assert lag.samples == 40
    assert set(lag.rivals) == {-160, -60, 140}


def test_half_of_the_whole_series_must_overlap_where_a_part_of_it_is_given() -> None:
    """The end of a long series is no short series, whose other half could overlap."""
    reference, series = _series(6, 400, 20)
    usable = np.ones((2, 400), dtype=bool)
    usable[0, 60:] = False
    assert _lag(reference, series, 40, usable).samples == 20
    assert best_lag(reference, series, usable, 40, whole=120) is not None
    assert best_lag(reference, series, usable, 40, whole=200) is None
