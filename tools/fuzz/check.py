"""Run one case in this process and say what was wrong with how imucalib took it."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import resource
import signal
import sys
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from imucalib_cli.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from imucalib_cli.jobs.input.recording import Recording
    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from tools.fuzz.cases import Case
    from tools.fuzz.seeds import Scene

SECONDS = 10.0
"""Of processor time; the clock on the wall says more of the other processes."""
MEMORY = 1 << 30
_SOFT, _HARD = 51.0, 400.0
"""Squared distance from truth in units of the stated covariance: a chance of 3e-9, and absurd."""
_LONGEST_LINE = 4000
_LINE = re.compile(r"[a-z][a-z ]*: \S.*")
_CODES = {0, 1, 2, 3, 4}


class _Hang(BaseException):
    """Not an Exception: nothing may swallow it."""


class _KnownError(BaseException):
    """What was read was read in a case before, so the answer is known."""


def prepare() -> None:
    """Make this process fit to run cases: limits, and no warnings of libraries on stderr."""
    os.environ["IMUCALIB_TRACEBACK"] = "1"
    warnings.simplefilter("ignore")
    signal.signal(signal.SIGPROF, on_time_out)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY + (256 << 20), resource.RLIM_INFINITY))
    _stop_at_known_data()


def _stop_at_known_data() -> None:
    """Estimate only from data that no case of this process had: much damage changes none."""
    from imucalib_cli.jobs import calibrate
    from imucalib_cli.jobs.input.recording import read_recording
    from imucalib_cli.jobs.input.request import unheard

    seen = set[bytes]()

    def read_new(request: CalibrationRequest, progress: Progress = unheard) -> Recording:
        recording = read_recording(request, progress)
        digest = _digest(recording)
        if digest in seen:
            raise _KnownError
        seen.add(digest)
        return recording

    calibrate.read_recording = read_new  # type: ignore[attr-defined]


def _digest(recording: Recording) -> bytes:
    """Of all that an estimate depends on."""
    digest = hashlib.blake2b()
    told = [recording.clock.kind, recording.robot and recording.robot.sha256]
    arrays: list[NDArray[Any]] = [
        each for imu in recording.imus for each in (imu.header_ns, imu.log_ns)
    ]
    for imu in recording.imus:
        told += [imu.topic, imu.frame_id]
        arrays += [imu.gyro, imu.accel]
    tracks = [*recording.sources.joints, *(edge.track for edge in recording.sources.edges)]
    for track in tracks:
        told += [track.name, *track.names]
        arrays += [track.t, track.values]
    digest.update(repr(told).encode("utf-8", "replace"))
    for each in arrays:
        digest.update(each.tobytes())
    return digest.digest()


def on_time_out(*_: object) -> None:
    """Say that a case takes too long."""
    raise _Hang


def check(case: Case) -> tuple[int | None, list[str]]:
    """The exit code, and findings: none if all is well."""
    before = _fingerprint(case.inputs)
    findings: list[str] = []
    words, out = io.StringIO(), io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    code: int | None = None
    _reset_peak()
    floor = _peak()
    try:
        with contextlib.redirect_stderr(words), contextlib.redirect_stdout(out), _temporary(case):
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            try:
                code = main(case.argv)
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0)
    except _KnownError:
        pass
    except _Hang:
        findings.append(f"HANG beyond {SECONDS:g} s:\n{traceback.format_exc(limit=-12)}")
    except MemoryError:
        findings.append(f"MEMORY: an allocation beyond {MEMORY >> 20} MiB:\n{_trace()}")
    except Exception:  # noqa: BLE001 - this is what is looked for
        findings.append(f"TRACEBACK:\n{_trace()}")
    used = _peak() - floor
    if used > MEMORY:
        findings.append(f"MEMORY: {used >> 20} MiB")
    if _fingerprint(case.inputs) != before:
        findings.append("INPUT changed")
    if code is not None:
        findings += _words(code, words.getvalue())
        findings += _answer(case, code)
    return code, findings


def _trace() -> str:
    return traceback.format_exc(limit=-8)


def _words(code: int, words: str) -> Iterator[str]:
    if code not in _CODES:
        yield f"EXIT code {code}"
    lines = words.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    if code in {1, 2} and not errors:
        yield f"SILENT: exit {code} without an error line: {words!r}"
    snippet = code == 1 and any("snippet" in line or "<joint" in line for line in lines)
    for line in lines:
        if line.startswith("internal error"):
            yield f"INTERNAL: {line[:300]!r}"
        if not _LINE.fullmatch(line) and not snippet:
            yield f"WORDS: {line[:300]!r}"
        if len(line) > _LONGEST_LINE:
            yield f"LONG LINE of {len(line)}: {line[:200]!r}"
        if not line.isprintable():
            yield f"CONTROL characters: {line[:300]!r}"


def _answer(case: Case, code: int) -> Iterator[str]:
    if case.truth is None or code != 0:
        return
    if case.argv[0] == "verify":
        yield "WRONG OK (verify): the URDF's pose is a degree off"
        return
    result = Path(case.argv[case.argv.index("-o") + 1])
    if not result.is_file():
        yield "MISSING: exit 0 without a result"
        return
    for document in yaml.safe_load_all(result.read_text()):
        if document["status"] != "ok":
            yield f"STATUS {document['status']} with exit 0"
            continue
        distance, mm, deg = _distance(document, case.truth)
        if not distance < _SOFT:
            hard = "hard" if not distance < _HARD else "soft"
            yield f"WRONG OK ({hard}): {distance:.3g} sigma², {mm:.3g} mm, {deg:.3g} deg"


def _distance(document: dict[str, Any], truth: Scene) -> tuple[float, float, float]:
    """Squared distance in the covariance's units, mm, degrees (design of the result: docs)."""
    pose = document["transform"]
    covariance = np.array(document["covariance"], dtype=float)
    dt = np.array(pose["translation"], dtype=float) - truth.t_parent_imu
    R = Rotation.from_quat(pose["rotation_xyzw"]) * Rotation.from_matrix(truth.R_parent_imu).inv()
    error = np.concatenate([dt, R.as_rotvec()])
    distance = float(error @ np.linalg.solve(covariance, error))
    return distance, float(np.linalg.norm(dt)) * 1e3, float(np.degrees(R.magnitude()))


def _fingerprint(inputs: Iterable[Path]) -> dict[str, str]:
    """Names and contents of inputs, and of what lies beside a file."""
    found: dict[str, str] = {}
    for path in inputs:
        folder = path if path.is_dir() else path.parent
        for each in sorted(folder.iterdir()):
            # A -shm is SQLite's own scratch; one that a crash left is written anew.
            if each.is_file() and each.name != "result.yaml" and not each.name.endswith("-shm"):
                found[str(each)] = hashlib.sha256(each.read_bytes()).hexdigest()
        if path.is_file():
            found[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


@contextlib.contextmanager
def _temporary(case: Case) -> Iterator[None]:
    """Temporary files where they go away with the case."""
    import tempfile

    folder = case.folder / "tmp"
    folder.mkdir()
    before, tempfile.tempdir = tempfile.tempdir, str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = before


def _reset_peak() -> None:
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int:
    """Largest resident size since the last reset, bytes."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << (
        0 if sys.platform == "darwin" else 10
    )
