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

import alfmu

TORQUE, STEP, HORIZON = 8.0, 0.05, 8.0  # 19.6 N.m hold it where its links are level
TRIALS, MOST = 64, 70

# %%
# The reward is the height of the links, and small for fast ones. Every trial begins near rest below.

environment = alfmu.VectorEnvironment(
    "four_bar",
    TRIALS,
    actions={"A.torque": (-TORQUE, TORQUE)},
    observations={"link1.angle": (-100.0, 100.0), "link1.angular_velocity": (-50.0, 50.0)},
    reward=lambda values, actions: np.sin(values["link1.angle"]) - 0.002 * values["link1.angular_velocity"] ** 2,
    step=STEP,
    horizon=HORIZON,
    start=lambda random, count: {"start.angle": -np.pi / 2 + random.uniform(-0.1, 0.1, count)},
    parameters={"start.angular_velocity": 0.0},
)

# %%
# The controller is a small network: sine and cosine of the angle, and its rate, by six neurons to one torque.


def torque(weights: np.ndarray, seen: np.ndarray) -> np.ndarray:
    angle, rate = seen.T
    features = np.stack([np.sin(angle), np.cos(angle), rate / 6, np.ones_like(rate)], axis=1)
    neurons = np.tanh(np.einsum("ki,kij->kj", features, weights[:, :24].reshape(-1, 4, 6)))
    return TORQUE * np.tanh((neurons * weights[:, 24:]).sum(axis=1))[:, None]


def trial(weights: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the reward of each trial, late ones counting more, and the angles over time."""
    seen, _ = environment.reset(seed=seed)
    total, angles = np.zeros(TRIALS), [seen[:, 0]]
    for time in np.arange(0, HORIZON - STEP / 2, STEP):
        seen, reward, *_ = environment.step(torque(weights, seen))
        total += reward * (1 + 2 * time / HORIZON)
        angles.append(seen[:, 0])
    return total, np.array(angles)


# %%
# The trainer is `CMA-ES <https://cma-es.github.io>`_ (``pip install cma``). Every ten generations its favourite has to
# swing up from as many new starts, and ends the training where it always does.


def upright(weights: np.ndarray, seed: int) -> tuple[float, np.ndarray]:
    """Return the share of starts from which a controller holds the links upright in the last second, and the angles."""
    _, angles = trial(np.tile(weights, (TRIALS, 1)), seed)
    return float((np.sin(angles[-round(1 / STEP) :]).min(axis=0) > 0.98).mean()), angles


def trained(seed: int) -> tuple[np.ndarray, list[float]]:
    """Return a controller, and the best reward of each generation."""
    trainer = cma.CMAEvolutionStrategy(np.zeros(30), 1.0, {"popsize": TRIALS, "seed": seed, "verbose": -9})
    best: list[float] = []
    while len(best) < MOST:
        asked = trainer.ask()
        rewards, _ = trial(np.array(asked), len(best))
        trainer.tell(asked, list(-rewards))
        best.append(rewards.max())
        if len(best) % 10 == 0 and upright(trainer.result.xfavorite, MOST + len(best))[0] == 1.0:
            break
    return trainer.result.xfavorite, best


for seed in range(1, 9):  # where a trainer ends beside the aim, another one begins
    controller, best = trained(seed)
    if len(best) < MOST:
        break

# %%
# **Check.** The controller swings up from other starts, too.

share, angles = upright(controller, 1000)
print(f"After {len(best)} generations, {100 * share:.0f} % of {TRIALS} new starts are upright in the last second.")

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
left.plot(best)
left.set(xlabel="generation", ylabel="best reward")
right.plot(np.arange(len(angles)) * STEP, np.sin(angles[:, ::6]))
right.set(xlabel="time [s]", ylabel="height of link 1 over its length", title="new starts")
