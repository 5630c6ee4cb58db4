"""What the documents have beside words: their commands run, CI's jobs and the container's too.

Every command that a page shows in a ```sh block runs, in the order of the page. A comment on the
line before a block states what differs: ``<!-- not run: why -->``; ``<!-- exit 3 -->`` for commands
that shall end so; ``<!-- run with --duration 15 -->`` for what each ``imucalib simulate`` of the
block is given besides, to take less time. Pictures are what the scripts beside them make.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from docs.motions import MOTIONS, PICTURES, lesson, pictures
from tests.processes import python, run
from tests.results.results_samples import drawn, named, written
from tests.test_docs import PAGES, ROOT, shell


@dataclass(frozen=True)
class Block:
    """Lines that are typed one after the other."""

    script: str
    exit_code: int = 0


def blocks(page: Path) -> list[Block]:
    """What of a page is run."""
    found = re.findall(
        r"^(?:<!-- (not run: |exit |run with )([^\n]+) -->\n)?```sh\n(.*?)^```",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL | re.MULTILINE,
    )
    return [_block(script, said, value) for said, value, script in found if said != "not run: "]


def _block(script: str, said: str, value: str) -> Block:
    if said == "exit ":
        return Block(script, exit_code=int(value))
    if said == "run with ":
        script = re.sub(r"^imucalib simulate", rf"\g<0> {value}", script, flags=re.MULTILINE)
    return Block(script)


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)], ids=_name)
def test_commands_of_a_page_run(page: Path, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "sample_data", tmp_path / "sample_data")
    folder = tmp_path / ("sample_data" if page.parent.name == "sample_data" else "")
    for block in blocks(page):
        done = shell(block.script, folder)
        assert done.returncode == block.exit_code, f"{block.script}\n{done.stderr}"
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_all_commands_are_in_tested_blocks(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    assert not re.findall(
        r"^    (?:imucalib|python3?|pip|git|\.venv\S*) .*", text, flags=re.MULTILINE
    )


# docs/ci.md and the container file

PAGE = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
GITHUB, GITLAB = (
    yaml.safe_load(block)
    for block in re.findall(r"^```yaml\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
)
INSTALL = re.compile(r"(?:pipx|pip) install \"imucalib\[plot\] @ git\+https://\S+/imucalib\"")


def github_steps() -> list[str]:
    (steps,) = GITHUB["jobs"].values()
    return [step["run"] for step in steps["steps"] if "run" in step]


def gitlab_lines() -> list[str]:
    (steps,) = GITLAB.values()
    return [*steps["before_script"], *steps["script"]]


def job(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return shell(f'export GITHUB_STEP_SUMMARY="$PWD/summary.md"\n{script}', folder)


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
        done = job("\n".join(commands), tmp_path)
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
    assert job(last, tmp_path).returncode == 0
    moved = drawn(1, 12, moves=[(6, [3e-3, 0.0, 0.0, 0.0, 0.0, 0.0])])
    written(tmp_path / "results", named(*moved))
    done = job(last, tmp_path)
    assert done.returncode not in {0, 3}
    assert done.stdout.startswith("moved: ")
    assert (tmp_path / "trend.svg").exists()


def test_every_artifact_is_written_by_its_job() -> None:
    (github,), (gitlab,) = GITHUB["jobs"].values(), GITLAB.values()
    kept = github["steps"][-1]["with"]["path"].split()
    commands = "\n".join(github_steps())
    for path in (*kept, "junit.xml", "$GITHUB_STEP_SUMMARY"):
        assert path in commands
    for path in (*gitlab["artifacts"]["paths"], gitlab["artifacts"]["reports"]["junit"]):
        assert path in "\n".join(gitlab_lines())


def instructions() -> list[tuple[str, str]]:
    """Of the container file, in their order."""
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    lines = re.sub(r"\\\n", " ", text).splitlines()
    found = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    return [(word, rest) for word, rest in found]


def test_container_runs_the_command_without_root() -> None:
    told = dict(instructions())  # of each the last one
    bases = [rest for word, rest in instructions() if word == "FROM"]
    assert all(re.match(r"docker\.io/library/python:3\.1[0-3]-slim\b", base) for base in bases)
    assert json.loads(told["ENTRYPOINT"]) == ["imucalib"]
    assert not told["USER"].startswith(("0", "root"))
    assert "OPENBLAS_NUM_THREADS=1" in shlex.split(told["ENV"])
    known = {"FROM", "COPY", "RUN", "ENV", "USER", "WORKDIR", "ENTRYPOINT", "CMD"}
    assert {word for word, _ in instructions()} <= known


@pytest.mark.slow
def test_container_build_steps_install_the_command(tmp_path: Path) -> None:
    """Each RUN in a fresh environment, with the image's folders in one of the test's."""
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    for name in (line[1:] for line in ignored if line.startswith("!")):
        copy: Any = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        (tmp_path / "src").mkdir(exist_ok=True)
        copy(ROOT / name, tmp_path / "src" / name)
    assert python("-m", "venv", tmp_path / "venv").returncode == 0
    tools = tmp_path / "venv" / "bin"
    environment = {**os.environ, "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    for word, rest in instructions():
        if word == "RUN":
            command = re.sub(r"(?<=[\s(])/(?=src|wheels)", f"{tmp_path}/", rest)
            done = run("sh", "-euc", command, cwd=tmp_path, env=environment)
            assert done.returncode == 0, done.stderr
    assert "trend" in run(tools / "imucalib", "--help", cwd=tmp_path).stdout


# Pictures and the site


@pytest.mark.slow
@pytest.mark.xdist_group("motions")  # logs are simulated once
def test_motion_pictures_match_their_script() -> None:
    """Another version of MuJoCo may differ in the last digits."""
    made = pictures()
    assert {path.stem for path in PICTURES.glob("*.svg")} == set(made)
    for name, picture in made.items():
        kept = _label((PICTURES / f"{name}.svg").read_text("utf-8"))
        drawn = _label(picture)
        assert re.sub(r"[\d.]+", "#", drawn) == re.sub(r"[\d.]+", "#", kept)
        for here, there in zip(_figures(drawn), _figures(kept), strict=True):
            assert here == pytest.approx(there, rel=0.1)


@pytest.mark.slow
@pytest.mark.xdist_group("motions")  # logs are simulated once
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


def _figures(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"\d+\.\d+|\d+", text)]


@pytest.mark.slow
def test_site_is_whole_and_loads_nothing_from_the_network(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="needs mkdocs: pip install '.[docs]'")
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = python("-m", "mkdocs", "build", "--strict", "--site-dir", tmp_path, cwd=ROOT, env=env)
    assert done.returncode == 0, done.stderr
    assert "excluded from the built site" not in done.stderr
    for page in (ROOT / "docs").rglob("*.md"):
        built = tmp_path / page.relative_to(ROOT / "docs").with_suffix(".html")
        assert built.exists() or page.name == "README.md"
    assert {"index.html", "CONTRIBUTING.html"} <= {each.name for each in tmp_path.iterdir()}
    loads = re.compile(
        r"""<(?:script|img|iframe|link)\b[^>]*?(?:src|href)=["']?(https?://[^"' >]+)"""
    )
    for page in tmp_path.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert loads.findall(text) == [], page.name
        for picture in re.findall(r"<img [^>]*>", text):
            assert re.search(r'alt="[^"]{20,}"', picture), picture
