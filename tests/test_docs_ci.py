"""docs/ci.md: the commands of its jobs run in a shell; the container file builds in a venv."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.results.results_samples import drawn, named, written
from tests.test_docs import ROOT, run

PAGE = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
GITHUB, GITLAB = (
    yaml.safe_load(block)
    for block in re.findall(r"^```yaml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
)
INSTALL = re.compile(r"(?:pipx|pip) install \"imucalib\[plot\] @ git\+https://\S+/imucalib\"")


def github_steps() -> list[str]:
    (job,) = GITHUB["jobs"].values()
    return [step["run"] for step in job["steps"] if "run" in step]


def gitlab_lines() -> list[str]:
    (job,) = GITLAB.values()
    return [*job["before_script"], *job["script"]]


def shell(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return run(f'export GITHUB_STEP_SUMMARY="$PWD/summary.md"\n{script}', folder)


JOBS = pytest.mark.parametrize(
    "commands", [github_steps(), gitlab_lines()], ids=["github", "gitlab"]
)


@pytest.mark.slow
@JOBS
def test_the_commands_of_a_job_run(commands: list[str], tmp_path: Path) -> None:
    """As they stand, but for the installation; then again with what the cache keeps."""
    install, *commands = commands
    (tmp_path / "bags").mkdir()  # a user's repository, with a log
    shutil.copy(ROOT / "sample_data/rihibot.mcap", tmp_path / "bags")
    shutil.copy(ROOT / "sample_data/rihibot.urdf", tmp_path / "robot.urdf")
    assert INSTALL.fullmatch(install)
    for _ in range(2):
        done = shell("\n".join(commands), tmp_path)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        assert (tmp_path / "junit.xml").read_text(encoding="utf-8").startswith("<?xml")
    assert (tmp_path / "results/rihibot.imu_link.yaml").exists()
    assert (tmp_path / "verify.csv").read_text(encoding="utf-8").count(",yes,") == 1
    assert "one recording can be used" in done.stdout


@pytest.mark.slow
@JOBS
def test_moved_mount_fails_the_job(commands: list[str], tmp_path: Path) -> None:
    (last,) = (line for line in commands if line.startswith("imucalib trend"))
    still = drawn(1, 12)
    written(tmp_path / "results", named(*still))
    assert shell(last, tmp_path).returncode == 0
    moved = drawn(1, 12, moves=[(6, [3e-3, 0.0, 0.0, 0.0, 0.0, 0.0])])
    written(tmp_path / "results", named(*moved))
    done = shell(last, tmp_path)
    assert done.returncode not in {0, 3}
    assert done.stdout.startswith("moved: ")
    assert (tmp_path / "trend.svg").exists()


def instructions() -> list[tuple[str, str]]:
    """Of the container file, in their order."""
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    lines = re.sub(r"\\\n", " ", text).splitlines()
    found = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    return [(word, rest) for word, rest in found]


@pytest.mark.slow
def test_container_build_steps_install_the_command(tmp_path: Path) -> None:
    """Each RUN in a fresh environment, with the image's folders in one of the test's."""
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    for name in (line[1:] for line in ignored if line.startswith("!")):
        copy: Any = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        (tmp_path / "src").mkdir(exist_ok=True)
        copy(ROOT / name, tmp_path / "src" / name)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    tools = tmp_path / "venv" / "bin"
    environment = {**os.environ, "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    for word, rest in instructions():
        if word == "RUN":
            command = re.sub(r"(?<=[\s(])/(?=src|wheels)", f"{tmp_path}/", rest)
            done = subprocess.run(
                ["sh", "-euc", command],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, done.stderr
    told = subprocess.run(
        [tools / "imucalib", "--help"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert "trend" in told.stdout
