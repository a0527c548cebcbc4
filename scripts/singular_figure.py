"""Draw `docs/singular.png`: a four-bar linkage passes a singular position, its distance and the error of its angle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import singular_study as study
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import alfmu
from alfmu.method.singular import BRANCH_MARGIN, LEAST_DISTANCE, LIMIT_ZONE, READ_DISTANCE, READ_ZONE

PICTURE = Path(__file__).parents[1] / "docs" / "singular.png"

SPEED, TORQUE, STEP, BEFORE, STEPS = 3.0, 4.0, 0.02, 10, 30
"""The motion: speed at the singular position [rad/s], torque [N.m], step [s], its number before and in all.

A step ends at the singular position, nearly: the hardest case for a method that does not know of it."""

ZONES = {
    "S3: stages are brought to the branch": (BRANCH_MARGIN**0.5, "#d7e6f4"),
    "S4: reactions read are limits": (READ_ZONE * READ_DISTANCE, "#9cc4e4"),
    "S4: accelerations are limits": (LIMIT_ZONE * LEAST_DISTANCE, "#4f93c8"),
}
"""Distance [rad] below which each holds, the largest first, and its colour."""


def distances(angles: NDArray) -> NDArray:
    """The distance that alfmu measures at angles [rad] of the crank."""
    equations, found = study.scene("vm", "four_bar", coordinates="joint"), []
    for angle in angles:
        i = alfmu.Instance(equations)
        i.set("start.angle", float(angle))
        i.initialize()
        found.append(i.get("monitor.distance"))
    return np.array(found)


def passage(axes: Axes, times: NDArray, angles: NDArray) -> None:
    """Distance over the time from the singular position [s], with the zones."""
    for label, (distance, colour) in ZONES.items():
        axes.axhspan(1e-6, distance, color=colour, lw=0, label=f"{label} (below {distance:.2g} rad)")
    axes.semilogy(times, distances(angles), "k-", lw=1.4)
    axes.set(ylabel="distance, root of the margin [rad]", ylim=(1e-5, 2))
    axes.legend(fontsize=8, loc="lower right", framealpha=1)


def main() -> None:
    """Draw the picture."""
    acceleration, before = study.parallelogram(), -STEP * BEFORE
    # The acceleration depends on the angle alone, so that a motion run backwards is one.
    start = study.motion(acceleration, np.array([[0.0], [SPEED]]), TORQUE, np.array([0.0, -before]), 0.005)[-1, :, 0]
    start *= 1, -1
    fine = np.sort([*np.geomspace(1e-5, STEP * (STEPS - BEFORE), 120), *-np.geomspace(1e-5, -before, 120)])
    angles = study.motion(acceleration, start[:, None], TORQUE, fine - before, 0.005)[:, 0, 0]
    motion = study.reference(acceleration, start, TORQUE, STEP, STEPS)
    times, exact = STEP * np.arange(1, STEPS + 1) + before, motion.exact[1:, 0]

    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    passage(above, fine, angles)
    above.set(title=f"Four-bar linkage in joint coordinates, torque of {TORQUE:g} N m, RK4 with steps of {STEP:g} s")
    equations = study.scene("vm", "four_bar", coordinates="joint")
    lines = {"the paper's procedure (solver.branch = paper)": study.PAPER, "on the branch (default)": study.OWN}
    for (label, branch), style in zip(lines.items(), ("C1-x", "C0-o"), strict=True):
        given = {"start.angle": start[0], "start.angular_velocity": start[1], "solver.branch": branch}
        run = study.drive(equations, given, {"A.torque": TORQUE}, STEP, STEPS)
        below.semilogy(times, np.maximum.accumulate(np.abs(run.angles[1:] - exact)), style, ms=4, lw=1.2, label=label)
    best = np.maximum.accumulate(np.abs(motion.by_rk4[1:, 0] - exact))
    below.semilogy(times, best, "k:", lw=1.6, label="RK4 on the exact equation of one degree of freedom")
    below.set(
        xlabel="time from the singular position [s]",
        ylabel="largest error so far of the angle [rad]",
        xlim=(-0.21, 0.41),
    )
    below.legend(fontsize=8, loc="lower right", framealpha=1)
    for axes in (above, below):
        axes.axvline(0.0, color="0.4", lw=0.8, ls="--")
        axes.grid(alpha=0.3)
    figure.savefig(PICTURE, dpi=110)
    print(PICTURE)


if __name__ == "__main__":
    main()
