"""What came of a plan's runs: tables as Markdown and JSON, figures as PNG and JSON, beside the paper's own numbers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from guider.reproduce.paper import PaperScore
from guider.reproduce.plans import Plan, PlannedRun, Variant
from guider.reproduce.runner import evaluation, state
from guider.runs import read_lines, write_json
from guider.statistics import (
    interquartile_mean,
    mean_and_deviation,
    probability_of_improvement,
    stratified_bootstrap_interval,
)
from guider.tasks.types import SCORE_UNITS


@dataclass(frozen=True)
class Cell:
    """A run in its place. result: its evaluation.json, None while it is unfinished."""

    task: str
    variant: Variant
    run: PlannedRun
    paper: PaperScore
    result: dict[str, Any] | None

    @property
    def scores(self) -> np.ndarray:
        """[seeds], in the task's unit."""
        assert self.result is not None
        return np.array([seed["score"] for seed in self.result["per_seed"]])


Grid = list[list[Cell]]


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


def cells(plan: Plan) -> Grid:
    """[task][variant] of a plan. Raises GuiderError where a directory holds another run, see runner.state."""
    return [
        [
            Cell(task, variant, run, paper, evaluation(plan, run) if state(plan, run) == "done" else None)
            for variant, run, paper in zip(plan.variants, runs, papers, strict=True)
        ]
        for task, runs, papers in zip(plan.tasks, plan.grid, plan.paper_scores, strict=True)
    ]


def summary(cell: Cell) -> dict[str, Any]:
    """A finished cell: mean and standard deviation over seeds, those of the paper, and what they come from."""
    assert cell.result is not None
    mean, deviation = mean_and_deviation(cell.scores)
    return {
        "variant": cell.variant.name,
        "label": cell.variant.label,
        "run": cell.run.name,
        "mean": mean,
        "deviation": deviation,
        "per_seed": cell.scores.tolist(),
        "interval_95": cell.result["interval_95"],
        "unit": cell.result["unit"],
        "paper": cell.paper,
    }


def aggregate(grid: Grid) -> dict[str, Any] | None:
    """Over the tasks that every variant with any result has finished; None where there is no such task.

    Per variant: interquartile mean and mean of normalised scores, with 95 % intervals, and how likely Guider beats it.
    """
    columns = [column for column in zip(*grid, strict=True) if any(cell.result for cell in column)]
    rows = [row for row in zip(*columns, strict=True) if all(cell.result for cell in row)]
    if not rows:
        return None
    scores = {
        column[0].variant.name: np.stack([_normalised(cell, cell.scores) for cell in column], axis=1)
        for column in zip(*rows, strict=True)
    }
    guider = scores.get("guider")
    variants = []
    for column in zip(*rows, strict=True):
        variant = column[0].variant
        ours = scores[variant.name]
        printed = [_normalised(cell, np.array(cell.paper[0])) for cell in column if cell.paper is not None]
        entry: dict[str, Any] = {
            "variant": variant.name,
            "label": variant.label,
            "interquartile_mean": float(interquartile_mean(ours)),
            "interval_95": stratified_bootstrap_interval(interquartile_mean, ours),
            "mean": float(ours.mean()),
            "paper_mean": float(np.mean(printed)) if len(printed) == len(column) else None,
        }
        if guider is not None and variant.name != "guider":
            entry["guider_improves"] = float(probability_of_improvement(guider, ours))
            entry["guider_improves_interval_95"] = stratified_bootstrap_interval(
                probability_of_improvement, guider, ours
            )
        variants.append(entry)
    return {"tasks": [row[0].task for row in rows], "variants": variants}


def protocol(plan: Plan, grid: Grid) -> dict[str, Any]:
    """How the finished runs were made and scored; what all of them share stands once."""
    finished = list({cell.run.name: cell for row in grid for cell in row if cell.result}.values())
    results = [cell.result for cell in finished if cell.result]
    departures = _shared([result["departures"] for result in results])
    versions = _shared([result["versions"] for result in results])
    asked = plan.protocol
    return {
        "preset": asked.preset,
        "training_seeds": [asked.first_seed, asked.first_seed + asked.seeds - 1],
        "episodes_per_seed": asked.episodes,
        "checkpoint": "last",
        "versions_of_all_runs": versions,
        "departures_of_all_runs": departures,
        "runs": [
            {
                "run": cell.run.name,
                "environment": result["environment"],
                "data": result["data"],
                "fingerprint": result["fingerprint"],
                "period_steps": result["period_steps"],
                "acts_by": result["acts_by"],
                "updates": result["updates"],
                "episode_seeds": result["episode_seeds"],
                "training_minutes": training_minutes(plan.directory(cell.run)),
                "other_departures": _without(result["departures"], departures),
                "other_versions": _without(result["versions"], versions),
            }
            for cell, result in zip(finished, results, strict=True)
        ],
    }


def training_minutes(directory: Path) -> float:
    """Minutes that a run's updates took, all seeds together; compilation and evaluation apart."""
    return sum(line["seconds"] for line in read_lines(directory / "metrics.jsonl")) / 60


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


def _normalised(cell: Cell, scores: np.ndarray) -> np.ndarray:
    """Scores as shares of the best there can be: every step of an episode with the goal met, or 100 %."""
    assert cell.result is not None
    counts_steps = cell.result["unit"] == SCORE_UNITS["return"]
    return scores / (cell.result["horizon_steps"] if counts_steps else 100)


def _shared(dicts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Entries that all of them have in common."""
    if not dicts:
        return {}
    return {name: value for name, value in dicts[0].items() if all(d.get(name, ...) == value for d in dicts)}


def _without(entries: dict[str, Any], shared: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in entries.items() if name not in shared}


def _cell_text(cell: dict[str, Any]) -> str:
    ours = f"**{cell['mean']:.1f}** ± {cell['deviation']:.1f}" if "mean" in cell else "-"
    return f"{ours} ({_paper_text(cell['paper'])})"


def _paper_text(paper: PaperScore) -> str:
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
