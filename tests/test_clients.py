"""The table of clients: what its script measures with those that are installed, and the page that shows it."""

import re
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def clients():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        import clients

        yield clients
        del sys.modules["clients"]


def most(column: str) -> float:
    """What a run may differ by: in Model Exchange, CVode at 1e-8 over 1 s leaves a hundred times its tolerance."""
    return 1e-5 if column.startswith("Model Exchange") else 1e-11


@pytest.fixture(scope="module")
def measured(clients):
    """Rows of clients that can be installed beside each other, by name."""
    names = ("newest fmpy", "ecos", "libcosim", "wasmtime", "fmusim")
    return dict(zip(names, clients.rows(names, here=True)[1:], strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["newest fmpy", "ecos", "libcosim", "wasmtime", "fmusim"])
def test_what_is_installed_gives_the_numbers_of_the_library(clients, measured, name):
    """fmpy is, which has a function for every column but one."""
    found = measured[name]
    if len(found) == 2:
        assert name != "newest fmpy"
        pytest.skip(found[1])
    for column, cell in zip(clients.COLUMNS, found[1:], strict=True):
        if cell == clients.NONE or (name, column) == ("libcosim", "co-simulation, FMI 3"):
            assert name != "newest fmpy" or column == "connected"
        else:
            assert float(cell) < most(column), column


def test_the_page_has_the_table_that_the_script_writes(clients):
    page = clients.PAGE.read_text(encoding="utf-8")
    shown = page.partition(clients.BEGIN)[2].partition(clients.END)[0].strip().splitlines()
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in shown]
    assert table[0] == ["Client", *clients.COLUMNS]
    assert len(table) == 2 + len(clients.CLIENTS) + len(clients.SYSTEM)
    for name, row in zip([*clients.CLIENTS, *clients.SYSTEM], table[2:], strict=True):
        assert re.fullmatch(rf"{name}( \d+(\.\w+)+)?", row[0])
        if row[1].startswith("**not tried**"):
            assert not any(row[2:])
            continue
        driver = clients.CLIENTS[name][0]
        for (column, method), cell in zip(clients.COLUMNS.items(), row[1:], strict=True):
            assert (cell == clients.NONE) != hasattr(driver, method)
            if re.fullmatch(r"[0-9.e+-]+", cell):
                assert float(cell) < most(column)
