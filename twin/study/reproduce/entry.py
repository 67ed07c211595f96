"""One table or figure: where it stands in the paper, how it is made again, and the function that does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from twin.study.reproduce.bench import Bench
from twin.study.reproduce.record import Outcome


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One table or figure.

    Attributes
    ----------
    name
        ``paper/table-1``.
    title
        What it shows.
    source
        Where in the paper.
    protocol
        What is done, in the paper's order, with what is assumed.
    run
        Does it.
    long
        Whether the quick form leaves it out unless it is asked for by name.
    """

    name: str
    title: str
    source: str
    protocol: str
    run: Callable[[Bench], Outcome]
    long: bool = False
