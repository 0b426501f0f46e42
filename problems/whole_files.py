"""Files that are put in place whole: no reader, kill or full disk leaves a part of one."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def put(path: Path, content: bytes | str) -> None:
    """Write a file, text as UTF-8; what was there stays until all is written.

    Raises
    ------
    OSError
        If the disk is full, or the folder cannot be written.
    """
    new = path.with_name(f".{path.name}.{os.getpid()}")  # two processes may write at a time
    try:
        new.write_bytes(content.encode() if isinstance(content, str) else content)
        new.replace(path)
    except BaseException:
        with suppress(OSError):
            new.unlink()
        raise
