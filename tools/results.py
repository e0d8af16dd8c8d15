"""The store of results, `results/TASK/VARIANT.json`, and the tables that documents show of it.

`keep` takes in what `guider evaluate` said of a finished run, with the commands that make it again. `tables` rewrites
what stands between `<!-- table NAME -->` and `<!-- end -->` in README.md and docs/results.md; with `--check` it only
says whether that would change anything.
"""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from guider import runs
from guider.evaluation.rollouts import success_interval
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.methods import preset_config
from guider.reproduce.paper import from_table_1
from guider.reproduce.report import paper_text
from guider.reproduce.scores import training_minutes
from guider.support.config import differences
from guider.support.files import parse_json, write_json, write_text
from guider.tasks import find_task
from tools.published import METHODS, OGBENCH

ROOT = Path(__file__).parent.parent
STORE = ROOT / "results"
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "results.md")
PLACES = ("data", "checksum")
"""Of an evaluation, what tells of the machine it was made on alone."""


def commands(run: runs.Run, recorded: str, evaluation: dict[str, Any]) -> list[str]:
    """The command lines that make data, run and score again. recorded: the first of them, which makes DATA.hdf5, or
    what its last word says."""
    spec, task = run.spec, find_task(run.spec.task or "")
    plain = Problem(task.radius, task.reach_radius, task.period_steps, task.goal_parts, task.domain)
    changed = differences(spec.config, preset_config(spec.method, cast(Preset, spec.preset), plain))
    data = recorded.split()[-1] if recorded.startswith("guider collect") else "DATA.hdf5"
    words = ["guider", "train", task.name, "--data", data, "--method", spec.method, "--preset", spec.preset]
    words += ["--seeds", str(len(spec.seeds)), "--first-seed", str(spec.seeds[0]), "--out", "RUN"]
    if (period := changed.pop("problem.period_steps", None)) is not None:
        words += ["--period-steps", str(period)]
    if changed:
        words += ["--set", *(f"{name}={value}" for name, value in changed.items())]
    episodes, first = evaluation["episodes_per_seed"], evaluation["episode_seeds"][0]
    scored = f"guider evaluate RUN --episodes {episodes} --first-seed {first}"
    return [recorded, shlex.join(words), scored]


def kept(run: runs.Run, recorded: str) -> dict[str, Any]:
    """What the store holds of a run that was evaluated on its task."""
    evaluation = parse_json(run.directory / "evaluation.json")
    trained_on = parse_json(run.directory / "run.json").get("trained_on")
    return {
        "commands": commands(run, recorded, evaluation),
        "trained_on": trained_on,
        "training_minutes": round(training_minutes(run.directory), 1),
        **{name: value for name, value in evaluation.items() if name not in PLACES},
    }


@dataclass(frozen=True)
class Row:
    """Runs that a table shows as one: of one task and kind of data."""

    task: str
    label: str
    results: tuple[dict[str, Any], ...]

    @property
    def seeds(self) -> list[dict[str, Any]]:
        return [seed for result in self.results for seed in result["per_seed"]]

    def cells(self) -> dict[str, str]:
        """By column: success of each run and seed, mean and interval, endings of failures, shares of subgoals."""
        scores = np.array([seed["episodes"]["score"] for seed in self.seeds])
        low, high = success_interval(scores > 0)
        endings = [ending for seed in self.seeds for ending in seed["episodes"]["ending"]]
        causes = " / ".join(str(endings.count(cause)) for cause in ("fell", "stuck", "time"))
        in_walls, off_data = (
            100 * np.mean([seed[f"subgoals_{where}"] for seed in self.seeds]) for where in ("in_walls", "off_data")
        )
        runs_each = [len(result["per_seed"]) for result in self.results]
        even = len(set(runs_each)) == 1
        each = [", ".join(f"{seed['score']:g}" for seed in result["per_seed"]) for result in self.results]
        return {
            "task": self.task,
            "data": self.label,
            "success, %, of each training seed; by data seed": "; ".join(each),
            "success, % (95 %)": f"**{scores.mean():.1f}** ({low:.1f} to {high:.1f})",
            "data x training seeds, episodes": f"{len(each)} x {runs_each[0]}, {scores.size}"
            if even
            else f"{len(scores)} in all, {scores.size}",
            "failures: fell / stuck / out of time": f"{causes} of {len(endings)}",
            "subgoals in walls / off the data, %": f"{in_walls:.1f} / {off_data:.1f}",
        }


SHORT = ("task", "success, % (95 %)", "data x training seeds, episodes", "failures: fell / stuck / out of time")


def antmaze(store: Path, variant: str, label: str) -> list[Row]:
    """A row per maze, of the runs VARIANT-DATASEED."""
    rows = []
    for size in ("umaze", "medium", "large"):
        files = sorted((store / f"antmaze-{size}-diverse").glob(f"{variant}-*.json"))
        if files:
            seeds = ", ".join(file.stem.removeprefix(f"{variant}-") for file in files)
            results = tuple(parse_json(file) for file in files)
            data = f"{label}, data seed{'s' if len(files) > 1 else ''} {seeds}"
            rows.append(Row(f"antmaze-{size}-diverse", data, results))
    return rows


def ogbench(store: Path) -> list[dict[str, str]]:
    """A row per data set of OGBench's that there are results on, by column: those of ours, and what is published, with
    what its method scores here. Raises KeyError where nothing published is known of one."""
    rows = []
    for folder in sorted(store.glob("ogbench-*")):
        name = folder.name.removeprefix("ogbench-").removesuffix("-v0")
        found = {file.stem: parse_json(file) for file in sorted(folder.glob("*.json"))}
        ours, theirs = [], dict(zip(METHODS, OGBENCH[name], strict=True))
        for variant, result in found.items():
            scores = np.array([seed["episodes"]["score"] for seed in result["per_seed"]])
            low, high = success_interval(scores > 0)
            minutes = f"{result['training_minutes']:.0f} min"
            goals = " ".join("-" if score is None else f"{score:.0f}" for score in result["per_goal"])
            entry = f"{variant} **{scores.mean():.1f}** ({low:.1f} to {high:.1f}; by goal {goals}; {minutes})"
            if (rival := result["method"].upper()) in theirs:
                theirs[rival] += f"<br>ours: {entry}"
            else:
                ours.append(entry)
        rows.append({"data set": name, "ours": "<br>".join(ours)} | theirs)
    return rows


def kitchen(store: Path) -> list[dict[str, str]]:
    """A row per kitchen and method, by column, of the runs METHOD-fast-DATASEED; and what the paper prints of it."""
    rows = []
    for file in sorted(store.glob("kitchen-*/*.json")):
        task, result = file.parent.name, parse_json(file)
        low, high = result["interval_95"]
        rows.append(
            {
                "task": task,
                "run": file.stem,
                "subtasks done, %, of each training seed": ", ".join(
                    f"{seed['score']:g}" for seed in result["per_seed"]
                ),
                "mean (95 %)": f"**{result['score']:.1f}** ({low:.1f} to {high:.1f})",
                "the paper, on its data": paper_text(from_table_1(task, result["method"])),
                "training, both seeds": f"{result['training_minutes']:.0f} min",
            }
        )
    return rows


def markdown(rows: Sequence[Row], columns: Sequence[str] = ()) -> str:
    """The table, of these columns or all, and the commands of its last run."""
    table = grid([row.cells() for row in rows], columns)
    results = [result for row in rows for result in row.results]
    acts, processors = ("; ".join(sorted({result[name] for result in results})) for name in ("acts_by", "evaluated_on"))
    last = results[-1]
    facts = f"Acts by the {acts}. Processors: {processors}. The commands of the last run:"
    return f"{table}\n\n{facts}\n\n```\n" + "\n".join(last["commands"]) + "\n```"


def grid(cells: Sequence[dict[str, str]], columns: Sequence[str] = ()) -> str:
    """The rows, of these columns or all."""
    header = columns or tuple(cells[0])
    lines = [header, ["---"] * len(header), *([row[name] for name in header] for row in cells)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


TABLES = {
    "antmaze": ("guider-fast", "`guider collect`", ()),
    "headline": ("guider-fast", "`guider collect`", SHORT),
    "antmaze-routes": ("guider-routes-40k", "`guider collect`", ()),
    "antmaze-d4rl-policy": ("d4rl-policy-guider-fast", "D4RL's own ant policy", ()),
}
"""name -> (the runs' variant, what their data is, columns or () for all)."""


def tables(store: Path = STORE) -> dict[str, str]:
    """Every table that there are results for, by name."""
    made = {name: (antmaze(store, variant, data), columns) for name, (variant, data, columns) in TABLES.items()}
    found = {name: markdown(rows, columns) for name, (rows, columns) in made.items() if rows}
    grids = {"ogbench": ogbench(store), "kitchen": kitchen(store)}
    return found | {name: grid(rows) for name, rows in grids.items() if rows}


def filled(document: str, made: dict[str, str]) -> str:
    """The document with its tables as they are now. Raises KeyError for a table that there is not."""
    return re.sub(
        r"(<!-- table (\S+) -->\n).*?(<!-- end -->)",
        lambda mark: f"{mark[1]}{made[mark[2]]}\n{mark[3]}",
        document,
        flags=re.DOTALL,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tools.results", description=__doc__)
    actions = parser.add_subparsers(dest="action", required=True)
    keep = actions.add_parser("keep", help="take the evaluation of a run into the store")
    keep.add_argument("run", type=Path, help="directory of the run")
    keep.add_argument("--variant", required=True, help="the result's name below its task")
    keep.add_argument(
        "--recorded",
        required=True,
        help="the command that makes DATA.hdf5, or another file that its last word names; or a comment, # ...",
    )
    show = actions.add_parser("tables", help="bring the documents up to date")
    show.add_argument("--check", action="store_true", help="change nothing; exit with 1 where something would change")
    asked = parser.parse_args(arguments)
    if asked.action == "keep":
        run = runs.open_run(asked.run)
        place = STORE / (run.spec.task or "") / f"{asked.variant}.json"
        place.parent.mkdir(parents=True, exist_ok=True)
        write_json(place, kept(run, asked.recorded))
        print(f"kept {place.relative_to(ROOT)}; next: python -m tools.results tables")
        return 0
    made = tables()
    stale = [path for path in DOCUMENTS if filled(path.read_text(), made) != path.read_text()]
    for path in stale:
        print(f"{path.relative_to(ROOT)} {'differs from the store' if asked.check else 'brought up to date'}")
        if not asked.check:
            write_text(path, filled(path.read_text(), made))
    return int(asked.check and bool(stale))


if __name__ == "__main__":
    sys.exit(main())
