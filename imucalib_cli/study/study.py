"""The list of studies, and how their parameters are read."""

from __future__ import annotations

from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from imucalib_cli.configuration import build, read_builtin, read_yaml
from imucalib_cli.errors import InputError
from imucalib_cli.optional import PACKAGES
from imucalib_cli.simulate.options import NoiseOptions

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.study.experiment import Study

STUDIES: dict[str, tuple[str, str]] = {
    "derivation": (
        "derivation:DerivationStudy",
        "Figures 5 to 7: derived against measured acceleration",
    ),
    "initial-error": (
        "noise_and_guess:InitialErrorStudy",
        "Table 3: sensitivity to the initial guess",
    ),
    "methods": ("methods:MethodsStudy", "Table 1: the methods compared"),
    "noise": ("noise_and_guess:NoiseStudy", "Table 2: sensitivity to IMU noise"),
    "window": ("sweeps:WindowStudy", "open question: the filters' window"),
    "optimiser": ("optimiser:OptimiserStudy", "open question: the optimiser"),
    "encoder": ("sweeps:EncoderStudy", "open question: noise of the encoders"),
    "bias": ("sweeps:BiasStudy", "open question: biases of the IMU"),
    "rate": ("sweeps:RateStudy", "open question: rates of the log"),
}
"""By name: module of imucalib_cli.study.studies with its class, and a description."""

_NEEDED = {"methods": ("mujoco", "cv2")}
"""Modules of optional dependencies; the others need the simulation's alone."""


def load_study(name: str, file: Path | None = None, *, quick: bool = False) -> Study:
    """Read one of STUDIES with its parameters; its module is imported only here.

    They are those of configs/studies/<name>.yaml, or of the user's own file. For few runs, for a
    quick look or for CI, its section ``quick`` replaces some of them.

    Raises:
        InputError: A parameter is missing, unknown or of another type; names it.
    """
    module, _, kind = STUDIES[name][0].partition(":")
    made: type[Study] = getattr(import_module(f"imucalib_cli.study.studies.{module}"), kind)
    where = f"{name}.yaml" if file is None else str(file)
    raw: dict[str, Any] = read_builtin(f"studies/{name}") if file is None else read_yaml(file)
    short = raw.pop("quick", None)
    if quick and short is None:
        raise InputError(f"{where}: has no section quick: state what a short run changes there")
    if not isinstance(short, dict | None):
        raise InputError(f"{where}: quick: expected keys and values, found {short!r}")
    study = build(made, raw | short if quick and short else raw, where)
    _check_counts(study, where)
    return study


def _check_counts(parameters: object, where: str) -> None:
    """Refuse empty lists (except optional ones) and counts below one, by the name of the key."""
    for part in fields(parameters):  # type: ignore[arg-type]
        value, here = getattr(parameters, part.name), f"{where}: {part.name}"
        if value == () and part.default is MISSING:
            raise InputError(f"{here}: an empty list; there must be one value")
        if part.name.endswith("seed"):
            continue
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, int) and not isinstance(item, bool) and item < 1:
                raise InputError(f"{here}: {item} is no count; 1 or more")
            if is_dataclass(item) and not isinstance(item, NoiseOptions):
                _check_counts(item, here)


def check_installed(name: str) -> None:
    """Check before any run that a study's optional dependencies are installed.

    Raises:
        InputError: One is not.
    """
    missing = [
        PACKAGES[module] for module in _NEEDED.get(name, ("mujoco",)) if not find_spec(module)
    ]
    if missing:
        raise InputError(
            f"study {name} needs {' and '.join(missing)}, which "
            f"{'is' if len(missing) == 1 else 'are'} not installed: pip install 'imucalib[study]'"
        )


def can_draw() -> bool:
    """Whether matplotlib is there."""
    return find_spec("matplotlib") is not None
