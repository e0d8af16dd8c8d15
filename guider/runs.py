"""Training runs on disk: start, record, resume, load.

A run is a directory:
    run.json            everything that determines the run (RunSpec), and what it was made with
    metrics.jsonl       a line per chunk of updates: stage, update, seconds, means per seed
    evaluations.jsonl   a line per evaluation during training
    evaluation.json     what `guider evaluate` found last
    checkpoints/        the whole training state, newest two
    plots/              what `guider plot` drew
    .lock               who trains it, while somebody does (see guider.locks)
Symbolic links in it are refused: a run from elsewhere must not make us read or write outside it.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shlex
import shutil
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from guider import checkpoint, stage_cache
from guider.config import from_dict, to_dict
from guider.episodes import Episodes, Spaces
from guider.errors import GuiderError, GuiderWarning, Stopped
from guider.files import (
    append_line,
    checked,
    clear_leftovers,
    parse_json,
    read_lines,
    shortened,
    temporary,
    walk,
    write_json,
    write_text,
)
from guider.locks import hold
from guider.methods import METHODS
from guider.methods.view import Scale, prepare, unit_scale
from guider.policy import Policy
from guider.processor import describe, settled
from guider.stopping import on_signals
from guider.training import Chunk, Position, init_seeds, seed_keys, train

FORMAT = 6
LONGEST_PATH = 3800
"""Bytes of a run's directory; what lies in it has longer names, up to the system's 4096."""


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
    return f"finish it with {_resume(directory)}"


def _resume(directory: Path) -> str:
    return f"`guider train --resume {shlex.quote(str(directory))}`"


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

    facts: what was found about the data, for people to read in run.json. The run's spec has the precision that `auto`
    means on this machine, and keeps it. Raises GuiderError if `directory` is taken, Stopped as `resume` does.
    """
    check_free(directory)
    spec = replace(spec, config=replace(spec.config, precision=settled(spec.config.precision)))
    prepared = _prepare(spec, episodes)
    run = Run(directory, spec)
    new = temporary(directory)
    with _writing(directory, "choose another --out, or make room there"):
        try:
            directory.parent.mkdir(parents=True, exist_ok=True)
            clear_leftovers(directory.parent, re.escape(shortened(directory.name)))
            new.mkdir()
            about = {"facts": facts, "made_with": versions(), "trained_on": describe()}
            write_json(new / "run.json", {"run_format": FORMAT, **to_dict(spec), **about})
            check_free(directory)
            new.rename(directory)
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
    with _only_trainer(run):
        _train(run, prepared, None, on_chunk, pace, cache)
    return run


def resume(
    run: Run,
    episodes: Callable[[], Episodes],
    on_chunk: Callable[[Chunk, Any], None],
    pace: Pace,
    cache: Path | None = None,
) -> None:
    """Continue a run from its newest checkpoint, or from the beginning where it has none yet.

    The result is bit-equal to that of an uninterrupted run, if `episodes()` are those of the spec's fingerprint.
    Raises GuiderError, before any work, while another process trains the run; Stopped where SIGINT or SIGTERM asked
    for it, once the state is saved.
    """
    with _only_trainer(run):
        restored = run.restore()
        _train(run, _prepare(run.spec, episodes()), restored, on_chunk, pace, cache)


def check_free(directory: Path) -> None:
    """Raise GuiderError where no new run can be: something is there, or the system takes no such name."""
    if len(os.fsencode(directory.absolute())) > LONGEST_PATH:
        raise GuiderError(f"{str(directory)[:40]}... is too long a name for a run; choose another --out")
    try:
        os.lstat(directory)
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:
        raise GuiderError(f"{str(directory)[:40]}: no run can be there ({error}); choose another --out") from error
    more = f", or continue it with {_resume(directory)}" if (directory / "run.json").exists() else ""
    raise GuiderError(f"{directory} exists already and is never overwritten; choose another --out{more}")


@contextmanager
def _only_trainer(run: Run) -> Iterator[None]:
    """Within, this process alone trains the run; what killed ones left behind is removed."""
    directory = run.directory
    with _writing(directory, "make it writable"), ExitStack() as held:
        held.enter_context(hold(directory / ".lock", f"{directory} is being trained"))
        _refuse_links(directory)
        clear_leftovers(directory, r"(?:metrics|evaluations)\.jsonl|evaluation\.json")
        held = held.pop_all()
    with held:
        yield


@contextmanager
def _writing(place: Path, remedy: str) -> Iterator[None]:
    """Within, what cannot be written is told in a line."""
    try:
        yield
    except OSError as error:
        reason = f"{error.filename or place}: {error.strerror}" if error.strerror else str(error)
        raise GuiderError(f"{reason}; {remedy}") from error


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
    """Run the stages, logging every chunk; checkpoints come as `pace` says, at each stage's end, and on stopping."""
    spec = run.spec
    data, scale = prepared
    if restored is None:
        reached = Position(0, 0)
        state = init_seeds(_initialiser(spec, scale), spec.seeds)
    else:
        reached, state = restored
        state = jax.tree.map(jnp.asarray, state)
    stages = run.stages
    metrics = run.directory / "metrics.jsonl"
    kept = f"what was saved last stays; once it can be written, go on with {_resume(run.directory)}"
    with _writing(run.directory, kept):
        for path in (metrics, run.directory / "evaluations.jsonl"):
            _drop_later_lines(path, total_updates(stages, reached))
    if cache is not None:
        with _writing(cache, "make it writable, or leave --stage-cache out"):
            stage_cache.clear(cache)
    saved, saved_at = reached, time.monotonic()
    entry = None  # of the stage being trained, in the cache
    held = ExitStack()  # the lock of that entry
    told: set[str] = set()  # whom was waited for
    asked: list[int] = []  # numbers of the signals that asked training to stop

    def ask(number: int) -> None:
        """The same signal twice does not wait; a terminal's Ctrl-C and then the SIGTERM of a runner are one wish."""
        if number in asked:
            raise Stopped(f"interrupted, not saved since; go on with {_resume(run.directory)}", number)
        asked.append(number)

    def stopped() -> Stopped:
        return Stopped(f"interrupted {run.progress(reached)}; go on with {_resume(run.directory)}", asked[0])

    def save(state: Any) -> None:
        nonlocal saved, saved_at
        with _writing(run.directory, kept):
            checkpoint.save(run.directory / "checkpoints", total_updates(stages, reached), reached, state)
        saved, saved_at = reached, time.monotonic()

    def wait(message: str) -> None:
        if asked:
            raise stopped()
        if message not in told:
            warnings.warn(GuiderWarning(f"{message}; waiting to take it over"), stacklevel=2)
            told.add(message)

    def known(index: int, state: Any) -> Any:
        """What the cache has of a stage, entered into the run as if it had been trained here."""
        nonlocal reached, entry
        reached = Position(index, 0)
        if cache is None:
            return None
        stage, part = stages[index], getattr(state, stages[index].part)
        end = Position(index, stage.updates)
        entry = cache / stage_cache.stage_digest(stage, index, state, data, spec.seeds, versions())
        with _writing(cache, "make it writable, or leave --stage-cache out"):
            held.enter_context(stage_cache.training(entry, wait))
        found = stage_cache.find(entry, end, part)
        if found is None:
            return None
        held.close()
        part, lines = found
        with _writing(run.directory, kept):
            for line in lines:
                total = total_updates(stages, Position(index, line["update"]))
                append_line(metrics, line | {"total_updates": total})
        reached = end
        save(state._replace(**{stage.part: part}))
        return jax.tree.map(jnp.asarray, part)

    def record(chunk: Chunk, state: Any) -> None:
        nonlocal reached
        _check_finite(run, chunk)
        reached = chunk.position
        line = {
            "stage": chunk.stage.name,
            "update": reached.update,
            "total_updates": total_updates(stages, reached),
            "seconds": round(chunk.seconds, 4),
            "metrics": {name: np.asarray(value).tolist() for name, value in chunk.metrics.items()},
        }
        with _writing(run.directory, kept):
            append_line(metrics, line)
        on_chunk(chunk, state)
        stage_ends = reached.update == chunk.stage.updates
        if stage_ends or time.monotonic() - saved_at > pace.checkpoint_seconds:
            save(state)
        if stage_ends and entry is not None:
            lines = [line for line in read_lines(metrics) if line["stage"] == chunk.stage.name]
            try:
                stage_cache.keep(entry, reached, getattr(state, chunk.stage.part), lines)
            except OSError as error:
                warnings.warn(GuiderWarning(f"{entry} is not kept for other runs: {error}"), stacklevel=2)
            held.close()

    with (
        held,
        on_signals(ask, signal.SIGINT, signal.SIGTERM),
        jax.default_matmul_precision(spec.config.precision),
    ):
        state = train(
            stages,
            state,
            data,
            spec.seeds,
            start=reached,
            chunk_updates=pace.chunk_updates,
            on_chunk=record,
            known=known,
            stop=lambda: bool(asked),
        )
        if asked and reached != Position(len(stages) - 1, stages[-1].updates):
            if reached != saved:
                save(state)
            raise stopped()


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
        values = parse_json(path)
        _refuse_links(directory)
    except (FileNotFoundError, NotADirectoryError):
        raise GuiderError(f"{directory} is not a run: it has no run.json") from None
    except OSError as error:
        raise GuiderError(f"{path} cannot be read: {error.strerror}") from error
    if values.get("run_format") != FORMAT:
        raise GuiderError(f"{path} was written by another version of guider (this one reads run format {FORMAT})")
    values = checked(path, values, "put the original back, or train the run anew")
    for name in ("run_format", "made_with", "trained_on", "facts"):
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


def _refuse_links(directory: Path) -> None:
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


def _drop_later_lines(path: Path, total: int) -> None:
    """Forget lines written after the checkpoint that training continues from."""
    if path.exists():
        kept = [line for line in read_lines(path) if line["total_updates"] <= total]
        write_text(path, "".join(json.dumps(line) + "\n" for line in kept))


def _initialiser(spec: RunSpec, scale: Scale) -> Callable[[jax.Array], Any]:
    """key -> one seed's fresh state."""
    return lambda key: METHODS[spec.method].init(spec.config, spec.spaces, scale, key)


def _state_template(spec: RunSpec) -> Any:
    init = _initialiser(spec, unit_scale(spec.config.view, spec.spaces))
    return jax.eval_shape(jax.vmap(init), seed_keys(spec.seeds))
