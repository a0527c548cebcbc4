"""
A network in JAX drives a four-bar
==================================

A run of a mechanism as a function in JAX: its derivative backward is alfmu's adjoint, so that networks, losses and
optimisers of JAX work with it. Here a small network turns time into the torque that takes a four-bar from one place to
another, where it comes to rest. `pip install jax`, then `python docs/learning/network_jax.py`.
"""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

import alfmu
from alfmu.gradients import Function

jax.config.update("jax_enable_x64", True)

STOP, STEP = 1.0, 0.02
OUTPUTS = "link1.angle", "link1.angular_velocity"
BEGIN, WANTED = 0.6, 1.6  # rad
TIMES = np.linspace(0.0, STOP, round(STOP / STEP) + 1)
HOW = {"parameters": {"start.angle": BEGIN}, "communication_step": STEP, "stop_time": STOP}

# %%
# The run: torques at all communication points in, outputs at all of them out.


class Weighted(Function):
    """The sum of outputs times weights, which JAX asks the derivative of."""

    names = OUTPUTS

    def __init__(self, weights: np.ndarray):
        self.weights = np.asarray(weights)

    def weighed(self, times: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
        return float((self.weights * columns).sum()), self.weights


def simulated(torque: np.ndarray) -> np.ndarray:
    result = alfmu.simulate("four_bar", inputs={"A.torque": (TIMES, np.asarray(torque))}, outputs=OUTPUTS, **HOW)
    return np.stack([result[name] for name in OUTPUTS], axis=1)


def pulled(torque: np.ndarray, weights: np.ndarray) -> np.ndarray:
    inputs = {"A.torque": (TIMES, np.asarray(torque))}
    return alfmu.gradient("four_bar", Weighted(weights), [], inputs=inputs, **HOW).inputs["A.torque"]


@jax.custom_vjp
def run(torque: jax.Array) -> jax.Array:
    return jax.pure_callback(simulated, jax.ShapeDtypeStruct((len(TIMES), len(OUTPUTS)), jnp.float64), torque)


def backward(torque: jax.Array, weights: jax.Array) -> tuple[jax.Array]:
    return (jax.pure_callback(pulled, jax.ShapeDtypeStruct(torque.shape, jnp.float64), torque, weights),)


run.defvjp(lambda torque: (run(torque), torque), backward)

# %%
# The network, and its training by the gradients that JAX takes through the run.


def torque_of(weights: jax.Array) -> jax.Array:
    slope, shift, out = weights.reshape(3, -1)
    return jnp.tanh(jnp.outer(TIMES, slope) + shift) @ out


def loss(weights: jax.Array) -> jax.Array:
    angle, rate = run(torque_of(weights))[-1]
    return (angle - WANTED) ** 2 + 0.1 * rate**2


found = minimize(
    lambda x: tuple(np.asarray(y, float) for y in jax.value_and_grad(loss)(x)),
    np.random.default_rng(0).normal(0.0, 2.0, 3 * 12),
    method="BFGS",
    jac=True,
    options={"maxiter": 60, "gtol": 1e-6},
)
reached = np.asarray(run(torque_of(found.x)))[-1]
print(f"after {found.nit} steps it ends at {reached[0]:.5f} rad with {reached[1]:.5f} rad/s")
