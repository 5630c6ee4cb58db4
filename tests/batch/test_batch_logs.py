"""What arguments of a batch lead to."""

import os
from collections.abc import Iterable
from pathlib import Path

import pytest

from imucalib_cli.batch.logs import find_logs
from imucalib_cli.cli.files import names_in
from imucalib_cli.logs.mcap.write import McapWriter
from imucalib_cli.logs.open import open_files

METADATA = "rosbag2_bagfile_information:\n  relative_file_paths: [a_0.mcap]\n"


def made(root: Path, *files: str) -> None:
    for name in files:
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(METADATA if path.name == "metadata.yaml" else "")


def found(root: Path, *names: object, left_out: Path | None = None) -> list[list[str]]:
    logs = find_logs(map(str, names), left_out=left_out).logs
    return [[os.path.relpath(str(path), root) for path in log.paths] for log in logs]


def test_each_recording_in_a_folder_is_one_log(tmp_path: Path) -> None:
    made(
        tmp_path,
        "day/b.mcap",
        "day/a.bag",
        "day/note.txt",
        "day/.hidden.mcap",
        "day/.git/x.mcap",
        "day/drive/metadata.yaml",
        "day/drive/a_0.mcap",
        "day/flight/mav0/imu0/data.csv",
        "day/deep/er/c.db3",
    )
    logs = [["a.bag"], ["b.mcap"], ["deep/er/c.db3"], ["drive"], ["flight"]]
    assert found(tmp_path / "day", tmp_path / "day") == logs
    assert found(tmp_path / "day", tmp_path / "day", left_out=tmp_path / "day" / "deep") == [
        each for each in logs if each != ["deep/er/c.db3"]
    ]
    assert found(tmp_path, tmp_path / "day" / "drive") == [["day/drive"]]
    assert found(tmp_path, tmp_path / "day/flight/mav0") == [["day/flight/mav0"]]


def test_log_files_are_detected_by_content(tmp_path: Path) -> None:
    (tmp_path / "log.recorded").write_bytes(b"#ROSBAG V2.0\n")
    (tmp_path / "readme").write_text("no log")
    assert found(tmp_path, tmp_path) == [["log.recorded"]]


def test_text_beside_logs_is_no_log(tmp_path: Path) -> None:
    """A table is one if its columns are those of an IMU or of joints, by the documented names."""
    texts = {
        "imu.csv": "t,gx,gy,gz,ax,ay,az,joint.elbow\n0,0,0,0,0,0,9.8,1\n",
        "joints.csv": "t,joint.elbow\n0,1\n",
        "notes.txt": "time, x, y\nhello\n",
        "replay.py": "import subprocess,signal,time,sys,os\nos.nice(5)\n",
        "temperature.csv": "time,celsius\n0,36.6\n",
        "truth.tum": "0 0 0 0 0 0 0 1\n",
    }
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    assert found(tmp_path, tmp_path) == [["imu.csv"], ["joints.csv"]]


@pytest.mark.parametrize(
    "motion", ["joint.elbow\n0,1", "elbow\n0,1", "x,y,z,qx,qy,qz,qw\n" + "0," * 7 + "1"]
)
def test_tables_that_need_each_other_are_one_recording(tmp_path: Path, motion: str) -> None:
    """As for a run."""
    day = tmp_path / "day"
    made(day, "readme.txt", "below/a.mcap")
    imu = "t,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n"
    (day / "imu.csv").write_text(imu)
    assert found(day, day) == [["imu.csv"], ["below/a.mcap"]]
    (day / "motion.csv").write_text(f"t,{motion}\n")
    assert found(day, day) == [["."], ["below/a.mcap"]]
    (day / "other.csv").write_text(imu.replace("az", "az,joint.elbow").replace("9.8", "9.8,1"))
    assert ["other.csv"] in found(day, day)


def test_numbered_parts_in_a_folder_are_one_recording(tmp_path: Path) -> None:
    made(tmp_path, "r_0.mcap", "r_1.mcap", "r_10.bag", "day_1.mcap", "day_2.mcap", "s_0.bag")
    made(tmp_path, "r_00.mcap")
    parts = [["day_1.mcap"], ["day_2.mcap"], ["r_0.mcap", "r_1.mcap"], ["r_00.mcap"], ["r_10.bag"]]
    parts += [["s_0.bag"]]
    assert sorted(found(tmp_path, tmp_path)) == parts
    # named one by one each is its own
    assert found(tmp_path, tmp_path / "r_?.mcap") == [["r_0.mcap"], ["r_1.mcap"]]
    made(tmp_path / "many", *(f"r_{number}.mcap" for number in range(11)))
    assert found(tmp_path / "many", tmp_path / "many") == [[f"r_{k}.mcap" for k in range(11)]]


def test_joining_parts_by_name_is_reported(tmp_path: Path) -> None:
    made(tmp_path, *(f"run_{number}.mcap" for number in range(20)), "other.mcap")
    (finding,) = find_logs([str(tmp_path)]).findings
    assert finding.values["others"] == 19
    pattern = finding.values["pattern"]
    assert isinstance(pattern, str)
    assert len(find_logs([pattern]).logs) == 20


def test_files_beside_results_are_not_logs(tmp_path: Path) -> None:
    for name in ("log.mcap", "log.debug-mcap.mcap"):
        library = "imucalib run --debug-mcap" if "debug" in name else "a recorder"
        with (tmp_path / name).open("wb") as file:
            McapWriter(file, library=library).close()
    head = "time_s,stamp_ns,accel_x_measured_m_s2,accel_y_measured_m_s2,accel_z_measured_m_s2\n"
    (tmp_path / "log.residuals.csv").write_text(head)
    assert found(tmp_path, tmp_path) == [["log.mcap"]]
    (log,) = open_files(tmp_path)
    assert str(log.path) == str(tmp_path / "log.mcap")
    named = tmp_path / "log.debug-mcap.mcap"
    assert found(tmp_path, named) == [
        ["log.debug-mcap.mcap"]
    ]  # a file that is named explicitly counts as a log


def test_each_url_is_a_separate_log() -> None:
    one, other = "https://host/get.mcap?id=1", "https://host/get.mcap?id=2"
    logs = find_logs([one, other, one]).logs
    assert len({log.place for log in logs}) == 2
    assert {log.label for log in logs} == {"https://host/get.mcap?…"}
    assert not any("id=" in log.place for log in logs)


def test_patterns_are_expanded_and_missing_paths_kept(tmp_path: Path) -> None:
    made(tmp_path, "x/a.mcap", "y/b.mcap", "[c].mcap")
    assert found(tmp_path, tmp_path / "**" / "?.mcap") == [["x/a.mcap"], ["y/b.mcap"]]
    assert found(tmp_path, tmp_path / "[c].mcap") == [["[c].mcap"]]  # a name, though it looks so
    (tmp_path / "empty").mkdir()
    names = ("*.db3", "gone", "empty")
    assert found(tmp_path, *(tmp_path / name for name in names)) == [[name] for name in names]


def test_log_with_several_paths_is_found_once(tmp_path: Path) -> None:
    made(tmp_path, "a.mcap", "drive/metadata.yaml", "drive/a_0.mcap")
    (tmp_path / "link.mcap").symlink_to("a.mcap")
    os.link(tmp_path / "a.mcap", tmp_path / "hard.mcap")
    names = ["a.mcap", "./a.mcap", "link.mcap", "hard.mcap", "drive", "drive/metadata.yaml"]
    search = find_logs(str(tmp_path / name) for name in names)
    assert [Path(log.label).name for log in search.logs] == ["a.mcap", "drive"]
    assert [each.code for each in search.findings] == ["batch.log_twice"] * 4


def test_broken_and_cyclic_links_are_kept_and_pipes_not_opened(tmp_path: Path) -> None:
    (tmp_path / "gone.mcap").symlink_to("nowhere")
    (tmp_path / "round.mcap").symlink_to("round.mcap")
    (tmp_path / "inner").symlink_to(tmp_path)
    os.mkfifo(tmp_path / "pipe.mcap")
    os.mkfifo(tmp_path / "pipe")
    assert found(tmp_path, tmp_path) == [["gone.mcap"], ["pipe.mcap"], ["round.mcap"]]


@pytest.mark.parametrize(
    ("data", "names"),
    [
        (b"a\nb c\n\n", ["a", "b c"]),
        (b"a\r\nb", ["a", "b"]),
        (b"a\nb\0c\0", ["a\nb", "c"]),
        (b"", []),
        ("ä\n".encode(), ["ä"]),
        (b"\xff.mcap\n", ["\udcff.mcap"]),
    ],
)
def test_list_file_is_split_into_names(data: bytes, names: Iterable[str]) -> None:
    assert names_in(data) == names


def test_non_utf8_names_have_printable_labels() -> None:
    log, other = find_logs(["/nowhere/\udcff.mcap", "/nowhere/\udcfe.mcap"]).logs
    assert log.label == other.label == "/nowhere/\ufffd.mcap"
    assert log.place != other.place
    log.place.encode()
