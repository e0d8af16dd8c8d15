"""Training into a run directory: from the beginning or from its newest checkpoint, and safe to stop at any moment."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes
from guider.errors import GuiderError, GuiderWarning, Stopped
from guider.learning.processor import describe, settled
from guider.learning.training import Chunk, Position, init_seeds, train
from guider.methods.view import prepare
from guider.runs import checkpoint, stage_cache
from guider.runs.run import (
    FORMAT,
    Pace,
    Run,
    RunSpec,
    how_to_resume,
    initialiser,
    refuse_links,
    total_updates,
    versions,
)
from guider.support.config import to_dict
from guider.support.files import append_line, clear_leftovers, read_lines, shortened, temporary, write_json, write_text
from guider.support.locks import hold
from guider.support.stopping import on_signals

LONGEST_PATH = 3800
"""Bytes of a run's directory; what lies in it has longer names, up to the system's 4096."""


def start(
    directory: Path,
    spec: RunSpec,
    facts: dict[str, Any],
    episodes: Episodes,
    on_chunk: Callable[[Chunk, Any], None],
    pace: Pace,
    cache: Path | None = None,
) -> Run:
    """Train a new run from the beginning, but for stages that `cache` knows (see guider.runs.stage_cache).

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
    more = f", or continue it with {how_to_resume(directory)}" if (directory / "run.json").exists() else ""
    raise GuiderError(f"{directory} exists already and is never overwritten; choose another --out{more}")


@contextmanager
def _only_trainer(run: Run) -> Iterator[None]:
    """Within, this process alone trains the run; what killed ones left behind is removed."""
    directory = run.directory
    with _writing(directory, "make it writable"), ExitStack() as held:
        held.enter_context(hold(directory / ".lock", f"{directory} is being trained"))
        refuse_links(directory)
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
        state = init_seeds(initialiser(spec, scale), spec.seeds)
    else:
        reached, state = restored
        state = jax.tree.map(jnp.asarray, state)
    stages = run.stages
    metrics = run.directory / "metrics.jsonl"
    kept = f"what was saved last stays; once it can be written, go on with {how_to_resume(run.directory)}"
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
            raise Stopped(f"interrupted, not saved since; go on with {how_to_resume(run.directory)}", number)
        asked.append(number)

    def stopped() -> Stopped:
        return Stopped(f"interrupted {run.progress(reached)}; go on with {how_to_resume(run.directory)}", asked[0])

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


def _drop_later_lines(path: Path, total: int) -> None:
    """Forget lines written after the checkpoint that training continues from."""
    if path.exists():
        kept = [line for line in read_lines(path) if line["total_updates"] <= total]
        write_text(path, "".join(json.dumps(line) + "\n" for line in kept))
