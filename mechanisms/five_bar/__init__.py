"""Five-bar linkage with one redundant constraint (Blajer 2002, Figs. 6 and 7).

    B ---- link2 ---- C
    |                 |
  link1             link3
    |                 |
    E ---- link4 ---- F
    |                 |            y
    |                 |            |  gravity g along -y
    A ==== ground === D            o-- x

All links have length l; A at (0, 0), D at (l, 0), E and F at mid-length of links 1 and 3.

    mixed     q = [th1 x2 y2 th2 th3 x4 y4 th4]   links 2 and 4 torn off, as in the paper
    joint     q = [th1 th2 th3 th4]               links 2 and 4 by their angles from link 1, the loops cut at C and F

Either of links 2 and 4 alone makes the parallelogram, so one constraint is redundant; at th1 = n pi all links are
aligned and the position is singular as well.
"""

import casadi as ca

from alfmu import Experiment, Mechanism

from ..four_bar import Coordinates, across, parallelogram

SKETCH = __doc__


def five_bar(coordinates: Coordinates = "mixed") -> Mechanism:
    """Return a five-bar linkage with one redundant constraint, in these coordinates."""
    experiment = Experiment(stop_time=20.0, step_size=0.02)
    m = Mechanism("five_bar", "Five-bar linkage with one redundant constraint", SKETCH, experiment)
    l, th1, links = parallelogram(m, coordinates)
    m4 = m.parameter("m4", 1.0, "kg", minimum=0.0, description="mass of link 4")
    link4, angle_E = across(m, coordinates, 4, m4, l, (l / 2 * ca.cos(th1), l / 2 * ca.sin(th1)), th1)
    m.revolute("E", links["link1"].at(l / 2), link4.start, coordinate=angle_E)
    m.revolute("F", link4.end, links["link3"].at(l / 2))
    return m
