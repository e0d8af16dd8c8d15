"""`guider data`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import tyro

from guider.commands.options import Json
from guider.commands.screen import answer, bar
from guider.errors import GuiderError


def data(
    action: tyro.conf.Positional[Literal["inspect", "fetch"]],
    source: tyro.conf.Positional[str | None] = None,
    task: str | None = None,
    goal_indices: tuple[int, ...] = (),
    radius: float | None = None,
    reach_radius: float | None = None,
    period_steps: int | None = None,
    format: str | None = None,
    episode_ends: tuple[str, ...] = (),
    out: Path | None = None,
    mirror: str | None = None,
    as_json: Json = False,
) -> None:
    """Look at logged data, or fetch what others published.

    `guider data inspect SOURCE` reads it as training would and says what it holds; with --task or --radius also what
    share of it training would learn from. `guider data fetch` lists what can be fetched; `guider data fetch NAME`
    fetches and checks it, going on where an earlier download broke off.

    Args:
        action: inspect or fetch.
        source: What to inspect: HDF5, npz, a pickle of WGCSL's, a Minari directory or minari:ID. Or a name to fetch.
        task: inspect: the benchmark that it is for.
        goal_indices: inspect: the state entries that are the goal; by default the source's own, or else 0 1.
        radius: inspect: a goal counts as met within this distance, as for `guider train`.
        reach_radius: inspect: as for `guider train`.
        period_steps: inspect: as for `guider train`.
        format: inspect: how to read it, if its content does not tell: arrays, d4rl-kitchen, minari, wgcsl.
        episode_ends: inspect: which signs of where episodes end to take, of those listed.
        out: fetch: directory for the files; by default GUIDER_DATA, or else ~/.cache/guider.
        mirror: fetch: URL of a folder that holds the files under their own names, tried first.
        as_json: Print one JSON document instead of text.
    """
    from guider import api
    from guider.data.catalogue import CATALOGUE, find_dataset
    from guider.data.download import fetch

    reading = (task, radius, reach_radius, period_steps, format)
    if action == "fetch" and (any(value is not None for value in reading) or goal_indices or episode_ends):
        raise GuiderError("guider data fetch takes --out and --mirror only; the other options are for inspect")
    if action == "inspect" and (out is not None or mirror is not None):
        raise GuiderError("guider data inspect takes no --out and no --mirror; they are for fetch")
    if action == "inspect":
        if source is None:
            raise GuiderError("say what to inspect: guider data inspect SOURCE")
        description = api.inspect(
            source,
            task=task,
            goal_indices=goal_indices or None,
            radius=radius,
            reach_radius=reach_radius,
            period_steps=period_steps,
            format=format,
            episode_ends=episode_ends,
        )
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
