"""Names of files and folders on the command line, refused before any work is done for them."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import Any, Literal

import click

_KINDS = {
    stat.S_IFREG: "file",
    stat.S_IFDIR: "folder",
    stat.S_IFIFO: "named pipe",
    stat.S_IFSOCK: "socket",
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
}


class PathName(click.Path):
    """The path of a regular file or of a folder, which need not be there yet.

    Parameters
    ----------
    kind
        What there may be; "page" is a file or a folder that holds one. A new file needs a folder.
    """

    def __init__(self, kind: Literal["file", "folder", "page"]) -> None:
        super().__init__(path_type=Path)
        self.kind = kind

    def convert(self, value: Any, param: Any, ctx: Any) -> Path:
        """Return the path; another kind of thing in its place is refused, and is never opened."""
        text = os.fspath(value)
        if not text.strip():
            self.fail(f"the name of the {self.kind} is empty.", param, ctx)
        allowed = ("file", "folder") if self.kind == "page" else (self.kind,)
        path = Path(text)
        try:
            there = _KINDS.get(stat.S_IFMT(path.stat().st_mode), "thing")
        except FileNotFoundError:
            if self.kind == "file" and not path.parent.is_dir():
                self.fail(f"there is no folder {str(path.parent)!r}; make it first.", param, ctx)
            return path
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            self.fail(f"{text!r} names no {self.kind}: {reason}.", param, ctx)
        if there not in allowed:
            self.fail(f"{text!r} is a {there}; name a {self.kind}.", param, ctx)
        return path


class ClusterAddress(click.ParamType):
    """The address of a scheduler: host:port, perhaps with a protocol that crosses machines."""

    name = "address"

    def convert(self, value: Any, param: Any, ctx: Any) -> str:
        """Return the address as it came; nothing is connected yet."""
        match = re.fullmatch(r"(?:(?:tcp|tls|wss?)://)?(?:[\w.-]+|\[[\da-fA-F:.%]+\]):(\d+)", value)
        if not match or not 0 < int(match[1][:6]) < 65536:
            self.fail(f"{value!r} is no address; give one such as tcp://head:8786.", param, ctx)
        return value
