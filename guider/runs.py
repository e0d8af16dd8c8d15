"""Training runs on disk: start, record, resume, load.

A run is a directory:
    run.json            everything that determines the run (RunSpec), and what it was made with
    metrics.jsonl       a line per chunk of updates: stage, update, seconds, means per seed
    evaluations.jsonl   a line per evaluation during training
    evaluation.json     what `guider evaluate` found last
    checkpoints/        the whole training state, newest two
    plots/              what `guider plot` drew
"""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from guider import checkpoint, stage_cache
from guider.config import from_dict, to_dict
from guider.episodes import Episodes, Spaces
from guider.errors import GuiderError
from guider.methods import METHODS
from guider.methods.view import Scale, prepare, unit_scale
from guider.policy import Policy
from guider.training import Chunk, Position, init_seeds, seed_keys, train

FORMAT = 4


@dataclass(frozen=True)
class RunSpec:
    """What determines a run, to the bit, on one machine.

    task: benchmark task, None for one's own data; data: where the episodes came from; format: how they were read, None
    if told by content; episode_ends: signs of where they end that were asked for, () if decided; fingerprint: of the
    episodes trained on; held_out: fraction of episodes kept for `guider evaluate`; config: the method's settings;
    spaces: dimensions and bounds.
    """

    task: str | None
    data: str
    format: str | None
    episode_ends: tuple[str, ...]
    fingerprint: str
    held_out: float
    method: str
    preset: str
    seeds: tuple[int, ...]
    config: Any
    spaces: Spaces


@dataclass(frozen=True)
class Pace:
    """How often training reports and saves; the result does not depend on it.

    chunk_updates: updates between reports; checkpoint_seconds: least time between checkpoints.
    """

    chunk_updates: int = 500
    checkpoint_seconds: float = 60.0


@dataclass(frozen=True)
class Run:
    """A run directory and its spec."""

    directory: Path
    spec: RunSpec

    @property
    def stages(self):
        return METHODS[self.spec.method].stages(self.spec.config)

    def restore(self) -> tuple[Position, Any] | None:
        """The newest checkpoint, (position, state of all seeds), or None where there is none yet."""
        return checkpoint.restore(self.directory / "checkpoints", _state_template(self.spec))

    def policies(self) -> list[Policy]:
        """The trained policy of every seed. Raises GuiderError while training is unfinished."""
        restored = self.restore()
        if restored is None:
            raise GuiderError(f"{self.directory} holds no checkpoint yet; {_finish(self.directory)}")
        position, state = restored
        last = self.stages[-1]
        if position != Position(len(self.stages) - 1, last.updates):
            stage = self.stages[position.stage]
            raise GuiderError(
                f"{self.directory} stopped after {position.update} of {stage.updates} updates of the "
                f"{stage.name} stage; {_finish(self.directory)}"
            )
        return policies(self.spec, state)


def _finish(directory: Path) -> str:
    return f"finish it with `guider train --resume {directory}`"


def policies(spec: RunSpec, state: Any) -> list[Policy]:
    """One policy per seed from a state whose leaves are [seeds, ...]."""
    shown_low, shown_high = _shown(spec.spaces)
    return [
        Policy(
            state=jax.tree.map(lambda leaf, i=index: jnp.asarray(leaf[i]), state),
            action_low=jnp.asarray(spec.spaces.action_low, jnp.float32),
            action_high=jnp.asarray(spec.spaces.action_high, jnp.float32),
            method=spec.method,
            config=spec.config,
            goal_indices=spec.spaces.goal_indices,
            state_dim=spec.spaces.state_dim,
            state_low=shown_low,
            state_high=shown_high,
        )
        for index in range(len(spec.seeds))
    ]


def _shown(spaces: Spaces) -> tuple[jax.Array | None, jax.Array | None]:
    """Limits of what a policy is shown of a state: the data's range and half of it more on either side."""
    if not spaces.state_low:
        return None, None
    low, high = jnp.asarray(spaces.state_low, jnp.float32), jnp.asarray(spaces.state_high, jnp.float32)
    return low - (high - low) / 2, high + (high - low) / 2


def start(
    directory: Path,
    spec: RunSpec,
    facts: dict[str, Any],
    episodes: Episodes,
    on_chunk: Callable[[Chunk, Any], None],
    pace: Pace,
    cache: Path | None = None,
) -> Run:
    """Train a new run from the beginning, but for stages that `cache` knows (see guider.stage_cache).

    facts: what was found about the data, for people to read in run.json. Raises GuiderError if `directory` is taken.
    """
    check_new(directory)
    run = Run(directory, spec)
    prepared = _prepare(spec, episodes)
    directory.parent.mkdir(parents=True, exist_ok=True)
    temporary = directory.with_name(f".{directory.name}.{os.getpid()}")
    temporary.mkdir()
    write_json(temporary / "run.json", {"run_format": FORMAT, **to_dict(spec), "facts": facts, "made_with": versions()})
    temporary.rename(directory)
    _train(run, prepared, None, on_chunk, pace, cache)
    return run


def check_new(directory: Path) -> None:
    """Raise GuiderError if `directory` is taken."""
    if directory.exists() or directory.is_symlink():
        raise GuiderError(
            f"{directory} exists already and is never overwritten; choose another --out, "
            f"or continue it with `guider train --resume {directory}`"
        )


def resume(
    run: Run, episodes: Episodes, on_chunk: Callable[[Chunk, Any], None], pace: Pace, cache: Path | None = None
) -> None:
    """Continue a run from its newest checkpoint, or from the beginning where it has none yet.

    The result is bit-equal to that of an uninterrupted run, if `episodes` are those of the spec's fingerprint.
    """
    _train(run, _prepare(run.spec, episodes), run.restore(), on_chunk, pace, cache)


def _prepare(spec: RunSpec, episodes: Episodes) -> tuple[Any, Any]:
    """(data on the device, input scale) of the episodes to train on. Raises GuiderError if they do not suffice."""
    training = episodes.split(spec.held_out)[0] if spec.held_out else episodes
    return prepare(spec.config.view, spec.config.problem, training)


def _train(
    run: Run,
    prepared: tuple[Any, Any],
    restored: tuple[Position, Any] | None,
    on_chunk: Callable[[Chunk, Any], None],
    pace: Pace,
    cache: Path | None,
) -> None:
    """Run the stages, logging every chunk; checkpoints come as `pace` says and at each stage's end."""
    spec = run.spec
    data, scale = prepared
    if restored is None:
        begin = Position(0, 0)
        state = init_seeds(_initialiser(spec, scale), spec.seeds)
    else:
        begin, state = restored
        state = jax.tree.map(jnp.asarray, state)
    stages = run.stages
    for name in ("metrics.jsonl", "evaluations.jsonl"):
        _drop_later_lines(run.directory / name, total_updates(stages, begin))
    saved_at = time.monotonic()
    entry = None  # of the stage being trained, in the cache

    def known(index: int, state: Any) -> Any:
        """What the cache has of a stage, entered into the run as if it had been trained here."""
        nonlocal entry
        if cache is None:
            return None
        stage, part = stages[index], getattr(state, stages[index].part)
        entry = cache / stage_cache.stage_digest(stage, index, state, data, spec.seeds, versions())
        found = stage_cache.find(entry, part)
        if found is None:
            return None
        part, lines = found
        before, end = total_updates(stages, Position(index, 0)), Position(index, stage.updates)
        for line in lines:
            append_line(run.directory / "metrics.jsonl", line | {"total_updates": before + line["update"]})
        whole = state._replace(**{stage.part: part})
        checkpoint.save(run.directory / "checkpoints", total_updates(stages, end), end, whole)
        return jax.tree.map(jnp.asarray, part)

    def record(chunk: Chunk, state: Any) -> None:
        nonlocal saved_at
        total = total_updates(stages, chunk.position)
        _check_finite(run, chunk)
        line = {
            "stage": chunk.stage.name,
            "update": chunk.position.update,
            "total_updates": total,
            "seconds": round(chunk.seconds, 4),
            "metrics": {name: np.asarray(value).tolist() for name, value in chunk.metrics.items()},
        }
        append_line(run.directory / "metrics.jsonl", line)
        on_chunk(chunk, state)
        stage_ends = chunk.position.update == chunk.stage.updates
        if stage_ends or time.monotonic() - saved_at > pace.checkpoint_seconds:
            checkpoint.save(run.directory / "checkpoints", total, chunk.position, state)
            saved_at = time.monotonic()
        if stage_ends and entry is not None:
            lines = [line for line in read_lines(run.directory / "metrics.jsonl") if line["stage"] == chunk.stage.name]
            stage_cache.keep(entry, chunk.position, getattr(state, chunk.stage.part), lines)

    chunk_updates = pace.chunk_updates
    with jax.default_matmul_precision(spec.config.precision):
        train(stages, state, data, spec.seeds, start=begin, chunk_updates=chunk_updates, on_chunk=record, known=known)


def _check_finite(run: Run, chunk: Chunk) -> None:
    """Raise GuiderError once a seed has diverged; the checkpoint before stays the newest."""
    for name, values in chunk.metrics.items():
        diverged = np.flatnonzero(~np.isfinite(np.asarray(values)))
        if len(diverged):
            raise GuiderError(
                f"{run.directory}: {name} of seed {run.spec.seeds[diverged[0]]} is no longer finite before update "
                f"{chunk.position.update} of the {chunk.stage.name} stage; lower its learning rate or check the data"
            )


def open_run(directory: str | Path) -> Run:
    """The run in `directory`. Raises GuiderError if it is not one, or was written by another version."""
    directory = Path(directory)
    path = directory / "run.json"
    try:
        values = json.loads(path.read_text())
    except FileNotFoundError:
        raise GuiderError(f"{directory} is not a run: it has no run.json") from None
    except (OSError, ValueError) as error:
        raise GuiderError(f"{path} cannot be read: {error}") from error
    if not isinstance(values, dict) or values.pop("run_format", None) != FORMAT:
        raise GuiderError(f"{path} was written by another version of guider (this one reads run format {FORMAT})")
    for name in ("made_with", "facts"):
        values.pop(name, None)
    method = values.get("method")
    if not isinstance(method, str) or method not in METHODS:
        raise GuiderError(f"{path} names the method {method!r}; there are {', '.join(METHODS)}")
    config = from_dict(METHODS[method].config_type, values.pop("config", {}), f"{path}: config")
    spec = from_dict(RunSpec, {**values, "config": config}, str(path))
    return Run(directory, spec)


def total_updates(stages: Sequence[Any], position: Position) -> int:
    """Updates done over all stages at `position`."""
    return sum(stage.updates for stage in stages[: position.stage]) + position.update


def read_lines(path: Path) -> list[dict[str, Any]]:
    """All complete lines of a JSONL file; a line cut off by a crash is left out."""
    if not path.exists():
        return []
    lines = []
    for text in path.read_text().splitlines():
        try:
            lines.append(json.loads(text))
        except ValueError:
            continue
    return lines


def append_line(path: Path, value: dict[str, Any]) -> None:
    """Add one line to a JSONL file."""
    with path.open("a") as file:
        file.write(json.dumps(value) + "\n")


def write_json(path: Path, value: Any) -> None:
    """Write JSON under a temporary name, then rename: readers see the old file or the new one, never half."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(json.dumps(value, indent=1) + "\n")
    temporary.replace(path)


def versions() -> dict[str, str]:
    """The software a result depends on."""
    packages = ("guider-rl", "jax", "optax", "numpy", "mujoco", "gymnasium")
    found = {"python": platform.python_version(), "device": jax.default_backend()}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def _drop_later_lines(path: Path, total: int) -> None:
    """Forget lines written after the checkpoint that training continues from."""
    if path.exists():
        kept = [line for line in read_lines(path) if line["total_updates"] <= total]
        temporary = path.with_name(f".{path.name}.{os.getpid()}")
        temporary.write_text("".join(json.dumps(line) + "\n" for line in kept))
        temporary.replace(path)


def _initialiser(spec: RunSpec, scale: Scale) -> Callable[[jax.Array], Any]:
    """key -> one seed's fresh state."""
    return lambda key: METHODS[spec.method].init(spec.config, spec.spaces, scale, key)


def _state_template(spec: RunSpec) -> Any:
    init = _initialiser(spec, unit_scale(spec.config.view, spec.spaces))
    return jax.eval_shape(jax.vmap(init), seed_keys(spec.seeds))
