"""`guider train`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Unpack

import tyro

from guider.commands.options import Json, assignments
from guider.commands.screen import answer, stage_bars
from guider.errors import GuiderError
from guider.learning.options import LearningOptions
from guider.support.files import user_path


def train(
    task: tyro.conf.Positional[str | None] = None,
    data: str | None = None,
    seeds: int | None = None,
    first_seed: int | None = None,
    out: Path | None = None,
    resume: Path | None = None,
    held_out: float | None = None,
    set: tuple[str, ...] = (),
    evaluate_every: int = 0,
    stage_cache: Path | None = None,
    log_to: Literal["tensorboard", "wandb"] | None = None,
    as_json: Json = False,
    **learning: Unpack[LearningOptions],
) -> None:
    """Learn a policy from logged data.

    A benchmark: guider train pointmaze-large --data datasets/pointmaze-large.hdf5 --seeds 4

    Your own logs: guider train --data logs.npz --goal-indices 0 1 --radius 0.5 --out runs/robot

    After a crash: guider train --resume runs/robot

    Args:
        task: A benchmark from `guider tasks`; leave it out for your own data.
        data: HDF5 (D4RL), npz (OGBench or your own), a Minari directory or minari:ID. See `guider data inspect`.
        seeds: How many agents to train at once, in one compiled program; by default 1.
        first_seed: Their seeds count up from here, by default 0, so that several machines can share a set of seeds.
        out: New directory for the run; by default runs/TASK-METHOD-PRESET.
        resume: Continue this interrupted run; the result is the same to the bit. Other settings are the run's own.
        held_out: Fraction of episodes kept aside for `guider evaluate`; by default 0.1 for own data, else 0.
        set: Further settings by dotted name, e.g. --set high.samples=2 low.updates=50000.
        evaluate_every: Evaluate on the task after every so many updates of the last stage (0: never).
        stage_cache: Directory where runs share their stages: equal ones trained before are taken over, new ones kept.
        log_to: Also send metrics to TensorBoard (into the run) or Weights & Biases; extras of the package.
        as_json: Print one JSON document instead of text.
    """
    from guider import api
    from guider.runs import sinks

    if resume is not None:
        if learning or set or any(value is not None for value in (task, seeds, first_seed, out, held_out)):
            raise GuiderError("--resume takes all settings from the run; give only --data if the data has moved")
        directory = user_path(resume)
    else:
        seeds = 1 if seeds is None else seeds
        if seeds < 1:
            raise GuiderError(f"--seeds must be 1 or more, got {seeds}")
        directory = api.run_directory(task, out, learning)
    sink = sinks.sink(log_to, directory)
    with stage_bars() as (say, show):
        if resume is not None:
            run = api.resume(
                directory, data, evaluate_every=evaluate_every, on_chunk=_both(show, sink), stage_cache=stage_cache
            )
        else:
            first_seed = first_seed or 0
            run = api.train(
                task,
                data,
                settings=assignments(set),
                seeds=range(first_seed, first_seed + (seeds or 1)),
                out=directory,
                held_out=held_out,
                evaluate_every=evaluate_every,
                on_chunk=_both(show, sink),
                say=say,
                stage_cache=stage_cache,
                **learning,
            )
    text = f"trained {run.directory}; next: `guider evaluate {run.directory}` and `guider plot {run.directory}`"
    answer({"run": str(run.directory), "seeds": list(run.spec.seeds)}, text, as_json)


def _both(first: Callable[..., None], second: Callable[..., None]) -> Callable[..., None]:
    def call(*arguments: Any) -> None:
        first(*arguments)
        second(*arguments)

    return call
