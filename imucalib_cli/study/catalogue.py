"""The studies there are, each imported only when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

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
