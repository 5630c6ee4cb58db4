"""No command costs its user a file: not one that it reads, not a log, not another result."""

import os
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from msgspec import to_builtins

from imucalib_cli.configuration import configs_folder
from imucalib_cli.errors import ChoiceError
from imucalib_cli.results.atomic import write_whole
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.results.names import shortened
from imucalib_cli.results.overwrite_checks import check_places
from tests.cli.stand_in import Estimator
from tests.conftest import Imucalib, LogWriter
from tests.processes import python
from tests.results.results_samples import make_estimate, make_result

SHORT = ("--duration", "0.2", "--imu-rate", "100", "--robot-rate", "50")


@pytest.fixture
def house(tmp_path: Path, log_writer: LogWriter, arm_urdf: Path) -> Iterator[Path]:
    """A folder with one file of every kind that a command reads; none changes, whatever is run."""
    log = log_writer.imu().joints().write()
    configs = Path(str(configs_folder()))
    (tmp_path / "result.yaml").write_text(to_yaml([make_result()]))
    table = tmp_path / "euroc" / "mav0" / "imu0" / "data.csv"
    table.parent.mkdir(parents=True)
    table.write_text("t_ns,gx,gy,gz,ax,ay,az\n0,0,0,0,0,0,9.8\n")
    for source, names in {
        log: ("log.mcap",),
        arm_urdf: ("real.urdf",),
        configs / "imus" / "bmi088.yaml": ("imu.yaml", "chip.truth.yaml"),
        configs / "barbot.yaml": ("own.yaml", "sim.truth.yaml"),
        configs / "studies" / "bias.yaml": ("bias-quick.jsonl",),
        table: ("imu.csv",),
    }.items():
        for name in names:
            shutil.copy(source, tmp_path / name)
    before = _contents(tmp_path)
    yield tmp_path
    after = _contents(tmp_path)
    assert {name: after.get(name) for name in before} == before


@pytest.fixture
def at_home(house: Path, monkeypatch: pytest.MonkeyPatch, imucalib: Imucalib) -> Imucalib:
    """Commands in the house."""
    monkeypatch.chdir(house)
    return imucalib


@pytest.fixture
def refused(estimator: Estimator, at_home: Imucalib) -> Callable[[str], str]:
    """The error message of a usage error of a command in the house."""
    del estimator

    def usage_error(arguments: str) -> str:
        short = SHORT if arguments.startswith("simulate") else ()
        return at_home(*arguments.split(), *short, code=2).err

    return usage_error


def _contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    "arguments",
    [
        "run log.mcap --urdf real.urdf -o real.urdf",
        "run log.mcap --urdf real.urdf --debug-mcap log.mcap",
        "run recording --urdf real.urdf -o recording/metadata.yaml",
        "run recording/metadata.yaml --urdf real.urdf -o recording/recording.mcap",
        "run log.mcap --urdf real.urdf --imu-model imu.yaml -o imu.yaml",
        "inspect recording -o recording/metadata.yaml",
        "inspect euroc -o euroc/mav0/imu0/data.csv",
        "inspect log.mcap --urdf real.urdf -o real.urdf",
        "verify log.mcap --urdf real.urdf -o log.mcap",
        "verify log.mcap --urdf real.urdf --imu-model imu.yaml -o imu.yaml",
        "verify result.yaml --urdf real.urdf -o result.yaml",
        "diff result.yaml result.yaml --urdf real.urdf -o real.urdf",
        "compare result.yaml --kalibr imu.yaml --urdf real.urdf -o imu.yaml",
        "compare result.yaml --kalibr imu.yaml --urdf real.urdf --truth own.yaml -o own.yaml",
        "simulate --config own.yaml -o sim.mcap --urdf own.yaml",
        "simulate --config sim.truth.yaml -o sim.mcap",
        "simulate barbot --imu-model chip.truth.yaml -o chip.mcap",
        "simulate barbot --imu-model imu.yaml -o new.mcap --urdf imu.yaml",
        "study bias --quick --config bias-quick.jsonl -o .",
    ],
)
def test_inputs_are_never_overwritten(arguments: str, refused: Callable[[str], str]) -> None:
    err = refused(arguments)
    assert "is an input and would be overwritten: name another file" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        "run log.mcap --urdf arm.urdf -o recording/metadata.yaml",
        "run log.mcap --urdf arm.urdf --debug-mcap recording/recording.mcap",
        "inspect recording -o log.mcap",
        "inspect recording -o imu.csv",
        "verify result.yaml --urdf arm.urdf -o real.urdf",
        "diff result.yaml result.yaml -o log.mcap",
        "simulate barbot -o log.mcap",
        "simulate barbot -o new.mcap --urdf real.urdf",
    ],
)
def test_foreign_logs_and_urdfs_are_not_overwritten(
    arguments: str, refused: Callable[[str], str]
) -> None:
    err = refused(arguments)
    kind = "URDF" if arguments.endswith(".urdf") else "log"
    assert f"is a {kind} and would be overwritten: name another file" in err
    # only these commands have a --force
    assert ("or give --force" in err) == arguments.startswith(("run", "simulate"))


@pytest.mark.usefixtures("estimator")
def test_force_overwrites_foreign_files(at_home: Imucalib) -> None:
    for name in ("a.mcap", "b.mcap"):
        shutil.copy("log.mcap", name)
    shutil.copy("real.urdf", "c.urdf")
    at_home("run", "log.mcap", "--urdf", "real.urdf", "-o", "a.mcap", "--force")
    at_home("simulate", "barbot", *SHORT, "-o", "b.mcap", "--urdf", "c.urdf", "--force")
    assert Path("a.mcap").read_text().startswith("schema:")
    assert "Made by imucalib simulate" in Path("c.urdf").read_text()
    at_home("run", "log.mcap", "--urdf", "arm.urdf", "-o", "./-")  # a file may be called so
    assert Path("./-").read_text().startswith("schema:")


@pytest.fixture
def simulate(imucalib: Imucalib) -> Imucalib:
    return imucalib.with_("simulate", "barbot", *SHORT)


def test_simulate_checks_all_output_paths_before_it_starts(
    tmp_path: Path, simulate: Imucalib
) -> None:
    places = ("-o", tmp_path / "sim.mcap", "--urdf")
    said = simulate(*places, tmp_path / "sim.truth.yaml", code=2)
    assert "would be written twice: name two files" in said.err
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "sim.mcap").write_bytes(b"old")
    for folder in ("sim.truth.yaml", "out.urdf"):
        (tmp_path / folder).mkdir()
        simulate(*places, tmp_path / "out.urdf", code=1)
        assert (tmp_path / "sim.mcap").read_bytes() == b"old"
        (tmp_path / folder).rmdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    said = simulate("-o", tmp_path / "pipe.mcap", code=1)
    assert "is a pipe or a device; name a file" in said.err


def test_repeated_simulation_keeps_link_and_permissions(tmp_path: Path, simulate: Imucalib) -> None:
    real, link = tmp_path / "real.mcap", tmp_path / "link.mcap"
    real.write_bytes(b"old")
    real.chmod(0o600)
    link.symlink_to(real)
    for _ in range(2):
        simulate("-o", link, "--urdf", tmp_path / "a.urdf")
        assert link.is_symlink()
        assert real.stat().st_mode & 0o777 == 0o600
        assert real.read_bytes().startswith(b"\x89MCAP")


def test_simulation_overwrites_only_its_own_files(tmp_path: Path, simulate: Imucalib) -> None:
    log, urdf = tmp_path / "mine.mcap", tmp_path / "mine.urdf"
    again = simulate.with_("-o", log, "--urdf", urdf)
    again()
    again()
    recorded, described = log.read_bytes(), urdf.read_bytes()
    others = {log: recorded + b"\0", urdf: described.replace(b'xyz="', b'xyz="1', 1)}
    for path, content in others.items():
        path.write_bytes(content)
        assert "and would be overwritten: name another file" in again(code=2).err
        assert path.read_bytes() == content
        again("--force")
    assert (log.read_bytes(), urdf.read_bytes()) == (recorded, described)


def test_inputs_are_recognised_under_any_path(tmp_path: Path) -> None:
    source, log = tmp_path / "source.yaml", tmp_path / "a.db3-wal"
    source.write_text("precious")
    log.write_text("x")
    soft, hard = tmp_path / "soft", tmp_path / "hard"
    soft.symlink_to(source)
    hard.hardlink_to(source)
    # SQLite reads the companion of a database too
    for name in (source, soft, hard, tmp_path / "." / "source.yaml", log):
        with pytest.raises(ChoiceError, match="is an input"):
            check_places(read=[source, tmp_path / "a.db3"], written=[name])


@pytest.mark.parametrize(
    "arguments",
    [
        "run ''",
        "run x.mcap --urdf ''",
        "inspect ''",
        "inspect x.mcap --urdf ''",
        "apply '' --urdf x",
        "apply x --urdf ''",
        "verify x ''",
        "report ''",
        "trend ''",
        "diff x ''",
        "compare x --kalibr '' --urdf x",
        "simulate --config '' -o x.mcap",
        "simulate barbot -o x.mcap --urdf ''",
        "study methods --config ''",
        "study methods -o ''",
        "run x.mcap --imu-topic ''",
        "run x.mcap --urdf x --imu-link ''",
        "run x.mcap --urdf x --parent /imu=''",
    ],
)
def test_empty_name_is_not_the_current_folder(arguments: str, imucalib: Imucalib) -> None:
    said = imucalib(*shlex.split(arguments), code=2).err
    assert "is empty, perhaps because a variable is not set" in said
    first = said.split()[1]
    assert first.isupper() or first.startswith("-") or first == "a"  # of the help, no variable


@pytest.mark.parametrize(
    "command", ["apply - --urdf -", "verify - --urdf -", "compare x --kalibr - --urdf -"]
)
def test_stdin_is_one_of_the_inputs(command: str, imucalib: Imucalib) -> None:
    said = imucalib(*command.split(), stdin=b"x", code=2).err
    assert "standard input can be one of the files, not two" in said


def test_output_may_be_a_pipe_behind_a_link() -> None:
    """A resolved link to a pipe, such as /dev/stdout, names no file."""
    read, write = os.pipe()
    path = Path(f"/dev/fd/{write}")
    check_places(read=(), written=[path])
    write_whole(path, "here")
    assert os.read(read, 9) == b"here"
    os.close(read)
    os.close(write)


@pytest.mark.parametrize("command", [["verify"], ["apply", "--force"]])
def test_file_redirected_to_stdin_is_an_input(
    command: list[str], tmp_path: Path, arm_urdf: Path
) -> None:
    result = tmp_path / "result.yaml"
    before = to_yaml([make_result(parent="hand", child="imu_link")])
    result.write_text(before)
    with result.open("rb") as file:
        arguments = (*command, "-", "--urdf", arm_urdf, "-o", result)
        done = python("-m", "imucalib_cli", *arguments, stdin=file)
    assert done.returncode == 2, done.stderr
    assert "is an input and would be overwritten" in done.stderr
    assert result.read_text() == before


@pytest.mark.usefixtures("estimator")
@pytest.mark.parametrize(
    "imus",
    [
        {"/i1": "a/b", "/i2": "a_b"},
        {"/i1": "a b", "/i2": "a_b"},
        {"/i1": "!!", "/i2": "??"},
        {"/imu/data": "imu_link", "/imu_data": "imu_link"},
        {"/i1": "A", "/i2": "a"},
    ],
    ids=str,
)
def test_results_with_the_same_name_get_separate_files(
    imus: dict[str, str], tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    writer = LogWriter(tmp_path / "rec").joints()
    for topic, frame in imus.items():
        writer.imu(topic, frame=frame)
    run = imucalib.with_("run", writer.write(), "--urdf", arm_urdf, "--parent", "hand")
    for _ in range(2):  # the second time each goes over its own
        err = run("-o", f"{tmp_path}/out/").err
        files = (tmp_path / "out").iterdir()
        topics = [yaml.safe_load(file.read_text())["provenance"]["topics"]["imu"] for file in files]
        assert sorted(topics) == sorted(imus)
        assert "is of another IMU or log: this result is in" in err


@pytest.mark.usefixtures("estimator")
@pytest.mark.parametrize("fmt", ["yaml", "json", "summary"])
def test_results_of_logs_with_the_same_name_are_both_kept(
    fmt: str, tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    for place, topic in (("d1", "/one"), ("d2", "/two")):
        (tmp_path / place).mkdir()
        log = LogWriter(tmp_path / place / "rosbag").imu(topic).joints().write()
        run = imucalib.with_("run", log, "--urdf", arm_urdf, "--format", fmt)
        said = run("-o", f"{tmp_path}/col/")
    first, _ = sorted(path.name for path in (tmp_path / "col").iterdir())
    assert "rosbag.imu_link.2" in first
    assert "rosbag.imu_link.2" in said.err


@pytest.mark.usefixtures("estimator")
def test_long_frame_name_gets_a_result_file(
    tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = LogWriter(tmp_path / "rec").imu(frame="\u00e9" * 200).joints().write()
    run = imucalib.with_("run", log, "--urdf", arm_urdf, "--parent", "hand")
    run("-o", f"{tmp_path}/out/")
    assert len(list((tmp_path / "out").iterdir())) == 1
    run("-o", tmp_path / f"{'x' * 250}.yaml")


@pytest.mark.usefixtures("estimator")
def test_files_that_a_xacro_loads_are_inputs(
    tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    pytest.importorskip("xacro")
    xacro, numbers, part = (tmp_path / name for name in ("x.xacro", "params.yaml", "part.xml"))
    numbers.write_text("height: 0.3")
    urdf = arm_urdf.read_text().replace("0 0 0.3", "0 0 ${numbers['height']}")
    opening = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    loaded = f"<xacro:property name='numbers' value=\"${{xacro.load_yaml('{numbers}')}}\"/>"
    part.write_text(f"{opening}{loaded}</robot>")
    included = '<xacro:include filename="part.xml"/>'
    xacro.write_text(urdf.replace('<robot name="arm">', f"{opening}{included}"))
    log = LogWriter(tmp_path / "rec").imu().joints().write()
    run = imucalib.with_("run", log, "--urdf", xacro)
    for name in (numbers, part):
        before = name.read_text()
        assert f"{name} is an input and would be overwritten" in run("-o", name, code=2).err
        assert name.read_text() == before
    run("-o", tmp_path / "result.yaml")


@pytest.mark.usefixtures("estimator")
def test_control_characters_of_a_log_are_in_no_output(
    tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    written = LogWriter(tmp_path / "rec").imu().joints().write()
    log = written.rename(tmp_path / "a\x1b[1m\nb|c d.mcap")
    run = imucalib.with_("run", log, "--urdf", arm_urdf, "--parent", "hand")
    run("-o", f"{tmp_path}/out/")
    run("-o", f"{tmp_path}/out/")  # which replaces it
    (file,) = (tmp_path / "out").iterdir()
    assert file.name == "a_[1m_b_c d.imu_link.yaml"


@pytest.mark.parametrize(
    ("coding", "expected"), [("utf-8", "\u65e5 \u00fc.imu"), ("ascii", "_ _.imu")]
)
def test_file_names_are_encodable_in_the_file_system(
    coding: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with LC_ALL=C, under which Python reads the names on disk as lone surrogates."""
    monkeypatch.setattr(sys, "getfilesystemencoding", lambda: coding)
    read = "\u65e5 \u00fc".encode().decode(coding, "surrogateescape")
    assert shortened(f"{read}.imu\udcff") == expected


def test_failed_run_warns_of_older_results_in_folder(
    estimator: Estimator, house: Path, imucalib: Imucalib
) -> None:
    run = imucalib.with_("run", house / "log.mcap", "--urdf", house / "arm.urdf")
    run("-o", f"{house}/out/")
    estimator.fail_on = 2
    words = "was not updated; it still holds an earlier result"
    err = run("-o", f"{house}/out/", code=1).err
    assert f"{house / 'out' / 'log.imu_link.yaml'} {words}" in err
    assert words not in run("-o", f"{house}/out/").err
    # also before the log is read
    assert words in run("-o", f"{house}/out/", "--imu-model", "nothere.yaml", code=1).err
    assert words in run("-o", f"{house}/out/", "--tilt-std", "1", "--gravity", "none", code=2).err


def test_repeated_apply_keeps_hand_edited_urdfs(
    tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    result, target = tmp_path / "result.yaml", tmp_path / "calibrated.urdf"
    apply = imucalib.with_("apply", result, "--urdf", arm_urdf, "-o", target)
    for x in (0.1, 0.2):
        moved = make_estimate(t_parent_imu=make_estimate().t_parent_imu + x)
        found = make_result(estimate=moved, parent="hand", child="imu_link")
        result.write_text(to_yaml([to_builtins(found)]))
        apply()
    target.write_text(target.read_text().replace("keep me", "changed by hand"))
    assert "is a URDF and would be overwritten" in apply(code=2).err
    assert "changed by hand" in target.read_text()
    apply("--force")
    assert "keep me" in target.read_text()


def test_extra_files_may_be_in_the_created_output_folder(
    tmp_path: Path, imucalib: Imucalib
) -> None:
    sample = Path(__file__).parents[2] / "sample_data" / "rihibot"
    quick = ("--to", "15", "--robot", "exact", "--sensor-model", "ideal", "-q")
    run = imucalib.with_("run", f"{sample}.mcap", "--urdf", f"{sample}.urdf", *quick)
    folder = tmp_path / "new" / "results"
    extras = ("--report", folder / "page.html", "--residuals", folder / "table.csv")
    run("-o", f"{folder}/", *extras)
    names = {"rihibot.imu_link.yaml", "page.html", "table.csv"}
    assert {path.name for path in folder.iterdir()} == names
    # no other folder is created
    run("-o", f"{tmp_path}/b/", "--report", tmp_path / "nowhere" / "page.html", code=1)
    assert not (tmp_path / "b").exists()
