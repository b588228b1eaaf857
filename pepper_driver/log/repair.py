"""A readable log from a damaged one."""

from __future__ import annotations

from pathlib import Path

from pepper_driver.backends.log_file import RawLog, decode_log, read_bytes
from pepper_driver.backends.log_records import find_chunks, messages_in
from pepper_driver.config.file_lock import lock_file
from pepper_driver.config.files import OutputError, make_folder, replacing
from pepper_driver.log.reader import usual_layout
from pepper_driver.log.writer import McapFile


def repair_log(path: Path, out: Path, *, force: bool = False) -> RawLog:
    """Write all that is intact of a log as a log that every program reads: with index, end, and no damaged bytes.

    Its messages are the same, bit for bit. What is missing stays known: ``read_log`` says it of the new log too.

    Args:
        path: The log.
        out: The new log; its folder is made.
        force: Replace a file that is there.

    Returns:
        The contents of the log.

    Raises:
        LogError: The log is missing, no log of this package, or nothing of it is intact.
        OutputError: ``out`` cannot be written, is there already, or is the log itself.
    """
    data = read_bytes(path)
    file = decode_log(path, data, usual_layout())
    if out.exists():
        if out.samefile(path):
            raise OutputError(f"{out}: is the log itself; name another file")
        if not force:
            raise OutputError(f"{out}: is there already; --force replaces it")
    make_folder(out.parent)
    metadata = {**file.metadata, "repaired": file.missing} if file.missing else file.metadata
    with lock_file(out), replacing(out) as partial:
        repaired = McapFile(partial, file.layout, metadata)
        try:
            for contents in find_chunks(data):
                for message in messages_in(contents or b""):
                    repaired.copy(message)
            repaired.finish(complete=file.complete)
        finally:
            repaired.abandon()
    return file
