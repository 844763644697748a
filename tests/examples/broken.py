"""Tasks with one fault each, at the line marked `# here`; `Sometimes` has whichever FAULT names."""

import numpy as np
from dm_control import mjcf
from glide import Glide

from ifo import Task

FAULT = ""


class WrongShape(Glide):
    def distance(self, state, contexts):  # here
        return np.linalg.norm(state.qpos - contexts["goal"], axis=1, keepdims=True)


class ListOfRewards(Glide):
    def expert_reward(self, state, action, contexts):  # here
        return [0.0] * len(action)


class NotFinite(Glide):
    def observe_expert(self, state, contexts):  # here
        return np.full((len(state.qpos), 3), np.nan)


class TypoInContexts(Glide):
    def distance(self, state, contexts):
        return np.linalg.norm(state.qpos - contexts["gaol"], axis=1)  # here


class TooFewArguments(Glide):
    def expert_reward(self, state, action):  # here
        return -np.square(action).sum(axis=1)


class NoCamera(Glide):
    camera = "wrist"  # build is Glide's


class TypoInMjcf(Glide):
    def build(self):
        root = super().build()
        root.worldbody.add("geom", name="extra", typ="sphere", size=(0.1,))  # here
        return root


class DoesNotCompile(Glide):
    def build(self):  # here
        root = super().build()
        root.worldbody.add("body", name="weightless").add("freejoint")
        return root


class BuildsText(Glide):
    def build(self):  # here
        return "<mujoco/>"


class NoMotor(Glide):
    def build(self):  # here
        return mjcf.RootElement()


class StartsElsewhere(Glide):
    def draw_states(self, rng, contexts):  # here
        return np.zeros((len(contexts["goal"]), 3)), np.zeros((len(contexts["goal"]), 2))


class NoSuchField(Glide):
    def model_fields(self, contexts):  # here
        return {"geom_colour": np.ones((len(contexts["goal"]), 3, 4))}


class HalfTheContexts(Glide):
    def draw_contexts(self, rng, n, distribution):  # here
        return {name: values[: n // 2] for name, values in super().draw_contexts(rng, n, distribution).items()}


class AtTheGoal(Glide):
    def distance(self, state, contexts):  # here
        return np.zeros(len(state.qpos))


class NoFactors(Glide):  # here
    default_factors = ("azimuth", "weather")


class Abstract(Task):  # here
    def build(self):
        return mjcf.RootElement()


class Sometimes(Glide):
    def broken(self, method):
        if method == FAULT:
            raise ZeroDivisionError("half of nothing")  # here

    def draw_contexts(self, rng, n, distribution):
        self.broken("draw_contexts")
        return super().draw_contexts(rng, n, distribution)

    def model_fields(self, contexts):
        self.broken("model_fields")
        return super().model_fields(contexts)

    def context_state(self, contexts):
        self.broken("context_state")
        return super().context_state(contexts)

    def draw_states(self, rng, contexts):
        self.broken("draw_states")
        return super().draw_states(rng, contexts)

    def observe(self, state):
        self.broken("observe")
        return super().observe(state)

    def observe_expert(self, state, contexts):
        self.broken("observe_expert")
        return super().observe_expert(state, contexts)

    def distance(self, state, contexts):
        self.broken("distance")
        return super().distance(state, contexts)
