"""Saving episodes, whatever they were read from, in the layouts that others read."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from guider.data.episodes import Episodes
from guider.data.store import Recording
from guider.data.write import FLAG_BYTES_PER_ROW, in_new_place, write_d4rl, write_minari, write_npz, write_ogbench
from guider.errors import GuiderError, GuiderWarning
from guider.support.extras import extra

LAYOUTS: Mapping[str, str] = {
    "plain": "npz: observations, actions, lengths, goals, bounds, names, goal entries; nothing is lost",
    "d4rl": "HDF5: observations, actions, rewards, terminals, timeouts",
    "ogbench": "npz: observations, actions, terminals",
    "minari": "a directory in Minari's format",
    "lerobot": "a directory in LeRobot's format, version 2.1; needs the extra `parquet`",
}
_ENDINGS: Mapping[str, tuple[str, ...]] = {
    "plain": (".npz",),
    "d4rl": (".hdf5", ".h5"),
    "ogbench": (".npz",),
    "minari": ("",),
    "lerobot": ("",),
}


def save(
    episodes: Episodes,
    path: Path,
    layout: str | None = None,
    *,
    fps: float = 10.0,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> str:
    """Write episodes to `path`, which must be new, and return the layout. It appears only when it is complete.

    layout: one of LAYOUTS; None tells it by the ending of the path's name: .npz is plain, .hdf5 d4rl, none minari
    fps:    steps a second, which LeRobot's says; report: called with (episodes done, episodes in all) where that takes
            a while

    Raises GuiderError for an ending that is not the layout's, where something is there already, and where it cannot be
    written.
    """
    layout = _layout(path, layout)
    if os.path.lexists(path):
        raise GuiderError(f"{path} exists already and is never overwritten; choose another name")
    if not fps > 0:
        raise GuiderError(f"--fps must be a number above 0, got {fps}")
    if episodes.computed:
        message = (
            f"{path}: what was computed for the goal is written as if it had been logged; leave --goal out here and "
            "give it to `guider train`, for a policy that computes it itself"
        )
        warnings.warn(GuiderWarning(message), stacklevel=2)
    recording = _recording(episodes)
    if layout == "d4rl":
        write_d4rl(path, recording, episodes.goal_indices, radius=0.0)
    elif layout == "minari":
        write_minari(
            path,
            recording,
            episodes.goal_indices,
            radius=0.0,
            dataset_id=f"own/{''.join(c if c.isalnum() else '-' for c in path.name) or 'logs'}-v0",
            recipe="logged",
            description=f"converted from {episodes.source}",
            seed=0,
            report=report,
        )
    elif layout == "lerobot":
        _write_lerobot(path, episodes, fps, report)
    elif layout == "ogbench":
        write_ogbench(path, recording)
    else:
        write_npz(path, _plain(episodes))
    return layout


def _layout(path: Path, asked: str | None) -> str:
    """The layout asked for, or else the first that the path's ending is of."""
    for layout in LAYOUTS if asked is None else (asked,):
        if path.suffix.lower() in _ENDINGS.get(layout, ()):
            return layout
    listed = ", ".join(f"{layout} ({' or '.join(endings) or 'none'})" for layout, endings in _ENDINGS.items())
    raise GuiderError(f"{path}: its ending is not its layout's; they are {listed}")


def _recording(episodes: Episodes) -> Recording:
    return Recording(
        episodes.observations,
        episodes.actions,
        episodes.lengths,
        episodes.goals,
        episodes.action_low,
        episodes.action_high,
    )


def _plain(episodes: Episodes) -> dict[str, np.ndarray]:
    arrays = {
        "observations": episodes.observations,
        "actions": episodes.actions,
        "lengths": episodes.lengths,
        "action_low": episodes.action_low,
        "action_high": episodes.action_high,
        "goal_indices": np.array(episodes.goal_indices),
    }
    named = {"state_names": episodes.state_names, "action_names": episodes.action_names}
    goals = {} if episodes.goals is None else {"goals": episodes.goals}
    return arrays | goals | {key: np.array(names) for key, names in named.items() if names}


def _write_lerobot(directory: Path, episodes: Episodes, fps: float, report: Callable[[int, int], None]) -> None:
    """A table an episode, with a row for each state; the last row's action, which nothing follows, is the one
    before."""
    with extra("parquet", "pyarrow, which writes parquet,"):
        import pyarrow
        from pyarrow import parquet
    names = {"observation.state": episodes.state_names, "action": episodes.action_names}
    widths = {"observation.state": episodes.observations.shape[1], "action": episodes.actions.shape[1]}
    vectors = {
        key: {"dtype": "float32", "shape": [width], "names": list(names[key]) or [str(i) for i in range(width)]}
        for key, width in widths.items()
    }
    numbers = {
        key: {"dtype": "int64", "shape": [1], "names": None} for key in ("frame_index", "episode_index", "index")
    }
    info = {
        "codebase_version": "v2.1",
        "robot_type": "unknown",
        "total_episodes": len(episodes.starts),
        "total_frames": len(episodes.observations),
        "total_tasks": 1,
        "total_videos": 0,
        "total_chunks": 1,
        "chunks_size": max(1000, len(episodes.starts)),
        "fps": fps,
        "splits": {"train": f"0:{len(episodes.starts)}"},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": None,
        "features": {
            **vectors,
            "timestamp": {"dtype": "float32", "shape": [1], "names": None},
            **numbers,
            "task_index": {"dtype": "int64", "shape": [1], "names": None},
        },
    }
    size = episodes.observations.nbytes + episodes.actions.nbytes + FLAG_BYTES_PER_ROW * len(episodes.observations)
    with in_new_place(directory, size) as partial:
        data = partial / "data" / "chunk-000"
        data.mkdir(parents=True)
        (partial / "meta").mkdir()
        lines: dict[str, list[Any]] = {"episodes": [], "episodes_stats": [], "tasks": [{"task_index": 0, "task": ""}]}
        for number, (start, length) in enumerate(zip(episodes.starts, episodes.lengths, strict=True)):
            rows = slice(start, start + length)
            actions = episodes.actions[rows].copy()
            actions[-1] = actions[-2]
            columns = {
                "observation.state": episodes.observations[rows],
                "action": actions,
                "timestamp": (np.arange(length) / fps).astype(np.float32),
                "frame_index": np.arange(length),
                "episode_index": np.full(length, number),
                "index": np.arange(start, start + length),
                "task_index": np.zeros(length, np.int64),
            }
            arrow = {key: _arrow(pyarrow, column) for key, column in columns.items()}
            parquet.write_table(pyarrow.table(arrow), data / f"episode_{number:06d}.parquet")
            lines["episodes"].append({"episode_index": number, "tasks": [""], "length": int(length)})
            stats = {key: _statistics(column) for key, column in columns.items()}
            lines["episodes_stats"].append({"episode_index": number, "stats": stats})
            report(number + 1, len(episodes.starts))
        for name, items in lines.items():
            (partial / "meta" / f"{name}.jsonl").write_text("".join(json.dumps(item) + "\n" for item in items))
        (partial / "meta" / "info.json").write_text(json.dumps(info, indent=4) + "\n")
        os.replace(partial, directory)


def _arrow(pyarrow: Any, column: np.ndarray) -> Any:
    if column.ndim == 1:
        return pyarrow.array(column)
    return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(column.reshape(-1)), column.shape[1])


def _statistics(column: np.ndarray) -> dict[str, list[Any]]:
    column = column.reshape(len(column), -1).astype(np.float64)
    found = {
        "min": column.min(axis=0),
        "max": column.max(axis=0),
        "mean": column.mean(axis=0),
        "std": column.std(axis=0),
    }
    return {name: values.tolist() for name, values in found.items()} | {"count": [len(column)]}
