"""``python -m twin`` is ``twin``."""

import os
import signal


def _interrupted(*_: object) -> None:
    os.write(2, b"twin: interrupted; files written so far are whole\n")
    os._exit(130)


def start() -> None:
    """Run the command line; Ctrl-C while its libraries load ends it without a traceback."""
    signal.signal(signal.SIGINT, _interrupted)
    from twin.cli import main

    main()


if __name__ == "__main__":
    start()
