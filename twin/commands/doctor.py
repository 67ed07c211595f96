"""`twin doctor`: what this machine has."""

from __future__ import annotations


def doctor() -> None:
    """Say what is installed, which Mitsuba variant and solver are used, and where the caches are.

    Exit code 4 if the main job can't run on this machine.
    """
    from twin.study.doctor import examine

    report = examine()
    print("\n".join(report.lines))
    if report.missing:
        from twin.errors import MissingCapability

        raise MissingCapability("the main job can't run: " + "; ".join(report.missing))
