"""Answers of verify and diff, and results that cannot be used or written."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt
from tests.troubleshooting.scene import Scene, Seen, clean, joint, noisy, provokes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ARM, BODY = "rihibot", "barbot"


def result(scene: Scene, name: str = "result.yaml", *, seed: int = 3, within: str = "log") -> Path:
    """Of a run on one log of the arm; another seed is another log."""
    recording = corrupt(clean(ARM), load_grade("industrial"), seed=seed)
    log = scene.log(recording, f"{within}{seed}.mcap")
    assert scene.run(log, "-o", scene.path(name)).code == 0
    return scene.path(name)


def edited(path: Path, pattern: str, new: str) -> Path:
    """A result with something changed by hand."""
    text, count = re.subn(pattern, new, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)
    return path


def apply_text(content: str) -> Callable[[Scene], Seen]:
    """`imucalib apply` of a file that is no result."""

    def provocation(scene: Scene) -> Seen:
        scene.path("result.yaml").write_text(content)
        return scene.cli("apply", scene.path("result.yaml"), "--urdf", scene.urdf())

    return provocation


provokes("yaml-alias")(apply_text("a: &a [*a]\n"))
provokes("yaml-deep")(apply_text("a: " + "[" * 100))
provokes("yaml-twice")(apply_text("schema: 1\nschema: 1\n"))


def verify(scene: Scene, *arguments: object) -> Seen:
    log = scene.log(noisy(ARM))
    return scene.cli("verify", log, "--urdf", scene.urdf(), *arguments)


@provokes("verify-no")
def _(scene: Scene) -> Seen:
    return verify(scene, "--within", "1mm,0.1deg")


@provokes("verify-between")
def _(scene: Scene) -> Seen:
    return verify(scene, "--within", "4.38mm,5deg")


@provokes("verify-untrusted")
def _(scene: Scene) -> Seen:
    reverse = 'axis xyz="0 0 1"', 'axis xyz="0 0 -1"'
    urdf = scene.urdf(lambda text: joint(text, "elbow_joint", *reverse))
    return scene.cli("verify", scene.log(noisy(ARM)), "--urdf", urdf)


@provokes("verify-no-pose")
def _(scene: Scene) -> Seen:
    log = scene.log(noisy(ARM), imu_frame="imu")
    return scene.cli("verify", log, "--urdf", scene.urdf(), "--parent", "wrist_3_link")


@provokes("verify-no-urdf")
def _(scene: Scene) -> Seen:
    log = scene.log(noisy(BODY), imu_frame="imu")
    return scene.cli("verify", log, "--parent", "bar_link", "--gravity", "none")


@provokes("diff-moved")
def _(scene: Scene) -> Seen:
    a = result(scene, "a.yaml")
    moved = corrupt(clean(ARM), load_grade("industrial"), seed=4)
    assert scene.run(scene.log(moved, "b.mcap"), "-o", scene.path("b.yaml")).code == 0
    b = edited(scene.path("b.yaml"), r"translation: \[-0\.02\d+", "translation: [-0.0245")
    return scene.cli("diff", a, b)


@provokes("diff-same-log")
def _(scene: Scene) -> Seen:
    a = result(scene, "a.yaml")
    return scene.cli("diff", a, result(scene, "b.yaml"))


@provokes("diff-unpaired")
def _(scene: Scene) -> Seen:
    a, b = result(scene, "a.yaml"), result(scene, "b.yaml", seed=4)
    first = a.read_text()
    second = edited(edited(a, "child: imu_link", "child: other"), "imu: /imu/data", "imu: /other")
    a.write_text(first + "---\n" + second.read_text())
    return scene.cli("diff", a, b)


@provokes("diff-parents")
def _(scene: Scene) -> Seen:
    a, b = result(scene, "a.yaml"), result(scene, "b.yaml", seed=4)
    return scene.cli("diff", a, edited(b, r"parent: wrist_3_link", "parent: flange"))


@provokes("covariance-edited")
def _(scene: Scene) -> Seen:
    a, b = result(scene, "a.yaml"), result(scene, "b.yaml", seed=4)
    text = a.read_text()
    first = text.index(",", text.index("covariance:")) + 1
    a.write_text(text[:first] + " 1.0" + text[text.index(",", first) :])
    return scene.cli("diff", a, b)


@provokes("not-a-result")
def _(scene: Scene) -> Seen:
    scene.path("result.yaml").write_text("arm: rihibot\n")
    return scene.cli("apply", scene.path("result.yaml"), "--urdf", scene.urdf())


@provokes("apply-two-results")
def _(scene: Scene) -> Seen:
    a, b = result(scene, "a.yaml"), result(scene, "b.yaml", seed=4)
    scene.path("both.yaml").write_text(a.read_text() + "---\n" + b.read_text())
    return scene.cli("apply", scene.path("both.yaml"), "--urdf", scene.urdf())


@provokes("apply-no-joint")
def _(scene: Scene) -> Seen:
    a = edited(result(scene), r"child: imu_link", "child: imu")
    return scene.cli("apply", a, "--urdf", scene.urdf())


@provokes("untrusted-format")
def _(scene: Scene) -> Seen:
    return scene.run(scene.log(noisy(ARM)), "--format", "urdf", "--require", "0.001mm")


@provokes("output-is-input")
def _(scene: Scene) -> Seen:
    log = scene.log(noisy(ARM))
    return scene.run(log, "-o", log)


@provokes("output-folder")
def _(scene: Scene) -> Seen:
    return scene.run(scene.log(noisy(ARM)), "-o", scene.path("missing/result.yaml"))


@provokes("output-full")
def _(scene: Scene) -> Seen:
    import resource
    import signal

    log = scene.log(noisy(ARM))
    scene.urdf()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, limits[1]))
    try:
        return scene.run(log, "-o", scene.path("result.yaml"))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)


@provokes("output-twice")
def _(scene: Scene) -> Seen:
    log = scene.path("same.mcap")
    return scene.cli("simulate", "barbot", "-o", log, "--urdf", log)


@provokes("output-is-log")
def _(scene: Scene) -> Seen:
    other = scene.path("other.mcap")
    other.write_bytes(scene.log(noisy(ARM)).read_bytes())
    return scene.run(scene.path("log.mcap"), "-o", other)


@provokes("output-is-urdf")
def _(scene: Scene) -> Seen:
    other = scene.path("other.urdf")
    other.write_bytes(scene.urdf().read_bytes())
    return scene.run(scene.log(noisy(ARM)), "-o", other)


@provokes("output-empty")
def _(scene: Scene) -> Seen:
    return scene.run(scene.log(noisy(ARM)), "-o", "")


@provokes("output-numbered")
def _(scene: Scene) -> Seen:
    scene.path("results").mkdir()
    scene.path("results/log.imu_link.yaml").write_text("something else")
    return scene.run(scene.log(noisy(ARM)), "-o", scene.path("results"))


@provokes("output-older")
def _(scene: Scene) -> Seen:
    return scene.run(scene.path("missing.mcap"), "-o", result(scene))


@provokes("output-protected")
def _(scene: Scene) -> Seen:
    target = scene.path("result.yaml")
    target.write_text("")
    target.chmod(0o444)
    return scene.run(scene.log(noisy(ARM)), "-o", target)
