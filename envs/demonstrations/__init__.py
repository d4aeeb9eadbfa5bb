"""Demonstrations of the door task: read, check, re-simulate, multiply, record.

demonstrations = load_demonstrations("bundled")
tensordicts = to_tensordict(demonstrations.episodes)
"""

from envs.demonstrations.episode import Episode, Provenance, content_hash
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.loading import DemonstrationSet, load_demonstrations
from envs.demonstrations.multiplication import multiply
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.recording import read_card, read_recording, write_recording
from envs.demonstrations.report import EpisodeReport, format_reports
from envs.demonstrations.resimulation import resimulate
from envs.demonstrations.sources import DemonstrationSource, open_source
from envs.demonstrations.tensordicts import to_tensordict

__all__ = [
    "DemonstrationError",
    "DemonstrationSet",
    "DemonstrationSource",
    "Episode",
    "EpisodeReport",
    "MultiplyConfig",
    "Provenance",
    "content_hash",
    "format_reports",
    "load_demonstrations",
    "multiply",
    "open_source",
    "read_card",
    "read_recording",
    "resimulate",
    "to_tensordict",
    "write_recording",
]
