"""``python -m imucalib_cli``: the command ``imucalib``, where its script is not on the PATH."""

import sys

from imucalib_cli.cli.entry import main

if __name__ == "__main__":  # worker processes import this file too
    sys.exit(main())
