"""Errors and warnings that name the file they are about."""

import copy
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SHOWN = 3  # files that a message names


@contextmanager
def about(path: Path) -> Iterator[None]:
    """Put the name of the file before the message of every error and warning raised inside.

    Raises
    ------
    ValueError
        In place of every error but those of the operating system, which name the file themselves.
    """
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            yield
        except OSError:
            raise
        except Exception as error:
            if not isinstance(error, ValueError):
                error = ValueError(f"cannot be used: unexpected {type(error).__name__}: {error}").with_traceback(
                    error.__traceback__
                )
            text = " ".join(str(error).split())
            raise ValueError(text if str(path) in text else f"{path}: {text}") from error
    for warning in heard:
        text, said = str(warning.message), copy.copy(warning.message)
        if issubclass(warning.category, UserWarning) and str(path) not in text:
            text = f"{path}: {text}"
        if isinstance(said, Warning):
            said.args = (text,)
        warnings.warn(said, warning.category, stacklevel=4)


@contextmanager
def naming(*paths: Path) -> Iterator[None]:
    """Put the names of files before the message of a ``ValueError`` of what was read from them, if it names none.

    Raises
    ------
    ValueError
        In place of every one raised inside.
    """
    try:
        yield
    except ValueError as error:
        text = str(error)
        if any(str(path) in text for path in paths):
            raise
        shown = ", ".join(map(str, paths[:SHOWN])) + (", ..." if len(paths) > SHOWN else "")
        raise ValueError(f"{shown}: {text}") from error
