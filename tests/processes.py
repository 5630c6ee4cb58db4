"""Programs in processes of their own."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parents[1]


def run(*command: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """What a process printed, and its exit code."""
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more}
    return subprocess.run([*map(str, command)], text=True, check=False, **given)


def python(*arguments: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """Of a Python process."""
    return run(sys.executable, *arguments, **more)


def start_script(script: Path, text: str, **more: Any) -> subprocess.Popen[bytes]:
    """A running Python process of a new script, which may import these tests."""
    script.write_text(text)
    # A process that is killed leaves its temporary files beside the script.
    environment = {**os.environ, "PYTHONPATH": str(_ROOT), "TMPDIR": str(script.parent)}
    given = {"cwd": _ROOT, "env": environment, "stderr": subprocess.PIPE, **more}
    return subprocess.Popen([sys.executable, str(script)], **given)


def wait_for(condition: Callable[[], object]) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("waited half a minute in vain")


def runs(pid: int) -> bool:
    """Whether a process has not ended, even if its status has not been read yet."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"
