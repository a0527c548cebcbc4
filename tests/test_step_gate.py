"""No step of an FMU allocates memory, locks, or calls the system, as rigs ask."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from test_left_out import by_a_compiler
from test_source import CASES, compiled, with_binary

from alfmu.runtime import build


@pytest.mark.slow
@by_a_compiler
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it is about Linux")
@pytest.mark.parametrize("kind", ["native", "source"])
@pytest.mark.parametrize("case", CASES)
def test_a_step_allocates_nothing_and_does_not_lock_or_call_the_system(tmp_path, fmu_of, case, kind):
    host = tmp_path / "host"
    compiled(
        ["-O1", "-w", "-rdynamic", str(Path(__file__).with_name("step_gate.c")), "-o", str(host), "-ldl"], tmp_path
    )
    mechanism = case if case in ("five_bar", "slider_crank") else CASES[case]()
    given = {"kind": "native", "reference": False} if kind == "native" else {"kind": "source", "fmi": 2}
    path = fmu_of(mechanism, **given)
    path = with_binary(path, 2) if kind == "source" else path
    folder = tmp_path / "unpacked"
    with zipfile.ZipFile(path) as archive:
        archive.extractall(folder)
    described = (folder / "modelDescription.xml").read_text()
    guid = re.search(r'guid="(.*?)"', described)[1]
    inputs, outputs = (
        [
            ("b" if kind == "Boolean" else "") + reference
            for reference, kind in re.findall(
                rf'valueReference="(\d+)" causality="{causality}".*?<(Real|Boolean|Integer)', described, re.DOTALL
            )
            if causality == "input" or kind == "Real"
        ]
        for causality in ("input", "output")
    )
    library = folder / "binaries" / build.HERE / f"{case}.so"
    command = [str(host), str(library), guid, (folder / "resources").as_uri(), "0.01", "200", *inputs, "o", *outputs]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "good")
    for found, wrong in (((3, "a step calls malloc"), "malloc"), ((-9, ""), "getpid")):
        done = subprocess.run([*command[:6], wrong], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == found
