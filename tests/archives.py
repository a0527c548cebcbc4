"""Archives with other contents, as FMUs and SSPs that somebody has changed."""

import zipfile
from collections.abc import Callable
from pathlib import Path


def changed(path: Path, target: Path, change: Callable[[str, bytes], bytes | None]) -> Path:
    """A copy of an archive with what `change` makes of each file, by its name; without those of which it makes None."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for info in old.infolist():
            if (data := change(info.filename, old.read(info))) is not None:
                new.writestr(info, data)
    return target


def replaced(path: Path, target: Path, name: str, old: str, new: str) -> Path:
    """A copy of an archive with another text in the files whose names end so; the old text is there."""
    found = []

    def change(file: str, data: bytes) -> bytes:
        if not file.endswith(name):
            return data
        found.append(old.encode() in data)
        return data.replace(old.encode(), new.encode(), 1)

    changed(path, target, change)
    assert any(found)
    return target
