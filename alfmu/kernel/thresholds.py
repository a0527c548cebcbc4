"""Numbers by which a run is judged while time passes; the C runtime has them from here (`layout.h`).

`docs/singular.md` has what half and twice each of them would do. S1 to S5 are steps of that page.
"""

import math

ASIDE = (-0.7, -0.1, 0.1, 0.7)
"""displacement along the motion [rad or m]: places beside the start at which S1 calibrates; large enough that one of
them is regular where the start is singular, and of two sizes, as one may be singular too."""

LITTLE = 1e-4
"""displacement of lengths [m]: enough to tell which coefficients of C are constant, and so little that no loop opens
far."""

FAR_RATIO = 2.0
"""logarithm of a ratio of pivots [1]: a place beside the start whose pivots contributed by masses are larger by this is
not typical, as coordinates that hardly describe the motion have larger ones."""

COARSE = 1024.0
"""parts of 1 [1]: the logarithm of a product of pivots is rounded to them, so that round-off does not move what S1
finds, and all processors find the same."""

PATIENT = 4
"""factor to the most multiplier iterations [1]: where the motion may end at a singular position, each
iteration gains little."""

UNFINISHED = 1e-7
"""last change of accelerations over them [1]: a step or a reading with a given penalty is refused where the multiplier
iteration ends above it; what it ends with above `solver.tolerance` is counted and told."""

REGULAR = 1e-3
"""size of a combination of constraints over the largest [1]: S5 freezes the rank only at places where all independent
combinations are larger; at a singular position the rank of the place before is kept."""

PENALTY_RATIO = 1e8
"""penalty over the largest mass that the rows hold [1]: the residual form of (8) needs three iterations to
round-off at it, and four at 1e6 and at 1e10 (`alfmu report all --profile paper`)."""

ALIKE = 10.0
"""ratio of the units of rows [1]: rows whose units are not known and differ by less share one."""

HARDLY = 1e-3
"""hold of constraints on a coordinate over the largest hold [1]: the mass of a coordinate that is held less does not
scale penalties, as no row has to carry it, and coefficients that are less in a row tell nothing of its unit."""

SAME = 1e-11
"""relative difference of coefficients [1]: coefficients that differ by less at all places beside the start are
constant, and those that are less than this of the largest (and of 1) are zero; round-off leaves 1e-15 of them."""

LOOSE = 1e-12
"""share of the largest entry [1]: it is added to the diagonal of J J' of an assembly, so that rows that depend on each
other share a correction, and directions that rows hold less than some 1e-6 of what they hold others give way."""

GAINED = 0.9
"""ratio of residues [1]: another pass of a correction is made while the last one left less than this part."""

DEPENDENT = 1e-10
"""pivot of C C' over its largest entry [1]: a row whose pivot is below it is a combination of others, where coordinates
are many; LOOSE leaves such a row some 1e-12."""

TOLERANCE = 1e-12
"""gap over the coordinates [1]: an assembly is closed below it; some hundred times round-off."""

ROUGH = 1e-9
"""gap over the coordinates [1]: an assembly that Gauss-Newton steps cannot close further is accepted below it,
as near a singular position, where a gap is the square of an angle."""

MOST = 200
"""number of Gauss-Newton steps [1]: an assembly takes some ten; near a singular position each gains a factor of two."""

LONGEST_TURN = 0.3
"""change of an angle in a Gauss-Newton step [rad]: loops are linear enough over it that the assembly found is the one
nearest to the guess."""

TRIES = 32
"""number of places [1]: another assembly is looked for from so many places around the guess before the start is
refused."""

AWAY = 0.5
"""way from the guess [m or rad]: an assembly that ends farther from it than this is compared with others around it."""

NEARER = 0.8
"""ratio of ways from the guess [1]: the start warns of an assembly whose way is less than this part of its own."""

BETWEEN = 2.0
"""ratio of ways from the guess [1]: the start warns of another assembly whose way is less than so many times its own,
as the guess is then beyond a third of the way to it; so it is where one bar of a pantograph is guessed half a turn
off."""

DISTINCT = 0.1
"""way between assemblies [m or rad]: nearer ones are the same, found less exactly; an assembly that is found again from
so far beside it is determined by the start values."""

MISSED = math.pi / 3
"""difference of an angle from its guess [rad]: the start names angles that end farther from it, by 60 degrees; guesses
that a person takes from a drawing are nearer."""

MISSED_LENGTHS = 3.0
"""difference of a length from its guess over the larger of the guess and the mechanism's length [1]: lengths may
be long ways on small wheels."""

DIRECTION = 1e-40
"""velocity [m/s or rad/s]: a motion that begins at rest near a singular position begins with it, as the places of a
limit lie along the velocity; all that it moves, and its energy, are nothing."""

RANKED = 8
"""number of places [1]: S1 finds the rank of C at so many places around the start, as the start itself may be singular;
with four the five-bar, which starts at a singular position, stops."""

FEW_RANKED = 2
"""number of places [1]: the same where coordinates are many, along the motion."""

LATER = 0.1
"""time [s]: where places depend on time, those around the start are this much later or earlier, a tenth, a hundredth
and a thousandth of it too, as laws are fast or slow; the start may be singular whatever the coordinates."""

MOST_RETURNS = 30
"""number of corrections [1]: so many bring a displaced place back to constraints that hold to second order alone, whose
gap each of them halves."""

SECOND_ORDER = 0.01
"""way back over a displacement [1]: a motion along which constraints lead back by more, however short it is, is
none."""

TORN = 0.3
"""gap that a step leaves over its largest displacement [1]: a step that opens more than this is refused; corrections
(10) would lead to another assembly."""

SHORTEST = 2.0**-14
"""part of an internal step [1]: a motion that does not go on by steps of this length is locked up."""

SAID = 6
"""number of coordinates [1]: an error lists so many at most, which fit into one line."""

FIRST_STEP = 1e-3
"""step [s]: the first one under error control, which then corrects it."""

SHORTENED = 0.2
"""ratio of steps [1]: a step under error control that cannot be judged is tried again at this part of its length."""

REGAINED = 1.1
"""ratio of steps [1]: what `auto` takes for the step of the method that it does not use grows by it with each step of
the other one, as conditions change; at 1.2 a third more tries of short steps are refused, below 1.1 the five-bar takes
long steps for 0.2 s after a singular position."""

EXACTER = 1.1
"""ratio of evaluations [1]: `auto` makes short steps, of order 5, where they take so many times fewer than those of its
method, of order 8: two short ones for one of it save a thirteenth and have ten times its error."""

LONGER = 5.0
"""ratio of steps [1]: `auto` goes over to implicit steps where one so many times as long as the explicit ones keeps the
tolerance, as stability alone keeps these short."""

PATIENCE = 100
"""number of steps [1]: after so many `auto` tries whether implicit ones can be longer, or explicit ones are enough."""

MOST_PATIENCE = 1600
"""number of steps [1]: after each such try in vain it waits twice as long, up to this."""

STAYS_CAREFUL = 8
"""number of tries [1]: so many are made with careful iterations after one that needed them."""

UNSEEN = 16
"""number of tries [1]: after so many without careful iterations one is made with them, to see what round-off leaves."""

SEEN_FLOOR = 0.1
"""error that round-off leaves over the tolerance [1]: careful tries are kept to where it is larger."""

STUCK = 20
"""number of tries [1]: no motion goes on where so many cannot be judged near a singular position before the step is
covered that was wanted at the first of them."""

REST = 1e-9
"""rate [rad/s or m/s]: a joint with dry friction that is slower rests; projections leave 1e-15 of velocities near 1."""

MOVING = 2.0
"""ratio of rates [1]: a joint that others, or a motion, held at rest moves from so many REST on, so that its direction
is beyond doubt."""

STOPPED = 1e-13
"""rate over the largest in the step [1]: so near zero the rate of a joint is brought where it stops or turns round."""

NEARLY_STOPPED = 0.01
"""rate over REST [1]: no nearer is it brought to zero, as it rests then."""

EXCEEDED = 1e-9
"""excess of a multiplier over its limit [1]: the joint lets go there, so that what decides is beyond doubt."""

IDLE = 1e-12
"""second rate over the largest without friction [1]: a joint that rests is held where it has no more; in rad/s^2 or
m/s^2 where the largest is below 1."""

IDLER = 100.0
"""ratio of second rates [1]: a joint that began to slide, and has less than so many IDLE as others hold it, rests."""

SHARING_ROUNDS = 200
"""number of rounds [1]: in so many the joints at rest take the shares of their limits that hold them; half of them are
as good for five joints."""

STEADY_SHARE = 1e-9
"""change of a share [1]: no other round is made where all change by less."""

NO_ROOM = 1e-7
"""room of a joint over its limit [1]: one with less cannot stick, as the next change of its load would let it go."""

SLIDING_ROUNDS = 3
"""number of rounds for each joint [1]: so often joints that rest are asked again as one more of them slides."""

SEARCHED = 60
"""number of tries [1]: so often a step is made again that ends where a joint stops or lets go; a few events take more
than 30."""

RIGHT_THERE = 1.0 / 1024
"""part of a step [1]: an event of a joint that has only begun to move is looked for so far behind its begin first."""

SEEN_BETWEEN = 16
"""number of places [1]: at so many a rate within a step is looked at, by the cubic through both ends."""

LOOKED_INTO = 1e-7
"""step [s]: shorter ones are not looked into, as no joint turns round twice in them."""

AT_ONCE = 8
"""number of events [1]: after so many at one instant no way to go on is found."""

JAM_AHEAD = 1e-6
"""time [s]: where a step fails, a jam is looked for ahead, from an internal step down to this."""

JAM_SHORTER = 4.0
"""ratio of times [1]: each is that much shorter than the one before."""

ONE_STEP = 1e-9
"""excess of a step [1]: what is left of a step up to an event is made in one where it is longer by no more."""

EARLIEST = 1e-3
"""time [s]: instants before this are told apart as those at this time, by its last digits."""

LEFT_TO_RK4 = 16.0
"""ratio of steps [1]: what is left of a step up to an event or a communication point, and is shorter than so many of
the shortest steps under error control, is made by RK4."""

LAST_DIGITS = 4.0
"""number of last digits of the time [1]: what is left and is no longer than that is made by RK4, too."""
