"""Published data that can be fetched by name: which files, and where they are."""

from __future__ import annotations

from dataclasses import dataclass

from guider.errors import GuiderError, names_like

MINARI_PREFIX = "minari:"

_D4RL = "https://rail.eecs.berkeley.edu/datasets/offline_rl"
_D4RL_MIRROR = "https://huggingface.co/datasets/imone/D4RL/resolve/main"
_OGBENCH = "https://rail.eecs.berkeley.edu/datasets/ogbench"


@dataclass(frozen=True)
class RemoteFile:
    """One file.

    urls:   where it is, in the order they are tried
    keys:   arrays that it must hold
    sha256: hex digest of its content, None where nobody has published one
    """

    name: str
    urls: tuple[str, ...]
    keys: tuple[str, ...]
    sha256: str | None = None


@dataclass(frozen=True)
class Dataset:
    """What a name stands for. Minari's have no files here: its own package fetches them.

    source: who published it
    """

    name: str
    source: str
    files: tuple[RemoteFile, ...] = ()


def find_dataset(name: str) -> Dataset:
    """The data called `name`; 'minari:ID' may name any of Minari's. Raises GuiderError, with names like it, if there is
    none.
    """
    if name in CATALOGUE:
        return CATALOGUE[name]
    if name.startswith(MINARI_PREFIX):
        return Dataset(name, "Minari")
    raise GuiderError(f"no data is called {name!r}; {names_like(name, CATALOGUE)} (`guider data fetch` lists all)")


def _d4rl(name: str, path: str, sha256: str | None = None) -> Dataset:
    file = path.rsplit("/", 1)[-1]
    urls = (f"{_D4RL}/{path}", f"{_D4RL_MIRROR}/{file}")
    return Dataset(
        name, "D4RL", (RemoteFile(file, urls, ("observations", "actions", "terminals", "timeouts"), sha256),)
    )


def _d4rl_antmaze(name: str, maze: str, starts: bool, goals: bool, sha256: str | None = None) -> Dataset:
    """starts, goals: whether they differ from episode to episode."""
    file = f"Ant_maze_{maze}_noisy_multistart_{starts}_multigoal_{goals}_sparse_fixed.hdf5"
    return _d4rl(name, f"ant_maze_v2/{file}", sha256)


def _ogbench(name: str) -> Dataset:
    files = (f"{name}.npz", f"{name}-val.npz")
    keys = ("observations", "actions", "terminals")
    return Dataset(name, "OGBench", tuple(RemoteFile(file, (f"{_OGBENCH}/{file}",), keys) for file in files))


def _names(robot: str, places: str, kinds: str) -> list[str]:
    return [f"{robot}-{place}-{kind}-v0" for place in places.split() for kind in kinds.split()]


_OGBENCH_NAMES = (
    *_names("pointmaze", "medium large giant teleport", "navigate stitch"),
    *_names("antmaze", "medium large giant teleport", "navigate stitch"),
    *_names("antmaze", "medium large teleport", "explore"),
    *_names("humanoidmaze", "medium large giant", "navigate stitch"),
    *_names("antsoccer", "arena medium", "navigate stitch"),
    *_names("cube", "single double triple quadruple", "play noisy"),
    *("scene-play-v0", "scene-noisy-v0"),
    *_names("puzzle", "3x3 4x4 4x5 4x6", "play noisy"),
)
_MINARI_IDS = (
    *(f"D4RL/kitchen/{kind}-v2" for kind in ("complete", "partial", "mixed")),
    *(f"D4RL/pointmaze/{maze}-v2" for maze in ("umaze", "medium", "large")),
)

# Checksums are those that users of these files have recorded publicly.
_DATASETS = (
    _d4rl_antmaze(
        "antmaze-umaze", "u-maze", False, False, "5ef15257771c50ef4d23c7de001750e96c8bb5d9b6a5e4a821dcfb3065fbd130"
    ),
    _d4rl_antmaze("antmaze-umaze-diverse", "u-maze", True, True),
    _d4rl_antmaze("antmaze-medium-play", "big-maze", True, False),
    _d4rl_antmaze("antmaze-medium-diverse", "big-maze", True, True),
    _d4rl_antmaze("antmaze-large-play", "hardest-maze", True, False),
    _d4rl_antmaze("antmaze-large-diverse", "hardest-maze", True, True),
    _d4rl(
        "kitchen-complete",
        "kitchen/mini_kitchen_microwave_kettle_light_slider-v0.hdf5",
        "cd797c38cd52dfbe3f960cef73935cc724847abd189e47a703a7a2315ed60a81",
    ),
    _d4rl(
        "kitchen-partial",
        "kitchen/kitchen_microwave_kettle_light_slider-v0.hdf5",
        "57bfd9c5fe88a7cf702bbaf8b7cd800d30cd869e7f73416007238d26cd859800",
    ),
    _d4rl(
        "kitchen-mixed",
        "kitchen/kitchen_microwave_kettle_bottomburner_light-v0.hdf5",
        "a30382a50278fdaea2e2d88e5f2836a95bcf9b581d252617872fd6537302721b",
    ),
    *(_ogbench(name) for name in _OGBENCH_NAMES),
    *(Dataset(f"{MINARI_PREFIX}{dataset_id}", "Minari") for dataset_id in _MINARI_IDS),
)
CATALOGUE: dict[str, Dataset] = {dataset.name: dataset for dataset in _DATASETS}
