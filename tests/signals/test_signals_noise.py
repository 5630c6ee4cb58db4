"""White noise of samples, against the noise put in."""

import numpy as np
import pytest

from imucalib_cli.signals.noise import noise_level, white_noise


@pytest.mark.parametrize("count", [20_000, 1_000_000])
def test_noise_beside_motion_is_that_put_in(count: int) -> None:
    rng = np.random.default_rng(1)
    t = 0.005 * np.arange(count)
    values = np.sin(t[:, None] * [0.5, 1.0, 2.0]) + rng.normal(size=(count, 3)) * [0.01, 0.02, 0.03]
    found = white_noise(values)
    np.testing.assert_allclose(found, [0.01, 0.02, 0.03], rtol=0.03)
    assert noise_level(values) == pytest.approx(np.sqrt(np.mean(found**2)))


def test_repeated_samples_count_as_often_in_a_long_log() -> None:
    """Half of them, as of a driver that publishes each sample twice: no phase is left out."""
    values = np.repeat(np.random.default_rng(2).normal(size=(600_000, 3)), 2, axis=0)
    np.testing.assert_allclose(white_noise(values), white_noise(values[:100_000]), rtol=0.02)
