"""The command line: the commands put together, what they yield printed, and exit codes out.

A command is a function of `twin.commands`.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import inspect
import io
import json
import os
import re
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import wraps
from types import FrameType
from typing import Annotated, Any, NoReturn, get_type_hints

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter, UnusedCliTokensError

from twin import commands
from twin.blas_threads import THREADS, set_environment
from twin.errors import InputError, RecipeError, TwinError
from twin.files import plain

app = App(
    name="twin",
    version=lambda: importlib.metadata.version("tactile-twin"),
    help="Physics-based digital twin of camera-based tactile sensors.",
    help_epilogue="Example: twin run kamiyama_pillar -s press.force_n='{z=5}' --out out/five\n\n"
    "Every command takes --threads N (or TWIN_THREADS): the threads of numeric libraries.\n\n"
    "Exit codes: 0 done; 1 failed, or the disk is full; 2 the input must be mended; 3 done, but "
    "some parts failed; 4 this machine lacks something; 130 interrupted.",
    help_format="plaintext",
    suppress_keyboard_interrupt=False,
    result_action="return_none",
    default_parameter=Parameter(negative="", negative_iterable=""),
)


def _add(command: Callable[..., Iterator[Any]]) -> None:
    """Add a command; its docstring holds the help of it and of its parameters. It prints the lines
    that it yields as they come; with ``--json`` all of its output is one object at the end."""

    @wraps(command)
    def printing(*arguments: Any, json_: bool = False, **options: Any) -> None:
        scene = options.get("scene") or (arguments[0] if arguments else None)
        with contextlib.closing(_named(command(*arguments, **options), scene)) as output:
            if json_:
                _print_json(command.__name__, output)
                return
            for piece in output:
                if line := piece if isinstance(piece, str) else piece[0]:
                    print(line)

    keyword = inspect.Parameter(
        "json_", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=_Json
    )
    text, _, examples = (inspect.getdoc(command) or "").partition("\n\nExamples:\n")
    about, _, section = text.partition("\n\nParameters\n----------\n")
    kinds = get_type_hints(command, include_extras=True)
    for entry in filter(None, re.split(r"\n(?=\S)", section)):
        name, *words = entry.split()
        kinds[name] = Annotated[kinds[name], Parameter(help=" ".join(words))]
    given = inspect.signature(command).parameters.values()
    described = [each.replace(annotation=kinds[each.name]) for each in given]
    printing.__signature__ = inspect.Signature([*described, keyword])  # type: ignore[attr-defined]
    printing.__annotations__ = {**kinds, "json_": _Json, "return": None}
    app.command(
        printing,
        help=re.sub(r"(?<!\n)\n(?!\n)", " ", about),
        help_epilogue=f"Examples:\n{examples}" if examples else "",
    )


def _named(output: Iterator[Any], scene: str | None) -> Generator[Any]:
    """Yield what a command yields; begin the messages of recipe errors, which know "this scene"
    only, with its name."""
    try:
        yield from output
    except RecipeError as problem:
        if problem.where is not None:
            raise
        raise RecipeError(problem.problems, scene) from None


_Json = Annotated[
    bool,
    Parameter(
        name="--json",
        help="Print one JSON object instead: command, ok, lines, rows (the records), notes, "
        "problems.",
    ),
]


class _Notes(io.StringIO):
    """Keeps what is written to standard error, which shows it too."""

    def __init__(self) -> None:
        super().__init__()
        self._shown = sys.stderr

    def write(self, text: str) -> int:
        self._shown.write(text)
        return super().write(text)


def _print_json(name: str, output: Iterator[Any]) -> None:
    """Print what a command yields as one JSON object."""
    notes = _Notes()
    lines: list[str] = []
    rows: list[Any] = []
    failure: TwinError | None = None
    try:
        with contextlib.redirect_stdout(notes), contextlib.redirect_stderr(notes):
            for piece in output:
                line, *records = [piece] if isinstance(piece, str) else piece
                lines += line.splitlines()
                rows += records
    except TwinError as problem:
        failure = problem
    printed = {
        "command": name,
        "ok": failure is None,
        "lines": lines,
        "rows": plain(rows),
        "notes": notes.getvalue().splitlines(),
        "problems": str(failure).splitlines() if failure else [],
    }
    print(json.dumps(printed, indent=1, ensure_ascii=False))
    if failure:
        raise failure


for _command in (
    commands.run,
    commands.explain,
    commands.mesh,
    commands.reproduce,
    commands.calibrate,
    commands.view,
    commands.dataset,
    commands.export,
    commands.reconstruct,
    commands.sweep,
    commands.scenes,
    commands.check,
    commands.doctor,
):
    _add(_command)


NARROWEST = 20
"""Columns below which help can't be laid out: the library that does it fails, or never ends."""


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line on stderr, without the place in the source."""
    print(f"twin: warning: {message}", file=sys.stderr)


def _usage_error(problem: CycloptsError) -> str:
    """Return a usage error in the user's terms where the library's message is about its own."""
    if isinstance(problem, UnusedCliTokensError):
        tokens = " ".join(map(repr, problem.unused_tokens or ()))
        return f"what is {tokens}? The command takes no more arguments"
    if isinstance(problem, MissingArgumentError) and problem.argument and problem.command_chain:
        wanted, command = problem.argument, app[problem.command_chain[0]]
        known = command.assemble_argument_collection(parse_docstring=True)
        about = next(one.parameter.help for one in known if one.name == wanted.name)
        if problem.keyword is not None:
            count = wanted.token_count()[0]
            values = "a value" if count < 2 else f"{count} values"
            return f"{problem.keyword} needs {values}: {about}"
        name = wanted.name if wanted.index is None else wanted.name.lstrip("-").upper()
        return f"{name} is missing: {about}"
    return str(problem)


def _without_threads(arguments: Sequence[str]) -> list[str]:
    """Return the arguments without ``--threads N``, which sets ``TWIN_THREADS``."""
    left: list[str] = []
    given = iter(arguments)
    for each in given:
        name, equals, value = each.partition("=")
        if name != "--threads":
            left.append(each)
            continue
        os.environ[THREADS] = value if equals else next(given, "")
        if not os.environ[THREADS]:
            raise InputError("--threads needs a value: the threads of numeric libraries")
    return left


def _interrupted() -> int:
    print("twin: interrupted; files written so far are whole", file=sys.stderr)
    return 130


def _folder_exists() -> bool:
    """Return whether the current folder still exists."""
    try:
        os.getcwd()
    except FileNotFoundError:
        return False
    return True


def _listen() -> list[int]:
    """Return a list that holds the signal after Ctrl-C."""
    heard: list[int] = []

    def interrupt(number: int, _: FrameType | None) -> None:
        heard.append(number)
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, interrupt)
    return heard


def _drop_output() -> None:
    """Discard what standard output still holds: flushing it at exit would fail again."""
    with contextlib.suppress(AttributeError, OSError):  # closed, or not a file at all
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with the code that `twin.errors` lists."""
    heard = _listen()
    for stream in (sys.stdout, sys.stderr):  # a letter that the terminal lacks becomes its number
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns) < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    try:
        given = _without_threads(sys.argv[1:] if arguments is None else arguments)
        set_environment()
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            app(given, exit_on_error=False, print_error=False)
        if sys.stdout is not None:  # it is None where the shell closed it
            sys.stdout.flush()
        code = 0
    except CycloptsError as problem:
        command = " ".join(["twin", *(problem.command_chain or ()), "--help"])
        print(f"twin: {_usage_error(problem)}\nSee: {command}", file=sys.stderr)
        code = 2
    except TwinError as problem:
        print(f"twin: {problem}", file=sys.stderr)
        code = problem.exit_code
    except KeyboardInterrupt:
        code = _interrupted()
    except BrokenPipeError:
        _drop_output()
        code = 1
    except Exception as problem:  # never a traceback for users, always one for developers
        if os.environ.get("TWIN_DEBUG"):
            raise
        code = _unexpected(problem, bool(heard))
    sys.exit(code)


def _unexpected(problem: Exception, heard: bool) -> int:
    """Print what is known of an exception that is none of this program's; return the exit code."""
    if heard:  # a library that was interrupted while it loaded raises something else
        return _interrupted()
    if not _folder_exists():
        print(
            "twin: the folder that it was started in is gone: change to one that is there",
            file=sys.stderr,
        )
        return 2
    if isinstance(problem, OSError) and problem.errno:
        where = f"standard output, or a file in --out or {tempfile.gettempdir()}"
        unwritable = TwinError.unwritable(problem.filename or where, problem)
        if unwritable.exit_code == 1:  # of standard output, a temporary file, or a library's own
            _drop_output()
            print(f"twin: {unwritable}", file=sys.stderr)
            return 1
    print(f"twin: internal error: {type(problem).__name__}: {problem}", file=sys.stderr)
    print("Set TWIN_DEBUG=1 to see where, and please report it.", file=sys.stderr)
    return 1
