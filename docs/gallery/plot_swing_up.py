"""
A four-bar learns to swing up
=============================

A parallel four-bar hangs below its base. Its motor is too weak to lift it, so a controller has to rock it until it
swings up over the singular positions where all links are in line, and to hold it there. A trainer finds the controller
from 64 trials at a time, which are members of one `alfmu.VectorEnvironment`.
"""

import cma
import matplotlib.pyplot as plt
import numpy as np

from alfmu import Experiment, Mechanism, VectorEnvironment, simulate
from alfmu.view.picture import animate

TORQUE, STEP, HORIZON = 8.0, 0.05, 8.0  # 19.6 N.m hold it where its links are level
TRIALS, MOST = 64, 70


def swing_up() -> Mechanism:
    m = Mechanism("swing_up", "A four-bar that learns to swing up", experiment=Experiment(HORIZON, STEP))
    guesses = {"angle": -np.pi / 2, "bend": np.pi / 2, "rocking": -np.pi / 2}
    angle, bend, rocking = (m.coordinate(k, "rad", start=x, independent=k == "angle") for k, x in guesses.items())
    crank, coupler, rocker = (m.bar(name, mass=1.0, length=1.0) for name in ("crank", "coupler", "rocker"))
    hinge = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=angle)
    m.revolute("B", crank.end, coupler.start, coordinate=bend)
    m.revolute("C", coupler.end, rocker.end)
    m.revolute("D", m.ground.at(1, 0), rocker.start, coordinate=rocking)
    m.drive(hinge, m.input("A.torque", "N.m"))
    m.gravity(0, -9.81)
    return m


# %%
# The reward is the height of the links, and small for fast ones. Every trial begins near rest below.

mechanism = swing_up()
environment = VectorEnvironment(
    mechanism,
    TRIALS,
    actions={"A.torque": (-TORQUE, TORQUE)},
    observations={"crank.angle": (-100.0, 100.0), "crank.angular_velocity": (-50.0, 50.0)},
    reward=lambda seen, _: np.sin(seen["crank.angle"]) - 0.002 * seen["crank.angular_velocity"] ** 2,
    step=STEP,
    horizon=HORIZON,
    start=lambda random, count: {"start.angle": -np.pi / 2 + random.uniform(-0.1, 0.1, count)},
)

# %%
# The controller is a small network: sine and cosine of the angle, and its rate, by six neurons to one torque.


def trial(weights: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the reward of each trial, late ones counting more; angles and torques over time."""
    seen, _ = environment.reset(seed=seed)
    total, angles, torques = np.zeros(TRIALS), [], []
    for time in np.arange(0, HORIZON - STEP / 2, STEP):
        angle, rate = seen.T
        features = np.stack([np.sin(angle), np.cos(angle), rate / 6, np.ones_like(rate)], axis=1)
        neurons = np.tanh(np.einsum("ki,kij->kj", features, weights[:, :24].reshape(-1, 4, 6)))
        torques.append(TORQUE * np.tanh((neurons * weights[:, 24:]).sum(axis=1)))
        seen, reward, *_ = environment.step(torques[-1][:, None])
        total += reward * (1 + 2 * time / HORIZON)
        angles.append(seen[:, 0])
    return total, np.array(angles), np.array(torques)


# %%
# The trainer is `CMA-ES <https://cma-es.github.io>`_ (``pip install cma``). Every ten generations its favourite has to
# swing up from as many new starts, and ends the training where it always does.


def upright(angles: np.ndarray) -> float:
    """Return the share of trials that hold the links upright in the last second."""
    return float((np.sin(angles[-round(1 / STEP) :]).min(axis=0) > 0.98).mean())


def trained(seed: int) -> tuple[np.ndarray, list[float]]:
    """Return a controller, the same for all trials, and the best reward of each generation."""
    trainer = cma.CMAEvolutionStrategy(np.zeros(30), 1.0, {"popsize": TRIALS, "seed": seed, "verbose": -9})
    best: list[float] = []
    favourite = np.zeros((TRIALS, 30))
    while len(best) < MOST:
        asked = trainer.ask()
        rewards = trial(np.array(asked), len(best))[0]
        trainer.tell(asked, list(-rewards))
        best.append(rewards.max())
        favourite = np.tile(trainer.result.xfavorite, (TRIALS, 1))
        if len(best) % 10 == 0 and upright(trial(favourite, MOST + len(best))[1]) == 1.0:
            break
    return favourite, best


seed = 1
controller, best = trained(seed)
while len(best) == MOST and seed < 8:  # where a trainer ends beside the aim, another one begins
    seed += 1
    controller, best = trained(seed)

# %%
# **Check.** The controller swings up from other starts, too.

_, angles, torques = trial(controller, 1000)
share = upright(angles)
print(f"After {len(best)} generations, {100 * share:.0f} % of {TRIALS} new starts are upright in the last second.")

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
left.plot(best)
left.set(xlabel="generation", ylabel="best reward")
times = np.arange(len(torques)) * STEP
right.plot(times + STEP, np.sin(angles[:, ::6]))
right.set(xlabel="time [s]", ylabel="height of the crank over its length", title="new starts")

# %%
# One of them again, by its torques over time.

start = {"start.angle": environment.batch.get("start.angle")[0]}
result = simulate(mechanism, inputs={"A.torque": (times, torques[:, 0])}, parameters=start)
animate(mechanism, result, "swing_up.gif", fps=15, speed=1)
