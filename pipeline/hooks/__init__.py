"""Trainer hooks: small adapters between TorchRL's training loop and the pieces of the pipeline."""

from pipeline.hooks.average import ActorAverageHook
from pipeline.hooks.backtrack import BacktrackHook
from pipeline.hooks.demo_update import DemoUpdateHook
from pipeline.hooks.episodes import EpisodeHook
from pipeline.hooks.evaluate import EvaluationHook
from pipeline.hooks.grown import GrownHook
from pipeline.hooks.portion_guard import PortionGuard
from pipeline.hooks.progress import ProgressHook
from pipeline.hooks.store import StoreHook
from pipeline.hooks.updates import UpdatesHook

__all__ = [
    "ActorAverageHook",
    "BacktrackHook",
    "DemoUpdateHook",
    "EpisodeHook",
    "EvaluationHook",
    "GrownHook",
    "PortionGuard",
    "ProgressHook",
    "StoreHook",
    "UpdatesHook",
]
