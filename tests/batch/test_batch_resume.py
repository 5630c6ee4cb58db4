"""What is finished in a folder is not done again, and killed at any moment nothing is lost."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from imucalib_cli.batch import folder as folder_module
from imucalib_cli.batch.folder import ResultFolder
from imucalib_cli.batch.logs import BatchLog
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.results.atomic import write_whole
from tests.batch.batch_tasks import Copying, batch, copying

if TYPE_CHECKING:
    from imucalib_cli.batch.batch import Batch
    from imucalib_cli.findings import Finding

ROOT = Path(__file__).parents[2]
OLD = time.time() - 1000.0


class Scene:
    """Logs that are texts, and a folder of results."""

    def __init__(self, root: Path) -> None:
        self.logs, self.results, self.root = root / "logs", root / "results", root
        self.logs.mkdir()
        self.task = copying(root / "traces")

    def log(self, name: str, text: str) -> Path:
        path = self.logs / f"{name}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        os.utime(path, (OLD, OLD))  # long settled
        return path

    def batch(self, *names: object, task: Copying | None = None, **changes: Any) -> Batch:
        return batch(self.results, *(names or [self.logs]), task=task or self.task, **changes)

    def run(self, *names: object, task: Copying | None = None, **changes: Any) -> list[str]:
        """Names of the logs that were worked on."""
        before = set(self.task.traces.iterdir())
        told = list(self.batch(*names, task=task, **changes).run())
        assert len(told) == len({log for log, _ in told})
        return sorted(
            path.name.rpartition(".")[0] for path in set(self.task.traces.iterdir()) - before
        )

    def files(self) -> dict[str, str]:
        """Of the folder, without records."""
        return {path.name: path.read_text() for path in self.results.iterdir() if path.is_file()}

    def results_of(self) -> dict[str, str]:
        """Of all logs by their texts."""
        return {name: text for name, text in self.files().items() if name != "summary.csv"}


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    return Scene(tmp_path)


def test_finished_logs_are_not_processed_again(scene: Scene) -> None:
    scene.log("a", "1")
    scene.log("b", "2")
    assert scene.run() == ["a", "b"]
    before = scene.files()
    assert scene.run() == []
    assert scene.files() == before
    scene.log("c", "3")
    assert scene.run() == ["c"]
    assert scene.run(fresh=True) == ["a", "b", "c"]


def test_changed_log_or_options_are_processed(scene: Scene) -> None:
    scene.log("a", "1")
    scene.log("b", "2")
    scene.run()
    scene.log("a", "changed")
    assert scene.run() == ["a"]
    assert scene.results_of()["a.a.yaml"] == "changed"
    other = replace(scene.task, context="other options")
    assert scene.run(task=other) == ["a", "b"]
    # the results are of these options now
    assert scene.run() == ["a", "b"]


def test_log_is_identified_by_content_not_mtime(scene: Scene) -> None:
    log = scene.log("a", "1")
    scene.run()
    log.write_text("2")
    os.utime(log, (OLD, OLD))
    assert scene.run() == []  # size and time are as they were, and trusted
    assert scene.run(rehash=True) == ["a"]
    log.touch()
    assert scene.run() == []


def test_change_right_after_hashing_is_detected(scene: Scene) -> None:
    log = scene.log("a", "1")
    log.touch()
    scene.run()
    found = log.stat()
    log.write_text("2")
    os.utime(log, ns=(found.st_atime_ns, found.st_mtime_ns))  # as of a coarse clock
    assert scene.run() == ["a"]


def test_moved_log_counts_as_finished(scene: Scene) -> None:
    log = scene.log("a", "1")
    scene.run()
    log.rename(scene.logs / "b.mcap")
    assert scene.run() == []
    scene.log("b", "longer")
    assert scene.run() == ["a"]  # it keeps its name in the folder
    assert sorted(scene.results_of()) == ["a.a.yaml", "a.b.yaml"]


def test_copied_log_is_a_separate_log(scene: Scene) -> None:
    scene.log("a", "1")
    scene.log("b", "1")
    assert scene.run() == ["a", "b"]
    assert scene.run() == []
    assert len(scene.results_of()) == 4
    scene.log("c", "1")
    assert scene.run() == ["c"]


def test_logs_with_the_same_name_do_not_collide(scene: Scene) -> None:
    for robot in ("red", "green", "blue"):
        scene.log(f"{robot}/monday", robot)
    scene.log("blue/MONDAY", "large")
    first = [scene.logs / "red"]
    scene.run(*first)
    assert scene.run() == ["MONDAY.2", "monday.3", "monday.4"]
    assert sorted(scene.results_of().values()) == sorted(["red", "green", "blue", "large"] * 2)
    scene.log("red/monday", "changed")
    assert scene.run() == ["monday"]
    assert sorted(scene.results_of().values()) == sorted(["changed", "green", "blue", "large"] * 2)


def test_foreign_files_are_not_overwritten(scene: Scene) -> None:
    scene.log("a", "1")
    scene.results.mkdir()
    (scene.results / "a.mine.yaml").write_text("precious")
    (scene.results / "a.txt").write_text("precious")
    assert scene.run() == ["a.2"]
    assert scene.files()["a.mine.yaml"] == "precious"
    assert sorted(scene.results_of()) == ["a.2.a.yaml", "a.2.b.yaml", "a.mine.yaml", "a.txt"]


def test_file_of_one_log_is_not_taken_by_another(scene: Scene) -> None:
    """The IMU b.a of the log x has the file that the IMU a of the log x.b wants."""
    task = replace(scene.task, frames=("b.a",))
    scene.log("x", "1")
    scene.log("x.b", "2 one")
    assert scene.run(task=task) == ["x", "x.b"]
    assert scene.results_of() == {"x.b.a.yaml": "2 one", "x.b.a.2.yaml": "1"}
    assert scene.run(task=task) == []
    assert scene.run(task=task, fresh=True) == ["x", "x.b"]
    assert scene.results_of() == {"x.b.a.yaml": "2 one", "x.b.a.2.yaml": "1"}


@pytest.mark.parametrize("earlier", [True, False])
def test_foreign_summary_is_not_overwritten(scene: Scene, earlier: bool) -> None:
    scene.log("a", "1")
    if earlier:
        assert scene.run() == ["a"]
        assert scene.run() == []  # its own summary is renewed
    scene.results.mkdir(exist_ok=True)
    (scene.results / "summary.csv").write_text("precious")
    with pytest.raises(ChoiceError, match="is not of a batch and would be overwritten"):
        scene.run()
    assert scene.files()["summary.csv"] == "precious"


@pytest.mark.parametrize("content", [None, "", "2", "1 and more"])
def test_modified_result_is_computed_again(scene: Scene, content: str | None) -> None:
    """None was removed."""
    scene.log("a", "1")
    scene.run()
    result = scene.results / "a.b.yaml"
    result.unlink() if content is None else result.write_text(content)
    assert scene.run() == ["a"]
    assert scene.results_of() == {"a.a.yaml": "1", "a.b.yaml": "1"}
    assert scene.run() == []


def test_replaced_log_is_reported(scene: Scene) -> None:
    told: list[Finding] = []
    scene.log("a", "1")
    scene.log("b", "2")
    scene.run(tell=told.append)
    scene.log("a", "another")
    scene.log("c", "3")
    scene.run(tell=told.append)
    assert [(each.code, each.values["log"]) for each in told] == [
        ("batch.log_replaced", str(scene.logs / "a.mcap"))
    ]
    scene.run(tell=told.append, fresh=True)
    assert len(told) == 1


def test_many_logs_with_the_same_name_are_named_quickly(scene: Scene, tmp_path: Path) -> None:
    """Each name is checked once: checking all of them for each of 2000 logs would take hours."""
    logs = [BatchLog((tmp_path / str(number) / "log.mcap",)) for number in range(5_000)]
    folder = ResultFolder(scene.results)
    with folder.opened():
        names = [log.name for log in folder.named(logs, (".yaml",))]
    assert names[:2] == ["log", "log.2"]
    assert len(set(names)) == len(names)


def test_damaged_records_are_computed_again(scene: Scene) -> None:
    for name in "abcd":
        scene.log(name, name)
    scene.run()
    records = scene.results / "records"
    (records / "a.json").write_text("{")
    (records / "b.json").write_text('{"schema": 2}')
    unknown = (records / "c.json").read_text().replace('"exit_code":0', '"exit_code":77')
    (records / "c.json").write_text(unknown)
    assert scene.run() == ["a", "b", "c"]
    assert sorted(scene.results_of()) == sorted(f"{x}.{y}.yaml" for x in "abcd" for y in "ab")


def test_unreadable_log_is_tried_in_every_run(scene: Scene, tmp_path: Path) -> None:
    log = scene.log("a", "1")
    scene.run()
    log.unlink()
    with pytest.raises(FileNotFoundError):  # of the task that reads it
        scene.run(tmp_path / "logs" / "a.mcap")


def test_second_batch_in_same_folder_is_refused(scene: Scene) -> None:
    scene.log("a", "1")
    with ResultFolder(scene.results).opened(), pytest.raises(ChoiceError, match="another batch"):
        scene.run()
    assert scene.run() == ["a"]


def test_output_path_that_is_a_file_is_refused(scene: Scene) -> None:
    scene.results.write_text("")
    scene.log("a", "1")
    with pytest.raises(InputError, match="cannot be made"):
        scene.run()


class Killed(BaseException):
    """Stands for kill -9: nothing of the program may catch it."""


def test_kill_around_any_write_loses_and_repeats_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every moment between two changes of the disk, of a first run and of one with changes."""
    for moment in range(1000):
        (tmp_path / str(moment)).mkdir()
        scene = Scene(tmp_path / str(moment))
        scene.log("a", "1")
        scene.log("b", "2")
        other = replace(scene.task, context="other options")
        scene.run(task=other)
        scene.log("a", "one result")
        scene.log("c", "3")
        killed = _killed_at(moment, scene, monkeypatch)
        scene.run()
        assert scene.run() == []
        assert sorted(scene.results_of().values()) == sorted(["one result", *("23" * 2)])
        if not killed:
            break
    assert moment >= 12  # writes: names, and of each log what was there, the results, the record


def _killed_at(moment: int, scene: Scene, monkeypatch: pytest.MonkeyPatch) -> bool:
    left = moment

    def deadly(path: Path, content: str | bytes) -> None:
        nonlocal left
        if left == 0:
            raise Killed
        left -= 1
        write_whole(path, content)

    with monkeypatch.context() as patched:
        patched.setattr(folder_module, "write_whole", deadly)
        try:
            scene.run()
        except Killed:
            return True
    return False


@pytest.mark.slow
def test_kill_at_random_time_loses_nothing(tmp_path: Path) -> None:
    """A process that is killed repeatedly gives the same final results as one that is not."""
    scene = Scene(tmp_path)
    texts = {f"log{number}": str(number) for number in range(60)}
    for name, text in texts.items():
        scene.log(name, text)
    command = [sys.executable, "-m", "tests.batch.batch_tasks", str(scene.results)]
    command += [str(scene.logs), str(scene.task.traces), "0.01"]
    chance = random.Random(13)  # noqa: S311 - no secret
    kills = 0
    for _ in range(25):
        begun = len(list(scene.task.traces.iterdir()))
        process = subprocess.Popen(command, cwd=ROOT)
        while len(list(scene.task.traces.iterdir())) == begun and process.poll() is None:
            time.sleep(0.001)
        time.sleep(chance.uniform(0.0, 0.1))
        kills += process.poll() is None
        process.kill()
        process.wait()
    assert kills >= 5
    recorded = {path.stem for path in (scene.results / "records").glob("[!.]*.json")}
    assert recorded
    assert set(scene.run()) == texts.keys() - recorded
    for partial in scene.results.glob("**/.*.part"):
        os.utime(partial, (OLD, OLD))
    assert scene.run() == []
    expected = {f"{name}.{imu}.yaml": text for name, text in texts.items() for imu in "ab"}
    assert scene.results_of() == expected
    worked = len(list(scene.task.traces.iterdir()))
    assert worked <= len(texts) + kills + 1
