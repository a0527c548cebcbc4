"""Sphinx: `python -m sphinx -W docs docs/_build` builds the pages, without network."""

import gc
import shutil
import sys
from datetime import date
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

gc.set_threshold(200_000, 20, 50)  # the collector would take a sixth of the time of the gallery

project = "alfmu"
version = release = version_of("alfmu")
copyright = f"{date.today().year}, the authors of alfmu"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_copybutton", "sphinx_design", "sphinxarg.ext", "snippets"]
exclude_patterns = ["_build", "made/**", "gallery/**"]
nitpicky = False

html_theme = "furo"
html_title = f"alfmu {version}"
html_static_path = ["_static"]
html_css_files = ["alfmu.css"]
html_copy_source = False

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

copybutton_prompt_text = "$ "

# The API, from docstrings: names in single quotes are code there.
default_role = "code"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_class_signature = "separated"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 80

# The gallery.
GALLERY = sorted((HERE / "gallery").glob("*.py"))
if GALLERY:
    extensions.append("sphinx_gallery.gen_gallery")
    sphinx_gallery_conf: dict[str, Any] = {
        "examples_dirs": "gallery",
        "gallery_dirs": "mechanisms/gallery",
        "filename_pattern": r"\.py$",
        "image_scrapers": ("films.scraper", "matplotlib"),
        "capture_repr": (),
        "write_computation_times": False,
        "download_all_examples": False,
        "show_memory": False,
        "min_reported_time": 1e9,
        "show_signature": False,
    }


def _formula(self: Any, node: Any, inline: bool) -> None:
    from docutils.nodes import SkipNode

    display = "inline" if inline else "block"
    self.body.append(f'<div class="formula">{convert(node.astext(), display=display)}</div>' if not inline else "")
    self.body.append(convert(node.astext(), display=display) if inline else "")
    raise SkipNode


def _escaped(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings write |Phi| for a size, which is something else in reStructuredText."""
    lines[:] = [line.replace("|", "\\|") for line in lines]


def _without_gallery(app: Any, document: str, source: list[str]) -> None:
    """A source archive may come without its examples."""
    if document == "mechanisms/index" and not GALLERY:
        before, _, rest = source[0].partition("## Gallery")
        source[0] = before + rest[rest.index("## ") :]
    if document == "index" and not GALLERY:
        source[0] = source[0].replace("mechanisms/gallery/index", "mechanisms/index")


def _live(app: Any, error: Exception | None) -> None:
    """The pages that run in frames of the first page stand beside it."""
    if not error and app.builder.format == "html":
        for page in (HERE / "made" / "index").glob("*.html"):
            target = Path(app.outdir) / "_live" / page.name
            target.parent.mkdir(exist_ok=True)
            shutil.copy(page, target)


def setup(app: Any) -> None:
    """Formulas as MathML, which browsers show by themselves: nothing is fetched."""
    app.connect("autodoc-process-docstring", _escaped)
    app.connect("build-finished", _live)
    app.connect("source-read", _without_gallery)
    if GALLERY:
        from films import checked, small

        for made in (checked, small):
            app.connect("builder-inited", made, priority=900)  # after sphinx-gallery has made the pages
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda self, node: _formula(self, node, True), None),
        block_renderers=(lambda self, node: _formula(self, node, False), None),
    )


html_math_renderer = "mathml"
