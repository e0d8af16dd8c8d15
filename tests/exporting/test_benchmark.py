"""The benchmark of exported policies runs, and finds them alike."""

from __future__ import annotations

from benchmarks import exporting


def test_it_finds_actions_alike_and_would_not_others(monkeypatch, tmp_path):
    monkeypatch.setattr(exporting, "INPUTS", 5)
    policy = exporting.with_routes(exporting.untrained_policy(exporting.TASK))
    acting = exporting.contenders(policy, tmp_path)
    ours = acting.pop("JAX")
    differences = exporting.on_random_inputs(ours, acting)
    assert set(differences) == {"NumPy", "onnxruntime"} and max(differences.values()) < exporting.DIFFERENCE

    class Halved:
        reset = ours.reset

        def act(self, observation, goal):
            return ours.act(observation, goal) / 2

    assert exporting.on_random_inputs(ours, {"halved": Halved()})["halved"] > 100 * exporting.DIFFERENCE
