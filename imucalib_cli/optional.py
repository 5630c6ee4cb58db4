"""Optional dependencies, imported when they are used."""

from importlib import import_module
from typing import Any

from imucalib_cli.errors import InputError

PACKAGES = {
    "mujoco": "MuJoCo",
    "cv2": "OpenCV",
    "matplotlib": "matplotlib",
    "pyarrow": "pyarrow",
    "fsspec": "fsspec",
    "aiohttp": "aiohttp",
    "distributed": "Dask",
    "google": "protobuf",
}
"""Common name of each module."""


def optional(module: str, need: str, extra: str) -> Any:
    """Import an optional dependency.

    Args:
        module: One of PACKAGES, or a module in one.
        need: Who needs it, such as "simulation needs".
        extra: Of imucalib, which installs it.

    Raises:
        InputError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        package = PACKAGES[module.split(".", maxsplit=1)[0]]
        raise InputError(
            f"{need} {package}, which is not installed: pip install 'imucalib[{extra}]'"
        ) from error
