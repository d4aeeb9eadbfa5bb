"""Demonstrations: read, check against the task's schema, select, multiply, record.

Nothing here knows a task: what an episode must look like, how it is replayed and how it is varied
are capabilities of :class:`envs.task.Task`.

demonstrations = load_demonstrations("bundled", find_task("door"))
tensordicts = to_tensordict(demonstrations.episodes)
"""

from envs.demonstrations.episode import Episode, Provenance, content_hash
from envs.demonstrations.errors import DemonstrationError
from envs.demonstrations.findings import Finding, Findings, Kind, Notes
from envs.demonstrations.loading import DemonstrationSet, DemoOptions, load_demonstrations
from envs.demonstrations.multiplication import multiply
from envs.demonstrations.multiply_config import MultiplyConfig
from envs.demonstrations.readers.recording import read_card, read_recording
from envs.demonstrations.report import EpisodeReport, format_reports, saturated_share
from envs.demonstrations.schema import DemoSchema, StartKey
from envs.demonstrations.sources import DemonstrationSource, open_source
from envs.demonstrations.tensordicts import IMITATED_ACTION, to_tensordict
from envs.demonstrations.writers import find_writer, write_demonstrations
from envs.demonstrations.writers.recording import write_recording

__all__ = [
    "IMITATED_ACTION",
    "DemoOptions",
    "DemoSchema",
    "DemonstrationError",
    "DemonstrationSet",
    "DemonstrationSource",
    "Episode",
    "EpisodeReport",
    "Finding",
    "Findings",
    "Kind",
    "MultiplyConfig",
    "Notes",
    "Provenance",
    "StartKey",
    "content_hash",
    "find_writer",
    "format_reports",
    "load_demonstrations",
    "multiply",
    "open_source",
    "read_card",
    "read_recording",
    "saturated_share",
    "to_tensordict",
    "write_demonstrations",
    "write_recording",
]
