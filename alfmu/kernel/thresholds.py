"""Numbers by which a run is judged while time passes; the C runtime has them from here (`layout.h`)."""

ASIDE = (-0.7, -0.1, 0.1, 0.7)
"""[rad, m]: displacements along the motion to places beside the start, where scales and ranks are found."""

LITTLE = 1e-4
"""[m]: displacement of lengths beside the start, enough to tell which coefficients of C are constant."""

FAR_RATIO = 2.0
"""Logarithm of a ratio of pivots contributed by masses, above which a place beside the start is not typical."""

COARSE = 1024.0
"""Parts of 1 to which the logarithm of a product of pivots is kept: coarse, so that round-off does not move it."""

PATIENT = 4
"""Factor to the most multiplier iterations where the motion may end at a singular position."""

REGULAR = 1e-3
"""Smallest size of an independent combination of constraints, over the largest."""

PENALTY_RATIO = 1e8
"""Default penalty over the largest mass that the rows hold, in units of the row."""

ALIKE = 10.0
"""Ratio of the units of rows up to which those that cannot be told are taken as one."""

HARDLY = 1e-3
"""Hold of constraints on a coordinate, over the largest, below which its mass does not scale penalties."""

SAME = 1e-11
"""Relative difference of coefficients that are the same at all places beside the start."""

LOOSE = 1e-12
"""share of the largest entry [1]: it is added to the diagonal of J J' of an assembly, so that rows that depend on each
other share a correction, and directions that rows hold less than some 1e-6 of what they hold others give way."""

GAINED = 0.9
"""ratio of residues [1]: another pass of a correction is made while the last one left less than this part."""

DEPENDENT = 1e-10
"""pivot of C C' over its largest entry [1]: a row whose pivot is below it is a combination of others, where coordinates
are many; LOOSE leaves such a row some 1e-12."""

TOLERANCE = 1e-12
"""Residue of an assembly, over the coordinates, at which it is closed."""

ROUGH = 1e-9
"""Residue of an assembly, over the coordinates, that is still accepted."""

MOST = 200
"""Gauss-Newton steps of an assembly at most."""

LONGEST_TURN = 0.3
"""[rad]: largest change of an angle in one of them."""

TRIES = 32
"""Places around the guess from which another assembly is looked for."""

RANKED = 8
"""Places around the start at which the rank of C is found."""

FEW_RANKED = 2
"""number of places [1]: the same where coordinates are many, along the motion."""

TORN = 0.3
"""Gap that a step may leave before it is closed, over the largest displacement in it."""

SHORTEST = 2.0**-14
"""Part of an internal step below which a motion that cannot go on is locked up."""

SAID = 6
"""Coordinates that an error lists at most."""

FIRST_STEP = 1e-3
"""[s]: the first step under error control."""
