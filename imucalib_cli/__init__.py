"""imucalib: where on the robot is the IMU, from a log of it moving and a URDF.

From Python: ``import imucalib_cli as ic; ic.calibrate("log.mcap", urdf="robot.urdf")``; see
:mod:`imucalib_cli.api`, whose names are here too and are imported when they are used.
"""

TYPE_CHECKING = False  # as in typing, whose import takes longer than all the rest here
if TYPE_CHECKING:
    from imucalib_cli.api import (
        Calibration,
        ChoiceError,
        ImucalibError,
        InputError,
        MatchedOptions,
        PaperOptions,
        PosePrior,
        Result,
        Tolerance,
        Units,
        UntrustedError,
        WindowChoice,
        calibrate,
        calibrate_arrays,
    )

__version__ = "0.1.0"

__all__ = [
    "Calibration",
    "ChoiceError",
    "ImucalibError",
    "InputError",
    "MatchedOptions",
    "PaperOptions",
    "PosePrior",
    "Result",
    "Tolerance",
    "Units",
    "UntrustedError",
    "WindowChoice",
    "__version__",
    "calibrate",
    "calibrate_arrays",
]


def __getattr__(name: str) -> object:
    """A name of the Python interface; importing it takes numpy and more."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from imucalib_cli import api

    return getattr(api, name)
