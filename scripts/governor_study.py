"""The flyball governor over 10 s: reference table by two methods, and what alfmu's fixed steps make of it.

python scripts/governor_study.py --write      # remakes tests/oracles/flyball.csv, some minutes
python scripts/governor_study.py              # compares alfmu with it
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import alfmu

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from oracles import flyball

STIFFNESS = 8e5, 8e7
STEPS = 3e-4, 2e-4, 1e-4


def write() -> None:
    """Integrate the minimal coordinates by DOP853 and by Radau; keep the first, report how far apart they are."""
    columns = [flyball.TIMES]
    for stiffness in STIFFNESS:
        explicit = flyball.heights(stiffness)
        looser = flyball.heights(stiffness, rtol=1e-11)
        implicit = flyball.heights(stiffness, method="Radau", rtol=1e-10)
        columns.append(explicit)
        print(
            f"springs of {stiffness:g} N/m: {explicit[-1]:.12f} m at 10 s; DOP853 at a tenfold tolerance differs by "
            f"{np.abs(looser - explicit).max():.1e} m, Radau by {np.abs(implicit - explicit).max():.1e} m"
        )
    names = ["time [s]", *(f"slider.position [m] at {k:g} N/m" for k in STIFFNESS)]
    np.savetxt(flyball.TABLE, np.stack(columns, axis=1), "%.14f", ",", header=",".join(names), comments="")


def compare(kernel: str) -> None:
    """Largest error of the height over 10 s for some steps, with the time it takes."""
    equations, table = alfmu.derive(alfmu.load("flyball_governor")), flyball.table()
    for column, stiffness in enumerate(STIFFNESS, 1):
        for step in STEPS:
            begin = time.perf_counter()
            given = {"stiffness": stiffness, "solver.method": "rk4", "solver.step_size": step}
            r = alfmu.simulate(equations, 10.0, 0.5, parameters=given, kernel=kernel)
            error = np.abs(r["slider.position"] - table[:, column]).max()
            spent = time.perf_counter() - begin
            print(
                f"springs of {stiffness:g} N/m, step {step:g} s: {r['slider.position'][-1]:.12f} m at 10 s, "
                f"largest error {error:.1e} m, energy balance {r.counters.energy_error:.1e} J, {spent:.1f} s"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="remake the reference table")
    parser.add_argument("--kernel", default="auto", help="kernel of alfmu (auto)")
    arguments = parser.parse_args()
    write() if arguments.write else compare(arguments.kernel)
