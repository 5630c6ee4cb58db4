"""Arrivals made from known ticks, by models of drivers, buses and networks."""

import numpy as np
import pytest

from imucalib_cli.arrays import Floats
from imucalib_cli.signals.timing.bursts import BurstTiming, crowding, rate_stretches, time_bursts
from tests.signals.signals_samples import arrivals


def _values(t: Floats) -> Floats:
    """Joints in smooth motion: in even steps if samples are even."""
    return np.stack([np.sin(1.3 * t), np.sin(0.7 * t + 1.0), np.cos(2.1 * t)], axis=1)


def _timed(stamps: Floats, values: Floats) -> BurstTiming:
    spread = time_bursts(stamps, values)
    assert spread is not None
    return spread


def _off(spread: BurstTiming, t: Floats) -> Floats:
    """Error of the ticks except for the delay, which is unobservable."""
    off = spread.t - t
    return np.asarray(off - np.median(off))


@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("rate", [200.0, 500.0, 1000.0])
@pytest.mark.parametrize("batch", [1, 5, 10])
def test_even_ticks_behind_bursts_are_found(rate: float, batch: int, *, same: bool) -> None:
    t = 3.0 + np.arange(int(60 * rate)) / rate
    stamps = arrivals(t, np.random.default_rng(int(rate) + batch), batch=batch, same=same)
    spread = _timed(stamps, _values(t))
    assert np.abs(_off(spread, t)).max() < 0.7e-3
    assert spread.period == pytest.approx(1 / rate, rel=2e-5)
    assert spread.lost == 0
    assert (np.diff(spread.t) > 0.0).all()


@pytest.mark.parametrize("rate", [200.0, 500.0, 1000.0])
@pytest.mark.parametrize("batch", [1, 5, 10])
def test_one_percent_message_loss_is_tolerated(rate: float, batch: int) -> None:
    rng = np.random.default_rng(int(rate) + batch)
    t = np.arange(int(60 * rate)) / rate
    kept = rng.random(len(t)) >= 0.01
    stamps = arrivals(t, rng, batch=batch)[kept]
    spread = _timed(stamps, _values(t[kept]))
    raw = stamps - t[kept]
    off = _off(spread, t[kept])
    # As stamped it is off by up to a batch and the latency.
    assert np.sqrt(np.mean(off**2)) < min(1.4e-3, 0.4 * np.std(raw))
    if batch > 1:
        assert spread.batch == batch
        assert spread.lost == pytest.approx((~kept).sum(), abs=2.5 * batch)
        assert spread.period == pytest.approx(1 / rate, rel=1e-4)


def test_losses_are_counted_if_arrivals_show_the_period() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(15_000) / 125.0
    kept = rng.random(len(t)) >= 0.01
    stamps = np.maximum.accumulate(t + rng.gamma(2.0, 0.003, len(t)))[kept]
    spread = _timed(stamps, _values(t[kept]))
    assert spread.lost == pytest.approx((~kept).sum(), abs=2)
    # Counting without regard to them would be off by a second in the middle.
    assert np.sqrt(np.mean(_off(spread, t[kept]) ** 2)) < 1.5e-3


def _polled(t: Floats, poll: float) -> Floats:
    """Fetched by a bus every ``poll`` s, and handed over one after the other."""
    count = np.ceil(t / poll)
    first = np.searchsorted(count, count)
    return np.asarray(count * poll + 1.2e-4 * (np.arange(len(t)) - first))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("loss", [0.0, 0.003])
@pytest.mark.parametrize(
    ("poll", "rate"),
    [(0.008, 200.0), (0.016, 200.0), (0.019, 200.0), (0.01, 200.0), (0.004, 400.0), (0.01, 240.0)],
)
def test_a_polled_bus_is_not_a_loss(poll: float, rate: float, loss: float, seed: int) -> None:
    """Its rate and the device's beat: the spectrum of arrivals has peaks at other rates, too."""
    rng = np.random.default_rng(seed)
    # The clocks slip, and within the log the polls begin to find another phase.
    t = 3.2 - 2.5e-5 + np.arange(int(25 * rate)) / rate * (1.0 + 2e-6 * (seed + 1))
    kept = rng.random(len(t)) >= loss
    if loss:
        for at in rng.integers(0, len(t) - 50, 3):
            kept[at : at + int(0.06 * rate)] = False
    spread = _timed(_polled(t, poll)[kept], _values(t[kept]))
    assert spread.lost == pytest.approx((~kept).sum(), abs=4)
    # Not only up to a constant: the delay is part of the time offset, and no more than that.
    assert np.abs(spread.t - t[kept]).max() < poll


def test_a_pause_of_the_log_keeps_its_length() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(12_000) / 200.0
    t = t[(t < 20.0) | (t > 23.0)]
    stamps = np.maximum.accumulate(t + rng.gamma(2.0, 0.0025, len(t)))
    spread = _timed(stamps, _values(t))
    assert np.median(np.abs(_off(spread, t))) < 1e-3
    assert np.diff(spread.t).max() == pytest.approx(3.0, abs=0.02)


def test_stamps_without_bursts_are_unchanged() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(8000) / 200.0
    pairs = np.repeat(np.arange(4000) * 0.01, 2)  # values belong to their stamps
    for stamps in (
        t,
        t + np.clip(rng.normal(scale=1e-3, size=len(t)), -2e-3, 2e-3),
        t[rng.random(len(t)) > 0.1],
        t[:50],
        pairs + np.tile([0.0, 2e-4], 4000),  # two publishers of one joint, or a late loop
        pairs,  # every message recorded twice
    ):
        assert time_bursts(stamps, _values(stamps)) is None
    assert time_bursts(rng.permutation(t), _values(t)) is None


def _changing(*parts: tuple[float, float]) -> Floats:
    """Stamps of stretches, each of a duration, s, and a rate, Hz."""
    steps = [np.full(round(seconds * rate), 1.0 / rate) for seconds, rate in parts]
    return np.asarray(2.0 + np.concatenate([[0.0], np.cumsum(np.concatenate(steps))]))


@pytest.mark.parametrize(
    "parts",
    [
        ((15.0, 100.0), (15.0, 200.0)),
        ((15.0, 200.0), (15.0, 100.0)),
        ((25.0, 100.0), (4.0, 1000.0)),
        ((30.0, 100.0), (2.0, 500.0)),
        ((10.0, 100.0), (5.0, 500.0), (10.0, 100.0)),
    ],
)
@pytest.mark.parametrize("jitter", [0.0, 2e-4])
def test_rate_change_is_not_a_burst(parts: tuple[tuple[float, float], ...], jitter: float) -> None:
    t = _changing(*parts)
    t = np.sort(t + np.random.default_rng(0).normal(0.0, jitter, len(t)))
    found = rate_stretches(t)
    assert [each.rate for each in found] == pytest.approx([rate for _, rate in parts], rel=0.05)
    starts = 2.0 + np.cumsum([0.0, *(seconds for seconds, _ in parts)])[:-1]
    # to a few samples; it was told up to 1.5 s late
    np.testing.assert_allclose([each.start for each in found], starts, atol=0.05)


@pytest.mark.parametrize("batch", [1, 5, 10])
@pytest.mark.parametrize("seed", range(4))
def test_bursts_losses_and_gaps_are_not_a_rate_change(batch: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.arange(6000) / 200.0
    assert rate_stretches(arrivals(t, rng, batch=batch)) == ()
    kept = (rng.random(6000) < 0.7) | (t < 15.0)
    assert rate_stretches(t[kept]) == ()
    held_up = t.copy()
    held_up[(t > 10.0) & (t < 13.0)] = 13.0 + 1e-6 * np.arange(((t > 10.0) & (t < 13.0)).sum())
    assert rate_stretches(held_up) == ()
    assert rate_stretches(t[(t < 5.0) | (t > 11.0)]) == ()


@pytest.mark.parametrize("size", [4, 10, 40])
def test_messages_that_were_held_up_are_no_crowd(size: int) -> None:
    """They come at once, behind a gap; copies of one come without it."""
    rng = np.random.default_rng(0)
    t = np.arange(6000) / 200.0
    held = t + rng.exponential(1e-4, len(t))
    for row in range(100, 5900, 50 * size):
        held[row : row + size] = held[row + size - 1] + 1e-6 * np.arange(size)
        half = slice(row + size // 2, row + size)  # comes a little later
        held[half] += 0.002
    assert not crowding(np.maximum.accumulate(held)).any()
    copied = np.insert(held, [3000] * size, held[2999] + 1e-6 * np.arange(1, size + 1))
    np.testing.assert_array_equal(np.flatnonzero(crowding(copied)), 3000 + np.arange(size))
