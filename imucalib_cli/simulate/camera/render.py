"""Images of an AprilGrid by homography, anti-aliased, one at a time.

Tags are of the family 36h11 with Kalibr's border, order and corner squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.optional import optional
from imucalib_cli.simulate.camera.view import project

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.arrays import Bools, Bytes, Floats
    from imucalib_cli.simulate.camera_config import AprilGrid, Intrinsics, Shades
    from imucalib_cli.simulate.options import NoiseOptions
    from imucalib_cli.simulate.recording import CameraRecord


_BORDER_BITS = 2
"""Black cells around a tag: borderBits of kalibr_create_target_pdf, blackTagBorder of Kalibr's
AprilgridOptions. (Tags of other detectors have 1.)"""
_EDGE = 6 + 2 * _BORDER_BITS
"""Cells along an edge of a tag of 36h11, which has 6 x 6 data cells."""
_CELL = 20
"""Pixels of the picture along an edge of a cell: finer than in any camera image here."""
_FINE = 4
"""Samples along an edge of a pixel: 16 are averaged for each."""
_OUTLINE = 64
"""Points along an edge of the paper, which distortion bends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A board as printed."""

    pixels: Bytes
    """(H, W), top row first."""
    T_pixel_target: Floats
    """(3, 3), homogeneous: points (x, y) of the target, m, to columns and rows of the picture,
    where whole numbers are centres of pixels."""
    outline: Floats
    """(4, 2), corners of the paper in the target's frame, m."""


def opencv() -> Any:
    """OpenCV, which is optional.

    Raises:
        InputError: It is not installed.
    """
    return optional("cv2", "images need", "camera")


def _family(cv2: Any) -> Any:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def tag_cells(number: int) -> Bools:
    """White cells of an upright tag on the board, top row first.

    Kalibr draws the 36 bits of a code from the most significant one, row by row from the upper
    left (kalibr_create_target_pdf, generateAprilTag with rotation=2). OpenCV's dictionary has
    the same tags, upside down.

    Returns:
        (_EDGE, _EDGE).

    Raises:
        InputError: OpenCV is not installed.
    """
    cv2 = opencv()
    drawn = cv2.aruco.generateImageMarker(_family(cv2), number, _EDGE, borderBits=_BORDER_BITS)
    return np.asarray(np.rot90(drawn, 2) > 0)


def board_picture(target: AprilGrid, shades: Shades) -> Picture:
    """Draw a board: ids row by row from the lower left, squares at the corners of all tags.

    As kalibr_create_target_pdf does (generateAprilBoard with symmCorners); the paper ends one
    spacing outside the outermost squares.

    Raises:
        InputError: OpenCV is not installed, the family has no so many tags, or the spacing is
            finer than the picture's pixels.
    """
    edge = _EDGE * _CELL
    gap = round(target.tag_spacing * edge)
    if abs(gap - target.tag_spacing * edge) > 1e-6:
        raise InputError(f"tag_spacing {target.tag_spacing:g}: must be a multiple of {1 / edge:g}")
    rows, cols = target.tag_rows, target.tag_cols
    known = len(_family(opencv()).bytesList)
    if rows * cols > known:
        raise InputError(f"{rows} x {cols} tags: the family 36h11 has {known}")
    margin, pitch = 2 * gap, edge + gap
    height, width = ((n - 1) * pitch + edge + 2 * margin for n in (rows, cols))
    white = np.ones((height, width), dtype=bool)
    for row in range(rows):
        for col in range(cols):
            cells = tag_cells(cols * row + col)
            left = margin + col * pitch
            top = height - margin - row * pitch - edge
            white[top : top + edge, left : left + edge] = np.kron(cells, np.ones((_CELL, _CELL)))
            for y, x in product((top - gap, top + edge), (left - gap, left + edge)):
                white[y : y + gap, x : x + gap] = False  # makes the corner symmetric
    scale = edge / target.tag_size
    T_pixel_target = np.array(
        [[scale, 0.0, margin - 0.5], [0.0, -scale, height - margin - 0.5], [0.0, 0.0, 1.0]]
    )
    low, high = -margin / scale, np.array([width - margin, height - margin]) / scale
    return Picture(
        pixels=np.where(white, round(shades.white), round(shades.black)).astype(np.uint8),
        T_pixel_target=T_pixel_target,
        outline=np.array([[low, low], [high[0], low], high, [low, high[1]]]),
    )


class Images:
    """Images of a record, rendered on request.

    The target is flat, so each image is one homography.
    """

    def __init__(self, record: CameraRecord, noise: NoiseOptions, seed: int) -> None:
        """Draw the picture of the board; the noise of every image has its own random stream.

        Raises:
            InputError: OpenCV is not installed, or the board cannot be drawn.
        """
        camera = record.config
        self._cv2 = opencv()
        self._record, self._seed = record, seed
        self._noise, self._blur = noise.image_noise, noise.image_blur
        self._lens, self._background = camera.intrinsics, camera.shades.background
        self._picture = board_picture(camera.target, camera.shades)
        self._rays = _fine_rays(camera.intrinsics) if any(camera.intrinsics.distortion) else None

    def __getitem__(self, i: int) -> Bytes:
        """(height, width), grey levels."""
        record = self._record
        R_camera_world = record.R_world_camera[i].T
        p_camera_target = R_camera_world @ (record.p_world_target - record.p_world_camera[i])
        image = self._render(R_camera_world @ record.R_world_target, p_camera_target)
        if self._blur:
            image = np.asarray(self._cv2.GaussianBlur(image, (0, 0), self._blur), dtype=np.uint8)
        if self._noise:
            rng = np.random.default_rng([self._seed, i])
            noisy = image + self._noise * rng.standard_normal(image.shape, dtype=np.float32)
            image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return image

    def _render(self, R_camera_target: Floats, p_camera_target: Floats) -> Bytes:
        lens = self._lens
        image = np.full((lens.height, lens.width), round(self._background), dtype=np.uint8)
        box = self._box(R_camera_target, p_camera_target)
        if box is None:
            return image
        left, top, right, bottom = box
        # columns x, y, 1 of the target to rays (x, y, 1) before the camera
        H = np.column_stack([R_camera_target[:, :2], p_camera_target])
        to_picture = self._picture.T_pixel_target @ np.linalg.inv(H)
        fine = self._sample(to_picture, box)
        size = (right - left, bottom - top)
        # the area's average, which is exact for whole factors
        image[top:bottom, left:right] = self._cv2.resize(
            fine, size, interpolation=self._cv2.INTER_AREA
        )
        return image

    def _sample(self, to_picture: Floats, box: tuple[int, int, int, int]) -> Bytes:
        """The picture at the fine samples of a part of the image."""
        cv2, lens = self._cv2, self._lens
        left, top, right, bottom = box
        shades = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": self._background}
        if self._rays is None:
            first = 0.5 / _FINE - 0.5  # of the first fine sample, from its pixel's centre
            to_ray = np.array(
                [
                    [1 / _FINE / lens.fx, 0.0, (left + first - lens.cx) / lens.fx],
                    [0.0, 1 / _FINE / lens.fy, (top + first - lens.cy) / lens.fy],
                    [0.0, 0.0, 1.0],
                ]
            )
            size = ((right - left) * _FINE, (bottom - top) * _FINE)
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            fine = cv2.warpPerspective(
                self._picture.pixels, to_picture @ to_ray, size, flags=flags, **shades
            )
        else:
            part = self._rays[top * _FINE : bottom * _FINE, left * _FINE : right * _FINE]
            u, v = np.moveaxis(part, -1, 0)
            x, y, w = (a * u + b * v + c for a, b, c in to_picture.astype(np.float32))
            fine = cv2.remap(self._picture.pixels, x / w, y / w, cv2.INTER_LINEAR, **shades)
        return np.asarray(fine, dtype=np.uint8)

    def _box(
        self, R_camera_target: Floats, p_camera_target: Floats
    ) -> tuple[int, int, int, int] | None:
        """Left, top, right, bottom of the part that may show the board; None if there is none."""
        share = np.arange(_OUTLINE)[:, None] / _OUTLINE
        corners = self._picture.outline
        edges = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
        flat = np.vstack(edges)
        points = flat @ R_camera_target[:, :2].T + p_camera_target
        facing = R_camera_target[:, 2] @ p_camera_target < 0
        pixels = project(self._lens, points)
        if not facing or not np.isfinite(pixels).any():
            return None
        whole = (0, 0, self._lens.width, self._lens.height)
        if not np.isfinite(pixels).all():  # partly behind the camera
            return whole
        low = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - 1, 0)
        high = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + 2, whole[2:])
        if (high <= low).any():
            return None
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _fine_rays(lens: Intrinsics) -> NDArray[np.float32]:
    """Rays (x, y, 1) of all fine samples of an image, (rows, columns, 2), distortion undone.

    By fixed-point iteration at whole pixels and linearly between them.
    """
    u, v = np.meshgrid(np.arange(-1.0, lens.width + 1), np.arange(-1.0, lens.height + 1))
    focal, middle = np.array([lens.fx, lens.fy]), np.array([lens.cx, lens.cy])
    distorted = (np.stack([u, v], axis=-1) - middle) / focal
    rays = distorted.copy()
    for _ in range(40):
        pixels = project(lens, np.dstack([rays, np.ones_like(u)]))
        rays += distorted - (pixels - middle) / focal
    fine = opencv().resize(rays, None, fx=_FINE, fy=_FINE)
    inner = slice(_FINE, -_FINE)  # without the pixels around the image
    return np.asarray(fine[inner, inner], dtype=np.float32)
