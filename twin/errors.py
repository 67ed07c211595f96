"""The errors this program raises, and the policy behind them, written once.

Every error message gives the problem, the value with its unit, the allowed range and a remedy. Each
class carries the exit code that the command line returns for it, so that no command decides its
own.

=====  ==========================================================
code   meaning
=====  ==========================================================
0      done
1      failed: the computation could not be finished, or the disk is full or read-only
2      the input can be mended: usage, recipe, a press without equilibrium, where to write
3      finished, but some samples failed
4      a capability that the job needs is missing on this machine
130    interrupted
=====  ==========================================================
"""

from __future__ import annotations

import contextlib
import errno
import functools
import sys
import warnings
from collections.abc import Iterable, Mapping

_FULL = {None, errno.ENOSPC, errno.EFBIG, errno.EROFS, getattr(errno, "EDQUOT", errno.ENOSPC)}
"""Error numbers of a full or read-only disk; numpy and HDF5 give none."""

_PASSING = {functools.__file__, contextlib.__file__}
"""Files between a caller and this program's functions: of lazy attributes and decorators."""


def did_you_mean(
    name: str,
    known: Iterable[str],
    otherwise: str,
    cutoff: float = 0.6,
    *,
    files: Mapping[str, str] | None = None,
) -> str:
    """Return the question after the nearest of the known names, or of the ``files`` by the name
    that is compared; ``otherwise`` where none is as near as ``cutoff``."""
    import difflib  # an error is rare, and the program starts without it

    asked = {**(files or {}), **{one: one for one in known}}
    spelt = {one.lower(): shown for one, shown in asked.items()}
    near = difflib.get_close_matches(name.lower(), list(spelt), 1, cutoff)
    return f"did you mean '{spelt[near[0]]}'?" if near else otherwise


class TwinError(Exception):
    """Anything that went wrong in a way this program understands (exit code 1).

    Examples
    --------
    >>> import twin
    >>> try:
    ...     twin.load_scene("gelpad_pres")
    ... except twin.TwinError as problem:
    ...     print(problem)
    no scene 'gelpad_pres': did you mean 'gelpad_press'?
    """

    exit_code = 1

    @staticmethod
    def unwritable(path: object, problem: OSError) -> TwinError:
        """Return the error of a file that can't be written: exit code 1 where the disk is full or
        read-only, 2 where its name or folder is wrong."""
        why = problem.strerror or problem  # numpy gives the number of bytes only
        kind = TwinError if problem.errno in _FULL else InputError
        return kind(
            f"{path}: can't be written ({why}); files written so far are whole. Make room or name "
            "another folder (--out, TWIN_CACHE, TMPDIR), and run again."
        )

    @staticmethod
    def unreadable(path: object, problem: OSError, remedy: str = "") -> InputError:
        """Return the error of a file that can't be read."""
        return InputError(f"{path}: can't be read ({problem.strerror}){remedy}")


class RecipeError(TwinError):
    """A recipe (scene, body, press) is wrong: all of its problems at once (exit code 2).

    Parameters
    ----------
    problems
        One line each: key, value with unit, allowed range, remedy.
    where
        The file, or the object, in which they were found.
    """

    exit_code = 2

    def __init__(self, problems: str | Iterable[str], where: str | None = None) -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        self.where = where
        prefix = f"{where}: " if where else ""
        super().__init__("\n".join(prefix + problem for problem in self.problems))


class InputError(TwinError):
    """A file or an argument given by the user can't be used (exit code 2)."""

    exit_code = 2


def require(value: object, kind: type | tuple[type, ...], what: str, remedy: str) -> None:
    """Raise an `InputError` unless an argument is of its kind; ``remedy`` is where to get
    one."""
    if not isinstance(value, kind):
        kinds = " or ".join(
            f"a {one.__name__}" for one in (kind if isinstance(kind, tuple) else (kind,))
        )
        raise InputError(
            f"{what} must be {kinds}, not {type(value).__name__!s} {value!r:.60}: {remedy}"
        )


class MeshError(TwinError):
    """A mesh could not be made, or does not pass the quality gates."""


class SolveError(TwinError):
    """A linear system could not be solved to the requested residual."""


class ContactError(TwinError):
    """A press has no equilibrium (exit code 2), or its contact did not converge.

    ``last_state`` is the `ContactState` before the step that was refused; None at the first step.
    """

    exit_code = 2
    last_state: object = None


class SomeFailed(TwinError):
    """A job of many parts is finished, but some of them failed; what could be done is written."""

    exit_code = 3


class NotSettled(ContactError):
    """A contact's iteration did not converge: nothing is known to be wrong with what was asked."""

    exit_code = 1


class MissingCapability(TwinError):
    """This machine lacks something the job needs (exit code 4); the message ends with how to
    install it."""

    exit_code = 4


class AccuracyWarning(UserWarning):
    """A result is less accurate than the scene requests; the message has both and a remedy.

    Examples
    --------
    Stop where a result is less accurate than the scene requests:

    >>> import warnings
    >>> import twin
    >>> warnings.simplefilter("error", twin.AccuracyWarning)
    """

    @classmethod
    def issue(cls, message: str) -> None:
        """Warn at the line outside this program that wanted the result."""
        frame, level = sys._getframe(1), 2
        while frame.f_back is not None and (
            frame.f_code.co_filename in _PASSING
            or frame.f_globals.get("__name__", "").startswith("twin.")
        ):
            frame, level = frame.f_back, level + 1
        warnings.warn(message, cls, stacklevel=level)
