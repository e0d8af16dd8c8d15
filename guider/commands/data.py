"""`guider data`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, Unpack

import tyro

from guider.commands.options import Json
from guider.commands.screen import answer, bar
from guider.errors import GuiderError
from guider.learning.options import LearningOptions


def data(
    action: tyro.conf.Positional[Literal["inspect", "fetch"]],
    source: tyro.conf.Positional[str | None] = None,
    task: str | None = None,
    out: Path | None = None,
    mirror: str | None = None,
    as_json: Json = False,
    **learning: Unpack[LearningOptions],
) -> None:
    """Look at logged data, or fetch what others published.

    `guider data inspect SOURCE` reads it as training would and says what it holds; with --task or --radius also what
    share of it training would learn from. `guider data fetch` lists what can be fetched; `guider data fetch NAME`
    fetches and checks it, going on where an earlier download broke off.

    Args:
        action: inspect or fetch.
        source: What to inspect: HDF5, npz, a pickle of WGCSL's, a Minari directory or minari:ID. Or a name to fetch.
        task: inspect: the benchmark that it is for.
        out: fetch: directory for the files; by default GUIDER_DATA, or else ~/.cache/guider.
        mirror: fetch: URL of a folder that holds the files under their own names, tried first.
        as_json: Print one JSON document instead of text.
    """
    from guider import api
    from guider.data.catalogue import CATALOGUE, find_dataset
    from guider.data.download import fetch

    if action == "fetch" and (task is not None or learning):
        raise GuiderError("guider data fetch takes --out and --mirror only; the other options are for inspect")
    if action == "inspect" and (out is not None or mirror is not None):
        raise GuiderError("guider data inspect takes no --out and no --mirror; they are for fetch")
    if action == "inspect":
        if source is None:
            raise GuiderError("say what to inspect: guider data inspect SOURCE")
        description = api.inspect(source, task=task, **learning)
        shown = description | {"episode_ends": _end_signs(description["episode_ends"])}
        lines = [f"{name.replace('_', ' '):>20}  {_short(value)}" for name, value in shown.items()]
        answer(description, "\n".join(lines), as_json)
    elif source is None and (out is not None or mirror is not None):
        raise GuiderError("say what to fetch: guider data fetch NAME; without a name it lists what there is")
    elif source is None:
        rows = [{"name": found.name, "source": found.source} for found in CATALOGUE.values()]
        answer(rows, "\n".join(f"{row['name']:32}  {row['source']}" for row in rows), as_json)
    else:
        dataset = find_dataset(source)
        with bar("fetching", "MB") as show:
            paths = fetch(
                dataset, out, mirror, report=lambda done, total: show(done // 10**6, total and total // 10**6)
            )
        files = [str(path) for path in paths]
        answer({"name": source, "files": files}, "\n".join(f"{file} is complete" for file in files), as_json)


def _end_signs(signs: list[dict[str, Any]]) -> str:
    """How many ends each sign gave, those taken first."""
    taken, others = (
        ", ".join(f"{sign['name']} {sign['ends']:,}" for sign in signs if sign["used"] == used)
        for used in (True, False)
    )
    return taken + (f" (not taken: {others})" if others else "")


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_short(item)}" for name, item in value.items())
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return "; ".join(map(_short, value))
    return str(value)
