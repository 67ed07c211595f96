"""``python -m twin`` is ``twin``."""

import signal


def start() -> None:
    """Run the command line; Ctrl-C while its libraries load ends it without a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from twin.cli import main

    main()


if __name__ == "__main__":
    start()
