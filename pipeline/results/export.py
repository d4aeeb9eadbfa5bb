"""A trained policy as three small files that ``make eval`` reads like a run directory."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from pipeline.files.run_files import CONFIG, write_atomically
from pipeline.policy import WEIGHTS, load_policy, save_weights
from pipeline.recipe import Recipe
from pipeline.results.evaluation import Evaluation, MadeFrom
from pipeline.results.runs import EvaluatedRun, RunGroup
from pipeline.run_dir import load_recipe, save_recipe
from pipeline.updates import critic_updates

CARD = "README.md"
POLICIES: Final = "policies"
"""Folder of published policies, below that of the results."""
UNSAFE: Final = re.compile(r"[^A-Za-z0-9._-]+")
"""What the name of a folder does not hold, because a shell or make reads it as something else."""
SHOWN = {
    "success_once": "share of episodes that succeed",
    "success_at_end": "share that are successful at their last step",
    "return_mean": "return",
    "steps_to_success_median": "steps until success, median",
}


def exported_seed(folder: Path) -> int | None:
    """The seed of the policy that ``folder`` holds; None if it holds none."""
    return int(load_recipe(folder).seed) if (folder / WEIGHTS).is_file() else None


def export_middle(row: RunGroup, policies: Path, *names: str, made: Path) -> None:
    """Writes the policy of a row's run in the middle by success, then return.

    It is chosen among the seeds whose weights are at hand: in a run directory, or published
    earlier, which then stay.

    Args:
        row: Evaluated runs of one row.
        policies: Folder of all published policies.
        names: Of the folder below it, from the outside in; characters that a shell reads are
            replaced.
        made: Where it is written, in place of ``policies``.
    """
    name = "/".join(UNSAFE.sub("_", part) for part in names)
    kept = exported_seed(policies / name)
    for run in row.by_distance_to_median:
        if run.path.is_dir():
            return export_policy(run, made / name, name=name)
        if run.seed == kept:
            return None
    return None


def export_policy(run: EvaluatedRun, folder: Path, *, name: str) -> None:
    """Writes weights, resolved configuration and card of the newest checkpoint of a run.

    Args:
        run: With its directory.
        folder: Where to; made if needed.
        name: Of the recipe, for the card.

    Raises:
        FileNotFoundError, ValueError: As ``load_policy``.
    """
    recipe = load_recipe(run.path)
    policy, origin = load_policy(recipe, recipe.find_task(), run.path)
    folder.mkdir(parents=True, exist_ok=True)
    save_weights(policy, folder / WEIGHTS, frames=origin.frames)
    # Of the paths only names stay: others have other folders, and other machines.
    portable = recipe.changed(
        cache_dir=Recipe.cache_dir,
        demos={"source": Path(recipe.demos.source).name},
        torch_threads=None,
        compile_updates=None,
        onednn=None,
        env={"num_threads": None},
    )
    save_recipe(folder, portable)
    write_atomically(folder / CARD, card_of(run.evaluation, recipe, name, origin.frames))


def _action(made_from: MadeFrom) -> str:
    if made_from.exploration == "mean":
        return "mean action"
    scale = 1.0 if made_from.noise_scale is None else made_from.noise_scale
    return f"sampled action, its noise times {scale:g}"


def card_of(evaluation: Evaluation, recipe: Recipe, name: str, frames: int) -> str:
    """What a policy is, what it was made of and what it reached, in Markdown."""
    figures = "\n".join(
        f"| {label} | {figure:.4g} |"
        for key, label in SHOWN.items()
        if (figure := evaluation.figure(key)) is not None
    )
    made_from = evaluation.made_from
    trained = (
        f"| updates | {critic_updates(recipe)} |" if recipe.offline else f"| frames | {frames} |"
    )
    demonstrations = "none"
    if recipe.uses_demonstrations:
        multiplied = ", multiplied" if recipe.demos.multiply.enabled else ""
        demonstrations = f"{Path(recipe.demos.source).name}{multiplied}"
    return f"""# Policy `{name}`

Of the task `{recipe.task.name}`.

| | |
|---|---|
| variant, preset, seed | {recipe.variant}, {recipe.preset}, {recipe.seed} |
{trained}
| demonstrations | {demonstrations} |
| network | {" x ".join(str(width) for width in recipe.actor.hidden)} |
{figures}

Over {evaluation.episodes} episodes, evaluation seed {made_from.evaluation_seed}, {_action(made_from)}. Again: `make eval RUN=docs/results/policies/{name}`.
Weights are in `{WEIGHTS}` (safetensors: tensors only), the configuration in `{CONFIG}`.
"""  # noqa: E501 - lines of Markdown
