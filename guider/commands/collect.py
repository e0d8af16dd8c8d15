"""`guider collect`."""

from __future__ import annotations

from pathlib import Path

from guider.commands.options import Json, TaskName
from guider.commands.screen import answer, bar
from guider.errors import GuiderError
from guider.support.files import user_path

OTHER_SEEDS = 2**31
"""Added to a seed, so that what is recorded for validation is of no seed's that anybody chooses."""


def collect(task: TaskName, out: Path, steps: int | None = None, seed: int = 0, as_json: Json = False) -> None:
    """Record data for a task on this machine, reproducibly from a seed.

    Args:
        task: A task whose data `guider tasks` says can be collected.
        out: New file laid out as D4RL's (.hdf5 or .h5) or as OGBench's (.npz, and beside it -val.npz with a tenth as
            much for validation), or, with no ending, new directory of a Minari dataset.
        steps: Rows to record; by default as many as the task's data has in the literature.
        seed: Equal seeds give equal files.
        as_json: Print one JSON document instead of text.
    """
    from guider.data.write import check_destination, validation_file, write_d4rl, write_minari, write_ogbench
    from guider.tasks import find_task

    out = user_path(out)
    found = find_task(task)
    if found.collector is None:
        raise GuiderError(f"{task} cannot be collected here; its data comes from files ({found.source}): --data FILE")
    steps = found.collector.steps if steps is None else steps
    if steps < 2 or seed < 0:
        raise GuiderError(f"--steps must be at least 2 and --seed at least 0, got {steps} and {seed}")
    layout = check_destination(out, 4 * steps * (found.state_dim + found.action_dim))
    with bar("recording", "steps") as show:
        recording = found.collector.record(steps, seed, show)
    if layout == "d4rl":
        write_d4rl(out, recording, found.goal_indices, found.radius, found.goal_parts)
    elif layout == "ogbench":
        write_ogbench(out, recording)
        with bar("recording for validation", "steps") as show:
            validation = found.collector.record(max(2, steps // 10), seed + OTHER_SEEDS, show)
        write_ogbench(validation_file(out), validation)
    else:
        with bar("writing", "episodes") as show:
            write_minari(
                out,
                recording,
                found.goal_indices,
                found.radius,
                found.goal_parts,
                dataset_id=f"guider/{task}-v0",
                recipe=found.collector.recipe,
                description=f"{found.environment}; made by: guider collect {task} --steps {steps} --seed {seed}",
                seed=seed,
                report=show,
            )
    answer({"data": str(out), "steps": steps, "seed": seed}, f"recorded {out}", as_json)
