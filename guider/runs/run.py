"""Training runs on disk: start, record, resume, load.

A run is a directory:
    run.json            everything that determines the run (RunSpec), and what it was made with
    metrics.jsonl       a line per chunk of updates: stage, update, seconds, means per seed
    evaluations.jsonl   a line per evaluation during training
    evaluation.json     what `guider evaluate` found last
    checkpoints/        the whole training state, newest two
    plots/              what `guider plot` drew
    .lock               who trains it, while somebody does (see guider.support.locks)
Symbolic links in it are refused: a run from elsewhere must not make us read or write outside it.
"""

from __future__ import annotations

import platform
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from guider.data import AS_FOUND, Reading
from guider.data.episodes import Spaces
from guider.data.goal_spaces import check_computed
from guider.errors import GuiderError
from guider.learning.training import Position, seed_keys
from guider.methods import find_method
from guider.methods.policy import Policy
from guider.methods.view import Scale, unit_scale
from guider.runs import checkpoint
from guider.support import plugins
from guider.support.config import from_dict, merged, to_dict
from guider.support.files import checked, parse_json, user_path, walk

FORMAT = 13
EARLIER = tuple(range(6, FORMAT))
"""Read too: settings that came later have defaults that are what was done before."""


@dataclass(frozen=True)
class RunSpec:
    """What determines a run, to the bit, on one machine.

    task: benchmark task, None for one's own data; data: where the episodes came from; reading: how they were read;
    fingerprint: of the episodes trained on; held_out: fraction of episodes kept for `guider evaluate`; config: the
    method's settings; spaces: dimensions, names and bounds.
    """

    task: str | None
    data: str
    reading: Reading
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
        return find_method(self.spec.method).stages(self.spec.config)

    def restore(self) -> tuple[Position, Any] | None:
        """The newest checkpoint, (position, state of all seeds), or None where there is none yet."""

        def fits(step: int, position: Position) -> bool:
            stages = self.stages
            return (
                0 <= position.stage < len(stages)
                and 0 < position.update <= stages[position.stage].updates
                and step == total_updates(stages, position)
            )

        return checkpoint.restore(self.directory / "checkpoints", _state_template(self.spec), fits)

    def policies(self) -> list[Policy]:
        """The trained policy of every seed. Raises GuiderError while training is unfinished."""
        restored = self.restore()
        if restored is None:
            raise GuiderError(f"{self.directory} holds no checkpoint yet; {_finish(self.directory)}")
        position, state = restored
        last = self.stages[-1]
        if position != Position(len(self.stages) - 1, last.updates):
            raise GuiderError(f"{self.directory} stopped {self.progress(position)}; {_finish(self.directory)}")
        return policies(self.spec, state)

    def progress(self, position: Position) -> str:
        """How far a run at `position` is, in words."""
        stage = self.stages[position.stage]
        return f"after {position.update} of {stage.updates} updates of the {stage.name} stage"


def _finish(directory: Path) -> str:
    return f"finish it with {how_to_resume(directory)}"


def how_to_resume(directory: Path) -> str:
    return f"`guider train --resume {shlex.quote(str(directory))}`"


def policies(spec: RunSpec, state: Any) -> list[Policy]:
    """One policy per seed from a state whose leaves are [seeds, ...]."""
    check_computed(spec.spaces)
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
            computed=spec.spaces.computed,
            computed_entries=sum(spec.spaces.computed_widths),
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


def open_run(directory: str | Path) -> Run:
    """The run in `directory`. Raises GuiderError if it is not one, or was written by another version."""
    directory = Path(directory)
    path = directory / "run.json"
    try:
        values = parse_json(path)
        refuse_links(directory)
    except (FileNotFoundError, NotADirectoryError):
        raise GuiderError(f"{directory} is not a run: it has no run.json") from None
    except OSError as error:
        raise GuiderError(f"{path} cannot be read: {error.strerror}") from error
    if (made := values.get("run_format")) not in (FORMAT, *EARLIER):
        raise GuiderError(f"{path} was written by another version of guider (this one reads run format {FORMAT})")
    values = checked(path, values, "put the original back, or train the run anew")
    for name in ("run_format", "made_with", "trained_on", "facts"):
        values.pop(name, None)
    try:
        method = find_method(str(values.get("method")))
    except GuiderError as error:
        raise GuiderError(f"{path}: {error}") from None
    settings = values.pop("config", {})
    if made in EARLIER and isinstance(settings, dict):
        settings = merged(to_dict(method.config_type()), settings)
        said = {name: values.pop(name) for name in ("format", "episode_ends") if name in values}
        values.setdefault("reading", to_dict(AS_FOUND) | said)
        later = {"state_names": [], "action_names": [], "computed": [], "computed_widths": [], "example": []}
        values["spaces"] = later | dict(values.get("spaces") or {})
    config = from_dict(method.config_type, settings, f"{path}: config")
    spec = from_dict(RunSpec, {**values, "config": config}, str(path))
    plugins.check_environment(spec.task or "", path)
    return Run(directory, spec)


def as_run(run: str | Path | Run) -> Run:
    """A run, from its directory unless it is one already. Raises GuiderError as `open_run` does."""
    return run if isinstance(run, Run) else open_run(user_path(run))


def total_updates(stages: Sequence[Any], position: Position) -> int:
    """Updates done over all stages at `position`."""
    return sum(stage.updates for stage in stages[: position.stage]) + position.update


def refuse_links(directory: Path) -> None:
    """Raise GuiderError where anything in a run is a symbolic link, or neither file nor folder."""
    for _ in walk(directory):
        pass


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


def initialiser(spec: RunSpec, scale: Scale) -> Callable[[jax.Array], Any]:
    """key -> one seed's fresh state."""
    return lambda key: find_method(spec.method).init(spec.config, spec.spaces, scale, key)


@lru_cache(maxsize=8)
def _state_template(spec: RunSpec) -> Any:
    init = initialiser(spec, unit_scale(spec.config.view, spec.spaces))
    return jax.eval_shape(jax.vmap(init), seed_keys(spec.seeds))
