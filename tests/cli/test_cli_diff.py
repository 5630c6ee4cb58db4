"""`imucalib diff` from two files to an exit code: pairs, frames, several IMUs."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib_cli.results.codec import to_json, to_yaml
from imucalib_cli.results.result import Result
from tests.cli.stand_in import ANSWERS, answers
from tests.conftest import Imucalib
from tests.results.results_samples import UP, make_result

SMALL = np.diag([1e-8] * 3 + [1e-10] * 3)
HERE = np.array([0.1, 0.2, 0.3])


def make(
    shift: Any = (0.0, 0.0, 0.0),
    *,
    child: str = "imu_link",
    parent: str = "hand",
    topic: str = "/imu",
    log: str = "a",
    **more: Any,
) -> Result:
    found = {"R_parent_imu": np.eye(3), "covariance": SMALL, **more}
    names: Any = {"child": child, "parent": parent, "topic": topic, "log": log}
    return make_result(t_parent_imu=HERE + shift, **names, **found)


@pytest.fixture
def write(tmp_path: Path) -> Any:
    def write(name: str, *results: Result) -> Path:
        text = to_json(results) if name.endswith("json") else to_yaml(results)
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


@pytest.fixture
def diff(write: Any, imucalib: Imucalib) -> Imucalib:
    """Of a first result and others."""
    return imucalib.with_("diff", write("a.yaml", make()))


def test_verdict_is_moved_not_moved_or_unknown(write: Any, diff: Imucalib) -> None:
    moved = write("b.json", make([0.0, 0.001, 0.0], log="b"))
    (document,), err = answers(diff(moved, code=4))
    assert document["verdict"] == "moved"
    np.testing.assert_allclose(document["translation"]["vector_mm"], [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(document["translation"]["std_mm"], np.full(3, 0.1 * 2**0.5))
    assert document["test"]["chi2"] == pytest.approx(50.0)
    assert document["test"]["degrees_of_freedom"] == 6
    assert err.startswith("moved: imu_link in hand has moved: 1.00 ± 0.14 mm")
    _, err = answers(diff(write("c.yaml", make([1e-5, 0.0, 0.0], log="b"))))
    assert err.startswith("not moved: imu_link in hand has not moved: ")
    (document,), err = answers(diff(write("d.yaml", make(log="b", unobservable=(UP,))), code=3))
    assert document["translation"]["unknown_directions"] == [[0.0, 0.0, 1.0]]
    assert document["test"]["degrees_of_freedom"] == 5
    assert "unknown: cannot tell whether" in err


def test_within_option_tests_size_of_the_difference(write: Any, diff: Imucalib) -> None:
    second = write("b.yaml", make([0.001, 0.0, 0.0], log="b"))
    (document,), err = answers(diff(second, "--within", "2mm", "-q"))
    assert err == ""
    assert document["within"] == {"translation_mm": 2.0, "rotation_deg": 0.5}
    diff(second, "--within", "0.5mm", code=4)
    diff(second, "--within", "1mm", code=3)


def test_one_result_can_come_from_stdin(write: Any, imucalib: Imucalib) -> None:
    first, second = write("a.yaml", make()), write("b.yaml", make())
    (document,), err = answers(imucalib("diff", "-", second, stdin=first.read_bytes()))
    assert document["first"]["file"] == "standard input"
    assert "warning: standard input and " in err
    assert "were computed from the same log" in err
    assert "one of the files, not two" in imucalib("diff", "-", "-", code=2).err


def test_imus_are_paired_by_frame_and_topic(write: Any, imucalib: Imucalib) -> None:
    # c kept its frame, d its topic; a and b share a frame and differ by topic
    def results(log: str, topic_of_c: str) -> list[Result]:
        names = [("x", "/a"), ("x", "/b"), ("c", topic_of_c), ("d", "/d")]
        return [
            make([i * 0.1, 0, 0], child=child, topic=topic, log=log)
            for i, (child, topic) in enumerate(names)
        ]

    diff, other = imucalib.with_("diff", write("a.yaml", *results("a", "/c"))), results("b", "/new")
    documents, _ = answers(diff(write("b.json", *reversed(other))))
    assert [d["second"]["imu"] for d in documents] == ["/a", "/b", "/new", "/d"]
    documents, err = answers(diff(write("b.yaml", *other[:3]), code=2))
    assert len(documents) == 3
    assert "a.yaml has a result of d (/d), " in err
    assert "b.yaml has none that matches it" in err


URDF = """<robot name="r"><link name="hand"/><link name="plate"/><link name="imu_link"/>
<link name="chip"/>
<joint name="bolt" type="fixed"><parent link="hand"/><child link="plate"/>
<origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/></joint>
<joint name="mount" type="fixed"><parent link="plate"/><child link="imu_link"/></joint>
<joint name="chip_joint" type="fixed"><parent link="imu_link"/><child link="chip"/>
<origin xyz="0 0 0.02"/></joint>
</robot>"""


def test_different_frames_need_the_urdf(write: Any, tmp_path: Path, imucalib: Imucalib) -> None:
    urdf = tmp_path / "r.urdf"
    urdf.write_text(URDF)
    first = write("a.yaml", make())
    # p_hand = (0.1 0 0) + Rz(90 deg) p_plate, and the chip 20 mm further along z
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    in_plate = R.T @ (HERE - [0.1, 0.0, 0.0]) + [0.0, 0.0, 0.02]
    moved = make(in_plate - HERE, parent="plate", child="chip", log="b", R_parent_imu=R.T)
    second = write("b.yaml", moved)
    (document,), _ = answers(imucalib("diff", first, second, "--urdf", urdf))
    np.testing.assert_allclose(document["translation"]["vector_mm"], np.zeros(3), atol=1e-9)
    assert document["rotation"]["difference_deg"] == pytest.approx(0.0, abs=1e-9)


def test_each_later_result_is_compared_with_the_first(
    write: Any, tmp_path: Path, diff: Imucalib
) -> None:
    first, broken = tmp_path / "a.yaml", tmp_path / "d.yaml"
    same, moved = write("b.yaml", make(log="b")), write("c.yaml", make([0.0, 0.001, 0.0], log="c"))
    broken.write_text("schema: 1\n")
    documents, err = answers(diff(same, moved, code=4))
    assert [each["second"]["file"] for each in documents] == [str(same), str(moved)]
    assert [each["verdict"] for each in documents] == ["not moved", "moved"]
    assert f"not moved: {same}: imu_link in hand has not moved" in err
    assert f"moved: {moved}: imu_link in hand has moved" in err
    out, err = diff(broken, same, "--format", "jsonl", "-q", code=1)
    (line,) = out.splitlines()
    ANSWERS.validate(json.loads(line))
    assert err.startswith(f"error: {broken}: status is missing")
    said = diff(same, moved, "--format", "csv", "-q", code=4)
    rows = list(csv.DictReader(io.StringIO(said.out)))
    assert [row["file"] for row in rows] == [str(same), str(moved)]
    assert {row["first"] for row in rows} == {str(first)}
    assert float(rows[1]["distance_mm"]) == pytest.approx(1.0)
    assert float(rows[1]["distance_sigma_mm"]) == pytest.approx(0.1 * 2**0.5, rel=1e-3)
    said = diff(same, moved, "--format", "summary", code=4)
    assert said.out.splitlines()[1].startswith(f"moved: {moved}: imu_link")
