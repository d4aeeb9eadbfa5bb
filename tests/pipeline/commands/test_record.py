"""``make record`` with a controller of the user's: what it writes can be learned from at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from configs import compose
from envs import find_task
from envs.demonstrations import DemoOptions, load_demonstrations, read_card
from pipeline import cli
from pipeline.build import build_run
from tests.toys import reach

AS_RECORDED = DemoOptions(resimulate=False)
FILE = str(Path(reach.__file__))
# Turns with each step: one step is (1, 2, ..., T); it succeeds where the action was above 0.5.
MINE = """
import gymnasium
import numpy as np
from gymnasium.spaces import Box
import torch


class Mine(gymnasium.Env):
    observation_space = Box(-99.0, 99.0, (2,), np.float32)
    action_space = Box(-2.0, 2.0, (1,), np.float32)
    tells = True

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.start, self.t = float(self.np_random.uniform(-1, 1)), 0
        return self.seen(), {}

    def seen(self):
        return np.array([self.start, self.t], np.float32)

    def step(self, action):
        self.t += 1
        told = {"success": self.start + action[0] > 1.0} if self.tells else {}
        return self.seen(), float(action[0]), False, self.t >= 5, told


class Mute(Mine):
    tells = False


def half(observation):
    return np.full((len(observation), 1), 0.5)


def tensors(observation: torch.Tensor) -> torch.Tensor:
    return torch.full((observation.shape[0], 1), 0.5)


class Counting:
    def __init__(self):
        self.calls = 0

    def __call__(self, observation):
        self.calls += 1
        return np.full((len(observation), 1), self.calls / 10)


def narrow(observation):
    return np.zeros(len(observation))


def loud(observation):
    return np.full((len(observation), 1), -1.5)


def undefined(observation):
    return np.full((len(observation), 1), np.nan)


def broken(observation):
    raise KeyError("x")
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def record(monkeypatch: pytest.MonkeyPatch):
    def run(*arguments: object) -> None:
        monkeypatch.setattr("sys.argv", ["bcsac", "record", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        if ended.value.code:
            raise ValueError(ended.value.code)

    return run


def trained_on(path: Path, task: str, folder: Path, *overrides: str):
    recipe = compose(
        "variant=bc_sac", "preset=smoke", f"task.name='{task}'", f"demos.source='{path}'",
        f"cache_dir='{folder / 'cache'}'", "collector.total_frames=100", "demos.held_out=1",
        *overrides,
    )  # fmt: skip
    run = build_run(recipe, folder / "run")
    run.train()
    return run


def test_the_toy_is_recorded_and_learned_from(record, tmp_path: Path):
    out = tmp_path / "reach.h5"
    record("", "--task", FILE, "--policy", f"{FILE}:controller", "--out", out, "--episodes", 4)
    loaded = load_demonstrations(out, find_task(FILE), AS_RECORDED)
    assert len(loaded.episodes) == 4
    assert all(episode.succeeds for episode in loaded.episodes)
    assert read_card(out)["policy"] == {"controller": f"{FILE}:controller"}
    assert trained_on(out, FILE, tmp_path).trainer.collected_frames == 100


def test_a_gymnasium_environment_is_recorded_and_learned_from(record, mine: Path):
    """0.5 is 1.0 of the environment's; a start above 0 succeeds, which half of them are."""
    record("", "env.horizon=5", "--task", "mine.py:Mine", "--policy", "mine.py:half", "--out",
           "d.h5", "--episodes", 6, "--attempts", 40)  # fmt: skip
    card = read_card(Path("d.h5"))
    assert card["admission"] == "success"
    assert card["admitted"] < card["attempts"]
    loaded = load_demonstrations("d.h5", find_task("mine.py:Mine"), AS_RECORDED)
    assert len(loaded.episodes) == 6
    for episode in loaded.episodes:
        assert episode.observations[0, 0] > 0.0
        np.testing.assert_array_equal(episode.actions, np.full((5, 1), 0.5))
        assert episode.rewards.tolist() == [1.0] * 5
    assert (
        trained_on(Path("d.h5"), "mine.py:Mine", mine, "env.horizon=5").trainer.collected_frames
        == 100
    )


def test_without_success_every_whole_episode_is_kept_and_that_is_said(record, mine: Path, capsys):
    record(
        "",
        "env.horizon=5",
        "--task",
        "mine.py:Mute",
        "--policy",
        "mine.py:tensors",
        "--episodes",
        3,
    )
    assert "every complete episode: the task tells no success" in capsys.readouterr().out
    card = read_card(Path("demonstrations.h5"))
    assert (card["kept"], card["max_progress_mean"]) == (3, None)
    with pytest.raises(ValueError, match=r"demonstrations.h5 exists: say OUT=demonstrations.h5"):
        record(
            "",
            "env.horizon=5",
            "--task",
            "mine.py:Mute",
            "--policy",
            "mine.py:tensors",
            "--episodes",
            3,
        )
    record("", "env.horizon=5", "--task", "mine.py:Mute", "--policy", "mine.py:half", "--episodes",
           2, "--out", "demonstrations.h5")  # fmt: skip
    assert read_card(Path("demonstrations.h5"))["kept"] == 2


def test_a_class_begins_anew_with_each_batch_of_episodes(record, mine: Path):
    """Eight copies of a Python environment at most: nine episodes are two batches."""
    record("", "env.horizon=5", "--task", "mine.py:Mute", "--policy", "mine.py:Counting", "--out",
           "d.h5", "--episodes", 9)  # fmt: skip
    for episode in load_demonstrations("d.h5", find_task("mine.py:Mute"), AS_RECORDED).episodes:
        np.testing.assert_allclose(episode.actions[:, 0], [0.1, 0.2, 0.3, 0.4, 0.5], rtol=1e-6)


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ("mine.py:narrow", r"gave actions of shape \[8\]; expected \[8, 1\]"),
        ("mine.py:loud", r"magnitude 1.5; expected \[-1, 1\]"),
        ("mine.py:undefined", r"magnitude nan; expected \[-1, 1\]"),
        ("mine.py:broken", r"POLICY=mine.py:broken raised: mine.py, line 6\d \(KeyError: 'x'\)"),
        ("mine.py:gone", r"POLICY=mine.py:gone: there is no 'gone'"),
        ("gone.py:f", r"there is no file 'gone.py'"),
    ],
)
def test_what_is_wrong_with_a_controller_is_one_line(record, mine: Path, policy: str, message: str):
    with pytest.raises(ValueError, match=message) as refused:
        record("", "env.horizon=5", "--task", "mine.py:Mine", "--policy", policy)
    assert "\n" not in str(refused.value)
    assert not Path("demonstrations.h5").exists()


def test_a_run_or_a_controller_but_not_both(record, mine: Path):
    with pytest.raises(ValueError, match="got neither"):
        record("", "env.horizon=5", "--task", "mine.py:Mine")
    with pytest.raises(ValueError, match=r"got RUN=runs/x and POLICY=mine.py:half"):
        record("runs/x", "--policy", "mine.py:half")


def test_a_run_of_a_file_is_used_with_its_file_named_again(record, mine: Path):
    record(
        "", "env.horizon=5", "--task", "mine.py:Mute", "--policy", "mine.py:half", "--episodes", 3
    )
    run = trained_on(Path("demonstrations.h5"), "mine.py:Mute", mine, "env.horizon=5")
    admit = "growth.admission.min_return=-100"
    with pytest.raises(ValueError, match=r"TRUST=1, or name it yourself: TASK=mine.py:Mute"):
        record(run.run_dir, "--episodes", 2)
    record(run.run_dir, admit, "--task", "mine.py:Mute", "--episodes", 2)
    assert read_card(run.run_dir / "demonstrations.h5")["admission"] == "growth.admission"
