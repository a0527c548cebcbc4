"""The fuzzer of native FMUs, shortly; `scripts/fuzz.py` has the long one."""

import os

import pytest

from alfmu.runtime import build

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not build.compiler(), reason="there is no C compiler")]


TIMES = float(os.environ.get("DRAWS", "1"))
"""`DRAWS=10 pytest tests/test_native_fuzz.py` makes ten times as many calls."""

RUNS = [
    *(("locks", 2, "address", 1, 8000), ("extrapolated", 3, "address", 1, 8000)),
    *(("explicit", 3, "address", 1, 3000), ("trapezoidal", 2, "address", 1, 3000)),
    *(("auto", 2, "address", 1, 800), ("jacobian", 2, "address", 1, 2000), ("jacobian", 3, "thread", 4, 1000)),
    *(("five_bar", 2, "thread", 4, 3000), ("order8", 3, "thread", 4, 3000)),
]


@pytest.mark.parametrize(("name", "fmi", "watched", "threads", "calls"), RUNS)
def test_no_call_makes_a_sanitizer_report_or_comes_to_a_wrong_status(
    fuzz, sanitized, tmp_path, name, fmi, watched, threads, calls
):
    calls = round(TIMES * calls)
    made, said = fuzz.fuzzed(fuzz.built(name, fmi, tmp_path, watched, sanitized(watched)), 7, calls, threads)
    assert calls <= made, said
    assert made < 1.2 * calls
    assert int(said.split(" steps made")[0].split()[-1]) > calls / 50, said


def test_the_fuzzer_sees_what_is_wrong(fuzz, sanitized, tmp_path, monkeypatch):
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
    made, said = fuzz.fuzzed(fuzz.built("wrong", 2, tmp_path, "address", sanitized("address")), 7, 2000, 1)
    assert made == 0
    assert "status 0 is not among those" in said
