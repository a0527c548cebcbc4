"""The headers that C and Python share are what Python writes."""

from pathlib import Path

import pytest

from alfmu import runtime
from alfmu.kernel.scene import operations_header
from alfmu.kernel.tables import layout_header


@pytest.mark.parametrize(("name", "made"), [("operations.h", operations_header), ("layout.h", layout_header)])
def test_headers_are_those_of_python(name, made):
    assert (Path(runtime.__file__).parent / "c" / "core" / name).read_text() == made()
