"""A run's data, found again."""

from __future__ import annotations

from pathlib import Path

from guider.data.episodes import IN_MEMORY, Episodes
from guider.data.goal_spaces import check_computed, with_computed
from guider.errors import GuiderError
from guider.runs.asked import episodes_of
from guider.runs.run import Run, RunSpec
from guider.support.files import user_path


def same_data(run: Run, data: str | Path | Episodes | None) -> Episodes:
    """The run's data, from `data` if it has moved. Raises GuiderError if it is not the same, and where what
    is computed of it is not."""
    spec = run.spec
    if data is None and spec.data == IN_MEMORY:
        raise GuiderError(f"{run.directory} was trained on arrays in memory; give the same Episodes (data=episodes)")
    check_computed(spec.spaces)
    try:
        given = spec.data if data is None else data
        episodes = _read(given, spec)
    except GuiderError as error:
        if data is not None:
            raise
        raise GuiderError(f"{error} (what {run.directory} was trained on; if it has moved: --data PLACE)") from error
    fingerprint = episodes.fingerprint()
    if fingerprint != spec.fingerprint:
        raise GuiderError(
            f"{episodes.source} (fingerprint {fingerprint}) is not the data {run.directory} was trained on "
            f"({spec.data}, fingerprint {spec.fingerprint}); give that with --data"
        )
    return episodes


def _read(given: str | Path | Episodes, spec: RunSpec) -> Episodes:
    """With what the run computed of its states, unless that is there already."""
    computed, indices = spec.spaces.computed, spec.spaces.goal_indices
    if not computed:
        return episodes_of(given, indices, reading=spec.reading)
    episodes = episodes_of(given, None, reading=spec.reading, assumed_goal=(0,))
    return with_computed(episodes, computed[len(episodes.computed) :]).with_goal_space(indices)


def lasting(data: str | Path | Episodes | None, episodes: Episodes) -> str:
    """The data's name, such that it is found again from another directory."""
    path = None if isinstance(data, Episodes) else user_path(episodes.source)
    return str(path.absolute()) if path is not None and path.exists() else episodes.source
