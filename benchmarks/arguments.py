"""What the benchmarks' command lines take: names that are known, and numbers in their range."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterable


def at_least(low: float) -> Callable[[str], int]:
    """Return a reader of whole numbers from ``low``, for `argparse`."""

    def read(text: str) -> int:
        try:
            number = int(text)
        except ValueError:
            number = -1
        if number < low:
            raise argparse.ArgumentTypeError(f"{text}: allowed are whole numbers from {low:g}")
        return number

    return read


def minutes(text: str) -> float:
    """Read a time, for `argparse`."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not 0 <= number < math.inf:
        raise argparse.ArgumentTypeError(f"{text}: allowed are numbers of minutes from 0")
    return number


def command_line(module: str, text: str | None, known: Iterable[str] = (), quick: bool = False) -> argparse.Namespace:
    """Return ``names``, all of them known, and ``quick`` of a module that takes no more; else exit with 2."""
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks.{module}", description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = list(known)
    if known:
        parser.add_argument("names", nargs="*", metavar="NAME", help=f"any of {', '.join(known)} (default all)")
    if quick:
        parser.add_argument("--quick", action="store_true", help="a small version, written nowhere")
    given = parser.parse_args()
    if unknown := sorted(set(given.names if known else ()) - set(known)):
        parser.error(f"unknown {', '.join(unknown)}: choose from {', '.join(known)}")
    return given
