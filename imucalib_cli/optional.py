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
    """Import a module of PACKAGES, which an extra of imucalib installs.

    ``need`` says who needs it, such as "simulation needs".

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
