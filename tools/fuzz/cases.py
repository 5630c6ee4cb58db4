"""One case from its seed and number: files, arguments, and what would be a wrong answer."""

from __future__ import annotations

import tempfile
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING

from tools.fuzz import seeds
from tools.fuzz.mutate_bag import damage_bag
from tools.fuzz.mutate_bytes import damage
from tools.fuzz.mutate_db3 import damage_db3
from tools.fuzz.mutate_mcap import damage_mcap
from tools.fuzz.mutate_messages import damage_messages
from tools.fuzz.mutate_texts import damage_text, damage_urdf, same_chain

if TYPE_CHECKING:
    from collections.abc import Callable

KINDS = {
    "messages": 22,
    "mcap": 20,
    "bag": 12,
    "db3": 14,
    "bytes": 14,
    "folder": 4,
    "urdf": 8,
    "result": 6,
}
"""What is damaged, and how often; ``bytes`` is any log, without regard to its format."""
_VERIFIED = 0.1
"""Share of calibrations that verify instead."""


@dataclass(eq=False)
class Case:
    """What to run and how."""

    what: str
    argv: list[str]
    folder: Path
    truth: seeds.Scene | None = None
    """Where an answer that is ok must be right."""
    inputs: list[Path] = field(default_factory=list)


def make(
    seed: int, number: int, kinds: tuple[str, ...], folder: Path, *, runs: float = 0.9
) -> Case:
    """Write a case's files; the same seed, number and kinds give the same case.

    Args:
        seed: Of all cases.
        number: Of the case.
        kinds: What may be damaged.
        folder: Where the files go.
        runs: Share of logs that are calibrated; the others are inspected.
    """
    rng = Random(f"{seed}-{number}")  # noqa: S311 - no secret
    kind = rng.choices(kinds, [KINDS[kind] for kind in kinds])[0]
    case = _MAKERS[kind](rng, folder)
    if case.argv[0] != "run":
        return case
    urdf = case.argv[case.argv.index("--urdf") :] if "--urdf" in case.argv else []
    if rng.random() >= runs:
        case.argv, case.truth = ["inspect", case.argv[1], *urdf], None
    elif rng.random() < _VERIFIED and case.truth is not None and urdf:
        # Is the pose in the URDF right? It is off by a degree, so the answer is never yes.
        case.argv = ["verify", case.argv[1], *urdf]
    return case


def sound_case(scene: Callable[[], seeds.Scene], kind: str, folder: Path) -> Case:
    """A log without any damage."""
    path = seeds.place(seeds.sound(scene, kind), folder / "in")
    return _run(f"sound {kind}", scene(), path, folder)


def _run(what: str, scene: seeds.Scene, path: Path, folder: Path) -> Case:
    argv = ["run", str(path), "-o", str(folder / "result.yaml")]
    inputs = [path]
    if scene.urdf is not None:
        urdf = folder / "robot.urdf"
        urdf.write_bytes(scene.urdf)
        argv += ["--urdf", str(urdf)]
        inputs.append(urdf)
    return Case(f"{scene.name} {what}", argv, folder, scene, inputs)


def _some(rng: Random, begins: str = "") -> tuple[Callable[[], seeds.Scene], str]:
    kinds = [each for each in seeds.KINDS if each.startswith(begins)]
    return rng.choice(seeds.SCENES), rng.choice(kinds)


def _file(content: dict[str, bytes]) -> str:
    """The file of a log that counts."""
    return max(content, key=lambda name: len(content[name]))


def _messages(rng: Random, folder: Path) -> Case:
    scene, kind = _some(rng)
    said, what = damage_messages(scene().messages, kind, rng)
    path = folder / "in" / "log"
    path.parent.mkdir()
    try:
        seeds.write(path, said, kind)
    # The writers check what they are given: then there is nothing to read.
    except Exception as error:  # noqa: BLE001
        return _run(f"{kind}: unwritable ({error})", scene(), path.parent / "none", folder)
    return _run(f"{kind}: {what}", scene(), path, folder)


def _log(
    begins: str, change: Callable[[bytes, Random], tuple[bytes, str]]
) -> Callable[[Random, Path], Case]:
    def made(rng: Random, folder: Path) -> Case:
        scene, kind = _some(rng, begins)
        files = dict(seeds.sound(scene, kind))
        name = _file(files)
        if begins == "mcap" and not files[name].startswith(b"\x89MCAP0"):
            files[name], what = damage(files[name], rng)
        else:
            files[name], what = change(files[name], rng)
        path = seeds.place(files, folder / "in")
        return _run(f"{kind}: {what}", scene(), path, folder)

    return made


def _db3(rng: Random, folder: Path) -> Case:
    scene, kind = _some(rng, "db3")
    if kind == "db3-file":
        kind = "db3"
    files = dict(seeds.sound(scene, kind))
    name = _file(files)
    changed, what = damage_db3(files.pop(name), rng)
    files |= {name + ending: content for ending, content in changed.items()}
    path = seeds.place(files, folder / "in")
    if rng.random() < 0.5:
        path = path / name
    return _run(f"{kind}: {what}", scene(), path, folder)


def _folder(rng: Random, folder: Path) -> Case:
    """Folders whose files are missing, strange or of several storages."""
    scene = rng.choice(seeds.SCENES)
    kind = rng.choice(("db3", "db3-file", "mcap2", "mcap2-file", "db3-message"))
    files = dict(seeds.sound(scene, kind))
    path = seeds.place(files, folder / "in")
    metadata, name = path / "metadata.yaml", _file(files)
    done = []
    for _ in range(rng.choice((1, 2))):
        how = rng.randrange(7)
        done.append(f"change {how}")
        match how:
            case 0:
                metadata.unlink(missing_ok=True)
            case 1:
                (path / name).unlink(missing_ok=True)
            case 2:
                (path / name).write_bytes(b"")
            case 3:
                other = seeds.sound(scene, rng.choice(seeds.KINDS))
                target = path / rng.choice((name + "x", "log_1.mcap", "a.db3"))
                target.write_bytes(other[_file(other)])
            case 4 if metadata.exists():
                changed, told = damage_text(metadata.read_bytes(), rng)
                metadata.write_bytes(changed)
                done.append(told)
            case 5:
                with suppress(FileExistsError):
                    (path / "loop").symlink_to(path / "loop")
                    (path / "nowhere.db3").symlink_to("missing")
            case _:
                with suppress(FileNotFoundError):
                    (path / name).rename(path / "renamed.bag")
    given = metadata if metadata.exists() and rng.random() < 0.3 else path
    return _run(f"{kind}: {', '.join(done)}", scene(), given, folder)


def _urdf(rng: Random, folder: Path) -> Case:
    scene = seeds.arm()
    path = seeds.place(seeds.sound(seeds.arm, "mcap-none"), folder / "in")
    case = _run("", scene, path, folder)
    assert scene.urdf is not None
    urdf, what = damage_urdf(scene.urdf, rng)
    case.what = f"urdf: {what}"
    case.inputs[1].write_bytes(urdf)
    if not same_chain(scene.urdf, urdf):
        case.truth = None
    return case


def _result(rng: Random, folder: Path) -> Case:
    scene = seeds.arm()
    assert scene.urdf is not None
    urdf, sound, result = folder / "robot.urdf", folder / "sound.yaml", folder / "result.yaml"
    urdf.write_bytes(scene.urdf)
    text = _sound_result(rng.random() < 0.3)
    sound.write_bytes(text)
    changed, what = damage_text(text, rng)
    result.write_bytes(changed)
    urdf_changed = ""
    if rng.random() < 0.2:
        content, urdf_changed = damage_urdf(scene.urdf, rng)
        urdf.write_bytes(content)
    argv = rng.choice(
        (
            ["apply", str(result), "--urdf", str(urdf)],
            ["apply", str(result), "--urdf", str(urdf), "--force"],
            ["diff", str(sound), str(result)],
        )
    )
    return Case(f"result: {what} {urdf_changed}", argv, folder, None, [urdf, sound, result])


@cache
def _sound_result(as_json: bool) -> bytes:
    from imucalib_cli.cli.main import main

    with tempfile.TemporaryDirectory() as name:
        case = sound_case(seeds.arm, "mcap-none", Path(name))
        assert main([*case.argv, "-q", "--format", "json" if as_json else "yaml"]) == 0
        return (Path(name) / "result.yaml").read_bytes()


def warm() -> None:
    """Make what all cases share, before workers are forked."""
    for scene in seeds.SCENES:
        for kind in seeds.KINDS:
            seeds.sound(scene, kind)
    for as_json in (False, True):
        _sound_result(as_json)


_MAKERS: dict[str, Callable[[Random, Path], Case]] = {
    "messages": _messages,
    "mcap": _log("mcap", damage_mcap),
    "bag": _log("bag", damage_bag),
    "db3": _db3,
    "bytes": _log("", damage),
    "folder": _folder,
    "urdf": _urdf,
    "result": _result,
}
