"""What training several seeds in one program gains over training them one after the other.

python -m benchmarks.seeds [--seeds N] [--rounds N] [--seconds S] [--json]
"""

from __future__ import annotations

import argparse
import json
import statistics
from typing import Any

from benchmarks.common import (
    STAGES,
    alternate,
    antmaze_config,
    antmaze_episodes,
    print_table,
    ratios,
    show_ratio,
    trainer,
)
from guider.data.episodes import Episodes


def measure(stage: str, episodes: Episodes, seeds: int, rounds: int, seconds: float) -> dict[str, Any]:
    """Rates in updates per second of every seed; the gain is the speed-up over one seed after the other."""
    config = antmaze_config("fast")
    contenders = {
        "one": trainer(config, stage, episodes),
        "together": trainer(config, stage, episodes, range(seeds)),
    }
    rates = alternate(contenders, rounds, seconds)
    per_seed = ratios(rates["together"], rates["one"])
    return {
        "seeds": seeds,
        "rates": rates,
        "median_rates": {name: statistics.median(values) for name, values in rates.items()},
        "per_seed_to_one": per_seed,
        "gain": {name: seeds * ratio for name, ratio in per_seed.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.seeds", description=__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="how many seeds train together")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each contender, in alternation")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a run")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    options = parser.parse_args()
    episodes = antmaze_episodes()
    results = {s: measure(s, episodes, options.seeds, options.rounds, options.seconds) for s in STAGES}
    if options.json:
        print(json.dumps(results))
        return
    rows = [
        (
            stage,
            f"{result['median_rates']['one']:.1f}",
            f"{result['median_rates']['together']:.1f}",
            show_ratio(result["per_seed_to_one"]),
            show_ratio(result["gain"]),
        )
        for stage, result in results.items()
    ]
    header = ("stage", "1 seed /s", f"{options.seeds} seeds /s each", "each to one", "gain over in turn")
    print_table("Preset fast, updates per second of every seed", header, rows)


if __name__ == "__main__":
    main()
