"""Metrics to TensorBoard or Weights & Biases, both extras; metrics.jsonl is always written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from guider.learning.training import Chunk
from guider.support.extras import extra


def sink(name: str | None, directory: Path) -> Callable[[Chunk, Any], None]:
    """A callback for the engine that logs the seeds' mean of every metric, by update of its stage.

    name: "tensorboard" (events go into directory/tensorboard), "wandb", or None for nothing.
    Raises GuiderError where the extra is not installed.
    """
    if name is None:
        return lambda chunk, state: None
    with extra(name, name):
        if name == "tensorboard":
            from tensorboardX import SummaryWriter

            write = _lazily(lambda: SummaryWriter(str(directory / "tensorboard")).add_scalar)
        else:
            import wandb  # pyright: ignore[reportMissingImports]

            run = _lazily(lambda: wandb.init(project="guider", name=directory.name).log)

            def write(tag: str, value: float, step: int) -> None:
                run({tag: value, f"{tag.split('/')[0]}/update": step})

    def log(chunk: Chunk, state: Any) -> None:
        for metric, values in chunk.metrics.items():
            write(f"{chunk.stage.name}/{metric}", float(values.mean()), chunk.position.update)

    return log


def _lazily(make: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """Call `make` on first use: the run's directory must not exist before the run does."""
    made: list[Callable[..., Any]] = []

    def call(*arguments: Any) -> Any:
        if not made:
            made.append(make())
        return made[0](*arguments)

    return call
