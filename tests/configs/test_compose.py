"""Composition: every variant under every preset, and nothing that the schema does not know."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hydra.errors import ConfigCompositionException, MissingConfigException

import configs
from configs.composition import adjusted, register_task_defaults, spelled_for_hydra, task_named
from pipeline.dotted import flatten, nest
from pipeline.files.run_files import CONFIG
from pipeline.overrides import overridden
from pipeline.recipe import Recipe
from pipeline.renamed import REMOVED, RENAMED, rename_keys
from pipeline.run_dir import load_recipe
from pipeline.settings import SettingsError
from pipeline.updates import portion_frames, updates_per_portion

POLICIES = Path(__file__).parents[2] / "docs" / "results" / "policies"
PAPER = ["sac", "bc", "bc_sac", "dbc_sac", "sid_bc", "sid_dbc", "ila_bc", "ila_dbc", "da_sac"]
RIVALS = ["ibrl", "loki", "qc_rlpd", "rfcl", "rlpd", "sacfd", "sil"]
VARIANTS = [*PAPER, "best", "gentle", *RIVALS]
PRESETS = ["smoke", "default", "table", "paper"]
UPDATES = {"smoke": 10, "default": 150, "table": 75, "paper": 1}
"""After each portion: 0.1, 0.3, 0.15 and 1 a frame, of 100, 500, 500 and 1 frames."""
RIVALS_UPDATES = {
    "qc_rlpd": {"smoke": 100, "default": 500, "table": 500, "paper": 1},
    "rfcl": {"smoke": 1000, "default": 5000, "table": 5000, "paper": 10},
    "rlpd": {"smoke": 2000, "default": 10_000, "table": 10_000, "paper": 20},
}
"""Those that make 1, 10 and 20 a frame, whatever the preset."""


def compose_config(variant: str, preset: str, *overrides: str) -> Recipe:
    return configs.compose(f"variant={variant}", f"preset={preset}", *overrides)


NAMES = {"variant", "preset"}


def flat(variant: str, preset: str = "paper", *overrides: str) -> dict[str, Any]:
    """The composed configuration as dotted keys, less what names the run."""

    def leaves(node: dict[str, Any], prefix: str) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in node.items():
            found |= (
                leaves(value, f"{prefix}{key}.")
                if isinstance(value, dict)
                else {prefix + key: value}
            )
        return found

    config = compose_config(variant, preset, *overrides).plain()
    return {k: v for k, v in leaves(config, "").items() if k not in NAMES}


def changes(variant: str, parent: str, preset: str) -> dict[str, Any]:
    ours, theirs = flat(variant, preset), flat(parent, preset)
    return {key: value for key, value in ours.items() if value != theirs[key]}


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant_composes_with_every_preset(variant: str, preset: str):
    config = compose_config(variant, preset)
    assert (config.variant, config.preset) == (variant, preset)
    assert Recipe.of(config.plain(), "itself") == config
    # Published numbers are of portions that the copies divide.
    assert portion_frames(config) == config.collector.frames_per_batch
    assert updates_per_portion(config) == RIVALS_UPDATES.get(variant, UPDATES)[preset]


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    ("variant", "parent", "delta"),
    [
        ("sid_bc", "bc_sac", {"growth.self_imitation": True}),
        ("sid_dbc", "dbc_sac", {"growth.self_imitation": True}),
        ("ila_bc", "bc_sac", {"growth.bc_model": True}),
        ("ila_dbc", "dbc_sac", {"growth.bc_model": True}),
        ("da_sac", "sac", {"sampler.demo_update_period": 2}),
        ("loki", "sac", {"pretrain": True}),
    ],
)
def test_a_variant_is_its_delta(variant: str, parent: str, delta: dict, preset: str):
    assert changes(variant, parent, preset) == delta


@pytest.mark.parametrize("preset", PRESETS)
def test_dbc_sac_lets_the_weight_decay(preset: str):
    alpha = {"paper": 0.999}.get(preset, 0.9999)  # the paper's in the tables, and ours
    delta = {"loss.bc_weight.kind": "exponential", "loss.bc_weight.decay": alpha}
    assert changes("dbc_sac", "bc_sac", preset) == delta


@pytest.mark.parametrize("key", ["loss.bc_weight.decay", "loss.bc_decay"])
def test_an_alpha_that_is_typed_comes_before_the_presets(key: str):
    """Under its old name too, for one release."""
    typed = compose_config("dbc_sac", "default", f"{key}=0.99").loss.bc_weight
    assert (typed.kind, typed.decay) == ("exponential", 0.99)
    changed = compose_config("dbc_sac", "default").changed(loss={"bc_weight": {"decay": 0.99}})
    assert changed.loss.bc_weight == typed


@pytest.mark.parametrize("override", ["dbc_decay=0.99", "+dbc_decay=0.99", "++dbc_decay=0.99"])
def test_what_a_preset_says_to_variants_cannot_be_typed(override: str):
    with pytest.raises(ValueError, match=r"^dbc_decay is .* type loss\.bc_weight\.decay=0\.99, "):
        compose_config("dbc_sac", "default", override)


def test_under_the_paper_preset_bc_sac_is_sac_with_imitation():
    assert changes("bc_sac", "sac", "paper") == {
        "loss.bc_weight.init": 1.0,
        "sampler.demo_ratio": 1.0,
    }
    assert changes("bc", "bc_sac", "paper").pop("offline") is True


@pytest.mark.parametrize("preset", PRESETS)
def test_sac_sees_no_demonstration(preset: str):
    config = compose_config("sac", preset)
    assert config.sampler.demo_ratio == 0
    assert config.sampler.demo_update_period == 0
    assert config.loss.bc_weight.init == 0
    assert config.loss.bc_gradient_ratio is None
    used = {
        "pretrain": config.pretrain,
        "offline": config.offline,
        "self-imitation": config.growth.self_imitation,
        "BC model": config.growth.bc_model,
        "actor's statistics": config.actor.normalise_observations,
        "critic's statistics": config.critic.normalise_observations,
    }
    assert [name for name, on in used.items() if on] == []


@pytest.mark.parametrize("variant", PAPER)
def test_the_paper_preset_is_section_iv_b_and_nothing_of_ours(variant: str):
    config = flat(variant, "paper")
    paper = {
        "actor.hidden": [1024, 1024],
        "critic.hidden": [1024, 1024],
        "actor.log_std_min": -5.0,
        "actor.log_std_max": 2.0,
        "critic.num_critics": 2,
        "loss.gamma": 0.99,
        "optim.actor_lr": 1e-5,
        "optim.critic_lr": 1e-5,
        "optim.temperature_lr": 1e-5,
        "bc.lr": 1e-5,
        "sampler.batch_size": 1024,
        "collector.total_frames": 100_000,
        "collector.random_frames": 10_000,
        "optim.updates_per_frame": 1.0,
        "collector.frames_per_batch": 1,
    }
    stabilisers_off = {
        "pretrain": False,
        "demos.multiply.enabled": False,
        "actor.layer_norm": False,
        "critic.layer_norm": False,
        "actor.normalise_observations": False,
        "critic.normalise_observations": False,
        "loss.n_step": 1,
        "loss.reward_scale": 1.0,
        "loss.entropy_in_target": True,
        "loss.rl_on_demos": False,
        "loss.actor_value": "min",
        "loss.target_subset": None,
        "loss.bc_gradient_ratio": None,
        "optim.max_grad_norm": None,
        "optim.actor_delay": 0,
    }
    expected = paper | stabilisers_off
    assert {key: config[key] for key in expected} == expected


@pytest.mark.parametrize("weight", [0.1, 10.0])
def test_the_papers_other_lambdas_are_one_override_away(weight: float):
    config = compose_config("bc_sac", "paper", f"loss.bc_weight.init={weight}")
    assert config.loss.bc_weight.init == weight


def test_the_smoke_preset_takes_seconds():
    config = compose_config("ila_dbc", "smoke")
    updates = config.collector.total_frames * config.optim.updates_per_frame
    assert config.collector.total_frames <= 1000
    assert updates + config.bc.updates <= 500


@pytest.mark.parametrize(
    "override",
    ["loss.bc_wieght.init=1", "loss.lambda=1", "typo=1", "demos.multiply.speed=2"],
)
def test_an_unknown_key_is_an_error(override: str):
    with pytest.raises(ConfigCompositionException, match="Could not override"):
        compose_config("bc_sac", "smoke", override)


@pytest.mark.parametrize(
    "override",
    [
        "seed=three",
        "loss.gamma=high",
        "offline=maybe",
        "actor.hidden=[a]",
        "optim.actor_period=1.5",
    ],
)
def test_a_value_of_the_wrong_type_is_an_error(override: str):
    with pytest.raises((ConfigCompositionException, SettingsError)) as caught:
        compose_config("bc_sac", "smoke", override)
    assert override.split("=")[0] in f"{caught.value} {caught.value.__cause__}"


@pytest.mark.parametrize(("group", "known"), [("variant", VARIANTS), ("preset", PRESETS)])
def test_an_unknown_choice_lists_the_known_ones(group: str, known: list[str]):
    choices = {"variant": "bc_sac", "preset": "smoke"} | {group: "imaginary"}
    with pytest.raises(MissingConfigException, match="imaginary") as caught:
        compose_config(**choices)
    assert all(name in str(caught.value) for name in known)


def test_a_task_puts_its_values_behind_a_preset_and_before_a_variant():
    """The door's `default` multiplies, smoke, which comes after it, does not; others never do."""
    assert compose_config("bc_sac", "default").demos.multiply.enabled
    assert not compose_config("bc_sac", "smoke").demos.multiply.enabled
    other = compose_config("best", "default", "task.name='gymnasium:Pendulum-v1'")
    assert not other.demos.multiply.enabled
    assert other.loss.target_entropy is None
    assert other.loss.progress_bonus == 0.0
    assert other.loss.gamma == 0.995  # of the variant itself
    # A later composition knows nothing of an earlier one's task.
    assert compose_config("best", "default").loss.progress_bonus == 10.0


def test_every_file_that_asks_for_a_tasks_values_is_one_that_they_may_follow():
    assert adjusted() == ("preset/default", "variant/best", "variant/gentle")
    gentle = compose_config("gentle", "default")
    assert (gentle.demos.multiply.speed_low, gentle.demos.multiply.speed_high) == (1.1, 1.35)
    assert gentle.evaluation.exploration == "mean"
    other = compose_config("gentle", "default", "task.name='gymnasium:Pendulum-v1'")
    assert (
        other.demos.multiply.speed_high
        == compose_config("bc_sac", "paper").demos.multiply.speed_high
    )


def test_what_is_typed_comes_last():
    assert compose_config("best", "default", "loss.progress_bonus=3").loss.progress_bonus == 3.0


def test_the_task_of_a_command_line():
    assert task_named(["seed=1", "task.name='gymnasium:A-v0'"]) == "gymnasium:A-v0"
    assert task_named(["seed=1"]) == "door"


def test_task_defaults_follow_files_that_take_them():
    with pytest.raises(ValueError, match=r"follow \['preset/mine'\], which is none of"):
        register_task_defaults({"preset/mine": {"seed": 1}})


def test_options_of_an_environment_are_typed_plainly():
    recipe = configs.compose(
        "variant=sac", "preset=smoke", "task.name='gymnasium:Pendulum-v1'",
        "task.kwargs.g=9.0", "task.success=return>=-200",
    )  # fmt: skip
    assert recipe.task.kwargs == {"g": 9.0}
    assert recipe.task.success == "return>=-200"


def test_the_old_name_of_the_task_on_a_command_line_works_and_is_warned_of(caplog):
    assert flat("bc_sac", "paper", "env.name=pen")["task.name"] == "pen"
    assert "env.name is now called task.name" in caplog.text


@pytest.mark.parametrize("old", [old for old in RENAMED if old != "env.name"])
def test_other_old_names_on_a_command_line_are_unknown_keys(old: str):
    with pytest.raises(ConfigCompositionException, match=f"Could not override '{re.escape(old)}'"):
        compose_config("bc_sac", "paper", f"{old}=1")


def test_an_old_bound_on_the_angle_took_the_place_of_success():
    saved = {"growth": {"admission": {"min_angle": 1.2}}}
    assert rename_keys(saved) == {"growth": {"admission": {"min_progress": 1.2, "success": False}}}


def test_every_old_name_is_one_of_a_published_policy():
    published = [flatten(yaml.safe_load(path.read_text())) for path in POLICIES.rglob(CONFIG)]
    for old in (*RENAMED, *REMOVED):
        assert any(old in values for values in published), old


@pytest.mark.parametrize("old", [*RENAMED, *REMOVED])
def test_old_names_in_python_are_refused_with_todays(old: str):
    today = {**RENAMED, **REMOVED}[old]
    with pytest.raises(SettingsError, match=re.escape(f"no {old} any more: set {today}")):
        Recipe().changed(**nest(old, 1))


def test_a_saved_alpha_is_the_one_that_trained():
    """Of three files: where the two keys agree, differ, and where nothing reads the old one."""
    assert load_recipe(POLICIES / "dbc_sac").loss.bc_weight.schedule(1)(2) == 0.9999**2
    typed = {"kind": "exponential", "init": 1.0, "decay": 0.5}
    saved = {"loss": {"bc_weight": dict(typed), "bc_decay": 0.9}}
    assert rename_keys(saved) == {"loss": {"bc_weight": typed}}
    assert load_recipe(POLICIES / "bc_sac_10").loss.bc_weight.schedule(1)(9) == 10.0


def test_a_published_configuration_of_before_means_the_same():
    recipe = load_recipe(POLICIES / "best")
    assert recipe.task.name == "door"
    assert recipe.env.success_steps == 30
    assert recipe.demos.end_progress == recipe.demos.multiply.min_progress == 1.5
    assert (recipe.loss.progress_bonus, recipe.loss.progress_bonus_cap) == (10.0, 1.5)
    assert recipe.loss.bc_emphasis.beyond == 0.25
    assert recipe.growth.admission.min_progress == 1.35


def test_renaming_leaves_todays_names_alone():
    recipe = compose_config("best", "default").plain()
    assert rename_keys(dict(recipe)) == recipe


ODD = 'it\'s a=1,b $HOME ${x} [c] {d: e} "q" ü #%'


@pytest.mark.parametrize("value", [ODD, "a: b", "1e5", "true", "'", "x'", 'say "y"'])
def test_a_path_means_itself_however_it_is_typed(value: str):
    for typed in (f"demos.source={value}", f"demos.source='{value}'"):
        assert configs.compose("variant=bc", typed).demos.source == value
        # What Hydra was handed, as a resumed run reads it again.
        handed = spelled_for_hydra(typed)
        assert overridden(Recipe(), handed).demos.source == value
        assert overridden(Recipe(), typed).demos.source == value


def test_a_path_of_several_runs_is_left_to_hydra():
    assert spelled_for_hydra("demos.source=a,b", several=True) == "demos.source=a,b"
    assert spelled_for_hydra("resume=null") == "resume=null"
