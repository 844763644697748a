"""PPO in one file, after CleanRL's ppo_continuous_action.py, learns from a translation into a Gymnasium environment.

    python examples/cleanrl_ppo.py runs/reacher.translation.h5 --steps 200000

What differs from CleanRL's file: environments are made by `ifo.make_environment`, whose observations include the time;
`ifo.TranslationRewardVector` gives the reward, encoding the frames of all environments in one batch; and episodes are
reset in the step after they end, as Gymnasium 1.x does by default, so that this step is left out of the loss.
"""

import argparse

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.distributions import Normal

import ifo

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("translation")
parser.add_argument("--steps", type=int, default=200_000, help="steps of all environments together")
parser.add_argument("--envs", type=int, default=8)
parser.add_argument("--rollout", type=int, default=256, help="steps per environment and iteration")
parser.add_argument("--epochs", type=int, default=10)
parser.add_argument("--minibatches", type=int, default=16)
parser.add_argument("--rate", type=float, default=3e-4)
parser.add_argument("--gamma", type=float, default=0.98)
parser.add_argument("--gae-lambda", type=float, default=0.95)
parser.add_argument("--clip", type=float, default=0.2)
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()


def layer(inputs, outputs, std=2**0.5):
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, std)
    nn.init.zeros_(made.bias)
    return made


class Agent(nn.Module):
    def __init__(self, observation_size, action_size):
        super().__init__()
        self.critic = nn.Sequential(
            layer(observation_size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, std=1.0)
        )
        self.mean = nn.Sequential(
            layer(observation_size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, action_size, std=0.01)
        )
        self.log_std = nn.Parameter(torch.full((1, action_size), -0.5))

    def policy(self, observations):
        mean = self.mean(observations)
        return Normal(mean, self.log_std.expand_as(mean).exp())

    def value(self, observations):
        return self.critic(observations).squeeze(-1)


torch.manual_seed(args.seed)
envs = gymnasium.vector.SyncVectorEnv([lambda: ifo.make_environment(args.translation)] * args.envs)
envs = ifo.TranslationRewardVector(envs, args.translation)
envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
envs = gymnasium.wrappers.vector.NormalizeObservation(envs)
envs = gymnasium.wrappers.vector.NormalizeReward(envs, gamma=args.gamma)
size, actions = envs.single_observation_space.shape[0], envs.single_action_space.shape[0]
agent = Agent(size, actions)
optimizer = torch.optim.Adam(agent.parameters(), lr=args.rate, eps=1e-5)

shape = args.rollout, args.envs
observed, acted = torch.zeros(*shape, size), torch.zeros(*shape, actions)
log_probs, rewards, values = (torch.zeros(shape) for _ in range(3))
ended, counted = torch.zeros(shape), torch.zeros(shape, dtype=torch.bool)
seen = torch.as_tensor(envs.reset(seed=args.seed)[0], dtype=torch.float32)
resets = np.zeros(args.envs, bool)
returns, outcomes = [], []
iterations = max(args.steps // (args.rollout * args.envs), 1)
for iteration in range(iterations):
    optimizer.param_groups[0]["lr"] = args.rate * (1 - iteration / iterations)
    for step in range(args.rollout):
        with torch.no_grad():
            policy = agent.policy(seen)
            action = policy.sample()
            log_probs[step], values[step] = policy.log_prob(action).sum(1), agent.value(seen)
        observed[step], acted[step] = seen, action
        counted[step] = torch.as_tensor(~resets)  # The action of a step that only resets is ignored.
        following, reward, terminated, truncated, info = envs.step(action.clamp(-1, 1).numpy())
        resets = terminated | truncated
        rewards[step] = torch.as_tensor(reward, dtype=torch.float32)
        ended[step] = torch.as_tensor(resets, dtype=torch.float32)  # The time is observed: its end has value 0.
        seen = torch.as_tensor(following, dtype=torch.float32)
        if "episode" in info:
            returns += info["episode"]["r"][info["_episode"]].tolist()
        if "outcome" in info:
            outcomes += [
                {name: outcome[k] for name, outcome in info["outcome"].items() if not name.startswith("_")}
                for k in np.flatnonzero(info["_outcome"])
            ]
    with torch.no_grad():
        advantages, advantage, later = torch.zeros(shape), torch.zeros(args.envs), agent.value(seen)
        for step in reversed(range(args.rollout)):
            goes_on = 1.0 - ended[step]
            error = rewards[step] + args.gamma * later * goes_on - values[step]
            advantage = error + args.gamma * args.gae_lambda * goes_on * advantage
            advantages[step], later = advantage, values[step]
    targets = advantages + values
    rows = counted.flatten().nonzero().squeeze(1)
    flat = [part.flatten(0, 1) for part in (observed, acted)] + [
        part.flatten() for part in (log_probs, advantages, targets)
    ]
    for _ in range(args.epochs):
        for chosen in rows[torch.randperm(len(rows))].chunk(args.minibatches):
            observations, taken, old, gained, target = (part[chosen] for part in flat)
            policy = agent.policy(observations)
            ratio = (policy.log_prob(taken).sum(1) - old).exp()
            gained = (gained - gained.mean()) / (gained.std(correction=0) + 1e-8)
            surrogate = torch.min(ratio * gained, ratio.clamp(1 - args.clip, 1 + args.clip) * gained).mean()
            loss = 0.5 * (agent.value(observations) - target).square().mean() - surrogate
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimizer.step()
    known = [f"return {np.mean(returns[-100:]):.2f}"] if returns else []
    known += [f"{name} {np.mean([o[name] for o in outcomes[-100:]]):.3f}" for name in (outcomes[0] if outcomes else {})]
    print(f"iteration {iteration + 1} of {iterations}: {', '.join(known)}")
envs.close()
