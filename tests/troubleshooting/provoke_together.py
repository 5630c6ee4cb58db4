"""Several logs of one mount: what does not belong together, and what cannot be solved again."""

from collections.abc import Callable
from pathlib import Path

from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.recording import Recording
from tests.simulate.simulate_samples import recorded
from tests.troubleshooting.provoke_recordings import moving_only
from tests.troubleshooting.scene import (
    ARM,
    RATE,
    Provocation,
    Scene,
    Seen,
    noisy,
    provocation,
    with_imu,
)


@provocation
def together(scene: Scene, *seeds: int, also: Callable[[], Recording] | None = None) -> Seen:
    """`imucalib run --together` on recordings of the arm, and another one."""
    recordings = [noisy(seed=seed) for seed in seeds] + ([also()] if also else [])
    logs = [scene.log(each, f"log{index}.mcap") for index, each in enumerate(recordings)]
    return scene.run(*logs, "--together")


def moved() -> Recording:
    """The same arm with the IMU 8 mm away."""
    rates = {"imu_rate": RATE, "robot_rate": RATE}
    recording = recorded(ARM, duration=24.0, mount_xyz=(-0.0225, 0.108, 0.0), **rates)
    return corrupt(recording, load_grade("industrial"), seed=6)


def mirrored() -> Recording:
    return with_imu(noisy(), gyro=-noisy().imu.gyro)


def other_priors(scene: Scene) -> Seen:
    one = _statistics(scene)
    return scene.cli("combine", one, _statistics(scene, "--robot", "exact", seed=4))


def missing(scene: Scene) -> Seen:
    logs = [scene.log(noisy(seed=seed), f"{seed}.mcap") for seed in (3, 4)]
    other = scene.log(noisy(seed=5), "other.mcap", imu_topic="/imu/other")
    return scene.run(*logs, other, "--together")


def batch_notes(scene: Scene) -> Seen:
    """A log by two names, parts by their names, and another recording in the place of one."""
    scene.path("logs").mkdir()
    log = scene.log(noisy(), "logs/monday.mcap")
    for part in (0, 1):
        scene.path(f"logs/run_{part}.mcap").write_bytes(b"")
    command = ["batch", scene.path("logs"), log, "-o", scene.path("results"), "--workers", "1"]
    command += ["--urdf", scene.urdf()]
    scene.cli(*command)
    scene.log(noisy(seed=4), "logs/monday.mcap")
    return scene.cli(*command)


def _statistics(scene: Scene, *options: object, seed: int = 3) -> Path:
    """The statistics of a run."""
    path = scene.path(f"log{seed}.npz")
    assert scene.run(scene.log(noisy(seed=seed)), "--statistics", path, *options).code in {0, 3}
    return path


def other_robot(scene: Scene) -> Seen:
    one = _statistics(scene)
    urdf = scene.path("robot.urdf")
    urdf.write_text(urdf.read_text().replace("<robot", "<!-- changed --><robot", 1))
    return scene.cli("combine", one, _statistics(scene, seed=4))


def held(scene: Scene) -> Seen:
    one = _statistics(scene, "--robot", "exact")
    return scene.cli("combine", one, "--robot", "nominal")


def damaged(scene: Scene) -> Seen:
    path = _statistics(scene)
    path.write_bytes(path.read_bytes()[:-1000])
    return scene.cli("combine", path)


TOGETHER: dict[str, Provocation] = {
    "together-few": together(3, 4),
    "together-disagree": together(3, 4, 5, also=moved),
    "together-left-out": together(3, 4, also=mirrored),
    "together-one-left": together(3, also=mirrored),
    "together-apart": together(3, also=moved),
    "together-far": together(3, 4, 5, also=moving_only(5)),
    "together-twice": together(3, 4, 5, 5),
    "together-missing": missing,
    "combine-robots": other_robot,
    "combine-priors": other_priors,
    "combine-held": held,
    "combine-no-statistics": lambda scene: scene.cli("combine", scene.result()),
    "combine-damaged": damaged,
}
UNLISTED: dict[str, Provocation] = {"batch-notes": batch_notes}
"""Notes, which nobody has to look up."""
