"""The pages of the documentation: what they show is so, and they load in a browser without network."""

import ast
import inspect
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

pytest.importorskip("sybil")
pytest.importorskip("sphinx")

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
ONE = "windscreen_wiper"
"""The example of the gallery that is run here; the build of all pages runs them all."""

HOLE = "…"
"""What stands for names and numbers in a message."""

LOADED = ("index", "tutorial", "mechanisms/index", "theory/method", "reference/api", "reference/messages")
"""Pages that a browser opens here, beside those of the gallery."""


def imported(name: str, folder: Path):
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        return __import__(name)


snippets = imported("snippets", DOCS)
links = imported("links", ROOT / "scripts" / "packaging")

OWN = [p for p in sorted(DOCS.rglob("*.md")) if not {"made", "_build", "gallery"} & set(p.relative_to(DOCS).parts)]
PAGES = [ROOT / "README.md", *OWN]
RUN = [page for page in PAGES if snippets.runs(page.read_text(encoding="utf-8"))]


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


# Snippets ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in RUN if page.name != "tutorial.md"], ids=name_of)
def test_a_page_shows_what_is_so(page, tmp_path):
    """Every block runs, and prints what the page says; the tutorial runs where the site is built."""
    if page in OWN and os.environ.get("SNIPPETS") == "site":
        pytest.skip("SNIPPETS=site: the site is built, too, which runs what stands in its pages")
    assert snippets.in_folder(page, tmp_path / "made") == ""


@pytest.mark.slow
def test_a_page_that_shows_something_else_is_told(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A\n\n```python\nprint(1 + 1)\n```\n\n```output\n3\n```\n")
    assert "line 7: AssertionError: the page says" in snippets.in_folder(page, tmp_path / "made")
    page.write_text("```console\n$ echo one two\none ...\n$ python -c 'raise SystemExit(3)'\n```\n")
    assert "ends with exit code 3" in snippets.in_folder(page, tmp_path / "made")
    page.write_text("```python\n# x.py\na = 2\n```\n\n```python\nfrom x import a\nprint(a)\n```\n\n```output\n2\n```\n")
    assert snippets.in_folder(page, tmp_path / "made") == ""


# Links and names -----------------------------------------------------------------------------------------------------


def test_the_readme_is_one_page():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 110


@pytest.mark.slow
def test_the_film_of_the_readme_is_small_and_moves(tmp_path):
    from PIL import Image

    film = DOCS / "five_bar.gif"
    assert film.stat().st_size < 300_000
    with Image.open(film) as frames:
        assert frames.n_frames > 30
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "scripts"))
        pictures = imported("pictures", ROOT / "scripts")
    assert pictures.main(["film", "-o", str(tmp_path / "again.gif"), "--fps", "2"]) == 0
    with Image.open(film) as frames, Image.open(tmp_path / "again.gif") as again:
        assert again.size == frames.size
        assert 3 < again.n_frames < frames.n_frames


def test_links_become_absolute_where_the_source_is_known():
    text = "![film](docs/a.gif)\n\n[the page](docs/b.md) and [site](https://x.org), [here](#c)\n"
    assert links.for_an_index(text, "https://git.org/a/b/", "1.0") == (
        "![film](https://git.org/a/b/raw/v1.0/docs/a.gif)\n\n"
        "[the page](https://git.org/a/b/blob/v1.0/docs/b.md) and [site](https://x.org), [here](#c)\n"
    )
    plain = links.for_an_index(text, None, "1.0")
    assert plain.startswith("the page, `docs/b.md` and [site](https://x.org), [here](#c)\n")


def test_every_registered_mechanism_has_a_page():
    import alfmu

    assert {page.stem for page in (DOCS / "mechanisms").glob("*.md")} == {*alfmu.mechanisms(), "index"}


def test_every_public_name_is_in_the_reference():
    import alfmu

    page = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\.\. auto\w+:: (?:\w+\.)*(\w+)(?:\(\))?$", page, re.M))
    assert set(alfmu.__all__) - named == set()
    calls = {n for n, _ in inspect.getmembers(alfmu.Mechanism, inspect.isfunction) if not n.startswith("_")}
    former = {"declared_at", "measured_joints", "measured_springs", "relations", "trace"}
    assert calls - former == set(re.findall(r"^   \.\. automethod:: (\w+)$", page, re.M))


# Messages ------------------------------------------------------------------------------------------------------------


def templates() -> list[list[str]]:
    """What the package says: texts of its Python and C files, cut where names and numbers are put in."""
    found = []
    for path in (ROOT / "alfmu").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                found.append("".join(x.value if isinstance(x, ast.Constant) else HOLE for x in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    for path in (ROOT / "alfmu" / "runtime" / "c").rglob("*.c"):
        text = re.sub(r'"\s*"', "", path.read_text(encoding="utf-8"))
        found += [re.sub(r"%[-+ .\d]*[a-z]", HOLE, each) for each in re.findall(r'"((?:[^"\\\n]|\\.)*)"', text)]
    return [each.split(HOLE) for each in found]


def said(message: str, pieces: list[str]) -> bool:
    """Whether a text with holes can hold a message with holes."""
    own, text = message.split(HOLE), HOLE.join(pieces)
    return all(piece in text for piece in own) and bool(re.search(".*".join(map(re.escape, own)), text, re.DOTALL))


QUOTED = re.findall(
    r"^`(.+)`\n: ",
    (DOCS / "reference" / "messages.md").read_text(encoding="utf-8").partition("## Messages of other programs")[0],
    re.M,
)


def test_messages_are_quoted():
    assert len(QUOTED) > 30


@pytest.fixture(scope="module")
def texts() -> list[list[str]]:
    return templates()


@pytest.mark.slow
@pytest.mark.parametrize("message", QUOTED)
def test_a_quoted_message_is_one_of_the_package(message, texts):
    assert any(said(message, pieces) for pieces in texts)


# The site ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The pages, with the pictures of the tutorial and of one example of the gallery; a warning fails.

    SITE is a folder with the whole site, where it is built anyway.
    """
    if built := os.environ.get("SITE"):
        return Path(built)
    if os.environ.get("SNIPPETS") == "site":
        pytest.skip("SNIPPETS=site: the site is built, too; SITE=FOLDER runs this test on it")
    folder = tmp_path_factory.mktemp("site")
    left = shutil.ignore_patterns("_build", "made", "__pycache__", "*.gif.tmp")
    for each in ("docs", "mechanisms"):
        shutil.copytree(ROOT / each, folder / each, ignore=left)
    shutil.rmtree(folder / "docs" / "mechanisms" / "gallery", ignore_errors=True)
    for each in ("CHANGELOG.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / each, folder)
    few = ["-D", "snippets_pages=tutorial", "-D", f"sphinx_gallery_conf.filename_pattern={ONE}"]
    command = [
        sys.executable,
        "-m",
        "sphinx",
        "-W",
        "--keep-going",
        "-q",
        *few,
        str(folder / "docs"),
        str(folder / "site"),
    ]
    # Whatever asks for the network finds none.
    without = {**os.environ, **dict.fromkeys(("http_proxy", "https_proxy"), "http://127.0.0.1:9")}
    done = subprocess.run(command, env=without, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "site"


@pytest.mark.slow
def test_a_page_that_does_not_run_fails_the_build_without_w_too(tmp_path):
    """Until it is mended, also where it is not read again."""
    shutil.copy(DOCS / "snippets.py", tmp_path)
    (tmp_path / "conf.py").write_text(
        "import sys\n\nsys.path.insert(0, '.')\nextensions = ['myst_parser', 'snippets']\n"
    )
    page = tmp_path / "index.md"
    command = [sys.executable, "-m", "sphinx", "-q", ".", "out"]

    def build() -> tuple[int, str]:
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
        return done.returncode, done.stderr

    page.write_text("# A page\n\n```python\nassert 1 == 2\n```\n")
    for _ in range(2):
        code, said = build()
        assert code == 1
        assert "pages that did not run: index" in said
    page.write_text("# A page\n")
    assert build() == (0, "")


def test_the_first_page_has_the_lines_of_what_runs_in_it():
    """Four mechanisms, each in a frame beside its declaration, of some ten lines."""
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    framed = re.findall(r'src="_live/(\w+)\.html#embedded"', text)
    declared = dict(re.findall(r"```python\n# (\w+)\.py\n(.*?)```", text, re.S))
    assert framed == list(declared)
    assert len(framed) == 4
    for name, lines in declared.items():
        assert f"$ alfmu live {name}.py -o {name}.html\n" in text
        assert len(lines.strip().splitlines()) - 2 <= 12, name
        namespace: dict[str, object] = {}
        exec(lines, namespace)
        assert getattr(namespace["m"], "name", "") == name


@pytest.mark.slow
def test_the_gallery_lists_an_example_by_its_film(site):
    if not (site / "mechanisms/gallery/index.html").exists():
        pytest.skip("this copy comes without the gallery")
    # Those that ran were checked, which for the whole site is all that test_gallery leaves to it.
    every = [path.stem for path in sorted((DOCS / "gallery").glob("*.py"))]
    assert (site / "checked.txt").read_text().split() == (every if "SITE" in os.environ else [f"plot_{ONE}"])
    (listed,) = (site / "_images").glob(f"sphx_glr_plot_{ONE}_thumb.png")
    (film,) = (site / "_images").glob(f"sphx_glr_plot_{ONE}_*.gif")
    with Image.open(listed) as small, Image.open(film) as frames:
        assert small.size == (400, 280)
        ground, of_film = (max(each.convert("RGB").getcolors(1 << 20))[1] for each in (small, frames))
        assert ground == of_film != (255, 255, 255)  # a figure stands on white


@pytest.mark.slow
def test_texts_are_shown_as_they_are_written(site):
    """What reStructuredText takes for markup that does not end is shown in red, and is no warning of Sphinx."""
    marked = [path.name for path in site.rglob("*.html") if 'class="problematic"' in path.read_text(encoding="utf-8")]
    assert marked == []
    assert "“link*.angle,*.force.*”" in (site / "reference" / "cli.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_pages_load_in_a_browser(site, chromium):
    """Pictures are there, nothing is fetched, nothing complains, and a phone shows no page wider than itself."""
    examples = [page for page in ("index", f"plot_{ONE}") if (site / "mechanisms/gallery" / f"{page}.html").exists()]
    broken = """
        const done = arguments[0], pictures = [...document.images];
        const lost = each => { each.loading = "eager"; return each.decode().then(() => null, () => each.src); };
        Promise.all(pictures.map(lost)).then(all => done([pictures.length, all.filter(x => x)]));
    """
    shown = 0
    for page in (*LOADED, *(f"mechanisms/gallery/{each}" for each in examples)):
        file = site / f"{page}.html"
        text = file.read_text(encoding="utf-8")
        assert re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"https?:", text) == [], page
        for width in (1280, 400):
            chromium.set_window_size(width, 900)
            chromium.get(file.as_uri())
            count, lost = chromium.execute_async_script(broken)
            assert lost == [], page
            shown += count
            over = chromium.execute_script("return document.documentElement.scrollWidth - window.innerWidth")
            assert over <= 0, f"{page} is {over} pixels too wide"
        assert [entry["message"] for entry in chromium.get_log("browser")] == [], page
    assert shown > 10


@pytest.mark.slow
def test_texts_of_the_site_are_made_from_the_package(site):
    """Options of every command, arguments of the public functions, and formulas that browsers show by themselves."""
    commands = (site / "reference" / "cli.html").read_text(encoding="utf-8")
    assert all(f"--{name}" in commands for name in ("held-rows", "compliances", "freeze", "platform"))
    api = (site / "reference" / "api.html").read_text(encoding="utf-8")
    assert all(f'id="alfmu.{name}"' in api for name in ("Mechanism.revolute", "simulate", "export", "Recipe"))
    formulas = re.findall(r"\$\$?[^$]+\$\$?", (DOCS / "theory" / "method.md").read_text(encoding="utf-8"))
    assert len(formulas) > 15
    assert (site / "theory" / "method.html").read_text(encoding="utf-8").count("<math") == len(formulas)


def test_pictures_of_pages_are_those_that_they_leave():
    """A page shows pictures of its own folder alone, and no other page's."""
    for page in OWN:
        folder = (DOCS / snippets.MADE / page.relative_to(DOCS)).with_suffix("")
        for path in links.relative(page.read_text(encoding="utf-8")):
            if f"{snippets.MADE}/" in path:
                assert (page.parent / path).resolve().parent == folder, f"{page}: {path}"
