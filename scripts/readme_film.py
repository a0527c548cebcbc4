"""Make the film of README.md and of the first page, `docs/five_bar.gif`: the five-bar of Blajer (2002) over one period.

The run is that of the paper's Figure 7, from the singular position with 2 rad/s under gravity, until the linkage is
back where it began, so that the film has no seam.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import alfmu
from alfmu.view.picture import animate

FILM = Path(__file__).parents[1] / "docs" / "five_bar.gif"

SIZE = (320, 300)
"""Width and height [pixels]."""


def period() -> float:
    """Time [s] after which the linkage turns through its start again, in the same sense."""
    run = alfmu.simulate("five_bar", 10.0, 0.01, outputs=["link1.angle", "link1.angular_velocity"])
    angle, rate = run["link1.angle"], run["link1.angular_velocity"]
    after = next(i for i in range(10, len(angle)) if angle[i - 1] < 0 <= angle[i] and rate[i] > 0)
    return float(np.interp(0.0, angle[after - 1 : after + 1], run.time[after - 1 : after + 1]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the film."""
    line = argparse.ArgumentParser(description="Make the film of README.md: one period of the five-bar.")
    line.add_argument("-o", "--output", type=Path, default=FILM, help="file to write (default: docs/five_bar.gif)")
    line.add_argument("--fps", type=float, default=20.0, help="frames per second (default: %(default)g)")
    chosen = line.parse_args(arguments)
    length = period()
    run = alfmu.simulate("five_bar", length, 0.01, outputs=["link*.x", "link*.y", "link*.angle"])
    animate(alfmu.load("five_bar"), run, chosen.output, fps=chosen.fps, size=SIZE)
    print(chosen.output)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
