"""The studies there are, each imported only when it is asked for."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.study.experiment import Study

STUDIES: dict[str, tuple[str, str]] = {
    "derivation": (
        "imucalib_cli.study.derivation_study",
        "Figures 5 to 7: derived against measured acceleration",
    ),
    "initial-error": (
        "imucalib_cli.study.initial_error_study",
        "Table 3: sensitivity to the initial guess",
    ),
    "methods": ("imucalib_cli.study.methods_study", "Table 1: the methods compared"),
    "noise": ("imucalib_cli.study.noise_study", "Table 2: sensitivity to IMU noise"),
    "window": ("imucalib_cli.study.window_study", "open question: the filters' window"),
    "optimiser": ("imucalib_cli.study.optimiser_study", "open question: the optimiser"),
    "encoder": ("imucalib_cli.study.encoder_study", "open question: noise of the encoders"),
    "bias": ("imucalib_cli.study.bias_study", "open question: biases of the IMU"),
    "rate": ("imucalib_cli.study.rate_study", "open question: rates of the log"),
}
"""Module, which has ``load(file, quick)``, and what it is, by name."""

_PACKAGES = {"mujoco": "MuJoCo", "cv2": "OpenCV"}
_SIMULATION = ("mujoco",)
_NEEDED = {"methods": ("mujoco", "cv2")}
"""Modules of optional dependencies; of a study that is not named the simulation's."""


def see_installed(name: str) -> None:
    """See before any run that a study's optional dependencies are there.

    Raises:
        InputError: One is not.
    """
    missing = [
        _PACKAGES[module] for module in _NEEDED.get(name, _SIMULATION) if not _is_there(module)
    ]
    if missing:
        raise InputError(
            f"study {name} needs {' and '.join(missing)}, which "
            f"{'is' if len(missing) == 1 else 'are'} not installed: pip install 'imucalib[study]'"
        )


def can_draw() -> bool:
    """Whether matplotlib is there."""
    return _is_there("matplotlib")


def _is_there(module: str) -> bool:
    return find_spec(module) is not None


def load_study(name: str, file: Path | None = None, *, quick: bool = False) -> Study:
    """A study with its parameters.

    Args:
        name: One of STUDIES.
        file: Parameters of the user's own, as configs/studies/ has them.
        quick: Few runs, for a look or for CI.

    Raises:
        InputError: The parameters cannot be read.
    """
    module, _ = STUDIES[name]
    study: Study = import_module(module).load(file, quick=quick)
    return study
