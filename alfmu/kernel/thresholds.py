"""Thresholds for decisions during a run, also for the C runtime (`layout.h`).

`docs/singular.md` has the effect of half and twice each of them. S1 to S5 are steps of that page.
"""

import math

ASIDE = (-0.7, -0.1, 0.1, 0.7)
"""displacement along the motion [rad or m]: S1 calibrates at these distances from the start; if the start is singular,
they are large enough for one of the positions to be regular, and of two sizes, as one position may be singular, too."""

LITTLE = 1e-4
"""displacement of lengths [m]: enough to detect which coefficients of C are constant, while loops open little."""

FAR_RATIO = 2.0
"""logarithm of a ratio of pivots [1]: a position near the start whose pivots contributed by masses are larger by this
is discarded as atypical, since coordinates hardly describe the motion there."""

RAISED = 4.0
"""pivot contributed by masses over the largest mass [1]: a typical pivot above it may belong to a coordinate that
hardly describes the motion; constraints then hold another one by a small coefficient, which makes its pivot too small
by the same factor."""

COARSE = 1024.0
"""number of parts of 1 [1]: logarithms of products of pivots are rounded to such parts, so that the result of S1
depends neither on round-off nor on the processor."""

PATIENT = 4
"""factor on the limit of multiplier iterations [1]: where the motion may end at a singular position, each iteration
gains little."""

UNFINISHED = 1e-7
"""relative last change of accelerations [1]: a step or an evaluation with a given penalty is rejected if the multiplier
iteration ends above it; a change above `solver.tolerance` is counted and reported."""

REGULAR = 1e-3
"""size of a combination of constraints over the largest [1]: S5 freezes the rank only at positions where all
independent combinations are larger; at a singular position the previous rank is kept."""

PENALTY_RATIO = 1e8
"""penalty over the largest mass that the rows constrain [1]: at this ratio the residual form of (8) needs three
iterations to round-off, and four at 1e6 and at 1e10 (`alfmu report --profile paper`)."""

LIGHTEST = 1e-5
"""mass of the lightest motion over the largest mass that the rows constrain [1]: below it, the default penalty is
reduced in proportion, so that round-off of constraints stays 2e-3 of that mass."""

LEAST_RATIO = 1e4
"""least penalty over the largest mass that the rows constrain [1]: masses lighter still are below round-off."""

ALIKE = 10.0
"""ratio of the units of rows [1]: rows with unknown units share one if they differ by less."""

HARDLY = 1e-3
"""effect of constraints on a coordinate over the largest effect [1]: masses of coordinates below it do not scale
penalties, as no row has to carry them, and coefficients below it do not determine the unit of a row."""

SAME = 1e-11
"""relative difference of coefficients [1]: coefficients that differ by less at all positions near the start are
constant, and those below this share of the largest (and of 1) are zero; round-off leaves 1e-15."""

LOOSE = 1e-12
"""share of the largest entry [1]: it is added to the diagonal of J J' of an assembly, so that dependent rows share a
correction, and directions constrained by less than some 1e-6 of the others are released."""

GAINED = 0.9
"""ratio of residuals [1]: a correction is repeated while a pass leaves less than this share of the residual."""

DEPENDENT = 1e-10
"""pivot of C C' over its largest entry [1]: a row with a smaller pivot depends on others, if there are many
coordinates; LOOSE leaves such a row some 1e-12."""

TOLERANCE = 1e-12
"""gap over the coordinates [1]: an assembly is closed below it; some hundred times round-off."""

ROUGH = 1e-9
"""gap over the coordinates [1]: below it an assembly is accepted that Gauss-Newton steps cannot close further, as near
a singular position, where a gap is the square of an angle."""

MOST = 200
"""most Gauss-Newton steps [1]: an assembly takes some ten; near a singular position each gains a factor of two."""

LONGEST_TURN = 0.3
"""change of an angle in a Gauss-Newton step [rad]: short enough for linearised loops to lead to the assembly nearest to
the guess."""

TRIES = 32
"""number of positions [1]: before the start fails, another assembly is searched from this many positions around the
guess."""

AWAY = 0.5
"""distance from the guess [m or rad]: an assembly farther from it is compared with others around it."""

NEARER = 0.8
"""ratio of distances from the guess [1]: the start warns of an assembly whose distance is less than this share of its
own."""

BETWEEN = 2.0
"""ratio of distances from the guess [1]: the start warns of another assembly within this multiple of its own distance,
as the guess is then beyond a third of the distance to it, for example if one bar of a pantograph is guessed half a turn
off."""

DISTINCT = 0.1
"""distance between assemblies [m or rad]: closer ones are the same assembly, computed less exactly; if the loops close
there again from this distance, the start values determine the assembly."""

MISSED = math.pi / 3
"""difference of an angle from its guess [rad]: the start reports angles that differ by more, 60 degrees; guesses from a
drawing are closer."""

MISSED_LENGTHS = 3.0
"""difference of a length from its guess over the larger of the guess and the mechanism's length [1]: the start reports
larger differences; the bound is wide, as a length may be the long travel of a small wheel."""

LEAVING = 0.1
"""displacement [rad or m]: a direction leads away from a singular start if at this distance the margin is
distinguishable from that of the start."""

BESIDE = 0.03
"""displacement [rad or m]: if a motion starts at rest in a singular position, its direction is that between two
positions at this distance on either side, once closing the constraints has put them on one of the motions that cross
there."""

SERVES = 0.25
"""change of the distance from a singular position over the motion of the fastest coordinate [1]: if it is smaller along
the motion, limits are taken along the direction in which the distance changes most instead."""

TOO_NEAR = 0.25
"""margin over BRANCH_MARGIN [1]: closer to a singular position, limits keep the direction of the previous step."""

RANKED = 8
"""number of positions [1]: S1 computes the rank of C at this many positions around the start, as the start itself may
be singular; with four the five-bar, which starts at a singular position, stops."""

FEW_RANKED = 2
"""number of positions [1]: S1 uses this many, along the motion, if there are many coordinates."""

LATER = 0.1
"""time [s]: if positions depend on time, those around the start are earlier or later by this, a tenth, a hundredth and
a thousandth of it, as laws may be fast or slow; the start may be singular for any coordinates."""

MOST_RETURNS = 30
"""most corrections [1]: this many return a displaced position to constraints that hold only to second order, whose gap
each of them halves."""

SECOND_ORDER = 0.01
"""correction over a displacement [1]: a direction along which the constraints require a larger one, however short the
displacement, is not a motion."""

TORN = 0.3
"""gap after a step over its largest displacement [1]: a step with a larger one is rejected, as corrections (10) would
lead to another assembly."""

SHORTEST = 2.0**-14
"""share of an internal step [1]: a motion that does not continue with steps of this length is locked."""

SAID = 6
"""most coordinates in an error [1]: they fit into one line."""

FIRST_STEP = 0.05
"""step over solver.step_size [1]: the first one under error control, which then corrects it."""

SHORTENED = 0.2
"""ratio of steps [1]: a step under error control that cannot be judged is repeated at this share of its length."""

REGAINED = 1.1
"""ratio of steps [1]: the step that `auto` assumes for the unused integrator grows by it with each step of the other
one, as conditions change; at 1.2 a third more attempts of short steps are rejected, below 1.1 the five-bar takes long
steps for 0.2 s after a singular position."""

EXACTER = 1.1
"""ratio of evaluations [1]: `auto` makes short steps, of order 5, if they need fewer evaluations than steps of order 8
by this factor: two short ones for one of them save a thirteenth and have ten times its error."""

LONGER = 5.0
"""ratio of steps [1]: `auto` switches to implicit steps if one this many times as long as the explicit ones meets the
tolerance, as only stability keeps these short."""

PATIENCE = 100
"""number of steps [1]: after this many `auto` tests whether implicit ones can be longer, or explicit ones suffice."""

MOST_PATIENCE = 1600
"""number of steps [1]: the interval doubles after each such test without success, up to this."""

STAYS_CAREFUL = 8
"""number of attempts [1]: once an attempt needed careful iterations, this many following ones use them, too."""

UNSEEN = 16
"""number of attempts [1]: after this many without careful iterations one is made with them, to measure round-off."""

SEEN_FLOOR = 0.1
"""round-off in the error over the tolerance [1]: careful attempts continue if it is larger."""

STUCK = 20
"""number of attempts [1]: no motion continues from a singular position if the errors of this many steps near it cannot
be judged, within the length proposed for the first of them."""

REST = 1e-9
"""rate [rad/s or m/s]: a joint with dry friction is at rest below it; projections leave 1e-15 of velocities near 1."""

SLOW_STEP = 0.02
"""step [s]: if solver.step_size is longer, the motion is assumed slower, and REST and the least IDLE are smaller by the
same factor; a shorter one may only serve accuracy and changes nothing."""

MOVING = 2.0
"""ratio of rates [1]: a joint that others, or a motion, held at rest counts as moving above this multiple of REST, so
that its direction is certain."""

STOPPED = 1e-13
"""rate over the largest in the step [1]: the end of a step where a joint stops or reverses is refined until its rate is
below this."""

NEARLY_STOPPED = 0.01
"""rate over REST [1]: the refinement ends below it, as the joint is then at rest."""

EXCEEDED = 1e-9
"""excess of a multiplier over its limit [1]: the joint is released at this excess, so that the decision is certain."""

IDLE = 1e-12
"""acceleration of a joint over the largest one without friction [1]: a joint at rest with a smaller one sticks; in
rad/s^2 or m/s^2 if the largest is below 1."""

IDLER = 100.0
"""ratio of accelerations [1]: a joint that began to slide is at rest if others hold it to less than this multiple of
IDLE."""

SHARING_ROUNDS = 200
"""most rounds [1]: joints at rest adjust the shares of their limits that hold them; half as many suffice for five
joints."""

STEADY_SHARE = 1e-9
"""change of a share [1]: the rounds end when all change by less."""

NO_ROOM = 1e-7
"""margin of a joint to its limit, over the limit [1]: a joint with less cannot stick, as the next change of its load
would release it."""

SLIDING_ROUNDS = 3
"""rounds for each joint [1]: joints at rest are checked again this often as one more of them slides."""

SEARCHED = 60
"""most attempts [1]: a step that ends where a joint stops or is released is repeated this often; a few events need more
than 30."""

RIGHT_THERE = 1.0 / 1024
"""share of a step [1]: an event of a joint that has just begun to move is searched first this far from the start of the
step."""

SEEN_BETWEEN = 16
"""number of instants [1]: a rate within a step is evaluated at this many, by the cubic through both ends."""

LOOKED_INTO = 5e-6
"""step over solver.step_size [1]: shorter ones are not searched, as no joint reverses twice in them."""

AT_ONCE = 8
"""number of events [1]: after this many at one instant no continuation exists."""

JAM_AHEAD = 5e-5
"""time over solver.step_size [1]: after a failed step, a jam is searched ahead, from an internal step down to this."""

JAM_SHORTER = 4.0
"""ratio of times [1]: each time ahead at which a jam is searched is shorter than the previous one by this factor."""

ONE_STEP = 1e-9
"""share of a step [1]: the rest of a step up to an event is made as one step if it is longer by no more than this."""

EARLIEST = 0.05
"""time over solver.step_size [1]: earlier instants are distinguished by the last digits of this time."""

LEFT_TO_RK4 = 16.0
"""ratio of steps [1]: RK4 makes the rest of a step up to an event or a communication point if it is shorter than this
many of the shortest steps under error control."""

LAST_DIGITS = 4.0
"""number of last digits of the time [1]: RK4 also makes a rest of a step that is no longer than this."""
