# pyright: reportAttributeAccessIssue=false
# (mujoco is a compiled module without type stubs)
"""The ant is D4RL's: its constants, its resets, and a replay of data recorded by D4RL's policy."""

import importlib.util
from pathlib import Path

import mujoco
import numpy as np
import pytest

from guider.tasks import find_task
from guider.tasks.antmaze import FRAME_SKIP, INITIAL_QPOS, ULTRA_GOAL_SHIFT_M, ant_model, sample_start
from guider.tasks.mazes import make_maze
from guider.tasks.replay import take_steps

RECREATION = Path(__file__).resolve().parents[3] / "shared" / "d4rl_antmaze"
PHYSICS = """
nq nv nu nbody ngeom qpos0 body_mass body_inertia body_ipos body_iquat body_pos body_quat body_parentid
geom_type geom_contype geom_conaffinity geom_condim geom_pos geom_quat geom_friction geom_solref geom_solimp
geom_solmix geom_margin geom_gap geom_priority geom_bodyid jnt_type jnt_range jnt_limited jnt_axis jnt_pos
jnt_stiffness jnt_margin jnt_solref jnt_solimp dof_damping dof_armature dof_frictionloss actuator_gear
actuator_ctrlrange actuator_ctrllimited actuator_trnid actuator_gainprm actuator_biasprm actuator_biastype
""".split()
OPTIONS = "timestep integrator gravity solver iterations tolerance cone impratio density viscosity wind".split()


def recreation():
    """The script that re-creates D4RL's data, as a module."""
    if not (RECREATION / "make.py").exists():
        pytest.skip("no shared/d4rl_antmaze beside the repository: D4RL's recording policy is not at hand")
    pytest.importorskip("ogbench", reason="ogbench, whose ant D4RL's data is re-created with, is not installed")
    spec = importlib.util.spec_from_file_location("d4rl_antmaze_make", RECREATION / "make.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_model_constants():
    model = ant_model(make_maze("umaze", 4.0))
    assert (model.nq, model.nv, model.nu) == (15, 14, 8)
    assert model.opt.timestep == 0.02
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    np.testing.assert_array_equal(model.actuator_gear[:, 0], 30.0)
    np.testing.assert_array_equal(model.actuator_ctrlrange, [[-1.0, 1.0]] * 8)
    np.testing.assert_array_equal(model.dof_armature, [0.0] * 6 + [1.0] * 8)
    np.testing.assert_array_equal(model.dof_damping, [0.0] * 6 + [1.0] * 8)
    np.testing.assert_array_equal(model.geom_solref, np.tile([0.02, 1.0], (model.ngeom, 1)))
    np.testing.assert_array_equal(model.geom_solimp[:, :3], np.tile([0.8, 0.8, 0.01], (model.ngeom, 1)))
    np.testing.assert_array_equal(model.geom_margin, 0.01)
    np.testing.assert_array_equal(model.geom_friction, np.tile([1.0, 0.5, 0.5], (model.ngeom, 1)))
    torso = model.body("torso").id
    assert model.body_mass[torso] == pytest.approx(5.0 * 4 / 3 * np.pi * 0.25**3)  # density 5, radius 0.25 m


def test_walls_stand_where_d4rl_puts_them():
    model = ant_model(make_maze("large", 4.0))
    wall = model.geom("wall_4_2")
    np.testing.assert_array_equal(wall.pos, [4.0, 12.0, 1.0])
    np.testing.assert_array_equal(wall.size, [2.0, 2.0, 1.0])
    assert sum(model.geom(i).name.startswith("wall") for i in range(model.ngeom)) == 9 * 12 - 46


@pytest.mark.parametrize("name", ["umaze", "medium", "large"])
def test_physics_equals_the_model_the_data_is_recreated_with(name):
    theirs, _ = recreation().model_for(name)
    ours = ant_model(make_maze(name, 4.0))
    for field in PHYSICS:
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field), err_msg=field)
    for field in OPTIONS:
        np.testing.assert_array_equal(getattr(ours.opt, field), getattr(theirs.opt, field), err_msg=field)
    floor = ours.geom("floor").id
    finite = np.arange(ours.ngeom) != floor  # a plane's size is only drawn
    np.testing.assert_array_equal(ours.geom_size[finite], theirs.geom_size[finite])


def test_replay_lands_on_the_recorded_states():
    """99 % of rows within 1e-5, all within 1e-3 of what a state that rounds to the recorded one leads to.

    Whether a foot touches or a joint meets its limit can hang on the rounding of the recorded state to
    float32: one row in ten thousand lands elsewhere, and lands right from a state moved within its rounding.
    """
    states, actions, _, _ = recreation().run(("large", 6, RECREATION / "d4rl_ant_policy.npz", 7, 600))
    first = np.flatnonzero(np.arange(len(states)) % 600 != 599)
    model = ant_model(make_maze("large", 4.0))
    landed = take_steps(model, FRAME_SKIP, states[first].astype(float), actions[first])
    errors = np.abs(landed - states[first + 1]).max(axis=1)
    assert np.mean(errors < 1e-5) >= 0.99

    rng = np.random.default_rng(0)
    for row in first[errors >= 1e-3]:
        rounding = rng.uniform(-0.5, 0.5, (64, 29)) * np.spacing(np.abs(states[row])).astype(float)
        landed = take_steps(model, FRAME_SKIP, states[row] + rounding, np.repeat(actions[row][None], 64, axis=0))
        assert np.abs(landed - states[row + 1]).max(axis=1).min() < 1e-3


def test_episodes_start_and_aim_where_d4rl_says():
    maze = make_maze("large", 4.0)
    rng = np.random.default_rng(0)
    starts = [sample_start(maze, 0.0, rng) for _ in range(4000)]
    qpos, qvel, goals = (np.array([getattr(s, key) for s in starts]) for key in ("qpos", "qvel", "goal"))
    noise = qpos - np.array(INITIAL_QPOS)
    assert np.abs(noise).max() <= 0.1
    np.testing.assert_allclose(noise.std(axis=0), 0.1 / np.sqrt(3), rtol=0.05)
    np.testing.assert_allclose(qvel.std(axis=0), 0.1, rtol=0.06)
    offsets = goals - [32.0, 24.0]
    assert offsets.min() >= 0.0 and 1.4 < offsets.max() <= 1.5
    np.testing.assert_allclose(offsets.mean(axis=0), 0.75, atol=0.02)
    np.testing.assert_allclose(offsets.var(axis=0), 1 / 12 + 0.25 / 12, rtol=0.06)  # of U(0, 1) + U(0, 0.5)


def test_no_goal_coordinate_is_negative():
    maze = make_maze("umaze", 4.0)
    goals = np.array([sample_start(maze, 0.0, np.random.default_rng(i)).goal for i in range(200)])
    assert goals[:, 0].min() >= 0.0 and goals[:, 1].min() >= 8.0


def test_ultra_aims_a_metre_nearer_the_origin():
    maze = make_maze("ultra", 4.0)
    rng = np.random.default_rng(0)
    offsets = np.array([sample_start(maze, ULTRA_GOAL_SHIFT_M, rng).goal for _ in range(2000)]) - [52.0, 36.0]
    assert -1.0 <= offsets.min() < -0.9 and 0.4 < offsets.max() <= 0.5
    env = find_task("antmaze-ultra-diverse").make_env(1)
    _, goals = env.reset(np.array([0]))
    env.close()
    np.testing.assert_array_equal(
        goals[0], sample_start(maze, ULTRA_GOAL_SHIFT_M, np.random.default_rng(0)).goal.astype(np.float32)
    )


def test_a_copy_is_determined_by_its_seed_alone():
    task = find_task("antmaze-umaze-diverse")
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (20, 8, 8))
    many, few = task.make_env(8), task.make_env(1)
    seeds = np.arange(100, 108)
    first, goals = many.reset(seeds)
    assert first.shape == (8, 29) and first.dtype == np.float32 and goals.shape == (8, 2)
    trajectory = np.array([first, *(many.step(a, np.ones(8, bool)) for a in actions)])
    for copy in (0, 5):
        alone, goal = few.reset(seeds[copy : copy + 1])
        np.testing.assert_array_equal(goal[0], goals[copy])
        rerun = np.array([alone, *(few.step(a[copy : copy + 1], np.ones(1, bool)) for a in actions)])
        np.testing.assert_array_equal(rerun[:, 0], trajectory[:, copy])
    many.close()
    few.close()


@pytest.mark.parametrize(("route", "horizon_steps"), [("S" + 3 * "." + "G", 700), ("S" + 11 * "." + "G", 1200)])
def test_a_drawn_maze(tmp_path, route, horizon_steps):
    wall = "#" * (len(route) + 2)
    (tmp_path / "line.txt").write_text(f"{wall}\n{wall}\n#{route}#\n{wall}\n")
    task = find_task(f"antmaze:{tmp_path / 'line.txt'}")
    assert (task.horizon_steps, task.name) == (horizon_steps, f"antmaze:{tmp_path / 'line.txt'}")
    assert "line.txt" in task.environment
    env = task.make_env(50)
    observations, goals = env.reset(np.arange(50))
    env.close()
    assert np.abs(observations[:, :2] - [0.0, 4.0]).max() <= 0.1
    offsets = goals - [4.0 * (len(route) - 1), 4.0]
    assert offsets.min() >= 0.0 and offsets.max() <= 1.5


@pytest.mark.parametrize("data", ["play", "everywhere"])
def test_tasks_of_one_maze_differ_in_the_data_alone(data):
    for size in ("medium", "large"):
        diverse, other = (find_task(f"antmaze-{size}-{name}") for name in ("diverse", data))
        facts = "horizon_steps radius reach_radius environment maze goal_indices score".split()
        assert all(getattr(diverse, fact) == getattr(other, fact) for fact in facts)
        assert other.paper_score is None


def test_tasks_are_the_papers():
    facts = {
        name: (task.horizon_steps, task.period_steps, task.radius, task.reach_radius, task.paper_score)
        for name in ("antmaze-umaze-diverse", "antmaze-medium-diverse", "antmaze-large-diverse")
        for task in [find_task(name)]
    }
    assert facts == {
        "antmaze-umaze-diverse": (700, 50, 0.5, 1.0, 88.5),
        "antmaze-medium-diverse": (1000, 50, 0.5, 1.0, 87.3),
        "antmaze-large-diverse": (1000, 50, 0.5, 1.0, 80.8),
    }
    environment = find_task("antmaze-large-diverse").environment
    assert "gear 30" in environment and mujoco.__version__ in environment
