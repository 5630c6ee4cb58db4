"""What can go wrong in a way a user can mend: one class for each exit code."""


class ImucalibError(Exception):
    """Base of every error a user may see; its text is one line that names the remedy."""


class InputError(ImucalibError):
    """An input cannot be used: says which file and topic, why, and what to do (exit code 1)."""


class ChoiceError(ImucalibError):
    """The user must choose or named something that is not there; lists the candidates (exit 2)."""


class UntrustedError(ImucalibError):
    """A result exists but must not be used for this without ``--force`` (exit code 3)."""
