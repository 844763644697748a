"""Glide: a disc that two motors move over a table must come to rest on a red one. A whole task in one file."""

import numpy as np

from ifo import ContextDistribution, Contexts, State, Task
from ifo.scene import ModelFields, add_goal, add_table, draw_camera, make_scene


class Glide(Task):
    """Context: azimuth, the goal's place, and where the disc starts."""

    factors = ("azimuth", "elevation", "distance", "goal", "initial")
    default_factors = ("azimuth", "goal", "initial")

    def build(self):
        root = make_scene("glide")
        add_table(root, 1.2, rgba=(0.5, 0.5, 0.4, 1), contype=0, conaffinity=0)
        add_goal(root, 0.15, contype=0, conaffinity=0)
        body = root.worldbody.add("body", name="disc", pos=(0, 0, 0.1))
        for axis, direction in (("x", (1, 0, 0)), ("y", (0, 1, 0))):
            joint = body.add("joint", name=axis, type="slide", axis=direction, damping=1.0)
            root.actuator.add("motor", name=axis, joint=joint, gear=(2.0,), ctrllimited=True, ctrlrange=(-1, 1))
        body.add("geom", name="disc", type="cylinder", size=(0.15, 0.1), mass=0.5, rgba=(0.2, 0.3, 0.8, 1))
        return root

    def draw_contexts(self, rng: np.random.Generator, n: int, distribution: ContextDistribution) -> Contexts:
        vary = self.varied(distribution)
        camera = draw_camera(rng, n, distribution, vary)
        goal, start = rng.uniform(-0.9, -0.5, (n, 2)), rng.uniform(0.4, 0.6, (n, 2))
        return camera | {
            "goal": goal if "goal" in vary else np.full((n, 2), -0.7),
            "start": start if "initial" in vary else np.full((n, 2), 0.5),
        }

    def model_fields(self, contexts: Contexts) -> dict[str, np.ndarray]:
        return ModelFields(self.model, contexts).place("goal", contexts["goal"]).done()

    def context_state(self, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        return np.array(contexts["start"]), np.zeros_like(contexts["start"])

    def draw_states(self, rng: np.random.Generator, contexts: Contexts) -> tuple[np.ndarray, np.ndarray]:
        start = contexts["start"] + rng.uniform(-0.02, 0.02, contexts["start"].shape)
        return start, np.zeros_like(start)

    def observe(self, state: State) -> np.ndarray:
        phase = (state.time / self.horizon)[:, None]
        return np.concatenate([state.qpos, state.qvel, phase], axis=1).astype(np.float32)

    def observe_expert(self, state: State, contexts: Contexts) -> np.ndarray:
        return np.concatenate([self.observe(state), contexts["goal"] - state.qpos], axis=1).astype(np.float32)

    def expert_reward(self, state: State, action: np.ndarray, contexts: Contexts) -> np.ndarray:
        return -self.distance(state, contexts) - 0.01 * np.square(action).sum(axis=1)

    def distance(self, state: State, contexts: Contexts) -> np.ndarray:
        return np.linalg.norm(state.qpos - contexts["goal"], axis=1)
