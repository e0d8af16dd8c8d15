"""`guider reproduce`."""

from __future__ import annotations

from pathlib import Path

import tyro
from rich.markup import escape

from guider.commands.options import Json, assignments
from guider.commands.screen import answer, plan_bar
from guider.errors import GuiderError
from guider.learning.options import Preset
from guider.reproduce.paper import TargetName
from guider.support.files import user_path


def reproduce(
    target: tyro.conf.Positional[TargetName],
    tasks: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
    preset: Preset = "fast",
    seeds: int = 4,
    first_seed: int = 0,
    episodes: int = 100,
    data: Path = Path("datasets"),
    out: Path = Path("runs/reproduce"),
    jobs: int = 1,
    set: tuple[str, ...] = (),
    dry_run: bool = False,
    report_only: bool = False,
    as_json: Json = False,
) -> None:
    """Make a table or figure of the paper: record missing data, train, evaluate, report.

    Runs live in OUT/runs/TASK/VARIANT-PRESET and are shared between tables and figures. What is done is skipped and
    what was interrupted goes on, so the same command continues where the last one ended.

    Args:
        target: The table or figure.
        tasks: These tasks in place of the paper's.
        methods: table1, figure4 and figure6: these methods in place of the paper's.
        preset: `fast` fits two cores; `paper` is the paper's equations and the authors' settings.
        seeds: How many agents to train per run.
        first_seed: Their seeds count up from here.
        episodes: Evaluation episodes per trained seed.
        data: Directory that holds TASK.hdf5, or a Minari dataset TASK; missing data is recorded into it.
        out: Directory for plan, runs, logs and results.
        jobs: Runs at a time, each on its own share of the cores.
        set: Settings of every run by dotted name, or of one method's, e.g. --set batch_size=256 guider:high.samples=2.
        dry_run: Show the plan; write and run nothing.
        report_only: Run nothing; write the table or figure of the runs there are.
        as_json: Print one JSON document instead of text.
    """
    from guider.reproduce import report, runner
    from guider.reproduce.plans import Protocol, make_plan

    if dry_run and report_only:
        raise GuiderError("--dry-run shows what would be run, --report-only runs nothing; give one of them")
    protocol = Protocol(preset, seeds, first_seed, episodes, assignments(set), user_path(data), user_path(out))
    plan = make_plan(target, protocol, tasks, methods)
    if dry_run:
        described = runner.describe(plan)
        lines = [f"{run['state']:>11}  {run['directory']}" for run in described["runs"]]
        answer(described, "\n".join([plan.title, *described["data_to_record"], *lines]), as_json)
        return
    failures = []
    if not report_only:
        with plan_bar() as watch:
            failures = runner.execute(plan, jobs, watch)
    document, files = report.write(plan)
    failed = [{"run": f.run.name, "reason": f.reason, "log": str(f.log)} for f in failures]
    shown = [escape(report.table(document)), ""] if "rows" in document else []
    answer(document | {"failed": failed}, "\n".join([*shown, *map(str, files)]), as_json)
    if failures:
        what = "; ".join(f"{failure['run']}: {failure['reason']}" for failure in failed)
        raise GuiderError(f"{len(failures)} of {len(plan.runs)} runs failed, the same command tries them again: {what}")
