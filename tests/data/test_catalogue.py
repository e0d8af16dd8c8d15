"""What can be fetched by name, and Minari, whose package does the work and whose word is not taken for it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from loopback import whole
from recordings import walk

from guider.cli import main
from guider.data.catalogue import CATALOGUE, find_dataset
from guider.data.download import fetch
from guider.data.store import Recording
from guider.data.write import write_minari
from guider.errors import GuiderError


def test_catalogue():
    diverse = CATALOGUE["antmaze-large-diverse"].files[0]
    assert diverse.urls[0] == (
        "https://rail.eecs.berkeley.edu/datasets/offline_rl/ant_maze_v2/"
        "Ant_maze_hardest-maze_noisy_multistart_True_multigoal_True_sparse_fixed.hdf5"
    )
    assert [file.name for file in CATALOGUE["antmaze-giant-stitch-v0"].files] == [
        "antmaze-giant-stitch-v0.npz",
        "antmaze-giant-stitch-v0-val.npz",
    ]
    files = [file for found in CATALOGUE.values() for file in found.files]
    assert len({file.name for file in files}) == len(files)
    assert all(url.startswith("https://") and url.endswith(file.name) for file in files for url in file.urls)
    assert all(file.sha256 is None or re.fullmatch("[0-9a-f]{64}", file.sha256) for file in files)
    with pytest.raises(GuiderError, match="did you mean kitchen-complete"):
        find_dataset("kitchen-completed")
    assert find_dataset("minari:any/thing-v3").source == "Minari"


def test_fetch_command(site, folder, content, capsys, monkeypatch):
    monkeypatch.setenv("GUIDER_DATA", str(folder))
    site.replies = [whole(content)]
    assert main(["data", "fetch", "antmaze-large-diverse", "--mirror", site.url, "--json"]) == 0
    (file,) = json.loads(capsys.readouterr().out)["files"]
    assert Path(file).parent == folder and Path(file).read_bytes() == content
    assert main(["data", "fetch", "--json"]) == 0
    listed = {row["name"] for row in json.loads(capsys.readouterr().out)}
    assert {"antmaze-large-diverse", "kitchen-mixed", "cube-single-play-v0"} <= listed
    assert main(["data", "fetch", "antmaze-larg-diverse"]) == 1
    assert "did you mean antmaze-large-diverse" in capsys.readouterr().err
    assert main(["data", "inspect"]) == 1
    assert "guider data inspect SOURCE" in capsys.readouterr().err


@pytest.fixture
def minari_root(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


def write_small_minari(directory: Path) -> None:
    arrays = walk([4, 6])
    directory.parent.mkdir(parents=True, exist_ok=True)
    recording = Recording(arrays["observations"], arrays["actions"], np.array([4, 6]))
    write_minari(directory, recording, (0, 1), 0.5, dataset_id="test/walk-v0", recipe="", description="", seed=0)


def test_minari_is_fetched_by_its_package_and_then_read(minari_root, monkeypatch, capsys):
    def download(dataset_id: str) -> None:
        print(f"Dataset {dataset_id} downloaded")
        write_small_minari(minari_root / dataset_id)

    monkeypatch.setattr("minari.download_dataset", download)
    assert main(["data", "fetch", "minari:test/walk-v0", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == [str(minari_root / "test" / "walk-v0")]
    monkeypatch.setattr("minari.download_dataset", None)
    assert fetch(find_dataset("minari:test/walk-v0")) == [minari_root / "test" / "walk-v0"]


def test_minari_that_leads_elsewhere_is_not_opened(minari_root, monkeypatch):
    write_small_minari(minari_root / "test" / "walk-v0")
    file = minari_root / "test" / "walk-v0" / "data" / "main_data.hdf5"
    file.rename(minari_root / "elsewhere")
    file.symlink_to(minari_root / "elsewhere")
    monkeypatch.setattr("minari.load_dataset", None)
    with pytest.raises(GuiderError, match=r"main_data\.hdf5 in the dataset is a symbolic link"):
        fetch(find_dataset("minari:test/walk-v0"))


@pytest.mark.parametrize("left", ["nothing", "an empty folder", "half of the data"])
def test_minari_that_says_downloaded_and_is_not(minari_root, monkeypatch, left):
    def download(dataset_id: str) -> None:
        if left == "an empty folder":
            (minari_root / dataset_id / "data").mkdir(parents=True)
        if left == "half of the data":
            write_small_minari(minari_root / dataset_id)
            file = minari_root / dataset_id / "data" / "main_data.hdf5"
            file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])

    monkeypatch.setattr("minari.download_dataset", download)
    for _ in range(2):
        with pytest.raises(GuiderError, match="minari:test/walk-v0 was not fetched whole") as raised:
            fetch(find_dataset("minari:test/walk-v0"))
        assert "\n" not in str(raised.value)


def test_minari_decides_where_its_data_is(folder):
    for arguments in ((folder, None), (None, "http://127.0.0.1")):
        with pytest.raises(GuiderError, match="MINARI_DATASETS_PATH"):
            fetch(find_dataset("minari:test/walk-v0"), *arguments)
