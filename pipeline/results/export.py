"""A trained policy as three small files that ``make eval`` reads like a run directory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from configs.schema import Config
from pipeline.policy import WEIGHTS, load_policy, save_weights
from pipeline.results.rows import Seed
from pipeline.run_dir import CONFIG, load_config, write_atomically

CARD = "README.md"
SHOWN = {
    "share_gt_1_35": "doors above 1.35 rad",
    "share_gt_0_2": "doors above 0.2 rad",
    "return_mean": "return",
    "angle_mean_deg": "largest angle, degrees",
    "steps_to_open_median": "steps until 1.35 rad, median",
}


def exported_seed(folder: Path) -> int | None:
    """The seed of the policy that ``folder`` holds; None if it holds none."""
    return int(load_config(folder).seed) if (folder / WEIGHTS).is_file() else None


def export_policy(seed: Seed, run_dir: Path, folder: Path, *, name: str) -> None:
    """Writes weights, resolved configuration and card of the newest checkpoint of a run.

    Args:
        seed: What the run reached.
        run_dir: The run.
        folder: Where to; made if needed.
        name: Of the recipe, for the card.

    Raises:
        FileNotFoundError, ValueError: As ``load_policy``.
    """
    config = load_config(run_dir)
    policy, origin = load_policy(config, run_dir)
    folder.mkdir(parents=True, exist_ok=True)
    save_weights(policy, folder / WEIGHTS, frames=origin.frames)
    # Of the paths only names stay: others have other folders, and other machines.
    portable = OmegaConf.merge(
        config,
        {
            "run_dir": folder.name,
            "resume": None,
            "cache_dir": Config.cache_dir,
            "demos": {"source": Path(config.demos.source).name},
            "torch_threads": None,
            "compile_updates": None,
            "onednn": None,
            "env": {"num_threads": None},
        },
    )
    write_atomically(folder / CONFIG, OmegaConf.to_yaml(portable, resolve=True))
    write_atomically(folder / CARD, _card(seed, config, name, origin.frames))


def _action(made_from: Mapping[str, Any]) -> str:
    if made_from["exploration"] == "mean":
        return "mean action"
    return f"sampled action, its noise times {made_from.get('noise_scale', 1.0):g}"


def _card(seed: Seed, config: Config, name: str, frames: int) -> str:
    evaluation = seed.evaluation
    figures = "\n".join(
        f"| {label} | {evaluation[key]:.4g} |"
        for key, label in SHOWN.items()
        if evaluation.get(key) is not None
    )
    made_from = evaluation["made_from"]
    return f"""# Policy `{name}`

Opens the door of the paper's task: 38 observations in, 28 actions in (-1, 1) out, 100 Hz position control.

| | |
|---|---|
| variant, preset, seed | {config.variant}, {config.preset}, {config.seed} |
| frames | {frames} |
| demonstrations | {Path(config.demos.source).name}{", multiplied" if config.demos.multiply.enabled else ""} |
| network | {" x ".join(str(width) for width in config.actor.hidden)} |
{figures}

Over {evaluation["episodes"]} doors, evaluation seed {made_from["evaluation_seed"]}, {_action(made_from)}. Again: `make eval RUN=docs/results/policies/{name}`.
Weights are in `{WEIGHTS}` (safetensors: tensors only), the configuration in `{CONFIG}`.
"""  # noqa: E501 - lines of Markdown
