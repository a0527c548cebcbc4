"""Shows the pictures and films that an example of the gallery writes, in the order of its blocks; its film in small."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from PIL import Image, ImageOps
from sphinx_gallery.scrapers import figure_rst

KINDS = (".gif", ".png", ".svg")

SMALL = (400, 280)
"""Width and height of a picture in the list of the gallery [pixels]."""


def scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move what a block has written beside its script into the gallery, and show it."""
    folder, shown = Path(block_vars["src_file"]).parent, []
    written = (path for path in folder.iterdir() if path.suffix in KINDS)
    for path in sorted(written, key=lambda each: each.stat().st_mtime_ns):
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
