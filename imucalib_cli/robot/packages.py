"""Find packages that a xacro names by $(find PACKAGE), with and without ROS."""

from __future__ import annotations

import importlib
import re
import sys
from contextlib import suppress
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

_ASKED = ("ament_index_python", "ament_index_python.packages")
"""Modules of ROS that xacro imports to find a package."""
_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
_HEAD = 1 << 16
"""Bytes of a package.xml that are searched: its name stands first."""


def find_packages_near(path: Path) -> list[str]:
    """Let xacro in this process find packages that are not installed.

    They lie in and beside the folders above a file, as the sources of a workspace do.

    Returns:
        Names of packages that were not found, as they are asked for; empty at first.
    """
    missing: list[str] = []
    installed: Any = None
    with suppress(ImportError):
        installed = importlib.import_module(_ASKED[1])

    def get_package_share_directory(package: str) -> str:
        with suppress(LookupError):  # ROS does not know the package
            if installed is not None:
                return str(installed.get_package_share_directory(package))
        folders = path.resolve().parents
        for place in (place for folder in folders for place in (folder, folder / package)):
            if place.name == package and place.is_dir():
                return str(place)
        for folder in folders:
            with suppress(OSError):
                for manifest in (folder / "package.xml", *sorted(folder.glob("*/package.xml"))):
                    if _name_in(manifest) == package.encode():
                        return str(manifest.parent)
        missing.append(package)
        raise LookupError(package)

    modules: dict[str, Any] = {name: ModuleType(name) for name in _ASKED}
    modules[_ASKED[1]].get_package_share_directory = get_package_share_directory
    sys.modules.update(modules)
    return missing


def _name_in(manifest: Path) -> bytes:
    """The name of a package, which may differ from its folder's; empty if there is none."""
    with suppress(OSError), manifest.open("rb") as file:
        found = _NAME.search(file.read(_HEAD))
        return b"" if found is None else found[1]
    return b""
