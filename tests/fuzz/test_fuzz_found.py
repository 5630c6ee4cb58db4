"""Wrong answers that the fuzzer found: an answer that is ok must be right."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.fuzz import check as checking
from tests.fuzz import seeds
from tests.fuzz.cases import Case
from tests.fuzz.mutate_messages import values_of, with_values

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt


@pytest.mark.parametrize(("count", "size"), [(7, 0.1), (7, 1.0), (3, 2 * np.pi), (20, 0.1)])
def test_an_encoder_that_leaps_a_few_times(count: int, size: float, tmp_path: Path) -> None:
    """Once 90 mm off, with a sigma of 4 mm, and ok: leaps pull the lever arm to nothing."""
    scene = seeds.arm()
    messages = list(scene.messages)
    joints = [k for k, each in enumerate(messages) if each.type == seeds.JOINTS]
    chosen: npt.NDArray[np.int64] = np.random.default_rng(0).choice(joints, count, replace=False)
    for k in chosen.tolist():
        values = values_of(messages[k])
        values[5] += size
        messages[k] = with_values(messages[k], values)
    log, urdf = tmp_path / "in" / "log", tmp_path / "robot.urdf"
    log.parent.mkdir()
    seeds.write(log, seeds.as_said(tuple(messages), "mcap-none"), "mcap-none")
    assert scene.urdf is not None
    urdf.write_bytes(scene.urdf)
    argv = ["run", str(log), "--urdf", str(urdf), "-o", str(tmp_path / "result.yaml")]
    code, findings = checking.check(Case("", argv, tmp_path, scene, [log]))
    assert findings == []
    assert code in {0, 3}
    told = (tmp_path / "result.yaml").read_text()
    assert "messages in which a value leaps away and back" in told
