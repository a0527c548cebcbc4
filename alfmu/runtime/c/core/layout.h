/* Numbers and messages common to alfmu's Python code and its runtime; generated from alfmu/kernel/tables.py. */

#ifndef ALFMU_LAYOUT_H
#define ALFMU_LAYOUT_H

#define SCENE_VERSION 33
#define GROSS 1e-06
#define TURN 3.141592653589793
#define CORRECTIONS 20
#define NOISE_FLOOR 25.0
#define LEAST_DISTANCE 0.011
#define BRANCH_MARGIN 0.00025
#define SMALL_PIVOT 0.03
#define REGULAR_PRODUCT 0.1
#define CONVERGENCE 7.0
#define FROZEN 1e-06
#define QUARTER 1.5707963267948966
#define DENSE 50
#define TIERS 3
#define CHOICES 3
#define FORMULATIONS 6
#define RESIDUAL_FORMULATION 0
#define CLASSIC_FORMULATION 1
#define PENALTY_FORMULATION 2
#define STIFFNESS_FORMULATION 3
#define BAUMGARTE_FORMULATION 4
#define DAE_FORMULATION 5
#define PROJECTED 1, 1, 0, 0, 0, 0
#define ZETA 1.0
#define OMEGA 10.0
#define LEAST_BEFORE 0.01
#define GIVEN_UP 1e-12
#define STEADY 1e-06
#define LOOSER 0.25
#define NOISE 8.0
#define UNBALANCED 0.001
#define ROUND_OFF 1.7763568394002505e-15
#define POLYNOMIAL 7
#define LIMITED 2.0
#define SHARED 3.0
#define JAM_PIVOT 0.001
#define JAM_SETTLED 1e-06
#define JUMP 1e-07
#define JUMPS "%s: %s jumps by %.6g %s at t = %.6g s, which a rigid mechanism cannot follow; give a law without jumps"
#define BROKEN "%s: at t = %.6g s %s, its rate or its acceleration is not finite; give a law with finite value, rate and acceleration, or other parameters"
#define IMPACT "%s: %s changes its rate by %.6g %s at t = %.6g s: an impact, whose impulse no output contains; round the law off there, if no impact is meant"
#define ASIDE -0.7, -0.1, 0.1, 0.7
#define LITTLE 0.0001
#define FAR_RATIO 2.0
#define RAISED 4.0
#define COARSE 1024.0
#define PATIENT 4
#define UNFINISHED 1e-07
#define REGULAR 0.001
#define PENALTY_RATIO 100000000.0
#define LIGHTEST 1e-05
#define LEAST_RATIO 10000.0
#define ALIKE 10.0
#define HARDLY 0.001
#define SAME 1e-11
#define LOOSE 1e-12
#define GAINED 0.9
#define DEPENDENT 1e-10
#define TOLERANCE 1e-12
#define ROUGH 1e-09
#define MOST 200
#define LONGEST_TURN 0.3
#define TRIES 32
#define AWAY 0.5
#define NEARER 0.8
#define BETWEEN 2.0
#define DISTINCT 0.1
#define MISSED 1.0471975511965976
#define MISSED_LENGTHS 3.0
#define LEAVING 0.1
#define BESIDE 0.03
#define SERVES 0.25
#define TOO_NEAR 0.25
#define RANKED 8
#define FEW_RANKED 2
#define LATER 0.1
#define MOST_RETURNS 30
#define SECOND_ORDER 0.01
#define TORN 0.3
#define SHORTEST 6.103515625e-05
#define SAID 6
#define FIRST_STEP 0.05
#define SHORTENED 0.2
#define REGAINED 1.1
#define EXACTER 1.1
#define LONGER 5.0
#define PATIENCE 100
#define MOST_PATIENCE 1600
#define STAYS_CAREFUL 8
#define UNSEEN 16
#define SEEN_FLOOR 0.1
#define STUCK 20
#define REST 1e-09
#define SLOW_STEP 0.02
#define MOVING 2.0
#define STOPPED 1e-13
#define NEARLY_STOPPED 0.01
#define EXCEEDED 1e-09
#define IDLE 1e-12
#define IDLER 100.0
#define SHARING_ROUNDS 200
#define STEADY_SHARE 1e-09
#define NO_ROOM 1e-07
#define SLIDING_ROUNDS 3
#define SEARCHED 60
#define RIGHT_THERE 0.0009765625
#define SEEN_BETWEEN 16
#define LOOKED_INTO 5e-06
#define AT_ONCE 8
#define JAM_AHEAD 5e-05
#define JAM_SHORTER 4.0
#define ONE_STEP 1e-09
#define EARLIEST 0.05
#define LEFT_TO_RK4 16.0
#define LAST_DIGITS 4.0

enum {
    SETTINGS_ALPHA, SETTINGS_TOLERANCE, SETTINGS_FREEDOM, SETTINGS_MASSES, SETTINGS_REGULAR, SETTINGS_NOTHING,
    SETTINGS_LEAST_DISTANCE, SETTINGS_CONTINUES, SETTINGS_RELATIVE, SETTINGS_ABSOLUTE, SETTINGS_ABSOLUTE_LENGTH,
    SETTINGS_INVERSE_LENGTH, SETTINGS_INVERSE_LOOP, SETTINGS_SHORT, SETTINGS_BESIDE, SETTINGS_STIFF, SETTINGS_ALONG,
    SETTINGS_AGREED, SETTINGS
};

enum {
    CONTROL_STEP_SIZE, CONTROL_TIER, CONTROL_METHOD, CONTROL
};

enum {
    TALLY_QUICK, TALLY_CAREFUL, TALLY_BRANCH, TALLY_LIMITS, TALLY_SHORT_TRIES, TALLY_SHORT_BESIDE, TALLY_SHORT_LIMITS,
    TALLY_STIFF_TRIES, TALLY_REGULAR_TRIES, TALLY_TRIES, TALLY_CAREFUL_TRIES, TALLY_COVERED, TALLY_REFUSED,
    TALLY_BESIDE, TALLY_BESIDE_LIMITS, TALLY
};

enum {
    PACE_DT, PACE_BEFORE, PACE_REFUSED, PACE_FIXED, PACE_END, PACE_LAST, PACE_ACCEPTED, PACE_FLOOR, PACE_CAREFUL,
    PACE_SHORT, PACE_OTHER_DT, PACE_OTHER_BEFORE, PACE_OTHER_REFUSED, PACE_STIFF, PACE_SINCE, PACE_PATIENCE, PACE
};

enum {
    SEEN_ACCELERATION_ERROR, SEEN_NEAR, SEEN_TROUBLE, SEEN
};

enum {
    WATCH_CHANGE, WATCH_SIZE, WATCH_PIVOT, WATCH_NEAR, WATCH_MARGIN, WATCH
};

#define SCENE_COUNTS(X) \
    X(parameters) X(choices) X(inputs) X(switches) X(outputs) X(own) X(starts) X(compliances) X(solver) X(held) \
    X(frictions) X(impulses) X(event_count) X(n) X(l) X(angles) X(counted) X(readings) X(ties) X(peaks) \
    X(break_count)

#define SCENE_REFERENCES(X) \
    X(step_size) X(penalty) X(tolerance) X(max_iterations) X(relative_tolerance) X(absolute_tolerance) \
    X(input_order)

#define SCENE_PROGRAMS(X) \
    X(quick) X(careful) X(instant) X(limit) X(move) X(close) X(impact) X(reach) X(beside) X(branch_step) \
    X(method_step) X(method_careful) X(short_step) X(stiff_step) X(regular_step) X(short_beside) X(instant_quick) \
    X(instant_patient) X(limit_patient) X(gripping)

#define SCENE_REST(X) \
    X(formulation) X(branch) X(continues) X(method_choice) X(freedom) X(brakes) X(weighted) X(balances) \
    X(same_tiers) X(careful_iterations) X(monitor_position) X(monitor_velocity) X(monitor_energy) \
    X(monitor_iterations) X(monitor_step_error) X(method) X(rk4_choice) X(automatic) X(reuses) X(implicit) \
    X(method_cost) X(short_cost) X(z) X(after) X(begin) X(u) X(p) X(k) X(dt) X(control) X(tally) X(pace) X(past) \
    X(seen) X(past_size) X(seen_size) X(time) X(work) X(trouble) X(change) X(near) X(size) X(exchange) X(workspace) \
    X(most) X(patient) X(slopes) X(within) X(q) X(v) X(struck) X(lost) X(again) X(stabilisation) X(projects) \
    X(of_least_norm) X(on_branch) X(onward) X(by_classic) X(by_penalty) X(by_stiffness) X(by_baumgarte) X(by_dae) \
    X(impulse) X(watch1) X(watch2) X(watch3) X(watch4) X(q1) X(q2) X(q3) X(q4) X(v1) X(v2) X(v3) X(v4) X(watch0) \
    X(read_watch) X(grip) X(dynamics) X(constraints) X(energy) X(closure) X(guesses) X(displacements) X(pivots) \
    X(irregular) X(sliding) X(laws) X(breaks) X(state_rates) X(stops) X(place) X(bring) X(settle) X(margin)

#define SCENE_REALS(X) \
    X(no_slope) X(fading) X(farthest) X(share) X(exponent) X(short_share) X(short_exponent) X(stiff_share) \
    X(stiff_exponent) X(beside_share) X(beside_exponent)

#define SCENE_OTHERS(X) \
    X(by_classic) X(by_penalty) X(by_stiffness) X(by_baumgarte) X(by_dae)

#define SCENE_NUMBERS(X) SCENE_COUNTS(X) SCENE_REFERENCES(X) SCENE_REST(X) SCENE_PROGRAMS(X)

#endif
