"""One page about runs, to read and to send: what was trained on what, how well, how it goes, and whether to trust it.

The page is a single HTML file that loads nothing: its data stand in it as JSON, its pictures too
(guider/assets/report.html).
"""

from __future__ import annotations

import html
import json
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import jax.numpy as jnp
import numpy as np

from guider.data.episodes import Episodes, entry_name
from guider.data.goal_spaces import goals_of
from guider.errors import GuiderError
from guider.evaluation.comparison import kept_score
from guider.evaluation.imagined import fit_model, imagined_episodes
from guider.evaluation.outcomes import ending
from guider.evaluation.rollouts import Trace, rollout
from guider.evaluation.trust import MEANINGS
from guider.methods import find_method, preset_config
from guider.methods.policy import Policy
from guider.plots import draw_run
from guider.plots.canvas import data_url
from guider.runs import Run, RunSpec
from guider.support.config import differences
from guider.support.files import parse_json, read_lines
from guider.tasks import find_task
from guider.tasks.types import Task

EPISODES = 12
_LOGGED, _POINTS, _SAMPLES, _RENEWALS = 1_500, 300, 16, 40
_DIGITS = 4


@dataclass(frozen=True)
class Subject:
    """A run to report on, and all of its data."""

    run: Run
    episodes: Episodes


def report(subjects: Sequence[Subject], first_seed: int = 0) -> str:
    """The page, as HTML. first_seed: of the evaluation episodes rolled out; on own data, episodes are imagined.

    Raises GuiderError where a run is not finished or has not been scored.
    """
    if not subjects:
        raise GuiderError("name a run to report on")
    content = {
        "runs": [_about(subject) for subject in subjects],
        "episodes": [_episodes(s, first_seed) for s in subjects],
    }
    content["pictures"] = _pictures(subjects[0], first_seed)
    text = json.dumps(content, allow_nan=False).replace("<", "\\u003c")  # a name in it cannot end the script
    title = ", ".join(subject.run.directory.name for subject in subjects)
    page = resources.files("guider.assets").joinpath("report.html").read_text(encoding="utf-8")
    return page.replace("{{title}}", html.escape(title)).replace("{{content}}", text)


def training_command(spec: RunSpec) -> str:
    """The command that trains such a run."""
    problem, reading = spec.config.problem, spec.reading
    words: list[Any] = ["guider", "train", *([spec.task] if spec.task else []), "--data", spec.data]
    for name, value in (("state", reading.state), ("action", reading.action), ("episode-ends", reading.episode_ends)):
        words += [f"--{name}", *value] if value else []
    words += ["--format", reading.format] if reading.format else []
    if spec.task is None:
        words += (
            ["--goal", *goals_of(spec.spaces)]
            if spec.spaces.computed
            else ["--goal-indices", *spec.spaces.goal_indices]
        )
        words += ["--radius", problem.radius]
        words += ["--reach-radius", problem.reach_radius, "--period-steps", problem.period_steps]
        words += ["--held-out", spec.held_out]
    words += [
        "--method",
        spec.method,
        "--preset",
        spec.preset,
        "--seeds",
        len(spec.seeds),
        "--first-seed",
        spec.seeds[0],
    ]
    preset = preset_config(spec.method, spec.preset, problem)  # pyright: ignore[reportArgumentType]
    chosen = [f"{name}={value}" for name, value in differences(spec.config, preset).items()]
    return shlex.join(map(str, [*words, *(["--set", *chosen] if chosen else [])]))


def _about(subject: Subject) -> dict[str, Any]:
    run, spec = subject.run, subject.run.spec
    score = kept_score(run.directory)
    kept = parse_json(run.directory / "run.json")
    curves: dict[str, dict[str, list[Any]]] = {}
    for line in read_lines(run.directory / "metrics.jsonl"):
        for metric, values in line["metrics"].items():
            curve = curves.setdefault(f"{line['stage']}: {metric.replace('_', ' ')}", {"x": [], "y": []})
            curve["x"].append(line["update"])
            curve["y"].append(_rounded(float(np.mean(values))))
    spaces = spec.spaces
    goal = ", ".join(entry_name(spaces.state_names, index) for index in spaces.goal_indices[:8])
    facts = {
        "task": spec.task or "own data",
        "data": f"{spec.data} (fingerprint {spec.fingerprint})",
        "episodes": f"{len(subject.episodes.starts):,} of {len(subject.episodes.observations):,} states, "
        f"{spec.held_out:.0%} held out",
        "learned from": str(kept.get("facts", {}).get("data_use", "")),
        "goal": f"{goal} within {spec.config.problem.radius:g}",
        "method": f"{find_method(spec.method).label}, preset {spec.preset}, seeds {', '.join(map(str, spec.seeds))}",
        "acts by": score["acts_by"],
        "period": f"{spec.config.problem.period_steps} steps; reach radius {spec.config.problem.reach_radius:g}",
        "training": ", ".join(f"{stage.name} {stage.updates:,}" for stage in run.stages),
        "versions": ", ".join(f"{name} {version}" for name, version in score["versions"].items()),
        "scored on": score["evaluated_on"],
    }
    return {
        "name": run.directory.name,
        "facts": facts,
        "score": _score(score),
        "departures": {name: str(value) for name, value in score["departures"].items()},
        "command": training_command(spec),
        "curves": {name: curve for name, curve in curves.items() if all(value is not None for value in curve["y"])},
    }


def _score(score: dict[str, Any]) -> dict[str, Any]:
    """headline, rows of (name, value of each seed, what it says), and words."""
    seeds = [f"seed {seed}" for seed in score["training_seeds"]]
    if score["task"] is None:
        rows = [
            [name.replace("_", " "), *(_shown(seed[name]) for seed in score["per_seed"]), MEANINGS[name]]
            for name in score["per_seed"][0]
        ]
        headline = " / ".join(f"{100 * (seed['imagined_success'] or 0):.0f} %" for seed in score["per_seed"])
        return {
            "headline": headline,
            "unit": "of the goals met in imagination",
            "seeds": seeds,
            "rows": rows,
            "words": score["verdicts"],
        }
    low, high = score["interval_95"]
    rows = [
        ["score", *(f"{seed['score']:.1f}" for seed in score["per_seed"]), score["unit"]],
        ["95 % interval", *(f"{seed['interval_95'][0]} to {seed['interval_95'][1]}" for seed in score["per_seed"]), ""],
        ["steps when met", *(_shown(seed["median_steps_when_met"]) for seed in score["per_seed"]), "median"],
    ]
    endings = [seed["episodes"].get("ending") for seed in score["per_seed"]]
    words = []
    if all(endings):
        told = {"fell": "fell over", "stuck": "got stuck", "time": "were still on their way"}
        every = [end for seed in endings for end in seed]
        failed = ", ".join(f"{every.count(cause)} {did}" for cause, did in told.items() if every.count(cause))
        words.append(f"of {len(every)} episodes {every.count('met')} met the goal" + (f"; {failed}" if failed else ""))
    return {
        "headline": f"{score['score']:.1f}",
        "unit": f"{score['unit']}, 95 % interval {low} to {high}, {score['episodes_per_seed']} episodes a seed",
        "seeds": seeds,
        "rows": rows,
        "words": words,
    }


def _episodes(subject: Subject, first_seed: int) -> dict[str, Any]:
    """Episodes to look at, in the two most varied goal entries (or one, against time)."""
    run, spec, episodes = subject.run, subject.run.spec, subject.episodes
    task = find_task(spec.task) if spec.task else None
    policy = run.policies()[0]
    if task is None:
        training, unseen = episodes.split(spec.held_out) if spec.held_out else (episodes, episodes)
        seen = imagined_episodes(policy, fit_model(training), training, unseen)
        traces, horizon = seen.traces(EPISODES), len(seen.places)
        kind = f"{'unseen' if spec.held_out else 'logged'} starts and goals, imagined in a model learned from the logs"
    else:
        traces, horizon = rollout(policy, task, EPISODES, first_seed).traces, task.horizon_steps
        kind = f"{task.environment}, episode seeds {first_seed} to {first_seed + EPISODES - 1}"
    entries = _entries(episodes)
    logged = episodes.achieved[:: max(1, len(episodes.achieved) // _LOGGED)]
    return {
        "kind": kind,
        "names": _names(episodes, entries),
        "radius": spec.config.problem.radius,
        "logged": _flat(logged, entries) if len(entries) == 2 else [],
        "walls": _walls(task),
        "traces": [_trace(trace, policy, entries, task, horizon) for trace in traces],
    }


def _trace(trace: Trace, policy: Policy, entries: list[int], task: Task | None, horizon: int) -> dict[str, Any]:
    stride = max(1, len(trace.achieved) // _POINTS)
    shown = np.unique(np.append(np.arange(0, len(trace.achieved), stride), len(trace.achieved) - 1))
    words = "met the goal" if trace.success else "did not meet the goal"
    if task is None and not trace.success:
        words = "strayed from what was logged" if len(trace.achieved) < horizon else "was still on its way"
    if task is not None and task.maze is not None and not trace.success:
        words = {"fell": "fell over", "stuck": "got stuck", "time": "ran out of time"}[ending(trace, task, task.maze)]
    return {
        "steps": shown.tolist(),
        "path": _flat(trace.achieved[shown], entries),
        "subgoals": _flat(trace.subgoals[shown], entries),
        "goal": _flat(trace.goal[None], entries)[0],
        "reach": _reach(trace, policy, entries),
        "outcome": f"{words} after {len(trace.achieved)} steps",
        "met": trace.success,
    }


def _reach(trace: Trace, policy: Policy, entries: list[int]) -> list[dict[str, Any]]:
    """Where the prior holds c steps to lead, from places where a subgoal was chosen."""
    subgoals = find_method(policy.method).subgoals
    if subgoals is None or subgoals.reachable is None:
        return []
    chosen = np.flatnonzero(trace.renewed)
    chosen = chosen[:: max(1, len(chosen) // _RENEWALS)]
    if len(chosen) == 0:
        return []
    samples = subgoals.reachable(policy.config, policy.state, jnp.asarray(trace.achieved[chosen]), _SAMPLES)
    points = np.asarray(samples).swapaxes(0, 1)
    return [{"step": int(step), "points": _flat(at, entries)} for step, at in zip(chosen, points, strict=True)]


def _pictures(subject: Subject, first_seed: int) -> list[dict[str, str]]:
    """The run's own pictures, drawn anew."""
    spec = subject.run.spec
    task = find_task(spec.task) if spec.task else None
    paths = draw_run(subject.run, task, subject.episodes, spec.seeds[0], first_seed)
    return [
        {
            "name": path.stem.split("-")[0],
            "source": data_url(path.read_bytes()),
        }
        for path in paths
    ]


def _entries(episodes: Episodes) -> list[int]:
    """The goal entries shown: both of two, the two most varied of more, or one."""
    spread = episodes.achieved.std(axis=0)
    return sorted(np.argsort(-spread, kind="stable")[:2].tolist())


def _names(episodes: Episodes, entries: list[int]) -> list[str]:
    return [entry_name(episodes.state_names, episodes.goal_indices[entry]) for entry in entries]


def _walls(task: Task | None) -> list[list[float]]:
    """[x, y, side] of each wall's lower corner."""
    if task is None or task.maze is None:
        return []
    side = task.maze.cell_size_m
    corners = task.maze.cell_centre(np.argwhere(task.maze.walls)) - side / 2
    return [[*map(float, corner), side] for corner in corners]


def _flat(points: np.ndarray, entries: list[int]) -> list[list[float | None]]:
    return [[_rounded(float(value)) for value in point] for point in points[:, entries]]


def _rounded(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None


def _shown(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
