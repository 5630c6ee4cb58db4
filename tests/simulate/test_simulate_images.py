"""Rendered boards, read by OpenCV's detector, and as Kalibr's reads its bits."""

import sys
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.simulate.camera.render import Images, board_picture
from imucalib_cli.simulate.camera.view import see
from imucalib_cli.simulate.camera_config import CameraConfig, load_camera
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.recording import CameraRecord

CAMERA = load_camera("rihibot", load_system("rihibot"))[1]
CODES = {
    0: 0xD5D628584,
    1: 0xD97F18B49,
    2: 0xDD280910E,
    3: 0xE479E9C98,
    6: 0x056A5D085,
    17: 0x683BB6C4C,
    30: 0xE4ABA3076,
    35: 0x686D7002A,
}
"""Some of t36h11 in Kalibr's ethz_apriltag2/include/apriltags/Tag36h11.h."""


def views(camera: CameraConfig = CAMERA) -> CameraRecord:
    """Eight views: straight ahead, aslant, rolled, near, far; by MuJoCo's order w x y z."""
    target = camera.target
    middle = np.add(target.xyz, [0.206, 0.0, 0.206])
    rng = np.random.default_rng(5)
    places, turns = [], []
    for k in range(8):
        offset = np.zeros(3) if k == 0 else rng.uniform([-0.25, -0.1, -0.2], [0.25, 0.1, 0.2])
        place = np.add(middle, [0.0, -0.7, 0.0]) + offset
        forward = (middle - place) / np.linalg.norm(middle - place)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        R = np.column_stack([right, np.cross(forward, right), forward])
        roll = 0.0 if k == 0 else rng.uniform(-0.8, 0.8)
        R = R @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
        w = np.sqrt(max(0.0, 1 + np.trace(R))) / 2
        skew = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
        places.append(place)
        turns.append([w, *(np.array(skew) / (4 * w))])
    return see(camera, np.arange(8.0), np.array(places), np.array(turns))


@pytest.fixture(scope="module")
def record() -> CameraRecord:
    return views()


@pytest.fixture(scope="module")
def images(record: CameraRecord) -> list[NDArray[np.uint8]]:
    drawn = Images(record, NoiseOptions(), 0)
    return [drawn[i] for i in range(len(record.t))]


def corners_of(corners: Floats, number: int) -> Floats:
    """(4, 2): lower left, lower right, upper right, upper left of a tag."""
    grid = corners.reshape(6, 2, 6, 2, 2)
    row, col = divmod(number, 6)
    return np.array([grid[row, y, col, x] for y, x in ((0, 0), (0, 1), (1, 1), (1, 0))])


def refined(image: NDArray[np.uint8], start: Floats, half_window: int = 5) -> Floats:
    """OpenCV's sub-pixel corners, as Kalibr refines its own."""
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    begin = np.ascontiguousarray(start.reshape(-1, 1, 2), dtype=np.float32)
    found = cv2.cornerSubPix(image, begin, (half_window, half_window), (-1, -1), criteria)
    return np.asarray(found[:, 0], dtype=np.float64)


def softened(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """cornerSubPix wants soft edges; a blur moves no symmetric corner."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 1.0), dtype=np.uint8)


def test_tag_bits_match_kalibr(record: CameraRecord, images: list[NDArray[np.uint8]]) -> None:
    """Read as Kalibr's TagDetector.cc: from the upper left, most significant bit first."""
    shades = CAMERA.shades
    middle = (shades.black + shades.white) / 2
    for image, corners in zip(images, record.corners, strict=True):
        for number, code in CODES.items():
            square = corners_of(corners, number)
            if not np.isfinite(square).all():
                continue
            flat = np.array([[0, 10], [10, 10], [10, 0], [0, 0]], dtype=np.float32)  # y down
            H = cv2.getPerspectiveTransform(flat, square.astype(np.float32))
            cells = np.array([[x + 0.5, y + 0.5] for y in range(10) for x in range(10)])
            at = cv2.perspectiveTransform(cells[None], H)[0].round().astype(int)
            white = (image[at[:, 1], at[:, 0]] > middle).reshape(10, 10)
            assert not white[:2].any()  # border of two cells
            assert not white[-2:].any()
            assert not white[:, :2].any()
            assert not white[:, -2:].any()
            read = int("".join("01"[int(bit)] for bit in white[2:8, 2:8].ravel()), 2)
            assert read == code


def test_opencv_detects_every_tag_in_place(
    record: CameraRecord, images: list[NDArray[np.uint8]]
) -> None:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector: Any = cv2.aruco.ArucoDetector(family, parameters)
    for image, corners in zip(images, record.corners, strict=True):
        squares, ids, _ = detector.detectMarkers(image)
        whole = [n for n in range(36) if np.isfinite(corners_of(corners, n)).all()]
        assert set(whole) <= set(ids.ravel())
        assert len(ids) == len(set(ids.ravel()))
        for square, number in zip(squares, ids.ravel(), strict=True):
            # its upper left, clockwise, of a tag that is upside down to it
            lr, ll, ul, ur = square[0]
            off = np.array([ll, lr, ur, ul]) - corners_of(corners, int(number))
            assert not (np.abs(off) > 4).any()  # its contours are rough; NaN where out of view


def test_drawn_corners_match_their_projection(
    record: CameraRecord, images: list[NDArray[np.uint8]]
) -> None:
    rng = np.random.default_rng(1)
    errors = []
    for image, corners in zip(images, record.corners, strict=True):
        seen = corners[np.isfinite(corners[:, 0])]
        start = seen + 0.5 * rng.standard_normal(seen.shape)
        errors.append(refined(softened(image), start) - seen)
    error = np.vstack(errors)
    assert len(error) > 1000
    assert np.abs(error.mean(axis=0)).max() < 0.003  # pixels
    assert error.std() < 0.025
    assert np.abs(error).max() < 0.12


def test_squares_at_all_corners_and_white_border() -> None:
    """Kalibr's symmCorners: a square of the spacing's size at each corner of each tag."""
    picture = board_picture(CAMERA.target, CAMERA.shades)

    def shade(x: float, y: float) -> int:
        column, row, _ = (picture.T_pixel_target @ [x, y, 1.0]).round().astype(int)
        return int(picture.pixels[row, column])

    size, gap = 0.055, 0.055 * 0.3
    pitch = size + gap
    for i in range(7):
        for j in range(7):
            assert shade(i * pitch - gap / 2, j * pitch - gap / 2) == 25
            if i and j:  # gaps between tags
                assert shade(i * pitch - gap / 2, j * pitch - gap - size / 2) == 225
                assert shade(i * pitch - gap - size / 2, j * pitch - gap / 2) == 225
    assert shade(-1.5 * gap, 0.0) == 225


def test_distortion_is_the_same_for_image_and_corners() -> None:
    small = replace(
        CAMERA.intrinsics, width=640, height=360, fx=450.0, fy=450.0, cx=319.5, cy=179.5
    )
    bent = replace(small, distortion=(-0.3, 0.08, 3e-4, -2e-4))
    record, straight = (views(replace(CAMERA, intrinsics=lens)) for lens in (bent, small))
    image = softened(Images(record, NoiseOptions(), 0)[2])
    seen = np.isfinite(record.corners[2, :, 0]) & np.isfinite(straight.corners[2, :, 0])
    assert np.abs(record.corners[2][seen] - straight.corners[2][seen]).max() > 2.0
    error = refined(image, record.corners[2][seen], half_window=3) - record.corners[2][seen]
    assert np.abs(error.mean(axis=0)).max() < 0.01
    assert error.std() < 0.05


def test_noise_is_seeded_and_differs_per_image(record: CameraRecord) -> None:
    clean, noise = Images(record, NoiseOptions(), 0), NoiseOptions(image_noise=3.0)
    one, again, other = (Images(record, noise, seed) for seed in (7, 7, 8))
    last, first = one[3], one[0]  # in any order
    np.testing.assert_array_equal(again[0], first)
    np.testing.assert_array_equal(again[3], last)
    error = first - clean[0].astype(float)
    assert error.std() == pytest.approx(3.0, rel=0.02)
    assert abs(error.mean()) < 0.02
    assert not np.array_equal(other[0], first)
    assert abs(np.corrcoef(error.ravel(), (last - clean[3].astype(float)).ravel())[0, 1]) < 0.01


def test_board_back_and_points_behind_camera_are_not_drawn(record: CameraRecord) -> None:
    for place in ([0.0, 1.5, 0.3], [-0.77, -3.0, 0.27]):
        turned = replace(
            record,
            p_world_camera=np.tile(place, (8, 1)),
            R_world_camera=np.tile(
                np.diag([1.0, -1.0, -1.0]) @ record.R_world_camera[0], (8, 1, 1)
            ),
        )
        assert (Images(turned, NoiseOptions(), 0)[0] == 140).all()


def test_missing_opencv_error_names_the_package(
    monkeypatch: pytest.MonkeyPatch, record: CameraRecord
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(InputError, match=r"pip install 'imucalib\[camera\]'"):
        Images(record, NoiseOptions(), 0)


def test_undrawable_spacing_is_refused() -> None:
    with pytest.raises(InputError, match=r"multiple of 0.005"):
        board_picture(replace(CAMERA.target, tag_spacing=0.3011), CAMERA.shades)
    with pytest.raises(InputError, match="has 587"):
        board_picture(replace(CAMERA.target, tag_rows=30, tag_cols=20), CAMERA.shades)
