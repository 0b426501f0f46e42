"""Files that are put in place whole: no reader, kill or full disk leaves a part of one.

What is kept for later runs (`cached`, `keep`, `kept`) ends with a digest of its content, which is
checked before anything is believed. The digest stands at the end, so that the system loads a shared
library in this form.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

_DIGEST = hashlib.sha256().digest_size


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


def cached(path: Path | None, make: Callable[[], bytes]) -> bytes:
    """Return what a file keeps, else make it and keep it, if the folder can be written."""
    if path is None:
        return make()
    if (content := kept(path)) is None:
        content = make()
        with suppress(OSError):  # a full disk
            keep(path, content)
    return content


def keep(path: Path, content: bytes) -> None:
    """Write a file that `kept` reads; its folder is made.

    Raises
    ------
    OSError
        If the disk is full, or the folder cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    put(path, content + hashlib.sha256(content).digest())


def kept(path: Path) -> bytes | None:
    """Read what `keep` wrote; None if there is no such file, or its content has changed."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    content, digest = content[:-_DIGEST], content[-_DIGEST:]
    return content if hashlib.sha256(content).digest() == digest else None
