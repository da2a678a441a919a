"""Files that are written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a file name beside the target; put the file in the target's place at the end.

    Raises:
        FileNotFoundError: The folder does not exist.
    """
    target = Path(path)
    folder = target.parent
    if not folder.is_dir():
        raise FileNotFoundError(f"path: folder {str(folder)!r} does not exist; make it first")
    unfinished = folder / f".{target.stem}-{secrets.token_hex(4)}{target.suffix}"
    try:
        yield unfinished
        os.replace(unfinished, target)
    finally:
        unfinished.unlink(missing_ok=True)
