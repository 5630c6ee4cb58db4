"""Renew messages.txt: ``python -m tests.troubleshooting [KEY ...]``; the diff is to be read."""

import sys
import tempfile
from pathlib import Path

from tests.troubleshooting.snapshot import FILE, PROVOCATIONS, provoked, store, stored

outputs = stored() if FILE.exists() else {}
for key in sys.argv[1:] or PROVOCATIONS:
    with tempfile.TemporaryDirectory() as folder:
        outputs[key] = provoked(key, Path(folder))
store({key: outputs[key] for key in PROVOCATIONS if key in outputs})
