"""A recording as a file: NumPy's zipped arrays, without pickle, so that reading one can never run code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pepper_driver.config import PepperError
from pepper_driver.config.errors import reason
from pepper_driver.config.files import replacing

FORMAT = 1

_FORMAT_NAME = "recording_format"
_CURE = "record the run again"
_LONGEST_REASON = 300


class RecordingError(PepperError, ValueError):
    """A recording is too short, of the wrong shape, not finite, of another robot, or its file is damaged."""


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays; at no time is there half a file at ``path``.

    Raises:
        OutputError: The place cannot be written to.
    """
    with replacing(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **{_FORMAT_NAME: np.array(FORMAT)}, **arrays)


def read_arrays(path: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Read the arrays ``names``; a file without one of them, or with others, is refused.

    Raises:
        RecordingError: In one line: file, reason, cure.
    """
    expected = {_FORMAT_NAME, *names}
    try:
        with path.open("rb") as stream:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise RecordingError("a single array")
            found = set(file.files)
            if _FORMAT_NAME not in found:
                raise RecordingError("arrays of something else")
            version = file[_FORMAT_NAME]
            if version.shape != () or version != FORMAT:
                raise RecordingError(
                    f"of format {str(version)[:20]}, not the format {FORMAT} of this version"
                )
            if missing := sorted(expected - found):
                raise RecordingError(f"without {', '.join(missing)}")
            if extra := sorted(found - expected):
                raise RecordingError(f"with unknown {', '.join(extra)}")
            return {name: file[name] for name in names}
    except RecordingError as error:
        raise RecordingError(f"{path}: is no recording, it is {error}; {_CURE}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({reason(error)}); {_CURE}") from error
    except Exception as error:  # whatever the decoders make of damaged bytes
        text = " ".join(reason(error).split())[:_LONGEST_REASON]
        raise RecordingError(f"{path}: damaged: {text}; {_CURE}") from error
