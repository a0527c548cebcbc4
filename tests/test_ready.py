"""What it takes to get a mechanism ready, and what is shown of it."""

import os
import struct
import subprocess
import sys
import time
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

import alfmu
from alfmu.kernel.complete import complete
from alfmu.kernel.passes import written
from alfmu.kernel.stream import Instructions
from alfmu.model.making import getting_ready, making, showing
from alfmu.simulation import prepared

AXES = [(0, 0, 1), (0, 1, 0), (1, 0, 0)]


def absolute() -> alfmu.Mechanism:
    """A four-bar in space: three bodies with seven coordinates each."""
    m = alfmu.Mechanism("three_bodies")
    corners = [(0.0, 0.0, 0.0), (0.2, 0.3, 0.0), (0.7, 0.4, 0.0), (0.5, 0.0, 0.0)]
    hinges = []
    for i, (begin, end) in enumerate(pairwise(map(np.array, corners))):
        center = (end - begin) / 2
        body = m.spatial_body(
            f"body{i}", mass=1.0, inertia=(0.01, 0.02, 0.025), center=tuple(center), position=tuple(begin + center)
        )
        hinges.append((body.at(), body.at(*(end - begin))))
    ground = m.spatial_ground.at
    ends = [(ground(*corners[0]), hinges[0][0]), *((a[1], b[0]) for a, b in pairwise(hinges))]
    for i, (first, second) in enumerate([*ends, (ground(*corners[-1]), hinges[-1][1])]):
        m.spatial_revolute(f"H{i}", first, second, axis=(0, 0, 1))
    m.gravity(0, -9.81, 0)
    return m


def chain(bodies: int) -> alfmu.Mechanism:
    """Hinges about axes that take turns."""
    m = alfmu.Mechanism("chain")
    m.gravity(0, 0, -9.81)
    before = m.spatial_ground.at()
    for i in range(bodies):
        angle = m.coordinate(f"angle{i}", "rad", start=0.1 * (i % 6), independent=True)
        body = m.spatial_body(f"body{i}", mass=1.0, inertia=(0.02, 0.03, 0.04), center=(0.1, 0.02, 0.05), relative=True)
        m.spatial_revolute(f"hinge{i}", before, body.at(), axis=AXES[i % 3], coordinate=angle)
        before = body.at(0.1, 0.0, 0.3)
    return m


@pytest.mark.slow
def test_functions_are_made_once():
    """Operations of all functions of a scene, to which the time of getting ready is in proportion.

    They were 500,000 while programs had margins and errors of their own, each with the factors of the augmented mass.
    """
    e = prepared(alfmu.derive(absolute()))
    assert sum(len(Instructions.of(f)) for f in complete(e).functions.values()) < 403_000


def test_what_was_made_is_not_made_again(tmp_path):
    """Files of the cache, and forms of CasADi's listing, were counted by what was taken for constants: whatever was
    written or traced made all that was in memory be forgotten, and gave its files names that no other process knew."""
    code = """if True:
        import alfmu
        from alfmu.kernel import trace
        from alfmu.runtime import pipeline, stored
        made = []
        pipeline.traced = lambda *given: made.append(given) or trace.traced(*given)
        e = alfmu.derive(alfmu.load("particle_on_circle"))
        scene, known = pipeline.prepared(e), stored.constants()
        alfmu.simulate("slider_crank", 0.01)
        assert pipeline.prepared(e) is scene
        assert stored.constants() == known
        print(len(made))
        """
    environment = {**os.environ, "ALFMU_CACHE": str(tmp_path)}
    run = partial(subprocess.run, [sys.executable, "-c", code], env=environment, text=True, check=True)
    assert [run(capture_output=True).stdout for _ in range(2)] == ["2\n", "0\n"]


def test_time_of_an_operation_that_is_arranged():
    """Python took some 10 to 20 us of the processor for each operation of a function."""
    f = alfmu.derive(chain(20)).functions["dynamics"]
    instructions = Instructions.of(f)
    began = time.process_time()
    written(instructions, [f.nnz_in(i) for i in range(f.n_in())], [f.nnz_out(i) for i in range(f.n_out())])
    assert (time.process_time() - began) / len(instructions) < 5e-6


def test_stages_within_stages_are_shown_once():
    told: list[str] = []

    class Shown:
        def __call__(self):
            return self

        def __enter__(self):
            told.append("begun")
            return told.append

        def __exit__(self, *_):
            told.append("done")

    making("nobody listens")
    with showing(Shown()), getting_ready():
        making("one")
        with getting_ready():
            making("two")
    assert told == ["begun", "one", "two", "done"]


@pytest.mark.skipif(sys.platform != "linux", reason="needs the terminals of Linux")
def test_the_command_line_shows_what_takes_long(tmp_path):
    """On a terminal, after the time of `GettingReady.AFTER`; into a file, nothing."""
    import fcntl
    import pty
    import termios

    file = tmp_path / "slow.py"
    file.write_text(
        "import sys, time\n"
        "from alfmu.cli.says import GettingReady\n"
        "from alfmu.model.making import getting_ready, making, showing\n"
        "GettingReady.AFTER = 0.3\n"
        "with showing(GettingReady()), getting_ready():\n"
        "    for k in range(8):\n"
        "        making(f'function {k}')\n"
        "        time.sleep(0.15)\n"
    )
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 100, 0, 0))
    subprocess.run([sys.executable, str(file)], stderr=theirs, check=True)
    os.close(theirs)
    shown = os.read(ours, 100_000).decode()
    os.close(ours)
    assert "function 7" in shown
    assert "function 0" not in shown
    silent = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, check=True)
    assert silent.stderr == ""
