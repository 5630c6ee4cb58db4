"""Fuzz imucalib: ``python -m tools.fuzz --cases 20000`` from the root of the repository."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tools.fuzz.cases import KINDS, make
from tools.fuzz.workers import Job, run

_TOLD_EVERY = 1000
_MOST_KEPT = 20
"""Cases of one sort whose files are kept."""


def main() -> int:
    """Run cases, keep those with findings, say how to repeat them."""
    parser = argparse.ArgumentParser(prog="python -m tools.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--kind", choices=KINDS, action="append", help="repeatable; default: all")
    parser.add_argument("--runs", type=float, default=0.9, help="share of logs to calibrate")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"))
    parser.add_argument("--write", type=Path, help="write the first case there and run nothing")
    options = parser.parse_args()
    kinds = tuple(options.kind or KINDS)
    if options.write:
        options.write.mkdir()
        case = make(options.seed, options.first, kinds, options.write, runs=options.runs)
        print(case.what, "\nimucalib", " ".join(case.argv))  # noqa: T201
        return 0
    numbers = range(options.first, options.first + options.cases)
    start, codes, found = time.monotonic(), Counter[object](), 0
    kept: Counter[str] = Counter()
    again = " ".join([f"--runs {options.runs}", *(f"--kind {each}" for each in options.kind or ())])
    for done in run(Job(options.seed, kinds, options.runs), numbers, options.workers):
        codes[done.code] += 1
        if codes.total() % _TOLD_EVERY == 0:
            print(codes.total(), "cases", file=sys.stderr, flush=True)  # noqa: T201
        if not done.findings:
            continue
        found += 1
        text = "\n".join(done.findings)
        which = f"--seed {options.seed} --first {done.number} --cases 1 {again}"
        print(f"case {done.number}: {done.what}\n{text}")  # noqa: T201
        print(f"again: python -m tools.fuzz {which}\n", flush=True)  # noqa: T201
        kept[text[:8]] += 1
        if done.what and kept[text[:8]] <= _MOST_KEPT:
            _keep(options.keep / f"{options.seed}-{done.number}", options.seed, done.number, kinds)
    took = time.monotonic() - start
    codes["none, the data being known"] = codes.pop(None, 0)
    told = ", ".join(f"exit {code}: {count}" for code, count in sorted(codes.items(), key=str))
    print(f"{options.cases} cases in {took:.0f} s, {told}; {found} with findings")  # noqa: T201
    return 1 if found else 0


def _keep(folder: Path, seed: int, number: int, kinds: tuple[str, ...]) -> None:
    """Write a case's files once more where they stay."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory() as name:
        here = Path(name) / "case"
        here.mkdir()
        make(seed, number, kinds, here)
        shutil.copytree(here, folder, symlinks=True)


if __name__ == "__main__":
    sys.exit(main())
