# pyright: reportMissingImports=false
# (PyTorch is optional)
"""Guider's three updates in plain eager PyTorch: the baseline that `benchmarks.updates` compares with.

The preset `paper` and nothing else, written the way the authors' code is: nn.Sequential networks, an Adam per
network, batches by indexing tensors, a critic call per group of samples with the state's rows repeated. The
losses, the number of samples and the target updates are those of guider.methods; tests/test_benchmarks.py
feeds both the same batch and noise. Where that code does more work (new samples for the backup and for each
critic, the policy on repeated rows, gradients that are never used), this one does as guider.methods does.

Shapes: B rows of a batch, S state, G goal, A action and Z latent entries, n samples. Per-row scalars are [B].
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from guider.learners import AwrConfig
from guider.learning.networks import LOG_STD_RANGE
from guider.learning.windows import Data
from guider.methods.goal_policy import GoalPolicyConfig
from guider.methods.guider import GuiderConfig

LAGRANGE_RANGE = (0.0, 1e6)


class TorchData(NamedTuple):
    """guider.learning.windows.Data as tensors."""

    observations: Tensor
    actions: Tensor
    achieved: Tensor
    goals: Tensor
    last_row: Tensor
    transition_rows: Tensor
    window_rows: Tensor


def torch_data(data: Data) -> TorchData:
    """The same data as tensors; it must hold recorded goals."""
    tensors = [torch.from_numpy(np.array(array)) for array in data]
    return TorchData(*(tensor if tensor.is_floating_point() else tensor.long() for tensor in tensors))


def mlp(sizes: Sequence[int], activation: nn.Module | None = None, dropout: float = 0.0) -> nn.Sequential:
    """Linear layers of the given sizes, each but the last followed by the activation (ReLU) and dropout."""
    modules: list[nn.Module] = []
    for fan_in, fan_out in pairwise(sizes[:-1]):
        modules += [nn.Linear(fan_in, fan_out), activation or nn.ReLU()]
        if dropout > 0:
            modules.append(nn.Dropout(dropout))
    return nn.Sequential(*modules, nn.Linear(sizes[-2], sizes[-1]))


def copy_layers(network: nn.Sequential, layers: Iterable[tuple[Any, Any]]) -> None:
    """Give the network the weights [in, out] and biases [out] of guider.learning.networks."""
    linear = [module for module in network if isinstance(module, nn.Linear)]
    with torch.no_grad():
        for module, (weight, bias) in zip(linear, layers, strict=True):
            module.weight.copy_(torch.from_numpy(np.array(weight)).T)
            module.bias.copy_(torch.from_numpy(np.array(bias)))


def copy_twins(critics: Sequence[nn.Sequential], twins: Iterable[tuple[Any, Any]]) -> None:
    """copy_layers for twins stacked along a leading axis."""
    layers = list(twins)
    for index, critic in enumerate(critics):
        copy_layers(critic, [(weight[index], bias[index]) for weight, bias in layers])


class Gaussian(NamedTuple):
    """Diagonal Gaussian; mean and log_std are [..., Z]."""

    mean: Tensor
    log_std: Tensor

    def sample(self, noise: Tensor) -> Tensor:
        return self.mean + self.log_std.exp() * noise

    def log_prob(self, value: Tensor) -> Tensor:
        standardised = (value - self.mean) * (-self.log_std).exp()
        return (-0.5 * standardised**2 - self.log_std - 0.5 * np.log(2 * np.pi)).sum(-1)

    def detach(self) -> Gaussian:
        return Gaussian(self.mean.detach(), self.log_std.detach())


def gaussian_head(outputs: Tensor) -> Gaussian:
    mean, log_std = outputs.chunk(2, dim=-1)
    return Gaussian(mean, log_std.clamp(*LOG_STD_RANGE))


def gaussian_kl(p: Gaussian, q: Gaussian) -> Tensor:
    """D_KL(p || q) per dimension, in nats."""
    variance_ratio = (2 * (p.log_std - q.log_std)).exp()
    mean_term = ((p.mean - q.mean) * (-q.log_std).exp()) ** 2
    return 0.5 * (variance_ratio + mean_term - 1) - (p.log_std - q.log_std)


def goal_reward(achieved: Tensor, goal: Tensor, radius: float) -> Tensor:
    return -((achieved - goal).norm(dim=-1) >= radius).float()


def td_target(reward: Tensor, next_value: Tensor, discount: float) -> Tensor:
    return torch.where(reward < 0, reward + discount * next_value, 0.0)


def minimise(loss: Tensor, networks: Sequence[nn.Module], optimisers: Sequence[torch.optim.Optimizer]) -> None:
    """Gradients of `loss` for these networks alone, and a step of each of their optimisers."""
    for optimiser in optimisers:
        optimiser.zero_grad()
    loss.backward(inputs=[parameter for network in networks for parameter in network.parameters()])
    for optimiser in optimisers:
        optimiser.step()


def move_targets(targets: Sequence[nn.Module], networks: Sequence[nn.Module], rate: float) -> None:
    with torch.no_grad():
        for target, network in zip(targets, networks, strict=True):
            for slow, fast in zip(target.parameters(), network.parameters(), strict=True):
                slow.lerp_(fast, rate)


def adam(networks: Sequence[nn.Module], rate: float) -> list[torch.optim.Optimizer]:
    return [torch.optim.Adam(network.parameters(), lr=rate) for network in networks]


def choose(rows: Tensor, count: int) -> Tensor:
    return rows[torch.randint(len(rows), (count,))]


def draw_between(first: Tensor, last: Tensor) -> Tensor:
    """Rows uniform in [first, last]."""
    return first + (torch.rand(first.shape) * (last - first + 1)).long()


def hindsight_goals(data: TorchData, first: Tensor, last: Tensor, relabel_fraction: float) -> Tensor:
    """A state of [first, last] with probability `relabel_fraction`, else the recorded goal. [B, G]"""
    first = torch.minimum(first, last)
    relabelled = torch.rand(len(first), 1) < relabel_fraction
    return torch.where(relabelled, data.achieved[draw_between(first, last)], data.goals[first])


class LatentModel:
    """Encoder, decoder and prior (Eq. 2-3)."""

    def __init__(self, config: GuiderConfig, goal_dim: int):
        self.config, settings = config, config.latent
        latent, hidden, gelu = settings.latent_dim, settings.hidden, nn.GELU(approximate="tanh")
        self.encoder = mlp((2 * goal_dim, *hidden, 2 * latent), gelu)
        self.decoder = mlp((goal_dim + latent, *hidden, goal_dim), gelu, settings.decoder_dropout)
        self.prior = mlp((goal_dim, *hidden, 2 * latent))
        self.networks = (self.encoder, self.decoder, self.prior)
        self.optimisers = adam(self.networks, settings.learning_rate)

    def loss(self, achieved: Tensor, later: Tensor, noise: Tensor) -> Tensor:
        """achieved, later: [B, G]; noise: [B, Z]."""
        settings = self.config.latent
        posterior = gaussian_head(self.encoder(torch.cat([achieved, later], -1)))
        prior = gaussian_head(self.prior(achieved))
        decoded = self.decoder(torch.cat([achieved, posterior.sample(noise)], -1))
        balance = settings.kl_balance
        kl = balance * gaussian_kl(posterior.detach(), prior) + (1 - balance) * gaussian_kl(posterior, prior.detach())
        return ((decoded - later) ** 2).mean() + settings.beta * kl.mean()

    def update(self, data: TorchData) -> None:
        settings = self.config.latent
        rows = choose(data.window_rows, settings.batch_size)
        later = torch.minimum(rows + self.config.problem.period_steps, data.last_row[rows])
        noise = torch.randn(settings.batch_size, settings.latent_dim)
        loss = self.loss(data.achieved[rows], data.achieved[later], noise)
        minimise(loss, self.networks, self.optimisers)


class SubgoalBatch(NamedTuple):
    """guider.methods.subgoal_policy.Transitions as tensors."""

    state: Tensor
    latent: Tensor
    reward: Tensor
    next_state: Tensor
    prior: Gaussian


class SubgoalNoise(NamedTuple):
    """next, now: [B, n, Z] and actor: [B, Z], standard normal; uniform: [B, n, Z] in [0, 1)."""

    next: Tensor
    now: Tensor
    uniform: Tensor
    actor: Tensor


class SubgoalPolicy:
    """The high level with CQL, a Lagrange weight and the max-Q backup (Eq. 4)."""

    def __init__(self, config: GuiderConfig, goal_dim: int):
        self.config, settings = config, config.high
        latent_dim = config.latent.latent_dim
        critic_sizes = (2 * goal_dim + latent_dim, *settings.hidden, 1)
        self.model = LatentModel(config, goal_dim)
        self.actor = mlp((2 * goal_dim, *settings.hidden, 2 * latent_dim))
        self.critics = [mlp(critic_sizes) for _ in range(2)]
        self.targets = [mlp(critic_sizes) for _ in range(2)]
        move_targets(self.targets, self.critics, 1.0)
        self.log_alpha = nn.Parameter(torch.zeros(()))
        self.log_lagrange = nn.Parameter(torch.zeros(()))
        self.optimisers = adam((self.actor, *self.critics), settings.learning_rate)
        self.weights_optimisers = [
            torch.optim.Adam([weight], lr=settings.learning_rate) for weight in (self.log_alpha, self.log_lagrange)
        ]

    def propose(self, state: Tensor) -> Gaussian:
        return gaussian_head(self.actor(state))

    def losses(self, batch: SubgoalBatch, noise: SubgoalNoise) -> tuple[Tensor, Tensor, Tensor]:
        """(TD error plus conservative terms of both critics, actor loss plus alpha's, Lagrange weight's loss)."""
        settings = self.config.high
        with torch.no_grad():
            next_policy, policy = self.propose(batch.next_state), self.propose(batch.state)
            next_policy, policy = (Gaussian(p.mean[:, None], p.log_std[:, None]) for p in (next_policy, policy))
            next_latents, now_latents = next_policy.sample(noise.next), policy.sample(noise.now)
            next_values = [_values(target, batch.next_state, next_latents) for target in self.targets]
            next_value = torch.minimum(*(values.max(dim=1).values for values in next_values))
            target = td_target(batch.reward, next_value, settings.discount)
            low, high = batch.latent.aminmax()
            uniform = low + (high - low) * noise.uniform
            log_volume = batch.latent.shape[1] * (high - low).log()
            next_log_density, now_log_density = next_policy.log_prob(next_latents), policy.log_prob(now_latents)

        td, gaps = torch.zeros(()), []
        for critic in self.critics:
            value = critic(torch.cat([batch.state, batch.latent], -1))[:, 0]
            weighted = [
                _values(critic, batch.state, uniform) + log_volume,
                _values(critic, batch.state, next_latents) - next_log_density,
                _values(critic, batch.state, now_latents) - now_log_density,
            ]
            sampled = torch.logsumexp(torch.cat(weighted, dim=1), dim=1)
            gaps.append((sampled - value).mean())
            td = td + ((value - target) ** 2).mean()

        assert settings.lagrange_threshold is not None, "the preset `paper` has one"
        excess = settings.conservative_weight * torch.stack(gaps) - settings.lagrange_threshold
        lagrange = self.log_lagrange.exp().clamp(*LAGRANGE_RANGE)
        critic_loss = td + lagrange.detach() * excess.sum()

        now = self.propose(batch.state)
        latent = now.sample(noise.actor)
        value = torch.minimum(*(critic(torch.cat([batch.state, latent], -1))[:, 0] for critic in self.critics))
        divergence = gaussian_kl(now, batch.prior).mean(-1)
        actor = (self.log_alpha.exp().detach() * divergence - value).mean()
        alpha = -self.log_alpha.exp() * (divergence.mean() - settings.target_divergence).detach()
        return critic_loss, actor + alpha, -lagrange * excess.mean().detach()

    def update(self, data: TorchData) -> None:
        settings, count = self.config.high, self.config.high.batch_size
        shape = (count, settings.samples, self.config.latent.latent_dim)
        noise = SubgoalNoise(torch.randn(shape), torch.randn(shape), torch.rand(shape), torch.randn(count, shape[-1]))
        critic, actor, lagrange = self.losses(self._sample(data), noise)
        for optimiser in (*self.optimisers, *self.weights_optimisers):
            optimiser.zero_grad()
        actor.backward(inputs=[*self.actor.parameters(), self.log_alpha])
        critic.backward(inputs=[parameter for network in self.critics for parameter in network.parameters()])
        lagrange.backward()
        for optimiser in (*self.optimisers, *self.weights_optimisers):
            optimiser.step()
        move_targets(self.targets, self.critics, settings.target_rate)

    def _sample(self, data: TorchData) -> SubgoalBatch:
        settings = self.config.high
        rows = choose(data.window_rows, settings.batch_size)
        last = data.last_row[rows]
        later_rows = torch.minimum(rows + self.config.problem.period_steps, last)
        goal = hindsight_goals(data, later_rows + settings.goal_offset, last, settings.relabel_fraction)
        achieved, later = data.achieved[rows], data.achieved[later_rows]
        with torch.no_grad():
            posterior = gaussian_head(self.model.encoder(torch.cat([achieved, later], -1)))
            prior = gaussian_head(self.model.prior(achieved))
        return SubgoalBatch(
            state=torch.cat([achieved, goal], -1),
            latent=posterior.sample(torch.randn_like(posterior.mean)),
            reward=goal_reward(later, goal, self.config.problem.radius),
            next_state=torch.cat([later, goal], -1),
            prior=prior,
        )


def _values(critic: nn.Module, state: Tensor, latents: Tensor) -> Tensor:
    """state: [B, 2G]; latents: [B, n, Z] -> [B, n]."""
    rows, samples, _ = latents.shape
    repeated = state[:, None].repeat(1, samples, 1)
    return critic(torch.cat([repeated, latents], -1).reshape(rows * samples, -1)).reshape(rows, samples)


class GoalBatch(NamedTuple):
    """guider.learners.Transitions as tensors."""

    state: Tensor
    action: Tensor
    reward: Tensor
    next_state: Tensor


class GoalPolicy:
    """The low level (Eq. 5-6)."""

    def __init__(self, config: GuiderConfig, state_dim: int, goal_dim: int, action_dim: int):
        assert isinstance(config.low.learner, AwrConfig), "Guider's own low level"
        self.config, self.learner = config, config.low.learner
        settings: GoalPolicyConfig = config.low
        input_dim = state_dim + 2 * goal_dim
        critic_sizes = (input_dim + action_dim, *settings.hidden, 1)
        self.actor = mlp((input_dim, *settings.hidden, 2 * action_dim))
        self.critics = [mlp(critic_sizes) for _ in range(2)]
        self.targets = [mlp(critic_sizes) for _ in range(2)]
        move_targets(self.targets, self.critics, 1.0)
        self.networks = (self.actor, *self.critics)
        self.optimisers = adam(self.networks, settings.learning_rate)

    def loss(self, batch: GoalBatch, next_noise: Tensor, noise: Tensor) -> Tensor:
        """TD error of both critics plus the actor's weighted regression; neither has a gradient for the other.

        next_noise, noise: [B, A], standard normal, for the policy's samples."""
        settings = self.learner
        with torch.no_grad():
            next_action = gaussian_head(self.actor(batch.next_state)).sample(next_noise)
            next_inputs = torch.cat([batch.next_state, next_action], -1)
            next_value = torch.minimum(*(target(next_inputs)[:, 0] for target in self.targets))
            target = td_target(batch.reward, next_value, settings.discount)
            ahead = td_target(batch.reward, self.critics[0](next_inputs)[:, 0], settings.discount)
        inputs = torch.cat([batch.state, batch.action], -1)
        td = sum(((critic(inputs)[:, 0] - target) ** 2).mean() for critic in self.critics)

        predicted = gaussian_head(self.actor(batch.state)).sample(noise)
        with torch.no_grad():
            baseline = self.critics[0](torch.cat([batch.state, predicted], -1))[:, 0]
            advantage = (ahead - baseline) / settings.temperature
            weight = advantage.clamp(max=20.0).exp().clamp(max=settings.weight_ceiling)
        return td + (weight * ((predicted - batch.action) ** 2).mean(-1)).mean()

    def update(self, data: TorchData) -> None:
        batch = self._sample(data)
        noise = torch.randn(2, *batch.action.shape)
        minimise(self.loss(batch, *noise), self.networks, self.optimisers)
        move_targets(self.targets, self.critics, self.learner.target_rate)

    def _sample(self, data: TorchData) -> GoalBatch:
        settings = self.config.low
        rows = choose(data.transition_rows, settings.batch_size)
        last = data.last_row[rows]
        longest = self.config.problem.period_steps + settings.subgoal_slack_steps
        subgoal_rows = draw_between(rows + 1, torch.minimum(rows + longest, last))
        subgoal = data.achieved[subgoal_rows]
        goal = hindsight_goals(data, subgoal_rows, last, settings.relabel_fraction)
        return GoalBatch(
            state=torch.cat([data.observations[rows], subgoal, goal], -1),
            action=data.actions[rows],
            reward=goal_reward(data.achieved[rows + 1], subgoal, self.config.problem.radius),
            next_state=torch.cat([data.observations[rows + 1], subgoal, goal], -1),
        )
