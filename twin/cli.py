"""The command line: the commands put together, and exit codes out; every decision lives elsewhere.

A command is a function in a file of `twin.commands`. Heavy packages are imported inside these functions, so that
``twin --help`` answers at once.
"""

from __future__ import annotations

import errno
import importlib.metadata
import inspect
import io
import os
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, NoReturn

from cyclopts import App, CycloptsError, MissingArgumentError, UnusedCliTokensError

from twin.commands.calibrate import calibrate
from twin.commands.check import check
from twin.commands.dataset import dataset
from twin.commands.doctor import doctor
from twin.commands.export import export
from twin.commands.mesh import mesh
from twin.commands.reconstruct import reconstruct
from twin.commands.reproduce import reproduce
from twin.commands.run import run
from twin.commands.scenes import scenes
from twin.commands.sweep import sweep
from twin.commands.view import view
from twin.errors import TwinError

app = App(
    name="twin",
    version=lambda: importlib.metadata.version("tactile-twin"),
    help="Physics-based digital twin of camera-based tactile sensors.",
    help_epilogue="Example: twin run kamiyama_pillar -s press.force_n='{z=5}' --out out/five",
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
    result_action="return_none",
)


def _told(command: Callable[..., None]) -> dict[str, str]:
    """Return a command's help from its docstring: paragraphs for a terminal to wrap, and examples, a line each."""
    text, _, examples = (inspect.getdoc(command) or "").partition("\n\nExamples:\n")
    paragraphs = [" ".join(paragraph.split("\n")) for paragraph in text.split("\n\n")]
    return {"help": "\n\n".join(paragraphs), "help_epilogue": f"Examples:\n{examples}" if examples else ""}


for _command in (
    run, mesh, reproduce, calibrate, view, dataset, export, reconstruct, sweep, scenes, check, doctor
):  # fmt: skip
    app.command(_command, **_told(_command))


FULL = {errno.ENOSPC, errno.EFBIG, errno.EROFS, getattr(errno, "EDQUOT", errno.ENOSPC)}
"""What a full or read-only disk says."""

NARROWEST = 20
"""Columns below which help can't be laid out: the library that does it fails, or never ends."""


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line on stderr, without the place in the source."""
    print(f"twin: warning: {message}", file=sys.stderr)


def _help_for(problem: CycloptsError) -> str:
    """Return the command whose help tells what is allowed."""
    return " ".join(["twin", *(problem.command_chain or ()), "--help"])


def _said(problem: CycloptsError) -> str:
    """Return what is wrong with the command line, in words of ours where the library's are of its inside."""
    if isinstance(problem, UnusedCliTokensError):
        return f"what is {' '.join(map(repr, problem.unused_tokens or ()))}? The command takes no more arguments"
    if isinstance(problem, MissingArgumentError) and problem.argument is not None:
        wanted = problem.argument
        if problem.keyword is not None:
            return f"{problem.keyword} needs a value: {wanted.parameter.help}"
        name = wanted.name if wanted.index is None else wanted.name.lstrip("-").upper()
        return f"{name} is missing: {wanted.parameter.help}"
    return str(problem)


def _interrupted() -> int:
    print("twin: interrupted; files written so far are whole", file=sys.stderr)
    return 130


def _is_somewhere() -> bool:
    """Return whether the current folder is still there."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _listen() -> list[int]:
    """Return a list that holds the signal once Ctrl-C was pressed; the interrupt itself goes its usual way."""
    heard: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        heard.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, interrupt)
    return heard


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with the code that `twin.errors` lists."""
    heard = _listen()
    for stream in (sys.stdout, sys.stderr):  # a terminal that lacks a letter is shown its number
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns) < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            app(list(arguments) if arguments is not None else None, exit_on_error=False, print_error=False)
        if sys.stdout is not None:  # it is None where the shell closed it
            sys.stdout.flush()
        code = 0
    except CycloptsError as problem:
        print(f"twin: {_said(problem)}\nSee: {_help_for(problem)}", file=sys.stderr)
        code = 2
    except TwinError as problem:
        print(f"twin: {problem}", file=sys.stderr)
        code = problem.exit_code
    except KeyboardInterrupt:
        code = _interrupted()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except Exception as problem:  # the promise: never a traceback for users, always one for developers
        if os.environ.get("TWIN_DEBUG"):
            raise
        if heard:  # a library that was interrupted while it loaded says something else
            sys.exit(_interrupted())
        if not _is_somewhere():
            print("twin: the folder that it was started in is gone: change to one that is there", file=sys.stderr)
            sys.exit(2)
        if isinstance(problem, OSError) and problem.errno in FULL:  # of a temporary file, or of a library's own
            where = problem.filename or f"standard output, or a file in {tempfile.gettempdir()}"
            print(f"twin: {where}: can't be written ({problem.strerror}); files written so far are whole. Make room or "
                  "name another folder (--out, TWIN_CACHE, TMPDIR), and run again.", file=sys.stderr)  # fmt: skip
        else:
            print(f"twin: internal error: {type(problem).__name__}: {problem}", file=sys.stderr)
            print("Set TWIN_DEBUG=1 to see where, and please report it.", file=sys.stderr)
        code = 1
    sys.exit(code)
