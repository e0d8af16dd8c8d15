# pyright: reportMissingImports=false
# (PyTorch is optional)
"""Updates per second of the three stages, against plain eager PyTorch and between our own settings.

PyTorch runs in float32, and again under its autocast to bfloat16.

python -m benchmarks.updates [--stage latent|high|low|switches] [--rounds N] [--seconds S] [--json]
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp

from benchmarks.common import (
    STAGES,
    Run,
    alternate,
    antmaze_config,
    antmaze_episodes,
    print_table,
    ratios,
    show_ratio,
    trainer,
    verdict,
)
from guider.data.episodes import Episodes, Spaces
from guider.learning.networks import Layers, mlp
from guider.learning.processor import describe
from guider.methods import guider, subgoal_policy
from guider.methods.guider import GuiderConfig
from guider.methods.view import prepare, unit_scale
from guider.tasks.simulation import available_cores

TARGETS = {"latent": 4.0, "high": 1.3, "low": 2.5}
"""Least acceptable ratio to eager PyTorch, at equal batches and samples."""

OURS = {"paper": "float32", "paper bfloat16": "bfloat16"}
"""Contenders held against PyTorch in float32, and their precision."""

SWITCHES: dict[str, dict[str, Any]] = {
    "samples=4": {"samples": 4},
    "samples=2": {"samples": 2},
    "hidden=(256,256)": {"hidden": (256, 256)},
    "critic=expectile": {"critic": "expectile"},
    "critic=td": {"critic": "td"},
}
"""Settings of the high level that buy speed, each alone on top of the preset `paper`."""


def forward_flops(sizes: Sequence[int], rows: int) -> float:
    """A multiplication and an addition per weight and row; activations and biases (under 1 %) are not counted."""
    return 2.0 * rows * sum(a * b for a, b in pairwise(sizes))


def training_flops(sizes: Sequence[int], rows: int) -> float:
    """A forward pass, and a backward pass to weights and inputs, of which the first layer's inputs need none."""
    return 3 * forward_flops(sizes, rows) - forward_flops(sizes[:2], rows)


def layer_sizes(layers: Layers) -> tuple[int, ...]:
    """(inputs, hidden ..., outputs) of a network, or of twins stacked along a leading axis."""
    return (*(weight.shape[-2] for weight, _ in layers), layers[-1][0].shape[-1])


def update_flops(config: GuiderConfig, stage: str, spaces: Spaces) -> float:
    """Floating-point operations of one update's networks, from their shapes and the passes through them.

    latent: encoder, decoder and prior are trained on B rows.
    high (CQL): both critics are trained on B (1 + 3n) rows, the actor on B; both target critics see B n rows;
        forward on B rows go encoder, prior, and the actor for the two sampling policies; both critics see the
        actor's B latents forward and back to their inputs.
    low: both critics and the actor are trained on B rows; forward go both target critics, the actor on next
        states, and on the actor's actions both critics (`action_value`), or one critic now and a step ahead.
    """
    scale = unit_scale(config.view, spaces)
    state = jax.eval_shape(lambda key: guider.init(config, spaces, scale, key), jax.random.key(0))
    encoder, decoder, prior = map(layer_sizes, state.latent.params)
    if stage == "latent":
        return sum(training_flops(sizes, config.latent.batch_size) for sizes in (encoder, decoder, prior))
    if stage == "high":
        actor, critic = layer_sizes(state.high.params.actor), layer_sizes(state.high.params.critic)
        rows, samples = config.high.batch_size, config.high.samples
        relabelling = forward_flops(encoder, rows) + forward_flops(prior, rows)
        critics = 2 * (forward_flops(critic, rows * samples) + training_flops(critic, rows * (1 + 3 * samples)))
        policies = 2 * forward_flops(actor, rows) + training_flops(actor, rows) + 4 * forward_flops(critic, rows)
        return relabelling + critics + policies
    actor, critic = layer_sizes(state.low.params.actor), layer_sizes(state.low.params.critic)
    rows = config.low.batch_size
    critics = 2 * (training_flops(critic, rows) + 2 * forward_flops(critic, rows))
    return critics + training_flops(actor, rows) + forward_flops(actor, rows)


def torch_trainer(config: GuiderConfig, stage: str, episodes: Episodes, autocast: bool = False) -> Run:
    """run(updates): the same stage in eager PyTorch, on all cores."""
    import torch

    from benchmarks.torch_updates import GoalPolicy, LatentModel, SubgoalPolicy, torch_data

    torch.set_num_threads(available_cores())
    data = torch_data(prepare(config.view, config.problem, episodes)[0])
    spaces = episodes.spaces
    makers: dict[str, Callable[[], LatentModel | SubgoalPolicy | GoalPolicy]] = {
        "latent": lambda: LatentModel(config, spaces.goal_dim),
        "high": lambda: SubgoalPolicy(config, spaces.goal_dim),
        "low": lambda: GoalPolicy(config, spaces.state_dim, spaces.goal_dim, spaces.action_dim),
    }
    baseline = makers[stage]()

    def run(updates: int) -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
            for _ in range(updates):
                baseline.update(data)

    return run


def measure_stage(stage: str, episodes: Episodes, rounds: int, seconds: float) -> dict[str, Any]:
    """One stage: preset `paper` here and in PyTorch, in either precision, and preset `fast`. Updates per second."""
    paper, fast = antmaze_config("paper"), antmaze_config("fast")
    rounded = replace(paper, precision="bfloat16")
    rates = alternate(
        {
            "paper": trainer(paper, stage, episodes),
            "paper bfloat16": trainer(rounded, stage, episodes),
            "torch": torch_trainer(paper, stage, episodes),
            "torch bfloat16": torch_trainer(paper, stage, episodes, autocast=True),
            "fast": trainer(fast, stage, episodes),
        },
        rounds,
        seconds,
    )
    flops = {name: update_flops(c, stage, episodes.spaces) for name, c in (("paper", paper), ("fast", fast))}
    medians = {name: statistics.median(values) for name, values in rates.items()}
    return {
        "rates": rates,
        "median_rates": medians,
        "flops_per_update": flops,
        "gflops_per_second": {
            name: medians[name] * flops["fast" if name == "fast" else "paper"] / 1e9 for name in medians
        },
        "to_torch": {name: ratios(rates[name], rates["torch"]) for name in OURS},
        "fast_to_paper": ratios(rates["fast"], rates["paper"]),
        "target": TARGETS[stage],
    }


def measure_switches(episodes: Episodes, rounds: int, seconds: float) -> dict[str, Any]:
    """The high level under `paper`, with each of SWITCHES, and with nothing shared between samples."""
    paper = antmaze_config("paper")
    contenders = {"paper": trainer(paper, "high", episodes)}
    with mock.patch.object(subgoal_policy, "twin_values", unshared_twin_values):
        contenders["first layer per sample"] = trainer(paper, "high", episodes)
    for name, settings in SWITCHES.items():
        contenders[name] = trainer(replace(paper, high=replace(paper.high, **settings)), "high", episodes)
    rates = alternate(contenders, rounds, seconds)
    return {
        "rates": rates,
        "median_rates": {name: statistics.median(values) for name, values in rates.items()},
        "to_paper": {name: ratios(values, rates["paper"]) for name, values in rates.items()},
    }


def unshared_twin_values(twins: Layers, context: jax.Array, actions: jax.Array) -> jax.Array:
    """guider.learning.networks.twin_values with the context repeated for every sample before the first layer."""
    if actions.ndim == 3:
        context = jnp.repeat(context[:, None], actions.shape[1], axis=1)
    inputs = jnp.concatenate([context, actions], axis=-1)
    return jax.vmap(lambda layers: mlp(layers, inputs)[..., 0])(twins)


def print_stages(results: dict[str, Any]) -> None:
    header = ("stage", "precision", "guider /s", "to torch (min-max)", "GFLOP/s", "")
    rows = [
        (
            stage,
            precision,
            f"{result['median_rates'][name]:.1f}",
            show_ratio(result["to_torch"][name]),
            f"{result['gflops_per_second'][name]:.0f}",
            verdict(result["to_torch"][name]["median"], result["target"]),
        )
        for stage, result in results.items()
        for name, precision in OURS.items()
    ]
    print_table(f"Preset paper on {describe()}: updates per second, against eager PyTorch in float32", header, rows)
    header = ("stage", "torch /s", "under autocast /s", "GFLOP/update", "GFLOP/s")
    rows = [
        (
            stage,
            f"{result['median_rates']['torch']:.1f}",
            f"{result['median_rates']['torch bfloat16']:.1f}",
            f"{result['flops_per_update']['paper'] / 1e9:.2f}",
            f"{result['gflops_per_second']['torch']:.0f}",
        )
        for stage, result in results.items()
    ]
    print_table("The same in eager PyTorch", header, rows)
    header = ("stage", "fast /s", "to paper (min-max)", "GFLOP/update", "GFLOP/s")
    rows = [
        (
            stage,
            f"{result['median_rates']['fast']:.1f}",
            show_ratio(result["fast_to_paper"]),
            f"{result['flops_per_update']['fast'] / 1e9:.2f}",
            f"{result['gflops_per_second']['fast']:.0f}",
        )
        for stage, result in results.items()
    ]
    print_table("Preset fast, updates per second", header, rows)


def print_switches(result: dict[str, Any]) -> None:
    rows = [
        (name, f"{rate:.1f}", show_ratio(result["to_paper"][name])) for name, rate in result["median_rates"].items()
    ]
    print_table("High level: what each setting buys", ("setting", "updates/s", "to paper (min-max)"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.updates", description=__doc__)
    parser.add_argument("--stage", choices=[*STAGES, "switches"], help="default: all stages and the switches")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contender, in alternation")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a run")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    options = parser.parse_args()
    chosen = [options.stage] if options.stage else [*STAGES, "switches"]
    episodes = antmaze_episodes()
    stages = {s: measure_stage(s, episodes, options.rounds, options.seconds) for s in chosen if s != "switches"}
    switches = measure_switches(episodes, options.rounds, options.seconds) if "switches" in chosen else None
    if options.json:
        print(json.dumps({"cores": available_cores(), "stages": stages, "switches": switches}))
        return
    print(f"{available_cores()} cores; {options.rounds} rounds of {options.seconds:g} s for each contender")
    if stages:
        print_stages(stages)
    if switches:
        print_switches(switches)


if __name__ == "__main__":
    main()
