"""Prefixes by which names of a log differ from those of a URDF; expected ones are by hand."""

import time

import pytest

from imucalib_cli.robot.names import names_in_urdf, prefixes

JOINTS = ("pan", "lift", "wrist_roll")


@pytest.mark.parametrize(
    ("names", "known", "hints", "expected"),
    [
        (("pan", "lift"), JOINTS, "", ()),
        (("left_pan", "left_lift"), JOINTS, "", ("left_",)),
        (("ur5/pan", "ur5/lift"), JOINTS, "", ("ur5/",)),
        (("robot::pan", "lift"), JOINTS, "", ("robot::",)),
        (("leftpan", "leftlift"), JOINTS, "", ()),
        # most names count
        (("a_pan", "b_pan", "b_lift"), JOINTS, "", ("b_",)),
        (("l_pan", "r_pan"), JOINTS, "", ("l_", "r_")),
        (("l_pan", "r_pan"), JOINTS, "/r/imu", ("r_",)),
        # a URDF of two arms, a topic of one
        (("pan", "lift"), ("l_pan", "l_lift", "r_pan", "r_lift"), "/l/joint_states", ("l_",)),
        (("pan", "lift"), ("l_pan", "l_lift", "r_pan", "r_lift"), "/joints", ("l_", "r_")),
        # wrist_roll is a joint of its own, not a prefixed roll
        (("wrist_roll", "a_roll"), ("wrist_roll", "roll"), "", ("a_",)),
        (("finger",), JOINTS, "", ()),
    ],
)
def test_joint_names_match_with_prefixes(
    names: tuple[str, ...], known: tuple[str, ...], hints: str, expected: tuple[str, ...]
) -> None:
    assert prefixes(names, known, hints) == expected


def test_thousands_of_names_take_no_time() -> None:
    known = [f"link_{k}" for k in range(5000)]
    begin = time.process_time()
    assert prefixes([f"r1/{name}" for name in known], known) == ("r1/",)
    assert time.process_time() - begin < 2.0


def test_prefix_may_be_on_either_side() -> None:
    assert names_in_urdf(("l_pan", "x"), JOINTS, "l_") == {"l_pan": "pan"}
    assert names_in_urdf(("pan", "x"), ("l_pan", "r_pan"), "l_") == {"pan": "l_pan"}
    # a name that is there already is not taken twice
    assert names_in_urdf(("pan", "l_pan"), JOINTS, "l_") == {}
