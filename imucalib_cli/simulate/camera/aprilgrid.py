"""The picture of an AprilGrid: tags of 36h11 with Kalibr's border, order and corner squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.optional import optional

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Bytes, Floats
    from imucalib_cli.simulate.camera.config import AprilGrid, Shades


BITS = 6
"""Data cells along an edge of a tag of 36h11."""
BORDER_BITS = 2
"""Black cells around them: borderBits of kalibr_create_target_pdf, blackTagBorder of Kalibr's
AprilgridOptions. (Tags of other detectors have 1.)"""
_CELL = 20
"""Pixels of the picture along an edge of a cell: finer than in any camera image here."""


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


def tag_cells(number: int, border_bits: int = BORDER_BITS) -> Bools:
    """White cells of an upright tag on the board, top row first.

    Kalibr draws the 36 bits of a code from the most significant one, row by row from the upper
    left (kalibr_create_target_pdf, generateAprilTag with rotation=2). OpenCV's dictionary has
    the same tags, upside down.

    Returns:
        (6 + 2 border_bits, 6 + 2 border_bits).

    Raises:
        InputError: OpenCV is not installed.
    """
    cv2 = opencv()
    edge = BITS + 2 * border_bits
    drawn = cv2.aruco.generateImageMarker(_family(cv2), number, edge, borderBits=border_bits)
    return np.asarray(np.rot90(drawn, 2) > 0)


def board_picture(target: AprilGrid, shades: Shades, border_bits: int = BORDER_BITS) -> Picture:
    """Draw a board: ids row by row from the lower left, squares at the corners of all tags.

    As kalibr_create_target_pdf does (generateAprilBoard with symmCorners); the paper ends one
    spacing outside the outermost squares.

    Raises:
        InputError: OpenCV is not installed, the family has no so many tags, or the spacing is
            finer than the picture's pixels.
    """
    edge = (BITS + 2 * border_bits) * _CELL
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
            cells = tag_cells(cols * row + col, border_bits)
            left = margin + col * pitch
            top = height - margin - row * pitch - edge
            white[top - gap : top + edge + gap, left - gap : left + edge + gap] &= _corners(
                edge, gap
            )
            white[top : top + edge, left : left + edge] = np.kron(cells, np.ones((_CELL, _CELL)))
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


def _corners(edge: int, gap: int) -> Bools:
    """White around a tag, except for squares at its corners, which make the corners symmetric."""
    around = np.ones((edge + 2 * gap, edge + 2 * gap), dtype=bool)
    for rows in (slice(gap), slice(-gap, None)):
        for cols in (slice(gap), slice(-gap, None)):
            around[rows, cols] = False
    return around
