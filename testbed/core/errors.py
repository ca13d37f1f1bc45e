"""Errors that the user can correct, among them libraries that are not installed."""

from __future__ import annotations

import errno
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn, SupportsIndex

# Control and format characters, surrogates, line and paragraph separators: quoted from a file, they
# could move the cursor of a terminal or reverse the text.
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


class Portable(Exception):
    """An exception that `copy` and `pickle` copy, whatever its constructor takes.

    Those of Python call the constructor with the text, which fails in another process, or changes
    the text, where the constructor has other parameters.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what makes a copy: class, text, attributes, notes."""
        return _copy_exception, (type(self), self.args, dict(vars(self)))


def _copy_exception(
    kind: type[Exception], args: tuple[object, ...], attributes: Mapping[str, object]
) -> Exception:
    """Return an exception with these attributes, without a call of its constructor."""
    error: Exception = kind.__new__(kind, *args)
    error.args = args
    vars(error).update(attributes)
    return error


class InputError(Portable, ValueError):
    """Invalid input; the text has the place, the reason, and what to write instead.

    The command line prints it without a traceback and exits with 2.
    """

    def __str__(self) -> str:
        """Return the text with invisible characters escaped."""
        return escape_controls(super().__str__())


def escape_controls(text: str) -> str:
    """Escape the invisible characters of a text, except line ends."""
    return text if text.isprintable() else "".join(map(_visible, text))


def _visible(character: str) -> str:
    hidden = character != "\n" and unicodedata.category(character) in _HIDDEN
    return repr(character)[1:-1] if hidden else character


class FlightError(InputError):
    """An error in flight, after the scenario was accepted, such as one of a user's law."""


class ExternalProgramLost(FlightError):
    """An external program that the run needs is not reachable, or has ended."""


DISTRIBUTION = "formation-testbed"  # the name that pip installs, as in pyproject.toml


class NotCopiedError(InputError, TypeError):
    """An object that `copy` or `pickle` cannot copy; the text has what to do instead."""


class NotCopied:
    """Base of classes whose objects cannot be copied: copies and pickles are refused.

    Copies would share memory of which compiled code has the addresses, or have the addresses of
    another process.
    """

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse copies and pickles.

        Raises:
            NotCopiedError: always.
        """
        raise NotCopiedError(self._why_not_copied())

    def _why_not_copied(self) -> str:
        """Return what cannot be copied, and what to do instead."""
        raise NotImplementedError


class MissingExtraError(InputError, ImportError):
    """A library of an extra is not installed; the text names the command."""


def install_command(extra: str) -> str:
    """Return the command that installs an extra."""
    return f'pip install "{DISTRIBUTION}[{extra}]"'


@contextmanager
def needs_extra(extra: str, purpose: str) -> Iterator[None]:
    """Import libraries of an extra in the block.

    Args:
        extra: of pyproject.toml.
        purpose: what needs the library, as the message begins.

    Raises:
        MissingExtraError: a library is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        raise MissingExtraError(
            f"{purpose}: {package} is not installed; write {install_command(extra)}"
        ) from None


@contextmanager
def needs_jsbsim() -> Iterator[None]:
    """Import JSBSim in the block.

    Raises:
        MissingExtraError: it is not installed, as on Linux with an ARM processor, for which there
            is no wheel.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            "JSBSim is not installed, and this command flies or measures aircraft with it: pip "
            "has it for computers other than those with Linux on ARM (run the command on such a "
            "one; testbed companion needs no JSBSim)"
        ) from error


# as the loader of libraries, other libraries and threading say it
_NO_MEMORY = ("failed to map segment", "cannot allocate memory", "can't start new thread")


def raise_memory_shortage(error: BaseException) -> None:
    """Raise an error on, where it is one of lack of memory and not of what the caller handles.

    Raises:
        MemoryError: that error, or one with its description.
    """
    if isinstance(error, MemoryError):
        raise error
    if memory_shortage(error):
        raise MemoryError(str(error)) from error


def describe_error(error: BaseException) -> str:
    """Return the text of an error; of one that has none its type. Never empty."""
    return str(error) or type(error).__name__


def memory_shortage(error: BaseException) -> str | None:
    """Describe the lack of memory that caused an error, with the remedy; None: another cause."""
    cause: BaseException | None = error
    while cause is not None:
        text = str(cause)
        if (
            isinstance(cause, MemoryError)
            or (isinstance(cause, OSError) and cause.errno == errno.ENOMEM)
            or any(words in text.lower() for words in _NO_MEMORY)
        ):
            return (
                f"not enough memory: {text or 'an allocation failed'} (end other programs, or "
                "raise the limits, ulimit -v and -u)"
            )
        cause = cause.__cause__ or cause.__context__
    return None
