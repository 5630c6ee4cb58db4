"""The pictures of the pages are what the scripts beside them make."""

import re

import pytest

from docs.motions import MOTIONS, PICTURES, lesson, pictures

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("motions")]  # logs are simulated once


def test_motion_pictures_match_their_script() -> None:
    """Another version of MuJoCo may differ in the last digits."""
    made = pictures()
    assert {path.stem for path in PICTURES.glob("*.svg")} == set(made)
    for name, picture in made.items():
        kept = _label((PICTURES / f"{name}.svg").read_text("utf-8"))
        drawn = _label(picture)
        assert re.sub(r"[\d.]+", "#", drawn) == re.sub(r"[\d.]+", "#", kept)
        for here, there in zip(_numbers(drawn), _numbers(kept), strict=True):
            assert here == pytest.approx(there, rel=0.1)


def test_motions_show_the_stated_observability() -> None:
    known = {name: lesson(name).known for name in MOTIONS}
    for one_axis in ("base-joint", "last-joint"):
        assert known.pop(one_axis) == [False, False, False, True, True, False]
    assert all(all(each) for each in known.values())
    worst = {name: lesson(name).std[:3].max() for name in known}
    assert worst["slowly"] > 10.0 * worst["all-joints"]
    assert worst["all-joints"] < 0.5 * worst["each-joint"]
    assert worst["each-joint"] == pytest.approx(worst["two-joints"], rel=0.2)


def _label(picture: str) -> str:
    (label,) = re.findall(r'aria-label="([^"]*)"', picture)
    return str(label)


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"\d+\.\d+|\d+", text)]
