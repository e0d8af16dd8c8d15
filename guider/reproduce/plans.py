"""What each table and figure of the paper needs: a grid of runs, tasks times variants.

Runs are named by what they are, not by what asked for them, so that whatever needs the same run shares it.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from guider.errors import GuiderError, names_like
from guider.learning.options import Preset
from guider.learning.problem import Problem
from guider.methods import find_method, preset_config
from guider.reproduce import paper
from guider.reproduce.paper import PaperScore
from guider.support.config import flatten, to_dict
from guider.tasks import find_task


@dataclass(frozen=True)
class Variant:
    """A column of a table or a line of a figure: a method, with settings of its own.

    name: of the runs; label: for readers; period_steps: c, None for the task's own.
    """

    name: str
    label: str
    method: str
    settings: dict[str, str] = field(default_factory=dict)
    period_steps: int | None = None


@dataclass(frozen=True)
class Target:
    """A table or figure of the paper.

    scores: task -> what the paper prints for each of `variants`, in order; by_method: its variants are whole methods,
    so that others may be asked for in their place; curves: its runs are evaluated all along, which takes its time.
    """

    title: str
    tasks: tuple[str, ...]
    variants: tuple[Variant, ...]
    scores: dict[str, tuple[PaperScore, ...]]
    by_method: bool = False
    curves: bool = False


def of_method(method: str) -> Variant:
    """A method as it is. Raises GuiderError for one that is none."""
    return Variant(method, find_method(method).label, method)


GUIDER = of_method("guider")
WITHOUT_PRIOR = Variant("guider-without-prior", "Guider w/o prior", "guider", {"high.prior": "false"})
WITHOUT_CQL = Variant("guider-without-cql", "Guider w/o CQL", "guider", {"high.critic": "td"})
WITHOUT_BOTH = Variant(
    "guider-without-prior-or-cql", "Guider w/o prior or CQL", "guider", WITHOUT_PRIOR.settings | WITHOUT_CQL.settings
)
WITHOUT_DECODER = Variant("guider-without-decoder", "Guider w/o decoder", "guider", {"low.subgoal_input": "latent"})

# Where either of the two guards suffices, only a run without both shows what they guard against; the paper has none.
_REGULARISATION = (GUIDER, WITHOUT_PRIOR, WITHOUT_CQL, WITHOUT_BOTH)
_REGULARISATION_SCORES = {task: (*scores, None) for task, scores in paper.TABLE_2.items()}
_PERIODS = tuple(Variant(f"guider-c{c}", f"c = {c}", "guider", period_steps=c) for c in paper.TABLE_3_PERIODS)
_TABLE_1_VARIANTS = tuple(of_method(method) for method in paper.TABLE_1_METHODS)
# Figure 4: the paper's text names the low levels; their bars without Guider are Table 1's methods.
_LOW_LEVELS = ("gcsl", "guider-gcsl", "wgcsl", "guider-wgcsl", "cql-her", "guider-cql", "guider")


def _from_table_1(task: str, variants: Sequence[Variant]) -> tuple[PaperScore, ...]:
    return tuple(paper.from_table_1(task, variant.name) for variant in variants)


def _figure(
    title: str, tasks: Sequence[str], variants: Sequence[Variant], by_method: bool = False, curves: bool = False
) -> Target:
    scores = {task: _from_table_1(task, variants) for task in paper.TABLE_1}
    return Target(title, tuple(tasks), tuple(variants), scores, by_method, curves)


# Where the paper does not say which tasks a figure shows, those of Table 2 stand in: one of each domain.
TARGETS: dict[str, Target] = {
    "table1": Target(
        "Table 1: all tasks and methods", tuple(paper.TABLE_1), _TABLE_1_VARIANTS, paper.TABLE_1, by_method=True
    ),
    "table2": Target(
        "Table 2: regularisation of the high level", tuple(paper.TABLE_2), _REGULARISATION, _REGULARISATION_SCORES
    ),
    "table3": Target("Table 3: subgoal period c", tuple(paper.TABLE_3), _PERIODS, paper.TABLE_3),
    "figure3": _figure("Figure 3: subgoals along episodes", tuple(paper.TABLE_2), [GUIDER]),
    "figure4": _figure(
        "Figure 4: low levels with and without Guider's high level",
        ["antmaze-large-diverse"],
        [of_method(method) for method in _LOW_LEVELS],
        by_method=True,
    ),
    "figure5": _figure(
        "Figure 5: with and without decoder", tuple(paper.TABLE_2), [GUIDER, WITHOUT_DECODER], curves=True
    ),
    "figure6": _figure(
        "Figure 6: learning curves", tuple(paper.TABLE_1), _TABLE_1_VARIANTS, by_method=True, curves=True
    ),
    "figure7": Target(
        "Figure 7: subgoals against where the agent was c steps later",
        ("antmaze-large-diverse",),
        _REGULARISATION,
        _REGULARISATION_SCORES,
    ),
}


@dataclass(frozen=True)
class PlannedRun:
    """Everything asked of a run; equal runs of two plans are one run.

    settings: by dotted name, as on the command line; period_steps: c, None for the task's own; curve: evaluated all
    along.
    """

    task: str
    variant: str
    method: str
    preset: Preset
    seeds: tuple[int, ...]
    settings: dict[str, str]
    period_steps: int | None
    curve: bool

    @property
    def name(self) -> str:
        """Its directory below OUT/runs: task/variant-preset, with -curve where it has one."""
        return f"{file_name(self.task)}/{self.variant}-{self.preset}{'-curve' if self.curve else ''}"

    def request(self) -> dict[str, Any]:
        """What is asked, as JSON gives it back."""
        return asdict(self) | {"seeds": list(self.seeds)}


@dataclass(frozen=True)
class Protocol:
    """What all runs of a plan have in common: the options of the command.

    settings: by dotted name, for every run, or as METHOD:NAME for those of one method.
    """

    preset: Preset = "fast"
    seeds: int = 4
    first_seed: int = 0
    episodes: int = 100
    settings: dict[str, str] = field(default_factory=dict)
    data: Path = Path("datasets")
    out: Path = Path("runs/reproduce")


@dataclass(frozen=True)
class Plan:
    """A table or figure, and the runs it is made of.

    grid, paper_scores: [task][variant].
    """

    name: str
    title: str
    tasks: tuple[str, ...]
    variants: tuple[Variant, ...]
    grid: tuple[tuple[PlannedRun, ...], ...]
    paper_scores: tuple[tuple[PaperScore, ...], ...]
    by_method: bool
    protocol: Protocol

    @property
    def runs(self) -> list[PlannedRun]:
        return [run for row in self.grid for run in row]

    def directory(self, run: PlannedRun) -> Path:
        return self.protocol.out / "runs" / run.name

    def data_path(self, task: str) -> Path:
        """Where the task's data is, or would be recorded: DATA/TASK.hdf5, or the Minari dataset DATA/TASK."""
        dataset = self.protocol.data / file_name(task)
        return dataset if dataset.is_dir() else dataset.with_name(f"{dataset.name}.hdf5")

    def command(self, task: str | None = None) -> str:
        """The command line that fills this plan, or one task's row of it."""
        protocol, default = self.protocol, Protocol()
        words = ["guider", "reproduce", self.name, "--tasks", *(self.tasks if task is None else (task,))]
        if self.by_method:
            words += ["--methods", *(variant.method for variant in self.variants)]
        for option in ("preset", "seeds", "first_seed", "episodes", "data", "out"):
            if getattr(protocol, option) != getattr(default, option):
                words += [f"--{option.replace('_', '-')}", str(getattr(protocol, option))]
        if protocol.settings:
            words += ["--set", *(f"{name}={value}" for name, value in protocol.settings.items())]
        return shlex.join(words)


def make_plan(name: str, protocol: Protocol, tasks: Sequence[str] = (), methods: Sequence[str] = ()) -> Plan:
    """The plan of a table or figure; tasks, methods: in place of the paper's, where any are given.

    Raises GuiderError for tasks, methods and settings that there are not, and for settings that the target itself
    compares.
    """
    target = TARGETS[name]
    if protocol.seeds < 1 or protocol.first_seed < 0 or protocol.episodes < 1:
        raise GuiderError("--seeds and --episodes must be 1 or more, --first-seed 0 or more")
    if methods and not target.by_method:
        raise GuiderError(f"{name} compares settings of one method; leave --methods out")
    variants = tuple(of_method(method) for method in dict.fromkeys(methods)) or target.variants
    for setting in protocol.settings:
        method, colon, _ = setting.partition(":")
        if colon and method not in {variant.method for variant in variants}:
            raise GuiderError(f"--set {setting}: {name} has no runs of a method {method!r}")
    known: set[str] = set()
    for variant in variants:
        if compared := variant.settings.keys() & _settings_of(variant.method, protocol):
            raise GuiderError(f"{name} compares values of {compared.pop()}; leave it out of --set")
        known |= flatten(to_dict(preset_config(variant.method, protocol.preset, Problem()))).keys()
    if unknown := [s for s in protocol.settings if s.rpartition(":")[2] not in known]:
        raise GuiderError(f"--set {unknown[0]}: no run has that setting; {names_like(unknown[0], known)}")
    chosen = tuple(dict.fromkeys(tasks)) or target.tasks
    if name == "figure7" and (open_fields := [task for task in chosen if find_task(task).maze is None]):
        raise GuiderError(f"figure7 is drawn on the map of a maze, and {open_fields[0]} has none")
    printed = {
        task: dict(zip((variant.name for variant in target.variants), scores, strict=True))
        for task, scores in target.scores.items()
    }
    return Plan(
        name=name,
        title=target.title,
        tasks=chosen,
        variants=variants,
        grid=tuple(tuple(_planned(task, variant, protocol, target.curves) for variant in variants) for task in chosen),
        paper_scores=tuple(tuple(printed.get(task, {}).get(v.name) for v in variants) for task in chosen),
        by_method=target.by_method,
        protocol=protocol,
    )


def _planned(task: str, variant: Variant, protocol: Protocol, curve: bool) -> PlannedRun:
    """The run of a variant on a task; one whose c is the task's own is the plain method's run."""
    if variant.period_steps == find_task(task).period_steps:
        variant = of_method(variant.method)
    return PlannedRun(
        task=task,
        variant=variant.name,
        method=variant.method,
        preset=protocol.preset,
        seeds=tuple(range(protocol.first_seed, protocol.first_seed + protocol.seeds)),
        settings=variant.settings | _settings_of(variant.method, protocol),
        period_steps=variant.period_steps,
        curve=curve,
    )


def _settings_of(method: str, protocol: Protocol) -> dict[str, str]:
    """The settings asked for that are for this method's runs; those that name it come last, and win."""
    named = {name.partition(":")[::2]: value for name, value in protocol.settings.items() if ":" in name}
    for_all = {name: value for name, value in protocol.settings.items() if ":" not in name}
    return for_all | {name: value for (owner, name), value in named.items() if owner == method}


def file_name(task: str) -> str:
    """A task's name as a file's."""
    return re.sub(r"[^A-Za-z0-9.-]+", "-", task)
