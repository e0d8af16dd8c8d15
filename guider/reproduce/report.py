"""What came of a plan's runs: tables as Markdown and JSON, figures as PNG and JSON, beside the paper's own numbers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from guider.reproduce.paper import PaperScore
from guider.reproduce.plans import Plan
from guider.reproduce.scores import Cell, Grid, aggregate, cells, protocol, summary
from guider.support.files import write_json


def write(plan: Plan) -> tuple[dict[str, Any], list[Path]]:
    """Write what there is of a table or figure into OUT, in place of an earlier one, and return (JSON, files)."""
    grid = cells(plan)
    out = plan.protocol.out
    document: dict[str, Any] = {"title": plan.title, "command": plan.command()}
    if plan.name.startswith("table"):
        document |= {"rows": [_row(plan, row) for row in grid], "aggregate": aggregate(grid)}
        pictures = []
    else:
        from guider.reproduce.figures import draw  # matplotlib takes a second to import

        pictures, numbers = draw(plan, grid)
        document |= {"pictures": [str(path) for path in pictures], "numbers": numbers}
    document |= {"unfinished": _unfinished(plan, grid), "protocol": protocol(plan, grid)}
    out.mkdir(parents=True, exist_ok=True)
    written = [*pictures, out / f"{plan.name}.json"]
    write_json(written[-1], document)
    if plan.name.startswith("table"):
        written.append(out / f"{plan.name}.md")
        _write_text(written[-1], markdown(document))
    return document, written


def markdown(document: dict[str, Any]) -> str:
    """A table's document as a page: the table, its aggregate and its protocol."""
    protocol, aggregated = document["protocol"], document["aggregate"]
    first, last = protocol["training_seeds"]
    sections = [
        f"# {document['title']}",
        f"`{document['command']}`",
        f"Mean ± standard deviation over training seeds {first} to {last}, {protocol['episodes_per_seed']} episodes "
        f"each, last checkpoint, preset `{protocol['preset']}`; in brackets the paper's, on its own data. Units: "
        + "; ".join(dict.fromkeys(row["unit"] for row in document["rows"] if row["unit"]))
        + ".",
        table(document),
    ]
    if aggregated is not None:
        sections.append(_aggregate_section(aggregated))
    sections.append(_protocol_section(protocol))
    return "\n\n".join(sections) + "\n"


def table(document: dict[str, Any]) -> str:
    """The table itself, as Markdown; the last column holds what fills unfinished rows, where there are any."""
    rows = document["rows"]
    header = ["task", *(cell["label"] for cell in rows[0]["cells"])]
    lines = [[row["task"], *(_cell_text(cell) for cell in row["cells"])] for row in rows]
    if document["unfinished"]:
        header.append("to fill the row")
        for line, row in zip(lines, rows, strict=True):
            line.append(f"`{row['command']}`" if row["command"] else "")
    return _markdown_table(header, lines)


def _row(plan: Plan, row: Sequence[Cell]) -> dict[str, Any]:
    units = [cell.result["unit"] for cell in row if cell.result]
    return {
        "task": row[0].task,
        "unit": units[0] if units else None,
        "cells": [
            summary(cell)
            if cell.result
            else {"variant": cell.variant.name, "label": cell.variant.label, "run": cell.run.name, "paper": cell.paper}
            for cell in row
        ],
        "command": None if len(units) == len(row) else plan.command(row[0].task),
    }


def _unfinished(plan: Plan, grid: Grid) -> list[dict[str, Any]]:
    """Tasks that lack runs, and the command that makes them."""
    lacking = {row[0].task: [cell.variant.name for cell in row if not cell.result] for row in grid}
    return [{"task": t, "variants": names, "command": plan.command(t)} for t, names in lacking.items() if names]


def _cell_text(cell: dict[str, Any]) -> str:
    ours = f"**{cell['mean']:.1f}** ± {cell['deviation']:.1f}" if "mean" in cell else "-"
    return f"{ours} ({paper_text(cell['paper'])})"


def paper_text(paper: PaperScore) -> str:
    if paper is None:
        return "-"
    mean, deviation = paper
    return f"{mean:.1f}" if deviation is None else f"{mean:.1f} ± {deviation:.1f}"


def _aggregate_section(aggregated: dict[str, Any]) -> str:
    lines = []
    for entry in aggregated["variants"]:
        beaten = "-"
        if "guider_improves" in entry:
            beaten = f"{entry['guider_improves']:.2f} ({_range(entry['guider_improves_interval_95'])})"
        printed = "-" if entry["paper_mean"] is None else f"{entry['paper_mean']:.3f}"
        middle = f"{entry['interquartile_mean']:.3f} ({_range(entry['interval_95'])})"
        lines.append([entry["label"], middle, f"{entry['mean']:.3f}", printed, beaten])
    header = ["", "interquartile mean (95 %)", "mean", "the paper's mean", "probability that Guider improves (95 %)"]
    return (
        "## Over tasks\n\n"
        "Scores as shares of the best there can be (steps with the goal met: of all steps; else of 100), over "
        f"{', '.join(aggregated['tasks'])}. Intervals: stratified bootstrap, seeds resampled within each task.\n\n"
        + _markdown_table(header, lines)
    )


def _protocol_section(protocol: dict[str, Any]) -> str:
    lines = [
        [
            run["run"],
            run["environment"],
            f"{run['data']} ({run['fingerprint']})",
            run["acts_by"],
            ", ".join(f"{count:,}" for count in run["updates"].values()),
            f"{run['training_minutes']:.1f}",
            _settings_text(run["other_departures"] | run["other_versions"]) or "-",
        ]
        for run in protocol["runs"]
    ]
    header = [
        "run",
        "environment",
        "data (fingerprint)",
        "acts by the",
        "updates",
        "training minutes",
        "of its own: departures, versions",
    ]
    return (
        "## Protocol\n\n"
        f"Software: {_settings_text(protocol['versions_of_all_runs']) or '-'}. Departures from preset `paper` in all "
        f"runs: {_settings_text(protocol['departures_of_all_runs']) or 'none'}.\n\n" + _markdown_table(header, lines)
    )


def _settings_text(settings: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in settings.items())


def _range(interval: Sequence[float]) -> str:
    low, high = interval
    return f"{low:.2f} to {high:.2f}"


def _markdown_table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *lines))


def _write_text(path: Path, text: str) -> None:
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(text)
    temporary.replace(path)
