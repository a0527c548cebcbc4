"""The fuzzer of native FMUs, shortly; `scripts/fuzz.py` has the long one."""

from pathlib import Path

import pytest

from alfmu.runtime import build

SCRIPTS = Path(__file__).parents[1] / "scripts"

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not build.compiler(), reason="there is no C compiler")]


@pytest.fixture(scope="module")
def fuzz():
    """The script as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(SCRIPTS))
        import fuzz

        yield fuzz


RUNS = [
    *(("locks", 2, "address", 1, 15_000), ("extrapolated", 3, "address", 1, 15_000)),
    *(("explicit", 3, "address", 1, 3000), ("trapezoidal", 2, "address", 1, 3000)),
    *(("auto", 2, "address", 1, 2000), ("jacobian", 2, "address", 1, 2500), ("jacobian", 3, "thread", 4, 2500)),
    *(("five_bar", 2, "thread", 4, 8000), ("order8", 3, "thread", 4, 5000)),
]


@pytest.mark.parametrize(("name", "fmi", "watched", "threads", "calls"), RUNS)
def test_no_call_makes_a_sanitizer_report_or_comes_to_a_wrong_status(
    fuzz, tmp_path, name, fmi, watched, threads, calls
):
    made, said = fuzz.fuzzed(fuzz.built(name, fmi, tmp_path, watched), 7, calls, threads)
    assert calls <= made, said
    assert made < 1.2 * calls
    assert int(said.split(" steps made")[0].split()[-1]) > calls / 50, said


def test_the_fuzzer_sees_what_is_wrong(fuzz, tmp_path, monkeypatch):
    """A step that is said to be made, and is not."""
    monkeypatch.setattr(fuzz, "CASES", {"wrong": fuzz.CASES["order8"]})
    broken = tmp_path / "broken.h"
    nothing = "((void)(c), (void)(point), (void)(step), (void)(way), 0)"
    broken.write_text(f"#undef fmi2DoStep\n#define fmi2DoStep(c, point, step, way) {nothing}\n")
    source = tmp_path / "fuzz.c"
    text = fuzz.SOURCE.read_text().replace(
        '#include "fmi2Functions.h"', f'#include "fmi2Functions.h"\n#include "{broken}"'
    )
    source.write_text(text)
    monkeypatch.setattr(fuzz, "SOURCE", source)
    made, said = fuzz.fuzzed(fuzz.built("wrong", 2, tmp_path, "address"), 7, 2000, 1)
    assert made == 0
    assert "status 0 is not among those" in said
