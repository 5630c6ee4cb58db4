"""The recipes of CONTRIBUTING, each run as printed there, and imucalib with it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from imucalib_cli.logs.log import open_log
from tests.processes import python

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "sample_data"
PARTS = re.split(r"^### ", (ROOT / "CONTRIBUTING.md").read_text("utf-8"), flags=re.MULTILINE)
ARM = ("run", f"{SAMPLE}/rihibot.mcap", "--urdf", f"{SAMPLE}/rihibot.urdf", "-q")
BODY: tuple[str, ...] = ("--parent", "sensor_body", "--to", "15", "--format", "json", "-q")
BODY += ("--robot", "exact", "--sensor-model", "ideal")


def _with_recipe(recipe: str, *commands: tuple[str, ...]) -> str:
    """What imucalib writes to stdout in a process of its own, the code of a recipe run before."""
    (part,) = (each for each in PARTS if each.startswith(f"{recipe}\n"))
    (code,) = re.findall(r"```python\n(.*?)```", part, flags=re.DOTALL)
    given = [list(command) for command in commands]
    start = f"from imucalib_cli.cli.main import main\nraise SystemExit(max(map(main, {given})))"
    done = python("-c", f"{code}\n{start}")
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_log_format_recipe_works(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A recording written in the format gives the pose that it gives as it is."""
    from imucalib_cli.cli.main import main

    recorded = SAMPLE / "broad_21_cut.mcap"
    log = open_log([recorded])
    data = log.read([each.name for each in log.topics])
    (imu,) = data.imus.values()
    ((body,),) = data.poses.values()
    rows = [
        (int(t), [*map(repr, values.tolist()), *[""] * 7])
        for t, values in zip(imu.header_ns, np.hstack([imu.gyro, imu.accel]), strict=True)
    ]
    rows += [
        (int(t), [*[""] * 6, *map(repr, values.tolist())])
        for t, values in zip(
            body.header_ns, np.hstack([body.position, body.quaternion_xyzw]), strict=True
        )
    ]
    rows.sort(key=lambda row: row[0])
    rows = rows[: len(rows) // 3]  # more than what is used
    table = tmp_path / "recording.toy"
    lines = (",".join([str(t), *cells]) for t, cells in rows)
    table.write_text("\n".join(lines) + "\n")

    found = json.loads(_with_recipe("A log format", ("run", str(table), *BODY)))
    assert main(["run", str(recorded), *BODY]) == 0
    expected = json.loads(capfd.readouterr().out)
    for key in ("translation", "rotation_xyzw"):
        assert found["transform"][key] == pytest.approx(expected["transform"][key], abs=1e-6)


@pytest.mark.slow
def test_unknown_recipe_works() -> None:
    """It is estimated with the others, and is nothing in a log that has none of it."""
    found = json.loads(_with_recipe("An unknown", (*ARM, "--format", "json")))
    assert found["status"] == "ok"
    parameters = found["diagnostics"]["parameters"]
    of_it = [each for each in parameters if each["name"] == "accel_rate_sensitivity"]
    assert [each["label"] for each in of_it] == ["x", "y", "z"]
    for each in of_it:
        assert 0.0 < each["std"] < each["prior_std"]
        assert abs(each["value"]) < 4.0 * each["std"]


@pytest.mark.slow
def test_output_recipe_works(tmp_path: Path) -> None:
    table = (*ARM, "--format", "table")
    into = (*table, "-o", f"{tmp_path}/new/")
    *words, last = _with_recipe("An output", ("run", "--help"), into, table).splitlines()
    assert any("table" in each for each in words)
    parent, child, *place = last.split(",")
    assert (parent, child) == ("wrist_3_link", "imu_link")
    assert [float(each) for each in place] == pytest.approx([-0.0225, 0.1, 0.0], abs=1e-4)
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["rihibot.imu_link.csv"]
