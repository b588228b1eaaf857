"""Kernels: scalar loops over joints, written as the equation of one joint, compiled before a robot moves.

What runs in every tick, or in every step of physics, is a function with the decorator :func:`kernel`. Its annotations
are its signature, and it is never compiled for other types. A class that uses a kernel loads it in its constructor, and
calls what :meth:`Kernel.load` returned: so nothing is compiled inside a tick. Compiling takes up to a second for each
kernel. The result is kept in a folder of the user, by processor and by the text of the kernel.
"""

from __future__ import annotations

import hashlib
import logging
import os
import stat
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    ParamSpec,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config.arrays import BoolArray, FloatArray, IntArray, ShortArray, StateArray
from pepper_driver.config.errors import reason

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")

CACHE_VARIABLE = "PEPPER_DRIVER_CACHE"
"""Environment variable: folder of the compiled kernels, in place of the one in the user's cache."""

CHECK_VARIABLE = "PEPPER_DRIVER_CHECK_KERNELS"
"""Environment variable: where it is set, as in the tests, all kernels look at their arguments."""

_MATRIX, _BLOCK, _STRIDED, _OUT = "two axes", "three axes", "gaps", "written to"

Matrix = Annotated[T, _MATRIX]
"""``Matrix[FloatArray]``: an array with two axes."""

Block = Annotated[T, _BLOCK]
"""``Block[FloatArray]``: an array with three axes."""

Strided = Annotated[T, _STRIDED]
"""``Strided[FloatArray]``: an array that may have gaps, such as a column of a matrix."""

Out = Annotated[T, _OUT]
"""``Out[FloatArray]``: an array that the kernel writes to. It cannot write to others, which may be read-only."""

_ARRAYS: dict[object, str] = {
    FloatArray: "float64",
    BoolArray: "boolean",
    IntArray: "int64",
    ShortArray: "int32",
    StateArray: "int8",
}
_SCALARS: dict[object, str] = {float: "float64", int: "int64", bool: "boolean"}

logger = logging.getLogger("pepper_driver")


class Records(Generic[T]):
    """Array with a record of type ``T`` for each joint: in a kernel ``board = boards[j]``, then ``board.kp``.

    Outside of kernels ``boards["kp"]`` is a view of one value of all joints. At run time this is a NumPy array, made by
    :func:`make_records`.
    """

    if TYPE_CHECKING:
        shape: tuple[int]

        @overload
        def __getitem__(self, key: int) -> T: ...
        @overload
        def __getitem__(self, key: str) -> NDArray[Any]: ...
        def __getitem__(self, key: int | str) -> T | NDArray[Any]: ...
        def __setitem__(self, key: int | str, value: object) -> None: ...
        def __len__(self) -> int: ...
        def copy(self) -> Records[T]:
            """Return a copy."""


@cache
def record_type(of: type[Any]) -> np.dtype[np.void]:
    """Return the type of an array whose records have the annotated values of a class: float, int or bool."""
    kinds = {float: np.float64, int: np.int64, bool: np.bool_}
    hints = {name: kind for name, kind in get_type_hints(of).items() if not _is_of_class(kind)}
    return np.dtype([(name, kinds[kind]) for name, kind in hints.items()], align=True)


def _is_of_class(kind: object) -> bool:
    """Return True for an annotation of a class variable, which records do not have."""
    return get_origin(kind) is ClassVar


def make_records(of: type[T], count: int, /, **values: object) -> Records[T]:
    """Return ``count`` records of a class, zero but for ``values``: by name, one number or (count,) numbers."""
    records = np.zeros(count, record_type(cast(Any, of)))
    for name, value in values.items():
        records[name] = value
    return cast(Records[T], records)


class Kernel(Generic[P, R]):
    """Function to be compiled, made by :func:`kernel`."""

    def __init__(self, function: Callable[P, R]) -> None:
        assert isinstance(function, FunctionType)
        self._function = function
        self._compiled: Callable[P, R] | None = None
        self.__doc__, self.__name__ = function.__doc__, function.__name__

    @property
    def name(self) -> str:
        """Module and name."""
        return f"{self._function.__module__}.{self.__name__}"

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Call the compiled function; inside of another kernel it becomes part of that one."""
        return self.load()(*args, **kwargs)

    def load(self) -> Callable[P, R]:
        """Return the compiled function, which takes positional arguments.

        Raises:
            TypeError: From the function: a value of another type than annotated, or an array with gaps.
        """
        with _COMPILING:
            if self._compiled is None:
                self._compiled = self._compile()
        return self._compiled

    def load_unchecked(self) -> Callable[P, R]:
        """Return the compiled function that does not look at its arguments, which takes 0.05 to 0.15 us for each array.

        For arrays that a checked kernel has seen before, or that the class of the caller has made: one of another type
        or with gaps would be misread, and is a TypeError only where CHECK_VARIABLE is set.
        """
        compiled = self.load()
        if os.environ.get(CHECK_VARIABLE):
            return compiled
        [only] = cast(Any, compiled).overloads.values()
        return cast(Callable[P, R], only.entry_point)

    def key(self) -> str:
        """Return a hash of all that the compiled code follows from: texts, constants, types, checks of bounds."""
        parts = [_text(self._function.__code__.co_filename), f"{_settings().BOUNDSCHECK=}"]
        for name, value in self._globals().items():
            if isinstance(value, Kernel):
                parts.append(value.key())
            elif isinstance(value, np.ndarray | np.generic):
                parts.append(
                    f"{name}={value.tolist()!r}"
                )  # whole: repr leaves out what is in the middle
            elif isinstance(value, int | float | tuple):
                parts.append(f"{name}={value!r}")
        parts += [str(kind) for kind in self._signature()]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]

    def _globals(self) -> dict[str, Any]:
        scope = self._function.__globals__
        return {name: scope[name] for name in self._function.__code__.co_names if name in scope}

    def _signature(self) -> tuple[Any, ...]:
        hints = get_type_hints(self._function, include_extras=True)
        hints.pop("return")
        return tuple(_numba_type(self.name, hint) for hint in hints.values())

    def _linked(self) -> Callable[P, R]:
        """Return the function with the compiled kernels that it calls, which become part of it."""
        function = self._function
        scope = {k: v.load() if isinstance(v, Kernel) else v for k, v in self._globals().items()}
        linked = FunctionType(
            function.__code__, {**function.__globals__, **scope}, function.__name__
        )
        linked.__module__, linked.__qualname__ = function.__module__, function.__qualname__
        return cast(Callable[P, R], linked)

    def _compile(self) -> Callable[P, R]:
        signature, folder = self._signature(), cache_folder()
        if folder is None:
            _announce()
            return _jit(self._linked(), signature, keep=False)
        own = folder / f"{self.name}-{self.key()}"
        settings = _settings()
        before, settings.CACHE_DIR = settings.CACHE_DIR, str(own)
        try:
            compiled = None
            if own.is_dir():
                with suppress(Exception):  # code from the cache needs no other kernels
                    compiled = _jit(cast(Callable[P, R], self._function), signature, keep=True)
            compiled = compiled or _jit(self._linked(), signature, keep=True)
        except Exception as error:
            # A full disk, a file that was cut short: the kernel is needed all the same.
            compiled = _jit(self._linked(), signature, keep=False)
            logger.warning(
                "%s: a kernel in it cannot be kept or read (%s); remove it", own, reason(error)
            )
        finally:
            settings.CACHE_DIR = before
        if not cast(Any, compiled).stats.cache_hits:
            _announce()
        return compiled


_COMPILING = threading.RLock()


def _settings() -> Any:  # noqa: ANN401 numba sets these attributes from the environment
    from numba.core import config

    return config


def _jit(function: Callable[P, R], signature: tuple[Any, ...], *, keep: bool) -> Callable[P, R]:
    """Compile a function, or read it from the cache; numba never compiles it for other types."""
    import numba

    # As in NumPy 1 / 0 is infinite.
    compile = cast(Any, numba.njit(signature, cache=keep, error_model="numpy"))
    return cast(Callable[P, R], compile(function))


def kernel(function: Callable[P, R]) -> Kernel[P, R]:
    """Make a kernel of a function that changes arrays in place, or returns a number.

    Its annotations are its signature: ``float``, ``int``, ``bool``; ``FloatArray``, ``BoolArray``, ``IntArray``,
    ``ShortArray``, ``StateArray`` and ``Records[...]``, with ``Matrix[...]``, ``Block[...]``, ``Strided[...]`` and
    ``Out[...]`` around them; or the class of a record. It may call other kernels and functions of NumPy and ``math``,
    and use constants of its module. A value that is not finite goes through its arithmetic as in NumPy; it must not
    become an index.
    """
    return Kernel(function)


def _numba_type(name: str, hint: Any) -> Any:  # noqa: ANN401 an annotation can be anything
    """Return numba's type of an argument; raises TypeError for an annotation that no kernel takes."""
    import numba

    if hint in _SCALARS:
        return getattr(numba.types, _SCALARS[hint])
    marks: tuple[object, ...] = ()
    if get_origin(hint) is Annotated:
        hint, *rest = get_args(hint)
        marks = tuple(rest)
    if get_origin(hint) is Records:
        element = numba.from_dtype(record_type(get_args(hint)[0]))
    elif hint in _ARRAYS:
        element = getattr(numba.types, _ARRAYS[hint])
    elif getattr(hint, "__annotations__", None):
        return numba.from_dtype(record_type(hint))
    else:
        raise TypeError(f"kernel {name}: an argument cannot be {hint}")
    axes = 3 if _BLOCK in marks else 2 if _MATRIX in marks else 1
    layout = "A" if _STRIDED in marks else "C"
    return cast(Any, numba.types.Array)(element, axes, layout, readonly=_OUT not in marks)


@cache
def _text(file: str) -> str:
    return Path(file).read_text(encoding="utf-8")


@cache
def _announce() -> None:
    """Say once in a process that it takes a moment."""
    print(
        "pepper_driver compiles its kernels for this processor: once, about half a minute",
        file=sys.stderr,
        flush=True,
    )


@cache
def cache_folder() -> Path | None:
    """Return the folder of compiled kernels, which only this user can write to; None where there is none.

    Compiled code is read from it and run: a folder in which others could put theirs is not used.
    """
    from platformdirs import user_cache_path

    given = os.environ.get(CACHE_VARIABLE)
    folder = Path(given).absolute() if given else user_cache_path("pepper_driver") / "kernels"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        problem = _problem(folder)
    except OSError as error:
        problem = reason(error)
    if not problem:
        return folder
    logger.warning(
        "%s: compiled kernels are not kept, so each start takes half a minute longer (%s); "
        "name a folder of yours in %s",
        folder,
        problem,
        CACHE_VARIABLE,
    )
    return None


def _problem(folder: Path) -> str:
    """Return why compiled code must not be read from, or cannot be written to a folder; empty if it can."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return "it cannot be written"
    if sys.platform == "win32":  # a user's folders have access lists of their own
        return ""
    for place in (folder, *folder.resolve().parents):
        status = place.stat()
        if status.st_uid not in (os.getuid(), 0):
            return f"{place} belongs to another user"
        # Where the sticky bit is set, as in /tmp, others cannot replace what is not theirs.
        if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and (
            place == folder or not status.st_mode & stat.S_ISVTX
        ):
            return f"{place} can be written by others"
    return ""
