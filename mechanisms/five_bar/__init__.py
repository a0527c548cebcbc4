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
q = [th1 x2 y2 th2 th3 x4 y4 th4]: links 2 and 4 torn off. Either of them alone makes the parallelogram, so one of the
eight constraints is redundant; at th1 = n pi all links are aligned and the position is singular as well.
"""

import casadi as ca
from alfmu_mechanisms.four_bar import parallelogram

from alfmu import Experiment, Mechanism

SKETCH = __doc__


def five_bar() -> Mechanism:
    """Five-bar linkage with one redundant constraint."""
    experiment = Experiment(stop_time=20.0, step_size=0.02)
    m = Mechanism("five_bar", "Five-bar linkage with one redundant constraint", SKETCH, experiment)
    l, th1, links = parallelogram(m)
    m4 = m.parameter("m4", 1.0, "kg", minimum=0.0, description="mass of link 4")
    x4 = m.coordinate("x4", "m", start=l / 2 * ca.cos(th1) + l / 2)
    y4 = m.coordinate("y4", "m", start=l / 2 * ca.sin(th1))
    th4 = m.coordinate("th4", "rad", start=0.0)
    link4 = m.bar("link4", mass=m4, length=l, pose=(x4, y4, th4))
    m.revolute("E", links["link1"].at(l / 2), link4.start)
    m.revolute("F", link4.end, links["link3"].at(l / 2))
    return m
