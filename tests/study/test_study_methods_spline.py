"""Splines, their calculus and the bordered solver against scipy and dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from imucalib_cli.study.methods.bordered import BorderedNormal
from imucalib_cli.study.methods.spline import (
    DEGREE,
    ORDER,
    Knots,
    evaluate,
    fitted_controls,
    rate_jacobian,
    residual_std,
    right_jacobian,
)


def test_values_and_derivatives_are_scipys() -> None:
    rng = np.random.default_rng(0)
    knots = Knots.over(2.0, 5.1, 7.0)
    controls = rng.normal(size=(knots.controls, 3))
    places = knots.start + (np.arange(knots.controls + ORDER) - DEGREE) / knots.rate
    spline = BSpline(places, controls, DEGREE)
    t = np.sort(rng.uniform(2.0, 5.1, 40))
    segment, u = knots.at(t)
    found = evaluate(controls, segment, knots.weights(u, 4))
    for order in range(4):
        np.testing.assert_allclose(found[order], spline.derivative(order)(t), atol=1e-9)


def test_a_fitted_spline_is_scipys_and_knows_the_noise() -> None:
    rng = np.random.default_rng(1)
    knots = Knots.over(0.0, 10.0, 12.0)
    t = np.linspace(0.0, 10.0, 2001)
    noisy = np.stack([np.sin(2 * t), np.cos(3 * t)], axis=1) + 0.01 * rng.normal(size=(2001, 2))
    places = (np.arange(knots.controls + ORDER) - DEGREE) / knots.rate
    design = BSpline.design_matrix(t, places, DEGREE).toarray()
    expected = np.linalg.lstsq(design, noisy, rcond=None)[0]
    found = design @ fitted_controls(knots, t, noisy)
    np.testing.assert_allclose(found, design @ expected, atol=1e-6)
    assert residual_std(knots, t, noisy) == pytest.approx(0.01, rel=0.05)
    assert residual_std(Knots.over(0.0, 10.0, 400.0), t, noisy) == 0.0


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.03, 0.07, 1.0, 3.0, 5.0])
def test_right_jacobian_against_scipys_rotations(size: float) -> None:
    rng = np.random.default_rng(2)
    phi = rng.normal(size=3)
    phi *= size / np.linalg.norm(phi)
    v = rng.normal(size=3)
    step = 1e-6
    here = Rotation.from_rotvec(phi)
    turned = (here.inv() * Rotation.from_rotvec(phi + step * v)).as_rotvec()
    back = (here.inv() * Rotation.from_rotvec(phi - step * v)).as_rotvec()
    J = right_jacobian(phi[None])[0]
    np.testing.assert_allclose(J @ v, (turned - back) / (2 * step), atol=1e-8)
    by_axis = [
        (right_jacobian((phi + step * e)[None])[0] - right_jacobian((phi - step * e)[None])[0]) @ v
        for e in np.eye(3)
    ]
    expected = np.stack(by_axis, axis=1) / (2 * step)
    np.testing.assert_allclose(rate_jacobian(phi[None], v[None])[0], expected, atol=1e-8)


def test_bordered_least_squares_is_dense_least_squares() -> None:
    rng = np.random.default_rng(3)
    controls, width, borders = 9, 2, 3
    segment = np.sort(rng.integers(0, controls - 3, 60))
    local = rng.normal(size=(60, 2, 4 * width))
    border = rng.normal(size=(60, 2, 2))
    columns, r = np.array([0, 2]), rng.normal(size=(60, 2))
    prior, prior_r = rng.normal(size=(4, borders)), rng.normal(size=4)
    normal = BorderedNormal(controls, width, 4, borders)
    for part in (slice(0, 25), slice(25, 60)):
        normal.add(segment[part], local[part], border[part], columns, r[part])
    normal.add_border(prior, prior_r)

    dense = np.zeros((60, 2, controls * width + borders))
    for row, first in enumerate(segment):
        dense[row, :, first * width : (first + 4) * width] = local[row]
        dense[row][:, controls * width + columns] = border[row]
    J = np.vstack([dense.reshape(120, -1), np.pad(prior, ((0, 0), (controls * width, 0)))])
    y = np.concatenate([r.ravel(), prior_r])
    expected = np.linalg.lstsq(J, y, rcond=None)[0]
    step, step_border, promised = normal.step(0.0)
    found = np.concatenate([step.ravel(), step_border])
    np.testing.assert_allclose(found, expected, atol=1e-8)
    left = y - J @ expected
    assert promised == pytest.approx(y @ y - left @ left, rel=1e-8)

    normal.hold([1, 2])
    step, step_border, _ = normal.step(0.0)
    expected = np.linalg.lstsq(J[:, : controls * width + 1], y, rcond=None)[0]
    np.testing.assert_allclose([*step.ravel(), *step_border], [*expected, 0.0, 0.0], atol=1e-8)
