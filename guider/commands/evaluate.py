"""`guider evaluate`."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from guider.commands.options import Json, RunDirectory
from guider.commands.screen import answer, bar


def evaluate(
    run: RunDirectory,
    episodes: int | None = None,
    first_seed: int | None = None,
    data: str | None = None,
    as_json: Json = False,
) -> None:
    """Score a finished run: success in the environment, or, for your own data, scores on held-out episodes.

    The result, with its whole protocol, is also written to RUN/evaluation.json.

    Args:
        run: Directory of the run.
        episodes: Task only: episodes per trained seed, by default 100, or 50 for each of several goals.
        first_seed: Task only: environment seeds count up from here, by default 0.
        data: Own data and mazes: where the run's data is now, if it has moved.
        as_json: Print one JSON document instead of text.
    """
    from guider.evaluation.score import keep_score, score

    with bar("evaluating", "steps") as show:
        result = score(run, episodes=episodes, first_seed=first_seed, data=data, on_steps=show)
    answer(result, _evaluation_table(result), as_json)
    keep_score(run, result)  # after it was shown: the place may be read-only


def _evaluation_table(result: dict[str, Any]) -> Table:
    title = f"{result['task'] or result['data']}, {result['method']}, preset {result['preset']}"
    if result["task"] is None:
        return _held_out_table(result, title)
    table = Table(box=None, title=title, caption=f"acts by the {result['acts_by']}")
    table.add_column("seed")
    in_maze = ("fell / stuck / time",) if "ending" in result["per_seed"][0]["episodes"] else ()
    guided = ("subgoals off data", "in walls") if "subgoals_in_walls" in result["per_seed"][0] else ()
    several = ("each goal",) if "per_goal" in result else ()
    for name in (result["unit"], "95 % interval", *several, "median steps when met", *in_maze, *guided):
        table.add_column(name)
    for seed, scores in zip(result["training_seeds"], result["per_seed"], strict=True):
        low, high = scores["interval_95"]
        cells = [
            f"{scores['score']:.1f}",
            f"{low} to {high}",
            *_each_goal(scores),
            str(scores["median_steps_when_met"]),
        ]
        if in_maze:
            endings = scores["episodes"]["ending"]
            cells.append(" / ".join(str(endings.count(cause)) for cause in ("fell", "stuck", "time")))
        if guided:
            shares = (scores["subgoals_off_data"], scores["subgoals_in_walls"])
            cells += ["?" if share is None else f"{100 * share:.1f} %" for share in shares]
        table.add_row(str(seed), *cells)
    low, high = result["interval_95"]
    table.add_row("all", f"{result['score']:.1f}", f"{low} to {high}", *_each_goal(result))
    return table


def _each_goal(scores: dict[str, Any]) -> list[str]:
    if "per_goal" not in scores:
        return []
    return [" ".join("-" if score is None else f"{score:.0f}" for score in scores["per_goal"])]


def _held_out_table(result: dict[str, Any], title: str) -> Table:
    """A row for each score, with what it says; the verdicts below."""
    from guider.evaluation.trust import MEANINGS

    seeds, per_seed = result["training_seeds"], result["per_seed"]
    verdicts = [f"seed {seed}: {words}" for seed, words in zip(seeds, result["verdicts"], strict=True)]
    table = Table(box=None, title=title, caption="\n".join([*verdicts, f"acts by the {result['acts_by']}"]))
    for head in ("", *(f"seed {seed}" for seed in seeds), "what it says"):
        table.add_column(head)
    for name in per_seed[0]:
        cells = ("-" if scores[name] is None else f"{scores[name]:.3g}" for scores in per_seed)
        table.add_row(name.replace("_", " "), *cells, MEANINGS[name])
    return table
