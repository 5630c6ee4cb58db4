"""Tables of text: CSV, TUM trajectories and EuRoC folders."""

from __future__ import annotations

import random
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zstandard

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.findings import warnings
from imucalib_cli.logs.log import LogData, open_log
from tests.logs.logs_samples import mixed_messages, write_log

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


COUNT = 50
START_NS = 1_403_636_580_838_555_648
STAMPS = START_NS + 5_000_123 * np.arange(COUNT)
VALUES = np.random.default_rng(5).normal(size=(COUNT, 6))
POSES = np.random.default_rng(6).normal(size=(COUNT, 7))
POSES[:, 3:] /= np.linalg.norm(POSES[:, 3:], axis=1)[:, None]
IMU_HEADER = "t_ns,gx,gy,gz,ax,ay,az"
TIMED = IMU_HEADER.replace("t_ns", "t")
"""Without the unit of the times."""
EUROC_IMU = (
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
    "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
)
ROSTOPIC = "%time," + ",".join(
    f"field.{name}.{axis}" for name in ("angular_velocity", "linear_acceleration") for axis in "xyz"
)
EUROC_POSE = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
    "q_RS_z [], v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1], b_a_RS_S_x [m s^-2]"
)
OPENVINS_POSE = "#time(ns),px,py,pz,qw,qx,qy,qz,vx,bwx,bax"
"""As in the corrected ground truth that OpenVINS publishes for these folders."""


def seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09d}"


def lines(stamps: Iterable[Any], values: NDArray[Any], separator: str = ",") -> str:
    rows = zip(stamps, values.tolist(), strict=True)
    return "".join(separator.join([str(t), *map(repr, row)]) + "\n" for t, row in rows)


def imu_rows(header: str, stamps: Iterable[Any] = STAMPS, separator: str = ",") -> str:
    return f"{header}\n{lines(stamps, VALUES, separator)}"


def read(path: Path, *more: Path, columns: tuple[str, ...] = ()) -> LogData:
    log = open_log([path, *more], columns)
    return log.read(each.name for each in log.topics)


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def assert_imu(data: LogData, topic: str) -> None:
    imu = data.imus[topic]
    np.testing.assert_array_equal(imu.header_ns, STAMPS)
    np.testing.assert_array_equal(imu.log_ns, STAMPS)
    np.testing.assert_array_equal(imu.gyro, VALUES[:, :3])
    np.testing.assert_array_equal(imu.accel, VALUES[:, 3:])


def assert_pose(data: LogData, topic: str) -> None:
    (pose,) = data.poses[topic]
    np.testing.assert_array_equal(pose.header_ns, STAMPS)
    np.testing.assert_array_equal(pose.position, POSES[:, :3])
    np.testing.assert_allclose(pose.quaternion_xyzw, POSES[:, 3:], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("header", "separator"),
    [
        (IMU_HEADER, ","),
        (EUROC_IMU, ","),
        ("timestamp;gyro_x;gyro_y;gyro_z;acc_x;acc_y;acc_z", ";"),
        ("Time [ns]\tGyro.x\tGyro.y\tGyro.z\tAccel.x\tAccel.y\tAccel.z", "\t"),
        (ROSTOPIC, ","),
        ("t_ns,gyroX,gyroY,gyroZ,accX,accY,accZ", ","),
        ('"t_ns","wx","wy","wz","ax","ay","az"', ","),
        ("\ufeff# t_ns, wx, wy, wz, ax, ay, az", ","),
    ],
)
def test_imu_is_recognised_by_column_names(tmp_path: Path, header: str, separator: str) -> None:
    path = write(tmp_path / "imu.csv", imu_rows(header, separator=separator))
    data = read(path)
    assert_imu(data, "/imu")
    assert warnings(data.findings) == ()


@pytest.mark.parametrize("gyro", ["gx,gy,gz", "gyroscope_x,gyroscope_y,gyroscope_z"])
def test_tables_of_one_sensor_are_halves_of_an_imu(tmp_path: Path, gyro: str) -> None:
    """As loggers of phones write them; they were joints named gx, gy and gz."""
    data = read(
        write(tmp_path / "gyr.csv", f"t_ns,{gyro}\n{lines(STAMPS, VALUES[:, :3])}"),
        write(tmp_path / "acc.csv", f"t_ns,ax,ay,az,temp\n{lines(STAMPS, VALUES[:, 3:])}"),
    )
    assert data.joints == {}
    np.testing.assert_array_equal(data.imus["/gyr"].gyro, VALUES[:, :3])
    np.testing.assert_array_equal(data.imus["/acc"].accel, VALUES[:, 3:])
    assert (data.imus["/gyr"].absent, data.imus["/acc"].absent) == (("accel",), ("gyro",))
    assert not data.imus["/gyr"].accel.any()


@pytest.mark.parametrize(
    "names", ["px,py,pz,rx,ry,rz,rw", "x,y,z,rot_x,rot_y,rot_z,rot_w", "x,y,z,qx,qy,qz,qw"]
)
def test_poses_are_recognised_by_column_names(tmp_path: Path, names: str) -> None:
    assert_pose(read(write(tmp_path / "p.csv", f"t_ns,{names}\n{lines(STAMPS, POSES)}")), "/p")


def test_three_columns_of_a_rotation_are_no_pose(tmp_path: Path) -> None:
    """They may be a vector or three angles."""
    path = write(tmp_path / "p.csv", f"t_ns,x,y,z,rx,ry,rz\n{lines(STAMPS, POSES[:, :6])}")
    assert read(path).poses == {}


@pytest.mark.parametrize(("unit", "factor"), [("s", 10**9), ("ms", 10**6), ("us", 10**3)])
@pytest.mark.parametrize("named", [False, True])
def test_times_are_exact_in_every_unit(
    tmp_path: Path, unit: str, factor: int, *, named: bool
) -> None:
    """A float64 of seconds since 1970 would be off by 100 ns."""
    digits = len(str(factor)) - 1
    stamps = [f"{ns // factor}.{ns % factor:0{digits}d}" for ns in STAMPS.tolist()]
    header = IMU_HEADER.replace("t_ns", f"t_{unit}" if named else "t")
    assert_imu(read(write(tmp_path / "imu.csv", imu_rows(header, stamps))), "/imu")


def test_times_of_named_unit_are_not_doubted(tmp_path: Path) -> None:
    rows = imu_rows(IMU_HEADER.replace("t_ns", "t_ms"), range(0, 250, 5))
    path = write(tmp_path / "imu.csv", rows)
    assert np.diff(read(path).imus["/imu"].header_ns).tolist() == [5_000_000] * (COUNT - 1)


def test_error_names_the_compressed_table(tmp_path: Path) -> None:
    """Not the temporary file that it is unpacked into."""
    path = tmp_path / "a.csv.zst"
    path.write_bytes(zstandard.compress(b"t,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9\n20,0,0,0,0,0,9\n"))
    with pytest.raises(InputError) as caught:
        open_log([path])
    assert str(caught.value).startswith(f"{path}: its rows would be 20 s apart")


@pytest.mark.parametrize("start", [10**15, 10**14 + 7, 10**13, 10**11, 10**10])
def test_nanoseconds_since_a_start_are_found_by_their_rate(tmp_path: Path, start: int) -> None:
    """By their size they are ms or us since 1970, and rows of 506 Hz would be seconds apart."""
    stamps = start + 1_975_999 * np.arange(COUNT)
    path = write(tmp_path / "imu.csv", imu_rows(TIMED, stamps))
    np.testing.assert_array_equal(read(path).imus["/imu"].header_ns, stamps)


def test_rare_rows_since_1970_keep_their_unit(tmp_path: Path) -> None:
    """Joints that are logged as they change."""
    stamps = STAMPS[0] + 7_000_000_000 * np.arange(COUNT)
    path = write(tmp_path / "arm.csv", f"t,joint.a\n{lines(stamps, VALUES[:, :1])}")
    np.testing.assert_array_equal(read(path).joints["/arm"][0].header_ns, stamps)


def test_user_can_name_columns(tmp_path: Path) -> None:
    odd = np.column_stack((VALUES[:, :3], np.full(COUNT, 36.6), VALUES[:, 3:]))
    path = write(tmp_path / "imu.csv", lines(STAMPS, odd))
    columns = ("t_ns", "gx", "gy", "gz", "-", "ax", "ay", "az")
    assert_imu(read(path, columns=columns), "/imu")


def test_columns_may_be_guessed_beside_a_table_of_named_ones(tmp_path: Path) -> None:
    imu = write(tmp_path / "imu.csv", lines(STAMPS, VALUES))
    arm = write(tmp_path / "arm.csv", f"t_ns,elbow\n{lines(STAMPS, VALUES[:, :1])}")
    (joints,) = read(imu, arm, columns=tuple(IMU_HEADER.split(","))).joints["/arm"]
    assert joints.names == ("elbow",)


def test_last_columns_need_no_names(tmp_path: Path) -> None:
    path = write(tmp_path / "imu.csv", lines(STAMPS, np.hstack((VALUES, VALUES, VALUES))))
    assert_imu(read(path, columns=(*IMU_HEADER.split(","), "...")), "/imu")


NO_TIME = r"imu\.csv has no time column: name one t, or t_ns"
HALF_NAMED = r"imu\.csv begins with a header without the columns "
WITHOUT_HEADER = r"no header with known columns: .* or use --csv-columns"
TWO_COLUMNS = r"imu\.csv: two columns name the joint a: remove one"
SENSORS = "acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z"
WIDE = lines(STAMPS, np.hstack((VALUES, VALUES, VALUES)))


@pytest.mark.parametrize(
    ("text", "columns", "says"),
    [
        (imu_rows(TIMED, range(0, 250, 5)), "", r"imu\.csv.* 5 s apart.*t_ns, t_us, t_ms or t_s"),
        # in ms; 5 Hz in us and 5 kHz in ns
        (
            imu_rows(TIMED, 10**12 + 200_000 * np.arange(COUNT)),
            "",
            r"imu\.csv.*200 s apart.*t_ns, t_us, t_ms or t_s",
        ),
        # a count of milliseconds, which reads as seconds of 1 Hz
        (imu_rows(TIMED, range(50)), "", r"imu\.csv.* 1 s apart.*t_ns, t_us, t_ms or t_s"),
        ("time [ticks],gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n", "", "times are in 'ticks'"),
        (imu_rows(f",{SENSORS}"), "", NO_TIME),
        (imu_rows(f"timeTick,{SENSORS}"), "", NO_TIME),
        (lines(STAMPS, VALUES), "", WITHOUT_HEADER),
        (lines(STAMPS, VALUES), "a,b", r"--csv-columns a,b: name a column t"),
        (lines(STAMPS, VALUES), "t_ns,gx,gy,gz,-,ax,ay,az", r"imu\.csv .*--csv-columns"),
        ("\n", TIMED, "--csv-columns"),
        # every column of unknown names became a joint, without a word
        (imu_rows("Time(s),BaseWx,BaseWy,BaseWz,BaseAx,BaseAy,BaseAz"), TIMED, HALF_NAMED + "t"),
        ("when,gx,gy,gz,ax,ay,z\n0,0,0,0,0,0,9.8\n", TIMED, HALF_NAMED + "t, az"),
        ("0,0,0,0,0,0,9.8,1\n", TIMED, r"has rows of 8 cells, and --csv-columns names 7"),
        (WIDE, IMU_HEADER, r"19 cells, .* names 7: .* or end with \.\.\."),
        (WIDE, f"{IMU_HEADER}{',-' * 13},...", "rows of 19 cells"),
        # the values of one of them are wrong, and nothing tells which
        ("t_ns,a,b,a\n1,0,0,0\n", "", TWO_COLUMNS),
        (f"{IMU_HEADER},joint.a,joint.a\n1{',0' * 8}\n", "", TWO_COLUMNS),
        (f"{IMU_HEADER},gyro_x\n1{',0' * 7}\n", "", r"imu\.csv: two columns name the same"),
        (f"{IMU_HEADER},joint.a[deg]\n1{',0' * 7}\n", "", r"imu\.csv: a is in 'deg'"),
        ("t_ns,x[mm],y,z,qx,qy,qz,qw\n1,0,0,0,0,0,0,1\n", "", r"imu\.csv: x is in 'mm'"),
    ],
)
def test_refused_table_is_explained(text: str, columns: str, says: str, tmp_path: Path) -> None:
    path = write(tmp_path / "imu.csv", text)
    with pytest.raises((InputError, ChoiceError), match=says):
        open_log([path], tuple(filter(None, columns.split(","))))


def test_other_columns_are_joints(tmp_path: Path) -> None:
    path = write(tmp_path / "joints.csv", f"t_ns,shoulder,w_x\n{lines(STAMPS, VALUES[:, :2])}")
    (joints,) = read(path).joints["/joints"]
    assert joints.names == ("shoulder", "w_x")
    np.testing.assert_array_equal(joints.position, VALUES[:, :2])
    names = tuple(f"segment_{number}_joint" for number in range(300))
    path = write(tmp_path / "x.csv", f"t_ns,{','.join(names)}\n{'1,' * 300}1\n{'2,' * 300}1\n")
    (joints,) = read(path).joints["/x"]
    assert joints.names == names


def test_one_table_can_contain_everything(tmp_path: Path) -> None:
    """Joined by time: a row holds one sensor, the cells of the others are empty."""
    header = f"{IMU_HEADER},temperature,joint.elbow,joint.wrist"
    rows = [header]
    for k in range(COUNT):
        values = ",".join(map(repr, VALUES[k].tolist()))
        rows += [f"{STAMPS[k]},{values},36.6,,", f"{STAMPS[k] + 1},,,,,,,,{k}.5,-1e-3"]
    data = read(write(tmp_path / "robot 1.csv", "\n".join(rows)))
    assert_imu(data, "/robot_1/imu")
    (joints,) = data.joints["/robot_1/joint_states"]
    assert joints.names == ("elbow", "wrist")
    np.testing.assert_array_equal(joints.header_ns, STAMPS + 1)
    np.testing.assert_array_equal(joints.position[:, 0], np.arange(COUNT) + 0.5)
    assert warnings(data.findings) == ()


def test_invalid_rows_are_skipped_and_counted(tmp_path: Path) -> None:
    good = lines(STAMPS, VALUES).splitlines()
    bad = ["12,1,2,3,4,5", "x,1,2,3,4,5,6", "13,1,2,3,4,5,six", "9" * 30 + ",1,2,3,4,5,6", "nan"]
    path = write(
        tmp_path / "imu.csv", "\n".join([IMU_HEADER, *good[:9], *bad, "# note", *good[9:]])
    )
    data = read(path)
    assert_imu(data, "/imu")
    assert warnings(data.findings) == (
        f"{path}: row 10 is the first that cannot be read: '12,1,2,3,4,5'",
        "/imu: 5 of 55 messages do not fit sensor_msgs/Imu and are left out",
    )


def test_decimal_commas_are_named(tmp_path: Path) -> None:
    path = write(tmp_path / "imu.csv", f"{TIMED.replace(',', ';')}\n1;0,5;0;0;0;0;9,8\n")
    assert warnings(read(path).findings)[0] == (
        f"{path}: row 1 is the first that cannot be read: '1;0,5;0;0;0;0;9,8': write numbers with "
        "a decimal point"
    )


def test_tum_trajectory_is_read_beside_an_imu(tmp_path: Path) -> None:
    poses = "# timestamp tx ty tz qx qy qz qw\n" + lines(map(seconds, STAMPS.tolist()), POSES, " ")
    data = read(
        write(tmp_path / "imu.csv", imu_rows(IMU_HEADER)),
        write(tmp_path / "groundtruth.txt", poses),
    )
    assert_imu(data, "/imu")
    assert_pose(data, "/groundtruth")
    assert warnings(data.findings) == ()


@pytest.mark.parametrize("pose_header", [EUROC_POSE, OPENVINS_POSE])
def test_euroc_folder_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pose_header: str
) -> None:
    """Headers as in the published data set; images and positions alone are left alone."""
    mav = tmp_path / "MH_01" / "mav0"
    write(mav / "imu0" / "data.csv", imu_rows(EUROC_IMU))
    ordered = np.column_stack((POSES[:, :3], POSES[:, 6], POSES[:, 3:6], VALUES[:, :3]))
    name = "state_groundtruth_estimate0"
    write(mav / name / "data.csv", f"{pose_header}\n{lines(STAMPS, ordered)}")
    write(mav / "cam0" / "data.csv", "#timestamp [ns],filename\n1403636579763555584,1.png\n")
    write(mav / "leica0" / "data.csv", "#timestamp [ns],p_RS_R_x [m]\n1403636579763555584,1.0\n")
    assert open_log([mav]).paths == open_log([mav.parent]).paths
    monkeypatch.chdir(mav)
    assert read(Path()).imus.keys() == {"/imu0"}
    log = open_log([tmp_path / "MH_01"])
    files = [path.parent.name for path in log.paths if isinstance(path, Path)]
    assert files == ["imu0", name]  # which have a hash
    data = log.read([each.name for each in log.topics])
    assert_imu(data, "/imu0")
    assert_pose(data, f"/{name}")
    assert (list(data.imus), list(data.joints), list(data.poses)) == (["/imu0"], [], [f"/{name}"])
    assert warnings(data.findings) == ()


def test_a_folder_of_tables_is_one_recording(tmp_path: Path) -> None:
    write(tmp_path / "imu.csv", imu_rows(IMU_HEADER))
    write(tmp_path / "joints.csv", f"t_ns,elbow\n{lines(STAMPS, VALUES[:, :1])}")
    write(tmp_path / "README.txt", "What this is.\n")
    data = read(tmp_path)
    assert_imu(data, "/imu")
    assert list(data.joints) == ["/joints"]


def test_tables_beside_a_log_are_ignored(tmp_path: Path) -> None:
    write(tmp_path / "notes.csv", imu_rows(IMU_HEADER))
    write_log(tmp_path / "log.mcap", mixed_messages(5), "mcap-none")
    assert [path.name for path in open_log([tmp_path]).paths] == ["log.mcap"]


@pytest.mark.parametrize(
    "text",
    [
        "import subprocess,signal,time,sys,os\nos.nice(5)\n",
        "time, x, y\nhello\n",
        "time, x, y\nhello, dear, reader\n",
        "time,x\n0,1,2\n",
    ],
)
def test_table_of_unknown_columns_begins_with_a_row_of_as_many_numbers(
    tmp_path: Path, text: str
) -> None:
    with pytest.raises(InputError, match=r"notes\.txt is not a log"):
        open_log([write(tmp_path / "notes.txt", text)])


@pytest.mark.parametrize("separator", [" ", ",", "\t"])
def test_numbers_are_a_table_without_header_whatever_the_name(
    tmp_path: Path, separator: str
) -> None:
    path = write(tmp_path / "numbers.txt", lines(STAMPS, VALUES, separator))
    with pytest.raises(InputError, match=WITHOUT_HEADER):
        open_log([path])


@pytest.mark.parametrize(
    "text", ["", "t,\n", "a,b,c\n1,2,3\n", "filename,timestamp\n", "1 2 3 4 5 6 7 8\n", "{}"]
)
def test_other_text_is_not_a_log(tmp_path: Path, text: str) -> None:
    path = write(tmp_path / "x.csv", text)
    try:
        data = read(path)
    except InputError as error:
        assert "x.csv" in str(error)  # noqa: PT017 - either way is right
    else:
        assert not data.imus


def test_damage_raises_only_imucalib_errors(tmp_path: Path) -> None:
    rng = random.Random(3)  # noqa: S311 - no secret
    header = f"{IMU_HEADER},joint.elbow"
    rows = np.column_stack((VALUES, VALUES[:, 0]))
    sound = f"{header}\n{lines(STAMPS, rows)}".encode()
    tum = lines(map(seconds, STAMPS.tolist()), POSES, " ").encode()
    path = tmp_path / "damaged.csv"
    read_at_all = 0
    for _ in range(400):
        raw = bytearray(rng.choice((sound, tum)))
        for _ in range(rng.randint(1, 6)):
            at = rng.choice((rng.randrange(60), rng.randrange(len(raw))))
            fill = rng.choice((b"\0", b"\xff", b",", b"\n", b"-", b"e9", b"9" * 400, b'"', b"inf"))
            raw[at : at + rng.choice((0, 1, 5))] = fill
        path.write_bytes(raw[: rng.choice((len(raw), len(raw) // 2))])
        try:
            read(path)
            read_at_all += 1
        except ImucalibError as error:
            assert "\n" not in str(error)  # noqa: PT017 - either way is right
    assert 150 < read_at_all < 350
