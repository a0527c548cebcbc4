"""Shows pictures and films of the examples of the gallery, in the order of their blocks; checks what each leaves."""

from __future__ import annotations

import shutil
import traceback
from pathlib import Path
from typing import Any

from checks import hold
from PIL import Image, ImageOps
from sphinx.errors import ExtensionError
from sphinx_gallery.scrapers import figure_rst

SOURCES = (".py", ".rst")
"""Suffixes of what the folder of the examples has of its own; the rest is what they have written."""

RAN: dict[str, tuple[dict[str, Any], list[str]]] = {}
"""Of each example that was run, the names and the files that it has left."""

SMALL = (400, 280)
"""Width and height of a picture in the list of the gallery [pixels]."""


def scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move what a block has written beside its script into the gallery, and show it."""
    folder, shown = Path(block_vars["src_file"]).parent, []
    _, left = RAN.setdefault(Path(block_vars["src_file"]).stem, (block_vars["example_globals"], []))
    written = (path for path in folder.iterdir() if path.is_file() and path.suffix not in SOURCES)
    for path in sorted(written, key=lambda each: each.stat().st_mtime_ns):
        left.append(path.name)
        target = Path(next(block_vars["image_path_iterator"])).with_suffix(path.suffix)
        shutil.move(path, target)
        shown.append(str(target))
    return figure_rst(shown, gallery_conf["src_dir"])


def small(app: Any) -> None:
    """Show each example by a third of its film, in place of its first figure, once the gallery is made."""
    images = Path(app.srcdir) / "mechanisms" / "gallery" / "images"
    for film in images.glob("*.gif"):
        with Image.open(film) as frames:
            frames.seek(frames.n_frames // 3)
            picture = ImageOps.fit(frames.convert("RGB"), SMALL)
        picture.save(images / "thumb" / f"{film.stem.rpartition('_')[0]}_thumb.png")


def checked(app: Any) -> None:
    """Check what each example has left, and list it; where it is wrong, the build fails, as does the next one."""
    gallery, wrong = Path(app.srcdir) / "mechanisms" / "gallery", []
    for stem, (names, files) in RAN.items():
        _, shown, said = (gallery / f"{stem}.rst").read_text(encoding="utf-8").partition("sphx-glr-script-out")
        try:
            figures = len(list((gallery / "images").glob(f"sphx_glr_{stem}_*.png")))
            hold(stem.removeprefix("plot_"), names, figures, shown and said, files)
        except Exception:
            (gallery / f"{stem}.py.md5").unlink(missing_ok=True)
            wrong.append(f"{stem}: {traceback.format_exc(limit=-1)}")
    if wrong:
        raise ExtensionError("\n".join(["checks of the gallery do not hold:", *wrong]))
    Path(app.outdir).mkdir(parents=True, exist_ok=True)
    (Path(app.outdir) / "checked.txt").write_text("\n".join(sorted(RAN)), encoding="utf-8")
