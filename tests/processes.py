"""Programs in processes of their own."""

from __future__ import annotations

import subprocess
import sys
from typing import Any


def python(*arguments: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """What a Python process printed, and its exit code."""
    command = [sys.executable, *map(str, arguments)]
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more}
    return subprocess.run(command, text=True, check=False, **given)
