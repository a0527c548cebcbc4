"""Batches of a mechanism as Gymnasium environments, to train controllers; they need `alfmu[gym]`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..catalogue.registry import load
from ..equations import Equations
from ..kernel import DEFAULT
from ..model.errors import InputError, needs
from ..model.mechanism import Mechanism
from ..runtime.batch import Batch
from ..runtime.pipeline import derive
from ..view.picture import draw, view_of
from ..view.shapes import geometry

with needs("an environment needs Gymnasium", "gym"):
    import gymnasium
    from gymnasium import spaces
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space

Numbers = NDArray[np.float64]

Values = Mapping[str, Numbers]
"""Variables by name, one value for each member."""

Bounds = Mapping[str, tuple[float, float]]
"""Variables by name, with their least and largest value."""


class VectorEnvironment(VectorEnv[Any, Any, Any]):
    """Many instances of a mechanism as one environment of Gymnasium.

    `actions` are inputs and `observations` variables with their bounds; inputs are held over each step of `step` [s].
    `reward(values, actions)` and `done(values)` work on arrays (count,) of all observations by name; without `done`
    every episode runs until it is truncated at `horizon` [s]. `start(random, count)` draws start values and parameters
    of members at the start of an episode; without it all members have the declared ones. Members whose episode has
    ended are reset at the next step (`AutoresetMode.NEXT_STEP`). A member whose step fails is truncated, with a reward
    of 0 and `infos["failed"]`.

    Further arguments are those of `alfmu.Batch`. Raises InputError if an action is not an input, or an observation not
    a variable.
    """

    def __init__(
        self,
        mechanism: str | Path | Mechanism | Equations,
        count: int,
        *,
        actions: Bounds,
        observations: Bounds,
        reward: Callable[[Values, Values], Numbers],
        step: float,
        horizon: float,
        done: Callable[[Values], NDArray[np.bool_]] | None = None,
        start: Callable[[np.random.Generator, int], Values] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        threads: int | None = None,
        kernel: str = DEFAULT,
        render_mode: str | None = None,
    ):
        if render_mode not in (None, "rgb_array"):
            raise InputError(f"there is no render_mode {render_mode!r}; use 'rgb_array', or none")
        if render_mode is not None and isinstance(mechanism, Equations):
            raise InputError(f"{mechanism.name}: equations have no pictures; give the mechanism, or no render_mode")
        declared = mechanism if isinstance(mechanism, Mechanism | Equations) else load(mechanism)
        self._shapes = geometry(declared, parameters) if render_mode and isinstance(declared, Mechanism) else None
        for what, made in (("reward", reward), ("done", done), ("start", start)):
            if not callable(made) and (made is not None or what == "reward"):
                raise InputError(f"{declared.name}: {what} is {made!r}; give a function")
        for what, seconds in (("step", step), ("horizon", horizon)):
            if not (isinstance(seconds, int | float | np.number) and 0 < seconds < math.inf):
                raise InputError(f"{declared.name}: {what} is {seconds!r}; it must be a finite time above zero [s]")
        spaces_of = [_box(declared.name, bounds) for bounds in (actions, observations)]
        e = declared if isinstance(declared, Equations) else derive(declared)
        given = {x.name for x in (*e.inputs, *e.parameters, *e.starts, *e.start_rates)}
        drawn = self._shapes.columns if self._shapes else []
        outputs = [name for name in dict.fromkeys([*observations, *drawn]) if name not in given]
        self.batch: Batch = Batch(e, count, parameters, outputs, threads, kernel)
        self.metadata: dict[str, Any] = {
            "autoreset_mode": AutoresetMode.NEXT_STEP,
            "render_modes": ["rgb_array"],
            "render_fps": max(1, round(1 / step)),
        }
        self.num_envs: int = count
        self.render_mode: str | None = render_mode
        self._step, self._horizon = step, horizon
        self._reward, self._done, self._start = reward, done, start
        self._actions, self._observations = list(actions), list(observations)
        inputs = [name for name in self._actions if name not in self.batch.inputs]
        if inputs:
            raise InputError(f"{self.batch.name}: {inputs[0]} is no input; use one of {', '.join(self.batch.inputs)}")
        for name in observations:
            self.batch.variable(name)
        self.single_action_space: spaces.Box = spaces_of[0]
        self.single_observation_space: spaces.Box = spaces_of[1]
        self.action_space: spaces.Space[Any] = batch_space(self.single_action_space, count)
        self.observation_space: spaces.Space[Any] = batch_space(self.single_observation_space, count)
        self._over = np.zeros(count, bool)
        self._extent: Numbers | None = None  # covers all pictures so far

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Let all members begin; or those of `options["reset_mask"]`, a mask (count,) of Booleans.

        All members draw from one generator, which several seeds start together.
        """
        if options is not None and not isinstance(options, dict):
            raise InputError(f"{self.batch.name}: options are {options!r}; give a dictionary")
        seeds = [] if seed is None else [x for x in np.atleast_1d(np.array(seed, object)).tolist() if x is not None]
        if any(isinstance(x, bool) or not isinstance(x, int | np.integer) or x < 0 for x in seeds):
            raise InputError(f"{self.batch.name}: seed is {seed!r}; give whole numbers of 0 or above")
        if seeds:
            self._np_random, self._np_random_seed = np.random.Generator(np.random.PCG64(seeds)), int(seeds[0])
        self._begin(self._mask("reset_mask", (options or {}).get("reset_mask", True)))
        return self._observed(), {}

    def _begin(self, members: NDArray[np.bool_]) -> None:
        """Draw start values until all of these members can be assembled, and assemble them."""
        left = members
        for _ in range(TRIES):
            self.batch.reset(left)
            drawn = self._start(self.np_random, int(left.sum())) if self._start else {}
            if not isinstance(drawn, Mapping):
                raise InputError(f"{self.batch.name}: start returned {drawn!r}; it must return values by name")
            for name, values in drawn.items():
                self.batch.set(name, values, left)
            left = self.batch.initialize(left)
            if not left.any():
                break
        else:
            member = int(np.argmax(left))
            raise InputError(f"{self.batch.name}: no start in {TRIES} tries: {self.batch.message(member)}")
        self._over = self._over & ~members

    def _observed(self) -> Numbers:
        return self.batch.get(*self._observations).reshape(self.num_envs, -1)

    def step(self, actions: Numbers) -> tuple[Numbers, Numbers, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Hold actions (count, inputs) over one step; actions out of bounds are clipped."""
        low, high = self.single_action_space.low, self.single_action_space.high
        given = np.asarray(actions)
        if given.shape != self.action_space.shape:
            raise InputError(
                f"{self.batch.name}: actions have the shape {given.shape}; they must be {self.action_space.shape}"
            )
        taken = np.clip(self.batch._given("actions", given, given.shape), low, high)
        begun = self._over
        on = ~begun
        if begun.any():
            self._begin(begun)
        self.batch.set_many(self._actions, taken[on], on)
        failed = self.batch.step(self._step, on)
        seen = self._observed()
        values = dict(zip(self._observations, seen.T, strict=True))
        found = self._reward(values, dict(zip(self._actions, taken.T, strict=True)))
        reward = np.where(on & ~failed, self.batch._given("reward", found, (self.num_envs,)), 0.0)
        if not np.isfinite(reward).all():
            member = int(np.argmin(np.isfinite(reward)))
            raise InputError(f"{self.batch.name}: reward is {reward[member]} for member {member}; it must be finite")
        over = self._mask("done", self._done(values) if self._done else False)
        done = on & ~failed & over
        late = on & (failed | (self.batch.time > self._horizon - 0.5 * self._step))
        self._over = done | late
        infos = {"failed": failed, "_failed": failed} if failed.any() else {}
        return seen, reward, done, late & ~done, infos

    def _mask(self, what: str, values: Any) -> NDArray[np.bool_]:
        """Return a mask (count,) that a user gave."""
        mask = self.batch._given(what, values, (self.num_envs,))
        if not np.isin(mask, (0.0, 1.0)).all():
            raise InputError(f"{self.batch.name}: {what} is {values!r}; it must be true or false for each member")
        return mask.astype(bool)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return pictures (height, width, 3) of all members, if the mode is "rgb_array"."""
        if self._shapes is None:
            return None
        names = self._shapes.columns
        placed = np.nan_to_num(self.batch.get(*names).reshape(self.num_envs, -1))
        self._extent = np.vstack([self._extent, placed]) if self._extent is not None else placed
        self._extent = np.vstack([self._extent.min(axis=0), self._extent.max(axis=0)])
        view = view_of(self._shapes, dict(zip(names, self._extent.T, strict=True)))
        rows = (dict(zip(names, row, strict=True)) for row in placed.tolist())
        return tuple(np.asarray(draw(self._shapes, row, view=view)) for row in rows)


class Environment(gymnasium.Env[Any, Any]):
    """One instance of a mechanism as an environment of Gymnasium; arguments are those of `VectorEnvironment`."""

    def __init__(self, mechanism: str | Path | Mechanism | Equations, **how: Any):
        self.many: VectorEnvironment = VectorEnvironment(mechanism, 1, **how)
        self.observation_space: spaces.Space[Any] = self.many.single_observation_space
        self.action_space: spaces.Space[Any] = self.many.single_action_space
        self.metadata: dict[str, Any] = {k: v for k, v in self.many.metadata.items() if k != "autoreset_mode"}
        self.render_mode: str | None = self.many.render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        seen, _ = self.many.reset(seed=seed)
        return seen[0], {}

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """Hold an action (inputs,) over one step."""
        if np.shape(action) != self.action_space.shape:
            what = f"an action has the shape {np.shape(action)}; it must be {self.action_space.shape}"
            raise InputError(f"{self.many.batch.name}: {what}")
        seen, reward, done, late, infos = self.many.step(np.asarray(action)[None])
        return seen[0], float(reward[0]), bool(done[0]), bool(late[0]), {"failed": True} if infos else {}

    def render(self) -> Any:
        """Return a picture (height, width, 3), if the mode is "rgb_array"."""
        pictures = self.many.render()
        return pictures and pictures[0]


def _box(name: str, bounds: Bounds) -> spaces.Box:
    """Return the space of variables with these bounds; raise InputError if one has none."""
    if not isinstance(bounds, Mapping):
        raise InputError(f"{name}: bounds are {bounds!r}; give least and largest values by name")
    for each, ends in bounds.items():
        if np.shape(ends) != (2,) or not ends[0] <= ends[1]:
            raise InputError(f"{name}: bounds of {each} are {ends!r}; give its least and largest value")
    low, high = np.array(list(bounds.values()), float).reshape(-1, 2).T
    return spaces.Box(low, high, dtype=np.float64)


TRIES = 20
"""Largest number of draws of start values until all members can be assembled."""
