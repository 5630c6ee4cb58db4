"""Why Dask and not Ray: what each weighs and how long it takes to start, on this machine.

    python -m benchmarks.engines [--keep FOLDER]

Each is installed into a fresh environment by pip, then starts a cluster of this machine with two
workers and no dashboard, runs one task that does nothing, and stops; whole processes, in turn.
"""

from __future__ import annotations

import statistics
import subprocess
import tempfile
import time
import venv
from pathlib import Path

from benchmarks.batch import family, megabytes
from benchmarks.common import arguments, table

REPEATS = 3
SCRIPTS = {
    "distributed": """
if __name__ == "__main__":
    from distributed import Client, LocalCluster
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            assert client.submit(len, "abc").result() == 3
            print("ready", flush=True)
            input()
""",
    "ray": """
if __name__ == "__main__":
    import ray
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    assert ray.get(ray.remote(lambda text: len(text)).remote("abc")) == 3
    print("ready", flush=True)
    input()
    ray.shutdown()
""",
}


def main() -> None:
    """Print the table."""
    words = "folder of the environments, to use them again"
    keep = arguments(__doc__, keep={"type": Path, "help": words}).keep
    with tempfile.TemporaryDirectory() as temporary:
        folder = keep or Path(temporary)
        pythons = {name: installed(folder / f"v_{name}", name) for name in SCRIPTS}
        measured: dict[str, list[tuple[float, float, float, int]]] = {name: [] for name in SCRIPTS}
        for _ in range(REPEATS):
            for name, python in pythons.items():
                measured[name].append(
                    started(python, Path(temporary) / f"start_{name}.py", SCRIPTS[name])
                )
        line = table(
            *("", "packages", "MB installed|.0f", "s to the first answer|.2f", "s to stop|.2f"),
            *("MB|.0f", "processes|.0f"),
        )
        for name, python in pythons.items():
            medians = map(statistics.median, zip(*measured[name], strict=True))
            line(f"{name} {version_of(python, name)}", *weight_of(python), *medians)


def installed(folder: Path, name: str) -> Path:
    """Python of an environment with a package and what that needs."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
        subprocess.run([python, "-m", "pip", "install", "-q", name], check=True)
    return python


def weight_of(python: Path) -> tuple[int, float]:
    """Packages, and MB of their files, beside pip and setuptools; without compiled Python."""
    (packages,) = python.parents[1].glob("lib/python*/site-packages")
    names = {path.name.split("-")[0] for path in packages.glob("*.dist-info")}
    files = (
        path
        for entry in packages.iterdir()
        if not entry.name.startswith(("pip", "setuptools", "pkg_resources", "_distutils"))
        for path in (entry.rglob("*") if entry.is_dir() else [entry])
    )
    size = sum(path.stat().st_size for path in files if path.is_file() and path.suffix != ".pyc")
    return len(names - {"pip", "setuptools"}), size / 1e6


def version_of(python: Path, name: str) -> str:
    """Of a package."""
    script = f"import importlib.metadata; print(importlib.metadata.version({name!r}))"
    return subprocess.run(
        [python, "-c", script], check=True, capture_output=True, text=True
    ).stdout.strip()


def started(python: Path, file: Path, script: str) -> tuple[float, float, float, int]:
    """Seconds until the first answer and from there to the end, MB and processes in between."""
    file.write_text(script)
    begun = time.perf_counter()
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [python, file], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdin is not None  # noqa: S101 - for mypy
        assert process.stdout is not None  # noqa: S101 - for mypy
        for line in process.stdout:
            if line.strip() == "ready":
                break
        ready = time.perf_counter() - begun
        members = family(process.pid)
        size = sum(share for _, share in map(megabytes, members))
        begun = time.perf_counter()
        process.stdin.write("\n")
        process.stdin.close()
        process.wait()
    return ready, time.perf_counter() - begun, size, len(members)


if __name__ == "__main__":
    main()
