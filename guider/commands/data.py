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
    what: tyro.conf.Positional[Literal["inspect", "convert", "fetch"]],
    source: tyro.conf.Positional[str | None] = None,
    destination: tyro.conf.Positional[Path | None] = None,
    task: str | None = None,
    out: Path | None = None,
    mirror: str | None = None,
    layout: str | None = None,
    fps: float = 10.0,
    report: Path | None = None,
    as_json: Json = False,
    **learning: Unpack[LearningOptions],
) -> None:
    """Look at logged data, convert it, or fetch what others published.

    `guider data inspect SOURCE` reads it as training would and says what it holds; with --task or --radius also what
    share of it training would learn from. `guider data convert SOURCE OUT` writes it in another layout: OUT.npz (plain,
    or --layout ogbench), OUT.hdf5 (D4RL's), OUT (a Minari directory, or --layout lerobot). `guider data fetch` lists
    what can be fetched; `guider data fetch NAME` fetches and checks it, going on where an earlier download broke off.

    Args:
        what: inspect, convert or fetch.
        source: What to look at: HDF5, npz, CSV, parquet, a pickle, a folder (LeRobot's, Minari's, a file an episode) or
            minari:ID. Or a name to fetch.
        destination: convert: the new file or directory.
        task: inspect: the benchmark that it is for.
        out: fetch: directory for the files; by default GUIDER_DATA, or else ~/.cache/guider.
        layout: convert: plain (npz, nothing is lost), d4rl, ogbench, minari or lerobot; by default as OUT ends.
        fps: convert: steps a second, for LeRobot's.
        report: inspect: a new HTML file for a page of it, with pictures.
        mirror: fetch: URL of a folder that holds the files under their own names, tried first.
        as_json: Print one JSON document instead of text.
    """
    from guider import api
    from guider.data.catalogue import CATALOGUE, find_dataset
    from guider.data.download import fetch

    if what == "fetch" and (task is not None or learning or destination is not None):
        raise GuiderError("guider data fetch takes --out and --mirror only; the other options are for inspect")
    if what != "fetch" and (out is not None or mirror is not None):
        raise GuiderError(f"guider data {what} takes no --out and no --mirror; they are for fetch")
    if what != "inspect" and report is not None:
        raise GuiderError(f"guider data {what} writes no page; --report is for inspect")
    if what != "convert" and (destination is not None or layout is not None):
        raise GuiderError(f"guider data {what} writes nothing; a second name and --layout are for convert")
    if what == "convert":
        if source is None or destination is None:
            raise GuiderError("say what to convert, and to what: guider data convert SOURCE OUT")
        with bar("writing", "episodes") as show:
            written = api.convert(source, destination, layout, fps=fps, report=show, **learning)
        path = str(destination)
        answer({"source": source, "written": path, "layout": written}, f"{path} is complete ({written})", as_json)
    elif what == "inspect":
        if source is None:
            raise GuiderError("say what to inspect: guider data inspect SOURCE")
        description = api.inspect(source, task=task, report=report, **learning)
        answer(description, _page(description), as_json)
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


def _page(description: dict[str, Any]) -> str:
    """The description for people to read: entries as a table, what is wrong last, then the verdict."""
    from guider.data.describe import in_words

    shown = description | {"episode_ends": _end_signs(description["episode_ends"])}
    tables = _entries(shown)
    faults, verdict = shown.pop("faults"), shown.pop("verdict")
    lines = [
        f"{name.replace('_', ' '):>20}  {in_words(value)}"
        for name, value in shown.items()
        if value not in ([], {}, None)
    ]
    lines += [f"{'look at' if number == 0 else '':>20}  {fault}" for number, fault in enumerate(faults)]
    return "\n".join([*tables, "", *lines, f"{'verdict':>20}  {verdict}"])


def _entries(shown: dict[str, Any]) -> list[str]:
    """Tables of the state's and the action's entries, for which what they tell is taken out of `shown`."""
    names = {kind: shown.pop(f"{kind}_names") for kind in ("state", "action")}
    could, refused = shown.pop("could_be_goal"), shown.pop("no_goal")
    ranges = {"state": shown.pop("state_range"), "action": shown.pop("action_bounds")}
    lines = []
    for kind, heads in (("state", ("lowest", "highest", "as a goal")), ("action", ("least", "most", "at rest"))):
        width = max([len(name) for name in names[kind]] + [4])
        lines.append(f"{kind:>8}  {'name' if names[kind] else '':{width}}  {heads[0]:>10}  {heads[1]:>10}  {heads[2]}")
        for entry, (low, high) in enumerate(ranges[kind]):
            name = names[kind][entry] if names[kind] else ""
            known = name or str(entry)
            last = (
                ("yes" if known in could else refused[known])
                if kind == "state"
                else f"{shown['resting_action'][entry]:g}"
            )
            lines.append(f"{entry:>8}  {name:{width}}  {low:>10.6g}  {high:>10.6g}  {last}")
    del shown["resting_action"], shown["goal_range"]
    return lines


def _end_signs(signs: list[dict[str, Any]]) -> str:
    """How many ends each sign gave, those taken first."""
    taken, others = (
        ", ".join(f"{sign['name']} {sign['ends']:,}" for sign in signs if sign["used"] == used)
        for used in (True, False)
    )
    return taken + (f" (not taken: {others})" if others else "")
